"""How well models announce collisions: recall against false alarms, and how early they are."""

from collections.abc import Iterator, Mapping
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from dlgmd_cli.plots.style import (
    GREY,
    Entries,
    Figure,
    Width,
    add_legend,
    house_style,
    new_figure,
)
from dlgmd_cli.plots.traces import LOOKS
from dlgmd_cli.results.result import Series

_HEIGHT_IN = 2.2
# Dots stand for models' own thresholds.
_MARKERS = ("", "s", "^", "D")
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


def trade_off(
    curves: Mapping[str, tuple[Series, Series]],
    points: Mapping[str, tuple[float, float]],
    max_false_per_min: float,
    width: Width = "one",
) -> Figure:
    """The greatest recall at each rate of false alarms, over all thresholds.

    Parameters
    ----------
    curves : mapping of str to (ndarray, ndarray), shape (T,)
        By label: false alarms a minute, and recall, at every threshold.
    points : mapping of str to (float, float)
        The same at a model's own threshold, drawn as a dot; NaN is left out.
    max_false_per_min : float
        The rate that is allowed, drawn as a line.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    """
    with house_style():
        figure = new_figure(_HEIGHT_IN, width)
        axes: Axes = figure.subplots()
        own = [rate for rate, _ in points.values() if rate <= _MOST_PER_MIN]
        right = max([_FALSE_PER_MIN, 2 * max_false_per_min, *(1.1 * rate for rate in own)])
        entries: Entries = []
        for (label, (rate, recall)), look in zip(curves.items(), _looks(), strict=False):
            order = np.lexsort((recall, rate))
            best = np.maximum.accumulate(recall[order])
            x = np.concatenate(([0.0], rate[order], [right]))
            y = np.concatenate(([0.0], best, best[-1:]))
            (line,) = axes.plot(x, y, drawstyle="steps-post", **look)
            entries.append((line, label))
            if label in points:
                axes.plot(*points[label], color=look["color"], **_DOT)
        if points:
            entries.append((Line2D([], [], color=GREY, linestyle="", **_DOT), "default threshold"))
        axes.axvline(max_false_per_min, color="0.8", linewidth=0.6, zorder=0.5)
        axes.set_xlim(0.0, right)
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel("False alarms per minute")
        axes.set_ylabel("Recall")
        axes.spines["top"].set_visible(False)
        add_legend(figure, entries)
    return figure


def leads(leads_s: Mapping[str, Series], horizon_s: float, width: Width = "one") -> Figure:
    """Share of the collisions that are announced by each time before contact.

    `leads_s` holds for each label the lead to every collision, in seconds, NaN where missed.
    """
    with house_style():
        figure = new_figure(_HEIGHT_IN, width)
        axes: Axes = figure.subplots()
        at = np.linspace(0.0, horizon_s, 501)
        entries: Entries = []
        for (label, found), look in zip(leads_s.items(), _looks(), strict=False):
            share = [(found >= left).mean() if len(found) else np.nan for left in at]
            (line,) = axes.plot(at, share, **look)
            entries.append((line, label))
        axes.set_xlim(horizon_s, 0.0)
        axes.set_ylim(0.0, 1.02)
        axes.set_xlabel("Time to contact (s)")
        axes.set_ylabel("Collisions announced")
        axes.spines["top"].set_visible(False)
        add_legend(figure, entries)
    return figure


def _looks() -> Iterator[dict[str, Any]]:
    """A look for each line, over and over."""
    every = [
        {"color": color, "linestyle": dashes, "marker": marker, "markersize": 3, "markevery": 0.2}
        for marker in _MARKERS
        for color, dashes in LOOKS
    ]
    return cycle(every)
