"""The closed loop: what an alarm at a time is worth to a drone, and its film."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from dlgmd_cli.frame import FloatArray, GreyImage, Series
from dlgmd_cli.scenes.flights.drone import GRAVITY_M_S2, JERK_M_S3, MAX_LEAN, RESTITUTION
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage, State, Stretch
from dlgmd_cli.scenes.flights.scenes import FilmCamera, FlightOptions, FlightScene
from dlgmd_cli.scenes.flights.truth import Nearest, contact_after, surroundings

REACT_S = 0.1
# Below this speed, a drone stands.
STANDING_M_S = 0.3
# A stop is for a real obstacle if the drone would have hit something within this time, straight on.
JUSTIFIED_S = 1.5
# How far a drone tilts as far as the autopilot lets it.
TILT_DEG = math.degrees(MAX_LEAN)
# Step at which a braking path is sampled, and the longest one in the search for contact if
# something moves.
_STEP_S, _LONGEST_S = 0.02, 0.02


@dataclass(frozen=True)
class Brakes:
    """How the pilot answers an alarm, and how the drone brakes.

    Attributes
    ----------
    react_s : float
        Time from the alarm to the first command; the flight goes on as it was.
    brake_m_s2 : float or None
        Deceleration, from then on at once. None leaves it to the drone: that of its tilt, at once
        if it is agile, else with limited jerk.
    agile : bool or None
        Whether the drone tilts instantly; None for that of the flight.
    tilt_deg, jerk_m_s3 : float
        How far the drone tilts, and how fast its deceleration grows, if it is not agile.
    """

    react_s: float = REACT_S
    brake_m_s2: float | None = None
    agile: bool | None = None
    tilt_deg: float = TILT_DEG
    jerk_m_s3: float = JERK_M_S3

    def path(self, start_s: float, state: State, agile: bool) -> Path:
        """The way from the first command to the stop, straight on."""
        velocity = state.velocity_m_s
        speed = float(np.linalg.norm(velocity))
        times, ways, speeds = self._stopping(speed, agile)
        towards = velocity / speed if speed else velocity
        places = state.position_m + np.outer(ways, towards)
        return _straight(start_s, float(times[-1]), places, np.outer(speeds, towards))

    def needed_s(self, speed_m_s: float, agile: bool = False) -> float:
        """The time to contact, in seconds, at which an alarm comes just in time for a stop.

        It is the way of the reaction and of the braking, over the speed. NaN for a drone that
        stands, at less than `STANDING_M_S`: no stop helps it.
        """
        if not speed_m_s >= STANDING_M_S:
            return math.nan
        return self.react_s + float(self._stopping(speed_m_s, agile)[1][-1]) / speed_m_s

    def _stopping(self, speed: float, agile: bool) -> tuple[Series, Series, Series]:
        """Times, ways and speeds from the first command to the stop, shape (n,) each."""
        most = self.brake_m_s2 or GRAVITY_M_S2 * math.tan(math.radians(self.tilt_deg))
        jerk = self.jerk_m_s3
        at_once = self.brake_m_s2 is not None or (agile if self.agile is None else self.agile)
        # The deceleration grows until `full_s`, and is constant then.
        full_s = 0.0 if at_once else min(most / jerk, math.sqrt(2.0 * speed / jerk))
        left = max(speed - 0.5 * jerk * full_s**2, 0.0)
        stop_s = max(full_s + left / most, _STEP_S)
        times = np.linspace(0.0, stop_s, math.ceil(stop_s / _STEP_S) + 1)
        grows, steady = np.minimum(times, full_s), np.maximum(times - full_s, 0.0)
        speeds = speed - 0.5 * jerk * grows**2 - most * steady
        ways = speed * grows - jerk * grows**3 / 6.0 + left * steady - 0.5 * most * steady**2
        return times, ways, speeds


@dataclass(frozen=True)
class Stop:
    """What came of a stop.

    Attributes
    ----------
    saved : bool
        Whether the drone stopped before it touched anything.
    impact_m_s : float
        Its speed at contact; NaN if it was saved.
    stopped_m : float
        Distance from its hull to the target after the stop; NaN if it was not saved.
    """

    saved: bool
    impact_m_s: float = math.nan
    stopped_m: float = math.nan


class Stoppable:
    """A flight in which the pilot may stop at any time.

    Attributes
    ----------
    speed_m_s : float
        Speed at contact, relative to the target; without a contact the median speed of the drone,
        or that of a target that moves.
    can_stop : bool
        Whether stopping helps: there is a contact, and it is the drone that moves.
    """

    def __init__(self, stage: Stage) -> None:
        self.stage = stage
        self._around, self._target = surroundings(stage.world), Nearest(stage.targets)
        moves = any(body.motion is not None for body in stage.targets)
        self._longest_s = _LONGEST_S if any(b.motion for b in stage.world.bodies) else math.inf
        self.can_stop = stage.contact_s is not None and not moves
        if stage.contact_s is not None:
            self.speed_m_s = self._speed(stage.contact_s - _STEP_S)
        else:
            times = np.arange(0.0, stage.duration_s, 0.1).tolist()
            speeds = [self._speed(time_s) for time_s in times]
            self.speed_m_s = float(max(speeds) if moves else np.median(speeds))

    def _speed(self, time_s: float) -> float:
        """The greatest speed of a part of the target relative to the drone."""
        velocity = self.stage.path.state(time_s).velocity_m_s
        others = self._target.surfaces.velocities(time_s)
        return float(np.sqrt(((others - velocity) ** 2).sum(axis=-1)).max())

    def needed_s(self, time_s: float, brakes: Brakes) -> float:
        """`Brakes.needed_s` at the drone's own speed at a time."""
        speed = float(np.linalg.norm(self.stage.path.state(time_s).velocity_m_s))
        return brakes.needed_s(speed, self.stage.agile)

    def way(self, alarm_s: float, brakes: Brakes) -> tuple[Path, float | None] | None:
        """The braking path, and when it touches something; None if the collision comes first."""
        command_s, contact_s = alarm_s + brakes.react_s, self.stage.contact_s
        if contact_s is not None and command_s >= contact_s:
            return None
        path = brakes.path(command_s, self.stage.path.state(command_s), self.stage.agile)
        return path, contact_after(path, self._around, command_s, self._longest_s)

    def stop(self, alarm_s: float, brakes: Brakes) -> Stop:
        """What comes of an alarm at a time, which is before the contact if there is one."""
        way, contact_s = self.way(alarm_s, brakes), self.stage.contact_s
        if way is None:
            assert contact_s is not None
            return Stop(False, self._speed(contact_s - _STEP_S))
        path, hit_s = way
        if hit_s is not None:
            return Stop(False, float(np.linalg.norm(path.state(hit_s).velocity_m_s)))
        end = path.state(path.duration_s).position_m
        left = float(self._target.distances(end, path.duration_s).min()) - REACH_M
        return Stop(True, stopped_m=left)

    def is_justified(self, alarm_s: float) -> bool:
        """Whether the drone would have hit something soon if it had flown straight on."""
        state = self.stage.path.state(alarm_s)
        places = state.position_m + np.outer([0.0, JUSTIFIED_S], state.velocity_m_s)
        path = _straight(alarm_s, JUSTIFIED_S, places, np.stack([state.velocity_m_s] * 2))
        return contact_after(path, self._around, alarm_s, self._longest_s) is not None


def _straight(start_s: float, seconds: float, places_m: FloatArray, speeds_m_s: FloatArray) -> Path:
    """A path over positions and velocities, (n, 3), at even times."""
    samples = np.hstack([places_m, speeds_m_s, np.zeros((len(places_m), 6))])
    stretch = Stretch(start_s, seconds / (len(places_m) - 1), samples)
    return Path((stretch,), (("straight", start_s, start_s + seconds),))


# Time filmed after the stop, and after a contact; step of the path.
_STANDS_S, _AFTER_S, _FINE_STEP_S = 1.0, 0.5, 0.005
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
    n_braking, n_after = (max(2, math.ceil(s / _FINE_STEP_S)) for s in (end_s - command_s, tail_s))
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
