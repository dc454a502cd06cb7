"""The number of threads that decoders and models may use in this process."""

import os
import threading

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
    """Whether the system lets this process start so many threads now.

    Where it does not, FFmpeg decodes to black images and says nothing.
    """
    if count <= 1:
        return True
    end = threading.Event()
    started: list[threading.Thread] = []
    try:
        for _ in range(count):
            thread = threading.Thread(target=end.wait, daemon=True)
            thread.start()
            started.append(thread)
    except (RuntimeError, MemoryError):
        return False
    finally:
        end.set()
        for thread in started:
            thread.join()
    return True
