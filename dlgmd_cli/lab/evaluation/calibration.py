"""Choose the thresholds, and the values of a search, that announce labelled collisions best.

The best choice has the highest recall at an allowed rate of false alarms. Performance is estimated
by cross-validation: the videos are split into folds, and each fold is scored with the choice that
does best on the others. The preset has the choice that does best on all videos.
"""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.lab.evaluation.cases import Case, of_kind, run_cases, signal_of, strength_at
from dlgmd_cli.lab.evaluation.report import ALL, groups
from dlgmd_cli.lab.evaluation.scoring import Scores, Signal, Tally, curve, score, tally, thresholds
from dlgmd_cli.models.detection import Flags, absolute
from dlgmd_cli.parameters import Parameters
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.options import InputOptions

WIDTH = "width_px"
# Numbers of successive spikes that are tried.
N_SP = (1, 2, 3, 4)
# T_MP if the parameters have 0 or 1, at which no κ could be found.
_T_MP = 0.4
_DIGITS = 4


@dataclass(frozen=True)
class Choice:
    """A threshold, the number of successive spikes, and their rank, see `Curve.rank`."""

    n_sp: int
    threshold: float
    rank: tuple[float, float, float]


# The choice on all videos, then for each fold the choice on all others.
Choices = tuple[Choice, ...]


@dataclass(frozen=True)
class Trial:
    """The values of a trial, and the thresholds chosen with them."""

    values: dict[str, Any]
    found: Choices


@dataclass(frozen=True)
class Rules:
    """The criteria of a calibration.

    Attributes
    ----------
    horizon_s : float
        An alarm up to so many seconds before a collision announces it.
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


@dataclass(frozen=True)
class Experiment:
    """The model to calibrate, the labelled videos, and how they are read; equal in all trials."""

    setup: Setup
    options: InputOptions
    rules: Rules
    cases: tuple[Case, ...]
    jobs: int | None

    @cached_property
    def folds(self) -> list[int]:
        """The fold of each video."""
        return fold_of([(bool(case.collisions), case.kind) for case in self.cases], self.rules)

    @cached_property
    def counted(self) -> Flags:
        """The videos on which the rate of false alarms is limited."""
        return of_kind(self.cases, self.rules.max_false_kind)

    def signals(self, setup: Setup) -> list[Signal]:
        """Run a setup over all videos; returns their signals."""
        by_name = {}
        for case, results in run_cases(self.cases, [setup], self.options, self.jobs):
            if isinstance(results, DlgmdError):
                raise results
            by_name[case.name] = signal_of(results[setup.label], case)
        return [by_name[case.name] for case in self.cases]

    def choose(self, setup: Setup) -> Choices:
        """Run a setup over all videos, and choose its thresholds."""
        return choose(self.signals(setup), self.folds, self.rules, self.counted)


@dataclass(frozen=True, eq=False, repr=False)
class Calibration:
    """A calibrated model and its scores.

    Attributes
    ----------
    setup : Setup
        The model with the parameters that do best on all videos.
    choices : tuple of Choice
        For each fold, the choice made without it.
    scores : dict of str to dict of str to Scores
        On `all` videos and on each kind. `held_out`: each fold with the choice made without it.
        `same_videos`: the final parameters on the videos that they were chosen on. `before`: the
        original parameters.
    experiment : Experiment
        What it was calibrated on.
    preset : str
        The YAML of a file for `config`; comments say how well it does.
    failed : dict of str to str
        Why videos are left out, by name.
    """

    setup: Setup
    choices: Choices
    scores: dict[str, dict[str, Scores]]
    experiment: Experiment
    preset: str = ""
    failed: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        form = "held out recall {recall:.2f}, {false_alarms_per_min:.2f} false/min"
        held = form.format(**self.scores["held_out"][ALL])
        label = self.experiment.setup.label
        return f"<Calibration of {label}: {', '.join(self.changes())}; {held}>"

    @property
    def params(self) -> Parameters:
        """The parameters found, for `run` and `Alarm`."""
        return self.setup.params

    def changes(self) -> list[str]:
        """Every setting that was changed, as ``kappa = 0.003``."""
        before = self.experiment.setup.settings()
        return [f"{k} = {v}" for k, v in self.setup.settings().items() if v != before[k]]


def calibrate(
    experiment: Experiment, before: Sequence[Signal], trials: Sequence[Trial] = ()
) -> Calibration:
    """Calibrate the thresholds of a model, or choose the best of some trials.

    Models of the best trials, on all videos and without each fold, run once more. `before` has the
    signals of the original model.
    """
    rules, folds, old = experiment.rules, experiment.folds, experiment.setup.params
    trials = trials or [Trial({}, choose(before, folds, rules, experiment.counted))]
    best, *winners = (best_trial(trials, number) for number in range(max(folds) + 2))
    setups, signals = {}, {str({}): list(before)}
    for one in (best, *winners):
        key = str(one.values)
        setups[key] = with_values(experiment.setup, one.values)
        if key not in signals:
            signals[key] = experiment.signals(setups[key])
    overall = best.found[0]
    choices = tuple(one.found[number] for number, one in enumerate(winners, start=1))
    own, final = signals[str(best.values)], setups[str(best.values)]
    at = strength_at(old.t_mp, old.kappa)
    tallies = {
        "held_out": tally_held_out(
            [signals[str(one.values)] for one in winners], folds, choices, rules.horizon_s
        ),
        "same_videos": [tally_of(one, overall, rules.horizon_s) for one in own],
        "before": [tally(one, old.n_sp, at, rules.horizon_s) for one in before],
    }
    scores = {
        name: {
            group: score([found[i] for i in members])
            for (word, group), members in groups(experiment.cases).items()
            if word == "kind" or group == ALL
        }
        for name, found in tallies.items()
    }
    setup = replace(final, params=with_choice(final.params, overall))
    return Calibration(setup, choices, scores, experiment)


def with_values(setup: Setup, values: Mapping[str, Any]) -> Setup:
    """A setup with other values; raises ParameterError if they contradict each other."""
    own = {key: value for key, value in values.items() if key != WIDTH}
    width_px = values.get(WIDTH, setup.width_px)
    params: Parameters = replace(setup.params, **own)  # type: ignore[type-var]
    return replace(setup, params=params, width_px=width_px)


def best_trial(trials: Sequence[Trial], number: int = 0) -> Trial:
    """The trial whose choice of a number, see `Choices`, ranks highest."""
    return max(trials, key=lambda trial: trial.found[number].rank)


def fold_of(sorts: Sequence[Hashable], rules: Rules) -> list[int]:
    """The fold of each video; those of a sort (with or without a collision) are spread evenly."""
    rng, n_dealt = np.random.default_rng(rules.seed), 0
    found = np.zeros(len(sorts), int)
    n_folds = min(rules.folds, len(sorts))
    for sort in sorted({*sorts}, reverse=True):  # type: ignore[type-var]
        members = rng.permutation([i for i, own in enumerate(sorts) if own == sort])
        found[members] = (n_dealt + np.arange(len(members))) % n_folds
        n_dealt += len(members)
    return [int(one) for one in found]


def choose(
    signals: Sequence[Signal], folds: Sequence[int], rules: Rules, counted: Flags | None = None
) -> Choices:
    """Make the best choice on all signals, and for each fold on all others.

    Of equal choices, that with the fewest spikes. `counted`, (videos,) bool, tells the videos on
    which false alarms are limited.
    """
    tables = {}
    for n_sp in N_SP:
        at = thresholds(signals, n_sp, rules.horizon_s)
        tables[n_sp] = at, [tally(one, n_sp, at, rules.horizon_s) for one in signals]

    def best(chosen: Flags) -> Choice:
        found = []
        for n_sp, (at, tallies) in tables.items():
            own = None if counted is None else counted[chosen]
            one = curve([tallies[i] for i in np.flatnonzero(chosen)], at, own)
            place = one.best(rules.max_false_per_min)
            found.append(Choice(n_sp, float(at[place]), one.rank(place)))
        return max(found, key=lambda one: (one.rank, -one.n_sp))

    own = np.asarray(folds)
    return best(own >= 0), *(best(own != fold) for fold in range(max(folds) + 1))


def tally_held_out(
    signals: Sequence[Sequence[Signal]],
    folds: Sequence[int],
    choices: Choices,
    horizon_s: float,
) -> list[Tally]:
    """Count the alarms of each fold with the choice that was made without it.

    `signals` has, for each fold, the signals of all videos with the parameters chosen without it.
    """
    by_video = enumerate(folds)
    return [tally_of(signals[fold][i], choices[fold], horizon_s) for i, fold in by_video]


def tally_of(signal: Signal, choice: Choice, horizon_s: float) -> Tally:
    """Count a signal's alarms with a choice.

    The strength is divided by the choice's threshold, so that the AUC can compare folds.
    """
    unit = max(choice.threshold, np.finfo(np.float64).tiny)
    return tally(replace(signal, strength=signal.strength / unit), choice.n_sp, 1.0, horizon_s)


def with_choice(params: Parameters, choice: Choice) -> Parameters:
    """The parameters with the n_sp of a choice, and with κ to four digits, or T_MP without κ."""
    if params.kappa is None:
        t_mp = float(absolute(choice.threshold, 1, None))
        return replace(params, t_mp=min(t_mp, 1.0), n_sp=choice.n_sp)  # type: ignore[type-var]
    t_mp = params.t_mp if 0.0 < params.t_mp < 1.0 else _T_MP
    kappa = float(f"{choice.threshold / strength_at(t_mp, 1.0):.{_DIGITS}g}")
    spec = params.specs()["kappa"]
    kappa = min(max(kappa, spec.low), spec.high)
    return replace(params, kappa=kappa, t_mp=t_mp, n_sp=choice.n_sp)  # type: ignore[type-var]
