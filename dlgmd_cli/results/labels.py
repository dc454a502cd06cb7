"""Labels: which videos show a collision, and at which frame."""

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath

from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.csv import read_rows, text_cell, write_rows

LABELS = "labels.csv"
COLUMNS = ("video", "collision_frame", "target", "kind", "manner")
# The columns that are required, and those of words, which may be missing or empty.
_NEEDED, WORDS = COLUMNS[:2], COLUMNS[2:]


@dataclass(frozen=True)
class Label:
    """The label of a video; a video with several collisions has one label for each.

    `video` is the path of the video or folder of pictures, relative to the table.
    `collision_frame` is the first frame at or after the collision; None if there is none. `target`
    is the object that is hit or approached, `kind` the kind of footage, such as `rendered` or
    `real`, and `manner` how it was flown; empty if unknown.
    """

    video: str
    collision_frame: int | None = None
    target: str = ""
    kind: str = ""
    manner: str = ""


def write_labels(path: Path, labels: Iterable[Label]) -> None:
    """Write labels as CSV; OSError passes through."""
    rows = (
        [
            text_cell(one.video),
            "" if one.collision_frame is None else str(one.collision_frame),
            *(text_cell(getattr(one, word)) for word in WORDS),
        ]
        for one in labels
    )
    write_rows(path, COLUMNS, rows)


def read_labels(path: Path) -> list[Label]:
    """Read the labels from a CSV, in its order; further columns are ignored.

    Raises ResultError if the file cannot be read, or is not a table of labels.
    """
    rows = read_rows(path)
    header = [name.strip() for name in rows[0]] if rows else []
    if not set(_NEEDED) <= set(header):
        mend = f"Its first line should be {','.join(_NEEDED)}."
        raise ResultError(str(path), "contains no labels", mend)
    return [
        _label(path, number, dict(zip(header, row, strict=False)))
        for number, row in enumerate(rows[1:], start=2)
        if row
    ]


def read_collisions(path: Path) -> dict[str, list[int]]:
    """Read the collision frames in a table of labels, by the video's absolute path.

    They can also be found by the name of the file, if it is unique, see `labelled_frames`. Raises
    ResultError if `path` is not a table of labels.
    """
    found: dict[str, list[int]] = {}
    by_name: dict[str, set[str]] = {}
    for label in read_labels(path):
        where = os.path.abspath(path.parent / label.video)
        by_name.setdefault(PurePath(where).name, set()).add(where)
        frames = found.setdefault(where, [])
        if label.collision_frame is not None:
            frames.append(label.collision_frame)
    unique = {name: found[where] for name, (where, *more) in by_name.items() if not more}
    return unique | found


def labelled_frames(collisions: dict[str, list[int]], input_path: str) -> list[int] | None:
    """The frames that `read_collisions` found for an input; None if it is not listed."""
    return collisions.get(input_path, collisions.get(PurePath(input_path).name))


def _label(path: Path, number: int, row: dict[str, str]) -> Label:
    video, frame = row.get("video", ""), row.get("collision_frame")
    if video and frame is not None:
        words = (row.get(word, "").strip() for word in WORDS)
        if not frame:
            return Label(video, None, *words)
        if frame.isascii() and frame.isdigit() and len(frame) <= 9:
            return Label(video, int(frame), *words)
    why = f"line {number} is not a label"
    mend = "Write a video and the number of a frame, or nothing after the comma."
    raise ResultError(str(path), why, mend)
