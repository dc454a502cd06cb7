"""The colours of a heat map, and the patterns of cells that have none."""

import math
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.style import GREY
from dlgmd_cli.results.tables import Flags, Series

# Blue below zero, red above it, nearly white between: told apart by all kinds of colour vision.
_SIGNED, _UNSIGNED = "RdBu_r", "viridis"
# From this ratio of the greatest to the least value on, colours follow its logarithm.
_WIDE = 100.0


class Look(NamedTuple):
    """How cells without a colour are drawn."""

    color: str
    hatch: str

    @property
    def style(self) -> dict[str, Any]:
        """What Matplotlib draws it with."""
        return {"facecolor": self.color, "edgecolor": GREY, "hatch": self.hatch, "linewidth": 0.0}


UNDEFINED, IMPOSSIBLE = Look("#CCCCCC", ""), Look("white", "////////")
MINUS_INFINITE, INFINITE = Look("white", "....."), Look("white", "++++")


def looks_of(values: Series, is_possible: Flags) -> dict[Look, Flags]:
    """Which cells have no colour, by how they look."""
    kinds = {
        MINUS_INFINITE: np.isneginf(values),
        INFINITE: np.isposinf(values),
        UNDEFINED: np.isnan(values) & is_possible,
        IMPOSSIBLE: ~is_possible,
    }
    return {look: cells for look, cells in kinds.items() if cells.any()}


def mark_cells(axes: Axes, cells: Flags, look: Look, x: Series, y: Series) -> None:
    """Draw cells, (n_y, n_x), between their edges; those that touch in a row as one."""
    shapes = []
    for row, flags in enumerate(cells):
        turns = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
        for first, last in turns.reshape(-1, 2):
            left, right, low, high = x[first], x[last], y[row], y[row + 1]
            shapes.append([(left, low), (right, low), (right, high), (left, high)])
    axes.add_collection(PolyCollection(shapes, **look.style), autolim=False)


def scale_of(
    values: Series, *, signed: bool, floor: float = -math.inf
) -> tuple[Colormap, Normalize] | None:
    """Colours for the finite values; where they have signs, zero is in the middle of them.

    Without signs, a wide range is logarithmic. What is below `floor` looks as if it was there.
    None if no value is finite.
    """
    finite = np.maximum(values[np.isfinite(values)], floor)
    if finite.size == 0:
        return None
    low, high = float(finite.min()), float(finite.max())
    if not low < high:
        pad = abs(low) / 2 or 0.5
        low, high = low - pad, high + pad
    if not signed:
        is_wide = low > 0.0 and high / low >= _WIDE
        norm = LogNorm(low, high) if is_wide else Normalize(low, high)
        return matplotlib.colormaps[_UNSIGNED], norm
    colours = matplotlib.colormaps[_SIGNED]
    if low < 0.0 < high:
        return colours, TwoSlopeNorm(0.0, low, high)
    # Of the colours for one sign, the palest would pass for the ground.
    start, end = (0.55, 1.0) if low >= 0.0 else (0.0, 0.45)
    return ListedColormap(colours(np.linspace(start, end, 256))), Normalize(low, high)


def bar_ticks(norm: Any) -> list[float]:
    """Round numbers along the bar of a `Normalize`, on either side of zero if that is within."""
    low, high = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
    spans = [(low, high, 4)]
    if isinstance(norm, LogNorm):
        powers = range(math.ceil(math.log10(low)), math.floor(math.log10(high)) + 1)
        return [10.0**power for power in powers[:: -(-len(powers) // 4)]]
    if isinstance(norm, TwoSlopeNorm):
        spans = [(low, 0.0, 3), (0.0, high, 3)]
    found: set[float] = set()
    for start, end, n_bins in spans:
        ticks = MaxNLocator(n_bins, steps=[1, 2, 5, 10]).tick_values(start, end)
        slack = 1e-9 * (end - start)
        found |= {float(t) for t in ticks if start - slack <= t <= end + slack}
    return sorted(found)
