"""`dlgmd calibrate`: find the parameters that announce labelled collisions best, as a preset."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.console import Command
from dlgmd_cli.commands.evaluate import labels_argument, rule_options
from dlgmd_cli.commands.options import (
    complete_key,
    input_options,
    jobs_option,
    json_option,
    model_options,
    out_option,
    overwrite_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.commands.show import show

if TYPE_CHECKING:
    from dlgmd_cli.tasks.setup import Setup


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
    type=int,
    default=5,
    show_default=True,
    metavar="K",
    help="Number of folds of the cross-validation over videos.",
)
@click.option(
    "--search",
    multiple=True,
    metavar="KEY=LOW:HIGH",
    shell_complete=complete_key,
    help="Also search a parameter, or width_px; repeatable; needs dlgmd[calibrate].",
)
@click.option(
    "--trials",
    type=int,
    default=50,
    show_default=True,
    metavar="N",
    help="With --search: number of trials, earlier ones included.",
)
@click.option(
    "--name", default="calibrated", show_default=True, metavar="NAME", help="Name of the preset."
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
    as_json: bool,
    **asked: Any,
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

    Writes the preset, OUT/NAME.yaml, for --config, and the figure OUT/NAME.png. Comments and the
    last line say what it was calibrated on, and whether it is better, held out.
    """
    from dlgmd_cli.tasks import calibrate as task

    asked |= {"model": setup, "formats": ("png",), **rules}
    show(task.calibrate(labels_path, progress=progress, **asked, **given), as_json=as_json)
