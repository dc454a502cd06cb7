"""The LGMD for angular acceleration, Zhao et al. 2024."""

import math

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.models.base import Answer, FloatImage
from dlgmd_cli.models.published import parts

_SCALE = {"authors": 10.0, "benchmark": 1.0}
_T_MP = {"authors": parts.sigmoid(4.0), "benchmark": 1.0}


class ALGMDParameters(dlgmd_cli.Parameters):
    """Parameters of `ALGMD`."""

    source = "Zhao et al., Biomimetics 9(1), 2024"
    rest = 0.5

    formulation: str = parts.whose_code()
    r_low: int = dlgmd_cli.key(1, "r_1", "px", "radius of inhibition for low speeds", 1, 16)
    r_high: int = dlgmd_cli.key(1, "r_2", "px", "radius of inhibition for high speeds", 1, 16)
    t_low: float = dlgmd_cli.key(0.03, "–", "luminance", "threshold of V_low", 0, 1)
    t_high: float = dlgmd_cli.key(0.1, "–", "luminance", "threshold of V_high and of A", 0.001, 1)
    a: float = dlgmd_cli.key(0.02, "a", "1/ms", "rate of recovery", 0, 1)
    b: float = dlgmd_cli.key(0.2, "b", "–", "sensitivity of recovery", 0, 1)
    c: float = dlgmd_cli.key(-65.0, "c", "mV", "potential after a reset and at the start", -100, 0)
    d: float = dlgmd_cli.key(2.0, "d", "mV/ms", "recovery added by a reset", 0, 100)
    v_reset: float = dlgmd_cli.key(30.0, "–", "mV", "potential that is reset", -100, 1000)
    interval: float = dlgmd_cli.key(1 / 30, "Δ", "s", "frame n steps n thousandths of it", 1e-6, 10)
    scale: float = dlgmd_cli.key(_SCALE, "–", "mV", "v - c at which MP is 0.73", 0.01, 1000)
    t_mp: float = dlgmd_cli.key(_T_MP, "–", "–", "MP at the authors' trigger, -25 mV", 0, 1)
    n_sp: int = dlgmd_cli.key(1, "n_sp", "frames", "spikes in a row that raise an alarm", 1, 1000)


def _kernel(radius: int, *, high: bool) -> FloatImage:
    """Inhibition from a disc of cells, which rises with the distance for low speeds."""
    x = np.arange(-radius, radius + 1)
    squares = np.add.outer(x**2, x**2)
    z = np.exp(-squares / (2 * radius**2))
    z = (z if high else 1 - z) / (2 * math.pi * radius**2)
    z *= np.rint(1 / z[z > 0].min()) * (squares <= radius**2)
    z[radius, radius] = 1
    return z.astype(np.float32)


class ALGMD(dlgmd_cli.Model):
    """The A-LGMD of [Zhao2024]: cells that have just passed from a low to a high speed.

    With luminance L in 0..1, L(-1) = 0, and discs of inhibition K_low and K_high::

        P(t) = |L(t) - L(t-1)|
        V_low(t) = P(t) - P(t-1) ∗ K_low,  V_high(t) = P(t) - P(t-1) ∗ K_high
        N_V = number of cells with V_high(t) ≥ t_high
        N_A = number of cells within 2 r_high - r_low + 1 rows and columns of such a cell, with
              V_low(t-1) > t_low and V_high(t-1) ≤ t_high
        v' = 0.04 v² + 5 v + 140 - u + N_A N_V,  u' = a (b v - u), after Izhikevich
        (v, u)(t) = (v, u)(t-1) + (n interval / 1000) (v', u'),  n = t from t = 2 on
        v = c and u = u(t-1) + d where v(t) ≥ v_reset
        MP = 1 / (1 + exp(-max(v - c, 0) / scale))

    The step of time grows with the number n of the frame, as in the authors' MATLAB
    (chasen-xqs/ALGMD, A_realtime_final.m). That reduces frames to 320x240, gives v without a
    sigmoid, whose scale is ours, and raises an alarm one frame after a peak of v above -25 mV. An
    input so strong that v passes v_reset in one step leaves no peak.

    The benchmark (MingshuoXu/BiSTS) compares |V_low| and |V_high| of the last frame with the
    thresholds, starts the neuron at once, with n = t + 1, and has u = u(t) + d after a reset and
    scale = 1.
    """

    params_class = ALGMDParameters
    layer_units = ("luminance", "luminance", "cells")
    columns = ("v",)
    first_valid_frame = 0

    def __init__(self, params: ALGMDParameters | None = None) -> None:
        super().__init__(params)
        params = self.params
        self._is_benchmark = params.formulation == "benchmark"
        self._kernels = _kernel(params.r_low, high=False), _kernel(params.r_high, high=True)
        side = 2 * max(2 * params.r_high - params.r_low + 1, 0) + 1
        self._around = np.ones((side, side), np.uint8)

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        params, receptors = self.params, self.receptors
        now = receptors.levels() / np.float32(255.0)
        if receptors.frame == 0:
            self._last = self._p = np.zeros_like(now)
            self._slowed = np.zeros(now.shape, np.bool_)
            self._v, self._u = params.c, 0.0
        p = np.abs(now - self._last)
        low, high = (p - parts.convolved(self._p, kernel) for kernel in self._kernels)
        is_fast = high >= np.float32(params.t_high)
        s = high * is_fast
        is_near = cv2.dilate(is_fast.view(np.uint8), self._around).view(np.bool_)
        is_faster = is_near & self._slowed
        receptors.clear(is_fast)
        receptors.clear(is_faster)
        self._integrate(np.count_nonzero(is_faster) * np.count_nonzero(is_fast))
        if self._is_benchmark:
            low, high = np.abs(low), np.abs(high)
        self._slowed = (low > np.float32(params.t_low)) & (high <= np.float32(params.t_high))
        self._last, self._p = now, p
        g = is_faster.astype(np.float32)
        if receptors.frame == 0:  # P is the frame itself, a change for the model only
            p = s = g
        mp = parts.sigmoid(max(self._v - params.c, 0.0) / params.scale)
        return p, s, g, {"mp": mp, "more": {"v": self._v}}

    def _integrate(self, current: int) -> None:
        """The potential and the recovery of the next frame."""
        params, v, u = self.params, self._v, self._u
        t = self.receptors.frame
        n = t + 1 if self._is_benchmark else t if t > 1 else 0
        step = n * params.interval / 1000
        self._v = v + step * (0.04 * v * v + 5.0 * v + 140.0 - u + current)
        self._u = u + step * params.a * (params.b * v - u)
        if self._v >= params.v_reset:
            self._v, self._u = params.c, (self._u if self._is_benchmark else u) + params.d
