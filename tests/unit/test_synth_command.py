"""`dlgmd synth`: its options, its output, and its errors."""

import re
import shlex
import sys
from pathlib import Path

import numpy as np
from conftest import read_video
from flightscenes import Quick

from dlgmd_cli.scenes.flights.scenes import SCENES

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


def test_two_seeds_have_two_names(dlgmd, runs, monkeypatch, here):
    monkeypatch.setitem(SCENES, "quick", Quick())
    for seed in (1, 2):
        arguments = ["synth", "quick", "--frames", 3, "--seed", seed, "--name", f"quick-{seed}"]
        result = dlgmd(*arguments, "--out", "all")
        names = [f"quick-{seed}.{end}" for end in ("mp4", "csv", "yaml")]
        assert result.stdout.split() == [str(Path("all", name)) for name in names], result.output
    runs("synth", "quick", "--count", 2, "--frames", 3, "--name", "third", "--out", "all")
    listed = Path("all/labels.csv").read_text().splitlines()[1:]
    assert [line.partition(",")[0] for line in listed] == ["third-0000.mp4", "third-0001.mp4"]


def test_noise_in_mpeg4_is_pointed_out_but_not_of_a_flight(dlgmd, monkeypatch):
    arguments = ["synth", "looming-cube", "--noise", "0.02", "--overwrite", *SMALL]
    assert dlgmd(*arguments).stderr == (
        "Note: MPEG-4 smooths the noise; --lossless keeps every pixel of it.\n"
    )
    assert dlgmd(*arguments, "--lossless").stderr == ""
    assert dlgmd("--quiet", *arguments).stderr == ""
    monkeypatch.setitem(SCENES, "quick", Quick())
    flight = ["synth", "quick", "--noise", 0.5, "--overwrite", "--frames", 3]
    assert dlgmd(*flight).stderr == ""
    monkeypatch.setitem(sys.modules, "av", None)
    assert dlgmd(*flight).stderr == ""


def test_lists_the_scenes_by_kind(runs, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    result = runs("synth", "--list")
    assert result.stderr == ""
    flights, flat = result.stdout.split("flat scene")
    assert re.match(r"^\s*flight +shows", flights)
    assert re.search(r"^ *quick +noise for an image *$", flights, re.M)
    for name in ("looming-cube", "receding-cube", "looming-ball", "translating-cubes"):
        assert re.search(rf"^ *{name} +(a cube|a ball|cubes) ", flat, re.M)
        assert name not in flights
    assert max(map(len, result.stdout.splitlines())) <= 80


def test_help_says_what_is_for_which_scenes_and_its_example_runs(dlgmd, runs):
    text = dlgmd("synth", "--help").stdout
    every, flights, flat = re.split(r"^\w.* only:$", text, flags=re.M)
    for section, flags in (
        (every, "--size --fps --frames --fov --noise --speed --seed --lossless --png --list"),
        (
            flights,
            "--exposure --rolling-shutter --vignette --shot-noise --manner --gamma --count --jobs",
        ),
        (flat, "--object-size --distance --contrast --background"),
    ):
        assert set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", section, re.M)) >= set(flags.split())
    assert "SCENE\n" not in every.partition("Options:")[2]
    example = re.search(r"Examples:\n +dlgmd (synth [^\n#]+)", text)
    runs(*shlex.split(example[1]))
