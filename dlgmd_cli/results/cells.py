"""Cells of every CSV: numbers as they are, and text from outside that does nothing there.

A spreadsheet takes a cell that begins with ``=``, ``+``, ``-`` or ``@`` as a formula, and a formula
can start programs and send data away. Numbers are not touched: -12.3 stays -12.3.
"""

import math
import re
from typing import Any

from dlgmd_cli.errors import printable

# Some spreadsheets take wide and small forms, and the minus of mathematics, for the plain ones.
STARTS_FORMULA = "=+-@＝＋－＠﹦﹢﹣﹫−"
# What a spreadsheet may drop before it looks at the first letter.
_DROPPED = r"[\s\"']*"
_AT_START = re.compile(f"(?={_DROPPED}[{re.escape(STARTS_FORMULA)}])")
_BEHIND_SEPARATOR = re.compile(f"(;{_DROPPED})([{re.escape(STARTS_FORMULA)}])")


def cell(value: Any) -> str:
    """A number as it stands in a CSV: reads back exactly as float32, empty where undefined."""
    number = float(value)
    return "" if math.isnan(number) else f"{number:.9g}"


def text_cell(text: str) -> str:
    """Text that others wrote, such as a file's name, as it stands in a CSV, for a csv.writer.

    Parameters
    ----------
    text : str
        Anything.

    Returns
    -------
    str
        On one line, with what a terminal would act on shown as an escape. What would start a
        formula has ``./`` in front, so that a path still leads to the same file. Where a formula
        would start for programs that split at semicolons, whatever is quoted, its first letter is
        an escape. Applied twice, it changes nothing more.
    """
    line = _BEHIND_SEPARATOR.sub(lambda found: found[1] + _escaped(found[2]), printable(text))
    return f"./{line}" if _AT_START.match(line) else line


def _escaped(letter: str) -> str:
    """`letter` as Python writes it in ASCII."""
    return f"\\x{ord(letter):02x}" if ord(letter) < 0x100 else f"\\u{ord(letter):04x}"
