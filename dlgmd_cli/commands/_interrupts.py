"""Ctrl-C that loses nothing: it ends the computing, and never the writing."""

import signal
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any


class Interrupts:
    """Context manager that takes over SIGINT.

    The first one raises KeyboardInterrupt, as ever, unless `hold` was called before; those after
    it, and all after `hold`, are only counted.
    """

    def __init__(self) -> None:
        self.count = 0
        self._raises = True
        self._before: Any = None
        # Python lets only the main thread set handlers.
        self._can_act = threading.current_thread() is threading.main_thread()

    def hold(self) -> None:
        """From now on, only count."""
        self._raises = False

    def ends(self, work: Callable[[], None], n_kept: Callable[[], int]) -> bool:
        """Do `work`; False if a Ctrl-C ended it, with `n_kept` frames computed, at least one."""
        try:
            work()
        except KeyboardInterrupt:
            if n_kept() == 0:
                raise
            return False
        return True

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.count += 1
        if self._raises:
            self._raises = False
            raise KeyboardInterrupt

    def __enter__(self) -> "Interrupts":
        if self._can_act:
            self._before = signal.signal(signal.SIGINT, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        if self._can_act:
            signal.signal(signal.SIGINT, self._before)
