"""The loops of the fused engine, compiled by Numba.

Every sum of taps runs over a whole block of rows as if it were one long row: the columns between
the blocks' rows hold zeros, and what is computed there is not used. So the compiler sees nothing
but long loops over neighbouring numbers, which it turns into vector instructions.

All of it stands in one module because Numba's cache on disk notices changes of this file only.
"""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
from numba import njit

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
def respond(
    first, end, stack, newer, older, reach, plan, shape, memory, edges, grouping, s_out, g_out
):
    """ΣS and ΣG of the rows `first` up to `end`; `fused` prepares every argument.

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
def without_cache() -> Callable[..., Any]:
    """`respond` compiled anew, for when the cache on disk fails."""
    return njit(**_OPTIONS)(respond.py_func)
