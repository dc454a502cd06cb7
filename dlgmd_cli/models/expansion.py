"""The expansion rate of the image and the time to contact: a measurement beside every model.

The rates a and b at which the image of an object ahead grows, see `motion`, are about
1 / (time to contact), per second: the τ of Lee (1976).
"""

import math
from collections import deque
from typing import NamedTuple

import cv2
import numpy as np

from dlgmd_cli.frame import SMALL_PX, small_wh
from dlgmd_cli.models.base import Flags, FloatImage, Grey
from dlgmd_cli.models.motion import MAX_SHIFT, Motion, blocks, fitted, follow
from dlgmd_cli.models.prepare import Filling, Flicker
from dlgmd_cli.models.receptors import aligned
from dlgmd_cli.models.windows import PARTS, Camera, Direction, Window

# Images are reduced further for the fit, by a whole factor, to at least this many columns.
REDUCED_PX = 120
# Time constants of the means over time, in seconds, of the rate that the time to contact follows
# and of that of both windows; and the interval of frames without times.
TAU_S, TAU_BOTH_S, USUAL_S = 0.1, 0.15, 1.0 / 30.0
# Between images that are closer in time, the change is too small to measure in whole levels: an
# image is compared with an earlier one.
LEAST_S = 0.027
# Between images that are further apart, more changes, but the unexplained part stays the same: the
# share of the explained change is taken as if they were this far apart, in seconds.
SHARE_S = 0.034
# Smallest side of a reduced image that is measured.
LEAST_SIDE = 20
# Weight of the difference between the two rates, which are alike where something looms: in the
# time to contact, and in the rate of both windows.
UNLIKE, UNLIKE_BOTH = 0.25, 0.5
# Greatest rate between two frames, in 1/s: a single one, such as that of a lamp that is switched
# on, raises no alarm.
MAX_RATE = 2.5
# The exposure has stepped if the mean of the image changes by this share, and three quarters of the
# means over 15 x 8 blocks change in the same direction.
STEP, STEP_BLOCKS = 0.05, (15, 8)
# A cell changes if it differs by this many grey levels more than the mean of all cells.
CHANGE_LEVELS = 3.0
# What moves before a still camera: least change a cell of the image, in grey levels, greatest
# share of the cells that change, and greatest spread, as a share of the shorter side's half.
LEAST_CHANGE, MAX_SHARE, MAX_SPREAD = 0.19, 0.4, 0.9
# The window of such a thing reaches 1.6 standard deviations from the centroid, at least 6 cells.
REACH, LEAST_REACH = 1.6, 6
# Of what the drone flies at, the middle of the image shows a part, before a background that expands
# less: the rate is that of the whole times the share of the change that it explains, and at least
# this one.
LEAST_SHARE = 0.5
# Below this expansion, in 1/s, there is no time to contact.
LEAST_RATE = 0.1


class Measured(NamedTuple):
    """What `Expansion` says about a frame; NaN where it cannot tell.

    Attributes
    ----------
    expansion : float
        Expansion rate D ahead, in 1/s, of both windows; negative where the image shrinks.
    ttc_s : float
        Estimated time to contact in seconds; NaN where nothing expands or changes. It is the
        lesser of that of the square window, and of 1 / `approach`.
    expansion_x, expansion_y : float
        Centre of the part of the image that expands, from -1 (left, top) to 1.
    ttc_share : float
        Share of the change in that part that its rate explains, 0 to 1; 1 where an object
        approaches a camera at rest. The higher it is, the better the estimate. NaN without a time
        to contact.
    approach : float
        Expansion rate, in 1/s, of what approaches a camera at rest; 0 where nothing does. It is
        measured as a whole, so that its time to contact is 1 / `approach`.
    """

    expansion: float = math.nan
    ttc_s: float = math.nan
    expansion_x: float = math.nan
    expansion_y: float = math.nan
    ttc_share: float = math.nan
    approach: float = math.nan


class _Mean:
    """The mean of a rate over time, of first order, within limits."""

    def __init__(self, tau_s: float) -> None:
        self.value, self._tau_s = 0.0, tau_s

    def add(self, rate: float, interval_s: float, *, is_step: bool) -> None:
        """Add a rate; one at a step of the exposure may hide an expansion, but not show one."""
        rate = min(rate, self.value) if is_step else rate
        self.value += _weight(interval_s, self._tau_s) * (_limited(rate, self.value) - self.value)


class _Images(NamedTuple):
    """An image as it is measured: its time, reduced, and in blocks."""

    time_s: float
    reduced: FloatImage
    blocks: FloatImage


class Expansion:
    """Expansion rate and time to contact of a sequence of images: causal, in constant memory.

    Two windows are measured, a square and a narrow one, see `windows`. With a and b the rates of
    a window along x and y:

    - `expansion` is D = 0.4 d_s + 0.6 d_n of the square and the narrow window, with d the mean of
      min(a, b) - |a - b| / 2 over `TAU_BOTH_S`;
    - `ttc_s` is max(q, 1/2) / d', with d' the mean of min(a, b) - |a - b| / 4 of the square, and
      q that of the share of the change that a and b explain, over `TAU_S`, see `_share_of`; or
    - 1 / `approach` where that is less, the rate of what moves in front of a background at rest.
      It is measured as a whole, and is the mean over half of `TAU_S`.

    Parameters
    ----------
    deflicker : bool
        Whether bands of mains light are removed, see `Flicker`, and steps of the exposure, see
        `evened`.
    camera : Camera
        The angles of the camera.

    Examples
    --------
    >>> import numpy as np
    >>> expansion = Expansion()
    >>> [expansion.step(np.full((60, 80), 9, np.uint8), t / 30).expansion for t in range(2)]
    [nan, 0.0]
    """

    def __init__(self, *, deflicker: bool = True, camera: Camera | None = None) -> None:
        self._deflickers, self._flicker = deflicker, Flicker()
        self._camera = camera or Camera()
        self._direction: Direction | None = None
        self._filling: Filling | None = None
        self._visible: FloatImage | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images; the next one may have another size."""
        self._flicker.reset()
        self._earlier: deque[_Images] = deque()
        self._ahead, self._local = _Mean(TAU_S), _Mean(TAU_S / 2.0)
        self._both = _Mean(TAU_BOTH_S), _Mean(TAU_BOTH_S)
        self._share, self._is_blank = 0.0, False
        self._place, self._shift_blocks = (0.0, 0.0), (0, 0)
        self._last_s, self._has_stepped = math.nan, False

    def ignore(self, hidden: Flags | None) -> None:
        """Leave some cells of the images, (H, W) bool, out from now on; None for none."""
        self._visible = None if hidden is None else visible(hidden, self._factor(hidden))
        self._filling = None if hidden is None else Filling(hidden)

    def look(self, camera: Camera) -> None:
        """Measure with another camera from now on, see the class."""
        self._camera = camera

    def head(self, direction: Direction | None) -> None:
        """Measure around a direction of flight from now on; None for the camera's own.

        Where a window would leave the image, the camera's own holds, too.
        """
        self._direction = direction

    def step(self, grey: Grey, time_s: float | None = None) -> Measured:
        """Measure the expansion from an earlier image to this one.

        Parameters
        ----------
        grey : ndarray, shape (H, W), uint8 or float32
            Grey levels in 0..255, or luminance in 0..1; at most `SMALL_PX` wide.
        time_s : float, optional
            Time of the image. Without times, images count as 30 per second.

        Returns
        -------
        Measured
            NaN at the first image, if a side of the image is too short, see `too_small`, and if
            the camera does not see where the drone flies, see `outside`.
        """
        at_s = math.nan if time_s is None else time_s
        step_s, self._last_s = at_s - self._last_s, at_s
        if self._deflickers:
            grey = self._flicker.of(grey)
        if self._filling is not None:
            grey = grey.copy()
            self._filling.fill(grey)
        factor = self._factor(grey)
        now = _Images(at_s, reduced(grey, factor), blocks(grey))
        before = self._before(at_s)
        self._earlier.append(now)
        if before is None or min(now.reduced.shape) < LEAST_SIDE:
            return Measured()
        windows = self._windows(now.reduced.shape)
        if windows is None:
            return Measured()
        most = max(1, math.floor(MAX_SHIFT * grey.shape[1] / SMALL_PX + 0.5))
        self._shift_blocks, cells = follow(now.blocks, before.blocks, self._shift_blocks, most)
        start, age_s = (cells[0] / factor, cells[1] / factor), at_s - before.time_s
        step_s, age_s = (s if s > 0.0 else USUAL_S for s in (step_s, age_s))
        self._measure(now.reduced, before.reduced, windows, start, (step_s, age_s))
        return self._measured(windows, now.reduced.shape)

    def _before(self, time_s: float) -> _Images | None:
        """The latest image that is old enough to compare with, or the oldest that is left."""
        while len(self._earlier) > 1 and not 0.0 <= time_s - self._earlier[1].time_s < LEAST_S:
            self._earlier.popleft()
        return self._earlier[0] if self._earlier else None

    def _factor(self, image: Grey | Flags) -> int:
        """By how much the sides of an image are divided: less for a wide lens."""
        return self._camera.factor(image.shape[1], factor_of(image.shape[1]))

    def _windows(self, shape: tuple[int, ...]) -> list[Window] | None:
        """The windows of an image; None if it does not have them."""
        return self._camera.windows(shape, self._direction) or self._camera.windows(shape)

    def _measure(
        self,
        now: FloatImage,
        before: FloatImage,
        windows: list[Window],
        start: tuple[float, float],
        intervals_s: tuple[float, float],
    ) -> None:
        """Add the rates between two reduced images to their means over time.

        `intervals_s` are the times since the last image, and since the one that is compared.
        """
        step_s, age_s = intervals_s
        is_step = False
        if self._deflickers:
            like = evened(before, now)
            is_step = like is not before and not self._has_stepped
            self._has_stepped = like is not before
            # What is white in one of them spoils the fit; several in a row may be one slow step.
            before = before if is_step else like
        motions = [fitted(now, before, window, start, self._visible) for window in windows]
        square = motions[0]
        if not math.isnan(square.share):
            share = _share_of(square.share, age_s)
            self._share += _weight(step_s, TAU_S) * (share - self._share)
        self._is_blank = math.isnan(square.share)
        local = 0.0
        if self._shift_blocks == (0, 0):
            rate, place = approaching(now, before, self._visible)
            local, self._place = rate / age_s, place if rate > 0.0 else self._place
        self._ahead.add(_alike(square, UNLIKE) / age_s, step_s, is_step=is_step)
        self._local.add(local, step_s, is_step=is_step)
        for mean, motion in zip(self._both, motions, strict=False):
            mean.add(_alike(motion, UNLIKE_BOTH) / age_s, step_s, is_step=is_step)

    def _measured(self, windows: list[Window], shape: tuple[int, ...]) -> Measured:
        """The rates, with the lesser time to contact and its place."""
        rate, share, is_blank = self._ahead.value, self._share, self._is_blank
        place, local = _middle_of(windows, shape), self._local.value
        if local >= LEAST_RATE and max(share, LEAST_SHARE) * local > rate:
            # What approaches a camera at rest is measured as a whole.
            rate, place, share, is_blank = local, self._place, 1.0, False
        ttc_s = math.nan
        if rate < LEAST_RATE or is_blank:
            share = math.nan
        else:
            ttc_s = max(share, LEAST_SHARE) / rate
        rates = (mean.value for mean in self._both)
        both = sum(part.weight * rate for part, rate in zip(PARTS, rates, strict=True))
        return Measured(both, ttc_s, *place, share, local)


def _alike(motion: Motion, unlike: float) -> float:
    """The lesser rate of a motion, less a part of the difference: what looms grows alike."""
    return min(motion.a, motion.b) - unlike * abs(motion.a - motion.b)


def _share_of(share: float, age_s: float) -> float:
    """The share that a motion would explain of the change between images `SHARE_S` apart.

    With r and e the squares of what is left and of what is explained, 1 - share is
    sqrt(r / (r + e)); e grows as the square of the time, and r does not.
    """
    if age_s <= SHARE_S:
        return share
    left = (1.0 - share) ** 2
    return 1.0 - math.sqrt(left / (left + (SHARE_S / age_s) ** 2 * (1.0 - left)))


def _middle_of(windows: list[Window], shape: tuple[int, ...]) -> tuple[float, float]:
    """The mean of the middles of windows, x and y from -1 to 1."""
    tops, bottoms, lefts, rights = (
        sum(edges) / len(windows) for edges in zip(*windows, strict=True)
    )
    return (lefts + rights) / shape[1] - 1.0, (tops + bottoms) / shape[0] - 1.0


def too_small(size_wh: tuple[int, int]) -> str:
    """Why the expansion of images of this size cannot be measured; empty if it can."""
    width, height = small_wh(*size_wh)
    factor = factor_of(width)
    if min(width, height) // factor >= LEAST_SIDE:
        return ""
    return (
        f"images of {size_wh[0]}x{size_wh[1]} px are too small or too narrow to measure their "
        f"expansion: there is no time to contact (at {width} px wide, both sides need "
        f"{LEAST_SIDE * factor} px)"
    )


def _weight(interval_s: float, tau_s: float) -> float:
    """Weight of the newest value of a mean."""
    return -math.expm1(-interval_s / tau_s)


def _limited(rate: float, mean: float) -> float:
    """A rate within limits, which widen as the mean grows."""
    return min(max(rate, -MAX_RATE), MAX_RATE + 2.0 * max(mean, 0.0))


def factor_of(width: int) -> int:
    """By how much the sides of a image are divided."""
    return max(1, width // REDUCED_PX)


def reduced(frame: Grey, factor: int) -> FloatImage:
    """Means over blocks of an image, and over 3x3 of those, in whole levels of 0 to 255."""
    height, width = (side // factor for side in frame.shape)
    image: Grey = frame[: height * factor, : width * factor].astype(np.float32)
    if factor > 1 and height and width:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    blurred = cv2.blur(image, (3, 3), borderType=cv2.BORDER_REPLICATE)
    levels = blurred if frame.dtype == np.uint8 else np.float32(255.0) * blurred
    # Halves up, also rounded ones.
    return np.floor(levels + np.float32(0.5001), out=aligned(levels.shape))


def visible(hidden: Flags, factor: int) -> FloatImage:
    """1.0 in the cells of a reduced image to which no hidden pixel contributes, else 0.0."""
    height, width = (side // factor for side in hidden.shape)
    shown = np.float32(hidden[: height * factor, : width * factor])
    shown = cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.dilate(shown, np.ones((3, 3))) == 0.0, np.float32)


def evened(before: FloatImage, now: FloatImage) -> FloatImage:
    """An earlier image as bright as the newest, in whole levels, if the exposure has stepped.

    Else the image itself. What comes near changes the brightness of a part of the image; a step
    of the exposure changes all of it alike.
    """
    if abs(cv2.mean(now)[0] / max(cv2.mean(before)[0], 1.0) - 1.0) < STEP:
        return before
    pair = (now, before)
    blocks = (cv2.resize(image, STEP_BLOCKS, interpolation=cv2.INTER_AREA) + 1.0 for image in pair)
    low, ratio, high = np.quantile(np.divide(*blocks), [0.25, 0.5, 0.75]).tolist()
    if low < 1.0 + STEP and high > 1.0 - STEP:
        return before
    like = np.floor(before * np.float32(ratio) + np.float32(0.5), out=aligned(before.shape))
    return np.minimum(like, np.float32(255.0), out=like)


def approaching(
    now: FloatImage, before: FloatImage, shown: FloatImage | None = None
) -> tuple[float, tuple[float, float]]:
    """By what share an object grows from one frame to the next, in front of what stands still.

    The part of the image about the centroid of the change is fitted, as wide as the change
    spreads. It is an approach if it expands along both sides about a point inside: what passes by
    moves as a whole.

    Returns
    -------
    rate : float
        The lesser of its expansions; 0 if nothing approaches, or the change is not in one place.
    place : (float, float)
        Centre of the part, x and y from -1 to 1.
    """
    nothing = 0.0, (0.0, 0.0)
    change = cv2.absdiff(now, before, dst=aligned(now.shape))
    level = CHANGE_LEVELS + cv2.mean(change)[0]
    above = cv2.threshold(change - np.float32(level), 0.0, 0.0, cv2.THRESH_TOZERO)[1]
    total, side = cv2.sumElems(above)[0], min(now.shape) // 2
    if total < LEAST_CHANGE * above.size or cv2.countNonZero(above) > MAX_SHARE * above.size:
        return nothing
    window, reaches = [], []
    for axis, n in enumerate(above.shape):
        profile = cv2.reduce(above, 1 - axis, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
        places = np.arange(n)
        centroid = float(profile @ places) / total
        spread = math.sqrt(max(float(profile @ (places - centroid) ** 2) / total, 0.0))
        if spread > MAX_SPREAD * side:
            return nothing
        reach = math.floor(min(max(REACH * spread, LEAST_REACH), side / 2.0) + 0.5)
        at = min(max(math.floor(centroid + 0.5), reach + 1), n - 2 - reach)
        window += [at - reach, at + reach + 1]
        reaches.append(reach)
    top, bottom, left, right = window
    motion = fitted(now, before, (top, bottom, left, right), (0.0, 0.0), shown)
    if abs(motion.v) >= motion.b * reaches[0] or abs(motion.u) >= motion.a * reaches[1]:
        return nothing
    place = (left + right) / now.shape[1] - 1.0, (top + bottom) / now.shape[0] - 1.0
    return max(min(motion.a, motion.b), 0.0), place
