"""Figures of how well responses separate: scores of the benchmark, ROC, precision and recall."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from dlgmd_cli.plots import style
from dlgmd_cli.plots.curves import LOOKS
from dlgmd_cli.results.roc import FRAMES, VIDEOS, Separations

# Height of a class, of a figure without classes, and of a panel; width of the names of classes;
# letters of a class in a line; greatest size of a number, and its share of a cell's width.
_ROW_IN, _AROUND_IN, _PANEL_IN, _NAMES_IN, _LONGEST_CLASS = 0.24, 0.95, 1.5, 1.25, 22
_NUMBER_PT, _NUMBER_SHARE = 8.0, 0.45
# The last rows of a table of scores are means over several classes.
_N_MEANS = 3
# A colour darker than this share of the scale takes white letters.
_DARK = 0.55
# Looks that return have markers, so far apart as a share of the panel.
_MARKERS, _EVERY = "osD^vPX*", 0.15


def scores(
    of_models: Mapping[str, Mapping[str, float]], width: style.Width = "one"
) -> style.Figure:
    """The scores of each model by class, and their means, as a table of numbers and colours.

    A row without any score is left out.

    Parameters
    ----------
    of_models : mapping of str to mapping of str to float
        Model -> class, then synthetic, real and weighted mean -> score, up to 1; NaN for none.
    width : "one" or "two"
        Columns of the paper that the figure takes.
    """
    every = [*next(iter(of_models.values()))]
    titles = [one for one in every if not all(np.isnan(own[one]) for own in of_models.values())]
    n_classes = len([one for one in titles if one not in every[-_N_MEANS:]])
    values = np.array([[own[title] for own in of_models.values()] for title in titles])
    with style.house_style():
        figure = style.new_figure(_AROUND_IN + _ROW_IN * len(titles), width)
        axes = figure.subplots()
        axes.imshow(values, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        cell_pt = 72.0 * (style.width_in(width) - _NAMES_IN) / len(of_models)
        size = style.points(min(_NUMBER_PT, _NUMBER_SHARE * cell_pt))
        for (row, column), value in np.ndenumerate(values):
            text = "–" if np.isnan(value) else f"{100 * value:.0f}"
            color = "white" if value > _DARK else "black"
            axes.text(column, row, text, ha="center", va="center", color=color, fontsize=size)
        axes.axhline(n_classes - 0.5, color="black", linewidth=0.8)
        names = (title.removeprefix("basic test/") for title in titles)
        labels = [style.wrapped(name, _LONGEST_CLASS) for name in names]
        axes.set_yticks(range(len(titles)), labels, fontsize=style.points(6))
        axes.set_xticks(range(len(of_models)), [*of_models], rotation=90, fontsize=style.points(7))
        axes.tick_params(length=0, labeltop=True, labelbottom=False)
        for spine in axes.spines.values():
            spine.set_visible(False)
        figure.supxlabel("SA (%)")
    return figure


def curves(found: Separations, width: style.Width = "one") -> style.Figure:
    """ROC, and precision over recall, of frames and, below, of videos if they have curves."""
    has_videos = any(of[VIDEOS].positives and of[VIDEOS].negatives for of in found.values())
    rows = (FRAMES, VIDEOS) if has_videos else (FRAMES,)
    with style.house_style():
        figure = style.new_figure(_PANEL_IN * len(rows) + 0.3, width)
        panels = figure.subplots(len(rows), 2, sharex=True, sharey=True, squeeze=False)
        panels[0, 0].set(xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
        entries: style.Entries = []
        for (roc, precision), by in zip(panels, rows, strict=True):
            roc.plot([0.0, 1.0], [0.0, 1.0], color="0.8", linewidth=0.7)
            roc.set_ylabel(f"Recall ({by})")
            precision.set_ylabel("Precision")
            for place, (label, of) in enumerate(found.items()):
                color, dashes = LOOKS[place % len(LOOKS)]
                look: style.Line = {"color": color, "linestyle": dashes}
                if place >= len(LOOKS):
                    marker = _MARKERS[(place // len(LOOKS) - 1) % len(_MARKERS)]
                    look |= {"marker": marker, "markersize": 2.5}
                handle: Any = Line2D([], [])
                handle.update(look)
                entries.append((handle, label))
                one = of[by]
                if not one.positives or not one.negatives:
                    continue
                recall = np.append(0.0, one.recall)
                roc.plot(np.append(0.0, one.false_positive_rate), recall, markevery=_EVERY, **look)
                steps = np.append(one.precision[0], one.precision)
                look["drawstyle"] = "steps-pre"  # the area below is the average precision
                precision.plot(recall, steps, markevery=_EVERY, **look)
        panels[-1, 0].set_xlabel("False positive rate")
        panels[-1, 1].set_xlabel("Recall")
        style.add_legend(figure, entries)
    return figure
