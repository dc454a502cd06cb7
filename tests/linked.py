"""A watch over MAVLink, an autopilot at its other end, and an attacker, each a process."""

import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
from conftest import free_port, until
from watching import PATIENCE_S, ROOT

from dlgmd_cli.frame import Frame
from dlgmd_cli.live import mavlink, outputs
from dlgmd_cli.live.reports import Reports
from dlgmd_cli.live.watch import Answer
from dlgmd_cli.models.alarm import Alarm

PIPED = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
N_DATAGRAMS = 2500
UNDEFINED = Alarm().step(np.zeros((9, 9), np.uint8))


def fuzzing(port, seed, *source):
    """A process that sends the datagrams; its output ends when it is done."""
    command = [sys.executable, ROOT / "tests" / "fuzzer.py", port, N_DATAGRAMS, seed, *source]
    return subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE)


def alarms(seed):
    """The commands that an autopilot receives in four alarms, and when each one began.

    With a seed, datagrams come from another address meanwhile.
    """
    port, began_s, arrived = free_port(), [], []
    command = [sys.executable, ROOT / "tests" / "autopilot.py", "copter", f"udpout:{port}"]
    watch = mavlink.Mavlink(f"udpin://127.0.0.1:{port}", Reports(), modes=["GUIDED"])
    send = watch._link.write

    def noted(data, places):
        if watch._towards is not None:
            arrived.append((time.monotonic(), [*places], bytes(data[10:-2])))  # without its number
        send(data, places)

    watch._link.write = noted
    receiver = outputs.Receiver("mavlink", watch)
    with ExitStack() as stack:
        stack.callback(outputs.finish, [receiver])
        pilot = stack.enter_context(subprocess.Popen([*map(str, command)], **PIPED))
        stack.callback(pilot.kill)
        fuzz = None if seed is None else stack.enter_context(fuzzing(port, seed))
        pilot.stdin.write(b"arm\n")
        until(lambda: watch._pilot.is_armed, PATIENCE_S)
        for number in range(120):
            if number % 30 == 29:
                pilot.stdin.write(b"mode GUIDED\n")
            event = {0: "begin", 20: "end"}.get(number % 30, "")
            now_s, is_on = time.monotonic(), number % 30 < 20
            began_s += [now_s] if event == "begin" else []
            frame = Frame(number, number / 30, np.zeros((9, 9)), captured_s=now_s)
            detection = replace(UNDEFINED, alarm=is_on)
            receiver.put(Answer(frame, detection, event=event, latency_ms=1.0))
            time.sleep(0.1)
        assert fuzz is None or fuzz.wait(PATIENCE_S) == 0
    return began_s, arrived
