"""The models at more sizes and parameters than the fast tests have time for."""

import gc
import math
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from model_checks import check_dlgmd, check_emd, check_lgmd
from plan_checks import check_both, check_fused, check_plan
from reference import clips, slow

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_model_contract import CASES, create, moving, steps

import dlgmd_cli
from dlgmd_cli import looming_fit, peak_before_contact
from dlgmd_cli.models.kernels import gaussian
from dlgmd_cli.parameters.presets import LATENCIES, DlgmdParameters

pytestmark = pytest.mark.slow

thoroughly = settings(deadline=None, max_examples=60)


@st.composite
def connections(draw, *, sigmas, max_r, max_a, longest=math.inf):
    """What kernels follow from, by key, as far as the latency in frames allows."""
    values = {
        "alpha": draw(st.floats(-0.5, 5.0)),
        "beta": draw(st.floats(0.0, 3.0)),
        "lam": draw(st.floats(0.0, 2.0)),
        "sigma_e": draw(st.floats(*sigmas)),
        "sigma_i": draw(st.floats(*sigmas)),
        "r": draw(st.integers(1, max_r)),
        "a": draw(st.floats(0.0, max_a)),
        "latency": draw(st.sampled_from(LATENCIES)),
    }
    r, alpha, beta, lam = (values[key] for key in ("r", "alpha", "beta", "lam"))
    assume(slow.latency(0, 0, alpha, beta, lam) >= 0.0)
    assume(beta + math.exp(-lam * lam * 2 * r * r) > 0.02)
    assume(slow.latency(r, r, alpha, beta, lam) <= longest)
    return values


# Memory


@pytest.mark.parametrize("case", CASES)
def test_memory_does_not_grow(case):
    model, frames = create(case), moving()
    grown = []
    tracemalloc.start()
    try:
        steps(model, frames * 5)
        for _ in range(2):
            gc.collect()
            before, _ = tracemalloc.get_traced_memory()
            for frame in frames * 30:
                model.step(frame)
            gc.collect()
            grown.append(tracemalloc.get_traced_memory()[0] - before)
    finally:
        tracemalloc.stop()
    # A single number kept for each of the 270 frames would take 8,600 bytes every time. What other
    # threads or Python's own lists of free objects take, they take once.
    assert min(grown) < 4_096


# Plans


@thoroughly
@given(connections(sigmas=(0.02, 100.0), max_r=8, max_a=10.0))
def test_plans_of_any_parameters_add_up(values):
    check_both(DlgmdParameters(**values))


@st.composite
def symmetric(draw, radius):
    """A kernel that is the same in all eight directions, and otherwise anything."""
    n_taps = (radius + 1) ** 2
    corner = draw(st.lists(st.floats(-1.0, 1.0, width=32), min_size=n_taps, max_size=n_taps))
    quarter = np.array(corner).reshape(radius + 1, radius + 1)
    quarter = quarter + quarter.T
    half = np.hstack([quarter[:, :0:-1], quarter])
    return np.vstack([half[:0:-1], half])


@thoroughly
@given(st.data(), st.integers(1, 6), st.sets(st.integers(1, 4)))
def test_plans_of_any_symmetric_kernels_add_up(data, radius, delays):
    kernels = {delay: data.draw(symmetric(radius)) for delay in {0} | delays}
    for check in (check_plan, check_fused):
        check(kernels, [gaussian(radius, 1.0), gaussian(radius, 3.0)])


# Equations


@st.composite
def parameters(draw):
    """Parameters from all over their ranges, small enough for nested loops."""
    return draw(connections(sigmas=(0.05, 10.0), max_r=3, max_a=4.0, longest=6.0)) | {
        "k": draw(st.floats(0.1, 4.0)),
        "t0": draw(st.floats(0.0, 4.0)),
        "m": draw(st.floats(0.1, 4.0)),
        "ffi_gd": draw(st.booleans()),
        "formulation": draw(st.sampled_from(slow.FORMULATIONS)),
        "saturate": draw(st.booleans()),
    }


@pytest.mark.parametrize("on_off", [False, True])
@thoroughly
@given(params=parameters(), seed=st.integers(0, 1000))
def test_any_parameters_agree_with_the_equations(on_off, params, seed):
    # A cell on the edge of the threshold is not wrong on either side; such draws say nothing.
    check_dlgmd(clips.drifting(4, 5, 10, seed), params, assume, on_off=on_off)


# Of models whose parameters are plain numbers: the check, the size of its clip, and ranges.
LGMD = {"p1": (-0.4, 0.4), "p2": (-0.4, 0.4), "w_i": (0.0, 3.0), "delta_c": (0.001, 20.0)}
LGMD |= {"c_omega": (0.1, 20.0), "c_de": (0.01, 2.0), "t_de": (0.0, 30.0), "t_ffi": (0.0, 60.0)}
EMD = {"tau_high": (0.01, 100.0), "tau_low": (0.01, 100.0)}
EMD |= {"delta": (0.0, 1.0), "f_active": (0.0, 0.5), "c": (0.0, 10.0)}


@pytest.mark.parametrize(
    ("check", "shape", "ranges"), [(check_lgmd, (4, 5), LGMD), (check_emd, (5, 4), EMD)]
)
@thoroughly
@given(data=st.data(), seed=st.integers(0, 1000))
def test_any_parameters_of_the_others(check, shape, ranges, data, seed):
    params = {key: data.draw(st.floats(*ends), label=key) for key, ends in ranges.items()}
    check(clips.drifting(*shape, 7, seed), assume, **params)


def test_our_stimuli_have_peaks_that_grow_with_l_over_v():
    """The image is full at the field of view, where the response ends: that is the angle."""
    l_over_v_s, peaks_s = [0.02, 0.04, 0.06], []
    scene = {"object_size": 0.5, "contrast": -1, "background": 1, "size": "240x240", "fps": 100}
    for each in l_over_v_s:
        clip = dlgmd_cli.synth("looming-cube", speed=0.25 / each, distance=4.77, fov=60, **scene)
        result = dlgmd_cli.run(clip.frames, 9, fps=clip.fps, repeats="keep")
        peaks_s.append(peak_before_contact(result, clip.truth["time_to_contact_s"][0]))
    fit = looming_fit(l_over_v_s, peaks_s)
    assert fit.r_squared > 0.95 and abs(fit.angle_deg - 60) < 12
