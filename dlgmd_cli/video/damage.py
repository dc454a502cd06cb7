"""Damage of a video file: lost frames, by its times, its stated length, or its structure."""

import math
import mmap
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dlgmd_cli.errors import counted
from dlgmd_cli.video.base import SourceInfo
from dlgmd_cli.video.containers import (
    CLUSTER,
    EBML,
    SEGMENT,
    SYNC,
    Stated,
    element,
    mapped,
    packets_of_transport,
)
from dlgmd_cli.video.timestamps import FrameRates

# Long intervals less than this many frames apart belong to the same hole.
_HOLE_EDGE_FRAMES = 5
# Holes of more frames than this, on average, are no irregularity of cutting or of a short video.
_FEW_FRAMES = 3
# Matroska: the elements of a segment; those of a cluster and its blocks; those of either.
_OF_SEGMENT = {0x114D9B74, 0x1549A966, 0x1654AE6B, 0x1C53BB6B, 0x1254C367, 0x1043A770, 0x1941A469}
_OF_SEGMENT |= {int.from_bytes(EBML, "big"), SEGMENT, CLUSTER}
_GROUP, _BLOCKS, _INVISIBLE = 0xA0, {0xA1, 0xA3}, 0x08
_OF_CLUSTER = {_GROUP, *_BLOCKS, 0xE7, 0xA7, 0xAB, 0xAF, 0x9B, 0xFB, 0xFD, 0xFA, 0xA4, 0x8E}
_OF_CLUSTER |= {0x5854, 0x75A1, 0x75A2}
_OF_EITHER, _CHECKSUM = {0xEC, 0xBF}, b"\xbf\x84"
# Transport streams: what packets of video call themselves; the flag of a counter that begins anew.
_FIRST_VIDEO, _LAST_VIDEO, _ANEW = 0xE0, 0xEF, 0x80
# So many packets are looked at together.
_N_TOGETHER = 1 << 14


class Structure(NamedTuple):
    """The number of frames and of damaged places in a Matroska or a transport stream.

    `is_cut` says that an element of Matroska ends after the file.
    """

    n_frames: int = 0
    n_faults: int = 0
    is_cut: bool = False


def structure_of(path: Path, stated: Stated) -> Structure:
    """What the structure of a file shows; nothing of other kinds than the two."""
    if stated.kind == "mkv":
        return _of_matroska(mapped(path), stated.track)
    return _of_transport(mapped(path)) if stated.kind == "ts" else Structure()


def _of_matroska(data: mmap.mmap, track: int) -> Structure:
    """The visible blocks of a track; unknown elements, wrong lengths and wrong checksums.

    After one that is unknown or too long, reading goes on at the next cluster.
    """
    n_frames = n_faults = at = 0
    end_of_cluster, is_cut = math.inf, False
    while 0 <= at < len(data):
        try:
            name, start, end = element(data, at)
        except IndexError:
            return Structure(n_frames, n_faults, is_cut=True)
        is_upper = name in _OF_SEGMENT
        is_between = is_upper and end_of_cluster < math.inf and at != end_of_cluster
        is_odd = not (is_upper or name in _OF_CLUSTER or name in _OF_EITHER)
        is_long = not is_upper and len(data) >= end > end_of_cluster
        n_faults += is_odd or is_long or is_between
        is_cut |= end > len(data) and not is_odd
        if is_odd or is_long:
            at, end_of_cluster = data.find(CLUSTER.to_bytes(4, "big"), at + 1), math.inf
            continue
        if is_upper:
            end_of_cluster = end if name == CLUSTER and end >= 0 else math.inf
            if data[start : start + 2] == _CHECKSUM and end <= len(data):
                crc = zlib.crc32(memoryview(data)[start + 6 : end])
                n_faults += crc != int.from_bytes(data[start + 2 : start + 6], "little")
        if name in _BLOCKS and data[start] == 0x80 | track:
            n_frames += not data[start + 3] & _INVISIBLE
        at = start if name in (SEGMENT, CLUSTER, _GROUP) else end
    return Structure(n_frames, n_faults, is_cut)


def _of_transport(data: mmap.mmap) -> Structure:
    """The images of the first video; packets without sync byte, and wrong continuity counters."""
    packets = packets_of_transport(data)
    n_frames, n_faults, video, last = 0, 0, -1, None
    for first in range(0, len(packets), _N_TOGETHER):
        block = packets[first : first + _N_TOGETHER]
        is_synced = block[:, 0] == SYNC
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
        n_frames += np.count_nonzero(is_image & (pids[begins] == video))
        # An image begins with something else, or what stands before the payload is too long.
        n_faults += np.count_nonzero(~is_image & (pids[begins] == video))
        n_faults += np.count_nonzero(~is_synced) + np.count_nonzero(starts[mine] >= 188)
        counts = (block[mine, 3] & 0x0F).astype(int)
        steps = np.diff(counts, prepend=counts[:1] if last is None else last) % 16
        n_faults += np.count_nonzero((steps > 1) & (flags[mine] & _ANEW == 0))
        last = counts[-1] if counts.size else last
    return Structure(int(n_frames), int(n_faults))


def missing_frames(
    times: Sequence[float],
    rates: FrameRates | None,
    n_short: int = 0,
) -> str | None:
    """A warning about frames that a demuxer skipped in a stream of constant rate, or None.

    `rates` are those of the times. Streams of variable rate have odd intervals everywhere; nothing
    is reported for them. Nor are single frames, which many recorders drop, unless the input states
    so many frames more than were read, `n_short`.
    """
    if rates is None or rates.varies:
        return None
    fps = rates.mean_fps
    intervals = np.diff(times) * fps
    is_steady = np.abs(intervals - 1.0) < 0.25 + 2e-3 * fps
    longs = np.flatnonzero(~is_steady & (intervals > 1.0))
    if longs.size == 0:
        return None
    # The edges of a hole are ragged: several long intervals close together, but not too many.
    starts = np.flatnonzero(np.diff(longs, prepend=-2 * _HOLE_EDGE_FRAMES) > _HOLE_EDGE_FRAMES)
    n_holes, n_long = len(starts), np.diff(starts, append=longs.size)
    n_odd = np.sum(~is_steady) - np.sum(np.minimum(n_long, _HOLE_EDGE_FRAMES))
    n_missing = round(np.sum(np.rint(intervals[longs]) - 1.0))
    # Cutting can leave a video with irregular intervals at its end, or a last frame far behind.
    n_after = len(intervals) - longs[-1]
    is_end = n_holes == 1 and n_after <= _HOLE_EDGE_FRAMES
    is_short = np.sum(is_steady) < 20 * n_holes
    is_small = n_missing <= _FEW_FRAMES * n_holes
    is_usual = (is_small and (is_end or is_short)) or (is_end and n_after == 1)
    is_dropped = n_missing < 2 * n_holes and n_missing > n_short
    if n_odd > 0 or is_usual or is_dropped:
        return None
    more = f" and in {n_holes - 1} more places" if n_holes > 1 else ""
    what = "1 frame is" if n_missing == 1 else f"about {n_missing} frames are"
    where = f"after frame {longs[0]} ({times[longs[0]]:.3f} s){more}"
    why = "damaged file or dropped frames"
    return f"{what} missing {where}, {why}; do not trust the response there"


def lost_frames(
    info: SourceInfo, stated: Stated, structure: Structure, times: Sequence[float]
) -> tuple[str, int]:
    """What a whole file states, or shows by its structure, beyond the frames that were decoded.

    Parameters
    ----------
    info, stated, structure
        What is known of the file.
    times : sequence of float
        The times of all its frames in seconds, at least one.

    Returns
    -------
    str
        The warning, or empty.
    int
        How many frames are known to lack.
    """
    fps = info.fps_stated or info.fps
    n_stated = (info.n_frames or 0) if stated.has_length else structure.n_frames
    n_short = max(0, n_stated - len(times))
    is_short = times[-1] + 1.5 / info.fps < min(n_stated / fps, stated.end_s)
    if structure.is_cut or (stated.has_length and is_short):
        return "frames are missing, the file is cut off or damaged", n_short
    n_late = round(times[0] * info.fps)
    if stated.kind == "mp4" and 0 < n_late <= n_short:
        return f"the first {counted(n_late, 'frame')} cannot be decoded", n_short
    if structure.n_faults:
        places = counted(structure.n_faults, "place")
        return f"packets are damaged or missing in {places} of the file", n_short
    # An AVI counts the frames that it leaves out on purpose, too.
    return "", 0 if stated.kind == "avi" else n_short
