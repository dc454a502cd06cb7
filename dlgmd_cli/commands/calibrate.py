"""`dlgmd calibrate`: find the parameters that announce labelled collisions best, as a preset."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli import __version__, cancel
from dlgmd_cli.commands.console import (
    Command,
    Failed,
    print_json,
    print_path,
    print_table,
    say,
    tell,
    warn,
)
from dlgmd_cli.commands.evaluate import labels_argument, rule_options, scored
from dlgmd_cli.commands.options import (
    complete_key,
    input_options,
    jobs_option,
    json_option,
    model_options,
    numeric,
    out_option,
    overwrite_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import printable
from dlgmd_cli.words import counted

if TYPE_CHECKING:
    from dlgmd_cli.lab.evaluation.calibration import Calibration, Experiment, Trial
    from dlgmd_cli.lab.evaluation.cases import Case
    from dlgmd_cli.lab.evaluation.scoring import Scores
    from dlgmd_cli.lab.evaluation.search import Range, Search
    from dlgmd_cli.runs.setup import Setup

_SHOWN = ("recall", "false_alarms_per_min", "lead_s", "auc")
# Options that a preset keeps: how a frame is prepared, not which part of a video is read.
_KEPT = ("scale", "size", "fps", "repeats")


@click.command(
    cls=Command,
    epilog="Example: dlgmd calibrate flights/labels.csv --set 3 --search sigma_i=1:5 --out best",
)
@labels_argument
@model_options
@input_options
@rule_options
@click.option(
    "--folds",
    type=numeric(int, 2, 1000),
    default=5,
    show_default=True,
    metavar="K",
    help="Number of folds of the cross-validation over videos.",
)
@click.option(
    "--search",
    "searched",
    multiple=True,
    metavar="KEY=LOW:HIGH",
    shell_complete=complete_key,
    help="Also search a parameter, or width_px; repeatable; needs dlgmd[calibrate].",
)
@click.option(
    "--trials",
    "n_trials",
    type=numeric(int, 1, 1_000_000),
    default=50,
    show_default=True,
    metavar="N",
    help="With --search: number of trials, earlier ones included.",
)
@click.option(
    "--name",
    default="calibrated",
    show_default=True,
    metavar="NAME",
    help="Name of the preset.",
)
@jobs_option
@out_option
@overwrite_option
@json_option
def calibrate(
    labels_path: Path,
    setup: "Setup",
    given: dict[str, Any],
    rules: dict[str, Any],
    folds: int,
    searched: tuple[str, ...],
    n_trials: int,
    name: str,
    jobs: int | None,
    out: str,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Find the thresholds that announce labelled collisions best.

    LABELS.csv and hits are as in 'dlgmd evaluate'. The command finds κ, the mean excitation at
    which the normalised MP is 1/2 (for the LGMD: the threshold T_MP), and n_sp, the spikes in a row
    that raise an alarm (1 to 4), with the highest recall at no more than --max-false-per-min. Ties
    are decided by the fewest false alarms, then by the longest lead.

    The reported performance is held out: the videos are split into folds, and each fold is scored
    with the parameters that do best on the others. The preset has the parameters that do best on
    all videos.

    With --search, Optuna also tries values of other parameters. Every trial runs the model over all
    videos. Trials are kept in OUT/trials.db: after an interruption, the same command continues.

    Writes the preset, OUT/NAME.yaml, for --config. Its comments say what it was calibrated on.
    """
    from dlgmd_cli.lab.evaluation import calibration
    from dlgmd_cli.lab.evaluation.cases import of_kind, read_cases, run_cases
    from dlgmd_cli.lab.evaluation.search import Search, parse_range
    from dlgmd_cli.results import store
    from dlgmd_cli.runs.setup import input_options as recorded

    if given.get("normalise") == "sequence":
        raise click.UsageError("--normalise sequence leaves no threshold to calibrate.")
    if not name.strip(". ") or Path(name).name != name:
        raise click.UsageError(f"--name: {printable(name)!r} is not the name of a file.")
    options = recorded(setup, given)
    wanted = calibration.Rules(**rules, folds=folds)
    ranges = dict(parse_range(text, setup.params) for text in searched)
    path = Path(out) / f"{name}.yaml"
    store.refuse_existing(path, overwrite=overwrite)
    cases = read_cases(labels_path)
    of_kind(cases, wanted.max_false_kind)  # raises if there are none
    with ExitStack() as opened:
        opened.enter_context(store.locked(Path(out)))
        search = None
        if ranges:
            asked = {
                "cases": [[case.name, case.kind, *case.collisions] for case in cases],
                "rules": asdict(wanted),
                "ranges": {key: one.text() for key, one in ranges.items()},
                "model": setup.settings(),
                "options": options.to_record(),
            }
            search = Search(Path(out), ranges, asked, overwrite=overwrite)
            opened.callback(search.close)
        found = run_cases(cases, [setup], options, jobs)
        evaluation = opened.enter_context(scored(labels_path, cases, found))
        _require_collisions(evaluation.cases, labels_path)
        experiment = calibration.Experiment(setup, options, wanted, tuple(evaluation.cases), jobs)
        trials = [] if search is None else _trials(experiment, search, n_trials)
        result = calibration.calibrate(experiment, evaluation.signals(setup.label), trials)
        store.write_text(path, _preset(result, experiment, labels_path.name, ranges, n_trials))
        if as_json:
            choices = [{"n_sp": one.n_sp, "excitation": one.threshold} for one in result.choices]
            found_out = {
                "parameters": result.setup.settings(),
                **{key: _json(one) for key, one in result.scores.items()},
                "folds": choices,
            }
            print_json({"preset": str(path), **found_out, "failed": evaluation.failed})
        else:
            _show(result, experiment)
            print_path(path)


def _trials(experiment: "Experiment", search: "Search", n_trials: int) -> "list[Trial]":
    n_done = len(search)
    if n_done:
        tell(f"{n_done} trials are done already.")
    try:
        with progress("calibrate", n_trials, "trial") as advance:
            for n_done in search.run(n_trials, experiment.setup, experiment.choose):
                advance(n_done)
    except (cancel.Interrupted, KeyboardInterrupt):
        say(f"{n_done} of {n_trials} trials are done; the same command continues from there.")
        raise
    trials = search.trials()
    if not trials:
        raise Failed("no trial had a valid combination of parameters.")
    return trials


def _require_collisions(cases: "Sequence[Case]", labels_path: Path) -> None:
    """Raise Failed if fewer than two videos have a collision; warn if few have."""
    n_with = sum(bool(case.collisions) for case in cases)
    if n_with < 2:
        raise Failed(
            f"{labels_path}: {counted(n_with, 'video')} with a collision; "
            "calibration needs at least 2."
        )
    if n_with < 20:
        warn(f"only {n_with} videos have a collision; the calibration may not generalise")


def _preset(
    found: "Calibration",
    experiment: "Experiment",
    labels: str,
    ranges: "Mapping[str, Range]",
    n_trials: int,
) -> str:
    """The YAML of the preset; comments say on what it was calibrated, and how well it does."""
    from dlgmd_cli.lab.evaluation.report import ALL
    from dlgmd_cli.results.record import yaml_text

    scores, rules = found.scores, experiment.rules
    held = scores["held_out"][ALL]
    searched = ", ".join(f"{key} = {one.text()}" for key, one in ranges.items())
    trials = f"; searched in {n_trials} trials: {searched}" if ranges else ""
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
        f"Calibrated: kappa (LGMD: t_mp) and n_sp{trials}.",
        f"Held out ({n_folds} folds): {_sentence(held)}.",
        *(f"Held out, {printable(kind)}: {_sentence(own)}." for kind, own in kinds),
        f"On the same videos: {_sentence(scores['same_videos'][ALL])}.",
    ]
    settings = found.setup.settings()
    kept = {k: v for k, v in experiment.options.to_record().items() if k in _KEPT}
    document = {**settings, **({"options": kept} if kept else {})}
    return yaml_text(document, "".join(f"# {line}\n" for line in lines))


def _json(scores: "Mapping[str, Scores]") -> dict[str, Any]:
    """The scores of all videos, and of each kind, as JSON values."""
    from dlgmd_cli.lab.evaluation.report import ALL, scores_json

    by_kind = {kind: scores_json(one) for kind, one in scores.items() if kind != ALL}
    return {**scores_json(scores[ALL]), **({"by_kind": by_kind} if by_kind else {})}


def _sentence(scores: "Scores") -> str:
    """The measures with their 95 % intervals, in words."""
    from dlgmd_cli.lab.evaluation.report import interval_text

    recall, rate, lead, auc = (interval_text(scores, name) for name in _SHOWN)
    return f"recall {recall}, {rate} false alarms per minute, median lead {lead} s, AUC {auc}"


def _show(found: "Calibration", experiment: "Experiment") -> None:
    from dlgmd_cli.lab.evaluation.report import ALL, interval_text

    names = {
        "held_out": f"held out ({max(experiment.folds) + 1} folds)",
        "same_videos": "on the same videos",
        "before": f"before ({experiment.setup.label})",
    }
    rows = [
        (title if kind == ALL else f"  {kind}", *(interval_text(own, name) for name in _SHOWN))
        for key, title in names.items()
        for kind, own in found.scores[key].items()
    ]
    print_table(("", "recall", "false/min", "lead s", "AUC"), rows)
    own, before = found.setup.settings(), experiment.setup.settings()
    changed = [f"{key} = {value}" for key, value in own.items() if value != before[key]]
    click.echo(f"Found: {', '.join(changed) or 'the same parameters as before'}.")
