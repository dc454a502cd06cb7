"""The figure of a calibration: its scores held out, beside those before."""

from collections.abc import Mapping
from typing import Any

from dlgmd_cli.plots.curves import LOOKS
from dlgmd_cli.plots.style import GREY, Entries, Figure, add_legend, house_style, new_figure

_HEIGHT_IN = 2.2


def verdict(scores: Mapping[str, Mapping[str, float]], max_false_per_min: float) -> Figure:
    """Recall over false alarms per minute with their intervals, and the allowed rate as a line.

    `scores` has, by title, what `scoring.score` returns.
    """
    with house_style():
        figure = new_figure(_HEIGHT_IN, "one")
        axes = figure.subplots()
        entries: Entries = []
        # Equal bars stay in sight: the first ones are wider.
        looks = zip(scores.items(), LOOKS, (2.6, 0.9), strict=False)
        for (title, own), (color, _), width in looks:
            x, y = own["false_alarms_per_min"], own["recall"]
            ends: Any = {}
            for axis, name in (("xerr", "false_alarms_per_min"), ("yerr", "recall")):
                value, low, high = (own[f"{name}{end}"] for end in ("", "_low", "_high"))
                ends[axis] = [[value - min(value, low)], [max(value, high) - value]]
            dot: Any = axes.errorbar(
                [x], [y], **ends, color=color, marker="o", markersize=4, linewidth=width, capsize=2
            )
            entries.append((dot, title))
        limit = axes.axvline(max_false_per_min, color=GREY, linewidth=0.8, linestyle=(0, (1, 1)))
        entries.append((limit, f"{max_false_per_min:g} a minute, the most allowed"))
        axes.set(xlim=(0.0, None), ylim=(-0.03, 1.03))
        axes.set(xlabel="False alarms per minute", ylabel="Recall")
        add_legend(figure, entries)
    return figure
