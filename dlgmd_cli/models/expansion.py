"""How fast the picture expands: in its middle, and where something moves before a still camera.

Between two frames, a part of the picture moves along x by ``u + a x`` and along y by ``v + b y``,
with x and y from the middle of the part. What is approached expands in both directions: a and b,
per second, are about 1 / (time to contact), or less where a part of the background is in view.
"""

import math
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Flags, FloatImage, Grey

# Rows from, up to; columns from, up to.
Window = tuple[int, int, int, int]
# Rows and columns.
Shift = tuple[int, int]
# Of each cell of a side: the cell before it, how far it is beyond that, and 1.0 where both it and
# the next one are in the picture; None where all are. Shape (n,) each.
_Side = tuple[npt.NDArray[np.intp], FloatImage, FloatImage | None]

# The picture is reduced by a whole factor to at least so many columns.
REDUCED_PX = 120
# Smallest side of a reduced picture that is measured.
LEAST_SIDE = 20
# Gauss-Newton steps.
N_STEPS = 2
# Scale of the residuals: this multiple of their mean, and so many grey levels.
RESIDUALS, RESIDUAL_LEVELS = 1.5, 1.0
# What is added to the diagonal of the normal equations: relative, for shifts, and for rates.
RIDGE, RIDGE_SHIFT, RIDGE_RATE = 1e-6, 1e-3, 0.1
# Weight of the difference between the two rates, which are alike where something looms.
UNLIKE = 0.25
# Fastest expansion of two frames, in 1/s: so that no single one, such as a lamp that is switched
# on, makes D reach the threshold of `flight`.
MAX_RATE = 2.5
# The exposure has stepped if the mean of the picture changes by so much, and three quarters of the
# means over so many columns and rows of blocks do in the same direction.
STEP, STEP_BLOCKS = 0.05, (15, 8)
# A cell changes if it does by this more than the mean of all, in grey levels.
CHANGE_LEVELS = 3.0
# What moves before a still camera: least change a cell of the picture, in grey levels, greatest
# share of the cells that change, and greatest spread, as a share of the shorter side's half.
LEAST_CHANGE, MAX_SHARE, MAX_SPREAD = 0.19, 0.4, 0.9
# Its window reaches so many standard deviations from the centroid, and so many cells at least.
REACH, LEAST_REACH = 1.6, 6
# An object that comes at a still camera expands as a whole; of what the drone flies at, the middle
# of the picture shows a part only. So the former counts as half.
LOCAL_SHARE = 0.5
# Below this expansion, in 1/s, there is no time to contact.
LEAST_RATE = 0.1
# The same as a factor of the normal equations, and what is added to them.
_RELATIVE = 1.0 + RIDGE * np.eye(4)
_ABSOLUTE = np.diag([RIDGE_SHIFT, RIDGE_SHIFT, RIDGE_RATE, RIDGE_RATE])


class Motion(NamedTuple):
    """Shift along y and x in cells, and the rates of expansion, each from one frame to the next."""

    v: float
    u: float
    b: float
    a: float


class Expansion:
    """The rate of expansion D of a sequence of frames, in 1/s; see `d_0` of `ContrastDLGMD`.

    Parameters
    ----------
    tau_s : float
        Time constant over which it is smoothed.
    evens : bool
        Whether steps of the exposure are taken out, see `evened`.
    """

    def __init__(self, tau_s: float, *, evens: bool = False) -> None:
        self._tau_s, self._evens = tau_s, evens
        self._hidden: Flags | None = None
        self._visible: FloatImage | None = None
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._before: FloatImage | None = None
        self._ahead = self._local = 0.0
        self._has_stepped = False

    def ignore(self, hidden: Flags | None) -> None:
        """Leave some cells of the frames, (H, W), out of the fit from now on."""
        self._hidden, self._visible = hidden, None

    @property
    def rate(self) -> float:
        """D at the last frame, in 1/s."""
        return max(self._ahead, LOCAL_SHARE * self._local)

    @property
    def ttc_s(self) -> float:
        """Time to contact in seconds; NaN where the picture does not expand."""
        return LOCAL_SHARE / self.rate if self.rate >= LEAST_RATE else math.nan

    def step(
        self, frames: tuple[Grey, Grey], unit: float, moved: tuple[Shift, Shift], interval_s: float
    ) -> None:
        """Measure the expansion between two frames.

        Parameters
        ----------
        frames : tuple of ndarray, shape (H, W)
            The newest frame and the one before.
        unit : float
            Luminance of a level of the frames.
        moved : tuple of (int, int)
            By how much the whole picture has moved, in blocks and in cells, rows first.
        interval_s : float
            Time between the frames.
        """
        now, before = reduced(frames[0], unit), self._before
        before = reduced(frames[1], unit) if before is None else before
        self._before = now
        if min(now.shape) < LEAST_SIDE:
            return
        is_step = False
        if self._evens:
            like = evened(before, now)
            is_step = like is not before and not self._has_stepped
            self._has_stepped = like is not before
            # What is white in one of them spoils the fit; several in a row may be one slow step.
            before = before if is_step else like
        if self._hidden is not None and self._visible is None:
            self._visible = visible(self._hidden)
        factor = factor_of(frames[0].shape[1])
        start = moved[1][0] / factor, moved[1][1] / factor
        found = fitted(now, before, middle(now.shape), start, self._visible)
        ahead = (min(found.a, found.b) - UNLIKE * abs(found.a - found.b)) / interval_s
        local = 0.0 if moved[0] != (0, 0) else approaching(now, before, self._visible) / interval_s
        if is_step:  # which may hide an expansion, but not show one
            ahead, local = min(ahead, self._ahead), min(local, self._local)
        self._ahead += _share(interval_s, self._tau_s) * (_limited(ahead) - self._ahead)
        # What comes at a still camera is near once it is seen.
        self._local += _share(interval_s, self._tau_s / 2.0) * (_limited(local) - self._local)


def _share(interval_s: float, tau_s: float) -> float:
    """Weight of the newest value of a mean."""
    return -math.expm1(-interval_s / tau_s)


def _limited(rate: float) -> float:
    return min(max(rate, -MAX_RATE), MAX_RATE)


def factor_of(width: int) -> int:
    """By how much the sides of a picture are divided."""
    return max(1, width // REDUCED_PX)


def middle(shape: tuple[int, ...]) -> Window:
    """The square in the middle whose side is half of the shorter one."""
    half = min(shape) // 2
    top, left = ((side - half) // 2 for side in shape)
    return top, top + half, left, left + half


def reduced(frame: Grey, unit: float) -> FloatImage:
    """Means over blocks of a frame, and over 3x3 of those, in whole levels of 0 to 255."""
    factor = factor_of(frame.shape[1])
    height, width = (side // factor for side in frame.shape)
    image: Grey = frame[: height * factor, : width * factor].astype(np.float32)
    if factor > 1 and height and width:
        image = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)
    blurred = cv2.blur(image, (3, 3), borderType=cv2.BORDER_REPLICATE)
    # Halves up, also rounded ones.
    return np.asarray(np.floor((blurred if unit < 1.0 else 255.0 * blurred) + 0.5001), np.float32)


def visible(hidden: Flags) -> FloatImage:
    """1.0 in the cells of a reduced picture that no hidden cell of the frame enters, else 0.0."""
    factor = factor_of(hidden.shape[1])
    height, width = (side // factor for side in hidden.shape)
    shown = np.float32(hidden[: height * factor, : width * factor])
    shown = cv2.resize(shown, (width, height), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.dilate(shown, np.ones((3, 3))) == 0.0, np.float32)


def evened(before: FloatImage, now: FloatImage) -> FloatImage:
    """An earlier picture as bright as the newest, in whole levels, if the exposure has stepped.

    Else the picture itself. What comes near changes the brightness of a part of the picture; a step
    of the exposure changes all of it alike.
    """
    if abs(cv2.mean(now)[0] / max(cv2.mean(before)[0], 1.0) - 1.0) < STEP:
        return before
    pair = (now, before)
    blocks = (cv2.resize(one, STEP_BLOCKS, interpolation=cv2.INTER_AREA) + 1.0 for one in pair)
    low, ratio, high = np.quantile(np.divide(*blocks), [0.25, 0.5, 0.75]).tolist()
    if low < 1.0 + STEP and high > 1.0 - STEP:
        return before
    return np.asarray(np.minimum(np.floor(before * np.float32(ratio) + 0.5), 255.0), np.float32)


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
    """The motion of a window of the earlier picture, by robust least squares on its gradients.

    `start` is the shift along y and x to begin with. The window must leave out the border cells.
    Where `shown`, of the picture's shape, is 0.0, cells do not count. No motion is found if less
    than a quarter of the window is shown and still in the picture.
    """
    top, bottom, left, right = window
    y, x = _places(bottom - top), _places(right - left)
    # The slopes by v, u, b and a, and what the motion does not explain: so that one product has
    # all sums. Calls, not cells, take the time.
    terms = np.empty((5, bottom - top, right - left), np.float32)
    _slopes(before[top - 1 : bottom + 1, left - 1 : right + 1], terms)
    np.multiply(terms[0], y[:, None], out=terms[2])
    np.multiply(terms[1], x, out=terms[3])
    inside, rest, weighted = before[top:bottom, left:right], terms[4], np.empty_like(terms)
    found = np.array([*start, 0.0, 0.0])
    middle_y, middle_x = (top + bottom - 1) / 2, (left + right - 1) / 2
    for _ in range(N_STEPS):
        v, u, b, a = found.tolist()
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
                return Motion(0.0, 0.0, 0.0, 0.0)
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
        found += cv2.solve(matrix, sums[:4, 4:].copy(), flags=cv2.DECOMP_LU)[1].ravel()
    return Motion(*found.tolist())


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
    """A picture between its cells, linear, (h, w)."""
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


def approaching(now: FloatImage, before: FloatImage, shown: FloatImage | None = None) -> float:
    """By what share an object grows from one frame to the next, in front of what stands still.

    The part of the picture about the centroid of the change is fitted, as wide as the change
    spreads. It is an approach if it expands along both sides about a point inside: what passes by
    moves as a whole.

    Returns
    -------
    float
        The lesser of its expansions; 0 if nothing approaches, or the change is not in one place.
    """
    change = cv2.absdiff(now, before)
    level = CHANGE_LEVELS + cv2.mean(change)[0]
    above = cv2.threshold(change - np.float32(level), 0.0, 0.0, cv2.THRESH_TOZERO)[1]
    total, side = cv2.sumElems(above)[0], min(now.shape) // 2
    if total < LEAST_CHANGE * above.size or cv2.countNonZero(above) > MAX_SHARE * above.size:
        return 0.0
    window, reaches = [], []
    for axis, n in enumerate(above.shape):
        profile = cv2.reduce(above, 1 - axis, cv2.REDUCE_SUM, dtype=cv2.CV_64F).ravel()
        places = np.arange(n)
        centroid = float(profile @ places) / total
        spread = math.sqrt(max(float(profile @ (places - centroid) ** 2) / total, 0.0))
        if spread > MAX_SPREAD * side:
            return 0.0
        reach = math.floor(min(max(REACH * spread, LEAST_REACH), side / 2.0) + 0.5)
        at = min(max(math.floor(centroid + 0.5), reach + 1), n - 2 - reach)
        window += [at - reach, at + reach + 1]
        reaches.append(reach)
    top, bottom, left, right = window
    found = fitted(now, before, (top, bottom, left, right), (0.0, 0.0), shown)
    if abs(found.v) >= found.b * reaches[0] or abs(found.u) >= found.a * reaches[1]:
        return 0.0
    return max(min(found.a, found.b), 0.0)
