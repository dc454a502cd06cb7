"""The legend above a figure: as many entries to a row as there is room for."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from dlgmd_cli.plots.style import Width, figure_width_in
from dlgmd_cli.plots.text import plain, shortened, text_width_in

# What shows an entry, and its text as it was given.
Keys = list[tuple[Any, str]]

_SIZE_PT = 7
_EM_IN = _SIZE_PT / 72
# Of an entry, in em: the line, the room right of it, the room to the next; and outside of all.
_SHORT_HANDLE, _LONG_HANDLE, _PAD, _SPACING, _BORDER = 1.6, 3.2, 0.8, 1.2, 0.4
_ROW_PITCH_IN = 0.137
_MAX_TEXT_IN = 2.4


class LegendPlan:
    """How the entries go into rows, which decides how high a figure is.

    Parameters
    ----------
    keys : Keys
        The entries; none for no legend.
    width : "one" or "two"
        Of the figure.
    patterned : bool
        Whether lines are told apart by their dashes, which takes longer samples.

    Attributes
    ----------
    more_in : float
        What the rows after the first add to the figure's height, in inches.
    """

    def __init__(self, keys: Keys, width: Width, *, patterned: bool) -> None:
        self._handles = [handle for handle, _ in keys]
        self._labels = [shortened(label, _MAX_TEXT_IN, _SIZE_PT) for _, label in keys]
        self._handle = _LONG_HANDLE if patterned else _SHORT_HANDLE
        self._n_columns = self._fitting_columns(figure_width_in(width))
        n_rows = -(-len(keys) // max(self._n_columns, 1))
        self.more_in = max(0, n_rows - 1) * _ROW_PITCH_IN

    def _fitting_columns(self, room_in: float) -> int:
        """The number of columns that takes the fewest rows, and fills them evenly."""
        n = len(self._labels)
        for n_rows in range(1, n):
            n_columns = -(-n // n_rows)
            if self._total_in(n_columns) <= room_in:
                return n_columns
        return min(n, 1)

    def _total_in(self, n_columns: int) -> float:
        """Width of the whole with that many columns, in inches."""
        texts = np.array([text_width_in(label, _SIZE_PT) for label in self._labels])
        widest = sum(column.max() for column in np.array_split(texts, n_columns))
        around_em = n_columns * (self._handle + _PAD + _SPACING) - _SPACING + 2 * _BORDER
        return float(widest + around_em * _EM_IN)

    def draw(self, figure: Figure) -> None:
        """Put the legend at the upper edge of `figure`."""
        if self._handles:
            figure.legend(
                self._handles,
                [plain(label) for label in self._labels],
                loc="upper center",
                ncols=self._n_columns,
                borderaxespad=0.1,
                borderpad=_BORDER,
                columnspacing=_SPACING,
                handlelength=self._handle,
                handletextpad=_PAD,
                labelspacing=0.3,
            )
