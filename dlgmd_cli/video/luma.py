"""From decoded images to the models' input: upright images, grey levels, the part to read."""

import re
import sys
from collections.abc import Collection, Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple, Protocol

import cv2
import numpy as np

from dlgmd_cli.errors import ParameterError, argument
from dlgmd_cli.frame import FULL, Flags, Image, Levels
from dlgmd_cli.reduction import Reducer, resized
from dlgmd_cli.video.base import Crop, SourceInfo, Unreadable
from dlgmd_cli.video.images import read_image


class Decoder(Protocol):
    """Reads an input once, from first to last.

    `kind` is opencv, pyav, or array. `is_damaged` is set when a frame could not be decoded.
    `takes_every_frame` says whether every frame is processed by default, as for images and arrays.
    By default, videos are reduced to the rate a model is designed for, without duplicates.
    """

    info: SourceInfo
    kind: str
    is_damaged: bool
    takes_every_frame: bool

    def stamps(self) -> Iterator[float]:
        """Step through the frames; yields the time of each in seconds, NaN if unknown."""
        ...

    def picture(self) -> Image:
        """The image of the latest frame, of the levels in `info`; raises Unreadable."""
        ...

    def close(self) -> None:
        """Free the input; may be called twice."""
        ...


# Pixel formats whose first plane is the luma with contiguous samples. All other formats must be
# converted: packed, RGB, floating-point, and formats of the other byte order.
ENDIAN = "le" if sys.byteorder == "little" else "be"
_PLANAR = re.compile(rf"(?:yuva?4\d\dp|yuvj4\d\dp|gray)(?:(9|1[0246]){ENDIAN})?")
_SEMIPLANAR = re.compile(rf"nv(?:12|21|16|24|42)|p[024](1[026]){ENDIAN}")
LIMITED, UNLIMITED = 1, 2  # FFmpeg's colour ranges; 0 is unspecified


# A display matrix is applied if it is within 6 degrees of a turn by a multiple of 90 degrees,
# mirrored or not.
_SLANT = 0.1


class Orientation(NamedTuple):
    """The steps that make an image upright: swap rows and columns, then mirror along x or y."""

    swaps: bool = False
    flips_x: bool = False
    flips_y: bool = False

    @classmethod
    def of_matrix(cls, a: int, b: int, c: int, d: int) -> "Orientation":
        """The orientation of a display matrix, which shows (x, y) at (a x + c y, b x + d y)."""
        straight, crossed = max(abs(a), abs(d)), max(abs(b), abs(c))
        if crossed <= _SLANT * straight:
            return cls(False, a < 0, d < 0)
        if straight <= _SLANT * crossed:
            return cls(True, c < 0, b < 0)
        return cls()

    @property
    def is_mirrored(self) -> bool:
        """Whether left and right are swapped after turning by `turned_deg`."""
        return (self.flips_x != self.flips_y) != self.swaps

    @property
    def turned_deg(self) -> int:
        """The angle by which images are turned clockwise: 0, 90, 180 or 270."""
        return (270 if self.flips_y else 90) if self.swaps else 180 * self.flips_y

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Width and height of an upright image."""
        return (height, width) if self.swaps else (width, height)

    def upright(self, image: Image) -> Image:
        """An image made upright; the same object if it already is."""
        if self.swaps:
            image = cv2.transpose(image)
        if self.flips_x or self.flips_y:
            image = cv2.flip(image, -1 if self.flips_x and self.flips_y else int(self.flips_x))
        return image


UPRIGHT = Orientation()


@lru_cache(maxsize=64)
def luma_plane(pixel_format: str, colour_range: int) -> tuple[type, Levels] | None:
    """Data type and levels of the luma plane; None if the first plane is not the luma.

    The arguments are FFmpeg's: a name such as yuv420p, and a colour range of 0, 1 or 2.
    """
    semiplanar = _SEMIPLANAR.fullmatch(pixel_format)
    match = _PLANAR.fullmatch(pixel_format) or semiplanar
    if match is None:
        return None
    n_bits = int(match[1] or 8)
    shift = 16 - n_bits if semiplanar and match[1] else 0  # samples fill the upper bits
    is_grey = pixel_format.startswith("gray")
    is_full = colour_range != LIMITED if is_grey else colour_range == UNLIMITED
    is_full = is_full or pixel_format.startswith("yuvj")
    kind = np.uint8 if n_bits == 8 else np.uint16
    if not is_full:
        scale = 1 << (n_bits - 8 + shift)
        return kind, (16 * scale, 235 * scale)
    return kind, (0, ((1 << n_bits) - 1) << shift)


def to_grey(image: Image, size_wh: tuple[int, int], levels: Levels = FULL) -> Image:
    """Grey levels (BT.601) of an image, clipped to `levels` and resized.

    Parameters
    ----------
    image : ndarray, (H, W) or (H, W, 3), uint8, uint16, or float32 in 0..1
        Grey or BGR.
    size_wh : (int, int)
        Width and height of the result, in px.
    levels : (int, int), optional
        The levels of black and white; those of 8 bits unless given.

    Returns
    -------
    ndarray, shape (height, width)
        Newly allocated: uint8 in 0..255 for an image of 8 bits, else float32 in 0..1.
    """
    return grey_at_sizes(image, [size_wh], levels, Reducer())[size_wh]


def _leveled(grey: Image, levels: Levels) -> Image:
    """A grey image whose levels of black and white are the least and the greatest value."""
    black, white = levels
    if grey.dtype == np.uint16:
        luminance = (grey - np.float32(black)) / np.float32(white - black)
        return np.clip(luminance, 0.0, 1.0, out=luminance)
    if grey.dtype == np.uint8 and levels != FULL:
        gain = 255.0 / (white - black)
        # Rounds to the nearest level and clips, twice as fast as a lookup table.
        return cv2.addWeighted(grey, gain, grey, 0.0, -black * gain)
    return grey


def grey_at_sizes(
    image: Image, sizes_wh: Collection[tuple[int, int]], levels: Levels, reducer: Reducer
) -> dict[tuple[int, int], Image]:
    """The grey image at each size, see `to_grey`; the `reducer` is that of all images."""
    reducer.take(image)
    sizes_wh = sorted(sizes_wh, reverse=True)
    return {size_wh: _leveled(reducer.at(size_wh), levels) for size_wh in sizes_wh}


def to_grey_levels(image: Image, levels: Levels) -> Image:
    """The grey image at its own size, 8 bits, 0..255, see `to_grey`."""
    grey = to_grey(image, (image.shape[1], image.shape[0]), levels)
    return grey if grey.dtype == np.uint8 else cv2.convertScaleAbs(grey, alpha=255.0)


def to_bgr(image: Image, size_wh: tuple[int, int], levels: Levels = FULL) -> Image:
    """An image for display: BGR of 8 bits, (height, width, 3), newly allocated.

    The arguments are those of `to_grey`.
    """
    if image.ndim == 2:
        image, levels = to_grey(image, size_wh, levels), (0, 1)
    elif (image.shape[1], image.shape[0]) != size_wh:
        shrinks = size_wh[0] <= image.shape[1] and size_wh[1] <= image.shape[0]
        way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
        image = cv2.resize(image, size_wh, interpolation=way)
    if image.dtype != np.uint8:
        image = np.clip(np.rint(image * (255.0 / levels[1])), 0, 255).astype(np.uint8)
    return cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image.copy()


# Least mean (0 to 255) of a cell without black mask pixels, with a margin for rounding.
_WHOLE = 254.95


def read_mask(path: str) -> Flags:
    """The black pixels of an image, (H, W) bool: darker than medium grey in every channel.

    Raises ParameterError if it is not an image.
    """
    try:
        image = read_image(Path(path))
    except Unreadable as error:
        why = str(error) if Path(path).exists() else "does not exist"
        hint = "Give a PNG whose black is left out."
        raise ParameterError("", f"{argument('mask')} {path} {why}", hint) from None
    brightest = image.max(axis=2) if image.ndim == 3 else image
    white = (1 << int(image.max()).bit_length()) - 1  # 1 and 255 are white, too, also of 16 bits
    return np.asarray(brightest <= white // 2)


class Region:
    """A rectangle of an image without the black pixels of a mask; the whole image by default.

    The image has the size `picture_wh`, in px. The rectangle is `crop`, inside the image; its size
    is `size_wh`. `masked` is True for black pixels, see `read_mask`. A mask of the image's size is
    cut to the rectangle, also in the attribute `masked`; a mask of any other size is resized to
    cover the rectangle.
    """

    def __init__(
        self, picture_wh: tuple[int, int], crop: Crop | None = None, masked: Flags | None = None
    ) -> None:
        width, height, x, y = crop or Crop(*picture_wh, 0, 0)
        self.picture_wh, self.size_wh = picture_wh, (width, height)
        self._place = np.s_[y : y + height, x : x + width]
        is_whole = masked is not None and masked.shape == (picture_wh[1], picture_wh[0])
        self.masked = self.of(masked) if masked is not None and is_whole else masked

    def of(self, image: Image) -> Image:
        """The rectangle of an image, (H, W) or (H, W, 3); a view."""
        return image[self._place]

    def lacks(self, size_wh: tuple[int, int]) -> str:
        """Why frames cannot have this size, larger than the rectangle; empty if they can."""
        is_within = all(asked <= own for asked, own in zip(size_wh, self.size_wh, strict=True))
        return "" if is_within else "the input has only {}x{} px".format(*self.size_wh)

    def hidden(self, size_wh: tuple[int, int]) -> Flags | None:
        """The hidden cells, (H, W) bool, of the rectangle at `size_wh`; None if there are none.

        A cell is hidden if any part of the cell is black. Raises ParameterError if all are hidden.
        """
        if self.masked is None or not self.masked.any():
            return None
        shown = np.where(self.masked, np.float32(0.0), np.float32(255.0))
        hidden = np.asarray(resized(shown, size_wh) < _WHOLE)
        if hidden.all():
            why = f"{argument('mask')} leaves no cell of {size_wh[0]}x{size_wh[1]}"
            raise ParameterError("", why, "Paint white what the model should use.")
        return hidden
