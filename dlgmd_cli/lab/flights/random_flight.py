"""A random flight through a random room, with a random outcome."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from dlgmd_cli.lab.flights import script
from dlgmd_cli.lab.flights.bodies import placement
from dlgmd_cli.lab.flights.drone import fly
from dlgmd_cli.lab.flights.furniture import furniture
from dlgmd_cli.lab.flights.geometry import first_contact, surroundings
from dlgmd_cli.lab.flights.path import REACH_M, Path, Stage
from dlgmd_cli.lab.flights.placing import (
    Build,
    MissedError,
    build_world,
    obstacle_beside,
    obstacle_in_path,
    with_unique_name,
)
from dlgmd_cli.lab.flights.renderer.solids import Body, Solid
from dlgmd_cli.lab.flights.rooms import SIDES, FurnishedRoom, cluttered_room, corridor, simple_room
from dlgmd_cli.lab.flights.textures import Rng

_AFTER_S = 0.5
# Earliest contact, and least distance and speed before it; flights below that are rejected.
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
    """A stage, or None if the flight would be too short or too slow."""
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
    obstacles = _place_obstacle(rng, plan, name, build, free, when)
    if obstacles is None:
        return None
    place = _draw_room(rng, free, obstacles, when if plan == "wall" else None)
    world = build_world(place, obstacles, light=rng.uniform(0.8, 1.8))
    contact_s = first_contact(free, world)
    if contact_s is not None and contact_s < _EARLIEST_S:
        return None
    if contact_s is None:
        stage = Stage(world, free, name, None, free.duration_s, agile)
        return stage if obstacles else _target_nearest(stage, when)
    path = flight(contact_s=contact_s)
    duration = min(contact_s + _AFTER_S, path.duration_s)
    stage = Stage(world, path, name, contact_s, duration, agile)
    return _target_nearest(stage, contact_s)


def _place_obstacle(
    rng: Rng, plan: str, name: str, build: Build, path: Path, when_s: float
) -> Sequence[Body] | None:
    """The obstacle at its planned position, or None if the flight would miss it."""
    if plan == "hit":
        turned = rng.uniform(-40.0, 40.0)
        try:
            return obstacle_in_path(path, when_s, build, name, turned_deg=turned)
        except MissedError:
            return None
    if plan == "pass":
        aside = rng.choice([-1.0, 1.0]) * rng.uniform(0.75, 1.2)
        return obstacle_beside(path, when_s, build, aside)
    if plan == "stop":
        ahead = rng.uniform(0.9, 1.8)
        return obstacle_beside(path, path.duration_s, build, 0.0, ahead_m=ahead)
    return ()


def _draw_obstacle(rng: Rng) -> tuple[str, Build, float]:
    """One of the obstacles, with random looks and scale: name, builder, and height to hit it at."""
    looks = np.random.default_rng(rng.integers(2**32))
    piece, name, sizes, (low_m, high_m) = _OBSTACLES[rng.integers(len(_OBSTACLES))]
    scale = rng.uniform(*sizes)

    def build(at_m: tuple[float, float], yaw_deg: float) -> list[Body]:
        return furniture(piece, looks, placement(at_m, yaw_deg, scale))

    return name, build, rng.uniform(scale * low_m, scale * high_m)


def _draw_script(rng: Rng, height: float, *, stops: bool) -> tuple[list[script.Phase], float]:
    """The phases of the flight, and the height of the camera at the start."""
    tilt = rng.uniform(5.0, 14.0)
    phases = [script.hover(rng.uniform(0.3, 1.0))]
    if rng.random() < 0.2:
        phases = [
            script.stand(rng.uniform(0.2, 0.6)),
            script.take_off(rng.uniform(1.8, 2.4), height - 0.12),
        ]
        height = 0.12
    phases.append(script.accelerate(rng.uniform(1.0, 2.2), -tilt))
    for _ in range(rng.integers(0, 3)):
        seconds, side = rng.uniform(0.5, 1.4), rng.choice([-1.0, 1.0])
        turn = [
            script.cruise(seconds),
            script.yaw(seconds, side * rng.uniform(5.0, 20.0)),
            script.roll(0.5 * seconds, side * rng.uniform(2.0, 5.0)),
            script.weave(
                seconds,
                rng.uniform(-10.0, 2.0),
                -side * rng.uniform(1.0, 6.0),
                side * rng.uniform(5.0, 30.0),
                rng.uniform(-0.3, 0.3),
            ),
        ]
        phases.append(turn[rng.integers(len(turn))])
    if stops:
        phases.append(script.decelerate(rng.uniform(1.8, 2.6), rng.uniform(8.0, 16.0)))
    return phases, height


def _draw_room(
    rng: Rng, path: Path, obstacles: Sequence[Body], wall_s: float | None
) -> FurnishedRoom:
    """A room around a flight; if `wall_s` is given, the flight reaches the far wall then."""
    times = np.arange(0.0, path.duration_s, 0.05)
    track = np.array([path.state(time).position_m for time in times])
    ends = [float(body.reach(np.array([[1.0, 0.0, 0.0]]))[0]) for body in obstacles]
    length = max(track[:, 0].max(), *ends, 3.0) + rng.uniform(1.2, 3.0)
    if wall_s is not None:
        return simple_room(rng, length_m=float(path.state(wall_s).position_m[0]) + REACH_M)
    sides = np.array([[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    widest = max([np.abs(track[:, 1]).max(), *(body.reach(sides).max() for body in obstacles)])
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
