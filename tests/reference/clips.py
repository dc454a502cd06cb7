"""Small seeded clips with motion in them, as lists of (H, W) float32 in 0..1."""

import numpy as np


def drifting(height, width, n_frames, seed, grid=None):
    """A random texture that slides by about a pixel a frame while its contrast swells.

    With `grid`, luminance is a multiple of 1/grid; for a power of two, float32 then holds every
    value, difference and complement of it exactly.
    """
    rng = np.random.default_rng(seed)
    texture = rng.random((height + n_frames, width + n_frames))
    frames = []
    for t in range(n_frames):
        down, right = (t, n_frames - t) if t % 3 else (t // 2, n_frames - t)
        seen = texture[down : down + height, right : right + width]
        frame = 0.5 + (seen - 0.5) * min(0.1 * 1.7**t, 1.0)
        frames.append(_store(frame, grid))
    return frames


def looming(height, width, n_frames, seed, grid=None):
    """A dark disc that grows faster and faster in front of a faint fixed texture."""
    rng = np.random.default_rng(seed)
    ground = 0.8 + 0.2 * rng.random((height, width))
    rows, columns = np.mgrid[:height, :width]
    distance = np.hypot(rows - 0.45 * height, columns - 0.55 * width)
    frames = []
    for t in range(n_frames):
        radius_px = 0.15 * max(height, width) * 1.45**t
        inside = np.clip(radius_px - distance, 0.0, 1.0)
        frames.append(_store(ground * (1.0 - inside), grid))
    return frames


def _store(frame, grid):
    if grid is not None:
        frame = np.round(frame * grid) / grid
    return frame.astype(np.float32)
