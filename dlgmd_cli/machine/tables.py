"""The one reader of tables: labels, truths, times, headings and results, from any program."""

import codecs
import csv
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from io import StringIO
from itertools import takewhile
from operator import itemgetter
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, counted, printable
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import similar_path

MAX_BYTES = 1 << 30
# The first of them that the first line has separates the cells.
_DELIMITERS = {"\t": "tabs", ";": "semicolons", "|": "bars", ",": "commas"}
# A character that no text has: the delimiter of a table with a single column.
_NONE = "\x1f"
PLAIN = "UTF-8, separated by commas"
_MOST_NAMED = 12
# What may stand above a table: nothing, a comment, and Excel's line that names the delimiter.
_SEP = re.compile(r'"?sep=(.)', re.I)
_ABOVE = re.compile(rf"\s*([#%]|$)|{_SEP.pattern}", re.I)
# Comments below the header; the name of a video may begin with #.
_COMMENTS = ("# ", "% ")
EMPTY = frozenset(("", "-", "–", "--", "na", "n/a", "nan", "none", "null"))
_UNIT = re.compile(
    r"(?i)[\[(]?([nuµμm]?s|sec|seconds|min|h|[km]?m|cm|k?m/[sh]|deg|°|degrees|rad|px|1/s|hz)[\])]?"
)
# 1,234 in a table with commas: a group of thousands, or three decimals.
_ONE_GROUP = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_CLOCK = re.compile(
    r"(?:(?P<date>\d{4}[-/]\d\d?[-/]\d\d?)[T ]\s*(?=\d+:\d+:)|(?P<days>\d+) days?,? )?"
    r"(?:(?P<h>\d+):)?(?P<m>\d+):(?P<s>[0-5]\d(?:[.,]\d+)?)\s*(?P<zone>Z|[+-]\d\d:?\d\d)?"
)


def plain(name: str) -> str:
    """The name of a column in lower case and underscores: ``Speed [m/s]`` -> ``speed_m_s``."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return re.sub(r"[^a-z0-9µμ]+", "_", parted.lower()).strip("_")


def number(text: str) -> float | None:
    """The number in a cell, also ``0,5`` and ``1 234``; None if it is no number, or infinite."""
    text = re.sub(r"(?<=\d)[\s'](?=\d{3}(?!\d))", "", text.replace("−", "-"))
    try:
        found = float(text.replace(",", "."))
    except ValueError:
        return None
    return found if math.isfinite(found) else None


def clock(text: str) -> float | None:
    """The seconds of ``hh:mm:ss``, ``mm:ss``, or of a date and a time since 1970; None otherwise.

    Fractions may follow the seconds, and ``Z`` or ``+02:00`` the time. A date without a zone is
    taken as UTC. Seconds since 1970 are exact to 0.2 µs.
    """
    match = _CLOCK.fullmatch(text.strip())
    if match is None:
        return None
    start_s = 86400.0 * int(match["days"] or 0)
    if match["date"]:
        day = match["date"].replace("/", "-") + (match["zone"] or "Z")
        try:
            start_s = datetime.strptime(day, "%Y-%m-%d%z").timestamp()
        except ValueError:
            return None
    minutes = 60 * int(match["h"] or 0) + int(match["m"])
    return start_s + 60 * minutes + float(match["s"].replace(",", "."))


def listed(names: Sequence[str]) -> str:
    """Names of columns, in words."""
    return printable(", ".join(names[:_MOST_NAMED]) + (", …" if names[_MOST_NAMED:] else ""))


@dataclass(frozen=True)
class TextTable:
    """A table as it was read.

    Attributes
    ----------
    path : Path
        The file.
    names, units : list of str
        The header, empty where there is none, and the cells of a row of units below.
    rows : list of list of str
        The cells of the rows, which may be fewer than the columns.
    lines : list of int
        The line in the file at which each row ends.
    remark : str
        The comments before the table.
    form : str
        The encoding and the delimiter, in words.
    fault : type
        The class of errors.
    """

    path: Path
    names: list[str]
    units: list[str]
    rows: list[list[str]]
    lines: list[int]
    remark: str
    form: str
    fault: type[DlgmdError]

    def place(self, name: str) -> int | None:
        """The place of a column, by its name or its `plain` name; raises if there are two."""
        places = [at for at, one in enumerate(self.names) if one == name]
        places = places or [at for at, one in enumerate(self.names) if plain(one) == name]
        if len(places) > 1:
            raise self.fault(str(self.path), f"has the column {name} twice", "Remove one of them.")
        return places[0] if places else None

    def require(self, *names: str, what: str) -> None:
        """Raise an error unless the table, `what` in words, has these columns."""
        if missing := [name for name in names if self.place(name) is None]:
            has = f"its columns are {listed(self.names)}" if any(self.names) else "it has no header"
            why = f"is not a table of {what}: it lacks {listed(missing)}; {has} ({self.form})"
            raise self.fault(str(self.path), why, f"Its first line should be {','.join(names)}.")

    def texts(self, name: str) -> list[str]:
        """The cells of a column, without surrounding spaces; empty if it is missing."""
        return [*map(str.strip, self._cells(name))]

    def _cells(self, name: str) -> list[str]:
        at = self.place(name)
        if at is None:
            return [""] * len(self.rows)
        try:
            return [*map(itemgetter(at), self.rows)]
        except IndexError:
            return [cells[at] if at < len(cells) else "" for cells in self.rows]

    def numbers(self, name: str, *, clocks: bool = False) -> npt.NDArray[np.float64]:
        """The numbers of a column, (n,), NaN for empty cells; with `clocks`, also of times in s.

        Raises an error for another text, and for ``1,234`` in a table with commas where no other
        cell of the column has a decimal comma.
        """
        try:
            return np.array([float(cell or "nan") for cell in self._cells(name)])
        except ValueError:
            cells = self.texts(name)
        is_decimal = any("," in cell and not _ONE_GROUP.fullmatch(cell) for cell in cells)
        is_open = "commas" in self.form and not is_decimal
        numbers = np.full(len(cells), math.nan)
        for row, cell in enumerate(cells):
            if cell.lower() in EMPTY:
                continue
            if is_open and _ONE_GROUP.fullmatch(cell):
                why = f"{cell!r} may be a thousand times {cell.replace(',', '.')}"
                raise self.at(row, name, why, "Write it without a comma.")
            found = number(cell)
            if found is None and clocks:
                found = clock(cell)
            if found is None:
                times = ", or a time as 00:01:12.5" if clocks else ""
                raise self.at(row, name, f"{cell[:40]!r} is no number", f"Write 12.5{times}.")
            numbers[row] = found
        return numbers

    def at(self, row: int, name: str, why: str, hint: str = "") -> DlgmdError:
        """The error about a cell, or about a row if `name` is empty."""
        where = f"line {self.lines[row]}" + (f", column {name}" if name else "")
        return self.fault(str(self.path), f"{where}: {printable(why)}", hint)


def read_table(path: Path, fault: type[DlgmdError], hint: str = "") -> TextTable:
    """Read a table of any program, such as a spreadsheet, pandas, R, or a camera.

    The encoding is that of the byte order mark, else UTF-8 or cp1252. Cells are separated by tabs,
    semicolons, bars or commas, the first of them that the first line has; ``sep=;`` may stand
    before it. Lines that begin with ``#`` are comments. If the first row has numbers, the header is
    the comment before it, if that has as many cells.

    Raises the error `fault` if the file cannot be read as a table, with `hint` if it is missing or
    no text, and if it is larger than 1 GiB.
    """
    encoding, lines = _lines(path, fault, hint)
    above = [*takewhile(_ABOVE.match, lines)]
    remarks = [line.strip().lstrip("#% ") for line in above if not _SEP.match(line)]
    sep = _SEP.match(above[0]) if above else None
    mark = sep[1] if sep else _delimiter("".join(lines[len(above) : len(above) + 1]))
    form = f"separated by {_DELIMITERS.get(mark, repr(mark))}" if mark != _NONE else "in one column"
    rows, lines_of = _rows(path, lines, len(above), mark, fault)
    comment = next(filter(None, reversed(remarks)), "")
    names, n_head = [], 0
    if rows:
        names = _header(rows[0], next(csv.reader([comment], delimiter=mark), []))
        n_head += not any(map(_is_value, rows[0]))
    units = rows[n_head] if rows[n_head:] and _are_units(rows[n_head]) else []
    n_head += bool(units)
    form = f"{encoding}, {form}"
    table = TextTable(
        path, names, units, rows[n_head:], lines_of[n_head:], " ".join(remarks), form, fault
    )
    for row, cells in enumerate(table.rows):
        if len(cells) > len(names):
            if any(map(str.strip, cells[len(names) :])):
                line = table.lines[row]
                why = f"line {line} has {counted(len(cells), 'cell')}, the first line {len(names)}"
                hint = "Write a cell that contains a separator in quotes, and 0.5 for 0,5."
                raise fault(str(path), why, hint)
            del cells[len(names) :]
    return table


def _header(first: list[str], comment: list[str]) -> list[str]:
    """The names of the columns: the first row, or the `comment` above if that row has values.

    Cells without a name at the end are left out; without a header, names are empty.
    """
    n_columns = max((at for at, cell in enumerate(first, 1) if cell.strip()), default=0)
    if any(map(_is_value, first)):
        first = comment if len(comment) == len(first) else [""] * n_columns
    return [name.strip() for name in first[:n_columns]]


def _lines(path: Path, fault: type[DlgmdError], hint: str) -> tuple[str, list[str]]:
    """The encoding of a file, and its lines; raises `fault` if it is missing or no text."""
    if path.is_dir():
        raise fault(str(path), "is a folder, not a table", "Give a CSV file.")
    try:
        with open_regular(path, "rb") as file:
            data = file.read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise fault(str(path), f"is larger than {MAX_BYTES >> 20} MiB", "Split it.")
        encoding, text = _decoded(data)
    except FileNotFoundError:
        raise fault(str(path), "this file is missing", similar_path(path) or hint) from None
    except (OSError, ValueError) as error:  # ValueError: a NUL in the path, or no text
        reason = getattr(error, "strerror", None) or "not a CSV file"
        raise fault(str(path), f"cannot be read ({reason})", hint or "Save it as CSV.") from None
    return encoding, [*StringIO(text, newline="")]


def _decoded(data: bytes) -> tuple[str, str]:
    """The encoding and the text; raises ValueError if the data are not text."""
    name, codec = "UTF-8", "utf-8"
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        name, codec = "UTF-16", "utf-16"
    try:
        text = data.decode(codec)
    except UnicodeDecodeError:
        name, text = "cp1252", data.decode("cp1252")
    if "\0" in text:
        raise ValueError("no text")
    return name, text.lstrip("\ufeff")


def _delimiter(line: str) -> str:
    """The delimiter of a table by its first line; `_NONE` for a single column."""
    outside_quotes = re.sub('"[^"]*"', "", line)
    return next((mark for mark in _DELIMITERS if mark in outside_quotes), _NONE)


def _rows(
    path: Path, lines: list[str], first: int, mark: str, fault: type[DlgmdError]
) -> tuple[list[list[str]], list[int]]:
    """The rows from line `first` on, without comments, and their lines; raises `fault`.

    Empty rows at the end are left out.
    """
    numbers = [n for n in range(first, len(lines)) if not lines[n].startswith(_COMMENTS)]
    kept = (lines[n] for n in numbers)
    reader = csv.reader(kept, delimiter=mark, strict=True, skipinitialspace=True)
    rows, lines_of = list[list[str]](), list[int]()
    try:
        for cells in reader:
            rows.append(cells)
            lines_of.append(numbers[reader.line_num - 1] + 1)
    except csv.Error as error:
        why = f"the row in line {1 + (lines_of[-1] if rows else first)} cannot be read ({error})"
        raise fault(str(path), why, "Check its quotes.") from None
    while rows and not any(map(str.strip, rows[-1])):
        rows.pop()
    return rows, lines_of


def _is_value(cell: str) -> bool:
    """Whether a cell has a number or a time, so that its row is no header."""
    return number(cell) is not None or clock(cell) is not None


def _are_units(row: list[str]) -> bool:
    """Whether a row has a unit, behind the first of several columns, and no value."""
    is_unit = any(_UNIT.fullmatch(cell.strip()) for cell in row[1:] or row)
    return is_unit and not any(map(_is_value, row))
