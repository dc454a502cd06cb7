"""FLV files whose stated length includes the delay of B-frames, whole and cut off."""

import shutil
import subprocess

import pytest

from dlgmd_cli.tasks.info import info

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed"),
]


def damage(path, decoder):
    return info(path, decoder=decoder).surveys[0].damage


@pytest.mark.parametrize("sound_s", [3, 5])
@pytest.mark.parametrize("delay_s", [0, 1])
def test_the_delay_of_b_frames_and_longer_sound_are_no_damage(tmp_path, decoder, delay_s, sound_s):
    path, part = tmp_path / "whole.flv", tmp_path / "cut.flv"
    images = ["-itsoffset", str(delay_s), "-f", "lavfi", "-i", "testsrc2=r=30:d=3"]
    tone = ["-f", "lavfi", "-i", f"sine=d={sound_s + delay_s}"]
    encoded = ["-c:v", "libx264", "-bf", "3", "-c:a", "aac"]
    subprocess.run(["ffmpeg", "-v", "error", *images, *tone, *encoded, path], check=True)
    assert not damage(path, decoder)
    content = path.read_bytes()
    part.write_bytes(content[: len(content) * 5 // 10])
    assert damage(part, decoder)
