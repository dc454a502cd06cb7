"""What an alarm is worth: the drone brakes, and the path is followed to its end."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.scenes.flights.braking import Brakes, Stoppable
from dlgmd_cli.scenes.flights.path import REACH_M, Path, Stage, Stretch
from dlgmd_cli.scenes.flights.solids import Capsule, Solid, Texture, World, quad
from dlgmd_cli.tasks.evaluate.stopping import brakes_of, brakes_text

GREY = Texture([[0.5]])
WALL = quad((5, 20, 9), (0, -40, 0), (0, 0, -9), GREY)


def flight(speed, *bodies, contact_s=None, agile=False, seconds=4.0):
    """Along x from x = 0, at a height of 4 m; the wall is at x = 5."""
    start = [0.0, 0.0, 4.0, speed, 0, 0, 0, 0, 0, 0, 0, 0]
    end = [speed * seconds, *start[1:]]
    path = Path([Stretch(0.0, seconds, np.array([start, end]))], (("cruise", 0.0, seconds),))
    solid = Solid("wall", [WALL])
    target, wall = (bodies[0].name, None) if bodies else ("wall", solid)
    world = World(solid, bodies)
    return Stoppable(Stage(world, path, target, contact_s, seconds, agile, wall))


def needed_m(speed, react_s, brake=None):
    """The way to the stop: at once with `brake`, or at 8 m/s³ up to a lean of 25 degrees."""
    if brake is not None:
        return speed * react_s + speed**2 / 2 / brake
    most = 9.81 * math.tan(math.radians(25))
    times = np.arange(0.0, 3.0, 1e-5)
    speeds = speed - np.cumsum(np.minimum(8.0 * times, most)) * 1e-5
    return speed * react_s + np.maximum(speeds, 0.0).sum() * 1e-5


@pytest.mark.parametrize("speed", [0.5, 2.0, 4.0])
@pytest.mark.parametrize(
    ("brakes", "decel"),
    [
        (Brakes(), None),
        (Brakes(react_s=0.3), None),
        (Brakes(agile=True), 9.81 * math.tan(math.radians(25))),
        (Brakes(brake_m_s2=8.0), 8.0),
    ],
)
def test_the_latest_alarm_that_saves_leaves_just_the_way_that_braking_takes(speed, brakes, decel):
    contact_s = (5.0 - REACH_M) / speed
    found = flight(speed, contact_s=contact_s, seconds=contact_s + 1)
    lead_s = needed_m(speed, brakes.react_s, decel) / speed
    early, late = (found.stop(contact_s - lead_s * share, brakes) for share in (1.01, 0.99))
    assert early.saved and early.stopped_m == pytest.approx(0.01 * lead_s * speed, abs=2e-3)
    assert math.isnan(early.impact_m_s) and math.isnan(late.stopped_m)
    assert not late.saved and 0.0 < late.impact_m_s < 0.3 * speed
    assert found.can_stop and found.speed_m_s == pytest.approx(speed)
    assert found.needed_s(0.5, brakes) == pytest.approx(lead_s, rel=1e-3)


def test_no_stop_helps_a_drone_that_stands():
    assert math.isnan(Brakes().needed_s(0.29)) and math.isnan(Brakes().needed_s(math.nan))
    assert Brakes().needed_s(0.3) > 0.1


def test_an_alarm_within_the_reaction_changes_nothing():
    found = flight(2.0, contact_s=2.45)
    for alarm_s in (2.36, 2.45):
        assert found.stop(alarm_s, Brakes()).impact_m_s == pytest.approx(2.0)


def test_the_drone_of_the_flight_brakes_as_it_can_unless_told_otherwise():
    agile = flight(3.0, contact_s=4.9 / 3, agile=True)
    alarm_s = 4.9 / 3 - 0.5
    assert agile.stop(alarm_s, Brakes()).saved
    assert not agile.stop(alarm_s, Brakes(agile=False)).saved


def test_a_stop_is_justified_if_straight_on_something_would_be_hit_within_a_second_and_a_half():
    found = flight(2.0)
    at_wall_s = 4.9 / 2.0
    assert not found.is_justified(at_wall_s - 1.52) and found.is_justified(at_wall_s - 1.48)
    assert not flight(0.0).is_justified(1.0)


def test_who_hovers_cannot_stop_what_comes_but_a_stop_for_it_is_justified():
    ends = np.array([[3.0, 0.0, 4.0]] * 2)

    def comes(time_s):
        return -1.0 * time_s, 0.0, 0.0

    ball = Capsule("ball", ends, 0.2, GREY, motion=comes)
    found = flight(0.0, ball, contact_s=2.7)
    assert not found.can_stop and found.speed_m_s == pytest.approx(1.0)
    assert found.is_justified(1.3) and not found.is_justified(1.0)
    # One that stands in the way can be stopped for.
    assert flight(1.0, Capsule("ball", ends, 0.2, GREY), contact_s=2.7).can_stop


_SPEEDS, _TILTS = st.floats(0.3, 10.0), st.floats(5.0, 45.0)
_JERKS, _BRAKING, _REACTS = st.floats(0.1, 1000.0), st.floats(0.1, 100.0), st.floats(0.0, 10.0)


@given(_SPEEDS, _REACTS, st.tuples(_TILTS, _TILTS), st.tuples(_JERKS, _JERKS))
def test_a_weaker_stabilised_drone_never_gets_a_later_alarm(speed, react, tilts, jerks):
    """Less tilt, less jerk, or both."""
    weak = Brakes(react, agile=False, tilt_deg=min(tilts), jerk_m_s3=min(jerks))
    strong = Brakes(react, agile=False, tilt_deg=max(tilts), jerk_m_s3=max(jerks))
    assert weak.needed_s(speed) >= strong.needed_s(speed) - 1e-9
    at_once = Brakes(react, agile=True, tilt_deg=min(tilts))
    assert weak.needed_s(speed) >= at_once.needed_s(speed) - 1e-9


@given(_SPEEDS, st.tuples(_REACTS, _REACTS), st.tuples(_BRAKING, _BRAKING))
def test_a_weaker_brake_or_a_slower_pilot_never_gets_a_later_alarm(speed, reacts, brakes):
    weak, strong = Brakes(max(reacts), min(brakes)), Brakes(min(reacts), max(brakes))
    assert weak.needed_s(speed) >= strong.needed_s(speed) - 1e-9


def test_how_a_drone_brakes_is_checked_and_said():
    brakes = brakes_of(0.1, None, None, 20, None)
    assert (brakes.agile, brakes.tilt_deg, brakes.jerk_m_s3) == (False, 20.0, 8.0)
    assert brakes_text(brakes) == "braking stabilised (20°, 8 m/s³)"
    assert brakes_text(brakes_of(0.1, None, True, 20)) == "braking with instant tilt of 20°"
    assert brakes_text(brakes_of(0.1, None, True)) == "braking with instant tilt"
    for wrong in ((4, None, None), (None, 0, None), (20, None, 8.0), (None, 8, 8.0)):
        with pytest.raises(ParameterError):
            brakes_of(0.1, wrong[2], None, wrong[0], wrong[1])
    with pytest.raises(ParameterError):
        brakes_of(0.1, None, True, None, 8)


@pytest.mark.parametrize(("tilt", "jerk"), [(4.9, 8), (45.1, 8), (20, 0.09), (20, 1000.5)])
def test_a_tilt_and_a_jerk_have_limits(tilt, jerk):
    with pytest.raises(ParameterError, match=r"is not at least|is more than"):
        brakes_of(0.1, None, None, tilt, jerk)
    limits = brakes_of(0.1, None, None, 5, 0.1), brakes_of(0.1, None, None, 45, 1000)
    assert [(one.tilt_deg, one.jerk_m_s3) for one in limits] == [(5.0, 0.1), (45.0, 1000.0)]
