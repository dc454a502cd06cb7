"""Figures of an evaluation (recall, lead times, times to contact) and a calibration."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.transforms import ScaledTranslation

from dlgmd_cli.plots import style
from dlgmd_cli.plots.curves import LOOKS
from dlgmd_cli.plots.traces import MAX_TOGETHER
from dlgmd_cli.results.result import Series
from dlgmd_cli.results.tradeoff import Curve

_HEIGHT_IN, _PANEL_IN, _AROUND_IN, _LINE_IN = 2.2, 1.15, 0.3, 0.12
# Number of panels side by side if each label has its own panel, by the width in columns.
_PER_ROW = {"one": 2, "two": 4}
# Rates per minute: the axis is linear up to 1, and beyond it logarithmic if rates exceed 10.
_LINEAR_PER_MIN, _MANY_PER_MIN = 1.0, 10.0
_DOT: Any = {
    "marker": "o",
    "markersize": 5,
    "markeredgecolor": "white",
    "markeredgewidth": 0.6,
    "clip_on": False,
    "zorder": 3,
}
_ALLOWED: Any = {"color": style.GREY, "linewidth": 0.8, "linestyle": (0, (1, 1)), "zorder": 0.5}
_BANDS_TOGETHER = 2
_PATCH: Any = {"alpha": 0.18, "linewidth": 0.0}
_BAND: Any = {**_PATCH, "step": "post", "zorder": 0.4}
_OTHERS: Any = {"color": "0.8", "linewidth": 0.7, "drawstyle": "steps-post"}


def trade_off(
    curves: Mapping[str, Curve],
    points: Mapping[str, tuple[float, float]],
    allowed: float,
    width: style.Width = "one",
) -> style.Figure:
    """The greatest recall at each false alarm rate, over all thresholds, with its interval.

    Parameters
    ----------
    curves : mapping of str to Curve
        The curves by label. More than two curves have a panel each.
    points : mapping of str to (float, float)
        False alarms per minute and recall at a model's own threshold, drawn as a dot; NaN is left
        out.
    allowed : float
        The allowed false alarms per minute, drawn as a line.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    """
    shown = [c.false_alarms_per_min[c.front].max() for c in curves.values()]
    right = max([2.0 * allowed, *shown, *(rate for rate, _ in points.values() if rate >= 0.0)])
    steps: dict[str, list[Series]] = {}
    for label, curve in curves.items():
        measures = curve.false_alarms_per_min, curve.recall, curve.recall_low, curve.recall_high
        steps[label] = [np.append(own[curve.front], own[curve.front[-1]]) for own in measures]
        steps[label][0][-1] = 1.03 * right  # the last step reaches the edge
    with style.house_style():
        lines = {label: (rate, recall) for label, (rate, recall, *_) in steps.items()}
        names = "False alarms per minute", "Recall"
        figure, drawn, entries = _draw(lines, names, width, _BANDS_TOGETHER)
        if points:
            dot = Line2D([], [], color=style.GREY, linestyle="", **_DOT)
            entries.append((dot, "default threshold"))
        limits = [line.axes.axvline(allowed, **_ALLOWED) for line in drawn.values()]
        entries.append((limits[0], f"{allowed:g} a minute, the most allowed"))
        for label, line in drawn.items():
            if right > _MANY_PER_MIN:
                line.axes.set_xscale("symlog", linthresh=_LINEAR_PER_MIN, subs=range(2, 10))
                line.axes.xaxis.set_major_formatter("{x:g}")
            line.axes.set_xlim(0.0, 1.03 * right or 1.0)
            rate, _, low, high = steps[label]
            line.axes.fill_between(rate, low, high, color=line.get_color(), **_BAND)
            if label in points:
                line.axes.plot(*points[label], color=line.get_color(), **_DOT)
        entries.append((Patch(color=style.GREY, **_PATCH), "95 %"))
        style.add_legend(figure, entries)
    return figure


def leads(leads_s: Mapping[str, Series], width: style.Width = "one") -> style.Figure:
    """Share of the contacts that are in time or announced by each time before contact.

    `leads_s` has, by label, the lead time of every contact in seconds, NaN if there is none.
    """
    longest_s = max([1.0, *(lead for own in leads_s.values() for lead in own[~np.isnan(own)])])
    longest_s *= 1.05
    at = np.linspace(0.0, longest_s, 501)
    lines = {
        label: (at, np.array([(lead_s >= left).mean() if len(lead_s) else np.nan for left in at]))
        for label, lead_s in leads_s.items()
    }
    with style.house_style():
        names = "Time left to contact (s)", "Contacts in time or\nannounced by then"
        figure, drawn, entries = _draw(lines, names, width)
        for line in drawn.values():
            line.axes.set_xlim(longest_s, 0.0)
        style.add_legend(figure, entries)
    return figure


def times_to_contact(errors: Mapping[str, Series], width: style.Width = "one") -> style.Figure:
    """The error of the estimated time to contact, over the true time to contact.

    `errors` has for each label the time to contact in seconds, and the median and the 90th
    percentile of |ln(estimate / truth)|, shape (3, n); NaN where there is no estimate.
    """
    with style.house_style():
        figure = style.new_figure(_HEIGHT_IN, width)
        axes = figure.subplots()
        entries: style.Entries = []
        for place, (label, (left_s, middle, most)) in enumerate(errors.items()):
            color, _ = LOOKS[place % len(LOOKS)]
            (line,) = axes.plot(left_s, np.exp(middle), color=color, marker="o", markersize=3)
            axes.plot(left_s, np.exp(most), color=color, marker="o", markersize=3, linestyle=":")
            entries.append((line, label))
        entries.append((Line2D([], [], color=style.GREY), "median"))
        entries.append((Line2D([], [], color=style.GREY, linestyle=":"), "90th percentile"))
        axes.set_yscale("log", subs=[1.5, 2, 3, 5])
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
        axes.set(xlim=(0.0, None), ylim=(1.0, None))
        axes.invert_xaxis()
        axes.set(xlabel="Time to contact (s)", ylabel="Estimate off by a factor of")
        style.add_legend(figure, entries)
    return figure


def _draw(
    lines: Mapping[str, tuple[Series, Series]],
    names: tuple[str, str],
    width: style.Width,
    together: int = MAX_TOGETHER,
) -> tuple[style.Figure, dict[str, Any], style.Entries]:
    """Draw steps in one panel, or many in a panel each: figure, line of each label, legend."""
    is_split = len(lines) > together
    per_row = _PER_ROW[width] if is_split else 1
    n_rows = -(-len(lines) // per_row) if is_split else 1
    titles = [style.wrapped(label, style.longest_label() // 2) for label in lines]
    panel_in = _PANEL_IN + _LINE_IN * max(title.count("\n") for title in titles)
    figure = style.new_figure(n_rows * panel_in + _AROUND_IN if is_split else _HEIGHT_IN, width)
    grid = figure.subplots(n_rows, per_row, sharex=True, sharey=True, squeeze=False)
    grid[0, 0].set_ylim(-0.03, 1.03)  # a line at 0 stays visible
    figure.supxlabel(names[0])
    figure.supylabel(names[1])
    drawn = {}
    panels: list[Axes] = list(grid.flat)
    for place, axes in enumerate(panels):
        axes.tick_params(labelbottom=not is_split or place + per_row >= len(lines))
    for unused in panels[len(lines) :] if is_split else ():
        unused.set_axis_off()
    for place, (label, line) in enumerate(lines.items()):
        axes = panels[place if is_split else 0]
        color, dashes = LOOKS[0 if is_split else place]
        if is_split:
            axes.set_title(titles[place], loc="left", pad=2, fontsize=style.points(7))
            for other in lines.values():
                axes.plot(*other, **_OTHERS)
        (drawn[label],) = axes.plot(*line, color=color, linestyle=dashes, drawstyle="steps-post")
    if is_split:
        return figure, drawn, [(Line2D([], [], **_OTHERS), "the other models")]
    return figure, drawn, [(line, label) for label, line in drawn.items()]


def _bars(scores: Mapping[str, float], name: str) -> list[list[float]]:
    """The distances from a measure down and up to the ends of its interval."""
    value, low, high = (scores[f"{name}{end}"] for end in ("", "_low", "_high"))
    return [[value - min(value, low)], [max(value, high) - value]]


def verdict(scores: Mapping[str, Mapping[str, float]], max_false_per_min: float) -> style.Figure:
    """Recall over false alarms per minute with their intervals, and the allowed rate as a line.

    `scores` has the measures of `scoring.score`, by title.
    """
    with style.house_style():
        figure = style.new_figure(_HEIGHT_IN, "one")
        axes = figure.subplots()
        axes.spines["top"].set_visible(True)
        entries: style.Entries = []
        # The crosses are apart by a few points: of equal scores, both stay visible.
        looks = zip(scores.items(), LOOKS, (("o", -2.0), ("s", 2.0)), strict=False)
        for (title, own), (color, _), (marker, apart_pt) in looks:
            x, y = own["false_alarms_per_min"], own["recall"]
            aside = ScaledTranslation(apart_pt / 72, apart_pt / 72, figure.dpi_scale_trans)
            dot = axes.errorbar(
                [x],
                [y],
                xerr=_bars(own, "false_alarms_per_min"),
                yerr=_bars(own, "recall"),
                transform=axes.transData + aside,
                color=color,
                marker=marker,
                markersize=3.5,
                linewidth=0.8,
                capsize=2,
            )
            entries.append((dot, title))
        limit = axes.axvline(max_false_per_min, **_ALLOWED)
        entries.append((limit, f"{max_false_per_min:g} a minute, the most allowed"))
        axes.set(ylim=(-0.06, 1.06))
        of_rate = "false_alarms_per_min", "false_alarms_per_min_high"
        known = [own[name] for own in scores.values() for name in of_rate]
        most = float(np.nanmax([*known, max_false_per_min]))
        axes.set_xlim(-0.03 * most, 1.08 * most)
        axes.set(xlabel="False alarms per minute", ylabel="Recall")
        style.add_legend(figure, entries)
    return figure
