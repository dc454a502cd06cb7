"""Times of frames: repair of bad timestamps, missing frames, and frame rates."""

import itertools
import math
from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from typing import NamedTuple

import numpy as np

from dlgmd_cli.errors import counted
from dlgmd_cli.parameters.facts import InputFacts

# 30 years, in s. OpenCV's timestamps are far larger if a stream states no start.
MAX_PLAUSIBLE_TIME_S = 1e9
# The least time between two frames: tables have six decimals.
LEAST_STEP_S = 2e-6
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


def is_unix(time_s: float) -> bool:
    """Whether a clock that shows this time counts from 1970: the time is from 2001 to 2065.

    NTP, which counts from 1900, shows more.
    """
    return 1_000_000_000 <= time_s <= 3_000_000_000


def start_of(first_s: float) -> InputFacts:
    """What a record says of the clock of times that count from the first frame.

    `start_time_utc` if the clock counts from 1970, else `clock_offset_s`; nothing if it began at 0.
    """
    if is_unix(first_s):
        start = datetime(1970, 1, 1) + timedelta(microseconds=round(first_s * 1_000_000))
        return {"start_time_utc": f"{start.isoformat(timespec='microseconds')}Z"}
    return {"clock_offset_s": float(first_s)} if first_s else {}


class FrameClock:
    """Turns a decoder's timestamps, however poor, into strictly increasing times.

    The nominal rate `fps` is for frames that have no usable timestamp.
    """

    def __init__(self, fps: float) -> None:
        self._interval = 1.0 / fps
        self._fps = fps
        self._last_good = self._last = -MAX_PLAUSIBLE_TIME_S
        self._first_s, self._stale = 0.0, 0
        self.n_stamped = 0
        self.n_repaired = 0

    def time(self, index: int, stamp_s: float) -> float:
        """Time of frame `index` in seconds, given its timestamp (NaN if missing)."""
        if self._last + LEAST_STEP_S <= stamp_s <= MAX_PLAUSIBLE_TIME_S:
            self.n_stamped += index > 0
            self._first_s = self._first_s if index else stamp_s
            self._stale = 0
            self._last_good = self._last = stamp_s
            return stamp_s
        self.n_repaired += 1
        self._stale += 1
        if self.n_stamped == 0:  # no frame after the first had a timestamp
            time_s = self._first_s + index * self._interval
        else:  # half an interval at first, to stay below the next good timestamp
            time_s = self._last_good + (self._stale - 0.5) * self._interval
        self._last = max(time_s, self._last + LEAST_STEP_S)
        return self._last

    def report(self) -> str | None:
        """A warning about times that replace the decoder's, or None."""
        if self.n_repaired == 0:
            return None
        if self.n_stamped == 0:
            return f"the stream has no timestamps; times are frame number / {self._fps:g} fps"
        what = f"{counted(self.n_repaired, 'frame')} had no usable timestamp"
        return f"{what}; their times follow from {self._fps:g} fps"
