"""`dlgmd evaluate`: how well alarms announce labelled collisions."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli.commands.batch import model_setups
from dlgmd_cli.commands.console import (
    EXIT_FAILED,
    Command,
    Failed,
    print_json,
    print_path,
    print_table,
    warn,
)
from dlgmd_cli.commands.options import (
    FiniteRange,
    Output,
    engine_option,
    formulation_option,
    input_options,
    json_option,
    option_group,
    output_options,
    param_option,
    setup_options,
    width_option,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import DlgmdError

if TYPE_CHECKING:
    from dlgmd_cli.evaluation.footage import Case, Field
    from dlgmd_cli.evaluation.report import Report
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.run import Setup
    from dlgmd_cli.video.frames import InputOptions

RECORD = "evaluate.yaml"

jobs_option = click.option(
    "--jobs",
    type=click.IntRange(1, 512),
    metavar="N",
    help="Videos at a time, each in a process of its own.  [default: all processors]",
)
rule_options = option_group(
    "rules",
    dict,
    click.option(
        "--horizon",
        "horizon_s",
        type=FiniteRange(min=0, min_open=True, max=3600),
        default=1.0,
        show_default=True,
        metavar="S",
        help="An alarm so many seconds before a collision announces it.",
    ),
    click.option(
        "--max-false-per-min",
        type=FiniteRange(min=0),
        default=1.0,
        show_default=True,
        metavar="F",
        help="False alarms a minute that the best threshold may raise.",
    ),
)


@click.command(
    cls=Command,
    epilog="Example: dlgmd evaluate flights/labels.csv --set 3 --set 9 --model lgmd --out results",
)
@click.argument("labels_path", metavar="LABELS.csv", type=click.Path(path_type=Path))
@setup_options(model_setups, param_option, formulation_option, engine_option)
@input_options
@click.option(
    "--results",
    type=click.Path(path_type=Path),
    metavar="DIR",
    help="Score what 'dlgmd batch' wrote there, instead of running models.",
)
@rule_options
@click.option(
    "--baselines/--no-baselines",
    default=True,
    show_default=True,
    help="Also score ΣP alone and the divergence of optical flow.",
)
@jobs_option
@width_option
@output_options
@json_option
def evaluate(
    labels_path: Path,
    setups: "list[Setup]",
    given: dict[str, Any],
    results: Path | None,
    rules: dict[str, float],
    baselines: bool,
    jobs: int | None,
    width: Any,
    output: Output,
    as_json: bool,
) -> None:
    """Score how well the alarms of models announce labelled collisions.

    LABELS.csv has the columns video (relative to it), collision_frame (empty: no collision) and,
    if wanted, target; a video with several collisions has several rows.

    An alarm counts when it is raised. Within the horizon before a collision it is a hit, and its
    lead is the time left. Up to 3 frames after the collision it is at contact, neither a hit nor
    false; after that it is ignored until the horizon before the video's next collision. Every
    other alarm is false; within 2 s before the collision it is also early. Minutes run to the
    first collision, or to the end of the video.

    Each model is scored at its default threshold and at the best one, that of the greatest recall
    with at most --max-false-per-min; the best one is chosen on the same videos, so that it is
    optimistic. Baselines have only that. Intervals are 95 % of 1000 resamples of the videos.

    Writes into OUT evaluate.csv (one row per model, threshold and target), curves.csv (recall and
    false alarms at all thresholds), alarms.csv (every alarm: hit, contact, false or early; and
    every missed collision), figures of the trade-off and of the leads, and evaluate.yaml.
    """
    from dlgmd_cli.evaluation.footage import Field, read_cases
    from dlgmd_cli.evaluation.report import evaluated
    from dlgmd_cli.results import store

    if results is not None:
        _refuse_models()
    cases = read_cases(labels_path)
    for name in _names(output):
        store.refuse_existing(output.out / name, overwrite=output.overwrite)
    field = Field(baselines=baselines)
    if results is None:
        failed = run_over(field, cases, *_asked(setups, given, baselines), jobs)
    else:
        failed = _read_over(field, cases, results)
    require_some(field, labels_path)
    report = evaluated(field, rules["horizon_s"], rules["max_false_per_min"])
    record = {
        "labels": str(labels_path.absolute()),
        **_counts(field, failed),
        **rules,
        "models": [_described(field, label) for label in field.candidates],
        "options": given_record(given),
    }
    files = _files(report, field, rules, record, output, width)
    with store.appearing(*(output.out / name for name in files)) as temporary:
        for path, write in zip(temporary, files.values(), strict=True):
            write(path)
    if as_json:
        from dlgmd_cli.evaluation.report import as_json as facts

        models = facts(report, field.candidates)
        print_json({"result": str(output.out), **_counts(field, failed), "models": models})
    else:
        _show(report, field)
        for name in files:
            print_path(output.out / name)
    raise_failed(failed, len(cases))


def _names(output: Output) -> list[str]:
    """The files that are written, the record last."""
    figures = [f"evaluate-{kind}.{form}" for kind in _FIGURES for form in output.formats]
    return ["evaluate.csv", "curves.csv", "alarms.csv", *figures, RECORD]


_FIGURES = ("trade-off", "leads")


def _asked(
    setups: "list[Setup]", given: dict[str, Any], baselines: bool
) -> "tuple[list[Setup], InputOptions]":
    """What is run, and how the videos are read: each model at the size that its file records."""
    from dlgmd_cli.evaluation.footage import with_flow
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.runs.run import input_options as recorded
    from dlgmd_cli.video.frames import InputOptions

    for one in setups:
        create_model(one.params, engine=one.engine)  # or its engine is missing
    options = recorded(setups[0], given) if len(setups) == 1 else InputOptions(**given)
    return with_flow(setups) if baselines else setups, options


def _refuse_models() -> None:
    """Raise a usage error if a model or how to read videos is given beside --results."""
    context = click.get_current_context()
    asked = {
        *("set_names", "configs", "models", "pairs", "formulation", "engine", "scale", "size"),
        *("fps", "repeats", "input_fps", "decoder", "start", "end", "normalise", "jobs"),
    }
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if parameter.name in asked and source is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{parameter.opts[0]} does not work with --results.")


def run_over(
    field: "Field",
    cases: "list[Case]",
    setups: "list[Setup]",
    options: "InputOptions",
    jobs: int | None,
) -> dict[str, str]:
    """Run the models over the videos; why a video could not be scored, by its name."""
    from dlgmd_cli.evaluation.footage import computed
    from dlgmd_cli.threads import n_processors

    labels = [one.label for one in setups]
    n_jobs = max(1, min(jobs or n_processors(), len(cases)))
    found = (
        (case, one if isinstance(one, DlgmdError) else dict(zip(labels, one, strict=True)))
        for case, one in computed(cases, setups, options, n_jobs)
    )
    return _take(field, cases, found)


def _read_over(field: "Field", cases: "list[Case]", folder: Path) -> dict[str, str]:
    """Read what a batch wrote of the videos; why a video could not be scored, by its name."""
    from dlgmd_cli.evaluation.footage import stored

    return _take(field, cases, stored(folder, cases))


def _take(
    field: "Field", cases: "list[Case]", found: "Iterator[tuple[Case, Any]]"
) -> dict[str, str]:
    """Add every video to the field, in the order of the labels, and warn of those that fail."""
    failed, every = {}, {}
    with progress("evaluate", len(cases), "video") as advance:
        for number, (case, results) in enumerate(found, start=1):
            every[case.name] = results
            advance(number)
    for case in cases:
        try:
            if isinstance(every[case.name], DlgmdError):
                raise every[case.name]
            field.add(case, every[case.name])
        except DlgmdError as error:
            failed[case.name] = f"{error.why}. {error.mend}".strip().rstrip(".")
            warn(f"{case.name}: {failed[case.name]}")
    return failed


def require_some(field: "Field", labels_path: Path) -> None:
    """Raise if no video can be scored."""
    if not field.cases:
        raise Failed(f"{labels_path}: no video could be scored.", EXIT_FAILED)


def raise_failed(failed: Mapping[str, str], n_cases: int) -> None:
    """Raise what makes the exit code 1 if some videos could not be scored."""
    if failed:
        raise Failed(
            f"{len(failed)} of {n_cases} videos could not be scored and are left out. Fix or "
            "remove them, then run again.",
            EXIT_FAILED,
        )


def _counts(field: "Field", failed: Mapping[str, str]) -> dict[str, Any]:
    """What the labels come to."""
    courses = next(iter(field.candidates.values())).courses.values()
    return {
        "videos": len(field.cases),
        "collisions": sum(len(case.collisions) for case in field.cases),
        "minutes": round(sum(course.minutes for course in courses), 3),
        "failed": dict(failed),
    }


def given_record(given: Mapping[str, Any]) -> dict[str, Any]:
    """The options of the input that were given, as a record holds them."""
    from dlgmd_cli.video.frames import InputOptions

    return InputOptions(**given).to_record()


def _described(field: "Field", label: str) -> dict[str, Any]:
    """What the record says of a candidate."""
    one = field.candidates[label]
    processed = one.record["processed"]
    size = {key: processed[key] for key in ("width", "height", "cells") if key in processed}
    if one.params is None:
        return {"label": label, "n_sp": one.n_sp, **size}
    return {"label": label, "model": one.params.model, **one.params.to_dict(), **size}


def _files(
    report: "Report",
    field: "Field",
    rules: Mapping[str, float],
    record: dict[str, Any],
    output: Output,
    width: Any,
) -> "dict[str, Write]":
    """What writes each file, by its name."""
    from dlgmd_cli.evaluation import report as tables
    from dlgmd_cli.results.record import record_text

    text = record_text(record, [])
    horizon_s = rules["horizon_s"]
    files: dict[str, Write] = {
        "evaluate.csv": partial(tables.write_report, report=report),
        "curves.csv": partial(tables.write_curves, report=report, candidates=field.candidates),
        "alarms.csv": partial(tables.write_alarms, report=report, field=field, horizon_s=horizon_s),
    }
    if output.formats:
        from dlgmd_cli.plots.style import figure_files

        files |= figure_files(_figures(report, rules, width), output.formats, output.dpi)
    files[RECORD] = lambda path: path.write_text(text, encoding="utf-8")
    return files


def _figures(
    report: "Report", rules: Mapping[str, float], width: Any
) -> dict[str, Callable[[], Any]]:
    """What draws each figure."""
    from dlgmd_cli.evaluation.report import DEFAULT
    from dlgmd_cli.plots import evaluation as plots

    curves = {label: (one.false_alarms_per_min, one.recall) for label, one in report.curves.items()}
    points = {}
    for label in curves:
        row = report.row(label, DEFAULT)
        if row is not None:
            rate, recall = (row.scores.measures[n] for n in ("false_alarms_per_min", "recall"))
            points[label] = (rate.value, recall.value)
    most = rules["max_false_per_min"]
    return {
        "evaluate-trade-off": partial(plots.trade_off, curves, points, most, width),
        "evaluate-leads": partial(plots.leads, report.leads_s, rules["horizon_s"], width),
    }


def _show(report: "Report", field: "Field") -> None:
    """The tables on stdout: all videos, then the recall of each target."""
    from dlgmd_cli.evaluation.report import ALL, interval_text

    header = ("model", "threshold", "recall", "false/min", "precision", "lead s", "AUC", "contact")
    rows = []
    for row in (one for one in report.rows if one.target == ALL):
        scores = row.scores
        names = ("recall", "false_alarms_per_min", "precision", "lead_s", "auc")
        cells = [interval_text(scores.measures[name]) for name in names]
        label = row.candidate.label
        rows.append((label, f"{row.at} {row.threshold:.4g}", *cells, str(scores.at_contact)))
    print_table(header, rows)
    counts = next(row.scores for row in report.rows)
    click.echo(
        f"{counts.videos} videos, {counts.collisions} collisions, {counts.minutes:.2f} minutes "
        "before contact or the end."
    )
    targets = list(dict.fromkeys(row.target for row in report.rows))[1:]
    if not targets:
        return
    lines = []
    for target in targets:
        mains = [report.main(label, target).scores for label in field.candidates]
        shown = [f"{one.hits}/{one.collisions}" if one.collisions else "–" for one in mains]
        rates = [one.measures["false_alarms_per_min"].value for one in mains]
        cells = [f"{hits}, {rate:.1f}" for hits, rate in zip(shown, rates, strict=True)]
        lines.append((target, str(mains[0].videos), *cells))
    click.echo("Collisions announced, and false alarms per minute, by target:")
    print_table(("target", "videos", *field.candidates), lines)
