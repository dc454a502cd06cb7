"""Memory does not grow with the length of a video."""

import subprocess
import sys

import pytest
from conftest import looming_frames, write_video

PROGRAM = """
import resource, sys
from dlgmd_cli.commands.app import cli
try:
    cli(sys.argv[1:], prog_name="dlgmd")
except SystemExit as end:
    assert not end.code
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


pytestmark = pytest.mark.slow


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in kB on Linux only")
@pytest.mark.parametrize(
    ("n_frames", "longer", "command"),
    [
        (200, 100, ["run", "{}.avi", "--no-plots"]),
        (200, 50, ["compare", "{}.avi", "--set", "9", "--model", "lgmd", "--no-plots"]),
        (200, 50, ["sweep", "{}.avi", "--x", "r=2", "--y", "a=1,2", "--jobs", "1", "--no-plots"]),
        # 400 more pictures of 2.8 MB would be 1.1 GB.
        (100, 5, ["layers", "{}.avi", "--video", "{}.mp4"]),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_many_times_the_frames_in_the_same_memory(tmp_path, n_frames, longer, command):
    frames = looming_frames(n_frames)
    write_video(tmp_path / "short.avi", frames)
    write_video(tmp_path / "long.avi", frames * longer)
    peak_kb = {}
    for name in ("short", "long"):
        done = subprocess.run(
            [sys.executable, "-c", PROGRAM, *(word.format(name) for word in command)],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=True,
        )
        peak_kb[name] = int(done.stdout.splitlines()[-1])
    assert peak_kb["long"] - peak_kb["short"] < 50_000
