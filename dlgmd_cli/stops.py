"""The signals that ask a program to end: Ctrl-C, `kill`, and a terminal that is closed."""

import _thread
import contextlib
import signal
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

Handler = Callable[[int, FrameType | None], Any] | signal.Handlers

STOPS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)

_AGAIN_AFTER_S = 0.01
# How long a signal is put off at most.
PATIENCE_S = 5.0

# When each of those that were put off came first.
_asked_s: dict[int, float] = {}


def answer(handler: Handler) -> dict[int, Any]:
    """Let `handler` answer them from now on, and return what did before.

    SIGTERM and SIGHUP stay ignored where they are: so `nohup` works. In any thread but the main
    one nothing is changed, since Python allows it there alone.
    """
    before: dict[int, Any] = {}
    for number in STOPS:
        found = signal.getsignal(number)
        # None: it is answered by something that is not Python, and could not be put back.
        if found is None or (found is signal.SIG_IGN and number != signal.SIGINT):
            continue
        try:
            before[number] = signal.signal(number, handler)
        except ValueError:  # another thread
            break
    return before


class Stops:
    """Context manager: `handler` answers the signals, and afterwards what did before."""

    def __init__(self, handler: Handler) -> None:
        self._handler = handler
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "Stops":
        self._before = answer(self._handler)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def interrupt(number: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt as an answer, as soon as it can do no harm."""
    if not put_off(number, frame):
        raise KeyboardInterrupt


def put_off(number: int, frame: FrameType | None) -> bool:
    """Whether an exception raised in `frame` could do harm; if so, the signal comes again soon.

    An import that is broken off at the wrong moment keeps its lock for ever: whatever other thread
    imports something hangs, and so does whoever waits for that. What is being entered would not be
    left, what is being left would not be cleaned up, and nothing gets out of `__del__`.
    """
    now_s = time.monotonic()
    if not _is_delicate(frame):
        _asked_s.pop(number, None)
        return False
    if now_s - _asked_s.setdefault(number, now_s) > PATIENCE_S:
        return False
    _thread.start_new_thread(_send_later, (number, _thread.get_ident()))
    return True


def _is_delicate(frame: FrameType | None) -> bool:
    """Whether something is being imported, entered, left or deleted."""
    # Only its innermost steps: what a generator does before it yields is code like any other.
    if frame is not None and frame.f_code.co_filename == contextlib.__file__:
        return True
    while frame is not None:
        name, file = frame.f_code.co_name, frame.f_code.co_filename
        if name in ("__exit__", "__del__") or file.startswith("<frozen importlib"):
            return True
        if name == "__enter__" and file != contextlib.__file__:
            return True
        frame = frame.f_back
    return False


def _send_later(number: int, thread: int) -> None:
    """Send the signal once more."""
    time.sleep(_AGAIN_AFTER_S)
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(thread, number)
    else:
        _thread.interrupt_main(signal.Signals(number))
