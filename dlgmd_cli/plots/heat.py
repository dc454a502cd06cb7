"""Layers as colours: scales shared by many images, and a reduction that keeps single cells."""

from dataclasses import dataclass
from typing import Any

import cv2
import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize

from dlgmd_cli.frame import BgrImage as BgrImage
from dlgmd_cli.frame import FloatImage as FloatImage

# From black through red to yellow. Its brightness grows with the value, so it survives grey print.
_UNSIGNED = "inferno"
# Blue below zero, white at zero, red above; safe for all common kinds of colour blindness.
_SIGNED = "RdBu_r"


@dataclass(frozen=True)
class Scale:
    """The name of a colour map, and the values at its ends.

    The ends are 0 and the greatest value. If there are negative values, they are minus and plus the
    greatest magnitude. Both are 0 if all values are 0.
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
        """The scale for all values of `layers` that are not NaN; None if all are."""
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
        # OpenCV takes the absolute value, which changes nothing: no index is below 0.
        index = cv2.convertScaleAbs(layer, alpha=steps, beta=-low * steps)
        rgba = matplotlib.colormaps[self.colours](np.arange(256), bytes=True)
        table = np.ascontiguousarray(rgba[:, None, 2::-1])
        return np.asarray(cv2.applyColorMap(index, table), dtype=np.uint8)


INPUT_SCALE = Scale(0.0, 1.0, "gray")


def add_bar(figure: Any, axes: Axes, scale: Scale | None, unit: str, **look: Any) -> Colorbar:
    """Add the colour bar of a panel; if all values are 0, its place stays empty."""
    known = scale or INPUT_SCALE
    colours = ScalarMappable(Normalize(*known.limits), known.colours)
    bar: Colorbar = figure.colorbar(colours, ax=axes, **look)
    bar.set_label(unit, parse_math=False)
    bar.ax.set_visible(scale is not None and not scale.is_flat)
    return bar


def strongest(layer: FloatImage, height: int, width: int) -> FloatImage:
    """Reduce `layer`, (H, W), to at most `height` x `width` by the strongest value of each area.

    The strongest value is that of greatest magnitude. A single active cell among silent ones thus
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
            starts = np.arange(size) * n_cells // size
            layer = pool.reduceat(layer, starts, axis=axis)
    return layer
