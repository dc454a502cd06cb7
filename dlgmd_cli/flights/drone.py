"""A quadrotor that flies a script: a point mass with an attitude, and thrust along its own up.

An autopilot turns what each phase of the script commands into orders (attitude, yaw rate, climb);
the drone follows them with the lags of its motors and attitude, drag, and gusts of wind. As on a
stabilised camera drone, orders are eased before they are followed, unless the drone is agile.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.path import Path, Stretch
from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.script import SPIN_UP_S, Phase, hover

STEP_S = 0.001
GRAVITY_M_S2 = 9.81
# Speed lost to the air, in 1/s: 12 degrees of pitch lead to about 6 m/s.
DRAG_1_S = 0.35
# Of a drone of 0.3 to 0.5 m: how fast its attitude follows, critically damped, and its lags.
_ATTITUDE_RAD_S = 10.0
_YAW_LAG_S = 0.15
_MOTOR_LAG_S = 0.04
_MAX_THRUST_M_S2 = 2.5 * GRAVITY_M_S2

# How orders are eased. PX4 limits jerk, to 8 m/s³ where a pilot flies (MPC_JERK_MAX; missions have
# 4): a drone that leans by an angle gains g times that, so it leans at jerk / g at most. It limits
# the acceleration of yaw, too (MPC_YAWRAUTO_ACC). ArduPilot lets an angle approach what is asked
# with a time constant (ATC_INPUT_TC: 0.15 s, crisp ones 0.1 s) and limits its acceleration; with
# 250 degrees/s², 10 degrees take about 0.4 s.
_LEAN_RAD_S = 8.0 / GRAVITY_M_S2
_LEAN_RAD_S2 = math.radians(250.0)
_EASE_S = 0.1
_YAW_RAD_S2 = math.radians(60.0)

# How fast the autopilot corrects speed and position, in 1/s.
_SPEED_GAIN, _PLACE_GAIN = 1.6, 0.7
_CLIMB_GAIN, _HEIGHT_GAIN = 6.0, 2.0
_HEADING_GAIN = 1.5
_MAX_LEAN = math.radians(25.0)
# Below this speed it counts as stopped when it is to hold a position.
_SLOW_M_S = 0.1

# A blow leaves this share of the speed, backwards. It throws the nose up by an angle for each m/s
# of speed, up to the greatest one, and the drone backs off.
RESTITUTION = 0.25
_MAX_KICK_DEG, _KICK_DEG_PER_M_S = 12.0, 4.0
_BACK_OFF_M = 0.25

# Standard deviation and time constant, in s, of each disturbance in the order of a gust: wind
# along x, y and z in m/s²; roll and pitch in rad; yaw rate in rad/s. Together they shift a
# hovering drone by about a centimetre.
_DISTURBANCES = (
    *((0.02, 0.8), (0.02, 0.8), (0.1, 0.8)),
    *((math.radians(0.25), 0.2), (math.radians(0.25), 0.2), (math.radians(1.0), 0.4)),
)
_Gust = tuple[float, ...]


def fly(
    script: Sequence[Phase],
    *,
    position_m: npt.ArrayLike,
    yaw_deg: float = 0.0,
    speed_m_s: float = 0.0,
    seed: int = 0,
    jitter: float = 1.0,
    contact_s: float | None = None,
    agile: bool = False,
) -> Path:
    """Fly a script, which begins on the floor if its first phase does, else in the air.

    Parameters
    ----------
    script : sequence of Phase
    position_m : array_like, shape (3,)
        Where it starts.
    yaw_deg, speed_m_s : float
        Where its nose points at first, and how fast it flies that way, if it is in the air.
    seed : int
        Of the disturbances. The same script and seed are the same flight to the last bit.
    jitter : float
        Factor on the disturbances; 0 is still air.
    contact_s : float, optional
        Time above 0 at which it hits something. It is thrown back, and hovers near by instead of
        following the script, as a phase called "collision". Up to and including that time, the
        flight is the same as without contact. A time at or after the end changes nothing.
    agile : bool
        Whether orders are followed at once, as a racing drone does, instead of eased.
    """
    starts = [0.0]
    for each in script:
        starts.append(starts[-1] + each.seconds)
    duration = starts[-1]
    phases = tuple(
        (phase.name, start, end)
        for phase, start, end in zip(script, starts[:-1], starts[1:], strict=True)
    )
    n_steps = math.ceil(duration / STEP_S) + 2
    gusts = _gusts(n_steps, seed, jitter)
    drone = _start(script[0], position_m, yaw_deg, speed_m_s)
    begins = {round(start / STEP_S): phase for start, phase in zip(starts, script, strict=False)}
    if contact_s is not None and contact_s >= duration:
        contact_s = None
    n_before = n_steps if contact_s is None else math.floor(contact_s / STEP_S) + 1
    pilot = _Pilot(drone, agile=agile)
    first = Stretch(0.0, STEP_S, _simulated(drone, pilot, begins, gusts[:n_before]))
    if contact_s is None:
        return Path((first,), phases)
    after = _rebound(first, drone, contact_s, gusts[n_before:], seed, agile=agile)
    kept = [(name, start, min(end, contact_s)) for name, start, end in phases if start < contact_s]
    return Path((first, after), (*kept, ("collision", contact_s, duration)))


def _simulated(
    drone: "_Drone", pilot: "_Pilot", begins: Mapping[int, Phase], gusts: Sequence[_Gust]
) -> FloatArray:
    """Samples of a flight, as `Stretch` has them; `begins` holds the phases by their first step."""
    samples = [drone.sample()]
    for step, gust in enumerate(gusts):
        if step in begins:
            pilot.begin(begins[step], drone, step * STEP_S)
        drone.advance(pilot.steer(drone, step * STEP_S), gust)
        samples.append(drone.sample())
    return np.array(samples)


def _gusts(n_steps: int, seed: int, strength: float) -> list[_Gust]:
    """Disturbances at each step: Ornstein-Uhlenbeck processes, from their usual level on.

    A longer flight begins with the disturbances of a shorter one.
    """
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


class _Orders(NamedTuple):
    """Roll and pitch in rad, yaw rate in rad/s, and acceleration upwards in m/s²."""

    roll: float
    pitch: float
    yaw_rate: float
    lift: float


@dataclass(slots=True)
class _Drone:
    """Position and velocity in the world, attitude, and thrust per mass; m, rad and s.

    Plain numbers, since the simulation takes thousands of small steps.
    """

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
        """Position, velocity, attitude and its rates, as `Stretch` keeps them."""
        return (
            *(self.x, self.y, self.z),
            *(self.vx, self.vy, self.vz),
            *(self.roll, self.pitch, self.yaw),
            *(self.roll_rate, self.pitch_rate, self.yaw_rate),
        )

    def advance(self, orders: _Orders, gust: _Gust) -> None:
        """Let a step of time pass."""
        wind_x, wind_y, wind_z, sway, nod, swing = gust
        cr, sr = math.cos(self.roll), math.sin(self.roll)
        cp, sp = math.cos(self.pitch), math.sin(self.pitch)
        cy, sy = math.cos(self.yaw), math.sin(self.yaw)
        thrust = self.thrust
        asked = min(max((GRAVITY_M_S2 + orders.lift) / (cp * cr), 0.0), _MAX_THRUST_M_S2)
        self.thrust += (asked - thrust) / _MOTOR_LAG_S * STEP_S
        ahead, left = -thrust * sp * cr, -thrust * sr
        lift = thrust * cp * cr - GRAVITY_M_S2
        if self.stands:
            if lift <= 0.0:
                return
            self.stands = False
        ax = cy * ahead - sy * left - DRAG_1_S * self.vx + wind_x
        ay = sy * ahead + cy * left - DRAG_1_S * self.vy + wind_y
        az = lift - DRAG_1_S * self.vz + wind_z
        self.x, self.vx = _moved(self.x, self.vx, ax)
        self.y, self.vy = _moved(self.y, self.vy, ay)
        self.z, self.vz = _moved(self.z, self.vz, az)
        w = _ATTITUDE_RAD_S
        roll_pull = w * (w * (orders.roll + sway - self.roll) - 2.0 * self.roll_rate)
        pitch_pull = w * (w * (orders.pitch + nod - self.pitch) - 2.0 * self.pitch_rate)
        yaw_pull = (orders.yaw_rate + swing - self.yaw_rate) / _YAW_LAG_S
        self.roll, self.roll_rate = _moved(self.roll, self.roll_rate, roll_pull)
        self.pitch, self.pitch_rate = _moved(self.pitch, self.pitch_rate, pitch_pull)
        self.yaw, self.yaw_rate = _moved(self.yaw, self.yaw_rate, yaw_pull)


def _moved(value: float, rate: float, pull: float) -> tuple[float, float]:
    """A value and its rate a step later; the mean rate makes them agree along the path."""
    later = rate + pull * STEP_S
    return value + 0.5 * (rate + later) * STEP_S, later


def _start(first: Phase, position_m: npt.ArrayLike, yaw_deg: float, speed_m_s: float) -> _Drone:
    """The drone at time 0: on the floor, or in the air and balanced for its speed."""
    x, y, z = (float(each) for each in np.asarray(position_m, float))
    yaw = math.radians(yaw_deg)
    if first.forward == "stand" or first.climb_m:
        return _Drone(x, y, z, yaw=yaw, stands=True)
    vx, vy = speed_m_s * math.cos(yaw), speed_m_s * math.sin(yaw)
    pitch = -math.atan2(DRAG_1_S * speed_m_s, GRAVITY_M_S2)
    thrust = GRAVITY_M_S2 / math.cos(pitch)
    return _Drone(x, y, z, vx, vy, pitch=pitch, yaw=yaw, thrust=thrust)


def _rebound(
    before: Stretch,
    drone: _Drone,
    contact_s: float,
    gusts: Sequence[_Gust],
    seed: int,
    *,
    agile: bool,
) -> Stretch:
    """The flight after a blow at `contact_s`, with the gusts from then on."""
    position, velocity, angles, rates = (part.tolist() for part in before.at(contact_s))
    drone.x, drone.y, drone.z = position
    drone.roll, drone.pitch, drone.yaw = angles
    speed = math.sqrt(sum(each * each for each in velocity))
    back = [-each / speed if speed else 0.0 for each in velocity]
    drone.vx, drone.vy, drone.vz = (RESTITUTION * speed * each for each in back)
    # A kick of the rate by w turns a critically damped attitude by w / (e W) at most.
    kick = min(_MAX_KICK_DEG, _KICK_DEG_PER_M_S * speed) * _ATTITUDE_RAD_S * math.e
    aside, swing = np.random.default_rng([seed, 1]).uniform(-0.5, 0.5, 2).tolist()
    drone.roll_rate = rates[0] + math.radians(kick * aside)
    drone.pitch_rate = rates[1] + math.radians(kick)
    drone.yaw_rate = rates[2] + math.radians(kick * swing)
    hold = drone.x + _BACK_OFF_M * back[0], drone.y + _BACK_OFF_M * back[1]
    samples = _simulated(drone, _Pilot(drone, hold, agile=agile), {0: hover(1.0)}, gusts)
    return Stretch(contact_s, STEP_S, samples)


class _Lean:
    """An angle that follows what is asked for with a limited rate and angular acceleration.

    Near its goal it approaches exponentially; from farther away, as fast as it can still stop.
    """

    def __init__(self, angle: float) -> None:
        self._angle, self._rate = angle, 0.0

    def follow(self, goal: float) -> float:
        """The angle after a step of time, in rad."""
        to_go = goal - self._angle
        gap, near = abs(to_go), _LEAN_RAD_S2 * _EASE_S**2
        fast = gap / _EASE_S if gap < near else math.sqrt(2.0 * _LEAN_RAD_S2 * (gap - near / 2.0))
        rate = math.copysign(min(fast, _LEAN_RAD_S), to_go)
        self._rate = _towards(self._rate, rate, _LEAN_RAD_S2)
        self._angle += self._rate * STEP_S
        return self._angle


def _towards(value: float, goal: float, rate: float) -> float:
    """A value a step of time later on its way to a goal, at a rate at most."""
    return value + min(max(goal - value, -rate * STEP_S), rate * STEP_S)


class _Pilot:
    """The autopilot, which flies one phase after the other.

    It holds a given position, (x, y), at first, or the one where the drone stops.
    """

    def __init__(
        self, drone: _Drone, hold_m: tuple[float, float] | None = None, *, agile: bool
    ) -> None:
        self._eased = None if agile else (_Lean(drone.roll), _Lean(drone.pitch))
        self._turns = 0.0
        self._height = drone.z
        self._heading, self._heading_rate = drone.yaw, 0.0
        self._hold = hold_m

    def begin(self, phase: Phase, drone: _Drone, time_s: float) -> None:
        """Take up a phase."""
        self._phase = phase
        self._yaw_rate = math.radians(phase.yaw_rate_deg_s)
        self._pitch = math.radians(phase.pitch_deg)
        # A climb from the floor begins when the propellers carry the weight.
        wait = SPIN_UP_S if drone.stands else 0.0
        self._climb_start_s, self._climb_s = time_s + wait, phase.seconds - wait
        self._from_m = self._height
        self._height += phase.climb_m
        self._speed = math.cos(drone.yaw) * drone.vx + math.sin(drone.yaw) * drone.vy
        stays = abs(self._speed) < _SLOW_M_S and phase.roll_deg is None
        self._holds = phase.forward in ("hold", "brake") or (phase.forward == "keep" and stays)
        if not self._holds:
            self._hold = None

    def steer(self, drone: _Drone, time_s: float) -> _Orders:
        """What to do now, for a step of time."""
        cos, sin = math.cos(drone.yaw), math.sin(drone.yaw)
        ahead = cos * drone.vx + sin * drone.vy
        left = cos * drone.vy - sin * drone.vx
        most = _MAX_LEAN
        if self._holds:
            ax, ay = self._stay(drone)
            forwards, leftwards = cos * ax + sin * ay, cos * ay - sin * ax
            if self._phase.forward == "brake" and self._hold is None:
                most = self._pitch
        else:
            forwards = _SPEED_GAIN * (self._speed - ahead) + DRAG_1_S * ahead
            # The first term is what a curve takes.
            leftwards = drone.yaw_rate * ahead + (DRAG_1_S - _SPEED_GAIN) * left
        pitch = min(max(-math.atan2(forwards, GRAVITY_M_S2), -_MAX_LEAN), most)
        if self._phase.forward == "tilt":
            pitch = self._pitch
        roll = min(max(-math.atan2(leftwards, GRAVITY_M_S2), -_MAX_LEAN), _MAX_LEAN)
        if self._phase.roll_deg is not None:
            roll = math.radians(self._phase.roll_deg)
        if self._eased:
            roll, pitch = self._eased[0].follow(roll), self._eased[1].follow(pitch)
        return _Orders(roll, pitch, self._turn(drone), self._lift(drone, time_s))

    def _stay(self, drone: _Drone) -> tuple[float, float]:
        """Acceleration along x and y that stops the drone, and then keeps it where it is."""
        if self._hold is None and math.hypot(drone.vx, drone.vy) < _SLOW_M_S:
            self._hold = drone.x + drone.vx / _SPEED_GAIN, drone.y + drone.vy / _SPEED_GAIN
        to_x, to_y = self._hold or (drone.x, drone.y)
        return (
            _SPEED_GAIN * (_PLACE_GAIN * (to_x - drone.x) - drone.vx),
            _SPEED_GAIN * (_PLACE_GAIN * (to_y - drone.y) - drone.vy),
        )

    def _turn(self, drone: _Drone) -> float:
        """Yaw rate that follows the heading of a drone that nothing disturbs."""
        eases = self._eased is not None
        self._turns = _towards(self._turns, self._yaw_rate, _YAW_RAD_S2 if eases else math.inf)
        was = self._heading_rate
        self._heading_rate += (self._turns - was) / _YAW_LAG_S * STEP_S
        wanted = self._turns + _HEADING_GAIN * (self._heading - drone.yaw)
        self._heading += 0.5 * (was + self._heading_rate) * STEP_S
        return wanted

    def _lift(self, drone: _Drone, time_s: float) -> float:
        """Acceleration upwards that keeps the height, or climbs along the path of least jerk."""
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
