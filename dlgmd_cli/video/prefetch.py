"""Reading ahead: a thread decodes the next frames while the model works on this one."""

import queue
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import cv2

ItemT = TypeVar("ItemT")

# Frames that wait at most.
DEPTH = 3
# How long leaving the context waits for a decoder to finish its frame.
PATIENCE_S = 10.0


class ReadAhead(Generic[ItemT]):
    """The items of an iterable, in order, taken from it by a thread of its own.

    A context manager. The thread is at most `depth` items ahead. An exception of the iterable is
    raised here, after the items before it. Leaving the context stops the thread.

    Parameters
    ----------
    items : iterable
        Iterated in that thread only.
    depth : int
        The greatest number of items that wait.
    """

    def __init__(self, items: Iterable[ItemT], depth: int = DEPTH) -> None:
        self._items = items
        self._queue: queue.Queue[tuple[ItemT | None, BaseException | None]] = queue.Queue(depth)
        self._stopped = threading.Event()
        # A daemon: a decoder that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._fill, name="dlgmd-decode", daemon=True)

    def _fill(self) -> None:
        """Put every item, then the end or the error, until told to stop."""
        error: BaseException | None = None
        try:
            for item in self._items:
                if not self._put((item, None)):
                    return
        except BaseException as caught:  # the other thread raises it, whatever it is
            error = caught
        self._put((None, error))

    def _put(self, entry: tuple[ItemT | None, BaseException | None]) -> bool:
        """Wait for room; False if told to stop."""
        while not self._stopped.is_set():
            try:
                self._queue.put(entry, timeout=0.1)
            except queue.Full:
                continue
            return True
        return False

    def __iter__(self) -> Iterator[ItemT]:
        while True:
            item, error = self._queue.get()
            if error is not None:
                raise error
            if item is None:
                return
            yield item

    def __enter__(self) -> "ReadAhead[ItemT]":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stopped.set()
        self._thread.join(PATIENCE_S)


@contextmanager
def opencv_threads(count: int) -> Iterator[None]:
    """While it lasts, OpenCV uses `count` threads of its own; then as many as before."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
