"""`dlgmd compare`: many models on one decode, held against `dlgmd run` of each."""

import json
import math
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from conftest import csv_rows, looming_frames, write_video, yaml_of
from matplotlib.text import Text

import dlgmd_cli
from dlgmd_cli.commands import options
from dlgmd_cli.parameters.presets import MODELS
from dlgmd_cli.results import csv
from dlgmd_cli.results.reading import read_comparison
from dlgmd_cli.video.opencv_decoder import OpenCVDecoder


def rows(folder):
    """compare.csv: label -> its rows, as text."""
    found = {}
    for row in csv_rows(folder / "compare.csv"):
        assert tuple(row) == csv.COMPARISON
        found.setdefault(row["label"], []).append(row)
    return found


def record(folder):
    return yaml_of(folder / "compare.yaml")


@pytest.fixture
def labels(runs, clips):
    """The labels of the models that `compare` has for options."""

    def call(*options):
        result = runs("compare", clips / "loom.avi", *options, "--json", "--overwrite")
        return list(json.loads(result.stdout)["models"])

    return call


def test_numbers_are_those_of_run(runs, clips, tmp_path):
    (tmp_path / "my.yaml").write_text("sigma_e: 0.7\nr: 3\n")
    given = {
        "set2": ["--set", 2],
        "set9": ["--set", 9],
        "my": ["--config", "my.yaml"],
        "lgmd": ["--model", "lgmd"],
        "emd-lgmd": ["--model", "emd-lgmd"],
        "set9/released": ["--set", 9, "--param", "formulation=released-2021"],
        "my/open": ["--config", "my.yaml", "--param", "ffi_gd=false"],
    }
    options = [word for label in list(given)[:5] for word in given[label]]
    options += ["--variant", "released:formulation=released-2021", "--variant", "open:ffi_gd=false"]
    runs("compare", clips / "loom.avi", *options, "--normalise", "sequence")
    compared = rows(tmp_path / "dlgmd-out" / "loom")
    assert set(given) < set(compared) and len(compared) == 3 * 3 + 2
    summaries = {
        one["label"]: one["summary"] for one in record(tmp_path / "dlgmd-out/loom")["models"]
    }
    for number, (label, alone) in enumerate(given.items()):
        out = f"alone-{number}"
        runs(
            *["run", clips / "loom.avi", *alone, "--out", out],
            *["--normalise", "sequence"],
        )
        folder = tmp_path / out / "loom"
        potential, attenuation = csv_rows(folder / "mp.csv"), csv_rows(folder / "attenuation.csv")
        for row, mp, db in zip(compared[label], potential, attenuation, strict=True):
            mp = {key: mp[key] for key in csv.COMPARISON if key in mp}
            assert {key: row[key] for key in mp} == mp
            assert row["attenuation_db"] == db["attenuation_db"]
        summary = yaml_of(folder / "run.yaml")["summary"]
        assert {key: summaries[label][key] for key in summary} == summary


def test_a_stored_comparison_has_the_alarms_of_its_rules(runs, tmp_path):
    clip = write_video(tmp_path / "loom.avi", looming_frames(width=64, height=48))
    runs("compare", clip, "--set", 9, "--model", "lgmd", "--alarm", "ttc")
    stored = read_comparison(tmp_path / "dlgmd-out/loom")
    for label, model in (("set9", 9), ("lgmd", "lgmd")):
        own = dlgmd_cli.run(clip, model, param={"alarm": "ttc"})
        assert stored[label].alarms.tolist() == own.alarms.tolist() and own.alarms.any()
        assert record(tmp_path / "dlgmd-out/loom")["models"][0]["summary"]["rule"] == "ttc"


def test_labels(labels, tmp_path):
    sets = ("--set", 3, "--set", 9, "--set", 3)
    assert labels(*sets, "--model", "lgmd") == ["set3", "set9", "lgmd"]
    assert labels("--set", 1, "--variant", "printed:formulation=equations") == ["set1", "printed"]
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "run.yaml").write_text("formulation: equations\nffi_gd: false\n")
    one = ("--config", "a/run.yaml")
    assert labels(*one, "--config", "b/run.yaml") == ["a/run", "b/run"]
    assert labels(*one, *one) == ["run"]


@pytest.mark.painted
def test_labels_name_the_models_in_files_tables_and_figures(runs, clips, tmp_path):
    options = ["--model", "lgmd", "--set", 9, "--label", "ours", "--label", "old one"]
    result = runs("compare", clips / "loom.avi", *options, "--format", "svg")
    assert " old one " in result.stdout
    read = read_comparison("dlgmd-out/loom")
    assert [one.params.model for one in read.values()] == ["dlgmd", "lgmd"]
    assert list(read) == list(rows(tmp_path / "dlgmd-out/loom")) == ["ours", "old one"]
    runs("plot", "mp", "dlgmd-out/loom", "--out", "again.svg")
    for figure in ("dlgmd-out/loom/compare-mp", "dlgmd-out/loom/compare-attenuation", "again"):
        text = Path(f"{figure}.svg").read_text(encoding="utf-8")
        assert ">ours<" in text and ">old one<" in text


def test_one_decode(runs, clips, monkeypatch):
    counts = Counter()
    original = OpenCVDecoder.picture

    def picture(self):
        counts["picture"] += 1
        return original(self)

    monkeypatch.setattr(OpenCVDecoder, "picture", picture)
    runs("run", clips / "loom.avi", "--decoder", "opencv")
    of_run = counts["picture"]
    assert of_run >= 20
    models = ("--set", 1, "--set", 9, "--model", "lgmd", "--variant", "r3:r=3")
    runs("compare", clips / "loom.avi", *models)
    assert counts["picture"] == 2 * of_run


def test_a_run_s_file_brings_its_size(runs, clips, tmp_path):
    for name, option in (("half", ["--scale", 0.5]), ("tiny", ["--size", "9x7"])):
        runs("run", clips / "loom.avi", *option, "--out", name)
    configs = [word for name in ("half", "tiny") for word in ("--config", f"{name}/loom/run.yaml")]
    runs("compare", clips / "loom.avi", "--set", 9, *configs)
    folder = tmp_path / "dlgmd-out/loom"
    sizes = {one["label"]: (one["width"], one["height"]) for one in record(folder)["models"]}
    assert sizes == {"set9": (32, 24), "half/loom/run": (16, 12), "tiny/loom/run": (9, 7)}
    for label, name in (("half/loom/run", "half"), ("tiny/loom/run", "tiny")):
        expected = [row["mp"] for row in csv_rows(tmp_path / name / "loom" / "mp.csv")]
        assert [row["mp"] for row in rows(folder)[label]] == expected
    runs("compare", clips / "loom.avi", *configs, "--size", "32x24", "--overwrite")
    assert {(one["width"], one["height"]) for one in record(folder)["models"]} == {(32, 24)}


def test_measures_end_at_the_collision_frame(runs, clips, tmp_path):
    common = ["compare", clips / "loom.avi", "--set", 3, "--json"]
    ends = [[], ["--collision-frame", 18]]
    peaks = []
    for number, end in enumerate(ends):
        result = runs(*common, *end, "--out", f"o{number}")
        peaks.append(json.loads(result.stdout)["models"]["set3"]["mp_max_frame"])
    assert peaks[0] > 18 >= peaks[1]
    assert record(tmp_path / "o1/loom")["collision_frame"] == 18
    levels = [[row["mp_seq"] for row in rows(tmp_path / f"o{n}/loom")["set3"]] for n in (0, 1)]
    assert levels[0] == levels[1] and "" not in levels[0][3:]
    (result,) = read_comparison(tmp_path / "o1/loom").values()
    assert result.summary["mp_max_frame"] == peaks[1]


def test_a_figure_that_cannot_end_at_the_collision_loses_no_result(runs, clips, tmp_path):
    lgmd = ("compare", clips / "loom.avi", "--model", "lgmd")
    outside = runs(*lgmd, "--collision-frame", 999, plots=True)
    assert "is outside frames" in outside.stderr
    assert (tmp_path / "dlgmd-out/loom/compare-mp.png").exists()


def test_an_infinite_ratio_is_explained(dlgmd, runs, tmp_path):
    still = [np.full((24, 32), 200, np.uint8)] * 12
    write_video(tmp_path / "late.avi", still + looming_frames()[10:])
    common = ["compare", "late.avi", "--set", 9, "--false-positive-frame", 5, "--format=none"]
    result = runs(*common)
    assert "inf: the membrane potential is 0 within 5 frames of the false positive" in result.stdout
    as_json = dlgmd(*common, "--json", "--overwrite")
    assert json.loads(as_json.stdout)["models"]["set9"]["distinguishability"] == "inf"
    assert (
        record(tmp_path / "dlgmd-out/late")["models"][0]["summary"]["distinguishability"]
        == math.inf
    )


@pytest.mark.parametrize(
    ("options", "column"),
    [({}, "mp_abs"), ({"normalise": "sequence"}, "mp_seq"), ({"normalise": "absolute"}, "mp_abs")],
)
def test_what_the_figure_shows(clips, options, column):
    marks = {"marks": [(4, "pitching")], "spans": [(3, 8, "accelerating")], "collision_frame": 19}
    found = dlgmd_cli.compare(clips / "loom.avi", [1, "lgmd"], **marks, **options)
    figure = found.plot("mp", width="two")
    assert figure.get_figwidth() > found.plot("mp").get_figwidth()
    texts = [text.get_text().strip() for text in figure.findobj(Text)]
    assert {"pitching", "accelerating", "set1", "lgmd"} <= set(texts)
    lines = [line.get_ydata() for axes in figure.axes for line in axes.lines]
    for one in found.results.values():  # what decides on spikes
        curve = getattr(one, column)
        assert any(np.array_equal(line, curve, equal_nan=True) for line in lines)


def test_what_one_model_can_answer_is_kept_though_the_other_cannot(runs, clips, tmp_path):
    done = runs("compare", clips / "short.avi", "--set", 9, "--set", 1)
    found = rows(tmp_path / "dlgmd-out" / "short")
    assert [row["mp"] for row in found["set9"]] == ["", "", ""]
    assert found["set1"][2]["mp"] != "" and "set1: too few" not in done.stderr
    assert "set9: too few frames for an answer" in done.stderr


def test_equal_labels_of_different_models_are_numbered(labels, tmp_path):
    for name, width in (("set3", 0.7), ("set9", 0.9)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "own.yaml").write_text(f"sigma_e: {width}\n")
    configs = [word for name in ("set3", "set9") for word in ("--config", f"{name}/own.yaml")]
    found = labels("--set", 9, *configs, "--variant", "own:r=3")
    assert found == ["set9", "set9/own", "set3/own", "set3/own/own", "set9/own (2)", "set9/own/own"]
    read = read_comparison("dlgmd-out/loom")
    assert read["set9/own"].params.sigma_e == 1.5
    assert read["set9/own (2)"].params.sigma_e == 0.9


def test_what_a_run_s_file_records_besides_its_size_is_said_to_be_left_out(runs, clips):
    runs("run", clips / "loom.avi", "--fps", 10, "--scale", 0.5, "--out", "a")
    result = runs("compare", clips / "loom.avi", "--config", "a/loom/run.yaml")
    assert "a/loom/run.yaml: its recorded options (fps) are not used; give them" in result.stderr


def test_spikes_without_a_peak_are_shown(dlgmd, tmp_path):
    write_video(tmp_path / "still.avi", [np.full((24, 32), 200, np.uint8)] * 9)
    (tmp_path / "low.yaml").write_text("model: lgmd\nt_mp: 0.5\n")
    result = dlgmd("compare", "still.avi", "--config", "low.yaml", "--format=none")
    (row,) = [line.split() for line in result.stdout.splitlines() if line.startswith(" low")]
    assert row == ["low", "spikes", "–", "0.080", "s", "frame", "3", "–", "–"]


def test_the_collision_of_a_table(clips, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("labels.csv").write_text(f"video,collision_frame\n{clips / 'loom.avi'},18\n")
    result = dlgmd_cli.compare(clips / "loom.avi", 3, collisions="labels.csv", out="out")
    assert record(tmp_path / "out/loom")["collision_frame"] == 18 and len(result.results) == 1


def test_a_normalisation_changes_the_alarms_of_one_rule_only_and_that_is_said(dlgmd, clips):
    common = ["compare", clips / "loom.avi", "--set", 9, "--format=none", "--overwrite"]
    for more, n_told in ((["--set", "flight"], 1), (["--model", "lgmd"], 0)):
        told = dlgmd(*common, *more, "--normalise", "sequence").stderr
        assert told.count("normalise changes no alarm of the rule expansion") == n_told
    assert "changes no alarm" not in dlgmd(*common, "--set", "flight").stderr


def test_several_sets_in_one_option(labels, dlgmd, clips):
    assert labels("--set", "3,6, flight", "--set", 9) == ["set3", "set6", "flight", "set9"]
    refused = dlgmd("compare", clips / "loom.avi", "--set", "3,lgmd")
    assert refused.exit_code == 2 and "Write --model lgmd" in refused.stderr


def test_all_names_every_model_of_the_package(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = np.random.default_rng(4).integers(0, 256, (8, 24, 32), np.uint8)
    compared = dlgmd_cli.compare(frames, "all", fps=30)
    labels = [*compared.results]
    assert labels == ["set9" if name == "dlgmd" else name for name in MODELS]
    assert compared.plot("mp").axes
    named = options.named_models(("9", "3"), (), (*MODELS,))
    assert [one.label for one in named] == ["set9", "set3", *labels[1:]]
