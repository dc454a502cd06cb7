"""Times of frames: repair of bad timestamps, missing frames, frame rates, and live streams."""

import itertools
import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from dlgmd_cli.frame import NOMINAL_FPS, RATE_TOLERANCE, CaptureClock, steady_step

# Thirty years; OpenCV's timestamps are astronomic if a stream states no start.
MAX_PLAUSIBLE_TIME_S = 1e9
# The frame rate varies if more than this share of the intervals is unusual.
_ODD_SHARE = 0.05
# The rate is measured over the first `_N_FIRST_STAMPS` stamps, if there are `_MIN_FIRST_STAMPS`.
_N_FIRST_STAMPS, _MIN_FIRST_STAMPS = 100, 12
# A measured rate this close to a usual one is that one: the stamps may be whole milliseconds.
_NEAR = 2e-3
# The measured rate counts if the stated one is lower by more than this.
_LOWER = 1.01


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
    times = sorted(
        {stamp_s for stamp_s in itertools.islice(stamps, _N_FIRST_STAMPS) if math.isfinite(stamp_s)}
    )
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


# The rate of a source is measured over so many frames. An interval of more than three frames is a
# stall.
_N_MEASURED, _N_AT_LEAST, _STALL_FRAMES = 61, 10, 3.0
# A stream's stamps are judged over so many frames, which may take so much longer, or shorter, to
# arrive. Two of them are less than a second apart.
_N_STAMPS, _SHARE, _MAX_APART_S = 90, 0.12, 1.0


class StreamClock:
    """Times of a stream's frames: by its own stamps, or recovered by `CaptureClock`.

    Stamps count while they go forward at the pace of the arrivals; those of streams that only count
    their frames, at a rate that somebody wrote into them, do not.

    Attributes
    ----------
    arrivals : CaptureClock
        What follows from the arrivals alone.
    is_stale : bool
        Whether to leave the latest frame out.
    """

    def __init__(self, nominal_fps: float = NOMINAL_FPS) -> None:
        self.arrivals, self._before = CaptureClock(nominal_fps), math.nan
        self._last: deque[tuple[float, float]] = deque(maxlen=_N_STAMPS)
        self._time_s, self.is_stale = math.nan, False

    def step(self, arrival_s: float, stamp_s: float = math.nan) -> float:
        """When a frame was captured that arrives at this time, in seconds."""
        recovered_s, before_s = self.arrivals.step(arrival_s), self._before
        self._before = recovered_s
        if self._last:
            came_s, stamped_s = self._last[-1]
            is_next = 0.0 < stamp_s - stamped_s < _MAX_APART_S
            if not is_next or arrival_s - came_s >= _MAX_APART_S:
                self._last.clear()  # the stream begins anew, or a part of it is lost
        self._last.append((arrival_s, stamp_s))
        is_stamped = self._are_sound()
        step_s = stamp_s - self._last[-2][1] if is_stamped else recovered_s - before_s
        self.is_stale = self.arrivals.is_stale and not is_stamped
        self._time_s = arrival_s if math.isnan(self._time_s) else self._time_s + step_s
        return self._time_s

    def _are_sound(self) -> bool:
        """Whether the latest stamps go at the pace of the arrivals."""
        (from_s, first_s), (to_s, last_s) = self._last[0], self._last[-1]
        apart = abs(1.0 - (last_s - first_s) / max(to_s - from_s, 1e-6))
        return len(self._last) > 1 and (apart < _SHARE or len(self._last) < _N_STAMPS)


class Pace:
    """Measures the rate of a source, and takes every k-th frame so that `max_fps` are left.

    Frames that arrive late all at once, after a stall, say nothing about the rate.

    Attributes
    ----------
    fps : float
        Frames a second over the last 60 intervals; NaN before there are ten of them.
    every : int
        The k of the frames that are taken; 0 before there is a rate.
    """

    def __init__(self, max_fps: float) -> None:
        self._max_fps, self.fps, self.every = max_fps, math.nan, 0
        self._times: deque[float] = deque(maxlen=_N_MEASURED)
        self._since_taken, self._n_late = 0, 0.0
        self._last_s, self._is_stall = math.nan, False

    def is_due(self, captured_s: float) -> bool:
        """Whether to take the frame that came at this time."""
        n_passed = (captured_s - self._last_s) * self.fps  # frames in the interval; NaN at first
        self._last_s = captured_s
        # A second stall directly after the first one is a slower source.
        is_second, self._is_stall = self._is_stall, n_passed > _STALL_FRAMES
        if self._is_stall and not is_second:
            self._n_late = n_passed
            self._times.clear()
        elif self._n_late >= 1.0 and n_passed < 0.5:
            self._n_late += n_passed - 1.0
            self._times.clear()
        self._times.append(captured_s)
        if len(self._times) > _N_AT_LEAST:
            self.fps = (len(self._times) - 1) / max(self._times[-1] - self._times[0], 1e-6)
            self.every = steady_step(self.fps, RATE_TOLERANCE * self._max_fps, self.every)
        self._since_taken += 1
        if self._since_taken < self.every:
            return False
        self._since_taken = 0
        return True
