"""Models as C: every formulation against Python, strict compilers, C++, traps, Cortex-M under QEMU.

What needs a tool that is not installed is skipped: gcc, g++, clang, gcc-arm-none-eabi with newlib,
qemu-system-arm.
"""

import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from exported import (
    EXPANSION,
    MP,
    WARNINGS,
    answers_of_c,
    answers_of_python,
    assert_alike,
    begins,
    error_of_mp,
    make,
    needs_cc,
    write,
)
from looming import approach
from reference import clips

from dlgmd_cli import load_set, open_video
from dlgmd_cli.microcontroller.export import Export
from dlgmd_cli.models.rules import side_of
from dlgmd_cli.parameters.presets import FORMULATIONS, load_config, parameters_of
from dlgmd_cli.stream.clock import sampling_step

pytestmark = [pytest.mark.slow, needs_cc]
OWN_FLIGHT = Path(__file__).parents[1] / "own_flight"
# A flight, a cube that comes closer, and cubes that pass.
_NAMES = ("group2", "looming-cube", "translating-cubes")
SAMPLES = [Path(__file__).parents[2] / f"sample_videos/{name}.mp4" for name in _NAMES]
SAMPLE = SAMPLES[0]
SMALL = parameters_of(load_config("flight-small"))
MODELS = pytest.mark.parametrize("params", [SMALL, load_set(9)], ids=["flight-small", "set9"])
# Whole milliseconds from frame to frame, by frames a second.
RATES = {15: (66, 67, 67), 30: (33, 33, 34), 60: (16, 17, 17), 120: (8, 8, 9)}
HAS_ARM = all(map(shutil.which, ("arm-none-eabi-gcc", "arm-none-eabi-size", "make")))
needs_arm = pytest.mark.skipif(not HAS_ARM, reason="gcc-arm-none-eabi is not installed")


@pytest.fixture(scope="module")
def own_flight():
    """24 frames before a contact, 96x54."""
    paths = sorted(OWN_FLIGHT.glob("*.png"))
    frames = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in paths]
    return [cv2.resize(frame, (96, 54), interpolation=cv2.INTER_AREA) for frame in frames]


@pytest.mark.parametrize(
    ("number", "formulation"),
    [
        *((number, "default") for number in (1, 2, 3, 4, 5, 6, 8, 9)),
        *((7, name) for name in FORMULATIONS),
    ],
)
def test_every_set_and_formulation(tmp_path, own_flight, number, formulation):
    params = load_set(number, formulation=formulation)
    export = Export(params, 96, 54)
    answers = answers_of_c(export, tmp_path, own_flight)
    right = answers_of_python(params, own_flight)
    assert right[:, MP].any() and not answers[:, EXPANSION:].any()  # nor is that measured
    assert_alike(export, answers, right)


@pytest.mark.parametrize(
    "changes",
    [
        *({"r": 1}, {"r": 12}, {"r": 2, "k": 3.0}, {"ffi_gd": False}, {"a": 0.0}),
        *({"alpha": 5.0}, {"sigma_e": 0.1}, {"n_sp": 4}, {"k": 1e-3, "kappa": 1e-6}),
        {"alarm": "ttc", "ttc_alarm": 0.5},
    ],
    ids=str,
)
def test_other_parameters(tmp_path, own_flight, changes):
    params = load_set(9, **changes)
    export = Export(params, 96, 54)
    answers = answers_of_c(export, tmp_path, own_flight)
    right = answers_of_python(params, own_flight)
    assert np.array_equal(answers[:, 0], right[:, 0])
    assert error_of_mp(export, answers, right).max() <= 1e-5


@pytest.mark.parametrize(
    ("name", "size"), [("flight-small", (96, 72)), ("flight", (240, 135))], ids=str
)
def test_alarms_of_clips_begin_at_those_of_python(tmp_path, own_flight, name, size):
    """Of sample videos, of the clips of the reference, and of the flight of the tests."""
    params = parameters_of(load_config(name))
    export = Export(params, *size)
    videos = [[frame.grey.copy() for frame in open_video(path, size_wh=size)] for path in SAMPLES]
    made = [
        [np.uint8(255.0 * frame) for frame in clip(54, 96, 12, seed=1)]
        for clip in (clips.drifting, clips.looming)
    ]
    for frames in [*videos, *made, own_flight]:
        frames = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in frames]
        answers = answers_of_c(export, tmp_path, frames)
        assert_alike(export, answers, answers_of_python(params, frames))


def test_any_frame_rate(tmp_path):
    """The same approach at four rates: with the steps, alarms are Python's, and hardly move.

    From 60 frames a second on, images that are further apart are compared, if they are kept.
    Without the steps, an approach looks slower the more frames there are.
    """
    frames = approach(468, 120, contact_s=4.0, size_wh=(96, 72))
    export, starts_s = Export(SMALL, 96, 72), []
    for fps, steps_ms in RATES.items():
        some = frames[:: 120 // fps]
        right = answers_of_python(SMALL, some, steps_ms)
        answers = answers_of_c(export, tmp_path, some, steps_ms, n_earlier=max(1, fps // 30))
        assert_alike(export, answers, right)
        starts_s.append(begins(right)[0] / fps)
    assert max(starts_s) - min(starts_s) < 0.15
    untimed = answers_of_c(export, tmp_path, frames)
    assert begins(untimed)[0] / 120 > max(starts_s) + 0.5


SANITIZED = f"{WARNINGS} -O1 -fsanitize=address,undefined -fno-sanitize-recover"


@pytest.mark.parametrize(
    ("params", "compiler", "flags"),
    [
        (SMALL, "gcc", f"{SANITIZED} -DDLGMD_EARLIER=4"),
        (SMALL, "gcc", f"{WARNINGS} -Wdouble-promotion -Wfloat-equal -Wcast-qual -Os"),
        (SMALL, "clang", "-Weverything -Werror -Wno-padded -Wno-declaration-after-statement"),
        (load_set(9), "gcc", f"{WARNINGS} -O3 -DDLGMD_EXPANSION=1 -DDLGMD_DEFLICKER=0"),
        (load_set(9), "clang", SANITIZED),
    ],
    ids=["checked", "warned", "clang warned", "set9", "set9 checked"],
)
def test_strict_compilers_and_sanitizers(tmp_path, params, compiler, flags):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    (tmp_path / "empty.c").write_text("int main(void) { return 0; }\n")
    if subprocess.run(
        [compiler, *flags.split(), "-o", "empty", "empty.c"], cwd=tmp_path
    ).returncode:
        pytest.skip(f"the sanitizers of {compiler} are not installed")
    folder = write(Export(params, 56, 42), tmp_path / "x")
    frames = folder / "frames.gray"
    sound = frames.read_bytes()
    frames.write_bytes(hard_frames(56, 42)[: 20 * 56 * 42])
    arguments = [f"CC={compiler}", f"CFLAGS={flags}"]
    make(folder, *arguments)
    for steps_ms in ([], ["1"], ["0", "33", "99999"]):
        subprocess.run(["./dlgmd", *steps_ms], cwd=folder, input=hard_frames(56, 42), check=True)
    frames.write_bytes(sound)
    assert make(folder, *arguments, "test").endswith("passed\n")


def hard_frames(width, height):
    """Black, white, flicker, noise, a single cell, and ramps that reach every level."""
    rng = np.random.default_rng(8)
    shape = (height, width)
    frames = [np.full(shape, level, np.uint8) for level in [0] * 6 + [255] * 5 + [0, 255] * 6]
    frames += [rng.integers(0, 256, shape, np.uint8) for _ in range(6)] + [frames[0]] * 8
    single = np.zeros(shape, np.uint8)
    single[height // 2, width // 2] = 1
    frames += [single, frames[0], single * 255, frames[0], frames[0]]
    frames += [rng.integers(0, 2, shape, np.uint8) * 255 for _ in range(6)]
    frames += [np.resize(np.arange(256, dtype=np.uint8) + 17 * t, shape) for t in range(8)]
    return b"".join(frame.tobytes() for frame in frames)


TRAPS = """#define _GNU_SOURCE
#include <fenv.h>
__attribute__((constructor)) static void on(void)
{
    feenableexcept(FE_DIVBYZERO | FE_OVERFLOW | FE_INVALID);
}
"""


@pytest.mark.skipif(not Path("/usr/include/fenv.h").exists(), reason="no feenableexcept here")
@MODELS
def test_no_floating_point_exception(tmp_path, params):
    folder = write(Export(params, 56, 42), tmp_path)
    (folder / "traps.c").write_text(TRAPS)
    fault = "int main(void) { volatile float zero = 0; return (int)(1 / zero); }"
    (folder / "fault.c").write_text(fault)
    for name, sources in (
        ("all", ["example.c", "dlgmd.c", "dlgmd_health.c"]),
        ("fault", ["fault.c"]),
    ):
        command = ["cc", "-O2", "-o", name, *sources, "traps.c", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run(["./fault"], cwd=folder).returncode < 0
    done = subprocess.run(["./all"], cwd=folder, input=hard_frames(56, 42), capture_output=True)
    assert (
        done.returncode == 0
        and done.stdout.count(b"\n") == len(hard_frames(56, 42)) // (56 * 42) + 1
    )


@needs_arm
@pytest.mark.parametrize("size", [(56, 42), (160, 120)], ids=str)
@MODELS
def test_costs_are_those_of_the_compiled_model(tmp_path, params, size):
    export = Export(params, *size)
    folder = write(export, tmp_path)
    printed = make(folder, "size", "CFLAGS=-O2 -fstack-usage")
    flash = int(printed.splitlines()[1].split()[0])
    assert export.costs["flash_bytes"] == pytest.approx(flash, rel=0.1)
    (usage,) = folder.glob("*.su")
    # All that calls one another is at most all functions together.
    stack = sum(int(line.split("\t")[1]) for line in usage.read_text().splitlines())
    assert stack <= export.costs["stack_bytes"]


@needs_arm
@MODELS
def test_nothing_is_called_that_is_not_said(tmp_path, params):
    """Memory functions alone: no division of 64 bits."""
    folder = write(Export(params, 96, 72), tmp_path)
    make(folder, "dlgmd.m4.o")
    named = subprocess.run(
        ["arm-none-eabi-nm", "-u", "dlgmd.m4.o"], cwd=folder, capture_output=True, text=True
    ).stdout
    assert set(re.findall(r"U (\w+)", named)) <= {"memset", "memcpy", "memmove"}


@needs_arm
@pytest.mark.skipif(not shutil.which("qemu-system-arm"), reason="qemu-system-arm is not installed")
@MODELS
def test_cortex_m_under_qemu(tmp_path, params):
    """The vectors pass on each board, in the instructions of docs/microcontroller.md."""
    folder = write(Export(params, 96, 72), tmp_path)
    printed = make(folder, "qemu")
    counts = [int(n) for n in re.findall(r"^instructions a frame: (\d+)$", printed, re.M)]
    assert printed.count("\npassed\n") == len(counts) == 2
    page = (Path(__file__).parents[2] / "docs/microcontroller.md").read_text(encoding="utf-8")
    row = f"| {'`flight-small`' if params is SMALL else 'set 9'} | 96x72 |"
    (line,) = (line for line in page.splitlines() if line.startswith(row))
    millions = [float(n) for n in re.findall(r"([\d.]+) M", line)]
    # M4 and M7. Another version of the compiler needs a few more or less.
    assert [count / 1e6 for count in counts] == pytest.approx(millions, rel=0.1)
    text = (folder / "vectors.h").read_text()
    (folder / "vectors.h").write_text(re.sub(r"{(1, ., .), ", r"{\1, 7", text))
    done = subprocess.run(["make", "-s", "qemu"], cwd=folder, capture_output=True)
    assert done.returncode != 0 and b"FAILED" in done.stdout


def test_the_frames_to_pass_and_the_side_are_those_of_python(tmp_path):
    """`dlgmd_every` against the choice of `Alarm`, `dlgmd_side_of` against `side_of`."""
    folder = write(Export(SMALL, 56, 42), tmp_path / "c")
    places = (-0.9, -0.34, -0.32, 0.0, 0.32, 0.34, 0.9)
    rates = (10, 15, 23, 24, 25, 30, 33, 34, 50, 60, 90, 120)
    answer = (
        "{.rule = rules[i % 3], .mp = 1, .has_ttc = true, "
        ".g_x = (float)places[i / 3], .expansion_x = (float)-places[i / 3]}"
    )
    (folder / "ask.c").write_text(
        '#include "dlgmd.h"\n#include <stdio.h>\nint main(void) {\n'
        f"    const uint32_t rates[] = {{{', '.join(map(str, rates))}}};\n"
        f"    const double places[] = {{{', '.join(map(str, places))}}};\n"
        "    const uint8_t rules[] = {DLGMD_SPIKES, DLGMD_TTC, DLGMD_AHEAD};\n"
        f"    for (int i = 0; i < {len(rates)}; i++) "
        '{ printf("%u\\n", (unsigned)dlgmd_every(rates[i])); }\n'
        f"    for (int i = 0; i < 3 * {len(places)}; i++) {{\n"
        f"        dlgmd_answer answer = {answer};\n"
        "        dlgmd_side side = dlgmd_side_of(&answer);\n"
        '        printf("%d\\n", side.known ? side.across : 9);\n    }\n'
        "    for (int i = 0; i < 3; i++) {\n"
        "        dlgmd_answer answer = {.rule = rules[i]};\n"
        '        printf("%d\\n", dlgmd_side_of(&answer).known);\n    }\n    return 0;\n}\n'
    )
    command = ["cc", "-std=c99", "-Wall", "-Wextra", "-Werror", "ask.c", "dlgmd.c", "-o", "ask"]
    subprocess.run(command, cwd=folder, check=True)
    told = subprocess.run([folder / "ask"], capture_output=True, text=True, check=True).stdout
    found = [int(line) for line in told.split()]
    expected = [0 if fps < 24 else sampling_step(fps, 33.0)[0] for fps in rates]
    words = {"left": -1, "ahead": 0, "right": 1}
    expected += [words[side_of(one * x, 0.0)] for x in places for one in (1, -1, -1)]
    assert found == [*expected, 0, 0, 0]  # nothing active, or nothing that expands
    assert "#define DLGMD_FPS 30" in (folder / "dlgmd.h").read_text()


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_two_exports_in_one_program_of_cpp(runs, tmp_path):
    """Of two sizes, with C++11 and 20; what is in the README is compiled, too."""
    for prefix, size in (("front_", "56x42"), ("down_", "64x48")):
        runs("export", "--size", size, "--prefix", prefix, "--out", prefix)
    (tmp_path / "main.cpp").write_text("""
#include "front_/front_dlgmd.h"
#include "down_/down_dlgmd.h"
#include <cstdint>
#include <cstdio>

int main()
{
    static front_dlgmd_state front;
    static down_dlgmd_state down;
    static std::uint8_t grey[DOWN_DLGMD_WIDTH * DOWN_DLGMD_HEIGHT];
    front_dlgmd_reset(&front);
    down_dlgmd_reset(&down);
    const front_dlgmd_answer a = front_dlgmd_step_us(&front, grey, 33333);
    const down_dlgmd_answer b = down_dlgmd_step_us(&down, grey, 33000);
    const bool is_near = a.ttc_s < 6.0F && b.ttc_s < 1.0F;
    std::printf("%d %d %d %d", FRONT_DLGMD_WIDTH, DOWN_DLGMD_WIDTH, is_near,
                front_dlgmd_side_of(&a).known);
    return 0;
}
""")
    objects = []
    for prefix in ("front_", "down_"):
        objects.append(f"{prefix}/{prefix}dlgmd.o")
        source = f"{prefix}/{prefix}dlgmd.c"
        subprocess.run(["cc", "-O1", "-c", source, "-o", objects[-1]], check=True, cwd=tmp_path)
    readme = (tmp_path / "front_" / "README.md").read_text()
    (tmp_path / "front_" / "loop.cpp").write_text(re.search("```cpp\n(.*?)```", readme, re.S)[1])
    for standard in (11, 20):
        strict = [f"-std=c++{standard}", "-Wall", "-Wextra", "-pedantic-errors", "-Werror"]
        compiled = ["g++", *strict, "main.cpp", *objects, "-o", "both"]
        subprocess.run(compiled, check=True, cwd=tmp_path)
        done = subprocess.run([tmp_path / "both"], capture_output=True, text=True, check=True)
        assert done.stdout == "56 64 0 0"
        loop = ["g++", *strict, "-c", "front_/loop.cpp", "-o", "loop.o"]
        subprocess.run(loop, check=True, cwd=tmp_path)
