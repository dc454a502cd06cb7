"""`run`: decode a video once and step every model."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, overload

from dlgmd_cli.errors import ParameterError, counted
from dlgmd_cli.parameters.facts import Value, stating
from dlgmd_cli.results import store
from dlgmd_cli.results.result import Result
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import RUN_ARGUMENTS, ModelName, ModelNames, Progress, no_progress
from dlgmd_cli.tasks.stepping import answers_of, require_response
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.writer import refuse_clips

_log = logging.getLogger(__name__)


@overload
def run(video: Openable, model: ModelNames, **options: Any) -> list[Result]: ...


@overload
def run(video: Openable, model: ModelName | None = None, **options: Any) -> Result: ...


@stating(RUN_ARGUMENTS)
def run(
    video: Openable,
    model: ModelName | ModelNames | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
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
        ``.npy`` or ``.npz`` file, or images: an array (n, H, W) or (n, H, W, 3), or any iterable
        of them, see `open_video`. For images in memory, `fps` is their rate (30 unless given), and
        all are processed. For all other inputs, `fps` limits the rate; images, arrays and stacks
        without times then need `input_fps`.
    model : optional
        A set's number (``9``), the name of a preset or a model (``"flight"``, ``"lgmd"``), a class,
        parameters, or a YAML file; a list of them runs several over one decoding. The default is
        the preset `flight`, see `parameters.presets.config_of`.
    param : mapping, optional
        Single parameters to override in all models, such as ``{"r": 4}``.
    formulation : str, optional
        The version of the D-LGMD: ``"default"``, ``"equations"``,
        ``"released-2021"`` or ``"released-2020"``.
    out : str or path, optional
        Write the files of `dlgmd run` into ``out/NAME``, for one model, with figures in `formats`
        (PNG with `dpi`) and captions of the alarms (``"vtt"``); `overwrite` replaces an
        earlier result, and earlier clips.
    clips : str or path, optional
        Write a clip of each alarm into this folder.
    progress
        As in `batch`.
    options
        Options of the input and of the rule, named as those of `dlgmd run`. `alarm` may also be a
        subclass of `Rule`. With `hashed`, the record has the SHA-256 of an input of any size.

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
        results = answers_of(source, request, progress)
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


def _log_details(result: Result) -> None:
    """Log the input, the processed frames, and the model with its parameters."""
    record = result.record
    form = "Input: {path}, {width}x{height}, {fps:.6g} frames a second, decoded by {decoder}."
    _log.debug("%s", form.format(**record["input"]))
    form = "Processed: {frames} frames of {width}x{height}."
    _log.debug("%s", form.format(**record["processed"]))
    values = ", ".join(f"{key} = {value}" for key, value in result.params.to_dict().items())
    _log.debug("Model: %s, with %s.", record["model"], values)
