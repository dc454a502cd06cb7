"""Planning how to apply the kernels of all delays with few operations.

A Gaussian that is cut into bands by latency is not separable, but nearly: a disc is a separable
square without a few corner taps, and neighbouring bands telescope,

    Σ_d K_d ∗ P(t-d) = Σ_d C_d ∗ (P(t-d) - P(t-d-1)),   C_d = K_0 + … + K_d,

so that the outermost kernel is a whole Gaussian. `plan` tries such rearrangements, plain `filter2D`
among them, and chooses the cheapest for OpenCV's filters.
"""

from collections.abc import Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.kernels import FloatKernel

# Taps below this share of the largest tap are rounding errors of float64.
NEGLIGIBLE = 1e-13
# Singular values below this share of the largest value are negligible in float32.
RANK_TOLERANCE = 1e-9

# Costs in ns per pixel, measured on float32 images in cache, with one thread.
PASS_COST = 0.15  # one more addition or difference of two images
TAPS_COST = (0.13, 0.038)  # filter2D: fixed, per tap
SEPARABLE_COST = (0.14, 0.098)  # sepFilter2D: fixed, per tap of one side
DFT_COST = 11.3  # filter2D beyond 11 x 11, where OpenCV uses the Fourier transform
MAX_TAPS_SIDE = 11


class Source(NamedTuple):
    """An input: P(t - delay), or the difference P(t - delay) - P(t - delay - 1)."""

    delay: int
    difference: bool


Layout = dict[Source, FloatKernel]
# A column and a row for `cv2.sepFilter2D`, or one kernel for `cv2.filter2D`.
Filter = tuple[npt.NDArray[np.float32], ...]


def layouts(kernels: dict[int, FloatKernel]) -> list[Layout]:
    """Alternative distributions of the kernels over frames and differences of frames."""
    return [_telescoped(kernels, first) for first in (max(kernels), 0, 1)]


def _telescoped(kernels: dict[int, FloatKernel], first: int) -> Layout:
    """The layout with cumulative kernels on differences of frames from delay `first` on."""
    layout = {Source(d, False): kernels[d] for d in sorted(kernels) if d < first}
    zero = np.zeros_like(kernels[0])
    last, cumulative = max(kernels), zero
    for delay in range(first, last + 1):
        cumulative = cumulative + kernels.get(delay, zero)
        layout[Source(delay, delay < last)] = cumulative
    return layout


def without_rounding(kernel: FloatKernel, peak: float) -> FloatKernel:
    """`kernel` without taps that are rounding errors of numbers as large as `peak`."""
    return np.where(np.abs(kernel) > NEGLIGIBLE * peak, kernel, 0.0)


def scale_of(kernel: FloatKernel, gaussian: FloatKernel) -> float | None:
    """The factor if `kernel` is part of a multiple of `gaussian`, else None."""
    used = (np.abs(kernel) > 0.0) & (gaussian > NEGLIGIBLE * gaussian.max())
    if not used.any():
        return None
    scale = median((kernel[used] / gaussian[used]).tolist())  # NumPy's would import masked arrays
    return None if abs(scale) * gaussian.max() > 2.0 * np.abs(kernel).max() else scale


def plan(
    kernels: dict[int, FloatKernel], gaussians: Sequence[FloatKernel]
) -> dict[Source, list[Filter]]:
    """The cheapest filters found whose sum is Σ_d kernels[d] ∗ P(t - d), by their sources.

    Parameters
    ----------
    kernels : dict of int to ndarray
        Delay in frames -> symmetric (2r + 1, 2r + 1) kernel; delay 0 is required.
    gaussians : sequence of ndarray
        Separable kernels of the same shape, of which `kernels` are parts.
    """
    plans = [
        {s: filters for s, kernel in layout.items() if (filters := decompose(kernel, gaussians))}
        for layout in layouts(kernels)
    ]
    return min(plans, key=lambda p: sum(_cost(f) + PASS_COST * s.difference for s, f in p.items()))


def decompose(kernel: FloatKernel, gaussians: Sequence[FloatKernel]) -> list[Filter]:
    """The cheapest filters found whose sum is `kernel`; empty if it is all zeros."""
    if not kernel.any():
        return []
    options = [_taps(without_rounding(kernel, np.abs(kernel).max())), _low_rank(kernel)]
    halves = range(1, len(kernel) // 2 + 1)
    options += [_cut_gaussian(kernel, base, half) for base in gaussians for half in halves]
    return min((option for option in options if option), key=_cost)


def _cost(filters: list[Filter]) -> float:
    """Cost of applying filters and adding their results, in ns per pixel."""
    cost = len(filters) * PASS_COST
    for kernels in filters:
        if len(kernels) == 2:
            cost += SEPARABLE_COST[0] + SEPARABLE_COST[1] * kernels[0].size
        elif len(kernels[0]) <= MAX_TAPS_SIDE:
            cost += TAPS_COST[0] + TAPS_COST[1] * np.count_nonzero(kernels[0])
        else:
            cost += DFT_COST
    return cost


def _cut_gaussian(kernel: FloatKernel, gaussian: FloatKernel, half: int) -> list[Filter]:
    """A multiple of `gaussian` on a square of half side `half`, and taps for the rest."""
    radius = len(kernel) // 2
    inside = slice(radius - half, radius + half + 1)
    square = np.zeros_like(kernel)
    square[inside, inside] = gaussian[inside, inside]
    scale = scale_of(kernel, square)
    if scale is None:
        return []
    rest = without_rounding(kernel - scale * square, np.abs(kernel).max())
    # g(x, y) = g(x, 0) g(0, y) / g(0, 0)
    profile = gaussian[radius, inside]
    return [_separable(profile * scale / gaussian[radius, radius], profile), *_taps(rest)]


def _taps(kernel: FloatKernel) -> list[Filter]:
    """`kernel` as one plain filter, cropped to its centred support; empty for zeros."""
    radius = len(kernel) // 2
    away = np.abs(np.argwhere(kernel) - radius)
    if away.size == 0:
        return []
    inside = slice(radius - away.max(), radius + away.max() + 1)
    return [(np.ascontiguousarray(kernel[inside, inside], np.float32),)]


def _low_rank(kernel: FloatKernel) -> list[Filter]:
    """Separable filters that add up to `kernel`, by its singular values."""
    columns, weights, rows = np.linalg.svd(kernel)
    rank = int(np.count_nonzero(weights > RANK_TOLERANCE * weights[0]))
    return [_separable(columns[:, i] * weights[i], rows[i]) for i in range(rank)]


def _separable(column: FloatKernel, row: FloatKernel) -> Filter:
    return column.astype(np.float32), row.astype(np.float32)
