"""The closed loop: what an alarm at a time is worth to the drone of a flight.

The pilot reacts, and the drone brakes along its direction of flight. The path is followed to its
end through the room of the flight, with everything that moves in it.
"""

import math
from dataclasses import dataclass

import numpy as np

from dlgmd_cli.frame import FloatArray, Series
from dlgmd_cli.scenes.flights.drone import GRAVITY_M_S2, JERK_M_S3, MAX_LEAN
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage, State, Stretch
from dlgmd_cli.scenes.flights.truth import Nearest, contact_after, surroundings

REACT_S = 0.1
# Below this speed, a drone stands.
STANDING_M_S = 0.3
# A stop is for a real obstacle if the drone would have hit something within this time, straight on.
JUSTIFIED_S = 1.5
# Deceleration of a drone that tilts as far as the autopilot lets it.
LEANING_M_S2 = GRAVITY_M_S2 * math.tan(MAX_LEAN)
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
        Deceleration, from then on at once. None leaves it to the drone: at most `LEANING_M_S2`,
        at once if it is agile, else with limited jerk.
    agile : bool or None
        Whether the drone tilts instantly; None for that of the flight.
    """

    react_s: float = REACT_S
    brake_m_s2: float | None = None
    agile: bool | None = None

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
        most = self.brake_m_s2 or LEANING_M_S2
        at_once = self.brake_m_s2 is not None or (agile if self.agile is None else self.agile)
        # The deceleration grows until `full_s`, and is constant then.
        full_s = 0.0 if at_once else min(most / JERK_M_S3, math.sqrt(2.0 * speed / JERK_M_S3))
        left = max(speed - 0.5 * JERK_M_S3 * full_s**2, 0.0)
        stop_s = max(full_s + left / most, _STEP_S)
        times = np.linspace(0.0, stop_s, math.ceil(stop_s / _STEP_S) + 1)
        grows, steady = np.minimum(times, full_s), np.maximum(times - full_s, 0.0)
        speeds = speed - 0.5 * JERK_M_S3 * grows**2 - most * steady
        ways = speed * grows - JERK_M_S3 * grows**3 / 6.0 + left * steady - 0.5 * most * steady**2
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
        own = self.stage.path.state(time_s).velocity_m_s
        others = self._target.surfaces.velocities(time_s)
        return float(np.sqrt(((others - own) ** 2).sum(axis=-1)).max())

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
