"""The rate of points in the drone's way, against scenes whose answer is known."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from dlgmd_cli import Alarm, DlgmdWarning, run
from dlgmd_cli.models.corridor import BESIDE_M, NOTHING, Motion, fastest, turned
from dlgmd_cli.models.expansion import Expansion, Measured
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.models.stopping import Brake, following
from dlgmd_cli.models.windows import Camera
from dlgmd_cli.parameters.presets import load_preset, parameters_of
from dlgmd_cli.plots.traces import plot

CAMERA, SHAPE, SPEED_M_S, AGE_S = Camera(), (135, 240), 2.0, 0.1
LEVEL = Motion((0.0, 0.0), SPEED_M_S, 0.0, 0.0, 0.0)


def noise(seed):
    """A texture of 2 m by 2 m, 400x400."""
    grey = np.random.default_rng(seed).uniform(0, 255, (400, 400)).astype(np.float32)
    grey = cv2.GaussianBlur(grey, (0, 0), 4)
    return np.uint8(np.clip((grey - grey.mean()) * 6 + 128, 0, 255))


WALL, OBJECT = noise(1), noise(2)


def seen(motion, boards, tilt_deg=0.0, camera=CAMERA):
    """What a camera sees of boards: texture, centre (right, down, forward; m) and half sides.

    The boards face a level drone that looks along its yaw of 0.
    """
    height, width = SHAPE
    focal, (axis_x, axis_y) = camera.focal(width), camera.axis(SHAPE)
    axes = motion.axes(tilt_deg)
    view = np.array(((focal, 0, axis_x), (0, focal, axis_y), (0, 0, 1))) @ axes
    image = np.full(SHAPE, 128, np.uint8)
    for texture, (right, down, forward), (half_x, half_y) in boards:
        n = texture.shape[0]
        # From px of the texture to north, east and down.
        place = np.array(
            (
                (0, 0, forward),
                (2 * half_x / n, 0, right - half_x),
                (0, 2 * half_y / n, down - half_y),
            )
        )
        turn = view @ place
        flags = cv2.INTER_AREA
        shown = cv2.warpPerspective(texture, turn, (width, height), flags=flags)
        covers = cv2.warpPerspective(np.full_like(texture, 255), turn, (width, height))
        image = np.where(covers > 127, shown, image)
    return image


def approach(distance_m, right_m=0.0, down_m=0.0, half_m=0.4, motions=(LEVEL, LEVEL), told=None):
    """The rate of an object before a far wall, with the object at this distance at last."""
    way = SPEED_M_S * AGE_S
    images = [
        seen(
            motion,
            [
                (WALL, (0.0, 0.0, 30.0 + further), (25.0, 25.0)),
                (OBJECT, (right_m, down_m, distance_m + further), (half_m, half_m)),
            ],
        )
        for motion, further in zip(motions, (way, 0.0), strict=True)
    ]
    return fastest(*images, told or motions, CAMERA, AGE_S)


@pytest.mark.parametrize("distance_m", [1.5, 2.5, 3.0])
def test_an_object_that_fills_a_part_of_the_window_has_its_own_rate(distance_m):
    rate, (x, y) = approach(distance_m)
    assert rate == pytest.approx(SPEED_M_S / distance_m, rel=0.12)
    assert abs(x) < 0.3 and abs(y) < 0.4


def test_what_is_beside_the_way_does_not_count():
    inside, outside = BESIDE_M, BESIDE_M + 0.8
    assert approach(2.5, right_m=inside)[0] > 0.6
    assert approach(2.5, right_m=outside) == approach(2.5, right_m=-outside) == NOTHING
    # The way reaches less far down than up.
    assert approach(2.5, down_m=-0.6)[0] > 0.6
    assert approach(2.5, down_m=0.6) == NOTHING


@pytest.mark.parametrize(
    ("attitude", "tilt_deg", "forward", "right"),
    [
        ((0, 0, 90), 0, (0, 1, 0), (-1, 0, 0)),  # yaw to the right: to the east
        ((0, 90, 0), 0, (0, 0, -1), (0, 1, 0)),  # nose up
        ((90, 0, 0), 0, (1, 0, 0), (0, 0, 1)),  # right side down
        ((0, 0, 0), 90, (0, 0, -1), (0, 1, 0)),  # the camera looks up
        ((90, 0, 0), 90, (0, 1, 0), (0, 0, 1)),  # up along the drone's own axes
    ],
)
def test_the_axes_of_the_camera_by_north_east_and_down(attitude, tilt_deg, forward, right):
    axes = Motion((0.0, 0.0), 1.0, *attitude).axes(tilt_deg)
    np.testing.assert_allclose(axes[2], forward, atol=1e-12)
    np.testing.assert_allclose(axes[0], right, atol=1e-12)
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("turn", [(0, 0, 4), (0, 3, 0), (5, 0, 0), (2, -2, -3)])
def test_turns_of_the_drone_are_turned_back(turn):
    """The direction of flight stays where it is: what the drone flies to moves in the image."""
    after = LEVEL._replace(roll_deg=turn[0], pitch_deg=turn[1], yaw_deg=turn[2])
    rate, _ = approach(2.5, motions=(LEVEL, after))
    assert rate == pytest.approx(0.8, rel=0.15)


@pytest.mark.parametrize("turn", [(0, 0, 50), (0, 40, 0), (30, -20, -40)])
@pytest.mark.parametrize("speed_m_s", [1.0, 0.0, math.nan])
@pytest.mark.parametrize("direction", [(25.0, 10.0), Motion().direction])
def test_a_turn_alone_does_not_make_the_window_grow(turn, speed_m_s, direction):
    """Far from the axis it does, unless the attitude tells of the turn."""
    rates, camera = [], Camera(tilt_deg=-20.0)  # without a direction, the window is 20° up
    for knows in (True, False):
        expansion = Expansion(camera=camera)
        for k in range(8):
            angles = [rate_deg_s * k / 30 for rate_deg_s in turn]
            there = Motion(direction, speed_m_s, *angles)
            expansion.head(there if knows else Motion(direction))
            image = seen(there, [(WALL, (0.0, 0.0, 30.0), (60.0, 60.0))], camera.tilt_deg)
            found = expansion.step(image, k / 30)
        rates.append((abs(found.expansion), abs(found.expansion_upright)))
    known, unknown = rates
    assert max(known) < 0.03 and max(unknown) > 5.0 * max(known)
    for missing in (Motion(), Motion(LEVEL.direction), LEVEL._replace(yaw_deg=math.nan)):
        assert turned(missing, LEVEL, CAMERA, SHAPE) is None
        assert turned(LEVEL, missing, CAMERA, SHAPE) is None


@pytest.mark.parametrize("error_deg", [(3.0, 0.0), (0.0, 3.0), (-2.0, -2.0)])
def test_an_error_of_the_direction_is_found(error_deg):
    wrong = LEVEL._replace(direction=error_deg)
    rate, _ = approach(2.5, told=(wrong, wrong))
    assert rate == pytest.approx(0.8, rel=0.25)


def test_a_repeated_pattern_does_not_approach():
    """A far fence of stripes fits at several places, also where it would be if it came nearer."""
    stripes = np.tile(np.uint8(128 + 100 * np.sin(np.arange(400) * 0.42)), (400, 1))
    rng = np.random.default_rng(3)
    images = [
        seen(LEVEL, [(stripes, (0.0, 0.0, distance), (25.0, 25.0))])
        + rng.integers(0, 3, SHAPE).astype(np.uint8)
        for distance in (40.2, 40.0)
    ]
    assert fastest(*images, (LEVEL, LEVEL), CAMERA, AGE_S)[0] < 0.2


def test_noise_does_not_approach():
    for seed in range(12):
        rng = np.random.default_rng(seed)
        images = [
            np.uint8(cv2.GaussianBlur(rng.uniform(0, 255, SHAPE), (0, 0), 1.0)) for _ in range(2)
        ]
        assert fastest(*images, (LEVEL, LEVEL), CAMERA, AGE_S) == NOTHING


def test_a_blank_image_does_not_say_that_nothing_is_in_the_way():
    blank, hidden = np.full(SHAPE, 90, np.uint8), np.zeros(SHAPE, np.bool_)
    assert math.isnan(fastest(blank, blank, (LEVEL, LEVEL), CAMERA, AGE_S)[0])
    wall = WALL[:135, :240]
    assert math.isnan(fastest(wall, wall, (LEVEL, LEVEL), CAMERA, AGE_S, hidden)[0])


def test_a_tilted_camera_flies_below_its_axis():
    camera = Camera(tilt_deg=15.0)
    motion = LEVEL._replace(direction=(0.0, -15.0))
    images = [
        seen(motion, [(WALL, (0, 0, 30.0), (25, 25)), (OBJECT, (0, 0, z), (0.4, 0.4))], 15.0)
        for z in (2.7, 2.5)
    ]
    rate, (_, y) = fastest(*images, (motion, motion), camera, AGE_S)
    assert rate == pytest.approx(0.8, rel=0.12) and y > 0.3


def flight(expansion, told, n=20, speed_m_s=2.0):
    """Measure an approach to an object, with what the drone tells of its motion."""
    rows = []
    for k in range(n):
        motion = told(k)
        expansion.head(motion)
        far = 3.5 - speed_m_s * k / 30
        boards = [(WALL, (0, 0, 30.0), (25, 25)), (OBJECT, (0, 0, far), (0.35, 0.35))]
        rows.append(expansion.step(seen(LEVEL, boards), k / 30))
    return rows


def test_two_looks_must_agree_and_the_time_to_contact_follows_the_way():
    rows = flight(Expansion(), lambda k: LEVEL)
    rates = [row.corridor for row in rows]
    assert all(math.isnan(rate) for rate in rates[:7]) and np.isfinite(rates[7:]).all()
    assert rates[-1] > 2.0 * rows[-1].expansion
    true_s = (3.5 - 2.0 * 19 / 30) / 2.0
    assert rows[-1].ttc_s == pytest.approx(true_s, abs=0.15)
    assert rows[-1].approach == 0.0


@pytest.mark.parametrize(
    "told",
    [
        lambda k: Motion(),
        lambda k: Motion((0.0, 0.0)),
        lambda k: LEVEL._replace(direction=Motion().direction),
        lambda k: LEVEL._replace(speed_m_s=0.3),
        lambda k: LEVEL._replace(yaw_deg=math.nan),
        # The image does not show where the drone flies to: that nothing is there is not known.
        lambda k: LEVEL._replace(direction=(70.0, 0.0)),
        lambda k: LEVEL._replace(direction=(120.0, 0.0)),
    ],
)
def test_without_a_whole_motion_there_is_no_way(told):
    rows = flight(Expansion(), told, 12)
    assert all(math.isnan(row.corridor) for row in rows)


def test_a_motion_that_is_lost_ends_the_rate():
    rows = flight(Expansion(), lambda k: LEVEL if k < 12 else Motion())
    assert rows[11].corridor > 0.0 and math.isnan(rows[-1].corridor)


def test_the_rule_compares_the_way_and_else_the_window():
    params = parameters_of(load_preset("flight"), {"alarm": "corridor"})
    rule, row = rule_of(params), Alarm("flight").step(np.zeros((60, 80), np.uint8), 0.0)
    window = Measured(0.47, 0.6, 1.0, approach=0.0)
    row = replace(row, **vars(window))
    assert rule.step(replace(row, corridor=0.5)).alarm
    assert not rule.step(replace(row, corridor=0.0)).alarm
    without = rule.step(row)
    assert without.alarm and without.signal == pytest.approx(0.5)
    ground = rule.step(replace(row, expansion_upright=0.1))
    assert not ground.alarm and ground.signal_limit == "ground"


@pytest.mark.parametrize(("brake", "speed_m_s"), [("arducopter", 2.0), ("px4", 3.0)])
def test_a_threshold_by_speed_is_that_of_the_window_too(brake, speed_m_s):
    """Where the motion is unknown; in a run, and in live, where it changes between frames."""
    params = parameters_of(load_preset("flight"), {"alarm": "corridor"})
    row = Alarm("flight").step(np.zeros((60, 80), np.uint8), 0.0)
    slow = following(params, Brake.parse(brake), speed_m_s)
    alone = following(replace(params, alarm="expansion"), Brake.parse(brake), speed_m_s)
    least = alone.expansion_alarm
    assert slow.expansion_alarm == least < 0.47 and slow.corridor_alarm <= 0.5
    live = rule_of(params)
    live.follow(slow)
    for rule in (rule_of(slow), live):
        for rate, is_on in ((1.01 * least, True), (0.99 * least, False)):
            seen = replace(row, **vars(Measured(rate, rate, 1.0, approach=0.0)))
            assert rule.step(seen).alarm == is_on
        assert rule.threshold == slow.corridor_alarm
    live.follow(params)
    assert not live.step(replace(row, **vars(Measured(0.46, 0.46, 1.0, approach=0.0)))).alarm


def test_an_alarm_is_told_the_motion():
    alarm = Alarm("flight", alarm="corridor")
    for k in range(20):
        alarm.heading(0.0, 0.0, SPEED_M_S, 0.0, 0.0, 0.0)
        far = 3.5 - 2.0 * k / 30
        boards = [(WALL, (0, 0, 30.0), (25, 25)), (OBJECT, (0, 0, far), (0.35, 0.35))]
        row = alarm.step(seen(LEVEL, boards), k / 30)
    assert row.alarm and row.rule == "corridor" and row.signal == row.corridor > 0.5


def test_a_run_without_the_motion_says_what_the_rule_compares():
    frames = [seen(LEVEL, [(WALL, (0, 0, 5.0 - k / 15), (25, 25))]) for k in range(8)]
    with pytest.warns(DlgmdWarning, match="drone's motion is unknown"):
        result = run(np.stack(frames), alarm="corridor", param={"expansion_alarm": 0.4}, fps=30)
    assert result.params.alarm == "corridor"


def test_a_table_with_the_motion_makes_the_rule_the_default(tmp_path):
    path = tmp_path / "heading.csv"
    path.write_text(
        "frame,right_deg,up_deg,speed_m_s,roll_deg,pitch_deg,yaw_deg\n0,0,0,2,0,0,0\n19,0,0,2,0,0,0\n"
    )
    frames = [
        seen(LEVEL, [(WALL, (0, 0, 30), (25, 25)), (OBJECT, (0, 0, 3.5 - k / 15), (0.35, 0.35))])
        for k in range(20)
    ]
    result = run(np.stack(frames), heading=path, fps=30)
    assert result.params.alarm == "corridor" and result.alarms[-1]
    assert rule_of(replace(result.params, corridor_alarm=9.0)).threshold == 9.0
    kept = run(np.stack(frames), heading=path, fps=30, param={"alarm": "expansion"})
    assert kept.params.alarm == "expansion"
    np.testing.assert_array_equal(kept.corridor, result.corridor)
    path.write_text("frame,right_deg,up_deg\n0,0,0\n19,0,0\n")
    assert run(np.stack(frames), heading=path, fps=30).params.alarm == "expansion"


def test_figures_and_pages_show_what_the_rule_compares(tmp_path):
    path = tmp_path / "heading.csv"
    path.write_text(
        "frame,right_deg,up_deg,speed_m_s,roll_deg,pitch_deg,yaw_deg\n"
        "0,0,0,2,0,0,0\n19,0,0,2,0,0,0\n"
    )
    frames = [
        seen(LEVEL, [(WALL, (0, 0, 30), (25, 25)), (OBJECT, (0, 0, 3.5 - k / 15), (0.35, 0.35))])
        for k in range(20)
    ]
    result = run(np.stack(frames), heading=path, fps=30)
    assert result.rule.to_dict()["column"] == "signal"
    names = [axes.get_ylabel() for axes in plot("mp", {"flight": result}).axes]
    assert "In the way (1/s)" in names
