"""Scenes for the engines, and whether both give the same answers."""

import math

import numpy as np
import pytest
from reference import slow

from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.engines import ENGINES
from dlgmd_cli.parameters.presets import MODELS

SUMS = ("p_sum", "s_sum", "mp", "ffi", "t_de")


def scene(height, width, n_frames=6, dtype=np.uint8, seed=3):
    """Blocks that drift, and bright squares that grow fast: something for every tile."""
    rng = np.random.default_rng(seed)
    ground = rng.integers(40, 160, (height // 5 + 9, width // 5 + 9), dtype=np.uint8)
    ground = np.kron(ground, np.ones((5, 5), np.uint8))
    frames = []
    for t in range(n_frames):
        frame = ground[2 * t : 2 * t + height, 3 * t : 3 * t + width].copy()
        for y in range(height // 2 % 80, height, 80):
            for x in range(width // 2 % 80, width, 80):
                rows, columns = (slice(max(0, c - 5 * t), c + 5 * t) for c in (y, x))
                frame[rows, columns] = 250
        frames.append(frame)
    return frames if dtype == np.uint8 else [f.astype(dtype) / dtype(255) for f in frames]


def create(engine, name="dlgmd", **changes):
    """A model with little inhibition, so that something passes everywhere."""
    values = (slow.table_2(9) if name == "dlgmd" else {}) | {"a": 0.4} | changes
    return create_model(MODELS[name](**values), engine=engine)


def answers(engine, frames, name="dlgmd", **changes):
    """Responses with layers."""
    model = create(engine, name, **changes)
    responses = [model.step(frame, layers=True) for frame in frames]
    assert model.engine_name == engine
    return responses


def assert_engines_agree(frames, name="dlgmd", **changes):
    """Sums and layers of both engines."""
    one, other = (answers(engine, frames, name, **changes) for engine in ENGINES)
    assert one[-1].is_valid
    for a, b in zip(one, other, strict=True):
        for name in SUMS:
            expected = pytest.approx(getattr(a, name), rel=1e-5, abs=1e-4, nan_ok=True)
            assert getattr(b, name) == expected, name
        for name in ("g_x", "g_y"):
            # The cells of the same weight that may fall on either side of a threshold.
            assert getattr(b, name) == pytest.approx(getattr(a, name), abs=1e-3, nan_ok=True)
        if a.is_valid:
            scale = max(1.0, float(a.layers.s.max()))
            np.testing.assert_allclose(a.layers.s, b.layers.s, rtol=0, atol=2e-5 * scale)
            # A cell at the threshold may fall on either side.
            apart = np.abs(a.layers.g - b.layers.g) > 1e-4 * scale**2
            assert apart.sum() <= 2 and np.all(np.minimum(a.layers.g, b.layers.g)[apart] == 0.0)
    # Late kernels may let nothing pass.
    assert changes or max(a.mp for a in one if a.is_valid) > 0.0 or min(frames[0].shape) == 1


def check_what_is_no_number(engine, name):
    """NaN is in the sums as long as it is in the history, and no longer."""
    frames = scene(20, 30, n_frames=10, dtype=np.float32)
    frames[0][5, 5] = frames[5][5, 5] = np.nan
    model = create(engine, name)
    responses = [model.step(frame) for frame in frames]
    assert math.isnan(responses[5].s_sum)
    for t in (4, 9):  # it has left the history
        assert math.isfinite(responses[t].s_sum) and math.isfinite(responses[t].t_de)
