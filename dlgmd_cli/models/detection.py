"""From membrane potential to alarm: normalisation, spikes, alarms. The same for every model."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.base import Grey, Model, Response, create_model, undefined
from dlgmd_cli.parameters import PRESETS, Parameters, load_config, parameters_of, shown
from dlgmd_cli.repeats import GapDetector, RepeatDetector

Series = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
Potential = TypeVar("Potential", float, Series)

# K of a single cell that answers to a change of one grey level, in luminance². A peak below it is
# rounding: the EMD-LGMD's of an object that recedes is 6e-7.
LEAST_PEAK = 1.0 / 255.0**2
# An alarm that begins so soon after the end of the one before belongs to it.
MERGE_S = 0.3
# Times such as 0.5 - 0.2 miss a tenth of a second by their last digits.
ROUNDING_S = 1e-6


def absolute(mp: Potential, n_cells: int, kappa: float | None) -> Potential:
    """Causal, scale-free membrane potential in [0, 1), comparable between videos.

    Parameters
    ----------
    mp : float or ndarray, shape (n,)
        Raw membrane potential K, not negative; NaN where undefined.
    n_cells : int
        Cells (pixels) that K sums over.
    kappa : float or None
        Mean excitation per cell at which the result is 1/2; None for the LGMD's own sigmoid.

    Returns
    -------
    float or ndarray, shape (n,)
        With κ̂ = K / n_cells: κ̂ / (κ̂ + κ), or 1 / (1 + exp(-κ̂)) in [0.5, 1), [Yue2006];
        NaN where `mp` is.
    """
    excitation = mp / n_cells
    if kappa is None:
        return 1.0 / (1.0 + np.exp(-excitation))
    return excitation / (excitation + kappa)


def sequence(mp: Series) -> Series:
    """Membrane potential scaled to [0, 1] by the extremes of its own sequence: offline only.

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


class SpikeDetector:
    """Spikes and alarms of a normalised membrane potential, frame by frame.

    Parameters
    ----------
    threshold : float
        T_MP, the level at which a spike is raised, [Zhao2023] Eq. (14).
    n_sp : int
        Spikes in a row that raise an alarm, [Zhao2023] Eq. (15).
    """

    def __init__(self, threshold: float, n_sp: int) -> None:
        self._threshold, self._n_sp = threshold, n_sp
        self.reset()

    def reset(self) -> None:
        """Forget the spikes before."""
        self._in_a_row = 0

    def step(self, level: float) -> tuple[bool, bool]:
        """Whether there is a spike at this frame, and whether the alarm is on; NaN is no spike."""
        spike = bool(level >= self._threshold)
        self._in_a_row = self._in_a_row + 1 if spike else 0
        return spike, self._in_a_row >= self._n_sp


def detect(levels: Series, threshold: float, n_sp: int) -> tuple[Flags, Flags]:
    """Spikes and alarms of a whole sequence, as `SpikeDetector` gives them frame by frame.

    Parameters
    ----------
    levels : ndarray, shape (n,)
        Normalised membrane potential; NaN where undefined.
    threshold, n_sp : float, int
        See `SpikeDetector`.

    Returns
    -------
    spikes, alarms : ndarray, shape (n,), bool
        The alarm is on from the n_sp-th spike in a row to the last.
    """
    detector = SpikeDetector(threshold, n_sp)
    flags = np.array([detector.step(level) for level in levels.tolist()], np.bool_)
    spikes, alarms = flags.reshape(-1, 2).T.copy()
    return spikes, alarms


def onsets(alarms: Flags, time_s: Series) -> npt.NDArray[np.intp]:
    """Rows at which an alarm is raised; one less than `MERGE_S` after the last is no new one.

    Parameters
    ----------
    alarms : ndarray, shape (n,), bool
        Where the alarm is on.
    time_s : ndarray, shape (n,)
        Times of the rows, in seconds, which do not decrease.

    Returns
    -------
    ndarray of int
        Row i is among them if the alarm is off at the row before, and was off for `MERGE_S`: no
        later row is needed to know it.
    """
    on = np.flatnonzero(alarms)
    is_new = np.ones(len(on), np.bool_)
    if len(on):
        pause_s = np.diff(time_s[on])
        is_new[1:] = (np.diff(on) > 1) & (pause_s >= MERGE_S - ROUNDING_S)
    return on[is_new]


@dataclass(frozen=True)
class Detection(Response):
    """A model's answer to one frame, and what follows from it.

    Attributes
    ----------
    mp_abs : float
        Membrane potential normalised by `absolute`; NaN before it is defined.
    spike : bool
        Whether `mp_abs` reaches the threshold.
    alarm : bool
        Whether the last n_sp frames, this one included, were spikes.
    """

    mp_abs: float = math.nan
    spike: bool = False
    alarm: bool = False


class Alarm:
    """A model with its alarm, fed one frame at a time: causal, in constant memory.

    Parameters
    ----------
    params : Parameters, optional
        Of any model; those of the preset `flight` unless given, which is made for frames 240 px
        wide.
    repeats : {"skip", "keep"}
        What to do with frames that merely repeat the one before: no answer to them but the last
        one, or show them to the model.
    engine : str
        See `DLGMD`.
    tell : callable, optional
        Called with a message before the engine is compiled, which takes some seconds.

    Attributes
    ----------
    model : Model
        What computes the membrane potential.

    Examples
    --------
    >>> import numpy as np
    >>> alarm = Alarm()
    >>> alarm.step(np.zeros((60, 80), np.uint8)).alarm
    False
    """

    def __init__(
        self,
        params: Parameters | None = None,
        *,
        repeats: str = "skip",
        engine: str = "auto",
        tell: Callable[[str], None] = lambda message: None,
    ) -> None:
        if repeats not in ("skip", "keep"):
            raise ParameterError("", f"repeats = {shown(repeats)} is not one of skip, keep")
        self.params = params if params is not None else parameters_of(load_config(PRESETS[0]))
        self.model: Model = create_model(self.params, engine=engine, tell=tell)
        self._spikes = SpikeDetector(self.params.t_mp, self.params.n_sp)
        self._gaps, self._repeats = GapDetector(), RepeatDetector() if repeats == "skip" else None
        self._last = Detection(**vars(undefined()))

    def reset(self) -> None:
        """Forget every frame seen so far; the next one may have another size."""
        self._begin_anew()
        self._gaps.reset()
        if self._repeats is not None:
            self._repeats.reset()

    def _begin_anew(self) -> None:
        """Forget what the model saw."""
        self.model.reset()
        self._spikes.reset()

    def step(self, frame: Grey, time_s: float | None = None) -> Detection:
        """Take the next frame and say whether the alarm is on.

        After a gap in time, which frames were lost in, the model begins anew: it has no answer
        until its history is full again.

        Parameters
        ----------
        frame : ndarray, shape (H, W), float32 or uint8
            Luminance in 0..1, or grey levels in 0..255.
        time_s : float, optional
            When the frame was taken; without it gaps go unnoticed.

        Raises
        ------
        FrameError
            If the frame is no such image, or not of the same size and type as the one before.
        MissingExtraError
            If the engine asked for needs a package that is not installed.
        """
        is_gap = time_s is not None and self._gaps.step(time_s)
        if self._repeats is not None and frame.ndim > 1 and self._repeats.step(frame):
            return self._last
        if is_gap:
            self._begin_anew()
        response = self.model.step(frame, time_s)
        mp_abs = float(absolute(response.mp, self.model.n_cells, self.params.kappa))
        spike, alarm = self._spikes.step(mp_abs)
        self._last = Detection(**vars(response), mp_abs=mp_abs, spike=spike, alarm=alarm)
        return self._last
