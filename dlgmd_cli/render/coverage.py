"""Which share of each pixel a polygon covers, exactly.

Every side is cut where it passes from one pixel to the next. Each piece adds to its pixel, and to
all pixels right of it, the area between itself and their right borders; sides that go up take away
what those that go down have added.
"""

import numpy as np
import numpy.typing as npt

from dlgmd_cli.render.camera import FloatArray
from dlgmd_cli.render.texture import FloatImage

Window = tuple[int, int, int, int]


def coverage(corners_xy: FloatArray, window: Window) -> FloatImage:
    """Area of a polygon in each pixel of a window: (h, w) float32, 0 to 1.

    Parameters
    ----------
    corners_xy : ndarray, shape (n, 2)
        In px of the picture, clockwise on the screen; it may be far larger than the window.
    window : (int, int, int, int)
        Left, top, right and bottom, in px; the last two are excluded.
    """
    left, top, right, bottom = window
    width, height = right - left, bottom - top
    x, y, rise = _pieces(corners_xy - (left, top), width, height)
    row = np.clip(np.floor(y).astype(np.intp), 0, height - 1)
    x = np.clip(x, 0.0, width)
    column = np.minimum(x.astype(np.intp), width - 1)
    share = rise * (x - column)
    cell = row * (width + 1) + column
    cells = height * (width + 1)
    steps = np.bincount(cell, rise - share, cells) + np.bincount(cell + 1, share, cells)
    areas = np.cumsum(steps.reshape(height, width + 1), axis=1)[:, :width]
    covered: FloatImage = -areas.astype(np.float32)
    return np.clip(covered, 0.0, 1.0, out=covered)


def _pieces(
    corners: FloatArray, width: int, height: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The sides, cut at the borders of pixels: x and y of the pieces' middles, and how far down.

    What is above or below the window is left out.
    """
    start, end = corners, np.concatenate([corners[1:], corners[:1]])
    run, rise = (end - start).T
    # Shares of the way along each side where the window begins and ends.
    is_steep = np.abs(rise) > 1e-12
    start, run, rise = start[is_steep], run[is_steep], rise[is_steep]
    limits = np.sort(np.stack([-start[:, 1] / rise, (height - start[:, 1]) / rise]), axis=0)
    begins, ends = np.maximum(limits[0], 0.0), np.minimum(limits[1], 1.0)
    inside = begins < ends
    start, run, rise, begins, ends = (each[inside] for each in (start, run, rise, begins, ends))
    sides = np.arange(len(start))
    cuts = [(sides, begins), (sides, ends)]
    for axis, along, size in ((0, run, width), (1, rise, height)):
        first, last = (start[:, axis] + share * along for share in (begins, ends))
        low = np.clip(np.ceil(np.minimum(first, last)), 0, size + 1).astype(np.intp)
        high = np.clip(np.floor(np.maximum(first, last)), -1, size).astype(np.intp)
        side, line = _counted(low, high)
        is_across = along[side] != 0.0
        side, line = side[is_across], line[is_across]
        share = (line - start[side, axis]) / along[side]
        cuts.append((side, np.clip(share, begins[side], ends[side])))
    side, share = (np.concatenate(each) for each in zip(*cuts, strict=True))
    order = np.lexsort((share, side))
    side, share = side[order], share[order]
    is_piece = side[1:] == side[:-1]
    owner = side[1:][is_piece]
    middle = (share[1:] + share[:-1])[is_piece] / 2.0
    length = np.diff(share)[is_piece]
    x, y = (start[owner] + middle[:, None] * np.stack([run, rise], axis=1)[owner]).T
    return x, y, rise[owner] * length


def _counted(
    low: npt.NDArray[np.intp], high: npt.NDArray[np.intp]
) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """All whole numbers from `low[i]` to `high[i]`, each with its i."""
    counts = np.maximum(high - low + 1, 0)
    owner = np.repeat(np.arange(len(counts)), counts)
    before = np.cumsum(counts) - counts
    return owner, np.arange(len(owner)) - before[owner] + low[owner]
