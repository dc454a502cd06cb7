"""Damaged videos, of which most losses are told, and sound ones, of which none is accused."""

import shutil
import subprocess
from collections import Counter
from functools import cache

import numpy as np
import pytest

av = pytest.importorskip("av", reason="PyAV finds the packets of the videos")

from dlgmd_cli.errors import DlgmdError  # noqa: E402
from dlgmd_cli.video.opening import open_video  # noqa: E402

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(shutil.which("ffmpeg") is None, reason="ffmpeg writes the videos"),
]
DECODERS = ("opencv", "pyav")
N_FRAMES, FPS, WIDTH, HEIGHT = 90, 30, 128, 64
PLACES = [divmod(bit, 8) for bit in range(8)]
X264 = "-c:v libx264 -g 15 -keyint_min 15 -sc_threshold 0"
# What is damaged: the container, its share of losses to be told, and the options of FFmpeg.
VIDEOS = {
    "h264.mp4": ("MP4, AVI, FLV", f"{X264} -bf 2 -movflags faststart"),
    "fragments.mp4": ("MP4, AVI, FLV", f"{X264} -bf 0 -movflags frag_keyframe+empty_moov"),
    "mjpeg.avi": ("MP4, AVI, FLV", "-c:v mjpeg -pix_fmt yuvj420p"),
    "h264.flv": ("MP4, AVI, FLV", f"{X264} -bf 0"),
    "h264.mkv": ("Matroska", f"{X264} -bf 2 -cluster_time_limit 400"),
    "vp8.webm": ("Matroska", "-c:v libvpx -g 15 -cluster_time_limit 400"),
    "live.mkv": ("Matroska", f"{X264} -bf 0 -live 1 -cluster_time_limit 400"),
    "h264.ts": ("TS", f"{X264} -bf 2"),
    "mpeg2.ts": ("TS", "-c:v mpeg2video -g 15 -bf 0"),
}
LEAST = {"MP4, AVI, FLV": 0.92, "Matroska": 0.95, "TS": 0.84}


def numbered(number):
    """An image that shows a number below 256 in eight squares, above a texture that moves."""
    texture = np.random.default_rng(3).integers(60, 200, (HEIGHT, WIDTH + 256), dtype=np.uint8)
    image = texture[:, number : number + WIDTH].copy()
    for bit, (y, x) in enumerate(PLACES):
        image[16 * y : 16 * y + 16, 16 * x : 16 * x + 16] = 230 if number >> bit & 1 else 20
    return image


def number_of(grey):
    """The number that an image shows."""
    squares = (grey[16 * y + 4 : 16 * y + 12, 16 * x + 4 : 16 * x + 12] for y, x in PLACES)
    return sum(int(square.mean() > 125) << bit for bit, square in enumerate(squares))


def ffmpeg(*words, frames=b""):
    """Let FFmpeg do this."""
    command = ["ffmpeg", "-v", "error", "-y", *map(str, words)]
    subprocess.run(command, input=frames, check=True, stdout=subprocess.DEVNULL)


def written(path, options, *, fps=FPS, n_frames=N_FRAMES, before="", after=""):
    """A video of numbered images, by these options of FFmpeg, those of the input `before`."""
    raw = f"-f rawvideo -pix_fmt gray -s {WIDTH}x{HEIGHT} -r {fps} -i -"
    pixels = "" if "-pix_fmt" in options else "-pix_fmt yuv420p"
    words = f"{before} {raw} {after} {options} {pixels}".split()
    ffmpeg(*words, path, frames=b"".join(numbered(n % 256) for n in range(n_frames)))
    return path


def packets_of(path):
    """Where the packets of a video stand in its file: (position, size)."""
    with av.open(str(path)) as container:
        packets = [(one.pos, one.size) for one in container.demux(video=0) if one.size]
    return [(at, size) for at, size in packets if at is not None and at >= 0]


def read(path, decoder):
    """Number and time of each frame, and what is told; None and the error if it is refused."""
    try:
        with open_video(path, decoder=decoder) as video:
            frames = [(number_of(one.grey), round(one.time_s, 2)) for one in video]
            return frames, video.progress.damage
    except DlgmdError as error:
        return None, [str(error)]


# Damages: how the bytes `data` are changed, given those packets.


def cut(data, packets, share):
    return data[: int(len(data) * share)]


def cut_last_packet(data, packets):
    return data[: packets[-1][0] + packets[-1][1] // 2]


def zeroed(data, packets, share, n_bytes):
    at = int(len(data) * share)
    return data[:at] + bytes(n_bytes) + data[at + n_bytes :]


def flipped(data, packets, n_bytes, seed=0):
    changed, random = bytearray(data), np.random.default_rng(seed)
    low, high = packets[5][0], packets[-5][0]
    for at in random.integers(low, high, n_bytes):
        changed[at] ^= 1 << random.integers(8)
    return bytes(changed)


def lost(data, packets, share, n_bytes):
    at = int(len(data) * share)
    return data[:at] + data[at + n_bytes :]


def packet_zeroed(data, packets, number):
    at, size = packets[number]
    return data[:at] + bytes(size) + data[at + size :]


def packet_lost(data, packets, number, count=1):
    at, end = packets[number][0], packets[number + count][0]
    return data[:at] + data[end:]


DAMAGES = {
    "cut at 60 %": (cut, 0.6),
    "cut within the last packet": (cut_last_packet,),
    "4 KiB zeroed": (zeroed, 0.45, 4096),
    "16 KiB zeroed": (zeroed, 0.6, 16384),
    "40 bits flipped": (flipped, 40),
    "1 KiB lost": (lost, 0.5, 1000),
    "a key frame zeroed": (packet_zeroed, 45),
}
# Of one kind only: a part of the container is lost.
ONLY = {
    "h264.mp4": {"end cut off": (cut, 0.97), "first packet zeroed": (packet_zeroed, 0)},
    "fragments.mp4": {"fragment lost": (packet_lost, 30, 15)},
    "mjpeg.avi": {"10 packets lost": (packet_lost, 30, 10)},
    "h264.flv": {"5 tags lost": (packet_lost, 30, 5)},
    "h264.mkv": {"cluster lost": (packet_lost, 45, 15)},
    "vp8.webm": {},
    "live.mkv": {},
    "h264.ts": {"5 packets lost": (lost, 0.3, 5 * 188)},
    "mpeg2.ts": {"PES lost": (packet_lost, 47, 3)},
}


def damaged_files(folder):
    """Every damaged file, as (container, name, sound file, damaged one)."""
    for name, (container, options) in VIDEOS.items():
        sound = written(folder / name, options)
        data, packets = sound.read_bytes(), packets_of(sound)
        for damage, (change, *how) in {**DAMAGES, **ONLY[name]}.items():
            path = folder / f"{damage}-{name}"
            path.write_bytes(change(data, packets, *how))
            yield container, f"{name}: {damage}", sound, path


def test_most_losses_are_told(tmp_path, capsys):
    n_lost, n_told, silent, read_once = Counter(), Counter(), [], cache(read)
    for container, name, sound, path in damaged_files(tmp_path):
        for decoder in DECODERS:
            whole, told_of_whole = read_once(sound, decoder)
            assert told_of_whole == [] and len(whole) == N_FRAMES, (name, decoder, told_of_whole)
            frames, told = read(path, decoder)
            if frames == whole:  # nothing is lost
                continue
            n_lost[container, decoder] += 1
            n_told[container, decoder] += bool(told)
            silent += [] if told else [f"{decoder}: {name}, {len(frames)} frames"]
    with capsys.disabled():
        print("\n" + "\n".join(silent))
        for container in LEAST:
            numbers = (f"{n_told[container, d]} of {n_lost[container, d]}" for d in DECODERS)
            print(f"| {container} | {' | '.join(numbers)} |")
    assert sum(n_lost.values()) > 100
    for key, n_of_key in n_lost.items():
        assert n_told[key] >= LEAST[key[0]] * n_of_key, (key, silent)


@pytest.mark.parametrize("decoder", DECODERS)
def test_frames_missing_at_the_end_are_reported(tmp_path, decoder):
    path = written(tmp_path / "x.y4m", "-pix_fmt gray", n_frames=12)
    frames, damage = read(path, decoder)
    assert len(frames) == 12 and damage == []
    data = path.read_bytes()
    # A frame without its first byte ends reading.
    broken = data.replace(b"FRAME", b"RAME", 6).replace(b"RAME", b"FRAME", 5)
    for part in (data[:-100], data[: len(data) // 2], broken):
        path.write_bytes(part)
        frames, damage = read(path, decoder)
        end = f"decoded and used {len(frames)} "
        (line,) = damage
        assert line.startswith("frames are missing, the file is cut off") and end in line


TONE = "-f lavfi -i anoisesrc=d={}:r=8000:a=0.1"


def by_rtmp(path):
    """An FLV of a server that sends what H.264 says beside the images as packets of their own."""
    written(path.with_name("whole.flv"), f"{X264} -bf 0")
    data = path.with_name("whole.flv").read_bytes()
    made, at = data[:13], 13
    while at < len(data):
        size = int.from_bytes(data[at + 1 : at + 4], "big")
        tag, at = data[at : at + 11 + size + 4], at + 11 + size + 4
        if tag[0] == 9 and tag[12] == 1:
            message = bytes([6, 5, 20, *range(1, 21), 0x80])
            body = bytes([0x27]) + tag[12:16] + len(message).to_bytes(4, "big") + message
            made += b"\x09" + len(body).to_bytes(3, "big") + tag[4:11] + body
            made += (11 + len(body)).to_bytes(4, "big")
        made += tag
    path.write_bytes(made)


def of_rtmp(path):
    """The same in another container: twice as many samples as images."""
    by_rtmp(path.with_suffix(".flv"))
    ffmpeg("-i", path.with_suffix(".flv"), "-c", "copy", path)


def without_index(path):
    """An AVI of a recorder that writes no index, with sound."""
    lavfi = f"-f lavfi -i testsrc2=s=128x64:r=30:d=3 {TONE.format(3)}"
    ffmpeg(*f"{lavfi} -c:v mjpeg -pix_fmt yuvj420p -c:a pcm_s16le".split(), path)
    data = path.read_bytes()
    path.write_bytes(data[: data.rindex(b"idx1")])


def by_ffmpeg(before, options, source="testsrc2=s=128x64:r=30:d=3"):
    """A writer of what FFmpeg makes of a test film by these options."""
    return lambda path: ffmpeg(*f"{before} -f lavfi -i {source} {options}".split(), path)


def from_open_gop(path):
    """A copy from a key frame on, before which images are shown that need others."""
    x264 = "open-gop=1:keyint=15:min-keyint=15:scenecut=0:bframes=3:b-adapt=0"
    whole = written(path.with_name(f"whole{path.suffix}"), f"-c:v libx264 -x264-params {x264}")
    ffmpeg("-ss", 1.01, "-i", whole, "-c", "copy", path)


NTSC = "testsrc2=s=128x64:r=30000/1001:d=3"
# Sound videos of other writers.
SOUND = {
    "rtmp.flv": by_rtmp,
    "rtmp.mp4": of_rtmp,
    "rtmp.mkv": of_rtmp,
    "b-frames.flv": by_ffmpeg("", f"{X264} -bf 3"),
    "longer-sound.flv": by_ffmpeg(
        TONE.format(5), f"-map 1:v -map 0:a {X264} -bf 2 -c:a mp3 -ar 44100"
    ),
    "variable.mp4": by_ffmpeg("", f"-vf select='mod(n*n,7)' -fps_mode vfr {X264}"),
    "fragments.mp4": by_ffmpeg(
        TONE.format(4), f"-map 1:v -map 0:a {X264} -movflags frag_keyframe+empty_moov -c:a aac"
    ),
    "prores.mov": by_ffmpeg("", "-c:v prores_ks"),
    "open-gop.mkv": from_open_gop,
    "open-gop.mp4": from_open_gop,
    "without-index.avi": without_index,
    "ntsc.mkv": by_ffmpeg("-itsoffset 3", "-c:v libvpx-vp9 -g 15", NTSC),
    "odd-clock.mp4": by_ffmpeg("", f"{X264} -bf 2 -video_track_timescale 10007", NTSC),
}


@pytest.mark.parametrize("name", SOUND)
def test_sound_files_of_other_writers_are_not_accused(tmp_path, name):
    SOUND[name](tmp_path / name)
    for decoder in DECODERS:
        with open_video(tmp_path / name, decoder=decoder) as video:
            assert len(list(video)) >= 40, decoder
            assert video.progress.damage == [], decoder
