"""The LGMD with ON and OFF pathways and spike frequency adaptation, Fu et al. 2018."""

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.models.base import Answer
from dlgmd_cli.models.published import parts


class SfaLGMDParameters(dlgmd_cli.Parameters):
    """Parameters of `SfaLGMD`."""

    source = "Fu et al., Neural Networks 106, 2018"
    rest = 0.5

    formulation: str = parts.whose_code()
    rate: float = dlgmd_cli.key(30.0, "1/τ_in", "frames/s", "rate of the frames", 0.1, 1e4)
    tau_1: float = dlgmd_cli.key(30.0, "τ_1", "ms", "delay from the four nearest cells", 0, 1e4)
    tau_2: float = dlgmd_cli.key(60.0, "τ_2", "ms", "delay from the corners", 0, 1e4)
    tau_ffi: float = dlgmd_cli.key(
        {"authors": 90.0, "benchmark": 9700 / 9}, "τ_ffi", "ms", "delay of FFI", 0, 1e5
    )
    tau_slow: float = dlgmd_cli.key(700.0, "τ_4", "ms", "adaptation while MP accelerates", 0, 1e6)
    tau_fast: float = dlgmd_cli.key(300.0, "τ_5", "ms", "adaptation else", 0, 1e6)
    w_1: float = dlgmd_cli.key(0.3, "w_1", "–", "strength of inhibition, ON", 0, 100)
    w_2: float = dlgmd_cli.key(0.6, "w_2", "–", "strength of inhibition, OFF", 0, 100)
    persistence: float = dlgmd_cli.key(0.1, "α", "–", "share of ON and OFF that stays", 0, 0.99)
    t_g: float = dlgmd_cli.key(10.0, "T_g", "grey levels", "threshold of G", 0, 1e6)
    t_ffi: float = dlgmd_cli.key(10.0, "T_FFI", "grey levels", "FFI that silences the cell", 0, 255)
    t_sfa: float = dlgmd_cli.key(0.0015, "T_sfa", "–", "change of MP that is a rise", 0, 1)
    t_mp: float = parts.threshold_2019()
    n_sp: int = parts.spikes_2019()


class SfaLGMD(dlgmd_cli.Model):
    """The LGMD of [Fu2018]: the response adapts unless its rise accelerates.

    With grey levels L, zero outside the frame, `NEIGHBOURS` w, the frames' interval Δ in ms, and
    D[X] = Σ w (a X(t) + (1 - a) X(t-1)) with a = Δ / (Δ + τ) by the distance of the cell::

        ON(t) = max(L(t) - L(t-1), 0) + persistence ON(t-1), OFF(t) likewise
        S = ON - w_1 D[ON] + D[OFF] - w_2 OFF
        Ĝ = mean of 3x3 cells of S, where that is at least t_g, else 0
        k = mean|Ĝ|;  U = 1 / (1 + exp(-k)), 0.5 if F ≥ t_ffi
        F(t) = b mean|L(t) - L(t-1)| + (1 - b) F(t-1),  b = Δ / (Δ + tau_ffi)
        MP(t) = c_slow U(t)                  if U'(t) - U'(t-1) ≥ t_sfa,  U'(t) = U(t) - U(t-1)
        MP(t) = c_fast U(t)                  else if U'(t) ≥ t_sfa
        MP(t) = c_fast (MP(t-1) + U'(t))     else;  all at least 0.5, with c = τ / (τ + Δ)

    The authors' C# (fuqinbing/LGMD-Plus-and-GAs-Open-Source, LGMDs.cs) low-passes the input of a
    delayed connection, as above. The benchmark (MingshuoXu/BiSTS, `SFA_LGMD`) takes the last D[X]
    where X(t-1) belongs, and has b = 1/Δ, which is tau_ffi = 1078 ms at 30 frames/s.
    """

    params_class = SfaLGMDParameters
    layer_units = ("grey levels", "grey levels", "grey levels")
    columns = ("k",)
    first_valid_frame = 0

    def __init__(self, params: SfaLGMDParameters | None = None) -> None:
        super().__init__(params)
        params, interval = self.params, 1e3 / self.params.rate
        near, far = params.tau_1, params.tau_2
        tau = np.array([[far, near, far], [near, 0.0, near], [far, near, far]])
        share = (interval / (interval + tau)).astype(np.float32)
        self._now, self._earlier = parts.NEIGHBOURS * share, parts.NEIGHBOURS * (1.0 - share)
        self._slow = params.tau_slow / (params.tau_slow + interval)
        self._fast = params.tau_fast / (params.tau_fast + interval)
        self._is_benchmark = params.formulation == "benchmark"
        self._ffi_share = interval / (interval + params.tau_ffi)

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        params, receptors = self.params, self.receptors
        p = receptors.level_change()
        if receptors.frame == 0:
            self._on = self._off = self._waiting = p
            self._ffi, self._u, self._u_change, self._mp = 0.0, 0.5, 0.0, 0.5
            return p, p, p, {"mp": 0.5}
        self._on = on = parts.added(parts.positive(p), params.persistence, self._on)
        self._off = off = parts.added(parts.positive(-p), params.persistence, self._off)
        # Both D at once, since they are linear: D[OFF] - w_1 D[ON].
        delayed = parts.added(off, -params.w_1, on)
        late = parts.convolved(delayed, self._now)
        late += parts.convolved(self._waiting, self._earlier)
        self._waiting = late if self._is_benchmark else delayed
        s = parts.added(on, -params.w_2, off)
        s += late
        receptors.clear(s)
        g = parts.at_least(parts.mean3(s), params.t_g)
        receptors.clear(g)
        k = cv2.sumElems(g)[0] / self.n_cells
        change = cv2.norm(p, cv2.NORM_L1) / self.n_cells
        self._ffi += self._ffi_share * (change - self._ffi)
        self._adapt(0.5 if self._ffi >= params.t_ffi else parts.sigmoid(k))
        return p, s, g, {"mp": self._mp, "ffi": self._ffi, "more": {"k": k}}

    def _adapt(self, u: float) -> None:
        """MP of the next frame from U."""
        change, t_sfa = u - self._u, self.params.t_sfa
        if change - self._u_change >= t_sfa:
            mp = self._slow * u
        elif change >= t_sfa:
            mp = self._fast * u
        else:
            mp = self._fast * (self._mp + change)
        self._mp, self._u, self._u_change = max(mp, 0.5), u, change
