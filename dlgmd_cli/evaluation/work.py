"""From labelled videos to calibrated parameters: with the model's own, or the best of a search."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.evaluation.calibration import (
    Calibration,
    Choice,
    Rules,
    calibrated,
    fold_of,
    held_out,
    on_the_same,
    with_choice,
)
from dlgmd_cli.evaluation.footage import Case, computed, course_of, strength_at
from dlgmd_cli.evaluation.measures import Scores, count, score
from dlgmd_cli.evaluation.scoring import Course
from dlgmd_cli.evaluation.search import Search, Trial, best_trial, with_values
from dlgmd_cli.runs.run import Setup
from dlgmd_cli.video.frames import InputOptions


@dataclass(frozen=True)
class Work:
    """What is the same for every trial: the model before, how videos are read, and which."""

    setup: Setup
    options: InputOptions
    rules: Rules
    cases: tuple[Case, ...]
    jobs: int

    @cached_property
    def folds(self) -> list[int]:
        """The fold that holds each video out."""
        return fold_of([bool(case.collisions) for case in self.cases], self.rules)

    def courses(self, setup: Setup) -> list[Course]:
        """What is thresholded of every video, with the parameters of a setup."""
        by_name = {}
        jobs = max(1, min(self.jobs, len(self.cases)))
        for case, results in computed(self.cases, [setup], self.options, jobs):
            if isinstance(results, DlgmdError):
                raise results
            by_name[case.name] = course_of(results[0], case)
        return [by_name[case.name] for case in self.cases]

    def calibrated(self, courses: Sequence[Course]) -> Calibration:
        """What does best on all courses, and without each fold."""
        return calibrated(courses, self.folds, self.rules)


@dataclass(frozen=True)
class Calibrated:
    """What came of it.

    Attributes
    ----------
    setup : Setup
        With the parameters that do best on all videos.
    choices : tuple of Choice
        What was chosen without each fold.
    scores : dict of str to Scores
        `held_out`, each fold with what was chosen without it; `same_videos`, the parameters on
        the videos that they were chosen on; `before`, the setup's own.
    """

    setup: Setup
    choices: tuple[Choice, ...]
    scores: dict[str, Scores]


def of_courses(work: Work, courses: Sequence[Course]) -> Calibrated:
    """Calibrate the model's own parameters, whose courses are given."""
    found = work.calibrated(courses)
    of_folds = [courses] * len(found.of_folds)
    return _result(work, work.setup, found.overall, courses, found.of_folds, of_folds, courses)


def tried(work: Work, search: Search, n_trials: int) -> Iterator[int]:
    """Make the trials of a search that are missing; yields how many there are after each."""

    def measure(setup: Setup) -> Calibration:
        return work.calibrated(work.courses(setup))

    return search.run(n_trials, work.setup, measure)


def of_trials(work: Work, before: Sequence[Course], trials: Sequence[Trial]) -> Calibrated:
    """The best of at least one trial, on all videos and without each fold; these run once more."""
    best = best_trial(trials)
    winners = [best_trial(trials, fold) for fold in range(len(best.found.of_folds))]
    ran: dict[str, list[Course]] = {}
    for one in (best, *winners):
        if str(one.values) not in ran:
            ran[str(one.values)] = work.courses(with_values(work.setup, one.values))
    choices = tuple(one.found.of_folds[fold] for fold, one in enumerate(winners))
    of_folds = [ran[str(one.values)] for one in winners]
    setup, own = with_values(work.setup, best.values), ran[str(best.values)]
    return _result(work, setup, best.found.overall, own, choices, of_folds, before)


def _result(
    work: Work,
    setup: Setup,
    overall: Choice,
    courses: Sequence[Course],
    choices: tuple[Choice, ...],
    of_folds: Sequence[Sequence[Course]],
    before: Sequence[Course],
) -> Calibrated:
    """Score a choice, those of the folds, and what was before."""
    rules, old = work.rules, work.setup.params
    at = strength_at(old.t_mp, old.kappa)
    scores = {
        "held_out": held_out(of_folds, work.folds, choices, rules),
        "same_videos": on_the_same(courses, overall, rules),
        "before": score([count(one, old.n_sp, at, rules.horizon_s) for one in before]),
    }
    return Calibrated(replace(setup, params=with_choice(setup.params, overall)), choices, scores)
