"""A flood of connections to the page of `dlgmd live`: no alarm is lost, and none comes late."""

import json
import os
import socket
import sys
import time
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
from conftest import free_port
from watching import PATIENCE_S, ROOT, lines_of, live

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(not sys.platform.startswith("linux"), reason="counts sockets in /proc"),
]
pytest.importorskip("uvicorn", reason="the page needs Uvicorn")
names = pytest.importorskip("pymavlink.dialects.v20.ardupilotmega", reason="needs pymavlink")

SAMPLE = ROOT / "sample_videos" / "group2.mp4"
N_IDLE = 1200
ASKS = [b"", b"", b"GET / HT", b"GET /events HTTP/1.1\r\nHost: localhost\r\n\r\n"]


def few_descriptors():
    import resource

    resource.setrlimit(resource.RLIMIT_NOFILE, (1024, 1024))


def n_clients(pid, port):
    """How many sockets of a process are connections to its port."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    inodes = {row[9] for row in rows if row[1].endswith(f":{port:04X}") and row[3] != "0A"}
    links = []
    for link in Path(f"/proc/{pid}/fd").iterdir():
        try:
            links.append(os.readlink(link))
        except FileNotFoundError:
            continue
    return sum(link[8:-1] in inodes for link in links if link.startswith("socket:["))


def next_alarm(lines):
    """The latencies until the next alarm, and the alarm."""
    latencies_ms = []
    for one in lines:
        if one["latency_ms"] is not None:
            latencies_ms.append(one["latency_ms"])
        if one.get("event") == "begin":
            return latencies_ms, one
    raise AssertionError("no alarm")


@pytest.fixture
def many_descriptors():
    import resource

    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    if 0 <= hard < N_IDLE + 300:
        pytest.skip("this system allows too few connections")
    resource.setrlimit(resource.RLIMIT_NOFILE, (N_IDLE + 300, hard))
    yield
    resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


def hear(pilot, parser, texts):
    """Take what has come to the autopilot; its buffer holds the messages of a few seconds."""
    with suppress(BlockingIOError):
        while True:
            for message in parser.parse_buffer(pilot.recv(4096, socket.MSG_DONTWAIT)) or ():
                texts += [message.text] if message.get_type() == "STATUSTEXT" else []


def test_a_flood_of_connections_starves_nothing(tmp_path, many_descriptors):
    """Idle, half a request, and clients that never read; an alarm reaches hook and autopilot."""
    hook, said, port = tmp_path / "hook.sh", tmp_path / "said", free_port()
    hook.write_text(f'#!/bin/sh\necho "$DLGMD_EVENT $DLGMD_FRAME" >> {said}\n')
    hook.chmod(0o755)
    with ExitStack() as stack:
        pilot = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        pilot.bind(("127.0.0.1", 0))
        options = ("--realtime", "--loop", "--jsonl", "--serve", port, "--exec", hook)
        options += ("--mavlink", f"udp://127.0.0.1:{pilot.getsockname()[1]}")
        options += ("--record", tmp_path / "r", "--keep-last", 1)
        log = stack.enter_context(open(tmp_path / "log", "wb"))
        process = stack.enter_context(
            live(SAMPLE, *options, stderr=log, preexec_fn=few_descriptors)
        )
        lines = lines_of(process)
        before_ms, _ = next_alarm(lines)
        clients, most = [], 0
        for number in range(N_IDLE):
            one = stack.enter_context(socket.socket())
            one.setblocking(False)
            one.connect_ex(("127.0.0.1", port))
            clients.append(one)
            if number % 50 == 0:
                most = max(most, n_clients(process.pid, port))
        for number, one in enumerate(clients):
            with suppress(OSError):  # not yet accepted, or ended
                one.send(ASKS[number % len(ASKS)])
        parser, texts = names.MAVLink(None), []
        parser.robust_parsing = True
        latencies_ms, events = [], []
        end = time.monotonic() + 12.0
        while time.monotonic() < end:
            found_ms, began = next_alarm(lines)
            latencies_ms += found_ms
            events.append(began["frame"])
            most = max(most, n_clients(process.pid, port))
            hear(pilot, parser, texts)
        assert len(events) >= 2 and 0 < most <= 64
        until_s = time.monotonic() + PATIENCE_S
        while f"begin {events[-1]}\n" not in said.read_text():
            assert time.monotonic() < until_s
        while sum("collision alarm (" in text for text in texts) <= len(events):
            assert time.monotonic() < until_s
            hear(pilot, parser, texts)
        process.terminate()
        assert process.wait(PATIENCE_S) == 0
    told = (tmp_path / "log").read_text()
    assert "Too many open files" not in told and "Traceback" not in told
    assert len(list((tmp_path / "r").glob("alarm-*/run.yaml"))) > len(events)
    high_ms = [float(np.percentile(some, 99)) for some in (before_ms, latencies_ms)]
    print(json.dumps({"sockets": most, "p99_ms": high_ms, "alarms": events}))
    assert "is too slow" not in told  # what a latency is depends on what else the machine does
