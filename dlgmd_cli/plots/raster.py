"""Spikes and collisions as bars on rows."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from dlgmd_cli.plots.legend import Keys
from dlgmd_cli.plots.series import Trace
from dlgmd_cli.plots.style import BLACK, BLUE, GREY, VERMILION
from dlgmd_cli.results.tables import Flags

_MIN_HEIGHT_IN, _ROW_IN = 0.44, 0.16
# Of a row's sample line, left of the axes, in inches.
_SAMPLE_IN = (-0.3, -0.06)


def raster_height_in(traces: list[Trace]) -> float:
    """Height that the rows need, in inches."""
    return max(_MIN_HEIGHT_IN, _ROW_IN * len(traces))


def draw_raster(axes: Axes, traces: list[Trace], width_in: float) -> Keys:
    """A row of spikes and one of collisions; of several results a row each with both.

    `width_in` is how wide the axes are, in inches.
    """
    axes.spines["bottom"].set_visible(False)
    if traces[0].alone:
        (trace,) = traces
        _draw_bars(axes, trace, trace.result.spike, (0.65, 1.35), BLUE)
        _draw_bars(axes, trace, trace.result.collision, (-0.35, 0.35), VERMILION)
        axes.set_yticks([1, 0], ["spikes", "collision"])
        axes.set_ylim(-0.6, 1.6)
        return []
    left, right = (place / width_in for place in _SAMPLE_IN)
    for row, trace in enumerate(reversed(traces)):
        if trace.result.has_spikes:
            _draw_bars(axes, trace, trace.result.spike, (row - 0.1, row + 0.4), trace.color)
            _draw_bars(axes, trace, trace.result.collision, (row - 0.4, row - 0.2), VERMILION)
        else:
            _say_unknown(axes, row)
        sample = {**trace.look(), "marker": "", "clip_on": False}
        axes.plot([left, right], [row, row], transform=axes.get_yaxis_transform(), **sample)
    axes.set_yticks([])
    axes.set_ylim(-0.6, len(traces) - 0.4)
    return _keys(traces)


def _draw_bars(
    axes: Axes, trace: Trace, flags: Flags, reach: tuple[float, float], color: str
) -> None:
    """A bar at every flagged row, from one height to another."""
    low, high = reach
    if trace.columns.grouped:
        spans = trace.columns.spans(flags)
        axes.broken_barh(spans, (low, high - low), color=color, linewidth=0.3)
    else:
        axes.vlines(trace.result.time_s[flags], low, high, color=color, linewidth=0.8)


def _say_unknown(axes: Axes, row: int) -> None:
    """Keep a row without data from looking like one without spikes."""
    axes.text(
        0.5,
        row,
        "spikes not recorded",
        transform=axes.get_yaxis_transform(),
        ha="center",
        va="center",
        color=GREY,
        fontsize=6.5,
    )


def _keys(traces: list[Trace]) -> Keys:
    """What the bars mean, as far as there are any."""
    keys: Keys = []
    for label, column, color, size in (
        ("spikes", "spike", BLACK, 6),
        ("collision", "collision", VERMILION, 4),
    ):
        if any(np.any(getattr(trace.result, column)) for trace in traces):
            bar = Line2D(
                [], [], color=color, marker="|", linestyle="", markersize=size, markeredgewidth=1.2
            )
            keys.append((bar, label))
    return keys
