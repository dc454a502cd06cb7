"""From membrane potential to alarm: normalisation, spikes, collision. The same for every model."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Series = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]


def normalise_absolute(mp: Series, n_cells: int, kappa: float) -> Series:
    """Causal, scale-free membrane potential in [0, 1).

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K; NaN where undefined.
    n_cells : int
        Cells (pixels) that K sums over.
    kappa : float
        Mean excitation per cell at which the result is 1/2.

    Returns
    -------
    ndarray, shape (n,)
        κ̂ / (κ̂ + κ) with κ̂ = K / n_cells; NaN where `mp` is.
    """
    excitation = mp / n_cells
    return excitation / (excitation + kappa)


def normalise_sigmoid(mp: Series, n_cells: int) -> Series:
    """The LGMD's own normalisation, in [0.5, 1).

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K, not negative; NaN where undefined.
    n_cells : int
        Cells (pixels) that K sums over.

    Returns
    -------
    ndarray, shape (n,)
        κ = 1 / (1 + exp(-K / n_cells)), [Yue2006]; NaN where `mp` is.
    """
    return np.asarray(1.0 / (1.0 + np.exp(-mp / n_cells)))


def normalise_sequence(mp: Series) -> Series:
    """Membrane potential scaled to [0, 1] by the extremes of its own sequence.

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K; NaN where undefined.

    Returns
    -------
    ndarray, shape (n,)
        (K - min K) / (max K - min K), as in the paper's figures; NaN where `mp` is, and
        everywhere if K never changes.
    """
    valid = mp[~np.isnan(mp)]
    if valid.size == 0 or valid.max() == valid.min():
        return np.full_like(mp, np.nan)
    return (mp - valid.min()) / (valid.max() - valid.min())


def spikes(level: Series, threshold: float) -> Flags:
    """Where the normalised membrane potential reaches its threshold, [Zhao2023] Eq. (14)."""
    return np.asarray(level >= threshold)  # false for NaN


def collisions(spike: Flags, n_sp: int) -> Flags:
    """Where a spike is at least the `n_sp`-th in a row, [Zhao2023] Eq. (15)."""
    alarm = np.zeros_like(spike)
    in_a_row = 0
    for frame, spiking in enumerate(spike):
        in_a_row = in_a_row + 1 if spiking else 0
        alarm[frame] = in_a_row >= n_sp
    return alarm


@dataclass(frozen=True)
class Readout:
    """Everything that follows from a sequence of membrane potentials; arrays of shape (n,)."""

    mp_abs: Series
    mp_seq: Series
    level: Series
    spike: Flags
    collision: Flags


def read_out(
    mp: Series, n_cells: int, *, kappa: float | None, threshold: float, n_sp: int, by_sequence: bool
) -> Readout:
    """Normalise `mp` both ways, and let one of them drive spikes and collisions.

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K; NaN where undefined.
    n_cells : int
        Cells (pixels) that K sums over.
    kappa : float or None
        See `normalise_absolute`; None for `normalise_sigmoid` in its place.
    threshold : float
        T_MP, the level at which a spike is raised.
    n_sp : int
        Spikes in a row that make a collision.
    by_sequence : bool
        Spikes follow `mp_seq` instead of `mp_abs`.
    """
    if kappa is None:
        mp_abs = normalise_sigmoid(mp, n_cells)
    else:
        mp_abs = normalise_absolute(mp, n_cells, kappa)
    mp_seq = normalise_sequence(mp)
    level = mp_seq if by_sequence else mp_abs
    spike = spikes(level, threshold)
    return Readout(mp_abs, mp_seq, level, spike, collisions(spike, n_sp))
