"""What the tables of `dlgmd lab measure` share: Markdown, the real clips, the scores of models."""

import csv
import os
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from functools import cache
from pathlib import Path

import dlgmd_cli
from dlgmd_cli.errors import ParameterError

# A row of a table that `evaluate` or `lab paper` wrote, by column.
Row = dict[str, str]


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    head, *lines = ("| " + " | ".join(cells) + " |" for cells in (header, *rows))
    return "\n".join((head, "|" + "---|" * len(header), *lines))


def number(text: str, digits: int = 2) -> str:
    """A number of a table; a dash where there is none."""
    return f"{float(text):.{digits}f}" if text else "–"


def reference(name: str) -> Path:
    """The labels of a folder of real clips; raises ParameterError if its place is not known."""
    folder = os.environ.get("DLGMD_REFERENCE")
    if folder is None:
        raise ParameterError("DLGMD_REFERENCE", "not set", "Set it to the folder of the clips.")
    return Path(folder) / name / "labels.csv"


@cache
def evaluated(labels: Path, *models: str | int, baselines: bool = False) -> list[Row]:
    """The rows of the evaluate.csv that `evaluate` writes."""
    with tempfile.TemporaryDirectory() as folder:
        dlgmd_cli.evaluate(labels, [*models], baselines=baselines, out=folder)
        return [*rows_of(Path(folder, "evaluate.csv"))]


def rows_of(path: Path) -> Iterator[Row]:
    """The rows of a CSV file."""
    with path.open(encoding="utf-8", newline="") as file:
        yield from csv.DictReader(file)


def of_all(labels: Path, *models: str | int) -> list[Row]:
    """The scores of each model on all videos, at its own threshold."""
    grouped = ("target", "kind", "manner")
    return [
        row
        for row in evaluated(labels, *models)
        if row["at"] == "default" and all(row[key] == "all" for key in grouped)
    ]
