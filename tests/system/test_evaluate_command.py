"""`dlgmd evaluate` on tiny clips: tables, JSON, stored results, what goes wrong."""

import json
import math
import shutil
from dataclasses import replace
from doctest import DocTestParser
from types import SimpleNamespace

import numpy as np
import pytest
from conftest import csv_rows, judged_anew, looming_frames, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli import read_result
from dlgmd_cli.errors import ParameterError, ResultError
from dlgmd_cli.models.stopping import BRAKES
from dlgmd_cli.results.labels import (
    Case,
    Label,
    collision_frames,
    groups,
    labels_of,
    near_frames,
    read_by_video,
    read_cases,
    write_labels,
)
from dlgmd_cli.results.scoring import alarms
from dlgmd_cli.results.tradeoff import Curve
from dlgmd_cli.tasks.evaluate.candidates import Candidates, Stopping, signal_of
from dlgmd_cli.tasks.evaluate.tables import curve_rows

pytestmark = pytest.mark.usefixtures("here")

NAN = float("nan")
# Large enough for the expansion to be measured.
SIZE = {"width": 64, "height": 48}
STILL = [looming_frames(1, **SIZE)[0]] * 12


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """Three clips: a square that looms, one that looms twice, and a still scene; and labels."""
    folder = tmp_path_factory.mktemp("footage")
    loom = looming_frames(**SIZE)
    write_video(folder / "near.avi", loom)
    write_video(folder / "twice.avi", [*loom, *STILL, *loom])
    write_video(folder / "still.avi", STILL)
    text = "video,collision_frame,target\nnear.avi,20,wall\ntwice.avi,52,chair\nstill.avi,,chair\n"
    (folder / "labels.csv").write_text(text)
    return folder


def recorded():
    return yaml_of("ev/evaluate.yaml")


NAMES = ("--label", "set3", "--label", "set9")
SETS = ("--set", 3, "--set", 9, "--param", "kappa=1e-4", "--jobs", 1, "--repeats", "keep")


BASELINES = ("ΣP alone", "LK divergence")


def test_nothing_is_calibrated_where_nothing_can_be_detected(dlgmd, tmp_path):
    for name in "ab":
        write_video(tmp_path / f"{name}.avi", STILL)
    (tmp_path / "labels.csv").write_text("video,collision_frame\na.avi,9\nb.avi,9\n")
    result = dlgmd("calibrate", "labels.csv", "--set", 9, "--jobs", 1, "--folds", 2, "--out", "c")
    assert result.exit_code == 1 and not list((tmp_path / "c").glob("*.yaml"))
    why = (
        "labels.csv: no threshold detects a contact at 1 false alarms per minute. Check the labels"
    )
    assert why in result.stderr.splitlines()[-1]


def test_each_normalisation_has_a_threshold_of_its_own(runs, footage):
    """The LGMD's own threshold is one of its sigmoid; the min–max has 0.4."""
    common = ("--set", 9, "--model", "lgmd", "--jobs", 1, "--no-baselines", "--overwrite")
    for normalise, threshold in (("sequence", "0.4"), ("absolute", "0.99999994")):
        options = (*common, "--normalise", normalise, "--out", "ev")
        result = runs("evaluate", footage / "labels.csv", *options, "--param", "alarm=spikes")
        rows = [row for row in csv_rows("ev/evaluate.csv") if row["at"] == "default"]
        assert {row["threshold"] for row in rows if row["model"].startswith("lgmd")} == {threshold}
        assert {row["threshold"] for row in rows if row["model"].startswith("set9")} == {"0.4"}
        assert threshold in result.stdout
    lgmd, chosen = (
        dlgmd_cli.run(footage / "near.avi", "lgmd", normalise="sequence", param=param)
        for param in ({}, {"t_mp": 0.91})
    )
    assert lgmd.threshold == 0.4 and lgmd.spikes.any() and chosen.threshold == 0.91
    assert np.array_equal(lgmd.new_spikes, lgmd.mp_seq >= 0.4)


def test_tables(runs, footage):
    result = runs("evaluate", footage / "labels.csv", *SETS, *NAMES, "--out", "ev")
    assert {row["model"] for row in csv_rows("ev/ttc.csv")} == {"all models"}
    assert "set9" in result.stdout and "3 videos, 2 contacts" in result.stdout
    first, *_ = result.stdout.split("3 videos")
    assert max(map(len, first.splitlines())) <= 100
    words = first.split("\n")[1].split()
    assert words == ["model", "rule", "threshold", "announced", "false/min", "in", "alarm"]
    rows = csv_rows("ev/evaluate.csv")
    assert {row["kind"] for row in rows} == {"all"} == {row["manner"] for row in rows}
    at = [(r["model"], r["at"]) for r in rows if r["target"] == "all"]
    both = [(label, kind) for label in ("set3", "set9") for kind in ("default", "best")]
    assert at == [*both, ("ΣP alone", "best"), ("LK divergence", "best")]
    by_target = {r["target"]: r for r in rows if (r["model"], r["at"]) == ("set3", "default")}
    assert list(by_target) == ["all", "all without walls", "chair", "wall"]
    assert [r["videos"] for r in by_target.values()] == ["3", "2", "2", "1"]
    assert [r["contacts"] for r in by_target.values()] == ["2", "1", "1", "1"]
    every = by_target["all"]
    assert every["threshold"] == "0.4" and every["rule"] == "spikes"
    assert float(every["excitation"]) == pytest.approx(1e-4 * 0.4 / 0.6)
    assert float(every["minutes"]) == pytest.approx(12 / 25 / 60)  # of the still scene alone
    assert (every["announced"], every["missed"], every["recall"]) == ("2", "0", "1")
    alarms = csv_rows("ev/alarms.csv")
    assert {(row["model"], row["at"]) for row in alarms} == {*at}
    for row in rows:
        own = [r for r in alarms if (r["model"], r["at"]) == (row["model"], row["at"])]
        if row["target"] == "all":  # the rows add up
            assert sum(r["kind"] == "announced" for r in own) == int(row["announced"])
            assert sum(int(r["false_alarms"]) for r in own) == int(row["false_alarms"])
    alarms = [r for r in alarms if (r["model"], r["at"]) == ("set3", "default")]
    assert {row["kind"] for row in alarms} == {"announced", "further"}
    told = {(r["video"], r["collision_frame"]) for r in alarms if r["kind"] == "announced"}
    assert told == {("near.avi", "20"), ("twice.avi", "52")}
    auc = {(row["model"], row["by"]): row for row in csv_rows("ev/auc.csv")}
    assert auc.keys() == {(label, by) for label, _ in at for by in ("frames", "videos")}
    own = auc["set3", "videos"]
    assert (own["positives"], own["negatives"], own["auc"]) == ("2", "1", "1")
    # Of near.avi and of the two approaches in twice.avi, and the still scene.
    frames = auc["set3", "frames"]
    assert int(frames["positives"]) > 2 * 12 and frames["negatives"] == "12"
    assert 0.5 < float(frames["auc"]) < 1 and frames["auc_low"] == ""
    roc = [r for r in csv_rows("ev/roc.csv") if (r["model"], r["by"]) == ("set3", "videos")]
    assert [r["recall"] for r in roc] == ["0.5", "1", "1"]
    curve = [r for r in csv_rows("ev/curves.csv") if r["model"] == "set9"]
    assert float(curve[-1]["recall"]) == float(curve[-1]["false_alarms_per_min"]) == 0
    assert recorded()["models"][1]["kappa"] == 1e-4 and recorded()["max_false_per_min"] == 1.0


def test_a_curve_has_both_ends_of_each_step():
    recall, rate = [1.0, 1.0, 1.0, 0.5, 0.5, 0.0], [3.0, 3.0, 3.0, 1.0, 1.0, 0.0]
    found = Curve(*map(np.array, (range(6), recall, recall, recall, rate)))
    candidate = SimpleNamespace(rule_name="ttc", level=float, excitation=lambda _: math.nan)
    rows = [*curve_rows(found, candidate)]
    assert [row[1] for row in rows] == [0.0, 2.0, 3.0, 4.0, 5.0]
    assert [row[-1] for row in rows] == [3.0, 3.0, 1.0, 1.0, 0.0]


def test_a_speed_says_what_is_in_time(runs, footage):
    (footage / "near.csv").write_text("video,collision_frame,speed_m_s\nnear.avi,20,4\n")
    common = ("evaluate", footage / "near.csv", "--set", 3, "--param", "kappa=1e-4", "--jobs", 1)
    common += ("--no-baselines", "--format=none", "--overwrite", "--out", "ev", "--repeats", "keep")

    def outcome(*options):
        made = runs(*common, *options)
        (row, _) = csv_rows("ev/evaluate.csv")
        (alarm, *_) = csv_rows("ev/alarms.csv")
        found = {k for k in ("in_time", "too_late", "too_early", "missed") if row[k] == "1"}
        assert {alarm["kind"]} == found and "in time   " in made.stdout
        return alarm["kind"], float(alarm["lead_s"])

    kind, lead_s = outcome()
    assert kind == "too_late" and lead_s < 0.5  # a stop from 4 m/s takes 0.8 s
    assert yaml_of("ev/evaluate.yaml")["brake"].endswith("ArduCopter with PSC_JERK_XY 20")
    brake = ("--brake", 100, "--react", 0)  # 4 m/s: 0.02 s
    assert outcome(*brake)[0] == "in_time"
    assert outcome(*brake, "--react", lead_s + 0.1)[0] == "too_late"
    assert outcome(*brake, "--react", lead_s / 4)[0] == "in_time"
    assert outcome("--speed-m-s", 0.3, "--brake", 100, "--react", 0)[0] == "in_time"
    assert yaml_of("ev/evaluate.yaml")["speed_m_s"] == 0.3


def test_who_brakes_says_what_is_in_time(runs, footage):
    """By --brake, else by the column; three brakes stand side by side, whoever brakes."""
    labels = footage / "braked.csv"
    labels.write_text("video,collision_frame,speed_m_s,brake\nnear.avi,20,4,0.01s\n")
    common = ("evaluate", labels, "--set", 3, "--param", "kappa=1e-4", "--jobs", 1, "--out", "ev")
    common += ("--no-baselines", "--format=none", "--overwrite", "--repeats", "keep")

    def rows(*options):
        printed = runs(*common, *options).stdout
        assert "arducopter:20" in printed and "In time by who brakes" in printed
        return csv_rows("ev/evaluate.csv")

    (row, _) = rows("--react", 0)
    assert row["in_time"] == "1"
    assert [row[f"in_time_{name}"] for name in BRAKES] == ["0", "0", "0"]
    assert row["threshold_arducopter"] == ""  # spikes mean no time before a contact
    (row, _) = rows("--react", 0, "--brake", "arducopter")
    assert row["in_time"] == "0"


def test_each_brake_needs_the_threshold_of_the_fastest_contact(footage):
    labels = footage / "fast.csv"
    labels.write_text("video,collision_frame,speed_m_s\nnear.avi,20,7\nnear.avi,21,1\n")
    report = dlgmd_cli.evaluate(labels, baselines=False)
    row = report.main("flight")
    for name, brake in BRAKES.items():
        with pytest.warns(dlgmd_cli.DlgmdWarning, match="above 3 m/s"):
            needed = dlgmd_cli.run(footage / "near.avi", speed_m_s=7, brake=brake.text).params
        assert row[f"threshold_{name}"] == pytest.approx(needed.expansion_alarm)
    assert row["threshold_arducopter"] < row["threshold_tilt"] < row["threshold_arducopter_20"]
    assert row["threshold_arducopter_20"] < 0.47
    assert report.to_json()["flight"]["threshold_tilt"] == row["threshold_tilt"]


def test_truth_beside_the_labels_justifies_alarms(runs, footage, tmp_path):
    shutil.copy(footage / "near.avi", "near.avi")
    (tmp_path / "labels.csv").write_text("video,collision_frame\nnear.avi,\n")
    common = ("evaluate", "labels.csv", "--set", 3, "--param", "kappa=1e-4", "--jobs", 1)
    common += ("--no-baselines", "--format=none", "--overwrite", "--out", "ev", "--repeats", "keep")

    def counts():
        told.append(runs(*common).stderr)
        row = csv_rows("ev/evaluate.csv")[0]
        return int(row["false_alarms"]), int(row["justified"])

    told = []
    n_false, none = counts()
    assert n_false > 0 == none
    (tmp_path / "truth").mkdir()
    lines = ["frame,time_s,distance_m,closing_m_s", "0,0,,", "9,0.36,2,1", "11,0.44,2,0.91"]
    (tmp_path / "truth/near.csv").write_text("\n".join(lines))
    assert counts() == (0, n_false)
    assert {row["kind"] for row in csv_rows("ev/alarms.csv")} == {"justified"}
    (tmp_path / "truth/near.csv").write_text("\n".join([*lines, "999,40,,"]))
    counts()
    (tmp_path / "truth/near.csv").write_text(
        "\n".join(line.replace("0.44", "0.9") for line in lines)
    )
    counts()
    told_of = ["check that they belong together" in text for text in told]
    assert told_of == [False, False, True, True]
    assert "truth/near.csv has 1 row more than the video has frames" in told[2]
    assert "truth/near.csv has frame 11 at 0.900 s, the video at 0.440 s" in told[3]


def test_which_frames_of_a_truth_are_near(tmp_path):
    path = tmp_path / "near.csv"
    rows = ["0,0.1,0.045,x", "1,0.1,0.0449,x", "2,,1,x", "3,1,,x", "4,1,-1,x", "5,0,0.1,x"]
    path.write_text("frame,distance_m,closing_m_s,more\n" + "\n".join(rows))
    near, truth = near_frames(path)
    assert near == (0, 5) and truth.texts("frame") == [*"012345"]
    head = "frame,distance_m,closing_m_s\n"
    for text, why in (
        (
            "frame,closing_m_s\n0,1\n",
            "truth of a video: it lacks distance_m; its columns are frame",
        ),
        (f"{head}0,far,1\n", "line 2, column distance_m: 'far' is no number"),
        (f"{head}0,1,\n,0,1\n", "line 3, column frame: is no number of a frame"),
        (f"{head}inf,1,1\n", "line 2, column frame: is no number of a frame"),
    ):
        path.write_text(text)
        with pytest.raises(ResultError, match=why):
            near_frames(path)


def test_results_of_a_batch_score_as_videos_do(dlgmd, runs, footage):
    runs("batch", footage, *SETS, "--out", "ba")
    common = ("evaluate", footage / "labels.csv", "--no-baselines", "--format=none")
    both = []
    for source in ((*SETS, *NAMES), ("--results", "ba")):
        result = runs(*common, *source, "--json", "--out", f"ev{len(both)}")
        both.append(json.loads(result.stdout)["models"])
    assert list(both[0]) == list(both[1]) == ["set3", "set9"]
    facts = both[0]["set9"]
    assert {"recall", "false_alarms_per_min", "lead_s", "in_alarm", "announced"} <= set(facts)
    assert facts["intervals"]["recall"][0] <= facts["recall"] <= facts["intervals"]["recall"][1]
    against = facts["difference"]
    assert against["to"] == "set3" and "difference" not in both[0]["set3"]
    for name in ("recall", "false_alarms_per_min"):
        value, low, high = against[name]
        assert value == pytest.approx(facts[name] - both[0]["set3"][name])
        # Only one video has time without a contact, which says nothing of others.
        assert low <= value <= high if name == "recall" else low is None is high
    assert against["comparisons"] == 2 and against["p"] == {"recall": 1.0, name: 1.0}
    for row, other in zip(csv_rows("ev0/evaluate.csv"), csv_rows("ev1/evaluate.csv"), strict=True):
        for key, text in row.items():
            if key in ("model", "at", "target", "kind", "manner", "rule"):
                assert text == other[key]
            else:
                assert float(text or NAN) == pytest.approx(
                    float(other[key] or NAN), rel=1e-6, nan_ok=True
                )
    for options in (["--set", 3], ["--fps", "9"]):
        refused = dlgmd(*common, "--results", "ba", *options)
        assert refused.exit_code == 2 and f"{options[0]} does not work" in refused.stderr
    assert read_result("ba/set9/near").params.kappa == 1e-4


def test_results_with_other_camera_angles_than_the_labels_are_told(dlgmd, runs, footage):
    runs("batch", footage, "--fov", 60, "--jobs", 1, "--out", "ba")
    lines = "near.avi,20,60,\ntwice.avi,52,,10\nstill.avi,,90,0\n"
    (footage / "angles.csv").write_text(f"video,collision_frame,fov,camera_tilt\n{lines}")
    common = "--results", "ba", "--no-baselines", "--format=none"
    told = dlgmd("evaluate", footage / "angles.csv", *common, "--out", "ev").stderr
    assert "results of 2 videos were made with other camera angles" in told
    assert "twice.avi: camera_tilt 0 instead of 10;" in told
    assert "angles" not in dlgmd("evaluate", footage / "labels.csv", *common, "--out", "no").stderr


def test_options_that_a_config_sets_are_recorded(runs, footage):
    runs("run", footage / "near.avi", "--scale", 0.5, "--end", 0.5)
    (footage / "one.csv").write_text("video,collision_frame\nnear.avi,10\n")
    more = ("--config", "dlgmd-out/near/run.yaml", "--out", "ev", "--repeats", "keep")
    runs("evaluate", footage / "one.csv", *more)
    assert recorded()["options"] == {"scale": 0.5, "end": 0.5, "repeats": "keep"}


@pytest.mark.parametrize(
    ("options", "label"), [(["--set", 3], "set3"), ([], "flight"), (["--model", "lgmd"], "lgmd")]
)
def test_results_of_one_model_have_its_name(runs, footage, options, label):
    common = ("--repeats", "keep", "--jobs", 1, "--out", "one")
    runs("batch", footage, *options, *common)
    more = ("--results", "one", "--out", "ev")
    runs("evaluate", footage / "labels.csv", *more)
    assert {row["model"] for row in csv_rows("ev/evaluate.csv")} == {label, "ΣP alone"}
    assert recorded()["models"][0]["label"] == label
    assert recorded()["options"] == {"repeats": "keep"}


@pytest.mark.parametrize(
    ("model", "options"), [(3, {}), ("lgmd", {}), (9, {"normalise": "sequence"}), ("flight", {})]
)
@pytest.mark.parametrize("repeats", ["skip", "keep"])
def test_alarms_are_those_of_a_run(footage, model, options, repeats):
    """With repeats, of which the still scene and the slow beginning have many, and without."""
    found = dlgmd_cli.run(footage / "twice.avi", model, repeats=repeats, **options)
    level = np.sort(found.level[np.isfinite(found.level)])[-4]
    ttc_alarm = float(np.sort(found.ttc_s)[3])  # exactly a time that is estimated
    changes = {"t_mp": max(float(level) - 1e-9, 1e-6), "n_sp": 1, "ttc_alarm": ttc_alarm}
    found = judged_anew(replace(found, params=replace(found.params, **changes)))
    evaluation = Candidates(baselines=False)
    evaluation.add(Case("twice.avi", "", (Label("twice.avi", 51),)), {"x": found})
    one = evaluation.by_label["x"]
    level = one.rule.strength_at(one.rule.threshold)
    rows = alarms(one.signals["twice.avi"], one.n_sp, level).row.tolist()
    assert rows == found.alarm_onsets.tolist() and rows
    assert found.is_repeat.any() == (repeats == "skip")


def test_a_video_that_fails_is_named_and_the_others_are_scored(dlgmd, footage, tmp_path):
    labels = footage / "more.csv"
    labels.write_text("video,collision_frame\nnear.avi,19\ngone.avi,3\nstill.avi,500\n")
    result = dlgmd("evaluate", labels, *SETS, "--json", "--format=none", "--no-baselines")
    assert result.exit_code == 1 and "2 of 3 videos" in result.stderr
    found = json.loads(result.stdout)
    assert found["videos"] == 1 and list(found["failed"]) == ["gone.avi", "still.avi"]
    for name, why in (("gone.avi", f"it is not in {footage}"), ("still.avi", "frames 0 to 11")):
        assert name in result.stderr and why in found["failed"][name]
    labels.write_text("video,collision_frame\ngone.avi,3\n")
    alone = dlgmd("evaluate", labels, "--out", "x")
    assert alone.exit_code == 1 and not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ("", "lists no video"),
        ("a.mp4,3\na.mp4,3\n", "a.mp4 is listed twice with frame 3"),
        ("a.mp4,\na.mp4,\n", "a.mp4 is listed twice with no frame"),
    ],
)
def test_labels_that_contradict_themselves(tmp_path, rows, why):
    path = tmp_path / "labels.csv"
    path.write_text(f"video,collision_frame\n{rows}")
    with pytest.raises(ResultError, match=why):
        read_cases(path)


def test_a_video_and_a_link_to_it_are_one(tmp_path):
    (tmp_path / "a.mp4").touch()
    (tmp_path / "link.mp4").symlink_to("a.mp4")
    path = tmp_path / "labels.csv"
    path.write_text("video,collision_frame\na.mp4,3\nlink.mp4,\n")
    with pytest.raises(ResultError, match="is listed with a collision and without one"):
        read_cases(path)
    path.write_text("video,collision_frame\nlink.mp4,9\na.mp4,3\n")
    (case,) = read_cases(path)
    assert (case.name, case.collisions) == ("link.mp4", (3, 9))
    known = read_by_video(path)
    for name in ("a.mp4", "link.mp4", "/elsewhere/link.mp4", "/elsewhere/a.mp4"):
        assert collision_frames(labels_of(known, str(tmp_path / name))) == [9, 3]


def test_several_collisions_of_a_video_and_groups_of_targets(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text(
        "video,collision_frame,target\na.mp4,90,wall\nb.mp4,,chair\na.mp4,40,chair\nc.mp4,7,\n"
    )
    cases = read_cases(path)
    both = Label("a.mp4", 40, "chair"), Label("a.mp4", 90, "wall")
    assert cases[0] == Case("a.mp4", str(tmp_path / "a.mp4"), both)
    found = {name: {i: m.tolist() for i, m in one.items()} for name, one in groups(cases).items()}
    assert found == {
        ("target", "all"): {0: [True, True], 1: [], 2: [True]},
        ("target", "all without walls"): {0: [True, False], 1: [], 2: [True]},
        ("target", "chair"): {0: [True, False], 1: []},
        ("target", "wall"): {0: [False, True]},
    }


def test_a_kind_that_all_have_is_no_group_and_neither_is_an_unknown_manner():
    labels = Label("a", 5, "", "real", "walk"), Label("b", None, "", "real")
    cases = [Case(label.video, "", (label,)) for label in labels]
    assert list(groups(cases)) == [("target", "all"), ("manner", "walk")]


def test_labels_have_speeds_angles_and_starts(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text(
        "video,collision_frame,speed_m_s,approach_start,fov,brake\na.mp4,30,2.5,10,,1.7s\n"
    )
    (case,) = read_cases(path)
    assert case.labels == (Label("a.mp4", 30, speed_m_s=2.5, approach_start=10, brake="1.7s"),)
    write_labels(path, case.labels)
    assert path.read_text().splitlines()[0] == (
        "video,collision_frame,approach_start,speed_m_s,brake,target,kind,manner"
    )
    assert read_cases(path) == [case]
    path.write_text("video;collision_frame;speed_m_s;approach_start;brake\na.mp4;30;2,5;10;1,7s\n")
    assert read_cases(path) == [case]
    for cells, why in (
        ("30,0,", "speed_m_s: 0.0 is not above 0"),
        ("30,fast,", "speed_m_s: 'fast' is no number"),
        ("30,,31", "the approach starts after the collision"),
        ("30,,x", "line 2, column approach_start: 'x' is not a frame"),
        (
            "30,2,,ardupilot",
            "line 2, column brake: 'ardupilot' is not a number. Write arducopter, ",
        ),
    ):
        path.write_text(f"video,collision_frame,speed_m_s,approach_start,brake\na.mp4,{cells}\n")
        with pytest.raises(ResultError, match=why):
            read_cases(path)


def test_the_times_of_contacts_and_approaches(footage):
    found = dlgmd_cli.run(footage / "near.avi", 9, repeats="keep")
    labels = (Label("near.avi", 15, approach_start=5), Label("near.avi", 21, speed_m_s=2.0))
    case = Case("near.avi", "", labels, near=(3, 4, 99))
    known = signal_of(found, case, Stopping())
    slow = signal_of(found, case, Stopping(speed_m_s=1.0))
    first, second = known.contacts
    assert (first.from_s, first.until_s, first.time_s) == pytest.approx((0.2 - 1.0, 0.6, 0.6))
    assert second.until_s == pytest.approx(21 / 25 - Stopping().brake.stop_s(2.0))
    assert second.from_s == second.until_s - 1.5
    assert [one.has_speed for one in (first, second, *slow.contacts)] == [False, True, True, True]
    assert known.near_s.tolist() == pytest.approx([3 / 25, 4 / 25])


def test_kinds_and_manners_have_rows_of_their_own(runs, footage):
    labels = footage / "kinds.csv"
    labels.write_text(
        "video,collision_frame,kind,manner\nnear.avi,20,rendered,\ntwice.avi,20,real,walk\n"
        "twice.avi,52,real,walk\nstill.avi,,rendered,\n"
    )
    more = ("--max-false-per-min", 0, "--no-baselines")
    result = runs("evaluate", labels, *SETS[2:], *more, "--out", "ev", plots=True)
    rows = csv_rows("ev/evaluate.csv")
    by_kind = {(r["at"], r["kind"]): r for r in rows if r["manner"] == "all"}
    assert [by_kind["default", kind]["videos"] for kind in ("all", "real", "rendered")] == [*"312"]
    assert int(by_kind["best", "all"]["false_alarms"]) == 0
    assert {row["manner"] for row in rows} == {"all", "walk"}
    assert {row["kind"] for row in csv_rows("ev/curves.csv")} == {"all", "real", "rendered"}
    assert recorded()["max_false_per_min"] == 0
    assert " rendered " in result.stdout and "By manner, announced" in result.stdout
    assert "Not drawn: recall over false alarms needs 10 contacts." in result.stdout.splitlines()
    assert "trade-off" not in result.stdout  # three contacts
    figure = dlgmd_cli.evaluate(labels, 9, jobs=1, baselines=False).plot("trade-off")
    names = [text.get_text() for text in figure.legends[0].get_texts()]
    assert "set9, real" in names and "set9, rendered" not in names  # of one contact
    labels.write_text("video,collision_frame\nnear.avi,20\n")
    with pytest.raises(ParameterError, match="needs 2 contacts"):
        dlgmd_cli.evaluate(labels, 9, jobs=1, baselines=False).plot("trade-off")


def test_the_rule_ttc_is_scored_by_the_time_to_contact(runs, footage):
    common = ("--no-baselines", "--format=none", "--jobs", 1, "--repeats", "keep")
    common += ("--max-false-per-min", 20)  # the first of two approaches may raise one
    times = ("--alarm", "ttc", "--param", "ttc_alarm=0.5")
    labels, models = footage / "labels.csv", {}
    by_time = {"flight": ("--alarm", "ttc"), "ttc": ("--set", 9, *times), "nine": ("--set", 9)}
    for out, options in by_time.items():
        made = runs("evaluate", labels, *options, *common, "--json", "--out", out)
        models |= {out: json.loads(made.stdout)["models"]}
    (label,) = models["ttc"]
    assert label == "set9 ttc_alarm=0.5 alarm=ttc" and [*models["flight"]] == ["flight alarm=ttc"]
    facts = models["ttc"][label]
    assert (facts["rule"], facts["threshold"], facts["n_sp"]) == ("ttc", 0.5, 1)
    # The measurement is the same beside both; so is what is best, and the whole curve.
    ours, theirs = ([*csv_rows(f"{name}/curves.csv")] for name in ("flight", "ttc"))
    assert [{**row, "model": ""} for row in ours] == [{**row, "model": ""} for row in theirs]
    assert {(row["rule"], row["excitation"]) for row in ours} == {("ttc", "")}
    thresholds = [float(row["threshold"]) for row in ours]
    assert thresholds == sorted(thresholds, reverse=True) and thresholds[-1] > 0.0
    assert facts["best"] == models["flight"]["flight alarm=ttc"]["best"]
    assert {row["rule"] for row in csv_rows("ttc/alarms.csv")} == {"ttc"}
    assert models["nine"]["set9"]["rule"] == "spikes"
    # A run with a threshold of the curve has the hits that the curve says.
    params = {"alarm": "ttc", "ttc_alarm": facts["best"]["threshold"]}
    hits = 0
    for name, first, contact in (("near.avi", 0, 20), ("twice.avi", 27, 52)):
        own = dlgmd_cli.run(footage / name, 9, param=params, repeats="keep")
        onsets = own.frame[own.alarm_onsets]
        hits += ((onsets >= first) & (onsets < contact)).any()
    assert facts["best"]["hits"] == hits == 2


def test_baselines_do_not_depend_on_the_models(runs, footage):
    found = {}
    for name, models in {"flight": (), "nine": ("--set", 9)}.items():
        common = ("evaluate", footage / "labels.csv", *models, "--out", name)
        runs(*common, "--jobs", 1)
        rows = csv_rows(f"{name}/evaluate.csv")
        found[name] = [r for r in rows if r["model"] in BASELINES]
    assert found["flight"] == found["nine"] and found["nine"]
    sums = [float(row["threshold"]) for row in found["nine"] if row["model"] == "ΣP alone"]
    assert sums and 0.0 < max(sums) < 1.0  # a mean over the cells, in luminance


def test_where_there_is_nothing_to_announce_no_threshold_is_best(runs, footage):
    labels = footage / "none.csv"
    labels.write_text("video,collision_frame\nstill.avi,\n")
    made = runs("evaluate", labels, "--out", "none", "--jobs", 1)
    best = [row for row in csv_rows("none/evaluate.csv") if row["at"] == "best"]
    assert [row["threshold"] for row in best] == ["inf", "inf", "inf"]
    assert made.stdout.count("none *") == 3


def test_the_figure_of_the_leads_names_the_thresholds(footage):
    found = dlgmd_cli.evaluate(footage / "labels.csv", 9, jobs=1)
    words = [text.get_text() for text in found.plot("leads").legends[0].get_texts()]
    assert words == [
        "set9, default threshold",
        *(f"{one}, best (optimistic)" for one in BASELINES),
    ]


def test_variants_labels_and_parameters_are_named(runs, footage):
    labels = footage / "near.csv"
    labels.write_text("video,collision_frame\nnear.avi,20\n")

    def models(*options):
        more = ("--no-baselines", "--format=none", "--jobs", 1, "--overwrite", "--out", "ev")
        runs("evaluate", labels, *options, *more)
        return list(dict.fromkeys(row["model"] for row in csv_rows("ev/evaluate.csv")))

    assert models("--set", 9, "--variant", "weak:kappa=0.1") == ["set9", "weak"]
    assert models("--set", 9, "--param", "kappa=0.1") == ["set9 kappa=0.1"]
    two = ("--set", 3, "--set", 9, "--variant", "weak:kappa=0.1")
    assert models(*two) == ["set3", "set3_weak", "set9", "set9_weak"]
    named = (word for name in "abcd" for word in ("--label", name))
    assert models(*two, *named) == [*"abcd"]


@pytest.mark.parametrize("name", ["batch", "evaluate"])
def test_the_example_of_a_docstring_runs(footage, name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(footage, "flights", dirs_exist_ok=True)
    names = {name: getattr(dlgmd_cli, name)}
    examples = DocTestParser().get_examples(names[name].__doc__)
    for example in examples:
        exec(compile(example.source, name, "single"), names)
    assert len(examples) >= 2
