"""The renderer: points are found where geometry says, and nothing shows through what hides it."""

import itertools
import math

import cv2
import numpy as np
import pytest
from bodies import ball, board, box, capsule, plain, project, rays_of
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.scenes.flights import painter
from dlgmd_cli.scenes.flights.camera import Camera, Pose, rotation
from dlgmd_cli.scenes.flights.painter import Coverage, Renderer
from dlgmd_cli.scenes.flights.scenes import FlightOptions, Sensor
from dlgmd_cli.scenes.flights.solids import Shade, Solid, Texture, World, quad

pytestmark = pytest.mark.slow

X, Y, Z = np.eye(3)
CAMERA = Camera((120, 160), 80.0)


def room(level=0.0, low=(-10, -10, -10), high=(10, 10, 10), textures=None):
    return box(low, high, level, "room", inwards=True, textures=textures)


def look(x=0.0, y=0.0, z=0.0, roll=0.0, pitch=0.0, yaw=0.0):
    return Pose(np.array([x, y, z]), rotation(roll, pitch, yaw))


def poses(n, low, high, seed=3):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield Pose(rng.uniform(low, high), rotation(*rng.uniform(-40, 40, 2), rng.uniform(0, 360)))


def seen(bodies, pose=None, camera=CAMERA, level=0.0):
    """An image of bodies in a room of one grey."""
    return Renderer(World(room(level), bodies), camera).render(pose or look())


# The camera


def test_body_axes():
    assert look().rotation == pytest.approx(np.eye(3))
    assert rotation(0, 0, 90) @ X == pytest.approx(Y)  # to the left
    assert rotation(0, 90, 0) @ X == pytest.approx(Z)  # nose up
    assert rotation(90, 0, 0) @ Y == pytest.approx(Z)  # right side down: the left one is up
    # First the yaw, then the pitch about what is left then, then the roll about the nose.
    turns = rotation(0, 0, 90) @ rotation(0, 30, 0) @ rotation(20, 0, 0)
    assert rotation(20, 30, 90) == pytest.approx(turns)
    assert np.linalg.det(turns) == pytest.approx(1.0)


def test_projection_has_left_on_the_left_and_up_at_the_top():
    camera = Camera((100, 200), 90.0)
    points = np.array([[2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 0.5]])
    expected = np.array([[100.0, 50.0], [50.0, 50.0], [100.0, 25.0]])
    assert project(camera, points, look()) == pytest.approx(expected)
    # Nose down by 10 degrees: what was straight ahead moves up.
    x, y = project(camera, points[0], look(pitch=-10.0))
    assert (x, y) == pytest.approx((100.0, 50.0 - 100.0 * math.tan(math.radians(10.0))))


# Edges


def centroid(picture, around_xy, reach=12):
    x, y = (int(c) for c in around_xy)
    part = picture[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(float)
    rows, columns = np.mgrid[y - reach : y + reach + 1, x - reach : x + reach + 1] + 0.5
    return np.array([(part * columns).sum(), (part * rows).sum()]) / part.sum()


@settings(max_examples=20, deadline=None)
@given(
    place=st.tuples(st.floats(-2.0, 0.3), st.floats(-0.6, 0.6), st.floats(-0.6, 0.6)),
    angles=st.tuples(st.floats(-40, 40), st.floats(-10, 10), st.floats(-15, 15)),
    tilt=st.floats(-50, 50),
    n_texels=st.sampled_from([160, 512]),
)
def test_known_points_are_found_in_the_picture(place, angles, tilt, n_texels):
    dots = [(0.25, 0.25), (0.75, 0.25), (0.5, 0.5), (0.25, 0.75), (0.75, 0.75)]
    y, x = np.mgrid[:n_texels, :n_texels] + 0.5
    squares = [(x - u * n_texels) ** 2 + (y - v * n_texels) ** 2 for u, v in dots]
    texture = Texture(np.exp(-np.array(squares) / (2.0 * 6.0**2)).sum(axis=0))
    right, down = rotation(0, 0, tilt) @ (-2.0 * Y), -2.0 * Z
    origin = 3.0 * X - (right + down) / 2.0
    camera, pose = Camera((240, 320), 70.0), look(*place, *angles)
    picture = seen([Solid("board", [quad(origin, right, down, texture)])], pose, camera)
    for u, v in dots:
        expected = project(camera, origin + u * right + v * down, pose)
        if np.all(expected > 20) and np.all(expected < (300, 220)):
            # Half a pixel is what is promised; slanted dots are not quite symmetric.
            assert np.abs(centroid(picture, expected) - expected).max() < 0.5


@settings(max_examples=15, deadline=None)
@given(
    corners=st.lists(st.tuples(st.floats(-10, 20), st.floats(-10, 20)), min_size=3, max_size=7),
    window=st.tuples(*[st.integers(0, 4)] * 2, *[st.integers(5, 10)] * 2),
)
def test_coverage_is_the_area_of_the_polygon_in_each_pixel(corners, window):
    """Against clipping the polygon at every pixel."""
    hull = cv2.convexHull(np.round(corners, 3).astype(np.float32), clockwise=False)
    if hull is None or len(hull) < 3:
        return
    hull = hull[:, 0].astype(float)
    left, top, right, bottom = window
    expected = np.zeros((bottom - top, right - left))
    for row, column in np.ndindex(*expected.shape):
        x, y = clipped(hull, column + left, row + top).T
        expected[row, column] = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    if expected.any():
        share = Coverage([hull + 7.3, hull, hull], (0, 0, 10, 10)).share(1, window)
        assert (1.0 if share is None else share) == pytest.approx(expected, abs=1e-5)
        assert (share is None) == (expected.min() > 1.0 - 1e-9)


def clipped(polygon, column, row):
    """The part of a polygon in one pixel."""
    for axis, sign, limit in ((0, 1, column), (0, -1, -column - 1), (1, 1, row), (1, -1, -row - 1)):
        kept = []
        for here, there in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            a, b = sign * here[axis] - limit, sign * there[axis] - limit
            if a >= 0:
                kept.append(here)
            if (a >= 0) != (b >= 0):
                kept.append(here + a / (a - b) * (there - here))
        polygon = np.array(kept).reshape(-1, 2)
    return polygon


def test_nothing_shows_between_faces_that_share_an_edge():
    boxes = [box((1, -1, 0), (2, 0, 1), 1.0), box((1.2, -1, 1), (2, -0.2, 1.5), 1.0)]
    bodies = [*boxes, capsule([-1, 1, 1], [-1, 1, 1.5], 0.3, 1.0)]
    renderer = Renderer(World(room(1.0, (-3, -2, 0), (3, 2, 3)), bodies), CAMERA)
    for pose in poses(12, (-0.8, -1.8, 0.2), (0.8, 0.5, 2.8)):
        assert np.abs(renderer.render(pose) - 1.0).max() < 1e-4


def test_near_things_are_clipped_and_not_turned_inside_out():
    # Nearer than a lens could show.
    assert seen([box((0.005, -1, -1), (0.2, 1, 1), 1.0)], level=0.25).max() == 0.25
    picture = seen([box((-1, 0.05, -1), (3, 0.5, 1), 1.0)], level=0.25)
    assert (picture[60, :70] == 1.0).all() and (picture[60, 85:] == 0.25).all()


# Textures


def noise_textures(shape, seed=0, contrast=1.0):
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.random(shape), (0, 0), 2)
    return [Texture(np.clip(0.5 + (noise - 0.5) * contrast, 0.0, 1.0))] * 6


def test_a_picture_does_not_depend_on_how_it_is_cut():
    textures = noise_textures((200, 300))
    bodies = [box((1, -1, 0), (2, 0, 1), textures=textures)]
    world = World(room(0, (-3, -2, 0), (3, 2, 3), textures), bodies)
    renderer = Renderer(world, CAMERA)
    for pose in poses(4, (-0.8, -1.8, 0.2), (0.8, 0.5, 2.8)):
        whole = renderer.render(pose)
        parts = [renderer.render(pose, rows=(a, b)) for a, b in ((0, 1), (1, 50), (50, 120))]
        np.testing.assert_allclose(np.concatenate(parts), whole, atol=1e-3)
        assert (renderer.render(pose) == whole).all()


def test_mipmaps_keep_far_texture_from_flickering():
    """A fine pattern far away is grey wherever the camera is, and sharp from near."""
    stripes = np.zeros((512, 512), np.float32)
    stripes[:, ::2] = 1.0
    renderer = Renderer(World(room(), [board(4, 2, Texture(stripes))]), CAMERA)
    far = np.array([renderer.render(look(y=y))[50:70, 70:90] for y in np.linspace(0, 0.02, 7)])
    assert np.ptp(far) < 0.02 and far.mean() == pytest.approx(0.5, abs=0.01)
    near = renderer.render(look(x=3.98))
    assert near.min() < 0.05 and near.max() > 0.95


def test_textures_change_their_size_without_a_step():
    noise = np.random.default_rng(1).random((1024, 1024), np.float32)
    textures = [plain(0.0), Texture(cv2.GaussianBlur(noise, (0, 0), 1.5)), *[plain(0.0)] * 4]
    world = World(room(0, (0, -5, 0), (20, 5, 3), textures))
    renderer = Renderer(world, Camera((240, 320), 80.0))
    # Where the finer size fades in, neighbouring heights differ no more than by what they show.
    pictures = [renderer.render(look(x=2.0, z=1.5 + dz)) for dz in (0.0, 0.002)]
    spread = [picture[150:, 70:250].std(axis=1) for picture in pictures]
    assert spread[0].min() > 0.01
    assert np.abs(np.diff(spread[0])).max() < 0.02
    assert np.abs(np.subtract(*spread)).max() < 0.005


def test_textures_are_neither_blurred_nor_jagged():
    """Against the mean over sixteen finer pixels."""
    world = World(room(0, (-3, -2, 0), (6, 2, 3), noise_textures((800, 1200), 4, 3.0)))
    shape = (90, 120)
    renderers = [Renderer(world, Camera([k * s for s in shape], 80.0)) for k in (1, 4)]
    contrasts, errors = [], []
    for pose in poses(8, (-2.5, -1, 0.5), (2, 1, 2.5)):
        picture, fine = (each.render(pose) for each in renderers)
        mean = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
        contrasts.append([np.abs(np.diff(each)).mean() for each in (picture, mean)])
        errors.append(np.abs(picture - mean).mean())
    contrast, wanted = np.mean(contrasts, axis=0)
    # Of noise as fine as the pixels a little less is shown, so that it does not shimmer.
    assert 0.68 < contrast / wanted < 0.8
    assert np.mean(errors) < 0.32 * wanted


def test_a_picture_is_made_of_numbers_whichever_way_the_camera_looks():
    """Also where the horizon of a wall goes exactly through the middles of pixels."""
    rng = np.random.default_rng(2)
    textures = [Texture(rng.random(size)) for size in ((1, 900), (700, 1), (40, 50)) * 2]
    world = World(room(0, (-3, -3, -3), (3, 3, 3), textures))
    renderer = Renderer(world, Camera((36, 64), 170.0))
    for angles in itertools.product((0, 45, 90), repeat=3):
        picture = renderer.render(look(0.3, -0.4, 0.2, *angles))
        assert picture.min() > -1e-6 and picture.max() < 1.0 + 1e-6, angles


# What hides what


@pytest.mark.parametrize("order", [1, -1])
def test_of_bodies_that_cut_the_nearer_one_is_seen(order):
    bodies = [box((2, -1, -1), (3, 1, 1), 1.0), box((2.5, -1, -1), (4, 1, 1), 0.5)][::order]
    assert seen(bodies)[60, 80] == 1.0
    assert seen(bodies, look(x=6.0, yaw=180.0))[60, 80] == 0.5


def test_a_moving_body_is_where_it_moves_to():
    mover = box((2, -0.2, -0.2), (2.4, 0.2, 0.2), 1.0, motion=lambda t: [0, t, 0])
    wall = box((3, -4, -4), (3.2, 4, 4), 0.25)
    renderer = Renderer(World(room(), [mover, wall]), CAMERA)
    for time_s in (0.0, 0.5, -0.7, 0.0):
        bright = np.argwhere(renderer.render(look(), time_s) > 0.9)
        expected = project(CAMERA, np.array([2.0, time_s, 0.0]), look())
        assert bright.mean(axis=0)[::-1] + 0.5 == pytest.approx(expected, abs=3.5)
    behind = box((4, -0.2, -0.2), (4.4, 0.2, 0.2), 1.0, motion=lambda t: [-2 * t, 0, 0])
    renderer = Renderer(World(room(), [behind, wall]), CAMERA)
    assert [renderer.render(look(), time_s).max() for time_s in (0.0, 1.0)] == [0.25, 1.0]


def test_a_view_is_painted_again_only_if_something_has_moved(monkeypatch):
    n_painted = []
    paint = painter._paint
    monkeypatch.setattr(painter, "_paint", lambda *of: n_painted.append(1) or paint(*of))
    mover = box((2, -0.2, -0.2), (2.4, 0.2, 0.2), 1.0, motion=lambda t: [0, max(t, 1.0), 0])
    world = World(room(), [mover], light=lambda t: 0.5 if t == 0.5 else 1.0)
    renderer = Renderer(world, CAMERA)
    first = renderer.render(look(), 0.0)
    first *= 0.0  # the caller may overwrite it
    half, whole = renderer.render(look(), 0.5), renderer.render(look(), 1.0)
    assert len(n_painted) == 1 and np.array_equal(half, whole * np.float32(0.5))
    renderer.render(look(), 2.0)
    renderer.render(look(yaw=1.0), 2.0)
    assert renderer.render(look(yaw=1.0), 2.0, (3, 5)).shape == (2, CAMERA.shape[1])
    assert len(n_painted) == 4


def test_light_is_a_gain_of_a_face_and_of_the_world():
    dim = Solid("board", [quad([2, 5, 5], -10 * Y, -10 * Z, plain(0.5), 0.4)])
    world = World(room(1.0), [dim], light=lambda t: 0.5 if t < 1.0 else 1.0)
    renderer = Renderer(world, CAMERA)
    assert renderer.render(look(), 0.0)[5, 5] == pytest.approx(0.1)
    assert renderer.render(look(), 1.0)[5, 5] == pytest.approx(0.2)


def test_a_shadow_darkens_the_room_behind_it_but_no_body():
    shade = Shade(np.full((4, 4), 0.25), (4.0, 20.0))
    lies = Solid("shadow", [quad([9.9, 2, 10], -4 * Y, -20 * Z, shade)], lambda t: [0, 5 * t, 0])
    thing = box((5, -0.5, -0.5), (6, 0.5, 0.5), 0.5)
    renderer = Renderer(World(room(0.8), [thing], shadows=[lies]), CAMERA)
    picture = renderer.render(look())
    y, x = 60, 80
    assert picture[y, x] == 0.5 and picture[y, 20] == pytest.approx(0.8)
    assert picture[5, x] == pytest.approx(0.2)
    # It has moved to the left, over the room alone.
    picture = renderer.render(look(), 1.0)
    assert picture[y, x] == 0.5 and picture[5, x] == pytest.approx(0.8)
    assert picture[y, 80 - 48] == pytest.approx(0.2)


# Balls and capsules


@pytest.mark.parametrize("distance", [0.5, 0.7, 1.0, 3.0])
def test_a_ball_is_a_disc_of_the_right_size_and_its_texture_fills_it(distance):
    y, x = (np.mgrid[:256, :256] + 0.5) / 128.0 - 1.0
    rings = Texture(np.minimum(np.hypot(x, y), 1.0))
    camera = Camera((400, 400), 120.0)
    radius = camera.focal_px * 0.4 / math.sqrt(distance**2 - 0.4**2)
    area = seen([ball([distance, 0, 0], 0.4, 1.0)], camera=camera).sum()
    assert area == pytest.approx(math.pi * radius**2, rel=1e-3)
    row = seen([ball([distance, 0, 0], 0.4, rings)], camera=camera)[200]
    for share in (0.25, 0.5, 0.9):
        there = np.interp(199.5 + share * radius, np.arange(400), row)
        assert there == pytest.approx(share, abs=0.03)


@pytest.mark.parametrize(
    "ends",
    [
        ([2.0, 0.9, -0.5], [2.0, 0.9, -0.5]),
        ([2.0, 0.9, -0.5], [2.4, 0.6, 0.1]),
        ([2.0, 0.3, -0.7], [-1.5, 0.9, 0.2]),
        ([0.7, 0.2, 0.1], [3.0, 0.25, 0.0]),
        ([0.8, 0.0, 0.0], [3.0, 0.0, 0.0]),
    ],
    ids=["ball", "aside", "reaching behind the camera", "on its tip", "along the axis"],
)
def test_a_round_body_covers_its_rays(ends):
    camera, pose, radius = Camera((75, 100), 80.0), look(roll=20, pitch=5, yaw=-10), 0.5
    columns, rows = np.meshgrid(np.arange(100) + 0.5, np.arange(75) + 0.5)
    rays = rays_of(camera, np.stack([columns, rows], -1), pose)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    # Distance of a ray from the segment, least over points along the segment.
    gaps = []
    for point in np.linspace(*ends, 300):
        ahead = np.maximum(rays @ point, 0.0)
        gaps.append(np.linalg.norm(point - ahead[..., None] * rays, axis=-1))
    hit = np.min(gaps, axis=0) < radius
    picture = seen([capsule(*ends, radius, 1.0)], pose, camera)
    assert 0.05 < hit.mean() < 0.95
    assert np.abs((picture > 0.5).astype(int) - hit).sum() < 0.004 * hit.sum() + 4


def test_a_round_body_is_textured_from_wherever_it_is_seen():
    """Also on its tip, where no plane along it could be."""
    squares = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((16, 16)))
    body = capsule([0, 0, -0.6], [0, 0, 0.6], 0.3, Texture(squares))
    renderer = Renderer(World(room(0.5, (-3, -3, -3), (3, 3, 3)), [body]), CAMERA)
    for x, z in ((-1.5, 0), (-0.8, 1.5), (-0.29, 1.5), (0.0, 1.5), (-0.1, 0.95), (0.0, -2.0)):
        pitch = math.degrees(math.atan2(-z, -x))
        picture = renderer.render(look(x, 0, z, pitch=pitch))
        assert picture.min() < 0.01 and picture.max() > 0.99, (x, z)
        for away in (90, 180, 270):
            assert np.isfinite(renderer.render(look(x, 0, z, pitch=pitch + away))).all()


@pytest.mark.parametrize(
    "body",
    [
        ball([0.1, 0, 0], 0.4, 1.0),
        ball([-2, 0, 0], 0.4, 1.0),
        capsule([0, -2, 0], [0, 2, 0], 0.4, 1.0),
    ],
    ids=["inside a ball", "behind the camera", "inside a capsule"],
)
def test_round_bodies_around_or_behind_the_camera_are_not_seen(body):
    assert seen([body], level=0.25).max() == 0.25


# The sensor


def exposed(level, shape=(200, 200), index=0, **how):
    options = FlightOptions(shape, **{"vignette": 0, "noise": 0, "shot_noise": 0, **how})
    return Sensor(options).develop(np.full(shape, level, np.float32), index)


def test_grey_levels_follow_gamma():
    assert (exposed(1.0) == 255).all() and (exposed(0.0) == 0).all() and (exposed(7.0) == 255).all()
    assert (exposed(0.5) == round(255 * 0.5 ** (1 / 2.2))).all()
    assert (exposed(0.5, gamma=1.0) == 128).all()


@pytest.mark.parametrize("level", [0.1, 0.4])
def test_noise_has_the_variance_that_was_asked_for(level):
    frame = exposed(level, gamma=1.0, shot_noise=0.05, noise=0.02) / 255.0
    assert frame.mean() == pytest.approx(level, abs=1e-3)
    assert frame.var() == pytest.approx(0.05**2 * level + 0.02**2, rel=0.05)


def test_noise_is_normal_and_new_in_every_pixel():
    noise = exposed(0.5, (301, 203), gamma=1.0, noise=0.1) / 127.5 - 1.0
    noise /= 0.2
    assert (np.abs(noise) < 1.0).mean() == pytest.approx(0.683, abs=0.02)
    assert (np.abs(noise) < 2.0).mean() == pytest.approx(0.954, abs=0.01)
    assert 3.5 < np.abs(noise).max() < 4.4 and abs((noise**3).mean()) < 0.05
    for shift in ((0, 1), (1, 0), (0, 4), (3, 2)):
        assert abs((noise * np.roll(noise, shift, (0, 1))).mean()) < 0.015


def test_the_vignette_takes_its_share_from_the_corners():
    frame = exposed(0.8, (150, 200), gamma=1.0, vignette=0.5) / 255.0
    assert frame[75, 100] == pytest.approx(0.8, abs=0.005)
    assert frame[0, 0] == pytest.approx(0.4, abs=0.01)
    assert (frame == frame[::-1, ::-1]).all()
    assert (np.diff(frame[75, 100:]) <= 0).all()
