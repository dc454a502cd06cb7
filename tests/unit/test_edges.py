"""Numbers at the edge: tiny frames, few of them, any rate, backward times, sums too large."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import FPS, make_result, scene

import dlgmd_cli
from dlgmd_cli import DLGMD


@pytest.mark.parametrize("fps", [1.0, 1000.0])
def test_at_any_rate_the_neuron_counts_frames(fps):
    frames = np.stack(scene(40, 60, 12))
    usual, other = (dlgmd_cli.run(frames, 9, input_fps=rate, fps="all") for rate in (30.0, fps))
    assert np.array_equal(usual.mp, other.mp, equal_nan=True) and np.isfinite(other.mp[3:]).all()
    assert other.time_s[-1] == pytest.approx(11 / fps)


@pytest.mark.filterwarnings("ignore::dlgmd_cli.DlgmdWarning")
def test_a_potential_that_is_no_number_is_reported():
    class Broken(DLGMD):
        """One whose potential fails at the seventh frame."""

        def reset(self):
            super().reset()
            self.n_frames = 0

        def step(self, *given, **options):
            response, self.n_frames = super().step(*given, **options), self.n_frames + 1
            return replace(response, mp=math.nan) if self.n_frames == 7 else response

    frames = np.stack(scene(40, 60, 12))
    of_all = {"input_fps": 30, "fps": "all", "repeats": "keep"}
    lines = dlgmd_cli.run(frames, Broken, **of_all).warnings
    assert any("undefined" in line and "frame 6" in line for line in lines)
    lines = dlgmd_cli.run(frames, 9, **of_all).warnings
    assert not any("infinite" in line or "undefined" in line for line in lines)


@pytest.mark.parametrize("gap_s", [0.0, 1.0])
def test_a_potential_that_a_gap_in_time_ends_is_no_fault(gap_s):
    """After a gap the model resets, and has none for a few frames."""
    mp, time_s = np.arange(20.0), np.arange(20) / FPS
    mp[10:13], time_s[10:] = np.nan, time_s[10:] + gap_s
    result = make_result(mp, time_s=time_s)
    result.rows["gap"][10] = gap_s > 0.0
    lines = result.doubts()
    assert any("undefined (NaN) at frame 10" in line for line in lines) == (gap_s == 0.0)
