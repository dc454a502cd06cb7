"""When frames were captured that arrive unevenly, and what `Alarm` makes of them."""

import math

import cv2
import numpy as np
import pytest
from arrivals import at_beacons, in_bursts, in_jitter, stalled
from documents import text_of

from dlgmd_cli import Alarm
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.health import BLIND_S, LEAST_MEASURED, Health, Measuring
from dlgmd_cli.stream.clock import (
    CaptureClock,
    Pace,
    StreamClock,
    least_delay_slope,
    steady_step,
)
from dlgmd_cli.stream.continuity import Continuity, GapDetector
from dlgmd_cli.stream.intake import Intake


@pytest.mark.parametrize("fps", [24, 30, 60])
@pytest.mark.parametrize("stall_s", [0.15, 0.2, 0.3])
@pytest.mark.parametrize("burst_s", [0.001, 0.01])
def test_a_burst_after_a_stall_was_captured_evenly(fps, stall_s, burst_s):
    _, came = stalled(fps, stall_s, burst_s=burst_s)
    clock, gaps = CaptureClock(), GapDetector()
    found = np.array([clock.step(t) for t in came.tolist()])
    assert np.diff(came).min() * fps < 0.7 and np.diff(came).max() * fps > 3.0
    assert np.diff(found).min() * fps > 0.9 and np.diff(found).max() * fps < 1.1
    assert (found <= came + 0.1 / fps).all() and clock.latest_s > 0.1
    assert not any(gaps.step(t) for t in found.tolist())


def test_regular_times_and_jitter_pass():
    times = (np.arange(200) / 30).tolist()
    clock = CaptureClock()
    assert [clock.step(t) for t in times] == times and clock.latest_s == 0.0
    late = np.arange(300) / 30 + np.random.default_rng(1).uniform(0.0, 0.02, 300)
    clock = CaptureClock()
    found = np.array([clock.step(t) for t in late.tolist()])
    assert np.std(np.diff(found)[30:]) < 0.5 * np.std(np.diff(late)[30:])


@pytest.mark.parametrize(("n_lost", "at"), [(4, 101), (12, 101), (60, 100)])
def test_lost_frames_are_a_gap(n_lost, at):
    """A frame later than it is, unless it lasts more than half a second."""
    times = np.arange(300) / 30
    times = np.r_[times[:100], times[100 + n_lost :]]
    clock, gaps = CaptureClock(), GapDetector()
    found = [clock.step(t) for t in times.tolist()]
    assert [n for n, t in enumerate(found) if gaps.step(t)] == [at] and found[-1] == times[-1]


def test_a_rate_that_changes_is_followed():
    for fps in (15, 60):
        times = np.r_[np.arange(60) / 30, 2.0 + np.arange(100) / fps]
        clock = CaptureClock()
        found = np.array([clock.step(t) for t in times.tolist()])
        np.testing.assert_allclose(np.diff(found)[100:], 1.0 / fps, rtol=0.03)
        assert found[-1] == pytest.approx(times[-1], abs=0.01)


def test_what_waited_is_stale():
    """During a long stall; not before the rate is known."""
    first = np.r_[np.arange(6) * 0.001, 0.03 + np.arange(60) / 30]
    later = np.r_[np.arange(60) / 30, 4.0 + np.arange(60) * 0.002, 4.15 + np.arange(30) / 30]
    found = []
    for times in (first, later):
        clock = CaptureClock()
        found.append([(clock.step(t), clock.is_stale)[1] for t in times.tolist()])
    assert not any(found[0])
    assert not any(found[1][:61]) and all(found[1][61:115]) and not any(found[1][121:])


def test_late_arrivals_do_not_change_the_slope_of_the_least_delay():
    """However late every third of them is."""
    even = np.arange(60) / 30
    late = even + np.where(np.arange(60) % 3 == 1, np.linspace(0.3, 0.0, 60) ** 2, 0.0)
    assert least_delay_slope(late) == pytest.approx(1 / 30, rel=1e-9)


@pytest.mark.parametrize(("fps", "gap_s"), [(25, 0.008), (30, 0.0003), (60, 0.008)])
def test_a_stream_in_bursts_from_its_first_frame_has_a_clock(fps, gap_s):
    """Its rate is known after a second, and said to be uncertain."""
    ways = [in_bursts(300, fps, size, gap_s) for size in (2, 8)]
    for came in [*ways, at_beacons(300, fps, gap_s)]:
        clock, gaps, found = CaptureClock(), GapDetector(), []
        for time_s in came.tolist():
            found.append(clock.step(time_s))
            assert not clock.is_stale and not gaps.step(found[-1])
        steps = np.diff(found)[2 * fps :]
        np.testing.assert_allclose(steps, 1.0 / fps, rtol=0.05)
        assert clock.is_settled and clock.fps == pytest.approx(fps, rel=0.01)
        assert clock.is_uneven or gap_s * fps > 0.3  # the longest gap is nearly the interval


@pytest.mark.parametrize("mbps", [25.0, 30.0])
def test_stamps_count_while_they_keep_pace(mbps):
    """They are exact where arrivals are not; what counts frames at 25 a second has no stamps."""
    _, came = stalled(30, 0.3)
    stamps = np.arange(300) / mbps
    clock = StreamClock()
    found = np.array([clock.step(*one) for one in zip(came.tolist(), stamps.tolist(), strict=True)])
    assert np.diff(found).min() * 30 > 0.9 and np.diff(found).max() * 30 < 1.25
    if mbps == 30.0:
        np.testing.assert_allclose(np.diff(found)[100:], 1 / 30, rtol=1e-6)


def test_the_choice_of_frames_does_not_flip():
    """At 33 frames a second, which is on the edge, with the jitter of a camera."""
    for fps in (32.6, 33.0, 33.3, 33.6):
        pace, jitter = Pace(30.0), np.random.default_rng(3).uniform(-0.004, 0.004, 600)
        taken = [pace.is_due(n / fps + moved) for n, moved in enumerate(jitter)]
        assert len(set(np.diff(np.flatnonzero(taken)[60:]))) == 1
    assert [steady_step(33.3, 33.0, k) for k in (0, 1, 2)] == [2, 1, 2]
    assert [steady_step(60.0, 33.0, k) for k in (0, 1, 2)] == [2, 2, 2]


SCENE = np.kron(
    np.random.default_rng(5).integers(40, 216, (16, 60), np.uint8), np.ones((6, 6), np.uint8)
)


def views(n):
    """A pan over a scene, 72 x 96."""
    return [SCENE[:72, 2 * i % 240 : 2 * i % 240 + 96] for i in range(n)]


@pytest.mark.parametrize("pause_s", [0.7, 6.0])
@pytest.mark.parametrize("n_before", [1, 3, 5])
def test_a_pause_before_the_rate_is_known_says_nothing_about_it(n_before, pause_s):
    """As where a source sends an image, and begins once it is answered."""
    for came in (in_bursts(150, 30, 4, 0.001), at_beacons(150, 30, 0.001)):
        came[n_before:] += pause_s
        clock = CaptureClock()
        found = [clock.step(time_s) for time_s in came.tolist()]
        assert clock.fps == pytest.approx(30, rel=0.01)
        assert np.diff(found)[40:] == pytest.approx(1 / 30, rel=0.05)


@pytest.mark.parametrize("fps", [0.8, 1.5, 2.0])
def test_a_slow_source_does_not_pause(fps):
    came = np.arange(40) / fps + np.tile([0.0, 0.15], 20)
    clock = CaptureClock()
    for time_s in came.tolist():
        clock.step(time_s)
    assert clock.is_settled and clock.fps == pytest.approx(fps, rel=0.25)


def test_jitter_that_looks_even_at_first_is_found_within_a_second():
    """The first ten intervals may be alike by chance; steps are then those of the line."""
    for seed in range(6):
        clock = CaptureClock()
        times = [clock.step(arrival_s) for arrival_s in in_jitter(150, 60, 0.032, seed)]
        assert clock.is_uneven
        assert np.diff(times)[90:] == pytest.approx(1 / 60, rel=0.02)


@pytest.mark.parametrize("first", [40, 41])
def test_a_gap_before_an_image_that_is_left_out_comes_before_the_next(first):
    intake, numbers = Intake(Continuity(), max_fps=30.0), np.arange(60)
    times_s = numbers / 60 + (numbers >= first)
    shown = [np.full((9, 9), 90 * (number % 2), np.uint8) for number in numbers]
    placed = [intake.place(*one) for one in zip(shown, times_s.tolist(), strict=True)]
    assert None in placed[first : first + 2]
    assert not any(one.is_repeat for one in placed if one)  # other images came between
    assert [one.after_gap for one in placed[first:] if one] == [True] + [False] * 9


def test_what_waited_in_a_long_stall_is_left_out():
    intake = Intake(Continuity(), clock=StreamClock())
    placed = [intake.place(None, time_s) for time_s in stalled(30, 0.7, 60)[1].tolist()]
    assert [n for n, one in enumerate(placed) if one is None] == [*range(31, 52)]
    assert [n for n, one in enumerate(placed) if one and one.after_gap] == [30]


def test_frames_without_times_are_told_once(caplog):
    alarm = Alarm()
    for frame in views(40):
        alarm.step(frame)
    assert caplog.messages == [
        "frames have no times, so they count as 30 a second; give step() the times"
    ]


RNG = np.random.default_rng(7)


def noisy(pictures, sd):
    """The same with noise."""
    return [
        np.clip(np.rint(one + RNG.normal(0.0, sd, one.shape)), 0, 255).astype(np.uint8)
        for one in pictures
    ]


def clocked(pictures):
    """The same with the clock of an on-screen display."""
    out = []
    for number, one in enumerate(pictures):
        one = one.copy()
        one[4:8, 4:12] = number // 3 * 12 % 256
        out.append(one)
    return out


STILL = [views(1)[0]] * 40
DARK = [np.zeros((72, 96), np.uint8)] * 40
COVERED = [np.minimum(RNG.poisson(0.04, (72, 96)), 2).astype(np.uint8) for _ in range(40)]
SNOW = [RNG.integers(0, 256, (72, 96), np.uint8) for _ in range(40)]


@pytest.mark.parametrize(
    ("shown", "reason"),
    [
        (DARK, "black"),
        (COVERED, "black"),
        (clocked(DARK), "black"),
        (noisy([np.full((72, 96), 128)] * 40, 2.0), "flat"),
        (SNOW, "noise"),
        (STILL, "frozen"),
        (noisy(STILL, 3.0), "frozen"),
        (noisy(clocked(STILL), 1.0), "frozen"),
        (noisy(views(40), 3.0), None),
        ([np.rint(one * 0.2).astype(np.uint8) for one in views(40)], None),
    ],
)
def test_health(shown, reason):
    """Within a second; and sound again after half a second of sound images, not before."""
    pictures, health = [*noisy(views(20), 1.0), *shown, *noisy(views(30), 1.0)], Health()
    told = [health.step(one, n / 30) for n, one in enumerate(pictures)]
    assert set(told[:20]) == {None} and told[-1] is None
    assert set(told[20:60]) == {None, reason} and told[20 + 29] == reason
    assert reason is None or (set(told[60:74]) == {reason} and told[60 + 20] is None)


def test_an_alarm_says_so():
    alarm = Alarm()
    told = [alarm.step(one, n / 30).blind for n, one in enumerate([*views(20), *DARK])]
    assert set(told[:20]) == {""} and told[-1] == "black"
    assert alarm.step(DARK[0], 9.0).blind == "black"  # it lasts over a gap
    alarm.reset()
    assert alarm.step(DARK[0], 9.1).blind == ""
    copies = [Frame(n, n / 30, one, is_repeat=n > 0) for n, one in enumerate(DARK)]
    alarm = Alarm()
    assert [alarm.step(one).blind for one in copies][-1] == "black"


def test_health_of_what_a_mask_leaves():
    """A living screen beside a frozen image is hidden, and does not count."""
    hidden = np.zeros((72, 96), bool)
    hidden[:, 60:] = True
    pictures = [np.where(hidden, a, b) for a, b in zip(SNOW, STILL, strict=True)]
    for mask, reason in ((None, None), (hidden, "frozen")):
        health = Health()
        health.ignore(mask)
        told = [health.step(one, n / 30) for n, one in enumerate(pictures)]
        assert told[-1] == reason


@pytest.mark.parametrize("step_s", [0.05, 0.17, 0.4])
def test_unlike_images_are_noise_only_if_neighbours_are_unlike(step_s):
    """Whatever the time between them: a fast camera shows another scene in each image."""
    noise = [RNG.integers(0, 256, (48, 64), np.uint8) for _ in range(40)]
    scenes = [cv2.resize(one[:6, :8], (64, 48), interpolation=cv2.INTER_CUBIC) for one in noise]
    for pictures, reason in ((noise, "noise"), (scenes, None)):
        health = Health()
        told = [health.step(one, step_s * n) for n, one in enumerate(pictures)]
        assert told[-1] == reason


@pytest.mark.parametrize("fps", [3, 5, 6, 7.5, 10, 15, 30])
def test_a_slow_camera_in_motion_is_not_frozen(fps):
    """A faint texture that is another one in each image is no noise."""
    texture = cv2.GaussianBlur(np.random.default_rng(7).normal(size=(72, 300)), (0, 0), 4.0)
    scene = np.where(np.arange(72)[:, None] < 36, 60.0, 200.0) + 4.0 * texture / texture.std()
    health, told = Health(), []
    for number in range(round(4 * fps)):
        left = round(40 * number / fps)
        told.append(health.step(np.uint8(np.rint(scene[:, left : left + 96])), number / fps))
    assert set(told) == {None}


def test_unmeasured():
    """Beneath the least quality for long enough, over gaps and without times, too."""
    page = " ".join(text_of("docs/live.md").split())
    assert f"of the expansion is below {LEAST_MEASURED}." in page
    assert f"has held for {BLIND_S} s" in page
    n = round(30 * BLIND_S)
    low, sound = [LEAST_MEASURED - 0.01] * (n + 1), [LEAST_MEASURED]
    for times_s in (np.arange(99) / 30, [math.nan] * 99):
        measuring = Measuring()
        told = [measuring.step(*one) for one in zip([*low, *sound, *low], times_s, strict=False)]
        assert np.flatnonzero(told).tolist() == [n, 2 * n + 2]
    measuring = Measuring()
    assert not measuring.step(math.nan, 3.0)  # the first frames have no quality yet
    assert not measuring.step(1.0, 3.0 + BLIND_S)
    assert not measuring.step(0.0, 1.0)  # the clock was set back
    assert measuring.step(math.nan, 1.0 + BLIND_S)
