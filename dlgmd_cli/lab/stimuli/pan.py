"""The view of a panning camera: a moving texture with sensor noise."""

import math
from collections.abc import Iterator

import cv2
import numpy as np

from dlgmd_cli.lab.stimuli.base import GreyImage

# Grain sizes of the texture, in px.
_GRAINS_PX = (4, 16, 64, 200)
# Standard deviation of the noise, in grey levels.
_NOISE_LEVELS = 4.0
# Motion of the camera across and down: amplitude, and angular frequency in rad/frame.
_SWAY_PX = (150.0, 100.0)
_SWAY_PER_FRAME = (1 / 18, 1 / 23)


def pan_frames(shape: tuple[int, int], n_frames: int, seed: int = 0) -> Iterator[GreyImage]:
    """Frames, (H, W) uint8, of a camera that sways in front of a random texture.

    They are as hard to decode as a flight. `seed` determines the texture and the noise.
    """
    height, width = shape
    rng = np.random.default_rng(seed)
    margin_x, margin_y = (math.ceil(sway) + 1 for sway in _SWAY_PX)
    side_wh = width + 2 * margin_x, height + 2 * margin_y
    texture = np.zeros(side_wh[::-1], np.float32)
    for grain in _GRAINS_PX:
        coarse = rng.random((side_wh[1] // grain + 3, side_wh[0] // grain + 3), np.float32)
        fine = cv2.resize(coarse, side_wh, interpolation=cv2.INTER_CUBIC)
        texture += fine * math.sqrt(grain)
    darkest, brightest = texture.min(), texture.max()
    texture = 20.0 + (texture - darkest) * np.float32(215.0 / (brightest - darkest))
    # Every frame shows a different window of one noise field.
    noise = _NOISE_LEVELS * rng.standard_normal((height + 256, width + 256), np.float32)
    for t in range(n_frames):
        x, y = (
            margin + sway * math.sin(t * speed)
            for margin, sway, speed in zip(
                (margin_x, margin_y), _SWAY_PX, _SWAY_PER_FRAME, strict=True
            )
        )
        shift = np.array([[1.0, 0.0, -x], [0.0, 1.0, -y]], np.float32)
        down, right = rng.integers(0, 256, 2)
        seen = cv2.warpAffine(texture, shift, (width, height))
        noisy = seen + noise[down : down + height, right : right + width]
        yield np.clip(np.rint(noisy), 0.0, 255.0).astype(np.uint8)
