"""Sweeps that are interrupted, killed, or lose a process."""

import os
import signal
import sys

import numpy as np
import pytest
from conftest import looming_frames, until, write_video
from disturbed import session_of, started
from test_own_models import FAST, own  # noqa: F401

import dlgmd_cli

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="needs signals, and reads /proc"),
]

LONG = ["sweep", "--x", "sigma_e=0.2:2:0.05", "--y", "sigma_i=0.5:4.5:0.5", "--format=none"]


@pytest.mark.parametrize("kills", [False, True], ids=["interrupted", "killed"])
def test_an_ended_sweep_writes_nothing_and_leaves_no_process(tmp_path, kills):
    with started(*LONG, "--jobs", 2, cwd=tmp_path) as running:
        until(lambda: len(session_of(running.pid)) >= 3 or running.poll() is not None, 60)
        assert running.poll() is None, running.communicate()
        if kills:
            running.kill()
        else:
            os.killpg(running.pid, signal.SIGINT)  # as a terminal does
        _, errors = running.communicate(timeout=60)
        until(lambda: not session_of(running.pid), 30)
    assert kills or (running.returncode, errors) == (130, "Interrupted.\n")
    assert kills or not [*tmp_path.iterdir()]
    assert not [*tmp_path.rglob("sweep.*")]


def test_a_video_by_two_processes(runs, tmp_path):
    write_video(tmp_path / "loom.avi", looming_frames(40, 320, 240))
    grid = ["--x", "sigma_e=0.5:2:0.5", "--y", "ffi_gd=true,false", "--set", 9]
    for jobs in (1, 2):
        options = ["--jobs", jobs, "--out", f"out{jobs}"]
        runs("sweep", "loom.avi", *grid, *options)
    one, two = (np.genfromtxt(f"out{jobs}/sweep-loom/sweep.csv", delimiter=",") for jobs in (1, 2))
    assert np.array_equal(one, two, equal_nan=True)


def test_sweeps_and_batches_of_own_models(runs, clips, own, tmp_path):  # noqa: F811
    axes = ["--x", "floor=0.05:0.2:0.05", "--y", "n_sp=1,2", "--jobs", 2]
    runs("sweep", clips / "loom.avi", *FAST, *axes)
    rows = (tmp_path / "dlgmd-out/sweep-loom/sweep.csv").read_text().splitlines()
    assert len(rows) == 9 and rows[0].startswith("floor,n_sp,mp_max")
    (tmp_path / "videos").mkdir()
    for name in "ab":
        write_video(tmp_path / f"videos/{name}.avi", looming_frames())
    runs("batch", "videos", *FAST, "--set", 9, "--jobs", 2, "--out", "b")
    found = dlgmd_cli.read_result(tmp_path / "b/Fast/a")
    assert found.params == own.FastParameters() and found.summary["mp_max"] > 0
