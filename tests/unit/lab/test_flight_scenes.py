"""Flights as scenes: their options, their length, and what is recorded of them."""

import pytest
from flightscenes import DURATION_S, Quick


@pytest.fixture
def scene():
    return Quick()


# Options


def test_options_at_their_limits(scene):
    for flag in ("--exposure", "--rolling-shutter"):
        assert scene.configure({flag: 1000 / 30, "--fps": 30.0})
        assert scene.configure({flag: 33.4, "--fps": 29.9})
    assert scene.n_frames(scene.configure({"--frames": 19})) == 19


def test_an_agile_drone_is_another_flight_and_the_record_says_so(scene):
    for agile in (True, False, None):
        assert scene.record(scene.configure({"--agile": agile}))["agile"] is bool(agile)


# Length and record


@pytest.mark.parametrize(("fps", "n_frames"), [(30.0, 19), (10.0, 7), (12.5, 8), (1.0, 1)])
def test_a_clip_is_as_long_as_the_flight(scene, fps, n_frames):
    options = scene.configure({"--fps": fps})
    assert scene.n_frames(options) == n_frames
    assert (n_frames - 1) / fps <= DURATION_S + 1e-9 < n_frames / fps
    assert len(list(scene.truth(options))) == scene.record(options)["frames"] == n_frames


@pytest.mark.parametrize(
    ("seed", "fps", "frame", "time_s"),
    [
        (0, 30.0, None, None),
        (1, 30.0, 12, 0.4),
        (11, 25.0, 7, 0.28),  # 0.28 * 25 > 7 in floating point
        (3, 30.0, 13, 0.41),
        (3, 100.0, 41, 0.41),
        (5, 30.0, 18, 0.6),
        (7, 30.0, None, 0.601),
    ],
)
def test_the_collision_is_the_first_frame_at_or_after_contact(scene, seed, fps, frame, time_s):
    record = scene.record(scene.configure({"--seed": seed, "--fps": fps}))
    assert (record["collision_frame"], record["collision_time_s"]) == (frame, time_s)


def test_a_collision_beyond_the_clip_is_none_of_its_frames(scene):
    cut = scene.record(scene.configure({"--seed": 1, "--frames": 12}))
    assert (cut["collision_frame"], cut["collision_time_s"]) == (None, 0.4)
    assert scene.record(scene.configure({"--seed": 1, "--frames": 13}))["collision_frame"] == 12


@pytest.mark.parametrize("fps", [7.0, 30.0, 119.88])
def test_phases_are_those_of_the_truth(scene, fps):
    options = scene.configure({"--fps": fps})
    spelled_out = [
        phase["name"]
        for phase in scene.record(options)["phases"]
        for _ in range(phase["first_frame"], phase["last_frame"] + 1)
    ]
    assert spelled_out == [row.phase for row in scene.truth(options)]
