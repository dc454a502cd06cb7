"""Timestamps: repair of bad ones, detection of missing frames, and frame rates."""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

# Thirty years; OpenCV's timestamps are astronomic if a stream states no start.
MAX_PLAUSIBLE_TIME_S = 1e9
# Long intervals less than this many frames apart belong to the same hole.
HOLE_EDGE_FRAMES = 5
# The frame rate varies if more than this share of the intervals is unusual.
_ODD_SHARE = 0.05
# So many stamps at the beginning of a stream tell its rate, at least `_MIN_FIRST_STAMPS`.
N_FIRST_STAMPS, _MIN_FIRST_STAMPS = 100, 12
# A measured rate this close to a usual one is that one: the stamps may be whole milliseconds.
_NEAR = 2e-3
# The measured rate counts if the stated one is lower by more than this.
_LOWER = 1.01


def missing_frames(
    times: Sequence[float], rates: "FrameRates | None", n_short: int = 0
) -> str | None:
    """A warning about frames that a demuxer skipped in a stream of constant rate, or None.

    `rates` are those of the times. Streams of variable rate have odd intervals everywhere; nothing
    is reported for them. Nor are single frames, which many recorders drop, unless the input states
    so many frames more than were read: `n_short`.
    """
    if rates is None or rates.varies:
        return None
    fps = rates.mean_fps
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
    # Cutting can leave a video with irregular intervals at its end.
    is_end = n_holes == 1 and len(intervals) - longs[-1] <= HOLE_EDGE_FRAMES
    is_variable = n_odd > 0 or np.sum(is_steady) < 20 * n_holes
    if is_end or is_variable or (n_missing < 2 * n_holes and n_missing > n_short):
        return None
    more = f" and in {n_holes - 1} more places" if n_holes > 1 else ""
    what = "1 frame is" if n_missing == 1 else f"about {n_missing} frames are"
    where = f"after frame {longs[0]} ({times[longs[0]]:.3f} s){more}"
    why = "damaged file or dropped frames"
    return f"{what} missing {where}, {why}; do not trust the response there"


class FrameRates(NamedTuple):
    """The frame rates of a video, in frames per second.

    `min_fps` and `max_fps` are the rates of the longest and the shortest interval. The rate
    `varies` if more than one interval in twenty differs clearly from the median. If it does not,
    `mean_fps` is the rate between gaps: it leaves out the intervals that do.
    """

    mean_fps: float
    min_fps: float
    max_fps: float
    varies: bool


def frame_rates(times: Sequence[float]) -> FrameRates | None:
    """The frame rates of frames at these times; None for fewer than two frames."""
    if len(times) < 2:
        return None
    intervals = np.diff(times)
    usual_s = float(np.sort(intervals)[len(intervals) // 2])  # a median that really occurs
    # The margin allows for times in whole milliseconds.
    is_odd = np.abs(intervals - usual_s) > 0.25 * usual_s + 2e-3
    varies = bool(np.count_nonzero(is_odd) > max(2, _ODD_SHARE * len(intervals)))
    mean_s = (intervals if varies else intervals[~is_odd]).mean()
    mean_fps, low, high = (1.0 / float(s) for s in (mean_s, intervals.max(), intervals.min()))
    return FrameRates(mean_fps, low, high, varies)


def steady_fps(stamps: Iterable[float]) -> float | None:
    """The frame rate between gaps, by the first stamps of a stream in any order, in seconds.

    None if they are few, or if the rate varies.
    """
    times = sorted({stamp_s for stamp_s in stamps if math.isfinite(stamp_s)})
    rates = frame_rates(times) if len(times) >= _MIN_FIRST_STAMPS else None
    if rates is None or rates.varies:
        return None
    fps = rates.mean_fps
    usual = min((round(fps), round(fps) / 1.001), key=lambda rate: abs(rate - fps))
    return float(usual) if abs(usual - fps) < _NEAR * fps else fps


def rate_between_gaps(stated_fps: float | None, steady_fps: float | None) -> float | None:
    """The rate of a stream that states an average, and whose first frames come at `steady_fps`.

    The average of a recording with pauses or missing frames is too low. One that is higher belongs
    to a stream that becomes faster.
    """
    if stated_fps and steady_fps and steady_fps > _LOWER * stated_fps:
        return steady_fps
    return stated_fps


class FrameClock:
    """Turns a decoder's timestamps, however poor, into strictly increasing times.

    The nominal rate `fps` is for frames that have no usable timestamp.
    """

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._fps = fps
        self._last_good = self._last = -MAX_PLAUSIBLE_TIME_S
        self._stale = 0
        self.n_stamped = 0
        self.n_repaired = 0

    def time(self, index: int, stamp_s: float) -> float:
        """Time of frame `index` in seconds, given its timestamp (NaN if missing)."""
        if self._last < stamp_s <= MAX_PLAUSIBLE_TIME_S:
            self.n_stamped += index > 0
            self._stale = 0
            self._last_good = self._last = stamp_s
            return stamp_s
        self.n_repaired += 1
        self._stale += 1
        if self.n_stamped == 0:  # no frame after the first had a timestamp
            time_s = index * self._interval
        else:  # start with half an interval, so that the next good timestamp is still ahead
            time_s = self._last_good + (self._stale - 0.5) * self._interval
        self._last = max(time_s, math.nextafter(self._last, math.inf))
        return self._last

    def report(self) -> str | None:
        """A warning about times that are not the decoder's own, or None."""
        if self.n_repaired == 0:
            return None
        if self.n_stamped == 0:
            return f"the stream has no timestamps; times are frame number / {self._fps:g} fps"
        what = f"{self.n_repaired} frames had no usable timestamp"
        return f"{what}; their times follow from {self._fps:g} fps"
