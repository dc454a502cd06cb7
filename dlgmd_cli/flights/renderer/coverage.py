"""The exact share of each pixel that polygons cover.

Every side is cut where it passes from one pixel to the next. Each piece adds to its pixel, and to
all pixels right of it, the area between itself and their right borders; sides that go up subtract
what those that go down have added.
"""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import IntArray
from dlgmd_cli.flights.renderer.texture import FloatImage, Window

# By how much rounding may change the height of a window.
_ROUNDING = 1e-9


class Coverage:
    """The shares of pixels that many polygons cover.

    The polygons, (n, 2) each, are in px of the picture, clockwise on the screen; they may be far
    outside of it. Only what is in the window matters.
    """

    def __init__(self, polygons: Sequence[FloatArray], window: Window) -> None:
        start = np.concatenate([np.empty((0, 2)), *polygons])
        end = np.concatenate([np.empty((0, 2)), *(np.roll(each, -1, axis=0) for each in polygons)])
        owner = np.repeat(np.arange(len(polygons)), [len(each) for each in polygons])
        self._x, self._y, self._rise, owner = _pieces(start, end - start, owner, window)
        self._row = np.floor(self._y).astype(np.intp)
        self._starts = np.searchsorted(owner, np.arange(len(polygons) + 1))

    def share(self, index: int, window: Window) -> FloatImage | None:
        """Area of a polygon in each pixel of a window that it touches, inside that of all polygons.

        Returns (h, w) float32, 0 to 1 up to rounding, or None if it is 1 everywhere.
        """
        left, top, right, bottom = window
        width, height = right - left, bottom - top
        own = slice(self._starts[index], self._starts[index + 1])
        row = self._row[own] - top
        here = (row >= 0) & (row < height)
        row, x, rise = row[here], self._x[own][here] - left, self._rise[own][here]
        if -rise[x <= 0.0].sum() >= height - _ROUNDING and not ((x > 0.0) & (x < width)).any():
            return None
        x = np.minimum(np.maximum(x, 0.0), width)
        column = np.minimum(x.astype(np.intp), width - 1)
        part = rise * (x - column)
        cell = row * (width + 1) + column
        steps = np.bincount(
            np.concatenate([cell, cell + 1]),
            np.concatenate([part - rise, -part]),
            height * (width + 1),
        ).reshape(height, width + 1)
        areas: FloatImage = np.cumsum(steps, axis=1, out=steps)[:, :width].astype(np.float32)
        return areas


def _pieces(
    start: FloatArray, way: FloatArray, owner: IntArray, window: Window
) -> tuple[FloatArray, FloatArray, FloatArray, IntArray]:
    """Cut the sides at the borders of pixels.

    Returns x and y of the pieces' middles, how far down each goes, and its polygon. What is above
    or below the window is left out; what is beside it is not cut.
    """
    left, top, right, bottom = window
    # Shares of the way along each side where the window begins and ends.
    is_steep = np.abs(way[:, 1]) > 1e-12
    start, way, owner = start[is_steep], way[is_steep], owner[is_steep]
    to_top, to_bottom = ((line - start[:, 1]) / way[:, 1] for line in (top, bottom))
    begins = np.maximum(np.minimum(to_top, to_bottom), 0.0)
    ends = np.minimum(np.maximum(to_top, to_bottom), 1.0)
    inside = begins < ends
    start, way, owner = start[inside], way[inside], owner[inside]
    begins, ends = begins[inside], ends[inside]
    first, last = start + begins[:, None] * way, start + ends[:, None] * way
    low = np.ceil(np.maximum(np.minimum(first, last), (left, top))).astype(np.intp)
    high = np.floor(np.minimum(np.maximum(first, last), (right, bottom))).astype(np.intp)
    low = np.minimum(low, (right + 1, bottom + 1))  # far outside, there is nothing to count
    high = np.maximum(high, low - 1)
    sides = np.arange(len(start))
    cut_sides, cuts = [sides, sides], [begins, ends]
    for axis in (0, 1):
        side, line = _counted(low[:, axis], high[:, axis])
        along = way[side, axis]
        is_across = along != 0.0
        side, line = side[is_across], line[is_across]
        share = (line - start[side, axis]) / along[is_across]
        cut_sides.append(side)
        cuts.append(np.minimum(np.maximum(share, begins[side]), ends[side]))
    side, share = np.concatenate(cut_sides), np.concatenate(cuts)
    order = np.argsort(2.0 * side + share)  # shares are 0 to 1
    side, share = side[order], share[order]
    is_piece = side[1:] == side[:-1]
    of = side[1:][is_piece]
    middle = ((share[1:] + share[:-1]) / 2.0)[is_piece]
    x, y = (start[of] + middle[:, None] * way[of]).T
    y = np.minimum(np.maximum(y, top), np.nextafter(bottom, top))
    return x, y, way[of, 1] * (share[1:] - share[:-1])[is_piece], owner[of]


def _counted(low: IntArray, high: IntArray) -> tuple[IntArray, IntArray]:
    """All whole numbers from `low[i]` to `high[i]`, each with its i."""
    counts = np.maximum(high - low + 1, 0)
    owner = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - before[owner] + low[owner]
