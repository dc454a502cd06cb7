"""The models of the field against the numbers of their public code, on every kind of stimulus."""

import sys
from pathlib import Path

import numpy as np
import pytest
from field_answers import BENCHMARK, CASES, check_benchmark, field

import dlgmd_cli

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_field_models import responses

STIMULI = [
    *("dark_looming", "light_receding", "dark_translating_vertical"),
    *("light_translating_horizontal", "dark_elongating_vertical", "light_shortening_vertical"),
    *("light_elongating_horizontal", "dark_shortening_horizontal", "chessboard_160x120"),
    *("texture_pan_131x97", "noise_64x48", "tof_A00_162x122", "cube_160x90"),
]


@pytest.mark.parametrize("model", CASES)
@pytest.mark.parametrize("stimulus", STIMULI)
def test_every_frame_is_the_benchmarks(model, stimulus):
    check_benchmark(model, stimulus)


def looming(n_frames=24, outward=True):
    """A dark square on white that grows from the centre, or shrinks; (n, 120, 120) uint8."""
    frames = np.full((n_frames, 120, 120), 255, np.uint8)
    for i, frame in enumerate(frames if outward else frames[::-1]):
        half = 8 + 2 * i
        frame[60 - half : 60 + half, 60 - half : 60 + half] = 0
    return frames


def test_the_probabilistic_models_mean_and_spread():
    """Of G, since the response of noise is 1; the stored numbers are of 20 seeds."""
    (frames,) = field("stimuli", "noise_64x48")
    mean, sd = field("answers", "noise_64x48/plgmd_k_mean", "noise_64x48/plgmd_k_sd")
    runs = [responses("plgmd", frames, seed=seed, **BENCHMARK)[1] for seed in range(30)]
    found, spread = np.mean(runs, axis=0)[2:], np.std(runs, axis=0, ddof=1)[2:]
    errors = abs(found - mean[2:]) / np.hypot(spread / 30**0.5, sd[2:] / 20**0.5)
    assert (errors < 3.0).mean() >= 0.9 and errors.max() < 5.0
    assert np.median(spread / sd[2:]) == pytest.approx(1.0, abs=0.25)


def test_lplc2_cells_see_what_approaches_and_the_benchmarks_what_recedes():
    def most(outward, param):
        return np.nanmax(dlgmd_cli.run(looming(outward=outward), "emd-lplc2", param=param).n_active)

    assert most(True, {}) > most(False, {})
    assert most(True, BENCHMARK) < most(False, BENCHMARK)
