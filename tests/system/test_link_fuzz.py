"""What comes over the link neither ends nor delays the watch, and sends no command."""

import subprocess
import sys

import pytest
from conftest import free_port
from watching import PATIENCE_S, ROOT, fed, lines_of, live

pytest.importorskip("pymavlink", reason="pymavlink is not installed")

pytestmark = pytest.mark.slow


def test_every_frame_is_answered_in_order_and_no_command_goes_out():
    """Though the datagrams speak for the autopilot, and its speed sets the threshold."""
    port, received = free_port(), []
    options = ("--input-size", "64x48", "--lockstep", "--jsonl", "--alarm", "ttc")
    link = ("--mavlink", f"udpin://127.0.0.1:{port}", "--mavlink-brake", "--mavlink-modes", "AUTO")
    speed = ("--speed-m-s", "autopilot")
    with live("-", *options, *link, *speed, stdin=subprocess.PIPE, bufsize=0) as watch, fed(watch):
        lines = lines_of(watch)
        received.append(next(lines))
        command = [sys.executable, str(ROOT / "tests/fuzzer.py"), str(port), "2500", "1"]
        with subprocess.Popen(command, stdout=subprocess.PIPE) as fuzz:
            while fuzz.poll() is None:
                received.append(next(lines))
        received += [next(lines) for _ in range(30)]
        watch.terminate()
        received += [*lines]
        assert watch.wait(PATIENCE_S) == 0
        words = watch.stderr.read().decode()
    frames = [one["frame"] for one in received if one["latency_ms"] is not None]
    assert frames == [*range(len(frames))] and len(frames) > 100 and "dropped: 0" in words
    assert not [one for one in received if one.get("event") == "brake"]
    assert "internal error" not in words and "Traceback" not in words
