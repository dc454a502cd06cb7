"""`dlgmd live` as a process: streams, overload, Ctrl-C at any moment, and memory."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from conftest import looming_frames

from dlgmd_cli import read_result

ROOT = Path(__file__).parents[2]
SAMPLE = ROOT / "sample_videos" / "group2.mp4"
PATIENCE_S = 60.0
# A second on a machine of its own; these tests share theirs.
AT_ONCE_S = 2.0
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="signals differ there"),
]


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


@contextmanager
def streaming(port, path=SAMPLE):
    """The sample over UDP, for ever."""
    pytest.importorskip("av", reason="PyAV is not installed")
    url = f"udp://127.0.0.1:{port}?pkt_size=1316"
    command = [sys.executable, ROOT / "tests" / "streamer.py", path, url]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as one:
        one.bind(("127.0.0.1", 0))
        return one.getsockname()[1]


def interrupt(process):
    """Press Ctrl-C once; seconds until the process has ended, and its exit code."""
    process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    return process.wait(PATIENCE_S), time.monotonic() - begin


def lines_of(process):
    """The JSON objects as they come."""
    return (json.loads(line) for line in process.stdout)


def until_listening(process, text=b"trying again"):
    while text not in process.stderr.readline():
        assert process.poll() is None


@pytest.mark.parametrize("scheme", ["udp", "rtsp", "http"])
def test_ctrl_c_ends_the_wait_for_a_stream_within_a_second(scheme):
    """From a server that takes the connection and says nothing, or, over UDP, from nobody."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        live(
            f"{scheme}://127.0.0.1:{server.getsockname()[1]}/x", stdout=subprocess.DEVNULL
        ) as process,
    ):
        time.sleep(2.0)
        code, seconds = interrupt(process)
        assert code == 130 and seconds < AT_ONCE_S
        assert b"Interrupted." in process.stderr.read()


def test_ctrl_c_ends_a_silent_pipe_within_a_second():
    read_end, write_end = os.pipe()
    arguments = ("-", "--input-size", "64x48", "--jsonl")
    with os.fdopen(write_end, "wb") as writer, live(*arguments, stdin=read_end) as process:
        os.close(read_end)
        writer.write(bytes(64 * 48))
        writer.flush()
        assert next(lines_of(process))["frame"] == 0
        code, seconds = interrupt(process)
        assert code == 130 and seconds < AT_ONCE_S


def test_ctrl_c_ends_a_command_that_nobody_listens_to_within_a_second():
    """Neither a full pipe at stdout nor a program that hangs keeps it from answering or ending."""
    read_end, write_end = os.pipe()
    arguments = ("-", "--input-size", "64x48", "--jsonl", "--fps", "all", "--exec", "sleep 5")
    with os.fdopen(write_end, "wb") as writer, live(*arguments, stdin=read_end) as process:
        os.close(read_end)
        frames = looming_frames(64, 64, 48)
        for number in range(1500):  # 230 kB of JSON
            writer.write(frames[number % 64].tobytes())
            writer.flush()
            time.sleep(0.001)
        until_listening(process, b"answers are dropped")
        code, seconds = interrupt(process)
        assert code == 130 and seconds < AT_ONCE_S


def test_a_stream_over_udp(tmp_path):
    """Alarms come, a receiver hears them, and the stream may go and come back."""
    port, heard = free_port(), free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", heard))
        receiver.settimeout(PATIENCE_S)
        arguments = ("--jsonl", "--events", "--udp", f"127.0.0.1:{heard}", "--record", tmp_path)
        with live(f"udp://127.0.0.1:{port}", *arguments, "--overwrite") as process:
            lines = lines_of(process)
            with streaming(port):
                began = next(one for one in lines if one["event"] == "begin")
                assert json.loads(receiver.recv(4096)) == began
                assert 0.0 < began["latency_ms"] < 250.0 and abs(began["g_x"]) < 0.5
            until_listening(process)
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
                for _ in range(200):
                    sender.sendto(os.urandom(1316), ("127.0.0.1", port))
                    time.sleep(0.005)
            with streaming(port):
                again = next(one for one in lines if one["event"] == "begin")
                assert again["frame"] > began["frame"]
                code, seconds = interrupt(process)
            assert code == 130 and seconds < AT_ONCE_S
    result = read_result(tmp_path)
    assert result.record["complete"] and result.summary["alarms"] >= 2
    assert again["frame"] in result.frame


def test_a_slow_model_drops_frames_and_never_falls_behind():
    """Frames of 720p come as fast as the pipe takes them; set 9 at full size is slower."""
    width, height, n_frames = 1280, 720, 400
    frames = [np.random.default_rng(n).integers(0, 255, (height, width), np.uint8) for n in (1, 2)]
    arguments = ("-", "--input-size", f"{width}x{height}", "--scale", 1, "--fps", "all", "--jsonl")
    with live(*arguments, "--set", 9, "--engine", "opencv", stdin=subprocess.PIPE) as process:

        def feed():
            for number in range(n_frames):
                process.stdin.write(frames[number % 2].tobytes())
            process.stdin.close()

        feeder = threading.Thread(target=feed)
        feeder.start()
        found = list(lines_of(process))
        feeder.join()
        told = process.stderr.read().decode()
        assert process.wait() == 0
    dropped = int(told.split("dropped: ")[1].split(";")[0])
    assert dropped > 0 and len(found) + dropped == n_frames and found[-1]["frame"] == n_frames - 1
    # Of a queue of frames, the last would be late by all of the time that was lost: seconds.
    assert np.median([one["latency_ms"] for one in found[-20:]]) < 500.0


def test_memory_does_not_grow(tmp_path):
    n_frames, n_early = 12_000, 3_000
    frames = [frame.tobytes() for frame in looming_frames(50, 64, 48)]
    arguments = ("-", "--input-size", "64x48", "--fps", "all", "--jsonl", "--record", tmp_path)
    with live(*arguments, "--overwrite", stdin=subprocess.PIPE) as process:

        def resident_kb():
            text = Path(f"/proc/{process.pid}/status").read_text()
            return int(text.split("VmRSS:")[1].split()[0])

        if not Path(f"/proc/{process.pid}/status").exists():
            pytest.skip("this system does not tell how much memory a process has")
        reader = threading.Thread(target=process.stdout.read)
        reader.start()
        for number in range(n_frames):
            process.stdin.write(frames[number % 50])
            process.stdin.flush()
            time.sleep(0.001)  # so that most frames are answered, unless the machine is busy
            if number == n_early:
                early_kb = resident_kb()
        late_kb = resident_kb()
        process.stdin.close()
        reader.join()
        assert process.wait() == 0
    n_rows = len(read_result(tmp_path))
    assert n_rows > n_frames / 8
    # A frame kept of each would take 4 MB at least, a few numbers of each 1 MB.
    assert late_kb - early_kb < 3_000, (n_rows, early_kb, late_kb)
