"""Facts that a video file states in its headers and that reading the file depends on."""

import math
import mmap
import re
import struct
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.video.luma import UPRIGHT, Orientation

# Exceptions of reading numbers from damaged bytes.
DAMAGE = (ValueError, LookupError, ArithmeticError, StopIteration, struct.error)
# Matroska: the names of elements.
EBML, SEGMENT, CLUSTER = 0x1A45DFA3, 0x18538067, 0x1F43B675
_TRACKS, _TRACK, _NUMBER, _TYPE, _IS_DEFAULT, _IS_VIDEO = 0x1654AE6B, 0xAE, 0xD7, 0x83, 0x88, 1
_PICTURE, _COLOURS, _TAGS = 0xE0, 0x55B0, (0x55BB, 0x55BA, 0x55B1)
# Transport streams: first byte of a packet, bytes per packet, bytes searched for the first packet.
SYNC, _PACKET_BYTES, _N_BYTES = 0x47, 188, 1 << 16
# Files without times: concatenated images (bare or with HTTP headers), AV1, H.264 and H.265. FFmpeg
# assumes 25 frames/s for all of them. The rate that H.264 may state is often wrong.
_WITHOUT_TIMES = re.compile(
    rb"\s*\xff\xd8\xff|\x89PNG(?!.{,200}acTL)|BM.{4}\0{4}|II\*\0|MM\0\*|RIFF....WEBP"
    rb"|(?:\r\n)?--[^\r\n]+\r\nContent-|\x12\0\x0a|\0?\0\0\x01[\x06\x09\x27\x47\x67\x40\x42\x46\x4e]",
    re.S | re.I,
)


# FFmpeg's names of the transfers, by their numbers in ITU-T H.273.
_TRANSFERS = {
    1: "bt709", 4: "gamma22", 5: "gamma28", 6: "smpte170m", 7: "smpte240m", 8: "linear",
    9: "log100", 10: "log316", 11: "iec61966-2-4", 12: "bt1361e", 13: "iec61966-2-1",
    14: "bt2020-10", 15: "bt2020-12", 16: "smpte2084", 17: "smpte428", 18: "arib-std-b67",
}  # fmt: skip
HDR = ("smpte2084", "arib-std-b67")
_UNKNOWN = 2  # no tag
# The tags with which OpenCV gives the levels of a file. It maps HDR (smpte2084, arib-std-b67) and
# wider primaries to BT.709, by a table that takes seconds to make. For the rest it gives an image
# of zeros, or ends the process.
_KEPT = {
    "transfer": {*range(1, 3), *range(4, 9), *range(11, 16)},
    "matrix": {*range(3), *range(4, 8), 9},
    "primaries": {*range(1, 3), *range(4, 8)},
}


class Colours(NamedTuple):
    """How a file says that its samples are to be shown, by numbers of ITU-T H.273."""

    primaries: int = _UNKNOWN
    transfer: int = _UNKNOWN
    matrix: int = _UNKNOWN

    @property
    def transfer_name(self) -> str:
        """FFmpeg's name of the transfer; empty if the file has no tag."""
        unnamed = "" if self.transfer == _UNKNOWN else f"number {self.transfer}"
        return _TRANSFERS.get(self.transfer, unnamed)

    def changed_by_opencv(self) -> str:
        """Why OpenCV would give other grey levels than the file has; empty if it would not."""
        odd = next((name for name, kept in _KEPT.items() if getattr(self, name) not in kept), "")
        value = self.transfer_name if odd == "transfer" else f"number {getattr(self, odd, '')}"
        return f"OpenCV would change its grey levels ({odd} {value})" if odd else ""


class Stated(NamedTuple):
    """The facts that a file states.

    `kind` is mp4, mkv, avi, flv, ts, mpegvideo, y4m, frames (without times), or empty for others.
    `orientation` is that of an MP4's video. `n_videos` counts the video streams of an MP4 or
    Matroska file, and `is_default` says whether the first video stream is the default. `end_s` is
    the duration in seconds that an MP4's edit list leaves visible, and `held_s` that of its last
    frame, 0 if unknown. `has_length` says whether FFmpeg reports the number of frames or the length
    of the video stream, not of the longest stream.
    `track` is the number of the first video track of an MP4 or Matroska file. `colours` are the
    tags in the headers of such a file; those of the video stream itself take precedence.
    """

    kind: str = ""
    orientation: Orientation = UPRIGHT
    n_videos: int = 1
    is_default: bool = True
    end_s: float = math.inf
    held_s: float = 0.0
    has_length: bool = False
    track: int = 0
    colours: Colours = Colours()

    @property
    def is_in_steps(self) -> bool:
        """Whether the file has only decoding times: AVI, and bare MPEG-1 and MPEG-2."""
        return self.kind in ("avi", "mpegvideo")

    @property
    def counts_from_0(self) -> bool:
        """Whether the stated length counts from time 0, even if the video begins later."""
        return self.kind in ("mkv", "flv")


def stated_by(path: Path) -> Stated:
    """The facts a video file states; all defaults if it is damaged or of another kind."""
    with suppress(OSError, *DAMAGE):
        whole = mapped(path)
        start = whole[:256]
        if start.startswith(EBML.to_bytes(4, "big")):
            return _by_matroska(whole)
        if start[:4] == b"RIFF" and start[8:12] == b"AVI ":
            return Stated("avi", has_length=True)
        if start[:3] == b"FLV":
            return Stated("flv", has_length=start[4] == 1)  # flags: video only, no sound
        if start.startswith(b"\0\0\1\xb3"):
            return Stated("mpegvideo")
        if _WITHOUT_TIMES.match(start):
            return Stated("frames")
        if start.startswith(b"YUV4MPEG2"):
            return Stated("y4m", has_length=True)
        if packets_of_transport(whole[:_N_BYTES]).size:
            return Stated("ts")
        return _by_mp4(memoryview(whole))
    return Stated()


class Structure(NamedTuple):
    """What was found by reading the parts of a file from its first byte to its last.

    `n_frames` is the number of frames, 0 if unknown. `n_faults` counts damaged places, `is_cut`
    says whether the last part is cut off, and `n_joined` is the number of recordings. The first
    fragment of an MP4 has the number `first`.
    """

    n_frames: int = 0
    n_faults: int = 0
    is_cut: bool = False
    n_joined: int = 1
    first: int = 1


def mapped(path: Path) -> mmap.mmap:
    """The bytes of a file, mapped into memory; raises OSError, ValueError for an empty file."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _by_mp4(whole: memoryview) -> Stated:
    movie = next(boxes([whole], b"moov"))
    scale = after_times(next(boxes([movie], b"mvhd")))
    every = list(boxes([movie], b"trak"))
    handlers = [next(boxes(boxes([track], b"mdia"), b"hdlr")) for track in every]
    videos = [
        t for t, handler in zip(every, handlers, strict=True) if bytes(handler[8:12]) == b"vide"
    ]
    headers = [next(boxes([track], b"tkhd")) for track in videos]
    flags = [header[3] & 1 for header in headers]  # whether a track is shown by default
    a, b, _, c, d = struct.unpack_from(">5i", headers[0], 52 if headers[0][0] == 1 else 40)
    edits = next(boxes(boxes([videos[0]], b"edts"), b"elst"), memoryview(bytes(8)))
    parts = struct.iter_unpack(">Qqi" if edits[0] == 1 else ">Iii", edits[8:])
    media = next(boxes(videos, b"mdia"))
    tables = next(boxes(boxes([media], b"minf"), b"stbl"))
    durations, ticks = next(boxes([tables], b"stts")), after_times(next(boxes([media], b"mdhd")))
    return Stated(
        "mp4",
        Orientation.of_matrix(a, b, c, d),
        len(videos),
        flags == sorted(flags, reverse=True),
        sum(part for part, at, _ in parts if at >= 0) / scale or math.inf,
        has_length=len(every) == 1 or not any(boxes([movie], b"mvex")),  # not in fragments
        held_s=number_at(durations, len(durations) - 4) / ticks,
        track=after_times(headers[0]),
        colours=_colours_of_mp4(tables),
    )


def _colours_of_mp4(tables: memoryview) -> Colours:
    for formats in boxes([tables], b"stsd"):
        # The boxes of the first format begin after the table's 8 bytes and the format's 86.
        for tags in boxes([formats[94:]], b"colr"):
            if bytes(tags[:3]) == b"ncl":  # nclx, or QuickTime's nclc; others are ICC profiles
                return Colours(*struct.unpack_from(">3H", tags, 4))
    return Colours()


def boxes(inside: Iterable[memoryview], kind: bytes) -> Iterator[memoryview]:
    """The contents of the boxes of one kind inside other MP4 boxes; ends at damage."""
    for data in inside:
        at = 0
        while at < len(data):
            name, start, end = box(data, at)
            if end < start:
                break
            if name == kind:
                yield data[start:end]
            at = end


def box(data: mmap.mmap | memoryview, at: int) -> tuple[bytes, int, int]:
    """An MP4 box at byte `at`: its kind, and the first and the end byte of its content."""
    size, start = number_at(data, at), at + 8
    if size == 1:
        size, start = int.from_bytes(data[start : start + 8], "big"), start + 8
    return bytes(data[at + 4 : at + 8]), start, at + size if size else len(data)


def after_times(header: memoryview) -> int:
    """The number after the two times of an MP4's header: ticks a second, or a track's number.

    The times have 8 bytes each in version 1 of the header, else 4.
    """
    return number_at(header, 20 if header[0] == 1 else 12)


def number_at(data: mmap.mmap | memoryview, at: int) -> int:
    """The number of 4 bytes in an MP4 box."""
    return int.from_bytes(data[at : at + 4], "big")


def element(data: mmap.mmap | bytes, at: int) -> tuple[int, int, int]:
    """A Matroska element at byte `at`: its name, and the first and the end byte of its content.

    The end is -1 if unknown, as in files that a browser recorded. Raises IndexError.
    """
    start = at + 9 - data[at].bit_length()
    n_size = 9 - data[start].bit_length()
    size = int.from_bytes(data[start : start + n_size], "big") & ~(1 << 7 * n_size)
    is_unknown = size == (1 << 7 * n_size) - 1
    end = -1 if is_unknown else start + n_size + size
    return int.from_bytes(data[at:start], "big"), start + n_size, end


def _elements(data: mmap.mmap | bytes, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """The Matroska elements from byte `at` to `end`, up to the first of unknown size."""
    while 0 <= at < end:
        name, start, at = element(data, at)
        yield name, start, at


def _parts(data: bytes) -> dict[int, bytes]:
    """The contents of the Matroska elements in a small one."""
    return {name: data[start:end] for name, start, end in _elements(data, 0, len(data))}


def _number(parts: dict[int, bytes], name: int, default: int = 0) -> int:
    return int.from_bytes(parts[name][:8], "big") if name in parts else default


def _by_matroska(data: mmap.mmap) -> Stated:
    tracks: list[dict[int, bytes]] = []
    with suppress(*DAMAGE):
        _, at, _ = element(data, element(data, 0)[2])
        for name, start, end in _elements(data, at, len(data)):
            if name == CLUSTER:
                break
            for kind, first, last in _elements(data, start, end) if name == _TRACKS else ():
                if kind == _TRACK:  # not a checksum
                    tracks.append(_parts(data[first:last]))
    videos = [track for track in tracks if _number(track, _TYPE) == _IS_VIDEO]
    flags = [_number(track, _IS_DEFAULT, 1) for track in videos]
    tags: dict[int, bytes] = {}
    with suppress(*DAMAGE):
        tags = _parts(_parts(videos[0][_PICTURE])[_COLOURS])
    return Stated(
        "mkv",
        n_videos=len(videos),
        is_default=flags == sorted(flags, reverse=True),
        has_length=len(tracks) == 1,
        track=_number(videos[0], _NUMBER) if videos else 0,
        colours=Colours(*(_number(tags, name, _UNKNOWN) for name in _TAGS)),
    )


def packets_of_transport(data: mmap.mmap | bytes) -> npt.NDArray[np.uint8]:
    """The packets of a transport stream, (n, 188); n is 0 for other files.

    The file may begin within a packet. Blu-ray's packets of 192 bytes are cut to 188.
    """
    found = np.frombuffer(data, np.uint8)
    for stride in (_PACKET_BYTES, _PACKET_BYTES + 4):
        for first in range(min(stride, len(found))):
            if (found[first : first + 4 * stride : stride] == SYNC).sum() == 4:
                whole = found[first : first + (found.size - first) // stride * stride]
                return whole.reshape(-1, stride)[:, :_PACKET_BYTES]
    return found[:0].reshape(0, _PACKET_BYTES)
