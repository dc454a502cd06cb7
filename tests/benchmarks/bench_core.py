"""One frame through the core, by each engine and by `cv2.filter2D` with the full kernels.

Not part of the test run. From the repository:

    python -m pytest tests/benchmarks/bench_core.py --benchmark-columns=median,iqr,rounds
"""

import itertools

import cv2
import numpy as np
import pytest

from dlgmd_cli import DLGMD, load_set
from dlgmd_cli.lab.bench.bench import SCENE
from dlgmd_cli.scenes.flights.scenes import find_scene, open_scene

SIZES = [(1080, 1920), (540, 960), (270, 480), (108, 192), (22, 38)]
N_FRAMES = 8
# Set 9 with less inhibition, so that something passes and answers can be compared.
PARAMS = load_set(9, a=0.4)


class FullKernels:
    """The model with one `filter2D` a delay, all else as plain as it can be."""

    def __init__(self, shape):
        signed = DLGMD(PARAMS).connections.signed()
        self.kernels = {delay: kernel.astype(np.float32) for delay, kernel in signed.items()}
        self.history = [np.zeros(shape, np.float32) for _ in range(max(signed) + 1)]
        self.previous = np.zeros(shape, np.float32)
        self.s, self.part = (np.empty(shape, np.float32) for _ in range(2))
        self.p_sums = [0.0, 0.0]

    def step(self, levels):
        luminance = np.multiply(levels, np.float32(1 / 255), dtype=np.float32)
        p = self.history.pop()
        cv2.absdiff(luminance, self.previous, dst=p)
        self.history.insert(0, p)
        self.previous = luminance
        self.p_sums = [self.p_sums[1], cv2.sumElems(p)[0]]
        for delay, kernel in sorted(self.kernels.items()):
            out = self.part if delay else self.s
            border = cv2.BORDER_CONSTANT
            cv2.filter2D(self.history[delay], -1, kernel, dst=out, borderType=border)
            if delay:
                cv2.add(self.s, self.part, dst=self.s)
        cv2.threshold(self.s, 0.0, 0.0, cv2.THRESH_TOZERO, dst=self.s)
        cv2.boxFilter(self.s, -1, (4, 4), self.part, (1, 1), False, cv2.BORDER_CONSTANT)
        g = cv2.multiply(self.s, self.part, dst=self.part)
        t_de = min(self.p_sums[0] * PARAMS.t0 / (g.size * PARAMS.m), 0.3)
        cv2.threshold(g, t_de, 0.0, cv2.THRESH_TOZERO, dst=g)
        cv2.threshold(g, 1.0, 0.0, cv2.THRESH_TRUNC, dst=g)
        return cv2.sumElems(self.s)[0], cv2.sumElems(g)[0]


@pytest.mark.parametrize("method", ["filter2D", "opencv", "numba"])
@pytest.mark.parametrize("shape", SIZES, ids=lambda shape: f"{shape[1]}x{shape[0]}")
def test_core(benchmark, set_threads, shape, method):
    set_threads(1)
    if method == "numba":
        pytest.importorskip("numba")
    options = {"size": shape, "frames": N_FRAMES}
    with open_scene(find_scene(SCENE), options, scale=1.0) as flight:
        frames = [frame.grey for frame in flight]
    plain = FullKernels(shape)
    model = DLGMD(PARAMS, engine="opencv" if method == "filter2D" else method)
    for frame in frames:
        s_sum, mp = plain.step(frame)
        response = model.step(frame)
    # What is timed below gives the same answers.
    assert response.s_sum == pytest.approx(s_sum, rel=1e-4, abs=1e-3)
    assert response.mp == pytest.approx(mp, rel=1e-4, abs=1e-3)
    step = plain.step if method == "filter2D" else model.step
    turns = itertools.cycle(frames)
    benchmark.group = f"{shape[1]}x{shape[0]}"
    benchmark(lambda: step(next(turns)))
