"""Decoding of video files by OpenCV's FFmpeg backend, as BGR pictures."""

import math
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import cv2

from dlgmd_cli.video.base import (
    FFMPEG_OPTIONS,
    MAX_SIDE,
    TOO_LARGE,
    StreamInfo,
    Unreadable,
    decoder_threads,
    openable,
    plausible_fps,
    require_memory,
)
from dlgmd_cli.video.luma import Image

# A damaged packet makes one read fail, the end of the stream all further ones. The decoder's
# threads may still hold pictures from before the damage.
_READS_PAST_DAMAGE = 32
_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_lock = threading.Lock()


class OpenCVDecoder:
    """Decodes the frames of a file as BGR pictures, once from first to last.

    OpenCV scales every frame to the size of the first one and does not report a change of size. The
    file's name must be valid UTF-8 and not a pattern. Raises Unreadable if no frame can be decoded.

    Notes
    -----
    ``CAP_PROP_CONVERT_RGB = 0`` gives the luma plane, and saves the conversion to BGR. But if the
    video states another matrix than BT.601 (most cameras state BT.709), OpenCV lets FFmpeg convert
    the plane to BT.601 by way of RGB. That is up to 80 levels off and slower than BGR. No property
    tells which videos these are, nor whether black is 0 or 16: yuvj420p is called I420 too.
    """

    takes_every_frame = False

    def __init__(self, name: str) -> None:
        self.is_damaged = False
        self._image: Image | None = None
        options = [cv2.CAP_PROP_N_THREADS, decoder_threads()]
        with guarded():
            self._capture = capture = cv2.VideoCapture(name, cv2.CAP_FFMPEG, options)
        if max(map(capture.get, (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT))) > MAX_SIDE:
            raise Unreadable(TOO_LARGE)
        height, width = self._first().shape[:2]
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self.stream_info = StreamInfo(
            width,
            height,
            plausible_fps(capture.get(cv2.CAP_PROP_FPS)),
            int(count) if 0 < count < 1e9 else None,
            _shown_s(Path(name), capture.get(cv2.CAP_PROP_BITRATE)),
            _four_letters(int(capture.get(cv2.CAP_PROP_FOURCC))),
        )

    def _first(self) -> Image:
        """The first decodable frame, with which `stamps` begins."""
        for _ in range(_READS_PAST_DAMAGE):
            if self._capture.grab():
                try:
                    return self.picture()[0]
                except Unreadable:
                    continue
        require_memory()
        raise Unreadable

    def stamps(self) -> Iterator[float]:
        """The timestamp of each frame in seconds, NaN where there is none."""
        capture = self._capture
        yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        while True:
            if not capture.grab():
                if not any(capture.grab() for _ in range(_READS_PAST_DAMAGE)):
                    return
                self.is_damaged = True
            # OpenCV gives 0 for a missing timestamp.
            yield capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0 or math.nan

    def picture(self) -> tuple[Image, None]:
        """The frame of the latest timestamp, valid until the next call."""
        try:
            is_there, image = self._capture.retrieve(self._image)
        except cv2.error:
            is_there, image = False, None
        if not is_there or image is None or image.size == 0:
            raise Unreadable("the file is damaged")
        # Reusing memory is faster: the system need not clear new pages.
        self._image = image
        return image, None

    def close(self) -> None:
        """Free the file; may be called twice."""
        self._capture.release()


def _four_letters(code: int) -> str:
    """A FOURCC as text, without unprintable characters."""
    letters = (code & 0xFFFFFFFF).to_bytes(4, "little").decode("latin-1")
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
