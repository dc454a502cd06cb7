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
_DAMAGE = (ValueError, LookupError, ArithmeticError, StopIteration, struct.error)
# Matroska: the names of elements.
EBML, SEGMENT, CLUSTER = 0x1A45DFA3, 0x18538067, 0x1F43B675
_TRACKS, _NUMBER, _TYPE, _IS_DEFAULT, _IS_VIDEO = 0x1654AE6B, 0xD7, 0x83, 0x88, 1
# Transport streams: first byte of a packet, bytes per packet, bytes searched for the first packet.
SYNC, _PACKET_BYTES, _N_BYTES = 0x47, 188, 1 << 16
# Files without times: concatenated images (bare or with HTTP headers), AV1, H.264 and H.265. FFmpeg
# assumes 25 frames/s for all of them. The rate that H.264 may state is often wrong.
_WITHOUT_TIMES = re.compile(
    rb"\s*\xff\xd8\xff|\x89PNG(?!.{,200}acTL)|BM.{4}\0{4}|II\*\0|MM\0\*|RIFF....WEBP"
    rb"|(?:\r\n)?--[^\r\n]+\r\nContent-|\x12\0\x0a|\0?\0\0\x01[\x06\x09\x27\x47\x67\x40\x42\x46\x4e]",
    re.S | re.I,
)


class Stated(NamedTuple):
    """The facts that a file states.

    `kind` is mp4, mkv, avi, flv, ts, mpegvideo, frames (without times), or empty for others.
    `orientation` is that of an MP4's video. `n_videos` counts the video streams of an MP4 or
    Matroska file, and `is_default` says whether the first video stream is the default. `end_s` is
    the duration in seconds that an MP4's edit list leaves visible. `has_length` says whether FFmpeg
    reports the number of frames or the length of the video stream, not of the longest stream.
    `track` is the number of a Matroska file's first video track.
    """

    kind: str = ""
    orientation: Orientation = UPRIGHT
    n_videos: int = 1
    is_default: bool = True
    end_s: float = math.inf
    has_length: bool = False
    track: int = 0

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
    with suppress(OSError, *_DAMAGE):
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
        if packets_of_transport(whole[:_N_BYTES]).size:
            return Stated("ts")
        return _by_mp4(memoryview(whole))
    return Stated()


def mapped(path: Path) -> mmap.mmap:
    """The bytes of a file, mapped into memory; raises OSError, ValueError for an empty file."""
    with path.open("rb") as file:
        return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)


def _by_mp4(whole: memoryview) -> Stated:
    movie = next(boxes([whole], b"moov"))
    header = next(boxes([movie], b"mvhd"))
    # The two times before the scale have 8 bytes each in version 1 of the header, else 4.
    (scale,) = struct.unpack_from(">I", header, 20 if header[0] == 1 else 12)
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
    return Stated(
        "mp4",
        Orientation.of_matrix(a, b, c, d),
        len(videos),
        flags == sorted(flags, reverse=True),
        sum(ticks for ticks, at, _ in parts if at >= 0) / scale or math.inf,
        has_length=len(every) == 1 or not any(boxes([movie], b"mvex")),  # not in fragments
    )


def boxes(inside: Iterable[memoryview], kind: bytes) -> Iterator[memoryview]:
    """The contents of the boxes of one kind inside other MP4 boxes; ends at damage."""
    for data in inside:
        at = 0
        while at + 16 <= len(data):
            size, name, long_size = struct.unpack_from(">I4sQ", data, at)
            head = 16 if size == 1 else 8
            size = {0: len(data) - at, 1: long_size}.get(size, size)
            if size < head:
                break
            if name == kind:
                yield data[at + head : at + size]
            at += size


def element(data: mmap.mmap, at: int) -> tuple[int, int, int]:
    """A Matroska element at byte `at`: its name, and the first and the end byte of its content.

    The end is -1 if unknown, as in files that a browser recorded. Raises IndexError.
    """
    start = at + 9 - data[at].bit_length()
    n_size = 9 - data[start].bit_length()
    size = int.from_bytes(data[start : start + n_size], "big") & ~(1 << 7 * n_size)
    is_unknown = size == (1 << 7 * n_size) - 1
    end = -1 if is_unknown else start + n_size + size
    return int.from_bytes(data[at:start], "big"), start + n_size, end


def _elements(data: mmap.mmap, at: int, end: int) -> Iterator[tuple[int, int, int]]:
    """The Matroska elements from byte `at` to `end`, up to the first of unknown size."""
    while 0 <= at < end:
        name, start, at = element(data, at)
        yield name, start, at


def _by_matroska(data: mmap.mmap) -> Stated:
    tracks: list[dict[int, int]] = []
    with suppress(*_DAMAGE):
        _, at, _ = element(data, element(data, 0)[2])
        for name, start, end in _elements(data, at, len(data)):
            if name == CLUSTER:
                break
            for _, first, last in _elements(data, start, end) if name == _TRACKS else ():
                parts = _elements(data, first, last)
                tracks.append({of: int.from_bytes(data[a:b][:8], "big") for of, a, b in parts})
    videos = [track for track in tracks if track.get(_TYPE) == _IS_VIDEO]
    flags = [track.get(_IS_DEFAULT, 1) for track in videos]
    return Stated(
        "mkv",
        n_videos=len(videos),
        is_default=flags == sorted(flags, reverse=True),
        has_length=len(tracks) == 1,
        track=videos[0][_NUMBER] if videos else 0,
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
