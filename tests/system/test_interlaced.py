"""Interlaced video as ffmpeg writes it, and clips that are none."""

import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from reference_data import reference_dir

from dlgmd_cli import run
from dlgmd_cli.video.content import is_combed
from dlgmd_cli.video.opencv_decoder import OpenCVDecoder
from dlgmd_cli.video.opening import open_video

pytestmark = pytest.mark.slow

SAMPLES = Path(__file__).parents[2] / "sample_videos"
WITH_FFMPEG = pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed")
FLAGS, FAST = ("-flags", "+ilme+ildct"), ("-preset", "veryfast")
# Name, filter that sets the flag, and codec; the last one has the comb only.
KINDS = {
    "mpeg2.ts": ("setfield=tff", "mpeg2video", "-qscale:v", "2", *FLAGS),
    "h264.mp4": ("setfield=tff", "libx264", *FAST, "-x264-params", "tff=1", *FLAGS),
    "uyvy.avi": ("setfield=tff", "rawvideo", "-pix_fmt", "uyvy422"),
    "plain.mp4": ("setfield=prog", "libx264", *FAST),
}


@cache
def whole_flight():
    """The result of the flight as it was rendered."""
    return run(SAMPLES / "group2.mp4")


@WITH_FFMPEG
@pytest.mark.parametrize("name", KINDS)
def test_interlaced_by_ffmpeg(tmp_path, name):
    """The flight at 60 fields a second: read as it is, its collision at 4.67 s is announced."""
    pytest.importorskip("av", reason="PyAV is not installed")
    flag, codec, *options = KINDS[name]
    fields = "minterpolate=fps=60:mi_mode=blend,scale=640:480,tinterlace=interleave_top"
    path = tmp_path / name
    command = ["ffmpeg", "-v", "error", "-i", SAMPLES / "group2.mp4", "-vf", f"{fields},{flag}"]
    done = subprocess.run([*command, "-c:v", codec, *options, path], check=False)
    if done.returncode:
        pytest.skip(f"this ffmpeg cannot write {name}")
    result, whole = run(path), whole_flight()
    assert result.record["input"]["deinterlaced"] == "bwdif"
    assert result.summary["alarms"] == whole.summary["alarms"] == 1
    times_s = [one.summary["first_alarm_time_s"] for one in (result, whole)]
    assert abs(times_s[0] - times_s[1]) < 0.1
    assert np.allclose(np.diff(result.time_s), 1 / 30, atol=2e-3)


def foreign():
    """The samples, and the clips of the reference data if there are any."""
    yield from SAMPLES.glob("*.mp4")
    for folder in ("footage", "clips"):
        yield from (reference_dir() / folder).glob("*.mp4")


def test_other_clips_are_not_taken_for_interlaced():
    for path in foreign():
        with open_video(path, decoder="opencv") as video:
            assert not video.info.is_interlaced and video.info.decoder == "opencv", path
        decoder = OpenCVDecoder(str(path))  # whatever its height
        assert not is_combed(decoder), path
        decoder.close()
