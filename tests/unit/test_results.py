"""`Result` and what is stored of it: summaries, files, the commit rule, reading back."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import csv_rows, judged_anew, make_result, result_of_level

import dlgmd_cli
from dlgmd_cli import read_result
from dlgmd_cli.errors import ResultError
from dlgmd_cli.models.normalise import absolute
from dlgmd_cli.parameters.facts import SCHEMA
from dlgmd_cli.results.csv import cell, cells
from dlgmd_cli.results.labels import Label, read_labels, write_labels

NAN = math.nan


def test_everything_public__is_listed():
    assert {"run", "open_video", "Result", "__version__"} <= set(dir(dlgmd_cli))
    with pytest.raises(AttributeError, match="no attribute 'rum'"):
        dlgmd_cli.rum  # noqa: B018


def test_summary():
    level = np.array([NAN, NAN, 0.1, 0.5, 0.2, 0.45, 0.6, 0.7, 0.1, 0.5, 0.5])
    db = np.array([NAN, NAN, -math.inf, -10, -20, -30, -3, -3, NAN, -1, -3])
    result = result_of_level(level, frame=np.arange(11) * 2 + 5, attenuation_db=db)
    result.rows["p_sum"] = [9, 0, 8, 1, 1, 1, 1, 1, 0, 1, 2]
    result.rows["s_sum"] = [
        NAN,
        NAN,
        0,
        *(10 ** (db[3:8] / 10)),
        NAN,
        *(10 ** (db[9:] / 10) * [1, 2]),
    ]
    assert result.summary == {
        "rule": "spikes",
        "mp_max": pytest.approx(np.nanmax(result.mp)),
        "mp_max_frame": 19,
        "mp_max_time_s": 19 / 25,
        "spikes": 6,
        "first_spike_time_s": 11 / 25,
        "alarms": 1,  # the other begins 0.24 s after its end
        "first_alarm_frame": 17,  # the second spike in a row raises it
        "first_alarm_time_s": 17 / 25,
        "first_alarm_side": None,  # no centroid is known
        "first_alarm_ttc_s": None,
        "blind_share": 0.0,
        "mean_attenuation_db": pytest.approx(-70 / 7),
        "attenuation_frames": 7,
        "median_attenuation_db": -6.5,
        "pooled_attenuation_db": pytest.approx(10 * math.log10(np.nansum(result.s_sum) / 16)),
    }
    assert result.alarm_onsets.tolist() == [6]


def test_an_attenuation_where_little_passes():
    """The mean is over the frames where anything does; the median and the pooled one tell more."""
    result = result_of_level(
        np.zeros(5), attenuation_db=np.array([NAN, -math.inf, -math.inf, -math.inf, -3])
    )
    result.rows["p_sum"], result.rows["s_sum"] = [NAN, 10, 10, 10, 2], [NAN, 0, 0, 0, 1]
    found = result.attenuations
    assert (found["mean_attenuation_db"], found["attenuation_frames"]) == (-3, 1)
    assert found["median_attenuation_db"] == -math.inf
    assert found["pooled_attenuation_db"] == pytest.approx(10 * math.log10(1 / 32))
    assert result.facts()["median_attenuation_db"] == "-inf"
    result.rows["repeat"][4] = True
    found = result.attenuations
    assert found["mean_attenuation_db"] is None and found["pooled_attenuation_db"] == -math.inf
    result.rows["attenuation_db"] = NAN
    assert [*result.attenuations.values()] == [None, 0, None, None]


def test_alarms_are_merged__and_listed(tmp_path):
    """Two pauses: one of 0.24 s, which does not end the alarm, and one of 0.32 s."""
    level = np.zeros(40)
    level[[3, 4, 10, 11, 12, 20, 21, 22]] = 0.5
    level[[5, 15]] = 0.9  # the latter is no alarm
    result = result_of_level(level, frame=np.arange(40) + 5)
    result.rows["g_x"] = np.linspace(-1, 1, 40)
    result.rows["g_y"], result.rows["ttc_s"] = -result.g_x, 0.7
    assert np.flatnonzero(result.alarms).tolist() == [4, 5, 11, 12, 21, 22]
    assert np.flatnonzero(result.alarmed).tolist() == [*range(4, 13), 21, 22]
    first, last = result.alarm_list
    assert (first.start_frame, first.end_frame, last.start_frame) == (9, 17, 26)
    assert (first.start_s, first.end_s) == (9 / 25, 17 / 25)
    assert first.peak_mp_abs == pytest.approx(0.9) and last.peak_mp_abs == pytest.approx(0.5)
    assert (first.side, last.side) == ("left low", "ahead")
    assert (result.summary["alarms"], result.summary["first_alarm_side"]) == (2, "left low")
    result.save(tmp_path / "r")
    row, _ = csv_rows(tmp_path / "r/alarms.csv")
    assert (row["start_frame"], row["end_s"], row["peak_signal"]) == ("9", "0.68", "0.9")
    assert (row["side"], row["ttc_s"], row["rule"]) == ("left low", "0.7", "spikes")
    (tmp_path / "r/alarms.csv").unlink()
    assert len(read_result(tmp_path / "r").alarm_list) == 2
    make_result([NAN, 0.0]).save(tmp_path / "silent")
    assert csv_rows(tmp_path / "silent/alarms.csv") == []


def test_why_a_potential_is_0_throughout():
    still, suppressed, small = (make_result([0.0] * 4) for _ in range(3))
    still.rows["p_sum"] = 0.0
    small.record["width_px"] = 480
    for result, why in (
        (still, "0: no frame differs from the one before"),
        (suppressed, "0: everything was suppressed"),
        (small, "0: frames 10 px wide are too small for a neuron made for 480 px"),
    ):
        (_, rows), *_ = result.shown()
        assert dict(rows)["peak MP"] == why


def test_a_result_shows_its_model_its_rule_and_its_alarms_first():
    result = make_result([0.0] * 9)
    result.rows["ttc_s"], result.rows["expansion_x"] = np.arange(9.0, 0.0, -1.0) / 5, -0.5
    result.rows["expansion_y"] = 0.0
    params = replace(result.params, alarm="ttc", ttc_alarm=0.64)
    result = judged_anew(replace(result, params=params, record={**result.record, "set": 9}))
    (_, rows), *_ = result.shown()
    assert rows[:4] == [
        ("model", "set9 (dlgmd)"),
        ("alarm rule", "ttc: time to contact of 0.64 s or less"),
        ("alarms", "1"),
        (
            "",
            "0.240 to 0.320 s, frames 6 to 8, left, estimated contact in 0.60 s, time to contact "
            "down to 0.20 s",
        ),
    ]


def test_a_result_says_which_angles_of_the_camera_are_assumed():
    result = make_result([0.0] * 4)
    assert "camera" not in dict(next(result.shown())[1])
    result.record["camera"] = {"fov": 80.0, "camera_tilt": 0.0, "known_by": "assumed"}
    for given, text in (
        ({}, "fov 80° assumed, camera tilt 0° assumed"),
        ({"fov": 80.0}, "fov 80°, camera tilt 0° assumed"),
        ({"fov": 80.0, "camera_tilt": 0.0}, "fov 80°, camera tilt 0°"),
    ):
        result.record["options"] = given
        assert dict(next(result.shown())[1])["camera"] == text


def test_the_blind_time_is_shown():
    result = make_result([0.0] * 51)
    assert result.blind_share == 0.0 and not result.blind_spans
    result.rows["blind"][10:20], result.rows["blind"][30:45] = "unmeasured", "black"
    assert result.blind_spans == [(10, 19, "unmeasured"), (30, 44, "black")]
    assert result.summary["blind_share"] == pytest.approx(0.5)
    (_, rows), *_ = result.shown()
    text = "unmeasured, black: 50.0 % of the time, longest from 1.200 to 1.760 s"
    assert dict(rows)["blind"] == text


def test_the_longest_stretch_that_is_held_back_is_told():
    result = make_result([0.0] * 70)
    result.rows["expansion"][14:20], result.rows["expansion"][30:45] = 2.0, 3.0  # 0.2 s, 0.56 s
    result.rows["expansion"][50:60] = 2.0
    result.rows["expansion_quality"][[50, 51, 52, 59]] = 1.0  # an alarm with a pause
    result.rows["expansion_upright"], result.rows["approach"] = result.expansion, 0.0
    result = replace(result, params=replace(result.params, alarm="expansion"))
    held = judged_anew(result)
    assert held.alarm_spans.tolist() == [[50, 59]] and not held.alarms[53:59].any()
    assert held.held == [(14, 19, "quality"), (30, 44, "quality")]
    (_, rows), *_ = held.shown()
    assert dict(rows)["no alarm"] == (
        "1.200 to 1.760 s, expansion up to 3.00/s, held back by quality (and 1 more)"
    )


def test_a_notebook_shows_a_result_as_a_table_and_a_figure():
    shown = result_of_level(np.array([NAN, NAN, 0.1, 0.5, 0.6]))._repr_html_()
    assert "<td>alarm rule</td>" in shown and "<td>spikes</td>" in shown
    assert 'src="data:image/png;base64,iVBOR' in shown


def test_sharpness_and_distinguishability():
    mp = np.zeros(40)
    mp[30], mp[10], mp[12] = 8.0, 2.0, 2.0
    result = make_result(mp)
    assert result.sharpness == pytest.approx(12 / 8 / 37)  # of every model from t = 3 on
    early = np.where(np.arange(40) < 3, 5.0, mp)  # set 1 answers to frame 2, set 9 does not
    assert make_result(early).sharpness == result.sharpness
    assert result.distinguishability(10) == pytest.approx(2.0)  # 8 / 11 over 4 / 11
    assert result.distinguishability(20) == math.inf
    assert math.isnan(result.distinguishability(500))
    assert math.isnan(make_result(np.zeros(9)).sharpness)
    repeating = make_result(np.repeat(mp, 1 + (np.arange(40) == 12)))
    repeating.rows["repeat"][13] = True  # a copy counts for nothing
    assert repeating.distinguishability(10) == pytest.approx((8 / 11) / (4 / 10))
    assert repeating.sharpness == result.sharpness


def test_measures_end_at_the_collision():
    mp = np.zeros(40)
    mp[10], mp[20], mp[23], mp[30] = 2.0, 8.0, 16.0, 40.0  # the last two are the recoil
    whole, until = make_result(mp), make_result(mp).until(22)
    assert (whole.summary["mp_max_frame"], until.summary["mp_max_frame"]) == (30, 20)
    assert np.array_equal(until.mp_seq, whole.mp_seq) and whole.mp_seq[30] == 1.0
    assert until.sharpness == pytest.approx(10 / 8 / 20)
    assert until.distinguishability(10) == pytest.approx((8 / 8) / (2 / 11))
    assert np.array_equal(until.mp_abs, whole.mp_abs)  # alarms take no part
    assert make_result(mp).until(None).summary == whole.summary


def test_a_peak_of_rounding_is_no_answer():
    result = make_result([NAN, NAN, NAN, 1e-7, 3e-6, 1e-7])
    assert np.isnan(result.mp_seq).all() and math.isnan(result.sharpness)
    assert math.isnan(result.distinguishability(3)) and result.summary["mp_max"] == 3e-6


def test_normalised_by_its_own_sequence():
    result = make_result([NAN, 1.0, 3.0, 2.0], normalise="sequence")
    assert np.array_equal(result.mp_seq, [NAN, 0, 1, 0.5], equal_nan=True)
    assert np.array_equal(result.level, result.mp_seq, equal_nan=True)
    assert result.spikes.tolist() == [False, False, True, True]
    assert np.allclose(result.mp_abs, absolute(result.mp, 100, result.params.kappa), equal_nan=True)
    still = make_result([NAN, 2.0, 2.0], normalise="sequence")
    assert np.isnan(still.level).all() and "never changes" in still.doubts()[0]


def test_by_its_own_sequence_a_copy_counts_once_and_a_gap_begins_anew():
    result = make_result([0.0, 3, 3, 3, 1, 3, 3, 3], normalise="sequence")
    assert result.alarms.tolist() == [False] * 2 + [True] * 2 + [False] * 2 + [True] * 2
    result.rows["repeat"][[2, 3]], result.rows["gap"][6] = True, True
    assert judged_anew(result).alarms.tolist() == [False] * 7 + [True]


@pytest.mark.parametrize("gap_s", [0.0, 1.0])
def test_a_potential_that_a_gap_in_time_ends_is_no_fault(gap_s):
    """After a gap the model resets, and has none for a few frames."""
    mp, time_s = np.arange(20.0), np.arange(20) / 25
    mp[10:13], time_s[10:] = NAN, time_s[10:] + gap_s
    result = make_result(mp, time_s=time_s)
    result.rows["gap"][10] = gap_s > 0.0
    lines = result.doubts()
    assert any("undefined (NaN) at frame 10" in line for line in lines) == (gap_s == 0.0)


def test_spikes_of_duplicate_frames_are_counted_once():
    result = result_of_level([0.1, 0.5, 0.5, 0.5, 0.1])
    result.rows["repeat"][[2, 3]] = True
    assert result.summary["spikes"] == 1 and result.summary["first_spike_time_s"] == 1 / 25
    assert result.spikes.tolist() == [False, True, True, True, False]  # held meanwhile


@pytest.mark.parametrize(
    ("name", "change", "why"),
    [
        ("mp.csv", lambda text: text.replace(",mp,", ",x,"), "its columns are not"),
        (
            "mp.csv",
            lambda text: text.replace("\n1,", "\none,"),
            "line 3, column frame: 'one' is no number",
        ),
        ("mp.csv", lambda text: text + text.splitlines()[1] + "\n", "are not frames in order"),
        ("mp.csv", lambda text: text + "7,1\n", "line 5: it does not have .* cells"),
        ("mp.csv", lambda text: text.splitlines()[0], "contains no frames"),
        # Python 3.10 reads no NUL.
        ("attenuation.csv", lambda text: "\x00" + text, "its columns are not|not a CSV file"),
        ("attenuation.csv", lambda text: text.rsplit("\n", 2)[0], "not those of mp.csv"),
        ("run.yaml", lambda text: text.replace("dlgmd\n", "other\n", 1), "model 'other'"),
        ("run.yaml", lambda text: text.replace("width: 10", "width:"), "processed.width"),
        ("run.yaml", lambda text: text.replace(f"ema: {SCHEMA}", "ema: 1"), "another version"),
        ("run.yaml", lambda text: "[", "contains no result"),
    ],
)
def test_files_that_were_changed(tmp_path, name, change, why):
    make_result([NAN, 1.0, 2.0]).save(tmp_path)
    (tmp_path / name).write_text(change((tmp_path / name).read_text()))
    with pytest.raises(ResultError, match=why) as caught:
        read_result(tmp_path)
    assert "\n" not in str(caught.value)


def test_numbers_read_back_as_float32():
    for value in np.random.default_rng(1).normal(size=200).astype(np.float32) * 1e3:
        assert np.float32(cell(value)) == value
    assert (cell(NAN), cell(-math.inf), cell(-12.5)) == ("", "-inf", "-12.5")


def test_two_frames_have_two_times_after_hours():
    times_s = [0.04, 999.9998, 36000.0, 36000.0002, NAN]
    texts = [cells(("time_s",), (time_s,))[0] for time_s in times_s]
    assert texts == ["0.04", "999.9998", "36000", "36000.0002", ""]


def test_labels(tmp_path):
    labels = [Label("a.mp4", 12, "wall"), Label("b/c.mp4"), Label("-d.mp4", 0)]
    labels.append(Label("a.mp4", 40, "", "real", "walk"))
    write_labels(tmp_path / "labels.csv", labels)
    header = (tmp_path / "labels.csv").read_text().splitlines()[0]
    assert header == "video,collision_frame,target,kind,manner"
    assert read_labels(tmp_path / "labels.csv") == [*labels[:2], Label("./-d.mp4", 0), labels[3]]
    for text, why in (
        ("\ufeff".encode("utf-16"), "it has no header"),
        (b"video,\0collision_frame\n", "not a CSV file"),
        (b"video\na.mp4\n", "lacks collision_frame; its columns are video .UTF-8, in one column"),
        (b"Film;Bild\na.mp4;3\n", "its columns are Film, Bild .UTF-8, separated by semicolons"),
    ):
        (tmp_path / "labels.csv").write_bytes(text)
        with pytest.raises(ResultError, match=why):
            read_labels(tmp_path / "labels.csv")
    for line in ("a.mp4,soon", "a.mp4", "a.mp4,-1", "a.mp4,1.5", "a.mp4," + "9" * 5000, ",2"):
        (tmp_path / "labels.csv").write_text(f"video,collision_frame\n{line}\n")
        with pytest.raises(ResultError, match=r"line 2.* is not a (label|frame)"):
            read_labels(tmp_path / "labels.csv")


@pytest.mark.parametrize(
    ("rows", "why"),
    [
        (
            'a.mp4,"1,000"',
            "frame: '1,000' is not a frame",
        ),
        (
            "a.mp4,12.000",
            "frame: '12.000' is not a frame",
        ),
        ("a.mp4,1,000", "line 2 has 3 cells, the first line 2"),
        ('a.mp4,3\nb.mp4,5,"wall\nc.mp4,7,ball', "the row in line 3 cannot be read"),
        ('a.mp4,3\n"b.mp4,5,wall\n"c.mp4",7,ball', "the row in line 3 cannot be read"),
    ],
)
def test_labels_that_could_be_read_wrongly_are_refused(tmp_path, rows, why):
    header = "video,collision_frame" + ",target" * (rows.count(",") > 3)
    (tmp_path / "labels.csv").write_text(f"{header}\n{rows}\n")
    with pytest.raises(ResultError) as caught:
        read_labels(tmp_path / "labels.csv")
    assert why in str(caught.value)


@pytest.mark.parametrize(
    ("encoding", "name"),
    [("utf-8", "UTF-8"), ("utf-8-sig", "UTF-8"), ("utf-16", "UTF-16"), ("cp1252", "cp1252")],
)
@pytest.mark.parametrize(
    ("mark", "number", "said"),
    [
        (",", "32.0", "commas"),
        (";", "32,0", "semicolons"),
        ("\t", "32", "tabs"),
        (",", '"32,0"', "c"),
    ],
)
def test_tables_of_other_programs(tmp_path, caplog, encoding, name, mark, number, said):
    caplog.set_level("INFO")
    lines = (("sure", "collision_frame", "video"), ("ja", number, "Flüge/ä.mp4"), ("", "", "b.mp4"))
    text = "\r\n".join(mark.join(line) for line in lines) + f"\r\n{mark * 2}\r\n"
    (tmp_path / "labels.csv").write_bytes(text.encode(encoding))
    more = (("sure", "ja"),)
    found = [Label("Flüge/ä.mp4", 32, further=more), Label("b.mp4", further=(("sure", ""),))]
    assert read_labels(tmp_path / "labels.csv") == found
    assert f"read as {name}, separated by {said}" in caplog.text
    assert "further columns: sure." in caplog.text
