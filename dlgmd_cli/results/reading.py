"""Reading stored results: a run, a comparison, or all results below a folder."""

import logging
import os
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path, PurePath
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, ResultError, warn
from dlgmd_cli.models.columns import MP
from dlgmd_cli.models.own_rules import keep_stored
from dlgmd_cli.parameters.checks import similar_path
from dlgmd_cli.parameters.facts import ModelFacts, Processed, Record, of_another_schema, part_of
from dlgmd_cli.parameters.presets import stored_parameters
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.files import COMPARED
from dlgmd_cli.results.labels import (
    ByVideo,
    collision_frames,
    labels_of,
    read_by_video,
    tell_outside,
)
from dlgmd_cli.results.record import checked_record, require
from dlgmd_cli.results.result import Result

ReadT = TypeVar("ReadT")

_log = logging.getLogger(__name__)


def read_result(folder: str | Path) -> Result:
    """Read a result that `Result.save` or `dlgmd run` wrote, with numbers of nine digits.

    Raises
    ------
    ResultError
        If there is no result, or one of its files is missing or damaged.
    """
    folder, record = _opened(folder, store.RUN, "result", "run")
    require(folder / store.RUN, record, "input.fps", "input.frames")

    whole = not record.get("interrupted", False)
    headers = csv.headers(own_columns(record))
    tables = [csv.read_columns(folder / k, names, complete=whole) for k, names in headers.items()]
    if not whole:
        # A killed 'dlgmd live' may have written the last row to the first file only.
        n_rows = min(len(table["frame"]) for table in tables)
        tables = [{key: column[:n_rows] for key, column in table.items()} for table in tables]
    for name, table in zip(headers, tables, strict=True):
        if not np.array_equal(tables[0]["frame"], table["frame"]):
            raise ResultError(str(folder / name), f"its frames are not those of {MP}")
    columns = {name: column for table in tables for name, column in table.items()}
    return _result(folder / store.RUN, columns, record, record)


def read_results(folder: str | Path, labels: str | Path | None = None) -> csv.Table:
    """Read all runs below a folder, such as those of `batch`, into one tidy table.

    Parameters
    ----------
    folder : str or path
        The folder of a batch, or another folder with results below.
    labels : str or path, optional
        A table of collisions, as for `evaluate`.

    Returns
    -------
    structured array, shape (n,)
        One row per frame: `video` (as in summary.csv), `model`, `frame`, `time_s`, `repeat`,
        `to_collision_s`, and the other columns of `Result.table`, NaN where a model lacks a column.
        `to_collision_s` is the time to the next collision in seconds, negative after the last
        collision, NaN if no collision is known. Without `labels`, and for videos not listed there,
        the collision is at `Result.contact_s`. ``pandas.DataFrame(table)`` accepts the array.

    Raises
    ------
    ResultError
        If there is no run, or if a file of a run or the table of labels is missing or damaged.

    Examples
    --------
    >>> table = read_results("dlgmd-out", "labels.csv")  # doctest: +SKIP
    >>> new = table[table["repeat"] == 0]  # doctest: +SKIP
    """
    folder = Path(folder)
    known = None if labels is None else read_by_video(Path(labels))
    paths = [path.parent for path in store.records_below(folder, store.RUN)]
    if not paths:
        raise ResultError(
            str(folder), f"contains no run (no {store.RUN})", "Run 'dlgmd batch' first."
        )
    results = [read_result(path) for path in paths]
    keys = [
        (_video_of(result, path, folder), result.label)
        for result, path in zip(results, paths, strict=True)
    ]
    tables, n_alike = [], Counter(keys)
    for (video, model), path, result in zip(keys, paths, results, strict=True):
        if n_alike[video, model] > 1:
            model = f"{model} · {path.relative_to(folder).as_posix()}"
        tables.append(_tidy(video, model, result, _contacts_s(known, result)))
    names = dict.fromkeys(name for table in tables for name in table)
    columns = {}
    for name in names:
        parts = [table.get(name, np.full(len(table["frame"]), np.nan)) for table in tables]
        columns[name] = np.concatenate(parts)
    return csv.table_from(columns)


def _video_of(result: Result, path: Path, folder: Path) -> str:
    """The video's name in its batch: as many path parts as the result's folder has in the batch."""
    batches = (batch for batch in path.parents if (batch / store.SUMMARY).is_file())
    n_parts = len(path.relative_to(next(batches, folder)).parts) or 1
    return "/".join(PurePath(str(result.record["input"].get("path"))).parts[-n_parts:])


def _contacts_s(known: ByVideo | None, result: Result) -> list[float]:
    """The times (s) of a result's collisions, by its labels, else by `Result.contact_s`."""
    frames = None if known is None else labelled_frames(known, result, result.title)
    if frames is None:
        return [] if result.contact_s is None else [result.contact_s]
    return sorted(result.times_of(frames))


def labelled_frames(known: ByVideo, result: Result, label: str) -> list[int] | None:
    """The labelled collisions (frames) of a result; None, with a warning, if it is not listed.

    Also warns of collisions outside the result's frames. Warnings call the result `label`.
    """
    path = str(result.record["input"].get("path"))
    listed = labels_of(known, path)
    if listed is None:
        warn(f"the labels do not list {path}")
        return None
    frames = collision_frames(listed)
    tell_outside(label, result.frame, frames)
    return frames


def _tidy(
    video: str, model: str, result: Result, contacts_s: Sequence[float]
) -> dict[str, npt.NDArray]:
    """The columns of a result, with the video, the model and the time to the next collision."""
    table = result.table
    columns = {name: table[name] for name in table.dtype.names or ()}
    first = {"video": np.full(len(result), video), "model": np.full(len(result), model)}
    first |= {name: columns.pop(name) for name in ("frame", "time_s", "repeat")}
    ahead_s = np.array([*contacts_s, np.nan])
    following = np.searchsorted(ahead_s[:-1], result.time_s).clip(max=max(len(contacts_s) - 1, 0))
    return {**first, "to_collision_s": ahead_s[following] - result.time_s, **columns}


def read_comparison(folder: str | Path) -> dict[str, Result]:
    """Label -> result that `dlgmd compare` wrote, in the order of the file.

    Raises
    ------
    ResultError
        If there is no comparison, or one of its files is missing or damaged.
    """
    folder, record = _opened(folder, store.COMPARISON, "comparison", "compare")
    require(folder / store.COMPARISON, record, "models")
    by_label = csv.read_comparison_columns(folder / COMPARED)
    described = {str(model.get("label")): model for model in record["models"]}
    if by_label.keys() != described.keys():
        raise ResultError(str(folder), f"{COMPARED} and {store.COMPARISON} do not match")
    common: Record = {"input": record.get("input", {}), "options": record.get("options", {})}
    if "collision_frame" in record:
        common["collision_frame"] = record["collision_frame"]
    results = {}
    for label, columns in by_label.items():
        model = described[label]
        facts: Record = {**common, **model, "processed": part_of(model, Processed)}
        results[label] = _result(folder / store.COMPARISON, columns, facts, model)
    return results


def readable(reads: Iterable[Callable[[], ReadT]]) -> list[ReadT]:
    """What each call reads; a damaged result is left out, with an error, unless all are damaged."""
    found, damaged = [], []
    for read in reads:
        try:
            found.append(read())
        except ResultError as error:
            damaged.append(error)
    if damaged and not found:
        raise damaged[0]
    for one in damaged:
        _log.error("%s: %s; it is left out", one.what, one.why)
    return found


def own_columns(record: Record) -> tuple[str, ...]:
    """The model's own columns that a record lists, see `Model.columns`."""
    return tuple(name for name in record.get("columns", ()) if name not in csv.KNOWN)


def _opened(folder: str | Path, name: str, what: str, command: str) -> tuple[Path, Record]:
    """The folder as a path, and the record inside; raises ResultError unless both exist."""
    if not isinstance(folder, str | os.PathLike):
        why = f"expected the folder of a result, not {type(folder).__name__}"
        raise ResultError("", why, "Write read_result('dlgmd-out/flight').")
    folder = Path(folder)
    try:
        if folder.is_file():
            why = "is a file, not the folder of a result"
            hint = f"Run 'dlgmd run {folder.name}' first, if it is a video."
            raise ResultError(str(folder), why, hint)
        if not folder.is_dir():
            hint = similar_path(folder) or "Run 'dlgmd run' first."
            raise ResultError(str(folder), "there is no such folder", hint)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ResultError(str(folder)[:200], f"cannot be read ({error})") from None
    record = checked_record(folder / name)
    below = (store.SUMMARY, f"*/{store.SUMMARY}", f"*/{store.RUN}")
    if not record and name == store.RUN and any(any(folder.glob(pattern)) for pattern in below):
        why = "contains the results of several videos"
        raise ResultError(str(folder), why, "Read them all with read_results.")
    if not record:
        why = f"contains no {what} (no {name})"
        raise ResultError(str(folder), why, f"Run 'dlgmd {command}' first.")
    if refusal := of_another_schema(record):
        raise ResultError(str(folder / name), *refusal)
    return folder, record


def _result(
    path: Path,
    columns: csv.Columns,
    record: Record,
    model: ModelFacts,
) -> Result:
    """A result from stored columns and a record; `model` is the part with its parameters."""
    require(path, record, "processed.width", "processed.height")
    keep_stored(model.get("alarm"))
    try:
        params = stored_parameters(model)
    except ParameterError as error:
        raise ResultError(str(path), str(error).rstrip("."), "Run again.") from None
    return Result(csv.rows_of(columns, own_columns(record)), params, record)
