"""Times of frames: repair of bad timestamps, missing frames, frame rates, and live streams."""

import itertools
import math
from collections import deque
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from dlgmd_cli.frame import NOMINAL_FPS, RATE_TOLERANCE, CaptureClock, steady_step

# 30 years, in s. OpenCV's timestamps are far larger if a stream states no start.
MAX_PLAUSIBLE_TIME_S = 1e9
# The frame rate varies if more than this share of the intervals differs from the median.
_ODD_SHARE = 0.05
# The rate is measured over the first 100 timestamps; at least 12 are needed.
_N_FIRST_STAMPS, _MIN_FIRST_STAMPS = 100, 12
# Relative difference below which a measured rate becomes a usual rate: stamps may be whole ms.
_NEAR = 2e-3
# The measured rate replaces a stated rate that is lower by more than this factor.
_LOWER = 1.01


class FrameRates(NamedTuple):
    """The frame rates of a video, in frames per second.

    `min_fps` and `max_fps` are the rates of the longest and the shortest interval. The rate
    `varies` if more than one interval in twenty differs clearly from the median. If the rate does
    not vary, `mean_fps` is the rate between gaps: intervals that differ clearly are left out.
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
    usual_s = float(np.sort(intervals)[len(intervals) // 2])  # a median that is an interval
    # The margin allows for times in whole milliseconds.
    is_odd = np.abs(intervals - usual_s) > 0.25 * usual_s + 2e-3
    varies = bool(np.count_nonzero(is_odd) > max(2, _ODD_SHARE * len(intervals)))
    mean_s = (intervals if varies else intervals[~is_odd]).mean()
    mean_fps, low, high = (1.0 / float(s) for s in (mean_s, intervals.max(), intervals.min()))
    return FrameRates(mean_fps, low, high, varies)


def steady_fps(stamps: Iterable[float]) -> float | None:
    """The frame rate between gaps, from a stream's first timestamps in seconds, in any order.

    None for fewer than 12 timestamps, or if the rate varies.
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
    """The nominal rate: `steady_fps`, measured over the first frames, if `stated_fps` is lower.

    The stated rate is an average: too low for a recording with pauses or missing frames. A stated
    rate above `steady_fps` is kept: it belongs to a stream that becomes faster.
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
        else:  # half an interval at first, to stay below the next good timestamp
            time_s = self._last_good + (self._stale - 0.5) * self._interval
        self._last = max(time_s, math.nextafter(self._last, math.inf))
        return self._last

    def report(self) -> str | None:
        """A warning about times that replace the decoder's, or None."""
        if self.n_repaired == 0:
            return None
        if self.n_stamped == 0:
            return f"the stream has no timestamps; times are frame number / {self._fps:g} fps"
        what = f"{self.n_repaired} frames had no usable timestamp"
        return f"{what}; their times follow from {self._fps:g} fps"


# The rate of a source is measured over 61 frames at most, and more than 10. An interval of more
# than three frames is a stall.
_N_MEASURED, _N_AT_LEAST, _STALL_FRAMES = 61, 10, 3.0
# A stream's timestamps are judged over 90 frames, whose arrivals may take 12 % longer or shorter.
# Consecutive timestamps are less than a second apart.
_N_STAMPS, _SHARE, _MAX_APART_S = 90, 0.12, 1.0


class StreamClock:
    """Times of a stream's frames: the stream's own timestamps, or recovered by `CaptureClock`.

    Timestamps are used while they advance at the pace of the arrivals. Timestamps that only count
    frames at a stated rate do not keep this pace.

    Attributes
    ----------
    arrivals : CaptureClock
        Recovers times from the arrivals alone.
    is_stale : bool
        Whether the latest frame is to be left out.
    """

    def __init__(self, nominal_fps: float = NOMINAL_FPS) -> None:
        self.arrivals, self._before = CaptureClock(nominal_fps), math.nan
        self._last: deque[tuple[float, float]] = deque(maxlen=_N_STAMPS)
        self._time_s, self.is_stale = math.nan, False

    def step(self, arrival_s: float, stamp_s: float = math.nan) -> float:
        """The capture time, in seconds, of a frame that arrives at `arrival_s`."""
        recovered_s, before_s = self.arrivals.step(arrival_s), self._before
        self._before = recovered_s
        if self._last:
            came_s, stamped_s = self._last[-1]
            is_next = 0.0 < stamp_s - stamped_s < _MAX_APART_S
            if not is_next or arrival_s - came_s >= _MAX_APART_S:
                self._last.clear()  # the stream began again, or frames are lost
        self._last.append((arrival_s, stamp_s))
        is_stamped = self._are_sound()
        step_s = stamp_s - self._last[-2][1] if is_stamped else recovered_s - before_s
        self.is_stale = self.arrivals.is_stale and not is_stamped
        self._time_s = arrival_s if math.isnan(self._time_s) else self._time_s + step_s
        return self._time_s

    def _are_sound(self) -> bool:
        """Whether the latest timestamps advance at the pace of the arrivals."""
        (from_s, first_s), (to_s, last_s) = self._last[0], self._last[-1]
        apart = abs(1.0 - (last_s - first_s) / max(to_s - from_s, 1e-6))
        return len(self._last) > 1 and (apart < _SHARE or len(self._last) < _N_STAMPS)


class Pace:
    """Measures the rate of a source, and takes every k-th frame to keep to `max_fps`.

    Delayed frames that arrive in a burst after a stall do not count for the rate.

    Attributes
    ----------
    fps : float
        Rate over the last 60 intervals, frames/s; NaN before there are ten intervals.
    every : int
        The k of the frames that are taken; 0 before the rate is known.
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
        # Two stalls in a row mean that the source has become slower.
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
