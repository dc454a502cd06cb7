"""A picture to paste on a face, with smaller copies of itself to sample from when it is far."""

from functools import cached_property

import cv2
import numpy as np
import numpy.typing as npt

FloatImage = npt.NDArray[np.float32]

# OpenCV takes ten times as long for what it samples outside an image as for what is inside.
MARGIN = 4


class Texture:
    """Reflectance over a rectangle.

    Parameters
    ----------
    image : ndarray, shape (h, w), float32
        Reflectance in 0..1, linear in light. A single pixel is a plain colour.
    """

    def __init__(self, image: npt.ArrayLike) -> None:
        self.image: FloatImage = np.ascontiguousarray(np.atleast_2d(image), np.float32)

    @cached_property
    def mean(self) -> float:
        """Mean reflectance."""
        return float(self.image.mean())

    @cached_property
    def levels(self) -> tuple[FloatImage, ...]:
        """The image and its copies at 1/2, 1/4, … of its size, down to a single pixel.

        Each has a margin of `MARGIN` pixels in the colour of its rim.
        """
        levels = [self.image]
        while max(levels[-1].shape) > 1:
            height, width = ((side + 1) // 2 for side in levels[-1].shape)
            small: FloatImage = np.asarray(
                cv2.resize(levels[-1], (width, height), interpolation=cv2.INTER_AREA), np.float32
            )
            levels.append(small.reshape(height, width))
        return tuple(np.pad(level, MARGIN, mode="edge") for level in levels)
