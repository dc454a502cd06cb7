"""Videos that are written: they come back, and appear whole or not at all."""

import sys
from fractions import Fraction

import numpy as np
import pytest
from conftest import read_video

from dlgmd_cli.errors import OutputError
from dlgmd_cli.video.opencv_decoder import count_frames
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

CODECS = ["mpeg4", "h264"]


def pictures(n, shape=(48, 64)):
    """Frame k is of one grey level, 20 + 10k, with a red square."""
    for k in range(n):
        image = np.full((*shape, 3), 20 + 10 * k, np.uint8)
        image[8:24, 8:24] = (0, 0, 200)
        yield image


def write(path, n=12, codec="mpeg4", fps=25.0):
    if codec == "h264" and best_codec() != "h264":
        pytest.skip("H.264 needs PyAV")
    with video_writer(path, (48, 64), fps, codec=codec, is_colour=True) as put:
        for image in pictures(n):
            put(image)
    return path


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("fps", [25.0, 30000 / 1001, 123.4567, 1.0, 240.0])
def test_a_video_comes_back(tmp_path, codec, fps):
    path = write(tmp_path / "x.mp4", codec=codec, fps=playable_fps(fps))
    rate, frames = read_video(path)
    assert rate == pytest.approx(fps, rel=1e-3)
    assert len(frames) == count_frames(path) == 12
    for k, frame in enumerate(frames):
        assert frame.shape == (48, 64, 3)
        assert np.abs(frame[:, 40:].astype(int) - (20 + 10 * k)).max() <= 6
        blue, green, red = frame[16, 16].astype(int)
        assert red > 180 and blue < 30 and green < 30


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("name", ["a%03d.mp4", "b:c.mp4", "d$e f.mp4"])
def test_names_that_decoders_read_otherwise(tmp_path, codec, name):
    assert count_frames(write(tmp_path / name, codec=codec)) == 12


def test_h264_is_what_browsers_play(tmp_path):
    path = write(tmp_path / "x.mp4", codec="h264")
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays while it loads
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert stream.codec_context.colorspace == 1  # BT.709


def test_without_pyav_it_is_mpeg4(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    assert best_codec() == "mpeg4"


@pytest.mark.parametrize("codec", CODECS)
def test_a_folder_that_is_not_there(tmp_path, codec):
    with pytest.raises(OutputError):
        write(tmp_path / "no" / "x.mp4", codec=codec)


@pytest.mark.parametrize(
    ("fps", "expected"),
    [(30.0, 30.0), (30000 / 1001, 30000 / 1001), (29.97, 29.97), (0.2, 1.0), (5000.0, 240.0)],
)
def test_playable_rates(fps, expected):
    assert playable_fps(fps) == expected


@pytest.mark.parametrize("fps", [24000, 30000, 60000, 120000])
def test_a_rate_of_broadcasts_is_kept_exactly(tmp_path, fps):
    av = pytest.importorskip("av")
    path = write(tmp_path / "x.mp4", codec="h264", fps=playable_fps(fps / 1001))
    with av.open(str(path)) as container:
        assert container.streams.video[0].average_rate == Fraction(fps, 1001)
