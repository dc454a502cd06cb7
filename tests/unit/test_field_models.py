"""The models of the field against the numbers of their public code."""

import numpy as np
import pytest
from reference_data import reference_dir

import dlgmd_cli

STIMULI = [
    *("dark_looming", "light_receding", "dark_translating_vertical"),
    *("light_translating_horizontal", "dark_elongating_vertical", "light_shortening_vertical"),
    *("light_elongating_horizontal", "dark_shortening_horizontal", "chessboard_160x120"),
    *("texture_pan_131x97", "noise_64x48", "tof_A00_162x122", "cube_160x90"),
]
# Model -> its name among the stored answers, and the parameters with which it is the benchmark's.
BENCHMARK = {"formulation": "benchmark"}
CASES = {
    "lgmd-2006": ("basic", {}),
    "mc-lgmd": ("mc", BENCHMARK),
    "sfa-lgmd": ("sfa", BENCHMARK),
}


def field(name):
    path = reference_dir() / "field" / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    return np.load(path)


@pytest.mark.parametrize("model", CASES)
@pytest.mark.parametrize("stimulus", STIMULI)
def test_every_frame_is_the_benchmarks(model, stimulus):
    key, param = CASES[model]
    answers = field("answers")
    result = dlgmd_cli.run(field("stimuli")[stimulus], model, fps=30, param=param)
    for values, name in ((result.mp, key), (result.k, f"{key}_k")):
        np.testing.assert_allclose(values, answers[f"{stimulus}/{name}"], rtol=1e-5, atol=1e-12)
    np.testing.assert_array_equal(result.level, result.mp)
