"""The tables of an evaluation: scores by model, threshold and target; curves; alarms."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.lab.evaluation.cases import Candidate, Case, Evaluation
from dlgmd_cli.lab.evaluation.measures import (
    MEASURES,
    Curve,
    Estimate,
    Scores,
    count,
    curve,
    score,
    thresholds,
)
from dlgmd_cli.lab.evaluation.scoring import HIT, IGNORED, KINDS, alarms
from dlgmd_cli.models.detection import Flags, Series
from dlgmd_cli.results.csv import cell, text_cell, write_rows

ALL, WITHOUT_WALLS, WALL = "all", "all without walls", "wall"
DEFAULT, BEST = "default", "best"
COUNTS = ("videos", "collisions", "hits", "at_contact", "false_alarms", "early", "minutes")
COLUMNS = (
    *("model", "at", "target", "threshold", "excitation", "n_sp", *COUNTS),
    *(f"{name}{end}" for name in MEASURES for end in ("", "_low", "_high")),
)
CURVE_COLUMNS = ("model", "threshold", "excitation", "recall", "false_alarms_per_min", "lead_s")
ALARM_COLUMNS = ("video", "model", "at", "frame", "time_s", "kind", "lead_s")


@dataclass(frozen=True)
class Row:
    """The scores of a candidate on a group of videos at one threshold.

    Attributes
    ----------
    at : str
        `default`: the threshold of the parameters. `best`: the threshold with the highest recall at
        the allowed rate of false alarms, chosen on the same videos.
    target : str
        `all`, `all without walls`, or the name of a target.
    excitation : float
        The threshold of the mean excitation; `threshold` is that of the normalised potential.
    """

    candidate: Candidate
    at: str
    target: str
    excitation: float
    scores: Scores

    @property
    def threshold(self) -> float:
        """The threshold of the normalised potential."""
        if self.at == DEFAULT and self.candidate.params is not None:
            return self.candidate.params.t_mp
        return self.candidate.level(self.excitation)


@dataclass(frozen=True)
class Report:
    """All rows, those of target `all` first, and the curve and the leads of each candidate.

    The leads, in seconds, are those at the default threshold, or, for a baseline, at the best one;
    NaN for collisions that are not announced.
    """

    rows: list[Row]
    curves: dict[str, Curve]
    leads_s: dict[str, Series]

    def row(self, label: str, at: str, target: str = ALL) -> Row | None:
        """The row of a candidate, threshold and target, or None."""
        for row in self.rows:
            if (row.candidate.label, row.at, row.target) == (label, at, target):
                return row
        return None

    def main(self, label: str, target: str = ALL) -> Row:
        """The row at the default threshold, or, for a baseline, at the best one."""
        found = self.row(label, DEFAULT, target) or self.row(label, BEST, target)
        assert found is not None
        return found


def groups(cases: Sequence[Case]) -> dict[str, dict[int, Flags]]:
    """For each group of targets, its videos by number, and flags of the collisions in the group."""
    known = sorted({target for case in cases for target in case.targets if target})
    chosen: dict[str, Iterable[str]] = {}
    if WALL in known and len(known) > 1:
        chosen[WITHOUT_WALLS] = {target for case in cases for target in case.targets} - {WALL}
    chosen |= {target: {target} for target in known}
    found = {ALL: {i: case.of_target(case.targets) for i, case in enumerate(cases)}}
    for name, targets in chosen.items():
        found[name] = {
            i: case.of_target(targets)
            for i, case in enumerate(cases)
            if set(case.targets) & set(targets)
        }
    return found


def make_report(evaluation: Evaluation, horizon_s: float, max_false_per_min: float) -> Report:
    """Score every candidate of an evaluation, which has at least one video."""
    rows: list[Row] = []
    curves, leads_s = {}, {}
    for label, candidate in evaluation.candidates.items():
        signals = [candidate.signals[case.name] for case in evaluation.cases]
        n_sp = candidate.n_sp
        curves[label] = curve(signals, n_sp, thresholds(signals, n_sp, horizon_s), horizon_s)
        best = curves[label].best(max_false_per_min)
        at = {BEST: float(curves[label].threshold[best])}
        if candidate.threshold is not None:
            at = {DEFAULT: candidate.threshold, **at}
        for name, strength in at.items():
            counts = [count(one, n_sp, strength, horizon_s) for one in signals]
            if label not in leads_s:
                leads_s[label] = np.concatenate([one.lead_s for one in counts])
            for target, members in groups(evaluation.cases).items():
                chosen = [counts[i].only(wanted) for i, wanted in members.items()]
                rows.append(Row(candidate, name, target, strength, score(chosen)))
    rows.sort(key=lambda row: row.target != ALL)
    return Report(rows, curves, leads_s)


def write_report(path: Path, report: Report) -> None:
    """Write evaluate.csv, see `COLUMNS`; OSError passes through."""

    def cells(row: Row) -> list[str]:
        scores = row.scores
        numbers: list[Any] = [row.threshold, row.excitation, row.candidate.n_sp]
        numbers += [getattr(scores, name) for name in COUNTS]
        numbers += [value for name in MEASURES for value in scores.measures[name]]
        words = (text_cell(row.candidate.label), row.at, text_cell(row.target))
        return [*words, *map(cell, numbers)]

    write_rows(path, COLUMNS, map(cells, report.rows))


def write_curves(path: Path, report: Report, candidates: Mapping[str, Candidate]) -> None:
    """Write curves.csv: the points of every curve at which a measure changes."""

    def rows() -> Iterator[list[str]]:
        for label, found in report.curves.items():
            columns = np.stack([found.recall, found.false_alarms_per_min, found.lead_s])
            before = np.nan_to_num(columns[:, :-1], nan=-1.0)
            changes = (np.nan_to_num(columns[:, 1:], nan=-1.0) != before).any(axis=0)
            for i in np.flatnonzero(np.concatenate(([True], changes))):
                strength = float(found.threshold[i])
                numbers = [candidates[label].level(strength), strength, *columns[:, i]]
                yield [text_cell(label), *map(cell, numbers)]

    write_rows(path, CURVE_COLUMNS, rows())


def write_alarms(path: Path, report: Report, evaluation: Evaluation, horizon_s: float) -> None:
    """Write alarms.csv: every alarm that is not ignored, and every missed collision."""

    def rows() -> Iterator[list[str]]:
        for case in evaluation.cases:
            for label, candidate in evaluation.candidates.items():
                row, signal = report.main(label), candidate.signals[case.name]
                found: list[tuple[int, float, str, float]] = []
                announced = set()
                for number, kind in alarms(signal, candidate.n_sp, row.excitation, horizon_s):
                    time_s, lead_s = float(signal.time_s[number]), math.nan
                    if kind == HIT:
                        contact_s = min(one for one in signal.contacts_s if one > time_s)
                        announced.add(contact_s)
                        lead_s = contact_s - time_s
                    if kind != IGNORED:
                        frame = number if signal.frame is None else int(signal.frame[number])
                        found.append((frame, time_s, KINDS[kind], lead_s))
                for frame, contact_s in zip(case.collisions, signal.contacts_s, strict=True):
                    if contact_s not in announced:
                        found.append((frame, contact_s, "missed", math.nan))
                for frame, time_s, word, lead_s in sorted(found):
                    words = (text_cell(case.name), text_cell(label), row.at)
                    yield [*words, str(frame), cell(time_s), word, cell(lead_s)]

    write_rows(path, ALARM_COLUMNS, rows())


def report_json(report: Report, candidates: Mapping[str, Candidate]) -> dict[str, Any]:
    """The measures of every candidate over all videos, by label; None where undefined."""

    def facts(row: Row) -> dict[str, Any]:
        return {
            "at": row.at,
            "threshold": defined(row.threshold),
            "n_sp": row.candidate.n_sp,
            **scores_json(row.scores),
        }

    found = {}
    for label in candidates:
        row, best = report.main(label), report.row(label, BEST)
        found[label] = facts(row)
        if best is not None and best is not row:
            found[label]["best"] = facts(best)
        targets = {one.target for one in report.rows} - {ALL}
        found[label]["recall_by_target"] = {
            target: defined(report.main(label, target).scores.measures["recall"].value)
            for target in sorted(targets)
        }
    return found


def scores_json(scores: Scores) -> dict[str, Any]:
    """The measures, their intervals and the counts as JSON values."""
    measures = scores.measures
    return {
        **{name: defined(one.value) for name, one in measures.items()},
        "intervals": {
            name: [defined(one.low), defined(one.high)] for name, one in measures.items()
        },
        **{name: getattr(scores, name) for name in COUNTS},
    }


def defined(value: float) -> float | None:
    """The value, or None if it is not finite: JSON has no number for it."""
    return value if math.isfinite(value) else None


def interval_text(one: Estimate, digits: int = 2) -> str:
    """A measure with its interval, for tables."""
    if math.isnan(one.value):
        return "–"
    if math.isnan(one.low):
        return f"{one.value:.{digits}f}"
    return f"{one.value:.{digits}f} ({one.low:.{digits}f}–{one.high:.{digits}f})"
