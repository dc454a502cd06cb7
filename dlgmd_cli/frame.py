"""A frame as models take it, its size and rate, and causal detection of repeats and gaps."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from statistics import median
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

# A gap exceeds this many median intervals; the median counts as MIN_USUAL_S at least.
GAP_INTERVALS, MIN_USUAL_S = 3.5, 1.0 / 30.0
# Number of recent intervals or changes that are kept, and the least number to judge by.
_N_USUAL, _N_AT_LEAST = 12, 3
# How far frames may exceed the rate of a model: nominal 30 frames/s can be up to 30.3.
RATE_TOLERANCE = 1.1
# Rows of a picture that are compared.
_N_ROWS = 90
# A repeat changes by less than `_SHARE` of the usual change. The picture that ends a run of repeats
# changes more than `_RISE` times as much as any of them.
_SHARE, _RISE = 0.25, 2.0
# A longer run of repeats is a still scene.
MAX_RUN = 11
# A reduction by this factor or more begins with a halving.
_FAR = 16


@dataclass(frozen=True)
class Frame:
    """A frame in the form that models take.

    Attributes
    ----------
    index : int
        Number of the frame in its source, from 0.
    time_s : float
        Its time in seconds; NaN if unknown.
    grey : ndarray, shape (H, W)
        uint8 levels 0..255 if the source has 8 bits, else float32 in 0..1.
    is_repeat : bool
        Whether it is a duplicate of the previous picture, see `RepeatDetector`; it is skipped.
    after_gap : bool
        Whether frames are missing before it, see `GapDetector`.
    picture : ndarray, shape (height, width, 3), uint8, or None
        The picture in BGR, if it was asked for.
    captured_s : float
        Time of its arrival by `time.monotonic`, if its source is live.
    others : mapping of (int, int) to ndarray
        The frame at further sizes (width, height), for models with sizes of their own.
    """

    index: int
    time_s: float
    grey: npt.NDArray[Any]
    is_repeat: bool = False
    after_gap: bool = False
    picture: npt.NDArray[np.uint8] | None = None
    captured_s: float = math.nan
    others: Mapping[tuple[int, int], npt.NDArray[Any]] = field(default_factory=dict)

    def at(self, size_wh: tuple[int, int] | None) -> npt.NDArray[Any]:
        """The grey frame at a size that was asked for; None stands for the first one."""
        return self.grey if size_wh is None else self.others.get(size_wh, self.grey)

    @property
    def luminance(self) -> npt.NDArray[np.float32]:
        """The same as float32 in 0..1, shape (H, W)."""
        if self.grey.dtype != np.uint8:
            return self.grey
        return np.divide(self.grey, np.float32(255.0), dtype=np.float32)


def resized(image: npt.NDArray[Any], size_wh: tuple[int, int]) -> npt.NDArray[Any]:
    """Resize a grey picture (H, W): area averages if it shrinks, else linear interpolation.

    OpenCV halves a picture seven times as fast as it divides the sides by 4 or by a fraction.
    Reduction by an even whole factor therefore begins with a halving. So does reduction by a factor
    of 16 or more, where the pixel pairs at the edges of an area hardly matter. Both steps round to
    whole levels: the result is within 1 of the exact mean, or within 1.25 for noise and a factor
    of 16.
    """
    width, height = size_wh
    sides = tuple(zip(image.shape, (height, width), strict=True))
    halves_well = all(old % 2 == 0 and old >= _FAR * new for old, new in sides)
    if halves_well or all(old % (2 * new) == 0 for old, new in sides):
        half = image.shape[1] // 2, image.shape[0] // 2
        # From a copy: reading two rows at once, as halving does, is slow outside the cache.
        image = cv2.resize(image.copy(), half, interpolation=cv2.INTER_AREA)
    if (image.shape[1], image.shape[0]) == size_wh:
        return image
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    return cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)


def sampling_step(fps: float, max_fps: float) -> tuple[int, float]:
    """The step k that reduces a rate of `fps` to `max_fps` at most by taking every k-th frame.

    Returns k and the least time between two such frames in seconds. It is half a frame shorter than
    nominal because times jitter.
    """
    every = max(1, math.ceil(fps / max_fps - 1e-3))
    return every, max((every - 0.5) / fps if every > 1 else 0.0, 0.5 / max_fps)


class GapDetector:
    """Detects missing frames from the frames' times."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._last_s = float("nan")
        self._intervals: deque[float] = deque(maxlen=_N_USUAL)

    def step(self, time_s: float) -> bool:
        """Whether frames are missing just before this time, judged by the earlier intervals."""
        interval_s, self._last_s = time_s - self._last_s, time_s
        if not interval_s > 0.0:  # the first frame, or a clock set back
            return False
        usual_s = median(self._intervals) if self._intervals else interval_s
        self._intervals.append(interval_s)
        return interval_s > GAP_INTERVALS * max(usual_s, MIN_USUAL_S)


class RepeatDetector:
    """Detects pictures that repeat the previous one, exactly or re-encoded.

    The change of a picture is the L2 norm of its difference from the previous one, over about 90
    rows. A picture is a repeat if its change is zero, or below a quarter of the usual change: the
    upper quartile over the last 12 new pictures.

    A scene that comes to rest changes just as little. The length of a run of repeats is therefore
    limited: to one picture at first, and later to the longest run that ended with a clear rise of
    the change. A picture is never a repeat before the first change, and a run never exceeds 11.

    Pixels where `hidden`, (H, W), is True are ignored.
    """

    def __init__(self, hidden: npt.NDArray[np.bool_] | None = None) -> None:
        self._hidden = hidden
        self.reset()

    def reset(self) -> None:
        """Forget all earlier pictures."""
        self._rows: npt.NDArray[Any] | None = None
        self._changes: deque[float] = deque(maxlen=_N_USUAL)
        self._longest, self._run, self._highest_in_run, self._n_equal = 1, 0, 0.0, 0

    def step(self, image: npt.NDArray[Any]) -> bool:
        """Whether a picture, (H, W) or (H, W, 3) of any type, repeats the previous one."""
        previous = self._rows
        row_step = max(1, len(image) // _N_ROWS)
        rows = self._rows = np.array(image[::row_step])
        if self._hidden is not None:
            rows[self._hidden[::row_step]] = 0
        if previous is None or previous.shape != rows.shape or previous.dtype != rows.dtype:
            return False
        change = cv2.norm(rows, previous)
        if change == 0.0:
            self._n_equal += 1
            return bool(self._changes) and self._n_equal <= MAX_RUN
        self._n_equal = 0
        is_repeat = self._is_low(change)
        if not is_repeat:
            self._changes.append(change)
        return is_repeat

    def _is_low(self, change: float) -> bool:
        """Whether a change above 0 is small enough for a repeat."""
        usual, n_usual = sorted(self._changes), len(self._changes)
        if n_usual >= _N_AT_LEAST and change < _SHARE * usual[3 * n_usual // 4]:
            self._run += 1
            self._highest_in_run = max(self._highest_in_run, change)
            return self._run <= self._longest
        if change > _RISE * self._highest_in_run:
            self._longest = min(MAX_RUN, max(self._longest, self._run))
        self._run, self._highest_in_run = 0, 0.0
        return False
