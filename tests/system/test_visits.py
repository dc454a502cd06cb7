"""Random flights of a given manner and speed, and what comes at a drone that hovers."""

import numpy as np
import pytest

from dlgmd_cli.scenes.flights.camera import Camera
from dlgmd_cli.scenes.flights.path import REACH_M
from dlgmd_cli.scenes.flights.random_flights import manner_of, manners, random_flight
from dlgmd_cli.scenes.flights.truth import Nearest, first_contact, truth_rows

pytestmark = pytest.mark.slow


def comer_of(stage):
    """The bodies of what comes, and their distances from the camera at times."""
    bodies = [body for body in stage.world.bodies if body.motion is not None]
    assert {body.name for body in bodies} == {stage.target}
    nearest = Nearest(bodies)

    def distance_m(time_s):
        return float(nearest.distances(stage.path.state(time_s).position_m, time_s).min())

    return bodies, distance_m


@pytest.mark.parametrize(("seed", "kind"), [(3, "drone"), (5, "ball"), (4, "person")])
def test_what_approaches_comes_into_view_hits_and_rebounds(seed, kind):
    stage = random_flight(seed, manner="approached")
    bodies, distance_m = comer_of(stage)
    contact_s = stage.contact_s
    assert stage.manner == "approached" and stage.target == kind
    assert first_contact(stage.path, stage.world) == pytest.approx(contact_s, abs=1e-4)
    assert distance_m(contact_s) == pytest.approx(REACH_M, abs=1e-4)
    before = stage.path.state(contact_s - 0.1)
    assert np.linalg.norm(before.velocity_m_s) < 1.0  # it is the other one that is fast
    paces = [np.subtract(body.motion(contact_s), body.motion(contact_s - 0.1)) for body in bodies]
    assert 0.1 <= np.linalg.norm(paces[0]) <= 0.8
    assert distance_m(contact_s + 0.3) > REACH_M + 0.02
    # It is seen, and the truth tells the time left.
    camera = Camera((90, 160), 80.0)
    rows = list(truth_rows(stage, camera, 30.0, 30))
    assert rows[20].time_to_contact_s == pytest.approx(contact_s - 20 / 30)
    at_s = contact_s - 0.3
    middle = np.mean([(body.reach(np.eye(3)) - body.reach(-np.eye(3))) / 2 for body in bodies], 0)
    x, y = camera.flatten(camera.view(middle + bodies[0].motion(at_s), stage.path.pose(at_s)))
    assert 0 <= x < 160 and 0 <= y < 90


def test_what_crosses_passes_near_by():
    stage = random_flight(4, manner="crossed")
    _, distance_m = comer_of(stage)
    assert stage.contact_s is None and first_contact(stage.path, stage.world) is None
    found = [distance_m(time_s) for time_s in np.arange(0.0, stage.duration_s, 0.02)]
    low, high = manners()["crossed"]["clear_m"]
    assert 0.8 * low < min(found) < high + 0.5
    assert found[0] - min(found) > 0.5  # it moves


@pytest.mark.parametrize("manner", ["gusts", "hit", "approached"])
def test_a_speed_is_that_of_the_cruise_or_of_what_comes(manner):
    stage = random_flight(2, manner=manner, speed_m_s=(3.0, 3.2))
    if manner == "approached":
        body = comer_of(stage)[0][0]
        way = np.subtract(body.motion(stage.contact_s), body.motion(stage.contact_s - 0.1))
        assert 3.0 <= np.linalg.norm(way) / 0.1 <= 3.2
        return
    times = np.linspace(0.1, 0.9, 5)  # in gusts, it varies
    speeds = [np.linalg.norm(stage.path.state(time_s).velocity_m_s[:2]) for time_s in times]
    assert np.median(speeds) == pytest.approx(3.1, abs=0.5)
    assert (stage.contact_s is not None) == (manner == "hit")


def test_the_seeds_of_before_there_were_visits_are_flown_as_before():
    drawn = ["storm", "pass", "hit", "hit", "light", "low", "pass", "gusts", "hit", "people"]
    assert [manner_of(seed) for seed in range(10)] == drawn
    visits = [seed for seed in range(400) if manner_of(seed) in ("approached", "crossed")]
    assert 0.04 < len(visits) / 400 < 0.1


def test_a_speed_on_the_command_line_and_in_the_record(dlgmd, runs):
    small = ["--size", "16x16", "--frames", 2, "--manner", "hit", "--speed"]
    runs("synth", "random", *small, "1:3", "--count", 1, "--out", "s1")
    again = dlgmd("synth", "random", *small, "1:3", "--count", 1, "--out", "s1")
    assert "1 of 1 flights were already there" in again.stderr
    other = dlgmd("synth", "random", *small, "2", "--count", 1, "--out", "s1")
    assert other.exit_code == 2 and "another flight already exists here (--speed)" in other.stderr
