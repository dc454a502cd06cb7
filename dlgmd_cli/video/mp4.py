"""The boxes of an MP4 from its first byte to its last, above all its fragments (OBS, phones)."""

import mmap
import re
from collections.abc import Iterator

import numpy as np

from dlgmd_cli.video.containers import Structure, after_times, box, boxes, number_at

# The beginning of a fragment, after its size, and fewer bytes than a fragment has.
_FRAGMENT, _FEW_BYTES = re.compile(rb"moof.{4}mfhd", re.S), 100

_NOTHING = memoryview(b"")


def structure_of_mp4(data: mmap.mmap, track: int) -> Structure:
    """The frames of the track, and where fragments are damaged, missing, cut off or joined."""
    movies = list(boxes([memoryview(data)], b"moov"))
    is_open = is_fragmented = any(boxes(movies, b"mvex"))
    every = boxes(movies, b"trak")
    tracks = [one for one in every if after_times(next(boxes([one], b"tkhd"))) == track]
    sizes = boxes(boxes(boxes(boxes(tracks, b"mdia"), b"minf"), b"stbl"), b"stsz")
    n_frames = sum(number_at(table, 8) for table in sizes)
    n_faults = first = last = 0
    is_cut, is_unknown, before = False, False, b""
    for kind, at, content in _parts(data):
        if kind == b"moof" and is_fragmented:
            number, n_more = _facts(content, track)
            first = first or (1 if n_frames else number)
            is_late = number > last + 1 and number != first
            n_faults += is_late and before != b""  # else it is counted already
            n_frames, last = n_frames + n_more, number
        elif kind == b"mfra":  # the table of fragments, which ends the file
            is_open = False
        elif not kind and at + len(content) < len(data):
            n_faults += 1
        elif kind == b"cut" or (not kind and is_open and _is_lost(content, data[at - 8 : at])):
            is_cut, is_unknown = True, before != b"moof"
        before = kind
    n_frames += is_fragmented and is_unknown  # a fragment is missing: at least one frame
    return Structure(n_frames, n_faults, is_cut, len(movies), first)


def _parts(data: mmap.mmap) -> Iterator[tuple[bytes, int, memoryview]]:
    """The boxes of a file: kind, first byte and content; the kind is empty for other bytes.

    After these, and after a box that is too long, reading goes on at the next fragment. `cut` is a
    box of frames that the end of the file cuts off.
    """
    at = searched = 0
    while at < len(data):
        kind, start, end = box(data, at)
        further = None
        if not kind.isalnum() or not start <= end <= len(data):
            further = _FRAGMENT.search(data, searched)
            is_cut = further is None and kind in (b"moof", b"mdat") and end > len(data)
            kind, start = b"cut" if is_cut else b"", at
            end = further.start() - 4 if further else len(data)
        yield kind, at, memoryview(data)[start:end]
        at, searched = end, further.end() if further else start


def _facts(fragment: memoryview, track: int) -> tuple[int, int]:
    """The number of a fragment in the file, and the number of its frames of a track."""
    parts = boxes([fragment], b"traf")
    mine = [part for part in parts if number_at(next(boxes([part], b"tfhd"), _NOTHING), 4) == track]
    n_frames = sum(number_at(run, 4) for run in boxes(mine, b"trun"))
    return number_at(next(boxes([fragment], b"mfhd"), _NOTHING), 4), n_frames


def _is_lost(tail: memoryview, before: bytes) -> bool:
    """Whether a file's last bytes, which are no box, were fragments: no padding, and no remark."""
    if not np.frombuffer(tail, np.uint8).any():  # then the last box ends in zeros, too
        return not any(before)
    return len(tail) > _FEW_BYTES or (len(tail) < 8 and tail[0] == 0)
