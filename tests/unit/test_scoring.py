"""What alarms are worth: contacts, false alarms; at one threshold and at all; their intervals."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.models.detection import Detection, spans
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.models.stopping import BRAKES
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import scoring, tradeoff
from dlgmd_cli.results.intervals import holm, interval, p_value
from dlgmd_cli.results.scoring import OUTCOMES, Signal, contact_of

FPS, NAN = 10.0, np.nan
PLAIN = contact_of(10.0)
# A stop takes 0.6 s: in time is from 7.9 s to 9.4 s.
FAST = contact_of(10.0, stop_s=0.6)


def video(alarms, contacts=(PLAIN,), near_s=None, n=200):
    """20 s whose strength is 1 from the first to the last time of each alarm, and 0 elsewhere."""
    time_s, strength = np.arange(n) / FPS, np.zeros(n)
    for first_s, last_s in alarms:
        strength[round(first_s * FPS) : round(last_s * FPS) + 1] = 1.0
    near_s = None if near_s is None else np.array(near_s)
    return Signal(time_s, strength, tuple(contacts), 1 / FPS, near_s=near_s)


def judged(one, at=0.5):
    """The outcome of each contact, and the number of false alarms."""
    counts = scoring.tally(one, 1, at)
    return [OUTCOMES[k] for k in counts.outcome[:, 0]], int(counts.n_false[0])


@pytest.mark.parametrize(
    ("alarms", "outcome", "n_false"),
    [
        ([], "missed", 0),
        ([(7.0, 7.2)], "announced", 0),  # 3 s before: the approach lasts 2 s
        ([(6.9, 7.2)], "missed", 1),
        ([(6.9, 9.5)], "missed", 2),  # it stands for more than 2 s
        ([(6.9, 7.0), (8.0, 8.1)], "announced", 1),
        ([(10.0, 10.0)], "announced", 0),
        ([(10.1, 10.5)], "missed", 0),  # no alarm is false up to 1 s after
        ([(11.0, 15.0)], "missed", 0),
        ([(11.1, 11.1)], "missed", 1),
        ([(1.0, 2.9)], "missed", 1),
        ([(1.0, 3.0)], "missed", 2),
        ([(1.0, 5.0)], "missed", 3),
        ([(1.0, 1.1), (1.3, 1.4)], "missed", 1),  # a pause of less than 0.3 s
        ([(1.0, 1.1), (1.4, 1.5)], "missed", 2),
        ([(0.0, 0.0), (19.9, 19.9)], "missed", 2),
    ],
)
def test_a_contact_without_a_speed(alarms, outcome, n_false):
    assert judged(video(alarms)) == ([outcome], n_false)


@pytest.mark.parametrize(
    ("approach_s", "first_s"), [(9.5, 8.5), (8.0, 7.0), (3.0, 7.0), (-math.inf, 7.0)]
)
def test_the_start_of_an_approach(approach_s, first_s):
    contacts = [contact_of(10.0, approach_s)]
    assert judged(video([(first_s, first_s)], contacts)) == (["announced"], 0)
    before_s = first_s - 1 / FPS
    assert judged(video([(before_s, before_s)], contacts)) == (["missed"], 1)


@pytest.mark.parametrize(
    ("alarms", "outcome", "n_false"),
    [
        ([], "missed", 0),
        ([(7.9, 8.0)], "in_time", 0),  # 1.5 s before a stop is due
        ([(9.4, 9.4)], "in_time", 0),
        ([(9.5, 9.6)], "too_late", 0),
        ([(10.0, 10.0)], "too_late", 0),
        ([(10.1, 10.1)], "missed", 0),
        ([(7.8, 7.8)], "too_early", 1),
        ([(7.8, 9.9)], "too_early", 2),
        ([(3.0, 6.9)], "too_early", 2),  # it stands 1 s before one would be in time
        ([(3.0, 6.8)], "missed", 2),
        ([(7.0, 7.0), (9.5, 9.5)], "too_late", 1),
        ([(7.0, 7.0), (9.0, 9.0)], "in_time", 1),
        ([(9.0, 9.0), (9.5, 9.5)], "in_time", 0),
    ],
)
def test_a_contact_with_a_speed(alarms, outcome, n_false):
    assert judged(video(alarms, [FAST])) == ([outcome], n_false)


@pytest.mark.parametrize(
    ("near_s", "is_justified"),
    [
        ((), False),
        ((3.0,), False),  # one frame
        ((2.0, 4.0), True),  # 1 s before, and 1 s after
        ((1.9, 4.0), False),
        ((2.0, 4.1), False),
        ((3.5, 3.6, 9.0), True),
    ],
)
def test_truth_justifies_an_alarm(near_s, is_justified):
    counts = scoring.tally(video([(3.0, 6.0)], near_s=near_s), 1, 0.5)
    assert (counts.n_false[0], counts.n_justified[0]) == ((0, 1) if is_justified else (2, 0))


def test_an_alarm_that_announces_is_not_counted_as_justified():
    counts = scoring.tally(video([(8.0, 8.0)], near_s=(8.0, 8.1)), 1, 0.5)
    assert (counts.n_justified[0], judged(video([(8.0, 8.0)]))) == (0, (["announced"], 0))
    early = video([(7.0, 7.5)], [FAST], near_s=(7.0, 7.1))
    assert judged(early) == (["too_early"], 0)


def test_contacts_are_judged_apart():
    contacts = [contact_of(5.0), contact_of(6.0, stop_s=0.6), contact_of(15.0)]
    found = judged(video([(4.5, 4.6), (5.6, 5.6), (11.9, 11.9)], contacts))
    assert found == (["announced", "in_time", "missed"], 1)
    assert scoring.tally(video([(4.5, 4.6)], contacts), 1, 0.5).lead_s[:2, 0].tolist() == [0.5, 1.5]


@pytest.mark.parametrize(
    ("onset_s", "in_time"),
    [
        (7.0, [True, False, False]),  # too early for the two that brake hard
        (8.1, [True, True, True]),
        (8.4, [False, True, True]),
        (9.4, [False, False, True]),
        (9.6, [False, False, False]),
    ],
)
def test_a_contact_is_in_time_for_one_brake_and_too_late_for_another(onset_s, in_time):
    contact = contact_of(10.0, stop_s=0.7)._replace(stops_s=(1.8, 0.7, 0.5))
    counts = scoring.tally(video([(onset_s, 9.9)], [contact, PLAIN]), 1, (0.5, 2.0))
    assert counts.in_time[0, :, 0].tolist() == in_time
    assert not counts.in_time[1].any() and not counts.in_time[:, :, 1].any()
    found = scoring.score([counts])
    assert [found[f"in_time_{name}"] for name in BRAKES] == in_time
    assert found["in_time"] == in_time[1]


def test_minutes_and_the_time_in_alarm():
    counts = scoring.tally(video([(1.0, 1.9), (8.0, 8.4)]), 1, 0.5)
    assert counts.minutes == pytest.approx((200 - 41) / FPS / 60)  # without 7 to 11 s
    assert (counts.alarm_s[0], counts.seconds) == pytest.approx((1.5, 20.0))
    assert scoring.tally(video([], ()), 1, 0.5).minutes == pytest.approx(1 / 3)
    assert scoring.tally(video([(0.0, 19.9)]), 1, 0.5).alarm_s[0] == pytest.approx(20.0)


def plain(one, n_sp, threshold):
    """First and last rows of the alarms, by the rules of a model and one threshold."""
    is_new = ~one.repeated
    strength = one.strength[is_new].tolist()
    if threshold < 0.0:  # times to contact, with a minus
        rule = rule_of(DlgmdParameters(alarm="ttc", ttc_alarm=-threshold))
        rows = [Detection(ttc_s=-value) for value in strength]
    else:
        rule = rule_of(DlgmdParameters(t_mp=threshold, n_sp=n_sp))
        rows = [Detection(level=value) for value in strength]
    alarms = np.array([rule.step(row).alarm for row in rows])
    return spans(alarms[np.cumsum(is_new) - 1], one.time_s)


@settings(max_examples=20)
@given(st.integers(0, 10**6), st.integers(0, 4))
def test_all_thresholds_say_what_each_alone_does(seed, n_sp):
    """The rule is `ttc` where `n_sp` is 0."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 120))
    # Few levels, so that there are ties; steps between frames differ; some are undefined.
    strength = rng.integers(0, 5, n) / 4.0
    strength[: rng.integers(0, 3)] = NAN
    time_s = np.cumsum(rng.choice([1 / 30, 1 / 60, 0.1, 0.5], n, p=[0.8, 0.15, 0.04, 0.01]))
    contacts = tuple(contact_of(t) for t in sorted(rng.uniform(0.0, float(time_s[-1]) + 0.1, 2)))
    repeated = rng.random(n) < rng.choice([0.0, 0.3])
    repeated[0] = False
    for row in np.flatnonzero(repeated):
        strength[row] = strength[row - 1]
    one = Signal(time_s, strength, contacts, 1 / 30, repeated)
    at = np.array([0.1, 0.25, 0.5, 0.6, 0.75, 1.0])
    if not n_sp:
        one = replace(one, strength=np.where(strength > 0.0, -1.1 + strength, NAN))
        n_sp, at = 1, -1.1 + at
    every, counts = scoring.alarms(one, n_sp, at), scoring.tally(one, n_sp, at)
    for number, threshold in enumerate(at):
        here, (first, last) = every.level == number, plain(one, n_sp, threshold).T
        assert every.row[here].tolist() == first.tolist()
        assert every.end_s[here].tolist() == time_s[last].tolist()
        alone = scoring.tally(one, n_sp, threshold)
        assert counts.outcome[:, number].tolist() == alone.outcome[:, 0].tolist()
        assert counts.n_false[number] == alone.n_false[0]
        np.testing.assert_array_equal(counts.lead_s[:, number], alone.lead_s[:, 0])


@pytest.mark.parametrize(("blind_s", "told"), [((8.6, 8.7), 1), ((8.3, 8.4), 0), ((10.1, 12), 0)])
def test_a_missed_contact_is_told_in_the_last_moments(blind_s, told):
    """One with an alarm does not count, and one without a word of health is not told."""
    one = video([])
    one = replace(one, blind=(one.time_s >= blind_s[0]) & (one.time_s <= blind_s[1]))
    hit = replace(one, strength=video([(9.0, 9.5)]).strength)
    scores = scoring.score([scoring.tally(each, 1, 0.5) for each in (one, hit, video([]))])
    assert (scores["told"], scores["missed"], scores["contacts"]) == (told, 2, 3)


def test_measures_of_several_videos():
    counts = [
        scoring.tally(one, 1, 0.5)
        for one in (
            video([(9.0, 9.0)], [FAST]),
            video([(8.0, 8.0)]),
            video([(1.0, 1.0), (9.5, 9.5)], [FAST]),
            video([(2.0, 2.0)], near_s=(2.0, 2.1)),
            video([(5.0, 8.0)], ()),
        )
    ]
    found = scoring.score(counts)
    minutes = sum(one.minutes for one in counts)
    expected = {"videos": 5, "contacts": 4, "hits": 2, "in_time": 1, "too_late": 1, "announced": 1}
    expected |= {"missed": 1, "too_early": 0, "false_alarms": 3, "justified": 1, "recall": 0.5}
    expected |= {"minutes": minutes, "false_alarms_per_min": 3 / minutes, "in_time_share": 0.25}
    expected |= {"lead_s": 1.5, "in_alarm": (0.1 * 5 + 3.1) / 100}
    assert {key: found[key] for key in expected} == pytest.approx(expected)
    for name in scoring.MEASURES:
        low, high = found[f"{name}_low"], found[f"{name}_high"]
        # Five shares of time have no interval of 95 %.
        assert math.isnan(low) if name == "in_alarm" else low <= found[name] <= high
    assert scoring.score(counts) == pytest.approx(found, rel=0, nan_ok=True)  # seeded
    nothing = scoring.score([counts[0].only(np.array([False]))])
    assert nothing["contacts"] == 0 and math.isnan(nothing["recall"])


def test_an_interval_is_that_of_drawn_videos():
    hits = (np.random.default_rng(5).random(200) < 0.7).astype(int)
    low, high = interval(hits, np.ones(200), "share")
    half = 1.96 * math.sqrt(hits.mean() * (1 - hits.mean()) / 200)
    assert low == pytest.approx(hits.mean() - half, abs=0.02)
    assert high == pytest.approx(hits.mean() + half, abs=0.02)
    # All ten alarms are in one of twenty minutes: there may as well be none, or thirty.
    low, high = interval([10] + [0] * 19, np.ones(20), "rate")
    assert low == 0.0 and high > 1.5


@pytest.mark.parametrize(
    ("counts", "of", "what", "bounds"),
    [
        ([0] * 13, [1] * 13, "share", (0.0, 1 - 0.025 ** (1 / 13))),
        ([1] * 4, [1] * 4, "share", (0.025 ** (1 / 4), 1.0)),
        ([5] * 4 + [0], [5] * 4 + [0], "share", (0.025 ** (1 / 4), 1.0)),  # videos, not contacts
        ([0] * 10, [1.0] * 10, "rate", (0.0, 0.36889)),
        ([0] * 10, [1] * 10, "difference", (-0.36889, 0.36889)),
        ([3] * 4, [2.0] * 4, "rate", (NAN, NAN)),
        ([0.5] * 8, [2.0] * 8, "time", (NAN, NAN)),
        ([0.5, 0.6] * 2, [2.0] * 4, "time", (NAN, NAN)),
        ([3], [10.0], "rate", (NAN, NAN)),  # one video says nothing of others
        ([1, 0], [1, 0], "share", (NAN, NAN)),
        ([0, 0], [0, 0], "share", (NAN, NAN)),
    ],
)
def test_where_all_videos_agree_the_interval_is_exact_or_none(counts, of, what, bounds):
    assert interval(counts, of, what) == pytest.approx(bounds, nan_ok=True, abs=1e-4)


def test_intervals_have_the_truth_as_often_as_they_say():
    """Also of few videos, and of alarms that come in fours."""
    rng = np.random.default_rng(7)
    for n, what, draw, truth in (
        (4, "share", lambda: rng.random(4) < 0.8, 0.8),
        (10, "share", lambda: rng.random(10) < 0.9, 0.9),
        (5, "rate", lambda: rng.poisson(0.3, 5), 0.3),
        (60, "rate", lambda: 4 * rng.poisson(0.1, 60), 0.4),
    ):
        bounds = np.array([interval(draw(), np.ones(n), what) for _ in range(150)])
        held = (bounds[:, 0] <= truth) & (truth <= bounds[:, 1])
        assert held.mean() > 0.9


def test_a_difference_is_tested_by_the_signs_of_videos():
    assert p_value([0, 0, 0]) == 1.0
    assert p_value([1, 1, 1, 0]) == 2 / 8  # three videos that differ cannot give less
    assert p_value([8] + [0] * 30) == 1.0  # one cluster of alarms is one video
    ours, theirs = np.random.default_rng(2).poisson((2.0, 0.9), (30, 2)).T
    signs = np.random.default_rng(3).choice([-1, 1], (9999, 30))
    as_far = np.abs(signs @ (ours - theirs)) >= abs((ours - theirs).sum())
    assert p_value(ours - theirs) == pytest.approx(as_far.mean(), abs=0.004)
    assert holm([0.01, 0.04, 0.03, 0.9]) == pytest.approx([0.04, 0.09, 0.09, 0.9])


def test_differences_are_those_of_the_same_videos():
    some = [scoring.tally(video([(9, 9)] if number % 3 else []), 1, 0.5) for number in range(30)]
    every = [scoring.tally(video([(9, 9)]), 1, 0.5)] * 30
    found = scoring.score_differences({"every": every, "some": some}, some)
    value, low, high, p = found["every"]["recall"]
    assert value == pytest.approx(1 / 3) and 0.0 < low < 1 / 3 < high < 0.65
    assert p == 4 * 2 / 2**10  # the least of four
    value, low, high, p = found["some"]["false_alarms_per_min"]
    most = 3.69 / sum(one.minutes for one in some)
    assert (value, low, high, p) == pytest.approx((0.0, -most, most, 1.0), rel=0.2)


def curve(signals, at):
    return tradeoff.curve([scoring.tally(one, 1, at) for one in signals], at)


def test_the_best_threshold():
    """At 0.25 there are false alarms, at 0.6 one contact is missed."""
    signals = []
    for level, noise in ((0.5, 0.2), (0.7, 0.25), (0.9, 0.1)):
        one = video([(9.0, 9.5)])
        one.strength[one.strength > 0] = level
        one.strength[20:23] = noise
        signals.append(one)
    at = tradeoff.thresholds(signals, 1)
    found = curve(signals, at)
    best = at[found.best(0.0)]
    assert 0.25 < best <= 0.5
    # Allowed 60 false alarms a minute, it is still this one: of equal recall, the fewest.
    assert at[found.best(60.0)] == best
    # Every threshold in between says the same as one of the curve.
    grid = np.linspace(0.01, 1.2, 200)
    dense = curve(signals, grid)
    pairs = set(zip(found.recall, found.false_alarms_per_min, strict=True))
    assert set(zip(dense.recall, dense.false_alarms_per_min, strict=True)) <= pairs
    assert (found.recall[-1], found.false_alarms_per_min[-1]) == (0, 0)
    front = found.front
    assert found.recall[front].tolist() == [1.0] and found.false_alarms_per_min[front] == [0.0]
    assert (found.recall_low <= found.recall).all() and (found.recall_high >= found.recall).all()
    silent = [video([])]
    at = tradeoff.thresholds(silent, 1)
    assert curve(silent, at).best(1.0) == len(at) - 1


def test_of_very_many_thresholds_the_high_ones_are_exact(monkeypatch):
    monkeypatch.setattr(tradeoff, "MAX_THRESHOLDS", 20)
    rng = np.random.default_rng(2)
    signals = [Signal(np.arange(400) / FPS, rng.random(400), (), 1 / FPS) for _ in range(3)]
    at = tradeoff.thresholds(signals, 1)
    assert len(at) <= 21
    monkeypatch.setattr(tradeoff, "MAX_THRESHOLDS", 10**6)
    assert set(at[-8:]) <= set(tradeoff.thresholds(signals, 1))
