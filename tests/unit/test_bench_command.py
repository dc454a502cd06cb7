"""`dlgmd bench`: what it measures adds up; how long things take is not tested."""

import json

import numpy as np
import pytest
from conftest import N_FRAMES, csv_rows

from dlgmd_cli.tasks import bench as benchmark

ONE_CELL = ["--radius", 2, "--scale", 0.5, "--repeat", 1]


def test_every_combination_is_measured(runs, clips):
    options = ["--radius", 3, "--radius", 2, "--scale", 1, "--scale", 0.5, "--repeat", 2]
    result = runs("bench", clips / "loom.avi", *options, "--json", "--csv", "b.csv")
    found = json.loads(result.stdout)
    assert found["frames"] == N_FRAMES and found["decoding_alone_ms"] > 0.0
    keys = [(row["radius"], row["scale"], row["width"], row["height"]) for row in found["rows"]]
    assert keys == [(3, 1.0, 32, 24), (3, 0.5, 16, 12), (2, 1.0, 32, 24), (2, 0.5, 16, 12)]
    for row in found["rows"]:
        assert row["engine"] == "opencv"
        assert row["paper_s"] is None and row["ratio"] is None  # not the paper's frames
        assert min(row["core_ms"], row["decode_ms"], row["whole_ms"]) > 0.0
        assert row["frames_per_s"] == pytest.approx(1000 / row["whole_ms"])
        assert row["whole_s"] == pytest.approx(0.120 * row["whole_ms"])
    for row, other in zip(csv_rows("b.csv"), found["rows"], strict=True):
        assert row["engine"] == other["engine"] and row["paper_s"] == row["ratio"] == ""
        assert float(row["whole_ms"]) == pytest.approx(other["whole_ms"], rel=1e-8)


def test_every_column_holds_what_it_says(dlgmd, runs, clips, monkeypatch):
    def ms_per_frame(video, act):
        if act.func is benchmark.run_models:
            return 5.0
        return 3.0 if act.args[0] is video else 2.0

    monkeypatch.setattr(benchmark, "_ms_per_frame", ms_per_frame)
    found = json.loads(runs("bench", clips / "loom.avi", *ONE_CELL, "--json").stdout)
    (row,) = found["rows"]
    assert (row["whole_ms"], row["decode_ms"]) == (5.0, 3.0)
    assert (row["frames_per_s"], row["whole_s"]) == (200.0, 0.6)
    assert found["decoding_alone_ms"] == 2.0
    shown = dlgmd("bench", clips / "loom.avi", *ONE_CELL).stdout
    assert "2.000 ms per frame (opencv)" in shown and "2.50 times as long at 16x12" in shown


def test_too_few_frames_warnings_and_an_interruption(dlgmd, runs, clips, cut, tmp_path, stop):
    result = dlgmd("bench", clips / "short.avi", *ONE_CELL)
    assert result.exit_code == 1 and "short.avi: 3 frames are too few" in result.stderr
    result = runs("bench", cut, *ONE_CELL)
    assert result.stderr.count(f"Warning: {cut}: ") == 1
    stop()
    result = dlgmd("bench", clips / "loom.avi", *ONE_CELL, "--csv", "b.csv")
    assert result.exit_code == 130 and not (tmp_path / "b.csv").exists()


def test_in_the_paper_a_smaller_kernel_and_a_smaller_image_take_less_time():
    """Table IV as it is kept: a number that is copied wrongly breaks this order."""
    table = np.array([[benchmark.PAPER_S[r, x] for x in benchmark.SCALES] for r in benchmark.RADII])
    assert (np.diff(table, axis=0) <= 0.0).all() and (np.diff(table, axis=1) < 0.0).all()
