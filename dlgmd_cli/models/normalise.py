"""Normalisation of the membrane potential, the same for every model."""

from typing import TypeVar

import numpy as np

from dlgmd_cli.frame import Series

Potential = TypeVar("Potential", float, Series)

# K of a single cell for a change of one grey level, in luminance². A lower peak is due to rounding:
# for a receding object, the peak of the EMD-LGMD is 6e-7.
LEAST_PEAK = 1.0 / 255.0**2


def absolute(mp: Potential, n_cells: int, kappa: float | None) -> Potential:
    """Membrane potential normalised online, in [0, 1) and comparable between videos.

    Parameters
    ----------
    mp : float or ndarray, shape (n,)
        Raw membrane potential K, not negative; NaN where undefined.
    n_cells : int
        Cells (pixels) that K sums over.
    kappa : float or None
        Half-saturation constant, a mean excitation per cell; None for the LGMD's own sigmoid.

    Returns
    -------
    float or ndarray, shape (n,)
        With κ̂ = K / n_cells: κ̂ / (κ̂ + κ), or 1 / (1 + exp(-κ̂)) in [0.5, 1), [Yue2006];
        NaN where `mp` is.
    """
    excitation = mp / n_cells
    if kappa is None:
        return 1.0 / (1.0 + np.exp(-excitation))
    with np.errstate(invalid="ignore"):  # an infinite potential is a warning of its own
        return excitation / (excitation + kappa)


def excitation_at(level: float, kappa: float | None) -> float:
    """The mean excitation per cell at which `absolute` gives `level`; infinite for level 1."""
    with np.errstate(divide="ignore"):
        odds = float(np.divide(level, 1.0 - level))
        return float(np.log(odds)) if kappa is None else kappa * odds


def sequence(mp: Series) -> Series:
    """Membrane potential by the min–max of its whole sequence, in [0, 1]; offline.

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K of the whole sequence; NaN where undefined.

    Returns
    -------
    ndarray, shape (n,)
        (K - min K) / (max K - min K), as in the paper's figures; NaN where `mp` is, and
        everywhere if K never changes or stays below `LEAST_PEAK`.
    """
    low = float(np.fmin.reduce(mp, initial=np.nan))
    high = float(np.fmax.reduce(mp, initial=np.nan))
    if not high > low or high < LEAST_PEAK:
        return np.full_like(mp, np.nan)
    return (mp - low) / (high - low)
