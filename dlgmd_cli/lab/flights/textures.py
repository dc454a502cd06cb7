"""Random textures of walls, floors and furniture, drawn in metres.

Every material takes a random generator, the size of the surface (width and height, in m) and a
resolution, and returns the reflectance, (h, w) float32 in 0..1, linear in light. `tone` is roughly
its mean.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.lab.flights.renderer.texture import FloatImage

Rng = np.random.Generator
Size = tuple[float, float]  # width and height, in m
MAX_SIDE_PX = 3600
DARKEST, BRIGHTEST = 0.02, 0.95
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates
_GRAIN_PX = 256
_CELL_PX = 8.0
_EVENED = 1.16  # factor that makes up for the lower standard deviation after interpolation


class Canvas:
    """A picture to draw on; x points right and y down, in m from the top left corner.

    The resolution is reduced if a side would exceed `MAX_SIDE_PX`. Initially, the picture is filled
    with `tone`.
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
        """Fill an upright rectangle with its top left corner at (x, y)."""
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

    def text(self, rng: Rng, box: Sequence[float], line: float, tone: float) -> None:
        """Fill the box (x, y, width, height) with fake text in lines of height `line`."""
        x, y, width, height = box
        for top in np.arange(y, y + height - line / 2.0, 1.8 * line):
            start, end = x, x + width * rng.uniform(0.6, 1.0)
            while start < end:
                word = min(line * rng.uniform(1.0, 4.5), end - start)
                for stroke in np.arange(start, start + word, 0.55 * line):
                    tall = line * rng.uniform(0.5, 1.0)
                    self.rectangle(stroke, top + line - tall, 0.3 * line, tall, tone)
                start += word + 0.7 * line

    def paste(self, picture: FloatImage, x: float, y: float) -> None:
        """Paste a picture of the same resolution with its top left corner at (x, y)."""
        top, left = round(y * self.scale), round(x * self.scale)
        room = self.image[top : top + picture.shape[0], left : left + picture.shape[1]]
        room[...] = picture[: room.shape[0], : room.shape[1]]

    def finished(self, blur_px: float = 0.7) -> FloatImage:
        """The picture as reflectance, blurred to avoid aliasing."""
        return reflectance(cv2.GaussianBlur(self.image, (0, 0), blur_px))


def reflectance(image: npt.ArrayLike) -> FloatImage:
    """The picture clipped to plausible reflectances."""
    return np.clip(image, DARKEST, BRIGHTEST, dtype=np.float32)


def grain(rng: Rng, shape: tuple[int, int], blur_px: float = 1.0) -> FloatImage:
    """Fine noise of standard deviation 1, with an inconspicuous period of 256 px."""
    tile = rng.standard_normal((_GRAIN_PX, _GRAIN_PX), np.float32)
    rim = 16
    wide = cv2.copyMakeBorder(tile, rim, rim, rim, rim, cv2.BORDER_WRAP)
    soft = np.asarray(cv2.GaussianBlur(wide, (0, 0), blur_px), np.float32)[rim:-rim, rim:-rim]
    tile = (soft - soft.mean()) / soft.std()
    times = tuple(-(-side // _GRAIN_PX) for side in shape)
    fine: FloatImage = np.tile(tile, times)[: shape[0], : shape[1]]
    return fine


def smooth_noise(rng: Rng, shape: tuple[int, int], cell_px: float | Size) -> FloatImage:
    """Smooth noise of standard deviation near 1, with blobs of size `cell_px`, (width, height)."""
    cell = cell_px if isinstance(cell_px, tuple) else (cell_px, cell_px)
    # Large blobs are drawn small and enlarged, which is faster and looks the same.
    steps = [max(1.0, each / _CELL_PX) for each in cell]
    small = [math.ceil(side / step) for side, step in zip(shape[::-1], steps, strict=True)]
    cell = (cell[0] / steps[0], cell[1] / steps[1])
    # One more cell on each side: replicated borders would show.
    width, height = (math.ceil(side / each) + 3 for side, each in zip(small, cell, strict=True))
    coarse = rng.standard_normal((height, width), np.float32) * _EVENED
    place = np.array([[cell[0], 0, -1.5 * cell[0]], [0, cell[1], -1.5 * cell[1]]])
    smooth = cv2.warpAffine(
        coarse, place, small, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    stretched: FloatImage = np.asarray(cv2.resize(smooth, shape[::-1]), np.float32)
    return stretched


def layered(rng: Rng, canvas: Canvas, cells_m: Sequence[float], fine: float = 0.5) -> FloatImage:
    """Noise at several scales, of standard deviation near 1; `fine` is the weight of the grain."""
    total = fine * grain(rng, canvas.shape)
    for cell_m in cells_m:
        total += smooth_noise(rng, canvas.shape, max(3.0, cell_m * canvas.scale))
    return total / math.sqrt(fine**2 + len(cells_m))


def plaster(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.6) -> FloatImage:
    """Uneven painted plaster with stains and a few scratches."""
    canvas = Canvas(size_m, px_per_m, tone)
    width, height = size_m
    for _ in range(int(1.5 * width)):
        x, y = rng.uniform(0.0, width), height * rng.beta(3.0, 1.5)
        ends = rng.normal((x, y), 0.12, (2, 2))
        canvas.line(np.array([(x, y), *ends]), 0.008, tone * rng.uniform(0.75, 0.92))
    stained = np.maximum(smooth_noise(rng, canvas.shape, 0.7 * canvas.scale) - 1.0, 0.0)
    uneven = layered(rng, canvas, (1.2, 0.3, 0.08, 0.03), fine=0.8)
    return reflectance(canvas.finished(1.2) * (1.0 + 0.045 * uneven - 0.06 * stained))


def brick(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.5) -> FloatImage:
    """A brick wall; `tone` is that of the joints, and the bricks are darker."""
    canvas = Canvas(size_m, px_per_m, tone)
    long, high, joint = 0.25, 0.08, 0.012
    for row, y in enumerate(np.arange(0.0, size_m[1], high)):
        for x in np.arange(-0.5 * long * (row % 2), size_m[0], long):
            of_brick = tone * rng.uniform(0.42, 0.78)
            canvas.rectangle(x, y, long - joint, high - joint, of_brick)
    return reflectance(canvas.finished(0.8) * (1.0 + 0.09 * layered(rng, canvas, (1.0, 0.1, 0.03))))


def wood(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.3) -> FloatImage:
    """Wood with vertical grain."""
    canvas = Canvas(size_m, px_per_m, tone)
    bent = smooth_noise(rng, canvas.shape, (0.09 * canvas.scale, 0.7 * canvas.scale))
    x = np.arange(canvas.shape[1], dtype=np.float32) / canvas.scale
    rings = np.sin(2.0 * np.pi * (x / 0.025 + 0.7 * bent))
    fibres = smooth_noise(rng, canvas.shape, (max(2.5, 0.004 * canvas.scale), 0.25 * canvas.scale))
    return reflectance(tone * (1.0 + 0.09 * rings + 0.08 * fibres + 0.08 * bent))


def parquet(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.2) -> FloatImage:
    """A floor of horizontal planks."""
    canvas = Canvas(size_m, px_per_m, tone)
    long, high = rng.uniform(0.9, 1.4), rng.uniform(0.1, 0.16)
    for y in np.arange(0.0, size_m[1], high):
        for x in np.arange(-long * rng.uniform(), size_m[0], long):
            canvas.rectangle(x, y, long, high, tone * rng.normal(1.0, 0.14))
            canvas.rectangle(x, y, 0.007, high, 0.45 * tone)
        canvas.rectangle(0.0, y, size_m[0], 0.006, 0.5 * tone)
    fibres = smooth_noise(rng, canvas.shape, (0.25 * canvas.scale, 0.015 * canvas.scale))
    return reflectance(canvas.finished() * (1.0 + 0.12 * fibres + 0.03 * grain(rng, canvas.shape)))


def carpet(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.15) -> FloatImage:
    """Worn carpet tiles in two shades."""
    canvas = Canvas(size_m, px_per_m, tone)
    for column, x in enumerate(np.arange(0.0, size_m[0], 0.5)):
        for row, y in enumerate(np.arange(0.0, size_m[1], 0.5)):
            canvas.rectangle(x, y, 0.5, 0.5, tone * (1.12 - 0.18 * ((row + column) % 2)))
    pile = layered(rng, canvas, (1.5, 0.3, 0.06, 0.025), fine=1.2)
    return reflectance(canvas.finished(1.0) * (1.0 + 0.16 * pile))


def cloth(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.3) -> FloatImage:
    """Woven cloth with slight creases."""
    canvas = Canvas(size_m, px_per_m, tone)
    weave = smooth_noise(rng, canvas.shape, (3.0, 14.0)) + smooth_noise(
        rng, canvas.shape, (14.0, 3.0)
    )
    creased = layered(rng, canvas, (0.4, 0.1), fine=0.2)
    return reflectance(tone * (1.0 + 0.08 * weave + 0.08 * creased))
