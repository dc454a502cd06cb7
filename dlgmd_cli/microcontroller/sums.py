"""The kernels as C: sums along the columns, then S as the sum along the row."""

from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from dlgmd_cli.microcontroller.staircases import Sum, Tap, fuse
from dlgmd_cli.models.kernels import Connections
from dlgmd_cli.models.plan import Source

N_LEVELS = 255
# Floating point: taps below this share of the largest tap of their sum would be lost in rounding.
_NEGLIGIBLE = 2.0**-22


class Step(NamedTuple):
    """Taps to add to the sum so far; the result is stored in column number `column`."""

    taps: Sum
    column: int


class Code(NamedTuple):
    """The sums, with weights as in the C code.

    Attributes
    ----------
    chains : list of list of Step
        Sums along the columns; each step continues the previous step.
    along : Sum
        The sum S, of columns and of sources.
    """

    chains: list[list[Step]]
    along: Sum

    @property
    def sums(self) -> list[Sum]:
        """All sums, in order."""
        return [*(step.taps for chain in self.chains for step in chain), self.along]

    @property
    def n_columns(self) -> int:
        """Number of columns."""
        return sum(map(len, self.chains))

    @property
    def operations(self) -> tuple[int, int]:
        """Multiplications and additions per cell."""
        groups = [group for taps in self.sums for group in _grouped(taps)]
        return len(groups), sum(len(terms) for _, terms in groups)

    @property
    def margin(self) -> int:
        """Greatest distance in a row at which S reads a source, in cells."""
        return max((abs(int(t.dx)) for t in self.along if isinstance(t.read, Source)), default=0)


def float_code(connections: Connections) -> Code:
    """Sums in single precision; weights of sources convert grey levels to luminance."""
    chains, along = _planned(connections)

    def rounded(taps: Sum) -> Sum:
        least = _NEGLIGIBLE * max((abs(tap.weight) for tap in taps), default=0.0)
        units = [1.0 / N_LEVELS if isinstance(tap.read, Source) else 1.0 for tap in taps]
        return [
            tap._replace(weight=float(np.float32(tap.weight * unit)))
            for tap, unit in zip(taps, units, strict=True)
            if abs(tap.weight) > least
        ]

    chains = [[step._replace(taps=rounded(step.taps)) for step in chain] for chain in chains]
    return Code(chains, rounded(along))


# Arranging sums


def _planned(connections: Connections) -> tuple[list[list[Step]], Sum]:
    """The chains and the sum along the row with the fewest operations."""

    def cost(sums: list[Sum]) -> float:
        return sum(Code(*_arranged(sums)).operations)

    return _arranged(fuse(connections.signed(), connections.gaussians, cost))


def _arranged(sums: list[Sum]) -> tuple[list[list[Step]], Sum]:
    """The same sums in chains: a sum that only the next sum continues is not stored."""
    n_reads = Counter(tap.read for taps in sums for tap in taps if isinstance(tap.read, int))
    last = len(sums) - 1
    along = sums[last]
    while last and _continues(along, last - 1) and n_reads[last - 1] == 1:
        last -= 1
        along = sums[last] + along[1:]
    chains: list[list[Step]] = []
    numbers: dict[int, int] = {}
    pending: Sum = []
    for k, taps in enumerate(sums[:last]):
        if k and _continues(taps, k - 1):
            pending += taps[1:]
        else:
            chains.append([])
            pending += taps
        is_continued = k + 1 < last and _continues(sums[k + 1], k)
        if n_reads[k] > is_continued:
            numbers[k] = len(numbers)
            chains[-1].append(Step(pending, numbers[k]))
            pending = []
    along = [t._replace(read=numbers[t.read]) if isinstance(t.read, int) else t for t in along]
    return chains, along


def _continues(taps: Sum, number: int) -> bool:
    """Whether a sum begins with the earlier sum number `number`."""
    return bool(taps) and taps[0] == Tap(number, 0, 0, 1.0)


def _grouped(taps: Sum) -> list[tuple[float, list[str]]]:
    """The weights, each with its terms; terms that cancel are left out."""
    groups: dict[float, Counter[str]] = defaultdict(Counter)
    for read, dy, dx, weight in taps:
        if isinstance(read, int):
            groups[weight][f"C{read}({dx})"] += 1
            continue
        groups[weight][f"P{read.delay}({dy}, {dx})"] += 1
        if read.difference:
            groups[weight][f"P{read.delay + 1}({dy}, {dx})"] -= 1
    signs = {1: "+", -1: "-"}
    return [
        (weight, [f"{signs[times]} {term}" for term, times in group.items() if times])
        for weight, group in groups.items()
    ]


# Writing C


def functions(code: Code) -> str:
    """The C functions `sum_columns` and `sum_along`, with their macros.

    `P1(dy, dx)` is P(t-1) at an offset from the present cell, in grey levels. `C0(dx)` is a column.
    """
    sources = [tap.read for taps in code.sums for tap in taps if isinstance(tap.read, Source)]
    delays = {s.delay for s in sources} | {s.delay + 1 for s in sources if s.difference}
    at = "((dy) + RADIUS) * DLGMD_STRIDE + x + (dx)"
    lines = [f"#define P{delay}(dy, dx) sources[{delay}][{at}]" for delay in sorted(delays)]
    columns = range(code.n_columns)
    lines += [f"#define C{n}(dx) columns[{n}][x + RADIUS + (dx)]" for n in columns]
    begin = "    for (int x = 0; x < WIDTH; x++) {\n        float sum = 0;"
    arguments = "const uint8_t *const *sources, float columns[][WIDTH + 2 * RADIUS]"
    unused = ["{", "    (void)sources;", "    (void)columns;"]

    def added(taps: Sum) -> Iterator[str]:
        for weight, terms in _grouped(taps):
            inside = " ".join(terms).removeprefix("+ ")
            whole = "(float)" if "P" in inside else ""
            yield f"        sum += {float_literal(weight)} * {whole}({inside});"

    lines += ["", f"static void sum_columns({arguments})", *unused]
    for chain in code.chains:
        lines.append(begin)
        for step in chain:
            lines += [*added(step.taps), f"        C{step.column}(0) = sum;"]
        lines.append("    }")
    lines += ["}", "", f"static void sum_along({arguments}, float *s)", *unused]
    lines += [begin, *added(code.along), "        s[x] = sum > 0 ? sum : 0;"]
    return "\n".join(lines) + "\n    }\n}\n"


def float_literal(value: float) -> str:
    """A number in single precision as a literal of C."""
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"
