"""Each public function gives what its command writes."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from conftest import looming_frames, write_video
from flightscenes import Quick

import dlgmd_cli
from dlgmd_cli import errors
from dlgmd_cli.scenes.flights.scenes import SCENES

pytestmark = pytest.mark.slow
STILL = [looming_frames(1)[0]] * 12
NAN = float("nan")


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """Two clips in which something looms, and a still one; and labels."""
    folder = tmp_path_factory.mktemp("footage")
    write_video(folder / "near.avi", looming_frames())
    write_video(folder / "late.avi", [*STILL, *looming_frames()])
    write_video(folder / "still.avi", STILL)
    lines = ["video,collision_frame,target", "near.avi,19,box", "late.avi,31,", "still.avi,,"]
    (folder / "labels.csv").write_text("\n".join(lines))
    return folder


def assert_same(table, path, *, but=()):
    """The table has the columns and, but for some, the numbers and words of a CSV."""
    with open(path, encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    assert list(table.dtype.names) == names and len(table) == len(rows)
    for name in {*names} - {*but}:
        cells = [row[names.index(name)] for row in rows]
        if table[name].dtype.kind == "U":
            assert table[name].tolist() == cells, name
        else:
            expected = [float(text or NAN) for text in cells]
            np.testing.assert_allclose(table[name], expected, rtol=1e-8, err_msg=name)


def test_batch(runs, footage):
    command = ("batch", footage, "--set", 9, "--model", "lgmd", "--jobs", 1)
    runs(*command)
    found = dlgmd_cli.batch(footage, [9, "lgmd"], out="mine", jobs=1)
    assert found.complete and set(found.statuses.values()) == {"done"}
    for label in ("set9", "lgmd"):
        own = found.table[found.table["model"] == label]
        columns = [name for name in own.dtype.names if name != "model"]
        assert_same(own[columns], f"mine/{label}/summary.csv")
        assert_same(own[columns], f"dlgmd-out/{label}/summary.csv", but=["wall_s"])
    assert repr(found) == "<Batch of 3 videos with set9, lgmd: 3 done>"
    again = dlgmd_cli.batch([footage / "near.avi"], model=9, out="mine/set9", dry_run=True)
    assert not any(again.to_do.values())
    with pytest.raises(errors.OutputExistsError):
        dlgmd_cli.batch(footage, model=9, param={"r": 3}, out="mine/set9")


def test_evaluate(runs, footage):
    options = ("--set", 3, "--set", 9, "--param", "kappa=1e-4", "--repeats", "keep", "--jobs", 1)
    command = ("evaluate", footage / "labels.csv", *options, "--horizon", 0.5)
    runs(*command)
    named = {"param": {"kappa": 1e-4}, "repeats": "keep", "jobs": 1, "horizon": 0.5}
    report = dlgmd_cli.evaluate(footage / "labels.csv", [3, 9], **named)
    assert_same(report.table, "dlgmd-out/evaluate.csv")
    assert_same(report.curve_table, "dlgmd-out/curves.csv")
    assert_same(report.alarm_table, "dlgmd-out/alarms.csv")
    assert_same(report.ttc_table, "dlgmd-out/ttc.csv")
    assert repr(report).startswith(
        "<Evaluation on 3 videos, 2 collisions: set3 kappa=0.0001 recall"
    )
    for kind in ("trade-off", "leads"):
        assert report.plot(kind).axes
    with pytest.raises(errors.ParameterError, match="Choose from trade-off, leads"):
        report.plot("lead")
    assert not Path("evaluate.csv").exists()


def test_calibrate(runs, footage):
    labels = footage / "labels.csv"
    result = runs("calibrate", labels, "--set", 3, "--jobs", 1, "--folds", 2, "--json")
    found = dlgmd_cli.calibrate(labels, model=3, jobs=1, folds=2)
    assert found.preset == Path("dlgmd-out/calibrated.yaml").read_text("utf-8")
    facts = json.loads(result.stdout)
    assert found.params.kappa == facts["parameters"]["kappa"]
    assert found.scores["held_out"]["all"]["recall"] == facts["held_out"]["recall"]
    assert repr(found).startswith("<Calibration of set3: ") and "held out recall" in repr(found)
    assert dlgmd_cli.run(footage / "near.avi", model=found.params).params == found.params
    assert sorted(path.name for path in footage.iterdir() if path.suffix == ".yaml") == []


def test_a_film_of_layers_that_were_not_run_to_the_end(runs, footage):
    command = ("layers", footage / "near.avi", "--set", 9, "--end", 0.3, "--video", "its.mp4")
    runs(*command)
    found = dlgmd_cli.layers(footage / "near.avi", 9, frames=[3], end=0.3)
    assert repr(found) == "<LayerResult near, set9: frames 3>"
    assert found.film("mine.mp4") == 8
    assert Path("mine.mp4").read_bytes() == Path("its.mp4").read_bytes()
    images = dlgmd_cli.layers(looming_frames(), 9, frames=[], fps=25)
    assert images.film("images.mp4", overlay=True) == 20
    with pytest.raises(errors.OutputExistsError):
        images.film("mine.mp4")
    with pytest.raises(AttributeError, match="no attribute 'g'"):
        images.g  # noqa: B018


@pytest.mark.parametrize("video", [None, "near.avi"])
def test_sweep(runs, footage, video):
    place = None if video is None else footage / video
    inputs, options = ([], {"frames": 9}) if video is None else ([place], {"model": 9})
    flags = [text for key, value in options.items() for text in (f"--{key}", value)]
    axes = ("--x", "r=2,3", "--y", "sigma_e=0.5:1.5:0.5")
    runs("sweep", *inputs, *axes, *flags, "--jobs", 1)
    found = dlgmd_cli.sweep(place, x=("r", [2, 3]), y="sigma_e=0.5:1.5:0.5", jobs=1, **options)
    name = "near" if video else "translating-cubes"
    assert_same(found.table, f"dlgmd-out/sweep-{name}/sweep.csv")
    assert repr(found).startswith(f"<SweepResult {name}: r (2) x sigma_e (3); ")
    assert found.plot().axes


def test_synth_in_memory_is_the_lossless_video(runs):
    scene = ("synth", "looming-cube", "--size", "64x48", "--speed", 5, "--noise", 0.01)
    runs(*scene, "--lossless")
    clip = dlgmd_cli.synth("looming-cube", size="64x48", speed=5, noise=0.01)
    assert_same(clip.truth, "looming-cube.csv")
    stored = dlgmd_cli.run("looming-cube.avi", model=9, repeats="keep")
    assert clip.fps == 30 and clip.frames.shape == (len(stored), 48, 64)
    np.testing.assert_allclose(dlgmd_cli.run(clip.frames, fps=30, model=9).mp, stored.mp, rtol=1e-6)
    written = dlgmd_cli.synth("looming-cube", "mine", size=(64, 48), speed=5, noise=0.01)
    assert written.frames is None and written.paths[0] == Path("mine/looming-cube.mp4")
    assert repr(clip) == f"<RenderedClip looming-cube: {len(stored)} frames>"


def test_synth_of_many(runs, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    runs("synth", "quick", "--count", 3, "--jobs", 1, "--out", "its")
    flights = dlgmd_cli.synth("quick", "mine", count=3, jobs=1)
    assert_same(flights.labels, "its/labels.csv")
    assert Path("mine/labels.csv").read_text() == Path("its/labels.csv").read_text()
    assert flights.failed == {} and "3 videos, 1 with a collision" in repr(flights)
