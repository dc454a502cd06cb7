"""Whether plans of filters and of loops add up to the kernels that they were made for."""

import numpy as np

from dlgmd_cli.models.engines.opencv import apply
from dlgmd_cli.models.engines.plan import fuse, plan
from dlgmd_cli.models.kernels import connect

# Kernels below this vanish in float32, and need not come back.
TINY = 1e-30


def answer_to(terms, history):
    """The sum of all terms' filters; `history[d]` is P(t - d)."""
    total = np.zeros(history[0].shape)
    for (delay, difference), one in terms:
        image = history[delay] - history[delay + 1] if difference else history[delay]
        out = np.full_like(image, np.nan)
        apply(one, image, out=out)
        total += out
    return total


def kernel_of(terms, delay, last_delay, radius):
    """What an impulse in P(t - delay) leaves behind: the kernel the terms amount to."""
    side = 4 * radius + 1
    history = [np.zeros((side, side), np.float32) for _ in range(last_delay + 1)]
    history[delay][2 * radius, 2 * radius] = 1.0
    return answer_to(terms, history)


def amounts_to(fused, delays, radius):
    """The kernel of every delay that the sums amount to, on (4r + 1, 4r + 1) taps.

    A tap at (dy, dx) reads the cell at (+dy, +dx), so that it stands there in the kernel.
    """
    side = 4 * radius + 1
    kernels = {delay: np.zeros((side, side)) for delay in delays}

    def spread(tap, dx, weight):
        source = fused.sources[tap.read]
        place = 2 * radius + tap.dy, 2 * radius + tap.dx + dx
        kernels[source.delay][place] += weight * tap.weight
        if source.difference:
            kernels[source.delay + 1][place] -= weight * tap.weight

    for tap in fused.taps:
        spread(tap, 0, 1.0)
    for along in fused.along:
        assert along.dy == 0
        number = along.read
        while number >= 0:
            assert fused.partials[number].onto < number
            for tap in fused.partials[number].taps:
                assert tap.dx == 0
                spread(tap, along.dx, along.weight)
            number = fused.partials[number].onto
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
    terms = plan(kernels, gaussians)
    radius, last = kernels[0].shape[0] // 2, max(kernels)
    found = {delay: kernel_of(terms, delay, last, radius) for delay in range(last + 1)}
    _expect(found, kernels, 4 * 2.0**-24)
    return terms


def check_fused(kernels, gaussians):
    """The loops' sums add up, and reach as far as they say."""
    fused = fuse(kernels, gaussians)
    radius = kernels[0].shape[0] // 2
    _expect(amounts_to(fused, range(max(kernels) + 2), radius), kernels, 1e-8)
    for number in range(len(fused.sources)):
        read = [*fused.taps, *(tap for p in fused.partials for tap in p.taps)]
        assert fused.reach(number) == max(abs(tap.dy) for tap in read if tap.read == number)
    return fused


def check_both(params):
    """Both plans for a model's connections."""
    found = connect(params)
    kernels = found.signed()
    return check_plan(kernels, found.gaussians), check_fused(kernels, found.gaussians)
