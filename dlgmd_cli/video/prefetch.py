"""Prefetching: a thread decodes the next frames while the model processes the current one."""

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, TypeVar

import cv2

ItemT = TypeVar("ItemT")


@contextmanager
def read_ahead(items: Iterable[ItemT], depth: int = 3) -> Iterator[Iterator[ItemT]]:
    """A context that yields the items in order while a thread fetches up to `depth` in advance.

    An exception from the iterable is raised after the items before it. Leaving the context waits
    for the item being fetched and fetches no more. Where the system refuses another thread, the
    items are fetched in this one.
    """
    iterator, end = iter(items), object()
    pool = ThreadPoolExecutor(1, thread_name_prefix="dlgmd-decode")

    def in_order() -> Iterator[ItemT]:
        try:
            waiting: deque[Any] = deque(pool.submit(next, iterator, end) for _ in range(depth))
        except RuntimeError:  # it cannot start a thread, and has fetched nothing
            yield from iterator
            return
        while (item := waiting.popleft().result()) is not end:
            waiting.append(pool.submit(next, iterator, end))
            yield item

    try:
        yield in_order()
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def opencv_threads(count: int) -> Iterator[None]:
    """Let OpenCV use `count` threads inside the context."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
