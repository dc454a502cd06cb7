"""`dlgmd evaluate`: score how well alarms announce labelled collisions."""

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
    warn_undrawn,
)
from dlgmd_cli.commands.options import (
    FiniteRange,
    Output,
    engine_option,
    formulation_option,
    input_options,
    jobs_option,
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
    from dlgmd_cli.lab.evaluation.cases import Case, Evaluation
    from dlgmd_cli.lab.evaluation.report import Report
    from dlgmd_cli.results.store import Write
    from dlgmd_cli.runs.setup import Setup
    from dlgmd_cli.video.options import InputOptions

RECORD = "evaluate.yaml"
FIGURES = ("trade-off", "leads")

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
        help="An alarm up to S seconds before a collision is a hit.",
    ),
    click.option(
        "--max-false-per-min",
        type=FiniteRange(min=0),
        default=1.0,
        show_default=True,
        metavar="F",
        help="False alarms per minute that the best threshold may have.",
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
    """Score how well alarms announce labelled collisions.

    LABELS.csv has the columns video (a path relative to the file), collision_frame (empty: no
    collision) and, optionally, target. A video with several collisions has several rows.

    An alarm counts at the frame that raises it. Within --horizon before a collision, it is a hit,
    and its lead is the time left. Up to 3 frames after a collision, it is at contact: neither a hit
    nor false. Later alarms are ignored until --horizon before the video's next collision. Every
    other alarm is false; up to 2 s before a collision it is also counted as early. Rates per minute
    refer to the time before the first collision, or to the whole video.

    Each model is scored at its default threshold and at the best one: the threshold with the
    highest recall at no more than --max-false-per-min. The best threshold is chosen on the same
    videos, so its scores are optimistic. Intervals are 95 % of 1000 resamples of the videos.

    Writes into OUT evaluate.csv (one row per model, threshold and target), curves.csv (recall and
    false alarms at every threshold), alarms.csv (every alarm and every missed collision), figures
    of the trade-off and of the leads, and evaluate.yaml.
    """
    from dlgmd_cli.lab.evaluation.cases import Evaluation, read_cases
    from dlgmd_cli.lab.evaluation.report import make_report
    from dlgmd_cli.results import store
    from dlgmd_cli.video.options import InputOptions

    if results is not None:
        _refuse_models()
    cases = read_cases(labels_path)
    click.get_current_context().with_resource(store.locked(output.out))
    for name in _names(output):
        store.refuse_existing(output.out / name, overwrite=output.overwrite)
    evaluation = Evaluation(baselines=baselines)
    if results is None:
        failed = run_over(evaluation, cases, *_asked(setups, given, baselines), jobs)
    else:
        from dlgmd_cli.lab.evaluation.cases import stored_results

        failed = _add_all(evaluation, cases, stored_results(results, cases))
    require_some(evaluation, labels_path)
    report = make_report(evaluation, rules["horizon_s"], rules["max_false_per_min"])
    record = {
        "labels": str(labels_path.absolute()),
        **_counts(evaluation, failed),
        **rules,
        "models": [_described(evaluation, label) for label in evaluation.candidates],
        "options": InputOptions(**given).to_record(),
    }
    files = _files(report, evaluation, rules, record, output, width)
    undrawn = store.write_files(output.out, files, record=RECORD)
    warn_undrawn(output.out, undrawn)
    if as_json:
        from dlgmd_cli.lab.evaluation.report import report_json

        models = report_json(report, evaluation.candidates)
        print_json({"result": str(output.out), **_counts(evaluation, failed), "models": models})
    else:
        _show(report, evaluation)
        for name in [name for name in files if name not in undrawn]:
            print_path(output.out / name)
    raise_failed(failed, len(cases))


def _names(output: Output) -> list[str]:
    """The names of the files to write, the record last."""
    figures = [f"evaluate-{kind}.{form}" for kind in FIGURES for form in output.formats]
    return ["evaluate.csv", "curves.csv", "alarms.csv", *figures, RECORD]


def _asked(
    setups: "list[Setup]", given: dict[str, Any], baselines: bool
) -> "tuple[list[Setup], InputOptions]":
    """The models to run, and how videos are read; each model at the size that its file records."""
    from dlgmd_cli.lab.evaluation.cases import with_flow
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.runs.setup import input_options as recorded
    from dlgmd_cli.video.options import InputOptions

    for one in setups:
        create_model(one.params, engine=one.engine)  # raises if its engine is not installed
    options = recorded(setups[0], given) if len(setups) == 1 else InputOptions(**given)
    return with_flow(setups) if baselines else setups, options


def _refuse_models() -> None:
    """Raise UsageError if an option is given that only matters when models are run."""
    context = click.get_current_context()
    asked = {
        *("set_names", "configs", "models", "pairs", "formulation", "engine", "scale", "size"),
        *("fps", "repeats", "input_fps", "decoder", "start", "end", "crop", "mask", "normalise"),
        "jobs",
    }
    for parameter in context.command.params:
        source = context.get_parameter_source(str(parameter.name))
        if parameter.name in asked and source is click.core.ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{parameter.opts[0]} does not work with --results.")


def run_over(
    evaluation: "Evaluation",
    cases: "list[Case]",
    setups: "list[Setup]",
    options: "InputOptions",
    jobs: int | None,
) -> dict[str, str]:
    """Run the models over the videos; returns why videos could not be scored, by name."""
    from dlgmd_cli.lab.evaluation.cases import run_cases
    from dlgmd_cli.threads import n_processors

    labels = [one.label for one in setups]
    n_jobs = max(1, min(jobs or n_processors(), len(cases)))
    found = (
        (case, one if isinstance(one, DlgmdError) else dict(zip(labels, one, strict=True)))
        for case, one in run_cases(cases, setups, options, n_jobs)
    )
    return _add_all(evaluation, cases, found)


def _add_all(
    evaluation: "Evaluation", cases: "list[Case]", found: "Iterator[tuple[Case, Any]]"
) -> dict[str, str]:
    """Add every video in the order of the labels; warns of videos that fail, and returns why."""
    failed, every = {}, {}
    with progress("evaluate", len(cases), "video") as advance:
        for number, (case, results) in enumerate(found, start=1):
            every[case.name] = results
            advance(number)
    for case in cases:
        try:
            if isinstance(every[case.name], DlgmdError):
                raise every[case.name]
            evaluation.add(case, every[case.name])
        except DlgmdError as error:
            failed[case.name] = f"{error.why}. {error.mend}".strip().rstrip(".")
            warn(f"{case.name}: {failed[case.name]}")
    return failed


def require_some(evaluation: "Evaluation", labels_path: Path) -> None:
    """Raise Failed if no video can be scored."""
    if not evaluation.cases:
        raise Failed(f"{labels_path}: no video could be scored.", EXIT_FAILED)


def raise_failed(failed: Mapping[str, str], n_cases: int) -> None:
    """Raise Failed, exit code 1, if some videos could not be scored."""
    if failed:
        raise Failed(
            f"{len(failed)} of {n_cases} videos could not be scored and are left out. Fix or "
            "remove them, then run again.",
            EXIT_FAILED,
        )


def _counts(evaluation: "Evaluation", failed: Mapping[str, str]) -> dict[str, Any]:
    """Numbers of videos, collisions and minutes, and the videos that failed."""
    signals = next(iter(evaluation.candidates.values())).signals.values()
    return {
        "videos": len(evaluation.cases),
        "collisions": sum(len(case.collisions) for case in evaluation.cases),
        "minutes": round(sum(signal.minutes for signal in signals), 3),
        "failed": dict(failed),
    }


def _described(evaluation: "Evaluation", label: str) -> dict[str, Any]:
    """The entry of a candidate in the record."""
    one = evaluation.candidates[label]
    processed = one.record["processed"]
    size = {key: processed[key] for key in ("width", "height", "cells") if key in processed}
    if one.params is None:
        return {"label": label, "n_sp": one.n_sp, **size}
    return {"label": label, "model": one.params.model, **one.params.to_dict(), **size}


def _files(
    report: "Report",
    evaluation: "Evaluation",
    rules: Mapping[str, float],
    record: dict[str, Any],
    output: Output,
    width: Any,
) -> "dict[str, Write]":
    """The function that writes each file, by name."""
    from dlgmd_cli.lab.evaluation import report as tables
    from dlgmd_cli.results.record import record_text
    from dlgmd_cli.results.store import file_of

    text = record_text(record, [])
    horizon_s = rules["horizon_s"]
    files: dict[str, Write] = {
        "evaluate.csv": partial(tables.write_report, report=report),
        "curves.csv": partial(tables.write_curves, report=report, candidates=evaluation.candidates),
        "alarms.csv": partial(
            tables.write_alarms, report=report, evaluation=evaluation, horizon_s=horizon_s
        ),
    }
    if output.formats:
        from dlgmd_cli.plots.style import figure_files

        files |= figure_files(_figures(report, rules, width), output.formats, output.dpi)
    files[RECORD] = file_of(text)
    return files


def _figures(
    report: "Report", rules: Mapping[str, float], width: Any
) -> dict[str, Callable[[], Any]]:
    """The function that draws each figure, by name."""
    from dlgmd_cli.lab.evaluation.report import DEFAULT
    from dlgmd_cli.lab.plots import evaluation as plots

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


def _show(report: "Report", evaluation: "Evaluation") -> None:
    """Print the tables: all videos, then hits and false alarms by target."""
    from dlgmd_cli.lab.evaluation.report import ALL, interval_text

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
        mains = [report.main(label, target).scores for label in evaluation.candidates]
        shown = [f"{one.hits}/{one.collisions}" if one.collisions else "–" for one in mains]
        rates = [one.measures["false_alarms_per_min"].value for one in mains]
        cells = [f"{hits}, {rate:.1f}" for hits, rate in zip(shown, rates, strict=True)]
        lines.append((target, str(mains[0].videos), *cells))
    click.echo("Collisions announced, and false alarms per minute, by target:")
    print_table(("target", "videos", *evaluation.candidates), lines)
