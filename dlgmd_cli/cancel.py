"""The stop flag: the first signal asks every loop to end, the second ends the program at once."""

import os
import signal
from types import FrameType
from typing import Any

EXIT_INTERRUPTED = 130

_requested = False


class Interrupted(Exception):  # noqa: N818, it is no error
    """The user asked to stop, and what was being computed cannot be kept."""


def listen() -> None:
    """Let Ctrl-C, `kill` and a closed terminal set the flag; for programs, not for libraries.

    SIGTERM and SIGHUP stay ignored where they are, so that `nohup` works.
    """
    _answer(_request)


def ignore() -> None:
    """Let signals do nothing from now on: all is done, and Python's own end must not be cut off."""
    _answer(signal.SIG_IGN)


def _answer(handler: Any) -> None:
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and (
            name == "SIGINT" or signal.getsignal(number) is not signal.SIG_IGN
        ):
            signal.signal(number, handler)


def requested() -> bool:
    """Whether the user asked to stop."""
    return _requested


def check() -> None:
    """Raise Interrupted if the user asked to stop."""
    if _requested:
        raise Interrupted


def _request(number: int, frame: FrameType | None) -> None:
    global _requested
    if _requested:
        os._exit(EXIT_INTERRUPTED)
    _requested = True
