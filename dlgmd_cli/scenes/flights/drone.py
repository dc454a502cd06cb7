"""A quadrotor that flies a script: a point mass with an attitude and thrust along its body z-axis.

An autopilot converts each phase of the script into commands (attitude, yaw rate, climb). The drone
follows them with the lags of its motors and attitude, drag, and gusts of wind. Unless it is agile,
commands are smoothed first, as on a stabilised camera drone.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Literal

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import FloatArray
from dlgmd_cli.scenes.flights.path import Path, Stretch

# Time until the propellers carry the weight.
SPIN_UP_S = 0.5


@dataclass(frozen=True)
class Phase:
    """A part of a flight with constant commands.

    Attributes
    ----------
    forward : str
        Control of the forward speed: "stand" on the floor, "hold" the position, "keep" the initial
        speed, "tilt" by `pitch_deg` regardless of the speed, or "brake" with `pitch_deg` and then
        hold the position.
    pitch_deg, roll_deg, yaw_rate_deg_s : float
        Positive for nose up, right side down, and counter-clockwise as seen from above. Without
        `roll_deg`, the drone banks so as not to slip sideways.
    climb_m : float
        Gain in height; the drone can climb at most about 1.4 (seconds - 0.5)² m.
    """

    name: str
    seconds: float
    forward: Literal["stand", "hold", "keep", "tilt", "brake"]
    pitch_deg: float = 0.0
    roll_deg: float | None = None
    yaw_rate_deg_s: float = 0.0
    climb_m: float = 0.0


# The phases of scripts. All begin with their duration; angles are in degrees.
PHASES: dict[str, Callable[..., Phase]] = {
    # Stand on the floor with the motors off; only before the first take-off.
    "stand": lambda seconds: Phase("stand", seconds, "stand"),
    # Climb, vertically or with a constant pitch. As the first phase or after "stand", the
    # propellers spin up before the drone leaves the floor.
    "take_off": lambda seconds, height_m, pitch=0.0: Phase(
        "take off", seconds, "tilt" if pitch else "hold", pitch, climb_m=height_m
    ),
    # Stop and hold the position.
    "hover": lambda seconds: Phase("hover", seconds, "hold"),
    # Pitch up (positive) or down (negative) and keep that angle.
    "pitch": lambda seconds, pitch: Phase("pitch", seconds, "tilt", pitch),
    # Accelerate with the nose down (a negative angle); drag limits the speed.
    "accelerate": lambda seconds, pitch: Phase("accelerate", seconds, "tilt", pitch),
    # Keep the initial forward speed, straight on or in a banked turn.
    "cruise": lambda seconds, rate=0.0: Phase("cruise", seconds, "keep", yaw_rate_deg_s=rate),
    # Brake with the nose up (a positive angle), then hold the position.
    "decelerate": lambda seconds, pitch: Phase("decelerate", seconds, "brake", pitch),
    # Turn about the vertical axis, on the spot or in a curve, at the initial forward speed or with
    # a constant pitch.
    "yaw": lambda seconds, rate, pitch=0.0: Phase(
        "yaw", seconds, "tilt" if pitch else "keep", pitch, yaw_rate_deg_s=rate
    ),
    # Do everything at once: change speed, roll, turn, and climb or sink.
    "weave": lambda seconds, pitch, roll, rate, climb_m: Phase(
        "weave", seconds, "tilt", pitch, roll, rate, climb_m
    ),
    # Roll right (positive) or left (negative) and slip sideways, keeping the forward speed.
    "roll": lambda seconds, roll: Phase("roll", seconds, "keep", roll_deg=roll),
}

STEP_S = 0.001
GRAVITY_M_S2 = 9.81
# Drag coefficient in 1/s: 12 degrees of pitch lead to about 6 m/s.
DRAG_1_S = 0.35
# For a drone of 0.3 to 0.5 m: natural frequency of its attitude (critically damped), and lags.
_ATTITUDE_RAD_S = 10.0
_YAW_LAG_S = 0.15
_MOTOR_LAG_S = 0.04
_MAX_THRUST_M_S2 = 2.5 * GRAVITY_M_S2

# Smoothing of commands. PX4 limits jerk, to 8 m/s³ under manual control (MPC_JERK_MAX; 4 in
# missions). Since the acceleration is g times the lean angle, the lean rate is at most jerk / g.
# PX4 also limits the yaw acceleration (MPC_YAWRAUTO_ACC). ArduPilot lets an angle approach its
# setpoint with a time constant (ATC_INPUT_TC: 0.15 s, or 0.1 s for a crisp response) and limits the
# angular acceleration: with 250 degrees/s², 10 degrees take about 0.4 s.
JERK_M_S3 = 8.0
_LEAN_RAD_S = JERK_M_S3 / GRAVITY_M_S2
_LEAN_RAD_S2 = math.radians(250.0)
_EASE_S = 0.1
_YAW_RAD_S2 = math.radians(60.0)

# Gains of the autopilot for speed and position, in 1/s.
_SPEED_GAIN, _PLACE_GAIN = 1.6, 0.7
_CLIMB_GAIN, _HEIGHT_GAIN = 6.0, 2.0
_HEADING_GAIN = 1.5
MAX_LEAN = math.radians(25.0)
# Below this speed the drone counts as stopped.
_SLOW_M_S = 0.1

# At contact, the drone rebounds with this share of its speed. The nose is thrown up in proportion
# to the speed, up to a maximum, and the drone backs off.
RESTITUTION = 0.25
_MAX_KICK_DEG, _KICK_DEG_PER_M_S = 12.0, 4.0
_BACK_OFF_M = 0.25

# Standard deviation and time constant, in s, of each disturbance in the order of a gust: wind
# along x, y and z in m/s²; roll and pitch in rad; yaw rate in rad/s. Together they shift a
# hovering drone by about a centimetre.
_DISTURBANCES = (
    (0.02, 0.8),
    (0.02, 0.8),
    (0.1, 0.8),
    (math.radians(0.25), 0.2),
    (math.radians(0.25), 0.2),
    (math.radians(1.0), 0.4),
)
_Gust = tuple[float, ...]
# Roll and pitch in rad, yaw rate in rad/s, and acceleration upwards in m/s².
_Commands = tuple[float, float, float, float]


def fly(
    script: Sequence[Phase],
    *,
    position_m: npt.ArrayLike,
    yaw_deg: float = 0.0,
    speed_m_s: float = 0.0,
    seed: int = 0,
    jitter: float = 1.0,
    contact_s: float | None = None,
    blow_m_s: npt.ArrayLike = (0.0, 0.0, 0.0),
    agile: bool = False,
) -> Path:
    """Simulate a flight; it begins on the floor if the first phase of the script does.

    Parameters
    ----------
    script : sequence of Phase
    position_m : array_like, shape (3,)
        Start position.
    yaw_deg, speed_m_s : float
        Initial heading and, if it starts in the air, forward speed.
    seed : int
        Seed of the disturbances. The same script and seed give the same flight to the last bit.
    jitter : float
        Factor on the disturbances; 0 is still air.
    contact_s : float, optional
        Time between 0 and the end at which the drone hits something. It rebounds, and then hovers
        near by in a phase called "collision" instead of following the script. Up to and including
        that time, the flight is the same as without contact.
    blow_m_s : array_like, shape (3,)
        Velocity of what it hits, or is hit by.
    agile : bool
        Whether commands are followed at once, as by a racing drone, instead of smoothed.
    """
    starts = list(accumulate((phase.seconds for phase in script), initial=0.0))
    duration = starts[-1]
    phases = [(phase.name, *ends) for phase, ends in zip(script, pairwise(starts), strict=True)]
    n_steps = math.ceil(duration / STEP_S) + 2
    gusts = _gusts(n_steps, seed, jitter)
    drone = _start(script[0], position_m, yaw_deg, speed_m_s)
    begins = {round(start / STEP_S): phase for start, phase in zip(starts, script, strict=False)}
    n_before = n_steps if contact_s is None else math.floor(contact_s / STEP_S) + 1
    pilot = _Pilot(drone, agile=agile)
    first = Stretch(0.0, STEP_S, _simulated(drone, pilot, begins, gusts[:n_before]))
    if contact_s is None:
        return Path((first,), tuple(phases))
    hold = _throw_back(drone, first, contact_s, np.asarray(blow_m_s, float), seed)
    pilot, hover = _Pilot(drone, hold, agile=agile), {0: PHASES["hover"](1.0)}
    after = Stretch(contact_s, STEP_S, _simulated(drone, pilot, hover, gusts[n_before:]))
    kept = [(name, start, min(end, contact_s)) for name, start, end in phases if start < contact_s]
    return Path((first, after), (*kept, ("collision", contact_s, duration)))


def _simulated(
    drone: "_Drone", pilot: "_Pilot", begins: Mapping[int, Phase], gusts: Sequence[_Gust]
) -> FloatArray:
    """Simulated samples, see `Stretch`; `begins` holds the phases by their first step."""
    samples = [drone.sample()]
    for step, gust in enumerate(gusts):
        if step in begins:
            pilot.begin(begins[step], drone, step * STEP_S)
        drone.advance(pilot.steer(drone, step * STEP_S), gust)
        samples.append(drone.sample())
    return np.array(samples)


def _gusts(n_steps: int, seed: int, strength: float) -> list[_Gust]:
    """Disturbances at each step: Ornstein-Uhlenbeck processes, the same in longer flights."""
    if strength == 0.0:
        return [(0.0,) * len(_DISTURBANCES)] * n_steps
    normal = np.random.default_rng(seed).standard_normal((n_steps, len(_DISTURBANCES)))
    channels = []
    for (deviation, memory_s), column in zip(_DISTURBANCES, normal.T.tolist(), strict=True):
        kept = math.exp(-STEP_S / memory_s)
        fresh = math.sqrt(1.0 - kept * kept)
        level, levels = column[0], []
        for number in column:
            levels.append(strength * deviation * level)
            level = kept * level + fresh * number
        channels.append(levels)
    return list(zip(*channels, strict=True))


@dataclass(slots=True)
class _Drone:
    """Position and velocity in the world, attitude, and thrust per mass; m, rad and s."""

    # Plain floats are fastest, since the simulation takes thousands of small steps.
    x: float
    y: float
    z: float
    vx: float = 0.0
    vy: float = 0.0
    vz: float = 0.0
    roll: float = 0.0
    pitch: float = 0.0
    yaw: float = 0.0
    roll_rate: float = 0.0
    pitch_rate: float = 0.0
    yaw_rate: float = 0.0
    thrust: float = 0.0
    stands: bool = False

    def sample(self) -> tuple[float, ...]:
        """Position, velocity, attitude and attitude rates, see `Stretch`."""
        place = self.x, self.y, self.z
        velocity = self.vx, self.vy, self.vz
        attitude = self.roll, self.pitch, self.yaw
        rates = self.roll_rate, self.pitch_rate, self.yaw_rate
        return place + velocity + attitude + rates

    def advance(self, commands: _Commands, gust: _Gust) -> None:
        """Advance by one time step."""
        to_roll, to_pitch, to_yaw_rate, to_lift = commands
        wind_x, wind_y, wind_z, sway, nod, swing = gust
        cr, sr = math.cos(self.roll), math.sin(self.roll)
        cp, sp = math.cos(self.pitch), math.sin(self.pitch)
        cy, sy = math.cos(self.yaw), math.sin(self.yaw)
        thrust = self.thrust
        goal = min(max((GRAVITY_M_S2 + to_lift) / (cp * cr), 0.0), _MAX_THRUST_M_S2)
        self.thrust += (goal - thrust) / _MOTOR_LAG_S * STEP_S
        ahead, left = -thrust * sp * cr, -thrust * sr
        lift = thrust * cp * cr - GRAVITY_M_S2
        if self.stands:
            if lift <= 0.0:
                return
            self.stands = False
        ax = cy * ahead - sy * left - DRAG_1_S * self.vx + wind_x
        ay = sy * ahead + cy * left - DRAG_1_S * self.vy + wind_y
        az = lift - DRAG_1_S * self.vz + wind_z
        self.x, self.vx = _integrated(self.x, self.vx, ax)
        self.y, self.vy = _integrated(self.y, self.vy, ay)
        self.z, self.vz = _integrated(self.z, self.vz, az)
        w = _ATTITUDE_RAD_S
        roll_pull = w * (w * (to_roll + sway - self.roll) - 2.0 * self.roll_rate)
        pitch_pull = w * (w * (to_pitch + nod - self.pitch) - 2.0 * self.pitch_rate)
        yaw_pull = (to_yaw_rate + swing - self.yaw_rate) / _YAW_LAG_S
        self.roll, self.roll_rate = _integrated(self.roll, self.roll_rate, roll_pull)
        self.pitch, self.pitch_rate = _integrated(self.pitch, self.pitch_rate, pitch_pull)
        self.yaw, self.yaw_rate = _integrated(self.yaw, self.yaw_rate, yaw_pull)


def _integrated(value: float, rate: float, pull: float) -> tuple[float, float]:
    """A value and its rate one step later, by the trapezoidal rule."""
    later = rate + pull * STEP_S
    return value + 0.5 * (rate + later) * STEP_S, later


def _start(first: Phase, position_m: npt.ArrayLike, yaw_deg: float, speed_m_s: float) -> _Drone:
    """The drone at time 0: on the floor, or in the air and trimmed for its speed."""
    x, y, z = (float(each) for each in np.asarray(position_m, float))
    yaw = math.radians(yaw_deg)
    if first.forward == "stand" or first.climb_m:
        return _Drone(x, y, z, yaw=yaw, stands=True)
    vx, vy = speed_m_s * math.cos(yaw), speed_m_s * math.sin(yaw)
    pitch = -math.atan2(DRAG_1_S * speed_m_s, GRAVITY_M_S2)
    return _Drone(x, y, z, vx, vy, pitch=pitch, yaw=yaw, thrust=GRAVITY_M_S2 / math.cos(pitch))


def _throw_back(
    drone: _Drone, before: Stretch, contact_s: float, blow_m_s: FloatArray, seed: int
) -> tuple[float, float]:
    """Throw the drone back at contact; returns where it then holds its position, (x, y)."""
    position, velocity, angles, rates = (part.tolist() for part in before.at(contact_s))
    velocity = [part - other for part, other in zip(velocity, blow_m_s.tolist(), strict=True)]
    drone.x, drone.y, drone.z = position
    drone.roll, drone.pitch, drone.yaw = angles
    speed = math.sqrt(sum(each * each for each in velocity))
    back = [-each / speed if speed else 0.0 for each in velocity]
    drone.vx, drone.vy, drone.vz = (RESTITUTION * speed * each for each in back)
    # A rate impulse w turns a critically damped attitude of frequency W by w / (e W) at most.
    kick = min(_MAX_KICK_DEG, _KICK_DEG_PER_M_S * speed) * _ATTITUDE_RAD_S * math.e
    aside, swing = np.random.default_rng([seed, 1]).uniform(-0.5, 0.5, 2).tolist()
    drone.roll_rate = rates[0] + math.radians(kick * aside)
    drone.pitch_rate = rates[1] + math.radians(kick)
    drone.yaw_rate = rates[2] + math.radians(kick * swing)
    return drone.x + _BACK_OFF_M * back[0], drone.y + _BACK_OFF_M * back[1]


class _EasedAngle:
    """An angle that follows its setpoint with limited rate and acceleration."""

    def __init__(self, angle: float) -> None:
        self._angle, self._rate = angle, 0.0

    def follow(self, goal: float) -> float:
        """The angle after one time step, in rad."""
        to_go = goal - self._angle
        gap, near = abs(to_go), _LEAN_RAD_S2 * _EASE_S**2
        # Near the setpoint exponential, farther away as fast as braking allows.
        fast = gap / _EASE_S if gap < near else math.sqrt(2.0 * _LEAN_RAD_S2 * (gap - near / 2.0))
        rate = math.copysign(min(fast, _LEAN_RAD_S), to_go)
        self._rate = _rate_limited(self._rate, rate, _LEAN_RAD_S2)
        self._angle += self._rate * STEP_S
        return self._angle


def _rate_limited(value: float, goal: float, rate: float) -> float:
    """`value` moved towards `goal` for one time step, at most at `rate`."""
    return value + min(max(goal - value, -rate * STEP_S), rate * STEP_S)


class _Pilot:
    """The autopilot; it holds the initially given position, (x, y), or else where it stopped."""

    def __init__(
        self, drone: _Drone, hold_m: tuple[float, float] | None = None, *, agile: bool
    ) -> None:
        self._eased = None if agile else (_EasedAngle(drone.roll), _EasedAngle(drone.pitch))
        self._turns = 0.0
        self._height = drone.z
        self._heading, self._heading_rate = drone.yaw, 0.0
        self._hold = hold_m

    def begin(self, phase: Phase, drone: _Drone, time_s: float) -> None:
        """Begin a phase."""
        self._phase = phase
        self._yaw_rate = math.radians(phase.yaw_rate_deg_s)
        self._pitch = math.radians(phase.pitch_deg)
        # A climb from the floor begins once the propellers carry the weight.
        wait = SPIN_UP_S if drone.stands else 0.0
        self._climb_start_s, self._climb_s = time_s + wait, phase.seconds - wait
        self._from_m = self._height
        self._height += phase.climb_m
        self._speed = math.cos(drone.yaw) * drone.vx + math.sin(drone.yaw) * drone.vy
        stays = abs(self._speed) < _SLOW_M_S and phase.roll_deg is None
        self._holds = phase.forward in ("hold", "brake") or (phase.forward == "keep" and stays)
        if not self._holds:
            self._hold = None

    def steer(self, drone: _Drone, time_s: float) -> _Commands:
        """The commands for the next time step."""
        cos, sin = math.cos(drone.yaw), math.sin(drone.yaw)
        ahead = cos * drone.vx + sin * drone.vy
        left = cos * drone.vy - sin * drone.vx
        most = MAX_LEAN
        if self._holds:
            ax, ay = self._stay(drone)
            forwards, leftwards = cos * ax + sin * ay, cos * ay - sin * ax
            if self._phase.forward == "brake" and self._hold is None:
                most = self._pitch
        else:
            forwards = _SPEED_GAIN * (self._speed - ahead) + DRAG_1_S * ahead
            # The first term is the centripetal acceleration.
            leftwards = drone.yaw_rate * ahead + (DRAG_1_S - _SPEED_GAIN) * left
        pitch = min(max(-math.atan2(forwards, GRAVITY_M_S2), -MAX_LEAN), most)
        if self._phase.forward == "tilt":
            pitch = self._pitch
        roll = min(max(-math.atan2(leftwards, GRAVITY_M_S2), -MAX_LEAN), MAX_LEAN)
        if self._phase.roll_deg is not None:
            roll = math.radians(self._phase.roll_deg)
        most_rad_s2 = math.inf
        if self._eased:
            roll, pitch = self._eased[0].follow(roll), self._eased[1].follow(pitch)
            most_rad_s2 = _YAW_RAD_S2
        self._turns = _rate_limited(self._turns, self._yaw_rate, most_rad_s2)
        # The heading of an undisturbed drone.
        was = self._heading_rate
        self._heading_rate += (self._turns - was) / _YAW_LAG_S * STEP_S
        yaw_rate = self._turns + _HEADING_GAIN * (self._heading - drone.yaw)
        self._heading += 0.5 * (was + self._heading_rate) * STEP_S
        return roll, pitch, yaw_rate, self._lift(drone, time_s)

    def _stay(self, drone: _Drone) -> tuple[float, float]:
        """Acceleration along x and y that stops the drone and then holds its position."""
        if self._hold is None and math.hypot(drone.vx, drone.vy) < _SLOW_M_S:
            self._hold = drone.x + drone.vx / _SPEED_GAIN, drone.y + drone.vy / _SPEED_GAIN
        to_x, to_y = self._hold or (drone.x, drone.y)
        return (
            _SPEED_GAIN * (_PLACE_GAIN * (to_x - drone.x) - drone.vx),
            _SPEED_GAIN * (_PLACE_GAIN * (to_y - drone.y) - drone.vy),
        )

    def _lift(self, drone: _Drone, time_s: float) -> float:
        """Vertical acceleration that holds the height, or climbs on a minimum-jerk trajectory."""
        if self._phase.forward == "stand":
            return -GRAVITY_M_S2
        height, speed, lift = self._height, 0.0, 0.0
        if self._phase.climb_m:
            start, seconds, climb = self._climb_start_s, self._climb_s, self._phase.climb_m
            if drone.stands and time_s < start:
                return GRAVITY_M_S2 * (time_s - start) / SPIN_UP_S
            s = min(max((time_s - start) / seconds, 0.0), 1.0)
            height = self._from_m + climb * (s**3 * (10.0 - 15.0 * s + 6.0 * s**2))
            speed = climb * (30.0 * s**2 * (1.0 - s) ** 2 / seconds)
            lift = climb * (60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / seconds**2)
        to_go = _HEIGHT_GAIN * (height - drone.z) + speed - drone.vz
        return lift + _CLIMB_GAIN * to_go + DRAG_1_S * drone.vz
