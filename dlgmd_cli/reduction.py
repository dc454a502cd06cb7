"""Images of other sizes: the grey images that models and the expansion take."""

import math
from functools import lru_cache

import cv2
import numpy as np

from dlgmd_cli.frame import FloatImage, Image

# A reduction by this factor or more begins by halving the image.
_FAR = 16
# So many numbers of single precision stay in the cache.
_IN_CACHE = 1 << 16


def resized(image: Image, size_wh: tuple[int, int]) -> Image:
    """A grey image (H, W) at a size, in new memory; see `Reducer`."""
    reducer = Reducer()
    reducer.take(image)
    return reducer.at(size_wh)


class Reducer:
    """Resizes grey images: area averages if they shrink, else linear interpolation.

    OpenCV halves an image seven times as fast as it divides the sides by 4 or by a fraction.
    Reduction by an even whole factor therefore begins with a halving. So does reduction by a factor
    of 16 or more, where the pixel pairs at the edges of an area hardly matter. Both steps round to
    whole levels: the result is within 1 of the exact mean, or within 1.25 for noise and a factor
    of 16. By factors such as 8/3, see `_shares`, the means are those of OpenCV, in half the time.

    Attributes
    ----------
    grey : ndarray, shape (H, W)
        The grey image before it is reduced. The next image overwrites it: new memory would take
        longer than the conversion.
    """

    def __init__(self) -> None:
        self._converted: Image | None = None
        self._half: Image | None = None
        # An image, and its means before they are rounded.
        self._means: tuple[Image | None, Image] = None, np.empty((0, 0))
        self._area_means: dict[tuple[tuple[int, ...], tuple[int, int]], _AreaMeans] = {}

    def take(self, image: Image) -> None:
        """Begin with the next image, (H, W) grey or (H, W, 3) BGR."""
        if image.ndim == 3:
            image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY, dst=self._converted)
            self._converted = image
        self.grey, self._is_halved, self._means = image, False, (None, image)

    def at(self, size_wh: tuple[int, int]) -> Image:
        """The grey image at a size, in new memory; the largest size is best asked for first."""
        (width, height), image = size_wh, self.grey
        sides = tuple(zip(image.shape, (height, width), strict=True))
        halves_well = all(old % 2 == 0 and old >= _FAR * new for old, new in sides)
        if halves_well or all(old % (2 * new) == 0 for old, new in sides):
            image = self._halved()
        if image.shape == (height, width):
            return image.copy()
        of_image, means = self._means
        if of_image is image and means.shape == (2 * height, 2 * width):
            return cv2.convertScaleAbs(_resize(means, size_wh))
        is_fast = image.shape == (2 * height, 2 * width) or image.dtype != np.uint8
        rows, columns = _shares(image.shape[0], height), _shares(image.shape[1], width)
        if is_fast or rows is None or columns is None:
            return _resize(image, size_wh)
        sizes = image.shape, size_wh
        if sizes not in self._area_means:
            self._area_means[sizes] = _AreaMeans(image.shape, rows, columns)
        means = self._area_means[sizes].of(image)
        self._means = image, means
        # Rounds halves to even levels, as OpenCV does in a reduction.
        return cv2.convertScaleAbs(means)

    def _halved(self) -> Image:
        """The image at half its size."""
        if not self._is_halved or self._half is None:
            image = self.grey
            # Reading two rows at once, as halving does, is slow outside the cache.
            image = image if image is self._converted else image.copy()
            half_wh = image.shape[1] // 2, image.shape[0] // 2
            self._half = cv2.resize(image, half_wh, dst=self._half, interpolation=cv2.INTER_AREA)
            self._is_halved = True
        return self._half


def _resize(image: Image, size_wh: tuple[int, int]) -> Image:
    """A grey image resized by OpenCV."""
    shrinks = size_wh[0] <= image.shape[1] and size_wh[1] <= image.shape[0]
    way = cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR
    return cv2.resize(image, size_wh, interpolation=way)


@lru_cache(maxsize=16)
def _shares(old: int, new: int) -> FloatImage | None:
    """The shares that n cells have in m means, (m, n), where a side shrinks by n/m = old/new.

    None unless n is a power of 2, at most 64: only then are all sums exact in single precision.
    """
    divisor = math.gcd(old, new)
    n, m = old // divisor, new // divisor
    if n < m or n > 64 or n & (n - 1):
        return None
    cells, means = np.arange(n), np.arange(m)[:, np.newaxis]
    ends = np.minimum(m * (cells + 1), n * (means + 1))
    return (np.maximum(ends - np.maximum(m * cells, n * means), 0) / n).astype(np.float32)


class _AreaMeans:
    """The area means of images of one shape, (H, W), by the `_shares` of their rows and columns.

    The next result overwrites the last one.
    """

    def __init__(self, shape: tuple[int, ...], rows: FloatImage, columns: FloatImage) -> None:
        (m, n), (height, width) = rows.shape, shape
        self._rows, self._columns = rows, np.ascontiguousarray(columns.T)
        n_blocks = min(height // n, max(1, _IN_CACHE // (n * width)))
        self._block = np.empty((n_blocks, n, width), np.float32)
        self._down = np.empty((height // n, m, width), np.float32)
        n_lines = height // n * m
        self._means = np.empty((n_lines, width // len(self._columns), len(columns)), np.float32)

    def of(self, image: Image) -> FloatImage:
        """The means, before they are rounded."""
        n_blocks, n, width = self._block.shape
        blocks = image.reshape(-1, n, width)
        for first in range(0, len(blocks), n_blocks):
            some = blocks[first : first + n_blocks]
            block = self._block[: len(some)]
            np.copyto(block, some)
            np.matmul(self._rows, block, out=self._down[first : first + len(some)])
        n, m = self._columns.shape
        np.matmul(self._down.reshape(-1, n), self._columns, out=self._means.reshape(-1, m))
        return self._means.reshape(len(self._means), -1)
