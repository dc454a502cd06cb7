"""`dlgmd sweep`: its numbers are those of `run`, and it says what it does."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
from conftest import N_FRAMES, csv_rows, looming_frames, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli.tasks.sweep import sweep as sweeps

CUBES = os.path.join("dlgmd-out", "sweep-translating-cubes")
FILES = {"sweep.csv", "sweep.yaml"}
SMALL = ["--size", "40x30", "--cube-size", 8, "--jobs", 1]
TINY = [*SMALL, "--x", "sigma_e=0.5,1", "--y", "sigma_i=1.5:2.5:0.5"]


def record(folder):
    return yaml_of(Path(folder, "sweep.yaml"))


def summary_of_run(runs, *arguments):
    result = runs("run", *arguments, "--json", "--overwrite")
    return json.loads(result.stdout)


def test_the_table_and_the_figure_name_the_model(runs, clips):
    grid = {"x": "a=1,2", "y": "r=2", "jobs": 1}
    found = dlgmd_cli.sweep(clips / "loom.avi", model=9, **grid)
    assert found.plot().get_suptitle() == "loom · set9"
    result = runs(
        "sweep", clips / "loom.avi", "--set", 9, "--x", "a=1,2", "--y", "r=2", "--jobs", 1
    )
    assert result.stdout.split()[:2] == ["set9", "least"]


def test_several_inputs_have_a_folder_each_and_one_figure(runs, clips):
    paths = [clips / "loom.avi", write_video(Path("away.avi"), looming_frames()[::-1])]
    more = ("--set", 9, "--x", "a=1,2", "--y", "r=2", "--jobs", 1)
    told = runs("sweep", *paths, *more, "--format", "svg")
    assert {*os.listdir("dlgmd-out")} == {"sweep-loom", "sweep-away", "sweeps.svg"}
    assert told.stdout.endswith("sweeps.svg\n")
    found = dlgmd_cli.sweeps(paths, 9, x="a=1,2", y="r=2", jobs=1)
    titles = [axes.get_title("left") for axes in found.plot().axes]
    assert titles[:2] == ["loom", "away"] == [result.name for result in found.results]


def test_two_inputs_of_one_name_are_refused_before_one_replaces_the_other(dlgmd, clips):
    paths = [clips / "loom.avi", Path("other/loom.avi")]
    result = dlgmd("sweep", *paths, "--set", 9, "--x", "a=1,2", "--y", "r=2", "--overwrite")
    assert result.exit_code == 2 and not Path("dlgmd-out").exists()
    assert "two inputs are called loom. Sweep them one at a time" in result.stderr


def test_attenuation_is_that_of_the_paper_s_fig_11(runs):
    grid = ["--x", "sigma_e=1.1", "--y", "sigma_i=1.5"]
    runs("sweep", *grid)
    found = [round(float(row["attenuation_db"]), 1) for row in csv_rows(f"{CUBES}/sweep.csv")]
    assert found == [-12.8, -0.8, 1.4, 2.3]
    cubes = {"speeds_px": [1.0, 2.0, 3.0, 4.0], "side_px": 40.0, "frames": 41}
    assert record(CUBES)["sweep"]["cubes"] == {**cubes, "width": 200, "height": 150}


def test_cubes_are_what_run_says_of_their_clip(runs):
    grid = ["--x", "sigma_e=1.1", "--y", "r=4,9", "--speed", 3, "--param", "sigma_i=1.5"]
    runs("sweep", *grid, "--jobs", 1)
    found = {int(r["r"]): r["attenuation_db"] for r in csv_rows(f"{CUBES}/sweep.csv")}
    clip = "synth translating-cubes --speed 3 --size 200x150 --contrast -1 --background 1"
    runs(*clip.split(), "--object-size", 40, "--frames", 53)
    changed = {"alpha": 0, "beta": 0, "lam": 0, "sigma_e": 1.1, "sigma_i": 1.5, "r": 4}
    params = [text for key, value in changed.items() for text in ("--param", f"{key}={value}")]
    summary = summary_of_run(runs, "translating-cubes.avi", "--set", 9, "--scale", 1, *params)
    assert found[4] == f"{summary['mean_attenuation_db']:.9g}"


SEQUENCE = "preset: flight\nkappa: 100\nn_sp: 1\noptions: {normalise: sequence, size: 24x18}\n"


@pytest.mark.parametrize("options", [[], ["--config", "seq.yaml"]], ids=["absolute", "sequence"])
def test_a_video_is_what_run_says(runs, clips, options):
    Path("seq.yaml").write_text(SEQUENCE)
    grid = ["--x", "r=2:6:2", "--y", "sigma_i=1,5", "--param", "a=0.8", "--jobs", 1]
    runs("sweep", clips / "loom.avi", *grid, *options)
    found = {(r["r"], r["sigma_i"]): r for r in csv_rows("dlgmd-out/sweep-loom/sweep.csv")}
    assert list(found) == [(r, s) for s in ("1", "5") for r in ("2", "4", "6")]
    columns = list(found["2", "1"])
    assert columns == ["r", "sigma_i", *sweeps.RESPONSE_COLUMNS]
    params = ["--param", "r=6", "--param", "sigma_i=5", "--param", "a=0.8", "--alarm", "spikes"]
    summary = summary_of_run(runs, clips / "loom.avi", *params, *options)
    row = found["6", "5"]
    for column in set(columns) & set(summary):
        value = summary[column]
        assert row[column] == ("" if value is None else f"{value:.9g}"), column
    assert row["first_alarm_frame"] != "" or not options
    mp = [float(line["mp"]) for line in csv_rows("dlgmd-out/loom/mp.csv")[3:] if line["mp"]]
    assert float(row["sharpness"]) == pytest.approx(np.mean(mp) / max(mp), rel=1e-6)
    assert row["distinguishability"] == ""


def test_the_released_code_sees_every_frame_as_in_a_run(tmp_path):
    twice = [frame for frame in looming_frames(24, 96, 72) for _ in range(2)]
    video = write_video(tmp_path / "twice.avi", twice, fourcc="FFV1")
    found = dlgmd_cli.sweep(video, x="formulation=default,released-2021", y="a=1", model=9, jobs=1)
    alone = dlgmd_cli.run(video, model=9, formulation="released-2021", param={"a": 1})
    assert found.columns["mp_max"][0, 0, 1] == alone.summary["mp_max"] > 0.0


def test_distinguishability_may_be_infinite_and_that_is_said(runs, tmp_path):
    frames = looming_frames(24, 96, 72)
    write_video(tmp_path / "late.avi", frames[:1] * 14 + frames, fourcc="FFV1")
    grid = ["--set", 9, "--x", "sigma_e=1,1.5", "--y", "a=0.5,100", "--jobs", 1]
    result = runs("sweep", "late.avi", *grid, "--false-positive-frame", 5)
    assert "inf: the membrane potential is 0 within 5 frames of the false positive" in result.stdout
    found = [row["distinguishability"] for row in csv_rows("dlgmd-out/sweep-late/sweep.csv")]
    assert found == ["inf", "inf", "", ""]


def test_points_that_are_not_possible_are_cells_without_a_value(runs):
    grid = ["--x", "alpha=-1,0", "--y", "sigma_e=0,1", "--speed", 2]
    result = runs("sweep", *SMALL, *grid)
    warnings = [line for line in result.stderr.splitlines() if line.startswith("Warning")]
    assert warnings == ["Warning: 2 of 4 points cannot be computed: sigma_e = 0.0 is not above 0."]
    found = {
        (r["alpha"], r["sigma_e"]): r["attenuation_db"] for r in csv_rows(f"{CUBES}/sweep.csv")
    }
    assert [bool(value) for value in found.values()] == [False, False, True, True]
    assert record(CUBES)["summary"] == {"points": 4, "computed": 2, "impossible": 2}
    assert record(CUBES)["options"] == {}  # the size is that of the cubes


def test_the_record_has_the_grid_and_the_options(runs, clips):
    options = ["--x", "r=2,3", "--y", "a=1,1.5", "--param", "sigma_e=0.5", "--size", "24x18"]
    runs("sweep", clips / "loom.avi", *options, "--jobs", 1)
    found = record("dlgmd-out/sweep-loom")
    assert found["sweep"] == {
        "x": {"key": "r", "values": [2, 3]},
        "y": {"key": "a", "values": [1.0, 1.5]},
        "false_positive_frame": None,
    }
    assert found["input"]["frames"] == found["processed"]["frames"] == N_FRAMES
    assert found["processed"]["width"] == 24 and found["options"] == {"size": "24x18"}
    assert (found["complete"], found["sigma_e"]) == (True, 0.5)
    assert found["versions"].keys() == {"dlgmd", "python", "numpy", "opencv"}


def test_an_interrupted_sweep_writes_nothing(dlgmd, stop, monkeypatch):
    measured = sweeps.measured

    def stopping(*arguments):
        stop()
        return measured(*arguments)

    monkeypatch.setattr(sweeps, "measured", stopping)
    result = dlgmd("sweep", *TINY, "--speed", 1)
    assert (result.exit_code, result.stderr) == (130, "Interrupted.\n")
    assert not Path("dlgmd-out").exists()


def test_warnings_of_the_input_are_kept(runs, tmp_path):
    write_video(tmp_path / "still.avi", looming_frames(1) * 8)
    result = runs("sweep", "still.avi", "--x", "r=2,3", "--y", "a=1,2", "--jobs", 1)
    assert "Warning: still.avi: nothing can be seen: all frames are the same" in result.stderr
    assert len(record("dlgmd-out/sweep-still")["warnings"]) == 1
    found = csv_rows("dlgmd-out/sweep-still/sweep.csv")
    assert {(r["mp_max"], r["sharpness"], r["mean_attenuation_db"]) for r in found} == {
        ("0", "", "")
    }
