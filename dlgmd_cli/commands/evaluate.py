"""`dlgmd evaluate`: score how well alarms announce labelled collisions."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.batch import model_setups
from dlgmd_cli.commands.console import (
    Command,
    Failed,
    print_json,
    print_path,
    print_table,
)
from dlgmd_cli.commands.options import (
    Output,
    engine_option,
    formulation_option,
    input_options,
    jobs_option,
    option_group,
    param_option,
    report_options,
    setup_options,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.words import counted, threshold_text

if TYPE_CHECKING:
    from dlgmd_cli.lab.evaluation.report import Report
    from dlgmd_cli.runs.setup import Setup

# Options that only matter when models are run, beside those of the input.
_OF_MODELS = {"set_names", "configs", "models", "pairs", "formulation", "engine", "jobs"}

labels_argument = click.argument(
    "labels_path", metavar="LABELS.csv", type=click.Path(path_type=Path)
)


rule_options = option_group(
    "rules",
    dict,
    click.option(
        "--horizon",
        type=float,
        default=1.0,
        show_default=True,
        metavar="S",
        help="An alarm up to S seconds before a collision is a hit.",
    ),
    click.option(
        "--max-false-per-min",
        default="1",
        show_default=True,
        metavar="F[:KIND]",
        help="False alarms per minute that the best threshold may have; on videos of a kind, if "
        "one is given, as 1:real.",
    ),
)


@click.command(
    cls=Command,
    epilog="Example: dlgmd evaluate flights/labels.csv --set 3 --set 9 --model lgmd --out results",
)
@labels_argument
@setup_options(model_setups, param_option, formulation_option, engine_option)
@input_options
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Score the results of 'dlgmd batch' in DIR instead of running models.",
)
@rule_options
@click.option(
    "--baselines/--no-baselines",
    default=True,
    show_default=True,
    help="Also score two baselines: the sum of P, and the divergence of optical flow.",
)
@jobs_option
@report_options
def evaluate(
    labels_path: Path,
    setups: "list[Setup]",
    given: dict[str, Any],
    results: Path | None,
    rules: dict[str, Any],
    baselines: bool,
    jobs: int | None,
    output: Output,
) -> None:
    """Score how well alarms announce labelled collisions.

    LABELS.csv has the columns video (a path relative to the file), collision_frame (empty: no
    collision) and, optionally, target, kind (such as rendered or real) and manner. A video with
    several collisions has several rows.

    An alarm counts at the frame that raises it. Within --horizon before a collision, it is a hit,
    and its lead is the time left. Up to 3 frames after a collision, it is at contact: neither a hit
    nor false. Later alarms are ignored until --horizon before the video's next collision. Every
    other alarm is false; up to 2 s before a collision it is also counted as early. Rates per minute
    refer to the time before the first collision, or to the whole video.

    Each model is scored at its default threshold and at the best one: the threshold with the
    highest recall at no more than --max-false-per-min. The best threshold is chosen on the same
    videos, so its scores are optimistic. Intervals are 95 % of 1000 resamples of the videos; that
    of the false alarms is widened to the exact Poisson interval, which none at all has, too.

    Writes into OUT evaluate.csv (one row per model and threshold for all videos, and for each
    target, kind and manner), curves.csv (recall and false alarms at every threshold, for all videos
    and for each kind), alarms.csv (every alarm and every missed collision of all videos; not the
    columns of 'dlgmd run'), figures of the trade-off and of the leads, and evaluate.yaml.
    """
    from dlgmd_cli.api import evaluate as api

    if results is not None:
        _refuse(_OF_MODELS | given.keys())
    report = api.evaluate(
        labels_path,
        setups if results is None else None,
        results=results,
        **rules,
        baselines=baselines,
        jobs=jobs if results is None else None,
        out=output.out,
        formats=output.formats,
        dpi=output.dpi,
        width=output.width,
        overwrite=output.overwrite,
        progress=progress,
        **(given if results is None else {}),
    )
    if output.as_json:
        facts = {"result": str(output.out), **report.counts(), "models": report.to_json()}
        print_json(facts)
    else:
        _show(report)
        for name in api.file_names(output.formats):
            if (output.out / name).exists():  # a figure that cannot be drawn does not
                print_path(output.out / name)
    raise_failures(report.evaluation.failed, len(report.evaluation.cases))


def _refuse(names: set[str]) -> None:
    """Raise UsageError if one of these options is given."""
    context = click.get_current_context()
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        is_given = source is click.core.ParameterSource.COMMANDLINE
        if parameter.name in names and is_given:
            raise click.UsageError(f"{parameter.opts[0]} does not work with --results.")


def raise_failures(failed: "Mapping[str, str]", n_scored: int) -> None:
    """Raise Failed, exit code 1, if some videos could not be scored."""
    if failed:
        raise Failed(
            f"{len(failed)} of {len(failed) + n_scored} videos could not be scored and are left "
            "out. Fix or remove them, then run again."
        )


def _show(report: "Report") -> None:
    """Print the tables: all videos and each kind, then hits and false alarms by group."""
    from dlgmd_cli.lab.evaluation.report import ALL, interval_text

    header = ("threshold", "recall", "false/min", "precision", "lead s", "AUC", "contact")
    names = ("recall", "false_alarms_per_min", "precision", "lead_s", "auc")
    kinds = report.names("kind")
    rows = [
        (
            row["model"],
            *((row["kind"],) if kinds else ()),
            f"{row['at']} {threshold_text(row['threshold'])}",
            *(interval_text(row, name) for name in names),
            str(row["at_contact"]),
        )
        for row in report.rows
        if row["target"] == row["manner"] == ALL
    ]
    print_table(("model", *(("kind",) if kinds else ()), *header), rows)
    first = report.rows[0]
    click.echo(
        f"{counted(first['videos'], 'video')}, {counted(first['collisions'], 'collision')}, "
        f"{first['minutes']:.2f} minutes before contact or the end."
    )
    for word in ("target", "manner"):
        _show_groups(report, word)


def _show_groups(report: "Report", word: str) -> None:
    """Print the hits and false alarms by target or manner, if there are any."""
    lines = []
    for name in report.names(word):
        mains = [report.main(label, **{word: name}) for label in report.curves]
        cells = [
            f"{'{hits}/{collisions}'.format(**row) if row['collisions'] else '–'}, "
            f"{row['false_alarms_per_min']:.1f}"
            for row in mains
        ]
        lines.append((name, str(mains[0]["videos"]), *cells))
    if lines:
        click.echo(f"Collisions announced, and false alarms per minute, by {word}:")
        print_table((word, "videos", *report.curves), lines)
