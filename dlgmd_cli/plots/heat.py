"""Layers as colours: scales, reduction that keeps single cells, tinted cells on the input."""

import math
from dataclasses import dataclass
from typing import Any

import cv2
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize
from matplotlib.figure import FigureBase

from dlgmd_cli.frame import BgrImage, FloatImage
from dlgmd_cli.results.result import Result

# From black through red to yellow. Its brightness grows with the value, so it survives grey print.
_UNSIGNED = "inferno"
# Blue below zero, white at zero, red above; safe for all common kinds of colour blindness.
_SIGNED = "RdBu_r"

# The tint of active cells: magenta is used for nothing else, and is rare in scenes.
TINT = "#E5008C"
# Colours in BGR order: magenta tint, orange spikes, blue MP, vermilion alarms.
_TINT, _SPIKE, _MP, _ALARM = (0x8C, 0, 0xE5), (0, 0x9F, 0xE6), (0xB2, 0x72, 0), (0, 0x5E, 0xD5)
_WHITE, _BLACK = (255, 255, 255), (0, 0, 0)
# Opacity (0..1) of the weakest active cell, and the additional opacity of the strongest cell.
_LEAST, _MORE = 0.45, 0.4
# Height of the banner as a share of the image's height; height of letters as a share of the image's
# shorter side; height in px of OpenCV's letters at scale 1.
_BANNER, _LETTER, _LETTER_PX = 0.09, 0.045, 22
# Top and bottom of the bar of MP as shares of the image's height.
_BAR = 0.16, 0.76
# Radius of the ring around the centroid, as a share of the image's height.
_RING = 0.035


@dataclass(frozen=True)
class Scale:
    """The name of a colour map, and the values at its ends.

    The ends are 0 and the greatest value, or, if there are negative values, minus and plus the
    greatest magnitude. Both ends are 0 if all values are 0.
    """

    low: float
    high: float
    colours: str

    @classmethod
    def over(cls, lowest: float, highest: float) -> "Scale":
        """The scale for values from `lowest` to `highest`."""
        if lowest < 0.0:
            bound = max(-lowest, highest)
            return cls(-bound, bound, _SIGNED)
        return cls(0.0, highest, _UNSIGNED)

    @classmethod
    def of(cls, layers: FloatImage) -> "Scale | None":
        """The scale for all values of `layers` that are not NaN; None if all are NaN."""
        defined = layers[~np.isnan(layers)]
        return cls.over(float(defined.min()), float(defined.max())) if defined.size else None

    @property
    def is_flat(self) -> bool:
        """Whether all values are 0."""
        return self.high == self.low

    @property
    def limits(self) -> tuple[float, float]:
        """`low` and `high`; (0, 1) if all values are 0."""
        return (self.low, 1.0) if self.is_flat else (self.low, self.high)

    def painted(self, layer: FloatImage) -> BgrImage:
        """`layer` in colour, shape (H, W, 3); 256 steps."""
        low, high = self.limits
        steps = 255.0 / (high - low)
        # OpenCV takes the absolute value: no change, since no index is below 0.
        index = cv2.convertScaleAbs(layer, alpha=steps, beta=-low * steps)
        rgba = matplotlib.colormaps[self.colours](np.arange(256), bytes=True)
        table = np.ascontiguousarray(rgba[:, None, 2::-1])
        return np.asarray(cv2.applyColorMap(index, table), dtype=np.uint8)


INPUT_SCALE = Scale(0.0, 1.0, "gray")


def add_bar(
    figure: FigureBase, axes: Axes, scale: Scale | None, unit: str, **options: Any
) -> Colorbar:
    """Add the colour bar of a panel; if all values are 0, the bar's place stays empty."""
    known = scale or INPUT_SCALE
    colours = ScalarMappable(Normalize(*known.limits), known.colours)
    bar = figure.colorbar(colours, ax=axes, **options)
    bar.set_label(unit, parse_math=False)
    bar.ax.set_visible(scale is not None and not scale.is_flat)
    return bar


def strongest(layer: FloatImage, height: int, width: int) -> FloatImage:
    """Reduce `layer`, (H, W), to at most `height` x `width` by the strongest value of each area.

    The strongest value has the greatest magnitude. A single active cell among silent cells thus
    stays visible in an image with fewer pixels than the layer has cells.
    """
    highest = _reduced(np.maximum, layer, height, width)
    if float(layer.min()) >= 0.0:
        return highest
    lowest = _reduced(np.minimum, layer, height, width)
    return np.where(-lowest > highest, lowest, highest)


def _reduced(pool: np.ufunc, layer: FloatImage, height: int, width: int) -> FloatImage:
    """`layer` pooled along both axes."""
    for axis, size in enumerate((height, width)):
        n_cells = layer.shape[axis]
        if n_cells > size:
            layer = pool.reduceat(layer, np.arange(size) * n_cells // size, axis=axis)
    return layer


def tinted(image: BgrImage, g: FloatImage | None, greatest: float) -> BgrImage:
    """Tint the active cells of G in an image, (H, W, 3) BGR.

    `g` may have any size; it is None where undefined. `greatest` is the greatest magnitude of G
    over all frames.
    """
    if g is None or not g.any():
        return image
    height, width = image.shape[:2]
    g = strongest(g, height, width)
    strength = np.abs(g) / np.float32(greatest)
    opacity = np.where(g != 0.0, _LEAST + _MORE * np.minimum(strength, 1.0), 0.0)
    cells = cv2.resize(opacity, (width, height), interpolation=cv2.INTER_NEAREST)[:, :, None]
    return np.rint(image * (1.0 - cells) + np.array(_TINT, np.float32) * cells).astype(np.uint8)


def mark_centroid(picture: BgrImage, g_x: float, g_y: float) -> None:
    """Draw a ring around the centroid of G, -1 to 1, into an image, (H, W, 3) BGR.

    If no cell is active, the centroid is NaN and nothing is drawn.
    """
    if math.isnan(g_x) or math.isnan(g_y):
        return
    height, width = picture.shape[:2]
    at = round((g_x + 1.0) / 2.0 * width - 0.5), round((g_y + 1.0) / 2.0 * height - 0.5)
    _ring(picture, at, max(3, round(_RING * height)))


def _ring(picture: BgrImage, at: tuple[int, int], radius: int) -> None:
    for colour, extra in ((_BLACK, 2), (_WHITE, 0)):
        cv2.circle(picture, at, radius, colour, max(1, radius // 6) + extra, cv2.LINE_AA)


class Overlay:
    """Draws the images of a film of the input at full size, with the MP as a bar.

    `shape` is (H, W) of the input in px; the film's size is rounded up to even numbers. `greatest`
    is the greatest magnitude of G over all frames.
    """

    def __init__(self, result: Result, shape: tuple[int, int], greatest: float) -> None:
        self._result, self._greatest, self._alarmed = result, greatest or 1.0, result.alarmed
        height, width = shape
        self.shape = height + height % 2, width + width % 2
        self._letter_px = max(1, round(_LETTER * min(self.shape)))
        scale = self._letter_px / _LETTER_PX
        self._scale, self._thickness = scale, max(1, round(1.5 * scale))

    def picture(self, row: int, image: BgrImage, g: FloatImage | None) -> BgrImage:
        """The image of one row of the result, (H, W, 3) BGR.

        `image` is the input, (H, W, 3) BGR, and `g` the layer, of any size, None where undefined.
        """
        height, width = self.shape
        down, right = height - image.shape[0], width - image.shape[1]
        border = cv2.BORDER_REPLICATE
        picture = np.asarray(cv2.copyMakeBorder(image, 0, down, 0, right, border), np.uint8)
        picture[: image.shape[0], : image.shape[1]] = tinted(image, g, self._greatest)
        result, margin = self._result, round(0.02 * height)
        mark_centroid(picture[: image.shape[0], : image.shape[1]], result.g_x[row], result.g_y[row])
        if self._alarmed[row]:
            band = round(_BANNER * height)
            cv2.rectangle(picture, (0, 0), (width, band), _ALARM, cv2.FILLED)
            place = None, (band + self._letter_px) // 2
            self._write(picture, f"ALARM ({result.rule.name})", place, _ALARM)
        text = f"frame {result.frame[row]}  {result.time_s[row]:.3f} s"
        self._write(picture, text, (margin, height - margin), _BLACK)
        self._name_marks(picture, (margin, height - margin - 2 * self._letter_px))
        self._draw_bar(picture, row, margin)
        return picture

    def _name_marks(self, picture: BgrImage, place: tuple[int, int]) -> None:
        """Write the legend of tint and ring, from `place` to the right."""
        (x, y), size = place, self._letter_px
        cv2.rectangle(picture, (x, y - size), (x + size, y), _BLACK, 3)
        cv2.rectangle(picture, (x, y - size), (x + size, y), _TINT, cv2.FILLED)
        x = self._write(picture, "active cells", (x + round(1.5 * size), y), _BLACK)
        _ring(picture, (x + 2 * size, y - size // 2), max(2, size // 2))
        self._write(picture, "their centroid", (x + 3 * size, y), _BLACK)

    def _draw_bar(self, picture: BgrImage, row: int, margin: int) -> None:
        """Draw the normalised MP as a bar on the right, with a tick at the threshold."""
        result, size, (height, width) = self._result, self._letter_px, self.shape
        top, bottom = (round(share * height) for share in _BAR)
        name_px = self._width_px("MP")
        right = width - margin - name_px // 2 + size // 2
        left = right - size

        def y(level: float) -> int:
            return round(bottom - min(max(level, 0.0), 1.0) * (bottom - top))

        cv2.rectangle(picture, (left - 2, top - 2), (right + 2, bottom + 2), _BLACK, cv2.FILLED)
        cv2.rectangle(picture, (left, top), (right, bottom), _WHITE, cv2.FILLED)
        if not math.isnan(level := float(result.level[row])):
            colour = _SPIKE if result.spikes[row] else _MP
            cv2.rectangle(picture, (left, y(level)), (right, bottom), colour, cv2.FILLED)
        tick, thick = y(result.threshold), max(1, size // 10)
        cv2.line(picture, (left - size // 2, tick), (right, tick), _BLACK, thick + 2)
        cv2.line(picture, (left - size // 2, tick), (right, tick), _WHITE, thick)
        self._write(picture, "MP", (width - margin - name_px, bottom + round(1.6 * size)), _BLACK)

    def _write(
        self, picture: BgrImage, text: str, place: tuple[int | None, int], rim: tuple[int, int, int]
    ) -> int:
        """Write white letters with a rim; returns where they end.

        They start at `place`, or are centred if it has no x.
        """
        (x, y), width = place, self._width_px(text)
        if x is None:
            x = (picture.shape[1] - width) // 2
        # The rim is the same text moved aside: thicker letters could be wider.
        thickness, font = self._thickness, cv2.FONT_HERSHEY_SIMPLEX
        aside = (-thickness, 0, thickness)
        places = [(x + dx, y + dy, rim) for dx in aside for dy in aside]
        for left, bottom, color in [*places, (x, y, _WHITE)]:
            cv2.putText(
                picture, text, (left, bottom), font, self._scale, color, thickness, cv2.LINE_AA
            )
        return x + width

    def _width_px(self, text: str) -> int:
        """Width of a text in px."""
        (width, _), _ = cv2.getTextSize(
            text, cv2.FONT_HERSHEY_SIMPLEX, self._scale, self._thickness
        )
        return width
