"""The five groups of flights of the paper's Table III: each ends in a collision.

[Zhao2023] gives each group's place, what the drone does, what it hits and at which frame of a
video of 30 frames/s. Speeds and sizes are not known; here they are a small quadrotor's in a room.
"""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.drone import fly
from dlgmd_cli.flights.path import Stage
from dlgmd_cli.flights.places.indoor import cluttered_room, simple_room
from dlgmd_cli.flights.places.obstacles import carton_on_stool, gridded_board, notebook_on_table
from dlgmd_cli.flights.places.rooms import Place
from dlgmd_cli.flights.places.seats import chair
from dlgmd_cli.flights.renderer.solids import Body
from dlgmd_cli.flights.script import (
    Phase,
    accelerate,
    decelerate,
    hover,
    pitch,
    stand,
    take_off,
    yaw,
)
from dlgmd_cli.flights.stages.placing import FRAME_S, Build, in_the_way, world_of

# What is filmed after the collision.
AFTER_S = 15 * FRAME_S


def group1(seed: int) -> Stage:
    """Cluttered indoor; it pitches and accelerates into a plain-coloured chair, frame 120."""
    return _collision(
        seed,
        [hover(1.2), pitch(0.4, -11.0), accelerate(9.0, -11.0)],
        start_m=(1.0, 0.0, 0.74),
        frame=120,
        target="chair",
        build=lambda at, yaw_deg: chair(at, yaw_deg, tone=0.12),
        turned_deg=25.0,
    )


def group2(seed: int) -> Stage:
    """Cluttered indoor; from frame 40 it pitches and accelerates, from 125 it brakes; 140."""
    return _collision(
        seed,
        [
            hover(40 * FRAME_S),
            pitch(10 * FRAME_S, -9.0),
            accelerate(75 * FRAME_S, -9.0),
            decelerate(9.0, 12.0),
        ],
        start_m=(1.0, 0.0, 1.1),
        frame=140,
        target="gridded pattern",
        build=gridded_board,
    )


def group3(seed: int) -> Stage:
    """Cluttered indoor; it yaws at 10 degrees/s, in a curve, into a notebook; frame 135."""
    return _collision(
        seed,
        [hover(0.6), pitch(0.3, -8.0), accelerate(0.6, -8.0), yaw(9.0, 10.0)],
        start_m=(1.2, 0.45, 0.94),
        yaw_deg=-18.0,
        frame=135,
        target="notebook",
        build=lambda at, yaw_deg: notebook_on_table(
            np.random.default_rng([seed, 2]), at, yaw_deg, height_m=0.72
        ),
    )


def group4(seed: int) -> Stage:
    """Simple indoor; it takes off and pitches, into a gridded pattern; frame 210."""
    return _take_off_and_pitch(seed, 210, "gridded pattern", gridded_board)


def group5(seed: int) -> Stage:
    """Simple indoor; it takes off and pitches, into a carton; frame 196."""

    def build(at_m: tuple[float, float], yaw_deg: float) -> Sequence[Body]:
        return carton_on_stool(np.random.default_rng([seed, 2]), at_m, yaw_deg, height_m=0.75)

    return _take_off_and_pitch(seed, 196, "carton", build)


def _take_off_and_pitch(seed: int, frame: int, target: str, build: Build) -> Stage:
    """What groups 4 and 5 have in common."""
    return _collision(
        seed,
        [stand(0.8), take_off(2.4, 0.95), pitch(0.5, -9.0), accelerate(9.0, -9.0)],
        start_m=(1.0, 0.0, 0.12),
        frame=frame,
        target=target,
        build=build,
        is_simple=True,
    )


def _collision(
    seed: int,
    script: Sequence[Phase],
    *,
    start_m: tuple[float, float, float],
    frame: int,
    target: str,
    build: Build,
    yaw_deg: float = 0.0,
    turned_deg: float = 0.0,
    is_simple: bool = False,
) -> Stage:
    """A flight with an obstacle in its way, and a room around both."""
    contact_s = frame * FRAME_S
    free = fly(script, position_m=start_m, yaw_deg=yaw_deg, seed=seed)
    obstacle = in_the_way(free, contact_s, build, target, turned_deg=turned_deg)
    place = _around(obstacle, np.random.default_rng([seed, frame]), is_simple)
    return Stage(
        world_of(place, obstacle),
        fly(script, position_m=start_m, yaw_deg=yaw_deg, seed=seed, contact_s=contact_s),
        target,
        contact_s,
        contact_s + AFTER_S,
    )


def _around(obstacle: Sequence[Body], rng: np.random.Generator, is_simple: bool) -> Place:
    """A room that ends some way behind an obstacle."""
    far_m = max(float(body.reach(np.array([[1.0, 0.0, 0.0]]))[0]) for body in obstacle)
    if is_simple:
        return simple_room(rng, length_m=far_m + 1.6, guests=obstacle)
    return cluttered_room(rng, length_m=far_m + 2.2, guests=obstacle)
