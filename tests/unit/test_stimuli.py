"""Scenes of plain objects: their shapes, their frames, and their ground truth."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.scenes.objects import SCENES
from dlgmd_cli.scenes.shapes import disc, rectangle

SHAPE = (24, 32)
SMALL = {"size": (48, 64), "frames": 6}

near = st.floats(-10.0, 40.0)
extents = st.floats(0.01, 60.0)


def whole(patch, shape=SHAPE):
    """The coverage of every pixel of an image."""
    picture = np.zeros(shape, np.float32)
    patch.paint(picture, 1.0)
    return picture


def darkness(frame, scene):
    """Share of each pixel that the object covers, as far as grey levels tell."""
    contrast = scene.background - scene.object_luminance
    return (scene.background - frame / 255.0) / contrast


# Shapes


@given(near, near, extents, extents)
def test_rectangle_covers_its_own_area(y, x, height, width):
    inside_y = max(0.0, min(SHAPE[0], y + height / 2) - max(0.0, y - height / 2))
    inside_x = max(0.0, min(SHAPE[1], x + width / 2) - max(0.0, x - width / 2))
    coverage = whole(rectangle(SHAPE, (y, x), (height, width)))
    assert coverage.sum(dtype=np.float64) == pytest.approx(inside_y * inside_x, abs=1e-3)
    assert coverage.min() >= 0.0 and coverage.max() <= 1.0 + 1e-6


@given(near, near, st.floats(0.05, 40.0))
def test_disc_agrees_with_counting_points(y, x, radius):
    n = 40
    points = (np.arange(SHAPE[1] * n) + 0.5) / n
    rows = points[: SHAPE[0] * n, None]
    hits = (rows - y) ** 2 + (points - x) ** 2 < radius**2
    counted = hits.reshape(SHAPE[0], n, SHAPE[1], n).mean(axis=(1, 3))
    # Each of a pixel's n rows has two ends at most, each off by half a step of 1/n.
    np.testing.assert_allclose(whole(disc(SHAPE, (y, x), radius)), counted, atol=1 / n)


@pytest.mark.parametrize("size", [1e4, 1e9, 1e30, 1e200])
def test_shapes_far_larger_than_the_picture_cover_it(size):
    assert np.all(whole(disc(SHAPE, (12.0, 16.0), size)) == 1.0)
    assert np.all(whole(rectangle(SHAPE, (12.0, 16.0), (size, size))) == 1.0)


# Every scene


@pytest.fixture(params=[*SCENES])
def scene(request):
    return SCENES[request.param]


def test_scene_has_a_line_and_as_many_frames_as_rows(scene):
    assert SCENES[scene.name] is scene
    assert scene.description and "\n" not in scene.description
    rows, first = list(scene.truth()), next(scene.frames())
    assert first.shape == (270, 480) and first.dtype == np.uint8
    assert len(rows) == scene.n_frames() == 75
    small = scene.configured(SMALL)
    assert len(list(small.frames())) == len(list(small.truth())) == SMALL["frames"]
    assert [row.frame for row in rows] == list(range(75))
    assert [row.time_s for row in rows] == [index / 30.0 for index in range(75)]


def test_angular_velocity_is_the_slope_of_the_angular_size(scene):
    rows = list(scene.configured({"fps": 500.0}).truth())
    for before, here, after in zip(rows, rows[1:], rows[2:], strict=False):
        if not here.time_to_contact_s < 0.05:  # the slope changes too fast for differences
            slope = (after.angular_size_deg - before.angular_size_deg) * 500.0 / 2.0
            assert here.angular_velocity_deg_s == pytest.approx(slope, rel=1e-2, abs=1e-9)


def test_noise_has_the_spread_asked_for(scene):
    still = scene.configured({"background": 0.5, "contrast": 0.0, "frames": 4})
    frames = np.stack(list(replace(still, noise=0.05).frames())) / 255.0
    assert frames.mean() == pytest.approx(0.5, abs=1e-3)
    # Rounding to grey levels adds a twelfth of a level squared.
    assert frames.std() == pytest.approx(math.hypot(0.05, 1 / 255 / math.sqrt(12)), rel=5e-3)
    assert np.std(frames[1] - frames[0]) == pytest.approx(math.sqrt(2) * 0.05, rel=1e-2)


def test_a_seed_gives_the_same_frames_and_another_seed_others(scene):
    noisy = scene.configured({**SMALL, "noise": 0.05, "seed": 3})
    first, again = list(noisy.frames()), list(noisy.frames())
    other = list(replace(noisy, seed=4).frames())
    for a, b, c in zip(first, again, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert np.any(a != c)


@pytest.mark.parametrize(
    ("contrast", "background", "grey"),
    [(-0.75, 0.8, (204, 51)), (-1.0, 1.0, (255, 0)), (0.25, 0.8, (204, 255))],
)
def test_contrast_is_webers(scene, contrast, background, grey):
    shown = scene.configured({**SMALL, "contrast": contrast, "background": background})
    frame = list(shown.frames())[-1]
    found = {int(value) for value in np.unique(frame)}
    assert grey[1] in found and found <= set(range(min(grey), max(grey) + 1))
    if not scene.name.startswith(("receding", "grating")):  # these may fill the corner
        assert frame[0, 0] == grey[0]


@pytest.mark.parametrize(
    ("name", "value", "why"),
    [
        ("size", (48,), "it needs a height and a width"),
        ("frames", 10**400, "is not a finite number"),
        ("speed", "fast", "'fast' is not a number"),
        ("speed", (), "every square needs a speed other than 0"),
    ],
)
def test_values_that_only_python_can_give(name, value, why):
    with pytest.raises(ParameterError, match=why):
        SCENES["translating-cubes"].configured({name: value})


# Objects that come closer or go away


@pytest.mark.parametrize("name", ["looming", "receding-cube", "ball"])
def test_the_area_of_the_object_follows_from_the_distance(name):
    scene = SCENES[name]
    focal = scene.focal_px
    for frame, row in zip(scene.frames(), scene.truth(), strict=True):
        half = math.radians(row.angular_size_deg) / 2.0
        span = 2.0 * focal * math.tan(half)
        distance = 0.1 + 3.0 * row.time_s if name == "receding-cube" else 7.5 - 3.0 * row.time_s
        if name == "ball":
            assert math.sin(half) == pytest.approx(0.25 / (distance + 0.25), rel=1e-9)
            area = math.pi * span**2 / 4 if span < 270.0 else None
        else:
            assert span == pytest.approx(focal * 0.5 / distance, rel=1e-9)
            area = min(span, 270.0) * min(span, 480.0)
        if name != "receding-cube":
            assert row.time_to_contact_s == pytest.approx(distance / 3.0) and distance > 0.0
        if area is not None:
            assert darkness(frame, scene).sum() == pytest.approx(area, rel=1e-3)


def test_receding_cube_is_the_looming_cube_backwards():
    looming, receding = SCENES["looming-cube"], SCENES["receding-cube"]
    there, back = looming.frames(), receding.frames()
    for a, b in zip(list(there)[::-1], back, strict=True):
        assert np.max(np.abs(a.astype(int) - b)) <= 1  # the last bit of the distances differs
    rows = list(receding.truth())
    assert all(math.isnan(row.time_to_contact_s) for row in rows)
    assert all(row.angular_velocity_deg_s < 0.0 for row in rows)


def test_the_receding_cube_goes_on_from_its_first_distance():
    scene = SCENES["receding-cube"].configured({"distance": 2, "speed": 6, "frames": 100})
    *_, last = scene.truth()
    assert last.frame == 99
    distance = 2 + 6 * 99 / 30
    assert math.tan(math.radians(last.angular_size_deg / 2)) == pytest.approx(0.25 / distance)
    with pytest.raises(ParameterError, match="receding-cube has no such option"):
        scene.configured({"final_angle": 40})


@pytest.mark.parametrize(("name", "same"), [("looming-cube", "looming"), ("looming-ball", "ball")])
def test_two_names_of_a_scene(name, same):
    one, other = (SCENES[each].configured({**SMALL, "noise": 0.01}) for each in (name, same))
    for a, b in zip(one.frames(), other.frames(), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize(
    ("given", "n_frames"),
    [
        *(({}, 75), ({"distance": 7.51}, 76), ({"frames": 10}, 10), ({"distance": 0.01}, 1)),
        *(({"speed": 0.3, "distance": 3.0}, 300), ({"speed": 0.001, "frames": 3}, 3)),
    ],
)
def test_length_of_a_looming_clip(given, n_frames):
    rows = list(SCENES["ball"].configured(given).truth())
    assert len(rows) == n_frames
    assert all(row.time_to_contact_s > 0.0 for row in rows)


# Objects that move sideways


def test_centroid_moves_by_exactly_the_speed():
    scene = SCENES["translating-cubes"]
    three = scene.configured({"speed": (1.0, 2.5, -0.3)})
    xs = np.arange(480) + 0.5
    assert scene.configured({"speed": (10.0, -3.0)}).n_frames() == 46
    centroids = []
    for frame in three.frames():
        rows = darkness(frame, three).reshape(3, 90, 480)
        assert np.allclose(rows.sum(axis=(1, 2)), 30.0**2, rtol=1e-3)
        centroids.append([(row.sum(axis=0) * xs).sum() / row.sum() for row in rows])
    # An edge pixel is rounded to one of 153 levels, 1/30 of a side: 2 * 0.5 / 153 / 30 px * 15.
    assert np.allclose(np.diff(centroids, axis=0), [1.0, 2.5, -0.3], atol=0.004)
    assert np.allclose(centroids[37], 240.0, atol=0.004)


def shown(name, **options):
    """The scene with some options, and the share of each pixel that the object covers."""
    scene = SCENES[name].configured({"size": (48, 64), **options})
    ground = scene.ground
    covered = [(f / 255.0 - ground) / (scene.object_luminance - ground) for f in scene.frames()]
    return scene, np.stack(covered)


def test_a_bar_spans_the_image_and_moves_either_way():
    for options, size in (({}, 48), ({"vertical": True, "speed": (3.0,)}, 64)):
        scene, covered = shown("translating", object_size=5.0, frames=9, **options)
        along = covered.mean(axis=2 if scene.vertical else 1)
        np.testing.assert_allclose(along.sum(axis=1), 5.0, atol=0.1)
        centres = along @ (np.arange(along.shape[1]) + 0.5) / along.sum(axis=1)
        np.testing.assert_allclose(np.diff(centres), scene.speeds_px[0], atol=0.05)
        assert covered.max(axis=1 if scene.vertical else 2).shape[1] == size


def test_what_grows_shrinks_backwards():
    _, grows = shown("elongating", object_size=20.0, speed=5.0, light=True)
    np.testing.assert_allclose(grows.sum(axis=(1, 2)), 100.0 * np.arange(1, 13), atol=3)
    _, shrinks = shown("shortening", object_size=20.0, speed=5.0, light=True)
    np.testing.assert_array_equal(shrinks, grows[::-1])


def test_stripes_are_as_wide_as_their_gaps_and_drift():
    _, covered = shown("grating", object_size=8.0, speed=-2.5, frames=5)
    assert covered.mean() == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(covered[4], np.roll(covered[0], -10, axis=1), atol=0.01)


def test_a_bar_turns_about_the_middle():
    _, covered = shown("rotating", object_size=6.0, speed=30.0, frames=4)
    np.testing.assert_allclose(covered.sum(axis=(1, 2)), 6.0 * 0.9 * 48, rtol=0.02)
    np.testing.assert_allclose(covered[3], covered[3, ::-1], atol=0.01)
    rows, columns = covered.max(axis=2).sum(axis=1), covered.max(axis=1).sum(axis=1)
    assert rows[0] == pytest.approx(6, abs=0.1) and columns[3] == pytest.approx(6, abs=0.1)
    assert covered[1, 24 + 8, 32 + 14] > 0.9 > 0.1 > covered[1, 24 - 8, 32 + 14]  # clockwise


def test_a_capsule_is_three_diameters_long():
    scene, covered = shown("capsule", frames=1, distance=1.5, fov=90)
    across = scene.focal_px * 2 * math.tan(math.radians(scene.angles(0).size_deg / 2))
    area = 2 * across**2 + math.pi * across**2 / 4
    assert covered.sum() == pytest.approx(area, rel=0.01)


@pytest.mark.parametrize("name", ["looming", "ball", "capsule"])
def test_an_approach_ends_at_its_final_angle_and_is_held(name):
    rows = list(SCENES[name].configured({"final_angle": 40, "hold": 0.5, "l_over_v": 50}).truth())
    moving, held = rows[:-15], rows[-15:]
    assert {row.angular_size_deg for row in held} == {moving[-1].angular_size_deg}
    assert held[0].angular_size_deg == pytest.approx(40)
    assert moving[-2].angular_size_deg < 39.9
    assert all(row.angular_velocity_deg_s == 0 for row in held)
    assert all(math.isnan(row.time_to_contact_s) for row in held)
    assert moving[0].time_to_contact_s == pytest.approx(7.5 / (0.25 / 0.05))
    back = [*SCENES["receding"].configured({"final_angle": 40, "hold": 0.5}).truth()]
    assert [row.angular_velocity_deg_s for row in back[:15]] == [0] * 15
    assert back[15].angular_size_deg == pytest.approx(40)
    assert back[16].angular_size_deg < 40 and back[-1].angular_velocity_deg_s < 0


def test_light_exchanges_the_luminances_and_an_image_is_the_background(tmp_path):
    dark, light = (next(SCENES["ball"].configured({"light": on}).frames()) for on in (False, True))
    assert (dark[0, 0], dark[135, 240], light[0, 0], light[135, 240]) == (204, 51, 51, 204)
    picture = np.tile(np.arange(100, 164, dtype=np.uint8), (96, 1))
    cv2.imwrite(str(tmp_path / "room.png"), picture)
    given = {"size": (48, 64), "background_image": str(tmp_path / "room.png"), "contrast": -0.5}
    frame = next(SCENES["ball"].configured(given).frames())
    np.testing.assert_array_equal(frame[0], picture[0])
    assert frame[24, 32] == pytest.approx(131.5 / 2, abs=1)
    for options, why in (
        ({**given, "light": True}, "excludes background_image"),
        ({"background_image": str(tmp_path)}, "cannot be read as an image"),
        ({"l_over_v": 100, "speed": 2}, "excludes speed"),
        ({"final_angle": 1}, "covers 1 degrees in the first frame already"),
    ):
        with pytest.raises(ParameterError, match=why):
            SCENES["ball"].configured(options)
