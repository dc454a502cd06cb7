"""The LGMD and the EMD-LGMD against nested loops in float64."""

import math

import numpy as np
import pytest
from dlgmd_cli.models.readout import normalise_sigmoid
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from reference import clips, slow_emd, slow_lgmd

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.emd_lgmd import EmdLGMD
from dlgmd_cli.models.lgmd import LGMD
from dlgmd_cli.parameters import EmdLgmdParameters, LgmdParameters

CLIPS = {
    "drifting 9x12": clips.drifting(9, 12, 8, seed=1),
    "looming 12x9": clips.looming(12, 9, 8, seed=2),
    "looming 11x14": clips.looming(11, 14, 9, seed=5),
    "smaller than a window": clips.drifting(2, 1, 6, seed=3),
    "one cell": clips.drifting(1, 1, 6, seed=4),
}
# float32 rounding of sums of a dozen products, relative to the largest of them.
ROUNDING = 2e-6


def compare(model, answers, frames, layers, columns, peak):
    """Every layer and every sum of every frame."""
    for t, (frame, answer) in enumerate(zip(frames, answers, strict=True)):
        response = model.step(frame, layers=True)
        for name, expected in layers(answer).items():
            actual = getattr(response.layers, name)
            assert (actual is None) == (expected is None), f"t = {t}, {name}"
            if expected is not None:
                scale = max(peak[name], 1e-30)
                np.testing.assert_allclose(actual, expected, rtol=0, atol=ROUNDING * scale)
        for name in columns:
            expected, actual = getattr(answer, name), getattr(response, name)
            if expected is None:
                assert math.isnan(actual), f"t = {t}, {name}"
            else:
                assert actual == pytest.approx(expected, rel=1e-5, abs=1e-7), f"t = {t}, {name}"


def undecided(answer, params):
    """Whether rounding may put a G, or FFI, on either side of its threshold."""
    near = np.abs(answer.g_raw * params["c_de"] - params["t_de"]) < 1e-4 * params["t_de"]
    return bool(near.any()) or abs(answer.ffi - params["t_ffi"]) < 1e-4


def silenced(layer):
    """What a switched-off cell groups: nothing."""
    return None if layer is None else np.zeros_like(layer)


def insist(decided):
    assert decided, "choose another seed"


def check_lgmd(frames, demand=insist, **changes):
    params = slow_lgmd.DEFAULTS | changes
    answers = slow_lgmd.run(frames, **params)
    demand(not any(one.g_raw is not None and undecided(one, params) for one in answers))
    g_peak = max(np.abs(one.g_raw).max() for one in answers if one.g_raw is not None)
    p_peak = max(np.abs(one.p).max() for one in answers if one.p is not None)
    compare(
        LGMD(LgmdParameters(**params)),
        answers,
        frames,
        lambda one: {"p": one.p, "s": one.s, "g": one.g if one.mp != 0.0 else silenced(one.g)},
        ("p_sum", "s_sum", "mp", "ffi"),
        {"p": p_peak, "s": p_peak * (1 + params["w_i"]), "g": 4 * g_peak},
    )
    return answers


def check_emd(frames, demand=insist, **changes):
    params = slow_emd.DEFAULTS | changes
    answers = slow_emd.run(frames, **params)
    near = [
        np.abs(np.abs(one.f) - params["f_active"]).min() < 1e-6
        for one in answers
        if one.f is not None
    ]
    demand(not any(near))
    compare(
        EmdLGMD(EmdLgmdParameters(**params)),
        answers,
        frames,
        lambda one: {"p": one.f, "s": one.m},
        ("p_sum", "s_sum", "mp", "ffi"),
        {"p": 1.0, "s": 1.0},
    )
    return answers


@pytest.mark.parametrize("clip", CLIPS)
def test_lgmd_agrees_with_its_equations(clip):
    check_lgmd(CLIPS[clip])


@pytest.mark.parametrize(
    "changes",
    [
        {"p1": 0.4, "p2": -0.3},
        {"p2": 0.5},
        {"w_i": 0.0},
        {"w_i": 2.5, "t_ffi": 255.0},
        {"delta_c": 9.0, "c_omega": 0.5},
        {"c_de": 1.0, "t_de": 1.0},
        {"t_de": 0.0},
        {"t_ffi": 4.0},
    ],
    ids=str,
)
def test_lgmd_with_other_parameters(changes):
    check_lgmd(CLIPS["drifting 9x12"], **changes)
    check_lgmd(CLIPS["looming 11x14"], **changes)


def test_the_clips_reach_every_branch_of_the_lgmd():
    answers = [
        one for frames in CLIPS.values() for one in check_lgmd(frames) if one.g_raw is not None
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
        params = LgmdParameters(w_i=0.0, c_de=1.0, t_ffi=255.0, **changes)
        steps = map(LGMD(params).step, (np.full((1, 1), v, np.float32) for v in (0.2, 0.3, 0.9)))
        return [response.mp for response in steps][-1]

    g = last(t_de=0.0)
    passed = [last(t_de=g * factor) for factor in (1 - 1e-6, 1 - 1e-12, 1, 1 + 1e-12, 1 + 1e-6)]
    assert g > 100.0 and passed == [g, g, g, 0.0, 0.0]


@pytest.mark.parametrize("clip", CLIPS)
def test_emd_agrees_with_its_equations(clip):
    check_emd(CLIPS[clip])


@pytest.mark.parametrize(
    "changes",
    [
        {"tau_high": 0.3},
        {"tau_low": 50.0},
        {"delta": 0.0},
        {"delta": 1.0},
        {"delta": 0.3, "c": 0.0},
        {"f_active": 0.2, "c": 9.0},
    ],
    ids=str,
)
def test_emd_with_other_parameters(changes):
    check_emd(CLIPS["drifting 9x12"], **changes)
    check_emd(CLIPS["looming 11x14"], **changes)


def test_emd_tells_expansion_from_contraction():
    frames = clips.looming(24, 32, 12, seed=6)
    outward, inward = (
        sum(response.mp for response in map(EmdLGMD().step, order) if response.is_valid)
        for order in (frames, frames[::-1])
    )
    assert outward > 2.0 * inward


@settings(deadline=None, max_examples=40)
@given(
    p1=st.floats(-0.4, 0.4),
    p2=st.floats(-0.4, 0.4),
    w_i=st.floats(0.0, 3.0),
    delta_c=st.floats(0.001, 20.0),
    c_omega=st.floats(0.1, 20.0),
    c_de=st.floats(0.01, 2.0),
    t_de=st.floats(0.0, 30.0),
    t_ffi=st.floats(0.0, 60.0),
    seed=st.integers(0, 1000),
)
def test_any_parameters_of_the_lgmd(seed, **params):
    check_lgmd(clips.drifting(4, 5, 7, seed), assume, **params)


@settings(deadline=None, max_examples=40)
@given(
    tau_high=st.floats(0.01, 100.0),
    tau_low=st.floats(0.01, 100.0),
    delta=st.floats(0.0, 1.0),
    f_active=st.floats(0.0, 0.5),
    c=st.floats(0.0, 10.0),
    seed=st.integers(0, 1000),
)
def test_any_parameters_of_the_emd(seed, **params):
    check_emd(clips.drifting(5, 4, 7, seed), assume, **params)


def test_own_normalisation_of_the_lgmd():
    mp = np.array([math.nan, 0.0, 12.0, 1e9])
    expected = [math.nan, 0.5, 1 / (1 + math.exp(-2.0)), 1.0]
    np.testing.assert_allclose(normalise_sigmoid(mp, 6), expected)


@pytest.mark.parametrize(("p1", "p2"), [(1.0, 0.0), (0.6, 0.5), (-0.6, 0.5), (0.0, -1.0)])
def test_persistence_that_never_dies_away_is_refused(p1, p2):
    with pytest.raises(ParameterError, match="grow for ever"):
        LgmdParameters(p1=p1, p2=p2)


@pytest.mark.parametrize("kind", [LGMD, EmdLGMD])
def test_there_is_no_other_engine(kind):
    assert kind(engine="opencv").engine_name == kind().engine_name == "opencv"
    with pytest.raises(ParameterError, match="has no engine 'numba'"):
        kind(engine="numba")
