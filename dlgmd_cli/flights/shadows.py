"""Soft shadows on the walls and the floor of a room: what makes furniture stand in it."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.solids import Body, Solid
from dlgmd_cli.flights.renderer.texture import FloatImage

_PX_PER_M = 40.0
_DEEPEST = 0.6  # share of the light that a thing takes away where it touches
_FADE_M = 0.25
_FARTHEST_M = 0.9


@dataclass(frozen=True)
class Wall:
    """A rectangle seen from inside a room.

    Attributes
    ----------
    origin_m, right_m, down_m : ndarray, shape (3,)
        As `Face` has them.
    """

    origin_m: FloatArray
    right_m: FloatArray
    down_m: FloatArray

    @property
    def size_m(self) -> tuple[float, float]:
        """Width and height."""
        return float(np.linalg.norm(self.right_m)), float(np.linalg.norm(self.down_m))

    def seen(self, points_m: FloatArray) -> FloatArray:
        """Points as (right, down, how far in front of it), from its top left corner, in m."""
        width, height = self.size_m
        right, down = self.right_m / width, self.down_m / height
        axes = np.array([right, down, np.cross(down, right)])
        placed: FloatArray = (points_m - self.origin_m) @ axes.T
        return placed


def shaded(image: FloatImage, wall: Wall, bodies: Sequence[Body]) -> FloatImage:
    """The picture of a wall, darker near its edges and behind what is close to it.

    What moves casts no shadow.
    """
    width, height = wall.size_m
    shape = (max(2, math.ceil(height * _PX_PER_M)), max(2, math.ceil(width * _PX_PER_M)))
    light = np.outer(_edges(shape[0], height), _edges(shape[1], width)).astype(np.float32)
    for body in bodies:
        if isinstance(body, Solid) and body.motion is None:
            _darken(light, wall.seen(body.corners_m))
    full: FloatImage = image * cv2.resize(light, image.shape[::-1]).reshape(image.shape)
    return full


def _edges(count: int, length_m: float) -> FloatArray:
    """How bright it is along a side between two corners."""
    at = (np.arange(count) + 0.5) * length_m / count
    bright: FloatArray = 1.0 - 0.22 * (np.exp(-at / 0.3) + np.exp((at - length_m) / 0.3))
    return bright


def _darken(light: FloatImage, corners_m: FloatArray) -> None:
    """Take away the light behind a body whose corners are as `Wall.seen` has them."""
    nearest = float(corners_m[:, 2].min())
    if nearest > _FARTHEST_M:
        return
    hull = cv2.convexHull((corners_m[:, :2] * _PX_PER_M).astype(np.float32))
    sigma = (0.03 + 0.3 * nearest) * _PX_PER_M
    rim = math.ceil(3.0 * sigma) + 1
    x, y, width, height = cv2.boundingRect(hull)
    left, top = max(0, x - rim), max(0, y - rim)
    around = light[top : max(0, y + height + rim), left : max(0, x + width + rim)]
    if not around.size:
        return
    # Filled with room to spare, so that a shadow at the picture's edge is not half as deep there.
    shadow = np.zeros((around.shape[0] + 2 * rim, around.shape[1] + 2 * rim), np.float32)
    points = np.round(16.0 * (hull - 0.5 + (rim - left, rim - top))).astype(np.int32)
    cv2.fillPoly(shadow, [points], 1.0, shift=4)
    soft = cv2.GaussianBlur(shadow, (0, 0), sigma)[rim:-rim, rim:-rim]
    around *= 1.0 - _DEEPEST * math.exp(-nearest / _FADE_M) * soft
