"""Many videos: what is done already, what is left to do, one task a video, and summary.csv."""

import time
import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from dlgmd_cli import __version__
from dlgmd_cli.errors import DlgmdError, OutputError, OutputExistsError
from dlgmd_cli.pool import DONE, FAILED, Outcome
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import read_record
from dlgmd_cli.results.result import Result
from dlgmd_cli.runs.find import SUMMARY, Input, local_copy
from dlgmd_cli.runs.run import Setup, open_input, require_an_answer, run_models
from dlgmd_cli.video.frames import InputOptions

if TYPE_CHECKING:
    from pathlib import Path

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
COLUMNS = ("video", "status", "error", *OF_INPUT, *OF_SUMMARY, "wall_s")
# Rewriting a long table after every short video would take more time than the videos.
_SHARE_OF_TIME = 0.05
# Records are read so many at a time, for each may be a journey to a bucket.
_READERS = 8


@dataclass(frozen=True)
class Job:
    """What is the same for every video of a batch; can be pickled.

    Attributes
    ----------
    setups : tuple of Setup
        The models.
    places : tuple of str
        Where the results of each go: an absolute path, or a URL.
    options : InputOptions
        How every video is read.
    formats : tuple of str
        Formats of the plots.
    dpi : int
        Resolution of PNG.
    overwrite : bool
        Whether results of other parameters, or of another input, may be replaced.
    scratch : str or None
        The folder for copies of videos from URLs, if not the system's.
    """

    setups: tuple[Setup, ...]
    places: tuple[str, ...]
    options: InputOptions
    formats: tuple[str, ...]
    dpi: int
    overwrite: bool = False
    scratch: str | None = None


@dataclass(frozen=True)
class Task:
    """A video, and which of the job's models are to be run over it, by number."""

    video: Input
    wanted: tuple[int, ...]


@dataclass(frozen=True)
class Row:
    """How a video ended in one model.

    Attributes
    ----------
    status : str
        `done`, `failed`, `crashed`, `killed` or `timeout`, see `pool.Outcome`.
    error : str
        Why it is not done, on one line.
    record : dict
        What run.yaml says, of one that is done.
    wall_s : float or None
        How long it took, decoding included, in seconds; None where that is not known.
    """

    status: str
    error: str = ""
    record: dict[str, Any] = field(default_factory=dict)
    wall_s: float | None = None


class Summary:
    """The rows of one summary.csv by the video's name, and the file, which is rewritten whole."""

    def __init__(self, place: "Path | UPath") -> None:
        self.path = place / SUMMARY
        self.rows: dict[str, Row] = {}
        self._next_write_s = 0.0

    def write(self, *, at_once: bool = True) -> None:
        """Write the file; raises OutputError.

        Without `at_once` it may be put off, so that writing takes a small share of the time.
        """
        began = time.monotonic()
        if not at_once and began < self._next_write_s:
            return
        cells = [_cells(name, self.rows[name]) for name in sorted(self.rows)]
        with store.writing(self.path):
            store.write_file(self.path, lambda file: csv.write_rows(file, COLUMNS, cells))
        ended = time.monotonic()
        self._next_write_s = ended + (ended - began) / _SHARE_OF_TIME


@dataclass(frozen=True)
class Plan:
    """What is left of a batch.

    Attributes
    ----------
    tasks : list of Task
        What is to be done.
    summaries : list of Summary
        One a model; they hold what is done already.
    n_other_version : int
        How many of the results that are kept come from another release.
    """

    tasks: list[Task]
    summaries: list[Summary]
    n_other_version: int


def plan(videos: Sequence[Input], job: Job, *, force: bool = False) -> Plan:
    """Compare what is asked for with the results that are there.

    Parameters
    ----------
    videos : sequence of Input
        All of the batch.
    job : Job
        How each is to be computed.
    force : bool
        Compute again what is done already.

    Raises
    ------
    OutputExistsError
        If there are results of other parameters or of another input, and `job.overwrite` is not
        set.
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
                    DONE, record=record, wall_s=_number(record.get("wall_s"))
                )
                n_other_version += record.get("versions", {}).get("dlgmd") != __version__
    tasks = [Task(video, tuple(wanted[video.name])) for video in videos if wanted[video.name]]
    return Plan(tasks, summaries, n_other_version)


def _done_record(folder: "Path | UPath", video: Input, setup: Setup, job: Job) -> dict[str, Any]:
    """The record of a whole result of this very video and of these settings; else nothing.

    Raises OutputExistsError if a result is there that may not be replaced.
    """
    record = read_record(folder / store.RUN)
    known, summary = record.get("input"), record.get("summary")
    if not isinstance(known, dict) or not isinstance(summary, dict):
        return {}
    differing = _differing(record, setup, job.options)
    is_same = bool(video.identity) and all(known.get(k) == v for k, v in video.identity.items())
    if not job.overwrite:
        mend = "Add --overwrite to replace such results, or choose another --out."
        if differing:
            why = f"the result there has other settings ({', '.join(differing[:5])})"
            raise OutputExistsError(str(folder), why, mend)
        if not is_same and known.get("path") != video.path:
            raise OutputExistsError(str(folder), "the result there is of another input", mend)
    if differing or not is_same or record.get("complete") is not True:
        return {}
    if not (known.keys() >= set(OF_INPUT) and summary.keys() >= set(OF_SUMMARY)):
        return {}
    files = set(csv.TABLES) | {f"{k}.{f}" for k in store.FIGURES[store.RUN] for f in job.formats}
    return record if files <= store.names_in(folder) else {}


def _differing(record: Mapping[str, Any], setup: Setup, options: InputOptions) -> list[str]:
    """Which settings of a result are not those that are asked for."""
    asked = setup.settings()
    if setup.engine != "auto":
        asked["engine"] = setup.engine
    wanted, found = options.to_record(), record.get("options")
    found = found if isinstance(found, dict) else {}
    differing = [key for key in {**wanted, **found} if wanted.get(key) != found.get(key)]
    # The mask's file has changed, or there was another.
    named = dict.fromkeys(key.removesuffix("_sha256").replace("_", "-") for key in differing)
    return [key for key, value in asked.items() if record.get(key) != value] + [
        f"--{name}" for name in named
    ]


def work_on(
    tasks: Plan, outcomes: Iterable[tuple[Task, Outcome]]
) -> Iterator[tuple[Task, dict[int, Row]]]:
    """Take down how tasks ended, whoever works on them, and keep the summaries up to date.

    Parameters
    ----------
    tasks : Plan
        Its summaries are written while this runs, and whatever ends it.
    outcomes : iterable of (Task, Outcome)
        What a pool yields for `run_video`.

    Yields
    ------
    (Task, dict of int to Row)
        A video, and its rows by the model's number.

    Raises
    ------
    OutputError
        If a summary cannot be written at the beginning or at the end.
    """
    for summary in tasks.summaries:  # before it takes the time to compute
        summary.write()
    try:
        for task, outcome in outcomes:
            rows = outcome.value
            if outcome.error is not None:
                rows = dict.fromkeys(task.wanted, as_row(outcome.error, outcome.status))
            for number, row in rows.items():
                summary = tasks.summaries[number]
                summary.rows[task.video.name] = row
                try:
                    summary.write(at_once=False)
                except OutputError:  # may be possible later; the end tells
                    continue
            yield task, rows
    finally:
        for summary in tasks.summaries:
            summary.write()


def run_video(job: Job, task: Task) -> dict[int, Row]:
    """Decode one video once, run every model that is wanted, and store the results.

    Whatever goes wrong becomes a row; what goes wrong in one model is only that one's.
    """
    began, rows = time.monotonic(), {}
    video = task.video
    try:
        for number in task.wanted:  # before it takes the time to compute
            _check(job, number, video)
        setups = [job.setups[number] for number in task.wanted]
        with (
            local_copy(video.path, job.scratch) as path,
            open_input(path, setups, job.options) as opened,
        ):
            identity = {"path": video.path, **video.identity}
            results = run_models(opened, setups, job.options, identity=identity)
            for number, result in zip(task.wanted, results, strict=True):
                try:
                    require_an_answer("", opened, [job.setups[number]], [result], job.options)
                    rows[number] = _save(job, number, video, result, began)
                except Exception as error:
                    rows[number] = as_row(error, began=began)
    except Exception as error:
        rows |= dict.fromkeys(set(task.wanted) - rows.keys(), as_row(error, began=began))
    return rows


def _check(job: Job, number: int, video: Input) -> bool:
    """Whether what is in the folder is of another input; raises if it may not be replaced."""
    folder = store.place(job.places[number]) / video.folder
    # `plan` has looked at an earlier result.
    may_replace = job.overwrite or (folder / store.RUN).exists()
    identity = {"path": video.path, **video.identity}
    return store.check(folder, store.RUN, identity, overwrite=may_replace)


def _save(job: Job, number: int, video: Input, result: Result, began: float) -> Row:
    """Write a result, and say so."""
    folder = store.place(job.places[number]) / video.folder
    wall_s = round(time.monotonic() - began, 3)
    result.record["wall_s"] = wall_s
    with store.locked(folder), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a font may lack letters of a title
        is_new = _check(job, number, video)
        store.commit(folder, store.RUN, result.files(job.formats, job.dpi), is_new_input=is_new)
    return Row(DONE, record={**result.record, "summary": result.summary}, wall_s=wall_s)


def as_row(error: Exception, status: str = FAILED, began: float | None = None) -> Row:
    """An error as a row: on one line, without the video's name."""
    if isinstance(error, DlgmdError):
        text = f"{error.why}. {error.mend}".strip()
    elif isinstance(error, MemoryError):
        text = "not enough memory. Process smaller frames with --scale, or use fewer --jobs."
    elif isinstance(error, OSError):
        text = f"{store.failure_text(error)}."
    else:
        text = f"internal error ({type(error).__name__}). 'dlgmd --debug run' shows more."
    return Row(status, text, wall_s=None if began is None else round(time.monotonic() - began, 3))


def _cells(video: str, row: Row) -> list[str]:
    """The cells of one video; empty where there is nothing to say."""
    cells = [csv.text_cell(video), row.status, csv.text_cell(row.error)]
    for part, keys in (("input", OF_INPUT), ("summary", OF_SUMMARY)):
        numbers = (_number(row.record.get(part, {}).get(key)) for key in keys)
        cells += ["" if number is None else csv.cell(number) for number in numbers]
    return [*cells, "" if row.wall_s is None else f"{row.wall_s:.3f}"]


def _number(value: Any) -> float | None:
    """A number of a record, None for what is none."""
    return value if isinstance(value, int | float) else None
