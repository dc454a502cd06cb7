"""Seconds below a figure and frame numbers above it, at their true places."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.results.tables import Series

# Of a tick label: how wide a character is, how near two may come, how far one may stick out.
_CHARACTER_IN, _GAP_IN, _MARGIN_IN = 0.062, 0.1, 0.17
# More than these would be hard to take in.
_MAX_TICKS, _MAX_TICKS_PER_IN = 7, 1.7


def label_time(axes: Axes, timeline: Timeline, width_in: float, frames_on: Axes) -> None:
    """Seconds below `axes`, and frame numbers above `frames_on` if the results agree on them.

    `width_in` is how wide the axes are, in inches.
    """
    first, last = timeline.start_s, timeline.end_s
    seconds, step = _round_numbers(first, last, width_in)
    decimals = 2 if last == first else max(0, -math.floor(math.log10(step) + 1e-6))
    labels = [f"{value:.{decimals}f}" for value in seconds]
    axes.set_xlim(timeline.view)
    axes.set_xticks(*_readable(seconds, labels, timeline.view, width_in))
    axes.set_xlabel("Time (s)")
    frames_on.spines["top"].set_visible(False)
    if not timeline.is_shared:
        return
    numbers, _ = _round_numbers(*timeline.frames, width_in, integer=True)
    places = np.interp(numbers, timeline.frame, timeline.time_s)
    labels = [f"{number:.0f}" for number in numbers]
    top = frames_on.secondary_xaxis("top")
    top.set_xticks(*_readable(places, labels, timeline.view, width_in))
    top.set_xlabel("Frame")


def _round_numbers(
    first: float, last: float, width_in: float, *, integer: bool = False
) -> tuple[Series, float]:
    """A few round numbers from `first` to `last`, and the step between them."""
    if last == first:
        return np.array([float(first)]), 1.0
    widest = max(len(f"{value:.0f}") for value in (first, last))
    if not integer:
        decimals = max(0, math.ceil(-math.log10((last - first) / 8)))
        widest += decimals + (decimals > 0)
    room = int(width_in / (widest * _CHARACTER_IN + _GAP_IN))
    most = max(_MAX_TICKS, int(_MAX_TICKS_PER_IN * width_in))
    locator = MaxNLocator(min(max(room, 2), most), steps=[1, 2, 5, 10], integer=integer)
    numbers = np.asarray(locator.tick_values(first, last), dtype=np.float64)
    slack = 1e-9 * (last - first)
    inside = (numbers >= first - slack) & (numbers <= last + slack)
    return np.clip(numbers[inside], first, last), float(numbers[1] - numbers[0])


def _readable(
    places: Series, labels: list[str], view: tuple[float, float], width_in: float
) -> tuple[list[float], list[str]]:
    """Those ticks whose labels neither touch each other nor leave the figure."""
    left, right = view
    kept: tuple[list[float], list[str]] = ([], [])
    taken_in = -math.inf
    for place, label in zip(places, labels, strict=True):
        middle_in = (place - left) / (right - left) * width_in
        half_in = len(label) * _CHARACTER_IN / 2
        if middle_in - half_in >= taken_in and middle_in + half_in <= width_in + _MARGIN_IN:
            kept[0].append(float(place))
            kept[1].append(label)
            taken_in = middle_in + half_in + _GAP_IN
    return kept
