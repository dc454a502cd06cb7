"""A flight whose pilot can brake while it is filmed: the loop from frame to alarm to drone."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dlgmd_cli.frame import FloatArray, GreyImage
from dlgmd_cli.scenes.flights.braking import Brakes, Stop, Stoppable
from dlgmd_cli.scenes.flights.drone import GRAVITY_M_S2, RESTITUTION
from dlgmd_cli.scenes.flights.path import Path, Stage, Stretch
from dlgmd_cli.scenes.flights.scenes import FilmCamera, FlightOptions, FlightScene

# Time filmed after the stop, and after a contact; step of the path.
_STANDS_S, _AFTER_S, _STEP_S = 1.0, 0.5, 0.005
# The attitude follows with this natural frequency, as that of the drone does. After a contact, the
# drone backs off so far.
_ATTITUDE_RAD_S, _BACK_OFF_M = 10.0, 0.25


@dataclass(frozen=True)
class Braked:
    """A stop: when the alarm was raised, and what came of it.

    Attributes
    ----------
    alarm_s : float
    stop : Stop
        `saved` is only of interest where there would have been a collision.
    justified : bool
        Whether the drone would have hit something within 1.5 s, straight on.
    """

    alarm_s: float
    stop: Stop
    justified: bool


class FlightInLoop:
    """The frames of a flight, one by one; `brake` between two of them changes the flight.

    Parameters
    ----------
    scene, options : FlightScene, FlightOptions
    brakes : Brakes
        How fast the pilot reacts, and how the drone brakes.

    Attributes
    ----------
    fps : float
    time_s : float
        Time of the latest frame.
    speed_m_s : float
        See `Stoppable`.
    stage : Stage
        The flight as it is flown now.
    braked : Braked or None
        The stop, once there is one.
    """

    def __init__(self, scene: FlightScene, options: FlightOptions, brakes: Brakes) -> None:
        self.stage = scene.stage(options)
        self.time_s = 0.0
        self.braked: Braked | None = None
        self.fps, self._n_frames = options.fps, scene.n_frames(options)
        self._camera, self._brakes = FilmCamera(self.stage, options), brakes
        self._flight = Stoppable(self.stage)
        self.speed_m_s = self._flight.speed_m_s

    def __iter__(self) -> Iterator[GreyImage]:
        """The frames, (H, W) uint8, up to the end of the flight as it is then."""
        index = 0
        while index < self._n_frames:
            self.time_s = index / self.fps
            yield self._camera.frame(index, self.stage.path)
            index += 1

    def brake(self) -> None:
        """Answer an alarm at the latest frame; later calls, and those after contact, do nothing."""
        contact_s = self.stage.contact_s
        if self.braked is not None or (contact_s is not None and self.time_s >= contact_s):
            return
        stop = self._flight.stop(self.time_s, self._brakes)
        self.braked = Braked(self.time_s, stop, self._flight.is_justified(self.time_s))
        way = self._flight.way(self.time_s, self._brakes)
        if way is not None:
            self.stage = _stopped(self.stage, *way)
            self._n_frames = math.floor(self.stage.duration_s * self.fps + 1e-6) + 1


def _stopped(stage: Stage, way: Path, hit_s: float | None) -> Stage:
    """The flight with a braking path from its start on; the drone tilts as it brakes."""
    command_s = way.stretches[0].start_s
    end_s = way.duration_s if hit_s is None else hit_s
    tail_s = _STANDS_S if hit_s is None else _AFTER_S
    n_braking, n_after = (max(2, math.ceil(s / _STEP_S)) for s in (end_s - command_s, tail_s))
    brakes_s = np.linspace(command_s, end_s, n_braking)
    places, speeds = np.array([way.at(time_s)[:2] for time_s in brakes_s.tolist()]).swapaxes(0, 1)
    # Lean against the direction of flight, which gives the deceleration.
    _, _, angles, rates = stage.path.at(command_s)
    leans = -np.gradient(speeds, brakes_s, axis=0) / GRAVITY_M_S2
    cos, sin = math.cos(angles[2]), math.sin(angles[2])
    pitches, rolls = np.arctan(leans @ [cos, sin, 0.0]), np.arctan(leans @ [-sin, cos, 0.0])
    goals = np.stack([rolls, pitches, np.full(n_braking, angles[2])], axis=1)
    step_s = (end_s - command_s) / (n_braking - 1)
    after = _followed(goals, angles, rates, step_s)
    first = Stretch(command_s, step_s, np.hstack([places, speeds, after]))
    last = _standing(first, end_s, tail_s, n_after, backwards=hit_s is not None)
    earlier = [stretch for stretch in stage.path.stretches if stretch.start_s < command_s]
    phases = [(name, a, min(b, command_s)) for name, a, b in stage.path.phases if a < command_s]
    last_phase = "hover" if hit_s is None else "collision"
    phases += [("brake", command_s, end_s), (last_phase, end_s, end_s + tail_s)]
    path = Path((*earlier, first, last), tuple(phases))
    return replace(stage, path=path, contact_s=hit_s, duration_s=end_s + tail_s)


def _standing(
    before: Stretch, start_s: float, seconds: float, n: int, *, backwards: bool
) -> Stretch:
    """The drone levels out and stands, or, after a contact, backs off a little."""
    times = np.linspace(0.0, seconds, n)
    place, velocity = before.samples[-1, :3], before.samples[-1, 3:6]
    speed = float(np.linalg.norm(velocity))
    away = -velocity / speed if speed and backwards else np.zeros(3)
    rate = RESTITUTION * speed / _BACK_OFF_M
    gone = _BACK_OFF_M * (1.0 - np.exp(-rate * times))
    paces = RESTITUTION * speed * np.exp(-rate * times)
    level = np.tile([0.0, 0.0, before.samples[-1, 8]], (n, 1))
    turned = _followed(level, before.samples[-1, 6:9], before.samples[-1, 9:], seconds / (n - 1))
    samples = np.hstack([place + np.outer(gone, away), np.outer(paces, away), turned])
    return Stretch(start_s, seconds / (n - 1), samples)


def _followed(
    goals: FloatArray, angles: FloatArray, rates: FloatArray, step_s: float
) -> FloatArray:
    """Angles and their rates, (n, 6) in rad, that follow goals as a critically damped attitude."""
    w, samples = _ATTITUDE_RAD_S, []
    for goal in goals:
        samples.append(np.concatenate([angles, rates]))
        rates = rates + step_s * w * (w * (goal - angles) - 2.0 * rates)
        angles = angles + step_s * rates
    return np.array(samples)
