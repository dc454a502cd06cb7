"""The D-LGMD of [Zhao2023], fed one frame at a time."""

import math
from collections.abc import Callable

import numpy as np

from dlgmd_cli.models.base import (
    FloatImage,
    Grey,
    Layers,
    Model,
    Photoreceptors,
    Response,
    aligned,
    undefined,
)
from dlgmd_cli.models.engines import AUTO, Grouping, choose_engine, create_engine
from dlgmd_cli.models.kernels import connect
from dlgmd_cli.parameters import DlgmdParameters

# The released code divides by this whatever the frame: n_cell m of its authors' 800 x 600.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3


class DLGMD(Model):
    """Distributed-presynaptic-connection LGMD, [Zhao2023] Eqs. (1) to (13).

    Parameters
    ----------
    params : DlgmdParameters, optional
        Parameters and formulation; set 9 in the `default` formulation unless given.
    engine : str
        What computes the layers: `opencv`, `numba` (a fused loop, compiled on first use), or
        `auto`, which takes Numba for large frames where it is installed.
    tell : callable, optional
        Called with a message before the engine is compiled, which takes some seconds.

    Attributes
    ----------
    engine_name : str
        The engine in use; what was asked for until the first frame.
    connections : Connections
        The kernels.
    first_valid_frame : int
        Index of the first frame with a full history: P begins at 1.

    Examples
    --------
    >>> import numpy as np
    >>> model = DLGMD()
    >>> responses = [model.step(np.full((60, 80), t / 10, np.float32)) for t in range(5)]
    >>> [response.is_valid for response in responses]
    [False, False, False, True, True]
    """

    name = "dlgmd"
    layer_units = ("luminance", "luminance", "luminance²")
    params: DlgmdParameters

    def __init__(
        self,
        params: DlgmdParameters | None = None,
        engine: str = AUTO,
        tell: Callable[[str], None] = lambda message: None,
    ) -> None:
        self.params = params if params is not None else DlgmdParameters()
        self.engine_name = self._asked_engine = engine
        self._tell = tell
        choose_engine(engine)  # complains at once, not at the first frame
        self._literal = self.params.formulation == "equations"
        self._released = self.params.formulation == "released"
        self.connections = connect(self.params)
        # FFI(t) looks one frame back, two in the released code, Eq. (12).
        self._ffi_delay = 2 if self._released else 1
        self.first_valid_frame = 1 + max(self.connections.max_delay_frames, self._ffi_delay)
        self._receptors = Photoreceptors(self.first_valid_frame)
        self._engine_is_for: tuple[object, object] | None = None

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Take the next frame and answer to it, see `Model.step`."""
        receptors = self._receptors
        receptors.take(luminance)
        if receptors.frame == 0:
            self._prepare(luminance)
        p_sum = receptors.p_sum(0)
        if receptors.frame < self.first_valid_frame:
            return undefined(p_sum, Layers(self._p_layer()) if layers else None)
        ffi = receptors.p_sum(self._ffi_delay)
        t_de = self._threshold(ffi)
        grouping = Grouping(self.params.k, t_de, math.inf if self._literal else 1.0)
        if not layers:
            s_sum, mp = self._engine.respond(receptors, grouping)
            return Response(p_sum, s_sum, mp, ffi, t_de)
        s, g = (aligned(luminance.shape) for _ in range(2))
        s_sum, mp = self._engine.respond(receptors, grouping, (s, g))
        return Response(p_sum, s_sum, mp, ffi, t_de, Layers(self._p_layer(), s, g))

    def _prepare(self, luminance: Grey) -> None:
        """Make an engine for frames like the first, unless there is one from before a reset."""
        kind, n_cells = (luminance.shape, luminance.dtype), luminance.size
        if kind == self._engine_is_for:
            return
        self._engine_is_for = kind
        self._cells = RELEASED_CELLS if self._released else n_cells * self.params.m
        self.engine_name = choose_engine(self._asked_engine, n_cells, self._tell)
        self._engine = create_engine(
            self.engine_name, self.connections, self._receptors, self._tell
        )

    def _threshold(self, ffi: float) -> float:
        """T_de, Eq. (11); the released code divides by a constant, and caps it."""
        if not self.params.ffi_gd:
            return 0.0
        t_de = ffi * self.params.t0 / self._cells
        return t_de if self._literal else min(t_de, MAX_T_DE)

    def _p_layer(self) -> FloatImage | None:
        """A copy of P(t) in units of luminance; None at the first frame."""
        if self._receptors.frame == 0:
            return None
        unit = np.float32(self._receptors.unit)
        return np.multiply(self._receptors.p(0), unit, dtype=np.float32)
