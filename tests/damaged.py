"""Inputs that are damaged, unusual or no videos at all, each with what is expected of a run."""

import os
import wave
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
from conftest import looming_frames, write_video

try:
    import av
except ImportError:
    av = None

N_FRAMES = 12


@dataclass(frozen=True)
class Input:
    """A file, and whether a run over it is to end in an "error", "recovers", or "either"."""

    name: str
    path: Path
    expected: str = "either"


def all_inputs(folder):
    """Every input, made below `folder`, each beside others of its kind."""
    sound = sound_videos(_made(folder / "sound"))
    return [
        *(Input(path.name, path, "recovers") for path in sound),
        *no_videos(_made(folder / "none"), sound[0]),
        *unusual_videos(_made(folder / "unusual"), sound[0]),
        *cut_videos(_made(folder / "cut"), sound),
    ]


def sound_videos(folder):
    """The same few frames in every container and codec that can be written here."""
    frames = looming_frames(N_FRAMES, 64, 48)
    videos = [
        write_video(folder / "mjpg.avi", frames),
        write_video(folder / "mpeg4.mp4", frames, fourcc="mp4v"),
        write_video(folder / "ffv1.mkv", frames, fourcc="FFV1"),
    ]
    if av is not None:
        videos += [
            encode(folder / f"{name}", frames, codec)
            for name, codec in (
                ("h264.mkv", "libx264"),
                ("vp9.webm", "libvpx-vp9"),
                ("h264.ts", "libx264"),
                ("mpeg2.mpg", "mpeg2video"),
            )
            if codec in av.codecs_available
        ]
    return videos


def no_videos(folder, video):
    """What no frame can be had from."""
    random = np.random.default_rng(1)
    contents = {
        "zero.mp4": b"",
        "one_byte.mp4": b"\0",
        "text.mp4": b"hello, this is no video\n" * 50,
        "text.mkv": b"hello",
        "random.mp4": random.bytes(5000),
        "random.avi": b"RIFF" + random.bytes(5000),
        "playlist.m3u8": b"#EXTM3U\n#EXTINF:1,\nhttp://127.0.0.1:9/x.ts\n#EXT-X-ENDLIST\n",
        "concat.mp4": b"ffconcat version 1.0\nfile /dev/zero\n",
    }
    for name, content in contents.items():
        (folder / name).write_bytes(content)
    with wave.open(str(folder / "sound.mp4"), "wb") as sound:
        sound.setnchannels(1)
        sound.setsampwidth(2)
        sound.setframerate(8000)
        sound.writeframes(random.bytes(8000))
    names = [*contents, "sound.mp4"]
    if av is not None:
        names.append(audio_only(folder / "audio.mp4").name)
    (folder / "folder.mp4").mkdir()
    (folder / "dangling.mp4").symlink_to("nowhere.mp4")
    (folder / "loop.mp4").symlink_to("loop.mp4")
    names += ["folder.mp4", "dangling.mp4", "loop.mp4", "missing.mp4"]
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "fifo.mp4")
        names.append("fifo.mp4")
    if hasattr(os, "geteuid") and os.geteuid() != 0:  # to whom nothing is forbidden
        (folder / "secret.mp4").write_bytes(video.read_bytes())
        (folder / "secret.mp4").chmod(0)
        names.append("secret.mp4")
    devices = [path for path in ("/dev/zero", "/dev/full", "/dev/null") if os.path.exists(path)]
    return [
        *(Input(name, folder / name, "error") for name in names),
        *(Input(path, Path(path), "error") for path in devices),
    ]


def unusual_videos(folder, video):
    """What may be in a video, but seldom is."""
    frames = looming_frames(N_FRAMES, 64, 48)
    (folder / "avi_named.mp4").write_bytes(video.read_bytes())
    (folder / "no_suffix").write_bytes(video.read_bytes())
    made = [
        Input("avi_named.mp4", folder / "avi_named.mp4", "recovers"),
        Input("no_suffix", folder / "no_suffix", "recovers"),
        Input("one_frame", write_video(folder / "one.avi", frames[:1]), "error"),
    ]
    path = write_video(folder / "2x2.avi", looming_frames(N_FRAMES, 2, 2))
    made.append(Input(path.name, path))
    wide = np.tile(frames[0], (171, 128))[:8192, :8192]
    path = write_video(folder / "8192x8192.avi", [wide, 255 - wide, wide, 255 - wide])
    made.append(Input(path.name, path, "recovers"))
    jpegs = [
        cv2.imencode(".jpg", frame)[1].tobytes()
        for width in (48, 64)
        for frame in looming_frames(N_FRAMES, width, width)
    ]
    (folder / "two_sizes.mjpeg").write_bytes(b"".join(jpegs))
    made.append(Input("two_sizes.mjpeg", folder / "two_sizes.mjpeg"))
    return made + (_unusual_by_pyav(folder, frames) if av is not None else [])


def _unusual_by_pyav(folder, frames):
    """Those that OpenCV cannot write."""
    stamps = np.cumsum(np.random.default_rng(2).integers(1, 400, len(frames)))
    kinds = {
        "variable_rate.mkv": ("recovers", "libx264", {"stamps": stamps}),
        "huge_stamps.mkv": ("either", "libx264", {"stamps": np.arange(N_FRAMES) + 2**40}),
        "steps_of_days.mkv": ("either", "libx264", {"stamps": np.arange(N_FRAMES) * 10**9}),
        "ten_bit.mkv": ("recovers", "libx264", {"pixels": "yuv420p10le"}),
        "alpha.mov": ("recovers", "qtrle", {"pixels": "argb"}),
        "alpha_png.mov": ("recovers", "png", {"pixels": "rgba"}),
        "alpha.webm": ("recovers", "libvpx-vp9", {"pixels": "yuva420p"}),
        "interlaced.mkv": ("either", "libx264", {"options": {"x264-params": "tff=1"}}),
        "no_index.mp4": ("recovers", "libx264", {"container": {"movflags": "frag_keyframe"}}),
    }
    made = [
        Input(name, encode(folder / name, frames, codec, **how), expected)
        for name, (expected, codec, how) in kinds.items()
        if codec in av.codecs_available
    ]
    for width, height in ((33, 17), (1, 40), (40, 1)):
        odd = looming_frames(N_FRAMES, width, height)
        path = encode(folder / f"{width}x{height}.mov", odd, "png", pixels="rgb24")
        made.append(Input(path.name, path))
    if "libx264" not in av.codecs_available:
        return made
    pieces = [
        encode(folder / f"{width}.h264", looming_frames(N_FRAMES, width, 48), "libx264")
        for width in (64, 96)
    ]
    (folder / "two_sizes.h264").write_bytes(b"".join(piece.read_bytes() for piece in pieces))
    made.append(Input("two_sizes.h264", folder / "two_sizes.h264"))
    for n_dropped in (1, 3):
        path = folder / f"without_{n_dropped}.mkv"
        copied(made[0].path, path, first=n_dropped)
        made.append(Input(path.name, path))
    return made


def cut_videos(folder, videos):
    """Every video, cut off at every tenth of its length."""
    made = []
    for video in videos:
        data = video.read_bytes()
        for tenth in range(1, 10):
            path = folder / f"{tenth}-{video.name}"
            path.write_bytes(data[: len(data) * tenth // 10])
            made.append(Input(f"cut {path.name}", path))
    return made


def encode(path, frames, codec, *, container=None, fps=25, options=None, **how):
    """Write grey frames, or those of PyAV; `how` is what `_framed` takes, and `colour_range`."""
    how = {"pixels": "yuv420p", "colour_range": None, "stamps": None, "numbers": None} | how
    first, limit = frames[0], how.pop("colour_range")
    with av.open(str(path), "w", options=container or {}) as file:
        stream = file.add_stream(codec, rate=fps)
        is_made = isinstance(first, av.VideoFrame)
        stream.height, stream.width = (first.height, first.width) if is_made else first.shape
        stream.pix_fmt = first.format.name if is_made else how["pixels"]
        stream.options = {"g": "100", **(options or {})}
        if how["stamps"] is not None:
            stream.time_base = stream.codec_context.time_base = Fraction(1, 1000)
        if limit is not None:
            stream.codec_context.color_range = limit
        for number, one in enumerate(frames):
            frame = _framed(one, number, stream, fps, **how)
            if limit is not None:
                frame.color_range = limit
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def _framed(one, number, stream, fps, *, pixels, stamps, numbers):
    """A frame, at `stamps` milliseconds, or with gaps: at `numbers` / `fps`."""
    if not isinstance(one, av.VideoFrame):
        one = av.VideoFrame.from_ndarray(np.repeat(one[..., None], 3, 2), format="rgb24")
        one = one.reformat(format=pixels)
    if stamps is not None:
        one.pts, one.time_base = int(stamps[number]), Fraction(1, 1000)
    elif numbers is not None:
        one.pts, one.time_base = int(numbers[number]), Fraction(1, fps)
    return one


def copied(source, target, *, first=0, shift=0, keeps=lambda number: True):
    """The packets of a video from one on, `shift` ticks later, as ffmpeg -c copy writes them."""
    with av.open(str(source)) as reader, av.open(str(target), "w") as writer:
        stream = reader.streams.video[0]
        copy = writer.add_stream_from_template(stream)
        for number, packet in enumerate(reader.demux(stream)):
            if number >= first and packet.dts is not None and keeps(number):
                packet.pts, packet.dts = packet.pts + shift, packet.dts + shift
                packet.stream = copy
                writer.mux(packet)
    return target


def audio_only(path):
    """A file with sound and no image."""
    with av.open(str(path), "w") as file:
        codec = "aac" if path.suffix == ".mp4" else "pcm_s16le"
        stream = file.add_stream(codec, rate=8000, layout="mono")
        samples = np.random.default_rng(3).uniform(-1, 1, (1, 8000)).astype(np.float32)
        frame = av.AudioFrame.from_ndarray(samples, format="fltp", layout="mono")
        frame.sample_rate, frame.pts = 8000, 0
        file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def _made(folder):
    folder.mkdir(parents=True)
    return folder
