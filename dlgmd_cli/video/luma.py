"""From a decoded picture to the grey levels a model takes: luma plane, reduction, full range."""

import re
import sys
from functools import lru_cache
from typing import Any, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import SourceError

Image = npt.NDArray[Any]

_GREY = {3: cv2.COLOR_BGR2GRAY, 4: cv2.COLOR_BGRA2GRAY}
# Formats whose first plane is the luma, one sample after the other. All others have to be
# converted: packed, RGB, floating point or of the other byte order.
_ENDIAN = "le" if sys.byteorder == "little" else "be"
_PLANAR = re.compile(rf"(?:yuva?4\d\dp|yuvj4\d\dp|gray)(?:(9|1[0246]){_ENDIAN})?")
_SEMIPLANAR = re.compile(rf"nv(?:12|21|16|24|42)|p[024](1[026]){_ENDIAN}")
_UNSPECIFIED, _LIMITED = 0, 1


class Luma(NamedTuple):
    """The luma plane of a pixel format: bits of a sample, and how far they are shifted up."""

    n_bits: int
    shift: int = 0


@lru_cache(maxsize=64)
def luma_of(pixel_format: str) -> Luma | None:
    """The luma plane of a format by FFmpeg's name, such as yuv420p; None if it has none."""
    planar = _PLANAR.fullmatch(pixel_format)
    if planar:
        return Luma(int(planar[1] or 8))
    semiplanar = _SEMIPLANAR.fullmatch(pixel_format)
    if semiplanar and semiplanar[1]:
        return Luma(int(semiplanar[1]), 16 - int(semiplanar[1]))
    return Luma(8) if semiplanar else None


@lru_cache(maxsize=64)
def levels_of(pixel_format: str, luma: Luma, colour_range: int) -> tuple[int, int] | None:
    """The levels of black and white in a luma plane; None for the least and greatest of its type.

    Parameters
    ----------
    pixel_format : str
        FFmpeg's name for it.
    luma : Luma
        As `luma_of` has it.
    colour_range : int
        As FFmpeg has it: 0 for unspecified, 1 for limited, 2 for full.
    """
    is_full_by_name = pixel_format.startswith(("yuvj", "gray"))
    is_limited = colour_range == _LIMITED and not pixel_format.startswith("yuvj")
    if is_limited or (colour_range == _UNSPECIFIED and not is_full_by_name):
        scale = 1 << (luma.n_bits - 8 + luma.shift)
        return 16 * scale, 235 * scale
    if luma.n_bits in (8, 16):
        return None
    return 0, ((1 << luma.n_bits) - 1) << luma.shift


def to_grey(image: Image, size_wh: tuple[int, int], levels: tuple[int, int] | None = None) -> Image:
    """Grey levels (BT.601) of a picture at the size given.

    Parameters
    ----------
    image : ndarray, (H, W) or (H, W, 1, 3 or 4), uint8 or uint16
        Grey, BGR or BGRA.
    size_wh : (int, int)
        Width and height of the result, in px.
    levels : (int, int), optional
        The levels of black and white; what lies outside is clipped. By default the least and the
        greatest that the type holds.

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
    grey = image
    if image.ndim == 3:
        channels = image.shape[2]
        if channels not in (1, *_GREY):
            raise SourceError("picture", f"{channels} channels are neither grey, BGR nor BGRA")
        grey = image[:, :, 0] if channels == 1 else cv2.cvtColor(image, _GREY[channels])
    grey = resized(grey, size_wh)
    if grey.dtype == np.uint16:
        black, white = levels or (0, 65535)
        luminance = (grey - np.float32(black)) / np.float32(white - black)
        return np.clip(luminance, 0.0, 1.0, out=luminance)
    if levels is not None:
        black, white = levels
        gain = 255.0 / (white - black)
        # Rounds to the nearest level and clips, at twice the speed of a table.
        return cv2.addWeighted(grey, gain, grey, 0.0, -black * gain)
    return grey.copy() if np.may_share_memory(grey, image) else grey


def resized(image: Image, size_wh: tuple[int, int]) -> Image:
    """A grey picture at another size: averages of areas if it shrinks, else interpolated.

    Parameters
    ----------
    image : ndarray, (H, W), uint8 or uint16
        The picture; returned as it is if it has that size.
    size_wh : (int, int)
        Width and height of the result, in px.

    Notes
    -----
    OpenCV halves a picture seven times as fast as it divides its sides by 4, so an even whole
    factor begins with a halving. Both steps round to whole levels: the result is within 1 of the
    exact mean, and differs by one level at most from a reduction in a single step.
    """
    width, height = size_wh
    if image.shape[1] % (2 * width) == 0 and image.shape[0] % (2 * height) == 0:
        half = image.shape[1] // 2, image.shape[0] // 2
        image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
    if (image.shape[1], image.shape[0]) == size_wh:
        return image
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    return cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
