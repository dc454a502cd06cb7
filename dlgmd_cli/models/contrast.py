"""The contrast-relative D-LGMD: it counts cells that change strongly relative to the contrast."""

import math
from collections.abc import Callable
from functools import cache, partial
from itertools import product

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
from dlgmd_cli.models.engines import BLOCK, Counting
from dlgmd_cli.models.expansion import Expansion, Shift, Window
from dlgmd_cli.models.prepare import Filling, Flicker
from dlgmd_cli.parameters.presets import ContrastParameters

# Number of cells that is enough to estimate the lower quartile.
MAX_QUARTILE_CELLS = 10_000
# It is mostly below so many grey levels.
FEW_LEVELS = 4
# The picture is moved if less than this share of the change is left.
MAX_LEFT = 0.95
# Frame rate where neither times nor `w_fps` tell.
NOMINAL_FPS = 30.0
# The picture's expansion counts up to this multiple of `d_0`.
MAX_EXPANSION = 16.0


class ContrastDLGMD(Distributed):
    """D-LGMD with thresholds relative to the contrast of the picture; it counts active cells.

    With σ(t) the smoothed standard deviation of the luminance::

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
    κ̂ = K / n_cell their share, but for what `balance`, `c_m` and `d_0` below make of it: an
    expanding picture multiplies K, which may then be more than n_cell.

    The D-LGMD sums products of S, which vanish at low contrast: it misses a plain wall straight
    ahead. Here, cells are counted instead. ν estimates the camera's noise from cells in which
    nothing moves; every picture has some. If the whole picture begins to move at once, because the
    drone pitches or a lamp is switched on, there is no history to inhibit the response. The change
    then grows faster than during an approach, and F, the feed-forward inhibition `ffi`, is large.
    `t_de` is the threshold of S. The layer P is P', but `p_sum` is the sum of ``|L(t) - L(t-1)|``,
    as in the other models.

    Nine parameters, off by default, keep it quiet on real footage:

    - `shift`: L(t-1) and the earlier P' first move along with the picture, by whole cells. Of means
      over 4x4 cells, the shift in blocks has the least mean change, by descent over the 8
      neighbours from the better of no shift and the last frame's; along each axis, with the
      changes a, b and c at one block less, there, and at one more, it is refined by
      (a - c) / 2 (max(a, c) - b), at most half a block. The frames move if that lowers the mean
      ``|L(t) - L(t-1)|`` where they overlap by more than a twentieth. Cells that enter have no
      change, and P' = 0.
    - `balance`: K is n_cell times the mean of the two least of ΣG / Σw over the four quadrants
      about the centre. A middle row or column belongs to both sides. What looms expands in all
      directions; what passes by does not.
    - `c_m`: K(t) = max(κ(t) - c_m m(t-1), 0), where κ(t) is K as above, and m its mean so far,
      m(t) = m(t-1) + (1 - exp(-Δt/tau_m)) (κ(t) - m(t-1)), from the first κ on. The cell adapts to
      what goes on all the time.
    - `d_0` and `k_0`, where `shift` is on: K(t) = e² (a + k_0 n_cell) - k_0 n_cell with a the K as
      above and e = min(max(1, D(t) / d_0), 16). D is how fast the picture expands, in 1/s, smoothed
      over `tau_d`: see `dlgmd_cli.models.expansion`. What is approached expands along both sides,
      and faster the less time is left. `ttc_s` follows from D.
    - `deflicker`: each row is divided by its mean relative to that over a period of the light,
      while rows are almost the same after 2 to 5 frames, but not after one: see `Flicker`. Steps of
      the exposure are no expansion, see `expansion.evened`.
    - `w_fps`: with n = w_fps Δt, w_sigma and w_m become 1 - (1 - w)^n, and M and G are divided by
      n. Δt is one frame at `w_fps`, or at 30 frames/s, if times are unknown.

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
        self._mean = math.nan

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        self._mean = math.nan

    def step(
        self, luminance: Grey, time_s: float | None = None, *, layers: bool = False
    ) -> Response:
        """Process the next frame, see `Model.step`."""
        self.receptors.time_s = math.nan if time_s is None else time_s
        return super().step(luminance, layers=layers)

    def ignore(self, hidden: Flags | None) -> None:
        """Ignore some cells, see `Model.ignore`, also in σ, ν and w."""
        super().ignore(hidden)
        self._weights = None

    def _respond(self, images: Images | None) -> Response:
        receptors, threshold = self.receptors, self._threshold()
        shape = receptors.current.shape
        if self._weights is None:
            self._weights = centre_weights(shape, self.params.sigma_c, receptors.hidden)
            self._quadrants = quadrants(self._weights, receptors.hidden)
        sums = self._engine.respond(receptors, Counting(threshold, self._weights), images)
        ffi = receptors.growth
        passed = min(1.0, self.params.growth / ffi) ** 2 if ffi > 0.0 else 1.0
        passed /= receptors.n_usual
        if images is not None:
            np.multiply(images[1], np.float32(passed), out=images[1])
        g_sum, (m_x, m_y) = passed * sums.g, sums.moments
        mp = passed * self._weakest(sums.quarters) if self.params.balance else g_sum
        g_x, g_y = centroid(g_sum, (passed * m_x, passed * m_y), shape)
        mp = self._expanding(self._adapted(mp))
        ttc_s = receptors.expansion.ttc_s
        return Response(
            *(receptors.p_sum(0), sums.s, mp, ffi, threshold), g_x=g_x, g_y=g_y, ttc_s=ttc_s
        )

    def _prepare(self, luminance: Grey) -> None:
        super()._prepare(luminance)
        self.receptors.blocks = self._engine.blocks
        self._weights = None

    def _weakest(self, quarters: tuple[float, ...]) -> float:
        """K by the two quadrants with the least ΣG, relative to their weights."""
        shares = [
            part / total for part, total in zip(quarters, self._quadrants, strict=True) if total
        ]
        least = sorted(shares)[:2]
        return self.n_cells * sum(least) / max(1, len(least))

    def _adapted(self, mp: float) -> float:
        """What of K exceeds `c_m` times its mean over the earlier frames."""
        c_m, tau_s = self.params.c_m, self.params.tau_m
        if c_m == 0.0:
            return mp
        before = mp if math.isnan(self._mean) else self._mean
        newest = -math.expm1(-self.receptors.interval_s / tau_s)
        self._mean = before + newest * (mp - before)
        return max(mp - c_m * before, 0.0)

    def _expanding(self, mp: float) -> float:
        """K, the more the faster the picture expands, see `d_0`."""
        d_0, extra = self.params.d_0, self.params.k_0 * self.n_cells
        if d_0 == 0.0:
            return mp
        rate = self.receptors.expansion.rate
        return min(max(rate / d_0, 1.0), MAX_EXPANSION) ** 2 * (mp + extra) - extra

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


def quadrants(weights: tuple[FloatImage, FloatImage], hidden: Flags | None = None) -> list[float]:
    """Σw of the quadrants, see `Sums.quarters`; of hidden cells, w is 0."""
    image = np.outer(*weights)
    if hidden is not None:
        image[hidden] = 0.0
    sides = [(slice(0, (n + 1) // 2), slice(n // 2, n)) for n in image.shape]
    return [float(image[rows, columns].sum()) for rows in sides[0] for columns in sides[1]]


def overlap(n: int, shift: int) -> tuple[slice, slice]:
    """Where the cells of a side of n remain after a shift, and where they were."""
    return slice(max(0, shift), n + min(0, shift)), slice(max(0, -shift), n - max(0, shift))


def mean_change(now: Grey, before: Grey, window: Window, shift: Shift) -> float:
    """Mean |a(i) - b(i - shift)| in a window of an image a that an earlier one b, moved, covers.

    The window is where its rows begin and end, and its columns. Infinite if none of it is covered.
    """
    (top, bottom, left, right), (y, x), (height, width) = window, shift, now.shape
    top, bottom = max(top, y), min(bottom, height + y)
    left, right = max(left, x), min(right, width + x)
    if top >= bottom or left >= right:
        return math.inf
    there = before[top - y : bottom - y, left - x : right - x]
    return cv2.norm(now[top:bottom, left:right], there, cv2.NORM_L1) / there.size


def whole(frame: Grey) -> Window:
    """All of an image as a window, see `mean_change`."""
    height, width = frame.shape
    return 0, height, 0, width


def refined(less: float, here: float, more: float) -> float:
    """How far the least change is from here, in blocks, by the changes one block less and more.

    At most half a block; 0 if nothing changes here, or if a change beside is infinite.
    """
    rise = max(less, more) - here
    part = (less - more) / (2.0 * rise) if here > 0.0 and 0.0 < rise < math.inf else 0.0
    return min(max(part, -0.5), 0.5)  # beyond the limits the change may be less


def shift_limits(shape: tuple[int, ...], most: int) -> list[int]:
    """The largest shift along each side, in blocks: at most a third of it."""
    return [min(most, n // 3) for n in shape]


def follow(now: FloatImage, before: FloatImage, start: Shift, most: int) -> tuple[Shift, Shift]:
    """By how much the picture has moved, see `ContrastDLGMD`.

    Parameters
    ----------
    now, before : ndarray
        Means over blocks of the two frames, see `Engine.blocks`.
    start : (int, int)
        The shift in blocks, rows first, that was found one frame earlier.
    most : int
        Largest shift, in blocks; at most a third of a side.

    Returns
    -------
    blocks, cells : (int, int)
        The shift in whole blocks, and in cells.
    """
    limits = shift_limits(now.shape, most)
    if 0 in limits:
        return (0, 0), (0, 0)
    change = cache(partial(mean_change, now, before, whole(now)))
    best = min(((0, 0), start), key=change)
    while True:
        ((y, x), (y_most, x_most)) = best, limits
        around = product(range(y - 1, y + 2), range(x - 1, x + 2))
        near = min((d for d in around if abs(d[0]) <= y_most and abs(d[1]) <= x_most), key=change)
        if change(near) >= change(best):
            break
        best = near

    def cells(blocks: int, less: Shift, more: Shift) -> int:
        part = refined(change(less), change(best), change(more))
        return BLOCK * blocks + math.floor(
            BLOCK * part + 0.5 + 1e-9
        )  # halves up, also rounded ones

    down = cells(y, (y - 1, x), (y + 1, x))
    return best, (down, cells(x, (y, x - 1), (y, x + 1)))


def lower_quartile(change: Grey, hidden: Flags | None = None) -> float:
    """Lower quartile of the cells of an image, (H, W), estimated from a subset if there are many.

    Cells where `hidden`, (H, W), is True are ignored.
    """
    step = max(1, math.isqrt(change.size // MAX_QUARTILE_CELLS))
    if hidden is not None and hidden[::step, ::step].all():  # the subset has no visible cell
        step = 1
    some = change[::step, ::step]
    some = some.ravel() if hidden is None else some[~hidden[::step, ::step]]
    rank = some.size // 4
    if some.dtype == np.uint8:  # faster than to sort
        for level in range(FEW_LEVELS):  # faster than a histogram
            n_above = cv2.countNonZero(cv2.threshold(some, level, 1, cv2.THRESH_BINARY)[1])
            if some.size - n_above > rank:
                return float(level)
        counts = cv2.calcHist([some], [0], None, [256], [0, 256])
        return float(np.searchsorted(counts.cumsum(dtype=float), rank, side="right"))
    return float(np.partition(some, rank)[rank])


def smoothed(before: float, newest: float, weight: float) -> float:
    """Exponential moving average; `weight` is that of the newest value.

    NaN is skipped, so that a single bad frame does not affect all later ones.
    """
    if math.isnan(before) or math.isnan(newest):
        return newest if math.isnan(before) else before
    return before + weight * (newest - before)


class ContrastReceptors(Photoreceptors):
    """P' of the last few frames: |L(t) - L(t-1)| in `stack`, and each frame's floor in `floors`.

    `sigma` is the smoothed standard deviation of the luminance, σ(t), and `noise` the smoothed
    lower quartile of |L(t) - L(t-1)|, ν(t), in luminance; both from frame 1 on. `growth` is F(t),
    the change relative to its earlier average, from frame 2 on: infinite if nothing changed before,
    0 if nothing changes now.

    `time_s` is the time of the next frame, NaN if unknown; `interval_s` is the time between the
    last two frames, and `n_usual` the same in frames at `w_fps`, 1 if times are ignored.
    `expansion` measures how fast the picture expands, if `shift` and `d_0` are on.
    """

    sigma: float
    blocks: Callable[[Grey], FloatImage]  # of the model's engine
    time_s = math.nan

    def __init__(self, depth: int, params: ContrastParameters) -> None:
        self._params, self._flicker = params, Flicker()
        self._filling: Filling | None = None
        self.expansion = Expansion(params.tau_d, evens=params.deflicker)
        super().__init__(depth)

    def reset(self) -> None:
        """Forget all earlier frames; the next one may have another size."""
        super().reset()
        self.sigma = self.noise = self.growth = self._usual = self._last_s = math.nan
        self._blocks: FloatImage | None = None
        self._shift_blocks = (0, 0)
        self.expansion.reset()
        self._flicker.reset()

    def hide(self, hidden: Flags | None) -> None:
        """Ignore the cells where `hidden` is True, see `Model.ignore`."""
        super().hide(hidden)
        self._filling = None if hidden is None else Filling(hidden)
        self.expansion.ignore(hidden)

    def cover(self, frame: Grey) -> None:
        """Fill what is hidden of a frame, (H, W), so that it does not hold the picture's motion."""
        if self._filling is not None:
            self._filling.fill(frame)

    def take(self, luminance: Grey) -> None:
        """Store the next frame and compute its P'; raises FrameError as `Model.step` does."""
        interval_s, usual_fps = self.time_s - self._last_s, self._params.w_fps
        self.interval_s = interval_s if interval_s > 0.0 else 1.0 / (usual_fps or NOMINAL_FPS)
        self.n_usual = self.interval_s * usual_fps or 1.0
        if self._params.deflicker:
            self._check(luminance)
            luminance = self._flicker.of(luminance)
        super().take(luminance)
        self._last_s = self.time_s

    def _compute_p(self, out: Grey) -> float:
        """Write |L(t) - L(t-1)| to `out`, and set its floor; returns the sum, in levels."""
        weight = self._weight(self._params.w_sigma)
        if self.frame == 1:
            self.sigma = self._deviation(self.previous)
        self._subtract(out, self._shift() if self._params.shift > 0 else (0, 0))
        self.sigma = smoothed(self.sigma, self._deviation(self.current), weight)
        self.noise = smoothed(self.noise, lower_quartile(out, self.hidden) * self.unit, weight)
        floor = self.floors[self.position(0)] = np.float32(self._floor() / self.unit)
        above = cv2.threshold(out, float(floor), 0.0, cv2.THRESH_TOZERO)[1]
        p_sum = cv2.sumElems(above)[0] - float(floor) * cv2.countNonZero(above)
        p_sum /= self.n_usual
        self.growth = p_sum / self._usual if self._usual else math.inf if p_sum else 0.0
        self._usual = smoothed(self._usual, p_sum, self._weight(self._params.w_m))
        return float(cv2.sumElems(out)[0])

    def _shift(self) -> Shift:
        """By how many cells the frames move, see `ContrastDLGMD`."""
        before = self.blocks(self.previous) if self._blocks is None else self._blocks
        now = self._blocks = self.blocks(self.current)
        most = self._params.shift // BLOCK
        self._shift_blocks, shift = follow(now, before, self._shift_blocks, most)
        if self._params.d_0 > 0.0:
            shifts = self._shift_blocks, shift
            frames = self.current, self.previous
            self.expansion.step(frames, self.unit, shifts, self.interval_s)
        still, moved = (
            mean_change(self.current, self.previous, whole(self.current), d)
            for d in ((0, 0), shift)
        )
        return shift if moved < MAX_LEFT * still else (0, 0)

    def _subtract(self, out: Grey, shift: Shift) -> None:
        """Write the change to `out`, (H, W), after the previous frame and earlier P' are moved."""
        (rows, from_rows), (columns, from_columns) = map(overlap, out.shape, shift)
        inside, source = (rows, columns), (from_rows, from_columns)
        cv2.absdiff(self.current[inside], self.previous[source], dst=out[inside])
        if self.hidden is not None:
            out[inside][self.hidden[source]] = 0
        earlier = range(1, self._depth) if shift != (0, 0) else ()
        for image in map(self.p, earlier):
            image[inside] = image[source]  # NumPy sees that they overlap
        for image in (out, *map(self.p, earlier)):
            image[: rows.start], image[rows.stop :] = 0, 0
            image[:, : columns.start], image[:, columns.stop :] = 0, 0
            self.clear(image)

    def _weight(self, weight: float) -> float:
        """The weight of the newest frame after `n_usual` frames, if it is `weight` after one."""
        return weight if self.n_usual == 1.0 else 1.0 - (1.0 - weight) ** self.n_usual

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
