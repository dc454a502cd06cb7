"""Series no finer than a figure can show: the rows of a long one grouped by column of pixels."""

import numpy as np
import numpy.typing as npt

from dlgmd_cli.plots.style import DPI, axes_width_in
from dlgmd_cli.results.tables import Flags, Series

# Up to here every row is drawn as it is.
MAX_ROWS = 2000


class Columns:
    """The rows of a result in the order of time, a column each or, if they are many, grouped.

    Nothing here is as long as the result, unless it is short: a figure of a day of video needs
    no more memory than one of a second.

    Parameters
    ----------
    time_s : array, shape (n,)
        Times of the rows, increasing; at least one.
    view : (float, float), optional
        What the time axis shows, in seconds, if other results share it; by default these rows.
    width_in : float, optional
        Width of the axes, in inches; by default those of a one-column figure.

    Attributes
    ----------
    grouped : bool
        Whether a column may hold several rows.
    time_s : array, shape (k,)
        Middle of every column that holds a row; k = n unless grouped.
    view : (float, float)
        What the time axis shows, in seconds.
    """

    def __init__(
        self,
        time_s: Series,
        view: tuple[float, float] | None = None,
        width_in: float | None = None,
    ) -> None:
        n, first, last = len(time_s), float(time_s[0]), float(time_s[-1])
        whole = (first, last) if last > first else (first - 0.5, first + 0.5)
        self.view = left, right = view or whole
        n_pixels = round((width_in or axes_width_in("one")) * DPI)
        self._pixel_s = (right - left) / n_pixels
        self.grouped = n > MAX_ROWS
        if self.grouped:
            n_columns = max(1, round((last - first) / self._pixel_s))
            edges = np.linspace(first, last, n_columns, endpoint=False)
            self._starts = np.unique(np.searchsorted(time_s, edges))  # without empty columns
        else:
            self._starts = np.arange(n)
        ends = np.append(self._starts[1:], n) - 1
        self.time_s = (time_s[self._starts] + time_s[ends]) / 2
        # A column lasts until halfway to the next one; the outermost as long as their neighbours.
        halfway = (time_s[ends[:-1]] + time_s[self._starts[1:]]) / 2
        if len(halfway):
            outermost = (2 * first - halfway[0], 2 * last - halfway[-1])
        else:
            # How long the only column lasts is unknown: all of its own figure, else a pixel.
            outermost = whole if self.view == whole else (first, last)
        self._edges = np.concatenate((outermost[:1], halfway, outermost[1:]))

    def highest(self, values: Series) -> Series:
        """Greatest value of every column; NaN where all of it is."""
        return np.fmax.reduceat(values, self._starts)

    def lowest(self, values: Series) -> Series:
        """Least value of every column; NaN where all of it is."""
        return np.fmin.reduceat(values, self._starts)

    def any(self, flags: Flags) -> Flags:
        """Which columns hold a flagged row."""
        return np.logical_or.reduceat(flags, self._starts)

    def spans(self, flags: Flags) -> list[tuple[float, float]]:
        """Start and duration of every unbroken stretch of flagged columns, in seconds.

        None is narrower than a column or a pixel, and all of them lie within the view.
        """
        left, right = self.view
        spans = []
        for first, last in _stretches(self.any(flags)):
            least = min(max(self._pixel_s, self._edges[last + 1] - self._edges[last]), right - left)
            start = min(max(self._edges[first], left), right - least)
            end = max(min(self._edges[last + 1], right), start + least)
            spans.append((float(start), float(end - start)))
        return spans


def _stretches(flags: Flags) -> npt.NDArray[np.intp]:
    """First and last place of every unbroken stretch, a row each."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return edges.reshape(-1, 2) - (0, 1)
