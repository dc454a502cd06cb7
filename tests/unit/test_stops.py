"""Signals that ask the program to end are heard at any time, and never at the wrong moment."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from dlgmd_cli import stops
from dlgmd_cli.stops import STOPS, Stops, answer, interrupt

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals differ on Windows")

# Says 'ready' once signals are answered, which is the first thing that it does.
PROGRAM = """
import sys
import dlgmd_cli.__main__ as entry

def answer(handler, answer=entry.answer):
    answer(handler)
    print("ready", flush=True)

entry.answer = answer
sys.argv = ["dlgmd", "run", {clip!r}, "--no-plots"]
entry.main()
"""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.03, 0.06, 0.09, 0.12, 0.16, 0.2, 0.25, 0.3, 0.4])
def test_a_signal_while_the_program_starts(tmp_path, clips, number, delay_s):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(clip=str(clips / "loom.avi"))],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdout.readline() == "ready\n"
    threading.Event().wait(delay_s)
    process.send_signal(number)
    _, errors = process.communicate(timeout=60)
    assert process.returncode in (0, 130) and "Traceback" not in errors, errors
    assert "Error" not in errors
    for folder in tmp_path.glob("dlgmd-out"):
        assert os.listdir(folder) == ["loom"]


def test_a_signal_after_the_end_changes_nothing(tmp_path):
    program = (
        "import atexit, os, signal, sys\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
        "atexit.register(os.kill, os.getpid(), signal.SIGTERM)\n"
        "from dlgmd_cli.__main__ import main\n"
        "sys.argv = ['dlgmd', 'sets', 'show', '12']\n"
        "main()\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 2 and "Traceback" not in done.stderr


def test_a_thread_that_still_runs_does_not_outlive_the_command():
    program = (
        "import sys, threading, time\n"
        "from dlgmd_cli.__main__ import main\n"
        "threading.Thread(target=time.sleep, args=[3600]).start()\n"
        "sys.argv = ['dlgmd', 'sets']\n"
        "main()\n"
    )
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert done.returncode == 0 and "lgmd" in done.stdout.splitlines()[-2]


def interrupted(work):
    """What `work` had done when the interrupt came that it sent."""
    done = []
    with Stops(interrupt), pytest.raises(KeyboardInterrupt):
        work(done)
        threading.Event().wait(30)
    return done


class Place:
    def __init__(self, done, at):
        self.done, self.at = done, at

    def __enter__(self):
        self.tell("entered")

    def __exit__(self, *_):
        self.tell("left")

    def tell(self, what):
        if what == self.at:
            signal.raise_signal(signal.SIGTERM)
        self.done.append(what)


@pytest.mark.parametrize("at", ["entered", "left"])
def test_what_is_entered_is_left_whole(at):
    def work(done):
        with Place(done, at):
            threading.Event().wait(30 if at == "entered" else 0)

    assert interrupted(work) == ["entered", "left"]


def test_a_generator_may_be_interrupted_before_it_yields():
    @contextmanager
    def place(done):
        done.append("begun")
        signal.raise_signal(signal.SIGINT)
        done.append("made")
        yield

    def work(done):
        with place(done):
            done.append("entered")

    assert interrupted(work) == ["begun"]


@pytest.mark.parametrize(("file", "is_put_off"), [(contextlib.__file__, True), (__file__, False)])
def test_between_a_generator_and_its_with_a_signal_is_put_off(monkeypatch, file, is_put_off):
    monkeypatch.setattr(stops, "_send_later", lambda *_: None)
    code = SimpleNamespace(co_name="__init__", co_filename=file)
    assert stops.put_off(signal.SIGINT, SimpleNamespace(f_code=code, f_back=None)) is is_put_off


def test_an_import_is_not_broken_off(tmp_path, monkeypatch):
    (tmp_path / "interrupted_module.py").write_text(
        "import signal\nsignal.raise_signal(signal.SIGINT)\nwhole = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)

    def work(done):
        import interrupted_module

        done.append(interrupted_module.whole)

    assert interrupted(work) == [True]


def test_patience_ends(monkeypatch):
    monkeypatch.setattr(stops, "PATIENCE_S", 0.05)

    def work(done):
        class Endless:
            def __enter__(self):
                signal.raise_signal(signal.SIGHUP)
                threading.Event().wait(30)
                done.append("entered")

            def __exit__(self, *_):
                pass

        with Endless():
            pass

    assert interrupted(work) == []


def test_what_is_ignored_stays_ignored():
    with Stops(signal.SIG_DFL):
        signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup has it
        with Stops(interrupt):
            assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
            assert signal.getsignal(signal.SIGTERM) is interrupt
        assert signal.getsignal(signal.SIGTERM) is signal.SIG_DFL


def test_other_threads_change_nothing():
    before = [signal.getsignal(number) for number in STOPS]
    found = []
    thread = threading.Thread(target=lambda: found.append(answer(interrupt)))
    thread.start()
    thread.join()
    assert found == [{}] and [signal.getsignal(number) for number in STOPS] == before
