"""The main loop: decode a video once and step every model. `run` is the library's entry point."""

import math
import os
from array import array
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import fields
from typing import Any, overload

import numpy as np

from dlgmd_cli import cancel
from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.models.base import Model, Response, create_model
from dlgmd_cli.parameters import MODELS, PRESETS, Parameters
from dlgmd_cli.results.record import packed_flags
from dlgmd_cli.results.result import Result
from dlgmd_cli.runs.setup import Setup, choose, input_options
from dlgmd_cli.video.frames import Frame, Video, VideoInfo, fingerprint
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead

OnFrame = Callable[[int], None]
# Columns of a row: frame, time_s, p_sum, s_sum, attenuation_db, mp, g_x, g_y.
_N_COLUMNS = 8


def silent(*_: Any) -> None:
    """The default callback."""


@overload
def run(video: str | os.PathLike[str], models: None = None, **options: Any) -> Result: ...


@overload
def run(
    video: str | os.PathLike[str], models: Sequence[Parameters | str | int], **options: Any
) -> list[Result]: ...


def run(
    video: str | os.PathLike[str],
    models: Sequence[Parameters | str | int] | None = None,
    *,
    set: str | int | None = None,
    config: str | os.PathLike[str] | None = None,
    model: str | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
    on_frame: OnFrame = silent,
    **options: Any,
) -> Result | list[Result]:
    """Run one model, or several, over a video that is decoded once.

    Parameters
    ----------
    video : str or path
        A video file, a folder of pictures, or a pattern such as ``frames/%04d.png``.
    models : sequence, optional
        The models: parameters, or names of sets (``9``), models (``"lgmd"``) and presets
        (``"flight"``). Without it, one model is run, given by `set`, `config` and `model`.
    set, config, model, formulation : optional
        One of the paper's sets; a YAML file or the name of a preset; the name of a model; how
        delays that are not whole frames are rounded. The default is the preset `flight`.
    param : mapping, optional
        Single parameters to override, such as ``{"r": 4}``.
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
    for name in options.keys() - {one.name for one in fields(InputOptions)}:
        known = ", ".join(one.name for one in fields(InputOptions))
        raise ParameterError("run", f"there is no option {name!r}", f"Choose from {known}.")
    if models is None:
        setup = choose(set, config, model, param, formulation, engine)
        return run_input(video, [setup], input_options(setup, options), on_frame=on_frame)[0]
    setups = [_setup(one, engine) for one in models]
    return run_input(video, setups, InputOptions(**options), on_frame=on_frame)


def _setup(model: Parameters | str | int, engine: str | None) -> Setup:
    """The setup for an entry of `models`."""
    if isinstance(model, Parameters):
        return Setup(model, model.model, engine or "auto")
    if model in MODELS:
        return choose(model=str(model), engine=engine)
    if model in PRESETS:
        return choose(config=str(model), engine=engine)
    return choose(set=str(model).removeprefix("set"), engine=engine)


def run_input(
    path: str | os.PathLike[str],
    setups: Sequence[Setup],
    options: InputOptions,
    *,
    on_frame: OnFrame = silent,
) -> list[Result]:
    """Open an input, run every model on it and close it; raises what `run` raises."""
    with open_input(path, setups, options) as video:
        results = run_models(video, setups, options, identity=fingerprint(path), on_frame=on_frame)
        require_response(os.fspath(path), video, setups, results, options)
    return results


def open_input(
    path: str | os.PathLike[str], setups: Sequence[Setup], options: InputOptions
) -> Video:
    """Open an input for models; raises what `open_video` raises.

    By default, the frame size is that of the first model and the frame rate that of the fastest. If
    one of the models has the formulation `released`, every frame is read, repeats included.
    """
    is_released = any(one.params.to_dict().get("formulation") == "released" for one in setups)
    model_fps = None if is_released else max(one.model_fps for one in setups)
    return options.open(path, width_px=setups[0].width_px, model_fps=model_fps)


def run_models(
    video: Video,
    setups: Sequence[Setup],
    options: InputOptions,
    *,
    identity: Mapping[str, Any],
    on_frame: OnFrame = silent,
) -> list[Result]:
    """Decode `video` once and step every model; the loop of all commands.

    Parameters
    ----------
    video : Video
        The source of the frames.
    setups : sequence of Setup
        At least one model.
    options : InputOptions
        Options of the video, for the records and the normalisation.
    identity : mapping
        Identity of the input for the records, see `fingerprint`.
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
    models = [create_model(one.params, engine=one.engine) for one in setups]
    sizes = [one.size_on(video, options) for one in setups]
    for model, size_wh in zip(models, sizes, strict=True):
        model.ignore(video.hidden(size_wh))
    rows, repeated = [array("d") for _ in setups], bytearray()
    complete = _step_models(video, models, sizes, rows, repeated, on_frame)
    if not complete and not rows[0]:
        raise cancel.Interrupted
    results = []
    for setup, model, size_wh, values in zip(setups, models, sizes, rows, strict=True):
        result = build_result(
            *(values, repeated, video, size_wh, setup, model, options, identity),
            was_read=complete,
            complete=complete,
        )
        result.warnings.extend(result.doubts())
        results.append(result)
    return results


def build_result(
    rows: "array[float]",
    repeated: bytearray,
    video: Video,
    size_wh: tuple[int, int],
    setup: Setup,
    model: Model,
    options: InputOptions,
    identity: Mapping[str, Any],
    *,
    was_read: bool,
    complete: bool,
    **facts: Any,
) -> Result:
    """Build the result of a model from the numbers of its frames.

    `rows` holds eight numbers per frame, `repeated` whether each frame repeats the previous one.
    `was_read` tells whether the video was read to the requested end. `complete` and `facts` are
    entries of the record.
    """
    columns = np.array(rows).reshape(-1, _N_COLUMNS).T.copy()
    frame, time_s, p_sum, s_sum, attenuation_db, mp, g_x, g_y = columns
    n_read = None if was_read else (int(frame[-1]) + 1, float(time_s[-1]))
    record = {
        **input_record(video, size_wh, len(frame), identity, n_read, repeated),
        **setup.named,
        **setup.settings(),
        "engine": model.engine_name,
        "options": options.to_record(),
        **facts,
        "warnings": list(video.progress.warnings),
        "complete": complete,
    }
    numbers = time_s, mp, p_sum, s_sum, attenuation_db, g_x, g_y
    return Result(frame.astype(np.int64), *numbers, setup.params, record)


def _step_models(
    video: Video,
    models: Sequence[Model],
    sizes: Sequence[tuple[int, int]],
    rows: Sequence["array[float]"],
    repeated: bytearray,
    on_frame: OnFrame,
) -> bool:
    """Step every model with every frame and store the numbers; False if the stop flag ended it.

    Models do not see repeats: the row of a repeat is a copy of the previous row. After a gap in
    time, the models are reset.
    """
    distinct = list(dict.fromkeys(sizes))

    def frames() -> Iterator[dict[tuple[int, int], Frame]]:
        for picture in video.pictures():
            yield {size: video.frame(picture, size) for size in distinct}

    # OpenCV's threads would only compete with those of the decoder.
    with opencv_threads(1), read_ahead(frames()) as ahead:
        for by_size in ahead:
            for model, size_wh, values in zip(models, sizes, rows, strict=True):
                frame = by_size[size_wh]
                if frame.is_repeat:
                    sums = tuple(values[2 - _N_COLUMNS :])
                else:
                    if frame.after_gap:
                        model.reset()
                    sums = numbers_of(model.step(frame.grey, frame.time_s))
                values.extend((frame.index, frame.time_s, *sums))
            repeated.append(frame.is_repeat)
            on_frame(frame.index + 1)
            if cancel.requested():
                return False
    return True


def numbers_of(response: Response) -> tuple[float, ...]:
    """The columns of a row after the frame and its time."""
    sums = response.p_sum, response.s_sum, response.attenuation_db
    return *sums, response.mp, response.g_x, response.g_y


def input_record(
    video: Video,
    size_wh: tuple[int, int],
    n_processed: int,
    identity: Mapping[str, Any],
    n_read: tuple[int, float] | None = None,
    repeated: bytes | bytearray = b"",
) -> dict[str, Any]:
    """The entries `input` and `processed` of a record.

    If reading was stopped, `n_read` is the number of processed frames and the time of the last one,
    since decoding may be ahead. `repeated` tells which processed frames repeat the previous one.
    """
    info, progress = video.info, video.progress
    frames, last_s = n_read or (progress.n_decoded, progress.last_time_s)
    repeats: dict[str, Any] = {}
    if progress.n_repeats is not None:
        repeats["repeats"] = sum(repeated) if n_read else progress.n_repeats
    processed = {"width": size_wh[0], "height": size_wh[1], "frames": n_processed}
    if (hidden := video.hidden(size_wh)) is not None:
        processed["cells"] = int(np.count_nonzero(~hidden))
    if any(repeated):
        repeats["repeated_rows"] = packed_flags(repeated)
    return {
        "input": {
            "path": info.path,
            "width": info.width,
            "height": info.height,
            "fps": info.fps,
            "frames": frames,
            "duration_s": last_s + 1.0 / info.fps,
            "decoder": info.decoder,
            **repeats,
            **identity,
        },
        "processed": processed,
    }


def input_identity(info: VideoInfo, path: str | os.PathLike[str]) -> dict[str, Any]:
    """Identity of an input: its path, size and modification time, see `fingerprint`."""
    return {"path": info.path, **fingerprint(path)}


def require_response(
    name: str,
    video: Video,
    setups: Sequence[Setup],
    results: Sequence[Result],
    options: InputOptions,
) -> None:
    """Raise SourceError if the input ended before any model had a full history."""
    if any(result.n_valid for result in results) or not results[0].record["complete"]:
        return
    needs = [create_model(one.params).first_valid_frame + 1 for one in setups]
    n_needed = min(needs)
    raise too_short(name, video, setups[needs.index(n_needed)].label, n_needed, options)


def too_short(
    name: str, video: Video, label: str, n_needed: int, options: InputOptions
) -> SourceError:
    """The error for an input with fewer frames than a model needs."""
    n_read, n_new = video.progress.n_decoded, video.progress.n_new
    if options.start or options.end is not None or options.fps not in (None, "all"):
        last_s = video.progress.last_time_s
        end = "" if math.isnan(last_s) else f"Its last frame read is at {last_s:.3f} s."
        why = f"--start, --end and --fps leave fewer than the {n_needed} frames that {label} needs"
        return SourceError(name, why, end)
    frames = f"{n_read} frame{'s' * (n_read > 1)}"
    if n_new < n_needed <= n_read:
        why = f"{frames}, of which the model sees {n_new}, but {label} needs at least {n_needed}"
        return SourceError(name, why, "Use a longer clip, or --repeats keep and --fps all.")
    return SourceError(
        name, f"{frames}, but {label} needs at least {n_needed}", "Use a longer clip."
    )
