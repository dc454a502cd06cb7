"""`run`: decode a video once and step every model."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any, overload

import numpy as np

from dlgmd_cli.errors import ParameterError, SourceError, argument, counted
from dlgmd_cli.frame import Flags, Frame, small_wh
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import opencv_threads
from dlgmd_cli.models.base import Model, create_model
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion, too_small
from dlgmd_cli.models.session import Session
from dlgmd_cli.models.windows import Camera, outside
from dlgmd_cli.parameters.facts import InputFacts, Processed, Record, RunFacts, Value
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.csv import RowList, Rows
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.store import is_url
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import (
    ModelName,
    ModelNames,
    OnFrame,
    Progress,
    Request,
    Setup,
    no_progress,
)
from dlgmd_cli.tasks.camera import camera_of, headings_beyond, not_headed, read_headings
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.opening import Openable, content_sha256
from dlgmd_cli.video.source import Video, read_ahead
from dlgmd_cli.video.writer import refuse_clips

_log = logging.getLogger(__name__)

# The largest input, in bytes, that is hashed by default.
HASHED_BYTES = 2e9
# The thread that decodes hands over so many frames at a time, with at most so many cells in all:
# waking another thread takes longer than a step on a small image.
MOST_TOGETHER, TOGETHER_PX = 8, 500_000


@overload
def run(video: Openable, model: ModelNames, **options: Any) -> list[Result]: ...


@overload
def run(video: Openable, model: ModelName | None = None, **options: Any) -> Result: ...


def run(
    video: Openable,
    model: ModelName | ModelNames | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    on_frame: OnFrame = call.silent,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    overwrite: bool = False,
    clips: str | os.PathLike[str] | None = None,
    progress: Progress = no_progress,
    **options: Any,
) -> Result | list[Result]:
    """Run one model, or several, over a video that is decoded once.

    Parameters
    ----------
    video : str, path, or iterable of ndarray
        A video file, a folder of images, a pattern such as ``frames/%04d.png``, a TIFF stack, a
        ``.npy`` file, or images: an array (n, H, W) or (n, H, W, 3), or any iterable of them, see
        `open_video`. For images in memory, `fps` is their rate (30 unless given), and all are
        processed. For all other inputs, `fps` limits the rate; images, stacks and ``.npy`` files
        then need `input_fps`.
    model : optional
        A set's number (``9``), the name of a preset or a model (``"flight"``, ``"lgmd"``), a class,
        parameters, or a YAML file; a list of them runs several over one decoding. The default is
        the preset `flight`, see `parameters.presets.config_of`.
    param : mapping, optional
        Single parameters to override in all models, such as ``{"r": 4}``.
    formulation : str, optional
        The version of the D-LGMD, see `dlgmd run --help`.
    on_frame : callable, optional
        Called after each frame with the number of input frames done.
    out : str or path, optional
        Write the files of `dlgmd run` into ``out/NAME``, for one model, with figures in `formats`
        (PNG with `dpi`) and captions of the alarms (``"vtt"``); `overwrite` replaces an
        earlier result, and earlier clips.
    clips : str or path, optional
        Write a clip of each alarm into this folder.
    progress
        As in `batch`.
    options
        `scale`, `size`, `fps`, `repeats`, `input_fps`, `times`, `bit_depth`, `decoder`, `start`,
        `end` (seconds), `crop`, `mask`, `normalise` and `hashed`, see `dlgmd run --help`. `alarm`:
        the rule, a name, a subclass of `Rule` or ``"package.module:Class"``. `threshold`: the
        rule's threshold. Both are for `batch`, `compare`, `evaluate`, `calibrate` and `layers`,
        too. `speed_m_s`: a threshold in time for a stop from this speed, see `dlgmd run --help`.

    Returns
    -------
    Result or list of Result
        A single result; for a list of models, one result per model in the list's order.

    Raises
    ------
    SourceError
        If nothing can be decoded, or the video is too short for every model.
    ParameterError
        If a parameter or an option is not valid.
    MissingExtraError
        If a decoder needs a package that is not installed.
    OutputError, OutputExistsError
        If `out` cannot be written, or has a result that may not be replaced.

    Examples
    --------
    >>> result = run("flight.mp4", 9)  # doctest: +SKIP
    >>> result.summary["alarms"]  # doctest: +SKIP
    1
    """
    request = call.fold(model, formulation, param, options, video)
    formats = store.known_formats(formats, store.RUN)
    several = isinstance(model, list | tuple)
    if several and (out is not None or clips is not None):
        hint = "Give a single model, or call batch or compare."
        raise ParameterError("", "out and clips work only with one model", hint)
    if clips is not None:
        store.require_local(clips, "clips")
    with call.opened(video, request, store.RUN, out, overwrite=overwrite) as (source, claim):
        if clips is not None and not overwrite:
            refuse_clips(Path(clips), source.info.name)
        results = answers_of(source, request, progress, on_frame)
        for result in () if several else results:
            call.warn_of_input(source, request, result.warnings)
            _log_details(result)
        require_response(source, request, results)
        if claim is not None:
            results[0].write(claim, results[0].files(formats, dpi))
        if clips is not None and not results[0].interrupted:
            onsets_s = [alarm.start_s for alarm in results[0].alarm_list]
            info, of_images = source.info, request.options.of_images
            folder = Path(clips)
            with call.clips_written(info.given, info.name, onsets_s, folder, of_images) as written:
                pass
            _log.info("%s in %s.", counted(len(written), "clip"), clips)
    return results if several else results[0]


def answers_of(
    video: Video, request: Request, progress: Progress, on_frame: OnFrame = call.silent
) -> list[Result]:
    """The results of all models, with their failure if all images were black or frozen."""
    with call.watched(video, request, progress) as advance:

        def both(n_done: int) -> None:
            advance(n_done)
            on_frame(n_done)

        identity = identified(video, request.options)
        results = run_models(video, request, identity=identity, on_frame=both)
    if video.progress.blind:
        for result in results:
            result.failure = SourceError(video.info.given, video.progress.blind)
    return results


def _log_details(result: Result) -> None:
    """Log the input, the processed frames, and the model with its parameters."""
    record = result.record
    form = "Input: {path}, {width}x{height}, {fps:.6g} frames a second, decoded by {decoder}."
    _log.debug("%s", form.format(**record["input"]))
    form = "Processed: {frames} frames of {width}x{height}."
    _log.debug("%s", form.format(**record["processed"]))
    values = ", ".join(f"{key} = {value}" for key, value in result.params.to_dict().items())
    _log.debug("Model: %s, with %s.", record["model"], values)


def responses(
    video: Video,
    session: Session,
    *,
    layers: Callable[[Frame], bool] = lambda frame: False,
    picture_wh: tuple[int, int] | None = None,
    on_frame: OnFrame = call.silent,
) -> Iterator[tuple[Frame, list[Detection]]]:
    """Take a session through an input that is read once; the loop of all commands.

    Parameters
    ----------
    video : Video
        The source of the frames; a thread reads ahead.
    session : Session
        The models, each with its frame size, or None for the video's size; and the expansion.
    layers : callable
        Whether the answers to a frame have the layers.
    picture_wh : (int, int), optional
        Also give the images, at this size, see `Video.frames`.
    on_frame : callable
        Called after each frame with the number of input frames done.

    Yields
    ------
    frame, answers : Frame, list of Detection
        Each frame with the answer of each model. The stop flag ends the loop after a frame.
    """
    sizes_wh = [size_wh or video.size_wh for size_wh in session.sizes_wh]
    measures = session.expansion is not None
    frames = video.frames(*sizes_wh, small=measures, picture_wh=picture_wh)
    n_cells = sum(width * height for width, height in (*sizes_wh, picture_wh or (0, 0)))
    together = min(max(1, TOGETHER_PX // n_cells), MOST_TOGETHER)
    # OpenCV's threads would only compete with the decoder's threads.
    with opencv_threads(1), read_ahead(frames, together=together) as ahead:
        for frame in ahead:
            yield frame, session.step(frame, layers=layers(frame))
            on_frame(frame.index + 1)
            if cancel.requested():
                return


def run_models(
    video: Video,
    request: Request,
    *,
    identity: InputFacts | None = None,
    on_frame: OnFrame = call.silent,
    measures: bool = True,
) -> list[Result]:
    """Read `video` once, run every model on it, and measure its expansion beside them.

    Parameters
    ----------
    video : Video
        The source of the frames.
    asked : Request
        The models, and the options of the video, for the records and the normalisation.
    identity : InputFacts, optional
        What identifies the input in the records, if it is not the video's own.
    on_frame : callable
        Called after each frame with the number of input frames done.
    measures : bool
        Whether the expansion is measured.

    Returns
    -------
    list of Result
        One per setup. Their records say ``complete: false`` if not all of the input was used, and
        ``interrupted: true`` if the stop flag ended the loop.

    Raises
    ------
    Interrupted
        If the stop flag ended the loop before the first frame.
    SourceError
        If an image in memory is not as it must be; the error has the results up to it.
    """
    session = session_on(video, request.setups, request.options, measures=measures)
    collected = [RowList(model.columns) for model in session.models]
    fault: SourceError | None = None
    try:
        for _, answers in responses(video, session, on_frame=on_frame):
            for row_list, answer in zip(collected, answers, strict=True):
                row_list.append(answer)
    except SourceError as error:
        if not collected[0]:
            raise
        fault = error
    interrupted = cancel.requested()
    if interrupted and not collected[0]:
        raise cancel.Interrupted
    is_read, results = not (interrupted or fault), []
    camera, entry = camera_of_video(video, request.options)
    for setup, model, row_list in zip(request.setups, session.models, collected, strict=True):
        result = build_result(
            video,
            setup,
            model,
            row_list.rows(),
            request.options,
            identity,
            is_read=is_read,
            complete=is_read and video.progress.is_whole,
            interrupted=interrupted,
            more=entry,
        )
        doubts, is_measured = doubts_of(result, camera, video.source_wh)
        result.warnings.extend(doubts)
        heading = request.options.heading if measures and is_measured else None
        if heading is not None:
            unheaded = not_headed(heading, camera, video.source_wh, result.frame)
            result.warnings.extend([unheaded] if unheaded else [])
        if heading is not None and result.complete:
            beyond = headings_beyond(heading, result.record["input"]["frames"])
            result.warnings.extend([beyond] if beyond else [])
        results.append(result)
    if fault is not None:
        fault.results = tuple(results)
        raise fault
    return results


def doubts_of(result: Result, camera: Camera, source_wh: tuple[int, int]) -> tuple[list[str], bool]:
    """The warnings about a result, and whether its expansion can be measured.

    `source_wh` is the size of the processed images, (width, height) in px before reduction.
    """
    unmeasured = too_small(source_wh) or outside(camera, source_wh)
    lines = result.doubts()
    if result.rule.uses_expansion and unmeasured:
        lines.append(unmeasured)
    return lines, not unmeasured


def camera_of_video(video: Video, options: InputOptions) -> tuple[Camera, RunFacts]:
    """The camera of a video, and the camera's entry in a record, see `camera_of`."""
    return camera_of(options, (video.info.width, video.info.height), video.info.path)


def session_on(
    video: Video, setups: Sequence[Setup], options: InputOptions, *, measures: bool = False
) -> Session:
    """The models, each at its frame size on a video, without the cells that the mask hides.

    With `measures`, the session also measures the expansion.
    """
    sizes_wh = [setup.size_on(video, options) for setup in setups]
    models = [create_model(setup.params) for setup in setups]
    for model, size_wh in zip(models, sizes_wh, strict=True):
        model.ignore(video.hidden(size_wh))
    if not measures:
        return Session(models, sizes_wh=sizes_wh)
    camera, _ = camera_of_video(video, options)
    expansion = Expansion(camera=camera)
    expansion.ignore(video.hidden(small_wh(*video.source_wh)))
    headings = None if options.heading is None else read_headings(options.heading)
    return Session(models, expansion, sizes_wh, headings)


def identified(
    video: Video, options: InputOptions, identity: InputFacts | None = None
) -> InputFacts:
    """The facts that identify an input in a record, with its SHA-256.

    By default, coded local videos and images of up to 2 GB are hashed, but not raw frames: hashing
    takes as long as reading them. With the option `hashed`, any file is hashed; raises SourceError
    if the file cannot be read.
    """
    info = video.info
    known: InputFacts = {**(info.identity if identity is None else identity)}
    is_coded = info.codec not in ("", "array", "rawvideo")
    is_worth_it = is_coded and not is_url(str(known.get("path")))
    if options.hashed or (options.hashed is None and is_worth_it):
        most_bytes = math.inf if options.hashed else HASHED_BYTES
        with nullcontext() if options.hashed else suppress(SourceError):
            if digest := content_sha256(info.path, most_bytes):
                known["content_sha256"] = digest
    return known


def build_result(
    video: Video,
    setup: Setup,
    model: Model,
    rows: Rows,
    options: InputOptions,
    identity: InputFacts | None = None,
    *,
    is_read: bool,
    complete: bool,
    interrupted: bool,
    more: RunFacts,
) -> Result:
    """The result of a model, see `input_record`; `more` are entries of its record."""
    record: Record = {
        **input_record(video, setup.size_on(video, options), rows, identity, is_read=is_read),
        **model_record(setup, model),
        "options": options.to_record(),
        **more,
        "warnings": [*video.progress.warnings],
        "complete": complete,
        "interrupted": interrupted,
    }
    return Result.of(rows, setup.params, record)


def model_record(setup: Setup, model: Model) -> Record:
    """The entries of a record about the model: name, parameters and the model's own columns."""
    record: Record = {**setup.config.named, **setup.settings()}
    return {**record, "columns": [*model.columns]} if model.columns else record


def processed_record(size_wh: tuple[int, int], n_frames: int, hidden: Flags | None) -> Processed:
    """The entry `processed` of a record; `hidden`, (H, W), marks the cells that the mask hides."""
    processed: Processed = {"width": size_wh[0], "height": size_wh[1], "frames": n_frames}
    if hidden is not None:
        processed["cells"] = int(np.count_nonzero(~hidden))
    return processed


def input_record(
    video: Video,
    size_wh: tuple[int, int],
    rows: Rows,
    identity: InputFacts | None = None,
    *,
    is_read: bool = True,
) -> RunFacts:
    """The entries `input` and `processed` of a record.

    If the video was not read to the requested end (`is_read`), the counts are those of the result's
    rows, since decoding may be ahead.
    """
    info, progress = video.info, video.progress
    n_frames, last_s = progress.n_decoded, progress.last_time_s
    if not is_read:
        n_frames, last_s = int(rows["frame"][-1]) + 1, float(rows["time_s"][-1])
    contact_s, n_repeats = csv.contact_beside(info.path), progress.n_repeats
    if n_repeats is not None and not is_read:
        n_repeats = int(rows["repeat"].sum())
    facts: InputFacts = {
        "path": info.path,
        "name": info.name,
        "width": info.width,
        "height": info.height,
        "fps": info.fps,
        "frames": n_frames,
        "duration_s": last_s + 1.0 / info.fps,
        "decoder": info.decoder,
    }
    if video.info.is_interlaced:
        facts["deinterlaced"] = "bwdif"
    if contact_s is not None:
        facts["contact_s"] = contact_s
    if n_repeats is not None:
        facts["repeats"] = n_repeats
    known = info.identity if identity is None else identity
    return {
        "input": {**facts, **known},
        "processed": processed_record(size_wh, len(rows), video.hidden(size_wh)),
    }


def require_response(video: Video, request: Request, results: Sequence[Result]) -> None:
    """Raise SourceError if the input ended before any model had a full history."""
    if any(result.n_valid for result in results) or results[0].interrupted:
        return
    needs = [create_model(setup.params).first_valid_frame + 1 for setup in request.setups]
    n_needed = min(needs)
    raise too_short(video, request.setups[needs.index(n_needed)].label, n_needed, request.options)


def too_short(video: Video, label: str, n_needed: int, options: InputOptions) -> SourceError:
    """The error for an input with fewer frames than a model needs."""
    name, n_read, n_new = video.info.given, video.progress.n_decoded, video.progress.n_new
    if options.start or options.end is not None or options.fps not in (None, "all"):
        last_s = video.progress.last_time_s
        end = "" if math.isnan(last_s) else f"Its last frame read is at {last_s:.3f} s."
        cut = f"{argument('start')}, {argument('end')} and {argument('fps')}"
        why = f"{cut} leave fewer than the {n_needed} frames that {label} needs"
        return SourceError(name, why, end)
    frames = counted(n_read, "frame")
    needs = f"but {label} needs at least {n_needed}"
    if n_new < n_needed <= n_read:
        why = f"{frames}, of which the model processes {n_new}, {needs}"
        every = f"{argument('repeats', 'keep')} and {argument('fps', 'all')}"
        return SourceError(name, why, f"Use a longer clip, or {every}.")
    return SourceError(name, f"{frames}, {needs}", "Use a longer clip.")
