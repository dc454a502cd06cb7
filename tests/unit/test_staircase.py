"""The compiled engine's plan adds up to the kernels it was made for, and to few operations."""

import numpy as np
import pytest
from dlgmd_cli.models.staircase import fuse
from draws import connections
from hypothesis import given, settings
from reference import slow

from dlgmd_cli.models.dlgmd import connections_of
from dlgmd_cli.models.kernels import gaussian
from dlgmd_cli.parameters import DlgmdParameters

SETS = sorted(slow.TABLE_2)


def amounts_to(plan, delays, radius):
    """The kernel of every delay that the plan's sums amount to, on (4r + 1, 4r + 1) taps.

    A tap at (dy, dx) reads the cell at (+dy, +dx), so that it stands there in the kernel.
    """
    side = 4 * radius + 1
    kernels = {delay: np.zeros((side, side)) for delay in delays}

    def spread(tap, dy, dx, weight):
        source = plan.sources[tap.read]
        place = 2 * radius + tap.dy + dy, 2 * radius + tap.dx + dx
        kernels[source.delay][place] += weight * tap.weight
        if source.difference:
            kernels[source.delay + 1][place] -= weight * tap.weight

    for tap in plan.taps:
        spread(tap, 0, 0, 1.0)
    for along in plan.along:
        assert along.dy == 0
        number = along.read
        while number >= 0:
            assert plan.partials[number].onto < number
            for tap in plan.partials[number].taps:
                assert tap.dx == 0
                spread(tap, 0, along.dx, along.weight)
            number = plan.partials[number].onto
    return kernels


def check(kernels, gaussians):
    plan = fuse(kernels, gaussians)
    radius = kernels[0].shape[0] // 2
    delays = range(max(kernels) + 2)
    found = amounts_to(plan, delays, radius)
    scale = max(sum(np.abs(kernel).max() for kernel in kernels.values()), 1e-30)
    inside = slice(radius, 3 * radius + 1)
    for delay in delays:
        expected = np.zeros((4 * radius + 1, 4 * radius + 1))
        expected[inside, inside] = kernels.get(delay, 0.0)
        np.testing.assert_allclose(found[delay], expected, rtol=0, atol=1e-8 * scale)
    for number in range(len(plan.sources)):
        rows = [tap.dy for p in plan.partials for tap in p.taps if tap.read == number]
        rows += [tap.dy for tap in plan.taps if tap.read == number]
        assert plan.reach(number) == max(map(abs, rows))
    return plan


def kernels_of(params):
    found = connections_of(params)
    return found.signed(), [gaussian(params.r, s) for s in (params.sigma_i, params.sigma_e)]


def loads(plan):
    return sum(len(p.taps) for p in plan.partials) + len(plan.along) + len(plan.taps)


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", SETS)
def test_plan_of_the_sets_adds_up(number, formulation):
    params = DlgmdParameters(**slow.table_2(number, formulation=formulation))
    kernels, gaussians = kernels_of(params)
    plan = check(kernels, gaussians)
    assert loads(plan) <= sum(np.count_nonzero(kernel) for kernel in kernels.values())


def test_discs_of_one_gaussian_share_their_sums():
    # 13 up the outer square, 9 up the disc in three steps on top of it, 13 along the row, and
    # two crosses in the middle: 45 in place of 178 taps.
    kernels, gaussians = kernels_of(DlgmdParameters(**slow.table_2(9)))
    plan = fuse(kernels, gaussians)
    assert [len(partial.taps) for partial in plan.partials] == [13, 5, 2, 2]
    assert [partial.onto for partial in plan.partials] == [-1, 0, 1, 2]
    assert len(plan.along) == 13 and len(plan.taps) == 10


@settings(deadline=None, max_examples=100)
@given(connections(sigmas=(0.02, 100.0), max_r=8, max_a=10.0))
def test_plan_of_any_parameters_adds_up(values):
    check(*kernels_of(DlgmdParameters(**values)))


@pytest.mark.parametrize("radius", [1, 3, 6])
def test_kernels_without_structure_stay_taps(radius):
    rng = np.random.default_rng(radius)
    kernel = rng.random((2 * radius + 1, 2 * radius + 1)) + 0.5
    kernel[0, 0] = 0.0
    plan = check({0: kernel}, [gaussian(radius, 1.0), gaussian(radius, 3.0)])
    assert len(plan.taps) == kernel.size - 1 and not plan.partials


def test_kernels_of_low_rank_become_sums_of_products():
    column, row = np.random.default_rng(1).random((2, 13)) + 0.5
    plan = check({0: np.outer(column, row)}, [gaussian(6, 1.0), gaussian(6, 3.0)])
    assert [len(partial.taps) for partial in plan.partials] == [13]
    assert len(plan.along) == 13 and not plan.taps


def test_nothing_but_zeros_needs_no_sums():
    plan = check({0: np.zeros((5, 5)), 1: np.zeros((5, 5))}, [gaussian(2, 1.0)])
    assert loads(plan) == 0 and plan.sources == []
