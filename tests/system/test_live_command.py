"""`dlgmd live` as a process: streams, overload, Ctrl-C at any moment, and memory."""

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import ExitStack, contextmanager, suppress
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from conftest import free_port, looming_frames, until, write_video
from documents import blocks
from watching import PATIENCE_S, ROOT, fed, lines_of, live

from dlgmd_cli import read_result

SAMPLE = ROOT / "sample_videos" / "group2.mp4"
# A second on a machine of its own; these tests share theirs. What would hold it up takes five.
AT_ONCE_S = 4.0
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="signals differ there"),
]


@contextmanager
def streaming(port, path=SAMPLE, scheme="udp"):
    """The sample over UDP, for ever."""
    pytest.importorskip("av", reason="PyAV is not installed")
    url = f"{scheme}://127.0.0.1:{port}?pkt_size=1316"
    command = [sys.executable, ROOT / "tests" / "streamer.py", path, url]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        try:
            yield process
        finally:
            process.kill()


def interrupt(process):
    """Press Ctrl-C once; seconds until the process has ended, and its exit code."""
    process.send_signal(signal.SIGINT)
    begin = time.monotonic()
    return process.wait(PATIENCE_S), time.monotonic() - begin


def until_listening(process, text=b"trying again"):
    while text not in process.stderr.readline():
        assert process.poll() is None


def until_taken(port):
    """Wait until somebody listens for datagrams at a port."""

    def is_taken():
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
            try:
                other.bind(("0.0.0.0", port))
            except OSError:
                return True
        return False

    until(is_taken, PATIENCE_S)


@pytest.mark.parametrize("scheme", ["udp", "rtsp", "http"])
def test_ctrl_c_ends_the_wait_for_a_stream_within_a_second(scheme):
    """From a server that takes the connection and says nothing, or, over UDP, from nobody."""
    with ExitStack() as stack:
        server = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
        server.settimeout(PATIENCE_S)
        port = free_port() if scheme == "udp" else server.getsockname()[1]
        url = f"{scheme}://127.0.0.1:{port}/x"
        process = stack.enter_context(live(url, stdout=subprocess.DEVNULL))
        if scheme == "udp":
            until_taken(port)
        else:
            stack.enter_context(server.accept()[0])
        code, seconds = interrupt(process)
        assert code == 130 and seconds < AT_ONCE_S
        assert b"Interrupted." in process.stderr.read()


def test_ctrl_c_ends_a_command_that_nobody_listens_to_within_a_second():
    """Neither a full pipe at stdout nor a program that hangs keeps it from answering or ending."""
    read_end, write_end = os.pipe()
    arguments = ("-", "--input-size", "64x48", "--jsonl", "--fps", "all", "--exec", "sleep 5")
    frames = looming_frames(64, 64, 48)

    def feed():
        with suppress(BrokenPipeError), os.fdopen(write_end, "wb", buffering=0) as writer:
            for number in count():
                writer.write(frames[number % 64].tobytes())
                time.sleep(0.001)

    feeder = threading.Thread(target=feed)
    with live(*arguments, stdin=read_end) as process:
        os.close(read_end)
        feeder.start()
        until_listening(process, b"answers are dropped")
        code, seconds = interrupt(process)
        feeder.join()
        assert code == 130 and seconds < AT_ONCE_S
        told = process.stderr.read()
        assert b"alarms: " in told and b"complete: " not in told  # nothing is recorded


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
                while json.loads(receiver.recv(4096)) != began:
                    pass  # an earlier event, as of a slow opening
                assert began["latency_ms"] > 0.0 and began["rule"] == "expansion"
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
            assert b"complete: no, a signal ended it" in process.stderr.read()
    result = read_result(tmp_path)
    assert result.record["complete"] is False and result.summary["alarms"] >= 2
    assert again["frame"] in result.frame


def test_a_session_over_rtp(tmp_path):
    """By the description that the documents have."""
    port = free_port() // 2 * 2
    (text,) = [text for _, name, text in blocks("docs/sources.md") if name == "stream.sdp"]
    (tmp_path / "stream.sdp").write_text(text.replace("5600", str(port)))
    with (
        streaming(port, scheme="rtp"),
        live(tmp_path / "stream.sdp", "--jsonl", "--events") as process,
    ):
        assert next(one for one in lines_of(process) if one["event"] == "begin")


def test_a_slow_model_drops_frames_and_never_falls_behind(tmp_path):
    """Frames of 720p come as fast as the pipe takes them; set 9 at full size is slower."""
    width, height, n_frames = 1280, 720, 400
    frames = [np.random.default_rng(n).integers(0, 255, (height, width), np.uint8) for n in (1, 2)]
    arguments = ("-", "--input-size", f"{width}x{height}", "--fps", "all", "--jsonl")
    (tmp_path / "full.yaml").write_text(f"set: 9\nwidth_px: {width}\n")
    with live(*arguments, "--config", tmp_path / "full.yaml", stdin=subprocess.PIPE) as process:

        def feed():
            for number in range(n_frames):
                process.stdin.write(frames[number % 2].tobytes())
            process.stdin.close()

        feeder = threading.Thread(target=feed)
        began_s = time.monotonic()
        feeder.start()
        # Events have lines of their own, such as that the frames are noise, which these are.
        found = [one for one in lines_of(process) if one["latency_ms"] is not None]
        took_ms = 1e3 * (time.monotonic() - began_s)
        feeder.join()
        told = process.stderr.read().decode()
        assert process.wait() == 0
    dropped = int(told.split("dropped: ")[1].split(";")[0])
    assert f"frames: {n_frames} came, {len(found)} answered" in told
    assert dropped > 0 and len(found) + dropped == n_frames
    assert found[-1]["frame"] >= n_frames - 20  # of the last frames, one in several
    # Of a queue of frames, the last would be late by nearly all of the time that it took.
    assert np.median([one["latency_ms"] for one in found[-20:]]) < 0.2 * took_ms


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
    assert n_rows > n_frames / 32
    # A frame kept of each would take 4 MB at least, a few numbers of each 1 MB.
    assert late_kb - early_kb < 3_000, (n_rows, early_kb, late_kb)


@pytest.mark.parametrize("streams", ["stdout", "both"])
def test_a_reader_that_goes_silences_nothing_else(streams):
    """As of `| head -2`, or of `2>&1 | head -2`; the datagrams go on, and tell it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        receiver.bind(("127.0.0.1", 0))
        receiver.settimeout(PATIENCE_S)
        place = f"127.0.0.1:{receiver.getsockname()[1]}"
        arguments = ("-", "--input-size", "64x48", "--jsonl", "--udp", place)
        both = {"stderr": subprocess.STDOUT} if streams == "both" else {}
        piped = {"stdin": subprocess.PIPE, "bufsize": 0}
        with live(*arguments, **piped, **both) as process, fed(process):
            for _ in range(2):
                process.stdout.readline()
            process.stdout.close()
            heard, n_after = [], 0
            while n_after < 30:
                heard.append(json.loads(receiver.recv(4096)))
                n_after += any(one.get("event") == "output-lost" for one in heard)
            process.send_signal(signal.SIGTERM)
            assert process.wait(PATIENCE_S) == 0
    (lost,) = [one for one in heard if one.get("event") == "output-lost"]
    assert lost["output"] == "jsonl" and [*lost][-1] == "output"


def test_a_reader_that_goes_ends_what_nobody_hears():
    arguments = ("-", "--input-size", "64x48", "--jsonl")
    with live(*arguments, stdin=subprocess.PIPE, bufsize=0) as process, fed(process):
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(PATIENCE_S) == 1
        assert b"nobody reads standard output any more" in process.stderr.read()


def test_a_closed_standard_output_is_one_that_nobody_reads():
    """As of `>&-`; other receivers go on."""
    command = f"exec {sys.executable} -m dlgmd_cli live - --input-size 64x48 --jsonl"
    for more, code in (("", 1), (" --exec true", 0)):
        closed = ["sh", "-c", f"{command}{more} >&-"]
        data = b"".join(frame.tobytes() for frame in looming_frames(20, 64, 48))
        done = subprocess.run(closed, input=data, capture_output=True, cwd=ROOT)
        told = done.stderr.decode()
        assert done.returncode == code and "nobody reads standard output" in told, told
        assert "Error" not in told


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_service_manager_ends_it_with_0_and_the_last_messages(number):
    """The end of an alarm that is on is told."""
    arguments = ("-", "--input-size", "64x48", "--fps", "all", "--set", 3, "--jsonl", "--events")
    with live(*arguments, stdin=subprocess.PIPE, bufsize=0) as process:
        lines = lines_of(process)
        with fed(process):
            assert next(one for one in lines if one["event"] == "begin")
            process.send_signal(number)
        rest = [one["event"] for one in lines]
        assert process.wait(PATIENCE_S) == 0 and rest[-1] == "end"
        assert b"Interrupted" not in process.stderr.read()


@pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="systemd is not installed")
def test_the_unit_file_of_the_documents_is_valid(tmp_path):
    (unit,) = [text for kind, name, text in blocks("docs/live.md") if name == "dlgmd.service"]
    file = tmp_path / "dlgmd.service"
    file.write_text(unit.replace("/opt/dlgmd/bin/dlgmd", "/bin/true"))
    done = subprocess.run(["systemd-analyze", "verify", file], capture_output=True, text=True)
    assert (done.returncode, done.stdout + done.stderr) == (0, "")
    file.write_text(unit)  # and an error would show
    done = subprocess.run(["systemd-analyze", "verify", file], capture_output=True, text=True)
    assert "/opt/dlgmd/bin/dlgmd" in done.stderr


def test_the_last_seconds_by_the_command(runs, tmp_path):
    """Beside the tables of all; another session goes on counting."""
    path = write_video(tmp_path / "a.avi", looming_frames(30, 64, 48), fps=30)
    options = ("--realtime", "--set", 3, "--record", "r", "--keep-last", 0.4, "--overwrite")
    for number in (1, 2):
        runs("live", path, *options)
        result = read_result(f"r/alarm-{number}")
        assert len(os.listdir(f"r/alarm-{number}/pictures")) == len(result) > 5
    assert len(read_result("r")) > len(result) and not os.path.exists("r/alarm-3")


def test_the_rule_and_its_threshold_are_said(runs, tmp_path):
    path = write_video(tmp_path / "a.avi", looming_frames(30, 64, 48), fps=30)
    said = runs("live", path, "--realtime", "--threshold", 0.6).stderr
    assert "Note: the alarm rule is expansion: expansion of 0.6/s or more." in said
