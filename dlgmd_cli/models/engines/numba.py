"""The compiled engine: loops by Numba that do all sums of a frame in one pass over memory.

Every sum of taps runs over a whole block of rows as if it were one long row: the columns between
the blocks' rows hold zeros, and what is computed there is not used. So the compiler sees nothing
but long loops over neighbouring numbers, which it turns into vector instructions.

All loops stand in one module because Numba's cache on disk notices changes of this file only.
"""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from pickle import UnpicklingError
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.core.event import Event, Listener, install_listener

from dlgmd_cli.models.base import FloatImage, Photoreceptors, aligned
from dlgmd_cli.models.engines import Grouping, just_below
from dlgmd_cli.models.engines.plan import FusedPlan, Tap, fuse
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.threads import n_threads

MAX_STRIP_PX = 512
# So many numbers of one image are worked on at a time; a few such blocks stay in a cache of 2 MB.
BLOCK = 1 << 14
MIN_ROWS, MAX_ROWS = 8, 64
# Bands of rows go to threads of their own, if they are worth the trouble.
MAX_BANDS, MIN_BAND_PX = 4, 500_000
_LANES = 16
_NOWHERE = np.empty((0, 0), np.float32)

# Sums may be rearranged into the lanes of a vector; nothing else is taken lightly.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}

_SUM = """
def unrolled(out, start, {base_arguments}image, n, places, weights, first):
    {fetch}
    for i in range(n):
        x = np.uint64(i)
        out[start + x] {operator} {total}
"""


def _unrolled(count: int, *, adds: bool) -> Callable[..., None]:
    """A sum of `count` taps, added to what is there or to a base that lies elsewhere.

    It is written out for each count because only so one pass over memory takes many taps: the
    compiler does not merge loops. Unsigned places spare it Python's negative indices.
    """
    source = _SUM.format(
        base_arguments="" if adds else "base, base_start, ",
        fetch="; ".join(
            f"p{k} = places[first + {k}]; w{k} = weights[first + {k}]" for k in range(count)
        ),
        operator="+=" if adds else "= base[base_start + x] +",
        total=" + ".join(f"w{k} * image[p{k} + x]" for k in range(count)),
    )
    names: dict[str, Any] = {"np": np}
    exec(source, names)
    return njit(**_OPTIONS)(names["unrolled"])


# 2r + 1 for r = 6, 4 and 2, the usual lengths of a row or column, and what makes up the others.
_add_13, _add_9, _add_5, _add_2, _add_1 = (_unrolled(n, adds=True) for n in (13, 9, 5, 2, 1))
_set_13, _set_9, _set_5, _set_2, _set_1 = (_unrolled(n, adds=False) for n in (13, 9, 5, 2, 1))


@njit(**_OPTIONS)
def _add(out, start, image, n, places, weights, first, last):
    """out[x] += Σ weights · image[places + x], for taps `first` up to `last`."""
    while last - first >= 13:
        _add_13(out, start, image, n, places, weights, first)
        first += 13
    if last - first >= 9:
        _add_9(out, start, image, n, places, weights, first)
        first += 9
    if last - first >= 5:
        _add_5(out, start, image, n, places, weights, first)
        first += 5
    while last - first >= 2:
        _add_2(out, start, image, n, places, weights, first)
        first += 2
    if last - first == 1:
        _add_1(out, start, image, n, places, weights, first)


@njit(**_OPTIONS)
def _sum(out, start, base, base_start, image, n, places, weights, first, last):
    """out[x] = base[x] + Σ weights · image[places + x]; `out` and `base` must not overlap."""
    if last - first >= 13:
        _set_13(out, start, base, base_start, image, n, places, weights, first)
        first += 13
    elif last - first >= 9:
        _set_9(out, start, base, base_start, image, n, places, weights, first)
        first += 9
    elif last - first >= 5:
        _set_5(out, start, base, base_start, image, n, places, weights, first)
        first += 5
    elif last - first >= 2:
        _set_2(out, start, base, base_start, image, n, places, weights, first)
        first += 2
    elif last - first == 1:
        _set_1(out, start, base, base_start, image, n, places, weights, first)
        first += 1
    else:
        for i in range(n):
            x = np.uint64(i)
            out[start + x] = base[base_start + x]
    _add(out, start, image, n, places, weights, first, last)


@njit(**_OPTIONS)
def _read_row(out, start, stack, newer, older, y, left, n):
    """A stretch of a row of one image as float32, less that of another unless `older` is -1."""
    a, b = np.uint64(newer), np.uint64(max(older, 0))
    row, first = np.uint64(y), np.uint64(left)
    if older < 0:
        for i in range(n):
            x = np.uint64(i)
            out[start + x] = np.float32(stack[a, row, first + x])
    else:
        for i in range(n):
            x = np.uint64(i)
            out[start + x] = np.float32(stack[a, row, first + x]) - np.float32(
                stack[b, row, first + x]
            )


@njit(**_OPTIONS)
def _rectify(s, start, n):
    """S = max(S, 0) in place, and its sum."""
    total = np.float32(0.0)
    for i in range(n):
        x = start + np.uint64(i)
        value = np.float32(0.0) if s[x] <= 0.0 else s[x]  # NaN stays
        s[x] = value
        total += value
    return total


@njit(**_OPTIONS)
def _four_rows(out, s, stride, n):
    """Sums over four rows, the first step of the 4 x 4 window."""
    for i in range(n):
        x = np.uint64(i)
        out[x] = (s[x] + s[x + stride]) + (s[x + stride + stride] + s[x + stride + stride + stride])


@njit(**_OPTIONS)
def _group_row(s, at, rows, around, n, gain, below, cap, g, y, left):
    """ΣG of a row, Eqs. (8) to (10), and G itself where `g` has room for it."""
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    total = np.float32(0.0)
    for i in range(n):
        x = np.uint64(i)
        c = around + x
        value = gain * s[at + x] * ((rows[c] + rows[c + one]) + (rows[c + two] + rows[c + three]))
        value = np.float32(0.0) if value <= below else value
        total += cap if value > cap else value
    if g.size:
        for i in range(n):
            c = around + np.uint64(i)
            value = (rows[c] + rows[c + one]) + (rows[c + two] + rows[c + three])
            value *= gain * s[at + np.uint64(i)]
            value = np.float32(0.0) if value <= below else value
            g[y, left + i] = cap if value > cap else value
    return total


@njit(**_OPTIONS)
def _clear_outside(s, start, stride, n_rows, top, height, left, width):
    """S is zero outside the image; column 0 of a block is column `left` of the image."""
    for row in range(n_rows):
        y, at = top + row, start + row * stride
        if y < 0 or y >= height:
            s[at : at + stride] = 0.0
        else:
            if left < 0:
                s[at : at - left] = 0.0
            if left + stride > width:
                s[at + width - left : at + stride] = 0.0


@njit(**_OPTIONS)
def _move_up(image, start, distance, n):
    """Rows that the next block needs again, to where it expects them."""
    for i in range(n):
        x = start + np.uint64(i)
        image[x] = image[x + distance]


@njit(**_OPTIONS)
def _read_block(image, stack, newer, older, reach, edges, shape, top, first_new):
    """The rows of a block that are new, for all strips, in the order of memory."""
    radius, n_rows, stride = shape
    depth = 2 * radius + n_rows
    height, width = stack.shape[1], stack.shape[2]
    for row in range(first_new, depth):
        y = top - radius + row
        for strip in range(edges.size - 1):
            begin = edges[strip] - 1 - radius
            left, right = max(0, begin), min(width, edges[strip + 1] + 2 + radius)
            for q in range(newer.size):
                at = (strip * newer.size + q) * depth * stride + row * stride
                if y < 0 or y >= height:
                    image[at : at + stride] = 0.0
                elif row >= radius - reach[q]:
                    start = np.uint64(at + left - begin)
                    _read_row(image, start, stack, newer[q], older[q], y, left, right - left)


@njit(**_OPTIONS)
def _summate(s, start, image, partial, zero, plan, shape):
    """S before it is rectified, from `start` on: partial sums first, then those along the row."""
    onto, last, up, up_weights, along, along_weights, taps, tap_weights = plan
    radius, n_rows, stride = shape
    n = n_rows * stride
    first = 0
    for k in range(onto.size):
        out, base = np.uint64(k * n), np.uint64(max(onto[k], 0) * n)
        if onto[k] < 0:
            _sum(partial, out, zero, base, image, n, up, up_weights, first, last[k])
        else:
            _sum(partial, out, partial, base, image, n, up, up_weights, first, last[k])
        first = last[k]
    n -= 2 * radius
    none = np.uint64(0)
    _sum(s, start, zero, none, partial, n, along, along_weights, 0, along_weights.size)
    _add(s, start, image, n, taps, tap_weights, 0, tap_weights.size)


@njit(**_OPTIONS)
def _rectify_block(s, n_rows, stride, top, first, end, left, n, s_out):
    """S = max(S, 0) on a block, and its sum over the image's rows `first` up to `end`."""
    s_sum = 0.0
    for row in range(n_rows):
        at, y = (3 + row) * stride, top + row
        total = _rectify(s, np.uint64(at), n + 3)
        if first <= y < end:
            # Column 0 and the last two belong to the neighbours.
            s_sum += total - s[at] - s[at + n + 1] - s[at + n + 2]
            if s_out.size:
                s_out[y, left : left + n] = s[at + 1 : at + 1 + n]
    return s_sum


@njit(**_OPTIONS)
def _group_block(s, rows, n_rows, stride, top, first, end, left, n, grouping, g_out):
    """ΣG over the rows for which S is there, as far as they are from `first` up to `end`."""
    gain, below, cap = grouping
    _four_rows(rows, s, np.uint64(stride), n_rows * stride)
    g_sum = 0.0
    for row in range(max(0, first + 2 - top), min(n_rows, end + 2 - top)):
        at, around = np.uint64((row + 1) * stride + 1), np.uint64(row * stride)
        y = top - 2 + row
        g_sum += _group_row(s, at, rows, around, n, gain, below, cap, g_out, y, left)
    return g_sum


def _cached(function: Callable[..., Any]) -> Any:
    """Compiled on first use, and kept on disk where there is a place to write to."""
    try:
        return njit(cache=True, **_OPTIONS)(function)
    except RuntimeError:  # Numba's word for a read-only home
        return njit(**_OPTIONS)(function)


@_cached
def sum_layers(
    first, end, stack, newer, older, reach, plan, shape, memory, edges, grouping, s_out, g_out
):
    """ΣS and ΣG of the rows `first` up to `end`; `NumbaEngine` prepares every argument.

    The image is cut into strips of columns. A block of rows is read for all strips, and worked on
    strip by strip; what the next block needs again is moved up.
    """
    radius, n_rows, stride = shape
    image, partial, zero, s, rows = memory
    depth, block = 2 * radius + n_rows, n_rows * stride
    size, s_size = newer.size * depth * stride, block + 3 * stride
    s_sum = g_sum = 0.0
    for strip in range(edges.size - 1):
        s[strip * s_size : strip * s_size + 3 * stride] = 0.0
    top, first_new = first - 1, 0
    while top - 2 < end:
        _read_block(image, stack, newer, older, reach, edges, shape, top, first_new)
        for strip in range(edges.size - 1):
            left, n = edges[strip], edges[strip + 1] - edges[strip]
            here = image[strip * size : (strip + 1) * size + stride]
            own = s[strip * s_size : (strip + 1) * s_size]
            _summate(own, np.uint64(3 * stride), here, partial, zero, plan, shape)
            _clear_outside(
                own, 3 * stride, stride, n_rows, top, stack.shape[1], left - 1, stack.shape[2]
            )
            s_sum += _rectify_block(own, n_rows, stride, top, first, end, left, n, s_out)
            g_sum += _group_block(
                own, rows, n_rows, stride, top, first, end, left, n, grouping, g_out
            )
            _move_up(own, np.uint64(0), np.uint64(block), 3 * stride)
            for q in range(newer.size):
                _move_up(here, np.uint64(q * depth * stride), np.uint64(block), 2 * radius * stride)
        top += n_rows
        first_new = 2 * radius
    return s_sum, g_sum


@lru_cache(maxsize=1)
def _without_cache() -> Callable[..., Any]:
    """`sum_layers` compiled anew, for when the cache on disk fails."""
    return njit(**_OPTIONS)(sum_layers.py_func)


class NumbaEngine:
    """S and G by compiled loops, see `fuse` for the sums and `Engine` for the meaning."""

    def __init__(
        self, connections: Connections, receptors: Photoreceptors, tell: Callable[[str], None]
    ) -> None:
        self._tell = tell
        plan = fuse(connections.signed(), connections.gaussians)
        radius = connections.radius_px
        _, height, width = receptors.stack.shape
        n_bands = max(1, min(n_threads(), MAX_BANDS, height * width // MIN_BAND_PX))
        self._bands = [height * i // n_bands for i in range(n_bands + 1)]
        n_strips = -(-width // MAX_STRIP_PX)
        self._edges = np.array([width * i // n_strips for i in range(n_strips + 1)])
        strip = int(np.diff(self._edges).max())
        # S of a strip has a column before it and two behind; sums along the row reach farther.
        stride = -(-(strip + 3 + 2 * radius) // _LANES) * _LANES
        n_rows = _rows_of_a_block(-(-height // n_bands) + 3, stride)
        self._shape = (radius, n_rows, stride)
        self._sources = plan.sources
        self._reach = np.array([plan.reach(q) for q in range(len(plan.sources))], np.int64)
        self._plan = _places(plan, radius, n_rows, stride, receptors.unit)
        depth, block = 2 * radius + n_rows, n_rows * stride
        sizes = (
            n_strips * len(plan.sources) * depth * stride,
            max(1, len(plan.partials)) * block,
            block,
            n_strips * (block + 3 * stride),
            block,
        )
        self._memory = [tuple(_zeros(size) for size in sizes) for _ in range(n_bands)]
        self._compute = sum_layers
        self._is_ready = False
        self._pool = ThreadPoolExecutor(max(1, n_bands - 1), "dlgmd-band")

    def respond(
        self,
        receptors: Photoreceptors,
        grouping: Grouping,
        layers: tuple[FloatImage, FloatImage] | None = None,
    ) -> tuple[float, float]:
        """ΣS and ΣG of the newest frame; bands of rows are worked on at the same time."""
        newer = [receptors.position(s.delay) for s in self._sources]
        older = [receptors.position(s.delay + 1) if s.difference else -1 for s in self._sources]
        places = (np.array(newer, np.int64), np.array(older, np.int64))
        given = (receptors.stack, *places, self._reach, self._plan)
        rest = (self._edges, _floats32(grouping), *(layers or (_NOWHERE, _NOWHERE)))

        def work(band: int) -> tuple[float, float]:
            rows = self._bands[band : band + 2]
            answer: tuple[float, float] = self._compute(
                *rows, *given, self._shape, self._memory[band], *rest
            )
            return answer

        if self._is_ready:
            others = [self._pool.submit(work, band) for band in range(1, len(self._memory))]
            answers = [work(0), *(other.result() for other in others)]
        else:
            # One after the other: a thread that compiles cannot be interrupted.
            answers = [self._first(work), *map(work, range(1, len(self._memory)))]
            self._is_ready = True
        return sum(s for s, _ in answers), sum(g for _, g in answers)

    def _first(self, work: Callable[[int], tuple[float, float]]) -> tuple[float, float]:
        """Work on the first band, for which the loops are compiled or loaded."""
        with install_listener("numba:compile", Announcement(self._tell)):
            try:
                return work(0)
            except (OSError, EOFError, UnpicklingError):  # a full disk, a cache file cut off
                self._compute = _without_cache()
                return work(0)


class Announcement(Listener):
    """Tells of the first compilation that begins; loading compiled code is none."""

    def __init__(self, tell: Callable[[str], None]) -> None:
        self._tell: Callable[[str], None] | None = tell

    def on_start(self, event: Event) -> None:
        """A compilation begins, maybe inside another."""
        if self._tell is not None:
            self._tell("Compiling the numba engine; about ten seconds, the first time.")
            self._tell = None

    def on_end(self, event: Event) -> None:
        """A compilation has ended."""


def _rows_of_a_block(n_rows: int, stride: int) -> int:
    """How many rows to work on at a time, so that the last block is nearly full."""
    largest = min(MAX_ROWS, max(MIN_ROWS, BLOCK // stride))
    n_blocks = -(-n_rows // largest)
    return -(-n_rows // n_blocks)


def _places(
    plan: FusedPlan, radius: int, n_rows: int, stride: int, unit: float
) -> tuple[npt.NDArray, ...]:
    """The plan as arrays: of each tap the place in memory that it reads, and its weight."""
    size, block = (2 * radius + n_rows) * stride, n_rows * stride
    upward = [tap for partial in plan.partials for tap in partial.taps]

    def places(taps: list[Tap], image: int, dy: int, dx: int) -> npt.NDArray[np.uint64]:
        found = [t.read * image + (dy + t.dy) * stride + dx + t.dx for t in taps]
        return np.array(found, np.int64).astype(np.uint64)

    return (
        np.array([partial.onto for partial in plan.partials], np.int64),
        np.cumsum([len(partial.taps) for partial in plan.partials], dtype=np.int64),
        places(upward, size, radius, 0),
        _weights(upward, unit),
        places(plan.along, block, 0, radius),
        _weights(plan.along, 1.0),
        places(plan.taps, size, radius, radius),
        _weights(plan.taps, unit),
    )


def _weights(taps: Iterable[Tap], unit: float) -> npt.NDArray[np.float32]:
    return np.array([tap.weight * unit for tap in taps], np.float32)


def _floats32(grouping: Grouping) -> tuple[np.float32, np.float32, np.float32]:
    """Gain, the largest number below the threshold, and cap."""
    below = just_below(grouping.t_de) if grouping.t_de > 0.0 else -1.0
    return np.float32(grouping.gain), np.float32(below), np.float32(grouping.cap)


def _zeros(size: int) -> npt.NDArray[np.float32]:
    """Zeros on a cache line, with room for what a vector reads beyond the end."""
    memory = aligned((size + 2 * _LANES,))
    memory[:] = 0.0
    return memory
