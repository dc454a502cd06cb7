"""Very many frames through one model and its result: memory grows by 48 bytes a frame, no more."""

import os
import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow
N_FRAMES = 1_000_000 if os.environ.get("DLGMD_THOROUGH") else 60_000
# An array grows ahead of its use; the rest is for what Python and OpenCV keep.
BYTES_A_FRAME, SLACK_MB = 60, 4.0
PROGRAM = """
import resource, sys, tempfile
from dataclasses import replace
from pathlib import Path
import numpy as np
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters import load_set
from dlgmd_cli.results.result import read_result
from dlgmd_cli.runs.run import run_models
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.frame import Frame
from dlgmd_cli.video.source import Progress, SourceInfo

N_FRAMES, WIDTH, HEIGHT = int(sys.argv[1]), 38, 22

class Endless:
    size_wh = source_wh = (WIDTH, HEIGHT)
    progress = Progress()
    info = SourceInfo("/x.avi", "x", WIDTH, HEIGHT, 30.0, None, "opencv")
    greys = np.random.default_rng(5).integers(100, 200, (40, HEIGHT, WIDTH), dtype=np.uint8)

    def frames(self, *sizes_wh, picture_wh=None):
        for index in range(N_FRAMES):
            self.progress.n_decoded, self.progress.last_time_s = index + 1, index / 30
            yield Frame(index, index / 30, self.greys[index % 40])

    def hidden(self, size_wh=None):
        return None

def tell(n_done):
    if n_done % (N_FRAMES // 10) == 0 or n_done == 4000:
        n_pages = int(Path("/proc/self/statm").read_text().split()[1])
        print(n_done, n_pages * resource.getpagesize() / 1e6, flush=True)

setup = Setup(load_set(9), "set9", "opencv")
(result,) = run_models(Endless(), [setup], InputOptions(), on_frame=tell)
with tempfile.TemporaryDirectory() as folder:
    result.save(Path(folder) / "x")
    assert len(read_result(Path(folder) / "x")) == len(result) == N_FRAMES
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells the memory of now on Linux only")
def test_very_many_frames_take_the_memory_of_their_numbers():
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(N_FRAMES)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    (_, first_mb), *rest = (map(float, line.split()) for line in done.stdout.splitlines())
    assert len(rest) >= 9
    for n_frames, now_mb in rest:
        assert now_mb - first_mb < SLACK_MB + n_frames * BYTES_A_FRAME / 1e6
