"""`Alarm` over streams of a few seconds: rates, late frames, sizes, and what is unmeasured."""

import math
import sys
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
from arrivals import stalled
from conftest import looming_frames

from dlgmd_cli import Alarm, load_set, run
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.parameters.presets import LgmdParameters
from dlgmd_cli.video.luma import to_grey

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_capture import views
from test_prepare import expansions, lit
from test_prepare import views as panned


@pytest.mark.parametrize(
    ("times_s", "repeats", "warning"),
    [
        (
            np.arange(99) / 60,
            False,
            "frames are processed at 60 a second, but the parameters are made for",
        ),
        (np.arange(99) / 60, True, ""),  # every image twice, which makes 30 new ones a second
        (np.arange(60) / 12, False, "frames are processed at 12 a second"),
        (np.arange(50) / 25, False, ""),
        (np.r_[np.arange(25) / 12, 5 + np.arange(60) / 30], False, ""),  # too few, then a gap
    ],
)
def test_another_frame_rate_is_told_once(times_s, repeats, warning, caplog):
    treatment = "skip" if repeats else "keep"
    alarm = Alarm(all_frames=True, repeats=treatment)
    for number, time_s in enumerate(times_s):
        image = number // 2 if repeats else number
        alarm.step(np.full((24, 32), 90 * (image % 2), np.uint8), float(time_s))
    assert len(caplog.messages) == bool(warning) and warning in caplog.text


@pytest.mark.parametrize("fps", [50, 120])
def test_frames_that_come_too_often_are_left_out_as_a_run_does(fps):
    """Even where their times jitter by a quarter of a frame."""
    rng, every, n = np.random.default_rng(1), math.ceil(fps / 33), fps + 40
    times_s = (np.arange(n) + rng.uniform(-0.2, 0.2, n)) / fps
    frames = [np.full((24, 32), 90 * (number % 2), np.uint8) for number in range(n)]
    alarm = Alarm(load_set(3))
    for _ in range(2):
        found = [alarm.step(*one) for one in zip(frames, times_s.tolist(), strict=True)]
        is_new = [a is not b for a, b in pairwise(found)]
        assert all(is_new[: fps - 2])  # the rate is not known for a second
        assert set(np.diff(np.flatnonzero(is_new[fps + 5 :]))) == {every}
        alarm.reset()
    # The clock is set back.
    assert alarm.step(frames[0], 9.0) is not alarm.step(frames[1], 0.0)


def test_a_camera_s_pictures_are_reduced_as_a_video_s():
    """Colour of 1000 px, which the preset processes at 240, the paper's sets at 480."""
    rng = np.random.default_rng(4)
    frames = [
        cv2.cvtColor(cv2.resize(frame, (1000, 400)), cv2.COLOR_GRAY2BGR)
        for frame in looming_frames(5)
    ]
    for frame in frames:
        frame[..., 2] = cv2.add(frame[..., 2], rng.integers(0, 20, (400, 1000), np.uint8))
    for params, size in (
        (None, (240, 96)),
        (load_set(3), (480, 192)),
        (LgmdParameters(), (480, 192)),
    ):
        alarm, expected = Alarm(params), Alarm(params, resize=False)
        answers = [alarm.step(frame) for frame in frames]
        assert alarm.model.n_cells == size[0] * size[1]
        for answer, frame in zip(answers, frames, strict=True):
            small = to_grey(frame, (240, 96))
            found = expected.step(to_grey(frame, size), small=small)
            np.testing.assert_equal(vars(found), vars(answer))
    narrow = Alarm(width_px=1200)
    narrow.step(np.float32(frames[0] / 255.0))
    assert narrow.model.n_cells == 400_000  # never enlarged


def test_an_alarm_does_not_take_a_late_frame_for_a_big_step(caplog):
    frames, (captured, came) = views(61), stalled(30, 0.2, 61)
    found = {}
    for name, times in (("captured", captured), ("came", came)):
        alarm = Alarm()
        found[name] = [alarm.step(*one) for one in zip(frames, times.tolist(), strict=True)]
    mp = {name: np.array([one.mp_abs for one in told]) for name, told in found.items()}
    np.testing.assert_allclose(mp["came"][20:], mp["captured"][20:], atol=0.02)
    assert caplog.messages == [
        "frames come unevenly, up to 0.20 s late; the times of their capture are used"
    ]
    exact = Alarm(times="capture")  # which this is not
    wrong = [exact.step(*one).mp_abs for one in zip(frames, came.tolist(), strict=True)]
    assert np.isnan(wrong[20:]).any() and not np.isnan(mp["came"][20:]).any()  # it starts anew
    with pytest.raises(ParameterError, match="times = 'late' is not one of arrival, capture"):
        Alarm(times="late")


@pytest.mark.parametrize(
    ("alarm", "reason"), [("expansion", "unmeasured"), ("ttc", "unmeasured"), ("spikes", "")]
)
def test_a_plain_wall_is_unmeasured(alarm, reason):
    """It is no fault of the images, which have a frame around the wall."""
    wall = np.full((108, 192), 150, np.uint8)
    wall[:12], wall[-12:] = 40, 220
    frames = [np.roll(wall, n % 3, axis=0) for n in range(45)]
    if alarm != "ttc":
        rows = [*map(Alarm(alarm=alarm, repeats="skip").step, frames, np.arange(45) / 30)]
        assert rows[0].blind == "" and rows[-1].blind == reason
    result = run(np.array(frames), "flight", fps=30, param={"alarm": alarm})
    assert result.blind[-1] == reason and set(result.blind) == {"", reason}
    assert (result.blind_share > 0.4) == bool(reason)


def test_the_expansion_does_not_see_flicker():
    shown = panned(36)
    clean, flickering = expansions(shown), expansions(lit(shown, 0.12))
    without = expansions(lit(shown, 0.12), deflicker=False)
    errors = [np.abs(one - clean)[20:].mean() for one in (flickering, without)]
    assert errors[0] < 0.1 and errors[0] < 0.7 * errors[1]
