"""Decoding of video files by PyAV, which gives direct access to the luma plane."""

import itertools
import math
import re
import struct
from collections.abc import Generator, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from dlgmd_cli.errors import NOT_INSTALLED, MissingExtraError, argument
from dlgmd_cli.frame import FULL, Image, Levels
from dlgmd_cli.video import base
from dlgmd_cli.video.base import SourceInfo, Unreadable
from dlgmd_cli.video.containers import Colours, stated_by
from dlgmd_cli.video.luma import ENDIAN, LIMITED, UNLIMITED, UPRIGHT, Orientation, luma_plane
from dlgmd_cli.video.opencv_decoder import true_stamps, with_true_rate

if TYPE_CHECKING:
    from av.container import InputContainer
    from av.video.frame import VideoFrame
    from av.video.stream import VideoStream

    Frames = Generator[VideoFrame, None, None]

# OpenCV's limit of undecodable packets in a row. A part of a longer stream begins with many.
_MAX_BAD_PACKETS = 4096
# Frames to look at for interlacing, which is flagged in each frame.
_N_FIELD_FRAMES = 8
_PROGRESSIVE = 1  # AV_FIELD_PROGRESSIVE
# De-interlacing makes one image per frame: frames keep their numbers, times and rate. One image per
# field would double the rate that the models are made for.
_BWDIF = "mode=send_frame:deint=all"
# Types of the parts (NAL units) of H.264 that belong to images.
_PARTS_OF_IMAGE = range(1, 6)
# Number of side data kinds to add: PyAV 18 lacks four of FFmpeg 8; later versions may lack more.
_N_NEWER_KINDS = 16
_DEFAULT, _COVER = 0x1, 0x400  # AV_DISPOSITION_DEFAULT, AV_DISPOSITION_ATTACHED_PIC


class PyAVDecoder:
    """Decodes the frames of a file once, as luma planes; as BGR if the format has no luma plane.

    Raises Unreadable if no frame can be decoded, and MissingExtraError if PyAV is not installed.

    Parameters
    ----------
    name : str
        The file's name, not a pattern.
    deinterlaces : bool
        Pass the frames through FFmpeg's filter bwdif: one image per frame.
    probes : bool
        Decode with one thread, and take the stated rate, which suffices for `details`.

    Notes
    -----
    FFmpeg's messages are discarded, as by PyAV's default: a callback into Python from FFmpeg's
    threads can deadlock. In damaged H.264, the timing of FFmpeg's threads decides which frames
    count as corrupt: reading the file again may end a few frames earlier or later.
    """

    kind = "pyav"
    takes_every_frame = False

    def __init__(self, name: str, *, deinterlaces: bool = False, probes: bool = False) -> None:
        av = import_av()
        self.is_damaged, self._has_begun = False, False
        try:
            self._container: InputContainer = _open(av, name)
        except (av.FFmpegError, ValueError):
            base.require_memory()
            raise Unreadable from None
        streams = video_streams(self._container)
        stream = self._stream = streams[0]
        # One thread per frame if the codec allows, else per slice. PyAV's default is one thread per
        # slice, but most videos have one slice per frame.
        stream.thread_type = "AUTO"
        context = stream.codec_context
        context.thread_count = 1 if probes else base.decoder_threads()
        if max(context.width, context.height) > base.MAX_SIDE:
            self._container.close()
            raise Unreadable(base.TOO_LARGE)
        self._stated = stated = stated_by(Path(name))
        self._frames = self._decoded(av, stream)
        if deinterlaces:
            self._frames = _deinterlaced(av, stream, self._frames)
        first = next(self._frames, None)
        if first is None:
            self.close()
            base.require_memory()
            raise Unreadable
        self._frame = first
        self._orientation = _orientation(av, first)
        self._start_s = _seconds(stream.start_time or 0, stream)
        self.info = self._info(_choice(streams), is_interlaced=deinterlaces)
        if not probes:
            self.info = with_true_rate(self.info, stated, name)

    def _info(self, remark: str, *, is_interlaced: bool) -> SourceInfo:
        """The properties a file states."""
        stream, frame = self._stream, self._frame
        start_s = self._start_s if self._stated.counts_from_0 else 0.0
        rates = (stream.average_rate, stream.guessed_rate, stream.base_rate)
        fps = next((float(r) for r in rates if r and base.plausible_fps(float(r))), None)
        whole_s = (self._container.duration or 0) / 1e6
        length_s = _seconds(stream.duration, stream) if stream.duration else whole_s
        if len(self._container.streams) > 1 and not stream.duration:  # may be of another stream
            length_s = 0.0
        n_frames = stream.frames or max(0, round((length_s - start_s) * (fps or 0.0)))
        pixels = frame.format
        bits, self._samples = _bits(frame), _samples_of(frame)[1:]
        levels = self._samples[1]
        # Each image of ProRes has its own tags, which take precedence.
        context = stream.codec_context
        colours = _colours(frame if context.name == "prores" else context)
        misread = colours.changed_by_opencv()
        if pixels.name.startswith("gray") and levels[0] > 0:
            misread = "its grey levels begin above 0"
        if bits == 16:
            misread = misread or f"OpenCV would keep 8 of its {bits} bits"
        return SourceInfo(
            *self._orientation.size(frame.width, frame.height),
            fps,
            n_frames or None,
            codec=context.name,
            is_interlaced=is_interlaced,
            remark=remark,
            pixel_format=pixels.name,
            bits=bits,
            levels=levels,
            misread=misread,
            turned_deg=self._orientation.turned_deg,
            is_mirrored=self._orientation.is_mirrored,
            transfer=colours.transfer_name,
        )

    def _decoded(self, av: ModuleType, stream: "VideoStream") -> "Frames":
        """All intact frames; of a file that has only decoding times, at these.

        With B-frames, the display times that FFmpeg guesses jump back and forth.
        """
        container = self._container
        n_bad = 0
        context = stream.codec_context
        has_lengths = context.name == "h264" and (context.extradata or b"")[:1] == b"\1"
        packets = container.demux(stream)
        while n_bad < _MAX_BAD_PACKETS:
            packet = None
            try:
                packet = next(packets, None)
                if packet is None:
                    return
                if has_lengths and packet.size and _has_no_image(bytes(packet)):
                    continue
                frames = stream.decode(packet)
            except EOFError:  # the decoder failed while flushing its last frames
                return
            except IndexError:  # PyAV no longer finds the stream in the container
                self.is_damaged = True
                return
            except av.FFmpegError:
                if packet is None and container.format.name == "mpjpeg":  # the closing boundary
                    return
                self.is_damaged = self.is_damaged or self._has_begun
                n_bad += 1
                packets = container.demux(stream)  # the error ended the previous iterator
                continue
            for frame in frames:
                if frame.is_corrupt:
                    self.is_damaged = self.is_damaged or self._has_begun
                else:
                    n_bad, self._has_begun = 0, True
                    if self._stated.is_in_steps:
                        frame.pts = frame.dts
                    yield frame

    def stamps(self) -> Iterator[float]:
        """The timestamp of each frame in seconds from the start of the stream, NaN if missing."""
        return true_stamps(self._stamps(), self._stated, self.info)

    def _stamps(self) -> Iterator[float]:
        """The timestamps as FFmpeg gives them."""
        for frame in itertools.chain([self._frame], self._frames):
            self._frame = frame
            yield _seconds(frame.pts, frame) - self._start_s

    def picture(self) -> Image:
        """The frame of the latest timestamp; the array stays valid after the next call."""
        frame = self._frame
        size = self._orientation.size(frame.width, frame.height)
        if size != self.info.size_wh:
            raise Unreadable(f"the frame size changes to {size[0]}x{size[1]}")
        if _samples_of(frame)[1:] != self._samples:  # they change within the file
            colour_range = LIMITED if self.info.levels[0] else UNLIMITED
            frame = frame.reformat(format=self.info.pixel_format, dst_color_range=colour_range)
        return picture_of(frame, self._orientation)[0]

    def details(self) -> SourceInfo:
        """The source's properties, interlacing included; consumes the first few frames."""
        some = itertools.islice(itertools.chain([self._frame], self._frames), _N_FIELD_FRAMES)
        # PyAV 17 has no `field_order`.
        order = getattr(self._stream.codec_context, "field_order", None)
        is_interlaced = order != _PROGRESSIVE and any(frame.interlaced_frame for frame in some)
        return replace(self.info, is_interlaced=is_interlaced)

    def close(self) -> None:
        """Free the file and all decoded frames; may be called twice."""
        # The generator reads from the container: closing the container first would crash.
        self._frames.close()
        container: InputContainer | None = vars(self).pop("_container", None)
        if container is not None:
            container.close()
        # The codec and the last frame keep some 20 MB of a large image's frames alive.
        vars(self).pop("_stream", None)
        vars(self).pop("_frame", None)


def _has_no_image(packet: bytes) -> bool:
    """Whether a packet of H.264 has messages but no image, as some servers send.

    FFmpeg reports an error for it and drops the last frame. A 4-byte length precedes each part.
    """
    at = 0
    while at + 4 < len(packet):
        if packet[at + 4] & 0x1F in _PARTS_OF_IMAGE:
            return False
        at += 4 + int.from_bytes(packet[at : at + 4], "big")
    return at == len(packet)


def details_of(name: str) -> SourceInfo | None:
    """The properties of a file; None if PyAV is not installed or cannot open the file."""
    try:
        with closing(PyAVDecoder(name, probes=True)) as decoder:
            return decoder.details()
    except (MissingExtraError, Unreadable):
        return None


def _colours(tagged: Any) -> Colours:
    """The colour tags of a frame or a codec context."""
    return Colours(int(tagged.color_primaries), int(tagged.color_trc), int(tagged.colorspace))


def _deinterlaced(av: ModuleType, stream: "VideoStream", frames: "Frames") -> "Frames":
    """De-interlaced frames: each frame's two fields become one image at the frame's time."""
    graph = av.filter.Graph()
    try:
        source = graph.add_buffer(template=stream)
    except ValueError:  # FFmpeg found no frame, thus the stream has no pixel format
        raise Unreadable from None
    nodes = source, graph.add("bwdif", _BWDIF), graph.add("buffersink")
    graph.link_nodes(*nodes).configure()
    size: tuple[int, int] | None = None
    with closing(frames):
        for frame in itertools.chain(frames, [None]):
            if frame is not None:
                size = size or (frame.width, frame.height)
                if (frame.width, frame.height) != size:
                    yield frame  # `picture` refuses a frame of another size
                    return
            graph.push(frame)
            while True:
                try:
                    yield graph.vpull()
                except (BlockingIOError, EOFError):  # needs the next frame, or all frames are out
                    break


def _samples_of(frame: "VideoFrame") -> tuple[str, type | None, Levels]:
    """The format that a frame is read in, the type of its luma plane, and the levels.

    The type is None if there is no luma plane, and the frame is converted to BGR.
    """
    name = re.sub("[bl]e$", ENDIAN, frame.format.name)
    luma = luma_plane(name, int(frame.color_range))
    if luma is not None and frame.planes[0].line_size > 0:
        return name, *luma
    if _bits(frame) > 8:
        return f"bgr48{ENDIAN}", None, (0, 65535)
    return "bgr24", None, FULL


def _bits(frame: "VideoFrame") -> int:
    return max(component.bits for component in frame.format.components)


def picture_of(frame: "VideoFrame", orientation: Orientation = UPRIGHT) -> tuple[Image, Levels]:
    """The image of a frame and its levels: the luma plane (a view), or BGR if there is none."""
    name, kind, levels = _samples_of(frame)
    try:
        if kind is None:
            return orientation.upright(frame.to_ndarray(format=name)), levels
        if name != frame.format.name:
            frame = frame.reformat(format=name)
    except (ValueError, OSError):  # no conversion from this format
        raise Unreadable("the file is damaged") from None
    # The view keeps the frame alive, and the frame keeps its memory.
    plane = frame.planes[0]
    shape, strides = (frame.height, frame.width), (plane.line_size, np.dtype(kind).itemsize)
    image: Image = np.ndarray(shape, kind, memoryview(plane), strides=strides)
    return orientation.upright(image), levels


def has_av() -> bool:
    """Whether PyAV can be used."""
    try:
        import_av()
    except MissingExtraError:
        return False
    return True


def import_av(what: str = "", reason: str = "") -> Any:
    """PyAV; raises MissingExtraError, which names `what` needs PyAV (the decoder) and `reason`."""
    try:
        import av
    except Exception as error:  # whatever a broken installation raises
        if "failed to map segment" in str(error):  # PyAV's libraries do not fit into memory
            raise MemoryError from None
        why = f"cannot be loaded ({str(error) or type(error).__name__})"
        if isinstance(error, ModuleNotFoundError):
            why = NOT_INSTALLED
        instead = "" if what else f"use {argument('decoder', 'opencv')}"
        what = what or argument("decoder", "pyav")
        error = MissingExtraError.of(what, "av", why, instead)
        why = f"{reason}, and {error.why}" if reason else error.why
        raise MissingExtraError(what, why, error.hint) from None
    return av


def _open(av: ModuleType, name: str) -> "InputContainer":
    """The file of this name, for reading."""
    # From release 19 on, PyAV always replaces bytes that are not UTF-8.
    is_strict = int(av.__version__.partition(".")[0]) < 19
    lenient = {"metadata_errors": "replace"} if is_strict else {}
    options = dict(base.FFMPEG_OPTIONS)
    # The prefix "file:" keeps FFmpeg from interpreting the name.
    container: InputContainer = av.open(f"file:{name}", container_options=options, **lenient)
    return container


def _seconds(ticks: int | None, timed: Any) -> float:
    """A time of a frame, packet or stream, from ticks to seconds; NaN for None."""
    return math.nan if ticks is None or timed.time_base is None else float(ticks * timed.time_base)


def video_streams(container: "InputContainer") -> list["VideoStream"]:
    """The decodable video streams without cover images, at least one; the default comes first."""
    decodable = (stream for stream in container.streams.video if stream.codec_context is not None)
    streams = [stream for stream in decodable if not stream.disposition.value & _COVER]
    if not streams:
        container.close()
        raise Unreadable
    return sorted(streams, key=lambda stream: not stream.disposition.value & _DEFAULT)


def _choice(streams: Sequence["VideoStream"]) -> str:
    """Which of several video streams is read, in words; empty if there is only one."""
    number = sorted(stream.index for stream in streams).index(streams[0].index) + 1
    context = streams[0].codec_context
    return base.choice(len(streams), number, context.width, context.height)


def _orientation(av: ModuleType, frame: "VideoFrame") -> Orientation:
    """How the frame is to be turned and mirrored."""
    try:
        side_data = frame.side_data
    except ValueError:  # side data of a kind that PyAV does not know, such as FFmpeg 8's Exif
        side_data = _with_known_side_data(av, frame).side_data
    matrix: Any = side_data.get("DISPLAYMATRIX")
    if matrix is None:
        return UPRIGHT
    a, b, _, c, d, *_ = struct.unpack("=9i", bytes(matrix))
    return Orientation.of_matrix(a, b, c, d)


def _with_known_side_data(av: ModuleType, frame: "VideoFrame") -> "VideoFrame":
    """The frame without side data of kinds that are newer than PyAV."""
    first_unknown = 1 + max(kind.value for kind in av.sidedata.sidedata.Type)
    graph = av.filter.Graph()
    size = {"width": frame.width, "height": frame.height}
    nodes = [graph.add_buffer(**size, format=frame.format, time_base=Fraction(1))]
    for kind in range(first_unknown, first_unknown + _N_NEWER_KINDS):
        nodes.append(graph.add("sidedata", f"mode=delete:type={kind}"))
    graph.link_nodes(*nodes, graph.add("buffersink")).configure()
    graph.push(frame)
    known: VideoFrame = graph.vpull()
    return known
