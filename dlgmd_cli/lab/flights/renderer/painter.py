"""Rendering of a world in linear light, by painting outlines from back to front."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dlgmd_cli.lab.flights.renderer.camera import Camera, Pose
from dlgmd_cli.lab.flights.renderer.coverage import Coverage
from dlgmd_cli.lab.flights.renderer.solids import Surfaces, World
from dlgmd_cli.lab.flights.renderer.texture import FloatImage, Outline, Window
from dlgmd_cli.lab.flights.renderer.visibility import PaintOrder, Projector

# Size of the bands to paint: a band fits into the cache and needs few texture sizes.
_BAND_PX, _MIN_ROWS = 65_536, 32


class Renderer:
    """Renders a world for any pose and time.

    Faces are drawn by their exact homographies, far ones first. Pixels on an edge are blended by
    exact coverage, and textures are sampled at the size at which they appear.
    """

    def __init__(self, world: World, camera: Camera) -> None:
        self.world, self.camera = world, camera
        self._surfaces = Surfaces([*world.bodies, world.room])
        self._projector = Projector(self._surfaces)
        self._order = PaintOrder(world.bodies)

    def render(
        self, pose: Pose, time_s: float = 0.0, rows: tuple[int, int] | None = None
    ) -> FloatImage:
        """The picture at a time: (H, W) float32, the light in each pixel.

        A white surface in normal light is 1. With `rows`, (first, end), only these rows are painted
        and returned.
        """
        offsets = self._surfaces.offsets(time_s)
        for index, body in enumerate(self.world.bodies):
            if body.motion is not None:
                self._order.move(index, body.moved(offsets[index]))
        outlines = self._projector.outlines(self.camera, pose, offsets)
        room = outlines.pop(len(self.world.bodies), None)
        extents = {index: _extent(each) for index, each in outlines.items()}
        order = self._order.back_to_front(pose.position_m, extents)
        painted = [*([room] if room else []), *(outlines[index] for index in order)]
        picture = _paint(painted, self.camera, rows or (0, self.camera.shape[0]))
        light = self.world.light(time_s)
        if light != 1.0:
            picture *= np.float32(light)
        return picture


def _paint(
    bodies: Sequence[Sequence[Outline]], camera: Camera, rows: tuple[int, int]
) -> FloatImage:
    """Paint some rows of a picture of bodies, given farthest first: (h, W) float32.

    All outlines of a body are blended with the picture before that body, so that shared edges come
    out right. Empty pixels are 0.
    """
    height, width = camera.shape
    picture: FloatImage = np.zeros((height, width), np.float32)
    every = [outline for outlines in bodies for outline in outlines]
    coverage = Coverage([outline.corners_xy for outline in every], (0, rows[0], width, rows[1]))
    first = 0
    for outlines in bodies:
        left, top, right, bottom = _window(outlines, width, rows)
        before = picture[top:bottom, left:right].copy()
        for index, outline in enumerate(outlines, first):
            for window in _bands(_window([outline], width, rows)):
                x, y, x_end, y_end = window
                texture = outline.sample(window, camera.focal_px)
                texture *= np.float32(outline.gain)
                share = coverage.share(index, window)
                target = picture[y:y_end, x:x_end]
                if share is None:
                    target[...] = texture
                    continue
                texture -= before[y - top : y_end - top, x - left : x_end - left]
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
    """The window of a picture, limited to some rows, that contains the outlines."""
    low_x, low_y, high_x, high_y = _extent(outlines)
    left, top = max(math.floor(low_x), 0), max(math.floor(low_y), rows[0])
    return (
        left,
        top,
        max(min(math.ceil(high_x), width), left),
        max(min(math.ceil(high_y), rows[1]), top),
    )


def _bands(window: Window) -> Iterator[Window]:
    """Split a window into bands of rows."""
    left, top, right, bottom = window
    if left < right:
        n_rows = max(_MIN_ROWS, _BAND_PX // (right - left))
        for first in range(top, bottom, n_rows):
            yield left, first, right, min(first + n_rows, bottom)
