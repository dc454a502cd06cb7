"""The divergence of optical flow, which the models are held against."""

import cv2
import numpy as np
import pytest

from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.presets import FlowDivergenceParameters

SIZE = 120, 160


def moved(matrix):
    """Four frames of a texture, each moved by `matrix` from the one before."""
    height, width = SIZE
    noise = np.random.default_rng(3).random((height, width)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 4), None, 0, 255, cv2.NORM_MINMAX)
    frames = []
    for n in range(4):
        whole = np.linalg.matrix_power(np.vstack([matrix, [0, 0, 1]]), n)[:2]
        frame = cv2.warpAffine(
            texture, whole, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
        frames.append(np.uint8(np.clip(frame, 0, 255)))
    return frames


def about_the_centre(scale):
    height, width = SIZE
    return cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, scale)


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        (about_the_centre(1.02), 1.2),  # 2 % a frame in each direction, 30 frames a second
        (about_the_centre(0.98), 0.0),  # receding: only what is positive counts
        (np.array([[1.0, 0, 1.5], [0, 1, 0.5]]), 0.0),
    ],
)
def test_mean_divergence(matrix, expected):
    model = create_model(FlowDivergenceParameters())
    frames = moved(matrix)
    answers = [model.step(frame).mp / frame.size for frame in frames]
    assert np.isnan(answers[0])
    np.testing.assert_allclose(answers[1:], expected, atol=0.3)
    for fps in (30, 50):  # always per second; without times, 30 frames a second
        model.reset()
        timed = [model.step(frame, n / fps).mp / frame.size for n, frame in enumerate(frames)]
        np.testing.assert_allclose(timed[1:], fps / 30 * np.array(answers[1:]))
    model.reset()
    bright = [model.step(np.float32(frame / 255)).mp / frame.size for frame in frames]
    np.testing.assert_allclose(bright[1:], answers[1:])
