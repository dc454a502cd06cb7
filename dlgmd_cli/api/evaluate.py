"""How well alarms announce labelled collisions."""

import logging
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any, Literal

from dlgmd_cli.api.batch import with_folder_labels
from dlgmd_cli.checks import Spec, blame
from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.lab.evaluation.cases import (
    Candidate,
    Case,
    Evaluation,
    Results,
    of_kind,
    read_cases,
    run_cases,
    stored_results,
    with_flow,
)
from dlgmd_cli.lab.evaluation.report import FIGURES, Report, make_report
from dlgmd_cli.models.base import create_model
from dlgmd_cli.results import store
from dlgmd_cli.results.record import record_text
from dlgmd_cli.runs.run import Progress, no_progress
from dlgmd_cli.runs.setup import ModelName, choose_all, common_options

_log = logging.getLogger(__name__)

RECORD = "evaluate.yaml"
TABLES = ("evaluate.csv", "curves.csv", "alarms.csv")
_HORIZON = Spec(float, 0, 3600, low_open=True)
_FALSE_PER_MIN = Spec(float, 0, math.inf)


def evaluate(
    labels: str | os.PathLike[str],
    models: Sequence[ModelName | int] | None = None,
    *,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    results: str | os.PathLike[str] | None = None,
    horizon: float = 1.0,
    max_false_per_min: float | str = 1.0,
    baselines: bool = True,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Report:
    """Score how well alarms announce labelled collisions; `dlgmd evaluate --help` has the rules.

    Parameters
    ----------
    labels : str or path
        A CSV with the columns ``video,collision_frame``, paths relative to it; ``target``, ``kind``
        and ``manner`` are optional.
    models, set, config, model, formulation, param, engine
        The models, as in `run`.
    results : str or path, optional
        Score the results of `batch` in this folder instead of running models.
    horizon : float
        An alarm up to so many seconds before a collision is a hit.
    max_false_per_min : float or str
        False alarms per minute that the best threshold may have; on the videos of one kind as
        ``"1:real"``.
    baselines : bool
        Also score the sum of P, and the divergence of optical flow.
    jobs, progress
        As in `batch`.
    out : str or path, optional
        Write the tables, figures in `formats` (PNG with `dpi`, `width` in columns of a paper) and
        evaluate.yaml into this folder; `overwrite` replaces earlier ones.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Report
        `table`, `curve_table` and `alarm_table` are structured arrays with the columns of the
        files; `plot` draws. ``evaluation.failed`` says why videos are left out.

    Raises
    ------
    ResultError
        If the labels or the results cannot be read.
    SourceError
        If no video can be scored.
    ParameterError
        If a parameter or an option is not valid.
    OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `batch`.

    Examples
    --------
    >>> report = evaluate("flights/labels.csv", models=[9, "lgmd"])  # doctest: +SKIP
    >>> report.table[["model", "at", "recall", "false_alarms_per_min"]]  # doctest: +SKIP
    """
    rules = rules_of(horizon, max_false_per_min)
    named = {"models": models, "set": set, "config": config, "model": model, "param": param}
    named |= {"formulation": formulation, "engine": engine, "jobs": jobs, **options}
    given = [name for name, value in named.items() if value is not None]
    if results is not None and given:
        why = f"{given[0]} does not work with results, which are there already"
        raise ParameterError("", why, "Leave it out.")
    labels, formats = Path(labels), tuple(dict.fromkeys(formats))
    cases = read_cases(labels)
    of_kind(cases, rules["max_false_kind"])  # raises if there are none
    with ExitStack() as opened:
        if out is not None:
            opened.enter_context(store.locked(Path(out)))
            for name in file_names(formats):
                store.refuse_existing(Path(out) / name, overwrite=overwrite)
        if results is not None:
            found = stored_results(Path(results), cases)
        else:
            setups = choose_all(models, set, config, model, param, formulation, engine)
            setups = with_folder_labels(setups)
            for one in setups:
                create_model(one.params, engine=one.engine)  # raises if it is not installed
            shared = common_options(setups, options)
            found = run_cases(cases, with_flow(setups) if baselines else setups, shared, jobs)
        evaluation = scored(labels, cases, found, progress, baselines=baselines)
        report = make_report(evaluation, **rules)
        if out is not None:
            _write(report, labels, rules, Path(out), formats, dpi, width)
    return report


def rules_of(horizon: float, max_false_per_min: float | str) -> dict[str, Any]:
    """The checked rules of an evaluation, by the names of `make_report`; raises ParameterError."""
    with blame("Invalid value for '--horizon'"):
        horizon_s = _HORIZON.check(horizon)
    rate, _, kind = str(max_false_per_min).partition(":")
    with blame("Invalid value for '--max-false-per-min'"):
        most = _FALSE_PER_MIN.parse(rate)
    return {
        "horizon_s": horizon_s,
        "max_false_per_min": most,
        "max_false_kind": kind.strip() or None,
    }


def file_names(formats: Iterable[str]) -> list[str]:
    """The files of an evaluation with figures in these formats."""
    figures = [f"evaluate-{kind}.{form}" for kind in FIGURES for form in formats]
    return [*TABLES, *figures, RECORD]


def scored(
    labels: Path,
    cases: Sequence[Case],
    found: Iterator[tuple[Case, Results]],
    progress: Progress,
    *,
    baselines: bool = False,
) -> Evaluation:
    """The models and the videos, as they are computed; logs those that fail.

    Raises SourceError if no video can be scored.
    """
    by_name = {}
    with progress("evaluate", len(cases), "video") as advance:
        for number, (case, results) in enumerate(found, start=1):
            by_name[case.name] = results
            advance(number)
    evaluation = Evaluation(baselines=baselines)
    for case in cases:
        evaluation.add(case, by_name[case.name])
    for name, why in evaluation.failed.items():
        _log.error("%s: %s", name, why)
    if not evaluation.cases:
        raise SourceError(str(labels), "no video could be scored")
    return evaluation


def _write(
    report: Report,
    labels: Path,
    rules: Mapping[str, Any],
    folder: Path,
    formats: Sequence[str],
    dpi: int,
    width: Literal["one", "two"],
) -> None:
    """Write the files of an evaluation into a folder, the record last."""
    candidates = report.evaluation.candidates.values()
    record = {
        "labels": str(labels.absolute()),
        **report.counts(),
        **rules,
        "models": [_described(one) for one in candidates],
        "options": next(iter(candidates)).record.get("options", {}),
    }
    files = report.tables()
    if formats:
        from dlgmd_cli.plots.style import figure_files

        figures = {f"evaluate-{kind}": partial(report.plot, kind, width) for kind in FIGURES}
        files |= figure_files(figures, formats, dpi)
    files[RECORD] = store.file_of(record_text(record, []))
    store.log_undrawn(folder, store.write_files(folder, files, record=RECORD))


def _described(one: Candidate) -> dict[str, Any]:
    processed = one.record["processed"]
    size = {key: processed[key] for key in ("width", "height", "cells") if key in processed}
    if one.params is None:
        return {"label": one.label, "n_sp": one.n_sp, **size}
    return {"label": one.label, "model": one.params.model, **one.params.to_dict(), **size}
