"""The threshold with the highest recall of labelled contacts, as a preset.

The best choice has the highest recall at an allowed rate of false alarms. Performance is estimated
by cross-validation: the videos are split into folds, and each fold is scored with the choice that
is best on the other folds. The preset has the choice that is best on all videos.
"""

from __future__ import annotations

import os
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from dlgmd_cli import __version__
from dlgmd_cli.errors import (
    DlgmdError,
    ParameterError,
    ResultError,
    argument,
    counted,
    printable,
    warn,
)
from dlgmd_cli.frame import Flags
from dlgmd_cli.models.rules import Spikes, rule_of
from dlgmd_cli.parameters.checks import Spec, refuse
from dlgmd_cli.parameters.facts import Json, Value, finite, for_json, stating
from dlgmd_cli.parameters.keys import Parameters
from dlgmd_cli.results import scoring, store, tradeoff
from dlgmd_cli.results.csv import Cell, Table, table_of
from dlgmd_cli.results.labels import ALL, Case, groups, read_cases
from dlgmd_cli.results.names import difference_text
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import yaml_text
from dlgmd_cli.results.scoring import Differences, Scores, Signal, Tally
from dlgmd_cli.tasks.call import (
    RULE_ARGUMENTS,
    ModelName,
    Progress,
    Request,
    Setup,
    fold,
    no_progress,
    require_measured,
)
from dlgmd_cli.tasks.evaluate.candidates import Candidates, add_all, left_out, run_cases
from dlgmd_cli.tasks.evaluate.evaluate import false_per_min
from dlgmd_cli.tasks.evaluate.tables import false_text, hits_text

# The seed of the split into folds.
_SEED = 0
# Options that a preset keeps: how a frame is prepared, not which part of a video is read.
_KEPT = ("scale", "size", "fps", "repeats")
_FOLDS = Spec(int, 2, 1000)
# A corrected p-value below this one is a difference.
_SIGNIFICANT = 0.05


class Choice(NamedTuple):
    """A threshold of the strength, see `Rule.strength`, and the frames in a row that reach it."""

    n_sp: int
    threshold: float

    def tally(self, signal: Signal) -> Tally:
        """Judge a signal's alarms with this choice."""
        return scoring.tally(signal, self.n_sp, self.threshold)


# The choice on all videos, then for each fold the choice on all other folds.
Choices = tuple[Choice, ...]


@stating(RULE_ARGUMENTS)
def calibrate(
    labels: str | os.PathLike[str],
    model: ModelName | None = None,
    *,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    max_false_per_min: float = 1.0,
    folds: int = 5,
    name: str = "calibrated",
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> Calibration:
    """Find the threshold with the highest recall of contacts, as `dlgmd calibrate` does.

    Parameters
    ----------
    labels, max_false_per_min, jobs, progress
        As in `evaluate`.
    model, formulation, param
        The initial model, as in `run`. Calibration keeps the rule of its alarms.
    folds : int
        Number of folds of the cross-validation over videos.
    name, out, formats, overwrite
        Write the preset to ``out/name.yaml``, for ``model=``, and the figure beside it in
        `formats`; an earlier one is replaced only if `overwrite`.
    options
        Options of the input, as in `run`.

    Returns
    -------
    Calibration
        `params` are the calibrated parameters, and `preset` is the text of the file. `scores` has
        the performance, also on held-out videos, and `verdict` says whether it is better than
        before. `run` and `evaluate` take `setup` as a model, with the width and the rate that the
        model is designed for.

    Raises
    ------
    ResultError
        If the labels cannot be read, or fewer than two videos have a collision.
    ParameterError, SourceError, OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `evaluate`.

    Examples
    --------
    >>> found = calibrate("flights/labels.csv", 9, out="best")  # doctest: +SKIP
    >>> run("flight.mp4", "best/calibrated.yaml")  # doctest: +SKIP
    """
    if not name.strip(". ") or Path(name).name != name:
        why = f"{argument('name')}: {printable(name)!r} is not the name of a file"
        raise ParameterError("", why)
    request = fold(model, formulation, param, options)
    require_measured(request.setups, options)
    found = {name: options.get(name) for name in ("threshold", "speed_m_s")}
    refuse(found, "has no effect: calibrate finds the threshold")
    rule = rule_of(request.setup.params)
    rule.tuned(rule.strength_at(rule.threshold), rule.n_in_a_row)  # raises if it cannot be tuned
    if request.options.normalise == "sequence" and rule.uses_level:
        why = f"{argument('normalise', 'sequence')} leaves no threshold to calibrate"
        raise ParameterError("", why, f"Add {argument('normalise', 'absolute')}.")
    max_false_per_min = false_per_min(max_false_per_min)
    n_folds = _FOLDS.check(folds, argument("folds"))
    labels, formats = Path(labels), store.known_formats(formats)
    cases = read_cases(labels)
    request = request.for_any_of(case.path for case in cases)
    with ExitStack() as opened:
        if out is not None:
            store.refuse_existing(Path(out) / f"{name}.yaml", overwrite=overwrite)
            claim = opened.enter_context(store.claimed(Path(out)))
        candidates = Candidates()
        add_all(candidates, labels, cases, run_cases(cases, request, jobs), progress)
        _require_contacts(candidates.cases, labels)
        judged = max_false_per_min, n_folds, name, labels.name
        calibration = calibrated(candidates, request, *judged)
        if out is not None:
            calibration.write(claim, calibration.files(formats))
    return calibration


def _require_contacts(cases: Sequence[Case], labels: Path) -> None:
    """Raise ResultError if fewer than two videos have a contact; log a warning if few have."""
    n_with = sum(bool(case.collisions) for case in cases)
    if n_with < 2:
        why = f"{counted(n_with, 'video')} with a contact; calibration needs at least 2"
        raise ResultError(str(labels), why)
    if n_with < 20:
        warn(f"only {n_with} videos have a contact; the calibration may not generalise")


def calibrated(
    candidates: Candidates, request: Request, allowed: float, n_folds: int, name: str, labels: str
) -> Calibration:
    """Choose and score the best threshold for the model of a request; `name` is the new name."""
    before, cases = request.setup, candidates.cases
    signals, rule = candidates.signals(before.label), rule_of(before.params)
    folds = fold_of([(bool(c.collisions), c.labels[0].kind) for c in cases], n_folds)
    best, *choices = choose_thresholds(signals, folds, allowed, rule.counts)
    original = Choice(rule.n_in_a_row, rule.strength_at(rule.threshold))
    params = rule.tuned(best.threshold, best.n_sp)
    written = Choice(best.n_sp, rule_of(params).strength_at(rule_of(params).threshold))
    hits = [scoring.score([one.tally(s) for s in signals])["recall"] for one in (best, written)]
    if not min(hits) > 0.0:  # rounded, a threshold may detect what the best one does not
        why = f"no threshold detects a contact at {allowed:g} false alarms per minute"
        hint = f"Check the labels, or raise {argument('max_false_per_min')}."
        raise ResultError(labels, why, hint)
    tallies = {
        "held_out": [choices[fold].tally(one) for one, fold in zip(signals, folds, strict=True)],
        "same_videos": [best.tally(signal) for signal in signals],
        "before": [original.tally(signal) for signal in signals],
    }
    scores = {
        scored: {
            group: scoring.score([counts[i] for i in members])
            for (word, group), members in groups(cases).items()
            if word == "kind" or group == ALL
        }
        for scored, counts in tallies.items()
    }
    return Calibration(
        setup=replace(before, params=params, label=name),
        before=before,
        options=request.options.to_record(),
        choices=tuple(choices),
        scores=scores,
        max_false_per_min=allowed,
        labels=labels,
        failed=candidates.failed,
        against=scoring.score_differences({name: tallies["held_out"]}, tallies["before"])[name],
    )


@dataclass(eq=False, repr=False)
class Calibration(Outcome):
    """A calibrated model and its scores.

    Attributes
    ----------
    setup : Setup
        The model with the parameters that are best on all videos, for `run` and `evaluate`.
    before : Setup
        The initial model.
    options : dict
        The options by which videos were read, as in a record.
    choices : tuple of Choice
        For each fold, the choice on the other folds.
    scores : dict of str to dict of str to Scores
        Scores on `all` videos and on each kind. `held_out`: each fold with the choice on the other
        folds. `same_videos`: the final parameters on the videos that they were chosen on.
        `before`: the initial parameters.
    max_false_per_min : float
        The allowed rate of false alarms.
    labels : str
        The name of the file of the labels.
    failed : dict of str to str
        The reasons why videos are left out, by name.
    against : dict of str to Difference
        Recall and false alarms per minute on held-out videos minus those of the initial parameters.
    """

    setup: Setup
    before: Setup
    options: dict[str, Value]
    choices: Choices
    scores: dict[str, dict[str, Scores]]
    max_false_per_min: float
    labels: str
    failed: Mapping[str, str]
    against: Differences

    FIGURES = {"verdict": "evaluation.verdict"}  # noqa: RUF012

    def __repr__(self) -> str:
        form = "held out recall {recall:.2f}, {false_alarms_per_min:.2f} false/min"
        held = form.format(**self.scores["held_out"][ALL])
        return f"<Calibration of {self.before.label}: {', '.join(self.changes())}; {held}>"

    @property
    def params(self) -> Parameters:
        """The calibrated parameters; `setup` also has the width that they are designed for."""
        return self.setup.params

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """The error behind the exit code 1: some videos could not be scored."""
        return left_out(self.failed, int(self.scores["before"][ALL]["videos"]))

    @property
    def table(self) -> Table:
        """The scores, one row for each set of videos and its kind."""
        rows: list[list[Cell]] = [
            [word, kind, *scores.values()]
            for word, kinds in self.scores.items()
            for kind, scores in kinds.items()
        ]
        return table_of((("scored", "kind", *self.scores["before"][ALL])), rows)

    def changes(self) -> list[str]:
        """Every setting that was changed, as ``kappa = 0.003``."""
        before = self.before.settings()
        return [f"{k} = {v}" for k, v in self.setup.settings().items() if v != before.get(k)]

    @property
    def preset(self) -> str:
        """The YAML of a file for `config`; its comments state the videos and the scores."""
        held = self.scores["held_out"][ALL]
        kinds = {kind: own for kind, own in self.scores["held_out"].items() if kind != ALL}
        lines = [
            f"Calibrated by dlgmd {__version__} on {printable(self.labels)}: "
            f"{counted(int(held['videos']), 'video')}, "
            f"{counted(int(held['contacts']), 'contact')}, {held['minutes']:.2f} minutes.",
            f"Highest recall with at most {self.max_false_per_min:g} false alarms per minute.",
            f"Calibrated: {rule_of(self.params).calibrated}.",
            f"Held out ({len(self.choices)} folds): {_sentence(held)}.",
            *(f"Held out, {printable(kind)}: {_sentence(own)}." for kind, own in kinds.items()),
            self.verdict,
            f"On the same videos, optimistic: {_sentence(self.scores['same_videos'][ALL])}.",
        ]
        kept = {key: value for key, value in self.options.items() if key in _KEPT}
        document = {**self.setup.settings(), **({"options": kept} if kept else {})}
        return yaml_text(document, "".join(f"# {line}\n" for line in lines))

    @property
    def verdict(self) -> str:
        """Whether held-out scores are better than before and keep the allowed false alarm rate."""
        recall, rate = self.against["recall"], self.against["false_alarms_per_min"]
        gains = [sign * d.value for sign, d in ((1, recall), (-1, rate)) if d.p < _SIGNIFICANT]
        is_better, is_worse = any(gain > 0.0 for gain in gains), any(gain < 0.0 for gain in gains)
        compared = "not clearly different from"
        if is_better != is_worse:
            compared = "better than" if is_better else "worse than"
        held, limit = self.scores["held_out"][ALL]["false_alarms_per_min"], self.max_false_per_min
        keeps = "keeps" if held <= limit else "misses"
        return (
            f"Held out, it is {compared} {printable(self.before.label)}: recall "
            f"{difference_text(*recall)}; false alarms per minute {difference_text(*rate)}. "
            f"It {keeps} the limit: {held:.2f} of {limit:g}."
        )

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The scores before and held out, and the allowed rate."""
        titles = {"held out": "held_out", f"before ({self.before.label})": "before"}
        scores = {title: self.scores[key][ALL] for title, key in titles.items()}
        return scores, self.max_false_per_min

    def figure_names(self) -> dict[str, str]:
        """The figure's name: the preset's."""
        return {"verdict": self.setup.label}

    def tables(self) -> dict[str, store.Write]:
        """The function that writes the preset, NAME.yaml."""
        return {f"{self.setup.label}.yaml": store.file_of(self.preset)}

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output."""
        rule = rule_of(self.params)
        chosen = [rule.chosen(choice.threshold, choice.n_sp) for choice in self.choices]
        return {
            "preset": next((str(path) for path in self.paths if path.suffix == ".yaml"), None),
            "verdict": self.verdict,
            "parameters": for_json(self.setup.settings()),
            **{key: _json(scores) for key, scores in self.scores.items()},
            "folds": [{name: finite(value) for name, value in own.items()} for own in chosen],
            "failed": self.failed,
        }

    def shown(self) -> Iterator[Shown]:
        """The scores, the calibrated parameters, and the path of the preset."""
        names = {
            "held_out": f"held out ({len(self.choices)} folds)",
            "same_videos": "on the same videos, optimistic",
            "before": f"before ({self.before.label})",
        }
        rows = [
            (
                title if kind == ALL else f"  {kind}",
                *(hits_text(scores), false_text(scores)),
            )
            for key, title in names.items()
            for kind, scores in self.scores[key].items()
        ]
        yield ("", "recall", "false alarms in minutes: rate"), rows
        yield f"Calibrated: {', '.join(self.changes()) or 'the same parameters as before'}."
        yield self.verdict
        yield from self.paths


def _json(scores: Mapping[str, Scores]) -> dict[str, Json]:
    """The scores on all videos and on each kind, as JSON values."""
    by_kind = {kind: scoring.scores_json(one) for kind, one in scores.items() if kind != ALL}
    return {**scoring.scores_json(scores[ALL]), **({"by_kind": by_kind} if by_kind else {})}


def _sentence(scores: Scores) -> str:
    """The measures with their 95 % intervals, in words."""
    return f"recall {hits_text(scores)}, false alarms in minutes: rate {false_text(scores)}"


def fold_of(sorts: Sequence[Hashable], n_folds: int) -> list[int]:
    """The fold of each video; videos with and without a collision are spread evenly."""
    rng, n_dealt = np.random.default_rng(_SEED), 0
    folds = np.zeros(len(sorts), int)
    n_folds = min(n_folds, len(sorts))
    for sort in sorted({*sorts}, reverse=True):  # type: ignore[type-var]
        members = rng.permutation([i for i, other in enumerate(sorts) if other == sort])
        folds[members] = (n_dealt + np.arange(len(members))) % n_folds
        n_dealt += len(members)
    return folds.tolist()


def choose_thresholds(
    signals: Sequence[Signal],
    folds: Sequence[int],
    max_false_per_min: float,
    counts: Sequence[int] = Spikes.counts,
) -> Choices:
    """Make the best choice on all signals, and for each fold on all other folds.

    `counts` are the numbers of frames in a row to try. Of equally good choices, the choice with the
    fewest frames in a row wins.
    """
    tables = {}
    for n_sp in counts:
        at = tradeoff.thresholds(signals, n_sp)
        tables[n_sp] = at, [scoring.tally(signal, n_sp, at) for signal in signals]

    def best(chosen: Flags) -> Choice:
        choices = {}
        for n_sp, (at, tallies) in tables.items():
            scored = tradeoff.curve([tallies[i] for i in np.flatnonzero(chosen)], at)
            place = scored.best(max_false_per_min)
            choices[scored.rank(place), -n_sp] = Choice(n_sp, float(at[place]))
        return choices[max(choices)]

    of_videos = np.asarray(folds)
    every = best(of_videos >= 0)
    return every, *(best(of_videos != fold) for fold in range(max(folds) + 1))
