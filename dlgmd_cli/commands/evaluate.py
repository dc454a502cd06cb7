"""`dlgmd evaluate`: score how well alarms announce labelled collisions."""

import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.checks import Spec
from dlgmd_cli.commands.batch import model_setups
from dlgmd_cli.commands.console import (
    Command,
    Failed,
    print_json,
    print_path,
    print_table,
    warn,
    warn_undrawn,
)
from dlgmd_cli.commands.options import (
    Output,
    Parsed,
    engine_option,
    formulation_option,
    input_options,
    jobs_option,
    numeric,
    option_group,
    param_option,
    report_options,
    setup_options,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.words import counted, threshold_text

if TYPE_CHECKING:
    from dlgmd_cli.lab.evaluation.cases import Candidate, Case, Evaluation, Results
    from dlgmd_cli.lab.evaluation.report import Report
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.setup import Setup

RECORD = "evaluate.yaml"
FIGURES = ("trade-off", "leads")
FALSE_PER_MIN = Spec(float, 0, math.inf)
# Options that only matter when models are run.
_NOT_WITH_RESULTS = {
    *("set_names", "configs", "models", "pairs", "formulation", "engine", "scale", "size", "fps"),
    *("repeats", "input_fps", "decoder", "start", "end", "crop", "mask", "normalise", "jobs"),
}

labels_argument = click.argument(
    "labels_path", metavar="LABELS.csv", type=click.Path(path_type=Path)
)


def _rate(text: str) -> tuple[float, str | None]:
    """`1` -> (1.0, None), and `1:real` -> (1.0, "real")."""
    rate, _, kind = text.partition(":")
    return FALSE_PER_MIN.parse(rate, ""), kind.strip() or None


def _rules(horizon_s: float, max_false_per_min: tuple[float, str | None]) -> dict[str, Any]:
    rate, kind = max_false_per_min
    return {"horizon_s": horizon_s, "max_false_per_min": rate, "max_false_kind": kind}


rule_options = option_group(
    "rules",
    _rules,
    click.option(
        "--horizon",
        "horizon_s",
        type=numeric(low_open=True, high=3600),
        default=1.0,
        show_default=True,
        metavar="S",
        help="An alarm up to S seconds before a collision is a hit.",
    ),
    click.option(
        "--max-false-per-min",
        type=Parsed("F[:KIND]", _rate),
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
    from dlgmd_cli.lab.evaluation.cases import of_kind, read_cases, stored_results
    from dlgmd_cli.lab.evaluation.report import make_report
    from dlgmd_cli.results import store
    from dlgmd_cli.results.record import record_text

    if results is not None:
        _refuse_models()
    cases = read_cases(labels_path)
    of_kind(cases, rules["max_false_kind"])  # raises if there are none
    click.get_current_context().with_resource(store.locked(output.out))
    names = [f"evaluate-{kind}.{form}" for kind in FIGURES for form in output.formats]
    for name in ("evaluate.csv", "curves.csv", "alarms.csv", *names, RECORD):
        store.refuse_existing(output.out / name, overwrite=output.overwrite)
    found = (
        _computed(cases, setups, given, jobs, baselines=baselines)
        if results is None
        else stored_results(results, cases)
    )
    with scored(labels_path, cases, found, baselines=baselines) as evaluation:
        report = make_report(evaluation, **rules)
        candidates = evaluation.candidates.values()
        record = {
            "labels": str(labels_path.absolute()),
            **report.counts(),
            **rules,
            "models": [_described(one) for one in candidates],
            "options": next(iter(candidates)).record.get("options", {}),
        }
        files = report.tables()
        if output.formats:
            files |= _figures(report, rules, output)
        files[RECORD] = store.file_of(record_text(record, []))
        undrawn = store.write_files(output.out, files, record=RECORD)
        warn_undrawn(output.out, undrawn)
        if output.as_json:
            facts = {"result": str(output.out), **report.counts(), "models": report.to_json()}
            print_json(facts)
        else:
            _show(report)
            for name in [name for name in files if name not in undrawn]:
                print_path(output.out / name)


def _computed(
    cases: "list[Case]",
    setups: "list[Setup]",
    given: dict[str, Any],
    jobs: int | None,
    *,
    baselines: bool,
) -> "Iterator[tuple[Case, Results]]":
    """Run the models over the videos, each model at the size that its file records."""
    from dlgmd_cli.lab.evaluation.cases import run_cases, with_flow
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.runs.setup import input_options as recorded
    from dlgmd_cli.video.options import InputOptions

    for one in setups:
        create_model(one.params, engine=one.engine)  # raises if its engine is not installed
    options = recorded(setups[0], given) if len(setups) == 1 else InputOptions(**given)
    return run_cases(cases, with_flow(setups) if baselines else setups, options, jobs)


def _refuse_models() -> None:
    """Raise UsageError if an option is given that only matters when models are run."""
    context = click.get_current_context()
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        is_given = source is click.core.ParameterSource.COMMANDLINE
        if parameter.name in _NOT_WITH_RESULTS and is_given:
            raise click.UsageError(f"{parameter.opts[0]} does not work with --results.")


@contextmanager
def scored(
    labels_path: Path,
    cases: "list[Case]",
    found: "Iterator[tuple[Case, Results]]",
    *,
    baselines: bool = False,
) -> "Iterator[Evaluation]":
    """The models and the videos, which are computed with a progress bar; warns of those that fail.

    Raises Failed at once if no video can be scored, and at the end if some cannot.
    """
    from dlgmd_cli.lab.evaluation.cases import Evaluation

    by_name = {}
    with progress("evaluate", len(cases), "video") as advance:
        for number, (case, results) in enumerate(found, start=1):
            by_name[case.name] = results
            advance(number)
    evaluation = Evaluation(baselines=baselines)
    for case in cases:
        evaluation.add(case, by_name[case.name])
    for name, why in evaluation.failed.items():
        warn(f"{name}: {why}")
    if not evaluation.cases:
        raise Failed(f"{labels_path}: no video could be scored.")
    yield evaluation
    if evaluation.failed:
        raise Failed(
            f"{len(evaluation.failed)} of {len(cases)} videos could not be scored and are left "
            "out. Fix or remove them, then run again."
        )


def _described(one: "Candidate") -> dict[str, Any]:
    processed = one.record["processed"]
    size = {key: processed[key] for key in ("width", "height", "cells") if key in processed}
    if one.params is None:
        return {"label": one.label, "n_sp": one.n_sp, **size}
    return {"label": one.label, "model": one.params.model, **one.params.to_dict(), **size}


def _figures(report: "Report", rules: dict[str, Any], output: Output) -> "Mapping[str, Write]":
    from dlgmd_cli.lab.evaluation.report import ALL, DEFAULT
    from dlgmd_cli.lab.plots.evaluation import leads, trade_off
    from dlgmd_cli.plots.style import figure_files

    curves, points = {}, {}
    for label, own in report.curves.items():
        for kind, one in own.items():
            title = label if kind == ALL else f"{label}, {kind}"
            if not report.main(label, kind=kind)["collisions"] and kind != ALL:
                continue  # nothing to announce
            curves[title] = one.false_alarms_per_min, one.recall
            row = report.row(label, DEFAULT, kind=kind)
            if row is not None:
                points[title] = row["false_alarms_per_min"], row["recall"]
    most, horizon_s, width = rules["max_false_per_min"], rules["horizon_s"], output.width
    figures = {
        "evaluate-trade-off": partial(trade_off, curves, points, most, width),
        "evaluate-leads": partial(leads, report.leads_s, horizon_s, width),
    }
    return figure_files(figures, output.formats, output.dpi)


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
