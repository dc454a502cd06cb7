"""Rooms and furniture of rendered flights: what they look like, and that they can be painted."""

import hashlib
from collections import Counter
from functools import lru_cache

import cv2
import numpy as np
import pytest
from bodies import are_apart

from dlgmd_cli.scenes.flights import rooms, textures
from dlgmd_cli.scenes.flights.furniture import block, catalogue, furniture, placement
from dlgmd_cli.scenes.flights.solids import Capsule, Solid, Texture

pytestmark = pytest.mark.slow

AXES = np.vstack([np.eye(3), -np.eye(3)])
SIZE = (1.1, 0.8)
SURFACES = (
    *("plaster", "brick", "parquet", "carpet", "wood", "cloth", "poster", "bookcase_front"),
    *("whiteboard", "carton_side", "notebook_screen", "door_leaf", "window_pane"),
    *("cupboard_front", "ceiling_panels", "tiles", "lines"),
)
PLAIN = Texture([[0.5]])
OBSTACLES = tuple(furniture("chair", np.random.default_rng(0), placement((5.0, 0.0), 170.0)))


def seeded(seed=1):
    return np.random.default_rng(seed)


def fingerprint(bodies):
    """Where everything is and what it looks like."""
    digest = hashlib.sha256()
    for face in (face for body in bodies for face in getattr(body, "faces", ())):
        digest.update(face.corners_m.tobytes() + face.texture.image.tobytes())
    return digest.hexdigest()


def solids(bodies):
    return [body for body in bodies if isinstance(body, Solid)]


def reach_m(bodies):
    """The box around bodies: its upper and its lower corner."""
    ends = np.max([body.reach(AXES) for body in bodies], axis=0)
    return ends[:3], -ends[3:]


def area_of(face):
    spread = face.corners_m - face.corners_m[0]
    return np.linalg.norm(np.cross(spread[1:-1], spread[2:]).sum(axis=0)) / 2


@pytest.fixture(scope="module")
def furnished():
    """Makes rooms around obstacles, and their furniture, without walls to paint: that is slow."""

    @lru_cache
    def made(name, seed, **options):
        def plain(size_m, *_, **__):
            return Solid("room", [*rooms.walls(size_m, PLAIN).values()])

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(rooms, "room", plain)
            size = {"length_m": 11.0, **options}
            world = getattr(rooms, name)(seeded(seed), obstacles=OBSTACLES, **size)
        return world, world.bodies[: -len(OBSTACLES)]

    return made


# Surfaces


@pytest.mark.parametrize("name", SURFACES)
def test_surfaces_reflect_what_things_do_and_come_from_the_seed(name):
    made = getattr(textures, name)
    image = made(seeded(), SIZE, 250.0)
    assert image.dtype == np.float32 and image.shape == (200, 275)
    assert image.min() >= 0.02 and image.max() <= 0.95
    assert np.array_equal(image, made(seeded(), SIZE, 250.0))
    assert not np.array_equal(image, made(seeded(2), SIZE, 250.0))
    # What alternates from pixel to pixel would flicker.
    alternating = cv2.filter2D(image, -1, np.outer([1, -2, 1], [1, -2, 1]) / 16.0)[1:-1, 1:-1]
    assert alternating.std() < 0.12 * image.std()
    # There is structure at several scales.
    for times in (4, 16):
        small = cv2.resize(image, None, fx=1 / times, fy=1 / times, interpolation=cv2.INTER_AREA)
        assert small.std() > 0.012 * image.mean(), f"1/{times}"


# Bodies


def check_convex(body):
    """Faces look outwards, are flat, and show their images the right way round."""
    for face in body.faces:
        beyond = (body.corners_m - face.corners_m[0]) @ face.normal
        assert beyond.max() < 1e-9, body.name
        assert (face.corners_m - face.corners_m[0]) @ face.normal == pytest.approx(0, abs=1e-9)
        assert np.cross(face.down_m, face.right_m) @ face.normal > 0
        assert face.right_m @ face.down_m == pytest.approx(0, abs=1e-9)
        around = np.roll(face.corners_m, -1, axis=0) - face.corners_m
        turns = np.cross(around, np.roll(around, -1, axis=0)) @ face.normal
        assert (turns > 0).all()
        assert 0.3 <= face.gain <= 1.0


def test_a_block_shows_each_side_where_it_is():
    sides = ("front", "back", "left", "right", "top", "bottom")
    skins = {side: Texture(0.1 * number) for number, side in enumerate(sides)}
    corners = np.array([(-1.0, -2.0, 0.0), (1.0, 2.0, 3.0)])
    body = block("b", placement((0, 0)), corners, skins, None)
    looks = {round(float(face.texture.image[0, 0]), 1): face.normal for face in body.faces}
    expected = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]
    assert [tuple(looks[round(0.1 * i, 1)]) for i in range(6)] == expected
    assert np.array_equal(reach_m([body]), corners[::-1])


# Furniture


@pytest.mark.parametrize("name", catalogue()["pieces"])
def test_furniture_is_convex_bodies_apart_from_each_other(name):
    bodies = furniture(name, seeded(), placement((2.0, -1.0), 137.0))
    for body in solids(bodies):
        check_convex(body)
    assert are_apart(bodies)
    high, low = reach_m(bodies)
    assert low[2] >= -1e-9 and high[2] <= 2.8 + 1e-9
    assert np.abs((high + low)[:2] / 2 - (2.0, -1.0)).max() < 0.3
    named = {catalogue()["pieces"].get(name, {}).get("name", name)}
    assert {body.name for body in bodies} & (named | {"notebook", "carton"})
    again = furniture(name, seeded(), placement((2.0, -1.0), 137.0))
    assert fingerprint(bodies) == fingerprint(again)


@pytest.mark.parametrize("name", catalogue()["at_walls"])
def test_what_is_put_at_walls_takes_no_more_room_than_it_says(name):
    entry = catalogue()["at_walls"][name]
    for seed in range(2):
        high, low = reach_m(furniture(name, seeded(seed), placement((0, 0)), group="at_walls"))
        assert low[0] >= -1e-9 and high[0] <= entry["depth_m"] + 0.031
        assert max(high[1], -low[1]) <= entry["width_m"] / 2 + 0.01


def test_a_person_is_one_thing_that_moves_and_casts_no_shadow_then():
    def motion(time_s):
        return (0.0, time_s, 0.0)

    walker = furniture("person", seeded(), placement((2.0, 0.0)), motion=motion)
    assert all(body.motion is motion for body in walker)
    assert sum(isinstance(body, Capsule) for body in walker) == 1
    high, low = reach_m(walker)
    assert high[2] == pytest.approx(1.75, abs=0.03) and low[2] == pytest.approx(0, abs=0.03)
    floor, light = rooms.walls((4.0, 4.0, 2.5), PLAIN)["floor"], np.ones((100, 100), np.float32)
    bare = rooms.shaded(light, floor, [])
    assert np.array_equal(rooms.shaded(light, floor, walker), bare)
    at_rest = furniture("person", seeded(), placement((2.0, 0.0)))
    assert rooms.shaded(light, floor, at_rest).min() < 0.7 * bare[20:80, 20:80].min()


# Rooms


def test_a_room_is_closed_and_looks_inwards_and_its_walls_are_told_by_name():
    size_m = (4.0, 3.0, 2.5)
    inside = rooms.room(size_m, seeded())
    middle = np.array([2.0, 0.0, 1.25])
    for (side, wall), face in zip(rooms.walls(size_m, PLAIN).items(), inside.faces, strict=True):
        assert (middle - face.corners_m[0]) @ face.normal > 0
        assert np.cross(face.down_m, face.right_m) @ face.normal > 0
        assert np.array_equal(face.origin_m, wall.origin_m)
        if side in ("floor", "ceiling"):
            continue
        where = placement(*rooms.at_wall(size_m, side, 1.0, 0.01))
        assert where.axes[:, 0] == pytest.approx(face.normal)
        assert (where.at_m - face.corners_m[0]) @ face.normal == pytest.approx(0.01)
    assert sum(area_of(face) * face.normal for face in inside.faces) == pytest.approx(0, abs=1e-9)
    high, low = reach_m([inside])
    assert low == pytest.approx([0, -1.5, 0]) and high == pytest.approx([4, 1.5, 2.5])


def test_a_shadow_sweeps_over_its_wall_and_stays_on_it():
    floor = rooms.walls((6.0, 4.0, 2.5), PLAIN)["floor"]
    shade = textures.shadow(seeded(), (2.0, 1.0), 60.0)
    assert 0.2 < shade.image.min() < 0.7
    edges = [shade.image[0], shade.image[-1], shade.image[:, 0], shade.image[:, -1]]
    assert min(edge.min() for edge in edges) > 0.97
    shadow = rooms.shadow_on(floor, shade, up=1.0, speed_m_s=0.5, phase=0.3)
    times = np.arange(0.0, 60.0, 0.1)
    ways = np.array([shadow.motion(time) for time in times])
    steps = np.linalg.norm(np.diff(ways, axis=0), axis=1)
    assert 0.045 < steps.max() <= 0.05 + 1e-9
    corners = ways[:, None] + shadow.corners_m
    assert corners[..., 0].min() == pytest.approx(0.0, abs=0.01)
    assert corners[..., 0].max() == pytest.approx(6.0, abs=0.01)
    assert np.abs(corners[..., 1]).max() <= 2.0 + 1e-9
    # A shadow larger than the wall is as large as it.
    whole = rooms.shadow_on(
        floor, textures.shadow(seeded(), (9.0, 9.0), 9.0), up=0.5, speed_m_s=1, phase=0
    )
    assert whole.faces[0].size_m == pytest.approx((6.0, 4.0)) and not np.any(whole.motion(1.0))


def test_furniture_darkens_the_floor_and_the_wall_behind_it():
    size_m = (4.0, 4.0, 2.5)
    walls = rooms.walls(size_m, PLAIN)
    where = placement(*rooms.at_wall(size_m, "left", 1.0, 0.25))
    stands = furniture("cupboard", seeded(), where)
    light = np.ones((400, 400), np.float32)
    for side in ("floor", "left"):
        bare, dark = (rooms.shaded(light, walls[side], bodies) for bodies in ([], stands))
        # The cupboard stands at x = 0.5 to 1.5 m and y = 1.5 to 2 m, and is 1.9 m high.
        rows, columns = np.nonzero(dark / bare < 0.75)
        assert (columns.min(), columns.max()) == pytest.approx((50, 149), abs=4)
        top, bottom = (0, 50) if side == "floor" else (0.6 / 2.5 * 400, 399)
        assert (rows.min(), rows.max()) == pytest.approx((top, bottom), abs=5)
        assert np.abs((dark / bare)[:, 200:] - 1.0).max() < 1e-3
    # Rooms are darker in their corners.
    assert bare[0, 0] < bare[0, 200] < bare[200, 200]
    assert np.abs(bare - bare[:, ::-1]).max() < 1e-5


# Furnished places


def check_place(world, furniture, free_m, end_m):
    """All is in the room, apart, and out of the way of a drone up to `end_m` before its end."""
    high, low = reach_m(furniture)
    most, least = reach_m([world.room])
    assert (high <= most + 1e-6).all() and (low >= least - 1e-6).all()
    assert are_apart(world.bodies)
    for body in furniture:
        (x, y, _), (low_x, low_y, _) = reach_m([body])
        is_beside = min(abs(y), abs(low_y)) >= free_m / 2 and y * low_y > 0
        assert is_beside or low_x >= most[0] - end_m or x <= 0.15, body.name
    assert "chair" not in {body.name for body in furniture}


@pytest.mark.parametrize(
    ("name", "free_m", "end_m", "size"),
    [
        ("cluttered_room", 2.4, 1.1, {}),
        ("cluttered_room", 2.0, 1.1, {"length_m": 8.0, "width_m": 3.6, "free_width_m": 2.0}),
        ("cluttered_room", 2.6, 1.1, {"length_m": 10.0, "width_m": 7.0, "free_width_m": 2.6}),
        ("simple_room", 2.6, 0.0, {}),
        ("corridor", 2.1, 0.1, {}),
    ],
)
def test_places_are_free_to_fly_through_and_can_be_painted_in_order(
    name, free_m, end_m, size, furnished
):
    check_place(*furnished(name, 0, **size), free_m, end_m)


def test_clutter_is_clutter_but_not_too_much_to_paint(furnished):
    for seed in range(2):
        cluttered, simple = (furnished(name, seed)[1] for name in ("cluttered_room", "simple_room"))
        assert len({body.name for body in cluttered}) >= 8
        assert 35 <= len(cluttered) <= 80
        assert sum(len(body.faces) for body in cluttered) <= 260
        assert len(simple) < len(cluttered) / 2
        # Only a simple room is bare at its far wall.
        at_far = [
            sum(reach_m([body])[0][0] > 10.8 for body in bodies) for bodies in (cluttered, simple)
        ]
        assert at_far[0] >= 3 and at_far[1] == 0
    names = Counter(body.name for body in furnished("corridor", 0)[1])
    assert set(names) == {"door", "poster"} and names["door"] >= 8


def test_nothing_is_put_where_something_stands():
    def stool(x, y):
        return furniture("stool", seeded(), placement((x, y)))

    furnishing = rooms.Furnishing((5.0, 4.0, 2.5), obstacles=stool(1.0, 1.8))
    free = stool(3.0, 1.8)
    # Beside the obstacle, free, beside the one before, and half in the wall.
    pieces = (stool(1.2, 1.8), free, stool(3.2, 1.6), stool(4.9, 0.0))
    added = [furnishing.add(piece) for piece in pieces]
    assert added == [False, True, False, False] and furnishing.bodies == free
