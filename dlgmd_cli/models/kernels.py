"""The D-LGMD's connections: Gaussian strengths, radial latency, and one kernel for each delay."""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ModelError

FloatKernel = npt.NDArray[np.float64]

# The delay is 0 frames for latencies below NEAR_FRAMES, 1 up to the edge in BANDS, 2 beyond it.
NEAR_FRAMES = 1.0
BANDS = {"bands": 1.8999, "bands-whole": 1.8999, "bands-2020": 1.9}


def _radius_squared(radius_px: int) -> FloatKernel:
    """x² + y² at every tap, (2r + 1, 2r + 1), in px²."""
    axis = np.arange(-radius_px, radius_px + 1, dtype=np.float64) ** 2
    return axis[:, None] + axis[None, :]


def gaussian(radius_px: int, sigma_px: float) -> FloatKernel:
    """Strength of a connection at each tap of the kernel.

    Parameters
    ----------
    radius_px : int
        Kernel radius r, not negative.
    sigma_px : float
        Standard deviation, in px, above 0.

    Returns
    -------
    ndarray, shape (2r + 1, 2r + 1), float64
        exp(-(x² + y²) / 2σ²) / (σ√(2π)), [Zhao2023] Eq. (4).

    Notes
    -----
    The amplitude is that of the one-dimensional Gaussian, as in the authors' released code. With a
    Gaussian of unit mass, the model would not be selective for speed.
    """
    exponent = -_radius_squared(radius_px) / (2.0 * sigma_px**2)
    strength: FloatKernel = np.exp(exponent) / (sigma_px * np.sqrt(2.0 * np.pi))
    return strength


def latency_map(radius_px: int, alpha: float, beta: float, lam: float) -> FloatKernel:
    """Latency of inhibition at each tap of the kernel.

    Parameters
    ----------
    radius_px : int
        Kernel radius r, not negative.
    alpha, beta : float
        Shift (frames) and saturation (1/frames, not negative) of the curve.
    lam : float
        Spread of the curve (1/px), λ in the paper.

    Returns
    -------
    ndarray, shape (2r + 1, 2r + 1), float64
        α + 1 / (β + exp(-λ²(x² + y²))) in frames, least at the centre, [Zhao2023] Eq. (5).
    """
    latency: FloatKernel = alpha + 1.0 / (beta + np.exp(-(lam**2) * _radius_squared(radius_px)))
    return latency


@dataclass(frozen=True)
class Connections:
    """The presynaptic connections of a cell in the S layer.

    Every kernel is (2r + 1, 2r + 1) float64. Its tap at [r + y, r + x] weighs the cell that is x px
    to the right and y px down.

    Attributes
    ----------
    latency : ndarray
        τ, in frames.
    excitation : ndarray
        K_E, applied to P(t).
    inhibition : dict of int to ndarray
        Delay d in frames -> K_d, applied to P(t - d).
    gaussians : tuple of ndarray
        Separable kernels; kernels that are parts of them need fewer operations.

    Raises
    ------
    ModelError
        If the kernels are not square, of one odd side, or a delay is not a whole number from 0 on.
    """

    latency: FloatKernel
    excitation: FloatKernel
    inhibition: dict[int, FloatKernel]
    gaussians: tuple[FloatKernel, ...] = ()

    def __post_init__(self) -> None:
        shape = self.latency.shape
        kernels = (self.excitation, *self.inhibition.values(), *self.gaussians)
        if len(shape) != 2 or shape[0] != shape[1] or shape[0] % 2 == 0:
            raise ModelError("connect()", f"the latency has shape {shape}, not (2r + 1, 2r + 1)")
        if any(kernel.shape != shape for kernel in kernels):
            why = f"not all kernels have the shape of the latency, {shape}"
            raise ModelError("connect()", why)
        if not all(isinstance(delay, int | np.integer) and delay >= 0 for delay in self.inhibition):
            why = f"the delays {sorted(self.inhibition)} are not whole numbers of frames from 0 on"
            raise ModelError("connect()", why)

    @property
    def radius_px(self) -> int:
        """The kernels' radius r."""
        return self.latency.shape[0] // 2

    @property
    def max_delay_frames(self) -> int:
        """The longest delay of inhibition."""
        return max(self.inhibition, default=0)

    def signed(self) -> dict[int, FloatKernel]:
        """Delay -> total kernel: excitation is positive, inhibition negative."""
        by_delay = {delay: -kernel for delay, kernel in self.inhibition.items()}
        by_delay[0] = self.excitation + by_delay.get(0, 0.0)
        return by_delay


def shares(n: int, scale: float) -> FloatKernel:
    """The shares that n cells in a row, centred, have in the cells of a finer or coarser row.

    Parameters
    ----------
    n : int
        Number of cells, odd.
    scale : float
        Cells of the other row in one of these cells, above 0.

    Returns
    -------
    ndarray, shape (m, n), float64
        The length, in cells of the other row, of the overlap of each pair; m is odd.
    """
    reach = math.ceil((n * scale - 1.0) / 2.0 - 1e-9)
    others = np.arange(-reach, reach + 1)[:, np.newaxis]
    edges = scale * (np.arange(n + 1) - n / 2.0)
    inside = np.minimum(others + 0.5, edges[1:]) - np.maximum(others - 0.5, edges[:-1])
    return np.maximum(inside, 0.0)


def resized(connections: Connections, scale: float) -> Connections:
    """Connections that spread over `scale` times as many cells, with the same sums.

    Each tap is a square of `scale` x `scale` cells with the tap's strength in all.
    """
    if scale == 1.0:
        return connections
    overlap = shares(len(connections.latency), scale)

    def of(kernel: FloatKernel) -> FloatKernel:
        spread: FloatKernel = overlap @ kernel @ overlap.T
        return spread

    sums = of(np.ones_like(connections.latency))
    by_delay = {delay: of(kernel) / scale**2 for delay, kernel in connections.inhibition.items()}
    excitation = of(connections.excitation) / scale**2
    return Connections(of(connections.latency) / sums, excitation, by_delay)


def delayed(kernel: FloatKernel, latency: FloatKernel, rounding: str) -> dict[int, FloatKernel]:
    """Delay in frames -> the part of a kernel with this delay; delays without taps are left out.

    Parameters
    ----------
    kernel : ndarray, shape (2r + 1, 2r + 1), float64
        Strength of each tap.
    latency : ndarray, shape (2r + 1, 2r + 1), float64
        Latency of each tap, in frames, not negative.
    rounding : str
        One of the `LATENCIES`. In the `bands` of the authors' codes, the delay is 0 frames where
        τ < 1, 1 up to τ = 1.8999 (in `bands-2020`, 1.9), and 2 beyond. `nearest` rounds τ to the
        nearest frame; `interpolated` divides the strength between the two frames next to τ.

    Raises
    ------
    ModelError
        If the latency has another shape than the kernel, or is negative or not a number anywhere.
    """
    if latency.shape != kernel.shape:
        why = f"it returns an array of shape {latency.shape}, not {kernel.shape}"
        raise ModelError("latency()", why)
    if not np.all((latency >= 0.0) & np.isfinite(latency)):
        hint = "Inhibition cannot come before its cause."
        raise ModelError("latency()", "some of it is negative or not a number", hint)
    weights = _delay_weights(latency, rounding)
    return {delay: kernel * weight for delay, weight in weights.items() if weight.any()}


def _delay_weights(latency: FloatKernel, rounding: str) -> dict[int, FloatKernel]:
    """Delay in frames -> the share of each tap that has this delay, see `delayed`."""
    delays, nearest = range(int(np.ceil(latency.max())) + 1), np.floor(latency + 0.5)
    if rounding in BANDS:
        delays, nearest = range(3), np.digitize(latency, (NEAR_FRAMES, BANDS[rounding]))
    elif rounding == "interpolated":
        return {d: np.maximum(0.0, 1.0 - np.abs(latency - d)) for d in delays}
    return {d: (nearest == d).astype(np.float64) for d in delays}
