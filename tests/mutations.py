"""Videos whose bytes are changed, and whether the frames that are lost by it are told."""

import os
import shutil
import subprocess
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple

import av
import numpy as np
from damaged import encode

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.machine.threads import limit_threads
from dlgmd_cli.video.opening import open_video

N_FRAMES, FPS = 90, 30
NO_B, B = {"g": "30", "bf": "0"}, {"g": "30", "bf": "2"}
# Container, codec and options of the videos, beside one another in the table.
KINDS = {
    "h264.mp4": ("libx264", NO_B),
    "h264-b.mp4": ("libx264", B),
    "mpeg4.mp4": ("mpeg4", {"g": "30"}),
    "h264.mkv": ("libx264", NO_B),
    "h264-b.mkv": ("libx264", B),
    "vp9.webm": ("libvpx-vp9", {"g": "30"}),
    "h264.ts": ("libx264", NO_B),
    "h264-b.ts": ("libx264", B),
    "mpeg2.ts": ("mpeg2video", {"g": "30"}),
    "mjpeg.avi": ("mjpeg", {}),
    "mpeg4.avi": ("mpeg4", {"g": "30"}),
    "h264-b.avi": ("libx264", B),
}
PLACES = [divmod(bit, 4) for bit in range(7)]
WAYS = ("first byte", "packet zeroed", "bytes", "block zeroed", "block lost", "header", "cut off")


class Row(NamedTuple):
    """A mutant read by a decoder: where frames are lost without a word, "" for nowhere.

    If they are, `n_counted` is how many ffprobe counts, -1 where it is not installed.
    """

    number: int
    name: str
    way: str
    decoder: str
    where: str
    n_counted: int


class Seen(NamedTuple):
    """Frames that were read, as (index, time, the number that the image shows); what was told."""

    frames: tuple
    is_told: bool


def numbered(number, width=64, height=48):
    """An image that shows a number below 128 in seven squares, above a texture that moves."""
    texture = np.random.default_rng(3).integers(60, 200, (height, width + 128), dtype=np.uint8)
    picture = texture[:, number : number + width].copy()
    for bit, (y, x) in enumerate(PLACES):
        picture[16 * y : 16 * y + 16, 16 * x : 16 * x + 16] = 230 if number >> bit & 1 else 20
    return picture


def number_of(grey):
    """The number that an image shows."""
    squares = (grey[16 * y + 4 : 16 * y + 12, 16 * x + 4 : 16 * x + 12] for y, x in PLACES)
    return sum(int(square.sum() > 125 * square.size) << bit for bit, square in enumerate(squares))


def sound(folder):
    """The videos that are mutated, one of each kind that can be written here."""
    frames, made = [numbered(number) for number in range(N_FRAMES)], []
    for name, (codec, options) in KINDS.items():
        if codec in av.codecs_available:
            pixels = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            how = {"pixels": pixels, "options": options, "fps": FPS}
            made.append(encode(Path(folder) / name, frames, codec, **how))
    return made


def packets_of(path):
    """Where the packets of a video stand in its file: (position, size)."""
    with av.open(str(path)) as container:
        return [
            (packet.pos, packet.size)
            for packet in container.demux(video=0)
            if packet.size and packet.pos is not None
        ]


def mutant(data, packets, random):
    """A way of `WAYS`, and the content changed in it."""
    content, way = np.frombuffer(data, np.uint8).copy(), WAYS[random.integers(len(WAYS))]
    # The first and the last packets are as interesting as all others.
    place = [0, int(random.integers(len(packets))), len(packets) - 1 - int(random.integers(3))]
    at, size = packets[random.choice(place)]
    start, length = int(random.integers(len(data))), int(2 ** random.uniform(2, 12))
    if way == "first byte":
        content[at] = 0
    elif way == "packet zeroed":
        content[at : at + size] = 0
    elif way == "bytes":
        n_changed = int(2 ** random.uniform(0, 6))
        content[random.integers(0, len(data), n_changed)] = random.integers(0, 256, n_changed)
    elif way == "block zeroed":
        content[start : start + length] = 0
    elif way == "block lost":
        content = np.delete(content, slice(start, start + length))
    elif way == "header":
        n_changed, end = int(2 ** random.uniform(0, 4)), min(len(data), 600)
        content[random.integers(0, end, n_changed)] = random.integers(0, 256, n_changed)
    else:
        content = content[: max(1, start)]
    return way, content.tobytes()


def seen(path, decoder):
    """What is read of a file; None if it is refused."""
    try:
        with open_video(path, decoder=decoder) as video:
            frames = tuple((one.index, round(one.time_s, 3), number_of(one.grey)) for one in video)
            return Seen(frames, bool(video.progress.warnings))
    except DlgmdError:
        return None


def lost(whole, now):
    """What is lost without a word: "" for nothing, else where."""
    if now is None or now.is_told:
        return ""
    had, has = whole.frames, now.frames
    if len(has) >= len(had):
        is_same = all(
            one[0] == other[0] and abs(one[1] - other[1]) < 0.5 / FPS
            for one, other in zip(had, has, strict=False)
        )
        return "" if is_same and len(has) == len(had) else "times"
    gone = sorted({number for *_, number in had} - {number for *_, number in has})
    if not gone:
        return "other"
    if gone[0] == 0:
        return "beginning"
    return "end" if gone[0] + len(gone) == len(had) and gone[-1] == len(had) - 1 else "middle"


def counted(path):
    """How many frames ffprobe decodes; -1 where it is not installed."""
    if shutil.which("ffprobe") is None:
        return -1
    ask = ["ffprobe", "-v", "quiet", "-count_frames", "-select_streams", "v:0", "-of", "csv=p=0"]
    shown = subprocess.run(
        [*ask, "-show_entries", "stream=nb_read_frames", str(path)], capture_output=True, text=True
    )
    number = shown.stdout.strip().split("\n")[0].strip(",")
    return int(number) if number.isdecimal() else 0


def tried(folder, paths, decoders, seed, numbers):
    """What becomes of each of these mutants."""
    limit_threads(1)
    rows, whole = [], {}
    for number in numbers:
        path = paths[number % len(paths)]
        way, data = mutant(
            path.read_bytes(),
            packets_of(path),
            np.random.default_rng((seed, number)),
        )
        changed = Path(folder) / f"{os.getpid()}{path.suffix}"
        changed.write_bytes(data)
        for decoder in decoders:
            if (path, decoder) not in whole:
                whole[path, decoder] = seen(path, decoder)
            now = seen(changed, decoder)
            where = lost(whole[path, decoder], now)
            rows.append(
                Row(number, path.name, way, decoder, where, counted(changed) if where else 0)
            )
    return rows


def study(folder, count, *, seed=42, decoders=("opencv", "pyav"), n_jobs=2):
    """Try `count` mutants, in processes; the rows of `tried`."""
    paths, share = sound(folder), 50
    parts = [range(first, min(first + share, count)) for first in range(0, count, share)]
    with ProcessPoolExecutor(n_jobs) as pool:
        work = partial(tried, folder, paths, decoders, seed)
        return [row for rows in pool.map(work, parts) for row in rows]
