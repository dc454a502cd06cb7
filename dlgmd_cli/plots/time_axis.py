"""Seconds below a figure and frame numbers above it, at their true places."""

import math

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.columns import AXES_WIDTH_IN, Columns
from dlgmd_cli.results.tables import Result, Series

# Of a tick label: how wide a character is, how near two may come, how far one may stick out.
_CHARACTER_IN, _GAP_IN, _MARGIN_IN = 0.062, 0.1, 0.17


def label_time(axes: Axes, columns: Columns, result: Result, frames_on: Axes | None = None) -> None:
    """Seconds below `axes`, frame numbers above (on `frames_on`, if that is the upper panel)."""
    left, right = columns.view
    first, last = float(result.time_s[0]), float(result.time_s[-1])
    seconds, step = _round_numbers(first, last)
    decimals = 2 if last == first else max(0, -math.floor(math.log10(step) + 1e-6))
    axes.set_xlim(left, right)
    axes.set_xticks(*_readable(seconds, [f"{value:.{decimals}f}" for value in seconds], axes))
    axes.set_xlabel("Time (s)")

    upper = frames_on or axes
    numbers, _ = _round_numbers(int(result.frame[0]), int(result.frame[-1]), integer=True)
    places = np.interp(numbers, result.frame, result.time_s)
    top = upper.secondary_xaxis("top")
    top.set_xticks(*_readable(places, [f"{number:.0f}" for number in numbers], axes))
    top.set_xlabel("Frame")
    upper.spines["top"].set_visible(False)


def _round_numbers(first: float, last: float, *, integer: bool = False) -> tuple[Series, float]:
    """Up to eight round numbers from `first` to `last`, and the step between them."""
    if last == first:
        return np.array([float(first)]), 1.0
    widest = max(len(f"{value:.0f}") for value in (first, last))
    if not integer:
        decimals = max(0, math.ceil(-math.log10((last - first) / 8)))
        widest += decimals + (decimals > 0)
    room = int(AXES_WIDTH_IN / (widest * _CHARACTER_IN + _GAP_IN))
    locator = MaxNLocator(min(max(room, 2), 7), steps=[1, 2, 5, 10], integer=integer)
    numbers = np.asarray(locator.tick_values(first, last), dtype=np.float64)
    slack = 1e-9 * (last - first)
    inside = (numbers >= first - slack) & (numbers <= last + slack)
    return np.clip(numbers[inside], first, last), float(numbers[1] - numbers[0])


def _readable(places: Series, labels: list[str], axes: Axes) -> tuple[list[float], list[str]]:
    """Those ticks whose labels neither touch each other nor leave the figure."""
    left, right = axes.get_xlim()
    kept: tuple[list[float], list[str]] = ([], [])
    taken_in = -math.inf
    for place, label in zip(places, labels, strict=True):
        middle_in = (place - left) / (right - left) * AXES_WIDTH_IN
        half_in = len(label) * _CHARACTER_IN / 2
        if middle_in - half_in >= taken_in and middle_in + half_in <= AXES_WIDTH_IN + _MARGIN_IN:
            kept[0].append(float(place))
            kept[1].append(label)
            taken_in = middle_in + half_in + _GAP_IN
    return kept
