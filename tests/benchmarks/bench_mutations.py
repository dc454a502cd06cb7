"""Files with changed bytes: what is refused, what is reported, and what is lost without a word.

Not part of the test run. From the repository:

    python tests/benchmarks/bench_mutations.py [COUNT] [--seed N] [--jobs N]
    python tests/benchmarks/bench_mutations.py --sound

Each of COUNT mutants, of 29 kinds of video in turn, numbered images, arrays, bags, presets, labels
and records, is read and compared with what is untouched: each image shows its number in a bar code.
Videos are read by both decoders. A row of the table is a kind; what is lost without a word is the
beginning, the middle or the end, the times, or the content of images or numbers. Of these losses,
those which the format could show by the table in docs/damage.md are listed after it.

With --sound, some 200 sound videos of these kinds are read instead: B-frames, sound, late starts,
variable rates, other rates, an edit list. Damage that is reported of one is a false alarm.
"""

import argparse
import os
import sys
import tempfile
from pathlib import Path

# FFmpeg has much to say of such files.
os.environ |= {"OPENCV_FFMPEG_LOGLEVEL": "-8", "OPENCV_LOG_LEVEL": "OFF"}
sys.path.insert(0, str(Path(__file__).parent.parent))

from mutations import is_promised, study, table, variants

from dlgmd_cli.video.opening import open_video


def false_alarms(folder):
    """Read the sound videos; the lines of the false alarms, after that of the number."""
    paths, lines = list(variants(folder)), []
    for path in paths:
        for decoder in ("opencv", "pyav"):
            with open_video(path, decoder=decoder) as video:
                n_frames = sum(1 for _ in video.pictures())
                what = f"{decoder} {path.parent.name}/{path.name}"
                lines += [f"{what}: {one}" for one in video.progress.damage]
                lines += [] if n_frames else [f"{what}: no frame"]
    n_kinds = len({path.name for path in paths})
    return [f"{len(paths)} sound videos of {n_kinds} kinds, false alarms: {len(lines)}", *lines]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("count", nargs="?", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=42)
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--sound", action="store_true")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        if given.sound:
            print(*false_alarms(Path(folder)), sep="\n")
            return
        rows = study(Path(folder), given.count, seed=given.seed, n_jobs=given.jobs)
    print(*table(rows), sep="\n")
    print("could be shown by docs/damage.md, or is an error:")
    for row in rows:
        if is_promised(row.name, row.outcome) or row.outcome in ("internal error", "hang or crash"):
            print("", *row)


if __name__ == "__main__":
    main()
