"""Every layer and sum of the D-LGMD against nested loops written from the equations."""

import math

import numpy as np
import pytest
from model_checks import answers_of, check_dlgmd, undecided
from reference import clips, slow

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters.presets import DlgmdParameters

SETS = sorted(slow.TABLE_2)
CLIPS = {
    "drifting 7x9": clips.drifting(7, 9, 6, seed=1),
    "looming 8x10": clips.looming(8, 10, 6, seed=2),
}
SMALL = [(1, 1), (1, 7), (4, 1), (2, 2), (3, 5)]
UNUSUAL = {
    "smallest radius": {"r": 1},
    "no inhibition": {"a": 0.0},
    "strong inhibition": {"a": 4.0, "sigma_i": 0.8},
    "wide": {"sigma_e": 30.0, "sigma_i": 60.0, "r": 3, "a": 0.2},
    "narrow": {"sigma_e": 0.1, "sigma_i": 0.2, "r": 3},
    "late": {"alpha": 3.0},
    "late, no inhibition": {"alpha": 3.0, "a": 0.0},
    "at once": {"alpha": -0.3, "beta": 0.9, "lam": 0.05},
    "whole frames": {"alpha": 1.0, "beta": 1.0, "lam": 0.0},
    "steep": {"lam": 3.0, "beta": 0.3},
    "no threshold": {"ffi_gd": False},
    "high threshold": {"t0": 20.0},
    "other gain and scale": {"k": 3.5, "m": 0.05},
    "small gain": {"k": 0.01},
    "beyond 11 taps": {"r": 7, "lam": 0.2, "sigma_e": 0.6, "a": 0.3},
}


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", SETS)
@pytest.mark.parametrize("clip", CLIPS)
def test_sets_agree_with_the_equations(clip, number, formulation):
    check_dlgmd(CLIPS[clip], slow.table_2(number, formulation=formulation))


@pytest.mark.parametrize(("latency", "saturate"), slow.COMBINATIONS)
@pytest.mark.parametrize("number", [5, 9])
@pytest.mark.parametrize("formulation", ["default", "released-2020"])
def test_latency_and_saturation_of_ones_own(formulation, number, latency, saturate):
    own = {"latency": latency, "saturate": saturate}
    check_dlgmd(CLIPS["looming 8x10"], slow.table_2(number, formulation=formulation, **own))


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", [1, 7, 9])
@pytest.mark.parametrize(("height", "width"), SMALL)
def test_frames_smaller_than_the_kernel(height, width, number, formulation):
    check_dlgmd(
        clips.drifting(height, width, 6, seed=3), slow.table_2(number, formulation=formulation)
    )


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("unusual", UNUSUAL)
def test_unusual_parameters(unusual, formulation):
    params = slow.table_2(5, formulation=formulation) | UNUSUAL[unusual]
    check_dlgmd(clips.drifting(7, 8, 8, seed=4), params)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
def test_without_a_threshold_g_still_saturates(formulation):
    params = slow.table_2(2, formulation=formulation, ffi_gd=False, k=40.0)
    answers = answers_of(slow.run, CLIPS["looming 8x10"], **params)
    assert any(one.g is not None and one.g_raw.max() > 1.0 for one in answers)
    check_dlgmd(CLIPS["looming 8x10"], params)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
def test_the_clips_reach_every_branch(formulation):
    # Agreement means little where nothing is thresholded, capped or saturated.
    below = above = saturated = capped = uncapped = rectified = False
    k = 16.0 if formulation == "released-2020" else 1.0
    for frames in CLIPS.values():
        for number in SETS:
            for answer in answers_of(
                slow.run, frames, **slow.table_2(number, formulation=formulation, k=k)
            ):
                if answer.g is None:
                    continue
                raw, t_de = answer.g_raw, answer.t_de
                below |= bool(((raw > 0) & (raw < t_de)).any())
                above |= bool(((raw >= t_de) & (raw < 1)).any())
                saturated |= bool((raw > 1).any())
                rectified |= bool((answer.s == 0).any() and (answer.s > 0).any())
                capped |= answer.t_de >= 0.3
                uncapped |= 0 < answer.t_de < 0.3
    assert below and above and saturated and rectified and uncapped
    # On frames this small the released divisor keeps T_de far from its cap.
    assert capped or formulation.startswith("released")


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
