"""Duplicates that FFmpeg encodes anew: which are found."""

import os
import shutil
import subprocess
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import read_video

from dlgmd_cli import open_video

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg is not installed"),
]
FLIGHT = Path(__file__).parents[2] / "sample_videos/group2.mp4"


SIZE = W, H = 320, 180
# Key frames of MPEG-4 code a duplicate wholly anew, and the B-frames of a strong compression blend
# duplicates with their neighbours: neither can be told from motion.
CODECS = {
    "x264-23": "libx264 -preset fast -crf 23",
    "x264-28": "libx264 -preset veryfast -tune zerolatency -crf 28 -g 60",
    "mpeg4": "mpeg4 -q:v 4 -g 60",
    "hevc": "libx265 -preset ultrafast -crf 26 -x265-params log-level=none",
    "vp9": "libvpx-vp9 -crf 32 -b:v 0 -deadline realtime -cpu-used 8",
    "mjpeg": "mjpeg -q:v 4 -pix_fmt yuvj420p",
    "mpeg2": "mpeg2video -q:v 4 -g 60",
}
N = 150
# Of 20 clips with duplicates, and 20 without; in 7 are all kinds and codecs.
N_CLIPS = 20 if os.environ.get("DLGMD_THOROUGH") else 7


def texture(seed, width, height=H + 40):
    """A colour image with details of three sizes."""
    noise = np.random.default_rng(seed).standard_normal((height, width, 3)).astype(np.float32)
    sizes = ((1.0, 0.5), (2.5, 1.0), (12.0, 1.0))
    wide = sum(cv2.GaussianBlur(noise, (0, 0), sd) * sd * share for sd, share in sizes)
    return 128 + 60 * wide / wide.std()


def pan(seed, speed, n=N):
    """A camera that moves along a texture by `speed(t)` px a frame, t from 0 to 1."""
    wide, x, views = texture(seed, W + 1600), 0.0, []
    for t in np.linspace(0, 1, n):
        moved = cv2.warpAffine(
            wide, np.float32([[1, 0, -x], [0, 1, -20 - 3 * np.sin(16 * t)]]), SIZE
        )
        views.append(np.uint8(moved.clip(0, 255)))
        x += speed(t)
    return views


def ball(seed, n=N):
    """An object that comes closer in front of a background that passes."""
    object_, back = texture(seed, 400, 400), pan(seed + 1, lambda t: 1.0, n)
    for t, view in zip(np.linspace(0, 1, n), back, strict=True):
        side = 120 / (8 - 7 * t)
        place = np.float32([[side / 400, 0, 170 - side / 2], [0, side / 400, 90 - side / 2]])
        inside = cv2.warpAffine(np.ones((400, 400)), place, SIZE) > 0.5
        view[inside] = cv2.warpAffine(object_, place, SIZE).clip(0, 255)[inside]
    return back


def flight(*_):
    """The sample flight, once the drone is at speed."""
    return [cv2.resize(one, SIZE, interpolation=cv2.INTER_AREA) for one in read_video(FLIGHT)[1]][
        60:
    ]


SCENES = (
    lambda seed: pan(seed, lambda t: 1.0 + seed % 3),
    ball,
    flight,
    lambda seed: pan(seed, lambda t: 2.0 + np.sin(9 * t)),
)


def with_duplicates(kind, views, rng):
    """Views of which some are given more than once, and whether each is a duplicate."""
    times = {"2 in 5": [1, 2, 2], "1 in 2": [2]}.get(kind) or [
        1 + (rng.random() < 0.12) * int(rng.integers(1, 9)) for _ in views
    ]
    counts = [times[k % len(times)] for k in range(len(views))]
    copies = [(view, copy > 0) for view, n in zip(views, counts, strict=True) for copy in range(n)]
    return tuple(zip(*copies[:N], strict=True))


def without_duplicates(kind, views, rng, k):
    """Views all of which are new."""
    if kind == "strobes":  # every 2 to 6 frames: more light, or more contrast
        lit = (lambda v: v + 40.0) if k % 2 else (lambda v: v * 1.5)
        return [
            np.uint8(np.clip(lit(v), 0, 255)) if t % (k + 2) == 0 else v
            for t, v in enumerate(views)
        ]
    if kind == "noise":
        return [np.uint8(np.clip(v + rng.normal(0, 2 + 2 * k, v.shape), 0, 255)) for v in views]
    if kind == "clock":
        for t, view in enumerate(views):
            cv2.rectangle(view, (4, 4), (150, 34), (0, 0, 0), -1)
            cv2.putText(
                view, f"{t // (k + 1):02d}:{37 * t % 60:02d}", (8, 28), 0, 0.8, (255,) * 3, 2
            )
    return views


def clips():
    """Kind, codec, frames and truth of clips; none of these seeds chose the test."""
    rng, codecs = np.random.default_rng(7), [*CODECS]
    for k in range(N_CLIPS):
        kind = ("2 in 5", "1 in 2", "bursts")[k % 3]
        views = SCENES[(k // 3 + k) % 4](500 + k)
        yield kind, codecs[3 * k % 7], *with_duplicates(kind, views, rng)
    for k in range(N_CLIPS):
        kind, views = ("strobes", "clock", "noise", "speeds up")[k % 4], SCENES[k // 4 % 4](600 + k)
        if kind == "speeds up":
            views = pan(700 + k, lambda t: 0.15 * 40.0**t)
        found = without_duplicates(kind, views, rng, k // 4)
        yield kind, codecs[(5 * k + 1) % 7], found, (False,) * len(found)


def test_duplicates_of_moving_scenes(tmp_path):
    """`pytest -s` prints the table: kind, codec, frames, duplicates, missed, wrongly left out."""
    right = {}
    for number, (kind, codec, views, truth) in enumerate(clips()):
        path, raw = tmp_path / f"{number}.mkv", ["-f", "rawvideo", "-pix_fmt", "bgr24", "-i", "-"]
        ffmpeg = ["ffmpeg", "-v", "error", "-s", f"{W}x{H}", "-r", "30", *raw]
        coder = ["-pix_fmt", "yuv420p", "-c:v", *CODECS[codec].split(), str(path)]
        subprocess.run([*ffmpeg, *coder], input=np.array(views).tobytes(), check=True)
        with open_video(path, repeats=None) as video:
            found = np.array([frame.is_repeat for frame in video])
        missed, wrong = int((truth & ~found).sum()), int((found & ~np.array(truth)).sum())
        print(f"{kind:9} {codec:8} {len(truth):4} {sum(truth):4} {missed:3} {wrong:3}")
        right.setdefault(kind, []).append(1 - (missed + wrong) / len(truth))
    shares = {kind: float(np.mean(each)) for kind, each in right.items()}
    print({kind: f"{100 * share:.1f} %" for kind, share in shares.items()})
    assert len(shares) == 7 and min(shares.values()) >= 0.99, shares
