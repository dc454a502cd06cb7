"""Scores of alarms on labelled videos, by model, threshold and group of videos."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import DlgmdError, ParameterError, argument, counted
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.own_rules import Stored
from dlgmd_cli.models.stopping import BRAKES, Brake, brake_of, speed_of
from dlgmd_cli.parameters.checks import Spec, in_argument, refuse
from dlgmd_cli.parameters.facts import Json, Value, finite, stating
from dlgmd_cli.results import roc, scoring, store, tradeoff
from dlgmd_cli.results.csv import Cell, Cells, Table, table_of
from dlgmd_cli.results.files import FIGURE_FORMATS
from dlgmd_cli.results.labels import ALL, GROUPED, VideoGroup, groups, read_cases
from dlgmd_cli.results.names import difference_text
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import record_text
from dlgmd_cli.results.scoring import OUTCOMES, Differences, Tally, scores_json
from dlgmd_cli.results.tradeoff import Curve
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import RULE_ARGUMENTS, ModelName, ModelNames, Progress, no_progress
from dlgmd_cli.tasks.evaluate import tables
from dlgmd_cli.tasks.evaluate.benchmark import Benchmark, score_benchmark
from dlgmd_cli.tasks.evaluate.candidates import (
    Candidate,
    Candidates,
    Stopping,
    add_all,
    flow_setup,
    left_out,
    run_cases,
    stored_results,
)
from dlgmd_cli.tasks.evaluate.tables import BEST, DEFAULT, Row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# The columns that say which model, threshold and group a row of scores belongs to.
_WORDS = ("model", "at", *GROUPED)
# Of fewer contacts, the curves of recall over false alarms are steps that say nothing.
_MIN_CONTACTS = 10
_RATE = Spec(float, 0, math.inf)


@stating(RULE_ARGUMENTS)
def evaluate(
    labels: str | os.PathLike[str],
    model: ModelName | ModelNames | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    results: str | os.PathLike[str] | None = None,
    max_false_per_min: float = 1.0,
    speed_m_s: float | None = None,
    react: float = 0.1,
    brake: str | float | None = None,
    tilt: float | None = None,
    jerk: float | None = None,
    baselines: bool = True,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Evaluation | Benchmark:
    """Score alarms against labelled contacts; `dlgmd evaluate --help` has the rules.

    Parameters
    ----------
    labels : str or path
        A CSV with the columns ``video,collision_frame``, paths relative to it; ``approach_start``,
        ``speed_m_s``, ``brake``, ``fov``, ``camera_tilt``, ``target``, ``kind`` and ``manner`` are
        optional.
        True distances in the folder ``truth`` beside the CSV can justify an alarm. Or the
        ``annotations.json`` of the LGMD benchmark: responses are scored, not alarms.
    model, formulation, param
        The models, as in `run`. Their labels include the parameters in `param`.
    results : str or path, optional
        Score the results of `batch` in this folder instead of running models.
    max_false_per_min : float
        Greatest number of false alarms per minute that the best threshold may have.
    speed_m_s : float, optional
        The speed at every contact, in place of the speeds in the labels.
    react, brake, tilt, jerk : float or str
        Who brakes, `react` seconds after the alarm, as `models.stopping.Brake.parse` reads it:
        ``"arducopter:20"`` (unless given), ``"px4"``, ``"1.7s"``, a deceleration in m/s². Or a
        controller of one's own, with a `tilt` in degrees (25) and a `jerk` in m/s³ (8).
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
    Evaluation, or Benchmark for annotations
        `table`, `curve_table`, `alarm_table` and `ttc_table` are structured arrays with the columns
        of the files. `plot` draws figures, and `save` writes all files. `failed` has the videos
        that are left out, with the reasons.

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
    labels, formats = Path(labels), store.known_formats(formats)
    if labels.suffix.lower() == ".json":
        of_alarms = {"results": results, "speed_m_s": speed_m_s, "brake": brake}
        of_alarms |= {"tilt": tilt, "jerk": jerk, "react": react != 0.1}
        of_alarms |= {"max_false_per_min": max_false_per_min != 1.0}
        refuse(of_alarms, "has no effect on annotations, which say nothing of alarms")
        with ExitStack() as opened:
            if out is not None:
                names = Benchmark.own_files(formats)
                place = store.claimed(Path(out), Benchmark.RECORD, names=names, overwrite=overwrite)
                claim = opened.enter_context(place)
            asked = model, formulation, param, options
            found = score_benchmark(labels, *asked, jobs=jobs, progress=progress)
            if out is not None:
                found.write(claim, found.files(formats, dpi, width=width))
        return found
    max_false_per_min = false_per_min(max_false_per_min)
    speed = None if speed_m_s is None else speed_of(speed_m_s)
    stopping = Stopping(
        brake_of(brake, react, tilt, jerk),
        speed,
        for_all=(brake, tilt, jerk) != (None, None, None),
    )
    if results is not None:
        given = {"model": model, "param": param, "formulation": formulation, "jobs": jobs}
        refuse({**given, **options}, "does not work with results, which are there already")
    cases = read_cases(labels)
    every = [label for case in cases for label in case.labels]
    has_speed = speed is not None or any(label.speed_m_s for label in every)
    has_brake = stopping.brake != Brake() or any(label.brake for label in every)
    if has_brake and not has_speed:
        why = "who brakes, and how, has no effect: no contact has a speed"
        raise ParameterError("", why, f"Add {argument('speed_m_s')}, or a column speed_m_s.")
    with ExitStack() as opened:
        if out is not None:
            names = Evaluation.own_files(formats)
            place = store.claimed(Path(out), Evaluation.RECORD, names=names, overwrite=overwrite)
            claim = opened.enter_context(place)
        if results is not None:
            outcomes = stored_results(Path(results), cases)
        else:
            param = call.with_rule(param, options.pop("alarm", None))
            request = call.fold(model, formulation, param, options)
            request = request.for_any_of(case.path for case in cases)
            setups = call.with_folder_labels(call.with_keys(request.setups, param))
            for setup in setups:
                create_model(setup.params)  # raises now if a custom model cannot be created
            setups += [flow_setup()] if baselines else []
            outcomes = run_cases(cases, replace(request, setups=tuple(setups)), jobs)
        candidates = Candidates(stopping, baselines=baselines)
        add_all(candidates, labels, cases, outcomes, progress)
        evaluation = Evaluation(candidates, max_false_per_min, labels)
        if out is not None:
            evaluation.write(claim, evaluation.files(formats, dpi, width=width))
    return evaluation


def false_per_min(allowed: float) -> float:
    """The allowed number of false alarms per minute, checked; raises ParameterError."""
    with in_argument("max_false_per_min"):
        return float(_RATE.check(allowed))


@dataclass(eq=False, repr=False)
class Evaluation(Outcome):
    """The scores of an evaluation, as `evaluate` returns them.

    Attributes
    ----------
    candidates : Candidates
        The models and baselines, and their signals.
    max_false_per_min : float
        Greatest number of false alarms per minute that the best threshold may have.
    labels : Path
        The file of the labels.
    rows : list of Row
        The rows of evaluate.csv; the rows of `all` videos come first.
    curves : dict of str to dict of str to Curve
        The curves of each candidate: of `all` videos, and of each kind.
    separations : dict of str to dict of str to Separation
        How well each candidate's signal separates `frames` before a contact from others, and
        `videos` with a contact from others.
    """

    RECORD = "evaluate.yaml"
    TABLES = ("evaluate.csv", "curves.csv", "alarms.csv", "ttc.csv", roc.AUC, roc.ROC)
    STEM = "evaluate-{}"
    FIGURES = {  # noqa: RUF012
        "trade-off": "evaluation.trade_off",
        "leads": "evaluation.leads",
        "ttc": "evaluation.times_to_contact",
        "roc": "separation.curves",
    }

    candidates: Candidates
    max_false_per_min: float
    labels: Path
    rows: list[Row] = field(init=False, default_factory=list)
    curves: dict[str, dict[str, Curve]] = field(init=False, default_factory=dict)
    separations: roc.Separations = field(init=False)

    def __post_init__(self) -> None:
        """Score every candidate on its videos, at least one."""
        members = groups(self.candidates.cases)
        for label, candidate in self.candidates.by_label.items():
            strengths = {BEST: self._best(candidate, members)}
            if (rule := candidate.rule) is not None:
                strengths = {DEFAULT: rule.strength_at(rule.threshold), **strengths}
            if isinstance(rule, Stored):  # its alarms are known, and no other threshold's
                del strengths[BEST]
            for at, strength in strengths.items():
                tallies = self._tallies(label, strength)
                self.rows.extend(tables.score_rows(candidate, at, strength, tallies, members))
        self.rows.sort(key=lambda row: any(row[word] != ALL for word in GROUPED))
        self.separations = roc.separations(
            {
                label: [roc.judged(signal) for signal in self.candidates.signals(label)]
                for label in self.candidates.by_label
            }
        )

    def _best(self, candidate: Candidate, members: Mapping[VideoGroup, Iterable[int]]) -> float:
        """Draw the curves of a candidate; returns the strength at the best threshold."""
        levels = tradeoff.thresholds(self.candidates.signals(candidate.label), candidate.n_sp)
        tallies = self._tallies(candidate.label, levels)
        self.curves[candidate.label] = curves = {ALL: tradeoff.curve(tallies, levels)}
        for (word, name), numbers in members.items():
            if word == "kind":
                curves[name] = tradeoff.curve([tallies[i] for i in numbers], levels)
        place = curves[ALL].best(self.max_false_per_min)
        # If no threshold has a hit, the best threshold is infinite: no signal reaches it.
        return float(levels[place]) if curves[ALL].recall[place] > 0.0 else math.inf

    def _tallies(self, label: str, at: npt.ArrayLike) -> list[Tally]:
        """The alarms of a candidate in each video, at one or several thresholds."""
        n_sp = self.candidates.by_label[label].n_sp
        return [scoring.tally(signal, n_sp, at) for signal in self.candidates.signals(label)]

    def __repr__(self) -> str:
        first = self.rows[0]
        form = "{model} recall {recall:.2f}, {false_alarms_per_min:.2f} false/min"
        scores = "; ".join(form.format(**self.main(label)) for label in self.curves)
        return f"<Evaluation on {first['videos']} videos, {first['contacts']} contacts: {scores}>"

    @property
    def curve_table(self) -> Table:
        """The rows of curves.csv: each model's recall and false alarms at every threshold."""
        return table_of(*self.cells()["curves.csv"])

    @property
    def alarm_table(self) -> Table:
        """The rows of alarms.csv: every onset, and every missed contact."""
        return table_of(*self.cells()["alarms.csv"])

    @property
    def ttc_table(self) -> Table:
        """The rows of ttc.csv: the errors of the estimated times to contact."""
        return table_of(*self.cells()["ttc.csv"])

    @property
    def failed(self) -> dict[str, str]:
        """The reasons why videos are left out, by the videos' names."""
        return self.candidates.failed

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """The error behind the exit code 1: some videos could not be scored."""
        return left_out(self.failed, len(self.candidates.cases))

    def row(self, label: str, at: str, **group: str) -> Row | None:
        """The row of a candidate and threshold, for all videos or a group; None if missing."""
        wanted = {"model": label, "at": at, **dict.fromkeys(GROUPED, ALL), **group}
        return next((r for r in self.rows if all(r[word] == wanted[word] for word in _WORDS)), None)

    def main(self, label: str, **group: str) -> Row:
        """The row at the default threshold, or, for a baseline, at the best threshold."""
        row = self.row(label, DEFAULT, **group) or self.row(label, BEST, **group)
        assert row is not None
        return row

    def differences(self) -> dict[str, Differences]:
        """Recall and false alarms per minute of each further model minus those of the first model.

        Models have their default thresholds and the same videos; each difference has its interval
        and its corrected p-value, see `scoring.score_differences`. Baselines, which have no
        default, are left out.
        """
        tallies = {
            label: self._tallies(label, candidate.strength_of(self.main(label)))
            for label, candidate in self.candidates.by_label.items()
            if candidate.rule is not None
        }
        if not tallies:
            return {}
        first, *others = tallies
        return scoring.score_differences(
            {label: tallies[label] for label in others}, tallies[first]
        )

    def names(self, word: str) -> list[str]:
        """The groups by target, kind or manner, without `all`, in the order of the rows."""
        return list(dict.fromkeys(row[word] for row in self.rows if row[word] != ALL))

    def counts(self) -> dict[str, Json]:
        """Numbers of videos, contacts and minutes, and the videos that failed."""
        first = self.rows[0]
        counts = {name: first[name] for name in ("videos", "contacts")}
        return {**counts, "minutes": round(first["minutes"], 3), "failed": dict(self.failed)}

    def record_text(self) -> str:
        """The text of evaluate.yaml."""
        candidates, stopping = self.candidates.by_label.values(), self.candidates.stopping
        speed = {} if stopping.speed_m_s is None else {"speed_m_s": stopping.speed_m_s}
        record = {
            "labels": str(self.labels.absolute()),
            **self.counts(),
            "max_false_per_min": self.max_false_per_min,
            **speed,
            "brake": str(stopping.brake),
            "models": [candidate.described() for candidate in candidates],
            "options": next(iter(candidates)).record.get("options", {}),
        }
        return record_text(record)

    def cells(self) -> Cells:
        """Columns and rows of each table: scores by model, threshold and group, curves, alarms."""
        return {
            "evaluate.csv": ([*self.rows[0]], [[*row.values()] for row in self.rows]),
            "curves.csv": (tables.CURVE_COLUMNS, self._curve_rows()),
            "alarms.csv": (tables.SCORED_ALARM_COLUMNS, self._alarm_rows()),
            "ttc.csv": (tables.TTC_COLUMNS, self._ttc_rows()),
            **roc.cells(self.separations),
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
                for row in (self.row(label, at) for at in (DEFAULT, BEST)):
                    if row is not None:
                        said = case.name, label, row["at"], row["rule"]
                        alarms = tables.alarm_rows(case, candidate, candidate.strength_of(row))
                        yield from ([*said, *alarm] for alarm in alarms)

    def plot(self, kind: str | None = None, width: Literal["one", "two"] = "one") -> Figure:  # type: ignore[override]
        """A figure: `trade-off` of recall and false alarms, `leads`, or `ttc`.

        `width` is in columns of a paper. Raises ParameterError for another figure, for a trade-off
        of fewer than two contacts, and for `ttc` without any estimate of the time to contact before
        a contact.
        """
        if why := self._lacking(2).get(kind or next(iter(self.FIGURES))):
            raise ParameterError("", why)
        return super().plot(kind, width=width)

    def _lacking(self, min_contacts: int = _MIN_CONTACTS) -> dict[str, str]:
        """Kind of each figure that has not data enough -> why it is not drawn."""
        why = {}
        if self.rows[0]["contacts"] < min_contacts:
            why["trade-off"] = f"recall over false alarms needs {min_contacts} contacts"
        if not self._ttc_rows():
            why["ttc"] = "no model estimates the time to contact before a contact"
        if roc.table(self.separations) is None:
            why["roc"] = "the ROC needs frames before a contact, and others"
        return why

    def figure_names(self) -> dict[str, str]:
        """Kind of each figure that has data enough -> file name without suffix."""
        lacking = self._lacking()
        return {k: name for k, name in super().figure_names().items() if k not in lacking}

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The arguments of each kind of figure, see `plots.evaluation`."""
        if kind == "roc":
            return (self.separations,)
        if kind == "leads":
            leads_s = {}
            for label, candidate in self.candidates.by_label.items():
                row = self.main(label)
                tallies = self._tallies(label, candidate.strength_of(row))
                every = [np.where(t.is_hit, t.lead_s, np.nan)[:, 0] for t in tallies]
                name = "default threshold" if row["at"] == DEFAULT else "best (optimistic)"
                leads_s[f"{label}, {name}"] = np.concatenate(every)
            return (leads_s,)
        if kind == "ttc":
            errors: dict[str, list[list[float]]] = {}
            for label, low, high, *_, middle, most, _, _ in self._ttc_rows():
                errors.setdefault(label, []).append([(low + high) / 2, middle, most])
            return ({label: np.array(rows).T for label, rows in errors.items()},)
        lines, at = {}, {}
        for label, by_kind in self.curves.items():
            for name, line in by_kind.items():
                if self.main(label, kind=name)["contacts"] < 2:
                    continue  # a single step, or none
                title = label if name == ALL else f"{label}, {name}"
                lines[title] = line
                default = self.row(label, DEFAULT, kind=name)
                if default is not None:
                    at[title] = default["false_alarms_per_min"], default["recall"]
        return lines, at, self.max_false_per_min

    @property
    def _word(self) -> str:
        """The word for hits: in time, announced, or hits where contacts of both kinds occur."""
        cases = self.candidates.cases
        signals = self.candidates.signals(self.rows[0]["model"]) if cases else []
        sorts = {contact.has_speed for signal in signals for contact in signal.contacts}
        return "in time" if sorts == {True} else "announced" if sorts <= {False} else "hits"

    def shown(self) -> Iterator[Shown]:
        """The tables: all videos, the outcomes, differences, hits and false alarms by group."""
        of_all = [row for row in self.rows if all(row[word] == ALL for word in GROUPED)]
        rows = [
            (
                *(row["model"], row["rule"], tables.threshold_cell(row)),
                *(tables.hits_text(row), tables.false_text(row), f"{100 * row['in_alarm']:.1f} %"),
            )
            for row in of_all
        ]
        yield ("model", "rule", "threshold", self._word, "false/min", "in alarm"), rows
        videos, contacts = (counted(of_all[0][f"{one}s"], one) for one in ("video", "contact"))
        yield f"{videos}, {contacts}. False alarms: count in minutes: rate. In brackets: 95 %."
        if any(row["at"] == BEST for row in self.rows):
            yield "* The best threshold, chosen on these videos: its scores are optimistic."
        if self._word != "announced" or any(row["justified"] or row["told"] for row in of_all):
            yield from self._shown_outcomes(of_all)
        if against := self.differences():
            n, first = sum(map(len, against.values())), next(iter(self.candidates.by_label))
            yield f"Less {first}, paired by video (95 %; p by sign flips, {n} comparisons, Holm):"
            cells = [
                (label, *(difference_text(*bounds) for bounds in measures.values()))
                for label, measures in against.items()
            ]
            yield ("model", "recall", "false/min"), cells
        for word in GROUPED:
            yield from self._shown_by(word)
        if areas := roc.table(self.separations):
            yield "Separation of frames before a contact from others, and of videos with one:"
            yield areas
        if any(path.suffix[1:] in FIGURE_FORMATS for path in self.paths):
            yield from (f"Not drawn: {why}." for why in self._lacking().values())
        yield from self.paths

    def _title(self, label: str) -> str:
        """The label, with a star if the candidate is scored at the best threshold."""
        return label if self.main(label)["at"] == DEFAULT else f"{label} *"

    def _shown_outcomes(self, rows: Sequence[Row]) -> Iterator[Shown]:
        """The outcomes of the contacts, justified alarms, and contacts in time by who brakes."""
        names = [*reversed(OUTCOMES), "told", "justified"]
        brake = self.candidates.stopping.brake
        yield f"Contacts, those missed but told, and justified alarms; a stop has {brake}:"
        cells = [
            (row["model"], tables.threshold_cell(row), *(str(row[name]) for name in names))
            for row in rows
        ]
        yield ("model", "threshold", *(name.replace("_", " ") for name in names)), cells

        if self._word == "announced":
            return
        yield "In time by who brakes, and the threshold that the fastest contact needs:"
        cells = [
            (row["model"], tables.threshold_cell(row), *(tables.brake_text(row, k) for k in BRAKES))
            for row in rows
        ]
        yield ("model", "threshold", *(brake.text for brake in BRAKES.values())), cells

    def _shown_by(self, word: str) -> Iterator[Shown]:
        """Hits and false alarms of all models, grouped by target, kind or manner."""
        for title, of, text in (
            (self._word, "contacts", tables.hits_text),
            ("false alarms, minutes: rate", "minutes", tables.false_text),
        ):
            lines = []
            for name in self.names(word):
                mains = [self.main(label, **{word: name}) for label in self.curves]
                if mains[0][of]:
                    lines.append((name, *(text(row) for row in mains)))
            if lines:
                yield f"By {word}, {title} (95 %):"
                yield (word, *map(self._title, self.curves)), lines

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output."""
        folder = str(self.paths[0].parent) if self.paths else None
        return {"result": folder, **self.counts(), "models": self.to_json()}

    def to_json(self) -> dict[str, Json]:
        """The measures of every candidate over all videos, by label; None where undefined."""
        against = self.differences()
        return {label: self._json_of(label, against) for label in self.curves}

    def _json_of(self, label: str, against: Mapping[str, Differences]) -> dict[str, Json]:
        """The measures of a candidate, and their differences from the first model's."""
        row, best = self.main(label), self.row(label, BEST)
        facts = _json(row)
        if best is not None and best is not row:
            facts["best"] = _json(best)
        if measures := against.get(label):
            facts["difference"] = {
                "to": next(iter(self.curves)),
                **{name: [finite(value) for value in own[:3]] for name, own in measures.items()},
                "p": {name: own.p for name, own in measures.items()},
                "comparisons": sum(map(len, against.values())),
            }
        for word in GROUPED:
            mains = {name: self.main(label, **{word: name}) for name in self.names(word)}
            facts[f"by_{word}"] = {name: scores_json(row) for name, row in mains.items()}
        return {**facts, **roc.areas_json(self.separations[label])}


def _json(row: Row) -> dict[str, Json]:
    """A row as JSON values."""
    at = {key: row[key] for key in ("at", "rule", "n_sp")}
    needed = {f"threshold_{name}": finite(row[f"threshold_{name}"]) for name in BRAKES}
    return {**at, "threshold": finite(row["threshold"]), **scores_json(row), **needed}
