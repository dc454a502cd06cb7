"""Pipes, archives under other names, servers and folders that are gone: one line each."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import dlgmd_cli


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_is_no_log(dlgmd):
    os.mkfifo("log")
    # In a process of its own: where it is opened, the call never returns.
    root = str(Path(dlgmd_cli.__file__).parents[1])
    command = [sys.executable, "-m", "dlgmd_cli", "sets", "show", "9", "--log", "log"]
    environment = {"PYTHONPATH": root}
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=60)
    except subprocess.TimeoutExpired:
        pytest.fail("it waits for a reader")
    assert done.returncode == 1 and done.stderr == "Error: --log: log: is a pipe, not a file.\n"


@pytest.mark.parametrize("command", ["run", "info"])
def test_an_archive_of_arrays_is_no_array(dlgmd, tmp_path, command):
    np.savez(tmp_path / "a.npz", x=np.zeros((9, 8, 8), np.uint8))
    (tmp_path / "a.npz").rename("a.npy")
    result = dlgmd(command, "a.npy", "--input-fps", 30)
    assert result.exit_code == 1
    assert "a.npy: cannot be read (not an array of numbers in NumPy's format)" in result.stderr


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps the working folder")
def test_a_deleted_working_folder(tmp_path):
    root = str(Path(dlgmd_cli.__file__).parents[1])
    code = f"""
import os, sys
sys.path.insert(0, {root!r})
os.mkdir("gone"); os.chdir("gone"); os.rmdir("../gone")
from dlgmd_cli.__main__ import main
main()
"""
    for words in (["run", "x.mp4"], ["view", str(tmp_path)], ["sets"]):
        command = [sys.executable, "-c", code, *words]
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 2
        assert done.stderr.startswith("Error: the working folder is gone (")
        assert done.stderr.count("\n") == 1
