"""Alarms: the detection of each frame, and the alarms of a whole run."""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.base import Response
from dlgmd_cli.models.rules import rule_named
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.keys import SPIKES

# An alarm that begins less than this time (s) after the end of an alarm continues that alarm.
MERGE_S = 0.3
# Tolerance (s) for rounding in differences of times, such as 0.5 - 0.2.
ROUNDING_S = 1e-6


class Episodes:
    """Tells frame by frame where alarms begin and end; a pause below `MERGE_S` ends no alarm."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Forget all earlier frames."""
        self._last_on_s, self._was_on = math.nan, False

    def step(self, time_s: float, is_on: bool) -> tuple[bool, bool]:
        """Whether an alarm ended before the next frame, and whether an alarm begins there."""
        is_long = time_s - self._last_on_s >= MERGE_S - ROUNDING_S
        has_ended = is_long and not (self._was_on and is_on)
        begins = is_on and (has_ended or math.isnan(self._last_on_s))
        if is_on:
            self._last_on_s = time_s
        elif has_ended:
            self._last_on_s = math.nan
        self._was_on = is_on
        return has_ended, begins


def spans(alarms: Flags, time_s: Series) -> npt.NDArray[np.intp]:
    """First and last row of every alarm; a pause shorter than `MERGE_S` ends no alarm.

    Parameters
    ----------
    alarms : ndarray, shape (n,), bool
        Where the alarm is on.
    time_s : ndarray, shape (n,)
        Non-decreasing times of the rows, in seconds.

    Returns
    -------
    ndarray of int, shape (n_alarms, 2)
        First row: the alarm turns on after at least `MERGE_S` off. Last row: the alarm is on for
        the last time. First rows are causal: they do not depend on later rows.
    """
    episodes, found = Episodes(), list[list[int]]()
    for row, (time, is_on) in enumerate(zip(time_s.tolist(), alarms.tolist(), strict=True)):
        _, begins = episodes.step(time, is_on)
        if begins:
            found.append([row, row])
        elif is_on:
            found[-1][1] = row
    return np.array(found, np.intp).reshape(-1, 2)


# The columns of alarms.csv.
ALARM_COLUMNS = (
    *("start_frame", "start_s", "end_frame", "end_s", "peak_mp_abs", "g_x", "g_y", "side", "ttc_s"),
    "rule",
)


class AlarmSpan(NamedTuple):
    """An alarm: its times, strength and place in the image; a row of alarms.csv.

    Attributes
    ----------
    start_frame, start_s : int, float
        The frame that raises the alarm, and its time in seconds.
    end_frame, end_s : int, float
        The last frame at which the alarm is on, and its time in seconds.
    peak_mp_abs : float
        Largest normalised membrane potential of the frames at which the alarm is on.
    g_x, g_y : float
        Centroid of the active cells in the frame that raises the alarm, NaN if there are none.
    ttc_s : float
        Time to contact in that frame, in seconds; NaN where nothing expands.
    rule : str
        The name of the rule that raises the alarm, see `Rule`.
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
        """The image region that raised the alarm, see `Rule.side`."""
        places = (self.g_x, self.g_y), (self.expansion_x, self.expansion_y)
        return rule_named(self.rule).side(*places)

    def to_dict(self) -> dict[str, Value | None]:
        """The columns of alarms.csv; None where a number is not defined."""
        values = {name: getattr(self, name) for name in ALARM_COLUMNS}
        return {k: None if v != v else v for k, v in values.items()}


@dataclass(frozen=True)
class Detection(Response):
    """A model's response to one frame, the measured expansion, and the rule's spike and alarm.

    Attributes
    ----------
    expansion, expansion_across, expansion_quality, ttc_s : float
    expansion_x, expansion_y, approach : float
        Expansion rates in 1/s, quality, time to contact in seconds, place, see `Measured`.
    mp_abs : float
        Membrane potential normalised by `absolute`; NaN until defined.
    spike : bool
        Whether `mp_abs` reaches the threshold.
    alarm : bool
        Whether the alarm is on, see `Rule`.
    rule : str
        The name of the alarm's rule, such as `spikes` or `ttc`.
    blind : str or None
        Why the images show nothing, see `Health`: `black`, `flat`, `noise` or `frozen`. None if the
        images are sound, or not bad for long enough. While `blind` is set, silence is no all-clear.
    """

    expansion: float = math.nan
    expansion_across: float = math.nan
    expansion_quality: float = math.nan
    ttc_s: float = math.nan
    expansion_x: float = math.nan
    expansion_y: float = math.nan
    approach: float = math.nan
    mp_abs: float = math.nan
    spike: bool = False
    alarm: bool = False
    rule: str = SPIKES
    blind: str | None = None

    @property
    def side(self) -> str:
        """The image region of the quantity that the rule compares, see `Rule.side`."""
        places = (self.g_x, self.g_y), (self.expansion_x, self.expansion_y)
        return rule_named(self.rule).side(*places)
