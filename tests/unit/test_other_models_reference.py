"""The LGMD, the EMD-LGMD and the ON/OFF D-LGMD against nested loops in float64."""

import numpy as np
import pytest
from model_checks import check_dlgmd, check_emd, check_lgmd
from reference import clips, slow

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.lgmd import LGMD
from dlgmd_cli.parameters.presets import LgmdParameters

CLIPS = {
    "drifting 9x12": clips.drifting(9, 12, 8, seed=1),
    "looming 12x9": clips.looming(12, 9, 8, seed=2),
    "looming 11x14": clips.looming(11, 14, 9, seed=5),
    "smaller than a window": clips.drifting(2, 1, 6, seed=3),
    "one cell": clips.drifting(1, 1, 6, seed=4),
}


@pytest.mark.parametrize("clip", CLIPS)
@pytest.mark.parametrize(
    ("check", "changes"), [(check_lgmd, {}), (check_lgmd, {"t_ffi": 25.0}), (check_emd, {})]
)
def test_models_agree_with_their_equations(clip, check, changes):
    check(CLIPS[clip], **changes)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
def test_on_off_agrees_with_its_equations(formulation):
    k = 16.0 if formulation == "released-2020" else 1.0  # else a cell lies at the threshold
    params = slow.table_2(9, formulation=formulation, k=k)
    check_dlgmd(CLIPS["drifting 9x12"], params, on_off=True)


def test_the_clips_reach_every_branch_of_the_lgmd():
    answers = [
        one
        for frames in CLIPS.values()
        for one in check_lgmd(frames, t_ffi=25.0)
        if one.g_raw is not None
    ]
    assert any((one.g > 0).any() for one in answers)
    assert any(((one.g_raw > 0) & (one.g == 0)).any() for one in answers)
    assert any((one.s < 0).any() for one in answers)
    assert any(one.mp == 0.0 and one.g.any() for one in answers)  # switched off
    assert any(one.mp > 0.0 for one in answers)


def test_lgmd_is_switched_off_above_its_threshold_only():
    frames = [np.full((4, 4), value, np.float32) for value in (0.0, 0.5, 0.0, 0.5)]
    last = [
        [LGMD(LgmdParameters(t_ffi=t_ffi, w_i=0.0)).step, frames] for t_ffi in (127.0, 127.5, 128.0)
    ]
    potentials = [[step(frame).mp for frame in clip][-1] for step, clip in last]
    assert potentials[0] == 0.0 and potentials[1] == potentials[2] > 0.0


def test_reset_forgets_what_persists():
    model = LGMD(LgmdParameters(p1=0.4, p2=0.3))
    frames = CLIPS["drifting 9x12"]
    first = [model.step(frame).s_sum for frame in frames]
    model.reset()
    np.testing.assert_array_equal([model.step(frame).s_sum for frame in frames], first)


def test_a_cell_exactly_at_the_threshold_passes_the_lgmd():
    def last(**changes):
        params = LgmdParameters(w_i=0.0, c_de=1.0, **changes)
        steps = map(LGMD(params).step, (np.full((1, 1), v, np.float32) for v in (0.2, 0.3, 0.9)))
        return [response.mp for response in steps][-1]

    g = last(t_de=0.0)
    passed = [last(t_de=g * factor) for factor in (1 - 1e-6, 1 - 1e-12, 1, 1 + 1e-12, 1 + 1e-6)]
    assert g > 100.0 and passed == [g, g, g, 0.0, 0.0]


@pytest.mark.parametrize(("p1", "p2"), [(1.0, 0.0), (0.6, 0.5), (-0.6, 0.5), (0.0, -1.0)])
def test_persistence_that_never_dies_away_is_refused(p1, p2):
    with pytest.raises(ParameterError, match="grow for ever"):
        LgmdParameters(p1=p1, p2=p2)
