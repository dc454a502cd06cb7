"""Images of a textured plane that comes closer, at any frame rate."""

import cv2
import numpy as np


def approach(n_frames, fps, contact_s, size_wh=(120, 68), seed=5):
    """Frames, (H, W) uint8, of a plane that is reached after `contact_s`; it expands about the
    middle by 1 / (contact_s - t) a second.
    """
    width, height = size_wh
    noise = np.random.default_rng(seed).integers(0, 256, (3 * height, 3 * width))
    plane = cv2.GaussianBlur(np.uint8(noise), (0, 0), width / 60)
    plane = cv2.normalize(plane, None, 40, 215, cv2.NORM_MINMAX)
    frames = []
    for t in range(n_frames):
        scale = 0.5 * contact_s / (contact_s - t / fps)
        right, down = width * (1 - 3 * scale) / 2, height * (1 - 3 * scale) / 2
        towards = np.float32([[scale, 0, right], [0, scale, down]])
        frames.append(cv2.warpAffine(plane, towards, size_wh, borderMode=cv2.BORDER_REFLECT))
    return frames
