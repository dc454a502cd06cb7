"""The comb of interlaced images, whose even and odd lines were taken half a frame apart."""

from itertools import islice
from typing import TYPE_CHECKING

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import GreyImage
from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.luma import to_grey_levels

if TYPE_CHECKING:
    from dlgmd_cli.video.source import Decoder

# Sizes of analog video, of which recorders often do not flag that it is interlaced. In scaled
# images there is no comb to see.
_ANALOG_LINES, _MAX_ANALOG_WIDTH = (480, 486, 576), 768
# Blocks of this side, in px, are judged if neighbouring lines differ by `_TEXTURE` levels on
# average. There is a comb if they differ so many times as much as every other line.
_BLOCK_PX, _TEXTURE, _RATIO = 16, 4.0, 1.5
# Least shares of all blocks and of those judged. In 28 clips that are not interlaced, no image
# has more than 0.0023 and 0.0036.
_LEAST_SHARE, _LEAST_JUDGED = 0.005, 0.03
# Without motion there is no comb. Images are judged if they differ from the one before by so many
# levels on average, and by so much of what lines two apart differ by: about a line. So many of the
# first `_MOST` are judged at most; three decide.
_MOTION, _MOTION_LINES, _N_JUDGED, _MOST, _N_COMBED = 2.0, 0.8, 12, 600, 3
# While nothing moves, so many images are left out.
_REST = 4


def has_comb(grey: npt.NDArray[np.uint8]) -> bool:
    """Whether even and odd lines of an image, (H, W), do not belong together.

    Where something moves, a line of an interlaced image resembles the next but one more than its
    neighbour. In other images that is rare: only stripes two lines wide look like it.
    """
    by_one, by_two = cv2.absdiff(grey[:-2], grey[1:-1]), cv2.absdiff(grey[:-2], grey[2:])
    size = tuple(max(1, side // _BLOCK_PX) for side in by_one.shape[::-1])
    by_one, by_two = (
        cv2.resize(each.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for each in (by_one, by_two)
    )
    judged = by_one > _TEXTURE
    n_combed = np.count_nonzero(judged & (by_one > _RATIO * by_two))
    least = max(_LEAST_SHARE * by_one.size, _LEAST_JUDGED * np.count_nonzero(judged))
    return bool(n_combed > least)


def has_analog_size(decoder: "Decoder") -> bool:
    """Whether the images of a video have a size in which a comb can be seen."""
    return decoder.info.height in _ANALOG_LINES and decoder.info.width <= _MAX_ANALOG_WIDTH


def is_combed(decoder: "Decoder") -> bool:
    """Whether the first moving images of a video are interlaced; reads on in `decoder`."""
    before: GreyImage | None = None
    n_judged = n_combed = n_left_out = 0
    for _ in islice(decoder.stamps(), _MOST):
        if n_left_out:
            n_left_out -= 1
            continue
        try:
            image, levels = decoder.picture()
        except Unreadable:
            break
        grey = to_grey_levels(image, levels)
        if before is not None and not _moves(before, grey):
            before, n_left_out = None, _REST
            continue
        if before is not None:
            n_judged, n_combed = n_judged + 1, n_combed + has_comb(grey)
        if n_judged == _N_JUDGED or n_combed == _N_COMBED:
            break
        before = grey
    return n_combed == _N_COMBED


def _moves(before: npt.NDArray[np.uint8], grey: npt.NDArray[np.uint8]) -> bool:
    """Whether an image differs from the one before by a motion of about a line or more."""
    change = cv2.mean(cv2.absdiff(grey[::8], before[::8]))[0]
    detail = cv2.mean(cv2.absdiff(grey[:-2:8], grey[2::8]))[0]
    return bool(change > max(_MOTION, _MOTION_LINES * detail))
