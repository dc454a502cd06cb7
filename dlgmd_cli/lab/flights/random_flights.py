"""Random flights: a room, a flight, and what happens around it, by a seed.

About half of them hit an obstacle or a wall. The others do what real drones and cameras do without
a collision, in the manners of `manners.yaml`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.lab.flights import textures
from dlgmd_cli.lab.flights.drone import PHASES, Phase, fly
from dlgmd_cli.lab.flights.furniture import furniture, placement
from dlgmd_cli.lab.flights.path import REACH_M, Path, Stage, shaken
from dlgmd_cli.lab.flights.rooms import SIDES, cluttered_room, corridor, shadow_on, simple_room
from dlgmd_cli.lab.flights.solids import Body, Solid, World, box_of
from dlgmd_cli.lab.flights.stages import (
    Build,
    MissedError,
    directions,
    obstacle_beside,
    obstacle_in_path,
    with_unique_name,
)
from dlgmd_cli.lab.flights.textures import Rng
from dlgmd_cli.lab.flights.truth import Nearest, first_contact, surroundings

# A manner with its ranges, and the numbers drawn from them.
Manner = dict[str, Any]

# Time filmed after a collision.
_AFTER_S = 0.5
# Earliest contact, and least distance and speed before it; flights below that are rejected.
_EARLIEST_S, _LEAST_WAY_M, _LEAST_M_S = 1.2, 1.8, 0.4
_MAX_TRIES = 100
# Probability that the drone is agile.
_AGILE = 0.25
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
# Step at which a path is sampled, and the space of a roaming drone to the ends of the room. If it
# flew straight on, it would hit nothing for some time: otherwise an alarm would be right.
_SAMPLE_S, _END_M = 0.05, 1.6
_STRAIGHT_S, _AHEAD_S = (0.1, 0.2, 0.3, 0.4, 0.5), 1.2
# Space for people beside the way, and their distance from walls.
_PEOPLE_M, _OFF_WALL_M = 2.2, 0.4


@cache
def manners() -> dict[str, Manner]:
    """The manners of `manners.yaml`, by name, with the usual values where they have none."""
    table = yaml.safe_load(FilePath(__file__).with_name("manners.yaml").read_text("utf-8"))
    usual = table.pop("usual")
    return {name: {**usual, **entry} for name, entry in table.items()}


def random_flight(seed: int, agile: bool | None = None) -> Stage:
    """A random flight in one of the `manners`; about half of them hit something.

    If the drone heads for an obstacle, the outcome is determined by following the flight, not by
    the manner: it may miss it, or hit something else. A quarter of the drones are agile, unless
    `agile` is given.
    """
    if agile is None:
        agile = bool(np.random.default_rng([seed, 0, 1]).random() < _AGILE)
    shares = [manner["share"] for manner in manners().values()]
    name = str(np.random.default_rng([seed, 0]).choice(list(manners()), p=shares))
    draw = _heading if name in ("hit", "wall", "pass", "stop") else _roaming
    for attempt in range(1, _MAX_TRIES):
        rng = np.random.default_rng([seed, attempt])
        stage = draw(rng, seed, name, agile)
        if stage is not None:
            return replace(stage, manner=name)
    raise RuntimeError(f"no flight found for the seed {seed}")


def _drawn(name: str, rng: Rng) -> Manner:
    """A manner with a number or a word for each of its ranges."""
    return {
        key: _draw(rng, value) if isinstance(value, list) and key != "shake_hz" else value
        for key, value in manners()[name].items()
    }


def _draw(rng: Rng, of: list[Any]) -> Any:
    """A number of a range, or one of several words."""
    if isinstance(of[0], str):
        return str(rng.choice(of))
    if isinstance(of[0], int):
        return int(rng.integers(of[0], of[1], endpoint=True))
    return float(rng.uniform(*of))


def _flight(
    phases: Sequence[Phase], manner: Manner, seed: int, agile: bool, **start: Any
) -> Callable[..., Path]:
    """A function that flies the phases in a manner; its argument is `contact_s`."""

    def flight(contact_s: float | None = None) -> Path:
        air = {"jitter": manner["air"], "seed": seed, "agile": agile}
        path = fly(phases, contact_s=contact_s, **air, **start)
        shake = {key: manner[key] for key in ("shake_deg_s", "shake_hz", "bob_m", "step_hz")}
        return shaken(path, np.random.default_rng([seed, 2]), **shake)

    return flight


# Towards an obstacle


def _heading(rng: Rng, seed: int, plan: str, agile: bool) -> Stage | None:
    """A stage, or None if the flight would be too short or too slow, or miss the obstacle."""
    manner = _drawn(plan, rng)
    name, build, height = _draw_obstacle(rng)
    phases, height = _draw_script(rng, height, stops=plan == "stop")
    start = (rng.uniform(0.9, 1.4), rng.uniform(-0.3, 0.3), height)
    turned = rng.uniform(-6.0, 6.0)
    flight = _flight(phases, manner, seed, agile, position_m=start, yaw_deg=turned)
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
        obstacles = obstacle_beside(free, when, build, aside)
    elif plan == "stop":
        ahead = rng.uniform(0.9, 1.8)
        obstacles = obstacle_beside(free, free.duration_s, build, 0.0, ahead_m=ahead)
    wall_s = when if plan == "wall" else None
    world = _draw_room(rng, free, obstacles, manner["floor"], wall_s)
    world = _lit(rng, world, manner, free.duration_s)
    contact_s = first_contact(free, world)
    if contact_s is None:
        stage = Stage(world, free, name, None, free.duration_s, agile)
        return stage if obstacles else _target_nearest(stage, when)
    if contact_s < _EARLIEST_S:
        return None
    path = flight(contact_s)
    duration = min(contact_s + _AFTER_S, path.duration_s)
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


def _draw_room(
    rng: Rng, path: Path, obstacles: Sequence[Body], floor: str, wall_s: float | None
) -> World:
    """A room around a flight; if `wall_s` is given, the flight reaches the far wall then."""
    track = _track(path)
    ends = np.array([box_of(body) for body in obstacles]).reshape(-1, 2, 3)
    length = max(track[:, 0].max(), *ends[:, 1, 0], 3.0) + rng.uniform(1.2, 3.0)
    if wall_s is not None:
        x_m = float(path.state(wall_s).position_m[0])
        return simple_room(rng, length_m=x_m + REACH_M, floor=floor)
    widest = max(np.abs(track[:, 1]).max(), np.abs(ends[:, :, 1]).max(initial=0.0))
    if widest < _CORRIDOR_M / 2 - 0.2 and rng.random() < 0.4:
        # As high as the pillar.
        size = {"length_m": length, "width_m": _CORRIDOR_M, "height_m": 2.8}
        return corridor(rng, **size, floor=floor, obstacles=obstacles)
    width = max(5.2, 2.0 * widest + 2.2) + rng.uniform(0.0, 0.8)
    kind = cluttered_room if rng.random() < 0.7 else simple_room
    return kind(rng, length_m=length, width_m=width, floor=floor, obstacles=obstacles)


# Roaming


def _roaming(rng: Rng, seed: int, name: str, agile: bool) -> Stage | None:
    """A stage without a collision, or None if the drone would hit something."""
    manner = _drawn(name, rng)
    phases = _draw_turns(rng, manner)
    start = {"yaw_deg": rng.uniform(-10.0, 10.0), "speed_m_s": manner["speed_m_s"]}
    flight = partial(_flight, phases, manner, seed, agile, **start)
    # The first flight only shows how much room it takes.
    track = _track(flight(position_m=(0.0, 0.0, manner["height_m"]))())
    low, high = track.min(axis=0), track.max(axis=0)
    at = (_END_M - low[0], -(low[1] + high[1]) / 2.0, manner["height_m"])
    path = flight(position_m=at)()
    half_m = (high[1] - low[1]) / 2.0 + max(manner["clear_m"], _PEOPLE_M * bool(manner["people"]))
    end_m = _END_M + _AHEAD_S * manner["speed_m_s"] + rng.uniform(0.0, 1.0)
    length_m = _END_M + high[0] - low[0] + end_m
    width_m = 2.0 * half_m + rng.uniform(1.0, 2.0)
    things = _draw_things(rng, path, manner, (length_m, width_m))
    people = _draw_people(rng, path, manner, (length_m - _OFF_WALL_M, half_m))
    world = cluttered_room(
        rng,
        length_m=length_m,
        width_m=width_m,
        free_width_m=2.0 * half_m,
        end_m=_END_M - 1.0,
        floor=manner["floor"],
        obstacles=[*things, *people],
    )
    world = _lit(rng, world, manner, path.duration_s)
    if _comes_near(path, world) or first_contact(path, world) is not None:
        return None
    stage = Stage(world, path, "", None, path.duration_s, agile)
    return _target_nearest(stage, path.duration_s / 2.0)


def _draw_turns(rng: Rng, manner: Manner) -> list[Phase]:
    """Straight parts, turns and slips in turn, at a constant speed."""
    phases: list[Phase] = []
    left_s, side = manner["seconds"], rng.choice([-1.0, 1.0])
    while left_s > 0.0:
        seconds = rng.uniform(0.4, 1.0)
        rate = side * manner["turn_deg_s"] * rng.uniform(0.6, 1.0)
        phases += [PHASES["cruise"](seconds / 2.0), PHASES["yaw"](seconds, rate)]
        left_s, side = left_s - 1.5 * seconds, -side
    return phases


def _draw_things(rng: Rng, path: Path, manner: Manner, size_m: tuple[float, float]) -> list[Body]:
    """Things beside the way, not in it, in a room of a length and width; fewer if space lacks."""
    found: list[Body] = []
    walls = np.array([[0.0, -size_m[1] / 2.0], [size_m[0], size_m[1] / 2.0]])
    for _ in range(manner["things"]):
        _, build, _ = _draw_obstacle(rng)
        time_s = rng.uniform(0.1, 0.95) * path.duration_s
        away = rng.choice([-1.0, 1.0]) * directions(path, time_s)[1]
        bodies = obstacle_beside(path, time_s, build, 0.0)
        state = path.state(time_s)
        deep_m = max(float(body.reach(-away[None])[0]) + away @ state.position_m for body in bodies)
        bodies = [body.moved((manner["clear_m"] + deep_m) * away) for body in bodies]
        boxes = np.array([box_of(body)[:, :2] for body in bodies])
        is_inside = (boxes[:, 0] > walls[0]).all() and (boxes[:, 1] < walls[1]).all()
        if is_inside and not _meet(bodies, found) and _is_clear(path, bodies, manner):
            found += bodies
    return found


def _draw_people(rng: Rng, path: Path, manner: Manner, ends_m: tuple[float, float]) -> list[Body]:
    """People who walk past in straight lines, not too near; they stop at x and |y| of `ends_m`."""
    found: list[Body] = []
    most = np.array(ends_m) - _OFF_WALL_M
    least = np.array([2.0 * _OFF_WALL_M, -most[1]])
    for _ in range(manner["people"]):
        time_s = rng.uniform(0.15, 0.9) * path.duration_s
        ahead, left = directions(path, time_s)
        aside, angle = np.radians([rng.uniform(-50.0, 50.0), rng.uniform(0.0, 360.0)])
        near = path.state(time_s).position_m + (manner["clear_m"] + 0.35 + rng.exponential(0.5)) * (
            math.cos(aside) * ahead + math.sin(aside) * left
        )
        at = np.clip(near[:2], least, most)
        way = manner["people_m_s"] * np.array([math.cos(angle), math.sin(angle)])
        # When the person reaches the borders.
        with np.errstate(divide="ignore"):
            times = np.sort([(least - at) / way, (most - at) / way], axis=0)
        first, last = float(times[0].max()), float(times[1].min())
        motion = partial(_walked, (*way, 0.0), time_s, (time_s + first, time_s + last))
        scale = rng.uniform(0.9, 1.05)
        where = placement(at.tolist(), math.degrees(angle), scale)
        person = furniture("person", rng, where, motion=motion)
        found += person if _is_clear(path, person, manner) else []
    return found


def _walked(way: Any, met_s: float, span: tuple[float, float], now_s: float) -> Any:
    """Displacement, (3,) in m, of a person who walks only within a span of time."""
    return np.array(way) * (min(max(now_s, span[0]), span[1]) - met_s)


def _is_clear(path: Path, bodies: Sequence[Body], manner: Manner) -> bool:
    """Whether bodies always leave a path nearly the free space of a manner."""
    nearest, times = Nearest(bodies), np.arange(0.0, path.duration_s, _SAMPLE_S).tolist()
    found = [nearest.distances(path.state(time).position_m, time).min() for time in times]
    return bool(min(found) > 0.8 * manner["clear_m"])


def _meet(bodies: Sequence[Body], others: Sequence[Body]) -> bool:
    """Whether the boxes of two groups of bodies meet."""
    if not others:
        return False
    boxes, taken = (np.array([box_of(body) for body in group]) for group in (bodies, others))
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    return bool(((low <= taken[:, 1]) & (taken[:, 0] <= high)).all(axis=1).any())


def _comes_near(path: Path, world: World) -> bool:
    """Whether the drone would soon hit something if it flew straight on, at any time."""
    nearest = surroundings(world)
    for time_s in np.arange(0.0, path.duration_s, _SAMPLE_S).tolist():
        state = path.state(time_s)
        for later_s in _STRAIGHT_S:
            at = state.position_m + later_s * state.velocity_m_s
            if nearest.distances(at, time_s + later_s).min() < REACH_M:
                return True
    return False


# Both


def _lit(rng: Rng, world: World, manner: Manner, seconds: float) -> World:
    """The world in the light of a manner: constant, or with steps, and with shadows."""
    levels = [rng.uniform(0.8, 1.8)]
    times = [0.0]
    starts = np.sort(rng.uniform(0.0, seconds, manner["light_steps"]))
    for start in starts.tolist():
        # Towards the middle of the range of levels.
        ratio = manner["light_ratio"] if levels[-1] < 1.2 else 1.0 / manner["light_ratio"]
        times += [max(start, times[-1]), max(start, times[-1]) + manner["light_step_s"]]
        levels += [levels[-1], levels[-1] * ratio]
    shadows = [_draw_shadow(rng, world, manner) for _ in range(manner["shadows"])]

    def light(time_s: float) -> float:
        return float(np.interp(time_s, times, levels))

    return replace(world, light=light, shadows=shadows)


def _draw_shadow(rng: Rng, world: World, manner: Manner) -> Solid:
    """A shadow that sweeps to and fro over a wall or the floor."""
    side = int(rng.choice([1, 2, 3, 4, 4]))  # not the wall behind the start, and not the ceiling
    return shadow_on(
        world.room.faces[side],
        textures.shadow(rng, (rng.uniform(0.8, 3.0), rng.uniform(0.8, 2.5)), 60.0),
        up=rng.uniform(0.0, 1.0),
        speed_m_s=manner["shadow_m_s"],
        phase=rng.uniform(0.0, 2.0 * math.pi),
    )


def _track(path: Path) -> Any:
    """Positions along a path, (n, 3)."""
    times = np.arange(0.0, path.duration_s, _SAMPLE_S)
    return np.array([path.state(time).position_m for time in times])


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
