"""Measures over a grid of two parameters, as heat maps like the paper's Fig. 11."""

import math
from typing import Any, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis as PlotAxis
from matplotlib.axis import XAxis
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.style import GREY, Width, add_legend, house_style, new_figure, width_in
from dlgmd_cli.results.result import Flags, Series
from dlgmd_cli.results.sweep import Axis, SweepResult

_COLUMNS = {"one": 2, "two": 4}
# What is left below this is rounding, as in the plots of a run.
SILENT_DB = -60.0
# Blue below zero, red above it, nearly white between: told apart by all kinds of colour vision.
_SIGNED, _UNSIGNED = "RdBu_r", "viridis"
# From this ratio of the greatest to the least value on, colours follow its logarithm; an axis does
# from the other one on, if the ratios of its values are even.
_WIDE_VALUES, _WIDE_AXIS = 100.0, 50.0
_FEW_TICKS = 3


class Measure(NamedTuple):
    """How a column is shown: title and unit, and what is said where it is not a finite number."""

    title: str
    unit: str
    undefined: str
    infinite: str = ""
    is_signed: bool = False
    floor: float = -math.inf


MEASURES = {
    "attenuation_db": Measure(
        "Attenuation",
        "dB",
        "no valid frame",
        f"nothing passes (< −{-SILENT_DB:g} dB)",
        is_signed=True,
        floor=-30.0,
    ),
    "mp_max": Measure("Peak MP", "", "no valid frame"),
    "sharpness": Measure("Sharpness", "", "no response"),
    "distinguishability": Measure(
        "Distinguishability", "", "no response", "∞: none at the false positive"
    ),
    "first_alarm_frame": Measure("First alarm", "frame", "no alarm"),
}


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


class _Panel(NamedTuple):
    """One heat map; `measure` says how to read `values`, shape (n_y, n_x)."""

    title: str
    measure: Measure
    values: Series
    looks: dict[Look, Flags]


def plot_sweep(result: SweepResult, width: Width = "one") -> Figure:
    """Heat maps over both parameters, one per speed or per measure, each with its own colours.

    Attenuation is blue below 0 dB and red above; what is below -30 dB looks as -30 dB does, and
    below -60 dB nothing passes. Cells that are not finite, or cannot be computed, are grey or
    have a pattern, which the legend explains.

    Parameters
    ----------
    result : SweepResult
        At least one point. A measure that no point has, distinguishability for one, is left out.
    width : {"one", "two"}
        Columns of a paper that the figure is wide.
    """
    panels, grid = _panels(result), result.grid
    per_row = _COLUMNS[width]
    n_rows = -(-len(panels) // per_row)
    with house_style():
        figure = new_figure(n_rows * 0.9 * width_in(width) / per_row + 0.35, width)
        all_axes: Any = figure.subplots(n_rows, per_row, squeeze=False)
        for place, axes in enumerate(all_axes.flat):
            if place >= len(panels):
                axes.set_axis_off()
                continue
            _draw(figure, axes, panels[place], result)
            label_axis(axes.xaxis, grid.x, shows=place + per_row >= len(panels))
            label_axis(axes.yaxis, grid.y, shows=place % per_row == 0)
        if result.speeds_px:
            figure.suptitle("Attenuation 10 lg(ΣS/ΣP) of a cube that moves at", fontsize=8)
        meanings = _meanings(panels).items()
        entries = [(Patch(**look.style), text) for look, text in meanings]
        add_legend(figure, entries, "outside lower left")
    return figure


def _panels(result: SweepResult) -> list[_Panel]:
    """What there is to draw."""
    if result.speeds_px:
        measure = MEASURES["attenuation_db"]
        passing = result.columns["attenuation_db"]
        passing = np.where(passing < SILENT_DB, -np.inf, passing)
        named = [
            (f"{speed:g} px/frame", measure, values)
            for speed, values in zip(result.speeds_px, passing, strict=True)
        ]
    else:
        named = [
            (measure.title, measure, result.columns[column][0])
            for column, measure in MEASURES.items()
            if column in result.columns
            and (column != "distinguishability" or not np.isnan(result.columns[column]).all())
        ]
    return [
        _Panel(title, measure, values, looks_of(values, result.is_possible))
        for title, measure, values in named
    ]


def looks_of(values: Series, is_possible: Flags) -> dict[Look, Flags]:
    """Which cells have no colour, by how they look."""
    kinds = {
        MINUS_INFINITE: np.isneginf(values),
        INFINITE: np.isposinf(values),
        UNDEFINED: np.isnan(values) & is_possible,
        IMPOSSIBLE: ~is_possible,
    }
    return {look: cells for look, cells in kinds.items() if cells.any()}


def _meanings(panels: list[_Panel]) -> dict[Look, str]:
    """What the cells without a colour mean, as far as there are some."""
    found: dict[Look, str] = {}
    for panel in panels:
        for look in panel.looks:
            if look is IMPOSSIBLE:
                found[look] = "no such parameters"
            elif look is UNDEFINED:
                text = panel.measure.undefined
                found[look] = text if found.get(look, text) == text else "undefined"
            else:
                found[look] = panel.measure.infinite
    return found


def _draw(figure: Figure, axes: Axes, panel: _Panel, result: SweepResult) -> None:
    """One map, coloured where there are finite values, with its scale."""
    axes.set_title(panel.title, pad=3, loc="left")
    axes.spines["right"].set_visible(True)
    axes.set_box_aspect(1)
    x, y = edges(result.grid.x), edges(result.grid.y)
    for look, cells in panel.looks.items():
        _mark_cells(axes, cells, look, x, y)
    measure = panel.measure
    scale = _scale_of(panel.values, signed=measure.is_signed, floor=measure.floor)
    if scale is None:
        return
    colours, norm = scale
    values = np.ma.masked_invalid(panel.values)
    # As pixels also in PDF and SVG, where viewers draw seams between cells.
    picture = axes.pcolormesh(x, y, values, cmap=colours, norm=norm, rasterized=True)
    is_cut = float(values.min()) < float(norm.vmin or 0.0)
    _add_bar(figure, axes, picture, measure.unit, is_cut=is_cut)


def _mark_cells(axes: Axes, cells: Flags, look: Look, x: Series, y: Series) -> None:
    """Draw cells, (n_y, n_x), between their edges; those that touch in a row as one."""
    shapes = []
    for row, flags in enumerate(cells):
        turns = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
        for first, last in turns.reshape(-1, 2):
            left, right, low, high = x[first], x[last], y[row], y[row + 1]
            shapes.append([(left, low), (right, low), (right, high), (left, high)])
    axes.add_collection(PolyCollection(shapes, **look.style), autolim=False)


def _scale_of(values: Series, *, signed: bool, floor: float) -> tuple[Colormap, Normalize] | None:
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
        is_wide = low > 0.0 and high / low >= _WIDE_VALUES
        norm = LogNorm(low, high) if is_wide else Normalize(low, high)
        return matplotlib.colormaps[_UNSIGNED], norm
    colours = matplotlib.colormaps[_SIGNED]
    if low < 0.0 < high:
        return colours, TwoSlopeNorm(0.0, low, high)
    # Of the colours for one sign, the palest would pass for the ground.
    start, end = (0.55, 1.0) if low >= 0.0 else (0.0, 0.45)
    return ListedColormap(colours(np.linspace(start, end, 256))), Normalize(low, high)


def _add_bar(figure: Figure, axes: Axes, picture: QuadMesh, unit: str, *, is_cut: bool) -> None:
    """The scale of a map, right of it, pointed where values lie below its end."""
    norm: Any = picture.norm
    extend = "min" if is_cut else "neither"
    bar = figure.colorbar(picture, ax=axes, extend=extend, fraction=0.07, pad=0.03, aspect=14)
    if isinstance(norm, TwoSlopeNorm):
        lowest, highest = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
        ticks: set[float] = set()
        for low, high in ((lowest, 0.0), (0.0, highest)):
            ticks |= set(MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high))
        bar.set_ticks(sorted(tick for tick in ticks if lowest <= tick <= highest))
    elif not isinstance(norm, LogNorm):
        bar.locator = MaxNLocator(4, steps=[1, 2, 5, 10])
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.ax.minorticks_off()
    bar.ax.set_title(unit, fontsize=6.5, color=GREY, pad=3)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def places(axis: Axis) -> Series:
    """Positions on an axis: the values themselves, or 0, 1, … if they are names."""
    return np.array(axis.values if axis.is_numeric else range(len(axis)), dtype=np.float64)


def edges(axis: Axis) -> Series:
    """Where the cells of an axis meet: halfway between its values; one more than those."""
    values = places(axis)
    if len(values) == 1:
        half = abs(values[0]) / 2 or 0.5
        return np.array([values[0] - half, values[0] + half])
    logarithmic = is_logarithmic(axis)
    values = np.log(values) if logarithmic else values
    middle = (values[:-1] + values[1:]) / 2
    outer = [2 * values[0] - middle[0]], [2 * values[-1] - middle[-1]]
    found: Series = np.concatenate((outer[0], middle, outer[1]))
    return np.exp(found) if logarithmic else found


def is_logarithmic(axis: Axis) -> bool:
    """Whether its values span a wide range in even ratios."""
    values = places(axis)
    if not axis.is_numeric or len(values) < 3 or values[0] <= 0.0:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    uneven, uneven_ratios = (d.std() / d.mean() for d in (steps, ratios))
    return bool(values[-1] / values[0] >= _WIDE_AXIS and uneven_ratios < uneven)


def axis_name(axis: Axis) -> str:
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
    elif len(axis) <= _FEW_TICKS or not axis.is_numeric:
        labels = [f"{v:.4g}" if axis.is_numeric else str(v) for v in axis.values]
        labels = [label.lower() if label in ("True", "False") else label for label in labels]
        drawn.set_ticks(list(places(axis)), labels)
    else:
        whole = isinstance(axis.values[0], int)
        drawn.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10], integer=whole))
    span = edges(axis)
    (drawn.axes.set_xlim if along_x else drawn.axes.set_ylim)(span[0], span[-1])
    if along_x and not axis.is_numeric:
        drawn.set_tick_params(rotation=90)
    if shows:
        drawn.set_label_text(axis_name(axis))
        drawn.labelpad = 2
    else:
        drawn.set_tick_params(which="both", labelbottom=False, labelleft=False)
