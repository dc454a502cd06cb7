"""Times and rates of frames as they arrive: capture times, and which frames are taken."""

import math
from collections import deque
from itertools import pairwise
from statistics import median

import numpy as np

from dlgmd_cli.frame import Series
from dlgmd_cli.stream.continuity import GAP_INTERVALS

# An interval is long above 1 + _LONG, short below 1 - _SHORT times the usual interval.
_LONG, _SHORT = 0.6, 0.2
# Recovered times may fall behind by this share of an interval per frame, to follow a slower rate.
_DRIFT = 0.02
# In a stream in bursts, each frame moves the clock by this share of its distance to the line below
# the arrivals. A larger share would look like another speed.
_TOWARDS_LINE = 0.005
# After a gap, frames closer together than this share of the usual interval had waited in a queue.
_BURST = 0.35
# A frame that is late by more than this share of an interval had waited in a queue.
_WAITED = 0.5
# Before the usual interval is known, frames less than _WAITED_S (s) apart had waited in a queue.
# No camera has an interval below _FASTEST_S (s).
_WAITED_S, _FASTEST_S = 1.0 / 100.0, 1.0 / 250.0
# A frame that is later than this many seconds follows a gap, even if no frame was lost. The network
# causes shorter delays.
_MAX_LATE_S = 0.5
# A rate is estimated over 30 intervals, at least 10; in bursts over 1 s and at most 120 arrivals.
_N_RATE, _N_RATE_AT_LEAST, SETTLED_S, _N_ARRIVALS = 30, 10, 1.0, 120
# The rate (frames/s) that is assumed until the rate is known.
NOMINAL_FPS = 30.0
# Intervals are alike if their quartiles are no farther apart than _SPREAD times their median, and
# the median is at least _LIKE_MEAN times their mean.
_SPREAD, _LIKE_MEAN = 0.5, 0.75
# Delays above this many seconds are reported.
UNEVEN_S = 0.1
# The sampling step stays the same while the measured rate changes by less than this share.
_STEADY = 0.05
# Frames may come up to this factor faster than a model's rate: nominal 30 frames/s can be 30.3.
RATE_TOLERANCE = 1.1
# The rate of a source is measured over 61 frames at most, and more than 10. An interval of more
# than three frames is a stall.
_N_MEASURED, _N_AT_LEAST, _STALL_FRAMES = 61, 10, 3.0
# A stream's timestamps are judged over 90 frames, whose arrivals may take 12 % longer or shorter.
# Consecutive timestamps are less than a second apart.
_N_STAMPS, _SHARE, _MAX_APART_S = 90, 0.12, 1.0


def sampling_step(fps: float, max_fps: float) -> tuple[int, float]:
    """The step k for which taking every k-th frame reduces a rate of `fps` to at most `max_fps`.

    Returns k and the shortest time between two of the taken frames in seconds. This time is half a
    frame shorter than nominal because times jitter.
    """
    every = max(1, math.ceil(fps / max_fps - 1e-3))
    return every, max((every - 0.5) / fps if every > 1 else 0.0, 0.5 / max_fps)


def steady_step(fps: float, max_fps: float, before: int) -> int:
    """The step of `sampling_step` for a measured rate; only a clear change of the rate changes it.

    `before` is the previous step, 0 for none.
    """
    low, now, high = (
        sampling_step(fps * share, max_fps)[0] for share in (1 - _STEADY, 1, 1 + _STEADY)
    )
    return before if low <= before <= high else now


class CaptureClock:
    """Estimates from arrival times, causally, when frames were captured.

    A camera captures at a regular rate; the transmission delays some frames. The clock follows the
    frames with the shortest delay. A late frame was captured one usual interval after the previous
    frame, and so was each frame of a burst that follows. If no burst follows, frames were lost:
    one frame later, the estimated time jumps to the arrival time. A frame that is more than 0.5 s
    late follows a gap at once, and the frames of a burst after it are stale.

    If most recent intervals are alike, the usual interval is their median. If the stream comes in
    bursts, the usual interval is the slope of the line below all arrivals of the last second or
    more, see `least_delay_slope`. Until the usual interval is known, frames of a burst count as
    captured at `nominal_fps`. The estimated times may then run ahead of the arrivals, and this lead
    stays constant.

    Attributes
    ----------
    is_stale : bool
        Whether the latest frame is to be left out.
    is_settled : bool
        Whether frames have arrived for 1 s, which is enough to know the rate.
    is_uneven : bool
        Whether frames come in bursts, so that their rate is uncertain.
    fps : float
        The estimated rate in frames per second; the nominal rate until there is an estimate.
    delay_s : float
        Time from the capture of the latest frame to its arrival, in seconds.
    latest_s : float
        The longest delay of a frame that a burst followed, in seconds.
    has_waited : bool
        Whether the latest frame waited in a queue.
    """

    def __init__(self, nominal_fps: float = NOMINAL_FPS) -> None:
        self._nominal_s, self.latest_s = 1.0 / nominal_fps, 0.0
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._arrivals: deque[float] = deque(maxlen=_N_ARRIVALS)
        self._steps: deque[float] = deque(maxlen=_N_RATE)
        self._first_s = self._time_s = math.nan
        self._ahead_s = self.delay_s = self._waiting_s = 0.0
        self._was_long = self._is_gap = self._is_known = False
        self.is_stale = self.is_settled = self.is_uneven = self.has_waited = False
        self.fps = 1.0 / self._nominal_s

    def step(self, arrival_s: float) -> float:
        """The capture time, in seconds, of the frame that arrives at `arrival_s`."""
        interval_s = arrival_s - self._arrivals[-1] if self._arrivals else math.nan
        if not interval_s >= 0.0:  # the first frame, or a clock that was set back
            self.reset()
            self._arrivals.append(arrival_s)
            self._first_s = self._time_s = arrival_s
            return arrival_s
        longest_s = max(_MAX_LATE_S, GAP_INTERVALS * max(self._steps, default=0.0))
        if not self._is_known and interval_s > longest_s:  # a pause says nothing about the rate
            self._arrivals.clear()
            self._first_s = arrival_s
        self._arrivals.append(arrival_s)
        self.is_settled = arrival_s - self._first_s >= SETTLED_S
        usual_s, self.is_stale = self._usual_s(), False
        if usual_s is None:
            step_s = self._provisional(interval_s)
        elif self.is_uneven or (not self._is_known and self.delay_s < 0.0):
            step_s = self._on_line(usual_s, interval_s)
        else:
            step_s = self._captured(usual_s, interval_s)
        self._is_known = usual_s is not None
        if not self.is_stale:
            # A clock that is ahead is slowed down; the shortened steps say nothing about the rate.
            is_ahead = usual_s is not None and self.delay_s < 0.0
            self._steps.append(max(step_s, interval_s) if is_ahead else step_s)
        self._time_s += step_s
        self.delay_s = arrival_s - (self._time_s - self._ahead_s)
        is_late = self.delay_s > _WAITED * abs(step_s)
        self.has_waited = is_late if self._is_known else interval_s < _WAITED_S
        return self._time_s

    def doubts(self) -> str:
        """How and at which rate frames arrive, if unevenly or in bursts; else an empty string."""
        if self.is_uneven and self._is_known:
            rate = f"about {self.fps:.3g} a second, which is uncertain"
            return f"in bursts, up to {self.latest_s:.2f} s late; their rate is {rate}"
        if self.is_uneven:
            nominal = f"{1.0 / self._nominal_s:.3g} a second"
            return f"in bursts; their rate is uncertain, and counts as {nominal} for a second"
        if self.latest_s > UNEVEN_S:
            late = f"up to {self.latest_s:.2f} s late"
            return f"unevenly, {late}; the times of their capture are used"
        return ""

    def _usual_s(self) -> float | None:
        """The camera's interval in seconds, estimated from the arrivals; None if unknown.

        A stream that was even for 1 s counts as even from then on: later delays do not change the
        known rate.
        """
        if self._is_known and not self.is_uneven and self.is_settled:
            usual_s = median(self._steps)
        elif len(self._arrivals) <= _N_RATE_AT_LEAST:
            return None
        else:
            recent = [*self._arrivals][-_N_RATE - 1 :]
            intervals = sorted(after - before for before, after in pairwise(recent))
            n_quarter = len(intervals) // 4
            usual_s, spread_s = median(intervals), intervals[-1 - n_quarter] - intervals[n_quarter]
            mean_s = (recent[-1] - recent[0]) / len(intervals)
            is_camera = usual_s >= _FASTEST_S and usual_s >= _LIKE_MEAN * mean_s
            self.is_uneven = not is_camera or spread_s > _SPREAD * usual_s
            if self.is_uneven:
                if self._arrivals[-1] - self._arrivals[0] < SETTLED_S:
                    return None
                usual_s = least_delay_slope(np.array(self._arrivals))
        self.fps = 1.0 / max(usual_s, _FASTEST_S)
        return usual_s

    def _provisional(self, interval_s: float) -> float:
        """The time step (s) while the rate is unknown; the nominal interval within a burst."""
        if interval_s < _WAITED_S:
            return self._nominal_s
        return max(interval_s + self.delay_s, 0.5 * min(interval_s, self._nominal_s))

    def _on_line(self, usual_s: float, interval_s: float) -> float:
        """The time step (s) of a stream in bursts, drifting towards the line below the arrivals."""
        if interval_s - usual_s > _MAX_LATE_S:  # frames were lost: the rate is unknown again
            self._arrivals = deque([self._arrivals[-1]], maxlen=_N_ARRIVALS)
            return interval_s + self.delay_s
        arrivals = np.array(self._arrivals)
        n_later = np.arange(len(arrivals) - 1, -1, -1)
        line_s = float(np.min(arrivals + usual_s * n_later))
        self.latest_s = max(self.latest_s, self._arrivals[-1] - line_s)
        if not self._is_known:  # the clock's lead over the arrivals stays constant
            self._ahead_s = self._time_s + usual_s - line_s
        apart_s = line_s - (self._time_s - self._ahead_s) - usual_s
        most_s = _DRIFT * usual_s
        return usual_s + min(max(_TOWARDS_LINE * apart_s, -most_s), most_s)

    def _captured(self, usual_s: float, interval_s: float) -> float:
        """The time step (s) of an even stream, from the capture of the previous frame."""
        delay_s = self.delay_s
        over_s, least_s = interval_s - usual_s, (1.0 - _SHORT) * min(interval_s, usual_s)
        arrived_s = max(interval_s + delay_s, least_s)
        due_s = min(arrived_s, (1.0 + _DRIFT) * usual_s)
        was_long, self._was_long = self._was_long, over_s > _LONG * usual_s
        if self._was_long:
            self._waiting_s += over_s
            self._is_gap = over_s > _MAX_LATE_S
            return arrived_s if was_long or self._is_gap else due_s  # long again: a slower source
        if over_s < -_SHORT * usual_s and self._waiting_s > 0.0:
            step_s = min(usual_s, interval_s + self._waiting_s)
            self.is_stale = self._is_gap and interval_s < _BURST * usual_s
            if self.is_stale or not self._is_gap:
                self.latest_s = max(self.latest_s, self._waiting_s)
            self._waiting_s -= step_s - interval_s
            return interval_s if self._is_gap else step_s
        self._waiting_s = 0.0
        return arrived_s if delay_s > _LONG * usual_s else due_s  # a long delay: frames were lost


def least_delay_slope(arrivals_s: Series) -> float:
    """The interval (s) of evenly captured frames, from their arrival times, shape (n,), n > 2.

    Of all lines below the arrivals, the line that is closest to them on average touches two
    arrivals, one in each half. The slope of this line is the interval: the frames with the shortest
    delay determine the slope, whatever the delays of the other frames.
    """
    numbers, middle = np.arange(len(arrivals_s)), 0.5 * (len(arrivals_s) - 1)
    early, late = numbers[numbers < middle], numbers[numbers > middle]
    first, last = early[:, np.newaxis], late[np.newaxis, :]
    rises = arrivals_s[last] * (middle - first) + arrivals_s[first] * (last - middle)
    lowest = int(np.argmin(rises / (last - first)))
    i, j = early[lowest // len(late)], late[lowest % len(late)]
    return float((arrivals_s[j] - arrivals_s[i]) / (j - i))


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
        self.arrivals = CaptureClock(nominal_fps)
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self.arrivals.reset()
        self._last: deque[tuple[float, float]] = deque(maxlen=_N_STAMPS)
        self._before = self._time_s = math.nan
        self.is_stale = False

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
        self._max_fps = max_fps
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self.fps, self.every = math.nan, 0
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
