"""What a model says over time: membrane potential, attenuation, spikes. Data in, Figure out."""

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.style import BLUE, COLUMN_WIDTH_IN, GREY, ORANGE, VERMILION, house_style
from dlgmd_cli.results.tables import Flags, Result, Series

_GOLDEN = 0.62
# Less than a millionth of P passes: a few cells' rounding, which would flatten the rest.
FLOOR_DB = -60.0


def plot_mp(result: Result) -> Figure:
    """Normalised membrane potential with its threshold, spikes and collisions.

    Parameters
    ----------
    result : Result
        At least one frame; frames without a level leave a gap.
    """
    with house_style():
        figure = _figure()
        axes = figure.subplots()
        _draw_level(axes, result)
        _draw_alarms(axes, result)
        _label_time(axes, result)
        _legend_above(figure, axes)
    return figure


def plot_attenuation(result: Result) -> Figure:
    """Attenuation 10 lg(ΣS/ΣP) in dB: a gap where undefined, a mark where next to nothing passes.

    Parameters
    ----------
    result : Result
        At least one frame.
    """
    with house_style():
        figure = _figure()
        axes = figure.subplots()
        silent = result.attenuation_db < FLOOR_DB  # -inf too, but not NaN
        shown = np.where(silent, np.nan, result.attenuation_db)
        _line(axes, result.time_s, shown, color=BLUE, label="attenuation")
        if silent.any():
            axes.plot(
                result.time_s[silent],
                np.full(silent.sum(), 0.03),
                "v",
                color=VERMILION,
                markersize=3,
                transform=axes.get_xaxis_transform(),
                label=f"nothing passes (< {FLOOR_DB:g} dB)",
            )
        if np.isnan(shown).all():
            axes.set_ylim(FLOOR_DB, 0)
        axes.set_ylabel("Attenuation (dB)")
        axes.margins(y=0.12)
        _label_time(axes, result)
        _legend_above(figure, axes)
    return figure


def plot_spikes(result: Result) -> Figure:
    """Raster of spikes and collisions above the level that caused them.

    Parameters
    ----------
    result : Result
        At least one frame.
    """
    with house_style():
        figure = _figure(height=0.75)
        raster, level = figure.subplots(
            2, 1, sharex=True, gridspec_kw={"height_ratios": [1, 3], "hspace": 0.08}
        )
        rows = ((1, result.spike, BLUE), (0, result.collision, VERMILION))
        for row, flags, color in rows:
            raster.vlines(result.time_s[flags], row - 0.35, row + 0.35, color=color, linewidth=0.8)
        raster.set_yticks([1, 0], ["spikes", "collision"])
        raster.set_ylim(-0.6, 1.6)
        raster.tick_params(axis="x", labelbottom=False, length=0)
        raster.spines["bottom"].set_visible(False)
        _draw_level(level, result, spikes=False)
        _label_time(level, result, frames_on=raster)
        figure.align_ylabels([level])
    return figure


def _figure(height: float = _GOLDEN) -> Figure:
    return Figure(figsize=(COLUMN_WIDTH_IN, COLUMN_WIDTH_IN * height), layout="constrained")


def _line(axes: Axes, time_s: Series, values: Series, *, color: str, label: str) -> None:
    """A line that breaks at NaN, with a dot where a single value would draw nothing."""
    axes.plot(time_s, values, color=color, label=label)
    known = ~np.isnan(values)
    before, after = np.concatenate(([False], known[:-1])), np.concatenate((known[1:], [False]))
    alone = known & ~before & ~after
    axes.plot(time_s[alone], values[alone], ".", color=color, markersize=3)


def _draw_level(axes: Axes, result: Result, *, spikes: bool = True) -> None:
    """The normalised membrane potential and its threshold."""
    _line(axes, result.time_s, result.level, color=BLUE, label="MP")
    threshold = float(result.threshold[0])
    axes.axhline(
        threshold, color=GREY, linestyle="--", linewidth=0.8, label=f"threshold {threshold:g}"
    )
    if spikes and result.spike.any():
        axes.plot(
            result.time_s[result.spike],
            result.level[result.spike],
            "o",
            color=ORANGE,
            markeredgecolor="black",
            markeredgewidth=0.3,
            markersize=3,
            label="spike",
        )
    axes.set_ylim(-0.03, 1.05)
    axes.set_ylabel("Normalised MP")


def _draw_alarms(axes: Axes, result: Result) -> None:
    """Shade every collision, from its first frame to its last."""
    for number, (first, last) in enumerate(_stretches(result.collision)):
        axes.axvspan(
            result.time_s[first],
            result.time_s[last],
            color=VERMILION,
            alpha=0.25,
            linewidth=0.8,
            label="collision" if number == 0 else None,
        )


def _stretches(flags: Flags) -> list[tuple[int, int]]:
    """First and last row of every unbroken stretch."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return [(int(first), int(end) - 1) for first, end in edges.reshape(-1, 2)]


def _label_time(axes: Axes, result: Result, frames_on: Axes | None = None) -> None:
    """Seconds below, frame numbers above (on `frames_on`, if that is the upper panel)."""
    time_s, frame = result.time_s, result.frame.astype(np.float64)
    axes.set_xlabel("Time (s)")
    if time_s[-1] > time_s[0]:
        axes.set_xlim(time_s[0], time_s[-1])
        top = (frames_on or axes).secondary_xaxis(
            "top",
            functions=(
                lambda seconds: _along(seconds, time_s, frame),
                lambda number: _along(number, frame, time_s),
            ),
        )
        top.xaxis.set_major_locator(MaxNLocator(nbins=7, integer=True))
        top.set_xlabel("Frame")
    (frames_on or axes).spines["top"].set_visible(False)


def _along(values: npt.ArrayLike, known: Series, matching: Series) -> npt.NDArray[np.float64]:
    """Read `matching` at `values` of `known`, both increasing; straight on outside."""
    values = np.asarray(values, dtype=np.float64)
    inside = np.interp(values, known, matching)
    slope = (matching[-1] - matching[0]) / (known[-1] - known[0])
    below = matching[0] + (values - known[0]) * slope
    above = matching[-1] + (values - known[-1]) * slope
    return np.where(values < known[0], below, np.where(values > known[-1], above, inside))


def _legend_above(figure: Figure, axes: Axes) -> None:
    """The legend over the frame axis, where it hides no data."""
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=4)


# Every picture of a result: file name without suffix -> what draws it.
PLOTS = {"mp": plot_mp, "attenuation": plot_attenuation, "spikes": plot_spikes}
