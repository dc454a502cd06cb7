"""Random flights: a room, a flight, and what happens around it, by a seed.

About half of them hit an obstacle or a wall, or are hit. The others do what real drones and cameras
do without a collision, in the scenarios of `manners.yaml`.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path as FilePath
from typing import Any

import numpy as np
import yaml

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.scenes.flights import random_parts as parts
from dlgmd_cli.scenes.flights import stages
from dlgmd_cli.scenes.flights.drone import GRAVITY_M_S2, PHASES, Phase
from dlgmd_cli.scenes.flights.furniture import catalogue, furniture, placement
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage
from dlgmd_cli.scenes.flights.random_parts import Way, visited_flight, within
from dlgmd_cli.scenes.flights.rooms import cluttered_room, corridor, simple_room
from dlgmd_cli.scenes.flights.solids import Body, World, box_of
from dlgmd_cli.scenes.flights.textures import Rng
from dlgmd_cli.scenes.flights.truth import Nearest, first_contact

# In these scenarios an object approaches a drone that hovers.
VISITS = ("approached", "crossed")
# Least distance and speed before a contact; flights below that are rejected.
_LEAST_WAY_M, _LEAST_M_S = 1.8, 0.4
_MAX_TRIES = 100
# Probability that the drone is agile.
_AGILE = 0.25
_CORRIDOR_M = 2.4
# Space of a roaming drone to the far end of the room, in seconds of flight, and, if it has a given
# speed, on either side. Space for people beside its way.
_AHEAD_S, _BESIDE_S, _PEOPLE_M = 1.2, 0.4, 2.2


@cache
def manners() -> dict[str, parts.Manner]:
    """The scenarios of `manners.yaml`, by name, with the usual values where they have none."""
    table = yaml.safe_load(FilePath(__file__).with_name("manners.yaml").read_text("utf-8"))
    usual = table.pop("usual")
    return {name: {**usual, **entry} for name, entry in table.items()}


def random_flight(
    seed: int,
    agile: bool | None = None,
    manner: str | None = None,
    speed_m_s: tuple[float, ...] = (),
) -> Stage:
    """A random flight in one of the scenarios, `manners`; about half of them hit something.

    If the drone heads for an obstacle, the outcome is determined by following the flight, not by
    the scenario: it may miss it, or hit something else.

    Parameters
    ----------
    seed : int
    agile : bool, optional
        Whether the drone is; a quarter of them are, unless given.
    manner : str, optional
        One of the `manners`, drawn unless given.
    speed_m_s : tuple of float
        The least and the greatest cruising speed, or one speed; that of the approaching object
        in "approached" and "crossed". The scenario has it unless given.
    """
    if agile is None:
        agile = bool(np.random.default_rng([seed, 0, 1]).random() < _AGILE)
    name = manner or manner_of(seed)
    kinds = dict.fromkeys(("hit", "wall", "pass", "stop"), _heading)
    draw = (kinds | dict.fromkeys(VISITS, visited_flight)).get(name, _roaming)
    for attempt in range(1, _MAX_TRIES):
        rng = np.random.default_rng([seed, attempt])
        drawn = _drawn(name, rng)
        if speed_m_s:
            speed = float(rng.uniform(speed_m_s[0], speed_m_s[-1]))
            drawn |= {"comer_m_s" if name in VISITS else "speed_m_s": speed, "paced": True}
        stage = draw(rng, seed, drawn, agile)
        if stage is not None:
            return replace(stage, manner=name)
    why = f"no flight of the scenario {name} was found for the seed {seed}"
    hint = f"Choose another {argument('seed')} or, with {argument('speed')}, a lower one."
    raise ParameterError("", why, hint)


def manner_of(seed: int) -> str:
    """The scenario that a seed draws."""
    shares = {name: manner["share"] for name, manner in manners().items()}
    visits = [shares.pop(name) for name in VISITS]
    # From a generator of its own: other seeds draw what they drew before there were visits.
    rng = np.random.default_rng([seed, 0, 3])
    if rng.random() < sum(visits):
        return str(rng.choice(VISITS, p=np.array(visits) / sum(visits)))
    return str(np.random.default_rng([seed, 0]).choice(list(shares), p=list(shares.values())))


def _drawn(name: str, rng: Rng) -> parts.Manner:
    """A scenario with a number or a word for each of its ranges."""
    drawn = {
        key: _draw(rng, value) if isinstance(value, list) and key != "shake_hz" else value
        for key, value in manners()[name].items()
    }
    return {**drawn, "name": name, "paced": False}


def _draw(rng: Rng, of: list[Any]) -> str | int | float:
    """A number of a range, or one of several words."""
    if isinstance(of[0], str):
        return str(rng.choice(of))
    if isinstance(of[0], int):
        return int(rng.integers(of[0], of[1], endpoint=True))
    return float(rng.uniform(*of))


# Towards an obstacle


def _heading(rng: Rng, seed: int, manner: parts.Manner, agile: bool) -> Stage | None:
    """A stage, or None if the flight would be too short or too slow, or miss the obstacle."""
    plan = manner["name"]
    name, build, height = _draw_obstacle(rng)
    if manner["paced"]:
        phases, speed = _draw_cruise(rng, manner, stops=plan == "stop"), manner["speed_m_s"]
    else:
        (phases, height), speed = _draw_script(rng, height, stops=plan == "stop"), 0.0
    start = (rng.uniform(0.9, 1.4), rng.uniform(-0.3, 0.3), height)
    turned = rng.uniform(-6.0, 6.0)
    begin = {"position_m": start, "yaw_deg": turned, "speed_m_s": speed}
    flight = parts.flight_in(phases, manner, seed, agile, **begin)
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
            obstacles = stages.obstacle_in_path(free, when, build, name, turned_deg=turned)
        except stages.MissedError:
            return None
    elif plan == "pass":
        aside = rng.choice([-1.0, 1.0]) * rng.uniform(0.75, 1.2)
        obstacles = stages.obstacle_beside(free, when, build, aside)
    elif plan == "stop":
        ahead = rng.uniform(0.9, 1.8)
        obstacles = stages.obstacle_beside(free, free.duration_s, build, 0.0, ahead_m=ahead)
    world = _draw_room(rng, free, obstacles, manner["floor"], when if plan == "wall" else None)
    world = parts.lit(rng, world, manner, free.duration_s)
    contact_s = first_contact(free, world)
    if contact_s is None:
        stage = Stage(world, free, name, None, free.duration_s, agile)
        return stage if obstacles else parts.target_nearest(stage, when)
    if contact_s < parts.EARLIEST_S:
        return None
    path = flight(contact_s)
    duration = min(contact_s + parts.AFTER_S, path.duration_s)
    return parts.target_nearest(Stage(world, path, name, contact_s, duration, agile), contact_s)


def _draw_obstacle(rng: Rng) -> tuple[str, stages.Build, float]:
    """One of the obstacles, with random looks and scale: name, builder, and height to hit it at."""
    looks = np.random.default_rng(rng.integers(2**32))
    obstacles = catalogue()["obstacles"]
    piece, name, sizes, (low_m, high_m) = obstacles[rng.integers(len(obstacles))]
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
    phases += _draw_turns(rng, (0.5, 1.4), weaves=True)
    if stops:
        phases.append(PHASES["decelerate"](rng.uniform(1.8, 2.6), rng.uniform(8.0, 16.0)))
    return phases, height


def _draw_cruise(rng: Rng, manner: parts.Manner, *, stops: bool) -> list[Phase]:
    """The phases of a flight that has its speed from the beginning, and keeps it."""
    speed = manner["speed_m_s"]
    phases = [PHASES["cruise"](rng.uniform(1.0, 1.8) + 1.5 / speed)]
    phases += _draw_turns(rng, (0.4, 1.0), weaves=False)
    if stops:
        pitch = rng.uniform(10.0, 18.0)
        brakes_s = speed / (GRAVITY_M_S2 * math.tan(math.radians(pitch)))
        phases.append(PHASES["decelerate"](brakes_s + rng.uniform(1.0, 1.6), pitch))
    return phases


def _draw_turns(rng: Rng, seconds_each: tuple[float, float], *, weaves: bool) -> list[Phase]:
    """Up to two straight parts, turns or slips, or also weaves."""
    phases = []
    for _ in range(rng.integers(0, 3)):
        seconds, side = rng.uniform(*seconds_each), rng.choice([-1.0, 1.0])
        turns = [
            PHASES["cruise"](seconds),
            PHASES["yaw"](seconds, side * rng.uniform(5.0, 20.0)),
            PHASES["roll"](0.5 * seconds, side * rng.uniform(2.0, 5.0)),
        ]
        if weaves:
            pitch, roll = rng.uniform(-10.0, 2.0), -side * rng.uniform(1.0, 6.0)
            rate, climb_m = side * rng.uniform(5.0, 30.0), rng.uniform(-0.3, 0.3)
            turns.append(PHASES["weave"](seconds, pitch, roll, rate, climb_m))
        phases.append(turns[rng.integers(len(turns))])
    return phases


def _draw_room(
    rng: Rng, path: Path, obstacles: Sequence[Body], floor: str, wall_s: float | None
) -> World:
    """A room around a flight; if `wall_s` is given, the flight reaches the far wall then."""
    track = parts.track_of(path)
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


def _roaming(rng: Rng, seed: int, manner: parts.Manner, agile: bool) -> Stage | None:
    """A stage without a collision, or None if the drone would hit something."""
    phases = parts.draw_turns(rng, manner)
    start = {"yaw_deg": rng.uniform(-10.0, 10.0), "speed_m_s": manner["speed_m_s"]}
    flight = partial(parts.flight_in, phases, manner, seed, agile, **start)
    # The first flight only shows how much room it takes.
    track = parts.track_of(flight(position_m=(0.0, 0.0, manner["height_m"]))())
    low, high = track.min(axis=0), track.max(axis=0)
    at = (parts.END_M - low[0], -(low[1] + high[1]) / 2.0, manner["height_m"])
    path = flight(position_m=at)()
    beside_m = _BESIDE_S * manner["speed_m_s"] if manner["paced"] else 0.0
    clear_m = max(manner["clear_m"], beside_m, _PEOPLE_M * bool(manner["people"]))
    half_m = (high[1] - low[1]) / 2.0 + clear_m
    end_m = parts.END_M + _AHEAD_S * manner["speed_m_s"] + rng.uniform(0.0, 1.0)
    length_m = parts.END_M + high[0] - low[0] + end_m
    width_m = 2.0 * half_m + rng.uniform(1.0, 2.0)
    things = _draw_things(rng, path, manner, (length_m, width_m))
    people = _draw_people(rng, path, manner, (length_m - parts.OFF_WALL_M, half_m))
    size_m, bodies = (length_m, width_m), [*things, *people]
    world = parts.room_around(rng, manner, size_m, half_m, bodies)
    world = parts.lit(rng, world, manner, path.duration_s)
    if parts.comes_near(path, world) or first_contact(path, world) is not None:
        return None
    stage = Stage(world, path, "", None, path.duration_s, agile)
    return parts.target_nearest(stage, path.duration_s / 2.0)


def _draw_things(
    rng: Rng, path: Path, manner: parts.Manner, size_m: tuple[float, float]
) -> list[Body]:
    """Things beside the way, not in it, in a room of a length and width; fewer if space lacks."""
    things: list[Body] = []
    walls = np.array([[0.0, -size_m[1] / 2.0], [size_m[0], size_m[1] / 2.0]])
    for _ in range(manner["things"]):
        _, build, _ = _draw_obstacle(rng)
        time_s = rng.uniform(0.1, 0.95) * path.duration_s
        away = rng.choice([-1.0, 1.0]) * stages.directions(path, time_s)[1]
        bodies = stages.obstacle_beside(path, time_s, build, 0.0)
        state = path.state(time_s)
        deep_m = max(float(body.reach(-away[None])[0]) + away @ state.position_m for body in bodies)
        bodies = [body.moved((manner["clear_m"] + deep_m) * away) for body in bodies]
        boxes = np.array([box_of(body)[:, :2] for body in bodies])
        is_inside = (boxes[:, 0] > walls[0]).all() and (boxes[:, 1] < walls[1]).all()
        if is_inside and not _meet(bodies, things) and _is_clear(path, bodies, manner):
            things += bodies
    return things


def _draw_people(
    rng: Rng, path: Path, manner: parts.Manner, ends_m: tuple[float, float]
) -> list[Body]:
    """People who walk past in straight lines, not too near; they stop at x and |y| of `ends_m`."""
    people: list[Body] = []
    most = np.array(ends_m) - parts.OFF_WALL_M
    least = np.array([2.0 * parts.OFF_WALL_M, -most[1]])
    for _ in range(manner["people"]):
        time_s = rng.uniform(0.15, 0.9) * path.duration_s
        ahead, left = stages.directions(path, time_s)
        aside, angle = np.radians([rng.uniform(-50.0, 50.0), rng.uniform(0.0, 360.0)])
        near = path.state(time_s).position_m + (manner["clear_m"] + 0.35 + rng.exponential(0.5)) * (
            math.cos(aside) * ahead + math.sin(aside) * left
        )
        at = np.clip(near[:2], least, most)
        way = manner["people_m_s"] * np.array([math.cos(angle), math.sin(angle)])
        # When the person reaches the borders.
        first, last = within(np.array([least - at, most - at]), way)
        walk = Way(near, np.array([*way, 0.0]), time_s, time_s + first, time_s + last)
        where = placement(at.tolist(), math.degrees(angle), rng.uniform(0.9, 1.05))
        person = furniture("person", rng, where, motion=walk.offset)
        people += person if _is_clear(path, person, manner) else []
    return people


def _is_clear(path: Path, bodies: Sequence[Body], manner: parts.Manner) -> bool:
    """Whether bodies always leave a path nearly the free space of a scenario."""
    nearest, times = Nearest(bodies), np.arange(0.0, path.duration_s, parts.SAMPLE_S).tolist()
    distances = [nearest.distances(path.state(time).position_m, time).min() for time in times]
    return bool(min(distances) > 0.8 * manner["clear_m"])


def _meet(bodies: Sequence[Body], others: Sequence[Body]) -> bool:
    """Whether the boxes of two groups of bodies meet."""
    if not others:
        return False
    boxes, taken = (np.array([box_of(body) for body in group]) for group in (bodies, others))
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    return bool(((low <= taken[:, 1]) & (taken[:, 0] <= high)).all(axis=1).any())
