"""Classify alarms at any threshold; recall, false alarms and lead times over many videos.

An alarm counts at its onset, the n_sp-th spike. Its kind depends on the time of the onset:

- within the horizon before a collision: a *hit*. The collision is detected, and the lead time is
  the time to it. Of several hits, the first counts;
- from the collision to 3 frames after it: a *late detection* (`contact`), neither a hit nor false;
- after that, up to the horizon before the video's next collision: *ignored*;
- at any other time: *false*. Within 2 s before the first collision, it is also *early*. In a
  rendered flight, it is `justified` instead, and neither a hit nor false, if it asks for a stop
  for a real obstacle: a collision within 1.5 s on the current course.

The minutes end at the first collision, or with the video: after a collision no alarm is false.
"""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.detection import MERGE_S, ROUNDING_S
from dlgmd_cli.parameters.checks import Spec, in_argument
from dlgmd_cli.parameters.facts import Json
from dlgmd_cli.results import intervals

HORIZON_S, EARLY_S, CONTACT_FRAMES = 1.0, 2.0, 3

FALSE, EARLY, HIT, AT_CONTACT, IGNORED, JUSTIFIED = range(6)
KINDS = ("false", "early", "hit", "contact", "ignored", "justified")
# Bootstrap resamples of the videos.
N_RESAMPLES = 1000
COUNTS = ("videos", "collisions", "hits", "at_contact", "false_alarms", "early", "minutes")
MEASURES = ("recall", "false_alarms_per_min", "precision", "lead_s", "lead_p10_s", "auc")

# The performance of a model on some videos at one threshold, see `score`.
Scores = dict[str, float]

_HORIZON = Spec(float, 0, 3600, low_open=True)
_FALSE_PER_MIN = Spec(float, 0, math.inf)


@dataclass(frozen=True)
class Rules:
    """What counts as a hit, and how many false alarms the best threshold may have.

    Attributes
    ----------
    horizon_s : float
        An alarm up to so many seconds before a collision is a hit.
    max_false_per_min : float
        Allowed rate of false alarms.
    max_false_kind : str or None
        Kind of the videos on which it is allowed; None for all.
    """

    horizon_s: float = HORIZON_S
    max_false_per_min: float = 1.0
    max_false_kind: str | None = None


def rules_of(horizon: float, max_false_per_min: float | str) -> Rules:
    """The checked rules, of arguments of `evaluate`; raises ParameterError."""
    with in_argument("horizon"):
        horizon_s = _HORIZON.check(horizon)
    rate, _, kind = str(max_false_per_min).partition(":")
    with in_argument("max_false_per_min"):
        return Rules(horizon_s, _FALSE_PER_MIN.parse(rate), kind.strip() or None)


@dataclass(frozen=True)
class Signal:
    """The signal of one video that is compared with a threshold, and the times of its collisions.

    Attributes
    ----------
    time_s : ndarray, shape (n,)
        Times of the frames, in seconds, increasing; n is at least 1.
    strength : ndarray, shape (n,)
        There is a spike where it reaches the threshold; NaN (no spike) where undefined.
    contacts_s : tuple of float
        Times of the collisions, in seconds, increasing.
    frame_s : float
        Duration of a frame of the video, in seconds.
    repeated : ndarray, shape (n,), bool, optional
        Duplicate frames. They have the strength of the one before, but are not counted as spikes.
    frame : int ndarray, shape (n,), optional
        Frame numbers in the video; 0 to n - 1 unless given.
    justified : ndarray, shape (n,), bool, optional
        Frames of a rendered flight at which a stop is for a real obstacle, whatever happens then.
    ttc_s : ndarray, shape (n,), optional
        Estimated time to contact, in seconds; NaN where there is none.
    """

    time_s: Series
    strength: Series
    contacts_s: tuple[float, ...]
    frame_s: float
    repeated: Flags | None = None
    frame: npt.NDArray[np.int64] | None = None
    justified: Flags | None = None
    ttc_s: Series | None = None

    def sustained(self, n_sp: int) -> Series:
        """The least strength of the last n_sp frames, shape (n,); -inf if there are fewer.

        Duplicate frames do not count.
        """
        filled = np.where(np.isnan(self.strength), -np.inf, self.strength)
        seen = np.ones(len(filled), np.bool_) if self.repeated is None else ~self.repeated
        seen[:1] = True
        padded = np.concatenate((np.full(n_sp - 1, -np.inf), filled[seen]))
        least = np.lib.stride_tricks.sliding_window_view(padded, n_sp).min(axis=-1)
        return np.asarray(least[np.cumsum(seen) - 1])

    @property
    def minutes(self) -> float:
        """Time before the first collision, horizon included, or the whole video."""
        end_s = min([float(self.time_s[-1]) + self.frame_s, *self.contacts_s[:1]])
        return max(end_s - float(self.time_s[0]), 0.0) / 60.0


@dataclass(frozen=True)
class Tally:
    """The alarms of one video, counted at each of T thresholds.

    Attributes
    ----------
    lead_s : ndarray, shape (collisions, T)
        Time from the first hit to the collision, in seconds; NaN if it is not detected.
    at_contact : ndarray, shape (collisions, T), bool
        Whether the detection is late: no hit, but an alarm begins at contact.
    n_false, n_early : int ndarray, shape (T,)
        Number of false alarms, and how many of them are early.
    n_justified : int ndarray, shape (T,)
        Number of alarms for a real obstacle only.
    stop_s : ndarray, shape (T,)
        When an alarm is first on within the horizon, or for a real obstacle; NaN if never. Not only
        where it begins: a pilot who did not heed it then may now.
    minutes : float
        Time in which an alarm counts as false.
    inside, outside : ndarray, shape (collisions,) and (m,)
        Scores of the windows, see `windows`.
    """

    lead_s: Series
    at_contact: Flags
    n_false: npt.NDArray[np.intp]
    n_early: npt.NDArray[np.intp]
    n_justified: npt.NDArray[np.intp]
    stop_s: Series
    minutes: float
    inside: Series
    outside: Series

    def only(self, collisions: Flags) -> "Tally":
        """The same for some of the collisions, but with all false alarms."""
        names = ("lead_s", "at_contact", "inside")
        return replace(self, **{name: getattr(self, name)[collisions] for name in names})


def onset_thresholds(signal: Signal, n_sp: int) -> tuple[Series, Series]:
    """The range of thresholds at which an alarm begins at each row: above `low`, up to `high`.

    The alarm is on while the sustained strength reaches the threshold. It begins at a row unless it
    was on at the row before, or within the `MERGE_S` before; the greatest sustained strength of
    that time is `low`.

    Returns
    -------
    low, high : ndarray, shape (n,)
        The range is empty if `low` is not less than `high`.
    """
    time_s, high = signal.time_s, signal.sustained(n_sp)
    low = np.concatenate(([-np.inf], high[:-1]))
    # For each row, the first earlier one that is too close for a separate alarm.
    first = np.searchsorted(time_s, time_s - (MERGE_S - ROUNDING_S), side="right")
    rows = np.arange(len(high))
    for back in range(2, int((rows - first).max(initial=0)) + 1):
        near = rows[back:][rows[back:] - back >= first[back:]]
        low[near] = np.maximum(low[near], high[near - back])
    return low, high


def kinds(signal: Signal, horizon_s: float) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.intp]]:
    """The kind of an alarm that began at each row, and the collision it belongs to.

    Returns
    -------
    kind : int ndarray, shape (n,)
        `FALSE`, `EARLY`, `HIT`, `AT_CONTACT`, `IGNORED` or `JUSTIFIED`.
    collision : int ndarray, shape (n,)
        Number of the collision for hits and late detections; otherwise -1.
    """
    time_s = signal.time_s
    kind = np.full(len(time_s), FALSE, np.int8)
    collision = np.full(len(time_s), -1)
    over_s = -np.inf  # end of the previous collision's contact
    for number, contact_s in enumerate(signal.contacts_s):
        grace_s = contact_s + CONTACT_FRAMES * signal.frame_s + ROUNDING_S
        before = (time_s < contact_s - ROUNDING_S) & (time_s > over_s)
        if number == 0:
            kind[before & (time_s >= contact_s - EARLY_S - ROUNDING_S)] = EARLY
        is_hit = before & (time_s >= contact_s - horizon_s - ROUNDING_S)
        is_at_contact = (time_s >= contact_s - ROUNDING_S) & (time_s <= grace_s)
        kind[time_s > grace_s] = IGNORED
        kind[is_hit], kind[is_at_contact] = HIT, AT_CONTACT
        collision[is_hit | is_at_contact] = number
        over_s = grace_s
    if signal.justified is not None:
        kind[signal.justified & ((kind == FALSE) | (kind == EARLY))] = JUSTIFIED
    return kind, collision


def tally(
    signal: Signal, n_sp: int, thresholds: npt.ArrayLike, horizon_s: float = HORIZON_S
) -> Tally:
    """Count the alarms of a video by kind, at one threshold or at T."""
    at = np.atleast_1d(np.asarray(thresholds, np.float64))
    low, high = onset_thresholds(signal, n_sp)
    kind, collision = kinds(signal, horizon_s)
    may_begin = low < high

    def count(wanted: Flags) -> npt.NDArray[np.intp]:
        """Number of alarms that begin at the wanted rows, shape (T,)."""
        lows, highs = np.sort(low[wanted]), np.sort(high[wanted])
        return np.searchsorted(lows, at, side="left") - np.searchsorted(highs, at, side="left")

    lead_s = np.full((len(signal.contacts_s), len(at)), np.nan)
    at_contact = np.zeros(lead_s.shape, np.bool_)
    for number, contact_s in enumerate(signal.contacts_s):
        is_own = may_begin & (collision == number)
        rows = np.flatnonzero(is_own & (kind == HIT))
        for row in rows[::-1]:  # the first hit overwrites later ones
            lead_s[number, (low[row] < at) & (at <= high[row])] = contact_s - signal.time_s[row]
        at_contact[number] = (count(is_own & (kind == AT_CONTACT)) > 0) & np.isnan(lead_s[number])
    n_early = count(may_begin & (kind == EARLY))
    n_false = count(may_begin & (kind == FALSE)) + n_early
    n_justified = count(may_begin & (kind == JUSTIFIED))
    needed = np.flatnonzero((kind == HIT) | (kind == JUSTIFIED))
    first = np.searchsorted(np.maximum.accumulate(high[needed]), at)
    stop_s = np.append(signal.time_s[needed], np.nan)[first]
    inside, outside = peaks(windows(signal, n_sp, horizon_s))
    counts = n_false, n_early, n_justified
    return Tally(lead_s, at_contact, *counts, stop_s, signal.minutes, inside, outside)


def alarms(
    signal: Signal, n_sp: int, threshold: float, horizon_s: float = HORIZON_S
) -> list[tuple[int, int]]:
    """Row and kind of every alarm at one threshold, in order."""
    low, high = onset_thresholds(signal, n_sp)
    kind, _ = kinds(signal, horizon_s)
    return [
        (int(row), int(kind[row]))
        for row in np.flatnonzero((low < threshold) & (threshold <= high))
    ]


class Window(NamedTuple):
    """A part of a video as long as the horizon: before a collision, or elsewhere.

    `collision` is the collision's number, or None elsewhere. `score` is the peak of the sustained
    strength; -inf if the video starts too late for the model to respond.
    """

    start_s: float
    end_s: float
    collision: int | None
    score: float


def windows(signal: Signal, n_sp: int, horizon_s: float = HORIZON_S) -> list[Window]:
    """The horizon of each collision, and the windows elsewhere.

    Windows elsewhere are as long as the horizon, and are laid backwards from the first horizon, or
    from the end of a video without a collision. A remainder of at least half a window counts, too.
    """
    strongest = signal.sustained(n_sp)
    kind, collision = kinds(signal, horizon_s)
    found = []
    for number, contact_s in enumerate(signal.contacts_s):
        peak = np.max(strongest[(kind == HIT) & (collision == number)], initial=-np.inf)
        found.append(Window(contact_s - horizon_s, contact_s, number, float(peak)))
    start_s = float(signal.time_s[0])
    end_s = start_s + 60.0 * signal.minutes - (horizon_s if signal.contacts_s else 0.0)
    while end_s - start_s >= horizon_s / 2:
        is_in = (signal.time_s >= end_s - horizon_s) & (signal.time_s < end_s - ROUNDING_S)
        if is_in.any():
            peak = strongest[is_in].max()
            found.append(Window(max(start_s, end_s - horizon_s), end_s, None, float(peak)))
        end_s -= horizon_s
    return found


def peaks(every: Sequence[Window]) -> tuple[Series, Series]:
    """The scores of the windows before collisions, and of those elsewhere."""
    inside = [window.score for window in every if window.collision is not None]
    return np.array(inside), np.array([w.score for w in every if w.collision is None])


def score(tallies: Sequence[Tally]) -> Scores:
    """The measures over at least one video, tallied at one threshold.

    Returns
    -------
    dict of str to float
        `videos`, `collisions`, `hits` (detected collisions), `at_contact`, `false_alarms`, `early`
        (included in the false ones) and `minutes` (time in which an alarm counts as false).

        `recall`: hits / collisions. `false_alarms_per_min`. `precision`: hits / (hits + false
        alarms). `lead_s`, `lead_p10_s`: median and 10th percentile of the lead times. `auc`: the
        probability that the score of a window before a collision exceeds one elsewhere, see
        `windows`. Each is followed by its bounds, `recall_low` and `recall_high`, from
        `N_RESAMPLES` resamples of the videos. NaN where undefined.

    Notes
    -----
    The bounds of the false alarms are the wider ones of those resamples and of the exact Poisson
    interval, `poisson_interval`. False alarms come in bunches: most are in a few videos, which only
    resampling of videos shows. But it gives 0 to 0 where no video has any, and is too narrow for
    few videos; the Poisson interval is right there, since a rare alarm is one of a kind. So are
    the bounds of recall and precision, with `binomial_interval`.
    """
    n = len(tallies)
    leads = [t.lead_s[~np.isnan(t.lead_s)] for t in tallies]
    sums, weights = _sums(tallies), resampled(n)
    n_collisions, n_hits, n_false, minutes = sums.sum(axis=0).tolist()
    n_contact = sum(int(t.at_contact.sum()) for t in tallies)
    n_early = sum(int(t.n_early[0]) for t in tallies)
    counts = n, int(n_collisions), int(n_hits), n_contact, int(n_false), n_early, minutes
    scores: Scores = dict(zip(COUNTS, counts, strict=True))
    totals = {"recall": n_collisions, "precision": n_hits + n_false}
    exact = {k: intervals.binomial_interval(int(n_hits), int(n)) for k, n in totals.items() if n}
    if minutes > 0.0:
        low, high = intervals.poisson_interval(int(n_false))
        exact["false_alarms_per_min"] = low / minutes, high / minutes
    values = _measured(weights, sums, leads, [(t.inside, t.outside) for t in tallies])
    for name, drawn in values.items():
        measure = float(drawn[0]), *_interval(drawn)
        bounds = exact.get(name, (np.nan, np.nan))
        scores[name], scores[f"{name}_low"], scores[f"{name}_high"] = _widened(measure, *bounds)
    return scores


def defined(value: float) -> float | None:
    """The value, or None if it is not finite: JSON has no number for it."""
    return value if math.isfinite(value) else None


def scores_json(scores: Scores, more: Iterable[str] = ()) -> dict[str, Json]:
    """The measures, their intervals, the counts and `more` of `score`, as JSON values."""
    bounds = {k: [defined(scores[f"{k}_low"]), defined(scores[f"{k}_high"])] for k in MEASURES}
    return {
        **{name: defined(scores[name]) for name in MEASURES},
        "intervals": bounds,
        **{name: scores[name] for name in COUNTS},
        **{name: defined(scores[name]) for name in more},
    }


def _sums(tallies: Sequence[Tally]) -> Series:
    """Collisions, hits, false alarms and minutes of each video, (n, 4)."""
    every = ((t, (~np.isnan(t.lead_s)).sum()) for t in tallies)
    return np.array([(len(t.lead_s), hits, t.n_false[0], t.minutes) for t, hits in every])


def resampled(n: int) -> npt.NDArray[np.int64]:
    """How often each of n videos counts: once, and in each resample, (1 + N_RESAMPLES, n)."""
    draws = np.random.default_rng(0).multinomial(n, np.full(n, 1.0 / n), N_RESAMPLES)
    return np.concatenate((np.ones((1, n), np.int64), draws))


def differences(
    ours: Sequence[Tally], theirs: Sequence[Tally]
) -> dict[str, tuple[float, float, float]]:
    """How much recall and false alarms a minute differ on the same videos, each with its interval.

    The interval is that of resamples of the videos, in which both have the same ones, but at least
    as wide as that of the collisions which one of them detects, see `paired_interval`, and of the
    false alarms which it has more of in a video.
    """
    weights = resampled(len(ours))

    def measured(tallies: Sequence[Tally]) -> tuple[Series, Series]:
        n_collisions, n_hits, n_false, minutes = (weights @ _sums(tallies)).T
        return ratio(n_hits, n_collisions), ratio(n_false, minutes)

    both = zip(("recall", "false_alarms_per_min"), measured(ours), measured(theirs), strict=True)
    changes = {name: value - other for name, value, other in both}
    changed = {name: (float(change[0]), *_interval(change)) for name, change in changes.items()}
    hits, others = (~np.isnan(np.concatenate([t.lead_s[:, 0] for t in s])) for s in (ours, theirs))
    if hits.size:
        pairs = int((hits & ~others).sum()), int((others & ~hits).sum()), hits.size
        changed["recall"] = _widened(changed["recall"], *intervals.paired_interval(*pairs))
    if minutes := sum(t.minutes for t in ours):
        more = np.array([a.n_false[0] - b.n_false[0] for a, b in zip(ours, theirs, strict=True)])
        n_more, n_fewer = int(more[more > 0].sum()), int(-more[more < 0].sum())
        bounds = intervals.poisson_interval(n_more), intervals.poisson_interval(n_fewer)
        low, high = intervals.difference_interval((n_more, n_fewer), bounds)
        name = "false_alarms_per_min"
        changed[name] = _widened(changed[name], low / minutes, high / minutes)
    return changed


def _widened(
    measure: tuple[float, float, float], low: float, high: float
) -> tuple[float, float, float]:
    """A value and its interval, which is at least as wide as another one."""
    value, least, most = measure
    return value, float(np.fmin(least, low)), float(np.fmax(most, high))


def _measured(
    weights: npt.NDArray[np.int64],
    sums: Series,
    leads: Sequence[Series],
    sides: Sequence[tuple[Series, Series]],
) -> dict[str, Series]:
    """Every measure for each row of `weights`, which says how often each video counts."""
    n_collisions, n_hits, n_false, minutes = (weights @ sums).T
    lead_s = np.concatenate(leads)
    order = np.argsort(lead_s)
    video = np.repeat(np.arange(len(leads)), [len(lead) for lead in leads])[order]
    n_inside, n_outside = (weights @ np.array([len(s[k]) for s in sides]) for k in (0, 1))
    return {
        "recall": ratio(n_hits, n_collisions),
        "false_alarms_per_min": ratio(n_false, minutes),
        "precision": ratio(n_hits, n_hits + n_false),
        "lead_s": _percentile(lead_s[order], weights[:, video], 0.5),
        "lead_p10_s": _percentile(lead_s[order], weights[:, video], 0.1),
        "auc": ratio(((weights @ _wins(sides)) * weights).sum(axis=1), n_inside * n_outside),
    }


def _wins(sides: Sequence[tuple[Series, Series]]) -> Series:
    """Pairs in which a peak inside video i exceeds one outside of video j; a tie counts half."""
    wins = np.zeros((len(sides), len(sides)))
    every = np.concatenate([inside for inside, _ in sides])
    owner = np.repeat(np.arange(len(sides)), [len(inside) for inside, _ in sides])
    for j, (_, outside) in enumerate(sides):
        ordered = np.sort(outside)
        beaten = np.searchsorted(ordered, every, "left") + np.searchsorted(ordered, every, "right")
        wins[:, j] = np.bincount(owner, beaten / 2, minlength=len(sides))
    return wins


def _percentile(ordered: Series, weights: npt.NDArray[np.int64], share: float) -> Series:
    """A percentile of increasing values, as NumPy's, for each row of `weights`, their counts."""
    if not ordered.size:
        return np.full(len(weights), np.nan)
    until = np.cumsum(weights, axis=1)
    total = until[:, -1]
    place = share * (total - 1)
    low = np.floor(place)

    def value(rank: Series) -> Series:
        return ordered[np.minimum((until <= rank[:, None]).sum(axis=1), len(ordered) - 1)]

    values = value(low) + (place - low) * (value(np.minimum(low + 1, total - 1)) - value(low))
    return np.where(total > 0, values, np.nan)


def ratio(above: npt.NDArray, below: npt.ArrayLike) -> Series:
    """A ratio, NaN where its denominator is 0."""
    below = np.broadcast_to(np.asarray(below, np.float64), np.shape(above))
    return np.divide(above, below, out=np.full(np.shape(above), np.nan), where=below > 0)


def _interval(drawn: Series) -> tuple[float, float]:
    """The interval of all values but the first that are not NaN; NaN if the first one is."""
    others = drawn[1:][~np.isnan(drawn[1:])]
    if np.isnan(drawn[0]) or not others.size:
        return np.nan, np.nan
    tail = (1.0 - intervals.CONFIDENCE) / 2
    low, high = np.quantile(others, [tail, 1.0 - tail])
    return float(low), float(high)
