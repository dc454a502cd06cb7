"""Recall, false alarms and lead times on labelled collisions, by model, threshold and target."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, ParameterError, counted
from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.facts import Json, Value
from dlgmd_cli.results import scoring, store, tradeoff
from dlgmd_cli.results.csv import Cell, Cells, Table, table_of
from dlgmd_cli.results.labels import ALL, GROUPED, Group, groups, of_kind, read_cases
from dlgmd_cli.results.names import difference_text
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import record_text
from dlgmd_cli.results.scoring import Rules, Tally, defined, rules_of, scores_json
from dlgmd_cli.results.tradeoff import Curve
from dlgmd_cli.scenes.flights.braking import Brakes
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import ModelName, ModelNames, Progress, no_progress
from dlgmd_cli.tasks.evaluate import stopping, tables
from dlgmd_cli.tasks.evaluate.candidates import (
    Candidate,
    Candidates,
    flow_setup,
    left_out,
    run_cases,
    scored,
    stored_results,
)
from dlgmd_cli.tasks.evaluate.stopping import Stops
from dlgmd_cli.tasks.evaluate.tables import Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DEFAULT, BEST = "default", "best"
# What a row of scores is about.
_WORDS = ("model", "at", *GROUPED)
# The measures of all videos that a terminal shows, and those of the stops, by their titles.
_SHOWN = {
    "recall": "recall",
    "false/min": "false_alarms_per_min",
    "precision": "precision",
    "lead time s": "lead_s",
    "10 %": "lead_p10_s",
    "AUC": "auc",
}
_HEADLINE = {"saved or detected": tables.SAVED_OR_DETECTED}
_SHOWN_OF_STOPS = {
    **_HEADLINE,
    "recall": "recall",
    "saved": "saved",
    "false stops/min": "unneeded_per_min",
    "justified": "justified",
    "impact m/s": "impact_m_s",
    "left m": "stopped_m",
}


def evaluate(
    labels: str | os.PathLike[str],
    model: ModelName | ModelNames | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    engine: str | None = None,
    results: str | os.PathLike[str] | None = None,
    horizon: float = 1.0,
    max_false_per_min: float | str = 1.0,
    react: float = 0.1,
    brake: float | None = None,
    tilt: float | None = None,
    jerk: float | None = None,
    agile: bool | None = None,
    speed_m_s: float | str | None = None,
    baselines: bool = True,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Evaluation:
    """Score alarms against labelled collisions; `dlgmd evaluate --help` has the rules.

    Parameters
    ----------
    labels : str or path
        A CSV with the columns ``video,collision_frame``, paths relative to it; ``target``, ``kind``
        and ``manner`` are optional.
    model, formulation, param, engine
        The models, as in `run`. What `param` changes shows in their labels.
    results : str or path, optional
        Score the results of `batch` in this folder instead of running models.
    horizon : float
        An alarm up to so many seconds before a collision is a hit.
    max_false_per_min : float or str
        False alarms per minute that the best threshold may have; on the videos of one kind as
        ``"1:real"``.
    react : float
        How the pilot of a rendered flight answers an alarm: after so many seconds.
    brake : float, optional
        Deceleration in m/s², at once. Without it, the drone brakes as it can.
    tilt, jerk : float, optional
        How a stabilised drone brakes: its greatest tilt in degrees (25 unless given), and how fast
        the deceleration grows in m/s³ (8).
    agile : bool, optional
        Whether the drones lean at once, or as stabilised ones. Without it, as each does.
    speed_m_s : float or "true", optional
        Also score each model with the rule `ttc` with the `ttc_alarm` that a stop from this speed
        needs, and 0.2 s; as ``"true"``, from the speed that each rendered flight has at each frame.
    baselines : bool
        Also score the sum of P, and the expansion rate of tracked corners.
    jobs, progress
        As in `batch`.
    out : str or path, optional
        Write the tables, figures in `formats` (PNG with `dpi`, `width` in columns of a paper) and
        evaluate.yaml into this folder; `overwrite` replaces earlier ones.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Evaluation
        `table`, `curve_table`, `window_table`, `alarm_table` and `ttc_table` are structured arrays
        with the columns of the files; `plot` draws, and `save` writes them. `failed` says why
        videos are left out.

    Raises
    ------
    ResultError
        If the labels or the results cannot be read.
    SourceError
        If no video can be scored.
    ParameterError
        If a parameter or an option is not valid.
    OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `batch`.

    Examples
    --------
    >>> report = evaluate("flights/labels.csv", [9, "lgmd"])  # doctest: +SKIP
    >>> report.table[["model", "at", "recall", "false_alarms_per_min"]]  # doctest: +SKIP
    """
    rules = rules_of(horizon, max_false_per_min)
    brakes = stopping.brakes_of(react, brake, agile, tilt, jerk)
    speed = stopping.speed_of(speed_m_s, stopping.TRUE)
    of_models = {"model": model, "param": param, "formulation": formulation, "engine": engine}
    of_models |= {"jobs": jobs, **options}
    given = [name for name, value in of_models.items() if value is not None]
    if results is not None and given:
        why = f"{given[0]} does not work with results, which are there already"
        raise ParameterError("", why, "Leave it out.")
    labels, formats = Path(labels), store.known_formats(formats)
    cases = read_cases(labels)
    of_kind(cases, rules.max_false_kind)  # raises if there are none
    with ExitStack() as opened:
        if out is not None:
            names = Evaluation.own_files(formats)
            place = store.claimed(Path(out), Evaluation.RECORD, names=names, overwrite=overwrite)
            claim = opened.enter_context(place)
        if results is not None:
            outcomes = stored_results(Path(results), cases)
        else:
            request = call.fold(model, formulation, param, engine, options)
            setups = call.with_folder_labels(call.with_keys(request.setups, param or ()))
            for setup in setups:  # raises if an engine is not installed
                create_model(setup.params, engine=setup.engine)
            setups += [flow_setup()] if baselines else []
            outcomes = run_cases(cases, replace(request, setups=tuple(setups)), jobs)
        candidates = scored(labels, cases, outcomes, progress, baselines=baselines)
        stops = stopping.stops_of(candidates, brakes, jobs)
        if speed is not None:
            stopping.with_speed(candidates, stops, brakes, speed)
        evaluation = Evaluation(candidates, rules, labels, stops, brakes)
        if out is not None:
            evaluation.write(claim, evaluation.files(formats, dpi, width=width))
    return evaluation


@dataclass(eq=False, repr=False)
class Evaluation(Outcome):
    """What `evaluate` returns.

    Attributes
    ----------
    candidates : Candidates
        The models and baselines, and their signals.
    rules : Rules
    labels : Path
        The file of the labels.
    stops : dict of str to Stops
        What stops are worth in rendered flights, by video.
    brakes : Brakes
        How an alarm is answered there.
    rows : list of Row
        Those of all videos first.
    curves : dict of str to dict of str to Curve
        For each candidate, the curve of `all` videos, and of each kind.
    """

    RECORD = "evaluate.yaml"
    TABLES = ("evaluate.csv", "curves.csv", "windows.csv", "alarms.csv", "ttc.csv")
    STEM = "evaluate-{}"
    FIGURES = {  # noqa: RUF012
        "trade-off": "evaluation.trade_off",
        "roc": "evaluation.roc",
        "leads": "evaluation.leads",
        "stops": "evaluation.trade_off",
        "ttc": "evaluation.times_to_contact",
    }

    candidates: Candidates
    rules: Rules
    labels: Path
    stops: Mapping[str, Stops]
    brakes: Brakes
    rows: list[Row] = field(init=False, default_factory=list)
    curves: dict[str, dict[str, Curve]] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        """Score every candidate on its videos, of which there is at least one.

        The allowed rate of false alarms is that on all videos, or on those of one kind; raises
        ParameterError if there are none. Stops for a real obstacle are not false.
        """
        speeds_m_s = {name: flight.speed_m_s for name, flight in self.stops.items()}
        members = groups(self.candidates.cases, speeds_m_s)
        limited = of_kind(self.candidates.cases, self.rules.max_false_kind)
        for candidate in self.candidates.by_label.values():
            for name, flight in self.stops.items():
                candidate.signals[name] = flight.on(candidate.signals[name])
            best = self._best(candidate, members, limited)
            thresholds = {DEFAULT: candidate.threshold, BEST: (candidate.level(best), best)}
            for at, threshold in thresholds.items():
                if threshold is None:
                    continue
                tallies = self._tallies(candidate, threshold[1])
                flights = self._flights(tallies)
                self.rows.extend(
                    tables.score_rows(candidate, at, threshold, tallies, flights, members)
                )
        self.rows.sort(key=lambda row: any(row[word] != ALL for word in GROUPED))

    def _best(
        self, candidate: Candidate, members: Mapping[Group, Iterable[int]], limited: Flags
    ) -> float:
        """Draw the curves of a candidate; returns the strength at the best threshold."""
        signals = self.candidates.signals(candidate.label)
        levels = tradeoff.thresholds(signals, candidate.n_sp, self.rules.horizon_s)
        tallies = self._tallies(candidate, levels)
        self.curves[candidate.label] = curves = {}
        for (word, name), numbers in members.items():
            if word == "kind" or name == ALL:
                chosen = [tallies[i] for i in numbers]
                curves[name] = tradeoff.with_band(tradeoff.curve(chosen, levels), chosen)
        if self.stops:
            curves[ALL] = stopping.with_stops(curves[ALL], [*self._flights(tallies).values()])
        whole = tradeoff.curve(tallies, levels, limited)
        place = whole.best(self.rules.max_false_per_min)
        # Where no threshold detects anything, the best one is never reached.
        return float(levels[place]) if whole.recall[place] > 0.0 else math.inf

    def _tallies(self, candidate: Candidate, at: npt.ArrayLike) -> list[Tally]:
        """The alarms of each video, at one threshold or several."""
        signals, horizon_s = self.candidates.signals(candidate.label), self.rules.horizon_s
        return [scoring.tally(signal, candidate.n_sp, at, horizon_s) for signal in signals]

    def _flights(self, tallies: Sequence[Tally]) -> dict[int, tuple[Stops, Tally]]:
        """The rendered flights among the videos, by number, with their alarms."""
        stops = [self.stops.get(case.name) for case in self.candidates.cases]
        pairs = enumerate(zip(stops, tallies, strict=True))
        return {i: (flight, tally) for i, (flight, tally) in pairs if flight is not None}

    def __repr__(self) -> str:
        first = self.rows[0]
        form = "{model} recall {recall:.2f}, {false_alarms_per_min:.2f} false/min"
        scores = "; ".join(form.format(**self.main(label)) for label in self.curves)
        return (
            f"<Evaluation on {first['videos']} videos, {first['collisions']} collisions: {scores}>"
        )

    @property
    def curve_table(self) -> Table:
        """The rows of curves.csv: each model's recall and false alarms at every threshold."""
        return table_of(*self.cells()["curves.csv"])

    @property
    def window_table(self) -> Table:
        """The rows of windows.csv: each model's score in the windows that make the AUC."""
        return table_of(*self.cells()["windows.csv"])

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
        tallies = {
            label: self._tallies(candidate, candidate.threshold[1])
            for label, candidate in self.candidates.by_label.items()
            if candidate.threshold is not None
        }
        first, *others = tallies or [""]
        return {label: scoring.differences(tallies[label], tallies[first]) for label in others}

    def names(self, word: str) -> list[str]:
        """The groups by target, kind or manner but `all`, in the order of the rows."""
        return list(dict.fromkeys(row[word] for row in self.rows if row[word] != ALL))

    def counts(self) -> dict[str, Json]:
        """Numbers of videos, collisions and minutes, and the videos that failed."""
        signals = self.candidates.signals(self.rows[0]["model"])
        return {
            "videos": len(self.candidates.cases),
            "collisions": sum(len(case.collisions) for case in self.candidates.cases),
            "minutes": round(sum(signal.minutes for signal in signals), 3),
            "failed": dict(self.failed),
        }

    def record_text(self) -> str:
        """The text of evaluate.yaml."""
        candidates = self.candidates.by_label.values()
        record = {
            "labels": str(self.labels.absolute()),
            **self.counts(),
            **asdict(self.rules),
            "react_s": self.brakes.react_s,
            "brakes": stopping.brakes_text(self.brakes),
            "models": [candidate.described() for candidate in candidates],
            "options": next(iter(candidates)).record.get("options", {}),
        }
        return record_text(record, [])

    def cells(self) -> Cells:
        """Columns and rows: scores by model, threshold and group of videos, and the others."""
        horizon_s = self.rules.horizon_s
        return {
            "evaluate.csv": ([*self.rows[0]], [[*row.values()] for row in self.rows]),
            "curves.csv": (tables.CURVE_COLUMNS, self._curve_rows()),
            "windows.csv": (tables.WINDOW_COLUMNS, tables.window_rows(self.candidates, horizon_s)),
            "alarms.csv": (tables.ALARM_COLUMNS, self._alarm_rows()),
            "ttc.csv": (tables.TTC_COLUMNS, self._ttc_rows()),
        }

    def _ttc_rows(self) -> list[list[Any]]:
        """The rows of ttc.csv."""
        labels = self.candidates.by_label
        return list(tables.ttc_rows({label: self.candidates.signals(label) for label in labels}))

    def _curve_rows(self) -> Iterator[list[Cell]]:
        """The rows of curves.csv."""
        for label, by_kind in self.curves.items():
            for kind, curve in by_kind.items():
                points = tables.curve_rows(curve, self.candidates.by_label[label])
                yield from ([label, kind, *point] for point in points)

    def _alarm_rows(self) -> Iterator[list[Cell]]:
        """The rows of alarms.csv."""
        for case in self.candidates.cases:
            for label, candidate in self.candidates.by_label.items():
                row, stops = self.main(label), self.stops.get(case.name)
                judged = candidate.strength_of(row), self.rules.horizon_s
                alarms = tables.alarm_rows(case, candidate, stops, *judged)
                yield from ([case.name, label, row["at"], row["rule"], *alarm] for alarm in alarms)

    def plot(self, kind: str | None = None, width: Literal["one", "two"] = "one") -> Figure:  # type: ignore[override]
        """A figure: `trade-off` of recall and false alarms, `roc`, `leads`, `stops`, or `ttc`.

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
        if not self._drones():
            empty["stops"] = "no video is a rendered flight with a collision to stop for"
        if math.isnan(self.rows[0]["auc"]):
            empty["roc"] = "there is no window before a collision, or none elsewhere"
        if not self._ttc_rows():
            empty["ttc"] = "no model estimates the time to contact before a collision"
        return empty

    def _drones(self) -> list[Stops]:
        """The rendered flights with a collision that a stop could avoid."""
        return [flight for flight in self.stops.values() if flight.can_stop]

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """What each kind of figure takes, see `plots.evaluation`."""
        if kind == "leads":
            leads_s = {}
            for label, candidate in self.candidates.by_label.items():
                row = self.main(label)
                tallies = self._tallies(candidate, candidate.strength_of(row))
                every = np.concatenate([counts.lead_s[:, 0] for counts in tallies])
                leads_s[f"{label}, {row['at']} threshold"] = every
            return leads_s, self.rules.horizon_s
        if kind == "stops":
            whole = {label: by_kind[ALL] for label, by_kind in self.curves.items()}
            stops = {label: (line.unneeded_per_min, line.saved) for label, line in whole.items()}
            rows = {label: self.row(label, DEFAULT) for label in whole}
            at = {k: (r["unneeded_per_min"], r["saved"]) for k, r in rows.items() if r is not None}
            return stops, at, None, ("False stops per minute", "Drones saved")
        if kind == "roc":
            rocs = tables.rocs(self.candidates, self.rules.horizon_s)
            area = {label: self.main(label)["auc"] for label in self.curves}
            return ({f"{label}, AUC {area[label]:.2f}": line for label, line in rocs.items()},)
        if kind == "ttc":
            errors: dict[str, list[list[float]]] = {}
            for label, low, high, *_, middle, most, _, _ in self._ttc_rows():
                errors.setdefault(label, []).append([(low + high) / 2, middle, most])
            return ({label: np.array(rows).T for label, rows in errors.items()},)
        lines: dict[str, tuple[Series, ...]] = {}
        at = {}
        for label, by_kind in self.curves.items():
            for name, line in by_kind.items():
                title = label if name == ALL else f"{label}, {name}"
                if not self.main(label, kind=name)["collisions"] and name != ALL:
                    continue  # nothing to detect
                band = line.recall_low, line.recall_high
                lines[title] = line.false_alarms_per_min, line.recall, *band
                default = self.row(label, DEFAULT, kind=name)
                if default is not None:
                    at[title] = default["false_alarms_per_min"], default["recall"]
        return lines, at, self.rules.max_false_per_min

    def shown(self) -> Iterator[Shown]:
        """The tables: all videos and each kind, then hits and false alarms by group; the files."""
        has_kinds = bool(self.names("kind"))
        measures = {**(_HEADLINE if self._drones() else {}), **_SHOWN}
        rows = [
            (
                row["model"],
                *((row["kind"],) if has_kinds else ()),
                row["rule"],
                tables.threshold_cell(row),
                *(tables.measure_text(row, name) for name in measures.values()),
                str(row["at_contact"]),
            )
            for row in self.rows
            if row["target"] == row["manner"] == row["speed"] == ALL
        ]
        kind = ("kind",) if has_kinds else ()
        yield ("model", *kind, "rule", "threshold", *measures, "late"), rows
        first = self.rows[0]
        yield (
            f"{counted(first['videos'], 'video')}, {counted(first['collisions'], 'collision')}, "
            f"{first['minutes']:.2f} minutes before contact or the end."
        )
        if against := self.differences():
            yield f"Less {next(iter(self.candidates.by_label))}, on the same videos (95 %):"
            cells = [
                (label, *(difference_text(*bounds) for bounds in measures.values()))
                for label, measures in against.items()
            ]
            yield ("model", "recall", "false/min"), cells
        yield from self._shown_stops()
        for word, title in (("target", "target"), ("manner", "scenario")):
            yield from self._shown_by(
                word, title, "Collisions detected, 95 % interval", "recall", "collisions"
            )
            yield from self._shown_by(
                word, title, "False alarms per minute, 95 % interval", "false_alarms_per_min"
            )
        yield from self.paths

    def _shown_stops(self) -> Iterator[Shown]:
        """What the stops are worth, also by speed, if there are rendered flights."""
        speeds = [flight.speed_m_s for flight in self._drones()]
        if not speeds:
            return
        yield (
            f"Rendered flights: {counted(len(speeds), 'drone')} in which a stop avoids the "
            f"collision, at {min(speeds):.1f} to {max(speeds):.1f} m/s (median "
            f"{np.median(speeds):.1f}). Reaction {self.brakes.react_s:g} s, "
            f"{stopping.brakes_text(self.brakes)}."
        )
        lines = [
            (
                label,
                self.main(label)["at"],
                *(tables.measure_text(self.main(label), name) for name in _SHOWN_OF_STOPS.values()),
            )
            for label in self.curves
        ]
        yield ("model", "threshold", *_SHOWN_OF_STOPS), lines
        for word in ("speed", "target"):
            yield from self._shown_by(word, word, "Drones saved, 95 % interval", "saved", "drones")

    def _shown_by(
        self, word: str, title: str, text: str, measure: str, of: str = "minutes"
    ) -> Iterator[Shown]:
        """A measure of all models by a word of the groups, where there is some `of` it."""
        lines = []
        for name in self.names(word):
            mains = [self.main(label, **{word: name}) for label in self.curves]
            if mains[0][of]:
                number = f"{mains[0][of]:.3g}"
                lines.append((name, number, *(tables.measure_text(row, measure) for row in mains)))
        if lines:
            yield f"{text}, by {title}:"
            yield (title, of, *self.curves), lines

    def facts(self) -> dict[str, Json]:
        """What its JSON has."""
        folder = str(self.paths[0].parent) if self.paths else None
        return {"result": folder, **self.counts(), "models": self.to_json()}

    def to_json(self) -> dict[str, Json]:
        """The measures of every candidate over all videos, by label; None where undefined."""
        against = self.differences()
        return {label: self._json_of(label, against.get(label)) for label in self.curves}

    def _json_of(
        self, label: str, against: Mapping[str, tuple[float, float, float]] | None
    ) -> dict[str, Json]:
        """The measures of a candidate, and their differences from those of the first one."""
        row, best = self.main(label), self.row(label, BEST)
        facts = _json(row)
        if best is not None and best is not row:
            facts["best"] = _json(best)
        if against is not None:
            facts["difference"] = {
                "to": next(iter(self.curves)),
                **{name: [defined(value) for value in bounds] for name, bounds in against.items()},
            }
        facts["recall_by_target"] = {
            target: defined(self.main(label, target=target)["recall"])
            for target in sorted(self.names("target"))
        }
        for word in ("kind", "manner", "speed"):
            groups = {name: self.main(label, **{word: name}) for name in self.names(word)}
            facts[f"by_{word}"] = {
                k: scores_json(row, tables.OF_STOPS) for k, row in groups.items()
            }
        return facts


def _json(row: Row) -> dict[str, Json]:
    """A row as JSON values."""
    at = {key: row[key] for key in ("at", "rule", "n_sp")}
    return {**at, "threshold": defined(row["threshold"]), **scores_json(row, tables.OF_STOPS)}
