"""One video of a batch: check for a finished result, processing, and its row of the summary."""

import time
import warnings
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from dlgmd_cli.errors import DlgmdError, OutputExistsError, argument, overwrite_hint
from dlgmd_cli.machine.pool import DONE, FAILED
from dlgmd_cli.parameters.facts import InputFacts, Record
from dlgmd_cli.results import store
from dlgmd_cli.results.files import names_of
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.batch.find import VideoFile, local_copy
from dlgmd_cli.tasks.call import Request
from dlgmd_cli.tasks.describing import identified
from dlgmd_cli.tasks.stepping import require_response, run_models

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
    "blind_share",
    "mean_attenuation_db",
    "attenuation_frames",
    "median_attenuation_db",
    "pooled_attenuation_db",
)
SIDE = "first_alarm_side"


@dataclass(frozen=True)
class VideoRow:
    """The outcome of one video with one model.

    `status` is the status of a `pool.TaskEnd`, and `error` is the reason, on one line, why the
    video is not done. If the video is done, `record` has the contents of run.yaml. `wall_s` is the
    wall time in seconds, decoding included; None if unknown. `lacks_figures` says whether a figure
    could not be drawn, which is a warning in the record.
    """

    status: str
    error: str = ""
    record: Record = field(default_factory=Record)
    wall_s: float | None = None
    lacks_figures: bool = False


@dataclass(frozen=True)
class Job:
    """The settings that all videos of a batch share; picklable.

    `places` holds the output folder of each model, an absolute path or a URL. Figures and
    captions are written in `formats`, PNG with `dpi`. With `overwrite`, results with other
    parameters or of another input may be replaced. Videos from URLs are copied to the folder
    `scratch`, the system's temporary folder unless given.
    """

    request: Request
    places: tuple[str, ...]
    formats: tuple[str, ...]
    dpi: int
    overwrite: bool = False
    scratch: str | None = None
    clips: str | None = None

    def folder(self, number: int, video: VideoFile) -> "Path | UPath":
        """The folder of a video's result with model `number`."""
        return store.place(self.places[number]) / video.folder

    def target(self, number: int, video: VideoFile) -> tuple["Path | UPath", str, InputFacts]:
        """The result's folder, its record's name and the input's identity, for `store`."""
        return self.folder(number, video), store.RUN, {**video.identity, "path": video.path}

    def may_replace(self, number: int, video: VideoFile) -> bool:
        """Whether an earlier result may be replaced; `done_record` has checked this before."""
        return self.overwrite or (self.folder(number, video) / store.RUN).exists()

    def clips_place(self, number: int, video: VideoFile) -> Path:
        """Folder and name of a video's clips, in a tree like the tree of the results."""
        label = self.request.setups[number].label if len(self.places) > 1 else ""
        return Path(self.clips or "") / label / video.folder


@dataclass(frozen=True)
class Task:
    """A video, and the numbers of the models to run on it."""

    video: VideoFile
    wanted: tuple[int, ...]


def done_record(job: Job, number: int, video: VideoFile) -> Record:
    """The record of a complete result of a video with the job's settings; empty if there is none.

    Raises OutputExistsError if the folder has a result that may not be replaced.
    """
    folder, setup = job.folder(number, video), job.request.setups[number]
    record = read_record(folder / store.RUN)
    known, summary = record.get("input"), record.get("summary")
    if known is None or summary is None:
        return {}
    settings = setup.settings()
    source: Record = {}
    if "model_sha256" in settings:
        source["model_sha256"] = settings.pop("model_sha256")
    options = job.request.options.beside(video.path)
    differing = differences(record, settings=settings, options=options.to_record())
    changed = differences(record, identity=video.identity, settings=source)
    is_same = bool(video.identity) and not changed
    if not job.overwrite:
        hint = overwrite_hint("such results")
        why = "the result there is of another input"
        if differing:
            why = f"the result there has other settings ({', '.join(differing[:5])})"
        if differing or (not is_same and known.get("path") != video.path):
            raise OutputExistsError(str(folder), why, hint)
    is_whole = known.keys() >= {*OF_INPUT} and summary.keys() >= {*OF_SUMMARY, SIDE}
    is_whole = is_whole and "frames" in record.get("processed", {})
    is_whole = is_whole and "complete" in record and not record.get("interrupted")
    if differing or not (is_same and is_whole):
        return {}
    return record if names_of(store.RUN, job.formats) <= store.names_in(folder) else {}


def run_video(job: Job, task: Task) -> dict[int, VideoRow]:
    """Decode a video once, run the models of the task on it, and store the results.

    Every error becomes a row. An error of one model does not affect the others.
    """
    began, rows = time.monotonic(), {}
    video = task.video
    try:
        for number in task.wanted:  # an unwritable folder must fail before the video is processed
            overwrite = job.may_replace(number, video)
            store.check_place(*job.target(number, video), overwrite=overwrite)
        options = job.request.options.beside(video.path)
        setups = tuple(job.request.setups[number] for number in task.wanted)
        request = replace(job.request, setups=setups, options=options)
        with local_copy(video.path, job.scratch) as path, request.open(path) as opened:
            name = opened.info.name if path == video.path else PurePosixPath(video.path).stem
            given: InputFacts = {"path": video.path, "name": name}
            identity = identified(opened, request.options, {**given, **video.identity})
            results = run_models(opened, request, identity=identity)
            for number, result in zip(task.wanted, results, strict=True):
                try:
                    alone = replace(request, setups=(job.request.setups[number],))
                    require_response(opened, alone, [result])
                    with ExitStack() as clips:  # a result without its clips is not done
                        if job.clips is not None:
                            place = job.clips_place(number, video)
                            onsets_s = [alarm.start_s for alarm in result.alarm_list]
                            where = place.name, onsets_s, place.parent, request.options.of_images
                            clips.enter_context(call.clips_written(path, *where))
                        rows[number] = _saved(job, number, video, result, began)
                except Exception as error:
                    rows[number] = error_row(error, began=began)
    except Exception as error:
        rows |= dict.fromkeys(set(task.wanted) - rows.keys(), error_row(error, began=began))
    return rows


def _saved(job: Job, number: int, video: VideoFile, result: Result, began: float) -> VideoRow:
    """Write a result and return its row."""
    wall_s = round(time.monotonic() - began, 3)
    result.record["wall_s"] = wall_s
    target, overwrite = job.target(number, video), job.may_replace(number, video)
    with warnings.catch_warnings(), store.claimed(*target, overwrite=overwrite) as claim:
        warnings.simplefilter("ignore")  # Matplotlib warns of letters that the font lacks
        undrawn = claim.commit(result.files(job.formats, job.dpi))
    unsaid = [f"{name} cannot be drawn ({why})" for name, why in undrawn.items()]
    record: Record = {
        **result.record,
        "summary": result.summary,
        "warnings": [*result.warnings, *unsaid],
    }
    return VideoRow(DONE, record=record, wall_s=wall_s, lacks_figures=bool(undrawn))


def error_row(error: Exception, status: str = FAILED, began: float | None = None) -> VideoRow:
    """The row of a video that failed; the error is one line without the video's name."""
    if isinstance(error, DlgmdError):
        text = error.reason
    elif isinstance(error, MemoryError):
        smaller = f"Process smaller frames with {argument('scale')}"
        text = f"not enough memory. {smaller}, or use fewer {argument('jobs')}."
    elif isinstance(error, OSError):
        text = f"{store.failure_text(error)}."
    else:
        text = f"internal error ({type(error).__name__}). Run this video alone to see more."
    wall_s = None if began is None else round(time.monotonic() - began, 3)
    return VideoRow(status, text, wall_s=wall_s)
