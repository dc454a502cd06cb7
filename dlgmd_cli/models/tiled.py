"""The default engine: OpenCV's filters, on tiles that stay in the processor's cache."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby, pairwise

import cv2
import numpy as np

from dlgmd_cli.models.base import FloatImage, Grey
from dlgmd_cli.models.engines import Grouped, Grouping, Wiring, just_below
from dlgmd_cli.models.filters import sum_4x4
from dlgmd_cli.models.history import History, aligned
from dlgmd_cli.models.plan import Term, plan

# Three float32 images of this size stay in a cache of 2 MB.
TILE_HW = (270, 480)
# The 4 x 4 window of the grouping layer looks this far up and left, and down and right.
BEFORE, AFTER = 1, 2

Window = tuple[slice, slice]


@dataclass(frozen=True)
class Tile:
    """A part of the image, and what lies around it that its answer depends on.

    Attributes
    ----------
    window : (slice, slice)
        The tile and its surroundings, in the image.
    target : (slice, slice)
        The tile itself, in the image.
    core : (slice, slice)
        The tile itself, in `window`.
    grouped : (slice, slice)
        The tile and what its grouping looks at, in `window`.
    core_in_grouped : (slice, slice)
        The tile itself, in `grouped`.
    """

    window: Window
    target: Window
    core: Window
    grouped: Window
    core_in_grouped: Window

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of `window`."""
        rows, columns = self.window
        return rows.stop - rows.start, columns.stop - columns.start


class TiledEngine:
    """S and G by OpenCV, see `plan` for the filters and `Engine` for the meaning."""

    def __init__(self, wiring: Wiring, history: History, tell: Callable[[str], None]) -> None:
        scaled = {delay: kernel * history.unit for delay, kernel in wiring.kernels.items()}
        terms = sorted(plan(scaled, wiring.gaussians), key=_image_of)
        self._groups = [
            (image, [t.filter for t in group]) for image, group in groupby(terms, _image_of)
        ]
        radius = wiring.gaussians[0].shape[0] // 2
        shape = history.stack.shape[1:]
        self._tiles = tiles((shape[0], shape[1]), radius)
        largest = max(height * width for height, width in (tile.shape for tile in self._tiles))
        self._memory = [aligned((largest,)) for _ in range(3)]

    def respond(
        self, history: History, grouping: Grouping | None, layers: Grouped | None = None
    ) -> tuple[float, float]:
        """ΣS and ΣG of the newest frame, tile by tile."""
        s_sum, g_sum = 0.0, 0.0 if grouping else math.nan
        for tile in self._tiles:
            s, part, spare = (self._image(place, tile.shape) for place in range(3))
            self._summate(history, tile, s, part, spare)
            s_sum += cv2.sumElems(s[tile.core])[0]
            if grouping is None:
                continue
            around = part[tile.grouped]
            sum_4x4(s[tile.grouped], out=around)
            g = spare[tile.core]
            _group(s[tile.core], around[tile.core_in_grouped], grouping, g)
            g_sum += cv2.sumElems(g)[0]
            if layers is not None:
                layers.s[tile.target], layers.g[tile.target] = s[tile.core], g
        return s_sum, g_sum

    def _image(self, place: int, shape: tuple[int, int]) -> FloatImage:
        """Memory for an image, the same one for every tile."""
        return self._memory[place][: shape[0] * shape[1]].reshape(shape)

    def _summate(
        self, history: History, tile: Tile, s: FloatImage, part: FloatImage, spare: FloatImage
    ) -> None:
        """S on the window of a tile, right where nothing outside the window is missing."""
        is_first = True
        for (delay, difference), filters in self._groups:
            image = _floats(history, delay, difference, tile.window, spare)
            for one in filters:
                one.apply(image, out=s if is_first else part)
                if not is_first:
                    np.add(s, part, out=s)
                is_first = False
        if is_first:
            s[:] = 0.0
        cv2.threshold(s, 0.0, 0.0, cv2.THRESH_TOZERO, dst=s)


def tiles(shape: tuple[int, int], radius: int) -> list[Tile]:
    """Tiles of nearly the same size that cover an image of `shape`, (H, W)."""
    rows, columns = (_spans(side, limit) for side, limit in zip(shape, TILE_HW, strict=True))
    return [
        _tile((top, left), (bottom, right), shape, radius)
        for top, bottom in rows
        for left, right in columns
    ]


def _spans(side: int, limit: int) -> list[tuple[int, int]]:
    """Cut `side` into the fewest parts of at most `limit`, nearly alike."""
    count = -(-side // limit)
    edges = [side * i // count for i in range(count + 1)]
    return list(pairwise(edges))


def _tile(
    first: tuple[int, int], last: tuple[int, int], shape: tuple[int, int], radius: int
) -> Tile:
    """The tile from pixel `first` up to `last`, (y, x) each."""
    parts = []
    for start, stop, side in zip(first, last, shape, strict=True):
        grouped_start, grouped_stop = max(0, start - BEFORE), min(side, stop + AFTER)
        begin, end = max(0, grouped_start - radius), min(side, grouped_stop + radius)
        parts.append(
            (
                slice(begin, end),
                slice(start, stop),
                slice(start - begin, stop - begin),
                slice(grouped_start - begin, grouped_stop - begin),
                slice(start - grouped_start, stop - grouped_start),
            )
        )
    return Tile(*zip(*parts, strict=True))


def _image_of(term: Term) -> tuple[int, bool]:
    """What a term reads."""
    return term.delay, term.difference


def _floats(
    history: History, delay: int, difference: bool, window: Window, spare: FloatImage
) -> Grey:
    """P(t - delay) in a window as float32, less P(t - delay - 1) if asked; maybe in `spare`."""
    newer = history[delay][window]
    if difference:
        cv2.subtract(newer, history[delay + 1][window], dst=spare, dtype=cv2.CV_32F)
    elif newer.dtype == np.float32:
        return newer
    else:
        np.copyto(spare, newer)
    return spare


def _group(s: FloatImage, around: FloatImage, grouping: Grouping, g: FloatImage) -> None:
    """G = S · Ce where it reaches T_de, saturated, Eqs. (8) to (10)."""
    cv2.multiply(s, around, dst=g, scale=grouping.gain)
    if grouping.t_de > 0.0:
        cv2.threshold(g, just_below(grouping.t_de), 0.0, cv2.THRESH_TOZERO, dst=g)
    if np.isfinite(grouping.cap):
        cv2.threshold(g, grouping.cap, 0.0, cv2.THRESH_TRUNC, dst=g)
