"""Batches: finding what is left to do, running one task per video, and writing summary.csv."""

import time
import warnings
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from dlgmd_cli import __version__
from dlgmd_cli.errors import DlgmdError, OutputError, OutputExistsError
from dlgmd_cli.pool import DONE, FAILED, Outcome
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.results.result import Result
from dlgmd_cli.runs.find import Input, local_copy
from dlgmd_cli.runs.run import open_input, require_response, run_models
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.clips import write_clips
from dlgmd_cli.video.options import InputOptions

if TYPE_CHECKING:
    from upath import UPath

OF_INPUT = ("frames", "width", "height", "fps", "duration_s")
OF_SUMMARY = (
    "mp_max",
    "mp_max_frame",
    "spikes",
    "alarms",
    "first_alarm_frame",
    "first_alarm_time_s",
    "mean_attenuation_db",
)
SIDE = "first_alarm_side"
COLUMNS = ("video", "status", "error", "warnings", *OF_INPUT, *OF_SUMMARY, SIDE, "wall_s")
# Share of the time for rewriting summary.csv: after every short video it would take too long.
_SHARE_OF_TIME = 0.05
# Threads that read records, since each may require a request to a bucket.
_READERS = 8


@dataclass(frozen=True)
class Job:
    """Settings shared by all videos of a batch; picklable.

    `places` holds the output folder of each model, an absolute path or a URL. The plots are written
    in `formats`, PNG with `dpi`. With `overwrite`, results with other parameters or of another
    input may be replaced. Videos from URLs are copied to the folder `scratch`, the system's
    temporary folder unless given.
    """

    setups: tuple[Setup, ...]
    places: tuple[str, ...]
    options: InputOptions
    formats: tuple[str, ...]
    dpi: int
    overwrite: bool = False
    scratch: str | None = None
    clips: str | None = None


@dataclass(frozen=True)
class Task:
    """A video, and the numbers of the job's models to run on it."""

    video: Input
    wanted: tuple[int, ...]


@dataclass(frozen=True)
class Row:
    """The outcome of one video with one model.

    `status` is that of a `pool.Outcome`, and `error` says on one line why the video is not done.
    If it is done, `record` has the contents of run.yaml. `wall_s` is the wall time in seconds,
    decoding included; None if unknown. `lacks_figures` tells that a figure could not be drawn,
    which is a warning in the record.
    """

    status: str
    error: str = ""
    record: dict[str, Any] = field(default_factory=dict)
    wall_s: float | None = None
    lacks_figures: bool = False


class Summary:
    """A summary.csv: its rows by the video's name, and the file, which is rewritten each time."""

    def __init__(self, place: "Path | UPath") -> None:
        self.path = place / store.SUMMARY
        self.rows: dict[str, Row] = {}
        self._next_write_s = 0.0

    def write(self, *, at_once: bool = True) -> None:
        """Write the file; raises OutputError.

        Without `at_once`, writing may be postponed to keep its share of the time small.
        """
        began = time.monotonic()
        if not at_once and began < self._next_write_s:
            return
        rows = [row_values(name, self.rows[name]) for name in sorted(self.rows)]
        write = partial(csv.write_values, header=COLUMNS, rows=rows)
        store.write_files(self.path.parent, {store.SUMMARY: write})
        ended = time.monotonic()
        self._next_write_s = ended + (ended - began) / _SHARE_OF_TIME


@dataclass(frozen=True)
class Plan:
    """The remaining work of a batch.

    There is one summary per model, with the rows that are already done. `n_other_version` counts
    the kept results that another version of dlgmd computed.
    """

    tasks: list[Task]
    summaries: list[Summary]
    n_other_version: int


def plan(videos: Sequence[Input], job: Job, *, force: bool = False) -> Plan:
    """Compare the batch with existing results to find the work that is left.

    With `force`, existing results are computed again. Raises OutputExistsError if there are results
    with other parameters or of another input, and `job.overwrite` is not set.
    """
    wanted: dict[str, list[int]] = {video.name: [] for video in videos}
    summaries, n_other_version = [], 0
    for number, (setup, text) in enumerate(zip(job.setups, job.places, strict=True)):
        place = store.place(text)
        summaries.append(Summary(place))

        def stored(video: Input, place: Any = place, setup: Setup = setup) -> dict[str, Any]:
            return {} if force else _done_record(place / video.folder, video, setup, job)

        with ThreadPoolExecutor(_READERS) as readers:
            for video, record in zip(videos, readers.map(stored, videos), strict=True):
                if not record:
                    wanted[video.name].append(number)
                    continue
                summaries[-1].rows[video.name] = Row(
                    DONE, record=record, wall_s=record.get("wall_s")
                )
                n_other_version += record.get("versions", {}).get("dlgmd") != __version__
    tasks = [Task(video, tuple(wanted[video.name])) for video in videos if wanted[video.name]]
    return Plan(tasks, summaries, n_other_version)


def _done_record(folder: "Path | UPath", video: Input, setup: Setup, job: Job) -> dict[str, Any]:
    """The record of a complete result of this video with these settings; empty if there is none.

    Raises OutputExistsError if there is a result that may not be replaced.
    """
    record = read_record(folder / store.RUN)
    known, summary = record.get("input"), record.get("summary")
    if known is None or summary is None:
        return {}
    asked = setup.settings()
    if setup.engine != "auto":
        asked["engine"] = setup.engine
    differing = differences(record, settings=asked, options=job.options.to_record())
    is_same = bool(video.identity) and not differences(record, identity=video.identity)
    if not job.overwrite:
        mend = "Add --overwrite to replace such results, or choose another --out."
        if differing:
            why = f"the result there has other settings ({', '.join(differing[:5])})"
            raise OutputExistsError(str(folder), why, mend)
        if not is_same and known.get("path") != video.path:
            raise OutputExistsError(str(folder), "the result there is of another input", mend)
    if differing or not is_same or record.get("complete") is not True:
        return {}
    if not (known.keys() >= set(OF_INPUT) and summary.keys() >= {*OF_SUMMARY, SIDE}):
        return {}
    if "frames" not in record.get("processed", {}):
        return {}
    figures = {f"{k}.{f}" for k in store.FIGURES[store.RUN] for f in job.formats}
    return record if {*csv.TABLES, csv.ALARMS} | figures <= store.names_in(folder) else {}


def record_outcomes(
    tasks: Plan, outcomes: Iterable[tuple[Task, Outcome]]
) -> Iterator[tuple[Task, dict[int, Row]]]:
    """Enter the outcomes of tasks into the summaries, and keep the files up to date.

    `outcomes` are those of a pool for `run_video`. Yields each video with its rows by the number of
    the model. The summaries are written repeatedly, and at the end even after an error. Raises
    OutputError if one cannot be written at the beginning or at the end.
    """
    for summary in tasks.summaries:  # fail before spending time on videos
        summary.write()
    try:
        for task, outcome in outcomes:
            rows = outcome.value
            if outcome.error is not None:
                rows = dict.fromkeys(task.wanted, error_row(outcome.error, outcome.status))
            for number, row in rows.items():
                summary = tasks.summaries[number]
                summary.rows[task.video.name] = row
                try:
                    summary.write(at_once=False)
                except OutputError:  # it may work later; the last attempt raises
                    continue
            yield task, rows
    finally:
        for summary in tasks.summaries:
            summary.write()


def run_video(job: Job, task: Task) -> dict[int, Row]:
    """Decode a video once, run the models of the task on it, and store the results.

    Every error becomes a row. An error of one model does not affect the others.
    """
    began, rows = time.monotonic(), {}
    video = task.video
    try:
        for number in task.wanted:  # fail before spending time on the video
            _check(job, number, video)
        setups = [job.setups[number] for number in task.wanted]
        with (
            local_copy(video.path, job.scratch) as path,
            open_input(path, setups, job.options) as opened,
        ):
            name = opened.info.name if path == video.path else PurePosixPath(video.path).stem
            identity = {"path": video.path, "name": name, **video.identity}
            results = run_models(opened, setups, job.options, identity=identity)
            for number, result in zip(task.wanted, results, strict=True):
                try:
                    require_response(opened, [job.setups[number]], [result], job.options)
                    rows[number] = _save(job, number, video, result, began)
                    if job.clips is not None:
                        _write_clips(job, number, video, path, result)
                except Exception as error:
                    rows[number] = error_row(error, began=began)
    except Exception as error:
        rows |= dict.fromkeys(set(task.wanted) - rows.keys(), error_row(error, began=began))
    return rows


def _check(job: Job, number: int, video: Input) -> bool:
    """Whether the folder has results of another input; raises if they may not be replaced."""
    folder = store.place(job.places[number]) / video.folder
    # `plan` has already checked an earlier result.
    may_replace = job.overwrite or (folder / store.RUN).exists()
    identity = {"path": video.path, **video.identity}
    return store.check(folder, store.RUN, identity, overwrite=may_replace)


def _save(job: Job, number: int, video: Input, result: Result, began: float) -> Row:
    """Write a result and return its row."""
    folder = store.place(job.places[number]) / video.folder
    wall_s = round(time.monotonic() - began, 3)
    result.record["wall_s"] = wall_s
    with store.locked(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Matplotlib warns if a font lacks a letter of a title
        is_new = _check(job, number, video)
        files = result.files(job.formats, job.dpi)
        undrawn = store.commit(folder, store.RUN, files, is_new_input=is_new)
    unsaid = [f"{name} cannot be drawn ({why})" for name, why in undrawn.items()]
    record = {**result.record, "summary": result.summary, "warnings": [*result.warnings, *unsaid]}
    return Row(DONE, record=record, wall_s=wall_s, lacks_figures=bool(undrawn))


def _write_clips(job: Job, number: int, video: Input, path: str, result: Result) -> None:
    """Write the clips of a result's alarms, in a tree like that of the results."""
    label = job.setups[number].label if len(job.places) > 1 else ""
    place = Path(job.clips or "") / label / video.folder
    onsets_s = [alarm.start_s for alarm in result.alarm_list]
    write_clips(path, place.name, onsets_s, place.parent, job.options.input_fps)


def error_row(error: Exception, status: str = FAILED, began: float | None = None) -> Row:
    """The row for an error, on one line and without the video's name."""
    if isinstance(error, DlgmdError):
        text = f"{error.why}. {error.mend}".strip()
    elif isinstance(error, MemoryError):
        text = "not enough memory. Process smaller frames with --scale, or use fewer --jobs."
    elif isinstance(error, OSError):
        text = f"{store.failure_text(error)}."
    else:
        text = f"internal error ({type(error).__name__}). 'dlgmd --debug run' shows more."
    return Row(status, text, wall_s=None if began is None else round(time.monotonic() - began, 3))


def row_values(video: str, row: Row) -> list[Any]:
    """The row of a video in summary.csv; None and an empty text are undefined."""
    values: list[Any] = [video, row.status, row.error, "; ".join(row.record.get("warnings", []))]
    for part, keys in (("input", OF_INPUT), ("summary", OF_SUMMARY)):
        numbers = (row.record.get(part, {}).get(key) for key in keys)
        values += [one if isinstance(one, int | float) else None for one in numbers]
    side = row.record.get("summary", {}).get(SIDE)
    wall_s = None if row.wall_s is None else round(row.wall_s, 3)
    return [*values, side if isinstance(side, str) else "", wall_s]
