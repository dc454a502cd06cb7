"""The contrast-relative D-LGMD: it counts cells that change strongly relative to the contrast."""

import math
from collections.abc import Callable

import cv2
import numpy as np

from dlgmd_cli.models.base import (
    AUTO,
    Flags,
    FloatImage,
    Grey,
    Photoreceptors,
    Response,
    centroid,
)
from dlgmd_cli.models.distributed import Distributed, Images
from dlgmd_cli.models.engines import Counting
from dlgmd_cli.parameters import ContrastParameters

# Number of cells that is enough to estimate the lower quartile.
MAX_QUARTILE_CELLS = 10_000


class ContrastDLGMD(Distributed):
    """D-LGMD with thresholds relative to the contrast of the picture; it counts active cells.

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
    centre of the frame, in halves of its longer side. K is the weighted number of active cells, and
    κ̂ their share.

    The D-LGMD sums products of S, which vanish at low contrast: it misses a plain wall straight
    ahead. Here, cells are counted instead. ν estimates the camera's noise from cells in which
    nothing moves; every picture has some. If the whole picture begins to move at once, because the
    drone pitches or a lamp is switched on, there is no history to inhibit the response. The change
    then grows faster than during an approach, and F, the feed-forward inhibition `ffi`, is large.
    `t_de` is the threshold of S. The layer P is P', but `p_sum` is Σ|L(t) - L(t-1)| as in the other
    models.

    Parameters
    ----------
    params : ContrastParameters, optional
        The published defaults unless given.
    engine
        See `DLGMD`.

    Examples
    --------
    >>> import numpy as np
    >>> model = ContrastDLGMD()
    >>> [model.step(np.full((60, 80), value, np.uint8)).mp for value in (9, 9, 90)]
    [nan, nan, 4800.0]
    """

    params_class = ContrastParameters
    layer_units = ("luminance", "luminance", "active cells")
    params: ContrastParameters
    receptors: "ContrastReceptors"

    def __init__(self, params: ContrastParameters | None = None, engine: str = AUTO) -> None:
        super().__init__(params, engine)
        self.receptors = ContrastReceptors(self.first_valid_frame, self.params)
        self._weights: tuple[FloatImage, FloatImage] | None = None

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells, see `Model.ignore`, also in σ, ν and w."""
        super().ignore(hidden)
        self._weights = None

    def _respond(self, images: Images | None) -> Response:
        receptors, threshold = self.receptors, self._threshold()
        shape = receptors.current.shape
        if self._weights is None:
            self._weights = centre_weights(shape, self.params.sigma_c, receptors.hidden)
        sums = self._engine.respond(receptors, Counting(threshold, self._weights), images)
        ffi = receptors.growth
        passed = min(1.0, self.params.growth / ffi) ** 2 if ffi > 0.0 else 1.0
        if images is not None:
            np.multiply(images[1], np.float32(passed), out=images[1])
        mp, (m_x, m_y) = passed * sums.g, sums.moments
        g_x, g_y = centroid(mp, (passed * m_x, passed * m_y), shape)
        return Response(receptors.p_sum(0), sums.s, mp, ffi, threshold, g_x=g_x, g_y=g_y)

    def _prepare(self, luminance: Grey) -> None:
        super()._prepare(luminance)
        self.receptors.subtract = self._engine.subtract
        self._weights = None

    def _threshold(self) -> float:
        """Threshold of S for an active cell, in luminance."""
        return max(self.params.c_s * self.receptors.sigma, self.params.s_min)


def centre_weights(
    shape: tuple[int, ...], sigma: float, hidden: Flags | None = None
) -> tuple[FloatImage, FloatImage]:
    """Weights of the rows, (H,), and of the columns, (W,): a Gaussian about the centre.

    Their products, the weights of the cells, have a mean of 1. `sigma` is the standard deviation in
    halves of the longer side. Cells where `hidden`, (H, W), is True do not enter the mean.
    """
    height, width = shape
    longer = max(shape)
    y, x = ((np.arange(side) - (side - 1) / 2) / (longer / 2) for side in (height, width))
    rows, columns = (np.exp(-(side**2) / (2 * sigma**2)) for side in (y, x))
    mean = np.outer(rows, columns)[... if hidden is None else ~hidden].mean()
    return (rows / mean).astype(np.float32), columns.astype(np.float32)


def lower_quartile(current: Grey, previous: Grey, hidden: Flags | None = None) -> float:
    """Lower quartile of |L(t) - L(t-1)|, estimated from a subset if there are many cells.

    Cells where `hidden`, (H, W), is True are ignored.
    """
    step = max(1, math.isqrt(current.size // MAX_QUARTILE_CELLS))
    if hidden is not None and hidden[::step, ::step].all():  # the subset has no visible cell
        step = 1
    change = cv2.absdiff(current[::step, ::step], previous[::step, ::step])
    if hidden is not None:
        change = change[~hidden[::step, ::step]]
    rank = change.size // 4
    if change.dtype == np.uint8:  # faster than to sort
        counts = cv2.calcHist([change], [0], None, [256], [0, 256])
        return float(np.searchsorted(counts.cumsum(dtype=float), rank, side="right"))
    return float(np.partition(change.ravel(), rank)[rank])


def smoothed(before: float, newest: float, weight: float) -> float:
    """Exponential moving average; `weight` is that of the newest value.

    NaN is skipped, so that a single bad frame does not affect all later ones.
    """
    if math.isnan(before) or math.isnan(newest):
        return newest if math.isnan(before) else before
    return before + weight * (newest - before)


class ContrastReceptors(Photoreceptors):
    """P' of the last few frames, each with the threshold of its own frame.

    `sigma` is the smoothed standard deviation of the luminance, σ(t), and `noise` the smoothed
    lower quartile of |L(t) - L(t-1)|, ν(t), in luminance; both from frame 1 on. `growth` is F(t),
    the change relative to its earlier average, from frame 2 on: infinite if nothing changed before,
    0 if nothing changes now.
    """

    sigma: float
    subtract: Callable[..., tuple[float, float]]  # of the model's engine
    _stack_type = np.float32  # P' is not a whole number of grey levels

    def __init__(self, depth: int, params: ContrastParameters) -> None:
        self._params = params
        super().__init__(depth)

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        self.sigma = self.noise = self.growth = self._usual = math.nan

    def _compute_p(self, out: Grey) -> float:
        """Write P' of the newest frame to `out`; returns Σ|L(t) - L(t-1)|."""
        weight = self._params.w_sigma
        if self.frame == 1:
            self.sigma = self._deviation(self.previous)
        self.sigma = smoothed(self.sigma, self._deviation(self.current), weight)
        quartile = lower_quartile(self.current, self.previous, self.hidden)
        self.noise = smoothed(self.noise, quartile * self.unit, weight)
        floor = self._floor() / self.unit
        p_sum, change_sum = self.subtract(self.current, self.previous, floor, out)
        self.growth = p_sum / self._usual if self._usual else math.inf if p_sum else 0.0
        self._usual = smoothed(self._usual, p_sum, self._params.w_m)
        return change_sum

    def _floor(self) -> float:
        """Threshold of |L(t) - L(t-1)|, in luminance."""
        params = self._params
        return max(params.c_p * self.sigma, params.c_n * self.noise, params.p_min)

    def _deviation(self, frame: Grey) -> float:
        """Standard deviation of the luminance.

        It is rounded to float32, so that adding a constant to all cells does not change a bit.
        """
        counted = None if self.hidden is None else (~self.hidden).view(np.uint8)
        return float(np.float32(cv2.meanStdDev(frame, mask=counted)[1][0, 0] * self.unit))
