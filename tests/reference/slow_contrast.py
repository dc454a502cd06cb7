"""The contrast-relative D-LGMD as nested loops in float64."""

import math
from dataclasses import dataclass
from functools import partial

import numpy as np

from reference.slow import kernels, summation, total

DEFAULTS = {
    "alpha": 0.0,
    "beta": 0.0,
    "lam": 0.0,
    "sigma_e": 0.35,
    "sigma_i": 2.5,
    "r": 4,
    "a": 1.5,
    "c_p": 0.08,
    "p_min": 0.01,
    "c_n": 3.0,
    "c_s": 0.12,
    "s_min": 0.005,
    "w_sigma": 0.2,
    "growth": 1.5,
    "w_m": 0.3,
    "sigma_c": 0.6,
    "w_fps": 0.0,
    "shift": 0,
    "balance": False,
    "deflicker": False,
    "c_m": 0.0,
    "tau_m": 1.5,
    "d_0": 0.0,
    "tau_d": 0.1,
    "k_0": 0.001,
}


@dataclass
class Answer:
    """One frame's layers and sums; None where they are not defined."""

    sigma: float
    floor: float | None = None
    p: np.ndarray | None = None
    s: np.ndarray | None = None
    g: np.ndarray | None = None
    noise: float | None = None
    usual: float | None = None
    ffi: float | None = None
    p_sum: float | None = None
    s_sum: float | None = None
    mp: float | None = None
    steady: float | None = None
    shift: tuple[int, int] = (0, 0)
    rate: float = 0.0
    beside: float = 0.0
    t_de: float | None = None


def deviation(frame):
    """Standard deviation of the luminance."""
    mean = sum(float(value) for value in frame.flat) / frame.size
    return math.sqrt(sum((float(value) - mean) ** 2 for value in frame.flat) / frame.size)


def above(layer, floor):
    """What of each cell exceeds `floor`."""
    result = np.zeros(layer.shape)
    for i, j in np.ndindex(layer.shape):
        result[i, j] = max(layer[i, j] - floor, 0.0)
    return result


def weights_of(shape, sigma_c):
    """How much cells count: less the farther they are from the centre, 1 on average."""
    (height, width), weights = shape, np.zeros(shape)
    for i, j in np.ndindex(shape):
        half = max(height, width) / 2
        y, x = (i - (height - 1) / 2) / half, (j - (width - 1) / 2) / half
        weights[i, j] = math.exp(-(x**2 + y**2) / (2 * sigma_c**2))
    return weights * (weights.size / total(weights))


def passed(ffi, growth):
    """What feed-forward inhibition leaves."""
    return min(1.0, growth / ffi) ** 2 if ffi else 1.0


def blocks_of(frame):
    """Means over blocks of 4 x 4 cells."""
    height, width = (side // 4 for side in frame.shape)
    means = np.zeros((height, width))
    for i, j in np.ndindex(height, width):
        means[i, j] = total(frame[4 * i : 4 * i + 4, 4 * j : 4 * j + 4]) / 16
    return means


def shift_between(frame, before, last, most):
    """The shift of the picture: in blocks, by descent, and in cells, between the blocks."""
    now, then = blocks_of(frame), blocks_of(before)
    limits = [min(most // 4, side // 3) for side in now.shape]
    if min(limits) == 0:
        return (0, 0), (0, 0)
    change = partial(mean_change, now, then)
    best = last if change(*last) < change(0, 0) else (0, 0)
    while True:
        found = best
        for i in (best[0] - 1, best[0], best[0] + 1):
            for j in (best[1] - 1, best[1], best[1] + 1):
                inside = abs(i) <= limits[0] and abs(j) <= limits[1]
                if inside and change(i, j) < change(*found):
                    found = i, j
        if found == best:
            break
        best = found
    fine = [4 * (place - b) for b, place in zip(best, between(change, *best), strict=True)]
    cells = [4 * b + math.floor(part + 0.5 + 1e-9) for b, part in zip(best, fine, strict=True)]
    return best, tuple(cells)


def between(change, i, j):
    """Where the least change is, at most half a block from (i, j)."""
    sides = ((change(i - 1, j), change(i + 1, j)), (change(i, j - 1), change(i, j + 1)))
    places = []
    for blocks, (less, more) in zip((i, j), sides, strict=True):
        rise = max(less, more) - change(i, j)
        part = (less - more) / (2 * rise) if change(i, j) > 0 and 0 < rise < math.inf else 0.0
        places.append(blocks + min(max(part, -0.5), 0.5))
    return places


def reduced(frame):
    """Means over blocks, so that 120 columns or more remain, then over 3 x 3: whole levels."""
    n = max(1, frame.shape[1] // 120)
    blocks = np.zeros([side // n for side in frame.shape])
    for i, j in np.ndindex(blocks.shape):
        blocks[i, j] = total(frame[n * i : n * i + n, n * j : n * j + n]) / n**2 * 255
    means, (height, width) = np.zeros(blocks.shape), blocks.shape
    for i, j in np.ndindex(blocks.shape):
        for di in (-1, 0, 1):
            for dj in (-1, 0, 1):
                near = min(max(i + di, 0), height - 1), min(max(j + dj, 0), width - 1)
                means[i, j] += blocks[near] / 9
    return np.floor(means + 0.5001)


def motion_of(now, then, rows, columns, start):
    """Shift down and right, and growth along both, of a part of a picture: two Newton steps."""
    v, u, b, a = *start, 0.0, 0.0
    height, width = now.shape
    mid_i, mid_j = (rows[0] + rows[1] - 1) / 2, (columns[0] + columns[1] - 1) / 2
    for _ in range(2):
        found = []
        for i in range(*rows):
            for j in range(*columns):
                y, x = i - mid_i, j - mid_j
                at_i, at_j = i + v + b * y, j + u + a * x
                if not (0 <= at_i < height - 1 and 0 <= at_j < width - 1):
                    continue
                near_i, near_j = int(at_i), int(at_j)
                down, right = at_i - near_i, at_j - near_j
                upper = (1 - right) * now[near_i, near_j] + right * now[near_i, near_j + 1]
                lower = (1 - right) * now[near_i + 1, near_j] + right * now[near_i + 1, near_j + 1]
                around = then[i - 1 : i + 2, j - 1 : j + 2]
                across, along = np.array([1, 2, 1]) / 8, np.array([-1, 0, 1])
                g_y, g_x = along @ around @ across, across @ around @ along
                rest = then[i, j] - (1 - down) * upper - down * lower
                found.append((rest, np.array([g_y, g_x, g_y * y, g_x * x])))
        if 4 * len(found) < (rows[1] - rows[0]) * (columns[1] - columns[0]):
            return 0.0, 0.0, 0.0, 0.0
        scale = 1.5 * sum(abs(rest) for rest, _ in found) / len(found) + 1
        matrix, right_side = np.zeros((4, 4)), np.zeros(4)
        for rest, slope in found:
            weight = 1 / (1 + (rest / scale) ** 2)
            matrix += weight * np.outer(slope, slope)
            right_side += weight * rest * slope
        matrix += np.diag(1e-6 * np.diag(matrix) + [1e-3, 1e-3, 0.1, 0.1])
        v, u, b, a = np.array([v, u, b, a]) + np.linalg.inv(matrix) @ right_side
    return v, u, b, a


def growth_ahead(now, then, start):
    """Growth of the square in the middle."""
    half = min(now.shape) // 2
    rows, columns = (((side - half) // 2, (side - half) // 2 + half) for side in now.shape)
    *_, b, a = motion_of(now, then, rows, columns, start)
    return min(a, b) - 0.25 * abs(a - b)


def growth_beside(now, then):
    """Growth of what moves before a still camera, about a point inside it; else 0."""
    change, half = abs(now - then), min(now.shape) // 2
    above = np.maximum(change - 3 - change.mean(), 0)
    mass = total(above)
    if mass < 0.19 * above.size or (above > 0).sum() > 0.4 * above.size:
        return 0.0
    windows, reaches = [], []
    for axis, side in enumerate(now.shape):
        places = np.indices(now.shape)[axis]
        middle = total(above * places) / mass
        spread = math.sqrt(total(above * (places - middle) ** 2) / mass)
        if spread > 0.9 * half:
            return 0.0
        reach = math.floor(min(max(1.6 * spread, 6), half / 2) + 0.5)
        at = min(max(math.floor(middle + 0.5), reach + 1), side - 2 - reach)
        windows.append((at - reach, at + reach + 1))
        reaches.append(reach)
    v, u, b, a = motion_of(now, then, *windows, (0.0, 0.0))
    passes = abs(v) >= b * reaches[0] or abs(u) >= a * reaches[1]
    return 0.0 if passes else max(min(a, b), 0.0)


def moved(image, dy, dx, entering):
    """The image moved down and right; `entering` where it does not reach."""
    result = entering.astype(float)
    for i, j in np.ndindex(image.shape):
        if 0 <= i - dy < image.shape[0] and 0 <= j - dx < image.shape[1]:
            result[i, j] = image[i - dy, j - dx]
    return result


def mean_change(frame, before, dy, dx):
    """Mean change over the cells that the moved picture covers."""
    other = moved(before, dy, dx, entering=np.full(frame.shape, np.nan))
    covered = [abs(a - b) for a, b in zip(frame.flat, other.flat, strict=True) if b == b]
    return sum(covered) / len(covered)


def weakest(g, weights):
    """K by the mean of the two quadrants with the least share of active cells."""
    (height, width), shares = g.shape, []
    for below in (False, True):
        for right in (False, True):
            active = whole = 0.0
            for i, j in np.ndindex(g.shape):
                y, x = i - (height - 1) / 2, j - (width - 1) / 2
                if (y >= 0 if below else y <= 0) and (x >= 0 if right else x <= 0):
                    active, whole = active + g[i, j], whole + weights[i, j]
            shares.append(active / whole)
    least, second, *_ = sorted(shares)
    return g.size * (least + second) / 2


def run(
    frames, *, times=None, w_fps, shift, balance, deflicker, c_m, tau_m, d_0, tau_d, k_0, **rest
):
    """One `Answer` for every frame, none of which flickers; `times` are theirs, in seconds."""
    interval = 1 / w_fps if w_fps else 1 / 30
    times = [t * interval for t in range(len(frames))] if times is None else times
    weights, answers, history = weights_of(frames[0].shape, rest["sigma_c"]), [], []
    excite, inhibit, values = connections_of(**rest)
    blocks, ahead, beside = (0, 0), 0.0, 0.0
    for t, frame in enumerate(frames):
        frame = frame.astype(float)
        before, d = frame, (0, 0)
        if t > 0:
            before = frames[t - 1].astype(float)
            blocks, d = shift_between(frame, before, blocks, shift)
            cells = d
            if mean_change(frame, before, *d) < 0.95 * mean_change(frame, before, 0, 0):
                before = moved(before, *d, entering=frame)
                history[1:] = [moved(p, *d, entering=np.zeros(p.shape)) for p in history[1:]]
            else:
                d = (0, 0)
        seconds = times[t] - times[t - 1] if t else interval
        if t and d_0 and min(frame.shape[0], frame.shape[1]) // max(1, frame.shape[1] // 120) >= 20:
            now, then = reduced(frame), reduced(frames[t - 1].astype(float))
            start = [c / max(1, frame.shape[1] // 120) for c in cells]
            rate = min(max(growth_ahead(now, then, start) / seconds, -2.5), 2.5)
            ahead += (1 - math.exp(-seconds / tau_d)) * (rate - ahead)
            rate = min(growth_beside(now, then) / seconds, 2.5) if blocks == (0, 0) else 0.0
            beside += (1 - math.exp(-2 * seconds / tau_d)) * (rate - beside)
        n = seconds * w_fps if w_fps else 1.0
        change = abs(frame - before) if t else None
        answer = see(frame, change, answers, n, **values)
        answer.shift, answer.beside, answer.rate = d, beside, max(ahead, beside / 2)
        history.append(answer.p)
        answers.append(answer)
        if t < 1 + max([1, *inhibit]):
            continue
        answer.s, answer.t_de = summation(history, excite, inhibit, t), threshold_of(answer, **rest)
        answer.s_sum, answer.g = total(answer.s), np.zeros(answer.s.shape)
        for i, j in np.ndindex(answer.s.shape):
            if answer.s[i, j] > answer.t_de:
                answer.g[i, j] = weights[i, j] * passed(answer.ffi, values["growth"]) / n
        answer.mp = kappa = weakest(answer.g, weights) if balance else total(answer.g)
        past = kappa if answers[-2].steady is None else answers[-2].steady
        answer.steady = past + (1 - math.exp(-seconds / tau_m)) * (kappa - past)
        answer.mp = max(kappa - c_m * past, 0.0)
        if d_0:
            ratio = min(max(1.0, answer.rate / d_0), 16.0)
            answer.mp = ratio**2 * (answer.mp + k_0 * frame.size) - k_0 * frame.size
    return answers


def threshold_of(answer, *, c_s, s_min, **_):
    """What S of an active cell exceeds."""
    return max(s_min, c_s * answer.sigma)


def connections_of(*, c_p, p_min, c_n, c_s, s_min, w_sigma, growth, w_m, sigma_c, **connections):
    """The kernels, and what is left of the parameters."""
    excite, inhibit = kernels(**connections, rounding="bands")
    values = {"c_p": c_p, "p_min": p_min, "c_n": c_n, "w_sigma": w_sigma, "growth": growth}
    return excite, inhibit, values | {"w_m": w_m}


def see(frame, change, answers, n, *, c_p, p_min, c_n, w_sigma, growth, w_m):
    """P' of a frame, after `n` usual intervals, and what follows from the picture as a whole."""
    w_sigma, w_m = 1 - (1 - w_sigma) ** n, 1 - (1 - w_m) ** n
    newest = deviation(frame)
    sigma = newest if not answers else (1.0 - w_sigma) * answers[-1].sigma + w_sigma * newest
    answer = Answer(sigma)
    if change is not None:
        quartile = sorted(change.flat)[change.size // 4]
        noise = answers[-1].noise
        answer.noise = quartile if noise is None else (1 - w_sigma) * noise + w_sigma * quartile
        answer.p_sum = total(change)
        answer.floor = max(p_min, c_p * sigma, c_n * answer.noise)
        answer.p = above(change, answer.floor)
        m = total(answer.p) / answer.p.size / n
        before = answers[-1].usual
        if before is None:
            answer.usual = m
        else:
            answer.ffi = 0.0 if m == 0 else m / before if before else math.inf
            answer.usual = (1 - w_m) * before + w_m * m
    return answer
