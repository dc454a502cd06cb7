"""From what a user typed to frames: a video, a folder of pictures, or a pattern."""

import math
import os
from pathlib import Path

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.video.frames import Reader
from dlgmd_cli.video.images import ImageReader, in_folder, is_pattern, matching
from dlgmd_cli.video.prepare import Selection, Source, processed_size
from dlgmd_cli.video.reader import DECODERS, DEFAULT_DECODER, VideoReader


def open_reader(
    path: str | os.PathLike[str], fps: float | None = None, decoder: str = DEFAULT_DECODER
) -> Reader:
    """A reader for a video file, a folder of pictures, or a pattern of pictures.

    Parameters
    ----------
    path : str or path
        What exists under this name is taken as it is; only otherwise it may be a pattern.
    fps : float, optional
        Frames per second where the input does not say.
    decoder : str
        What decodes a video.

    Raises
    ------
    SourceError
        If there is nothing to decode.
    ParameterError
        If there is no such decoder.
    MissingExtraError
        If the decoder's package is not installed.
    """
    if decoder not in DECODERS:
        raise ParameterError(
            "", f"there is no decoder {decoder!r}", f"Choose from {', '.join(DECODERS)}."
        )
    text = os.fspath(path)
    file = Path(text)
    try:
        exists = file.exists()
    except (OSError, ValueError) as error:  # a name too long, or with a NUL
        raise SourceError(text[:80], f"not a usable path ({error})") from None
    if file.is_dir():
        absolute = file.resolve()
        return ImageReader(in_folder(file), absolute, absolute.name or "root", fps)
    if not exists and is_pattern(text):
        folder = file.parent.absolute()
        while is_pattern(folder.name):
            folder = folder.parent
        return ImageReader(matching(text), file.absolute(), folder.resolve().name or "root", fps)
    return VideoReader(file, fps, decoder)


def open_source(
    path: str | os.PathLike[str],
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | None = None,
    start_s: float = 0.0,
    end_s: float = math.inf,
    max_fps: float | None = None,
    max_frames: int | None = None,
    input_fps: float | None = None,
    decoder: str = DEFAULT_DECODER,
) -> Source:
    """Frames of a video, a folder or a pattern, ready for a model.

    Parameters
    ----------
    path : str or path
        A video file, a folder of pictures, or a pattern such as ``frames/%04d.png``.
    scale : float, optional
        Linear scale of the frames; without it the width is reduced to 480 px at most.
    size_wh : (int, int), optional
        An exact size instead, in px.
    start_s, end_s : float
        Span of time to read, in seconds, the end excluded.
    max_fps : float, optional
        Frames a second at most; the others are dropped, and times stay true.
    max_frames : int, optional
        Frames in all at most.
    input_fps : float, optional
        Frames per second of pictures, or of a video that does not say; 30 unless given.
    decoder : {"opencv", "pyav"}
        What decodes a video; pictures are always read by OpenCV. PyAV comes with `dlgmd[fast]`.

    Returns
    -------
    Source
        Iterate it for `Frame`\\ s; a context manager.

    Raises
    ------
    SourceError
        If nothing can be decoded.
    ParameterError
        If an option is out of range.
    MissingExtraError
        If the decoder's package is not installed.
    """
    selection = Selection(start_s, end_s, max_fps, max_frames)
    reader = open_reader(path, input_fps, decoder)
    try:
        size = processed_size(reader.info.width, reader.info.height, scale=scale, size_wh=size_wh)
    except BaseException:
        reader.close()
        raise
    return Source(reader, size, selection)
