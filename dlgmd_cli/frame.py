"""Images, and frames in the form that models take."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

# Images, (H, W) or (H, W, 3): of any type; grey and BGR levels 0..255; levels between 0 and 1.
Image = npt.NDArray[Any]
GreyImage = npt.NDArray[np.uint8]
BgrImage = npt.NDArray[np.uint8]
FloatImage = npt.NDArray[np.float32]
# The levels of black and white of an image's samples, and those of 8 bits.
Levels = tuple[int, int]
FULL: Levels = (0, 255)
# Numbers, one per frame, cell or point; arrays of numbers; booleans, one per frame, cell or point.
Series = npt.NDArray[np.float64]
FloatArray = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# The expansion is measured on images of at most this width (px), whatever the model's frame size.
SMALL_PX = 240


def runs_of(flags: Flags) -> npt.NDArray[np.intp]:
    """The first row of every run of flagged rows, and the row after its last; shape (n, 2)."""
    return np.flatnonzero(np.diff(flags, prepend=False, append=False)).reshape(-1, 2)


@dataclass(frozen=True)
class Frame:
    """A frame in the form that models take.

    Attributes
    ----------
    index : int
        Number of the frame in its source, from 0.
    time_s : float
        Time of the frame in seconds; NaN if unknown.
    grey : ndarray, shape (H, W)
        uint8 levels 0..255 if the source has 8 bits, else float32 in 0..1.
    is_repeat : bool
        Whether the frame is a duplicate of the previous one, see `RepeatDetector`, and is skipped.
    after_gap : bool
        Whether frames are missing before the frame, see `GapDetector`.
    picture : ndarray, shape (height, width, 3), uint8, or None
        The image in BGR, if requested.
    captured_s : float
        Arrival time by `time.monotonic`, in seconds, if the source is live; else NaN.
    small : ndarray, shape (h, w), or None
        The frame at the size of `small_wh`, on which the expansion is measured, if requested.
    others : mapping of (int, int) to ndarray
        The frame at further sizes (width, height), for models that need another size.
    """

    index: int
    time_s: float
    grey: Image
    is_repeat: bool = False
    after_gap: bool = False
    picture: npt.NDArray[np.uint8] | None = None
    captured_s: float = math.nan
    small: Image | None = None
    others: Mapping[tuple[int, int], Image] = field(default_factory=dict)

    def at(self, size_wh: tuple[int, int] | None) -> Image:
        """The grey frame at a requested size; for None or an unknown size, `grey`."""
        return self.grey if size_wh is None else self.others.get(size_wh, self.grey)

    @property
    def luminance(self) -> npt.NDArray[np.float32]:
        """The grey frame as float32 in 0..1, shape (H, W)."""
        if self.grey.dtype != np.uint8:
            return self.grey
        return np.divide(self.grey, np.float32(255.0), dtype=np.float32)

    def in_place_of(self, dropped: "Frame") -> "Frame":
        """This frame if `dropped` is left out: a repeat if both are, after a gap if either is."""
        is_repeat = self.is_repeat and dropped.is_repeat
        return replace(self, is_repeat=is_repeat, after_gap=self.after_gap or dropped.after_gap)


def small_wh(width: int, height: int) -> tuple[int, int]:
    """Width and height at which the expansion of an image is measured, in px."""
    scale = min(1.0, SMALL_PX / width)
    return max(1, round(width * scale)), max(1, round(height * scale))
