"""The LGMD with motion and contrast pathways, Fu, Li and Peng 2023."""

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.models.base import Answer, FloatImage
from dlgmd_cli.models.published import parts

# A cell minus the mean of the 8 cells around it.
_CONTRAST = np.full((3, 3), -1 / 8, np.float32)
_CONTRAST[1, 1] = 1.0


class McLGMDParameters(dlgmd_cli.Parameters):
    """Parameters of `McLGMD`."""

    source = "Fu, Li and Peng, Array 17, 2023"
    rest = 0.5

    formulation: str = parts.whose_code()
    beta: float = dlgmd_cli.key(0.4, "β", "–", "strength of inhibition", 0, 100)
    alpha1: float = dlgmd_cli.key(3.0, "α_1", "grey levels", "sensitivity to contrast", 1e-6, 1e3)
    sigma: float = dlgmd_cli.key(5.0, "σ", "px", "width of the surround, of 9x9 cells", 0.01, 1e3)
    c_omega: float = dlgmd_cli.key(4.0, "C_ω", "–", "divisor of max|Ce| in ω", 0.001, 1000)
    c_de: float = dlgmd_cli.key(0.5, "C_de", "–", "decay coefficient of G", 1e-6, 100)
    t_de: float = dlgmd_cli.key(0.7, "T_de", "–", "threshold of decayed G", 0, 1e6)
    gain: float = dlgmd_cli.key(10.0, "–", "–", "factor of k in the sigmoid", 1e-6, 1e6)
    t_mp: float = parts.threshold_2019()
    n_sp: int = parts.spikes_2019()


class McLGMD(dlgmd_cli.Model):
    """The LGMD of [Fu2023]: in two pathways, contrast inhibits motion.

    With grey levels L, and H the Gaussian of 9x9 cells of width sigma; for ON (+) and OFF (-)::

        P± = max(± (L(t) - L(t-1)), 0)
        M = tanh(P± / (P± ∗ H + alpha1)),  C = |M - mean of the 8 cells around it|
        S± = M(t) - beta M(t-1) ∗ w, with `NEIGHBOURS` w
        R± = max(S± - C, 0)
        S = R+ + R- + R+ R-,  G = S Ce / ω as in `LGMD2006`, 0 where c_de G < t_de
        k = mean G;  MP = 1 / (1 + exp(-gain k))

    This is the authors' code (fuqinbing/harmonizing-motion-and-contrast-vision-for-looming-
    detection), which mirrors the frame at its border without repeating the outermost cells. The
    benchmark (MingshuoXu/BiSTS, `LGMD_P_ON_OFF`) has zeros beyond the border, and keeps the
    negative part of OFF instead of the positive: R- = -min(S- - C, 0).
    """

    params_class = McLGMDParameters
    layer_units = ("grey levels", "–", "–")
    columns = ("k",)
    first_valid_frame = 0

    def __init__(self, params: McLGMDParameters | None = None) -> None:
        super().__init__(params)
        self._is_benchmark = self.params.formulation == "benchmark"
        self._border = parts.ZERO if self._is_benchmark else cv2.BORDER_REFLECT_101

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        params, receptors = self.params, self.receptors
        p = receptors.level_change()
        if receptors.frame == 0:
            self._on = self._off = p
            return p, p, p, {"mp": 0.5}
        self._on, on = self._pathway(parts.positive(p), self._on)
        self._off, off = self._pathway(parts.positive(-p), self._off)
        on, off = parts.positive(on), parts.positive(-off if self._is_benchmark else off)
        s = on * off
        s += on
        s += off
        receptors.clear(s)
        g = parts.grouped(s, params.t_de / params.c_de, params.c_omega, self._border)
        k = cv2.sumElems(g)[0] / self.n_cells
        return p, s, g, {"mp": parts.sigmoid(params.gain * k), "more": {"k": k}}

    def _pathway(self, p: FloatImage, last: FloatImage) -> tuple[FloatImage, FloatImage]:
        """M(t) of a pathway from P and M(t-1), and S - C."""
        surround = cv2.GaussianBlur(p, (9, 9), self.params.sigma, borderType=self._border)
        surround += np.float32(self.params.alpha1)
        m: FloatImage = np.tanh(np.divide(p, surround, out=surround), out=surround)
        s = parts.added(m, -self.params.beta, parts.convolved(last, parts.NEIGHBOURS, self._border))
        s -= np.abs(parts.convolved(m, _CONTRAST, self._border))
        return m, s
