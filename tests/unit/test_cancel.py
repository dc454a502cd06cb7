"""The stop flag, in a process of its own: one signal asks, a second one ends."""

import signal
import subprocess
import sys

import pytest

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="signals differ on Windows")

PROGRAM = """
import time
from dlgmd_cli.machine import cancel
cancel.listen()
print("ready", flush=True)
while not cancel.requested():
    time.sleep(0.01)
print("asked", cancel.terminated(), flush=True)
time.sleep({rest})
try:
    cancel.check()
except cancel.Interrupted:
    print("stopped", flush=True)
"""


def start(rest, before=None):
    process = subprocess.Popen(
        [sys.executable, "-c", PROGRAM.format(rest=rest)],
        stdout=subprocess.PIPE,
        text=True,
        preexec_fn=before,
    )
    assert process.stdout.readline() == "ready\n"
    return process


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP"])
def test_one_signal_asks(name):
    process = start(0)
    process.send_signal(getattr(signal, name))
    said = f"asked {name != 'SIGINT'}\nstopped\n"
    assert process.communicate(timeout=20)[0] == said and process.returncode == 0


def test_a_second_one_ends():
    process = start(60)
    process.send_signal(signal.SIGINT)
    assert process.stdout.readline() == "asked False\n"
    process.send_signal(signal.SIGTERM)
    assert process.communicate(timeout=20)[0] == "" and process.returncode == 130


def test_nohup_works():
    process = start(0, lambda: signal.signal(signal.SIGHUP, signal.SIG_IGN))
    process.send_signal(signal.SIGHUP)
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.3)
    process.send_signal(signal.SIGINT)
    assert process.communicate(timeout=20)[0] == "asked False\nstopped\n"
