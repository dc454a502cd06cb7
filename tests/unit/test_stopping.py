"""What the alarms of rendered flights are worth: judged at thresholds, summed, in every table."""

import math
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from conftest import csv_rows, read_video, write_video, yaml_of
from test_avoid import CONTACT_S, stage_of

from dlgmd_cli.errors import ResultError
from dlgmd_cli.models.rules import RATE_TIMES_TIME
from dlgmd_cli.parameters.presets import DlgmdParameters, load_config, parameters_of
from dlgmd_cli.results.labels import Case
from dlgmd_cli.results.scoring import EARLY, HIT, JUSTIFIED, Rules, Signal, alarms, tally
from dlgmd_cli.results.tradeoff import curve
from dlgmd_cli.scenes.flights.braking import Brakes
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightOptions, FlightScene, recorded_stage
from dlgmd_cli.tasks.evaluate.candidates import Candidate, Candidates
from dlgmd_cli.tasks.evaluate.evaluate import Evaluation
from dlgmd_cli.tasks.evaluate.stopping import Stops, following, score_stops, with_stops
from dlgmd_cli.tasks.evaluate.tables import ttc_rows
from dlgmd_cli.tasks.synth import synth

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


@pytest.fixture(scope="module")
def rendered(tmp_path_factory):
    """Two flights at a wall, one of which ends early, and their labels."""
    folder = tmp_path_factory.mktemp("rendered") / "f"
    with pytest.MonkeyPatch.context() as patch:
        scene = FlightScene("wall", "", FlightOptions(shape=(54, 96)), stage_of)
        patch.setitem(SCENES, "wall", scene)
        synth("wall", folder, count=2, jobs=1)
        yield folder


@pytest.fixture
def flights(runs, rendered):
    """The same in the working folder, to be changed."""
    return shutil.copytree(rendered, Path("f"))


def braked(runs, flights, *options, plots=False):
    """The outcome of the command by the rule `ttc`, and its row of all flights."""
    quick = ("--no-baselines", "--jobs", 1, "--overwrite", "--alarm", "ttc", "--out", "ev")
    result = runs("evaluate", flights / "labels.csv", *quick, *options, plots=plots)
    rows = [row for row in csv_rows("ev/evaluate.csv") if row["at"] == "default"]
    of_all = {"all"}
    (row,) = [r for r in rows if {r[k] for k in ("target", "kind", "manner", "speed")} == of_all]
    assert row["drones"] == "1" and float(row["speed_m_s"]) == pytest.approx(2.0)
    return result, row


def test_evaluate_closes_the_loop(runs, flights):
    result, row = braked(runs, flights, "--brake", 40, "--react", 0, plots=True)
    assert float(row["saved"]) == 1.0
    assert "1 drone in which a stop avoids the collision, at 2.0 to 2.0 m/s" in result.stdout
    assert "Reaction 0 s, braking at 40 m/s²" in result.stdout
    assert Path("ev/evaluate-stops.png").exists() and yaml_of("ev/evaluate.yaml")["react_s"] == 0
    of_drone = [row for row in csv_rows("ev/alarms.csv") if row["stopped_m"]]
    assert of_drone and {row["saved"] for row in of_drone} == {"1"}
    assert all(float(row["stopped_m"]) > 0.1 for row in of_drone)
    assert "1" in {row["justified"] for row in of_drone}
    braked(runs, flights, "--horizon", 0.1)
    kinds = {(r["kind"], r["justified"]) for r in csv_rows("ev/alarms.csv")}
    assert ("justified", "1") in kinds and not {("false", "1"), ("early", "1")} & kinds
    estimates = [row for row in csv_rows("ev/ttc.csv") if row["ttc_s"]]
    assert {row["model"] for row in estimates} == {"flight alarm=ttc"} and Path(
        "ev/evaluate-ttc.png"
    ).exists()
    near = estimates[0]
    assert (near["left_from_s"], near["left_to_s"], near["frames"]) == ("0.2", "0.3", "3")
    assert 0.1 < float(near["ttc_s"]) < 0.6 and near["estimated"] == "1"
    assert csv_rows("ev/curves.csv")[0].keys() >= {"saved", "unneeded_per_min"}


def test_a_threshold_that_follows_the_speed(runs, dlgmd, flights):
    """A row more for the rule `ttc` alone; the flight's true speed is 2 m/s throughout."""
    common = ("evaluate", flights / "labels.csv", "--config", "flight", "--set", 9, "--no-plots")
    common += ("--no-baselines", "--jobs", 1, "--overwrite", "--out", "ev", "--stabilised")
    rows = {}
    for speed in ("2", "true"):
        runs(*common, "--speed-m-s", speed)
        found = [r for r in csv_rows("ev/evaluate.csv") if r["at"] == "default"]
        rows |= {r["model"]: r for r in reversed(found)}
    assert rows.keys() == {"set9", "flight", "flight, 2 m/s", "flight, true speed"}
    given, true, usual = rows["flight, 2 m/s"], rows["flight, true speed"], rows["flight"]
    assert float(usual["threshold"]) == 0.52
    needed_s = Brakes(agile=False).needed_s(2.0)
    assert float(given["threshold"]) == pytest.approx(RATE_TIMES_TIME / (needed_s + 0.2))
    assert float(true["threshold"]) == pytest.approx(RATE_TIMES_TIME / 0.2)
    same = given.keys() - {"model", "threshold", "auc"}
    assert {k: true[k] for k in same} == {k: given[k] for k in same}
    assert float(given["saved"]) >= float(usual["saved"])
    result = dlgmd(*common, "--speed-m-s", "fast")
    assert result.exit_code == 2 and "Invalid value for '--speed-m-s'" in result.stderr


def test_a_stop_that_is_overdue_from_the_start_has_a_best_threshold(runs, flights):
    """A weak brake needs more time than is ever left, so that the alarm is on throughout."""
    options = ("--brake", 0.5, "--speed-m-s", "true", "--config", "flight", "--no-plots")
    runs("evaluate", flights / "labels.csv", *options, "--no-baselines", "--jobs", 1, "--out", "ev")
    rows = [r for r in csv_rows("ev/evaluate.csv") if r["model"] == "flight, true speed"]
    assert {row["at"] for row in rows} == {"default", "best"}
    assert math.isinf(max(float(row["threshold"]) for row in rows))


def test_no_speed_is_too_high_for_a_threshold():
    params = parameters_of(load_config("flight"))
    assert following(params, Brakes(brake_m_s2=0.1), 100.0).expansion_alarm == 0.01
    assert following(params, Brakes(), math.nan) == following(params, Brakes(), 0.1) == params
    by_time = parameters_of(load_config("flight"), {"alarm": "ttc"})
    assert following(by_time, Brakes(brake_m_s2=0.1), 100.0).ttc_alarm == 100.0


def test_a_video_without_its_record_or_of_another_version_is_no_flight(runs, flights):
    record = flights / "wall-0000.yaml"
    assert recorded_stage(flights / "wall-0000.mp4").contact_s == CONTACT_S
    record.write_text(record.read_text().replace("collision_time_s: 2.4", "collision_time_s: 2.3"))
    with pytest.raises(ResultError, match="this version renders differently"):
        recorded_stage(flights / "wall-0000.mp4")
    record.write_text("width: 96\n")  # of something else
    assert recorded_stage(flights / "wall-0000.mp4") is None
    record.unlink()
    result = runs("evaluate", flights / "labels.csv", "--no-baselines", "--out", "ev", plots=True)
    assert "a stop avoids" not in result.stdout and result.stderr == ""
    assert not Path("ev/evaluate-stops.png").exists()
    assert {row["saved"] for row in csv_rows("ev/alarms.csv") if "0000" in row["video"]} <= {""}


def closed(dlgmd, flights, collision_frame, *options):
    """The outcome of the command on the flight with this label, and whether its loop is closed."""
    (flights / "own.csv").write_text(f"video,collision_frame\nwall-0000.mp4,{collision_frame}\n")
    quick = ("--no-baselines", "--no-plots", "--set", 9, "--scale", 0.5, "--jobs", 1, "--overwrite")
    result = dlgmd("evaluate", flights / "own.csv", *quick, *options, "--out", "ev")
    return result, result.exit_code == 0 and csv_rows("ev/evaluate.csv")[0]["drones"] == "1"


def test_a_record_that_is_not_of_the_video_closes_no_loop(dlgmd, flights):
    """Whatever its frames, size or rate say; a part of the video is still the video."""
    video, record = flights / "wall-0000.mp4", flights / "wall-0000.yaml"
    assert closed(dlgmd, flights, 74, "--end", 2.49)[1]
    whole, (rate, frames) = record.read_text(), read_video(video)
    write_video(video, frames[30:], rate)
    result, is_closed = closed(dlgmd, flights, 44)
    why = "wall-0000.mp4: no stop is simulated: wall-0000.yaml is the record of another video"
    assert f"{why} (frames 91 instead of 61)" in result.stderr and not is_closed
    write_video(video, [frame[:48] for frame in frames], rate)
    result, is_closed = closed(dlgmd, flights, 74)
    assert f"{why} (height 54 instead of 48)" in result.stderr and not is_closed
    write_video(video, frames, 25)
    result, is_closed = closed(dlgmd, flights, 74)
    assert f"{why} (fps 30.0 instead of 25.0)" in result.stderr and not is_closed
    for text in (whole[:200], "scene", whole.replace("fps: 30.0", "fps: .nan", 1)):
        record.write_text(text)
        with pytest.raises(ResultError, match="is damaged"):
            recorded_stage(video)
    result, is_closed = closed(dlgmd, flights, 74)
    assert "no stop is simulated: wall-0000.yaml is damaged" in result.stderr and not is_closed


def test_a_label_that_contradicts_the_record_is_an_error(dlgmd, flights):
    for frame in (60, ""):
        result, _ = closed(dlgmd, flights, frame)
        why = "its label contradicts wall-0000.yaml, which has a collision at frame 74"
        assert result.exit_code == 1 and why in result.stderr


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (("--react", -1), "'--react': -1 is not at least 0"),
        (("--brake", 1e-6), "'--brake': 1e-06 is not at least 0.1"),
        (("--brake", 5, "--agile"), "--brake does not work with --agile or --stabilised"),
    ],
)
def test_answers_that_nobody_can_give(dlgmd, options, why):
    result = dlgmd("evaluate", "labels.csv", *options)
    assert result.exit_code == 2 and why in result.stderr
