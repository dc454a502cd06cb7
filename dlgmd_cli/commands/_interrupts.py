"""Ctrl-C that loses nothing: it ends the computing, and never the writing."""

import signal
import threading
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

import click

from dlgmd_cli.commands._console import EXIT_INTERRUPTED, say


class Interrupts:
    """Context manager that takes over SIGINT.

    The first one raises KeyboardInterrupt, as ever, unless `hold` was called before; those after
    it, and all after `hold`, are only counted.

    Attributes
    ----------
    count : int
        How many there were.
    spared_plots : bool
        Whether one of them kept a plot from being drawn.
    """

    def __init__(self) -> None:
        self.count = 0
        self.spared_plots = False
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

    def conclude(self, target: Path, n_frames: int, *, complete: bool) -> None:
        """Say what `target` holds after an interrupt, and exit as interrupted; else nothing."""
        if complete and not self.count:
            return
        kept = f"the {n_frames} frames before it"
        if complete:
            kept = "all frames, but not all plots" if self.spared_plots else "the whole result"
        say(f"{target} holds {kept}.")
        raise click.exceptions.Exit(EXIT_INTERRUPTED)

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
