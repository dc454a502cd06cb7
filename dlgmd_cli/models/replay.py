"""A recorded input, looked at again by one model after another; P is not computed anew."""

import math
from collections.abc import Sequence

from dlgmd_cli.errors import FrameError
from dlgmd_cli.models.base import Grey
from dlgmd_cli.models.history import History


class Replay:
    """A `View` of frames whose P is known.

    Parameters
    ----------
    frames : ndarray, shape (n, H, W), uint8 or float32, or None
        The frames; may be a memory map. None where the models look at changes alone.
    changes : ndarray, shape (n, H, W), of the same type
        P(t) of every frame, in the same levels; the first is not looked at.
    p_sums : sequence of float
        ΣP(t) of every frame, in units of luminance.
    """

    def __init__(self, frames: Grey | None, changes: Grey, p_sums: Sequence[float]) -> None:
        self._frames, self._p_sums = frames, p_sums
        self.history = History.of(changes)
        self.rewind()

    def __len__(self) -> int:
        return len(self._p_sums)

    def rewind(self, first: int = 0) -> None:
        """Go back to before a frame, from which on they count from 0: one of several clips."""
        self.frame, self._first = -1, first

    def advance(self) -> None:
        """Go on to the next frame."""
        self.frame += 1
        self.history.go_to(self._first + self.frame)

    @property
    def current(self) -> Grey:
        """The frame that is looked at."""
        return self._at(self.frame)

    @property
    def previous(self) -> Grey:
        """The frame before it."""
        return self._at(self.frame - 1)

    def p_sum(self, delay: int) -> float:
        """ΣP(t - delay) in units of luminance, NaN where it is not defined."""
        return self._p_sums[self._first + self.frame - delay] if delay < self.frame else math.nan

    def _at(self, frame: int) -> Grey:
        """A frame of the clip."""
        if self._frames is None:
            raise FrameError("frame", "only its changes are on record")
        picture: Grey = self._frames[self._first + frame]
        return picture
