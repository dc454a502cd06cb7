"""The fewest sums along columns and rows that amount to the kernels of all delays.

A disc cut from a Gaussian is a staircase: each column of taps has a certain height, which does not
grow with the distance from the middle. Such a kernel needs one weighted sum along the column,
extended step by step, and one along the row. At each distance, the row sum uses the column sum of
the height there. Discs from the same Gaussian, on different frames, share both.
"""

from collections import defaultdict
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from dlgmd_cli.models.kernels import FloatKernel
from dlgmd_cli.models.plan import NEGLIGIBLE, Layout, Source, layouts, scale_of, without_rounding


class Tap(NamedTuple):
    """A weight for a source or an earlier sum (by index), at an offset in rows and columns."""

    read: Source | int
    dy: int
    dx: int
    weight: float


Sum = list[Tap]


def fuse(
    kernels: dict[int, FloatKernel],
    gaussians: Sequence[FloatKernel],
    cost: Callable[[list[Sum]], float],
) -> list[Sum]:
    """The sums of least `cost` found for kernels and gaussians as in `plan`.

    The last sum is Σ_d kernels[d] ∗ P(t - d). The sums before run along the columns; each may
    include an earlier sum.
    """
    profiles = [gaussian[len(gaussian) // 2] for gaussian in gaussians]
    plans = [_fuse_layout(layout, profiles) for layout in layouts(kernels)]
    return min(plans, key=cost)


def _fuse_layout(layout: Layout, profiles: list[FloatKernel]) -> list[Sum]:
    """Sums for the kernels of a layout: staircases and single taps."""
    sums: list[Sum] = []
    along: Sum = []
    stairs: dict[int, list[Staircase]] = defaultdict(list)
    for source, whole in layout.items():
        kernel = without_rounding(whole, np.abs(whole).max())
        radius = len(kernel) // 2
        fits = [_fit(kernel, profile, source) for profile in profiles]
        number = min(range(len(fits)), key=lambda i: fits[i][0], default=None)
        if number is not None and fits[number][0] < np.count_nonzero(kernel):
            stairs[number].append(fits[number][1])
            kernel = fits[number][2]
        along += [Tap(source, y - radius, x - radius, kernel[y, x]) for y, x in np.argwhere(kernel)]
    for number, members in stairs.items():
        _add_stairs(sums, along, members, profiles[number])
    return [*sums, along]


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
    scale = scale_of(kernel, gaussian) or 0.0
    used = (kernel != 0.0) & (gaussian > NEGLIGIBLE * gaussian.max())
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
            sums.append(begin + further)
            reached = heights
        if max(reached) >= 0:
            weight = profile[radius + distance] / profile[radius]
            along += [Tap(len(sums) - 1, 0, dx, weight) for dx in sorted({-distance, distance})]
