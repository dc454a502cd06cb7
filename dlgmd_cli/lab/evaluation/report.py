"""The tables of an evaluation: scores by model, threshold and target; curves; alarms."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from dlgmd_cli.checks import require_known
from dlgmd_cli.lab.evaluation.cases import Case, Evaluation, of_kind
from dlgmd_cli.lab.evaluation.scoring import (
    COUNTS,
    HIT,
    IGNORED,
    KINDS,
    MEASURES,
    Curve,
    Scores,
    alarms,
    curve,
    score,
    tally,
    thresholds,
)
from dlgmd_cli.models.detection import Flags, Series
from dlgmd_cli.results.csv import Table, table_of, write_values
from dlgmd_cli.results.store import Write

if TYPE_CHECKING:
    from dlgmd_cli.plots.style import Figure, Width

ALL, WITHOUT_WALLS, WALL = "all", "all without walls", "wall"
DEFAULT, BEST = "default", "best"
FIGURES = ("trade-off", "leads")
# By what the videos are grouped, and the words in a row of scores.
GROUPED = ("target", "kind", "manner")
_WORDS = ("model", "at", *GROUPED)
CURVE_COLUMNS = (
    "model",
    "kind",
    "threshold",
    "excitation",
    "recall",
    "false_alarms_per_min",
    "lead_s",
)
ALARM_COLUMNS = ("video", "model", "at", "frame", "time_s", "kind", "lead_s")


# The scores of a candidate on a group of videos at one threshold, by the columns of evaluate.csv.
# `at`: `default`, the threshold of the parameters, or `best`, that with the highest recall at the
# allowed rate of false alarms, chosen on the same videos. `target`: `all`, `all without walls`, or
# a target's name. `kind` and `manner`: `all`, or those of the labels; only one of the three is not
# `all`. `threshold` is that of the normalised potential, `excitation` that of the mean
# excitation; the other columns are those of `score`.
Row = dict[str, Any]


@dataclass(frozen=True, eq=False, repr=False)
class Report:
    """All rows, those of all videos first, and the curves and the leads of each candidate.

    It has a curve for `all` videos and for each kind. The leads, in seconds, are those at the
    default threshold, or, for a baseline, at the best one; NaN for collisions that are not
    announced.
    """

    evaluation: Evaluation
    horizon_s: float
    rows: list[Row]
    curves: dict[str, dict[str, Curve]]
    leads_s: dict[str, Series]
    max_false_per_min: float

    def __repr__(self) -> str:
        first, form = (
            self.rows[0],
            "{model} recall {recall:.2f}, {false_alarms_per_min:.2f} false/min",
        )
        said = "; ".join(form.format(**self.main(label)) for label in self.curves)
        return f"<Report on {first['videos']} videos, {first['collisions']} collisions: {said}>"

    @property
    def table(self) -> Table:
        """The rows as evaluate.csv has them: scores by model, threshold and group of videos."""
        return table_of(list(self.rows[0]), ([*row.values()] for row in self.rows))

    @property
    def curve_table(self) -> Table:
        """The rows of curves.csv: each model's recall and false alarms at every threshold."""
        return table_of(CURVE_COLUMNS, self._curve_rows())

    @property
    def alarm_table(self) -> Table:
        """The rows of alarms.csv: every alarm that counts, and every missed collision."""
        return table_of(ALARM_COLUMNS, self._alarm_rows())

    def plot(self, kind: str = "trade-off", width: "Width" = "one") -> "Figure":
        """A figure: `trade-off` of recall and false alarms, or `leads`; `width` in columns.

        Raises ParameterError if there is no such figure.
        """
        from dlgmd_cli.lab.plots.evaluation import leads, trade_off

        require_known("figure", kind, FIGURES)
        if kind == "leads":
            return leads(self.leads_s, self.horizon_s, width)
        curves, points = {}, {}
        for label, own in self.curves.items():
            for name, one in own.items():
                title = label if name == ALL else f"{label}, {name}"
                if not self.main(label, kind=name)["collisions"] and name != ALL:
                    continue  # nothing to announce
                curves[title] = one.false_alarms_per_min, one.recall
                row = self.row(label, DEFAULT, kind=name)
                if row is not None:
                    points[title] = row["false_alarms_per_min"], row["recall"]
        return trade_off(curves, points, self.max_false_per_min, width)

    def row(self, label: str, at: str, **group: str) -> Row | None:
        """The row of a candidate and threshold, of all videos or of a group, or None."""
        asked = {"model": label, "at": at, **dict.fromkeys(GROUPED, ALL), **group}
        return next((r for r in self.rows if all(r[word] == asked[word] for word in _WORDS)), None)

    def main(self, label: str, **group: str) -> Row:
        """The row at the default threshold, or, for a baseline, at the best one."""
        found = self.row(label, DEFAULT, **group) or self.row(label, BEST, **group)
        assert found is not None
        return found

    def names(self, word: str) -> list[str]:
        """The groups by target, kind or manner but `all`, in the order of the rows."""
        return list(dict.fromkeys(row[word] for row in self.rows if row[word] != ALL))

    def counts(self) -> dict[str, Any]:
        """Numbers of videos, collisions and minutes, and the videos that failed."""
        signals = self.evaluation.signals(self.rows[0]["model"])
        return {
            "videos": len(self.evaluation.cases),
            "collisions": sum(len(case.collisions) for case in self.evaluation.cases),
            "minutes": round(sum(signal.minutes for signal in signals), 3),
            "failed": dict(self.evaluation.failed),
        }

    def tables(self) -> dict[str, Write]:
        """The function that writes each table, by file name; OSError passes through."""
        rows = [[*row.values()] for row in self.rows]
        return {
            "evaluate.csv": partial(write_values, header=list(self.rows[0]), rows=rows),
            "curves.csv": partial(write_values, header=CURVE_COLUMNS, rows=self._curve_rows()),
            "alarms.csv": partial(write_values, header=ALARM_COLUMNS, rows=self._alarm_rows()),
        }

    def _curve_rows(self) -> Iterator[list[Any]]:
        """The rows of curves.csv: the points of every curve at which a measure changes."""
        every = [(label, *one) for label, own in self.curves.items() for one in own.items()]
        for label, kind, found in every:
            columns = np.stack([found.recall, found.false_alarms_per_min, found.lead_s])
            changes = (np.diff(np.nan_to_num(columns, nan=-1.0)) != 0.0).any(axis=0)
            for i in np.flatnonzero(np.concatenate(([True], changes))):
                strength = float(found.threshold[i])
                level = self.evaluation.candidates[label].level(strength)
                yield [label, kind, level, strength, *columns[:, i].tolist()]

    def _alarm_rows(self) -> Iterator[list[Any]]:
        """The rows of alarms.csv: every alarm that is not ignored, and every missed collision."""
        for case in self.evaluation.cases:
            for label, candidate in self.evaluation.candidates.items():
                row, signal = self.main(label), candidate.signals[case.name]
                found: list[tuple[int, float, str, float]] = []
                announced = set()
                for number, kind in alarms(
                    signal, candidate.n_sp, row["excitation"], self.horizon_s
                ):
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
                    yield [case.name, label, row["at"], frame, time_s, word, lead_s]

    def to_json(self) -> dict[str, Any]:
        """The measures of every candidate over all videos, by label; None where undefined."""

        def facts(row: Row) -> dict[str, Any]:
            at = {"at": row["at"], "threshold": defined(row["threshold"]), "n_sp": row["n_sp"]}
            return at | scores_json(row)

        found = {}
        for label in self.evaluation.candidates:
            row, best = self.main(label), self.row(label, BEST)
            found[label] = facts(row)
            if best is not None and best is not row:
                found[label]["best"] = facts(best)
            found[label]["recall_by_target"] = {
                target: defined(self.main(label, target=target)["recall"])
                for target in sorted(self.names("target"))
            }
            for word in ("kind", "manner"):
                found[label][f"by_{word}"] = {
                    name: scores_json(self.main(label, **{word: name})) for name in self.names(word)
                }
        return found


def groups(cases: Sequence[Case]) -> dict[tuple[str, str], dict[int, Flags]]:
    """For each group, its videos by number, and flags of the collisions in the group.

    The keys are by what the videos are grouped, and the group's name: `all` first, then the groups
    of targets, kinds and manners. A kind or manner that all videos have is no group.
    """
    every = {target for case in cases for target in case.targets}
    chosen = {ALL: every}
    if WALL in every and every - {WALL, ""}:
        chosen[WITHOUT_WALLS] = every - {WALL}
    chosen |= {target: {target} for target in sorted(every - {""})}
    found = {
        ("target", name): {
            i: case.of_target(targets)
            for i, case in enumerate(cases)
            if targets.intersection(case.targets)
        }
        for name, targets in chosen.items()
    }
    for word in ("kind", "manner"):
        names = [getattr(case, word) for case in cases]
        for name in sorted({*names} - {""}) if len({*names}) > 1 else ():
            found[word, name] = {
                i: np.ones(len(cases[i].collisions), np.bool_)
                for i, own in enumerate(names)
                if own == name
            }
    return found


def make_report(
    evaluation: Evaluation,
    horizon_s: float,
    max_false_per_min: float,
    max_false_kind: str | None = None,
) -> Report:
    """Score every candidate of an evaluation, which has at least one video.

    The allowed rate of false alarms is that on all videos, or on those of one kind; raises
    ParameterError if there are none.
    """
    rows: list[Row] = []
    curves: dict[str, dict[str, Curve]] = {}
    leads_s: dict[str, Series] = {}
    members, counted = groups(evaluation.cases), of_kind(evaluation.cases, max_false_kind)
    for label, candidate in evaluation.candidates.items():
        signals, n_sp = evaluation.signals(label), candidate.n_sp
        levels = thresholds(signals, n_sp, horizon_s)
        every = [tally(one, n_sp, levels, horizon_s) for one in signals]
        curves[label] = {
            name: curve([every[i] for i in own], levels)
            for (word, name), own in members.items()
            if word == "kind" or name == ALL
        }
        best = float(levels[curve(every, levels, counted).best(max_false_per_min)])
        at = {BEST: (candidate.level(best), best)}
        if candidate.threshold is not None:
            at = {DEFAULT: candidate.threshold, **at}
        for name, (level, strength) in at.items():
            tallies = [tally(one, n_sp, strength, horizon_s) for one in signals]
            leads_s.setdefault(label, np.concatenate([one.lead_s[:, 0] for one in tallies]))
            for (word, group), wanted in members.items():
                chosen = [tallies[i].only(flags) for i, flags in wanted.items()]
                own = {"model": label, "at": name, **dict.fromkeys(GROUPED, ALL), word: group}
                at_level = {"threshold": level, "excitation": strength, "n_sp": n_sp}
                rows.append({**own, **at_level, **score(chosen)})
    rows.sort(key=lambda row: any(row[word] != ALL for word in GROUPED))
    return Report(evaluation, horizon_s, rows, curves, leads_s, max_false_per_min)


def scores_json(scores: Scores) -> dict[str, Any]:
    """The measures, their intervals and the counts as JSON values."""
    intervals = {name: (scores[f"{name}_low"], scores[f"{name}_high"]) for name in MEASURES}
    return {
        **{name: defined(scores[name]) for name in MEASURES},
        "intervals": {name: list(map(defined, bounds)) for name, bounds in intervals.items()},
        **{name: scores[name] for name in COUNTS},
    }


def defined(value: float) -> float | None:
    """The value, or None if it is not finite: JSON has no number for it."""
    return value if math.isfinite(value) else None


def interval_text(scores: Scores, name: str) -> str:
    """A measure with its interval, for tables."""
    value, low, high = (scores[f"{name}{end}"] for end in ("", "_low", "_high"))
    if math.isnan(value):
        return "–"
    return f"{value:.2f}" if math.isnan(low) else f"{value:.2f} ({low:.2f}–{high:.2f})"
