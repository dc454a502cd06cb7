"""The rows of a result, one per processed frame: a model's responses as columns of the CSVs."""

from array import array
from collections.abc import Mapping
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Response
from dlgmd_cli.results.csv import TABLES

# What a model says about a frame and a table holds. The other columns follow from these.
NUMBERS = tuple(name for header in TABLES.values() for name in header if hasattr(Response, name))
ROW = np.dtype(
    [
        ("frame", np.int64),
        ("time_s", np.float64),
        ("is_repeat", np.bool_),
        *((name, np.float64) for name in NUMBERS),
    ]
)
_NAMES = tuple(ROW.names or ())
Rows = npt.NDArray[np.void]


class RowList:
    """Collects the rows of a result."""

    def __init__(self) -> None:
        self._values = array("d")
        self._numbers_of = attrgetter(*NUMBERS)

    def append(self, frame: Frame, response: Response) -> None:
        """Add the response to a frame."""
        numbers = self._numbers_of(response)
        self._values.extend((frame.index, frame.time_s, frame.is_repeat, *numbers))

    def __len__(self) -> int:
        return len(self._values) // len(_NAMES)

    def rows(self) -> Rows:
        """All rows, shape (n,), of type `ROW`."""
        columns = np.array(self._values).reshape(-1, len(_NAMES)).T
        return rows_of(dict(zip(_NAMES, columns, strict=True)))


def rows_of(columns: Mapping[str, Any]) -> Rows:
    """Rows from their columns, shape (n,), by name.

    `frame` and `time_s` are required. Missing numbers are NaN, and without `is_repeat` no row is a
    repeat. Columns that no row has are left out.
    """
    rows = np.zeros(len(columns["frame"]), ROW)
    for name in NUMBERS:
        rows[name] = np.nan
    for name in _NAMES:
        if name in columns:
            rows[name] = columns[name]
    return rows
