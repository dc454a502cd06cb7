"""Sharpness and distinguishability of a response."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from reference_data import reference_frames

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters import load_set
from dlgmd_cli.results.measures import distinguishability, sharpness
from dlgmd_cli.results.tables import Result

NAN = math.nan
potentials = st.lists(st.sampled_from([NAN, 0.0]) | st.floats(1e-6, 1e6), min_size=1, max_size=40)


def result_of(mp, first=0, step=1):
    """A result of which only the frame numbers and the raw membrane potential matter."""
    mp = np.array(mp, dtype=np.float64)
    nothing = np.full_like(mp, NAN)
    flags = np.zeros(len(mp), dtype=bool)
    return Result(
        frame=first + step * np.arange(len(mp)),
        time_s=np.arange(len(mp)) / 30,
        mp=mp,
        **dict.fromkeys(
            ("p_sum", "s_sum", "attenuation_db", "mp_abs", "mp_seq", "level", "threshold"), nothing
        ),
        spike=flags,
        collision=flags,
    )


def test_sharpness_is_the_mean_of_the_response_scaled_to_its_peak():
    assert sharpness(result_of([NAN, NAN, 1.0, 2.0, 8.0, 1.0])) == 12.0 / 8.0 / 4.0
    assert sharpness(result_of([NAN, 3.0])) == 1.0


@pytest.mark.parametrize("mp", [[NAN, NAN], [NAN, 0.0, 0.0], []])
def test_sharpness_of_no_response_is_undefined(mp):
    assert math.isnan(sharpness(result_of(mp)))


@given(potentials, st.floats(1e-3, 1e3))
def test_sharpness_has_no_unit_and_lies_within_0_and_1(mp, factor):
    one, other = sharpness(result_of(mp)), sharpness(result_of(np.array(mp) * factor))
    assert other == pytest.approx(one, nan_ok=True)
    assert math.isnan(one) or 1.0 / len(mp) - 1e-12 <= one <= 1.0


def test_distinguishability_looks_five_frames_to_either_side():
    mp = np.zeros(60)
    mp[:3] = NAN
    mp[35:46] = 2.0
    mp[40] = 13.0
    mp[[34, 46]] = 1.0
    mp[10:21] = 0.5
    mp[[9, 21]] = 0.7
    assert distinguishability(result_of(mp), 15) == (10 * 2.0 + 13.0) / 11 / 0.5
    # The clip ends, or has not begun, within the window.
    assert distinguishability(result_of(mp[:42]), 15) == (6 * 2.0 + 13.0) / 7 / 0.5
    assert distinguishability(result_of(mp), 5) == pytest.approx(3.0 / (1.2 / 8))


def test_distinguishability_goes_by_frame_numbers():
    mp = [NAN, 1.0, 1.0, 1.0, 4.0, 8.0, 4.0]  # frames 100, 103, … 118
    result = result_of(mp, first=100, step=3)
    assert distinguishability(result, 105) == (16.0 / 3) / 1.0
    assert distinguishability(replace(result, frame=result.frame - 100), 5) == (16.0 / 3) / 1.0


@pytest.mark.parametrize(
    ("mp", "frame", "expected"),
    [
        ([NAN, 0.0] + [0.0] * 10 + [3.0], 2, math.inf),
        ([NAN] + [0.0] * 10, 2, NAN),
        ([NAN] * 12 + [1.0], 2, NAN),  # no valid frame there
        ([1.0] * 10, 16, NAN),  # no frame there
        ([1.0] * 10, -5, 1.0),
        ([NAN] * 4, 2, NAN),
        ([], 0, NAN),
    ],
)
def test_distinguishability_at_its_limits(mp, frame, expected):
    assert distinguishability(result_of(mp), frame) == pytest.approx(expected, nan_ok=True)


def test_sharpness_is_that_of_the_paper_s_looming_ball():
    frames = reference_frames("looming_ball")
    found = []
    for number in range(4, 10):
        model = DLGMD(load_set(number), engine="opencv")
        found.append(round(sharpness(result_of([model.step(f).mp for f in frames])), 3))
    assert found == [0.137, 0.137, 0.135, 0.131, 0.131, 0.117]
