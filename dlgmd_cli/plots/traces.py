"""What a model says over time: membrane potential, attenuation, spikes. Data in, Figure out."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dlgmd_cli.plots.columns import AXES_WIDTH_IN, Columns
from dlgmd_cli.plots.style import (
    BLUE,
    GREY,
    LIGHT_BLUE,
    ORANGE,
    VERMILION,
    add_axes,
    house_style,
    new_figure,
)
from dlgmd_cli.plots.time_axis import label_time
from dlgmd_cli.results.tables import Result, Series

# Less than a millionth of P passes: a few cells' rounding, which would flatten the rest.
FLOOR_DB = -60.0
# What the vertical axis spans at least, so that rounding does not look like an event.
MIN_SPAN_DB = 5.0

# More dots than this touch each other: their black rims would hide the rest.
_MAX_RINGED = 200

_LEFT_IN, _BOTTOM_IN = 0.55, 0.38


def plot_mp(result: Result) -> Figure:
    """Normalised membrane potential with its threshold, spikes and collisions.

    Parameters
    ----------
    result : Result
        At least one frame; frames without a level leave a gap. Of a long result the line is the
        highest level of every column of pixels, over a band down to the lowest.
    """
    with house_style():
        figure, axes, columns = _single(result)
        _draw_level(axes, columns, result)
        _draw_spikes(axes, columns, result)
        for number, (start, duration) in enumerate(columns.spans(result.collision)):
            axes.axvspan(
                start,
                start + duration,
                color=VERMILION,
                alpha=0.25,
                linewidth=0.8,
                zorder=0,
                label="collision" if number == 0 else None,
            )
        label_time(axes, columns, result)
        _legend_above(figure, axes)
    return figure


def plot_attenuation(result: Result) -> Figure:
    """Attenuation 10 lg(ΣS/ΣP) in dB: a gap where undefined, a mark where next to nothing passes.

    Parameters
    ----------
    result : Result
        At least one frame. A long result is thinned as in `plot_mp`.
    """
    with house_style():
        figure, axes, columns = _single(result)
        silent = result.attenuation_db < FLOOR_DB  # -inf too, but not NaN
        shown = np.where(silent, np.nan, result.attenuation_db)
        _line(axes, columns, shown, label="attenuation")
        if silent.any():
            marked = columns.time_s[columns.any(silent)]
            axes.plot(
                marked,
                np.full(len(marked), 0.03),
                "v",
                color=VERMILION,
                markersize=3,
                transform=axes.get_xaxis_transform(),
                label=f"nothing passes (< {FLOOR_DB:g} dB)",
            )
        elif np.isnan(shown).all():
            too_few = np.isnan(result.s_sum).all()
            _note(axes, "too few frames" if too_few else "no picture changes")
        axes.set_ylim(_span_db(shown))
        axes.set_ylabel("Attenuation (dB)")
        label_time(axes, columns, result)
        _legend_above(figure, axes)
    return figure


def plot_spikes(result: Result) -> Figure:
    """Raster of spikes and collisions above the level that caused them.

    Parameters
    ----------
    result : Result
        At least one frame. A long result is thinned as in `plot_mp`, and spikes too near each
        other to be told apart are one bar.
    """
    with house_style():
        columns = Columns(result.time_s)
        figure = new_figure(2.6)
        raster = add_axes(figure, (_LEFT_IN, 1.75, AXES_WIDTH_IN, 0.44))
        level = add_axes(figure, (_LEFT_IN, _BOTTOM_IN, AXES_WIDTH_IN, 1.3))
        for row, flags, color in ((1, result.spike, BLUE), (0, result.collision, VERMILION)):
            low, high = row - 0.35, row + 0.35
            if columns.grouped:
                raster.broken_barh(
                    columns.spans(flags), (low, high - low), color=color, linewidth=0.3
                )
            else:
                raster.vlines(result.time_s[flags], low, high, color=color, linewidth=0.8)
        raster.set_xlim(columns.view)
        raster.set_yticks([1, 0], ["spikes", "collision"])
        raster.set_ylim(-0.6, 1.6)
        raster.set_xticks([])
        raster.spines["bottom"].set_visible(False)
        level.spines["top"].set_visible(False)
        _draw_level(level, columns, result)
        label_time(level, columns, result, frames_on=raster)
    return figure


def _single(result: Result) -> tuple[Figure, Axes, Columns]:
    """A figure of one panel, with room for the frame numbers and a legend above it."""
    figure = new_figure(2.17)
    axes = add_axes(figure, (_LEFT_IN, _BOTTOM_IN, AXES_WIDTH_IN, 1.25))
    return figure, axes, Columns(result.time_s)


def _line(axes: Axes, columns: Columns, values: Series, *, label: str) -> None:
    """A line that breaks at NaN, with a dot where a single value would draw nothing."""
    highest = columns.highest(values)
    known = ~np.isnan(highest)
    if not known.any():
        return
    before, after = np.concatenate(([False], known[:-1])), np.concatenate((known[1:], [False]))
    alone = known & ~before & ~after
    if columns.grouped:
        lowest = columns.lowest(values)
        axes.fill_between(columns.time_s, lowest, highest, color=LIGHT_BLUE, linewidth=0)
        axes.vlines(
            columns.time_s[alone], lowest[alone], highest[alone], color=LIGHT_BLUE, linewidth=0.4
        )
        label += " (max, range)"
    width = 0.7 if columns.grouped else 1.0
    axes.plot(columns.time_s, highest, color=BLUE, linewidth=width, label=label)
    axes.plot(columns.time_s[alone], highest[alone], ".", color=BLUE, markersize=3)


def _draw_level(axes: Axes, columns: Columns, result: Result) -> None:
    """The normalised membrane potential and its threshold."""
    _line(axes, columns, result.level, label="MP")
    threshold = float(result.threshold[0])
    axes.axhline(
        threshold, color=GREY, linestyle="--", linewidth=0.8, label=f"threshold {threshold:g}"
    )
    if np.isnan(result.level).all():
        too_few = np.isnan(result.mp).all()
        _note(axes, "too few frames" if too_few else "the membrane potential never changes")
    axes.set_ylim(-0.03, 1.05)
    axes.set_ylabel("Normalised MP")


def _draw_spikes(axes: Axes, columns: Columns, result: Result) -> None:
    """A dot at every spike, or at the highest one of every column."""
    spiking = columns.any(result.spike)
    if not spiking.any():
        return
    levels = columns.highest(np.where(result.spike, result.level, np.nan))
    crowded = np.count_nonzero(spiking) > _MAX_RINGED
    axes.plot(
        columns.time_s[spiking],
        levels[spiking],
        "o",
        color=ORANGE,
        markeredgecolor="black",
        markeredgewidth=0 if crowded or columns.grouped else 0.3,
        markersize=2 if crowded else 3,
        label="spike",
    )


def _span_db(shown: Series) -> tuple[float, float]:
    """Limits of the vertical axis, with room for the marks at the bottom."""
    if np.isnan(shown).all():
        return FLOOR_DB, 0.0
    low, high = float(np.nanmin(shown)), float(np.nanmax(shown))
    half = max(high - low, MIN_SPAN_DB) / 2 * 1.24
    return (low + high) / 2 - half, (low + high) / 2 + half


def _note(axes: Axes, why: str) -> None:
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


def _legend_above(figure: Figure, axes: Axes) -> None:
    """The legend over the frame axis, where it hides no data."""
    handles, labels = axes.get_legend_handles_labels()
    if handles:
        figure.legend(
            handles, labels, loc="upper center", ncols=4, borderaxespad=0.1, columnspacing=1.2
        )


# Every picture of a result: file name without suffix -> what draws it.
PLOTS = {"mp": plot_mp, "attenuation": plot_attenuation, "spikes": plot_spikes}
