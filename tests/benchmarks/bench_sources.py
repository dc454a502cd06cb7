"""The delay of each kind of source: from a frame at its sender to the answer that is printed.

    python tests/benchmarks/bench_sources.py [NAME...]

FFmpeg encodes frames of two textures, 30 a second, and sends them. Every 20 frames the texture is
the other one: the membrane potential jumps, and the line of JSON in which it does is the answer to
that frame. It needs the command ffmpeg; a camera and a ROS topic are not measured here.
"""

import json
import shlex
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))

from streamer import CHUNK, over_rtsp  # noqa: E402

WIDTH, HEIGHT, FPS = 320, 240, 30
N_STILL, N_FLIPS, WARM_S = 20, 25, 12.0
RAW = f"ffmpeg -v error -f rawvideo -pix_fmt gray -s {WIDTH}x{HEIGHT} -r {FPS} -i - "
H264 = RAW + "-pix_fmt yuv420p -c:v libx264 -preset ultrafast -tune zerolatency -g 15 "
# What a receiver of its own writes into the pipe.
TO_PIPE = f"-f rawvideo -pix_fmt gray - | dlgmd live - --input-size {WIDTH}x{HEIGHT}"
QUICK = "ffmpeg -v error -fflags nobuffer -flags low_delay -probesize 5000 "


class Kind(NamedTuple):
    """A kind of source: what sends it, and the command that watches it."""

    sender: str
    watch: str
    carry: Callable[[tuple[str, int]], Callable[[bytes], object]] | None = None


KINDS = {
    "MPEG-TS over UDP": Kind(
        H264 + "-f mpegts udp://127.0.0.1:5301?pkt_size=1316", "dlgmd live udp://127.0.0.1:5301"
    ),
    "RTSP": Kind(H264 + "-f mpegts -", "dlgmd live rtsp://127.0.0.1:5302/x", over_rtsp),
    "RTP": Kind(H264 + "-f rtp -sdp_file stream.sdp rtp://127.0.0.1:5304", "dlgmd live stream.sdp"),
    "MJPEG over HTTP": Kind(
        RAW + "-c:v mjpeg -q:v 3 -f mpjpeg -flush_packets 1 -listen 1 http://127.0.0.1:5306/v",
        "dlgmd live http://127.0.0.1:5306/v",
    ),
    "pipe": Kind(
        H264 + "-f mpegts udp://127.0.0.1:5307?pkt_size=1316",
        QUICK + "-i udp://127.0.0.1:5307 " + TO_PIPE,
    ),
}


class Sender:
    """Frames at their pace, and when the texture became another one."""

    def __init__(self, kind: Kind, folder: str) -> None:
        self.flipped_s: list[float] = []
        self.is_measured, self.is_over = False, False
        piped = subprocess.PIPE if kind.carry else None
        command = shlex.split(kind.sender)
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=piped, cwd=folder)
        if kind.carry:
            port = int(kind.watch.rpartition(":")[2].split("/")[0])
            threading.Thread(target=self._carry, args=(kind.carry, port), daemon=True).start()
        threading.Thread(target=self._feed, daemon=True).start()

    def _carry(self, carry, port: int) -> None:
        """Hand on what FFmpeg writes."""
        send = carry(("127.0.0.1", port))
        with suppress(OSError):
            while data := self._process.stdout.read1(CHUNK):
                send(data)

    def _feed(self) -> None:
        rng = np.random.default_rng(1)
        blocks = rng.integers(60, 196, (2, HEIGHT // 8, WIDTH // 8), np.uint8)
        textures = [np.kron(one, np.ones((8, 8), np.uint8)).tobytes() for one in blocks]
        began_s, number = time.monotonic(), 0
        with suppress(OSError):
            while not self.is_over:
                time.sleep(max(0.0, began_s + number / FPS - time.monotonic()))
                if self.is_measured and number % N_STILL == 0:
                    self.flipped_s.append(time.monotonic())
                self._process.stdin.write(textures[number // N_STILL % 2])
                self._process.stdin.flush()
                number += 1

    def end(self) -> None:
        self.is_over = True
        self._process.kill()
        self._process.wait()


def delays_ms(kind: Kind) -> tuple[list[float], int]:
    """The delays of the frames at which the texture changed, and how many of them there were."""
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        sender = Sender(kind, folder)
        stack.callback(sender.end)
        if "stream.sdp" in kind.watch:
            while not (Path(folder) / "stream.sdp").is_file():
                time.sleep(0.05)
        command = kind.watch.replace("dlgmd", f"{sys.executable} -m dlgmd_cli")
        watch = subprocess.Popen(
            ["sh", "-c", f"{command} --fps all --repeats keep --jsonl"],
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            cwd=folder,
            start_new_session=True,
        )
        stack.callback(end_all, watch)
        first_s, heard = None, []
        for line in watch.stdout:
            now_s, answer = time.monotonic(), json.loads(line)
            if answer["latency_ms"] is None or answer["mp"] is None:
                continue
            first_s = first_s or now_s
            sender.is_measured = now_s - first_s > WARM_S
            heard.append((now_s, answer["mp"]))
            if len(sender.flipped_s) > N_FLIPS:
                break
    limit = 0.5 * max(mp for _, mp in heard)
    jumps_s = np.array([now_s for now_s, mp in heard if mp > limit])
    late = [jumps_s[jumps_s >= at_s][:1] - at_s for at_s in sender.flipped_s[:N_FLIPS]]
    near_ms = [1e3 * float(one[0]) for one in late if len(one) and one[0] < N_STILL / FPS]
    return near_ms, N_FLIPS


def end_all(watch: subprocess.Popen) -> None:
    """End the watch and what it reads from, which are a session of their own."""
    subprocess.run(["kill", "--", f"-{watch.pid}"], check=False)
    with suppress(subprocess.TimeoutExpired):
        watch.wait(5.0)


def main(*names: str) -> None:
    if shutil.which("ffmpeg") is None:
        raise SystemExit("the command ffmpeg is not there")
    print(f"{'source':18} {'median':>7} {'highest':>8}  seen  command")
    for name in names or KINDS:
        found_ms, n_flips = delays_ms(KINDS[name])
        told = f"{np.median(found_ms):7.0f} {max(found_ms):8.0f}" if found_ms else f"{'none':>16}"
        print(f"{name:18} {told}  {len(found_ms)}/{n_flips}  {KINDS[name].watch}", flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
