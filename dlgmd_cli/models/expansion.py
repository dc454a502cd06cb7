"""The expansion rate of the image and the time to contact, measured independently of the model.

The rate at which the image of a surface ahead grows is 1 / (time to contact), per second: the τ of
Lee (1976). `growth` measures it between two images.
"""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from dlgmd_cli.frame import small_wh
from dlgmd_cli.models.approach import LEAST_AGE_S, approaching
from dlgmd_cli.models.base import Flags, Grey
from dlgmd_cli.models.columns import column, described
from dlgmd_cli.models.corridor import Motion, fastest, turned
from dlgmd_cli.models.growth import PATCH_WH, Growth, Points, grid, growth, visible
from dlgmd_cli.models.prepare import Filling, Flicker
from dlgmd_cli.models.windows import Bounds, Camera

# Points along each side of the window ahead.
N_AHEAD = 7
# Time constant (s) of the mean rate ahead, and the interval (s) of frames without times.
TAU_S, USUAL_S = 0.12, 1.0 / 30.0
# Least time (s) between compared images: over less time, points move too little to be measured.
LEAST_S = 0.027
# Rates with this standard error, in 1/s, have half the weight of exact ones in the mean.
ERROR = 0.2
# The mean of rates with less than this share of their full weight is undefined.
LEAST_WEIGHT = 1e-4
# After this time (s), an image that looks like a copy counts, too.
MOST_AGE_S = 0.4
# Shortest side of an image that is measured, in px.
LEAST_SIDE = 20
# Below this rate, in 1/s, there is no time to contact.
LEAST_RATE = 0.1
# An expansion of less quality is too uncertain for a time to contact, and counts less for an alarm.
LEAST_QUALITY = 0.35
_CENTRE = "centre of the region that expands, from −1 (left, top) to 1"


@described
@dataclass(frozen=True)
class Measured:
    """What `Expansion` measures at a frame; NaN where it cannot measure.

    `expansion_quality` is the weight of the rates in the mean `expansion`, as a share of the weight
    of exact ones: 1/2 for a standard error of `ERROR`; near 0 on a blank wall, in the dark, and
    where everything moves too fast. `ttc_s` is 1 / `corridor` where this is known; else
    1 / `expansion`, or 1 / `approach` if this is less; minus the mean age of what the rate was
    measured on. It is NaN where the rate is below `LEAST_RATE`, and without `corridor` where
    `expansion` has a quality below `LEAST_QUALITY`.
    """

    expansion: float = column(
        "1/s",
        "expansion rate in the [window](measurements.md#the-window) ahead; negative if the image "
        "shrinks, empty if it cannot be measured",
    )
    expansion_upright: float = column("1/s", "the same, without what level ground adds")
    expansion_quality: float = column(
        "–",
        "precision of `expansion`, 0 to 1 (a precise rate may be wrong); "
        "[1/2](model.md#expansion-rate-and-time-to-contact) for a standard error of 0.2/s",
    )
    ttc_s: float = column(
        "s",
        "estimated time to contact; [empty](model.md#time-to-contact) where no rate of 0.1/s or "
        "more was measured well",
    )
    expansion_x: float = column("–", _CENTRE)
    expansion_y: float = column("–", _CENTRE)
    approach: float = column(
        "1/s", "expansion rate of an object that approaches a hovering camera; 0 if none does"
    )
    corridor: float = column(
        "1/s",
        "1 / (time to contact) of the [points in the drone's way](measurements.md#the-way); "
        "0 if there are none, [empty](measurements.md#the-rule-of-flight) without the motion",
    )


class _Mean:
    """The mean of rates over time, weighted by their precision: first-order, over `TAU_S`.

    `quality` is the sum of the weights, 0 to 1.
    """

    def __init__(self) -> None:
        self.quality = self._sum = self._upright = self._age = 0.0

    def add(self, found: Growth, age_s: float, interval_s: float) -> None:
        """Add a growth over `age_s`; one that could not be measured only ages the others."""
        newest = -math.expm1(-interval_s / TAU_S)
        weight = rate = upright = 0.0
        if found.rate == found.rate:
            weight = newest * ERROR**2 / (ERROR**2 + (found.error / age_s) ** 2)
            rate, upright = weight * found.rate / age_s, weight * found.upright / age_s
        self._age = (1.0 - newest) * (self._age + interval_s * self.quality)
        self.quality += weight - newest * self.quality
        self._sum += rate - newest * self._sum
        self._upright += upright - newest * self._upright

    @property
    def values(self) -> tuple[float, float, float]:
        """The mean rate, that of what stands upright, and the mean age of the rates in s.

        NaN below `LEAST_WEIGHT`.
        """
        if self.quality <= LEAST_WEIGHT:
            return math.nan, math.nan, math.nan
        q = self.quality
        return self._sum / q, self._upright / q, self._age / q


class _Image(NamedTuple):
    """An image in grey levels, its time, and the drone's motion then."""

    grey: Grey
    time_s: float
    motion: Motion


class Expansion:
    """Expansion rate and time to contact of a sequence of images: causal, in constant memory.

    Points of a window around the direction of flight, see `windows`, are tracked from an image at
    least `LEAST_S` earlier; their `growth`, divided by the time between the images, is the rate
    ahead. `expansion` is the mean of these rates over `TAU_S`, weighted by their precision:

        Σ w r / Σ w,  w = exp(-age / τ) E² / (E² + e²),

    with the rates r, their standard errors e, `TAU_S` = τ and `ERROR` = E; `expansion_quality` is
    Σ w / Σ exp(-age / τ), and `expansion_upright` is the same mean of the growth of what stands
    `upright`. At constant speed, the time to contact was 1 / `expansion` when the rates had their
    mean age Σ w age / Σ w; `ttc_s` is less by this age. Where the drone's attitude is known, its
    turn is left out of the growth, see `turned`. From images `LEAST_AGE_S` apart, `approach`
    is the rate of an object before a camera at rest, and `corridor`, if the drone's motion is
    known, that of points in its way, see `fastest`: the lesser of the last two.

    Parameters
    ----------
    deflicker : bool
        Whether bands of mains light are removed, see `Flicker`.
    camera : Camera
        The angles of the camera.
    at_rest : bool
        Whether objects that approach a camera at rest are measured; exported C does not.

    Examples
    --------
    >>> import numpy as np
    >>> expansion = Expansion()
    >>> [expansion.step(np.full((60, 80), 9, np.uint8), t / 30).approach for t in range(2)]
    [nan, 0.0]
    """

    def __init__(
        self, *, deflicker: bool = True, camera: Camera | None = None, at_rest: bool = True
    ) -> None:
        self._deflickers, self._flicker, self._at_rest = deflicker, Flicker(), at_rest
        self.camera = camera or Camera()
        self._motion = Motion()
        self._filling: Filling | None = None
        self._shown: Flags | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images; the next one may have another size."""
        self._flicker.reset()
        self._earlier: deque[_Image] = deque()
        self._ahead = _Mean()
        self._still: Grey | None = None
        self._still_motion = Motion()
        self._still_s, self._near, self._place = 0.0, 0.0, (0.0, 0.0)
        # The last two rates in the way, and the time between them; none if the motion is unknown.
        self._in_way: list[float] = []
        self._between_s = 0.0
        self._points_of: tuple[Bounds, Points] | None = None
        self._last_s = math.nan

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore the cells of the images where `hidden`, (H, W), is True; None ignores no cells."""
        self._filling = self._shown = self._points_of = None
        if hidden is not None:
            self._filling = Filling(hidden)
            near = cv2.dilate(hidden.astype(np.uint8), np.ones(PATCH_WH, np.uint8))
            self._shown = np.asarray(near == 0)

    def look(self, camera: Camera) -> None:
        """Measure with another camera from now on, see the class."""
        self.camera = camera

    def head(self, motion: Motion) -> None:
        """Measure around a direction of flight, and turn images back, from now on.

        The camera's default direction holds if it is unknown, or the window would leave the image.
        """
        self._motion = motion

    def step(self, grey: Grey, time_s: float | None = None) -> Measured:
        """Measure the expansion from an earlier image to this one.

        Parameters
        ----------
        grey : ndarray, shape (H, W), uint8 or float32
            Grey levels in 0..255, or luminance in 0..1; at most `SMALL_PX` wide.
        time_s : float, optional
            Time of the image in seconds. Without times, images count as 30 per second.

        Returns
        -------
        Measured
            NaN at the first image, if a side of the image is too short (see `too_small`), and if
            the direction of flight is outside the image (see `outside`).
        """
        at_s = math.nan if time_s is None else time_s
        step_s, self._last_s = at_s - self._last_s, at_s
        grey = self._prepared(grey)
        now = _Image(grey, at_s, self._motion)
        before = self._before(at_s)
        self._earlier.append(now)
        if before is None or min(grey.shape) < LEAST_SIDE:
            return Measured()
        motion = self._motion
        window = self.camera.window(grey.shape, motion.direction)
        if window is None:
            # The image does not show where the drone flies: the default direction holds.
            motion, window = Motion(), self.camera.window(grey.shape)
        if window is None:
            return Measured()
        step_s, age_s = (s if s > 0.0 else USUAL_S for s in (step_s, at_s - before.time_s))
        turn = turned(before.motion, now.motion, self.camera, grey.shape)
        ahead = growth(before.grey, grey, self._points(window, grey.shape), turn)
        self._ahead.add(ahead, age_s, step_s)
        if self._at_rest:
            self._look_around(grey, step_s, motion)
        return self._measured(window, grey.shape)

    def _prepared(self, grey: Grey) -> Grey:
        """An image in grey levels, without flicker, and with filled hidden cells."""
        if grey.dtype != np.uint8:
            grey = np.uint8(np.clip(grey, 0.0, 1.0) * 255.0 + 0.5)
        if self._deflickers:
            grey = self._flicker.of(grey)
        if self._filling is not None:
            grey = grey.copy()
            self._filling.fill(grey)
        return grey

    def _before(self, time_s: float) -> _Image | None:
        """The latest image that is at least `LEAST_S` old, or the oldest stored image."""
        while len(self._earlier) > 1 and not 0.0 <= time_s - self._earlier[1].time_s < LEAST_S:
            self._earlier.popleft()
        return self._earlier[0] if self._earlier else None

    def _look_around(self, grey: Grey, step_s: float, motion: Motion) -> None:
        """Measure what is in the way, or approaches a camera at rest, every `LEAST_AGE_S`.

        A copy of the last image, as a stalled stream shows it, has no time of its own: the next
        image is measured in its place.
        """
        self._still_s += step_s
        if self._still is None:
            self._still, self._still_s, self._still_motion = grey, 0.0, motion
            return
        share = step_s / self._still_s
        if self._still_s >= LEAST_AGE_S and (
            self._still_s >= MOST_AGE_S
            or not _is_copy(grey, self._earlier[-2].grey, self._still, share)
        ):
            self._look(self._still, grey, motion)
            self._still, self._still_s, self._still_motion = grey, 0.0, motion

    def _look(self, before: Grey, now: Grey, motion: Motion) -> None:
        """Measure what is in the way if the motion is known, else before a camera at rest."""
        if not (self._still_motion.has_way and motion.has_way):
            growth, self._place = approaching(before, now, self._shown)
            self._near, self._in_way = growth / self._still_s, []
            return
        age_s = self._still_s
        motions = self._still_motion, motion
        rate, place = fastest(before, now, motions, self.camera, age_s, self._shown)
        self._near, self._between_s = 0.0, self._still_s
        self._in_way = [] if math.isnan(rate) else [*self._in_way[-1:], rate]
        self._place = place if rate > 0.0 else self._place

    def _points(self, window: Bounds, shape: tuple[int, ...]) -> Points:
        """The points of the window ahead; made anew only where the window moves."""
        if self._points_of is None or self._points_of[0] != window:
            self._points_of = window, visible(grid(window, N_AHEAD), shape, self._shown)
        return self._points_of[1]

    def _measured(self, window: Bounds, shape: tuple[int, ...]) -> Measured:
        """The rates, and the time to contact by the best of them, with its place."""
        (rate, upright, age_s), quality = self._ahead.values, self._ahead.quality
        left, top, right, bottom = window
        place = (left + right + 1.0) / shape[1] - 1.0, (top + bottom + 1.0) / shape[0] - 1.0
        best = rate if quality >= LEAST_QUALITY else 0.0
        corridor = math.nan
        if len(self._in_way) > 1:  # a single look may be wrong
            corridor = min(self._in_way)
            is_older = corridor < self._in_way[-1]
            best, age_s = corridor, self._still_s + (self._between_s if is_older else 0.0)
            place = self._place if corridor > 0.0 else place
        elif self._near > best:
            # An object that approaches a camera at rest is measured as a whole.
            best, age_s, place = self._near, self._still_s, self._place
        ttc_s = max(1.0 / best - age_s, 0.0) if best >= LEAST_RATE else math.nan
        return Measured(rate, upright, quality, ttc_s, *place, self._near, corridor)


def _is_copy(now: Grey, last: Grey, earlier: Grey, share: float) -> bool:
    """Whether an image has changed since the last one by half of its share of a change or less."""
    return cv2.norm(now, last, cv2.NORM_L1) <= 0.5 * share * cv2.norm(now, earlier, cv2.NORM_L1)


def too_small(size_wh: tuple[int, int]) -> str:
    """Why the expansion of images of this size cannot be measured; empty if it can."""
    width, height = small_wh(*size_wh)
    if min(width, height) >= LEAST_SIDE:
        return ""
    return (
        f"images of {size_wh[0]}x{size_wh[1]} px are too small or too narrow to measure their "
        f"expansion: there is no time to contact (at {width} px wide, both sides need "
        f"{LEAST_SIDE} px)"
    )
