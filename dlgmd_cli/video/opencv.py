"""Decoding of video files by OpenCV's FFmpeg backend, as BGR pictures."""

import math
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np

from dlgmd_cli.frame import Image
from dlgmd_cli.video.base import (
    FALLBACK_FPS,
    FFMPEG_OPTIONS,
    MAX_SIDE,
    TOO_LARGE,
    MissingCodec,
    StreamInfo,
    Unreadable,
    decoder_threads,
    openable,
    plausible_fps,
    require_memory,
)
from dlgmd_cli.video.orientation import of_mp4
from dlgmd_cli.video.timestamps import N_FIRST_STAMPS, steady_fps

# A damaged packet makes one read fail, the end of the stream all further ones. The decoder's
# threads may still hold pictures from before the damage.
_READS_PAST_DAMAGE = 32
_SEGMENT = b"\x18\x53\x80\x67"
_MATROSKA = b"\x1a\x45\xdf\xa3"
# How OpenCV calls grey pixels of 8 bits, and of more in either byte order.
_GREY = ("Y800", "Y1", "1Y")
_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_lock = threading.Lock()


class OpenCVDecoder:
    """Decodes the frames of a file as BGR pictures, once from first to last.

    OpenCV scales every frame to the size of the first one and does not report a change of size. The
    file's name must be valid UTF-8 and not a pattern. Raises Unreadable if no frame can be decoded.

    Attributes
    ----------
    is_still : bool
        Whether the second picture equals the first. Of frames that are flagged as interlaced,
        OpenCV converts none and gives the same memory again and again.
    is_default : bool
        Whether the stream that is read is the default one, as far as their facts differ.
    is_grey : bool
        Whether the pictures are grey. OpenCV takes them for full range, whatever the video states.

    Notes
    -----
    ``CAP_PROP_CONVERT_RGB = 0`` gives the luma plane, and saves the conversion to BGR. But if the
    video states another matrix than BT.601 (most cameras state BT.709), OpenCV lets FFmpeg convert
    the plane to BT.601 by way of RGB. That is up to 80 levels off and slower than BGR. No property
    tells which videos these are, nor whether black is 0 or 16: yuvj420p is called I420 too.
    """

    kind = "opencv"
    takes_every_frame = False

    def __init__(self, name: str) -> None:
        self.is_damaged = False
        self._image: Image | None = None
        options = [cv2.CAP_PROP_N_THREADS, decoder_threads()]
        with guarded():
            self._capture = capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, options)
        self._orientation = of_mp4(Path(name))
        if self._orientation.is_mirrored:  # OpenCV only turns, and would turn it wrongly
            capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
        if max(map(capture.get, (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))) > MAX_SIDE:
            raise Unreadable(TOO_LARGE)
        codec = _four_letters(capture.get(cv2.CAP_PROP_FOURCC))
        first = self._first(codec)
        height, width = first.shape[:2]
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        packets = _undecoded(name)
        self.is_default = not packets.isOpened() or _stream_of(packets) == _stream_of(capture)
        first_stamps = list(_first_stamps(packets))
        with Path(name).open("rb") as file:
            start = file.read(64)
        self._packets = packets if _is_whole_matroska(start, Path(name).stat().st_size) else None
        self._last_packet_s = max(first_stamps, default=0.0)
        self._is_avi = start[:4] == b"RIFF" and start[8:12] == b"AVI "
        if start[:4] == _MATROSKA:  # its length counts from 0, wherever it begins
            since_start = capture.get(cv2.CAP_PROP_POS_MSEC) * capture.get(cv2.CAP_PROP_FPS) / 1e3
            count -= max(0.0, capture.get(cv2.CAP_PROP_PTS) - since_start)
        self.stream_info = StreamInfo(
            width,
            height,
            plausible_fps(capture.get(cv2.CAP_PROP_FPS)),
            int(count) if 0 < count < 1e9 else None,
            _shown_s(Path(name), capture.get(cv2.CAP_PROP_BITRATE)),
            codec,
            steady_fps=steady_fps(first_stamps),
        )
        pixels = _four_letters(capture.get(cv2.CAP_PROP_CODEC_PIXEL_FORMAT))
        self.is_grey = pixels in _GREY
        self._start: list[tuple[float, Image | None]]
        self._kept: Image | None = None
        self._rest = self._grabbed()
        self.is_still = self._second_repeats(first)

    def _first(self, codec: str) -> Image:
        """The first picture that can be decoded."""
        for _ in range(_READS_PAST_DAMAGE):
            if self._capture.grab():
                try:
                    return self._retrieved()
                except Unreadable:
                    continue
        require_memory()
        raise MissingCodec(codec) if self._capture.isOpened() else Unreadable

    def _second_repeats(self, first: Image) -> bool:
        """Whether the second picture equals the first; both are kept for `stamps`."""
        self._start = [(self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0, first)]
        stamp_s = next(self._rest, None)
        if stamp_s is None:
            return False
        self._image = None
        try:
            self._start.append((stamp_s, self._retrieved()))
        except Unreadable:  # `picture` tries again
            self._start.append((stamp_s, None))
        second = self._start[1][1]
        return second is not None and np.array_equal(first, second)

    def stamps(self) -> Iterator[float]:
        """The timestamp of each frame in seconds, NaN where there is none."""
        fps = self.stream_info.fps
        return _in_steps(self._stamps(), 1.0 / fps) if self._is_avi and fps else self._stamps()

    def _stamps(self) -> Iterator[float]:
        """The timestamps as OpenCV gives them."""
        for stamp_s, picture in self._start:
            self._kept = picture
            yield stamp_s
        self._kept = None
        yield from self._rest

    def _grabbed(self) -> Iterator[float]:
        """The timestamps from the second frame on."""
        capture, last_s = self._capture, 0.0
        while True:
            if not capture.grab():
                if not any(capture.grab() for _ in range(_READS_PAST_DAMAGE)):
                    self._find_end(last_s)
                    return
                self.is_damaged = True
            last_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            # OpenCV gives 0 for a missing timestamp.
            yield last_s or math.nan

    def _find_end(self, last_s: float) -> None:
        """Of a whole Matroska file, let the video end with its last packet.

        The length that the file states is that of its longest stream, such as sound. Nothing is to
        be found out if the last frame, at `last_s`, is there.
        """
        fps, n_frames = self.stream_info.fps or FALLBACK_FPS, self.stream_info.n_frames or 0
        if self._packets is None or last_s + 1.5 / fps >= n_frames / fps:
            return
        while self._packets.grab():
            stamp_s = self._packets.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            self._last_packet_s = max(self._last_packet_s, stamp_s)
        self.stream_info = self.stream_info._replace(shown_s=self._last_packet_s + 1.0 / fps)

    def picture(self) -> tuple[Image, None]:
        """The frame of the latest timestamp, valid until the next call."""
        return (self._retrieved() if self._kept is None else self._kept), None

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
        return self._orientation.upright(image) if self._orientation.is_mirrored else image

    def close(self) -> None:
        """Free the file; may be called twice."""
        self._start.clear()
        self._capture.release()
        if self._packets is not None:
            self._packets.release()


def _is_whole_matroska(start: bytes, n_bytes: int) -> bool:
    """Whether a file that starts like this is Matroska, and as long as its header states."""
    at = len(_MATROSKA)
    if start[:at] != _MATROSKA:
        return False
    for is_segment in (False, True):  # the header, then all the rest
        if is_segment and start[at : at + 4] != _SEGMENT:
            return False
        at += 4 * is_segment
        first = start[at] if at < len(start) else 0
        n = 9 - first.bit_length()  # bytes of the size that follows
        if n > 8:
            return False
        size = int.from_bytes(start[at : at + n], "big") & ~(1 << 7 * n)
        at += n + size
    return at <= n_bytes and size != (1 << 7 * n) - 1  # that means unknown


def _in_steps(stamps: Iterator[float], step_s: float) -> Iterator[float]:
    """The times of an AVI from 0. OpenCV's are those of decoding: late, and none at the end."""
    first_s = last_s = math.nan
    for stamp_s in stamps:
        last_s = last_s + step_s if math.isnan(stamp_s) else stamp_s
        first_s = last_s if math.isnan(first_s) else first_s
        yield last_s - first_s


def _undecoded(name: str) -> cv2.VideoCapture:
    """The packets of the default video stream; decoded, OpenCV reads the first stream instead."""
    with guarded():
        return cv2.VideoCapture(name, cv2.CAP_FFMPEG, [cv2.CAP_PROP_FORMAT, -1])


def _stream_of(capture: cv2.VideoCapture) -> tuple[float, ...]:
    """What tells one video stream of a file from another, however it is turned."""
    sides = cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT
    others = cv2.CAP_PROP_FRAME_COUNT, cv2.CAP_PROP_FPS, cv2.CAP_PROP_FOURCC
    return (*sorted(map(capture.get, sides)), *map(capture.get, others))


def _first_stamps(packets: cv2.VideoCapture) -> Iterator[float]:
    """The times of a video's first packets in seconds, in the order of the file."""
    for _ in range(N_FIRST_STAMPS):
        if not packets.grab():
            break
        yield packets.get(cv2.CAP_PROP_POS_MSEC) / 1000.0


def _four_letters(code: float) -> str:
    """A FOURCC as text, without unprintable characters."""
    letters = (int(code) & 0xFFFFFFFF).to_bytes(4, "little").decode("latin-1")
    return "".join(filter(str.isprintable, letters)).strip()


def _shown_s(file: Path, kbit_per_s: float) -> float:
    """Duration that the edit list of an MP4 leaves visible, in seconds; else infinite."""
    with file.open("rb") as start:
        is_mp4 = start.read(8)[4:] == b"ftyp"
    # FFmpeg derives the bit rate of an MP4 from its size and its visible duration.
    if not is_mp4 or kbit_per_s <= 0.0:
        return math.inf
    return 8e-3 * file.stat().st_size / kbit_per_s


def count_frames(path: Path) -> int:
    """Number of frames that can be decoded from a video file."""
    try:
        with openable(path.absolute()) as name:
            decoder = OpenCVDecoder(name)
    except Unreadable:
        return 0
    n_frames = sum(1 for _ in decoder.stamps())
    decoder.close()
    return n_frames


@contextmanager
def guarded(options: Mapping[str, str] = FFMPEG_OPTIONS) -> Iterator[None]:
    """While it lasts, OpenCV opens videos with these options besides those the user has set.

    The environment is the only way to tell OpenCV. It is restored afterwards, for a program that
    opens a camera by itself.
    """
    with _lock:
        before = os.environ.get(_VARIABLE)
        ours = "|".join(f"{key};{value}" for key, value in options.items())
        os.environ[_VARIABLE] = f"{before}|{ours}" if before else ours
        try:
            yield
        finally:
            if before is None:
                del os.environ[_VARIABLE]
            else:
                os.environ[_VARIABLE] = before
