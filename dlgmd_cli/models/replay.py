"""A recorded input, looked at again by one model after another; P is not computed anew."""

import math
from collections.abc import Sequence

from dlgmd_cli.models.base import Grey
from dlgmd_cli.models.history import History


class Replay:
    """A `View` of frames whose P is known.

    Parameters
    ----------
    frames : ndarray, shape (n, H, W), uint8 or float32
        The frames; may be a memory map.
    changes : ndarray, shape (n, H, W), of the same type
        P(t) of every frame, in the same levels; the first is not looked at.
    p_sums : sequence of float
        ΣP(t) of every frame, in units of luminance.
    """

    def __init__(self, frames: Grey, changes: Grey, p_sums: Sequence[float]) -> None:
        self._frames, self._p_sums = frames, p_sums
        self.history = History.of(changes)
        self.frame = -1

    def __len__(self) -> int:
        return len(self._frames)

    def rewind(self) -> None:
        """Go back to before the first frame."""
        self.frame = -1

    def advance(self) -> None:
        """Go on to the next frame."""
        self.frame += 1
        self.history.go_to(self.frame)

    @property
    def current(self) -> Grey:
        """The frame that is looked at."""
        frame: Grey = self._frames[self.frame]
        return frame

    @property
    def previous(self) -> Grey:
        """The frame before it."""
        frame: Grey = self._frames[self.frame - 1]
        return frame

    def p_sum(self, delay: int) -> float:
        """ΣP(t - delay) in units of luminance, NaN where it is not defined."""
        return self._p_sums[self.frame - delay] if delay < self.frame else math.nan
