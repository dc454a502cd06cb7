"""Normalisation of the membrane potential, spikes and alarms, the same for every model."""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeVar

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.base import Response
from dlgmd_cli.parameters.keys import SPIKES, TTC, Parameters

Potential = TypeVar("Potential", float, Series)

# K of a single cell for a change of one grey level, in luminance². A lower peak is due to rounding;
# for a receding object, the EMD-LGMD's is 6e-7.
LEAST_PEAK = 1.0 / 255.0**2
# An alarm that begins within this time after the end of another belongs to it.
MERGE_S = 0.3
# Tolerance for rounding in differences of times, such as 0.5 - 0.2.
ROUNDING_S = 1e-6
# Where the middle third of the image ends, in halves of its sides from its centre.
_THIRD = 1.0 / 3.0


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
    return excitation / (excitation + kappa)


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


class Rule:
    """The rule of an alarm, beside a model and the expansion: it turns either into alarms.

    With the rule `spikes`, the alarm is on after `n_sp` spikes in a row, [Zhao2023] Eq. (15). With
    `ttc`, it is on while the time to contact is `ttc_alarm` or less.

    Parameters
    ----------
    params : Parameters
        `alarm` is the rule; `t_mp` is T_MP, the level of a spike, Eq. (14).
    """

    def __init__(self, params: Parameters) -> None:
        self.name, self.t_mp, self.ttc_alarm = params.alarm, params.t_mp, params.ttc_alarm
        self.n_in_a_row = params.n_sp if self.name == SPIKES else 1
        self.reset()

    @property
    def text(self) -> str:
        """The rule in words."""
        if self.name == TTC:
            return f"ttc: time to contact of {self.ttc_alarm:g} s or less"
        return f"spikes: {self.n_in_a_row} in a row, at an MP of {self.t_mp:g} or more"

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._in_a_row = 0

    def step(self, level: float, ttc_s: float) -> tuple[bool, bool]:
        """Whether a frame is a spike, and whether the alarm is on; NaN is neither.

        `level` is the normalised membrane potential, `ttc_s` the time to contact in seconds.
        """
        spike = bool(level >= self.t_mp)
        is_on = spike if self.name == SPIKES else ttc_s <= self.ttc_alarm
        self._in_a_row = self._in_a_row + 1 if is_on else 0
        return spike, self._in_a_row >= self.n_in_a_row

    def detect(self, levels: Series, ttc_s: Series) -> tuple[Flags, Flags]:
        """Spikes and alarms of a whole sequence, shape (n,) each; see `step`."""
        self.reset()
        flags = np.array([*map(self.step, levels.tolist(), ttc_s.tolist())], np.bool_)
        spikes, alarms = flags.reshape(-1, 2).T.copy()
        return spikes, alarms


def spans(alarms: Flags, time_s: Series) -> npt.NDArray[np.intp]:
    """First and last row of every alarm; pauses shorter than `MERGE_S` do not end one.

    Parameters
    ----------
    alarms : ndarray, shape (n,), bool
        Where the alarm is on.
    time_s : ndarray, shape (n,)
        Non-decreasing times of the rows, in seconds.

    Returns
    -------
    ndarray of int, shape (n_alarms, 2)
        Rows where the alarm turns on after it was off for `MERGE_S` at least, and the rows where it
        is on for the last time. The former are causal: they do not depend on later rows.
    """
    on = np.flatnonzero(alarms)
    is_new = np.ones(len(on), np.bool_)
    if len(on):
        pause_s = np.diff(time_s[on])
        is_new[1:] = (np.diff(on) > 1) & (pause_s >= MERGE_S - ROUNDING_S)
    return np.column_stack((on[is_new], on[np.roll(is_new, -1)]))


def side_of(g_x: float, g_y: float) -> str:
    """The third of the image that a centroid lies in.

    Parameters
    ----------
    g_x, g_y : float
        Centroid, from -1 (left, top) to 1; NaN where undefined.

    Returns
    -------
    str
        `left` (g_x below -1/3), `ahead` or `right` (above 1/3), followed by ``high`` (g_y below
        -1/3) or ``low`` (above 1/3) outside the middle third, such as ``left high``; empty if the
        centroid is undefined.
    """
    if math.isnan(g_x) or math.isnan(g_y):
        return ""
    across = "left" if g_x < -_THIRD else "right" if g_x > _THIRD else "ahead"
    return across + (" high" if g_y < -_THIRD else " low" if g_y > _THIRD else "")


def side_by(rule: str, places: Any) -> str:
    """The `side_of` what a rule goes by: the active cells, or the part of the image that expands.

    `places` has their `g_x` and `g_y`, or its `expansion_x` and `expansion_y`.
    """
    if rule == SPIKES:
        return side_of(places.g_x, places.g_y)
    return side_of(places.expansion_x, places.expansion_y)


# The columns of alarms.csv.
ALARM_COLUMNS = (
    *("start_frame", "start_s", "end_frame", "end_s", "peak_mp_abs", "g_x", "g_y", "side", "ttc_s"),
    "rule",
)


class AlarmSpan(NamedTuple):
    """An alarm: when, how strong, and from where; a row of alarms.csv.

    Attributes
    ----------
    start_frame, start_s : int, float
        The frame that raises the alarm, and its time in seconds.
    end_frame, end_s : int, float
        The last frame at which the alarm is on.
    peak_mp_abs : float
        Greatest normalised membrane potential of the frames at which it is on.
    g_x, g_y : float
        Centroid of the active cells in the frame that raises the alarm, NaN if there are none.
    ttc_s : float
        Time to contact in that frame, in seconds; NaN where nothing expands.
    rule : str
        The rule that raises the alarm, see `Rule`.
    expansion_x, expansion_y : float
        Centre of the part of the image that expands in that frame, see `Measured`.
    """

    start_frame: int
    start_s: float
    end_frame: int
    end_s: float
    peak_mp_abs: float
    g_x: float = math.nan
    g_y: float = math.nan
    ttc_s: float = math.nan
    rule: str = SPIKES
    expansion_x: float = math.nan
    expansion_y: float = math.nan

    @property
    def side(self) -> str:
        """Where in the image it was raised, by what raised it, see `side_of`."""
        return side_by(self.rule, self)

    def to_dict(self) -> dict[str, Any]:
        """The columns of alarms.csv; None where a number is not defined."""
        values = {name: getattr(self, name) for name in ALARM_COLUMNS}
        return {k: None if v != v else v for k, v in values.items()}


@dataclass(frozen=True)
class Detection(Response):
    """A model's response to one frame, the expansion beside it, and what the rule makes of both.

    Attributes
    ----------
    expansion, ttc_s, expansion_x, expansion_y, ttc_share : float
        Expansion rate in 1/s, time to contact in seconds, where, and how good, see `Measured`.
    mp_abs : float
        Membrane potential normalised by `absolute`; NaN until defined.
    spike : bool
        Whether `mp_abs` reaches the threshold.
    alarm : bool
        Whether the alarm is on, see `Rule`.
    rule : str
        The rule of the alarm: `spikes` or `ttc`.
    blind : str or None
        Why the images show nothing, see `Health`: `black`, `flat`, `noise` or `frozen`. None if
        they are sound, or not bad for long enough. While it is set, no alarm is no all-clear.
    """

    expansion: float = math.nan
    ttc_s: float = math.nan
    expansion_x: float = math.nan
    expansion_y: float = math.nan
    ttc_share: float = math.nan
    mp_abs: float = math.nan
    spike: bool = False
    alarm: bool = False
    rule: str = SPIKES
    blind: str | None = None

    @property
    def side(self) -> str:
        """Where in the image what the rule goes by is, see `side_by`."""
        return side_by(self.rule, self)
