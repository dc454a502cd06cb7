"""What walls, floors and furniture are made of: pictures of surfaces, drawn from a seed.

Every function takes the generator, the size of the surface (width and height, in m) and a
resolution, and gives reflectance, (h, w) float32 in 0..1, linear in light. `tone` is about its
mean.
"""

import cv2
import numpy as np

from dlgmd_cli.flights.places.sheet import Rng, Sheet, Size, clouds, grain, layered, limited
from dlgmd_cli.flights.renderer.texture import FloatImage

WALL_PX_PER_M = 250.0
THING_PX_PER_M = 500.0


def plain(tone: float) -> FloatImage:
    """One colour, as a single pixel."""
    return np.full((1, 1), tone, np.float32)


def plaster(
    rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.6, rough: float = 0.045
) -> FloatImage:
    """Painted plaster, uneven by `rough`, with stains and a few scratches."""
    sheet = Sheet(size_m, px_per_m, tone)
    width, height = size_m
    for _ in range(int(1.5 * width)):
        x, y = rng.uniform(0.0, width), height * rng.beta(3.0, 1.5)
        ends = rng.normal((x, y), 0.12, (2, 2))
        sheet.line(np.array([(x, y), *ends]), 0.008, tone * rng.uniform(0.75, 0.92))
    stained = np.maximum(clouds(rng, sheet.shape, 0.7 * sheet.scale) - 1.0, 0.0)
    uneven = layered(rng, sheet, (1.2, 0.3, 0.08, 0.03), fine=0.8)
    return limited(sheet.finished(1.2) * (1.0 + rough * uneven - 0.06 * stained))


def wallpaper(
    rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.55
) -> FloatImage:
    """Stripes and a small figure, over and over."""
    sheet = Sheet(size_m, px_per_m, tone)
    pitch = rng.uniform(0.2, 0.3)
    part = Sheet((pitch, 1.4 * pitch), sheet.scale, tone)
    part.rectangle(0.0, 0.0, 0.18 * pitch, 1.4 * pitch, 0.8 * tone)
    part.rectangle(0.22 * pitch, 0.0, 0.03 * pitch, 1.4 * pitch, 0.65 * tone)
    petals = rng.integers(4, 8)
    for y, radius in ((0.4, 0.2), (1.05, 0.11)):
        for turn in np.arange(petals) * 2.0 * np.pi / petals:
            petal_x, petal_y = 0.62 + 0.6 * radius * np.cos(turn), y + 0.6 * radius * np.sin(turn)
            part.disc(petal_x * pitch, petal_y * pitch, 0.42 * radius * pitch, 0.6 * tone)
        part.disc(0.62 * pitch, y * pitch, 0.3 * radius * pitch, min(0.85, 1.4 * tone))
    times = tuple(-(-full // of) for full, of in zip(sheet.shape, part.shape, strict=True))
    sheet.image = np.tile(part.image, times)[: sheet.shape[0], : sheet.shape[1]]
    return limited(sheet.finished(0.9) * (1.0 + 0.03 * layered(rng, sheet, (1.0, 0.2))))


def brick(rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.3) -> FloatImage:
    """A brick wall; its joints are brighter than the bricks."""
    sheet = Sheet(size_m, px_per_m, min(0.8, 1.7 * tone))
    long, high, joint = 0.25, 0.08, 0.012
    for row, y in enumerate(np.arange(0.0, size_m[1], high)):
        for x in np.arange(-0.5 * long * (row % 2), size_m[0], long):
            of_brick = tone * rng.uniform(0.7, 1.3)
            sheet.rectangle(x, y, long - joint, high - joint, of_brick)
    return limited(sheet.finished(0.8) * (1.0 + 0.09 * layered(rng, sheet, (1.0, 0.1, 0.03))))


def concrete(
    rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.4
) -> FloatImage:
    """Bare concrete with the joints and holes of its moulds."""
    sheet = Sheet(size_m, px_per_m, tone)
    for x in np.arange(1.25, size_m[0], 1.25):
        sheet.rectangle(x, 0.0, 0.012, size_m[1], 0.7 * tone)
    for y in np.arange(1.25, size_m[1], 1.25):
        sheet.rectangle(0.0, y, size_m[0], 0.012, 0.7 * tone)
    for x in np.arange(0.3, size_m[0], 0.65):
        for y in np.arange(0.3, size_m[1], 0.65):
            sheet.disc(x, y, 0.015, 0.4 * tone)
    return limited(
        sheet.finished(0.8) * (1.0 + 0.13 * layered(rng, sheet, (0.9, 0.25, 0.07, 0.02)))
    )


def wood(rng: Rng, size_m: Size, px_per_m: float = THING_PX_PER_M, tone: float = 0.3) -> FloatImage:
    """Wood whose fibres run along the height."""
    sheet = Sheet(size_m, px_per_m, tone)
    bent = clouds(rng, sheet.shape, (0.09 * sheet.scale, 0.7 * sheet.scale))
    x = np.arange(sheet.shape[1], dtype=np.float32) / sheet.scale
    rings = np.sin(2.0 * np.pi * (x / 0.025 + 0.7 * bent))
    fibres = clouds(rng, sheet.shape, (max(2.5, 0.004 * sheet.scale), 0.25 * sheet.scale))
    return limited(tone * (1.0 + 0.09 * rings + 0.08 * fibres + 0.08 * bent))


def parquet(
    rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.2
) -> FloatImage:
    """A floor of planks that run along the width."""
    sheet = Sheet(size_m, px_per_m, tone)
    long, high = rng.uniform(0.9, 1.4), rng.uniform(0.1, 0.16)
    for y in np.arange(0.0, size_m[1], high):
        for x in np.arange(-long * rng.uniform(), size_m[0], long):
            sheet.rectangle(x, y, long, high, tone * rng.normal(1.0, 0.14))
            sheet.rectangle(x, y, 0.007, high, 0.45 * tone)
        sheet.rectangle(0.0, y, size_m[0], 0.006, 0.5 * tone)
    fibres = clouds(rng, sheet.shape, (0.25 * sheet.scale, 0.015 * sheet.scale))
    return limited(sheet.finished() * (1.0 + 0.12 * fibres + 0.03 * grain(rng, sheet.shape)))


def tiles(
    rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.35, side_m: float = 0.3
) -> FloatImage:
    """Square tiles with dark joints."""
    sheet = Sheet(size_m, px_per_m, tone)
    for y in np.arange(0.0, size_m[1], side_m):
        for x in np.arange(0.0, size_m[0], side_m):
            sheet.rectangle(x, y, side_m, side_m, tone * rng.normal(1.0, 0.06))
        sheet.rectangle(0.0, y, size_m[0], 0.008, 0.5 * tone)
    for x in np.arange(0.0, size_m[0], side_m):
        sheet.rectangle(x, 0.0, 0.008, size_m[1], 0.5 * tone)
    return limited(sheet.finished() * (1.0 + 0.065 * layered(rng, sheet, (0.5, 0.12, 0.04))))


def carpet(
    rng: Rng, size_m: Size, px_per_m: float = WALL_PX_PER_M, tone: float = 0.15
) -> FloatImage:
    """Short pile, trodden, with the joints of its squares."""
    sheet = Sheet(size_m, px_per_m, tone)
    for column, x in enumerate(np.arange(0.0, size_m[0], 0.5)):
        for row, y in enumerate(np.arange(0.0, size_m[1], 0.5)):
            sheet.rectangle(x, y, 0.5, 0.5, tone * (1.12 - 0.18 * ((row + column) % 2)))
    pile = layered(rng, sheet, (1.5, 0.3, 0.06, 0.025), fine=1.2)
    return limited(sheet.finished(1.0) * (1.0 + 0.16 * pile))


def cloth(
    rng: Rng, size_m: Size, px_per_m: float = THING_PX_PER_M, tone: float = 0.3
) -> FloatImage:
    """Woven cloth with slight creases."""
    sheet = Sheet(size_m, px_per_m, tone)
    weave = clouds(rng, sheet.shape, (3.0, 14.0)) + clouds(rng, sheet.shape, (14.0, 3.0))
    creased = layered(rng, sheet, (0.4, 0.1), fine=0.2)
    return limited(tone * (1.0 + 0.08 * weave + 0.08 * creased))


def metal(
    rng: Rng, size_m: Size, px_per_m: float = THING_PX_PER_M, tone: float = 0.4
) -> FloatImage:
    """Brushed across the width."""
    sheet = Sheet(size_m, px_per_m, tone)
    brushed = clouds(rng, sheet.shape, (0.3 * sheet.scale, 3.0))
    return limited(
        tone * (1.0 + 0.05 * brushed + 0.04 * clouds(rng, sheet.shape, 0.3 * sheet.scale))
    )


def leaves(
    rng: Rng, size_m: Size, px_per_m: float = THING_PX_PER_M, tone: float = 0.1
) -> FloatImage:
    """A dense plant: leaves over leaves, each with its rib."""
    sheet = Sheet(size_m, px_per_m, 0.35 * tone)
    long = 0.16
    for _ in range(int(700 * size_m[0] * size_m[1]) + 20):
        at, turn = rng.uniform(0.0, size_m), rng.normal(-0.5 * np.pi, 0.9)
        axis = np.array([np.cos(turn), np.sin(turn)]) * long * rng.uniform(0.6, 1.2)
        side = np.array([-axis[1], axis[0]]) * 0.16
        of_leaf = tone * rng.uniform(0.5, 1.9)
        rim = [at, at + 0.35 * axis + side, at + axis, at + 0.35 * axis - side]
        sheet.polygon(rim, of_leaf)
        sheet.line([at, at + 0.9 * axis], 0.003, 1.3 * of_leaf)
    return sheet.finished()


def curtain(
    rng: Rng, size_m: Size, px_per_m: float = THING_PX_PER_M, tone: float = 0.5
) -> FloatImage:
    """Cloth in upright folds."""
    sheet = Sheet(size_m, px_per_m, tone)
    width = np.arange(sheet.shape[1], dtype=np.float32) / sheet.scale
    bent = clouds(rng, sheet.shape, (0.15 * sheet.scale, 0.8 * sheet.scale))
    folds = np.sin(2.0 * np.pi * width / 0.13 + 1.5 * bent)
    shaded = cv2.GaussianBlur(folds.astype(np.float32), (0, 0), 1.5)
    return limited(tone * (0.8 + 0.28 * shaded + 0.03 * grain(rng, sheet.shape)))
