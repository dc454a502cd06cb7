"""Files of strangers: whatever is changed in what a command reads, it ends with one clear line."""

import math
import os
import re
import resource
import shutil
import struct
import sys
import time
import zlib
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest
from click.testing import CliRunner
from conftest import looming_frames
from damaged import sound_videos
from PIL import Image

from dlgmd_cli.commands.app import cli
from dlgmd_cli.machine.pool import run_tasks

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="limits differ there"),
]
N_EACH = 400 if os.environ.get("DLGMD_THOROUGH") else 25
LIMIT_S, LIMIT_BYTES = 30.0, 2 << 30
RUN = "run {} --no-plots --overwrite"
AFRESH = "run mjpg.avi --no-plots --overwrite"
EVALUATE = "evaluate labels.csv --no-plots --overwrite --no-baselines --out e"
SWEEP = "sweep mjpg.avi --x r=1,2 --y a=1,2 --jobs 1 --no-plots --out s"
LAYERS = "layers mjpg.avi --frames 5,8 --no-plots --npz --out y"
KERNELS = "kernels --no-plots --overwrite --out k"
SYNTH = "synth random --count 2 --jobs 1 --size 32x24 --frames 8 --out f"
# What is changed, and the commands that read it.
READERS = {
    "videos": [RUN, "info {}"],
    "pictures/5.*": ["run pictures --no-plots --overwrite", "info pictures", "batch . --dry-run"],
    "x.gif": [RUN],
    "x.npy": [RUN],
    "mask.*": [f"{AFRESH} --mask {{}}"],
    "labels.csv": [EVALUATE, "view r/mjpg --no-film --labels {} --overwrite --out p.html"],
    "config.yaml": [f"{AFRESH} --config {{}}", f"{KERNELS} --config {{}}"],
    "r/mjpg/run.yaml": [
        "plot mp r/mjpg --overwrite",
        "view r/mjpg --no-film --overwrite --out p.html",
        f"{EVALUATE} --results r",
        f"{AFRESH} --config {{}}",
        f"{AFRESH} --out r",
        "batch mjpg.avi --out r --no-plots --dry-run",
    ],
    "r/mjpg/*.csv": ["plot overview r/mjpg --overwrite", f"{EVALUATE} --results r"],
    "r/summary.csv": ["batch mjpg.avi --out r --no-plots --dry-run"],
    "c/mjpg/compare.*": [
        "view c/mjpg --no-film --overwrite --out p.html",
        "compare mjpg.avi --set 3 --set 9 --no-plots --overwrite --out c",
    ],
    "y/mjpg/layers.yaml": [f"{LAYERS} --overwrite", f"{AFRESH} --config {{}}"],
    "s/sweep-mjpg/sweep.*": [SWEEP],
    "e/evaluate.yaml": [EVALUATE, f"{KERNELS} --config {{}}"],
    "f/*.yaml": [SYNTH],
    "f/labels.csv": [SYNTH],
}
# What takes time, memory or the stack of a reader that knows no bounds.
BOMBS = [
    b"[" * 50_000,
    b"a: &a [x,x,x]\n"
    + b"".join(b"%c: &%c [*%c,*%c,*%c]\n" % (n + 1, n + 1, n, n, n) for n in range(97, 120)),
]
STRANGE = ["nan", "-1", "0", "1e999", "9" * 400, "x", "", "[]", "{a: b}", "~", "\x1b[2J", "1e9"]


def invoke(command):
    return CliRunner().invoke(cli, command.split(), prog_name="dlgmd")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A folder with one file of every kind that a command reads, and the results of a few."""
    folder = tmp_path_factory.mktemp("whole")
    frames = looming_frames(12, 64, 48)
    sound_videos(folder)
    (folder / "pictures").mkdir()
    endings = ["png", "jpg", "tiff", "webp", "bmp", "jp2", "pgm", "gif"]
    for number, frame in enumerate(frames):
        ending = endings[number % 7]
        cv2.imwrite(str(folder / f"pictures/{number}.{ending}"), frame)
    for ending in endings[:7]:
        cv2.imwrite(str(folder / f"mask.{ending}"), frames[5])
        cv2.imwrite(str(folder / f"pictures/5.{ending}"), frames[5])
    shown = [Image.fromarray(frame) for frame in frames]
    shown[0].save(folder / "x.gif", save_all=True, append_images=shown[1:])
    np.save(folder / "x.npy", np.array(frames))
    (folder / "labels.csv").write_text("video,collision_frame,kind\nmjpg.avi,9,tree\n")
    (folder / "config.yaml").write_text("sigma_e: 1.5\nr: 2\nmodel: dlgmd\noptions: {fps: 20}\n")
    commands = [f"{AFRESH} --out r", f"{EVALUATE}", SWEEP, LAYERS, SYNTH, KERNELS]
    commands += ["batch mjpg.avi --out r --no-plots --force --jobs 1"]
    commands += ["compare mjpg.avi --set 3 --set 9 --no-plots --out c"]
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for command in commands:
            result = invoke(command)
            assert result.exit_code == 0, (command, result.output)
    return folder


def mutant(data, name, random):
    """The content of a file, changed in a few places; of text, whole values or lines too."""
    if name.endswith("yaml") and random.random() < 0.1:
        return BOMBS[random.integers(2)]
    if name.endswith(("yaml", "csv")) and random.random() < 0.8:
        words = re.split(rb"([\s,:\[\]{}]+)", data)
        for place in random.integers(0, len(words), random.integers(1, 4)):
            words[place] = STRANGE[random.integers(len(STRANGE))].encode()
        return b"".join(words)
    content = np.frombuffer(data, np.uint8).copy()
    way, end = random.integers(5), len(data) if random.random() < 0.5 else min(len(data), 200)
    if way == 0:
        return content[: random.integers(len(data))].tobytes()
    if way == 1:  # whole words of the header, such as sizes
        start = int(random.integers(0, max(end - 4, 1)))
        content[start : start + 4] = random.choice([0, 127, 255], 4)
    else:
        n_changed = int(2 ** random.uniform(0, 7))
        content[random.integers(0, end, n_changed)] = random.integers(0, 256, n_changed)
    if name.endswith("png"):  # else nothing but the check sum is seen to be wrong
        content[29:33] = np.frombuffer(struct.pack(">I", zlib.crc32(content[12:29])), np.uint8)
    return content.tobytes()


def files_read(folder, pattern):
    """The files that a pattern of `READERS` stands for."""
    suffixes = (".avi", ".mp4", ".mkv", ".webm", ".ts", ".mpg")
    if pattern == "videos":
        return sorted(path for path in folder.iterdir() if path.suffix in suffixes)
    return sorted(folder.glob(pattern))


def attack(whole, scratch, task):
    """What is wrong with how commands end over mutants of one kind; in a process of a pool."""
    pattern, numbers = task
    folder = scratch / f"{re.sub(r'[^a-z]', '', pattern)}{numbers[0]}"
    shutil.copytree(whole, folder)
    os.chdir(folder)
    files, commands, faults = files_read(folder, pattern), READERS[pattern], []
    # What is mapped before counts too, some GB of it.
    n_pages = int(Path("/proc/self/statm").read_text().split()[0])
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (n_pages * resource.getpagesize() + LIMIT_BYTES, most))
    for number in numbers:
        random = np.random.default_rng((7, len(pattern), number))
        file = files[number % len(files)]
        data = (whole / file.relative_to(folder)).read_bytes()
        file.write_bytes(mutant(data, file.name, random))
        command = commands[number // len(files) % len(commands)].replace("{}", file.name)
        began, result = time.monotonic(), invoke(command)
        took_s = time.monotonic() - began
        lines = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
        is_told = bool(lines) == (result.exit_code != 0)
        text = result.output
        if result.exit_code not in (0, 1, 2) or "internal error" in text or "Traceback" in text:
            faults.append((number, command, file.name, result.exit_code, text[-300:]))
        elif not is_told or "not enough memory" in text or took_s > LIMIT_S:
            faults.append((number, command, file.name, took_s, text[-300:]))
        file.write_bytes(data)
        for made in {file.parent, folder / "r/mjpg", folder / "c/mjpg"} - {folder}:  # replaced
            shutil.copytree(whole / made.relative_to(folder), made, dirs_exist_ok=True)
    shutil.rmtree(folder)
    return faults


def test_mutants(whole, tmp_path, monkeypatch):
    for side in ("WIDTH", "HEIGHT"):  # as the command sets it
        monkeypatch.setenv(f"OPENCV_IO_MAX_IMAGE_{side}", "8192")
    tasks, n_tried = [], 0
    for pattern, commands in READERS.items():
        n_files = len(files_read(whole, pattern))
        count = max(N_EACH * max(len(commands), math.isqrt(n_files)), n_files * len(commands))
        tasks += [(pattern, range(first, min(first + 60, count))) for first in range(0, count, 60)]
        n_tried += count
    assert n_tried > 700
    faults = []
    for task, outcome in run_tasks(partial(attack, whole, tmp_path), tasks, 2, timeout_s=300):
        try:
            faults += outcome.result()  # raises if it took its process with it
        except Exception as error:
            faults.append((task, repr(error)))
    assert not faults, "\n".join(map(str, faults))
