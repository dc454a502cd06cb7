"""Very many frames through one model and one writer: what becomes of memory and of the speed.

Linux only. From the repository:

    python tests/benchmarks/soak.py [FRAMES]

Prints a row after the first frames, one after every tenth, and one for the writing of the tables
and the summary: the memory that the process has at that moment, while it writes the greatest, and
the speed of the median and of the fastest slice of `SLICE` frames, in frames per second of
computing.
"""

import resource
import sys
import tempfile
import time
from itertools import cycle, islice
from pathlib import Path
from statistics import median

import numpy as np

from dlgmd_cli import DLGMD, load_set
from dlgmd_cli.results.measures import Summary
from dlgmd_cli.results.tables import write_tables
from dlgmd_cli.runs.reading import Reading
from dlgmd_cli.runs.recording import Recording
from dlgmd_cli.video.frames import Frame
from dlgmd_cli.video.prefetch import opencv_threads

WIDTH, HEIGHT = 38, 22
N_WARM, SLICE, N_PARTS = 4_000, 200, 10
PARAMS = load_set(9)


def pictures(count=400):
    """A dark square that grows and vanishes on noise, each (HEIGHT, WIDTH) uint8."""
    noise = np.random.default_rng(5)
    for number in range(count):
        picture = noise.integers(150, 200, (HEIGHT, WIDTH), dtype=np.uint8)
        half = 1 + number % 10
        picture[11 - half : 11 + half, 19 - half : 19 + half] = 20
        yield picture


def resident_mb():
    """Memory of this process that is in use now, in MB."""
    n_pages = int(Path("/proc/self/statm").read_text().split()[1])
    return n_pages * resource.getpagesize() / 1e6


class Soak:
    """One model that is fed without end, and its recording."""

    def __init__(self):
        self.recording = Recording()
        self._model = DLGMD(PARAMS, engine="opencv")
        self._pictures = enumerate(cycle(list(pictures())))

    def feed(self, n_frames):
        """Go on by so many frames; frames a second."""
        begun = time.process_time()
        for index, picture in islice(self._pictures, n_frames):
            frame = Frame(index, index / 30, picture)
            self.recording.append(frame, self._model.step(frame.grey))
        return n_frames / (time.process_time() - begun)

    def write(self):
        """Write and remove the tables, and summarise; the summary, and the memory in MB."""
        reading, memory_mb = Reading(self.recording, (WIDTH, HEIGHT), PARAMS, by_sequence=False), []

        def watched():
            for piece in reading:
                yield piece
                memory_mb.append(resident_mb())

        with tempfile.TemporaryDirectory() as folder:
            write_tables(Path(folder), watched())
        summary = Summary.of(watched())
        return summary.to_dict(), max(memory_mb)


def main(n_frames):
    """Print the table."""
    begun, soak = time.perf_counter(), Soak()
    soak.feed(N_WARM)
    soak.write()
    print(f"{'frames':>8} {'MB':>7} {'frames/s':>9} {'fastest':>8}")
    print(f"{N_WARM:>8} {resident_mb():>7.2f}")
    for _ in range(N_PARTS):
        speeds = [soak.feed(SLICE) for _ in range((n_frames - N_WARM) // N_PARTS // SLICE)]
        row = f"{len(soak.recording):>8} {resident_mb():>7.2f}"
        print(f"{row} {median(speeds):>9.0f} {max(speeds):>8.0f}", flush=True)
    summary, memory_mb = soak.write()
    print(f"{'written':>8} {memory_mb:>7.2f}")
    print(f"{time.perf_counter() - begun:.1f} s in all; {summary}")


if __name__ == "__main__":
    with opencv_threads(1):
        main(int(sys.argv[1]) if len(sys.argv) > 1 else 1_000_000)
