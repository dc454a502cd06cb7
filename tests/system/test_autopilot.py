"""`dlgmd live --mavlink-brake` against a stand-in for an autopilot, each a process of its own."""

import re
import signal
import subprocess
import sys
import threading
from contextlib import contextmanager

import pytest
from conftest import free_port, until
from watching import PATIENCE_S, ROOT, fed, lines_of, live

from dlgmd_cli.models.stopping import MARGIN_S, Brake

pytest.importorskip("pymavlink", reason="pymavlink is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="there are no pseudo-terminals"),
]
PIPED = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "bufsize": 0}


class Flight:
    """The lines of the stand-in, the events of the watch, and ways to change things."""

    def __init__(self, pilot, watch):
        self.pilot, self.watch, self.log, self.events = pilot, watch, [], []
        self._logs = threading.Thread(target=self._keep, args=(self.log, pilot.stdout))
        self._watches = threading.Thread(target=self._keep, args=(self.events, lines_of(watch)))
        self._logs.start()
        self._watches.start()

    def _keep(self, kept, lines):
        for line in lines:
            kept.append(line.decode().strip() if isinstance(line, bytes) else line)

    def obey(self, *lines):
        """Change the autopilot; the log and the events begin anew."""
        self.log.clear()
        self.events.clear()
        self.pilot.stdin.write("".join(f"{line}\n" for line in lines).encode())

    def hears(self, pattern, n=1):
        """Wait until the log has so many lines like this."""
        until(lambda: sum(bool(re.search(pattern, one)) for one in [*self.log]) >= n, PATIENCE_S)

    def tells(self, event, **facts):
        """Wait for an event with these entries."""
        wanted = {"event": event} | facts
        until(lambda: any(wanted.items() <= one.items() for one in [*self.events]), PATIENCE_S)

    def count(self, event):
        return sum(one["event"] == event for one in self.events)

    def end(self):
        """End the watch; nothing but its last words comes."""
        self.watch.send_signal(signal.SIGTERM)
        assert self.watch.wait(PATIENCE_S) == 0
        self.hears("STATUSTEXT 4 dlgmd: the watch has ended")
        self.hears("HEARTBEAT state 7")
        self.pilot.stdin.close()
        self._logs.join()
        self._watches.join()


@contextmanager
def flying(kind, link, *options):
    """A watch with an autopilot at its other end."""
    port = free_port()
    place = {"serial": "pty", "udp": f"{port}", "udpin": f"udpout:{port}"}[link]
    command = [sys.executable, ROOT / "tests" / "autopilot.py", kind, place]
    with subprocess.Popen(command, **PIPED) as pilot:
        try:
            name = pilot.stdout.readline().decode().strip() if link == "serial" else ""
            url = {
                "serial": f"serial://{name}",
                "udp": f"udp://127.0.0.1:{port}",
                "udpin": f"udpin://{port}",
            }[link]
            arguments = ("-", "--input-size", "64x48", "--set", 3, "--fps", "all")
            mavlink = ("--mavlink", url, "--mavlink-brake", *options)
            mavlink += ("--jsonl", "--events")
            with live(*arguments, *mavlink, stdin=subprocess.PIPE, bufsize=0) as watch, fed(watch):
                yield Flight(pilot, watch)
        finally:
            pilot.kill()


MODES = {"copter": "BRAKE", "px4": "LOITER"}
BRAKES = {"copter": "COMMAND_LONG 176 try 0: 129 17 0", "px4": "COMMAND_LONG 176 try 0: 129 4 3"}


@pytest.mark.parametrize(
    ("kind", "link", "modes"),
    [
        ("copter", "serial", "GUIDED"),
        ("px4", "udpin", "mission"),
    ],
)
def test_what_makes_a_drone_brake(kind, link, modes):
    with flying(kind, link, "--mavlink-modes", modes) as flight:
        mode, brake = modes.upper(), MODES[kind]
        flight.hears("COMMAND_LONG 511: message 33 every 100000 us")
        flight.tells("brake-withheld", why="not armed")
        flight.hears("STATUSTEXT 2 dlgmd: collision alarm")
        flight.hears("COLLISION src 255 level 2")
        flight.hears("NAMED_VALUE_FLOAT mp from 1/196")
        flight.obey("speed 3.5", "arm")  # it accepts
        flight.hears(BRAKES[kind])
        flight.tells("brake", mode=brake, number=1)
        flight.tells("brake-answer", result="ACCEPTED", number=1)
        flight.tells("autopilot", mode=brake, armed=True)
        flight.tells("brake-confirmed", mode=brake, number=1)
        flight.hears(f"STATUSTEXT 2 dlgmd: braking .{brake}.")
        flight.tells("end", speed_m_s=3.5)
        flight.tells("brake-withheld", why=f"{brake} already")  # and no other command
        assert flight.count("brake") == 1
        flight.obey("refuse", f"mode {mode}")
        flight.tells("brake-answer", result="DENIED")
        flight.tells("brake-failed", mode=brake, number=10, why="DENIED")
        flight.hears("COMMAND_LONG 176 try 9")
        flight.hears("STATUSTEXT 2 dlgmd: BRAKE REFUSED: DENIED".replace("BRAKE", brake, 1))
        flight.end()


def test_the_threshold_follows_the_speed_of_the_autopilot():
    rule = ("--alarm", "ttc", "--speed-m-s", "autopilot", "--brake", "5", "--react", "0.4")
    needed_s = 0.4 + Brake.parse(5).distance_m(7.0) / 7.0
    with flying("copter", "udp", "--mavlink-modes", "GUIDED", *rule) as flight:
        flight.tells("begin", rule="ttc", ttc_alarm=1.25)
        flight.obey("speed 7")
        flight.tells("begin", rule="ttc", ttc_alarm=round(needed_s + MARGIN_S, 3))
        flight.end()


def test_the_threshold_follows_the_stop_that_the_autopilot_tells():
    rule = ("--alarm", "ttc", "--speed-m-s", "autopilot")
    needed_s = Brake.parse("arducopter:20").stop_s(9.0) + MARGIN_S
    with flying("copter", "udp", "--mavlink-modes", "GUIDED", *rule) as flight:
        flight.tells("autopilot", brake="arducopter:20", brake_by="PSC_JERK_XY")
        flight.obey("arm", "speed 9")
        flight.tells("begin", rule="ttc", ttc_alarm=round(needed_s, 3))
        flight.end()


def test_the_heading_of_the_autopilot_is_followed():
    with flying("copter", "udp", "--mavlink-modes", "GUIDED") as flight:
        flight.tells("heading", by="default", why="no attitude and velocity within 1 s")
        flight.obey("speed 2", "pitch -8")
        flight.tells("heading", by="autopilot", right_deg=0.0, up_deg=8.0)
        flight.end()


def test_every_frame_is_answered_in_order_and_no_command_goes_out():
    """Whatever comes over the link, though it speaks for the autopilot, whose speed counts."""
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
