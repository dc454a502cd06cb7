"""`dlgmd live` as a service: what it tells systemd, and that a frozen one is ended."""

import os
import signal
import socket
import subprocess
import time

import pytest
from conftest import looming_frames
from watching import PATIENCE_S, fed, live

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not hasattr(socket, "AF_UNIX"), reason="systemd is Linux's"),
]
LIMIT_S = 2.0
FROZEN = '''"""A model that hangs at its 180th frame, after 3 s."""

import time

from dlgmd_cli import DLGMD


class Frozen(DLGMD):
    n_steps = 0

    def step(self, *given, **more):
        self.n_steps += 1
        if self.n_steps == 180:
            time.sleep(1000)
        return super().step(*given, **more)
'''


class Systemd:
    """A stand-in for systemd: takes messages, and kills what shows no sign of life in time."""

    def __init__(self, folder):
        self.listener = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.listener.bind(str(folder / "notify"))
        self.log, self._begin_s = [], time.monotonic()
        self.env = {**os.environ, "NOTIFY_SOCKET": str(folder / "notify")}
        self.env["WATCHDOG_USEC"] = str(int(1e6 * LIMIT_S))
        self.env["PYTHONPATH"] = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])

    def next(self, patience_s):
        """The next message; empty if none comes in time."""
        self.listener.settimeout(patience_s)
        try:
            text = self.listener.recv(4096).decode()
        except TimeoutError:
            text = ""
        self.log.append(f"{time.monotonic() - self._begin_s:6.2f} {text or 'nothing: killed'}")
        return text

    def watch(self, process, seconds):
        """Watch over a process for some time; whether it was killed."""
        end_s = alive_s = time.monotonic()
        end_s += seconds
        while time.monotonic() < end_s:
            left_s = alive_s + LIMIT_S - time.monotonic()
            text = self.next(max(left_s, 0.01))
            if text == "WATCHDOG=1":
                alive_s = time.monotonic()
            elif not text:
                process.kill()
                return True
        return False


@pytest.fixture
def systemd(tmp_path):
    manager = Systemd(tmp_path)
    yield manager
    manager.listener.close()


ARGUMENTS = ("-", "--input-size", "64x48", "--fps", "all")


def test_a_frozen_watch_is_ended(tmp_path, systemd):
    (tmp_path / "frozen.py").write_text(FROZEN)
    more = {"stdin": subprocess.PIPE, "bufsize": 0}
    options = ("--model", "frozen:Frozen", "--alarm", "spikes")
    with live(*ARGUMENTS, *options, env=systemd.env, **more) as process, fed(process):
        assert systemd.next(PATIENCE_S) == "READY=1"
        assert systemd.watch(process, PATIENCE_S) and process.wait(PATIENCE_S) == -9
    told = "\n".join(systemd.log)
    print(told)
    assert "WATCHDOG=1" in told and "STATUS=" in told and "frames/s" in told and "nan" not in told


def test_a_silent_source_is_no_frozen_watch(systemd):
    """What is lost was said; then signs of life go on. The end is told, too."""
    more = {"stdin": subprocess.PIPE, "bufsize": 0, "env": systemd.env}
    with live(*ARGUMENTS, **more) as process:
        for frame in looming_frames(30, 64, 48):
            process.stdin.write(frame.tobytes())
            time.sleep(1 / 30)
        assert systemd.next(PATIENCE_S) == "READY=1"
        assert not systemd.watch(process, 3.0 * LIMIT_S)
        process.send_signal(signal.SIGTERM)
        assert process.wait(PATIENCE_S) == 0
        while systemd.next(LIMIT_S) != "STOPPING=1":
            assert systemd.log[-1][7:] != "nothing: killed"
    assert any("STATUS=blind: lost" in line for line in systemd.log)
