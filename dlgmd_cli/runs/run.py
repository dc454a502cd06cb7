"""The main loop: decode a video once and step every model. `run` is the library's entry point."""

import math
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from typing import Any, overload

import numpy as np

from dlgmd_cli import cancel
from dlgmd_cli.errors import SourceError
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import Response, create_model
from dlgmd_cli.models.step import Stepper
from dlgmd_cli.results.record import packed_flags
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.rows import RowList, Rows
from dlgmd_cli.runs.setup import ModelName, Setup, choose_all, common_options
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead
from dlgmd_cli.video.source import Video
from dlgmd_cli.words import counted

OnFrame = Callable[[int], None]
# Takes a name, a total (None if unknown) and a unit; yields a callback for the number done, which
# may be followed by another name.
Progress = Callable[[str, int | None, str], AbstractContextManager[Callable[..., None]]]


def silent(*_: Any) -> None:
    """The default callback."""


def no_progress(*_: Any) -> AbstractContextManager[Callable[..., None]]:
    """The default `Progress`."""
    return nullcontext(silent)


@overload
def run(video: Openable, models: None = None, **options: Any) -> Result: ...


@overload
def run(video: Openable, models: Sequence[ModelName | int], **options: Any) -> list[Result]: ...


def run(
    video: Openable,
    models: Sequence[ModelName | int] | None = None,
    *,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    on_frame: OnFrame = silent,
    **options: Any,
) -> Result | list[Result]:
    """Run one model, or several, over a video that is decoded once.

    Parameters
    ----------
    video : str, path, or iterable of ndarray
        A video file, a folder of pictures, a pattern such as ``frames/%04d.png``, a ``.npy`` file,
        or images: an array (n, H, W) or (n, H, W, 3), or any iterable of them, see `open_video`.
        Of images in memory, `fps` alone is their rate, 30 unless given, and all are processed.
        Everywhere else `fps` limits a rate: pictures and ``.npy`` files need `input_fps` for that.
    models : sequence, optional
        Several models: parameters, classes of models, or names of sets (``9``), models (``"lgmd"``)
        and presets (``"flight"``). They may not be given with `set`, `config` or `model`.
    set, config, model : optional
        One of the paper's sets; a YAML file or the name of a preset; a model by its name
        (``"package.module:Class"`` for one's own), class or parameters. The default is the preset
        `flight`.
    param : mapping, optional
        Single parameters to override in all models, such as ``{"r": 4}``.
    formulation : str, optional
        Whose version of the D-LGMD, see `dlgmd run --help`.
    engine : str, optional
        `opencv` or `numba`; chosen by frame size unless given.
    on_frame : callable, optional
        Called after each frame with the number of input frames done.
    options
        `scale`, `size`, `fps`, `repeats`, `input_fps`, `decoder`, `start`, `end` (seconds), `crop`,
        `mask` and `normalise`, see `dlgmd run --help`.

    Returns
    -------
    Result or list of Result
        A single result, or one for each of `models` in their order.

    Raises
    ------
    SourceError
        If nothing can be decoded, or the video is too short for every model.
    ParameterError
        If a parameter or an option is not valid.
    MissingExtraError
        If an engine or a decoder needs a package that is not installed.

    Examples
    --------
    >>> result = run("flight.mp4", set=9)  # doctest: +SKIP
    >>> result.summary["alarms"]  # doctest: +SKIP
    1
    """
    setups = choose_all(models, set, config, model, param, formulation, engine)
    shared = common_options(setups, given_options(video, options))
    results = run_input(video, setups, shared, on_frame=on_frame)
    return results[0] if models is None else results


def given_options(video: Openable, options: Mapping[str, Any]) -> dict[str, Any]:
    """The options as they are given, but `fps` is the rate of images in memory that have none."""
    found = dict(options)
    if not isinstance(video, str | os.PathLike) and found.get("input_fps") is None:
        found["input_fps"] = found.pop("fps", None)
    return found


def run_input(
    source: Openable, setups: Sequence[Setup], options: InputOptions, *, on_frame: OnFrame = silent
) -> list[Result]:
    """Open an input, run every model on it and close it; raises what `run` raises."""
    with open_input(source, setups, options) as video:
        results = run_models(video, setups, options, on_frame=on_frame)
        require_response(video, setups, results, options)
    return results


def open_input(source: Openable, setups: Sequence[Setup], options: InputOptions) -> Video:
    """Open an input for models; raises what `open_video` raises.

    By default, the frame size is that of the first model and the frame rate that of the fastest. If
    one of the models has the formulation `released`, every frame is read, repeats included.
    """
    is_released = any(one.params.to_dict().get("formulation") == "released" for one in setups)
    model_fps = None if is_released else max(one.model_fps for one in setups)
    return options.open(source, width_px=setups[0].width_px, model_fps=model_fps)


def responses(
    video: Video,
    steppers: Sequence[Stepper],
    *,
    layers: Callable[[Frame], bool] = lambda frame: False,
    picture_wh: tuple[int, int] | None = None,
    on_frame: OnFrame = silent,
) -> Iterator[tuple[Frame, list[Response]]]:
    """Step models through an input that is read once; the loop of all commands.

    Parameters
    ----------
    video : Video
        Where the frames come from; a thread reads ahead.
    steppers : sequence of Stepper
        The models, each with its frame size, or None for the video's.
    layers : callable
        Whether the responses to a frame have the layers.
    picture_wh : (int, int), optional
        Also give the pictures, at this size, see `Video.frames`.
    on_frame : callable
        Called after each frame with the number of input frames done.

    Yields
    ------
    frame, responses : Frame, list of Response
        Each frame with one response per stepper. The stop flag ends the loop after a frame.
    """
    sizes = [one.size_wh or video.size_wh for one in steppers]
    frames = video.frames(*sizes, picture_wh=picture_wh)
    # OpenCV's threads would only compete with those of the decoder.
    with opencv_threads(1), read_ahead(frames) as ahead:
        for frame in ahead:
            wants_layers = layers(frame)
            yield frame, [one.step(frame, layers=wants_layers) for one in steppers]
            on_frame(frame.index + 1)
            if cancel.requested():
                return


def run_models(
    video: Video,
    setups: Sequence[Setup],
    options: InputOptions,
    *,
    identity: Mapping[str, Any] | None = None,
    on_frame: OnFrame = silent,
) -> list[Result]:
    """Read `video` once and run every model on it.

    Parameters
    ----------
    video : Video
        The source of the frames.
    setups : sequence of Setup
        At least one model.
    options : InputOptions
        Options of the video, for the records and the normalisation.
    identity : mapping, optional
        Identity of the input for the records, if it is not the video's own.
    on_frame : callable
        Called after each frame with the number of input frames done.

    Returns
    -------
    list of Result
        One per setup. If the stop flag ended the loop, the results hold the frames before it, and
        their records say ``complete: false``.

    Raises
    ------
    Interrupted
        If the stop flag ended the loop before the first frame.
    """
    steppers = [stepper_on(video, one, options) for one in setups]
    collected = [RowList() for _ in setups]
    for frame, found in responses(video, steppers, on_frame=on_frame):
        for one, response in zip(collected, found, strict=True):
            one.append(frame, response)
    complete = not cancel.requested()
    if not complete and not collected[0]:
        raise cancel.Interrupted
    results = []
    for setup, stepper, one in zip(setups, steppers, collected, strict=True):
        rows, size_wh = one.rows(), stepper.size_wh or video.size_wh
        facts = input_record(video, size_wh, rows, identity, is_read=complete)
        result = build_result(setup, stepper, rows, options, facts, complete=complete)
        result.warnings.extend([*video.progress.warnings, *result.doubts()])
        results.append(result)
    return results


def stepper_on(video: Video, setup: Setup, options: InputOptions) -> Stepper:
    """A model at its frame size on a video, without the cells that the mask hides."""
    size_wh = setup.size_on(video, options)
    stepper = Stepper(setup.params, engine=setup.engine, size_wh=size_wh)
    stepper.ignore(video.hidden(size_wh))
    return stepper


def build_result(
    setup: Setup,
    stepper: Stepper,
    rows: Rows,
    options: InputOptions,
    facts: Mapping[str, Any],
    *,
    complete: bool,
    **more: Any,
) -> Result:
    """The result of a model; `facts` (see `input_record`) and `more` are entries of its record."""
    record = {
        **facts,
        **setup.named,
        **setup.settings(),
        "engine": stepper.model.engine_name,
        "options": options.to_record(),
        **more,
        "warnings": [],
        "complete": complete,
    }
    return Result(rows, setup.params, record)


def input_record(
    video: Video,
    size_wh: tuple[int, int],
    rows: Rows,
    identity: Mapping[str, Any] | None = None,
    *,
    is_read: bool = True,
) -> dict[str, Any]:
    """The entries `input` and `processed` of a record.

    If the video was not read to the requested end (`is_read`), the counts are those of the rows,
    since decoding may be ahead.
    """
    info, progress = video.info, video.progress
    width, height = size_wh
    n_frames, last_s = progress.n_decoded, progress.last_time_s
    if not is_read:
        n_frames, last_s = int(rows["frame"][-1]) + 1, float(rows["time_s"][-1])
    processed = {"width": width, "height": height, "frames": len(rows)}
    if (hidden := video.hidden(size_wh)) is not None:
        processed["cells"] = int(np.count_nonzero(~hidden))
    repeats: dict[str, Any] = {}
    if progress.n_repeats is not None:
        n_repeated = int(rows["is_repeat"].sum())
        repeats["repeats"] = progress.n_repeats if is_read else n_repeated
    if rows["is_repeat"].any():
        repeats["repeated_rows"] = packed_flags(rows["is_repeat"].tobytes())
    return {
        "input": {
            "path": info.path,
            "name": info.name,
            "width": info.width,
            "height": info.height,
            "fps": info.fps,
            "frames": n_frames,
            "duration_s": last_s + 1.0 / info.fps,
            "decoder": info.decoder,
            **({"deinterlaced": "bwdif"} if video.info.is_interlaced else {}),
            **repeats,
            **(info.identity if identity is None else identity),
        },
        "processed": processed,
    }


def require_response(
    video: Video, setups: Sequence[Setup], results: Sequence[Result], options: InputOptions
) -> None:
    """Raise SourceError if the input ended before any model had a full history."""
    if any(result.n_valid for result in results) or not results[0].record["complete"]:
        return
    needs = [create_model(one.params).first_valid_frame + 1 for one in setups]
    n_needed = min(needs)
    raise too_short(video, setups[needs.index(n_needed)].label, n_needed, options)


def too_short(video: Video, label: str, n_needed: int, options: InputOptions) -> SourceError:
    """The error for an input with fewer frames than a model needs."""
    name, n_read, n_new = video.info.given, video.progress.n_decoded, video.progress.n_new
    if options.start or options.end is not None or options.fps not in (None, "all"):
        last_s = video.progress.last_time_s
        end = "" if math.isnan(last_s) else f"Its last frame read is at {last_s:.3f} s."
        why = f"--start, --end and --fps leave fewer than the {n_needed} frames that {label} needs"
        return SourceError(name, why, end)
    frames = counted(n_read, "frame")
    if n_new < n_needed <= n_read:
        why = f"{frames}, of which the model sees {n_new}, but {label} needs at least {n_needed}"
        return SourceError(name, why, "Use a longer clip, or --repeats keep and --fps all.")
    return SourceError(
        name, f"{frames}, but {label} needs at least {n_needed}", "Use a longer clip."
    )
