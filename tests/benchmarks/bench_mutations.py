"""Videos with changed bytes: how often frames are lost without a word, by class.

Not part of the test run. From the repository:

    python tests/benchmarks/bench_mutations.py [COUNT] [--seed N] [--jobs N]

Each of COUNT mutants, of a dozen containers and codecs in turn, is read by both decoders and
compared with the untouched video, whose images show their numbers. A row of the table is a class
of losses that nothing tells: OpenCV, PyAV, and in how many of these `ffprobe -count_frames` counts
every frame. A crash of a decoder ends the study with an error, a hang stops it.
"""

import argparse
import os
import sys
import tempfile
from collections import Counter
from pathlib import Path

# FFmpeg has much to say of such files.
os.environ |= {"OPENCV_FFMPEG_LOGLEVEL": "-8", "OPENCV_LOG_LEVEL": "OFF"}
sys.path.insert(0, str(Path(__file__).parent.parent))

from mutations import N_FRAMES, study


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rows = study(Path(folder), given.count, seed=given.seed, n_jobs=given.jobs)
    silent = [row for row in rows if row.where]
    counts = Counter((row.name, row.where, row.way, row.decoder) for row in silent)
    whole = Counter((*row[1:3], row.where) for row in silent if row.n_counted == N_FRAMES)
    print(f"{'video':12}{'lost':11}{'by':15}{'OpenCV':>7}{'PyAV':>7}{'ffprobe counts all':>20}")
    for name, where, way in sorted({key[:3] for key in counts}):
        both = [counts[name, where, way, decoder] for decoder in ("opencv", "pyav")]
        print(f"{name:12}{where:11}{way:15}{both[0]:7}{both[1]:7}{whole[name, way, where]:20}")
    for decoder in ("opencv", "pyav"):
        n_silent = sum(row.decoder == decoder for row in silent)
        print(f"{decoder}: {n_silent} of {given.count} ({n_silent / given.count:.2%})")


if __name__ == "__main__":
    main()
