"""Figures of results over time: membrane potential, attenuation, spikes and alarms."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.errors import ParameterError, argument, warn
from dlgmd_cli.parameters.checks import require_known
from dlgmd_cli.plots import curves, style
from dlgmd_cli.plots.timeline import ROW_IN, Timeline, draw_annotations
from dlgmd_cli.results.annotations import KINDS, NONE, Annotations, Mark
from dlgmd_cli.results.result import Result

# Most results in one panel, and most attenuations, which have gaps and jumps; more: a row each.
# With `one_panel`, up to _MAX_ON_REQUEST results.
MAX_TOGETHER, _MAX_ATTENUATIONS, _MAX_ON_REQUEST = 4, 2, 8
_RASTER_ROW_IN, _AXES_LABELS_IN = 0.16, 0.75
# Inches: left margin, distance of its axis labels from the figure's edge, right margin; then the
# margin below, the margin with frame numbers above, and the space between panels.
_LEFT_IN, _LABEL_IN, _RIGHT_IN = 0.58, 0.16, 0.15
_BELOW_IN, _ABOVE_IN, _BETWEEN_IN = 0.4, 0.43, 0.08
# Inches, with a row of panels per result: all rows together, the lowest and the highest row, and
# the name above a row.
_SMALL_IN, _LEAST_SMALL_IN, _MOST_SMALL_IN, _NAME_IN = 5.5, 0.3, 0.6, 0.17
# Inches: height of a page without margins and legend, and of the lowest legible panel.
_PAGE_IN, _LEGIBLE_IN = 8.5, 0.18


def plot(
    kind: str,
    results: Mapping[str, Result],
    annotations: Annotations = NONE,
    *,
    column: str | None = None,
    width: style.Width = "one",
    emphasise: str | None = None,
    collisions: Mapping[str, Sequence[int]] | None = None,
    until: str | None = None,
    one_panel: bool = False,
    xlim: tuple[float, float] | None = None,
    ylim: tuple[float, float] | None = None,
    ax: Axes | None = None,
    mark: Iterable[Mark] = (),
    span: Iterable[tuple[int, int, str]] = (),
    collision_frame: int | None = None,
    false_positive_frame: int | None = None,
) -> style.Figure:
    """Draw results over time.

    Parameters
    ----------
    kind : str
        "mp": the normalised membrane potential, with the threshold if all results share it, above
        the expansion rate and the time to contact. "attenuation": 10 lg(ΣS/ΣP) in dB, with a gap
        where it is undefined and marks at the foot of the axis where almost nothing passes.
        "spikes": the potential above spikes and alarms. "ttc": the expansion rate and the time to
        contact, with the true time before known collisions. "overview": all of these. Any other
        name is a column, such as one of the model's own.
    results : mapping of str to Result
        By label, in the order of the legend; at least one, each with at least one frame. More than
        four results, or two attenuations, have a row of panels each. A result alone in its panel
        also shows its spikes and alarms. For a long result, the maximum of every pixel column is
        drawn.
    annotations : Annotations
        Annotated frames, drawn at the times of the first result.
    column : "level", "mp_abs" or "mp_seq", optional
        The potential to draw: the potential that is compared with the threshold (default), on a
        fixed scale, or as per-video min–max.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    emphasise : str, optional
        Label of the result whose line is the strongest: blue and thick.
    collisions : mapping of str to sequence of int, optional
        Frames of collisions by label: black lines, dashed like the result's line unless all results
        have the same frames. Results without an entry show the collision in their own record.
    until : "collision", optional
        Show the time up to the last collision only; the time axis says so. No scale changes.
    one_panel : bool
        Draw the highest panel of the kind alone, with up to eight results in it.
    xlim, ylim : (float, float), optional
        Limits of the time axis in s, and of the highest panel: the potential, or in "attenuation"
        the attenuation in dB.
    ax : Axes, optional
        Draw the highest panel of the kind alone, into these axes of an existing figure.
    mark : iterable of (int, str) or (str, int, str)
        Texts at frames; with a result's label before the frame, for that result alone.
    span : iterable of (int, int, str)
        Texts over ranges of frames: first frame, last frame, text.
    collision_frame, false_positive_frame : int, optional
        Frames of the true collision, and of a false alarm.

    Raises
    ------
    ParameterError
        If an annotation is not valid.
    ValueError
        If there is no result, `kind`, `column` or `width` is unknown, `emphasise` is no label, or
        `ylim` is given for the two scales of "overview".
    """
    _check(kind, results, column or "level", emphasise, ylim)
    annotations = annotations.plus(mark, span, collision_frame, false_positive_frame)
    annotations.require(results)
    traces = [
        with_contacts(trace, collisions or {}, annotations.collision_frame)
        for trace in curves.traces_of(results, emphasise)
    ]
    timeline = replace(Timeline.of(results.values()), limits=xlim)
    if until is not None:
        timeline = _until_collision(until, timeline, traces)
        xlim = timeline.limits
    share = (timeline.end_s - timeline.start_s) / np.ptp(xlim) if xlim else 1.0
    n_columns = int(curves.MAX_COLUMNS * max(1.0, share))

    traces = [
        replace(
            trace,
            n_columns=n_columns,
            marks=tuple(
                (time_s, text)
                for frame, text in annotations.of_result(trace.label)
                for time_s in trace.result.times_of([frame])
            ),
        )
        for trace in traces
    ]
    if ax is not None:
        require_axes(ax)
        limits = {"xlim": xlim, "ylim": ylim}
        _draw_on(ax, kind, traces, timeline, annotations, column or "level", **limits)
        return ax.figure  # type: ignore[return-value]
    names = curves.panels_of(kind, [trace.result for trace in traces])
    names = names[:1] if one_panel else names
    is_apart = _are_apart(names[0], traces, one_panel=one_panel)
    is_annotated = bool(annotations.remarks())
    layout = _layout(names, traces, timeline, is_apart=is_apart, is_annotated=is_annotated)
    with style.house_style():
        figure = style.new_figure(1.0, width)
        panels, grid = _panels_in(figure, layout)
        entries = _draw(panels, column or "level", xlim, ylim)
        if is_apart:
            entries = _share(panels, entries)
        for axes_of in grid.T:
            timeline.label(axes_of[-1], axes_of[0])
        if len(grid) > len(layout.rows):
            n_rows = [draw_annotations(annotations, timeline, a[0], a[1:]) for a in grid.T]
            layout.heights[0] = max(*n_rows, 0.1) * ROW_IN
            grid[0, 0].get_gridspec().set_height_ratios(layout.heights)
        _join(grid)
        figure.align_ylabels([panel.axes for panel in panels if panel.axes.get_ylabel()])
        _finish(figure, layout, [entry for some in entries for entry in some])
    return figure


def require_axes(ax: Axes) -> Axes:
    """`ax` unchanged; raises ParameterError if `ax` is not an Axes."""
    if not isinstance(ax, Axes):
        why = f"ax is of the type {type(ax).__name__}, but the highest panel is drawn into one Axes"
        raise ParameterError("", why, "Give one of them, or leave it out for all panels.")
    return ax


def _draw_on(
    axes: Axes,
    kind: str,
    traces: list[curves.Trace],
    timeline: Timeline,
    annotations: Annotations,
    column: str,
    *,
    xlim: tuple[float, float] | None,
    ylim: tuple[float, float] | None,
) -> None:
    """Draw into the caller's axes, with a legend inside, and the annotations above."""
    name, *_ = curves.panels_of(kind, [trace.result for trace in traces])
    height_in = axes.get_window_extent().height / axes.figure.dpi
    entries = _draw([_Panel(axes, name, traces, height_in)], column, xlim, ylim)
    axes.set(xlim=timeline.view, xlabel=timeline.axis_name)
    if n_rows := len(annotations.remarks()):
        strip = axes.inset_axes((0.0, 1.0, 1.0, n_rows * ROW_IN / height_in))
        strip.set(xlim=timeline.view, xticks=[])
        strip.patch.set_visible(False)
        strip.spines[:].set_visible(False)
        draw_annotations(annotations, timeline, strip, [axes])
        strip.set_ylim(0.0, n_rows)
    named = {
        style.plain(text): handle for some in reversed(entries) for handle, text in reversed(some)
    }
    axes.legend([*named.values()][::-1], [*named][::-1], fontsize="small")


class _Layout(NamedTuple):
    """The panels of each row, and heights in inches; `heights` may begin with empty rows.

    If there is space between the rows, `_fix_margins` lays out the figure instead of Matplotlib.
    """

    rows: list[list[tuple[str, list[curves.Trace]]]]
    heights: list[float]
    between_in: float
    margins_in: float


def _layout(
    names: tuple[str, ...],
    traces: list[curves.Trace],
    timeline: Timeline,
    *,
    is_apart: bool,
    is_annotated: bool,
) -> _Layout:
    """The rows of panels for one result, for some together, or for many with a row each."""
    rows, heights = _rows(names, traces, is_apart=is_apart)
    if len(traces) == 1 and not is_annotated:
        heights = [curves.panel_of(name).height_in - _BETWEEN_IN for name in names]
        return _Layout(rows, heights, _BETWEEN_IN, _ABOVE_IN + _BELOW_IN)
    if is_apart:
        margins_in = (_ABOVE_IN if timeline.is_shared else 0.05) + _BELOW_IN
        return _Layout(rows, [ROW_IN, *heights], _NAME_IN, margins_in)
    above = [ROW_IN] if is_annotated else []
    return _Layout(rows, above + heights, 0.0, _AXES_LABELS_IN)


def _draw(
    panels: "list[_Panel]",
    column: str,
    xlim: tuple[float, float] | None,
    ylim: tuple[float, float] | None,
) -> list[style.Entries]:
    """Draw the lines of every panel, and the collisions; returns each panel's legend entries."""
    entries = [
        curves.panel_of(panel.name).draw(panel.axes, panel.traces, scale)
        for panel, scale in _scaled(panels, column, ylim)
    ]
    entries.append(_draw_collisions(panels))
    _draw_own_marks(panels)
    if xlim or ylim:  # dots of spikes may lie outside the limits
        for dots in (line for panel in panels for line in panel.axes.lines):
            dots.set_clip_on(dots.get_clip_on() or dots.get_marker() == "o")
    return entries


def _panels_in(
    figure: style.Figure, layout: _Layout
) -> tuple[list["_Panel"], npt.NDArray[np.object_]]:
    """The panels of a layout, row by row, and the grid of all axes, empty rows included."""
    heights, rows = layout.heights, layout.rows
    shape = len(heights), len(rows[0])
    grid = figure.subplots(*shape, sharex=True, squeeze=False, height_ratios=heights)
    below = zip(grid[-len(rows) :], rows, heights[-len(rows) :], strict=True)
    panels = [
        _Panel(axes, *content, height_in)
        for axes_of, row, height_in in below
        for axes, content in zip(axes_of, row, strict=True)
    ]
    return panels, grid


def _finish(figure: style.Figure, layout: _Layout, entries: style.Entries) -> None:
    """Give a figure its height, its legend and, with space between its rows, its margins."""
    between_in = layout.between_in * (len(layout.heights) - 1)
    height_in = sum(layout.heights) + between_in + layout.margins_in
    figure.set_figheight(height_in * style.text_scale())
    legend_in = style.add_legend(figure, entries)
    if layout.between_in and style.text_scale() == 1.0:
        above_in = layout.margins_in - _BELOW_IN + legend_in
        _fix_margins(figure, layout.heights, layout.between_in, above_in)


def _join(grid: npt.NDArray) -> None:
    """Leave out what divides the panels: only the lowest row keeps its time axis."""
    for axes in grid[1:].flat:
        axes.patch.set_visible(False)  # it would hide words below the panel above
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
    """Raise ValueError if the arguments of `plot` cannot be drawn."""
    if not results:
        raise ValueError("there is no result to draw")
    of_models = set.intersection(
        *(set(result.rows.dtype.names or ()) for result in results.values())
    )
    for name, value, known, more in (
        ("kind", kind, KINDS, of_models),
        ("column", column, curves.MP_COLUMNS, ()),
        ("emphasise", emphasise or next(iter(results)), results, ()),
    ):
        if value not in (*known, *more):
            raise ValueError(f"{name} is {value!r}, none of {', '.join(known)}")
    if ylim and kind == "overview":
        raise ValueError("ylim is for one scale, and an overview has several")


class _Panel(NamedTuple):
    """Axes, the name of the panel, the traces it shows, and its height in inches."""

    axes: Axes
    name: str
    traces: list[curves.Trace]
    height_in: float


def with_contacts(
    trace: curves.Trace, collisions: Mapping[str, Sequence[int]], annotated: int | None
) -> curves.Trace:
    """The trace of a result with its collisions: given, annotated, or in the result's record.

    Annotated collisions have lines of their own; collisions outside the result have no line.
    """
    result, known_s = trace.result, trace.result.contact_s
    given = collisions.get(trace.label)
    if given is None and annotated is None and known_s is not None:
        within = (known_s,) if known_s <= result.time_s[-1] else ()
        return replace(trace, collisions_s=within, contacts_s=(known_s,))
    at = [] if annotated is None else [annotated]
    times = tuple(result.times_of(at if given is None else given))
    return replace(trace, collisions_s=() if given is None else times, contacts_s=times)


def _until_collision(until: str, timeline: Timeline, traces: Iterable[curves.Trace]) -> Timeline:
    """The timeline up to the last collision; all of it, with a warning, if none is known."""
    require_known("until", until, ("collision",))
    low, high = timeline.view
    last_s = max((time_s for trace in traces for time_s in trace.contacts_s), default=low)
    if last_s <= low:
        warn(f"{argument('until')}: no collision is known in the time that is shown; all is drawn")
        return timeline
    axis_name = "Time (s), up to the collision"
    return replace(timeline, limits=(low, min(high, last_s)), axis_name=axis_name)


def _are_apart(name: str, traces: Sequence[curves.Trace], *, one_panel: bool) -> bool:
    """Whether each result has a row of panels; `name` is the highest panel's."""
    if one_panel and len(traces) > _MAX_ON_REQUEST:
        most = f"at most {_MAX_ON_REQUEST} results"
        warn(f"{argument('one_panel')}: {len(traces)} have a row each; one panel shows {most}")
    if one_panel:
        return len(traces) > _MAX_ON_REQUEST
    return len(traces) > (_MAX_ATTENUATIONS if name == "attenuation" else MAX_TOGETHER)


def _rows(
    names: tuple[str, ...], traces: list[curves.Trace], *, is_apart: bool
) -> tuple[list[list[tuple[str, list[curves.Trace]]]], list[float]]:
    """The names and results of the panels, row by row, and the rows' heights in inches."""
    n_results = len(traces)
    raster_in = max(curves.panel_of("raster").height_in, _RASTER_ROW_IN * n_results)
    if not is_apart:
        heights = [
            raster_in if name == "raster" else curves.panel_of(name).height_in for name in names
        ]
        return [[(name, traces)] for name in names], heights
    # Each row has room for the potential and the attenuation, not for the expansion as well. With
    # both, the raster is left out: the panels of the potential show the same spikes and alarms.
    lines = [name for name in names if name != "raster"]
    if names[0] == "level":
        lines = [name for name in ("level", "attenuation") if name in names]
    has_raster = "raster" in names and len(lines) == 1
    room_in = _PAGE_IN - _ABOVE_IN - _BELOW_IN - _NAME_IN * n_results - raster_in * has_raster
    small_in = min(max(_SMALL_IN / n_results, _LEAST_SMALL_IN), _MOST_SMALL_IN)
    small_in = max(min(small_in, room_in / n_results), _LEGIBLE_IN)
    # Up to four results share a panel in other figures: each keeps its colour from there.
    usual, dashes = curves.LOOKS[0]
    colors = [t.look["color"] if n_results <= MAX_TOGETHER else usual for t in traces]
    each = [
        replace(trace, look={**trace.look, "color": color, "linestyle": dashes}, alone=True)
        for trace, color in zip(traces, colors, strict=True)
    ]
    rows = [[(name, [trace]) for name in lines] for trace in each]
    heights = [small_in] * n_results
    if has_raster:
        rows.append(
            [("raster", [replace(trace, look={"color": style.ORANGE}) for trace in traces])]
        )
        heights.append(raster_in)
    return rows, heights


def _scaled(
    panels: list[_Panel], column: str, ylim: tuple[float, float] | None
) -> list[tuple[_Panel, curves.AxisScale]]:
    """Every panel with its vertical axis; panels of one attenuation each share its limits."""
    scale = curves.AxisScale(0.0, column)
    of = {panels[0].name: scale._replace(limits=ylim)}
    alone = [panel.traces[0] for panel in panels if panel.name == "attenuation"]
    if len(alone) > 1:
        limits = ylim or curves.span_db([curves.silence(trace)[1] for trace in alone])
        of["attenuation"] = scale._replace(limits=limits)
    return [(p, of.get(p.name, scale)._replace(height_in=p.height_in)) for p in panels]


def _share(panels: list[_Panel], entries: list[style.Entries]) -> list[style.Entries]:
    """Name the rows of one result each, and label each column of panels once.

    Returns the legend's entries without the results' lines, and with one entry for all thresholds
    if the thresholds differ.
    """
    named: set[str] = set()
    for name in dict.fromkeys(panel.name for panel in panels if panel.name != "raster"):
        group = [(panel.axes, panel.traces[0]) for panel in panels if panel.name == name]
        names = {axes.get_ylabel() for axes, _ in group}
        for axes, trace in group:
            if trace.label not in named:
                title = style.plain(trace.label, style.longest_label())
                axes.text(0.0, 1.04, title, transform=axes.transAxes, fontsize=style.points(7))
            if name != "attenuation":
                axes.yaxis.set_major_locator(MaxNLocator(2, steps=[1, 2, 5, 10]))
            axes.set_ylabel("")
        named |= {trace.label for _, trace in group}
        # The label is longer than a panel is high: it is centred on all panels of the column.
        text = names.pop() if len(names) == 1 else curves.EITHER
        group[len(group) // 2][0].set_ylabel(text).set_y(0.5 if len(group) % 2 else 1.0)
    thresholds = {text for some in entries for _, text in some if text.startswith("threshold ")}
    return [
        [
            (handle, "threshold" if text in thresholds and len(thresholds) > 1 else text)
            for handle, text in some
            if text not in named
        ]
        for some in entries
    ]


def _fix_margins(
    figure: style.Figure, heights: list[float], between_in: float, above_in: float
) -> None:
    """Lay out figures of one result, which every run draws, and figures with many panels.

    `heights` are the heights of the panels, `between_in` and `above_in` those of the spaces between
    and above them, in inches. The labels' widths are known at our font size, and Matplotlib's
    layout would take as long as drawing.
    """
    figure.set_layout_engine(None)
    width, height = figure.get_size_inches()
    ticks = [text for axes in figure.axes for text in axes.get_yticklabels() if text.get_text()]
    longest_in = max((text.get_window_extent().width for text in ticks), default=0.0) / figure.dpi
    left_in, n_columns = max(_LEFT_IN, longest_in + 0.1), len(figure.axes) // len(heights)
    panel_in = (width - n_columns * left_in - _RIGHT_IN) / n_columns
    for axes in figure.axes:  # labels are at the same place in all figures
        _, middle = axes.yaxis.label.get_position()
        axes.yaxis.set_label_coords(-(left_in - _LABEL_IN) / panel_in, middle)
    figure.subplots_adjust(
        left=left_in / width,
        right=1.0 - _RIGHT_IN / width,
        bottom=_BELOW_IN / height,
        top=1.0 - above_in / height,
        hspace=between_in * len(heights) / sum(heights),
        wspace=left_in / panel_in,
    )


def _draw_collisions(panels: list[_Panel]) -> style.Entries:
    """Draw a result's collisions: black lines, or in the raster bars in the result's row."""
    are_equal = len({trace.collisions_s for panel in panels for trace in panel.traces}) == 1
    drawn: list[Line2D] = []
    for panel in panels:
        n_rows = len(panel.traces)
        for place, trace in enumerate(panel.traces):
            low, high = 0.0, 1.0
            dashes: style.Dashes = "-"
            if panel.name == "raster" and not trace.alone:
                low, high = (n_rows - place - 1) / n_rows, (n_rows - place) / n_rows
            elif not are_equal:
                dashes = trace.look.get("linestyle", "-")
            for time_s in trace.collisions_s:
                line = panel.axes.axvline(time_s, low, high, color=style.BLACK, linestyle=dashes)
                line.set(linewidth=1.4, zorder=2.4)
                drawn.append(line)
    return [(Line2D([], [], color=style.BLACK, linewidth=1.4), "collision")] if drawn else []


def _draw_own_marks(panels: list[_Panel]) -> None:
    """Draw each result's own marks in its colour, with texts in its highest panel."""
    named: set[str] = set()
    for panel in (panel for panel in panels if panel.name != "raster"):
        for trace in panel.traces:
            color, middle_s = trace.look["color"], trace.result.time_s[[0, -1]].mean()
            for time_s, text in trace.marks:
                dashes = trace.look["linestyle"]
                panel.axes.axvline(time_s, color=color, linestyle=dashes, linewidth=0.8, zorder=3.1)
                if trace.label in named:
                    continue
                style.write_on_white(
                    panel.axes,
                    time_s,
                    0.97,
                    text,
                    ha="left" if time_s < middle_s else "right",
                    va="top",
                    color=color,
                    clip_on=True,
                    transform=panel.axes.get_xaxis_transform(),
                )
            named.add(trace.label)
