"""Very many frames through one model and one writer: memory stays flat, and the speed stays."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

SOAK = Path(__file__).parents[1] / "benchmarks" / "soak.py"
# 48 bytes a frame would be 3.8 MB, or 48.
N_FRAMES, MAX_GROWTH_MB = (1_000_000, 5.0) if os.environ.get("DLGMD_THOROUGH") else (80_000, 3.0)


@pytest.mark.skipif(sys.platform != "linux", reason="/proc tells the memory of now on Linux only")
def test_very_many_frames_in_the_memory_of_few():
    done = subprocess.run(
        [sys.executable, SOAK, str(N_FRAMES)],
        capture_output=True,
        text=True,
        check=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    print(done.stdout)
    _, warm, *parts, written, _ = (line.split() for line in done.stdout.splitlines())
    assert len(parts) == 10 and int(parts[-1][0]) >= 0.95 * N_FRAMES
    memory_mb = [float(row[1]) for row in (warm, *parts, written)]
    assert max(memory_mb) - memory_mb[0] < MAX_GROWTH_MB
    # A busy machine slows some slices; what slows with the number of frames slows them all.
    assert float(parts[-1][3]) > 0.7 * float(parts[0][2])
