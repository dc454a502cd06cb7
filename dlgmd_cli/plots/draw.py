"""What each kind of panel shows, of one result or of several."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from dlgmd_cli.plots.legend import Keys
from dlgmd_cli.plots.series import Trace, draw_line, note, reason
from dlgmd_cli.plots.style import GREY, ORANGE, VERMILION
from dlgmd_cli.results.tables import Flags, Series

# Less than a millionth of P passes: a few cells' rounding, which would flatten the rest.
FLOOR_DB = -60.0
# What the vertical axis spans at least, so that rounding does not look like an event.
MIN_SPAN_DB = 5.0
# Share of the attenuation axes that stays free above the lines, and at least below them.
_MARGIN = 0.12 / 1.24
# From one row of marks for silence to the next, in inches.
SILENCE_IN = 0.06

# The columns of a Result that a figure can show as its normalised membrane potential.
LEVELS = {"level": "Normalised MP", "mp_abs": "Normalised MP", "mp_seq": "Self-normalised MP"}

# More dots than this touch each other: their black rims would hide the rest.
_MAX_RINGED = 200


def draw_level(axes: Axes, traces: list[Trace], column: str = "level") -> Keys:
    """The normalised membrane potential, and the threshold if it is everyone's."""
    if column not in LEVELS:
        raise ValueError(f"column is {column!r}, none of {', '.join(LEVELS)}")
    levels = [getattr(trace.result, column) for trace in traces]
    keys = [
        key
        for trace, level in zip(traces, levels, strict=True)
        for key in draw_line(axes, trace, level)
    ]
    thresholds = {float(trace.result.threshold[0]) for trace in traces}
    held_against = all(
        column == "level" or np.array_equal(level, trace.result.level, equal_nan=True)
        for trace, level in zip(traces, levels, strict=True)
    )
    if held_against and len(thresholds) == 1 and traces[0].result.has_spikes:
        threshold = thresholds.pop()
        label = f"threshold {threshold:g}"
        line = axes.axhline(threshold, color=GREY, linestyle="--", linewidth=0.8, label=label)
        keys.append((line, label))
    if all(np.isnan(level).all() for level in levels):
        note(axes, reason(traces, "the membrane potential never changes"))
    axes.set_ylim(-0.03, 1.05)
    axes.set_ylabel(LEVELS[column])
    return keys


def draw_events(axes: Axes, trace: Trace, level: Series) -> Keys:
    """Spikes and collisions where the level of one result is drawn."""
    keys = _draw_spikes(axes, trace, level)
    for number, (start, duration) in enumerate(trace.columns.spans(trace.result.collision)):
        label = "collision" if number == 0 else None
        span = axes.axvspan(
            start,
            start + duration,
            color=VERMILION,
            alpha=0.25,
            linewidth=0.8,
            zorder=0,
            label=label,
        )
        if label:
            keys.append((span, label))
    return keys


def _draw_spikes(axes: Axes, trace: Trace, level: Series) -> Keys:
    """A dot at every spike, or at the highest one of every column."""
    columns, spike = trace.columns, trace.result.spike
    spiking = columns.any(spike)
    if not spiking.any():
        return []
    levels = columns.highest(np.where(spike, level, np.nan))
    crowded = np.count_nonzero(spiking) > _MAX_RINGED
    (dots,) = axes.plot(
        columns.time_s[spiking],
        levels[spiking],
        "o",
        color=ORANGE,
        markeredgecolor="black",
        markeredgewidth=0 if crowded or columns.grouped else 0.3,
        markersize=2 if crowded else 3,
        label="spike",
    )
    return [(dots, "spike")]


def is_silent(trace: Trace) -> Flags:
    """Where next to nothing passes: -inf too, but not NaN."""
    silent: Flags = trace.result.attenuation_db < FLOOR_DB
    return silent


def draw_attenuation(axes: Axes, traces: list[Trace], height_in: float) -> Keys:
    """Attenuation in dB, on axes of that height; marks below, a row each, where nothing passes."""
    silences = [is_silent(trace) for trace in traces]
    shown = [
        np.where(silent, np.nan, trace.result.attenuation_db)
        for trace, silent in zip(traces, silences, strict=True)
    ]
    keys = [
        key
        for trace, values in zip(traces, shown, strict=True)
        for key in draw_line(axes, trace, values)
    ]
    rows = [place for place, silent in enumerate(silences) if silent.any()]
    label = f"nothing passes (< {FLOOR_DB:g} dB)"
    for row, place in enumerate(reversed(rows)):
        trace = traces[place]
        marked = trace.columns.time_s[trace.columns.any(silences[place])]
        axes.plot(
            marked,
            np.full(len(marked), 0.03 + row * SILENCE_IN / height_in),
            "v",
            color=VERMILION if trace.alone else trace.color,
            markersize=3,
            transform=axes.get_xaxis_transform(),
            label=label,
        )
    if rows:
        color = VERMILION if traces[0].alone else GREY
        keys.append((Line2D([], [], marker="v", linestyle="", color=color, markersize=3), label))
    elif all(np.isnan(values).all() for values in shown):
        note(axes, reason(traces, "no picture changes"))
    more = max(len(rows) - 1, 0) * SILENCE_IN / height_in
    low, high = _span_db(shown, more)
    axes.set_ylim(low, high)
    if more:  # the marks must not look like values
        least = low + more * (high - low)
        axes.set_yticks([tick for tick in axes.get_yticks() if least <= tick <= high])
    axes.set_ylabel("Attenuation (dB)")
    return keys


def _span_db(shown: list[Series], rows: float) -> tuple[float, float]:
    """Limits of the vertical axis, with `rows` of it for further marks at the bottom."""
    known = [values[~np.isnan(values)] for values in shown]
    lowest = [float(values.min()) for values in known if values.size]
    highest = [float(values.max()) for values in known if values.size]
    if not lowest:
        return FLOOR_DB, 0.0
    low, high = min(lowest), max(highest)
    middle, half = (low + high) / 2, max(high - low, MIN_SPAN_DB) / 2
    whole = 2 * half / (1 - 2 * _MARGIN - rows)
    return middle - half - whole * (_MARGIN + rows), middle + half + whole * _MARGIN
