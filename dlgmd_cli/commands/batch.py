"""`dlgmd batch`: run models over every video below folders, in spite of videos that fail."""

from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.console import Command, progress, show


def model_setups(
    set_names: tuple[str, ...],
    configs: tuple[str, ...],
    models: tuple[str, ...],
    pairs: tuple[str, ...] = (),
    alarm: str | None = None,
    threshold: float | None = None,
    speed_m_s: str | None = None,
    brake: str | None = None,
    *,
    physical: bool = False,
) -> "list[options.Setup]":
    """All models that the options name, each once."""
    from dlgmd_cli.tasks.call import DLGMD, at_threshold, choose, requiring_rules, with_rule

    if set_names or configs:  # sets and files are D-LGMDs already, or a file names another model
        models = tuple(name for name in models if name != DLGMD)
    named = options.named_models(set_names, configs, models) or [None]
    param = with_rule(options.overrides(pairs, physical=physical), alarm)
    setups = requiring_rules([choose(name, param) for name in named], param)
    return [at_threshold(setup, threshold, speed_m_s, brake) for setup in setups]


@click.command(cls=Command)
@click.argument(
    "folders", metavar="FOLDER...", nargs=-1, required=True, shell_complete=options.complete_file
)
@options.setup_options(
    model_setups,
    *(options.param_option, options.physical_option),
    *(options.alarm_option, options.threshold_option),
    *(options.speed_option, options.brake_option),
)
@options.input_options(
    *("size", "fps", "crop", "mask", "repeats", "input_fps", "decoder", "normalise"),
    *("fov", "camera_tilt"),
)
@options.run_output_options
@options.clips_option
@click.option("--force", is_flag=True, help="Also process videos that were done before.")
@click.option("--dry-run", is_flag=True, help="List what would be processed, and write nothing.")
@options.jobs_option
@click.option(
    "--timeout",
    type=options.numeric(low_open=True),
    metavar="S",
    help="Give up on a video after S seconds.  [default: no limit]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Use a Dask cluster: tcp://HOST:PORT, or a scheduler file; needs the extra cluster.",
)
def batch(folders: tuple[str, ...], **arguments: Any) -> None:
    """Run models over every video in folders.

    \b
    Examples:
      dlgmd batch flights                           # every video below flights/
      dlgmd batch flights --set 7 --set 9 --jobs 4  # two models, four processes
      dlgmd batch flights --dry-run                 # only list what would run

    A FOLDER may also be a video, or the URL of either, such as s3://bucket/flights. OUT may be a
    URL, too. A folder that holds only images, eight or more of one size, counts as a video. A
    .npy array counts only if it is named itself. Hidden files and folders are left out.

    Writes into OUT the files of 'dlgmd run', one folder per video, in a tree like the videos' tree,
    and summary.csv, one row per video. Several models share one decoding; each model has a tree and
    a summary of its own: OUT/set7, OUT/set9 and so on.

    A video that fails does not stop the others. Videos that were done before with the same
    parameters are skipped: after an interruption, the same command continues. --clips writes the
    clips of the processed videos; --force processes all videos.
    """
    from dlgmd_cli.tasks.batch.batch import batch as task

    show(task(folders, progress=progress, **arguments))
