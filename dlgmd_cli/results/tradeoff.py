"""The curve of recall over false alarms per minute for all thresholds, and the best threshold."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from dlgmd_cli.frame import Series
from dlgmd_cli.results.intervals import interval
from dlgmd_cli.results.scoring import Signal, Tally

# Maximum number of thresholds of a curve. Half of them are the highest thresholds, without gaps:
# high thresholds give few alarms, and each alarm counts.
MAX_THRESHOLDS = 1000


@dataclass(frozen=True)
class Curve:
    """Performance at T increasing thresholds; arrays of shape (T,).

    `recall` is the share of contacts that are in time or announced, with bounds, see `interval`.
    Without contacts, `recall` is 0 and the bounds are NaN.
    """

    threshold: Series
    recall: Series
    recall_low: Series
    recall_high: Series
    false_alarms_per_min: Series

    def rank(self, i: int) -> tuple[float, float]:
        """Sort key of threshold number i: higher for higher recall, then for fewer false alarms."""
        return float(self.recall[i]), -float(self.false_alarms_per_min[i])

    def best(self, max_false_per_min: float) -> int:
        """Index of the best threshold with at most `max_false_per_min` false alarms per minute.

        Of equally good thresholds, the middle one. The highest threshold raises no alarm, so that
        there is always a solution.
        """
        allowed = np.flatnonzero(~(self.false_alarms_per_min > max_false_per_min))
        ranks = [self.rank(int(i)) for i in allowed]
        top = max(ranks)
        equal = [i for i, rank in zip(allowed, ranks, strict=True) if rank == top]
        return int(equal[len(equal) // 2])

    @property
    def front(self) -> npt.NDArray[np.intp]:
        """Thresholds with a higher recall than all others at as low a rate, by increasing rate."""
        order = np.lexsort((-self.recall, self.false_alarms_per_min))
        before = np.maximum.accumulate(np.concatenate(([-1.0], self.recall[order][:-1])))
        return order[self.recall[order] > before]


def thresholds(signals: Sequence[Signal], n_sp: int) -> Series:
    """All thresholds at which the alarms of the signals differ, increasing, shape (T,).

    Thresholds lie midway between neighbouring strengths. Above `MAX_THRESHOLDS`, the lower ones are
    thinned out. The highest threshold raises no alarm.
    """
    levels = np.unique(np.concatenate([signal.sustained(n_sp) for signal in signals]))
    levels = levels[np.isfinite(levels)]
    if len(levels) > MAX_THRESHOLDS:
        half = MAX_THRESHOLDS // 2
        chosen = np.linspace(0, len(levels) - half - 1, half).round().astype(int)
        levels = np.concatenate((levels[chosen], levels[-half:]))
    if not levels.size:
        return np.array([np.inf])
    top = np.nextafter(levels[-1], np.inf)
    # The midpoint of two adjacent floats is one of the two; both give the same alarms.
    return np.unique(np.concatenate((levels[:1], (levels[1:] + levels[:-1]) / 2, [top])))


def curve(tallies: Sequence[Tally], at: Series) -> Curve:
    """The curve of at least one video, tallied at the same thresholds."""
    hits = np.array([t.is_hit.sum(axis=0) for t in tallies])
    contacts = np.array([len(t.outcome) for t in tallies])
    n_false, minutes = np.sum([t.n_false for t in tallies], axis=0), sum(t.minutes for t in tallies)
    recall = hits.sum(axis=0) / max(contacts.sum(), 1)
    rate = n_false / minutes if minutes else np.full(len(at), np.nan)
    return Curve(at, recall, *interval(hits, contacts, "share"), rate)
