"""The compiled engine: Numba loops that compute all sums of a few rows while these are in cache.

A block of rows is treated as one long row. The columns between the rows hold zeros, and results
there are not used. The compiler thus sees only long loops over adjacent numbers and vectorises
them. The images, sums and S of a block are contiguous in memory.

All loops are in this module because Numba's cache on disk detects only changes of this file.
"""

import logging
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial
from pickle import UnpicklingError
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit
from numba.core.event import Event, Listener, install_listener

from dlgmd_cli.machine.threads import n_threads
from dlgmd_cli.models.base import Flags, FloatImage
from dlgmd_cli.models.engines import Grouping, Sums, just_below
from dlgmd_cli.models.engines.plan import MAX_TAPS, Sum, fuse, sources_of
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.models.receptors import Pathway, aligned

_log = logging.getLogger(__name__)

MAX_ROWS = 32  # per block
# Each band of rows has its own thread, if it is large enough.
MAX_BANDS, MIN_BAND_PX = 4, 500_000
_LANES = 16
_Loops = Callable[..., tuple[float, ...]]
ONLY_S = 0.0  # as the gain, which a grouping never has, it means that G is not computed
_NOWHERE, _NONE_HIDDEN = np.empty((0, 0), np.float32), np.empty((0, 0), np.bool_)

# Allow reordering of sums for vector instructions, but no other fast-math approximations.
_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "fastmath": {"contract", "reassoc", "nsz"},
}


def _unrolled(most: int) -> Callable[..., None]:
    """A function that computes memory[out + x] = Σ weights · memory[places + x] over `count` taps.

    The code is unrolled for each count up to `most`: the compiler does not merge loops, and one
    pass over memory should handle many taps. Unsigned indices avoid the check for negative ones.
    """
    source = "def total(memory, out, n, places, weights, first, count):\n"
    for count in range(most + 1):
        taps = range(count)
        fetch = [f"p{k} = places[first + {k}]; w{k} = weights[first + {k}]" for k in taps]
        source += f"""
    if count == {count}:
        {"; ".join(fetch) or "pass"}
        for i in range(n):
            x = np.uint64(i)
            memory[out + x] = {" + ".join(f"w{k} * memory[p{k} + x]" for k in taps) or 0.0}
"""
    names: dict[str, Any] = {"np": np}
    exec(source, names)
    return njit(**_OPTIONS)(names["total"])


_total = _unrolled(MAX_TAPS)


@njit(**_OPTIONS)
def _read_row(out, start, p):
    """A row as float32."""
    for i in range(p.size):
        x = np.uint64(i)
        out[start + x] = np.float32(p[x])


@njit(**_OPTIONS)
def _read_difference(out, start, newer, older):
    """A row minus another, as float32."""
    for i in range(newer.size):
        x = np.uint64(i)
        out[start + x] = np.float32(newer[x]) - np.float32(older[x])


@njit(**_OPTIONS)
def _read(memory, stack, newer, older, shape, top, first_new):
    """Read the new rows of a block from every source: P, or the difference of two."""
    radius, n_rows, stride = shape
    depth = 2 * radius + n_rows
    for q in range(newer.size):
        a, b = newer[q], older[q]
        for row in range(first_new, depth):
            y, at = top - radius + row, (q * depth + row) * stride
            if 0 <= y < stack.shape[1]:
                start = np.uint64(at + 1 + radius)
                if b < 0:
                    _read_row(memory, start, stack[a, y])
                else:
                    _read_difference(memory, start, stack[a, y], stack[b, y])
            else:
                memory[at : at + stride] = 0.0


@njit(**_OPTIONS)
def _move_up(image, distance, n):
    """Move the part that the next block reuses to its beginning."""
    for i in range(n):
        x = np.uint64(i)
        image[x] = image[x + distance]


@njit(**_OPTIONS)
def _clear(s, hidden):
    """Set S = 0 in the hidden cells of a row, in place."""
    for x in range(s.size):
        s[x] = np.float32(0.0) if hidden[x] else s[x]


@njit(**_OPTIONS)
def _rectify(s):
    """Set S = max(S, 0) in a row, in place; returns its sum."""
    total = np.float32(0.0)
    for x in range(s.size):
        value = np.float32(0.0) if s[x] <= 0.0 else s[x]  # NaN stays
        s[x] = value
        total += value
    return total


@njit(**_OPTIONS)
def _group(s, stride, four, g, gain, below, cap):
    """Compute G of a row, Eqs. (8) to (10); returns its sum. `s` starts one cell up and left."""
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    down = np.uint64(stride)
    for i in range(four.size):
        x = np.uint64(i)
        four[x] = (s[x] + s[x + down]) + (s[x + two * down] + s[x + three * down])
    total = np.float32(0.0)
    for i in range(g.size):
        x = np.uint64(i)
        around = (four[x] + four[x + one]) + (four[x + two] + four[x + three])
        value = gain * s[x + down + one] * around
        value = np.float32(0.0) if value <= below else value
        value = cap if value > cap else value
        g[x] = value
        total += value
    return total


@njit(**_OPTIONS)
def _moment(g):
    """ΣG · column of a row."""
    total = np.float32(0.0)
    for x in range(g.size):
        total += g[x] * np.float32(x)
    return total


def _sum_layers(
    first, end, stack, newer, older, hidden, plan, shape, memory, row_memory, grouping, s_out, g_out
):
    """ΣS, ΣG and its moments for the rows from `first` up to `end`, block by block.

    `NumbaEngine` prepares all arguments.
    """
    outs, last, places, weights = plan
    radius, n_rows, stride = shape
    gain, below, cap = grouping
    four, g = row_memory
    _, height, width = stack.shape
    block, size = n_rows * stride, (2 * radius + n_rows) * stride
    # S of a block and of the three rows above it.
    s = memory[outs[-1] - 3 * stride : outs[-1] + block]
    s[: 3 * stride] = 0.0
    s_sum = g_sum = m_x = m_y = 0.0
    top, first_new = first - 1, 0
    while top - 2 < end:
        _read(memory, stack, newer, older, shape, top, first_new)
        begin = 0
        for k in range(outs.size):
            _total(memory, np.uint64(outs[k]), block, places, weights, begin, last[k] - begin)
            begin = last[k]
        for row in range(n_rows):
            at, y = (3 + row) * stride, top + row
            if y < 0 or y >= height:
                s[at : at + stride] = 0.0
                continue
            s[at], s[at + 1 + width : at + stride] = 0.0, 0.0
            if hidden.size:
                _clear(s[at + 1 : at + 1 + width], hidden[y])
            total = _rectify(s[at + 1 : at + 1 + width])
            if first <= y < end:
                s_sum += total
                if s_out.size:
                    s_out[y] = s[at + 1 : at + 1 + width]
        for row in range(max(0, first + 2 - top), min(n_rows, end + 2 - top)):
            y = top - 2 + row
            if gain == ONLY_S:
                break
            total = _group(s[row * stride :], stride, four, g, gain, below, cap)
            if total > 0.0:
                g_sum += total
                m_x += _moment(g)
                m_y += total * y
            if g_out.size:
                g_out[y] = g
        _move_up(s, np.uint64(block), 3 * stride)
        for q in range(newer.size):
            _move_up(memory[q * size :], np.uint64(block), 2 * radius * stride)
        top += n_rows
        first_new = 2 * radius
    return s_sum, g_sum, m_x, m_y


@cache
def _compiled(on_disk: bool) -> _Loops:
    """The loops, compiled at the first call or loaded from Numba's cache."""
    return njit(cache=on_disk, **_OPTIONS)(_sum_layers)


class NumbaEngine:
    """Computes S and G by compiled loops; see `Engine`, and `fuse` for the sums."""

    def __init__(self, connections: Connections, shape: tuple[int, int], unit: float) -> None:
        sums = fuse(connections.signed(), connections.gaussians)
        self._sources = sources_of(sums)
        height, width = shape
        n_bands = max(1, min(n_threads(), MAX_BANDS, height * width // MIN_BAND_PX))
        self._bands = [height * i // n_bands for i in range(n_bands + 1)]
        radius = connections.radius_px
        # S has one extra column on the left and two on the right; sums along the row need more.
        stride = -(-(width + 3 + 2 * radius) // _LANES) * _LANES
        # S of a band has three rows more than G. Blocks are sized so that the last is nearly full.
        n_rows = -(-height // n_bands) + 3
        n_rows = -(-n_rows // -(-n_rows // MAX_ROWS))
        self._shape = (radius, n_rows, stride)
        self._plan = _places(sums, *self._shape, unit)
        size = int(self._plan[0][-1]) + n_rows * stride + stride
        self._memory = [(_zeros(size), (_zeros(width + 3), _zeros(width))) for _ in range(n_bands)]
        self._map = ThreadPoolExecutor(n_bands, "dlgmd-band").map if n_bands > 1 else map
        self._compute: _Loops | None = None
        self._announcement = Announcement()

    def respond(
        self,
        p: Pathway,
        hidden: Flags | None,
        grouping: Grouping | None,
        s_out: FloatImage | None = None,
        g_out: FloatImage | None = None,
    ) -> Sums:
        """The sums of the newest frame; bands of rows are computed in parallel."""
        newer = [p.position(s.delay) for s in self._sources]
        older = [p.position(s.delay + 1) if s.difference else -1 for s in self._sources]
        places = (np.array(newer, np.int64), np.array(older, np.int64))
        gain, t_de, cap = (ONLY_S, 0.0, 1.0) if grouping is None else grouping
        below = just_below(t_de) if t_de > 0.0 else -1.0
        constants = np.float32(gain), np.float32(below), np.float32(cap)

        def work(band: int, compute: _Loops) -> tuple[float, ...]:
            return compute(
                *self._bands[band : band + 2],
                p.stack,
                *places,
                _NONE_HIDDEN if hidden is None else hidden,
                self._plan,
                self._shape,
                *self._memory[band],
                constants,
                _NOWHERE if s_out is None else s_out,
                _NOWHERE if g_out is None else g_out,
            )

        if self._compute is None:
            self._compute = self._load(partial(work, 0))
        compute = self._compute
        answers = self._map(lambda band: work(band, compute), range(len(self._memory)))
        s_sum, g_sum, m_x, m_y = np.array(list(answers)).sum(axis=0).tolist()
        return Sums(s_sum, g_sum, (m_x, m_y))

    def _load(self, work: Callable[[_Loops], Any]) -> _Loops:
        """Compile or load the loops, in this thread: others cannot be interrupted meanwhile."""
        with install_listener("numba:compile", self._announcement):
            try:
                work(_compiled(True))
                return _compiled(True)
            # A full disk, a truncated cache file, or a home folder that is not writable
            except (OSError, EOFError, UnpicklingError, RuntimeError):
                work(_compiled(False))
                return _compiled(False)


class Announcement(Listener):
    """Announces the first compilation, but not the loading of compiled code."""

    _is_due = True

    def on_start(self, event: Event) -> None:
        """A compilation begins, perhaps inside another compilation."""
        if self._is_due:
            _log.info("Compiling the numba engine; about ten seconds, the first time.")
            self._is_due = False

    def on_end(self, event: Event) -> None:
        """A compilation has ended."""


def _places(
    sums: list[Sum], radius: int, n_rows: int, stride: int, unit: float
) -> tuple[npt.NDArray, ...]:
    """The memory layout: output position of each sum, its end among the taps, and all taps.

    A tap is a position to read and a weight. First in memory are the images, with `radius` rows and
    columns around a block, then the column sums, then three rows of S of the previous block, and
    last S. S begins one column before the image.
    """
    sources = sources_of(sums)
    size, block = (2 * radius + n_rows) * stride, n_rows * stride
    # Gaps keep reads and writes apart: overlapping loops are not vectorised.
    outs = [len(sources) * size + stride + k * (block + stride) for k in range(len(sums))]
    outs[-1] += 3 * stride
    # Column sums are needed at more columns than sums along the row, which begin where S does.
    begins = [radius if any(tap.dx for tap in taps) else 0 for taps in sums]
    begins[-1] = radius
    places, weights = [], []
    for begin, taps in zip(begins, sums, strict=True):
        for tap in taps:
            if isinstance(tap.read, int):
                start, weight = outs[tap.read] - begins[tap.read], tap.weight
            else:
                start = sources.index(tap.read) * size + (radius + tap.dy) * stride
                weight = tap.weight * unit
            places.append(start + tap.dx + begin)
            weights.append(weight)
    ends = np.cumsum([len(taps) for taps in sums], dtype=np.int64)
    return np.array(outs), ends, np.array(places, np.uint64), np.array(weights, np.float32)


def _zeros(size: int) -> npt.NDArray[np.float32]:
    memory = aligned((size,))
    memory[:] = 0.0
    return memory
