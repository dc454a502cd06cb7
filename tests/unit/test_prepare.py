"""Frames without flicker, and with filled hidden cells; steps of the exposure."""

import numpy as np
import pytest

from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.prepare import Filling, Flicker

RNG = np.random.default_rng(4)
SCENE = np.kron(RNG.integers(40, 200, (30, 80), np.uint8), np.ones((5, 5), np.uint8))


def views(n):
    """A pan over a scene, down and to the right, 72 x 96."""
    return [SCENE[i : i + 72, 2 * i : 2 * i + 96].copy() for i in range(n)]


def expansions(pictures, deflicker=True):
    """How fast images expand, in 1/s, from the second on."""
    expansion = Expansion(deflicker=deflicker)
    return np.array([expansion.step(one, n / 30).expansion for n, one in enumerate(pictures)])[1:]


def lit(pictures, depth, fps=30.0, mains_hz=100.0):
    """The same under mains light, as a rolling shutter sees it."""
    out = []
    for number, picture in enumerate(pictures):
        rows = (number / fps + np.linspace(0.0, 0.02, len(picture))) * mains_hz
        light = 1.0 + depth * np.sin(2.0 * np.pi * rows)
        out.append(np.clip(np.rint(picture * light[:, None]), 0, 255).astype(np.uint8))
    return out


@pytest.mark.parametrize("kind", [np.uint8, np.float32])
@pytest.mark.parametrize(("fps", "mains_hz", "period"), [(30, 100, 3), (25, 120, 5), (24, 100, 0)])
def test_flicker_is_removed(kind, fps, mains_hz, period):
    """Of a period up to five frames."""
    pictures = [SCENE[n // 4 : n // 4 + 72, n : n + 96].copy() for n in range(60)]
    unit = 1 if kind == np.uint8 else kind(1 / 255)
    flicker, left, seen = Flicker(), [], []
    for clean, one in zip(pictures, lit(pictures, 0.12, fps, mains_hz), strict=True):
        found = flicker.of((one * unit).astype(kind))
        left.append(np.abs(found / unit - clean).mean())
        seen.append(np.abs(one - clean.astype(float)).mean())
    assert flicker.period == period
    assert (np.mean(left[20:]) < 0.3 * np.mean(seen[20:])) == (period > 0)


def test_what_does_not_flicker_passes():
    """Motion, a cut, steps of the exposure, and noise: not a bit is changed."""
    rng = np.random.default_rng(6)
    steps = [np.uint8(one * (0.8 if n // 8 % 2 else 1.0)) for n, one in enumerate(views(60))]
    noise = [rng.integers(0, 256, (72, 96), np.uint8) for _ in range(60)]
    cut = [*views(60)[:30], *views(60)[:30]]
    for pictures in (views(60), steps, noise, cut):
        flicker = Flicker()
        assert all(flicker.of(one) is one for one in pictures)


def test_hidden_cells_are_like_those_around_them():
    hidden = np.zeros((72, 96), bool)
    hidden[30:36, 40:50] = True
    for kind in (np.uint8, np.float32):
        frame = np.tile(np.linspace(0, 200, 96), (72, 1)).astype(kind)
        filled = frame.copy()
        filled[hidden] = 255
        Filling(hidden).fill(filled)
        assert (filled[~hidden] == frame[~hidden]).all() and filled.dtype == kind
        assert np.abs(filled[hidden] - frame[hidden].astype(float)).max() < 15
    everywhere = np.ones((72, 96), bool)
    everywhere[0, 0] = False
    Filling(everywhere).fill(frame)
    assert (frame == frame[0, 0]).all()


def test_a_step_of_the_exposure_is_no_expansion():
    """The image turns darker and brighter by a fifth; nothing moves."""
    steps = [np.uint8(views(1)[0] * (0.8 if n // 8 % 2 else 1.0)) for n in range(40)]
    assert np.abs(expansions(steps)).max() < 0.1


def test_an_approach_does_not_flicker():
    """A white square that approaches makes half of the image brighter: nothing is removed."""
    pictures = [np.full((72, 96), 60, np.uint8) for _ in range(40)]
    for n, one in enumerate(pictures):
        reach = round(40 * 0.93 ** (40 - n))
        one[36 - min(reach, 36) : 36 + reach, 48 - reach : 48 + reach] = 240
    found, expected = expansions(pictures), expansions(pictures, deflicker=False)
    np.testing.assert_array_equal(found, expected)
    assert np.nanmax(found) > 0.5
