"""The rows of evaluate.csv, curves.csv, windows.csv, alarms.csv and ttc.csv."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise, product
from typing import Any

import numpy as np

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.detection import ROUNDING_S
from dlgmd_cli.models.rules import rule_named
from dlgmd_cli.results import scoring
from dlgmd_cli.results.csv import Cell
from dlgmd_cli.results.labels import ALL, GROUPED, Case, Group
from dlgmd_cli.results.names import interval_text, number_text, share_text, threshold_text
from dlgmd_cli.results.scoring import Signal, Tally, Window
from dlgmd_cli.results.tradeoff import Curve, roc
from dlgmd_cli.tasks.evaluate.candidates import Candidate, Candidates
from dlgmd_cli.tasks.evaluate.stopping import Stops, score_stops, with_bounds

# The measures of a curve, a point of which is a row of curves.csv.
_OF_CURVE = (
    *("recall", "false_alarms_per_min", "lead_s", "saved", "unneeded_per_min"),
    *("recall_low", "recall_high"),
)
CURVE_COLUMNS = ("model", "kind", "rule", "threshold", "excitation", *_OF_CURVE)
WINDOW_COLUMNS = ("video", "model", "start_s", "end_s", "collision_frame", "score")
ALARM_COLUMNS = (
    *("video", "model", "at", "rule", "frame", "time_s", "kind", "lead_s"),
    *("saved", "impact_m_s", "stopped_m", "justified", "outcome"),
)
# What becomes of a collision; and what is said of a stop where there is none.
DETECTED, SAVED, MISSED = "detected", "saved", "missed"
_NO_STOP = (math.nan,) * 4
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


# The share of all collisions that are detected, or whose drone an earlier alarm saves.
SAVED_OR_DETECTED = "saved_or_detected"
OF_STOPS = (*score_stops([]), *with_bounds(SAVED_OR_DETECTED, 0, 0))
# The scores of a candidate on a group of videos at one threshold, by the columns of evaluate.csv.
# `at`: `default`, the threshold of the parameters, or `best`, that with the highest recall at the
# allowed rate of false alarms, chosen on the same videos. `target`: `all`, `all without walls`, or
# a target's name. `kind` and `manner`: `all`, or those of the labels; `speed`: `all`, or that of
# rendered flights, such as "2 m/s"; only one of the four is not `all`. `threshold` is that of the
# normalised potential, and `excitation` that of the mean excitation; with the rule `ttc`, it is
# the time to contact in seconds, and there is no excitation. `n_sp` is the number of frames in a
# row that raise an alarm. The other columns are those of `score` and `score_stops`.
Row = dict[str, Any]


def score_rows(
    candidate: Candidate,
    at: str,
    threshold: tuple[float, float],
    tallies: Sequence[Tally],
    flights: Mapping[int, tuple[Stops, Tally]],
    members: Mapping[Group, Mapping[int, Flags]],
) -> Iterator[Row]:
    """The rows of evaluate.csv of a candidate at a threshold, of all groups.

    `tallies` are those of all videos, and `flights` the rendered ones among them, by number.
    """
    level, strength = threshold
    saved = {i: flight.outcomes(tally.stop_s)[0] for i, (flight, tally) in flights.items()}
    for (word, group), numbers in members.items():
        chosen = [tallies[i].only(flags) for i, flags in numbers.items()]
        stops = score_stops([flights[i] for i in numbers if i in flights])
        spared = [
            ~np.isnan(tally.lead_s[:, 0]) | (saved.get(i, 0.0) == 1.0)
            for i, tally in zip(numbers, chosen, strict=True)
        ]
        every = np.concatenate(spared) if stops["drones"] else np.zeros(0, np.bool_)
        yield {
            "model": candidate.label,
            "at": at,
            **dict.fromkeys(GROUPED, ALL),
            word: group,
            "rule": candidate.rule_name,
            "threshold": level,
            "excitation": candidate.excitation(strength),
            "n_sp": candidate.n_sp,
            **scoring.score(chosen),
            **stops,
            **with_bounds(SAVED_OR_DETECTED, int(every.sum()), len(every)),
        }


def curve_rows(curve: Curve, candidate: Candidate) -> Iterator[list[Cell]]:
    """The cells of curves.csv from `rule` on: the points of a curve at which a measure changes."""
    points = np.stack([getattr(curve, measure) for measure in _OF_CURVE])
    changes = (np.diff(np.nan_to_num(points, nan=-1.0)) != 0.0).any(axis=0)
    for i in np.flatnonzero(np.concatenate(([True], changes))):
        strength = float(curve.threshold[i])
        at = candidate.level(strength), candidate.excitation(strength)
        yield [candidate.rule_name, *at, *points[:, i].tolist()]


def _windows(candidates: Candidates, horizon_s: float) -> Iterator[tuple[Case, str, Window]]:
    """The windows of every video, with each candidate's score."""
    for case, (label, of) in product(candidates.cases, candidates.by_label.items()):
        for window in scoring.windows(of.signals[case.name], of.n_sp, horizon_s):
            yield case, label, window


def window_rows(candidates: Candidates, horizon_s: float) -> Iterator[list[Cell]]:
    """The rows of windows.csv."""
    for case, label, window in _windows(candidates, horizon_s):
        frame = None if window.collision is None else case.collisions[window.collision]
        yield [case.name, label, window.start_s, window.end_s, frame, window.score]


def rocs(candidates: Candidates, horizon_s: float) -> dict[str, tuple[Series, Series]]:
    """The curve whose area is the AUC, see `tradeoff.roc`, of each candidate."""
    by_label: dict[str, list[Window]] = {}
    for _, label, window in _windows(candidates, horizon_s):
        by_label.setdefault(label, []).append(window)
    return {label: roc(*scoring.peaks(every)) for label, every in by_label.items()}


def alarm_rows(
    case: Case, candidate: Candidate, stops: Stops | None, threshold: float, horizon_s: float
) -> list[list[Cell]]:
    """The cells of alarms.csv from `frame` on, of the alarms of a candidate in a video.

    There is a row for each alarm that is not ignored, and for each missed collision. The outcome of
    a collision is that of one row alone: of the first hit, of the alarm that stops the drone
    without a hit, or of the row for the collision that is missed.
    """
    signal, detected = candidate.signals[case.name], set()
    judged = candidate.n_sp, threshold, horizon_s
    rows: list[list[Any]] = []
    for number, kind in scoring.alarms(signal, *judged):
        if kind == scoring.IGNORED:
            continue
        time_s, lead_s, outcome = float(signal.time_s[number]), math.nan, ""
        if kind == scoring.HIT:
            contact_s = min(at_s for at_s in signal.contacts_s if at_s > time_s)
            lead_s = contact_s - time_s
            outcome = "" if contact_s in detected else DETECTED
            detected.add(contact_s)
        frame = number if signal.frame is None else int(signal.frame[number])
        worth = _NO_STOP if stops is None else stops.worth(time_s)
        rows.append([frame, time_s, scoring.KINDS[kind], lead_s, *worth, outcome])
    stop_s = float(scoring.tally(signal, *judged).stop_s[0])
    saved, impact, left, _ = _NO_STOP if stops is None else stops.worth(stop_s)
    for frame, contact_s in zip(case.collisions, signal.contacts_s, strict=True):
        if contact_s in detected:
            continue
        if saved == 1.0:
            max(row for row in rows if row[1] <= stop_s)[-1] = SAVED
        else:
            cells = math.nan, saved, impact, left, math.nan
            rows.append([frame, contact_s, MISSED, *cells, MISSED])
    return sorted(rows)


def ttc_rows(signals: Mapping[str, Sequence[Signal]]) -> Iterator[list[Any]]:
    """The rows of ttc.csv; `signals` are those of all videos, by model.

    Models beside which the same was measured have rows together, as `all models` if there are no
    others. Where nothing is estimated before any collision, there are none.
    """
    by_estimate: dict[bytes, list[tuple[str, Series, Series]]] = {}
    for label, of_model in signals.items():
        left_s, ttc_s = _before_contact(of_model)
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


# What the shares are of.
_SHARES = {
    "recall": "collisions",
    SAVED_OR_DETECTED: "collisions",
    "saved": "drones",
}


def measure_text(row: Row, name: str) -> str:
    """A measure of a row, with its interval if it has one."""
    if name in _SHARES:
        return share_text(row, name, row[_SHARES[name]])
    return interval_text(row, name) if f"{name}_low" in row else number_text(row[name])


def threshold_cell(row: Row) -> str:
    """The threshold of a row with its unit, for tables."""
    if not math.isfinite(row["threshold"]):
        return f"{row['at']}: none"
    threshold = threshold_text(row["threshold"])
    return f"{row['at']} {rule_named(row['rule']).with_unit(threshold)}"
