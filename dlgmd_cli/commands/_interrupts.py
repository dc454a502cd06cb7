"""Ctrl-C that loses nothing: it ends the computing, and never the writing."""

from collections.abc import Callable
from pathlib import Path
from types import FrameType

import click

from dlgmd_cli.commands._console import EXIT_INTERRUPTED, say
from dlgmd_cli.stops import Stops, put_off


class Interrupts(Stops):
    """Context manager that takes over Ctrl-C, and with it SIGTERM and SIGHUP.

    The first one raises KeyboardInterrupt, as ever, unless `hold` was called before; those after
    it, and all after `hold`, are only counted. Entered before anything that is to be cleaned up,
    it keeps the cleaning from being interrupted, too.

    Attributes
    ----------
    count : int
        How many there were.
    spared_plots : bool
        Whether one of them kept a plot from being drawn.
    """

    def __init__(self) -> None:
        super().__init__(self._handle)
        self.count = 0
        self.spared_plots = False
        self._raises = True

    def hold(self) -> None:
        """From now on, only count."""
        self._raises = False

    def ends(self, work: Callable[[], None], n_kept: Callable[[], int]) -> bool:
        """Do `work`, then `hold`; False if a Ctrl-C ended it, with at least one frame computed."""
        try:
            work()
            self.hold()  # what comes between here and the writing would lose everything
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
        if self._raises and put_off(number, frame):
            return
        self.count += 1
        if self._raises:
            self._raises = False
            raise KeyboardInterrupt

    def __enter__(self) -> "Interrupts":
        super().__enter__()
        return self
