"""Figures of results over time: membrane potential, attenuation, spikes and alarms."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.curves import (
    COLUMNS,
    DRAWS,
    EITHER,
    LOOKS,
    MAX_POINTS,
    AxisScale,
    Draw,
    Trace,
    silence,
    span_db,
    traces_of,
)
from dlgmd_cli.plots.style import (
    BLACK,
    ORANGE,
    Entries,
    Figure,
    Width,
    add_legend,
    house_style,
    new_figure,
    plain,
)
from dlgmd_cli.plots.timeline import ROW_IN, Timeline, draw_annotations
from dlgmd_cli.results.annotations import KINDS, NONE, Annotations
from dlgmd_cli.results.result import Result

# More results than this have a row of panels each.
MAX_TOGETHER = 4
_HEIGHT_IN, _RASTER_IN, _RASTER_ROW_IN, _AXES_LABELS_IN = 1.25, 0.4, 0.16, 0.75
# Margins around the panels: labels below and on the left, frame numbers above; and between them.
_LEFT_IN, _RIGHT_IN, BELOW_IN, ABOVE_IN, BETWEEN_IN = 0.58, 0.15, 0.4, 0.43, 0.08
# Heights with a row of panels per result: all rows together; least and greatest height of one; the
# name above it.
_SMALL_IN, _LEAST_SMALL_IN, _MOST_SMALL_IN, _NAME_IN = 5.5, 0.3, 0.6, 0.17
# Height of a page without margins and legend, and of the lowest legible panel.
_PAGE_IN, _LEGIBLE_IN = 8.5, 0.18


def plot(
    kind: str,
    results: Mapping[str, Result],
    annotations: Annotations = NONE,
    *,
    column: str | None = None,
    width: Width = "one",
    emphasise: str | None = None,
    collisions: Mapping[str, Sequence[int]] | None = None,
    xlim: tuple[float, float] | None = None,
    ylim: tuple[float, float] | None = None,
) -> Figure:
    """Draw results over time.

    Parameters
    ----------
    kind : str
        "mp": the normalised membrane potential, with the threshold if all results share it.
        "attenuation": 10 lg(ΣS/ΣP) in dB, with a gap where it is undefined and marks below a break
        of the axis where almost nothing passes. "spikes": the potential above spikes and alarms.
        "overview": all of these.
    results : mapping of str to Result
        By label, in the order of the legend; at least one, each with at least one frame. More than
        four have a row of panels each. A result that is alone in its panel also shows its spikes
        and alarms, which the overview shows only there. For a long result, the maximum of every
        pixel column is drawn.
    annotations : Annotations
        Annotated frames, drawn at the times of the first result.
    column : "level", "mp_abs" or "mp_seq", optional
        The potential to draw: the one that is compared with the threshold (default), the absolute
        one, or the one scaled to the extremes of its sequence.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    emphasise : str, optional
        Label of the result whose line is the strongest: blue and thick.
    collisions : mapping of str to sequence of int, optional
        Frames of collisions by label: black lines, dashed as the result's own line unless all
        results have the same.
    xlim, ylim : (float, float), optional
        Limits of the time axis in s, and of the potential or, in "attenuation", of the dB.

    Raises
    ------
    ValueError
        If there is no result, `kind`, `column` or `width` is not one of these, `emphasise` is no
        label, or `ylim` is given for the two scales of "overview".
    """
    _check(kind, results, column or "level", emphasise, ylim)
    timeline = replace(Timeline.of(results.values()), limits=xlim)
    share = (timeline.end_s - timeline.start_s) / np.ptp(xlim) if xlim else 1.0
    n_points = int(MAX_POINTS * max(1.0, share))
    traces = [
        replace(one, n_points=n_points, collisions_s=_times(one.result, collisions or {}, label))
        for label, one in zip(results, traces_of(results, emphasise), strict=True)
    ]
    layout = _layout(kind, traces, timeline, is_annotated=annotations != NONE)
    with house_style():
        figure = new_figure(1.0, width)
        shape, ratios = (len(layout.heights), len(layout.rows[0])), layout.heights
        grid: Any = figure.subplots(*shape, sharex=True, squeeze=False, height_ratios=ratios)
        panels = [
            _Panel(axes, *one, height_in)
            for axes_of, row, height_in in zip(
                grid[layout.n_above :], layout.rows, ratios[layout.n_above :], strict=True
            )
            for axes, one in zip(axes_of, row, strict=True)
        ]
        found = _draw(panels, column or "level", xlim, ylim)
        if len(results) > MAX_TOGETHER:
            found = _share(panels, found)
        for axes_of in grid.T:
            timeline.label(axes_of[-1], axes_of[0])
        if layout.n_above:
            n_rows = [draw_annotations(annotations, timeline, a[0], a[1:]) for a in grid.T]
            layout.heights[0] = max(*n_rows, 0.1) * ROW_IN
            grid[0, 0].get_gridspec().set_height_ratios(layout.heights)
        _join(grid)
        figure.align_ylabels([one.axes for one in panels if one.axes.get_ylabel()])
        between_in = layout.between_in * (len(layout.heights) - 1)
        figure.set_figheight(sum(layout.heights) + between_in + layout.margins_in)
        legend_in = add_legend(figure, [entry for some in found for entry in some])
        if layout.is_fixed:
            above_in = layout.margins_in - BELOW_IN + legend_in
            fix_margins(figure, layout.heights, layout.between_in, above_in)
    return figure


class _Layout(NamedTuple):
    """What is in each row of panels, and heights in inches; above the first, `n_above` are free.

    `is_fixed` says whether `fix_margins` lays the figure out, instead of Matplotlib.
    """

    rows: "list[list[tuple[Draw, list[Trace]]]]"
    heights: list[float]
    n_above: int
    between_in: float
    margins_in: float
    is_fixed: bool


def _layout(kind: str, traces: list[Trace], timeline: Timeline, *, is_annotated: bool) -> _Layout:
    """The rows of panels: of one result, of up to four together, or of many, a row each."""
    rows, heights = _rows(kind, traces)
    if len(traces) == 1 and not is_annotated:
        heights, margins_in = heights_alone(KINDS[kind]), ABOVE_IN + BELOW_IN
        return _Layout(rows, heights, 0, BETWEEN_IN, margins_in, is_fixed=True)
    if len(traces) > MAX_TOGETHER:
        margins_in = (ABOVE_IN if timeline.is_shared else 0.05) + BELOW_IN
        return _Layout(rows, [ROW_IN, *heights], 1, _NAME_IN, margins_in, is_fixed=True)
    above = [ROW_IN] if is_annotated else []
    return _Layout(rows, above + heights, len(above), 0.0, _AXES_LABELS_IN, is_fixed=False)


def _draw(
    panels: "list[_Panel]",
    column: str,
    xlim: tuple[float, float] | None,
    ylim: tuple[float, float] | None,
) -> list[Entries]:
    """Draw the lines of every panel, and the collisions; returns the entries of the legend."""
    found = [one.draw(one.axes, one.traces, scale) for one, scale in _scaled(panels, column, ylim)]
    found.append(_draw_collisions(panels))
    if xlim or ylim:  # dots of spikes may lie outside
        for dots in (line for one in panels for line in one.axes.lines):
            dots.set_clip_on(dots.get_clip_on() or dots.get_marker() == "o")
    return found


def _join(grid: Any) -> None:
    """Leave out the lines between panels: only the lowest keep their time axis."""
    for axes in grid.flat:
        axes.spines["top"].set_visible(False)
    for axes in grid[:-1].flat:
        axes.spines["bottom"].set_visible(False)
        axes.tick_params(axis="x", bottom=False)


def _check(
    kind: str,
    results: Mapping[str, Result],
    column: str,
    emphasise: str | None,
    ylim: tuple[float, float] | None,
) -> None:
    """Raise ValueError if these cannot be drawn."""
    if not results:
        raise ValueError("there is no result to draw")
    for name, value, known in (
        ("kind", kind, KINDS),
        ("column", column, COLUMNS),
        ("emphasise", emphasise or next(iter(results)), results),
    ):
        if value not in known:
            raise ValueError(f"{name} is {value!r}, none of {', '.join(known)}")
    if ylim and kind == "overview":
        raise ValueError("ylim is for one scale, and an overview has two")


class _Panel(NamedTuple):
    """Axes, the function that draws in them, what it draws, and their height in inches."""

    axes: Axes
    draw: Draw
    traces: list[Trace]
    height_in: float


def _times(
    result: Result, collisions: Mapping[str, Sequence[int]], label: str
) -> tuple[float, ...]:
    """The times of a result's collisions that lie within it."""
    first, last = result.frame[[0, -1]]
    within = [frame for frame in collisions.get(label, ()) if first <= frame <= last]
    return tuple(np.interp(within, result.frame, result.time_s).tolist())


def _rows(
    kind: str, traces: list[Trace]
) -> tuple[list[list[tuple[Draw, list[Trace]]]], list[float]]:
    """For each row of panels, their drawing functions and results; and the heights in inches."""
    names, n_results = KINDS[kind], len(traces)
    raster_in = max(_RASTER_IN, _RASTER_ROW_IN * n_results)
    if n_results <= MAX_TOGETHER:
        heights = [raster_in if name == "raster" else _HEIGHT_IN for name in names]
        return [[(DRAWS[name], traces)] for name in names], heights
    lines = [DRAWS[name] for name in names if name != "raster"]
    # Beside the attenuation there is no room for a raster, which every level shows anyway.
    has_raster = "raster" in names and len(lines) == 1
    room_in = _PAGE_IN - ABOVE_IN - BELOW_IN - _NAME_IN * n_results - raster_in * has_raster
    small_in = min(max(_SMALL_IN / n_results, _LEAST_SMALL_IN), _MOST_SMALL_IN)
    small_in = max(min(small_in, room_in / n_results), _LEGIBLE_IN)
    color, _ = LOOKS[0]
    own = [
        replace(one, look={**one.look, "color": color, "linestyle": "-"}, alone=True)
        for one in traces
    ]
    rows: list[list[tuple[Draw, list[Trace]]]]
    rows = [[(draw, [one]) for draw in lines] for one in own]
    heights = [small_in] * n_results
    if has_raster:
        rows.append([(DRAWS["raster"], [replace(one, look={"color": ORANGE}) for one in traces])])
        heights.append(raster_in)
    return rows, heights


def _scaled(
    panels: list[_Panel], column: str, ylim: tuple[float, float] | None
) -> list[tuple[_Panel, AxisScale]]:
    """Every panel with its vertical axis; those of one result each share the one of their kind."""
    limits, n_silent = ylim, None
    alone = [one.traces[0] for one in panels if one.draw is DRAWS["attenuation"]]
    if len(alone) > 1:
        silences, shown = zip(*(silence(one) for one in alone), strict=True)
        limits, n_silent = limits or span_db(shown), int(np.any([s.any() for s in silences]))
    scale = AxisScale(0.0, column)
    return [
        (
            one,
            scale._replace(height_in=one.height_in, limits=limits, n_silent=n_silent)
            if one.draw is DRAWS["attenuation"]
            else scale._replace(height_in=one.height_in, limits=ylim),
        )
        for one in panels
    ]


def _share(panels: list[_Panel], found: list[Entries]) -> list[Entries]:
    """Name the rows of one result each, and label each column of panels once.

    Returns the entries of the legend without those of the lines, and with one for all thresholds if
    they differ.
    """
    named: set[str] = set()
    for draw in (DRAWS["level"], DRAWS["attenuation"]):
        group = [(one.axes, one.traces[0]) for one in panels if one.draw is draw]
        names = {axes.get_ylabel() for axes, _ in group}
        for axes, trace in group:
            if trace.label not in named:
                axes.text(0.0, 1.04, plain(trace.label), transform=axes.transAxes, fontsize=7)
            if draw is DRAWS["level"]:
                axes.yaxis.set_major_locator(MaxNLocator(2, steps=[1, 2, 5, 10]))
            axes.set_ylabel("")
        named |= {trace.label for _, trace in group}
        if group:
            # The label is longer than one panel: it stands beside the middle of all.
            text = names.pop() if len(names) == 1 else EITHER
            label = group[len(group) // 2][0].set_ylabel(text)
            label.set_y(0.5 if len(group) % 2 else 1.0)
    thresholds = {text for some in found for _, text in some if text.startswith("threshold ")}
    return [
        [
            (handle, "threshold" if text in thresholds and len(thresholds) > 1 else text)
            for handle, text in some
            if text not in named
        ]
        for some in found
    ]


def fix_margins(figure: Figure, heights: list[float], between_in: float, above_in: float) -> None:
    """Lay out figures of one result, which every run draws, and figures with many panels.

    `heights` are those of the panels, `above_in` that of what stands above them, in inches. The
    widths of their labels are known, and Matplotlib's layout would take as long as drawing.
    """
    figure.set_layout_engine(None)
    width, height = figure.get_size_inches()
    ticks = [text for axes in figure.axes for text in axes.get_yticklabels() if text.get_text()]
    longest_in = max((text.get_window_extent().width for text in ticks), default=0.0) / figure.dpi
    left_in, n_columns = max(_LEFT_IN, longest_in + 0.1), len(figure.axes) // len(heights)
    panel_in = (width - n_columns * left_in - _RIGHT_IN) / n_columns
    figure.subplots_adjust(
        left=left_in / width,
        right=1.0 - _RIGHT_IN / width,
        bottom=BELOW_IN / height,
        top=1.0 - above_in / height,
        hspace=between_in * len(heights) / sum(heights),
        wspace=left_in / panel_in,
    )


def heights_alone(names: Sequence[str]) -> list[float]:
    """Heights of the panels of one result, by their names, in inches."""
    return [(_RASTER_IN if name == "raster" else _HEIGHT_IN) - BETWEEN_IN for name in names]


def _draw_collisions(panels: list[_Panel]) -> Entries:
    """Draw a black line at every collision of a result, in the raster a bar in the result's row."""
    are_equal = len({trace.collisions_s for one in panels for trace in one.traces}) == 1
    drawn: list[Any] = []
    for one in panels:
        n_rows = len(one.traces)
        for place, trace in enumerate(one.traces):
            look: Any = {"color": BLACK, "linewidth": 1.4, "zorder": 2.4}
            ends = (0.0, 1.0)
            if one.draw is DRAWS["raster"] and not trace.alone:
                ends = (n_rows - place - 1) / n_rows, (n_rows - place) / n_rows
            elif not are_equal:
                look["linestyle"] = trace.look.get("linestyle", "-")
            drawn += [one.axes.axvline(time_s, *ends, **look) for time_s in trace.collisions_s]
    mark = Line2D([], [], color=BLACK, linewidth=1.4)
    return [(mark, "collision")] if drawn else []
