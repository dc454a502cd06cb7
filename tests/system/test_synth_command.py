"""`dlgmd synth`: its options, its output, and its errors."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from conftest import read_video
from reference_data import reference_dir

import dlgmd_cli
from dlgmd_cli.errors import OutputExistsError, ParameterError
from dlgmd_cli.results.benchmark import SYNTHETIC, read_annotations

SMALL = ["--size", "64x48", "--frames", "5"]


def test_all_options_arrive(runs):
    options = (
        "--size 64x48 --fps 10 --frames 3 --object-size 2 --speed 1 --distance 4 --contrast 1 "
        "--background 0.25 --noise 0 --seed 7 --fov 90 --out new/here"
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


def test_the_basic_videos_are_those_of_the_benchmark(tmp_path):
    found = dlgmd_cli.synth("benchmark", out=tmp_path)
    assert len(found.videos) == len(found.paths) - 1 == 16
    sequences, failed = read_annotations(tmp_path / "annotations.json")
    assert len(sequences) == 16 and not failed
    assert {one.group for one in sequences} == {*SYNTHETIC[:4]}
    for one in sequences:
        approaches = "looming" in one.name
        assert one.truth.tolist() == ([0.5] + [1] * 45 + [0.5] * 4 if approaches else [0.5] * 50)
    rate, frames = read_video(tmp_path / sequences[0].name)
    assert rate == 30 and np.array_equal(np.array(frames)[..., 1], found.frames[0])
    with pytest.raises(OutputExistsError):
        dlgmd_cli.synth("benchmark", out=tmp_path)
    dlgmd_cli.synth("benchmark", out=tmp_path, lossless=False, overwrite=True)
    assert not [*tmp_path.rglob("*.avi")] and len([*tmp_path.rglob("*.mp4")]) == 16
    found.save(tmp_path / "saved")
    assert np.array_equal(np.load(tmp_path / "saved/light_looming.npy"), found.frames[1])
    with pytest.raises(ParameterError, match="speed does not work with benchmark"):
        dlgmd_cli.synth("benchmark", speed=3)


def test_the_basic_videos_are_the_stored_ones_to_the_pixel():
    stored = np.load(reference_dir() / "field" / "stimuli.npz")
    videos = dlgmd_cli.synth("benchmark")
    assert videos.frames.shape == (16, 50, 240, 432)
    common = [one for one in videos.videos.values() if one.name in stored]
    assert len(common) == 8
    for one in common:
        np.testing.assert_array_equal(one.frames, stored[one.name])
