"""Sweeps that are interrupted, killed, or lose a process: no point that was done is lost."""

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import yaml
from conftest import looming_frames, write_video

import dlgmd_cli

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="needs signals, and reads /proc"),
]

CUBES = "dlgmd-out/sweep-translating-cubes"
LONG = ["sweep", "--x", "sigma_e=0.2:2:0.1", "--y", "sigma_i=0.5:6:0.25", "--no-plots"]
N_POINTS = 19 * 23


def process(*arguments):
    root = Path(dlgmd_cli.__file__).parents[1]
    return subprocess.Popen(
        [sys.executable, "-m", "dlgmd_cli", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(root)},
        start_new_session=True,
    )


def n_lines(folder=CUBES):
    path = Path(folder, "sweep.csv")
    return path.read_bytes().count(b"\n") if path.exists() else 0


def until(condition, running):
    deadline = time.monotonic() + 60
    while not condition() and running.poll() is None and time.monotonic() < deadline:
        time.sleep(0.005)
    assert running.poll() is None, running.communicate()


def children_of(pid):
    """The processes that another one started."""
    files = Path(f"/proc/{pid}/task").glob("*/children")
    return [int(child) for file in files for child in file.read_text().split()]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The table of the long sweep, computed by one process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    done = process(*LONG, "--jobs", 1, "--out", folder)
    _, errors = done.communicate(timeout=300)
    assert done.returncode == 0, errors
    return (folder / "sweep-translating-cubes/sweep.csv").read_bytes()


def check_continues(dlgmd, undisturbed, jobs):
    """The same command computes the rest, and the table is that of an undisturbed sweep."""
    assert yaml.safe_load(Path(CUBES, "sweep.yaml").read_text())["complete"] is False
    result = dlgmd(*LONG, "--jobs", jobs)
    assert result.exit_code == 0, result.output
    match = re.match(rf"(\d+) of {N_POINTS} points are already done\.", result.stderr)
    assert Path(CUBES, "sweep.csv").read_bytes() == undisturbed
    assert sorted(os.listdir(CUBES)) == ["sweep.csv", "sweep.yaml"]
    assert yaml.safe_load(Path(CUBES, "sweep.yaml").read_text())["complete"] is True
    return int(match[1])


@pytest.mark.parametrize("jobs", [1, 2])
def test_an_interrupted_sweep_continues(dlgmd, undisturbed, jobs):
    running = process(*LONG, "--jobs", jobs)
    until(lambda: n_lines() > 30, running)
    os.killpg(running.pid, signal.SIGINT)  # as a terminal does
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 130, errors
    match = re.fullmatch(
        rf"\S+sweep-translating-cubes holds (\d+) of {N_POINTS} points; "
        r"the same command continues from there\.\nInterrupted\.\n",
        errors,
    )
    assert match, errors
    assert n_lines() == 1 + 4 * int(match[1])
    assert check_continues(dlgmd, undisturbed, 3 - jobs) == int(match[1])


def test_a_killed_sweep_continues_and_leaves_no_process(dlgmd, undisturbed):
    running = process(*LONG, "--jobs", 2)
    until(lambda: n_lines() > 30, running)
    children = children_of(running.pid)
    running.kill()
    running.communicate(timeout=60)
    assert len(children) >= 2
    with Path(CUBES, "sweep.csv").open("ab") as table:
        table.write(b"2,6,1,-3.")
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in children) and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not any(Path(f"/proc/{pid}").exists() for pid in children)
    assert check_continues(dlgmd, undisturbed, 2) > 6


def test_a_process_that_is_killed_loses_no_point_that_was_done(dlgmd, undisturbed):
    running = process(*LONG, "--jobs", 2)
    until(lambda: n_lines() > 30, running)
    # Amid its task: one that is killed while it takes a task leaves the pool's lock taken.
    time.sleep(0.05)
    for pid in children_of(running.pid):
        command = Path(f"/proc/{pid}/cmdline").read_bytes()
        if b"spawn_main" in command:
            os.kill(pid, signal.SIGKILL)
            break
    _, errors = running.communicate(timeout=60)
    assert running.returncode == 1, errors
    kept, error = errors.splitlines()
    assert re.fullmatch(rf"\S+ holds \d+ of {N_POINTS} points; the same .* from there\.", kept)
    assert error == (
        "Error: a point of the grid: its process was killed, as happens when memory runs out. "
        "Use fewer --jobs."
    )
    check_continues(dlgmd, undisturbed, 2)


@pytest.mark.parametrize("engine", ["opencv", "numba"])
def test_a_video_by_two_processes(dlgmd, tmp_path, engine):
    if engine == "numba":
        pytest.importorskip("numba", reason="the numba engine needs numba")
    write_video(tmp_path / "loom.avi", looming_frames(120, 320, 240))
    grid = ["--x", "sigma_e=0.5:2:0.5", "--y", "ffi_gd=true,false", "--set", 9, "--engine", engine]
    for jobs in (1, 2):
        options = ["--jobs", jobs, "--out", f"out{jobs}", "--no-plots"]
        result = dlgmd("sweep", "loom.avi", *grid, *options)
        assert result.exit_code == 0, result.output
    one, two = (np.genfromtxt(f"out{jobs}/sweep-loom/sweep.csv", delimiter=",") for jobs in (1, 2))
    # The order in which Numba adds up depends on the number of threads.
    assert np.allclose(one, two, rtol=1e-6 if engine == "numba" else 0.0, equal_nan=True)
