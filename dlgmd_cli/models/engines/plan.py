"""How to add up the kernels of all delays with few operations.

A Gaussian cut into bands by its latency is no longer separable, but it is close: a disc is a
separable square less a few corner taps, and neighbouring bands telescope,

    Σ_d K_d ∗ P(t-d) = Σ_d C_d ∗ (P(t-d) - P(t-d-1)),   C_d = K_0 + … + K_d,

so that the outermost band becomes the whole Gaussian. Two planners try these rearrangements on
whatever kernels they are given and keep the cheapest: `plan` for OpenCV's filters, with plain
`filter2D` always among them, and `fuse` for loops that do all sums in one pass.

For `fuse`, a disc cut out of a Gaussian is a staircase: at each column its taps reach a certain
height, and the heights do not grow with the distance from the middle. Such a kernel needs one
weighted sum up the column, continued step by step (the partial sums), and one along the row, which
takes at each distance the partial sum that reaches as high as the kernel does there. Discs cut out
of the same Gaussian, on different frames, share both.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.kernels import FloatKernel

# Taps below this share of the largest one are rounding of the float64 arithmetic above them.
NEGLIGIBLE = 1e-13
# Singular values below this share of the largest one are lost in float32 anyway.
RANK_TOLERANCE = 1e-9

# OpenCV: costs in ns per pixel, measured on float32 images that stay in cache, with one thread.
PASS_COST = 0.15  # one more addition or difference of two images
TAPS_COST = (0.13, 0.038)  # filter2D: fixed, per tap
SEPARABLE_COST = (0.14, 0.098)  # sepFilter2D: fixed, per tap of one side
DFT_COST = 11.3  # filter2D beyond 11 x 11, where OpenCV turns to the Fourier transform
MAX_TAPS_SIDE = 11
# Loops: what it costs to convert one more image of P, or a difference of two, in loads per pixel.
IMAGE_COST, DIFFERENCE_COST = 4.0, 5.0


class Source(NamedTuple):
    """What is read: P(t - delay), or P(t - delay) - P(t - delay - 1)."""

    delay: int
    difference: bool


Layout = dict[Source, FloatKernel]


def layouts(kernels: dict[int, FloatKernel]) -> list[Layout]:
    """Ways to spread the kernels over frames and differences of frames."""
    plain = {Source(delay, False): kernel for delay, kernel in kernels.items()}
    return [plain, *(_telescoped(kernels, first) for first in (0, 1))]


def _telescoped(kernels: dict[int, FloatKernel], first: int) -> Layout:
    """Cumulative kernels on differences of frames from delay `first` on."""
    layout = {Source(d, False): kernel for d, kernel in kernels.items() if d < first}
    zero = np.zeros_like(next(iter(kernels.values())))
    last, cumulative = max(kernels), zero
    for delay in range(first, last + 1):
        cumulative = cumulative + kernels.get(delay, zero)
        layout[Source(delay, delay < last)] = cumulative
    return layout


def without_rounding(kernel: FloatKernel) -> FloatKernel:
    """`kernel` without the taps that are mere rounding."""
    return np.where(np.abs(kernel) > NEGLIGIBLE * np.abs(kernel).max(), kernel, 0.0)


def low_rank_factors(kernel: FloatKernel) -> list[tuple[FloatKernel, FloatKernel]]:
    """Columns and rows whose outer products add up to `kernel`, by its singular values."""
    columns, weights, rows = np.linalg.svd(kernel)
    rank = int(np.count_nonzero(weights > RANK_TOLERANCE * weights[0]))
    return [(columns[:, i] * weights[i], rows[i]) for i in range(rank)]


@dataclass(frozen=True)
class Separable:
    """A filter that is the outer product of a column and a row."""

    column: npt.NDArray[np.float32]
    row: npt.NDArray[np.float32]


@dataclass(frozen=True)
class Taps:
    """A filter given tap by tap; its cost grows with the taps that are not zero."""

    kernel: npt.NDArray[np.float32]


Filter = Separable | Taps


class Term(NamedTuple):
    """One filter and what it reads."""

    source: Source
    filter: Filter


class Costed(NamedTuple):
    """Filters whose sum is one kernel, and what they cost."""

    filters: tuple[Filter, ...]
    cost: float


def plan(kernels: dict[int, FloatKernel], gaussians: Sequence[FloatKernel]) -> tuple[Term, ...]:
    """The cheapest terms found whose sum is Σ_d kernels[d] ∗ P(t - d).

    Parameters
    ----------
    kernels : dict of int to ndarray
        Delay in frames -> (2r + 1, 2r + 1) kernel, symmetric.
    gaussians : sequence of ndarray
        Separable kernels of the same shape that the others were cut from.
    """
    candidates = []
    for layout in layouts(kernels):
        cost, terms = 0.0, []
        for source, kernel in layout.items():
            best = decompose(kernel, gaussians)
            if best.filters:
                cost += best.cost + PASS_COST * (1 + source.difference)
                terms += [Term(source, one) for one in best.filters]
        candidates.append((cost, tuple(terms)))
    return min(candidates, key=lambda candidate: candidate[0])[1]


def decompose(kernel: FloatKernel, gaussians: Sequence[FloatKernel]) -> Costed:
    """The cheapest filters found that add up to `kernel`; none for a kernel of zeros."""
    if not kernel.any():
        return Costed((), 0.0)
    options = [_taps(without_rounding(kernel)), _low_rank(kernel)]
    halves = range(1, kernel.shape[0] // 2 + 1)
    options += [_cut_gaussian(kernel, base, half) for base in gaussians for half in halves]
    return min(options, key=lambda option: option.cost)


def _cut_gaussian(kernel: FloatKernel, gaussian: FloatKernel, half: int) -> Costed:
    """A multiple of `gaussian` on the square of half side `half`, and taps for the rest."""
    radius = kernel.shape[0] // 2
    inside = slice(radius - half, radius + half + 1)
    square = np.zeros_like(kernel)
    square[inside, inside] = gaussian[inside, inside]
    scale = _scale(kernel, square)
    if scale is None:
        return Costed((), np.inf)
    rest = kernel - scale * square
    rest[np.abs(rest) <= NEGLIGIBLE * np.abs(kernel).max()] = 0.0
    # g(x, y) = g(x, 0) g(0, y) / g(0, 0)
    profile = gaussian[radius, inside]
    factor = _separable(profile * scale / gaussian[radius, radius], profile)
    corners = _taps(rest)
    cost = factor.cost + corners.cost + (PASS_COST if corners.filters else 0.0)
    return Costed(factor.filters + corners.filters, cost)


def _scale(kernel: FloatKernel, gaussian: FloatKernel) -> float | None:
    """Which multiple of `gaussian` the kernel was cut from; None if it was not."""
    used = (np.abs(kernel) > 0.0) & (gaussian > NEGLIGIBLE * gaussian.max())
    if not used.any():
        return None
    scale = float(np.median(kernel[used] / gaussian[used]))
    return None if abs(scale) * gaussian.max() > 2.0 * np.abs(kernel).max() else scale


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


def _low_rank(kernel: FloatKernel) -> Costed:
    """`kernel` as a sum of separable filters."""
    parts = [_separable(column, row) for column, row in low_rank_factors(kernel)]
    filters = tuple(one for part in parts for one in part.filters)
    return Costed(filters, sum(part.cost for part in parts) + PASS_COST * (len(parts) - 1))


def _separable(column: FloatKernel, row: FloatKernel) -> Costed:
    """One separable filter."""
    fixed, each = SEPARABLE_COST
    separable = Separable(column.astype(np.float32), row.astype(np.float32))
    return Costed((separable,), fixed + each * row.size)


class Tap(NamedTuple):
    """A weight, and what it is for: the number of an image, a row and a column from the cell."""

    read: int
    dy: int
    dx: int
    weight: float


class Partial(NamedTuple):
    """A sum up the columns of sources, on top of an earlier one (-1: of nothing)."""

    onto: int
    taps: list[Tap]


@dataclass
class FusedPlan:
    """Sums whose total is Σ_d kernels[d] ∗ P(t - d).

    Attributes
    ----------
    sources : list of Source
        What is read.
    partials : list of Partial
        Sums up the columns, in the order in which they are to be computed.
    along : list of Tap
        The sum along the row; each tap reads a partial.
    taps : list of Tap
        What is left, read from the sources.
    """

    sources: list[Source] = field(default_factory=list)
    partials: list[Partial] = field(default_factory=list)
    along: list[Tap] = field(default_factory=list)
    taps: list[Tap] = field(default_factory=list)

    def number(self, source: Source) -> int:
        """The number of a source, which becomes one that is read."""
        if source not in self.sources:
            self.sources.append(source)
        return self.sources.index(source)

    @property
    def cost(self) -> float:
        """Numbers loaded per pixel, conversions included."""
        sums = sum(len(partial.taps) + 1 for partial in self.partials)
        images = sum(DIFFERENCE_COST if s.difference else IMAGE_COST for s in self.sources)
        return sums + len(self.along) + len(self.taps) + images

    def reach(self, number: int) -> int:
        """How many rows above and below a cell are read of a source."""
        read = [*self.taps, *(tap for partial in self.partials for tap in partial.taps)]
        return max((abs(tap.dy) for tap in read if tap.read == number), default=0)


class Staircase(NamedTuple):
    """`scale` times a Gaussian, at distance |dx| cut to |dy| <= heights[|dx|]; -1 for none."""

    source: Source
    scale: float
    heights: tuple[int, ...]


def fuse(kernels: dict[int, FloatKernel], gaussians: Sequence[FloatKernel]) -> FusedPlan:
    """The cheapest plan found for these kernels, given as to `plan`."""
    profiles = [gaussian[gaussian.shape[0] // 2] for gaussian in gaussians]
    plans = [_fuse_layout(layout, profiles) for layout in layouts(kernels)]
    return min(plans, key=lambda one: one.cost)


def _fuse_layout(layout: Layout, profiles: list[FloatKernel]) -> FusedPlan:
    """A plan for kernels on the frames that `layout` says."""
    fused = FusedPlan()
    stairs: dict[int, list[Staircase]] = defaultdict(list)
    loose: dict[tuple[Source, int, int], float] = {}
    for source, kernel in layout.items():
        cleaned = without_rounding(kernel)
        if not cleaned.any():
            continue
        fits = [_fit(cleaned, profile, source) for profile in profiles]
        costs = [_stairs_cost(*fit) for fit in fits]
        number = costs.index(min(costs))
        found, rest = fits[number]
        ranks = low_rank_factors(cleaned)
        by_taps, by_ranks = int(np.count_nonzero(cleaned)), 2 * len(ranks) * len(cleaned)
        if found is not None and costs[number] < min(by_taps, by_ranks):
            stairs[number].append(found)
            cleaned = rest
        elif by_ranks < by_taps:
            _add_factors(fused, source, ranks)
            continue
        radius = len(cleaned) // 2
        for y, x in zip(*np.nonzero(cleaned), strict=True):
            loose[source, int(y) - radius, int(x) - radius] = float(cleaned[y, x])
    for number, members in stairs.items():
        _add_stairs(fused, members, profiles[number])
    for (source, dy, dx), weight in _merged(loose).items():
        fused.taps.append(Tap(fused.number(source), dy, dx, weight))
    return fused


def _stairs_cost(stairs: Staircase | None, rest: FloatKernel) -> float:
    """Loads per pixel of a staircase and the taps beside it."""
    if stairs is None:
        return math.inf
    columns = 2 * max(stairs.heights) + 1
    rows = 2 * (sum(height >= 0 for height in stairs.heights)) - 1
    return columns + rows + int(np.count_nonzero(rest))


def _fit(
    kernel: FloatKernel, profile: FloatKernel, source: Source
) -> tuple[Staircase | None, FloatKernel]:
    """The staircase of a Gaussian inside `kernel`, and what it leaves; None if there is none."""
    radius = len(kernel) // 2
    gaussian = np.outer(profile, profile) / profile[radius]
    scale = _scale(kernel, gaussian)
    if scale is None:
        return None, kernel
    peak = np.abs(kernel).max()
    used = (kernel != 0.0) & (gaussian > NEGLIGIBLE * gaussian.max())
    fitting = used & (np.abs(kernel - scale * gaussian) <= 1e-9 * peak)
    heights = [-1] * (radius + 1)
    for distance in range(radius, -1, -1):
        outer = heights[distance + 1] if distance < radius else -1
        rows = np.flatnonzero(fitting[radius:, radius + distance])
        heights[distance] = max(outer, int(rows[-1]) if rows.size else -1)
    if heights[0] < 0:
        return None, kernel
    away = np.abs(np.arange(len(kernel)) - radius)
    inside = away[:, None] <= np.array(heights)[away]
    rest = kernel - np.where(inside, scale * gaussian, 0.0)
    rest[np.abs(rest) <= 1e-12 * peak] = 0.0
    return Staircase(source, scale, tuple(heights)), rest


def _add_stairs(fused: FusedPlan, members: list[Staircase], profile: FloatKernel) -> None:
    """Partial sums shared by staircases of one Gaussian, and the sum along the row."""
    radius = len(profile) // 2
    reached = [-1] * len(members)
    onto = -1
    for distance in range(radius, -1, -1):
        heights = [member.heights[distance] for member in members]
        if max(heights) < 0:
            continue
        if heights != reached:
            taps = [
                Tap(fused.number(member.source), dy, 0, member.scale * float(profile[radius + dy]))
                for member, low, high in zip(members, reached, heights, strict=True)
                for dy in range(-high, high + 1)
                if abs(dy) > low
            ]
            fused.partials.append(Partial(onto, taps))
            onto, reached = len(fused.partials) - 1, heights
        weight = float(profile[radius + distance] / profile[radius])
        fused.along += [Tap(onto, 0, dx, weight) for dx in sorted({-distance, distance})]


def _add_factors(
    fused: FusedPlan, source: Source, ranks: list[tuple[FloatKernel, FloatKernel]]
) -> None:
    """Partial sums and sums along the row for a sum of separable kernels."""
    for column, row in ranks:
        radius = len(column) // 2
        number = fused.number(source)
        taps = [Tap(number, y - radius, 0, float(w)) for y, w in enumerate(column) if w]
        fused.partials.append(Partial(-1, taps))
        place = len(fused.partials) - 1
        fused.along += [Tap(place, 0, x - radius, float(w)) for x, w in enumerate(row) if w]


def _merged(
    loose: dict[tuple[Source, int, int], float],
) -> dict[tuple[Source, int, int], float]:
    """The same taps, with P(d) - P(d+1) and P(d+1) of one weight made into P(d)."""
    merged = dict(loose)
    for (source, dy, dx), weight in loose.items():
        older = (Source(source.delay + 1, False), dy, dx)
        if source.difference and np.isclose(loose.get(older, np.nan), weight, rtol=1e-9):
            del merged[source, dy, dx], merged[older]
            newer = (Source(source.delay, False), dy, dx)
            merged[newer] = merged.get(newer, 0.0) + weight
    return merged
