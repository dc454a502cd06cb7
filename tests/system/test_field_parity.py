"""The models of the field against the numbers of their public code, on every kind of stimulus."""

import pytest
from field_answers import CASES, check_benchmark

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
