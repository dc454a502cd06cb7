"""Labels: which videos show a collision, and at which frame."""

import os
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePath

from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.csv import read_rows, write_values

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


# Labels by the path or name of their video.
ByVideo = dict[str, list[Label]]


def write_labels(path: Path, labels: Iterable[Label]) -> None:
    """Write labels as CSV; OSError passes through."""
    write_values(path, COLUMNS, ([getattr(one, name) for name in COLUMNS] for one in labels))


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


def read_by_video(path: Path) -> ByVideo:
    """Read the labels of each video, by its absolute path, and by its name if that is unique.

    Raises ResultError if `path` is not a table of labels.
    """
    found: ByVideo = {}
    for label in read_labels(path):
        found.setdefault(os.path.abspath(path.parent / label.video), []).append(label)
    n_named = Counter(PurePath(where).name for where in found)
    unique = {PurePath(where).name: labels for where, labels in found.items()}
    return {name: unique[name] for name, n in n_named.items() if n == 1} | found


def labels_of(known: ByVideo, input_path: str) -> list[Label] | None:
    """The labels that `read_by_video` found for an input; None if it is not listed."""
    return known.get(input_path, known.get(PurePath(input_path).name))


def collision_frames(labels: Iterable[Label]) -> list[int]:
    """The frames of the collisions."""
    return [one.collision_frame for one in labels if one.collision_frame is not None]


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
