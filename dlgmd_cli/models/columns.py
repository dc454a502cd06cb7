"""Declaration of columns: a number of a frame is a field with its unit, meaning and tables."""

import math
import re
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

# The tables of a result that have one row per frame.
MP, ATTENUATION, SPIKES = TABLES = "mp.csv", "attenuation.csv", "spikes.csv"
# The table with one row per alarm.
ALARMS = "alarms.csv"

KindT = TypeVar("KindT", bound=type)


@dataclass(frozen=True)
class Column:
    """A column: its name, its unit, what it means (Markdown), its type, and the tables with it."""

    name: str
    unit: str
    meaning: str
    tables: tuple[str, ...] = (MP,)
    kind: type = float


def column(
    unit: str, meaning: str, *tables: str, kind: type = float, default: Any = math.nan
) -> Any:
    """A field of a dataclass that is a column of some tables, of mp.csv unless others are given."""
    declared = {"unit": unit, "meaning": meaning, "tables": tables or (MP,), "kind": kind}
    return field(default=default, metadata=declared)


def columns_of(kind: type) -> tuple[Column, ...]:
    """The columns that a dataclass declares, with those of its bases, in their order."""
    return tuple(Column(one.name, **one.metadata) for one in fields(kind) if one.metadata)


def described(kind: KindT) -> KindT:
    """Append the columns that a dataclass itself declares to its docstring, as attributes."""
    own = [one for one in columns_of(kind) if one.name in vars(kind)["__annotations__"]]
    lines = []
    for one in own:
        unit = "" if one.unit == "–" else f", {one.unit}"
        meaning = re.sub(r"\[(.*?)\]\(.*?\)", r"\1", one.meaning)
        meaning = f"{meaning[0].upper()}{meaning[1:]}."
        lines += [f"    {one.name} : {one.kind.__name__}{unit}", f"        {meaning}"]
    title = "\n\n    Attributes\n    ----------\n"
    head, _, others = (kind.__doc__ or "").partition(title)
    kind.__doc__ = f"{head.rstrip()}{title}" + "\n".join(lines) + f"\n{others or '    '}"
    return kind
