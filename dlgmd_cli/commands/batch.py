"""`dlgmd batch`: run models over every video below folders. A failed video does not end it."""

import os
from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from dlgmd_cli import cancel
from dlgmd_cli.commands.console import (
    Command,
    Failed,
    detail,
    note,
    print_json,
    print_path,
    print_table,
    say,
    tell,
    warn,
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
from dlgmd_cli.errors import ParameterError, SourceError, printable
from dlgmd_cli.names import numbered
from dlgmd_cli.parameters import parse_overrides
from dlgmd_cli.words import counted, frames_text

if TYPE_CHECKING:
    from dlgmd_cli.pool import Outcome
    from dlgmd_cli.runs.batch import Job, Plan, Row, Task
    from dlgmd_cli.runs.find import Found
    from dlgmd_cli.runs.setup import Setup
    from dlgmd_cli.video.options import InputOptions

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
    """Every model that the options ask for, each once; its label is a valid name of a folder."""
    from dlgmd_cli.runs.setup import DLGMD, choose

    if set_names or configs:  # these already are D-LGMDs, unless a file names another model
        models = tuple(name for name in models if name != DLGMD)
    chosen = partial(
        choose, overrides=parse_overrides(pairs), formulation=formulation, engine=engine
    )
    setups = [
        *(chosen(set=name) for name in dict.fromkeys(set_names)),
        *(chosen(config=path) for path in dict.fromkeys(configs)),
        *(chosen(model=name) for name in dict.fromkeys(models)),
    ] or [chosen()]
    labels = [_as_folder(one.label) for one in setups]
    if len({label.casefold() for label in labels}) < len(labels):
        labels = numbered([label.lower() for label in labels])
    return [replace(one, label=label) for one, label in zip(setups, labels, strict=True)]


def _as_folder(label: str) -> str:
    """A label as a valid name of a folder."""
    name = label.replace("/", "_").replace("\\", "_")
    return name if name.strip(". ") and not name.startswith(".") else f"model{name}"


def _check_scheduler(scheduler: str | None, jobs: int | None, timeout_s: float | None) -> None:
    """Raise if a scheduler's address is not valid, or is given with options of local processes."""
    if scheduler is None:
        return
    for option, value in (("--jobs", jobs), ("--timeout", timeout_s)):
        if value is not None:
            raise click.UsageError(f"{option} does not work with --scheduler. Leave it out.")
    from dlgmd_cli.runs.dask import address_of

    address_of(scheduler)


def _outcomes(
    job: "Job",
    tasks: "list[Task]",
    n_jobs: int | None,
    timeout_s: float | None,
    scheduler: str | None,
) -> "Iterator[tuple[Task, Outcome]]":
    """Run the tasks in local processes or on a cluster; yields each with its outcome as it ends."""
    from dlgmd_cli import pool
    from dlgmd_cli.results import store
    from dlgmd_cli.runs import dask
    from dlgmd_cli.runs.batch import run_video
    from dlgmd_cli.threads import n_processors

    if scheduler is None:
        # With fewer videos than processors, each video uses several of them.
        n_jobs = max(1, min(n_jobs or n_processors(), len(tasks)))
        return pool.run_tasks(partial(run_video, job), tasks, n_jobs, timeout_s=timeout_s)
    places = [one if store.is_url(one) else os.path.abspath(one) for one in job.places]
    function = partial(run_video, replace(job, places=tuple(places), scratch=None))
    local = [Path(one) for one in places if not store.is_url(one)]
    folders = [local[0].parent if len(places) > 1 else local[0]] if local else []
    return dask.run_tasks(function, tasks, scheduler, folders=folders)


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
    URL, too. A folder that holds only pictures, eight or more of one size, counts as a video.

    Writes into OUT what 'dlgmd run' writes, one folder per video, in a tree like that of the
    videos, and summary.csv, one row per video. Several models share one decoding; each has a tree
    and a summary of its own: OUT/set7, OUT/set9 and so on.

    A video that fails does not stop the others. Videos that were done before with the same
    parameters are skipped: after an interruption, the same command continues. --clips writes those
    of the videos that are processed; --force processes all.
    """
    from tempfile import TemporaryDirectory

    from dlgmd_cli.results import store
    from dlgmd_cli.runs.batch import Job

    _check_scheduler(scheduler, jobs, timeout_s)
    options, labels = _options(setups, given), [one.label for one in setups]
    places = [str(store.place(out) / label) for label in labels] if len(labels) > 1 else [out]
    found = _find(folders, [out, *([] if clips is None else [str(clips)])], exclude)
    formats = () if no_plots else tuple(dict.fromkeys(formats))
    job = Job(tuple(setups), tuple(places), options, formats, dpi, overwrite or force)
    job = replace(job, clips=None if clips is None else os.path.abspath(clips))
    if dry_run:
        _show_plan(found, _plan(found, job, force), job, labels, as_json=as_json)
        return
    with store.locked(store.place(out)), ExitStack() as stack:
        if any(store.is_url(video.path) for video in found.videos):
            scratch = stack.enter_context(TemporaryDirectory(prefix="dlgmd-"))
            job = replace(job, scratch=scratch)
        plan = _plan(found, job, force)
        outcomes = _outcomes(job, plan.tasks, jobs, timeout_s, scheduler)
        complete = _process(plan, outcomes, labels)
        statuses = {video.name: _status(plan, video.name) for video in found.videos}
        _show(plan, statuses, labels, complete=complete, as_json=as_json)
    if not complete or cancel.requested():
        raise click.exceptions.Exit(cancel.EXIT_INTERRUPTED)
    _raise_failures(found, plan, statuses, out)


def _options(setups: "list[Setup]", given: dict[str, Any]) -> "InputOptions":
    """How every video is read: by the options given, otherwise by those that configs record."""
    from dlgmd_cli.models.base import create_model
    from dlgmd_cli.runs.setup import input_options as recorded

    every = [recorded(one, given) for one in setups]
    for one, options in zip(setups, every, strict=True):
        create_model(one.params, engine=one.engine)  # raises if its engine is not installed
        if options != every[0]:
            raise ParameterError(
                one.origin,
                "its recorded options differ from those of the other models",
                "Give them on the command line, or run this model alone.",
            )
    return every[0]


def _find(folders: tuple[str, ...], outs: list[str], exclude: tuple[str, ...]) -> "Found":
    """Find the videos, but not below `outs`, and tell the user what is left out."""
    from dlgmd_cli.results.store import is_url
    from dlgmd_cli.runs.find import find_videos

    found = find_videos(folders, [Path(out) for out in outs if not is_url(out)], exclude)
    for remark in found.remarks:
        note(remark)
    for fault in found.faults:
        warn(f"{fault}; its videos are left out")
    if not found.videos:
        mend = "Give folders with .mp4, .avi, .mkv and the like, or with pictures of one size."
        raise SourceError(", ".join(folders), "there is no video", mend)
    return found


def _plan(found: "Found", job: "Job", force: bool) -> "Plan":
    from dlgmd_cli.runs.batch import plan

    made = plan(found.videos, job, force=force)
    n_all = len(found.videos)
    n_before = n_all - len(made.tasks)
    if n_before:
        are = "is" if n_all == 1 else "are"
        tell(f"{n_before} of {counted(n_all, 'video')} {are} done already.")
    if made.n_other_version:
        kept = counted(made.n_other_version, "result")
        warn(f"kept {kept} of another version of dlgmd; --force processes all videos again")
    return made


def _process(plan: "Plan", outcomes: "Iterator[Any]", labels: list[str]) -> bool:
    """Run all tasks with a progress bar and warnings; False if the user interrupted it."""
    from dlgmd_cli.runs.batch import record_outcomes

    n_ended = n_failed = 0
    try:
        with progress("batch", len(plan.tasks), "video") as advance:
            for task, rows in record_outcomes(plan, outcomes):
                failures = _failures(rows, labels)
                warnings = [
                    text for row in rows.values() for text in row.record.get("warnings", [])
                ]
                for line in dict.fromkeys([*failures, *warnings]):
                    warn(f"{task.video.name}: {line.rstrip('.')}")
                for number, row in rows.items():
                    detail(f"{task.video.name}, {labels[number]}: {row.status}, {row.wall_s} s")
                n_ended, n_failed = n_ended + 1, n_failed + bool(failures)
                advance(n_ended, f"batch, {n_failed} failed")
    except (cancel.Interrupted, KeyboardInterrupt):
        return False
    return True


def _failures(rows: "Mapping[int, Row]", labels: list[str]) -> list[str]:
    """The reasons why a video failed, with the models' labels if they failed differently."""
    reasons: dict[str, list[str]] = {}
    for number, row in rows.items():
        if row.status != DONE:
            reasons.setdefault(f"{row.status}: {row.error}", []).append(labels[number])
    return [
        reason if len(failed) == len(rows) else f"{', '.join(failed)}: {reason}"
        for reason, failed in reasons.items()
    ]


def _status(plan: "Plan", video: str) -> str:
    """The status of a video over all models: the first that is not done; empty if one is open."""
    rows = [summary.rows.get(video) for summary in plan.summaries]
    if None in rows:
        return ""
    return next((row.status for row in rows if row and row.status != DONE), DONE)


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


def _show_plan(
    found: "Found", plan: "Plan", job: "Job", labels: list[str], *, as_json: bool
) -> None:
    """Print what a batch would do, for --dry-run."""
    from dlgmd_cli.results import store

    wanted = {task.video.name: task.wanted for task in plan.tasks}
    videos = {
        video.name: {
            labels[number]: str(store.place(job.places[number]) / video.folder)
            for number in wanted.get(video.name, ())
        }
        for video in found.videos
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


def _raise_failures(found: "Found", plan: "Plan", statuses: dict[str, str], out: str) -> None:
    """Raise Failed, exit code 1, if a video, a folder or a figure failed."""
    n_total, n_failed = len(statuses), sum(status != DONE for status in statuses.values())
    if n_failed:
        n_done, those = n_total - n_failed, "it" if n_total == 1 else f"those {n_failed}"
        kept = f"{counted(n_done, 'result')} {'is' if n_done == 1 else 'are'}"
        rest = f"; the other {kept} in {printable(out)}" if n_done else ""
        raise Failed(
            f"{n_failed} of {counted(n_total, 'video')} failed{rest}. Fix or remove "
            f"{'that one' if n_failed == 1 < n_total else those}, then run again."
        )
    if found.faults:
        raise Failed(
            f"some folders could not be read; the results of the others are in {printable(out)}. "
            "Check their access rights, then run again."
        )
    if any(row.lacks_figures for summary in plan.summaries for row in summary.rows.values()):
        raise Failed(f"some figures could not be drawn; all tables are in {printable(out)}.")
