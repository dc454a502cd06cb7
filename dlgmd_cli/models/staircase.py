"""How to add up the kernels of all delays in one pass, for a compiled loop.

A disc cut out of a Gaussian is a staircase: at each column its taps reach a certain height, and
the heights do not grow with the distance from the middle. A Gaussian being separable, such a
kernel needs one weighted sum up the column, continued step by step (the partial sums), and one
along the row, which takes at each distance the partial sum that reaches as high as the kernel
does there. Discs cut out of the same Gaussian, on different frames, share both.
"""

import math
from collections import defaultdict
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from dlgmd_cli.models.kernels import FloatKernel
from dlgmd_cli.models.plan import NEGLIGIBLE, Layout, layouts, low_rank_factors, without_rounding

# What it costs to convert one more image of P, or a difference of two, in loads per pixel.
IMAGE_COST, DIFFERENCE_COST = 4.0, 5.0


class Source(NamedTuple):
    """P(t - delay), or P(t - delay) - P(t - delay - 1)."""

    delay: int
    difference: bool


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


@dataclass(frozen=True)
class Staircase:
    """`scale` times a Gaussian, at distance |dx| cut to |dy| <= heights[|dx|]; -1 for none."""

    source: Source
    scale: float
    heights: tuple[int, ...]


def fuse(kernels: dict[int, FloatKernel], gaussians: list[FloatKernel]) -> FusedPlan:
    """The cheapest plan found for these kernels.

    Parameters
    ----------
    kernels, gaussians
        As `plan.plan` takes them.
    """
    profiles = [gaussian[gaussian.shape[0] // 2] for gaussian in gaussians]
    plans = [_plan_layout(layout, profiles) for layout in layouts(kernels)]
    return min(plans, key=lambda one: one.cost)


def _plan_layout(layout: Layout, profiles: list[FloatKernel]) -> FusedPlan:
    """A plan for kernels on the frames that `layout` says."""
    plan = FusedPlan()
    stairs: dict[int, list[Staircase]] = defaultdict(list)
    loose: dict[tuple[Source, int, int], float] = {}
    for place, kernel in layout.items():
        source, cleaned = Source(*place), without_rounding(kernel)
        if not cleaned.any():
            continue
        fits = [_fit(cleaned, profile, source) for profile in profiles]
        costs = [_cost(*fit) for fit in fits]
        number = costs.index(min(costs))
        found, rest = fits[number]
        ranks = low_rank_factors(cleaned)
        by_taps, by_ranks = int(np.count_nonzero(cleaned)), 2 * len(ranks) * len(cleaned)
        if found is not None and costs[number] < min(by_taps, by_ranks):
            stairs[number].append(found)
            cleaned = rest
        elif by_ranks < by_taps:
            _add_factors(plan, source, ranks)
            continue
        radius = len(cleaned) // 2
        for y, x in zip(*np.nonzero(cleaned), strict=True):
            loose[source, int(y) - radius, int(x) - radius] = float(cleaned[y, x])
    for number, members in stairs.items():
        _add_stairs(plan, members, profiles[number])
    for (source, dy, dx), weight in _merged(loose).items():
        plan.taps.append(Tap(plan.number(source), dy, dx, weight))
    return plan


def _cost(stairs: Staircase | None, rest: FloatKernel) -> float:
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
    used = (kernel != 0.0) & (gaussian > NEGLIGIBLE * gaussian.max())
    if not used.any():
        return None, kernel
    scale = float(np.median(kernel[used] / gaussian[used]))
    peak = np.abs(kernel).max()
    fitting = used & (np.abs(kernel - scale * gaussian) <= 1e-9 * peak)
    heights = [-1] * (radius + 1)
    for distance in range(radius, -1, -1):
        outer = heights[distance + 1] if distance < radius else -1
        rows = np.flatnonzero(fitting[radius:, radius + distance])
        heights[distance] = max(outer, int(rows[-1]) if rows.size else -1)
    if heights[0] < 0 or abs(scale) * gaussian.max() > 2.0 * peak:
        return None, kernel
    stairs = np.zeros_like(kernel)
    for distance, height in enumerate(heights):
        inside = slice(radius - height, radius + height + 1)
        for column in (radius - distance, radius + distance):
            if height >= 0:
                stairs[inside, column] = scale * gaussian[inside, column]
    rest = kernel - stairs
    rest[np.abs(rest) <= 1e-12 * peak] = 0.0
    return Staircase(source, scale, tuple(heights)), rest


def _add_stairs(plan: FusedPlan, members: list[Staircase], profile: FloatKernel) -> None:
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
                Tap(plan.number(member.source), dy, 0, member.scale * float(profile[radius + dy]))
                for member, low, high in zip(members, reached, heights, strict=True)
                for dy in range(-high, high + 1)
                if abs(dy) > low
            ]
            plan.partials.append(Partial(onto, taps))
            onto, reached = len(plan.partials) - 1, heights
        weight = float(profile[radius + distance] / profile[radius])
        plan.along += [Tap(onto, 0, dx, weight) for dx in sorted({-distance, distance})]


def _add_factors(
    plan: FusedPlan, source: Source, ranks: list[tuple[FloatKernel, FloatKernel]]
) -> None:
    """Partial sums and sums along the row for a sum of separable kernels."""
    for column, row in ranks:
        radius = len(column) // 2
        number = plan.number(source)
        taps = [Tap(number, y - radius, 0, float(w)) for y, w in enumerate(column) if w]
        plan.partials.append(Partial(-1, taps))
        place = len(plan.partials) - 1
        plan.along += [Tap(place, 0, x - radius, float(w)) for x, w in enumerate(row) if w]


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
