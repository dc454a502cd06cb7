"""The renderer: points are found where geometry says, and nothing shows through what hides it."""

import itertools
import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.flights.renderer.camera import Camera, Pose, rotation
from dlgmd_cli.flights.renderer.coverage import Coverage
from dlgmd_cli.flights.renderer.painter import Renderer
from dlgmd_cli.flights.renderer.sensor import Sensor
from dlgmd_cli.flights.renderer.solids import Round, Solid, World, quad
from dlgmd_cli.flights.renderer.texture import Texture
from dlgmd_cli.flights.renderer.visibility import Order, between

X, Y, Z = np.eye(3)
PLAIN = {level: Texture(np.float32(level)) for level in (0.0, 0.25, 0.5, 1.0)}
CAMERA = Camera((120, 160), 80.0)


def box_faces(low, high, textures, *, inside=False):
    """The six faces of an upright box, seen from outside or from inside."""
    (x, y, z), size = low, np.subtract(high, low)
    (x2, y2, z2), (dx, dy, dz) = high, (X * size[0], Y * size[1], Z * size[2])
    corners = [
        ([x, y2, z2], dx, -dy),  # from above
        ([x, y, z], dx, dy),  # from below
        ([x, y, z2], dx, -dz),  # from where y is less
        ([x2, y2, z2], -dx, -dz),
        ([x, y2, z2], -dy, -dz),  # from where x is less
        ([x2, y, z2], dy, -dz),
    ]
    faces = []
    for (origin, right, down), texture in zip(corners, textures, strict=True):
        if inside:
            origin, right = np.add(origin, right), -right
        faces.append(quad(origin, right, down, texture))
    return faces


def room(level=0.0, low=(-10, -10, -10), high=(10, 10, 10)):
    return Solid("room", box_faces(low, high, [PLAIN[level]] * 6, inside=True))


def box(low, high, level=1.0, name="box"):
    return Solid(name, box_faces(low, high, [PLAIN[level]] * 6))


def look(x=0.0, y=0.0, z=0.0, roll=0.0, pitch=0.0, yaw=0.0):
    return Pose(np.array([x, y, z]), rotation(roll, pitch, yaw))


def dot_texture(n_texels, dots):
    """A black square with small bright dots at shares (u, v) of its sides."""
    image = np.zeros((n_texels, n_texels), np.float32)
    y, x = np.mgrid[:n_texels, :n_texels] + 0.5
    for u, v in dots:
        square = (x - u * n_texels) ** 2 + (y - v * n_texels) ** 2
        image += np.exp(-square / (2.0 * 6.0**2)).astype(np.float32)
    return Texture(image)


def centroid(picture, around_xy, reach=9):
    x, y = (int(c) for c in around_xy)
    part = picture[y - reach : y + reach + 1, x - reach : x + reach + 1].astype(float)
    rows, columns = np.mgrid[y - reach : y + reach + 1, x - reach : x + reach + 1] + 0.5
    return np.array([(part * columns).sum(), (part * rows).sum()]) / part.sum()


def test_body_axes():
    assert look().rotation == pytest.approx(np.eye(3))
    assert rotation(0, 0, 90) @ X == pytest.approx(Y)  # to the left
    assert rotation(0, 90, 0) @ X == pytest.approx(Z)  # nose up
    assert rotation(90, 0, 0) @ Y == pytest.approx(Z)  # right side down: the left one is up
    # First the yaw, then the pitch about what is left then, then the roll about the nose.
    assert rotation(0, 30, 90) @ X == pytest.approx(rotation(0, 0, 90) @ rotation(0, 30, 0) @ X)
    assert rotation(20, 30, 90) @ Y == pytest.approx(rotation(0, 30, 90) @ rotation(20, 0, 0) @ Y)
    turned = rotation(10, -20, 130)
    assert turned @ turned.T == pytest.approx(np.eye(3))
    assert np.linalg.det(turned) == pytest.approx(1.0)


def test_projection_has_left_on_the_left_and_up_at_the_top():
    camera = Camera((100, 200), 90.0)
    assert camera.focal_px == pytest.approx(100.0)
    points = np.array([[2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [2.0, 0.0, 0.5]])
    assert camera.project(points, look()) == pytest.approx(
        np.array([[100.0, 50.0], [50.0, 50.0], [100.0, 25.0]])
    )
    # Nose down by 10 degrees: what was straight ahead moves up.
    x, y = camera.project(points[0], look(pitch=-10.0))
    assert (x, y) == pytest.approx((100.0, 50.0 - 100.0 * math.tan(math.radians(10.0))))


@settings(max_examples=30, deadline=None)
@given(
    position=st.tuples(*[st.floats(-3, 3)] * 3),
    angles=st.tuples(*[st.floats(-180, 180)] * 3),
    at=st.tuples(st.floats(0, 160), st.floats(0, 120)),
    depth=st.floats(0.05, 50),
)
def test_rays_are_the_inverse_of_projection(position, angles, at, depth):
    pose = Pose(np.array(position), rotation(*angles))
    point = pose.position_m + depth * CAMERA.rays(np.array(at), pose)
    assert CAMERA.project(point, pose) == pytest.approx(np.array(at), abs=1e-6)
    assert CAMERA.view(point, pose)[2] == pytest.approx(depth)
    ray = CAMERA.rays_from_xy @ [*at, 1.0]
    assert pose.camera_from_world.T @ ray == pytest.approx(CAMERA.rays(np.array(at), pose))


@settings(max_examples=40, deadline=None)
@given(
    x=st.floats(-2.0, 0.3),
    y=st.floats(-0.6, 0.6),
    z=st.floats(-0.6, 0.6),
    roll=st.floats(-40, 40),
    pitch=st.floats(-10, 10),
    yaw=st.floats(-15, 15),
    tilt=st.floats(-50, 50),
    mip=st.booleans(),
)
def test_known_points_are_found_in_the_picture(x, y, z, roll, pitch, yaw, tilt, mip):
    dots = [(0.25, 0.25), (0.75, 0.25), (0.5, 0.5), (0.25, 0.75), (0.75, 0.75)]
    turned = rotation(0, 0, tilt)
    right, down = turned @ (-2.0 * Y), -2.0 * Z
    origin = np.array([3.0, 0.0, 0.0]) - (right + down) / 2.0
    texture = dot_texture(512 if mip else 160, dots)
    board = Solid("board", [quad(origin, right, down, texture)])
    camera = Camera((240, 320), 70.0)
    pose = look(x, y, z, roll, pitch, yaw)
    picture = Renderer(World(room(), [board]), camera).render(pose)
    for u, v in dots:
        expected = camera.project(origin + u * right + v * down, pose)
        if np.all(expected > 20) and np.all(expected < (300, 220)):
            # Half a pixel is what is promised; slanted dots are not quite symmetric.
            assert np.abs(centroid(picture, expected, reach=12) - expected).max() < 0.5


@settings(max_examples=30, deadline=None)
@given(
    x=st.floats(-3, 0.5), y=st.floats(-0.3, 0.3), z=st.floats(-0.3, 0.3),
    roll=st.floats(-45, 45), tilt=st.floats(-40, 40),
)  # fmt: skip
def test_the_area_of_a_board_is_that_of_its_projected_corners(x, y, z, roll, tilt):
    right = rotation(0, 0, tilt) @ (-0.8 * Y)
    origin = np.array([2.0, 0.0, 0.4]) - right / 2.0
    board = Solid("board", [quad(origin, right, -0.8 * Z, PLAIN[1.0])])
    camera = Camera((240, 320), 70.0)
    pose = look(x, y, z, roll)
    corners = camera.project(board.corners_m, pose)
    if not (np.all(corners > 1) and np.all(corners < (319, 239))):
        return
    picture = Renderer(World(room(), [board]), camera).render(pose)
    area = cv2.contourArea(corners.astype(np.float32))
    assert picture.sum() == pytest.approx(area, rel=1e-4)


def test_an_edge_moves_by_fractions_of_a_pixel():
    board = box((1.0, -5.0, -0.2), (1.5, 5.0, 5.0))
    camera = Camera((64, 64), 90.0)
    for shift in np.linspace(0.0, 0.1, 11):
        picture = Renderer(World(room(), [board]), camera).render(look(z=shift))
        assert (picture[:, 30] == picture[:, 0]).all()
        assert picture[:, 30].sum() == pytest.approx(32.0 * (1.0 + 0.2 + shift), abs=1e-3)


@settings(max_examples=60, deadline=None)
@given(
    corners=st.lists(st.tuples(st.floats(-30, 60), st.floats(-30, 60)), min_size=3, max_size=7),
    window=st.tuples(*[st.integers(0, 12)] * 2, *[st.integers(13, 30)] * 2),
)
def test_coverage_is_the_area_of_the_polygon_in_each_pixel(corners, window):
    """Against clipping the polygon at every pixel."""
    points = np.array(corners, np.float32)
    hull = cv2.convexHull(points, clockwise=False)
    if hull is None or len(hull) < 3:
        return
    hull = hull[:, 0].astype(float)
    left, top, right, bottom = window
    expected = np.zeros((bottom - top, right - left))
    for row in range(top, bottom):
        for column in range(left, right):
            part = clipped(hull, column, row)
            x, y = part.T if len(part) else np.zeros((2, 1))
            expected[row - top, column - left] = (x * np.roll(y, -1) - y * np.roll(x, -1)).sum() / 2
    if not expected.any():
        return
    share = Coverage([hull + 7.3, hull, hull], (0, 0, 30, 30)).share(1, window)
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
        if not len(polygon):
            break
    return polygon


def test_a_far_rod_does_not_grow():
    """A rod much thinner than a pixel takes its share of the light and no more."""
    for distance in (5.0, 10.0, 20.0, 40.0):
        rod = box((distance, -0.013, -60), (distance + 0.001, 0.013, 60))
        picture = Renderer(World(room(low=(-99,) * 3, high=(99,) * 3), [rod]), CAMERA).render(
            look()
        )
        assert picture[60].sum() == pytest.approx(CAMERA.focal_px * 0.026 / distance, rel=1e-3)


def poses(n, low, high, seed=3):
    rng = np.random.default_rng(seed)
    for _ in range(n):
        yield Pose(rng.uniform(low, high), rotation(*rng.uniform(-40, 40, 2), rng.uniform(0, 360)))


def test_nothing_shows_between_faces_that_share_an_edge():
    white = room(1.0, (-3, -2, 0), (3, 2, 3))
    boxes = [box((1, -1, 0), (2, 0, 1)), box((1.2, -1, 1), (2, -0.2, 1.5))]
    balls = [Round("ball", np.array([[-1, 1, 1], [-1, 1, 1.5]]), 0.3, PLAIN[1.0])]
    renderer = Renderer(World(white, boxes + balls), CAMERA)
    for pose in poses(30, (-0.8, -1.8, 0.2), (0.8, 0.5, 2.8)):
        picture = renderer.render(pose)
        assert picture == pytest.approx(np.ones(CAMERA.shape), abs=1e-4)


def test_a_picture_does_not_depend_on_how_it_is_cut():
    rng = np.random.default_rng(0)
    textures = [Texture(cv2.GaussianBlur(rng.random((200, 300)), (0, 0), 2)) for _ in range(6)]
    world = World(
        Solid("room", box_faces((-3, -2, 0), (3, 2, 3), textures, inside=True)),
        [Solid("box", box_faces((1, -1, 0), (2, 0, 1), textures))],
    )
    renderer = Renderer(world, CAMERA)
    for pose in poses(5, (-0.8, -1.8, 0.2), (0.8, 0.5, 2.8)):
        whole = renderer.render(pose)
        parts = [renderer.render(pose, rows=(a, b)) for a, b in ((0, 1), (1, 50), (50, 120))]
        assert np.concatenate(parts) == pytest.approx(whole, abs=1e-3)
        assert (renderer.render(pose) == whole).all()


def test_mipmaps_keep_far_texture_from_flickering():
    """A fine pattern far away is grey wherever the camera is, and sharp from near."""
    stripes = np.zeros((512, 512), np.float32)
    stripes[:, ::2] = 1.0
    board = Solid("board", [quad([4, 1, 1], -2 * Y, -2 * Z, Texture(stripes))])
    renderer = Renderer(World(room(), [board]), CAMERA)
    far = np.array([renderer.render(look(y=y))[50:70, 70:90] for y in np.linspace(0, 0.02, 7)])
    assert np.ptp(far) < 0.02 and far.mean() == pytest.approx(0.5, abs=0.01)
    near = renderer.render(look(x=3.98))
    assert near.min() < 0.05 and near.max() > 0.95


def test_textures_change_their_size_without_a_step():
    rng = np.random.default_rng(1)
    floor = [PLAIN[0.0]] * 6
    floor[0] = Texture(cv2.GaussianBlur(rng.random((2048, 2048), np.float32), (0, 0), 1.5))
    world = World(Solid("room", box_faces((0, -5, 0), (20, 5, 3), floor, inside=True)))
    # Where the finer size fades in, neighbouring heights differ no more than by what they show.
    world.room.faces[0], world.room.faces[1] = world.room.faces[1], world.room.faces[0]
    renderer = Renderer(world, Camera((240, 320), 80.0))
    spread = [
        renderer.render(look(x=2.0, z=1.5 + 0.001 * step))[130:].std(axis=1) for step in range(3)
    ]
    assert np.abs(np.diff(spread[0])).max() < 0.05
    assert np.abs(np.subtract(spread[0], spread[2])).max() < 0.02


def test_textures_are_neither_blurred_nor_jagged():
    """Against the mean over sixteen finer pixels."""
    rng = np.random.default_rng(4)
    noise = cv2.GaussianBlur(rng.random((800, 1200)), (0, 0), 2)
    noise = np.clip(0.5 + (noise - 0.5) * 3.0, 0.0, 1.0)
    textured = Solid("room", box_faces((-3, -2, 0), (6, 2, 3), [Texture(noise)] * 6, inside=True))
    shape = (90, 120)
    renderers = [Renderer(World(textured), Camera([k * s for s in shape], 80.0)) for k in (1, 4)]
    contrasts, errors = [], []
    for pose in poses(8, (-2.5, -1, 0.5), (2, 1, 2.5)):
        seen, fine = (each.render(pose) for each in renderers)
        mean = cv2.resize(fine, shape[::-1], interpolation=cv2.INTER_AREA)
        contrasts.append([np.abs(np.diff(each)).mean() for each in (seen, mean)])
        errors.append(np.abs(seen - mean).mean())
    contrast, wanted = np.mean(contrasts, axis=0)
    # Of noise as fine as the pixels a little less is shown, so that it does not shimmer.
    assert 0.68 < contrast / wanted < 0.8
    assert np.mean(errors) < 0.32 * wanted


def test_the_rim_of_a_texture_reaches_to_the_edge_of_its_face():
    board = Solid("board", [quad([1, 1, 1], -2 * Y, -2 * Z, Texture([[0.2, 0.8]]))])
    row = Renderer(World(room(), [board]), Camera((120, 160), 90.0)).render(look())[60]
    assert row[:38] == pytest.approx(np.full(38, 0.2), abs=1e-6)
    assert row[-38:] == pytest.approx(np.full(38, 0.8), abs=1e-6)
    assert row[80 - 20 : 80 + 20].mean() == pytest.approx(0.5, abs=1e-3)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_what_is_behind_is_hidden(seed):
    """Against rays through the middle and the rim of every pixel, where they all see the same."""
    rng = np.random.default_rng(seed)
    bodies, levels = [], []
    for i in range(8):
        x, y, z = 1.5 + (i // 3) * 1.2, -1.8 + (i % 3) * 1.2, rng.uniform(-0.8, 0)
        size = rng.uniform(0.2, 1.0, 3)
        level = 0.1 + 0.1 * i
        low, high = np.array([x, y, z]), np.array([x, y, z]) + size
        bodies.append(Solid(f"{i}", box_faces(low, high, [Texture(np.float32(level))] * 6)))
        levels.append((low, high, level))
    order = rng.permutation(8)
    camera = Camera((36, 48), 90.0)
    pose = look(*rng.uniform(-0.4, 0.4, 3), *rng.uniform(-20, 20, 3))
    picture = Renderer(World(room(), [bodies[i] for i in order]), camera).render(pose)
    columns, rows = np.meshgrid(np.arange(97) / 2.0, np.arange(73) / 2.0)
    rays = camera.rays(np.stack([columns, rows], -1), pose)
    nearest, traced = np.full((73, 97), np.inf), np.zeros((73, 97))
    with np.errstate(divide="ignore"):
        for low, high, level in levels:
            ends = np.sort(
                np.stack([(low - pose.position_m) / rays, (high - pose.position_m) / rays]), axis=0
            )
            enters, leaves = ends[0].max(-1), ends[1].min(-1)
            hit = (enters < leaves) & (enters > 0) & (enters < nearest)
            nearest[hit], traced[hit] = enters[hit], level
    inner = np.ones((3, 3), np.uint8)
    is_flat = (cv2.dilate(traced, inner) == cv2.erode(traced, inner))[1::2, 1::2]
    expected = traced[1::2, 1::2]
    # A sharp tip may pass between the rays.
    assert picture[is_flat] == pytest.approx(expected[is_flat], abs=0.04)


def test_order_is_exact_for_upright_bodies():
    rng = np.random.default_rng(5)
    bodies = [
        box((i, j, 0), (i + 0.9, j + 0.9, rng.uniform(0.2, 2))) for i in range(4) for j in (0, 1)
    ]
    bodies.append(Round("ball", np.array([[1.95, 0.95, 3.0]] * 2), 0.4, PLAIN[1.0]))
    bodies.append(Round("ball", np.array([[1.95, 0.95, 4.0]] * 2), 0.4, PLAIN[1.0]))
    assert Order(bodies).is_exact
    x, y, z, offset = between(bodies[-2], bodies[-1])
    assert (x, y, z, offset) == pytest.approx((0, 0, 1, 3.5))
    cut = [*bodies, box((0.5, 0.5, 0.1), (1.5, 1.5, 0.15))]
    assert not Order(cut).is_exact
    everywhere = dict.fromkeys(range(11), (0.0, 0.0, 9.0, 9.0))
    assert sorted(Order(cut).back_to_front(np.array([-5.0, 0, 1]), everywhere)) == [*range(11)]


@pytest.mark.parametrize("turned", [0.0, 40.0])
def test_what_is_nearer_hides_also_where_its_middle_is_farther(turned):
    axes = rotation(0, 0, turned)

    def turned_box(low, high, level):
        faces = box_faces(low, high, [PLAIN[level]] * 6)
        quads = [
            quad(axes @ f.origin_m, axes @ f.right_m, axes @ f.down_m, f.texture) for f in faces
        ]
        return Solid("box", quads)

    screen = turned_box((1.5, -0.5, -1), (1.6, 8, 1), 1.0)
    hidden = turned_box((1.8, -0.2, -0.5), (2.2, 0.6, 0.5), 0.5)
    for bodies in ([screen, hidden], [hidden, screen]):
        assert Order(bodies).is_exact
        picture = Renderer(World(room(), bodies), CAMERA).render(look(yaw=turned))
        assert not (np.abs(picture - 0.5) < 0.01).any() and picture[60, 80] == 1.0


def test_of_bodies_that_cut_the_nearer_one_is_seen():
    first, second = box((2, -1, -1), (3, 1, 1), 1.0), box((2.5, -1, -1), (4, 1, 1), 0.5)
    for bodies in ([first, second], [second, first]):
        renderer = Renderer(World(room(), bodies), CAMERA)
        assert renderer.render(look())[60, 80] == 1.0
        assert renderer.render(look(x=6.0, yaw=180.0))[60, 80] == 0.5


def test_of_bodies_that_hide_each_other_in_a_ring_the_farthest_is_painted_first():
    """Three bars along the axes, each before the next one as seen from afar along (1, 1, 1)."""
    eye, everywhere = np.full(3, 10.0), dict.fromkeys(range(3), (0.0, 0.0, 9.0, 9.0))
    for farthest in range(3):
        bars = []
        for axis in range(3):
            middle = np.roll([0.0, 1.0, -1.0], axis) - 2.0 * (axis == farthest) * np.eye(3)[axis]
            half = np.where(np.arange(3) == axis, 4.0, 0.2)
            bars.append(box(middle - half, middle + half))
        expected = [(farthest + step) % 3 for step in range(3)]
        assert Order(bars).back_to_front(eye, everywhere) == expected


def test_a_face_gets_its_share_of_the_light():
    board = Solid("board", [quad([2, 5, 5], -10 * Y, -10 * Z, PLAIN[0.5], 0.4)])
    ball = Round("ball", np.array([[1, 0, 0]] * 2), 0.3, PLAIN[1.0], 0.3)
    picture = Renderer(World(room(1.0), [board, ball]), CAMERA).render(look())
    assert picture[5, 5] == pytest.approx(0.2) and picture[60, 80] == pytest.approx(0.3)


def test_a_moving_body_is_where_it_moves_to():
    mover = Solid("mover", box((2, -0.2, -0.2), (2.4, 0.2, 0.2)).faces, motion=lambda t: [0, t, 0])
    wall = box((3, -4, -4), (3.2, 4, 4), 0.25)
    renderer = Renderer(World(room(), [mover, wall]), CAMERA)
    for time_s in (0.0, 0.5, -0.7, 0.0):
        picture = renderer.render(look(), time_s)
        bright = np.argwhere(picture > 0.9)
        expected = CAMERA.project(np.array([2.0, time_s, 0.0]), look())
        assert bright.mean(axis=0)[::-1] + 0.5 == pytest.approx(expected, abs=3.5)
    behind = Solid(
        "mover", box((4, -0.2, -0.2), (4.4, 0.2, 0.2)).faces, motion=lambda t: [-2 * t, 0, 0]
    )
    renderer = Renderer(World(room(), [behind, wall]), CAMERA)
    assert renderer.render(look(), 0.0).max() == 0.25
    assert renderer.render(look(), 1.0).max() == 1.0


def test_light_is_a_gain():
    world = World(room(0.5), light=lambda t: 0.5 if t < 1.0 else 1.0)
    renderer = Renderer(world, CAMERA)
    assert renderer.render(look(), 0.0) == pytest.approx(np.full((120, 160), 0.25))
    assert renderer.render(look(), 1.0) == pytest.approx(np.full((120, 160), 0.5), abs=1e-6)


@pytest.mark.parametrize("distance", [0.45, 0.6, 1.0, 3.0])
def test_a_ball_is_a_disc_of_the_right_size(distance):
    ball = Round("ball", np.array([[distance, 0, 0]] * 2), 0.4, PLAIN[1.0])
    camera = Camera((400, 400), 60.0)
    picture = Renderer(World(room(), [ball]), camera).render(look())
    radius = camera.focal_px * 0.4 / math.sqrt(distance**2 - 0.4**2)
    if radius < 199:
        assert picture.sum() == pytest.approx(math.pi * radius**2, rel=6e-4)
    else:
        assert picture[200, 200] == 1.0


@pytest.mark.parametrize("distance", [0.5, 0.7, 3.0])
def test_the_texture_of_a_ball_fills_what_is_seen_of_it(distance):
    y, x = (np.mgrid[:256, :256] + 0.5) / 128.0 - 1.0
    rings = Texture(np.minimum(np.hypot(x, y), 1.0))
    ball = Round("ball", np.array([[distance, 0, 0]] * 2), 0.4, rings)
    camera = Camera((400, 400), 120.0)
    row = Renderer(World(room(), [ball]), camera).render(look())[200]
    radius = camera.focal_px * 0.4 / math.sqrt(distance**2 - 0.4**2)
    for share in (0.25, 0.5, 0.9):
        there = np.interp(199.5 + share * radius, np.arange(400), row)
        assert there == pytest.approx(share, abs=0.03)


BALL = [[2.0, 0.9, -0.5]] * 2
CAPSULES = {
    "aside": [[2.0, 0.9, -0.5], [2.4, 0.6, 0.1]],
    "reaching behind the camera": [[2.0, 0.3, -0.7], [-1.5, 0.9, 0.2]],
    "on its tip": [[0.7, 0.2, 0.1], [3.0, 0.25, 0.0]],
    "along the axis": [[0.8, 0.0, 0.0], [3.0, 0.0, 0.0]],
}


@pytest.mark.parametrize("ends", [BALL, *CAPSULES.values()], ids=["ball", *CAPSULES])
def test_a_round_body_covers_its_rays(ends):
    ends, radius = np.array(ends), 0.5
    camera = Camera((150, 200), 80.0)
    columns, rows = np.meshgrid(np.arange(200) + 0.5, np.arange(150) + 0.5)
    pose = look(roll=20, pitch=5, yaw=-10)
    rays = camera.rays(np.stack([columns, rows], -1), pose)
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    # Distance of a ray from the segment, least over points along the segment.
    gaps = []
    for point in np.linspace(ends[0], ends[1], 400):
        ahead = np.maximum(rays @ point, 0.0)
        gaps.append(np.linalg.norm(point - ahead[..., None] * rays, axis=-1))
    hit = np.min(gaps, axis=0) < radius
    body = Round("body", ends, radius, PLAIN[1.0])
    picture = Renderer(World(room(), [body]), camera).render(pose)
    assert 0.05 < hit.mean() < 0.95
    assert np.abs((picture > 0.5).astype(int) - hit).sum() < 0.004 * hit.sum() + 4


def test_a_round_body_is_textured_from_wherever_it_is_seen():
    """Also on its tip, where no plane along it could be."""
    squares = np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((16, 16)))
    body = Round("body", np.array([[0, 0, -0.6], [0, 0, 0.6]]), 0.3, Texture(squares))
    renderer = Renderer(World(room(0.5, (-3, -3, -3), (3, 3, 3)), [body]), CAMERA)
    for x, z in ((-1.5, 0), (-0.8, 1.5), (-0.29, 1.5), (0.0, 1.5), (-0.1, 0.95), (0.0, -2.0)):
        pitch = math.degrees(math.atan2(-z, -x))
        picture = renderer.render(look(x, 0, z, pitch=pitch))
        assert picture.min() < 0.01 and picture.max() > 0.99, (x, z)
        # Whichever way the camera looks.
        for away in (0, 90, 180, 270):
            assert np.isfinite(renderer.render(look(x, 0, z, pitch=pitch + away))).all()


def test_from_inside_a_ball_there_is_none():
    ball = Round("ball", np.array([[0.1, 0, 0]] * 2), 0.4, PLAIN[1.0])
    assert Renderer(World(room(0.25), [ball]), CAMERA).render(look()).max() == 0.25
    behind = Round("ball", np.array([[-2, 0, 0]] * 2), 0.4, PLAIN[1.0])
    assert Renderer(World(room(0.25), [behind]), CAMERA).render(look()).max() == 0.25
    capsule = Round("capsule", np.array([[0, -2, 0], [0, 2, 0]]), 0.4, PLAIN[1.0])
    assert Renderer(World(room(0.25), [capsule]), CAMERA).render(look()).max() == 0.25


def test_a_picture_is_made_of_numbers_whichever_way_the_camera_looks():
    """Also where the horizon of a wall goes exactly through the middles of pixels."""
    rng = np.random.default_rng(2)
    textures = [Texture(rng.random(size)) for size in ((1, 900), (700, 1), (40, 50)) * 2]
    textured = Solid("room", box_faces((-3, -3, -3), (3, 3, 3), textures, inside=True))
    renderer = Renderer(World(textured), Camera((36, 64), 170.0))
    turns = (-90, 0, 45, 90)
    for angles in itertools.product(turns, turns, turns):
        picture = renderer.render(look(0.3, -0.4, 0.2, *angles))
        assert picture.min() > -1e-6 and picture.max() < 1.0 + 1e-6, angles


def test_the_top_of_a_capsule_has_the_top_of_its_texture():
    texture = Texture(
        np.linspace(1.0, 0.0, 64, dtype=np.float32)[:, None] * np.ones((1, 16), np.float32)
    )
    body = Round("body", np.array([[2, 0, -0.3], [2, 0, 0.3]]), 0.2, texture)
    column = Renderer(World(room(), [body]), CAMERA).render(look())[:, 80]
    lit = np.flatnonzero(column > 0.05)
    assert (np.diff(column[lit[1] : lit[-1]]) < 0).all() and column[lit[2]] > 0.85


def test_near_things_are_clipped_and_not_turned_inside_out():
    wall = box((0.005, -1, -1), (0.2, 1, 1))
    picture = Renderer(World(room(0.25), [wall]), CAMERA).render(look())
    assert picture.max() == 0.25  # nearer than a lens could show
    beside = box((-1, 0.05, -1), (3, 0.5, 1))
    picture = Renderer(World(room(0.25), [beside]), CAMERA).render(look())
    assert (picture[60, :70] == 1.0).all() and (picture[60, 85:] == 0.25).all()


# The sensor


def exposed(level, shape=(200, 200), **how):
    camera = Camera(shape, 80.0)
    return Sensor(camera, **how).develop(np.full(shape, level, np.float32), 0)


def test_grey_levels_follow_gamma():
    assert (exposed(1.0) == 255).all() and (exposed(0.0) == 0).all() and (exposed(7.0) == 255).all()
    assert (exposed(0.5) == round(255 * 0.5 ** (1 / 2.2))).all()
    assert (exposed(0.5, gamma=1.0) == 128).all()


def test_noise_has_the_variance_that_was_asked_for():
    for level in (0.1, 0.4):
        frame = exposed(level, gamma=1.0, shot_noise=0.05, read_noise=0.02) / 255.0
        assert frame.mean() == pytest.approx(level, abs=1e-3)
        assert frame.var() == pytest.approx(0.05**2 * level + 0.02**2, rel=0.05)


def test_noise_is_normal_and_new_in_every_pixel():
    noise = exposed(0.5, (301, 203), gamma=1.0, read_noise=0.1) / 127.5 - 1.0
    noise /= 0.2
    assert (np.abs(noise) < 1.0).mean() == pytest.approx(0.683, abs=0.02)
    assert (np.abs(noise) < 2.0).mean() == pytest.approx(0.954, abs=0.01)
    assert 3.5 < np.abs(noise).max() < 4.4 and abs((noise**3).mean()) < 0.05
    for other in (np.roll(noise, shift, (0, 1)) for shift in ((0, 1), (1, 0), (0, 4), (3, 2))):
        assert abs((noise * other).mean()) < 0.015


def test_noise_is_the_same_again_and_new_in_every_frame():
    camera = Camera((50, 50), 80.0)
    frames = [
        Sensor(camera, read_noise=0.02, seed=seed).develop(
            np.full((50, 50), 0.5, np.float32), index
        )
        for seed, index in ((1, 0), (1, 0), (1, 1), (2, 0))
    ]
    assert (frames[0] == frames[1]).all()
    for one, other in itertools.combinations(frames[1:], 2):
        assert abs(np.corrcoef(one.ravel(), other.ravel())[0, 1]) < 0.1


def test_the_vignette_takes_its_share_from_the_corners():
    frame = exposed(0.8, (150, 200), gamma=1.0, vignette=0.5) / 255.0
    assert frame[75, 100] == pytest.approx(0.8, abs=0.005)
    assert frame[0, 0] == pytest.approx(0.4, abs=0.01)
    assert (frame == frame[::-1, ::-1]).all()
    assert (np.diff(frame[75, 100:]) <= 0).all()
