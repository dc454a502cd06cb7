"""Choose the threshold and n_sp with the highest recall at an allowed rate of false alarms.

Performance is estimated by cross-validation: the videos are split into folds, and each fold is
scored with the choice that does best on the others. The preset has the choice that does best on
all videos.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from dlgmd_cli.lab.evaluation.cases import strength_at
from dlgmd_cli.lab.evaluation.measures import Count, Scores, count, curve_of, score, thresholds
from dlgmd_cli.lab.evaluation.scoring import Signal, Tally, tally
from dlgmd_cli.models.detection import Series, absolute
from dlgmd_cli.parameters import Parameters

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


@dataclass(frozen=True)
class Rules:
    """The criteria of a calibration.

    Attributes
    ----------
    horizon_s : float
        An alarm up to so many seconds before a collision announces it.
    max_false_per_min : float
        Allowed rate of false alarms.
    folds : int
        Number of folds of the cross-validation.
    seed : int
        Seed of the split into folds.
    """

    horizon_s: float = 1.0
    max_false_per_min: float = 1.0
    folds: int = 5
    seed: int = 0


@dataclass(frozen=True)
class Choices:
    """The choice on all videos, and for each fold the choice on all others."""

    overall: Choice
    of_folds: tuple[Choice, ...]


def fold_of(has_collision: Sequence[bool], rules: Rules) -> list[int]:
    """The fold of each video; videos with and without a collision are spread evenly."""
    rng, n_dealt = np.random.default_rng(rules.seed), 0
    found = np.zeros(len(has_collision), int)
    n_folds = min(rules.folds, len(has_collision))
    for kind in (True, False):
        members = rng.permutation(np.flatnonzero(np.asarray(has_collision) == kind))
        found[members] = (n_dealt + np.arange(len(members))) % n_folds
        n_dealt += len(members)
    return [int(one) for one in found]


def choose(signals: Sequence[Signal], folds: Sequence[int], rules: Rules) -> Choices:
    """Make the best choice on all signals, and for each fold on all others."""
    tables: dict[int, tuple[Series, list[Tally]]] = {}
    for n_sp in N_SP:
        at = thresholds(signals, n_sp, rules.horizon_s)
        tables[n_sp] = at, [tally(one, n_sp, at, rules.horizon_s) for one in signals]
    own = np.asarray(folds)
    overall = _choice(tables, np.ones(len(signals), bool), rules)
    return Choices(
        overall,
        tuple(_choice(tables, own != fold, rules) for fold in range(max(folds) + 1)),
    )


def _choice(
    tables: Mapping[int, tuple[Series, list[Tally]]], chosen: np.ndarray, rules: Rules
) -> Choice:
    """The best choice on the videos `chosen`; of equal ones, that with the fewest spikes."""
    found = []
    for n_sp, (at, tallies) in tables.items():
        curve = curve_of([tallies[i] for i in np.flatnonzero(chosen)], at)
        best = curve.best(rules.max_false_per_min)
        found.append(Choice(n_sp, float(at[best]), curve.rank(best)))
    return max(found, key=lambda one: (one.rank, -one.n_sp))


def score_held_out(
    signals: Sequence[Sequence[Signal]],
    folds: Sequence[int],
    choices: Sequence[Choice],
    rules: Rules,
) -> Scores:
    """Score each fold with the choice that was made without it.

    `signals` has, for each fold, the signals of all videos with the parameters chosen without it.
    Strengths are divided by the fold's threshold, so that the AUC can compare folds.
    """
    return score(
        [_count(signals[fold][number], choices[fold], rules) for number, fold in enumerate(folds)]
    )


def score_same_videos(signals: Sequence[Signal], choice: Choice, rules: Rules) -> Scores:
    """Score a choice on the videos that it was made on."""
    return score([_count(one, choice, rules) for one in signals])


def _count(signal: Signal, choice: Choice, rules: Rules) -> Count:
    """Count a signal's alarms, its strength divided by the threshold of a choice."""
    unit = max(choice.threshold, np.finfo(np.float64).tiny)
    return count(
        replace(signal, strength=signal.strength / unit), choice.n_sp, 1.0, rules.horizon_s
    )


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
