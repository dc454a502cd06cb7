"""The comb of interlaced pictures, whose even and odd lines were taken half a frame apart."""

from itertools import islice
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.video.base import Unreadable
from dlgmd_cli.video.luma import Image, to_grey

if TYPE_CHECKING:
    from dlgmd_cli.video.source import Decoder

# Heights of analog video, of which recorders often do not flag that it is interlaced. In scaled
# pictures there is no comb to see.
ANALOG_LINES = (480, 486, 576)
# Blocks of this side, in px, are judged if neighbouring lines differ by `_TEXTURE` levels on
# average. There is a comb if they differ so many times as much as every other line.
_BLOCK_PX, _TEXTURE, _RATIO = 16, 4.0, 1.5
# Least shares of all blocks and of those judged. In 28 clips that are not interlaced, no picture
# has more than 0.0023 and 0.0036.
_LEAST_SHARE, _LEAST_JUDGED = 0.005, 0.03
# Without motion there is no comb: pictures count if they differ from the one before by so many
# levels on average. So many of those are looked at, among the first `_MOST`; three decide.
_MOTION, _N_MOVING, _MOST, _N_COMBED = 2.0, 24, 900, 3


def has_comb(grey: npt.NDArray[np.uint8]) -> bool:
    """Whether even and odd lines of a picture, (H, W), do not belong together.

    Where something moves, a line of an interlaced picture resembles the next but one more than its
    neighbour. In other pictures that is rare: only stripes two lines wide look like it.
    """
    by_one, by_two = cv2.absdiff(grey[:-2], grey[1:-1]), cv2.absdiff(grey[:-2], grey[2:])
    size = tuple(max(1, side // _BLOCK_PX) for side in by_one.shape[::-1])
    one, two = (
        cv2.resize(each.astype(np.float32), size, interpolation=cv2.INTER_AREA)
        for each in (by_one, by_two)
    )
    judged = one > _TEXTURE
    n_combed = np.count_nonzero(judged & (one > _RATIO * two))
    return bool(
        n_combed > _LEAST_SHARE * one.size and n_combed > _LEAST_JUDGED * np.count_nonzero(judged)
    )


def is_combed(decoder: "Decoder") -> bool:
    """Whether the first moving pictures of a video are interlaced; reads on in `decoder`."""
    before: Image | None = None
    n_moving = n_combed = 0
    for _ in islice(decoder.stamps(), _MOST):
        try:
            image, levels = decoder.picture()
        except Unreadable:
            break
        grey: Any = to_grey(image, (image.shape[1], image.shape[0]), levels)
        if grey.dtype != np.uint8:
            grey = cv2.convertScaleAbs(grey, alpha=255.0)
        if before is not None and cv2.mean(cv2.absdiff(grey[::8], before[::8]))[0] > _MOTION:
            n_moving += 1
            n_combed += has_comb(grey)
        if n_moving == _N_MOVING or n_combed == _N_COMBED:
            break
        before = grey
    return n_combed == _N_COMBED
