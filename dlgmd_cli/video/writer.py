"""Writing video files frame by frame, and clips around alarms; no partial file is left."""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from dlgmd_cli.errors import OutputError, OutputExistsError, argument, overwrite_hint
from dlgmd_cli.frame import Image
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.files import staging
from dlgmd_cli.video.base import ImageOptions, Unreadable, openable
from dlgmd_cli.video.luma import to_bgr
from dlgmd_cli.video.opencv_decoder import count_frames
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.pyav_decoder import has_av, import_av, video_streams

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
    """The frame rate closest to `fps` that players support; 30000/1001 is kept exactly."""
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
    named_by: str = "out",
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
    target, named_by : Path, str, optional
        For error messages: the file, `path` unless given, and the argument that names it.
    x264 : mapping, optional
        Encoder options that replace the defaults for H.264.

    Raises
    ------
    OutputError
        If the file cannot be written, or if the disk is full.
    """
    start = partial(_by_pyav, x264) if codec == "h264" else partial(by_opencv, codec)
    n_frames = 0
    try:
        with staging(path.parent) as folder:
            file = folder.absolute() / f"video{path.suffix}"
            file.touch()  # raises an OSError with the reason; OpenCV gives none
            with openable(file) as name, start(name, shape, fps, is_colour) as encode:

                def write(image: Image) -> None:
                    nonlocal n_frames
                    encode(image)
                    n_frames += 1

                yield write
            # OpenCV does not report a full disk: the file lacks frames.
            n_written = count_frames(file)
            if n_written != n_frames:
                why = f"only {n_written} of {n_frames} frames arrived on the disk"
                hint = f"Free some space, or choose another {argument(named_by)}."
                raise OutputError(str(target or path), why, hint)
            file.replace(path)
    except OSError as error:
        why = f"cannot be written ({error.strerror or error})"
        hint = f"Choose another {argument(named_by)}, or free some space."
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
def by_opencv(
    codec: str, name: str, shape: tuple[int, int], fps: float, is_colour: bool
) -> Iterator[WriteFrame]:
    """OpenCV's encoder, which keeps three decimals of a frame rate: 30000/1001 becomes 29.97.

    The file is complete after the context, see `video_writer`. Raises OSError if the file cannot be
    written.
    """
    if codec == "mpeg4" and fps * 1000 > MAX_TICKS_PER_S:
        fps = round(fps, 2)
    fourcc = cv2.VideoWriter.fourcc(*_FOURCC[codec])
    # FFV1 is lossless only if grey frames are passed as grey (the last argument).
    writer = cv2.VideoWriter(name, cv2.CAP_FFMPEG, fourcc, fps, shape[::-1], is_colour)
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

    def picture_of(image: Image) -> av.VideoFrame:
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
            # Players assume BT.709 for video of this size: state BT.709 explicitly.
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


BEFORE_S, AFTER_S = 2.0, 1.0
# A copied clip begins at a key frame, at most this long before the requested start.
_MAX_EARLY_S = 1.0
# Codecs and containers whose packets fit into an MP4 unchanged: these videos are copied.
_CODECS, _CONTAINERS = {"h264", "hevc", "av1", "vp9", "mpeg4"}, {"mp4", "matroska"}

Spans = Mapping[str, tuple[float, float]]


def clips_of(folder: Path, name: str) -> list[Path]:
    """The clips of an input's alarms in a folder; the folder need not exist."""
    ours = re.compile(rf"{re.escape(name)}-alarm\d+-\d+\.\d\ds\.mp4")
    paths = folder.iterdir() if folder.is_dir() else ()
    return sorted(path for path in paths if ours.fullmatch(path.name))


def refuse_clips(folder: Path, name: str) -> None:
    """Raise OutputExistsError if the folder has clips of an input of this name."""
    if earlier := clips_of(folder, name):
        hint = overwrite_hint("the clips of this name", "clips")
        raise OutputExistsError(str(earlier[0]), "already exists", hint)


def spans_of(name: str, onsets_s: Sequence[float]) -> dict[str, tuple[float, float]]:
    """The clips of alarms that begin at these times: from 2 s before to 1 s after.

    A clip's file name has `name`, the alarm's number and time: ``flight-alarm1-3.97s.mp4``.
    """
    spans = {}
    for number, onset_s in enumerate(onsets_s, 1):
        clip = f"{name}-alarm{number}-{max(onset_s, 0.0):.2f}s.mp4"
        spans[clip] = onset_s - BEFORE_S, onset_s + AFTER_S
    return spans


def make_clips(
    source: str,
    spans: Spans,
    folder: Path,
    of_images: ImageOptions | None = None,
) -> None:
    """Make the clips of `spans_of` in a folder of their own.

    `source` is a path for `open_video`, and `of_images` are its options for images. Copied clips
    keep the video's codec, and begin at a key frame up to 1 s earlier; other clips are H.264, if
    PyAV is installed. Raises SourceError if the source cannot be decoded, OutputError and OSError.
    """
    given = of_images or {}
    rest = {
        clip: span
        for clip, span in spans.items()
        if given.get("times") is not None
        or not _copy(source, span, folder / clip, given.get("input_fps"))
    }
    if rest:
        _encode(source, rest, folder, given)


def _copy(source: str, span_s: tuple[float, float], target: Path, input_fps: float | None) -> bool:
    """Copy the packets of a span; False, and no file, if the packets cannot be copied.

    Packets are not copied if the rate that is given, if any, is not theirs.
    """
    if not (has_av() and Path(source).is_file()):
        return False
    av = import_av()
    start_s, end_s = max(span_s[0], 0.0), span_s[1]
    try:
        with openable(Path(source).absolute()) as name, av.open(f"file:{name}") as video:
            stream: Any = video_streams(video)[0]
            is_fit = _CONTAINERS.intersection(video.format.name.split(","))
            if not is_fit or stream.codec_context.name not in _CODECS:
                return False
            if input_fps not in (None, float(stream.average_rate or 0.0)):
                return False
            first, tick_s = stream.start_time or 0, float(stream.time_base)
            video.seek(first + round(start_s / tick_s), stream=stream)
            packets = video.demux(stream)
            packet = next(packets)
            if not packet.is_keyframe or packet.dts is None:
                return False
            early_s = start_s - (packet.pts - first) * tick_s
            if not -tick_s <= early_s <= _MAX_EARLY_S:
                return False
            begin = packet.dts
            with av.open(str(target), "w", options={"movflags": "+faststart"}) as clip:
                track = clip.add_stream_from_template(stream)
                while packet is not None and packet.dts is not None:
                    # Stop by decoding time: images shown before the end may need later ones.
                    if (packet.dts - first) * tick_s >= end_s:
                        break
                    packet.pts, packet.dts = packet.pts - begin, packet.dts - begin
                    packet.stream = track
                    clip.mux(packet)
                    packet = next(packets, None)
        return True
    except (av.FFmpegError, Unreadable, StopIteration, ValueError):
        target.unlink(missing_ok=True)
        return False


def _encode(source: str, spans: Spans, folder: Path, of_images: ImageOptions) -> None:
    """Encode all spans in one pass through the source; OpenCV gives the colours."""
    waiting = sorted(spans.items(), key=lambda clip: clip[1])
    last_s = max(end_s for _, end_s in spans.values())
    with (
        ExitStack() as stack,
        open_video(source, end_s=last_s, decoder="opencv", **of_images) as video,
    ):
        width, height = (max(2, side - side % 2) for side in video.source_wh)
        fps, running = playable_fps(video.info.fps), []
        for picture in video.pictures():
            cancel.check()
            while waiting and waiting[0][1][0] <= picture.time_s:
                name, (_, end_s) = waiting.pop(0)
                clip = stack.enter_context(ExitStack())
                writer = video_writer(
                    folder / name,
                    (height, width),
                    fps,
                    codec=best_codec(),
                    is_colour=True,
                    named_by="clips",
                )
                running.append((end_s, clip, clip.enter_context(writer)))
            for end_s, clip, write in running[:]:
                if picture.time_s >= end_s:
                    clip.close()
                    running.remove((end_s, clip, write))
                else:
                    write(to_bgr(picture.image, (width, height), video.info.levels))
