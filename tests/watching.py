"""`dlgmd live` as a process, and the frames of a pipe that it watches."""

import json
import subprocess
import sys
import threading
from contextlib import contextmanager, suppress
from pathlib import Path

from conftest import looming_frames

ROOT = Path(__file__).parents[1]
PATIENCE_S = 300.0  # until something must have come about, however busy the machine is


@contextmanager
def live(*arguments, **options):
    """`dlgmd live` as a process, which is killed if a test fails, or waits too long."""
    command = [sys.executable, "-m", "dlgmd_cli", "live", *map(str, arguments)]
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "cwd": ROOT} | options
    with subprocess.Popen(command, **given) as process:
        watchdog = threading.Timer(PATIENCE_S, process.kill)
        watchdog.start()
        try:
            yield process
        finally:
            watchdog.cancel()
            process.kill()


def lines_of(process):
    """The JSON objects as they come."""
    return (json.loads(line) for line in process.stdout)


@contextmanager
def fed(process, size_wh=(64, 48)):
    """Write frames of an approach, again and again, to a process without a buffer."""
    frames = [frame.tobytes() for frame in looming_frames(50, *size_wh)]
    stop = threading.Event()

    def feed():
        number = 0
        with suppress(OSError):
            while not stop.wait(1 / 60):
                process.stdin.write(frames[number % 50])
                number += 1

    feeder = threading.Thread(target=feed)
    feeder.start()
    try:
        yield
    finally:
        stop.set()
        feeder.join()
        process.stdin.close()
