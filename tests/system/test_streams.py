"""Videos as strangers write them: late, turned over, with several streams, damaged at the start."""

import json
import struct
import sys

import cv2
import numpy as np
import pytest
from conftest import read_video, write_video

av = pytest.importorskip("av", reason="PyAV writes these videos")

from damaged import encode  # noqa: E402

from dlgmd_cli.errors import MissingExtraError, SourceError  # noqa: E402
from dlgmd_cli.video.containers import stated_by  # noqa: E402
from dlgmd_cli.video.luma import UPRIGHT, Orientation  # noqa: E402
from dlgmd_cli.video.opening import open_video  # noqa: E402
from dlgmd_cli.video.survey import survey  # noqa: E402
from dlgmd_cli.video.writer import make_clips  # noqa: E402


def noise(n_frames, width=64, height=48):
    """Frames of which none resembles another."""
    return np.random.default_rng(1).integers(0, 255, (n_frames, height, width), dtype=np.uint8)


def read(path, decoder, **options):
    """The frames, what was told, and what the input is."""
    with open_video(path, decoder=decoder, **options) as source:
        return list(source), source.progress.warnings, source.info


@pytest.mark.parametrize(
    ("name", "codec", "bf"),
    [
        *(("x.avi", codec, "2") for codec in ("mpeg4", "libx264")),
        *(("x.m2v", "mpeg2video", bf) for bf in ("0", "2")),  # bare: it states its rate
    ],
)
def test_b_frames_are_steady(tmp_path, decoder, name, codec, bf):
    if codec not in av.codecs_available:
        pytest.skip(f"this PyAV has no {codec}")
    path = encode(tmp_path / name, noise(60), codec, options={"bf": bf}, fps=60)
    found, warnings, info = read(path, decoder)
    assert warnings == [] and info.fps == 60 and [one.index for one in found] == list(range(60))
    assert [one.time_s for one in found] == pytest.approx([n / 60 for n in range(60)])


def write_bare(folder, kind):
    """Twenty frames one after the other, as cameras and the web send them."""
    path, frames = folder / f"x.{kind}", noise(20)
    if kind == "h264":
        return encode(path, frames, "libx264", fps=60)
    suffix, start, end = {
        "mjpeg": (".jpg", b"", b""),
        "mpjpeg": (".jpg", b"Content-type: image/jpeg\r\n\r\n", b"\r\n--x\r\n"),
        "png": (".png", b"", b""),
    }[kind]
    parts = (start + cv2.imencode(suffix, frame)[1].tobytes() + end for frame in frames)
    path.write_bytes((b"--x\r\n" if start else b"") + b"".join(parts))
    return path


@pytest.mark.parametrize("kind", ["mjpeg", "mpjpeg", "png", "h264"])
def test_of_frames_without_times_the_given_rate_counts(tmp_path, decoder, kind):
    if kind == "h264" and "libx264" not in av.codecs_available:
        pytest.skip("this PyAV has no libx264")
    path = write_bare(tmp_path, kind)
    found, warnings, info = read(path, decoder, input_fps=60)
    assert warnings == [] and info.fps == 60
    assert [one.time_s for one in found] == pytest.approx([n / 60 for n in range(20)])
    found, (warning,), info = read(path, decoder)
    assert "states no frame rate" in warning and "taken as 30 fps" in warning
    assert len(found) == 20 and found[-1].time_s == pytest.approx(19 / 30)
    assert survey(path, decoder=decoder, input_fps=60).duration_s == pytest.approx(20 / 60)


def test_frames_without_times_may_come_after_other_bytes(tmp_path, decoder):
    path = write_bare(tmp_path, "mjpeg")
    path.write_bytes(b"\n" + path.read_bytes())
    found, warnings, info = read(path, decoder, input_fps=60)
    assert len(found) == 20 and warnings == [] and info.fps == 60


def test_an_interlaced_apng_of_which_no_frame_is_found_is_refused(tmp_path, decoder):
    path = encode(tmp_path / "x.apng", noise(20), "apng", pixels="gray")
    data = bytearray(path.read_bytes())
    data[data.index(b"IHDR") + 16] = 0x5F
    data[data.index(b"fcTL") + 21] ^= 0xF6  # the place of the first image
    path.write_bytes(data)
    with pytest.raises(SourceError, match="no frame could be decoded"):
        open_video(path, decoder=decoder)


def test_damage_is_told_of_a_video_that_starts_late(tmp_path, decoder):
    numbers = range(150, 195)
    path = tmp_path / "x.mkv"
    encode(path, noise(45), "ffv1", numbers=numbers, fps=30)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    found, warnings, _ = read(path, decoder)
    assert 20 < len(found) < 40 and f"{len(found)} of about 45 frames" in warnings[-1]


def test_a_damaged_first_picture_is_told(tmp_path):
    """It is left out, and the others keep their times."""
    path = encode(tmp_path / "x.mp4", noise(12), "mpeg4")
    whole, _, _ = read(path, "pyav")
    with av.open(str(path)) as container:
        first = next(container.demux(video=0))
        middle = first.pos + first.size // 2
    data = bytearray(path.read_bytes())
    data[middle : middle + 20] = b"\x55" * 20
    path.write_bytes(data)
    found, warnings, _ = read(path, "pyav")
    assert [one.index for one in found] == list(range(11))
    assert [one.time_s for one in found] == [one.time_s for one in whole[1:]]
    (line,) = warnings
    assert line.startswith("the first frame cannot be decoded; decoded and used 11 of about 12")


def test_damage_before_the_first_frame_is_told_and_no_gap_after_it(tmp_path):
    """The first packet is none at all; then the recording pauses."""
    numbers = [n + 50 * (n > 20) for n in range(40)]
    path = encode(tmp_path / "x.mp4", noise(40), "ffv1", numbers=numbers, options={"g": "1"})
    with av.open(str(path)) as container:
        first = next(container.demux(video=0))
    data = bytearray(path.read_bytes())
    data[first.pos : first.pos + first.size] = b"\xff" * first.size
    path.write_bytes(data)
    found, warnings, _ = read(path, "pyav")
    assert len(found) == 39 and found[-1].time_s > 3.0
    assert any("the first frame cannot be decoded" in line for line in warnings)


def two_streams(path, default):
    """Write 20 frames of 64x48 and 25 of 48x32; the number `default` is the default one."""
    with av.open(str(path), "w") as file:
        streams = []
        for number, (width, height) in enumerate([(64, 48), (48, 32)]):
            stream = file.add_stream("mpeg4", rate=25)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            is_default = number == default
            stream.disposition = av.stream.Disposition.default.value if is_default else 0
            streams.append((stream, noise(20 + 5 * number, width, height)))
        for stream, frames in streams:
            for grey in frames:
                picture = np.repeat(grey[..., None], 3, 2)
                file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            file.mux(stream.encode(None))
    return path


@pytest.mark.parametrize(
    ("suffix", "default", "size", "n_frames"),
    [
        *((suffix, 0, (64, 48), 20) for suffix in ("mkv", "mp4")),
        *((suffix, 1, (48, 32), 25) for suffix in ("mkv", "mp4")),
    ],
)
def test_of_several_streams_the_default_one_is_read(
    tmp_path, decoder, suffix, default, size, n_frames
):
    path = two_streams(tmp_path / f"x.{suffix}", default)
    found, warnings, info = read(path, decoder)
    assert (info.width, info.height) == size and len(found) == n_frames
    assert info.decoder == (decoder if default == 0 else "pyav")
    line = f"the file has 2 video streams; number {default + 1} is read, the default"
    assert f"{line} ({size[0]}x{size[1]})" in warnings


def test_clips_are_of_the_stream_that_is_read(tmp_path):
    path = two_streams(tmp_path / "x.mp4", default=1)
    make_clips(str(path), {"clip.mp4": (-1.0, 0.5)}, tmp_path)
    assert read_video(tmp_path / "clip.mp4")[1][0].shape == (32, 48, 3)


def test_without_pyav_another_stream_than_the_first_is_refused(tmp_path, monkeypatch):
    path = two_streams(tmp_path / "x.mkv", default=1)
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(MissingExtraError, match="reads another of its video streams"):
        open_video(path)


# Display matrices (a, b, c, d) by which (x, y) is shown at (a x + c y, b x + d y), with the angle
# and whether the image is mirrored, and what makes it upright.
TURNS = {
    "none": ((1, 0, 0, 1), (0, False), lambda picture: picture),
    "hflip": ((-1, 0, 0, 1), (0, True), np.fliplr),
    "vflip": ((1, 0, 0, -1), (180, True), np.flipud),
    "half": ((-1, 0, 0, -1), (180, False), lambda picture: np.rot90(picture, 2)),
    "right": ((0, 1, -1, 0), (90, False), lambda picture: np.rot90(picture, -1)),
    "left": ((0, -1, 1, 0), (270, False), np.rot90),
    "transposed": ((0, 1, 1, 0), (90, True), np.transpose),
    "transverse": ((0, -1, -1, 0), (270, True), lambda picture: np.rot90(picture, 2).T),
}


@pytest.mark.parametrize("name", TURNS)
def test_turned_and_mirrored_as_the_file_asks(dlgmd, tmp_path, decoder, name):
    matrix, told, upright = TURNS[name]
    picture = np.full((48, 64), 100, np.uint8)
    picture[:24, :32], picture[:24, 32:], picture[24:, :32] = 250, 30, 180
    path = write_video(tmp_path / "x.mp4", [picture] * 6, fourcc="mp4v")
    data = bytearray(path.read_bytes())
    at = data.index(b"tkhd") + 4 + 40  # of a version-0 track header
    a, b, c, d = (value << 16 for value in matrix)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    (found, *_), _, info = read(path, decoder)
    expected = upright(picture)
    assert info.decoder == decoder and (info.height, info.width) == expected.shape
    assert np.abs(found.grey.astype(int) - expected).mean() < 3
    result = dlgmd("info", path, "--decoder", decoder, "--json")
    (facts,) = json.loads(result.stdout)["inputs"]
    assert (facts["turned_deg"], facts["is_mirrored"]) == told
    shown = dlgmd("info", path, "--decoder", decoder).stdout
    turned = [f"{told[0]}° clockwise"] * (told[0] > 0) + ["mirrored"] * told[1]
    assert f"{', '.join(turned)}, as the file asks" in shown if turned else "rotation" not in shown


@pytest.mark.parametrize("content", [b"", b"moov", b"\0" * 64, bytes(range(256)) * 8])
def test_what_has_no_matrix_is_upright(tmp_path, content):
    (tmp_path / "x.mp4").write_bytes(content)
    names = "x.mp4", "none.mp4"
    assert all(stated_by(tmp_path / name).orientation == UPRIGHT for name in names)
    nested = struct.pack(">I4s", 8, b"tkhd")  # without a matrix
    for kind in (b"trak", b"moov"):
        nested = struct.pack(">I4s", 8 + len(nested), kind) + nested
    (tmp_path / "x.mp4").write_bytes(nested + bytes(16))
    assert stated_by(tmp_path / "x.mp4").orientation == UPRIGHT


def test_slanted_matrices_are_not_followed():
    assert Orientation.of_matrix(46341, 46341, -46341, 46341) == UPRIGHT  # 45 degrees
    assert Orientation.of_matrix(-65500, 2000, 2000, 65500) == Orientation(flips_x=True)
