"""The contrast-relative D-LGMD: it counts the cells that change much for the picture's contrast."""

import math
from collections.abc import Callable

import cv2
import numpy as np

from dlgmd_cli.models.base import Grey, Photoreceptors, Response
from dlgmd_cli.models.distributed import Distributed, Images
from dlgmd_cli.models.engines import AUTO, Counting
from dlgmd_cli.parameters import ContrastParameters


class ContrastDLGMD(Distributed):
    """D-LGMD whose thresholds follow the contrast of the picture, and which counts active cells.

    With σ(t) the smoothed standard deviation of the luminance:

        σ(t)  = (1 - w_sigma) σ(t-1) + w_sigma std(L(t)),  σ(0) = std(L(0))
        P'(t) = max(|L(t) - L(t-1)| - max(p_min, c_p σ(t)), 0)
        S(t)  from P', [Zhao2023] Eqs. (2) to (7)
        G(t)  = 1 where S(t) > max(s_min, c_s σ(t)), else 0
        K(t)  = ΣG, so that κ̂ is the share of active cells

    The D-LGMD sums products of S, which vanish where there is little contrast: it misses a plain
    wall straight ahead. There is no feed-forward inhibition: `ffi` is NaN, and `t_de` is the
    threshold of S. The layer P is P', while `p_sum` is Σ|L(t) - L(t-1)|, as in other models.

    Parameters
    ----------
    params : ContrastParameters, optional
        The published defaults unless given.
    engine : str
        See `DLGMD`.
    tell : callable, optional
        Called with a message before the engine is compiled, which takes some seconds.

    Examples
    --------
    >>> import numpy as np
    >>> model = ContrastDLGMD()
    >>> [model.step(np.full((60, 80), value, np.uint8)).mp for value in (9, 9, 90)]
    [nan, nan, 4800.0]
    """

    name = "dlgmd-contrast"
    layer_units = ("luminance", "luminance", "active")
    params: ContrastParameters

    def __init__(
        self,
        params: ContrastParameters | None = None,
        engine: str = AUTO,
        tell: Callable[[str], None] = lambda message: None,
    ) -> None:
        params = params if params is not None else ContrastParameters()
        super().__init__(params, engine, tell)
        self._receptors: ContrastReceptors = ContrastReceptors(self.first_valid_frame, params)

    def _respond(self, images: Images | None) -> Response:
        """S and G of the newest frame, and their sums."""
        threshold = self._threshold()
        s_sum, n_active = self._engine.respond(self._receptors, Counting(threshold), images)
        return Response(self._receptors.p_sum(0), s_sum, n_active, math.nan, threshold)

    def _threshold(self) -> float:
        """What S must exceed for a cell to be active, in luminance."""
        return max(self.params.c_s * self._receptors.sigma, self.params.s_min)


class ContrastReceptors(Photoreceptors):
    """P' of as many frames as the model looks back, each with the floor of its own frame.

    Attributes
    ----------
    sigma : float
        Smoothed standard deviation of the luminance, σ(t); from frame 1 on.
    """

    sigma: float
    _stack_type = np.float32  # P' is no whole number of grey levels

    def __init__(self, depth: int, params: ContrastParameters) -> None:
        self._params = params
        super().__init__(depth)

    def _see(self, out: Grey) -> float:
        """Write P' of the newest frame into `out`; the sum of |L(t) - L(t-1)|."""
        before = self.sigma if self.frame > 1 else self._deviation(self.previous)
        newest, weight = self._deviation(self.current), self._params.w_sigma
        # A frame with a NaN says nothing of the contrast, and must not spoil all that come after.
        before, newest = (
            newest if math.isnan(before) else before,
            before if math.isnan(newest) else newest,
        )
        self.sigma = (1.0 - weight) * before + weight * newest
        change = cv2.absdiff(self.current, self.previous)
        np.subtract(change, np.float32(self._floor() / self.unit), out=out)
        cv2.threshold(out, 0.0, 0.0, cv2.THRESH_TOZERO, dst=out)
        return float(cv2.sumElems(change)[0])

    def _floor(self) -> float:
        """What |L(t) - L(t-1)| must exceed, in luminance."""
        return max(self._params.c_p * self.sigma, self._params.p_min)

    def _deviation(self, frame: Grey) -> float:
        """Standard deviation of the luminance.

        As float32, so that it stays the same to the last bit when all cells get brighter alike.
        """
        return float(np.float32(cv2.meanStdDev(frame)[1][0, 0] * self.unit))
