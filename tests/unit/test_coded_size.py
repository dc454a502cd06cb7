"""Sizes in compressed packets, and a change of size seen in step with the decoder."""

import math
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from dlgmd_cli.video.coded_size import coded_size
from dlgmd_cli.video.watch import ResolutionWatch, count_packets

CODECS = ["MJPG", "h264", "hevc", "VP80", "VP90", "mp4v", "MPNG", "what"]
START = b"\0\0\0\1"
SMALL, LARGE = (64, 48), (96, 80)

# Sequence headers as x264 (core 164) and x265 (3.5) write them; the latter less their timing.
X264 = {
    "67640028acd940780227e5c044000003000400000300c83c60c658": (1920, 1080),
    "67640028acd94078044fde0220000003002000000643e2c5b2c0": (1920, 1080),  # interlaced
    "677a000dbcd9415087888fc044000003000400000300c83c50a658": (322, 242),  # 4:2:2
    "67f4000b919b28588f08446022000003000200000300641e28532c": (161, 121),  # 4:4:4
}
X265 = {
    "420101016000000300900000030000030078a003c08010e596566924caf01680": (1920, 1080),
    "4201010408000003009d0800000300003cb00a480f9c93e5959a4932bc05a020": (322, 242),
    # two temporal layers
    "42010201600000030090000003000003003c0000a00a080f1659598acd249caf0168": (320, 240),
}


class BitWriter:
    """Builds headers bit by bit."""

    def __init__(self) -> None:
        self.bits = ""

    def put(self, value: int, n_bits: int) -> "BitWriter":
        self.bits += f"{value:0{n_bits}b}" if n_bits else ""
        return self

    def golomb(self, *values: int) -> "BitWriter":
        for value in values:
            digits = f"{value + 1:b}"
            self.bits += "0" * (len(digits) - 1) + digits
        return self

    def unit(self, head: bytes) -> bytes:
        """A NAL unit with its start code, stop bit and escapes."""
        body = head + self.raw(stop="1")
        escaped = bytearray()
        for byte in body:
            if byte <= 3 and escaped[-2:] == b"\0\0":
                escaped.append(3)
            escaped.append(byte)
        return START + bytes(escaped)

    def raw(self, stop: str = "") -> bytes:
        bits = self.bits + stop
        bits += "0" * (-len(bits) % 8)
        return int(bits or "0", 2).to_bytes(len(bits) // 8, "big")


def h264_header(size: tuple[int, int], number: int = 0) -> bytes:
    """A Baseline sequence header for sizes divisible by 16."""
    bits = BitWriter().put(66, 8).put(0, 8).put(10, 8).golomb(number, 0, 2, 0).put(0, 1)
    return bits.golomb(size[0] // 16 - 1, size[1] // 16 - 1).put(0b11000, 5).unit(b"\x67")


def h264_stream(size: tuple[int, int], n_frames: int) -> bytes:
    """A decodable H.264 stream: an uncompressed grey frame, then frames that repeat it."""
    picture_header = BitWriter().golomb(0, 0).put(0, 2).golomb(0, 0, 0).put(0, 3)
    stream = h264_header(size) + picture_header.golomb(0, 0).put(0, 3).unit(b"\x68")
    n_blocks = size[0] * size[1] // 256
    picture = BitWriter().golomb(0, 7, 0).put(0, 4).golomb(0).put(0, 2).golomb(0)
    for _ in range(n_blocks):
        picture.golomb(25)
        picture.put(0, -len(picture.bits) % 8).put(int.from_bytes(b"\x80" * 384, "big"), 3072)
    stream += picture.unit(b"\x65")
    for number in range(1, n_frames):
        repeat = BitWriter().golomb(0, 5, 0).put(number % 16, 4).put(0, 3).golomb(0, n_blocks)
        stream += repeat.unit(b"\x41")
    return stream


def frames(size: tuple[int, int], n_frames: int) -> Iterator[np.ndarray]:
    """Noise that moves, so that packets are not trivial."""
    rng = np.random.default_rng(1)
    noise = cv2.resize(rng.integers(0, 255, (12, 16, 3), np.uint8), size)
    return (np.roll(noise, 3 * i, axis=1) for i in range(n_frames))


def write_clip(path: Path, fourcc: str, size: tuple[int, int], n_frames: int) -> None:
    """A clip by OpenCV, or a skipped test where it lacks the encoder."""
    code = cv2.VideoWriter.fourcc(*fourcc)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, 25.0, size)
    if not writer.isOpened():
        pytest.skip(f"this OpenCV cannot write {fourcc}")
    for image in frames(size, n_frames):
        writer.write(image)
    writer.release()


def packets(path: Path) -> list[bytes]:
    """The packets of a file."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    found = []
    while capture.grab():
        found.append(capture.retrieve()[1].tobytes())
    capture.release()
    return found


def write_ivf(path: Path, fourcc: bytes, size: tuple[int, int], payloads: list[bytes]) -> None:
    """A file of given packets, 25 to the second."""
    head = struct.pack("<4sHH4sHHIIII", b"DKIF", 0, 32, fourcc, *size, 25, 1, len(payloads), 0)
    chunks = (struct.pack("<IQ", len(data), i) + data for i, data in enumerate(payloads))
    path.write_bytes(head + b"".join(chunks))


def jpegs(size: tuple[int, int], n_frames: int) -> list[bytes]:
    """Pictures for a Motion-JPEG stream."""
    return [cv2.imencode(".jpg", image)[1].tobytes() for image in frames(size, n_frames)]


def watch_decoding(path: Path) -> tuple[int, int | None, tuple[int, int] | None]:
    """Decode a file and watch it: number of frames, index and size at the change."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    watch = ResolutionWatch(str(path))
    n_frames, changed_at, new_size = 0, None, None
    while capture.grab():
        stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
        is_stamp = 0 < stamp_s < 1e6
        size = watch.size_of_next(stamp_s if is_stamp else math.nan)
        if size and changed_at is None:
            changed_at, new_size = n_frames, size
        n_frames += 1
    capture.release()
    watch.close()
    return n_frames, changed_at, new_size


@pytest.mark.parametrize(("header", "size"), X264.items())
def test_reads_the_headers_of_x264(header: str, size: tuple[int, int]) -> None:
    assert coded_size("h264", START + bytes.fromhex(header)) == size


@pytest.mark.parametrize(("header", "size"), X265.items())
def test_reads_the_headers_of_x265(header: str, size: tuple[int, int]) -> None:
    assert coded_size("hevc", START + bytes.fromhex(header)) == size


def test_other_units_may_come_before_the_header_but_pictures_end_the_search() -> None:
    header, size = next(iter(X264.items()))
    unit = START + bytes.fromhex(header)
    assert coded_size("h264", START + b"\x09\xf0" + START[1:] + b"\x06\x05\x01\x00" + unit) == size
    assert coded_size("h264", START + b"\x65\x88\x84" + unit) is None


def test_h264_headers_that_disagree_announce_nothing() -> None:
    one, other = h264_header(SMALL, number=0), h264_header(LARGE, number=1)
    assert coded_size("h264", one + other) is None
    assert coded_size("h264", one + h264_header(LARGE, number=0)) == LARGE


@given(
    blocks=st.tuples(st.integers(1, 500), st.integers(1, 500)),
    crop=st.tuples(*[st.integers(0, 7)] * 4),
    chroma=st.integers(0, 3),
    is_interlaced=st.booleans(),
    scaling=st.lists(st.lists(st.integers(1, 60), min_size=16, max_size=16), max_size=6),
    order_type=st.integers(0, 2),
)
def test_h264_round_trip(
    blocks: tuple[int, int],
    crop: tuple[int, int, int, int],
    chroma: int,
    is_interlaced: bool,
    scaling: list[list[int]],
    order_type: int,
) -> None:
    bits = BitWriter().put(244, 8).put(0, 8).put(40, 8).golomb(0, chroma)
    bits.put(0, 1 if chroma == 3 else 0).golomb(0, 0).put(0, 1).put(1, 1)
    for index in range(12 if chroma == 3 else 8):
        entries = scaling[index] if index < len(scaling) else []
        bits.put(bool(entries), 1)
        for last, entry in zip([8, *entries], entries, strict=False):
            bits.golomb(2 * (entry - last) - 1 if entry > last else 2 * (last - entry))
    bits.golomb(0, order_type)
    if order_type == 0:
        bits.golomb(2)
    elif order_type == 1:
        bits.put(0, 1).golomb(4, 5, 2, 6, 7)
    bits.golomb(3).put(0, 1).golomb(blocks[0] - 1, blocks[1] - 1)
    bits.put(1, 2 if is_interlaced else 1).put(1, 1)
    bits.put(1, 1).golomb(*crop).put(0, 1)
    n_rows = 1 + is_interlaced
    x_step, y_step = {0: (1, 1), 1: (2, 2), 2: (2, 1), 3: (1, 1)}[chroma]
    width = 16 * blocks[0] - x_step * (crop[0] + crop[1])
    height = n_rows * (16 * blocks[1] - y_step * (crop[2] + crop[3]))
    expected = (width, height) if min(width, height) > 0 else None
    assert coded_size("avc1", bits.unit(b"\x67")) == expected


@given(st.integers(1, 16383), st.integers(1, 16383), st.integers(0, 1))
def test_vp8_round_trip(width: int, height: int, n_shown: int) -> None:
    tag = bytes([n_shown << 4, 0, 0])
    packet = tag + b"\x9d\x01\x2a" + struct.pack("<HH", width | 1 << 14, height | 2 << 14)
    assert coded_size("VP80", packet) == (width, height)
    assert coded_size("VP80", bytes([tag[0] | 1]) + packet[1:]) is None


@pytest.mark.parametrize("profile", range(4))
@pytest.mark.parametrize("is_rgb", [False, True])
def test_vp9_key_frame(profile: int, is_rgb: bool) -> None:
    bits = BitWriter().put(2, 2).put(profile & 1, 1).put(profile >> 1, 1)
    bits.put(0, 1 if profile == 3 else 0).put(0b0010, 4).put(0x498342, 24)
    bits.put(0, 1 if profile >= 2 else 0).put(7 if is_rgb else 2, 3)
    bits.put(0, (0 if is_rgb else 1) + (profile % 2) * (1 if is_rgb else 3))
    frame = bits.put(853, 16).put(479, 16).put(0, 16).raw()
    assert coded_size("VP90", frame) == (854, 480)
    hidden = BitWriter().put(2, 2).put(0b0010, 4).put(0, 40).raw()
    index = bytes([0xC1, len(frame), len(hidden), 0xC1])
    assert coded_size("VP90", frame + hidden + index) == (854, 480)


def test_vp9_may_change_its_size_between_key_frames() -> None:
    inter = BitWriter().put(2, 2).put(0b000110, 6).put(0, 2).put(1, 8).put(0, 12)
    new = BitWriter()
    new.bits = inter.bits
    assert coded_size("VP90", inter.put(1, 1).put(0, 40).raw()) is None
    assert coded_size("VP90", new.put(0, 3).put(319, 16).put(239, 16).put(0, 8).raw()) == (320, 240)


@pytest.mark.parametrize("has_extras", [False, True])
@pytest.mark.parametrize("codec", ["mp4v", "FMP4", "XVID", "DIVX", "DX50"])
def test_mpeg4_layer_header(codec: str, has_extras: bool) -> None:
    bits = BitWriter().put(0, 1).put(1, 8)
    if has_extras:
        bits.put(1, 1).put(2, 4).put(1, 3).put(15, 4).put(0x1011, 16)
        bits.put(1, 1).put(0b011, 3).put(1, 1).put(0, 79)
    else:
        bits.put(0, 1).put(1, 4).put(0, 1)
    bits.put(0, 2).put(1, 1).put(30000, 16).put(1, 1)
    bits.put(1, 1).put(1001, 15) if has_extras else bits.put(0, 1)
    layer = bits.put(1, 1).put(720, 13).put(1, 1).put(576, 13).put(1, 1).raw()
    before = b"\0\0\1\xb0\x01\0\0\1\xb5\x89\x13\0\0\1\x00"
    picture = b"\0\0\1\xb6\x10\x60"
    assert coded_size(codec, before + b"\0\0\1\x20" + layer + picture) == (720, 576)
    assert coded_size(codec, before + picture + b"\0\0\1\x20" + layer) is None


def test_jpeg_passes_over_the_thumbnail() -> None:
    inner = cv2.imencode(".jpg", np.zeros((8, 8, 3), np.uint8))[1].tobytes()
    outer = cv2.imencode(".jpg", np.zeros((33, 67, 3), np.uint8))[1].tobytes()
    segment = b"\xff\xff\xe1" + struct.pack(">H", 2 + len(inner)) + inner
    assert coded_size("MJPG", outer[:2] + segment + outer[2:]) == (67, 33)


def test_png_header() -> None:
    picture = cv2.imencode(".png", np.zeros((33, 67, 3), np.uint8))[1].tobytes()
    assert coded_size("MPNG", picture) == coded_size("png ", picture) == (67, 33)


def test_unknown_codec_announces_nothing() -> None:
    assert coded_size("AV01", START + bytes.fromhex(next(iter(X264)))) is None


PREFIXES = [
    b"",
    b"\xff\xd8\xff\xc0",
    START + b"\x67",
    START + b"\x67\x64\x00\x28",
    START + b"\x42\x01",
    b"\x10\0\0\x9d\x01\x2a",
    b"\x82\x49\x83\x42",
    b"\0\0\1\x20",
    b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR",
]


@given(st.sampled_from(CODECS), st.sampled_from(PREFIXES), st.binary(max_size=200))
@example("VP90", b"", b"\xc0")
@example("h264", START + b"\x67", b"\0" * 200)
def test_any_bytes_give_a_size_or_none(codec: str, prefix: bytes, data: bytes) -> None:
    size = coded_size(codec, prefix + data)
    assert size is None or all(0 < side < 65536 for side in size)


@given(st.data())
def test_cut_off_headers_never_raise(data: st.DataObject) -> None:
    codec, header = data.draw(
        st.sampled_from([("h264", h) for h in X264] + [("hevc", h) for h in X265])
    )
    packet = START + bytes.fromhex(header)
    coded_size(codec, packet[: data.draw(st.integers(0, len(packet)))])


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("pattern", [b"\0\0\1\x67", b"\0\0\1\x42\x01", b"\0\0\1\x20", b"\xff\xd8"])
def test_hostile_packets_are_searched_only_so_far(codec: str, pattern: bytes) -> None:
    packet = pattern * 500_000
    start_s = time.process_time()
    coded_size(codec, packet)
    assert time.process_time() - start_s < 1.0


@pytest.mark.parametrize("size", [(64, 48), (130, 98), (322, 242)])
@pytest.mark.parametrize(
    ("fourcc", "suffix"),
    [("MJPG", "avi"), ("mp4v", "mp4"), ("XVID", "avi"), ("VP80", "webm"), ("VP90", "mkv")],
)
def test_sizes_and_counts_agree_with_the_decoder(
    tmp_path: Path, fourcc: str, suffix: str, size: tuple[int, int]
) -> None:
    path = tmp_path / f"clip.{suffix}"
    write_clip(path, fourcc, size, 12)
    announced = {coded_size(fourcc, packet) for packet in packets(path)} - {None}
    # An MP4 keeps the header of MPEG-4 apart.
    assert announced == {size} or suffix == "mp4"
    assert count_packets(str(path)) == 12
    assert watch_decoding(path) == (12, None, None)


def test_change_in_a_jpeg_stream(tmp_path: Path) -> None:
    path = tmp_path / "two.mjpeg"
    path.write_bytes(b"".join(jpegs(SMALL, 5) + jpegs(LARGE, 4) + jpegs(SMALL, 3)))
    assert watch_decoding(path) == (12, 5, LARGE)
    assert count_packets(str(path)) == 12


def test_change_in_an_h264_stream(tmp_path: Path) -> None:
    path = tmp_path / "two.h264"
    path.write_bytes(h264_stream(SMALL, 7) + h264_stream(LARGE, 6))
    assert watch_decoding(path) == (13, 7, LARGE)
    assert count_packets(str(path)) == 13


def test_frames_before_the_first_key_frame_do_not_count(tmp_path: Path) -> None:
    stream = h264_stream(SMALL, 7)
    path = tmp_path / "late.h264"
    path.write_bytes(stream[stream.index(START + b"\x41") :] + stream)
    assert count_packets(str(path)) == 7


def test_interlaced_h264_has_no_count(tmp_path: Path) -> None:
    stream = h264_stream(SMALL, 7)
    path = tmp_path / "fields.h264"
    bits = BitWriter().put(77, 8).put(0, 8).put(10, 8).golomb(0, 0, 2, 0).put(0, 1)
    header = bits.golomb(SMALL[0] // 16 - 1, SMALL[1] // 32 - 1).put(0b001000, 6).unit(b"\x67")
    path.write_bytes(header + stream[len(h264_header(SMALL)) :])
    assert count_packets(str(path)) is None


@pytest.mark.parametrize("fourcc", ["VP80", "VP90"])
def test_change_in_vp8_and_vp9_with_hidden_frames(tmp_path: Path, fourcc: str) -> None:
    parts = []
    for name, size in (("small", SMALL), ("large", LARGE)):
        clip = tmp_path / f"{name}.webm"
        write_clip(clip, fourcc, size, 6)
        parts.append(packets(clip))
    if fourcc == "VP80":
        # The same packet again, not shown: harmless to the decoder, one packet more to us.
        for part in parts:
            part.insert(3, bytes([part[2][0] & 0xEF]) + part[2][1:])
    path = tmp_path / "two.ivf"
    write_ivf(path, fourcc.encode(), SMALL, parts[0] + parts[1])
    assert watch_decoding(path) == (12, 6, LARGE)
    assert count_packets(str(path)) == 12


def test_change_in_mpeg4_whose_first_header_is_outside_the_packets(tmp_path: Path) -> None:
    parts = []
    for name, size in (("small", SMALL), ("large", LARGE)):
        clip = tmp_path / f"{name}.avi"
        write_clip(clip, "XVID", size, 6)
        parts.append(b"".join(packets(clip)))
    path = tmp_path / "two.m4v"
    path.write_bytes(b"".join(parts))
    n_frames, changed_at, size = watch_decoding(path)
    assert (changed_at, size) == (6, LARGE) and n_frames >= 11


def test_timestamps_keep_step_where_frames_are_lost(tmp_path: Path) -> None:
    path = tmp_path / "two.ivf"
    write_ivf(path, b"MJPG", SMALL, jpegs(SMALL, 10) + jpegs(LARGE, 5))
    by_count, by_time = ResolutionWatch(str(path)), ResolutionWatch(str(path))
    decoded = [i for i in range(15) if i not in (4, 5, 6)]
    assert [i for i in decoded if by_count.size_of_next()] == [13, 14]
    assert [i for i in decoded if by_time.size_of_next(i / 25)] == [10, 11, 12, 13, 14]
    by_count.close()
    by_time.close()


def test_timestamps_that_lead_nowhere_are_not_followed(tmp_path: Path) -> None:
    path = tmp_path / "two.h264"
    path.write_bytes(h264_stream(SMALL, 7) + h264_stream(LARGE, 6))
    watch = ResolutionWatch(str(path))
    assert [i for i in range(13) if watch.size_of_next(1e3)] == [7, 8, 9, 10, 11, 12]
    watch.close()


@pytest.mark.parametrize("is_there", [False, True])
def test_what_cannot_be_watched_never_changes(tmp_path: Path, is_there: bool) -> None:
    path = tmp_path / "clip.avi"
    if is_there:
        path.write_bytes(b"no video " * 100)
    watch = ResolutionWatch(str(path))
    assert [watch.size_of_next(i / 25) for i in range(3)] == [None] * 3
    watch.close()
    watch.close()
    assert watch.size_of_next() is None
    assert count_packets(str(path)) is None


def test_a_watch_that_was_never_asked_can_be_closed(tmp_path: Path) -> None:
    ResolutionWatch(str(tmp_path / "none.avi")).close()
