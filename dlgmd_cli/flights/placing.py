"""Obstacles put in the way of a flight or beside it, and the world that they make with a room."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from dlgmd_cli.flights.geometry import Nearest
from dlgmd_cli.flights.path import REACH_M, Path
from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Body, World
from dlgmd_cli.flights.rooms import Place

# Builds an obstacle at (x, y) on the floor with a yaw in degrees; its front looks along its x.
Build: TypeAlias = Callable[[tuple[float, float], float], Sequence[Body]]

# Obstacles reach less far than this from where they are built; looked for in steps of that.
_FARTHEST_M, _STEP_M = 3.0, 0.02
_N_HALVINGS = 50
_STANDS_M_S, _TOUCHING_M = 0.1, 0.01

# Frames of the paper's videos are this far apart.
FRAME_S = 1.0 / 30.0

# How bright a room is: a white surface that faces the lamps is as bright as a camera can see.
DAYLIGHT = 1.35


class PassedError(Exception):
    """A flight that goes over or under the obstacle that was to be in its way."""


def in_the_way(
    path: Path, contact_s: float, build: Build, target: str, *, turned_deg: float = 0.0
) -> list[Body]:
    """An obstacle straight ahead, so far that the camera comes within reach of it at a time.

    The path is that as if nothing were there. `target` is the name of what is met; other parts of
    the obstacle must not be met before. Its front is turned from where the drone comes from. Raises
    PassedError if the camera does not come within reach of it.
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
            raise PassedError(target)
    near = far - _STEP_M
    for _ in range(_N_HALVINGS):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if touches(middle) else (near, middle)
    return [body.moved(near * ahead) for body in bodies]


def beside(
    path: Path, time_s: float, build: Build, aside_m: float, ahead_m: float = 0.0
) -> list[Body]:
    """An obstacle that looks at the drone from beside or before where it is at a time.

    It is so far left of the drone and ahead, as it flies then; as its nose points, if it does not.
    """
    state = path.state(time_s)
    stands = np.linalg.norm(state.velocity_m_s) < _STANDS_M_S
    ahead = heading(state.pose.rotation[:, 0] if stands else state.velocity_m_s)
    left = np.array([-ahead[1], ahead[0], 0.0])
    x, y, _ = (state.position_m + ahead_m * ahead + aside_m * left).tolist()
    return list(build((x, y), math.degrees(math.atan2(ahead[1], ahead[0])) + 180.0))


def world_of(place: Place, guests: Sequence[Body] = (), light: float = DAYLIGHT) -> World:
    """A furnished place and what else is in it, in steady light.

    Furniture that has the name of a guest gets another one, so that truths are about the guest.
    """
    taken = {guest.name for guest in guests}
    furniture = [_other(body) if body.name in taken else body for body in place.bodies]
    return World(place.room, [*furniture, *guests], lambda _: light)


def singled_out(world: World, index: int) -> World:
    """A world where only the piece of furniture that a body is a part of has that body's name.

    Parts of a piece share a name and touch.
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
    """The same body by another name."""
    return replace(body, name=f"other {body.name}")


def heading(velocity_m_s: FloatArray) -> FloatArray:
    """The level direction of a velocity, as a unit vector (3,)."""
    level = velocity_m_s * (1.0, 1.0, 0.0)
    ahead: FloatArray = level / np.linalg.norm(level)
    return ahead
