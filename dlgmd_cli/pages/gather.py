"""Gather the content of pages: results grouped by input, and labelled collisions."""

import csv
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ResultError
from dlgmd_cli.files import open_regular
from dlgmd_cli.names import distinct_names, numbered, picture_folder
from dlgmd_cli.pool import DONE
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import labelled_frames
from dlgmd_cli.results.result import Result, read_comparison, read_result
from dlgmd_cli.runs.find import SUMMARY


@dataclass(frozen=True)
class LabelledResult:
    """A result, its folder and label; `peers` are all results of the same run, with itself."""

    folder: Path
    label: str
    result: Result
    peers: tuple[Result, ...]


@dataclass(frozen=True)
class Input:
    """An input with all of its results, at least one; `name` is unique among the inputs."""

    name: str
    path: str
    results: tuple[LabelledResult, ...]


@dataclass(frozen=True)
class Gathered:
    """All inputs, sorted by name; `failed` has the failed videos of batches, with the reasons.

    `is_batch` says whether results were found in subfolders of a given folder.
    """

    inputs: list[Input]
    failed: list[tuple[str, str]]
    is_batch: bool


def gather(paths: Sequence[Path]) -> Gathered:
    """Read every result in folders, or in their subfolders, and group them by input.

    Raises
    ------
    ResultError
        If a folder holds no result, or one that is damaged.
    """
    failed: list[tuple[str, str]] = []
    by_input: dict[tuple[Any, ...], list[LabelledResult]] = {}
    batches = [path for path in paths if not _has_result(path)]
    for path in paths:
        for folder in _below(path) if path in batches else [path]:
            for one in _read(folder):
                known = one.result.record["input"]
                same = tuple(known.get(key) for key in ("path", "bytes", "mtime_ns", "sha256"))
                by_input.setdefault(same, []).append(one)
    for path in batches:
        failed += _failures(path)
    inputs = []
    places = [_place(first.result) for first, *_ in by_input.values()]
    for name, results in zip(distinct_names(places), by_input.values(), strict=True):
        path = results[0].result.record["input"]["path"]
        inputs.append(Input(name, path, _labelled(results)))
    return Gathered(sorted(inputs, key=lambda one: one.name), failed, bool(batches))


def collisions_of(one: Input, frames: Iterable[int], labels: dict[str, list[int]]) -> list[int]:
    """The collision frames of an input: those given, those on record, and those labelled."""
    known = {labelled.result.collision_frame for labelled in one.results}
    listed = labelled_frames(labels, one.path) or []
    return sorted({*frames, *listed, *(frame for frame in known if frame is not None)})


def _has_result(folder: Path) -> bool:
    """Whether a folder holds a result itself; a missing folder counts, and fails when read."""
    records = (store.RUN, store.COMPARISON)
    return not folder.is_dir() or any((folder / name).exists() for name in records)


def _below(folder: Path) -> list[Path]:
    """The subfolders with results, sorted; raises ResultError if there are none."""
    names = (store.RUN, store.COMPARISON)
    found = sorted({record.parent for name in names for record in folder.rglob(name)})
    if not found:
        raise ResultError(
            str(folder),
            f"contains no result (no {store.RUN} or {store.COMPARISON})",
            "Run 'dlgmd run' or 'dlgmd batch' first.",
        )
    return found


def _read(folder: Path) -> list[LabelledResult]:
    found = []
    if (folder / store.RUN).exists() or not (folder / store.COMPARISON).exists():
        result = read_result(folder)
        found.append(LabelledResult(folder, _model_name(result), result, (result,)))
    if (folder / store.COMPARISON).exists():
        compared = read_comparison(folder)
        peers = tuple(compared.values())
        found += [LabelledResult(folder, *item, peers) for item in compared.items()]
    for one in found:
        if not isinstance((one.result.record.get("input") or {}).get("path"), str):
            raise ResultError(str(folder), "its record does not name the input", "Run again.")
    return found


def _model_name(result: Result) -> str:
    """The name of a result's model: its set, its preset, or the model itself."""
    if isinstance(number := result.record.get("set"), int):
        return f"set{number}"
    return str(result.record.get("preset") or result.params.model.rpartition(":")[2])


def _labelled(results: Sequence[LabelledResult]) -> tuple[LabelledResult, ...]:
    """The results of an input; labels that are not unique are extended by the folder."""
    labels = [one.label for one in results]
    folders = list(dict.fromkeys(one.folder for one in results))
    names = dict(zip(folders, distinct_names(folders), strict=True))
    unique = numbered(
        [
            one.label if labels.count(one.label) == 1 else f"{one.label} · {names[one.folder]}"
            for one in results
        ]
    )
    return tuple(replace(one, label=label) for one, label in zip(results, unique, strict=True))


def _place(result: Result) -> Path:
    known = result.record["input"]
    return picture_folder(known["path"]) if "pictures" in known else Path(known["path"])


def _failures(folder: Path) -> list[tuple[str, str]]:
    """The failed videos of a batch, with the reasons; none if the summary cannot be read."""
    failed = []
    for path in sorted([*folder.glob(SUMMARY), *folder.glob(f"*/{SUMMARY}")]):
        try:
            with open_regular(path, newline="", encoding="utf-8") as file:
                for row in csv.DictReader(file):
                    if row.get("status") not in (DONE, None):
                        why = row.get("error") or row["status"]
                        failed.append((str(row.get("video")), str(why)))
        except (OSError, ValueError, csv.Error):
            continue
    return list(dict.fromkeys(failed))
