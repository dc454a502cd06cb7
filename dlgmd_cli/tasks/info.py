"""What videos are like: size, codec, frame rate, duplicate frames, damage."""

import logging
import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, ParameterError, printable
from dlgmd_cli.results import store
from dlgmd_cli.results.info import Info
from dlgmd_cli.tasks.call import Progress, no_progress
from dlgmd_cli.video.base import DEFAULT_DECODER
from dlgmd_cli.video.survey import Survey, survey

_log = logging.getLogger(__name__)

Place = str | os.PathLike[str]


def info(
    videos: Place | Iterable[Place],
    *,
    input_fps: float | None = None,
    decoder: str | None = None,
    topic: str | None = None,
    write_mask: Place | None = None,
    overwrite: bool = False,
    progress: Progress = no_progress,
) -> Info:
    """Describe videos: size, codec, frame rate, duplicate frames, damage; each is read to its end.

    Parameters
    ----------
    videos : str, path, or iterable of them
        Video files, folders of images or patterns. Of several, one that cannot be read does not
        stop the others.
    input_fps, decoder, topic
        As in `run`. Of several topics without `topic`, the first is described, and all are listed.
    write_mask : str or path, optional
        Write a mask of a single video into this .png, black where pixels never change; an earlier
        file is replaced only with `overwrite`.
    progress
        As in `batch`.

    Returns
    -------
    Info
        `surveys` has what was found, and `failed` says why a video could not be read.

    Raises
    ------
    SourceError
        If a single video cannot be read, or has no pixels that never change.
    ParameterError, MissingExtraError, OutputError, OutputExistsError
        As in `run`.

    Examples
    --------
    >>> info("flight.mp4").surveys[0].repeats  # doctest: +SKIP
    40
    """
    paths = [os.fspath(p) for p in ([videos] if isinstance(videos, str | os.PathLike) else videos)]
    mask = None if write_mask is None else Path(write_mask)
    if mask is not None:
        if len(paths) > 1:
            raise ParameterError("", "--write-mask works with one INPUT")
        store.refuse_existing(mask, overwrite=overwrite, named_by="write_mask")
    surveys: list[Survey] = []
    failed: dict[str, str] = {}
    for path in paths:
        try:
            with progress(path, None, "frame") as on_frame:
                chosen = decoder or DEFAULT_DECODER
                known: Any = {"decoder": chosen, "input_fps": input_fps, "topic": topic}
                surveyed = survey(path, **known, on_frame=on_frame)
        except DlgmdError as error:
            if len(paths) == 1:
                raise
            _log.error("%s", str(error).rstrip("."))
            failed[path] = printable(str(error))
            continue
        surveys.append(surveyed)
        for warning in surveyed.warnings:
            _log.warning("%s: %s", path, warning)
    made = Info(surveys, failed, paths)
    if mask is not None:
        files = {mask.name: store.file_of(made.mask())}
        how: Any = {"overwrite": overwrite, "named_by": "write_mask", "locks": False}
        with store.claimed(mask.parent, names=files, **how) as claim:
            made.paths = claim.write(files)
    return made
