"""The D-LGMD as nested loops in float64: slow, plain, and independent of the package under test."""

import itertools
import math
from dataclasses import dataclass

import numpy as np

FORMULATIONS = ("default", "released-2021", "released-2020", "equations")
# Latency, saturation and grouping that the names stand for, and all ways to combine the first two.
NAMED = {
    "default": ("bands", True, "sum"),
    "released-2021": ("bands", True, "sum"),
    "released-2020": ("bands-2020", True, "mean"),
    "equations": ("interpolated", False, "sum"),
}
BAND_EDGES = {"bands": (1.0, 1.8999), "bands-whole": (1.0, 1.8999), "bands-2020": (1.0, 1.9)}
COMBINATIONS = list(itertools.product((*BAND_EDGES, "nearest", "interpolated"), (True, False)))

# The paper's Table II: alpha, beta, lam, sigma_e, sigma_i, r; a = 1.5 and T0 = 0.5 in all.
TABLE_2 = {
    1: (0.0, 0.0, 0.0, 0.35, 1.0, 4),
    2: (0.0, 0.0, 0.0, 0.35, 1.8, 4),
    3: (0.0, 0.0, 0.0, 0.35, 2.5, 4),
    4: (-0.1, 0.5, 0.7, 0.35, 1.0, 4),
    5: (-0.1, 0.5, 0.7, 0.35, 1.8, 4),
    6: (-0.1, 0.5, 0.7, 0.35, 2.5, 4),
    7: (-0.1, 0.5, 0.7, 1.0, 5.0, 4),
    8: (-0.1, 0.5, 0.7, 1.0, 5.0, 6),
    9: (-0.1, 0.5, 0.7, 1.5, 5.0, 6),
}


def table_2(number, **changes):
    """The plain-number parameters of one set, with the constants of Table I."""
    keys = ("alpha", "beta", "lam", "sigma_e", "sigma_i", "r")
    chosen = dict(zip(keys, TABLE_2[number], strict=True))
    chosen |= {"a": 1.5, "k": 1.0, "t0": 0.5, "m": 0.4, "ffi_gd": True, "formulation": "default"}
    return chosen | changes


@dataclass
class Answer:
    """One frame's layers and sums; None where the history is too short to define them."""

    p: np.ndarray | None = None
    s: np.ndarray | None = None
    g: np.ndarray | None = None
    g_raw: np.ndarray | None = None
    p_sum: float | None = None
    s_sum: float | None = None
    mp: float | None = None
    ffi: float | None = None
    t_de: float | None = None


def gaussian(x, y, sigma):
    """Eq. (4)."""
    return math.exp(-(x * x + y * y) / (2.0 * sigma * sigma)) / (sigma * math.sqrt(2.0 * math.pi))


def latency(x, y, alpha, beta, lam):
    """Eq. (5), in frames."""
    return alpha + 1.0 / (beta + math.exp(-lam * lam * (x * x + y * y)))


def kernels(alpha, beta, lam, sigma_e, sigma_i, r, a, rounding):
    """K_E as (dx, dy) -> weight, and K_d as d -> (dx, dy) -> weight; only the delays in use."""
    excite, inhibit = {}, {}
    for y in range(-r, r + 1):
        for x in range(-r, r + 1):
            tau = latency(x, y, alpha, beta, lam)
            g_e, g_i = gaussian(x, y, sigma_e), a * gaussian(x, y, sigma_i)
            if rounding == "nearest":
                excite[x, y] = g_e
                # The frame at most half a frame away; of two, the older one.
                d = math.floor(tau)
                if tau - d >= 0.5:
                    d += 1
                inhibit.setdefault(d, {})[x, y] = g_i
                continue
            if rounding == "interpolated":
                excite[x, y] = g_e
                for d in range(math.ceil(max(tau, 0.0)) + 1):
                    weight = 1.0 - abs(tau - d)
                    if weight > 0.0:
                        inhibit.setdefault(d, {})[x, y] = weight * g_i
                continue
            if tau < 1.0:
                excite[x, y] = max(g_e - g_i, 0.0)
            elif tau == 1.0 or rounding != "bands":
                excite[x, y] = g_e
            else:
                excite[x, y] = 0.0
            band = 0
            for edge in BAND_EDGES[rounding]:
                if edge <= tau:
                    band += 1
            if band > 0:
                inhibit.setdefault(band, {})[x, y] = g_i
    return excite, inhibit


def photoreceptors(frames):
    """P of every frame but the first, Eq. (1)."""
    layers = [None]
    for before, after in itertools.pairwise(frames):
        height, width = after.shape
        p = np.zeros((height, width))
        for i in range(height):
            for j in range(width):
                p[i, j] = abs(float(after[i, j]) - float(before[i, j]))
        layers.append(p)
    return layers


def pathways(frames):
    """P_on and P_off of every frame but the first."""
    on, off = [None], [None]
    for before, after in itertools.pairwise(frames):
        change = after.astype(float) - before.astype(float)
        on.append(np.where(change > 0.0, change, 0.0))
        off.append(np.where(change < 0.0, -change, 0.0))
    return on, off


def weighted(p, weights, i, j):
    """The cell (i, j) of `p`, a list of rows, convolved with `weights`."""
    total = 0.0
    for (x, y), weight in weights.items():
        total += weight * p[i - y][j - x]
    return total


def summation(history, excite, inhibit, t):
    """S(t), Eqs. (2), (3), (6) and (7)."""
    height, width = history[t].shape
    s = np.zeros((height, width))
    # Beyond the border is nothing. Lists: to read a number of an array takes three times as long.
    reach = max(x for x, _ in excite)
    rows = {d: np.pad(history[t - d], reach).tolist() for d in (0, *inhibit)}
    for i in range(height):
        for j in range(width):
            total = weighted(rows[0], excite, i + reach, j + reach)
            for d, weights in inhibit.items():
                total -= weighted(rows[d], weights, i + reach, j + reach)
            s[i, j] = max(total, 0.0)
    return s


def group(s, k):
    """G before threshold and saturation, Eqs. (8) and (9)."""
    height, width = s.shape
    g = np.zeros((height, width))
    for i in range(height):
        for j in range(width):
            around = 0.0
            for row in range(max(i - 1, 0), min(i + 3, height)):
                for column in range(max(j - 1, 0), min(j + 3, width)):
                    around += s[row, column]
            g[i, j] = s[i, j] * k * around
    return g


def total(layer):
    """Sum over a layer, cell by cell."""
    result = 0.0
    for value in layer.flat:
        result += float(value)
    return result


def run(
    frames,
    *,
    alpha,
    beta,
    lam,
    sigma_e,
    sigma_i,
    r,
    a,
    k,
    t0,
    m,
    ffi_gd,
    formulation,
    latency=None,
    saturate=None,
    grouping=None,
    on_off=False,
):
    """One `Answer` for every frame, Eqs. (1) to (13); S is that of ON and OFF pathways if asked.

    `latency`, `saturate` and `grouping` are those that the formulation stands for, unless given.
    """
    named = NAMED[formulation]
    rounding = named[0] if latency is None else latency
    is_limited = named[1] if saturate is None else saturate
    is_mean = (grouping or named[2]) == "mean"
    excite, inhibit = kernels(alpha, beta, lam, sigma_e, sigma_i, r, a, rounding)
    history = photoreceptors(frames)
    histories = pathways(frames) if on_off else [history]
    lag = 2 if formulation.startswith("released") else 1
    # P begins at frame 1, and both the oldest inhibition and FFI must find one.
    first = 1 + max([lag, *inhibit])
    answers = []
    for t, p in enumerate(history):
        answer = Answer()
        answers.append(answer)
        if p is None:
            continue
        answer.p, answer.p_sum = p, total(p)
        if t < first:
            continue
        answer.s = sum(summation(one, excite, inhibit, t) for one in histories)
        answer.s_sum = total(answer.s)
        answer.ffi = total(history[t - lag])
        cells = 200_000.0 if formulation.startswith("released") else p.size * m
        # T_de is the threshold in force: without one, every G passes, as it does at zero.
        answer.t_de = answer.ffi * t0 / cells if ffi_gd else 0.0
        if is_limited:
            answer.t_de = min(answer.t_de, 0.3)
        answer.g_raw = group(answer.s, k / 16 if is_mean else k)
        answer.g = np.zeros_like(answer.g_raw)
        for i in range(p.shape[0]):
            for j in range(p.shape[1]):
                g = answer.g_raw[i, j]
                if g < answer.t_de:
                    g = 0.0
                if is_limited:
                    g = min(g, 1.0)
                answer.g[i, j] = g
        answer.mp = total(answer.g)
    return answers
