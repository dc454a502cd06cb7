"""The summation and the grouping layer, by OpenCV's filters on tiles that fit into the cache.

Everything outside the frame is zero. `cv2.filter2D` computes a correlation, which is the same as a
convolution for the model's symmetric kernels.
"""

import math
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from dlgmd_cli.models.base import Flags, FloatImage, Grey, first_moments
from dlgmd_cli.models.kernels import Connections, FloatKernel
from dlgmd_cli.models.plan import Filter, Source, plan
from dlgmd_cli.models.receptors import Pathway, aligned

# Three float32 images of this size fit into a cache of 2 MB.
TILE_HW = (270, 480)
# The 4 x 4 window of the grouping layer extends this far up and left, and down and right.
BEFORE, AFTER = 1, 2
_BORDER = cv2.BORDER_CONSTANT

Slices = tuple[slice, slice]


class Grouping(NamedTuple):
    """Gain k, threshold T_de and saturation of the grouping layer, Eqs. (9) and (10)."""

    gain: float
    t_de: float
    cap: float


class Sums(NamedTuple):
    """ΣS and ΣG of a frame, and the `first_moments` of G."""

    s: float
    g: float
    moments: tuple[float, float]


class Tile(NamedTuple):
    """A tile of the image.

    `target` is the tile in the image, `window` the tile with the surroundings that it depends on,
    and `core` the tile within `window`.
    """

    window: Slices
    target: Slices
    core: Slices

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of `window`."""
        rows, columns = self.window
        return rows.stop - rows.start, columns.stop - columns.start


class SummationAndGrouping:
    """S and G for one set of connections and frames of one size, (H, W), whose P is in `unit`."""

    def __init__(self, connections: Connections, shape: tuple[int, ...], unit: float) -> None:
        kernels = {delay: kernel * unit for delay, kernel in connections.signed().items()}
        self.filters = plan(kernels, connections.gaussians)
        self.tiles = tiles(shape, connections.radius_px)
        largest = max(height * width for height, width in (tile.shape for tile in self.tiles))
        self.memory = [aligned((largest,)) for _ in range(3)]

    def respond(
        self,
        p: Pathway,
        hidden: Flags | None,
        grouping: Grouping | None,
        s_out: FloatImage | None = None,
        g_out: FloatImage | None = None,
    ) -> Sums:
        """The sums of the newest frame, in luminance; S and G are written to the images, (H, W).

        S(t) = max(Σ_d P(t-d) ∗ K_d, 0), Eqs. (2), (3), (6), (7)
        G(t) = S · Ce where S · Ce ≥ T_de, saturated, Eqs. (8) to (10); without a `grouping`, G is
               not computed and its sums are 0

        S is 0 where `hidden`, (H, W), is True.
        """
        s_sum = g_sum = m_x = m_y = 0.0
        for tile in self.tiles:
            height, width = tile.shape
            s, part, g = (m[: height * width].reshape(height, width) for m in self.memory)
            sum_up(self.filters, p, tile.window, s, part, spare=g)
            cv2.threshold(s, 0.0, 0.0, cv2.THRESH_TOZERO, dst=s)
            if hidden is not None:
                s[hidden[tile.window]] = 0.0
            s_sum += cv2.sumElems(s[tile.core])[0]
            if s_out is not None:
                s_out[tile.target] = s[tile.core]
            if grouping is None:
                continue
            sum_4x4(s, out=part)
            group(s[tile.core], part[tile.core], grouping, g[tile.core])
            g_of_tile = cv2.sumElems(g[tile.core])[0]
            if g_of_tile > 0.0:
                (dx, dy), (down, right) = first_moments(g[tile.core]), tile.target
                m_x += dx + right.start * g_of_tile
                m_y += dy + down.start * g_of_tile
            g_sum += g_of_tile
            if g_out is not None:
                g_out[tile.target] = g[tile.core]
        return Sums(s_sum, g_sum, (m_x, m_y))


def sum_up(
    filters: dict[Source, list[Filter]],
    p: Pathway,
    window: Slices,
    out: FloatImage,
    part: FloatImage,
    spare: FloatImage,
) -> None:
    """Write the sum of all filters of a window of P to `out`; overwrites `part` and `spare`.

    The sum is valid where the kernels do not extend beyond the window.
    """
    is_first = True
    for source, of_source in filters.items():
        image = floats(p, source, window, spare)
        for kernels in of_source:
            apply(kernels, image, out=out if is_first else part)
            if not is_first:
                np.add(out, part, out=out)
            is_first = False
    if is_first:  # without any filters
        out[:] = 0.0


class Convolution:
    """Σ_d P(t-d) ∗ K_d of whole frames, by the fewest filters; P is in luminance.

    Parameters
    ----------
    kernels : dict of int to ndarray
        Delay d in frames -> K_d, (2r + 1, 2r + 1); delay 0 is required.
    gaussians : tuple of ndarray
        See `Connections`.
    shape : (int, int)
        H and W of the frames.
    """

    def __init__(
        self,
        kernels: dict[int, FloatKernel],
        gaussians: tuple[FloatKernel, ...],
        shape: tuple[int, ...],
    ) -> None:
        self.filters = plan(kernels, gaussians)
        self.memory = aligned(shape), aligned(shape)

    def of(self, p: Pathway) -> FloatImage:
        """The sum at the newest frame, (H, W), newly allocated."""
        part, spare = self.memory
        out = aligned(part.shape)
        sum_up(self.filters, p, (slice(None), slice(None)), out, part, spare)
        return out


def apply(kernels: Filter, image: FloatImage, out: FloatImage) -> None:
    """Filter `image` into `out`, both (H, W)."""
    if len(kernels) == 2:
        column, row = kernels
        cv2.sepFilter2D(image, -1, row, column, dst=out, borderType=_BORDER)
    else:
        cv2.filter2D(image, -1, kernels[0], dst=out, borderType=_BORDER)


def sum_4x4(image: FloatImage, out: FloatImage) -> None:
    """Sum over rows and columns -1 … +2 about each cell, [Zhao2023] Eq. (9) without its gain."""
    # For a 4x4 window, OpenCV's default anchor is (2, 2), the released code's anchor is (1, 1).
    cv2.boxFilter(image, -1, (4, 4), dst=out, anchor=(1, 1), normalize=False, borderType=_BORDER)


def tiles(shape: tuple[int, ...], radius: int) -> list[Tile]:
    """Tiles of nearly equal size that cover an image of `shape`, (H, W)."""
    rows, columns = (
        [_surround(start, stop, side, radius) for start, stop in _spans(side, limit)]
        for side, limit in zip(shape, TILE_HW, strict=True)
    )
    return [Tile(*zip(row, column, strict=True)) for row in rows for column in columns]


def _spans(side: int, limit: int) -> list[tuple[int, int]]:
    """Split `side` into the fewest nearly equal parts of at most `limit`."""
    count = -(-side // limit)
    return list(pairwise(side * i // count for i in range(count + 1)))


def _surround(start: int, stop: int, side: int, radius: int) -> tuple[slice, slice, slice]:
    """The slices of a `Tile` along one side, for the cells from `start` up to `stop`."""
    begin, end = max(0, start - BEFORE - radius), min(side, stop + AFTER + radius)
    return slice(begin, end), slice(start, stop), slice(start - begin, stop - begin)


def floats(p: Pathway, source: Source, window: Slices, spare: FloatImage) -> Grey:
    """The window of a source as float32: a view of P, or `spare`, filled."""
    newer = p(source.delay)[window]
    if source.difference:
        older = p(source.delay + 1)[window]
        cv2.subtract(newer, older, dst=spare, dtype=cv2.CV_32F)
    elif newer.dtype == np.float32:
        return newer
    else:
        np.copyto(spare, newer)
    return spare


def group(s: FloatImage, around: FloatImage, grouping: Grouping, g: FloatImage) -> None:
    """G = S · Ce where S · Ce ≥ T_de, saturated, Eqs. (8) to (10)."""
    cv2.multiply(s, around, dst=g, scale=grouping.gain)
    if grouping.t_de > 0.0:
        cv2.threshold(g, just_below(grouping.t_de), 0.0, cv2.THRESH_TOZERO, dst=g)
    if np.isfinite(grouping.cap):
        cv2.threshold(g, grouping.cap, 0.0, cv2.THRESH_TRUNC, dst=g)


def just_below(threshold: float) -> float:
    """The largest float32 b below `threshold`: for a float32 x, x > b means x ≥ `threshold`."""
    nearest = np.float32(threshold)
    if float(nearest) >= threshold:  # as float64: NumPy would round the threshold first
        nearest = np.nextafter(nearest, np.float32(-math.inf))
    return float(nearest)


def grouped(s: FloatImage, grouping: Grouping) -> FloatImage:
    """G of a whole frame's S, (H, W), newly allocated; see `group`."""
    around, g = aligned(s.shape), aligned(s.shape)
    sum_4x4(s, out=around)
    group(s, around, grouping, g)
    return g
