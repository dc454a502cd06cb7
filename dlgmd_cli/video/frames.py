"""From what a user typed to an open video: options, processed size, decoder, fingerprint."""

import hashlib
import math
import numbers
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.parameters import DEFAULT_WIDTH_PX, shown
from dlgmd_cli.video.base import (
    DECODERS,
    DEFAULT_DECODER,
    FALLBACK_FPS,
    REPEATS,
    Crop,
    Unreadable,
    openable,
    parse_crop,
    parse_size,
)
from dlgmd_cli.video.images import ImageDecoder, name_of, pictures_at
from dlgmd_cli.video.opencv import OpenCVDecoder
from dlgmd_cli.video.pyav import PyAVDecoder
from dlgmd_cli.video.reading import Decoder, Frame, Selection, Video, VideoInfo, least_gap
from dlgmd_cli.video.region import Region, read_mask

__all__ = [
    "Frame",
    "InputOptions",
    "Video",
    "VideoInfo",
    "fingerprint",
    "open_video",
    "processed_size",
]

MAX_SIDE = 8192

_ABOVE_0 = math.ulp(0.0)
# Least and greatest value of the options that are numbers, in words.
_RANGES = {
    "scale": (_ABOVE_0, 1.0, "above 0 and up to 1"),
    "fps": (_ABOVE_0, 100_000.0, "a frame rate above 0, or all"),
    "input_fps": (_ABOVE_0, 100_000.0, "a frame rate above 0"),
    "start": (0.0, 1e9, "a time in seconds"),
    "end": (0.0, 1e9, "a time in seconds"),
}
_CHOICES = {
    "decoder": DECODERS,
    "normalise": ("absolute", "sequence"),
    "repeats": REPEATS,
}
# What a default rate may be exceeded by: videos of 30 frames a second have up to 30.3.
_SLACK = 1.1
# What begins the name of a stream or of a file elsewhere.
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
_RECORD = "Record it to a file first, for example with 'ffmpeg -i SOURCE -c copy flight.mkv'."
# FFmpeg is kept from reading lists of files anyway; this gives a better reason than "damaged".
_LISTS = (b"#EXTM3U", b"ffconcat")


@dataclass(frozen=True)
class InputOptions:
    """What is read of an input, and which normalised membrane potential is thresholded.

    None stands for the default everywhere. `scale`, `size` and so on are those of `open_video`;
    `fps` may be `all`, `normalise` is `absolute` or `sequence`. A `crop` may be given as text; a
    `mask` is held as an absolute path. `mask_sha256` is always that of the file, so that a record
    tells whether the mask has changed.

    Raises
    ------
    ParameterError
        If two of them exclude each other.
    """

    scale: float | None = None
    size: tuple[int, int] | None = None
    fps: float | str | None = None
    repeats: str | None = None
    input_fps: float | None = None
    decoder: str | None = None
    start: float | None = None
    end: float | None = None
    crop: Crop | None = None
    mask: str | None = None
    mask_sha256: str | None = field(default=None, repr=False)
    normalise: str | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.size, tuple | None):
            text = self.size if isinstance(self.size, str) else shown(self.size)
            object.__setattr__(self, "size", parse_size(text))
        if not isinstance(self.crop, Crop | None):
            text = self.crop if isinstance(self.crop, str) else shown(self.crop)
            object.__setattr__(self, "crop", parse_crop(text))
        if isinstance(self.mask, str | os.PathLike):
            object.__setattr__(self, "mask", os.path.abspath(self.mask))
        object.__setattr__(self, "mask_sha256", _digest(self.mask))
        for name, value in vars(self).items():
            why = "" if value is None else _why_wrong(name, value)
            if why:
                option = f"--{name.replace('_', '-')} {shown(value)}"
                raise ParameterError("", f"{option} is not {why}")
        if self.scale is not None and self.size is not None:
            raise ParameterError("", "--scale and --size exclude each other", "Give one of them.")
        if self.start is not None and self.end is not None and self.end <= self.start:
            raise ParameterError("", f"--end {self.end:g} is not after --start {self.start:g}")

    @classmethod
    def from_record(cls, record: Mapping[str, Any], origin: str = "") -> "InputOptions":
        """The options that a record holds; raises ParameterError, which names `origin`."""
        known = {one.name for one in fields(cls)}
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
        values = {key: value for key, value in vars(self).items() if value is not None}
        if self.size is not None:
            values["size"] = "{}x{}".format(*self.size)
        if self.crop is not None:
            values["crop"] = str(self.crop)
        return values

    def open(
        self,
        path: str | os.PathLike[str],
        *,
        width_px: int = DEFAULT_WIDTH_PX,
        model_fps: float | None = None,
    ) -> Video:
        """Open an input with these options; raises what `open_video` raises.

        `width_px` and `model_fps` stand for what no option says; without `model_fps` every frame
        is taken then, repeats too.
        """
        return open_video(
            path,
            scale=self.scale,
            size_wh=self.size,
            width_px=width_px,
            start_s=self.start or 0.0,
            end_s=math.inf if self.end is None else self.end,
            max_fps=math.inf if self.fps == "all" else self.fps,  # type: ignore[arg-type]
            model_fps=model_fps,
            repeats=self.repeats or (None if model_fps else "keep"),
            input_fps=self.input_fps,
            decoder=self.decoder or DEFAULT_DECODER,
            crop=self.crop,
            mask=self.mask,
        )


def _digest(mask: Any) -> str | None:
    """The SHA-256 of a file; None if there is none, which is for `open_video` to say."""
    try:
        return hashlib.sha256(Path(mask).read_bytes()).hexdigest()
    except (OSError, TypeError, ValueError):
        return None


def _why_wrong(name: str, value: Any) -> str:
    """What the value of an option should be; empty if it is that."""
    if name == "fps" and value == "all":
        return ""
    if name in _RANGES:
        low, high, words = _RANGES[name]
        is_number = isinstance(value, numbers.Real) and not isinstance(value, bool)
        return "" if is_number and low <= value <= high else words
    if name == "mask":
        return "" if isinstance(value, str) else "a picture's file"
    choices = _CHOICES.get(name, (value,))
    return "" if value in choices else f"one of {', '.join(choices)}"


def open_video(
    path: str | os.PathLike[str],
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | None = None,
    width_px: int = DEFAULT_WIDTH_PX,
    start_s: float = 0.0,
    end_s: float = math.inf,
    max_fps: float | None = None,
    model_fps: float | None = None,
    repeats: str | None = "keep",
    max_frames: int | None = None,
    input_fps: float | None = None,
    decoder: str = DEFAULT_DECODER,
    crop: Crop | str | None = None,
    mask: str | os.PathLike[str] | None = None,
) -> Video:
    """Frames of a video, a folder or a pattern, ready for a model.

    Parameters
    ----------
    path : str or path
        A video file, a folder of pictures, or a pattern such as ``frames/%04d.png``. An existing
        file or folder of this name comes before a pattern.
    scale : float, optional
        Linear scale of the frames; without it the width is reduced to `width_px` at most.
    size_wh : (int, int), optional
        An exact size instead, in px.
    width_px : int
        The greatest width without `scale` and `size_wh`; 480, a quarter of 1080p, is the paper's
        best, and the preset `flight` is made for 240.
    start_s, end_s : float
        Span of time to read, in seconds, the end excluded.
    max_fps : float, optional
        Frames a second at most: only every k-th is taken, and times stay true.
    model_fps : float, optional
        The same for videos if `max_fps` is None, where a tenth more is let pass.
    repeats : {"keep", "skip"}, optional
        With `skip`, frames that repeat the one before are marked as such, and do not count as
        frames for `max_fps`. None skips them in videos, not in pictures.
    max_frames : int, optional
        Frames in all at most.
    input_fps : float, optional
        Frames per second of pictures, or of a video that does not state it; 30 unless given.
    decoder : {"opencv", "pyav"}
        What decodes a video; pictures are always read by OpenCV. PyAV comes with `dlgmd[fast]`.
    crop : str, optional
        The rectangle of each picture that is read, as ``WIDTHxHEIGHT+X+Y`` in px; `scale` and
        `width_px` are relative to it.
    mask : path, optional
        A picture whose black marks what models are to ignore, see `Video.hidden`; it covers the
        rectangle, and is scaled if it has another size.

    Returns
    -------
    Video
        Iterate it for `Frame`\\ s; a context manager.

    Raises
    ------
    SourceError
        If nothing can be decoded, or the crop reaches outside the picture.
    ParameterError
        If an option is out of range, the path is that of a stream, or the mask is no picture or
        leaves nothing.
    MissingExtraError
        If the decoder's package is not installed.
    """
    if isinstance(crop, str):
        crop = parse_crop(crop)
    masked = None if mask is None else read_mask(os.fspath(mask))
    Selection(start_s, end_s)  # complains before the input is opened
    if max_fps is not None and not max_fps > 0.0:
        raise ParameterError("", f"fps {max_fps:g} is not above 0")
    if decoder not in DECODERS:
        raise ParameterError(
            "", f"there is no decoder {decoder!r}", f"Choose from {', '.join(DECODERS)}."
        )
    if not isinstance(path, str | os.PathLike):
        raise ParameterError("", f"expected the path of a video, not {type(path).__name__}")
    file = Path(path)
    _refuse_streams(os.fspath(path))
    try:
        pictures = pictures_at(file)
    except (OSError, ValueError) as error:  # a name too long, or with a NUL
        raise SourceError(str(path)[:80], f"not a usable path ({error})") from None
    reopen: Callable[[], Decoder]
    if pictures is None:
        _check_readable(file)
        name, reopen = file.stem or file.name, partial(_open_file, file, decoder)
    else:
        name, reopen = name_of(file), partial(ImageDecoder, pictures, input_fps or FALLBACK_FPS)
        decoder = DEFAULT_DECODER
    opened = reopen()
    try:
        width, height, fps, n_frames, *_ = opened.facts
        fps = fps or input_fps or FALLBACK_FPS
        if max_fps is None:
            is_capped = model_fps is not None and pictures is None
            max_fps = _SLACK * model_fps if is_capped else math.inf  # type: ignore[operator]
        every, least_gap_s = least_gap(fps, max_fps)
        info = VideoInfo(os.path.abspath(path), name, width, height, fps, n_frames, decoder)
        if crop and (crop.x + crop.width > width or crop.y + crop.height > height):
            why = f"--crop {crop} reaches outside its pictures of {width}x{height}"
            raise SourceError(str(path), why, "Choose a rectangle inside them.")
        region = Region((width, height), crop, masked)
        size = processed_size(*region.size_wh, scale=scale, size_wh=size_wh, width_px=width_px)
        region.hidden(size)  # complains if nothing is left
    except BaseException:
        opened.close()
        raise
    video = Video(
        *(opened, reopen, info, size, Selection(start_s, end_s, max_frames, least_gap_s)),
        region=region,
        rate_fps=fps / every,
        skips_repeats=repeats == "skip" or (repeats is None and pictures is None),
    )
    if pictures is not None and input_fps is None:
        line = f"pictures have no times; taken as {fps:g} fps (set it with --input-fps)"
        video.progress.warnings.append(line)
    return video


def _open_file(path: Path, decoder: str) -> Decoder:
    """A decoder at the start of a video file."""
    try:
        with openable(path.absolute()) as name:
            return PyAVDecoder(name) if decoder == "pyav" else OpenCVDecoder(name)
    except Unreadable:
        raise SourceError(
            str(path),
            "no frame could be decoded, damaged file or missing codec",
            "Try re-encoding it with ffmpeg.",
        ) from None


def _refuse_streams(name: str) -> None:
    """Raise ParameterError if a name is that of a stream, of standard input or of a file elsewhere.

    A file or a folder of this name, or one that its pattern leads through, is taken as such.
    """
    if name == "-" and not Path(name).exists():
        raise ParameterError("-", "standard input is not read; only files are", _RECORD)
    if _URL.match(name) and not Path(name.partition("/")[0]).exists():
        scheme = name.partition(":")[0].lower()
        if scheme in ("http", "https", "s3", "gs", "az", "abfs", "ftp", "sftp", "file"):
            mend = "Download the file first, or use 'dlgmd batch', which reads files from URLs."
            raise ParameterError(name, "URLs are not read here", mend)
        raise ParameterError(name, "live streams are not read; only files are", _RECORD)


def _check_readable(path: Path) -> None:
    """Raise SourceError with the reason why a file cannot be opened, which FFmpeg does not give."""
    name = str(path)
    if not path.exists():
        raise SourceError(name, "there is no such file or folder", "Check the path.")
    if path.is_fifo():
        raise SourceError(name, "is a pipe; only files are read", _RECORD)
    if path.is_char_device():
        raise SourceError(name, "is a device, such as a camera; only files are read", _RECORD)
    if not path.is_file():
        raise SourceError(name, "is neither a file nor a folder", "Give a video file.")
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise SourceError(name, f"cannot be read ({error.strerror})") from None
    if not start:
        raise SourceError(name, "the file is empty", "Copy or record it again.")
    if start.startswith(_LISTS):
        raise SourceError(
            name, "is a list of other files, not a video", "Give one of the videos it names."
        )


def processed_size(
    width: int,
    height: int,
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | None = None,
    width_px: int = DEFAULT_WIDTH_PX,
) -> tuple[int, int]:
    """Width and height in px at which an input is processed; raises ParameterError.

    Without `scale`, 0 < scale <= 1, and an exact `size_wh` in px the width is reduced to
    `width_px`, and never enlarged.
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
        scale = min(1.0, width_px / width)
    if not 0.0 < scale <= 1.0:
        raise ParameterError("", f"scale {scale:g} is not above 0 and up to 1")
    return max(1, round(width * scale)), max(1, round(height * scale))


def fingerprint(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What tells an input from another of the same name, without decoding it.

    Of a file ``bytes`` and ``mtime_ns``; of pictures their number and a digest of the names, sizes
    and times of change of all. Raises SourceError if there are no pictures, and OSError.
    """
    pictures = pictures_at(Path(path))
    if pictures is None:
        facts = Path(path).stat()
        return {"bytes": facts.st_size, "mtime_ns": facts.st_mtime_ns}
    digest = hashlib.sha256()
    for picture in pictures:
        facts = picture.stat()
        line = f"{picture.name}\0{facts.st_size}\0{facts.st_mtime_ns}\n"
        digest.update(line.encode(errors="replace"))
    return {"pictures": len(pictures), "sha256": digest.hexdigest()}
