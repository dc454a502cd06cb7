"""Checks of the decoded images: black or frozen spans, and interlacing that no flag reports."""

import math
from itertools import islice

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import argument
from dlgmd_cli.frame import Flags, GreyImage, Image, Levels
from dlgmd_cli.video.base import Crop, Unreadable
from dlgmd_cli.video.luma import Decoder, Region, to_grey_levels

# Least duration of a black or frozen span. A cut to black, or a duplicate frame, is shorter.
BLIND_S = 0.7
# Number of rows of an image that are compared first.
_N_ROWS = 16
# Number of blind spans that a warning names.
_N_SHOWN = 3
# Sizes of analog video. Many recorders do not flag analog video as interlaced. Once scaled, an
# image shows no comb.
_ANALOG_LINES, _MAX_ANALOG_WIDTH = (480, 486, 576), 768
# Blocks have `_BLOCK_PX` px on a side. A block is judged if neighbouring lines differ by more than
# `_TEXTURE` levels on average. A block has a comb if the mean difference of neighbouring lines
# exceeds `_RATIO` times the mean difference of lines two apart.
_BLOCK_PX, _TEXTURE, _RATIO = 16, 4.0, 1.5
# An image has a comb if its blocks with a comb exceed these shares of all blocks and of the
# judged blocks. In 28 progressive clips, the greatest shares are 0.0023 and 0.0036.
_LEAST_SHARE, _LEAST_JUDGED = 0.005, 0.03
# Without motion there is no comb. An image is judged if it moves by about a line: its mean
# difference from the image before is at least `_MOTION` levels, and `_MOTION_LINES` times the
# difference of lines two apart. At most `_N_JUDGED` of the first `_MOST` images are judged. A video
# is interlaced if `_N_COMBED` judged images have a comb.
_MOTION, _MOTION_LINES, _N_JUDGED, _MOST, _N_COMBED = 2.0, 0.8, 12, 600, 3
# Number of images that are skipped while nothing moves.
_REST = 4
# Grey levels (of 255) of the brightest black bar: compression makes it brighter. A row or column
# is part of the picture if more than this share of its pixels is lit.
_BLACK, _LIT_SHARE = 24, 0.01
# Least width of a bar in px, and the least share of each side that a crop keeps.
_MIN_BAR_PX, _MIN_LEFT = 2, 0.3
# A constant pixel varies by at most this many grey levels. A picture is small if it fills at most
# `_SMALL` of the images; if less than `_FILLED` of it differs from the rest, it is an object.
_CONSTANT, _SMALL, _FILLED = 8, 0.55, 0.5
# Number of images before a picture counts as small.
_FEW = 8


class BlindSpans:
    """Finds the spans in which all images are black or frozen, in constant memory.

    An image is black if no sample exceeds the level of black, and frozen if every sample equals
    that of the image before. A camera's noise prevents both, also at night. A span lasts at least
    0.7 s. Whole images are compared only while 16 of their rows are equal.

    Parameters
    ----------
    black : int
        The level of black.

    Attributes
    ----------
    throughout : str
        `black` or `frozen` if all images from the first to the latest are so, else empty.
    n_equal, n_runs : int
        Number of images that equal the one before, and of runs of such images.
    """

    def __init__(self, black: int = 0) -> None:
        self._black = black
        self._rows: Image | None = None
        self._whole: Image | None = None
        self._first_s = self._last_s = self._since_s = math.nan
        self.throughout = self._suspected = ""
        self.n_equal = self.n_runs = 0
        self._was_equal = False
        self._spans: dict[tuple[str, float], float] = {}

    def step(self, picture: Image, time_s: float) -> None:
        """Judge the next image.

        `picture` is (H, W) grey or (H, W, 3) BGR as it was decoded: reduced images may lose their
        noise. The caller may reuse the array afterwards. `time_s` is its time in seconds.
        """
        rows = picture[:: max(1, len(picture) // _N_ROWS)]
        was_equal, is_equal = self._was_equal, self._is_equal(picture, rows)
        self.n_equal, self.n_runs = self.n_equal + is_equal, self.n_runs + (is_equal > was_equal)
        self._was_equal = is_equal
        is_black = rows.max() <= self._black and picture.max() <= self._black
        suspected = "black" if is_black else "frozen" if is_equal else ""
        if suspected != self._suspected:
            # A frozen span begins with the image that the first equal image repeats.
            self._since_s = self._last_s if suspected == "frozen" else time_s
            self._suspected = suspected
        self._last_s = time_s
        if math.isnan(self._first_s):
            self._first_s = time_s
        self.throughout = suspected if self._since_s == self._first_s < time_s else ""
        if suspected and time_s - self._since_s >= BLIND_S:
            self._spans[suspected, self._since_s] = time_s

    @property
    def spans_s(self) -> list[tuple[float, float]]:
        """First and last time of every span, in seconds."""
        return [(since_s, end_s) for (_, since_s), end_s in self._spans.items()]

    def report(self) -> str:
        """The warning about black and frozen spans; empty if there are none."""
        if self.throughout:
            alike = "black" if self.throughout == "black" else "the same"
            return f"nothing can be seen: all frames are {alike}"
        spans = [
            f"{kind} from {since_s:.2f} to {end_s:.2f} s"
            for (kind, since_s), end_s in self._spans.items()
        ]
        shown = spans[:_N_SHOWN] + [f"and {len(spans) - _N_SHOWN} more"] * (len(spans) > _N_SHOWN)
        return f"{', '.join(shown)}: nothing can be seen there" if spans else ""

    def _is_equal(self, picture: Image, rows: Image) -> bool:
        """Whether an image equals the previous one; a change outside `rows` shows an image late."""
        if self._rows is None:
            self._rows, self._whole = rows.copy(), picture.copy()
            return False
        if not np.array_equal(rows, self._rows):
            self._rows, self._whole = rows.copy(), None
            return False
        if self._whole is None:
            self._whole = picture.copy()
        elif not np.array_equal(picture, self._whole):
            self._whole = picture.copy()
            return False
        return True


class Surround:
    """Finds a picture that fills a small part of the images while the rest is one constant level.

    `levels` are those of black and white. Of the images 1, 2, 4, 8 …, the first and the last count.
    """

    def __init__(self, levels: Levels) -> None:
        self._levels, self._n_images, self._kept = levels, 0, list[Image]()

    def step(self, image: Image) -> None:
        """Look at the next image, (H, W) or (H, W, 3), as it was decoded."""
        self._n_images += 1
        if self._n_images & (self._n_images - 1) == 0:
            self._kept[1:] = [to_grey_levels(image, self._levels)]

    def report(self) -> str:
        """The warning that names the picture's crop; empty if the picture is not small."""
        if self._n_images < _FEW:
            return ""
        first = self._kept[0]
        for level in {int(first[y, x]) for y in (0, -1) for x in (0, -1)}:
            lit = [np.abs(np.int16(one) - level) > _CONSTANT for one in self._kept]
            crop = crop_of(np.logical_or(*lit))
            if crop is None or crop.width * crop.height > _SMALL * first.size:
                continue
            picture = Region((first.shape[1], first.shape[0]), crop)
            if min(picture.of(one).mean() for one in lit) > _FILLED:
                keeps = f"{argument('crop', str(crop))} keeps the picture"
                return f"the picture is small, and the rest of the frame is constant; {keeps}"
        return ""


def crop_borders(brightest: Image) -> Crop | None:
    """The crop of an image, (H, W), inside borders that are never brighter than black.

    None if there are no borders, or if the crop would be too small.
    """
    crop = crop_of(brightest > _BLACK)
    if crop is None or crop.width < _MIN_LEFT * brightest.shape[1]:
        return None
    return None if crop.height < _MIN_LEFT * brightest.shape[0] else crop


def crop_of(lit: Flags) -> Crop | None:
    """The crop inside the borders of an image, (H, W), where few pixels are lit; None for none."""
    spans = []
    for axis in (0, 1):
        lines = np.flatnonzero(lit.mean(axis=axis) > _LIT_SHARE)
        side = lit.shape[1 - axis]
        if not lines.size:
            return None
        first, last = int(lines[0]), int(lines[-1]) + 1
        first = first if first >= _MIN_BAR_PX else 0
        spans.append((first, last if side - last >= _MIN_BAR_PX else side))
    (left, right), (top, bottom) = spans
    crop = Crop(right - left, bottom - top, left, top)
    return None if (crop.height, crop.width) == lit.shape else crop


def has_comb(grey: npt.NDArray[np.uint8]) -> bool:
    """Whether even and odd lines of an image, (H, W), do not belong together.

    In moving parts of an interlaced image, a line differs more from its neighbour than from the
    line two below. In a progressive image, only stripes two lines wide show such a comb.
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


def has_analog_size(decoder: Decoder) -> bool:
    """Whether the images of a video have a size in which a comb can be seen."""
    return decoder.info.height in _ANALOG_LINES and decoder.info.width <= _MAX_ANALOG_WIDTH


def is_combed(decoder: Decoder) -> bool:
    """Whether the first moving images of a video are interlaced; reads on in `decoder`."""
    before: GreyImage | None = None
    n_judged = n_combed = n_left_out = 0
    for _ in islice(decoder.stamps(), _MOST):
        if n_left_out:
            n_left_out -= 1
            continue
        try:
            image = decoder.picture()
        except Unreadable:
            break
        grey = to_grey_levels(image, decoder.info.levels)
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
