"""Writing video files, complete or not at all: with OpenCV, or with PyAV for H.264."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.errors import OutputError
from dlgmd_cli.frame import Image
from dlgmd_cli.machine.files import staging
from dlgmd_cli.video.base import openable
from dlgmd_cli.video.opencv import count_frames
from dlgmd_cli.video.pyav import has_av, import_av

WriteFrame = Callable[[Image], Any]

_FOURCC = {"mpeg4": "mp4v", "ffv1": "FFV1"}
# Greatest number of clock ticks per second in MPEG-4.
MAX_TICKS_PER_S = 65_535
# Frame rates that players support.
PLAYABLE_FPS = (1.0, 240.0)

_X264_COLOUR = {"preset": "veryfast", "crf": "20"}
# For a film embedded in a page: small, with fast seeking.
PAGE_FILM = {"preset": "medium", "crf": "27", "g": "15", "bf": "0"}
# For reproducible files: x264's output depends on the number of threads, and with the macroblock
# tree small frames differ once in a few hundred runs.
_X264_GREY = {"preset": "faster", "crf": "18", "threads": "1", "x264-params": "mbtree=0"}
# Limited range, as players expect it: black at 16, white at 235.
_LIMITED: Image = np.rint(16.0 + np.arange(256) * (219.0 / 255.0)).astype(np.uint8)


def best_codec() -> str:
    """`h264`, which every player and browser supports, if PyAV has an encoder; else `mpeg4`."""
    return "h264" if has_av() and "libx264" in import_av().codecs_available else "mpeg4"


def playable_fps(fps: float) -> float:
    """The frame rate closest to `fps` that players support; 30000/1001 stays exactly that."""
    lowest, highest = PLAYABLE_FPS
    return float(encoded_rate(min(max(fps, lowest), highest)))


def encoded_rate(fps: float) -> Fraction:
    """The frame rate as H.264 stores it: 29.97002997 is 30000/1001."""
    return Fraction(fps).limit_denominator(1001)


@contextmanager
def video_writer(
    path: Path,
    shape: tuple[int, int],
    fps: float,
    *,
    codec: str = "mpeg4",
    is_colour: bool = False,
    target: Path | None = None,
    option: str = "--out",
    x264: Mapping[str, str] | None = None,
) -> Iterator[WriteFrame]:
    """A context that yields a function to write each frame; leaving it completes the file.

    The file is written under a temporary name in the same folder and renamed when complete. After
    an exception inside the context, an earlier file is unchanged and no new one is left.

    Parameters
    ----------
    path : Path
        The video; its suffix selects the container, which must be .mp4 for `h264`.
    shape : (int, int)
        H and W, both even; frames are (H, W) uint8 grey, or (H, W, 3) BGR if `is_colour`.
    codec : {"mpeg4", "ffv1", "h264"}
        FFV1 is lossless; H.264 needs PyAV, and the same grey frames always give the same file.
    target, option : Path, str, optional
        For error messages: the file, `path` unless given, and the option to change.
    x264 : mapping, optional
        Encoder options that replace the defaults for H.264.

    Raises
    ------
    OutputError
        If the file cannot be written, or if the disk is full.
    """
    start = partial(_by_pyav, x264) if codec == "h264" else partial(_by_opencv, _FOURCC[codec])
    n_frames = 0
    try:
        with staging(path.parent) as folder:
            file = folder.absolute() / f"video{path.suffix}"
            file.touch()  # an OSError here gives the reason; OpenCV would not
            with openable(file) as name, start(name, shape, fps, is_colour) as encode:

                def write(image: Image) -> None:
                    nonlocal n_frames
                    encode(image)
                    n_frames += 1

                yield write
            # OpenCV does not report a full disk; the file then lacks frames.
            n_written = count_frames(file)
            if n_written != n_frames:
                why = f"only {n_written} of {n_frames} frames arrived on the disk"
                hint = f"Free some space, or choose another {option}."
                raise OutputError(str(target or path), why, hint)
            file.replace(path)
    except OSError as error:
        why = f"cannot be written ({error.strerror or error})"
        hint = f"Choose another {option}, or free some space."
        raise OutputError(str(target or path), why, hint) from None


def write_video(
    path: Path,
    frames: Iterable[Image],
    shape: tuple[int, int],
    fps: float,
    *,
    codec: str = "mpeg4",
    target: Path | None = None,
) -> None:
    """Write (H, W) uint8 grey frames to a video; see `video_writer`."""
    with video_writer(path, shape, fps, codec=codec, target=target) as write:
        for frame in frames:
            write(frame)


@contextmanager
def _by_opencv(
    fourcc: str, name: str, shape: tuple[int, int], fps: float, is_colour: bool
) -> Iterator[WriteFrame]:
    """OpenCV's encoder, which keeps three decimals of a frame rate: 30000/1001 becomes 29.97."""
    if fourcc == _FOURCC["mpeg4"] and fps * 1000 > MAX_TICKS_PER_S:
        fps = round(fps, 2)
    # FFV1 is lossless only if grey frames are passed as grey (the last argument).
    writer = cv2.VideoWriter(
        name, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*fourcc), fps, shape[::-1], is_colour
    )
    try:
        if not writer.isOpened():
            raise OSError("the encoder does not start")
        yield writer.write
    finally:
        writer.release()


@contextmanager
def _by_pyav(
    x264: Mapping[str, str] | None, name: str, shape: tuple[int, int], fps: float, is_colour: bool
) -> Iterator[WriteFrame]:
    """H.264 with the colour space of HD video, and the index first so that browsers can stream."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    def picture_of(image: Image) -> Any:
        """A frame in the encoder's pixel format."""
        if not is_colour:
            return av.VideoFrame.from_ndarray(_planes(image), format="yuv420p")
        return av.VideoFrame.from_ndarray(image, format="bgr24").reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
        )

    try:
        with av.open(name, "w", format="mp4", options={"movflags": "+faststart"}) as container:
            stream: Any = container.add_stream("libx264", rate=encoded_rate(fps))
            stream.height, stream.width = shape
            stream.pix_fmt = "yuv420p"
            stream.options = dict(x264 or (_X264_COLOUR if is_colour else _X264_GREY))
            # Players assume BT.709 for video of this size; state it explicitly.
            context = stream.codec_context
            context.color_range, context.colorspace = ColorRange.MPEG, Colorspace.ITU709
            context.color_primaries = context.color_trc = 1
            yield lambda image: container.mux(stream.encode(picture_of(image)))
            container.mux(stream.encode(None))
    except av.FFmpegError as error:
        raise OSError(error.errno, error.strerror) from None


def _planes(image: Image) -> Image:
    """A grey frame as the planes of yuv420p, one below the other."""
    height, width = image.shape
    planes: Image = np.full((height * 3 // 2, width), 128, np.uint8)
    planes[:height] = _LIMITED[image]
    return planes
