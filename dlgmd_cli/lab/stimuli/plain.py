"""Rendering of plain objects on a plain background, antialiased by exact pixel coverage."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.lab.stimuli.base import ClipOptions, GreyImage, invalid, option

DEFAULT_FRAMES = 75
FloatImage = npt.NDArray[np.float32]
FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True)
class FlatOptions(ClipOptions):
    """Options of all flat scenes.

    `contrast` is the Weber contrast (object - background) / background. Luminances range from 0 to
    1, which is grey level 255. `noise` is the standard deviation of the luminance noise, added to
    each pixel before rounding to grey levels.
    """

    contrast: float = option(-0.75, "--contrast", -1, 1000)
    background: float = option(0.8, "--background", 0, 1, low_open=True)
    noise: float = option(0.0, "--noise", 0, 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.object_luminance <= 1.0:
            raise invalid(
                "--contrast",
                f"{self.contrast:g} on a background of {self.background:g} makes the object "
                "brighter than white",
                f"Choose -1 to {1 / self.background - 1:.3g}, or a darker --background.",
            )

    @property
    def object_luminance(self) -> float:
        """Luminance of the object in 0..1."""
        return self.background * (1.0 + self.contrast)


@dataclass(frozen=True)
class FlatTruth:
    """The ground truth of one frame of a flat scene."""

    frame: int
    time_s: float
    angular_size_deg: float
    angular_velocity_deg_s: float
    time_to_contact_s: float


@dataclass(frozen=True)
class Patch:
    """A shape in a picture: `coverage`, 0..1, of the pixels in `rows` and `columns`."""

    rows: slice
    columns: slice
    coverage: FloatArray

    def paint(self, picture: FloatImage, luminance: float) -> None:
        """Blend `luminance` into `picture`, (H, W), by coverage, in place."""
        below = picture[self.rows, self.columns]
        below += self.coverage * (luminance - below)


def render(
    options: FlatOptions, n_frames: int, patches: Callable[[int], Iterable[Patch]]
) -> Iterator[GreyImage]:
    """Frames with the objects that `patches` gives for each frame index, on the background."""
    rng = np.random.default_rng(options.seed)
    for index in range(n_frames):
        picture: FloatImage = np.full(options.shape, options.background, np.float32)
        for patch in patches(index):
            patch.paint(picture, options.object_luminance)
        if options.noise > 0.0:
            picture += options.noise * rng.standard_normal(options.shape, np.float32)
        yield np.rint(255.0 * np.clip(picture, 0.0, 1.0)).astype(np.uint8)


def rectangle(
    shape: tuple[int, int], center_yx: tuple[float, float], size_yx: tuple[float, float]
) -> Patch:
    """Exact coverage of an upright rectangle, which may be far larger than the picture.

    Coordinates are in px with y down; pixel (0, 0) extends from 0 to 1.
    """
    rows, y = _pixel_edges(center_yx[0], size_yx[0] / 2, shape[0])
    columns, x = _pixel_edges(center_yx[1], size_yx[1] / 2, shape[1])
    inside_y = np.diff(np.clip(y, -size_yx[0] / 2, size_yx[0] / 2))
    inside_x = np.diff(np.clip(x, -size_yx[1] / 2, size_yx[1] / 2))
    return Patch(rows, columns, np.outer(inside_y, inside_x))


def disc(shape: tuple[int, int], center_yx: tuple[float, float], radius_px: float) -> Patch:
    """Coverage of a disc, exact up to rounding (1e-3 at a radius of a million px).

    It may be far larger than the picture; coordinates are as in `rectangle`.
    """
    rows, y = _pixel_edges(center_yx[0], radius_px, shape[0])
    columns, x = _pixel_edges(center_yx[1], radius_px, shape[1])
    near_y, far_y = _squared_distances(y)
    near_x, far_x = _squared_distances(x)
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


def _squared_distances(edges: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Squared distances from 0 to the nearest and the farthest point of each pixel."""
    low, high = edges[:-1], edges[1:]
    near = np.clip(0.0, low, high)
    return near**2, np.maximum(-low, high) ** 2


def _area_from_center(y: FloatArray, x: FloatArray, radius: float) -> FloatArray:
    """Signed area of the part of the disc inside the rectangle from its centre to (y, x).

    The rectangle counts in full up to its intersection with the circle. Beyond that, the area under
    the circle counts.
    """
    height, width = np.minimum(np.abs(y), radius), np.minimum(np.abs(x), radius)
    cut = np.sqrt(radius * radius - width**2)
    under_circle = _area_under_circle(np.maximum(height, cut), radius)
    area = width * np.minimum(height, cut) + under_circle - _area_under_circle(cut, radius)
    signed: FloatArray = np.sign(y) * np.sign(x) * area
    return signed


def _area_under_circle(t: FloatArray, radius: float) -> FloatArray:
    """Integral of sqrt(radius² - s²) over s from 0 to t."""
    square = radius * radius
    area: FloatArray = (t * np.sqrt(square - t**2) + square * np.arcsin(t / radius)) / 2
    return area
