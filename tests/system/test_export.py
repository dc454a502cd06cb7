"""Models as C: the command and its folder, and that the C answers as Python does."""

import ctypes
import json
import math
import re
import shutil
import subprocess
from itertools import cycle, islice
from pathlib import Path

import numpy as np
import pytest
from conftest import looming_frames
from exported import (
    ALARM,
    EXPANSION,
    NAMES,
    PLACE,
    QUALITY,
    address,
    answers_of_c,
    answers_of_python,
    assert_alike,
    compiled,
    make,
    needs_cc,
)

from dlgmd_cli import Alarm, load_set
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.microcontroller.export import Export
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.health import BLACK, FLAT, FROZEN, NOISE, Health, Measuring
from dlgmd_cli.models.prepare import Flicker
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.presets import load_config, parameters_of

FLIGHT, SMALL = (parameters_of(load_config(name)) for name in ("flight", "flight-small"))

QUICK = "CFLAGS=-O0"
FILES = {
    "dlgmd_health.c",
    *("dlgmd.h", "dlgmd.c", "dlgmd_model.h", "example.c", "test.c", "vectors.h", "frames.gray"),
    *("board.c", "mps2.ld", "Makefile", "README.md"),
    *("CMakeLists.txt", "library.json", "library.properties"),
}


@needs_cc
@pytest.mark.skipif(not shutil.which("cmake"), reason="CMake is not installed")
@pytest.mark.parametrize("prefix", ["", "front_"])
def test_cmake_in_a_project_and_alone(runs, tmp_path, prefix):
    """A project links it, by the name of the prefix; alone, CTest compares the answers."""
    runs("export", "--size", "56x42", "--out", "x", "--prefix", prefix)
    (tmp_path / "app.c").write_text(
        f'#include "{prefix}dlgmd.h"\nstatic {prefix}dlgmd_state state;\n'
        f"int main(void) {{ {prefix}dlgmd_reset(&state); return 0; }}\n"
    )
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.16)\nproject(app C)\nadd_subdirectory(x)\n"
        f"add_executable(app app.c)\ntarget_link_libraries(app {prefix}dlgmd_c)\n"
    )
    for source, build in ((tmp_path, tmp_path / "b"), (tmp_path / "x", tmp_path / "c")):
        for command in (["cmake", "-S", source, "-B", build], ["cmake", "--build", build]):
            subprocess.run(command, check=True, capture_output=True)
    subprocess.run([tmp_path / "b" / "app"], check=True)
    done = subprocess.run(["ctest"], cwd=tmp_path / "c", capture_output=True, text=True)
    assert done.returncode == 0 and "100% tests passed" in done.stdout


@needs_cc
def test_a_library_for_platformio_and_arduino(runs, tmp_path):
    """Arduino compiles every file of the folder, and the sketch has the only `main`."""
    runs("export", "--size", "56x42", "--out", "x")
    described = json.loads((tmp_path / "x" / "library.json").read_text())
    lines = (tmp_path / "x" / "library.properties").read_text().splitlines()
    properties = dict(line.split("=") for line in lines)
    assert described["version"] == properties["version"]
    assert re.fullmatch(r"\d+\.\d+\.\d+", properties["version"])
    kept = [word[2:-1] for word in described["build"]["srcFilter"] if word[0] == "+"]
    assert all((tmp_path / "x" / name).is_file() for name in [*kept, properties["includes"]])
    (tmp_path / "x" / "sketch.c").write_text(
        '#include "dlgmd.h"\nstatic dlgmd_state s;\nint main(void) { dlgmd_reset(&s); return 0; }\n'
    )
    command = [
        "cc",
        "-DARDUINO=10800",
        "-O0",
        "-o",
        "sketch",
        *map(str, (tmp_path / "x").glob("*.c")),
    ]
    subprocess.run(command, check=True, cwd=tmp_path / "x")


@needs_cc
def test_make_test_and_the_example(runs, tmp_path):
    result = runs("export", "--size", "56x42", "--out", "x")
    assert result.stdout.splitlines()[0] == "x"
    assert {path.name for path in (tmp_path / "x").iterdir()} == FILES
    printed = make(tmp_path / "x", QUICK, "test").splitlines()
    assert printed[-1] == "passed" and len(printed) >= 9
    # The test fails where an answer is another.
    text = (tmp_path / "x/vectors.h").read_text()
    (tmp_path / "x/vectors.h").write_text(re.sub(r"{(1, ., .), [\d.]+,", r"{\1, 1.0,", text))
    with pytest.raises(AssertionError, match=r"membrane potential: .* FAILED"):
        make(tmp_path / "x", QUICK, "test")


@needs_cc
def test_the_example_prints_csv(runs, tmp_path):
    runs("export", "--size", "16x16", "--alarm", "spikes", "--out", "x")
    make(tmp_path / "x", QUICK)
    printed = make(tmp_path / "x", "--eval=play: ; ./dlgmd < frames.gray", "play").splitlines()
    assert printed[:3] == [
        "frame,mp,mp_abs,spike,alarm,rule,g_x,g_y,expansion,expansion_upright,expansion_quality,"
        "ttc_s,expansion_x,expansion_y,blind",
        "0,,,0,0,spikes,,,,,,,,,",
        "1,,,0,0,spikes,,,,,,,,,",
    ]
    assert len(printed) == 21 and ",ahead," not in printed[20]
    with pytest.raises(AssertionError, match="does not end with a whole frame of 16 x 16"):
        make(tmp_path / "x", "--eval=play: ; head -c 300 frames.gray | ./dlgmd", "play")


def test_an_angle_of_the_command_line_goes_before_that_of_a_file(runs, tmp_path):
    (tmp_path / "mine.yaml").write_text("preset: flight-small\nfov: 100\ncamera_tilt: 3\n")
    runs("export", "--config", "mine.yaml", "--fov", "120", "--size", "56x42", "--out", "x")
    readme = (tmp_path / "x/README.md").read_text()
    assert "--fov 120 --camera-tilt 3 --size 56x42 --repeats keep" in readme


def test_costs_in_json_table_and_header(dlgmd, runs, tmp_path):
    facts = json.loads(runs("export", "--set", 9, "--json").stdout)
    assert facts["folder"] == "dlgmd-c"
    assert facts["multiplications"] == 23 * 96 * 72 and facts["additions"] == 54 * 96 * 72
    for name in ("dlgmd.h", "README.md"):
        text = (tmp_path / "dlgmd-c" / name).read_text()
        assert f"{facts['ram_bytes']:,} bytes of state" in text and "@" not in text
    again = dlgmd("export", "--set", 9)
    assert again.exit_code == 2 and "already exists. Add --overwrite" in again.stderr
    assert f"{facts['ram_bytes']:,}" in dlgmd("export", "--set", 9, "--overwrite").stdout


def rough_frames(width, height):
    """Looming frames with noise, a flicker, and stretches of black and white."""
    rng = np.random.default_rng(5)
    frames = [f + rng.integers(0, 6, f.shape, np.uint8) for f in looming_frames(16, width, height)]
    extremes = [np.full((height, width), level, np.uint8) for level in (0, 255, 255, 255, 0)]
    noise = [rng.integers(0, 256, (height, width), np.uint8) for _ in range(4)]
    return [*frames, *extremes, *noise, *frames[-4:]]


@needs_cc
@pytest.mark.parametrize(
    ("params", "steps_ms"),
    [
        (SMALL, (0,)),
        (SMALL, (30, 33, 40)),
        (SMALL, (66, 67, 67)),
        (load_set(9, alarm="ttc", ttc_alarm=1.5), (0,)),
        (load_set(9), (17,)),
        (load_set(3, formulation="released-2020"), (0,)),
    ],
    ids=str,
)
def test_c_answers_as_python(tmp_path, params, steps_ms):
    """With and without times."""
    export = Export(params, 56, 42)
    frames = rough_frames(56, 42)
    answers = answers_of_c(export, tmp_path, frames, steps_ms)
    right = answers_of_python(params, frames, steps_ms)
    assert right[:, 1].any() and right[:, ALARM].any()
    assert_alike(export, answers, right)


@needs_cc
def test_windows_follow_the_camera_and_the_heading_as_in_python(tmp_path):
    """Also where the windows leave the image, and the usual heading holds."""
    camera = Camera(110.0, -4.0)
    export = Export(FLIGHT, 96, 54, camera=camera)
    headings = [None, (12.34, -3.0), (-30.0, 8.5), (-44.0, 20.0), (55.0, 0.0), (180.0, 0.0)]
    headings = [direction for direction in headings for _ in range(5)]
    frames = [wall(96, 54, t) for t in range(30)]
    answers = answers_of_c(export, tmp_path, frames, (33, 33, 34), headings)
    right = answers_of_python(FLIGHT, frames, (33, 33, 34), headings, camera)
    assert_alike(export, answers, right)
    assert right[:, ALARM].any() and len(np.unique(right[1:, PLACE], axis=0)) == 4


def test_a_camera_that_does_not_see_where_the_drone_flies_has_no_export():
    with pytest.raises(ParameterError, match=r"mounted 40° upwards, does not see.*alarm"):
        Export(FLIGHT, 96, 54, camera=Camera(tilt_deg=40.0))


def wall(width, height, t, light=1.0):
    """A textured wall that comes nearer."""
    rows, columns = np.mgrid[:height, :width]
    y, x = ((at - n / 2) / 1.05 ** (t - 10) for at, n in ((rows, height), (columns, width)))
    levels = 120 + 40 * np.sin(y / 2.1) * np.cos(x / 2.7) + 20 * np.sin(x / 5)
    return np.rint(np.minimum(levels * light, 255)).astype(np.uint8)


@needs_cc
@pytest.mark.parametrize("steps_ms", [(0,), (33, 33, 34), (100,)])
def test_unmeasured_is_that_of_python(tmp_path, steps_ms):
    """To a frame, by the quality that C measures; never during an alarm, and not for spikes."""
    plain = [np.full((54, 96), 128, np.uint8)] * 40
    frames = [*plain, *(wall(96, 54, t) for t in range(24)), *plain]
    answers = answers_of_c(Export(FLIGHT, 96, 54), tmp_path, frames, steps_ms)
    measuring, times_ms = Measuring(), np.cumsum([*islice(cycle(steps_ms), len(frames))])
    right = [
        measuring.step(quality, time_ms / 1000.0 if steps_ms[0] else math.nan) and not alarm
        for quality, time_ms, alarm in zip(
            answers[:, QUALITY], times_ms, answers[:, ALARM], strict=True
        )
    ]
    told = answers[:, NAMES.index("unmeasured")]
    assert told.tolist() == right and told[39] and not told[60] and told[-1]
    (folder := tmp_path / "spikes").mkdir()
    params = parameters_of(load_config("flight"), {"alarm": "spikes"})
    spikes = answers_of_c(Export(params, 96, 54), folder, frames, steps_ms)
    assert not spikes[:, NAMES.index("unmeasured")].any()


def lamp_frames(width, height):
    """It, under a lamp that flickers."""
    rows = np.mgrid[:height, :width][0]
    for t in range(36):
        lamp = 1 + 0.12 * np.sin(2 * np.pi * (rows / height * 1.5 + t / 3))
        yield wall(width, height, t, lamp if t < 20 else 1.0)


@needs_cc
def test_flicker_is_removed_as_in_python(tmp_path):
    export, frames = Export(SMALL, 64, 48), [*lamp_frames(64, 48)]
    flicker, periods = Flicker(), []
    for frame in frames:
        flicker.of(frame)
        periods.append(flicker.period)
    assert 3 in periods
    answers = answers_of_c(export, tmp_path, frames, (33, 33, 34))
    right = answers_of_python(SMALL, frames, (33, 33, 34))
    assert_alike(export, answers, right)
    alarm = Alarm(
        SMALL,
        resize=False,
        expansion=Expansion(camera=Camera(), deflicker=False, at_rest=False),
        times="capture",
    )
    plain = [alarm.step(frame, t / 30).expansion for t, frame in enumerate(frames)]
    assert np.abs(plain[1:] - right[1:, EXPANSION]).max() > 0.2


def test_sizes_whose_expansion_cannot_be_measured():
    for size, why in (((320, 240), "up to 240 px wide"), ((64, 18), "too small or too narrow")):
        with pytest.raises(ParameterError, match=why):
            Export(SMALL, *size)
        assert not Export(load_set(9), *size).expands


def test_table_of_costs():
    """RAM and flash in the table of docs/microcontroller.md are what the command says."""
    page = (Path(__file__).parents[2] / "docs/microcontroller.md").read_text(encoding="utf-8")
    cells = [[cell.strip() for cell in row.split("|")[1:-1]] for row in page.splitlines()]
    rows = [row for row in cells if len(row) == 6 and "x" in row[1]]
    assert len(rows) == 4
    for model, size, ram, flash, *_ in rows:
        is_preset = model.startswith("`")
        params = parameters_of(load_config(model.strip("`"))) if is_preset else load_set(9)
        width, height = map(int, size.split("x"))
        costs = Export(params, width, height).costs
        assert ram == f"{costs['ram_bytes']:,}" and flash == f"{costs['flash_bytes']:,}"


def sights(width, height):
    """Images, 1.2 s of each kind at 30 a second, between sound ones: noisy, moving stripes."""
    rng = np.random.default_rng(3)
    x = np.arange(width) + 0.0 * np.arange(height)[:, None]

    def noisy(picture, levels):
        seen = picture + levels * rng.standard_normal((height, width))
        return np.clip(np.rint(seen), 0, 255).astype(np.uint8)

    stripes = 128.0 + 60.0 * np.sin(x / 5.0)
    kinds = (
        lambda: noisy(0.04, 0.3),
        lambda: noisy(120.0, 5.0),
        lambda: rng.integers(0, 256, (height, width), np.uint8),
        lambda: noisy(stripes, 1.0),
    )
    for kind in kinds:
        yield from (kind() for _ in range(36))
        yield from (noisy(128.0 + 60.0 * np.sin((x + 3 * t) / 5.0), 2.0) for t in range(30))


@needs_cc
def test_health_is_that_of_python(tmp_path):
    """Each reason, when it begins and ends, to a frame; for odd sizes, too."""
    names = (None, BLACK, FLAT, NOISE, FROZEN)
    for width, height, step_ms in ((64, 48, 33), (57, 43, 0), (64, 48, 170)):
        (folder := tmp_path / f"{width} {step_ms}").mkdir()
        c, health = compiled(Export(SMALL, width, height), folder), Health()
        sight, time_ms = (ctypes.c_uint32 * (width * height))(), 0
        c.dlgmd_health_reset(sight)
        told, right = [], []
        for frame in sights(width, height):
            time_ms += step_ms
            told.append(names[c.dlgmd_health_us(sight, address(frame), 1000 * step_ms)])
            right.append(health.step(frame, time_ms / 1000.0 if step_ms else None))
        assert set(right) == set(names)
        apart = [i for i, (a, b) in enumerate(zip(told, right, strict=True)) if a != b]
        assert all(told[i] in right[i - 1 : i + 2] for i in apart) and len(apart) <= 8
