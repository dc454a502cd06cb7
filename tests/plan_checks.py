"""Whether plans of filters and of staircases add up to the kernels that they were made for."""

import numpy as np

from dlgmd_cli.microcontroller.staircases import fuse
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.filters import apply
from dlgmd_cli.models.plan import plan

# Kernels below this vanish in float32, and need not come back.
TINY = 1e-30


def n_taps(sums):
    """How many numbers the sums add."""
    return sum(map(len, sums))


def kernel_of(filters, delay, last_delay, radius):
    """What an impulse in P(t - delay) leaves behind: the kernel the filters amount to."""
    side = 4 * radius + 1
    history = np.zeros((last_delay + 2, side, side), np.float32)
    history[delay, 2 * radius, 2 * radius] = 1.0
    total, out = np.zeros((side, side)), np.empty((side, side), np.float32)
    for source, ones in filters.items():
        image = history[source.delay] - source.difference * history[source.delay + 1]
        for one in ones:
            apply(one, image, out=out)
            total += out
    return total


def amounts_to(sums, delays, radius):
    """The kernel of every delay that the sums amount to, on (4r + 1, 4r + 1) taps.

    A tap at (dy, dx) reads the cell at (+dy, +dx), so that it stands there in the kernel.
    """
    side = 4 * radius + 1
    kernels = {delay: np.zeros((side, side)) for delay in delays}

    def spread(number, dx, weight):
        for tap in sums[number]:
            if isinstance(tap.read, int):
                assert tap.read < number and tap.dy == 0
                spread(tap.read, dx + tap.dx, weight * tap.weight)
                continue
            # Sums that others read along the row go up the column alone.
            assert tap.dx == 0 or dx == 0
            place = 2 * radius + tap.dy, 2 * radius + dx + tap.dx
            kernels[tap.read.delay][place] += weight * tap.weight
            if tap.read.difference:
                kernels[tap.read.delay + 1][place] -= weight * tap.weight

    spread(len(sums) - 1, 0, 1.0)
    return kernels


def _expect(found, kernels, tolerance):
    """Every delay's kernel comes back.

    The scale is that of all kernels together: terms on differences of frames add and take away
    what belongs to other delays, and a Gaussian may reach beyond the part that is left of it.
    """
    radius = kernels[0].shape[0] // 2
    scale = max(sum(np.abs(kernel).max() for kernel in kernels.values()), TINY)
    for delay, kernel in found.items():
        expected = np.pad(kernels.get(delay, np.zeros_like(kernels[0])), radius)
        np.testing.assert_allclose(kernel, expected, rtol=0, atol=tolerance * scale)


def check_plan(kernels, gaussians):
    """OpenCV's filters add up, within a few roundings to float32."""
    filters = plan(kernels, gaussians)
    radius, last = kernels[0].shape[0] // 2, max(kernels)
    found = {delay: kernel_of(filters, delay, last, radius) for delay in range(last + 1)}
    _expect(found, kernels, 4 * 2.0**-24)
    return filters


def check_fused(kernels, gaussians):
    """The sums of staircases add up."""
    sums = fuse(kernels, gaussians, n_taps)
    radius = kernels[0].shape[0] // 2
    _expect(amounts_to(sums, range(max(kernels) + 2), radius), kernels, 1e-8)
    return sums


def check_both(params):
    """Both plans for a model's connections."""
    found = DLGMD(params).connections
    kernels = found.signed()
    return check_plan(kernels, found.gaussians), check_fused(kernels, found.gaussians)
