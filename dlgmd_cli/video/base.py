"""What all decoders share: pictures and facts, limits, and what FFmpeg may open."""

import math
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from dlgmd_cli.threads import n_processors, thread_limit

if TYPE_CHECKING:  # loading NumPy takes time, and --help does not need it
    import numpy.typing as npt

DECODERS = ("opencv", "pyav")
DEFAULT_DECODER = "opencv"
FALLBACK_FPS = 30.0
MAX_PLAUSIBLE_FPS = 1000.0
# A damaged packet makes one read fail; at the end of the stream all further reads fail. Pictures
# from before the damage may still be inside the decoder's threads.
READS_PAST_DAMAGE = 32
_MAX_DECODER_THREADS = 16

# What FFmpeg may open: files that hold moving pictures themselves. Left out are lists of other
# files and addresses: concat, hls, dash, sdp, vobsub, image2 and the like.
_FORMATS = (
    *("mov,mp4,m4a,3gp,3g2,mj2", "matroska,webm", "avi", "mpegts", "mpeg", "mpegvideo", "ogg"),
    *("flv", "live_flv", "asf", "mxf", "gxf", "lxf", "nut", "ivf", "dv", "rm", "wtv", "swf", "nsv"),
    *("nuv", "pva", "r3d", "cine", "ser", "dhav", "ifv", "mpegtsraw", "yuv4mpegpipe"),
    *("h264", "hevc", "vvc", "evc", "h261", "h263", "m4v", "vc1", "vc1test", "av1", "obu"),
    *("dirac", "dnxhd", "cavsvideo", "avs2", "avs3", "mjpeg", "mjpeg_2000", "smjpeg", "mpjpeg"),
    *("gif", "apng", "jpegxl_anim", "png_pipe", "jpeg_pipe", "bmp_pipe", "tiff_pipe", "webp_pipe"),
)
FFMPEG_OPTIONS = {"protocol_whitelist": "file", "format_whitelist": ",".join(_FORMATS)}


@dataclass(frozen=True)
class VideoInfo:
    """Facts about an input.

    Attributes
    ----------
    path : str
        Where it is, absolute.
    name : str
        What its results are called: the stem of a file, the name of a folder.
    width, height : int
        Size of its pictures as they are shown, in px.
    fps : float
        Nominal frames per second.
    n_frames : int or None
        How many frames it claims to have: a hint for a progress bar, often wrong.
    decoder : str
        What decodes it: opencv or pyav.
    """

    path: str
    name: str
    width: int
    height: int
    fps: float
    n_frames: int | None
    decoder: str = DEFAULT_DECODER


@dataclass(frozen=True)
class Picture:
    """A decoded picture: uint8 or uint16, (H, W) or (H, W, channels) in BGR order.

    `levels` are the levels of black and white, if they are not the least and the greatest that
    the data type holds.
    """

    index: int
    time_s: float
    image: "npt.NDArray[Any]"
    levels: tuple[int, int] | None = None


@dataclass
class Progress:
    """How far the reading has come, and what went wrong."""

    n_decoded: int = 0
    last_time_s: float = math.nan
    warnings: list[str] = field(default_factory=list)


class Facts(NamedTuple):
    """What a decoder learns when it opens an input; None where the input states nothing.

    `width` and `height` are those of its first frame as it is shown. `shown_s` is the length of
    the part that is shown, in seconds, where an edit list may hide the rest; infinite otherwise.
    """

    width: int
    height: int
    fps: float | None
    n_frames: int | None
    shown_s: float = math.inf


class Unreadable(Exception):  # noqa: N818
    """A file or a frame cannot be decoded; the message says why."""


def decoder_threads() -> int:
    """How many threads a decoder gets: two frames more in flight than there are processors.

    They keep the processors busy while the last frame is converted. A limit of threads holds.
    """
    return thread_limit() or min(n_processors() + 2, _MAX_DECODER_THREADS)


def plausible_fps(fps: float) -> float | None:
    """`fps` if it can be a frame rate, else None."""
    return fps if math.isfinite(fps) and 0.0 < fps <= MAX_PLAUSIBLE_FPS else None


@contextmanager
def openable(path: Path) -> Iterator[str]:
    """A name for an absolute path that FFmpeg opens as it is: no pattern, and valid UTF-8.

    Only opening needs it; reading goes on without.
    """
    name = str(path)
    try:
        name.encode("utf-8")
        needs_link = "%" in name
    except UnicodeEncodeError:  # OpenCV would crash
        needs_link = True
    if not needs_link:
        yield name
        return
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        # The suffix helps FFmpeg to recognise raw streams; an odd one may be part of the trouble.
        suffix = path.suffix if path.suffix[1:].isalnum() and path.suffix.isascii() else ""
        link = Path(folder) / f"video{suffix}"
        with suppress(OSError):  # not every system lets its users make links
            link.symlink_to(path)
            name = str(link)
        yield name
