"""Placing obstacles in the path of a flight or beside it, and building the world from a room."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from dlgmd_cli.lab.flights.geometry import Nearest
from dlgmd_cli.lab.flights.path import REACH_M, Path
from dlgmd_cli.lab.flights.renderer.camera import FloatArray
from dlgmd_cli.lab.flights.renderer.solids import Body, World
from dlgmd_cli.lab.flights.rooms import FurnishedRoom

# Builds an obstacle at (x, y) on the floor with a yaw in degrees; its front faces along its x.
Build: TypeAlias = Callable[[tuple[float, float], float], Sequence[Body]]

# Bound on the extent of obstacles, and step of the search.
_FARTHEST_M, _STEP_M = 3.0, 0.02
_N_HALVINGS = 50
_STANDS_M_S, _TOUCHING_M = 0.1, 0.01

# Frame interval of the paper's videos.
FRAME_S = 1.0 / 30.0

# Light in a room: a white surface facing the lamps is just saturated in the camera.
DAYLIGHT = 1.35


class MissedError(Exception):
    """The flight passes over or under the obstacle that it should hit."""


def obstacle_in_path(
    path: Path, contact_s: float, build: Build, target: str, *, turned_deg: float = 0.0
) -> list[Body]:
    """An obstacle straight ahead, placed so that the drone touches it at `contact_s`.

    `path` is the flight without contact. `target` names the part to be touched; other parts must
    not be touched earlier. The front is turned by `turned_deg` from facing the drone. Raises
    MissedError if the drone cannot touch the target.
    """
    state = path.state(contact_s)
    ahead = heading(state.velocity_m_s)
    x, y, _ = state.position_m.tolist()
    yaw = math.degrees(math.atan2(ahead[1], ahead[0])) + 180.0 + turned_deg
    bodies = build((x, y), yaw)
    nearest = Nearest([body for body in bodies if body.name == target])

    def touches(ahead_m: float) -> bool:
        return bool(
            nearest.distances(state.position_m - ahead_m * ahead, contact_s).min() <= REACH_M
        )

    far = _FARTHEST_M
    while not touches(far - _STEP_M):
        far -= _STEP_M
        if far < -_FARTHEST_M:
            raise MissedError(target)
    near = far - _STEP_M
    for _ in range(_N_HALVINGS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if touches(middle) else (near, middle)
    return [body.moved(near * ahead) for body in bodies]


def obstacle_beside(
    path: Path, time_s: float, build: Build, aside_m: float, ahead_m: float = 0.0
) -> list[Body]:
    """An obstacle beside or ahead of the drone's position at a time, facing the drone.

    It is `aside_m` to the left and `ahead_m` ahead, relative to the direction of flight, or to the
    heading if the drone is at rest.
    """
    state = path.state(time_s)
    stands = np.linalg.norm(state.velocity_m_s) < _STANDS_M_S
    ahead = heading(state.pose.rotation[:, 0] if stands else state.velocity_m_s)
    left = np.array([-ahead[1], ahead[0], 0.0])
    x, y, _ = (state.position_m + ahead_m * ahead + aside_m * left).tolist()
    return list(build((x, y), math.degrees(math.atan2(ahead[1], ahead[0])) + 180.0))


def build_world(
    place: FurnishedRoom, obstacles: Sequence[Body] = (), light: float = DAYLIGHT
) -> World:
    """The world of a furnished room and obstacles, in constant light.

    Furniture with the same name as an obstacle is renamed: the name identifies the target.
    """
    taken = {obstacle.name for obstacle in obstacles}
    furniture = [_other(body) if body.name in taken else body for body in place.bodies]
    return World(place.room, [*furniture, *obstacles], lambda _: light)


def with_unique_name(world: World, index: int) -> World:
    """The world with other furniture renamed so that only one piece has its name.

    The piece is that of the body `index`: the bodies of the same name connected to it by touching.
    """
    name = world.bodies[index].name
    axes = np.eye(3)
    boxes = {
        i: (-body.reach(-axes) - _TOUCHING_M, body.reach(axes) + _TOUCHING_M)
        for i, body in enumerate(world.bodies)
        if body.name == name
    }
    piece, new = {index}, [index]
    while new:
        low, high = boxes[new.pop()]
        touched = {
            i for i, (low2, high2) in boxes.items() if (low <= high2).all() and (low2 <= high).all()
        }
        new += touched - piece
        piece |= touched
    bodies = [
        _other(body) if body.name == name and i not in piece else body
        for i, body in enumerate(world.bodies)
    ]
    return World(world.room, bodies, world.light)


def _other(body: Body) -> Body:
    """The body under another name."""
    return replace(body, name=f"other {body.name}")


def heading(velocity_m_s: FloatArray) -> FloatArray:
    """Horizontal direction of a velocity, a unit vector (3,)."""
    level = velocity_m_s * (1.0, 1.0, 0.0)
    ahead: FloatArray = level / np.linalg.norm(level)
    return ahead
