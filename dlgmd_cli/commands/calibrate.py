"""`dlgmd calibrate`: find the parameters that announce labelled collisions best, as a preset."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.console import Command, print_json, print_path, print_table
from dlgmd_cli.commands.evaluate import labels_argument, raise_failures, rule_options
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

if TYPE_CHECKING:
    from dlgmd_cli.lab.evaluation.calibration import Calibration
    from dlgmd_cli.lab.evaluation.scoring import Scores
    from dlgmd_cli.runs.setup import Setup


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
    from dlgmd_cli.api import calibrate as api

    found = api.calibrate(
        labels_path,
        model=setup,
        **rules,
        folds=folds,
        search=searched,
        trials=n_trials,
        name=name,
        jobs=jobs,
        out=out,
        overwrite=overwrite,
        progress=progress,
        **given,
    )
    path = Path(out) / f"{name}.yaml"
    if as_json:
        facts = {
            "parameters": found.setup.settings(),
            **{key: _json(one) for key, one in found.scores.items()},
            "folds": [{"n_sp": one.n_sp, "excitation": one.threshold} for one in found.choices],
        }
        print_json({"preset": str(path), **facts, "failed": found.failed})
    else:
        _show(found)
        print_path(path)
    raise_failures(found.failed, len(found.experiment.cases))


def _json(scores: "Mapping[str, Scores]") -> dict[str, Any]:
    """The scores of all videos, and of each kind, as JSON values."""
    from dlgmd_cli.lab.evaluation.report import ALL, scores_json

    by_kind = {kind: scores_json(one) for kind, one in scores.items() if kind != ALL}
    return {**scores_json(scores[ALL]), **({"by_kind": by_kind} if by_kind else {})}


def _show(found: "Calibration") -> None:
    from dlgmd_cli.api.calibrate import SHOWN
    from dlgmd_cli.lab.evaluation.report import ALL, interval_text

    experiment = found.experiment
    names = {
        "held_out": f"held out ({max(experiment.folds) + 1} folds)",
        "same_videos": "on the same videos",
        "before": f"before ({experiment.setup.label})",
    }
    rows = [
        (title if kind == ALL else f"  {kind}", *(interval_text(own, name) for name in SHOWN))
        for key, title in names.items()
        for kind, own in found.scores[key].items()
    ]
    print_table(("", "recall", "false/min", "lead s", "AUC"), rows)
    click.echo(f"Found: {', '.join(found.changes()) or 'the same parameters as before'}.")
