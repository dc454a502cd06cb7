"""Planning how to apply the kernels of all delays with few operations.

A Gaussian that is cut into bands by latency is not separable, but nearly: a disc is a separable
square without a few corner taps, and neighbouring bands telescope,

    Σ_d K_d ∗ P(t-d) = Σ_d C_d ∗ (P(t-d) - P(t-d-1)),   C_d = K_0 + … + K_d,

so that the outermost kernel is a whole Gaussian. Two planners try such rearrangements and choose
the cheapest: `plan` for OpenCV's filters, which always considers plain `filter2D`, and `fuse` for
compiled loops.

For `fuse`, a disc cut from a Gaussian is a staircase: each column of taps has a certain height,
which does not grow with the distance from the middle. Such a kernel needs one weighted sum along
the column, extended step by step, and one along the row. At each distance, the row sum uses the
column sum of the height there. Discs from the same Gaussian, on different frames, share both.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from statistics import median
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.kernels import FloatKernel

# Taps below this share of the largest tap are rounding errors of float64.
_NEGLIGIBLE = 1e-13
# Singular values below this share of the largest value are negligible in float32.
RANK_TOLERANCE = 1e-9

# OpenCV: costs in ns per pixel, measured on float32 images in cache, with one thread.
PASS_COST = 0.15  # one more addition or difference of two images
TAPS_COST = (0.13, 0.038)  # filter2D: fixed, per tap
SEPARABLE_COST = (0.14, 0.098)  # sepFilter2D: fixed, per tap of one side
DFT_COST = 11.3  # filter2D beyond 11 x 11, where OpenCV uses the Fourier transform
MAX_TAPS_SIDE = 11
# Loops: cost of converting one more image or difference, in loads per pixel.
IMAGE_COST = 4.0
# Taps per sum. Numba's cache does not notice a change here: edit engines/numba.py as well.
MAX_TAPS = 15


class Source(NamedTuple):
    """An input: P(t - delay), or the difference P(t - delay) - P(t - delay - 1)."""

    delay: int
    difference: bool


Layout = dict[Source, FloatKernel]
# A column and a row for `cv2.sepFilter2D`, or one kernel for `cv2.filter2D`.
Filter = tuple[npt.NDArray[np.float32], ...]


class Tap(NamedTuple):
    """A weight for a source or an earlier sum (by index), at an offset in rows and columns."""

    read: Source | int
    dy: int
    dx: int
    weight: float


Sum = list[Tap]


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


def _without_rounding(kernel: FloatKernel, peak: float) -> FloatKernel:
    """`kernel` without taps that are rounding errors of numbers as large as `peak`."""
    return np.where(np.abs(kernel) > _NEGLIGIBLE * peak, kernel, 0.0)


def _scale(kernel: FloatKernel, gaussian: FloatKernel) -> float | None:
    """The factor if `kernel` is part of a multiple of `gaussian`, else None."""
    used = (np.abs(kernel) > 0.0) & (gaussian > _NEGLIGIBLE * gaussian.max())
    if not used.any():
        return None
    scale = median((kernel[used] / gaussian[used]).tolist())  # NumPy's would import masked arrays
    return None if abs(scale) * gaussian.max() > 2.0 * np.abs(kernel).max() else scale


# OpenCV's filters


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
    options = [_taps(_without_rounding(kernel, np.abs(kernel).max())), _low_rank(kernel)]
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
    scale = _scale(kernel, square)
    if scale is None:
        return []
    rest = _without_rounding(kernel - scale * square, np.abs(kernel).max())
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


# Compiled loops


def _loads(sums: list[Sum]) -> float:
    """Cost of computing some sums in a compiled loop, in loads per pixel."""
    return len(sources_of(sums)) * IMAGE_COST + sum(len(taps) + 1 for taps in sums)


def fuse(
    kernels: dict[int, FloatKernel],
    gaussians: Sequence[FloatKernel],
    cost: Callable[[list[Sum]], float] = _loads,
) -> list[Sum]:
    """The cheapest sums found for kernels and gaussians as in `plan`.

    The last sum is Σ_d kernels[d] ∗ P(t - d). The sums before run along the columns; each may
    include an earlier sum.
    """
    profiles = [gaussian[len(gaussian) // 2] for gaussian in gaussians]
    plans = [_fuse_layout(layout, profiles) for layout in layouts(kernels)]
    return min(plans, key=cost)


def sources_of(sums: list[Sum]) -> list[Source]:
    """All sources that the taps of the sums read."""
    return sorted({tap.read for taps in sums for tap in taps if not isinstance(tap.read, int)})


def _fuse_layout(layout: Layout, profiles: list[FloatKernel]) -> list[Sum]:
    """Sums for the kernels of a layout: staircases and single taps."""
    sums: list[Sum] = []
    along: Sum = []
    stairs: dict[int, list[Staircase]] = defaultdict(list)
    for source, whole in layout.items():
        kernel = _without_rounding(whole, np.abs(whole).max())
        radius = len(kernel) // 2
        fits = [_fit(kernel, profile, source) for profile in profiles]
        number = min(range(len(fits)), key=lambda i: fits[i][0], default=None)
        if number is not None and fits[number][0] < np.count_nonzero(kernel):
            stairs[number].append(fits[number][1])
            kernel = fits[number][2]
        along += [Tap(source, y - radius, x - radius, kernel[y, x]) for y, x in np.argwhere(kernel)]
    for number, members in stairs.items():
        _add_stairs(sums, along, members, profiles[number])
    _append(sums, along)
    return sums


def _append(sums: list[Sum], taps: Sum) -> None:
    """Append a sum, split into parts of at most `MAX_TAPS`."""
    while len(taps) > MAX_TAPS:
        sums.append(taps[:MAX_TAPS])
        taps = [Tap(len(sums) - 1, 0, 0, 1.0), *taps[MAX_TAPS:]]
    sums.append(taps)


class Staircase(NamedTuple):
    """`scale` times a Gaussian, limited to |dy| <= heights[|dx|]; a height of -1 is empty."""

    source: Source
    scale: float
    heights: list[int]


def _fit(
    kernel: FloatKernel, profile: FloatKernel, source: Source
) -> tuple[float, Staircase, FloatKernel]:
    """Fit a staircase of a Gaussian into `kernel`: loads per pixel, staircase and remainder.

    The loads include the taps of the remainder; they are infinite if nothing of the Gaussian fits.
    """
    radius, peak = len(kernel) // 2, np.abs(kernel).max()
    gaussian = np.outer(profile, profile) / profile[radius]
    scale = _scale(kernel, gaussian) or 0.0
    used = (kernel != 0.0) & (gaussian > _NEGLIGIBLE * gaussian.max())
    fitting = used & (np.abs(kernel - scale * gaussian) <= 1e-9 * peak)
    away = np.abs(np.arange(len(kernel)) - radius)
    reached = np.where(fitting[radius:, radius:], away[radius:, None], -1).max(axis=0)
    heights = np.maximum.accumulate(reached[::-1])[::-1]
    inside = away[:, None] <= heights[away]
    rest = kernel - np.where(inside, scale * gaussian, 0.0)
    rest[np.abs(rest) <= 1e-12 * peak] = 0.0
    loads = 2 * heights[0] + 2 * np.count_nonzero(heights >= 0) + np.count_nonzero(rest)
    return loads if inside.any() else np.inf, Staircase(source, scale, heights.tolist()), rest


def _add_stairs(
    sums: list[Sum], along: Sum, members: list[Staircase], profile: FloatKernel
) -> None:
    """Append the column sums of staircases of one Gaussian, and add their taps along the row."""
    radius = len(profile) // 2
    reached = [-1] * len(members)
    for distance in range(radius, -1, -1):
        heights = [member.heights[distance] for member in members]
        if heights != reached:
            begin = [Tap(len(sums) - 1, 0, 0, 1.0)] if max(reached) >= 0 else []
            further = [
                Tap(member.source, dy, 0, member.scale * profile[radius + dy])
                for member, low, high in zip(members, reached, heights, strict=True)
                for dy in range(-high, high + 1)
                if abs(dy) > low
            ]
            _append(sums, begin + further)
            reached = heights
        if max(reached) >= 0:
            weight = profile[radius + distance] / profile[radius]
            along += [Tap(len(sums) - 1, 0, dx, weight) for dx in sorted({-distance, distance})]
