"""What comes over the link neither ends nor delays the watch, and sends no command."""

import subprocess

import numpy as np
import pytest
from conftest import free_port
from watching import PATIENCE_S, fed, lines_of, live

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
from fuzzer import datagrams
from linked import N_DATAGRAMS, alarms, fuzzing

pytestmark = pytest.mark.slow
SEEDS, LATER_S = (1, 2), 0.05


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
