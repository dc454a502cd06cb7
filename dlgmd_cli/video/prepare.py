"""From a decoded picture to what a model takes: chosen by time, grey, resized, full range."""

import math
from collections.abc import Iterator
from functools import lru_cache

import cv2
import numpy as np

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.video.frames import (
    Frame,
    Image,
    Picture,
    Progress,
    Reader,
    Select,
    SourceInfo,
    Verdict,
)

# The paper's best size: a quarter of 1080p.
DEFAULT_WIDTH = 480
MAX_SIDE = 8192
_GREY = {3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}


def processed_size(
    width: int,
    height: int,
    *,
    scale: float | None = None,
    size_wh: tuple[int, int] | None = None,
) -> tuple[int, int]:
    """Width and height in px at which a width x height input is processed.

    Parameters
    ----------
    width, height : int
        Size of the input, in px.
    scale : float, optional
        Linear scale, 0 < scale <= 1. Without it (and without `size_wh`) the width is reduced to
        480 px, the paper's best size, and never enlarged.
    size_wh : (int, int), optional
        An exact size instead, in px.

    Raises
    ------
    ParameterError
        If scale or size are out of range, or both are given.
    """
    if size_wh is not None:
        if scale is not None:
            raise ParameterError("", "scale and size exclude each other", "Give one of them.")
        if not all(1 <= side <= MAX_SIDE for side in size_wh):
            raise ParameterError(
                "", f"size {size_wh[0]}x{size_wh[1]} is not within 1 to {MAX_SIDE} px"
            )
        return size_wh
    if scale is None:
        scale = min(1.0, DEFAULT_WIDTH / width)
    if not 0.0 < scale <= 1.0:
        raise ParameterError("", f"scale {scale:g} is not above 0 and up to 1")
    return max(1, round(width * scale)), max(1, round(height * scale))


class Selection:
    """Which frames to take: a span of time, thinned to at most so many frames a second.

    Parameters
    ----------
    start_s, end_s : float
        First time taken and first time no longer taken, in seconds.
    max_fps : float, optional
        Frames a second at most; the others are dropped, and times stay true.
    max_frames : int, optional
        Frames in all at most.
    """

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

    def begin(self) -> Select:
        """A fresh verdict on each frame's time; the times must increase."""
        origin_s, last_slot, n_taken = math.nan, -1, 0

        def select(time_s: float) -> Verdict:
            nonlocal origin_s, last_slot, n_taken
            if time_s >= self._end_s or n_taken == self._max_frames:
                return Verdict.STOP
            # Without a start, frames before zero (edit lists make them) belong to the video too.
            if self._start_s > 0.0 and time_s < self._start_s:
                return Verdict.SKIP
            if self._max_fps is None:
                n_taken += 1
                return Verdict.TAKE
            origin_s = time_s if math.isnan(origin_s) else origin_s
            # Timestamps are rounded, in Matroska to 1 ms: a frame may come that much early.
            slot = math.floor((time_s - origin_s + 1e-3) * self._max_fps)
            if slot <= last_slot:
                return Verdict.SKIP
            last_slot = slot
            n_taken += 1
            return Verdict.TAKE

        return select


def to_grey(image: Image, size_wh: tuple[int, int], levels: tuple[int, int] | None = None) -> Image:
    """Grey levels (BT.601) of a picture at the size given.

    Parameters
    ----------
    image : ndarray, (H, W) or (H, W, 1, 3 or 4), uint8 or uint16
        Grey, BGR or BGRA.
    size_wh : (int, int)
        Width and height of the result, in px.
    levels : (int, int), optional
        The levels of black and white; what lies outside is cut off. Unless given, the least and
        the greatest that the type holds.

    Returns
    -------
    ndarray, shape (height, width)
        Newly allocated: uint8 in 0..255 for a picture of 8 bits, else float32 in 0..1.

    Raises
    ------
    SourceError
        If the picture has another depth or number of channels.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise SourceError("picture", f"{image.dtype} pixels are not 8 or 16 bit", "Convert it.")
    original = image
    if image.ndim == 3:
        channels = image.shape[2]
        if channels not in (1, *_GREY):
            raise SourceError("picture", f"{channels} channels are neither grey, BGR nor BGRA")
        image = image[:, :, 0] if channels == 1 else cv2.cvtColor(image, _GREY[channels])
    height, width = image.shape
    if (width, height) != size_wh:
        shrinks = size_wh[0] <= width and size_wh[1] <= height
        image = cv2.resize(
            image, size_wh, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        )
    if image.dtype == np.uint16:
        black, white = levels or (0, 65535)
        luminance = (image - np.float32(black)) / np.float32(white - black)
        return np.clip(luminance, 0.0, 1.0, out=luminance)
    if levels is not None:
        return cv2.LUT(image, _full_range(*levels))
    return image.copy() if np.may_share_memory(image, original) else image


@lru_cache(maxsize=8)
def _full_range(black: int, white: int) -> Image:
    """Table from levels of a limited range to 0..255."""
    stretched = (np.arange(256) - black) * (255.0 / (white - black))
    return np.clip(np.rint(stretched), 0, 255).astype(np.uint8)


class Source:
    """Frames ready for a model, out of a reader's pictures; a context manager.

    Attributes
    ----------
    info : SourceInfo
        Facts about the input.
    size_wh : (int, int)
        Width and height of the frames, in px.
    """

    def __init__(self, reader: Reader, size_wh: tuple[int, int], selection: Selection) -> None:
        self._reader = reader
        self._selection = selection
        self.info: SourceInfo = reader.info
        self.size_wh = size_wh

    @property
    def progress(self) -> Progress:
        """How many frames were decoded so far, and what went wrong with them."""
        return self._reader.progress

    def pictures(self, n_kept: int = 1) -> Iterator[Picture]:
        """The pictures that were chosen, as decoded; each is valid until `n_kept` more of them."""
        return self._reader.pictures(self._selection.begin(), n_kept)

    def frame(self, picture: Picture, size_wh: tuple[int, int] | None = None) -> Frame:
        """What models take of a picture, at another size than the source's own if given."""
        grey = to_grey(picture.image, size_wh or self.size_wh, picture.levels)
        return Frame(picture.index, picture.time_s, grey)

    def __iter__(self) -> Iterator[Frame]:
        return map(self.frame, self.pictures())

    def close(self) -> None:
        """Free the input; may be called twice."""
        self._reader.close()

    def __enter__(self) -> "Source":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
