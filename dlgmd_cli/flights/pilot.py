"""The autopilot: from what a phase commands and how the drone moves to attitude and climb."""

import math
from dataclasses import dataclass

from dlgmd_cli.flights.craft import DRAG_1_S, GRAVITY_M_S2, YAW_LAG_S, Craft
from dlgmd_cli.flights.script import SPIN_UP_S, Phase

# How fast it corrects its speed and its position, in 1/s.
_SPEED_GAIN, _PLACE_GAIN = 2.0, 0.7
_CLIMB_GAIN, _HEIGHT_GAIN = 6.0, 2.0
_HEADING_GAIN = 1.5
_MAX_LEAN = math.radians(25.0)
# Below this speed it has stopped, as far as holding a position goes.
_SLOW_M_S = 0.1


@dataclass(frozen=True, slots=True)
class Orders:
    """Roll and pitch in rad, yaw rate in rad/s, and acceleration upwards in m/s²."""

    roll: float
    pitch: float
    yaw_rate: float
    lift: float


class Pilot:
    """Flies one phase after the other.

    Parameters
    ----------
    craft : Craft
        As it is at the start.
    """

    def __init__(self, craft: Craft) -> None:
        self._height = craft.z
        self._heading, self._heading_rate = craft.yaw, craft.yaw_rate
        self._hold: tuple[float, float] | None = None
        self._climb: _Climb | None = None

    def begin(self, phase: Phase, craft: Craft, time_s: float) -> None:
        """Take up a phase."""
        self._phase = phase
        self._yaw_rate = math.radians(phase.yaw_rate_deg_s)
        self._pitch = math.radians(phase.pitch_deg)
        self._climb = None
        if phase.climb_m:
            wait = SPIN_UP_S if craft.stands else 0.0
            self._climb = _Climb(time_s + wait, phase.seconds - wait, self._height, phase.climb_m)
            self._height += phase.climb_m
        self._speed = math.cos(craft.yaw) * craft.vx + math.sin(craft.yaw) * craft.vy
        stays = abs(self._speed) < _SLOW_M_S and phase.roll_deg is None
        self._holds = phase.forward in ("hold", "brake") or (phase.forward == "keep" and stays)
        if not self._holds:
            self._hold = None

    def recover(self, phase: Phase, craft: Craft, back_off: tuple[float, float]) -> None:
        """Hold a position near by, `back_off` metres from here, after a blow."""
        self._height, self._heading, self._heading_rate = craft.z, craft.yaw, 0.0
        self.begin(phase, craft, 0.0)
        self._hold = craft.x + back_off[0], craft.y + back_off[1]

    def steer(self, craft: Craft, time_s: float, step_s: float) -> Orders:
        """What to do now, for `step_s` seconds."""
        cos, sin = math.cos(craft.yaw), math.sin(craft.yaw)
        ahead = cos * craft.vx + sin * craft.vy
        left = cos * craft.vy - sin * craft.vx
        most = _MAX_LEAN
        if self._holds:
            ax, ay = self._stay(craft)
            forwards, leftwards = cos * ax + sin * ay, cos * ay - sin * ax
            if self._phase.forward == "brake" and self._hold is None:
                most = self._pitch
        else:
            forwards = _SPEED_GAIN * (self._speed - ahead) + DRAG_1_S * ahead
            # The first term is what a curve takes.
            leftwards = craft.yaw_rate * ahead + (DRAG_1_S - _SPEED_GAIN) * left
        pitch = min(max(-math.atan2(forwards, GRAVITY_M_S2), -_MAX_LEAN), most)
        if self._phase.forward == "tilt":
            pitch = self._pitch
        roll = min(max(-math.atan2(leftwards, GRAVITY_M_S2), -_MAX_LEAN), _MAX_LEAN)
        if self._phase.roll_deg is not None:
            roll = math.radians(self._phase.roll_deg)
        return Orders(roll, pitch, self._turn(craft, step_s), self._lift(craft, time_s))

    def _stay(self, craft: Craft) -> tuple[float, float]:
        """Acceleration along x and y that stops the drone, and then keeps it where it is."""
        if self._hold is None and math.hypot(craft.vx, craft.vy) < _SLOW_M_S:
            self._hold = craft.x + craft.vx / _SPEED_GAIN, craft.y + craft.vy / _SPEED_GAIN
        to_x, to_y = self._hold or (craft.x, craft.y)
        return (
            _SPEED_GAIN * (_PLACE_GAIN * (to_x - craft.x) - craft.vx),
            _SPEED_GAIN * (_PLACE_GAIN * (to_y - craft.y) - craft.vy),
        )

    def _turn(self, craft: Craft, step_s: float) -> float:
        """Yaw rate that follows the heading of a drone that nothing disturbs."""
        was = self._heading_rate
        self._heading_rate += (self._yaw_rate - was) / YAW_LAG_S * step_s
        wanted = self._yaw_rate + _HEADING_GAIN * (self._heading - craft.yaw)
        self._heading += 0.5 * (was + self._heading_rate) * step_s
        return wanted

    def _lift(self, craft: Craft, time_s: float) -> float:
        """Acceleration upwards that keeps the height, or follows the climb."""
        height, speed, lift = self._height, 0.0, 0.0
        if self._phase.forward == "stand":
            return -GRAVITY_M_S2
        if self._climb is not None:
            if craft.stands and time_s < self._climb.start_s:
                return GRAVITY_M_S2 * (time_s - self._climb.start_s) / SPIN_UP_S
            height, speed, lift = self._climb.at(time_s)
        to_go = _HEIGHT_GAIN * (height - craft.z) + speed - craft.vz
        return lift + _CLIMB_GAIN * to_go + DRAG_1_S * craft.vz


@dataclass(frozen=True)
class _Climb:
    """From one height to another along the path of least jerk."""

    start_s: float
    seconds: float
    from_m: float
    climb_m: float

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Height, speed and acceleration upwards at a time."""
        s = min(max((time_s - self.start_s) / self.seconds, 0.0), 1.0)
        rise = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
        speed = 30.0 * s**2 * (1.0 - s) ** 2 / self.seconds
        lift = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / self.seconds**2
        return self.from_m + self.climb_m * rise, self.climb_m * speed, self.climb_m * lift
