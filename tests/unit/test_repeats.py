"""Frames that repeat the one before, and gaps in time: what is told apart, and what follows."""

import json
import warnings
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from conftest import csv_rows, looming_frames, read_video, write_video, yaml_of

from dlgmd_cli import Alarm, load_set, open_video, read_comparison, read_result, run
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.pages.page import _result_data
from dlgmd_cli.results import csv
from dlgmd_cli.stream.continuity import MAX_RUN, GapDetector, RepeatDetector

SIZE = 72, 96


def scene(seed=3):
    """A wide textured image to fly along."""
    noise = np.random.default_rng(seed).uniform(0, 255, (SIZE[0], 900)).astype(np.float32)
    return cv2.GaussianBlur(noise, (0, 0), 3) * 3 - 255


def pan(n, px=2, noise=0.0, gain=1.0, seed=5):
    """A camera that moves along the scene; its sensor's noise has a standard deviation."""
    wide, rng = scene(), np.random.default_rng(seed)
    views = (wide[:, px * t : px * t + SIZE[1]] * gain for t in range(n))
    return [np.uint8(np.clip(v + rng.normal(0, noise, SIZE) + 20, 0, 255)) for v in views]


def told(frames, is_coded=True):
    detector = RepeatDetector(is_coded=is_coded)
    return [detector.step(frame) for frame in frames]


def encoded_anew(frame, rng):
    """As a codec does: most of it stays, and a few blocks change by a few levels."""
    found = frame.copy()
    for y, x in rng.integers(0, 60, (3, 2)):
        found[y : y + 8, x : x + 8] += np.uint8(2)
    return found


@pytest.mark.parametrize("times", [(2,), (3,), (4,), (1, 1, 1, 1, 2), (2, 3)], ids=str)
@pytest.mark.parametrize("is_exact", [True, False])
def test_repeats_are_found(times, is_exact):
    rng, frames, expected = np.random.default_rng(2), [], []
    for number, frame in enumerate(pan(60, noise=1.0)):
        for copy in range(times[number % len(times)]):
            if copy > 0:
                frame = frame if is_exact else encoded_anew(frame, rng)
            frames.append(frame)
            expected.append(copy > 0)
    found = np.array(told(frames))
    settled = 12 * max(times)
    assert found[settled:].tolist() == expected[settled:]
    assert not (found & ~np.array(expected)).any()


NOT_REPEATS = {
    "moving": pan(60),
    "hovering with noise": pan(60, px=0, noise=1.5),
    "dark": pan(60, noise=1.0, gain=0.05),
    "a fade": [np.uint8(f * (1 - t / 60)) for t, f in enumerate(pan(60, noise=1.0))],
    "a cut": [*pan(30, noise=1.0), *(255 - f for f in pan(30, noise=1.0))],
    "still": pan(1) * 60,
    "faster and faster": looming_frames(40, 96, 72),
    "a flash every fourth frame": [
        np.uint8(f * 0.6 + 60 * (t % 4 == 0)) for t, f in enumerate(pan(60, noise=1.0))
    ],
    "a clock": [
        cv2.putText(f, f"{37 * t % 60}", (2, 30), 0, 1, 255, 3) if t % 2 else f
        for t, f in enumerate(pan(60, px=1))
    ],
}


@pytest.mark.parametrize("name", NOT_REPEATS)
def test_what_is_no_repeat(name):
    assert not any(told(NOT_REPEATS[name]))


def test_a_sudden_rest_is_a_repeat_briefly_and_a_frozen_picture_not_for_ever():
    assert sum(told([*pan(30, noise=1.0), *pan(60, px=0, noise=1.0, seed=6)])) <= MAX_RUN
    frozen = told([*pan(30), *[pan(30)[-1]] * 40])
    assert frozen == [False] * 30 + [True] * MAX_RUN + [False] * (40 - MAX_RUN)


def test_gaps_are_told_from_slow_and_uneven_rates():
    def gaps(times):
        detector = GapDetector()
        return [i for i, time_s in enumerate(times) if detector.step(time_s)]

    steady = np.arange(40) / 30
    assert gaps(np.where(steady > 1.0, steady + 1.0, steady)) == [31]
    rng = np.random.default_rng(1)
    assert gaps(np.cumsum(rng.uniform(0.02, 0.05, 100))) == []
    assert gaps(np.delete(steady, [9, 10])) == []  # two frames were dropped
    assert gaps(np.arange(20) / 2) == []  # two frames a second, all along
    assert gaps(np.arange(100) / 240) == []


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


def test_a_flash_leaves_no_frame_of_an_array_out():
    """With --repeats skip neither: no image equals the one before."""
    for period in range(2, 7):
        lit = [np.uint8(f * 0.6 + 40 * (t % period == 0)) for t, f in enumerate(looming_frames(40))]
        for repeats in ("skip", None):
            result = run(np.array(lit), 9, repeats=repeats, param={"kappa": 1e-3})
            assert not result.is_repeat.any() and not any("equal" in w for w in result.warnings)
    assert sum(told([lit[0]] * 3 + lit, is_coded=False)) == 3


def test_an_alarm_answers_to_a_repeat_as_before():
    alarm, doubled = (Alarm(load_set(7, kappa=1e-3), repeats="skip") for _ in range(2))
    alarms = 0
    for number, frame in enumerate(looming_frames(40, 96, 72)):
        once, twice = alarm.step(frame), [doubled.step(frame) for _ in range(2)]
        # Before anything has changed, a frame like the one before is a still scene.
        assert number == 0 or twice[1].mp is twice[0].mp
        assert number < 5 or (once.mp, once.alarm) == (twice[0].mp, twice[0].alarm)
        alarms += once.alarm
    assert alarms > 0
    with pytest.raises(ParameterError, match="repeats = 'drop' is not one of skip, keep"):
        Alarm(repeats="drop")


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


def test_too_few_new_pictures(dlgmd, tmp_path):
    frames = looming_frames(3, 96, 72)
    write_video(tmp_path / "few.avi", [f for f in frames for _ in range(8)], 240)
    result = dlgmd("run", "few.avi", "--set", 9)
    assert result.exit_code == 1
    assert "24 frames, of which the model processes 3, but set9 needs at least 4." in result.stderr


def test_a_video_that_is_opened_skips_them_if_told_to(doubled):
    def n_repeats(repeats):
        with open_video(doubled / "ten.avi", repeats=repeats) as video:
            return sum(frame.is_repeat for frame in video)

    assert n_repeats("keep") == 0 < n_repeats("skip") == n_repeats(None)
    with pytest.raises(ParameterError, match="repeats = 'drop' is not one of skip, keep"):
        n_repeats("drop")
