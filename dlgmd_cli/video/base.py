"""Shared by all decoders: names of inputs, limits, `SourceInfo`, and sizes as text."""

import glob
import math
import os
import re
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TypedDict

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.machine.threads import can_start, n_processors, thread_limit
from dlgmd_cli.parameters.checks import shown
from dlgmd_cli.parameters.facts import InputFacts

DECODERS = ("opencv", "pyav")
DEFAULT_DECODER = "opencv"
# Pixel formats of raw frames: FFmpeg's name -> bytes per pixel.
PIXEL_FORMATS = {
    "gray": 1.0,
    "yuv420p": 1.5,
    "nv12": 1.5,
    "yuyv422": 2.0,
    "bgr24": 3.0,
    "rgb24": 3.0,
}
FALLBACK_FPS = 30.0
# Longest side, in px, of an image that is decoded: a small file can state any size.
MAX_SIDE = 8192
TOO_LARGE = f"is larger than {MAX_SIDE}x{MAX_SIDE} px"
MAX_PLAUSIBLE_FPS = 1000.0
# The highest rate that a user may give; a higher one is a time base, or times in another unit.
MAX_FPS = 5000.0
_MAX_DECODER_THREADS = 16
LITTLE_MEMORY = 64 << 20  # bytes

# The formats FFmpeg may open: only files that contain video themselves. Playlists and similar
# formats (concat, hls, dash, sdp, vobsub, image2) could make FFmpeg read other files or a network.
_FORMATS = (
    *("mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm", "avi", "mpegts", "mpeg", "mpegvideo", "ogg"),
    *("flv", "live_flv", "asf", "mxf", "gxf", "lxf", "nut", "ivf", "dv", "rm", "wtv", "swf", "nsv"),
    *("nuv", "pva", "r3d", "cine", "ser", "dhav", "ifv", "mpegtsraw", "yuv4mpegpipe"),
    *("h264", "hevc", "vvc", "evc", "h261", "h263", "m4v", "vc1", "vc1test", "av1", "obu"),
    *("dirac", "dnxhd", "cavsvideo", "avs2", "avs3", "mjpeg", "mjpeg_2000", "smjpeg", "mpjpeg"),
    *("gif", "apng", "jpegxl_anim", "png_pipe", "jpeg_pipe", "bmp_pipe", "tiff_pipe", "webp_pipe"),
)
FFMPEG_OPTIONS = {"protocol_whitelist": "file", "format_whitelist": ",".join(_FORMATS)}


_ENDINGS = """
    264 265 3g2 3gp asf avi bag db3 dv f4v flv gif h264 h265 hevc ivf m2ts m2v m4v mcap mj2 mjpeg
    mjpg mkv mov mp4 mpe mpeg mpg mts mxf nut ogg ogm ogv rm rmvb ts vob webm wmv y4m
"""
_VIDEOS = frozenset(f".{ending}" for ending in _ENDINGS.split())
# FFmpeg's names, FOURCCs and suffixes of what keeps every sample.
_KEEPING = """
    array rawvideo ffv1 ffvh ffvhuff hfyu huffyuv utvideo ulra ulrg uly0 uly2 uly4 ulh0 ulh2 ulh4
    magy magicyuv mpng png apng gif rle qtrle zlib mszh zmbv fsv1 flashsv v210 r210 yuv4
    tiff tif tga targa bmp pbm pgm ppm pnm
"""
_LOSSLESS = frozenset(_KEEPING.split())
# The signal of reference white as a share of the range of HDR, by transfer [ITU-R BT.2408].
_REFERENCE_WHITE = {"smpte2084": 0.58, "arib-std-b67": 0.75}
# The number in a pattern of images, such as %04d.
PRINTF = re.compile(r"%(0?)(\d*)d")
# User names and passwords in a URL: the text before the host, and values whose key looks secret.
_USER = re.compile(r"(?<=://)[^/?#]*@")
_SECRET = re.compile(r"(?i)((?:pass|pwd|pw|secret|token|key|auth|sig|cred)[^=&;/?#]*=)[^&;/#]*")


class ImageOptions(TypedDict, total=False):
    """Options of `open_video` for what an input may not state, or state wrongly."""

    input_fps: float | None
    times: str | None
    bit_depth: int | None
    topic: str | None


class Crop(NamedTuple):
    """A rectangle of an image, in px, with its top left corner at (`x`, `y`)."""

    width: int
    height: int
    x: int
    y: int

    def shares(self, picture_wh: tuple[int, int]) -> tuple[float, float, float, float]:
        """The rectangle's left, top, right and bottom edges, as shares of an image's sides."""
        width, height = picture_wh
        right, bottom = self.x + self.width, self.y + self.height
        return self.x / width, self.y / height, right / width, bottom / height

    def overhang(self, picture_wh: tuple[int, int]) -> str:
        """How the rectangle extends beyond an image of this size, for an error; empty if inside."""
        width, height = picture_wh
        if self.x + self.width <= width and self.y + self.height <= height:
            return ""
        return f"{argument('crop')} {self} reaches outside its frames of {width}x{height}"

    def __str__(self) -> str:
        return f"{self.width}x{self.height}+{self.x}+{self.y}"


@dataclass(frozen=True)
class SourceInfo:
    """Properties of a source. A decoder fills them in; `open_video` adds those from `fps` on.

    `width` and `height` are those of the upright images, in px. `fps_stated` is the frame rate that
    the source states, None for none. `n_frames` is the stated number of frames, often wrong: a hint
    for a progress bar. `codec` is FFmpeg's name, or the FOURCC where FFmpeg's name is unknown.
    `is_interlaced` says that frames consist of two fields, which PyAV de-interlaces. `remark` is a
    line for the user about how the source is read.

    `levels` are those of black and white of the images as they are decoded, and `bits` the bits per
    sample that the source states; with a bit depth given, its levels are in `Video.info`.

    Of video, only PyAV fills in `bits` and the next four, also where OpenCV decodes: FFmpeg's name
    of the pixel format, why OpenCV would decode wrong grey levels (`misread`, empty if it would
    not), the angle in degrees by which the images are turned clockwise to be upright, as the file
    asks, and whether they are then mirrored. `transfer` is FFmpeg's name of the transfer (such as
    bt709, or smpte2084 of HDR), empty for none.

    `fps` is the nominal frame rate: what the user gave, else the stated rate, or the rate between
    gaps if the stated rate is a lower average. `path` is absolute, and `given` is the path or name
    passed to `open_video`. `name` names the results: the stem of a file, the name of a folder.
    `decoder` is opencv, pyav, rosbags or array. `identity` identifies the content without decoding
    it, see `fingerprint`. `start` says what the clock showed at the first frame, see `start_of`.
    """

    width: int
    height: int
    fps_stated: float | None
    n_frames: int | None
    codec: str = ""
    is_interlaced: bool = False
    remark: str = ""
    pixel_format: str = ""
    bits: int | None = None
    levels: tuple[int, int] = (0, 255)
    misread: str = ""
    turned_deg: int | None = None
    is_mirrored: bool | None = None
    transfer: str = ""
    fps: float = math.nan
    path: str = ""
    name: str = ""
    decoder: str = ""
    identity: InputFacts = field(default_factory=InputFacts)
    given: str = ""
    start: InputFacts = field(default_factory=InputFacts)

    @property
    def size_wh(self) -> tuple[int, int]:
        """Width and height of the source's images, in px."""
        return self.width, self.height

    @property
    def diffuse_levels(self) -> tuple[int, int]:
        """The levels of black and of reference white, which only the highlights of HDR exceed."""
        black, white = self.levels
        return black, round(black + _REFERENCE_WHITE.get(self.transfer, 1.0) * (white - black))

    @property
    def is_lossless(self) -> bool:
        """Whether the source keeps every sample, so that duplicates are equal images."""
        if self.decoder == "rosbags":
            return re.search("jpe?g", self.codec) is None
        # OpenCV has no FOURCC for raw video.
        return not self.codec or self.codec.lower() in _LOSSLESS


class Unreadable(Exception):  # noqa: N818
    """A file or frame that cannot be decoded; the message gives the reason."""


class MissingCodec(Unreadable):
    """A file that opens, but has no decodable frame; the message names the codec."""


def choice(n_videos: int, number: int, width: int, height: int) -> str:
    """Which of several video streams is read, in words; empty if there is only one."""
    if n_videos < 2:
        return ""
    what = f"the file has {n_videos} video streams; number {number} is read, the default"
    return f"{what} ({width}x{height})"


def decoder_threads() -> int:
    """Number of threads for a decoder: one per processor, unless a limit is set.

    More threads take more CPU time, a tenth for small images, and save no time. The number is 1 if
    the system refuses twice as many threads: FFmpeg starts the same number again to convert an
    image.
    """
    count = thread_limit() or min(n_processors(), _MAX_DECODER_THREADS)
    return count if count == 1 or can_start(2 * count + 1) else 1


def require_memory() -> None:
    """Raise MemoryError if little memory is left: FFmpeg would report a damaged file instead."""
    import numpy as np

    np.empty(LITTLE_MEMORY, np.uint8)  # allocated only: writing to the array would take 40 ms


def _numbers(pattern: str, text: Any) -> list[int]:
    """The whole numbers in place of each N of `pattern`; empty if the text does not match.

    The numbers themselves may be given in place of a text.
    """
    if isinstance(text, tuple):
        is_fitting = len(text) == pattern.count("N") and all(type(part) is int for part in text)
        return [*text] if is_fitting and min(text) >= 0 else []
    numbers = pattern.replace("N", r"(\d{1,6})")
    match = isinstance(text, str) and re.fullmatch(numbers, text.strip(), re.ASCII)
    return [int(number) for number in match.groups()] if match else []


def parse_size(text: Any, name: str = "") -> tuple[int, int]:
    """`480x270` -> (480, 270), as a pair; raises ParameterError."""
    sides = _numbers("N[x×X*]N", text)
    if not sides:
        raise ParameterError("", f"{shown(text)} is not WIDTHxHEIGHT", "Write 480x270.")
    return checked_size((sides[0], sides[1]))


def checked_size(size_wh: tuple[int, int]) -> tuple[int, int]:
    """`size_wh` in px if images may have it; raises ParameterError otherwise."""
    if not all(1 <= side <= MAX_SIDE for side in size_wh):
        raise ParameterError("", f"size {size_wh[0]}x{size_wh[1]} is not within 1 to {MAX_SIDE} px")
    return size_wh


def parse_crop(text: Any, name: str = "") -> Crop:
    """`640x360+0+60` -> Crop(640, 360, 0, 60), as four numbers; raises ParameterError."""
    numbers = _numbers(r"N[x×X*]N\+N\+N", text)
    if not numbers or not numbers[0] or not numbers[1]:
        hint = "Write 640x360+0+60: 640x360 px, 0 px from the left and 60 px from the top."
        raise ParameterError("", f"{shown(text)} is not WIDTHxHEIGHT+X+Y", hint)
    return Crop(*numbers)


def plausible_fps(fps: float) -> float | None:
    """`fps` if it is a plausible frame rate, else None."""
    return fps if math.isfinite(fps) and 0.0 < fps <= MAX_PLAUSIBLE_FPS else None


@contextmanager
def openable(path: Path) -> Iterator[str]:
    """A file name that FFmpeg takes literally (no pattern, valid UTF-8) for an absolute path.

    The name must exist while the file is opened, not while it is read.
    """
    name = str(path)
    is_utf8 = name.encode("utf-8", "replace").decode("utf-8") == name  # else OpenCV would crash
    if is_utf8 and "%" not in name:
        yield name
        return
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        # FFmpeg recognises raw streams by their suffix; an unusual suffix may prevent opening.
        suffix = path.suffix if path.suffix[1:].isalnum() and path.suffix.isascii() else ""
        link = Path(folder) / f"video{suffix}"
        with suppress(OSError):  # some systems do not let users create links
            link.symlink_to(path)
            name = str(link)
        yield name


def is_video(name: str) -> bool:
    """Whether a file name has the suffix of a video."""
    return PurePosixPath(name).suffix.lower() in _VIDEOS


def is_pattern(text: str) -> bool:
    """Whether a path is a glob, or a printf pattern with one %d."""
    return glob.has_magic(text) or PRINTF.search(Path(text).name) is not None


def picture_folder(path: str | os.PathLike[str]) -> Path:
    """The folder of a sequence of images, for a path that is a folder or a pattern."""
    folder = Path(path).absolute()
    while not folder.is_dir() and is_pattern(folder.name):
        folder = folder.parent
    return folder.resolve()


def input_name(path: str | os.PathLike[str], *, are_pictures: bool) -> str:
    """Name of an input's results: the stem of a file; for images, the folder's name."""
    if are_pictures:
        return picture_folder(path).name or "root"
    return Path(path).stem or Path(path).name


def without_password(source: str) -> str:
    """A URL without the user and password, and with ``***`` for other values that look secret."""
    return _SECRET.sub(r"\1***", _USER.sub("", source))
