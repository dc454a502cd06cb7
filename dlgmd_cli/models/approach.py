"""How fast an object approaches a camera at rest, from points tracked over the whole image.

A hovering drone sways, so that the whole background moves a little, but as a whole: by a shift, a
growth and a turn. Neighbouring points that move otherwise are an object.
"""

import math

import cv2
import numpy as np

from dlgmd_cli.models.base import Flags, Grey
from dlgmd_cli.models.growth import (
    MIN_POINTS,
    Points,
    Similarity,
    similarity,
    tracked,
    tracked_near,
    visible,
)

# Least time (s) between compared images. Columns of points: the fewest tell at little cost that the
# camera is far from being at rest, as in most flights; the fewer ones whether anything moves.
LEAST_AGE_S, FEWEST_ACROSS, FEW_ACROSS, N_ACROSS = 0.09, 8, 12, 24
# Points with less than this share of the mean texture are left out: on a blank wall or in the sky,
# they seem to move without any object.
LEAST_TEXTURE = 0.3
# The camera is at rest if the residuals of the background have at most this scale, in px, and its
# growth is at most this share. Objects have residuals of more than `OUTSIDE` times the scale.
STILL_PX, STILL_GROWTH, OUTSIDE = 0.5, 0.01, 2.0
# It is far from that at this multiple of either: a few points may be badly tracked.
FAR = 2.0
# Fewest points of an object, and its least share of all points that leave the background.
LEAST_POINTS, LEAST_SHARE = 4, 0.6
# Patches at the edge of an object show the background, too: an object grows faster than its points,
# 1.5 times as fast in the median of rendered flights. So much of this is made good.
EDGE = 1.25
# What `approaching` gives where nothing approaches.
NOTHING = 0.0, (0.0, 0.0)


def approaching(
    before: Grey, now: Grey, shown: Flags | None = None
) -> tuple[float, tuple[float, float]]:
    """By what share an object grows from one image to a later one, in front of a still background.

    Parameters
    ----------
    before, now : ndarray, shape (H, W), uint8
        Images at least `LEAST_AGE_S` apart.
    shown : ndarray, shape (H, W), bool, optional
        Where points may be.

    Returns
    -------
    growth : float
        The growth against the background, less its standard error, times `EDGE`; 0 if nothing
        approaches, or the camera is not at rest.
    place : (float, float)
        Mean of the object's points, x and y from -1 to 1.

    Notes
    -----
    The object is the largest group of neighbouring points with residuals ρ against the
    background's `similarity`. With their places z relative to the mean, the n points grow by
    g + ir = Σ z*ρ / Σ|z|², with the standard error e² = Σ|ρ - ρ̄ - (g + ir) z|² / (2 (n - 2) Σ|z|²).
    An object that approaches grows about a point inside: |ρ̄| < (g - e) √(Σ|z|² / n). An object
    that passes by moves as a whole.
    """
    if _flies(before, now, shown):
        return NOTHING
    for n_across in (FEW_ACROSS, N_ACROSS):
        points, cells = _spread(now.shape, n_across, shown)
        there, found, texture = tracked(before, now, points)
        if found.any():
            found &= texture >= LEAST_TEXTURE * texture[found].mean()
        if np.count_nonzero(found) < 2 * MIN_POINTS:
            return NOTHING
        background = similarity(points[found], there[found])
        apart = np.abs(background.left) > OUTSIDE * background.scale
        if _moves(background, 1.0) or not apart.any():
            return NOTHING
    group = _largest(cells[found], apart)
    n = np.count_nonzero(group)
    if n < LEAST_POINTS or n < LEAST_SHARE * np.count_nonzero(apart):
        return NOTHING
    places, left = background.places[group], background.left[group]
    middle, move = places.mean(), left.mean()
    places, left = places - middle, left - move
    moment = float(np.sum(np.abs(places) ** 2))
    slope = complex(np.vdot(places, left)) / moment
    rest = float(np.sum(np.abs(left - slope * places) ** 2))
    rate = slope.real - math.sqrt(rest / (2.0 * (n - 2) * moment))
    if abs(move) >= rate * math.sqrt(moment / n):
        return NOTHING
    x, y = there[found][group].mean(axis=0)
    return EDGE * rate, (_across(x, now.shape[1]), _across(y, now.shape[0]))


def _flies(before: Grey, now: Grey, shown: Flags | None) -> bool:
    """Whether the camera is far from being at rest, by the fewest points."""
    points, _ = _spread(now.shape, FEWEST_ACROSS, shown)
    there, found, _ = tracked_near(before, now, points)
    if np.count_nonzero(found) < 2 * MIN_POINTS:
        return False
    return _moves(similarity(points[found], there[found]), FAR)


def _moves(background: Similarity, most: float) -> bool:
    """Whether the background moves by more than this multiple of what a camera at rest may."""
    is_rough = background.scale > most * STILL_PX
    return is_rough or abs(background.slope.real) > most * STILL_GROWTH


def _spread(shape: tuple[int, ...], n_across: int, shown: Flags | None) -> tuple[Points, Points]:
    """Points in the middle of cells that cover an image, and the column and row of each cell."""
    height, width = shape
    n_down = max(1, round(n_across * height / width))
    size = np.array((width / n_across, height / n_down))
    cells = np.stack(np.meshgrid(np.arange(n_across), np.arange(n_down)), axis=-1).reshape(-1, 2)
    points = visible(np.float32((cells + 0.5) * size - 0.5), shape, shown)
    return points, np.asarray((points + 0.5) // size, np.int64)


def _largest(cells: Points, apart: Flags) -> Flags:
    """Which of the points are in the largest group of neighbouring cells with points `apart`."""
    columns, rows = cells.T
    marked = np.zeros((rows.max() + 1, columns.max() + 1), np.uint8)
    marked[rows, columns] = apart
    _, groups, sizes, _ = cv2.connectedComponentsWithStats(marked, connectivity=8)
    sizes[0] = 0
    largest: Flags = apart & (groups[rows, columns] == np.argmax(sizes[:, cv2.CC_STAT_AREA]))
    return largest


def _across(place: float, side: int) -> float:
    """A place from -1 to 1 along a side of an image, in px."""
    return (2.0 * float(place) + 1.0) / side - 1.0
