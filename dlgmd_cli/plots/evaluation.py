"""Figures of an evaluation (recall, lead times, stops, times to contact) and a calibration."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from dlgmd_cli.plots import style
from dlgmd_cli.plots.curves import LOOKS
from dlgmd_cli.plots.traces import MAX_TOGETHER
from dlgmd_cli.results.result import Series

_HEIGHT_IN, _PANEL_IN, _AROUND_IN = 2.2, 1.15, 0.3
# Panels side by side, if every label has its own.
_PER_ROW = {"one": 2, "two": 4}
# The trade-off is shown up to this rate, or as far as a model's own threshold needs.
_FALSE_PER_MIN, _MOST_PER_MIN = 5.0, 30.0
_DOT: Any = {
    "marker": "o",
    "markersize": 5,
    "markeredgecolor": "white",
    "markeredgewidth": 0.6,
    "clip_on": False,
    "zorder": 3,
}
_ALLOWED: Any = {"color": style.GREY, "linewidth": 0.8, "linestyle": (0, (1, 1)), "zorder": 0.5}
_OTHERS: Any = {"color": "0.8", "linewidth": 0.7, "drawstyle": "steps-post"}


def trade_off(
    curves: Mapping[str, tuple[Series, Series]],
    points: Mapping[str, tuple[float, float]],
    allowed: float | None = None,
    names: tuple[str, str] = ("False alarms per minute", "Recall"),
    width: style.Width = "one",
) -> style.Figure:
    """The greatest share at each rate, over all thresholds.

    Parameters
    ----------
    curves : mapping of str to (ndarray, ndarray), shape (T,)
        By label: the rate, such as false alarms per minute, and the share, such as the recall, at
        every threshold. More than four have a panel each.
    points : mapping of str to (float, float)
        The same at a model's own threshold, drawn as a dot; NaN is left out.
    allowed : float, optional
        The allowed rate, drawn as a line.
    names : (str, str)
        What rate and share are called.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    """
    own = [1.1 * rate for rate, _ in points.values() if rate <= _MOST_PER_MIN]
    right = max([_FALSE_PER_MIN, 2 * (allowed or 0.0), *own])
    with style.house_style():
        figure, drawn, entries = _draw(_best_so_far(curves, right), names, width)
        if points:
            dot = Line2D([], [], color=style.GREY, linestyle="", **_DOT)
            entries.append((dot, "default threshold"))
        if allowed is not None and drawn:
            lines = [line.axes.axvline(allowed, **_ALLOWED) for line in drawn.values()]
            entries.append((lines[0], f"{allowed:g} a minute, the most allowed"))
        for label, line in drawn.items():
            line.axes.set_xlim(0.0, right)
            if label in points:
                line.axes.plot(*points[label], color=line.get_color(), **_DOT)
        style.add_legend(figure, entries)
    return figure


def _best_so_far(
    curves: Mapping[str, tuple[Series, Series]], right: float
) -> dict[str, tuple[Series, Series]]:
    """The greatest share at each rate or below it, as steps up to the right."""
    lines = {}
    for label, (rate, share) in curves.items():
        order = np.lexsort((share, rate))
        best = np.maximum.accumulate(share[order])
        x = np.concatenate(([0.0], rate[order], [np.fmax.reduce(rate, initial=right)]))
        lines[label] = x, np.concatenate(([0.0], best, best[-1:]))
    return lines


def leads(
    leads_s: Mapping[str, Series], horizon_s: float, width: style.Width = "one"
) -> style.Figure:
    """Share of the collisions that are detected by each time before contact.

    `leads_s` has for each label the lead time of every collision in seconds, NaN where missed.
    """
    at = np.linspace(0.0, horizon_s, 501)
    lines = {
        label: (at, np.array([(lead_s >= left).mean() if len(lead_s) else np.nan for left in at]))
        for label, lead_s in leads_s.items()
    }
    with style.house_style():
        figure, drawn, entries = _draw(lines, ("Time to contact (s)", "Collisions detected"), width)
        for line in drawn.values():
            line.axes.set_xlim(horizon_s, 0.0)
        style.add_legend(figure, entries)
    return figure


def times_to_contact(errors: Mapping[str, Series], width: style.Width = "one") -> style.Figure:
    """By how much the estimated time to contact is wrong, over the time to contact.

    `errors` has for each label the time to contact in seconds, and the median and the 90th
    percentile of |ln(estimate / truth)|, shape (3, n); NaN where there is no estimate.
    """
    with style.house_style():
        figure = style.new_figure(_HEIGHT_IN, width)
        axes = figure.subplots()
        entries: style.Entries = []
        for place, (label, (left_s, middle, most)) in enumerate(errors.items()):
            color, _ = LOOKS[place % len(LOOKS)]
            (line,) = axes.plot(left_s, middle, color=color, marker="o", markersize=3)
            axes.plot(left_s, most, color=color, marker="o", markersize=3, linestyle=":")
            entries.append((line, label))
        entries.append((Line2D([], [], color=style.GREY), "median"))
        entries.append((Line2D([], [], color=style.GREY, linestyle=":"), "90 %"))
        axes.set(xlim=(0.0, None), ylim=(0.0, None))
        axes.invert_xaxis()
        axes.spines["top"].set_visible(False)
        axes.set(xlabel="Time to contact (s)", ylabel="|ln(estimate / truth)|")
        style.add_legend(figure, entries)
    return figure


def _draw(
    lines: Mapping[str, tuple[Series, Series]], names: tuple[str, str], width: style.Width
) -> tuple[style.Figure, dict[str, Any], style.Entries]:
    """Steps in one panel, or, if many, in a panel each: figure, line of each label, legend."""
    is_split = len(lines) > MAX_TOGETHER
    per_row = _PER_ROW[width] if is_split else 1
    n_rows = -(-len(lines) // per_row) if is_split else 1
    figure = style.new_figure(n_rows * _PANEL_IN + _AROUND_IN if is_split else _HEIGHT_IN, width)
    grid = figure.subplots(n_rows, per_row, sharex=True, sharey=True, squeeze=False)
    grid[0, 0].set_ylim(-0.03, 1.03)  # a line at 0 is seen
    figure.supxlabel(names[0], fontsize=8)
    figure.supylabel(names[1], fontsize=8)
    drawn = {}
    panels: list[Axes] = list(grid.flat)
    for place, axes in enumerate(panels):
        axes.spines["top"].set_visible(False)
        axes.tick_params(labelbottom=not is_split or place + per_row >= len(lines))
    for unused in panels[len(lines) :] if is_split else ():
        unused.set_axis_off()
    for place, (label, line) in enumerate(lines.items()):
        axes = panels[place if is_split else 0]
        color, dashes = LOOKS[0 if is_split else place]
        if is_split:
            axes.set_title(style.plain(label, 30), loc="left", pad=2, fontsize=7)
            for other in lines.values():
                axes.plot(*other, **_OTHERS)
        (drawn[label],) = axes.plot(*line, color=color, linestyle=dashes, drawstyle="steps-post")
    if is_split:
        return figure, drawn, [(Line2D([], [], **_OTHERS), "the other models")]
    return figure, drawn, [(line, label) for label, line in drawn.items()]


def _bars(scores: Mapping[str, float], name: str) -> list[list[float]]:
    """How far the interval of a measure reaches below and above it."""
    value, low, high = (scores[f"{name}{end}"] for end in ("", "_low", "_high"))
    return [[value - min(value, low)], [max(value, high) - value]]


def verdict(scores: Mapping[str, Mapping[str, float]], max_false_per_min: float) -> style.Figure:
    """Recall over false alarms per minute with their intervals, and the allowed rate as a line.

    `scores` has, by title, what `scoring.score` returns.
    """
    with style.house_style():
        figure = style.new_figure(_HEIGHT_IN, "one")
        axes = figure.subplots()
        entries: style.Entries = []
        # Equal bars stay in sight: the first ones are wider.
        looks = zip(scores.items(), LOOKS, (2.6, 0.9), strict=False)
        for (title, own), (color, _), width in looks:
            x, y = own["false_alarms_per_min"], own["recall"]
            dot = axes.errorbar(
                [x],
                [y],
                xerr=_bars(own, "false_alarms_per_min"),
                yerr=_bars(own, "recall"),
                color=color,
                marker="o",
                markersize=4,
                linewidth=width,
                capsize=2,
            )
            entries.append((dot, title))
        limit = axes.axvline(max_false_per_min, **_ALLOWED)
        entries.append((limit, f"{max_false_per_min:g} a minute, the most allowed"))
        axes.set(xlim=(0.0, None), ylim=(-0.03, 1.03))
        axes.set(xlabel="False alarms per minute", ylabel="Recall")
        style.add_legend(figure, entries)
    return figure
