"""An LGMD with elementary motion detectors, for comparison with the D-LGMD."""

import math

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import (
    FloatImage,
    Grey,
    Layers,
    Model,
    Photoreceptors,
    Response,
    centroid_of,
)
from dlgmd_cli.models.receptors import aligned
from dlgmd_cli.parameters.presets import EmdLgmdParameters


class EmdLGMD(Model):
    """LGMD based on correlators that respond to expansion, after [Bermudez2007].

    With luminance L in 0..1, and Z[·] a field expanded about its centre by 1 + delta::

        F(t) = L(t) - L̄(t),  L̄ the low-pass of L with time constant tau_high
        D(t) = the low-pass of F with time constant tau_low
        R = Z[D] · F - D · Z[F],  M = max(R, 0)
        K = ΣM exp(-c FFI),  FFI = share of the cells with |F| > f_active

    The low-passes are of first order, y(t) = y(t-1) + (1 - exp(-1/τ)) (x(t) - y(t-1)). L̄ starts
    with the first frame and D with zero. The layer P is F, S is M, and G is M exp(-c FFI).

    Parameters
    ----------
    params : EmdLgmdParameters, optional
        The defaults unless given.
    """

    params_class = EmdLgmdParameters
    layer_units = ("luminance", "luminance²", "luminance²")
    first_valid_frame = 2
    params: EmdLgmdParameters

    def __init__(self, params: EmdLgmdParameters | None = None) -> None:
        super().__init__(params)
        self._slow, self._fast = (
            np.float32(-math.expm1(-1.0 / tau))
            for tau in (self.params.tau_high, self.params.tau_low)
        )
        self._rest = np.float32(math.exp(-1.0 / self.params.tau_high))
        self.receptors = Photoreceptors(0)

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        receptors = self.receptors
        receptors.take(luminance)
        luminance = np.multiply(receptors.current, np.float32(receptors.unit), dtype=np.float32)
        if receptors.frame == 0:
            self._mean = luminance
            self._delayed = np.zeros_like(luminance)
            self._places = [_places(side, self.params.delta) for side in luminance.shape]
            return Response(layers=Layers() if layers else None)
        # Aligned, so that sums are the same in every run.
        change = np.subtract(luminance, self._mean, out=aligned(luminance.shape))
        self._mean += self._slow * change
        # The difference from the new mean. A subtraction would leave only rounding errors if the
        # mean follows almost at once.
        change *= self._rest
        self._delayed += self._fast * (change - self._delayed)
        p_sum = cv2.norm(change, cv2.NORM_L1)
        if receptors.frame < self.first_valid_frame:
            return Response(p_sum, layers=Layers(change) if layers else None)
        motion = np.multiply(self._expand(self._delayed), change, out=aligned(change.shape))
        motion -= self._delayed * self._expand(change)
        np.maximum(motion, 0.0, out=motion)
        s_sum = cv2.sumElems(motion)[0]
        is_active = np.abs(change) > np.float32(self.params.f_active)
        ffi = np.count_nonzero(is_active) / receptors.n_cells
        gain = math.exp(-self.params.c * ffi)
        shown = Layers(change, motion, motion * np.float32(gain)) if layers else None
        g_x, g_y = centroid_of(motion)  # G is M times a number
        return Response(p_sum, s_sum, s_sum * gain, ffi, 0.0, shown, g_x, g_y)

    def _expand(self, field: FloatImage) -> FloatImage:
        """Z[·] of a field, newly allocated; for delta >= 0, Z needs no values outside the field."""
        (row, share_y), (column, share_x) = self._places
        wide = _between(field, row, share_y[:, None], axis=0)
        return _between(wide, column, share_x, axis=1)


def _between(
    field: FloatImage, place: npt.NDArray[np.intp], share: FloatImage, axis: int
) -> FloatImage:
    """Linear interpolation along an axis, at `share` of the way from `place` to the next cell."""
    near = np.take(field, place, axis=axis, mode="clip")
    step = np.take(field, place + 1, axis=axis, mode="clip")
    step -= near
    step *= share
    near += step
    return near


def _places(side: int, delta: float) -> tuple[npt.NDArray[np.intp], FloatImage]:
    """Source positions of the cells along a side: the cell before, and the fraction after it."""
    centre = (side - 1) / 2
    source = centre + (np.arange(side) - centre) / (1.0 + delta)
    place = np.floor(source).astype(np.intp)
    return place, (source - place).astype(np.float32)
