"""The plan of filters adds up to the kernels it was made for, and to fewer operations."""

import cv2
import numpy as np
import pytest
from dlgmd_cli.models.filters import Separable, Taps, sum_4x4
from dlgmd_cli.models.plan import decompose, plan
from draws import connections
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import slow

from dlgmd_cli.models.kernels import connect, gaussian
from dlgmd_cli.parameters import DlgmdParameters

SETS = sorted(slow.TABLE_2)
# Kernels below this vanish in float32, and need not come back.
TINY = 1e-30


def answer_to(terms, history):
    """The sum of all terms' filters; `history[d]` is P(t - d)."""
    total = np.zeros(history[0].shape)
    for term in terms:
        image = history[term.delay]
        if term.difference:
            image = image - history[term.delay + 1]
        out = np.full_like(image, np.nan)
        term.filter.apply(image, out=out)
        total += out
    return total


def kernel_of(terms, delay, last_delay, radius):
    """What an impulse in P(t - delay) leaves behind: the kernel the terms amount to."""
    side = 4 * radius + 1
    history = [np.zeros((side, side), np.float32) for _ in range(last_delay + 1)]
    history[delay][2 * radius, 2 * radius] = 1.0
    return answer_to(terms, history)


def check(kernels, gaussians):
    """Every delay's kernel comes back from the terms, within a few roundings to float32.

    The scale is that of all kernels together: terms on differences of frames add and take away
    what belongs to other delays, and a Gaussian may reach beyond the part that is left of it.
    """
    terms = plan(kernels, gaussians)
    radius = kernels[0].shape[0] // 2
    last = max(kernels)
    scale = max(sum(np.abs(kernel).max() for kernel in kernels.values()), TINY)
    inside = slice(radius, 3 * radius + 1)
    for delay in range(last + 1):
        expected = np.zeros((4 * radius + 1, 4 * radius + 1))
        expected[inside, inside] = kernels.get(delay, 0.0)
        np.testing.assert_allclose(
            kernel_of(terms, delay, last, radius), expected, rtol=0, atol=4 * 2.0**-24 * scale
        )
    return terms


def kernels_of(params):
    found = connect(params)
    bases = [gaussian(params.r, sigma) for sigma in (params.sigma_i, params.sigma_e)]
    return found.signed(), bases


def products(terms):
    """Multiplications per pixel."""
    return sum(
        term.filter.row.size + term.filter.column.size
        if isinstance(term.filter, Separable)
        else np.count_nonzero(term.filter.kernel)
        for term in terms
    )


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", SETS)
def test_plan_of_the_sets_adds_up(number, formulation):
    params = DlgmdParameters(**slow.table_2(number, formulation=formulation))
    check(*kernels_of(params))


@settings(deadline=None, max_examples=80)
@given(connections(sigmas=(0.02, 100.0), max_r=8, max_a=10.0))
def test_plan_of_any_parameters_adds_up(values):
    check(*kernels_of(DlgmdParameters(**values)))


@st.composite
def symmetric(draw, radius):
    """A kernel that is the same in all eight directions, and otherwise anything."""
    corner = draw(
        st.lists(
            st.floats(-1.0, 1.0, width=32), min_size=(radius + 1) ** 2, max_size=(radius + 1) ** 2
        )
    )
    quarter = np.array(corner).reshape(radius + 1, radius + 1)
    quarter = quarter + quarter.T
    half = np.hstack([quarter[:, :0:-1], quarter])
    return np.vstack([half[:0:-1], half])


@settings(deadline=None, max_examples=60)
@given(st.data(), st.integers(1, 6), st.sets(st.integers(1, 4)))
def test_plan_of_any_symmetric_kernels_adds_up(data, radius, delays):
    kernels = {delay: data.draw(symmetric(radius)) for delay in {0} | delays}
    check(kernels, [gaussian(radius, 1.0), gaussian(radius, 3.0)])


@pytest.mark.parametrize("radius", [1, 2, 4, 5])
def test_kernels_without_structure_fall_back_to_taps(radius):
    rng = np.random.default_rng(radius)
    quarter = rng.random((radius + 1, radius + 1)) + 0.5
    half = np.hstack([quarter[:, :0:-1], quarter])
    kernel = np.vstack([half[:0:-1], half])
    bases = [gaussian(radius, 1.0), gaussian(radius, 3.0)]
    found = decompose(kernel, bases)
    assert [type(one) for one in found.filters] == [Taps]
    np.testing.assert_array_equal(found.filters[0].kernel, kernel.astype(np.float32))
    (term,) = check({0: kernel}, bases)
    assert (term.delay, term.difference) == (0, False)


def test_taps_are_cut_to_their_support():
    kernel = np.zeros((9, 9))
    kernel[4, 4], kernel[3, 4], kernel[5, 4], kernel[4, 3], kernel[4, 5] = 5, 1, 1, 2, 2
    (only,) = decompose(kernel, []).filters
    assert isinstance(only, Taps)
    assert only.kernel.shape == (3, 3)


def test_a_gaussian_costs_two_passes():
    (only,) = decompose(1.5 * gaussian(6, 5.0), [gaussian(6, 5.0)]).filters
    assert isinstance(only, Separable)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", [8, 9])
def test_plan_of_the_widest_sets_saves_most_of_the_work(number, formulation):
    kernels, bases = kernels_of(DlgmdParameters(**slow.table_2(number, formulation=formulation)))
    terms = check(kernels, bases)
    assert products(terms) < 0.5 * sum(np.count_nonzero(kernel) for kernel in kernels.values())
    plain = sum(decompose(kernel, []).cost for kernel in kernels.values())
    assert sum(decompose(kernel, bases).cost for kernel in kernels.values()) < plain
    # Beyond 11 taps a side, OpenCV turns to the Fourier transform.
    assert all(max(t.filter.kernel.shape) <= 11 for t in terms if isinstance(t.filter, Taps))


def test_the_outer_band_of_set_9_becomes_a_whole_gaussian():
    terms = plan(*kernels_of(DlgmdParameters(**slow.table_2(9))))
    assert {(term.delay, term.difference) for term in terms} == {(0, False), (1, True), (2, False)}
    (outer,) = (t.filter for t in terms if t.delay == 2 and isinstance(t.filter, Separable))
    assert outer.row.shape == outer.column.shape == (13,)


def test_kernels_of_zeros_need_no_filter():
    zero = np.zeros((9, 9))
    assert decompose(zero, [gaussian(4, 1.0)]).filters == ()
    assert plan({0: zero}, [gaussian(4, 1.0)]) == ()
    assert plan({0: zero, 2: zero}, [gaussian(4, 1.0)]) == ()


def test_a_kernel_of_zeros_between_others_is_skipped():
    kernel, zero = gaussian(4, 1.0), np.zeros((9, 9))
    terms = check({0: kernel, 1: zero, 3: -kernel}, [gaussian(4, 1.0)])
    assert len(terms) == 2


def test_filters_see_nothing_beyond_the_border():
    image = np.ones((3, 4), np.float32)
    out = np.empty_like(image)
    Taps(np.ones((3, 3), np.float32)).apply(image, out=out)
    np.testing.assert_array_equal(out, [[4, 6, 6, 4], [6, 9, 9, 6], [4, 6, 6, 4]])
    Separable(np.ones(3, np.float32), np.ones(3, np.float32)).apply(image, out=out)
    np.testing.assert_array_equal(out, [[4, 6, 6, 4], [6, 9, 9, 6], [4, 6, 6, 4]])


def test_separable_keeps_rows_and_columns_apart():
    image = np.zeros((5, 7), np.float32)
    image[2, 3] = 1.0
    out = np.empty_like(image)
    column, row = np.float32([1, 2, 1]), np.float32([1, 3, 5, 3, 1])
    Separable(column, row).apply(image, out=out)
    np.testing.assert_array_equal(out[1:4, 1:6], np.outer(column, row))
    assert cv2.countNonZero(out) == 15


def test_the_4x4_window_reaches_further_down_and_right():
    image = np.zeros((9, 9), np.float32)
    image[4, 5] = 1.0
    out = np.empty_like(image)
    sum_4x4(image, out=out)
    # A cell sums rows and columns -1 … +2, so an impulse shows from -2 to +1.
    expected = np.zeros((9, 9))
    expected[2:6, 3:7] = 1.0
    np.testing.assert_array_equal(out, expected)
