"""The cascade of an LGMD1 and an LGMD2, Li et al. 2023."""

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.models.base import Answer, FloatImage
from dlgmd_cli.models.published import parts

# The weights of x(t), D[x](t-1) and D[x](t-2).
_LOW_PASS = 0.2, 0.5, 0.3
# An LGMD2 inhibits ON with 0.4 of the weights. A float32, since these cascades amplify a last bit.
_ON_KERNEL = np.float32(0.4) * parts.NEIGHBOURS
_MEAN = np.full((3, 3), 1 / 9, np.float32)


class CascadeParameters(dlgmd_cli.Parameters):
    """Parameters of both cascades."""

    source = "Li et al., IJCNN, 2023; values of the LGMD benchmark, MingshuoXu/BiSTS"
    rest = 0.5

    formulation: str = parts.whose_code()
    a: float = dlgmd_cli.key(0.1, "a", "–", "weight of the high-pass and of adaptation", 0, 1)
    persistence: float = dlgmd_cli.key(0.1, "d_c", "–", "share of ON and OFF that stays", 0, 0.99)
    sigma: float = dlgmd_cli.key(1.5, "σ", "px", "width of the blur, of 7x7 cells", 0.01, 100)
    t_ffi: float = dlgmd_cli.key(40.0, "T_FFI", "grey levels", "FFI at which w is 1", 0.001, 1e6)
    base_on: float = dlgmd_cli.key(0.3, "–", "–", "least strength of inhibition, ON", 0, 100)
    base_off: float = dlgmd_cli.key(0.15, "–", "–", "least strength of inhibition, OFF", 0, 100)
    c_cn: float = dlgmd_cli.key(1.0, "C_cn", "grey levels", "half-saturation contrast", 1e-6, 1e6)
    t_sfa: float = dlgmd_cli.key(0.01, "T_sfa", "–", "threshold of G and of its rise", 0, 1)
    gain: float = dlgmd_cli.key(200.0, "–", "–", "factor of k in the sigmoid", 1e-6, 1e6)
    # The authors' V_th is not public. The benchmark's neuron rests at 0.5, too.
    t_mp: float = dlgmd_cli.key(0.9, "V_th", "–", "spiking threshold of MP, BiSTS", 0, 1)
    n_sp: int = parts.spikes_2019()


class Lgmd1Lgmd2(dlgmd_cli.Model):
    """The cascade of [Li2023]: an LGMD2 sees the changes in the layer S of an LGMD1.

    With grey levels L, zero outside the frame, `NEIGHBOURS` N, a Gaussian H of 7x7 cells, and the
    low-pass D[x](t) = 0.2 x(t) + 0.5 D[x](t-1) + 0.3 D[x](t-2); for ON (+) and OFF (-)::

        P(t) = a (P(t-1) + L(t) - L(t-1)),  X_1 = P ∗ H,  X_2(t) = S_1(t) - S_1(t-1)
        FFI = D[mean|P|],  w- = max(FFI / t_ffi, base_off),  w+ = max(2 w-, base_on)
        ON(t) = max(X(t), 0) + persistence ON(t-1), OFF(t) likewise of -X;  E = ON ∗ N, OFF ∗ N
        S = max(E+ - w D[E+] ∗ N, 0) + max(E- - w- D[E-] ∗ N, 0)
            w = w- in the LGMD1 and 0.4 w+ in the LGMD2
        G = mean of 3x3 cells of tanh(S_2 / (c_cn + mean of 3x3 cells of S_2)), 0 below t_sfa
        Ĝ(t) = max(a G(t) + a (Ĝ(t-1) - G(t-1)), 0), where G rises by more than t_sfa max(a G(t), 0)
        k = mean Ĝ;  MP = 1 / (1 + exp(-gain k))

    The authors' code (fuqinbing/Ensemble-of-LGMD-Models) takes its parameters as arguments; all
    values are those of the benchmark. Its leaky neuron with V = ΣĜ is therefore left out: it
    answers V(t-1) exp(-age / T_in) + V(t) - V_th spike + V_rest, and the benchmark, whose response
    is the MP above, discards that. Its test whether E D[E] ∗ N ≥ 0 is always passed.

    The benchmark (MingshuoXu/BiSTS) takes P(t-1) for L(t-1), so that P = a L but for rounding, and
    mirrors P at the border of the frame for the blur.
    """

    params_class = CascadeParameters
    layer_units = ("grey levels", "grey levels", "–")
    columns = ("k",)
    first_valid_frame = 0
    # Whether the first and the second LGMD are an LGMD2, whose ON inhibits with other weights.
    are_lgmd2 = False, True

    def __init__(self, params: CascadeParameters | None = None) -> None:
        super().__init__(params)
        row = np.exp(-0.5 * (np.arange(-3, 4, dtype=np.float32) / self.params.sigma) ** 2)
        row /= row.sum()
        self._blur = np.outer(row, row)

    def reset(self) -> None:
        """Forget all earlier frames."""
        super().reset()
        self._p = self._s = self._g = self._adapted = np.zeros((1, 1), np.float32)
        self._ffi = parts.LowPass(*_LOW_PASS)
        self._pathways = [  # of each LGMD, those that give ON and OFF, and their D[E]
            [(parts.LowPass(1.0, self.params.persistence), parts.LowPass(*_LOW_PASS)) for _ in "+-"]
            for _ in self.are_lgmd2
        ]

    def respond(self) -> Answer:
        """The answer to the newest frame, see `Model.respond`."""
        params, receptors, border = self.params, self.receptors, parts.ZERO
        if params.formulation == "benchmark":
            border = cv2.BORDER_REFLECT_101
            self._p = params.a * (self._p + receptors.levels() - self._p)
        else:
            self._p = params.a * (self._p + receptors.level_change())
        ffi = self._ffi(parts.summed(np.abs(self._p)) / self.n_cells)
        w_off = max(ffi / params.t_ffi, params.base_off)
        x = parts.convolved(self._p, self._blur, border)
        receptors.clear(x)
        first = self._layer_s(0, x, w_off)
        s = self._layer_s(1, first - self._s, w_off)
        self._s = first
        k = self._adapt(s)
        numbers = {"mp": parts.sigmoid(params.gain * k), "ffi": float(ffi), "more": {"k": k}}
        return self._p, s, self._adapted, numbers

    def _layer_s(self, place: int, x: FloatImage, w_off: float) -> FloatImage:
        """The layer S of the first LGMD (0) or of the second (1) from the change of its input."""
        w_on, on_kernel = w_off, parts.NEIGHBOURS
        if self.are_lgmd2[place]:
            w_on, on_kernel = max(2 * w_off, self.params.base_on), _ON_KERNEL
        s = np.zeros_like(x)
        inputs = (x, w_on, on_kernel), (-x, w_off, parts.NEIGHBOURS)
        for (part, w, kernel), (wave, delayed) in zip(inputs, self._pathways[place], strict=True):
            e = parts.convolved(wave(parts.positive(part)), parts.NEIGHBOURS)
            self.receptors.clear(e)
            s += parts.positive(e - w * parts.convolved(delayed(e), kernel))
        return s

    def _adapt(self, s: FloatImage) -> float:
        """The mean of Ĝ of the next frame."""
        params = self.params
        g = parts.convolved(np.tanh(s / (params.c_cn + parts.convolved(s, _MEAN))), _MEAN)
        self.receptors.clear(g)
        g = parts.at_least(g, params.t_sfa)
        adapted = params.a * (self._adapted - self._g) * (g - self._g <= params.t_sfa)
        self._g, self._adapted = g, parts.positive(params.a * g + adapted)
        return cv2.sumElems(self._adapted)[0] / self.n_cells
