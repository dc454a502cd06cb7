"""Flights through rooms that `scenes.yaml` describes, and the places of their obstacles."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights.drone import PHASES, fly
from dlgmd_cli.scenes.flights.furniture import furniture, placement
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage
from dlgmd_cli.scenes.flights.rooms import DAYLIGHT, cluttered_room, corridor, renamed, simple_room
from dlgmd_cli.scenes.flights.solids import Body, Motion, World, box_of
from dlgmd_cli.scenes.flights.textures import Rng
from dlgmd_cli.scenes.flights.truth import Nearest

# Builds an obstacle at (x, y) on the floor with a yaw in degrees; its front faces along its x.
Build = Callable[[tuple[float, float], float], Sequence[Body]]

# Frame interval of the paper's videos.
FRAME_S = 1.0 / 30.0
_ROOMS = {"cluttered": cluttered_room, "simple": simple_room, "corridor": corridor}
_DUSK, _OFF_WALL_M = 0.3, 0.01
# Time filmed after a collision.
_AFTER_S = 15 * FRAME_S

# Bound on the extent of obstacles, and step of the search.
_FARTHEST_M, _STEP_M = 3.0, 0.02
_N_HALVINGS = 50
_STANDS_M_S, _TOUCHING_M = 0.1, 0.01


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
    ahead = _heading(state.velocity_m_s)
    x, y, _ = state.position_m.tolist()
    bodies = build((x, y), _facing_deg(ahead) + turned_deg)
    nearest = Nearest([body for body in bodies if body.name == target])

    def touches(ahead_m: float) -> bool:
        distances = nearest.distances(state.position_m - ahead_m * ahead, contact_s)
        return bool(distances.min() <= REACH_M)

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
    """An obstacle that faces the drone, so far to its left and ahead of it at a time.

    This is relative to the direction of flight, or to the heading if the drone is at rest.
    """
    state, (ahead, left) = path.state(time_s), directions(path, time_s)
    x, y, _ = (state.position_m + ahead_m * ahead + aside_m * left).tolist()
    return list(build((x, y), _facing_deg(ahead)))


def directions(path: Path, time_s: float, *, looks: bool = False) -> tuple[FloatArray, FloatArray]:
    """Horizontal unit vectors, (3,): where the drone flies, or heads if it rests, and its left.

    With `looks`, it is where the camera looks in any case.
    """
    state = path.state(time_s)
    stands = np.linalg.norm(state.velocity_m_s) < _STANDS_M_S
    ahead = _heading(state.pose.rotation[:, 0] if looks or stands else state.velocity_m_s)
    return ahead, np.array([-ahead[1], ahead[0], 0.0])


def _heading(velocity_m_s: FloatArray) -> FloatArray:
    """Horizontal direction of a velocity, a unit vector (3,)."""
    level = velocity_m_s * (1.0, 1.0, 0.0)
    return level / np.linalg.norm(level)


def _facing_deg(ahead: FloatArray) -> float:
    """The yaw of what faces a drone that flies in a direction."""
    return math.degrees(math.atan2(ahead[1], ahead[0])) + 180.0


def with_unique_name(world: World, index: int) -> World:
    """The world with other furniture renamed so that only one piece has its name.

    The piece is that of the body `index`: the bodies of the same name connected to it by touching.
    """
    name = world.bodies[index].name
    named = [i for i, body in enumerate(world.bodies) if body.name == name]
    boxes = {i: box_of(world.bodies[i]) for i in named}
    piece, new = {index}, [index]
    while new:
        low, high = boxes[new.pop()] + np.array([[-_TOUCHING_M], [_TOUCHING_M]])
        touched = {
            i
            for i, (low2, high2) in boxes.items()
            if (low <= high2 + _TOUCHING_M).all() and (low2 - _TOUCHING_M <= high).all()
        }
        new += touched - piece
        piece |= touched
    others = {*named} - piece
    bodies = [renamed(body) if i in others else body for i, body in enumerate(world.bodies)]
    return replace(world, bodies=bodies)


# Named flights


def named_flight(spec: Mapping[str, Any], seed: int, agile: bool | None = None) -> Stage:
    """The flight described by an entry of `scenes.yaml`; `seed` determines everything random.

    `agile` overrides the entry.
    """
    agile = spec.get("agile", False) if agile is None else agile
    phases = [PHASES[name](n / 30.0, *values) for name, n, *values in spec["flies"]]
    start = {"position_m": spec["start_m"], "yaw_deg": spec.get("yaw_deg", 0.0)}
    flight = partial(fly, phases, **start, seed=seed, agile=agile)
    free, obstacle = flight(), spec["obstacle"]
    target, hit_at = obstacle.get("target", obstacle["piece"]), obstacle.get("hit_at")
    room = dict(spec["room"])
    rng = np.random.default_rng([seed, room.pop("number", 1)])
    kind, behind_m = _ROOMS[room.pop("kind")], room.pop("behind_m", 0.0)
    if hit_at is not None:
        contact_s = hit_at * FRAME_S
        build = partial(_piece, obstacle["piece"], np.random.default_rng([seed, 2]))
        turned = obstacle.get("turned_deg", 0.0)
        obstacles = obstacle_in_path(free, contact_s, build, target, turned_deg=turned)
        end_m = max(float(box_of(body)[1, 0]) for body in obstacles)
        world = kind(rng, **{"length_m": end_m + behind_m, **room}, obstacles=obstacles)
        path = flight(contact_s=contact_s)
        return Stage(world, path, target, contact_s, contact_s + _AFTER_S, agile)
    room.setdefault("length_m", _x(free, free.duration_s) + behind_m)
    obstacles = _missed_obstacle(obstacle, rng, free, room["length_m"])
    world = kind(rng, **room, obstacles=obstacles)
    if "lamps_on_at" in spec:
        on_s = spec["lamps_on_at"] / 30.0
        world = replace(world, light=lambda time_s: DAYLIGHT if time_s >= on_s else _DUSK)
    return Stage(world, free, target, None, free.duration_s, agile)


def _piece(
    name: str, rng: Rng, at_m: Sequence[float], yaw_deg: float = 0.0, motion: Motion | None = None
) -> list[Body]:
    """A piece of furniture at (x, y) on the floor, or at (x, y, z)."""
    return furniture(name, rng, placement(at_m, yaw_deg), motion=motion)


def _missed_obstacle(
    obstacle: Mapping[str, Any], rng: Rng, path: Path, length_m: float
) -> list[Body]:
    """An obstacle that is not hit."""
    name = obstacle["piece"]
    if "at_frame" in obstacle:
        return _piece(name, rng, (_x(path, obstacle["at_frame"] / 30.0), obstacle["y_m"]))
    if "up_m" in obstacle:
        return _piece(name, rng, (length_m - _OFF_WALL_M, 0.0, obstacle["up_m"]), 180.0)
    walk = obstacle["walks"]

    def motion(time_s: float) -> tuple[float, float, float]:
        way = walk["m_s"] * (time_s - walk["from"] / 30.0)
        return 0.0, float(np.clip(way, 0.0, walk["way_m"])), 0.0

    return _piece(name, rng, obstacle["at_m"], obstacle["yaw_deg"], motion)


def _x(path: Path, time_s: float) -> float:
    """Position along the room at a time, in m."""
    return float(path.state(time_s).position_m[0])
