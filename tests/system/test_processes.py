"""The command as a process: its streams, its working folder, and what it imports."""

import os
import subprocess
import sys

import pytest
from disturbed import environment

from dlgmd_cli.video.writer import best_codec


def python(*words, **options):
    """What a process of Python says; `words` follow its name."""
    options = {"capture_output": True, "encoding": "utf-8"} | options
    return subprocess.run([sys.executable, *words], **options)


def test_a_closed_stdout_is_no_traceback():
    command = f'"{sys.executable}" -m dlgmd_cli sets | head -1'
    done = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not os.path.exists("/proc/self/fd"), reason="no /proc here")
def test_closed_streams_are_not_taken_by_files():
    program = (
        "import os, sys\n"
        "from dlgmd_cli.commands import app\n"
        "app.cli = lambda **_: None\n"
        "app.main()\n"
        "names = [os.readlink(f'/proc/self/fd/{fd}') for fd in range(3)]\n"
        "sys.exit(names != ['/dev/null'] * 3)\n"
    )
    command = f"'{sys.executable}' -c \"{program}\" <&- >&- 2>&-"
    assert subprocess.run(["sh", "-c", command]).returncode == 0


@pytest.mark.parametrize("arguments", [["sets"], ["sets", "show", "9"], ["--help"]])
def test_an_encoding_without_greek_is_no_error(arguments):
    environment = {**os.environ, "PYTHONIOENCODING": "cp1252"}
    done = python("-m", "dlgmd_cli", *arguments, env=environment, encoding="cp1252")
    assert done.returncode == 0 and done.stderr == ""


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
@pytest.mark.parametrize("word", ["sets", "--help", "--version"])
def test_a_full_stdout_is_one_line(word):
    with open("/dev/full", "w") as full:
        streams = {"capture_output": False, "stdout": full, "stderr": subprocess.PIPE}
        done = python("-m", "dlgmd_cli", word, **streams)
    assert done.returncode == 1 and done.stderr.count("\n") == 1
    assert "the output cannot be written" in done.stderr


def test_an_interrupt_before_signals_are_answered_is_quiet():
    program = """
import sys
class Interrupting:
    def find_spec(self, name, *_):
        if name == "dlgmd_cli.machine.cancel":
            raise KeyboardInterrupt
sys.meta_path.insert(0, Interrupting())
from dlgmd_cli.__main__ import main
assert not {"logging", "typing", "signal", "dlgmd_cli.errors"} & set(sys.modules)
main()
"""
    done = python("-S", "-c", program)
    assert (done.returncode, done.stderr) == (130, "")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="Windows has no such pipes")
def test_a_pipe_is_no_log(tmp_path):
    os.mkfifo(tmp_path / "log")
    words = ["-m", "dlgmd_cli", "sets", "show", "9", "--log", "log"]
    done = python(*words, cwd=tmp_path, env=environment(), timeout=60)  # it waits for no reader
    assert done.returncode == 1 and done.stderr == "Error: --log: log: is a pipe, not a file.\n"


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps the working folder")
def test_a_deleted_working_folder(tmp_path):
    program = """
import os
os.mkdir("gone"); os.chdir("gone"); os.rmdir("../gone")
from dlgmd_cli.__main__ import main
main()
"""
    for words in (["run", "x.mp4"], ["view", str(tmp_path)], ["sets"]):
        done = python("-c", program, *words, cwd=tmp_path, env=environment())
        assert done.returncode == 2
        assert done.stderr.startswith("Error: the working folder is gone (")
        assert done.stderr.count("\n") == 1


def test_the_library_is_light_and_needs_no_click():
    program = """
import sys, dlgmd_cli
assert not {"numpy", "cv2", "yaml", "dlgmd_cli.tasks"} & set(sys.modules)
for name in dlgmd_cli.__all__:
    assert callable(getattr(dlgmd_cli, name)), name
heavy = {"click", "rich", "matplotlib", "optuna", "distributed"} & set(sys.modules)
assert not heavy, heavy
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as POSIX has it")
def test_a_full_disk_is_noticed(tmp_path):
    codecs = ["mpeg4", "h264"] if best_codec() == "h264" else ["mpeg4"]
    script = f"""
import resource
from pathlib import Path
import numpy as np
from dlgmd_cli.errors import OutputError
from dlgmd_cli.video.writer import video_writer
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
rng = np.random.default_rng(1)
path = Path("x.mp4")
for codec in {codecs!r}:
    try:
        with video_writer(path, (240, 320), 30.0, codec=codec, is_colour=True) as put:
            for _ in range(10):
                put(rng.integers(0, 255, (240, 320, 3), dtype=np.uint8))
    except OutputError as error:
        print("noticed", error, path.exists())
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True
    )
    lines = done.stdout.splitlines()
    assert len(lines) == len(codecs), done.stderr
    assert all(line.startswith("noticed x.mp4: ") and line.endswith("False") for line in lines)
