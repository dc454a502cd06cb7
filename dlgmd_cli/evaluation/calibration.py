"""The threshold, and how long it must be held, that announce most at an allowed rate of mistakes.

Videos are dealt into folds. Each fold in turn is held out: what does best on the others is scored
on it, so that no video judges what was chosen on it. The preset that is written is what does best
on all of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlgmd_cli.evaluation.footage import strength_at
from dlgmd_cli.evaluation.measures import Count, Scores, count, curve_of, score, thresholds
from dlgmd_cli.evaluation.scoring import Course, Tally, tally
from dlgmd_cli.models.detection import Series, absolute
from dlgmd_cli.parameters import Parameters

# How many spikes in a row are tried.
N_SP = (1, 2, 3, 4)
# T_MP where that of the parameters leaves nothing to choose.
_T_MP = 0.4
_DIGITS = 4


@dataclass(frozen=True)
class Choice:
    """A threshold and how long it must be held, and its rank, see `Curve.rank`."""

    n_sp: int
    threshold: float
    rank: tuple[float, float, float]


@dataclass(frozen=True)
class Rules:
    """What is asked for.

    Attributes
    ----------
    horizon_s : float
        How long before a collision an alarm may begin to announce it.
    max_false_per_min : float
        The rate of false alarms that is allowed.
    folds : int
        Of the cross-validation.
    seed : int
        Which videos are held out together.
    """

    horizon_s: float = 1.0
    max_false_per_min: float = 1.0
    folds: int = 5
    seed: int = 0


@dataclass(frozen=True)
class Calibration:
    """What was chosen on all videos, and on all but those of each fold."""

    overall: Choice
    of_folds: tuple[Choice, ...]


def fold_of(has_collision: Sequence[bool], rules: Rules) -> list[int]:
    """The fold of each video: as many with a collision, and without one, in each as possible."""
    rng, n_dealt = np.random.default_rng(rules.seed), 0
    found = np.zeros(len(has_collision), int)
    n_folds = min(rules.folds, len(has_collision))
    for kind in (True, False):
        members = rng.permutation(np.flatnonzero(np.asarray(has_collision) == kind))
        found[members] = (n_dealt + np.arange(len(members))) % n_folds
        n_dealt += len(members)
    return [int(one) for one in found]


def calibrated(courses: Sequence[Course], folds: Sequence[int], rules: Rules) -> Calibration:
    """What does best on all courses, and on those that are not in each fold."""
    tables: dict[int, tuple[Series, list[Tally]]] = {}
    for n_sp in N_SP:
        at = thresholds(courses, n_sp, rules.horizon_s)
        tables[n_sp] = at, [tally(one, n_sp, at, rules.horizon_s) for one in courses]
    own = np.asarray(folds)
    overall = _choice(tables, np.ones(len(courses), bool), rules)
    return Calibration(
        overall,
        tuple(_choice(tables, own != fold, rules) for fold in range(max(folds) + 1)),
    )


def _choice(
    tables: Mapping[int, tuple[Series, list[Tally]]], chosen: np.ndarray, rules: Rules
) -> Choice:
    """The best of some videos; of equal ones, the fewest spikes."""
    found = []
    for n_sp, (at, tallies) in tables.items():
        curve = curve_of([tallies[i] for i in np.flatnonzero(chosen)], at)
        best = curve.best(rules.max_false_per_min)
        found.append(Choice(n_sp, float(at[best]), curve.rank(best)))
    return max(found, key=lambda one: (one.rank, -one.n_sp))


def held_out(
    courses: Sequence[Sequence[Course]],
    folds: Sequence[int],
    choices: Sequence[Choice],
    rules: Rules,
) -> Scores:
    """How well what was chosen without each fold does on it.

    `courses` has, for each fold, those of all videos with the parameters chosen without it.
    Strengths count in units of the fold's threshold, so that the AUC compares them.
    """
    return score(
        [_count(courses[fold][number], choices[fold], rules) for number, fold in enumerate(folds)]
    )


def on_the_same(courses: Sequence[Course], choice: Choice, rules: Rules) -> Scores:
    """How well a choice does on the videos that it was made on."""
    return score([_count(one, choice, rules) for one in courses])


def _count(course: Course, choice: Choice, rules: Rules) -> Count:
    """A course at a choice's threshold, which becomes the unit."""
    unit = max(choice.threshold, np.finfo(np.float64).tiny)
    return count(
        replace(course, strength=course.strength / unit), choice.n_sp, 1.0, rules.horizon_s
    )


def with_choice(params: Parameters, choice: Choice) -> Parameters:
    """The parameters with the threshold of a choice, to four digits: κ, or T_MP without a κ."""
    if params.kappa is None:
        t_mp = float(absolute(choice.threshold, 1, None))
        return replace(params, t_mp=min(t_mp, 1.0), n_sp=choice.n_sp)  # type: ignore[type-var]
    t_mp = params.t_mp if 0.0 < params.t_mp < 1.0 else _T_MP
    kappa = float(f"{choice.threshold / strength_at(t_mp, 1.0):.{_DIGITS}g}")
    spec = params.specs()["kappa"]
    kappa = min(max(kappa, spec.low), spec.high)
    return replace(params, kappa=kappa, t_mp=t_mp, n_sp=choice.n_sp)  # type: ignore[type-var]
