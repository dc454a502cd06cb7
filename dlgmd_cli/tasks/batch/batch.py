"""Models over every video below folders; a video that fails does not end the batch."""

from __future__ import annotations

import logging
import os
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from dlgmd_cli import __version__, errors
from dlgmd_cli.errors import argument, counted, printable, warn
from dlgmd_cli.machine import cancel, dask, pool
from dlgmd_cli.machine.pool import DONE, TaskEnd
from dlgmd_cli.machine.threads import n_processors
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.parameters.facts import Json, Value, stating
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.csv import Cell, Cells
from dlgmd_cli.results.names import frames_text
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.batch.find import VideoFile, VideoListing, find_videos
from dlgmd_cli.tasks.batch.video import (
    OF_INPUT,
    OF_SUMMARY,
    SIDE,
    Job,
    Task,
    VideoRow,
    done_record,
    error_row,
    run_video,
)
from dlgmd_cli.tasks.call import (
    RUN_ARGUMENTS,
    ModelName,
    ModelNames,
    Place,
    Progress,
    Request,
    Setup,
    no_progress,
)
from dlgmd_cli.video.writer import refuse_clips

if TYPE_CHECKING:
    from upath import UPath

_log = logging.getLogger(__name__)

SUMMARY_COLUMNS = (
    *("video", "status", "error", "warnings", *OF_INPUT, *OF_SUMMARY),
    *("complete", SIDE, "wall_s"),
)
# Columns of a terminal's table after a video's name.
_HEADER = ("status", "frames", "peak MP", "spikes", "alarms", "first alarm")
# Greatest share of the time for rewriting summary.csv: rewriting after every short video is slow.
SHARE_OF_TIME = 0.05
# Greatest number of rows of a full table; longer tables show only the videos that failed.
_MAX_ROWS = 60
# Number of threads that read records: each record may need a request to a bucket.
_READERS = 8


@stating(RUN_ARGUMENTS)
def batch(
    folders: Place | Iterable[Place],
    model: ModelName | ModelNames | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
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

    Each video has a folder in `out` with the files of `dlgmd run`, see `read_result`. Videos that
    were done before with the same parameters are skipped: the same call continues a batch.

    Parameters
    ----------
    folders : str, path, or iterable of them
        Folders, videos, or URLs of either.
    model, formulation, param
        The models, as in `run`. Several models have a folder each below `out`.
    out : str or path
        Folder of the results, or a URL.
    formats : iterable of {"png", "pdf", "svg", "vtt"}
        Formats of the figures, and of the alarms' captions (``"vtt"``); none by default. `dpi` is
        the resolution of PNG.
    overwrite : bool
        Replace results of other parameters or inputs.
    force : bool
        Also process videos that were done before.
    clips : str or path, optional
        Also write clips of the alarms into this folder.
    exclude : iterable of str
        Patterns of files and folders to leave out, such as ``"raw*"``.
    dry_run : bool
        Only list the videos to process.
    jobs : int, optional
        Number of processes, all processors unless given. A script that calls this needs
        ``if __name__ == "__main__":``, as always with processes.
    timeout : float, optional
        Time limit per video, in seconds.
    scheduler : str, optional
        A Dask cluster instead of processes of this machine: ``tcp://HOST:PORT``, or a scheduler
        file.
    progress : callable, optional
        Called with a name, a total and a unit; returns a context manager that yields a function,
        which is called with the number done.
    options
        Options of the input and of the rule, as in `run`.

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
        If `out` has results that may not be replaced.
    OutputError, MissingExtraError, WorkerError
        If `out` cannot be written, a package is missing, or processes or a cluster do not work.

    Examples
    --------
    >>> done = batch("flights", 9, out="results")  # doctest: +SKIP
    >>> done.table[done.table["alarms"] > 0]["video"]  # doctest: +SKIP
    """
    _check_scheduler(scheduler, jobs, timeout)
    param = call.with_rule(param, options.pop("alarm", None))
    at = call.taken_threshold(options)
    setups = call.choose_all(model, param, formulation)
    request = _agreed([call.at_threshold(one, **at) for one in setups], options)
    formats = store.known_formats(formats, store.RUN)
    labels, out = [setup.label for setup in request.setups], os.fspath(out)
    places = [str(store.place(out) / label) for label in labels] if len(labels) > 1 else [out]
    roots = [folders] if isinstance(folders, str | os.PathLike) else folders
    outs = [out, *([] if clips is None else [os.fspath(clips)])]
    listing = _find([os.fspath(root) for root in roots], outs, exclude)
    request = request.for_any_of(video.path for video in listing.videos)
    if clips is not None:
        store.require_local(clips, "clips")
        clips = os.path.abspath(clips)
    job = Job(request, tuple(places), formats, dpi, overwrite or force, clips=clips)
    if dry_run:
        planned = work_left(listing.videos, job, force=force)
        return Batch(job, out, listing.videos, listing.faults, *planned, is_dry=True)
    with store.claimed(store.place(out)), ExitStack() as stack:
        if any(store.is_url(video.path) for video in listing.videos):
            scratch = stack.enter_context(TemporaryDirectory(prefix="dlgmd-"))
            job = replace(job, scratch=scratch)
        tasks, summaries = work_left(listing.videos, job, force=force)
        if clips is not None and not job.overwrite:
            for place in (job.clips_place(n, t.video) for t in tasks for n in t.wanted):
                refuse_clips(place.parent, place.name)
        done = Batch(job, out, listing.videos, listing.faults, tasks, summaries)
        _process(done, _ended(job, tasks, jobs, timeout, scheduler), progress)
    return done


def _check_scheduler(scheduler: str | None, jobs: int | None, timeout_s: float | None) -> None:
    """Raise if a scheduler's address is not valid, or is given with options of local processes."""
    if scheduler is not None:
        others = {"jobs": jobs, "timeout": timeout_s}
        refuse(others, f"does not work with {argument('scheduler')}")
        dask.address_of(scheduler)


def _agreed(setups: Sequence[Setup], given: Mapping[str, Any]) -> Request:
    """The request for every video: the given options, else the options recorded in configs."""
    setups = call.with_folder_labels(setups)
    every = [call.options_for(setup, given) for setup in setups]
    for setup, options in zip(setups, every, strict=True):
        create_model(setup.params)  # raises now if a custom model cannot be created
        if options != every[0]:
            why = "its recorded options differ from those of the other models"
            hint = "Give them on the command line, or run this model alone."
            raise errors.ParameterError(setup.config.name, why, hint)
    return Request(tuple(setups), every[0], call.conditional(given))


def _find(folders: list[str], outs: list[str], exclude: Iterable[str]) -> VideoListing:
    """Find the videos, except below `outs`, and log which are left out."""
    listing = find_videos(folders, [Path(o) for o in outs if not store.is_url(o)], exclude)
    for remark in listing.remarks:
        _log.info("Note: %s.", remark)
    for fault in listing.faults:
        _log.error("%s; its videos are left out", fault)
    if not listing.videos:
        hint = "Give folders with .mp4, .avi, .mkv and the like, or with images of one size."
        raise errors.SourceError(", ".join(folders), "there is no video", hint)
    return listing


def work_left(
    videos: Sequence[VideoFile], job: Job, *, force: bool = False
) -> tuple[list[Task], list[SummaryFile]]:
    """Find the remaining work by comparison with existing results; logs the finished part.

    Returns the remaining tasks, and a summary per model with the finished rows. With `force`,
    existing results are computed again. Raises OutputExistsError if there are results with other
    parameters or of another input, and `job.overwrite` is not set.
    """
    wanted: dict[str, list[int]] = {video.name: [] for video in videos}
    summaries, n_other_version = [], 0
    for number, place in enumerate(job.places):
        summaries.append(SummaryFile(store.place(place)))
        with ThreadPoolExecutor(_READERS) as readers:
            found = readers.map(partial(done_record, job, number), () if force else videos)
            records = dict(zip(wanted, found, strict=False))
        for name, numbers in wanted.items():
            record = records.get(name)
            if not record:
                numbers.append(number)
                continue
            summaries[-1].rows[name] = VideoRow(DONE, record=record, wall_s=record.get("wall_s"))
            n_other_version += record.get("versions", {}).get("dlgmd") != __version__
    tasks = [Task(video, tuple(wanted[video.name])) for video in videos if wanted[video.name]]
    if n_before := len(videos) - len(tasks):
        are = "is" if len(videos) == 1 else "are"
        _log.info("%d of %s %s done already.", n_before, counted(len(videos), "video"), are)
    if n_other_version:
        again = f"{argument('force', True)} processes all videos again"
        warn(f"kept {counted(n_other_version, 'result')} of another version of dlgmd; {again}")
    return tasks, summaries


def _ended(
    job: Job,
    tasks: list[Task],
    n_jobs: int | None,
    timeout_s: float | None,
    scheduler: str | None,
) -> Iterator[tuple[Task, TaskEnd]]:
    """Run the tasks in local processes or on a cluster; yields each task when it ends.

    Large files begin first: at the end, no processor waits for the longest video.
    """
    tasks = sorted(tasks, key=lambda task: task.video.identity.get("bytes") or 0, reverse=True)
    if scheduler is None:
        # With fewer videos than processors, each video uses several processors.
        n_jobs = max(1, min(n_jobs or n_processors(), len(tasks)))
        return pool.run_tasks(partial(run_video, job), tasks, n_jobs, timeout_s=timeout_s)
    places = [place if store.is_url(place) else os.path.abspath(place) for place in job.places]
    function = partial(run_video, replace(job, places=tuple(places), scratch=None))
    local = [Path(place) for place in places if not store.is_url(place)]
    folders = [local[0].parent if len(places) > 1 else local[0]] if local else []
    return dask.run_tasks(function, tasks, scheduler, folders=folders)


def _process(done: Batch, ended: Iterator[tuple[Task, TaskEnd]], progress: Progress) -> None:
    """Run all tasks, enter their outcomes into the summaries, and log failures and warnings.

    The summaries are written repeatedly, and at the end even after an error. A warning about
    several videos is logged once, at the end, with the number of videos. The stop flag ends the
    batch. Raises OutputError if a summary cannot be written at the beginning or at the end.
    """
    n_failed, warned = 0, dict[str, list[str]]()
    for summary in done.summaries:  # an unwritable folder must fail before videos are processed
        summary.write()
    try:
        with progress("batch", len(done.tasks), "video") as advance:
            for n_ended, (task, outcome) in enumerate(ended, start=1):
                name = task.video.name
                if outcome.error is None:
                    rows = outcome.result()
                else:
                    rows = dict.fromkeys(task.wanted, error_row(outcome.error, outcome.status))
                for number, row in rows.items():
                    done.summaries[number].rows[name] = row
                    with suppress(errors.OutputError):  # only the last attempt raises
                        done.summaries[number].write(at_once=False)
                    _log.debug(
                        "%s, %s: %s, %s s.", name, done.labels[number], row.status, row.wall_s
                    )
                failed = failures(rows, done.labels)
                for line in failed:
                    _log.error("%s: %s", name, line.rstrip("."))
                warnings = (row.record.get("warnings", []) for row in rows.values())
                for line in dict.fromkeys(chain.from_iterable(warnings)):
                    warned.setdefault(line.rstrip("."), []).append(name)
                n_failed += bool(failed)
                advance(n_ended, f"batch, {n_failed} failed")
    except cancel.Interrupted:
        done.complete = False
    finally:
        for line, (first, *others) in warned.items():
            more = f" and {counted(len(others), 'other video')}" if others else ""
            warn(f"{first}{more}: {line}")
        for summary in done.summaries:
            summary.write()


def failures(rows: Mapping[int, VideoRow], labels: Sequence[str]) -> list[str]:
    """The reasons why a video failed, with the models' labels if they failed differently."""
    reasons: dict[str, list[str]] = {}
    for number, row in rows.items():
        if row.status != DONE:
            reasons.setdefault(f"{row.status}: {row.error}", []).append(labels[number])
    return [
        reason if len(failed) == len(rows) else f"{', '.join(failed)}: {reason}"
        for reason, failed in reasons.items()
    ]


class SummaryFile:
    """A summary.csv: its rows by the video's name, and the file, always rewritten as a whole."""

    def __init__(self, place: Path | UPath) -> None:
        self.path = place / store.SUMMARY
        self.rows: dict[str, VideoRow] = {}
        self._next_write_s = 0.0

    def write(self, *, at_once: bool = True) -> None:
        """Write the file; raises OutputError.

        Without `at_once`, writing may be postponed to take a small share of the time.
        """
        began = time.monotonic()
        if not at_once and began < self._next_write_s:
            return
        rows = [row_values(name, self.rows[name]) for name in sorted(self.rows)]
        write = partial(csv.write_values, header=SUMMARY_COLUMNS, rows=rows)
        store.ClaimedFolder(self.path.parent).commit({store.SUMMARY: write})
        ended = time.monotonic()
        self._next_write_s = ended + (ended - began) / SHARE_OF_TIME


def row_values(video: str, row: VideoRow) -> list[Cell]:
    """The row of a video in summary.csv; undefined values are None or an empty text."""
    known, summary = row.record.get("input", {}), row.record.get("summary", {})
    numbers = (
        *map(known.get, OF_INPUT),
        *map(summary.get, OF_SUMMARY),
        row.record.get("complete"),
    )
    return [
        *(video, row.status, row.error, "; ".join(row.record.get("warnings", []))),
        *(number if isinstance(number, int | float) else None for number in numbers),
        summary.get("first_alarm_side") or "",
        None if row.wall_s is None else round(row.wall_s, 3),
    ]


@dataclass(eq=False, repr=False)
class Batch(Outcome):
    """The outcome of a batch.

    Attributes
    ----------
    job : Job
        The models and the other settings that all videos share.
    out : str
        The folder of the results.
    videos : list of VideoFile
        The videos that were found.
    faults : list of str
        The folders that could not be read.
    tasks : list of Task
        The videos and models that were not done before.
    summaries : list of Summary
        One per model, with the row of each video.
    complete : bool
        Whether the batch ran to its end.
    is_dry : bool
        Whether the batch only listed the videos to process.
    """

    TABLES = (store.SUMMARY,)

    job: Job
    out: str
    videos: list[VideoFile]
    faults: list[str]
    tasks: list[Task]
    summaries: list[SummaryFile]
    complete: bool = True
    is_dry: bool = False

    @property
    def labels(self) -> list[str]:
        """The models' names."""
        return [setup.label for setup in self.job.request.setups]

    @cached_property
    def to_do(self) -> dict[str, dict[str, str]]:
        """For each video, the folders to write, by the models' labels; none if it was done."""
        to_do: dict[str, dict[str, str]] = {video.name: {} for video in self.videos}
        for task in self.tasks:
            folders = {self.labels[n]: str(self.job.folder(n, task.video)) for n in task.wanted}
            to_do[task.video.name] = folders
        return to_do

    @property
    def interrupted(self) -> bool:
        """Whether the user stopped the batch."""
        return not self.complete

    def __repr__(self) -> str:
        counts = Counter(status or "not processed" for status in self.statuses.values())
        statuses = ", ".join(f"{n} {status}" for status, n in counts.items())
        n_videos = counted(len(self.statuses), "video")
        return f"<Batch of {n_videos} with {', '.join(self.labels)}: {statuses}>"

    def cells(self) -> Cells:
        """The rows of every summary.csv, after a column `model`."""
        rows = [
            [label, *row_values(video, row)]
            for label, summary in zip(self.labels, self.summaries, strict=True)
            for video, row in sorted(summary.rows.items())
        ]
        return {store.SUMMARY: (("model", *SUMMARY_COLUMNS), rows)}

    @property
    def statuses(self) -> dict[str, str]:
        """By video, the first model's status that is not `done`; empty if a model was not run."""
        return {video: self._status(video) for video in self.to_do}

    def _status(self, video: str) -> str:
        statuses = [summary.rows.get(video, VideoRow("")).status for summary in self.summaries]
        return "" if "" in statuses else next((word for word in statuses if word != DONE), DONE)

    @property
    def warnings(self) -> dict[str, list[str]]:
        """The warnings about each video, from all models; videos without warnings are left out."""
        by_video: dict[str, list[str]] = {}
        for summary in self.summaries:
            for video, row in summary.rows.items():
                lines = [*by_video.get(video, []), *row.record.get("warnings", [])]
                by_video[video] = list(dict.fromkeys(lines))
        return {video: lines for video, lines in sorted(by_video.items()) if lines}

    @property
    def failure(self) -> errors.DlgmdError | None:  # type: ignore[override]
        """The error behind the exit code 1: a video, a folder or a figure failed."""
        if self.is_dry:
            return None
        statuses, out = self.statuses, printable(self.out)
        n_total, n_failed = len(statuses), sum(status != DONE for status in statuses.values())
        if n_failed:
            n_done, those = n_total - n_failed, "it" if n_total == 1 else f"those {n_failed}"
            kept = "result is" if n_done == 1 else f"{n_done} results are"
            rest = f"; the other {kept} in {out}" if n_done else ""
            those = "that one" if n_failed == 1 < n_total else those
            why = f"{n_failed} of {counted(n_total, 'video')} failed{rest}"
            return errors.DlgmdError("", why, f"Fix or remove {those}, then run again.")
        if self.faults:
            why = f"some folders could not be read; the results of the others are in {out}"
            return errors.DlgmdError("", why, "Check their access rights, then run again.")
        if any(row.lacks_figures for summary in self.summaries for row in summary.rows.values()):
            return errors.DlgmdError(
                "", f"some figures could not be drawn; all tables are in {out}"
            )
        return None

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output."""
        if self.is_dry:
            return {"dry_run": True, "videos": len(self.to_do), "to_do": self.to_do}
        paths, statuses = [str(summary.path) for summary in self.summaries], self.statuses
        return {
            "summary": paths[0] if len(paths) == 1 else dict(zip(self.labels, paths, strict=True)),
            "complete": self.complete,
            "videos": len(statuses),
            "already_done": self._n_before,
            "status": {DONE: 0, **Counter(status for status in statuses.values() if status)},
            "warnings": self.warnings,
        }

    @property
    def _n_before(self) -> int:
        return sum(not folders for folders in self.to_do.values())

    def shown(self) -> Iterator[Shown]:
        """A table for each model, the paths of the summaries, and the counts."""
        if self.is_dry:
            yield from self._planned()
            return
        for label, summary in zip(self.labels, self.summaries, strict=True):
            rows = sorted(summary.rows.items())
            if len(rows) > _MAX_ROWS:
                rows = [(name, row) for name, row in rows if row.status != DONE]
            if rows:
                yield (label, *_HEADER), [(name, row.status, *_cells(row)) for name, row in rows]
        for summary in self.summaries:
            yield summary.path
        yield self._counts()

    def _planned(self) -> Iterator[Shown]:
        """The videos that the batch would process."""
        rows = [
            (name, ", ".join(folders.values()) or "– (done before)")
            for name, folders in self.to_do.items()
        ]
        yield ("video", "would be written to"), rows
        n_videos, n_before = len(rows), self._n_before
        yield (
            f"{counted(n_videos, 'video')}: {n_videos - n_before} to process, {n_before} done "
            "before. Nothing was written."
        )

    def _counts(self) -> str:
        """One line with the number of videos, in total and by status."""
        statuses = self.statuses
        by_status, n_before = Counter(statuses.values()), self._n_before
        done = f"{by_status.pop(DONE, 0)} done"
        parts = [f"{done} ({n_before} before)" if n_before else done]
        n_open = by_status.pop("", 0)
        parts += [f"{n} {status}" for status, n in sorted(by_status.items())]
        parts += [f"{n_open} not processed"] if n_open else []
        alarmed = {
            video
            for summary in self.summaries
            for video, row in summary.rows.items()
            if row.record.get("summary", {}).get("alarms")
        }
        n_warned = len(self.warnings)
        parts += [f"{len(alarmed)} with alarms"]
        parts += [f"{n_warned} with warnings"] if n_warned else []
        videos = f"{counted(len(statuses), 'video')}: {', '.join(parts)}."
        return f"{videos} Model: {', '.join(self.labels)}."

    def kept(self) -> str:
        """A line about the results kept after an interruption."""
        statuses = self.statuses
        n_done = sum(status == DONE for status in statuses.values())
        return f"{n_done} of {len(statuses)} videos are done; the same command continues from there"


def _cells(row: VideoRow) -> tuple[str, ...]:
    """The cells of a video for a terminal."""
    summary = row.record.get("summary", {})
    if not summary:
        return ("–",) * (len(_HEADER) - 1)
    peak = "–" if summary["mp_max"] is None else f"{summary['mp_max']:.6g}"
    first = "–"
    if None not in (summary["first_alarm_frame"], summary["first_alarm_time_s"]):
        first = "frame {first_alarm_frame}, {first_alarm_time_s:.3f} s".format(**summary)
        first += f", {side}" if (side := summary.get("first_alarm_side")) else ""
    spikes, alarms = str(summary["spikes"]), str(summary["alarms"])
    return frames_text(row.record), peak, spikes, alarms, first
