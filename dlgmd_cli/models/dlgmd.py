"""The D-LGMD of [Zhao2023]."""

import math
from dataclasses import replace

from dlgmd_cli.models.base import (
    AUTO,
    FloatImage,
    Grey,
    Layers,
    Model,
    Photoreceptors,
    Response,
    aligned,
    centroid,
    checked_params,
)
from dlgmd_cli.models.engines import Grouping, Images, choose_engine, create_engine
from dlgmd_cli.models.kernels import connect
from dlgmd_cli.parameters.presets import DlgmdParameters

# Both released codes divide by this for any frame size. n_cell m is 192000 for the authors' frames
# of 800 x 600, and 207360 for 960 x 540: which was meant is not known.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3


class DLGMD(Model):
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

    def __init__(self, params: DlgmdParameters | None = None, engine: str = AUTO) -> None:
        self.params = checked_params(params, self.params_class)
        self.engine_name = self._asked_engine = engine
        choose_engine(engine)  # raises now, not at the first frame
        self.connections = connect(self.params)
        # P is defined from frame 1 on.
        self.first_valid_frame = 1 + max(self.connections.max_delay_frames, self.least_delay)
        self.receptors = Photoreceptors(self.first_valid_frame)
        self._engine_is_for: tuple[object, object] | None = None

    @property
    def least_delay(self) -> int:
        """FFI(t) uses P(t-1), Eq. (12), but P(t-2) in the released codes."""
        return 2 if self.params.is_released else 1

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        self._take(luminance)
        if self.receptors.frame == 0:
            self._prepare(luminance)
        if self.receptors.frame < self.first_valid_frame:
            shown = Layers(self.p_layer()) if layers else None
            return Response(self.receptors.p_sum(0), layers=shown)
        if not layers:
            return self._respond(None)
        s, g = (aligned(luminance.shape) for _ in range(2))
        return replace(self._respond((s, g)), layers=Layers(self.p_layer(), s, g))

    def _take(self, luminance: Grey) -> None:
        self.receptors.take(luminance)

    def _prepare(self, luminance: Grey) -> None:
        """Create an engine for frames like the first; after a reset, keep one that fits."""
        if self._engine_is_for != (luminance.shape, luminance.dtype):
            self._engine_is_for = luminance.shape, luminance.dtype
            self.engine_name = choose_engine(self._asked_engine, luminance.size)
            self._engine = create_engine(self.engine_name, self.connections, self.receptors)

    def p_layer(self) -> FloatImage | None:
        """A copy of P(t) in luminance; None at the first frame."""
        return self.receptors.layer() if self.receptors.frame > 0 else None

    def _respond(self, images: Images | None) -> Response:
        """The response once the history is full; S and G are written to `images`."""
        receptors, grouping = self.receptors, self.grouping()
        s_sum, mp, moments = self._engine.respond(receptors, grouping, images)
        g_x, g_y = centroid(mp, moments, receptors.current.shape)
        ffi = receptors.p_sum(self.least_delay)
        return Response(receptors.p_sum(0), s_sum, mp, ffi, grouping.t_de, g_x=g_x, g_y=g_y)

    def grouping(self) -> Grouping:
        """Gain, threshold and saturation of the newest frame's G, Eqs. (9) to (12).

        The released codes divide FFI by a constant. The printed equations neither limit the
        threshold nor saturate G; the released codes do both.
        """
        params, receptors = self.params, self.receptors
        t_de = 0.0
        if params.ffi_gd:
            cells = RELEASED_CELLS if params.is_released else receptors.n_cells * params.m
            t_de = receptors.p_sum(self.least_delay) * params.t0 / cells
        if not params.saturate:
            return Grouping(params.gain, t_de, math.inf)
        return Grouping(params.gain, min(t_de, MAX_T_DE), 1.0)
