"""Frames for models: sizes, rate, capture times, and causal detection of duplicates and gaps."""

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from statistics import median
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

# Images, (H, W) or (H, W, 3): of any type; grey and BGR levels 0..255; levels between 0 and 1.
Image = npt.NDArray[Any]
GreyImage = npt.NDArray[np.uint8]
BgrImage = npt.NDArray[np.uint8]
FloatImage = npt.NDArray[np.float32]
# Numbers, one per frame, cell or point; arrays of numbers; booleans, one per frame, cell or point.
Series = npt.NDArray[np.float64]
FloatArray = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# A gap exceeds GAP_INTERVALS median intervals; the median counts as at least MIN_USUAL_S seconds.
GAP_INTERVALS, MIN_USUAL_S = 3.5, 1.0 / 30.0
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
# Number of recent intervals or changes that are kept.
_N_USUAL = 12
# Frames may come up to this factor faster than a model's rate: nominal 30 frames/s can be 30.3.
RATE_TOLERANCE = 1.1
# About this many rows and columns of a coded image are compared, in blocks of `_BLOCK` samples
# squared. `_FLAT` is the variance (grey levels squared) up to which a block counts as flat.
_N_ROWS, _N_COLUMNS, _BLOCK, _FLAT = 90, 160, 8, 100.0
# A duplicate changes by less than `_SHARE` of the usual change, and by less than `_MOST`. Below
# `_SURE`, a scene that comes to rest is unlikely: its image has the noise of a camera. The image
# that ends a run of duplicates changes more than `_RISE` times as much as any of them.
_SHARE, _MOST, _SURE, _RISE = 0.2, 0.03, 0.01, 2.0
# A coder changes the brightness of blocks by less than this many grey levels on average.
_LIT = 1.0
# The expansion is measured on images of at most this width (px), whatever the model's frame size.
SMALL_PX = 240
# A run of more duplicates than this is a still scene.
MAX_RUN = 11


@dataclass(frozen=True)
class Frame:
    """A frame in the form that models take.

    Attributes
    ----------
    index : int
        Number of the frame in its source, from 0.
    time_s : float
        Time of the frame in seconds; NaN if unknown.
    grey : ndarray, shape (H, W)
        uint8 levels 0..255 if the source has 8 bits, else float32 in 0..1.
    is_repeat : bool
        Whether the frame is a duplicate of the previous one, see `RepeatDetector`, and is skipped.
    after_gap : bool
        Whether frames are missing before the frame, see `GapDetector`.
    picture : ndarray, shape (height, width, 3), uint8, or None
        The image in BGR, if requested.
    captured_s : float
        Arrival time by `time.monotonic`, in seconds, if the source is live; else NaN.
    small : ndarray, shape (h, w), or None
        The frame at the size of `small_wh`, on which the expansion is measured, if requested.
    others : mapping of (int, int) to ndarray
        The frame at further sizes (width, height), for models that need another size.
    """

    index: int
    time_s: float
    grey: Image
    is_repeat: bool = False
    after_gap: bool = False
    picture: npt.NDArray[np.uint8] | None = None
    captured_s: float = math.nan
    small: Image | None = None
    others: Mapping[tuple[int, int], Image] = field(default_factory=dict)

    def at(self, size_wh: tuple[int, int] | None) -> Image:
        """The grey frame at a requested size; for None or an unknown size, `grey`."""
        return self.grey if size_wh is None else self.others.get(size_wh, self.grey)

    @property
    def luminance(self) -> npt.NDArray[np.float32]:
        """The grey frame as float32 in 0..1, shape (H, W)."""
        if self.grey.dtype != np.uint8:
            return self.grey
        return np.divide(self.grey, np.float32(255.0), dtype=np.float32)

    def in_place_of(self, dropped: "Frame") -> "Frame":
        """This frame if `dropped` is left out: a repeat if both are, after a gap if either is."""
        is_repeat = self.is_repeat and dropped.is_repeat
        return replace(self, is_repeat=is_repeat, after_gap=self.after_gap or dropped.after_gap)


def small_wh(width: int, height: int) -> tuple[int, int]:
    """Width and height at which the expansion of an image is measured, in px."""
    scale = min(1.0, SMALL_PX / width)
    return max(1, round(width * scale)), max(1, round(height * scale))


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
    """

    def __init__(self, hidden: Flags | None = None, *, is_coded: bool = False) -> None:
        self._hidden, self._is_coded = hidden, is_coded
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
        before, self._blocks = self._blocks, _blocks(current) if self._is_coded else None
        if previous is None or previous.shape != current.shape or previous.dtype != current.dtype:
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
    """An image in grey levels, and the mean and the variance of its blocks."""

    levels: FloatImage
    mean: FloatImage
    variance: FloatImage


def _blocks(image: Image) -> _Blocks:
    """The blocks of an image, (H, W) of any type."""
    levels = image.astype(np.float32)
    if image.dtype != np.uint8:
        levels *= 255.0 / (np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1.0)
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

    Attributes
    ----------
    is_new : bool
        Whether a new frame has come since the last frame that was taken.
    """

    def __init__(
        self, *, skips_repeats: bool = True, is_coded: bool = False, hidden: Flags | None = None
    ) -> None:
        self._skips_repeats, self._is_coded = skips_repeats, is_coded
        self.ignore(hidden)
        self.reset()

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore the pixels `hidden` from now on, and forget the previous image."""
        detector = RepeatDetector(hidden, is_coded=self._is_coded)
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
        is_repeat, after_gap = not self.is_new, self.is_new and self._after_gap
        self._after_gap = self._after_gap and is_repeat
        self.is_new = False
        return is_repeat, after_gap
