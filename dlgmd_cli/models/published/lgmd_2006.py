"""The LGMD with a grouping layer, Yue and Rind 2006."""

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.models.base import Answer
from dlgmd_cli.models.published import parts


class LGMD2006Parameters(dlgmd_cli.Parameters):
    """Parameters of `LGMD2006`."""

    source = "Yue and Rind, IEEE TNN 17(3), 2006"
    rest = 0.5

    w_i: float = dlgmd_cli.key(0.3, "W_I", "–", "strength of inhibition", 0, 100)
    p1: float = dlgmd_cli.key(0.0, "p_1", "–", "persistence of change after one frame", 0, 0.5)
    p2: float = dlgmd_cli.key(0.0, "p_2", "–", "persistence of change after two frames", 0, 0.49)
    c_omega: float = dlgmd_cli.key(4.0, "C_ω", "–", "divisor of max|Ce| in ω", 0.001, 1000)
    c_de: float = dlgmd_cli.key(0.5, "C_de", "–", "decay coefficient of G", 1e-6, 100)
    t_de: float = dlgmd_cli.key(15.0, "T_de", "grey levels", "threshold of decayed G", 0, 1e6)
    t_ffi: float = dlgmd_cli.key(
        255.0, "T_FFI", "grey levels", "mean change that silences the cell; 255 never", 0, 255
    )
    t_mp: float = parts.threshold_2019()
    n_sp: int = parts.spikes_2019()


class LGMD2006(dlgmd_cli.Model):
    """The LGMD of [Yue2006]: the response is the sigmoid of the mean of G.

    With grey levels L, 0 to 255, zero outside the frame, and `NEIGHBOURS` w::

        P(t) = L(t) - L(t-1) + p1 P(t-1) + p2 P(t-2)
        S = |P(t)| - w_i |P(t-1) ∗ w|
        Ce = S ∗ ones(3, 3)/9,  ω = 0.01 + max|Ce| / c_omega,  G = S Ce / ω
        G̃ = G where c_de G ≥ t_de, else 0
        k = mean|G̃|, 0 if mean|P(t-1)| ≥ t_ffi;  MP = 1 / (1 + exp(-k))

    There is no public code of its authors. Their persistence p_i = 1 / (1 + exp(μ i)) leaves μ
    open, and the benchmark (MingshuoXu/BiSTS, `BasicLGMD`) has none and no FFI: nor has the
    default. The model `lgmd`, of another laboratory, subtracts without the absolute values.
    """

    params_class = LGMD2006Parameters
    layer_units = ("grey levels", "grey levels", "grey levels")
    columns = ("k",)
    first_valid_frame = 0

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        params, receptors = self.params, self.receptors
        p = receptors.level_change()
        if receptors.frame == 0:
            self._p = [p, p]
        last, before = self._p
        p = parts.added(parts.added(p, params.p1, last), params.p2, before)
        self._p = [p, last]
        if receptors.frame < 2:  # no P(t-1) yet
            return p, 0 * p, 0 * p, {"mp": 0.5}
        s = parts.added(np.abs(p), -params.w_i, np.abs(parts.convolved(last, parts.NEIGHBOURS)))
        receptors.clear(s)
        g = parts.grouped(s, params.t_de / params.c_de, params.c_omega)
        ffi = cv2.norm(last, cv2.NORM_L1) / self.n_cells
        k = 0.0 if ffi >= params.t_ffi else cv2.norm(g, cv2.NORM_L1) / self.n_cells
        return p, s, g, {"mp": parts.sigmoid(k), "ffi": ffi, "more": {"k": k}}
