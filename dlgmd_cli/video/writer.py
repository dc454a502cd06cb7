"""Frames to a video file, by OpenCV or, where it is installed, by PyAV."""

import tempfile
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import OutputError

Image = npt.NDArray[np.uint8]
Write = Callable[[Image], Any]

_FOURCC = {"mpeg4": "mp4v", "ffv1": "FFV1"}
# What MPEG-4 can count to within a second.
MAX_TICKS_PER_S = 65_535
# What a player can be expected to show.
PLAYABLE_FPS = (1.0, 240.0)

_X264_COLOUR = {"preset": "veryfast", "crf": "20"}
# What x264 makes of a frame depends on the number of threads; and with its macroblock tree, the
# same small frames come out otherwise once in some hundred times.
_X264_GREY = {"preset": "faster", "crf": "18", "threads": "1", "x264-params": "mbtree=0"}
# Grey levels as players expect them: black at 16, white at 235.
_LIMITED: Image = np.rint(16.0 + np.arange(256) * (219.0 / 255.0)).astype(np.uint8)


def best_codec() -> str:
    """`h264`, which every player and browser shows, where PyAV brings an encoder; else `mpeg4`."""
    try:
        import av
    except ImportError:
        return "mpeg4"
    return "h264" if "libx264" in av.codecs_available else "mpeg4"


def playable_fps(fps: float) -> float:
    """The frame rate nearest to `fps` that players cope with and every codec of ours holds."""
    lowest, highest = PLAYABLE_FPS
    rate = min(max(fps, lowest), highest)
    return round(rate, 3 if rate * 1000 <= MAX_TICKS_PER_S else 2)


def open_video(
    path: Path, shape: tuple[int, int], fps: float, *, codec: str, is_colour: bool
) -> AbstractContextManager[Write]:
    """A context that yields what takes frame after frame; leaving it completes the file.

    Parameters
    ----------
    path : Path
        The video; its suffix says the container, which for `h264` must be .mp4.
    shape : (int, int)
        H and W, both even.
    fps : float
        Frames per second.
    codec : {"mpeg4", "ffv1", "h264"}
        FFV1 keeps every grey level; H.264 needs PyAV.
    is_colour : bool
        Whether frames are (H, W, 3) BGR, else (H, W) grey; uint8 both. Grey frames are kept as
        well as H.264 can that is not exact, and the same ones always give the same file.

    Raises
    ------
    OSError
        If the file cannot be written. With OpenCV's codecs, what finds no room on the disk is
        missing in the file without a word: count the frames afterwards, see `check_arrived`.
    """
    if codec == "h264":
        return _by_pyav(path, shape, fps, is_colour)
    return _by_opencv(path, shape, fps, _FOURCC[codec], is_colour)


def encode(
    path: Path, frames: Iterable[Image], shape: tuple[int, int], fps: float, *, codec: str = "mpeg4"
) -> None:
    """Encode grey frames.

    Parameters
    ----------
    path, shape, fps, codec
        See `open_video`.
    frames : iterable of ndarray
        (H, W) uint8 each.

    Raises
    ------
    OSError
        If the file cannot be written at all, see `open_video`.
    """
    with open_video(path, shape, fps, codec=codec, is_colour=False) as write:
        for frame in frames:
            write(frame)


def check_arrived(target: Path, n_written: int, n_frames: int, *, option: str = "--out") -> None:
    """Raise OutputError unless every frame is in the file.

    Parameters
    ----------
    target : Path
        Where the video is to stand, and `option` what says so, for the error.
    n_written, n_frames : int
        Frames that can be decoded from it, and frames that were encoded.
    """
    if n_written != n_frames:
        raise OutputError(
            str(target),
            f"only {n_written} of {n_frames} frames arrived on the disk",
            f"Free some space, or choose another {option}.",
        )


@contextmanager
def _openable(path: Path) -> Iterator[str]:
    """A name for `path` that FFmpeg can take: one that is not valid UTF-8 would crash OpenCV."""
    absolute = path.absolute()  # else FFmpeg reads what stands before a colon as a protocol
    try:
        str(absolute).encode("utf-8")
    except UnicodeEncodeError:
        with tempfile.TemporaryDirectory(prefix="dlgmd-") as temporary:
            link = Path(temporary) / "out"
            link.symlink_to(absolute.parent, target_is_directory=True)
            yield str(link / path.name)
    else:
        yield str(absolute)


@contextmanager
def _by_opencv(
    path: Path, shape: tuple[int, int], fps: float, fourcc: str, is_colour: bool
) -> Iterator[Write]:
    """OpenCV's encoder."""
    height, width = shape
    path.touch()  # if this cannot be done, it says why; OpenCV would not
    with _openable(path) as name:
        # Grey frames go in as they are (the last argument): FFV1 is exact only so.
        writer = cv2.VideoWriter(
            name, cv2.CAP_FFMPEG, cv2.VideoWriter.fourcc(*fourcc), fps, (width, height), is_colour
        )
        try:
            if not writer.isOpened():
                raise OSError("the encoder does not start")
            yield writer.write
        finally:
            writer.release()


@contextmanager
def _by_pyav(path: Path, shape: tuple[int, int], fps: float, is_colour: bool) -> Iterator[Write]:
    """H.264 with the colours of HD video, and the index in front, so that browsers can stream."""
    import av
    from av.video.reformatter import ColorRange, Colorspace

    def picture_of(image: Image) -> Any:
        """A frame as it is encoded."""
        if not is_colour:
            return av.VideoFrame.from_ndarray(_planes(image), format="yuv420p")
        return av.VideoFrame.from_ndarray(image, format="bgr24").reformat(
            format="yuv420p",
            dst_colorspace=Colorspace.ITU709,
            dst_color_range=ColorRange.MPEG,
        )

    height, width = shape
    path.touch()
    with _openable(path) as name:
        try:
            with av.open(name, "w", format="mp4", options={"movflags": "+faststart"}) as container:
                stream: Any = container.add_stream(
                    "libx264", rate=Fraction(fps).limit_denominator(1001)
                )
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                stream.options = _X264_COLOUR if is_colour else _X264_GREY
                # Players take video of this size for BT.709 unless told otherwise; so say it is.
                context = stream.codec_context
                context.color_range, context.colorspace = ColorRange.MPEG, Colorspace.ITU709
                context.color_primaries = context.color_trc = 1

                def write(image: Image) -> None:
                    container.mux(stream.encode(picture_of(image)))

                yield write
                container.mux(stream.encode(None))
        except av.FFmpegError as error:
            raise OSError(error.errno, error.strerror) from None


def _planes(image: Image) -> Image:
    """A grey frame as the planes of yuv420p, one below the other."""
    height, width = image.shape
    planes: Image = np.full((height * 3 // 2, width), 128, np.uint8)
    planes[:height] = _LIMITED[image]
    return planes
