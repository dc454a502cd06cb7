"""`dlgmd synth`: its options, its output, and its errors."""

import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import read_video
from flightscenes import Quick

from dlgmd_cli.lab.flights.scenes import SCENES

ROOT = Path(__file__).parents[3]
SMALL = ["--size", "64x48", "--frames", "5"]


def test_all_options_arrive(dlgmd):
    options = (
        "--size 64x48 --fps 10 --frames 3 --object-size 2 --speed 1 --distance 4 --contrast 1 "
        "--background 0.25 --noise 0 --seed 7 --fov 90 --lossless --out new/here"
    )
    result = dlgmd("synth", "looming-cube", *options.split())
    assert result.exit_code == 0, result.output
    video, truth = (Path("new", "here", f"looming-cube.{end}") for end in ("avi", "csv"))
    assert result.stdout.splitlines() == [str(video), str(truth)] and result.stderr == ""
    first = read_video(video)[1][0][..., 1]
    assert first[0, 0] == 64  # 0.25 * 255, rounded
    assert np.count_nonzero(first == 128) == 16**2  # f = 32 px, 2 m at 4 m
    assert truth.read_text().splitlines()[-1].startswith("2,0.2,")


def test_noise_in_mpeg4_is_pointed_out(dlgmd):
    arguments = ["synth", "looming-cube", "--noise", "0.02", "--overwrite", *SMALL]
    assert dlgmd(*arguments).stderr == (
        "Note: MPEG-4 smooths the noise; --lossless keeps every pixel of it.\n"
    )
    assert dlgmd(*arguments, "--lossless").stderr == ""
    assert dlgmd("--quiet", *arguments).stderr == ""


def test_a_flight_has_a_record_and_no_note_on_its_noise(dlgmd, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    result = dlgmd("synth", "quick", "--frames", 3, "--noise", 0.5)
    assert result.exit_code == 0 and result.stderr == ""
    assert result.stdout.split() == ["quick.mp4", "quick.csv", "quick.yaml"]
    monkeypatch.setitem(sys.modules, "av", None)
    assert dlgmd("synth", "quick", "--noise", 0.5, "--overwrite").stderr == ""


def test_lists_the_scenes_by_kind(dlgmd, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    result = dlgmd("synth", "--list")
    assert result.exit_code == 0 and result.stderr == ""
    flights, flat = result.stdout.split("flat scene")
    assert re.match(r"^\s*flight +shows", flights)
    assert re.search(r"^ *quick +noise for a picture *$", flights, re.M)
    for name in ("looming-cube", "receding-cube", "looming-ball", "translating-cubes"):
        assert re.search(rf"^ *{name} +(a cube|a ball|cubes) ", flat, re.M)
        assert name not in flights
    assert max(map(len, result.stdout.splitlines())) <= 80


def test_help_says_what_is_for_which_scenes_and_its_example_runs(dlgmd):
    text = dlgmd("synth", "--help").stdout
    every, flights, flat = re.split(r"^\w.* only:$", text, flags=re.M)
    for section, flags in (
        (every, "--size --fps --frames --fov --noise --seed --lossless --png --list"),
        (flights, "--exposure --rolling-shutter --vignette --shot-noise --gamma --count --jobs"),
        (flat, "--object-size --speed --distance --contrast --background"),
    ):
        assert set(re.findall(r"^  (?:-\w, )?(--[a-z-]+)", section, re.M)) >= set(flags.split())
    assert "SCENE\n" not in every.partition("Options:")[2]
    example = re.search(r"Example: dlgmd (synth [^\n]+(?:\n +[^\n]+)?)", text)
    assert dlgmd(*shlex.split(example[1])).exit_code == 0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "Missing argument 'SCENE'. 'dlgmd synth --list' lists the scenes."),
        ("looming-cub", "there is no scene 'looming-cub'. Did you mean 'looming-cube'? Choose"),
        ("translating-cubes --distance 3", "--distance: translating-cubes has no such option."),
        ("looming-cube --size 64", "'64' is not WIDTHxHEIGHT"),
        ("looming-cube --jobs 2", "--jobs works only with --count."),
        ("looming-cube --fps fast", "'fast' is not a valid float"),
        ("looming-ball --speed nan", "'--speed': nan is not a finite number"),
    ],
)
def test_wrong_usage(dlgmd, arguments, message):
    result = dlgmd("synth", "--out", "new", *arguments.split())
    assert result.exit_code == 2
    assert message in result.stderr and result.stdout == ""
    assert not Path("new").exists()


def test_folder_that_cannot_be_made(dlgmd):
    Path("file").touch()
    result = dlgmd("synth", "looming-cube", "--out", "file", *SMALL)
    assert result.exit_code == 1
    assert "cannot be written" in result.stderr


def test_command_loads_without_opencv():
    script = "import sys, dlgmd_cli.commands.synth; sys.exit('cv2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT).returncode == 0
