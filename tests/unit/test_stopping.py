"""How long before contact an alarm must begin for a stop, and thresholds that follow the speed."""

import math

import pytest

from dlgmd_cli.errors import DlgmdWarning, ParameterError
from dlgmd_cli.models.rules import RATE_TIMES_TIME
from dlgmd_cli.models.stopping import Brake, brake_of, followed_speed, following, speed_of
from dlgmd_cli.parameters.presets import load_config, parameters_of

# The distances (m) of ArduCopter 4.7-dev in its simulator, in the mode BRAKE.
SIMULATED = [
    ("arducopter", 1, 1.55),
    ("arducopter", 2, 3.33),
    ("arducopter", 3, 5.14),
    ("arducopter", 5, 9.17),
    ("arducopter:10", 3, 3.00),
    ("arducopter:20", 3, 1.95),
    # As the greatest distance over speed.
    ("arducopter:10", 5, 5 * 1.11),
    ("arducopter:20", 5, 5 * 0.76),
]


@pytest.mark.parametrize(("brake", "speed", "distance_m"), SIMULATED)
def test_arducopter_stops_as_in_its_simulator(brake, speed, distance_m):
    assert Brake.parse(brake).distance_m(speed) == pytest.approx(distance_m, rel=0.07)


def integrated_s(speed, wanted, jerk, most, step_s=2e-4):
    """Distance over speed of a drone whose deceleration aims at `wanted(v)`, by small steps."""
    v, decel, distance_m = speed, 0.0, 0.0
    while v > 1e-4 * speed:
        decel = min(decel + jerk * step_s, wanted(v), most)
        v -= decel * step_s
        distance_m += v * step_s
    return distance_m / speed


@pytest.mark.parametrize("speed", [0.3, 1.3, 2.0, 25.0])
@pytest.mark.parametrize("jerk", [3.0, 18.8])
def test_the_shaping_s_closed_form_is_its_integral(speed, jerk):
    most = 9.81 * math.tan(math.radians(30.0))
    shaped_s = integrated_s(speed, lambda v: v * jerk / 7.5, jerk, most)
    assert Brake("arducopter", jerk).distance_m(speed) / speed - 0.08 == pytest.approx(
        shaped_s, rel=2e-3
    )


@pytest.mark.parametrize("speed", [0.3, 1.0, 1.3, 2.0, 5.0, 12.0])
@pytest.mark.parametrize(("tilt", "jerk"), [(25, 8), (10, 8), (45, 3), (25, 1000)])
def test_the_closed_form_of_a_tilt_is_its_integral(speed, tilt, jerk):
    most = 9.81 * math.tan(math.radians(tilt))
    found = brake_of(tilt=tilt, jerk=jerk, react=0.4).stop_s(speed)
    expected = 0.4 + integrated_s(speed, lambda v: math.inf, jerk, most)
    assert found == pytest.approx(expected, abs=1e-3)


def test_some_stops():
    assert Brake.parse("tilt").stop_s(0.0) == Brake.parse(5.0).stop_s(0.0) == 0.1
    assert Brake.parse("tilt").stop_s(2.0) == pytest.approx(0.5733, abs=1e-4)
    assert Brake.parse("4").stop_s(2.0) == pytest.approx(0.35)
    assert Brake.parse("1.7 s").stop_s(2.0) == pytest.approx(1.8)
    assert Brake.parse("1.7s").distance_m(2.0) == pytest.approx(3.4)
    # Its Navigator: computeBrakingDistanceFromVelocity(v, 4, 3, 0.6 * 4).
    assert Brake.parse("PX4").distance_m(3.0) == pytest.approx(3.0 * (3.0 / 6.0 + 0.6))
    # A larger parameter does not stop sooner, as the attitude's acceleration limits the jerk.
    assert Brake.parse("arducopter:30").stop_s(3.0) == Brake.parse("arducopter:20").stop_s(3.0)
    assert Brake.parse("arducopter").stop_s(0.0) == pytest.approx(0.1 + 0.08 + 1.5)
    # Where the drone stands as soon as the deceleration is full, both equations hold.
    full = (9.81 * math.tan(math.radians(25.0))) ** 2 / 16.0
    tilt = Brake.parse("tilt")
    assert tilt.stop_s(full * (1 - 1e-9)) == pytest.approx(tilt.stop_s(full), abs=1e-8)
    for how in ("arducopter", "px4", "tilt", "4"):
        assert math.isnan(Brake.parse(how).stop_s(math.nan))


@pytest.mark.parametrize(
    ("given", "text", "words"),
    [
        ({}, "arducopter:20", "0.1 s of reaction, BRAKE of ArduCopter with PSC_JERK_XY 20"),
        ({"brake": "arducopter:5"}, "arducopter", "with PSC_JERK_XY 5"),
        ({"brake": "tilt"}, "tilt", "0.1 s of reaction, 25° of tilt, 8 m/s³ of jerk"),
        ({"tilt": 15, "react": 0.3}, "tilt", "0.3 s of reaction, 15° of tilt, 8 m/s³ of jerk"),
        ({"brake": "tilt", "jerk": 4}, "tilt", "25° of tilt, 4 m/s³ of jerk"),
        ({"brake": 5.0}, "5", "0.1 s of reaction, 5 m/s² at once"),
        ({"brake": "1.7s"}, "1.7s", "1.7 s times the speed"),
        ({"brake": "px4"}, "px4", "Hold of PX4, by its source"),
    ],
)
def test_brakes_in_words(given, text, words):
    brake = brake_of(**given)
    assert brake.text == text and str(brake).endswith(words)


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"react": -1.0}, "react"),
        ({"tilt": 60.0}, "tilt"),
        ({"jerk": 0.0}, "jerk"),
        ({"brake": 0.0}, "brake: 0.0 is not above 0. Write arducopter, "),
        ({"brake": "ardupilot"}, "brake: 'ardupilot' is not a number. Write arducopter, "),
        ({"brake": "arducopter:"}, "brake"),
        ({"brake": "arducopter:0"}, "brake"),
        ({"brake": "px4:4"}, "brake"),
        ({"brake": "nan"}, "brake"),
        ({"brake": "0s"}, "brake"),
        ({"brake": "s"}, "brake"),
        ({"brake": True}, "brake"),
        ({"brake": ""}, "brake"),
        ({"brake": 5.0, "jerk": 8.0}, "tilt and jerk exclude brake=5.0"),
        ({"brake": "arducopter", "tilt": 8.0}, "exclude brake='arducopter'. .* brake='tilt'"),
    ],
)
def test_brakes_that_cannot_be(given, why):
    with pytest.raises(ParameterError, match=why):
        brake_of(**given)


def test_speeds():
    assert speed_of("2.5") == 2.5 and speed_of(3) == 3.0
    for wrong in ("autopilot", "0.1", "fast", 200.0):
        with pytest.raises(ParameterError, match="speed"):
            speed_of(wrong)
    assert followed_speed(3) == 3.0
    with pytest.warns(DlgmdWarning, match="do not brake by the alarm above 3 m/s"):
        assert followed_speed("5") == 5.0


def test_a_threshold_leaves_time_for_the_stop_and_a_margin():
    flight = parameters_of(load_config("flight"))
    ttc = parameters_of(load_config("flight"), {"alarm": "ttc"})
    stock = Brake.parse("arducopter")
    needed_s = stock.stop_s(2.0) + 0.2
    assert following(ttc, stock, 2.0).ttc_alarm == pytest.approx(needed_s)
    rate = following(flight, stock, 2.0).expansion_alarm
    assert rate == pytest.approx(RATE_TIMES_TIME / needed_s)
    # Where the stop is short, alarms begin no later than without a speed.
    brake = Brake()
    assert RATE_TIMES_TIME / (brake.stop_s(2.0) + 0.2) > flight.expansion_alarm
    assert following(flight, brake, 2.0).expansion_alarm == flight.expansion_alarm
    assert following(ttc, brake, 2.0).ttc_alarm == ttc.ttc_alarm
    for standing in (0.0, 0.2, math.nan):
        assert following(flight, brake, standing) is flight
    # No speed is too high for a threshold: it stays within the limits of the parameter.
    slowest = Brake.parse(0.1)
    assert following(flight, slowest, 100.0).expansion_alarm == 0.01
    assert following(ttc, slowest, 100.0).ttc_alarm == 100.0
