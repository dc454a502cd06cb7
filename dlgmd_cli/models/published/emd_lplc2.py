"""The fly's LPLC2 cells on motion detectors, with a giant fibre, Zhao et al. 2023."""

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.frame import Flags, FloatArray, FloatImage
from dlgmd_cli.models.base import Answer
from dlgmd_cli.models.published import parts

# The four branches of a cell: _LONG cells outward from its centre, _WIDE across.
_LONG, _WIDE = 50, 40
# x + _ROUNDING - _ROUNDING is x rounded to 2⁻³⁶. The running sums of such numbers are exact, so
# that a branch without motion sums to 0.
_ROUNDING = 1.5 * 2.0**16
# Steps of the giant fibre between two frames.
_N_STEPS = 20


class EmdLplc2Parameters(dlgmd_cli.Parameters):
    """Parameters of `EmdLplc2`."""

    source = "Zhao et al., iScience 26(4), 2023"
    rest = 0.5

    formulation: str = parts.whose_code()
    interval: float = dlgmd_cli.key(0.01, "Δ", "s", "interval of the frames", 1e-4, 10)
    tau_low: float = dlgmd_cli.key(0.05, "τ_L", "s", "time constant of the delay", 0, 100)
    tau_high: float = dlgmd_cli.key(0.25, "τ_H", "s", "time constant of the high-pass", 1e-4, 100)
    t_off: float = dlgmd_cli.key(0.05, "–", "luminance", "F below which OFF is active", 0, 1)
    t_branch: float = dlgmd_cli.key(1.5, "–", "–", "outward motion of an active branch", 0, 1e6)
    t_inward: float = dlgmd_cli.key(-2.0, "–", "–", "B at which a branch silences", -1e6, 1e6)
    n_branches: int = dlgmd_cli.key(3, "–", "–", "active branches of an active cell", 1, 4)
    w: float = dlgmd_cli.key(250.0, "w", "–", "gain of the current", 0, 1e6)
    n_max: float = dlgmd_cli.key(2500.0, "–", "cells", "cells that scale the current", 1, 1e9)
    n_rise: float = dlgmd_cli.key(1440.0, "–", "cells", "rise that scales the current", 1, 1e9)
    v_rest: float = dlgmd_cli.key(-60.0, "V_0", "mV", "resting potential", -80, 0)
    v_th: float = dlgmd_cli.key(-50.0, "V_th", "mV", "potential of a spike", -80, 0)
    v_reset: float = dlgmd_cli.key(-70.0, "V_re", "mV", "potential after a spike", -80, 0)
    resistance: float = dlgmd_cli.key(10.0, "R", "–", "resistance", 0, 1e6)
    tau: float = dlgmd_cli.key(0.3, "τ", "s", "time constant of the giant fibre", 1e-3, 100)
    # Any spike of the fibre is the authors' alarm.
    t_mp: float = dlgmd_cli.key(parts.sigmoid(10.0), "–", "–", "MP at V_th, 10 mV above rest", 0, 1)
    n_sp: int = dlgmd_cli.key(1, "n_sp", "frames", "spikes in a row that raise an alarm", 1, 1000)


class EmdLplc2(dlgmd_cli.Model):
    """The fly's escape pathway of [Zhao2023b]: cells whose motion points outward, and their rise.

    With luminance L in 0..1, h = tau_high / interval and l = tau_low / interval::

        F(t) = h / (h + 1) (L(t) - L(t-1) + F(t-1)),  F(0) = 0
        ON = max(F, 0),  OFF = max(t_off - F, 0)
        D(t) = (X(t) + l D(t-1)) / (l + 1), the delayed ON or OFF; x' is the next cell along an axis
        M = Σ X(x) D(x') - Σ D(x) X(x') over ON and OFF: motion to the left, or upward
        B = ΣM of a branch, the 50x40 cells on one side, outward positive: left, right, up, down
        N = number of cells where at least n_branches have B > t_branch, and all B > t_inward, B ≠ 0
        I = w N(t) / n_max (N(t) - N(t-1)) / n_rise, 0 if N(t-1) = 0
        τ v' = v_rest - v + R I, 20 steps a frame (Runge-Kutta); v = v_reset after v > v_th
        MP = 1 / (1 + exp(-max(v - v_rest, 0))), where v is 20 mV in a frame with a spike

    These are the authors' values for videos (zhaojunyu01/EMD-LPLC2-GF-model, part 7), which they
    reduce to a quarter; their first tests need four branches above 2 (n_branches=4, t_branch=2,
    t_inward=2). Their fibre never leaves -80 mV once it falls there.

    The benchmark (MingshuoXu/BiSTS) turns convolution into correlation, so that a branch looks at
    the opposite side: it counts cells with inward motion, of receding objects. Its v is that after
    the reset, and leaves -80 mV again.
    """

    params_class = EmdLplc2Parameters
    layer_units = ("luminance", "luminance²", "cells")
    columns = ("n_active", "v")
    first_valid_frame = 0

    def reset(self) -> None:
        """Forget all earlier frames."""
        super().reset()
        params = self.params
        self._n_active, self._v = 0, params.v_rest
        stays = params.tau_high / (params.tau_high + params.interval)
        self._high_pass = parts.LowPass(stays, stays)
        stays = params.tau_low / (params.tau_low + params.interval)
        self._delays = [parts.LowPass(1.0 - stays, stays) for _ in ("on", "off")]

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        now = self.receptors.levels() / np.float32(255.0)
        if self.receptors.frame == 0:
            self._last, zero = now, np.zeros_like(now)
            more = {"n_active": 0, "v": self._v}
            return zero, zero, zero, {"mp": 0.5, "more": more}
        high = self._high_pass(now - self._last)
        self._last = now
        left, up = self._motion(high)
        active = self._active(left, up)
        n_active = int(np.count_nonzero(active))
        v = self._fibre(n_active)
        mp = parts.sigmoid(max(v - self.params.v_rest, 0.0))
        more = {"n_active": n_active, "v": v}
        s = np.abs(left) + np.abs(up)
        return high, s, active.astype(np.float32), {"mp": mp, "more": more}

    def _motion(self, high: FloatImage) -> list[FloatImage]:
        """M to the left and upward. The cells of the last row and column have none."""
        on, off = parts.positive(high), parts.positive(self.params.t_off - high)
        self.receptors.clear(on)
        self.receptors.clear(off)
        pathways = (on, self._delays[0](on)), (off, self._delays[1](off))
        here, right, below = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, :-1]
        motions = []
        for there in (right, below):
            motion = sum(x[here] * late[there] for x, late in pathways)
            motion -= sum(late[here] * x[there] for x, late in pathways)
            motions.append(np.pad(motion, (0, 1)))
        return motions

    def _active(self, left: FloatImage, up: FloatImage) -> Flags:
        """Whether each cell is active; those of the last row and column never are."""
        params = self.params
        branches = [*_branches(left), *(np.ascontiguousarray(b.T) for b in _branches(up.T))]
        if params.formulation == "benchmark":
            branches = [-b for b in branches]
        active = np.sum([b > params.t_branch for b in branches], axis=0) >= params.n_branches
        for b in branches:
            active &= (b > params.t_inward) & (b != 0.0)
        active[-1], active[:, -1] = False, False
        self.receptors.clear(active)
        return active

    def _fibre(self, n_active: int) -> float:
        """The potential of the giant fibre in the next frame, mV."""
        params, last = self.params, self._n_active
        current = params.w * n_active / params.n_max * (n_active - last) / params.n_rise
        goal = params.v_rest + params.resistance * (current if last else 0.0)
        z = params.interval / _N_STEPS / params.tau
        stays = 1 - z + z**2 / 2 - z**3 / 6 + z**4 / 24  # a step of Runge-Kutta
        has_spike, is_benchmark = False, params.formulation == "benchmark"
        for _ in range(_N_STEPS):
            self._v = max(self._v, -80.0)
            if self._v > -80.0 or is_benchmark:
                self._v = goal + (self._v - goal) * stays
            if self._v > params.v_th:
                self._v, has_spike = params.v_reset, True
        self._n_active = n_active
        return 20.0 if has_spike and not is_benchmark else self._v


def _branches(motion: FloatImage) -> tuple[FloatArray, FloatArray]:
    """ΣM outward over the branch to the left and over that to the right of each cell."""
    rounded = np.add(motion, _ROUNDING, dtype=np.float64) - _ROUNDING
    wide = cv2.copyMakeBorder(rounded, 0, 0, 0, _LONG, parts.ZERO)
    size, anchor = (_LONG, _WIDE), (_LONG - 1, _WIDE // 2 - 1)
    sums = np.empty(wide.shape)
    cv2.boxFilter(wide, -1, size, sums, anchor, normalize=False, borderType=parts.ZERO)
    return sums[:, :-_LONG], -sums[:, _LONG:]
