"""Gaussians, latency, bands and the kernel of each delay."""

import numpy as np
import pytest
from reference import slow

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.kernels import gaussian
from dlgmd_cli.parameters.presets import LATENCIES, DlgmdParameters


def as_array(weights, r):
    """The reference's (dx, dy) -> weight as the package lays kernels out."""
    kernel = np.zeros((2 * r + 1, 2 * r + 1))
    for (x, y), weight in weights.items():
        kernel[y + r, x + r] = weight
    return kernel


@pytest.mark.parametrize("latency", LATENCIES)
@pytest.mark.parametrize("number", sorted(slow.TABLE_2))
def test_kernels_of_the_sets(number, latency):
    params = slow.table_2(number)
    names = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r", "a")
    excite, inhibit = slow.kernels(**{name: params[name] for name in names}, rounding=latency)
    found = DLGMD(DlgmdParameters(**params, latency=latency)).connections
    np.testing.assert_allclose(found.excitation, as_array(excite, params["r"]), atol=1e-15)
    assert sorted(found.inhibition) == sorted(inhibit)
    for delay, kernel in found.inhibition.items():
        np.testing.assert_allclose(kernel, as_array(inhibit[delay], params["r"]), atol=1e-15)
    # What reaches a cell: excitation less inhibition.
    signed = found.signed()
    at_once = found.inhibition.get(0, 0.0)
    np.testing.assert_array_equal(signed.pop(0), found.excitation - at_once)
    for delay, kernel in signed.items():
        np.testing.assert_array_equal(kernel, -found.inhibition[delay])


def flat(latency_frames, latency="bands"):
    """Connections whose latency is the same at every tap."""
    shape = {"alpha": latency_frames - 1.0, "beta": 0.0, "lam": 0.0}
    size = {"r": 2, "sigma_e": 1.0, "sigma_i": 2.0, "a": 1.5}
    return DLGMD(DlgmdParameters(**shape, **size, latency=latency)).connections


INHIBIT = 1.5 * gaussian(2, 2.0)


@pytest.mark.parametrize(
    ("latency_frames", "delay"),
    [
        (0.0, None),
        (np.nextafter(1.0, 0.0), None),
        (1.0, 1),
        (np.nextafter(1.8999, 0.0), 1),
        (1.8999, 2),
        (7.0, 2),
    ],
)
def test_band_edges(latency_frames, delay):
    found = flat(latency_frames)
    assert (found.latency == latency_frames).all()
    assert list(found.inhibition) == ([] if delay is None else [delay])
    for kernel in found.inhibition.values():
        np.testing.assert_array_equal(kernel, INHIBIT)


@pytest.mark.parametrize(
    ("latency_frames", "delay"), [(0.0, 0), (0.499, 0), (0.5, 1), (1.49, 1), (1.5, 2), (7.0, 7)]
)
def test_the_nearest_frame_takes_all_inhibition(latency_frames, delay):
    found = flat(latency_frames, "nearest")
    assert list(found.inhibition) == [delay]
    np.testing.assert_array_equal(found.inhibition[delay], INHIBIT)


def test_interpolation_splits_between_two_frames():
    found = flat(2.25, "interpolated")
    assert sorted(found.inhibition) == [2, 3] and found.max_delay_frames == 3
    np.testing.assert_allclose(found.inhibition[2], 0.75 * INHIBIT, rtol=1e-15)
    np.testing.assert_allclose(found.inhibition[3], 0.25 * INHIBIT, rtol=1e-15)
