"""What comes over the link neither ends nor delays the watch, and sends no command."""

import subprocess
import sys
import time
from contextlib import ExitStack
from dataclasses import replace

import numpy as np
import pytest
from conftest import free_port, until
from fuzzer import datagrams
from watching import PATIENCE_S, ROOT, fed, lines_of, live

from dlgmd_cli.frame import Frame
from dlgmd_cli.live.watch import Answer, Reports
from dlgmd_cli.models.alarm import Alarm

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from dlgmd_cli.live import mavlink, outputs

pytestmark = pytest.mark.slow
PIPED = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}
N_DATAGRAMS, SEEDS, LATER_S = 2500, (1, 2), 0.05
UNDEFINED = Alarm().step(np.zeros((9, 9), np.uint8))


def fuzzing(port, seed, *source):
    """A process that sends the datagrams; its output ends when it is done."""
    command = [sys.executable, ROOT / "tests" / "fuzzer.py", port, N_DATAGRAMS, seed, *source]
    return subprocess.Popen([*map(str, command)], stdout=subprocess.PIPE)


def test_the_datagrams_are_valid_and_damaged_frames():
    from pymavlink.dialects.v20 import ardupilotmega as names

    parser, kinds = names.MAVLink(None), set()
    parser.robust_parsing = True
    for data in datagrams(N_DATAGRAMS, 3):
        kinds |= {message.get_type() for message in parser.parse_buffer(data) or ()}
    assert len(kinds) > 100 and "BAD_DATA" in kinds


@pytest.mark.parametrize("seed", SEEDS)
def test_every_frame_is_answered_in_order_and_no_command_goes_out(seed):
    """Though the datagrams speak for the autopilot, and its speed sets the threshold."""
    port, received = free_port(), []
    options = ("--input-size", "64x48", "--lockstep", "--jsonl", "--alarm", "ttc")
    link = ("--mavlink", f"udpin://127.0.0.1:{port}", "--mavlink-brake", "--mavlink-modes", "AUTO")
    speed = ("--speed-m-s", "autopilot")
    with live("-", *options, *link, *speed, stdin=subprocess.PIPE, bufsize=0) as watch, fed(watch):
        lines = lines_of(watch)
        received.append(next(lines))
        with fuzzing(port, seed, 1, 1) as fuzz:
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


def test_the_commands_are_those_without_the_datagrams():
    """To the same address, and at most 50 ms later (the median, as other tests run beside this)."""
    found = []
    for seed in (None, *SEEDS):
        began_s, arrived = alarms(seed)
        modes = [one for one in arrived if one[2][28:30] == b"\xb0\x00"]
        delays_s = [min(t - b for b in began_s if t >= b) for t, *_ in modes]
        assert {len(places) for _, places, _ in arrived} == {1}
        found.append(([data for *_, data in modes], delays_s))
    (commands, delays_s), *others = found
    assert len(commands) == 4
    for fuzzed, later_s in others:
        assert fuzzed == commands
        assert np.median(np.subtract(later_s, delays_s)) <= LATER_S
