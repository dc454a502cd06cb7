"""Every layer and sum of the D-LGMD against nested loops written from the equations."""

import math

import numpy as np
import pytest
from model_checks import answers_of, check_dlgmd, undecided
from reference import clips, slow

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters.presets import DlgmdParameters

LOOMING = clips.looming(8, 10, 6, seed=2)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", [1, 5, 9])
def test_sets_agree_with_the_equations(number, formulation):
    """Other clips and parameters are in the slow tier."""
    check_dlgmd(LOOMING, slow.table_2(number, formulation=formulation))


def test_the_released_threshold_is_capped():
    # Luminance far beyond 1 stands in for the hundreds of thousands of cells that it takes.
    frames = [frame * np.float32(2e5) for frame in clips.drifting(3, 4, 6, seed=5)]
    params = slow.table_2(1, formulation="released-2021", k=1e-10)
    answers = answers_of(slow.run, frames, **params)
    assert answers[-1].t_de == 0.3 and 0 < answers[-1].mp < answers[-1].g_raw.sum()
    model = DLGMD(DlgmdParameters(**params))
    responses = [model.step(frame) for frame in frames]
    assert not undecided(answers[-1])
    assert responses[-1].t_de == 0.3
    assert responses[-1].mp == pytest.approx(answers[-1].mp, rel=1e-5)


@pytest.mark.parametrize("formulation", ["default", "equations"])
def test_a_cell_exactly_at_the_threshold_passes(formulation):
    # One cell without inhibition: G follows from P(t) alone, T_de from P(t-1), here 1/2, so that
    # T_de = t0/2 to the last bit.
    def last_mp(luminance, **changes):
        model = DLGMD(DlgmdParameters(**slow.table_2(1, a=0.0, m=1.0, k=0.5) | changes))
        return [model.step(np.full((1, 1), value, np.float32)).mp for value in luminance][-1]

    g = last_mp((0.0, 0.5, 0.5, 1.0), formulation=formulation)  # P(t-1) is 0, and so is T_de
    assert 0.0 < g < 0.3
    passed = [
        last_mp((0.0, 0.0, 0.5, 1.0), t0=2.0 * t_de, formulation=formulation)
        for t_de in (g * (1 - 1e-6), g * (1 - 1e-12), g, g * (1 + 1e-12), g * (1 + 1e-6))
    ]
    assert passed == [g, g, g, 0.0, 0.0]


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize(
    "changes",
    [
        # The Gaussian's far taps are denormal, so that ratios to them overflow.
        {"sigma_e": 0.0259157844227662},
        {"sigma_e": 0.1322, "r": 5},
        {"sigma_e": 0.01, "k": 100.0},
        {"sigma_i": 0.01, "a": 100.0},
        {"m": 0.001, "t0": 5e-324},
        {"k": 1e-12},
    ],
    ids=str,
)
def test_limits_of_the_ranges_are_answered(changes, formulation):
    model = DLGMD(DlgmdParameters(**slow.table_2(9, formulation=formulation) | changes))
    responses = [model.step(frame) for frame in clips.drifting(6, 7, 5, seed=6)]
    assert math.isfinite(responses[-1].s_sum) and math.isfinite(responses[-1].mp)
    assert responses[-1].t_de >= 0.0
