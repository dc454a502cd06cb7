"""What is seen through an outline: in which part of the picture, and the texture there."""

import math
from collections.abc import Iterator

import cv2
import numpy as np

from dlgmd_cli.flights.renderer.camera import FloatArray
from dlgmd_cli.flights.renderer.coverage import Window
from dlgmd_cli.flights.renderer.outline import Outline
from dlgmd_cli.flights.renderer.texture import MARGIN, FloatImage

# What is painted at a time: a band stays in the cache, and has few sizes of texture.
_BAND_PX, _MIN_ROWS = 65_536, 32
# How far foreshortening counts when the size of the texture is chosen: 0 would sample it too
# coarsely in one direction, 1 blurs it in the other.
_FORESHORTENING = 0.75
# A texture is sampled this much finer, in steps of twice the size, than it has pixels to fill: that
# makes up for what sampling between texels blurs, and shows what the mean over each pixel would.
_SHARPENING = 0.5
# 1 / depth, in 1/m, of what is as good as nowhere.
_VANISHING = 1e-9


def bands(outline: Outline, shape: tuple[int, int], rows: tuple[int, int]) -> Iterator[Window]:
    """Windows (left, top, right, bottom) that hold all that an outline touches in some rows.

    Parameters
    ----------
    outline : Outline
    shape : (int, int)
        Of the picture, in px.
    rows : (int, int)
        The first, and the one after the last.
    """
    start = outline.corners_xy
    end = np.concatenate([start[1:], start[:1]])
    (left, top), (right, bottom) = start.min(axis=0), start.max(axis=0)
    first_row = max(math.floor(top), rows[0])
    last_row = min(math.ceil(bottom), rows[1])
    width = min(right, shape[1]) - max(left, 0.0) + 1.0
    n_rows = max(_MIN_ROWS, int(_BAND_PX / width)) if width > 1.0 else _MIN_ROWS
    tops = np.arange(first_row, last_row, n_rows)
    bottoms = np.minimum(tops + n_rows, last_row)
    if len(tops) == 1:
        x, x_end = max(math.floor(left), 0), min(math.ceil(right), shape[1])
        if x < x_end:
            yield x, first_row, x_end, last_row
        return
    # Of each side, the part that passes through each band, and its least and greatest x there.
    low = np.clip(tops[:, None], np.minimum(start[:, 1], end[:, 1]), None)
    high = np.clip(bottoms[:, None], None, np.maximum(start[:, 1], end[:, 1]))
    rise = end[:, 1] - start[:, 1]
    run = end[:, 0] - start[:, 0]
    is_level = np.abs(rise) < 1e-9
    slope = np.where(is_level, 0.0, run / np.where(is_level, 1.0, rise))
    ends = start[:, 0] + (np.stack([low, high]) - start[:, 1]) * slope
    ends = np.where(is_level, np.stack([start[:, 0], end[:, 0]])[:, None], ends)
    is_here = low <= high
    lefts = np.where(is_here, ends.min(axis=0), np.inf).min(axis=1)
    rights = np.where(is_here, ends.max(axis=0), -np.inf).max(axis=1)
    for row, row_end, x, x_end in zip(tops, bottoms, lefts, rights, strict=True):
        if x_end < -1.0 or x > shape[1] + 1.0:
            continue
        window = max(math.floor(x), 0), int(row), min(math.ceil(x_end), shape[1])
        if window[0] < window[2]:
            yield (*window, int(row_end))


def sample(outline: Outline, window: Window, focal_px: float) -> FloatImage:
    """The texture as it is seen through a window, before `gain`.

    Between two sizes of the texture it is mixed, by 1 / depth, so that none of them ends abruptly.
    """
    levels = outline.texture.levels
    left, top, right, bottom = window
    size_wh = right - left, bottom - top
    if len(levels) == 1:
        return np.full(size_wh[::-1], outline.texture.mean, np.float32)
    finest, coarsest = _levels(outline, window, focal_px)
    picture: FloatImage = np.zeros(size_wh[::-1], np.float32)
    for index in range(coarsest, finest - 1, -1):
        # Farther away, the next coarser size is all there is; nearer, the next finer one.
        farthest = -math.inf if index == coarsest else _inverse_depth(outline, index + 1, focal_px)
        nearest = math.inf if index == finest else _inverse_depth(outline, index - 1, focal_px)
        part = _between(outline.plane, window, farthest, nearest)
        if part is None:
            continue
        warped = _warped(outline, part, index)
        x, y, x_end, y_end = part
        target = picture[y - top : y_end - top, x - left : x_end - left]
        if index == coarsest:
            target[...] = warped
            continue
        warped -= target
        warped *= _share_of_finer(outline, part, index, focal_px)
        target += warped
    # Nothing is seen where the plane has its horizon, but that times nothing would still be NaN.
    cv2.patchNaNs(picture, outline.texture.mean)
    return picture


def _warped(outline: Outline, window: Window, index: int) -> FloatImage:
    """One size of the texture as it is seen through a window."""
    left, top, right, bottom = window
    level = outline.texture.levels[index]
    height, width = (side - 2 * MARGIN for side in level.shape)
    shift = MARGIN - 0.5
    texel = np.array([[width, 0.0, shift], [0.0, height, shift], [0.0, 0.0, 1.0]])
    to_window = np.array([[1.0, 0.0, left + 0.5], [0.0, 1.0, top + 0.5], [0.0, 0.0, 1.0]])
    warped: FloatImage = np.asarray(
        cv2.warpPerspective(
            level,
            texel @ outline.texture_from_xy @ to_window,
            (right - left, bottom - top),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=outline.texture.mean,
        ),
        np.float32,
    )
    return warped


def _between(plane: FloatArray, window: Window, low: float, high: float) -> Window | None:
    """What holds all of a window where a plane is between two values; None if it is nowhere."""
    left, top, right, bottom = window
    a, b, c = plane.tolist()
    columns = _passed(a, low - c, high - c, (b * top, b * bottom), (left, right))
    rows = _passed(b, low - c, high - c, (a * left, a * right), (top, bottom))
    if columns[0] >= columns[1] or rows[0] >= rows[1]:
        return None
    return columns[0], rows[0], columns[1], rows[1]


def _passed(
    slope: float, low: float, high: float, others: tuple[float, float], limits: tuple[int, int]
) -> tuple[int, int]:
    """From and before which pixel ``slope * x``, with one of the others, is between two values."""
    first, last = low - max(others), high - min(others)
    if slope < 0.0:
        first, last = last, first
    if slope == 0.0:
        return limits if first < 0.0 < last else (0, 0)
    least, most = limits
    return (
        math.floor(min(max(first / slope, least), most)),
        math.ceil(min(max(last / slope, least), most)),
    )


def _levels(outline: Outline, window: Window, focal_px: float) -> tuple[int, int]:
    """The finest and the coarsest size of the texture that a window needs."""
    left, top, right, bottom = window
    a, b, c = outline.plane
    least, most = np.maximum(outline.inverse_depths, _VANISHING).tolist()
    farthest = max(least, c + min(a * left, a * right) + min(b * top, b * bottom))
    nearest = max(least, min(most, c + max(a * left, a * right) + max(b * top, b * bottom)))
    last = len(outline.texture.levels) - 1
    finest = min(max(math.floor(_level(outline, nearest, focal_px)), 0), last)
    coarsest = math.ceil(_level(outline, min(farthest, nearest), focal_px))
    return finest, min(max(coarsest, finest), last)


def _share_of_finer(outline: Outline, window: Window, index: int, focal_px: float) -> FloatImage:
    """How much of the texture's size `index` is in the mix with the next coarser one, in 0..1."""
    left, top, right, bottom = window
    all_of_it = _inverse_depth(outline, index, focal_px)
    none_of_it = _inverse_depth(outline, index + 1, focal_px)
    a, b, c = outline.plane / (all_of_it - none_of_it)
    c -= none_of_it / (all_of_it - none_of_it)
    share = _ramp(a, b, c, np.arange(left + 0.5, right), np.arange(top + 0.5, bottom))
    return np.clip(share, 0.0, 1.0, out=share)


def _ramp(a: float, b: float, c: float, x: FloatArray, y: FloatArray) -> FloatImage:
    """a x + b y + c, at every y (rows) and x (columns)."""
    ramp: FloatImage = np.add.outer((b * y + c).astype(np.float32), (a * x).astype(np.float32))
    return ramp


def _level(outline: Outline, inverse_depth: float, focal_px: float) -> float:
    """Which size of the texture is wanted at a depth: log2 of how much smaller it is."""
    per_pixel = outline.texels_per_m / (focal_px * inverse_depth)
    slant = max(1.0, 1.0 / (inverse_depth * outline.distance_m))
    return math.log2(per_pixel) + _FORESHORTENING * math.log2(slant) - _SHARPENING


def _inverse_depth(outline: Outline, level: float, focal_px: float) -> float:
    """Where `_level` is `level`: the inverse function."""
    facing = outline.texels_per_m / (focal_px * 2.0 ** (level + _SHARPENING))
    if facing * outline.distance_m >= 1.0:
        return facing
    slanted = facing * outline.distance_m**-_FORESHORTENING
    return float(slanted ** (1.0 / (1.0 + _FORESHORTENING)))
