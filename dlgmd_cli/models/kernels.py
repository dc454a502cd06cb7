"""The D-LGMD's connections: Gaussian strengths, radial latency, and one kernel for each delay."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.parameters.presets import DlgmdParameters

FloatKernel = npt.NDArray[np.float64]

# Latencies below `NEAR_FRAMES` give a delay of 0 frames, up to the edge by name 1, and beyond it 2.
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
    """The presynaptic connections of a cell in the S layer; kernels are (2r + 1, 2r + 1) float64.

    `latency` is τ, in frames, and `excitation` is K_E, applied to P(t). `inhibition` maps each
    delay d in frames that is in the latency map to K_d, applied to P(t - d). `gaussians` are the
    separable kernels of which the others are parts.
    """

    latency: FloatKernel
    excitation: FloatKernel
    inhibition: dict[int, FloatKernel]
    gaussians: tuple[FloatKernel, ...]

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


def delay_weights(latency: FloatKernel, rounding: str) -> dict[int, FloatKernel]:
    """Delay -> the share of each tap's inhibition that is so many frames late.

    Parameters
    ----------
    latency : ndarray, shape (2r + 1, 2r + 1), float64
        Latency of each tap, in frames.
    rounding : str
        One of the `LATENCIES`, see `connect`.
    """
    delays, nearest = range(int(np.ceil(latency.max())) + 1), np.floor(latency + 0.5)
    if rounding in BANDS:
        delays, nearest = range(3), np.digitize(latency, (NEAR_FRAMES, BANDS[rounding]))
    elif rounding == "interpolated":
        return {d: np.maximum(0.0, 1.0 - np.abs(latency - d)) for d in delays}
    return {d: (nearest == d).astype(np.float64) for d in delays}


def connect(params: DlgmdParameters) -> Connections:
    """Compute the kernels of all delays, [Zhao2023] Eqs. (2) to (7).

    Parameters
    ----------
    params : DlgmdParameters
        The latency `bands` follows the authors' code of 2021: inhibition in three bands, and
        excitation only where the latency is at most one frame. `bands-2020` follows their code of
        2020: the last band begins at 1.9 instead of 1.8999 frames, and excitation is everywhere.
        `bands-whole` has the bands of 2021 and the excitation of 2020. In all three, inhibition
        without delay is subtracted from excitation, down to 0. With the others, excitation is
        everywhere, as printed; inhibition is delayed to the `nearest` whole frame, or
        `interpolated` between the two frames next to its latency.
    """
    wide, excite = gaussian(params.r, params.sigma_i), gaussian(params.r, params.sigma_e)
    latency = latency_map(params.r, params.alpha, params.beta, params.lam)
    weights, narrow = delay_weights(latency, params.latency), excite
    if params.latency in BANDS:
        excite = np.maximum(excite - params.a * wide * weights.pop(0), 0.0)
        if params.latency == "bands":
            excite[latency > NEAR_FRAMES] = 0.0
    inhibition = {d: params.a * wide * weight for d, weight in weights.items() if weight.any()}
    return Connections(latency, excite, inhibition, (wide, narrow))
