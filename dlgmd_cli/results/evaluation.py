"""`Evaluation`: alarms against labelled collisions, by model, threshold and target."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from dlgmd_cli.errors import DlgmdError, ParameterError, counted
from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.rules import rule_named
from dlgmd_cli.results import scoring, stopping
from dlgmd_cli.results.candidates import Candidate, Candidates
from dlgmd_cli.results.csv import Table, table_of
from dlgmd_cli.results.labels import Case, of_kind
from dlgmd_cli.results.names import threshold_text
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import record_text
from dlgmd_cli.results.timing import TTC_COLUMNS, ttc_rows

if TYPE_CHECKING:
    from matplotlib.figure import Figure

ALL, WITHOUT_WALLS, WALL = "all", "all without walls", "wall"
DEFAULT, BEST = "default", "best"
# What becomes of a collision.
DETECTED, SAVED, MISSED = "detected", "saved", "missed"
# By what the videos are grouped, and the words in a row of scores.
GROUPED = ("target", "kind", "manner", "speed")
_WORDS = ("model", "at", *GROUPED)
CURVE_COLUMNS = (
    *("model", "kind", "rule", "threshold", "excitation"),
    *("recall", "false_alarms_per_min", "lead_s", "saved", "unneeded_per_min"),
)
ALARM_COLUMNS = (
    *("video", "model", "at", "rule", "frame", "time_s", "kind", "lead_s"),
    *("saved", "impact_m_s", "stopped_m", "justified", "outcome"),
)


# The scores of a candidate on a group of videos at one threshold, by the columns of evaluate.csv.
# `at`: `default`, the threshold of the parameters, or `best`, that with the highest recall at the
# allowed rate of false alarms, chosen on the same videos. `target`: `all`, `all without walls`, or
# a target's name. `kind` and `manner`: `all`, or those of the labels; `speed`: `all`, or that of
# rendered flights, such as "2 m/s"; only one of the four is not `all`. `threshold` is that of the
# normalised potential, and `excitation` that of the mean excitation; with the rule `ttc`, it is
# the time to contact in seconds, and there is no excitation. `n_sp` is the number of frames in a
# row that raise an alarm. The other columns are those of `score` and `score_stops`.
Row = dict[str, Any]


@dataclass(eq=False, repr=False)
class Evaluation(Outcome):
    """All rows, those of all videos first, and the curves and the lead times of each candidate.

    It has a curve for `all` videos and for each kind. The lead times, in seconds, are those at the
    default threshold, or, for a baseline, at the best one; NaN for collisions that are not
    detected. `rules` has the horizon, and the allowed rate of false alarms. `candidates` has the
    models and their signals, and `labels` is the file of the labels. `stops` has what stops are
    worth in rendered flights, by video, `answer` how an alarm is answered, and `stop_curves` the
    false stops a minute and the share of drones that are saved, at every threshold.
    """

    RECORD = "evaluate.yaml"
    TABLES = ("evaluate.csv", "curves.csv", "alarms.csv", "ttc.csv")
    STEM = "evaluate-{}"
    FIGURES = {  # noqa: RUF012
        "trade-off": "evaluation.trade_off",
        "leads": "evaluation.leads",
        "stops": "evaluation.trade_off",
        "ttc": "evaluation.times_to_contact",
    }

    candidates: Candidates
    rows: list[Row]
    curves: dict[str, dict[str, scoring.Curve]]
    leads_s: dict[str, Series]
    rules: Mapping[str, Any]
    labels: Path
    stops: Mapping[str, stopping.Stops] = field(default_factory=dict)
    stop_curves: Mapping[str, tuple[Series, Series]] = field(default_factory=dict)
    answer: Mapping[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        first = self.rows[0]
        form = "{model} recall {recall:.2f}, {false_alarms_per_min:.2f} false/min"
        said = "; ".join(form.format(**self.main(label)) for label in self.curves)
        return f"<Evaluation on {first['videos']} videos, {first['collisions']} collisions: {said}>"

    @property
    def curve_table(self) -> Table:
        """The rows of curves.csv: each model's recall and false alarms at every threshold."""
        return table_of(*self.cells()["curves.csv"])

    @property
    def alarm_table(self) -> Table:
        """The rows of alarms.csv: every alarm that counts, and every missed collision."""
        return table_of(*self.cells()["alarms.csv"])

    @property
    def ttc_table(self) -> Table:
        """The rows of ttc.csv: how good the estimated times to contact are."""
        return table_of(*self.cells()["ttc.csv"])

    @property
    def failed(self) -> dict[str, str]:
        """Why videos are left out, by name."""
        return self.candidates.failed

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """Why the exit code is 1: some videos could not be scored."""
        return left_out(self.failed, len(self.candidates.cases))

    def plot(self, kind: str | None = None, width: Literal["one", "two"] = "one") -> "Figure":  # type: ignore[override]
        """A figure: `trade-off` of recall and false alarms, `leads`, `stops`, or `ttc`.

        `width` is in columns. Raises ParameterError if there is no such figure; `stops` are those
        of rendered flights, and `ttc` needs estimates of the time to contact before a collision.
        """
        if kind in (empty := self._empty_figures()):
            raise ParameterError("", empty[kind])
        return super().plot(kind, width=width)

    def figure_names(self) -> dict[str, str]:
        """Kind of each figure that shows something -> file name without suffix."""
        empty = self._empty_figures()
        return {kind: name for kind, name in super().figure_names().items() if kind not in empty}

    def _empty_figures(self) -> dict[str | None, str]:
        """Why figures have nothing to show, by their kinds."""
        empty: dict[str | None, str] = {}
        if not self._has_drones:
            empty["stops"] = "no video is a rendered flight with a collision to stop for"
        if not self._ttc_rows():
            empty["ttc"] = "no model estimates the time to contact before a collision"
        return empty

    @property
    def _has_drones(self) -> bool:
        """Whether there are rendered flights with a collision that a stop could avoid."""
        return any(flight.can_stop for flight in self.stops.values())

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The lead times and the horizon, or the curves, their points, and the allowed rate."""
        if kind == "leads":
            at = {label: self.main(label)["at"] for label in self.leads_s}
            shown = {f"{k}, {at[k]} threshold": leads_s for k, leads_s in self.leads_s.items()}
            return shown, self.rules["horizon_s"]
        if kind == "stops":
            rows = {label: self.row(label, DEFAULT) for label in self.stop_curves}
            at = {k: (r["unneeded_per_min"], r["saved"]) for k, r in rows.items() if r is not None}
            return self.stop_curves, at, None, ("False stops per minute", "Drones saved")
        if kind == "ttc":
            errors: dict[str, list[list[float]]] = {}
            for label, low, high, *_, middle, most, _, _ in self._ttc_rows():
                errors.setdefault(label, []).append([(low + high) / 2, middle, most])
            return ({label: np.array(rows).T for label, rows in errors.items()},)
        curves, points = {}, {}
        for label, own in self.curves.items():
            for name, line in own.items():
                title = label if name == ALL else f"{label}, {name}"
                if not self.main(label, kind=name)["collisions"] and name != ALL:
                    continue  # nothing to detect
                curves[title] = line.false_alarms_per_min, line.recall
                row = self.row(label, DEFAULT, kind=name)
                if row is not None:
                    points[title] = row["false_alarms_per_min"], row["recall"]
        return curves, points, self.rules["max_false_per_min"]

    def record_text(self) -> str:
        """The text of evaluate.yaml."""
        candidates = self.candidates.by_label.values()
        record = {
            "labels": str(self.labels.absolute()),
            **self.counts(),
            **self.rules,
            **self.answer,
            "models": [_described(candidate) for candidate in candidates],
            "options": next(iter(candidates)).record.get("options", {}),
        }
        return record_text(record, [])

    def row(self, label: str, at: str, **group: str) -> Row | None:
        """The row of a candidate and threshold, of all videos or of a group, or None."""
        wanted = {"model": label, "at": at, **dict.fromkeys(GROUPED, ALL), **group}
        return next((r for r in self.rows if all(r[word] == wanted[word] for word in _WORDS)), None)

    def main(self, label: str, **group: str) -> Row:
        """The row at the default threshold, or, for a baseline, at the best one."""
        row = self.row(label, DEFAULT, **group) or self.row(label, BEST, **group)
        assert row is not None
        return row

    def differences(self) -> dict[str, dict[str, tuple[float, float, float]]]:
        """Recall and false alarms a minute of each further model less those of the first one.

        At the default thresholds and on the same videos, each with its interval, see
        `scoring.differences`. Baselines, which have no default, are left out.
        """
        horizon_s, candidates = self.rules["horizon_s"], self.candidates
        tallies = {
            label: [
                scoring.tally(signal, candidate.n_sp, candidate.threshold[1], horizon_s)
                for signal in candidates.signals(label)
            ]
            for label, candidate in candidates.by_label.items()
            if candidate.threshold is not None
        }
        first, *others = tallies or [""]
        return {label: scoring.differences(tallies[label], tallies[first]) for label in others}

    def names(self, word: str) -> list[str]:
        """The groups by target, kind or manner but `all`, in the order of the rows."""
        return list(dict.fromkeys(row[word] for row in self.rows if row[word] != ALL))

    def counts(self) -> dict[str, Any]:
        """Numbers of videos, collisions and minutes, and the videos that failed."""
        signals = self.candidates.signals(self.rows[0]["model"])
        return {
            "videos": len(self.candidates.cases),
            "collisions": sum(len(case.collisions) for case in self.candidates.cases),
            "minutes": round(sum(signal.minutes for signal in signals), 3),
            "failed": dict(self.failed),
        }

    def cells(self) -> dict[str, Any]:
        """Columns and rows: scores by model, threshold and group of videos, and the others."""
        return {
            "evaluate.csv": ([*self.rows[0]], [[*row.values()] for row in self.rows]),
            "curves.csv": (CURVE_COLUMNS, self._curve_rows()),
            "alarms.csv": (ALARM_COLUMNS, self._alarm_rows()),
            "ttc.csv": (TTC_COLUMNS, self._ttc_rows()),
        }

    def _ttc_rows(self) -> list[list[Any]]:
        """The rows of ttc.csv."""
        labels = self.candidates.by_label
        return list(ttc_rows({label: self.candidates.signals(label) for label in labels}))

    def _curve_rows(self) -> Iterator[list[Any]]:
        """The rows of curves.csv: the points of every curve at which a measure changes."""
        every = [(label, *item) for label, own in self.curves.items() for item in own.items()]
        for label, kind, points in every:
            measures = points.recall, points.false_alarms_per_min, points.lead_s
            stopped = self.stop_curves.get(label) if kind == ALL else None
            rate, saved = stopped or (np.full_like(points.recall, np.nan),) * 2
            columns = np.stack([*measures, saved, rate])
            changes = (np.diff(np.nan_to_num(columns, nan=-1.0)) != 0.0).any(axis=0)
            for i in np.flatnonzero(np.concatenate(([True], changes))):
                strength, candidate = float(points.threshold[i]), self.candidates.by_label[label]
                at = candidate.rule_name, candidate.level(strength), candidate.excitation(strength)
                yield [label, kind, *at, *columns[:, i].tolist()]

    def _alarm_rows(self) -> Iterator[list[Any]]:
        """The rows of alarms.csv: every alarm that is not ignored, and every missed collision.

        The outcome of a collision is that of one row alone: of the first hit, of the alarm that
        stops the drone without a hit, or of a row for the collision that is missed.
        """
        for case in self.candidates.cases:
            for label, candidate in self.candidates.by_label.items():
                row, signal = self.main(label), candidate.signals[case.name]
                judged = signal, candidate.n_sp, candidate.strength_of(row), self.rules["horizon_s"]
                rows: list[list[Any]] = []
                announced, stops = set(), self.stops.get(case.name)
                for number, kind in scoring.alarms(*judged):
                    time_s, lead_s, fate = float(signal.time_s[number]), math.nan, ""
                    if kind == scoring.HIT:
                        contact_s = min(at_s for at_s in signal.contacts_s if at_s > time_s)
                        lead_s = contact_s - time_s
                        fate = "" if contact_s in announced else DETECTED
                        announced.add(contact_s)
                    if kind != scoring.IGNORED:
                        frame = number if signal.frame is None else int(signal.frame[number])
                        worth = stopping.stop_cells(stops, time_s)
                        rows.append([frame, time_s, scoring.KINDS[kind], lead_s, *worth, fate])
                stop_s = None if stops is None else stopping.stop_time(*judged)
                for frame, contact_s in zip(case.collisions, signal.contacts_s, strict=True):
                    if contact_s in announced:
                        continue
                    saved, impact, left, _ = stopping.stop_cells(stops, stop_s)
                    if saved == 1.0 and stop_s is not None:
                        max(row for row in rows if row[1] <= stop_s)[-1] = SAVED
                    else:
                        cells = math.nan, saved, impact, left, math.nan
                        rows.append([frame, contact_s, MISSED, *cells, MISSED])
                at = row["at"], row["rule"]
                yield from ([case.name, label, *at, *cells] for cells in sorted(rows))

    def facts(self) -> dict[str, Any]:
        """What --json prints."""
        folder = str(self.paths[0].parent) if self.paths else None
        return {"result": folder, **self.counts(), "models": self.to_json()}

    def shown(self) -> Iterator[Shown]:
        """The tables: all videos and each kind, then hits and false alarms by group; the files."""
        header = ("rule", "threshold", "recall", "false/min", "precision", "lead time s")
        names = ("recall", "false_alarms_per_min", "precision", "lead_s", "lead_p10_s", "auc")
        kinds = self.names("kind")
        rows = [
            (
                row["model"],
                *((row["kind"],) if kinds else ()),
                row["rule"],
                _threshold_text(row),
                *(interval_text(row, name) for name in names),
                str(row["at_contact"]),
            )
            for row in self.rows
            if row["target"] == row["manner"] == row["speed"] == ALL
        ]
        yield ("model", *(("kind",) if kinds else ()), *header, "10 %", "AUC", "late"), rows
        first = self.rows[0]
        yield (
            f"{counted(first['videos'], 'video')}, {counted(first['collisions'], 'collision')}, "
            f"{first['minutes']:.2f} minutes before contact or the end."
        )
        if against := self.differences():
            yield f"Less {next(iter(self.candidates.by_label))}, on the same videos (95 %):"
            cells = [
                (label, *(difference_text(*bounds) for bounds in own.values()))
                for label, own in against.items()
            ]
            yield ("model", "recall", "false/min"), cells
        if self._has_drones:
            yield from stopping.shown_stops(self)
        for word in ("target", "manner"):
            yield from self._shown_by(word)
        yield from self.paths

    def _shown_by(self, word: str) -> Iterator[Shown]:
        """The hits and false alarms by target or manner, if there are any."""
        lines = []
        for name in self.names(word):
            mains = [self.main(label, **{word: name}) for label in self.curves]
            cells = [
                f"{'{hits}/{collisions}'.format(**row) if row['collisions'] else '–'}, "
                f"{row['false_alarms_per_min']:.1f}"
                for row in mains
            ]
            lines.append((name, str(mains[0]["videos"]), *cells))
        if lines:
            title = "scenario" if word == "manner" else word
            yield f"Collisions detected, and false alarms per minute, by {title}:"
            yield (title, "videos", *self.curves), lines

    def to_json(self) -> dict[str, Any]:
        """The measures of every candidate over all videos, by label; None where undefined."""

        def facts(row: Row) -> dict[str, Any]:
            at = {key: row[key] for key in ("at", "rule", "n_sp")}
            at["threshold"] = defined(row["threshold"])
            return at | scores_json(row)

        by_label: dict[str, dict[str, Any]] = {}
        against = self.differences()
        for label in self.candidates.by_label:
            row, best = self.main(label), self.row(label, BEST)
            by_label[label] = facts(row)
            if best is not None and best is not row:
                by_label[label]["best"] = facts(best)
            if label in against:
                by_label[label]["difference"] = {
                    "to": next(iter(self.candidates.by_label)),
                    **{name: list(map(defined, bounds)) for name, bounds in against[label].items()},
                }
            by_label[label]["recall_by_target"] = {
                target: defined(self.main(label, target=target)["recall"])
                for target in sorted(self.names("target"))
            }
            for word in ("kind", "manner", "speed"):
                by_label[label][f"by_{word}"] = {
                    name: scores_json(self.main(label, **{word: name})) for name in self.names(word)
                }
        return by_label


def groups(
    cases: Sequence[Case], stops: Mapping[str, stopping.Stops] | None = None
) -> dict[tuple[str, str], dict[int, Flags]]:
    """For each group, its videos by number, and flags of the collisions in the group.

    The keys are by what the videos are grouped, and the group's name: `all` first, then the groups
    of targets, kinds, manners and, in rendered flights, speeds in whole m/s. A kind, manner or
    speed that all videos have is no group.
    """
    every = {target for case in cases for target in case.targets}
    chosen = {ALL: every}
    if WALL in every and every - {WALL, ""}:
        chosen[WITHOUT_WALLS] = every - {WALL}
    chosen |= {target: {target} for target in sorted(every - {""})}
    members = {
        ("target", name): {
            i: case.of_target(targets)
            for i, case in enumerate(cases)
            if targets.intersection(case.targets)
        }
        for name, targets in chosen.items()
    }
    stops = stops or {}
    speeds = [f"{stops[c.name].speed_m_s:.0f} m/s" if c.name in stops else "" for c in cases]
    words = {word: [getattr(case, word) for case in cases] for word in ("kind", "manner")}
    for word, names in {**words, "speed": speeds}.items():
        for name in sorted({*names} - {""}) if len({*names}) > 1 else ():
            members[word, name] = {
                i: np.ones(len(cases[i].collisions), np.bool_)
                for i, own in enumerate(names)
                if own == name
            }
    return members


def evaluated(
    candidates: Candidates,
    rules: Mapping[str, Any],
    labels: Path,
    stops: Mapping[str, stopping.Stops],
    answer: Mapping[str, Any],
) -> Evaluation:
    """Score every candidate on its videos, of which there is at least one.

    The allowed rate of false alarms is that on all videos, or on those of one kind; raises
    ParameterError if there are none. In the flights that `stops` has, stops for a real obstacle are
    not false.
    """
    horizon_s = rules["horizon_s"]
    rows: list[Row] = []
    curves: dict[str, dict[str, scoring.Curve]] = {}
    leads_s: dict[str, Series] = {}
    stop_curves: dict[str, tuple[Series, Series]] = {}
    cases = candidates.cases
    flights = [(i, stops[case.name]) for i, case in enumerate(cases) if case.name in stops]
    for candidate in candidates.by_label.values():
        candidate.signals |= {name: own.on(candidate.signals[name]) for name, own in stops.items()}
    members, counted = groups(cases, stops), of_kind(cases, rules["max_false_kind"])
    for label, candidate in candidates.by_label.items():
        signals, n_sp = candidates.signals(label), candidate.n_sp
        levels = scoring.thresholds(signals, n_sp, horizon_s)
        every = [scoring.tally(signal, n_sp, levels, horizon_s) for signal in signals]
        curves[label] = {
            name: scoring.curve([every[i] for i in own], levels)
            for (word, name), own in members.items()
            if word == "kind" or name == ALL
        }
        if stops:
            of_levels = n_sp, levels, horizon_s
            flown = [stopping.tally_stops(signals[i], f, *of_levels) for i, f in flights]
            stop_curves[label] = stopping.stop_curve(flown)
        whole = scoring.curve(every, levels, counted)
        place = whole.best(rules["max_false_per_min"])
        # Where no threshold detects anything, the best one is never reached.
        best = float(levels[place]) if whole.recall[place] > 0.0 else math.inf
        default = {} if candidate.threshold is None else {DEFAULT: candidate.threshold}
        for name, (level, at) in {**default, BEST: (candidate.level(best), best)}.items():
            tallies = [scoring.tally(signal, n_sp, at, horizon_s) for signal in signals]
            judged = n_sp, at, horizon_s
            stopped = {i: stopping.tally_stops(signals[i], f, *judged) for i, f in flights}
            leads_s.setdefault(label, np.concatenate([counts.lead_s[:, 0] for counts in tallies]))
            for (word, group), wanted in members.items():
                chosen = [tallies[i].only(flags) for i, flags in wanted.items()]
                own = {"model": label, "at": name, **dict.fromkeys(GROUPED, ALL), word: group}
                excitation = candidate.excitation(at)
                at_level = {
                    "rule": candidate.rule_name,
                    "threshold": level,
                    "excitation": excitation,
                }
                worth = stopping.score_stops([stopped[i] for i in wanted if i in stopped])
                fates = [
                    ~np.isnan(counts.lead_s[:, 0]) | (i in stopped and stopped[i].saved[0])
                    for i, counts in zip(wanted, chosen, strict=True)
                ]
                share = float(np.mean(np.concatenate(fates))) if worth["drones"] else math.nan
                worth[stopping.SAVED_OR_DETECTED] = share
                rows.append({**own, **at_level, "n_sp": n_sp, **scoring.score(chosen), **worth})
    rows.sort(key=lambda row: any(row[word] != ALL for word in GROUPED))
    return Evaluation(candidates, rows, curves, leads_s, rules, labels, stops, stop_curves, answer)


def scores_json(scores: scoring.Scores) -> dict[str, Any]:
    """The measures, their intervals and the counts as JSON values."""
    intervals = {name: (scores[f"{name}_low"], scores[f"{name}_high"]) for name in scoring.MEASURES}
    return {
        **{name: defined(scores[name]) for name in scoring.MEASURES},
        "intervals": {name: list(map(defined, bounds)) for name, bounds in intervals.items()},
        **{name: scores[name] for name in scoring.COUNTS},
        # A calibration closes no loop.
        **{k: defined(scores[k]) for k in stopping.MEASURES if k in scores},
    }


def _threshold_text(row: Row) -> str:
    """The threshold of a row with its unit, for tables."""
    if not math.isfinite(row["threshold"]):
        return f"{row['at']}: none"
    threshold = threshold_text(row["threshold"])
    return f"{row['at']} {rule_named(row['rule']).with_unit(threshold)}"


def defined(value: float) -> float | None:
    """The value, or None if it is not finite: JSON has no number for it."""
    return value if math.isfinite(value) else None


def interval_text(scores: scoring.Scores, name: str) -> str:
    """A measure with its interval, for tables."""
    value, low, high = (scores[f"{name}{end}"] for end in ("", "_low", "_high"))
    if math.isnan(value):
        return "–"
    return f"{value:.2f}" if math.isnan(low) else f"{value:.2f} ({low:.2f}–{high:.2f})"


def difference_text(value: float, low: float, high: float) -> str:
    """A difference with its interval, for tables."""
    return "–" if math.isnan(value) else f"{value:+.2f} ({low:+.2f} to {high:+.2f})"


def left_out(failed: Mapping[str, str], n_scored: int) -> DlgmdError | None:
    """The error if some videos could not be scored."""
    if not failed:
        return None
    why = f"{len(failed)} of {len(failed) + n_scored} videos could not be scored and are left out"
    return DlgmdError("", why, "Fix or remove them, then run again.")


def _described(candidate: Candidate) -> dict[str, Any]:
    label, params, processed = candidate.label, candidate.params, candidate.record["processed"]
    size = {key: processed[key] for key in ("width", "height", "cells") if key in processed}
    if params is None:
        return {"label": label, "n_sp": candidate.n_sp, **size}
    return {"label": label, "model": params.model, **params.to_dict(), **size}
