"""Every layer and sum of every model against nested loops in float64, see `reference`."""

import math
from functools import lru_cache

import numpy as np
import pytest
from reference import slow, slow_emd, slow_lgmd

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.emd_lgmd import EmdLGMD
from dlgmd_cli.models.lgmd import LGMD
from dlgmd_cli.models.on_off import OnOffDLGMD
from dlgmd_cli.parameters.presets import (
    DlgmdParameters,
    EmdLgmdParameters,
    LgmdParameters,
    OnOffParameters,
)

SUMS = ("p_sum", "s_sum", "mp", "ffi", "t_de")
# One rounding to float32, relative; and of sums of a dozen products.
ROUNDING, SUM_ROUNDING = 2.0**-24, 2e-6


@lru_cache(maxsize=1000)
def _computed(run, shape, frames, params):
    """As `answers_of`, of what can be looked up."""
    return run([np.frombuffer(one, np.float32).reshape(shape) for one in frames], **dict(params))


def answers_of(run, frames, **params):
    """What nested loops answer, once for all tests."""
    frames = [np.asarray(frame, np.float32) for frame in frames]
    return _computed(
        run, frames[0].shape, tuple(map(np.ndarray.tobytes, frames)), tuple(params.items())
    )


def insist(decided):
    """What demands that no cell of a fixed clip may fall on either side of its threshold."""
    assert decided, "choose another seed"


def undecided(answer):
    """Whether some G lies so near T_de that rounding S may put it on either side."""
    near = np.abs(answer.g_raw - answer.t_de) <= 4e-6 * max(answer.t_de, 1e-3)
    return bool(answer.t_de > 0.0 and near.any())


def rounding_of(params):
    """How delays are rounded, by name or by the formulation."""
    return params.get("latency") or slow.NAMED[params.get("formulation", "default")][0]


def strength(params):
    """Σ|K| over all delays: how far S moves, at most, when P moves by one."""
    keys = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r", "a")
    connections = {key: params[key] for key in keys}
    excite, inhibit = slow.kernels(**connections, rounding=rounding_of(params))
    return sum(sum(weights.values()) for weights in (excite, *inhibit.values()))


def check_layers(layers, answer, k, s_error):
    """Each layer within what float32 explains.

    P is one subtraction, rounded once. S adds up products no larger than the peak of P times the
    kernels' strength; rounding grows with that sum, not with S, which is what cancellation
    leaves. Taking differences of frames, factors of kernels or a Fourier transform adds a few
    roundings of the same size; 8 of them cover all (the worst seen is 4, by Fourier transform).
    G is quadratic in S, so that an error of S counts with S around it; rounding of the 4x4 sum
    and of the product is relative.
    """
    np.testing.assert_allclose(layers.p, answer.p, rtol=0, atol=ROUNDING)
    if answer.s is None:
        assert layers.s is None and layers.g is None
        return
    np.testing.assert_allclose(layers.s, answer.s, rtol=0, atol=s_error)
    around = k * 17 * (answer.s.max() + s_error)
    np.testing.assert_allclose(layers.g, answer.g, rtol=8 * ROUNDING, atol=s_error * around + 1e-30)


def check_dlgmd(frames, params, demand=insist, on_off=False):
    """The D-LGMD; `demand` is told whether every G is clearly on one side of the threshold."""
    answers = answers_of(slow.run, frames, **params, on_off=on_off)
    demand(not any(one.g is not None and undecided(one) for one in answers))
    model = OnOffDLGMD(OnOffParameters(**params)) if on_off else DLGMD(DlgmdParameters(**params))
    peak = max(float(np.max(one.p)) for one in answers if one.p is not None)
    s_error = 8 * ROUNDING * strength(params) * peak
    for t, (frame, answer) in enumerate(zip(frames, answers, strict=True)):
        response = model.step(frame, layers=True)
        if answer.p is None:
            assert response.layers.p is None
        else:
            check_layers(response.layers, answer, params["k"], s_error)
        for column in SUMS:
            expected, actual = getattr(answer, column), getattr(response, column)
            if expected is None:
                assert math.isnan(actual), f"t = {t}, {column}"
            else:
                error = abs(actual - expected)
                assert error <= 1e-5 * max(abs(expected), 1.0), f"t = {t}, {column}"


def compare(model, answers, frames, layers, columns, peak):
    """Every layer and every sum of every frame."""
    for t, (frame, answer) in enumerate(zip(frames, answers, strict=True)):
        response = model.step(frame, layers=True)
        for name, expected in layers(answer).items():
            actual = getattr(response.layers, name)
            assert (actual is None) == (expected is None), f"t = {t}, {name}"
            if expected is not None:
                scale = max(peak[name], 1e-30)
                np.testing.assert_allclose(actual, expected, rtol=0, atol=SUM_ROUNDING * scale)
        for name in columns:
            expected, actual = getattr(answer, name), getattr(response, name)
            if expected is None:
                assert math.isnan(actual), f"t = {t}, {name}"
            else:
                assert actual == pytest.approx(expected, rel=1e-5, abs=1e-7), f"t = {t}, {name}"


def _undecided_lgmd(answer, params):
    """Whether rounding may put a G, or FFI, on either side of its threshold."""
    near = np.abs(answer.g_raw * params["c_de"] - params["t_de"]) < 1e-4 * params["t_de"]
    return bool(near.any()) or abs(answer.ffi - params["t_ffi"]) < 1e-4


def _silenced(layer):
    """What a switched-off cell groups: nothing."""
    return None if layer is None else np.zeros_like(layer)


def check_lgmd(frames, demand=insist, **changes):
    params = slow_lgmd.DEFAULTS | changes
    answers = answers_of(slow_lgmd.run, frames, **params)
    demand(not any(one.g_raw is not None and _undecided_lgmd(one, params) for one in answers))
    g_peak = max(np.abs(one.g_raw).max() for one in answers if one.g_raw is not None)
    p_peak = max(np.abs(one.p).max() for one in answers if one.p is not None)
    compare(
        LGMD(LgmdParameters(**params)),
        answers,
        frames,
        lambda one: {"p": one.p, "s": one.s, "g": one.g if one.mp != 0.0 else _silenced(one.g)},
        ("p_sum", "s_sum", "mp", "ffi"),
        {"p": p_peak, "s": p_peak * (1 + params["w_i"]), "g": 4 * g_peak},
    )
    return answers


def check_emd(frames, demand=insist, **changes):
    params = slow_emd.DEFAULTS | changes
    answers = answers_of(slow_emd.run, frames, **params)
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
