"""What the alarms of rendered flights are worth: judged at thresholds, summed, in every table."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from dlgmd_cli.scenes.flights.braking import Brakes

from dlgmd_cli.parameters.presets import DlgmdParameters, load_config, parameters_of
from dlgmd_cli.results.labels import Case
from dlgmd_cli.results.scoring import EARLY, HIT, JUSTIFIED, Rules, Signal, alarms, tally
from dlgmd_cli.results.tradeoff import curve
from dlgmd_cli.tasks.evaluate.candidates import Candidate, Candidates
from dlgmd_cli.tasks.evaluate.evaluate import Evaluation
from dlgmd_cli.tasks.evaluate.stopping import Stops, following, score_stops, with_stops
from dlgmd_cli.tasks.evaluate.tables import ttc_rows

pytestmark = pytest.mark.usefixtures("here")

TIME_S = np.arange(90) / 30.0


def stops_of(can_stop=True, latest_s=1.5, justified_from_s=1.0):
    """A flight at 2 m/s; a stop saves the drone until a time, and is justified from another on."""
    saves = latest_s >= TIME_S
    return Stops(
        TIME_S,
        saves,
        np.where(saves, math.nan, 1.2),
        np.where(saves, 0.4, math.nan),
        justified_from_s <= TIME_S,
        can_stop,
        2.0,
        np.full(90, 0.6),
    )


def signal_of(*spikes, contact_s=2.0):
    """Strength 1 at the frames of these times, in seconds, and 0.1 elsewhere."""
    strength = np.full(90, 0.1)
    strength[[round(one * 30) for one in spikes]] = 1.0
    return Signal(TIME_S, strength, () if contact_s is None else (contact_s,), 1 / 30)


def judged(signal, stops, at=0.5):
    """A flight and its alarms, as `score_stops` takes them."""
    return stops, tally(stops.on(signal), 1, at, 0.5)


def stopped(signal, stops, at=0.5):
    """Of a flight: saved, speed at impact, and distance left at the thresholds; and its alarms."""
    _, counts = judged(signal, stops, at)
    return *stops.outcomes(counts.stop_s), counts


def test_the_first_alarm_that_is_needed_decides():
    """The horizon is 0.5 s before contact at 2 s; alarms from 1 s on are justified."""
    stops = stops_of(latest_s=1.6)
    for spikes, saved, unneeded, justified in (
        ((1.55,), True, 0, 0),
        ((1.75,), False, 0, 0),
        ((1.2, 1.75), True, 0, 1),  # too early for a hit, but justified
        ((0.3, 1.75), False, 1, 0),  # nobody needs the first; the flight goes on
        ((0.3,), False, 1, 0),
        ((2.03,), False, 0, 0),  # at contact
        ((), False, 0, 0),
    ):
        is_saved, *_, counts = stopped(signal_of(*spikes), stops)
        assert is_saved[0] == saved, spikes
        assert (counts.n_false[0], counts.n_justified[0]) == (unneeded, justified), spikes
    _, impact, left, counts = stopped(signal_of(), stops)
    assert impact[0] == 2.0 and math.isnan(left[0]) and math.isnan(counts.stop_s[0])
    _, impact, _, counts = stopped(signal_of(1.75), stops)
    assert impact[0] == 1.2 and counts.stop_s[0] == pytest.approx(1.75, abs=0.02)
    assert np.isnan(stopped(signal_of(1.75), stops_of(can_stop=False))[:3]).all()


def test_an_alarm_that_stays_on_stops_the_drone_once_that_is_justified():
    """A stop is justified from 1 s on, or from 1.7 s on, and saves the drone until 1.6 s."""
    early = np.arange(0.8, 1.1, 1 / 30)
    for spikes, justified_from_s, saved, impact in (
        (early, 1.0, True, math.nan),
        (early[:5], 1.0, False, 2.0),  # it ends before
        (np.arange(0.8, 1.9, 1 / 30), 1.7, True, math.nan),  # needed from 1.5 s on
        (np.arange(0.8, 1.3, 1 / 30), 1.7, False, 2.0),
    ):
        flight = stops_of(True, 1.6, justified_from_s)
        is_saved, at_m_s, _, counts = stopped(signal_of(*spikes), flight)
        assert is_saved[0] == saved and (counts.n_false[0], counts.n_justified[0]) == (1, 0)
        assert at_m_s[0] == pytest.approx(impact, nan_ok=True)
    # The level at which it stays on decides: it sinks from 1 to 0.4 before a stop is justified.
    signal = signal_of(*early)
    signal.strength[29:] = np.minimum(signal.strength[29:], 0.4)
    assert stopped(signal, stops_of(), [0.3, 0.5])[0].tolist() == [True, False]


def test_an_alarm_that_is_justified_is_not_false():
    """Those from 1 s on are, those from 1.5 s on announce the collision."""
    plain = signal_of(0.3, 1.2, 1.8)
    signal = stops_of().on(plain)
    assert alarms(signal, 1, 0.5, 0.5) == [(9, EARLY), (36, JUSTIFIED), (54, HIT)]
    assert (tally(plain, 1, 0.5, 0.5).n_false, tally(signal, 1, 0.5, 0.5).n_false) == (2, 1)


def test_estimates_of_the_time_to_contact_are_compared_with_the_time_left():
    """They are right from 1 s to contact on, twice as long before, and missing before 1.5 s."""
    left_s = 2.0 - TIME_S
    ttc_s = np.where(left_s < 0.99, left_s, np.where(left_s < 1.49, 2.0 * left_s, math.nan))
    signal = replace(signal_of(), ttc_s=ttc_s)
    rows = list(ttc_rows({"flight": [signal, signal_of()], "set9": [signal_of()]}))
    assert [row[:4] for row in rows[-3:]] == [
        ["flight", 0.7, 1.0, 9],
        ["flight", 1.0, 1.5, 15],
        ["flight", 1.5, 2.0, 15],
    ]
    assert rows[3][4:] == pytest.approx([1.0, 25.0 / 30.0, 0.0, 0.0, 0.0, 0.0], abs=0.02)
    off_s = 37.0 / 30.0
    expected = [1.0, 2.0 * off_s, math.log(2), math.log(2), off_s, off_s]
    assert rows[4][4:] == pytest.approx(expected, abs=0.1)
    assert rows[5][4] == 0.0 and np.isnan(rows[5][5:]).all()


def test_the_error_of_half_and_of_nine_in_ten_estimates():
    """From 1 to 1.5 s left, the logarithm of the error rises from 0 to 1.4 in steps of 0.1."""
    left_s = 2.0 - TIME_S
    ttc_s = left_s * np.exp(3.0 * left_s - 3.0)
    *_, row, _ = ttc_rows({"flight": [replace(signal_of(), ttc_s=ttc_s)]})
    assert row[6:8] == pytest.approx([0.7, 1.26])


def test_scores_count_drones_that_a_stop_can_save_and_all_minutes():
    flights = [
        judged(signal_of(1.2), stops_of()),
        judged(signal_of(1.8), stops_of()),
        judged(signal_of(1.8), stops_of(can_stop=False)),  # it hovers
        judged(signal_of(0.5, 1.2, contact_s=None), stops_of(can_stop=False)),
    ]
    found = score_stops(flights)
    assert found["drones"] == 2 and found["saved"] == 0.5
    assert found["impact_m_s"] == 1.2 and found["stopped_m"] == 0.4
    assert found["unneeded_per_min"] == pytest.approx(1 / ((2.0 * 3 + 3.0) / 60))
    assert found["justified"] == pytest.approx(2 / 3) and found["speed_m_s"] == 2.0
    assert all(math.isnan(value) for key, value in score_stops([]).items() if key != "drones")


def test_the_curve_has_the_scores_of_each_threshold():
    levels = np.array([0.05, 0.5, 2.0])
    signals = signal_of(0.3, 1.2), signal_of(1.2, contact_s=None)
    signals = tuple(replace(one, strength=one.strength * (1.0 + 0.0 * TIME_S)) for one in signals)
    stops = stops_of(), stops_of(can_stop=False)
    flights = [judged(one, own, levels) for one, own in zip(signals, stops, strict=True)]
    found = with_stops(curve([counts for _, counts in flights], levels), flights)
    rate, saved = found.unneeded_per_min, found.saved
    for i, level in enumerate(levels):
        each = [judged(one, own, level) for one, own in zip(signals, stops, strict=True)]
        found = score_stops(each)
        assert rate[i] == pytest.approx(found["unneeded_per_min"]) and saved[i] == found["saved"]


def test_what_becomes_of_a_collision_is_said_once():
    """Of five flights, one is detected twice, two are saved by earlier alarms, two are missed."""
    spikes = {
        "twice": (1.2, 1.55, 1.85),  # two hits after an alarm that is justified, too
        "saved": (0.3, 1.2),
        "held": np.arange(0.8, 1.9, 1 / 30),  # it begins unneeded, and stays on
        "late": (1.45,),  # justified, but too late
        "never": (),
    }
    stops = {name: stops_of(latest_s=1.4 if name == "late" else 1.6) for name in spikes}
    stops["held"] = stops_of(True, 1.6, 1.7)
    signals = {name: signal_of(*own) for name, own in spikes.items()}
    candidates = Candidates(baselines=False)
    params = DlgmdParameters(t_mp=0.5)
    candidates.by_label["m"] = Candidate("m", 1, params, True, {"processed": {}}, signals)
    candidates.cases = [Case(name, name, (60,), ("wall",)) for name in spikes]
    made = Evaluation(candidates, Rules(horizon_s=0.5), Path("labels.csv"), stops, Brakes())
    table = made.alarm_table
    table = table[table["at"] == "default"]
    told = {name: [] for name in spikes}
    for one in table:
        told[str(one["video"])].append(f"{one['kind']} {one['outcome']}".strip())
    assert told == {
        "twice": ["justified", "hit detected", "hit"],
        "saved": ["early", "justified saved"],
        "held": ["early saved"],
        "late": ["justified", "missed missed"],
        "never": ["missed missed"],
    }
    late, never = table[table["outcome"] == "missed"]
    assert late["saved"] == never["saved"] == 0
    assert (late["impact_m_s"], never["impact_m_s"]) == (1.2, 2.0)
    row = made.row("m", "default")
    assert (row["recall"], row["saved_or_detected"], row["saved"]) == (0.2, 0.6, 0.6)
    assert made.to_json()["m"]["saved_or_detected"] == 0.6
    (lines,) = (
        block[1] for block in made.shown() if block[0][2:4] == ("saved or detected", "recall")
    )
    assert [cell.partition(",")[0] for cell in lines[0][2:5]] == [
        "0.60 (0.15–0.95)",
        "0.20 (0.00–0.72)",
        "0.60 (0.15–0.95)",
    ]
    assert lines[0][4].endswith(", 3 of 5")


def test_no_speed_is_too_high_for_a_threshold():
    params = parameters_of(load_config("flight"))
    assert following(params, Brakes(brake_m_s2=0.1), 100.0).expansion_alarm == 0.01
    assert following(params, Brakes(), math.nan) == following(params, Brakes(), 0.1) == params
    by_time = parameters_of(load_config("flight"), {"alarm": "ttc"})
    assert following(by_time, Brakes(brake_m_s2=0.1), 100.0).ttc_alarm == 100.0
