"""What in a stream is no new picture, and where frames are missing; both decided causally."""

from collections import deque
from statistics import median
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

# A gap is longer than so many of the usual intervals, which count as no shorter than MIN_USUAL_S.
GAP_INTERVALS, MIN_USUAL_S = 3.5, 1.0 / 30.0
# So many intervals, or changes, tell what is usual.
_N_USUAL, _N_AT_LEAST = 12, 3
# Rows of a picture that are compared.
_N_ROWS = 90
# A repeat changes by less than this share of what is usual; what follows by twice as much or more.
_SHARE, _RISE = 0.25, 2.0
# Longer runs of repeats are a still scene.
MAX_RUN = 11


class GapDetector:
    """Tells from the times of frames where some are missing."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget the frames before."""
        self._last_s = float("nan")
        self._intervals: deque[float] = deque(maxlen=_N_USUAL)

    def step(self, time_s: float) -> bool:
        """Whether the frame at this time comes after a gap, compared with the intervals before."""
        interval_s, self._last_s = time_s - self._last_s, time_s
        if not interval_s > 0.0:  # the first frame, or a clock that was set back
            return False
        usual_s = median(self._intervals) if self._intervals else interval_s
        self._intervals.append(interval_s)
        return interval_s > GAP_INTERVALS * max(usual_s, MIN_USUAL_S)


class RepeatDetector:
    """Tells which pictures merely repeat the one before, exactly or encoded anew.

    A picture's change is the root mean square of its difference from the one before, over some 90
    of its rows. It repeats that one if nothing changes, or if the change is less than a quarter of
    the usual one: the upper quartile of the last 12 new pictures.

    A scene that comes to rest changes as little. Hence no more pictures in a row count as repeats
    than there were before: one at first, and as many as such a run had when the change rose again
    after it, as it does when a repeat is over. Nothing is a repeat before the first change, and no
    more than 11 pictures in a row are.

    Pixels where `hidden`, (H, W), is True are not looked at.
    """

    def __init__(self, hidden: npt.NDArray[np.bool_] | None = None) -> None:
        self._hidden = hidden
        self.reset()

    def reset(self) -> None:
        """Forget the pictures before."""
        self._rows: npt.NDArray[Any] | None = None
        self._changes: deque[float] = deque(maxlen=_N_USUAL)
        self._longest, self._run, self._highest_in_run, self._n_equal = 1, 0, 0.0, 0

    def step(self, image: npt.NDArray[Any]) -> bool:
        """Whether a picture, (H, W) or (H, W, 3) of any type, repeats the one before."""
        before = self._rows
        every = max(1, len(image) // _N_ROWS)
        rows = self._rows = np.array(image[::every])
        if self._hidden is not None:
            rows[self._hidden[::every]] = 0
        if before is None or before.shape != rows.shape or before.dtype != rows.dtype:
            return False
        change = cv2.norm(rows, before)
        if change == 0.0:
            self._n_equal += 1
            return bool(self._changes) and self._n_equal <= MAX_RUN
        self._n_equal = 0
        is_repeat = self._is_low(change)
        if not is_repeat:
            self._changes.append(change)
        return is_repeat

    def _is_low(self, change: float) -> bool:
        """Whether a change above 0 is so far below the usual one as that of a repeat."""
        usual, n_usual = sorted(self._changes), len(self._changes)
        if n_usual >= _N_AT_LEAST and change < _SHARE * usual[3 * n_usual // 4]:
            self._run += 1
            self._highest_in_run = max(self._highest_in_run, change)
            return self._run <= self._longest
        if change > _RISE * self._highest_in_run:
            self._longest = min(MAX_RUN, max(self._longest, self._run))
        self._run, self._highest_in_run = 0, 0.0
        return False
