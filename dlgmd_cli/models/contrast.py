"""The contrast-relative D-LGMD: it counts the cells that change much for the picture's contrast."""

import math
from collections.abc import Callable

import cv2
import numpy as np

from dlgmd_cli.models.base import (
    Flags,
    FloatImage,
    Grey,
    Photoreceptors,
    Response,
    aligned,
    centroid_of,
    checked_params,
)
from dlgmd_cli.models.distributed import Distributed, Images
from dlgmd_cli.models.engines import AUTO, Counting
from dlgmd_cli.parameters import ContrastParameters

# Cells that the lower quartile is taken over: some ten thousand are plenty.
MAX_QUARTILE_CELLS = 10_000


class ContrastDLGMD(Distributed):
    """D-LGMD whose thresholds follow the contrast of the picture, and which counts active cells.

    With σ(t) the smoothed standard deviation of the luminance:

        σ(t)  = (1 - w_sigma) σ(t-1) + w_sigma std(L(t)),  σ(0) = std(L(0))
        ν(t)  = (1 - w_sigma) ν(t-1) + w_sigma Q(t),  ν(1) = Q(1),
                Q(t) the lower quartile of |L(t) - L(t-1)| over the cells
        P'(t) = max(|L(t) - L(t-1)| - max(p_min, c_p σ(t), c_n ν(t)), 0)
        S(t)  from P', [Zhao2023] Eqs. (2) to (7)
        M(t)  = mean of P'(t),  M̄(t) = (1 - w_m) M̄(t-1) + w_m M(t),  M̄(1) = M(1)
        F(t)  = M(t) / M̄(t-1)
        G(t)  = w · min(1, growth / F(t))² where S(t) > max(s_min, c_s σ(t)), else 0
        K(t)  = ΣG

    with w ∝ exp(-ρ²/(2 sigma_c²)) and Σw = n_cell, where ρ is the distance of a cell from the
    centre of the frame, in halves of its longer side. K is the number of active cells, so that κ̂
    is their share; those off the centre count less.

    The D-LGMD sums products of S, which vanish where there is little contrast: it misses a plain
    wall straight ahead. In every picture some cells show nothing that moves; how much they change,
    ν, is the camera's noise. Where all of the picture begins to move at once, as when the drone
    pitches or a lamp is switched on, there is no history that could inhibit, but change grows
    faster than an approach makes it grow: F, the feed-forward inhibition `ffi`, is large. `t_de` is
    the threshold of S. The layer P is P', while `p_sum` is Σ|L(t) - L(t-1)|, as in other models.

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
    layer_units = ("luminance", "luminance", "active cells")
    params: ContrastParameters

    def __init__(
        self,
        params: ContrastParameters | None = None,
        engine: str = AUTO,
        tell: Callable[[str], None] = lambda message: None,
    ) -> None:
        params = checked_params(params, ContrastParameters)
        super().__init__(params, engine, tell, least_delay=1)  # F(t) looks one frame back
        self._receptors: ContrastReceptors = ContrastReceptors(self.first_valid_frame, params)
        self._weights: FloatImage | None = None

    def ignore(self, hidden: Flags | None) -> None:
        """Leave out some cells, see `Model.ignore`; σ, ν and w are those of the others."""
        super().ignore(hidden)
        self._weights = None

    def _respond(self, images: Images | None) -> Response:
        """S and G of the newest frame, and their sums."""
        receptors, threshold = self._receptors, self._threshold()
        shape = receptors.current.shape
        if self._weights is None or self._weights.shape != shape:
            self._weights = centre_weights(shape, self.params.sigma_c, receptors.hidden)
            self._spare = aligned(shape), aligned(shape)
        s, g = images or self._spare
        s_sum = self._engine.respond(receptors, Counting(threshold), (s, g)).s
        ffi = receptors.growth
        passed = min(1.0, self.params.growth / ffi) ** 2 if ffi > 0.0 else 1.0
        cv2.multiply(g, self._weights, dst=g, scale=passed)
        mp = cv2.sumElems(g)[0]
        g_x, g_y = centroid_of(g)
        return Response(receptors.p_sum(0), s_sum, mp, ffi, threshold, g_x=g_x, g_y=g_y)

    def _threshold(self) -> float:
        """What S must exceed for a cell to be active, in luminance."""
        return max(self.params.c_s * self._receptors.sigma, self.params.s_min)


def centre_weights(shape: tuple[int, ...], sigma: float, hidden: Flags | None = None) -> FloatImage:
    """How much each cell counts, (H, W): a Gaussian about the centre, 1 on average.

    Where `hidden`, (H, W), is True, it is 0; the average is that of the other cells.

    `sigma` is its standard deviation in halves of the longer side.
    """
    height, width = shape
    longer = max(shape)
    y, x = ((np.arange(side) - (side - 1) / 2) / (longer / 2) for side in (height, width))
    weights = np.outer(np.exp(-(y**2) / (2 * sigma**2)), np.exp(-(x**2) / (2 * sigma**2)))
    if hidden is not None:
        weights[hidden] = 0.0
        return np.asarray(weights / weights[~hidden].mean(), np.float32)
    return np.asarray(weights / weights.mean(), np.float32)


def lower_quartile(image: Grey, hidden: Flags | None = None) -> float:
    """What three quarters of the values reach, over some of the cells where there are many.

    Where `hidden`, (H, W), is True, a cell does not count.
    """
    step = max(1, math.isqrt(image.size // MAX_QUARTILE_CELLS))
    values = image[::step, ::step].ravel()
    if hidden is not None:
        values = values[~hidden[::step, ::step].ravel()]
        if values.size == 0:  # so few cells that none of those looked at is among them
            values = image[~hidden]
    return float(np.partition(values, values.size // 4)[values.size // 4])


def smoothed(before: float, newest: float, weight: float) -> float:
    """The average of all values so far, with this weight of the newest one.

    A frame with a NaN says nothing, and must not spoil all that come after.
    """
    if math.isnan(before) or math.isnan(newest):
        return newest if math.isnan(before) else before
    return before + weight * (newest - before)


class ContrastReceptors(Photoreceptors):
    """P' of as many frames as the model looks back, each with the floor of its own frame.

    Attributes
    ----------
    sigma : float
        Smoothed standard deviation of the luminance, σ(t); from frame 1 on.
    noise : float
        Smoothed lower quartile of |L(t) - L(t-1)|, ν(t), in luminance; from frame 1 on.
    growth : float
        F(t), how much more changed than on average before; from frame 2 on, infinite where
        nothing did and 0 where nothing does.
    """

    sigma: float
    _stack_type = np.float32  # P' is no whole number of grey levels

    def __init__(self, depth: int, params: ContrastParameters) -> None:
        self._params = params
        super().__init__(depth)

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        super().reset()
        self.sigma = self.noise = self.growth = self._usual = math.nan

    def _see(self, out: Grey) -> float:
        """Write P' of the newest frame into `out`; the sum of |L(t) - L(t-1)|."""
        weight = self._params.w_sigma
        if self.frame == 1:
            self.sigma = self._deviation(self.previous)
        self.sigma = smoothed(self.sigma, self._deviation(self.current), weight)
        change = cv2.absdiff(self.current, self.previous)
        self.noise = smoothed(self.noise, lower_quartile(change, self.hidden) * self.unit, weight)
        np.subtract(change, np.float32(self._floor() / self.unit), out=out)
        cv2.threshold(out, 0.0, 0.0, cv2.THRESH_TOZERO, dst=out)
        p_sum = cv2.sumElems(out)[0]
        self.growth = p_sum / self._usual if self._usual else math.inf if p_sum else 0.0
        self._usual = smoothed(self._usual, p_sum, self._params.w_m)
        return float(cv2.sumElems(change)[0])

    def _floor(self) -> float:
        """What |L(t) - L(t-1)| must exceed, in luminance."""
        params = self._params
        return max(params.c_p * self.sigma, params.c_n * self.noise, params.p_min)

    def _deviation(self, frame: Grey) -> float:
        """Standard deviation of the luminance.

        As float32, so that it stays the same to the last bit when all cells get brighter alike.
        """
        counted = None if self.hidden is None else (~self.hidden).view(np.uint8)
        return float(np.float32(cv2.meanStdDev(frame, mask=counted)[1][0, 0] * self.unit))
