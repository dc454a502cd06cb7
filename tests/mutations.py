"""Files whose bytes are changed, and whether what is lost by it is reported."""

import os
import shutil
import subprocess
from collections import Counter
from functools import partial
from typing import NamedTuple

import av
import cv2
import numpy as np
from bagged import film, write_bag
from pebble import ProcessPool

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.machine.threads import limit_threads
from dlgmd_cli.parameters.presets import load_config
from dlgmd_cli.results.labels import read_labels
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.tasks.run import run
from dlgmd_cli.video.opening import open_video

N_FRAMES, FPS, WIDTH, HEIGHT = 40, 30, 64, 48
H264, B = "-c:v libx264 -g 15 -bf 0", "-c:v libx264 -g 15 -bf 2"
MPEG4, MPEG2 = "-c:v mpeg4 -g 15", "-c:v mpeg2video -g 15"
# The 29 kinds of video, with the options of FFmpeg that write them.
VIDEOS = {
    "h264.mp4": H264,
    "h264-b.mp4": B,
    "mpeg4.mp4": MPEG4,
    "hevc.mp4": "-c:v libx265 -x265-params log-level=none:keyint=15",
    "fragments.mp4": f"{B} -movflags frag_keyframe+empty_moov",
    "h264-b.mov": B,
    "prores.mov": "-c:v prores_ks",
    "h264.mkv": H264,
    "h264-b.mkv": B,
    "ffv1.mkv": "-c:v ffv1",
    "vp8.webm": "-c:v libvpx -g 15",
    "vp9.webm": "-c:v libvpx-vp9 -g 15",
    "mjpeg.avi": "-c:v mjpeg",
    "mpeg4.avi": MPEG4,
    "h264-b.avi": B,
    "h264.ts": H264,
    "h264-b.ts": B,
    "mpeg2.ts": MPEG2,
    "h264-b.flv": B,
    "sorenson.flv": "-c:v flv -g 15",
    "raw.y4m": "-pix_fmt yuv420p",
    "png.apng": "-c:v apng",
    "palette.gif": "-c:v gif",
    "wmv2.wmv": "-c:v wmv2 -g 15",
    "mpeg2.mpg": MPEG2,
    "mpeg4.nut": MPEG4,
    "theora.ogv": "-c:v libtheora -q:v 10 -g 15",
    "jpeg.mjpeg": "-c:v mjpeg",
    "h264-b.h264": B,
}
OTHERS = ("images-png", "images-jpg", "array.npy", "preset.yaml", "labels.csv", "record")
OTHERS += ("bag.bag", "bag", "bag.mcap")
# What is lost can be reported of these by their lengths, indices, numbers or checksums: the table
# in docs/damage.md. Kinds by their ends; no other loss is promised.
PROMISED = {
    "fragments.mp4": ("beginning", "middle", "end"),
    ".mp4": ("beginning", "middle", "end", "times"),
    ".mov": ("beginning", "middle", "end", "times"),
    ".mkv": ("beginning", "middle", "end"),
    ".webm": ("beginning", "middle", "end"),
    ".avi": ("beginning", "middle", "end", "times"),
    ".ts": ("middle",),
    ".flv": ("beginning", "middle", "end"),
    ".y4m": ("middle", "end"),
    ".apng": ("beginning", "middle", "end", "times", "content"),
    "images-png": ("middle", "times", "content"),
    "images-jpg": ("middle", "times"),
}
# Sound videos: the options of FFmpeg before and after those of the codec.
IMAGES, TONE = "-f lavfi -i testsrc2=r=30:d=2:s=96x64", "-f lavfi -i sine=d="
VARIANTS = {
    "plain": (IMAGES, ""),
    "60": (IMAGES.replace("r=30", "r=60"), ""),
    "ntsc": (IMAGES.replace("r=30", "r=30000/1001"), ""),
    "sound": (f"{IMAGES} {TONE}2", "-ar 44100"),
    "longer-sound": (f"{IMAGES} {TONE}3", "-ar 44100"),
    "late": (f"-itsoffset 1 {IMAGES} {TONE}3", "-ar 44100"),
    "variable": (IMAGES, "-vf select='mod(n*n,7)' -vsync vfr"),
    "b-frames": (IMAGES, "-bf 3"),
    "cut": (f"-ss 0.5 {IMAGES}", ""),
}
PLACES = [divmod(bit, 4) for bit in range(7)]
WAYS = ("first byte", "packet zeroed", "bytes", "block zeroed", "block lost", "header", "cut off")
FOLDER_WAYS = ("bytes", "lost", "several lost")
# So many mutants are tried together; a share of them that takes longer than this, in s, hangs.
SHARE, MOST_S = 20, 300


class Row(NamedTuple):
    """What became of a mutant that a decoder read: one of `OUTCOMES`, the last six being silent."""

    number: int
    name: str
    way: str
    decoder: str
    outcome: str
    remark: str = ""


SILENT = ("beginning", "middle", "end", "times", "content")
OUTCOMES = ("refused", "warned", "same", *SILENT, "internal error", "hang or crash")


class Seen(NamedTuple):
    """Frames that were read, as (index, time, the number that the image shows); the warnings."""

    frames: tuple
    warnings: frozenset


def is_promised(name, outcome):
    """Whether the table says that this silent loss can be reported."""
    ends = (end for end in PROMISED if name.endswith(end))
    return outcome in PROMISED.get(next(ends, ""), ())


def numbered(number):
    """An image that shows a number below 128 in seven squares, above a texture that moves."""
    texture = np.random.default_rng(3).integers(60, 200, (HEIGHT, WIDTH + 128), dtype=np.uint8)
    image = texture[:, number : number + WIDTH].copy()
    for bit, (y, x) in enumerate(PLACES):
        image[16 * y : 16 * y + 16, 16 * x : 16 * x + 16] = 230 if number >> bit & 1 else 20
    return image


def number_of(grey):
    """The number that an image shows."""
    squares = (grey[16 * y + 4 : 16 * y + 12, 16 * x + 4 : 16 * x + 12] for y, x in PLACES)
    return sum(int(square.sum() > 125 * square.size) << bit for bit, square in enumerate(squares))


def ffmpeg(*words, frames=b""):
    """Whether FFmpeg does this."""
    command = ["ffmpeg", "-v", "quiet", "-y", *words]
    return subprocess.run(command, input=frames, stdout=subprocess.DEVNULL).returncode == 0


def sound(folder):
    """What is mutated, a file or folder of each kind that can be written here."""
    frames = [numbered(number) for number in range(N_FRAMES)]
    raw = ["-f", "rawvideo", "-pix_fmt", "gray", "-s", f"{WIDTH}x{HEIGHT}", "-r", str(FPS)]
    paths = []
    for name, options in VIDEOS.items():
        path = folder / name
        pixels = [] if "-pix_fmt" in options or path.suffix == ".gif" else ["-pix_fmt", "yuv420p"]
        pixels = ["-pix_fmt", "gray"] if path.suffix == ".apng" else pixels
        pixels = ["-pix_fmt", "yuv422p10le"] if name == "prores.mov" else pixels
        pixels = ["-pix_fmt", "yuvj420p"] if "-c:v mjpeg" in options else pixels
        if ffmpeg(*raw, "-i", "-", *options.split(), *pixels, path, frames=b"".join(frames)):
            paths.append(path)
    for suffix in ("png", "jpg"):
        (folder / f"images-{suffix}").mkdir()
        for number, frame in enumerate(frames):
            cv2.imwrite(str(folder / f"images-{suffix}" / f"{number:04d}.{suffix}"), frame)
    np.save(folder / "array.npy", np.stack(frames))
    (folder / "preset.yaml").write_text("set: 3\nr: 4\nsigma_e: 1.5\nt_mp: 0.7\nalarm: spikes\n")
    labels = [f"flight{n}.mp4,{40 + n},group1" for n in range(9)]
    (folder / "labels.csv").write_text("\n".join(["video,collision_frame,target", *labels, ""]))
    run(np.stack(frames), 3, input_fps=FPS).save(folder / "record")
    for name in ("bag.bag", "bag", "bag.mcap"):
        write_bag(folder / name, {"/camera": film(1 if name == "bag.bag" else 2, frames, FPS)})
    return [*paths, *(folder / name for name in OTHERS)]


def variants(folder, chosen=tuple(VARIANTS)):
    """Sound videos of every kind: plain, with sound, late, of variable rate, and so on."""
    for name, options in VIDEOS.items():
        for variant in chosen:
            before, after = VARIANTS[variant]
            path = folder / variant / name
            path.parent.mkdir(exist_ok=True)
            if ffmpeg(*before.split(), *options.split(), *after.split(), path):
                yield path


def packets_of(path):
    """Where the packets of a video stand in its file: (position, size); all of another file."""
    try:
        with av.open(str(path)) as container:
            packets = [(one.pos, one.size) for one in container.demux(video=0) if one.size]
    except (av.FFmpegError, ValueError, IndexError):
        packets = []
    return [packet for packet in packets if packet[0] is not None] or [(0, path.stat().st_size)]


def mutant(data, packets, random):
    """A way of `WAYS`, and the content changed in it."""
    content, way = np.frombuffer(data, np.uint8).copy(), WAYS[random.integers(len(WAYS))]
    # The first and the last packets are as interesting as all others.
    last = len(packets) - 1 - int(random.integers(min(3, len(packets))))
    at, size = packets[random.choice([0, int(random.integers(len(packets))), last])]
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


def mutated(source, target, random):
    """Write a mutant of a file, or of one file or several of a folder; the way."""
    shutil.rmtree(target, ignore_errors=True)
    if source.is_file():
        way, data = mutant(source.read_bytes(), packets_of(source), random)
        target.write_bytes(data)
        return way
    shutil.copytree(source, target)
    files = sorted(target.iterdir())
    one = files[random.integers(len(files))]
    way = FOLDER_WAYS[random.integers(len(FOLDER_WAYS))]
    if way == "lost":
        one.unlink()
    elif way == "several lost":
        first = int(random.integers(len(files)))
        for file in files[first : first + 1 + int(random.integers(5))]:
            file.unlink()
    else:
        way, data = mutant(one.read_bytes(), packets_of(one), random)
        one.write_bytes(data)
    return way


def seen(path, name, decoder):
    """What is read of a file; None if it is refused."""
    try:
        if name == "record":
            result = read_result(path)
            return Seen((repr(result.params), result.rows.tobytes()), frozenset(result.warnings))
        if name in ("preset.yaml", "labels.csv"):
            content = (load_config if name == "preset.yaml" else read_labels)(path)
            return Seen((repr(content),), frozenset())
        with open_video(path, decoder=decoder, input_fps=FPS) as video:
            frames = tuple((one.index, round(one.time_s, 3), number_of(one.grey)) for one in video)
            return Seen(frames, frozenset(video.progress.warnings))
    except DlgmdError:
        return None


def outcome(whole, now):
    """What became of a file that was changed."""
    if now is None or now.warnings - whole.warnings:
        return "refused" if now is None else "warned"
    had, has = whole.frames, now.frames
    if had == has:
        return "same"
    if not (isinstance(had[0], tuple) and isinstance(has[0], tuple)):
        return "content"
    gone = sorted({number for *_, number in had} - {number for *_, number in has})
    if len(has) < len(had) and gone:
        if gone[0] == 0:
            return "beginning"
        return "end" if gone[0] + len(gone) == len(had) and gone[-1] == len(had) - 1 else "middle"
    pairs = list(zip(had, has, strict=False))
    is_timed = all(a[0] == b[0] and abs(a[1] - b[1]) < 0.5 / FPS for a, b in pairs)
    if len(had) != len(has) or not is_timed:
        return "times"
    return "content" if any(a[2] != b[2] for a, b in pairs) else "same"


_whole = {}


def tried(folder, paths, decoders, seed, numbers):
    """What becomes of each of these mutants."""
    limit_threads(1)
    rows = []
    for number in numbers:
        path = paths[number % len(paths)]
        changed = folder / f"{os.getpid()}" / path.name
        changed.parent.mkdir(exist_ok=True)
        way = mutated(path, changed, np.random.default_rng((seed, number)))
        for decoder in decoders if path.name in VIDEOS else decoders[:1]:
            if (path, decoder) not in _whole:
                _whole[path, decoder] = seen(path, path.name, decoder)
            try:
                now, remark = seen(changed, path.name, decoder), ""
                became = outcome(_whole[path, decoder], now)
            except Exception as error:
                became, remark = "internal error", repr(error)
            rows.append(Row(number, path.name, way, decoder, became, remark))
    return rows


def study(folder, count, *, seed=42, decoders=("opencv", "pyav"), n_jobs=2):
    """Try `count` mutants, in processes; the rows of `tried`."""
    paths = sound(folder)
    parts = [range(first, min(first + SHARE, count)) for first in range(0, count, SHARE)]
    work, rows = partial(tried, folder, paths, decoders, seed), []
    with ProcessPool(n_jobs) as pool:
        done = [pool.schedule(work, (part,), timeout=MOST_S) for part in parts]
        for part, future in zip(parts, done, strict=True):
            try:
                rows += future.result()
            except Exception as error:
                rows.append(Row(part[0], "", "", "", "hang or crash", repr(error)))
    return rows


def table(rows):
    """The lines of a table of what became of the mutants, by decoder and kind."""
    head = ("tried", *OUTCOMES)
    lines = [f"{'':9}{'kind':15}" + "".join(f"{name:>10.9}" for name in head)]
    for decoder in dict.fromkeys(row.decoder for row in rows):
        mine = [row for row in rows if row.decoder == decoder]
        for name in [*dict.fromkeys(row.name for row in mine), "all"]:
            counts = Counter(row.outcome for row in mine if name in (row.name, "all"))
            numbers = [counts.total(), *(counts[one] for one in OUTCOMES)]
            lines.append(f"{decoder:9}{name:15}" + "".join(f"{number:10}" for number in numbers))
    return lines
