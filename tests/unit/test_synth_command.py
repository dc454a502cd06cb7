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

from dlgmd_cli.scenes.flights.scenes import SCENES

ROOT = Path(__file__).parents[2]
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


def test_noise_in_mpeg4_is_pointed_out(dlgmd):
    arguments = ["synth", "looming-cube", "--noise", "0.02", "--overwrite", *SMALL]
    assert dlgmd(*arguments).stderr == (
        "Note: MPEG-4 smooths the noise; --lossless keeps every pixel of it.\n"
    )
    assert dlgmd(*arguments, "--lossless").stderr == ""
    assert dlgmd("--quiet", *arguments).stderr == ""


def test_a_flight_has_a_record_and_no_note_on_its_noise(dlgmd, runs, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    result = runs("synth", "quick", "--frames", 3, "--noise", 0.5)
    assert result.stderr == ""
    assert result.stdout.split() == ["quick.mp4", "quick.csv", "quick.yaml"]
    monkeypatch.setitem(sys.modules, "av", None)
    assert dlgmd("synth", "quick", "--noise", 0.5, "--overwrite").stderr == ""


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


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("", "Missing argument 'SCENE'. 'dlgmd synth --list' lists the scenes."),
        ("looming-cub", "there is no scene 'looming-cub'. Did you mean 'looming-cube'? Choose"),
        ("translating-cubes --distance 3", "--distance: translating-cubes has no such option."),
        ("quick --contrast 0.5", "--contrast: quick has no such option. It takes "),
        ("looming-cube --size 9000x48", "size 9000x48 is not within 1 to 8192 px"),
        ("looming-cube --fps fast", "'fast' is not a valid float"),
        ("looming-cube --fps nan", "nan is not a finite number. Choose 1 to 600."),
        ("looming-cube --fov 180", "Choose 1 to 170 degrees."),
        ("looming-cube --contrast 0.5", "0.5 on a background of 0.8 makes the object brighter"),
        ("looming-cube --background 0", "is not above 0. Choose above 0 to 1."),
        ("looming-cube --frames 76", "'--frames': contact comes after 75 frames"),
        ("looming-cube --speed 0.001", "'--speed': contact comes only after 225000 "),
        ("looming-cube --speed 1 --speed 2", "'--speed': the scene takes one value, not 2"),
        ("translating-cubes --speed 1 --speed 0", "every square needs a speed other than 0"),
        ("translating-cubes --speed 10 --frames 47", "leaves the image after 46 frames"),
        ("translating-cubes --object-size 68", "Choose 67 px or less."),
        # What no video can hold.
        ("looming-cube --size 64x47", "64x47 is odd, "),
        ("looming-cube --size 63x48 --lossless", "Choose 64x48"),
        ("looming-cube --fps 29.97003 --lossless", "decimals, which this video does not keep"),
        ("looming-cube --fps 119.999", "MPEG-4 cannot hold 119.999"),
        # Flights, and many of them.
        ("quick --exposure 33.4", "'--exposure': 33.4 ms is longer than a frame"),
        ("quick --rolling-shutter 33.4", "'--rolling-shutter': 33.4 ms is longer than a frame"),
        ("quick --gamma 4.1", "'--gamma': 4.1 is more"),
        ("quick --frames 20", "'--frames': the flight ends after 19 frames. Choose"),
        ("quick --fps 600", "'--fps': the flight has 361 frames, and a clip has 180 at most"),
        ("looming-cube --jobs 2", "--jobs works only with --count."),
        ("looming-cube --count 2", "--count works only with flights, and looming-cube is not one."),
        ("quick --count 0", "Invalid value for '--count': 0 is not at least 1"),
        (f"quick --count 2 --seed {2**63 - 1}", "'--seed': 9223372036854775808 is more than"),
    ],
)
def test_wrong_usage(dlgmd, monkeypatch, arguments, message):
    monkeypatch.setitem(SCENES, "quick", Quick())
    monkeypatch.setattr("dlgmd_cli.scenes.flights.scenes.MAX_FRAMES", 180)
    result = dlgmd("synth", "--out", "new", *arguments.split())
    assert result.exit_code == 2
    assert message in result.stderr and result.stdout == ""
    assert not Path("new").exists()


def test_command_loads_without_opencv():
    script = "import sys, dlgmd_cli.commands.synth; sys.exit('cv2' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], cwd=ROOT).returncode == 0
