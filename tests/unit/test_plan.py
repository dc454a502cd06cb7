"""Filters and sums of staircases add up to their kernels, and to few operations."""

import numpy as np
import pytest
from plan_checks import check_both, check_fused, check_plan, n_taps

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.filters import apply, sum_4x4
from dlgmd_cli.models.kernels import gaussian
from dlgmd_cli.models.plan import decompose, plan
from dlgmd_cli.parameters.presets import LATENCIES, load_set


def products(filters):
    """Multiplications per pixel."""
    return sum(np.count_nonzero(part) for ones in filters.values() for one in ones for part in one)


@pytest.mark.parametrize("latency", LATENCIES)
@pytest.mark.parametrize("number", [1, 5, 9])
def test_plans_of_the_sets_add_up(number, latency):
    params = load_set(number, latency=latency)
    filters, sums = check_both(params)
    n_all = sum(np.count_nonzero(kernel) for kernel in DLGMD(params).connections.signed().values())
    assert n_taps(sums) <= n_all
    if number >= 8:  # the widest: most of the work is saved
        assert products(filters) < 0.5 * n_all
        # Beyond 11 taps a side, OpenCV turns to the Fourier transform.
        assert all(len(one[0]) <= 11 for ones in filters.values() for one in ones if len(one) == 1)


def test_the_outer_band_of_set_9_becomes_a_whole_gaussian():
    found = DLGMD(load_set(9)).connections
    filters = plan(found.signed(), found.gaussians)
    assert sorted(filters) == [(0, False), (1, True), (2, False)]
    (outer,) = (one for one in filters[2, False] if len(one) == 2)
    assert [side.shape for side in outer] == [(13,), (13,)]


@pytest.mark.parametrize("radius", [1, 2, 4, 5])
def test_kernels_without_structure_stay_taps(radius):
    rng = np.random.default_rng(radius)
    quarter = rng.random((radius + 1, radius + 1)) + 0.5
    half = np.hstack([quarter[:, :0:-1], quarter])
    kernel = np.vstack([half[:0:-1], half])
    bases = [gaussian(radius, 1.0), gaussian(radius, 3.0)]
    (((only,),),) = check_plan({0: kernel}, bases).values()
    np.testing.assert_array_equal(only, kernel.astype(np.float32))
    kernel[0, 0] = 0.0
    sums = check_fused({0: kernel}, bases)
    assert n_taps(sums) == kernel.size - 1


def test_a_gaussian_is_one_separable_filter():
    assert [len(one) for one in decompose(1.5 * gaussian(6, 5.0), [gaussian(6, 5.0)])] == [2]


def test_taps_are_cut_to_their_support():
    kernel = np.zeros((9, 9))
    kernel[4, 4], kernel[3, 4], kernel[5, 4], kernel[4, 3], kernel[4, 5] = 5, 1, 1, 2, 2
    ((only,),) = decompose(kernel, [])
    assert only.shape == (3, 3)


def test_kernels_of_zeros_need_nothing():
    kernel, zero, bases = gaussian(4, 1.0), np.zeros((9, 9)), [gaussian(4, 1.0)]
    for kernels in ({0: zero}, {0: zero, 2: zero}):
        assert plan(kernels, bases) == {}
        assert check_fused(kernels, bases) == [[]]
    assert len(check_plan({0: kernel, 1: zero, 3: -kernel}, bases)) == 2


@pytest.mark.parametrize("one", [(np.ones((3, 3)),), (np.ones(3), np.ones(3))])
def test_filters_see_nothing_beyond_the_border(one):
    image = np.ones((3, 4), np.float32)
    out = np.empty_like(image)
    apply(one, image, out=out)
    np.testing.assert_array_equal(out, [[4, 6, 6, 4], [6, 9, 9, 6], [4, 6, 6, 4]])


def test_the_4x4_window_reaches_further_down_and_right():
    image = np.zeros((9, 9), np.float32)
    image[4, 5] = 1.0
    out = np.empty_like(image)
    sum_4x4(image, out=out)
    # A cell sums rows and columns -1 … +2, so an impulse shows from -2 to +1.
    expected = np.zeros((9, 9))
    expected[2:6, 3:7] = 1.0
    np.testing.assert_array_equal(out, expected)
