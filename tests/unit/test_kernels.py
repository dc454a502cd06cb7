"""Gaussians, latency, bands and the kernel of each delay."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import slow

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.kernels import connect, gaussian, latency_map
from dlgmd_cli.parameters import DlgmdParameters

SETS = sorted(slow.TABLE_2)
RADIAL_SETS = [4, 5, 6, 7, 8, 9]
# Small enough that beta + exp(-lam² r²) stays far from zero.
SHAPES = {
    "radius_px": st.integers(0, 8),
    "alpha": st.floats(-1.0, 5.0),
    "beta": st.floats(0.0, 3.0),
    "lam": st.floats(0.0, 0.3),
}


def connections(number, **changes):
    return connect(DlgmdParameters(**slow.table_2(number, **changes)))


def as_array(weights, r):
    """The reference's (dx, dy) -> weight as the package lays kernels out."""
    kernel = np.zeros((2 * r + 1, 2 * r + 1))
    for (x, y), weight in weights.items():
        kernel[y + r, x + r] = weight
    return kernel


@pytest.mark.parametrize("sigma", [0.35, 1.0, 5.0])
def test_gaussian_has_the_amplitude_of_one_dimension(sigma):
    kernel = gaussian(4, sigma)
    assert kernel.shape == (9, 9)
    assert kernel.dtype == np.float64
    assert kernel[4, 4] == pytest.approx(1 / (sigma * math.sqrt(2 * math.pi)), rel=1e-15)
    ratio = math.exp(-(2**2 + 3**2) / (2 * sigma**2))
    assert kernel[2, 7] == pytest.approx(kernel[4, 4] * ratio, rel=1e-12)


def test_gaussian_is_not_normalised():
    # In two dimensions its mass is σ√(2π), far from one for a wide one.
    assert gaussian(30, 5.0).sum() == pytest.approx(5.0 * math.sqrt(2 * math.pi), rel=1e-6)


@settings(deadline=None)
@given(radius_px=st.integers(0, 8), sigma=st.floats(0.05, 50.0))
def test_gaussian_is_the_same_in_all_eight_directions(radius_px, sigma):
    kernel = gaussian(radius_px, sigma)
    for turned in (kernel[::-1], kernel[:, ::-1], kernel.T):
        np.testing.assert_array_equal(kernel, turned)


@pytest.mark.parametrize("number", RADIAL_SETS)
def test_latency_of_the_radial_sets(number):
    latency = connections(number).latency
    r = latency.shape[0] // 2
    assert latency[r, r] == pytest.approx(-0.1 + 1 / 1.5, rel=1e-15)
    assert round(latency[r, r], 2) == 0.57
    assert 1.899 < latency[0, 0] < 1.9


@pytest.mark.parametrize("number", [1, 2, 3])
def test_latency_without_shape_is_one_frame_everywhere(number):
    assert (connections(number).latency == 1.0).all()


@settings(deadline=None)
@given(**SHAPES)
def test_latency_never_falls_with_radius(radius_px, alpha, beta, lam):
    latency = latency_map(radius_px, alpha, beta, lam)
    axis = np.arange(-radius_px, radius_px + 1)
    squared = np.add.outer(axis**2, axis**2)
    order = np.argsort(squared, axis=None, kind="stable")
    steps = np.diff(latency.ravel()[order])
    assert (steps >= -1e-13 * np.abs(latency).max()).all()
    assert latency.min() == latency[radius_px, radius_px]


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", SETS)
def test_kernels_of_the_sets(number, formulation):
    params = slow.table_2(number, formulation=formulation)
    names = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r", "a", "formulation")
    excite, inhibit = slow.kernels(**{name: params[name] for name in names})
    actual = connections(number, formulation=formulation)
    np.testing.assert_allclose(actual.excitation, as_array(excite, params["r"]), atol=1e-15)
    assert sorted(actual.inhibition) == sorted(inhibit)
    for delay, kernel in actual.inhibition.items():
        np.testing.assert_allclose(kernel, as_array(inhibit[delay], params["r"]), atol=1e-15)


@pytest.mark.parametrize("number", [1, 2, 3])
def test_formulations_agree_without_radial_latency(number):
    default, *others = (connections(number, formulation=name) for name in slow.FORMULATIONS)
    assert list(default.inhibition) == [1]
    for other in others:
        np.testing.assert_array_equal(other.excitation, default.excitation)
        assert list(other.inhibition) == [1]
        np.testing.assert_array_equal(other.inhibition[1], default.inhibition[1])


def test_bands_of_set_9():
    found = connections(9)
    delays = np.zeros((13, 13), int)
    for delay, kernel in found.inhibition.items():
        delays[kernel > 0] = delay
    # By hand from Eq. (5): τ reaches 1 at 1.35 px from the centre, and 1.8999 at 4.65 px.
    axis = np.arange(-6, 7)
    squared = np.add.outer(axis**2, axis**2)
    expected = np.select([squared < 1.35**2, squared < 4.65**2], [0, 1], 2)
    np.testing.assert_array_equal(delays, expected)
    assert found.max_delay_frames == 2


def flat(latency_frames, **changes):
    """Connections whose latency is the same at every tap."""
    arguments = {
        "radius_px": 2,
        "sigma_e_px": 1.0,
        "sigma_i_px": 2.0,
        "strength": 1.5,
        "alpha": latency_frames - 1.0,
        "beta": 0.0,
        "lam": 0.0,
        "interpolate": False,
    }
    return connect(**arguments | changes)


@pytest.mark.parametrize(
    ("latency_frames", "delay"),
    [
        (0.0, None),
        (np.nextafter(1.0, 0.0), None),
        (1.0, 1),
        (1.5, 1),
        (np.nextafter(1.8999, 0.0), 1),
        (1.8999, 2),
        (2.5, 2),
        (7.0, 2),
    ],
)
def test_band_edges(latency_frames, delay):
    found = flat(latency_frames)
    assert (found.latency == latency_frames).all()
    assert list(found.inhibition) == ([] if delay is None else [delay])
    for kernel in found.inhibition.values():
        np.testing.assert_array_equal(kernel, 1.5 * gaussian(2, 2.0))


def test_excitation_is_gated_by_latency():
    excite, inhibit = gaussian(2, 1.0), 1.5 * gaussian(2, 2.0)
    np.testing.assert_array_equal(flat(0.5).excitation, np.maximum(excite - inhibit, 0.0))
    np.testing.assert_array_equal(flat(1.0).excitation, excite)
    assert not flat(1.0001).excitation.any()
    assert (flat(0.5).excitation == 0.0).any() and (flat(0.5).excitation > 0.0).any()


def test_excitation_of_the_equations_is_everywhere():
    for latency_frames in (0.0, 0.5, 1.0, 3.7):
        found = flat(latency_frames, interpolate=True)
        np.testing.assert_array_equal(found.excitation, gaussian(2, 1.0))


def test_interpolation_splits_between_two_frames():
    found = flat(2.25, interpolate=True)
    assert sorted(found.inhibition) == [2, 3]
    whole = 1.5 * gaussian(2, 2.0)
    np.testing.assert_allclose(found.inhibition[2], 0.75 * whole, rtol=1e-15)
    np.testing.assert_allclose(found.inhibition[3], 0.25 * whole, rtol=1e-15)
    assert found.max_delay_frames == 3


@settings(deadline=None)
@given(**SHAPES, strength=st.floats(0.1, 10.0))
def test_interpolation_loses_no_inhibition(radius_px, alpha, beta, lam, strength):
    centre = alpha + 1.0 / (beta + 1.0)
    shift = max(-centre, 0.0)  # a latency below zero has no frame to come from
    found = connect(
        radius_px=radius_px,
        sigma_e_px=1.0,
        sigma_i_px=2.0,
        strength=strength,
        alpha=alpha + shift + 1e-12,
        beta=beta,
        lam=lam,
        interpolate=True,
    )
    whole = sum(found.inhibition.values())
    np.testing.assert_allclose(whole, strength * gaussian(radius_px, 2.0), rtol=1e-9)
    assert all((kernel >= 0.0).all() and kernel.any() for kernel in found.inhibition.values())


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
def test_signed_kernels_are_what_reaches_a_cell(formulation):
    found = connections(6, formulation=formulation)
    signed = found.signed()
    at_once = found.inhibition.get(0, 0.0)
    np.testing.assert_array_equal(signed.pop(0), found.excitation - at_once)
    assert sorted(signed) == [1, 2]
    for delay, kernel in signed.items():
        np.testing.assert_array_equal(kernel, -found.inhibition[delay])


@pytest.mark.parametrize("sigma", [0.0, -1.0, math.nan])
def test_gaussian_refuses_a_width_that_is_none(sigma):
    with pytest.raises(ParameterError, match=rf"^sigma = {sigma:g} px is not above 0\.$"):
        gaussian(4, sigma)


def test_negative_radius_is_refused():
    for make in (lambda: gaussian(-1, 1.0), lambda: latency_map(-1, 0.0, 0.5, 0.7)):
        with pytest.raises(ParameterError, match=r"^radius -1 px is negative\.$"):
            make()


def test_negative_saturation_is_refused():
    with pytest.raises(ParameterError, match=r"^beta = -0\.5 is below 0\.$"):
        latency_map(4, 0.0, -0.5, 0.7)
    with pytest.raises(ParameterError, match=r"^beta = -0\.5 is below 0\.$"):
        flat(1.0, beta=-0.5)
