"""Random textures of surfaces and images of things, drawn in metres.

Every material takes a random generator, the size of the surface (width and height, in m) and a
resolution, and returns the reflectance, (h, w) float32 in 0..1, linear in light. `tone` is roughly
its mean.
"""

import math
from collections.abc import Sequence

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import FloatArray, FloatImage
from dlgmd_cli.scenes.flights.solids import Shade

Rng = np.random.Generator
Size = tuple[float, float]  # width and height, in m
MAX_SIDE_PX = 3600
DARKEST, BRIGHTEST = 0.02, 0.95
_SHIFT = 4  # fractional bits of OpenCV's drawing coordinates
_GRAIN_PX = 256
_CELL_PX = 8.0
_EVENED = 1.16  # factor that makes up for the lower standard deviation after interpolation


class Canvas:
    """An image to draw on; x points right and y down, in m from the top left corner.

    The resolution is reduced if a side would exceed `MAX_SIDE_PX`. Initially, the image is filled
    with `tone`.
    """

    def __init__(self, size_m: Size, px_per_m: float, tone: float = 0.5) -> None:
        self.size_m = size_m
        self.scale = min(px_per_m, MAX_SIDE_PX / max(size_m))
        width, height = (max(1, round(side * self.scale)) for side in size_m)
        self.shape = height, width
        self.image: FloatImage = np.full(self.shape, tone, np.float32)

    def polygon(self, points_m: npt.ArrayLike, tone: float) -> None:
        """Fill a polygon, (n, 2)."""
        cv2.fillPoly(self.image, [self._fixed(points_m)], tone, shift=_SHIFT)

    def rectangle(self, x: float, y: float, width: float, height: float, tone: float) -> None:
        """Fill an upright rectangle with its top left corner at (x, y)."""
        low_x, high_x = (round(each * self.scale) for each in (x, x + width))
        low_y, high_y = (round(each * self.scale) for each in (y, y + height))
        self.image[max(low_y, 0) : max(high_y, 0), max(low_x, 0) : max(high_x, 0)] = tone

    def grid(self, x: FloatArray, y: FloatArray, line: float, tone: float) -> None:
        """Draw lines across the whole image, which begin at some x, and then at some y."""
        for left in x:
            self.rectangle(left, 0.0, line, self.size_m[1], tone)
        for top in y:
            self.rectangle(0.0, top, self.size_m[0], line, tone)

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
        thick = max(1, round(width * self.scale))
        cv2.polylines(self.image, [self._fixed(points_m)], False, tone, thick, shift=_SHIFT)

    def _fixed(self, points_m: npt.ArrayLike) -> npt.NDArray[np.int32]:
        """Points as OpenCV draws them, in fractions of a px."""
        points = np.asarray(points_m) * self.scale - 0.5
        return np.round(points * (1 << _SHIFT)).astype(np.int32)

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
        """Paste an image of the same resolution with its top left corner at (x, y)."""
        top, left = round(y * self.scale), round(x * self.scale)
        room = self.image[top : top + picture.shape[0], left : left + picture.shape[1]]
        room[...] = picture[: room.shape[0], : room.shape[1]]

    def finished(self, blur_px: float = 0.7) -> FloatImage:
        """The image as reflectance, blurred to avoid aliasing."""
        return reflectance(cv2.GaussianBlur(self.image, (0, 0), blur_px))


def reflectance(image: npt.ArrayLike) -> FloatImage:
    """The image clipped to plausible reflectances."""
    return np.clip(image, DARKEST, BRIGHTEST, dtype=np.float32)


def grain(rng: Rng, shape: tuple[int, int]) -> FloatImage:
    """Fine noise of standard deviation 1, with an inconspicuous period of 256 px."""
    tile = rng.standard_normal((_GRAIN_PX, _GRAIN_PX), np.float32)
    rim = 16
    wide = cv2.copyMakeBorder(tile, rim, rim, rim, rim, cv2.BORDER_WRAP)
    soft = np.asarray(cv2.GaussianBlur(wide, (0, 0), 1.0), np.float32)[rim:-rim, rim:-rim]
    tile = (soft - soft.mean()) / soft.std()
    return np.tile(tile, tuple(-(-side // _GRAIN_PX) for side in shape))[: shape[0], : shape[1]]


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
    return np.asarray(cv2.resize(smooth, shape[::-1]), np.float32)


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
            canvas.rectangle(x, y, long - joint, high - joint, tone * rng.uniform(0.42, 0.78))
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


def tiles(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.35) -> FloatImage:
    """Square floor tiles in two tones, of a random contrast, with dark joints."""
    canvas = Canvas(size_m, px_per_m, 0.3 * tone)
    side, contrast, joint = rng.uniform(0.2, 0.6), rng.uniform(0.0, 0.8), 0.012
    for column, x in enumerate(np.arange(0.0, size_m[0], side)):
        for row, y in enumerate(np.arange(0.0, size_m[1], side)):
            of_tile = tone * rng.normal(1.0, 0.06) * (1.0 - contrast * ((row + column) % 2))
            canvas.rectangle(x, y, side - joint, side - joint, of_tile)
    return reflectance(canvas.finished() * (1.0 + 0.04 * layered(rng, canvas, (0.5, 0.05))))


def lines(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.15) -> FloatImage:
    """Rough dark ground with bright painted lines, across, along and dashed."""
    canvas = Canvas(size_m, px_per_m, tone)
    (width, height), paint = size_m, rng.uniform(0.25, 0.6)
    wide, every = rng.uniform(0.03, 0.12), rng.uniform(0.6, 1.8)
    across = np.arange(rng.uniform(0.0, every), width, every)
    canvas.grid(across, rng.uniform(0.0, height, 3), wide, paint)
    y = rng.uniform(0.3, 0.7) * height
    for x in np.arange(0.0, width, 1.2):
        canvas.rectangle(x, y, 0.7, wide, paint)
    return reflectance(canvas.finished() * (1.0 + 0.18 * layered(rng, canvas, (0.8, 0.1, 0.03))))


def cloth(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.3) -> FloatImage:
    """Woven cloth with slight creases."""
    canvas = Canvas(size_m, px_per_m, tone)
    across, along = (smooth_noise(rng, canvas.shape, cell) for cell in ((3.0, 14.0), (14.0, 3.0)))
    creased = layered(rng, canvas, (0.4, 0.1), fine=0.2)
    return reflectance(tone * (1.0 + 0.08 * (across + along) + 0.08 * creased))


def gridded(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """A grid of black lines on white: nine vertical ones, and horizontal ones at equal spacing."""
    canvas = Canvas(size_m, px_per_m, 0.82)
    width, height = size_m
    n_lines, line = 9, 0.02
    n_level = max(2, round((height - line) / (width - line) * (n_lines - 1)) + 1)
    x, y = np.linspace(0.0, width - line, n_lines), np.linspace(0.0, height - line, n_level)
    canvas.grid(x, y, line, 0.04)
    return canvas.finished()


def poster(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """An abstract image with some lines like writing, on paper with a frame."""
    paper, ground = rng.uniform(0.6, 0.85), rng.uniform(0.08, 0.6)
    width, height = size_m
    canvas = Canvas(size_m, px_per_m, paper)
    rim = 0.06 * min(size_m)
    bottom = height * rng.uniform(0.62, 0.8)
    inner = Canvas((width - 2 * rim, bottom - rim), canvas.scale, ground)
    for _ in range(rng.integers(5, 10)):
        x, y = rng.uniform(0.0, inner.size_m)
        reach = rng.uniform(0.08, 0.4) * width
        tone = rng.choice([0.04, 0.12, 0.3, 0.55, 0.8])
        kind = rng.integers(4)
        if kind == 0:
            sides = reach * rng.uniform(0.5, 1.2, 2)
            inner.rectangle(x - sides[0] / 2, y - sides[1] / 2, sides[0], sides[1], tone)
        elif kind == 1:
            inner.disc(x, y, 0.5 * reach, tone)
        elif kind == 2:
            inner.polygon(rng.normal((x, y), 0.6 * reach, (3, 2)), tone)
        else:
            inner.line(rng.normal((x, y), reach, (4, 2)), 0.02 * width, tone)
    inner.image *= 1.0 + 0.06 * smooth_noise(rng, inner.shape, 0.1 * inner.scale)
    canvas.paste(inner.image, rim, rim)
    line = 0.035 * height
    canvas.text(rng, (rim, bottom + line, width - 2 * rim, line), 1.3 * line, 0.07)
    text = (rim, bottom + 3.2 * line, width - 2 * rim, height - rim - bottom - 3.2 * line)
    canvas.text(rng, text, 0.35 * line, 0.2)
    canvas.frame(0.0, 0.0, width, height, 0.018, rng.choice([0.05, 0.25, 0.5]))
    return canvas.finished()


def bookcase_front(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.3) -> FloatImage:
    """Five rows of book spines behind the two glass doors of a bookcase."""
    canvas = Canvas(size_m, px_per_m, tone)
    width, height = size_m
    tall = (height - 0.1) / 5
    for low in 0.05 + tall * np.arange(1, 6):
        canvas.rectangle(0.04, low - tall + 0.06, width - 0.08, tall - 0.06, 0.03)
        x = 0.04
        while x < width - 0.1:
            thick, high = rng.uniform(0.015, 0.055), (tall - 0.06) * rng.uniform(0.7, 1.0)
            back = float(rng.choice([0.05, 0.1, 0.2, 0.35, 0.6])) * rng.uniform(0.8, 1.2)
            ink = 0.75 if back < 0.25 else 0.07
            canvas.rectangle(x, low - high, thick - 0.003, high, back)
            canvas.rectangle(x, low - rng.uniform(0.2, 0.9) * high, thick - 0.003, 0.015, ink)
            canvas.rectangle(x + 0.35 * thick, low - 0.65 * high, 0.25 * thick, 0.3 * high, ink)
            x += thick
    canvas.rectangle(0.5 * width - 0.02, 0.0, 0.04, height, tone)
    canvas.rectangle(0.5 * width - 0.003, 0.0, 0.006, height, 0.2 * tone)
    return canvas.finished()


def whiteboard(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """Scribbled notes, boxes with arrows between them, and a curve, in a metal frame."""
    canvas = Canvas(size_m, px_per_m, 0.78)
    width, height = size_m
    canvas.image *= 1.0 + 0.03 * smooth_noise(rng, canvas.shape, 0.3 * canvas.scale)
    notes = (0.07 * width, 0.1 * height, 0.35 * width, 0.4 * height)
    canvas.text(rng, notes, 0.035, 0.15)
    for row in range(3):
        y = height * (0.12 + 0.27 * row)
        canvas.frame(0.55 * width, y, 0.14 * width, 0.15 * height, 0.01, 0.1)
        canvas.frame(0.78 * width, y, 0.14 * width, 0.15 * height, 0.01, 0.3)
        canvas.line([(0.69 * width, y + 0.07), (0.78 * width, y + 0.07)], 0.01, 0.1)
        canvas.text(rng, (0.57 * width, y + 0.03, 0.1 * width, 0.08), 0.025, 0.1)
    x = np.linspace(0.08, 0.45, 40)
    canvas.line(np.stack([x * width, height * (0.8 - 0.12 * np.sin(14 * x))], -1), 0.012, 0.12)
    corner = np.array([(0.08, 0.58), (0.08, 0.92), (0.46, 0.92)]) * size_m
    canvas.line(corner, 0.01, 0.08)
    canvas.frame(0.0, 0.0, width, height, 0.025, 0.4)
    return canvas.finished()


def carton_side(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.3) -> FloatImage:
    """Cardboard with tape down its middle, arrows that say which way is up, and lines of print."""
    canvas = Canvas(size_m, px_per_m, tone)
    width, height = size_m
    unit = min(size_m)
    canvas.rectangle(0.5 * width - 0.06 * unit, 0.0, 0.12 * unit, 0.4 * height, 1.45 * tone)
    canvas.rectangle(0.0, 0.0, width, 0.006, 0.5 * tone)
    ink = 0.2 * tone
    for x in (0.68 * width, 0.83 * width):
        tip = np.array((x, 0.12 * height))
        arrow = [(0, 0), (0.09, 0.12), (0.035, 0.12), (0.035, 0.3), (-0.035, 0.3), (-0.035, 0.12)]
        canvas.polygon(tip + unit * np.array([*arrow, (-0.09, 0.12)]), ink)
    canvas.rectangle(0.62 * width, 0.12 * height + 0.34 * unit, 0.28 * width, 0.025 * unit, ink)
    canvas.text(rng, (0.08 * width, 0.5 * height, 0.5 * width, 0.2 * height), 0.09 * unit, ink)
    canvas.rectangle(0.72 * width, 0.66 * height, 0.2 * width, 0.22 * height, 0.75)
    text = (0.74 * width, 0.7 * height, 0.16 * width, 0.16 * height)
    canvas.text(rng, text, 0.03 * unit, 0.06)
    waves = smooth_noise(rng, canvas.shape, (max(3.0, 0.006 * canvas.scale), 0.3 * canvas.scale))
    worn = layered(rng, canvas, (0.2, 0.04, 0.01), fine=0.3)
    return reflectance(canvas.finished(0.8) * (1.0 + 0.025 * waves + 0.05 * worn))


def notebook_screen(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """A screen with two windows of text and bar charts, in a dark frame."""
    canvas = Canvas(size_m, px_per_m, 0.035)
    width, height = size_m
    rim = 0.05 * width
    shown = Canvas((width - 2 * rim, height - 2.4 * rim), canvas.scale, 0.22)
    wide, high = shown.size_m
    shown.image += 0.05 * smooth_noise(rng, shown.shape, 0.08 * shown.scale)
    for x, y, w, h, tone in ((0.04, 0.06, 0.52, 0.7, 0.8), (0.48, 0.2, 0.48, 0.66, 0.7)):
        shown.rectangle(x * wide, y * high, w * wide, h * high, tone)
        shown.rectangle(x * wide, y * high, w * wide, 0.06 * high, 0.1)
        text = ((x + 0.03) * wide, (y + 0.1) * high, (w - 0.06) * wide, (h - 0.35) * high)
        shown.text(rng, text, 0.022 * high, 0.08)
        bars = rng.uniform(0.04, 0.2, 8)
        for at, bar in zip(np.linspace(x + 0.04, x + w - 0.08, 8), bars, strict=True):
            base = (y + h - 0.03) * high
            shown.rectangle(at * wide, base - bar * high, 0.035 * wide, bar * high, 0.15)
    shown.rectangle(0.0, 0.93 * high, wide, 0.07 * high, 0.06)
    canvas.paste(shown.image, rim, rim)
    canvas.rectangle(0.44 * width, height - 0.9 * rim, 0.12 * width, 0.2 * rim, 0.3)
    return canvas.finished()


def door_leaf(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.5) -> FloatImage:
    """A door with its frame, two recessed panels and a handle."""
    canvas = Canvas(size_m, px_per_m, tone)
    width, height = size_m
    for low, high in ((0.1, 0.46), (0.54, 0.92)):
        _recess(canvas, (0.2 * width, low * height, 0.6 * width, (high - low) * height), tone)
    canvas.frame(0.0, 0.0, width, height + 0.2, 0.07, 0.8 * tone)
    canvas.frame(0.07, 0.07, width - 0.14, height + 0.2, 0.012, 0.3 * tone)
    canvas.rectangle(0.82 * width, 0.5 * height, 0.025, 0.16, 0.6)
    canvas.rectangle(0.72 * width, 0.52 * height, 0.12, 0.022, 0.08)
    canvas.rectangle(0.72 * width, 0.52 * height, 0.12, 0.008, 0.8)
    return reflectance(canvas.finished() * (1.0 + 0.03 * layered(rng, canvas, (0.4, 0.08, 0.02))))


def window_pane(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """A bright window: blurred trees, houses and sky behind its bars, and a sill."""
    canvas = Canvas(size_m, px_per_m, 0.9)
    width, height = size_m
    for _ in range(7):
        wide, top = rng.uniform(0.15, 0.4) * width, rng.uniform(0.4, 0.75) * height
        canvas.rectangle(rng.uniform(-0.1, 1.0) * width, top, wide, height, rng.uniform(0.25, 0.6))
    for _ in range(25):
        x, y = rng.uniform(0.0, width), rng.uniform(0.55, 0.95) * height
        canvas.disc(x, y, rng.uniform(0.03, 0.15) * width, rng.uniform(0.12, 0.4))
    canvas.image[...] = cv2.GaussianBlur(canvas.image, (0, 0), 0.025 * canvas.scale)
    canvas.image *= 1.0 + 0.03 * smooth_noise(rng, canvas.shape, 0.1 * canvas.scale)
    canvas.rectangle(0.5 * width - 0.035, 0.0, 0.07, height, 0.55)
    canvas.rectangle(0.5 * width - 0.004, 0.0, 0.008, height, 0.25)
    canvas.frame(0.0, 0.0, width, height, 0.06, 0.6)
    canvas.frame(0.06, 0.06, width - 0.12, height - 0.12, 0.012, 0.2)
    canvas.rectangle(0.0, height - 0.05, width, 0.05, 0.75)
    return canvas.finished()


def cupboard_front(rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.35) -> FloatImage:
    """Two wooden doors with a gap between them, handles, and two drawers at the bottom."""
    canvas = Canvas(size_m, px_per_m, tone)
    width, height = size_m
    bent = smooth_noise(rng, canvas.shape, (0.04 * canvas.scale, 0.6 * canvas.scale))
    fibres = smooth_noise(rng, canvas.shape, (max(2.5, 0.005 * canvas.scale), 0.25 * canvas.scale))
    canvas.image *= 1.0 + 0.06 * bent + 0.05 * fibres
    for x in (0.05, 0.55):
        _recess(canvas, (x * width, 0.04 * height, 0.4 * width, 0.68 * height), tone)
        canvas.rectangle((x + 0.15) * width, 0.86 * height, 0.1 * width, 0.02, 0.07)
    for x in (0.455, 0.52):
        canvas.rectangle(x * width, 0.36 * height, 0.025 * width, 0.14, 0.07)
    canvas.rectangle(0.495 * width, 0.0, 0.008, height, 0.2 * tone)
    canvas.rectangle(0.0, 0.77 * height, width, 0.008, 0.2 * tone)
    canvas.rectangle(0.0, height - 0.06, width, 0.06, 0.3 * tone)
    canvas.frame(0.0, 0.0, width, height, 0.012, 0.6 * tone)
    return canvas.finished()


def ceiling_panels(
    rng: Rng, size_m: Size, px_per_m: float, tone: float = 0.7, lamps: tuple[int, int] = (4, 2)
) -> FloatImage:
    """Speckled square panels, and lamps in columns and rows with a glow around them."""
    canvas = Canvas(size_m, px_per_m, tone)
    width, height = size_m
    canvas.grid(np.arange(0.0, width, 0.6), np.arange(0.0, height, 0.6), 0.018, 0.65 * tone)
    canvas.image *= 1.0 + 0.05 * layered(rng, canvas, (0.05, 0.6), fine=1.0)
    shine = np.zeros_like(canvas.image)
    columns = (np.arange(lamps[0]) + 0.5) * width / lamps[0]
    rows = (np.arange(lamps[1]) + 0.5) * height / lamps[1]
    spots = [(x, y) for x in columns for y in rows]
    for x, y in spots:
        middle = round(x * canvas.scale), round(y * canvas.scale)
        cv2.circle(shine, middle, round(0.6 * canvas.scale), 1.0, -1)
    small = cv2.resize(shine, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.05 * canvas.scale)
    canvas.image *= 0.8 + 0.35 * cv2.resize(small, canvas.shape[::-1])
    for x, y in spots:
        long, wide = min(1.2, 0.6 * width / lamps[0]), min(0.3, 0.5 * height / lamps[1])
        canvas.rectangle(x - long / 2 - 0.04, y - wide / 2 - 0.04, long + 0.08, wide + 0.08, 0.35)
        canvas.rectangle(x - long / 2, y - wide / 2, long, wide, 0.95)
    return canvas.finished()


def shadow(rng: Rng, size_m: Size, px_per_m: float) -> Shade:
    """A shadow with a soft rim: of one thing, or of several bars. It does not reach its edges."""
    canvas = Canvas(size_m, px_per_m, 1.0)
    width, height = size_m
    dark = rng.uniform(0.25, 0.6)
    if rng.random() < 0.5:
        around = np.sort(rng.uniform(0.0, 2.0 * math.pi, 9))
        reach = rng.uniform(0.25, 0.4, 9)
        ring = np.stack([reach * np.cos(around), reach * np.sin(around)], -1)
        canvas.polygon((0.5 + ring) * size_m, dark)
    else:
        for x in np.arange(0.12, 0.8, rng.uniform(0.12, 0.3)):
            canvas.rectangle(x * width, 0.12 * height, 0.07 * width, 0.76 * height, dark)
    soft = cv2.GaussianBlur(canvas.image, (0, 0), rng.uniform(0.01, 0.03) * max(canvas.shape))
    return Shade(soft, size_m)


def _recess(canvas: Canvas, box: tuple[float, float, float, float], tone: float) -> None:
    """Draw a recessed panel: dark where the edge is in shade, bright where it catches the light."""
    x, y, width, height = box
    canvas.frame(x, y, width, height, 0.014, 0.75 * tone)
    canvas.rectangle(x, y, width, 0.014, 0.5 * tone)
    canvas.rectangle(x, y + height - 0.014, width, 0.014, min(0.85, 1.3 * tone))
