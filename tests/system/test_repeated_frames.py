"""Duplicates of whole videos: what runs, tables, figures and other commands make of them."""

import json
import warnings
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from conftest import csv_rows, looming_frames, read_video, write_video, yaml_of

from dlgmd_cli import Alarm, read_comparison, read_result, run
from dlgmd_cli.pages.page import _result_data
from dlgmd_cli.results import csv


@pytest.fixture(scope="module")
def doubled(tmp_path_factory):
    """`once`, 30 frames a second; `twice` and `four` with repeats; `ten`, 10 images in 30."""
    folder, frames = tmp_path_factory.mktemp("doubled"), looming_frames(40, 96, 72)
    for name, times in (("once", 1), ("twice", 2), ("four", 4)):
        write_video(folder / f"{name}.avi", [f for f in frames for _ in range(times)], 30 * times)
    write_video(folder / "ten.avi", [f for f in frames for _ in range(3)], 30)
    return folder


@pytest.mark.parametrize(("name", "fps"), [("twice", None), ("four", "all")])
def test_a_video_with_repeats_gives_the_alarms_of_the_one_without(doubled, name, fps):
    times = {"twice": 2, "four": 4}[name]
    once, found = (run(doubled / f"{one}.avi", model=7, fps=fps) for one in ("once", name))
    assert once.summary["alarms"] == found.summary["alarms"] == 1
    onset = once.summary["first_alarm_frame"]
    assert found.summary["first_alarm_frame"] == times * onset
    assert found.summary["mp_max"] == once.summary["mp_max"]
    assert found.sharpness == pytest.approx(once.sharpness, rel=0.1)  # early ones are kept
    assert len(found) == (40 if fps is None else 40 * times)
    if fps == "all":
        has_numbers = np.isfinite(found.mp)
        assert not found.is_repeat[~has_numbers].any()
        # Before the first change, none is known to be a duplicate.
        n_new = (has_numbers & ~found.is_repeat).sum()
        assert n_new == np.isfinite(once.mp).sum() + times - 1
        rows = np.flatnonzero(found.is_repeat)
        for column in ("mp", "p_sum", "spikes", "alarms"):
            values = getattr(found, column).astype(float)
            np.testing.assert_array_equal(values[rows], values[rows - 1])
    kept = run(doubled / f"{name}.avi", model=7, fps="all", repeats="keep")
    assert kept.summary["alarms"] == 0 and "repeats" not in kept.record["input"]


def test_every_frame_of_the_released_code_is_kept(doubled):
    released = run(doubled / "four.avi", model=7, formulation="released-2021")
    assert len(released) == 160 and "repeats" not in released.record["input"]


def test_of_what_is_stored_without_loss_equal_images_are_skipped_if_asked(dlgmd, tmp_path):
    frames = [frame for view in looming_frames(30, 96, 72) for frame in (view, view)]
    (tmp_path / "pictures").mkdir()
    for number, frame in enumerate(frames):
        cv2.imwrite(f"pictures/{number:03d}.png", frame)
    np.save("pan.npy", frames)
    write_video(tmp_path / "pan.avi", frames, 60, fourcc="FFV1")
    given = ["pictures", "pan.npy", "pan.avi", np.array(frames)]

    def every(one):  # of an array, `fps` is the rate
        return {} if isinstance(one, np.ndarray) else {"fps": "all"}

    for each in given:
        kept = run(each, 7, **every(each))
        assert not kept.is_repeat.any() and "repeats" not in kept.record["input"]
        (note,) = [line for line in kept.warnings if "equal" in line]
        assert note.startswith("30 of 60 images equal the one before, and are processed (repeats=")
    found = [run(one, 7, repeats="skip", **every(one)) for one in given]
    for result in found:
        assert np.array_equal(result.is_repeat, found[0].is_repeat)
        assert np.array_equal(result.mp, found[0].mp, equal_nan=True)
        assert result.record["input"]["repeats"] == 30
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of steps without times
        alarms = Alarm(7, repeats="skip"), Alarm(7)
        steps = [[alarm.step(frame).mp for frame in frames] for alarm in alarms]
    np.testing.assert_array_equal(steps, [found[0].mp, kept.mp])


# A frame far from the peak, whose MP is not 0.
OTHER = 6


def numbers_of(new):
    """What a reader computes from the rows of new images."""
    db = new.attenuation_db.replace([np.inf, -np.inf], np.nan)
    defined = new[new.attenuation_db.notna()]
    mp, peak = new.mp, new.mp.idxmax()
    near = {at: mp[(new.frame - at).abs() <= 5].mean() for at in (new.frame[peak], OTHER)}
    return {
        "spikes": new.spike.sum(),
        "first_spike_time_s": new.time_s[new.spike == 1].iloc[0],
        "mp_max": mp.max(),
        "mp_max_frame": new.frame[peak],
        "mean_attenuation_db": db.mean(),
        "attenuation_frames": db.count(),
        "median_attenuation_db": defined.attenuation_db.median(),
        "pooled_attenuation_db": 10 * np.log10(defined.s_sum.sum() / defined.p_sum.sum()),
        "sharpness": (mp[3:] / mp[3:].max()).mean(),
        "distinguishability": near[new.frame[peak]] / near[OTHER],
    }


def test_each_table_marks_the_copied_rows_and_the_others_give_our_numbers(runs, doubled):
    pandas = pytest.importorskip("pandas")
    runs("run", doubled / "ten.avi", "--set", 7)
    result, folder = read_result("dlgmd-out/ten"), Path("dlgmd-out/ten")
    tables = {name: pandas.read_csv(folder / name) for name in csv.TABLES}
    for table in [*tables.values(), result.to_dataframe()]:
        assert np.array_equal(table["repeat"], result.is_repeat)
        assert result.record["input"]["repeats"] == table["repeat"].sum() == 78
    table = pandas.concat(tables.values(), axis=1)
    new = table.loc[:, ~table.columns.duplicated()].query("repeat == 0").reset_index()
    ours = {**result.summary, "sharpness": result.sharpness}
    ours["distinguishability"] = result.distinguishability(OTHER)
    assert {n: ours[n] for n in numbers_of(new)} == pytest.approx(numbers_of(new), rel=1e-7)
    assert ours["spikes"] < result.spikes.sum()
    runs("compare", doubled / "ten.avi", "--set", 7)
    compared = pandas.read_csv("dlgmd-out/ten/compare.csv")
    assert np.array_equal(compared["repeat"], result.is_repeat)


def test_figures_show_no_spike_on_a_copied_frame(doubled):
    result = run(doubled / "ten.avi", model=7)
    copies = result.time_s[result.is_repeat]
    panel, raster = result.plot("spikes").axes[:2]
    dots = [line for line in panel.lines if line.get_marker() == "o"]
    shown = np.concatenate([line.get_xdata() for line in dots])
    assert shown.size == result.summary["spikes"] and not np.isin(shown, copies).any()
    bars = raster.collections[0].get_paths()
    spans = [bar.get_extents().intervalx for bar in bars]
    assert spans and not any(((low < copies) & (copies < high)).any() for low, high in spans)
    result.rows["attenuation_db"] = -np.inf
    on_page = _result_data(SimpleNamespace(result=result, label="", film=None), 0.0)
    assert on_page["spikes"] == np.flatnonzero(result.new_spikes).tolist()
    assert on_page["silent"] == np.flatnonzero(~result.is_repeat).tolist()


def test_layers_and_sweeps_see_what_run_sees(runs, doubled):
    onset = run(doubled / "ten.avi", model=7).summary["first_alarm_frame"]
    grid = ["--x", "sigma_e=1", "--y", "a=1.5", "--set", 7, "--jobs", 1]
    runs("sweep", doubled / "ten.avi", *grid)
    (row,) = csv_rows("dlgmd-out/sweep-ten/sweep.csv")
    assert int(row["first_alarm_frame"]) == onset
    layers = ("layers", doubled / "ten.avi", "--set", 7)
    result = runs(*layers, "--frames", f"{onset},{onset + 1}", "--npz")
    assert f"that were processed is frame {onset + 1}; " in result.stderr
    runs(*layers, "--end", 0.4, "--video", "film.mp4", "--overlay")
    rate, pictures = read_video("film.mp4")
    assert (round(rate), len(pictures)) == (30, 12)


def test_what_is_recorded_and_read_again(runs, doubled):
    result = runs("run", doubled / "ten.avi", "--set", 7, "--json")
    assert json.loads(result.stdout)["alarms"] == 1
    assert "78 of 120 frames are duplicates: the video has about 10 new frames" in result.stderr
    record = yaml_of("dlgmd-out/ten/run.yaml")
    assert record["input"]["repeats"] == 78 and record["processed"]["frames"] == 120
    stored, fresh = read_result("dlgmd-out/ten"), run(doubled / "ten.avi", model=7)
    assert np.array_equal(stored.alarms, fresh.alarms) and stored.alarm_onsets.size == 1
    assert np.array_equal(stored.is_repeat, fresh.is_repeat)
    runs("compare", doubled / "ten.avi", "--set", 7)
    compared = read_comparison("dlgmd-out/ten")["set7"]
    assert np.array_equal(compared.alarms, fresh.alarms)
    again = ["--config", "dlgmd-out/ten/run.yaml", "--out", "again"]
    runs("run", doubled / "ten.avi", *again)
    assert yaml_of("again/ten/run.yaml") == record
