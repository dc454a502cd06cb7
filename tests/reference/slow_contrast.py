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
    "c_s": 0.12,
    "s_min": 0.005,
    "w_sigma": 0.2,
}


@dataclass
class Answer:
    """One frame's layers and sums; None where they are not defined."""

    sigma: float
    floor: float | None = None
    p: np.ndarray | None = None
    s: np.ndarray | None = None
    g: np.ndarray | None = None
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


def run(frames, *, c_p, p_min, c_s, s_min, w_sigma, **connections):
    """One `Answer` for every frame."""
    excite, inhibit = kernels(**connections, formulation="default")
    answers, history = [], []
    for t, change in enumerate(photoreceptors(frames)):
        newest = deviation(frames[t])
        sigma = newest if t == 0 else (1.0 - w_sigma) * answers[-1].sigma + w_sigma * newest
        answer = Answer(sigma)
        answers.append(answer)
        if change is not None:
            answer.p_sum, answer.floor = total(change), max(p_min, c_p * sigma)
            answer.p = above(change, answer.floor)
        history.append(answer.p)
        if t < 1 + max(inhibit, default=0):
            continue
        answer.s, answer.t_de = summation(history, excite, inhibit, t), max(s_min, c_s * sigma)
        answer.s_sum = total(answer.s)
        answer.g = np.zeros(answer.s.shape)
        for i, j in np.ndindex(answer.s.shape):
            answer.g[i, j] = 1.0 if answer.s[i, j] > answer.t_de else 0.0
        answer.mp = total(answer.g)
    return answers
