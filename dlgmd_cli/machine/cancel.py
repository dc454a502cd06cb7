"""The stop flag: the first signal asks every loop to stop, the second ends the program at once."""

import os
import signal
from types import FrameType
from typing import Any

EXIT_INTERRUPTED = 130

_requested = _terminated = False


class Interrupted(Exception):  # noqa: N818, stopping is not an error
    """The user asked to stop; unfinished work is discarded."""


def listen() -> None:
    """Make Ctrl-C, `kill` and a closed terminal set the flag; for programs, not for libraries.

    An ignored SIGTERM or SIGHUP stays ignored: `nohup` depends on this.
    """
    _set_handlers(_request)


def ignore() -> None:
    """Ignore signals from now on: the work is done, and Python must shut down undisturbed."""
    _set_handlers(signal.SIG_IGN)


def _set_handlers(handler: Any) -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and (
            name == "SIGINT" or signal.getsignal(number) is not signal.SIG_IGN
        ):
            signal.signal(number, handler)


def requested() -> bool:
    """Whether the user asked to stop."""
    return _requested


def terminated() -> bool:
    """Whether SIGTERM or SIGHUP asked to stop, as a service manager or a closed terminal does."""
    return _terminated


def check() -> None:
    """Raise Interrupted if the user asked to stop."""
    if _requested:
        raise Interrupted


def _request(number: int, frame: FrameType | None) -> None:
    global _requested, _terminated
    if _requested:
        os._exit(EXIT_INTERRUPTED)
    _terminated = number != signal.SIGINT
    _requested = True
