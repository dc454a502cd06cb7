"""The plans of filters and of loops add up to their kernels, and to few operations."""

import numpy as np
import pytest
from plan_checks import check_both, check_fused, check_plan
from reference import slow

from dlgmd_cli.models.engines.opencv import apply, sum_4x4
from dlgmd_cli.models.engines.plan import Separable, Taps, decompose, fuse, plan
from dlgmd_cli.models.kernels import connect, gaussian
from dlgmd_cli.parameters import load_set


def products(terms):
    """Multiplications per pixel."""
    return sum(
        one.row.size + one.column.size
        if isinstance(one, Separable)
        else np.count_nonzero(one.kernel)
        for _, one in terms
    )


def loads(fused):
    """Numbers read per pixel."""
    return sum(len(p.taps) for p in fused.partials) + len(fused.along) + len(fused.taps)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", sorted(slow.TABLE_2))
def test_plans_of_the_sets_add_up(number, formulation):
    params = load_set(number, formulation=formulation)
    terms, fused = check_both(params)
    n_taps = sum(np.count_nonzero(kernel) for kernel in connect(params).signed().values())
    assert loads(fused) <= n_taps
    if number >= 8:  # the widest: most of the work is saved
        assert products(terms) < 0.5 * n_taps
        # Beyond 11 taps a side, OpenCV turns to the Fourier transform.
        assert all(max(one.kernel.shape) <= 11 for _, one in terms if isinstance(one, Taps))


def test_the_outer_band_of_set_9_becomes_a_whole_gaussian():
    found = connect(load_set(9))
    terms = plan(found.signed(), found.gaussians)
    assert {source for source, _ in terms} == {(0, False), (1, True), (2, False)}
    (outer,) = (one for source, one in terms if source == (2, False) and isinstance(one, Separable))
    assert outer.row.shape == outer.column.shape == (13,)


def test_discs_of_one_gaussian_share_their_sums():
    # 13 up the outer square, 9 up the disc in three steps on top of it, 13 along the row, and
    # two crosses in the middle: 45 in place of 178 taps.
    found = connect(load_set(9))
    fused = fuse(found.signed(), found.gaussians)
    assert [len(partial.taps) for partial in fused.partials] == [13, 5, 2, 2]
    assert [partial.onto for partial in fused.partials] == [-1, 0, 1, 2]
    assert len(fused.along) == 13 and len(fused.taps) == 10


@pytest.mark.parametrize("radius", [1, 2, 4, 5])
def test_kernels_without_structure_stay_taps(radius):
    rng = np.random.default_rng(radius)
    quarter = rng.random((radius + 1, radius + 1)) + 0.5
    half = np.hstack([quarter[:, :0:-1], quarter])
    kernel = np.vstack([half[:0:-1], half])
    bases = [gaussian(radius, 1.0), gaussian(radius, 3.0)]
    ((source, only),) = check_plan({0: kernel}, bases)
    assert source == (0, False)
    np.testing.assert_array_equal(only.kernel, kernel.astype(np.float32))
    kernel[0, 0] = 0.0
    fused = check_fused({0: kernel}, bases)
    assert len(fused.taps) == kernel.size - 1 and not fused.partials


def test_kernels_of_low_rank_become_sums_of_products():
    column, row = np.random.default_rng(1).random((2, 13)) + 0.5
    fused = check_fused({0: np.outer(column, row)}, [gaussian(6, 1.0), gaussian(6, 3.0)])
    assert [len(partial.taps) for partial in fused.partials] == [13]
    assert len(fused.along) == 13 and not fused.taps
    (only,) = decompose(1.5 * gaussian(6, 5.0), [gaussian(6, 5.0)]).filters
    assert isinstance(only, Separable)


def test_taps_are_cut_to_their_support():
    kernel = np.zeros((9, 9))
    kernel[4, 4], kernel[3, 4], kernel[5, 4], kernel[4, 3], kernel[4, 5] = 5, 1, 1, 2, 2
    (only,) = decompose(kernel, []).filters
    assert isinstance(only, Taps) and only.kernel.shape == (3, 3)


def test_kernels_of_zeros_need_nothing():
    kernel, zero, bases = gaussian(4, 1.0), np.zeros((9, 9)), [gaussian(4, 1.0)]
    for kernels in ({0: zero}, {0: zero, 2: zero}):
        assert plan(kernels, bases) == ()
        fused = check_fused(kernels, bases)
        assert loads(fused) == 0 and fused.sources == []
    assert len(check_plan({0: kernel, 1: zero, 3: -kernel}, bases)) == 2


@pytest.mark.parametrize(
    "one",
    [Taps(np.ones((3, 3), np.float32)), Separable(np.ones(3, np.float32), np.ones(3, np.float32))],
)
def test_filters_see_nothing_beyond_the_border(one):
    image = np.ones((3, 4), np.float32)
    out = np.empty_like(image)
    apply(one, image, out=out)
    np.testing.assert_array_equal(out, [[4, 6, 6, 4], [6, 9, 9, 6], [4, 6, 6, 4]])


def test_separable_keeps_rows_and_columns_apart():
    image = np.zeros((5, 7), np.float32)
    image[2, 3] = 1.0
    out = np.empty_like(image)
    column, row = np.float32([1, 2, 1]), np.float32([1, 3, 5, 3, 1])
    apply(Separable(column, row), image, out=out)
    np.testing.assert_array_equal(out, np.pad(np.outer(column, row), 1))


def test_the_4x4_window_reaches_further_down_and_right():
    image = np.zeros((9, 9), np.float32)
    image[4, 5] = 1.0
    out = np.empty_like(image)
    sum_4x4(image, out=out)
    # A cell sums rows and columns -1 … +2, so an impulse shows from -2 to +1.
    expected = np.zeros((9, 9))
    expected[2:6, 3:7] = 1.0
    np.testing.assert_array_equal(out, expected)
