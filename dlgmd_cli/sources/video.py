"""Video files through OpenCV, read so that a damaged or unusual one still gives what it holds."""

import math
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2

from dlgmd_cli.errors import SourceError
from dlgmd_cli.sources.base import (
    FALLBACK_FPS,
    GRABS_PAST_DAMAGE,
    Image,
    Picture,
    Progress,
    Select,
    SourceInfo,
    Verdict,
    plausible_fps,
)
from dlgmd_cli.sources.times import FrameClock, HoleWatch
from dlgmd_cli.sources.watch import ResolutionWatch, count_packets

_DAMAGED = "the file is damaged"


class VideoReader:
    """Pictures of a video file by OpenCV's FFmpeg backend.

    Parameters
    ----------
    path : Path
        A file. Its name may hold anything: OpenCV never gets to read it as a pattern or an URL.
    fps : float, optional
        Frames per second where the file does not say; 30 unless given.

    Raises
    ------
    SourceError
        If no picture can be decoded.
    """

    info: SourceInfo
    progress: Progress

    def __init__(self, path: Path, fps: float | None = None) -> None:
        self._is_at_start = True
        self._fault: str | None = None
        self.progress = Progress()
        self._link_folder: tempfile.TemporaryDirectory[str] | None = None
        self._capture: cv2.VideoCapture | None = None
        self._watch: ResolutionWatch | None = None
        _check_readable(path)
        self._path = path
        self._name = self._openable(path.absolute())
        try:
            first = self._open()
        except BaseException:
            self.close()
            raise
        assert self._capture is not None
        stated = plausible_fps(self._capture.get(cv2.CAP_PROP_FPS))
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        height, width = first.shape[:2]
        self.info = SourceInfo(
            os.path.abspath(path),
            path.stem or path.name,
            width,
            height,
            stated or fps or FALLBACK_FPS,
            int(count) if 0 < count < 1e9 else None,
        )

    def _openable(self, path: Path) -> str:
        """A name for `path` that OpenCV opens as it is: no pattern, and valid UTF-8."""
        name = str(path)
        try:
            name.encode("utf-8")
            if "%" not in name:
                return name
        except UnicodeEncodeError:
            pass
        self._link_folder = tempfile.TemporaryDirectory(prefix="dlgmd-")
        # The suffix helps FFmpeg to recognise raw streams; an odd one may be part of the trouble.
        suffix = path.suffix if path.suffix[1:].isalnum() and path.suffix.isascii() else ""
        link = Path(self._link_folder.name) / f"video{suffix}"
        try:
            link.symlink_to(path)
        except OSError:  # not every system lets its users make links
            return name
        return str(link)

    def _open(self) -> Image:
        """Open the file and decode its first picture."""
        capture = cv2.VideoCapture(self._name, cv2.CAP_FFMPEG)
        self._capture = capture
        if capture.isOpened():
            for _ in range(GRABS_PAST_DAMAGE):
                if capture.grab():
                    image = _retrieve(capture, None)
                    if image is not None:
                        return image
        raise SourceError(
            str(self._path),
            "no frame could be decoded, damaged file or missing codec",
            "Try re-encoding it with ffmpeg.",
        )

    def pictures(self, select: Select) -> Iterator[Picture]:
        """Every picture that `select` takes, until the stream ends or breaks.

        The reading ends with a warning where the picture size changes (OpenCV would rescale what
        follows) and where damage leaves a gap; the pictures before it are whole.
        """
        clock, holes = FrameClock(self.info.fps), HoleWatch(self.info.fps)
        self.progress.n_decoded = 0
        self._fault = None
        image: Image | None = None
        for stamp_s in self._grabbed():
            index = self.progress.n_decoded
            time_s = clock.time(index, stamp_s)
            holes.add(index, time_s)
            verdict = select(time_s)
            if verdict is Verdict.STOP:
                break
            if verdict is Verdict.TAKE:
                image = _retrieve(self._capture, image)
                if image is None:
                    self._fault = _DAMAGED
                    break
            self.progress.n_decoded, self.progress.last_time_s = index + 1, time_s
            if verdict is Verdict.TAKE and image is not None:
                yield Picture(index, time_s, image)
        else:
            self._fault = self._fault or self._shortfall()
        reports = (clock.report(), holes.report(), self._fault_line())
        self.progress.warnings += [line for line in reports if line]
        self._release()

    def _grabbed(self) -> Iterator[float]:
        """Grab frame after frame and give each one's timestamp in seconds, NaN for none."""
        if not self._is_at_start:
            self._release()
            self._open()
        self._is_at_start = False
        capture = self._capture
        assert capture is not None
        self._watch = ResolutionWatch(self._name)
        is_grabbed = True  # by opening
        while True:
            damaged = not (is_grabbed or capture.grab())
            is_grabbed = False
            if damaged and not any(capture.grab() for _ in range(GRABS_PAST_DAMAGE)):
                return
            stamp_s = self._stamp()
            if damaged:
                self._fault = _DAMAGED
            if self._fault and stamp_s > self.progress.last_time_s + 1.5 / self.info.fps:
                return
            size = self._watch.size_of_next(stamp_s)
            if size is not None:
                self._fault = f"the picture size changes to {size[0]}x{size[1]}"
                return
            yield stamp_s

    def _stamp(self) -> float:
        """The timestamp of the frame grabbed last, in seconds; NaN where OpenCV has none."""
        assert self._capture is not None
        stamp_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        is_none = stamp_s == 0.0 and self.progress.n_decoded > 0  # as OpenCV says it
        return math.nan if is_none else stamp_s

    def _shortfall(self) -> str | None:
        """What is missing at the end of the stream, if anything; the stated count often lies."""
        n_frames, stated, fps = self.progress.n_decoded, self.info.n_frames, self.info.fps
        if stated is None or n_frames >= stated:
            return None
        end_s, shown_s = stated / fps, self._shown_s()
        if self.progress.last_time_s + 1.5 / fps < min(end_s, shown_s):
            # Some containers, AVI for one, number their frames anew behind a hole.
            return "frames are missing, the file is cut off or damaged on the way"
        if shown_s + 1.5 / fps < end_s:
            return None
        lost = (count_packets(self._name) or 0) - n_frames
        return f"{lost} frames could not be decoded, damaged file" if lost > 0 else None

    def _shown_s(self) -> float:
        """How much of its frames an MP4 shows, in seconds: its edit list may hide some."""
        assert self._capture is not None
        file = Path(self._name)
        with file.open("rb") as start:
            is_mp4 = start.read(8)[4:] == b"ftyp"
        # FFmpeg has the bit rate of an MP4 from its size and the length that it shows.
        kbit_per_s = self._capture.get(cv2.CAP_PROP_BITRATE)
        if not is_mp4 or kbit_per_s <= 0.0:
            return math.inf
        return 8e-3 * file.stat().st_size / kbit_per_s

    def _fault_line(self) -> str | None:
        """The warning for a reading that did not go as it should."""
        if self._fault is None:
            return None
        n_frames, stated = self.progress.n_decoded, self.info.n_frames
        of_stated = f" of about {stated}" if stated and stated > n_frames else ""
        until = f"{self.progress.last_time_s:.3f} s"
        return f"{self._fault}; decoded and used {n_frames}{of_stated} frames, up to {until}"

    def close(self) -> None:
        """Free the file; may be called twice."""
        self._release()
        if self._link_folder is not None:
            self._link_folder.cleanup()
            self._link_folder = None

    def _release(self) -> None:
        """Free the decoders, so that they can be opened again."""
        if self._capture is not None:
            self._capture.release()
            self._capture = None
        if self._watch is not None:
            self._watch.close()
            self._watch = None


def _check_readable(path: Path) -> None:
    """Say what OpenCV would not: why a file cannot be opened."""
    name = str(path)
    if not path.exists():
        raise SourceError(name, "there is no such file or folder", "Check the path.")
    if not path.is_file():
        raise SourceError(name, "it is neither a file nor a folder", "Give a video file.")
    try:
        with path.open("rb") as file:
            is_empty = not file.read(1)
    except OSError as error:
        raise SourceError(name, f"it cannot be read ({error.strerror})") from None
    if is_empty:
        raise SourceError(name, "the file is empty", "Copy or record it again.")


def _retrieve(capture: cv2.VideoCapture | None, buffer: Image | None) -> Image | None:
    """Decode the frame grabbed last, into `buffer` if it fits; None if that fails."""
    assert capture is not None
    try:
        decoded, image = capture.retrieve(buffer)
    except cv2.error:
        return None
    return image if decoded and image is not None and image.size else None
