"""What belongs to a building: pictures of doors, windows and so on, drawn from a seed.

The functions take and give what those of `materials` do.
"""

import cv2
import numpy as np

from dlgmd_cli.flights.places.materials import THING_PX_PER_M
from dlgmd_cli.flights.places.sheet import Rng, Sheet, Size, clouds, layered, limited
from dlgmd_cli.flights.renderer.texture import FloatImage


def door_leaf(
    rng: Rng, size_m: Size = (0.95, 2.05), px_per_m: float = 400.0, tone: float = 0.5
) -> FloatImage:
    """A door with its frame, two sunk panels and a handle."""
    sheet = Sheet(size_m, px_per_m, tone)
    width, height = size_m
    for low, high in ((0.1, 0.46), (0.54, 0.92)):
        _sunk(sheet, (0.2 * width, low * height, 0.6 * width, (high - low) * height), tone)
    sheet.frame(0.0, 0.0, width, height + 0.2, 0.07, 0.8 * tone)
    sheet.frame(0.07, 0.07, width - 0.14, height + 0.2, 0.012, 0.3 * tone)
    sheet.rectangle(0.82 * width, 0.5 * height, 0.025, 0.16, 0.6)
    sheet.rectangle(0.72 * width, 0.52 * height, 0.12, 0.022, 0.08)
    sheet.rectangle(0.72 * width, 0.52 * height, 0.12, 0.008, 0.8)
    return limited(sheet.finished() * (1.0 + 0.03 * layered(rng, sheet, (0.4, 0.08, 0.02))))


def window_pane(
    rng: Rng, size_m: Size = (1.4, 1.3), px_per_m: float = 300.0, light: float = 0.9
) -> FloatImage:
    """A bright window: blurred trees, houses and sky behind its bars, and a sill."""
    sheet = Sheet(size_m, px_per_m, light)
    width, height = size_m
    for _ in range(7):
        wide, top = rng.uniform(0.15, 0.4) * width, rng.uniform(0.4, 0.75) * height
        sheet.rectangle(rng.uniform(-0.1, 1.0) * width, top, wide, height, rng.uniform(0.25, 0.6))
    for _ in range(25):
        x, y = rng.uniform(0.0, width), rng.uniform(0.55, 0.95) * height
        sheet.disc(x, y, rng.uniform(0.03, 0.15) * width, rng.uniform(0.12, 0.4))
    sheet.image[...] = cv2.GaussianBlur(sheet.image, (0, 0), 0.025 * sheet.scale)
    sheet.image *= 1.0 + 0.03 * clouds(rng, sheet.shape, 0.1 * sheet.scale)
    bars = 2 if width < 1.7 else 3
    for x in np.linspace(0.0, width, bars + 1)[1:-1]:
        sheet.rectangle(x - 0.035, 0.0, 0.07, height, 0.55)
        sheet.rectangle(x - 0.004, 0.0, 0.008, height, 0.25)
    sheet.frame(0.0, 0.0, width, height, 0.06, 0.6)
    sheet.frame(0.06, 0.06, width - 0.12, height - 0.12, 0.012, 0.2)
    sheet.rectangle(0.0, height - 0.05, width, 0.05, 0.75)
    return sheet.finished()


def cupboard_front(
    rng: Rng, size_m: Size = (1.0, 1.9), px_per_m: float = THING_PX_PER_M, tone: float = 0.35
) -> FloatImage:
    """Two leaves of wood with a gap between them, handles, and two drawers at the bottom."""
    sheet = Sheet(size_m, px_per_m, tone)
    width, height = size_m
    bent = clouds(rng, sheet.shape, (0.04 * sheet.scale, 0.6 * sheet.scale))
    fibres = clouds(rng, sheet.shape, (max(2.5, 0.005 * sheet.scale), 0.25 * sheet.scale))
    sheet.image *= 1.0 + 0.06 * bent + 0.05 * fibres
    for x in (0.05, 0.55):
        _sunk(sheet, (x * width, 0.04 * height, 0.4 * width, 0.68 * height), tone)
        sheet.rectangle((x + 0.15) * width, 0.86 * height, 0.1 * width, 0.02, 0.07)
    for x in (0.455, 0.52):
        sheet.rectangle(x * width, 0.36 * height, 0.025 * width, 0.14, 0.07)
    sheet.rectangle(0.495 * width, 0.0, 0.008, height, 0.2 * tone)
    sheet.rectangle(0.0, 0.77 * height, width, 0.008, 0.2 * tone)
    sheet.rectangle(0.0, height - 0.06, width, 0.06, 0.3 * tone)
    sheet.frame(0.0, 0.0, width, height, 0.012, 0.6 * tone)
    return sheet.finished()


def radiator_front(
    rng: Rng, size_m: Size = (1.2, 0.55), px_per_m: float = 400.0, tone: float = 0.7
) -> FloatImage:
    """White ribs with dark between them."""
    sheet = Sheet(size_m, px_per_m, tone)
    for x in np.arange(0.04, size_m[0] - 0.04, 0.06):
        sheet.rectangle(x, 0.03, 0.014, size_m[1] - 0.06, 0.5 * tone)
        sheet.rectangle(x + 0.014, 0.03, 0.008, size_m[1] - 0.06, 0.75 * tone)
    sheet.rectangle(0.0, 0.0, size_m[0], 0.015, min(0.85, 1.2 * tone))
    return limited(sheet.finished() * (1.0 + 0.02 * clouds(rng, sheet.shape, 0.2 * sheet.scale)))


def ceiling_panels(
    rng: Rng,
    size_m: Size,
    px_per_m: float = 120.0,
    tone: float = 0.6,
    lamps: tuple[int, int] = (4, 2),
) -> FloatImage:
    """Square panels with speckles, and lamps in columns and rows, with light around them."""
    sheet = Sheet(size_m, px_per_m, tone)
    width, height = size_m
    for x in np.arange(0.0, width, 0.6):
        sheet.rectangle(x, 0.0, 0.018, height, 0.65 * tone)
    for y in np.arange(0.0, height, 0.6):
        sheet.rectangle(0.0, y, width, 0.018, 0.65 * tone)
    speckled = layered(rng, sheet, (0.05, 0.6), fine=1.0)
    sheet.image *= 1.0 + 0.05 * speckled
    shine = np.zeros_like(sheet.image)
    columns = (np.arange(lamps[0]) + 0.5) * width / lamps[0]
    rows = (np.arange(lamps[1]) + 0.5) * height / lamps[1]
    spots = [(x, y) for x in columns for y in rows]
    for x, y in spots:
        cv2.circle(
            shine,
            (round(x * sheet.scale), round(y * sheet.scale)),
            round(0.6 * sheet.scale),
            1.0,
            -1,
        )
    small = cv2.resize(shine, None, fx=0.125, fy=0.125, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), 0.05 * sheet.scale)
    sheet.image *= 0.8 + 0.35 * cv2.resize(small, sheet.shape[::-1])
    for x, y in spots:
        long, wide = min(1.2, 0.6 * width / lamps[0]), min(0.3, 0.5 * height / lamps[1])
        sheet.rectangle(x - long / 2 - 0.04, y - wide / 2 - 0.04, long + 0.08, wide + 0.08, 0.35)
        sheet.rectangle(x - long / 2, y - wide / 2, long, wide, 0.95)
    return sheet.finished()


def _sunk(sheet: Sheet, box: tuple[float, float, float, float], tone: float) -> None:
    """Draw a sunk panel: dark where the rim hides the light, bright where it catches it."""
    x, y, width, height = box
    sheet.frame(x, y, width, height, 0.014, 0.75 * tone)
    sheet.rectangle(x, y, width, 0.014, 0.5 * tone)
    sheet.rectangle(x, y + height - 0.014, width, 0.014, min(0.85, 1.3 * tone))
