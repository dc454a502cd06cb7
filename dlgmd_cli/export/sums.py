"""The plan of the compiled loops as C: sums up the columns, and the sum along the row that is S."""

import math
from collections import defaultdict
from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from dlgmd_cli.models.engines.plan import Sum, Tap, fuse, sources_of
from dlgmd_cli.models.kernels import Connections

LEVELS = 255
# Float: taps below this share of their sum's largest one are lost in its rounding.
NEGLIGIBLE = 2.0**-22
# Fixed: P' of the contrast-relative model is in 1/128 level, as 16 bits hold it.
CHANGE_BITS = 7


class Step(NamedTuple):
    """Taps to add to the sum, which then is a column of its own."""

    taps: Sum
    column: int


class Code(NamedTuple):
    """Sums with their weights as C has them.

    Attributes
    ----------
    chains : list of list of Step
        Sums up the columns, each continued step by step.
    along : Sum
        What S adds up: columns by number, and sources.
    shifts : list of int
        Fixed: bits that each chain drops of its sum.
    s_bits, s_shift : int
        Fixed: binary places of S's sum, and how many of them are dropped.
    """

    chains: list[list[Step]]
    along: Sum
    shifts: list[int]
    s_bits: int = 0
    s_shift: int = 0

    @property
    def n_columns(self) -> int:
        """How many columns the chains give."""
        return sum(map(len, self.chains))

    @property
    def operations(self) -> tuple[int, int]:
        """Multiplications and additions for each cell."""
        groups = [group for taps in self._sums() for group in _grouped(taps)]
        return len(groups), sum(len(reads) for _, reads in groups)

    @property
    def margin(self) -> int:
        """How far beside its column S reads a source."""
        return max((abs(t.dx) for t in self.along if not isinstance(t.read, int)), default=0)

    def _sums(self) -> Iterator[Sum]:
        yield from (step.taps for chain in self.chains for step in chain)
        yield self.along


def _planned(connections: Connections) -> tuple[list[list[Step]], Sum]:
    """The sums that take the fewest operations."""

    def cost(sums: list[Sum]) -> float:
        chains, along = _arranged(sums)
        return sum(Code(chains, along, []).operations)

    return _arranged(fuse(connections.signed(), connections.gaussians, cost))


def _arranged(sums: list[Sum]) -> tuple[list[list[Step]], Sum]:
    """The same sums, where one that merely continues another is not split from it."""
    n_reads = defaultdict(int)
    for taps in sums:
        for tap in taps:
            if isinstance(tap.read, int):
                n_reads[tap.read] += 1
    last = len(sums) - 1
    along = sums[last]
    while last and _continues(along, last - 1) and n_reads[last - 1] == 1:
        last -= 1
        along = sums[last] + along[1:]
    chains: list[list[Step]] = []
    numbers: dict[int, int] = {}
    pending: Sum = []
    for k, taps in enumerate(sums[:last]):
        is_continued = k + 1 < last and _continues(sums[k + 1], k)
        if k and _continues(taps, k - 1):
            taps = taps[1:]
        else:
            chains.append([])
        pending = pending + taps
        if n_reads[k] > is_continued:
            numbers[k] = len(numbers)
            chains[-1].append(Step(pending, numbers[k]))
            pending = []
    along = [t._replace(read=numbers[t.read]) if isinstance(t.read, int) else t for t in along]
    return chains, along


def _continues(taps: Sum, number: int) -> bool:
    """Whether a sum begins with that earlier one."""
    return bool(taps) and taps[0] == Tap(number, 0, 0, 1.0)


def float_code(connections: Connections, unit: float) -> Code:
    """Sums in single precision; a level of a source counts `unit`."""
    chains, along = _planned(connections)

    def rounded(taps: Sum) -> Sum:
        least = NEGLIGIBLE * max((abs(tap.weight) for tap in taps), default=0.0)
        return [
            tap._replace(
                weight=np.float32(tap.weight * (1.0 if isinstance(tap.read, int) else unit))
            )
            for tap in taps
            if abs(tap.weight) > least
        ]

    rounded_chains = [[Step(rounded(step.taps), step.column) for step in one] for one in chains]
    return Code(rounded_chains, rounded(along), [0] * len(chains))


def fixed_code(connections: Connections, gain: float, source_bits: int, s_max: float) -> Code:
    """Sums of integers of 32 bits, of columns of 16 bits.

    Parameters
    ----------
    connections : Connections
        The kernels.
    gain : float
        What S, in levels, is multiplied by.
    source_bits : int
        Binary places of a source, in levels.
    s_max : float
        What S can reach then, and 16 bits are to hold; infinite if S keeps its 32 bits.
    """
    chains, along = _planned(connections)
    scaled_chains, shifts, bits = [], [], {}
    for chain in chains:
        taps = [tap for step in chain for tap in step.taps]
        reach = LEVELS * _reach(taps)
        column_bits = _bits(15, reach)
        weight_bits = min(
            _bits(31, reach) - source_bits, _bits(15, max(abs(t.weight) for t in taps))
        )
        shifts.append(weight_bits + source_bits - column_bits)
        bits |= {step.column: column_bits for step in chain}
        scaled_chains.append(
            [Step(_integers(step.taps, lambda tap: weight_bits), step.column) for step in chain]
        )
    reaches = [
        abs(tap.weight) * (2.0 ** (15 - bits[tap.read]) if isinstance(tap.read, int) else LEVELS)
        for tap in along
    ]
    s_bits = _bits(31, gain * sum(reaches)) if reaches else 16
    scaled_along = [tap._replace(weight=tap.weight * gain) for tap in along]

    def places(tap: Tap) -> int:
        return s_bits - (bits[tap.read] if isinstance(tap.read, int) else source_bits)

    s_shift = 0 if math.isinf(s_max) else s_bits - min(15, s_bits, _bits(16, s_max))
    return Code(scaled_chains, _integers(scaled_along, places), shifts, s_bits, s_shift)


def _reach(taps: Sum) -> float:
    """The largest value of a sum, without its sign, where sources reach 1."""
    weights = [(tap.weight, not isinstance(tap.read, int) and tap.read.difference) for tap in taps]
    up = sum(abs(weight) for weight, both in weights if both or weight > 0.0)
    return max(up, sum(abs(weight) for weight, both in weights if both or weight < 0.0))


def _bits(width: int, reach: float) -> int:
    """Binary places that a number up to `reach` can have in so many bits, rounding included."""
    return math.floor(width - math.log2(reach * 1.002)) if reach else 0


def _integers(taps: Sum, places: Callable[[Tap], int]) -> Sum:
    """Taps with whole weights of so many binary places, without those that are 0."""
    whole = [tap._replace(weight=round(float(tap.weight) * 2.0 ** places(tap))) for tap in taps]
    return [tap for tap in whole if tap.weight]


def _grouped(taps: Sum) -> list[tuple[float, list[str]]]:
    """Weights, each with all that it is for; what is added and taken away again is left out."""
    groups: dict[float, dict[str, int]] = defaultdict(lambda: defaultdict(int))
    for tap in taps:
        group = groups[tap.weight]
        if isinstance(tap.read, int):
            group[f"C{tap.read}({tap.dx})"] += 1
            continue
        group[f"P{tap.read.delay}({tap.dy}, {tap.dx})"] += 1
        if tap.read.difference:
            group[f"P{tap.read.delay + 1}({tap.dy}, {tap.dx})"] -= 1
    signed = {1: "+ ", -1: "- "}
    return [
        (weight, [f"{signed[times]}{term}" for term, times in group.items() if times])
        for weight, group in groups.items()
    ]


def functions(code: Code, *, is_fixed: bool, is_contrast: bool) -> str:
    """`sum_columns` and `sum_along`, and what they read, as C.

    P of a source is the number of its levels; with the contrast-relative model, P' in the units of
    its table.
    """
    reads = sorted(
        {tap.read for taps in code._sums() for tap in taps if not isinstance(tap.read, int)}
    )
    delays = sorted({s.delay for s in reads} | {s.delay + 1 for s in reads if s.difference})
    lines = []
    for delay in delays:
        place = f"sources[{delay}].change[((dy) + RADIUS) * DLGMD_STRIDE + x + (dx)]"
        read = f"sources[{delay}].passed[{place}]" if is_contrast else place
        lines.append(f"#define P{delay}(dy, dx) {read}")
    for number in range(code.n_columns):
        lines.append(f"#define C{number}(dx) columns[{number}][x + RADIUS + (dx)]")
    number_type = "int32_t" if is_fixed else "float"

    def added(taps: Sum) -> Iterator[str]:
        for weight, terms in _grouped(taps):
            literal = str(weight) if is_fixed else float_literal(weight)
            inside = " ".join(terms).removeprefix("+ ")
            is_whole = not is_contrast and not is_fixed and "P" in inside
            yield f"        sum += {literal} * {'(float)' * is_whole}({inside});"

    head = f"    for (int x = 0; x < WIDTH; x++) {{\n        {number_type} sum"
    body = []
    for chain, shift in zip(code.chains, code.shifts, strict=True):
        start = f" = {1 << (shift - 1)};" if is_fixed and shift else " = 0;"
        body.append(head + start)
        for step in chain:
            body += added(step.taps)
            value = f"(dlgmd_column)(sum >> {shift})" if is_fixed else "sum"
            body.append(f"        C{step.column}(0) = {value};")
        body.append("    }")
    columns = "dlgmd_column columns[][WIDTH + 2 * RADIUS]"
    unused = [] if delays and code.chains else ["    (void)sources;", "    (void)columns;"]
    lines += ["", "/* Up the columns of row y. */"]
    lines += [
        f"static void sum_columns(const source *sources, {columns})",
        "{",
        *unused,
        *body,
        "}",
    ]
    s = "sum" if not code.s_shift else f"(dlgmd_sum)(sum > 0 ? sum >> {code.s_shift} : 0)"
    if not (is_fixed or is_contrast):
        s = "sum > 0.0f ? sum : 0.0f"
    arguments = f"const source *sources, {columns}, dlgmd_sum *s"
    lines += ["", "/* Along the row. */", f"static void sum_along({arguments})", "{"]
    lines += ["    (void)sources;", "    (void)columns;", f"{head} = 0;", *added(code.along)]
    lines += [f"        s[x] = {s};", "    }", "}"]
    return "\n".join(lines) + "\n"


def float_literal(value: float) -> str:
    """A number in single precision, as C writes it."""
    text = f"{np.float32(value):.9g}"
    return f"{text}f" if "." in text or "e" in text else f"{text}.0f"
