"""Models over every video below folders; a video that fails does not end it."""

import logging
import os
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from dlgmd_cli import cancel, pool
from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.names import numbered
from dlgmd_cli.pool import DONE, Outcome
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Table, table_of
from dlgmd_cli.runs import dask
from dlgmd_cli.runs.batch import (
    COLUMNS,
    Job,
    Plan,
    Row,
    Task,
    clips_place,
    plan,
    record_outcomes,
    row_values,
    run_video,
)
from dlgmd_cli.runs.find import Found, find_videos
from dlgmd_cli.runs.run import Progress, no_progress
from dlgmd_cli.runs.setup import ModelName, Setup, choose_all, input_options
from dlgmd_cli.threads import n_processors
from dlgmd_cli.video.clips import refuse_clips
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.words import counted

_log = logging.getLogger(__name__)

Place = str | os.PathLike[str]


@dataclass(frozen=True, eq=False, repr=False)
class Batch:
    """The outcome of a batch.

    Attributes
    ----------
    labels : list of str
        The models' names.
    found : Found
        The videos, and `faults`: the folders that could not be read.
    plan : Plan
        The `summaries`, one per model, and the `tasks` that were left to do.
    job : Job
        What is common to all videos; `job.places` has the folder of each model.
    complete : bool
        Whether it ran to its end.
    """

    labels: list[str]
    found: Found
    plan: Plan
    job: Job
    complete: bool = True

    def __repr__(self) -> str:
        counts = Counter(status or "not processed" for status in self.statuses.values())
        said = ", ".join(f"{n} {status}" for status, n in counts.items())
        n_videos = counted(len(self.statuses), "video")
        return f"<Batch of {n_videos} with {', '.join(self.labels)}: {said}>"

    @property
    def table(self) -> Table:
        """The rows of every summary.csv, after a column `model`."""
        rows = [
            [label, *row_values(video, row)]
            for label, summary in zip(self.labels, self.plan.summaries, strict=True)
            for video, row in sorted(summary.rows.items())
        ]
        return table_of(("model", *COLUMNS), rows)

    @property
    def statuses(self) -> dict[str, str]:
        """The status of each video: the first that is not `done`; empty if it was not processed."""
        return {video.name: self._status(video.name) for video in self.found.videos}

    def _status(self, video: str) -> str:
        rows = [summary.rows.get(video) for summary in self.plan.summaries]
        if None in rows:
            return ""
        return next((row.status for row in rows if row and row.status != DONE), DONE)


def batch(
    folders: Place | Iterable[Place],
    models: Sequence[ModelName | int] | None = None,
    *,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    out: Place = "dlgmd-out",
    formats: Iterable[str] = (),
    dpi: int = 200,
    overwrite: bool = False,
    force: bool = False,
    clips: Place | None = None,
    exclude: Iterable[str] = (),
    dry_run: bool = False,
    jobs: int | None = None,
    timeout: float | None = None,
    scheduler: str | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> Batch:
    """Run models over every video in folders, as `dlgmd batch` does.

    Each video has a folder in `out`, with what `dlgmd run` writes; see `read_result`. Videos that
    were done before with the same parameters are skipped, so that the same call continues.

    Parameters
    ----------
    folders : str, path, or iterable of them
        Folders, videos, or URLs of either.
    models, set, config, model, formulation, param, engine
        The models, as in `run`. Several have a folder each below `out`.
    out : str or path
        Folder of the results, or a URL.
    formats : iterable of {"png", "pdf", "svg"}
        Formats of the figures; none by default. `dpi` is the resolution of PNG.
    overwrite : bool
        Replace results of other parameters or inputs.
    force : bool
        Also process videos that were done before.
    clips : str or path, optional
        Also write clips of the alarms into this folder.
    exclude : iterable of str
        Patterns of files and folders to leave out, such as ``"raw*"``.
    dry_run : bool
        Only find what there is to do.
    jobs : int, optional
        Number of processes, all processors unless given. A script that calls this needs
        ``if __name__ == "__main__":``, as always with processes.
    timeout : float, optional
        Give up on a video after so many seconds.
    scheduler : str, optional
        A Dask cluster instead of processes of this machine, see `dlgmd batch --help`.
    progress : callable, optional
        Called with a name, a total and a unit; returns a context manager that yields a function to
        call with the number done.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Batch
        Its `table` has a row per model and video; a video that fails has a row, too.

    Raises
    ------
    SourceError
        If a folder does not exist, or there is no video.
    ParameterError
        If a parameter or an option is not valid.
    OutputExistsError
        If there are results that may not be replaced.
    OutputError, MissingExtraError, WorkerError
        If `out` cannot be written, a package is missing, or processes or a cluster do not work.

    Examples
    --------
    >>> done = batch("flights", set=9, out="results")  # doctest: +SKIP
    >>> done.table[done.table["alarms"] > 0]["video"]  # doctest: +SKIP
    """
    _check_scheduler(scheduler, jobs, timeout)
    setups = with_folder_labels(choose_all(models, set, config, model, param, formulation, engine))
    shared = _agreed_options(setups, options)
    labels, out = [one.label for one in setups], os.fspath(out)
    places = [str(store.place(out) / label) for label in labels] if len(labels) > 1 else [out]
    roots = [folders] if isinstance(folders, str | os.PathLike) else folders
    outs = [out, *([] if clips is None else [os.fspath(clips)])]
    found = _find([os.fspath(root) for root in roots], outs, exclude)
    formats = tuple(dict.fromkeys(formats))
    job = Job(tuple(setups), tuple(places), shared, formats, dpi, overwrite or force)
    job = replace(job, clips=None if clips is None else os.path.abspath(clips))
    if dry_run:
        return Batch(labels, found, _plan(found, job, force), job)
    with store.locked(store.place(out)), ExitStack() as stack:
        if any(store.is_url(video.path) for video in found.videos):
            scratch = stack.enter_context(TemporaryDirectory(prefix="dlgmd-"))
            job = replace(job, scratch=scratch)
        made = _plan(found, job, force)
        if clips is not None and not job.overwrite:
            for place in (clips_place(job, n, one.video) for one in made.tasks for n in one.wanted):
                refuse_clips(place.parent, place.name)
        outcomes = _outcomes(job, made.tasks, jobs, timeout, scheduler)
        complete = _process(made, outcomes, labels, progress)
    return Batch(labels, found, made, job, complete)


def with_folder_labels(setups: Sequence[Setup]) -> list[Setup]:
    """The setups with distinct labels that are valid names of folders."""
    labels = [_as_folder(one.label) for one in setups]
    if len({label.casefold() for label in labels}) < len(labels):
        labels = numbered([label.lower() for label in labels])
    return [replace(one, label=label) for one, label in zip(setups, labels, strict=True)]


def failures(rows: Mapping[int, Row], labels: Sequence[str]) -> list[str]:
    """The reasons why a video failed, with the models' labels if they failed differently."""
    reasons: dict[str, list[str]] = {}
    for number, row in rows.items():
        if row.status != DONE:
            reasons.setdefault(f"{row.status}: {row.error}", []).append(labels[number])
    return [
        reason if len(failed) == len(rows) else f"{', '.join(failed)}: {reason}"
        for reason, failed in reasons.items()
    ]


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
            raise ParameterError("", f"{option} does not work with --scheduler", "Leave it out.")
    dask.address_of(scheduler)


def _agreed_options(setups: Sequence[Setup], given: Mapping[str, Any]) -> InputOptions:
    """How every video is read: by the options given, otherwise by those that configs record."""
    every = [input_options(one, given) for one in setups]
    for one, options in zip(setups, every, strict=True):
        create_model(one.params, engine=one.engine)  # raises if its engine is not installed
        if options != every[0]:
            raise ParameterError(
                one.origin,
                "its recorded options differ from those of the other models",
                "Give them on the command line, or run this model alone.",
            )
    return every[0]


def _find(folders: list[str], outs: list[str], exclude: Iterable[str]) -> Found:
    """Find the videos, but not below `outs`, and log what is left out."""
    local = [Path(out) for out in outs if not store.is_url(out)]
    found = find_videos(folders, local, exclude)
    for remark in found.remarks:
        _log.info("Note: %s.", remark)
    for fault in found.faults:
        _log.error("%s; its videos are left out", fault)
    if not found.videos:
        mend = "Give folders with .mp4, .avi, .mkv and the like, or with pictures of one size."
        raise SourceError(", ".join(folders), "there is no video", mend)
    return found


def _plan(found: Found, job: Job, force: bool) -> Plan:
    made = plan(found.videos, job, force=force)
    n_all = len(found.videos)
    n_before = n_all - len(made.tasks)
    if n_before:
        are = "is" if n_all == 1 else "are"
        _log.info("%d of %s %s done already.", n_before, counted(n_all, "video"), are)
    if made.n_other_version:
        _log.warning(
            "kept %s of another version of dlgmd; --force processes all videos again",
            counted(made.n_other_version, "result"),
        )
    return made


def _outcomes(
    job: Job,
    tasks: list[Task],
    n_jobs: int | None,
    timeout_s: float | None,
    scheduler: str | None,
) -> Iterator[tuple[Task, Outcome]]:
    """Run the tasks in local processes or on a cluster; yields each with its outcome as it ends."""
    if scheduler is None:
        # With fewer videos than processors, each video uses several of them.
        n_jobs = max(1, min(n_jobs or n_processors(), len(tasks)))
        return pool.run_tasks(partial(run_video, job), tasks, n_jobs, timeout_s=timeout_s)
    places = [one if store.is_url(one) else os.path.abspath(one) for one in job.places]
    function = partial(run_video, replace(job, places=tuple(places), scratch=None))
    local = [Path(one) for one in places if not store.is_url(one)]
    folders = [local[0].parent if len(places) > 1 else local[0]] if local else []
    return dask.run_tasks(function, tasks, scheduler, folders=folders)


def _process(
    made: Plan, outcomes: Iterator[tuple[Task, Outcome]], labels: list[str], progress: Progress
) -> bool:
    """Run all tasks, and log failures and warnings; False if the stop flag ended it."""
    n_ended = n_failed = 0
    try:
        with progress("batch", len(made.tasks), "video") as advance:
            for task, rows in record_outcomes(made, outcomes):
                failed = failures(rows, labels)
                for line in failed:
                    _log.error("%s: %s", task.video.name, line.rstrip("."))
                warnings = (row.record.get("warnings", []) for row in rows.values())
                for line in dict.fromkeys(chain.from_iterable(warnings)):
                    _log.warning("%s: %s", task.video.name, line.rstrip("."))
                for number, row in rows.items():
                    said = task.video.name, labels[number], row.status, row.wall_s
                    _log.debug("%s, %s: %s, %s s.", *said)
                n_ended, n_failed = n_ended + 1, n_failed + bool(failed)
                advance(n_ended, f"batch, {n_failed} failed")
    except cancel.Interrupted:
        return False
    return True
