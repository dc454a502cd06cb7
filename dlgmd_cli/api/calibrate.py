"""The parameters that announce labelled collisions best, as a preset."""

import logging
import os
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dlgmd_cli import __version__, cancel
from dlgmd_cli.api.evaluate import rules_of, scored
from dlgmd_cli.checks import Spec
from dlgmd_cli.errors import DlgmdError, ParameterError, ResultError, printable
from dlgmd_cli.lab.evaluation import calibration
from dlgmd_cli.lab.evaluation.calibration import Calibration, Experiment, Trial
from dlgmd_cli.lab.evaluation.cases import Case, of_kind, read_cases, run_cases
from dlgmd_cli.lab.evaluation.report import ALL, interval_text
from dlgmd_cli.lab.evaluation.scoring import Scores
from dlgmd_cli.lab.evaluation.search import Search, parse_range
from dlgmd_cli.results import store
from dlgmd_cli.results.record import yaml_text
from dlgmd_cli.runs.run import Progress, no_progress
from dlgmd_cli.runs.setup import ModelName, Setup, choose, input_options
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.words import counted

_log = logging.getLogger(__name__)

SHOWN = ("recall", "false_alarms_per_min", "lead_s", "auc")
# Options that a preset keeps: how a frame is prepared, not which part of a video is read.
_KEPT = ("scale", "size", "fps", "repeats")
_FOLDS, _TRIALS = Spec(int, 2, 1000), Spec(int, 1, 1_000_000)


def calibrate(
    labels: str | os.PathLike[str],
    *,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    horizon: float = 1.0,
    max_false_per_min: float | str = 1.0,
    folds: int = 5,
    search: Mapping[str, tuple[float, float]] | Iterable[str] = (),
    trials: int = 50,
    name: str = "calibrated",
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Calibration:
    """Find the thresholds that announce labelled collisions best, as `dlgmd calibrate` does.

    Parameters
    ----------
    labels, horizon, max_false_per_min, jobs, progress
        As in `evaluate`.
    set, config, model, formulation, param, engine
        The model to start from, as in `run`.
    folds : int
        Number of folds of the cross-validation over videos.
    search : mapping of str to (float, float), or iterable of str
        Also search parameters in these ranges, both ends included: ``{"sigma_i": (1, 5)}`` or
        ``["sigma_i=1:5"]``.
    trials : int
        With `search`: number of trials, earlier ones in `out` included.
    name, out, overwrite
        Write the preset to ``out/name.yaml``, for ``config=``; an earlier one only if `overwrite`.
        The trials are in ``out/trials.db``: the same call continues them.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Calibration
        `params` are the parameters found, and `preset` is the text of the file. `scores` says how
        well they do, also on videos that they were not chosen on. `run` and `evaluate` take `setup`
        as a model, with the width and the rate that it is made for.

    Raises
    ------
    ResultError
        If the labels cannot be read, or fewer than two videos have a collision.
    ParameterError, SourceError, OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `evaluate`.

    Examples
    --------
    >>> found = calibrate("flights/labels.csv", set=9, out="best")  # doctest: +SKIP
    >>> run("flight.mp4", config="best/calibrated.yaml")  # doctest: +SKIP
    """
    if options.get("normalise") == "sequence":
        raise ParameterError("", "--normalise sequence leaves no threshold to calibrate")
    if not name.strip(". ") or Path(name).name != name:
        raise ParameterError("", f"--name: {printable(name)!r} is not the name of a file")
    setup = choose(set, config, model, param, formulation, engine)
    shared = input_options(setup, options)
    rules = calibration.Rules(
        **rules_of(horizon, max_false_per_min), folds=_FOLDS.check(folds, "--folds")
    )
    n_trials = _TRIALS.check(trials, "--trials")
    if isinstance(search, Mapping):
        search = [f"{key}={low}:{high}" for key, (low, high) in search.items()]
    ranges = dict(parse_range(text, setup.params) for text in search)
    labels = Path(labels)
    if out is not None:
        store.refuse_existing(Path(out) / f"{name}.yaml", overwrite=overwrite)
    cases = read_cases(labels)
    of_kind(cases, rules.max_false_kind)  # raises if there are none
    with ExitStack() as opened:
        folder = Path(opened.enter_context(TemporaryDirectory()) if out is None else out)
        opened.enter_context(store.locked(folder))
        made = None
        if ranges:
            asked = _asked(cases, setup, shared, rules)
            made = Search(folder, ranges, asked, overwrite=overwrite)
            opened.callback(made.close)
        evaluation = scored(labels, cases, run_cases(cases, [setup], shared, jobs), progress)
        _require_collisions(evaluation.cases, labels)
        experiment = Experiment(setup, shared, rules, tuple(evaluation.cases), jobs)
        tried = [] if made is None else _trials(experiment, made, n_trials, progress)
        found = calibration.calibrate(experiment, evaluation.signals(setup.label), tried)
        searched = ", ".join(f"{key} = {one.text()}" for key, one in ranges.items())
        about = f"; searched in {counted(n_trials, 'trial')}: {searched}" if ranges else ""
        preset = _preset(found, experiment, labels.name, about)
        named = replace(found.setup, label=name)
        found = replace(found, setup=named, preset=preset, failed=evaluation.failed)
        if out is not None:
            store.write_text(folder / f"{name}.yaml", preset)
    return found


def _asked(
    cases: Sequence[Case], setup: Setup, options: InputOptions, rules: calibration.Rules
) -> dict[str, Any]:
    """What trials depend on beside the ranges."""
    return {
        "cases": [[case.name, case.kind, *case.collisions] for case in cases],
        "rules": asdict(rules),
        "model": setup.settings(),
        "options": options.to_record(),
    }


def _trials(
    experiment: Experiment, search: Search, n_trials: int, progress: Progress
) -> list[Trial]:
    n_done = len(search)
    if n_done:
        _log.info("%d trials are done already.", n_done)
    try:
        with progress("calibrate", n_trials, "trial") as advance:
            for n_done in search.run(n_trials, experiment.setup, experiment.choose):
                advance(n_done)
    except (cancel.Interrupted, KeyboardInterrupt):
        _log.info(
            "%d of %d trials are done; the same command continues from there.", n_done, n_trials
        )
        raise
    trials = search.trials()
    if not trials:
        raise DlgmdError("", "no trial had a valid combination of parameters")
    return trials


def _require_collisions(cases: Sequence[Case], labels: Path) -> None:
    """Raise ResultError if fewer than two videos have a collision; log a warning if few have."""
    n_with = sum(bool(case.collisions) for case in cases)
    if n_with < 2:
        why = f"{counted(n_with, 'video')} with a collision; calibration needs at least 2"
        raise ResultError(str(labels), why)
    if n_with < 20:
        _log.warning("only %d videos have a collision; the calibration may not generalise", n_with)


def _preset(found: Calibration, experiment: Experiment, labels: str, about: str) -> str:
    """The YAML of the preset; comments say on what it was calibrated, and how well it does."""
    scores, rules = found.scores, experiment.rules
    held = scores["held_out"][ALL]
    n_folds = max(experiment.folds) + 1
    kinds = [(kind, own) for kind, own in scores["held_out"].items() if kind != ALL]
    limited = rules.max_false_kind
    where = f" on videos of the kind {printable(limited)}" if limited else ""
    lines = [
        f"Calibrated by dlgmd {__version__} on {printable(labels)}: "
        f"{counted(int(held['videos']), 'video')}, "
        f"{counted(int(held['collisions']), 'collision')}, {held['minutes']:.2f} minutes.",
        f"Highest recall with at most {rules.max_false_per_min:g} false alarms per minute{where}.",
        f"Alarms up to {rules.horizon_s:g} s before a collision are hits.",
        f"Calibrated: kappa (LGMD: t_mp) and n_sp{about}.",
        f"Held out ({n_folds} folds): {_sentence(held)}.",
        *(f"Held out, {printable(kind)}: {_sentence(own)}." for kind, own in kinds),
        f"On the same videos: {_sentence(scores['same_videos'][ALL])}.",
    ]
    settings = found.setup.settings()
    kept = {k: v for k, v in experiment.options.to_record().items() if k in _KEPT}
    document = {**settings, **({"options": kept} if kept else {})}
    return yaml_text(document, "".join(f"# {line}\n" for line in lines))


def _sentence(scores: Scores) -> str:
    """The measures with their 95 % intervals, in words."""
    recall, rate, lead, auc = (interval_text(scores, name) for name in SHOWN)
    return f"recall {recall}, {rate} false alarms per minute, median lead {lead} s, AUC {auc}"
