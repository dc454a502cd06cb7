"""MAVLink: alarms for an autopilot, reports from the autopilot, and the command to brake."""

import logging
import math
import time
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from dlgmd_cli import Rule
from dlgmd_cli.errors import Once, ParameterError, argument, counted
from dlgmd_cli.models.health import UNMEASURED
from dlgmd_cli.models.stopping import Brake
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.watch.autopilot import HEARD_S, MAX_SPEED_M_S, Autopilot, Mode, dialect
from dlgmd_cli.watch.brake import Braking
from dlgmd_cli.watch.links import Address, open_link
from dlgmd_cli.watch.load import RATE, in_words
from dlgmd_cli.watch.peers import AUTOPILOTS, Peer, Peers
from dlgmd_cli.watch.reports import Reports
from dlgmd_cli.watch.signing import OLD, Signing, key_in
from dlgmd_cli.watch.stop import Stop
from dlgmd_cli.watch.watch import BEGIN, BLIND, END, SEES, Answer

_log = logging.getLogger(__name__)

# Event: the autopilot is heard, is no longer heard, or changes its mode.
AUTOPILOT = "autopilot"
# Event: messages are dropped that are not signed by the key.
UNSIGNED = "unsigned"
# An alarm that a slow link has delayed by more than this (s) does not brake.
_LATE_S = 1.0
HEARTBEAT_S, _VALUES_S = 1.0, 0.2
# MAV_COLLISION_SRC has no value for a camera: 0 is ADS-B, 1 another aircraft's GPS. 255 is unused.
_CAMERA = 255
# A radio speaks for itself, and has no key.
_OF_RADIOS = "RADIO", "RADIO_STATUS"
# Time limit (s) of reading: a flood of messages must not delay alarms.
_READ_S = 0.01
# Number of bytes without a valid message above which a warning is given.
_NONSENSE = 500
# The autopilot is asked to send its motion this often (us); until it comes, again after _ASK_S (s).
_MOTION_US, _ASK_S = 100_000, 5.0
# Bytes of a STATUSTEXT; number of identifiers for long texts. Short texts have identifier 0.
_TEXT_BYTES, _MOST_TEXTS = 50, 65_535


class Mavlink:
    """Sends MAVLink 2 to an autopilot, reads its reports, and commands it to brake if requested.

    Sent are: COLLISION with a threat level (HIGH while the alarm is on, LOW at a spike; NONE only
    for the first frame after a threat); NAMED_VALUE_FLOAT five times per second and with events;
    STATUSTEXT at events and at the end; and a heartbeat, also while no frame comes, with the state
    BOOT before the first answer and CRITICAL while the source shows nothing. An autopilot that is
    heard, or heard again, is asked for its attitude, position and velocity, ten times a second.

    With `modes`, an alarm commands the autopilot to brake, see `Braking`: only if its last
    heartbeat is at most 3 s old, it is armed and in one of the modes; never while the source shows
    nothing, or if two autopilots speak with the same number, see `Peers`. Commands and the
    autopilot's answers are reported as events, and STATUSTEXT tells the pilot.

    Parameters
    ----------
    url : str
        ``udp://HOST:PORT`` to send to an address, ``udpin://[HOST:]PORT`` to answer senders (those
        of this machine unless a host is given), ``tcp:HOST:PORT``, or
        ``serial:///dev/ttyACM0:57600``. A lost port or connection is opened again.
    reports : Reports
        Receives events, and the speed and motion of the drone.
    system, component : int
        Our own numbers. The autopilot is component 1 of the same system.
    modes : collection of str
        The modes in which the autopilot may be commanded, see `known_modes`; none for no command.
    braking : sequence of str
        The modes that brake, in order; by default, the usual modes of the vehicle.
    signing : str, optional
        File with the passphrase to sign messages with; its SHA-256 is the key, as in MAVProxy.
        What comes without a right signature is dropped.
    rule, react_s : Rule or None, float
        The rule that raises the alarms, and the time from an alarm to the command: a threshold
        that is too late for the stop is warned of, see `Stop`.

    Raises
    ------
    MissingExtraError
        If pymavlink is not installed, or pyserial for a serial port.
    ParameterError
        If the connection cannot be opened, or the file cannot be read.
    """

    PAUSE_S = 0.05

    def __init__(
        self,
        url: str,
        reports: Reports,
        *,
        system: int = 1,
        component: int = 196,
        modes: Collection[str] = (),
        braking: Sequence[str] = (),
        signing: str | None = None,
        rule: Rule | None = None,
        react_s: float = Brake.react_s,
    ) -> None:
        key = None if signing is None else key_in(signing)
        self._names = names = dialect()[0]
        try:
            # pymavlink's own links print to stdout and never recover from a failure.
            self._link = open_link(url)
        except (OSError, ValueError) as error:  # ValueError: not an address
            why = f"{url!r} cannot be opened ({error})"
            hint = "Write, for example, udp://127.0.0.1:14550."
            raise ParameterError(argument("mavlink"), why, hint) from None
        self._mav = names.MAVLink(self, system, component)
        self._signing, self._dropped = Signing(self._mav, key), Counter[str]()
        self._reports, self._own = reports, (system, component)
        self._target = system, names.MAV_COMP_ID_AUTOPILOT1
        self._pilot = Autopilot(system, braking)
        self._braking = Braking(self._pilot, modes, self._command, self._report, self._say)
        self._is_to_brake, self._alarm_s = bool(modes), math.inf
        self._stop = Stop(self._pilot, self._ask_parameter, rule, react_s)
        self._peers = Peers(names)
        self._towards: list[Address] | None = None
        self._reported: dict[str, Json] = {} if modes else {"heard": False}
        self._told = Once()
        self._begin_s, self._beat_s, self._values_s = time.monotonic(), -math.inf, -math.inf
        self._asked_s = -math.inf
        self._level, self._reason, self._n_nonsense, self._n_long = 0, "", 0, 0
        self._state = names.MAV_STATE_BOOT
        self._texts = {
            BEGIN: (names.MAV_SEVERITY_CRITICAL, "collision alarm"),
            END: (names.MAV_SEVERITY_NOTICE, "collision alarm over"),
            BLIND: (names.MAV_SEVERITY_ERROR, "blind"),
            SEES: (names.MAV_SEVERITY_NOTICE, "recovered"),
        }

    def __call__(self, answer: Answer) -> None:
        """Send an answer, after reading the messages that have come."""
        names, self._reason = self._names, answer.reason
        self._state = names.MAV_STATE_CRITICAL if answer.reason else names.MAV_STATE_ACTIVE
        if answer.event == BEGIN and self._is_to_brake:
            self._braking.begin()
        if answer.event == END:
            self._braking.end()
        if answer.frame is not None and answer.detection.alarm:
            self._alarm_s = answer.frame.captured_s
        self.beat()
        if answer.is_of_frame or answer.event in self._texts:
            self._send_threat(answer)
            self._send_values(answer)
        if answer.event in self._texts:
            severity, text = self._texts[answer.event]
            detail = f" ({answer.reason})" if answer.event == BLIND else ""
            if answer.event == BEGIN:
                side = answer.span.side if answer.span is not None else ""
                detail = f" ({answer.detection.rule}){side and ', '}{side}"
            self._tell(severity, f"{text}{detail}")
        if answer.event == RATE and not answer.report["protects"]:
            self._tell(names.MAV_SEVERITY_ERROR, in_words(answer.report))

    def beat(self) -> None:
        """Read messages, and repeat a command or send a heartbeat if due."""
        self._read()
        now_s, state = time.monotonic(), {**self._pilot.to_dict(), **self._peers.facts()}
        if self._is_to_brake:
            state |= self._step_stop()
        self._reports.speed_m_s = self._pilot.speed_m_s
        self._reports.motion = self._pilot.move()
        self._reports.attitude = self._pilot.attitude
        self._ask(now_s)
        is_early = now_s - self._begin_s < HEARD_S and not self._pilot.is_heard
        if state != self._reported and not is_early:
            self._reported = state
            self._report(AUTOPILOT, **state, **self._at_speed())
        self._braking.step(self._objection())
        if now_s - self._beat_s >= HEARTBEAT_S:
            self._beat_s = now_s
            self._send_heartbeat(self._state)
            self._ask_who_is_there()

    def close(self) -> None:
        """Send that the watch has ended, and close the link."""
        for flaw, n in self._dropped.items():
            _log.warning("%s: dropped %s: %s", argument("mavlink"), counted(n, "message"), flaw)
        try:
            self._tell(self._names.MAV_SEVERITY_WARNING, "the watch has ended")
            self._send_heartbeat(self._names.MAV_STATE_POWEROFF)
        finally:
            self._link.close()

    def _report(self, event: str, **facts: Json) -> None:
        self._reports.append((event, facts))
        text = ", ".join(f"{name} {value}" for name, value in facts.items())
        _log.info("%s: %s: %s.", argument("mavlink"), event, text)

    def write(self, data: bytes) -> None:
        """Send a message: a command to the autopilot, any other message to all heard senders."""
        self._link.write(data, self._peers.heard() if self._towards is None else self._towards)

    def _objection(self) -> str:
        """A reason not to command now that does not come from the autopilot; empty for none."""
        # What an alarm has raised is right, also if the expansion is not measured after it.
        if self._reason not in ("", UNMEASURED):
            return f"blind, {self._reason}"
        if self._peers.kinship() == AUTOPILOTS:
            return f"{AUTOPILOTS} of system {self._own[0]}"
        if time.monotonic() - self._alarm_s > _LATE_S:
            return f"the alarm is more than {_LATE_S:g} s old"
        return ""

    def _command(self, mode: Mode, n_before: int) -> None:
        """Command a mode of the autopilot, and request a heartbeat, which states the mode."""
        names, flags = self._names, self._pilot.flags()
        self._order(names.MAV_CMD_DO_SET_MODE, (flags, mode.main, mode.sub), n_before)
        self._order(names.MAV_CMD_REQUEST_MESSAGE, (names.MAVLINK_MSG_ID_HEARTBEAT, 0, 0))

    def _ask(self, now_s: float) -> None:
        """Ask the autopilot for its motion once it is heard, and again while its motion is unknown.

        The rates hold until the autopilot restarts, and for this link alone.
        """
        names = self._names
        if not self._pilot.is_heard:
            self._asked_s = -math.inf
            return
        is_known = self._reports.motion is not None and self._asked_s > -math.inf
        if is_known or now_s - self._asked_s < _ASK_S:
            return
        self._asked_s = now_s
        for number in (
            names.MAVLINK_MSG_ID_ATTITUDE,
            names.MAVLINK_MSG_ID_LOCAL_POSITION_NED,
            names.MAVLINK_MSG_ID_GLOBAL_POSITION_INT,
        ):
            self._order(names.MAV_CMD_SET_MESSAGE_INTERVAL, (number, _MOTION_US, 0))

    def _ask_who_is_there(self) -> None:
        """If several addresses speak as the autopilot, ask each for its clock, see `Peers`."""
        names, speakers = self._names, self._peers.speakers()
        if len(speakers) > 1:
            command, clock = names.MAV_CMD_REQUEST_MESSAGE, names.MAVLINK_MSG_ID_SYSTEM_TIME
            with self._only_to(speakers):
                self._mav.command_long_send(*self._target, command, 0, clock, 0, 0, 0, 0, 0, 0)

    def _step_stop(self) -> dict[str, Json]:
        """Find out how the autopilot stops; returns the entries for the event."""
        self._stop.step()
        self._reports.brake = self._stop.brake
        if line := self._stop.warning():
            _log.warning("%s: %s", argument("mavlink"), line)
        for mode in self._pilot.brakes:
            if mode.follows_throttle:
                what = "with a throttle stick at the bottom, the drone sinks"
                self._warn_once(f"in {mode.name}, {what}; put it into the middle")
        return self._stop.facts() if self._pilot.is_heard else {}

    def _at_speed(self) -> dict[str, Json]:
        """How long before contact an alarm must begin at the present speed, if both are known."""
        brake, speed_m_s = self._stop.brake, self._pilot.speed_m_s
        if brake is None or math.isnan(speed_m_s):
            return {}
        return {"stop_s": round(brake.stop_s(speed_m_s), 2)}

    def _ask_parameter(self, name: str) -> None:
        with self._only_to(self._peers.speakers()[:1]):
            self._mav.param_request_read_send(*self._target, name.encode(), -1)

    def _order(self, command: int, numbers: tuple[int, int, int], n_before: int = 0) -> None:
        """Send a command with its first three parameters to the autopilot alone."""
        with self._only_to(self._peers.speakers()[:1]):
            self._mav.command_long_send(*self._target, command, n_before, *numbers, 0, 0, 0, 0)

    @contextmanager
    def _only_to(self, peers: Sequence[Peer]) -> Iterator[None]:
        """Send to these senders alone meanwhile."""
        self._towards = [peer.place for peer in peers]
        try:
            yield
        finally:
            self._towards = None

    def _say(self, text: str, is_critical: bool) -> None:
        """Tell the pilot about the progress of the brake command."""
        names = self._names
        self._tell(names.MAV_SEVERITY_CRITICAL if is_critical else names.MAV_SEVERITY_WARNING, text)

    def _tell(self, severity: int, text: str) -> None:
        """Send a text, as several STATUSTEXT with one identifier if it is too long for one."""
        data, number = f"dlgmd: {text}".encode(), 0
        if len(data) > _TEXT_BYTES:
            self._n_long = number = self._n_long % _MOST_TEXTS + 1
            data += b"\0"  # marks the end, also if the last part is full
        for place, first in enumerate(range(0, len(data), _TEXT_BYTES)):
            part = data[first : first + _TEXT_BYTES]
            self._mav.statustext_send(severity, part, number, place)

    def _read(self) -> None:
        """Process the messages that have come, within the time limit."""
        until_s = time.monotonic() + _READ_S
        for place, data in self._link.read():
            peer = self._peers.of(place)
            try:
                for message in peer.parser.parse_buffer(data) or ():
                    self._take(message, peer)
            except Exception:  # pymavlink may raise anything for damaged messages
                self._n_nonsense += len(data)
            if time.monotonic() >= until_s:
                break
        if self._n_nonsense > _NONSENSE:
            self._warn_once("what comes back is not MAVLink; check the rate of the port")
        if (speed := self._pilot.odd_speed_m_s) > MAX_SPEED_M_S:
            what = f"the autopilot reports {speed:g} m/s"
            self._warn_once(f"{what}; speeds beyond {MAX_SPEED_M_S:g} m/s are ignored")

    def _take(self, message: Any, peer: Peer) -> None:
        """Process a message from a sender."""
        if message.get_type() == "BAD_DATA":
            self._n_nonsense += len(message.data)
            return
        if flaw := self._signing.flaw(message):
            self._drop(message, peer, flaw)
            return
        peer.heard_s = time.monotonic()
        if self._pilot.is_from(message):
            if not self._peers.take(peer, message, is_beat=self._pilot.is_beat(message)):
                return
            self._pilot.step(message)
            if message.get_type() == "COMMAND_ACK":
                self._take_answer(message)
        elif self._pilot.is_of_another(message) and not self._pilot.is_heard:
            what = f"an autopilot of system {message.get_srcSystem()} is heard"
            self._warn_once(f"{what}; {argument('mavlink_system')} says which one to command")

    def _drop(self, message: Any, peer: Peer, flaw: str) -> None:
        """Count a message that the key does not vouch for, and report each flaw once."""
        if message.get_type() in _OF_RADIOS:
            return
        self._dropped[flaw] += 1
        if flaw == OLD:
            peer.heard_s = time.monotonic()
        if self._dropped[flaw] == 1:
            self._report(UNSIGNED, why=flaw, address=peer.name)

    def _warn_once(self, text: str) -> None:
        if self._told.is_new(text.partition(";")[2]):
            _log.warning("%s: %s", argument("mavlink"), text)

    def _take_answer(self, message: Any) -> None:
        """Process the answer to the brake command; other answers are not for this program."""
        names = self._names
        target = message.target_system, message.target_component
        is_ours = all(number in (0, own) for number, own in zip(target, self._own, strict=True))
        if is_ours and message.command == names.MAV_CMD_DO_SET_MODE:
            known = names.enums["MAV_RESULT"].get(message.result)
            name = known.name.removeprefix("MAV_RESULT_") if known else str(message.result)
            self._braking.answer(name)

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
        self._signing.tick()
        kind, pilot = names.MAV_TYPE_ONBOARD_CONTROLLER, names.MAV_AUTOPILOT_INVALID
        self._mav.heartbeat_send(kind, pilot, 0, 0, state)
