"""The kernels as C: sums along the columns, then S as the sum along the row."""

import math
from collections import Counter, defaultdict
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from dlgmd_cli.models.engines.plan import Source, Sum, Tap, fuse
from dlgmd_cli.models.kernels import Connections

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
    shifts : list of int
        Fixed point: number of bits that the sums of each chain are shifted right.
    s_bits, s_shift : int
        Fixed point: binary places of the sum S, and number of bits that S is shifted right.
    """

    chains: list[list[Step]]
    along: Sum
    shifts: list[int]
    s_bits: int = 0
    s_shift: int = 0

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
    return Code(chains, rounded(along), [0] * len(chains))


def fixed_code(connections: Connections, gain: float) -> Code:
    """Sums in integers of 32 bits; columns have 16 bits.

    Parameters
    ----------
    connections : Connections
        The kernels.
    gain : float
        Factor of S in luminance. The product must fit 16 bits.
    """
    kernels = connections.signed().values()
    s_max = gain * sum(float(np.maximum(kernel, 0.0).sum()) for kernel in kernels)
    chains, along = _planned(connections)
    shifts: list[int] = []
    # Binary places and greatest value of the columns.
    columns: dict[Any, tuple[int, float]] = {}
    for i, chain in enumerate(chains):
        taps = [tap for step in chain for tap in step.taps]
        largest, reach = max(abs(tap.weight) for tap in taps), N_LEVELS * _reach(taps)
        weight_bits, bits = min(_places(15, largest), _places(31, reach)), _places(15, reach)
        columns |= {step.column: (bits, 2.0 ** (15 - bits)) for step in chain}
        shifts.append(weight_bits - bits)
        chains[i] = [step._replace(taps=_whole(step.taps, weight_bits)) for step in chain]
    reads = [columns.get(tap.read, (0, float(N_LEVELS))) for tap in along]
    along = [tap._replace(weight=tap.weight * gain / N_LEVELS) for tap in along]
    pairs = list(zip(along, reads, strict=True))
    s_bits = _places(31, sum(abs(tap.weight) * high for tap, (_, high) in pairs))
    along = [kept for tap, (bits, _) in pairs for kept in _whole([tap], s_bits - bits)]
    return Code(chains, along, shifts, s_bits, s_bits - min(15, s_bits, _places(16, s_max)))


def _reach(taps: Sum) -> float:
    """The greatest magnitude of a sum, for frames from 0 to 1."""
    up = down = 0.0
    for tap in taps:
        is_difference = isinstance(tap.read, Source) and tap.read.difference
        up += abs(tap.weight) if is_difference else max(tap.weight, 0.0)
        down += abs(tap.weight) if is_difference else max(-tap.weight, 0.0)
    return max(up, down)


def _places(width: int, reach: float) -> int:
    """Binary places that numbers up to `reach`, once rounded, can have in `width` bits."""
    return math.floor(width - math.log2(reach * 1.002)) if reach else width


def _whole(taps: Sum, places: int) -> Sum:
    """Taps with integer weights of `places` binary places; weights of 0 are left out."""
    whole = [tap._replace(weight=round(float(tap.weight) * 2.0**places)) for tap in taps]
    return [tap for tap in whole if tap.weight]


# Arranging sums


def _planned(connections: Connections) -> tuple[list[list[Step]], Sum]:
    """The chains and the sum along the row with the fewest operations."""

    def cost(sums: list[Sum]) -> float:
        return sum(Code(*_arranged(sums), []).operations)

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


def functions(code: Code, *, is_fixed: bool) -> str:
    """The C functions `sum_columns` and `sum_along`, with their macros.

    `P1(dy, dx)` is P(t-1) at an offset from the present cell, in grey levels. `C0(dx)` is a column.
    """
    sources = [tap.read for taps in code.sums for tap in taps if isinstance(tap.read, Source)]
    delays = {s.delay for s in sources} | {s.delay + 1 for s in sources if s.difference}
    at = "((dy) + RADIUS) * DLGMD_STRIDE + x + (dx)"
    lines = [f"#define P{delay}(dy, dx) sources[{delay}][{at}]" for delay in sorted(delays)]
    columns = range(code.n_columns)
    lines += [f"#define C{n}(dx) columns[{n}][x + RADIUS + (dx)]" for n in columns]
    number = "int32_t" if is_fixed else "float"
    begin = f"    for (int x = 0; x < WIDTH; x++) {{\n        {number} sum"
    arguments = "const uint8_t *const *sources, dlgmd_column columns[][WIDTH + 2 * RADIUS]"
    unused = ["{", "    (void)sources;", "    (void)columns;"]

    def added(taps: Sum) -> Iterator[str]:
        for weight, terms in _grouped(taps):
            factor = str(weight) if is_fixed else float_literal(weight)
            inside = " ".join(terms).removeprefix("+ ")
            is_whole = not is_fixed and "P" in inside
            yield f"        sum += {factor} * {'(float)' * is_whole}({inside});"

    lines += ["", f"static void sum_columns({arguments})", *unused]
    for chain, shift in zip(code.chains, code.shifts, strict=True):
        lines.append(f"{begin} = {1 << (shift - 1) if shift else 0};")
        for step in chain:
            value = f"(dlgmd_column)(sum >> {shift})" if is_fixed else "sum"
            lines += [*added(step.taps), f"        C{step.column}(0) = {value};"]
        lines.append("    }")
    s = f"(dlgmd_sum)(sum >> {code.s_shift})" if is_fixed else "sum"
    lines += ["}", "", f"static void sum_along({arguments}, dlgmd_sum *s)", *unused]
    lines += [f"{begin} = 0;", *added(code.along), f"        s[x] = sum > 0 ? {s} : 0;"]
    return "\n".join(lines) + "\n    }\n}\n"


def float_literal(value: float) -> str:
    """A number in single precision as a literal of C."""
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"
