"""Tables of names that the pages read from the code, as Markdown."""

from collections.abc import Iterable
from itertools import groupby
from pathlib import Path
from typing import Any

import yaml

from dlgmd_cli.models.columns import TABLES as PER_FRAME
from dlgmd_cli.models.columns import columns_of
from dlgmd_cli.models.detection import AlarmSpan
from dlgmd_cli.parameters.keys import RULES
from dlgmd_cli.parameters.presets import MODELS, load_preset, preset_names
from dlgmd_cli.results.csv import COLUMNS
from dlgmd_cli.results.files import FILES

ROOT = Path(__file__).parents[1]


def table(header: list[str], rows: list[list[str]]) -> str:
    """A table in Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _shown(value: Any) -> str:
    """A value as YAML has it."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else f"{value:.9g}"


def parameters() -> str:
    """The keys of the D-LGMD, with their defaults."""
    kind = MODELS["dlgmd"]
    rows = [
        [f"`{key}`", spec.symbol, spec.unit, _shown(kind.defaults()[key]), spec.meaning]
        for key, spec in kind.specs().items()
    ]
    return table(["key", "symbol", "unit", "default", "meaning"], rows)


def sets() -> str:
    """The paper's sets: the keys in which they differ, and κ."""
    values = {name: load_preset(name).values for name in preset_names()}
    specs = MODELS["dlgmd"].specs()
    keys = [key for key in specs if len({one.get(key) for one in values.values()}) > 1]
    header = ["set", *(f"`{key}`" for key in keys)]
    return table(header, [[n, *(_shown(one[key]) for key in keys)] for n, one in values.items()])


def _list(rows: Iterable[tuple[str, str, str]]) -> str:
    """Names with notes and a meaning; neighbours that differ by their names alone share a line."""
    lines = []
    for (notes, meaning), same in groupby(rows, key=lambda row: row[1:]):
        names = ", ".join(f"`{name}`" for name, *_ in same)
        lines.append(f"- {names}{notes}: {meaning}")
    return "\n".join(lines)


def files(record: str) -> str:
    """The files of a record, with what they hold: a list."""
    rows = []
    for one in FILES[record]:
        first, *others = one.names(one.formats)
        more = f" (or {', '.join(one.formats[1:])})" if others else ""
        rows.append((first, more, one.meaning))
    return _list(rows)


def columns(of: str) -> str:
    """The columns that the code declares, of a `run` or an `alarm`: a list.

    Beside the unit stand the files, unless a column of a run is in mp.csv alone.
    """
    rows = []
    for one in columns_of(AlarmSpan) if of == "alarm" else COLUMNS:
        files = "all files" if one.tables == PER_FRAME else ", ".join(one.tables)
        is_plain = of == "alarm" or files == "mp.csv"
        notes = [note for note in (one.unit, "" if is_plain else files) if note not in ("–", "")]
        beside = f" ({', '.join(notes)})" if notes else ""
        rows.append((one.name, beside, one.meaning))
    return _list(rows)


def rules() -> str:
    """The rules with a name, and when each raises an alarm: a list."""
    return "\n".join(f"- `{name}`: {rule.words}" for name, rule in RULES.items())


def meaning(group: str) -> str:
    """What the columns of a group mean, with their units, from columns.yaml: a list."""
    path = Path(__file__).with_name("columns.yaml")
    rows = yaml.safe_load(path.read_text(encoding="utf-8"))[group]
    units = {name: "" if unit == "–" else f" ({unit})" for name, (unit, _) in rows.items()}
    return "\n".join(f"- {name}{units[name]}: {text}" for name, (_, text) in rows.items())


def _cited(one: dict[str, Any]) -> str:
    """A publication of CITATION.cff: authors, year and address, or the title if it has none."""
    families = [
        family
        for who in one["authors"]
        for family in (
            # A name is a list such as "Yue, S., and Rind, F. C.".
            who["name"].replace(", and ", ", ").split(", ")[::2]
            if "name" in who
            else [who["family-names"]]
        )
    ]
    names = " and ".join(families) if len(families) < 3 else f"{families[0]} et al."
    address = one.get("url") or one.get("repository-code") or ""
    if "doi" in one:
        address = f"https://doi.org/{one['doi']}"
    year = f" {one['year']}" if "year" in one else ""
    title = f'"{" ".join(one["title"].split())}"'
    link = f"[{address.removeprefix('https://')}]({address})" if address else title
    return f"{names}{year}, {link}"


def references(group: str) -> str:
    """The publications that are `Implemented` or `Inspired`, and where."""
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    paper = {
        **citation["preferred-citation"],
        "notes": "Implemented: D-LGMD, the paper whose tables and figures these pages name.",
    }
    own = [one for one in (paper, *citation["references"]) if one["notes"].startswith(group)]
    notes = [one["notes"].partition(": ")[2].rstrip(".") for one in own]
    return "\n".join(f"- {note}: {_cited(one)}" for note, one in zip(notes, own, strict=True))


TABLES = {
    "parameters": parameters,
    "sets": sets,
    "files": files,
    "columns": columns,
    "rules": rules,
    "meaning": meaning,
    "references": references,
}
