"""From a decoded picture to the grey levels a model takes: luma plane, reduction, full range."""

import re
import sys
from functools import lru_cache
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

Image = npt.NDArray[Any]
# The levels of black and white; None for the least and the greatest that the type holds.
Levels = tuple[int, int] | None

# Formats whose first plane is the luma, one sample after the other. All others have to be
# converted: packed, RGB, floating point or of the other byte order.
_ENDIAN = "le" if sys.byteorder == "little" else "be"
_PLANAR = re.compile(rf"(?:yuva?4\d\dp|yuvj4\d\dp|gray)(?:(9|1[0246]){_ENDIAN})?")
_SEMIPLANAR = re.compile(rf"nv(?:12|21|16|24|42)|p[024](1[026]){_ENDIAN}")
# From this factor on, a reduction begins with a halving.
_FAR = 16
_LIMITED, _FULL = 1, 2  # FFmpeg's colour ranges; 0 is unspecified


@lru_cache(maxsize=64)
def luma_plane(pixel_format: str, colour_range: int) -> tuple[type, Levels] | None:
    """The type and the levels of a format's first plane, if that is the luma.

    Both arguments are as FFmpeg has them: a name such as yuv420p, and 0, 1 or 2.
    """
    planar, semiplanar = _PLANAR.fullmatch(pixel_format), _SEMIPLANAR.fullmatch(pixel_format)
    found = planar or semiplanar
    if found is None:
        return None
    n_bits = int(found[1] or 8)
    shift = 16 - n_bits if semiplanar and found[1] else 0  # samples fill the upper bits
    is_full = pixel_format.startswith("yuvj") or colour_range == _FULL
    if colour_range != _LIMITED and pixel_format.startswith("gray"):
        is_full = True
    kind = np.uint8 if n_bits == 8 else np.uint16
    if not is_full:
        scale = 1 << (n_bits - 8 + shift)
        return kind, (16 * scale, 235 * scale)
    return kind, None if n_bits in (8, 16) else (0, ((1 << n_bits) - 1) << shift)


def to_grey(image: Image, size_wh: tuple[int, int], levels: Levels = None) -> Image:
    """Grey levels (BT.601) of a picture, clipped to its levels, at the size given.

    Parameters
    ----------
    image : ndarray, (H, W) or (H, W, 3), uint8 or uint16
        Grey or BGR.
    size_wh : (int, int)
        Width and height of the result, in px.
    levels : (int, int), optional
        The levels of black and white.

    Returns
    -------
    ndarray, shape (height, width)
        Newly allocated: uint8 in 0..255 for a picture of 8 bits, else float32 in 0..1.
    """
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
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
    """A grey picture (H, W) at another size: averages of areas if it shrinks, else interpolated.

    OpenCV halves a picture seven times as fast as it divides its sides by 4, or by what is no
    whole number. An even whole factor therefore begins with a halving, and so does one of 16 or
    more, where pairs of pixels at the edges of an area hardly count. Both steps round to whole
    levels: the result is within 1 of the exact mean, or 1.25 of noise with a factor of 16.
    """
    width, height = size_wh
    sides = tuple(zip(image.shape, (height, width), strict=True))
    halves_well = all(old % 2 == 0 and old >= _FAR * new for old, new in sides)
    if halves_well or all(old % (2 * new) == 0 for old, new in sides):
        half = image.shape[1] // 2, image.shape[0] // 2
        image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
    if (image.shape[1], image.shape[0]) == size_wh:
        return image
    shrinks = width <= image.shape[1] and height <= image.shape[0]
    return cv2.resize(image, size_wh, interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
