"""The only caller of OpenCV's convolutions. Everything outside the frame is zero.

`cv2.filter2D` correlates; the model's kernels are symmetric, so that it convolves as well.
"""

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import FloatImage

BORDER = cv2.BORDER_CONSTANT


@dataclass(frozen=True)
class Separable:
    """A filter that is the outer product of a column and a row."""

    column: npt.NDArray[np.float32]
    row: npt.NDArray[np.float32]

    def apply(self, image: FloatImage, out: FloatImage) -> None:
        """Filter `image` into `out`, both (H, W)."""
        cv2.sepFilter2D(image, -1, self.row, self.column, dst=out, borderType=BORDER)


@dataclass(frozen=True)
class Taps:
    """A filter given tap by tap; its cost grows with the taps that are not zero."""

    kernel: npt.NDArray[np.float32]

    def apply(self, image: FloatImage, out: FloatImage) -> None:
        """Filter `image` into `out`, both (H, W)."""
        cv2.filter2D(image, -1, self.kernel, dst=out, borderType=BORDER)


Filter = Separable | Taps


def sum_4x4(image: FloatImage, out: FloatImage) -> None:
    """Sum over rows and columns -1 … +2 about each cell, [Zhao2023] Eq. (9) without its gain."""
    # The window is even: OpenCV would anchor it at (2, 2), the released code does at (1, 1).
    cv2.boxFilter(image, -1, (4, 4), dst=out, anchor=(1, 1), normalize=False, borderType=BORDER)
