"""Models over every video below folders; a video that fails does not end it."""

from __future__ import annotations

import logging
import os
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain
from pathlib import Path, PurePosixPath
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from dlgmd_cli import __version__, errors
from dlgmd_cli.errors import ParameterError, counted
from dlgmd_cli.machine import cancel, dask, pool
from dlgmd_cli.machine.pool import DONE, FAILED, TaskEnd
from dlgmd_cli.machine.threads import n_processors
from dlgmd_cli.models.base import create_model
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.batch import OF_INPUT, OF_SUMMARY, SIDE, Batch, Row, Summary
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import ModelName, Progress, Request, Setup, no_progress
from dlgmd_cli.tasks.find import VideoFile, VideoListing, find_videos, local_copy
from dlgmd_cli.tasks.run import require_response, run_models
from dlgmd_cli.video.writer import refuse_clips

if TYPE_CHECKING:
    from upath import UPath

_log = logging.getLogger(__name__)

# Threads that read records, since each may require a request to a bucket.
_READERS = 8
Place = str | os.PathLike[str]


@dataclass(frozen=True)
class Shared:
    """What all videos of a batch have in common; picklable.

    `places` holds the output folder of each model, an absolute path or a URL. The plots are written
    in `formats`, PNG with `dpi`. With `overwrite`, results with other parameters or of another
    input may be replaced. Videos from URLs are copied to the folder `scratch`, the system's
    temporary folder unless given.
    """

    asked: Request
    places: tuple[str, ...]
    formats: tuple[str, ...]
    dpi: int
    overwrite: bool = False
    scratch: str | None = None
    clips: str | None = None


@dataclass(frozen=True)
class Task:
    """A video, and the numbers of the models to run on it."""

    video: VideoFile
    wanted: tuple[int, ...]


# The remaining work of a batch, and a summary per model, with the rows that are already done.
Work = tuple[list[Task], list[Summary]]


def batch(
    folders: Place | Iterable[Place],
    model: ModelName | Sequence[ModelName] | None = None,
    *,
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
    model, formulation, param, engine
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
    >>> done = batch("flights", 9, out="results")  # doctest: +SKIP
    >>> done.table[done.table["alarms"] > 0]["video"]  # doctest: +SKIP
    """
    _check_scheduler(scheduler, jobs, timeout)
    request = _agreed(call.choose_all(model, param, formulation, engine), options)
    formats = store.known_formats(formats)
    labels, out = [setup.label for setup in request.setups], os.fspath(out)
    places = [str(store.place(out) / label) for label in labels] if len(labels) > 1 else [out]
    roots = [folders] if isinstance(folders, str | os.PathLike) else folders
    outs = [out, *([] if clips is None else [os.fspath(clips)])]
    listing = _find([os.fspath(root) for root in roots], outs, exclude)
    if clips is not None:
        store.require_local(clips, "clips")
        clips = os.path.abspath(clips)
    shared = Shared(request, tuple(places), formats, dpi, overwrite or force, clips=clips)
    if dry_run:
        made = plan(listing.videos, shared, force=force)
        return _outcome(shared, listing, made, out, is_dry=True)
    with store.claimed(store.place(out)), ExitStack() as stack:
        if any(store.is_url(video.path) for video in listing.videos):
            scratch = stack.enter_context(TemporaryDirectory(prefix="dlgmd-"))
            shared = replace(shared, scratch=scratch)
        tasks, summaries = made = plan(listing.videos, shared, force=force)
        for summary in summaries:
            if n := summary.n_dropped(video.name for video in listing.videos):
                said = "Note: %s no longer lists %s of an earlier batch; their results stay."
                _log.info(said, summary.path, counted(n, "video"))
        if clips is not None and not shared.overwrite:
            for place in (clips_place(shared, n, t.video) for t in tasks for n in t.wanted):
                refuse_clips(place.parent, place.name)
        ended = _ended(shared, tasks, jobs, timeout, scheduler)
        complete = _process(made, ended, labels, progress)
    return _outcome(shared, listing, made, out, complete=complete)


def _outcome(shared: Shared, listing: VideoListing, made: Work, out: str, **how: bool) -> Batch:
    """The outcome of what was planned."""
    tasks, summaries = made
    labels = [setup.label for setup in shared.asked.setups]
    to_do: dict[str, dict[str, str]] = {video.name: {} for video in listing.videos}
    for task in tasks:
        for n in task.wanted:
            place = store.place(shared.places[n]) / task.video.folder
            to_do[task.video.name][labels[n]] = str(place)
    return Batch(labels, out, summaries, to_do, listing.faults, **how)


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


def _check_scheduler(scheduler: str | None, jobs: int | None, timeout_s: float | None) -> None:
    """Raise if a scheduler's address is not valid, or is given with options of local processes."""
    if scheduler is None:
        return
    for option, value in (("--jobs", jobs), ("--timeout", timeout_s)):
        if value is not None:
            raise ParameterError("", f"{option} does not work with --scheduler", "Leave it out.")
    dask.address_of(scheduler)


def _agreed(setups: Sequence[Setup], given: Mapping[str, Any]) -> Request:
    """What is asked of every video: with the options given, otherwise those that configs record."""
    setups = call.with_folder_labels(setups)
    every = [call.input_options(setup, given) for setup in setups]
    for setup, options in zip(setups, every, strict=True):
        create_model(setup.params, engine=setup.engine)  # raises if its engine is not installed
        if options != every[0]:
            why = "its recorded options differ from those of the other models"
            hint = "Give them on the command line, or run this model alone."
            raise ParameterError(setup.origin, why, hint)
    return Request(tuple(setups), every[0])


def _find(folders: list[str], outs: list[str], exclude: Iterable[str]) -> VideoListing:
    """Find the videos, but not below `outs`, and log what is left out."""
    listing = find_videos(folders, [Path(o) for o in outs if not store.is_url(o)], exclude)
    for remark in listing.remarks:
        _log.info("Note: %s.", remark)
    for fault in listing.faults:
        _log.error("%s; its videos are left out", fault)
    if not listing.videos:
        hint = "Give folders with .mp4, .avi, .mkv and the like, or with images of one size."
        raise errors.SourceError(", ".join(folders), "there is no video", hint)
    return listing


def _ended(
    shared: Shared,
    tasks: list[Task],
    n_jobs: int | None,
    timeout_s: float | None,
    scheduler: str | None,
) -> Iterator[tuple[Task, TaskEnd]]:
    """Run the tasks in local processes or on a cluster; yields each with its outcome as it ends."""
    if scheduler is None:
        # With fewer videos than processors, each video uses several of them.
        n_jobs = max(1, min(n_jobs or n_processors(), len(tasks)))
        return pool.run_tasks(partial(run_video, shared), tasks, n_jobs, timeout_s=timeout_s)
    places = [place if store.is_url(place) else os.path.abspath(place) for place in shared.places]
    function = partial(run_video, replace(shared, places=tuple(places), scratch=None))
    local = [Path(place) for place in places if not store.is_url(place)]
    folders = [local[0].parent if len(places) > 1 else local[0]] if local else []
    return dask.run_tasks(function, tasks, scheduler, folders=folders)


def _process(
    made: Work, ended: Iterator[tuple[Task, TaskEnd]], labels: list[str], progress: Progress
) -> bool:
    """Run all tasks, enter their outcomes into the summaries, and log failures and warnings.

    The summaries are written repeatedly, and at the end even after an error. A warning that
    concerns several videos is logged once, at the end, with their number. Returns False if the stop
    flag ended it. Raises OutputError if a summary cannot be written at the beginning or at the end.
    """
    tasks, summaries = made
    n_failed, warned = 0, dict[str, list[str]]()
    for summary in summaries:  # fail before spending time on videos
        summary.write()
    try:
        with progress("batch", len(tasks), "video") as advance:
            for n_ended, (task, outcome) in enumerate(ended, start=1):
                rows, name = outcome.value, task.video.name
                if outcome.error is not None:
                    rows = dict.fromkeys(task.wanted, error_row(outcome.error, outcome.status))
                for number, row in rows.items():
                    summaries[number].rows[name] = row
                    with suppress(errors.OutputError):  # it may work later; the last attempt raises
                        summaries[number].write(at_once=False)
                failed = failures(rows, labels)
                for line in failed:
                    _log.error("%s: %s", name, line.rstrip("."))
                warnings = (row.record.get("warnings", []) for row in rows.values())
                for line in dict.fromkeys(chain.from_iterable(warnings)):
                    warned.setdefault(line.rstrip("."), []).append(name)
                for number, row in rows.items():
                    _log.debug("%s, %s: %s, %s s.", name, labels[number], row.status, row.wall_s)
                n_failed += bool(failed)
                advance(n_ended, f"batch, {n_failed} failed")
    except cancel.Interrupted:
        return False
    finally:
        for line, (first, *others) in warned.items():
            more = f" and {counted(len(others), 'other video')}" if others else ""
            _log.warning("%s%s: %s", first, more, line)
        for summary in summaries:
            summary.write()
    return True


def plan(videos: Sequence[VideoFile], shared: Shared, *, force: bool = False) -> Work:
    """Compare the batch with existing results to find the work that is left; logs what is done.

    With `force`, existing results are computed again. Raises OutputExistsError if there are results
    with other parameters or of another input, and `shared.overwrite` is not set.
    """
    wanted: dict[str, list[int]] = {video.name: [] for video in videos}
    summaries, n_other_version = [], 0
    for number, (setup, text) in enumerate(zip(shared.asked.setups, shared.places, strict=True)):
        place = store.place(text)
        summaries.append(Summary(place))

        def stored(video: VideoFile, place: Any = place, setup: Setup = setup) -> dict[str, Any]:
            return {} if force else _done_record(place / video.folder, video, setup, shared)

        with ThreadPoolExecutor(_READERS) as readers:
            for video, record in zip(videos, readers.map(stored, videos), strict=True):
                if not record:
                    wanted[video.name].append(number)
                    continue
                row = Row(DONE, record=record, wall_s=record.get("wall_s"))
                summaries[-1].rows[video.name] = row
                n_other_version += record.get("versions", {}).get("dlgmd") != __version__
    tasks = [Task(video, tuple(wanted[video.name])) for video in videos if wanted[video.name]]
    if n_before := len(videos) - len(tasks):
        are = "is" if len(videos) == 1 else "are"
        _log.info("%d of %s %s done already.", n_before, counted(len(videos), "video"), are)
    if n_other_version:
        what = "kept %s of another version of dlgmd; --force processes all videos again"
        _log.warning(what, counted(n_other_version, "result"))
    return tasks, summaries


def _done_record(
    folder: Path | UPath, video: VideoFile, setup: Setup, shared: Shared
) -> dict[str, Any]:
    """The record of a complete result of this video with these settings; empty if there is none.

    Raises OutputExistsError if there is a result that may not be replaced.
    """
    record = read_record(folder / store.RUN)
    known, summary = record.get("input"), record.get("summary")
    if known is None or summary is None:
        return {}
    settings = setup.settings()
    if setup.engine != "auto":
        settings["engine"] = setup.engine
    differing = differences(record, settings=settings, options=shared.asked.options.to_record())
    is_same = bool(video.identity) and not differences(record, identity=video.identity)
    if not shared.overwrite:
        hint = "Add --overwrite to replace such results, or choose another --out."
        why = "the result there is of another input"
        if differing:
            why = f"the result there has other settings ({', '.join(differing[:5])})"
        if differing or (not is_same and known.get("path") != video.path):
            raise errors.OutputExistsError(str(folder), why, hint)
    is_whole = known.keys() >= set(OF_INPUT) and summary.keys() >= {*OF_SUMMARY, SIDE}
    is_whole = is_whole and "frames" in record.get("processed", {})
    if differing or not (is_same and is_whole and record.get("complete") is True):
        return {}
    figures = {f"{k}.{f}" for k in store.FIGURES[store.RUN] for f in shared.formats}
    return record if {*csv.TABLES, csv.ALARMS} | figures <= store.names_in(folder) else {}


def run_video(shared: Shared, task: Task) -> dict[int, Row]:
    """Decode a video once, run the models of the task on it, and store the results.

    Every error becomes a row. An error of one model does not affect the others.
    """
    began, rows = time.monotonic(), {}
    video = task.video
    try:
        for number in task.wanted:  # fail before spending time on the video
            store.check(**_claim(shared, number, video))
        setups = tuple(shared.asked.setups[number] for number in task.wanted)
        request = replace(shared.asked, setups=setups)
        with local_copy(video.path, shared.scratch) as path, request.open(path) as opened:
            name = opened.info.name if path == video.path else PurePosixPath(video.path).stem
            identity = {"path": video.path, "name": name, **video.identity}
            results = run_models(opened, request, identity=identity)
            for number, result in zip(task.wanted, results, strict=True):
                try:
                    alone = replace(request, setups=(shared.asked.setups[number],))
                    require_response(opened, alone, [result])
                    with ExitStack() as clips:  # a result without its clips is not done
                        if shared.clips is not None:
                            place = clips_place(shared, number, video)
                            onsets_s = [alarm.start_s for alarm in result.alarm_list]
                            where = place.name, onsets_s, place.parent, request.options.of_images
                            clips.enter_context(call.clips_written(path, *where))
                        rows[number] = _save(shared, number, video, result, began)
                except Exception as error:
                    rows[number] = error_row(error, began=began)
    except Exception as error:
        rows |= dict.fromkeys(set(task.wanted) - rows.keys(), error_row(error, began=began))
    return rows


def _claim(shared: Shared, number: int, video: VideoFile) -> dict[str, Any]:
    """What is asked of `store` for the folder of a result."""
    folder = store.place(shared.places[number]) / video.folder
    # `plan` has already checked an earlier result.
    may_replace = shared.overwrite or (folder / store.RUN).exists()
    identity = {"path": video.path, **video.identity}
    return {"folder": folder, "record": store.RUN, "identity": identity, "overwrite": may_replace}


def _save(shared: Shared, number: int, video: VideoFile, result: Result, began: float) -> Row:
    """Write a result and return its row."""
    wall_s = round(time.monotonic() - began, 3)
    result.record["wall_s"] = wall_s
    with warnings.catch_warnings(), store.claimed(**_claim(shared, number, video)) as claim:
        warnings.simplefilter("ignore")  # Matplotlib warns if a font lacks a letter of a title
        undrawn = claim.commit(result.files(shared.formats, shared.dpi))
    unsaid = [f"{name} cannot be drawn ({why})" for name, why in undrawn.items()]
    record = {**result.record, "summary": result.summary, "warnings": [*result.warnings, *unsaid]}
    return Row(DONE, record=record, wall_s=wall_s, lacks_figures=bool(undrawn))


def clips_place(shared: Shared, number: int, video: VideoFile) -> Path:
    """Folder and name of a video's clips, in a tree like that of the results."""
    label = shared.asked.setups[number].label if len(shared.places) > 1 else ""
    return Path(shared.clips or "") / label / video.folder


def error_row(error: Exception, status: str = FAILED, began: float | None = None) -> Row:
    """The row for an error, on one line and without the video's name."""
    if isinstance(error, errors.DlgmdError):
        text = f"{error.why}. {error.hint}".strip()
    elif isinstance(error, MemoryError):
        text = "not enough memory. Process smaller frames with --scale, or use fewer --jobs."
    elif isinstance(error, OSError):
        text = f"{store.failure_text(error)}."
    else:
        text = f"internal error ({type(error).__name__}). 'dlgmd --debug run' shows more."
    return Row(status, text, wall_s=None if began is None else round(time.monotonic() - began, 3))
