"""Sweeps that are interrupted, killed, or lose a process: no point that was done is lost."""

import os
import re
import signal
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner
from conftest import looming_frames, until, write_video
from disturbed import session_of, started
from test_own_models import FAST, own  # noqa: F401

import dlgmd_cli
from dlgmd_cli.commands.app import cli

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="needs signals, and reads /proc"),
]

CUBES = "dlgmd-out/sweep-translating-cubes"
LONG = ["sweep", "--x", "sigma_e=0.2:2:0.15", "--y", "sigma_i=0.5:4.5:2", "--format=none"]
N_POINTS = 13 * 3


def n_lines(folder=CUBES):
    path = Path(folder, "sweep.csv")
    return path.read_bytes().count(b"\n") if path.exists() else 0


def until_some_are_done(running):
    until(lambda: n_lines() > 30 or running.poll() is not None, 60)
    assert running.poll() is None, running.communicate()


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The table of the long sweep, computed by one process."""
    folder = tmp_path_factory.mktemp("undisturbed")
    result = CliRunner().invoke(cli, [*LONG, "--jobs", "1", "--out", str(folder)])
    assert result.exit_code == 0, result.output
    return (folder / "sweep-translating-cubes/sweep.csv").read_bytes()


def check_continues(runs, undisturbed, jobs):
    """The same command computes the rest, and the table is that of an undisturbed sweep."""
    assert yaml.safe_load(Path(CUBES, "sweep.yaml").read_text())["complete"] is False
    result = runs(*LONG, "--jobs", jobs)
    match = re.match(rf"(\d+) of {N_POINTS} points are already done\.", result.stderr)
    assert Path(CUBES, "sweep.csv").read_bytes() == undisturbed
    assert sorted(os.listdir(CUBES)) == ["sweep.csv", "sweep.yaml"]
    assert yaml.safe_load(Path(CUBES, "sweep.yaml").read_text())["complete"] is True
    return int(match[1])


def test_an_interrupted_sweep_continues(dlgmd, undisturbed):
    with started(*LONG, "--jobs", 2, cwd=".") as running:
        until_some_are_done(running)
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
    assert check_continues(dlgmd, undisturbed, 1) == int(match[1])


def test_a_killed_sweep_continues_and_leaves_no_process(dlgmd, undisturbed):
    with started(*LONG, "--jobs", 2, cwd=".") as running:
        until_some_are_done(running)
        assert len(session_of(running.pid)) >= 3
        running.kill()
        running.wait()
        until(lambda: not session_of(running.pid), 30)
    with Path(CUBES, "sweep.csv").open("ab") as table:
        table.write(b"2,4.5,1,-3.")
    assert check_continues(dlgmd, undisturbed, 2) > 6


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
