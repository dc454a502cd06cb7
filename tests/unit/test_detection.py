"""Normalisation, spikes and alarms; frame by frame, and of a whole run."""

import math
import re

import numpy as np
import pytest
from conftest import looming_frames, write_video
from reference import clips

import dlgmd_cli
from dlgmd_cli.errors import FrameError
from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.detection import Detection, spans
from dlgmd_cli.models.normalise import absolute, sequence
from dlgmd_cli.models.rules import rule_of, side_of
from dlgmd_cli.parameters.presets import (
    MODELS,
    load_config,
    load_set,
    parameters_of,
)
from dlgmd_cli.tasks.call import choose

NAN = np.nan
FRAMES = clips.looming(24, 30, 9, seed=1)


def test_absolute_is_half_at_kappa_whatever_the_size():
    mp = np.array([NAN, 0.0, 3.0, 9.0])
    np.testing.assert_allclose(absolute(mp, 1000, 0.003), [NAN, 0, 0.5, 0.75])
    np.testing.assert_array_equal(absolute(4 * mp, 4000, 0.003), absolute(mp, 1000, 0.003))
    # Without kappa it is the sigmoid of the LGMD.
    expected = [NAN, 0.5, 1 / (1 + math.exp(-2.0)), 1.0]
    np.testing.assert_allclose(absolute(np.array([NAN, 0.0, 12.0, 1e9]), 6, None), expected)


@pytest.mark.parametrize(
    ("mp", "expected"),
    [
        ([NAN, NAN, 4.0, 2.0, 6.0], [NAN, NAN, 0.5, 0.0, 1.0]),
        ([NAN, 0.0, 0.0], [NAN] * 3),  # a still scene
        ([NAN, 0.0, 6e-7, 0.0], [NAN] * 4),  # rounding
        ([NAN, 0.0, 6e-5, 3e-5], [NAN, 0.0, 1.0, 0.5]),  # four cells, one grey level
        ([NAN, NAN], [NAN] * 2),
        ([], []),
    ],
)
def test_sequence_spans_zero_to_one_over_valid_frames(mp, expected):
    np.testing.assert_array_equal(sequence(np.array(mp)), expected)


@pytest.mark.parametrize("n_sp", [1, 2, 3])
def test_an_alarm_needs_n_sp_spikes_in_a_row(n_sp):
    rule = rule_of(load_set(9, n_sp=n_sp, t_mp=0.4))
    rows = [rule.step(Detection(level=one)) for one in (0.4, 0.39999, 1, 0.5, 1, NAN, 1, 1)]
    in_a_row = (1, 0, 1, 2, 3, 0, 1, 2)
    assert [row.spike for row in rows] == [n > 0 for n in in_a_row]
    assert [row.alarm for row in rows] == [n >= n_sp for n in in_a_row]
    rule.restart()  # as after a gap
    assert rule.step(Detection(level=1)).alarm == (n_sp == 1)


def test_the_rule_ttc_goes_by_the_time_to_contact_alone():
    rule = rule_of(load_set(9, alarm="ttc", ttc_alarm=0.5, n_sp=3))
    numbers = [(1.0, NAN), (1.0, 0.51), (0.0, 0.5), (0.0, 0.2)]
    rows = [rule.step(Detection(level=level, ttc_s=ttc_s)) for level, ttc_s in numbers]
    assert [row.spike for row in rows] == [True, True, False, False]
    assert [row.alarm for row in rows] == [False, False, True, True]


@pytest.mark.parametrize(
    ("pause", "n_alarms"),
    [(1, 1), (7, 1), (8, 2), (40, 2)],  # 0.267 s off at 30 frames a second; 0.3 s
)
def test_alarms_less_than_0_3_s_apart_are_one(pause, n_alarms):
    alarms = np.array([False] * 4 + [True] * 3 + [False] * pause + [True] * 2)
    time_s = np.arange(len(alarms)) / 30
    last = 8 + pause
    expected = [[4, last]] if n_alarms == 1 else [[4, 6], [7 + pause, last]]
    assert spans(alarms, time_s).tolist() == expected
    # The pause runs from the end of the last, however short.
    again = np.concatenate((alarms, [False] * 7, [True]))
    expected[-1][1] = last + 8
    assert spans(again, np.arange(len(again)) / 30).tolist() == expected
    assert spans(np.array([], bool), np.array([])).shape == (0, 2)


@pytest.mark.parametrize(
    ("g_x", "g_y", "side"),
    [
        *((-0.34, 0.0, "left"), (-0.33, 0.33, "ahead"), (0.34, -0.33, "right")),
        *((-1.0, -1.0, "left high"), (0.0, 0.34, "ahead low"), (NAN, NAN, "")),
    ],
)
def test_sides_are_thirds_of_the_picture(g_x, g_y, side):
    assert side_of(g_x, g_y) == side


PARAMS = [
    *(load_set(number, kappa=1e-4) for number in (3, 9)),
    load_set(9, formulation="equations", n_sp=1),
    *(kind() for kind in MODELS.values()),
]


@pytest.mark.parametrize("number", range(len(PARAMS)))
def test_an_alarm_says_frame_by_frame_what_a_whole_run_does(number):
    params = PARAMS[number]
    frames = FRAMES if number % 2 else [np.uint8(frame * 255) for frame in FRAMES]
    model, alarm = create_model(params), Alarm(params, repeats="keep")
    responses = [model.step(frame) for frame in frames]
    mp = np.array([one.mp for one in responses])
    mp_abs = absolute(mp, 24 * 30, params.kappa) if params.rest is None else mp
    rule = rule_of(params)
    judged = [rule.step(Detection(level=level)) for level in mp_abs.tolist()]
    for _ in range(2):
        found = [alarm.step(frame, t / 30) for t, frame in enumerate(frames)]
        np.testing.assert_array_equal([one.mp for one in found], [one.mp for one in responses])
        np.testing.assert_allclose([one.mp_abs for one in found], mp_abs, rtol=1e-15)
        assert [one.spike for one in found] == [one.spike for one in judged]
        assert [one.alarm for one in found] == [one.alarm for one in judged]
        alarm.reset()
    assert [one.is_valid for one in found] == [one.is_valid for one in responses]


def test_the_default_alarm_is_the_preset():
    assert Alarm().params == parameters_of(load_config("flight"))


def test_the_alarm_goes_off_as_a_disc_looms():
    alarm = Alarm(load_set(9))
    found = [alarm.step(frame).alarm for frame in clips.looming(60, 80, 12, seed=4)]
    assert not any(found[:4]) and any(found)
    with pytest.raises(FrameError):
        alarm.step(np.zeros((60, 80, 4), np.uint8))


def test_parameters_are_made_for_the_width_of_their_model():
    widths = [
        choose(one).config.width_px for one in ("flight", "flight-small", load_set(3), "lgmd")
    ]
    assert widths == [240, 96, 480, 480]


def test_an_alarm_takes_a_file_of_parameters(tmp_path):
    (tmp_path / "own.yaml").write_text("set: 3\nwidth_px: 100\nn_sp: 1\n")
    alarm = Alarm(load_config(tmp_path / "own.yaml"))
    alarm.step(np.zeros((90, 200), np.uint8))
    assert alarm.params == load_set(3, n_sp=1) and alarm.model.n_cells == 100 * 45


def test_all_frames_are_processed_if_asked_for():
    alarm = Alarm(load_set(3), all_frames=True)
    found = [alarm.step(np.full((24, 32), 90 * (n % 2), np.uint8), n / 60) for n in range(99)]
    assert len(set(map(id, found))) == 99


def test_the_frames_of_an_open_video_give_what_run_gives(tmp_path):
    """An alarm takes them as they are, with their times; in its own loop as in `run`."""
    path = write_video(tmp_path / "loom.avi", looming_frames(30, 64, 48))
    result = dlgmd_cli.run(path, 3)
    alarm = Alarm(load_set(3))
    with dlgmd_cli.open_video(path) as video:
        rows = [alarm.step(frame) for frame in video]
    for name in ("frame", "time_s", "mp", "expansion", "signal", "alarm"):
        np.testing.assert_array_equal([getattr(row, name) for row in rows], getattr(result, name))


class AtOnce(dlgmd_cli.Rule):
    """An alarm before any model has a response."""

    def value(self, row):
        return 1.0 if row.frame < 2 else math.nan


def test_an_alarm_before_the_first_response_prints_no_nan(tmp_path):
    result = dlgmd_cli.run(looming_frames(20), alarm=AtOnce, fps=30)
    (alarm,) = result.alarm_list
    assert alarm.peak_signal == 1.0 and alarm.to_dict()["peak_mp_abs"] is None
    result.save(tmp_path / "x", formats=["vtt"])
    texts = [path.read_text() for path in (tmp_path / "x").iterdir()]
    assert len(texts) > 4
    for text in (*texts, str(list(result.shown()))):
        assert not re.search(r"\bnan\b", text, re.IGNORECASE)
