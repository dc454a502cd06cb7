"""Damage of a video file: lost frames, by frame times, the stated length, or the structure."""

import math
import mmap
import re
import struct
import zlib
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import counted
from dlgmd_cli.video import containers
from dlgmd_cli.video.base import SourceInfo, openable
from dlgmd_cli.video.containers import CLUSTER, EBML, SEGMENT, Stated, Structure, mapped
from dlgmd_cli.video.mp4 import structure_of_mp4
from dlgmd_cli.video.opencv_decoder import packet_times
from dlgmd_cli.video.timestamps import FrameRates

# Long intervals at most this number of frames apart belong to the same hole.
_HOLE_EDGE_FRAMES = 5
# Greatest mean number of missing frames per hole that cutting or a short video can explain.
_FEW_FRAMES = 3
# Matroska: elements of a segment, elements of a cluster and its groups, elements of both.
_OF_SEGMENT = {0x114D9B74, 0x1549A966, 0x1654AE6B, 0x1C53BB6B, 0x1254C367, 0x1043A770, 0x1941A469}
_OF_SEGMENT |= {EBML, SEGMENT, CLUSTER}
_GROUP, _BLOCKS, _INVISIBLE = 0xA0, {0xA1, 0xA3}, 0x08
_OF_CLUSTER = {_GROUP, *_BLOCKS, 0xE7, 0xA7, 0xAB, 0xAF, 0x9B, 0xFB, 0xFD, 0xFA, 0xA4, 0x8E}
_OF_CLUSTER |= {0x5854, 0x75A1, 0x75A2}
_OF_EITHER, _CHECKSUM = {0xEC, 0xBF}, b"\xbf\x84"
# Transport streams: first and last stream id of video, and the flag of a counter that restarts.
_FIRST_VIDEO, _LAST_VIDEO, _ANEW = 0xE0, 0xEF, 0x80
# Ticks of 1/90000 s after which their times begin anew, and by which no B-frame goes back.
_WRAP, _BACK = 1 << 33, 45000
Places = npt.NDArray[np.intp]
# AVI: what the index says of an image.
_INDEXED = re.compile(rb"\d\dd[bc].{8}(?!\0{4})", re.S)
# FLV: the first byte of tags of sound, video and data, and the codecs that send more than images.
_TAGS_OF_FLV, _IN_PARTS = (8, 9, 18), (7, 12)
# FLV: the size of the file among the facts at its beginning.
_SIZE_OF_FLV, _N_HEAD = re.compile(rb"filesize\0(.{8})", re.S), 1 << 16
# Number of packets that are checked at a time.
_N_TOGETHER = 1 << 14
# The reason for missing frames if all frames in the file were decoded.
PAUSE = "the recording paused or dropped frames"
# FFmpeg's and OpenCV's names of H.264. Some servers send its messages in packets without an image.
_H264 = ("h264", "avc1")


class Loss(NamedTuple):
    """What a file that was read to its end has lost.

    `fault` says it in words, empty for nothing. `n_short` is the number of the file's frames that
    were not decoded; None if unknown. `remark` says how the file is put together, if unusual.
    """

    fault: str = ""
    n_short: int | None = None
    remark: str = ""


def structure_of(path: Path, stated: Stated) -> Structure:
    """The structure of an MP4, a Matroska file or transport stream; of others, whether it is cut.

    Decoders, stated lengths and times reveal less: of 60 damaged files, 21 with OpenCV and 37 with
    PyAV, instead of 51 and 55.
    """
    with suppress(*containers.DAMAGE):
        if stated.kind == "mp4":
            return structure_of_mp4(mapped(path), stated.track)
        if stated.kind == "mkv":
            return _of_matroska(mapped(path), stated.track)
        readers = {"ts": _of_transport, "flv": _of_flv, "avi": _of_avi, "y4m": _of_y4m}
        if stated.kind in readers:
            return readers[stated.kind](mapped(path))
    return Structure()


def _of_flv(data: mmap.mmap) -> Structure:
    """Counts the images of a file; faults: no tag where one should begin, or of another size."""
    found = _SIZE_OF_FLV.search(data[:_N_HEAD])
    stated = int(struct.unpack(">d", found[1])[0]) if found else 0
    n_frames, n_joined, at = 0, 1, 13
    while at < len(data):
        if data[at : at + 3] == b"FLV":
            n_joined, at = n_joined + 1, at + 13
            continue
        n_bytes = 11 + int.from_bytes(data[at + 1 : at + 4], "big")
        end = at + n_bytes + 4
        if data[at] not in _TAGS_OF_FLV or data[end - 4 : end] != n_bytes.to_bytes(4, "big"):
            is_fault = at < (stated or len(data))  # else it is what follows the file
            return Structure(n_frames, is_fault, is_fault and end > len(data), n_joined)
        is_image = data[at + 11] & 0x0F not in _IN_PARTS or data[at + 12] == 1
        n_frames += data[at] == 9 and is_image
        at = end
    return Structure(n_frames, 0, len(data) < stated, n_joined)


def _of_avi(data: mmap.mmap) -> Structure:
    """Counts the images in the index, but not those left out on purpose, of size 0.

    The number is 0 without an index, or if it is of the first part only.
    """
    parts, at = list[bytes](), 0
    while data[at : at + 4] == b"RIFF":
        parts.append(data[at + 8 : at + 12])
        n_bytes = int.from_bytes(data[at + 4 : at + 8], "little")
        at += 8 + n_bytes + n_bytes % 2
    index = data.rfind(b"idx1") if len(parts) == 1 else -1
    n_frames = len(_INDEXED.findall(data[index:])) if index > 0 else 0
    return Structure(n_frames, n_joined=parts.count(b"AVI "))


def _of_y4m(data: mmap.mmap) -> Structure:
    """Says whether the last frame is shorter than the first; unknown for a single frame."""
    first = data.find(b"FRAME")
    second = data.find(b"FRAME", first + 5)
    return Structure(is_cut=second > 0 and (len(data) - first) % (second - first) > 0)


def _of_matroska(data: mmap.mmap, track: int) -> Structure:
    """Counts a track's visible blocks; faults: unknown elements, wrong lengths or checksums.

    After an element that is unknown or too long, reading goes on at the next cluster.
    """
    n_frames = n_faults = n_joined = at = 0
    end_of_segment = end_of_cluster = math.inf
    is_cut = False
    while 0 <= at < len(data):
        if at >= end_of_segment and data[at : at + 4] != b"\x1a\x45\xdf\xa3":
            break  # padding, or what a camera appends
        try:
            name, start, end = containers.element(data, at)
        except IndexError:
            return Structure(n_frames, n_faults, is_cut=True)
        n_joined += name == EBML
        if name == SEGMENT:
            end_of_segment = end if end >= 0 else math.inf
        is_upper = name in _OF_SEGMENT
        is_between = is_upper and end_of_cluster < math.inf and at != end_of_cluster
        is_odd = not (is_upper or name in _OF_CLUSTER or name in _OF_EITHER)
        is_long = not is_upper and len(data) >= end > end_of_cluster
        n_faults += is_odd or is_long or is_between
        is_there = end <= len(data)
        is_cut |= not (is_there or is_odd)
        if is_odd or is_long:
            at, end_of_cluster = data.find(CLUSTER.to_bytes(4, "big"), at + 1), math.inf
            continue
        if is_upper:
            end_of_cluster = end if name == CLUSTER and end >= 0 else math.inf
            if data[start : start + 2] == _CHECKSUM and is_there:
                crc = zlib.crc32(memoryview(data)[start + 6 : end])
                n_faults += crc != int.from_bytes(data[start + 2 : start + 6], "little")
        if name in _BLOCKS and is_there and data[start] == 0x80 | track:
            n_frames += not data[start + 3] & _INVISIBLE
        at = start if name in (SEGMENT, CLUSTER, _GROUP) else end
    return Structure(n_frames, n_faults, is_cut, n_joined)


def _of_transport(data: mmap.mmap) -> Structure:
    """Counts images of the first video; missing sync bytes and wrong counters are faults."""
    found = containers.packets_of_transport(data)
    packets = found[: 1 + np.flatnonzero(found[:, 0] == containers.SYNC)[-1]]  # padding may follow
    n_faults, video, last = 0, -1, None
    images, jumps = list[int](), list[int]()
    for first in range(0, len(packets), _N_TOGETHER):
        block = packets[first : first + _N_TOGETHER]
        is_synced = block[:, 0] == containers.SYNC
        pids = (block[:, 1] & 0x1F).astype(np.uint16) << 8 | block[:, 2]
        has_more = block[:, 3] & 0x20 > 0  # an adaptation field before the payload
        flags = np.where(has_more & (block[:, 4] > 0), block[:, 5], 0)
        is_payload = is_synced & (block[:, 3] & 0x10 > 0)
        starts = 4 + np.where(has_more, block[:, 4].astype(int) + 1, 0)
        begins = np.flatnonzero(is_payload & (block[:, 1] & 0x40 > 0) & (starts <= 184))
        heads = block[begins[:, None], starts[begins, None] + np.arange(4)]
        is_image = (heads[:, :3] == (0, 0, 1)).all(axis=1)
        is_image &= (heads[:, 3] >= _FIRST_VIDEO) & (heads[:, 3] <= _LAST_VIDEO)
        if video < 0 and is_image.any():
            video = int(pids[begins[is_image][0]])
        mine = np.flatnonzero(is_payload & (pids == video))
        images += [*(first + begins[is_image & (pids[begins] == video)])]
        # Faults: a payload that starts without an image, or an adaptation field without payload.
        n_faults += np.count_nonzero(~is_image & (pids[begins] == video))
        n_faults += np.count_nonzero(~is_synced) + np.count_nonzero(starts[mine] >= 188)
        counts = (block[mine, 3] & 0x0F).astype(int)
        steps = np.diff(counts, prepend=counts[:1] if last is None else last) % 16
        jumps += [*(first + mine[(steps > 1) & (flags[mine] & _ANEW == 0)])]
        last = counts[-1] if counts.size else last
    # A recording of a broadcast may begin and end within a packet.
    is_whole = len(packets) < len(found) or len(data) % packets.strides[0] == 0
    is_cut = data[0] == containers.SYNC and not is_whole
    joints = _joints(packets, np.array(images, np.intp), np.array(jumps, np.intp))
    n_faults += np.count_nonzero(~np.isin(np.searchsorted(images, jumps), joints))
    return Structure(len(images), int(n_faults), is_cut, 1 + len(joints))


def _joints(packets: npt.NDArray[np.uint8], images: Places, jumps: Places) -> Places:
    """Which images begin a recording that was joined to the one before.

    `images` and `jumps` are the packets in which an image begins and in which a counter jumps. At a
    joint the times go back, or the counters of the image and of the table of programs begin at 0.
    """
    heads = packets[images]
    starts = 4 + np.where(heads[:, 3] & 0x20 > 0, heads[:, 4].astype(int) + 1, 0)
    places = np.minimum(starts, 174)[:, None] + np.arange(7, 14)
    fields = np.take_along_axis(heads, places, axis=1)
    (stamped,) = np.nonzero(fields[:, 0] & 0x80)
    bits = fields[stamped, 2:].astype(int) >> (1, 0, 1, 0, 1) & (0x7, 0xFF, 0x7F, 0xFF, 0x7F)
    steps = np.diff(bits @ (1 << 30, 1 << 22, 1 << 15, 1 << 7, 1))
    is_back = (steps + _WRAP // 2) % _WRAP < _WRAP // 2 - _BACK
    anew = [at for at in jumps if not (packets[at - 2 : at + 1, 3] & 0x0F).any()]
    return np.union1d(stamped[1:][is_back], np.searchsorted(images, np.intersect1d(anew, images)))


def missing_frames(
    times: Sequence[float],
    rates: FrameRates | None,
    n_short: int | None = None,
) -> str:
    """A warning about a gap between the times of a stream of constant rate; empty for none.

    `rates` are the frame rates of `times`. `n_short` is the number of the input's frames that were
    not decoded, None if unknown. Holes of a single frame, which many recorders leave, are reported
    only if `n_short` accounts for all. Streams of variable rate, always irregular, have no warning.
    """
    if rates is None or rates.varies:
        return ""
    fps = rates.mean_fps
    intervals = np.diff(times) * fps
    is_steady = np.abs(intervals - 1.0) < 0.25 + 2e-3 * fps
    longs = np.flatnonzero(~is_steady & (intervals > 1.0))
    if longs.size == 0:
        return ""
    # Around a hole, a few long intervals may lie close together: `_HOLE_EDGE_FRAMES` at most.
    starts = np.flatnonzero(np.diff(longs, prepend=-2 * _HOLE_EDGE_FRAMES) > _HOLE_EDGE_FRAMES)
    n_holes, n_long = len(starts), np.diff(starts, append=longs.size)
    n_odd = np.sum(~is_steady) - np.sum(np.minimum(n_long, _HOLE_EDGE_FRAMES))
    n_missing = round(np.sum(np.rint(intervals[longs]) - 1.0))
    # A cut video may have irregular intervals at its end, or a late last frame.
    n_after = len(intervals) - longs[-1]
    is_end = n_holes == 1 and n_after <= _HOLE_EDGE_FRAMES
    is_edge = is_end or (n_holes == 1 and longs[-1] == 0)
    is_short = np.sum(is_steady) < 20 * n_holes
    is_small = n_missing <= _FEW_FRAMES * n_holes
    is_usual = (is_small and (is_edge or is_short)) or (is_end and n_after == 1)
    is_dropped = n_missing < 2 * n_holes and n_missing > (n_short or 0)
    if n_odd > 0 or is_usual or is_dropped:
        return ""
    more = f" and in {n_holes - 1} more places" if n_holes > 1 else ""
    what = "1 frame is" if n_missing == 1 else f"about {n_missing} frames are"
    where = f"after frame {longs[0]} ({times[longs[0]]:.3f} s){more}"
    why = PAUSE if n_short == 0 else "damaged file or dropped frames"
    return f"{what} missing {where}, {why}; do not trust the response there"


def lost_frames(path: Path, info: SourceInfo, times: Sequence[float], *, is_damaged: bool) -> Loss:
    """What a file that was read to its end has lost.

    `times` are the times of all decoded frames in seconds, at least one. `is_damaged` says whether
    the decoder has reported an error.
    """
    stated, fps = containers.stated_by(path), info.fps_stated or info.fps
    structure, n_frames = structure_of(path, stated), info.n_frames or 0
    n_known = structure.n_frames or (n_frames if stated.kind == "avi" else 0)
    n_short = max(0, n_known - len(times)) if n_known else None
    # When the last frame begins. It may be held; an edit list may end within a frame.
    held_s = stated.held_s or 1.0 / fps
    end_s = min(n_frames / fps - held_s, stated.end_s - 1.5 / fps) if stated.has_length else 0.0
    step_s = median(np.diff(times).tolist()) if len(times) > 1 else 1.0 / info.fps
    after_s, remark = times[-1] + 0.5 * step_s, _remark(structure)
    is_late = after_s < end_s and n_short != 0
    n_late = round(times[0] * info.fps)
    has_messages = info.codec.lower() in _H264 and not stated.is_in_steps
    fault = ""
    is_whole = stated.kind == "mp4" and n_short == 0  # only sound is cut off, or a remark
    if is_late or (structure.is_cut and not is_whole):
        fault = "frames are missing, the file is cut off or damaged"
    elif structure.n_faults:
        parts = "fragments" if stated.kind == "mp4" else "packets"
        places = counted(structure.n_faults, "place")
        fault = f"{parts} are damaged or missing in {places} of the file"
    elif structure.n_joined > 1 and stated.kind in ("mp4", "flv") and n_short != 0:
        fault, remark = f"{remark}, and not all of it is read", ""
    elif stated.kind == "mp4" and 0 < n_late <= (n_short or 0):
        first = f"{n_late} frames" if n_late > 1 else "frame"
        fault = f"the first {first} cannot be decoded"
    elif is_damaged and not (has_messages and _is_complete(path, after_s)):
        fault = "the file is damaged"
    # AVI also counts frames left out on purpose: they are not lost. The counters of a transport
    # stream restart after 15 and may miss a loss: 0 lost frames are reported as unknown.
    if fault or (stated.kind == "ts" and not remark):
        n_short = n_short or None
    elif stated.kind == "avi":
        n_short = 0
    return Loss(fault, n_short, remark)


def _remark(structure: Structure) -> str:
    if structure.n_joined > 1:
        return f"the file is {structure.n_joined} recordings, joined"
    return f"the file begins with fragment {structure.first}" if structure.first > 1 else ""


def _is_complete(path: Path, end_s: float) -> bool:
    """Whether no packet is later than `end_s`."""
    with openable(path) as name:
        return max(packet_times(name), default=0.0) < end_s
