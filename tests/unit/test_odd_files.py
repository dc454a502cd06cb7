"""Pipes, archives under other names, servers and folders that are gone: one line each."""

import os
import socket
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from conftest import make_result

import dlgmd_cli


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_is_no_log(dlgmd):
    os.mkfifo("log")
    # In a process of its own: where it is opened, the call never returns.
    root = str(Path(dlgmd_cli.__file__).parents[1])
    command = [sys.executable, "-m", "dlgmd_cli", "sets", "show", "9", "--log", "log"]
    environment = {"PYTHONPATH": root, "DLGMD_SETTINGS": "none"}
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


@pytest.mark.filterwarnings("ignore::UserWarning")  # old universal-pathlib does not know FTP
def test_a_server_that_hangs_up(dlgmd, clips):
    pytest.importorskip("upath", reason="URLs need dlgmd[cluster]")
    with socket.create_server(("127.0.0.1", 0)) as server:

        def hang_up():
            while True:
                try:
                    server.accept()[0].close()
                except OSError:
                    return

        threading.Thread(target=hang_up, daemon=True).start()
        url = f"ftp://127.0.0.1:{server.getsockname()[1]}/x"
        result = dlgmd("batch", clips, "--out", url, "--format=none", "--jobs", 1)
        server.shutdown(socket.SHUT_RDWR)
    assert result.exit_code == 1 and "cannot be reached" in result.stderr.splitlines()[-1]


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


@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere, names are text")
def test_a_name_that_is_no_text_has_its_page(runs, tmp_path):
    for name in (b"bad\xff", b"good"):
        result = make_result(np.linspace(0, 500, 60))
        result.record["input"]["path"] = f"/videos/{os.fsdecode(name)}.mp4"
        result.save(tmp_path / "res" / os.fsdecode(name))
    runs("view", "res", "--no-film", "--out", "all.html")
    pages = {"bad-udcff.mp4.html", "good.mp4.html"}
    assert pages <= {path.name for path in (tmp_path / "all-pages").iterdir()}
    assert all(f"all-pages/{page}" in (tmp_path / "all.html").read_text() for page in pages)
    runs("view", Path("res") / os.fsdecode(b"bad\xff"), "--no-film")
    assert (tmp_path / "dlgmd-out/view-bad-udcff.html").exists()
