"""Reading ahead: the next frames are decoded in a thread while the model works on this one."""

import queue
import threading
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Generic, TypeVar

import cv2

from dlgmd_cli.video.frames import KEPT_PICTURES

ItemT = TypeVar("ItemT")

# One picture waits to be put, and one is worked on while the next is asked for.
DEPTH = KEPT_PICTURES - 3
# How long a decoder may take over one frame before a stop no longer waits for it.
PATIENCE_S = 10.0


class ReadAhead(Generic[ItemT]):
    """The items of an iterable, in order, taken from it by a thread of its own.

    A context manager. The thread is never more than `depth` items ahead. What the iterable raises
    is raised here, after the items before it. Leaving the context, for whatever reason, stops the
    thread.

    Parameters
    ----------
    items : iterable
        Iterated in the thread, and in no other meanwhile.
    depth : int
        Items that wait at most.
    """

    def __init__(self, items: Iterable[ItemT], depth: int = DEPTH) -> None:
        self._items = items
        self._queue: queue.Queue[tuple[ItemT | None, BaseException | None]] = queue.Queue(depth)
        self._stopped = threading.Event()
        # A daemon: a decoder that hangs must not keep the program from ending.
        self._thread = threading.Thread(target=self._fill, name="dlgmd-decode", daemon=True)

    def _fill(self) -> None:
        """Put every item, then the end or the error, unless told to stop."""
        error: BaseException | None = None
        try:
            for item in self._items:
                if not self._put((item, None)):
                    return
        except BaseException as caught:  # handed to the other thread, whatever it is
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
    """OpenCV's own threads for as long as a run takes; then the host's number again."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
