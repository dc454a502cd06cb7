"""The contrast-relative D-LGMD as nested loops in float64."""

import math
from dataclasses import dataclass

import numpy as np

from reference.slow import kernels, photoreceptors, summation, total

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


def run(frames, *, c_p, p_min, c_n, c_s, s_min, w_sigma, growth, w_m, sigma_c, **connections):
    """One `Answer` for every frame."""
    weights = weights_of(frames[0].shape, sigma_c)
    excite, inhibit = kernels(**connections, rounding="bands")
    answers, history = [], []
    for t, change in enumerate(photoreceptors(frames)):
        newest = deviation(frames[t])
        sigma = newest if t == 0 else (1.0 - w_sigma) * answers[-1].sigma + w_sigma * newest
        answer = Answer(sigma)
        answers.append(answer)
        if change is not None:
            quartile = sorted(change.flat)[change.size // 4]
            noise = answers[-2].noise
            answer.noise = quartile if noise is None else (1 - w_sigma) * noise + w_sigma * quartile
            answer.p_sum = total(change)
            answer.floor = max(p_min, c_p * sigma, c_n * answer.noise)
            answer.p = above(change, answer.floor)
            m = total(answer.p) / answer.p.size
            before = answers[-2].usual
            if before is None:
                answer.usual = m
            else:
                answer.ffi = 0.0 if m == 0 else m / before if before else math.inf
                answer.usual = (1 - w_m) * before + w_m * m
        history.append(answer.p)
        if t < 1 + max([1, *inhibit]):
            continue
        answer.s, answer.t_de = summation(history, excite, inhibit, t), max(s_min, c_s * sigma)
        answer.s_sum = total(answer.s)
        answer.g = np.zeros(answer.s.shape)
        for i, j in np.ndindex(answer.s.shape):
            if answer.s[i, j] > answer.t_de:
                answer.g[i, j] = weights[i, j] * passed(answer.ffi, growth)
        answer.mp = total(answer.g)
    return answers
