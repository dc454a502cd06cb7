"""Reading stored results: a run, or a comparison."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import ParameterError, ResultError
from dlgmd_cli.frame import Series
from dlgmd_cli.parameters.presets import stored_parameters
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import read_record, require, unpacked_flags
from dlgmd_cli.results.result import Result


def read_result(folder: str | Path) -> Result:
    """Read a result that `Result.save` or `dlgmd run` wrote; numbers have nine digits.

    Raises
    ------
    ResultError
        If there is no result, or one of its files is missing or damaged.
    """
    folder, record = _opened(folder, store.RUN, "result", "run")
    require(folder / store.RUN, record, "input.fps", "input.frames")

    whole = record.get("complete") is not False
    headers = {name: csv.TABLES[name] for name in ("mp.csv", "attenuation.csv")}
    headers["mp.csv"] += own_columns(record)
    tables = [csv.read_columns(folder / k, names, complete=whole) for k, names in headers.items()]
    if not whole:
        # 'dlgmd live' may have been killed when a row was in the first file only.
        n_rows = min(len(table["frame"]) for table in tables)
        tables = [{key: column[:n_rows] for key, column in table.items()} for table in tables]
    levels, attenuation = tables
    if not np.array_equal(levels["frame"], attenuation["frame"]):
        raise ResultError(str(folder / "attenuation.csv"), "its frames are not those of mp.csv")
    return _result(folder / store.RUN, {**levels, **attenuation}, record, record)


def read_comparison(folder: str | Path) -> dict[str, Result]:
    """Read the results that `dlgmd compare` wrote, by label, in its order.

    A comparison stores neither sums nor centroids: these are undefined.

    Raises
    ------
    ResultError
        If there is no comparison, or one of its files is missing or damaged.
    """
    folder, record = _opened(folder, store.COMPARISON, "comparison", "compare")
    require(folder / store.COMPARISON, record, "models")
    by_label = csv.read_comparison_columns(folder / "compare.csv")
    described = {str(model.get("label")): model for model in record["models"]}
    if by_label.keys() != described.keys():
        raise ResultError(str(folder), f"compare.csv and {store.COMPARISON} do not match")
    common = {k: record[k] for k in ("input", "options", "collision_frame") if k in record}
    results = {}
    for label, columns in by_label.items():
        own = described[label]
        size = {key: own[key] for key in ("width", "height", "cells") if key in own}
        facts = {**common, **own, "processed": size}
        results[label] = _result(folder / store.COMPARISON, columns, facts, own)
    return results


def own_columns(record: Mapping[str, Any]) -> tuple[str, ...]:
    """The model's own columns by a record, see `Model.columns`."""
    return tuple(name for name in record.get("columns", ()) if name not in csv.KNOWN)


def _opened(folder: str | Path, name: str, what: str, command: str) -> tuple[Path, dict[str, Any]]:
    """The folder as a path, and the record in it; raises ResultError unless both are there."""
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
            raise ResultError(str(folder), "there is no such folder", "Run 'dlgmd run' first.")
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise ResultError(str(folder)[:200], f"cannot be read ({error})") from None
    record = read_record(folder / name)
    if not record:
        why = f"contains no {what} (no {name})"
        raise ResultError(str(folder), why, f"Run 'dlgmd {command}' first.")
    return folder, record


def _result(
    path: Path, columns: Mapping[str, Series], record: dict[str, Any], own: Mapping[str, Any]
) -> Result:
    """A result from stored columns and a record; `own` holds the model and its parameters."""
    require(path, record, "processed.width", "processed.height")
    try:
        params = stored_parameters(own)
    except ParameterError as error:
        raise ResultError(str(path), str(error).rstrip("."), "Run again.") from None
    # Results of before the column `repeat` have the flags in the record, or none.
    repeated = record.get("input", {}).get("repeated_rows")
    flags = {}
    try:
        if "repeat" in columns:
            flags["is_repeat"] = columns["repeat"] == 1.0
        elif repeated is not None:
            flags["is_repeat"] = unpacked_flags(repeated, len(columns["frame"]))
    except ValueError:
        raise ResultError(str(path), "its repeated_rows are damaged", "Run again.") from None
    return Result(csv.rows_of({**columns, **flags}, own_columns(record)), params, record)
