"""The ON/OFF D-LGMD against nested loops in float64."""

import numpy as np
import pytest
from model_checks import check_dlgmd
from reference import clips, slow

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.on_off import OnOffDLGMD
from dlgmd_cli.parameters.presets import DlgmdParameters, OnOffParameters

CLIPS = {
    "drifting 9x12": clips.drifting(9, 12, 8, seed=1),
    "looming 10x13": clips.looming(10, 13, 8, seed=2),
    "faint": [np.float32(0.5) + frame / 32 for frame in clips.drifting(8, 9, 8, seed=5)],
    "smaller than the kernel": clips.drifting(4, 1, 6, seed=3),
    "one cell": clips.drifting(1, 1, 6, seed=4),
}


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", [3, 9])
@pytest.mark.parametrize("clip", CLIPS)
def test_on_off_agrees_with_its_equations(clip, number, formulation):
    k = 16.0 if formulation == "released-2020" else 1.0  # else a cell lies at the threshold
    check_dlgmd(CLIPS[clip], slow.table_2(number, formulation=formulation, k=k), on_off=True)


def test_on_and_off_do_not_inhibit_each_other():
    frames, both = CLIPS["drifting 9x12"], slow.table_2(3)
    models = OnOffDLGMD(OnOffParameters(**both)), DLGMD(DlgmdParameters(**both))
    brightening = np.maximum.accumulate(frames)
    for t, frame in enumerate(brightening):  # with one pathway at work, it is the D-LGMD
        apart, together = (model.step(frame) for model in models)
        if t >= 2:
            assert apart.s_sum == pytest.approx(together.s_sum, rel=1e-5)
            assert apart.mp == pytest.approx(together.mp, rel=1e-5)
    for model in models:
        model.reset()
    answers = [[model.step(frame, layers=True) for model in models] for frame in frames]
    assert all((a.layers.s >= b.layers.s - 1e-6).all() for a, b in answers[2:])
    assert sum(a.s_sum for a, _ in answers[2:]) > 1.2 * sum(b.s_sum for _, b in answers[2:])
