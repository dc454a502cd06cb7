"""The D-LGMD of [Zhao2023]."""

import math

from dlgmd_cli.models.base import Response, centroid
from dlgmd_cli.models.distributed import Distributed, Images
from dlgmd_cli.models.engines import Grouping
from dlgmd_cli.parameters.presets import DlgmdParameters

# The released code divides by this for any frame size: n_cell m of the authors' 800 x 600 frames.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3


class DLGMD(Distributed):
    """Distributed-presynaptic-connection LGMD, [Zhao2023] Eqs. (1) to (13).

    Parameters
    ----------
    params : DlgmdParameters, optional
        Parameters and formulation; set 9 in the `default` formulation unless given.
    engine : str
        Engine for the layers: `opencv`, `numba` (a fused loop, compiled on first use), or `auto`,
        which uses Numba for large frames if it is installed.

    Examples
    --------
    >>> import numpy as np
    >>> model = DLGMD()
    >>> responses = [model.step(np.full((60, 80), t / 10, np.float32)) for t in range(5)]
    >>> [response.is_valid for response in responses]
    [False, False, False, True, True]
    """

    params_class = DlgmdParameters
    layer_units = ("luminance", "luminance", "luminance²")
    params: DlgmdParameters

    @property
    def least_delay(self) -> int:
        """FFI(t) uses P(t-1), Eq. (12), but P(t-2) in the released code."""
        return 2 if self.params.formulation == "released" else 1

    def _respond(self, images: Images | None) -> Response:
        receptors = self.receptors
        grouping = self.grouping()
        s_sum, mp, moments, _ = self._engine.respond(receptors, grouping, images)
        g_x, g_y = centroid(mp, moments, receptors.current.shape)
        ffi = receptors.p_sum(self.least_delay)
        return Response(receptors.p_sum(0), s_sum, mp, ffi, grouping.t_de, g_x=g_x, g_y=g_y)

    def grouping(self) -> Grouping:
        """Gain, threshold and saturation of the newest frame's G, Eqs. (9) to (12).

        The released code divides FFI by a constant. The printed equations neither limit the
        threshold nor saturate G; the released code does both.
        """
        params, receptors = self.params, self.receptors
        t_de = 0.0
        if params.ffi_gd:
            is_released = params.formulation == "released"
            cells = RELEASED_CELLS if is_released else receptors.n_cells * params.m
            t_de = receptors.p_sum(self.least_delay) * params.t0 / cells
        if not params.saturate:
            return Grouping(params.k, t_de, math.inf)
        return Grouping(params.k, min(t_de, MAX_T_DE), 1.0)
