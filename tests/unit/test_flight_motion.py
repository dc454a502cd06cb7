"""The quadrotor obeys its physics, and its path is smooth, exact and repeatable."""

import math
import time

import numpy as np
import pytest

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.flights.drone import RESTITUTION, fly
from dlgmd_cli.flights.renderer.camera import rotation
from dlgmd_cli.flights.script import (
    SPIN_UP_S,
    accelerate,
    climb_seconds,
    cruise,
    decelerate,
    hover,
    pitch,
    roll,
    stand,
    take_off,
    yaw,
)

START = (1.0, -2.0, 1.5)
GRAVITY, DRAG = 9.81, 0.35
MIXED = [
    hover(0.6),
    pitch(0.4, -8),
    accelerate(1.0, -14),
    cruise(0.8, 40),
    roll(0.6, 9),
    decelerate(1.6, 15),
    yaw(0.5, -120),
]


def flown(*script, **options):
    return fly(script, **{"position_m": START, "jitter": 0.0, **options})


def along(path, times, what="position_m"):
    return np.array([getattr(path.state(t), what) for t in times])


def ahead_of(state):
    nose = math.radians(state.yaw_deg)
    return np.array([math.cos(nose), math.sin(nose), 0.0])


def same_until(path, other, end_s):
    for t in np.linspace(0.0, end_s, 400):
        a, b = path.state(t), other.state(t)
        for name in ("position_m", "velocity_m_s", "angular_velocity_rad_s"):
            if not np.array_equal(getattr(a, name), getattr(b, name)):
                return False
        if (a.roll_deg, a.pitch_deg, a.yaw_deg) != (b.roll_deg, b.pitch_deg, b.yaw_deg):
            return False
    return True


def test_still_air_hovers_on_the_spot():
    path = flown(hover(3))
    places = along(path, np.linspace(0, 3, 50))
    np.testing.assert_allclose(places, np.broadcast_to(START, places.shape), atol=1e-9)


def test_a_hover_sways_by_about_a_centimetre_and_some_tenths_of_a_degree():
    path = flown(hover(60), jitter=1.0, seed=3)
    times = np.linspace(5, 60, 2000)
    sway = (along(path, times) - START).std(axis=0)
    assert (sway > 0.003).all()
    assert (sway < 0.02).all()
    for angle in ("roll_deg", "pitch_deg", "yaw_deg"):
        assert 0.1 < along(path, times, angle).std() < 0.8
    stronger = flown(hover(60), jitter=2.0, seed=3)
    np.testing.assert_allclose((along(stronger, times) - START).std(axis=0), 2.0 * sway, rtol=0.05)


def test_pitching_down_accelerates_by_what_the_thrust_leaves():
    path = flown(accelerate(12, -12), yaw_deg=90.0)
    for t in (0.7, 1.5, 3.0):
        before, state, after = (path.state(t + dt) for dt in (-0.01, 0.0, 0.01))
        assert state.pitch_deg == pytest.approx(-12, abs=0.2)
        gained = (after.velocity_m_s - before.velocity_m_s) @ [0, 1, 0] / 0.02
        speed = state.velocity_m_s[1]
        lean = math.tan(math.radians(-state.pitch_deg))
        assert gained == pytest.approx(GRAVITY * lean - DRAG * speed, rel=0.02)
        assert state.position_m[2] == pytest.approx(START[2], abs=0.01)
        assert state.position_m[0] == pytest.approx(START[0], abs=1e-9)
    terminal = GRAVITY * math.tan(math.radians(12)) / DRAG
    assert path.state(12).velocity_m_s[1] == pytest.approx(terminal, rel=0.02)
    assert terminal == pytest.approx(6, abs=0.1)


def test_attitude_follows_within_half_a_second_and_never_jumps():
    path = flown(hover(0.5), pitch(1.5, -10))
    times = np.arange(0.5, 1.5, 0.001)
    angles = along(path, times, "pitch_deg")
    spins = along(path, times, "angular_velocity_rad_s")
    assert angles[0] == 0.0
    assert (np.diff(angles) <= 1e-9).all(), "critically damped: no overshoot"
    assert angles[200] > -7.0
    assert angles[500] == pytest.approx(-10, abs=0.5)
    assert np.abs(np.diff(spins, axis=0)).max() < 0.02
    # theta'' = W² (c - theta) - 2 W theta', solved.
    turned = -10 * (1 - np.exp(-10 * (times - 0.5)) * (1 + 10 * (times - 0.5)))
    np.testing.assert_allclose(angles, turned, atol=0.05)


def test_cruise_keeps_its_speed_with_the_nose_a_little_down():
    path = flown(cruise(3), speed_m_s=3.0)
    state = path.state(3.0)
    np.testing.assert_allclose(state.velocity_m_s, [3, 0, 0], atol=1e-3)
    expected = -math.degrees(math.atan(DRAG * 3.0 / GRAVITY))
    assert state.pitch_deg == pytest.approx(expected, abs=0.01)
    after = flown(accelerate(2, -12), cruise(3))
    kept = np.linalg.norm(after.state(2.0).velocity_m_s)
    assert np.linalg.norm(after.state(5.0).velocity_m_s) == pytest.approx(kept, rel=0.01)


def test_cruise_with_a_yaw_rate_flies_a_banked_curve():
    path = flown(cruise(6, 30), speed_m_s=2.0)
    for t in (2.0, 3.5, 5.0):
        state = path.state(t)
        assert state.angular_velocity_rad_s[2] == pytest.approx(math.radians(30), rel=0.02)
        speed = np.linalg.norm(state.velocity_m_s)
        assert speed == pytest.approx(2.0, rel=0.02)
        assert state.velocity_m_s @ ahead_of(state) / speed > 0.999, "it slips sideways"
        bank = -math.degrees(math.atan(2.0 * math.radians(30) / GRAVITY))
        assert state.roll_deg == pytest.approx(bank, rel=0.03)
    centre = path.state(2.0).position_m + np.cross([0, 0, 1], path.state(2.0).velocity_m_s) / (
        math.radians(30)
    )
    assert np.linalg.norm(path.state(5).position_m - centre) == pytest.approx(
        2.0 / math.radians(30), rel=0.02
    )


def test_yaw_turns_on_the_spot_at_its_rate_and_stops():
    path = flown(yaw(40, 10), hover(2), yaw_deg=5.0)
    assert path.state(20.0).angular_velocity_rad_s == pytest.approx([0, 0, math.radians(10)])
    assert path.state(0.0).angular_velocity_rad_s[2] == 0.0
    assert path.state(40.0).yaw_deg == pytest.approx(5 + 400, abs=2), "beyond a full turn"
    assert path.state(42.0).yaw_deg == pytest.approx(5 + 400, abs=0.01)
    np.testing.assert_allclose(path.state(42.0).position_m, START, atol=1e-6)
    jittered = flown(yaw(40, 10), hover(2), jitter=1.0)
    assert jittered.state(42.0).yaw_deg == pytest.approx(400, abs=3), "the heading drifts away"


def test_yaw_in_flight_goes_on_at_the_speed_there_was():
    path = flown(yaw(3, 10), speed_m_s=2.0)
    state = path.state(3.0)
    np.testing.assert_allclose(state.velocity_m_s, 2.0 * ahead_of(state), atol=0.02)


def test_decelerate_stops_and_does_not_come_back():
    path = flown(accelerate(2.5, -12), decelerate(4, 15))
    top = path.state(2.5).velocity_m_s[0]
    assert path.state(3.0).pitch_deg == pytest.approx(15, abs=1.5)
    assert path.state(3.0).velocity_m_s[0] < top - 0.5
    speeds = along(path, np.arange(2.5, 6.5, 0.01), "velocity_m_s")[:, 0]
    assert speeds.min() > -0.05
    places = along(path, np.arange(5.0, 6.5, 0.01))
    assert np.ptp(places, axis=0).max() < 0.05
    assert along(path, np.arange(2.5, 6.5, 0.01), "pitch_deg").max() <= 15.0


def test_hover_stops_a_drone_that_comes_in_fast():
    path = flown(hover(6), speed_m_s=4.0)
    assert np.linalg.norm(path.state(6.0).velocity_m_s) < 0.02
    assert along(path, np.arange(0, 6, 0.02), "pitch_deg").max() <= 25.001


def test_take_off_leaves_the_floor_after_spinning_up_and_reaches_its_height():
    floor = (0.0, 0.0, 0.12)
    path = flown(take_off(2.5, 1.1), hover(1), position_m=floor, jitter=1.0)
    for t in np.linspace(0.0, SPIN_UP_S, 20):
        state = path.state(t)
        assert np.array_equal(state.position_m, floor), "it jitters on the floor"
        assert not state.velocity_m_s.any()
        assert (state.roll_deg, state.pitch_deg, state.yaw_deg) == (0, 0, 0)
    heights = along(path, np.arange(0, 2.5, 0.01))[:, 2]
    assert heights[int(SPIN_UP_S * 100) + 50] > 0.15
    assert heights.max() < 1.27
    assert (heights >= 0.12).all()
    assert path.state(2.5).position_m[2] == pytest.approx(1.22, abs=0.03)
    assert path.state(3.5).position_m[2] == pytest.approx(1.22, abs=0.03)


def test_take_off_with_the_nose_down_flies_forward_while_it_climbs():
    path = flown(stand(1), take_off(2.5, 1.0, -10), position_m=(0, 0, 0))
    assert np.array_equal(path.state(1.0 + 0.9 * SPIN_UP_S).position_m, [0, 0, 0])
    end = path.state(3.5)
    assert end.pitch_deg == pytest.approx(-10, abs=0.1)
    assert end.velocity_m_s[0] > 1.5
    assert end.position_m[2] == pytest.approx(1.0, abs=0.03)


def test_a_take_off_in_the_air_climbs_from_there():
    path = flown(hover(0.5), take_off(2.5, 1.0))
    assert path.state(0.5 + SPIN_UP_S).position_m[2] > START[2] + 0.01
    assert path.state(3.0).position_m[2] == pytest.approx(START[2] + 1.0, abs=0.01)


def test_roll_slips_to_the_side_that_is_down():
    for angle, side in ((10, -1), (-10, 1)):
        path = flown(roll(2, angle), speed_m_s=2.0)
        state = path.state(2.0)
        assert state.roll_deg == pytest.approx(angle, abs=0.01)
        assert side * state.velocity_m_s[1] > 1.5
        assert state.velocity_m_s[0] == pytest.approx(2.0, rel=0.02)
        slip = along(path, [0.99, 1.01], "velocity_m_s")[:, 1]
        lean = GRAVITY * math.tan(math.radians(10)) - DRAG * abs(slip.mean())
        assert side * (slip[1] - slip[0]) / 0.02 == pytest.approx(lean, rel=0.02)


def test_the_same_seed_is_the_same_flight_and_others_are_not():
    path = flown(*MIXED, seed=5, jitter=1.0)
    end = path.duration_s
    assert same_until(path, flown(*MIXED, seed=5, jitter=1.0), end)
    assert not same_until(path, flown(*MIXED, seed=6, jitter=1.0), end)
    assert same_until(flown(*MIXED, seed=5), flown(*MIXED, seed=6), end), "still air has no seed"


def test_a_longer_flight_begins_as_a_shorter_one():
    assert same_until(
        flown(*MIXED, jitter=1.0),
        flown(*MIXED, hover(3), jitter=1.0),
        sum(p.seconds for p in MIXED),
    )


def test_the_global_generator_is_left_alone():
    np.random.seed(4)
    first = np.random.random()
    np.random.seed(4)
    flown(hover(0.5), jitter=1.0)
    assert np.random.random() == first


@pytest.mark.parametrize("contact_s", [0.0004, 1.75, 2.0, 53 / 30, 5.4999])
def test_until_contact_a_flight_is_what_it_is_without(contact_s):
    free = flown(*MIXED, jitter=1.0, seed=8)
    hit = flown(*MIXED, jitter=1.0, seed=8, contact_s=contact_s)
    assert same_until(free, hit, contact_s)
    assert not same_until(free, hit, min(contact_s + 0.1, free.duration_s))
    assert hit.duration_s == free.duration_s
    assert hit.phase(contact_s) == "collision"
    assert hit.phase(contact_s - 1e-6) == free.phase(contact_s - 1e-6)


def test_contact_throws_the_drone_back_and_it_hovers_there():
    path = flown(accelerate(3, -12), contact_s=2.0)
    before, after = path.state(2.0), path.state(2.0 + 1e-6)
    np.testing.assert_allclose(after.position_m, before.position_m, atol=1e-4)
    np.testing.assert_allclose(after.velocity_m_s, -RESTITUTION * before.velocity_m_s, atol=1e-3)
    assert after.pitch_deg == pytest.approx(before.pitch_deg, abs=1e-2)
    times = np.arange(2.0, 3.0, 0.005)
    assert (along(path, times)[:, 0] <= before.position_m[0] + 0.01).all(), "it goes through"
    kicked = along(path, times, "pitch_deg") - before.pitch_deg
    assert 5.0 < kicked.max() < 25.0
    assert 0.3 < np.abs(along(path, times, "roll_deg")).max() < 10.0
    longer = flown(accelerate(8, -12), contact_s=2.0, jitter=0.0)
    end = longer.state(8.0)
    assert np.linalg.norm(end.velocity_m_s) < 0.02
    assert abs(end.pitch_deg) < 0.1
    assert before.position_m[0] - 1.0 < end.position_m[0] < before.position_m[0] - 0.1
    assert longer.phases == (("accelerate", 0.0, 2.0), ("collision", 2.0, 8.0))


def test_phases_have_no_gaps_and_contact_ends_those_that_follow():
    path = flown(hover(1), pitch(0.5, -5), cruise(1))
    assert path.phases == (("hover", 0, 1.0), ("pitch", 1.0, 1.5), ("cruise", 1.5, 2.5))
    assert path.duration_s == 2.5
    assert [path.phase(t) for t in (-1, 0, 0.999, 1.0, 1.5, 2.5, 9)] == (
        ["hover"] * 3 + ["pitch", "cruise", "cruise", "cruise"]
    )
    hit = flown(hover(1), pitch(0.5, -5), cruise(1), contact_s=1.0)
    assert hit.phases == (("hover", 0.0, 1.0), ("collision", 1.0, 2.5))


def test_a_phase_begins_on_the_frame_that_it_is_said_to():
    thirds = flown(hover(0.1), hover(0.1), hover(0.1), cruise(1))
    assert thirds.phases[3][1] > 9 / 30
    assert thirds.phase(9 / 30) == "cruise"
    path = flown(hover(40 / 30), accelerate(80 / 30, -12), decelerate(1, 10))
    assert [path.phase(n / 30) for n in (39, 40, 119, 120)] == (
        ["hover", "accelerate", "accelerate", "decelerate"]
    )


def test_contact_at_the_end_or_later_changes_nothing():
    for contact_s in (1.0, 7.0):
        path = flown(hover(1), contact_s=contact_s, jitter=1.0)
        assert same_until(path, flown(hover(1), jitter=1.0), 1.0)
        assert path.phases == (("hover", 0.0, 1.0),)


@pytest.mark.parametrize("step_s", [1e-6, 3e-4])
def test_finite_differences_of_the_pose_are_the_velocities(step_s):
    path = flown(*MIXED, jitter=1.0, seed=2, yaw_deg=200, contact_s=4.0)
    # 4 is contact, where the velocity jumps.
    for t in np.random.default_rng(1).uniform(0.01, 5.4, 60):
        before, state, after = (path.state(t + dt) for dt in (-step_s, 0, step_s))
        if abs(t - 4.0) <= step_s:
            continue
        speed = (after.position_m - before.position_m) / (2 * step_s)
        np.testing.assert_allclose(speed, state.velocity_m_s, atol=2e-4)
        turn = (after.pose.rotation - before.pose.rotation) / (2 * step_s) @ state.pose.rotation.T
        spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        np.testing.assert_allclose(spin / 2, state.angular_velocity_rad_s, atol=1e-3)


def test_the_path_is_smooth_between_its_samples():
    path = flown(*MIXED, jitter=1.0)
    times = np.arange(1.0, 1.02, 0.0001)
    speeds = along(path, times, "velocity_m_s")
    assert np.abs(np.diff(speeds, axis=0)).max() < 10 * 0.0001 * 1.5
    assert np.abs(np.diff(along(path, times), axis=0)).max() < 5 * 0.0001


def test_poses_are_states_and_times_beyond_the_ends_are_the_ends():
    path = flown(*MIXED)
    state = path.state(2.2)
    pose = path.pose(2.2)
    assert np.array_equal(pose.position_m, state.position_m)
    assert np.array_equal(pose.rotation, rotation(state.roll_deg, state.pitch_deg, state.yaw_deg))
    for beyond, end in ((-1.0, 0.0), (99.0, path.duration_s)):
        assert np.array_equal(path.pose(beyond).position_m, path.pose(end).position_m)


def test_a_path_can_be_moved():
    path = flown(*MIXED, contact_s=3.0)
    moved = path.moved([1.0, 2.0, -0.5]).moved([1.0, 0.0, 0.0])
    for t in (0.0, 1.2, 4.4):
        a, b = path.state(t), moved.state(t)
        np.testing.assert_allclose(b.position_m - a.position_m, [2.0, 2.0, -0.5], atol=1e-12)
        assert np.array_equal(a.velocity_m_s, b.velocity_m_s)
        assert np.array_equal(a.pose.rotation, b.pose.rotation)
    assert moved.phases == path.phases


def test_ten_seconds_are_simulated_in_less_than_half_of_one():
    spent = []
    for _ in range(3):
        started = time.process_time()
        flown(hover(10), jitter=1.0)
        spent.append(time.process_time() - started)
    assert min(spent) < 0.5


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: hover(0), "phase 'hover': 0 s is not above 0 and up to 3600 s."),
        (lambda: hover(math.nan), "phase 'hover': nan s is not above 0 and up to 3600 s."),
        (lambda: pitch(1, -46), "phase 'pitch': a tilt of -46° is beyond 45°."),
        (lambda: roll(1, math.inf), "phase 'roll': a tilt of inf° is beyond 45°."),
        (lambda: yaw(1, 361), "phase 'yaw': 361°/s is beyond 360°/s."),
        (lambda: decelerate(1, -3), "phase 'decelerate': -3° is not nose up."),
        (lambda: take_off(2, 0), "phase 'take off': a climb of 0 m is not above 0."),
        (lambda: take_off(9, 101), "phase 'take off': a climb of 101 m is not 0 to 100 m."),
        (lambda: take_off(1, 2), "phase 'take off': a climb of 2 m takes 1.7 s at least."),
        (lambda: flown(), "the flight's script: it has no phase."),
        (
            lambda: flown(hover(1), stand(1)),
            "the flight's script: it stands on the floor after having flown.",
        ),
        (
            lambda: flown(stand(1), hover(1)),
            "the flight's script: it does not take off from where it stands.",
        ),
        (lambda: flown(hover(1), contact_s=0), "contact_s: 0 is not above 0."),
        (lambda: flown(hover(1), contact_s=math.nan), "contact_s: nan is not above 0."),
        (lambda: flown(hover(1), jitter=-1), "jitter: -1 is not 0 to 20."),
        (lambda: flown(hover(1), speed_m_s=31), "speed_m_s: 31 is not 0 to 30."),
        (
            lambda: flown(take_off(2, 1), speed_m_s=1),
            "speed_m_s: 1, but the drone stands on the floor.",
        ),
    ],
)
def test_what_cannot_be_flown_is_refused(make, message):
    with pytest.raises(ParameterError) as error:
        make()
    assert str(error.value) == message


def test_the_shortest_climb_can_be_flown():
    seconds = climb_seconds(3.0) + 0.001
    path = flown(take_off(seconds, 3.0), hover(1), position_m=(0, 0, 0))
    heights = along(path, np.arange(0, path.duration_s, 0.01))[:, 2]
    assert heights.max() < 3.15
    assert heights[-1] == pytest.approx(3.0, abs=0.03)
