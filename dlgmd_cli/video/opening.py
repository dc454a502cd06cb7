"""Opening an input: choice of decoder, processed size, and fingerprint."""

from __future__ import annotations

import hashlib
import math
import os
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import ParameterError, SourceError, argument
from dlgmd_cli.frame import FULL
from dlgmd_cli.parameters.checks import refuse, require_known, similar_path
from dlgmd_cli.parameters.facts import InputFacts
from dlgmd_cli.parameters.presets import DEFAULT_WIDTH_PX
from dlgmd_cli.stream.clock import RATE_TOLERANCE, sampling_step
from dlgmd_cli.video import bags, base
from dlgmd_cli.video.base import (
    Crop,
    MissingCodec,
    SourceInfo,
    Unreadable,
    input_name,
    without_password,
)
from dlgmd_cli.video.containers import stated_by
from dlgmd_cli.video.content import has_analog_size, is_combed
from dlgmd_cli.video.given_times import given_times
from dlgmd_cli.video.images import (
    ARRAYS,
    NAME,
    ArrayDecoder,
    ImageDecoder,
    load_array,
    pictures_at,
)
from dlgmd_cli.video.input_options import SPECS, InputOptions, parse_time
from dlgmd_cli.video.luma import Decoder, Region, read_mask
from dlgmd_cli.video.opencv_decoder import OpenCVDecoder, packet_times
from dlgmd_cli.video.pyav_decoder import PyAVDecoder, details_of, has_av, import_av
from dlgmd_cli.video.source import Selection, Video
from dlgmd_cli.video.tiff import TIFF, TiffDecoder, n_pages
from dlgmd_cli.video.timestamps import rate_between_gaps, steady_fps

# Inputs of `open_video`: a path, or images in memory.
Openable = str | os.PathLike[str] | Iterable[Any]

# The beginning of a URL.
_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")
_GREY = (
    "the frames are grey, and their black is taken for 0; "
    "with PyAV (the extra fast) it is what the video states"
)
_INTERLACED = "it is interlaced"
_RECORD = "Watch it with 'dlgmd live', or record it to a file first."
# Reading every k-th frame is reported if it leaves less than this share of the model's rate.
_FEW = 0.75
# Number of bytes of a file that are hashed at a time.
_HASHED_BYTES = 1 << 20
# Option -> the inputs that use it. Every other option applies to all inputs.
ONLY_FOR = {
    "decoder": "video files alone have a choice of decoder",
    "topic": "ROS bags alone have topics",
    "bit_depth": "it is for samples of 16 bits",
    "size": "",
    "mask": "",
}
# FFmpeg refuses playlists anyway; recognising them allows a better message than "damaged file".
PLAYLISTS = (b"#EXTM3U", b"ffconcat")


def open_video(
    path: Openable,
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | str | None = None,
    width_px: int = DEFAULT_WIDTH_PX,
    start_s: float | str = 0.0,
    end_s: float | str = math.inf,
    max_fps: float | None = None,
    model_fps: float | None = None,
    repeats: str | None = "keep",
    max_frames: int | None = None,
    input_fps: float | None = None,
    times: str | os.PathLike[str] | None = None,
    bit_depth: int | None = None,
    decoder: str = base.DEFAULT_DECODER,
    crop: Crop | str | None = None,
    mask: str | os.PathLike[str] | None = None,
    topic: str | None = None,
) -> Video:
    """Open a video, images, a ROS bag or an array as a source of frames for a model.

    Parameters
    ----------
    path : str, path, or iterable of ndarray
        A video file; a ROS bag (the folder, of ROS 2) or MCAP file; a folder of images; a pattern
        such as ``frames/%04d.png`` (an existing file or folder of this name takes precedence); a
        ``.npy`` file, or ``.npz`` of one array; a TIFF stack; or the images themselves: an array
        (n, H, W) or (n, H, W, 3), or any iterable of images (H, W) or (H, W, 3). Colour is BGR, as
        OpenCV has it; images are uint8, uint16, or float from 0 to 1.
    scale : float, optional
        Linear scale of the frames; by default, a width above `width_px` is reduced to it.
    size_wh : (int, int), optional
        Exact size of the frames, in px, instead of `scale`.
    width_px : int
        Greatest width without `scale` and `size_wh`. 480, a quarter of 1080p, is the best in the
        paper; the preset `flight` is designed for 240.
    start_s, end_s : float
        Time span to read, in seconds, the end excluded.
    max_fps : float, optional
        Maximum frame rate: only every k-th frame is read, and frames keep their true times. Images
        and arrays state no rate: with `max_fps`, they need `input_fps` too.
    model_fps : float, optional
        Default of `max_fps` for videos; a rate up to 10 % higher is accepted.
    repeats : {"keep", "skip"}, optional
        With `skip`, duplicates of the previous frame are marked as such and do not count for
        `max_fps`, see `RepeatDetector`. None means `skip` for images that were coded with loss,
        and `keep` for what keeps every sample (arrays, PNG, TIFF, lossless codecs).
    max_frames : int, optional
        Maximum number of frames in all.
    input_fps : float, optional
        True frame rate, up to 5,000, also of a video that states another, such as the rate of its
        playback. 30 unless given for images, arrays, and bare H.264 or H.265, whose own rate is
        often wrong.
    times : path, optional
        A table with the time of each frame, see `read_times`, in place of all other times.
    bit_depth : int, optional
        Bits that samples of more than 8 bits really have, 8 to 16, whether of video, images, bags
        or arrays: white of uint16 is 2**bit_depth - 1. Unless given, those that the input states,
        with a warning if all samples of 16 bits are far below white.
    decoder : {"opencv", "pyav"}
        Decoder for videos. Images are always read by OpenCV. PyAV, which comes with the
        extra ``fast``, reads what OpenCV would read wrongly: interlaced video (de-interlaced),
        codecs that OpenCV lacks, HDR, 16 bits, grey video whose black is not 0, files whose default
        video stream is not the first, and whatever has a `bit_depth`.
    crop : str, optional
        The part of each image to read, as ``WIDTHxHEIGHT+X+Y`` in px; `scale` and `width_px`
        are relative to it.
    mask : path, optional
        An image whose black pixels models ignore, see `Video.hidden`. A mask of the input's size is
        cut by the crop; a mask of any other size is resized to cover the crop.
    topic : str, optional
        The topic of a ROS bag; required if several topics have images. Only bags have topics.

    Returns
    -------
    Video
        A context manager and an iterable of `Frame`.

    Raises
    ------
    SourceError
        If nothing can be decoded, or the crop extends beyond the image.
    ParameterError
        If an option is out of range, the path names a stream, or the mask is not an image or hides
        everything.
    MissingExtraError
        If the input needs PyAV, which is not installed.
    """
    crop = None if crop is None else base.parse_crop(crop)
    size_wh = None if size_wh is None else base.parse_size(size_wh)
    start_s = start_s if start_s == 0.0 else parse_time(start_s)
    end_s = end_s if end_s == math.inf else parse_time(end_s)
    masked = None if mask is None else read_mask(os.fspath(mask))
    Selection(start_s, end_s)  # raises before the input is opened
    if max_fps is not None and not max_fps > 0.0:
        raise ParameterError("", f"fps {max_fps:g} is not above 0")
    require_known("decoder", decoder, base.DECODERS)
    for name, value in {"repeats": repeats, "input_fps": input_fps}.items():
        if value is not None:
            SPECS[name].check(value, argument(name))
    if bit_depth:
        decoder = "pyav"  # OpenCV keeps 8 bits
    name, where, reopen = _source(path, decoder, input_fps or base.FALLBACK_FPS, topic)
    opened = reopen()
    is_continuous = not opened.takes_every_frame
    try:
        stated_fps = _nominal_fps(where, opened)
        given = given_times(times, input_fps, stated_fps)
        file_fps = stated_fps or input_fps or base.FALLBACK_FPS
        fps = given.fps if given else file_fps
        has_rate = is_continuous or bool(stated_fps or input_fps or given)
        most_fps = _most_fps(max_fps, model_fps, is_continuous=is_continuous, has_rate=has_rate)
        every, min_interval_s = sampling_step(fps, most_fps)
        info = _info(path, where, name, opened, fps, bit_depth)
        info = replace(info, start=given.start if given else info.start)
        region = _region(info, crop, masked)
        size = processed_size(*region.size_wh, scale=scale, size_wh=size_wh, width_px=width_px)
        region.hidden(size)  # raises if nothing is left
    except BaseException:
        opened.close()
        raise
    video = Video(
        *(opened, reopen, info, size, Selection(start_s, end_s, max_frames, min_interval_s)),
        region=region,
        rate_fps=fps / every,
        bit_depth=bit_depth,
        skips_repeats=not info.is_lossless if repeats is None else repeats == "skip",
        given=given,
        file_fps=file_fps,
    )
    video.unused = _unused(opened, decoder, size_wh, region)
    video.progress.warnings += _remarks(opened, None if input_fps or given else fps)
    if max_fps is None and model_fps and every > 1 and fps / every < _FEW * model_fps:
        left = f"one frame of {every} is read, {fps / every:.3g} a second of {fps:.3g}"
        every_frame = f"{argument('fps')} all reads every frame"
        video.progress.warnings.append(f"{left}; {every_frame}")
    return video


def _unused(
    opened: Decoder, decoder: str, size_wh: tuple[int, int] | None, region: Region
) -> dict[str, str]:
    """The options without effect on an open input, and why."""
    is_video = isinstance(opened, OpenCVDecoder | PyAVDecoder)
    uses = {
        "decoder": is_video,
        "topic": isinstance(opened, bags.BagDecoder),
        "bit_depth": opened.info.levels[1] > FULL[1],
    }
    unused = {name: ONLY_FOR[name] for name, is_used in uses.items() if not is_used}
    if is_video and opened.kind != decoder:
        unused["decoder"] = "PyAV reads this input, which OpenCV would misread"
    if size_wh is not None and (why := region.lacks(size_wh)):
        unused["size"] = why
    if region.masked is not None and not region.masked.any():
        unused["mask"] = "none of its pixels is black"
    return unused


def require_used(given: Collection[str], inputs: Iterable[Mapping[str, str]]) -> None:
    """Raise ParameterError for an option that was given and that no input uses.

    `inputs` are the `Video.unused` of each, read as far as necessary.
    """
    left, reasons = set(given), dict[str, str]()
    for unused in inputs:
        left &= unused.keys()
        reasons = {**unused, **reasons}
        if not left:
            return
    for name in sorted(left if reasons else ()):
        refuse({name: True}, f"has no effect: {reasons[name]}")


def _info(
    path: Openable, where: str, name: str, opened: Decoder, fps: float, bit_depth: int | None
) -> SourceInfo:
    """The properties of an open input; `where` is its absolute path, or NAME for an array."""
    identity: InputFacts = {}
    given, (black, white) = where, opened.info.levels
    if bit_depth and white > FULL[1]:
        n_lower = max(0, (opened.info.bits or bit_depth) - bit_depth)
        black, white = black >> n_lower, white >> n_lower
    if where != NAME:
        assert isinstance(path, str | os.PathLike)
        identity, given = {"path": where, **fingerprint(where)}, os.fspath(path)
    return replace(
        opened.info,
        fps=fps,
        path=where,
        name=name,
        decoder=opened.kind,
        identity=identity,
        given=given,
        levels=(black, white),
    )


def _nominal_fps(path: str, opened: Decoder) -> float | None:
    """The stated frame rate of a source, or the rate between gaps if the stated rate is lower."""
    info = opened.info
    if opened.kind not in base.DECODERS or info.fps_stated is None:
        return info.fps_stated
    if info.is_interlaced:  # each packet may be a field
        return info.fps_stated
    with base.openable(Path(path)) as name:
        return rate_between_gaps(info.fps_stated, steady_fps(packet_times(name)))


def open_input(
    path: Openable,
    options: InputOptions,
    *,
    width_px: int = DEFAULT_WIDTH_PX,
    model_fps: float | None = None,
) -> Video:
    """Open an input with these options; raises the errors of `open_video`.

    `width_px` and `model_fps` apply where no option sets the size or the rate. Without `model_fps`
    every frame is processed by default, duplicates of coded video included.
    """
    return open_video(
        path,
        scale=options.scale,
        size_wh=options.size,
        width_px=width_px,
        start_s=options.start or 0.0,
        end_s=math.inf if options.end is None else options.end,
        max_fps=math.inf if options.fps == "all" else options.fps,  # type: ignore[arg-type]
        model_fps=model_fps,
        repeats=options.repeats or (None if model_fps else "keep"),
        decoder=options.decoder or base.DEFAULT_DECODER,
        crop=options.crop,
        mask=options.mask,
        **options.of_images,
    )


def _most_fps(
    max_fps: float | None, model_fps: float | None, *, is_continuous: bool, has_rate: bool
) -> float:
    """The maximum frame rate; raises ParameterError if the input has no rate to limit."""
    if max_fps is None:
        return RATE_TOLERANCE * model_fps if model_fps and is_continuous else math.inf
    if max_fps < math.inf and not has_rate:
        why = f"{argument('fps')} {max_fps:g} limits a frame rate, but images and arrays state none"
        raise ParameterError("", why, f"Give theirs with {argument('input_fps')}.")
    return max_fps


def _region(info: SourceInfo, crop: Crop | None, masked: Any) -> Region:
    """The part of the images to read; raises SourceError if the crop extends beyond an image."""
    picture_wh = info.width, info.height
    if crop and (why := crop.overhang(picture_wh)):
        raise SourceError(info.path, why, "Choose a rectangle inside them.")
    return Region(picture_wh, crop, masked)


def _remarks(opened: Decoder, assumed_fps: float | None) -> Iterator[str]:
    """Lines for the user about how an input is read, and the frame rate if it was assumed."""
    if opened.info.remark:
        yield opened.info.remark
    is_untimed = opened.info.fps_stated is None and opened.kind != bags.NAME
    if is_untimed and assumed_fps is not None:
        what = "an array has" if opened.info.codec == NAME else "images have"
        is_bare = not opened.takes_every_frame
        what = "the stream states no frame rate and has" if is_bare else what
        taken = f"taken as {assumed_fps:g} fps (set it with {argument('input_fps')})"
        yield f"{what} no times; {taken}"
    if isinstance(opened, OpenCVDecoder) and opened.is_grey and not has_av():
        yield _GREY


def _source(
    path: Openable, decoder: str, fps: float, topic: str | None
) -> tuple[str, str, Callable[[], Decoder]]:
    """The name and absolute path of an input, and a function that opens the input."""
    if not isinstance(path, str | os.PathLike):
        if not isinstance(path, Iterable):
            what = type(path).__name__
            hint = "A camera is for live." if isinstance(path, int) else "Give a video."
            raise ParameterError("", f"expected a path or images, not {what}", hint)
        return NAME, NAME, partial(ArrayDecoder, path, fps)
    file, where = Path(path), os.path.abspath(path)
    if not os.fspath(path):
        raise ParameterError("", "the name of the input is empty")
    _refuse_streams(os.fspath(path))
    try:
        is_folder_of_bag = file.is_dir() and bags.is_bag(file)
        pictures = None if is_folder_of_bag else pictures_at(file)
    except (OSError, ValueError) as error:  # a name too long, or with a NUL
        raise SourceError(str(path)[:80], f"not a usable path ({error})") from None
    name = input_name(file, are_pictures=pictures is not None)
    if pictures is not None:
        if n_pages(pictures[0]) > 1:
            hint = "Give one stack, or the folder to 'dlgmd batch'."
            raise SourceError(str(pictures[0]), "is a stack of images, a video of its own", hint)
        return name, where, partial(ImageDecoder, pictures, fps)
    if not is_folder_of_bag:
        _check_readable(file)
    if file.suffix.lower() in ARRAYS:
        return name, where, lambda: ArrayDecoder(load_array(file), fps, str(path))
    if file.suffix.lower() in TIFF:
        return name, where, partial(TiffDecoder, file, fps)
    if bags.is_bag(file):
        return name, where, partial(bags.BagDecoder, file, topic)
    return name, where, partial(_open_file, file, decoder)


def _open_file(path: Path, decoder: str) -> Decoder:
    """A decoder for a video file: the requested one, or PyAV if OpenCV would misread the file."""
    try:
        with base.openable(path.absolute()) as name:
            if decoder == "opencv":
                opened, reason = _by_opencv(name)
                if opened is not None:
                    return opened
                import_av(str(path), reason)
            return _by_pyav(name)
    except Unreadable as error:
        why, hint = (str(error), RE_ENCODE) if str(error) else mistaken(path)
        raise SourceError(str(path), why, hint) from None


def _by_opencv(name: str) -> tuple[OpenCVDecoder | None, str]:
    """OpenCV's decoder; None and the reason, where only PyAV reads the file correctly."""
    stated, details = stated_by(Path(name)), details_of(name)
    if not stated.is_default:
        return None, "OpenCV reads another of its video streams than the default one"
    if details is not None and details.is_interlaced:
        return None, _INTERLACED
    if reason := details.misread if details else stated.colours.changed_by_opencv():
        return None, reason
    try:
        opened = OpenCVDecoder(name)
    except MissingCodec as error:
        return None, f"OpenCV decodes none of its frames (codec {error})"
    if has_analog_size(opened):
        with closing(opened):
            if is_combed(opened):
                return None, _INTERLACED
        opened = OpenCVDecoder(name)
    if details is not None:
        info = opened.info
        opened.info = replace(
            details, fps_stated=info.fps_stated, n_frames=info.n_frames, levels=info.levels
        )
    return opened, ""


def _by_pyav(name: str) -> PyAVDecoder:
    """PyAV's decoder, which de-interlaces interlaced video."""
    details = details_of(name)
    is_interlaced = details is not None and details.is_interlaced
    if not is_interlaced:
        opened = PyAVDecoder(name)
        if not has_analog_size(opened):
            return opened
        with closing(opened):
            is_interlaced = is_combed(opened)
    return PyAVDecoder(name, deinterlaces=is_interlaced)


_LFS = b"version https://git-lfs.github.com/"
# So many bytes at the beginning and at the end of a file tell what it is.
_N_BYTES = 1 << 16
RE_ENCODE = "Try re-encoding it with ffmpeg."


def mistaken(path: Path) -> tuple[str, str]:
    """Why a file without any frame cannot be read, by its bytes, and a hint for the user."""
    with path.open("rb") as file:
        head = file.read(_N_BYTES)
        file.seek(max(0, path.stat().st_size - _N_BYTES))
        both = head + file.read()
    if head.startswith(_LFS):
        return "is a Git LFS pointer, not the video itself", "Fetch it with 'git lfs pull'."
    if re.match(rb"\s*<(!doctype )?html", head, re.I):
        return "is a web page, not a video", "Download the video itself."
    if head.startswith(b"PK\x03\x04"):
        return "is a ZIP archive, not a video", "Unpack it first."
    if b"soun" in both and b"vide" not in both:  # the kinds of tracks in the index of an MP4
        return "has sound, but no video", "Give the video that it belongs to."
    if head[4:8] == b"ftyp":
        why = "no frame could be decoded; the recording or the copy was perhaps cut off"
        return why, "Copy it again; some cameras complete such a file when they start."
    return "no frame could be decoded, damaged file or missing codec", RE_ENCODE


def _refuse_streams(name: str) -> None:
    """Raise ParameterError for a stream, standard input or a URL, unless such a file exists."""
    if name == "-" and not Path(name).exists():
        raise ParameterError("-", "standard input is not read; only files are", _RECORD)
    if _URL.match(name) and not Path(name.partition("/")[0]).exists():
        scheme, name = name.partition(":")[0].lower(), without_password(name)
        if scheme in ("http", "https", "s3", "gs", "az", "abfs", "ftp", "sftp", "file"):
            hint = "Download the file first, or use 'dlgmd batch', which reads files from URLs."
            raise ParameterError(name, "URLs are not read here", hint)
        raise ParameterError(name, "live streams are not read; only files are", _RECORD)


def _check_readable(path: Path) -> None:
    """Raise SourceError with the reason if a file cannot be opened; FFmpeg gives no reason."""
    name = str(path)
    if not path.exists():
        raise SourceError(
            name, "there is no such file or folder", similar_path(path) or "Check the path."
        )
    if not path.is_file():
        raise SourceError(name, "is a pipe or a device; only files are read", _RECORD)
    try:
        with path.open("rb") as file:
            start = file.read(8)
    except OSError as error:
        raise SourceError(name, f"cannot be read ({error.strerror})") from None
    if not start:
        raise SourceError(name, "the file is empty", "Copy or record it again.")
    if start.startswith(b"MATLAB") or path.suffix.lower() == ".mat":
        hint = "Read it by scipy.io.loadmat (h5py from 7.3 on), and give its array as (n, H, W)."
        raise SourceError(name, "is a file of MATLAB, not a video", hint)
    if start.startswith(PLAYLISTS):
        hint = "Give one of the videos it names."
        raise SourceError(name, "is a list of other files, not a video", hint)


def processed_size(
    width: int,
    height: int,
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | None = None,
    width_px: int = DEFAULT_WIDTH_PX,
) -> tuple[int, int]:
    """Width and height in px at which an input is processed; raises ParameterError.

    `scale` is above 0 and up to 1, `size_wh` an exact size in px. Without both, a width above
    `width_px` is reduced to `width_px`; a smaller width is kept.
    """
    if size_wh is not None:
        if scale is not None:
            raise ParameterError("", "scale and size exclude each other", "Give one of them.")
        return base.checked_size(size_wh)
    if scale is None:
        scale = min(1.0, width_px / width)
    if not 0.0 < scale <= 1.0:
        raise ParameterError("", f"scale {scale:g} is not above 0 and up to 1")
    return max(1, round(width * scale)), max(1, round(height * scale))


def fingerprint(path: str | os.PathLike[str]) -> InputFacts:
    """Identify the content of an input without decoding it.

    A file and a ROS bag's folder are identified by ``bytes`` and ``mtime_ns``, images by their
    number and a SHA-256 of their names, sizes and modification times. Raises SourceError if there
    are no images, and OSError.
    """
    pictures = None if bags.is_bag(Path(path)) else pictures_at(Path(path))
    if pictures is None:
        status = max((file.stat() for file in bags.bag_files(Path(path))), key=lambda s: s.st_size)
        return {"bytes": status.st_size, "mtime_ns": status.st_mtime_ns}
    digest = hashlib.sha256()
    for picture in pictures:
        status = picture.stat()
        line = f"{picture.name}\0{status.st_size}\0{status.st_mtime_ns}\n"
        digest.update(line.encode(errors="replace"))
    return {"pictures": len(pictures), "sha256": digest.hexdigest()}


def content_sha256(path: str | os.PathLike[str], most_bytes: float = math.inf) -> str:
    """SHA-256 of a file, or of all images of an input in order, as hexadecimal digits.

    The result is empty for more than `most_bytes` in all. Raises SourceError if there are no
    images, or if a file cannot be read.
    """
    digest = hashlib.sha256()
    try:
        parts = None if bags.is_bag(Path(path)) else pictures_at(Path(path))
        parts = parts or bags.bag_files(Path(path))
        if most_bytes < math.inf and sum(part.stat().st_size for part in parts) > most_bytes:
            return ""
        for part in parts:
            with part.open("rb") as file:
                while block := file.read(_HASHED_BYTES):
                    digest.update(block)
    except OSError as error:
        why = f"cannot be read ({error.strerror or error})"
        raise SourceError(str(path), why, f"Leave out {argument('hash')}.") from None
    return digest.hexdigest()
