"""The state that an autopilot reports by MAVLink: its mode, whether it is armed, its motion."""

import math
import time
from collections.abc import Iterable, Sequence
from types import ModuleType
from typing import Any, NamedTuple

from dlgmd_cli.errors import MissingExtraError, ParameterError, argument
from dlgmd_cli.models.stopping import ARDUCOPTER, JERK, PX4
from dlgmd_cli.parameters.checks import nearest, shown
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.watch.heading import MOTION_FRESH_S, Velocity, along_axes
from dlgmd_cli.watch.reports import Attitude

# Seconds for which a heartbeat is valid: at 1 Hz, two heartbeats may be lost.
HEARD_S = 3.0
# Seconds for which a reported velocity is valid as the speed.
FRESH_S = 2.0
# Time constant of the mean of the reported motion, in seconds.
_MOTION_TAU_S = 0.3
# Message with a velocity -> unit of the velocity in m/s; the better message first.
_VELOCITIES = {"LOCAL_POSITION_NED": 1.0, "GLOBAL_POSITION_INT": 0.01}
# No drone is faster: a higher speed is an error of the autopilot, or a damaged message.
MAX_SPEED_M_S = 100.0
# The modes in which vehicles brake and hold their position, by pymavlink's names: of ArduCopter, of
# ArduRover, and Hold of PX4.
_BRAKING, _PX4_HOLD = ("BRAKE", "HOLD"), "LOITER"
# Modes that may be named, too: those that stop, and those that only hold a height. In these (but
# not in LAND, and not in PX4's Hold), a throttle stick at the bottom makes the drone sink.
_STICKS, _HEIGHT_ONLY = ("LOITER", "POSHOLD", "FLOWHOLD", "POSCTL"), ("ALT_HOLD", "ALTCTL")
MAY_BRAKE = (*_BRAKING, *_STICKS, "LAND", *_HEIGHT_ONLY)
# ArduCopter's parameter on which the stop in BRAKE depends (m/s³), by the names of its versions.
JERKS = "PSC_JERK_XY", "PSC_JERK_NE", "PSC_NE_JERK"


def dialect() -> tuple[ModuleType, ModuleType]:
    """The messages of MAVLink 2, and pymavlink's tables of modes; raises MissingExtraError."""
    try:
        from pymavlink import mavutil
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError:
        raise MissingExtraError.of(argument("mavlink"), "pymavlink") from None
    return ardupilotmega, mavutil


class Mode(NamedTuple):
    """A mode that can be commanded.

    Heartbeats state the mode as `number`, commands as `main` and `sub`.
    """

    name: str
    number: int
    main: int
    sub: int

    @property
    def stops(self) -> bool:
        """Whether the drone stops in this mode, and does not only hold its height."""
        return self.name not in _HEIGHT_ONLY

    @property
    def follows_throttle(self) -> bool:
        """Whether a throttle stick at the bottom makes the drone sink."""
        is_hold = self.name == _PX4_HOLD and self.sub > 0
        return self.name in (*_STICKS, *_HEIGHT_ONLY) and not is_hold


class Autopilot:
    """The recent reports of the autopilot of a system.

    Parameters
    ----------
    system : int
        The number of the autopilot's system.
    braking : sequence of str
        Names of the modes that brake, in order; by default, the usual modes of the vehicle.

    Attributes
    ----------
    is_armed : bool
        Whether the autopilot is armed.
    odd_speed_m_s : float
        The last speed that was ignored because it is above `MAX_SPEED_M_S`, or NaN.
    mode, number : str, int
        pymavlink's name of the mode, such as GUIDED, or ``Mode(99)``, and the mode's number.
    heard_s : float
        Arrival time of the last heartbeat, by `time.monotonic`.
    brakes : tuple of Mode
        The modes that brake, in order; none for a plane, or for a VTOL of PX4 unless it reports
        that it hovers.
    attitude : Attitude
        The last reported one.
    jerk : (str, float) or None
        ArduCopter's parameter of the stop, by name, in m/s³; None until it has a valid value.
    """

    def __init__(self, system: int, braking: Sequence[str] = ()) -> None:
        self._names, self._tables = dialect()
        self._system, self._braking, self.heard_s = system, tuple(braking), -math.inf
        self.is_armed, self.mode, self.number = False, "", -1
        self.brakes: tuple[Mode, ...] = ()
        self.jerk: tuple[str, float] | None = None
        self._base_mode, self._vtol_state = 0, 0
        # Velocities (north, east, down; m/s), with arrival times.
        self._velocities: dict[str, tuple[tuple[float, float, float], float]] = {}
        self.attitude = Attitude((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), -math.inf)
        self._moved_s = -math.inf
        self._motion: Velocity | None = None
        self.odd_speed_m_s = math.nan

    @property
    def is_heard(self) -> bool:
        """Whether a heartbeat came within the last 3 s."""
        return time.monotonic() - self.heard_s <= HEARD_S

    @property
    def who_brakes(self) -> str:
        """Whose stop the first mode that brakes is: `arducopter`, `px4`, or empty if unknown."""
        first = self.brakes[0] if self.brakes else None
        if first is None or first.name not in ("BRAKE", _PX4_HOLD):
            return ""
        if first.name == "BRAKE":
            return ARDUCOPTER
        return PX4 if first.sub > 0 else ""

    @property
    def speed_m_s(self) -> float:
        """Speed from the local, else the global position, at most 2 s old; NaN if unknown."""
        velocity = self._velocity(FRESH_S)
        return math.nan if velocity is None else math.hypot(*velocity)

    def _velocity(self, within_s: float) -> tuple[float, float, float] | None:
        """The best velocity that came within the last `within_s` seconds; None for none."""
        known = [self._velocities[name] for name in _VELOCITIES if name in self._velocities]
        from_s = time.monotonic() - within_s
        return next((velocity for velocity, came_s in known if came_s >= from_s), None)

    def move(self) -> Velocity | None:
        """Smoothed velocity along the drone's axes; None if it or the attitude is over 1 s old.

        To be called about ten times per second.
        """
        velocity, now_s = self._velocity(MOTION_FRESH_S), time.monotonic()
        if velocity is None or now_s - self.attitude.came_s > MOTION_FRESH_S:
            self._motion = None
            return None
        forward, right, up = along_axes(velocity, self.attitude.angles)
        if self._motion is not None:
            new = 1.0 - math.exp((self._moved_s - now_s) / _MOTION_TAU_S)
            before_forward, before_right, before_up = self._motion
            forward = before_forward + new * (forward - before_forward)
            right = before_right + new * (right - before_right)
            up = before_up + new * (up - before_up)
        self._motion, self._moved_s = (forward, right, up), now_s
        return self._motion

    def is_in(self, modes: Iterable[str]) -> bool:
        """Whether the current mode is one of these names and numbers."""
        return not {self.mode, str(self.number)}.isdisjoint(modes)

    def is_from(self, message: Any) -> bool:
        """Whether a message is from the autopilot itself, not another component or system."""
        source = message.get_srcSystem(), message.get_srcComponent()
        return source == (self._system, self._names.MAV_COMP_ID_AUTOPILOT1)

    def is_of_another(self, message: Any) -> bool:
        """Whether a message is a heartbeat from the autopilot of another system."""
        is_pilot = message.get_srcComponent() == self._names.MAV_COMP_ID_AUTOPILOT1
        return self.is_beat(message) and is_pilot and message.get_srcSystem() != self._system

    def is_beat(self, message: Any) -> bool:
        """Whether a message is a vehicle's heartbeat."""
        is_beat = message.get_type() == "HEARTBEAT"
        return is_beat and message.autopilot != self._names.MAV_AUTOPILOT_INVALID

    def step(self, message: Any) -> None:
        """Update the state from one of the autopilot's messages."""
        names, kind = self._names, message.get_type()
        if self.is_beat(message):
            self.heard_s, self._base_mode = time.monotonic(), message.base_mode
            has_number = message.base_mode & names.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            self.number = message.custom_mode if has_number else -1
            self.is_armed = bool(message.base_mode & names.MAV_MODE_FLAG_SAFETY_ARMED)
            self.mode = self._tables.mode_string_v10(message)
            self.brakes = self._braking_modes(message.autopilot, message.type)
        elif kind == "PARAM_VALUE":
            if message.param_id in JERKS and JERK.low <= message.param_value <= JERK.high:
                self.jerk = message.param_id, round(message.param_value, 3)
        elif kind == "EXTENDED_SYS_STATE":
            self._vtol_state = message.vtol_state
        elif kind == "ATTITUDE":
            angles = message.roll, message.pitch, message.yaw
            rates = message.rollspeed, message.pitchspeed, message.yawspeed
            if all(map(math.isfinite, angles)):
                is_turning = all(map(math.isfinite, rates))
                known = rates if is_turning else (0.0, 0.0, 0.0)
                self.attitude = Attitude(angles, known, time.monotonic())
        elif kind in _VELOCITIES:
            unit = _VELOCITIES[kind]
            velocity = unit * message.vx, unit * message.vy, unit * message.vz
            speed = math.hypot(*velocity)
            if speed > MAX_SPEED_M_S:
                self.odd_speed_m_s = speed
            elif not math.isnan(speed):
                self._velocities[kind] = velocity, time.monotonic()

    def _braking_modes(self, autopilot: int, kind: int) -> tuple[Mode, ...]:
        names, tables = self._names, self._tables
        if autopilot == names.MAV_AUTOPILOT_PX4:
            is_vtol = names.MAV_TYPE_VTOL_DUOROTOR <= kind <= names.MAV_TYPE_VTOL_RESERVED5
            is_plane = kind == names.MAV_TYPE_FIXED_WING
            if is_plane or (is_vtol and self._vtol_state != names.MAV_VTOL_STATE_MC):
                return ()
            known = {
                name: Mode(name, main << 16 | sub << 24, main, sub)
                for name, (_, main, sub) in tables.px4_map.items()
            }
            usual = [_PX4_HOLD]
        elif autopilot == names.MAV_AUTOPILOT_ARDUPILOTMEGA:
            numbers = tables.mode_mapping_byname(kind) or {}
            known = {name: Mode(name, number, number, 0) for name, number in numbers.items()}
            usual = [name for name in _BRAKING if name in known][:1]
        else:
            return ()
        if not usual:  # a plane falls if it stops
            return ()
        return tuple(known[name] for name in self._braking or usual if name in known)

    def to_dict(self) -> dict[str, Json]:
        """The autopilot's state as entries of an event."""
        if not self.is_heard:
            return {"heard": False}
        return {"heard": True, "mode": self.mode, "armed": self.is_armed}

    def flags(self) -> int:
        """The base mode of a command: custom mode enabled; armed and simulated as at present."""
        names = self._names
        kept = names.MAV_MODE_FLAG_SAFETY_ARMED | names.MAV_MODE_FLAG_HIL_ENABLED
        return int(names.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (self._base_mode & kept))


def known_modes(text: str) -> list[str]:
    """``GUIDED,auto,196608`` as names and numbers; raises ParameterError for unknown ones."""
    return _modes(text, "mavlink_modes", "Give names such as GUIDED,AUTO, or the numbers of modes.")


def braking_modes(text: str | None) -> list[str]:
    """``BRAKE,LOITER`` as names, in order, none for None; raises ParameterError."""
    if text is None:
        return []
    hint = f"Choose from {', '.join(MAY_BRAKE)}."
    names = _modes(text, "mavlink_brake_mode", hint)
    if others := [name for name in names if name not in MAY_BRAKE]:
        why = f"{others[0]} is no name" if others[0].isdecimal() else f"{others[0]} does not brake"
        raise ParameterError(argument("mavlink_brake_mode"), why, hint)
    return names


def _modes(text: str, name: str, hint: str) -> list[str]:
    """Names and numbers of modes in the value of an argument."""
    tables = dialect()[1]
    maps = tables.AP_MAV_TYPE_MODE_MAP.values()
    known = {*tables.px4_map, *(mode for modes in maps for mode in modes.values())}
    modes = [word.strip().upper() for word in text.split(",")]
    for mode in modes:
        if mode not in known and not mode.isdecimal():
            near = nearest(mode[:100], map(str.lower, sorted(known)))
            hint = f"Did you mean {near.upper()}? {hint}" if near else hint
            raise ParameterError(argument(name), f"there is no mode {shown(mode)}", hint)
    return modes
