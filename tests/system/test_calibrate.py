"""What `calibrate` chooses: thresholds found again, folds that are held out."""

from dataclasses import replace

import numpy as np
import pytest

from dlgmd_cli.models.normalise import absolute, excitation_at
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.parameters.presets import DlgmdParameters, LgmdParameters
from dlgmd_cli.results.scoring import Signal, contact_of, score, tally
from dlgmd_cli.tasks.calibrate import choose_thresholds, fold_of

FPS = 30.0


def signal(bursts, contact=None):
    """200 frames of faint noise, and bursts of `(first, n_frames, strength)`."""
    strength = 0.01 * np.random.default_rng(0).random(200)
    for first, n, level in bursts:
        strength[first : first + n] = level
    contacts = () if contact is None else (contact_of(contact / FPS),)
    return Signal(np.arange(200) / FPS, strength, contacts, 1 / FPS)


def material(n=10):
    """Collisions announced by three frames of 0.5 and more; short flashes are stronger."""
    levels = np.linspace(0.5, 0.9, n)
    near = [signal([(20, 2, 2.0), (60, 8, 0.3), (135, 3, level)], 150) for level in levels]
    return near + [signal([(50, 2, 3.0), (90, 20, 0.4)]) for _ in range(n)]


def judged(signals, max_false_per_min=0.0, counts=(1, 2, 3, 4)):
    """The choices, and the scores held out and on the same videos."""
    folds = fold_of([bool(one.contacts) for one in signals], 5)
    overall, *others = choose_thresholds(signals, folds, max_false_per_min, counts)
    held_out = score([others[f].tally(one) for f, one in zip(folds, signals, strict=True)])
    same = score([overall.tally(one) for one in signals])
    return [overall, *others], held_out, same, folds


def test_the_threshold_and_the_count_are_found_again():
    choices, held_out, same, _ = judged(material())
    for choice in choices:
        assert choice.n_sp == 3 and 0.4 < choice.threshold <= 0.55
    # Whether the weakest is announced depends on the others alone.
    assert held_out["contacts"] == 10 and held_out["false_alarms"] == 0 and held_out["hits"] >= 9
    assert (same["recall"], same["false_alarms"]) == (1.0, 0)
    # With room for mistakes it announces no more, and so makes none.
    assert judged(material(), 60.0)[0][0] == choices[0]


def test_recall_is_bought_with_the_false_alarms_that_are_allowed():
    signals = [signal([(135, 3, 0.5)], 150), signal([(135, 3, 0.2)], 150), signal([(50, 9, 0.3)])]
    minutes = sum(tally(one, 1, 1.0).minutes for one in signals)
    for allowed, recall in ((1.01, 1.0), (0.99, 0.5)):
        best, *_ = choose_thresholds(signals, [0, 1, 0], allowed / minutes)
        assert score([best.tally(one) for one in signals])["recall"] == recall


def test_no_video_judges_what_was_chosen_on_it():
    *_, folds = judged(material())
    # The videos of fold 0 are ten times as strong: what is chosen without them stays, and fails.
    scaled = [
        replace(one, strength=10 * one.strength) if fold == 0 else one
        for one, fold in zip(material(), folds, strict=True)
    ]
    choices, held_out, same, _ = judged(scaled)
    assert 0.4 < choices[1].threshold <= 0.55
    assert held_out["false_alarms"] > 0 < same["hits"] < 10


@pytest.mark.parametrize(("n_with", "n_without", "n_folds"), [(10, 15, 5), (3, 4, 5), (2, 0, 5)])
def test_folds_are_even(n_with, n_without, n_folds):
    has = [True] * n_with + [False] * n_without
    folds = np.array(fold_of(has, n_folds))
    assert set(folds) == set(range(min(n_folds, len(has))))
    for chosen in (folds, folds[:n_with]):
        counts = np.bincount(chosen, minlength=min(n_folds, len(has)))
        assert counts.max() - counts.min() <= 1
    assert fold_of(has, n_folds) == folds.tolist()


def test_folds_are_even_over_kinds():
    sorts = [(True, "real")] * 10 + [(True, "rendered")] * 20 + [(False, "real")] * 5
    folds = np.array(fold_of(sorts, 5))
    for first, last in ((0, 10), (10, 30), (30, 35)):
        assert np.bincount(folds[first:last]).tolist() == [(last - first) // 5] * 5


@pytest.mark.parametrize("params", [DlgmdParameters(), DlgmdParameters(t_mp=1.0), LgmdParameters()])
def test_the_choice_becomes_parameters(params):
    found = rule_of(params).tuned(0.0123456, 3)
    assert found.n_sp == 3
    assert absolute(0.0123456, 1, found.kappa) == pytest.approx(found.t_mp, rel=1e-3)
    assert excitation_at(found.t_mp, found.kappa) == pytest.approx(0.0123456, rel=1e-3)


def test_a_time_to_contact_is_found_again():
    """Those before contact are shorter than where nothing is hit; one frame raises the alarm."""
    times = [signal([], contact) for contact in [150] * 6 + [None] * 4]
    for number, one in enumerate(times):
        one.strength[:] = np.nan
        one.strength[50:60] = -1.5  # nothing is hit
        if one.contacts:
            one.strength[135:138] = -0.5 - 0.01 * number
    (overall, *_), held_out, same, _ = judged(times, counts=(1,))
    assert overall.n_sp == 1 and -1.5 < overall.threshold <= -0.55
    assert (same["recall"], same["false_alarms"]) == (1.0, 0)
    # Whether the longest is announced depends on the others alone.
    assert held_out["hits"] >= 5 and held_out["false_alarms"] == 0
    before = DlgmdParameters(alarm="ttc")
    found = rule_of(before).tuned(overall.threshold, overall.n_sp)
    assert replace(found, ttc_alarm=before.ttc_alarm) == before
    assert found.ttc_alarm == pytest.approx(-overall.threshold, rel=1e-3)
    rule = rule_of(found)
    assert rule.threshold == -rule.strength_at(rule.threshold) == found.ttc_alarm
