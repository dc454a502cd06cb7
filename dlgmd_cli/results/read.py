"""Results as they were written, read back: what a figure needs without decoding again."""

import csv
import math
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.comparison import COMPARISON_COLUMNS
from dlgmd_cli.results.folder import COMPARISON, RUN
from dlgmd_cli.results.tables import TABLES, Flags, Result, Series

(_COMPARE_CSV,) = (name for name in COMPARISON.names if name.endswith(".csv"))

_FLAGS = ("spike", "collision")
# No line of a result is nearly as long, but one of another file may be as long as the memory.
_MAX_LINE = 10_000
# More than any video has, and less than upsets sums and figures.
_MAX_FRAME, _MAX_NUMBER = 2.0**53, 1e30
_REMAKE = "Make the result anew, with --overwrite."


def comparison_at(path: Path) -> Path | None:
    """The compare.csv that `path` stands for, or None where it stands for a run.

    Parameters
    ----------
    path : Path
        A folder of results or a compare.csv. A folder that holds both is taken as a run.

    Raises
    ------
    ResultError
        If there is no such folder or file, or no result in it.
    """
    try:
        if path.name in (RUN.record, *TABLES) and path.is_file():
            raise ResultError(
                str(path), "it is one file of a result", "Give the folder that holds it."
            )
        if path.exists() and not path.is_dir():
            return path
        if not path.exists():
            raise ResultError(
                str(path), "there is no such folder or file", "Give one that 'dlgmd run' wrote."
            )
        if any((path / name).exists() for name in (RUN.record, *TABLES)):
            return None
        if (path / _COMPARE_CSV).exists():
            return path / _COMPARE_CSV
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise _unreadable(path, error) from None
    raise ResultError(
        str(path), "there is no result in this folder", "Give one that 'dlgmd run' wrote."
    )


def read_result(folder: Path) -> Result:
    """What `write_tables` wrote into `folder`.

    Parameters
    ----------
    folder : Path
        Holds mp.csv, attenuation.csv and spikes.csv.

    Returns
    -------
    Result
        At least one frame; numbers as written, to nine digits. NaN where a cell is empty.

    Raises
    ------
    ResultError
        If a file is missing, or not what `write_tables` writes, or the files do not belong
        together.
    """
    columns: dict[str, Series] = {}
    for name, expected in TABLES.items():
        path = folder / name
        table = _columns(_read(path, expected, labelled=False).get("", []), expected, path)
        if columns and not (
            np.array_equal(columns["frame"], table["frame"])
            and np.array_equal(columns["time_s"], table["time_s"])
        ):
            raise ResultError(
                str(path), f"its frames are not those of {next(iter(TABLES))}", _REMAKE
            )
        columns.update(table)
    return _result(columns)


def read_comparison(path: Path) -> dict[str, Result]:
    """Every result of a comparison, by label, in the order of the file.

    Parameters
    ----------
    path : Path
        A compare.csv: one row a label and frame.

    Returns
    -------
    dict of str to Result
        At least one. A comparison holds no sums and no spikes: `p_sum`, `s_sum` and `threshold`
        are NaN, nothing spikes, and `level` is `mp_abs`.

    Raises
    ------
    ResultError
        If it cannot be read, or is no such file.
    """
    results = {}
    for label, values in _read(path, COMPARISON_COLUMNS, labelled=True).items():
        columns = _columns(values, COMPARISON_COLUMNS[1:], path)
        undefined = np.full(len(columns["frame"]), np.nan)
        never = np.zeros(len(undefined))
        columns.update(dict.fromkeys(("p_sum", "s_sum", "threshold"), undefined))
        columns.update(dict.fromkeys(_FLAGS, never), level=columns["mp_abs"])
        results[label] = _result(columns)
    return results


def _result(columns: dict[str, Series]) -> Result:
    """The columns in the types that a Result has."""
    typed: dict[str, Any] = {**columns, "frame": columns["frame"].astype(np.int64)}
    typed.update((name, columns[name].astype(bool)) for name in _FLAGS)
    return Result(**typed)


def _read(path: Path, expected: tuple[str, ...], *, labelled: bool) -> dict[str, Any]:
    """The numbers of every label, row after row; the only label is "" unless `labelled`."""
    values: dict[str, array[float]] = {}
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):  # a pipe keeps one waiting
            raise ResultError(str(path), "it is not a file", _REMAKE)
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(_lines(file, path))
            if tuple(next(rows, ())) != expected:
                mend = "Give what 'dlgmd run' or 'dlgmd compare' wrote." if labelled else _REMAKE
                raise ResultError(str(path), f"its columns are not {','.join(expected)}", mend)
            for row in rows:
                label = row.pop(0) if labelled and row else ""
                if len(row) != len(expected) - labelled:
                    raise _bad_row(path, rows.line_num, f"it has not {len(expected)} cells")
                if label not in values:
                    values[label] = array("d")
                try:
                    values[label].extend(map(_number, row))
                except ValueError as error:
                    raise _bad_row(path, rows.line_num, str(error)) from None
    except FileNotFoundError:
        raise ResultError(str(path), "this file is missing", _REMAKE) from None
    except (OSError, ValueError, csv.Error) as error:  # ValueError: bytes that are no text
        raise _unreadable(path, error) from None
    if not values:
        raise ResultError(str(path), "it holds no frames", _REMAKE)
    return values


def _lines(file: Any, path: Path) -> Iterator[str]:
    """The lines of `file`, none of which may be long."""
    while line := file.readline(_MAX_LINE):
        if len(line) >= _MAX_LINE:
            raise ResultError(str(path), "it has lines too long for a table of results", _REMAKE)
        yield line


def _number(text: str) -> float:
    """A cell as a number; ValueError says what is wrong with it."""
    if not text:
        return math.nan
    try:
        return float(text)
    except ValueError:
        raise ValueError(f"{text[:40]!r} is no number") from None


def _columns(values: Any, names: tuple[str, ...], path: Path) -> dict[str, Series]:
    """The columns by name, after a look at those that are not just any numbers."""
    table = np.array(values, dtype=np.float64).reshape(-1, len(names))
    columns = {name: table[:, place].copy() for place, name in enumerate(names)}
    for why, is_bad in _faults(columns):
        if is_bad.any():
            frame = columns["frame"][int(np.argmax(is_bad))]
            raise ResultError(str(path), f"the row of frame {frame:g} {why}", _REMAKE)
    return columns


def _faults(columns: dict[str, Series]) -> Iterator[tuple[str, Flags]]:
    """What may be wrong with a row, and the rows where it is."""
    frame, time_s = columns["frame"], columns["time_s"]
    yield "has no frame number", ~((frame >= 0) & (frame < _MAX_FRAME)) | (frame != frame.round())
    yield "does not come after the row before it", np.diff(frame, prepend=-1.0) <= 0
    yield "has no time", ~(np.abs(time_s) < _MAX_NUMBER)
    yield "is earlier than the row before it", np.diff(time_s, prepend=-_MAX_NUMBER) < 0
    for name, values in columns.items():
        if name in _FLAGS:
            yield f"has neither 0 nor 1 as {name}", (values != 0) & (values != 1)
        else:
            allowed = np.isnan(values) | (np.abs(values) < _MAX_NUMBER)
            if name == "attenuation_db":
                allowed |= values == -np.inf
            yield f"is beyond all bounds in {name}", ~allowed


def _bad_row(path: Path, line: int, why: str) -> ResultError:
    return ResultError(str(path), f"line {line}: {why}", _REMAKE)


def _unreadable(path: Path, error: Exception) -> ResultError:
    """The error for what is no text, or may not be read."""
    reason = getattr(error, "strerror", None) or "it is no table of text"
    return ResultError(str(path), f"it cannot be read ({reason})", _REMAKE)
