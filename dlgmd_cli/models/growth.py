"""How a window of the image grows between two images, from points tracked by Lucas and Kanade."""

import math
from functools import partial
from statistics import median
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import Flags, Grey
from dlgmd_cli.models.windows import Bounds

# Places in an image, (n, 2) as x and y, in px.
Points = npt.NDArray[np.float32]

# The tracked patch (width and height in px), and the highest level of the pyramid, forward and
# backward: the way back begins at the point itself, which it reaches if the tracking is right.
PATCH_WH, TOP_LEVEL, TOP_LEVEL_BACK = (13, 13), 3, 1
# Least eigenvalue of a patch's gradients, as OpenCV scales it: only patches without any texture
# are left out, since the residuals of the others say how good they are.
LEAST_TEXTURE = 1e-5
# A point tracked forward and backward must come back to within this many px.
MAX_RETURN_PX = 0.5
# Fewest points of a fit, number of its reweighted steps, and the scale of its residuals:
# RESIDUALS times their median, plus LEAST_PX.
MIN_POINTS, N_STEPS, RESIDUALS, LEAST_PX = 6, 4, 1.5, 0.05
_FLAGS = cv2.OPTFLOW_LK_GET_MIN_EIGENVALS
_track = partial(cv2.calcOpticalFlowPyrLK, winSize=PATCH_WH, minEigThreshold=LEAST_TEXTURE)
# Neighbouring patches overlap and share their errors: the true error of the growth is this
# multiple of the standard error that independent points would have.
OVERLAP = 5.0
# A row whose points spread less across, in px², has no growth.
LEAST_SPREAD = 1e-6


class Growth(NamedTuple):
    """The motion of a window from one image to a later one.

    Attributes
    ----------
    rate : float
        Growth of the window, as a share of its size; NaN if it cannot be measured.
    upright : float
        The same without that of level ground, see `upright`.
    error : float
        Estimated standard error of the rate; infinite if the rate cannot be measured.
    """

    rate: float = math.nan
    upright: float = math.nan
    error: float = math.inf


def grid(window: Bounds, n: int) -> Points:
    """n x n places that cover a window, the first and last ones on its edges, (n * n, 2)."""
    left, top, right, bottom = window
    places = np.empty((n, n, 2), np.float32)
    places[..., 0] = np.linspace(left, right, n)
    places[..., 1] = np.linspace(top, bottom, n)[:, np.newaxis]
    return places.reshape(-1, 2)


def visible(points: Points, shape: tuple[int, ...], shown: Flags | None = None) -> Points:
    """The points that are inside an image (H, W) and, if given, where `shown`, (H, W), is True."""
    cells = np.rint(points).astype(np.intp)
    inside = np.all((cells >= 2) & (cells < (shape[1] - 2, shape[0] - 2)), axis=1)
    if shown is not None:
        inside[inside] = shown[cells[inside, 1], cells[inside, 0]]
    return points[inside]


def growth(
    before: Grey, now: Grey, points: Points, turn: npt.NDArray[np.float64] | None = None
) -> Growth:
    """How the image grows about the mean of `points`, from an earlier image to a later one.

    Parameters
    ----------
    before, now : ndarray, shape (H, W), uint8
    points : ndarray, shape (n, 2), float32
        Places in the earlier image, see `visible`.
    turn : ndarray, shape (3, 3), optional
        Where far points of the earlier image are in the later one if the camera has turned: a
        homography, which the growth leaves out. Far from the axis, a turn alone makes the image
        grow.
    """
    there, found, _ = tracked(before, now, points)
    if np.count_nonzero(found) < MIN_POINTS:
        return Growth()
    points, there = points[found], there[found]
    if turn is not None:
        there = np.float32(cv2.perspectiveTransform(there[np.newaxis], np.linalg.inv(turn))[0])
    fit = similarity(points, there)
    grown = upright(points, there, fit.weight)
    return Growth() if math.isnan(grown) else Growth(fit.slope.real, grown, fit.error)


def upright(points: Points, there: Points, weight: npt.NDArray[np.float64]) -> float:
    """The growth of what stands upright: that of a wall, and 0 for ground below a level flight.

    Between two rows of points, ground grows twice as fast down as across, and what is far away
    does not grow. Here the growth across weights the rows as the growth down weights the changes
    from row to row, so that twice the one less the other is 0 whatever part of the window the
    ground fills.

    Parameters
    ----------
    points, there : ndarray, shape (n, 2)
        Places (x, y) of tracked points in two images; the points of a row have the same y, and
        follow one another.
    weight : ndarray, shape (n,)

    Returns
    -------
    float
        2 A - D; NaN if all points are in one row, or no row has two points.

    Notes
    -----
    With the moves u and v, the growth down is D = Σw(y - ȳ)v / Σw(y - ȳ)². This is a mean of the
    changes of v from row k to the next one, with the weights W_k = Σw(y - ȳ) over the rows below.
    The growth across is the mean of those of the rows, A_k = Σw(x - x̄_k)u / Σw(x - x̄_k)², with
    the weights W_{k-1} (y_k - y_{k-1}) + W_k (y_{k+1} - y_k).
    """
    x, y = np.float64(points).T
    u, v = np.float64(there).T - (x, y)
    first = np.flatnonzero(np.concatenate(((True,), y[1:] > y[:-1])))
    terms = weight * np.array((np.ones(len(x)), x, y, u, v, x * x, x * u))
    rows = np.add.reduceat(terms, first, axis=1).T.tolist()
    middle = sum(row[2] for row in rows) / sum(row[0] for row in rows)
    moment = down = above = total = across = 0.0
    last_y = last_growth = 0.0
    had_growth = False
    for n, sum_x, sum_y, sum_u, sum_v, sum_xx, sum_xu in rows:
        level, spread = sum_y / n - middle, sum_xx - sum_x**2 / n
        has_growth = spread > LEAST_SPREAD
        growth_across = (sum_xu - sum_x * sum_u / n) / spread if has_growth else 0.0
        # The sum over the rows below is minus that over those above; 0 before the first row.
        share = -above * (level - last_y)
        across += share * (growth_across + last_growth)
        total += share * (has_growth + had_growth)
        above, moment, down = above + n * level, moment + n * level**2, down + level * sum_v
        last_y, last_growth, had_growth = level, growth_across, has_growth
    return 2.0 * across / total - down / moment if total > 0.0 else math.nan


def tracked(
    before: Grey, now: Grey, points: Points
) -> tuple[Points, Flags, npt.NDArray[np.float32]]:
    """Where points of the earlier image are in the later one.

    Returns
    -------
    there : ndarray, shape (n, 2)
    found : ndarray, shape (n,), bool
        Which of the points were found.
    texture : ndarray, shape (n,)
        Least eigenvalue of the gradients of each patch that was found, as OpenCV scales it.
    """
    if not len(points):
        return points, np.zeros(0, np.bool_), np.zeros(0, np.float32)
    places, reached, texture = _track(before, now, points, None, maxLevel=TOP_LEVEL, flags=_FLAGS)
    there = np.asarray(places, np.float32)
    found = (np.asarray(reached).ravel() > 0) & returns(before, now, points, there)
    return there, found, np.asarray(texture, np.float32).ravel()


def tracked_near(
    before: Grey, now: Grey, points: Points
) -> tuple[Points, Flags, npt.NDArray[np.float32]]:
    """Where points that move little are in the later image, without the way back.

    Returns
    -------
    there : ndarray, shape (n, 2)
    reached : ndarray, shape (n,), bool
    differs : ndarray, shape (n,)
        Mean absolute difference of the patches, in grey levels.
    """
    if not len(points):
        return points, np.zeros(0, np.bool_), np.zeros(0, np.float32)
    flags = cv2.OPTFLOW_USE_INITIAL_FLOW
    there, reached, differs = _track(
        before, now, points, points.copy(), maxLevel=TOP_LEVEL_BACK, flags=flags
    )
    is_reached = np.asarray(reached).ravel() > 0
    return np.asarray(there, np.float32), is_reached, np.asarray(differs, np.float32).ravel()


def returns(before: Grey, now: Grey, points: Points, there: Points) -> Flags:
    """Which points come back from the later image to where they were in the earlier one."""
    if not len(points):
        return np.zeros(0, np.bool_)
    flags = _FLAGS | cv2.OPTFLOW_USE_INITIAL_FLOW
    back, returned, _ = _track(
        now, before, there, points.copy(), maxLevel=TOP_LEVEL_BACK, flags=flags
    )
    x, y = np.asarray(back - points, np.float32).T
    came_back: Flags = x * x + y * y < MAX_RETURN_PX**2
    return came_back & (np.asarray(returned).ravel() > 0)


class Similarity(NamedTuple):
    """A shift, a growth and a turn that were fitted to the displacements of n points, in px.

    Attributes
    ----------
    slope : complex
        Growth and, as the imaginary part, turn.
    shift : complex
        Shift of the mean of the places.
    weight : ndarray, shape (n,)
        Weight of each point.
    error : float
        Standard error of the growth.
    places, left : ndarray, shape (n,), complex128
        Places relative to their mean, and what the fit leaves of their displacements.
    scale : float
        Scale of what the fit leaves.
    """

    slope: complex
    shift: complex
    weight: npt.NDArray[np.float64]
    error: float
    places: npt.NDArray[np.complex128]
    left: npt.NDArray[np.complex128]
    scale: float


def similarity(points: Points, there: Points) -> Similarity:
    """The robust fit of a shift, a growth and a turn to the displacements of points.

    Notes
    -----
    With places z = x + iy, relative to their mean, the displacement of a point is
    d = s + (g + ir) z: shift s, growth g and turn r, by `N_STEPS` of least squares with Cauchy's
    weights w:

        (g + ir) (Σw|z|² - |Σwz|²/Σw) = Σwz*d - (Σwz)* Σwd/Σw,  s = (Σwd - (g + ir) Σwz)/Σw.

    With the residuals ρ and the factor M of g + ir, the standard error of g is `OVERLAP` times
    √(Σ(wρ)² / (2 Σw M)).
    """
    places = _complex(points)
    moves = _complex(there) - places
    places -= places.mean()
    turned = places.conj() * moves
    # All sums of a step are one product of this matrix, (8, n), with the weights.
    terms = np.empty((8, len(places)))
    terms[0], terms[1] = 1.0, places.real**2 + places.imag**2
    terms[2], terms[3], terms[4], terms[5] = places.real, places.imag, moves.real, moves.imag
    terms[6], terms[7] = turned.real, turned.imag
    weight = np.ones(len(places))
    for _ in range(N_STEPS):
        total, squares, x, y, dx, dy, grown, turn = terms.dot(weight).tolist()
        place, shift = complex(x, y) / total, complex(dx, dy) / total
        moment = max(squares - total * (place * place.conjugate()).real, 1e-9)
        slope = (complex(grown, turn) - total * place.conjugate() * shift) / moment
        shift -= slope * place
        left = moves - slope * places - shift
        rest = np.abs(left)
        scale = RESIDUALS * median(rest.tolist()) + LEAST_PX
        weight = 1.0 / (1.0 + (rest / scale) ** 2)
    squares = float(weight**2 @ rest**2)
    error = OVERLAP * math.sqrt(squares / (2.0 * float(weight.sum()) * moment))
    return Similarity(slope, shift, weight, error, places, left, scale)


def _complex(points: Points) -> npt.NDArray[np.complex128]:
    """Points, (n, 2), as x + iy."""
    return np.ascontiguousarray(points, np.float64).view(np.complex128)[:, 0]
