"""How an image moves between two frames: shift of the whole image, shift and growth of a window.

Between two frames, a part of the image moves along x by ``u + a x`` and along y by ``v + b y``,
with x and y from the middle of the part. The rates a and b are fitted to the brightness gradients
directly, without optical flow (Negahdaripour and Horn, 1989; Horn, Fang and Masaki, 2007).
"""

import math
from functools import cache, partial
from itertools import product
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import FloatImage, Grey
from dlgmd_cli.models.receptors import aligned
from dlgmd_cli.models.windows import Window

# Rows and columns.
Shift = tuple[int, int]
# Interpolation along one side, three arrays of shape (n,): index of the cell before, distance from
# that cell, and 1.0 where both neighbours are in the image (None if all neighbours are).
_Side = tuple[npt.NDArray[np.intp], FloatImage, FloatImage | None]

# The shift of the whole image is found on means over blocks of BLOCK x BLOCK cells. It is at most
# MAX_SHIFT blocks in an image `SMALL_PX` wide, and less in a narrower image.
BLOCK, MAX_SHIFT = 4, 4
# Gauss-Newton steps.
N_STEPS = 2
# Scale of the residuals: RESIDUALS times their mean absolute value, plus RESIDUAL_LEVELS levels.
RESIDUALS, RESIDUAL_LEVELS = 1.5, 1.0
# Ridge on the diagonal of the normal equations: relative; absolute, for shifts and for rates.
RIDGE, RIDGE_SHIFT, RIDGE_RATE = 1e-6, 1e-3, 0.1
# Below this mean square of the residuals, in grey levels squared, nothing changes in a window.
LEAST_SQUARE = 0.01
# The ridge: a factor of the normal equations, and a summand.
_RELATIVE = 1.0 + RIDGE * np.eye(4)
_ABSOLUTE = np.diag([RIDGE_SHIFT, RIDGE_SHIFT, RIDGE_RATE, RIDGE_RATE])


class Motion(NamedTuple):
    """Shift along y and x in cells, and the rates of expansion, from one frame to the next.

    `share` is the share of the change that the rates explain, 0 to 1: one minus the ratio of the
    residuals with and without the rates. NaN if nothing changes beyond the shift.
    """

    v: float = 0.0
    u: float = 0.0
    b: float = 0.0
    a: float = 0.0
    share: float = math.nan


@cache
def _places(n: int) -> FloatImage:
    """Positions of n cells, relative to their centre."""
    return (np.arange(n) - (n - 1) / 2).astype(np.float32)


def fitted(
    now: FloatImage,
    before: FloatImage,
    window: Window,
    start: tuple[float, float],
    shown: FloatImage | None = None,
) -> Motion:
    """The motion of a window of the earlier image, by robust least squares on its gradients.

    `start` is the initial shift along y and x. The window must not contain border cells. Cells
    where `shown`, of the image's shape, is 0.0 are ignored. No motion is found if less than a
    quarter of the window is shown and, after the motion, still inside the image.
    """
    top, bottom, left, right = window
    y, x = _places(bottom - top), _places(right - left)
    # Rows: the derivatives by v, u, b and a, and the residuals, so that one product gives all sums.
    # The number of calls, not of cells, determines the time.
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
        # Square roots of the weights, since both factors of each product are weighted.
        roots = rest * np.float32(1.0 / scale)
        roots *= roots
        roots += 1.0
        np.sqrt(roots, out=roots)
        np.divide(1.0 if is_seen is None else is_seen, roots, out=roots)
        np.multiply(terms, roots, out=weighted)
        # OpenCV's product: NumPy's product ends the process if OpenBLAS gets no memory.
        sums = cv2.mulTransposed(weighted.reshape(5, -1), False, dtype=cv2.CV_64F)
        matrix = sums[:4, :4] * _RELATIVE + _ABSOLUTE
        # For a 4 x 4 matrix, OpenCV is faster than NumPy.
        step = cv2.solve(matrix, sums[:4, 4:].copy(), flags=cv2.DECOMP_LU)[1].ravel()
        motion += step
    # The sums of squares of the residuals with the rates, and of the change that rates explain.
    residual = max(float(sums[4, 4] - step @ sums[:4, 4]), 0.0)
    explained = max(float(motion[2:] @ sums[2:4, 2:4] @ motion[2:]), 0.0)
    v, u, b, a = motion.tolist()
    if residual + explained < LEAST_SQUARE * n_seen:
        return Motion(v, u, b, a)
    return Motion(v, u, b, a, 1.0 - math.sqrt(residual / (residual + explained)))


def _slopes(patch: FloatImage, out: FloatImage) -> None:
    """Sobel gradients / 8 along y and x, of all cells but the border, to out[:2]."""
    pairs = patch[:, :-1] + patch[:, 1:]
    across = pairs[:, :-1] + pairs[:, 1:]
    np.subtract(across[2:], across[:-2], out=out[0])
    pairs = patch[:-1] + patch[1:]
    down = pairs[:-1] + pairs[1:]
    np.subtract(down[:, 2:], down[:, :-2], out=out[1])
    out[:2] *= np.float32(0.125)


def _along(middle: float, rate: float, places: FloatImage, n: int) -> _Side:
    """The interpolation at the positions `middle + rate * places` along a side of n cells."""
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
    """An image at positions between its cells, by linear interpolation, (h, w)."""
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


def blocks(frame: Grey) -> FloatImage:
    """Means over whole blocks of `BLOCK` x `BLOCK` cells of an image, in the image's levels."""
    height, width = (n // BLOCK for n in frame.shape)
    if height == 0 or width == 0:
        return np.zeros((height, width), np.float32)
    whole = frame[: height * BLOCK, : width * BLOCK].astype(np.float32)
    return np.asarray(cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA), np.float32)


def mean_change(now: Grey, before: Grey, shift: Shift) -> float:
    """Mean |now(i) - before(i - shift)| over the cells that both images cover."""
    (y, x), (height, width) = shift, now.shape
    top, bottom = max(0, y), min(height, height + y)
    left, right = max(0, x), min(width, width + x)
    there = before[top - y : bottom - y, left - x : right - x]
    return cv2.norm(now[top:bottom, left:right], there, cv2.NORM_L1) / there.size


def refined(less: float, here: float, more: float) -> float:
    """The offset of the least change in blocks, by a parabola through three neighbouring changes.

    At most half a block either way; 0 if the change `here` is 0.
    """
    rise = max(less, more) - here
    part = (less - more) / (2.0 * rise) if here > 0.0 and rise > 0.0 else 0.0
    return min(max(part, -0.5), 0.5)  # at the largest shift, the least change may lie beyond it


def follow(now: FloatImage, before: FloatImage, start: Shift, most: int) -> tuple[Shift, Shift]:
    """The shift of the whole image: the shift with the least mean change.

    The shift is found by descent over the 8 neighbours, from the better of no shift and the last
    shift, and refined by a parabola along each axis.

    Parameters
    ----------
    now, before : ndarray
        Means over blocks of the two images, see `blocks`.
    start : (int, int)
        The shift in blocks, rows first, that was found one frame earlier.
    most : int
        Largest shift, in blocks; at most a third of a side counts.

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
        # Rounds halves up, also halves with a rounding error.
        return BLOCK * blocks + math.floor(BLOCK * part + 0.5 + 1e-9)

    down = cells(y, (y - 1, x), (y + 1, x))
    return best, (down, cells(x, (y, x - 1), (y, x + 1)))
