"""Repeats that FFmpeg encodes anew: the sample flight at higher rates gives the same alarms."""

import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest

from dlgmd_cli import run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed"),
]
FLIGHT = Path(__file__).parents[2] / "sample_videos/group2.mp4"


def alarms(path, **options):
    result = run(path, **options)
    return result.time_s[result.alarm_onsets].tolist(), result


@pytest.fixture(scope="module")
def repeated(tmp_path_factory):
    """The flight at a rate: `repeated(60)`."""

    @cache
    def encoded(fps):
        path = tmp_path_factory.mktemp("repeated") / f"{fps}.mp4"
        command = ["ffmpeg", "-v", "error", "-i", str(FLIGHT), "-vf", f"fps={fps}", str(path)]
        subprocess.run(command, check=True)
        return path

    return encoded


@pytest.mark.parametrize(
    ("fps", "options", "decoder"),
    [
        (60, {}, "opencv"),
        (60, {"model": 9}, "pyav"),
        (120, {}, "pyav"),
        (120, {"model": 9}, "opencv"),
    ],
    ids=str,
)
def test_frames_repeated_by_ffmpeg(repeated, fps, options, decoder):
    if decoder == "pyav":
        pytest.importorskip("av", reason="PyAV is not installed")
    path = repeated(fps)
    expected, once = alarms(FLIGHT, decoder=decoder, **options)
    found, result = alarms(path, decoder=decoder, **options)
    assert len(found) == len(expected) >= 1
    assert found == pytest.approx(expected, abs=1.01 / 30)
    n_repeated = result.record["input"]["repeats"]
    assert n_repeated > 0.8 * (fps / 30 - 1) * len(once)
    assert any("frames are duplicates" in line for line in result.warnings)
    # Those who ask see what it would be without.
    _, kept = alarms(path, decoder=decoder, repeats="keep", fps="all", **options)
    assert len(kept) > len(result) and kept.summary["mp_max"] != result.summary["mp_max"]
