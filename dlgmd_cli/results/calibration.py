"""Choose thresholds, and values of a search, with the highest recall of labelled collisions.

The best choice has the highest recall at an allowed rate of false alarms. Performance is estimated
by cross-validation: the videos are split into folds, and each fold is scored with the choice that
does best on the others. The preset has the choice that does best on all videos.
"""

import math
from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dlgmd_cli import __version__
from dlgmd_cli.errors import DlgmdError, counted, printable
from dlgmd_cli.frame import Flags
from dlgmd_cli.models.rules import Spikes, rule_of
from dlgmd_cli.parameters.keys import Parameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Table, table_of
from dlgmd_cli.results.evaluation import ALL, defined, interval_text, left_out, scores_json
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import yaml_text
from dlgmd_cli.results.scoring import Scores, Signal, Tally, curve, tally, thresholds

WIDTH = "width_px"
_SHOWN = ("recall", "false_alarms_per_min", "lead_s", "auc")
# Options that a preset keeps: how a frame is prepared, not which part of a video is read.
_KEPT = ("scale", "size", "fps", "repeats")


@dataclass(frozen=True)
class Choice:
    """A threshold of the strength, see `Rule.strength`, the number of frames in a row that
    reach it, and their rank, see `Curve.rank`.
    """

    n_sp: int
    threshold: float
    rank: tuple[float, float, float]


# The choice on all videos, then for each fold the choice on all others.
Choices = tuple[Choice, ...]


@dataclass(frozen=True)
class Rules:
    """The criteria of a calibration.

    Attributes
    ----------
    horizon_s : float
        An alarm up to so many seconds before a collision is a hit.
    max_false_per_min : float
        Allowed rate of false alarms.
    max_false_kind : str or None
        Kind of the videos on which it is allowed; None for all.
    folds : int
        Number of folds of the cross-validation.
    seed : int
        Seed of the split into folds.
    """

    horizon_s: float = 1.0
    max_false_per_min: float = 1.0
    max_false_kind: str | None = None
    folds: int = 5
    seed: int = 0


@dataclass(eq=False, repr=False)
class Calibration(Outcome):
    """A calibrated model and its scores.

    Attributes
    ----------
    setup : Setup
        The model with the parameters that do best on all videos, for `run` and `evaluate`.
    before : Setup
        The model that it started from.
    options : dict
        How the videos were read, as a record has it.
    choices : tuple of Choice
        For each fold, the choice made without it.
    scores : dict of str to dict of str to Scores
        On `all` videos and on each kind. `held_out`: each fold with the choice made without it.
        `same_videos`: the final parameters on the videos that they were chosen on. `before`: the
        original parameters.
    rules : Rules
        The criteria.
    labels : str
        The name of the file of the labels.
    searched : str
        What was searched, in words.
    failed : dict of str to str
        Why videos are left out, by name.
    against : dict of str to (float, float, float)
        How much recall and false alarms a minute, held out, differ from those of the original
        parameters, and the bounds.
    """

    setup: Any
    before: Any
    options: dict[str, Any]
    choices: Choices
    scores: dict[str, dict[str, Scores]]
    rules: Rules
    labels: str
    searched: str
    failed: Mapping[str, str]
    against: Mapping[str, tuple[float, float, float]]

    FIGURES = {"verdict": "evaluation.verdict"}  # noqa: RUF012

    def __repr__(self) -> str:
        form = "held out recall {recall:.2f}, {false_alarms_per_min:.2f} false/min"
        held = form.format(**self.scores["held_out"][ALL])
        return f"<Calibration of {self.before.label}: {', '.join(self.changes())}; {held}>"

    @property
    def params(self) -> Parameters:
        """The calibrated parameters, without the width that they are made for; `setup` has it."""
        return self.setup.params

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """Why the exit code is 1: some videos could not be scored."""
        return left_out(self.failed, int(self.scores["before"][ALL]["videos"]))

    @property
    def table(self) -> Table:
        """The scores, one row for each set of videos and its kind."""
        rows = (
            [word, kind, *own.values()]
            for word, kinds in self.scores.items()
            for kind, own in kinds.items()
        )
        return table_of((("scored", "kind", *self.scores["before"][ALL])), rows)

    def changes(self) -> list[str]:
        """Every setting that was changed, as ``kappa = 0.003``."""
        before = self.before.settings()
        return [f"{k} = {v}" for k, v in self.setup.settings().items() if v != before[k]]

    @property
    def preset(self) -> str:
        """The YAML of a file for `config`; comments say on what and how well it does."""
        held = self.scores["held_out"][ALL]
        kinds = [(kind, own) for kind, own in self.scores["held_out"].items() if kind != ALL]
        rules, limited = self.rules, self.rules.max_false_kind
        where = f" on videos of the kind {printable(limited)}" if limited else ""
        lines = [
            f"Calibrated by dlgmd {__version__} on {printable(self.labels)}: "
            f"{counted(int(held['videos']), 'video')}, "
            f"{counted(int(held['collisions']), 'collision')}, {held['minutes']:.2f} minutes.",
            f"Highest recall with at most {rules.max_false_per_min:g} false alarms per "
            f"minute{where}.",
            f"Alarms up to {rules.horizon_s:g} s before a collision are hits.",
            f"Calibrated: {rule_of(self.params).calibrated}{self.searched}.",
            f"Held out ({len(self.choices)} folds): {_sentence(held)}.",
            *(f"Held out, {printable(kind)}: {_sentence(own)}." for kind, own in kinds),
            self.verdict,
            f"On the same videos: {_sentence(self.scores['same_videos'][ALL])}.",
        ]
        kept = {key: value for key, value in self.options.items() if key in _KEPT}
        document = {**self.setup.settings(), **({"options": kept} if kept else {})}
        return yaml_text(document, "".join(f"# {line}\n" for line in lines))

    @property
    def verdict(self) -> str:
        """Whether it is better than before, and keeps the allowed rate; both held out."""
        (recall, low, high), (rate, fewest, most) = (
            self.against[name] for name in ("recall", "false_alarms_per_min")
        )
        said = "not clearly different from"
        if low >= 0.0 >= most and (low > 0.0 or most < 0.0):
            said = "better than"
        if high <= 0.0 <= fewest and (high < 0.0 or fewest > 0.0):
            said = "worse than"
        limit, kind = self.rules.max_false_per_min, self.rules.max_false_kind
        held = self.scores["held_out"][kind or ALL]["false_alarms_per_min"]
        keeps = "keeps" if held <= limit else "misses"
        return (
            f"Held out, it is {said} {printable(self.before.label)}: recall {recall:+.2f} "
            f"({low:+.2f} to {high:+.2f}), {rate:+.2f} ({fewest:+.2f} to {most:+.2f}) false alarms "
            f"per minute. It {keeps} the limit: {held:.2f} of {limit:g}."
        )

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The scores before and held out, and the allowed rate."""
        own = self.rules.max_false_kind or ALL
        titles = {"held out": "held_out", f"before ({self.before.label})": "before"}
        scores = {title: self.scores[key][own] for title, key in titles.items()}
        return scores, self.rules.max_false_per_min

    def figure_names(self) -> dict[str, str]:
        """The figure's name, which is that of the preset."""
        return {"verdict": self.setup.label}

    def tables(self) -> dict[str, store.Write]:
        """The function that writes the preset, NAME.yaml."""
        return {f"{self.setup.label}.yaml": store.file_of(self.preset)}

    def facts(self) -> dict[str, Any]:
        """What --json prints."""
        rule = rule_of(self.params)
        chosen = [rule.chosen(choice.threshold, choice.n_sp) for choice in self.choices]
        return {
            "preset": next((str(path) for path in self.paths if path.suffix == ".yaml"), None),
            "verdict": self.verdict,
            "parameters": self.setup.settings(),
            **{key: _json(scores) for key, scores in self.scores.items()},
            "folds": [{name: defined(value) for name, value in own.items()} for own in chosen],
            "failed": self.failed,
        }

    def shown(self) -> Iterator[Shown]:
        """The scores, the calibrated parameters, and where the preset is."""
        names = {
            "held_out": f"held out ({len(self.choices)} folds)",
            "same_videos": "on the same videos",
            "before": f"before ({self.before.label})",
        }
        rows = [
            (title if kind == ALL else f"  {kind}", *(interval_text(own, name) for name in _SHOWN))
            for key, title in names.items()
            for kind, own in self.scores[key].items()
        ]
        yield ("", "recall", "false/min", "lead time s", "AUC"), rows
        yield f"Calibrated: {', '.join(self.changes()) or 'the same parameters as before'}."
        yield self.verdict
        yield from self.paths


def _json(scores: Mapping[str, Scores]) -> dict[str, Any]:
    """The scores of all videos, and of each kind, as JSON values."""
    by_kind = {kind: scores_json(own) for kind, own in scores.items() if kind != ALL}
    return {**scores_json(scores[ALL]), **({"by_kind": by_kind} if by_kind else {})}


def _sentence(scores: Scores) -> str:
    """The measures with their 95 % intervals, in words."""
    recall, rate, lead, auc = (interval_text(scores, name) for name in _SHOWN)
    return f"recall {recall}, {rate} false alarms per minute, median lead time {lead} s, AUC {auc}"


def fold_of(sorts: Sequence[Hashable], rules: Rules) -> list[int]:
    """The fold of each video; those of a sort (with or without a collision) are spread evenly."""
    rng, n_dealt = np.random.default_rng(rules.seed), 0
    folds = np.zeros(len(sorts), int)
    n_folds = min(rules.folds, len(sorts))
    for sort in sorted({*sorts}, reverse=True):  # type: ignore[type-var]
        members = rng.permutation([i for i, own in enumerate(sorts) if own == sort])
        folds[members] = (n_dealt + np.arange(len(members))) % n_folds
        n_dealt += len(members)
    return folds.tolist()


def choose(
    signals: Sequence[Signal],
    folds: Sequence[int],
    rules: Rules,
    counted: Flags | None = None,
    counts: Sequence[int] = Spikes.counts,
) -> Choices:
    """Make the best choice on all signals, and for each fold on all others.

    Of equal choices, that with the fewest frames in a row, of which numbers of them `counts` are
    tried. `counted`, (videos,) bool, tells the videos on which false alarms are limited.
    """
    tables = {}
    for n_sp in counts:
        at = thresholds(signals, n_sp, rules.horizon_s)
        tables[n_sp] = at, [tally(signal, n_sp, at, rules.horizon_s) for signal in signals]

    def best(chosen: Flags) -> Choice:
        choices = []
        for n_sp, (at, tallies) in tables.items():
            own = None if counted is None else counted[chosen]
            scored = curve([tallies[i] for i in np.flatnonzero(chosen)], at, own)
            place = scored.best(rules.max_false_per_min)
            choices.append(Choice(n_sp, float(at[place]), scored.rank(place)))
        return max(choices, key=lambda choice: (choice.rank, -choice.n_sp))

    own = np.asarray(folds)
    return best(own >= 0), *(best(own != fold) for fold in range(max(folds) + 1))


def tally_held_out(
    signals: Sequence[Sequence[Signal]], folds: Sequence[int], choices: Choices, horizon_s: float
) -> list[Tally]:
    """Count the alarms of each fold with the choice that was made without it.

    `signals` has, for each fold, the signals of all videos with the parameters chosen without it.
    """
    return [tally_of(signals[fold][i], choices[fold], horizon_s) for i, fold in enumerate(folds)]


def tally_of(signal: Signal, choice: Choice, horizon_s: float) -> Tally:
    """Count a signal's alarms with a choice.

    The strength is divided by the size of the choice's threshold, so that the AUC can compare
    folds; its sign stays.
    """
    unit = max(abs(choice.threshold), np.finfo(np.float64).tiny)
    scaled = replace(signal, strength=signal.strength / unit)
    return tally(scaled, choice.n_sp, math.copysign(1.0, choice.threshold), horizon_s)


def with_choice(params: Parameters, choice: Choice) -> Parameters:
    """The parameters with a choice, see `Rule.tuned`."""
    return rule_of(params).tuned(choice.threshold, choice.n_sp)
