"""The rows of a result, one per processed frame: numbers as columns of the CSVs."""

import math
from array import array
from collections.abc import Iterable, Mapping
from operator import attrgetter
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Response
from dlgmd_cli.models.expansion import Measured
from dlgmd_cli.results.csv import TABLES

# What a model says about a frame, and what the expansion measures, of the tables' columns. The
# others follow from these.
_OF_MODEL, _OF_EXPANSION = (
    tuple(name for header in TABLES.values() for name in header if hasattr(kind, name))
    for kind in (Response, Measured)
)


_NOT_MEASURED = Measured()
_KNOWN = {name for header in TABLES.values() for name in header} | {"is_repeat"}


def row_type(more: Iterable[str] = ()) -> np.dtype:
    """The type of a row; a model's own columns come last, see `Model.columns`."""
    numbers = (*_OF_MODEL, *_OF_EXPANSION, *more)
    for name in more:
        if not name.isidentifier() or name in _KNOWN:
            why = f"the model's column {name!r} is not a name, or one of another column"
            raise ParameterError("", why, "Choose another name.")
    own: list[tuple[str, Any]] = [(name, np.float64) for name in numbers]
    return np.dtype([("frame", np.int64), ("time_s", np.float64), ("is_repeat", np.bool_), *own])


Rows = npt.NDArray[np.void]


class RowList:
    """Collects the rows of a result."""

    def __init__(self, more: Iterable[str] = ()) -> None:
        self._values, self._more = array("d"), tuple(more)
        self._type = row_type(self._more)
        self._of_model = attrgetter(*_OF_MODEL)
        self._of_expansion = attrgetter(*_OF_EXPANSION)

    def append(self, frame: Frame, response: Response, measured: Measured = _NOT_MEASURED) -> None:
        """Add the response to a frame, and the expansion beside it."""
        self._values.extend((frame.index, frame.time_s, frame.is_repeat))
        self._values.extend(self._of_model(response))
        self._values.extend(self._of_expansion(measured))
        self._values.extend(response.more.get(name, math.nan) for name in self._more)

    def __len__(self) -> int:
        return len(self._values) // len(self._type.names or ())

    def rows(self) -> Rows:
        """All rows, shape (n,), of type `row_type`."""
        columns = np.array(self._values).reshape(-1, len(self._type.names or ())).T
        return rows_of(dict(zip(self._type.names or (), columns, strict=True)), self._more)


def rows_of(columns: Mapping[str, Any], more: Iterable[str] = ()) -> Rows:
    """Rows from their columns, shape (n,), by name; `more` are a model's own.

    `frame` and `time_s` are required. Missing numbers are NaN, and without `is_repeat` no row is a
    duplicate. Columns that no row has are left out.
    """
    rows = np.zeros(len(columns["frame"]), row_type(more))
    for name in rows.dtype.names or ():
        if name in columns:
            rows[name] = columns[name]
        elif name != "is_repeat":
            rows[name] = np.nan
    return rows
