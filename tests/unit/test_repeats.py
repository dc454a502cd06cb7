"""Frames that repeat the one before, and gaps in time: what is told apart, and what follows."""

import cv2
import numpy as np
import pytest
from conftest import looming_frames, write_video

from dlgmd_cli import Alarm, load_set, open_video, run
from dlgmd_cli.errors import ParameterError
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


def test_a_flash_leaves_no_frame_of_an_array_out():
    """Not with --repeats skip: no image equals the one before."""
    for period in (2, 5):
        lit = [np.uint8(f * 0.6 + 40 * (t % period == 0)) for t, f in enumerate(looming_frames(40))]
        result = run(np.array(lit), 9, repeats="skip", param={"kappa": 1e-3})
        assert not result.is_repeat.any() and not any("equal" in w for w in result.warnings)
    assert sum(told([lit[0]] * 3 + lit, is_coded=False)) == 3


def test_an_alarm_answers_to_a_repeat_as_before():
    alarm, doubled = (Alarm(load_set(7, kappa=1e-3), repeats="skip") for _ in range(2))
    alarms = 0
    for number, frame in enumerate(looming_frames(40, 64, 48)):
        once, twice = alarm.step(frame), [doubled.step(frame) for _ in range(2)]
        # Before anything has changed, a frame like the one before is a still scene.
        assert number == 0 or twice[1].mp is twice[0].mp
        assert number < 5 or (once.mp, once.alarm) == (twice[0].mp, twice[0].alarm)
        alarms += once.alarm
    assert alarms > 0
    with pytest.raises(ParameterError, match="repeats = 'drop' is not one of skip, keep"):
        Alarm(repeats="drop")


def test_too_few_new_pictures(dlgmd, tmp_path):
    frames = looming_frames(3, 96, 72)
    write_video(tmp_path / "few.avi", [f for f in frames for _ in range(8)], 240)
    result = dlgmd("run", "few.avi", "--set", 9)
    assert result.exit_code == 1
    assert "24 frames, of which the model processes 3, but set9 needs at least 4." in result.stderr


def test_a_video_that_is_opened_skips_them_if_told_to(tmp_path):
    frames = [frame for frame in looming_frames(30, 96, 72) for _ in range(2)]
    path = write_video(tmp_path / "doubled.avi", frames, 60)

    def n_repeats(repeats):
        with open_video(path, repeats=repeats) as video:
            return sum(frame.is_repeat for frame in video)

    assert n_repeats("keep") == 0 < n_repeats("skip") == n_repeats(None)
    assert run(path, 9, fps="all").record["input"]["repeats"] == n_repeats("skip")
    with pytest.raises(ParameterError, match="repeats = 'drop' is not one of skip, keep"):
        n_repeats("drop")
