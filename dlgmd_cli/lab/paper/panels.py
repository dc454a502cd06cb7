"""Curves in several panels: one panel per formulation, scene or quantity."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from matplotlib.axes import Axes

from dlgmd_cli.lab.paper.clips import Series
from dlgmd_cli.plots import style

_ROW_IN, _AROUND_IN, _PER_ROW = 1.5, 0.35, 3
# Curves with more than twice as many values have markers at some of them only.
_MARKER_ROOM = 12
# Neighbours differ in colour, dashes and brightness; vermilion and black have other meanings.
_LOOKS: tuple[tuple[str, style.Dashes], ...] = (
    (style.BLUE, "-"),
    (style.PURPLE, (0, (4, 1.5))),
    (style.GREEN, (0, (5, 1.5, 1, 1.5))),
    (style.SKY_BLUE, (0, (1, 1.2))),
    (style.GREY, (0, (9, 2))),
    (style.ORANGE, (0, (5, 1.2, 1, 1.2, 1, 1.2))),
)
_STRONG_PT = 2.0
_MARKERS = ("o", "s", "^", "D", "x", "+")


@dataclass(frozen=True)
class Panel:
    """One panel: curves by label, each x and y of shape (n,), and marks.

    `spans` are ranges of x with a text, `collision` is the x of the collision, `level` the y of a
    threshold. `bars` are lower and upper ends of intervals by label, (2, n). Values of -60 dB and
    below, through which nothing passes, are drawn at -60 dB, and the axis says so.
    """

    title: str
    curves: Mapping[str, tuple[Series, Series]]
    spans: Sequence[tuple[float, float, str]] = ()
    collision: float | None = None
    level: float | None = None
    y_label: str = ""
    bars: Mapping[str, Series] = field(default_factory=dict)


def plot_panels(
    panels: Sequence[Panel],
    x_label: str,
    y_label: str,
    *,
    dots: bool = False,
    log_x: bool = False,
    log_y: bool = False,
    share_x: bool = True,
    share_y: bool = True,
    emphasise: str | None = None,
) -> style.Figure:
    """Draw panels, three in a row; a label has the same look in all of them.

    `dots` draws a marker at every value; `log_x` also puts a tick there. Both are for curves with
    few values. `share_x` is for panels that share their y. `emphasise` is the label of the
    strongest curve.
    """
    labels = list(dict.fromkeys(label for panel in panels for label in panel.curves))
    looks = {label: _look(place, dots=dots) for place, label in enumerate(labels)}
    if emphasise:
        looks[emphasise]["linewidth"] = _STRONG_PT
    per_row = min(_PER_ROW, len(panels))
    n_rows = -(-len(panels) // per_row)
    with style.house_style():
        figure = style.new_figure(n_rows * _ROW_IN + _AROUND_IN, "two")
        grid = figure.subplots(
            n_rows, per_row, squeeze=False, sharey=share_y, sharex=share_x and share_y and "col"
        )
        entries: style.Entries = []
        for place, axes in enumerate(grid.flat):
            if place >= len(panels):
                axes.set_axis_off()
                continue
            entries += _draw(axes, panels[place], looks)
            if log_x:
                axes.set_xscale("log")
                values = np.unique(np.concatenate([x for x, _ in panels[place].curves.values()]))
                axes.set_xticks(values, [f"{value:g}" for value in values])
                axes.minorticks_off()
            if log_y:
                axes.set_yscale("log")
            if place + per_row >= len(panels):
                axes.set_xlabel(x_label)
                axes.tick_params(labelbottom=True)
            if place % per_row == 0 or panels[place].y_label:
                axes.set_ylabel(panels[place].y_label or y_label)
        style.add_legend(figure, entries)
    return figure


def _look(place: int, *, dots: bool) -> style.Line:
    color, dashes = _LOOKS[place % len(_LOOKS)]
    marker = _MARKERS[place % len(_MARKERS)] if dots or place >= len(_LOOKS) else ""
    return {"color": color, "linestyle": dashes, "marker": marker, "markersize": 3}


def _draw(axes: Axes, panel: Panel, looks: Mapping[str, style.Line]) -> style.Entries:
    axes.set_title(panel.title, loc="left", pad=11 if panel.spans else 4)
    for row, (start, end, text) in enumerate(panel.spans):
        axes.axvspan(start, end, color=style.GREY, alpha=0.22 if row % 2 else 0.12, linewidth=0)
        axes.text(
            (start + end) / 2,
            1.01,
            text,
            ha="center",
            va="bottom",
            fontsize=6,
            color=style.GREY,
            transform=axes.get_xaxis_transform(),
        )
    entries: style.Entries = []
    for label, (x, y) in panel.curves.items():
        look = looks[label]
        every = max(1, len(x) // 10) if len(x) > 2 * _MARKER_ROOM else 1
        shown = np.where(np.isinf(y), style.FLOOR_DB, y)
        (line,) = axes.plot(x, shown, markevery=every, **look)
        entries.append((line, label))
        if label in panel.bars:
            axes.vlines(x, *panel.bars[label], color=look["color"], linewidth=0.8)
        if (shown == style.FLOOR_DB).any():
            axes.yaxis.set_major_formatter(_decibels)
    if panel.level is not None:
        line = axes.axhline(panel.level, color=style.GREY, linestyle="--", linewidth=0.8)
        entries.append((line, f"threshold {panel.level:g}"))
    if panel.collision is not None:
        line = axes.axvline(panel.collision, color=style.BLACK, linewidth=0.8)
        entries.append((line, "collision"))
    return entries


def _decibels(value: float, _: float) -> str:
    """The label of a tick; that of -60 dB stands for all that lies below, too."""
    return f"{'≤ ' if value == style.FLOOR_DB else ''}{value:g}".replace("-", "−")
