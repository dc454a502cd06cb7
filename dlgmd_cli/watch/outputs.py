"""Receivers of alarms and events (JSON lines, UDP, MAVLink, programs), each in its own thread."""

import ipaddress
import json
import logging
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
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import Once, ParameterError, argument
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import started_thread
from dlgmd_cli.watch.reports import Reports
from dlgmd_cli.watch.watch import OUTPUT_LOST, Answer

Deliver = Callable[[Answer], None]
_log = logging.getLogger(__name__)

# Maximum number of answers that wait for a receiver; the oldest are dropped.
MAX_WAITING = 64
# Maximum number of programs that run at once.
MAX_RUNNING = 8
# Time limit (s) of the last deliveries at the end, after Ctrl-C and without Ctrl-C.
_INTERRUPTED_S, PATIENCE_S = 0.2, 2.0


class Receiver:
    """Delivers answers in its own thread, so that a slow receiver never delays a frame.

    A failure is logged once per reason; further answers are still delivered. If the receiver is
    slow, the oldest answers are dropped, answers without an event first.

    Parameters
    ----------
    name : str
        Option that requested the receiver, for messages.
    deliver : callable
        Called with each answer in turn; may block or raise. Its method `close`, if any, is called
        at the end; its method `beat`, if any, when no answer has come for `PAUSE_S`.
    only_events : bool
        Whether only answers with an event are delivered.
    """

    def __init__(self, name: str, deliver: Deliver, *, only_events: bool = False) -> None:
        self._name, self._deliver, self._only_events = name, deliver, only_events
        self._waiting: deque[Answer] = deque()
        self._changed, self._is_closed = threading.Condition(), False
        self._logged = Once()
        self._thread = started_thread(self._work, f"dlgmd-{name}")

    def put(self, answer: Answer) -> None:
        """Queue an answer; returns at once."""
        if self._only_events and not answer.event:
            return
        with self._changed:
            if len(self._waiting) == MAX_WAITING:
                del self._waiting[next((n for n, a in enumerate(self._waiting) if not a.event), 0)]
                self._log_once("the receiver is too slow; answers are dropped")
            self._waiting.append(answer)
            self._changed.notify()

    def close(self) -> None:
        """Accept no more answers; waiting answers are still delivered."""
        with self._changed:
            self._is_closed = True
            self._changed.notify()

    def wait(self, until_s: float) -> None:
        """Wait for the last delivery until a time of `time.monotonic`; log if it is not done."""
        self._thread.join(max(0.0, until_s - time.monotonic()))
        if self._thread.is_alive():
            self._log_once("the receiver did not take everything in time")

    def _work(self) -> None:
        names = "beat", "PAUSE_S", "close"
        beat, pause_s, close = (getattr(self._deliver, name, None) for name in names)
        is_over = False
        while not is_over:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_closed, pause_s)
                is_over = not self._waiting and self._is_closed
                answer = self._waiting.popleft() if self._waiting else None
            try:
                if answer is not None:
                    self._deliver(answer)
                elif act := close if is_over else beat:
                    act()
            except Exception as error:
                self._log_once(str(error) or type(error).__name__)

    def _log_once(self, why: str) -> None:
        if self._logged.is_new(why):
            _log.warning("%s: %s", self._name, why)


def finish(outputs: Sequence[Receiver]) -> None:
    """Deliver waiting answers, within at most 2 s, or 0.2 s after Ctrl-C (2 s after SIGTERM)."""
    for output in outputs:
        output.close()
    is_hurried = cancel.requested() and not cancel.terminated()
    until_s = time.monotonic() + (_INTERRUPTED_S if is_hurried else PATIENCE_S)
    for output in outputs:
        output.wait(until_s)


def lines_on_stdout(reports: Reports) -> Deliver:
    """Writes each answer as a line of JSON; reports once that the reader has closed stdout.

    Lines bypass Python's buffer, which Python would flush at the end even without a reader.
    """
    # Python has no standard output if it was closed before the start (`>&-`).
    buffered = None if sys.stdout is None else sys.stdout.buffer
    stream, is_lost = getattr(buffered, "raw", buffered), False

    def deliver(answer: Answer) -> None:
        nonlocal is_lost
        data = memoryview(b"" if is_lost else f"{answer.to_json()}\n".encode())
        try:
            while data:
                if stream is None:
                    raise BrokenPipeError
                n_written = stream.write(data)
                if n_written is None:  # a non-blocking stream is full
                    time.sleep(0.01)
                data = data[n_written or 0 :]
        except BrokenPipeError:
            is_lost = True
            _log.warning("%s: nobody reads standard output any more", argument("jsonl"))
            reports.append((OUTPUT_LOST, {"output": "jsonl"}))

    return deliver


class Datagrams:
    """Sends each answer as a line of JSON in a datagram to ``HOST:PORT``, from one socket.

    Raises
    ------
    ParameterError
        If `address` is not ``HOST:PORT``, or the host cannot be found.
    """

    def __init__(self, address: str) -> None:
        host, port = split_address(address, argument("udp"))
        try:
            self._socket, self._target = datagram_socket(host, port)
        except (OSError, UnicodeError):  # UnicodeError: an invalid name
            why = f"the host {host!r} cannot be found"
            hint = "Give a name or an address that exists."
            raise ParameterError(argument("udp"), why, hint) from None
        self.close = self._socket.close

    def __call__(self, answer: Answer) -> None:
        """Send a datagram."""
        self._socket.sendto(f"{answer.to_json()}\n".encode(), self._target)


def datagram_socket(host: str, port: int) -> tuple[socket.socket, Any]:
    """A socket for datagrams, and the resolved address; raises OSError or UnicodeError."""
    family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_DGRAM)[0]
    return socket.socket(family, kind, protocol), place


def split_address(text: str, option: str, host: str | None = None) -> tuple[str, int]:
    """``HOST:PORT`` as a host and a port, with the brackets of ``[::1]:8000`` removed.

    With a default `host`, the text is an address to listen at: ``PORT`` or the IP address of a host
    suffices, and port 0 means any free port.
    """
    if host:
        with suppress(ValueError):
            return str(ipaddress.ip_address(text.strip("[]"))), 0
    before, colon, port = text.rpartition(":")
    name = before.removeprefix("[").removesuffix("]") if colon else host
    least = 0 if host else 1
    if not name or not re.fullmatch("[0-9]{1,5}", port) or not least <= int(port) < 65536:
        form = "PORT or HOST:PORT" if host else "HOST:PORT"
        raise ParameterError(option, f"{text[:60]!r} is not {form}", "Write 127.0.0.1:5005.")
    return name, int(port)


class Programs:
    """Starts a program with each event, without a shell and without waiting for its end.

    The program gets the answer as environment variables: DLGMD_EVENT is `begin`, `end`, `blind`,
    `sees` …; DLGMD_FRAME, DLGMD_TIME_S and so on are the values of a line of JSON, written as in
    JSON (true, not True), empty for null. The program's output goes to stderr.

    Raises
    ------
    ParameterError
        If there is no such program.
    """

    def __init__(self, command: str) -> None:
        try:
            self._arguments = shlex.split(command)
        except ValueError as error:
            hint = "Check the quotation marks."
            raise ParameterError(argument("exec"), f"{error}", hint) from None
        name = self._arguments[0] if self._arguments else ""
        if shutil.which(name) is None:
            why, hint = f"there is no program {name!r}", "Check the path."
            if Path(name).is_file():
                why, hint = f"{name!r} is not executable", f"Allow it: chmod +x {shlex.quote(name)}"
            raise ParameterError(argument("exec"), why, hint)
        self.running: list[subprocess.Popen[bytes]] = []

    def __call__(self, answer: Answer) -> None:
        """Start the program."""
        for ended in [program for program in self.running if program.poll() is not None]:
            self.running.remove(ended)
            if ended.returncode:
                what = "%s: the program ended with exit code %d"
                _log.warning(what, argument("exec"), ended.returncode)
        if len(self.running) == MAX_RUNNING:
            raise RuntimeError(f"{MAX_RUNNING} programs are still running; no more are started")
        facts = {key: "" if value is None else value for key, value in answer.to_dict().items()}
        texts = {
            f"DLGMD_{key.upper()}": value if isinstance(value, str) else json.dumps(value)
            for key, value in facts.items()
        }
        program = subprocess.Popen(
            self._arguments,
            env={**os.environ, **texts},
            stdin=subprocess.DEVNULL,
            stdout=sys.__stderr__,
            stderr=sys.__stderr__,
            start_new_session=True,  # Ctrl-C must not end the program
        )
        self.running.append(program)
