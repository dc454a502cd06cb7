"""Live sources: a camera, a stream, a pipe, or a file at its own pace. The newest frame wins."""

import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.video.base import PIXEL_FORMATS, Unreadable
from dlgmd_cli.video.luma import Levels, to_grey
from dlgmd_cli.video.opencv import guarded
from dlgmd_cli.video.opening import processed_size
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.region import Region, read_mask
from dlgmd_cli.video.source import Video

Image = npt.NDArray[Any]
Tell = Callable[[str], None]

SCHEMES = ("rtsp", "rtsps", "udp", "rtp", "tcp", "http", "https")
_EVEN = ("yuv420p", "nv12", "yuyv422")
_LIMITED = 16, 235
# FFmpeg is to hand on what has arrived, and to decode without frames in flight.
_STREAM_OPTIONS = {
    "protocol_whitelist": "rtsp,rtsps,rtp,srtp,udp,tcp,tls,http,https,httpproxy,crypto,data",
    "rtsp_transport": "tcp",
    "fflags": "nobuffer",
    "flags": "low_delay",
}
_TIMEOUT_MS = 5000
# Pauses before a lost source is tried again.
FIRST_PAUSE_S, MAX_PAUSE_S = 0.5, 30.0
# The rate of a source is measured over so many frames, and may exceed the limit by a tenth.
_N_MEASURED, _N_AT_LEAST, _SLACK, _PAUSE_S = 61, 10, 0.1, 1.0
# A file that is decoded so late plays on from there, instead of trying to catch up.
_MAX_LATE_S = 0.25
SHOWN_PX = 640


@dataclass(frozen=True)
class Shot:
    """A picture as it came from a source.

    `captured_s` is when it was there, by `time.monotonic`. `index` and `time_s` are those of a
    file; None where frames are only counted, and their time is that of their arrival.
    """

    image: Image
    levels: Levels
    captured_s: float
    index: int | None = None
    time_s: float | None = None


@dataclass(frozen=True)
class LiveFrame:
    """A frame as models take it.

    `index` counts the frames of the source, dropped ones too; `time_s` is the time since the first
    one, or the file's. `captured_s` is when it was there, by `time.monotonic`. `image` is the
    picture, (H, W, 3) BGR and at most 640 px wide, if someone wants to see it.
    """

    index: int
    time_s: float
    captured_s: float
    grey: Image
    image: Image | None = None


class LiveSource:
    """Reads a source on a thread of its own, and keeps its newest frame.

    All frames have the size that follows from the first picture.

    Parameters
    ----------
    name : str
        What messages call it.
    open_shots : callable
        Opens the source and yields what comes, until it ends or raises `Unreadable`. It is called
        with what takes a message.
    options : InputOptions
        `scale`, `size`, `fps`, `crop` and `mask`.
    width_px, model_fps : int, float
        What the model is made for; used where no option says otherwise.
    tries_again : bool
        Whether a source that was lost is opened again.
    must_open : bool
        Whether it is an error all the same if it cannot be opened the first time.

    Attributes
    ----------
    is_over : bool
        Whether no frame will come any more.
    n_frames, n_dropped, n_left_out : int
        Frames that came; of them, those that nobody took before the next one came, and those left
        out because of the frame rate.
    picture_wh, size_wh : (int, int)
        Width and height of the first picture, and of the frames; (0, 0) before it.
    wants_images : bool
        Set it for frames with their pictures.
    """

    def __init__(
        self,
        name: str,
        open_shots: Callable[[Tell], Iterator[Shot]],
        options: InputOptions,
        *,
        width_px: int,
        model_fps: float,
        tries_again: bool = False,
        must_open: bool = False,
    ) -> None:
        self.name, self._open_shots, self._options = name, open_shots, options
        self._width_px, self._tries_again, self._must_open = width_px, tries_again, must_open
        max_fps = model_fps if options.fps is None else options.fps
        self._pace = Pace(math.inf if max_fps == "all" else float(max_fps))
        self._masked = None if options.mask is None else read_mask(options.mask)
        self.is_over, self.wants_images = False, False
        self.n_frames = self.n_dropped = self.n_left_out = 0
        self.picture_wh = self.size_wh = self._latest_wh = (0, 0)
        self._region: Region | None = None
        self._first_s = math.nan
        self._newest: LiveFrame | None = None
        self._error: BaseException | None = None
        self._told: deque[str] = deque(maxlen=100)
        self._changed, self._stop = threading.Condition(), threading.Event()
        self._thread = threading.Thread(target=self._read, name="dlgmd-live", daemon=True)

    def __enter__(self) -> "LiveSource":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self._thread.join(timeout=0.1)  # a read that hangs is left behind

    def end(self) -> None:
        """Read no further; may be called from any thread."""
        self._stop.set()
        with self._changed:
            self.is_over = True
            self._changed.notify()

    def take(self, timeout_s: float) -> LiveFrame | None:
        """The newest frame that was not taken yet; None if there is none in time.

        Raises whatever made the source unusable for good.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._newest is not None or self.is_over, timeout_s)
            frame, self._newest = self._newest, None
            if frame is None and self._error is not None:
                raise self._error
            return frame

    def tell(self, message: str) -> None:
        """Leave a message for `messages`."""
        self._told.append(message)

    def messages(self) -> Iterator[str]:
        """What happened to the source since the last call, a line each."""
        while self._told:
            yield f"{self.name}: {self._told.popleft()}"

    def hidden(self) -> npt.NDArray[np.bool_] | None:
        """Which cells of a frame the mask leaves out, (H, W); None for none."""
        return None if self._region is None else self._region.hidden(self.size_wh)

    @property
    def fps(self) -> float:
        """The frame rate of the source, as measured lately; NaN before there are enough frames."""
        return self._pace.fps

    def _read(self) -> None:
        """Open the source, and again when it is lost, until it is over."""
        pause_s = FIRST_PAUSE_S
        try:
            while not self._stop.is_set():
                reason = "the source has ended"
                try:
                    for shot in self._open_shots(self.tell):
                        pause_s = FIRST_PAUSE_S
                        self._publish(shot)
                        if self._stop.is_set():
                            return
                except Unreadable as lost:
                    if not self._tries_again or (self._must_open and self.n_frames == 0):
                        raise SourceError(self.name, str(lost)) from None
                    reason = str(lost)
                if not self._tries_again:
                    return
                self.tell(f"{reason}; trying again in {pause_s:g} s")
                self._stop.wait(pause_s)
                pause_s = min(2.0 * pause_s, MAX_PAUSE_S)
        except BaseException as error:
            self._error = error
        finally:
            self.end()

    def _publish(self, shot: Shot) -> None:
        """Put the frame of a picture in place of the newest one."""
        if math.isnan(self._first_s):
            self._first_s = shot.captured_s
        index = self.n_frames if shot.index is None else shot.index
        time_s = shot.captured_s - self._first_s if shot.time_s is None else shot.time_s
        self.n_frames += 1
        is_due = self._pace.is_due(shot.captured_s)
        if shot.time_s is None and not is_due:
            self.n_left_out += 1
            return
        image = self._region_of(shot.image).of(shot.image)
        grey = to_grey(image, self.size_wh, shot.levels)
        shown = _shown(image, shot.levels) if self.wants_images else None
        with self._changed:
            self.n_dropped += self._newest is not None
            self._newest = LiveFrame(index, time_s, shot.captured_s, grey, shown)
            self._changed.notify()

    def _region_of(self, image: Image) -> Region:
        """What is looked at of a picture; of the first one, the size of all frames follows."""
        height, width = image.shape[:2]
        if self._region is not None and self._latest_wh == (width, height):
            return self._region
        crop = self._options.crop
        if crop and (crop.x + crop.width > width or crop.y + crop.height > height):
            why = f"--crop {crop} reaches outside its pictures of {width}x{height}"
            if self._region is not None:
                raise Unreadable(why)
            raise SourceError(self.name, why, "Choose a rectangle inside them.")
        if self._region is not None:
            self.tell(f"its pictures are {width}x{height} now, and are scaled")
        self._region = Region((width, height), crop, self._masked)
        self._latest_wh = width, height
        if self.size_wh == (0, 0):
            self.picture_wh = width, height
            self.size_wh = processed_size(
                *self._region.size_wh,
                scale=self._options.scale,
                size_wh=self._options.size,
                width_px=self._width_px,
            )
        self._region.hidden(self.size_wh)  # complains if nothing is left
        return self._region


class Pace:
    """Measures the rate of a source, and takes every k-th frame so that `max_fps` are left."""

    def __init__(self, max_fps: float) -> None:
        self._max_fps = max_fps
        self._times: deque[float] = deque(maxlen=_N_MEASURED)
        self._since_taken, self._every = 0, 1

    @property
    def fps(self) -> float:
        """Frames a second over the last two seconds or so; NaN before there are ten of them."""
        n_intervals = len(self._times) - 1
        if n_intervals < _N_AT_LEAST:
            return math.nan
        return n_intervals / max(self._times[-1] - self._times[0], 1e-6)

    def is_due(self, captured_s: float) -> bool:
        """Whether to take the frame that came at this time."""
        if self._times and captured_s - self._times[-1] > _PAUSE_S:
            self._times.clear()  # it was away, which says nothing about its rate
        self._times.append(captured_s)
        if not math.isnan(fps := self.fps):
            self._every = max(1, math.ceil(fps / self._max_fps - _SLACK))
        self._since_taken += 1
        if self._since_taken < self._every:
            return False
        self._since_taken = 0
        return True


def _shown(image: Image, levels: Levels) -> Image:
    """A picture to look at, (H, W, 3) BGR of 8 bits, at most 640 px wide."""
    height, width = image.shape[:2]
    scale = min(1.0, SHOWN_PX / width)
    size = max(1, round(width * scale)), max(1, round(height * scale))
    if image.ndim == 3 and image.dtype == np.uint8:
        return cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    grey = to_grey(image, size, levels)
    if grey.dtype != np.uint8:
        grey = np.rint(255.0 * grey).astype(np.uint8)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


# What can be a source.


def is_camera(source: str) -> bool:
    """Whether this is the number or the device of a camera: ``0``, ``/dev/video0``."""
    return source.isdecimal() or source.startswith("/dev/video")


def scheme_of(source: str) -> str:
    """What comes before ``://``, in small letters; empty for none."""
    match = re.match(r"([A-Za-z][A-Za-z0-9+.-]*)://", source)
    return match[1].lower() if match else ""


def without_password(source: str) -> str:
    """A URL without the user and password that it may hold."""
    return re.sub(r"(?<=://)[^/?#]*@", "", source)


def shots_of_capture(source: str, size_wh: tuple[int, int] | None, tell: Tell) -> Iterator[Shot]:
    """What a camera or a stream sends; `size_wh` is what a camera is asked for.

    Raises Unreadable if it cannot be opened or sends nothing for five seconds.
    """
    if is_camera(source):
        if not source.isdecimal() and not Path(source).exists():
            raise Unreadable("there is no such camera (ls /dev/video* lists them)")
        capture = cv2.VideoCapture(int(source) if source.isdecimal() else source)
        capture.set(cv2.CAP_PROP_BUFFERSIZE, 1)
        if size_wh is not None:
            capture.set(cv2.CAP_PROP_FRAME_WIDTH, size_wh[0])
            capture.set(cv2.CAP_PROP_FRAME_HEIGHT, size_wh[1])
        if not capture.isOpened():
            why = "the camera cannot be opened; it is not there, or another program uses it"
            raise Unreadable(why)
    else:
        limits = (cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, cv2.CAP_PROP_READ_TIMEOUT_MSEC)
        options = [cv2.CAP_PROP_N_THREADS, 1]
        for limit in limits:
            options += [limit, _TIMEOUT_MS]
        with guarded(_STREAM_OPTIONS):
            capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, options)
        if not capture.isOpened():
            raise Unreadable("the stream cannot be opened")
    try:
        image: Image | None = None
        while capture.grab():
            captured_s = time.monotonic()
            is_there, image = capture.retrieve(image)
            if is_there and image is not None and image.size:
                yield Shot(image, None, captured_s)
        raise Unreadable("the source was lost")
    except cv2.error:
        raise Unreadable("it sent a picture that cannot be decoded") from None
    finally:
        capture.release()


def shots_of_pipe(
    stream: BinaryIO, size_wh: tuple[int, int], pixel_format: str, tell: Tell
) -> Iterator[Shot]:
    """Raw frames from a pipe, one directly after the other, in one of the `PIXEL_FORMATS`.

    Raises ParameterError if the format has no frames of that size.
    """
    width, height = size_wh
    if pixel_format in _EVEN and (width % 2 or (height % 2 and pixel_format != "yuyv422")):
        why = f"{width}x{height} is odd, and {pixel_format} shares colours between two pixels"
        raise ParameterError("--input-size", why, "Send frames with even sides, or gray.")
    n_bytes = int(width * height * PIXEL_FORMATS[pixel_format])
    data = bytearray(n_bytes)
    while True:
        n_read = 0
        while n_read < n_bytes:
            n_more = stream.readinto(memoryview(data)[n_read:])  # type: ignore[attr-defined]
            if not n_more:
                if n_read:
                    tell(f"it ended within a frame, after {n_read} of {n_bytes} bytes")
                return
            n_read += n_more
        captured_s = time.monotonic()
        yield Shot(*_unpacked(np.frombuffer(data, np.uint8), size_wh, pixel_format), captured_s)


def _unpacked(data: Image, size_wh: tuple[int, int], pixel_format: str) -> tuple[Image, Levels]:
    """The picture in the bytes of a frame, and its levels; a view where that will do."""
    width, height = size_wh
    if pixel_format in ("bgr24", "rgb24"):
        picture = data.reshape(height, width, 3)
        is_bgr = pixel_format == "bgr24"
        return picture if is_bgr else cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), None
    if pixel_format == "yuyv422":
        return np.ascontiguousarray(data[::2].reshape(height, width)), _LIMITED
    luma = data[: width * height].reshape(height, width)
    return luma, None if pixel_format == "gray" else _LIMITED


def shots_at_their_pace(video: Video, tell: Tell) -> Iterator[Shot]:
    """The pictures of a file, each when its time has come.

    One that is decoded too late is handed on at once. If that happens all the time, the file plays
    slower, which is told.
    """
    begin_s, is_told = math.nan, False
    for picture in video.pictures():
        now_s = time.monotonic()
        if math.isnan(begin_s):
            begin_s = now_s - picture.time_s
        due_s = begin_s + picture.time_s
        if now_s > due_s + _MAX_LATE_S:
            begin_s += now_s - due_s
            due_s = now_s
            if not is_told:
                tell("it cannot be decoded at its own pace here, and plays slower")
                is_told = True
        while (left_s := due_s - time.monotonic()) > 0.0:
            time.sleep(left_s)
        yield Shot(picture.image, picture.levels, due_s, picture.index, picture.time_s)


def check_source(source: str, *, is_realtime: bool, has_size: bool) -> None:
    """Raise ParameterError unless this can be a live source."""
    scheme = scheme_of(source)
    if source == "-":
        if not has_size:
            mend = "Add, for example, --input-size 640x480 --pixel-format gray."
            raise ParameterError("-", "a pipe of raw frames needs --input-size", mend)
    elif scheme and scheme not in SCHEMES:
        known = ", ".join(f"{name}://" for name in SCHEMES)
        why = f"there is no kind of stream called {scheme}://"
        raise ParameterError(without_password(source), why, f"Choose from {known}.")
    elif not scheme and not is_camera(source) and not is_realtime:
        if Path(source).exists():
            mend = "Add --realtime to play it at its own pace, or use 'dlgmd run'."
            raise ParameterError(source, "is a file, not a live source", mend)
        mend = "Give a camera such as 0, a stream such as rtsp://…, - for a pipe, or a file."
        raise ParameterError(source, "there is no such source", mend)
    if is_realtime and (source == "-" or scheme or is_camera(source)):
        raise ParameterError("--realtime", "works only with files", "Leave it out.")
    if has_size and source != "-" and not is_camera(source):
        why = "works only with a pipe or a camera"
        raise ParameterError("--input-size", why, "Use --size for the frames of the model.")
