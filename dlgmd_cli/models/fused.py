"""The compiled engine: one pass over memory for all sums of a frame."""

import math
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from pickle import UnpicklingError

import numpy as np
import numpy.typing as npt
from numba.core.event import Event, Listener, install_listener

from dlgmd_cli.models import compiled
from dlgmd_cli.models.engines import Grouped, Grouping, Wiring, just_below
from dlgmd_cli.models.history import History, aligned
from dlgmd_cli.models.staircase import FusedPlan, Tap, fuse
from dlgmd_cli.threads import n_threads

MAX_STRIP_PX = 512
# So many numbers of one image are worked on at a time; a few such blocks stay in a cache of 2 MB.
BLOCK = 1 << 14
MIN_ROWS, MAX_ROWS = 8, 64
# Bands of rows go to threads of their own, if they are worth the trouble.
MAX_BANDS, MIN_BAND_PX = 4, 500_000
_LANES = 16
_NOWHERE = np.empty((0, 0), np.float32)
# The loops group in the same pass as they sum; leaving that out would save nothing.
_UNGROUPED = Grouping(1.0, 0.0, 1.0)


class FusedEngine:
    """S and G by compiled loops, see `staircase` for the sums and `Engine` for the meaning."""

    def __init__(self, wiring: Wiring, history: History, tell: Callable[[str], None]) -> None:
        self._tell = tell
        plan = fuse(wiring.kernels, wiring.gaussians)
        radius = wiring.gaussians[0].shape[0] // 2
        height, width = history.stack.shape[1:]
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
        self._plan = _places(plan, radius, n_rows, stride, history.unit)
        depth, block = 2 * radius + n_rows, n_rows * stride
        sizes = (
            n_strips * len(plan.sources) * depth * stride,
            max(1, len(plan.partials)) * block,
            block,
            n_strips * (block + 3 * stride),
            block,
        )
        self._memory = [tuple(_zeros(size) for size in sizes) for _ in range(n_bands)]
        self._compute = compiled.respond
        self._is_ready = False
        self._pool = ThreadPoolExecutor(max(1, n_bands - 1), "dlgmd-band")

    def respond(
        self, history: History, grouping: Grouping | None, layers: Grouped | None = None
    ) -> tuple[float, float]:
        """ΣS and ΣG of the newest frame; bands of rows are worked on at the same time."""
        newer = np.array([history.position(s.delay) for s in self._sources], np.int64)
        older = [history.position(s.delay + 1) if s.difference else -1 for s in self._sources]
        given = (history.stack, newer, np.array(older, np.int64), self._reach, self._plan)
        rest = (self._edges, _floats32(grouping or _UNGROUPED), *(layers or (_NOWHERE, _NOWHERE)))

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
        g_sum = sum(g for _, g in answers) if grouping else math.nan
        return sum(s for s, _ in answers), g_sum

    def _first(self, work: Callable[[int], tuple[float, float]]) -> tuple[float, float]:
        """Work on the first band, for which the loops are compiled or loaded."""
        with install_listener("numba:compile", Announcement(self._tell)):
            try:
                return work(0)
            except (OSError, EOFError, UnpicklingError):  # a full disk, a cache file cut off
                self._compute = compiled.without_cache()
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
