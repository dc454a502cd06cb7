"""Receivers of alarms and events: lines of JSON, UDP, MAVLink and programs, each in a thread."""

import ipaddress
import json
import logging
import math
import os
import re
import shlex
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import MissingExtraError, ParameterError
from dlgmd_cli.live.watch import BEGIN, BLIND, END, SEES, Answer
from dlgmd_cli.machine import cancel
from dlgmd_cli.video.live import started_thread

Deliver = Callable[[Answer], None]
_log = logging.getLogger(__name__)

# Answers that wait for a receiver; the oldest are dropped.
_MAX_WAITING = 64
# Programs that may run at once.
_MAX_RUNNING = 8
_HEARTBEAT_S = 1.0
# Pause before a lost serial port is opened again.
_AGAIN_S = 1.0
# MAVLink's number of the drone that this is a part of.
_SYSTEM = 1
# How long the last deliveries may take at the end, after Ctrl-C and without it.
_INTERRUPTED_S, _PATIENCE_S = 0.2, 2.0


class Receiver:
    """Delivers answers to a receiver in a thread of its own, so that it never delays a frame.

    A failure is logged once for each reason; the next answer is delivered all the same. If the
    receiver is slow, the oldest answers are dropped.

    Parameters
    ----------
    name : str
        Option that asked for it, for messages.
    deliver : callable
        Called with one answer after the other; may block or raise. Its method `close`, if it has
        one, is called at the end, and `beat`, if it has one, after each second without an answer.
    only_events : bool
        Deliver only answers with an event.
    """

    def __init__(self, name: str, deliver: Deliver, *, only_events: bool = False) -> None:
        self._name, self._deliver, self._only_events = name, deliver, only_events
        self._waiting: deque[Answer] = deque()
        self._changed, self._is_closed = threading.Condition(), False
        self._logged: set[str] = set()
        self._thread = started_thread(self._work, f"dlgmd-{name}")

    def put(self, answer: Answer) -> None:
        """Queue an answer; returns at once."""
        if self._only_events and not answer.event:
            return
        with self._changed:
            if len(self._waiting) == _MAX_WAITING:
                self._waiting.popleft()
                self._log_once("the receiver is too slow; answers are dropped")
            self._waiting.append(answer)
            self._changed.notify()

    def close(self) -> None:
        """Accept no more answers; those that wait are still delivered."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def wait(self, until_s: float) -> None:
        """Wait for that, up to a time of `time.monotonic`; logs what is left."""
        self._thread.join(max(0.0, until_s - time.monotonic()))
        if self._thread.is_alive():
            self._log_once("the receiver did not take everything in time")

    def _work(self) -> None:
        beat = getattr(self._deliver, "beat", None)
        while True:
            with self._changed:
                pause_s = _HEARTBEAT_S if beat else None
                self._changed.wait_for(lambda: self._waiting or self._is_closed, pause_s)
                if not self._waiting and self._is_closed:
                    break
                answer = self._waiting.popleft() if self._waiting else None
            try:
                if answer is not None:
                    self._deliver(answer)
                elif beat:
                    beat()
            except Exception as error:
                self._log_once(str(error) or type(error).__name__)
        getattr(self._deliver, "close", lambda: None)()

    def _log_once(self, why: str) -> None:
        if why not in self._logged:
            self._logged.add(why)
            _log.warning("%s: %s", self._name, why)


def finish(outputs: Sequence[Receiver]) -> None:
    """Deliver what waits, within 2 s at most, or 0.2 s after Ctrl-C."""
    for output in outputs:
        output.close()
    until_s = time.monotonic() + (_INTERRUPTED_S if cancel.requested() else _PATIENCE_S)
    for output in outputs:
        output.wait(until_s)


def lines_on_stdout(give_up: Callable[[], None]) -> Deliver:
    """Writes each answer as a line of JSON; calls `give_up` when stdout was closed by its reader.

    The lines bypass Python's buffer, which would have to be emptied at the end, reader or not.
    """
    buffer: Any = sys.stdout.buffer
    stream = getattr(buffer, "raw", buffer)

    def deliver(answer: Answer) -> None:
        data = memoryview(f"{answer.to_json()}\n".encode())
        try:
            while data:
                n_written = stream.write(data)
                if n_written is None:  # it does not block, and is full
                    time.sleep(0.01)
                data = data[n_written or 0 :]
        except BrokenPipeError:
            give_up()

    return deliver


class Datagrams:
    """Sends each answer as JSON in a datagram to ``HOST:PORT``, from one socket.

    Raises
    ------
    ParameterError
        If this is not such an address, or the host cannot be found.
    """

    def __init__(self, address: str) -> None:
        host, port = split_address(address, "--udp")
        try:
            found = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError):  # the latter for names that are not valid
            why = f"the host {host!r} cannot be found"
            raise ParameterError("--udp", why, "Give a name or an address that exists.") from None
        family, kind, protocol, _, target = found[0]
        self._target: Any = target
        self._socket = socket.socket(family, kind, protocol)
        self.close = self._socket.close

    def __call__(self, answer: Answer) -> None:
        """Send a datagram."""
        self._socket.sendto(answer.to_json().encode(), self._target)


def split_address(text: str, option: str, host: str | None = None) -> tuple[str, int]:
    """``HOST:PORT`` as a host and a port, with the brackets of ``[::1]:8000`` removed.

    With a default `host`, this is an address to listen at: ``PORT`` alone, or the number of a host
    alone, will do, and port 0 is any free one.
    """
    if host:
        try:
            return str(ipaddress.ip_address(text.strip("[]"))), 0
        except ValueError:
            pass
    before, colon, port = text.rpartition(":")
    name = before.removeprefix("[").removesuffix("]") if colon else host
    least = 0 if host else 1
    if not name or not re.fullmatch("[0-9]{1,5}", port) or not least <= int(port) < 65536:
        form = "PORT or HOST:PORT" if host else "HOST:PORT"
        raise ParameterError(option, f"{text[:60]!r} is not {form}", "Write 127.0.0.1:5005.")
    return name, int(port)


class Programs:
    """Starts a program with each event, without a shell and without waiting for its end.

    The answer is in its environment: DLGMD_EVENT is `begin`, `end`, `blind` or `sees`, and
    DLGMD_FRAME, DLGMD_TIME_S and so on are the values of a line of JSON, as it has them: true, not
    True; null is empty. Its output goes to stderr.

    Raises
    ------
    ParameterError
        If there is no such program.
    """

    def __init__(self, command: str) -> None:
        try:
            self._arguments = shlex.split(command)
        except ValueError as error:
            raise ParameterError("--exec", f"{error}", "Check the quotation marks.") from None
        name = self._arguments[0] if self._arguments else ""
        if shutil.which(name) is None:
            if Path(name).is_file():
                why, mend = f"{name!r} is not executable", f"Allow it: chmod +x {shlex.quote(name)}"
                raise ParameterError("--exec", why, mend)
            raise ParameterError("--exec", f"there is no program {name!r}", "Check the path.")
        self._running: list[subprocess.Popen[bytes]] = []

    def __call__(self, answer: Answer) -> None:
        """Start the program."""
        for ended in [one for one in self._running if one.poll() is not None]:
            self._running.remove(ended)
            if ended.returncode:
                _log.warning("--exec: the program ended with exit code %d", ended.returncode)
        if len(self._running) == _MAX_RUNNING:
            raise RuntimeError(f"{_MAX_RUNNING} programs are still running; no more are started")
        facts = {f"DLGMD_{key.upper()}": value for key, value in answer.to_dict().items()}
        texts = {
            key: value if isinstance(value, str) else "" if value is None else json.dumps(value)
            for key, value in facts.items()
        }
        one = subprocess.Popen(
            self._arguments,
            env={**os.environ, **texts},
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,
            stderr=sys.__stderr__,
            start_new_session=True,  # Ctrl-C must not end it
        )
        self._running.append(one)


class Mavlink:
    """Sends MAVLink: COLLISION with a threat level, STATUSTEXT at events, and a heartbeat.

    The threat level of a frame is HIGH while the alarm is on, LOW at a spike, else NONE; frames
    without a threat are sent only after one with it. The time to contact is the model's estimate,
    NaN where it has none; distances are unknown, and NaN. The heartbeat goes on while no frame
    comes: its state is BOOT before the first answer, CRITICAL while the source shows nothing.

    Parameters
    ----------
    url : str
        ``udp://HOST:PORT`` or ``serial:///dev/ttyACM0:57600``. A serial port that is lost is opened
        again.

    Raises
    ------
    MissingExtraError
        If pymavlink is not installed, or pyserial for a serial port.
    ParameterError
        If the connection cannot be opened.
    """

    def __init__(self, url: str) -> None:
        try:
            from pymavlink import mavutil
        except ImportError:
            raise MissingExtraError.of("--mavlink", "pymavlink") from None
        self._names = names = mavutil.mavlink
        try:
            # pymavlink's own links print to stdout, and stay dead once they fail.
            link = _link(url)
        except (OSError, ValueError) as error:  # the latter for what is no address
            why = f"{url!r} cannot be opened ({error})"
            mend = "Write, for example, udp://127.0.0.1:14550."
            raise ParameterError("--mavlink", why, mend) from None
        self._mav = names.MAVLink(link, _SYSTEM, names.MAV_COMP_ID_OBSTACLE_AVOIDANCE)
        self.close = link.close
        self._level, self._beat_s, self._state = 0, -math.inf, names.MAV_STATE_BOOT
        self._texts = {
            BEGIN: (names.MAV_SEVERITY_CRITICAL, "collision alarm"),
            END: (names.MAV_SEVERITY_NOTICE, "collision alarm over"),
            BLIND: (names.MAV_SEVERITY_ERROR, "blind"),
            SEES: (names.MAV_SEVERITY_NOTICE, "sees again"),
        }

    def __call__(self, answer: Answer) -> None:
        """Send an answer."""
        names, found, send = self._names, answer.detection, self._mav
        self._state = names.MAV_STATE_CRITICAL if answer.reason else names.MAV_STATE_ACTIVE
        if time.monotonic() - self._beat_s >= _HEARTBEAT_S:
            self.beat()
        before, self._level = self._level, names.MAV_COLLISION_THREAT_LEVEL_NONE
        if found.alarm:
            self._level = names.MAV_COLLISION_THREAT_LEVEL_HIGH
        elif found.spike:
            self._level = names.MAV_COLLISION_THREAT_LEVEL_LOW
        if self._level or before:
            unknown = float("nan")
            send.collision_send(
                names.MAV_COLLISION_SRC_MAVLINK_GPS_GLOBAL_INT,
                _SYSTEM,
                names.MAV_COLLISION_ACTION_REPORT,
                self._level,
                *(found.ttc_s, unknown, unknown),
            )
        if answer.event:
            severity, text = self._texts[answer.event]
            detail = f" ({answer.reason})" if answer.event == BLIND else ""
            if answer.event == BEGIN and answer.span is not None and answer.span.side:
                detail = f", {answer.span.side}"
            send.statustext_send(severity, f"dlgmd: {text}{detail}".encode())

    def beat(self) -> None:
        """Send a heartbeat."""
        names, self._beat_s = self._names, time.monotonic()
        kind, pilot = names.MAV_TYPE_ONBOARD_CONTROLLER, names.MAV_AUTOPILOT_INVALID
        self._mav.heartbeat_send(kind, pilot, 0, 0, self._state)


class _Socket:
    """Sends datagrams to ``HOST:PORT``; raises OSError or ValueError."""

    def __init__(self, place: str) -> None:
        host, port = split_address(place, "--mavlink")
        self._target: Any
        family, kind, protocol, _, self._target = socket.getaddrinfo(
            host, port, type=socket.SOCK_DGRAM
        )[0]
        self._socket = socket.socket(family, kind, protocol)
        self.close = self._socket.close

    def write(self, data: bytes) -> None:
        """Send a message."""
        self._socket.sendto(data, self._target)


class _SerialPort:
    """Writes to a serial port, and opens it again after it was lost; raises OSError at first.

    A message that cannot be written is dropped. That the port is lost, and that it is back, are
    warnings.
    """

    def __init__(self, device: str, baud: int) -> None:
        try:
            import serial
        except ImportError:
            raise MissingExtraError.of("--mavlink", "pyserial") from None
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
            _log.warning("--mavlink: %s is lost (%s); trying again", self._device, error)
            self.close()

    def close(self) -> None:
        """Free the port."""
        port, self._port = self._port, None
        if port is not None:
            with suppress(OSError):
                port.close()

    def _is_back(self) -> bool:
        """Try to open the port again, once a second."""
        if time.monotonic() - self._tried_s < _AGAIN_S:
            return False
        self._tried_s = time.monotonic()
        try:
            self._port = self._open()
        except OSError:
            return False
        _log.warning("--mavlink: %s is back", self._device)
        return True


def _link(url: str) -> _Socket | _SerialPort:
    """What a URL leads to; raises ValueError or OSError."""
    scheme, _, place = url.partition("://")
    if scheme == "udp":
        return _Socket(place)
    if scheme != "serial":
        raise ValueError("only udp:// and serial:// are links")
    return _SerialPort(*serial_place(place))


def serial_place(place: str) -> tuple[str, int]:
    """``/dev/ttyACM0:57600`` as a device and its rate, which is 57600 if it is not given."""
    device, _, baud = place.rpartition(":")
    return (device, int(baud)) if device else (place, 57600)
