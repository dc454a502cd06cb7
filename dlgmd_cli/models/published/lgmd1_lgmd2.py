"""The cascade of an LGMD1 and an LGMD2, Li et al. 2023."""

from dataclasses import dataclass

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli.models.base import FloatImage, Grey
from dlgmd_cli.models.published import parts

# The weights of x(t), y(t-1) and y(t-2) in every low-pass y of x.
_NOW, _LAST, _BEFORE = 0.2, 0.5, 0.3
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


@dataclass
class Pathway:
    """What the ON or the OFF pathway of an LGMD remembers; `kernel` spreads its inhibition."""

    kernel: FloatImage
    wave: FloatImage
    late: tuple[FloatImage, FloatImage]  # D[E] of the last two frames


class Lgmd1Lgmd2(dlgmd_cli.Model):
    """The cascade of [Li2023]: an LGMD2 sees what changes in the layer S of an LGMD1.

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
    # How the first and the second LGMD inhibit ON; an LGMD2 does so with other weights.
    on_kernels = parts.NEIGHBOURS, _ON_KERNEL

    def __init__(self, params: CascadeParameters | None = None) -> None:
        super().__init__(params)
        self._is_benchmark = self.params.formulation == "benchmark"
        self._border = cv2.BORDER_REFLECT_101 if self._is_benchmark else parts.ZERO
        row = np.exp(-0.5 * (np.arange(-3, 4, dtype=np.float32) / self.params.sigma) ** 2)
        row /= row.sum()
        self._blur = np.outer(row, row)

    def _begin(self, levels: FloatImage) -> None:
        """Start from rest."""
        zero = np.zeros_like(levels)
        self._levels, self._ffi = levels, (0.0, 0.0)
        self._p = self._s = self._g = self._adapted = zero
        self._first, self._second = (
            [Pathway(kernel, zero, (zero, zero)) for kernel in (on_kernel, parts.NEIGHBOURS)]
            for on_kernel in self.on_kernels
        )

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> dlgmd_cli.Response:
        """Process the next frame, see `Model.step`."""
        params, receptors = self.params, self.receptors
        receptors.take(luminance)
        levels = receptors.levels()
        if receptors.frame == 0:
            self._begin(levels)
        earlier = self._p if self._is_benchmark else self._levels
        self._levels, self._p = levels, params.a * (self._p + levels - earlier)
        x = parts.convolved(self._p, self._blur, self._border)
        receptors.clear(x)
        weights = self._weights()
        first = self._layer_s(self._first, x, weights[0])
        s = self._layer_s(self._second, first - self._s, weights[1])
        self._s = first
        k = self._adapt(s)
        return dlgmd_cli.Response.of(
            *(self._p, s, self._adapted),
            layers=layers,
            mp=parts.sigmoid(params.gain * k),
            ffi=float(self._ffi[0]),
            more={"k": k},
        )

    def _weights(self) -> list[tuple[float, float]]:
        """The strength of inhibition of ON and OFF in the first and in the second LGMD."""
        params, (last, before) = self.params, self._ffi
        mean = parts.summed(np.abs(self._p)) / self.n_cells
        self._ffi = _NOW * mean + _LAST * last + _BEFORE * before, last
        off = max(self._ffi[0] / params.t_ffi, params.base_off)
        on = max(2 * off, params.base_on)
        return [(on if kernel is _ON_KERNEL else off, off) for kernel in self.on_kernels]

    def _layer_s(
        self, pathways: list[Pathway], change: FloatImage, weights: tuple[float, float]
    ) -> FloatImage:
        """The layer S of an LGMD from the change of its input."""
        s = np.zeros_like(change)
        for path, part, weight in zip(pathways, (change, -change), weights, strict=True):
            wave = parts.positive(part)
            wave += self.params.persistence * path.wave
            e = parts.convolved(wave, parts.NEIGHBOURS)
            self.receptors.clear(e)
            last, before = path.late
            late = _NOW * e
            late += _LAST * last
            late += _BEFORE * before
            path.wave, path.late = wave, (late, last)
            inhibition = parts.convolved(late, path.kernel)
            inhibition *= weight
            s += parts.positive(e - inhibition)
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
