"""The growth of the window, without noise, in scenes whose answer is known."""

import numpy as np
import pytest

from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import N_AHEAD
from dlgmd_cli.models.growth import MIN_POINTS, grid, similarity, upright, visible
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.presets import load_config, parameters_of

RULE = rule_of(parameters_of(load_config("flight")))
# Images of 16:9, 4:3 and 3:4.
SIZES_WH = ((240, 135), (240, 180), (180, 240))
# A level flight, at 1.2 m and 3 m/s, over an interval of 1/30 s; what is near is 2 m ahead.
HEIGHT_M, STEP_M, NEAR_M, FAR_M = 1.2, 0.1, 2.0, 1e5
UP_TO_10 = (-10, -5, 0, 5, 10)


def seen(scene, down_deg, size_wh):
    """The window's points in two images by a camera that looks down, and what grows in it.

    The camera does not tell its pitch. Points in a blank sky are not tracked.
    """
    width, height = size_wh
    camera = Camera()
    points = visible(grid(camera.window((height, width)), N_AHEAD), (height, width))
    middle = np.array([(width - 1) / 2, (height - 1) / 2])
    x, y = (np.float64(points) - middle).T / camera.focal(width)
    sine, cosine = np.sin(np.radians(down_deg)), np.cos(np.radians(down_deg))
    below, ahead = y * cosine + sine, cosine - y * sine
    ground = np.where(below > 1e-6, HEIGHT_M / np.maximum(below, 1e-6), np.inf)
    reach = {
        "ground": ground,
        "ground under sky": ground,
        "ground under far texture": np.minimum(ground, FAR_M),
        "wall": NEAR_M / ahead,
        "slanted wall": NEAR_M / (ahead + 0.5 * x),
        "half a wall": np.where(x < 0.0, NEAR_M / ahead, FAR_M),
    }[scene]
    tracked = reach * ahead < 200.0 if scene.endswith("sky") else np.isfinite(reach)
    at = np.array([x, below, ahead])[:, tracked] * reach[tracked]
    at[2] -= STEP_M
    y, depth = at[1] * cosine - at[2] * sine, at[1] * sine + at[2] * cosine
    there = np.array([at[0] / depth, y / depth]).T * camera.focal(width) + middle
    return points[tracked], np.float32(there)


def measured(scene, down_deg, size_wh):
    """The signal of the rule `expansion`, and the expansion; both / the rate of the wall."""
    points, there = seen(scene, down_deg, size_wh)
    if len(points) < MIN_POINTS:
        return 0.0, 0.0
    fit = similarity(points, there)
    standing = upright(points, there, fit.weight)
    row = Detection(
        expansion=fit.slope.real, expansion_upright=standing, expansion_quality=1.0, approach=0.0
    )
    true = STEP_M / (NEAR_M - STEP_M)
    return RULE.value(row) / true, fit.slope.real / true


@pytest.mark.parametrize("size_wh", SIZES_WH)
@pytest.mark.parametrize(
    ("scene", "tilts", "most"),
    [
        ("ground", (22, 17, 12), 0.05),
        ("ground under sky", UP_TO_10, 0.05),
        ("ground under far texture", UP_TO_10, 0.2),
    ],
)
def test_ground_below_a_level_flight_is_no_obstacle_whatever_stands_above_it(
    scene, tilts, most, size_wh
):
    for down_deg in tilts:
        signal, rate = measured(scene, down_deg, size_wh)
        assert abs(signal) <= max(most * rate, 0.01), down_deg


@pytest.mark.parametrize("size_wh", SIZES_WH)
def test_a_wall_counts_in_full_and_half_a_wall_by_half(size_wh):
    for down_deg in UP_TO_10:
        for scene in ("wall", "slanted wall"):
            signal, rate = measured(scene, down_deg, size_wh)
            assert rate == pytest.approx(1.0, rel=0.08)  # a tilted window shows the wall aslant
            assert signal == pytest.approx(rate, rel=0.02)
        signal, rate = measured("half a wall", down_deg, size_wh)
        assert signal == pytest.approx(rate, rel=0.02) and 0.3 < rate < 0.7


def test_points_in_one_row_or_one_column_have_no_growth():
    places = np.float32([[4.0 * k, 9.0] for k in range(7)])
    for points in (places, places[:, ::-1]):
        assert np.isnan(upright(points, 1.01 * points, np.ones(7)))
