"""Calibrate a model on labelled videos: its thresholds alone, or with a search of parameters."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.lab.evaluation.cases import Case, run_cases, signal_of, strength_at
from dlgmd_cli.lab.evaluation.crossvalidation import (
    Choice,
    Choices,
    Rules,
    choose,
    fold_of,
    score_held_out,
    score_same_videos,
    with_choice,
)
from dlgmd_cli.lab.evaluation.measures import Scores, count, score
from dlgmd_cli.lab.evaluation.scoring import Signal
from dlgmd_cli.lab.evaluation.search import Trial, best_trial, with_values
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.options import InputOptions


@dataclass(frozen=True)
class Experiment:
    """The model to calibrate, the labelled videos, and how they are read; equal in all trials."""

    setup: Setup
    options: InputOptions
    rules: Rules
    cases: tuple[Case, ...]
    jobs: int

    @cached_property
    def folds(self) -> list[int]:
        """The fold of each video."""
        return fold_of([bool(case.collisions) for case in self.cases], self.rules)

    def signals(self, setup: Setup) -> list[Signal]:
        """Run a setup over all videos; returns their signals."""
        by_name = {}
        jobs = max(1, min(self.jobs, len(self.cases)))
        for case, results in run_cases(self.cases, [setup], self.options, jobs):
            if isinstance(results, DlgmdError):
                raise results
            by_name[case.name] = signal_of(results[0], case)
        return [by_name[case.name] for case in self.cases]

    def choose(self, setup: Setup, signals: Sequence[Signal] | None = None) -> Choices:
        """Choose on all signals of a setup, and without each fold; it is run if none are given."""
        return choose(signals or self.signals(setup), self.folds, self.rules)


@dataclass(frozen=True)
class Calibration:
    """A calibrated model and its scores.

    Attributes
    ----------
    setup : Setup
        The model with the parameters that do best on all videos.
    choices : tuple of Choice
        For each fold, the choice made without it.
    scores : dict of str to Scores
        `held_out`: each fold with the choice made without it. `same_videos`: the final parameters
        on the videos that they were chosen on. `before`: the original parameters.
    """

    setup: Setup
    choices: tuple[Choice, ...]
    scores: dict[str, Scores]


def calibrate_thresholds(experiment: Experiment, signals: Sequence[Signal]) -> Calibration:
    """Calibrate the thresholds of a model from its signals."""
    found = experiment.choose(experiment.setup, signals)
    of_folds = [signals] * len(found.of_folds)
    return _result(
        experiment, experiment.setup, found.overall, signals, found.of_folds, of_folds, signals
    )


def calibrate_by_search(
    experiment: Experiment, before: Sequence[Signal], trials: Sequence[Trial]
) -> Calibration:
    """Calibrate by the best of at least one trial, on all videos and without each fold.

    The models of the best trials run once more. `before` has the signals of the original model.
    """
    best = best_trial(trials)
    winners = [best_trial(trials, fold) for fold in range(len(best.found.of_folds))]
    ran: dict[str, list[Signal]] = {}
    for one in (best, *winners):
        if str(one.values) not in ran:
            ran[str(one.values)] = experiment.signals(with_values(experiment.setup, one.values))
    choices = tuple(one.found.of_folds[fold] for fold, one in enumerate(winners))
    of_folds = [ran[str(one.values)] for one in winners]
    setup, own = with_values(experiment.setup, best.values), ran[str(best.values)]
    return _result(experiment, setup, best.found.overall, own, choices, of_folds, before)


def _result(
    experiment: Experiment,
    setup: Setup,
    overall: Choice,
    signals: Sequence[Signal],
    choices: tuple[Choice, ...],
    of_folds: Sequence[Sequence[Signal]],
    before: Sequence[Signal],
) -> Calibration:
    """Score the final choice, the choices of the folds, and the original parameters."""
    rules, old = experiment.rules, experiment.setup.params
    at = strength_at(old.t_mp, old.kappa)
    scores = {
        "held_out": score_held_out(of_folds, experiment.folds, choices, rules),
        "same_videos": score_same_videos(signals, overall, rules),
        "before": score([count(one, old.n_sp, at, rules.horizon_s) for one in before]),
    }
    return Calibration(replace(setup, params=with_choice(setup.params, overall)), choices, scores)
