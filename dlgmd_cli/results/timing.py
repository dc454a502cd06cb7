"""How good the estimated time to contact is, against the time that was left to collisions."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from dlgmd_cli.frame import Series
from dlgmd_cli.models.detection import ROUNDING_S
from dlgmd_cli.results.scoring import Signal

# The columns of ttc.csv: of the frames at which this time was left to the first collision of a
# video, their number, the share of them that have an estimate, the median of the estimates, the
# median and the 90th percentile of |ln(estimate / time left)|, and the median signed and the mean
# absolute error, in s.
TTC_COLUMNS = (
    *("model", "left_from_s", "left_to_s", "frames"),
    *("estimated", "ttc_s", "log_error", "log_error_p90", "error_s", "mean_abs_error_s"),
)
ALL_MODELS = "all models"
_EDGES_S = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)


def ttc_rows(signals: Mapping[str, Sequence[Signal]]) -> Iterator[list[Any]]:
    """The rows of ttc.csv; `signals` are those of all videos, by model.

    Models beside which the same was measured have rows together, as `all models` if there are no
    others. Where nothing is estimated before any collision, there are none.
    """
    by_estimate: dict[bytes, list[Any]] = {}
    for label, own in signals.items():
        left_s, ttc_s = _before_contact(own)
        if not np.isnan(ttc_s).all():
            by_estimate.setdefault(ttc_s.tobytes(), []).append((label, left_s, ttc_s))
    for (label, left_s, ttc_s), *others in by_estimate.values():
        label = ALL_MODELS if others and len(by_estimate) == 1 else label
        for low, high in pairwise(_EDGES_S):
            here = (left_s >= low - ROUNDING_S) & (left_s < high - ROUNDING_S)
            known = here & ~np.isnan(ttc_s)
            measures = [np.nan] * 5
            if known.any():
                off_s = ttc_s[known] - left_s[known]
                error = np.abs(np.log(ttc_s[known] / left_s[known]))
                measures = [np.median(ttc_s[known]), *np.quantile(error, (0.5, 0.9))]
                measures += [np.median(off_s), np.abs(off_s).mean()]
            share = known.sum() / here.sum() if here.any() else np.nan
            yield [label, low, high, int(here.sum()), *map(float, (share, *measures))]


def _before_contact(signals: Sequence[Signal]) -> tuple[Series, Series]:
    """Time left to the first collision, and the estimate of it, at all frames before one."""
    left, estimates = [np.empty(0)], [np.empty(0)]
    for signal in signals:
        if signal.ttc_s is not None and signal.contacts_s:
            left_s = signal.contacts_s[0] - signal.time_s
            is_before = (left_s >= _EDGES_S[0] - ROUNDING_S) & (left_s < _EDGES_S[-1])
            left.append(left_s[is_before])
            estimates.append(signal.ttc_s[is_before])
    return np.concatenate(left), np.concatenate(estimates)
