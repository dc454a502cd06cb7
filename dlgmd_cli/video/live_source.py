"""Live sources: cameras, streams, pipes, and files at their own pace. Old frames are dropped."""

import logging
import math
import re
import threading
import time
from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing
from dataclasses import KW_ONLY, dataclass, replace
from itertools import count
from pathlib import Path
from typing import BinaryIO

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, SourceError, argument
from dlgmd_cli.frame import FULL, Frame, Image, Levels, small_wh
from dlgmd_cli.machine.threads import started_thread
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.reduction import Reducer
from dlgmd_cli.stream.clock import StreamClock
from dlgmd_cli.stream.continuity import Continuity, GapDetector
from dlgmd_cli.stream.intake import Intake, Placed
from dlgmd_cli.video.base import PIXEL_FORMATS, Unreadable, without_password
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.luma import Region, grey_at_sizes, read_mask, to_bgr
from dlgmd_cli.video.opencv_decoder import guarded
from dlgmd_cli.video.opening import processed_size
from dlgmd_cli.video.source import Video

_log = logging.getLogger(__name__)

SCHEMES = ("rtsp", "rtsps", "udp", "rtp", "tcp", "http", "https")
_EVEN = ("yuv420p", "nv12", "yuyv422")
_LIMITED = 16, 235
# FFmpeg delivers frames as they arrive: no buffering, and no decoding of several frames at a time.
_STREAM_OPTIONS = {
    "protocol_whitelist": "rtsp,rtsps,rtp,srtp,udp,tcp,tls,http,https,httpproxy,crypto,data",
    "rtsp_transport": "tcp",
    "fflags": "nobuffer",
    "flags": "low_delay",
}
# The description of an RTP session is a file; the session's packets come by RTP.
_SESSION_OPTIONS = {**_STREAM_OPTIONS, "protocol_whitelist": "file,rtp,srtp,udp,crypto"}
# Longest waits for opening, for a frame, and for the first key frame. Reading goes on after shorter
# stalls: a stream that is opened again shows nothing until its next key frame.
_OPEN_TIMEOUT_MS, _READ_TIMEOUT_MS, _KEY_FRAME_S = 5000, 5000, 12.0
# The pause before a lost source is opened again doubles from the first value up to the second in
# the first `_NEW_S` seconds, and up to the third later.
FIRST_PAUSE_S, MAX_PAUSE_S, MAX_LATER_PAUSE_S, _NEW_S = 0.5, 2.0, 30.0, 60.0
# A file whose frame is decoded later than this does not catch up: it plays on from that frame.
MAX_LATE_S = 0.25
# Pause before a file plays again: long enough to be a gap for a model at 5 frames/s or more, too
# short for a lost source.
SEAM_S = 0.75
SHOWN_PX = 640
# Number of frames that wait to be taken, and the seconds that they may span.
_MAX_WAITING, _MAX_SPAN_S = 16, 0.3


@dataclass(frozen=True)
class Shot:
    """An image from a source, before it is turned and reduced.

    `captured_s` is the time of arrival, by `time.monotonic`. Files give `index` and `time_s`. For
    other sources, both are None: frames are counted, and their times follow from the arrivals or
    from `stamp_s`, the stream's own time, NaN for none.

    For a file, `region` is the part of the image that was read, and `is_repeat` and `after_gap` say
    how the image follows the previous one, see `Frame`.
    """

    image: Image
    levels: Levels
    captured_s: float
    index: int | None = None
    time_s: float | None = None
    stamp_s: float = math.nan
    region: Region | None = None
    is_repeat: bool = False
    after_gap: bool = False


@dataclass(eq=False, repr=False)
class LiveSource:
    """Reads a source on a thread of its own, and keeps its newest frames.

    All frames have the size that follows from the first image. The `index` of a frame counts
    dropped frames too. `time_s` is the time of capture since the first frame, see `StreamClock`, or
    the file's own time.

    Parameters
    ----------
    name : str
        The source's name in messages and records, without passwords.
    open_shots : callable
        Opens the source and yields its images, until it ends or raises `Unreadable`.
    options : InputOptions
        `scale`, `size`, `fps`, `repeats`, `crop` and `mask`.
    width_px, model_fps : int, float
        Design width and rate of the model; defaults of the options.
    tries_again : bool
        Whether a lost source is opened again.
    must_open : bool
        Whether a failure of the first opening is an error in spite of `tries_again`.
    rotate, flip : int, bool
        Turn all images clockwise by 0, 90, 180 or 270 degrees, then swap left and right.
    drops : bool
        Whether frames that nobody takes in time are dropped. If False, the source waits
        until the frame is taken.
    may_pause : bool
        Whether a source without frames for long still counts as present, like a paused simulator.

    Attributes
    ----------
    is_over : bool
        Whether the source has ended for good.
    is_lost : bool
        Whether the source has ended and is to be opened again.
    heard_s : float
        Time of the last frame by `time.monotonic`; before the first, of the beginning.
    first_s : float
        Time of the first frame, whose `time_s` is 0; NaN before the first frame.
    n_frames, n_dropped, n_left_out : int
        Number of frames that came; of these, dropped frames (because of `every`, or because nobody
        took them in time), and frames left out because of the frame rate.
    picture_wh, size_wh, small_wh : (int, int)
        Width and height of the first image, the frames, and the small frames; (0, 0) before.
    region : Region or None
        The part of the turned images that is processed; None before the first image.
    wants_pictures, keeps_pictures : bool
        Whether frames have their images: while the page is open, or all the time.
    every : int
        One in `every` frames is to be taken; the others are dropped. See `take_every`.
    """

    name: str
    open_shots: Callable[[], Generator[Shot, None, None]]
    options: InputOptions
    _: KW_ONLY
    width_px: int
    model_fps: float
    tries_again: bool = False
    must_open: bool = False
    rotate: int = 0
    flip: bool = False
    drops: bool = True
    may_pause: bool = False

    def __post_init__(self) -> None:
        options = self.options
        max_fps = self.model_fps if options.fps is None else options.fps
        self._masked = None if options.mask is None else read_mask(options.mask)
        self.is_over = self.wants_pictures = self.keeps_pictures = self.is_lost = False
        self.n_frames = self.n_dropped = self.n_left_out = 0
        self.heard_s, self.first_s = time.monotonic(), math.nan
        self.picture_wh = self.size_wh = self.small_wh = (0, 0)
        self.region: Region | None = None
        # What the source does to its images is unknown: most cameras and networks code them.
        self._continuity = Continuity(skips_repeats=options.repeats != "keep", is_coded=True)
        self._intake = Intake(
            self._continuity,
            math.inf if max_fps == "all" else float(max_fps),
            StreamClock(self.model_fps),
        )
        self._gaps = GapDetector()  # of the frames that are taken
        self._waiting, self.every, self._n_to_drop = deque[Frame](), 1, 0
        # Whether all frames that were dropped are repeats, and whether one follows a gap.
        self._before = True, False
        self._reducer = Reducer()
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._stop = threading.Event()

    def __enter__(self) -> "LiveSource":
        self.heard_s = time.monotonic()
        self._thread = started_thread(self._read, "dlgmd-live")
        return self

    def __exit__(self, *_: object) -> None:
        self.end()
        self._thread.join(timeout=0.1)  # a hanging read must not delay the exit

    def end(self) -> None:
        """Stop reading; may be called from any thread."""
        self._stop.set()
        with self._changed:
            self.is_over = True
            self._changed.notify_all()

    def take(self, timeout_s: float) -> Frame | None:
        """The oldest frame that waits; None if none comes in time.

        At most 16 frames wait, of the last 0.3 s; older ones are dropped.

        Raises the error that made the source unusable for good.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self.is_over, timeout_s)
            if not self._waiting:
                if self._error is not None:
                    raise self._error
                return None
            frame = self._waiting.popleft()
            self._changed.notify_all()
        if self._gaps.step(frame.time_s) and self.n_dropped:
            return replace(frame, is_repeat=False, after_gap=True)
        return frame

    def hidden(self) -> tuple[npt.NDArray[np.bool_] | None, npt.NDArray[np.bool_] | None]:
        """The cells that the mask hides, (H, W), in a frame and a small frame; None for none."""
        if self.region is None:
            return None, None
        return self.region.hidden(self.size_wh), self.region.hidden(self.small_wh)

    @property
    def fps(self) -> float:
        """Frame rate of the source over the latest frames; NaN before there are enough."""
        return self._intake.pace.fps

    @property
    def taken_fps(self) -> float:
        """Rate of the frames that are not left out; NaN before there are enough frames."""
        return self.fps / max(1, self._intake.pace.every)

    def _read(self) -> None:
        """Open and read the source, and open a lost source again, until it has ended for good."""
        lost_s, pause_s, logged = time.monotonic(), FIRST_PAUSE_S, ""
        try:
            while not self._stop.is_set():
                reason = "the source has ended"
                try:
                    with closing(self.open_shots()) as shots:
                        for shot in shots:
                            if self._stop.is_set():
                                return
                            lost_s, pause_s, logged = time.monotonic(), FIRST_PAUSE_S, ""
                            self._publish(shot)
                except Unreadable as lost:
                    if not self.tries_again or (self.must_open and self.region is None):
                        raise SourceError(self.name, str(lost)) from None
                    reason = str(lost)
                if not self.tries_again:
                    return
                self.is_lost = True
                if reason != logged:
                    _log.warning("%s: %s; trying again", self.name, reason)
                    logged = reason
                limit_s = MAX_PAUSE_S if time.monotonic() - lost_s < _NEW_S else MAX_LATER_PAUSE_S
                self._stop.wait(min(pause_s, limit_s))
                pause_s = min(2.0 * pause_s, MAX_LATER_PAUSE_S)
        except BaseException as error:
            self._error = error
        finally:
            self.end()

    def _publish(self, shot: Shot) -> None:
        """Make the frame of an image the newest frame."""
        image = self._visible(shot)
        self.is_lost, index = False, self.n_frames if shot.index is None else shot.index
        self.n_frames, self.heard_s = self.n_frames + 1, time.monotonic()
        if shot.time_s is None:
            placed = self._placed(shot, image)
        else:
            self._intake.pace.is_due(shot.time_s)
            placed = Placed(shot.time_s, shot.is_repeat, shot.after_gap)
        if placed is None:
            self.n_left_out += 1
            return
        time_s, is_repeat, after_gap = placed
        is_repeat, after_gap = is_repeat and self._before[0], after_gap or self._before[1]
        if self._n_to_drop > 0:
            self._before, self._n_to_drop = (is_repeat, after_gap), self._n_to_drop - 1
            self.n_dropped += 1
            return
        self._before, self._n_to_drop = (True, False), self.every - 1
        sizes = {self.size_wh, self.small_wh}
        greys = grey_at_sizes(image, sizes, shot.levels, self._reducer)
        shown_wh = processed_size(image.shape[1], image.shape[0], width_px=SHOWN_PX)
        is_seen = self.wants_pictures or self.keeps_pictures
        shown = to_bgr(image, shown_wh, shot.levels) if is_seen else None
        frame = Frame(
            index,
            time_s,
            greys[self.size_wh],
            is_repeat,
            after_gap,
            picture=shown,
            captured_s=shot.captured_s,
            small=greys[self.small_wh],
        )
        self._put(frame)

    def _put(self, frame: Frame) -> None:
        """Make a frame ready to be taken; frames that nobody took in time are dropped."""
        with self._changed:
            if not self.drops:
                self._changed.wait_for(lambda: not self._waiting or self.is_over)
            self._waiting.append(frame)
            oldest_s = frame.captured_s - _MAX_SPAN_S
            while len(self._waiting) > _MAX_WAITING or self._waiting[0].captured_s < oldest_s:
                oldest = self._waiting.popleft()
                self._waiting[0] = self._waiting[0].in_place_of(oldest)
                self.n_dropped += 1
            self._changed.notify_all()

    def take_every(self, every: int) -> None:
        """Drop all but one in `every` frames from now on, also of those that wait."""
        with self._changed:
            frames = [*self._waiting]
            self._waiting.clear()
            for number, frame in enumerate(reversed(frames)):  # the newest one stays
                if number % every == 0:
                    self._waiting.appendleft(frame)
                else:
                    self._waiting[0] = self._waiting[0].in_place_of(frame)
                    self.n_dropped += 1
            self.every = every
            self._n_to_drop = every - 1 if self._waiting else min(self._n_to_drop, every - 1)

    def _placed(self, shot: Shot, image: Image) -> Placed | None:
        """The image's time since the first one, and how it follows; None if it is left out."""
        placed = self._intake.place(image, shot.captured_s, shot.stamp_s)
        if doubts := self._intake.doubts():
            _log.warning("%s: its frames come %s", self.name, doubts)
        if placed is None:
            return None
        if math.isnan(self.first_s):
            self.first_s = placed.time_s
        return placed._replace(time_s=placed.time_s - self.first_s)

    def _visible(self, shot: Shot) -> Image:
        """The processed part of an image, turned; the first image determines all sizes."""
        image, region = shot.image, shot.region
        if region is None or self.rotate or self.flip:
            image = turned(image, self.rotate, self.flip)
            region = self._region_of(image)
            image = region.of(image)
        if self.region is None:
            self.picture_wh, self.small_wh = region.picture_wh, small_wh(*region.size_wh)
            self.size_wh = processed_size(
                *region.size_wh,
                scale=self.options.scale,
                size_wh=self.options.size,
                width_px=self.width_px,
            )
            if why := region.lacks(self.size_wh):
                refuse({"size": self.options.size}, f"has no effect: {why}")
        if region is not self.region:
            region.hidden(self.size_wh)  # raises ParameterError if no cell is left
            self._continuity.begin(region.hidden(region.size_wh), shot.levels)
            self.region = region
        return image

    def _region_of(self, image: Image) -> Region:
        """The region of a turned image: the previous one if the image's size has not changed."""
        before, crop, picture_wh = self.region, self.options.crop, (image.shape[1], image.shape[0])
        if before is not None and before.picture_wh == picture_wh:
            return before
        if crop and (why := crop.overhang(picture_wh)):
            if before is not None:
                raise Unreadable(why)
            raise SourceError(self.name, why, "Choose a rectangle inside them.")
        if before is not None:
            _log.warning("%s: its frames are %dx%d now, and are scaled", self.name, *picture_wh)
        return Region(picture_wh, crop, self._masked)


def turned(image: Image, rotate: int, flip: bool) -> Image:
    """An image turned clockwise by 0, 90, 180 or 270 degrees, then left and right swapped."""
    ways = {90: cv2.ROTATE_90_CLOCKWISE, 180: cv2.ROTATE_180, 270: cv2.ROTATE_90_COUNTERCLOCKWISE}
    image = cv2.rotate(image, ways[rotate]) if rotate else image
    return cv2.flip(image, 1) if flip else image


def is_camera(source: str) -> bool:
    """Whether the source is a camera's number or device: ``0``, ``/dev/video0``."""
    return source.isdecimal() or source.startswith("/dev/video")


def is_session(source: str) -> bool:
    """Whether the source is a file that describes an RTP session, as H.264 over RTP needs."""
    return source.lower().endswith(".sdp") and not scheme_of(source)


def scheme_of(source: str) -> str:
    """The scheme of a URL, in lower case; empty for none."""
    match = re.match(r"([A-Za-z][A-Za-z0-9+.-]*)://", source)
    return match[1].lower() if match else ""


def shots_of_capture(source: str, size_wh: tuple[int, int] | None) -> Generator[Shot, None, None]:
    """The images of a camera or a stream; `size_wh` is requested from a camera.

    Raises Unreadable if the source cannot be opened, or sends nothing for five seconds.
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
        options = [cv2.CAP_PROP_N_THREADS, 1, cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, _OPEN_TIMEOUT_MS]
        options += [cv2.CAP_PROP_READ_TIMEOUT_MSEC, _READ_TIMEOUT_MS]
        with guarded(_SESSION_OPTIONS if is_session(source) else _STREAM_OPTIONS):
            capture = cv2.VideoCapture(source, cv2.CAP_FFMPEG, options)
        if not capture.isOpened():
            raise Unreadable("the stream cannot be opened")
    try:
        image: Image | None = None
        patience_s = math.inf if is_camera(source) else _READ_TIMEOUT_MS / 1e3
        first_by_s = time.monotonic() + (0.0 if is_camera(source) else _KEY_FRAME_S)
        while True:
            asked_s = time.monotonic()
            is_grabbed, captured_s = capture.grab(), time.monotonic()
            if not is_grabbed and image is None and captured_s < first_by_s:
                time.sleep(0.01)  # packets before the first key frame cannot be decoded
                continue
            # After a read timeout, FFmpeg returns old images that its decoder still held.
            if not is_grabbed or captured_s - asked_s >= patience_s:
                raise Unreadable("the source was lost")
            is_there, image = capture.retrieve(image)
            if is_there and image is not None and image.size:
                stamp_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3
                yield Shot(image, FULL, captured_s, stamp_s=stamp_s)
    except cv2.error:
        raise Unreadable("it sent a frame that cannot be decoded") from None
    finally:
        capture.release()


def shots_of_pipe(
    stream: BinaryIO, size_wh: tuple[int, int], pixel_format: str, fps: float | None = None
) -> Generator[Shot, None, None]:
    """Raw frames from a pipe, without bytes in between, in one of the `PIXEL_FORMATS`.

    With a rate `fps`, the times follow from the frames' numbers, not from their arrivals.

    Raises ParameterError if the format has no frames of that size.
    """
    width, height = size_wh
    if pixel_format in _EVEN and (width % 2 or (height % 2 and pixel_format != "yuyv422")):
        why = f"{width}x{height} is odd, and {pixel_format} shares colours between two pixels"
        raise ParameterError(argument("input_size"), why, "Send frames with even sides, or gray.")
    n_bytes = int(width * height * PIXEL_FORMATS[pixel_format])
    data = bytearray(n_bytes)
    for number in count():
        n_read = 0
        while n_read < n_bytes:
            n_more = stream.readinto(memoryview(data)[n_read:])  # type: ignore[attr-defined]
            if not n_more:
                if n_read:
                    what = "standard input: it ended within a frame, after %d of %d bytes"
                    _log.warning(what, n_read, n_bytes)
                return
            n_read += n_more
        captured_s = time.monotonic()
        image, levels = unpacked(np.frombuffer(data, np.uint8), size_wh, pixel_format)
        if fps is None:
            yield Shot(image, levels, captured_s)
        else:
            yield Shot(image, levels, captured_s, number, number / fps)


def unpacked(data: Image, size_wh: tuple[int, int], pixel_format: str) -> tuple[Image, Levels]:
    """The image in the bytes of a raw frame (a view if possible), and its levels."""
    width, height = size_wh
    if pixel_format in ("bgr24", "rgb24"):
        image = data.reshape(height, width, 3)
        return image if pixel_format == "bgr24" else cv2.cvtColor(image, cv2.COLOR_RGB2BGR), FULL
    if pixel_format == "yuyv422":
        return np.ascontiguousarray(data[::2].reshape(height, width)), _LIMITED
    luma = data[: width * height].reshape(height, width)
    return luma, FULL if pixel_format == "gray" else _LIMITED


def shots_at_their_pace(
    open_file: Callable[[], Video], *, loops: bool = False
) -> Generator[Shot, None, None]:
    """The images of a file, each yielded at its own time after the first was taken.

    An image that is decoded too late is yielded at once. If all images are late, the file plays
    slower, with a warning.

    With `loops`, the file plays again and again: numbers and times go on, `SEAM_S` after the last
    image, so that models restart.
    """
    begin_s, has_warned = math.nan, False
    index, time_s, n_before, before_s = 0, 0.0, 0, 0.0
    with open_file() as video:
        while True:
            for number, picture in enumerate(video.pictures()):
                index, time_s = n_before + picture.index, before_s + picture.time_s
                now_s = time.monotonic()
                due_s = now_s if math.isnan(begin_s) else begin_s + time_s
                if now_s > due_s + MAX_LATE_S:
                    begin_s += now_s - due_s
                    due_s = now_s
                    if not has_warned:
                        what = "%s: it cannot be decoded at its own pace here, and plays slower"
                        _log.warning(what, video.info.path)
                        has_warned = True
                while (left_s := due_s - time.monotonic()) > 0.0:
                    time.sleep(left_s)
                yield Shot(
                    picture.image,
                    video.info.levels,
                    due_s,
                    index,
                    time_s,
                    region=video.region,
                    is_repeat=picture.is_repeat,
                    after_gap=picture.after_gap or (n_before > 0 and number == 0),
                )
                if math.isnan(begin_s):
                    begin_s = time.monotonic() - time_s
            if not loops:
                return
            n_before, before_s = index + 1, time_s + SEAM_S


def check_source(source: str, *, is_realtime: bool, has_size: bool) -> None:
    """Raise ParameterError unless `source` is a live source."""
    scheme, name = scheme_of(source), without_password(source)
    if source == "-":
        if not has_size:
            size = argument("input_size")
            hint = f"Add, for example, {size} 640x480 {argument('pixel_format')} gray."
            raise ParameterError("-", f"a pipe of raw frames needs {size}", hint)
    elif scheme and scheme not in SCHEMES:
        known = ", ".join(f"{name}://" for name in SCHEMES)
        why = f"there is no kind of stream called {scheme}://"
        raise ParameterError(name, why, f"Choose from {known}.")
    elif scheme == "rtp":
        why = "RTP does not say what it carries; that is in the sender's session description"
        raise ParameterError(name, why, "Save it as stream.sdp, and give that file as the source.")
    elif is_session(source) and not Path(source).is_file():
        raise ParameterError(name, "there is no such file", "Check the path.")
    elif not scheme and not is_camera(source) and not is_realtime and not is_session(source):
        if Path(source).exists():
            play = f"Add {argument('realtime', True)} to play it at its own pace"
            hint = f"{play}, or use 'dlgmd run'."
            raise ParameterError(name, "is a file, not a live source", hint)
        hint = "Give a camera such as 0, a stream such as rtsp://…, - for a pipe, or a file."
        raise ParameterError(name, "there is no such source", hint)
    if is_realtime and (source == "-" or scheme or is_camera(source)):
        refuse({"realtime": True}, "works only with files")
    if has_size and source != "-" and not is_camera(source):
        why = "works only with a pipe or a camera"
        hint = f"Use {argument('size')} for the frames of the model."
        raise ParameterError(argument("input_size"), why, hint)
