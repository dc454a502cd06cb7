"""The LGMD on elementary motion detectors as nested loops in float64."""

import math
from dataclasses import dataclass

import numpy as np

DEFAULTS = {"tau_high": 8.0, "tau_low": 2.0, "delta": 0.02, "f_active": 0.05, "c": 2.0}


@dataclass
class Answer:
    """One frame's layers and sums; None where the history is too short to define them."""

    f: np.ndarray | None = None
    m: np.ndarray | None = None
    p_sum: float | None = None
    s_sum: float | None = None
    mp: float | None = None
    ffi: float | None = None


def low_pass(tau):
    """How far a first-order low-pass goes towards its input in a frame."""
    return 1.0 - math.exp(-1.0 / tau)


def expanded(field, delta):
    """The field expanded about its centre: every cell looks a little nearer to the centre."""
    height, width = field.shape
    out = np.zeros_like(field)
    for i in range(height):
        for j in range(width):
            y = (height - 1) / 2 + (i - (height - 1) / 2) / (1.0 + delta)
            x = (width - 1) / 2 + (j - (width - 1) / 2) / (1.0 + delta)
            top, left = math.floor(y), math.floor(x)
            below, right = min(top + 1, height - 1), min(left + 1, width - 1)
            down, across = y - top, x - left
            out[i, j] = (
                field[top, left] * (1 - down) * (1 - across)
                + field[below, left] * down * (1 - across)
                + field[top, right] * (1 - down) * across
                + field[below, right] * down * across
            )
    return out


def run(frames, *, tau_high, tau_low, delta, f_active, c):
    """One `Answer` for every frame, (H, W) luminance in 0..1."""
    answers = []
    mean = delayed = None
    for t, frame in enumerate(frames):
        answer = Answer()
        answers.append(answer)
        luminance = frame.astype(float)
        if t == 0:
            mean, delayed = luminance.copy(), np.zeros_like(luminance)
            continue
        height, width = luminance.shape
        answer.f = np.zeros_like(luminance)
        for i in range(height):
            for j in range(width):
                mean[i, j] += low_pass(tau_high) * (luminance[i, j] - mean[i, j])
                answer.f[i, j] = luminance[i, j] - mean[i, j]
                delayed[i, j] += low_pass(tau_low) * (answer.f[i, j] - delayed[i, j])
        answer.p_sum = sum(abs(float(value)) for value in answer.f.flat)
        if t < 2:
            continue
        z_d, z_f = expanded(delayed, delta), expanded(answer.f, delta)
        answer.m = np.zeros_like(luminance)
        active = 0
        for i in range(height):
            for j in range(width):
                motion = z_d[i, j] * answer.f[i, j] - delayed[i, j] * z_f[i, j]
                answer.m[i, j] = max(motion, 0.0)
                active += abs(answer.f[i, j]) > f_active
        answer.s_sum = sum(float(value) for value in answer.m.flat)
        answer.ffi = active / luminance.size
        answer.mp = answer.s_sum * math.exp(-c * answer.ffi)
    return answers
