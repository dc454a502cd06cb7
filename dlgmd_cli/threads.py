"""The number of threads that decoders and models may use in this process."""

import os

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
    """Number of threads to use: one per processor, within the limit."""
    return min(n_processors(), _limit or n_processors())
