"""What is lost of a video, by what its container states; and what only looks like a loss."""

import struct
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

av = pytest.importorskip("av", reason="PyAV writes these videos")

from damaged import audio_only, copied, encode  # noqa: E402

from dlgmd_cli.errors import SourceError  # noqa: E402
from dlgmd_cli.video.base import StreamInfo  # noqa: E402
from dlgmd_cli.video.opening import open_video  # noqa: E402
from dlgmd_cli.video.pyav import in_steps  # noqa: E402
from dlgmd_cli.video.stated import Stated, measured  # noqa: E402

FPS, GOP = 30, 15
OPTIONS = {"g": str(GOP), "bf": "0", "keyint_min": str(GOP), "sc_threshold": "0"}
pytestmark = pytest.mark.skipif("libx264" not in av.codecs_available, reason="writes H.264")


def write(path, n_frames=45, codec="libx264", options=OPTIONS, **how):
    """A video whose frames move."""
    ground = np.random.default_rng(4).integers(0, 255, (48, 64 + n_frames), dtype=np.uint8)
    frames = [ground[:, n : n + 64] for n in range(n_frames)]
    return encode(path, frames, codec, options=options, fps=FPS, **how)


def packets(path):
    with av.open(str(path)) as container:
        return [(one.pos, one.size) for one in container.demux(video=0) if one.size]


def zero(path, number, skip=0):
    """Zero a packet, or all but its headers; of a transport stream, its first byte or content."""
    (at, size), *_ = [*packets(path)[number:], None]
    data, end = bytearray(path.read_bytes()), at + size
    if path.suffix != ".ts":
        data[at + skip : end] = bytes(size - skip)
    elif not skip:
        data[at] = 0
    else:
        for start in range(at, packets(path)[number + 1][0], 188):
            head = 40 if start == at else 12
            data[start + head : start + 188] = bytes(188 - head)
    path.write_bytes(data)
    return path


def read(path, decoder):
    """Numbers and times of the frames, and what is told of damage."""
    with open_video(path, decoder=decoder) as video:
        frames = [(one.index, one.time_s) for one in video]
        return [index for index, _ in frames], [time_s for _, time_s in frames], video.progress


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "avi"])
@pytest.mark.parametrize("skip", [0, 8], ids=["packet", "content"])
def test_a_lost_beginning_counts(tmp_path, decoder, suffix, skip):
    """Nothing can be decoded before the second key frame."""
    how = {"codec": "mjpeg", "pixels": "yuvj420p", "options": {}} if suffix == "avi" else {}
    path = zero(write(tmp_path / f"x.{suffix}", **how), 0, skip)
    indices, times, progress = read(path, decoder)
    n_lost = 1 if suffix == "avi" else GOP
    if suffix == "ts" and not skip:  # with it, the time of its first frame is lost
        n_lost -= 1
    assert indices == list(range(n_lost, n_lost + len(indices))) and indices[-1] in (43, 44)
    assert times == pytest.approx([n / FPS for n in indices], abs=2e-3)
    assert progress.damage[0].startswith(f"the first {n_lost} of 4")


def start_time(path, ticks):
    """Write a video whose first stamp is above 0."""
    return copied(write(path.with_name(f"whole{path.suffix}")), path, shift=ticks)


def hidden_start(path):
    """Write an MP4 whose edit list hides the first frames, which are no key frames but one."""
    path = write(path)
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") + 12
    (duration,) = struct.unpack_from(">I", data, at)
    ticks = 512 * 5  # of the 15360 a second that FFmpeg writes
    struct.pack_into(">Ii", data, at, duration - 5 * 1000 // FPS, ticks)
    path.write_bytes(data)
    return path


SOUND = {
    "late.ts": lambda path: write(path),  # at 1.4 s
    "late.mkv": lambda path: start_time(path, 5000),
    "late.mp4": lambda path: start_time(path, 5 * 15360),
    "edited.mp4": hidden_start,
    "b-frames.mp4": lambda path: write(path, options={**OPTIONS, "bf": "3"}),
    "b-frames.mkv": lambda path: write(path, options={**OPTIONS, "bf": "3"}),
    "b-frames.ts": lambda path: write(path, options={**OPTIONS, "bf": "3"}),
    "b-frames.avi": lambda path: write(path, options={**OPTIONS, "bf": "3"}),
    "cut.mkv": lambda path: copied(write(path.with_name("whole.mkv")), path, first=GOP),
    "cut.mp4": lambda path: copied(write(path.with_name("whole.mp4")), path, first=GOP),
    "cut.ts": lambda path: copied(write(path.with_name("whole.ts")), path, first=GOP),
    "amid.ts": lambda path: copied(write(path.with_name("whole.ts")), path, first=5),
    "open.mkv": lambda path: copied(
        write(
            path.with_name("whole.mkv"),
            options={"g": "15", "x264-params": "open-gop=1:bframes=3:scenecut=0:b-adapt=0"},
        ),
        path,
        first=GOP,
    ),
}


@pytest.mark.parametrize("name", SOUND)
def test_what_begins_late_has_lost_nothing(tmp_path, decoder, name):
    indices, times, progress = read(SOUND[name](tmp_path / name), decoder)
    assert indices[0] == 0 and len(indices) >= 15
    assert progress.damage == []
    if name not in ("amid.ts", "open.mkv"):
        assert times[0] == 0.0


@pytest.mark.parametrize("number", [44, 40])
@pytest.mark.parametrize("suffix", ["mkv", "ts"])
def test_a_lost_end_is_told(tmp_path, decoder, suffix, number):
    """The first byte of a packet is zeroed: its block, or its part of the stream, is lost."""
    path = write(tmp_path / f"x.{suffix}")
    at, _ = packets(path)[number]
    data = bytearray(path.read_bytes())
    data[at] = 0
    path.write_bytes(data)
    indices, _, progress = read(path, decoder)
    assert len(indices) < 45 and len(progress.damage) == 1


WRITTEN = {
    "x.ts": {},
    "x.flv": {"codec": "flv", "options": {"g": "15"}},
    "x.mkv": {"codec": "mpeg4", "options": {"g": "15"}},
    "x.avi": {"codec": "mjpeg", "options": {}, "pixels": "yuvj420p"},
    "x.mp4": {"options": {**OPTIONS, "bf": "2"}},
    "mpeg4.mp4": {"codec": "mpeg4", "options": {}},
    "fragments.mp4": {"container": {"movflags": "frag_keyframe+empty_moov"}},
}
IN_1_PLACE = "packets are damaged or missing in 1 place"


@pytest.mark.parametrize("name", WRITTEN)
def test_what_is_changed_below_is_sound(tmp_path, decoder, name):
    indices, _, progress = read(write(tmp_path / name, **WRITTEN[name]), decoder)
    assert indices == list(range(45)) and progress.warnings == []


def put(data, at, content):
    """Other bytes at a place."""
    return data[:at] + content + data[at + len(content) :]


def number(data, box, place, value):
    """Another number behind the name of a box."""
    return put(data, data.index(box) + place, struct.pack(">I", value))


# The file, how it is changed about a packet of so many bytes, and what is told.
CHANGES = {
    "a packet is lost": ("x.ts", lambda data, at, _: data[:at] + data[at + 188 :], IN_1_PLACE),
    "four are": ("x.ts", lambda data, at, _: data[:at] + data[at + 4 * 188 :], IN_1_PLACE),
    "the last is not whole": ("x.ts", lambda data, *_: data[:-100], IN_1_PLACE),
    # The length of what stands before an image is within the packet; each image has a mark.
    "length": ("x.ts", lambda data, at, _: put(data, at + 4, b"\xf0"), ""),
    "mark": ("x.ts", lambda d, at, _: put(d, d.index(b"\0\0\1\xe0", at) + 2, b"\xf0"), ""),
    "time of a tag": ("x.flv", lambda data, at, _: put(data, at + 5, b"\x0d"), IN_1_PLACE),
    "codec of a tag": ("x.flv", lambda data, at, _: put(data, at + 11, b"\x4d"), IN_1_PLACE),
    "extended codec": ("x.flv", lambda data, at, _: put(data, at + 11, b"\xd2"), IN_1_PLACE),
    "kind of a tag": ("x.flv", lambda data, at, _: put(data, at, b"\x19"), "damaged"),
    # The first tag has no image.
    "the first image": (
        "x.flv",
        lambda data, *_: put(data, 28 + int.from_bytes(data[14:17], "big"), b"\x12"),
        "damaged",
    ),
    "name of an index": (
        "x.mkv",
        lambda data, *_: put(data, data.rindex(b"\x1c\x53\xbb\x6b"), b"\x1c\x53\xbb\xe2"),
        "1 place",
    ),
    "a bit of an image": (
        "x.mkv",
        lambda data, at, size: put(data, at + size // 2, bytes([data[at + size // 2] ^ 0x10])),
        "damaged",
    ),
    "checksum": ("x.mkv", lambda data, *_: data.replace(b"DURATION", b"DURATIOM"), "1 place"),
    "name of a header": ("x.avi", lambda d, *_: d.replace(b"hdrl", b"hdrd", 1), "are damaged"),
    "name of a stream": ("x.avi", lambda d, *_: d.replace(b"strl", b"strd", 1), "are damaged"),
    # OpenCV gives nothing of such a packet.
    "a zeroed image": ("x.mp4", lambda data, at, size: put(data, at, bytes(size)), ""),
    # Less than a frame is shown, by the clock; or 60 ms, where the track's header has all.
    "clock of edits": ("x.mp4", lambda d, *_: number(d, b"mvhd", 16, 1 << 24), "are missing"),
    "edits": ("x.mp4", lambda data, *_: number(data, b"elst", 12, 60), "packets are damaged"),
    # Ticks a second: no edit list shows more than the track has; ticks a frame, which has 512.
    "clock of a track": ("mpeg4.mp4", lambda d, *_: number(d, b"mdhd", 16, 10_000_000), ""),
    "steps of a track": ("mpeg4.mp4", lambda data, *_: number(data, b"stts", 12, 555), ""),
    "cut off": ("fragments.mp4", lambda data, *_: data[: len(data) * 2 // 3], "cut off"),
    "unnamed": ("fragments.mp4", lambda data, *_: b"trux".join(data.rsplit(b"trun", 1)), ""),
    "unnamed, in a file whose first box is": (
        "fragments.mp4",
        lambda data, *_: b"trux".join(data.replace(b"ftyp", b"\x80typ").rsplit(b"trun", 1)),
        "",
    ),
    "zeros": (
        "fragments.mp4",
        lambda data, *_: put(data, at := data.rindex(b"moof") - 4, bytes(len(data) - at)),
        "",
    ),
    # Its other box takes the place of all that follows.
    "size": ("fragments.mp4", lambda d, *_: put(d, d.index(b"mfhd") - 4, b"\x70"), ""),
    "clock": ("fragments.mp4", lambda data, *_: data.replace(b"mdhd", b"mdh5"), ""),
    # Each frame of the first one lasts for two days.
    "frames of days": ("fragments.mp4", lambda d, *_: put(d, d.index(b"tfhd") + 20, b"\xb1"), ""),
}


@pytest.mark.parametrize("change", CHANGES)
def test_damage_that_the_structure_shows_is_told(tmp_path, decoder, change):
    name, changed, told = CHANGES[change]
    path = write(tmp_path / name, **WRITTEN[name])
    path.write_bytes(changed(path.read_bytes(), *packets(path)[GOP + 3]))
    damage = read(path, decoder)[2].damage
    assert damage and told in damage[-1]


def test_a_frame_of_an_mp4_that_comes_after_its_end_is_told(tmp_path, decoder):
    """The last but one is shown beyond the end, and so is never read."""
    path = write(tmp_path / "x.mp4", options={**OPTIONS, "bf": "2"})
    data = bytearray(path.read_bytes())
    at = data.index(b"ctts")
    (n_entries,) = struct.unpack_from(">I", data, at + 8)
    struct.pack_into(">I", data, at + 12 + 8 * (n_entries - 2) + 4, 1 << 28)
    path.write_bytes(data)
    assert "packets are damaged" in read(path, decoder)[2].damage[-1]


@pytest.mark.parametrize("b_frames", [0, 2])
def test_an_avi_that_counts_fields_is_sound(tmp_path, decoder, b_frames):
    """FFmpeg copies H.264 into an AVI at twice its rate, with nothing in every other place."""
    whole = write(tmp_path / "x.mp4", 60, options={**OPTIONS, "bf": str(b_frames)})
    path = tmp_path / "x.avi"
    with av.open(str(whole)) as reader, av.open(str(path), "w") as writer:
        stream = reader.streams.video[0]
        copy = writer.add_stream_from_template(stream)
        copy.time_base = Fraction(1, 2 * FPS)
        annex = av.bitstream.BitStreamFilterContext("h264_mp4toannexb", stream, copy)
        for packet in reader.demux(stream):
            if packet.dts is not None:
                for one in annex.filter(packet):
                    one.stream = copy
                    writer.mux(one)
    indices, times, progress = read(path, decoder)
    assert indices == list(range(60)) and progress.damage == []
    assert times == pytest.approx([n / FPS for n in range(60)])
    with open_video(path, decoder=decoder) as video:
        assert (video.info.fps, video.info.n_frames) == (FPS, 60)


@pytest.mark.parametrize(
    ("suffix", "codec"), [("ts", "libx264"), ("wmv", "wmv2"), ("nut", "mpeg4")]
)
def test_longer_sound_is_no_damage(tmp_path, decoder, suffix, codec):
    path = tmp_path / f"x.{suffix}"
    whole = write(tmp_path / f"whole.{suffix}", codec=codec, options={})
    with av.open(str(whole)) as reader, av.open(str(path), "w") as writer:
        copy = writer.add_stream_from_template(reader.streams.video[0])
        sound = writer.add_stream("mp2", rate=32000, layout="mono")
        for packet in reader.demux(video=0):
            if packet.dts is not None:
                packet.stream = copy
                writer.mux(packet)
        for number in range(80):
            frame = av.AudioFrame.from_ndarray(np.zeros((1, 1152), np.int16), "s16", "mono")
            frame.sample_rate, frame.pts = 32000, 45000 + 1152 * number
            writer.mux(sound.encode(frame))
        writer.mux(sound.encode(None))
    indices, _, progress = read(path, decoder)
    assert len(indices) == 45 and progress.damage == []


@pytest.mark.parametrize("suffix", ["mkv", "avi", "mp4"])
def test_sound_alone_is_not_called_damaged(tmp_path, decoder, suffix):
    path = audio_only(tmp_path / f"x.{suffix}")
    with pytest.raises(SourceError, match="has sound, but no video"):
        open_video(path, decoder=decoder)


@pytest.mark.parametrize("dropped", [(), (40,), (30, 60)])
def test_single_frames_that_the_file_promises_are_missed(tmp_path, decoder, dropped):
    """One of many is no sign of damage, unless the file states that it is there."""
    whole = write(tmp_path / "whole.mkv", 90, "mjpeg", {}, pixels="yuvj420p")
    path = copied(whole, tmp_path / "x.mkv", keeps=lambda number: number not in dropped)
    indices, _, progress = read(path, decoder)
    assert len(indices) == 90 - len(dropped) and len(progress.damage) == bool(dropped)
    more = " and in 1 more place" if len(dropped) > 1 else ""
    told = (
        "",
        "1 frame is missing after frame 39 (1.3",
        "about 2 frames are missing after frame 29",
    )
    assert progress.damage == [] or progress.damage[0].startswith(told[len(dropped)])
    assert more in "".join(progress.damage)


@pytest.mark.parametrize("after", [b"\n", b"\0\0\0\x08free", bytes(12)], ids=["byte", "box", "0"])
def test_what_comes_after_an_mp4_is_no_damage(tmp_path, decoder, after):
    path = write(tmp_path / "x.mp4", codec="mpeg4", options={})
    path.write_bytes(path.read_bytes() + after)
    indices, _, progress = read(path, decoder)
    assert indices == list(range(45)) and progress.warnings == []


def test_frames_that_an_avi_leaves_out_on_purpose_are_no_damage(tmp_path, decoder):
    """Its index has empty entries for them."""
    numbers = [0, *range(31, 75)]
    path = write(tmp_path / "x.avi", codec="mjpeg", options={}, pixels="yuvj420p", numbers=numbers)
    indices, times, progress = read(path, decoder)
    assert progress.damage == [] and len(indices) == 45
    assert times[1] - times[0] == pytest.approx(31 / FPS, abs=0.01)


def test_of_two_entries_a_frame_none_is_left_out():
    """FFmpeg counts the empty ones, and takes twice the rate."""
    packets, stated = [(n / 30, True) for n in range(45)], Stated("avi", n_empty=45)
    info = measured(StreamInfo(64, 48, 60.0, 90), stated, packets, 0.0, 0.0, False)
    assert (info.n_frames, info.fps, info.n_empty) == (45, pytest.approx(30.0), 0)


def test_an_avi_that_states_two_rates_is_told(tmp_path, decoder):
    path = write(tmp_path / "x.avi", codec="mjpeg", options={}, pixels="yuvj420p")
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, data.index(b"avih") + 8, 50_000)
    path.write_bytes(data)
    assert read(path, decoder)[2].warnings == [
        "the file states 30 and 20 frames/s; 30 are used",
    ]


def test_frames_of_an_avi_without_times_are_no_farther_apart():
    """FFmpeg gives the last frames none; frames are missing directly before them."""
    stamps = [0, 1, 2, 3, 12, None, None]
    frames = (SimpleNamespace(dts=dts) for dts in stamps)
    assert [frame.pts for frame in in_steps(frames)] == [0, 1, 2, 3, 12, 13, 14]


@pytest.mark.parametrize("lost", [b"S\xab\x84\x1cS\xbbk", b"\x11M\x9bt"], ids=["entry", "list"])
def test_the_index_of_a_matroska_is_found_without_its_list(tmp_path, decoder, lost):
    """It has the time of the first key frame, which is lost."""
    path = zero(write(tmp_path / "x.mkv"), 0)
    data = path.read_bytes()
    assert data.count(lost) == 1
    path.write_bytes(data.replace(lost, lost[:-1] + b"z"))
    assert read(path, decoder)[0][0] == GOP


@pytest.mark.parametrize("first", [0, 3])
def test_windows_media_states_its_size(tmp_path, decoder, first):
    """And a length that counts from 0, wherever the video begins."""
    numbers = range(first, first + 45)
    path = write(tmp_path / "x.wmv", codec="wmv2", options={}, numbers=numbers)
    assert read(path, decoder)[2].warnings == []
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    assert read(path, decoder)[2].damage
