"""Measures over many videos: recall, false alarms, leads, AUC and their confidence intervals."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.lab.evaluation.scoring import (
    HORIZON_S,
    IGNORED,
    Signal,
    Tally,
    kinds,
    onset_thresholds,
)
from dlgmd_cli.models.detection import Series

# Bootstrap resamples of the videos, and the confidence level of the intervals.
N_RESAMPLES, CONFIDENCE = 1000, 0.95
# Maximum number of thresholds of a curve. Half of them are the highest ones, without gaps: there
# alarms are few, and each counts.
MAX_THRESHOLDS = 4000
COUNTS = ("videos", "collisions", "hits", "at_contact", "false_alarms", "early", "minutes")
MEASURES = ("recall", "false_alarms_per_min", "precision", "lead_s", "lead_p10_s", "auc")

# The performance of a model on some videos at one threshold, see `score`.
Scores = dict[str, float]


@dataclass(frozen=True)
class Curve:
    """Performance at T increasing thresholds; arrays of shape (T,). `lead_s` is a median or NaN."""

    threshold: Series
    recall: Series
    false_alarms_per_min: Series
    lead_s: Series

    def rank(self, i: int) -> tuple[float, float, float]:
        """Sort key of threshold number i: high recall, then few false alarms, then a long lead."""
        lead_s = 0.0 if np.isnan(self.lead_s[i]) else float(self.lead_s[i])
        return float(self.recall[i]), -float(self.false_alarms_per_min[i]), lead_s

    def best(self, max_false_per_min: float) -> int:
        """Index of the best threshold with at most `max_false_per_min` false alarms per minute.

        Of equally good ones, the middle one. The highest threshold raises no alarm, so there is
        always a solution.
        """
        allowed = np.flatnonzero(~(self.false_alarms_per_min > max_false_per_min))
        ranks = [self.rank(int(i)) for i in allowed]
        top = max(ranks)
        equal = [i for i, rank in zip(allowed, ranks, strict=True) if rank == top]
        return int(equal[len(equal) // 2])


def thresholds(signals: Sequence[Signal], n_sp: int, horizon_s: float = HORIZON_S) -> Series:
    """All thresholds at which the alarms of the signals differ, increasing, shape (T,).

    They lie midway between the values at which an alarm appears or disappears. Above
    `MAX_THRESHOLDS`, the lower half is thinned out. The highest threshold raises no alarm.
    """
    found = []
    for signal in signals:
        low, high = onset_thresholds(signal, n_sp)
        counts = (low < high) & (kinds(signal, horizon_s)[0] != IGNORED)
        found += [low[counts], high[counts]]
    edges = np.unique(np.concatenate(found)) if found else np.empty(0)
    edges = edges[np.isfinite(edges)]
    if len(edges) > MAX_THRESHOLDS:
        half = MAX_THRESHOLDS // 2
        chosen = np.linspace(0, len(edges) - half - 1, half).round().astype(int)
        edges = np.concatenate((edges[chosen], edges[-half:]))
    if not edges.size:
        return np.array([np.inf])
    top = np.nextafter(edges[-1], np.inf)
    # The midpoint of two adjacent floats is one of the two, and either will do.
    return np.unique(np.concatenate((edges[:1], (edges[1:] + edges[:-1]) / 2, [top])))


def curve(tallies: Sequence[Tally], at: Series) -> Curve:
    """The curve of videos that were tallied at the same thresholds."""
    leads_s = np.concatenate([one.lead_s for one in tallies])
    n_false = np.sum([one.n_false for one in tallies], axis=0)
    recall = (~np.isnan(leads_s)).mean(axis=0) if len(leads_s) else np.full(len(at), np.nan)
    minutes = sum(one.minutes for one in tallies)
    return Curve(at, np.nan_to_num(recall), _ratio(n_false, minutes), _medians(leads_s))


def _medians(columns: Series) -> Series:
    """The median of every column of an (n, T) array, ignoring NaN; NaN if a column has only NaN."""
    n = (~np.isnan(columns)).sum(axis=0)
    if not len(columns):
        return np.full(len(n), np.nan)
    ordered = np.sort(columns, axis=0)  # NaN comes last
    middle = np.stack([np.maximum(n - 1, 0) // 2, np.minimum(n // 2, len(columns) - 1)])
    return np.asarray(np.take_along_axis(ordered, middle, axis=0).mean(axis=0))


def score(tallies: Sequence[Tally], seed: int = 0) -> Scores:
    """The measures over at least one video, tallied at one threshold.

    Returns
    -------
    dict of str to float
        `videos`, `collisions`, `hits` (announced collisions), `at_contact`, `false_alarms`, `early`
        (included in the false ones) and `minutes` (time in which an alarm counts as false).

        `recall`: hits / collisions. `false_alarms_per_min`. `precision`: hits / (hits + false
        alarms). `lead_s`, `lead_p10_s`: median and 10th percentile of the leads. `auc`: the
        probability that the peak strength before a collision exceeds one elsewhere, see
        `scoring.peaks`. Each is followed by its bounds, `recall_low` and `recall_high`, from
        `N_RESAMPLES` resamples of the videos. NaN where undefined.
    """
    n = len(tallies)
    leads = [one.lead_s[~np.isnan(one.lead_s)] for one in tallies]
    sums = np.array(
        [
            (len(one.lead_s), len(found), one.n_false[0], one.minutes)
            for one, found in zip(tallies, leads, strict=True)
        ]
    )
    n_collisions, n_hits, n_false, minutes = sums.sum(axis=0).tolist()
    n_contact = sum(int(one.at_contact.sum()) for one in tallies)
    n_early = sum(int(one.n_early[0]) for one in tallies)
    counts = n, int(n_collisions), int(n_hits), n_contact, int(n_false), n_early, minutes
    found: Scores = dict(zip(COUNTS, counts, strict=True))
    draws = np.random.default_rng(seed).multinomial(n, np.full(n, 1.0 / n), N_RESAMPLES)
    weights = np.concatenate((np.ones((1, n), np.int64), draws))
    values = _measured(weights, sums, leads, [(one.inside, one.outside) for one in tallies])
    for name, drawn in values.items():
        found[name] = float(drawn[0])
        found[f"{name}_low"], found[f"{name}_high"] = _interval(drawn)
    return found


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
    video = np.repeat(np.arange(len(leads)), [len(one) for one in leads])[order]
    below = _wins(sides)
    n_inside, n_outside = (
        weights @ np.array([len(side[which]) for side in sides], np.int64) for which in (0, 1)
    )
    return {
        "recall": _ratio(n_hits, n_collisions),
        "false_alarms_per_min": _ratio(n_false, minutes),
        "precision": _ratio(n_hits, n_hits + n_false),
        "lead_s": _percentile(lead_s[order], weights[:, video], 0.5),
        "lead_p10_s": _percentile(lead_s[order], weights[:, video], 0.1),
        "auc": _ratio(((weights @ below) * weights).sum(axis=1), n_inside * n_outside),
    }


def _wins(sides: Sequence[tuple[Series, Series]]) -> Series:
    """Pairs in which a peak inside video i exceeds one outside of video j; a tie counts half."""
    found = np.zeros((len(sides), len(sides)))
    every = np.concatenate([inside for inside, _ in sides])
    owner = np.repeat(np.arange(len(sides)), [len(inside) for inside, _ in sides])
    for j, (_, outside) in enumerate(sides):
        ordered = np.sort(outside)
        beaten = np.searchsorted(ordered, every, "left") + np.searchsorted(ordered, every, "right")
        found[:, j] = np.bincount(owner, beaten / 2, minlength=len(sides))
    return found


def _percentile(ordered: Series, weights: npt.NDArray[np.int64], share: float) -> Series:
    """A percentile of increasing values for each row of `weights`: how often each value counts.

    Interpolates linearly, as NumPy does.
    """
    if not ordered.size:
        return np.full(len(weights), np.nan)
    until = np.cumsum(weights, axis=1)
    total = until[:, -1]
    place = share * (total - 1)
    low = np.floor(place)

    def value(rank: Series) -> Series:
        return ordered[np.minimum((until <= rank[:, None]).sum(axis=1), len(ordered) - 1)]

    found = value(low) + (place - low) * (value(np.minimum(low + 1, total - 1)) - value(low))
    return np.where(total > 0, found, np.nan)


def _ratio(above: npt.NDArray, below: npt.ArrayLike) -> Series:
    """A ratio, NaN where its denominator is 0."""
    below = np.broadcast_to(np.asarray(below, np.float64), np.shape(above))
    return np.divide(above, below, out=np.full(np.shape(above), np.nan), where=below > 0)


def _interval(drawn: Series) -> tuple[float, float]:
    """The interval of all values but the first that are not NaN; NaN if the first one is."""
    others = drawn[1:][~np.isnan(drawn[1:])]
    if np.isnan(drawn[0]) or not others.size:
        return np.nan, np.nan
    tail = (1.0 - CONFIDENCE) / 2
    low, high = np.quantile(others, [tail, 1.0 - tail])
    return float(low), float(high)
