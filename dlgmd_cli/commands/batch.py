"""`dlgmd batch`: run models over every video below folders. A failed video does not end it."""

from collections import Counter
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli import cancel
from dlgmd_cli.commands.console import (
    Command,
    Failed,
    print_json,
    print_path,
    print_table,
    say,
)
from dlgmd_cli.commands.options import (
    clips_option,
    complete_file,
    dpi_option,
    engine_option,
    format_option,
    formulation_option,
    input_options,
    jobs_option,
    json_option,
    no_plots_option,
    numeric,
    out_option,
    param_option,
    setup_options,
)
from dlgmd_cli.commands.progress import progress
from dlgmd_cli.errors import printable
from dlgmd_cli.parameters import parse_overrides
from dlgmd_cli.words import counted, frames_text

if TYPE_CHECKING:
    from dlgmd_cli.api.batch import Batch
    from dlgmd_cli.runs.batch import Plan, Row
    from dlgmd_cli.runs.setup import Setup

DONE = "done"
# Longer tables show only the videos that failed.
_MAX_ROWS = 60


def model_setups(
    set_names: tuple[str, ...],
    configs: tuple[Path, ...],
    models: tuple[str, ...],
    pairs: tuple[str, ...],
    formulation: str | None,
    engine: str | None,
) -> "list[Setup]":
    """Every model that the options ask for, each once."""
    from dlgmd_cli.runs.setup import DLGMD, choose

    if set_names or configs:  # these already are D-LGMDs, unless a file names another model
        models = tuple(name for name in models if name != DLGMD)
    chosen = partial(
        choose, overrides=parse_overrides(pairs), formulation=formulation, engine=engine
    )
    return [
        *(chosen(set=name) for name in dict.fromkeys(set_names)),
        *(chosen(config=path) for path in dict.fromkeys(configs)),
        *(chosen(model=name) for name in dict.fromkeys(models)),
    ] or [chosen()]


@click.command(
    cls=Command,
    epilog="Example: dlgmd batch flights --set 7 --set 9 --jobs 4 --timeout 600 --out results",
)
@click.argument(
    "folders", metavar="FOLDER...", nargs=-1, required=True, shell_complete=complete_file
)
@setup_options(model_setups, param_option, formulation_option, engine_option)
@input_options
@out_option
@format_option
@dpi_option
@no_plots_option
@clips_option
@click.option("--overwrite", is_flag=True, help="Replace results of other parameters or inputs.")
@click.option("--force", is_flag=True, help="Also process videos that were done before.")
@click.option(
    "--exclude",
    multiple=True,
    metavar="PATTERN",
    help="Leave out files and folders of this name or path, such as 'raw*'; repeatable.",
)
@click.option("--dry-run", is_flag=True, help="List what would be processed, and write nothing.")
@jobs_option
@click.option(
    "--timeout",
    "timeout_s",
    type=numeric(low_open=True),
    metavar="S",
    help="Give up on a video after S seconds.  [default: no limit]",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Use a Dask cluster: tcp://HOST:PORT, or a scheduler file; needs dlgmd[cluster].",
)
@json_option
def batch(
    folders: tuple[str, ...],
    setups: "list[Setup]",
    given: dict[str, Any],
    out: str,
    formats: tuple[str, ...],
    dpi: int,
    no_plots: bool,
    clips: Path | None,
    overwrite: bool,
    force: bool,
    exclude: tuple[str, ...],
    dry_run: bool,
    jobs: int | None,
    timeout_s: float | None,
    scheduler: str | None,
    as_json: bool,
) -> None:
    """Run models over every video in folders.

    A FOLDER may also be a video, or the URL of either, such as s3://bucket/flights. OUT may be a
    URL, too. A folder that holds only pictures, eight or more of one size, counts as a video. A
    .npy array counts only if it is named itself.

    Writes into OUT what 'dlgmd run' writes, one folder per video, in a tree like that of the
    videos, and summary.csv, one row per video. Several models share one decoding; each has a tree
    and a summary of its own: OUT/set7, OUT/set9 and so on.

    A video that fails does not stop the others. Videos that were done before with the same
    parameters are skipped: after an interruption, the same command continues. --clips writes those
    of the videos that are processed; --force processes all.
    """
    from dlgmd_cli.api import batch as api

    found = api.batch(
        folders,
        setups,
        out=out,
        formats=() if no_plots else formats,
        dpi=dpi,
        overwrite=overwrite,
        force=force,
        clips=clips,
        exclude=exclude,
        dry_run=dry_run,
        jobs=jobs,
        timeout=timeout_s,
        scheduler=scheduler,
        progress=progress,
        **given,
    )
    if dry_run:
        _show_plan(found, as_json=as_json)
        return
    statuses = found.statuses
    _show(found.plan, statuses, found.labels, complete=found.complete, as_json=as_json)
    if not found.complete or cancel.requested():
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    _raise_failures(found, statuses, out)


def _show(
    plan: "Plan", statuses: dict[str, str], labels: list[str], *, complete: bool, as_json: bool
) -> None:
    """Print tables, the paths of the summaries and the counts, or all as JSON."""
    paths = [str(summary.path) for summary in plan.summaries]
    if as_json:
        facts = {
            "summary": paths[0] if len(paths) == 1 else dict(zip(labels, paths, strict=True)),
            "complete": complete,
            "videos": len(statuses),
            "already_done": len(statuses) - len(plan.tasks),
            "status": {DONE: 0, **Counter(status for status in statuses.values() if status)},
            "warnings": _warnings(plan),
        }
        print_json(facts)
    else:
        for label, summary in zip(labels, plan.summaries, strict=True):
            _print_rows(summary.rows, label if len(labels) > 1 else "video")
        for path in paths:
            print_path(path)
        click.echo(_counts(plan, statuses))
    if not complete:
        n_done = sum(status == DONE for status in statuses.values())
        say(
            f"Interrupted. {n_done} of {len(statuses)} videos are done; the same command continues "
            "from there."
        )


def _warnings(plan: "Plan") -> dict[str, list[str]]:
    """The warnings about each video, from all models; only videos that have some."""
    found: dict[str, list[str]] = {}
    for summary in plan.summaries:
        for video, row in summary.rows.items():
            lines = [*found.get(video, []), *row.record.get("warnings", [])]
            found[video] = list(dict.fromkeys(lines))
    return {video: lines for video, lines in sorted(found.items()) if lines}


def _counts(plan: "Plan", statuses: dict[str, str]) -> str:
    """One line with the number of videos, in total and by status."""
    n_before = len(statuses) - len(plan.tasks)
    by_status = Counter(statuses.values())
    done = f"{by_status.pop(DONE, 0)} done"
    parts = [f"{done} ({n_before} before)" if n_before else done]
    n_open = by_status.pop("", 0)
    parts += [f"{n} {status}" for status, n in sorted(by_status.items())]
    parts += [f"{n_open} not processed"] if n_open else []
    alarmed = {
        video
        for summary in plan.summaries
        for video, row in summary.rows.items()
        if row.record.get("summary", {}).get("alarms")
    }
    n_warned = len(_warnings(plan))
    parts += [f"{len(alarmed)} with alarms"] + ([f"{n_warned} with warnings"] if n_warned else [])
    return f"{counted(len(statuses), 'video')}: {', '.join(parts)}."


def _show_plan(found: "Batch", *, as_json: bool) -> None:
    """Print what a batch would do, for --dry-run."""
    from dlgmd_cli.results import store

    wanted = {task.video.name: task.wanted for task in found.plan.tasks}
    videos = {
        video.name: {
            found.labels[number]: str(store.place(found.job.places[number]) / video.folder)
            for number in wanted.get(video.name, ())
        }
        for video in found.found.videos
    }
    if as_json:
        print_json({"dry_run": True, "videos": len(videos), "to_do": videos})
        return
    rows = [
        (name, ", ".join(folders.values()) or "– (done before)") for name, folders in videos.items()
    ]
    print_table(("video", "would be written to"), rows)
    n_open = len(wanted)
    click.echo(
        f"{counted(len(videos), 'video')}: {n_open} to process, {len(videos) - n_open} done before."
        " Nothing was written."
    )


def _print_rows(rows: "Mapping[str, Row]", title: str) -> None:
    shown = sorted(rows.items())
    if len(shown) > _MAX_ROWS:
        shown = [(name, row) for name, row in shown if row.status != DONE]
    header = (title, "status", "frames", "peak MP", "spikes", "alarms", "first alarm")
    if shown:
        print_table(header, [(name, row.status, *_cells(row)) for name, row in shown])


def _cells(row: "Row") -> tuple[str, ...]:
    summary: dict[str, Any] = row.record.get("summary", {})
    if not summary:
        return ("–",) * 5
    peak = "–" if summary["mp_max"] is None else f"{summary['mp_max']:.6g}"
    first = "–"
    if None not in (summary["first_alarm_frame"], summary["first_alarm_time_s"]):
        first = "frame {first_alarm_frame}, {first_alarm_time_s:.3f} s".format(**summary)
        first += f", {side}" if (side := summary.get("first_alarm_side")) else ""
    counts = (str(summary["spikes"]), str(summary["alarms"]))
    return (frames_text(row.record), peak, *counts, first)


def _raise_failures(found: "Batch", statuses: dict[str, str], out: str) -> None:
    """Raise Failed, exit code 1, if a video, a folder or a figure failed."""
    n_total, n_failed = len(statuses), sum(status != DONE for status in statuses.values())
    if n_failed:
        n_done, those = n_total - n_failed, "it" if n_total == 1 else f"those {n_failed}"
        kept = "result is" if n_done == 1 else f"{n_done} results are"
        rest = f"; the other {kept} in {printable(out)}" if n_done else ""
        raise Failed(
            f"{n_failed} of {counted(n_total, 'video')} failed{rest}. Fix or remove "
            f"{'that one' if n_failed == 1 < n_total else those}, then run again."
        )
    if found.found.faults:
        raise Failed(
            f"some folders could not be read; the results of the others are in {printable(out)}. "
            "Check their access rights, then run again."
        )
    if any(row.lacks_figures for summary in found.plan.summaries for row in summary.rows.values()):
        raise Failed(f"some figures could not be drawn; all tables are in {printable(out)}.")
