"""Tables of other programs, such as pandas, R and spreadsheets: any delimiter and encoding."""

import codecs
import csv
from io import StringIO
from pathlib import Path
from typing import NamedTuple

from dlgmd_cli.errors import ResultError
from dlgmd_cli.machine.files import open_regular

_DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars"}
_MAX_BYTES = 1 << 26


class ForeignTable(NamedTuple):
    """The cells of a table, with the column names first, and how they were read, in words."""

    header: list[str]
    rows: list[list[str]]  # empty lines are empty rows
    encoding: str
    delimiter: str

    @property
    def is_plain(self) -> bool:
        """Whether it is in UTF-8, with commas."""
        return self.encoding == "UTF-8" and self.delimiter == "commas"

    def __str__(self) -> str:
        return f"{self.encoding}, separated by {self.delimiter}"


def read_table(path: Path) -> ForeignTable:
    """Read a table; the delimiter is the one that the first line has most of.

    The encoding is the one that a byte order mark states, else UTF-8, else cp1252, the one of
    Windows in Western Europe. Raises ResultError if the file cannot be read.
    """
    try:
        with open_regular(path, "rb") as file:
            data = file.read(_MAX_BYTES + 1)
        if len(data) > _MAX_BYTES:
            raise ResultError(str(path), f"is larger than {_MAX_BYTES >> 20} MiB", "Split it.")
        encoding, text = _decoded(data)
        first = text.partition("\n")[0]
        mark = max(_DELIMITERS, key=first.count)
    except FileNotFoundError:
        raise ResultError(str(path), "this file is missing") from None
    except (OSError, ValueError) as error:  # ValueError: no such letters
        reason = getattr(error, "strerror", None) or "not a CSV file"
        raise ResultError(str(path), f"cannot be read ({reason})") from None
    rows: list[list[str]] = []
    reader, read = csv.reader(StringIO(text, newline=""), delimiter=mark, strict=True), 0
    try:
        for row in reader:
            rows.append(row)
            read = reader.line_num
    except csv.Error as error:
        why = f"the row in line {read + 1} cannot be read ({error})"
        raise ResultError(str(path), why, "Check its quotes.") from None
    header, *rows = rows or [[]]
    return ForeignTable([name.strip() for name in header], rows, encoding, _DELIMITERS[mark])


def _decoded(data: bytes) -> tuple[str, str]:
    """The encoding and the text; raises ValueError if it is none."""
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "UTF-16", data.decode("utf-16")
    if b"\0" in data:
        raise ValueError("no text")
    try:
        return "UTF-8", data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return "cp1252", data.decode("cp1252")
