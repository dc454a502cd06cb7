"""Gather the content of pages: results grouped by input, and labelled collisions."""

import hashlib
import os
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path, PurePath
from typing import Any

import numpy as np

from dlgmd_cli.errors import ResultError
from dlgmd_cli.machine.pool import DONE
from dlgmd_cli.machine.tables import read_table
from dlgmd_cli.models.detection import ROUNDING_S
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import ByVideo, Label, collision_frames, labels_of
from dlgmd_cli.results.names import distinct_names, numbered
from dlgmd_cli.results.reading import read_comparison, read_result, readable
from dlgmd_cli.results.result import Result
from dlgmd_cli.video.base import picture_folder


@dataclass(frozen=True)
class LabelledResult:
    """A result, its folder and label; `peers` are all results of the same run, this one included.

    `below` is the folder relative to the batch's folder.
    """

    folder: Path
    label: str
    result: Result
    peers: tuple[Result, ...]
    below: Path = Path()


@dataclass(frozen=True)
class Input:
    """An input with all of its results, at least one; `name` is unique among the inputs.

    `key` identifies the input without its folder's name; `in_labels` is its path in labels.csv.
    `labels` are the input's labels in a given table; None if the table does not list the input.
    """

    name: str
    path: str
    results: tuple[LabelledResult, ...]
    key: str
    in_labels: str
    labels: list[Label] | None = None


@dataclass(frozen=True)
class Gathered:
    """All inputs, sorted by name; `failed` has the failed videos of batches, with the reasons.

    `is_batch` says whether results were found in subfolders of a given folder. The paths in
    labels.csv are relative to `labels_folder`, which holds all inputs.
    """

    inputs: list[Input]
    failed: list[tuple[str, str]]
    is_batch: bool
    labels_folder: str


def gather(paths: Sequence[Path], known: ByVideo | None = None) -> Gathered:
    """Read every result in folders, or in their subfolders, and group them by input.

    `known` has the labels of the inputs, see `read_by_video`.

    Raises
    ------
    ResultError
        If a folder holds no result, or all results are damaged.
    """
    by_input: dict[tuple[Any, ...], list[LabelledResult]] = {}
    trees = [tree for tree in map(store.tree_at, paths) if tree is not None]
    folders = store.with_results(paths)
    for labelled in chain(*readable(partial(_read, folder) for folder in folders)):
        folder = labelled.folder
        # `below` is empty if the folder itself was given.
        below = (folder.relative_to(tree) for tree in trees if folder.is_relative_to(tree))
        labelled = replace(labelled, below=next(below, Path()))
        facts = labelled.result.record["input"]
        same = tuple(facts.get(key) for key in ("path", "bytes", "mtime_ns", "sha256"))
        by_input.setdefault(same, []).append(labelled)
    failed = [video for tree in dict.fromkeys(trees) for video in _failures(tree)]
    first_of = [first for first, *_ in by_input.values()]
    places = [_place(first.result) for first in first_of]
    labels_folder = _common([_root(first) for first in first_of])
    inputs = []
    for name, results in zip(distinct_names(places), by_input.values(), strict=True):
        facts = results[0].result.record["input"]
        path, n_bytes = facts["path"], facts.get("bytes")
        key = hashlib.sha256(f"{path}|{n_bytes}".encode(errors="backslashreplace")).hexdigest()[:16]
        in_labels = path
        if labels_folder:
            in_labels = Path(os.path.relpath(path, labels_folder)).as_posix()
        labels = labels_of(known or {}, path)
        inputs.append(Input(name, path, _labelled(results), key, in_labels, labels))
    inputs.sort(key=lambda subject: subject.name)
    return Gathered(inputs, failed, bool(trees), labels_folder)


def _root(labelled: LabelledResult) -> str:
    """The folder of an input; in a batch, the searched folder, whose tree the results mirror.

    By paths relative to this folder, 'dlgmd evaluate --results' finds results from labels.csv.
    """
    folder = PurePath(labelled.result.record["input"]["path"]).parent
    n_mirrored = _n_common(str(labelled.below.parent), str(folder))
    return str(PurePath(*folder.parts[: len(folder.parts) - n_mirrored]))


def _n_common(path: str, other: str) -> int:
    """The number of parts at the end of two paths that agree."""
    pairs = zip(reversed(PurePath(path).parts), reversed(PurePath(other).parts), strict=False)
    return next((n for n, (a, b) in enumerate(pairs) if a != b), len(PurePath(path).parts))


def _common(folders: Sequence[str]) -> str:
    """The folder that holds all `folders`; empty if there is none (URLs, several drives)."""
    try:
        folder = os.path.commonpath(folders)
    except ValueError:
        return ""
    return folder if Path(folder).is_absolute() else ""


def collisions_of(subject: Input, frames: Iterable[int]) -> list[int] | None:
    """The collision frames of an input: given in `frames`, in records, and in labels.

    None if no frame is given or recorded, and the input is not labelled.
    """
    recorded = (_contact_frame(labelled.result) for labelled in subject.results)
    known = [*collision_frames(subject.labels or ()), *recorded]
    collisions = {*frames, *(frame for frame in known if frame is not None)}
    return sorted(collisions) if collisions or subject.labels is not None else None


def _contact_frame(result: Result) -> int | None:
    """The collision frame in a result's record, or in a rendered clip's ground truth."""
    if result.contact_s is None or result.contact_s > result.time_s[-1]:
        return None
    return result.collision_frame or int(
        result.frame[np.searchsorted(result.time_s, result.contact_s - ROUNDING_S)]
    )


def _read(folder: Path) -> list[LabelledResult]:
    results = []
    if (folder / store.RUN).exists() or not (folder / store.COMPARISON).exists():
        result = read_result(folder)
        results.append(LabelledResult(folder, result.label, result, (result,)))
    if (folder / store.COMPARISON).exists():
        compared = read_comparison(folder)
        peers = tuple(compared.values())
        results += [LabelledResult(folder, *item, peers) for item in compared.items()]
    for labelled in results:
        if not isinstance((labelled.result.record.get("input") or {}).get("path"), str):
            raise ResultError(str(folder), "its record does not name the input", "Run again.")
    return results


def _labelled(results: Sequence[LabelledResult]) -> tuple[LabelledResult, ...]:
    """The results of an input; labels that occur twice are extended by the folder."""
    labels = [labelled.label for labelled in results]
    folders = list(dict.fromkeys(labelled.folder for labelled in results))
    names = dict(zip(folders, distinct_names(folders), strict=True))
    unique = numbered(
        [
            label if labels.count(label) == 1 else f"{label} · {names[labelled.folder]}"
            for label, labelled in zip(labels, results, strict=True)
        ]
    )
    return tuple(
        replace(result, label=label) for result, label in zip(results, unique, strict=True)
    )


def _place(result: Result) -> Path:
    known = result.record["input"]
    return picture_folder(known["path"]) if "pictures" in known else Path(known["path"])


def _failures(folder: Path) -> list[tuple[str, str]]:
    """The failed videos of a batch, with the reasons; empty if the summary cannot be read."""
    failed = []
    for path in sorted([*folder.glob(store.SUMMARY), *folder.glob(f"*/{store.SUMMARY}")]):
        with suppress(ResultError):
            table = read_table(path, ResultError)
            columns = map(table.texts, ("video", "status", "error"))
            for video, status, error in zip(*columns, strict=True):
                if status not in (DONE, ""):
                    failed.append((video, error or status))
    return list(dict.fromkeys(failed))
