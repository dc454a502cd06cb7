"""Figures of results over time: membrane potential, attenuation, spikes and alarms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.annotations import NONE, Annotations
from dlgmd_cli.plots.kinds import KINDS
from dlgmd_cli.plots.style import (
    BLACK,
    BLUE,
    FLOOR_DB,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
    Entries,
    Figure,
    Width,
    add_legend,
    house_style,
    new_figure,
    plain,
)
from dlgmd_cli.plots.timeline import ROW_IN, Timeline, draw_annotations
from dlgmd_cli.results.result import Flags, Result, Series

# Least span of the vertical axis, so that rounding errors do not look like an event.
MIN_SPAN_DB = 5.0
# Pixel columns of the widest figure; for longer results, the maximum of each column is drawn.
MAX_POINTS = 1400

COLUMNS = ("level", "mp_abs", "mp_seq")
# Axis labels by `Result.by_sequence`, in the words of --normalise; and for results that differ.
LEVEL_NAMES = {False: "MP (absolute)", True: "MP (sequence)"}
_EITHER = "Normalised MP"
# Neighbours differ in colour, dashes and brightness; vermilion and black have other meanings. The
# last two are for other kinds of figures: more than four results have a panel each.
LOOKS: tuple[tuple[str, Any], ...] = (
    (BLUE, "-"),
    (PURPLE, (0, (4, 1.5))),
    (GREEN, (0, (5, 1.5, 1, 1.5))),
    (SKY_BLUE, (0, (1, 1.2))),
    (GREY, (0, (9, 2))),
    (ORANGE, (0, (5, 1.2, 1, 1.2, 1, 1.2))),
)
MAX_TOGETHER = 4
# The look of an emphasised line, beside that of the others.
STRONG: dict[str, Any] = {"linewidth": 1.7, "marker": "o", "markersize": 3.5, "markevery": 0.08}
_WEAK: dict[str, Any] = {"linewidth": 0.8}
_HEIGHT_IN, _RASTER_IN, _RASTER_ROW_IN, _AXES_LABELS_IN = 1.25, 0.4, 0.16, 0.75
# Margins around the panels: labels below and on the left, frame numbers above; and between them.
_LEFT_IN, _RIGHT_IN, BELOW_IN, ABOVE_IN, BETWEEN_IN = 0.58, 0.15, 0.4, 0.43, 0.08
# Heights with a row of panels per result: all rows together; least and greatest height of one; the
# name above it.
_SMALL_IN, _LEAST_SMALL_IN, _MOST_SMALL_IN, _NAME_IN = 5.5, 0.3, 0.6, 0.17
# Height of a page without margins and legend, and of the lowest legible panel.
_PAGE_IN, _LEGIBLE_IN = 8.5, 0.18
# Height of a row of marks below the break of an axis, and of the break.
_MARKS_IN, _BREAK_IN = 0.09, 0.08

# Limits of the potential: no tick is halfway between two pixels, where rounding would place it.
_LEVELS = (-0.03, 1.055)
# Greatest number of characters of a name beside a row of spikes.
_LONGEST_ROW_NAME = 18
# More dots than this touch each other, and their black rims would hide everything else.
_MAX_RINGED = 200


@dataclass(frozen=True)
class _Trace:
    """A result and the look of its line; if it is `alone`, its spikes and alarms are shown, too.

    `collisions_s` has the times of its collisions, and `n_points` the most points of its line.
    """

    label: str
    result: Result
    look: dict[str, Any]
    alone: bool
    collisions_s: tuple[float, ...] = ()
    n_points: int = MAX_POINTS


class Scale(NamedTuple):
    """The vertical axis of a panel: its height in inches, and what is drawn.

    `column` is that of the potential. `limits` are those of the values, None to fit them.
    `n_silent` is the number of rows for results of which nothing passes, None for as many as there
    are.
    """

    height_in: float
    column: str = "level"
    limits: tuple[float, float] | None = None
    n_silent: int | None = None


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
        Label of the result whose line is the strongest: blue, thick, with dots.
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
    if not results:
        raise ValueError("there is no result to draw")
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}, none of {', '.join(KINDS)}")
    column = column or "level"
    if column not in COLUMNS:
        raise ValueError(f"column is {column!r}, none of {', '.join(COLUMNS)}")
    if emphasise is not None and emphasise not in results:
        raise ValueError(f"emphasise is {emphasise!r}, none of {', '.join(results)}")
    if ylim and kind == "overview":
        raise ValueError("ylim is for one scale, and an overview has two")
    timeline = Timeline.of(results.values())
    n_points = MAX_POINTS
    if xlim:
        n_points = int(MAX_POINTS * max(1.0, (timeline.end_s - timeline.start_s) / np.ptp(xlim)))
        timeline = replace(timeline, limits=xlim)
    traces = [
        replace(one, n_points=n_points, collisions_s=_times(one.result, collisions or {}, label))
        for label, one in zip(results, traces_of(results, emphasise), strict=True)
    ]
    is_split = len(results) > MAX_TOGETHER
    is_alone = len(results) == 1 and annotations == NONE
    rows, heights = _rows(kind, traces)
    above = [ROW_IN] if annotations != NONE or is_split else []
    between_in, margins_in = BETWEEN_IN, ABOVE_IN + BELOW_IN
    if is_alone:
        heights = heights_alone(KINDS[kind])
    elif is_split:
        between_in, margins_in = _NAME_IN, (ABOVE_IN if timeline.is_shared else 0.05) + BELOW_IN
    else:
        between_in, margins_in = 0.0, _AXES_LABELS_IN
    with house_style():
        figure = new_figure(1.0, width)
        grid: Any = figure.subplots(
            len(above) + len(rows), len(rows[0]), sharex=True, squeeze=False,
            height_ratios=above + heights,
        )  # fmt: skip
        panels = [
            _Panel(axes, *one, height_in)
            for axes_of, row, height_in in zip(grid[len(above) :], rows, heights, strict=True)
            for axes, one in zip(axes_of, row, strict=True)
        ]
        found = [
            one.draw(one.axes, one.traces, scale) for one, scale in _scaled(panels, column, ylim)
        ]
        found.append(_draw_collisions(panels))
        if xlim or ylim:  # dots of spikes may lie outside
            for dots in (line for one in panels for line in one.axes.lines):
                dots.set_clip_on(dots.get_clip_on() or dots.get_marker() == "o")
        if is_split:
            found = _share(panels, found)
        for axes_of in grid.T:
            timeline.label(axes_of[-1], axes_of[0])
            if not above:
                continue
            n_rows = draw_annotations(annotations, timeline, axes_of[0], axes_of[1:])
            above = [max(n_rows, 0.1) * ROW_IN]
            grid[0, 0].get_gridspec().set_height_ratios(above + heights)
        for axes in grid.flat:  # no lines between panels: only the lowest keeps its time axis
            axes.spines["top"].set_visible(False)
        for axes in grid[:-1].flat:
            axes.spines["bottom"].set_visible(False)
            axes.tick_params(axis="x", bottom=False)
        figure.align_ylabels([one.axes for one in panels if one.axes.get_ylabel()])
        heights = above + heights
        figure.set_figheight(sum(heights) + between_in * (len(heights) - 1) + margins_in)
        legend_in = add_legend(figure, [entry for some in found for entry in some])
        if is_split or is_alone:
            above_in = margins_in - BELOW_IN
            fix_margins(figure, heights, between_in, above_in + legend_in)
    return figure


class _Panel(NamedTuple):
    """Axes, the function that draws in them, what it draws, and their height in inches."""

    axes: Axes
    draw: "Draw"
    traces: list[_Trace]
    height_in: float


def _times(
    result: Result, collisions: Mapping[str, Sequence[int]], label: str
) -> tuple[float, ...]:
    """The times of a result's collisions that lie within it."""
    first, last = result.frame[[0, -1]]
    within = [frame for frame in collisions.get(label, ()) if first <= frame <= last]
    return tuple(np.interp(within, result.frame, result.time_s).tolist())


def _rows(
    kind: str, traces: list[_Trace]
) -> tuple[list[list[tuple["Draw", list[_Trace]]]], list[float]]:
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
    rows: list[list[tuple[Draw, list[_Trace]]]]
    rows = [[(draw, [one]) for draw in lines] for one in own]
    heights = [small_in] * n_results
    if has_raster:
        rows.append([(_draw_raster, [replace(one, look={"color": ORANGE}) for one in traces])])
        heights.append(raster_in)
    return rows, heights


def _scaled(
    panels: list[_Panel], column: str, ylim: tuple[float, float] | None
) -> list[tuple[_Panel, Scale]]:
    """Every panel with its vertical axis; those of one result each share the one of their kind."""
    limits, n_silent = ylim, None
    alone = [one.traces[0] for one in panels if one.draw is _draw_attenuation]
    if len(alone) > 1:
        silences, shown = zip(*(_silence(one) for one in alone), strict=True)
        limits, n_silent = limits or _span_db(shown), int(np.any([s.any() for s in silences]))
    scale = Scale(0.0, column)
    return [
        (
            one,
            scale._replace(height_in=one.height_in, limits=limits, n_silent=n_silent)
            if one.draw is _draw_attenuation
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
    for draw in (_draw_level, _draw_attenuation):
        group = [(one.axes, one.traces[0]) for one in panels if one.draw is draw]
        names = {axes.get_ylabel() for axes, _ in group}
        for axes, trace in group:
            if trace.label not in named:
                axes.text(0.0, 1.04, plain(trace.label), transform=axes.transAxes, fontsize=7)
            if draw is _draw_level:
                axes.yaxis.set_major_locator(MaxNLocator(2, steps=[1, 2, 5, 10]))
            axes.set_ylabel("")
        named |= {trace.label for _, trace in group}
        if group:
            # The label is longer than one panel: it stands beside the middle of all.
            text = names.pop() if len(names) == 1 else _EITHER
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


def thinned(time_s: Series, values: Series, n_points: int = MAX_POINTS) -> tuple[Series, Series]:
    """Reduce a series to at most `n_points`: the first time and the greatest value of each column.

    A column is NaN if all its values are, and flagged if any of its rows is.
    """
    if len(values) <= n_points:
        return time_s, values
    edges = np.linspace(time_s[0], time_s[-1], n_points, endpoint=False)
    starts = np.unique(np.searchsorted(time_s, edges))
    return time_s[starts], np.fmax.reduceat(values, starts)


def stretches(
    time_s: Series, flags: Flags, n_points: int = MAX_POINTS
) -> list[tuple[float, float]]:
    """Start and duration, in seconds, of every run of flagged rows.

    A row extends halfway to its neighbours.
    """
    times, any_flag = thinned(time_s, flags.astype(np.float64), n_points)
    half = np.diff(times) / 2 if len(times) > 1 else np.array([0.1])
    edges = np.concatenate(
        (times[:1] - half[:1], times[:-1] + half[: len(times) - 1], times[-1:] + half[-1:])
    )
    turns = np.flatnonzero(np.diff(np.concatenate(([0.0], any_flag, [0.0]))))
    return [(float(edges[a]), float(edges[b] - edges[a])) for a, b in turns.reshape(-1, 2)]


def heights_alone(names: Sequence[str]) -> list[float]:
    """Heights of the panels of one result, by their names, in inches."""
    return [(_RASTER_IN if name == "raster" else _HEIGHT_IN) - BETWEEN_IN for name in names]


def traces_of(results: Mapping[str, Result], emphasise: str | None = None) -> list[_Trace]:
    """The results as traces, each with its look; the emphasised one has the first."""
    others = [label for label in results if label != emphasise]
    order = [*([emphasise] if emphasise else ()), *others]
    looks = {}
    for place, label in enumerate(order):
        color, dashes = LOOKS[place % len(LOOKS)]
        looks[label] = {"color": color, "linestyle": dashes}
        if emphasise:
            looks[label] |= {**STRONG, "zorder": 2.5} if label == emphasise else _WEAK
    return [
        _Trace(label, result, looks[label], alone=len(results) == 1)
        for label, result in results.items()
    ]


def _draw_line(axes: Axes, trace: _Trace, values: Series) -> Entries:
    """Draw a line that breaks at NaN; an isolated value is a dot."""
    times, highest = thinned(trace.result.time_s, values, trace.n_points)
    known = np.concatenate(([False], ~np.isnan(highest), [False]))
    single = known[1:-1] & ~known[:-2] & ~known[2:]
    (line,) = axes.plot(times, highest, **trace.look)
    axes.plot(times[single], highest[single], ".", color=trace.look["color"], markersize=3)
    return [(line, trace.label)] if known.any() or not trace.alone else []


def _draw_collisions(panels: list[_Panel]) -> Entries:
    """Draw a black line at every collision of a result, in the raster a bar in the result's row."""
    are_equal = len({trace.collisions_s for one in panels for trace in one.traces}) == 1
    drawn: list[Any] = []
    for one in panels:
        n_rows = len(one.traces)
        for place, trace in enumerate(one.traces):
            look: Any = {"color": BLACK, "linewidth": 1.4, "zorder": 2.4}
            ends = (0.0, 1.0)
            if one.draw is _draw_raster and not trace.alone:
                ends = (n_rows - place - 1) / n_rows, (n_rows - place) / n_rows
            elif not are_equal:
                look["linestyle"] = trace.look.get("linestyle", "-")
            drawn += [one.axes.axvline(time_s, *ends, **look) for time_s in trace.collisions_s]
    mark = Line2D([], [], color=BLACK, linewidth=1.4)
    return [(mark, "collision")] if drawn else []


def _draw_level(axes: Axes, traces: list[_Trace], scale: Scale) -> Entries:
    """Draw the normalised potential, a shared threshold, and the events of a single result."""
    results, column = [trace.result for trace in traces], scale.column
    by_sequence = {r.by_sequence if column == "level" else column == "mp_seq" for r in results}
    levels: list[Series] = [getattr(result, column) for result in results]
    entries = []
    for trace, level in zip(traces, levels, strict=True):
        entries += _draw_line(axes, trace, level)
    thresholds = {result.threshold for result in results}
    is_level = all({result.by_sequence} == by_sequence for result in results)
    if len(thresholds) == 1 and (column == "level" or is_level):
        threshold = thresholds.pop()
        line = axes.axhline(threshold, color=GREY, linestyle="--", linewidth=0.8)
        entries.append((line, f"threshold {threshold:g}"))
    if traces[0].alone:
        entries += _draw_events(axes, traces[0], levels[0])
    if all(np.isnan(level).all() for level in levels):
        _note(axes, traces, "the membrane potential never changes")
    axes.set_ylim(scale.limits or _LEVELS)
    axes.set_ylabel(LEVEL_NAMES[by_sequence.pop()] if len(by_sequence) == 1 else _EITHER)
    return entries


def _draw_events(axes: Axes, trace: _Trace, level: Series) -> Entries:
    """Draw a dot at every spike, and a band at every alarm."""
    entries: Entries = []
    result = trace.result
    spiking_level = np.where(result.spikes, level, np.nan)
    times, levels = thinned(result.time_s, spiking_level, trace.n_points)
    spiking = ~np.isnan(levels)
    if spiking.any():
        look: Any = {"markersize": 3, "markeredgecolor": "black", "markeredgewidth": 0.3}
        if np.count_nonzero(spiking) > _MAX_RINGED:
            look = {"markersize": 2, "markeredgewidth": 0}
        look |= {"color": ORANGE, "zorder": 3, "clip_on": False}
        (dots,) = axes.plot(times[spiking], levels[spiking], "o", **look)
        entries.append((dots, "spike"))
    if result.alarms.any():
        lasting = stretches(result.time_s, result.alarmed, trace.n_points)
        bands = axes.broken_barh(
            lasting, (0, 1), alpha=0.3, color=VERMILION, linewidth=0.8,
            transform=axes.get_xaxis_transform(), zorder=0,
        )  # fmt: skip
        entries.append((bands, "alarm"))
    return entries


def _silence(trace: _Trace) -> tuple[Flags, Series]:
    """Where almost nothing passes, and the attenuation elsewhere."""
    silent = trace.result.attenuation_db < FLOOR_DB  # -inf, but not NaN
    return silent, np.where(silent, np.nan, trace.result.attenuation_db)


def _draw_attenuation(axes: Axes, traces: list[_Trace], scale: Scale) -> Entries:
    """Draw attenuation in dB; where nothing passes, marks below a break, in a row per result."""
    entries: Entries = []
    silences, shown = zip(*(_silence(trace) for trace in traces), strict=True)
    for trace, values in zip(traces, shown, strict=True):
        entries += _draw_line(axes, trace, values)
    silent = [(t, s) for t, s in zip(traces, silences, strict=True) if s.any()]
    if silent:
        mark = Line2D([], [], marker="v", linestyle="", color=GREY, markersize=3)
        entries.append((mark, f"nothing passes (< −{-FLOOR_DB:g} dB)"))
    elif all(np.isnan(values).all() for values in shown):
        _note(axes, traces, "no frame differs from the one before it")
    n_rows = len(silent) if scale.n_silent is None else scale.n_silent
    row = _MARKS_IN / scale.height_in
    lines = tuple(axes.lines)
    foot = _break_axis(axes, scale.limits or _span_db(shown), n_rows, scale.height_in)
    if n_rows and scale.limits:  # what lies below the limits does not cross the break
        edge = foot + _BREAK_IN / scale.height_in
        for line in lines:
            line.set_clip_path(Rectangle((0, edge), 1, 1 - edge, transform=axes.transAxes))
    for place, (trace, flags) in enumerate(silent, start=1):
        times, flagged = thinned(trace.result.time_s, flags.astype(np.float64), trace.n_points)
        marked = times[flagged > 0.0]
        color = GREY if trace.alone else trace.look["color"]
        look: Any = {"color": color, "markersize": 3}
        height = np.full(len(marked), foot - (place - 0.5) * row)
        axes.plot(marked, height, "v", transform=axes.get_xaxis_transform(), **look)
    axes.set_ylabel("Attenuation (dB)")
    return entries


def _break_axis(axes: Axes, limits: tuple[float, float], n_rows: int, height_in: float) -> float:
    """Set the limits and ticks of values, above a break and rows for −∞ if there are `n_rows`.

    Returns the height of these rows, as a share of the axes'.
    """
    low, high = limits
    gap, foot = (_BREAK_IN / height_in, n_rows * _MARKS_IN / height_in) if n_rows else (0.0, 0.0)
    bottom = high - (high - low) / (1.0 - gap - foot)
    axes.set_ylim(bottom, high)
    locator: Any = MaxNLocator(int(np.clip(5 * height_in, 2, 6)), steps=[1, 2, 5, 10])
    ticks = [float(tick) for tick in locator.tick_values(low, high) if low <= tick <= high]
    labels = [f"{tick:g}".replace("-", "−") for tick in ticks]
    if n_rows:
        ticks, labels = [*ticks, bottom + (high - bottom) * foot / 2], [*labels, "−∞"]
        # Two strokes across the axis, which is interrupted between them.
        stroke: Any = {"marker": [(-1, -0.4), (1, 0.4)], "markersize": 5, "markeredgewidth": 0.6}
        ends = foot + gap * np.array([0.3, 0.7])
        look: Any = {"color": "white", "linewidth": 1.5, "markeredgecolor": "black", "zorder": 3}
        axes.plot([0, 0], ends, transform=axes.transAxes, clip_on=False, **look, **stroke)
    axes.set_yticks(ticks, labels)
    return foot


def _span_db(shown: Sequence[Series]) -> tuple[float, float]:
    """Limits of the vertical axis."""
    drawn = np.concatenate([thinned(np.arange(float(len(v))), v)[1] for v in shown])
    known = drawn[~np.isnan(drawn)]
    if not known.size:
        return FLOOR_DB, 0.0
    low, high = float(known.min()), float(known.max())
    missing = max(0.0, MIN_SPAN_DB - (high - low)) / 2
    margin = 0.1 * max(high - low, MIN_SPAN_DB)
    return low - missing - margin, high + missing + margin


def _draw_raster(axes: Axes, traces: list[_Trace], _: Scale) -> Entries:
    """Draw a row of spikes and a row of alarms; with several results, a row with both for each."""
    axes.tick_params(axis="y", length=0)
    if traces[0].alone:
        trace = traces[0]
        _draw_bars(axes, trace, trace.result.spikes, (0.65, 1.35), ORANGE)
        _draw_bars(axes, trace, trace.result.alarmed, (-0.35, 0.35), VERMILION)
        axes.set_yticks([1, 0], ["spikes", "alarm"])
        axes.set_ylim(-0.6, 1.6)
        return []
    for row, trace in enumerate(reversed(traces)):
        _draw_bars(axes, trace, trace.result.spikes, (row - 0.1, row + 0.4), trace.look["color"])
        _draw_bars(axes, trace, trace.result.alarmed, (row - 0.4, row - 0.15), VERMILION)
    names = [plain(trace.label, _LONGEST_ROW_NAME) for trace in reversed(traces)]
    axes.set_yticks(range(len(traces)), names, fontsize=6.5)
    axes.set_ylim(-0.5, len(traces) - 0.5)
    colors = {trace.look["color"] for trace in traces}
    return [
        (Line2D([], [], color=color, marker="|", linestyle="", markeredgewidth=1.2), text)
        for color, text in (
            (colors.pop() if len(colors) == 1 else GREY, "spike"),
            (VERMILION, "alarm"),
        )
    ]


def _draw_bars(
    axes: Axes, trace: _Trace, flags: Flags, reach: tuple[float, float], color: str
) -> None:
    """Draw a bar over every run of flagged rows, between two heights."""
    low, high = reach
    bars = stretches(trace.result.time_s, flags, trace.n_points)
    axes.broken_barh(bars, (low, high - low), color=color, linewidth=0.4)


def _note(axes: Axes, traces: list[_Trace], unchanged: str) -> None:
    """Say why there is no line: too few frames, or what `unchanged` says."""
    n_short = sum(trace.result.n_valid == 0 for trace in traces)
    reasons = ["too few frames"] * (n_short > 0) + [unchanged] * (n_short < len(traces))
    why = ", or ".join(reasons)
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 1}
    axes.text(
        0.5, 0.5, f"undefined: {why}", transform=axes.transAxes, ha="center", va="center",
        color=GREY, fontsize=7, bbox=ground,
    )  # fmt: skip


# A function that draws results in a panel: axes, results, vertical axis.
Draw = Callable[[Axes, list[_Trace], Scale], Entries]
# By the names of the panels in `KINDS`.
DRAWS: dict[str, Draw] = {
    "level": _draw_level,
    "attenuation": _draw_attenuation,
    "raster": _draw_raster,
}
