"""MAVLink: alarms for an autopilot, what it reports, and the command that makes it brake."""

import logging
import math
import time
from collections.abc import Iterable
from contextlib import suppress
from functools import partial
from typing import Any

from dlgmd_cli.errors import MissingExtraError, ParameterError, argument
from dlgmd_cli.live.outputs import datagram_socket, split_address
from dlgmd_cli.live.watch import BEGIN, BLIND, END, SEES, Answer, Reports
from dlgmd_cli.parameters.checks import nearest, shown

_log = logging.getLogger(__name__)

# Events: the autopilot is heard or no longer, or has another mode; the command that brakes was
# sent, or is not sent; what came back.
AUTOPILOT, BRAKE, WITHHELD, ANSWERED = "autopilot", "brake", "brake-withheld", "brake-answer"
# What an autopilot reported longer ago is not known any more.
FRESH_S = 2.0
# Tries of a command, how long an answer to each may take, and the least time between two commands.
MAX_TRIES, ANSWER_S, LEAST_APART_S = 3, 0.5, 2.0
# An alarm that a slow link has held up for longer brakes no more.
_LATE_S = 1.0
_HEARTBEAT_S, _VALUES_S = 1.0, 0.2
# Pause before a lost serial port is opened again.
_AGAIN_S = 1.0
# MAV_COLLISION_SRC has no camera: 0 is ADS-B, 1 another aircraft's GPS. This is none of them.
_CAMERA = 255
# Messages with a speed, the better one first, and its unit in m/s.
_SPEEDS = {"LOCAL_POSITION_NED": 1.0, "GLOBAL_POSITION_INT": 0.01}
# A speed beyond this is an error of the autopilot, or a damaged message, not one of a drone.
MAX_SPEED_M_S = 100.0
# So many bytes that are no message are reported.
_NONSENSE = 500


def _dialect() -> tuple[Any, Any]:
    """The messages of MAVLink 2, and pymavlink's tables of modes; raises MissingExtraError."""
    try:
        from pymavlink import mavutil
        from pymavlink.dialects.v20 import ardupilotmega
    except ImportError:
        raise MissingExtraError.of(argument("mavlink"), "pymavlink") from None
    return ardupilotmega, mavutil


class Autopilot:
    """What the autopilot of a system has reported lately.

    Attributes
    ----------
    is_armed : bool
        Whether it is armed.
    odd_speed_m_s : float
        The last speed that was ignored since it is beyond `MAX_SPEED_M_S`, or NaN.
    mode : str
        The name of its mode by pymavlink, such as GUIDED, or ``Mode(99)``.
    brake : (str, int, int) or None
        The mode in which it brakes and holds its place, and its numbers for a command: BRAKE of
        ArduCopter, HOLD of ArduRover, Hold of PX4, which pymavlink calls LOITER. None for planes.
    """

    def __init__(self, system: int) -> None:
        self._names, self._tables = _dialect()
        self._system, self._heard_s = system, -math.inf
        self.is_armed, self.mode = False, ""
        self.brake: tuple[str, int, int] | None = None
        self._base_mode, self._custom_mode = 0, -1
        self._speeds: dict[str, tuple[float, float]] = {}
        self.odd_speed_m_s = math.nan

    @property
    def is_heard(self) -> bool:
        """Whether a heartbeat came within the last 2 s."""
        return time.monotonic() - self._heard_s <= FRESH_S

    @property
    def speed_m_s(self) -> float:
        """Speed by the local position, else the global one, of the last 2 s; NaN for none."""
        known = [self._speeds[name] for name in _SPEEDS if name in self._speeds]
        from_s = time.monotonic() - FRESH_S
        return next((speed for speed, received_s in known if received_s >= from_s), math.nan)

    def is_in(self, modes: Iterable[str]) -> bool:
        """Whether its mode is one of these names and numbers."""
        return not {self.mode, str(self._custom_mode)}.isdisjoint(modes)

    def is_from(self, message: Any) -> bool:
        """Whether a message is of the autopilot itself, not of another component or system."""
        source = message.get_srcSystem(), message.get_srcComponent()
        return source == (self._system, self._names.MAV_COMP_ID_AUTOPILOT1)

    def step(self, message: Any) -> None:
        """Take in one of its messages."""
        names, kind = self._names, message.get_type()
        if kind == "HEARTBEAT" and message.autopilot != names.MAV_AUTOPILOT_INVALID:
            self._heard_s, self._base_mode = time.monotonic(), message.base_mode
            has_number = message.base_mode & names.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
            self._custom_mode = message.custom_mode if has_number else -1
            self.is_armed = bool(message.base_mode & names.MAV_MODE_FLAG_SAFETY_ARMED)
            self.mode = self._tables.mode_string_v10(message)
            self.brake = self._braking_mode(message.autopilot, message.type)
        elif kind in _SPEEDS:
            speed = _SPEEDS[kind] * math.hypot(message.vx, message.vy, message.vz)
            if speed > MAX_SPEED_M_S:
                self.odd_speed_m_s = speed
            elif not math.isnan(speed):
                self._speeds[kind] = speed, time.monotonic()

    def _braking_mode(self, autopilot: int, kind: int) -> tuple[str, int, int] | None:
        names, tables = self._names, self._tables
        if autopilot == names.MAV_AUTOPILOT_PX4 and kind != names.MAV_TYPE_FIXED_WING:
            return ("LOITER", *tables.px4_map["LOITER"][1:])
        numbers = tables.mode_mapping_byname(kind) or {}
        if autopilot == names.MAV_AUTOPILOT_ARDUPILOTMEGA:
            return next(((n, numbers[n], 0) for n in ("BRAKE", "HOLD") if n in numbers), None)
        return None

    def to_dict(self) -> dict[str, object]:
        """Its state as entries of an event."""
        if not self.is_heard:
            return {"heard": False}
        return {"heard": True, "mode": self.mode, "armed": self.is_armed}

    def flags(self) -> int:
        """The base mode of a command: a number of its own, and armed or simulated as it is now."""
        names = self._names
        kept = names.MAV_MODE_FLAG_SAFETY_ARMED | names.MAV_MODE_FLAG_HIL_ENABLED
        return int(names.MAV_MODE_FLAG_CUSTOM_MODE_ENABLED | (self._base_mode & kept))


def known_modes(text: str) -> frozenset[str]:
    """``GUIDED,auto,196608`` as names and numbers; raises ParameterError for unknown ones."""
    tables = _dialect()[1]
    maps = tables.AP_MAV_TYPE_MODE_MAP.values()
    known = {*tables.px4_map, *(name for names in maps for name in names.values())}
    modes = {word.strip().upper() for word in text.split(",")}
    for mode in sorted(modes - known):
        if not mode.isdecimal():
            near = nearest(mode[:100], map(str.lower, sorted(known)))
            hint = f"Did you mean {near.upper()}? " if near else ""
            hint = f"{hint}Give names such as GUIDED,AUTO, or the numbers of modes."
            raise ParameterError(argument("mavlink_modes"), f"there is no mode {shown(mode)}", hint)
    return frozenset(modes)


class Mavlink:
    """Sends MAVLink 2 to an autopilot, reads what it reports, and makes it brake if it is asked to.

    It sends COLLISION with a threat level (HIGH while the alarm is on, LOW at a spike, else NONE;
    frames without a threat only after one with it), NAMED_VALUE_FLOAT five times a second and with
    events, STATUSTEXT at events and at the end, and a heartbeat, also while no frame comes: its
    state is BOOT before the first answer, CRITICAL while the source shows nothing.

    With `modes`, an alarm that begins sends MAV_CMD_DO_SET_MODE: only if the autopilot was heard
    within 2 s, is armed, and in one of the modes, and never while the source shows nothing. Without
    MAV_RESULT_ACCEPTED, it is sent up to three times, if all that still holds. Nothing ever
    releases the brake. All of it, and what the autopilot says, are reports.

    Parameters
    ----------
    url : str
        ``udp://HOST:PORT`` to send there, ``udpin://[HOST:]PORT`` to answer who sends to it, or
        ``serial:///dev/ttyACM0:57600``. A serial port that is lost is opened again.
    reports : Reports
        For events and the speed.
    system, component : int
        Own numbers. The autopilot is component 1 of the same system.
    modes : frozenset of str
        See `known_modes`; without any, nothing is commanded.

    Raises
    ------
    MissingExtraError
        If pymavlink is not installed, or pyserial for a serial port.
    ParameterError
        If the connection cannot be opened.
    """

    PAUSE_S = 0.05

    def __init__(
        self,
        url: str,
        reports: Reports,
        *,
        system: int = 1,
        component: int = 196,
        modes: frozenset[str] = frozenset(),
    ) -> None:
        self._names = names = _dialect()[0]
        try:
            # pymavlink's own links print to stdout, and stay dead once they fail.
            self._link = _link(url)
        except (OSError, ValueError) as error:  # the latter for what is no address
            why = f"{url!r} cannot be opened ({error})"
            hint = "Write, for example, udp://127.0.0.1:14550."
            raise ParameterError(argument("mavlink"), why, hint) from None
        self._mav = names.MAVLink(self._link, system, component)
        self._mav.robust_parsing = True
        self._reports, self._own, self._modes = reports, (system, component), modes
        self._pilot = Autopilot(system)
        self._reported: dict[str, object] = {} if modes else {"heard": False}
        self._tries, self._due_s, self._braked_s = 0, math.inf, -math.inf
        self._is_answered = self._has_told_speed = False
        self._begin_s, self._beat_s, self._values_s = time.monotonic(), -math.inf, -math.inf
        self._level, self._reason, self._n_nonsense = 0, "", 0
        self._state = names.MAV_STATE_BOOT
        self._texts = {
            BEGIN: (names.MAV_SEVERITY_CRITICAL, "collision alarm"),
            END: (names.MAV_SEVERITY_NOTICE, "collision alarm over"),
            BLIND: (names.MAV_SEVERITY_ERROR, "blind"),
            SEES: (names.MAV_SEVERITY_NOTICE, "recovered"),
        }

    def __call__(self, answer: Answer) -> None:
        """Send an answer, after what there was to read."""
        names, self._reason = self._names, answer.reason
        self._state = names.MAV_STATE_CRITICAL if answer.reason else names.MAV_STATE_ACTIVE
        self.beat()
        if answer.event == BEGIN and self._modes:
            self._brake(answer)
        if answer.is_of_frame or answer.event in self._texts:
            self._send_threat(answer)
            self._send_values(answer)
        if answer.event in self._texts:
            severity, text = self._texts[answer.event]
            detail = f" ({answer.reason})" if answer.event == BLIND else ""
            if answer.event == BEGIN:
                side = answer.span.side if answer.span is not None else ""
                detail = f" ({answer.detection.rule}){side and ', '}{side}"
            self._mav.statustext_send(severity, f"dlgmd: {text}{detail}".encode())

    def beat(self) -> None:
        """Read what has come, try a command again, and send a heartbeat, where they are due."""
        self._read()
        now_s, state = time.monotonic(), self._pilot.to_dict()
        self._reports.speed_m_s = self._pilot.speed_m_s
        if state != self._reported:
            self._reported = state
            self._report(AUTOPILOT, **state)
        if now_s >= self._due_s:
            if not self._is_answered:
                self._report(ANSWERED, result="none", number=self._tries)
            self._try()
        if now_s - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            self._send_heartbeat(self._state)

    def close(self) -> None:
        """Say that this was the end, and free the link."""
        try:
            text = b"dlgmd: the watch has ended"
            self._mav.statustext_send(self._names.MAV_SEVERITY_WARNING, text)
            self._send_heartbeat(self._names.MAV_STATE_POWEROFF)
        finally:
            self._link.close()

    def _report(self, event: str, **facts: object) -> None:
        self._reports.append((event, facts))
        text = ", ".join(f"{name} {value}" for name, value in facts.items())
        _log.info("%s: %s: %s.", argument("mavlink"), event, text)

    def _brake(self, answer: Answer) -> None:
        """Begin a command at an alarm."""
        now_s, why = time.monotonic(), ""
        if now_s - self._braked_s < LEAST_APART_S:
            why = f"the last command is less than {LEAST_APART_S:g} s old"
        elif answer.frame is not None and now_s - answer.frame.captured_s > _LATE_S:
            why = f"the alarm is more than {_LATE_S:g} s old"
        if why := why or self._objection():
            self._report(WITHHELD, why=why)
            return
        self._braked_s, self._tries = now_s, 0
        self._try()

    def _objection(self) -> str:
        """Why nothing is to be commanded now; empty if it may be."""
        pilot = self._pilot
        reasons = {
            "no heartbeat of the autopilot within 2 s": not pilot.is_heard,
            "not armed": not pilot.is_armed,
            f"blind, {self._reason}": bool(self._reason),
            f"{pilot.mode} already": pilot.brake is not None and pilot.mode == pilot.brake[0],
            f"{pilot.mode} is not one of the modes": not pilot.is_in(self._modes),
            "no braking mode of this vehicle is known": pilot.brake is None,
        }
        return next((why for why, is_so in reasons.items() if is_so), "")

    def _try(self) -> None:
        """Send the command once more, unless that was all, or it may not be sent any more."""
        self._due_s = math.inf
        if self._tries == MAX_TRIES:
            what = "%s: the autopilot has not accepted %d commands"
            _log.warning(what, argument("mavlink"), MAX_TRIES)
            return
        if (why := self._objection()) or self._pilot.brake is None:
            self._report(WITHHELD, why=why)
            return
        (name, *numbers), names = self._pilot.brake, self._names
        self._tries, self._due_s = self._tries + 1, time.monotonic() + ANSWER_S
        self._is_answered = False
        self._mav.command_long_send(
            *(self._own[0], names.MAV_COMP_ID_AUTOPILOT1, names.MAV_CMD_DO_SET_MODE),
            *(self._tries - 1, self._pilot.flags(), *numbers, 0, 0, 0, 0),
        )
        self._report(BRAKE, mode=name, number=self._tries)

    def _read(self) -> None:
        """Take in the messages that have come."""
        data = self._link.read()
        try:
            messages = (data and self._mav.parse_buffer(data)) or ()
        except Exception:  # pymavlink's parser of damaged messages may raise anything
            messages, self._n_nonsense = (), self._n_nonsense + len(data)
        for message in messages:
            if message.get_type() == "BAD_DATA":
                self._n_nonsense += len(message.data)
            elif self._pilot.is_from(message):
                self._pilot.step(message)
                if message.get_type() == "COMMAND_ACK":
                    self._take_answer(message)
        if self._n_nonsense > _NONSENSE:
            self._n_nonsense = -(1 << 62)  # once
            what = "%s: what comes back is not MAVLink; check the rate of the port"
            _log.warning(what, argument("mavlink"))
        if self._pilot.odd_speed_m_s > MAX_SPEED_M_S and not self._has_told_speed:
            self._has_told_speed = True
            _log.warning(
                "%s: the autopilot reports %g m/s; speeds beyond %g m/s are ignored",
                argument("mavlink"),
                self._pilot.odd_speed_m_s,
                MAX_SPEED_M_S,
            )

    def _take_answer(self, message: Any) -> None:
        """The answer to the command that waits for one; any other is not for this program."""
        names = self._names
        target = message.target_system, message.target_component
        is_ours = all(number in (0, own) for number, own in zip(target, self._own, strict=True))
        is_mode = message.command == names.MAV_CMD_DO_SET_MODE
        if not (is_ours and is_mode and self._due_s < math.inf):
            return
        known = names.enums["MAV_RESULT"].get(message.result)
        name = known.name.removeprefix("MAV_RESULT_") if known else str(message.result)
        self._report(ANSWERED, result=name, number=self._tries)
        self._is_answered = True
        if message.result == names.MAV_RESULT_ACCEPTED:
            self._due_s = math.inf

    def _send_threat(self, answer: Answer) -> None:
        names, detection = self._names, answer.detection
        before, self._level = self._level, names.MAV_COLLISION_THREAT_LEVEL_NONE
        if detection.alarm:
            self._level = names.MAV_COLLISION_THREAT_LEVEL_HIGH
        elif detection.spike:
            self._level = names.MAV_COLLISION_THREAT_LEVEL_LOW
        if self._level or before:
            self._mav.collision_send(
                *(_CAMERA, self._own[0], names.MAV_COLLISION_ACTION_REPORT, self._level),
                *(detection.ttc_s, math.nan, math.nan),  # distances are unknown
            )

    def _send_values(self, answer: Answer) -> None:
        now_s, detection = time.monotonic(), answer.detection
        if not answer.is_of_frame or (now_s - self._values_s < _VALUES_S and not answer.event):
            return
        self._values_s = now_s
        for name in ("mp", "expansion", "ttc_s"):
            boot_ms = int(1e3 * (now_s - self._begin_s)) % (1 << 32)
            self._mav.named_value_float_send(boot_ms, name.encode(), getattr(detection, name))

    def _send_heartbeat(self, state: int) -> None:
        names = self._names
        kind, pilot = names.MAV_TYPE_ONBOARD_CONTROLLER, names.MAV_AUTOPILOT_INVALID
        self._mav.heartbeat_send(kind, pilot, 0, 0, state)


class _Socket:
    """Datagrams to ``HOST:PORT``, or at a port to whoever sent last; raises OSError, ValueError."""

    def __init__(self, place: str, *, listens: bool) -> None:
        host, port = split_address(place, argument("mavlink"), "0.0.0.0" if listens else None)
        self._socket, self._target = datagram_socket(host, port)
        self._listens = listens
        self._socket.setblocking(False)
        self.close = self._socket.close
        if listens:
            try:
                self._socket.bind(self._target)
            except OSError:
                self.close()
                raise
            self._target = None

    def write(self, data: bytes) -> None:
        """Send a message; drop it if nobody is known."""
        if self._target is not None:
            self._socket.sendto(data, self._target)

    def read(self) -> bytes:
        """What has come."""
        data = b""
        with suppress(OSError):  # nothing more is there
            while len(data) < 1 << 16:
                datagram, place = self._socket.recvfrom(4096)
                data, self._target = data + datagram, place if self._listens else self._target
        return data


class _SerialPort:
    """A serial port, which is opened again after it was lost; raises OSError at first.

    A message that cannot be written is dropped. That the port is lost, and that it is back, are
    warnings.
    """

    def __init__(self, device: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise MissingExtraError.of(argument("mavlink"), "pyserial") from None
        self._open = partial(serial.Serial, device, baud, timeout=0.0, write_timeout=1.0)
        self._too_slow, self._device = serial.SerialTimeoutException, device
        self._port: Any = self._open()
        self._tried_s = -math.inf

    def write(self, data: bytes) -> None:
        """Write a message."""
        if self._port is None and not self._is_back():
            return
        try:
            self._port.write(bytes(data))
        except self._too_slow:
            raise TimeoutError(f"{self._device} takes nothing") from None
        except OSError as error:  # which the package's own are, too
            self._lose(error)

    def read(self) -> bytes:
        """What has come."""
        try:
            return b"" if self._port is None else self._port.read(1 << 16)
        except OSError as error:
            self._lose(error)
            return b""

    def close(self) -> None:
        """Free the port."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError):
                port.close()

    def _lose(self, error: OSError) -> None:
        _log.warning("%s: %s is lost (%s); trying again", argument("mavlink"), self._device, error)
        self.close()

    def _is_back(self) -> bool:
        """Try to open the port again, once a second."""
        if time.monotonic() - self._tried_s < _AGAIN_S:
            return False
        self._tried_s = time.monotonic()
        try:
            self._port = self._open()
        except OSError:
            return False
        _log.warning("%s: %s is back", argument("mavlink"), self._device)
        return True


def _link(url: str) -> _Socket | _SerialPort:
    """What a URL leads to; raises ValueError or OSError."""
    scheme, _, place = url.partition("://")
    if scheme in ("udp", "udpin"):
        return _Socket(place, listens=scheme == "udpin")
    if scheme != "serial":
        raise ValueError("only udp://, udpin:// and serial:// are links")
    return _SerialPort(*serial_place(place))


def serial_place(place: str) -> tuple[str, int]:
    """``/dev/ttyACM0:57600`` as a device and its rate, which is 57600 if it is not given."""
    device, _, baud = place.rpartition(":")
    return (device, int(baud)) if device else (place, 57600)
