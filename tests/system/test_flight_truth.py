"""The truth of a flight agrees with closed forms, brute force and finite differences."""

import math
from dataclasses import asdict, fields

import bodies
import numpy as np
import pytest
from bodies import box
from flightscenes import accelerate, cruise, hover, stand, take_off, yaw
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.scenes.flights.camera import Camera
from dlgmd_cli.scenes.flights.drone import fly
from dlgmd_cli.scenes.flights.path import REACH_M, Stage, State
from dlgmd_cli.scenes.flights.solids import Capsule, Face, Solid, Texture, World
from dlgmd_cli.scenes.flights.truth import (
    FlightTruth,
    ImageSpeed,
    Nearest,
    Target,
    first_contact,
    truth_rows,
)

pytestmark = pytest.mark.slow

PLAIN = Texture([[0.5]])
CAMERA = Camera((90, 160), 80.0)
COLUMNS = (
    "frame,time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg,distance_m,time_to_contact_s,"
    "angular_size_deg,angular_velocity_deg_s,max_image_speed_px,phase"
)


def polygon(*corners):
    corners = np.array(corners, float)
    return Face(corners, PLAIN, corners[0], corners[1] - corners[0], corners[-1] - corners[0])


def ball(radius=0.3, at=(4, 0, 1), name="ball", motion=None):
    return bodies.ball(at, radius, name=name, motion=motion)


def pole(first, last, radius=0.1, name="pole", motion=None):
    return bodies.capsule(first, last, radius, name=name, motion=motion)


def board(x, side, name="board"):
    """A square that looks back along x, its middle at the height of the camera, 1 m."""
    return bodies.board(x, side, name=name, z=1.0)


ROOM = box((-20, -20, 0), (20, 20, 8), name="room", inwards=True)


def straight(speed=2.0, seconds=2.0, **options):
    options = {"position_m": (0, 0, 1), "jitter": 0.0, **options}
    return fly([cruise(seconds)], speed_m_s=speed, **options)


def turning():
    script = [accelerate(1.0, -12), yaw(1.0, 60)]
    return fly(script, position_m=(0, 0, 1), seed=4, speed_m_s=1.0)


def moving(t):
    return (-0.7 * t, 0.4 * math.sin(2 * t), 0.1 * t * t)


def truth(things, path, target, contact_s=None, *, fps=25, n_frames=20):
    stage = Stage(World(ROOM, things), path, target, contact_s, path.duration_s)
    return list(truth_rows(stage, CAMERA, fps, n_frames))


def first_row(things, target, path=None):
    return truth(things, path or straight(), target, n_frames=1)[0]


def still(position=(0, 0, 1), velocity=(0, 0, 0), angles=(0, 0, 0), spin=(0, 0, 0)):
    position, velocity, spin = (np.array(each, float) for each in (position, velocity, spin))
    return State(position, velocity, *angles, spin)


# Columns


def test_the_columns_are_those_of_the_file_in_their_order():
    assert ",".join(field.name for field in fields(FlightTruth)) == COLUMNS
    values = asdict(first_row([ball()], "ball")).values()
    assert all(type(value) in (int, float, str) for value in values)


def test_rows_are_where_the_path_is():
    path = fly([hover(0.4), accelerate(1, -10)], position_m=(1, 2, 3), yaw_deg=30, seed=1)
    for index, row in enumerate(truth([ball()], path, "ball", fps=20)):
        state = path.state(index / 20)
        assert (row.frame, row.time_s) == (index, index / 20)
        assert (row.x_m, row.y_m, row.z_m) == tuple(state.position_m)
        angles = state.roll_deg, state.pitch_deg, state.yaw_deg
        assert (row.roll_deg, row.pitch_deg, row.yaw_deg) == angles
        assert row.phase == ("hover" if index < 8 else "accelerate")


@pytest.mark.parametrize("contact_s", [14 / 25, math.nextafter(14 / 25, 0)])
def test_time_to_contact_runs_out_at_contact_and_is_unknown_after_it(contact_s):
    path = straight(contact_s=contact_s)
    rows = truth([board(3, 1)], path, "board", contact_s)
    left = [row.time_to_contact_s for row in rows]
    np.testing.assert_allclose(left[:15], (14 - np.arange(15)) / 25, atol=1e-12)
    assert left[14] == 0.0 and np.isnan(left[15:]).all()
    assert [row.phase for row in rows[13:16]] == ["cruise", "collision", "collision"]
    assert rows[14].angular_velocity_deg_s > 0, "at contact it is what it is just before"
    assert rows[15].angular_velocity_deg_s < 0
    assert math.isnan(first_row([ball()], "ball", path).time_to_contact_s)


def test_a_target_that_does_not_exist_is_refused():
    with pytest.raises(ParameterError) as error:
        first_row([ball()], "chair")
    assert str(error.value) == "the flight's target: nothing is named 'chair'."


# Distances


def test_distances_to_known_bodies():
    things = [board(4, 1), box((2, 0.5, 0), (3, 1, 0.25), name="box"), ball(0.3, (0, 2, 1))]
    things += [pole((5, -1, 0), (5, -1, 3), radius=0.2), ball(0.2, (0, -4, 1))]
    for name, distance in (
        ("board", 4.0),
        ("box", math.sqrt(4 + 0.25 + 0.75**2)),
        ("ball", 1.7),  # the nearer one of that name
        ("pole", math.sqrt(26) - 0.2),
    ):
        assert first_row(things, name).distance_m == pytest.approx(distance)


def test_inside_a_closed_body_there_is_no_distance():
    inside = fly([hover(1)], position_m=(2.5, 0.6, 0.1), jitter=0.0)
    for body in (box((2, 0.5, 0), (3, 1, 0.25), name="x"), ball(0.5, (2.4, 0.6, 0.1), "x")):
        row = first_row([body], "x", inside)
        assert (row.distance_m, row.angular_size_deg, row.angular_velocity_deg_s) == (0, 180, 0)
    slanted = Solid("x", [polygon((3, 0, 0), (4, 1, 0), (4, 1, 2), (3, 0, 2))])
    path = fly([hover(1)], position_m=(3.4, 0.6, 0.8), jitter=0.0)
    assert first_row([slanted], "x", path).distance_m == pytest.approx(0.2 / math.sqrt(2))


numbers = st.floats(-3, 3)


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(0, 1), min_size=3, max_size=6), st.integers(0, 99), st.tuples(*[numbers] * 3)
)
def test_distance_to_a_polygon_is_that_of_its_nearest_point(shares, seed, point):
    angles = np.cumsum(np.array(shares) + 0.1)
    angles *= math.tau / (angles[-1] + 0.1)
    tilt = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    flat = np.column_stack([2 * np.cos(angles), np.sin(angles), np.full(len(angles), 0.3)])
    corners, point = flat @ tilt, np.array(point)
    # With another of more corners, so that its last one is repeated.
    other = polygon(*[(50 + math.cos(a), math.sin(a), 50) for a in np.arange(7) * math.tau / 7])
    nearest = Nearest([Solid("a", [polygon(*corners)]), Solid("b", [other])])
    found = nearest.distances(point, 0.0)[0]
    assert found == pytest.approx(slow_distance(point, corners), abs=1e-9)


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


@pytest.mark.parametrize(
    ("things", "half"),
    [
        (
            [pole((2, -0.5, 1), (2, 0.5, 1))],
            math.atan(0.25) + math.asin(0.1 / math.hypot(2, 0.5)),
        ),
        ([board(4, 0.8, "pole")], math.atan(0.4 * math.sqrt(2) / 4)),  # the diagonal
        ([ball(0.3, name="pole")], math.asin(0.3 / 4)),
        ([pole((2, 0, 1), (3, 0, 1))], math.asin(0.1 / 2)),
        ([pole((3, 0, 1), (2, 0, 1))], math.asin(0.1 / 2)),
        (
            [ball(0.3, (4, 1, 1), "pole"), ball(0.3, (4, -1, 1), "pole")],
            math.atan(1 / 4) + math.asin(0.3 / math.sqrt(17)),
        ),
        ([ball(0.3, (-4, 0, 1), "pole")], math.asin(0.3 / 4)),  # behind the camera
        ([ball(1, (3, 0, 1), "pole"), ball(1, (-3, 0, 1), "pole")], math.pi / 2),
    ],
    ids=["capsule", "board", "ball", "on its tip", "reversed", "two balls", "behind", "all round"],
)
def test_bodies_of_one_name_span_one_angle(things, half):
    row = first_row(things, "pole")
    assert row.angular_size_deg == pytest.approx(math.degrees(2 * half))


def test_a_wall_is_as_far_and_as_large_as_its_rectangle():
    """And grows as a board of its size does, although the floor is nearer."""
    far = [face for face in ROOM.faces if face.corners_m[:, 0].min() == 20]
    stage = Stage(World(ROOM, []), straight(), "wall", None, 1.0, wall=Solid("wall", far))
    rows = list(truth_rows(stage, CAMERA, 25, 20))
    assert rows[0].distance_m == 20.0 and rows[-1].distance_m == pytest.approx(20 - 2 * 19 / 25)
    corners = np.array([(20, -20, 8), (20, 20, 0)]) - (0, 0, 1)
    corners = corners / np.linalg.norm(corners, axis=1)[:, None]
    angle = math.degrees(math.acos(corners[0] @ corners[1]))
    assert rows[0].angular_size_deg == pytest.approx(angle)
    sizes = [row.angular_size_deg for row in rows]
    rates = [row.angular_velocity_deg_s for row in rows]
    assert rates[1:-1] == pytest.approx(np.gradient(sizes, 1 / 25)[1:-1], rel=1e-3)


@pytest.mark.parametrize("motion", [None, moving], ids=["still", "moving"])
@pytest.mark.parametrize("kind", ["box", "ball", "capsule"])
def test_the_angle_changes_as_fast_as_finite_differences_say(kind, motion):
    body = {
        "box": box((3, -0.2, 0.5), (4, 1.2, 1.4), name="x", motion=motion),
        "ball": ball(0.4, (4, 0.5, 1.2), "x", motion),
        "capsule": pole((4, -1, 1), (5, 1, 1.5), radius=0.2, name="x", motion=motion),
    }[kind]
    path = turning()
    target, h = Target(Stage(World(ROOM, [body]), path, "x", None, 2.0)), 1e-5
    for t in np.random.default_rng(0).uniform(0.1, 1.9, 30):
        before, after = (target.seen_from(path.state(t + dt), t + dt)[1] for dt in (-h, h))
        rate = target.seen_from(path.state(t), t)[2]
        assert rate == pytest.approx((after - before) / (2 * h), abs=1e-4)


# Image speed


def fastest(things, state, target=None, time_s=0.0):
    return ImageSpeed(World(ROOM, things), CAMERA, target).fastest(state, time_s)


F = CAMERA.focal_px
OMEGA = math.radians(30)


@pytest.mark.parametrize(
    ("state", "expected"),
    [
        # The room's wall at x = 20 fills the image: its corners are fastest.
        (still((15, 0, 4), velocity=(2, 0, 0)), math.hypot(80, 45) * 2 / 5),
        # x' = f w (1 + x²/f²), y' = w x y / f.
        (
            still(spin=(0, 0, OMEGA)),
            math.hypot(F * OMEGA * (1 + (80 / F) ** 2), OMEGA * 80 * 45 / F),
        ),
        (still(spin=(OMEGA, 0, 0)), OMEGA * math.hypot(45, 80)),
        (still(), 0.0),
    ],
    ids=["forwards", "yaw", "roll", "at rest"],
)
def test_the_speed_of_a_room_is_that_of_its_closed_form(state, expected):
    things = [ball()] if expected == 0.0 else []
    assert fastest(things, state) == pytest.approx(expected, rel=1e-9)


def sideways(t):
    return (0, 2 * t, 0)


MOVED = box((4, -0.5, 0.5), (5, 0.5, 1.5), name="x", motion=sideways)
SMALL = box((4, 0.02, 1.01), (4.01, 0.025, 1.015), name="x", motion=sideways)


@pytest.mark.parametrize(
    ("things", "expected"),
    [
        # Its nearest point, at 3.7 m, is nearly the fastest: all of it moves alike.
        ([ball(0.3, (4, 0, 1), "x", sideways)], F * 2 / 3.7),
        ([ball(0.3, (-4, 0, 1), "x", sideways)], 0.0),
        ([MOVED], F * 2 / 4),
        ([MOVED, board(3, 4)], 0.0),
        ([MOVED, ball(1, (2, 0, 1))], 0.0),
        ([MOVED, pole((2, 0, -5), (2, 0, 7), radius=0.9)], 0.0),
        ([ball(0.004, (4, 0.021, 1.013), "x", sideways)], F * 2 / 4),  # between the grid's lines
        ([SMALL], F * 2 / 4),
        ([box((4, 5, 0.5), (5, 6, 1.5), name="x", motion=sideways)], 0.0),
    ],
    ids=["ball", "behind", "box", "board", "a ball before", "pole", "tiny", "small", "beside"],
)
def test_what_is_hidden_or_beside_the_picture_does_not_count(things, expected):
    assert fastest(things, still(), "x") == pytest.approx(expected, rel=2e-3)


def slow_depth(body, eye, ray):
    """By marching along a ray, or by the planes of the faces."""
    if isinstance(body, Capsule):
        steps = np.arange(0.01, 12, 0.0005)
        points = eye + steps[:, None] * ray
        axis = body.ends_m[1] - body.ends_m[0]
        along = np.clip((points - body.ends_m[0]) @ axis / max(axis @ axis, 1e-12), 0, 1)
        gaps = np.linalg.norm(points - body.ends_m[0] - along[:, None] * axis, axis=-1)
        inside = np.flatnonzero(gaps <= body.radius_m)
        return steps[inside[0]] if len(inside) else math.inf
    depths = [math.inf]
    for face in body.faces:
        if ray @ face.normal >= 0:
            continue
        depth = (face.corners_m[0] - eye) @ face.normal / (ray @ face.normal)
        if depth > 0 and slow_distance(eye + depth * ray, face.corners_m) < 1e-9:
            depths.append(depth)
    return min(depths)


# One reaches from behind the camera across its plane.
ACROSS = [(1, 0.5, 0.8), (-5, -1.5, 0.8), (-5, -1.5, 1.4), (1, 0.5, 1.4)]
BODIES = [
    box((3, -1.2, 0), (4, -0.3, 1.2), name="a", motion=moving),
    Solid("across", [polygon(*ACROSS), polygon(*ACROSS[::-1])]),
    pole((3, -1, 0.5), (4, 1, 1.5), radius=0.25, motion=moving),
    ball(0.35, (5, 0.8, 1.3), motion=moving),
    board(6, 3),
]


def test_each_line_of_sight_meets_what_brute_force_says():
    lines = ImageSpeed(World(ROOM, BODIES), CAMERA)
    pose, offsets = still(angles=(5, -8, 12)).pose, lines.surfaces.offsets(0.4)
    closeness, body = lines.cast(lines.grid, pose, offsets)
    assert set(body) == {0, 1, 2, 3, 4, 5}
    for index in range(0, len(lines.grid), 61):
        ray = lines.grid[index] @ pose.camera_from_world
        depths = [
            slow_depth(each, pose.position_m - offset, ray)
            for each, offset in zip([*BODIES, ROOM], offsets, strict=True)
        ]
        assert 1 / closeness[index] == pytest.approx(min(depths), abs=6e-4)
        assert body[index] == np.argmin(depths)


@pytest.mark.parametrize("time_s", [0.35, 1.7])
def test_the_fastest_point_is_that_of_finite_differences(time_s):
    """Every point that a line of sight meets, projected a little before and after."""
    path, h = turning(), 1e-5
    lines = ImageSpeed(World(ROOM, BODIES), CAMERA)
    pose, offsets = path.pose(time_s), lines.surfaces.offsets
    closeness, body = lines.cast(lines.grid, pose, offsets(time_s))
    points = pose.position_m + lines.grid @ pose.camera_from_world / closeness[:, None]
    before, after = (
        bodies.project(
            CAMERA, points + (offsets(time_s + dt) - offsets(time_s))[body], path.pose(time_s + dt)
        )
        for dt in (-h, h)
    )
    expected = np.linalg.norm((after - before) / (2 * h), axis=-1).max()
    assert lines.fastest(path.state(time_s), time_s) == pytest.approx(expected, rel=1e-4)


# Contact


@pytest.mark.parametrize(
    "body",
    [board(3, 1), ball(0.3, (3.3, 0, 1)), box((3, -1, 0), (4, 1, 2), name="box")],
    ids=lambda body: body.name,
)
def test_contact_is_when_the_nearest_point_is_within_reach(body):
    path, world = straight(1.3, 3.0), World(ROOM, [body])
    found = first_contact(path, world)
    assert found == pytest.approx((3 - REACH_M) / 1.3, abs=1e-3)
    assert math.dist(path.state(found).position_m, (3, 0, 1)) == pytest.approx(REACH_M, abs=1e-6)
    hit = straight(1.3, 3.0, contact_s=found)
    assert first_contact(hit, world) == pytest.approx(found, abs=1e-9)
    assert first_contact(straight(1.3, 2.2), world) is None


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (ball(0.1, (6, 0, 1), motion=lambda t: (-12.0 * max(t - 1, 0), 0, 0)), 1 + 5.8 / 12),
        (ball(0.01, (3, 0, 1), motion=lambda t: (-40.0 * t, 0, 0)), 2.89 / 40),
        # What is near at first counts once it has been away.
        (
            ball(0.1, (0.15, 0, 1), motion=lambda t: (0.3 * math.sin(t), 0, 0)),
            math.pi - math.asin(0.05 / 0.3),
        ),
    ],
    ids=["late", "swift", "near"],
)
def test_a_body_can_come_to_the_drone(body, expected):
    path = fly([hover(4)], position_m=(0, 0, 1), jitter=0.0)
    assert first_contact(path, World(ROOM, [body])) == pytest.approx(expected, abs=1e-3)


def test_the_floor_it_stands_on_is_no_contact_and_a_ceiling_is():
    path = fly([stand(0.5), take_off(3, 2)], position_m=(0, 0, 0.05))
    assert first_contact(path, World(ROOM)) is None
    found = first_contact(path, World(box((-5, -5, 0), (5, 5, 1.5), name="room", inwards=True)))
    assert path.state(found).position_m[2] == pytest.approx(1.5 - REACH_M, abs=1e-6)
