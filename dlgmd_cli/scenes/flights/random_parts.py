"""What all random flights share: their flying, their light, and their target."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from dlgmd_cli.scenes.flights import textures
from dlgmd_cli.scenes.flights.drone import PHASES, Phase, fly
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage, shaken
from dlgmd_cli.scenes.flights.rooms import SIDES, shadow_on
from dlgmd_cli.scenes.flights.solids import Solid, World
from dlgmd_cli.scenes.flights.stages import with_unique_name
from dlgmd_cli.scenes.flights.textures import Rng
from dlgmd_cli.scenes.flights.truth import surroundings

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

    def flight(contact_s: float | None = None, blow_m_s: Any = (0.0, 0.0, 0.0)) -> Path:
        air = {"jitter": manner["air"], "seed": seed, "agile": agile}
        path = fly(phases, contact_s=contact_s, blow_m_s=blow_m_s, **air, **start)
        shake = {key: manner[key] for key in ("shake_deg_s", "shake_hz", "bob_m", "step_hz")}
        return shaken(path, np.random.default_rng([seed, 2]), **shake)

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


def lit(rng: Rng, world: World, manner: Manner, seconds: float) -> World:
    """The world in the light of a scenario: constant, or with steps, and with shadows."""
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
