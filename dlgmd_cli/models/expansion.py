"""The expansion rate of the image and the time to contact, measured independently of the model.

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

# For the fit, images are reduced further, by a whole factor, to at least this many columns.
REDUCED_PX = 120
# Time constants (s) of the mean rates over time: of the square window, for the time to contact, and
# of both windows. Interval (s) of frames without times.
TAU_S, TAU_BOTH_S, USUAL_S = 0.1, 0.15, 1.0 / 30.0
# Least time (s) between compared images. Over less time, the change is too small to measure in
# whole grey levels.
LEAST_S = 0.027
# Time (s) between images to which the share of explained change refers. Over a longer time, the
# image changes more, but the unexplained part stays the same.
SHARE_S = 0.034
# Shortest side of a reduced image that is measured, in cells.
LEAST_SIDE = 20
# Weight of |a - b|, which is small for a looming object: in the time to contact, and in the rate of
# both windows.
UNLIKE, UNLIKE_BOTH = 0.25, 0.5
# Largest rate between two frames, in 1/s: a single large rate, as when a lamp is switched on,
# raises no alarm.
MAX_RATE = 2.5
# The exposure has stepped if the image's mean changes by this share, and three quarters of the
# means over 15 x 8 blocks change in the same direction.
STEP, STEP_BLOCKS = 0.05, (15, 8)
# A cell changes if its difference exceeds the mean over all cells by this many grey levels.
CHANGE_LEVELS = 3.0
# An object that moves in front of a camera at rest: least mean change per cell (grey levels),
# largest share of changing cells, and largest spread (share of half the shorter side).
LEAST_CHANGE, MAX_SHARE, MAX_SPREAD = 0.19, 0.4, 0.9
# The window of such an object reaches 1.6 standard deviations from the centroid, at least 6 cells.
REACH, LEAST_REACH = 1.6, 6
# An obstacle may fill only a part of the window, in front of a background that expands less. For
# the time to contact, the rate is therefore divided by the share of the change that it explains;
# this is the least divisor.
LEAST_SHARE = 0.5
# Below this expansion rate, in 1/s, there is no time to contact.
LEAST_RATE = 0.1


class Measured(NamedTuple):
    """What `Expansion` measures at a frame; NaN where it cannot measure.

    Attributes
    ----------
    expansion : float
        Expansion rate D ahead, in 1/s, of both windows; negative where the image shrinks.
    ttc_s : float
        Estimated time to contact in seconds: that of the square window, or 1 / `approach` if this
        is less. NaN where nothing expands or changes.
    expansion_x, expansion_y : float
        Centre of the part of the image that expands, from -1 (left, top) to 1.
    ttc_share : float
        Share of the change in that part that the expansion rate explains, 0 to 1; 1 where an object
        approaches a camera at rest. A higher share means a better estimate. NaN without a time to
        contact.
    approach : float
        Expansion rate, in 1/s, of an object that approaches a camera at rest; 0 where none does.
        The whole object is measured, so that its time to contact is 1 / `approach`.
    """

    expansion: float = math.nan
    ttc_s: float = math.nan
    expansion_x: float = math.nan
    expansion_y: float = math.nan
    ttc_share: float = math.nan
    approach: float = math.nan


class _Mean:
    """The mean of a rate over time: a first-order low-pass with limited input."""

    def __init__(self, tau_s: float) -> None:
        self.value, self._tau_s = 0.0, tau_s

    def add(self, rate: float, interval_s: float, *, is_step: bool) -> None:
        """Add a rate (1/s); at a step of the exposure, it may lower the mean, but not raise it."""
        rate = min(rate, self.value) if is_step else rate
        self.value += _weight(interval_s, self._tau_s) * (_limited(rate, self.value) - self.value)


class _Images(NamedTuple):
    """The time of an image, the reduced image, and its means over blocks."""

    time_s: float
    reduced: FloatImage
    blocks: FloatImage


class Expansion:
    """Expansion rate and time to contact of a sequence of images: causal, in constant memory.

    Two windows are measured, a square and a narrow one, see `windows`. With a and b the rates of a
    window along x and y:

    - `expansion` is D = 0.4 d_s + 0.6 d_n of the square and the narrow window, with d the mean of
      min(a, b) - |a - b| / 2 over `TAU_BOTH_S`;
    - `ttc_s` is max(q, 1/2) / d', with d' the mean of min(a, b) - |a - b| / 4 over `TAU_S`, and q
      the mean over `TAU_S` of the share of the change that a and b explain, see `_share_of`, both
      of the square window; or 1 / `approach` if this is less;
    - `approach` is the rate of an object in front of a background at rest, over half of `TAU_S`.

    Parameters
    ----------
    deflicker : bool
        Whether bands of mains light (see `Flicker`) and steps of the exposure (see `evened`) are
        removed.
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
        """Ignore the cells of the images where `hidden`, (H, W), is True; None ignores no cells."""
        self._visible = None if hidden is None else visible(hidden, self._factor(hidden))
        self._filling = None if hidden is None else Filling(hidden)

    def look(self, camera: Camera) -> None:
        """Measure with another camera from now on, see the class."""
        self._camera = camera

    def head(self, direction: Direction | None) -> None:
        """Measure around a direction of flight from now on; None for the camera's default.

        The camera's default direction also holds if a window would leave the image.
        """
        self._direction = direction

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
        if self._deflickers:
            grey = self._flicker.of(grey)
        if self._filling is not None:
            grey = grey.copy()
            self._filling.fill(grey)
        factor = self._factor(grey)
        now = _Images(at_s, block_means(grey, factor), blocks(grey))
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
        """The latest image that is at least `LEAST_S` old, or the oldest stored image."""
        while len(self._earlier) > 1 and not 0.0 <= time_s - self._earlier[1].time_s < LEAST_S:
            self._earlier.popleft()
        return self._earlier[0] if self._earlier else None

    def _factor(self, image: Grey | Flags) -> int:
        """The factor by which the sides of an image are divided; smaller for a wide lens."""
        return self._camera.factor(image.shape[1], factor_of(image.shape[1]))

    def _windows(self, shape: tuple[int, ...]) -> list[Window] | None:
        """The windows of an image; None if the image does not show them."""
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

        `intervals_s` are the times since the last image, and since the image `before`.
        """
        step_s, age_s = intervals_s
        is_step = False
        if self._deflickers:
            like = evened(before, now)
            is_step = like is not before and not self._has_stepped
            self._has_stepped = like is not before
            # White parts of one image spoil the fit; steps in a row may be one slow step.
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
        """The rates, and the shorter time to contact with its place."""
        rate, share, is_blank = self._ahead.value, self._share, self._is_blank
        place, local = _middle_of(windows, shape), self._local.value
        if local >= LEAST_RATE and max(share, LEAST_SHARE) * local > rate:
            # An object that approaches a camera at rest is measured as a whole.
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
    """min(a, b) - unlike · |a - b|: a looming object grows alike along x and y."""
    return min(motion.a, motion.b) - unlike * abs(motion.a - motion.b)


def _share_of(share: float, age_s: float) -> float:
    """The share of the change that a motion would explain between images `SHARE_S` apart.

    With r the mean square of the unexplained and e of the explained change, share is
    1 - sqrt(r / (r + e)); e grows with the square of the time, r stays the same.
    """
    if age_s <= SHARE_S:
        return share
    left = (1.0 - share) ** 2
    return 1.0 - math.sqrt(left / (left + (SHARE_S / age_s) ** 2 * (1.0 - left)))


def _middle_of(windows: list[Window], shape: tuple[int, ...]) -> tuple[float, float]:
    """The mean centre of windows, x and y from -1 to 1."""
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
    """Weight of the newest value in a first-order mean over time."""
    return -math.expm1(-interval_s / tau_s)


def _limited(rate: float, mean: float) -> float:
    """The rate within `MAX_RATE` either way; twice a positive mean is added to the upper limit."""
    return min(max(rate, -MAX_RATE), MAX_RATE + 2.0 * max(mean, 0.0))


def factor_of(width: int) -> int:
    """The factor by which the sides of an image of this width are divided."""
    return max(1, width // REDUCED_PX)


def block_means(frame: Grey, factor: int) -> FloatImage:
    """Means over blocks of an image, then over 3x3 block means, in whole levels of 0 to 255."""
    height, width = (side // factor for side in frame.shape)
    image: Grey = frame[: height * factor, : width * factor].astype(np.float32)
    if factor > 1 and height and width:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    blurred = cv2.blur(image, (3, 3), borderType=cv2.BORDER_REPLICATE)
    levels = blurred if frame.dtype == np.uint8 else np.float32(255.0) * blurred
    # Rounds halves up, also halves with a rounding error.
    return np.floor(levels + np.float32(0.5001), out=aligned(levels.shape))


def visible(hidden: Flags, factor: int) -> FloatImage:
    """1.0 in the cells of a reduced image to which no hidden pixel contributes, else 0.0."""
    height, width = (side // factor for side in hidden.shape)
    shown = np.float32(hidden[: height * factor, : width * factor])
    shown = cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.dilate(shown, np.ones((3, 3))) == 0.0, np.float32)


def evened(before: FloatImage, now: FloatImage) -> FloatImage:
    """The earlier image at the brightness of the newest, in whole levels, after an exposure step.

    Without a step, `before` itself. An approaching object changes the brightness of a part of the
    image; a step of the exposure changes the whole image alike.
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
    """By what share an object grows from one frame to the next, in front of a still background.

    The motion is fitted in a window around the centroid of the change, as wide as the change
    spreads. An approaching object expands along both sides about a point inside the window; an
    object that passes by moves as a whole.

    Returns
    -------
    rate : float
        The smaller growth, along x or y; 0 if nothing approaches, or the change is spread out.
    place : (float, float)
        Centre of the window, x and y from -1 to 1.
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
