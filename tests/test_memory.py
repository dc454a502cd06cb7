"""Memory does not grow with the length of a video."""

import subprocess
import sys

import pytest
from conftest import looming_frames, write_video

PROGRAM = """
import resource, sys
from dlgmd_cli.app import cli
try:
    cli(["run", sys.argv[1], "--no-plots"], prog_name="dlgmd")
except SystemExit as end:
    assert end.code == 0
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in kB on Linux only")
def test_a_hundred_times_the_frames_in_the_same_memory(tmp_path):
    frames = looming_frames(200)
    write_video(tmp_path / "short.avi", frames)
    write_video(tmp_path / "long.avi", frames * 100)
    peak_kb = {}
    for name in ("short", "long"):
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, f"{name}.avi"],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        peak_kb[name] = int(done.stdout.splitlines()[-1])
    assert peak_kb["long"] - peak_kb["short"] < 50_000
