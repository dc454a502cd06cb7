"""The quadrotor obeys its physics, and its path is smooth, exact and repeatable."""

import math

import numpy as np
import pytest
from flightscenes import accelerate, cruise, decelerate, hover, pitch, roll, stand, take_off, yaw

from dlgmd_cli.scenes.flights.drone import RESTITUTION, SPIN_UP_S, fly
from dlgmd_cli.scenes.flights.path import shaken

pytestmark = pytest.mark.slow

START = (1.0, -2.0, 1.5)
GRAVITY, DRAG = 9.81, 0.35
MIXED = [hover(0.6), pitch(0.4, -8), accelerate(1.0, -14), cruise(0.8, 40), roll(0.6, 9)]
MIXED += [decelerate(1.6, 15), yaw(0.5, -120)]


def flown(*script, **options):
    return fly(script, **{"position_m": START, "jitter": 0.0, **options})


def along(path, times, what="position_m"):
    return np.array([getattr(path.state(t), what) for t in times])


def ahead_of(state):
    nose = math.radians(state.yaw_deg)
    return np.array([math.cos(nose), math.sin(nose), 0.0])


def numbers(path, time_s):
    state = path.state(time_s)
    angles = state.roll_deg, state.pitch_deg, state.yaw_deg
    return [*state.position_m, *state.velocity_m_s, *state.angular_velocity_rad_s, *angles]


def same_until(path, other, end_s):
    return all(numbers(path, t) == numbers(other, t) for t in np.linspace(0.0, end_s, 50))


# Phases


def test_a_hover_holds_the_spot_and_gusts_move_it_by_about_a_centimetre():
    places = along(flown(hover(3)), np.linspace(0, 3, 50))
    np.testing.assert_allclose(places, np.broadcast_to(START, places.shape), atol=1e-9)
    path = flown(hover(20), jitter=1.0, seed=3)
    times = np.linspace(5, 20, 200)
    sway = (along(path, times) - START).std(axis=0)
    assert (sway > 0.003).all() and (sway < 0.02).all()
    for angle in ("roll_deg", "pitch_deg", "yaw_deg"):
        assert 0.1 < along(path, times, angle).std() < 0.8


def test_pitching_down_accelerates_by_what_the_thrust_leaves():
    path = flown(accelerate(12, -12), yaw_deg=90.0)
    for t in (1.2, 1.8, 3.0):
        before, state, after = (path.state(t + dt) for dt in (-0.01, 0.0, 0.01))
        assert state.pitch_deg == pytest.approx(-12, abs=0.2)
        gained = (after.velocity_m_s - before.velocity_m_s) @ [0, 1, 0] / 0.02
        lean = math.tan(math.radians(-state.pitch_deg))
        assert gained == pytest.approx(GRAVITY * lean - DRAG * state.velocity_m_s[1], rel=0.02)
        assert state.position_m[[0, 2]] == pytest.approx([START[0], START[2]], abs=0.01)
    terminal = GRAVITY * math.tan(math.radians(12)) / DRAG
    assert path.state(12).velocity_m_s[1] == pytest.approx(terminal, rel=0.02)


def test_cruise_keeps_its_speed_with_the_nose_a_little_down():
    state = flown(cruise(3), speed_m_s=3.0).state(3.0)
    np.testing.assert_allclose(state.velocity_m_s, [3, 0, 0], atol=1e-3)
    assert state.pitch_deg == pytest.approx(-math.degrees(math.atan(DRAG * 3 / GRAVITY)), abs=0.01)
    after = flown(accelerate(2, -12), cruise(3))
    kept = np.linalg.norm(after.state(2.0).velocity_m_s)
    assert np.linalg.norm(after.state(5.0).velocity_m_s) == pytest.approx(kept, rel=0.01)


def test_cruise_with_a_yaw_rate_flies_a_banked_curve():
    path, rate = flown(cruise(6, 30), speed_m_s=2.0), math.radians(30)
    for t in (2.0, 3.5, 5.0):
        state = path.state(t)
        speed = np.linalg.norm(state.velocity_m_s)
        assert state.angular_velocity_rad_s[2] == pytest.approx(rate, rel=0.02)
        assert speed == pytest.approx(2.0, rel=0.02)
        assert state.velocity_m_s @ ahead_of(state) / speed > 0.999, "it slips sideways"
        bank = -math.degrees(math.atan(2.0 * rate / GRAVITY))
        assert state.roll_deg == pytest.approx(bank, rel=0.05)
    begin = path.state(2.0)
    centre = begin.position_m + np.cross([0, 0, 1], begin.velocity_m_s) / rate
    assert math.dist(path.state(5).position_m, centre) == pytest.approx(2.0 / rate, rel=0.02)


def test_yaw_turns_on_the_spot_and_in_flight_goes_on_at_its_speed():
    path = flown(yaw(10, 40), hover(2), yaw_deg=5.0)
    assert path.state(0.0).angular_velocity_rad_s[2] == 0.0
    assert path.state(5.0).angular_velocity_rad_s == pytest.approx([0, 0, math.radians(40)])
    assert path.state(12.0).yaw_deg == pytest.approx(5 + 400, abs=0.01), "beyond a full turn"
    np.testing.assert_allclose(path.state(12.0).position_m, START, atol=1e-6)
    gusty = flown(yaw(10, 40), hover(2), jitter=1.0)
    assert gusty.state(12.0).yaw_deg == pytest.approx(400, abs=3), "the heading drifts away"
    state = flown(yaw(3, 10), speed_m_s=2.0).state(3.0)
    np.testing.assert_allclose(state.velocity_m_s, 2.0 * ahead_of(state), atol=0.02)


def test_decelerate_stops_and_does_not_come_back():
    path = flown(accelerate(2.5, -12), decelerate(4, 15))
    assert path.state(3.6).pitch_deg == pytest.approx(15, abs=1.5)
    assert path.state(3.4).velocity_m_s[0] < path.state(2.5).velocity_m_s[0] - 0.5
    times = np.arange(2.5, 6.5, 0.01)
    assert along(path, times, "velocity_m_s")[:, 0].min() > -0.1
    assert along(path, times, "pitch_deg").max() <= 15.0
    assert np.ptp(along(path, times[250:]), axis=0).max() < 0.07


def test_take_off_leaves_the_floor_after_spinning_up_and_reaches_its_height():
    floor = (0.0, 0.0, 0.12)
    path = flown(take_off(2.5, 1.1), hover(1), position_m=floor, jitter=1.0)
    for t in np.linspace(0.0, SPIN_UP_S, 20):
        assert numbers(path, t) == [*floor, *[0.0] * 9], "it sways on the floor"
    heights = along(path, np.arange(0, 2.5, 0.01))[:, 2]
    assert heights[int(SPIN_UP_S * 100) + 50] > 0.15
    assert (heights >= 0.12).all() and heights.max() < 1.27
    assert along(path, [2.5, 3.5])[:, 2] == pytest.approx(1.22, abs=0.03)


def test_take_off_with_the_nose_down_flies_forward_and_in_the_air_it_climbs_at_once():
    path = flown(stand(1), take_off(2.5, 1.0, -10), position_m=(0, 0, 0))
    assert np.array_equal(path.state(1.0 + 0.9 * SPIN_UP_S).position_m, [0, 0, 0])
    end = path.state(3.5)
    assert end.pitch_deg == pytest.approx(-10, abs=0.1) and end.velocity_m_s[0] > 1.5
    assert end.position_m[2] == pytest.approx(1.0, abs=0.03)
    airborne = flown(hover(0.5), take_off(2.5, 1.0))
    assert airborne.state(0.5 + SPIN_UP_S).position_m[2] > START[2] + 0.01
    assert airborne.state(3.0).position_m[2] == pytest.approx(START[2] + 1.0, abs=0.01)


@pytest.mark.parametrize(("angle", "side"), [(10, -1), (-10, 1)])
def test_roll_slips_to_the_side_that_is_down(angle, side):
    path = flown(roll(2, angle), speed_m_s=2.0)
    state = path.state(2.0)
    assert state.roll_deg == pytest.approx(angle, abs=0.01)
    assert side * state.velocity_m_s[1] > 1.5
    assert state.velocity_m_s[0] == pytest.approx(2.0, rel=0.02)
    slip = along(path, [0.99, 1.01], "velocity_m_s")[:, 1]
    lean = GRAVITY * math.tan(math.radians(10)) - DRAG * abs(slip.mean())
    assert side * (slip[1] - slip[0]) / 0.02 == pytest.approx(lean, rel=0.02)


@pytest.mark.parametrize(
    ("order", "axis", "most"),
    [(pitch(2, -11), 1, 6.0), (roll(2, 9), 0, 6.0), (yaw(2, 30), 2, 2.1)],
    ids=["pitch", "roll", "yaw"],
)
def test_orders_are_eased_unless_the_drone_is_agile(order, axis, most):
    """Rates change smoothly, by so many degrees/s a frame at most; in the end all is alike."""
    eased, agile = (flown(hover(1), order, agile=agile) for agile in (False, True))
    spins, others = (
        np.degrees(along(path, np.arange(28, 90) / 30, "angular_velocity_rad_s")[:, axis])
        for path in (eased, agile)
    )
    assert 0.5 * most < np.abs(np.diff(spins)).max() < most
    assert np.abs(np.diff(others)).max() > 2.5 * most
    assert np.abs(spins).max() < 48.0
    ends = [numbers(path, 3.0) for path in (eased, agile)]
    assert ends[0][6:11] == pytest.approx(ends[1][6:11], abs=0.3)


# Contact


@pytest.mark.parametrize("contact_s", [0.0004, 53 / 30, 5.4999])
def test_until_contact_a_flight_is_what_it_is_without(contact_s):
    free = flown(*MIXED, jitter=1.0, seed=8)
    hit = flown(*MIXED, jitter=1.0, seed=8, contact_s=contact_s)
    assert same_until(free, hit, contact_s)
    assert not same_until(free, flown(*MIXED, jitter=1.0, seed=6), 1.0)
    assert not same_until(free, hit, min(contact_s + 0.1, free.duration_s))
    assert hit.duration_s == free.duration_s
    assert hit.phase(contact_s) == "collision"
    assert hit.phase(contact_s - 1e-6) == free.phase(contact_s - 1e-6)


def test_contact_throws_the_drone_back_and_it_hovers_there():
    path = flown(accelerate(8, -12), contact_s=2.0)
    before, after = path.state(2.0), path.state(2.0 + 1e-6)
    np.testing.assert_allclose(after.position_m, before.position_m, atol=1e-4)
    np.testing.assert_allclose(after.velocity_m_s, -RESTITUTION * before.velocity_m_s, atol=1e-3)
    times = np.arange(2.0, 3.0, 0.005)
    assert (along(path, times)[:, 0] <= before.position_m[0] + 0.01).all(), "it goes through"
    kicked = along(path, times, "pitch_deg") - before.pitch_deg
    assert kicked[0] == pytest.approx(0.0, abs=1e-2) and 5.0 < kicked.max() < 25.0
    assert 0.3 < np.abs(along(path, times, "roll_deg")).max() < 10.0
    end = path.state(8.0)
    assert np.linalg.norm(end.velocity_m_s) < 0.02 and abs(end.pitch_deg) < 0.1
    assert before.position_m[0] - 1.0 < end.position_m[0] < before.position_m[0] - 0.1
    assert path.phases == (("accelerate", 0.0, 2.0), ("collision", 2.0, 8.0))


# Paths


def test_phases_have_no_gaps_and_begin_on_the_frames_that_they_are_said_to():
    path = flown(hover(1), pitch(0.5, -5), cruise(1))
    assert path.phases == (("hover", 0, 1.0), ("pitch", 1.0, 1.5), ("cruise", 1.5, 2.5))
    found = [path.phase(t) for t in (0, 0.999, 1.0, 1.5, 2.5, 9)]
    assert found == ["hover"] * 2 + ["pitch"] + ["cruise"] * 3
    hit = flown(hover(1), pitch(0.5, -5), contact_s=1.0)
    assert hit.phases == (("hover", 0.0, 1.0), ("collision", 1.0, 1.5))
    thirds = flown(hover(0.1), hover(0.1), hover(0.1), cruise(1))
    assert thirds.phases[3][1] > 9 / 30 and thirds.phase(9 / 30) == "cruise"


SHAKE = {"shake_deg_s": 20.0, "shake_hz": (0.5, 6.0), "bob_m": 0.03, "step_hz": 2.0}


def shaky(path, **options):
    return shaken(path, np.random.default_rng(7), {**SHAKE, **options})


def test_a_shaken_camera_turns_as_fast_and_bobs_as_far_as_it_should():
    still = flown(hover(60))
    times = np.arange(0.0, 60.0, 0.02)
    path = shaky(still)
    spin = np.degrees(along(path, times, "angular_velocity_rad_s"))
    assert np.sqrt((spin**2).mean(axis=0)) == pytest.approx([20.0] * 3, rel=0.2)
    assert 45 < np.abs(spin).max() < 20 * 4 * 3**0.5
    bob = along(path, times) - START
    assert np.abs(bob).max(axis=0) == pytest.approx([0.0, 0.015, 0.03], abs=1e-3)
    is_up = bob[:, 2] > 0
    assert np.count_nonzero(is_up[1:] & ~is_up[:-1]) == pytest.approx(60 * 2, abs=1)


def test_a_shake_leaves_the_way_and_the_contact_as_they_are():
    contact_s = 2.0
    free, hit = (flown(*MIXED, jitter=3.0, contact_s=when) for when in (None, contact_s))
    calm = {"bob_m": 0.0}
    assert same_until(shaky(free, **calm), shaky(hit, **calm), contact_s)
    times = np.linspace(0.0, hit.duration_s, 50)
    np.testing.assert_array_equal(along(shaky(hit, **calm), times), along(hit, times))
    assert same_until(shaky(free, shake_deg_s=0.0, **calm), free, free.duration_s)


@pytest.mark.parametrize("change", [lambda path: path, shaky])
def test_finite_differences_of_the_pose_are_the_velocities(change):
    step_s = 3e-4
    path = change(flown(*MIXED, jitter=1.0, seed=2, yaw_deg=200, contact_s=4.0))
    for t in np.random.default_rng(1).uniform(0.01, 5.4, 60):
        if abs(t - 4.0) <= step_s:  # contact, where the velocity jumps
            continue
        before, state, after = (path.state(t + dt) for dt in (-step_s, 0, step_s))
        speed = (after.position_m - before.position_m) / (2 * step_s)
        np.testing.assert_allclose(speed, state.velocity_m_s, atol=2e-4)
        turn = (after.pose.rotation - before.pose.rotation) / (2 * step_s) @ state.pose.rotation.T
        spin = np.array([turn[2, 1] - turn[1, 2], turn[0, 2] - turn[2, 0], turn[1, 0] - turn[0, 1]])
        np.testing.assert_allclose(spin / 2, state.angular_velocity_rad_s, atol=1e-3)


def test_times_beyond_the_ends_are_the_ends():
    path = flown(*MIXED)
    for beyond, end in ((-1.0, 0.0), (99.0, path.duration_s)):
        assert numbers(path, beyond) == numbers(path, end)
