"""Rendering of a world in linear light, by painting outlines from back to front.

The coverage of pixels is exact: every side of a polygon is cut at the borders of pixels. Each piece
adds to its own pixel, and to all pixels right of it, the area between the piece and their right
borders. Sides that go down add this area, and sides that go up subtract it.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dlgmd_cli.frame import FloatArray, FloatImage
from dlgmd_cli.scenes.flights.camera import Camera, Pose
from dlgmd_cli.scenes.flights.solids import IntArray, Outline, Shade, Surfaces, Window, World
from dlgmd_cli.scenes.flights.visibility import PaintOrder, visible_outlines

# Rounding tolerance for the height of a window.
_ROUNDING = 1e-9
# Size of the bands to paint: a band fits into the cache and needs few texture sizes.
_BAND_PX, _MIN_ROWS = 65_536, 32


class Coverage:
    """Pixel coverage of many polygons inside a window.

    The polygons, (n, 2) each, are in px and clockwise on the screen. They may extend far outside
    the image.
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
        of_face = slice(self._starts[index], self._starts[index + 1])
        row = self._row[of_face] - top
        here = (row >= 0) & (row < height)
        row, x, rise = row[here], self._x[of_face][here] - left, self._rise[of_face][here]
        if -rise[x <= 0.0].sum() >= height - _ROUNDING and not ((x > 0.0) & (x < width)).any():
            return None
        x = np.minimum(np.maximum(x, 0.0), width)
        column = np.minimum(x.astype(np.intp), width - 1)
        part = rise * (x - column)
        cell = row * (width + 1) + column
        cells, parts = np.concatenate([cell, cell + 1]), np.concatenate([part - rise, -part])
        steps = np.bincount(cells, parts, height * (width + 1)).reshape(height, width + 1)
        return np.cumsum(steps, axis=1, out=steps)[:, :width].astype(np.float32)


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
        # All integers from `low` to `high` of each side.
        counts = np.maximum(high[:, axis] - low[:, axis] + 1, 0)
        side = np.repeat(sides, counts)
        line = np.arange(len(side)) - (np.cumsum(counts) - counts)[side] + low[side, axis]
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


class Renderer:
    """Renders a world for any pose and time.

    Faces are drawn by their exact homographies, far ones first. Pixels on an edge are blended by
    exact coverage, and textures are sampled at the size at which they appear.
    """

    def __init__(self, world: World, camera: Camera) -> None:
        self.world, self.camera = world, camera
        self._surfaces = Surfaces([*world.bodies, world.room, *world.shadows])
        self._order = PaintOrder(world.bodies)
        self._latest: tuple[bytes, FloatImage] | None = None

    def render(
        self, pose: Pose, time_s: float = 0.0, rows: tuple[int, int] | None = None
    ) -> FloatImage:
        """The image at a time: (H, W) float32, the light in each pixel.

        A white surface in normal light is 1. With `rows`, (first, end), only these rows are painted
        and returned.
        """
        offsets, rows = self._surfaces.offsets(time_s), rows or (0, self.camera.shape[0])
        facts = [pose.position_m, pose.rotation, offsets, np.array(rows)]
        view = b"".join(fact.tobytes() for fact in facts)
        if self._latest is None or self._latest[0] != view:  # else nothing has moved
            self._latest = view, self._picture(pose, offsets, rows)
        return self._latest[1] * np.float32(self.world.light(time_s))

    def _picture(self, pose: Pose, offsets: FloatArray, rows: tuple[int, int]) -> FloatImage:
        """The image in normal light with bodies at their places."""
        for index, body in enumerate(self.world.bodies):
            if body.motion is not None:
                self._order.move(index, body.moved(offsets[index]))
        seen = visible_outlines(self._surfaces, self.camera, pose, offsets)
        # The room, and the shadows on it.
        behind = [seen.pop(index) for index in sorted(seen) if index >= len(self.world.bodies)]
        extents = {index: _extent(each) for index, each in seen.items()}
        order = self._order.back_to_front(pose.position_m, extents)
        return _paint([*behind, *(seen[index] for index in order)], self.camera, rows)


def _paint(
    bodies: Sequence[Sequence[Outline]], camera: Camera, rows: tuple[int, int]
) -> FloatImage:
    """Paint some rows of an image of bodies, given farthest first: (h, W) float32."""
    height, width = camera.shape
    picture: FloatImage = np.zeros((height, width), np.float32)
    every = [outline for outlines in bodies for outline in outlines]
    coverage = Coverage([outline.corners_xy for outline in every], (0, rows[0], width, rows[1]))
    first = 0
    for outlines in filter(None, bodies):
        left, top, right, bottom = _window(outlines, width, rows)
        # All outlines of a body are blended with this, so that shared edges come out right.
        before = picture[top:bottom, left:right].copy()
        for index, outline in enumerate(outlines, first):
            for window in _bands(_window([outline], width, rows)):
                x, y, x_end, y_end = window
                texture = outline.sample(window, camera.focal_px)
                texture *= np.float32(outline.gain)
                was = before[y - top : y_end - top, x - left : x_end - left]
                if isinstance(outline.texture, Shade):
                    texture *= was
                share = coverage.share(index, window)
                target = picture[y:y_end, x:x_end]
                if share is None:
                    target[...] = texture
                    continue
                texture -= was
                texture *= share
                target += texture
        first += len(outlines)
    return picture[rows[0] : rows[1]]


def _extent(outlines: Sequence[Outline]) -> tuple[float, float, float, float]:
    """Left, top, right and bottom of a group of outlines."""
    corners = np.concatenate([outline.corners_xy for outline in outlines])
    (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return left, top, right, bottom


def _window(outlines: Sequence[Outline], width: int, rows: tuple[int, int]) -> Window:
    """The window of an image, limited to some rows, that contains the outlines."""
    low_x, low_y, high_x, high_y = _extent(outlines)
    left, top = max(math.floor(low_x), 0), max(math.floor(low_y), rows[0])
    right, bottom = min(math.ceil(high_x), width), min(math.ceil(high_y), rows[1])
    return left, top, max(right, left), max(bottom, top)


def _bands(window: Window) -> Iterator[Window]:
    """Split a window into bands of rows."""
    left, top, right, bottom = window
    if left < right:
        n_rows = max(_MIN_ROWS, _BAND_PX // (right - left))
        for first in range(top, bottom, n_rows):
            yield left, first, right, min(first + n_rows, bottom)
