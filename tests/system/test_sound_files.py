"""What only looks like a loss of frames: a late start, an edit list, frames left out on purpose."""

import math
import struct
from fractions import Fraction

import numpy as np
import pytest

av = pytest.importorskip("av", reason="PyAV writes these videos")

from damaged import copied, encode, remuxed, silence  # noqa: E402

from dlgmd_cli.video.base import SourceInfo  # noqa: E402
from dlgmd_cli.video.containers import Stated  # noqa: E402
from dlgmd_cli.video.opencv_decoder import true_stamps  # noqa: E402
from dlgmd_cli.video.opening import open_video  # noqa: E402

FPS, GOP = 30, 15
OPTIONS = {"g": str(GOP), "bf": "0", "keyint_min": str(GOP), "sc_threshold": "0"}
pytestmark = pytest.mark.skipif("libx264" not in av.codecs_available, reason="writes H.264")


def write(path, n_frames=45, codec="libx264", options=OPTIONS, **how):
    """A video whose frames move."""
    ground = np.random.default_rng(4).integers(0, 255, (48, 64 + n_frames), dtype=np.uint8)
    frames = [ground[:, n : n + 64] for n in range(n_frames)]
    return encode(path, frames, codec, options=options, fps=FPS, **how)


def read(path, decoder):
    """Numbers and times of the frames, and what is told of damage."""
    with open_video(path, decoder=decoder) as video:
        frames = [(one.index, one.time_s) for one in video]
        return [index for index, _ in frames], [time_s for _, time_s in frames], video.progress


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


WRITTEN = {
    "x.ts": {},
    "x.flv": {"codec": "flv", "options": {"g": "15"}},
    "x.mkv": {"codec": "mpeg4", "options": {"g": "15"}},
    "x.avi": {"codec": "mjpeg", "options": {}, "pixels": "yuvj420p"},
    "x.mp4": {"options": {**OPTIONS, "bf": "2"}},
    "mpeg4.mp4": {"codec": "mpeg4", "options": {}},
    "fragments.mp4": {"container": {"movflags": "frag_keyframe+empty_moov"}},
}


@pytest.mark.parametrize("name", WRITTEN)
def test_what_is_changed_below_is_sound(tmp_path, decoder, name):
    indices, _, progress = read(write(tmp_path / name, **WRITTEN[name]), decoder)
    assert indices == list(range(45)) and progress.warnings == []


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
    ("suffix", "codec"), [("ts", "libx264"), ("wmv", "wmv2"), ("nut", "mpeg4"), ("mkv", "ffv1")]
)
def test_longer_sound_is_no_damage(tmp_path, decoder, suffix, codec):
    path = tmp_path / f"x.{suffix}"
    whole = write(tmp_path / f"whole.{suffix}", codec=codec, options={})
    with remuxed(whole, path) as (writer, copy, packets):
        sound = writer.add_stream("mp2", rate=32000, layout="mono")
        for packet in packets:
            packet.stream = copy
            writer.mux(packet)
        for number in range(80):
            writer.mux(sound.encode(silence(1152, 32000, 45000 + 1152 * number)))
        writer.mux(sound.encode(None))
    indices, _, progress = read(path, decoder)
    assert len(indices) == 45 and progress.damage == []


# An Insta360 appends its recordings of motion, and this mark.
INSTA360 = bytes(range(256)) * 40 + b"8db42d694ccc418790edff439fe026bf"
AFTER = {"byte": b"\n", "box": b"\0\0\0\x08free", "0": bytes(12), "Insta360": INSTA360}


@pytest.mark.parametrize("after", AFTER.values(), ids=AFTER)
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


def test_frames_of_an_avi_without_times_are_no_farther_apart():
    """FFmpeg gives the last frames none; frames are missing directly before them."""
    stamps = iter([5.0, 6.0, 7.0, 8.0, 17.0, math.nan, math.nan])
    info = SourceInfo(8, 8, fps_stated=1.0, n_frames=None)
    times = [*true_stamps(stamps, Stated("avi"), info)]
    assert times == [0, 1, 2, 3, 12, 13, 14]


def test_eight_sound_tracks_in_a_pause_are_no_damage(tmp_path, decoder):
    path, pause_s = tmp_path / "x.mkv", 12
    whole = write(tmp_path / "whole.mkv")
    with remuxed(whole, path) as (writer, copy, packets):
        sounds = [writer.add_stream("pcm_s16le", rate=8000) for _ in range(8)]
        for packet in packets:
            if packet.pts == 667:  # the frame at which the recording goes on, in ms
                for number in range(50 * pause_s):
                    for sound in sounds:
                        writer.mux(sound.encode(silence(160, at=5336 + 160 * number)))
            later = 1000 * pause_s * (packet.pts >= 667)
            packet.pts, packet.dts, packet.stream = packet.pts + later, packet.dts + later, copy
            writer.mux(packet)
    indices, times, progress = read(path, decoder)
    assert indices == list(range(45)) and progress.damage == []
    assert max(np.diff(times)) == pytest.approx(pause_s, abs=0.1)


def test_samples_without_an_image_are_no_damage(tmp_path, decoder):
    """Servers of RTMP send two messages (SEI) with each image."""
    path, message = tmp_path / "x.mp4", b"\x06\x05\x11" + bytes(range(17)) + b"\x80"
    whole = write(tmp_path / "whole.mp4", 120)
    with remuxed(whole, path) as (writer, copy, packets):
        for packet in packets:
            at, base = packet.pts, packet.time_base
            packet.stream = copy
            writer.mux(packet)
            for number in (1, 2):
                sei = av.Packet(len(message).to_bytes(4, "big") + message)
                sei.pts = sei.dts = at + 100 * number
                sei.stream, sei.time_base = copy, base
                writer.mux(sei)
    indices, _, progress = read(path, decoder)
    assert indices == list(range(120)) and progress.damage == []


def test_a_browsers_thousand_clusters_are_sound(tmp_path, decoder):
    live = {"live": "1", "cluster_time_limit": "1"}
    path = write(tmp_path / "x.webm", 1000, "libvpx", {"deadline": "realtime"}, container=live)
    assert path.read_bytes().count(b"\x1f\x43\xb6\x75") >= 1000
    indices, _, progress = read(path, decoder)
    assert indices == list(range(1000)) and progress.warnings == []
