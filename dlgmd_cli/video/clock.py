"""The times of live frames: when they were captured, and how many to take."""

import math
from collections import deque

from dlgmd_cli.frame import RATE_TOLERANCE, CaptureClock, steady_step

# The rate of a source is measured over so many frames. An interval of more than three frames is a
# stall.
_N_MEASURED, _N_AT_LEAST, _STALL_FRAMES = 61, 10, 3.0
# A stream's stamps are judged over so many frames, which may take so much longer, or shorter, to
# arrive. Two of them are less than a second apart. A frame that is late by more than this share of
# an interval waited.
_N_STAMPS, _SHARE, _MAX_APART_S, _WAITED = 90, 0.12, 1.0, 0.5


class StreamClock:
    """Times of a stream's frames: by its own stamps, or recovered by `CaptureClock`.

    Stamps count while they go forward at the pace of the arrivals; those of streams that only count
    their frames, at a rate that somebody wrote into them, do not.

    Attributes
    ----------
    latest_s, is_stale
        See `CaptureClock`.
    waited : bool
        Whether the latest frame waited on its way, with others.
    """

    def __init__(self) -> None:
        self._arrivals, self._before = CaptureClock(), math.nan
        self._last: deque[tuple[float, float]] = deque(maxlen=_N_STAMPS)
        self._time_s, self.latest_s, self.is_stale = math.nan, 0.0, False
        self.waited = False

    def step(self, arrival_s: float, stamp_s: float = math.nan) -> float:
        """When a frame was captured that arrives at this time, in seconds."""
        recovered_s, before_s = self._arrivals.step(arrival_s), self._before
        self._before, self.latest_s = recovered_s, self._arrivals.latest_s
        self.waited = arrival_s - recovered_s > _WAITED * abs(recovered_s - before_s)
        if self._last and not 0.0 < stamp_s - self._last[-1][1] < _MAX_APART_S:
            self._last.clear()  # the stream begins anew, or a part of it is lost
        self._last.append((arrival_s, stamp_s))
        is_stamped = self._are_sound()
        step_s = stamp_s - self._last[-2][1] if is_stamped else recovered_s - before_s
        is_known = len(self._last) > _N_AT_LEAST  # before, a pipe may just be fast
        self.is_stale = self._arrivals.is_stale and is_known and not is_stamped
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
    """

    def __init__(self, max_fps: float) -> None:
        self._max_fps, self.fps = max_fps, math.nan
        self._times: deque[float] = deque(maxlen=_N_MEASURED)
        self._since_taken, self._every, self._n_late = 0, 0, 0.0
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
            n_intervals = len(self._times) - 1
            self.fps = n_intervals / max(self._times[-1] - self._times[0], 1e-6)
            self._every = steady_step(self.fps, RATE_TOLERANCE * self._max_fps, self._every)
        self._since_taken += 1
        if self._since_taken < self._every:
            return False
        self._since_taken = 0
        return True
