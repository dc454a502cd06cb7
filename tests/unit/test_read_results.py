"""Stored comparisons read back, or a line that says what is wrong."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from conftest import make_result
from figures import write_comparison

from dlgmd_cli.errors import DlgmdWarning, ResultError
from dlgmd_cli.parameters.presets import load_set
from dlgmd_cli.results import csv
from dlgmd_cli.results.reading import read_comparison, read_result, read_results
from dlgmd_cli.results.record import read_record

NAN, INF = np.nan, np.inf


def test_a_comparison_has_a_result_per_label(tmp_path):
    folder = write_comparison(
        tmp_path,
        *("set9,0,0,,,0,", "lgmd,0,0,1,0.5,0,-3"),
        *("set9,3,0.1,2,0.75,1,-inf", '"a, ""b""",0,0,1,0.5,0,-3', "lgmd,3,0.1,2,0.75,1,-2"),
        labels=("set9", "lgmd", 'a, "b"'),
    )
    results = read_comparison(folder)
    assert list(results) == ["set9", "lgmd", 'a, "b"']
    nine = results["set9"]
    assert nine.frame.tolist() == [0, 3] and nine.time_s.tolist() == [0, 0.1]
    assert np.array_equal(nine.mp, [NAN, 2.0], equal_nan=True)
    assert np.array_equal(nine.attenuation_db, [NAN, -INF], equal_nan=True)
    assert nine.spikes.tolist() == [False, True] and np.isnan(nine.p_sum).all()


def test_what_is_no_comparison(tmp_path):
    with pytest.raises(ResultError, match="contains no comparison"):
        read_comparison(tmp_path)
    write_comparison(tmp_path, "set9,1,0,1,1,1,-3", "other,2,0,1,1,1,-3", labels=["set9"])
    with pytest.raises(ResultError, match=r"compare\.csv and compare\.yaml do not match"):
        read_comparison(tmp_path)
    for read in (read_result, read_comparison):
        with pytest.raises(ResultError):
            read(tmp_path / "a\0b")


def test_an_ffi_without_limit_is_read(tmp_path):
    result = make_result(np.linspace(0, 500, 60))
    result.rows["ffi"][3] = np.inf  # the model `flight`, where nothing changed before
    result.save(tmp_path)
    assert read_result(tmp_path).ffi[3] == np.inf


def test_times_that_nine_digits_do_not_tell_apart_are_kept(tmp_path):
    make_result(np.ones(3), time_s=[0.0, 1e6, 1e6 + 1e-4]).save(tmp_path)
    assert read_result(tmp_path).time_s.tolist() == [0.0, 1e6, 1e6 + 1e-4]


@pytest.fixture
def batch_of(tmp_path):
    """A batch of `approach` under two models, one with a column of its own, and of `sub/other`."""
    for place, video, model, own in (
        ("set9/approach", "approach.mp4", 9, ()),
        ("set9/sub/other", "sub/other.mp4", 9, ()),
        ("mine/approach", "approach.mp4", 3, ("loudness",)),
    ):
        rows = csv.rows_of({"frame": np.arange(0, 40, 2), "time_s": np.arange(20) / 10}, own)
        rows["mp"], rows["repeat"] = np.arange(20.0), np.arange(20) % 5 == 4
        for name in own:
            rows[name] = 7.0
        result = make_result(rows["mp"])
        params = load_set(model)
        record = {**result.record, "set": model, **params.to_dict(), "columns": [*own]}
        record["input"] = {**record["input"], "path": f"/films/{video}", "name": "x"}
        replace(result, rows=rows, params=params, record=record).save(tmp_path / "out" / place)
        (tmp_path / "out" / place.split("/")[0] / "summary.csv").write_text("video\n")
    return tmp_path / "out"


def test_a_batch_is_one_tidy_table(batch_of):
    table = read_results(batch_of)
    pairs = dict.fromkeys(zip(table["video"].tolist(), table["model"].tolist(), strict=True))
    assert [*pairs] == [
        ("approach.mp4", "set3"),
        ("approach.mp4", "set9"),
        ("sub/other.mp4", "set9"),
    ]
    assert table.dtype.names[:6] == (
        "video",
        "model",
        "frame",
        "time_s",
        "repeat",
        "to_collision_s",
    )
    assert {*csv.KNOWN, "loudness"} == {*table.dtype.names[2:]} - {"to_collision_s"}
    for video, model in pairs:
        part = table[(table["video"] == video) & (table["model"] == model)]
        folder = {"set3": "mine", "set9": "set9"}[model]
        own = read_result(batch_of / folder / video.removesuffix(".mp4")).table
        for name in own.dtype.names:
            np.testing.assert_array_equal(part[name], own[name])
        assert np.isnan(part["to_collision_s"]).all()
        assert np.isnan(part["loudness"]).all() == (model == "set9")


def test_the_time_to_a_labelled_collision_is_to_the_next_one(batch_of, tmp_path):
    labels = tmp_path / "labels.csv"
    frames = (10, 20, 1000)  # the last one is not in the result
    rows = "".join(f"/films/approach.mp4,{frame}\n" for frame in frames)
    labels.write_text("video,collision_frame\n" + rows)
    with pytest.warns(DlgmdWarning, match="the labels do not list /films/sub/other.mp4"):
        table = read_results(batch_of, labels)
    part = table[(table["video"] == "approach.mp4") & (table["model"] == "set9")]
    expected = [*(0.5 - part["time_s"][:6]), *(1.0 - part["time_s"][6:])]
    np.testing.assert_allclose(part["to_collision_s"], expected, atol=1e-12)
    assert np.isnan(table["to_collision_s"][table["video"] == "sub/other.mp4"]).all()


def test_without_labels_a_result_knows_its_collision_itself(batch_of):
    path = batch_of / "set9/sub/other/run.yaml"
    record = yaml.safe_load(path.read_text())
    record["input"]["contact_s"] = 1.5
    path.write_text(yaml.safe_dump(record))
    table = read_results(batch_of)
    is_known = table["video"] == "sub/other.mp4"
    np.testing.assert_allclose(
        table["to_collision_s"], np.where(is_known, 1.5 - table["time_s"], NAN)
    )


def test_results_of_one_video_and_model_stay_apart(batch_of):
    (batch_of / "mine").rename(batch_of / "again")
    shutil.copytree(batch_of / "again", batch_of / "more")
    models = np.unique(read_results(batch_of)["model"]).tolist()
    assert models == ["set3 · again/approach", "set3 · more/approach", "set9"]


def test_several_videos_are_no_result(batch_of, tmp_path):
    for folder in (batch_of, batch_of / "set9"):
        with pytest.raises(
            ResultError, match=r"of several videos\. Read them all with read_results"
        ):
            read_result(folder)
    with pytest.raises(ResultError, match=r"contains no run \(no run.yaml\)"):
        read_results(tmp_path / "nothing")


ENTRIES = {
    **dict.fromkeys(("options", "versions", "processed", "camera", "columns", "warnings"), 5),
    "input": [],
    "summary": "x",
    "models": [5],
    "wall_s": "slow",
    "complete": 1,
}


def damaged(path, name):
    """Change an entry of a record."""
    record = {**yaml.safe_load(path.read_text()), name: ENTRIES[name]}
    path.write_text(yaml.safe_dump(record))
    return path


@pytest.mark.parametrize("name", ENTRIES)
def test_a_damaged_record_is_named(tmp_path, name):
    make_result(np.arange(20.0)).save(tmp_path)
    path = damaged(tmp_path / "run.yaml", name)
    with pytest.raises(ResultError, match=f"run.yaml: does not state a valid {name}. Run again"):
        read_result(tmp_path)
    with pytest.warns(DlgmdWarning, match=f"run.yaml: does not state a valid {name}; it is ign"):
        assert read_record(path) == {}


def test_beside_a_damaged_record_the_rest_is_done(batch_of, dlgmd):
    damaged(batch_of / "set9/approach/run.yaml", "camera")
    for command in ("plot", "mp", batch_of), ("view", batch_of, "--out", "v.html"):
        ended = dlgmd(*command)
        assert ended.exit_code == 1 and ended.stdout, ended.output
        (line,) = (line for line in ended.stderr.splitlines() if line.startswith("Error"))
        assert "run.yaml: does not state a valid camera; it is left out" in line
