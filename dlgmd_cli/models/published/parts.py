"""What models of the field are made of."""

import math
from typing import Any

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.frame import FloatImage

# The weights of the four nearest cells and of the corners.
NEIGHBOURS = np.array([[0.125, 0.25, 0.125], [0.25, 0.0, 0.25], [0.125, 0.25, 0.125]], np.float32)
# Beyond the border of the frame, everything is 0.
ZERO = cv2.BORDER_CONSTANT


def whose_code() -> Any:
    """The key `formulation` of a model whose code in the benchmark differs from its authors'."""
    meaning = "whose code: the authors' or the benchmark's"
    return dlgmd_cli.key("authors", meaning=meaning, choices=("authors", "benchmark"))


def threshold_2019() -> Any:
    """The key `t_mp` of Fu 2019, in fuqinbing/LGMD-Plus-and-GAs-Open-Source (LGMDSingle.cs)."""
    return dlgmd_cli.key(0.78, "T_sp", "–", "spiking threshold of MP, Fu 2019", 0, 1)


def spikes_2019() -> Any:
    """The key `n_sp` of Fu 2019, as `threshold_2019`."""
    meaning = "spikes in a row that raise an alarm, Fu 2019"
    return dlgmd_cli.key(5, "N_ts", "frames", meaning, 1, 1000)


class LowPass:
    """y(t) = now x(t) + last y(t-1) + before y(t-2) … of numbers or images x, from rest."""

    def __init__(self, now: float, *of_earlier: float) -> None:
        self._now, self._of_earlier = now, of_earlier
        self._earlier: list[Any] = []

    def __call__(self, x: Any) -> Any:
        """y(t) from x(t); an image is newly allocated, and must not be changed."""
        y = self._now * x
        for weight, earlier in zip(self._of_earlier, self._earlier, strict=False):
            y += weight * earlier
        self._earlier = [y, *self._earlier][: len(self._of_earlier)]
        return y


def sigmoid(k: float) -> float:
    """1 / (1 + exp(-k)) in single precision, as in the public code: 1 from k = 17 on."""
    return float(np.float32(1.0 / (1.0 + math.exp(-k))))


def positive(image: FloatImage) -> FloatImage:
    """max(X, 0) of an image X, newly allocated."""
    return np.asarray(cv2.threshold(image, 0.0, 0.0, cv2.THRESH_TOZERO)[1], np.float32)


def at_least(image: FloatImage, least: float) -> FloatImage:
    """An image where it is at least `least`, else 0, newly allocated."""
    below = float(np.nextafter(np.float32(least), np.float32(-np.inf)))
    return np.asarray(cv2.threshold(image, below, 0.0, cv2.THRESH_TOZERO)[1], np.float32)


def added(image: FloatImage, weight: float, other: FloatImage) -> FloatImage:
    """X + weight Y of two images, newly allocated."""
    return np.asarray(cv2.scaleAdd(other, weight, image), np.float32)


def convolved(image: FloatImage, kernel: FloatImage, border: int = ZERO) -> FloatImage:
    """The convolution of an image, (H, W), with a symmetric kernel, newly allocated."""
    return np.asarray(cv2.filter2D(image, -1, kernel, borderType=border), np.float32)


def mean3(image: FloatImage, border: int = ZERO) -> FloatImage:
    """The mean of the 3x3 cells around each cell, newly allocated."""
    return np.asarray(cv2.blur(image, (3, 3), borderType=border), np.float32)


def grouped(s: FloatImage, least: float, c_omega: float = 4.0, border: int = ZERO) -> FloatImage:
    """The grouping layer of [Yue2006]: S Ce / ω where that is at least `least`, else 0.

    Ce is the mean of 3x3 cells of S, and ω = 0.01 + max|Ce| / c_omega.
    """
    ce = mean3(s, border)
    omega = 0.01 + cv2.norm(ce, cv2.NORM_INF) / c_omega
    cv2.multiply(s, ce, dst=ce, scale=1.0 / omega)
    return at_least(ce, least)


def summed(image: FloatImage) -> np.float32:
    """Σ of an image in single precision, added in the order of PyTorch, so that no bit differs.

    PyTorch has 32 running sums, in blocks of 16, 256 and 4096 numbers. The first 8 of them get the
    numbers that are left over, and the last few of these come before all others.
    """
    numbers = image.ravel()
    eights = numbers[: numbers.size // 8 * 8].reshape(-1, 8)
    rows, sums = eights[: len(eights) // 4 * 4].reshape(-1, 32), np.zeros(32, np.float32)
    left_over = eights[4 * len(rows) :]
    for _ in range(3):
        n_in_blocks = len(rows) // 16 * 16
        sums = sums + rows[n_in_blocks:].sum(axis=0)
        rows = rows[:n_in_blocks].reshape(-1, 16, 32).sum(axis=1)
    sums = sums + rows.sum(axis=0)
    first, *others = sums.reshape(4, 8)
    eight = np.stack([first, *left_over, *others]).sum(axis=0)
    return np.float32(sum([*numbers[eights.size :], *eight], np.float32(0)))
