"""Where the values of a parameter lie on an axis, and what stands beside it."""

import numpy as np
from matplotlib.axis import Axis as PlotAxis
from matplotlib.axis import XAxis
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.results.tables import Series
from dlgmd_cli.runs.axis import Axis

_FEW = 3
# From this ratio of the greatest to the least value on, even ratios make a logarithmic axis.
_WIDE = 50.0


def places(axis: Axis) -> Series:
    """The values themselves, or 0, 1, … for those that are names."""
    return np.array(axis.values if axis.is_numeric else range(len(axis)), dtype=np.float64)


def edges(axis: Axis) -> Series:
    """Where the cells of an axis meet: halfway between its values; one more than those."""
    values = places(axis)
    if len(values) == 1:
        half = abs(values[0]) / 2 or 0.5
        return np.array([values[0] - half, values[0] + half])
    if is_logarithmic(axis):
        return np.exp(_halfway(np.log(values)))
    return _halfway(values)


def is_logarithmic(axis: Axis) -> bool:
    """Whether its values span a wide range in even ratios."""
    values = places(axis)
    if not axis.is_numeric or len(values) < 3 or values[0] <= 0.0:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    uneven, uneven_ratios = (d.std() / d.mean() for d in (steps, ratios))
    return bool(values[-1] / values[0] >= _WIDE and uneven_ratios < uneven)


def name(axis: Axis) -> str:
    """Symbol and unit of a parameter, for a label."""
    symbol, _, index = axis.spec.symbol.partition("_")
    if symbol == "–":
        return axis.key
    label = f"{symbol}$_{{\\mathrm{{{index}}}}}$" if index else symbol
    return label if axis.spec.unit == "–" else f"{label} ({axis.spec.unit})"


def label_axis(drawn: PlotAxis, axis: Axis, *, shows: bool) -> None:
    """Scale, ticks and, if it `shows`, their labels and the parameter's name."""
    along_x = isinstance(drawn, XAxis)
    if is_logarithmic(axis):
        (drawn.axes.set_xscale if along_x else drawn.axes.set_yscale)("log")
    elif len(axis) <= _FEW or not axis.is_numeric:
        labels = [f"{v:.4g}" if axis.is_numeric else _word(v) for v in axis.values]
        drawn.set_ticks(list(places(axis)), labels)
    else:
        whole = isinstance(axis.values[0], int)
        drawn.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], integer=whole))
    span = edges(axis)
    (drawn.axes.set_xlim if along_x else drawn.axes.set_ylim)(span[0], span[-1])
    if along_x and not axis.is_numeric:
        drawn.set_tick_params(rotation=90)
    if shows:
        drawn.set_label_text(name(axis))
        drawn.labelpad = 2
    else:
        drawn.set_tick_params(which="both", labelbottom=False, labelleft=False)


def _word(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def _halfway(values: Series) -> Series:
    """Between the values, and as far beyond the outermost."""
    middle = (values[:-1] + values[1:]) / 2
    return np.concatenate(
        ([2 * values[0] - middle[0]], middle, [2 * values[-1] - middle[-1]]),
    )
