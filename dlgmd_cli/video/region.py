"""The part of an image that models get: a rectangle without the pixels that a mask hides."""

from functools import lru_cache
from pathlib import Path

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import Flags, Image, resized
from dlgmd_cli.video.base import Crop, Unreadable
from dlgmd_cli.video.images import read_image

# Mean of a cell (0 to 255) without any black pixel of the mask, with a margin for rounding.
_WHOLE = 254.95


def read_mask(path: str) -> Flags:
    """Where the image at `path` is black, (H, W): darker than a medium grey in every channel.

    Raises ParameterError if it is not an image.
    """
    try:
        image = read_image(Path(path))
    except Unreadable as error:
        why = str(error) if Path(path).exists() else "does not exist"
        hint = "Give a PNG whose black is left out."
        raise ParameterError("", f"--mask {path} {why}", hint) from None
    brightest = image.max(axis=2) if image.ndim == 3 else image
    return np.asarray(brightest <= np.iinfo(image.dtype).max // 2)


class Region:
    """A rectangle of an image without the black pixels of a mask; the whole image by default.

    The image has the size `picture_wh`, in px, and the rectangle `crop`, inside it, `size_wh`.
    `masked` is True for black pixels, see `read_mask`. One of the image's size is cut as the
    image is; one of any other size is resized to cover the rectangle.
    """

    def __init__(
        self, picture_wh: tuple[int, int], crop: Crop | None = None, masked: Flags | None = None
    ) -> None:
        width, height, x, y = crop or Crop(*picture_wh, 0, 0)
        self.size_wh = width, height
        self._place = np.s_[y : y + height, x : x + width]
        is_whole = masked is not None and masked.shape == (picture_wh[1], picture_wh[0])
        self._masked = self.of(masked) if masked is not None and is_whole else masked
        self.hidden = lru_cache(maxsize=16)(self._hidden)

    def of(self, image: Image) -> Image:
        """The rectangle of an image, (H, W) or (H, W, 3); a view."""
        return image[self._place]

    def _hidden(self, size_wh: tuple[int, int]) -> Flags | None:
        """The hidden cells, (H, W) bool, of the rectangle at a size; None if there are none.

        A cell is hidden if any part of it is black. Raises ParameterError if no cell remains.
        """
        if self._masked is None or not self._masked.any():
            return None
        shown = np.where(self._masked, np.float32(0.0), np.float32(255.0))
        hidden = np.asarray(resized(shown, size_wh) < _WHOLE)
        if hidden.all():
            why = f"--mask leaves no cell of {size_wh[0]}x{size_wh[1]}"
            raise ParameterError("", why, "Paint white what the model should use.")
        return hidden
