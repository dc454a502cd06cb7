"""`dlgmd evaluate`: score alarms against labelled contacts."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.batch import model_setups
from dlgmd_cli.commands.compare import label_option, variant_option, with_variants
from dlgmd_cli.commands.console import Command, progress, refuse_given, show
from dlgmd_cli.parameters.facts import Value

# Options that need a run of the models (as all options of the input do), refused with --results.
_OF_MODELS = {"set_names", "configs", "models", "pairs", "jobs"}
_OF_MODELS |= {"variants", "labels", "alarm", "threshold"}


def _no_folder(ctx: click.Context, param: click.Parameter, value: Path) -> Path:
    """Callback: raises BadParameter for a folder."""
    if value.is_dir():
        meant = f"For results, write 'dlgmd evaluate LABELS.csv --results {value}'."
        if (value / "annotations.json").is_file():
            meant = f"Write 'dlgmd evaluate {value / 'annotations.json'}'."
        why = f"{str(value)!r} is a folder, not a table of labels. {meant}"
        raise click.BadParameter(why, ctx, param)
    return value


labels_argument = click.argument(
    "labels_path", metavar="LABELS.csv", type=click.Path(path_type=Path), callback=_no_folder
)


allowed_option = options.with_default(
    "--max-false-per-min",
    type=options.numeric(low=0),
    default=1.0,
    metavar="F",
    help="False alarms per minute that the best threshold may have.",
)


def _setups(
    *,
    variants: tuple[tuple[str, dict[str, Value]], ...] = (),
    labels: tuple[str, ...] = (),
    pairs: tuple[str, ...] = (),
    alarm: str | None = None,
    physical: bool = False,
    **more: Any,
) -> "list[options.Setup]":
    """Every model with its variants; labels include the parameters of --param and --alarm."""
    from dlgmd_cli.tasks.call import with_keys, with_rule

    param = with_rule(options.overrides(pairs, physical=physical), alarm)
    setups = with_keys(model_setups(pairs=pairs, alarm=alarm, physical=physical, **more), param)
    return with_variants(setups, variants, labels)


@click.command(cls=Command)
@labels_argument
@options.setup_options(
    _setups,
    *(options.param_option, options.physical_option),
    *(options.alarm_option, options.threshold_option),
    *(variant_option, label_option),
)
@options.input_options(
    "fps", "repeats", "input_fps", "normalise", "fov", "camera_tilt", argument="given"
)
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Score the results of 'dlgmd batch' in DIR instead of running models.",
)
@allowed_option
@click.option(
    "--speed-m-s",
    metavar="M/S",
    help="Speed at every contact, in place of the column speed_m_s.",
)
@options.stopping_options
@options.with_default(
    "--baselines/--no-baselines",
    default=True,
    help="Also score two baselines: the sum of P, and the expansion rate of corners tracked by "
    "Lucas and Kanade. They get the frames of the preset flight, whatever the models; with "
    "--results, the sum of P is that of the first model.",
)
@options.jobs_option
@options.output_options
def evaluate(
    labels_path: Path,
    model: "list[options.Setup]",
    given: dict[str, Any],
    results: Path | None,
    jobs: int | None,
    **arguments: Any,
) -> None:
    """Score alarms against labelled contacts.

    \b
    Examples:
      dlgmd evaluate flights/labels.csv                     # the preset flight
      dlgmd evaluate flights/labels.csv --set 3 --set 9     # two models
      dlgmd evaluate flights/labels.csv --results out       # results of a batch
      dlgmd evaluate lgmd/annotations.json --model all      # the LGMD benchmark

    LABELS.csv has the columns video (a path relative to the file), collision_frame (empty: no
    contact) and, optionally, approach_start (a frame), speed_m_s, brake (as --brake), fov,
    camera_tilt, target, kind (such as rendered or real) and manner (the scenario). A video with
    several contacts has several rows.

    An alarm counts at its onset, its first frame. A contact with a speed is in time if its alarm
    leaves time for a stop (by --brake and --react) and begins at most 1.5 s before the last moment
    for that stop; else the contact is too late, too early or missed. A table has the contacts in
    time for a stock ArduCopter (1.7 to 1.9 s before the contact at 1 to 3 m/s), for one with
    PSC_JERK_XY 20 (0.6 to 0.7 s), and for a tilt of 25 degrees (0.4 to 0.7 s). A contact without a
    speed is announced if an alarm begins between t0 - 1 s and the contact, where t0 is the later of
    approach_start and the contact - 2 s; else the contact is missed.

    Every other onset is a false alarm, also an onset that is too early; onsets up to 1 s after a
    contact are not. A false alarm counts once more for each further 2 s that it lasts. If
    truth/NAME.csv is beside LABELS.csv (columns frame, time_s, distance_m, closing_m_s), an onset
    within 1 s of two frames with a closing speed of at least 0.45/s times the distance is
    justified, not false.

    Each model is scored at its own threshold and at the best threshold, which has the most contacts
    in time or announced at no more than --max-false-per-min ("none" if all have none). The best
    threshold is chosen on the same videos: its scores are optimistic. Intervals (95 %) are by
    resampling whole videos. Differences between models are tested video by video, with Holm's
    correction.

    Writes into OUT evaluate.csv (one row per model and threshold for all videos, and for each
    target, kind and manner), curves.csv (recall and false alarms at every threshold, for all videos
    and for each kind), alarms.csv (every onset and every missed contact; its columns are not those
    of 'dlgmd run'), ttc.csv (errors of the estimated times to contact), auc.csv and roc.csv (how
    well the signal separates frames before a contact from others, and videos with a contact from
    others), figures of the trade-off (from ten contacts on), of the lead times, of the times to
    contact and of the ROC, and evaluate.yaml.

    annotations.json, of the LGMD benchmark, has for each video, by its path, "ground_truth": a
    value for each frame, 0.5 to 1. Every frame gets a response at its full size. The score SA of
    each class, the means and the rank are printed, and written as benchmark.csv, sequences.csv,
    responses.json, auc.csv, roc.csv, two figures and benchmark.yaml.
    """
    from dlgmd_cli.tasks.evaluate.evaluate import evaluate as task

    of_models = {"model": model, "jobs": jobs, **given}
    if labels_path.suffix.lower() == ".json":
        refuse_given({"alarm", "threshold", "baselines"}, "has no effect on annotations")
    if results is not None:
        refuse_given({*_OF_MODELS, *given}, "does not work with --results")
        of_models = {}
    arguments |= {"results": results, **of_models}
    show(task(labels_path, progress=progress, **arguments))
