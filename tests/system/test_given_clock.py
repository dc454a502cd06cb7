"""Commands and functions over videos whose true times are given."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import FPS, csv_rows, looming_frames, yaml_of

import dlgmd_cli

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_given_times import TIMES_S, table

SHORT = ["--fps", "all", "--format", "none"]


def times_of(folder):
    return np.array([float(row["time_s"]) for row in csv_rows(folder / "mp.csv")])


@pytest.mark.parametrize("name", ["loom.avi", "loom.mp4"])
def test_the_given_rate_holds(dlgmd, clips, tmp_path, decoder, name):
    done = dlgmd("run", clips / name, "--input-fps", "500", "--decoder", decoder, *SHORT)
    assert done.exit_code == 0, done.output
    assert "it states 25 frames/s; --input-fps 500 holds" in done.stderr
    record = yaml_of(tmp_path / "dlgmd-out/loom/run.yaml")
    assert record["input"]["fps"] == 500
    assert record["options"]["input_fps"] == 500
    assert record["input"]["duration_s"] == pytest.approx(20 / 500)
    assert not record["warnings"]


def test_every_command_takes_the_table(dlgmd, clips, tmp_path):
    path = table(tmp_path / "x.csv")
    for name, more in {"run": SHORT, "compare": SHORT, "layers": ["--frames", "0"]}.items():
        done = dlgmd(name, clips / "loom.avi", "--times", path, "--set", "9", *more, "-o", name)
        assert done.exit_code == 0, done.output
        assert "x.csv is the clock, 500 frames/s, in place of its own" in done.stderr
        (record,) = (yaml_of(found) for found in tmp_path.rglob(f"{name}.yaml"))
        assert record["options"]["times"] == str(path)
        assert len(record["options"]["times_sha256"]) == 64


def test_the_expansion_follows_the_rate_and_the_membrane_potential_does_not():
    frames = np.stack(looming_frames(24, 96, 72))
    slow = dlgmd_cli.run(frames, input_fps=30)
    fast = dlgmd_cli.run(frames, input_fps=300)
    np.testing.assert_array_equal(slow.mp, fast.mp)
    np.testing.assert_allclose(slow.time_s, 10 * fast.time_s)


@pytest.mark.usefixtures("here")
def test_a_batch_and_an_evaluation_take_the_table_beside_a_video(dlgmd, clips, tmp_path):
    folder = tmp_path / "flights"
    folder.mkdir()
    for name in ("a.avi", "b.avi"):
        shutil.copy(clips / "loom.avi", folder / name)
    table(folder / "a.times.csv")
    command = ["batch", folder, *SHORT, "--set", "9", "-o", tmp_path / "o"]
    assert dlgmd(*command).exit_code == 0
    np.testing.assert_allclose(times_of(tmp_path / "o" / "a"), TIMES_S)
    np.testing.assert_allclose(times_of(tmp_path / "o" / "b"), np.arange(20) / FPS)
    assert "2 done (2 before)" in dlgmd(*command).output
    table(folder / "a.times.csv", TIMES_S + 1)
    assert "other settings (times)" in dlgmd(*command).stderr
    (folder / "labels.csv").write_text("video,collision_frame\na.avi,19\n")
    model = ["--set", "9", "--no-baselines", "--fps", "all", "--format", "none", "--out"]
    done = dlgmd("evaluate", folder / "labels.csv", *model, tmp_path / "e")
    assert done.exit_code == 0, done.output
