"""Images of a camera that turns, and the fields of two of them in one."""

import cv2
import numpy as np

HEIGHT, WIDTH = 480, 320
RNG = np.random.default_rng(5)
GROUND = cv2.GaussianBlur(RNG.integers(0, 256, (HEIGHT, 1200), np.uint8), (0, 0), 3.0)
GROUND = cv2.normalize(GROUND, None, 20, 235, cv2.NORM_MINMAX)


def at(x_px):
    """What a camera sees that has turned by so many px."""
    return GROUND[:, x_px : x_px + WIDTH]


def woven(first, second):
    """The even lines of an image and the odd ones of another."""
    picture = first.copy()
    picture[1::2] = second[1::2]
    return picture
