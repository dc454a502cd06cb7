"""Memory does not grow with the length of a video, but for 96 bytes a frame of its numbers."""

import os
import subprocess
import sys

import pytest
from conftest import looming_frames, write_video
from disturbed import environment

PROGRAM = """
import sys
from pathlib import Path
from dlgmd_cli.commands.app import cli
try:
    cli(sys.argv[1:], prog_name="dlgmd")
except SystemExit as end:
    assert not end.code
# Not that of getrusage, which knows the process that started this one, too.
print(Path("/proc/self/status").read_text().partition("VmHWM:")[2].split()[0])
"""
THOROUGH = bool(os.environ.get("DLGMD_THOROUGH"))
N_FRAMES = 1_000_000 if THOROUGH else 10_000
takes_long = pytest.mark.skipif(not THOROUGH, reason="takes long: set DLGMD_THOROUGH=1")
# An array grows ahead of its use; the rest is for what Python and OpenCV keep.
BYTES_A_FRAME, SLACK_MB = 120, 4.0
SOAK = """
import resource, sys, tempfile
from pathlib import Path
import numpy as np
from dlgmd_cli.parameters.presets import load_set
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.tasks.call import Request, Setup
from dlgmd_cli.tasks.stepping import run_models
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.frame import Frame
from dlgmd_cli.video.base import SourceInfo
from dlgmd_cli.video.source import ReadProgress

N_FRAMES, WIDTH, HEIGHT = int(sys.argv[1]), 38, 22

class Endless:
    size_wh = source_wh = (WIDTH, HEIGHT)
    progress = ReadProgress()
    info = SourceInfo(WIDTH, HEIGHT, 30.0, None, fps=30.0, path="/x.avi", name="x")
    greys = np.random.default_rng(5).integers(100, 200, (40, HEIGHT, WIDTH), dtype=np.uint8)

    def frames(self, *sizes_wh, **_):
        for index in range(N_FRAMES):
            self.progress.n_decoded, self.progress.last_time_s = index + 1, index / 30
            yield Frame(index, index / 30, self.greys[index % 40])

    def hidden(self, size_wh=None):
        return None

def tell(n_done):
    if n_done % (N_FRAMES // 10) == 0 or n_done == 4000:
        n_pages = int(Path("/proc/self/statm").read_text().split()[1])
        print(n_done, n_pages * resource.getpagesize() / 1e6, flush=True)

asked = Request((Setup(load_set(9), "set9"),), InputOptions())
(result,) = run_models(Endless(), asked, on_frame=tell)
with tempfile.TemporaryDirectory() as folder:
    result.save(Path(folder) / "x")
    assert len(read_result(Path(folder) / "x")) == len(result) == N_FRAMES
"""

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="other systems count memory otherwise"),
]


def printed(cwd, program, *arguments):
    """The lines that a program prints."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    done = subprocess.run(
        command, cwd=cwd, capture_output=True, text=True, check=True, env=environment()
    )
    return done.stdout.splitlines()


@pytest.mark.parametrize(
    ("size_wh", "n_frames", "longer", "command"),
    [
        # 650 more frames of 19 kB would be 12 MB, and four times that as single precision.
        ((160, 120), 50, 14, ["run", "{}.avi", "--format=none"]),
        # A sweep maps a file of all frames, 4 MB, which counts.
        pytest.param(
            (64, 48),
            100,
            15,
            ["sweep", "{}.avi", "--x", "r=2", "--y", "a=1,2", "--jobs", "1", "--format=none"],
            marks=takes_long,
        ),
        # 45 more images of 2.8 MB would be 126 MB.
        pytest.param((32, 24), 15, 4, ["layers", "{}.avi", "--video", "{}.mp4"], marks=takes_long),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else None,
)
def test_many_times_the_frames_in_the_same_memory(tmp_path, size_wh, n_frames, longer, command):
    frames = looming_frames(n_frames, *size_wh)
    write_video(tmp_path / "short.avi", frames)
    write_video(tmp_path / "long.avi", frames * longer)
    peak_kb = {}
    for name in ("short", "long"):
        lines = printed(tmp_path, PROGRAM, *(word.format(name) for word in command))
        peak_kb[name] = int(lines[-1])
    assert peak_kb["long"] - peak_kb["short"] < 10_000


def test_very_many_frames_take_the_memory_of_their_numbers(tmp_path):
    found = printed(tmp_path, SOAK, N_FRAMES)
    (_, first_mb), *rest = (map(float, line.split()) for line in found)
    assert len(rest) >= 9
    for n_frames, now_mb in rest:
        assert now_mb - first_mb < SLACK_MB + n_frames * BYTES_A_FRAME / 1e6
