"""Models as C: every formulation against Python, strict compilers, traps, Cortex-M under QEMU.

What needs a tool that is not installed is skipped: gcc, clang, gcc-arm-none-eabi with newlib,
qemu-system-arm.
"""

import re
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import csv_rows
from exported import (
    ALARM,
    EXPANSION,
    MP,
    MP_ABS,
    TTC_S,
    WARNINGS,
    answers_of_c,
    answers_of_python,
    assert_alike,
    error_of_mp,
    make,
    needs_cc,
    write,
)
from looming import approach

from dlgmd_cli import load_set, open_video
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.export.project import Export
from dlgmd_cli.frame import sampling_step
from dlgmd_cli.models.rules import side_of
from dlgmd_cli.parameters.presets import FORMULATIONS, load_config, parameters_of

pytestmark = [pytest.mark.slow, needs_cc]
OWN_FLIGHT = Path(__file__).parents[1] / "own_flight"
SAMPLE = Path(__file__).parents[2] / "sample_videos/group2.mp4"
SMALL = parameters_of(load_config("flight-small"))
ARITHMETIC = pytest.mark.parametrize("is_fixed", [False, True], ids=["float", "fixed"])
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


@pytest.fixture(scope="module")
def approaches():
    """Frames of the sample flight, and of planes that come closer, at 160x120."""
    flight = [frame.grey.copy() for frame in open_video(SAMPLE, size_wh=(160, 120))]
    return [flight, *(approach(90, 30, s, size_wh=(160, 120)) for s in (3.05, 3.4, 4.5, 9.0))]


@ARITHMETIC
@pytest.mark.parametrize("formulation", FORMULATIONS)
@pytest.mark.parametrize("number", range(1, 10))
def test_every_set_and_formulation(tmp_path, own_flight, number, formulation, is_fixed):
    params = load_set(number, formulation=formulation)
    if is_fixed and formulation == "equations":
        with pytest.raises(ParameterError, match="no upper bound"):
            Export(params, 96, 54, is_fixed)
        return
    export = Export(params, 96, 54, is_fixed)
    answers = answers_of_c(export, tmp_path, own_flight)
    right = answers_of_python(params, own_flight)
    assert right[:, MP].any()
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
@ARITHMETIC
def test_other_parameters(tmp_path, own_flight, changes, is_fixed):
    params = load_set(9, **changes)
    export = Export(params, 96, 54, is_fixed)
    answers = answers_of_c(export, tmp_path, own_flight)
    right = answers_of_python(params, own_flight)
    assert np.array_equal(answers[:, 0], right[:, 0])
    assert error_of_mp(export, answers, right).max() <= (0.02 if is_fixed else 1e-5)


@pytest.mark.parametrize("size", [(38, 22), (160, 120)], ids=str)
@MODELS
def test_approaches(tmp_path, approaches, params, size):
    """Float: the answers to 1e-5 and the same alarms. Fixed: the same alarms within a frame."""
    exports = [Export(params, *size, is_fixed) for is_fixed in (False, True)]
    for number, large in enumerate(approaches):
        frames = [cv2.resize(frame, size, interpolation=cv2.INTER_AREA) for frame in large]
        right = answers_of_python(params, frames)
        folders = [tmp_path / f"{number}-{kind}" for kind in ("float", "fixed")]
        for folder in folders:
            folder.mkdir()
        single, fixed = map(answers_of_c, exports, folders, [frames] * 2)
        assert_alike(exports[0], single, right)
        assert np.abs(fixed[:, MP_ABS] - right[:, MP_ABS]).max() <= 0.03
        for answers in (fixed[:, ALARM], right[:, ALARM]):
            other = right[:, ALARM] if answers is not right[:, ALARM] else fixed[:, ALARM]
            near = np.convolve(other, np.ones(3), "same") > 0
            assert not (answers.astype(bool) & ~near).any()


def test_any_frame_rate(tmp_path):
    """The same approach at four rates: with the steps, alarms are Python's, and hardly move.

    From 60 frames a second on, images that are further apart are compared, if they are kept.
    Without the steps, an approach looks slower the more frames there are.
    """
    frames = approach(468, 120, contact_s=4.0, size_wh=(96, 72))
    exports = [Export(SMALL, 96, 72, is_fixed) for is_fixed in (False, True)]
    for fps, steps_ms in RATES.items():
        some = frames[:: 120 // fps]
        right = answers_of_python(SMALL, some, steps_ms)
        assert 2.3 < int(np.argmax(right[:, ALARM])) / fps < 2.5
        for export in exports:
            n_earlier = max(1, fps // 30)
            answers = answers_of_c(export, tmp_path, some, steps_ms, n_earlier=n_earlier)
            assert np.array_equal(answers[:, ALARM], right[:, ALARM])
            most = 0.04 if export.is_fixed else 1e-5
            assert np.abs(answers[:, EXPANSION] - right[:, EXPANSION]).max() <= most
            both = (answers[:, TTC_S] > 0) & (right[:, TTC_S] > 0) & (right[:, TTC_S] < 3)
            ttc_s, expected_s = answers[both, TTC_S], right[both, TTC_S]
            np.testing.assert_allclose(ttc_s, expected_s, rtol=most)
    untimed = answers_of_c(exports[0], tmp_path, frames)
    assert int(np.argmax(untimed[:, ALARM])) / 120 > 3.5


def test_alarms_are_those_of_the_command(runs, tmp_path):
    """Of a video of that size: the command measures the expansion of the video, not of --size."""
    frames = [frame.grey.copy() for frame in open_video(SAMPLE, size_wh=(96, 72))]
    np.save(tmp_path / "small.npy", frames)
    options = ["--set", "flight-small", "--repeats", "keep", "--input-fps", "30"]
    runs("run", tmp_path / "small.npy", *options)
    rows = csv_rows("dlgmd-out/small/spikes.csv")
    expected = [[int(row["spike"]), int(row["alarm"])] for row in rows]
    for is_fixed in (False, True):
        answers = answers_of_c(Export(SMALL, 96, 72, is_fixed), tmp_path, frames)
        assert answers[:, 1 : ALARM + 1].astype(int).tolist() == expected
        assert answers[:, ALARM].any()


SANITIZED = f"{WARNINGS} -O1 -fsanitize=address,undefined -fno-sanitize-recover"


# One compiler sees all four, each of the others both models and both arithmetics.
@pytest.mark.parametrize(
    ("compiler", "flags", "params", "is_fixed"),
    [
        *(("gcc", SANITIZED, load_set(9) if k > 1 else SMALL, bool(k % 2)) for k in range(4)),
        *(
            (compiler, flags, params, params is SMALL)
            for compiler, flags in (
                ("gcc", f"{WARNINGS} -Wdouble-promotion -Wfloat-equal -Wcast-qual -Os"),
                ("gcc", f"{WARNINGS} -O3 -DDLGMD_EXPANSION=1 -DDLGMD_DEFLICKER=0"),
                ("clang", f"{SANITIZED} -DDLGMD_EARLIER=4"),
                ("clang", "-Weverything -Werror -Wno-padded -Wno-declaration-after-statement"),
            )
            for params in (SMALL, load_set(9))
        ),
    ],
    ids=lambda one: type(one).__name__ if hasattr(one, "model") else str(one)[:60],
)
def test_strict_compilers_and_sanitizers(tmp_path, params, is_fixed, compiler, flags):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    (tmp_path / "empty.c").write_text("int main(void) { return 0; }\n")
    if subprocess.run(
        [compiler, *flags.split(), "-o", "empty", "empty.c"], cwd=tmp_path
    ).returncode:
        pytest.skip(f"the sanitizers of {compiler} are not installed")
    folder = write(Export(params, 40, 30, is_fixed), tmp_path / "x")
    frames = folder / "frames.gray"
    sound = frames.read_bytes()
    frames.write_bytes(hard_frames(40, 30)[: 20 * 40 * 30])
    arguments = [f"CC={compiler}", f"CFLAGS={flags}"]
    make(folder, *arguments)
    for steps_ms in ([], ["1"], ["0", "33", "99999"]):
        subprocess.run(["./dlgmd", *steps_ms], cwd=folder, input=hard_frames(40, 30), check=True)
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
@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@MODELS
def test_no_floating_point_exception(tmp_path, params, compiler):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} is not installed")
    folder = write(Export(params, 40, 30), tmp_path)
    (folder / "traps.c").write_text(TRAPS)
    fault = "int main(void) { volatile float zero = 0; return (int)(1 / zero); }"
    (folder / "fault.c").write_text(fault)
    for name, sources in (
        ("all", ["example.c", "dlgmd.c", "dlgmd_health.c"]),
        ("fault", ["fault.c"]),
    ):
        command = [compiler, "-O2", "-o", name, *sources, "traps.c", "-lm"]
        subprocess.run(command, cwd=folder, check=True)
    assert subprocess.run(["./fault"], cwd=folder).returncode < 0
    done = subprocess.run(["./all"], cwd=folder, input=hard_frames(40, 30), capture_output=True)
    assert done.returncode == 0 and done.stdout.count(b"\n") == len(hard_frames(40, 30)) // 1200 + 1


@needs_arm
@pytest.mark.parametrize("size", [(38, 22), (160, 120)], ids=str)
@ARITHMETIC
@MODELS
def test_costs_are_those_of_the_compiled_model(tmp_path, params, is_fixed, size):
    export = Export(params, *size, is_fixed)
    folder = write(export, tmp_path)
    printed = make(folder, "size", "CFLAGS=-O2 -fstack-usage")
    flash = int(printed.splitlines()[1].split()[0])
    assert export.costs["flash_bytes"] == pytest.approx(flash, rel=0.1)
    (usage,) = folder.glob("*.su")
    # All that calls one another is at most all functions together.
    stack = sum(int(line.split("\t")[1]) for line in usage.read_text().splitlines())
    assert stack <= export.costs["stack_bytes"]


@needs_arm
@ARITHMETIC
@MODELS
def test_nothing_is_called_that_is_not_said(tmp_path, params, is_fixed):
    """Memory functions alone: no division of 64 bits, and with integers nothing for floats."""
    folder = write(Export(params, 96, 72, is_fixed), tmp_path)
    make(folder, "dlgmd.m4.o")
    named = subprocess.run(
        ["arm-none-eabi-nm", "-u", "dlgmd.m4.o"], cwd=folder, capture_output=True, text=True
    ).stdout
    assert set(re.findall(r"U (\w+)", named)) <= {"memset", "memcpy", "memmove"}


@needs_arm
@pytest.mark.skipif(not shutil.which("qemu-system-arm"), reason="qemu-system-arm is not installed")
@ARITHMETIC
@MODELS
def test_cortex_m_under_qemu(tmp_path, params, is_fixed):
    """The vectors pass on each board, in the instructions of docs/microcontroller.md."""
    folder = write(Export(params, 96, 72, is_fixed), tmp_path)
    printed = make(folder, "qemu")
    counts = [int(n) for n in re.findall(r"^instructions a frame: (\d+)$", printed, re.M)]
    n_boards = 3 if is_fixed else 2
    assert printed.count("\npassed\n") == len(counts) == n_boards
    page = (Path(__file__).parents[2] / "docs/microcontroller.md").read_text(encoding="utf-8")
    model, arithmetic = (
        "`flight-small`" if params is SMALL else "set 9",
        ("float", "fixed")[is_fixed],
    )
    row = f"| {model} | {arithmetic} | 96x72 |"
    (line,) = (line for line in page.splitlines() if line.startswith(row))
    millions = [float(n) for n in re.findall(r"([\d.]+) M", line)]
    # M4 and M7. Another version of the compiler needs a few more or less.
    assert [count / 1e6 for count in counts[-2:]] == pytest.approx(millions, rel=0.1)
    text = (folder / "vectors.h").read_text()
    (folder / "vectors.h").write_text(re.sub(r"{(1, ., .), ", r"{\1, 7", text))
    done = subprocess.run(["make", "-s", "qemu"], cwd=folder, capture_output=True)
    assert done.returncode != 0 and b"FAILED" in done.stdout


@ARITHMETIC
def test_the_frames_to_pass_and_the_side_are_those_of_python(tmp_path, is_fixed):
    """`dlgmd_every` against the choice of `Alarm`, `dlgmd_side_of` against `side_of`."""
    folder = write(Export(SMALL, 40, 30, is_fixed), tmp_path / "c")
    one, places = 32768 if is_fixed else 1, (-0.9, -0.34, -0.32, 0.0, 0.32, 0.34, 0.9)
    rates = (10, 15, 23, 24, 25, 30, 33, 34, 50, 60, 90, 120)
    cast = "int16_t" if is_fixed else "float"
    answer = (
        "{.rule = rules[i % 3], .mp = 1, .has_ttc = true, "
        f".g_x = ({cast})(places[i / 3] * {one}), "
        f".expansion_x = ({cast})(-places[i / 3] * {one})}}"
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


def test_nothing_crosses(tmp_path, own_flight):
    """The rule changes no number; a set with the rule spikes measures no expansion."""
    spikes, ttc = (
        answers_of_c(Export(load_set(6, alarm=rule), 96, 54), tmp_path, own_flight)
        for rule in ("spikes", "ttc")
    )
    right = answers_of_c(Export(load_set(9, alarm="ttc"), 96, 54), tmp_path, own_flight)
    neuron, measured = slice(MP, EXPANSION), slice(EXPANSION, None)
    assert np.array_equal(spikes[:, neuron], ttc[:, neuron]) and not spikes[:, measured].any()
    assert np.array_equal(ttc[:, measured], right[:, measured]) and ttc[:, EXPANSION].any()
    assert not np.array_equal(ttc[:, MP_ABS], right[:, MP_ABS])
