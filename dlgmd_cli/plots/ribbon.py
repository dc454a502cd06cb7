"""The trace of a whole film as one long ribbon of pixels, of which only a few lengths exist."""

import math
from functools import lru_cache

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.plots.pixels import BgrImage, film_style, pixel_figure, rasterised
from dlgmd_cli.plots.style import BLUE, GREY, ORANGE
from dlgmd_cli.results.tables import Result

# What the ribbon shows at once: so many seconds, and frames at least, unless the film is shorter.
WINDOW_S = 10.0
MIN_FRAMES = 50
# Of the normalised membrane potential, from the bottom to the top.
LEVELS = (-0.03, 1.05)
# Below the trace, for the numbers of the time axis.
TICKS_PX = 30
# Vermilion, a quarter of it: an opaque colour does not show where two bars overlap.
LIGHT_VERMILION = "#F5D6BF"

# How far a length is drawn beyond its ends, as a share of it.
_OVERLAP = 1 / 39
# On and off, in points; 15 px together, into which lengths of 1170 px divide, and their overlap.
_DASHES = (0, (7.2, 3.6))


class Ribbon:
    """The normalised membrane potential over time, drawn in lengths of one window each.

    Pixels count from the first frame's time, to the left as well; ribbons before and after the
    film are empty. Needs memory for a few windows, whatever the length of the film.

    Parameters
    ----------
    result : Result
        At least one frame.
    width, height : int
        Of the window, in px; `TICKS_PX` of the height are for the numbers.

    Attributes
    ----------
    interval_s : float
        Usual time from frame to frame.
    window_s : float
        How much time a window shows.
    """

    def __init__(self, result: Result, width: int, height: int) -> None:
        self._result = result
        self.width, self.height = width, height
        times = result.time_s
        self.interval_s = float(np.median(np.diff(times))) if times.size > 1 else 1.0
        # The last frame, too, lasts some time.
        self._first_s, self._end_s = float(times[0]), float(times[-1]) + self.interval_s
        self.window_s = min(
            max(WINDOW_S, MIN_FRAMES * self.interval_s), self._end_s - self._first_s
        )
        self._length = lru_cache(maxsize=3)(self._draw)

    def place(self, time_s: float) -> int:
        """The pixel at which a time stands."""
        return round((time_s - self._first_s) / self.window_s * self.width)

    def level_y(self, level: float) -> int:
        """The row of pixels at which a level stands."""
        low, high = LEVELS
        return round((high - level) / (high - low) * (self.height - TICKS_PX))

    def cut(self, left: int, width: int, now: int) -> BgrImage:
        """The pixels from `left` on, with the trace up to `now` only."""
        pieces = []
        at = left
        while at < left + width:
            number, offset = divmod(at, self.width)
            n_pixels = min(self.width - offset, left + width - at)
            empty, full = self._length(number)
            n_past = min(max(now - at, 0), n_pixels)
            pieces.append(full[:, offset : offset + n_past])
            pieces.append(empty[:, offset + n_past : offset + n_pixels])
            at += n_pixels
        return np.hstack(pieces)

    def _draw(self, number: int) -> tuple[BgrImage, BgrImage]:
        """One length of the ribbon, without and with the trace."""
        left_s = self._first_s + (number - _OVERLAP) * self.window_s
        right_s = left_s + (1 + 2 * _OVERLAP) * self.window_s
        with film_style():
            figure = pixel_figure(self.width, self.height)
            # Wider than the picture, so that what reaches across the cut is on both sides of it.
            bottom = TICKS_PX / self.height
            axes = figure.add_axes((-_OVERLAP, bottom, 1 + 2 * _OVERLAP, 1 - bottom))
            axes.set_xlim(left_s, right_s)
            axes.set_ylim(*LEVELS)
            axes.axhline(
                float(self._result.threshold[0]), color=GREY, linestyle=_DASHES, linewidth=1.0
            )
            axes.spines[:].set_visible(False)
            axes.set_yticks([])
            self._label_time(axes)
            empty = rasterised(figure)
            self._draw_trace(axes)
            return empty, rasterised(figure)

    def _label_time(self, axes: Axes) -> None:
        """Round times, the same on every length; none where there is no film."""
        steps = MaxNLocator(10, steps=[1, 2, 5, 10]).tick_values(0.0, self.window_s)
        step = float(steps[1] - steps[0])
        decimals = max(0, -math.floor(math.log10(step) + 1e-6))
        left_s, right_s = axes.get_xlim()
        numbers = range(math.ceil(left_s / step), math.floor(right_s / step) + 1)
        slack = step * 1e-6
        times = [
            number * step
            for number in numbers
            if self._first_s - slack <= number * step <= self._end_s
        ]
        axes.set_xticks(times, [f"{time_s:.{decimals}f}" for time_s in times])

    def _draw_trace(self, axes: Axes) -> None:
        """What the model said."""
        result = self._result
        left_s, right_s = axes.get_xlim()
        first, last = (int(row) for row in np.searchsorted(result.time_s, [left_s, right_s]))
        # One frame more on either side: lines come from there.
        rows = slice(max(first - 1, 0), last + 1)
        time_s, level = result.time_s[rows], result.level[rows]
        spike, collision = result.spike[rows], result.collision[rows]
        if not time_s.size:
            return
        ends = np.append(time_s[1:], min(time_s[-1] + self.interval_s, self._end_s))
        low, high = LEVELS
        axes.broken_barh(
            list(zip(time_s[collision], (ends - time_s)[collision], strict=True)),
            (low, high - low),
            color=LIGHT_VERMILION,
            linewidth=0,
        )
        axes.plot(time_s, level, color=BLUE, linewidth=1.6)
        axes.plot(
            *(time_s[spike], level[spike], "o"),
            color=ORANGE,
            markeredgecolor="black",
            markeredgewidth=0.5,
            markersize=6,
        )
