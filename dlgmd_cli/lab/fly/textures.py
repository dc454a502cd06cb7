"""Procedural grey textures: each is a square that repeats without a seam."""

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
GreyImage = npt.NDArray[np.uint8]

SIDE_PX = 512

# A texture takes a generator of random numbers; returns luminance, (512, 512) float, 0 to 1.
Texture = Callable[[np.random.Generator], FloatArray]
Layer = tuple[float, ...]


def noise(rng: np.random.Generator, slope: float = 1.0, stretch: float = 1.0) -> FloatArray:
    """Noise whose amplitude falls as 1 / frequency**slope; mean 0, standard deviation 1.

    With `stretch` above 1, structures are that many times as high as wide.
    """
    rows = np.fft.fftfreq(SIDE_PX)[:, None] * stretch
    columns = np.fft.rfftfreq(SIDE_PX)[None, :]
    frequency = np.hypot(rows, columns)
    frequency[0, 0] = np.inf
    white = np.fft.rfft2(rng.standard_normal((SIDE_PX, SIDE_PX)))
    field = np.fft.irfft2(white / frequency**slope, (SIDE_PX, SIDE_PX))
    return np.asarray(field / field.std())


def _cells(
    rng: np.random.Generator, n_rows: int, n_columns: int, joint_px: int, shift: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """A random level for each cell of a grid, and a mask that is 1 on its joints.

    Every other row is shifted by a share of a cell, as in a wall of bricks.
    """
    row, column = np.mgrid[:SIDE_PX, :SIDE_PX]
    at_row = row * n_rows // SIDE_PX
    moved = (column + (at_row % 2) * shift * SIDE_PX / n_columns) % SIDE_PX
    at_column = (moved * n_columns // SIDE_PX).astype(int)
    levels = rng.standard_normal((n_rows, n_columns))[at_row, at_column]
    joint = (row * n_rows % SIDE_PX < joint_px * n_rows) | (
        moved * n_columns % SIDE_PX < joint_px * n_columns
    )
    return levels, joint.astype(float)


def _layered(image: FloatArray, rng: np.random.Generator, layers: tuple[Layer, ...]) -> FloatArray:
    """An image and layers of noise; each is an amplitude, and what `noise` takes."""
    for amplitude, *form in layers:
        image = image + amplitude * noise(rng, *form)
    return image


def _grain(mean: float, *layers: Layer) -> Texture:
    """A texture of noise about a mean; without layers, one level."""
    return lambda rng: _layered(np.full((SIDE_PX, SIDE_PX), mean), rng, layers)


def _tiled(
    grid: tuple[int, int, int, float], joint: float, mean: float, spread: float, *layers: Layer
) -> Texture:
    """A texture of cells whose levels vary about a mean; `grid` is what `_cells` takes."""

    def texture(rng: np.random.Generator) -> FloatArray:
        levels, joints = _cells(rng, *grid)
        return np.where(joints > 0, joint, _layered(mean + spread * levels, rng, layers))

    return texture


def wallpaper(rng: np.random.Generator) -> FloatArray:
    """Vertical stripes with a pattern of dots."""
    row, column = np.mgrid[:SIDE_PX, :SIDE_PX] / SIDE_PX
    n = int(rng.integers(6, 12))
    stripes = np.sign(np.sin(2 * np.pi * n * column))
    dots = np.cos(2 * np.pi * 2 * n * column) * np.cos(2 * np.pi * 2 * n * row) > 0.7
    return 0.66 + 0.07 * stripes + 0.14 * dots + 0.03 * noise(rng, 0.8)


def concrete(rng: np.random.Generator) -> FloatArray:
    """Stains of all sizes, joints of the formwork."""
    _, joint = _cells(rng, 2, 1, 3)
    return 0.6 + 0.09 * noise(rng, 1.1) - 0.2 * joint


def parquet(rng: np.random.Generator) -> FloatArray:
    """Planks with a grain along them."""
    levels, joint = _cells(rng, 2, 10, 2, 0.5)
    return 0.52 + 0.06 * levels + 0.05 * noise(rng, 0.9, 0.06) - 0.2 * joint


def leaves(rng: np.random.Generator) -> FloatArray:
    """Leaves in light and shade."""
    return 0.38 + 0.16 * np.tanh(1.5 * noise(rng, 0.8)) + 0.06 * noise(rng, 0.2)


def cloth(rng: np.random.Generator) -> FloatArray:
    """Folds, and a weave."""
    row, column = np.mgrid[:SIDE_PX, :SIDE_PX]
    weave = np.sin(row * np.pi / 8) * np.sin(column * np.pi / 8)
    return 0.55 + 0.1 * noise(rng, 1.3, 0.4) + 0.04 * weave


def cardboard(rng: np.random.Generator) -> FloatArray:
    """The side of a carton: tape, a printed label, and a few signs."""
    image = 0.62 + 0.02 * noise(rng, 0.6) + 0.015 * noise(rng, 0.8, 0.05)
    image[:, 225:287] += 0.12
    x, y = (int(corner) for corner in rng.integers(40, 300, 2))
    cv2.rectangle(image, (x, y), (x + 150, y + 100), 0.9, cv2.FILLED)
    for row in range(y + 14, y + 98, 14):
        cv2.line(image, (x + 10, row), (x + int(rng.integers(60, 140)), row), 0.25, 4)
    cv2.arrowedLine(image, (440, 470), (440, 360), 0.3, 10)
    cv2.rectangle(image, (0, 0), (SIDE_PX - 1, SIDE_PX - 1), 0.45, 6)
    return image


def books(rng: np.random.Generator) -> FloatArray:
    """Rows of the backs of books on boards."""
    image = np.full((SIDE_PX, SIDE_PX), 0.12)
    for shelf in range(4):
        bottom, left = (shelf + 1) * 128 - 10, 0
        while left < SIDE_PX - 8:
            width, height = int(rng.integers(10, 30)), int(rng.integers(70, 112))
            right = min(left + width, SIDE_PX)
            image[bottom - height : bottom, left : right - 1] = rng.uniform(0.2, 0.9)
            band = bottom - int(rng.integers(20, height - 8))
            image[band - 8 : band, left : right - 1] = rng.uniform(0.2, 0.9)
            left = right
        image[bottom : bottom + 10] = 0.6
    return image


def screen(rng: np.random.Generator) -> FloatArray:
    """The screen of a computer: windows with lines of text."""
    image = 0.35 + 0.05 * noise(rng, 1.6)
    for _ in range(4):
        (x, y), (w, h) = rng.integers(10, 260, 2), rng.integers(120, 240, 2)
        image[y : y + h, x : x + w] = rng.uniform(0.75, 0.95)
        image[y : y + 16, x : x + w] = 0.25
        for line in range(y + 28, y + h - 8, 14):
            image[line : line + 4, x + 8 : x + 8 + int(rng.integers(40, max(w - 8, 41)))] = 0.3
    image[:12] = image[-12:] = image[:, :12] = image[:, -12:] = 0.05
    return image


def poster(rng: np.random.Generator) -> FloatArray:
    """A printed picture: shapes of all shades in a light frame."""
    image = 0.5 + 0.12 * noise(rng, 1.6)
    for _ in range(14):
        x, y = (int(v) for v in rng.integers(0, SIDE_PX, 2))
        shade, size = rng.uniform(0.05, 0.95), int(rng.integers(15, 90))
        if rng.random() < 0.5:
            cv2.circle(image, (x, y), size, shade, cv2.FILLED)
        else:
            cv2.rectangle(image, (x, y), (x + size, y + 2 * size), shade, cv2.FILLED)
    cv2.rectangle(image, (0, 0), (SIDE_PX - 1, SIDE_PX - 1), 0.95, 40)
    return image


def facade(rng: np.random.Generator) -> FloatArray:
    """Storeys of windows in a plastered wall."""
    image = 0.62 + 0.05 * noise(rng, 1.1) + 0.03 * noise(rng, 0.3)
    for row in range(4):
        for column in range(4):
            y, x = row * 128 + 28, column * 128 + 34
            image[y - 5 : y + 83, x - 5 : x + 65] = 0.85
            image[y : y + 78, x : x + 60] = rng.uniform(0.1, 0.4)
            image[y : y + 78, x + 28 : x + 32] = image[y + 36 : y + 40, x : x + 60] = 0.8
        image[row * 128 : row * 128 + 6] = 0.5
    return image


def patches(rng: np.random.Generator) -> FloatArray:
    """Patches of two shades, as on a ball."""
    return np.where(noise(rng, 1.6) > 0, 0.85, 0.25) + 0.03 * noise(rng, 0.4)


# Name -> texture, and the width in m that one square covers on floors, walls and boards.
TEXTURES: dict[str, tuple[Texture, float]] = {
    "plain": (_grain(0.85), 1.0),  # a pure colour
    "plaster": (_grain(0.78, (0.045, 1.3), (0.025, 0.4)), 2.4),  # faint stains and grain
    "wallpaper": (wallpaper, 1.6),
    "concrete": (concrete, 2.5),
    "bricks": (_tiled((12, 4, 5, 0.5), 0.72, 0.45, 0.07, (0.05, 0.7)), 1.1),  # light joints
    "tiles": (_tiled((4, 4, 4, 0.0), 0.35, 0.66, 0.06, (0.02,)), 1.6),  # square, of two shades
    "parquet": (parquet, 1.6),
    "wood": (_grain(0.6, (0.07, 1.0, 0.1)), 1.5),  # a grain, as of furniture
    "carpet": (_grain(0.45, (0.07, 0.2), (0.05, 1.2)), 1.8),  # short threads and worn places
    "grass": (_grain(0.42, (0.1, 0.5), (0.06, 1.4)), 2.6),  # blades, tufts and bare patches
    "asphalt": (_grain(0.4, (0.06, 0.3), (0.04, 1.5)), 3.0),  # grit, and patches of another age
    "paving": (
        _tiled((6, 6, 5, 0.5), 0.25, 0.58, 0.05, (0.05, 0.8)),
        2.4,
    ),  # dark joints
    "leaves": (leaves, 1.4),
    "bark": (_grain(0.36, (0.12, 0.8, 0.2)), 1.0),  # upright ridges
    "cloth": (cloth, 1.0),
    "cardboard": (cardboard, 1.0),
    "books": (books, 1.3),
    "grid": (_tiled((8, 8, 14, 0.0), 0.08, 0.92, 0.0), 1.0),  # dark lines on white
    "screen": (screen, 1.0),
    "keys": (_tiled((7, 14, 7, 0.0), 0.5, 0.15, 0.0), 1.0),  # a keyboard
    "poster": (poster, 1.0),
    "facade": (facade, 12.0),
    "patches": (patches, 1.0),
}


def drawn(name: str, rng: np.random.Generator) -> GreyImage:
    """A texture by its name, (512, 512) uint8."""
    image = np.clip(TEXTURES[name][0](rng), 0.0, 1.0)
    return np.asarray(np.rint(image * 255.0), np.uint8)


@dataclass(frozen=True)
class Look:
    """What a surface looks like: a texture of `TEXTURES`, and the share of light it reflects.

    On a board, the texture repeats in its own size, or covers the board `once`.
    """

    texture: str
    shade: float = 1.0
    once: bool = False
