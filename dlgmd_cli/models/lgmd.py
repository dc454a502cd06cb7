"""The conventional LGMD, for comparison with the D-LGMD."""

import cv2
import numpy as np

from dlgmd_cli.models.base import (
    FloatImage,
    Grey,
    Layers,
    Model,
    Photoreceptors,
    Response,
    centroid_of,
)
from dlgmd_cli.models.filters import just_below
from dlgmd_cli.parameters.presets import LgmdParameters

# Weights of lateral inhibition, which acts one frame later.
INHIBITION = np.array([[0.125, 0.25, 0.125], [0.25, 0.0, 0.25], [0.125, 0.25, 0.125]])


class LGMD(Model):
    """LGMD of [Zhao2018] after [Yue2006]: signed, with inhibition from the nearest neighbours.

    With luminance L in grey levels, 0..255, and zero outside the frame::

        P(t) = L(t) - L(t-1) + p1 P(t-1) + p2 P(t-2)
        S(t) = P(t) - w_i P(t-1) ∗ w
        Ce = S ∗ ones(3, 3)/9,  ω = delta_c + max|Ce| / c_omega,  G = S · Ce / ω
        G̃ = G where c_de G ≥ t_de, else 0
        K = Σ|G̃|; all G̃ are 0 if FFI(t) = Σ|P(t-1)| / n_cell exceeds t_ffi

    Parameters
    ----------
    params : LgmdParameters, optional
        The published values, except T_FFI, unless given.
    """

    params_class = LgmdParameters
    layer_units = ("grey levels", "grey levels", "grey levels")
    first_valid_frame = 2
    params: LgmdParameters

    def __init__(self, params: LgmdParameters | None = None) -> None:
        super().__init__(params)
        self._threshold = self.params.t_de / self.params.c_de
        self._inhibition = (-self.params.w_i * INHIBITION).astype(np.float32)
        self._p: list[FloatImage] = []
        self.receptors = Photoreceptors(0)

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        self.receptors.take(luminance)
        if self.receptors.frame == 0:
            self._p = []
            return Response(layers=Layers() if layers else None)
        p = self._change()
        self._p = [p, *self._p[:1]]
        p_sum = cv2.norm(p, cv2.NORM_L1)
        if self.receptors.frame < self.first_valid_frame:
            return Response(p_sum, layers=Layers(p.copy()) if layers else None)
        s = p + cv2.filter2D(self._p[1], -1, self._inhibition, borderType=cv2.BORDER_CONSTANT)
        self.receptors.clear(s)
        g = self._group(s)
        ffi = cv2.norm(self._p[1], cv2.NORM_L1) / self.n_cells
        if ffi > self.params.t_ffi:
            g[:] = 0.0
        mp = cv2.norm(g, cv2.NORM_L1)
        shown = Layers(p.copy(), s, g) if layers else None
        s_sum = cv2.norm(s, cv2.NORM_L1)
        g_x, g_y = centroid_of(g)
        return Response(p_sum, s_sum, mp, ffi, self._threshold, shown, g_x, g_y)

    def _change(self) -> FloatImage:
        p = self.receptors.level_change()
        for weight, earlier in zip((self.params.p1, self.params.p2), self._p, strict=False):
            if weight:
                p += np.float32(weight) * earlier
        return p

    def _group(self, s: FloatImage) -> FloatImage:
        ce = cv2.boxFilter(s, -1, (3, 3), normalize=True, borderType=cv2.BORDER_CONSTANT)
        self.receptors.clear(ce)
        omega = self.params.delta_c + cv2.norm(ce, cv2.NORM_INF) / self.params.c_omega
        g = cv2.multiply(s, ce, dst=ce, scale=1.0 / omega)
        cv2.threshold(g, just_below(self._threshold), 0.0, cv2.THRESH_TOZERO, dst=g)
        return np.asarray(g, np.float32)
