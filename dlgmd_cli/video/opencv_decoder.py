"""Decoding of video files by OpenCV's FFmpeg backend, as BGR images."""

import math
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path

import cv2

from dlgmd_cli.frame import Image
from dlgmd_cli.video import base
from dlgmd_cli.video.base import MAX_SIDE, MissingCodec, SourceInfo, Unreadable
from dlgmd_cli.video.containers import Stated, stated_by
from dlgmd_cli.video.timestamps import steady_fps

# A damaged packet makes one read fail, the end of the stream all further reads. The decoder's
# threads may still hold images from before the damage.
_READS_PAST_DAMAGE = 32
# OpenCV's names of grey pixels: 8 bits, and more than 8 bits in either byte order.
_GREY = ("Y800", "Y1", "1Y")
_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_lock = threading.Lock()


class OpenCVDecoder:
    """Decodes the frames of a file as BGR images, once from first to last.

    OpenCV scales every frame to the size of the first one and does not report a change of size. The
    file's name must be valid UTF-8 and not a pattern. Raises Unreadable if no frame can be decoded.

    Attributes
    ----------
    is_grey : bool
        Whether the images are grey. OpenCV treats grey as full range, whatever the video states.

    Notes
    -----
    OpenCV does not convert frames flagged as interlaced: each read returns the same memory
    unchanged.

    ``CAP_PROP_CONVERT_RGB = 0`` gives the luma plane, and saves the conversion to BGR. But if the
    video states another matrix than BT.601 (most cameras state BT.709), FFmpeg converts the plane
    to BT.601 by way of RGB: up to 80 levels off, and slower than BGR. No property of OpenCV reports
    the matrix, or whether black is 0 or 16: yuvj420p is also reported as I420.
    """

    kind = "opencv"
    takes_every_frame = False

    def __init__(self, name: str) -> None:
        self.is_damaged = False
        self._image: Image | None = None
        options = [cv2.CAP_PROP_N_THREADS, base.decoder_threads()]
        self._stated = stated = stated_by(Path(name))
        with guarded():
            self._capture = capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, options)
        if stated.orientation.is_mirrored:  # OpenCV does not mirror, and turns by a wrong angle
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if max(map(capture.get, (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))) > MAX_SIDE:
            raise Unreadable(base.TOO_LARGE)
        codec = _four_letters(capture.get(cv2.CAP_PROP_FOURCC))
        first = self._first(codec)
        height, width = first.shape[:2]
        fps = base.plausible_fps(capture.get(cv2.CAP_PROP_FPS))
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        n_frames = int(count) if 0 < count < 1e9 else None
        if stated.counts_from_0 and n_frames and fps:
            start_s = capture.get(cv2.CAP_PROP_PTS) / fps - capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
            n_frames = max(0, n_frames - round(start_s * fps)) or None
        info = SourceInfo(
            width,
            height,
            fps,
            n_frames,
            codec,
            remark=base.choice(stated.n_videos, 1, width, height),
            transfer=stated.colours.transfer_name,
        )
        self.info = with_true_rate(info, stated, name)
        self.is_grey = _four_letters(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT)) in _GREY

    def _first(self, codec: str) -> Image:
        """The first image that can be decoded."""
        for _ in range(_READS_PAST_DAMAGE):
            with suppress(Unreadable):
                if self._capture.grab():
                    return self._retrieved()
        base.require_memory()
        raise MissingCodec(codec) if self._capture.isOpened() else Unreadable

    def stamps(self) -> Iterator[float]:
        """The timestamp of each frame in seconds, NaN where there is none."""
        return true_stamps(self._stamps(), self._stated, self.info)

    def _stamps(self) -> Iterator[float]:
        """The timestamps as OpenCV gives them."""
        capture = self._capture
        yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        while True:
            if not capture.grab():
                if not any(capture.grab() for _ in range(_READS_PAST_DAMAGE)):
                    return
                self.is_damaged = True
            # OpenCV gives 0 for a missing timestamp.
            yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0 or math.nan

    def picture(self) -> Image:
        """The frame of the latest timestamp, valid until the next call."""
        return self._retrieved()

    def _retrieved(self) -> Image:
        """The frame that was grabbed last."""
        try:
            is_there, image = self._capture.retrieve(self._image)
        except cv2.error:
            is_there, image = False, None
        if not is_there or image is None or image.size == 0:
            raise Unreadable("the file is damaged")
        # Reusing memory is faster: the system need not clear new pages.
        self._image = image
        orientation = self._stated.orientation
        return orientation.upright(image) if orientation.is_mirrored else image

    def close(self) -> None:
        """Free the file; may be called twice."""
        self._capture.release()


def true_stamps(stamps: Iterator[float], stated: Stated, info: SourceInfo) -> Iterator[float]:
    """The timestamps of a decoder in seconds, NaN where the kind of file has none."""
    if stated.is_in_steps and info.fps_stated:
        return _in_steps(stamps, 1.0 / info.fps_stated)
    if stated.kind == "frames":
        return (math.nan for _ in stamps)
    return stamps


def _in_steps(stamps: Iterator[float], step_s: float) -> Iterator[float]:
    """Times in s from 0, from decoding times, which are shifted, and NaN for the last frames."""
    first_s = last_s = math.nan
    for stamp_s in stamps:
        last_s = last_s + step_s if math.isnan(stamp_s) else stamp_s
        first_s = last_s if math.isnan(first_s) else first_s
        yield last_s - first_s


def with_true_rate(info: SourceInfo, stated: Stated, name: str) -> SourceInfo:
    """`info` without the rate that FFmpeg guesses, or with the measured rate of a file in steps.

    A file with only decoding times may state its rate of fields.
    """
    if stated.kind == "frames":
        return replace(info, fps_stated=None, n_frames=None)
    fps = steady_fps(packet_times(name)) if stated.is_in_steps else None
    if not (fps and info.fps_stated):
        return info
    n_frames = round((info.n_frames or 0) * fps / info.fps_stated)
    return replace(info, fps_stated=fps, n_frames=n_frames or None)


def packet_times(name: str) -> Iterator[float]:
    """The time of each packet of a video in seconds, in the file's order."""
    with guarded():
        packets = cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])
    while packets.grab():
        yield packets.get(cv2.CAP_PROP_POS_MSEC) / 1000.0


def _four_letters(code: float) -> str:
    """A FOURCC as text, without unprintable characters."""
    letters = (int(code) & 0xFFFFFFFF).to_bytes(4, "little").decode("latin-1")
    return "".join(filter(str.isprintable, letters)).strip()


def count_frames(path: Path) -> int:
    """Number of frames that can be decoded from a video file."""
    try:
        with base.openable(path.absolute()) as name, closing(OpenCVDecoder(name)) as decoder:
            return sum(1 for _ in decoder.stamps())
    except Unreadable:
        return 0


@contextmanager
def guarded(options: Mapping[str, str] = base.FFMPEG_OPTIONS) -> Iterator[None]:
    """A context in which OpenCV opens videos with these options, added to the user's own.

    OpenCV takes them only from an environment variable. It is restored at the end: a program may
    open a camera itself.
    """
    ours = "|".join(f"{key};{value}" for key, value in options.items())
    with _lock:
        before = os.environ.get(_VARIABLE)
        os.environ[_VARIABLE] = f"{before}|{ours}" if before else ours
        try:
            yield
        finally:
            del os.environ[_VARIABLE]  # empty options would not be the same as none
            if before is not None:
                os.environ[_VARIABLE] = before
