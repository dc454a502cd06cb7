"""Random pictures of things in rooms: prints, furniture fronts, doors, windows.

The functions have the same arguments and results as the materials in `textures`.
"""

import cv2
import numpy as np

from dlgmd_cli.lab.flights.renderer.texture import FloatImage
from dlgmd_cli.lab.flights.textures import Canvas, Rng, Size, layered, reflectance, smooth_noise


def gridded(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """A grid of black lines on white: nine vertical ones, and horizontal ones at equal spacing."""
    canvas = Canvas(size_m, px_per_m, 0.82)
    width, height = size_m
    n_lines, line = 9, 0.02
    n_level = max(2, round((height - line) / (width - line) * (n_lines - 1)) + 1)
    for x in np.linspace(0.0, width - line, n_lines):
        canvas.rectangle(x, 0.0, line, height, 0.04)
    for y in np.linspace(0.0, height - line, n_level):
        canvas.rectangle(0.0, y, width, line, 0.04)
    return canvas.finished()


def poster(rng: Rng, size_m: Size, px_per_m: float) -> FloatImage:
    """An abstract picture with some lines like writing, on paper with a frame."""
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
    for x in np.arange(0.0, width, 0.6):
        canvas.rectangle(x, 0.0, 0.018, height, 0.65 * tone)
    for y in np.arange(0.0, height, 0.6):
        canvas.rectangle(0.0, y, width, 0.018, 0.65 * tone)
    speckled = layered(rng, canvas, (0.05, 0.6), fine=1.0)
    canvas.image *= 1.0 + 0.05 * speckled
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


def _recess(canvas: Canvas, box: tuple[float, float, float, float], tone: float) -> None:
    """Draw a recessed panel: dark where the edge is in shade, bright where it catches the light."""
    x, y, width, height = box
    canvas.frame(x, y, width, height, 0.014, 0.75 * tone)
    canvas.rectangle(x, y, width, 0.014, 0.5 * tone)
    canvas.rectangle(x, y + height - 0.014, width, 0.014, min(0.85, 1.3 * tone))
