"""Reading an input: frames chosen by their times, and what a damaged file holds before a gap."""

import copy
import math
from array import array
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.images import ImageDecoder
from dlgmd_cli.video.luma import to_grey
from dlgmd_cli.video.opencv import OpenCVDecoder
from dlgmd_cli.video.pyav import PyAVDecoder
from dlgmd_cli.video.timestamps import FrameClock, missing_frames

# What decodes an input once: `facts`; `stamps()`, which takes one frame after the other and gives
# its timestamp; `picture()`, what that frame shows, and its levels; `is_damaged`, whether there
# were frames that cannot be decoded.
Decoder = OpenCVDecoder | PyAVDecoder | ImageDecoder


@dataclass(frozen=True)
class VideoInfo:
    """Facts about an input.

    Attributes
    ----------
    path : str
        Where it is, absolute.
    name : str
        What its results are called: the stem of a file, the name of a folder.
    width, height : int
        Size of its pictures as they are shown, in px.
    fps : float
        Nominal frames per second.
    n_frames : int or None
        How many frames it claims to have: a hint for a progress bar, often wrong.
    decoder : str
        What decodes it: opencv or pyav.
    """

    path: str
    name: str
    width: int
    height: int
    fps: float
    n_frames: int | None
    decoder: str


@dataclass(frozen=True)
class Picture:
    """A decoded picture: uint8 or uint16, (H, W) grey or (H, W, 3) BGR.

    `levels` are the levels of black and white, if they are not the least and the greatest that
    the data type holds.
    """

    index: int
    time_s: float
    image: npt.NDArray[Any]
    levels: tuple[int, int] | None = None


@dataclass
class Progress:
    """How far the reading has come, and what went wrong."""

    n_decoded: int = 0
    last_time_s: float = math.nan
    warnings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class Frame:
    """A frame as models take it.

    `grey` is (H, W): uint8 levels 0..255 if the input has 8 bits, else float32 in 0..1.
    """

    index: int
    time_s: float
    grey: npt.NDArray[Any]

    @property
    def luminance(self) -> npt.NDArray[np.float32]:
        """The same as float32 in 0..1, shape (H, W)."""
        if self.grey.dtype != np.uint8:
            return self.grey
        return np.divide(self.grey, np.float32(255.0), dtype=np.float32)


class Selection:
    """Which frames to take, asked once for each in turn; see `open_video` for the parameters."""

    def __init__(
        self,
        start_s: float = 0.0,
        end_s: float = math.inf,
        max_fps: float | None = None,
        max_frames: int | None = None,
    ) -> None:
        if not end_s > start_s:
            raise ParameterError("", f"end {end_s:g} s is not after start {start_s:g} s")
        if max_fps is not None and not (math.isfinite(max_fps) and max_fps > 0.0):
            raise ParameterError("", f"fps {max_fps:g} is not above 0")
        self._start_s, self._end_s, self._max_fps = start_s, end_s, max_fps
        self._max_frames = max_frames
        self._origin_s, self._last_slot, self._n_taken = math.nan, -1, 0

    def is_over(self, time_s: float) -> bool:
        """Whether neither a frame at this time nor a later one is taken."""
        return time_s >= self._end_s or self._n_taken == self._max_frames

    def takes(self, time_s: float) -> bool:
        """Whether the frame at this time is taken."""
        # Without a start, frames before zero (edit lists make them) belong to the video too.
        if self._start_s > 0.0 and time_s < self._start_s:
            return False
        if self._max_fps is not None:
            if math.isnan(self._origin_s):
                self._origin_s = time_s
            # Timestamps are rounded, in Matroska to 1 ms: a frame may be that much early.
            slot = math.floor((time_s - self._origin_s + 1e-3) * self._max_fps)
            if slot <= self._last_slot:
                return False
            self._last_slot = slot
        self._n_taken += 1
        return True


class Video:
    """Frames of an input, ready for a model; a context manager, made by `open_video`.

    Iterate it for `Frame`\\ s, each in memory of its own; every iteration starts at the beginning.

    Attributes
    ----------
    info : VideoInfo
        Facts about the input.
    size_wh : (int, int)
        Width and height of the frames, in px.
    progress : Progress
        How many frames were decoded so far, the time of the last one, and warnings.
    """

    def __init__(
        self,
        decoder: Decoder,
        reopen: Callable[[], Decoder],
        info: VideoInfo,
        size_wh: tuple[int, int],
        selection: Selection,
    ) -> None:
        self._decoder, self._reopen, self._is_read = decoder, reopen, False
        self._selection = selection
        self.info, self.size_wh = info, size_wh
        self.progress = Progress()

    def pictures(self) -> Iterator[Picture]:
        """The chosen pictures as decoded, each valid until the next one, to the end or a fault.

        Reading ends with a warning if damage leaves a gap, or if PyAV finds that the picture size
        changes (OpenCV scales such pictures to the first one's size and does not say so).
        """
        if self._is_read:
            self._decoder.close()
            self._decoder = self._reopen()
        self._is_read = True
        decoder, progress, fps = self._decoder, self.progress, self.info.fps
        selection, clock, times = copy.copy(self._selection), FrameClock(fps), array("d")
        progress.n_decoded, progress.last_time_s = 0, math.nan
        fault = ""
        for index, stamp_s in enumerate(decoder.stamps()):
            if decoder.is_damaged:
                fault = "the file is damaged"
                if stamp_s > progress.last_time_s + 1.5 / fps:
                    break
            time_s = clock.time(index, stamp_s)
            times.append(time_s)
            if selection.is_over(time_s):
                break
            is_taken = selection.takes(time_s)
            if is_taken:
                try:
                    image, levels = decoder.picture()
                except Unreadable as error:
                    fault = str(error)
                    break
            progress.n_decoded, progress.last_time_s = index + 1, time_s
            if is_taken:
                yield Picture(index, time_s, image, levels)
        else:
            fault = fault or self._shortfall()
        reports = (clock.report(), missing_frames(times, fps), fault and self._ending(fault))
        progress.warnings += [line for line in reports if line]
        decoder.close()

    def _shortfall(self) -> str:
        """What is missing at the end of the stream, if anything."""
        stated, fps = self.info.n_frames, self.info.fps
        if stated is not None and self.progress.n_decoded < stated:  # the count is often wrong
            end_s = min(stated / fps, self._decoder.facts.shown_s)
            if self.progress.last_time_s + 1.5 / fps < end_s:
                return "frames are missing, the file is cut off or damaged"
        return "the file is damaged" if self._decoder.is_damaged else ""

    def _ending(self, fault: str) -> str:
        """The warning for a reading that a fault has ended."""
        n_frames, stated = self.progress.n_decoded, self.info.n_frames
        of_stated = f" of about {stated}" if stated and stated > n_frames else ""
        until = f"{self.progress.last_time_s:.3f} s"
        return f"{fault}; decoded and used {n_frames}{of_stated} frames, up to {until}"

    def frame(self, picture: Picture, size_wh: tuple[int, int] | None = None) -> Frame:
        """What models take of a picture, at the video's `size_wh` unless another is given."""
        grey = to_grey(picture.image, size_wh or self.size_wh, picture.levels)
        return Frame(picture.index, picture.time_s, grey)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, self.pictures())

    def close(self) -> None:
        """Free the input; may be called twice."""
        self._decoder.close()

    def __enter__(self) -> "Video":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
