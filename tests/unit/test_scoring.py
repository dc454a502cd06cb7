"""What alarms are worth: hits, leads, false alarms; at one threshold and at all of them."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.models.detection import spans
from dlgmd_cli.models.rules import Seen, rule_of
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import scoring, tradeoff
from dlgmd_cli.results.intervals import binomial_interval, paired_interval, poisson_interval
from dlgmd_cli.results.names import share_text
from dlgmd_cli.results.scoring import KINDS, Signal

FPS = 30.0
NAN = np.nan


def signal(bursts, contacts=(), n=200, fps=FPS):
    """A video whose strength is 1 in the frames `(first, last)` of each burst, and 0 elsewhere."""
    strength = np.zeros(n)
    for first, last in bursts:
        strength[first : last + 1] = 1.0
    return Signal(np.arange(n) / fps, strength, tuple(frame / fps for frame in contacts), 1 / fps)


def curve(signals, n_sp, at):
    return tradeoff.curve([scoring.tally(one, n_sp, at) for one in signals], at)


def verdict(one, **options):
    """Kinds of the alarms at threshold 0.5."""
    return [KINDS[kind] for _, kind in scoring.alarms(one, 2, 0.5, **options)]


# The alarm is raised at the second frame of a burst.
@pytest.mark.parametrize(
    ("bursts", "contacts", "expected", "lead_frames"),
    [
        ([(119, 121)], [150], ["hit"], [30]),  # a second before is within the horizon
        ([(118, 121)], [150], ["early"], [None]),
        ([(89, 91)], [150], ["early"], [None]),  # two seconds before
        ([(88, 91)], [150], ["false"], [None]),
        ([(148, 160)], [150], ["hit"], [1]),
        ([(149, 151)], [150], ["contact"], [None]),
        ([(152, 160)], [150], ["contact"], [None]),  # three frames after
        ([(153, 160)], [150], ["ignored"], [None]),
        ([(119, 119)], [150], [], [None]),  # one spike is no alarm
        ([(125, 126), (140, 145)], [150], ["hit", "hit"], [24]),  # the first counts
        ([(110, 160)], [150], ["early"], [None]),  # on since before the horizon
        ([(110, 115), (122, 160)], [150], ["early"], [None]),  # a pause of less than 0.3 s
        ([(110, 115), (124, 160)], [150], ["early", "hit"], [25]),
        ([(10, 12), (125, 126), (149, 151)], [150], ["false", "hit", "contact"], [24]),
        ([(10, 12), (30, 32), (198, 199)], [], ["false", "false", "false"], []),
        # Of two collisions: what is between them is ignored up to the second one's horizon.
        ([(65, 70), (90, 92), (140, 142)], [70, 150], ["hit", "ignored", "hit"], [4, 9]),
        ([(71, 73), (140, 142)], [70, 80], ["contact", "ignored"], [None, None]),
        ([(76, 79)], [70, 80], ["hit"], [None, 3]),
    ],
)
def test_what_an_alarm_is(bursts, contacts, expected, lead_frames):
    one = signal(bursts, contacts)
    assert verdict(one) == expected
    counted = scoring.tally(one, 2, 0.5)
    leads = [NAN if lead is None else lead / FPS for lead in lead_frames]
    np.testing.assert_allclose(counted.lead_s[:, 0], leads, atol=1e-9)
    n_false = sum(kind in ("false", "early") for kind in expected)
    assert (counted.n_false[0], counted.n_early[0]) == (n_false, expected.count("early"))
    is_said = [lead is None and number == 0 for number, lead in enumerate(lead_frames)]
    assert counted.at_contact[:, 0].tolist() == [one and "contact" in expected for one in is_said]


@pytest.mark.parametrize(
    ("contacts", "n_frames"), [([], 200), ([150], 150), ([70, 150], 70), ([205], 200)]
)
def test_minutes_run_to_contact_or_the_end(contacts, n_frames):
    assert signal([], contacts).minutes == pytest.approx(n_frames / FPS / 60)


def test_a_longer_horizon_leaves_less_that_is_false():
    one = signal([(80, 90)], [150])
    assert verdict(one) == ["false"] and verdict(one, horizon_s=3.0) == ["hit"]


def plain(one, n_sp, threshold, horizon_s):
    """Rows of the onsets and what they are, by the plain rules and one threshold."""
    seen = ~one.repeated
    strength = one.strength[seen]
    if threshold < 0.0:  # times to contact, with a minus
        rule = rule_of(DlgmdParameters(alarm="ttc", ttc_alarm=-threshold))
        _, alarms = rule.detect(Seen(np.full_like(strength, NAN), -strength))
    else:
        _, alarms = rule_of(DlgmdParameters(t_mp=threshold, n_sp=n_sp)).detect(Seen(strength))
    alarms = alarms[np.cumsum(seen) - 1]
    rows = spans(alarms, one.time_s)[:, 0]
    found = []
    for row in rows:
        t, kind, over = one.time_s[row], "false", -np.inf
        for number, contact in enumerate(one.contacts_s):
            grace = contact + 3 * one.frame_s + 1e-6
            if t <= over:
                break
            if contact - horizon_s - 1e-6 <= t < contact - 1e-6:
                kind = "hit"
            elif contact - 1e-6 <= t <= grace:
                kind = "contact"
            elif t > grace:
                kind = "ignored"
            elif number == 0 and t >= contact - 2 - 1e-6:
                kind = "early"
            over = grace
        found.append((row, kind))
    return found


@settings(max_examples=150, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 4), st.sampled_from([0, 1, 2]))
def test_all_thresholds_say_what_each_alone_does(seed, n_sp, n_contacts):
    """The rule is `ttc` where `n_sp` is 0."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 120))
    # Few levels, so that there are ties; steps between frames differ; some are undefined.
    strength = rng.integers(0, 5, n) / 4.0
    strength[: rng.integers(0, 3)] = NAN
    time_s = np.cumsum(rng.choice([1 / 30, 1 / 60, 0.1, 0.5], n, p=[0.8, 0.15, 0.04, 0.01]))
    last = float(time_s[-1])
    contacts = tuple(sorted(rng.uniform(0.0, last + 0.1, n_contacts)))
    repeated = rng.random(n) < rng.choice([0.0, 0.3])
    repeated[0] = False
    for row in np.flatnonzero(repeated):
        strength[row] = strength[row - 1]
    one = Signal(time_s, strength, contacts, 1 / 30, repeated)
    at = np.array([0.1, 0.25, 0.5, 0.6, 0.75, 1.0])
    if not n_sp:
        one = replace(one, strength=np.where(strength > 0.0, -1.1 + strength, NAN))
        n_sp, at = 1, -1.1 + np.array([0.1, 0.25, 0.5, 0.6, 0.75, 1.0])
    counted = scoring.tally(one, n_sp, at)
    for number, threshold in enumerate(at):
        expected = plain(one, n_sp, threshold, 1.0)
        assert [(r, KINDS[k]) for r, k in scoring.alarms(one, n_sp, threshold)] == expected
        words = [kind for _, kind in expected]
        assert counted.n_early[number] == words.count("early")
        assert counted.n_false[number] == words.count("early") + words.count("false")
        hits = [time_s[row] for row, kind in expected if kind == "hit"]
        leads = []
        for contact in contacts:
            own = [contact - t for t in hits if min(c for c in contacts if c > t) == contact]
            leads.append(max(own, default=NAN))
        np.testing.assert_allclose(counted.lead_s[:, number], leads)


def test_the_strongest_inside_and_outside_of_horizons():
    strength = np.arange(200) / 200
    one = Signal(np.arange(200) / FPS, strength, (150 / FPS,), 1 / FPS)
    inside, outside = scoring.peaks(scoring.windows(one, 2))
    # The frame before contact; a run of two has the strength of its weaker frame.
    np.testing.assert_allclose(inside, [148 / 200])
    np.testing.assert_allclose(outside, [(last - 1) / 200 for last in (119, 89, 59, 29)])
    windows = scoring.windows(signal([], n=50), 1)
    ends = [part for window in windows for part in (window.start_s, window.end_s)]
    assert ends == pytest.approx([50 / FPS - 1, 50 / FPS, 0, 50 / FPS - 1])
    inside, outside = scoring.peaks(windows)
    assert inside.shape == (0,) and len(outside) == 2  # 1 s, and 0.67 s that is left


def test_measures_of_several_videos():
    counts = [
        scoring.tally(signal(bursts, contacts), 2, 0.5)
        for bursts, contacts in [
            ([(119, 130)], [150]),  # 1 s
            ([(143, 150)], [150]),  # 0.2 s
            ([(20, 22), (134, 140)], [150]),  # 0.5 s, and a false alarm
            ([(149, 160)], [150]),  # at contact
            ([(50, 52), (90, 92)], []),  # two false alarms
        ]
    ]
    found = scoring.score(counts)
    minutes = (4 * 150 + 200) / FPS / 60
    expected = {"videos": 5, "collisions": 4, "hits": 3, "at_contact": 1, "false_alarms": 3}
    expected |= {"early": 0, "minutes": minutes, "recall": 0.75, "precision": 0.5, "lead_s": 0.5}
    expected |= {"lead_p10_s": np.percentile([1, 0.2, 0.5], 10)}
    assert {key: found[key] for key in expected} == pytest.approx(expected)
    assert found["false_alarms_per_min"] == pytest.approx(3 / minutes)
    inside = [1, 1, 1, 0]
    outside = [peak for one in counts for peak in one.outside]
    pairs = [(a > b) + (a == b) / 2 for a in inside for b in outside]
    assert found["auc"] == pytest.approx(np.mean(pairs)) and max(outside) == 1
    elsewhere, before = tradeoff.roc(np.array(inside), np.array(outside))
    area = np.sum(np.diff(elsewhere) * (before[1:] + before[:-1]) / 2)
    assert area == pytest.approx(found["auc"]) and elsewhere[-1] == before[-1] == 1
    for name in scoring.MEASURES:
        low, high = found[f"{name}_low"], found[f"{name}_high"]
        assert low <= found[name] <= high and low < high
    assert scoring.score(counts) == found  # seeded


def test_the_band_of_a_curve_holds_the_best_recall_at_each_rate():
    """Two videos are missed at a threshold without false alarms, which are in one video alone."""
    signals = [signal([(140, 145)], [150]) for _ in range(6)]
    weak = [signal([(10, 12), (140, 145)], [150]) for _ in range(3)]
    signals += [replace(one, strength=one.strength / 2) for one in weak]
    at = np.array([0.4, 0.9, 2.0])
    tallies = [scoring.tally(one, 2, at) for one in signals]
    found = tradeoff.with_band(tradeoff.curve(tallies, at), tallies)
    minutes = 9 * 150 / FPS / 60
    np.testing.assert_allclose(found.false_alarms_per_min, [3 / minutes, 0, 0])
    np.testing.assert_allclose(found.recall, [1, 2 / 3, 0])
    # At no false alarm, the best recall is 6 of 9 also at the threshold that detects nothing.
    exact = [binomial_interval(9, 9), *[binomial_interval(6, 9)] * 2]
    low, high = np.array(exact).T
    assert (found.recall_low <= low).all() and (found.recall_high >= high).all()
    assert found.recall_high[1] == 1.0  # where no weak video is drawn, or no one's false alarm
    silent = [scoring.tally(signal([]), 2, at)]
    assert np.isnan(tradeoff.with_band(tradeoff.curve(silent, at), silent).recall_low).all()


def test_videos_are_drawn_alike_in_every_run():
    drawn = scoring.resampled(4)
    expected = np.random.default_rng(0).multinomial(4, [0.25] * 4, scoring.N_RESAMPLES)
    assert drawn[0].tolist() == [1] * 4 and np.array_equal(drawn[1:], expected)


def test_an_interval_is_that_of_resampled_videos():
    rng = np.random.default_rng(5)
    counts = [
        scoring.tally(signal([(130, 140)] * bool(rng.random() < 0.7), [150]), 2, 0.5)
        for _ in range(100)
    ]
    found = scoring.score(counts)
    half = 1.96 * np.sqrt(found["recall"] * (1 - found["recall"]) / 100)
    assert found["recall_high"] - found["recall_low"] == pytest.approx(2 * half, rel=0.15)
    nothing = scoring.score([counts[0].only(np.array([False]))])
    assert np.isnan([nothing["recall"], nothing["recall_low"]]).all()
    assert nothing["collisions"] == 0


@pytest.mark.parametrize(
    ("count", "n", "low", "high"),
    [(0, 13, 0, 0.2471), (3, 3, 0.2924, 1), (5, 10, 0.1871, 0.8129), (1, 1, 0.025, 1)],
)
def test_the_exact_binomial_interval(count, n, low, high):
    """Clopper and Pearson's, to four decimals."""
    assert binomial_interval(count, n) == pytest.approx((low, high), abs=1e-4)


@pytest.mark.parametrize(
    ("count", "low", "high"), [(0, 0.0, 3.689), (1, 0.025, 5.572), (10, 4.795, 18.390)]
)
def test_the_exact_poisson_interval(count, low, high):
    """Garwood's table, to three decimals."""
    assert poisson_interval(count) == pytest.approx((low, high), abs=1e-3)
    assert poisson_interval(3000)[1] == pytest.approx(3000 + 1.96 * 3000**0.5, rel=1e-3)


def test_false_alarms_in_bunches_and_none_at_all_have_wide_intervals():
    quiet, bursts = signal([]), signal([(first, first + 3) for first in range(5, 190, 20)])
    none = scoring.score([scoring.tally(quiet, 2, 0.5)] * 20)
    minutes = 20 * quiet.minutes
    assert none["false_alarms_per_min_low"] == 0.0
    assert none["false_alarms_per_min_high"] == pytest.approx(3.689 / minutes, rel=1e-3)
    # All ten alarms are in one of twenty videos: it may as well be in none, or in three.
    bunched = scoring.score([scoring.tally(one, 2, 0.5) for one in [bursts, *[quiet] * 19]])
    assert bunched["false_alarms"] == 10
    assert bunched["false_alarms_per_min_low"] == 0.0
    assert bunched["false_alarms_per_min_high"] > 1.5 * 18.39 / minutes


def test_the_limit_may_be_on_some_videos():
    """The threshold that is right for the second video is too low for the first."""
    noisy, good = signal([(20, 30)]), signal([(130, 140)], [150])
    noisy.strength[:] *= 2.0
    at = tradeoff.thresholds([noisy, good], 2)
    tallies = [scoring.tally(one, 2, at) for one in (noisy, good)]
    every = tradeoff.curve(tallies, at)
    second = tradeoff.curve(tallies, at, np.array([False, True]))
    assert (second.recall == every.recall).all()
    assert every.recall[every.best(0.0)] == 0.0
    assert second.recall[second.best(0.0)] == 1.0
    best = second.best(0.0)
    assert second.false_alarms_per_min[best] == 0.0 < every.false_alarms_per_min[best]


def test_the_best_threshold():
    # The stronger bursts announce; at 0.2 there are false alarms, at 0.6 one collision is missed.
    signals = []
    for level, noise in ((0.5, 0.2), (0.7, 0.25), (0.9, 0.1)):
        one = signal([(130, 140)], [150])
        one.strength[one.strength > 0] = level
        one.strength[20:23] = noise
        signals.append(one)
    at = tradeoff.thresholds(signals, 2)
    found = curve(signals, 2, at)
    best = at[found.best(0.0)]
    assert 0.25 < best <= 0.5
    assert curve(signals, 2, np.array([best])).recall[0] == 1.0
    # Allowed 60 false alarms a minute, it is still this one: of equal recall, the fewest.
    assert at[found.best(60.0)] == best
    # Every threshold in between says the same as one of the curve.
    grid = np.linspace(0.01, 1.2, 200)
    dense = curve(signals, 2, grid)
    pairs = set(zip(found.recall, found.false_alarms_per_min, strict=True))
    assert set(zip(dense.recall, dense.false_alarms_per_min, strict=True)) <= pairs
    assert (found.recall[-1], found.false_alarms_per_min[-1]) == (0, 0)
    silent = [signal([], [150])]
    at = tradeoff.thresholds(silent, 2)
    assert at[curve(silent, 2, at).best(1.0)] > 0


def test_of_very_many_thresholds_the_high_ones_are_exact(monkeypatch):
    monkeypatch.setattr(tradeoff, "MAX_THRESHOLDS", 20)
    rng = np.random.default_rng(2)
    signals = [Signal(np.arange(400) / FPS, rng.random(400), (), 1 / FPS) for _ in range(3)]
    at = tradeoff.thresholds(signals, 1)
    assert len(at) <= 21
    monkeypatch.setattr(tradeoff, "MAX_THRESHOLDS", 10**6)
    assert set(at[-8:]) <= set(tradeoff.thresholds(signals, 1))


def test_differences_are_those_of_the_same_videos():
    videos = [signal([(130, 140)] if number % 3 else [], [150]) for number in range(30)]
    some = [scoring.tally(one, 2, 0.5) for one in videos]
    every = [scoring.tally(signal([(130, 140)], [150]), 2, 0.5)] * 30
    found = scoring.differences(every, some)
    assert found["recall"][0] == pytest.approx(1 / 3)
    assert 0.1 < found["recall"][1] < 1 / 3 < found["recall"][2] < 0.6
    # Without a pair that differs, 30 collisions leave what 0 of 30 leaves, and no alarm so, too.
    value, low, high = scoring.differences(some, some)["recall"]
    assert (value, low, high) == (0.0, -high, pytest.approx(1.0 - 0.025 ** (1 / 30)))
    value, low, high = scoring.differences(some, some)["false_alarms_per_min"]
    assert (value, low) == (0.0, -high)
    assert high == pytest.approx(-math.log(0.025) / sum(one.minutes for one in some))


def test_the_interval_of_pairs_covers_the_difference():
    """The outcomes whose interval holds the difference have 95 %, but for rare shares."""
    n, held = 13, []
    outcomes = [(b, c) for b in range(n + 1) for c in range(n + 1 - b)]
    low, high = np.array([paired_interval(*one, n) for one in outcomes]).T
    ways = np.array([math.comb(n, b) * math.comb(n - b, c) for b, c in outcomes], float)
    ours, theirs = np.array(outcomes).T
    for share in np.linspace(0.0, 0.95, 20):
        for other in np.linspace(0.0, min(share, 1.0 - share), 6):
            neither = max(1.0 - share - other, 0.0)
            odds = ways * share**ours * other**theirs * neither ** (n - ours - theirs)
            holds = (low <= share - other) & (share - other <= high)
            assert odds.sum() == pytest.approx(1.0)
            held.append(odds[holds].sum())
    assert min(held) > 0.89 and np.mean(np.array(held) >= 0.95) > 0.95
    assert 0.96 < np.mean(held) < 0.985  # nor much too wide
    assert paired_interval(0, 0, n) == pytest.approx((-0.247, 0.247), abs=1e-3)


@pytest.mark.parametrize(
    ("of", "text"), [(1, "0.50 (0.20–0.80), 0 of 1"), (29, "0.50 (0.20–0.80), 14 of 29")]
)
def test_the_counts_of_few_stand_beside_a_share(of, text):
    scores = {"recall": 0.5, "recall_low": 0.2, "recall_high": 0.8}
    assert share_text(scores, "recall", of) == text
    assert share_text(scores, "recall", 30) == share_text(scores, "recall", 0) == text[:16]
