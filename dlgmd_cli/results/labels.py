"""Which videos show a collision, and when: a table that is made or read as a whole."""

import csv
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.csv import text_cell, write_rows

LABELS = "labels.csv"


@dataclass(frozen=True)
class Label:
    """What is known of a video.

    Attributes
    ----------
    video : str
        Its path, relative to the table; a folder of pictures is one, too.
    collision_frame : int or None
        The first frame at or after the collision; None if there is none.
    """

    video: str
    collision_frame: int | None = None


COLUMNS = ("video", "collision_frame")


def write_labels(path: Path, labels: Iterable[Label]) -> None:
    """Write labels as CSV; OSError passes through."""
    rows = (
        [text_cell(one.video), "" if one.collision_frame is None else str(one.collision_frame)]
        for one in labels
    )
    write_rows(path, COLUMNS, rows)


def read_labels(path: Path) -> list[Label]:
    """The labels in a CSV, in its order.

    Raises
    ------
    ResultError
        If it cannot be read, or holds something else.
    """
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.reader(file))
    except (OSError, ValueError, csv.Error) as error:
        reason = getattr(error, "strerror", None) or "not a CSV file"
        raise ResultError(str(path), f"it cannot be read ({reason})") from None
    if not rows or tuple(rows[0]) != COLUMNS:
        raise ResultError(
            str(path), "it holds no labels", f"Its first line should be {','.join(COLUMNS)}."
        )
    return [_label(path, number, row) for number, row in enumerate(rows[1:], start=2) if row]


def _label(path: Path, number: int, row: list[str]) -> Label:
    """What line `number` of a CSV says."""
    if len(row) == len(COLUMNS) and row[0]:
        video, frame = row
        if not frame:
            return Label(video)
        if frame.isascii() and frame.isdigit() and len(frame) <= 9:
            return Label(video, int(frame))
    raise ResultError(
        str(path),
        f"line {number} is not a label",
        "Write a video and the number of a frame, or nothing after the comma.",
    )
