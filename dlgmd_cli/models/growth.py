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

# The tracked patch (width and height in px), and the highest level of the pyramid.
PATCH_WH, TOP_LEVEL = (13, 13), 3
# Least eigenvalue of a patch's gradients, as OpenCV scales it: only patches without any texture
# are left out, since the residuals of the others say how good they are.
LEAST_TEXTURE = 1e-5
# A point tracked forward and backward must come back to within this many px.
MAX_RETURN_PX = 0.5
# Fewest points of a fit, number of its reweighted steps, and the scale of its residuals:
# RESIDUALS times their median, plus LEAST_PX.
MIN_POINTS, N_STEPS, RESIDUALS, LEAST_PX = 6, 4, 1.5, 0.05
# Neighbouring patches overlap and share their errors: the true error of the growth is this
# multiple of the standard error that independent points would have.
OVERLAP = 5.0


class Growth(NamedTuple):
    """The motion of a window from one image to a later one.

    Attributes
    ----------
    rate : float
        Growth of the window, as a share of its size; NaN if it cannot be measured.
    across : float
        Growth of the window's width alone; `rate` is the mean of those of width and height.
    error : float
        Estimated standard error of the rate; infinite if the rate cannot be measured.
    """

    rate: float = math.nan
    across: float = math.nan
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


def growth(before: Grey, now: Grey, points: Points) -> Growth:
    """How the image grows about the mean of `points`, from an earlier image to a later one.

    Parameters
    ----------
    before, now : ndarray, shape (H, W), uint8
    points : ndarray, shape (n, 2), float32
        Places in the earlier image, see `visible`.
    """
    there, found, _ = tracked(before, now, points)
    if np.count_nonzero(found) < MIN_POINTS:
        return Growth()
    fit = similarity(points[found], there[found])
    return Growth(fit.slope.real, fit.across, fit.error)


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
    track = partial(
        cv2.calcOpticalFlowPyrLK,
        winSize=PATCH_WH,
        maxLevel=TOP_LEVEL,
        flags=cv2.OPTFLOW_LK_GET_MIN_EIGENVALS,
        minEigThreshold=LEAST_TEXTURE,
    )
    there, reached, texture = track(before, now, points, None)
    back, returned, _ = track(now, before, there, None)
    x, y = np.asarray(back - points, np.float32).T
    returns = x * x + y * y < MAX_RETURN_PX**2
    found = (np.asarray(reached) & np.asarray(returned)).ravel() > 0
    return np.asarray(there, np.float32), found & returns, np.asarray(texture, np.float32).ravel()


class Similarity(NamedTuple):
    """A shift, a growth and a turn that were fitted to the displacements of n points, in px.

    Attributes
    ----------
    slope : complex
        Growth and, as the imaginary part, turn.
    shift : complex
        Shift of the mean of the places.
    across : float
        Growth across alone.
    error : float
        Standard error of the growth.
    places, left : ndarray, shape (n,), complex128
        Places relative to their mean, and what the fit leaves of their displacements.
    scale : float
        Scale of what the fit leaves.
    """

    slope: complex
    shift: complex
    across: float
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

    With the residuals ρ and the factor M of g + ir, the growth across is g + Re Σwzρ / M, and the
    standard error of g is `OVERLAP` times √(Σ(wρ)² / (2 Σw M)).
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
        across = slope.real + float((weight * places @ left).real) / moment
        rest = np.abs(left)
        scale = RESIDUALS * median(rest.tolist()) + LEAST_PX
        weight = 1.0 / (1.0 + (rest / scale) ** 2)
    squares = float(weight**2 @ rest**2)
    error = OVERLAP * math.sqrt(squares / (2.0 * float(weight.sum()) * moment))
    return Similarity(slope, shift, across, error, places, left, scale)


def _complex(points: Points) -> npt.NDArray[np.complex128]:
    """Points, (n, 2), as x + iy."""
    return np.ascontiguousarray(points, np.float64).view(np.complex128)[:, 0]
