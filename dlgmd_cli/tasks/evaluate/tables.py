"""The rows of evaluate.csv, curves.csv, alarms.csv and ttc.csv."""

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.detection import ROUNDING_S
from dlgmd_cli.models.rules import rule_named
from dlgmd_cli.models.stopping import BRAKES, MARGIN_S
from dlgmd_cli.results import scoring
from dlgmd_cli.results.csv import Cell
from dlgmd_cli.results.labels import ALL, GROUPED, Case, VideoGroup
from dlgmd_cli.results.names import threshold_text
from dlgmd_cli.results.scoring import FALSE, FURTHER, JUSTIFIED, OUTCOMES, Scores, Signal, Tally
from dlgmd_cli.results.tradeoff import Curve
from dlgmd_cli.tasks.evaluate.candidates import Candidate

# The measures of a curve; each point of the curve is a row of curves.csv.
_OF_CURVE = ("recall", "recall_low", "recall_high", "false_alarms_per_min")
CURVE_COLUMNS = ("model", "kind", "rule", "threshold", "excitation", *_OF_CURVE)
SCORED_ALARM_COLUMNS = (
    *("video", "model", "at", "rule", "frame", "time_s", "kind", "collision_frame", "lead_s"),
    *("duration_s", "false_alarms"),
)
# The columns of ttc.csv. Each row is about the frames with the same time left to a video's first
# contact: their number, the share of frames with an estimate, the median of the estimates (s), the
# median and 90th percentile of |ln(estimate / time left)|, and the median signed error and mean
# absolute error (s).
TTC_COLUMNS = (
    *("model", "left_from_s", "left_to_s", "frames"),
    *("estimated", "ttc_s", "log_error", "log_error_p90", "error_s", "mean_abs_error_s"),
)
ALL_MODELS = "all models"
DEFAULT, BEST = "default", "best"
_EDGES_S = (0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0)

# The scores of a candidate on a group of videos at one threshold, by the columns of evaluate.csv.
# `at`: `default`, the threshold of the parameters, or `best`, the threshold with the highest recall
# at the allowed rate of false alarms, chosen on the same videos. `target`: `all`, `all without
# walls`, or a target's name. `kind`, `manner`: `all`, or a word of the labels. At most one of these
# three is not `all`. `threshold` compares the normalised potential, `excitation` the mean
# excitation; with the rule `ttc`, `threshold` is a time to contact in s, without an excitation.
# `n_sp` is the number of frames in a row that raise an alarm. `score` gives the other columns.
Row = dict[str, Any]


def score_rows(
    candidate: Candidate,
    at: str,
    strength: float,
    tallies: Sequence[Tally],
    members: Mapping[VideoGroup, Mapping[int, Flags]],
) -> Iterator[Row]:
    """The rows of evaluate.csv of a candidate at a threshold: one row per group.

    `tallies` has the alarms in each of the videos.
    """
    for (word, group), numbers in members.items():
        yield {
            "model": candidate.label,
            "at": at,
            **dict.fromkeys(GROUPED, ALL),
            word: group,
            "rule": candidate.rule_name,
            "threshold": candidate.level(strength),
            "excitation": candidate.excitation(strength),
            "n_sp": candidate.n_sp,
            **scoring.score([tallies[i].only(flags) for i, flags in numbers.items()]),
            **_needed(candidate),
        }


def _needed(candidate: Candidate) -> dict[str, float]:
    """`threshold_arducopter` and so on: the threshold for the longest stop by each of `BRAKES`.

    NaN without a speed, and if the threshold of the rule means no time before a contact.
    """
    contacts = [contact for signal in candidate.signals.values() for contact in signal.contacts]
    stops_s = [contact.stops_s for contact in contacts if contact.has_speed]
    rule, names = candidate.rule, [f"threshold_{name}" for name in BRAKES]
    if rule is None or not rule.follows_speed or not stops_s:
        return dict.fromkeys(names, math.nan)
    needed_s = np.max(stops_s, axis=0) + MARGIN_S
    return {name: rule.threshold_at(s) for name, s in zip(names, needed_s.tolist(), strict=True)}


def curve_rows(curve: Curve, candidate: Candidate) -> Iterator[list[Cell]]:
    """The cells of curves.csv from `rule` on.

    These are the points of a curve before and after each change of a measure: between two points
    with the same measures, they hold for every threshold.
    """
    points = np.stack([getattr(curve, measure) for measure in _OF_CURVE])
    changes = (np.diff(np.nan_to_num(points, nan=-1.0)) != 0.0).any(axis=0)
    begins, ends = np.concatenate(([True], changes)), np.concatenate((changes, [True]))
    for i in np.flatnonzero(begins | ends):
        strength = float(curve.threshold[i])
        at = candidate.level(strength), candidate.excitation(strength)
        yield [candidate.rule_name, *at, *points[:, i].tolist()]


def alarm_rows(case: Case, candidate: Candidate, strength: float) -> list[list[Cell]]:
    """The cells of alarms.csv from `frame` on, of a candidate in a video.

    Each contact has a row, with the onset that decides the contact's outcome, if there is one. Each
    further onset has a row.
    """
    signal = candidate.signals[case.name]
    every = scoring.alarms(signal, candidate.n_sp, strength)
    judged = scoring.tally(signal, candidate.n_sp, strength)
    frames = np.arange(len(signal.time_s)) if signal.frame is None else signal.frame
    of_onset: dict[int, list[tuple[str, float, float]]] = {}
    rows: list[list[Any]] = []
    for number, collision in enumerate(case.collisions):
        kind = OUTCOMES[judged.outcome[number, 0]]
        onset, lead_s = int(judged.onset[number, 0]), float(judged.lead_s[number, 0])
        if onset < 0:
            contact_s = signal.contacts[number].time_s
            rows.append([collision, contact_s, kind, collision, math.nan, math.nan, 0])
        of_onset.setdefault(onset, []).append((kind, collision, lead_s))
    for i, row in enumerate(every.row):
        other = FALSE if every.n_false[i] else JUSTIFIED if every.justified[i] else FURTHER
        stands_s, n_false = float(every.end_s[i] - every.start_s[i]), int(every.n_false[i])
        for kind, of, lead_s in of_onset.get(i, [(other, math.nan, math.nan)]):
            start = int(frames[row]), float(every.start_s[i])
            rows.append([*start, kind, of, lead_s, stands_s, n_false])
            n_false = 0  # false alarms are counted in one row only
    return sorted(rows, key=lambda cells: cells[:2])


def ttc_rows(signals: Mapping[str, Sequence[Signal]]) -> Iterator[list[Any]]:
    """The rows of ttc.csv; `signals` has the signals of all videos by model.

    Models with the same estimates share rows, called `all models` if every model has them. If no
    time is estimated before any contact, there are no rows.
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
    """True and estimated time to the first contact, in s, at all frames before that contact."""
    left, estimates = [np.empty(0)], [np.empty(0)]
    for signal in signals:
        if signal.ttc_s is not None and signal.contacts:
            left_s = signal.contacts[0].time_s - signal.time_s
            is_before = (left_s >= _EDGES_S[0] - ROUNDING_S) & (left_s < _EDGES_S[-1])
            left.append(left_s[is_before])
            estimates.append(signal.ttc_s[is_before])
    return np.concatenate(left), np.concatenate(estimates)


def hits_text(row: Scores) -> str:
    """Cell of a table: number of hits (in time or announced), and the interval of their share."""
    if not row["contacts"]:
        return "–"
    low, high = (100.0 * row[f"recall_{end}"] for end in ("low", "high"))
    bounds = "" if math.isnan(low) else f" ({low:.0f}–{high:.0f} %)"
    return f"{row['hits']}/{row['contacts']}{bounds}"


def false_text(row: Scores) -> str:
    """Cell of a table: the false alarms' number, minutes, rate per minute and its interval."""
    rate, low, high = (row[f"false_alarms_per_min{end}"] for end in ("", "_low", "_high"))
    if math.isnan(rate):
        return "–"
    bounds = "" if math.isnan(low) else f" ({low:.2g}–{high:.2g})"
    return f"{row['false_alarms']} in {row['minutes']:.3g}: {rate:.2g}{bounds}"


def brake_text(row: Row, name: str) -> str:
    """Cell of a table: the contacts in time for a stop by one of `BRAKES`, and its threshold."""
    needed = row[f"threshold_{name}"]
    with_unit = "" if math.isnan(needed) else rule_named(row["rule"]).with_unit(f"{needed:.3g}")
    return f"{row[f'in_time_{name}']}" + (with_unit and f" (needs {with_unit})")


def threshold_cell(row: Row) -> str:
    """Cell of a table: a row's threshold with its unit; the best threshold has a star."""
    star = "" if row["at"] == DEFAULT else " *"
    if not math.isfinite(row["threshold"]):
        return f"none{star}"
    text = threshold_text(row["threshold"])
    return (rule_named(row["rule"]).with_unit(text) if row["rule"] else text) + star
