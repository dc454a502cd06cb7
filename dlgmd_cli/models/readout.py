"""From membrane potential to alarm: normalisation, spikes, collision. The same for every model."""

from collections.abc import Iterable
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


def extremes(pieces: Iterable[Series]) -> tuple[float, float]:
    """The least and the greatest of all `pieces` of a sequence; NaN if nothing is defined."""
    low = high = np.nan
    for piece in pieces:
        low = float(np.fmin.reduce(piece, initial=low))
        high = float(np.fmax.reduce(piece, initial=high))
    return low, high


def normalise_sequence(mp: Series, ends: tuple[float, float] | None = None) -> Series:
    """Membrane potential scaled to [0, 1] by the extremes of its own sequence.

    Parameters
    ----------
    mp : ndarray, shape (n,)
        Raw membrane potential K; NaN where undefined.
    ends : (float, float), optional
        Least and greatest K of the sequence that `mp` is a piece of, see `extremes`; those of
        `mp` unless given.

    Returns
    -------
    ndarray, shape (n,)
        (K - min K) / (max K - min K), as in the paper's figures; NaN where `mp` is, and
        everywhere if K never changes.
    """
    low, high = ends or extremes([mp])
    if not high > low:
        return np.full_like(mp, np.nan)
    return (mp - low) / (high - low)


def spikes(level: Series, threshold: float) -> Flags:
    """Where the normalised membrane potential reaches its threshold, [Zhao2023] Eq. (14)."""
    return np.asarray(level >= threshold)  # false for NaN


def in_a_row(spike: Flags, n_before: int = 0) -> npt.NDArray[np.intp]:
    """How many spikes without a gap end at each frame; `n_before` ended just before the first."""
    frame = np.arange(1, len(spike) + 1)
    last_quiet = np.maximum.accumulate(np.where(spike, -n_before, frame))
    return np.asarray(frame - last_quiet)


@dataclass(frozen=True)
class Readout:
    """Everything that follows from a sequence of membrane potentials; arrays of shape (n,).

    `in_a_row` counts the spikes that end at each frame without a gap; `collision` is where they
    are at least N_sp, [Zhao2023] Eq. (15).
    """

    mp_abs: Series
    mp_seq: Series
    level: Series
    spike: Flags
    in_a_row: npt.NDArray[np.intp]
    collision: Flags


def read_out(
    mp: Series,
    n_cells: int,
    *,
    kappa: float | None,
    threshold: float,
    n_sp: int,
    by_sequence: bool,
    ends: tuple[float, float] | None = None,
    n_before: int = 0,
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
    ends : (float, float), optional
        Where `mp` is a piece of a sequence, the least and the greatest K of the whole.
    n_before : int
        Where it is a later piece, the last `in_a_row` of the one before.
    """
    if kappa is None:
        mp_abs = normalise_sigmoid(mp, n_cells)
    else:
        mp_abs = normalise_absolute(mp, n_cells, kappa)
    mp_seq = normalise_sequence(mp, ends)
    level = mp_seq if by_sequence else mp_abs
    spike = spikes(level, threshold)
    run = in_a_row(spike, n_before)
    return Readout(mp_abs, mp_seq, level, spike, run, run >= n_sp)
