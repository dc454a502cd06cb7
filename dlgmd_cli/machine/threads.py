"""The limit of this process's threads, and starting threads."""

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


def can_start(count: int) -> bool:
    """Whether the system lets this process start `count` threads now.

    If the system does not, FFmpeg decodes to black images without an error.
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
    """A running daemon thread; raises DlgmdError if the system allows no more threads."""
    thread = threading.Thread(target=target, name=name, daemon=True)
    try:
        thread.start()
    except RuntimeError:
        why = "the system allows no more threads"
        raise DlgmdError("", why, "Raise the limit (ulimit -u), or end other programs.") from None
    return thread


@contextmanager
def opencv_threads(count: int) -> Iterator[None]:
    """Let OpenCV use `count` threads inside the context."""
    import cv2  # takes a tenth of a second

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
