"""What the containers of video state, by their bytes; or what else a file is."""

import codecs
import itertools
import math
import mmap
import re
import struct
import zlib
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.video.stated import Orientation, Stated

# What reading numbers from damaged bytes raises.
_DAMAGE = (ValueError, LookupError, ArithmeticError, StopIteration, struct.error)
# Of each end of a file; MP4 may describe its streams in either.
_N_BYTES = 1 << 18
# More boxes than that are in no file that is an MP4.
_MAX_BOXES = 10_000
# Of Matroska: the names of elements.
_EBML, _SEGMENT, _SEEK_HEAD, _INFO = b"\x1a\x45\xdf\xa3", 0x18538067, 0x114D9B74, 0x1549A966
_TRACKS, _CUES, _TAGS, _SIMPLE_TAG = 0x1654AE6B, 0x1C53BB6B, 0x1254C367, 0x67C8
# The bits that names of one to four bytes have; a checksum, the first thing in an element.
_CLUSTER, _NAME_BITS, _CHECKSUM = 0x1F43B675, (8, 15, 22, 29), b"\xbf\x84"
# What is in a segment; beside the above, chapters, attachments, space that is left, a checksum.
_OTHERS = (0x1043A770, 0x1941A469, 0xEC, 0xBF)
_OF_SEGMENT = {_SEEK_HEAD, _INFO, _TRACKS, _CUES, _TAGS, _CLUSTER, *_OTHERS}
_IS_VIDEO = 1
# Of MP4 and QuickTime: what a file begins with, and the flag of a track that is shown by default.
_FIRST_BOXES, _ENABLED = (b"ftyp", b"moov", b"mdat", b"wide", b"free", b"skip"), 1
# Codecs put at most so many frames before another in the file that is shown after them.
_MOST_REORDERED = 16
# Lengths that say that they are unknown.
_UNKNOWN = ((1 << 32) - 1, (1 << 64) - 1)
_BOX_NAME = re.compile(rb"[ -~\xa9]{4}")
# Of AVI: two rates that differ by more than this are not the same.
_ANOTHER = 0.01
# Of Windows Media: what a file begins with, and its properties, among them its size.
_ASF = bytes.fromhex("3026b2758e66cf11")
_PROPERTIES = re.escape(bytes.fromhex("a1dcab8c47a9cf118ee400c00c205365"))
# Of transport streams: a packet begins with this byte; those of Blu-ray have a time before it.
_SYNC, _PACKET, _STRIDES, _LEAST_SYNCED = 0x47, 188, (188, 192), 0.05
# What packets of a transport stream call themselves. From the first on, they may be video; those
# after the last are sound or data, too.
_FIRST_VIDEO, _LAST_VIDEO = 0xE0, 0xEF
# The flags of a packet that begins with a key frame, or whose counter begins anew. So many packets
# are looked at together.
_IS_KEY, _ANEW, _BLOCK = 0x40, 0x80, 1 << 14
# Of FLV: the sizes of its header, that of a tag, and the tag at the end of H.264; what tags call
# themselves.
_FLV_HEADER, _TAG_HEADER, _END_TAG, _VIDEO_TAG, _TAGS_OF_FLV = 13, 11, 16, 9, (8, 9, 18)
# The bits of a frame's kind, those of a key frame, and what begins the settings of H.264.
_KIND_OF_FRAME, _KEY_FRAME, _SETTINGS = 0x70, 0x10, b"\x17\0"
# Those of the codec, and the one that says that it is named elsewhere.
_CODEC, _EXTENDED = 0x0F, 0x80
_Y4M, _MPEG_VIDEO, _PNG = b"YUV4MPEG2", b"\0\0\1\xb3", b"\x89PNG\r\n\x1a\n"
# Images one after the other, as they are or with headers of the web, AV1, H.264 and H.265 have no
# times. What H.264 may state of its rate is often wrong; FFmpeg takes 25 a second for all of them.
_WITHOUT_TIMES = re.compile(
    rb"\xff\xd8\xff|\x89PNG|BM.{4}\0{4}|II\*\0|MM\0\*|RIFF....WEBP|(?:\r\n)?--[^\r\n]+\r\nContent-"
    rb"|\x12\0\x0a|\0?\0\0\x01[\x06\x09\x27\x47\x67\x40\x42\x46\x4e]",
    re.S | re.I,
)


def stated_by(path: Path, *, scans: bool = False) -> Stated:
    """What a video file states.

    If it `scans` all of the file, `n_faults` and `is_cut` say what its structure shows of losses.
    Else the first 3 MB of a transport stream are looked at, and nothing of others.
    """
    with suppress(OSError, *_DAMAGE), path.open("rb") as file:
        whole = memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
        start = bytes(whole[:12])
        if start.startswith(_EBML):
            stated = Stated("mkv")
            with suppress(*_DAMAGE):
                stated = _by_matroska(whole)
            return stated._replace(n_faults=_faults_of_matroska(whole)) if scans else stated
        if start[:4] == b"RIFF" and start[8:] == b"AVI ":
            return _by_avi(whole)
        if start[:3] == b"FLV":
            return _by_flv(whole, scans=scans)
        # A damaged name of the first box does not keep FFmpeg from reading an MP4.
        if start[4:8] in _FIRST_BOXES or any(boxes([whole], b"moov")):
            return _by_mp4(whole)
        if start.startswith(_ASF):
            return Stated("asf", is_cut=_size_of_asf(whole) > len(whole))
        if start.startswith(_Y4M):
            return Stated("y4m", is_cut=_ends_within_frame(whole))
        if start.startswith(_MPEG_VIDEO):
            return Stated("mpegvideo")
        if start.startswith(_PNG):
            animated = _by_png(whole, scans=scans)
            return animated if animated.n_frames else Stated("frames", n_faults=animated.n_faults)
        if _WITHOUT_TIMES.match(whole[:_N_BYTES]):
            return Stated("frames")
        return _by_transport(whole, scans=scans)
    return Stated()


def _by_mp4(whole: memoryview) -> Stated:
    movie = next(boxes([whole], b"moov"))
    try:
        return _by_movie(whole, movie)
    except _DAMAGE:
        return Stated("mp4", n_faults=1)


def _by_movie(whole: memoryview, movie: memoryview) -> Stated:
    header = next(boxes([movie], b"mvhd"))
    scale, _ = _clock(header)
    every = [(track, boxes(boxes([track], b"mdia"), b"hdlr")) for track in boxes([movie], b"trak")]
    tracks = [track for track, handlers in every if bytes(next(handlers)[8:12]) == b"vide"]
    flags = [next(boxes([track], b"tkhd"))[3] & _ENABLED for track in tracks]
    track, media = tracks[0], list(boxes([tracks[0]], b"mdia"))
    shown = next(boxes([track], b"tkhd"))
    # The times before the matrix have 8 bytes each in version 1, else 4.
    a, b, _, c, d = struct.unpack_from(">5i", shown, 52 if shown[0] == 1 else 40)
    key = next(boxes(boxes(boxes(media, b"minf"), b"stbl"), b"stss"), b"")
    has_key = bytes(key[8:12]) == b"\0\0\0\1"
    edits = next(boxes(boxes([track], b"edts"), b"elst"), memoryview(bytes(8)))
    parts = list(struct.iter_unpack(">Qqi" if edits[0] == 1 else ">Iii", edits[8:]))
    shown_s = sum(ticks for ticks, at, _ in parts if at >= 0) / scale
    is_fragmented, numbers = any(boxes([movie], b"mvex")), [_number_of(one) for one, _ in every]
    fragments = list(boxes([whole], b"moof")) if is_fragmented else []
    n_frames, n_odd = _frames_of(fragments, _number_of(track), numbers)
    n_faults, is_cut = _faults_of_mp4(whole, is_fragmented=is_fragmented)
    n_faults += n_odd
    n_faults += _contradictions(media, shown_s)
    n_faults += 0 < sum(ticks for ticks, *_ in parts) < 0.8 * _length_of_track(shown)
    return Stated(
        "mp4",
        end_s=shown_s or math.nan,
        n_faults=n_faults,
        has_key=has_key or is_fragmented,
        is_default=flags == sorted(flags, reverse=True),
        n_videos=len(tracks),
        orientation=Orientation.of_matrix(a, b, c, d),
        n_frames=n_frames,
        is_cut=is_cut,
    )


def _frames_of(
    fragments: Sequence[memoryview], mine: bytes, numbers: Sequence[bytes]
) -> tuple[int, int]:
    """The number of a track's frames in fragments, and of their parts without a track or frames.

    The track has the number `mine` of all `numbers`.
    """
    n_frames, n_faults = 0, 0
    for fragment in fragments:
        parts = list(boxes([fragment], b"traf"))
        n_faults += not parts
        for part in parts:
            number, runs = bytes(next(boxes([part], b"tfhd"))[4:8]), list(boxes([part], b"trun"))
            n_faults += number not in numbers or (number == mine and not runs)
            n_frames += sum(int.from_bytes(run[4:8], "big") for run in runs if number == mine)
    return n_frames, n_faults


def _number_of(track: memoryview) -> bytes:
    """The number by which fragments of an MP4 name a track."""
    header = next(boxes([track], b"tkhd"))
    return bytes(header[20 if header[0] == 1 else 12 :][:4])


def _length_of_track(header: memoryview) -> int:
    """The length of an MP4's track by its header: that of all its edits; 0 if it is unknown."""
    (length,) = struct.unpack_from(*((">Q", header, 28) if header[0] == 1 else (">I", header, 20)))
    return 0 if length in _UNKNOWN else int(length)


def _clock(header: memoryview) -> tuple[int, int]:
    """Ticks a second and length in ticks, by the header of an MP4 or of media; 0 if unknown."""
    at = (">IQ", header, 20) if header[0] == 1 else (">II", header, 12)
    scale, length = struct.unpack_from(*at)
    return scale, 0 if length in _UNKNOWN else length


def _contradictions(media: Sequence[memoryview], shown_s: float) -> int:
    """Whether an MP4's media are shorter than what is shown, or than their frames and delays."""
    scale, length = _clock(next(boxes(media, b"mdhd")))
    if not length:
        return 0
    steps, delays = _entries(media, b"stts", ">u4"), _entries(media, b"ctts", ">i4")[:, 1]
    longest = steps[:, 1].max(initial=0.0)
    # Writers differ in the length of the last frame.
    is_other = abs(length - steps.prod(axis=1).sum()) > 1.5 * longest
    is_beyond = bool((np.abs(delays) > length + _MOST_REORDERED * longest).any())
    return int(shown_s > 1.05 * length / scale + 0.1) + int(is_other) + int(is_beyond)


def _entries(media: Sequence[memoryview], name: bytes, kind: str) -> npt.NDArray[np.float64]:
    """The entries of a box of an MP4's media, (n, 2): a number of frames, and ticks of each."""
    box = next(boxes(boxes(boxes(media, b"minf"), b"stbl"), name), memoryview(bytes(8)))
    entries = np.frombuffer(box[8 : len(box) // 8 * 8], kind).astype(float).reshape(-1, 2)
    return entries[: int.from_bytes(box[4:8], "big")]


def _faults_of_mp4(whole: memoryview, *, is_fragmented: bool) -> tuple[int, bool]:
    """The number of places where no box follows another, and whether one ends after the file.

    Zeros at the end stand in the place of fragments; after a whole MP4, they are padding.
    """
    at = 0
    for _ in range(_MAX_BOXES):
        if at + 8 > len(whole):
            break
        size, name = struct.unpack_from(">I4s", whole, at)
        long_size = int.from_bytes(whole[at + 8 : at + 16], "big")
        if not size:  # up to the end, or padding
            is_odd = is_fragmented or any(whole[at : at + _N_BYTES])
            return int(is_odd and not _BOX_NAME.fullmatch(name)), False
        if not _BOX_NAME.fullmatch(name) or 1 < size < 8 or (size == 1 and long_size < 16):
            return 1, False
        at += long_size if size == 1 else size
    return 0, at > len(whole)


def _chunks(data: memoryview) -> Iterator[tuple[bytes, memoryview]]:
    """Name and content of the chunks of a RIFF file, such as an AVI."""
    at = 0
    while at + 8 <= len(data):
        name, size = struct.unpack_from("<4sI", data, at)
        yield name, data[at + 8 : at + 8 + size]
        at += 8 + size + size % 2


def _by_avi(whole: memoryview) -> Stated:
    chunks, n_empty = list(_chunks(whole[12:])), 0
    try:
        header = next(content[4:] for _, content in chunks if bytes(content[:4]) == b"hdrl")
        lists = [part for _, part in _chunks(header) if bytes(part[:4]) == b"strl"]
        streams = [dict(_chunks(part[4:])).get(b"strh", part[:0]) for part in lists]
        videos = [number for number, one in enumerate(streams) if bytes(one[:4]) == b"vids"]
        number = videos[0]
        (step_us,) = struct.unpack_from("<I", dict(_chunks(header))[b"avih"])
        scale, rate = struct.unpack_from("<II", streams[number], 20)
        is_another = step_us and abs(step_us * rate / scale / 1e6 - 1.0) > _ANOTHER
    except _DAMAGE:
        return Stated("avi", n_faults=1)
    with suppress(*_DAMAGE):  # not every file has an index
        index = np.frombuffer(dict(chunks)[b"idx1"], "<u4").reshape(-1, 4)
        # The name of a chunk begins with the number of its stream in two digits.
        is_mine = index[:, 0] & 0xFFFF == int.from_bytes(b"%02d" % number, "little")
        n_empty = int(np.count_nonzero(is_mine & (index[:, 3] == 0)))
    other_fps = 1e6 / step_us if is_another else math.nan
    return Stated("avi", n_videos=len(videos), n_empty=n_empty, other_fps=other_fps)


def _size_of_asf(whole: memoryview) -> int:
    """The size of a Windows Media file in bytes, as it states it; 0 if it does not."""
    size = re.search(_PROPERTIES + rb".{24}(.{8})", whole[:_N_BYTES], re.S)
    return int.from_bytes(size[1], "little") if size else 0


def _elements(data: memoryview) -> Iterator[tuple[int, memoryview, bool]]:
    """Name and content of each element of Matroska, and whether all of it is there."""
    at = 0
    while at < len(data):
        n_name = 9 - data[at].bit_length()
        start = at + n_name
        n_size = 9 - data[start].bit_length()
        size = int.from_bytes(data[start : start + n_size], "big") & ~(1 << 7 * n_size)
        is_unknown = size == (1 << 7 * n_size) - 1
        start, end = start + n_size, len(data) if is_unknown else start + n_size + size
        name = int.from_bytes(data[at : at + n_name], "big")
        yield name, data[start:end], end <= len(data)
        at = end


def _parts(data: memoryview, *names: int) -> Iterator[memoryview]:
    """The elements at a path of names."""
    for name, content, _ in _elements(data):
        if name == names[0]:
            yield from _parts(content, *names[1:]) if names[1:] else [content]


def _number(data: memoryview, *names: int) -> int:
    """The first number at a path of names; 0 for none."""
    return int.from_bytes(next(_parts(data, *names), b""), "big")


def _by_matroska(whole: memoryview) -> Stated:
    segments = ((content, is_all) for name, content, is_all in _elements(whole) if name == _SEGMENT)
    segment, is_whole = next(segments, (whole[:0], True))
    seeks = list(_parts(segment, _SEEK_HEAD, 0x4DBB))
    places = {_number(seek, 0x53AB): _number(seek, 0x53AC) for seek in seeks}

    def listed(name: int) -> memoryview:
        """The content of an element, where the seek head has it or wherever it is; or nothing."""
        at = places.get(name, 0)
        is_there = int.from_bytes(segment[at : at + 4], "big") == name
        with suppress(IndexError, StopIteration):
            return next(_parts(segment[at if is_there else 0 :], name))
        return segment[:0]

    scale_s = (_number(listed(_INFO), 0x2AD7B1) or 1_000_000) * 1e-9
    tracks = list(_parts(listed(_TRACKS), 0xAE))
    videos = [track for track in tracks if _number(track, 0x83) == _IS_VIDEO]
    video = next(iter(videos), segment[:0])
    flags = [bytes(next(_parts(track, 0x88), b"\1")) == b"\1" for track in videos]
    number, uid = _number(video, 0xD7), _number(video, 0x73C5)
    mine = (cue for cue in _parts(listed(_CUES), 0xBB) if _number(cue, 0xB7, 0xF7) == number)
    cues = [_number(cue, 0xB3) * scale_s for cue in mine]
    end_s = math.nan
    for tag in _parts(listed(_TAGS), 0x7373):
        for simple in _parts(tag, _SIMPLE_TAG) if _number(tag, 0x63C0, 0x63C5) == uid else ():
            name, value = (bytes(next(_parts(simple, kind), b"")) for kind in (0x45A3, 0x4487))
            time = re.match(rb"(\d+):(\d+):(\d+\.?\d*)", value)
            if name == b"DURATION" and time:
                end_s = float(time[1]) * 3600.0 + float(time[2]) * 60.0 + float(time[3])
    length = next(_parts(listed(_INFO), 0x4489), b"")
    if math.isnan(end_s) and length and (len(tracks) == 1 or not is_whole):  # of the longest track
        end_s = struct.unpack(">d" if len(length) == 8 else ">f", length)[0] * scale_s
    is_default = flags == sorted(flags, reverse=True)
    begin_s, n_videos = min(cues, default=math.nan), max(1, len(videos))
    return Stated("mkv", begin_s, end_s, is_default=is_default, n_videos=n_videos)


def _faults_of_matroska(whole: memoryview) -> int:
    """The number of places where no known element follows another, or a checksum is wrong."""
    with suppress(IndexError):
        for name, content, _ in _elements(whole):
            if name == _SEGMENT:
                n_unknown = sum(name not in _OF_SEGMENT for name, *_ in _elements(content))
                return n_unknown + _faults_among(content)
    return 1


def _faults_among(data: memoryview) -> int:
    n_faults = 0
    try:
        for name, content, is_all in _elements(data):
            if not is_all or name.bit_length() not in _NAME_BITS:
                return n_faults + 1
            if content[:2] == _CHECKSUM:
                n_faults += zlib.crc32(content[6:]) != int.from_bytes(content[2:6], "little")
            elif name == _CLUSTER:
                n_faults += _faults_among(content)
    except IndexError:  # an element without its size
        n_faults += 1
    return n_faults


def _by_transport(whole: memoryview, *, scans: bool) -> Stated:
    data = np.frombuffer(whole, np.uint8)
    shares = [np.mean(data[n - _PACKET :: n] == _SYNC) for n in _STRIDES if data.size > n]
    if max(shares, default=0.0) < _LEAST_SYNCED:
        return Stated()
    stride = _STRIDES[int(np.argmax(shares))]
    packets = data[: data.size // stride * stride].reshape(-1, stride)[:, stride - _PACKET :]
    n_faults, has_key, video, last = int(data.size % stride > 0), False, -1, None
    n_videos = 1
    for first in range(0, len(packets) if scans else 1, _BLOCK):
        block = packets[first : first + _BLOCK]
        is_synced = block[:, 0] == _SYNC
        n_faults += int(np.count_nonzero(~is_synced))
        pids = (block[:, 1] & 0x1F).astype(np.uint16) << 8 | block[:, 2]
        flags = np.where((block[:, 3] & 0x20 > 0) & (block[:, 4] > 0), block[:, 5], 0)
        is_payload = is_synced & (block[:, 3] & 0x10 > 0)
        starts = 4 + np.where(block[:, 3] & 0x20, block[:, 4].astype(int) + 1, 0)
        begins = np.flatnonzero(is_payload & (block[:, 1] & 0x40 > 0) & (starts <= _PACKET - 4))
        heads = block[begins[:, None], starts[begins, None] + np.arange(4)]
        kinds = np.where((heads[:, :3] == (0, 0, 1)).all(axis=1), heads[:, 3], 0)
        if video < 0 and (kinds >= _FIRST_VIDEO).any():
            first_at = begins[kinds >= _FIRST_VIDEO][0]
            video, has_key = int(pids[first_at]), bool(flags[first_at] & _IS_KEY)
            is_video = (kinds >= _FIRST_VIDEO) & (kinds <= _LAST_VIDEO)
            n_videos = max(1, len(set(pids[begins[is_video]])))
        mine = np.flatnonzero(is_payload & (pids == video))
        # What stands before the payload is too long, or an image begins with something else.
        n_faults += int(np.count_nonzero(starts[mine] >= _PACKET))
        n_faults += int(np.count_nonzero((pids[begins] == video) & (kinds == 0)))
        counts = (block[mine, 3] & 0x0F).astype(int)
        steps = np.diff(counts, prepend=counts[:1] if last is None else last) % 16
        n_faults += int(np.count_nonzero((steps > 1) & (flags[mine] & _ANEW == 0)))
        last = counts[-1] if counts.size else last
    return Stated("ts", n_faults=n_faults, has_key=has_key, n_videos=n_videos)


def boxes(inside: Iterable[memoryview], kind: bytes) -> Iterator[memoryview]:
    """The content of the boxes of one kind inside others."""
    for data in inside:
        at = 0
        for _ in range(_MAX_BOXES):
            if at + 16 > len(data):
                break
            size, name, long_size = struct.unpack_from(">I4sQ", data, at)
            head = 16 if size == 1 else 8
            size = {0: len(data) - at, 1: long_size}.get(size, size)
            if size < head:  # damaged
                break
            if name == kind:
                yield data[at + head : at + size]
            at += size


def _end_of_flv(whole: memoryview) -> float:
    """The end of the video in seconds: the stated length, less by how long sound outlasts it.

    The length is that of the longest stream. NaN if none is stated, or if the file does not end
    with a tag and its size.
    """
    length = re.search(rb"duration\0(.{8})", whole[:_N_BYTES], re.S)
    end, last_ms = len(whole), 0
    while length and end > _FLV_HEADER:
        size = int.from_bytes(whole[end - 4 : end], "big")
        tag = whole[max(0, end - 4 - size) : end - 4]
        if len(tag) < _TAG_HEADER or int.from_bytes(tag[1:4], "big") != size - _TAG_HEADER:
            break
        time_ms = _time_ms(tag)
        last_ms = max(last_ms, time_ms)
        if tag[0] == _VIDEO_TAG and size > _END_TAG:
            (length_s,) = struct.unpack(">d", length[1])
            return float(length_s - (last_ms - time_ms) / 1e3)
        end -= size + 4
    return math.nan


def _time_ms(tag: memoryview) -> int:
    """The time of a tag of an FLV, in ms."""
    return tag[7] << 24 | int.from_bytes(tag[4:7], "big")


def _tags(whole: memoryview) -> Iterator[tuple[int, int, memoryview]]:
    """Kind and time (ms) of each tag of an FLV and two bytes of its content; 0 where none is."""
    at = _FLV_HEADER
    while at < len(whole):
        head = whole[at : at + _TAG_HEADER + 2]
        is_tag = len(head) > _TAG_HEADER and head[0] in _TAGS_OF_FLV and not any(head[8:11])
        if not is_tag:
            yield 0, 0, whole[:0]
            return
        yield head[0], _time_ms(head), head[_TAG_HEADER:]
        at += _TAG_HEADER + int.from_bytes(head[1:4], "big") + 4
    if at > len(whole):
        yield 0, 0, whole[:0]


def _by_flv(whole: memoryview, *, scans: bool) -> Stated:
    videos = (content for kind, _, content in _tags(whole) if kind == _VIDEO_TAG)
    frames = (content[0] for content in videos if content[0] & 15 and bytes(content) != _SETTINGS)
    has_key = next(frames, 0) & _KIND_OF_FRAME == _KEY_FRAME
    n_faults = int(scans and (not has_key or _is_damaged_flv(whole)))
    return Stated("flv", end_s=_end_of_flv(whole), n_faults=n_faults, has_key=has_key)


def _is_damaged_flv(whole: memoryview) -> bool:
    """Whether no tag follows one, or those of video lack a kind, an order or a common codec."""
    tags = list(_tags(whole))
    videos = [(time_ms, content[0]) for kind, time_ms, content in tags if kind == _VIDEO_TAG]
    times = [time_ms for time_ms, _ in videos]
    has_all = all(kind for kind, *_ in tags) and all(first & _KIND_OF_FRAME for _, first in videos)
    codecs = {first & (_EXTENDED if first & _EXTENDED else _CODEC) for _, first in videos}
    return not has_all or len(codecs) > 1 or times != sorted(times)


def _ends_within_frame(whole: memoryview) -> bool:
    """Whether a y4m, whose frames have the same number of bytes, ends within one."""
    first, *others = (found.start() for found in itertools.islice(re.finditer(b"FRAME", whole), 2))
    return bool(others) and (len(whole) - first) % (others[0] - first) > 0


def _by_png(whole: memoryview, *, scans: bool) -> Stated:
    """What an APNG states: the number of its frames, its end, and a checksum for each chunk."""
    at, name, n_frames, n_faults = len(_PNG), b"", 0, 0
    while at + 12 <= len(whole) and name != b"IEND":
        size, name = struct.unpack_from(">I4s", whole, at)
        end = at + 8 + size
        if name == b"IDAT" and not n_frames:
            break
        if name == b"acTL":
            (n_frames,) = struct.unpack_from(">I", whole, at + 8)
        if scans:
            n_faults += zlib.crc32(whole[at + 4 : end]) != int.from_bytes(
                whole[end : end + 4], "big"
            )
        at = end + 4
    is_cut = name != b"IEND" or at > len(whole)
    return Stated("apng", n_faults=n_faults, n_frames=n_frames, is_cut=is_cut)


_LFS = b"version https://git-lfs.github.com/"
_SOUND = re.compile(
    rb"ID3|fLaC|RIFF....WAVE|\xff[\xf2\xf3\xfa\xfb]|OggS.{24}(\x01vorbis|OpusHead|\x7fFLAC)", re.S
)
# The kinds of streams, as MP4, AVI and Matroska describe them.
_STREAM = re.compile(rb"(?:hdlr.{8}|strh.{4}|\x86[\x83-\xa0])(vid[es]|soun|auds|V_|A_)", re.S)
RE_ENCODE = "Try re-encoding it with ffmpeg."


def mistaken(path: Path) -> tuple[str, str]:
    """Why a file without any frame cannot be read, judged by its first bytes, and what to do."""
    with path.open("rb") as file:
        head = file.read(_N_BYTES)
        file.seek(max(0, path.stat().st_size - _N_BYTES))
        streams = {stream for part in (head, file.read()) for stream in _STREAM.findall(part)}
    if head.startswith(_LFS):
        return "is a Git LFS pointer, not the video itself", "Fetch it with 'git lfs pull'."
    if re.match(rb"\s*<(!doctype )?html", head, re.I):
        return "is a web page, not a video", "Download the video itself."
    if head.startswith(b"PK\x03\x04"):
        return "is a ZIP archive, not a video", "Unpack it first."
    if _SOUND.match(head) or (streams and streams <= {b"soun", b"auds", b"A_"}):
        return "has sound, but no video", "Give the video that it belongs to."
    if _is_text(head):
        return "is a text file, not a video", "Give the video."
    if head[4:8] == b"ftyp" and not stated_by(path).kind:
        why = "was not closed: the recording or the copy was cut off before its index (moov)"
        return why, "Copy it again; some cameras complete such a file when they start."
    return "no frame could be decoded, damaged file or missing codec", RE_ENCODE


def _is_text(head: bytes) -> bool:
    """Whether all of it is text in UTF-8; the last letter may be cut."""
    try:
        text = codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return False
    return all(letter.isprintable() or letter.isspace() for letter in text)
