"""Flights through rooms: those that `scenes.yaml` describes, and random ones."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from dlgmd_cli.lab.flights.camera import FloatArray
from dlgmd_cli.lab.flights.drone import PHASES, Phase, fly
from dlgmd_cli.lab.flights.furniture import furniture, placement
from dlgmd_cli.lab.flights.path import REACH_M, Path, Stage
from dlgmd_cli.lab.flights.rooms import (
    DAYLIGHT,
    SIDES,
    cluttered_room,
    corridor,
    renamed,
    simple_room,
)
from dlgmd_cli.lab.flights.solids import Body, Motion, Solid, World, box_of
from dlgmd_cli.lab.flights.textures import Rng
from dlgmd_cli.lab.flights.truth import Nearest, first_contact, surroundings

# Builds an obstacle at (x, y) on the floor with a yaw in degrees; its front faces along its x.
Build = Callable[[tuple[float, float], float], Sequence[Body]]

# Frame interval of the paper's videos.
FRAME_S = 1.0 / 30.0
_ROOMS = {"cluttered": cluttered_room, "simple": simple_room, "corridor": corridor}
_DUSK, _OFF_WALL_M = 0.3, 0.01
# Time filmed after a collision.
_AFTER_S, _RANDOM_AFTER_S = 15 * FRAME_S, 0.5

# Bound on the extent of obstacles, and step of the search.
_FARTHEST_M, _STEP_M = 3.0, 0.02
_N_HALVINGS = 50
_STANDS_M_S, _TOUCHING_M = 0.1, 0.01

# Of random flights: earliest contact, and least distance and speed before it; flights below that
# are rejected.
_EARLIEST_S, _LEAST_WAY_M, _LEAST_M_S = 1.2, 1.8, 0.4
_MAX_TRIES = 50
# Probability that the drone is agile.
_AGILE = 0.25
# Probability of each plan; the outcome may differ from the plan.
_PLANS = {"hit": 0.45, "wall": 0.1, "pass": 0.25, "stop": 0.2}
_CORRIDOR_M = 2.4
# Possible obstacles: the piece of furniture, the part to be hit, the range of its scale, and the
# range of heights at which it can be hit at scale 1.
_OBSTACLES = (
    ("chair", "chair", (0.9, 1.15), (0.65, 0.78)),
    ("gridded pattern", "gridded pattern", (0.8, 1.2), (0.8, 1.4)),
    ("notebook on table", "notebook", (0.95, 1.1), (0.86, 0.93)),
    ("carton on stool", "carton", (0.85, 1.15), (0.85, 1.1)),
    ("pillar", "pillar", (1.0, 1.0), (0.6, 1.8)),
    ("person", "person", (0.9, 1.05), (0.9, 1.4)),
)


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


def _obstacle_beside(
    path: Path, time_s: float, build: Build, aside_m: float, ahead_m: float = 0.0
) -> list[Body]:
    """An obstacle that faces the drone, so far to its left and ahead of it at a time.

    This is relative to the direction of flight, or to the heading if the drone is at rest.
    """
    state = path.state(time_s)
    stands = np.linalg.norm(state.velocity_m_s) < _STANDS_M_S
    ahead = _heading(state.pose.rotation[:, 0] if stands else state.velocity_m_s)
    left = np.array([-ahead[1], ahead[0], 0.0])
    x, y, _ = (state.position_m + ahead_m * ahead + aside_m * left).tolist()
    return list(build((x, y), _facing_deg(ahead)))


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


# Random flights


def random_flight(seed: int, agile: bool | None = None) -> Stage:
    """A random flight; about half of them hit an obstacle, a wall, or other furniture.

    In the others, the drone passes the obstacle, stops in front of it, or has none in its way. The
    outcome is determined by following the flight, not by the plan. A quarter of the drones are
    agile, unless `agile` is given.
    """
    if agile is None:
        agile = bool(np.random.default_rng([seed, 0, 1]).random() < _AGILE)
    plan = str(np.random.default_rng([seed, 0]).choice(list(_PLANS), p=list(_PLANS.values())))
    for attempt in range(1, _MAX_TRIES):
        stage = _draw_stage(np.random.default_rng([seed, attempt]), seed, plan, agile)
        if stage is not None:
            return stage
    raise RuntimeError(f"no flight found for the seed {seed}")


def _draw_stage(rng: Rng, seed: int, plan: str, agile: bool) -> Stage | None:
    """A stage, or None if the flight would be too short or too slow, or miss the obstacle."""
    name, build, height = _draw_obstacle(rng)
    phases, height = _draw_script(rng, height, stops=plan == "stop")
    start = (rng.uniform(0.9, 1.4), rng.uniform(-0.3, 0.3), height)
    turned = rng.uniform(-6.0, 6.0)
    flight = partial(fly, phases, position_m=start, yaw_deg=turned, seed=seed, agile=agile)
    free = flight()
    moving = [end for phase, _, end in free.phases if phase not in ("stand", "take off", "hover")]
    when = rng.uniform(0.55, 0.95) * moving[-1]
    met = free.state(when)
    if plan in ("hit", "wall") and (
        np.linalg.norm(met.position_m - start) < _LEAST_WAY_M
        or np.linalg.norm(met.velocity_m_s[:2]) < _LEAST_M_S
    ):
        return None
    obstacles: Sequence[Body] = ()
    if plan == "hit":
        turned = rng.uniform(-40.0, 40.0)
        try:
            obstacles = obstacle_in_path(free, when, build, name, turned_deg=turned)
        except MissedError:
            return None
    elif plan == "pass":
        aside = rng.choice([-1.0, 1.0]) * rng.uniform(0.75, 1.2)
        obstacles = _obstacle_beside(free, when, build, aside)
    elif plan == "stop":
        ahead = rng.uniform(0.9, 1.8)
        obstacles = _obstacle_beside(free, free.duration_s, build, 0.0, ahead_m=ahead)
    world = _draw_room(rng, free, obstacles, when if plan == "wall" else None)
    light = rng.uniform(0.8, 1.8)
    world = replace(world, light=lambda _: light)
    contact_s = first_contact(free, world)
    if contact_s is None:
        stage = Stage(world, free, name, None, free.duration_s, agile)
        return stage if obstacles else _target_nearest(stage, when)
    if contact_s < _EARLIEST_S:
        return None
    path = flight(contact_s=contact_s)
    duration = min(contact_s + _RANDOM_AFTER_S, path.duration_s)
    return _target_nearest(Stage(world, path, name, contact_s, duration, agile), contact_s)


def _draw_obstacle(rng: Rng) -> tuple[str, Build, float]:
    """One of the obstacles, with random looks and scale: name, builder, and height to hit it at."""
    looks = np.random.default_rng(rng.integers(2**32))
    piece, name, sizes, (low_m, high_m) = _OBSTACLES[rng.integers(len(_OBSTACLES))]
    scale = rng.uniform(*sizes)

    def build(at_m: tuple[float, float], yaw_deg: float) -> list[Body]:
        return furniture(piece, looks, placement(at_m, yaw_deg, scale))

    return name, build, rng.uniform(scale * low_m, scale * high_m)


def _draw_script(rng: Rng, height: float, *, stops: bool) -> tuple[list[Phase], float]:
    """The phases of the flight, and the height of the camera at the start."""
    tilt = rng.uniform(5.0, 14.0)
    phases = [PHASES["hover"](rng.uniform(0.3, 1.0))]
    if rng.random() < 0.2:
        phases = [
            PHASES["stand"](rng.uniform(0.2, 0.6)),
            PHASES["take_off"](rng.uniform(1.8, 2.4), height - 0.12),
        ]
        height = 0.12
    phases.append(PHASES["accelerate"](rng.uniform(1.0, 2.2), -tilt))
    for _ in range(rng.integers(0, 3)):
        seconds, side = rng.uniform(0.5, 1.4), rng.choice([-1.0, 1.0])
        turn = [
            PHASES["cruise"](seconds),
            PHASES["yaw"](seconds, side * rng.uniform(5.0, 20.0)),
            PHASES["roll"](0.5 * seconds, side * rng.uniform(2.0, 5.0)),
            PHASES["weave"](
                seconds,
                rng.uniform(-10.0, 2.0),
                -side * rng.uniform(1.0, 6.0),
                side * rng.uniform(5.0, 30.0),
                rng.uniform(-0.3, 0.3),
            ),
        ]
        phases.append(turn[rng.integers(len(turn))])
    if stops:
        phases.append(PHASES["decelerate"](rng.uniform(1.8, 2.6), rng.uniform(8.0, 16.0)))
    return phases, height


def _draw_room(rng: Rng, path: Path, obstacles: Sequence[Body], wall_s: float | None) -> World:
    """A room around a flight; if `wall_s` is given, the flight reaches the far wall then."""
    times = np.arange(0.0, path.duration_s, 0.05)
    track = np.array([path.state(time).position_m for time in times])
    ends = np.array([box_of(body) for body in obstacles]).reshape(-1, 2, 3)
    length = max(track[:, 0].max(), *ends[:, 1, 0], 3.0) + rng.uniform(1.2, 3.0)
    if wall_s is not None:
        return simple_room(rng, length_m=_x(path, wall_s) + REACH_M)
    widest = max(np.abs(track[:, 1]).max(), np.abs(ends[:, :, 1]).max(initial=0.0))
    if widest < _CORRIDOR_M / 2 - 0.2 and rng.random() < 0.4:
        # As high as the pillar.
        return corridor(
            rng, length_m=length, width_m=_CORRIDOR_M, height_m=2.8, obstacles=obstacles
        )
    width = max(5.2, 2.0 * widest + 2.2) + rng.uniform(0.0, 0.8)
    kind = cluttered_room if rng.random() < 0.7 else simple_room
    return kind(rng, length_m=length, width_m=width, obstacles=obstacles)


def _target_nearest(stage: Stage, time_s: float) -> Stage:
    """The stage with the furniture or wall that is nearest to the drone at a time as target."""
    world = stage.world
    distances = surroundings(world).distances(stage.path.state(time_s).position_m, time_s)
    nearest = int(np.argmin(distances))
    if nearest < len(world.bodies):
        target = world.bodies[nearest].name
        return replace(stage, world=with_unique_name(world, nearest), target=target)
    side = nearest - len(world.bodies)
    return replace(stage, target=SIDES[side], wall=Solid(SIDES[side], [world.room.faces[side]]))
