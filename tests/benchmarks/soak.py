"""Very many frames through one model and one writer: what becomes of memory and of the speed.

From the repository:

    python tests/benchmarks/soak.py [FRAMES]

Prints the memory and the speed after every tenth, then after the tables and the summary are
written. Memory is the process's at that moment, not its peak; the speed is that of the median
slice of `SLICE` frames, so that a machine that is busy now and then does not matter.
"""

import gc
import sys
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path
from statistics import median

import numpy as np

from dlgmd_cli import DLGMD, load_set
from dlgmd_cli.models.base import Model
from dlgmd_cli.results.measures import Summary
from dlgmd_cli.results.tables import write_tables
from dlgmd_cli.runs.reading import Reading
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.sources.base import Frame

WIDTH, HEIGHT = 38, 22
N_WARM, SLICE, N_PARTS = 2_000, 200, 10
PAGE_MB = 4096 / 2**20


def pictures(count: int = 400) -> list[np.ndarray]:
    """A dark square that comes and goes on noise, (HEIGHT, WIDTH) uint8."""
    noise = np.random.default_rng(5)
    made = []
    for number in range(count):
        picture = noise.integers(120, 220, (HEIGHT, WIDTH), dtype=np.uint8)
        half = 1 + number % 10
        picture[11 - half : 11 + half, 19 - half : 19 + half] = 20
        made.append(picture)
    return made


def resident_mb() -> float:
    """Memory of this process that is in use now, in MB."""
    gc.collect()
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_MB


class Soak:
    """One model that is fed without end."""

    def __init__(self, model: Model) -> None:
        self.recording = Recording()
        self._model = model
        self._pictures = enumerate(cycle(pictures()))

    def feed(self, n_frames: int) -> float:
        """Go on by so many frames; frames a second."""
        begun = time.perf_counter()
        for index, picture in islice(self._pictures, n_frames):
            frame = Frame(index, index / 30, picture)
            self.recording.append(frame, self._model.step(frame.grey))
        return n_frames / (time.perf_counter() - begun)


def main(n_frames: int) -> None:
    """Print a row after every tenth, and one at the end."""
    params = load_set(9)
    soak = Soak(DLGMD(params, engine="opencv"))
    print(f"{'frames':>10} {'MB':>8} {'frames/s':>9}")
    soak.feed(N_WARM)
    print(f"{N_WARM:>10} {resident_mb():>8.2f} {'':>9}", flush=True)
    for _ in range(N_PARTS):
        speed = median(soak.feed(SLICE) for _ in range(n_frames // N_PARTS // SLICE))
        print(f"{len(soak.recording):>10} {resident_mb():>8.2f} {speed:>9.0f}", flush=True)
    reading = Reading(soak.recording, (WIDTH, HEIGHT), params, by_sequence=True)
    begun = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        write_tables(Path(folder), reading)
    summary = Summary.of(reading).to_dict()
    print(f"{'written':>10} {resident_mb():>8.2f} {time.perf_counter() - begun:8.1f} s")
    print(summary)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
