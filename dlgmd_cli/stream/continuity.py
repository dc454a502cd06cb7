"""Causal detection of missing and of duplicate frames."""

import math
from collections import deque
from statistics import median
from typing import NamedTuple

import cv2
import numpy as np

from dlgmd_cli.frame import FULL, Flags, FloatImage, Image, Levels

# A gap exceeds GAP_INTERVALS median intervals; the median counts as at least MIN_USUAL_S seconds.
GAP_INTERVALS, MIN_USUAL_S = 3.5, 1.0 / 30.0
# Number of recent intervals or changes that are kept.
_N_USUAL = 12
# About this many rows and columns of a coded image are compared, in blocks of `_BLOCK` samples
# squared. `_FLAT` is the variance (grey levels squared) up to which a block counts as flat.
_N_ROWS, _N_COLUMNS, _BLOCK, _FLAT = 90, 160, 8, 100.0
# A duplicate changes by less than `_SHARE` of the usual change, and by less than `_MOST`. Below
# `_SURE`, a scene that comes to rest is unlikely: its image has the noise of a camera. The image
# that ends a run of duplicates changes more than `_RISE` times as much as any of them.
_SHARE, _MOST, _SURE, _RISE = 0.2, 0.03, 0.01, 2.0
# A coder changes the brightness of blocks by less than this many grey levels on average.
_LIT = 1.0
# A run of more duplicates than this is a still scene.
MAX_RUN = 11


class GapDetector:
    """Detects missing frames from the frames' times."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._last_s = float("nan")
        self._intervals: deque[float] = deque(maxlen=_N_USUAL)

    def step(self, time_s: float) -> bool:
        """Whether frames are missing just before `time_s`, judged by the earlier intervals."""
        interval_s, self._last_s = time_s - self._last_s, time_s
        if not interval_s > 0.0:  # the first frame, or a clock that was set back
            return False
        usual_s = median(self._intervals) if self._intervals else interval_s
        self._intervals.append(interval_s)
        return interval_s > GAP_INTERVALS * max(usual_s, MIN_USUAL_S)


class RepeatDetector:
    """Detects duplicates of the previous image.

    Of images stored without loss, an image is a duplicate if it equals the previous one.

    A coder writes a duplicate anew, with noise of its own. Its pattern then stays where it was,
    while motion of the scene moves the pattern of most blocks. The change of a coded image is the
    mean over blocks of 1 − r, where r is the correlation of a block with the same block of the
    previous image. Flashes change brightness and contrast, but not r; a clock changes few blocks.
    The usual change is the upper quartile of the changes of the last 12 new images. An image is a
    duplicate if its change is less than a fifth of the usual change, and less than 0.03, and if
    the brightness of blocks changes by a grey level at most.

    A scene that comes to rest changes as little as duplicates do. The length of a run is therefore
    limited to 11; where changes are not below 0.01, to 1 at first, and later to the longest run
    that a clear rise of the change ended.

    Parameters
    ----------
    hidden : ndarray, shape (H, W), bool, optional
        Pixels that are ignored where True.
    is_coded : bool
        Whether the images were coded with loss.
    levels : (int, int)
        The images' levels of black and white.
    """

    def __init__(
        self, hidden: Flags | None = None, *, is_coded: bool = False, levels: Levels = FULL
    ) -> None:
        self._hidden, self._is_coded, self._levels = hidden, is_coded, levels
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images."""
        self._previous: Image | None = None
        self._blocks: _Blocks | None = None
        self._changes: deque[float] = deque(maxlen=_N_USUAL)
        self._longest, self._run, self._highest_in_run = 1, 0, 0.0

    def step(self, image: Image) -> bool:
        """Whether an image, (H, W) or (H, W, 3) of any type, is a duplicate of the previous one."""
        height, width = image.shape[:2] if self._is_coded else (0, 0)
        grid = (
            slice(None, None, height // _N_ROWS or 1),
            slice(None, None, width // _N_COLUMNS or 1),
        )
        # Of a coded image in colour, green is compared.
        place = (*grid, 1) if self._is_coded and image.ndim == 3 else grid
        current = np.array(image[place])
        if self._hidden is not None:
            current[self._hidden[grid]] = 0
        previous, self._previous = self._previous, current
        before, self._blocks = self._blocks, None
        if self._is_coded:
            self._blocks = _blocks(current, self._levels)
        if previous is None or previous.shape != current.shape:
            return False
        change, light = 0.0, 0.0
        if not np.array_equal(current, previous):
            change, light = 1.0, 0.0
            if before is not None and self._blocks is not None:
                change, light = _change(before, self._blocks)
        is_repeat = self._is_low(change if light <= _LIT else math.inf)
        if not is_repeat and change > 0.0:
            self._changes.append(change)
        return is_repeat

    def _is_low(self, change: float) -> bool:
        """Whether a change is small enough for a duplicate, and the run is not too long."""
        if change < min(_MOST, _SHARE * self._usual()):
            self._run += 1
            self._highest_in_run = max(self._highest_in_run, change)
            return self._run <= (MAX_RUN if change < _SURE else self._longest)
        if change > _RISE * self._highest_in_run:
            self._longest = min(MAX_RUN, max(self._longest, self._run))
        self._run, self._highest_in_run = 0, 0.0
        return False

    def _usual(self) -> float:
        """The usual change: 0 before the first change of coded images, of other images 1."""
        if not self._is_coded:
            return 1.0
        return sorted(self._changes)[3 * len(self._changes) // 4] if self._changes else 0.0


class _Blocks(NamedTuple):
    """An image in grey levels of 0..255, and the mean and the variance of its blocks."""

    levels: FloatImage
    mean: FloatImage
    variance: FloatImage


def _blocks(image: Image, black_white: Levels) -> _Blocks:
    """The blocks of an image, (H, W) of any type, with these levels of black and white."""
    black, white = black_white
    levels = (image - np.float32(black)) * np.float32(255.0 / (white - black))
    mean = _means(levels)
    return _Blocks(levels, mean, _means(levels * levels) - mean**2 + _FLAT)


def _means(levels: FloatImage) -> FloatImage:
    """The means of the blocks of an image."""
    size_wh = max(1, levels.shape[1] // _BLOCK), max(1, levels.shape[0] // _BLOCK)
    return np.asarray(cv2.resize(levels, size_wh, interpolation=cv2.INTER_AREA))


def _change(before: _Blocks, after: _Blocks) -> tuple[float, float]:
    """Mean over blocks of 1 − r, with r the correlation of a block of two images; 0 if flat.

    The second number is the mean change of the brightness of blocks, in grey levels.
    """
    covariance = _means(before.levels * after.levels) - before.mean * after.mean + _FLAT
    r = covariance / np.sqrt(before.variance * after.variance)
    change = cv2.norm(before.mean, after.mean, cv2.NORM_L1) / r.size
    return max(0.0, 1.0 - float(cv2.mean(r)[0])), change


class Continuity:
    """Says of each frame of a source whether it is a duplicate, follows a gap, or is new.

    Some frames are skipped. If a skipped frame is repeated, the repetition counts as new. A gap
    before a skipped frame is carried over to the next frame. A frame after a gap is new, even if
    it looks the same.

    Parameters
    ----------
    skips_repeats : bool
        Whether duplicates are detected and skipped.
    is_coded : bool
        Whether the images were coded with loss, see `RepeatDetector`.
    hidden : ndarray, shape (H, W), bool, optional
        Pixels that are ignored.
    levels : (int, int)
        The images' levels of black and white.

    Attributes
    ----------
    is_new : bool
        Whether a new frame has come since the last frame that was taken.
    """

    def __init__(
        self,
        *,
        skips_repeats: bool = True,
        is_coded: bool = False,
        hidden: Flags | None = None,
        levels: Levels = FULL,
    ) -> None:
        self._skips_repeats, self._is_coded = skips_repeats, is_coded
        self.begin(hidden, levels)
        self.reset()

    def begin(self, hidden: Flags | None, levels: Levels = FULL) -> None:
        """Forget the previous image: the next ones have these levels, and pixels to ignore."""
        detector = RepeatDetector(hidden, is_coded=self._is_coded, levels=levels)
        self._repeats = detector if self._skips_repeats else None

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._gaps = GapDetector()
        if self._repeats is not None:
            self._repeats.reset()
        self.is_new = self._after_gap = False

    def step(self, image: Image | None, time_s: float | None) -> tuple[bool, bool]:
        """Whether the next frame is a duplicate of the previous one, and whether it follows a gap.

        An undecoded frame (`image` None) counts as new; one without a `time_s` follows no gap.
        """
        is_gap = time_s is not None and self._gaps.step(time_s)
        is_repeat = False
        if image is not None and self._repeats is not None:
            is_repeat = self._repeats.step(image) and not is_gap
        self.is_new = self.is_new or not is_repeat
        self._after_gap = self._after_gap or is_gap
        return is_repeat, is_gap

    def take(self) -> tuple[bool, bool]:
        """Take the latest frame; its `is_repeat` and `after_gap` refer to the last frame taken."""
        is_repeat, after_gap = not self.is_new, self._after_gap  # a frame after a gap is new
        self.is_new = self._after_gap = False
        return is_repeat, after_gap
