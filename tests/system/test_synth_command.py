"""`dlgmd synth`: its options, its output, and its errors."""

import re
import shlex
from pathlib import Path

import numpy as np
from conftest import read_video

SMALL = ["--size", "64x48", "--frames", "5"]


def test_all_options_arrive(runs):
    options = (
        "--size 64x48 --fps 10 --frames 3 --object-size 2 --speed 1 --distance 4 --contrast 1 "
        "--background 0.25 --noise 0 --seed 7 --fov 90 --lossless --out new/here"
    )
    result = runs("synth", "looming-cube", *options.split())
    video, truth = (Path("new", "here", f"looming-cube.{end}") for end in ("avi", "csv"))
    assert result.stdout.splitlines() == [str(video), str(truth)] and result.stderr == ""
    first = read_video(video)[1][0][..., 1]
    assert first[0, 0] == 64  # 0.25 * 255, rounded
    assert np.count_nonzero(first == 128) == 16**2  # f = 32 px, 2 m at 4 m
    assert truth.read_text().splitlines()[-1].startswith("2,0.2,")


def test_the_examples_of_the_help_run(dlgmd, runs, here):
    text = dlgmd("synth", "--help").stdout
    examples = re.findall(r"^ +dlgmd (synth [^\n#]+)", text, re.M)
    assert examples
    for example in examples:
        runs(*shlex.split(example), *(() if " benchmark " in example else SMALL))
