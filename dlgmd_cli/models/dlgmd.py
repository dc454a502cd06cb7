"""The D-LGMD of [Zhao2023], fed one frame at a time."""

import math
from collections import deque
from collections.abc import Callable

import cv2
import numpy as np

from dlgmd_cli.errors import FrameError
from dlgmd_cli.models.base import FloatImage, Grey, Layers, Response
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
from dlgmd_cli.params import DlgmdParameters

# The released code divides by this whatever the frame: n_cell m of its authors' 800 x 600.
RELEASED_CELLS = 200_000.0
MAX_T_DE = 0.3
_TYPES = (np.dtype(np.float32), np.dtype(np.uint8))


class DLGMD:
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
    ) -> None:
        self.params = params if params is not None else DlgmdParameters()
        self.engine_name = self._asked_engine = engine
        self._tell = tell
        choose_engine(engine)  # complains at once, not at the first frame
        self._literal = self.params.formulation == "equations"
        self._released = self.params.formulation == "released"
        self.connections = connections_of(self.params)
        # FFI(t) looks one frame back, two in the released code, Eq. (12).
        self._ffi_delay = 2 if self._released else 1
        self.reset()

    @property
    def first_valid_frame(self) -> int:
        """Index of the first frame with a full history: 1 + the largest delay."""
        return 1 + max(self.connections.max_delay_frames, self._ffi_delay)

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        self._n_frames = 0
        self._p_sums: deque[float] = deque(maxlen=self._ffi_delay + 1)

    def step(self, luminance: Grey, *, layers: bool = False) -> Response:
        """Take the next frame and answer to it.

        Parameters
        ----------
        luminance : ndarray, shape (H, W), float32 or uint8
            Luminance in 0..1, or grey levels in 0..255 that stand for it. The array may be reused
            by the caller afterwards.
        layers : bool
            Return copies of P, S and G as well.

        Returns
        -------
        Response
            Sums in units of luminance; NaN before `first_valid_frame` for all but `p_sum`, and
            for `p_sum` at the first frame.

        Raises
        ------
        FrameError
            If the frame is neither a float32 nor a uint8 image, or not of the same size and type
            as the one before.
        MissingExtraError
            If the engine asked for needs a package that is not installed.
        """
        self._admit(luminance)
        frame = self._n_frames
        self._n_frames += 1
        if frame == 0:
            np.copyto(self._previous, luminance)
            return _undefined(layers=Layers() if layers else None)
        p = self._history.advance()
        cv2.absdiff(luminance, self._previous, dst=p)
        np.copyto(self._previous, luminance)
        p_sum = cv2.sumElems(p)[0] * self._history.unit
        self._p_sums.append(p_sum)
        if frame < self.first_valid_frame:
            return _undefined(p_sum, Layers(self._p_layer()) if layers else None)
        ffi = self._p_sums[-1 - self._ffi_delay]
        t_de = self._threshold(ffi)
        grouping = Grouping(self.params.k, t_de, math.inf if self._literal else 1.0)
        room = Grouped(*(aligned(p.shape) for _ in range(2))) if layers else None
        s_sum, mp = self._engine.respond(self._history, grouping, room)
        shown = Layers(self._p_layer(), *room) if room else None
        return Response(p_sum, s_sum, mp, ffi, t_de, shown)

    def _admit(self, luminance: Grey) -> None:
        """Check a frame, and make room on the first one."""
        if luminance.ndim != 2 or luminance.dtype not in _TYPES or luminance.size == 0:
            raise FrameError(
                "frame",
                f"{luminance.dtype} of shape {luminance.shape} is not a float32 or uint8 image "
                "(H, W)",
                "Give luminance in 0..1, for example gray.astype(np.float32) / 255.",
            )
        if self._n_frames == 0:
            self._prepare(luminance)
        for name, given, before in (
            ("shape", luminance.shape, self._previous.shape),
            ("type", luminance.dtype, self._previous.dtype),
        ):
            if given != before:
                raise FrameError(
                    "frame",
                    f"its {name} {given} is not that of the frames before, {before}",
                    "Call reset() between videos.",
                )

    def _prepare(self, luminance: Grey) -> None:
        """Make the memory and the engine for frames like this one."""
        self._previous = aligned(luminance.shape, luminance.dtype)
        depth = max(self.connections.max_delay_frames + 1, 2)
        self._history = History(depth, self._previous)
        self.engine_name = choose_engine(self._asked_engine, luminance.size, self._tell)
        params = self.params
        gaussians = [gaussian(params.r, sigma) for sigma in (params.sigma_i, params.sigma_e)]
        wiring = Wiring(self.connections.signed(), gaussians)
        self._engine = create_engine(self.engine_name, wiring, self._history, self._tell)

    def _p_layer(self) -> FloatImage:
        """A copy of P(t) in units of luminance."""
        return np.multiply(self._history[0], np.float32(self._history.unit), dtype=np.float32)

    def _threshold(self, ffi: float) -> float:
        """T_de, Eq. (11); the released code divides by a constant, and caps it."""
        if not self.params.ffi_gd:
            return 0.0
        cells = RELEASED_CELLS if self._released else self._previous.size * self.params.m
        t_de = ffi * self.params.t0 / cells
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


def _undefined(p_sum: float = math.nan, layers: Layers | None = None) -> Response:
    return Response(p_sum, math.nan, math.nan, math.nan, math.nan, layers)
