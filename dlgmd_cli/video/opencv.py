"""Video files decoded by OpenCV's FFmpeg backend."""

import math
from collections import deque
from collections.abc import Iterator
from pathlib import Path

import cv2

from dlgmd_cli.threads import thread_limit
from dlgmd_cli.video.ffmpeg import guarded
from dlgmd_cli.video.frames import (
    GRABS_PAST_DAMAGE,
    Decoded,
    Grab,
    Image,
    VideoFacts,
    plausible_fps,
)
from dlgmd_cli.video.watch import ResolutionWatch


class OpenCVDecoder:
    """The frames of a file as BGR pictures.

    Parameters
    ----------
    name : str
        The file; valid UTF-8 and no pattern.
    """

    def __init__(self, name: str) -> None:
        self.is_damaged = False
        self._name = name
        self._n_grabbed = 0
        self._capture: cv2.VideoCapture | None = None
        self._watch: ResolutionWatch | None = None
        self._images: deque[Image | None] = deque([None])

    def open(self) -> VideoFacts | None:
        """Open the file and decode its first frame; None if there is none."""
        self.is_damaged, self._n_grabbed = False, 0
        limit = thread_limit()
        options = [] if limit is None else [cv2.CAP_PROP_N_THREADS, limit]
        with guarded():
            capture = cv2.VideoCapture(self._name, cv2.CAP_FFMPEG, options)
        self._capture = capture
        self._watch = ResolutionWatch(self._name)
        if capture.isOpened():
            for _ in range(GRABS_PAST_DAMAGE):
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
        # FFmpeg has the bit rate of an MP4 from its size and the length that it shows.
        if not is_mp4 or kbit_per_s <= 0.0:
            return math.inf
        return 8e-3 * file.stat().st_size / kbit_per_s

    def grabs(self) -> Iterator[Grab]:
        """Every frame from the first on; once after each `open`."""
        capture, watch = self._capture, self._watch
        assert capture is not None and watch is not None
        is_grabbed = True  # by opening
        while True:
            is_damaged = not (is_grabbed or capture.grab())
            is_grabbed = False
            if is_damaged and not any(capture.grab() for _ in range(GRABS_PAST_DAMAGE)):
                return
            self.is_damaged = self.is_damaged or is_damaged
            stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            if stamp_s == 0.0 and self._n_grabbed > 0:  # as OpenCV says that there is none
                stamp_s = math.nan
            self._n_grabbed += 1
            yield Grab(stamp_s, watch.size_of_next(stamp_s))

    def keep(self, n_pictures: int) -> None:
        """From now on, leave an image as it is until so many more were asked for."""
        self._images = deque([None] * n_pictures)

    def picture(self) -> Decoded | None:
        """The frame grabbed last, see `keep`; None if it is damaged."""
        assert self._capture is not None
        try:
            is_there, image = self._capture.retrieve(self._images[0])
        except cv2.error:
            return None
        if not is_there or image is None or image.size == 0:
            return None
        # Memory that was used before spares the system to clear new pages.
        self._images[0] = image
        self._images.rotate()
        return Decoded(image)

    def close(self) -> None:
        """Free the file, so that it can be opened again; may be called twice."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None
        if self._watch is not None:
            self._watch.close()
            self._watch = None
