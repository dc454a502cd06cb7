"""From what a user typed to the frames a model takes: opened, chosen by time, grey, reduced."""

import math
import numbers
import os
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.parameters import shown
from dlgmd_cli.video.base import (
    DECODERS,
    DEFAULT_DECODER,
    Picture,
    Progress,
    Select,
    Verdict,
    VideoInfo,
)

# NumPy and OpenCV are imported inside the functions that need them: --help loads this module.
if TYPE_CHECKING:
    import numpy as np
    import numpy.typing as npt

    from dlgmd_cli.video.files import FileReader
    from dlgmd_cli.video.images import ImageReader

__all__ = [
    "DECODERS",
    "DEFAULT_DECODER",
    "Frame",
    "InputOptions",
    "Picture",
    "Progress",
    "Video",
    "VideoInfo",
    "fingerprint",
    "open_video",
    "processed_size",
]

# The paper's best size: a quarter of 1080p.
DEFAULT_WIDTH = 480
MAX_SIDE = 8192


@dataclass(frozen=True)
class Frame:
    """A frame as models take it.

    `grey` is (H, W): uint8 levels 0..255 if the input has 8 bits, else float32 in 0..1.
    """

    index: int
    time_s: float
    grey: "npt.NDArray[Any]"

    @property
    def luminance(self) -> "npt.NDArray[np.float32]":
        """The same as float32 in 0..1, shape (H, W)."""
        import numpy as np

        if self.grey.dtype != np.uint8:
            return self.grey
        return np.divide(self.grey, np.float32(255.0), dtype=np.float32)


# Least and greatest value of the options that are numbers, whether the least is excluded, in words.
_RANGES = {
    "scale": (0.0, 1.0, True, "above 0 and up to 1"),
    "fps": (0.0, 100_000.0, True, "a frame rate above 0"),
    "input_fps": (0.0, 100_000.0, True, "a frame rate above 0"),
    "start": (0.0, 1e9, False, "a time in seconds"),
    "end": (0.0, 1e9, False, "a time in seconds"),
}
_CHOICES = {"decoder": tuple(DECODERS), "normalise": ("absolute", "sequence")}


def parse_size(text: str) -> tuple[int, int]:
    """`480x270` -> (480, 270); raises ParameterError."""
    match = re.fullmatch(r"(\d{1,6})[x×X](\d{1,6})", text.strip(), re.ASCII)
    if match is None:
        raise ParameterError("", f"{text[:40]!r} is not WIDTHxHEIGHT", "Write 480x270.")
    return int(match[1]), int(match[2])


def _wrong(name: str, value: object, why: str) -> ParameterError:
    return ParameterError("", f"--{name.replace('_', '-')} {shown(value)} {why}")


@dataclass(frozen=True)
class InputOptions:
    """What is read of an input, and which normalised membrane potential is thresholded.

    None stands for the default everywhere. `scale`, `size` and so on are those of `open_video`;
    `normalise` is `absolute` or `sequence`.

    Raises
    ------
    ParameterError
        If two of them exclude each other.
    """

    scale: float | None = None
    size: tuple[int, int] | None = None
    fps: float | None = None
    input_fps: float | None = None
    decoder: str | None = None
    start: float | None = None
    end: float | None = None
    normalise: str | None = None

    def __post_init__(self) -> None:
        if isinstance(self.size, str):
            object.__setattr__(self, "size", parse_size(self.size))
        for name, (low, high, is_open, allowed) in _RANGES.items():
            value = getattr(self, name)
            is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
            if value is not None and not (
                is_number and (low < value if is_open else low <= value) and value <= high
            ):
                raise _wrong(name, value, f"is not {allowed}")
        for name, choices in _CHOICES.items():
            value = getattr(self, name)
            if value is not None and value not in choices:
                raise _wrong(name, value, f"is not one of {', '.join(choices)}")
        if self.scale is not None and self.size is not None:
            raise ParameterError("", "--scale and --size exclude each other", "Give one of them.")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ParameterError("", f"--end {self.end:g} is not after --start {self.start:g}")

    @classmethod
    def from_record(cls, record: Mapping[str, Any], origin: str = "") -> "InputOptions":
        """The options that a record holds; raises ParameterError, which names `origin`."""
        known = {field.name for field in fields(cls)}
        for key in record:
            if key not in known:
                raise ParameterError(origin, f"unknown option {shown(key)} under 'options'")
        try:
            return cls(**record)
        except ParameterError as error:
            raise ParameterError(origin, f"options: {error.why}", error.mend) from None

    def n_expected(self, info: VideoInfo) -> int | None:
        """The number of frames until the requested end, as far as the input states it."""
        if info.n_frames is None or self.end is None:
            return info.n_frames
        return min(info.n_frames, math.ceil(self.end * info.fps))

    def to_record(self) -> dict[str, Any]:
        """The options that are not left to the default, as a record holds them."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        if self.size is not None:
            values["size"] = "{}x{}".format(*self.size)
        return {key: value for key, value in values.items() if value is not None}

    @property
    def by_sequence(self) -> bool:
        """Whether spikes follow the potential normalised by its own sequence."""
        return self.normalise == "sequence"

    def open(self, path: str | os.PathLike[str]) -> "Video":
        """Open an input with these options; raises what `open_video` raises."""
        return open_video(
            path,
            scale=self.scale,
            size_wh=self.size,
            start_s=self.start or 0.0,
            end_s=math.inf if self.end is None else self.end,
            max_fps=self.fps,
            input_fps=self.input_fps,
            decoder=self.decoder or DEFAULT_DECODER,
        )


class Video:
    """Frames of an input, ready for a model; a context manager, made by `open_video`.

    Iterate it for `Frame`\\ s, each in memory of its own; every iteration starts at the beginning.

    Attributes
    ----------
    info : VideoInfo
        Facts about the input.
    size_wh : (int, int)
        Width and height of the frames, in px.
    """

    def __init__(
        self,
        reader: "FileReader | ImageReader",
        size_wh: tuple[int, int],
        select: Callable[[], Select],
    ) -> None:
        from dlgmd_cli.video.luma import to_grey

        self._reader, self._select, self._to_grey = reader, select, to_grey
        self.info: VideoInfo = reader.info
        self.size_wh = size_wh

    @property
    def progress(self) -> Progress:
        """How many frames were decoded so far, the time of the last one, and warnings."""
        return self._reader.progress

    def pictures(self) -> Iterator[Picture]:
        """The chosen pictures as decoded; each is valid until the next one."""
        return self._reader.pictures(self._select())

    def frame(self, picture: Picture, size_wh: tuple[int, int] | None = None) -> Frame:
        """What models take of a picture, at the video's `size_wh` unless another is given."""
        grey = self._to_grey(picture.image, size_wh or self.size_wh, picture.levels)
        return Frame(picture.index, picture.time_s, grey)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, self.pictures())

    def close(self) -> None:
        """Free the input; may be called twice."""
        self._reader.close()

    def __enter__(self) -> "Video":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_video(
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
) -> Video:
    """Frames of a video, a folder or a pattern, ready for a model.

    Parameters
    ----------
    path : str or path
        A video file, a folder of pictures, or a pattern such as ``frames/%04d.png``. An existing
        file or folder of this name comes before a pattern.
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
        Frames per second of pictures, or of a video that does not state it; 30 unless given.
    decoder : {"opencv", "pyav"}
        What decodes a video; pictures are always read by OpenCV. PyAV comes with `dlgmd[fast]`.

    Returns
    -------
    Video
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
    select = selection(start_s, end_s, max_fps, max_frames)
    if decoder not in DECODERS:
        raise ParameterError(
            "", f"there is no decoder {decoder!r}", f"Choose from {', '.join(DECODERS)}."
        )
    reader = _open_reader(os.fspath(path), input_fps, decoder)
    try:
        size = processed_size(reader.info.width, reader.info.height, scale=scale, size_wh=size_wh)
        return Video(reader, size, select)
    except BaseException:
        reader.close()
        raise


def _open_reader(path: str, fps: float | None, decoder: str) -> "FileReader | ImageReader":
    """A reader for a video file, a folder of pictures, or a pattern."""
    from dlgmd_cli.video.files import FileReader
    from dlgmd_cli.video.images import ImageReader, in_folder, is_pattern, matching

    file = Path(path)
    try:
        exists = file.exists()
    except (OSError, ValueError) as error:  # a name too long, or with a NUL
        raise SourceError(path[:80], f"not a usable path ({error})") from None
    if file.is_dir():
        absolute = file.resolve()
        return ImageReader(in_folder(file), absolute, absolute.name or "root", fps)
    if not exists and is_pattern(path):
        folder = file.parent.absolute()
        while is_pattern(folder.name):
            folder = folder.parent
        return ImageReader(matching(path), file.absolute(), folder.resolve().name or "root", fps)
    return FileReader(file, fps, decoder)


def processed_size(
    width: int,
    height: int,
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | None = None,
) -> tuple[int, int]:
    """Width and height in px at which an input is processed.

    Parameters
    ----------
    width, height : int
        Size of the input, in px.
    scale : float, optional
        Linear scale, 0 < scale <= 1. Without it (and without `size_wh`) the width is reduced to
        480 px, the paper's best size, and never enlarged.
    size_wh : (int, int), optional
        An exact size instead, in px.

    Raises
    ------
    ParameterError
        If scale or size are out of range, or both are given.
    """
    if size_wh is not None:
        if scale is not None:
            raise ParameterError("", "scale and size exclude each other", "Give one of them.")
        if not all(1 <= side <= MAX_SIDE for side in size_wh):
            raise ParameterError(
                "", f"size {size_wh[0]}x{size_wh[1]} is not within 1 to {MAX_SIDE} px"
            )
        return size_wh
    if scale is None:
        scale = min(1.0, DEFAULT_WIDTH / width)
    if not 0.0 < scale <= 1.0:
        raise ParameterError("", f"scale {scale:g} is not above 0 and up to 1")
    return max(1, round(width * scale)), max(1, round(height * scale))


def selection(
    start_s: float = 0.0,
    end_s: float = math.inf,
    max_fps: float | None = None,
    max_frames: int | None = None,
) -> Callable[[], Select]:
    """Which frames to take; see `open_video` for the parameters.

    Returns
    -------
    callable
        Each call begins anew, with a function that judges one frame after the other by its time;
        the times must increase.

    Raises
    ------
    ParameterError
        If the end is not after the start, or the rate is not above 0.
    """
    if not end_s > start_s:
        raise ParameterError("", f"end {end_s:g} s is not after start {start_s:g} s")
    if max_fps is not None and not (math.isfinite(max_fps) and max_fps > 0.0):
        raise ParameterError("", f"fps {max_fps:g} is not above 0")

    def begin() -> Select:
        origin_s, last_slot, n_taken = math.nan, -1, 0

        def select(time_s: float) -> Verdict:
            nonlocal origin_s, last_slot, n_taken
            if time_s >= end_s or n_taken == max_frames:
                return Verdict.STOP
            # Without a start, frames before zero (edit lists make them) belong to the video too.
            if start_s > 0.0 and time_s < start_s:
                return Verdict.SKIP
            if max_fps is not None:
                origin_s = time_s if math.isnan(origin_s) else origin_s
                # Timestamps are rounded, in Matroska to 1 ms: a frame may be that much early.
                slot = math.floor((time_s - origin_s + 1e-3) * max_fps)
                if slot <= last_slot:
                    return Verdict.SKIP
                last_slot = slot
            n_taken += 1
            return Verdict.TAKE

        return select

    return begin


def fingerprint(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What tells an input from another of the same name, without decoding it.

    Parameters
    ----------
    path : str or path
        What `open_video` takes.

    Returns
    -------
    dict
        Of a file ``bytes`` and ``mtime_ns``; of pictures their number and a digest of the names,
        sizes and times of change of all.

    Raises
    ------
    SourceError
        If there are no pictures.
    OSError
        If the files cannot be looked at.
    """
    import hashlib

    from dlgmd_cli.video.images import in_folder, is_pattern, matching

    file = Path(path)
    if file.is_dir():
        pictures = in_folder(file)
    elif not file.exists() and is_pattern(os.fspath(path)):
        pictures = matching(os.fspath(path))
    else:
        facts = file.stat()
        return {"bytes": facts.st_size, "mtime_ns": facts.st_mtime_ns}
    digest = hashlib.sha256()
    for picture in pictures:
        facts = picture.stat()
        line = f"{picture.name}\0{facts.st_size}\0{facts.st_mtime_ns}\n"
        digest.update(line.encode(errors="replace"))
    return {"pictures": len(pictures), "sha256": digest.hexdigest()}
