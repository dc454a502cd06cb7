"""`dlgmd evaluate`: score alarms against labelled collisions."""

from pathlib import Path
from typing import Any

import click

from dlgmd_cli.commands import options
from dlgmd_cli.commands.batch import model_setups
from dlgmd_cli.commands.compare import label_option, labelled, variant_option, variants_of
from dlgmd_cli.commands.console import Command, progress, show
from dlgmd_cli.parameters.facts import Value

# Options that only matter when models are run, beside those of the input.
_OF_MODELS = {"set_names", "configs", "models", "pairs", "jobs"}
_OF_MODELS |= {"variants", "labels", "alarm"}

labels_argument = click.argument(
    "labels_path", metavar="LABELS.csv", type=click.Path(path_type=Path)
)


rule_options = options.option_group(
    "",
    dict,
    options.with_default(
        "--horizon",
        default=1.0,
        metavar="S",
        help="An alarm up to S seconds before a collision is a hit.",
    ),
    options.with_default(
        "--max-false-per-min",
        default="1",
        metavar="F[:KIND]",
        help="False alarms per minute that the best threshold may have; on videos of a kind, if "
        "one is given, as 1:real.",
    ),
)


def _setups(
    *,
    variants: tuple[tuple[str, dict[str, Value]], ...] = (),
    labels: tuple[str, ...] = (),
    pairs: tuple[str, ...] = (),
    **more: Any,
) -> "list[options.Setup]":
    """Every model with its variants; single parameters show in their names."""
    from dlgmd_cli.tasks.call import with_keys

    setups = with_keys(model_setups(pairs=pairs, **more), options.overrides(pairs))
    every = [each for s in setups for each in (s, *variants_of(s, variants, setups))]
    return labelled(every, labels)


@click.command(cls=Command)
@labels_argument
@options.setup_options(
    _setups, options.param_option, options.alarm_option, variant_option, label_option
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
@rule_options
@options.stopping_options
@click.option(
    "--agile/--stabilised",
    default=None,
    help="Whether the drones of rendered flights tilt at once, or are stabilised.  [default: as "
    "each is]",
)
@click.option(
    "--speed-m-s",
    metavar="M/S|true",
    help="Also score the rules ttc and expansion with the threshold that a stop from this speed "
    "needs, and 0.2 s; with 'true', from that of each rendered flight at each frame.",
)
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
    """Score alarms against labelled collisions.

    \b
    Examples:
      dlgmd evaluate flights/labels.csv                     # the preset flight
      dlgmd evaluate flights/labels.csv --set 3 --set 9     # two models
      dlgmd evaluate flights/labels.csv --results out       # results of a batch

    LABELS.csv has the columns video (a path relative to the file), collision_frame (empty: no
    collision) and, optionally, target, kind (such as rendered or real) and manner (the scenario). A
    video with several collisions has several rows.

    An alarm counts at the frame that raises it. Within --horizon before a collision, it is a hit:
    the collision is detected, and the lead time is the time to contact. Up to 3 frames after a
    collision, it is a late detection: neither a hit nor false. Later alarms are ignored until
    --horizon before the video's next collision. Every other alarm is false; up to 2 s before a
    collision it is also counted as early. Rates per minute refer to the time before the first
    collision, or to the whole video.

    Each model is scored at its default threshold and at the best one: the threshold with the
    highest recall at no more than --max-false-per-min. With the rule spikes, it is that of the
    normalised MP; with expansion, a rate; with ttc, a time to contact. The best threshold is chosen
    on the same videos, so its scores are optimistic. Where no threshold detects a collision, it is
    "none". Intervals are 95 % of 1000 resamples of the videos; those of recall, precision and false
    alarms are widened to the exact ones (Clopper-Pearson and Poisson), which 0 of 13 has, too.

    In flights of 'dlgmd synth', whose record is beside the video, stops are simulated: once an
    alarm is on within --horizon before the collision, or for a real obstacle, the pilot reacts and
    the drone brakes, straight on. It is saved if it stops before it touches anything. A stop is for
    a real obstacle if the drone would have collided within 1.5 s on its current course; its alarm
    is not false. An alarm that is neither when it is raised asks for a false stop, and the flight
    goes on; if it is still on later, the drone brakes then.

    Writes into OUT evaluate.csv (one row per model and threshold for all videos, and for each
    target, kind, manner and speed), curves.csv (recall and false alarms at every threshold, for all
    videos and for each kind), windows.csv (the scores that make the AUC), alarms.csv (every alarm
    and every missed collision of all videos; not the columns of 'dlgmd run'), ttc.csv (errors of
    the estimated times to contact), figures of the trade-off, of the AUC, of the lead times, of the
    stops and of the times to contact, and evaluate.yaml.
    """
    from dlgmd_cli.tasks.evaluate.evaluate import evaluate as task

    of_models = {"model": model, "jobs": jobs, **given}
    if results is not None:
        _refuse(_OF_MODELS | given.keys())
        of_models = {}
    arguments |= {"results": results, **of_models}
    show(task(labels_path, progress=progress, **arguments))


def _refuse(names: set[str]) -> None:
    """Raise UsageError if one of these options is given."""
    context = click.get_current_context()
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if parameter.name in names and source is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{parameter.opts[0]} does not work with --results.")
