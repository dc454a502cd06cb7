"""The end of a file, and its parts: a last frame that is held, fragments, joined recordings."""

import re

import numpy as np
import pytest

av = pytest.importorskip("av", reason="PyAV writes these videos")

from damaged import encode, remuxed  # noqa: E402

from dlgmd_cli.video.opening import open_video  # noqa: E402

FPS, GOP, N_FRAMES = 30, 15, 60
OPTIONS = {"g": str(GOP), "bf": "0", "keyint_min": str(GOP), "sc_threshold": "0"}
FRAGMENTS = "frag_keyframe+empty_moov+default_base_moof"
JUNK = np.random.default_rng(2).integers(0, 256, 2000, dtype=np.uint8).tobytes()
pytestmark = pytest.mark.skipif("libx264" not in av.codecs_available, reason="writes H.264")


def write(path, n_frames=N_FRAMES, movflags=None, **options):
    """A video whose frames move."""
    ground = np.random.default_rng(4).integers(0, 255, (48, 64 + n_frames), dtype=np.uint8)
    frames = [ground[:, n : n + 64] for n in range(n_frames)]
    container = {"movflags": movflags} if movflags else None
    return encode(
        path, frames, "libx264", options={**OPTIONS, **options}, fps=FPS, container=container
    )


def read(path, decoder):
    """The number of frames, and what was told."""
    with open_video(path, decoder=decoder) as video:
        return len(list(video)), video.progress


@pytest.mark.parametrize("b_frames", ["0", "2"])
@pytest.mark.parametrize("suffix", ["mp4", "mov", "mkv", "flv", "ts"])
def test_a_last_frame_may_be_held(tmp_path, decoder, suffix, b_frames):
    path = tmp_path / f"x.{suffix}"
    with remuxed(write(tmp_path / "whole.mp4", bf=b_frames), path) as (writer, copy, packets):
        for number, packet in enumerate(packets):
            if number == N_FRAMES - 1:
                packet.duration = int(4 / packet.time_base)
            packet.stream = copy
            writer.mux(packet)
    n_frames, progress = read(path, decoder)
    assert n_frames == N_FRAMES and progress.damage == []


def changed(data, what):
    """A fragmented file without its third fragment, or with damage there."""
    starts = [found.start() - 4 for found in re.finditer(rb"moof.{4}mfhd", data, re.S)]
    third, fourth, inside = starts[2], starts[3], data.index(b"mdat", starts[2]) + 100
    return {
        "junk": data[:third] + JUNK + data[third:],
        "junk inside": data[:inside] + JUNK + data[inside:],
        "lost bytes": data[:inside] + data[inside + 500 :],
        "zeros": data[:third] + bytes(inside - third) + data[inside:],
        "lost": data[:third] + data[fourth:],
        "cut inside": data[:inside],
        "cut in the header": data[: third + 6],
        "zeros to the end": data[:inside] + bytes(len(data) - inside),
    }[what]


DAMAGES = ["junk", "junk inside", "lost bytes", "zeros", "lost", "cut inside"]


@pytest.mark.parametrize("what", [*DAMAGES, "cut in the header", "zeros to the end"])
@pytest.mark.parametrize("movflags", [FRAGMENTS, "frag_keyframe"])
def test_lost_frames_of_fragments_are_told(tmp_path, decoder, what, movflags):
    # Without the flag empty_moov, the first frames are in no fragment.
    path = write(tmp_path / "x.mp4", N_FRAMES + GOP * (movflags == "frag_keyframe"), movflags)
    n_whole, progress = read(path, decoder)
    assert n_whole >= N_FRAMES and progress.damage == []
    path.write_bytes(changed(path.read_bytes(), what))
    n_frames, progress = read(path, decoder)
    assert n_frames < n_whole or what == "zeros to the end"
    assert any(f"decoded and used {n_frames} of about " in line for line in progress.damage)


@pytest.mark.parametrize("after", [b"\n", bytes(5000), b"made by a camera"])
def test_what_follows_the_fragments_is_no_damage(tmp_path, decoder, after):
    path = write(tmp_path / "x.mp4", movflags=FRAGMENTS + "+skip_trailer")
    path.write_bytes(path.read_bytes() + after)
    n_frames, progress = read(path, decoder)
    assert n_frames == N_FRAMES and progress.warnings == []


def test_a_pause_between_fragments_is_no_loss(tmp_path, decoder):
    path = tmp_path / "x.mp4"
    numbers = [*range(30), *range(150, 180)]
    frames = [*np.random.default_rng(4).integers(0, 255, (60, 48, 64), dtype=np.uint8)]
    container = {"movflags": FRAGMENTS}
    encode(path, frames, "libx264", options=OPTIONS, numbers=numbers, fps=FPS, container=container)
    n_frames, progress = read(path, decoder)
    assert n_frames == 60 and progress.damage == []
    assert "the recording paused" in progress.warnings[0]


def test_the_first_fragments_may_be_missing(tmp_path, decoder):
    path = write(tmp_path / "x.mp4", movflags=FRAGMENTS + "+skip_trailer")
    data = path.read_bytes()
    first, second = [found.start() - 4 for found in re.finditer(b"moof", data)][:2]
    path.write_bytes(data[:first] + data[second:])
    n_frames, progress = read(path, decoder)
    assert n_frames == N_FRAMES - GOP and progress.damage == []
    assert progress.warnings == ["the file begins with fragment 2"]


@pytest.mark.parametrize("seconds", [0, 100])
@pytest.mark.parametrize("b_frames", ["0", "2"])
def test_joined_transport_streams_have_lost_nothing(tmp_path, decoder, b_frames, seconds):
    path = write(tmp_path / "x.ts", bf=b_frames)
    later = tmp_path / "later.ts"
    with remuxed(path, later) as (writer, copy, packets):
        for packet in packets:
            packet.pts, packet.dts = packet.pts + 90000 * seconds, packet.dts + 90000 * seconds
            packet.stream = copy
            writer.mux(packet)
    path.write_bytes(path.read_bytes() + later.read_bytes())
    n_frames, progress = read(path, decoder)
    assert n_frames == 2 * N_FRAMES and progress.damage == []
    assert "the file is 2 recordings, joined" in progress.warnings


@pytest.mark.parametrize("suffix", ["mp4", "flv"])
def test_joined_recordings_that_are_not_read_are_told(tmp_path, decoder, suffix):
    path = write(tmp_path / f"x.{suffix}")
    path.write_bytes(2 * path.read_bytes())
    n_frames, progress = read(path, decoder)
    told = "the file is 2 recordings, joined, and not all of it is read; decoded and used 60 of"
    assert n_frames == N_FRAMES and progress.damage[0].startswith(told)


@pytest.mark.parametrize(
    ("suffix", "after"),
    [("mkv", JUNK), ("mkv", bytes(5000)), ("flv", JUNK), ("flv", bytes(5000)), ("ts", bytes(5000))],
)
def test_what_follows_a_file_is_no_damage(tmp_path, decoder, suffix, after):
    path = write(tmp_path / f"x.{suffix}")
    path.write_bytes(path.read_bytes() + after)
    n_frames, progress = read(path, decoder)
    assert n_frames == N_FRAMES and progress.warnings == []


def test_joined_avi_are_read_and_say_so(tmp_path, decoder):
    path = encode(
        tmp_path / "x.avi",
        [*np.random.default_rng(4).integers(0, 255, (20, 48, 64), dtype=np.uint8)],
        "mjpeg",
        pixels="yuvj420p",
        fps=FPS,
    )
    path.write_bytes(2 * path.read_bytes())
    n_frames, progress = read(path, decoder)
    assert n_frames == 40 and progress.damage == []
    assert "the file is 2 recordings, joined" in progress.warnings
