"""The LGMD without distributed connections as nested loops in float64."""

import numpy as np

from reference.slow import Answer

WEIGHTS = {
    (-1, -1): 0.125,
    (-1, 0): 0.25,
    (-1, 1): 0.125,
    (0, -1): 0.25,
    (0, 1): 0.25,
    (1, -1): 0.125,
    (1, 0): 0.25,
    (1, 1): 0.125,
}

DEFAULTS = {
    "p1": 0.0,
    "p2": 0.0,
    "w_i": 0.3,
    "delta_c": 0.01,
    "c_omega": 4.0,
    "c_de": 0.15,
    "t_de": 15.0,
    "t_ffi": 255.0,
}


def at(layer, i, j):
    """A cell, zero beyond the border."""
    height, width = layer.shape
    return float(layer[i, j]) if 0 <= i < height and 0 <= j < width else 0.0


def magnitude(layer):
    """Σ|.| over a layer, cell by cell."""
    total = 0.0
    for value in layer.flat:
        total += abs(float(value))
    return total


def changes(frames, p1, p2):
    """P of every frame but the first: signed, in grey levels, with persistence."""
    layers = [None]
    for t in range(1, len(frames)):
        height, width = frames[t].shape
        p = np.zeros((height, width))
        for i in range(height):
            for j in range(width):
                p[i, j] = 255.0 * (float(frames[t][i, j]) - float(frames[t - 1][i, j]))
                if t >= 2:
                    p[i, j] += p1 * layers[t - 1][i, j]
                if t >= 3:
                    p[i, j] += p2 * layers[t - 2][i, j]
        layers.append(p)
    return layers


def run(frames, *, p1, p2, w_i, delta_c, c_omega, c_de, t_de, t_ffi):
    """One `Answer` for every frame, (H, W) luminance in 0..1."""
    answers = []
    layers = changes(frames, p1, p2)
    for t, p in enumerate(layers):
        answer = Answer()
        answers.append(answer)
        if p is None:
            continue
        answer.p, answer.p_sum = p, magnitude(p)
        if t < 2:
            continue
        height, width = p.shape
        before = layers[t - 1]
        answer.s = np.zeros_like(p)
        for i in range(height):
            for j in range(width):
                inhibition = 0.0
                for (di, dj), weight in WEIGHTS.items():
                    inhibition += weight * at(before, i + di, j + dj)
                answer.s[i, j] = p[i, j] - w_i * inhibition
        answer.s_sum = magnitude(answer.s)
        ce = np.zeros_like(p)
        for i in range(height):
            for j in range(width):
                for di in (-1, 0, 1):
                    for dj in (-1, 0, 1):
                        ce[i, j] += at(answer.s, i + di, j + dj) / 9.0
        omega = delta_c + max(abs(float(value)) for value in ce.flat) / c_omega
        answer.g_raw, answer.g = np.zeros_like(p), np.zeros_like(p)
        for i in range(height):
            for j in range(width):
                answer.g_raw[i, j] = answer.s[i, j] * ce[i, j] / omega
                if answer.g_raw[i, j] * c_de >= t_de:
                    answer.g[i, j] = answer.g_raw[i, j]
        answer.ffi = magnitude(before) / p.size
        answer.mp = 0.0 if answer.ffi > t_ffi else magnitude(answer.g)
    return answers
