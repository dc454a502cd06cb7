"""The stored answers of the benchmark's public code, and the check against them."""

import numpy as np
import pytest
from reference_data import reference_dir

import dlgmd_cli

# Model -> its name among the stored answers, the parameters with which it is the benchmark's, and
# the column of what is squashed.
BENCHMARK = {"formulation": "benchmark"}
CASES = {
    "lgmd-2006": ("basic", {}, "k"),
    "mc-lgmd": ("mc", BENCHMARK, "k"),
    "sfa-lgmd": ("sfa", BENCHMARK, "k"),
    "lgmd1-lgmd2": ("lgmd1_lgmd2", BENCHMARK, "k"),
    "lgmd2-lgmd1": ("lgmd2_lgmd1", BENCHMARK, "k"),
    "algmd": ("algmd", BENCHMARK, "v"),
    "emd-lplc2": ("emd_lplc2", BENCHMARK, "n_active"),
}
# The frames where a cell of a cascade passes T_sfa by the last bit of a convolution. On another
# computer, the benchmark's own code differs from its stored answers in four frames.
ROUNDED = {("lgmd1-lgmd2", "cube_160x90"): [9, 12], ("lgmd2-lgmd1", "texture_pan_131x97"): [28]}


def field(name, *keys):
    """Arrays of a file of the field's folder."""
    path = reference_dir() / "field" / f"{name}.npz"
    if not path.is_file():
        pytest.skip(f"no {path}")
    with np.load(path) as arrays:
        return [arrays[key] for key in keys]


def check_benchmark(model, stimulus):
    """Every frame of a stimulus is answered as by the public code."""
    key, param, column = CASES[model]
    (frames,) = field("stimuli", stimulus)
    answers = field("answers", f"{stimulus}/{key}", f"{stimulus}/{key}_k")
    result = dlgmd_cli.run(frames, model, fps=30, param=param)
    exact = np.ones(len(result.mp), bool)
    exact[ROUNDED.get((model, stimulus), [])] = False
    for values, answer in zip((result.mp, getattr(result, column)), answers, strict=True):
        np.testing.assert_allclose(values[exact], answer[exact], rtol=1e-5, atol=1e-12)
        np.testing.assert_allclose(values[~exact], answer[~exact], rtol=2e-3)
    np.testing.assert_array_equal(result.level, result.mp)
