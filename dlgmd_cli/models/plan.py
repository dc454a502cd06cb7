"""How to add up the kernels of all delays with few operations.

A Gaussian cut into bands by its latency is no longer separable, but it is close: a disc is a
separable square less a few corner taps, and neighbouring bands telescope,

    Σ_d K_d ∗ P(t-d) = Σ_d C_d ∗ (P(t-d) - P(t-d-1)),   C_d = K_0 + … + K_d,

so that the outermost band becomes the whole Gaussian. The planner tries these rearrangements on
whatever kernels it is given and keeps the cheapest; plain `filter2D` is always among them.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from dlgmd_cli.models.filters import Filter, Separable, Taps
from dlgmd_cli.models.kernels import FloatKernel

# Taps below this share of the largest one are rounding of the float64 arithmetic above them.
NEGLIGIBLE = 1e-13
# Singular values below this share of the largest one are lost in float32 anyway.
RANK_TOLERANCE = 1e-9

# Costs in ns per pixel, measured on float32 images that stay in cache, with one thread.
PASS_COST = 0.15  # one more addition or difference of two images
TAPS_COST = (0.13, 0.038)  # filter2D: fixed, per tap
SEPARABLE_COST = (0.14, 0.098)  # sepFilter2D: fixed, per tap of one side
DFT_COST = 11.3  # filter2D beyond 11 x 11, where OpenCV turns to the Fourier transform
MAX_TAPS_SIDE = 11


@dataclass(frozen=True)
class Term:
    """One filter and what it reads: P(t - delay), or P(t - delay) - P(t - delay - 1)."""

    delay: int
    difference: bool
    filter: Filter


@dataclass(frozen=True)
class Costed:
    """Filters whose sum is one kernel, and what they cost."""

    filters: tuple[Filter, ...]
    cost: float


def plan(kernels: dict[int, FloatKernel], gaussians: list[FloatKernel]) -> tuple[Term, ...]:
    """The cheapest terms found whose sum is Σ_d kernels[d] ∗ P(t - d).

    Parameters
    ----------
    kernels : dict of int to ndarray
        Delay in frames -> (2r + 1, 2r + 1) kernel, symmetric.
    gaussians : list of ndarray
        Separable kernels of the same shape that the others were cut from.
    """
    candidates = []
    for layout in layouts(kernels):
        cost, terms = 0.0, []
        for (delay, difference), kernel in layout.items():
            best = decompose(kernel, gaussians)
            if best.filters:
                cost += best.cost + PASS_COST * (1 + difference)
                terms += [Term(delay, difference, one) for one in best.filters]
        candidates.append((cost, tuple(terms)))
    return min(candidates, key=lambda candidate: candidate[0])[1]


Layout = dict[tuple[int, bool], FloatKernel]


def layouts(kernels: dict[int, FloatKernel]) -> list[Layout]:
    """Ways to spread the kernels over frames and differences of frames."""
    return [plain_layout(kernels), *(telescoped_layout(kernels, first) for first in (0, 1))]


def plain_layout(kernels: dict[int, FloatKernel]) -> Layout:
    """Every kernel on its own frame."""
    return {(delay, False): kernel for delay, kernel in kernels.items()}


def telescoped_layout(kernels: dict[int, FloatKernel], first: int) -> Layout:
    """Cumulative kernels on differences of frames from delay `first` on."""
    layout = {(d, False): kernel for d, kernel in kernels.items() if d < first}
    zero = np.zeros_like(next(iter(kernels.values())))
    last, cumulative = max(kernels), zero
    for delay in range(first, last + 1):
        cumulative = cumulative + kernels.get(delay, zero)
        layout[delay, delay < last] = cumulative
    return layout


def decompose(kernel: FloatKernel, gaussians: list[FloatKernel]) -> Costed:
    """The cheapest filters found that add up to `kernel`; none for a kernel of zeros."""
    if not kernel.any():
        return Costed((), 0.0)
    options = [_taps(without_rounding(kernel)), _low_rank(kernel)]
    options += [_cut_gaussian(kernel, base, side) for base, side in _squares(kernel, gaussians)]
    return min(options, key=lambda option: option.cost)


def without_rounding(kernel: FloatKernel) -> FloatKernel:
    """`kernel` without the taps that are mere rounding."""
    return np.where(np.abs(kernel) > NEGLIGIBLE * np.abs(kernel).max(), kernel, 0.0)


def _squares(
    kernel: FloatKernel, gaussians: list[FloatKernel]
) -> Iterator[tuple[FloatKernel, int]]:
    """Every Gaussian on every centred square."""
    for gaussian in gaussians:
        for half in range(1, kernel.shape[0] // 2 + 1):
            yield gaussian, half


def _cut_gaussian(kernel: FloatKernel, gaussian: FloatKernel, half: int) -> Costed:
    """A multiple of `gaussian` on the square of half side `half`, and taps for the rest."""
    radius = kernel.shape[0] // 2
    inside = slice(radius - half, radius + half + 1)
    square = np.zeros_like(kernel)
    square[inside, inside] = gaussian[inside, inside]
    used = (np.abs(kernel) > 0.0) & (square > NEGLIGIBLE * square.max())
    if not used.any():
        return Costed((), np.inf)
    scale = np.median(kernel[used] / square[used])
    peak = np.abs(kernel).max()
    if np.abs(scale) * square.max() > 2.0 * peak:  # kernel was not cut from this Gaussian
        return Costed((), np.inf)
    rest = kernel - scale * square
    rest[np.abs(rest) <= NEGLIGIBLE * peak] = 0.0
    # g(x, y) = g(x, 0) g(0, y) / g(0, 0)
    profile = gaussian[radius, inside]
    factor = _separable(profile * scale / gaussian[radius, radius], profile)
    corners = _taps(rest)
    cost = factor.cost + corners.cost + (PASS_COST if corners.filters else 0.0)
    return Costed(factor.filters + corners.filters, cost)


def _taps(kernel: FloatKernel) -> Costed:
    """`kernel` tap by tap, cut to its centred support."""
    rows, columns = np.nonzero(kernel)
    if rows.size == 0:
        return Costed((), 0.0)
    radius = kernel.shape[0] // 2
    half = int(max(np.abs(rows - radius).max(), np.abs(columns - radius).max()))
    inside = slice(radius - half, radius + half + 1)
    taps = Taps(np.ascontiguousarray(kernel[inside, inside], np.float32))
    fixed, each = TAPS_COST
    small = 2 * half + 1 <= MAX_TAPS_SIDE
    return Costed((taps,), fixed + each * rows.size if small else DFT_COST)


def low_rank_factors(kernel: FloatKernel) -> list[tuple[FloatKernel, FloatKernel]]:
    """Columns and rows whose outer products add up to `kernel`, by its singular values."""
    columns, weights, rows = np.linalg.svd(kernel)
    rank = int(np.count_nonzero(weights > RANK_TOLERANCE * weights[0]))
    return [(columns[:, i] * weights[i], rows[i]) for i in range(rank)]


def _low_rank(kernel: FloatKernel) -> Costed:
    """`kernel` as a sum of separable filters."""
    parts = [_separable(column, row) for column, row in low_rank_factors(kernel)]
    filters = tuple(one for part in parts for one in part.filters)
    return Costed(filters, sum(part.cost for part in parts) + PASS_COST * (len(parts) - 1))


def _separable(column: FloatKernel, row: FloatKernel) -> Costed:
    fixed, each = SEPARABLE_COST
    separable = Separable(column.astype(np.float32), row.astype(np.float32))
    return Costed((separable,), fixed + each * row.size)
