"""Layers as colours: one scale for many pictures, and cells that stay visible when made small."""

from dataclasses import dataclass

import cv2
import matplotlib
import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]
BgrImage = npt.NDArray[np.uint8]

# From black through red to yellow: its brightness grows with the value, also on grey paper.
_UNSIGNED = "inferno"
# Blue below zero, red above it, white between: told apart by all common kinds of colour vision.
_SIGNED = "RdBu_r"


@dataclass(frozen=True)
class Scale:
    """The values at the two ends of a colour map.

    Attributes
    ----------
    low, high : float
        0 and the greatest value, or, where values have signs, the greatest magnitude both ways.
        Both 0 where nothing differs from 0.
    colours : str
        Matplotlib's name of the colour map.
    """

    low: float
    high: float
    colours: str

    @classmethod
    def over(cls, lowest: float, highest: float) -> "Scale | None":
        """The scale that holds both values; None if there are none, that is for inf and -inf."""
        if not lowest <= highest:
            return None
        if lowest < 0.0:
            bound = max(-lowest, highest)
            return cls(-bound, bound, _SIGNED)
        return cls(0.0, highest, _UNSIGNED)

    @classmethod
    def of(cls, layers: FloatImage) -> "Scale | None":
        """The scale of all that is not NaN in `layers`."""
        defined = layers[~np.isnan(layers)]
        return cls.over(float(defined.min()), float(defined.max())) if defined.size else None

    @property
    def is_flat(self) -> bool:
        """Whether all values are 0."""
        return self.high == self.low

    @property
    def limits(self) -> tuple[float, float]:
        """`low` and `high`, apart even where all values are 0."""
        return (self.low, 1.0) if self.is_flat else (self.low, self.high)

    def painted(self, layer: FloatImage) -> BgrImage:
        """`layer` in colour, shape (H, W, 3); 256 steps."""
        low, high = self.limits
        steps = 255.0 / (high - low)
        # Never below 0, so that the absolute value that OpenCV takes changes nothing.
        index = cv2.convertScaleAbs(layer, alpha=steps, beta=-low * steps)
        rgba = matplotlib.colormaps[self.colours](np.arange(256), bytes=True)
        table = np.ascontiguousarray(rgba[:, None, 2::-1])
        return np.asarray(cv2.applyColorMap(index, table), dtype=np.uint8)


INPUT_SCALE = Scale(0.0, 1.0, "gray")


def strongest(layer: FloatImage, height: int, width: int) -> FloatImage:
    """`layer` at no more than `height` x `width`, each value the strongest of those it replaces.

    A single active cell among silent ones thus stays visible in a picture with fewer pixels than
    the layer has cells. Averaging would fade it, taking every n-th cell would lose it.

    Parameters
    ----------
    layer : ndarray, shape (H, W), float32
        Without NaN.
    height, width : int
        A side that is shorter than this is left as it is.

    Returns
    -------
    ndarray, shape (min(H, height), min(W, width)), float32
        Where values have signs, the strongest is that of greatest magnitude.
    """
    if layer.shape[0] <= height and layer.shape[1] <= width:
        return layer
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
