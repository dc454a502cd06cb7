"""Shapes in an image, with the exact share of each pixel that they cover."""

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from dlgmd_cli.frame import FloatArray, FloatImage


@dataclass(frozen=True)
class Patch:
    """A shape in an image: `coverage`, 0..1, of the pixels in `rows` and `columns`."""

    rows: slice
    columns: slice
    coverage: FloatArray

    def paint(self, picture: FloatImage, luminance: float) -> None:
        """Blend `luminance` into `picture`, (H, W), by coverage, in place."""
        below = picture[self.rows, self.columns]
        below += self.coverage * (luminance - below)

    @property
    def turned(self) -> "Patch":
        """The same shape with rows and columns exchanged."""
        return Patch(self.columns, self.rows, self.coverage.T)


def rectangle(
    shape: tuple[int, int], center_yx: tuple[float, float], size_yx: tuple[float, float]
) -> Patch:
    """Exact coverage of an upright rectangle, possibly far larger than the image.

    Coordinates are in px with y down; pixel (0, 0) extends from 0 to 1.
    """
    rows, y = _pixel_edges(center_yx[0], size_yx[0] / 2, shape[0])
    columns, x = _pixel_edges(center_yx[1], size_yx[1] / 2, shape[1])
    inside_y = np.diff(np.clip(y, -size_yx[0] / 2, size_yx[0] / 2))
    inside_x = np.diff(np.clip(x, -size_yx[1] / 2, size_yx[1] / 2))
    return Patch(rows, columns, np.outer(inside_y, inside_x))


def disc(shape: tuple[int, int], center_yx: tuple[float, float], radius_px: float) -> Patch:
    """Coverage of a disc, exact up to rounding (1e-3 at a radius of a million px).

    The disc may be far larger than the image; coordinates are as in `rectangle`.
    """
    rows, y = _pixel_edges(center_yx[0], radius_px, shape[0])
    columns, x = _pixel_edges(center_yx[1], radius_px, shape[1])
    # Squared distances from the centre to the nearest and the farthest point of each pixel.
    near_y, near_x = (np.clip(0.0, each[:-1], each[1:]) ** 2 for each in (y, x))
    far_y, far_x = (np.maximum(-each[:-1], each[1:]) ** 2 for each in (y, x))
    square = radius_px * radius_px  # `**` would raise OverflowError
    covered = far_y[:, None] + far_x <= square
    coverage = covered.astype(np.float64)
    # Only pixels on the circle itself need the integral.
    i, j = np.nonzero(~covered & (near_y[:, None] + near_x < square))
    area = (
        _area_from_center(y[i + 1], x[j + 1], radius_px)
        - _area_from_center(y[i], x[j + 1], radius_px)
        - _area_from_center(y[i + 1], x[j], radius_px)
        + _area_from_center(y[i], x[j], radius_px)
    )
    coverage[i, j] = np.clip(area, 0.0, 1.0)
    return Patch(rows, columns, coverage)


def _pixel_edges(center: float, reach: float, n_pixels: int) -> tuple[slice, FloatArray]:
    """The pixels within center ± reach, and the positions of their edges relative to `center`."""
    low, high = (
        int(np.clip(edge, 0, n_pixels))
        for edge in (np.floor(center - reach), np.ceil(center + reach))
    )
    high = max(low, high)
    edges: FloatArray = np.arange(low, high + 1, dtype=np.float64) - center
    return slice(low, high), edges


def _area_from_center(y: FloatArray, x: FloatArray, radius: float) -> FloatArray:
    """Signed area of the part of the disc inside the rectangle from its centre to (y, x).

    The rectangle counts in full up to its intersection with the circle. Beyond that, the area under
    the circle counts.
    """
    height, width = np.minimum(np.abs(y), radius), np.minimum(np.abs(x), radius)
    cut = np.sqrt(radius * radius - width**2)
    under_circle = _area_under_circle(np.maximum(height, cut), radius)
    area = width * np.minimum(height, cut) + under_circle - _area_under_circle(cut, radius)
    return np.sign(y) * np.sign(x) * area


def _area_under_circle(t: FloatArray, radius: float) -> FloatArray:
    """Integral of sqrt(radius² - s²) over s from 0 to t."""
    square = radius * radius
    return (t * np.sqrt(square - t**2) + square * np.arcsin(t / radius)) / 2


def bar(
    shape: tuple[int, int],
    center_yx: tuple[float, float],
    size_yx: tuple[float, float],
    turn: float,
) -> Patch:
    """Coverage of a rectangle that is turned by `turn` radians, right to a tenth or so."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    y, x = y - center_yx[0], x - center_yx[1]
    along = x * math.cos(turn) + y * math.sin(turn)
    across = y * math.cos(turn) - x * math.sin(turn)
    inside_y, inside_x = (
        np.clip(0.5 + (size / 2 - np.abs(place)), 0.0, 1.0)
        for size, place in zip(size_yx, (across, along), strict=True)
    )
    return Patch(slice(None), slice(None), inside_y * inside_x)


def stripes(shape: tuple[int, int], first_x: float, width_px: float) -> Patch:
    """Exact coverage of upright stripes, as wide as their gaps, the first one at `first_x`."""
    periods = (np.arange(shape[1] + 1) - first_x) / (2.0 * width_px)
    whole = np.floor(periods)
    covered = width_px * (whole + np.minimum(2.0 * (periods - whole), 1.0))
    return Patch(slice(None), slice(None), np.tile(np.diff(covered), (shape[0], 1)))


def union(shape: tuple[int, int], patches: Iterable[Patch]) -> Patch:
    """Several shapes as one; a pixel on the edges of two is covered as by the greater."""
    coverage = np.zeros(shape)
    for patch in patches:
        part = coverage[patch.rows, patch.columns]
        np.maximum(part, patch.coverage, out=part)
    return Patch(slice(None), slice(None), coverage)
