"""Where the expansion is measured, by the camera's angles and the direction of flight."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import csv_rows, write_video, yaml_of
from looming import approach
from reference import slow_growth
from reference.clips import looming

from dlgmd_cli import Alarm, open_video, run
from dlgmd_cli.errors import DlgmdWarning, ParameterError
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.models.detection import Detection
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.rules import LEAST_QUALITY, RATE_TIMES_TIME, Ahead
from dlgmd_cli.models.windows import Camera, beside, outside
from dlgmd_cli.parameters.presets import load_config, parameters_of
from dlgmd_cli.tasks.camera import has_motion, read_headings


@pytest.mark.parametrize("direction", [(0.0, 0.0), (12.0, -7.0), (-20.0, 5.0)])
def test_the_window_is_that_of_its_angles(direction):
    expected = slow_growth.window(240, 135, 80.0, *direction)
    assert Camera().window((135, 240), direction) == pytest.approx(expected, abs=1e-9)


def test_angles_count_not_shares_of_the_image():
    """A lens of twice the tangent has as many px a degree in an image that is twice as wide."""
    near, wide = Camera(80.0), Camera(math.degrees(2 * math.atan(2 * math.tan(math.radians(40)))))
    sizes = [
        (right - left, bottom - top)
        for camera, shape in ((near, (68, 120)), (wide, (136, 240)))
        for left, top, right, bottom in [camera.window(shape)]
    ]
    assert sizes[0] == pytest.approx(sizes[1])


@pytest.mark.parametrize(("tilt", "sees"), [(0, True), (10, True), (20, True), (30, False)])
def test_a_camera_that_looks_up_sees_the_direction_of_flight_lower(tilt, sees):
    camera = Camera(80.0, float(tilt))
    window = camera.window((136, 240))
    assert (window is not None) == sees == (outside(camera, (240, 136)) == "")
    if tilt and window is not None:
        assert window[1] > Camera().window((136, 240))[1]


def test_a_crop_leaves_the_window_where_it_is():
    whole = Camera().window((68, 120))
    part = Camera(crop=(0.25, 0.0, 0.75, 1.0)).window((68, 60))
    assert part == pytest.approx((whole[0] - 30, whole[1], whole[2] - 30, whole[3]))


def test_one_image_of_a_stereo_pair_is_told():
    frames = looming(64, 96, 12, seed=3)
    with pytest.warns(DlgmdWarning, match="lies beside the middle of the image"):
        run(frames, fps=30, crop="48x64+0+0")
    assert beside(Camera(crop=(0.5, 0.0, 1.0, 1.0)))
    assert not beside(Camera()) and not beside(Camera(crop=(0.3, 0.0, 0.7, 1.0)))


def test_the_window_follows_a_heading_and_stays_where_it_is_out_of_view():
    camera = Camera()
    assert camera.window((68, 120), (10.0, 0.0))[0] > camera.window((68, 120))[0]
    assert camera.window((68, 120), (60.0, 0.0)) is None
    frames = looming(68, 120, 12, seed=3)
    answers = []
    for direction in ((math.nan, 0.0), (60.0, 0.0), (180.0, 0.0), (0.0, 0.0), (8.0, 0.0)):
        expansion = Expansion(camera=camera)
        expansion.head(Motion(direction))
        answers.append(repr([expansion.step(frame, t / 30) for t, frame in enumerate(frames)]))
    assert len({*answers[:4]}) == 1 and answers[4] != answers[0]


def test_a_heading_counts_from_its_frame_on():
    """The points follow the window, not only its place in the answer."""
    straight, turned = Expansion(), Expansion()
    for t, frame in enumerate(approach(12, 30, 2.0, (240, 135), seed=3)):
        if t == 8:
            turned.head(Motion((8.0, 0.0)))
        rates = {repr(one.step(frame, t / 30).expansion) for one in (straight, turned)}
        assert len(rates) == (1 if t < 8 else 2)


def test_an_alarm_has_a_camera_and_a_heading():
    frames = [np.uint8(255 * one) for one in looming(68, 120, 12, seed=3)]

    def last(alarm, *heading):
        alarm.heading(*heading)
        return [alarm.step(frame, t / 30).expansion for t, frame in enumerate(frames)][-1]

    usual = last(Alarm())
    assert last(Alarm(), math.nan, 3.0) == usual != last(Alarm(), 8.0, 5.0)
    turned = Expansion()
    turned.head(Motion((8.0, 5.0)))
    rates = [turned.step(frame, t / 30).expansion for t, frame in enumerate(frames)]
    assert last(Alarm(), 8.0, 5.0) == rates[-1]
    assert math.isnan(last(Alarm(camera_tilt=30)))
    narrow = replace(load_config("flight"), camera={"fov": 60.0})  # what is given comes first
    assert last(Alarm(narrow)) == last(Alarm(fov=60)) != usual == last(Alarm(narrow, fov=80))
    with pytest.raises(ParameterError, match="fov"):
        Alarm(fov=0)


def ahead(rate, quality=1.0, **more):
    """The row of a frame whose image expands at a rate, in all directions unless told otherwise."""
    usual = {"expansion_upright": rate, "approach": 0.0}
    return Detection(expansion=rate, expansion_quality=quality, **usual | more)


def test_what_is_ahead_and_what_approaches_a_still_camera_have_one_threshold():
    rule = Ahead(replace(parameters_of(load_config("flight")), expansion_alarm=0.5))
    rates = [(0.49, 0.0), (0.5, 0.0), (0.1, 0.49), (0.1, 0.5), (math.nan, 2.0), (math.nan, 0.0)]
    rows = [rule.step(ahead(d, approach=near)) for d, near in rates]
    assert [row.alarm for row in rows] == [False, True, False, True, True, False]
    assert [row.signal_limit for row in rows] == ["", "", "", "", "", ""]
    assert rule.threshold_at(1.5) == pytest.approx(RATE_TIMES_TIME / 1.5)
    assert rule.threshold_at(0.9) == 0.5  # never later than without a speed


def test_an_expansion_of_low_quality_counts_less():
    """In proportion; an object that approaches a camera at rest has no such quality."""
    rule = Ahead(replace(parameters_of(load_config("flight")), expansion_alarm=0.5))
    shares = [(2.0, 0.0), (1.0, 0.0), (0.5, 0.0), (0.1, 0.0), (0.0, 0.0), (0.0, 2.0)]
    rows = [rule.step(ahead(3.0, LEAST_QUALITY * one, approach=near)) for one, near in shares]
    assert [row.signal for row in rows] == pytest.approx([3.0, 3.0, 1.5, 0.3, 0.0, 2.0])
    assert [row.alarm for row in rows] == [True, True, True, False, False, True]
    assert [row.signal_limit for row in rows] == ["", "", *["quality"] * 3, "approach"]


def test_what_grows_twice_as_fast_down_as_across_is_ground():
    """A plane ahead counts in full, a pole too, which grows across alone; ground not at all."""
    rule = Ahead(replace(parameters_of(load_config("flight")), expansion_alarm=0.5))
    rates = [(1.0, 1.0), (2.0, 0.0), (1.0, 2.0), (1.0, 3.0)]  # across, down
    rows = [rule.step(ahead((a + d) / 2.0, expansion_upright=2 * a - d)) for a, d in rates]
    assert [row.signal for row in rows] == pytest.approx([1.0, 1.0, 0.0, 0.0])
    assert [row.signal_limit for row in rows] == ["", "", "ground", "ground"]
    # Of two causes, the one that takes more is named: ground leaves 0.4 of the rate.
    shares = (0.3, 0.5)
    rows = [rule.step(ahead(1.0, LEAST_QUALITY * one, expansion_upright=0.4)) for one in shares]
    assert [row.signal_limit for row in rows] == ["quality", "ground"]


def test_what_a_table_of_headings_says(tmp_path):
    path = tmp_path / "h.csv"
    path.write_text("frame,right_deg,up_deg\n10,0,4\n20,10,6\n")
    motion = read_headings(str(path))
    assert motion(15).direction == (5.0, 5.0)
    assert all(math.isnan(angle) for frame in (9, 21) for angle in motion(frame).direction)
    assert not motion(15).has_attitude and not has_motion(str(path))
    path.write_bytes(
        b"\xef\xbb\xbfup_deg,frame,right_deg\r\n4,10,0\r\n,12,\r\nnan,13,2\r\n6,20,1\r\n"
    )
    motion = read_headings(str(path))
    known = [frame for frame in range(30) if math.isfinite(sum(motion(frame).direction))]
    assert known == [10, 20] and motion(20).direction == (1.0, 6.0)
    path.write_text(
        "frame,right_deg,up_deg,speed_m_s,roll_deg,pitch_deg,yaw_deg\n"
        "0,0,4,2,0,-4,179\n10,0,4,3,2,-4,-179\n"
    )
    assert has_motion(str(path))
    assert read_headings(str(path))(5) == ((0.0, 4.0), 2.5, 1.0, -4.0, pytest.approx(180.0))
    path.write_text("frame,right_deg,up_deg,speed_m_s,roll_deg,pitch_deg,yaw_deg\n0,,,0.1,1,2,3\n")
    standing = read_headings(str(path))(0)
    assert standing[1:] == (0.1, 1.0, 2.0, 3.0) and standing.has_attitude and not standing.has_way
    head = "frame,right_deg,up_deg\n"
    for text, why in (
        (
            "frame,up_deg\n1,2\n",
            "lacks right_deg; its columns are frame, up_deg",
        ),
        (f"{head}3,0,0\n3,0,0\n", "line 3, column frame: is no frame after the one before"),
        (f"{head}3,inf,0\n", "line 2, column right_deg: is no number"),
        (f"{head},0,0\n", "line 2, column frame"),
        (head, "has no row"),
        ("", "directions of flight: .*; it has no header"),
    ):
        path.write_text(text)
        with pytest.raises(ParameterError, match=why):
            read_headings(str(path))
    with pytest.raises(ParameterError, match="this file is missing"):
        read_headings(str(tmp_path / "none.csv"))
    path.write_text(f"{head}0,0,5\n3,0,5\n4,,\n5,90,0\n9,90,0\n")
    with pytest.warns(
        DlgmdWarning, match="h.csv: in 4 of 8 frames, it has no direction that the camera sees"
    ):
        result = run(looming(68, 120, 8, seed=3), fps=30, heading=path)
    assert not any("more than the video has frames" in line for line in result.warnings)
    whole = "frame,right_deg,up_deg,speed_m_s,roll_deg,pitch_deg,yaw_deg\n"
    path.write_text(f"{whole}0,,,1,0,0,0\n8,,,1,0,0,9\n")
    with pytest.warns(DlgmdWarning, match="h.csv: in 8 of 8 frames, it has no direction"):
        run(looming(68, 120, 8, seed=3), fps=30, heading=path)
    # An attitude alone is no mistake.
    path.write_text("frame,right_deg,up_deg,roll_deg,pitch_deg,yaw_deg\n0,,,0,0,0\n8,,,0,0,9\n")
    told = run(looming(68, 120, 8, seed=3), fps=30, heading=path).warnings
    assert not any("h.csv" in line for line in told)
    path.write_text(f"{head}0,0,5\n7,0,5\n8,0,5\n999,0,5\n")
    with pytest.warns(DlgmdWarning, match="h.csv has 2 rows more than the video has frames"):
        run(looming(68, 120, 8, seed=3), fps=30, heading=path)
    path.write_text("frame,time_s,right_deg,up_deg\n0,1:02:03,0,5\n7,1:02:03.7,0,5\n")
    with pytest.warns(DlgmdWarning, match="h.csv has frame 7 at 0.700 s, the video at 0.233 s"):
        run(looming(68, 120, 8, seed=3), fps=30, heading=path)


def test_records_name_the_camera(tmp_path):
    run(looming(68, 120, 30, seed=3), fps=30, fov=100, camera_tilt=5, out=tmp_path)
    (folder,) = tmp_path.iterdir()
    record = yaml_of(folder / "run.yaml")
    assert record["camera"] == {"fov": 100.0, "camera_tilt": 5.0, "known_by": "option"}
    assert [*csv_rows(folder / "mp.csv")][-1]["approach"]


@pytest.mark.parametrize(("fps", "warns"), [(33, False), (36, True), (44, True), (50, False)])
def test_a_rate_of_which_few_frames_remain_is_a_warning(tmp_path, fps, warns):
    frames = [np.uint8(255 * one) for one in looming(48, 64, 20, seed=3)]
    write_video(tmp_path / "a.avi", frames, fps=fps)
    with open_video(tmp_path / "a.avi", model_fps=30) as video:
        told = [line for line in video.progress.warnings if "all reads every frame" in line]
        assert bool(told) == warns
    with open_video(tmp_path / "a.avi", model_fps=30, max_fps=math.inf) as video:
        assert not video.progress.warnings
