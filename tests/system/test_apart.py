"""Nothing crosses between the neuron, the expansion and the rule of the alarm."""

import numpy as np
import pytest

import dlgmd_cli
import dlgmd_cli.reduction
from dlgmd_cli.models.columns import columns_of
from dlgmd_cli.models.expansion import Measured
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.presets import MODELS
from dlgmd_cli.results.judging import judged

pytestmark = pytest.mark.slow
EXPANSION = [one.name for one in columns_of(Measured)]


@pytest.fixture(scope="module")
def approach():
    """A textured wall that comes near and drifts, 36 frames of 480 x 270, with a mains flicker."""
    rng = np.random.default_rng(5)
    wall = np.kron(rng.integers(30, 220, (60, 100)), np.ones((8, 8))).astype(np.uint8)
    frames = []
    for t in range(36):
        size = 1.0 / (1.0 - t / 50)
        rows, columns = (
            (np.arange(side) - side / 2) / size + middle
            for side, middle in ((270, 240 + t), (480, 400 - t))
        )
        light = 1.0 + 0.03 * np.sin(2.1 * t + np.arange(270) / 40.0)
        seen = wall[np.ix_(rows.astype(int), columns.astype(int))] * light[:, None]
        frames.append(np.clip(seen, 0, 255).astype(np.uint8))
    return np.array(frames)


@pytest.mark.parametrize("model", [3, 9, "flight", "dlgmd-onoff"])
def test_the_potential_is_the_same_under_either_rule(approach, model):
    by_spikes, by_ttc = (
        dlgmd_cli.run(approach, model, fps=30, param={"alarm": rule}) for rule in ("spikes", "ttc")
    )
    for name in ("mp", "s_sum", "p_sum", "ffi", "t_de", "g_x", "g_y", "spikes"):
        np.testing.assert_array_equal(getattr(by_spikes, name), getattr(by_ttc, name))
    assert {one.rule for one in by_ttc.alarm_list} == {"ttc"}
    # What Alarm says frame by frame, of the neuron alone, is the same, too.
    alone = dlgmd_cli.models.base.create_model(by_ttc.params)
    size_wh = by_ttc.record["processed"]["width"], by_ttc.record["processed"]["height"]
    reduced = [dlgmd_cli.reduction.resized(frame, size_wh) for frame in approach]
    np.testing.assert_array_equal([alone.step(frame).mp for frame in reduced], by_ttc.mp)


def test_the_expansion_is_the_same_beside_every_model_size_and_scale(approach):
    basis = dlgmd_cli.run(approach, fps=30)
    assert np.nanmin(basis.ttc_s) < 0.7 and basis.alarm_list
    others = [
        *(dlgmd_cli.run(approach, model, fps=30) for model in (1, 6, *MODELS, "flight-small")),
        *(
            dlgmd_cli.run(approach, 9, fps=30, **how)
            for how in ({"scale": 0.3}, {"size": (99, 60)})
        ),
        dlgmd_cli.run(approach, "lgmd", fps=30, param={"alarm": "ttc", "n_sp": 3}),
    ]
    for one in others:
        for name in EXPANSION:
            np.testing.assert_array_equal(getattr(one, name), getattr(basis, name))
        alarms = judged(one.rows, rule_of(basis.params))["alarm"]
        np.testing.assert_array_equal(alarms, basis.alarms)
    alarm = dlgmd_cli.Alarm(9)
    found = [alarm.step(frame, t / 30) for t, frame in enumerate(approach)]
    for name in EXPANSION:
        np.testing.assert_array_equal([getattr(one, name) for one in found], getattr(basis, name))
