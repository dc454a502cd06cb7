"""`dlgmd calibrate`: find the thresholds with the highest recall, as a preset."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show
from dlgmd_cli.commands.evaluate import allowed_option, labels_argument


@click.command(cls=Command)
@labels_argument
@options.model_in_pixels_options
@options.alarm_option
@options.input_options("fps", "repeats", "input_fps", "fov", "camera_tilt")
@allowed_option
@options.with_default(
    "--folds",
    default=5,
    metavar="K",
    help="Number of folds of the cross-validation over videos.",
)
@options.jobs_option
@options.out_option
@options.overwrite_option
def calibrate(labels_path: Path, **arguments: Any) -> None:
    """Find the threshold with the highest recall.

    \b
    Examples:
      dlgmd calibrate flights/labels.csv               # the preset flight
      dlgmd calibrate flights/labels.csv --set 9       # the paper's set 9
      dlgmd calibrate flights/labels.csv --folds 10    # of the cross-validation

    LABELS.csv and false alarms are as in 'dlgmd evaluate'; recall is the share of the contacts that
    are in time or announced. The command finds the threshold of the alarm's rule with the highest
    recall at no more than --max-false-per-min false alarms. For the rule spikes, it finds κ, the
    half-saturation constant of the normalised MP (for the LGMD: the threshold T_MP), and n_sp, the
    spikes in a row that raise an alarm (1 to 4); for expansion, it finds expansion_alarm; for ttc,
    ttc_alarm. Of thresholds with equal recall, the one with the fewest false alarms is chosen.

    The reported performance is held out: the videos are split into folds, and each fold is scored
    with the best parameters on the other folds. The preset has the best parameters on all videos.

    Writes the preset, OUT/calibrated.yaml, for --config, and the figure OUT/calibrated.png.
    Its comments and the last line of the output name the labels, and say whether the preset is
    better on held-out videos.
    """
    from dlgmd_cli.tasks.calibrate import calibrate as task

    arguments |= {"formats": ("png",)}
    show(task(labels_path, progress=progress, **arguments))
