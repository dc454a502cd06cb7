"""The peak's time against l/|v|, and its fit."""

import math

import numpy as np
import pytest
from conftest import FPS, make_result

from dlgmd_cli import looming_fit, peak_before_contact
from dlgmd_cli.errors import ParameterError


def test_the_fit_is_the_regression_with_its_intervals():
    x, rng = np.repeat(np.arange(0.01, 0.08, 0.01), 3), np.random.default_rng(3)
    y = 4.7 * x - 0.027 + rng.normal(0, 0.004, len(x))
    fit, ((slope, intercept), covariance) = looming_fit(x, y), np.polyfit(x, y, 1, cov=True)
    half = 2.0738730679 * np.sqrt(np.diag(covariance))  # Student's t of 22 degrees of freedom
    assert fit.slope == pytest.approx(slope)
    assert fit.slope_high - fit.slope == pytest.approx(half[0])
    assert fit.delay_s == pytest.approx(-intercept)
    assert fit.delay_s - fit.delay_low_s == pytest.approx(half[1])
    assert (fit.r_squared, fit.n) == (pytest.approx(np.corrcoef(x, y)[0, 1] ** 2), len(x))
    assert fit.slope_low < 4.7 < fit.slope_high and fit.delay_low_s < 0.027 < fit.delay_high_s
    assert fit.angle_low_deg < fit.angle_deg < fit.angle_high_deg
    assert fit.angle_deg == pytest.approx(2 * np.degrees(np.arctan(1 / slope)))
    # What the data cannot give is not given: an approach without a peak, an interval of two.
    two = looming_fit([0.02, 0.04, 0.06], [0.05, 0.11, np.nan])
    assert two.n == 2 and two.slope == pytest.approx(3.0)
    assert all(map(math.isnan, (two.slope_low, two.delay_high_s, two.angle_low_deg)))
    wrong = [([0.02, 0.02], [0.1, 0.2]), ([0.02], [0.1, 0.2]), ([0.02, 0.04], [0.1, np.nan])]
    for x, y in (*wrong, ([0.02, -0.04], [0.1, 0.2])):
        with pytest.raises(ParameterError, match=r"l/\|v\|"):
            looming_fit(x, y)


def test_the_peak_is_the_greatest_before_the_contact():
    mp = np.zeros(50)
    mp[[20, 30, 45]] = 2.0, 5.0, 9.0  # the last is the recoil
    result = make_result(mp)
    assert peak_before_contact(result.until(40)) == pytest.approx(10 / FPS)
    assert peak_before_contact(result, 25 / FPS) == pytest.approx(5 / FPS)
    assert math.isnan(peak_before_contact(result, 10 / FPS))
    with pytest.raises(ParameterError, match="the contact of flight is not known"):
        peak_before_contact(result)
