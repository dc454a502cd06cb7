"""Exact pixel coverage of polygons.

Every side is cut at the borders of pixels. Each piece adds to its own pixel, and to all pixels
right of it, the area between the piece and their right borders. Sides that go down add this area,
and sides that go up subtract it.
"""

from collections.abc import Sequence

import numpy as np

from dlgmd_cli.lab.flights.renderer.camera import FloatArray
from dlgmd_cli.lab.flights.renderer.solids import IntArray
from dlgmd_cli.lab.flights.renderer.texture import FloatImage, Window

# Rounding tolerance for the height of a window.
_ROUNDING = 1e-9


class Coverage:
    """Pixel coverage of many polygons inside a window.

    The polygons, (n, 2) each, are in px and clockwise on the screen. They may extend far outside
    the picture.
    """

    def __init__(self, polygons: Sequence[FloatArray], window: Window) -> None:
        start = np.concatenate([np.empty((0, 2)), *polygons])
        end = np.concatenate([np.empty((0, 2)), *(np.roll(each, -1, axis=0) for each in polygons)])
        owner = np.repeat(np.arange(len(polygons)), [len(each) for each in polygons])
        self._x, self._y, self._rise, owner = _pieces(start, end - start, owner, window)
        self._row = np.floor(self._y).astype(np.intp)
        self._starts = np.searchsorted(owner, np.arange(len(polygons) + 1))

    def share(self, index: int, window: Window) -> FloatImage | None:
        """Coverage of each pixel of a window by one polygon.

        The window must lie inside that of the constructor. Returns (h, w) float32, 0 to 1 up to
        rounding, or None if the coverage is 1 everywhere.
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
    """Cut the sides of polygons at the borders of pixels.

    Returns x and y of the middle of each piece, its extent in y (down is positive), and its
    polygon. Parts above and below the window are dropped; parts beside it are kept uncut.
    """
    left, top, right, bottom = window
    # Where each side enters and leaves the window, as a share of its length.
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
    low = np.minimum(low, (right + 1, bottom + 1))  # no cuts far outside the window
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
    """All integers from `low[i]` to `high[i]`: their i, and the integers."""
    counts = np.maximum(high - low + 1, 0)
    owner = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - before[owner] + low[owner]
