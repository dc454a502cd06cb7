"""An LGMD on elementary motion detectors, the second model that the D-LGMD is compared with."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import numpy.typing as npt

from dlgmd_cli.models.base import FloatImage, Layers, Response, undefined
from dlgmd_cli.models.detector import Detector
from dlgmd_cli.models.engines import AUTO, require_opencv
from dlgmd_cli.models.photoreceptors import View
from dlgmd_cli.params import EmdLgmdParameters


class EmdLGMD(Detector):
    """LGMD on correlators that answer to expansion, after [Bermudez2007].

    With luminance L in 0..1, and Z[·] a field expanded about its centre by 1 + delta:

        F(t) = L(t) - L̄(t),  L̄ the low-pass of L with time constant tau_high
        D(t) = the low-pass of F with time constant tau_low
        R = Z[D] · F - D · Z[F],  M = max(R, 0)
        K = ΣM exp(-c FFI),  FFI = share of the cells with |F| > f_active

    Low-passes are of first order, y(t) = y(t-1) + (1 - exp(-1/τ)) (x(t) - y(t-1)); L̄ begins at the
    first frame and D at zero. The layer P is F, S is M, and G is M exp(-c FFI), which K sums.

    Parameters
    ----------
    params : EmdLgmdParameters, optional
        The defaults unless given.
    engine : str
        `opencv` or `auto`; there is no other.
    tell : callable, optional
        Never called; all models take one.
    """

    name = "emd-lgmd"
    layer_units = ("luminance", "luminance²", "luminance²")

    def __init__(
        self,
        params: EmdLgmdParameters | None = None,
        engine: str = AUTO,
        tell: Callable[[str], None] = lambda message: None,
    ) -> None:
        self.params = params if params is not None else EmdLgmdParameters()
        self.engine_name = require_opencv(engine, self.name)
        self._slow, self._fast = (
            np.float32(-math.expm1(-1.0 / tau))
            for tau in (self.params.tau_high, self.params.tau_low)
        )
        self._rest = np.float32(math.exp(-1.0 / self.params.tau_high))
        super().__init__(look_back=2)

    def respond(self, view: View, *, layers: bool = False) -> Response:
        """Answer to the newest frame of `view`; to be called once for every frame, in order."""
        luminance = np.multiply(view.current, np.float32(view.history.unit), dtype=np.float32)
        if view.frame == 0:
            self._mean = luminance
            self._delayed = np.zeros_like(luminance)
            self._expand = Expansion(luminance.shape, self.params.delta)
            return undefined(layers=Layers() if layers else None)
        change = luminance - self._mean
        self._mean += self._slow * change
        # What is left of it after the mean has followed: where it follows nearly at once, the
        # difference to the new mean would be mere rounding.
        change *= self._rest
        self._delayed += self._fast * (change - self._delayed)
        p_sum = cv2.norm(change, cv2.NORM_L1)
        if view.frame < self.first_valid_frame:
            return undefined(p_sum, Layers(change) if layers else None)
        motion = self._expand(self._delayed) * change
        motion -= self._delayed * self._expand(change)
        np.maximum(motion, 0.0, out=motion)
        s_sum = cv2.sumElems(motion)[0]
        size = np.abs(change)
        ffi = np.count_nonzero(size > np.float32(self.params.f_active)) / size.size
        gain = math.exp(-self.params.c * ffi)
        shown = Layers(change, motion, motion * np.float32(gain)) if layers else None
        return Response(p_sum, s_sum, s_sum * gain, ffi, 0.0, shown)


class Expansion:
    """Z[·]: a field expanded about its centre by 1 + delta, bilinear.

    Parameters
    ----------
    shape : (int, int)
        H and W.
    delta : float
        Not negative, so that no cell looks outside the field.
    """

    def __init__(self, shape: tuple[int, ...], delta: float) -> None:
        self._rows, self._columns = (_places(side, delta) for side in shape)
        self._shape = shape

    def __call__(self, field: FloatImage) -> FloatImage:
        """The expanded field, (H, W) float32, newly allocated."""
        (row, share_y), (column, share_x) = self._rows, self._columns
        wide = _between(field, row, share_y[:, None], axis=0)
        return _between(wide, column, share_x, axis=1)


def _between(
    field: FloatImage, place: npt.NDArray[np.intp], share: FloatImage, axis: int
) -> FloatImage:
    """What lies `share` of the way from `place` to the next one, along an axis."""
    near = np.take(field, place, axis=axis, mode="clip")
    step = np.take(field, place + 1, axis=axis, mode="clip")
    step -= near
    step *= share
    near += step
    return near


def _places(side: int, delta: float) -> tuple[npt.NDArray[np.intp], FloatImage]:
    """Where cells along a side look: the cell before that place, and how far beyond it."""
    centre = (side - 1) / 2
    source = centre + (np.arange(side) - centre) / (1.0 + delta)
    place = np.floor(source).astype(np.intp)
    return place, (source - place).astype(np.float32)
