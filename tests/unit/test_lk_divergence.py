"""The expansion rate of tracked corners, which the models are compared with."""

import cv2
import numpy as np
import pytest

from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.presets import LkDivergenceParameters

SIZE = 120, 160


def moved(matrix, n=4):
    """Frames of a texture, each moved by `matrix` from the one before."""
    height, width = SIZE
    noise = np.random.default_rng(3).random((height, width)).astype(np.float32)
    texture = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2), None, 0, 255, cv2.NORM_MINMAX)
    frames = []
    for k in range(n):
        whole = np.linalg.matrix_power(np.vstack([matrix, [0, 0, 1]]), k)[:2]
        frame = cv2.warpAffine(
            texture, whole, (width, height), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
        )
        frames.append(np.uint8(np.clip(frame, 0, 255)))
    return frames


def about_the_centre(scale):
    height, width = SIZE
    return cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, scale)


def rates(model, frames, fps=None):
    """K per cell of every frame, in 1/s."""
    model.reset()
    times = [None if fps is None else n / fps for n in range(len(frames))]
    return [model.step(*one).mp / frames[0].size for one in zip(frames, times, strict=True)]


@pytest.mark.parametrize(
    ("matrix", "expected"),
    [
        (about_the_centre(1.02), 0.6),  # 2 % a frame, 30 frames a second
        (about_the_centre(0.98), 0.0),  # receding: only what is positive counts
        (np.array([[1.0, 0, 1.5], [0, 1, 0.5]]), 0.0),
    ],
)
def test_expansion_rate(matrix, expected):
    model, frames = create_model(LkDivergenceParameters()), moved(matrix)
    answers = rates(model, frames)
    assert np.isnan(answers[0])
    # It approaches its end with the time constant of 0.1 s.
    shares = 1.0 - np.exp(-np.arange(1, 4) / 3.0)
    np.testing.assert_allclose(answers[1:], expected * shares, atol=0.03)
    np.testing.assert_allclose(rates(model, frames, fps=30)[1:], answers[1:])
    slower = 1.0 - np.exp(-np.arange(1, 4) / 1.5)
    np.testing.assert_allclose(rates(model, frames, fps=15)[1:], expected / 2 * slower, atol=0.03)
    bright = [np.float32(frame / 255) for frame in frames]
    np.testing.assert_allclose(rates(model, bright)[1:], answers[1:])


def test_a_frame_without_corners_has_no_expansion():
    frames = [np.full(SIZE, 90, np.uint8)] * 3
    assert rates(create_model(LkDivergenceParameters()), frames)[1:] == [0.0, 0.0]


def test_ignored_cells_have_no_corners():
    model, frames = create_model(LkDivergenceParameters()), moved(about_the_centre(1.02))
    model.ignore(np.ones(SIZE, np.bool_))
    assert [model.step(frame).mp for frame in frames][1:] == [0.0] * 3


def test_its_photoreceptors_see_every_change():
    model = create_model(LkDivergenceParameters())
    first, second = moved(about_the_centre(1.02), 2)
    model.step(first)
    changes = np.abs(np.float64(second) - first) / 255
    assert model.step(second).p_sum == pytest.approx(changes.sum())
