"""Where the expansion is measured, by the camera's angles and the direction of flight."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conftest import csv_rows, write_video, yaml_of
from looming import approach
from reference.clips import looming

from dlgmd_cli import Alarm, open_video, run
from dlgmd_cli.errors import DlgmdWarning, ParameterError
from dlgmd_cli.models.expansion import Expansion
from dlgmd_cli.models.rules import Ahead, Seen
from dlgmd_cli.models.windows import Camera, outside
from dlgmd_cli.parameters.presets import load_config, parameters_of
from dlgmd_cli.tasks.camera import read_headings


def test_the_windows_of_a_level_camera_of_80_degrees():
    """A square, and a narrower one above it."""
    square, narrow = Camera().windows((68, 120))
    assert square == (17, 51, 43, 77)
    assert narrow == (8, 43, 50, 70)


def test_angles_count_not_shares_of_the_image():
    """A lens of 120 degrees has as many cells a degree in an image that is twice as wide."""
    near, wide = Camera(80.0), Camera(120.0)
    sizes = [
        (bottom - top, right - left)
        for camera, shape in ((near, (68, 120)), (wide, (136, 240)))
        for top, bottom, left, right in camera.windows(shape)
    ]
    assert np.abs(np.subtract(sizes[:2], sizes[2:])).max() <= 2
    assert (near.factor(240, 2), wide.factor(240, 2), Camera(60.0).factor(240, 2)) == (2, 1, 2)


@pytest.mark.parametrize(("tilt", "sees"), [(0, True), (10, True), (20, True), (25, False)])
def test_a_camera_that_looks_up_sees_the_direction_of_flight_lower(tilt, sees):
    camera = Camera(80.0, float(tilt))
    windows = camera.windows((68, 120))
    assert (windows is not None) == sees == (outside(camera, (240, 136)) == "")
    if tilt and windows is not None:
        level = Camera().windows((68, 120))
        assert windows[0][0] > level[0][0] and windows[1][0] > level[1][0]


def test_a_crop_leaves_the_windows_where_they_are():
    whole = Camera().windows((68, 120))
    part = Camera(crop=(0.25, 0.0, 0.75, 1.0)).windows((68, 60))
    moved = [(top, bottom, left - 30, right - 30) for top, bottom, left, right in whole]
    assert part == moved


def test_the_windows_follow_a_heading_and_stay_where_it_is_out_of_view():
    camera = Camera()
    right = camera.windows((68, 120), (10.0, 5.0))
    level = camera.windows((68, 120))
    assert [one[2] for one in right] > [one[2] for one in level]
    assert camera.windows((68, 120), (60.0, 5.0)) is None
    frames = looming(68, 120, 12, seed=3)
    answers = []
    for direction in (None, (60.0, 5.0), (180.0, 0.0), (0.0, 5.0)):
        expansion = Expansion(camera=camera)
        expansion.head(direction)
        answers.append([expansion.step(frame, t / 30) for t, frame in enumerate(frames)])
    assert len({repr(answer) for answer in answers}) == 1


def test_an_alarm_has_a_camera_and_a_heading():
    frames = [np.uint8(255 * one) for one in looming(68, 120, 12, seed=3)]

    def last(alarm, *heading):
        alarm.heading(*heading)
        return [alarm.step(frame, t / 30).expansion for t, frame in enumerate(frames)][-1]

    usual = last(Alarm())
    assert last(Alarm(), math.nan, 3.0) == usual != last(Alarm(), 8.0, 5.0)
    assert math.isnan(last(Alarm(camera_tilt=25)))
    with pytest.raises(ParameterError, match="fov"):
        Alarm(fov=0)


def test_the_approach_of_a_still_camera_keeps_its_own_threshold():
    params = replace(parameters_of(load_config("flight")), expansion_alarm=0.5, ttc_alarm=0.8)
    rule = Ahead(params)
    seen = [(0.49, 0.0), (0.5, 0.0), (0.1, 1.24), (0.1, 1.25), (math.nan, 2.0), (math.nan, 0.0)]
    on = [rule.step(Seen(0.0, expansion=d, approach=near))[1] for d, near in seen]
    assert on == [False, True, False, True, True, False]
    assert rule.threshold_at(0.9) == pytest.approx(0.5)


def test_the_time_to_contact_does_not_depend_on_the_rate_of_frames():
    """Of a plane 1 s before contact, though the changes differ, of which some is rounding."""
    found = {}
    for fps in (15, 30, 60, 120):
        expansion = Expansion(camera=Camera())
        for t, frame in enumerate(approach(1 + 3 * fps // 2, fps, contact_s=2.5)):
            answer = expansion.step(frame, t / fps)
        found[fps] = answer.ttc_s
    assert found[30] == pytest.approx(1.0, rel=0.15)
    assert [found[fps] for fps in (15, 60, 120)] == pytest.approx([found[30]] * 3, rel=0.05)


def test_what_a_table_of_headings_says(tmp_path):
    path = tmp_path / "h.csv"
    path.write_text("frame,right_deg,up_deg\n10,0,4\n20,10,6\n")
    direction = read_headings(str(path))
    assert direction(15) == (5.0, 5.0) and direction(9) is direction(21) is None
    path.write_bytes(
        b"\xef\xbb\xbfup_deg,frame,right_deg\r\n4,10,0\r\n,12,\r\nnan,13,2\r\n6,20,1\r\n"
    )
    direction = read_headings(str(path))
    known = [frame for frame in range(30) if direction(frame) is not None]
    assert known == [10, 20] and direction(20) == (1.0, 6.0)
    head = "frame,right_deg,up_deg\n"
    texts = (
        "frame,up_deg\n1,2\n",
        f"{head}3,0,0\n3,0,0\n",
        f"{head}3,inf,0\n",
        f"{head},0,0\n",
        head,
        "",
    )
    for text in texts:
        path.write_text(text)
        with pytest.raises(ParameterError, match="directions of flight"):
            read_headings(str(path))
    with pytest.raises(ParameterError, match="No such file"):
        read_headings(str(tmp_path / "none.csv"))
    path.write_text(f"{head}0,0,5\n3,0,5\n4,,\n5,90,0\n9,90,0\n")
    with pytest.warns(
        DlgmdWarning, match="h.csv: 4 of 8 frames are measured around its directions"
    ):
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
