"""The path of a flight, and its stage: the path with the world around it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights.camera import Pose, rotation
from dlgmd_cli.scenes.flights.solids import Body, Solid, World

# Distance from the camera to the drone's hull: contact is at this distance.
REACH_M = 0.1
# Tolerance for rounding in times.
_SAME_S = 1e-9
# Waves in the shake of a camera about each axis.
_N_WAVES = 8


@dataclass(frozen=True)
class State:
    """State of the drone at an instant.

    For the angles, see `rotation`; yaw exceeds 360 after a full turn. The angular velocity, (3,),
    is in world coordinates.
    """

    position_m: FloatArray
    velocity_m_s: FloatArray
    roll_deg: float
    pitch_deg: float
    yaw_deg: float
    angular_velocity_rad_s: FloatArray

    @cached_property
    def pose(self) -> Pose:
        """Position and attitude of the camera."""
        return Pose(self.position_m, rotation(self.roll_deg, self.pitch_deg, self.yaw_deg))


@dataclass(frozen=True)
class Stretch:
    """A smooth part of a flight, sampled every `step_s` seconds.

    Each of the samples, (n, 12), holds position, velocity, roll, pitch and yaw, and the rates of
    these angles, in m, rad and s.
    """

    start_s: float
    step_s: float
    samples: FloatArray

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Position, velocity, attitude and attitude rates, by cubic Hermite interpolation.

        The velocity and the rates are the exact derivatives of the other two.
        """
        steps = (time_s - self.start_s) / self.step_s
        index = min(max(math.floor(steps), 0), len(self.samples) - 2)
        s, h = steps - index, self.step_s
        t = 1.0 - s
        before, after = self.samples[index : index + 2].reshape(2, 2, 2, 3)
        (value0, slope0), (value1, slope1) = before.swapaxes(0, 1), after.swapaxes(0, 1)
        rise = value1 - value0
        value = value0 + s * s * (3.0 - 2.0 * s) * rise + h * s * t * (t * slope0 - s * slope1)
        slope = 6.0 * s * t / h * rise + t * (1.0 - 3.0 * s) * slope0 + s * (3.0 * s - 2.0) * slope1
        return value[0], slope[0], value[1], slope[1]


@dataclass(frozen=True)
class Path:
    """The path of a drone.

    Each stretch is valid up to and including the start of the next. Phases are tuples of name,
    start and end, in s, without gaps.
    """

    stretches: Sequence[Stretch]
    phases: tuple[tuple[str, float, float], ...]

    @property
    def duration_s(self) -> float:
        """Duration of the flight."""
        return self.phases[-1][2]

    def phase(self, time_s: float) -> str:
        """Name of the phase at a time from 0 on; at a boundary, that of the later one."""
        return [name for name, start, _ in self.phases if start <= time_s + _SAME_S][-1]

    def state(self, time_s: float) -> State:
        """State of the drone; at the time of contact, the state just before it.

        Before the start and after the end, it is the first and the last state, since an exposure
        may extend a little beyond the flight.
        """
        position, velocity, angles, rates = self.at(time_s)
        _, pitch, yaw = angles
        cos, sin = math.cos(yaw), math.sin(yaw)
        about_nose = np.array([math.cos(pitch) * cos, math.cos(pitch) * sin, math.sin(pitch)])
        spin = about_nose * rates[0] + np.array([sin, -cos, 0.0]) * rates[1]
        spin[2] += rates[2]
        roll_deg, pitch_deg, yaw_deg = map(math.degrees, angles.tolist())
        return State(position, velocity, roll_deg, pitch_deg, yaw_deg, spin)

    def at(self, time_s: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """The same as position, velocity, attitude and attitude rates, see `Stretch.at`."""
        time = min(max(time_s, 0.0), self.duration_s)
        begun = [stretch for stretch in self.stretches if stretch.start_s < time - _SAME_S]
        return (begun or self.stretches[:1])[-1].at(time)

    def pose(self, time_s: float) -> Pose:
        """Position and attitude of the camera; see `state`."""
        return self.state(time_s).pose


def shaken(path: Path, rng: np.random.Generator, shake: Mapping[str, Any]) -> Path:
    """The path of a camera that shakes, and bobs with the steps of who carries it.

    Parameters
    ----------
    path : Path
        The path of what carries the camera.
    rng : Generator
        Draws the frequencies and phases. The same ones shake a flight with and without contact in
        the same way.
    shake : mapping
        `shake_deg_s` is the root mean square of the added rate of roll, pitch and yaw. Each is a
        sum of sine waves with equal amplitudes of the rate, between the two frequencies in Hz of
        `shake_hz`. `bob_m` is the amplitude of the height, at `step_hz` steps per second, and half
        of it sideways, along y, at half of the frequency.
    """
    low, high = shake["shake_hz"]
    pulses = 2.0 * np.pi * low * (high / low) ** rng.random((_N_WAVES, 3))
    phases = rng.uniform(0.0, 2.0 * np.pi, (_N_WAVES, 3))
    rate = math.radians(shake["shake_deg_s"]) * math.sqrt(2.0 / _N_WAVES)
    step, bob_m = 2.0 * np.pi * shake["step_hz"], shake["bob_m"]
    stretches = []
    for stretch in path.stretches:
        times = stretch.start_s + stretch.step_s * np.arange(len(stretch.samples))
        samples = stretch.samples.copy()
        for axis, amplitude, pulse in ((1, bob_m / 2.0, step / 2.0), (2, bob_m, step)):
            samples[:, axis] += amplitude * np.sin(pulse * times)
            samples[:, 3 + axis] += amplitude * pulse * np.cos(pulse * times)
        waves = times[:, None, None] * pulses + phases
        samples[:, 6:9] += (rate / pulses * np.sin(waves)).sum(axis=1)
        samples[:, 9:] += rate * np.cos(waves).sum(axis=1)
        stretches.append(replace(stretch, samples=samples))
    return replace(path, stretches=tuple(stretches))


@dataclass(frozen=True)
class Stage:
    """A world, and a flight through it.

    Attributes
    ----------
    target : str
        Name of the target; all bodies of that name together are the target.
    wall : Solid or None
        The target if it is a side of the room.
    contact_s : float or None
        Time at which the drone hits something.
    duration_s : float
        Duration of the filmed part of the flight.
    agile : bool
        Whether the drone follows commands at once; see `fly`.
    manner : str
        Scenario of a random flight, see `manners.yaml`.
    """

    world: World
    path: Path
    target: str
    contact_s: float | None
    duration_s: float
    agile: bool = False
    wall: Solid | None = None
    manner: str = ""

    @property
    def targets(self) -> list[Body]:
        """The bodies, or the wall, that are the target."""
        if self.wall is not None:
            return [self.wall]
        return [body for body in self.world.bodies if body.name == self.target]
