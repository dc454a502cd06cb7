"""Tiny clips that are written once, and a way to call the command."""

import csv
import gc
import os
import re
import shutil
import signal
import socket
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from hypothesis import settings

from dlgmd_cli import DLGMD
from dlgmd_cli.machine import cancel, threads
from dlgmd_cli.machine.files import PREFIX
from dlgmd_cli.machine.pool import DONE, FAILED, TaskEnd
from dlgmd_cli.models import filters
from dlgmd_cli.models.normalise import absolute
from dlgmd_cli.parameters import presets
from dlgmd_cli.parameters.keys import RULES
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import intervals
from dlgmd_cli.results.csv import rows_of
from dlgmd_cli.results.judging import judged
from dlgmd_cli.results.result import Result

# Full collections walk through all modules and tests, which took 8 % of the time.
gc.set_threshold(20_000)
if hasattr(signal, "SIGHUP"):
    # Below nohup it is ignored, which the processes that tests start would keep to.
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # in the background of a shell
    signal.signal(signal.SIGINT, signal.default_int_handler)
# Fewer examples than usual, the same in each run: what a change breaks is not a matter of luck. No
# deadline, which a busy machine misses. `--hypothesis-profile=search` looks for new ones.
settings.register_profile("quick", max_examples=40, derandomize=True, deadline=None)
settings.register_profile("search", max_examples=1000, deadline=None)
settings.load_profile("quick")


def once_for_the_same(plan):
    """`plan` that remembers: tests make the same models over and over, for 4 ms each."""
    plans = {}

    def planned(kernels, gaussians):
        values = [(delay, kernel.tobytes()) for delay, kernel in kernels.items()]
        key = (*values, *(one.tobytes() for one in gaussians))
        if key not in plans:
            plans[key] = plan(kernels, gaussians)
        return plans[key]

    return planned


filters.plan = once_for_the_same(filters.plan)
# Every command reads the presets of the package, for 10 ms each.
presets.load_model_preset = cache(presets.load_model_preset)


def pytest_configure(config):
    """Let processes take files in their order, and not those with few but long tests at last."""
    if hasattr(config.option, "loadscopereorder"):
        config.option.loadscopereorder = False


def pytest_runtest_setup(item):
    """A few small frames are decoded sooner without threads, which each opening starts anew.

    Tests that are marked slow have them.
    """
    threads.limit_threads(None if item.get_closest_marker("slow") else 1)


def pytest_collection_finish():
    """Modules and tests stay: collections need not walk through them."""
    gc.freeze()


WIDTH, HEIGHT, N_FRAMES, FPS = 32, 24, 20, 25.0
# The commands that draw figures.
DRAWING = {"batch", "compare", "evaluate", "layers", "run", "sweep"}


def looming_frames(n_frames=N_FRAMES, width=WIDTH, height=HEIGHT):
    """A dark square that grows faster and faster on a bright, faintly textured ground.

    Its edges move by parts of a pixel, so that no frame repeats another.
    """
    texture = np.random.default_rng(7).integers(200, 230, (height, width), dtype=np.uint8)
    y, x = (np.abs(np.arange(n) - (n - 1) / 2) for n in (height, width))
    frames = []
    for t in range(n_frames):
        half = min(height, width) * 0.45 / (n_frames - t)
        covered = np.outer(np.clip(half + 0.5 - y, 0, 1), np.clip(half + 0.5 - x, 0, 1))
        frames.append(np.round(texture + covered * (20.0 - texture)).astype(np.uint8))
    return frames


def write_video(path: Path, frames, fps=FPS, fourcc="MJPG") -> Path:
    """Write grey frames as a video."""
    height, width = frames[0].shape[:2]
    code = cv2.VideoWriter_fourcc(*fourcc)
    writer = cv2.VideoWriter(str(path), cv2.CAP_FFMPEG, code, fps, (width, height), True)
    assert writer.isOpened()
    for frame in frames:
        writer.write(cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR) if frame.ndim == 2 else frame)
    writer.release()
    return path


def make_result(mp, *, time_s=None, frame=None, attenuation_db=None, size_wh=(10, 10), **options):
    """A result of set 9 with these membrane potentials; `options` are what was given to `run`."""
    mp = np.asarray(mp, float)
    n = len(mp)
    frame = np.arange(n) if frame is None else np.asarray(frame)
    record = {
        "input": {"path": "/somewhere/flight.mp4", "fps": FPS, "frames": n, "decoder": "opencv"},
        "processed": {"width": size_wh[0], "height": size_wh[1], "frames": n},
        "model": "dlgmd",
        **DlgmdParameters().to_dict(),
        "options": options,
        "warnings": [],
        "complete": True,
    }
    db = np.zeros(n) if attenuation_db is None else np.asarray(attenuation_db, float)
    time_s = frame / FPS if time_s is None else np.asarray(time_s, float)
    columns = {"frame": frame, "time_s": time_s, "mp": mp, "attenuation_db": db}
    rows = rows_of({**columns, "p_sum": 1.0, "s_sum": 1.0})
    return judged_anew(Result(rows, DlgmdParameters(), record))


def judged_anew(result):
    """The result with the spikes and alarms that its rule gives for its potentials, as a run."""
    rows = result.rows.copy()
    rows["mp_abs"] = absolute(rows["mp"], result.n_cells, result.params.kappa)
    rows["level"] = result.mp_seq if result.by_sequence else rows["mp_abs"]
    return replace(result, rows=judged(rows, result.rule))


def result_of_level(level, **options):
    """A result whose `mp_abs` is `level`."""
    level = np.asarray(level, float)
    return make_result(100 * DlgmdParameters().kappa * level / (1.0 - level), **options)


def csv_rows(path: Path):
    """The rows of a CSV as mappings of text."""
    with open(path, newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def files_of(folder):
    """The files below a folder, without those half written and what the clock puts into them."""
    found = {}
    for path in sorted(Path(folder).rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.is_file() and not name.startswith(PREFIX) and f"/{PREFIX}" not in name:
            content = re.sub(rb"(?m)^wall_s: .*\n", b"", path.read_bytes())
            if path.name == "summary.csv":  # whose last column is the time
                content = re.sub(rb"(?m),[^,\n]*$", b"", content)
            found[name] = content
    return found


def free_port():
    """A port of this machine to which datagrams may go."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def full(*_, **__):
    """Instead of what writes: the disk is full."""
    raise OSError(28, "No space left on device")


def yaml_of(path: Path):
    """The content of a YAML file."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times as fast
    return yaml.load(Path(path).read_text(encoding="utf-8"), loader)


def until(is_so, limit_s=60.0):
    """Wait for something that must come about soon, in another thread or process."""
    end, pause_s = time.monotonic() + limit_s, 0.0005
    while not is_so():
        assert time.monotonic() < end
        time.sleep(pause_s)
        pause_s = min(1.5 * pause_s, 0.01)


def scene(height, width, n_frames=6, dtype=np.uint8, seed=3):
    """Blocks that drift, and bright squares that grow fast: something for every tile."""
    rng = np.random.default_rng(seed)
    ground = rng.integers(40, 160, (height // 5 + 9, width // 5 + 9), dtype=np.uint8)
    ground = np.kron(ground, np.ones((5, 5), np.uint8))
    frames = []
    for t in range(n_frames):
        frame = ground[2 * t : 2 * t + height, 3 * t : 3 * t + width].copy()
        for y in range(height // 2 % 80, height, 80):
            for x in range(width // 2 % 80, width, 80):
                rows, columns = (slice(max(0, c - 5 * t), c + 5 * t) for c in (y, x))
                frame[rows, columns] = 250
        frames.append(frame)
    return frames if dtype == np.uint8 else [f.astype(dtype) / dtype(255) for f in frames]


def read_video(path: Path):
    """Frame rate and every frame of a video."""
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    rate, frames = capture.get(cv2.CAP_PROP_FPS), []
    while True:
        is_read, frame = capture.read()
        if not is_read:
            return rate, frames
        frames.append(frame)


@pytest.fixture(scope="session")
def clips(tmp_path_factory) -> Path:
    """`loom.avi` (MJPG), `loom.mp4` and `short.avi` (3 frames); not to be written to."""
    folder = tmp_path_factory.mktemp("clips")
    write_video(folder / "loom.avi", looming_frames())
    write_video(folder / "loom.mp4", looming_frames(), fourcc="mp4v")
    write_video(folder / "short.avi", looming_frames(3))
    return folder


@pytest.fixture
def cut(clips, tmp_path) -> str:
    """Name of a video in the working folder whose last quarter is missing."""
    whole = (clips / "loom.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(whole[: len(whole) * 3 // 4])
    return "cut.avi"


@pytest.fixture(scope="session")
def pictures(tmp_path_factory) -> Path:
    """A folder of 12 PNG named 1.png … 12.png; not to be written to."""
    folder = tmp_path_factory.mktemp("pictures")
    for number, frame in enumerate(looming_frames(12), start=1):
        cv2.imwrite(str(folder / f"{number}.png"), frame)
    return folder


@pytest.fixture(params=["opencv", "pyav"])
def decoder(request) -> str:
    """Every decoder of videos, as far as it is installed."""
    if request.param == "pyav":
        pytest.importorskip("av", reason="PyAV is not installed")
    return request.param


@pytest.fixture(scope="module")
def chromium():
    """Chromium, driven by Playwright; skips where one of them is absent."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")
    program = os.environ.get("DLGMD_BROWSER") or shutil.which("chromium")
    if program is None:
        pytest.skip("Chromium is not installed (apt-get install chromium)")
    with playwright.sync_playwright() as driver:
        found = driver.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield found
        found.close()


@pytest.fixture
def browser(chromium):
    """The same, whose pages end with the test: what nobody sees would go on to ask and to draw."""
    yield chromium
    for context in chromium.contexts:
        context.close()


@pytest.fixture(autouse=True)
def own_rules():
    """A rule of a test's own is known as long as the test runs."""
    known = dict(RULES)
    yield
    for name in RULES.keys() - known.keys():
        del RULES[name]


@pytest.fixture(autouse=True)
def quick(request, monkeypatch):
    """But in tests marked slow, scores have intervals of 200 resamples, figures are not painted.

    They are made, which is quick beside it. A test that looks into their files is marked
    `painted`; `test_outcomes.py` paints every kind.
    """
    if request.node.get_closest_marker("slow"):
        return
    monkeypatch.setattr(intervals, "N_RESAMPLES", 200)
    if not request.node.get_closest_marker("painted"):
        # By its name: Matplotlib is not imported before a test needs it.
        monkeypatch.setattr(
            "dlgmd_cli.plots.style.save_figure", lambda figure, path, dpi=0: path.touch()
        )


@pytest.fixture
def set_threads():
    """Sets the number of OpenCV's threads, and puts it back."""
    before = cv2.getNumThreads()
    yield cv2.setNumThreads
    cv2.setNumThreads(before)


@pytest.fixture
def stop(monkeypatch):
    """Set the stop flag, as a first Ctrl-C does: `stop()`; it is cleared after the test."""
    monkeypatch.setattr(cancel, "_requested", False)
    monkeypatch.setattr(cancel, "_terminated", False)
    return lambda: monkeypatch.setattr(cancel, "_requested", True)


@pytest.fixture
def stop_at(monkeypatch, stop):
    """Set the stop flag in the given call of a method: `stop_at(9)`."""

    def arrange(call, target=DLGMD, name="step"):
        method, seen = getattr(target, name), []

        def stopping(self, *arguments, **options):
            seen.append(1)
            if len(seen) == call:
                stop()
            return method(self, *arguments, **options)

        monkeypatch.setattr(target, name, stopping)

    return arrange


@pytest.fixture
def here(monkeypatch):
    """Tasks are done in this process, which is quicker than to start others."""

    def run_tasks(function, tasks, jobs, *, timeout_s=None):
        for task in tasks:
            cancel.check()
            try:
                outcome = TaskEnd(DONE, function(task))
            except Exception as error:
                outcome = TaskEnd(FAILED, error=error)
            yield task, outcome

    monkeypatch.setattr("dlgmd_cli.machine.pool.run_tasks", run_tasks)


@pytest.fixture
def dlgmd(tmp_path, monkeypatch):
    """Call the command in an empty folder: `dlgmd("run", "x.mp4")` -> click's result."""
    from dlgmd_cli.commands.app import cli

    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        return CliRunner().invoke(cli, [str(a) for a in arguments], prog_name="dlgmd")

    return call


@pytest.fixture
def runs(dlgmd):
    """Call a command that must succeed; it draws figures if it has a --format, or by `plots`."""

    def call(*arguments, plots=False):
        if arguments[0] in DRAWING and not plots and "--format" not in arguments:
            arguments = (arguments[0], "--format=none", *arguments[1:])
        result = dlgmd(*arguments)
        assert result.exit_code == 0, result.output
        return result

    return call
