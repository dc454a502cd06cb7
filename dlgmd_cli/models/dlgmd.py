"""The D-LGMD of [Zhao2023], fed one frame at a time."""

import math
from collections.abc import Callable

import numpy as np

from dlgmd_cli.models.base import FloatImage, Layers, Response, undefined
from dlgmd_cli.models.detector import Detector
from dlgmd_cli.models.engines import (
    AUTO,
    Grouped,
    Grouping,
    Wiring,
    choose_engine,
    create_engine,
)
from dlgmd_cli.models.history import History, aligned
from dlgmd_cli.models.kernels import Connections, connect, gaussian
from dlgmd_cli.models.photoreceptors import View
from dlgmd_cli.params import DlgmdParameters

# The released code divides by this whatever the frame: n_cell m of its authors' 800 x 600.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3


class DLGMD(Detector):
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
    groups : bool
        Compute the grouping layer. Without it, attenuation comes faster, and there is no membrane
        potential: `mp` is NaN, and `layers` cannot be had.

    Attributes
    ----------
    engine_name : str
        The engine in use; what was asked for until the first frame.

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

    def __init__(
        self,
        params: DlgmdParameters | None = None,
        engine: str = AUTO,
        tell: Callable[[str], None] = lambda message: None,
        groups: bool = True,
    ) -> None:
        self._groups = groups
        self.params = params if params is not None else DlgmdParameters()
        self.engine_name = self._asked_engine = engine
        self._tell = tell
        choose_engine(engine)  # complains at once, not at the first frame
        self._literal = self.params.formulation == "equations"
        self._released = self.params.formulation == "released"
        self.connections = connections_of(self.params)
        # FFI(t) looks one frame back, two in the released code, Eq. (12).
        self._ffi_delay = 2 if self._released else 1
        self._history: History | None = None
        super().__init__(1 + max(self.connections.max_delay_frames, self._ffi_delay))

    def respond(self, view: View, *, layers: bool = False) -> Response:
        """Answer to the newest frame of `view`; to be called once for every frame, in order."""
        if view.history is not self._history:
            self._prepare(view.history)
        if view.frame < self.first_valid_frame:
            return undefined(view.p_sum(0), Layers(_p_layer(view)) if layers else None)
        ffi = view.p_sum(self._ffi_delay)
        t_de = self._threshold(ffi)
        grouping = None
        if self._groups:
            grouping = Grouping(self.params.k, t_de, math.inf if self._literal else 1.0)
        room = Grouped(*(aligned(view.history[0].shape) for _ in range(2))) if layers else None
        s_sum, mp = self._engine.respond(view.history, grouping, room)
        shown = Layers(_p_layer(view), *room) if room else None
        return Response(view.p_sum(0), s_sum, mp, ffi, t_de, shown)

    def _prepare(self, history: History) -> None:
        """Make an engine for images like those of `history`."""
        self._history = history
        n_cells = history.stack[0].size
        self.engine_name = choose_engine(self._asked_engine, n_cells, self._tell)
        params = self.params
        gaussians = [gaussian(params.r, sigma) for sigma in (params.sigma_i, params.sigma_e)]
        wiring = Wiring(self.connections.signed(), gaussians)
        self._cells = RELEASED_CELLS if self._released else n_cells * params.m
        self._engine = create_engine(self.engine_name, wiring, history, self._tell)

    def _threshold(self, ffi: float) -> float:
        """T_de, Eq. (11); the released code divides by a constant, and caps it."""
        if not self.params.ffi_gd:
            return 0.0
        t_de = ffi * self.params.t0 / self._cells
        return t_de if self._literal else min(t_de, MAX_T_DE)


def connections_of(params: DlgmdParameters) -> Connections:
    """The kernels that `params` describe."""
    return connect(
        radius_px=params.r,
        sigma_e_px=params.sigma_e,
        sigma_i_px=params.sigma_i,
        strength=params.a,
        alpha=params.alpha,
        beta=params.beta,
        lam=params.lam,
        interpolate=params.formulation == "equations",
    )


def _p_layer(view: View) -> FloatImage | None:
    """A copy of P(t) in units of luminance; None at the first frame."""
    if view.frame == 0:
        return None
    return np.multiply(view.history[0], np.float32(view.history.unit), dtype=np.float32)
