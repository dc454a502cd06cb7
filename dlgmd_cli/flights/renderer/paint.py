"""Outlines into a picture, one on top of the other."""

import math
from collections.abc import Sequence

import numpy as np

from dlgmd_cli.flights.renderer.camera import Camera
from dlgmd_cli.flights.renderer.coverage import Coverage
from dlgmd_cli.flights.renderer.outline import Outline
from dlgmd_cli.flights.renderer.sample import bands, sample
from dlgmd_cli.flights.renderer.texture import FloatImage


def paint(bodies: Sequence[Sequence[Outline]], camera: Camera, rows: tuple[int, int]) -> FloatImage:
    """Some rows of a picture of bodies that are given with the farthest first.

    Parameters
    ----------
    bodies : sequence of sequence of Outline
        What is seen of each. Where these share an edge, each adds its share of a pixel to what was
        there before all of them.
    camera : Camera
    rows : (int, int)
        The first, and the one after the last.

    Returns
    -------
    ndarray, shape (h, W), float32
        Linear light; where nothing is, 0.
    """
    height, width = camera.shape
    picture: FloatImage = np.zeros((height, width), np.float32)
    every = [outline for outlines in bodies for outline in outlines]
    coverage = Coverage([outline.corners_xy for outline in every], (0, rows[0], width, rows[1]))
    first = 0
    for outlines in bodies:
        before, (left, top) = _before(picture, outlines, rows)
        for index, outline in enumerate(outlines, first):
            for window in bands(outline, camera.shape, rows):
                x, y, x_end, y_end = window
                texture = sample(outline, window, camera.focal_px)
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


def _before(
    picture: FloatImage, outlines: Sequence[Outline], rows: tuple[int, int]
) -> tuple[FloatImage, tuple[int, int]]:
    """What is in the picture around some outlines, and where its left top corner is."""
    if len(outlines) == 1:
        return picture, (0, 0)
    corners = np.concatenate([outline.corners_xy for outline in outlines])
    (low_x, low_y), (high_x, high_y) = corners.min(axis=0), corners.max(axis=0)
    left, top = max(math.floor(low_x), 0), max(math.floor(low_y), rows[0])
    right = min(max(math.ceil(high_x), left), picture.shape[1])
    bottom = max(min(math.ceil(high_y), rows[1]), top)
    return picture[top:bottom, left:right].copy(), (left, top)
