"""The expansion rate of the image and the time to contact: a measurement beside every model.

Between two frames, a part of the image moves along x by ``u + a x`` and along y by ``v + b y``,
with x and y from the middle of the part. The rates a and b of an object ahead are about
1 / (time to contact), per second: the τ of Lee (1976). They are fitted to the brightness gradients
directly, without optical flow (Negahdaripour and Horn, 1989; Horn, Fang and Masaki, 2007).
"""

import math
from functools import cache, partial
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import SMALL_PX, small_wh
from dlgmd_cli.models.base import Flags, FloatImage, Grey, aligned
from dlgmd_cli.models.prepare import Filling, Flicker

# Rows from, up to; columns from, up to.
Window = tuple[int, int, int, int]
# Rows and columns.
Shift = tuple[int, int]
# Of each cell of a side: the cell before it, how far it is beyond that, and 1.0 where both it and
# the next one are in the image; None where all are. Shape (n,) each.
_Side = tuple[npt.NDArray[np.intp], FloatImage, FloatImage | None]

# The fit reduces them further, by a whole factor, to at least so many columns.
REDUCED_PX = 120
# The shift of the whole image is found on means over blocks of so many cells; it is at most so many
# blocks in an image of `SMALL_PX`, and less in a narrower one.
BLOCK, MAX_SHIFT = 4, 4
# Time constant of the mean over time, in seconds, and the interval of frames without times.
TAU_S, USUAL_S = 0.1, 1.0 / 30.0
# Smallest side of a reduced image that is measured.
LEAST_SIDE = 20
# Gauss-Newton steps.
N_STEPS = 2
# Scale of the residuals: this multiple of their mean, and so many grey levels.
RESIDUALS, RESIDUAL_LEVELS = 1.5, 1.0
# What is added to the diagonal of the normal equations: relative, for shifts, and for rates.
RIDGE, RIDGE_SHIFT, RIDGE_RATE = 1e-6, 1e-3, 0.1
# Weight of the difference between the two rates, which are alike where something looms.
UNLIKE = 0.25
# Greatest rate between two frames, in 1/s: a single one, such as that of a lamp that is switched
# on, raises no alarm.
MAX_RATE = 2.5
# The exposure has stepped if the mean of the image changes by so much, and three quarters of the
# means over so many columns and rows of blocks do in the same direction.
STEP, STEP_BLOCKS = 0.05, (15, 8)
# A cell changes if it does by this more than the mean of all, in grey levels.
CHANGE_LEVELS = 3.0
# What moves before a still camera: least change a cell of the image, in grey levels, greatest
# share of the cells that change, and greatest spread, as a share of the shorter side's half.
LEAST_CHANGE, MAX_SHARE, MAX_SPREAD = 0.19, 0.4, 0.9
# Its window reaches so many standard deviations from the centroid, and so many cells at least.
REACH, LEAST_REACH = 1.6, 6
# Of what the drone flies at, the middle of the image shows a part, before a background that expands
# less: the rate is that of the whole times the share of the change that it explains, and at least
# this one.
LEAST_SHARE = 0.5
# Nothing changes in a window if the mean square of its residuals is less, in grey levels squared.
LEAST_SQUARE = 0.01
# Below this expansion, in 1/s, there is no time to contact.
LEAST_RATE = 0.1
# The same as a factor of the normal equations, and what is added to them.
_RELATIVE = 1.0 + RIDGE * np.eye(4)
_ABSOLUTE = np.diag([RIDGE_SHIFT, RIDGE_SHIFT, RIDGE_RATE, RIDGE_RATE])


class Motion(NamedTuple):
    """Shift along y and x in cells, and the rates of expansion, each from one frame to the next.

    `share` is the share of the change that the rates explain, 0 to 1: one less the ratio of the
    residuals with and without them. It is NaN where nothing changes but by the shift.
    """

    v: float = 0.0
    u: float = 0.0
    b: float = 0.0
    a: float = 0.0
    share: float = math.nan


class Measured(NamedTuple):
    """What `Expansion` says about a frame; NaN where it cannot tell.

    Attributes
    ----------
    expansion : float
        Expansion rate D, in 1/s; negative where the image shrinks and nothing approaches.
    ttc_s : float
        Estimated time to contact in seconds; NaN where nothing expands or changes. It is 1 / D
        times the share of the change that D explains, which counts as half at least.
    expansion_x, expansion_y : float
        Centre of the part of the image that D is from, from -1 (left, top) to 1.
    ttc_share : float
        Share of the change in that part that D explains, 0 to 1; 1 where an object approaches a
        camera at rest. The higher it is, the better the estimate. NaN without a time to contact.
    """

    expansion: float = math.nan
    ttc_s: float = math.nan
    expansion_x: float = math.nan
    expansion_y: float = math.nan
    ttc_share: float = math.nan


class Expansion:
    """Expansion rate and time to contact of a sequence of images: causal, in constant memory.

    D is one of two rates, the one with the shorter time to contact. The first is that of the square
    in the middle of the image whose side is half of the shorter side: the lesser of a and b, less a
    quarter of their difference. The second is that of what moves in front of a background at rest;
    it is measured as a whole, so that its time to contact is 1 / D. Both are means over time with
    the time constants `TAU_S` and half of it.

    Parameters
    ----------
    deflicker : bool
        Whether bands of mains light are removed, see `Flicker`, and steps of the exposure, see
        `evened`.

    Examples
    --------
    >>> import numpy as np
    >>> expansion = Expansion()
    >>> [expansion.step(np.full((60, 80), 9, np.uint8), t / 30).expansion for t in range(2)]
    [nan, 0.0]
    """

    def __init__(self, *, deflicker: bool = True) -> None:
        self._deflickers, self._flicker = deflicker, Flicker()
        self._filling: Filling | None = None
        self._visible: FloatImage | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all earlier images; the next one may have another size."""
        self._flicker.reset()
        self._before: tuple[FloatImage, FloatImage] | None = None
        self._ahead = self._local = self._share = 0.0
        self._is_blank = False
        self._place, self._shift_blocks = (0.0, 0.0), (0, 0)
        self._last_s, self._has_stepped = math.nan, False

    def ignore(self, hidden: Flags | None) -> None:
        """Leave some cells of the images, (H, W) bool, out from now on; None for none."""
        self._visible = None if hidden is None else visible(hidden)
        self._filling = None if hidden is None else Filling(hidden)

    def step(self, grey: Grey, time_s: float | None = None) -> Measured:
        """Measure the expansion from the previous image to this one.

        Parameters
        ----------
        grey : ndarray, shape (H, W), uint8 or float32
            Grey levels in 0..255, or luminance in 0..1; at most `SMALL_PX` wide.
        time_s : float, optional
            Time of the image. Without times, images count as 30 per second.

        Returns
        -------
        Measured
            NaN at the first image, and if a side of the image is too short, see `too_small`.
        """
        interval_s = math.nan if time_s is None else time_s - self._last_s
        self._last_s = math.nan if time_s is None else time_s
        if self._deflickers:
            grey = self._flicker.of(grey)
        if self._filling is not None:
            grey = grey.copy()
            self._filling.fill(grey)
        before, now = self._before, (reduced(grey), blocks(grey))
        self._before = now
        if before is None or min(now[0].shape) < LEAST_SIDE:
            return Measured()
        most = max(1, math.floor(MAX_SHIFT * grey.shape[1] / SMALL_PX + 0.5))
        self._shift_blocks, cells = follow(now[1], before[1], self._shift_blocks, most)
        factor = factor_of(grey.shape[1])
        start = cells[0] / factor, cells[1] / factor
        self._measure(now[0], before[0], start, interval_s if interval_s > 0.0 else USUAL_S)
        return self._measured()

    def _measure(
        self, now: FloatImage, before: FloatImage, start: tuple[float, float], interval_s: float
    ) -> None:
        """Add the rates between two reduced images to their means over time."""
        is_step = False
        if self._deflickers:
            like = evened(before, now)
            is_step = like is not before and not self._has_stepped
            self._has_stepped = like is not before
            # What is white in one of them spoils the fit; several in a row may be one slow step.
            before = before if is_step else like
        motion = fitted(now, before, middle(now.shape), start, self._visible)
        ahead = (min(motion.a, motion.b) - UNLIKE * abs(motion.a - motion.b)) / interval_s
        if not math.isnan(motion.share):
            self._share += _weight(interval_s, TAU_S) * (motion.share - self._share)
        self._is_blank = math.isnan(motion.share)
        local = 0.0
        if self._shift_blocks == (0, 0):
            rate, place = approaching(now, before, self._visible)
            local, self._place = rate / interval_s, place if rate > 0.0 else self._place
        if is_step:  # which may hide an expansion, but not show one
            ahead, local = min(ahead, self._ahead), min(local, self._local)
        self._ahead += _weight(interval_s, TAU_S) * (_limited(ahead, self._ahead) - self._ahead)
        # What approaches a camera at rest is near once it is seen.
        weight = _weight(interval_s, TAU_S / 2.0)
        self._local += weight * (_limited(local, self._local) - self._local)

    def _measured(self) -> Measured:
        """The greater rate, with its time to contact and its place."""
        rate, place, share, is_blank = self._ahead, (0.0, 0.0), self._share, self._is_blank
        if self._local >= LEAST_RATE and max(share, LEAST_SHARE) * self._local > rate:
            # What approaches a camera at rest is measured as a whole.
            rate, place, share, is_blank = self._local, self._place, 1.0, False
        if rate < LEAST_RATE or is_blank:
            return Measured(rate, math.nan, *place)
        return Measured(rate, max(share, LEAST_SHARE) / rate, *place, share)


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


def blocks(frame: Grey) -> FloatImage:
    """Means over whole blocks of `BLOCK` x `BLOCK` cells of an image, in its own levels."""
    height, width = (n // BLOCK for n in frame.shape)
    if height == 0 or width == 0:
        return np.zeros((height, width), np.float32)
    whole = frame[: height * BLOCK, : width * BLOCK].astype(np.float32)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def _weight(interval_s: float, tau_s: float) -> float:
    """Weight of the newest value of a mean."""
    return -math.expm1(-interval_s / tau_s)


def _limited(rate: float, mean: float) -> float:
    """A rate within limits, which widen as the mean grows."""
    return min(max(rate, -MAX_RATE), MAX_RATE + 2.0 * max(mean, 0.0))


def factor_of(width: int) -> int:
    """By how much the sides of a image are divided."""
    return max(1, width // REDUCED_PX)


def middle(shape: tuple[int, ...]) -> Window:
    """The square in the middle whose side is half of the shorter one."""
    half = min(shape) // 2
    top, left = ((side - half) // 2 for side in shape)
    return top, top + half, left, left + half


def reduced(frame: Grey) -> FloatImage:
    """Means over blocks of an image, and over 3x3 of those, in whole levels of 0 to 255."""
    factor = factor_of(frame.shape[1])
    height, width = (side // factor for side in frame.shape)
    image: Grey = frame[: height * factor, : width * factor].astype(np.float32)
    if factor > 1 and height and width:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    blurred = cv2.blur(image, (3, 3), borderType=cv2.BORDER_REPLICATE)
    levels = blurred if frame.dtype == np.uint8 else np.float32(255.0) * blurred
    # Halves up, also rounded ones.
    return np.floor(levels + np.float32(0.5001), out=aligned(levels.shape))


def visible(hidden: Flags) -> FloatImage:
    """1.0 in the cells of a reduced image that no hidden cell of the frame enters, else 0.0."""
    factor = factor_of(hidden.shape[1])
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


@cache
def _places(n: int) -> FloatImage:
    """Places of n cells, from their middle."""
    return (np.arange(n) - (n - 1) / 2).astype(np.float32)


def fitted(
    now: FloatImage,
    before: FloatImage,
    window: Window,
    start: tuple[float, float],
    shown: FloatImage | None = None,
) -> Motion:
    """The motion of a window of the earlier image, by robust least squares on its gradients.

    `start` is the shift along y and x to begin with. The window must leave out the border cells.
    Where `shown`, of the image's shape, is 0.0, cells do not count. No motion is found if less
    than a quarter of the window is shown and still in the image.
    """
    top, bottom, left, right = window
    y, x = _places(bottom - top), _places(right - left)
    # The slopes by v, u, b and a, and what the motion does not explain: so that one product has
    # all sums. Calls, not cells, take the time.
    shape = 5, bottom - top, right - left
    terms, weighted = aligned(shape), aligned(shape)
    _slopes(before[top - 1 : bottom + 1, left - 1 : right + 1], terms)
    np.multiply(terms[0], y[:, None], out=terms[2])
    np.multiply(terms[1], x, out=terms[3])
    inside, rest = before[top:bottom, left:right], terms[4]
    motion = np.array([*start, 0.0, 0.0])
    middle_y, middle_x = (top + bottom - 1) / 2, (left + right - 1) / 2
    for _ in range(N_STEPS):
        v, u, b, a = motion.tolist()
        rows = _along(middle_y + v, 1.0 + b, y, now.shape[0])
        columns = _along(middle_x + u, 1.0 + a, x, now.shape[1])
        np.subtract(inside, _sampled(now, rows, columns), out=rest)
        is_seen, n_seen = None, rest.size
        if rows[2] is not None or columns[2] is not None or shown is not None:
            inside_y, inside_x = (
                np.ones(n, np.float32) if side[2] is None else side[2]
                for side, n in zip((rows, columns), rest.shape, strict=True)
            )
            is_seen = np.outer(inside_y, inside_x)
            if shown is not None:
                is_seen *= shown[top:bottom, left:right]
            n_seen = np.count_nonzero(is_seen)
            if 4 * n_seen < rest.size:
                return Motion()
            rest *= is_seen
        scale = RESIDUALS * cv2.norm(rest, cv2.NORM_L1) / n_seen + RESIDUAL_LEVELS
        # The roots of the weights, for both factors of each product.
        roots = rest * np.float32(1.0 / scale)
        roots *= roots
        roots += 1.0
        np.sqrt(roots, out=roots)
        np.divide(1.0 if is_seen is None else is_seen, roots, out=roots)
        np.multiply(terms, roots, out=weighted)
        # OpenCV's product: NumPy's would end the process where OpenBLAS gets no memory.
        sums = cv2.mulTransposed(weighted.reshape(5, -1), False, dtype=cv2.CV_64F)
        matrix = sums[:4, :4] * _RELATIVE + _ABSOLUTE
        # Faster than NumPy's for so few numbers.
        step = cv2.solve(matrix, sums[:4, 4:].copy(), flags=cv2.DECOMP_LU)[1].ravel()
        motion += step
    # The squares of the residuals with the rates, and of what these explain.
    residual = max(float(sums[4, 4] - step @ sums[:4, 4]), 0.0)
    explained = max(float(motion[2:] @ sums[2:4, 2:4] @ motion[2:]), 0.0)
    v, u, b, a = motion.tolist()
    if residual + explained < LEAST_SQUARE * n_seen:
        return Motion(v, u, b, a)
    return Motion(v, u, b, a, 1.0 - math.sqrt(residual / (residual + explained)))


def _slopes(patch: FloatImage, out: FloatImage) -> None:
    """Sobel gradients along y and x, an eighth of them, of all but the border cells, to out[:2]."""
    pairs = patch[:, :-1] + patch[:, 1:]
    across = pairs[:, :-1] + pairs[:, 1:]
    np.subtract(across[2:], across[:-2], out=out[0])
    pairs = patch[:-1] + patch[1:]
    down = pairs[:-1] + pairs[1:]
    np.subtract(down[:, 2:], down[:, :-2], out=out[1])
    out[:2] *= np.float32(0.125)


def _along(middle: float, rate: float, places: FloatImage, n: int) -> _Side:
    """Where a window has the cells at `middle + rate * places` of n."""
    at = rate * places
    at += middle
    whole = np.floor(at)
    at -= whole
    cells = whole.astype(np.intp)
    first, last = int(cells[0]), int(cells[-1])
    if 0 <= first < n - 1 and 0 <= last < n - 1:
        return cells, at, None
    inside = ((cells >= 0) & (cells < n - 1)).astype(np.float32)
    return np.minimum(np.maximum(cells, 0), n - 2), at, inside


def _sampled(now: FloatImage, rows: _Side, columns: _Side) -> FloatImage:
    """A image between its cells, linear, (h, w)."""
    (y, part_y, _), (x, part_x, _) = rows, columns
    lines, below = now.take(y, 0), now.take(y + 1, 0)
    below -= lines
    below *= part_y[:, None]
    lines += below
    seen, beside = lines.take(x, 1), lines.take(x + 1, 1)
    beside -= seen
    beside *= part_x
    seen += beside
    return seen


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


def mean_change(now: Grey, before: Grey, shift: Shift) -> float:
    """Mean |a(i) - b(i - shift)| where an image a is covered by an earlier one b, moved."""
    (y, x), (height, width) = shift, now.shape
    top, bottom = max(0, y), min(height, height + y)
    left, right = max(0, x), min(width, width + x)
    there = before[top - y : bottom - y, left - x : right - x]
    return cv2.norm(now[top:bottom, left:right], there, cv2.NORM_L1) / there.size


def refined(less: float, here: float, more: float) -> float:
    """How far the least change is from here, in blocks, by the changes one block less and more.

    At most half a block; 0 if nothing changes here.
    """
    rise = max(less, more) - here
    part = (less - more) / (2.0 * rise) if here > 0.0 and rise > 0.0 else 0.0
    return min(max(part, -0.5), 0.5)  # beyond the limits the change may be less


def follow(now: FloatImage, before: FloatImage, start: Shift, most: int) -> tuple[Shift, Shift]:
    """By how much the whole image has moved: the shift with the least mean change.

    It is found by descent over the 8 neighbours, from the better of no shift and the last one.
    Along each axis, a parabola refines it.

    Parameters
    ----------
    now, before : ndarray
        Means over blocks of the two images, see `blocks`.
    start : (int, int)
        The shift in blocks, rows first, that was found one frame earlier.
    most : int
        Greatest shift, in blocks; at most a third of a side.

    Returns
    -------
    blocks, cells : (int, int)
        The shift in whole blocks, and in cells.
    """
    limits = [min(most, n // 3) for n in now.shape]
    change = cache(partial(mean_change, now, before))
    best = min(((0, 0), start), key=change)
    while True:
        ((y, x), (y_most, x_most)) = best, limits
        around = product(range(y - 1, y + 2), range(x - 1, x + 2))
        near = min((d for d in around if abs(d[0]) <= y_most and abs(d[1]) <= x_most), key=change)
        if change(near) >= change(best):
            break
        best = near

    def cells(blocks: int, less: Shift, more: Shift) -> int:
        part = refined(change(less), change(best), change(more))
        # Halves up, also rounded ones.
        return BLOCK * blocks + math.floor(BLOCK * part + 0.5 + 1e-9)

    down = cells(y, (y - 1, x), (y + 1, x))
    return best, (down, cells(x, (y, x - 1), (y, x + 1)))
