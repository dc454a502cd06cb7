"""What random flights share: their flying, their light, their target, and objects that come by."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights import textures
from dlgmd_cli.scenes.flights.drone import PHASES, RESTITUTION, Phase, fly
from dlgmd_cli.scenes.flights.furniture import furniture, placement
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage, shaken
from dlgmd_cli.scenes.flights.rooms import SIDES, cluttered_room, shadow_on
from dlgmd_cli.scenes.flights.solids import Body, Capsule, Motion, Solid, Texture, World, box_of
from dlgmd_cli.scenes.flights.stages import directions, with_unique_name
from dlgmd_cli.scenes.flights.textures import Rng
from dlgmd_cli.scenes.flights.truth import first_contact, surroundings

# A scenario with its ranges, and the numbers drawn from them.
Manner = dict[str, Any]

# Earliest contact, and time filmed after it.
EARLIEST_S, AFTER_S = 1.2, 0.5
# Step at which a path is sampled, and the space of a roaming drone to the ends of the room. If it
# flew straight on, it would hit nothing for some time: otherwise an alarm would be right.
SAMPLE_S, END_M = 0.05, 1.6
_STRAIGHT_S = (0.1, 0.2, 0.3, 0.4, 0.5)
# Distance of people from walls.
OFF_WALL_M = 0.4


def flight_in(
    phases: Sequence[Phase], manner: Manner, seed: int, agile: bool, **start: Any
) -> Callable[..., Path]:
    """A function that flies the phases in a scenario; its argument is `contact_s`."""

    def flight(contact_s: float | None = None, blow_m_s: npt.ArrayLike = (0.0, 0.0, 0.0)) -> Path:
        air = {"jitter": manner["air"], "seed": seed, "agile": agile}
        path = fly(phases, contact_s=contact_s, blow_m_s=blow_m_s, **air, **start)
        return shaken(path, np.random.default_rng([seed, 2]), manner)

    return flight


def draw_turns(rng: Rng, manner: Manner) -> list[Phase]:
    """Straight parts, turns and slips in turn, at a constant speed."""
    phases: list[Phase] = []
    left_s, side = manner["seconds"], rng.choice([-1.0, 1.0])
    while left_s > 0.0:
        seconds = rng.uniform(0.4, 1.0)
        rate = side * manner["turn_deg_s"] * rng.uniform(0.6, 1.0)
        phases += [PHASES["cruise"](seconds / 2.0), PHASES["yaw"](seconds, rate)]
        left_s, side = left_s - 1.5 * seconds, -side
    return phases


def comes_near(path: Path, world: World) -> bool:
    """Whether the drone would soon hit something if it flew straight on, at any time."""
    nearest = surroundings(world)
    for time_s in np.arange(0.0, path.duration_s, SAMPLE_S).tolist():
        state = path.state(time_s)
        for later_s in _STRAIGHT_S:
            at = state.position_m + later_s * state.velocity_m_s
            if nearest.distances(at, time_s + later_s).min() < REACH_M:
                return True
    return False


def room_around(
    rng: Rng, manner: Manner, size_m: tuple[float, float], half_m: float, obstacles: Sequence[Body]
) -> World:
    """A cluttered room of a length and width, free up to `half_m` on either side of the x axis."""
    length_m, width_m = size_m
    return cluttered_room(
        rng,
        length_m=length_m,
        width_m=width_m,
        free_width_m=2.0 * half_m,
        end_m=END_M - 1.0,
        floor=manner["floor"],
        obstacles=obstacles,
    )


def lit(rng: Rng, world: World, manner: Manner, seconds: float) -> World:
    """The world in the light of a scenario: constant, or with steps, and with shadows."""
    levels = [rng.uniform(0.8, 1.8)]
    times = [0.0]
    for start in np.sort(rng.uniform(0.0, seconds, manner["light_steps"])).tolist():
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


def track_of(path: Path) -> Any:
    """Positions along a path, (n, 3)."""
    times = np.arange(0.0, path.duration_s, SAMPLE_S)
    return np.array([path.state(time).position_m for time in times])


def target_nearest(stage: Stage, time_s: float) -> Stage:
    """The stage with the furniture or wall that is nearest to the drone at a time as target."""
    world = stage.world
    distances = surroundings(world).distances(stage.path.state(time_s).position_m, time_s)
    nearest = int(np.argmin(distances))
    if nearest < len(world.bodies):
        target = world.bodies[nearest].name
        return replace(stage, world=with_unique_name(world, nearest), target=target)
    side = nearest - len(world.bodies)
    return replace(stage, target=SIDES[side], wall=Solid(SIDES[side], [world.room.faces[side]]))


# Nobody runs faster, in m/s.
_FASTEST_PERSON_M_S = 4.0
_RADII_M, _BALL_TEXELS = (0.08, 0.4), 96
# Height of the middle of the drone of furniture.yaml.
_DRONE_MIDDLE_M = 0.06
# It comes for so long, from so far at most, and within so much space on either side.
_COMES_S, _COMES_M, _ASIDE_M = (1.2, 2.5), 8.0, 3.0


@dataclass(frozen=True)
class Way:
    """A straight way at a constant speed, between two instants; before and after, it is at rest.

    Attributes
    ----------
    at_m, velocity_m_s : ndarray, shape (3,)
        Where the object is at the time `at_s`, and its velocity.
    at_s, start_s, end_s : float
    """

    at_m: FloatArray
    velocity_m_s: FloatArray
    at_s: float
    start_s: float
    end_s: float

    def offset(self, time_s: float) -> FloatArray:
        """Displacement from `at_m` at a time, (3,) in m."""
        return self.velocity_m_s * (min(max(time_s, self.start_s), self.end_s) - self.at_s)


def within(borders_m: FloatArray, velocity_m_s: FloatArray) -> tuple[float, float]:
    """When something is between two corners, (2, 2) in m from where it is at time 0."""
    with np.errstate(divide="ignore"):
        times = np.sort(borders_m / velocity_m_s, axis=0)
    return float(times[0].max()), float(times[1].min())


def _draw_comer(rng: Rng, kind: str, way: Way) -> list[Body]:
    """The bodies of a "ball", "person" or "drone" on its way.

    `way` is that of its middle; of a person, of the feet.
    """
    looks = np.random.default_rng(rng.integers(2**32))
    if kind == "ball":
        radius_m = math.exp(looks.uniform(*np.log(_RADII_M)))
        ends = np.array([way.at_m, way.at_m])
        return [Capsule("ball", ends, radius_m, _ball(looks), motion=way.offset)]
    yaw_deg = math.degrees(math.atan2(way.velocity_m_s[1], way.velocity_m_s[0]))
    scale = looks.uniform(0.9, 1.05) if kind == "person" else looks.uniform(0.6, 1.6)
    x, y, z = way.at_m.tolist()
    low_m = 0.0 if kind == "person" else _DRONE_MIDDLE_M * scale
    return furniture(kind, looks, placement((x, y, z - low_m), yaw_deg, scale), motion=way.offset)


def _ball(rng: Rng) -> Texture:
    """A ball with stripes, darker towards its rim."""
    y, x = (np.mgrid[:_BALL_TEXELS, :_BALL_TEXELS] + 0.5) * 2.0 / _BALL_TEXELS - 1.0
    light = 0.5 + 0.5 * np.sqrt(np.maximum(1.0 - x**2 - y**2, 0.0))
    turn, width = rng.uniform(0.0, math.pi), rng.uniform(0.3, 0.9)
    stripes = np.cos(math.tau / width * (math.cos(turn) * x + math.sin(turn) * y)) > 0.0
    tone = np.where(stripes, *rng.uniform(0.03, 0.95, 2)) + 0.02 * rng.standard_normal(x.shape)
    return Texture(textures.reflectance(np.clip(tone * light, 0.0, 1.0)))


def _rebounding(motion: Motion, contact_s: float, time_s: float) -> FloatArray:
    """Displacement at a time, with a share of the speed backwards from contact on."""
    return np.asarray(motion(min(time_s, contact_s - RESTITUTION * (time_s - contact_s))), float)


def _width_m(bodies: Sequence[Body]) -> float:
    """The greatest extent of bodies along x or y, in m."""
    boxes = np.array([box_of(body) for body in bodies])
    return float((boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0))[:2].max())


def visited_flight(rng: Rng, seed: int, manner: Manner, agile: bool) -> Stage | None:
    """A stage in which something hits the drone, or passes it; None if it does not."""
    hits = manner["name"] == "approached"
    phases = draw_turns(rng, manner)
    at = (END_M, 0.0, manner["height_m"])
    begin = {"yaw_deg": rng.uniform(-10.0, 10.0), "speed_m_s": manner["speed_m_s"]}
    flight = flight_in(phases, manner, seed, agile, position_m=at, **begin)
    free = flight()
    met_s = rng.uniform(0.5, 0.85) * free.duration_s
    kind = manner["comer"]
    if kind == "person" and manner["comer_m_s"] > _FASTEST_PERSON_M_S:
        kind = str(rng.choice(["ball", "drone"]))
    draw_way = _draw_way_to if hits else _draw_way_past
    way = draw_way(rng, free, met_s, manner, kind)
    comer = _draw_comer(rng, kind, way)
    if not hits:  # beside the drone, not through it
        away = way.at_m - free.state(met_s).position_m
        away[2] = 0.0
        aside = away / np.linalg.norm(away) * _width_m(comer) / 2
        comer = _draw_comer(rng, kind, replace(way, at_m=way.at_m + aside))
    ends = [way.at_m + way.offset(time_s) for time_s in (way.start_s, way.end_s)]
    spots = np.array([*ends, *track_of(free)])
    half_m = float(np.abs(spots[:, 1]).max()) + _width_m(comer) / 2.0 + OFF_WALL_M
    length_m = float(spots[:, 0].max()) + _width_m(comer) / 2.0 + rng.uniform(1.2, 2.5)
    width_m = 2.0 * half_m + rng.uniform(1.0, 2.0)
    world = room_around(rng, manner, (length_m, width_m), half_m, comer)
    world = lit(rng, world, manner, free.duration_s)
    contact_s = first_contact(free, world)
    if not hits:
        if contact_s is not None or comes_near(free, world):
            return None
        return Stage(world, free, comer[0].name, None, free.duration_s, agile)
    if contact_s is None or contact_s < EARLIEST_S:
        return None
    path = flight(contact_s, way.velocity_m_s)
    bodies = [
        replace(body, motion=partial(_rebounding, body.motion, contact_s)) if body.motion else body
        for body in world.bodies
    ]
    world = replace(world, bodies=bodies)
    duration = min(contact_s + AFTER_S, path.duration_s)
    stage = target_nearest(Stage(world, path, "", contact_s, duration, agile), contact_s)
    return stage if stage.target == comer[0].name else None


def _draw_way_to(rng: Rng, path: Path, met_s: float, manner: Manner, kind: str) -> Way:
    """A straight way to the drone from nearly ahead; nothing flies below half a metre."""
    ahead, left = directions(path, met_s, looks=True)
    angle = math.radians(manner["comer_deg"])
    aim = path.state(met_s).position_m + rng.uniform(-0.06, 0.06, 3)
    pace = manner["comer_m_s"]
    far_m = min(pace * rng.uniform(*_COMES_S), _COMES_M, pace * met_s)
    from_m = aim + far_m * (math.cos(angle) * ahead + math.sin(angle) * left)
    from_m[2] = rng.uniform(0.6, 2.0)
    if kind == "person":
        aim[2] = from_m[2] = 0.0
    towards = (aim - from_m) / np.linalg.norm(aim - from_m)
    start_s = met_s - float(np.linalg.norm(aim - from_m)) / pace
    return Way(aim, pace * towards, met_s, start_s, path.duration_s)


def _draw_way_past(rng: Rng, path: Path, met_s: float, manner: Manner, kind: str) -> Way:
    """A straight, level way past the drone, across its view or to its side, inside a space."""
    ahead, left = directions(path, met_s, looks=True)
    angle, side = math.radians(rng.uniform(0.0, 90.0)), rng.choice([-1.0, 1.0])
    here = path.state(met_s).position_m
    away = math.cos(angle) * ahead + side * math.sin(angle) * left
    near = here + (manner["clear_m"] + REACH_M) * away
    near[2] = 0.0 if kind == "person" else here[2] + rng.uniform(-0.3, 0.4)
    pace = manner["comer_m_s"]
    # It comes from ahead, and is nearest to the drone at `near`.
    velocity = pace * (side * math.cos(angle) * left - math.sin(angle) * ahead)
    far_s = min(rng.uniform(*_COMES_S), _COMES_M / pace, met_s)
    # Until it reaches the borders of the space.
    borders = np.array([[OFF_WALL_M + 0.4, -_ASIDE_M], [END_M + _COMES_M, _ASIDE_M]])
    first_s, last_s = within(borders - near[:2], velocity[:2])
    return Way(near, velocity, met_s, met_s + max(first_s, -far_s), met_s + max(last_s, 0.0))
