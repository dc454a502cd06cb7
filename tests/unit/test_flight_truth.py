"""The truth of a flight agrees with closed forms, brute force and finite differences."""

import csv
import math
from dataclasses import asdict, fields

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.flights.drone import fly
from dlgmd_cli.flights.geometry import Nearest, first_contact, surroundings
from dlgmd_cli.flights.image_speed import ImageSpeed
from dlgmd_cli.flights.path import REACH_M, Stage, State
from dlgmd_cli.flights.renderer.camera import Camera
from dlgmd_cli.flights.renderer.solids import Face, Round, Solid, World, quad
from dlgmd_cli.flights.renderer.texture import Texture
from dlgmd_cli.flights.script import accelerate, cruise, hover, stand, take_off, yaw
from dlgmd_cli.flights.truth import FlightTruth, Target, truth_rows

PLAIN = Texture([[0.5]])
CAMERA = Camera((90, 160), 80.0)
COLUMNS = (
    "frame,time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,distance_m,time_to_contact_s,"
    "angular_size_deg,angular_velocity_deg_s,max_image_speed_px,phase"
)


def polygon(*corners):
    corners = np.array(corners, float)
    return Face(corners, PLAIN, corners[0], corners[1] - corners[0], corners[-1] - corners[0])


def box(name, low, high, *, inwards=False, motion=None):
    low, high, faces = np.array(low, float), np.array(high, float), []
    for axis in range(3):
        u, v = (np.eye(3)[(axis + i) % 3] * (high - low) for i in (1, 2))
        for is_high in (False, True):
            corner = low.copy()
            corner[axis] = (low, high)[is_high][axis]
            around = [corner, corner + u, corner + u + v, corner + v]
            faces.append(polygon(*(around if is_high != inwards else around[::-1])))
    return Solid(name, faces, motion)


def ball(radius=0.3, at=(4, 0, 1), name="ball", motion=None):
    return Round(name, np.array([at, at], float), radius, PLAIN, motion=motion)


def board(x, side, name="board", motion=None):
    """A square that looks back along x, its middle at the height of the camera, 1 m."""
    face = quad((x, side / 2, 1 + side / 2), (0, -side, 0), (0, 0, -side), PLAIN)
    return Solid(name, [face], motion)


ROOM = box("room", (-20, -20, 0), (20, 20, 8), inwards=True)


def straight(speed=2.0, seconds=2.0, **options):
    options = {"position_m": (0, 0, 1), "jitter": 0.0, **options}
    return fly([cruise(seconds)], speed_m_s=speed, **options)


def truth(bodies, path, target, contact_s=None, *, camera=CAMERA, fps=25, n_frames=20):
    stage = Stage(World(ROOM, bodies), path, target, contact_s, path.duration_s)
    return list(truth_rows(stage, camera, fps, n_frames))


def still(position=(0, 0, 1), velocity=(0, 0, 0), angles=(0, 0, 0), spin=(0, 0, 0)):
    position, velocity, spin = (np.array(each, float) for each in (position, velocity, spin))
    return State(position, velocity, *angles, spin)


# Columns


def test_the_columns_are_those_of_the_file_in_their_order():
    assert ",".join(field.name for field in fields(FlightTruth)) == COLUMNS
    (row,) = truth([ball()], straight(), "ball", n_frames=1)
    values = asdict(row)
    assert all(type(value) in (int, float, str) for value in values.values())
    assert next(csv.reader([",".join(map(str, values.values()))]))[-1] == "cruise"


def test_rows_are_where_the_path_is():
    path = fly([hover(0.4), accelerate(1, -10)], position_m=(1, 2, 3), yaw_deg=30, seed=1)
    rows = truth([ball()], path, "ball", fps=20)
    assert [row.frame for row in rows] == list(range(20))
    for row in rows:
        state = path.state(row.frame / 20)
        assert row.time_s == row.frame / 20
        assert (row.x_m, row.y_m, row.z_m) == tuple(state.position_m)
        assert (row.roll_deg, row.pitch_deg, row.yaw_deg) == (
            *(state.roll_deg, state.pitch_deg),
            state.yaw_deg,
        )
        assert row.phase == ("hover" if row.frame < 8 else "accelerate")


def test_time_to_contact_runs_out_at_contact_and_is_unknown_after_it():
    path = straight(contact_s=14 / 25)
    rows = truth([board(3, 1)], path, "board", 14 / 25)
    left = [row.time_to_contact_s for row in rows]
    np.testing.assert_allclose(left[:15], (14 - np.arange(15)) / 25, atol=1e-12)
    assert left[14] == 0.0
    assert np.isnan(left[15:]).all()
    assert [row.phase for row in rows[13:16]] == ["cruise", "collision", "collision"]
    assert rows[14].angular_velocity_deg_s > 0, "at contact it is what it is just before"
    assert rows[15].angular_velocity_deg_s < 0
    assert all(math.isnan(row.time_to_contact_s) for row in truth([ball()], path, "ball"))


def test_contact_is_at_a_frame_although_its_time_is_rounded():
    contact_s = math.nextafter(14 / 25, 0)
    path = straight(contact_s=contact_s)
    row = truth([board(3, 1)], path, "board", contact_s)[14]
    assert (row.time_to_contact_s, row.phase) == (0.0, "collision")
    assert row.angular_velocity_deg_s > 0


# Distances


def test_distances_to_known_bodies():
    path = straight()
    bodies = [board(4, 1), box("box", (2, 0.5, 0), (3, 1, 0.25)), ball(0.3, (0, 2, 1))]
    capsule = Round("capsule", np.array([[5, -1, 0], [5, -1, 3.0]]), 0.2, PLAIN)
    all_of_them = [*bodies, capsule]
    for name, distance in (
        ("board", 4.0),
        ("box", math.sqrt(4 + 0.25 + 0.75**2)),
        ("ball", 1.7),
        ("capsule", math.sqrt(26) - 0.2),
        ("room", 1.0),
    ):
        assert truth(all_of_them, path, name, n_frames=1)[0].distance_m == pytest.approx(distance)


def test_bodies_of_one_name_are_one_target():
    rows = truth([ball(0.3, (4, 0, 1)), ball(0.2, (3, 0, 1))], straight(), "ball", n_frames=1)
    assert rows[0].distance_m == pytest.approx(2.8)
    wide = truth([ball(0.3, (4, 1, 1)), ball(0.3, (4, -1, 1))], straight(), "ball", n_frames=1)
    half = math.atan(1 / 4) + math.asin(0.3 / math.sqrt(17))
    assert wide[0].angular_size_deg == pytest.approx(math.degrees(2 * half))


def test_inside_a_body_there_is_no_distance():
    inside = fly([hover(1)], position_m=(2.5, 0.6, 0.1), jitter=0.0)
    for body in (box("x", (2, 0.5, 0), (3, 1, 0.25)), ball(0.5, (2.4, 0.6, 0.1), "x")):
        row = truth([body], inside, "x", n_frames=1)[0]
        assert (row.distance_m, row.angular_size_deg, row.angular_velocity_deg_s) == (0, 180, 0)


def test_only_closed_bodies_have_an_inside():
    slanted = Solid("x", [polygon((3, 0, 0), (4, 1, 0), (4, 1, 2), (3, 0, 2))])
    without_a_bottom = [f for f in box("x", (3, 0, 1), (4, 1, 2)).faces if f.normal[2] >= 0]
    path = fly([hover(1)], position_m=(3.4, 0.6, 0.8), jitter=0.0)
    row = truth([slanted], path, "x", n_frames=1)[0]
    assert row.distance_m == pytest.approx(0.2 / math.sqrt(2))
    row = truth([Solid("x", without_a_bottom)], path, "x", n_frames=1)[0]
    assert row.distance_m == pytest.approx(math.hypot(0.2, 0.4))


numbers = st.floats(-3, 3)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.tuples(numbers, numbers), min_size=3, max_size=6), numbers, st.data())
def test_distance_to_a_polygon_is_that_of_its_nearest_point(flat, turn, data):
    hull = convex(flat)
    if hull is None:
        return
    tilt = np.linalg.qr(np.random.default_rng(abs(int(turn * 1e3))).normal(size=(3, 3)))[0]
    corners = np.column_stack([hull, np.full(len(hull), turn)]) @ tilt
    point = np.array([data.draw(numbers) for _ in range(3)])
    # With another of more corners, so that its last one is repeated.
    other = polygon(*[(50 + math.cos(a), math.sin(a), 50) for a in np.arange(7) * math.tau / 7])
    bodies = [Solid("a", [polygon(*corners)]), Solid("b", [other])]
    found = Nearest(bodies).distances(point, 0.0)[0]
    weights = np.random.default_rng(0).dirichlet(np.full(len(corners), 0.4), 4000)
    tried = np.linalg.norm(weights @ corners - point, axis=-1).min()
    assert found <= tried + 1e-9
    assert found == pytest.approx(slow_distance(point, corners), abs=1e-9)


def convex(points):
    """Corners of the convex hull, counter-clockwise, or None if it is too thin."""
    points = sorted(set(points))
    chains = []
    for ordered in (points, points[::-1]):
        chain = []
        for p in ordered:
            while len(chain) > 1 and turn_of(chain[-2], chain[-1], p) <= 1e-3:
                chain.pop()
            chain.append(p)
        chains.extend(chain[:-1])
    return np.array(chains) if len(chains) > 2 else None


def turn_of(a, b, c):
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def slow_distance(point, corners):
    """Of the plane if its foot is inside the polygon, else of the nearest edge."""
    normal = np.cross(corners[1] - corners[0], corners[2] - corners[0])
    normal /= np.linalg.norm(normal)
    height = (point - corners[0]) @ normal
    foot = point - height * normal
    edges = list(zip(corners, np.roll(corners, -1, axis=0), strict=True))
    if all(np.cross(b - a, foot - a) @ normal >= 0 for a, b in edges):
        return abs(height)
    to_edges = []
    for a, b in edges:
        along = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        to_edges.append(np.linalg.norm(point - a - along * (b - a)))
    return min(to_edges)


# Angular size


def test_a_board_approached_head_on_spans_twice_an_arctangent():
    side, speed = 0.8, 2.0
    path = straight(speed)
    for row in truth([board(4, side)], path, "board", n_frames=40):
        # The diagonal is the widest.
        d, half = 4 - speed * row.time_s, side / math.sqrt(2)
        assert row.distance_m == pytest.approx(d, abs=1e-3)
        assert row.angular_size_deg == pytest.approx(
            math.degrees(2 * math.atan(half / row.distance_m)), abs=2e-3
        )
        rate = 2 * half * speed / (row.distance_m**2 + half**2)
        assert row.angular_velocity_deg_s == pytest.approx(math.degrees(rate), rel=2e-3)


def test_a_ball_spans_twice_an_arcsine():
    radius, speed = 0.3, 1.5
    for row in truth([ball(radius)], straight(speed), "ball", n_frames=40):
        centre = math.dist((row.x_m, row.y_m, row.z_m), (4, 0, 1))
        assert row.angular_size_deg == pytest.approx(
            math.degrees(2 * math.asin(radius / centre)), rel=1e-9
        )
        rate = 2 * radius * speed / (centre * math.sqrt(centre**2 - radius**2))
        assert row.angular_velocity_deg_s == pytest.approx(math.degrees(rate), rel=2e-3)


def test_a_capsule_spans_its_ends_and_their_halves():
    capsule = Round("pole", np.array([[2, -0.5, 1], [2, 0.5, 1.0]]), 0.1, PLAIN)
    row = truth([capsule], straight(), "pole", n_frames=1)[0]
    half = math.atan(0.5 / 2) + math.asin(0.1 / math.hypot(2, 0.5))
    assert row.angular_size_deg == pytest.approx(math.degrees(2 * half))
    for ends in ([[2, 0, 1], [3, 0, 1.0]], [[3, 0, 1], [2, 0, 1.0]]):
        end_on = Round("pole", np.array(ends), 0.1, PLAIN)
        row = truth([end_on], straight(), "pole", n_frames=1)[0]
        assert row.angular_size_deg == pytest.approx(math.degrees(2 * math.asin(0.1 / 2)))


def test_what_is_behind_or_all_round_counts_too():
    behind = truth([ball(0.3, (-4, 0, 1))], straight(), "ball", n_frames=1)[0]
    assert behind.angular_size_deg == pytest.approx(math.degrees(2 * math.asin(0.3 / 4)))
    assert behind.angular_velocity_deg_s < 0
    around = [ball(1, (3, 0, 1)), ball(1, (-3, 0, 1))]
    row = truth(around, straight(), "ball", n_frames=1)[0]
    assert (row.angular_size_deg, row.angular_velocity_deg_s) == (180, 0)
    row = truth([], straight(), "room", n_frames=1)[0]
    assert (row.angular_size_deg, row.angular_velocity_deg_s) == (180, 0)


def moving(t):
    return (-0.7 * t, 0.4 * math.sin(2 * t), 0.1 * t * t)


@pytest.mark.parametrize("motion", [None, moving], ids=["still", "moving"])
@pytest.mark.parametrize(
    "body",
    [
        lambda motion: box("x", (3, -0.2, 0.5), (4, 1.2, 1.4), motion=motion),
        lambda motion: ball(0.4, (4, 0.5, 1.2), "x", motion),
        lambda motion: Round("x", np.array([[4, -1, 1], [5, 1, 1.5]]), 0.2, PLAIN, motion=motion),
    ],
    ids=["box", "ball", "capsule"],
)
def test_the_angle_changes_as_fast_as_finite_differences_say(body, motion):
    path = fly(
        [accelerate(1.0, -12), yaw(1.0, 60)],
        position_m=(0, 0, 1),
        seed=4,
        speed_m_s=1.0,
    )
    target, h = Target(Stage(World(ROOM, [body(motion)]), path, "x", None, 2.0)), 1e-5
    for t in np.random.default_rng(0).uniform(0.1, 1.9, 60):
        before, after = (target.seen_from(path.state(t + dt), t + dt)[1] for dt in (-h, h))
        rate = target.seen_from(path.state(t), t)[2]
        assert rate == pytest.approx((after - before) / (2 * h), abs=1e-4)


def test_turning_on_the_spot_changes_no_angle():
    path = fly([yaw(1, 90)], position_m=(0, 0, 1), jitter=0.0)
    for row in truth([board(4, 1)], path, "board"):
        assert row.angular_velocity_deg_s == pytest.approx(0, abs=1e-9)


def test_a_target_that_is_not_there_is_refused():
    with pytest.raises(ParameterError) as error:
        truth([ball()], straight(), "chair")
    assert str(error.value) == "the flight's target: nothing is named 'chair'."


# Image speed


def fastest(world, camera, state, time_s, target=None):
    return ImageSpeed(world, camera, target).fastest(state, time_s)


def test_head_on_to_a_wall_the_corners_are_fastest():
    # The room's wall at x = 20 fills the picture.
    state = still((15, 0, 4), velocity=(2, 0, 0))
    height, width = CAMERA.shape
    corner = math.hypot(width / 2, height / 2)
    found = fastest(World(ROOM), Camera((90, 160), 60.0), state, 0.0)
    assert found == pytest.approx(corner * 2 / 5, rel=1e-9)


def test_pure_yaw_sweeps_the_rim_fastest():
    omega = math.radians(30)
    found = fastest(World(ROOM), CAMERA, still(spin=(0, 0, omega)), 0.0)
    f = CAMERA.focal_px
    height, width = (side / 2 for side in CAMERA.shape)
    # x' = f w (1 + x²/f²), y' = w x y / f.
    assert found == pytest.approx(
        math.hypot(f * omega * (1 + (width / f) ** 2), omega * width * height / f), rel=1e-9
    )


def test_pure_roll_turns_the_corners_about_the_middle():
    spin = (math.radians(50), 0, 0)
    found = fastest(World(ROOM), CAMERA, still(spin=spin), 0.0)
    assert found == pytest.approx(math.radians(50) * math.hypot(45, 80), rel=1e-9)


def test_at_rest_nothing_moves_but_bodies_that_do():
    state = still()
    assert fastest(World(ROOM, [ball()]), CAMERA, state, 0.3) == 0.0
    moved = ball(0.3, (4, 0, 1), motion=lambda t: (0, 1.5 * t, 0))
    # Its nearest point, at 3.7 m, is nearly the fastest: all of it moves alike.
    found = fastest(World(ROOM, [moved]), CAMERA, state, 0.0, "ball")
    assert found == pytest.approx(CAMERA.focal_px * 1.5 / 3.7, rel=1e-6)
    behind = ball(0.3, (-4, 0, 1), motion=lambda t: (0, 1.5 * t, 0))
    assert fastest(World(ROOM, [behind]), CAMERA, state, 0.0, "ball") == 0.0


def test_what_is_hidden_does_not_count():
    state = still()
    moved = box("box", (4, -0.5, 0.5), (5, 0.5, 1.5), motion=lambda t: (0, 2 * t, 0))
    shown = fastest(World(ROOM, [moved]), CAMERA, state, 0.0, "box")
    assert shown == pytest.approx(CAMERA.focal_px * 2 / 4, rel=1e-6)
    assert fastest(World(ROOM, [moved, board(3, 4)]), CAMERA, state, 0.0, "box") == 0.0
    assert fastest(World(ROOM, [moved, ball(1, (2, 0, 1))]), CAMERA, state, 0.0) == 0.0
    pole = Round("pole", np.array([[2, 0, -5], [2, 0, 7.0]]), 0.9, PLAIN)
    assert fastest(World(ROOM, [moved, pole]), CAMERA, state, 0.0, "box") == 0.0


def test_a_small_target_is_found_between_the_lines():
    tiny = ball(0.004, (4, 0.021, 1.013), motion=lambda t: (0, 3 * t, 0))
    assert fastest(World(ROOM, [tiny]), CAMERA, still(), 0.0) == 0.0
    found = fastest(World(ROOM, [tiny]), CAMERA, still(), 0.0, "ball")
    assert found == pytest.approx(CAMERA.focal_px * 3 / 4, rel=2e-3)
    small = box("box", (4, 0.02, 1.01), (4.01, 0.025, 1.015), motion=lambda t: (0, 3 * t, 0))
    for angles in np.random.default_rng(0).uniform(-1, 1, (20, 3)):
        found = fastest(World(ROOM, [small]), CAMERA, still(angles=angles), 0.0, "box")
        assert found == pytest.approx(CAMERA.focal_px * 3 / 4, rel=2e-3)


def test_a_target_beside_the_picture_does_not_count():
    aside = box("box", (4, 5, 0.5), (5, 6, 1.5), motion=lambda t: (0, 0, 2 * t))
    assert fastest(World(ROOM, [aside]), CAMERA, still(), 0.0, "box") == 0.0
    turned = still(angles=(0, 0, 50))
    assert fastest(World(ROOM, [aside]), CAMERA, turned, 0.0, "box") > 10.0


def test_a_body_beside_the_camera_hides_what_it_should():
    # Its near end is behind the camera, so that its corners have no place in the picture.
    wall = box("wall", (-2, 0.2, 0), (3, 0.4, 3))
    state = still(velocity=(1, 0, 0))
    found = fastest(World(ROOM, [wall]), CAMERA, state, 0.0)
    # At the left edge the wall is as near as it gets in the picture; the speed of a point at
    # x = X / Z on it is f x / Z, and its depth 0.2 / x.
    x = math.tan(math.radians(40))
    height = CAMERA.shape[0] / CAMERA.shape[1] * x
    assert found == pytest.approx(CAMERA.focal_px * math.hypot(x, height) * x / 0.2, rel=1e-9)


def slow_fastest(world, camera, path, time_s):
    """By marching along lines of sight and projecting what is found a little before and after."""
    pose, h = path.pose(time_s), 1e-5
    height, width = camera.shape
    x, y = np.meshgrid(np.linspace(0, width, 65), np.linspace(0, height, 37))
    best = 0.0
    for ray in camera.rays(np.stack([x.ravel(), y.ravel()], -1), pose)[::13]:
        near, owner = math.inf, None
        for body in [*world.bodies, world.room]:
            offset = np.zeros(3) if body.motion is None else np.array(body.motion(time_s))
            depth = slow_depth(body, pose.position_m - offset, ray)
            if depth < near:
                near, owner = depth, body
        point = pose.position_m + near * ray
        places = []
        for dt in (-h, h):
            moved = point
            if owner.motion is not None:
                step = np.array(owner.motion(time_s + dt)) - np.array(owner.motion(time_s))
                moved = point + step
            places.append(camera.project(moved, path.pose(time_s + dt)))
        best = max(best, np.linalg.norm(places[1] - places[0]) / (2 * h))
    return best


def slow_depth(body, eye, ray):
    depths = [math.inf]
    if isinstance(body, Round):
        steps = np.arange(0.01, 12, 0.0005)
        points = eye + steps[:, None] * ray
        axis = body.ends_m[1] - body.ends_m[0]
        along = np.clip((points - body.ends_m[0]) @ axis / max(axis @ axis, 1e-12), 0, 1)
        gaps = np.linalg.norm(points - body.ends_m[0] - along[:, None] * axis, axis=-1)
        inside = np.flatnonzero(gaps <= body.radius_m)
        return steps[inside[0]] if len(inside) else math.inf
    for face in body.faces:
        if ray @ face.normal >= 0:
            continue
        depth = (face.corners_m[0] - eye) @ face.normal / (ray @ face.normal)
        if depth > 0 and slow_distance(eye + depth * ray, face.corners_m) < 1e-9:
            depths.append(depth)
    return min(depths)


@pytest.mark.parametrize("time_s", [0.35, 1.2, 1.7])
def test_the_fastest_point_is_that_of_brute_force(time_s, monkeypatch):
    path = fly(
        [accelerate(1.0, -12), yaw(1.0, 60)],
        position_m=(0, 0, 1),
        seed=4,
        speed_m_s=1.0,
    )
    world = World(
        ROOM,
        [
            box("a", (5, -1.2, 0), (6, -0.3, 1.2), motion=moving),
            box("b", (-1, 1.2, 0), (4, 1.6, 2)),
            ball(0.35, (5, 0.8, 1.3), motion=moving),
            Round("c", np.array([[6, -2, 0.5], [6, 2, 2.5]]), 0.15, PLAIN, motion=moving),
        ],
    )
    # Every thirteenth line of sight of both.
    sparse = ImageSpeed.cast

    def cast(self, rays, pose, offsets_m):
        near, body = sparse(self, rays, pose, offsets_m)
        keep = np.arange(len(rays)) % 13 == 0
        return np.where(keep, near, 0.0), body

    monkeypatch.setattr(ImageSpeed, "cast", cast)
    found = fastest(world, CAMERA, path.state(time_s), time_s)
    assert found == pytest.approx(slow_fastest(world, CAMERA, path, time_s), rel=2e-3)


def test_each_line_of_sight_meets_what_brute_force_says():
    # One that reaches from behind the camera across its plane.
    across = [(1, 0.5, 0.8), (-5, -1.5, 0.8), (-5, -1.5, 1.4), (1, 0.5, 1.4)]
    bodies = [
        box("a", (3, -1.2, 0), (4, -0.3, 1.2), motion=moving),
        Solid("across", [polygon(*across), polygon(*across[::-1])]),
        Round("c", np.array([[3, -1, 0.5], [4, 1, 1.5]]), 0.25, PLAIN, motion=moving),
        board(6, 3),
    ]
    lines = ImageSpeed(World(ROOM, bodies), CAMERA)
    pose, offsets = still(angles=(5, -8, 12)).pose, lines.surfaces.offsets(0.4)
    closeness, body = lines.cast(lines.grid, pose, offsets)
    assert set(body) == {0, 1, 2, 3, 4}
    for index in range(0, len(lines.grid), 23):
        ray = lines.grid[index] @ pose.camera_from_world
        depths = [
            slow_depth(each, pose.position_m - offset, ray)
            for each, offset in zip([*bodies, ROOM], offsets, strict=True)
        ]
        assert 1 / closeness[index] == pytest.approx(min(depths), abs=6e-4)
        assert body[index] == np.argmin(depths)


def test_speeds_of_rows_are_per_frame_and_follow_the_target():
    path = straight()
    bodies = [board(4, 1)]
    (row,) = truth(bodies, path, "board", fps=25, n_frames=1)
    state = path.state(0.0)
    expected = fastest(World(ROOM, bodies), CAMERA, state, 0.0, "board") / 25
    assert row.max_image_speed_px == expected


# Contact


@pytest.mark.parametrize(
    "body",
    [board(3, 1), ball(0.3, (3.3, 0, 1)), box("box", (3, -1, 0), (4, 1, 2))],
    ids=lambda body: body.name,
)
def test_contact_is_when_the_nearest_point_is_within_reach(body):
    path = straight(1.3, 3.0)
    found = first_contact(path, World(ROOM, [body]))
    assert found == pytest.approx((3 - REACH_M) / 1.3, abs=1e-3)
    assert math.dist(path.state(found).position_m, (3, 0, 1)) == pytest.approx(REACH_M, abs=1e-6)
    hit = fly([cruise(3)], position_m=(0, 0, 1), jitter=0, speed_m_s=1.3, contact_s=found)
    assert first_contact(hit, World(ROOM, [body])) == pytest.approx(found, abs=1e-9)
    assert first_contact(straight(1.3, 2.2), World(ROOM, [body])) is None


def test_only_the_names_that_are_asked_for_count():
    world = World(ROOM, [board(2, 1, "poster"), board(3, 1)])
    path = straight(2.0, 3.0)
    assert first_contact(path, world) == pytest.approx(0.95, abs=1e-3)
    assert first_contact(path, world, ["board"]) == pytest.approx(1.45, abs=1e-3)
    assert first_contact(path, world, ["room"]) is None
    assert first_contact(path, world, []) is None
    assert first_contact(straight(10.0, 3.0), world, ["room"]) == pytest.approx(1.99, abs=0.01)


def test_a_body_can_come_to_the_drone():
    path = fly([hover(3)], position_m=(0, 0, 1), jitter=0.0)
    swift = ball(0.1, (6, 0, 1), motion=lambda t: (-12.0 * max(t - 1, 0), 0, 0))
    assert first_contact(path, World(ROOM, [swift])) == pytest.approx(1 + 5.8 / 12, abs=1e-3)
    bullet = ball(0.01, (3, 0, 1), motion=lambda t: (-40.0 * t, 0, 0))
    assert first_contact(path, World(ROOM, [bullet])) == pytest.approx(2.89 / 40, abs=1e-4)


def test_what_is_near_at_first_counts_once_it_has_been_away():
    path = fly([hover(4)], position_m=(0, 0, 1), jitter=0.0)
    near = ball(0.1, (0.15, 0, 1), motion=lambda t: (0.3 * math.sin(t), 0, 0))
    found = first_contact(path, World(ROOM, [near]))
    assert found == pytest.approx(math.pi - math.asin(0.05 / 0.3), abs=1e-4)


def test_the_floor_it_stands_on_is_no_contact_and_a_ceiling_is():
    path = fly([stand(0.5), take_off(3, 2)], position_m=(0, 0, 0.05))
    assert first_contact(path, World(ROOM)) is None
    low = box("room", (-5, -5, 0), (5, 5, 1.5), inwards=True)
    found = first_contact(path, World(low))
    assert path.state(found).position_m[2] == pytest.approx(1.5 - REACH_M, abs=1e-6)
    away = path.moved([0, 0, 0.2])
    assert first_contact(away, World(ROOM)) is None


def clearance(path, world, time_s):
    position = path.state(time_s).position_m
    return surroundings(world).distances(position, time_s).min()


def test_clearance_is_from_the_nearest_surface():
    path = straight(2.0)
    world = World(ROOM, [board(4, 1), ball(0.3, (0, 1, 1))])
    assert clearance(path, world, 0.0) == pytest.approx(0.7)
    assert clearance(path, World(ROOM), 0.0) == pytest.approx(1.0), "the floor"
    assert clearance(path, world, 1.6) == pytest.approx(0.8, abs=1e-3)
    outside = path.moved([0, 0, 7.5])
    assert clearance(outside, world, 0.0) == pytest.approx(-0.5)
