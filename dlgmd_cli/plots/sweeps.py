"""Measures over a grid of two parameters, as heat maps like the paper's Fig. 11."""

import math
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from dlgmd_cli.plots.grid_axes import edges, label_axis
from dlgmd_cli.plots.shades import (
    IMPOSSIBLE,
    UNDEFINED,
    Look,
    bar_ticks,
    looks_of,
    mark_cells,
    scale_of,
)
from dlgmd_cli.plots.style import (
    GREY,
    Box,
    Width,
    add_axes,
    figure_width_in,
    house_style,
    new_figure,
)
from dlgmd_cli.results.sweeps import SweepResult
from dlgmd_cli.results.tables import Series

# Of the figure, in inches: the room left of the first map and right of each, below the lowest and
# above each, for a line of the legend, and what the names of choices take more than numbers.
_LEFT, _BESIDE, _BOTTOM, _ABOVE, _LINE, _NAMES = 0.46, 0.56, 0.4, 0.28, 0.15, 0.32
_BAR_GAP, _BAR_WIDTH, _HEAD = 0.06, 0.08, 0.12
_COLUMNS = {"one": 2, "two": 4}
# What is left below this is rounding, as in the plots of a run.
SILENT_DB = -60.0


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
    "first_collision_frame": Measure("First collision", "frame", "no collision"),
}


class Panel(NamedTuple):
    """One heat map; `measure` says how to read `values`, shape (n_y, n_x)."""

    title: str
    measure: Measure
    values: Series


def plot_sweep(result: SweepResult, width: Width = "one") -> Figure:
    """Heat maps over both parameters, one a speed or one a measure, each with its own colours.

    Attenuation is blue below 0 dB and red above; what is below -30 dB looks as -30 dB does, and
    below -60 dB nothing passes. What is no finite number, or cannot be computed, has no colour but
    grey or a pattern, which the legend explains.

    Parameters
    ----------
    result : SweepResult
        At least one point. A measure that no point has, distinguishability for one, is left out.
    width : {"one", "two"}
        Columns of a paper that the figure is wide.
    """
    panels = _panels(result)
    grid = result.grid
    per_row = _COLUMNS[width]
    n_rows = -(-len(panels) // per_row)
    legend = _legend(panels, result)
    left = _LEFT + (0.0 if grid.y.is_numeric else _NAMES)
    top = _HEAD if result.speeds_px else 0.0
    bottom = _BOTTOM + (0.0 if grid.x.is_numeric else _NAMES) + _LINE * len(legend)
    side = (figure_width_in(width) - left) / per_row - _BESIDE
    with house_style():
        figure = new_figure(bottom + n_rows * (side + _ABOVE) + top, width)
        for place, panel in enumerate(panels):
            row, column = divmod(place, per_row)
            x = left + column * (side + _BESIDE)
            y = bottom + (n_rows - 1 - row) * (side + _ABOVE)
            axes = add_axes(figure, (x, y, side, side))
            picture = _draw(axes, panel, result)
            label_axis(axes.xaxis, grid.x, shows=place + per_row >= len(panels))
            label_axis(axes.yaxis, grid.y, shows=column == 0)
            if picture is not None:
                beside = (x + side + _BAR_GAP, y, _BAR_WIDTH, side)
                _add_bar(figure, picture, beside, panel.measure.unit)
        if result.speeds_px:
            _head(figure, "Attenuation 10 lg(ΣS/ΣP) of a cube that moves at")
        _add_legend(figure, legend)
    return figure


def _panels(result: SweepResult) -> list[Panel]:
    """What there is to draw."""
    if result.speeds_px:
        measure = MEASURES["attenuation_db"]
        passing = result.columns["attenuation_db"]
        passing = np.where(passing < SILENT_DB, -np.inf, passing)
        maps = zip(result.speeds_px, passing, strict=True)
        return [Panel(f"{speed:g} px/frame", measure, values) for speed, values in maps]
    return [
        Panel(measure.title, measure, result.columns[column][0])
        for column, measure in MEASURES.items()
        if column in result.columns
        and (column != "distinguishability" or not np.isnan(result.columns[column]).all())
    ]


def _draw(axes: Axes, panel: Panel, result: SweepResult) -> QuadMesh | None:
    """One map, coloured where there are finite values; None if there are none."""
    axes.set_title(panel.title, fontsize=8, pad=3, loc="left")
    axes.spines["right"].set_visible(True)
    x, y = edges(result.grid.x), edges(result.grid.y)
    for look, cells in looks_of(panel.values, result.is_possible).items():
        mark_cells(axes, cells, look, x, y)
    scale = scale_of(panel.values, signed=panel.measure.is_signed, floor=panel.measure.floor)
    if scale is None:
        return None
    colours, norm = scale
    # As pixels also in PDF and SVG, where viewers draw seams between cells.
    return axes.pcolormesh(
        x, y, np.ma.masked_invalid(panel.values), cmap=colours, norm=norm, rasterized=True
    )


def _add_bar(figure: Figure, picture: QuadMesh, box: Box, unit: str) -> None:
    """The scale of `picture`."""
    norm: Any = picture.norm
    is_cut = bool(np.ma.min(np.ma.asarray(picture.get_array())) < norm.vmin)
    bar = figure.colorbar(
        picture,
        cax=add_axes(figure, box),
        ticks=bar_ticks(norm),
        extend="min" if is_cut else "neither",
    )
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.ax.minorticks_off()
    if not isinstance(norm, LogNorm):  # powers of ten have labels of their own
        bar.set_ticklabels([f"{tick:g}".replace("-", "−") for tick in bar.get_ticks()])
    bar.ax.set_title(unit, fontsize=6.5, color=GREY, pad=3)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def _legend(panels: list[Panel], result: SweepResult) -> dict[Look, str]:
    """What the cells without a colour mean, as far as there are some."""
    found: dict[Look, str] = {}
    for panel in panels:
        for look in looks_of(panel.values, result.is_possible):
            if look is IMPOSSIBLE:
                found[look] = "no such parameters"
            elif look is UNDEFINED:
                text = panel.measure.undefined
                found[look] = text if found.get(look, text) == text else "undefined"
            else:
                found[look] = panel.measure.infinite
    return found


def _head(figure: Figure, text: str) -> None:
    """What all panels show."""
    figure.text(0.5, 1.0 - 0.04 / figure.get_size_inches()[1], text, ha="center", va="top")


def _add_legend(figure: Figure, legend: dict[Look, str]) -> None:
    """A line for each pattern, below the maps."""
    if legend:
        handles = [Patch(**look.style, label=text) for look, text in legend.items()]
        figure.legend(
            handles=handles, loc="lower left", borderaxespad=0.2, handleheight=1.0, labelspacing=0.3
        )
