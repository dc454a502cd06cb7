"""How many threads decoders and models may keep busy at once, in this process."""

import os

_limit: int | None = None


def n_processors() -> int:
    """How many processors this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def limit_threads(count: int | None) -> None:
    """From now on, use so many at most; None for as many as there are processors."""
    global _limit
    _limit = count


def thread_limit() -> int | None:
    """What `limit_threads` said last."""
    return _limit


def n_threads() -> int:
    """How many threads are worth having."""
    return min(n_processors(), _limit or n_processors())
