"""The engines on frames of 12 million cells, whose sums are large."""

import numpy as np
import pytest

pytest.importorskip("numba", reason="the numba engine needs numba")

from engine_checks import answers, scene

from dlgmd_cli.models.engines import ENGINES

pytestmark = pytest.mark.slow


def test_engines_agree_to_1e4_of_the_peak():
    frames = scene(3000, 4000, n_frames=5)
    one, other = ([a.mp for a in answers(engine, frames)] for engine in ENGINES)
    assert np.isfinite(one[3:]).all() and np.nanmax(one) > 0.0
    np.testing.assert_allclose(other, one, rtol=0, atol=1e-4 * np.nanmax(one))
