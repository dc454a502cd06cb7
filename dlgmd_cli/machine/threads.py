"""Threads that this process may use, threads that it starts, and its environment."""

import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

from dlgmd_cli.errors import DlgmdError

_limit: int | None = None


def n_processors() -> int:
    """Number of processors available to this process."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def limit_threads(count: int | None) -> None:
    """Use at most `count` threads from now on; None allows one per processor."""
    global _limit
    _limit = count


def thread_limit() -> int | None:
    """The limit last set by `limit_threads`."""
    return _limit


def n_threads() -> int:
    """Number of threads to use: one per processor, within the limit, if they can be started."""
    count = min(n_processors(), _limit or n_processors())
    return count if can_start(count) else 1


def can_start(count: int) -> bool:
    """Whether the system lets this process start `count` threads now.

    Where it does not, FFmpeg decodes to black images and says nothing.
    """
    end = threading.Event()
    with ThreadPoolExecutor(count) as pool:
        try:
            for _ in range(count if count > 1 else 0):
                pool.submit(end.wait)
        except (RuntimeError, MemoryError):
            return False
        finally:
            end.set()
    return True


def started_thread(target: Callable[[], object], name: str) -> threading.Thread:
    """A running daemon thread; raises DlgmdError where the system allows no more of them."""
    thread = threading.Thread(target=target, name=name, daemon=True)
    try:
        thread.start()
    except RuntimeError:
        why = "the system allows no more threads"
        raise DlgmdError("", why, "Raise the limit (ulimit -u), or end other programs.") from None
    return thread


@contextmanager
def environment(name: str, value: str) -> Iterator[None]:
    """Set a variable of the environment inside the context."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            os.environ.pop(name, None)
        else:
            os.environ[name] = before
