"""Heat maps of measures over a grid of two parameters, as in the paper's Fig. 11."""

from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis as PlotAxis
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import Colormap, ListedColormap, LogNorm, Normalize, TwoSlopeNorm
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator, NullFormatter

from dlgmd_cli.frame import Flags, Series, runs_of
from dlgmd_cli.plots import style
from dlgmd_cli.results.grid import Axis, Grid, as_text

_COLUMNS = {"one": 2, "two": 4}
# Greatest number of inputs side by side in one column of a paper; letters per inch at 6.5 points.
_MOST_IN_ONE, _LETTERS_PER_IN = 3, 15
_LOWEST_DB = -30.0
# Blue below zero, nearly white at zero, red above; safe for all common kinds of colour blindness.
_SIGNED, _UNSIGNED = "RdBu_r", "viridis"
# Ratios of the greatest to the least value from which on colours are logarithmic, and an axis whose
# values have even ratios.
_WIDE_VALUES, _WIDE_AXIS = 100.0, 50.0
# Number of labels that fit on an axis, and the greatest number of values that all have a tick.
_LABELS, _MOST_TICKS = 4.6, 40


class Measure(NamedTuple):
    """Title and unit of a column, and the legend's texts for NaN and for infinite values."""

    title: str
    unit: str
    undefined: str
    infinite: str = ""


MAPPED = {
    "attenuation_db": Measure(
        "Attenuation", "dB", "no valid frame", f"nothing passes (< −{-style.FLOOR_DB:g} dB)"
    ),
    "mp_max": Measure("Peak MP", "", "no valid frame"),
    "sharpness": Measure("Sharpness", "", "no response"),
    "distinguishability": Measure(
        "Distinguishability", "", "no response", "∞: none at the false positive"
    ),
    "first_alarm_frame": Measure("First alarm", "frame", "no alarm"),
}


class Map(NamedTuple):
    """A map: its title, measure and values, and where the parameters are valid, (n_y, n_x)."""

    title: str
    measure: Measure
    values: Series
    is_possible: Flags


class Look(NamedTuple):
    """How cells without a colour are drawn, by Matplotlib's names."""

    facecolor: str
    hatch: str
    edgecolor: str = style.GREY
    linewidth: float = 0.0


UNDEFINED, IMPOSSIBLE = Look("#CCCCCC", ""), Look("white", "////////")
MINUS_INFINITE, INFINITE = Look("white", "....."), Look("white", "++++")


def plot_sweep(
    grid: Grid,
    columns: Mapping[str, Series],
    is_possible: Flags,
    speeds_px: Sequence[float],
    title: str,
    width: style.Width = "one",
) -> style.Figure:
    """Draw heat maps over both parameters, one per speed or per measure.

    All speeds share one scale; each measure has its own. Attenuation is blue below 0 dB and red
    above. The scale ends at -30 dB; below -60 dB, nothing passes. Values that are not finite, or
    cannot be computed, are grey or hatched, as the legend explains. Distinguishability is left out
    if it is undefined at all points. There is at least one point.

    Parameters
    ----------
    grid : Grid
        The parameters and their values.
    columns : mapping of str to ndarray, shape (n_clips, n_y, n_x)
        The measures at each point.
    is_possible : ndarray, shape (n_y, n_x), bool
        Where the values are a valid combination.
    speeds_px : sequence of float
        The speed of the cube in each clip in px/frame; empty for a video.
    title : str
        The text above the figure.
    width : {"one", "two"}
        Columns of a paper.
    """
    panels, per_row = _panels(columns, is_possible, speeds_px), _COLUMNS[width]
    rows = [panels[first : first + per_row] for first in range(0, len(panels), per_row)]
    return _draw_maps(grid, rows, title, width, per_row, "all" if speeds_px else "none")


def plot_sweeps(
    grid: Grid,
    inputs: Sequence[tuple[str, Mapping[str, Series], Flags]],
    title: str,
    width: style.Width = "one",
) -> style.Figure:
    """Draw the maps of several inputs side by side: one column per input, one row per measure.

    All maps of a measure share a scale. `inputs` are names, measures and valid points, as in
    `plot_sweep`. More than three inputs take two columns of a paper.
    """
    width = "two" if len(inputs) > _MOST_IN_ONE else width
    letters = round(_LETTERS_PER_IN * style.width_in(width) / len(inputs))
    by_measure: dict[Measure, list[Map]] = {}
    for place, (name, columns, is_possible) in enumerate(inputs):
        for one in _panels(columns, is_possible, ()):
            empty = one._replace(title="", values=np.full(grid.shape, np.nan))
            row = by_measure.setdefault(one.measure, [empty] * len(inputs))
            row[place] = one._replace(title="")
        top = next(iter(by_measure.values()))
        top[place] = top[place]._replace(title=style.plain(name, letters))
    return _draw_maps(grid, [*by_measure.values()], title, width, len(inputs), "row")


def _draw_maps(
    grid: Grid,
    rows: Sequence[Sequence[Map]],
    title: str,
    width: style.Width,
    n_columns: int,
    sharing: Literal["all", "row", "none"],
) -> style.Figure:
    """Draw rows of maps; all maps, or the maps of a row, may share a scale."""
    meanings: dict[Look, str] = {}
    with style.house_style():
        height_in = len(rows) * 0.9 * style.width_in(width) / n_columns + 0.55
        figure = style.new_figure(height_in, width)
        all_axes = figure.subplots(len(rows), n_columns, squeeze=False)
        drawn = [[*zip(axes, row, strict=False)] for axes, row in zip(all_axes, rows, strict=True)]
        every = [pair for row in drawn for pair in row]
        for axes in all_axes.flat[len(every) :]:
            axes.set_axis_off()
        groups = {"all": [every], "row": drawn, "none": [[pair] for pair in every]}[sharing]
        for group in groups:
            finite = np.concatenate([one.values[np.isfinite(one.values)] for _, one in group])
            measure = group[0][1].measure
            is_signed = measure is MAPPED["attenuation_db"]
            scale = _scale_of(finite, signed=is_signed) if finite.size else None
            pictures = [_draw_map(axes, one, grid, scale, meanings) for axes, one in group]
            for picture in [picture for picture in pictures if picture is not None][:1]:
                beside = [*all_axes.flat] if sharing == "all" else [axes for axes, _ in group]
                _add_bar(figure, beside, picture, measure, finite)
        for place, (axes, one) in enumerate(every):
            axes.set_title(
                one.title,
                pad=3,
                loc="left",
                fontsize=style.points(6.5) if sharing == "row" else None,
            )
            label_axis(axes, "x", grid.x, shows=place + n_columns >= len(every))
            label_axis(axes, "y", grid.y, shows=place % n_columns == 0)
        figure.suptitle(style.plain(title, 80))
        entries = [(Patch(**look._asdict()), text) for look, text in meanings.items()]
        style.add_legend(figure, entries, "outside lower left")
    return figure


def _panels(
    columns: Mapping[str, Series], is_possible: Flags, speeds_px: Sequence[float]
) -> list[Map]:
    """One map per speed, or one map per measure."""
    if speeds_px:
        passing = columns["attenuation_db"]
        passing = np.where(passing < style.FLOOR_DB, -np.inf, passing)
        return [
            Map(f"{speed:g} px/frame", MAPPED["attenuation_db"], values, is_possible)
            for speed, values in zip(speeds_px, passing, strict=True)
        ]
    return [
        Map(measure.title, measure, columns[column][0], is_possible)
        for column, measure in MAPPED.items()
        if column in columns
        and (column != "distinguishability" or not np.isnan(columns[column]).all())
    ]


def _draw_map(
    axes: Axes,
    one: Map,
    grid: Grid,
    scale: tuple[Colormap, Normalize] | None,
    meanings: dict[Look, str],
) -> QuadMesh | None:
    """Draw one map, and note the meaning of uncoloured cells; None without finite values."""
    axes.spines[:].set_visible(True)
    axes.set_box_aspect(1)
    x, y, values = edges(grid.x), edges(grid.y), one.values
    for look, text, cells in (
        (MINUS_INFINITE, one.measure.infinite, np.isneginf(values)),
        (INFINITE, one.measure.infinite, np.isposinf(values)),
        (UNDEFINED, one.measure.undefined, np.isnan(values) & one.is_possible),
        (IMPOSSIBLE, "no such parameters", ~one.is_possible),
    ):
        if cells.any():
            _mark_cells(axes, cells, look, x, y)
            meanings[look] = text if meanings.get(look, text) == text else "undefined"
    if scale is None or not np.isfinite(values).any():
        return None
    # Rasterized even in PDF and SVG, because viewers draw seams between vector cells.
    shown, (colours, norm) = np.ma.masked_invalid(values), scale
    return axes.pcolormesh(x, y, shown, cmap=colours, norm=norm, rasterized=True)


def _mark_cells(axes: Axes, cells: Flags, look: Look, x: Series, y: Series) -> None:
    """Draw the flagged cells, (n_y, n_x); neighbours in a row are one shape."""
    shapes = []
    for row, flags in enumerate(cells):
        for first, last in runs_of(flags):
            left, right, low, high = x[first], x[last], y[row], y[row + 1]
            shapes.append([(left, low), (right, low), (right, high), (left, high)])
    axes.add_collection(PolyCollection(shapes, **look._asdict()), autolim=False)


def _scale_of(values: Series, *, signed: bool) -> tuple[Colormap, Normalize]:
    """The colour map and norm for finite values; `signed` ones have zero in the middle.

    A wide range of unsigned values is logarithmic. Signed values are cut off at -30 dB.
    """
    finite = np.maximum(values, _LOWEST_DB) if signed else values
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
    # For values of one sign, the palest colours are left out: they look like the background.
    start, end = (0.55, 1.0) if low >= 0.0 else (0.0, 0.45)
    return ListedColormap(colours(np.linspace(start, end, 256))), Normalize(low, high)


def _add_bar(
    figure: style.Figure,
    beside: list[Axes],
    picture: QuadMesh,
    measure: Measure,
    values: Series,
) -> None:
    """Add the colour bar of one or several maps, with a pointed end if values lie below the bar."""
    norm, is_signed = picture.norm, measure is MAPPED["attenuation_db"]
    bar = figure.colorbar(
        picture,
        ax=beside,
        fraction=0.07,
        pad=0.03,
        shrink=0.6 if is_signed else 1.0,
        aspect=22 if is_signed else 14,
        extend="min" if (values < (picture.get_clim()[0] or 0.0)).any() else "neither",
    )
    unit = measure.unit
    if len(beside) > 1 and not is_signed:
        bar.set_label(f"{measure.title} ({unit})" if unit else measure.title, labelpad=2)
        unit = ""
    if isinstance(norm, TwoSlopeNorm):
        lowest, highest = float(norm.vmin or 0.0), float(norm.vmax or 0.0)
        ticks: set[float] = set()
        for low, high in ((lowest, 0.0), (0.0, highest)):
            ticks |= set(MaxNLocator(3, steps=[1, 2, 5, 10]).tick_values(low, high))
        bar.set_ticks(sorted(tick for tick in ticks if lowest <= tick <= highest))
        bar.set_label("centred at 0 dB", fontsize=style.points(6.5), color=style.GREY, labelpad=2)
    elif not isinstance(norm, LogNorm):
        bar.locator = MaxNLocator(4, steps=[1, 2, 5, 10])
    bar.ax.tick_params(pad=1.5, length=2, labelsize=6.5)
    bar.ax.minorticks_off()
    bar.ax.set_title(unit, fontsize=style.points(6.5), color=style.GREY, pad=3)
    bar.outline.set_linewidth(0.4)  # type: ignore[operator]


def places(axis: Axis) -> Series:
    """Positions on an axis: the numbers themselves, or 0, 1, … for names."""
    return np.array(axis.values if axis.is_numeric else range(len(axis)), dtype=np.float64)


def edges(axis: Axis) -> Series:
    """Edges of the cells of an axis, halfway between values; n + 1 edges for n values."""
    values = places(axis)
    if len(values) == 1:
        half = abs(values[0]) / 2 or 0.5
        return np.array([values[0] - half, values[0] + half])
    logarithmic = is_logarithmic(axis)
    values = np.log(values) if logarithmic else values
    middle = (values[:-1] + values[1:]) / 2
    first, last = 2 * values[0] - middle[0], 2 * values[-1] - middle[-1]
    cell_edges = np.array([first, *middle, last])
    return np.exp(cell_edges) if logarithmic else cell_edges


def is_logarithmic(axis: Axis) -> bool:
    """Whether the axis's values span a wide range in even ratios."""
    values = places(axis)
    if not axis.is_numeric or len(values) < 3 or values[0] <= 0.0:
        return False
    steps, ratios = np.diff(values), np.diff(np.log(values))
    uneven, uneven_ratios = (d.std() / d.mean() for d in (steps, ratios))
    return bool(values[-1] / values[0] >= _WIDE_AXIS and uneven_ratios < uneven)


def axis_name(axis: Axis) -> str:
    """Symbol and unit of a parameter, for an axis label."""
    symbol, _, index = axis.spec.symbol.partition("_")
    if symbol == "–":
        return axis.key
    label = f"{symbol}$_{{\\mathrm{{{index}}}}}$" if index else symbol
    return label if axis.spec.unit == "–" else f"{label} ({axis.spec.unit})"


def label_axis(axes: Axes, name: str, axis: Axis, *, shows: bool) -> None:
    """Set scale and ticks of the axis "x" or "y"; with `shows`, also tick labels and the name.

    Every value has a tick; as many ticks as fit have a label.
    """
    drawn: PlotAxis = getattr(axes, f"{name}axis")
    at = scaled = places(axis)
    if is_logarithmic(axis):
        axes.set(**{f"{name}scale": "log"})
        scaled = np.log(at)
    labelled: list[int] = []
    for place, value in enumerate(scaled):
        gap = value - scaled[labelled[-1]] if labelled else np.inf
        if gap >= (scaled[-1] - scaled[0]) / _LABELS or not axis.is_numeric:
            labelled.append(place)
    drawn.set_ticks(at[labelled], [as_text(axis.values[place]) for place in labelled])
    drawn.set_ticks(at if len(at) <= _MOST_TICKS else [], minor=True)
    drawn.set_minor_formatter(NullFormatter())
    span = edges(axis)
    axes.set(**{f"{name}lim": (span[0], span[-1])})
    if name == "x" and not axis.is_numeric:
        drawn.set_tick_params(rotation=90)
    if shows:
        drawn.set_label_text(axis_name(axis))
        drawn.labelpad = 2
    else:
        drawn.set_tick_params(which="both", labelbottom=False, labelleft=False)
