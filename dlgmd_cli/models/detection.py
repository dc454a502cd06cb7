"""What a frame gave, and the alarms of a whole run."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.base import Response
from dlgmd_cli.models.columns import (
    ALARMS,
    ATTENUATION,
    MP,
    SPIKES,
    TABLES,
    Column,
    column,
    columns_of,
    described,
)
from dlgmd_cli.models.expansion import Measured
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.parameters.keys import SPIKES as SPIKES_RULE

# An alarm that begins less than this time (s) after the end of an alarm continues that alarm.
MERGE_S = 0.3
# Tolerance (s) for rounding in differences of times, such as 0.5 - 0.2.
ROUNDING_S = 1e-6


@described
@dataclass(frozen=True)
class Detection(Measured, Response):
    """What a frame gave: a model's response, the measured expansion, the rule's spike and alarm.

    The numbers of the response and of the expansion are those of `Response` and `Measured`. A
    custom rule is given a detection whose `signal`, `spike` and `alarm` are not set yet. On a copy,
    all numbers are those of the frame before.

    Attributes
    ----------
    rule : str
        The name of the alarm's rule, such as `spikes` or `ttc`.
    side : str
        The image region of what the rule compares, see `side_of`; empty where undefined.
    """

    frame: int = column("–", "number in the input, from 0", *TABLES, kind=int, default=-1)
    time_s: float = column("s", "time of the frame, from the decoder", *TABLES)
    mp_abs: float = column("–", "the MP on a [fixed scale](words.md#the-model), 0 to 1")
    level: float = column(
        "–", "normalised MP: `mp_abs`; with `--normalise sequence`, `mp_seq`", SPIKES
    )
    spike: bool = column("0, 1", "whether the frame is a spike", SPIKES, kind=bool, default=False)
    signal: float = column(
        "1/s, s or –",
        "what the rule compares with its threshold: a rate, the time to contact (`ttc`) or the "
        "normalised MP (`spikes`)",
    )
    signal_limit: str = column(
        "–",
        "why `signal` is below `expansion`: [`ground`, `quality` or "
        "`approach`](questions.md#why-is-there-no-alarm-here)",
        kind=str,
        default="",
    )
    alarm: bool = column("0, 1", "whether the alarm is on", MP, SPIKES, kind=bool, default=False)
    repeat: bool = column(
        "0, 1",
        "whether the row is a copy (always 0 before the model's first response)",
        *TABLES,
        kind=bool,
        default=False,
    )
    gap: bool = column(
        "0, 1",
        "whether the model began anew, since frames are missing before this one",
        kind=bool,
        default=False,
    )
    blind: str = column(
        "–",
        "why a collision may raise no alarm: [`unmeasured`](measurements.md#unmeasured), or in "
        "`live` another [reason](live.md#health)",
        kind=str,
        default="",
    )
    rule: str = SPIKES_RULE
    side: str = ""


# Every column that a row holds, in the order of the tables: which frame it is comes first.
COLUMNS = (
    *sorted(columns_of(Detection), key=lambda one: one.name not in ("frame", "time_s")),
    Column(
        "attenuation_db",
        "dB",
        "10 log10(ΣS/ΣP); drawn at −60 if below; `-inf` from −69 dB down",
        (ATTENUATION,),
    ),
)


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


@described
@dataclass(frozen=True)
class AlarmSpan:
    """An alarm: its times, strength and place in the image; a row of alarms.csv."""

    start_frame: int = column("–", "first frame of the alarm", ALARMS, kind=int, default=0)
    start_s: float = column("s", "its time", ALARMS)
    end_frame: int = column("–", "last frame of the alarm", ALARMS, kind=int, default=0)
    end_s: float = column("s", "its time", ALARMS)
    peak_signal: float = column(
        "1/s, s or –",
        "greatest `signal`; with the rule `ttc`, the least",
        ALARMS,
    )
    peak_mp_abs: float = column(
        "–", "greatest `mp_abs`; empty if the alarm ends before the model responds", ALARMS
    )
    g_x: float = column("–", "centroid of the active cells as the alarm begins", ALARMS)
    g_y: float = column("–", "centroid of the active cells as the alarm begins", ALARMS)
    side: str = column(
        "–",
        "image region: `left`, `ahead` or `right`; above or below the middle third, also `high` "
        "or `low`",
        ALARMS,
        kind=str,
        default="",
    )
    ttc_s: float = column("s", "estimated time to contact as the alarm begins", ALARMS)
    rule: str = column(
        "–",
        "name of the rule",
        ALARMS,
        kind=str,
        default=SPIKES_RULE,
    )

    @classmethod
    def at(cls, row: Any, rule: str, side: str) -> "AlarmSpan":
        """An alarm that a row, of `Detection` or alike, raises."""
        frame, time_s = int(row.frame), float(row.time_s)
        return cls(
            start_frame=frame,
            start_s=time_s,
            end_frame=frame,
            end_s=time_s,
            peak_signal=float(row.signal),
            peak_mp_abs=float(row.mp_abs),
            g_x=float(row.g_x),
            g_y=float(row.g_y),
            side=side,
            ttc_s=float(row.ttc_s),
            rule=rule,
        )

    def until(self, row: Any, *, at_most: bool) -> "AlarmSpan":
        """The alarm with one more row; with `at_most`, the least signal is the strongest."""
        strongest = np.fmin if at_most else np.fmax
        return replace(
            self,
            end_frame=int(row.frame),
            end_s=float(row.time_s),
            peak_signal=float(strongest(self.peak_signal, row.signal)),
            peak_mp_abs=float(np.fmax(self.peak_mp_abs, row.mp_abs)),
        )

    def to_dict(self) -> dict[str, Value | None]:
        """The columns of alarms.csv; None where a number is not defined."""
        return {name: None if v != v else v for name, v in vars(self).items()}
