"""All thresholds at once: recall over false alarms with its interval, and the ROC."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.results import intervals
from dlgmd_cli.results.scoring import (
    HORIZON_S,
    IGNORED,
    Signal,
    Tally,
    kinds,
    onset_thresholds,
    ratio,
    resampled,
)

# Maximum number of thresholds of a curve. Half of them are the highest ones, without gaps: there
# alarms are few, and each counts.
MAX_THRESHOLDS = 4000


@dataclass(frozen=True)
class Curve:
    """Performance at T increasing thresholds; arrays of shape (T,). `lead_s` is a median or NaN.

    `saved` is the share of the drones that stops save, and `unneeded_per_min` the rate of false
    stops, in rendered flights alone; else NaN. `recall_low` and `recall_high` are those of
    `with_band`, or NaN.
    """

    threshold: Series
    recall: Series
    false_alarms_per_min: Series
    lead_s: Series
    saved: Series
    unneeded_per_min: Series
    recall_low: Series
    recall_high: Series

    def rank(self, i: int) -> tuple[float, float, float]:
        """Sort key of threshold number i: high recall, few false alarms, a long lead time."""
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
    ends = [np.empty(0)]
    for signal in signals:
        low, high = onset_thresholds(signal, n_sp)
        counts = (low < high) & (kinds(signal, horizon_s)[0] != IGNORED)
        ends += [low[counts], high[counts]]
    edges = np.unique(np.concatenate(ends))
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


def curve(tallies: Sequence[Tally], at: Series, counted: Flags | None = None) -> Curve:
    """The curve of videos that were tallied at the same thresholds.

    With `counted`, (videos,) bool, the rate of false alarms is that of these videos alone.
    """
    leads_s = np.concatenate([t.lead_s for t in tallies])
    recall = (~np.isnan(leads_s)).mean(axis=0) if len(leads_s) else np.full(len(at), np.nan)
    limited = [t for i, t in enumerate(tallies) if counted is None or counted[i]]
    n_false = np.sum([t.n_false for t in limited], axis=0) + np.zeros(len(at))
    minutes = sum(t.minutes for t in limited)
    rate, undefined = ratio(n_false, minutes), np.full(len(at), np.nan)
    return Curve(at, np.nan_to_num(recall), rate, medians(leads_s), *[undefined] * 4)


def greatest(rate: Series, share: Series, at: Series) -> Series:
    """The greatest share at no more than each rate in `at`, of T thresholds' rates and shares."""
    order = np.argsort(rate)
    best = np.concatenate(([0.0], np.maximum.accumulate(share[order])))
    return np.asarray(best[np.searchsorted(rate[order], at, side="right")])


def with_band(curve: Curve, tallies: Sequence[Tally]) -> Curve:
    """The curve of these videos with the interval of its recall; without a collision, as it is.

    It is that of the greatest recall at no more than the rate of each point, of resamples of the
    videos, each with the thresholds that suit it, and at least as wide as the exact one.
    """
    rate, n_collisions = curve.false_alarms_per_min, np.array([len(t.lead_s) for t in tallies])
    total = int(n_collisions.sum())
    if not total:
        return curve
    n_hits = np.array([(~np.isnan(t.lead_s)).sum(axis=0) for t in tallies])
    n_false, minutes = np.array([t.n_false for t in tallies]), [t.minutes for t in tallies]
    drawn = [
        greatest(ratio(w @ n_false, w @ minutes), w @ n_hits / (w @ n_collisions), rate)
        for w in resampled(len(tallies))
        if w @ n_collisions
    ]
    exact = np.array([intervals.binomial_interval(k, total) for k in range(total + 1)])
    low, high = exact[np.rint(drawn[0] * total).astype(int)].T
    tail = (1.0 - intervals.CONFIDENCE) / 2
    least, most = np.quantile(drawn[1:], [tail, 1.0 - tail], axis=0)
    bounds = np.minimum(low, least), np.maximum(high, most)
    return replace(curve, recall_low=bounds[0], recall_high=bounds[1])


def medians(columns: Series) -> Series:
    """The median of every column of an (n, T) array, ignoring NaN; NaN if a column has only NaN."""
    n = (~np.isnan(columns)).sum(axis=0)
    if not len(columns):
        return np.full(len(n), np.nan)
    ordered = np.sort(columns, axis=0)  # NaN comes last
    middle = np.stack([np.maximum(n - 1, 0) // 2, np.minimum(n // 2, len(columns) - 1)])
    return np.asarray(np.take_along_axis(ordered, middle, axis=0).mean(axis=0))


def roc(inside: Series, outside: Series) -> tuple[Series, Series]:
    """The curve whose area is the AUC: shares of windows with at least each score, from 0 to 1.

    Returns
    -------
    elsewhere, before : ndarray, shape (1 + number of different scores,)
        Lines between the points make a tie count half.
    """
    levels = np.unique(np.concatenate((inside, outside)))[::-1]
    sides = (np.sort(outside), np.sort(inside))
    elsewhere, before = (
        np.concatenate(([0.0], 1.0 - np.searchsorted(side, levels) / len(side))) for side in sides
    )
    return elsewhere, before
