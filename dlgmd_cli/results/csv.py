"""The rows of a result, the columns of every CSV, and functions to write and read them.

Spreadsheets interpret a cell that begins with ``=``, ``+``, ``-`` or ``@`` as a formula, which can
start programs and send data away. Text from outside is escaped; numbers are not changed.
"""

import csv
import math
import re
from array import array
from collections.abc import Iterable, Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, ResultError, argument, printable
from dlgmd_cli.machine.tables import read_table
from dlgmd_cli.models import detection
from dlgmd_cli.models.columns import MP, SPIKES, TABLES, Column, columns_of
from dlgmd_cli.models.detection import AlarmSpan, Detection
from dlgmd_cli.parameters.facts import Value

# A value in a row of a table. File name -> columns and rows of the table.
Cell = Value | None
Cells = Mapping[str, tuple[Sequence[str], Iterable[Sequence[Cell]]]]
# A table with named columns. The rows of a result, one per processed frame.
Table = npt.NDArray[np.void]
Rows = Table
# Name -> column that was read, shape (n,): float64, or texts.
Columns = dict[str, npt.NDArray[Any]]
# Type of a column -> type in the rows.
_DTYPES = {int: np.int64, float: np.float64, bool: np.bool_, str: "U16"}

# Every column of a result: those of the rows, and those that need the end of the video, or belong
# to the whole result. A column is an attribute of `Result`.
COLUMNS = (
    *detection.COLUMNS,
    Column(
        "mp_seq", "–", "the MP from the video's minimum (0) to its maximum (1), as in the paper"
    ),
    Column("threshold", "–", "normalised MP at which spikes begin", (SPIKES,)),
)
KNOWN = frozenset(one.name for one in COLUMNS)
_TEXTS = frozenset(one.name for one in COLUMNS if one.kind is str)
# The columns of alarms.csv.
ALARM_COLUMNS = tuple(one.name for one in columns_of(AlarmSpan))
# The columns of compare.csv, in long form: the label, and every column of a result.
COMPARISON = ("label", *(one.name for one in COLUMNS))
# The required columns of a table. If a file lacks another column, its values are undefined.
_NEEDED = frozenset({"frame", "time_s", "mp", "signal", "level", "attenuation_db"})

# Some spreadsheets accept full-width and small forms and the mathematical minus sign, too.
_STARTS_FORMULA = re.escape("=+-@＝＋－＠﹦﹢﹣﹫−")
# Characters that a spreadsheet may strip from the start of a cell.
_DROPPED = r"[\s\"']*"
_AT_START = re.compile(f"(?={_DROPPED}[{_STARTS_FORMULA}])")
_BEHIND_SEPARATOR = re.compile(f"(;{_DROPPED})([{_STARTS_FORMULA}])")
_MAX_NUMBER = 1e30


def _run_again() -> str:
    """The hint of errors about a damaged table."""
    return f"Run again with {argument('overwrite', True)}."


def headers(more: Iterable[str] = ()) -> dict[str, tuple[str, ...]]:
    """The columns of each table with a row per frame; the model's own columns `more` end mp.csv."""
    names = {table: [c.name for c in COLUMNS if table in c.tables] for table in TABLES}
    return {table: (*own, *(more if table == MP else ())) for table, own in names.items()}


def cell(value: Cell) -> str:
    """A number as text that reads back exactly as float32, empty for NaN and None; or a text."""
    if isinstance(value, str):
        return text_cell(value)
    return "" if value is None or value != value else f"{float(value):.9g}"


def text_cell(text: str) -> str:
    """Text from outside, such as a file name, on one line and not a formula in a spreadsheet.

    Text that would start a formula is prefixed with ``./``, so that a path still refers to the same
    file. After a semicolon, where some programs split cells, the first character of a formula is
    escaped. The function is idempotent.
    """

    def escaped(match: re.Match[str]) -> str:
        code = ord(match[2])
        return match[1] + (f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}")

    line = _BEHIND_SEPARATOR.sub(escaped, printable(text))
    return f"./{line}" if _AT_START.match(line) else line


def cells(header: Sequence[str], row: Iterable[Cell]) -> list[str]:
    """A row as text; times, in columns whose names end in ``_s``, have six decimals or more.

    Nine digits alone would give two frames of a recording of hours the same time.
    """
    return [
        f"{value:.6f}".rstrip("0").rstrip(".")
        if name.endswith("_s") and isinstance(value, float) and 1e3 <= abs(value) < math.inf
        else cell(value)
        for name, value in zip(header, row, strict=True)
    ]


def write_rows(path: Path, header: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Write cells as CSV; OSError passes through."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def write_values(path: Path, header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> None:
    """Write texts and numbers as CSV, None as an empty cell; OSError passes through."""
    write_rows(path, header, (cells(header, row) for row in rows))


def table_of(header: Sequence[str], rows: Iterable[Sequence[Cell]]) -> Table:
    """Texts and numbers as a structured array, shape (n,), with the columns of a CSV.

    None becomes an empty text or NaN. Select rows as ``table[table["alarms"] > 0]``;
    ``pandas.DataFrame(table)`` accepts the array.
    """
    arrays = {}
    columns = [*zip(*rows, strict=True)] or [()] * len(header)
    for name, column in zip(header, columns, strict=True):
        empty: str | float = "" if any(isinstance(value, str) for value in column) else math.nan
        arrays[name] = np.array([empty if value is None else value for value in column])
    return table_from(arrays)


def table_from(arrays: Mapping[str, npt.NDArray]) -> Table:
    """Columns, each of shape (n,), as a structured array."""
    n_rows = len(next(iter(arrays.values())))
    table = np.empty(n_rows, [(name, values.dtype) for name, values in arrays.items()])
    for name, values in arrays.items():
        table[name] = values
    return table


def read_columns(path: Path, header: tuple[str, ...], *, complete: bool = True) -> Columns:
    """Read the columns of a CSV, shape (n,) with n >= 1; empty cells of numbers are NaN.

    Columns that an older file lacks, or that only a newer version knows, are left out. If the file
    is not `complete`, a last row that was cut off, as on a full disk, is left out as well.

    Raises ResultError if the file cannot be read, is another table, or does not contain frames in
    order.
    """
    columns = _read(path, header, complete=complete)
    _require_order(path, columns)
    return {name: column for name, column in columns.items() if name in header}


def read_comparison_columns(path: Path) -> dict[str, Columns]:
    """Label -> columns of a compare.csv, in the file's order of labels; raises ResultError."""
    columns, by_label = _read(path, COMPARISON), dict[str, Columns]()
    labels = columns.pop(COMPARISON[0])
    for label in dict.fromkeys(labels.tolist()):
        by_label[label] = {name: column[labels == label] for name, column in columns.items()}
        _require_order(path, by_label[label])
    return by_label


def contact_beside(path: str) -> float | None:
    """Time (s) of a rendered clip's collision, from the ground truth beside the clip, or None."""
    try:
        table = read_table(Path(path).with_suffix(".csv"), ResultError)
        times_s, left_s = table.numbers("time_s"), table.numbers("time_to_contact_s")
    except ResultError:
        return None
    contact_s = float(times_s[0] + left_s[0]) if len(times_s) else math.nan
    return contact_s if math.isfinite(contact_s) else None


def _read(path: Path, header: tuple[str, ...], *, complete: bool = True) -> Columns:
    """The columns of a table whose header is checked against `header`; raises ResultError."""
    table = read_table(path, ResultError, _run_again())
    names, rows = table.names, table.rows
    is_whole = _NEEDED.intersection(header) <= set(names) and names[:1] == [*header[:1]]
    if not is_whole or len(set(names)) < len(names):
        raise ResultError(str(path), f"its columns are not {','.join(header)}", _run_again())
    if not complete and rows and len(rows[-1]) < len(names):
        del rows[-1]
    if not rows:
        raise ResultError(str(path), "contains no frames", _run_again())
    for row, cells in enumerate(rows):
        if len(cells) != len(names):
            raise table.at(row, "", f"it does not have {len(names)} cells", _run_again())
    texts = _TEXTS | {COMPARISON[0]}
    return {
        name: np.array(table.texts(name)) if name in texts else table.numbers(name)
        for name in names
    }


def _require_order(path: Path, columns: Columns) -> None:
    """Raise ResultError unless frames and times are in order, and numbers not too large."""
    numbers = {name: column for name, column in columns.items() if name not in _TEXTS}
    frame, time_s = columns["frame"], columns["time_s"]
    is_in_order = (
        (frame == frame.round()) & (np.diff(frame, prepend=-1.0) > 0) & (frame < 2**53)
    ).all() and (np.isfinite(time_s) & (np.diff(time_s, prepend=time_s[0]) >= 0)).all()
    if (
        not is_in_order
        or any((one[np.isfinite(one)] > _MAX_NUMBER).any() for one in numbers.values())
        or any(np.isposinf(column).any() for name, column in numbers.items() if name != "ffi")
    ):
        raise ResultError(str(path), "its rows are not frames in order", _run_again())


def row_type(more: Iterable[str] = ()) -> np.dtype:
    """The dtype of a row; a model's own columns come last, see `Model.columns`."""
    for name in more:
        if not name.isidentifier() or name in KNOWN:
            why = f"the model's column {name!r} is not a name, or one of another column"
            raise ParameterError("", why, "Choose another name.")
    own = [(name, np.float64) for name in more]
    return np.dtype([*((one.name, _DTYPES[one.kind]) for one in detection.COLUMNS), *own])


class RowList:
    """Collects the rows of a result."""

    def __init__(self, more: Iterable[str] = ()) -> None:
        self._type, self._more = row_type(more), tuple(more)
        names = [one.name for one in detection.COLUMNS]
        self._numbers, self._texts = array("d"), list[tuple[str, ...]]()
        numbers = [name for name in names if name not in _TEXTS]
        self._take_numbers, self._n_numbers = attrgetter(*numbers), len(numbers) + len(self._more)
        self._take_texts = attrgetter(*(name for name in names if name in _TEXTS))

    def append(self, row: Detection) -> None:
        """Add what a frame gave."""
        self._numbers.extend(self._take_numbers(row))
        self._numbers.extend(row.more.get(name, math.nan) for name in self._more)
        self._texts.append(self._take_texts(row))

    def __len__(self) -> int:
        return len(self._texts)

    def rows(self) -> Rows:
        """All rows, shape (n,), of type `row_type`."""
        names = self._type.names or ()
        numbers = iter(np.array(self._numbers).reshape(len(self), self._n_numbers).T)
        texts = iter(np.array(self._texts, object).reshape(len(self), len(_TEXTS)).T)
        return rows_of(
            {name: next(texts if name in _TEXTS else numbers) for name in names}, self._more
        )


def rows_of(columns: Mapping[str, npt.ArrayLike], more: Iterable[str] = ()) -> Rows:
    """Rows from columns of shape (n,) by name; `more` are the names of a model's own columns.

    `frame` and `time_s` are required. Missing numbers become NaN, missing flags False. Columns that
    are not in `row_type` are left out.
    """
    rows = np.zeros(len(np.atleast_1d(columns["frame"])), row_type(more))
    for name in rows.dtype.names or ():
        if name in columns:
            rows[name] = columns[name]
        elif rows.dtype[name] == np.float64:
            rows[name] = np.nan
    return rows
