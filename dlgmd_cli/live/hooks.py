"""Who hears the alarm: lines of JSON, UDP, MAVLink, and programs. None of them delays a frame."""

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
from typing import Any

from dlgmd_cli import cancel
from dlgmd_cli.errors import MissingExtraError, ParameterError
from dlgmd_cli.live.watch import BEGIN, Answer

Tell = Callable[[str], None]
Deliver = Callable[[Answer], None]

# Answers that wait for a receiver; the oldest are dropped.
_MAX_WAITING = 64
# Programs that may run at once.
_MAX_RUNNING = 8
_HEARTBEAT_S = 1.0
# How long what waits at the end may take, at Ctrl-C and without it.
_INTERRUPTED_S, _PATIENCE_S = 0.2, 2.0


class Hook:
    """Hands answers to a receiver on a thread of its own.

    What a receiver raises is told once; it is tried again with the next answer. If it is slow, the
    oldest answers are dropped.

    Parameters
    ----------
    name : str
        The option that asked for it, for messages.
    deliver : callable
        Called with one answer after the other; may block or raise.
    tell : callable
        Called with what goes wrong.
    only_events : bool
        Hand on only where an alarm begins or ends.
    """

    def __init__(
        self, name: str, deliver: Deliver, tell: Tell, *, only_events: bool = False
    ) -> None:
        self._name, self._deliver, self._tell = name, deliver, tell
        self._only_events = only_events
        self._waiting: deque[Answer] = deque()
        self._changed, self._is_closed = threading.Condition(), False
        self._told: set[str] = set()
        self._thread = threading.Thread(target=self._work, name=f"dlgmd-{name}", daemon=True)
        self._thread.start()

    def put(self, answer: Answer) -> None:
        """Leave an answer for the receiver; returns at once."""
        if self._only_events and not answer.event:
            return
        with self._changed:
            if len(self._waiting) == _MAX_WAITING:
                self._waiting.popleft()
                self._tell_once("the receiver is too slow; answers are dropped")
            self._waiting.append(answer)
            self._changed.notify()

    def close(self) -> None:
        """Take no more; what waits is still delivered."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def wait(self, until_s: float) -> None:
        """Wait for that, up to a time of `time.monotonic`; tell if something still waits."""
        self._thread.join(max(0.0, until_s - time.monotonic()))
        if self._thread.is_alive():
            self._tell_once("the receiver did not take everything in time")

    def _work(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_closed)
                if not self._waiting:
                    return
                answer = self._waiting.popleft()
            try:
                self._deliver(answer)
            except Exception as error:
                self._tell_once(str(error) or type(error).__name__)

    def _tell_once(self, why: str) -> None:
        if why not in self._told:
            self._told.add(why)
            self._tell(f"{self._name}: {why}")


def join(hooks: Sequence[Hook]) -> None:
    """Let hooks deliver what waits, as far as they can in a moment; less of one after Ctrl-C."""
    for hook in hooks:
        hook.close()
    until_s = time.monotonic() + (_INTERRUPTED_S if cancel.requested() else _PATIENCE_S)
    for hook in hooks:
        hook.wait(until_s)


def lines_on_stdout(give_up: Callable[[], None]) -> Deliver:
    """Writes each answer as a line of JSON; calls `give_up` when nobody reads them any more.

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


def datagrams(address: str) -> Deliver:
    """Sends each answer as JSON in a datagram to ``HOST:PORT``; raises ParameterError."""
    host, port = split_address(address, "--udp")
    try:
        family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    except (OSError, UnicodeError):  # the latter is of names that cannot be
        why = f"the host {host!r} cannot be found"
        raise ParameterError("--udp", why, "Give a name or an address that exists.") from None

    def deliver(answer: Answer) -> None:
        with socket.socket(family, kind, protocol) as sender:
            sender.sendto(answer.to_json().encode(), place)

    return deliver


def split_address(text: str, option: str, host: str | None = None) -> tuple[str, int]:
    """``HOST:PORT`` as a host and a port.

    With `host`, which is the one if none is given, it is where to listen: port 0 is any free one.
    """
    before, colon, port = text.rpartition(":")
    name = before.strip("[]") if colon else host
    least = 0 if host else 1
    if not name or not re.fullmatch("[0-9]{1,5}", port) or not least <= int(port) < 65536:
        form = "PORT or HOST:PORT" if host else "HOST:PORT"
        raise ParameterError(option, f"{text[:60]!r} is not {form}", "Write 127.0.0.1:5005.")
    return name, int(port)


class Programs:
    """Starts a program with each event, without a shell and without waiting for its end.

    The event is in its environment: DLGMD_EVENT is `begin` or `end`, and DLGMD_FRAME, DLGMD_TIME_S
    and so on are what a line of JSON has. What it prints goes to stderr.

    Raises
    ------
    ParameterError
        If there is no such program.
    """

    def __init__(self, command: str, tell: Tell) -> None:
        self._tell = tell
        try:
            self._arguments = shlex.split(command)
        except ValueError as error:
            raise ParameterError("--exec", f"{error}", "Check the quotation marks.") from None
        name = self._arguments[0] if self._arguments else ""
        if shutil.which(name) is None:
            raise ParameterError("--exec", f"there is no program {name!r}", "Check the path.")
        self._running: list[subprocess.Popen[bytes]] = []

    def __call__(self, answer: Answer) -> None:
        """Start the program."""
        for ended in [one for one in self._running if one.poll() is not None]:
            self._running.remove(ended)
            if ended.returncode:
                self._tell(f"--exec: the program ended with exit code {ended.returncode}")
        if len(self._running) == _MAX_RUNNING:
            raise RuntimeError(f"{_MAX_RUNNING} programs are still running; no more are started")
        facts = {f"DLGMD_{key.upper()}": value for key, value in answer.to_dict().items()}
        texts = {key: "" if value is None else str(value) for key, value in facts.items()}
        one = subprocess.Popen(
            self._arguments,
            env={**os.environ, **texts},
            stdin=subprocess.DEVNULL,
            stdout=2,
            start_new_session=True,  # Ctrl-C is for us, not for what it was told to do
        )
        self._running.append(one)


class Mavlink:
    """Sends MAVLink: COLLISION with a threat level, STATUSTEXT at events, and a heartbeat.

    The threat level of a frame is HIGH while the alarm is on, LOW at a spike, else NONE; frames
    without a threat are sent only after one with it. Times and distances are not known, and NaN.

    Parameters
    ----------
    url : str
        ``udp://HOST:PORT`` or ``serial:///dev/ttyACM0:57600``. There is no TCP: pymavlink waits
        where nobody answers, and prints to stdout.

    Raises
    ------
    MissingExtraError
        If pymavlink is not installed.
    ParameterError
        If the connection cannot be opened.
    """

    def __init__(self, url: str) -> None:
        try:
            from pymavlink import mavutil
        except ImportError:
            why = "the package 'pymavlink' is not installed"
            mend = "Install it with: pip install 'dlgmd[live]'."
            raise MissingExtraError("--mavlink", why, mend) from None
        self._names = mavutil.mavlink
        try:
            self._link = mavutil.mavlink_connection(
                **_connection(url),
                source_system=1,
                source_component=self._names.MAV_COMP_ID_OBSTACLE_AVOIDANCE,
            )
        except Exception as error:  # of sockets, of serial lines, and pymavlink's own
            why = f"{url!r} cannot be opened ({error})"
            mend = "Write, for example, udp://127.0.0.1:14550."
            raise ParameterError("--mavlink", why, mend) from None
        self._level, self._beat_s = 0, -_HEARTBEAT_S

    def __call__(self, answer: Answer) -> None:
        """Send what an answer says."""
        names, said, send = self._names, answer.said, self._link.mav
        if (now_s := time.monotonic()) - self._beat_s >= _HEARTBEAT_S:
            self._beat_s = now_s
            kind, pilot = names.MAV_TYPE_ONBOARD_CONTROLLER, names.MAV_AUTOPILOT_INVALID
            send.heartbeat_send(kind, pilot, 0, 0, names.MAV_STATE_ACTIVE)
        before, self._level = self._level, names.MAV_COLLISION_THREAT_LEVEL_NONE
        if said.alarm:
            self._level = names.MAV_COLLISION_THREAT_LEVEL_HIGH
        elif said.spike:
            self._level = names.MAV_COLLISION_THREAT_LEVEL_LOW
        if self._level or before:
            unknown = float("nan")
            send.collision_send(
                names.MAV_COLLISION_SRC_MAVLINK_GPS_GLOBAL_INT,
                self._link.source_system,
                names.MAV_COLLISION_ACTION_REPORT,
                self._level,
                *(unknown, unknown, unknown),
            )
        if answer.event:
            is_begin = answer.event == BEGIN
            severity = names.MAV_SEVERITY_CRITICAL if is_begin else names.MAV_SEVERITY_NOTICE
            text = "collision alarm" if is_begin else "collision alarm over"
            send.statustext_send(severity, f"dlgmd: {text}".encode())


def _connection(url: str) -> dict[str, Any]:
    """What pymavlink takes for a URL; raises ValueError."""
    scheme, _, place = url.partition("://")
    if scheme == "udp":
        return {"device": f"udpout:{place}"}
    if scheme != "serial":
        raise ValueError("only udp:// and serial:// are links")
    device, _, baud = place.rpartition(":")
    return {"device": device or place, "baud": int(baud) if device else 57600}
