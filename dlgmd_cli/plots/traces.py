"""Figures of results over time: membrane potential, attenuation, spikes and alarms."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.annotations import NONE, Annotations
from dlgmd_cli.plots.style import (
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
from dlgmd_cli.words import threshold_text

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
_HEIGHT_IN, _RASTER_IN, _RASTER_ROW_IN, _AXES_LABELS_IN = 1.25, 0.4, 0.16, 0.75
# Margins around the panels: labels below and on the left, frame numbers above; and between them.
_LEFT_IN, _RIGHT_IN, BELOW_IN, ABOVE_IN, BETWEEN_IN = 0.58, 0.08, 0.4, 0.43, 0.08
# Heights with a panel per result: all panels together; least and greatest height of one; its name.
_SMALL_IN, _LEAST_SMALL_IN, _MOST_SMALL_IN, _NAME_IN = 4.5, 0.3, 0.6, 0.17
# Height of a page without margins, and of the lowest legible panel.
_PAGE_IN, _LEGIBLE_IN = 9.0, 0.18

# Greatest number of characters of a name beside a row of spikes.
_LONGEST_ROW_NAME = 18
# More dots than this touch each other, and their black rims would hide everything else.
_MAX_RINGED = 200


@dataclass(frozen=True)
class _Trace:
    """A result and the look of its line; if it is `alone`, its spikes and alarms are shown, too."""

    label: str
    result: Result
    look: dict[str, Any]
    alone: bool


def plot(
    kind: str,
    results: Mapping[str, Result],
    annotations: Annotations = NONE,
    *,
    column: str | None = None,
    width: Width = "one",
) -> Figure:
    """Draw results over time.

    Parameters
    ----------
    kind : str
        "mp": the normalised membrane potential, with the threshold if all results share it.
        "attenuation": 10 lg(ΣS/ΣP) in dB, with a gap where it is undefined and a mark where almost
        nothing passes. "spikes": spikes and alarms above the potential that caused them.
        "overview": all of these.
    results : mapping of str to Result
        By label, in the order of the legend; at least one, each with at least one frame. More than
        four have a panel each. A result that is alone in its panel also shows its spikes and
        alarms. For a long result, the maximum of every pixel column is drawn.
    annotations : Annotations
        Annotated frames, drawn at the times of the first result.
    column : "level", "mp_abs" or "mp_seq", optional
        The potential to draw: the one that is compared with the threshold (default), the absolute
        one, or the one scaled to the extremes of its sequence.
    width : "one" or "two"
        Columns of the paper that the figure takes.

    Raises
    ------
    ValueError
        If there is no result, or `kind`, `column` or `width` is not one of these.
    """
    if not results:
        raise ValueError("there is no result to draw")
    if kind not in KINDS:
        raise ValueError(f"kind is {kind!r}, none of {', '.join(KINDS)}")
    column = column or "level"
    if column not in COLUMNS:
        raise ValueError(f"column is {column!r}, none of {', '.join(COLUMNS)}")
    panels, heights = _panels(KINDS[kind], results)
    is_split = len(results) > MAX_TOGETHER
    is_alone = len(results) == 1 and annotations == NONE
    between_in, margins_in = _NAME_IN if is_split else 0.0, _AXES_LABELS_IN
    if is_alone:
        heights = heights_alone(KINDS[kind])
        between_in, margins_in = BETWEEN_IN, ABOVE_IN + BELOW_IN
    with house_style():
        figure = new_figure(1.0, width)
        timeline = Timeline.of(results.values())
        above = [ROW_IN] if annotations != NONE or is_split else []
        grid: Any = figure.subplots(
            len(above) + len(panels), sharex=True, squeeze=False, height_ratios=above + heights
        )
        highest, axes_of = grid[0, 0], list(grid[len(above) :, 0])
        found = [
            draw(axes, traces, column) for axes, (draw, traces) in zip(axes_of, panels, strict=True)
        ]
        if is_split:
            found = _share(axes_of, panels, found)
        timeline.label(axes_of[-1], axes_of[0] if not above else highest)
        if above:
            n_rows = draw_annotations(annotations, timeline, highest, axes_of)
            above = [max(n_rows, 0.1) * ROW_IN]
            highest.get_gridspec().set_height_ratios(above + heights)
        for axes in grid[:, 0]:  # no lines between panels: only the lowest keeps its time axis
            axes.spines["top"].set_visible(False)
        for axes in grid[:-1, 0]:
            axes.spines["bottom"].set_visible(False)
            axes.tick_params(axis="x", bottom=False)
        figure.align_ylabels([axes for axes in axes_of if axes.get_ylabel()])
        heights = above + heights
        figure.set_figheight(sum(heights) + between_in * (len(heights) - 1) + margins_in)
        ordered = found if kind != "spikes" else found[::-1]
        legend_in = add_legend(figure, [entry for some in ordered for entry in some])
        if is_split or is_alone:
            fix_margins(figure, heights, between_in, legend_in)
    return figure


def _panels(
    draws: tuple["_Draw", ...], results: Mapping[str, Result]
) -> tuple[list[tuple["_Draw", list[_Trace]]], list[float]]:
    """For each panel, from the top down: its drawing function and results, and its height in in."""
    raster_in = max(_RASTER_IN, _RASTER_ROW_IN * len(results))
    if len(results) <= MAX_TOGETHER:
        together = traces_of(results)
        heights = [raster_in if draw is _draw_raster else _HEIGHT_IN for draw in draws]
        return [(draw, together) for draw in draws], heights
    n_small = sum(draw is not _draw_raster for draw in draws) * len(results)
    # So that the figure fits on a page, if its panels stay legible.
    room_in = _PAGE_IN - raster_in - _AXES_LABELS_IN - _NAME_IN * n_small
    small_in = min(max(_SMALL_IN / n_small, _LEAST_SMALL_IN), _MOST_SMALL_IN)
    small_in = min(small_in, max(room_in / n_small, _LEGIBLE_IN))
    apart = [trace for label, one in results.items() for trace in traces_of({label: one})]
    panels: list[tuple[_Draw, list[_Trace]]] = []
    heights = []
    for draw in draws:
        if draw is _draw_raster:
            rows = [replace(trace, look={"color": ORANGE}, alone=False) for trace in apart]
            panels.append((draw, rows))
            heights.append(raster_in)
        else:
            panels += [(draw, [trace]) for trace in apart]
            heights += [small_in] * len(apart)
    return panels, heights


def _share(
    axes_of: list[Axes], panels: list[tuple["_Draw", list[_Trace]]], found: list[Entries]
) -> list[Entries]:
    """Name the panels of one result each, and give each kind of panel one scale and one label.

    Returns the entries of the legend without those of the lines, and with one for all thresholds if
    they differ.
    """

    for kind in (_draw_level, _draw_attenuation):
        group = [
            (axes, traces[0])
            for axes, (draw, traces) in zip(axes_of, panels, strict=True)
            if draw is kind
        ]
        if not group:
            continue
        lows, highs = zip(*(axes.get_ylim() for axes, _ in group), strict=True)
        names = {axes.get_ylabel() for axes, _ in group}
        for axes, trace in group:
            axes.text(0.0, 1.04, plain(trace.label), transform=axes.transAxes, fontsize=7)
            axes.set_ylim(min(lows), max(highs))
            axes.yaxis.set_major_locator(MaxNLocator(2, steps=[1, 2, 5, 10]))
            axes.set_ylabel("")
        # The label is longer than one panel: it stands beside the middle of all.
        label = group[len(group) // 2][0].set_ylabel(names.pop() if len(names) == 1 else _EITHER)
        label.set_y(0.5 if len(group) % 2 else 1.0)
    thresholds = {text for some in found for _, text in some if text.startswith("threshold ")}
    names_of_lines = {trace.label for _, traces in panels for trace in traces}
    return [
        [
            (handle, "threshold" if text in thresholds and len(thresholds) > 1 else text)
            for handle, text in some
            if text not in names_of_lines
        ]
        for some in found
    ]


def fix_margins(figure: Figure, heights: list[float], between_in: float, legend_in: float) -> None:
    """Lay out figures of one result, which every run draws, and figures with many panels.

    `heights` are those of the panels, in inches. The widths of their labels are known, and
    Matplotlib's layout would take as long as drawing.
    """
    figure.set_layout_engine(None)
    width, height = figure.get_size_inches()
    ticks = [text for axes in figure.axes for text in axes.get_yticklabels() if text.get_text()]
    longest_in = max((text.get_window_extent().width for text in ticks), default=0.0) / figure.dpi
    figure.subplots_adjust(
        left=max(_LEFT_IN, longest_in + 0.1) / width,
        right=1.0 - _RIGHT_IN / width,
        bottom=BELOW_IN / height,
        top=1.0 - (ABOVE_IN + legend_in) / height,
        hspace=between_in * len(heights) / sum(heights),
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


def stretches(time_s: Series, flags: Flags) -> list[tuple[float, float]]:
    """Start and duration, in seconds, of every run of flagged rows.

    A row extends halfway to its neighbours.
    """
    times, any_flag = thinned(time_s, flags.astype(np.float64))
    half = np.diff(times) / 2 if len(times) > 1 else np.array([0.1])
    edges = np.concatenate(
        (times[:1] - half[:1], times[:-1] + half[: len(times) - 1], times[-1:] + half[-1:])
    )
    turns = np.flatnonzero(np.diff(np.concatenate(([0.0], any_flag, [0.0]))))
    return [(float(edges[a]), float(edges[b] - edges[a])) for a, b in turns.reshape(-1, 2)]


def heights_alone(draws: Sequence["_Draw"]) -> list[float]:
    """Heights of the panels of one result, in inches."""
    return [(_RASTER_IN if draw is _draw_raster else _HEIGHT_IN) - BETWEEN_IN for draw in draws]


def traces_of(results: Mapping[str, Result]) -> list[_Trace]:
    """The results as traces, each with its look."""
    return [
        _Trace(label, result, {"color": color, "linestyle": dashes}, alone=len(results) == 1)
        for (label, result), (color, dashes) in zip(results.items(), LOOKS, strict=False)
    ]


def _draw_line(axes: Axes, trace: _Trace, values: Series) -> Entries:
    """Draw a line that breaks at NaN; an isolated value is a dot."""
    times, highest = thinned(trace.result.time_s, values)
    known = np.concatenate(([False], ~np.isnan(highest), [False]))
    single = known[1:-1] & ~known[:-2] & ~known[2:]
    (line,) = axes.plot(times, highest, **trace.look)
    axes.plot(times[single], highest[single], ".", color=trace.look["color"], markersize=3)
    return [(line, trace.label)] if known.any() or not trace.alone else []


def _draw_level(axes: Axes, traces: list[_Trace], column: str) -> Entries:
    """Draw the normalised potential, a shared threshold, and the events of a single result."""
    results = [trace.result for trace in traces]
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
        entries.append((line, f"threshold {threshold_text(threshold)}"))
    if traces[0].alone:
        entries += _draw_events(axes, results[0], levels[0])
    if all(np.isnan(level).all() for level in levels):
        _note(axes, traces, "the membrane potential never changes")
    axes.set_ylim(-0.03, 1.05)
    axes.set_ylabel(LEVEL_NAMES[by_sequence.pop()] if len(by_sequence) == 1 else _EITHER)
    return entries


def _draw_events(axes: Axes, result: Result, level: Series) -> Entries:
    """Draw a dot at every spike, and a band at every alarm."""
    entries: Entries = []
    times, levels = thinned(result.time_s, np.where(result.spikes, level, np.nan))
    spiking = ~np.isnan(levels)
    if spiking.any():
        look: Any = {"markersize": 3, "markeredgecolor": "black", "markeredgewidth": 0.3}
        if np.count_nonzero(spiking) > _MAX_RINGED:
            look = {"markersize": 2, "markeredgewidth": 0}
        look |= {"color": ORANGE, "zorder": 3, "clip_on": False}
        (dots,) = axes.plot(times[spiking], levels[spiking], "o", **look)
        entries.append((dots, "spike"))
    if result.alarms.any():
        bands = axes.broken_barh(
            stretches(result.time_s, result.alarmed), (0, 1), alpha=0.3, color=VERMILION,
            linewidth=0.8, transform=axes.get_xaxis_transform(), zorder=0,
        )  # fmt: skip
        entries.append((bands, "alarm"))
    return entries


def _draw_attenuation(axes: Axes, traces: list[_Trace], _: str) -> Entries:
    """Draw attenuation in dB; where nothing passes, marks below, in one row per result."""
    entries: Entries = []
    silences = [trace.result.attenuation_db < FLOOR_DB for trace in traces]  # -inf, but not NaN
    shown = [
        np.where(silent, np.nan, trace.result.attenuation_db)
        for trace, silent in zip(traces, silences, strict=True)
    ]
    for trace, values in zip(traces, shown, strict=True):
        entries += _draw_line(axes, trace, values)
    rows = [place for place, silent in enumerate(silences) if silent.any()]
    for row, place in enumerate(reversed(rows)):
        times, silent = thinned(traces[place].result.time_s, silences[place].astype(np.float64))
        marked = times[silent > 0.0]
        height = np.full(len(marked), 0.04 + 0.06 * row)
        color = GREY if traces[place].alone else traces[place].look["color"]
        look: Any = {"color": color, "markersize": 3}
        axes.plot(marked, height, "v", transform=axes.get_xaxis_transform(), **look)
    if rows:
        mark = Line2D([], [], marker="v", linestyle="", color=GREY, markersize=3)
        entries.append((mark, f"nothing passes (< −{-FLOOR_DB:g} dB)"))
    elif all(np.isnan(values).all() for values in shown):
        _note(axes, traces, "no frame differs from the one before it")
    axes.set_ylim(*_span_db(shown, 0.06 * len(rows)))
    axes.set_ylabel("Attenuation (dB)")
    return entries


def _span_db(shown: list[Series], foot: float) -> tuple[float, float]:
    """Limits of the vertical axis; `foot` is the share of it that stays free below the values."""
    drawn = np.concatenate([thinned(np.arange(float(len(v))), v)[1] for v in shown])
    known = drawn[~np.isnan(drawn)]
    if not known.size:
        return FLOOR_DB, 0.0
    low, high = float(known.min()), float(known.max())
    missing = max(0.0, MIN_SPAN_DB - (high - low)) / 2
    margin = 0.1 * max(high - low, MIN_SPAN_DB)
    low, high = low - missing - margin, high + missing + margin
    return high - (high - low) / (1.0 - foot), high


def _draw_raster(axes: Axes, traces: list[_Trace], _: str) -> Entries:
    """Draw a row of spikes and a row of alarms; with several results, a row with both for each."""
    axes.tick_params(axis="y", length=0)
    if traces[0].alone:
        result = traces[0].result
        _draw_bars(axes, result, result.spikes, (0.65, 1.35), ORANGE)
        _draw_bars(axes, result, result.alarmed, (-0.35, 0.35), VERMILION)
        axes.set_yticks([1, 0], ["spikes", "alarm"])
        axes.set_ylim(-0.6, 1.6)
        return []
    for row, trace in enumerate(reversed(traces)):
        look = trace.look
        _draw_bars(axes, trace.result, trace.result.spikes, (row - 0.1, row + 0.4), look["color"])
        _draw_bars(axes, trace.result, trace.result.alarmed, (row - 0.4, row - 0.15), VERMILION)
    names = [plain(trace.label, _LONGEST_ROW_NAME) for trace in reversed(traces)]
    axes.set_yticks(range(len(traces)), names, fontsize=6.5)
    axes.set_ylim(-0.6, len(traces) - 0.4)
    colors = {trace.look["color"] for trace in traces}
    return [
        (Line2D([], [], color=color, marker="|", linestyle="", markeredgewidth=1.2), text)
        for color, text in (
            (colors.pop() if len(colors) == 1 else GREY, "spikes"),
            (VERMILION, "alarm"),
        )
    ]


def _draw_bars(
    axes: Axes, result: Result, flags: Flags, reach: tuple[float, float], color: str
) -> None:
    """Draw a bar over every run of flagged rows, between two heights."""
    low, high = reach
    bars = stretches(result.time_s, flags)
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


# A function that draws results in a panel: axes, results, column of the potential.
_Draw = Callable[[Axes, list[_Trace], str], Entries]
# The panels of each figure, from the top down.
KINDS: dict[str, tuple[_Draw, ...]] = {
    "mp": (_draw_level,),
    "attenuation": (_draw_attenuation,),
    "spikes": (_draw_raster, _draw_level),
    "overview": (_draw_level, _draw_attenuation, _draw_raster),
}
