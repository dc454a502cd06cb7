"""Scores of labelled videos by the onsets of alarms, at any threshold.

An *onset* is the frame at which an alarm begins. A contact at time t, for which a stop must begin s
seconds earlier and the approach begins at a, has one outcome:

- with a speed, *in time*: an onset from t1 = t - s - 1.5 s to t - s;
- with a speed, *too late*: an onset after t - s, up to t;
- with a speed, *too early*: an onset before t1, of an alarm that lasts until t1 - 1 s or longer;
- without a speed, *announced*: an onset from t1 = max(a, t - 2 s) - 1 s to t;
- *missed*: no such onset. Such a contact is *told* if the model was blind in the last 1.5 s.

Of several outcomes, the first in this list counts. An onset from t1 to t + 1 s is never false. Any
other onset, also one that is too early, is a *false* alarm, and each further 2 s of the alarm are
another. Such an alarm is *justified* instead if, by the truth, the image grows by 0.45/s or more in
at least two frames within 1 s of the onset.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.detection import MERGE_S, ROUNDING_S
from dlgmd_cli.models.stopping import BRAKES
from dlgmd_cli.parameters.facts import Json, finite
from dlgmd_cli.results.intervals import holm, interval, p_value

# An alarm in time begins at most this many seconds before a stop must begin.
EARLIEST_S = 1.5
# Without a speed, an approach lasts at most APPROACH_S (s), and an alarm may begin BEFORE_S before.
# An alarm that is too early lasts until BEFORE_S before the first moment in time, or longer.
APPROACH_S, BEFORE_S = 2.0, 1.0
# Up to AFTER_S (s) after a contact, no onset is false. Each further STANDS_S (s) that a false alarm
# lasts count as another false alarm.
AFTER_S, STANDS_S = 1.0, 2.0
# N_NEAR frames with a high true rate within NEAR_S (s) of an onset justify the alarm.
NEAR_S, N_NEAR = 1.0, 2
# A contact is told if the model was blind in the last TOLD_S (s) before it.
TOLD_S = 1.5
# The outcomes of a contact. An onset has one of these outcomes, or one of the three others.
OUTCOMES = ("missed", "too_early", "too_late", "announced", "in_time")
MISSED, TOO_EARLY, TOO_LATE, ANNOUNCED, IN_TIME = range(5)
FALSE, JUSTIFIED, FURTHER = "false", "justified", "further"
# The measures of `score` that have an interval; the counts of `score`.
MEASURES = ("recall", *(f"{name}_share" for name in OUTCOMES), "false_alarms_per_min", "in_alarm")
IN_TIME_BY = [f"in_time_{name}" for name in BRAKES]
COUNTS = ("videos", "contacts", "hits", *OUTCOMES, *IN_TIME_BY, "told")
COUNTS += ("false_alarms", "justified", "minutes")

# Measure or count -> value, for a model on some videos at one threshold, see `score`.
Scores = dict[str, float]
# Maximum number of comparisons of a strength with a threshold in one array.
_AT_ONCE = 1 << 21


class Contact(NamedTuple):
    """A contact: its time, and the first and last time of an onset in time or announcing it (s).

    `stops_s` has the times that the stops of `BRAKES` need, if the speed is known.
    """

    time_s: float
    from_s: float
    until_s: float
    has_speed: bool = False
    stops_s: tuple[float, ...] = ()


def contact_of(
    time_s: float, approach_s: float = -math.inf, stop_s: float | None = None
) -> Contact:
    """The contact at `time_s`; `stop_s` is the time that a stop needs if the speed is known."""
    if stop_s is not None:
        return Contact(time_s, time_s - stop_s - EARLIEST_S, time_s - stop_s, True)
    return Contact(time_s, max(approach_s, time_s - APPROACH_S) - BEFORE_S, time_s)


@dataclass(frozen=True)
class Signal:
    """The signal of one video, which is compared with a threshold, and the video's contacts.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times of the frames, in seconds, increasing; n is at least 1.
    strength : ndarray, shape (n,)
        A frame is a spike if its strength reaches the threshold; NaN (no spike) if undefined.
    contacts : tuple of Contact
        The contacts in order of time.
    frame_s : float
        Duration of a frame of the video, in seconds.
    repeated : ndarray, shape (n,), bool, optional
        Duplicate frames, which have the strength of the previous frame but never count as spikes.
    frame : int ndarray, shape (n,), optional
        Frame numbers in the video; 0 to n - 1 unless given.
    near_s : ndarray, shape (m,), optional
        Times of the frames that justify an alarm, increasing.
    ttc_s : ndarray, shape (n,), optional
        Estimated time to contact, in seconds; NaN where undefined.
    blind : ndarray, shape (n,), bool, optional
        Where the model is blind, see `Detection.blind`.
    """

    time_s: Series
    strength: Series
    contacts: tuple[Contact, ...]
    frame_s: float
    repeated: Flags | None = None
    frame: npt.NDArray[np.int64] | None = None
    near_s: Series | None = None
    ttc_s: Series | None = None
    blind: Flags | None = None

    def is_told(self, contact: Contact) -> bool:
        """Whether the model was blind in the last 1.5 s before a contact."""
        if self.blind is None:
            return False
        left_s = contact.time_s - self.time_s
        return bool(self.blind[(left_s >= -ROUNDING_S) & (left_s <= TOLD_S + ROUNDING_S)].any())

    def sustained(self, n_sp: int) -> Series:
        """The least strength of the last `n_sp` frames, shape (n,); -inf for fewer frames.

        Duplicate frames do not count.
        """
        filled = np.where(np.isnan(self.strength), -np.inf, self.strength)
        seen = np.ones(len(filled), np.bool_) if self.repeated is None else ~self.repeated
        seen[:1] = True
        padded = np.concatenate((np.full(n_sp - 1, -np.inf), filled[seen]))
        least = np.lib.stride_tricks.sliding_window_view(padded, n_sp).min(axis=-1)
        return np.asarray(least[np.cumsum(seen) - 1])

    @property
    def steps_s(self) -> Series:
        """Duration of each frame in seconds, shape (n,)."""
        return np.append(np.diff(self.time_s), self.frame_s)

    @property
    def is_free(self) -> Flags:
        """Frames at which an onset may be false, as no contact is near, shape (n,), bool."""
        free = np.ones(len(self.time_s), np.bool_)
        for contact in self.contacts:
            is_after = self.time_s >= contact.from_s - ROUNDING_S
            free &= ~(is_after & (self.time_s <= contact.time_s + AFTER_S + ROUNDING_S))
        return free

    @property
    def is_near(self) -> Flags:
        """Frames at which truth justifies an alarm, shape (n,), bool."""
        if self.near_s is None:
            return np.zeros(len(self.time_s), np.bool_)
        reach = NEAR_S + ROUNDING_S
        first = np.searchsorted(self.near_s, self.time_s - reach)
        last = np.searchsorted(self.near_s, self.time_s + reach, side="right")
        return np.asarray(last - first >= N_NEAR)


class Alarms(NamedTuple):
    """The alarms of one video at T thresholds, by threshold and time; arrays of shape (alarms,).

    `level` is the number of the threshold, `row` the row of the onset; `start_s` and `end_s` are
    the times of the onset and of the last frame at which the alarm is on. `n_false` is the number
    of false alarms that the alarm counts as; `justified`: only the truth makes this number 0.
    """

    level: npt.NDArray[np.intp]
    row: npt.NDArray[np.intp]
    start_s: Series
    end_s: Series
    n_false: npt.NDArray[np.intp]
    justified: Flags

    def of(self, contact: Contact) -> npt.NDArray[np.int8]:
        """The outcome of a contact by each alarm alone: the number of one of `OUTCOMES`."""
        start_s, from_s, until_s = self.start_s, contact.from_s, contact.until_s
        found = np.full(len(start_s), MISSED, np.int8)
        if contact.has_speed:
            is_before = (start_s < from_s) & (self.end_s >= from_s - BEFORE_S - ROUNDING_S)
            found[is_before] = TOO_EARLY
        is_after = start_s >= from_s - ROUNDING_S
        found[is_after & (start_s <= contact.time_s + ROUNDING_S)] = TOO_LATE
        hit = IN_TIME if contact.has_speed else ANNOUNCED
        found[is_after & (start_s <= until_s + ROUNDING_S)] = hit
        return found


def alarms(signal: Signal, n_sp: int, thresholds: npt.ArrayLike) -> Alarms:
    """The alarms of a video at one threshold, or at each of T; pauses as in `detection.spans`."""
    at = np.atleast_1d(np.asarray(thresholds, np.float64))
    strength, time_s, n = signal.sustained(n_sp), signal.time_s, len(signal.time_s)
    found: list[tuple[npt.NDArray[np.intp], ...]] = []
    for first in range(0, len(at), step := max(1, _AT_ONCE // n)):
        on = strength >= at[first : first + step, None]
        last = np.maximum.accumulate(np.where(on, np.arange(n), -1), axis=1)
        # For each row, the last earlier row at which the alarm was on; -1 for none.
        before = np.hstack((np.full((len(on), 1), -1), last[:, :-1]))
        pause_s = np.where(before < 0, np.inf, time_s - time_s[before])
        begins = on & (before < np.arange(n) - 1) & (pause_s >= MERGE_S - ROUNDING_S)
        begins[:, 0] = on[:, 0]
        level, row = np.nonzero(begins)
        # An alarm ends at the last row that is on before the next alarm at the threshold begins.
        until = np.append(np.where(np.diff(level) == 0, row[1:] - 1, n - 1), n - 1)[: len(row)]
        found.append((level + first, row, last[level, until]))
    level, row, end = (np.concatenate(parts) for parts in zip(*found, strict=True))
    start_s, end_s = time_s[row], time_s[end]
    more = ((end_s - start_s + ROUNDING_S) // STANDS_S).astype(np.intp)
    free, near = signal.is_free[row], signal.is_near[row]
    n_false = np.where(free & ~near, 1 + more, 0)
    return Alarms(level, row, start_s, end_s, n_false, free & near)


@dataclass(frozen=True)
class Tally:
    """The alarms of one video, counted at each of T thresholds.

    Attributes
    ----------
    outcome : int ndarray, shape (contacts, T)
        The outcome of each contact: the number of one of `OUTCOMES`.
    onset : int ndarray, shape (contacts, T)
        The number of the alarm that decides the outcome, see `alarms`; -1 if missed.
    lead_s : ndarray, shape (contacts, T)
        Time from the onset of this alarm to the contact, in seconds; NaN if missed.
    in_time : bool ndarray, shape (contacts, brakes, T)
        Whether the contact is in time for each of `BRAKES`; False without a speed.
    told : ndarray, shape (contacts,), bool
        Whether the model was blind just before a contact, see `Signal.is_told`.
    n_false, n_justified : int ndarray, shape (T,)
        Number of false alarms, and of alarms that only the truth justifies.
    alarm_s : ndarray, shape (T,)
        Time in alarm, in seconds.
    seconds : float
        Duration of the video.
    minutes : float
        Time in which an onset may be a false alarm, in minutes.
    """

    outcome: npt.NDArray[np.int8]
    onset: npt.NDArray[np.intp]
    lead_s: Series
    in_time: Flags
    told: Flags
    n_false: npt.NDArray[np.intp]
    n_justified: npt.NDArray[np.intp]
    alarm_s: Series
    seconds: float
    minutes: float

    @property
    def is_hit(self) -> Flags:
        """Which contacts are in time or announced, shape (contacts, T), bool."""
        return self.outcome >= ANNOUNCED

    def only(self, contacts: Flags) -> "Tally":
        """The tally of some of the contacts, but with all false alarms."""
        names = ("outcome", "onset", "lead_s", "in_time", "told")
        return replace(self, **{name: getattr(self, name)[contacts] for name in names})


def tally(signal: Signal, n_sp: int, thresholds: npt.ArrayLike) -> Tally:
    """Judge the alarms of a video at one threshold or at T."""
    n = np.size(thresholds)
    every = alarms(signal, n_sp, thresholds)
    outcome = np.full((len(signal.contacts), n), MISSED, np.int8)
    onset, lead_s = np.full(outcome.shape, -1), np.full(outcome.shape, np.nan)
    in_time = np.zeros((len(outcome), len(BRAKES), n), np.bool_)
    for number, contact in enumerate(signal.contacts):
        found = every.of(contact)
        chosen = np.flatnonzero(found != MISSED)
        # The last value written stays: the best outcome, and among equal outcomes the first onset.
        chosen = chosen[np.lexsort((-every.start_s[chosen], found[chosen]))]
        level = every.level[chosen]
        outcome[number, level], onset[number, level] = found[chosen], chosen
        lead_s[number, level] = contact.time_s - every.start_s[chosen]
        for brake, stop_s in enumerate(contact.stops_s):
            is_hit = every.of(contact_of(contact.time_s, stop_s=stop_s)) == IN_TIME
            in_time[number, brake, every.level[is_hit]] = True

    def summed(weights: npt.NDArray) -> npt.NDArray:
        return np.bincount(every.level, weights, minlength=n)

    steps_s = signal.steps_s
    lasts_s = np.minimum(every.end_s - every.start_s + signal.frame_s, steps_s.sum())
    return Tally(
        outcome,
        onset,
        lead_s,
        in_time,
        np.array([signal.is_told(contact) for contact in signal.contacts], np.bool_),
        n_false=summed(every.n_false).astype(np.intp),
        n_justified=summed(every.justified).astype(np.intp),
        alarm_s=summed(lasts_s),
        seconds=float(steps_s.sum()),
        minutes=float(steps_s[signal.is_free].sum()) / 60.0,
    )


def score(tallies: Sequence[Tally]) -> Scores:
    """The measures over at least one video, tallied at one threshold.

    Returns
    -------
    dict of str to float
        `videos`; `contacts`, the `hits` (in time or announced) and each of `OUTCOMES` among them;
        `told` among the missed; `in_time_arducopter` and so on, the contacts in time for each of
        `BRAKES`;
        `false_alarms` and `justified`; `minutes` in which an onset may be false.

        `recall`: hits / contacts. `in_time_share` and so on: each outcome / contacts.
        `false_alarms_per_min`. `in_alarm`: share of the time. Each of these measures has bounds,
        such as `recall_low` and `recall_high`, see `interval`. `lead_s`: median lead of the hits.
        NaN where undefined.
    """
    contacts = [len(t.outcome) for t in tallies]
    minutes = [t.minutes for t in tallies]
    of = {k: [int((t.outcome == i).sum()) for t in tallies] for i, k in enumerate(OUTCOMES)}
    of |= {k: [int(t.in_time[:, i].sum()) for t in tallies] for i, k in enumerate(IN_TIME_BY)}
    of["hits"] = [int(t.is_hit.sum()) for t in tallies]
    of["told"] = [int((t.told & (t.outcome[:, 0] == MISSED)).sum()) for t in tallies]
    of["false_alarms"] = [int(t.n_false[0]) for t in tallies]
    of["justified"] = [int(t.n_justified[0]) for t in tallies]
    totals: Scores = {name: sum(own) for name, own in of.items()}
    totals |= {"videos": len(tallies), "contacts": sum(contacts), "minutes": sum(minutes)}
    scores = {name: totals[name] for name in COUNTS}
    for name, own in (("recall", "hits"), *((f"{k}_share", k) for k in OUTCOMES)):
        scores |= _measured(name, of[own], contacts, "share")
    scores |= _measured("false_alarms_per_min", of["false_alarms"], minutes, "rate")
    in_alarm = [t.alarm_s[0] for t in tallies], [t.seconds for t in tallies]
    scores |= _measured("in_alarm", *in_alarm, "time")
    leads = np.concatenate([t.lead_s[t.is_hit] for t in tallies])
    return {**scores, "lead_s": float(np.median(leads)) if leads.size else math.nan}


def _measured(
    name: str, counts: Sequence[float], of: Sequence[float], what: str
) -> dict[str, float]:
    """Name -> value of a measure and its two bounds."""
    low, high = interval(counts, of, what)
    value = sum(counts) / sum(of) if sum(of) else math.nan
    return {name: value, f"{name}_low": float(low), f"{name}_high": float(high)}


class Difference(NamedTuple):
    """A difference of two models, the bounds of its interval, and the corrected p-value."""

    value: float
    low: float
    high: float
    p: float


# Measure -> difference.
Differences = dict[str, Difference]


def score_differences(
    of_models: Mapping[str, Sequence[Tally]], theirs: Sequence[Tally]
) -> dict[str, Differences]:
    """Recall and false alarms per minute of models minus those of another, on the same videos.

    Videos are resampled in pairs, see `interval`, and tested in pairs, see `p_value`. The p-values
    are corrected by `holm` for their number: two for each model in `of_models`.
    """
    of: dict[str, Sequence[float]] = {
        "recall": [len(t.outcome) for t in theirs],
        "false_alarms_per_min": [t.minutes for t in theirs],
    }
    found: dict[tuple[str, str], tuple[float, ...]] = {}
    for label, ours in of_models.items():
        pairs = list(zip(ours, theirs, strict=True))
        counts = {
            "recall": [int(a.is_hit.sum()) - int(b.is_hit.sum()) for a, b in pairs],
            "false_alarms_per_min": [int(a.n_false[0] - b.n_false[0]) for a, b in pairs],
        }
        for name, differences in counts.items():
            bounds = _measured(name, differences, of[name], "difference").values()
            found[label, name] = *bounds, p_value(differences)
    corrected = holm([p for *_, p in found.values()])
    by_model: dict[str, Differences] = {label: {} for label in of_models}
    for ((label, name), (value, low, high, _)), p in zip(found.items(), corrected, strict=True):
        if name == "recall":  # with further events, the bounds may exceed those of a share
            low, high = max(low, -1.0), min(high, 1.0)
        by_model[label][name] = Difference(value, low, high, p)
    return by_model


def scores_json(scores: Scores) -> dict[str, Json]:
    """The measures, their intervals and the counts of `score`, as JSON values."""
    bounds = {k: [finite(scores[f"{k}_low"]), finite(scores[f"{k}_high"])] for k in MEASURES}
    return {
        **{name: finite(scores[name]) for name in (*MEASURES, "lead_s")},
        "intervals": bounds,
        **{name: scores[name] for name in COUNTS},
    }
