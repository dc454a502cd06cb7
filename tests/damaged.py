"""Videos as PyAV writes them, in any container and codec, at any times."""

from contextlib import contextmanager
from fractions import Fraction

import cv2
import numpy as np

try:
    import av
    from av.video.reformatter import VideoReformatter

    # One for all frames: each would set up its own, which takes longer than to encode it.
    _reformatter = VideoReformatter()
except ImportError:
    av = None


def encode(path, frames, codec, *, container=None, fps=25, options=None, **how):
    """Write grey frames, or those of PyAV; `how` is what `_framed` takes, and two more.

    These are `colour_range` and `colours`, the numbers of primaries, transfer and matrix.
    """
    how = {"pixels": "yuv420p", "colour_range": None, "stamps": None, "numbers": None} | how
    first, limit = frames[0], how.pop("colour_range")
    colours = how.pop("colours", (2, 2, 2))
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
        context = stream.codec_context
        context.color_primaries, context.color_trc, context.colorspace = colours
        for number, one in enumerate(frames):
            frame = _framed(one, number, stream, fps, **how)
            frame.color_primaries, frame.color_trc, frame.colorspace = colours
            if limit is not None:
                frame.color_range = limit
            file.mux(stream.encode(frame))
        file.mux(stream.encode(None))
    return path


def _framed(one, number, stream, fps, *, pixels, stamps, numbers):
    """A frame, at `stamps` milliseconds, or with gaps: at `numbers` / `fps`."""
    if not isinstance(one, av.VideoFrame):
        one = av.VideoFrame.from_ndarray(cv2.merge([one] * 3), format="rgb24")
        one = _reformatter.reformat(one, format=pixels)
    if stamps is not None:
        one.pts, one.time_base = int(stamps[number]), Fraction(1, 1000)
    elif numbers is not None:
        one.pts, one.time_base = int(numbers[number]), Fraction(1, fps)
    return one


def copied(source, target, *, first=0, shift=0):
    """The packets of a video from one on, `shift` ticks later, as ffmpeg -c copy writes them."""
    with remuxed(source, target) as (writer, copy, packets):
        for number, packet in enumerate(packets):
            if number >= first:
                packet.pts, packet.dts = packet.pts + shift, packet.dts + shift
                packet.stream = copy
                writer.mux(packet)
    return target


@contextmanager
def remuxed(source, target):
    """The writer of another file, the stream there, and the packets that may go into it."""
    with av.open(str(source)) as reader, av.open(str(target), "w") as writer:
        stream = reader.streams.video[0]
        packets = (packet for packet in reader.demux(stream) if packet.dts is not None)
        yield writer, writer.add_stream_from_template(stream), packets


def silence(n_samples, rate=8000, at=0):
    """Sound of so many samples, which begins at one."""
    frame = av.AudioFrame.from_ndarray(np.zeros((1, n_samples), np.int16), "s16", "mono")
    frame.sample_rate, frame.pts = rate, at
    return frame
