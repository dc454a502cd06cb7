"""`dlgmd evaluate` on tiny clips: tables, JSON, stored results, what goes wrong."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
import yaml
from conftest import looming_frames, write_video

import dlgmd_cli
from dlgmd_cli import read_result
from dlgmd_cli.errors import ResultError
from dlgmd_cli.lab.evaluation.cases import Case, Evaluation, read_cases
from dlgmd_cli.lab.evaluation.report import groups
from dlgmd_cli.lab.evaluation.scoring import alarms

STILL = [looming_frames(1)[0]] * 12


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """Three clips: a square that looms, one that looms twice, and a still scene; and labels."""
    folder = tmp_path_factory.mktemp("footage")
    loom = looming_frames()
    write_video(folder / "near.avi", loom)
    write_video(folder / "twice.avi", [*loom, *STILL, *loom])
    write_video(folder / "still.avi", STILL)
    text = "video,collision_frame,target\nnear.avi,20,wall\ntwice.avi,52,chair\nstill.avi,,chair\n"
    (folder / "labels.csv").write_text(text)
    return folder


def table(path):
    with open(path, encoding="utf-8") as file:
        return list(csv.DictReader(file))


COMMON = ("--param", "kappa=1e-4", "--jobs", 1, "--repeats", "keep")


def test_files_and_tables(dlgmd, footage, tmp_path):
    result = dlgmd(
        *["evaluate", footage / "labels.csv", "--set", 3, "--set", 9, *COMMON, "--out", "ev"],
        *["--format", "svg"],
    )
    assert result.exit_code == 0, result.output
    names = {path.name for path in (tmp_path / "ev").iterdir()}
    assert names == {
        *("evaluate.csv", "curves.csv", "alarms.csv", "evaluate.yaml"),
        *("evaluate-trade-off.svg", "evaluate-leads.svg"),
    }
    assert "set9" in result.stdout and "3 videos, 2 collisions" in result.stdout
    rows = table(tmp_path / "ev/evaluate.csv")
    at = [(r["model"], r["at"]) for r in rows if r["target"] == "all"]
    both = [(label, kind) for label in ("set3", "set9") for kind in ("default", "best")]
    assert at == [*both, ("ΣP alone", "best"), ("flow divergence", "best")]
    by_target = {r["target"]: r for r in rows if (r["model"], r["at"]) == ("set3", "default")}
    assert list(by_target) == ["all", "all without walls", "chair", "wall"]
    assert [r["videos"] for r in by_target.values()] == ["3", "2", "2", "1"]
    assert [r["collisions"] for r in by_target.values()] == ["2", "1", "1", "1"]
    assert by_target["all"]["threshold"] == "0.4"
    assert float(by_target["all"]["excitation"]) == pytest.approx(1e-4 * 0.4 / 0.6)
    assert float(by_target["all"]["minutes"]) == pytest.approx((20 + 52 + 12) / 25 / 60)
    assert int(by_target["all"]["false_alarms"]) == 1 == int(by_target["chair"]["false_alarms"])
    alarms = [
        (r["video"], r["kind"]) for r in table(tmp_path / "ev/alarms.csv") if r["model"] == "set3"
    ]
    assert ("twice.avi", "early") in alarms and not any("still" in name for name, _ in alarms)
    frames = [int(r["frame"]) for r in table(tmp_path / "ev/alarms.csv") if r["kind"] == "missed"]
    assert set(frames) == {20, 52}
    hits = sum(kind == "hit" for _, kind in alarms)
    assert hits == int(by_target["all"]["hits"]) > 0
    assert sum(kind == "missed" for _, kind in alarms) == 2 - hits
    curve = [r for r in table(tmp_path / "ev/curves.csv") if r["model"] == "set9"]
    assert float(curve[-1]["recall"]) == float(curve[-1]["false_alarms_per_min"]) == 0
    record = yaml.safe_load((tmp_path / "ev/evaluate.yaml").read_text(encoding="utf-8"))
    assert record["models"][1]["kappa"] == 1e-4 and record["horizon_s"] == 1.0
    again = dlgmd("evaluate", footage / "labels.csv", "--out", "ev")
    assert again.exit_code == 2 and "already exists" in again.stderr


def test_results_of_a_batch_score_as_videos_do(dlgmd, footage):
    sets = ["--set", 3, "--set", 9, *COMMON]
    assert dlgmd("batch", footage, *sets, "--no-plots", "--out", "ba").exit_code == 0
    both = []
    for source in ([*sets, "--no-baselines"], ["--results", "ba", "--no-baselines"]):
        result = dlgmd(
            "evaluate", footage / "labels.csv", *source, "--json", "--no-plots", "--overwrite"
        )
        assert result.exit_code == 0, result.output
        both.append(json.loads(result.stdout)["models"])
    assert list(both[0]) == ["set3", "set9"]
    facts = both[0]["set9"]
    assert {"recall", "false_alarms_per_min", "lead_s", "auc"} <= set(facts)
    assert facts["intervals"]["recall"][0] <= facts["recall"] <= facts["intervals"]["recall"][1]

    def flat(value):
        if isinstance(value, dict):
            return [one for key in value for one in flat(value[key])]
        if isinstance(value, list):
            return [one for part in value for one in flat(part)]
        return [value]

    for one, other in zip(flat(both[0]), flat(both[1]), strict=True):
        is_number = isinstance(one, float) and isinstance(other, float)
        assert one == (pytest.approx(other, rel=1e-6) if is_number else other)
    refused = dlgmd("evaluate", footage / "labels.csv", "--results", "ba", "--set", 3)
    assert refused.exit_code == 2 and "--set does not work with --results" in refused.stderr
    refused = dlgmd("evaluate", footage / "labels.csv", "--results", "ba", "--crop", "16x16+0+0")
    assert refused.exit_code == 2 and "--crop does not work with --results" in refused.stderr
    assert read_result("ba/set9/near").params.kappa == 1e-4


def test_options_that_a_config_sets_are_recorded(dlgmd, footage, tmp_path):
    assert dlgmd("run", footage / "near.avi", "--scale", 0.5, "--end", 0.5).exit_code == 0
    config = tmp_path / "dlgmd-out/near/run.yaml"
    (footage / "one.csv").write_text("video,collision_frame\nnear.avi,10\n")
    more = ("--no-plots", "--out", "ev", "--repeats", "keep")
    assert dlgmd("evaluate", footage / "one.csv", "--config", config, *more).exit_code == 0
    record = yaml.safe_load((tmp_path / "ev/evaluate.yaml").read_text(encoding="utf-8"))
    assert record["options"] == {"scale": 0.5, "end": 0.5, "repeats": "keep"}


@pytest.mark.parametrize(
    ("options", "label"), [(["--set", 3], "set3"), ([], "flight"), (["--model", "lgmd"], "lgmd")]
)
def test_results_of_one_model_have_its_name(dlgmd, footage, options, label):
    batch = ["batch", footage, *options, "--no-plots", "--repeats", "keep", "--jobs", 1]
    assert dlgmd(*batch, "--out", "one").exit_code == 0
    result = dlgmd(
        *["evaluate", footage / "labels.csv", "--results", "one", "--out", "ev", "--no-plots"]
    )
    assert result.exit_code == 0, result.output
    assert {row["model"] for row in table("ev/evaluate.csv")} == {label, "ΣP alone"}
    with open("ev/evaluate.yaml", encoding="utf-8") as file:
        record = yaml.safe_load(file)
    assert record["models"][0]["label"] == label and record["options"] == {"repeats": "keep"}


@pytest.mark.parametrize("options", [{"set": 3}, {"model": "lgmd"}, {"normalise": "sequence"}])
@pytest.mark.parametrize("repeats", ["skip", "keep"])
def test_alarms_are_those_of_a_run(footage, options, repeats):
    """With repeats, of which the still scene and the slow beginning have many, and without."""
    found = dlgmd_cli.run(footage / "twice.avi", repeats=repeats, **options)
    level = np.sort(found.level[np.isfinite(found.level)])[-4]
    found = replace(found, params=replace(found.params, t_mp=float(level) - 1e-9, n_sp=1))
    evaluation = Evaluation(baselines=False)
    evaluation.add(Case("twice.avi", "", (51,), ("",)), {"x": found})
    one = evaluation.candidates["x"]
    rows = [row for row, _ in alarms(one.signals["twice.avi"], one.n_sp, one.threshold)]
    assert rows == found.alarm_onsets.tolist() and rows
    assert found.is_repeat.any() == (repeats == "skip")


def test_a_video_that_fails_is_named_and_the_others_are_scored(dlgmd, footage, tmp_path):
    labels = footage / "more.csv"
    labels.write_text("video,collision_frame\nnear.avi,19\ngone.avi,3\nstill.avi,500\n")
    result = dlgmd("evaluate", labels, *COMMON, "--json", "--no-plots", "--no-baselines")
    assert result.exit_code == 1
    assert "gone.avi: there is no such file" in result.stderr
    assert "still.avi: its collision is at frame 500, but frames 0 to 11" in result.stderr
    assert "2 of 3 videos could not be scored" in result.stderr
    found = json.loads(result.stdout)
    assert found["videos"] == 1 and list(found["failed"]) == ["gone.avi", "still.avi"]
    labels.write_text("video,collision_frame\ngone.avi,3\n")
    alone = dlgmd("evaluate", labels, "--out", "x")
    assert alone.exit_code == 1 and not (tmp_path / "x").exists()


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        ("", "lists no video"),
        ("a.mp4,3\na.mp4,3\n", "a.mp4 is listed twice with frame 3"),
        ("a.mp4,\na.mp4,\n", "a.mp4 is listed twice with no frame"),
        ("a.mp4,3\na.mp4,\n", "with a collision and without one"),
    ],
)
def test_labels_that_contradict_themselves(tmp_path, rows, why):
    path = tmp_path / "labels.csv"
    path.write_text(f"video,collision_frame\n{rows}")
    with pytest.raises(ResultError, match=why):
        read_cases(path)


def test_several_collisions_of_a_video_and_groups_of_targets(tmp_path):
    path = tmp_path / "labels.csv"
    path.write_text(
        "video,collision_frame,target\na.mp4,90,wall\nb.mp4,,chair\na.mp4,40,chair\nc.mp4,7,\n"
    )
    cases = read_cases(path)
    assert cases[0] == Case("a.mp4", str(tmp_path / "a.mp4"), (40, 90), ("chair", "wall"))
    found = {name: {i: m.tolist() for i, m in one.items()} for name, one in groups(cases).items()}
    assert found == {
        "all": {0: [True, True], 1: [], 2: [True]},
        "all without walls": {0: [True, False], 1: [], 2: [True]},
        "chair": {0: [True, False], 1: []},
        "wall": {0: [False, True]},
    }
