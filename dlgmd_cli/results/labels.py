"""Labels of videos: their collisions, by frame; and finding the stored results of videos."""

import logging
import os
import re
from collections import Counter
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from math import isnan
from pathlib import Path, PurePath

import numpy as np

from dlgmd_cli.errors import ParameterError, ResultError, SourceError, argument, warn
from dlgmd_cli.frame import Flags
from dlgmd_cli.machine.tables import EMPTY, PLAIN, TextTable, listed, read_table
from dlgmd_cli.models.stopping import Brake
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.parameters.facts import InputFacts
from dlgmd_cli.parameters.presets import ANGLES
from dlgmd_cli.results.csv import write_values
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.store import RUN, is_url, records_below
from dlgmd_cli.video.opening import Openable, content_sha256, fingerprint

_log = logging.getLogger(__name__)

LABELS, TRUTH, HEADINGS = "labels.csv", "truth", "headings"
# The required columns; the columns of words, and those that are parsed, which may be empty.
_NEEDED, WORDS = ("video", "collision_frame"), ("target", "kind", "manner")
_NUMBERS = {**ANGLES, "speed_m_s": Spec(float, 0, 1000, low_open=True)}
_FRAMES = ("collision_frame", "approach_start")
_COLUMNS = ("video", *_FRAMES, *_NUMBERS, "brake", *WORDS)
# The columns of a truth that are read. The true rate (1/s), closing speed over distance, at or
# above which an alarm is justified.
_TRUTH, NEAR_1_S, _ROUNDING = ("frame", "distance_m", "closing_m_s"), 0.45, 1e-9
# Programs whose integer columns cannot be empty write 32.0 or 32,0. Three digits after
# a separator may be a group of thousands.
_FRAME = re.compile(r"([0-9]{1,9})(?:[.,]0{0,2})?")
_FRAME_HINT = "Write a video and the number of a frame, or nothing after the comma."
_MEND = "Run 'dlgmd batch' again."


@dataclass(frozen=True)
class Label:
    """The label of a video; a video with several collisions has one label for each.

    Attributes
    ----------
    video : str
        The path of the video or folder of images, relative to the table.
    collision_frame : int or None
        The first frame at or after the collision; None if there is no collision.
    target, kind, manner : str
        The object that is hit or approached; the kind of footage, such as `rendered` or `real`; the
        scenario. Empty if unknown.
    further : tuple of (str, str)
        The names and cells of the other columns.
    fov, camera_tilt : float or None
        Angles of the camera in degrees; None if unknown.
    speed_m_s : float or None
        The speed at the collision, in m/s; None if unknown.
    approach_start : int or None
        The frame at which the approach begins; None if unknown.
    brake : str
        Who brakes, as `Brake.parse` reads it; empty if unknown.
    """

    video: str
    collision_frame: int | None = None
    target: str = ""
    kind: str = ""
    manner: str = ""
    further: tuple[tuple[str, str], ...] = ()
    fov: float | None = None
    camera_tilt: float | None = None
    speed_m_s: float | None = None
    approach_start: int | None = None
    brake: str = ""


# The columns that group videos. Two further groups: all collisions, and all but those with a wall.
GROUPED = WORDS
ALL, WITHOUT_WALLS, WALL = "all", "all without walls", "wall"
# The grouping column, and the group's name.
VideoGroup = tuple[str, str]
# Path or name of a video -> labels.
ByVideo = dict[str, list[Label]]


def write_labels(path: Path, labels: Iterable[Label]) -> None:
    """Write labels as CSV, without optional columns that no label has; OSError passes through."""
    every = [*labels]
    plain = (*_NEEDED, *WORDS)
    columns = [c for c in _COLUMNS if c in plain or {getattr(x, c) for x in every} - {None, ""}]
    write_values(path, columns, ([getattr(label, name) for name in columns] for label in every))


def read_labels(path: Path) -> list[Label]:
    """Read the labels from a table, in the table's order; log the format of an unusual table.

    Raises ResultError if the file cannot be read, or is not a table of labels.
    """
    table = read_table(path, ResultError)
    table.require(*_NEEDED, what="labels")
    known = {table.place(name) for name in _COLUMNS}
    further = {at: name for at, name in enumerate(table.names) if name and at not in known}
    if further or table.form != PLAIN:
        kept = f"; further columns: {listed([*further.values()])}" if further else ""
        _log.info("Note: %s: read as %s%s.", path, table.form, kept)
    columns = {name: table.texts(name) for name in _COLUMNS}
    numbers = {name: table.numbers(name) for name in _NUMBERS}
    labels = []
    for row, cells in enumerate(table.rows):
        if any(map(str.strip, cells)):
            known_cells = {name: column[row] for name, column in columns.items()}
            label = _label(table, row, known_cells, {key: numbers[key][row] for key in numbers})
            more = ((name, "".join(cells[at : at + 1]).strip()) for at, name in further.items())
            labels.append(replace(label, further=tuple(more)))
    return labels


def by_path(path: Path) -> ByVideo:
    """Absolute path of a video, links resolved -> labels, in the table's order.

    Raises ResultError if `path` is not a table of labels, or if labels contradict each other.
    """
    by_video: ByVideo = {}
    for label in read_labels(path):
        where = label.video if is_url(label.video) else str(path.parent / label.video)
        by_video.setdefault(real_path(where), []).append(label)
    for labels in by_video.values():
        _require_agreement(path, labels)
    return by_video


def _require_agreement(path: Path, labels: list[Label]) -> None:
    """Raise ResultError if the labels of one video contradict each other."""
    video, frames = labels[0].video, [label.collision_frame for label in labels]
    for frame in frames:
        if frames.count(frame) > 1:
            what = "no frame" if frame is None else f"frame {frame}"
            raise ResultError(str(path), f"{video} is listed twice with {what}", "Remove one line.")
    if len({(label.fov, label.camera_tilt) for label in labels}) > 1:
        why = f"{video} has several values of {' or '.join(ANGLES)}"
        raise ResultError(str(path), why, "Give one camera for a video.")
    if None in frames and len(frames) > 1:
        why = f"{video} is listed with a collision and without one"
        raise ResultError(str(path), why, "Remove one of the lines.")


def read_by_video(path: Path) -> ByVideo:
    """Absolute path of a video, and also its name if the name is unique -> labels.

    Raises ResultError as `by_path` does.
    """
    by_where = by_path(path)
    named = {(PurePath(label.video).name, where) for where in by_where for label in by_where[where]}
    n_named = Counter(name for name, _ in named)
    return {name: by_where[where] for name, where in named if n_named[name] == 1} | by_where


def labels_of(known: ByVideo, input_path: str) -> list[Label] | None:
    """The labels that `read_by_video` found for an input; None if the input is not listed."""
    return known.get(real_path(input_path), known.get(PurePath(input_path).name))


def first_collision(
    video: Openable, frame: int | None, table: str | os.PathLike[str] | None
) -> int | None:
    """The frame of a video's first collision, as given or from a table of labels.

    None if there is no collision; warns if the video is not listed. Raises ResultError as `by_path`
    does, and ParameterError if both are given, or a table for a video that is not a path.
    """
    if table is None:
        return frame
    if frame is not None or not isinstance(video, str | os.PathLike):
        why = f"{argument('collisions')} is for a path, and excludes {argument('collision_frame')}"
        raise ParameterError("", why, "Leave one of them out.")
    listed = labels_of(read_by_video(Path(table)), os.path.abspath(video))
    if listed is None:
        warn(f"{table} does not list {video}")
    return min(collision_frames(listed or ()), default=None)


def collision_frames(labels: Iterable[Label]) -> list[int]:
    """The frames of the collisions."""
    return [label.collision_frame for label in labels if label.collision_frame is not None]


def tell_outside(label: str, frames: Sequence[int], collisions: Iterable[int]) -> None:
    """Warn of collisions outside the frames of the result called `label`."""
    first, last = int(frames[0]), int(frames[-1])
    for frame in collisions:
        if not first <= frame <= last:
            warn(f"{label}: the collision at frame {frame} is outside frames {first} to {last}")


def _label(
    table: TextTable, row: int, cells: Mapping[str, str], numbers: Mapping[str, float]
) -> Label:
    """The label in a row of a table, without further columns; raises ResultError."""
    if not cells["video"] or len(table.rows[row]) <= (table.place("collision_frame") or 0):
        raise table.at(row, "", "this is not a label", _FRAME_HINT)
    collision, start = (_frame(table, row, name, cells[name]) for name in _FRAMES)
    if collision is not None and start is not None and start > collision:
        why = "the approach starts after the collision"
        raise table.at(row, "approach_start", why, "Correct one of them.")
    measured: list[float | None] = []
    for name, spec in _NUMBERS.items():
        try:
            measured.append(None if isnan(numbers[name]) else spec.check(float(numbers[name])))
        except ParameterError as error:
            raise table.at(row, name, error.why, error.hint) from None
    (target, kind, manner), (fov, tilt, speed) = (cells[name] for name in WORDS), measured
    brake = _brake(table, row, cells["brake"])
    known = fov, tilt, speed, start, brake
    return Label(cells["video"], collision, target, kind, manner, (), *known)


def _brake(table: TextTable, row: int, cell: str) -> str:
    """The cell that says who brakes; raises ResultError if `Brake.parse` does not know it."""
    try:
        # Numbers of a table may have a decimal comma.
        return cell and Brake.parse(cell.replace(",", ".")).text
    except ParameterError as error:
        raise table.at(row, "brake", error.why, error.hint) from None


def _frame(table: TextTable, row: int, name: str, cell: str) -> int | None:
    """The number of a frame in a cell, None if it is empty; raises ResultError."""
    if whole := _FRAME.fullmatch(cell):
        return int(whole[1])
    if cell.lower() in EMPTY:
        return None
    raise table.at(row, name, f"{cell[:40]!r} is not a frame", _FRAME_HINT)


@dataclass(frozen=True)
class Case:
    """A labelled video.

    Attributes
    ----------
    name, path : str
        The video's name in the labels, and its path.
    labels : tuple of Label
        The labels of the video's collisions in order, or a single label without a collision.
    near : tuple of int
        The frames whose true rate of growth is `NEAR_1_S` or more; empty if there is no truth.
    truth : TextTable, optional
        The table of the truth.
    heading : str, optional
        The path of the table of the drone's motion; None if there is none.
    """

    name: str
    path: str
    labels: tuple[Label, ...]
    near: tuple[int, ...] = ()
    truth: TextTable | None = None
    heading: str | None = None

    @property
    def collisions(self) -> tuple[int, ...]:
        """The frames of the collisions, increasing; empty if there is no collision."""
        return tuple(collision_frames(self.labels))

    @property
    def targets(self) -> set[str]:
        """The targets in the labels."""
        return {label.target for label in self.labels}

    def of_target(self, wanted: Collection[str]) -> Flags:
        """Which collisions are with one of the `wanted` targets."""
        targets = [label.target for label in self.labels[: len(self.collisions)]]
        return np.array([target in wanted for target in targets], np.bool_)


def read_cases(path: Path) -> list[Case]:
    """The videos that labels list, in their order; raises ResultError."""
    by_video = by_path(path)
    if not by_video:
        raise ResultError(str(path), "lists no video", "Add a line for each, as flight.mp4,120.")
    cases = []
    for where, labels in by_video.items():
        name = labels[0].video
        place = where if is_url(where) else str(path.parent / name)
        ordered = sorted(labels, key=lambda label: label.collision_frame or 0)
        truth = path.parent / TRUTH / f"{PurePath(name).stem}.csv"
        near, table = near_frames(truth) if truth.is_file() else ((), None)
        heading = path.parent / HEADINGS / truth.name
        known = str(heading) if heading.is_file() else None
        cases.append(Case(name, place, tuple(ordered), near, table, known))
    return cases


def near_frames(path: Path) -> tuple[tuple[int, ...], TextTable]:
    """The frames of a truth with a rate (closing speed over distance) of `NEAR_1_S` or more.

    Also returns the table. Raises ResultError if the file lacks one of the columns
    frame, distance_m and closing_m_s.
    """
    table = read_table(path, ResultError)
    table.require(*_TRUTH, what="the truth of a video")
    frame, distance, closing = map(table.numbers, _TRUTH)
    for row in np.flatnonzero(~((frame >= 0.0) & (frame < 2**53))):
        raise table.at(int(row), "frame", "is no number of a frame", "Count from 0.")
    is_near = (closing > 0.0) & (closing >= NEAR_1_S * distance - _ROUNDING)
    return tuple(map(int, frame[is_near])), table


def groups(cases: Sequence[Case]) -> dict[VideoGroup, dict[int, Flags]]:
    """Group -> numbers of the group's videos -> flags of the collisions in the group.

    A group is a grouping column and a name: `all` first, then the groups of targets, kinds and
    manners. A kind or manner that all videos have is no group.
    """
    every = set().union(*(case.targets for case in cases))
    targets = {ALL: every}
    if WALL in every and every - {WALL, ""}:
        targets[WITHOUT_WALLS] = every - {WALL}
    targets |= {target: {target} for target in sorted(every - {""})}
    members = {
        ("target", name): {
            i: case.of_target(chosen) for i, case in enumerate(cases) if chosen & case.targets
        }
        for name, chosen in targets.items()
    }
    for word in ("kind", "manner"):
        names = [getattr(case.labels[0], word) for case in cases]
        for group in sorted({*names} - {""}) if len({*names}) > 1 else ():
            members[word, group] = {
                i: np.ones(len(case.collisions), np.bool_)
                for i, (case, name) in enumerate(zip(cases, names, strict=True))
                if name == group
            }
    return members


class StoredResults:
    """The results in a folder and its subfolders, found by their videos.

    Parameters
    ----------
    place : Path
        The folder of a batch.
    """

    def __init__(self, place: Path) -> None:
        self._place = place
        records = records_below(place, RUN)
        inputs = {path.parent: read_record(path).get("input", {}) for path in records}
        # Folder of a result -> its input, from the record.
        self._inputs = {folder: facts for folder, facts in inputs.items() if facts.get("path")}
        self._by_path = {real_path(facts["path"]): folder for folder, facts in self._inputs.items()}
        hashed = ((f.get("content_sha256"), folder) for folder, f in self._inputs.items())
        self._by_content = {digest: folder for digest, folder in hashed if digest}

    def folder_of(self, video: str, name: str) -> Path:
        """The folder of a video's result; errors call the video `name`.

        The folder's record has the video's path. If the video was moved or copied, the record has
        the SHA-256 of its content.

        Raises ResultError if there is no folder, or if the video was replaced.
        """
        folder = self._by_path.get(real_path(video))
        if folder is None:
            with suppress(SourceError):
                folder = self._by_content.get(content_sha256(video))
            if folder is None:
                why = f"there is no result of {name}, neither by its path nor by its content"
                raise ResultError(str(self._place), why, _MEND)
            return folder
        known, now = self._inputs[folder], _identity(video)
        if any(known.get(key) != value for key, value in now.items()):
            is_as_big = "bytes" in now and known.get("bytes") == now["bytes"]
            change = "was changed later" if is_as_big else "has another size"
            why = f"{name} is not the video of its result: it {change}"
            raise ResultError(str(folder), why, _MEND)
        return folder


def real_path(path: str) -> str:
    """A path with links and ``..`` resolved; a URL unchanged."""
    try:
        return path if is_url(path) else os.path.realpath(path)
    except (OSError, ValueError):  # ValueError: a NUL in the name
        return path


def _identity(video: str) -> InputFacts:
    """The `fingerprint` of a file or of images; empty if the file is gone, or for a URL."""
    try:
        return {} if is_url(video) else fingerprint(video)
    except (OSError, ValueError, SourceError):
        return {}
