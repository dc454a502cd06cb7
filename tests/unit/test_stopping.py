"""How long before contact an alarm must begin for a stop, and thresholds that follow the speed."""

import math

import numpy as np
import pytest

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.rules import RATE_TIMES_TIME
from dlgmd_cli.models.stopping import Brakes, brakes_of, following, speed_of, stop_s
from dlgmd_cli.parameters.presets import load_config, parameters_of


def integrated_s(speed, react_s=0.1, tilt_deg=25.0, jerk_m_s3=8.0, brake_m_s2=None, step_s=1e-4):
    """`stop_s`, by small steps."""
    time_s = np.arange(0.0, 20.0, step_s)
    most = 9.81 * math.tan(math.radians(tilt_deg)) if brake_m_s2 is None else brake_m_s2
    brake = (
        np.minimum(jerk_m_s3 * time_s, most) if brake_m_s2 is None else np.full_like(time_s, most)
    )
    left = speed - np.cumsum(brake) * step_s
    return react_s + left[left > 0.0].sum() * step_s / speed


@pytest.mark.parametrize("speed", [0.3, 1.0, 1.3, 2.0, 5.0, 12.0])
@pytest.mark.parametrize(
    "brakes",
    [
        {},
        {"react_s": 0.4},
        {"tilt_deg": 10.0},
        {"tilt_deg": 45.0, "jerk_m_s3": 3.0},
        {"jerk_m_s3": 1000.0},
        {"brake_m_s2": 4.6},
    ],
)
def test_the_closed_form_is_the_integral(speed, brakes):
    assert stop_s(speed, **brakes) == pytest.approx(integrated_s(speed, **brakes), abs=1e-3)
    assert Brakes(**brakes).stop_s(speed) == stop_s(speed, **brakes)


def test_some_stops():
    assert stop_s(0.0) == stop_s(0.0, brake_m_s2=5.0) == 0.1
    assert stop_s(2.0) == pytest.approx(0.5733, abs=1e-4)
    assert stop_s(2.0, brake_m_s2=4.0) == pytest.approx(0.35)
    # Where the drone stands as soon as the deceleration is full, both equations hold.
    full = (9.81 * math.tan(math.radians(25.0))) ** 2 / 16.0
    assert stop_s(full * (1 - 1e-9)) == pytest.approx(stop_s(full), abs=1e-8)
    assert math.isnan(stop_s(math.nan))


@pytest.mark.parametrize(
    ("given", "text"),
    [
        ({}, "0.1 s of reaction, 25° of tilt, 8 m/s³ of jerk"),
        ({"tilt": 15, "react": 0.3}, "0.3 s of reaction, 15° of tilt, 8 m/s³ of jerk"),
        ({"brake": 5.0}, "0.1 s of reaction, 5 m/s² at once"),
    ],
)
def test_brakes_in_words(given, text):
    assert str(brakes_of(**given)) == text


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"react": -1.0}, "react"),
        ({"tilt": 60.0}, "tilt"),
        ({"jerk": 0.0}, "jerk"),
        ({"brake": 0.0}, "brake"),
        ({"brake": 5.0, "jerk": 8.0}, "instant"),
        ({"brake": 5.0, "tilt": 8.0}, "instant"),
    ],
)
def test_brakes_that_cannot_be(given, why):
    with pytest.raises(ParameterError, match=why):
        brakes_of(**given)


def test_speeds():
    assert speed_of("2.5") == 2.5 and speed_of(3) == 3.0 and speed_of(None) is None
    assert speed_of("autopilot", "autopilot") == "autopilot"
    for wrong in ("autopilot", "0.1", "fast", 200.0):
        with pytest.raises(ParameterError, match="speed"):
            speed_of(wrong)


def test_a_threshold_leaves_time_for_the_stop_and_a_margin():
    flight = parameters_of(load_config("flight"))
    ttc = parameters_of(load_config("flight"), {"alarm": "ttc"})
    brakes = Brakes()
    needed_s = brakes.stop_s(2.0) + 0.2
    assert following(ttc, brakes, 2.0).ttc_alarm == pytest.approx(needed_s)
    rate = following(flight, brakes, 2.0).expansion_alarm
    assert rate == pytest.approx(RATE_TIMES_TIME / needed_s)
    for standing in (0.0, 0.2, math.nan):
        assert following(flight, brakes, standing) is flight
    # No speed is too high for a threshold: it stays within the limits of the parameter.
    slowest = Brakes(brake_m_s2=0.1)
    assert following(flight, slowest, 100.0).expansion_alarm == 0.01
    assert following(ttc, slowest, 100.0).ttc_alarm == 100.0
