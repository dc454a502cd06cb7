"""One result among several on the same axes: its line, its look, its rows on a raster."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dlgmd_cli.plots.columns import Columns
from dlgmd_cli.plots.legend import Keys
from dlgmd_cli.plots.style import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    LIGHT_BLUE,
    ORANGE,
    PURPLE,
    SKY_BLUE,
    VERMILION,
)
from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.results.tables import Result, Series

_SOLID: Any = "-"
_DASHED: Any = (0, (4, 1.5))
_DOTTED: Any = (0, (1, 1.2))
_DASH_DOT: Any = (0, (5, 1.5, 1, 1.5))
_LONG_DASHED: Any = (0, (9, 2))
_DASH_DOT_DOT: Any = (0, (5, 1.2, 1, 1.2, 1, 1.2))
# Two lines of the same dashes differ in brightness, so that a grey print tells them apart.
LOOKS: tuple[tuple[str, Any], ...] = (
    (BLUE, _SOLID),
    (VERMILION, _DASHED),
    (GREEN, _DASH_DOT),
    (BLACK, _DOTTED),
    (PURPLE, _LONG_DASHED),
    (BLUE, _DASH_DOT_DOT),
    (ORANGE, _SOLID),
    (BLACK, _DASHED),
    (SKY_BLUE, _DASH_DOT),
    (PURPLE, _DOTTED),
    (GREEN, _LONG_DASHED),
    (ORANGE, _DASH_DOT_DOT),
)
# After the label of a line that is nowhere defined.
UNDEFINED = " (undefined)"
# From the thirteenth line on, looks come again, with marks on the line.
_MARKERS = ("", "o", "s", "^", "D", "x", "+")


@dataclass(frozen=True)
class Trace:
    """A result with what it takes to draw it.

    Attributes
    ----------
    label : str
        What the legend calls it.
    columns : Columns
        Its rows as the figure can show them.
    color, dashes, marker
        Its look, as Matplotlib names it.
    alone : bool
        Whether it is the figure's only result, which then shows more of it.
    """

    label: str
    result: Result
    columns: Columns
    color: str
    dashes: Any
    marker: str
    alone: bool

    def key(self) -> Line2D:
        """Its line in the legend."""
        return Line2D([], [], **self.look())

    def look(self) -> dict[str, Any]:
        """What all of its lines look like."""
        return {
            "color": self.color,
            "linestyle": self.dashes,
            "marker": self.marker,
            "markersize": 3,
            "linewidth": 0.7 if self.columns.grouped else 1.0,
        }


def traces_of(results: Mapping[str, Result], timeline: Timeline, width_in: float) -> list[Trace]:
    """Every result with a look of its own, in their order."""
    traces = []
    for place, (label, result) in enumerate(results.items()):
        color, dashes = LOOKS[place % len(LOOKS)]
        traces.append(
            Trace(
                label,
                result,
                Columns(result.time_s, timeline.view, width_in),
                color,
                dashes,
                _MARKERS[place // len(LOOKS) % len(_MARKERS)],
                alone=len(results) == 1,
            )
        )
    return traces


def draw_line(axes: Axes, trace: Trace, values: Series) -> Keys:
    """A line that breaks at NaN, with a dot where a single value would draw nothing."""
    columns, label = trace.columns, trace.label
    highest = columns.highest(values)
    known = ~np.isnan(highest)
    if not known.any():
        return [] if trace.alone else [(trace.key(), label + UNDEFINED)]
    before, after = np.concatenate(([False], known[:-1])), np.concatenate((known[1:], [False]))
    single = known & ~before & ~after
    if columns.grouped:
        lowest = columns.lowest(values)
        band = (
            {"color": LIGHT_BLUE}
            if trace.alone
            else {"color": trace.color, "alpha": 0.2, "zorder": 1}
        )
        axes.fill_between(columns.time_s, lowest, highest, linewidth=0, **band)
        axes.vlines(columns.time_s[single], lowest[single], highest[single], linewidth=0.4, **band)
        if trace.alone:
            label += " (max, range)"
    n_known = int(np.count_nonzero(known))
    (line,) = axes.plot(
        columns.time_s, highest, label=label, markevery=max(1, n_known // 12), **trace.look()
    )
    axes.plot(columns.time_s[single], highest[single], ".", color=trace.color, markersize=3)
    return [(line, label)]


def range_key(traces: list[Trace]) -> Keys:
    """Explains the bands, where several results have some."""
    if traces[0].alone or not any(trace.columns.grouped for trace in traces):
        return []
    band = Patch(facecolor=GREY, alpha=0.3, linewidth=0)
    line = Line2D([], [], color=GREY, linewidth=0.7)
    return [((band, line), "maximum, range")]


def note(axes: Axes, why: str) -> None:
    """Say why there is no line."""
    axes.text(
        0.5,
        0.5,
        f"undefined: {why}",
        transform=axes.transAxes,
        ha="center",
        va="center",
        color=GREY,
        fontsize=7,
        bbox={"facecolor": "white", "edgecolor": "none", "pad": 1},
    )


def reason(traces: list[Trace], unchanged: str) -> str:
    """Why none of the traces has a line: too few frames, or what `unchanged` says."""
    too_few = {bool(np.isnan(trace.result.mp).all()) for trace in traces}
    if len(too_few) > 1:
        return f"too few frames, or {unchanged}"
    return "too few frames" if too_few.pop() else unchanged
