"""A picture that is drawn in metres, and the noise that makes it look like a thing."""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.flights.renderer.texture import FloatImage

Rng = np.random.Generator
Size = tuple[float, float]  # width and height, in m
MAX_SIDE_PX = 3600
DARKEST, BRIGHTEST = 0.02, 0.95
_SHIFT = 4  # binary places of the fractions of a pixel that OpenCV draws with
_GRAIN_PX = 256
_CELL_PX = 8.0
_EVENED = 1.16  # what interpolation takes off the standard deviation


class Sheet:
    """A picture of something flat; x goes right and y down, in m from its top left corner.

    Parameters
    ----------
    size_m : (float, float)
        Width and height.
    px_per_m : float
        Its resolution; less where a side would have more than `MAX_SIDE_PX`.
    tone : float
        Reflectance that it has before anything is drawn.
    """

    def __init__(self, size_m: Size, px_per_m: float, tone: float = 0.5) -> None:
        self.size_m = size_m
        self.scale = min(px_per_m, MAX_SIDE_PX / max(size_m))
        width, height = (max(1, round(side * self.scale)) for side in size_m)
        self.image: FloatImage = np.full((height, width), tone, np.float32)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, in px."""
        height, width = self.image.shape
        return height, width

    def polygon(self, points_m: npt.ArrayLike, tone: float) -> None:
        """Fill a polygon, (n, 2)."""
        points = np.asarray(points_m) * self.scale - 0.5
        fixed = np.round(points * (1 << _SHIFT)).astype(np.int32)
        cv2.fillPoly(self.image, [fixed], tone, shift=_SHIFT)

    def rectangle(self, x: float, y: float, width: float, height: float, tone: float) -> None:
        """Fill an upright rectangle that has its top left corner at (x, y)."""
        low_x, high_x = (round(each * self.scale) for each in (x, x + width))
        low_y, high_y = (round(each * self.scale) for each in (y, y + height))
        self.image[max(low_y, 0) : max(high_y, 0), max(low_x, 0) : max(high_x, 0)] = tone

    def frame(
        self, x: float, y: float, width: float, height: float, line: float, tone: float
    ) -> None:
        """Draw the edges of an upright rectangle, inside it."""
        self.rectangle(x, y, width, line, tone)
        self.rectangle(x, y + height - line, width, line, tone)
        self.rectangle(x, y, line, height, tone)
        self.rectangle(x + width - line, y, line, height, tone)

    def line(self, points_m: npt.ArrayLike, width: float, tone: float) -> None:
        """Draw a line through points, (n, 2)."""
        points = np.asarray(points_m) * self.scale - 0.5
        fixed = np.round(points * (1 << _SHIFT)).astype(np.int32)
        thick = max(1, round(width * self.scale))
        cv2.polylines(self.image, [fixed], False, tone, thick, shift=_SHIFT)

    def disc(self, x: float, y: float, radius: float, tone: float) -> None:
        """Fill a circle around (x, y)."""
        around = np.linspace(0.0, 2.0 * math.pi, 40, endpoint=False)
        self.polygon(np.stack([x + radius * np.cos(around), y + radius * np.sin(around)], -1), tone)

    def lettering(self, rng: Rng, box: Sequence[float], line: float, tone: float) -> None:
        """Fill the box (x, y, width, height) with lines, `line` high, of strokes like words."""
        x, y, width, height = box
        for top in np.arange(y, y + height - line / 2.0, 1.8 * line):
            start, end = x, x + width * rng.uniform(0.6, 1.0)
            while start < end:
                word = min(line * rng.uniform(1.0, 4.5), end - start)
                for stroke in np.arange(start, start + word, 0.55 * line):
                    tall = line * rng.uniform(0.5, 1.0)
                    self.rectangle(stroke, top + line - tall, 0.3 * line, tall, tone)
                start += word + 0.7 * line

    def stick(self, picture: FloatImage, x: float, y: float) -> None:
        """Paste a picture of the same resolution with its top left corner at (x, y)."""
        top, left = round(y * self.scale), round(x * self.scale)
        room = self.image[top : top + picture.shape[0], left : left + picture.shape[1]]
        room[...] = picture[: room.shape[0], : room.shape[1]]

    def finished(self, blur_px: float = 0.7) -> FloatImage:
        """The picture without edges finer than its pixels, within what things reflect."""
        return limited(cv2.GaussianBlur(self.image, (0, 0), blur_px))


def limited(image: npt.ArrayLike) -> FloatImage:
    """The picture within what things reflect."""
    return np.clip(image, DARKEST, BRIGHTEST, dtype=np.float32)


def grain(rng: Rng, shape: tuple[int, int], blur_px: float = 1.0) -> FloatImage:
    """Fine noise of standard deviation 1; it repeats, out of sight, every 256 px."""
    tile = rng.standard_normal((_GRAIN_PX, _GRAIN_PX), np.float32)
    rim = 16
    wide = cv2.copyMakeBorder(tile, rim, rim, rim, rim, cv2.BORDER_WRAP)
    soft = np.asarray(cv2.GaussianBlur(wide, (0, 0), blur_px), np.float32)[rim:-rim, rim:-rim]
    tile = (soft - soft.mean()) / soft.std()
    times = tuple(-(-side // _GRAIN_PX) for side in shape)
    fine: FloatImage = np.tile(tile, times)[: shape[0], : shape[1]]
    return fine


def clouds(rng: Rng, shape: tuple[int, int], cell_px: float | Size) -> FloatImage:
    """Smooth noise of standard deviation near 1 and about a blob per cell, (width, height)."""
    cell = cell_px if isinstance(cell_px, tuple) else (cell_px, cell_px)
    # Wide blobs are made small and stretched, which is quicker and looks the same.
    steps = [max(1.0, each / _CELL_PX) for each in cell]
    small = [math.ceil(side / step) for side, step in zip(shape[::-1], steps, strict=True)]
    cell = (cell[0] / steps[0], cell[1] / steps[1])
    # Another cell on each side: what is stretched over the edge has a plain rim there.
    width, height = (math.ceil(side / each) + 3 for side, each in zip(small, cell, strict=True))
    coarse = rng.standard_normal((height, width), np.float32) * _EVENED
    place = np.array([[cell[0], 0, -1.5 * cell[0]], [0, cell[1], -1.5 * cell[1]]])
    smooth = cv2.warpAffine(
        coarse, place, small, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    stretched: FloatImage = np.asarray(cv2.resize(smooth, shape[::-1]), np.float32)
    return stretched


def layered(rng: Rng, sheet: Sheet, cells_m: Sequence[float], fine: float = 0.5) -> FloatImage:
    """Noise at several scales at once, standard deviation near 1, `fine` of it grain."""
    total = fine * grain(rng, sheet.shape)
    for cell_m in cells_m:
        total += clouds(rng, sheet.shape, max(3.0, cell_m * sheet.scale))
    return total / math.sqrt(fine**2 + len(cells_m))
