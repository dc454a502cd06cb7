"""Timestamps of frames: repaired so that they increase, and searched for missing frames."""

import math
from collections.abc import Sequence

import numpy as np

# Thirty years; if a stream has no start, OpenCV's timestamps are astronomic.
MAX_PLAUSIBLE_TIME_S = 1e9
HOLE_EDGE_FRAMES = 5
# Fewer intervals say nothing of a rate; so large a share of odd ones is no accident.
_LEAST_INTERVALS, _VARIABLE_SHARE = 10, 0.1


def missing_frames(times: Sequence[float], fps: float) -> str | None:
    """One line on frames that a demuxer skipped in a stream of constant rate, or None.

    Streams of variable rate have odd intervals everywhere; nothing is reported for them.
    """
    intervals = np.diff(times) * fps
    is_steady = np.abs(intervals - 1.0) < 0.25 + 2e-3 * fps
    longs = np.flatnonzero(~is_steady & (intervals > 1.0))
    if longs.size == 0:
        return None
    # The edges of a hole are ragged: several long intervals close together, but not too many.
    starts = np.flatnonzero(np.diff(longs, prepend=-2 * HOLE_EDGE_FRAMES) > HOLE_EDGE_FRAMES)
    n_holes, n_long = len(starts), np.diff(starts, append=longs.size)
    n_odd = np.sum(~is_steady) - np.sum(np.minimum(n_long, HOLE_EDGE_FRAMES))
    n_missing = round(np.sum(np.rint(intervals[longs]) - 1.0))
    # A video that was cut can have a ragged end.
    is_end = n_holes == 1 and len(intervals) - longs[-1] <= HOLE_EDGE_FRAMES
    is_variable = n_odd > 0 or np.sum(is_steady) < 20 * n_holes
    if is_end or is_variable or n_missing < 2 * n_holes:
        return None
    more = f" and in {n_holes - 1} more places" if n_holes > 1 else ""
    return (
        f"about {n_missing} frames are missing after frame {longs[0]} ({times[longs[0]]:.3f} s)"
        f"{more}, damaged file or dropped frames; do not trust the response there"
    )


def variable_rate(times: Sequence[float]) -> str | None:
    """One line on a frame rate that changes, or None.

    It does if a tenth of the intervals differ from the median by a quarter and 2 ms: stamps in
    whole milliseconds jitter.
    """
    intervals = np.diff(times)
    if intervals.size < _LEAST_INTERVALS:
        return None
    median = float(np.median(intervals))
    is_odd = np.abs(intervals - median) > 0.25 * median + 2e-3
    if np.mean(is_odd) < _VARIABLE_SHARE:
        return None
    slow, fast = 1.0 / np.percentile(intervals, [95, 5])
    return (
        f"the frame rate varies, mostly from {slow:.3g} to {fast:.3g} frames a second; "
        "every frame keeps its own time"
    )


class FrameClock:
    """Strictly increasing times from a decoder's timestamps, however poor these are.

    Parameters
    ----------
    fps : float
        Nominal rate, for frames that have no usable timestamp.
    """

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._fps = fps
        self._last_good = self._last = -MAX_PLAUSIBLE_TIME_S
        self._stale = 0
        self.n_stamped = 0
        self.n_repaired = 0

    def time(self, index: int, stamp_s: float) -> float:
        """Time of frame `index` in seconds, given its timestamp (NaN: none)."""
        if self._last < stamp_s <= MAX_PLAUSIBLE_TIME_S:
            self.n_stamped += index > 0
            self._stale = 0
            self._last_good = self._last = stamp_s
            return stamp_s
        self.n_repaired += 1
        self._stale += 1
        if self.n_stamped == 0:  # no frame after the first one ever had one
            time_s = index * self._interval
        else:  # half an interval at first, so that the next good stamp is still ahead
            time_s = self._last_good + (self._stale - 0.5) * self._interval
        self._last = max(time_s, math.nextafter(self._last, math.inf))
        return self._last

    def report(self) -> str | None:
        """One line on times that are not the decoder's own, or None."""
        if self.n_repaired == 0:
            return None
        if self.n_stamped == 0:
            return f"the stream has no timestamps; times are frame number / {self._fps:g} fps"
        return (
            f"{self.n_repaired} frames had no usable timestamp; "
            f"their times follow from {self._fps:g} fps"
        )
