"""The clock's table: how far the alarm is from that of the true times, in frames.

    python tests/benchmarks/bench_clock.py

A row for each way in which the frames of `sample_videos/group2.mp4` arrive, a column for each time
between the frames of a burst. After the slash there are the frames that were left out, and in
brackets those of the first second, and `blind` where the images were taken for none.
"""

import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from arrivals import GAPS_S, WAYS, arriving, watched  # noqa: E402

from dlgmd_cli import open_video  # noqa: E402


def cell(frames, true, came):
    """The alarm at some times of arrival beside that of the true times."""
    first, left_out, is_blind = watched(frames, came)
    n_early = np.count_nonzero(came[left_out] - came[0] < 1.0)
    late = "none" if first is None else f"{first - true.first:+d}"
    text = f"{late}/{len(left_out)}{f'({n_early})' if n_early else ''}"
    return f"{text} blind" if is_blind else text


def main():
    with open_video(ROOT / "sample_videos" / "group2.mp4", width_px=240) as video:
        frames = [frame.grey for frame in video]
    for fps in (25, 30, 50, 60):
        true = watched(frames, np.arange(len(frames)) / fps, times="capture")
        told = f"alarm at frame {true.first}, {len(true.left_out)} left out"
        print(f"\n{fps} frames/s; by the true times: {told}")
        print(f"{'ms':8}" + "".join(f"{1e3 * gap_s:>18g}" for gap_s in GAPS_S))
        for way in WAYS:
            cells = (cell(frames, true, arriving(len(frames), fps, way, g)) for g in GAPS_S)
            print(f"{way:8}" + "".join(f"{one:>18}" for one in cells))


if __name__ == "__main__":
    main()
