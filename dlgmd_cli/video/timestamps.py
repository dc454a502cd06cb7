"""Timestamps of frames: repaired so that they increase, and searched for missing frames."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

# Thirty years; if a stream has no start, OpenCV's timestamps are astronomic.
MAX_PLAUSIBLE_TIME_S = 1e9
HOLE_EDGE_FRAMES = 5
_ODD_SHARE = 0.05


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


class Rhythm(NamedTuple):
    """How frames follow each other, in frames a second.

    `mean_fps` is of all, the others are those of the longest and of the shortest interval. The
    rate `varies` if more than one interval in twenty is not like the others.
    """

    mean_fps: float
    least_fps: float
    most_fps: float
    varies: bool


def rhythm(times: Sequence[float]) -> Rhythm | None:
    """How the frames at these times follow each other; None of fewer than two."""
    if len(times) < 2:
        return None
    intervals = np.diff(times)
    usual_s = float(np.sort(intervals)[len(intervals) // 2])  # one that there is
    # Times may be whole milliseconds.
    n_odd = np.count_nonzero(np.abs(intervals - usual_s) > 0.25 * usual_s + 2e-3)
    return Rhythm(
        len(intervals) / (times[-1] - times[0]),
        1.0 / float(intervals.max()),
        1.0 / float(intervals.min()),
        bool(n_odd > max(2, _ODD_SHARE * len(intervals))),
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
