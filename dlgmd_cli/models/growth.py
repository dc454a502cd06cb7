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
    error : float
        Estimated standard error of the rate; infinite if the rate cannot be measured.
    x, y : float
        Shift of the window's centre, in px.
    """

    rate: float = math.nan
    error: float = math.inf
    x: float = math.nan
    y: float = math.nan


def grid(window: Bounds, n: int) -> Points:
    """n x n places that cover a window, the first and last ones on its edges, (n * n, 2)."""
    left, top, right, bottom = window
    places = np.empty((n, n, 2), np.float32)
    places[..., 0] = np.linspace(left, right, n)
    places[..., 1] = np.linspace(top, bottom, n)[:, np.newaxis]
    return places.reshape(-1, 2)


def growth(before: Grey, now: Grey, points: Points, shown: Flags | None = None) -> Growth:
    """How the image grows about the mean of `points`, from an earlier image to a later one.

    Parameters
    ----------
    before, now : ndarray, shape (H, W), uint8
    points : ndarray, shape (n, 2), float32
        Places in the earlier image. Places outside the image are left out.
    shown : ndarray, shape (H, W), bool, optional
        Points are only tracked where it is True.
    """
    height, width = before.shape
    cells = np.rint(points).astype(np.intp)
    inside = np.all((cells >= 2) & (cells < (width - 2, height - 2)), axis=1)
    if shown is not None:
        inside[inside] = shown[cells[inside, 1], cells[inside, 0]]
    points = points[inside]
    if len(points) < MIN_POINTS:
        return Growth()
    there, found = tracked(before, now, points)
    return fitted(points[found], there[found])


def tracked(before: Grey, now: Grey, points: Points) -> tuple[Points, Flags]:
    """Where points of the earlier image are in the later one, and which of them were found."""
    track = partial(
        cv2.calcOpticalFlowPyrLK,
        winSize=PATCH_WH,
        maxLevel=TOP_LEVEL,
        minEigThreshold=LEAST_TEXTURE,
    )
    there, reached, _ = track(before, now, points, None)
    back, returned, _ = track(now, before, there, None)
    returns = np.linalg.norm(back - points, axis=1) < MAX_RETURN_PX
    found = (np.asarray(reached) & np.asarray(returned)).ravel() > 0
    return np.asarray(there, np.float32), found & returns


def fitted(points: Points, there: Points) -> Growth:
    """The robust fit of a shift, a growth and a turn to the displacements of points.

    Notes
    -----
    With places z = x + iy, relative to their weighted mean, the displacement of a point is
    d = s + (g + ir) z: shift s, growth g and turn r, by `N_STEPS` of least squares with Cauchy's
    weights. The standard error of g is `OVERLAP` times √(Σ(wρ)² / (2 Σw Σw|z|²)), with the weights
    w and the residuals ρ.
    """
    if len(points) < MIN_POINTS:
        return Growth()
    places = points[:, 0] + 1j * points[:, 1].astype(np.float64)
    moves = there[:, 0] + 1j * there[:, 1].astype(np.float64) - places
    weight = np.ones(len(places))
    for _ in range(N_STEPS):
        total = weight.sum()
        middle, shift = weight @ places / total, weight @ moves / total
        around, apart = places - middle, moves - shift
        moment = max(float(weight @ (around.real**2 + around.imag**2)), 1e-9)
        slope = (weight * around.conj()) @ apart / moment
        rest = np.abs(apart - slope * around)
        scale = RESIDUALS * median(rest.tolist()) + LEAST_PX
        weight = 1.0 / (1.0 + (rest / scale) ** 2)
    squares = float(weight**2 @ rest**2)
    error = OVERLAP * math.sqrt(squares / (2.0 * float(weight.sum()) * moment))
    shift += slope * (places.mean() - middle)
    return Growth(float(slope.real), error, float(shift.real), float(shift.imag))
