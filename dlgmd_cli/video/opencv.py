"""Video files decoded by OpenCV's FFmpeg backend, as BGR pictures."""

import math
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2

from dlgmd_cli.video.base import (
    FFMPEG_OPTIONS,
    READS_PAST_DAMAGE,
    Decoded,
    Grab,
    VideoFacts,
    decoder_threads,
    plausible_fps,
)
from dlgmd_cli.video.luma import Image

_VARIABLE = "OPENCV_FFMPEG_CAPTURE_OPTIONS"
_lock = threading.Lock()


class OpenCVDecoder:
    """The frames of a file as BGR pictures.

    Parameters
    ----------
    name : str
        The file; valid UTF-8 and no pattern.

    Notes
    -----
    OpenCV scales every frame to the size of the first one, and does not tell when the size changes.
    """

    def __init__(self, name: str) -> None:
        self.is_damaged = False
        self._name = name
        self._capture: cv2.VideoCapture | None = None
        self._image: Image | None = None

    def open(self) -> VideoFacts | None:
        """Open the file and decode its first frame; None if there is none."""
        self.is_damaged = False
        options = [cv2.CAP_PROP_N_THREADS, decoder_threads()]
        with guarded():
            capture = cv2.VideoCapture(self._name, cv2.CAP_FFMPEG, options)
        self._capture = capture
        if capture.isOpened():
            for _ in range(READS_PAST_DAMAGE):
                first = self.picture() if capture.grab() else None
                if first is not None:
                    return self._facts(capture, first.image)
        return None

    def _facts(self, capture: cv2.VideoCapture, first: Image) -> VideoFacts:
        """What the container states."""
        height, width = first.shape[:2]
        count = capture.get(cv2.CAP_PROP_FRAME_COUNT)
        return VideoFacts(
            width,
            height,
            plausible_fps(capture.get(cv2.CAP_PROP_FPS)),
            int(count) if 0 < count < 1e9 else None,
            self._shown_s(capture.get(cv2.CAP_PROP_BITRATE)),
        )

    def _shown_s(self, kbit_per_s: float) -> float:
        """How much of its frames an MP4 shows, in seconds: its edit list may hide some."""
        file = Path(self._name)
        with file.open("rb") as start:
            is_mp4 = start.read(8)[4:] == b"ftyp"
        # FFmpeg derives the bit rate of an MP4 from its size and the length that it shows.
        if not is_mp4 or kbit_per_s <= 0.0:
            return math.inf
        return 8e-3 * file.stat().st_size / kbit_per_s

    def grabs(self) -> Iterator[Grab]:
        """Every frame from the first on; once after each `open`."""
        capture = self._capture
        assert capture is not None
        is_grabbed = is_first = True  # by opening
        while True:
            if not is_grabbed:
                if not any(capture.grab() for _ in range(READS_PAST_DAMAGE)):
                    return
                self.is_damaged = True
            stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            # OpenCV says 0 where there is no timestamp.
            yield Grab(math.nan if stamp_s == 0.0 and not is_first else stamp_s)
            is_first = False
            is_grabbed = capture.grab()

    def picture(self) -> Decoded | None:
        """The frame grabbed last, in memory that the next one reuses; None if it is damaged."""
        assert self._capture is not None
        try:
            is_there, image = self._capture.retrieve(self._image)
        except cv2.error:
            return None
        if not is_there or image is None or image.size == 0:
            return None
        # Reused memory is faster: the system need not clear new pages.
        self._image = image
        return Decoded(image)

    def close(self) -> None:
        """Free the file, so that it can be opened again; may be called twice."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None


@contextmanager
def guarded() -> Iterator[None]:
    """While it lasts, OpenCV opens videos with `FFMPEG_OPTIONS` besides those the user has set.

    The environment is the only way to tell OpenCV. It is restored afterwards, for a program that
    opens a camera by itself.
    """
    with _lock:
        before = os.environ.get(_VARIABLE)
        ours = "|".join(f"{key};{value}" for key, value in FFMPEG_OPTIONS.items())
        os.environ[_VARIABLE] = f"{before}|{ours}" if before else ours
        try:
            yield
        finally:
            if before is None:
                del os.environ[_VARIABLE]
            else:
                os.environ[_VARIABLE] = before
