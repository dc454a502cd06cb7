"""What pages show: results by the input that they are of, and collisions from labels."""

import csv
import os
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

from dlgmd_cli.errors import ResultError
from dlgmd_cli.names import numbered, told_apart
from dlgmd_cli.pool import DONE
from dlgmd_cli.results import store
from dlgmd_cli.results.labels import read_labels
from dlgmd_cli.results.result import Result, read_comparison, read_result
from dlgmd_cli.runs.find import SUMMARY

# A result with its folder, its name within it, and those that were computed in one go with it.
Entry = tuple[Path, str, Result, tuple[Result, ...]]


@dataclass(frozen=True)
class Shown:
    """A result under its label; `peers` were computed in one go with it, itself among them."""

    label: str
    result: Result
    peers: tuple[Result, ...]


@dataclass(frozen=True)
class Input:
    """An input with all of its results, at least one; `name` is what the page calls it."""

    name: str
    path: str
    shown: tuple[Shown, ...]


@dataclass(frozen=True)
class Gathered:
    """Inputs in order; `failed` are videos of a batch without a result, with the reason.

    `is_batch` says whether one of the folders holds results in folders of its own.
    """

    inputs: list[Input]
    failed: list[tuple[str, str]]
    is_batch: bool


def gather(paths: Sequence[Path]) -> Gathered:
    """Every result in folders, or in the folders within them, by input.

    Raises
    ------
    ResultError
        If a folder holds no result, or one that is damaged.
    """
    found: list[Entry] = []
    failed: list[tuple[str, str]] = []
    is_batch = False
    for path in paths:
        folders = [path]
        if not _has_result(path):
            folders = _below(path)
            failed += _failures(path)
            is_batch = True
        for folder in folders:
            found += _read(folder)
    by_input: dict[tuple[Any, ...], list[Entry]] = {}
    for entry in found:
        by_input.setdefault(_identity(entry[2]), []).append(entry)
    inputs = []
    inputs_of = [
        PurePath(str(entries[0][2].record["input"]["path"])) for entries in by_input.values()
    ]
    names = told_apart([Path(one) for one in inputs_of])
    for name, entries in zip(names, by_input.values(), strict=True):
        labels = _labels(entries)
        shown = [
            Shown(label, result, peers)
            for label, (_, _, result, peers) in zip(labels, entries, strict=True)
        ]
        inputs.append(Input(name, str(entries[0][2].record["input"]["path"]), tuple(shown)))
    return Gathered(sorted(inputs, key=lambda one: one.name), failed, is_batch)


def collisions_of(one: Input, frames: Iterable[int], labels: dict[str, list[int]]) -> list[int]:
    """Frames at which an input's camera collides: those given, those on record, those labelled."""
    known = {shown.result.collision_frame for shown in one.shown}
    labelled = labels.get(one.path, labels.get(PurePath(one.path).name, []))
    return sorted({*frames, *labelled, *(frame for frame in known if frame is not None)})


def read_collisions(path: Path) -> dict[str, list[int]]:
    """Collision frames that a labels.csv lists, by the video's absolute path.

    Also by the name of its file, where no other video has the same. Raises ResultError if it is no
    such file.
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


def _has_result(folder: Path) -> bool:
    """Whether a folder holds a result itself; one that is not there says so when it is read."""
    records = (store.RUN, store.COMPARISON)
    return not folder.is_dir() or any((folder / name).exists() for name in records)


def _below(folder: Path) -> list[Path]:
    """The folders below one that hold results, in order; raises ResultError if there are none."""
    names = (store.RUN, store.COMPARISON)
    found = sorted({record.parent for name in names for record in folder.rglob(name)})
    if not found:
        raise ResultError(
            str(folder),
            f"it holds no result (no {store.RUN} or {store.COMPARISON})",
            "Run 'dlgmd run' or 'dlgmd batch' first.",
        )
    return found


def _read(folder: Path) -> list[Entry]:
    """Every result of a folder."""
    found: list[Entry] = []
    if (folder / store.RUN).exists() or not (folder / store.COMPARISON).exists():
        result = read_result(folder)
        found.append((folder, _model_name(result), result, (result,)))
    if (folder / store.COMPARISON).exists():
        compared = read_comparison(folder)
        peers = tuple(compared.values())
        found += [(folder, label, result, peers) for label, result in compared.items()]
    for _, _, result, _ in found:
        if not isinstance((result.record.get("input") or {}).get("path"), str):
            raise ResultError(str(folder), "its record does not name the input", "Run again.")
    return found


def _model_name(result: Result) -> str:
    """What a single result's model is called: its set, its preset, or itself."""
    if isinstance(number := result.record.get("set"), int):
        return f"set{number}"
    return str(result.record.get("preset") or result.params.model)


def _labels(entries: Sequence[Entry]) -> list[str]:
    """Names of the results of one input: the models', with the folders' where these are alike."""
    names = [name for _, name, _, _ in entries]
    folders = list(dict.fromkeys(folder for folder, *_ in entries))
    told = dict(zip(folders, told_apart(folders), strict=True))
    return numbered(
        [
            name if names.count(name) == 1 else f"{name} · {told[folder]}"
            for folder, name, _, _ in entries
        ]
    )


def _identity(result: Result) -> tuple[Any, ...]:
    """What tells the input of a result from others."""
    known = result.record["input"]
    return tuple(known.get(key) for key in ("path", "bytes", "mtime_ns", "sha256"))


def _failures(folder: Path) -> list[tuple[str, str]]:
    """Videos that a batch could not finish, and why; nothing where the table cannot be read."""
    failed = []
    for path in sorted([*folder.glob(SUMMARY), *folder.glob(f"*/{SUMMARY}")]):
        try:
            with path.open(newline="", encoding="utf-8") as file:
                for row in csv.DictReader(file):
                    if row.get("status") not in (DONE, None):
                        why = row.get("error") or row["status"]
                        failed.append((str(row.get("video")), str(why)))
        except (OSError, ValueError, csv.Error):
            continue
    return list(dict.fromkeys(failed))
