"""The one reader of tables: labels, truths, times, headings and results, from any program."""

import codecs
import csv
import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import date
from decimal import Decimal, InvalidOperation
from io import StringIO
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, counted, printable
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import similar_path

MAX_BYTES = 1 << 26
# If a line has equally many of two delimiters, the first of them separates the cells.
_DELIMITERS = {"\t": "tabs", ";": "semicolons", "|": "bars", ",": "commas"}
# A character that no text has: the delimiter of a table with a single column.
_NONE = "\x1f"
PLAIN = "UTF-8, separated by commas"
_MOST_NAMED = 12
# Excel's first line, which names the delimiter. A comment before the header, and below it, where
# the name of a video may begin with #.
_SEP = re.compile(r'"?sep=(.)"?[,;\t]*\s*', re.I)
_COMMENT, _COMMENT_BELOW = re.compile(r"\s*[#%]"), re.compile(r"\s*[#%](\s|$)")
EMPTY = frozenset(("", "-", "–", "--", "na", "n/a", "nan", "none", "null"))
# Cells of a row of units: a unit, brackets, or a word for a column without one.
_UNIT = re.compile(
    r"(?i)[\[(].*[\])]|[nuµμm]?s|sec|seconds|min|h|[km]?m|cm|(m|km)/[sh]|deg|°|degrees|rad|px|1/s|hz"
    r"|frames?|#|-|–|text|string|path|file|name|n/?a|none|no\.?"
)
# 1,234,567.8 or 1.234.567,8; a single group could also be three decimals.
_GROUPED = re.compile(r"[+-]?[1-9]\d{0,2}([.,])\d{3}(?:\1\d{3})*(?:(?!\1)[.,]\d*)?")
_ONE_GROUP = re.compile(r"[+-]?[1-9]\d{0,2},\d{3}")
_DATE = re.compile(r"(\d{4})[-/](\d\d?)[-/](\d\d?)[T ]\s*")
_CLOCK = re.compile(
    r"(?:(?P<days>\d+) days?,? )?(?:(?P<h>\d+):)?(?P<m>\d+):(?P<s>[0-5]\d(?:[.,]\d+)?)"
    r"\s*(?:Z|UTC|(?P<sign>[+-])(?P<zone_h>\d\d):?(?P<zone_m>\d\d))?",
    re.I,
)


def plain(name: str) -> str:
    """The name of a column in lower case and underscores: ``Speed [m/s]`` -> ``speed_m_s``."""
    parted = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    return re.sub(r"[^a-z0-9µμ]+", "_", parted.lower()).strip("_")


def number(text: str) -> Decimal | None:
    """The number in a cell, also ``0,5``, ``1.234,5`` and ``1 234``; None if it is no number."""
    text = re.sub(r"(?<=\d)[\s'](?=\d{3}(?!\d))", "", text.strip().replace("−", "-"))
    groups = _GROUPED.fullmatch(text)
    if groups and (text.count(groups[1]) > 1 or {".", ","} <= {*text}):
        text = text.replace(groups[1], "")
    try:
        found = Decimal(text.replace(",", "."))
    except InvalidOperation:
        return None
    return found if found.is_finite() else None


def clock(text: str) -> Decimal | None:
    """The seconds of ``hh:mm:ss``, ``mm:ss``, or of a date and a time since 1970; None otherwise.

    Fractions may follow the seconds, and ``Z`` or ``+02:00`` the time. A date without a zone is
    taken as UTC.
    """
    text = text.strip()
    day = _DATE.match(text)
    match = _CLOCK.fullmatch(text[day.end() :] if day else text)
    if match is None:
        return None
    hours, minutes, seconds = match["h"], match["m"], match["s"].replace(",", ".")
    if day and hours is None:  # 2026-05-01 12:30
        hours, minutes, seconds = minutes, seconds, "0"
    n_days = int(match["days"] or 0)
    try:
        n_days += (date(*map(int, day.groups())) - date(1970, 1, 1)).days if day else 0
    except ValueError:
        return None
    zone = 60 * int(match["zone_h"] or 0) + int(match["zone_m"] or 0)
    n_minutes = (24 * n_days + int(hours or 0)) * 60 + int(minutes)
    return 60 * Decimal(n_minutes + (zone if match["sign"] == "-" else -zone)) + Decimal(seconds)


def listed(names: Sequence[str]) -> str:
    """Names of columns, in words."""
    return printable(", ".join(names[:_MOST_NAMED]) + (", …" if names[_MOST_NAMED:] else ""))


class Row(NamedTuple):
    """A row: its line in the file, and its cells, which may be fewer than the columns."""

    line: int
    cells: list[str]


@dataclass(frozen=True)
class TextTable:
    """A table as it was read.

    Attributes
    ----------
    path : Path
        The file.
    names, units : list of str
        The header, empty where there is none, and the cells of a row of units below.
    rows : list of Row
        The rows; an empty row has no cells.
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
    rows: list[Row]
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
        return [cells[at] if at < len(cells) else "" for _, cells in self.rows]

    def numbers(self, name: str, *, clocks: bool = False) -> npt.NDArray[np.float64]:
        """The numbers of a column, (n,), NaN for empty cells, see `decimals`."""
        try:
            return np.array([float(cell or "nan") for cell in self._cells(name)])
        except ValueError:
            read = self.decimals(name, clocks=clocks)
        return np.array([math.nan if one is None else float(one) for one in read])

    def decimals(self, name: str, *, clocks: bool = False) -> list[Decimal | None]:
        """The exact numbers of a column; with `clocks`, of times as `clock` reads them, in s.

        None for empty cells. Raises an error for another text, and for ``1,234`` in a table with
        commas where no other cell of the column has a decimal comma.
        """
        cells, read = self.texts(name), list[Decimal | None]()
        is_decimal = any("," in cell and not _GROUPED.fullmatch(cell) for cell in cells)
        is_open = not is_decimal and "commas" in self.form
        for row, cell in enumerate(cells):
            if cell.lower() in EMPTY:
                read.append(None)
                continue
            found = number(cell)
            if found is None and clocks:
                found = clock(cell)
            if found is None:
                times = ", or a time as 00:01:12.5" if clocks else ""
                raise self.at(row, name, f"{cell[:40]!r} is no number", f"Write 12.5{times}.")
            if is_open and _ONE_GROUP.fullmatch(cell):
                raise self.at(row, name, *thousands(cell))
            read.append(found)
        return read

    def at(self, row: int, name: str, why: str, hint: str = "") -> DlgmdError:
        """The error about a cell, or about a row if `name` is empty."""
        where = f"line {self.rows[row].line}" + (f", column {name}" if name else "")
        return self.fault(str(self.path), f"{where}: {printable(why)}", hint)


def thousands(cell: str) -> tuple[str, str]:
    """Why ``1,234`` may be read in two ways, and what to write."""
    whole, part = re.split("[.,]", cell)
    small = f"{whole}.{part}".rstrip("0").rstrip(".")
    return f"{cell!r} may be a thousand times {small}", f"Write {whole}{part} or {small}."


def read_table(
    path: Path, fault: type[DlgmdError], hint: str = "", *, limited: bool = True
) -> TextTable:
    """Read a table of any program, such as a spreadsheet, pandas, R, or a camera.

    The encoding is that of the byte order mark, else UTF-8, UTF-16 or cp1252. Cells are separated
    by commas, semicolons, tabs or bars, whichever the first line has most of; ``sep=;`` may stand
    before it. Lines that begin with ``#`` are comments. If the first row has numbers, the header is
    the comment before it, if that has as many cells.

    Raises the error `fault` if the file cannot be read as a table, with `hint` if it is missing or
    no text, and if it is larger than 64 MiB, unless it is not `limited`.
    """
    encoding, lines = _lines(path, fault, hint, limited=limited)
    sep, first, remarks = _SEP.fullmatch(lines[0] if lines else ""), 0, [""]
    if sep:
        lines[0] = ""
    while first < len(lines) and (not lines[first].strip() or _COMMENT.match(lines[first])):
        remarks.append(lines[first].strip().lstrip("#% "))
        first += 1
    start = "".join(lines[first : first + 1])
    head = next(filter(None, reversed(remarks)), "")
    mark = sep[1] if sep else _delimiter(head if head and start[:1].isdigit() else start)
    form = f"separated by {_DELIMITERS.get(mark, repr(mark))}" if mark != _NONE else "in one column"
    rows = [*_rows(path, lines, first, mark, fault)]
    while rows and not any(map(str.strip, rows[-1].cells)):
        rows.pop()
    names = _header(rows, next(csv.reader([head], delimiter=mark, skipinitialspace=True), []))
    units = rows.pop(0).cells if rows and _are_units(rows[0].cells) else []
    for line, cells in rows:
        if any(map(str.strip, cells[len(names) :])):
            why = f"line {line} has {counted(len(cells), 'cell')}, the first line {len(names)}"
            hint = "Write a cell that contains a separator in quotes, and 0.5 for 0,5."
            raise fault(str(path), why, hint)
        del cells[len(names) :]
    return TextTable(path, names, units, rows, " ".join(remarks), f"{encoding}, {form}", fault)


def _header(rows: list[Row], comment: list[str]) -> list[str]:
    """The names of the columns, taken from the rows; those in the `comment` if rows begin at once.

    Without a header, names are empty. Cells without a name at the end of a header are left out.
    """
    names = rows[0].cells if rows else []
    if any(_is_value(cell) for cell in names):
        names = comment if len(comment) == len(names) else [""] * len(names)
    elif rows:
        del rows[0]
    n_named = max((at for at, name in enumerate(names, 1) if name.strip()), default=len(names))
    return [name.strip() for name in names[:n_named]]


def _lines(
    path: Path, fault: type[DlgmdError], hint: str, *, limited: bool
) -> tuple[str, list[str]]:
    """The encoding of a file, and its lines; raises `fault` if it is missing or no text."""
    if path.is_dir():
        raise fault(str(path), "is a folder, not a table", "Give a CSV file.")
    try:
        with open_regular(path, "rb") as file:
            data = file.read(MAX_BYTES + 1 if limited else -1)
        if limited and len(data) > MAX_BYTES:
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
    elif data[:2].count(0) == 1:  # without a byte order mark, before a Latin letter
        name, codec = "UTF-16", "utf-16-le" if data[0] else "utf-16-be"
    try:
        text = data.decode(codec)
    except UnicodeDecodeError:
        name, text = "cp1252", data.decode("cp1252")
    if "\0" in text:
        raise ValueError("no text")
    return name, text.lstrip("\ufeff")


def _delimiter(line: str) -> str:
    """The most frequent delimiter outside quotes; a comma between digits counts if it is alone."""
    outside = re.sub('"[^"]*"', "", line)
    if any(mark in outside for mark in "\t;|"):
        outside = re.sub(r"(?<=\d),(?=\d)", "", outside)
    mark = max(_DELIMITERS, key=outside.count)
    return mark if mark in outside else _NONE


def _rows(
    path: Path, lines: list[str], first: int, mark: str, fault: type[DlgmdError]
) -> Iterator[Row]:
    """The rows from line `first` on, without comments; raises `fault`."""
    comments = {at for at, line in enumerate(lines) if at > first and _COMMENT_BELOW.match(line)}
    kept = ("\n" if at in comments else lines[at] for at in range(first, len(lines)))
    reader, at = csv.reader(kept, delimiter=mark, strict=True, skipinitialspace=True), first
    try:
        for cells in reader:
            if at not in comments:
                yield Row(at + 1, cells)
            at = first + reader.line_num
    except csv.Error as error:
        why = f"the row in line {at + 1} cannot be read ({error})"
        raise fault(str(path), why, "Check its quotes.") from None


def _is_value(cell: str) -> bool:
    """Whether a cell has a number or a time, so that its row is no header."""
    return any(map(str.isdigit, cell)) and (number(cell) is not None or clock(cell) is not None)


def _are_units(row: list[str]) -> bool:
    """Whether a row has units alone, more than the first one of several columns."""
    filled = [at for at, cell in enumerate(row) if cell.strip()]
    is_enough = len(filled) > 1 or filled[:1] > [0] or (bool(filled) and len(row) == 1)
    return is_enough and all(_UNIT.fullmatch(row[at].strip()) for at in filled)
