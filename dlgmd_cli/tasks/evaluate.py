"""Recall, false alarms and lead times on labelled collisions."""

import logging
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Literal

from dlgmd_cli.errors import DlgmdError, ParameterError, ResultError, SourceError
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.checks import Spec, blame
from dlgmd_cli.parameters.presets import LkDivergenceParameters
from dlgmd_cli.results import store
from dlgmd_cli.results.candidates import FLOW, Candidates, Results
from dlgmd_cli.results.evaluation import Evaluation, evaluated
from dlgmd_cli.results.labels import Case, StoredResults, of_kind, read_cases
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import ModelName, Progress, Request, Setup, no_progress
from dlgmd_cli.tasks.run import require_response, run_models
from dlgmd_cli.tasks.stopping import TRUE, answer_of, brakes_of, speed_of, stops_of, with_speed

_log = logging.getLogger(__name__)

_HORIZON = Spec(float, 0, 3600, low_open=True)
_FALSE_PER_MIN = Spec(float, 0, math.inf)


def evaluate(
    labels: str | os.PathLike[str],
    model: ModelName | Sequence[ModelName] | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    results: str | os.PathLike[str] | None = None,
    horizon: float = 1.0,
    max_false_per_min: float | str = 1.0,
    react: float = 0.1,
    brake: float | None = None,
    agile: bool | None = None,
    speed_m_s: float | str | None = None,
    baselines: bool = True,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Evaluation:
    """Score alarms against labelled collisions; `dlgmd evaluate --help` has the rules.

    Parameters
    ----------
    labels : str or path
        A CSV with the columns ``video,collision_frame``, paths relative to it; ``target``, ``kind``
        and ``manner`` are optional.
    model, formulation, param, engine
        The models, as in `run`. What `param` changes shows in their labels.
    results : str or path, optional
        Score the results of `batch` in this folder instead of running models.
    horizon : float
        An alarm up to so many seconds before a collision is a hit.
    max_false_per_min : float or str
        False alarms per minute that the best threshold may have; on the videos of one kind as
        ``"1:real"``.
    react : float
        How the pilot of a rendered flight answers an alarm: after so many seconds.
    brake : float, optional
        Deceleration in m/s², at once. Without it, the drone brakes as it can.
    agile : bool, optional
        Whether the drones lean at once, or as stabilised ones. Without it, as each does.
    speed_m_s : float or "true", optional
        Also score each model with the rule `ttc` with the `ttc_alarm` that a stop from this speed
        needs, and 0.2 s; as ``"true"``, from the speed that each rendered flight has at each frame.
    baselines : bool
        Also score the sum of P, and the expansion rate of tracked corners.
    jobs, progress
        As in `batch`.
    out : str or path, optional
        Write the tables, figures in `formats` (PNG with `dpi`, `width` in columns of a paper) and
        evaluate.yaml into this folder; `overwrite` replaces earlier ones.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Evaluation
        `table`, `curve_table`, `alarm_table` and `ttc_table` are structured arrays with the columns
        of the files; `plot` draws, and `save` writes them. `failed` says why videos are left out.

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
    rules, brakes = rules_of(horizon, max_false_per_min), brakes_of(react, brake, agile)
    speed = speed_of(speed_m_s, TRUE)
    of_models = {"model": model, "param": param, "formulation": formulation, "engine": engine}
    of_models |= {"jobs": jobs, **options}
    given = [name for name, value in of_models.items() if value is not None]
    if results is not None and given:
        why = f"{given[0]} does not work with results, which are there already"
        raise ParameterError("", why, "Leave it out.")
    labels, formats = Path(labels), store.known_formats(formats)
    cases = read_cases(labels)
    of_kind(cases, rules["max_false_kind"])  # raises if there are none
    with ExitStack() as opened:
        claim = None
        if out is not None:
            names = Evaluation.own_files(formats)
            place = store.claimed(Path(out), Evaluation.RECORD, names=names, overwrite=overwrite)
            claim = opened.enter_context(place)
        if results is not None:
            outcomes = stored_results(Path(results), cases)
        else:
            request = call.fold(model, formulation, param, engine, options)
            setups = call.with_folder_labels(call.with_keys(request.setups, param or ()))
            for setup in setups:  # raises if an engine is not installed
                create_model(setup.params, engine=setup.engine)
            setups += [flow_setup()] if baselines else []
            outcomes = run_cases(cases, replace(request, setups=tuple(setups)), jobs)
        candidates = scored(labels, cases, outcomes, progress, baselines=baselines)
        stops = stops_of(candidates, brakes, jobs)
        if speed is not None:
            with_speed(candidates, stops, brakes, speed)
        made = evaluated(candidates, rules, labels, stops, answer_of(brakes))
        if claim is not None:
            made.write(claim, formats, dpi, width=width)
    return made


def rules_of(horizon: float, max_false_per_min: float | str) -> dict[str, Any]:
    """The checked rules of an evaluation, by name; raises ParameterError."""
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


def scored(
    labels: Path,
    cases: Sequence[Case],
    outcomes: Iterator[tuple[Case, Results]],
    progress: Progress,
    *,
    baselines: bool = False,
) -> Candidates:
    """The models and the videos, as they are computed; logs those that fail.

    Raises SourceError if no video can be scored.
    """
    by_name = {}
    with progress("evaluate", len(cases), "video") as advance:
        for number, (case, results) in enumerate(outcomes, start=1):
            by_name[case.name] = results
            advance(number)
    candidates = Candidates(baselines=baselines)
    for case in cases:
        candidates.add(case, by_name[case.name])
    for name, why in candidates.failed.items():
        _log.error("%s: %s", name, why)
    if not candidates.cases:
        raise SourceError(str(labels), "no video could be scored")
    return candidates


def run_cases(
    cases: Sequence[Case], request: Request, jobs: int | None
) -> Iterator[tuple[Case, Results]]:
    """Run all models over every video; yields each video with its results, or its error.

    Videos come in the order in which they end. Each is decoded once, in one of `jobs` processes. An
    error that is not a DlgmdError is raised.
    """
    return results_of(partial(_run, request), cases, jobs)


def _run(request: Request, case: Case) -> dict[str, Result]:
    """All models over one video."""
    try:
        with request.open(case.path) as video:
            results = run_models(video, request)
            require_response(video, request, results)
    except SourceError:
        if store.is_url(case.path) or Path(case.path).exists():
            raise
        folder = Path(os.path.abspath(case.path)).parent
        hint = "Paths in labels start at the folder of their table."
        raise SourceError(case.name, f"it is not in {folder}", hint) from None
    return {setup.label: result for setup, result in zip(request.setups, results, strict=True)}


def flow_setup() -> Setup:
    """The expansion rate of tracked corners, which gets the frames of the preset flight."""
    params = LkDivergenceParameters()
    return replace(call.choose(), params=params, label=FLOW, engine="auto", named={})


def stored_results(folder: Path, cases: Sequence[Case]) -> Iterator[tuple[Case, Results]]:
    """Every video with its results, read from the folder of a batch, or its error.

    Raises ResultError if it is not the folder of a batch.
    """
    is_single = (folder / store.SUMMARY).is_file()
    pattern = store.SUMMARY if is_single else f"*/{store.SUMMARY}"
    places = [path.parent for path in sorted(folder.glob(pattern))]
    if not places:
        why = f"it holds no results of a batch (no {store.SUMMARY})"
        raise ResultError(str(folder), why, "Run 'dlgmd batch' first.")
    label, stored = "", {place.name: StoredResults(place) for place in places}
    for case in cases:
        try:
            results = {
                name: read_result(batch.folder_of(case.path, case.name))
                for name, batch in stored.items()
            }
        except DlgmdError as error:
            yield case, error
            continue
        if is_single:
            (result,) = results.values()
            record = result.record
            own = f"set{record['set']}" if "set" in record else record.get("preset")
            label = label or str(own or record["model"])
            results = {label: result}
        yield case, results
