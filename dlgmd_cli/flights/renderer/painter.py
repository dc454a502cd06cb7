"""A world as a camera sees it, in linear light: outlines painted on top of each other."""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from dlgmd_cli.flights.renderer.camera import Camera, Pose
from dlgmd_cli.flights.renderer.coverage import Coverage
from dlgmd_cli.flights.renderer.solids import Surfaces, World
from dlgmd_cli.flights.renderer.texture import FloatImage, Outline, Window
from dlgmd_cli.flights.renderer.visibility import Order, Sight

# Size of what is painted at a time: a band stays in the cache, and has few sizes of texture.
_BAND_PX, _MIN_ROWS = 65_536, 32


class Renderer:
    """Paints a world from any pose, at any time.

    Every face is drawn by its exact homography, far ones first; pixels on an edge get the exact
    share that is covered, and textures are sampled at the size that they are seen at.
    """

    def __init__(self, world: World, camera: Camera) -> None:
        self.world, self.camera = world, camera
        self._surfaces = Surfaces([*world.bodies, world.room])
        self._sight = Sight(self._surfaces)
        self._order = Order(world.bodies)

    def render(
        self, pose: Pose, time_s: float = 0.0, rows: tuple[int, int] | None = None
    ) -> FloatImage:
        """The picture at a time: (H, W) float32, the light that comes from each pixel.

        A white surface in ordinary light is 1. Of some rows, the first and the one after the last,
        only they are painted and returned.
        """
        offsets = self._surfaces.offsets(time_s)
        for index, body in enumerate(self.world.bodies):
            if body.motion is not None:
                self._order.move(index, body.moved(offsets[index]))
        outlines = self._sight.outlines(self.camera, pose, offsets)
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
    """Some rows of a picture of bodies that are given with the farthest first: (h, W) float32.

    Where outlines of one body share an edge, each adds its share of a pixel to what was there
    before all of them. Where nothing is, it is 0.
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
    """Left, top, right and bottom of some outlines."""
    corners = np.concatenate([outline.corners_xy for outline in outlines])
    (left, top), (right, bottom) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    return left, top, right, bottom


def _window(outlines: Sequence[Outline], width: int, rows: tuple[int, int]) -> Window:
    """What some outlines touch in some rows of a picture."""
    low_x, low_y, high_x, high_y = _extent(outlines)
    left, top = max(math.floor(low_x), 0), max(math.floor(low_y), rows[0])
    return (
        left,
        top,
        max(min(math.ceil(high_x), width), left),
        max(min(math.ceil(high_y), rows[1]), top),
    )


def _bands(window: Window) -> Iterator[Window]:
    """A window in parts."""
    left, top, right, bottom = window
    if left < right:
        n_rows = max(_MIN_ROWS, _BAND_PX // (right - left))
        for first in range(top, bottom, n_rows):
            yield left, first, right, min(first + n_rows, bottom)
