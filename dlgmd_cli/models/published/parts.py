"""What several models of the field have in common."""

import math

import cv2
import numpy as np

from dlgmd_cli.frame import FloatImage

# The formulations of a model whose code in the benchmark differs from its authors'.
CODES = ("authors", "benchmark")
# The weights of the four nearest cells and of the corners.
NEIGHBOURS = np.array([[0.125, 0.25, 0.125], [0.25, 0.0, 0.25], [0.125, 0.25, 0.125]], np.float32)
# Beyond the border of the frame, everything is 0.
ZERO = cv2.BORDER_CONSTANT


def sigmoid(k: float) -> float:
    """1 / (1 + exp(-k)) in single precision, as in the public code: 1 from k = 17 on."""
    return float(np.float32(1.0 / (1.0 + math.exp(-k))))


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
    g = cv2.multiply(s, ce, dst=ce, scale=1.0 / omega)
    g[g < np.float32(least)] = 0.0
    return np.asarray(g, np.float32)
