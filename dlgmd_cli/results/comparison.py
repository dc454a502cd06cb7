"""compare.csv: what several models said about one input, in long form."""

import csv
from collections.abc import Mapping
from pathlib import Path

from dlgmd_cli.results.cells import cell, text_cell
from dlgmd_cli.results.tables import Result

COMPARISON_COLUMNS = ("label", "frame", "time_s", "mp", "mp_abs", "mp_seq", "attenuation_db")


def write_comparison(path: Path, results: Mapping[str, Result]) -> None:
    """Write every frame of every result, label by label; OSError passes through.

    Parameters
    ----------
    path : Path
        The CSV.
    results : mapping of str to Result
        Label -> what its model said; the label is guarded, see `text_cell`.
    """
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COMPARISON_COLUMNS)
        for label, result in results.items():
            series = [getattr(result, column) for column in COMPARISON_COLUMNS[1:]]
            for row in zip(*series, strict=True):
                writer.writerow([text_cell(label), *(cell(value) for value in row)])
