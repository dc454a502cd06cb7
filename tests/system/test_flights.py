"""Every flight, at length: near misses, random flights, and rooms in which nothing overlaps."""

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from bodies import are_apart, project
from flightscenes import SMALL, Quick, scene_of

from dlgmd_cli.results.labels import read_labels
from dlgmd_cli.scenes.flights import random_flights
from dlgmd_cli.scenes.flights.camera import Camera
from dlgmd_cli.scenes.flights.path import REACH_M
from dlgmd_cli.scenes.flights.random_flights import manners
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightScene
from dlgmd_cli.scenes.flights.solids import Solid, World
from dlgmd_cli.scenes.flights.truth import Nearest, Target, first_contact, surroundings

pytestmark = pytest.mark.slow
random_flight = cache(random_flights.random_flight)

# The paper's Table III: what is hit, and at which frame.
GROUPS = {
    "group1": ("chair", 120),
    "group2": ("gridded pattern", 140),
    "group2-late": ("gridded pattern", 140),
    "group3": ("notebook", 135),
    "group4": ("gridded pattern", 210),
    "group5": ("carton", 196),
}
# How near each may come to what it is about, in m.
MISSES = {
    "past-pillar": (0.4, 0.7),
    "through-doorway": (0.35, 0.6),
    "along-corridor": (2.5, 4.0),
    "turn-at-wall": (1.0, 1.6),
    "light-on": (4.0, 6.0),
    "person-crossing": (3.0, 4.5),
}


def placed(bodies, time_s):
    """The bodies where they are at a time."""
    return [body.moved(body.motion(time_s)) if body.motion else body for body in bodies]


@pytest.mark.usefixtures("here")
@pytest.mark.parametrize("name", GROUPS)
def test_groups_hit_what_the_paper_says_when_it_says(name):
    target, frame = GROUPS[name]
    scene = SCENES[name]
    options = scene.configure(SMALL)
    record = scene.record(options)
    assert (record["target"], record["collision_frame"]) == (target, frame)
    stage = scene.stage(options)
    parts = [body for body in stage.world.bodies if body.name == target]
    extent = np.ptp([body.reach(np.eye(3)) for body in parts], axis=0)
    assert (extent < 1.7).all()  # there is one of them only
    # What is touched first, of all there is, is the target, and then.
    assert first_contact(stage.path, stage.world) * 30 == pytest.approx(frame, abs=1e-3)
    alone = World(Solid("room", []), parts)
    assert first_contact(stage.path, alone) * 30 == pytest.approx(frame, abs=1e-3)
    if name in ("group4", "group5"):
        phases = [each["name"] for each in record["phases"]]
        assert phases == ["stand", "take off", "pitch", "accelerate", "collision"]
        heights = [stage.path.state(k / 30).position_m[2] for k in (0, 20, 100)]
        assert heights[0] == heights[1] < 0.2 < 0.9 < heights[2]
        assert stage.path.state(150 / 30).pitch_deg < -7


@pytest.mark.parametrize("name", MISSES)
def test_near_misses_miss(name):
    scene, options, rows = scene_of(name)
    stage = scene.stage(options)
    assert stage.contact_s is None and scene.record(options)["collision_frame"] is None
    assert first_contact(stage.path, stage.world) is None
    near, far = MISSES[name]
    assert near < min(row.distance_m for row in rows) < far
    assert all(math.isnan(row.time_to_contact_s) for row in rows)
    world = surroundings(stage.world)
    for time_s in np.arange(0.0, stage.duration_s, 0.1):
        assert world.distances(stage.path.state(time_s).position_m, time_s).min() > 0.3


def test_the_truth_leads_to_the_contact_and_follows_the_script():
    """Of group2: it pitches from frame 40, brakes from 105, and hits at 140."""
    scene, options, rows = scene_of("group2")
    first = {each["name"]: each["first_frame"] for each in scene.record(options)["phases"]}
    assert (first["pitch"], first["decelerate"], first["collision"]) == (40, 105, 140)
    left = [row.time_to_contact_s for row in rows]
    assert left[139] == pytest.approx(1 / 30) and math.isnan(left[141])
    assert rows[140].distance_m == pytest.approx(REACH_M, abs=1e-6)
    assert min(row.distance_m for row in rows) > 0.08
    sizes = [row.angular_size_deg for row in rows[:141]]
    assert sizes[0] < 30 and sizes[-1] > max(60, max(sizes) - 3)
    # The nose goes down first, and speed comes of it.
    assert all(abs(row.pitch_deg) < 1.5 for row in rows[:40])
    assert rows[60].pitch_deg < -7 and rows[138].pitch_deg > 5
    speeds = np.diff([row.x_m for row in rows]) * 30
    assert abs(speeds[30]) < 0.05 < 0.3 < speeds[60] < speeds[90] < speeds[110]
    assert 0.5 < speeds[138] < speeds.max() / 2


def test_group3_yaws_without_pitching():
    _, _, rows = scene_of("group3")
    turning = [row for row in rows if row.phase == "yaw"]
    assert turning[-1].yaw_deg - turning[0].yaw_deg > 25
    assert np.ptp([row.pitch_deg for row in turning]) < 1.5


def test_groups_1_to_3_share_a_room():
    """What stands there is the same, but for what each of them hits."""
    places = []
    for name in ("group1", "group2", "group3"):
        bodies = SCENES[name].stage(scene_of(name)[1]).world.bodies
        places.append([body.corners_m.tolist() for body in bodies if isinstance(body, Solid)])
    shared = [place for place in places[0] if place in places[1] and place in places[2]]
    assert len(shared) > 25
    assert all(len(place) - len(shared) < 20 for place in places)


def test_through_the_doorway_means_through():
    scene, options, rows = scene_of("through-doorway")
    stage = scene.stage(options)
    parts = [body for body in stage.world.bodies if body.name == "doorway"]
    begins = min(-body.reach(np.array([[-1.0, 0, 0]]))[0] for body in parts)
    ends = max(body.reach(np.array([[1.0, 0, 0]]))[0] for body in parts)
    x = [row.x_m for row in rows]
    assert x[0] < begins < ends < x[-1]


def test_the_light_goes_on_after_two_seconds():
    scene, options, _ = scene_of("light-on")
    means = np.array([frame.mean() for frame in scene.frames(options)])
    steps = np.abs(np.diff(means))
    assert steps.argmax() == 59 and steps[59] > 40
    assert np.delete(steps, 59).max() < 1.0


def test_the_person_crosses_the_picture():
    scene, options, _ = scene_of("person-crossing")
    stage = scene.stage(options)
    camera = Camera(options.shape, options.fov_deg)
    across = []
    for frame in range(0, scene.n_frames(options), 15):
        bodies = [body for body in placed(stage.world.bodies, frame / 30) if body.name == "person"]
        middles = [(body.reach(np.eye(3)) - body.reach(-np.eye(3))) / 2 for body in bodies]
        across.append(project(camera, np.mean(middles, axis=0), stage.path.pose(frame / 30))[0])
    assert across[0] > 45 and across[-1] < 20 and (np.diff(across) < 0.2).all()


@pytest.mark.parametrize("name", [*GROUPS, *MISSES, "ball-and-capsules"])
def test_bodies_are_apart_and_in_the_room(name):
    scene, options, _ = scene_of(name)
    stage = scene.stage(options)
    for time_s in (0.0, stage.duration_s / 2, stage.duration_s):
        bodies = placed(stage.world.bodies, time_s)
        assert are_apart(bodies)
        for wall in stage.world.room.faces if name != "ball-and-capsules" else ():
            level = wall.normal @ wall.corners_m[0]
            for body in bodies:
                assert -body.reach(-wall.normal[None])[0] > level - 1e-6, body.name


def test_random_flights_come_out_in_every_way():
    stages = [random_flight(seed) for seed in range(8)]
    hits = [stage for stage in stages if stage.contact_s is not None]
    assert 2 <= len(hits) <= 6
    assert len({stage.target for stage in stages}) >= 3
    assert len({len(stage.world.bodies) for stage in stages}) >= 4
    for stage in stages:
        contact = first_contact(stage.path, stage.world)
        if stage.contact_s is None:
            assert contact is None
        else:
            assert contact == pytest.approx(stage.contact_s, abs=1e-4)
            distance, angle, _ = Target(stage).seen_from(stage.path.state(contact), contact)
            assert distance == pytest.approx(REACH_M, abs=1e-4) and angle > 50
            assert contact < stage.duration_s <= contact + 0.5 + 1e-9
        if not any(body.motion for body in stage.world.bodies):
            assert are_apart(stage.world.bodies)


def test_a_random_flight_into_a_wall_says_so():
    """The seeds of three such flights; the wall is told from the floor, which is nearer."""
    for seed in (19, 26, 33):
        stage = random_flight(seed)
        walls = Nearest([], stage.world.room.faces)
        state = stage.path.state(stage.contact_s)
        assert stage.target == "wall"
        assert walls.distances(state.position_m, 0.0)[:4].min() == pytest.approx(REACH_M, abs=1e-4)
        begin = Target(stage).seen_from(stage.path.state(0.0), 0.0)
        assert begin[0] > 1.0 and begin[1] < 120


@pytest.mark.parametrize(
    ("manner", "seed"),
    [
        *(("gusts", 7), ("gusts", 62), ("storm", 148), ("storm", 192), ("turns", 15)),
        *(("close", 40), ("low", 5), ("people", 9), ("light", 4), ("walk", 10), ("walk", 41)),
    ],
)
def test_a_roaming_flight_is_what_its_manner_says_and_hits_nothing(manner, seed):
    stage, ranges = random_flight(seed), manners()[manner]
    assert stage.manner == manner and stage.contact_s is None
    assert first_contact(stage.path, stage.world) is None
    times = np.arange(0.0, stage.duration_s, 0.02)
    states = [stage.path.state(time) for time in times]
    spin = np.degrees([state.angular_velocity_rad_s for state in states])
    heights = np.array([state.position_m[2] for state in states])
    speeds = np.linalg.norm([state.velocity_m_s[:2] for state in states], axis=1)
    lights = np.array([stage.world.light(time) for time in times])
    people = [body for body in stage.world.bodies if body.motion is not None]
    low, high = ranges["height_m"]
    assert low - 0.3 < heights.min() and heights.max() < high + 0.3
    assert speeds.max() < ranges["speed_m_s"][1] + 1.0
    assert (np.ptp(lights) > 0) == bool(stage.world.shadows) == (manner == "light")
    assert bool(people) <= (manner in ("people", "walk"))
    if manner in ("gusts", "turns", "walk"):
        assert np.abs(spin).max() > 25
    if manner == "storm":
        assert np.linalg.norm(spin, axis=1).max() > 90
    # Even straight on, there would be nothing for half a second.
    around = surroundings(stage.world)
    for now_s, state in zip(times, states, strict=True):
        ahead = state.position_m + 0.3 * state.velocity_m_s
        assert around.distances(ahead, now_s + 0.3).min() > 0.5 * REACH_M


def test_a_random_drone_is_agile_if_told_to_and_in_a_quarter_of_the_seeds():
    drawn = [np.random.default_rng([seed, 0, 1]).random() < 0.25 for seed in range(6)]
    stages = [random_flight(seed) for seed in range(6)]
    assert [stage.agile for stage in stages] == drawn and 0 < sum(drawn) < 6
    asked = SCENES["random"].configure({**SMALL, "seed": 4, "agile": False})
    record = SCENES["random"].record(asked)
    assert stages[4].agile and record["agile"] is False


def test_a_seed_is_a_flight():
    scene = SCENES["random"]
    again = FlightScene("random", "", scene.defaults, random_flights.random_flight)
    given = {**SMALL, "seed": 5, "frames": 40}
    one, two = (each.configure(given) for each in (scene, again))
    assert list(map(str, scene.truth(one))) == list(map(str, again.truth(two)))
    for a, b in zip(scene.frames(one), again.frames(two), strict=True):
        assert (a == b).all()
    other = scene.configure({**given, "seed": 6})
    assert next(scene.frames(other)).tolist() != next(again.frames(two)).tolist()


def test_a_drone_at_rest_sees_the_same_but_for_noise():
    """Texture does not flicker when nothing moves."""
    scene, *_ = scene_of("group4")
    calm = scene.configure({**SMALL, "noise": 0.0, "shot_noise": 0.0, "frames": 20})
    frames = list(scene.frames(calm))
    assert all((frame == frames[0]).all() for frame in frames)
    noisy = list(scene.frames(scene.configure({**SMALL, "frames": 2})))
    assert (noisy[0] != noisy[1]).any()


# Many of them


def test_in_processes_of_their_own_a_death_or_an_error_costs_one_flight(dlgmd, monkeypatch):
    monkeypatch.setitem(SCENES, "quick", Quick())
    alone = ["synth", "quick", "--out", "alone", "--count", 3, "--jobs", 1]
    assert dlgmd(*alone).exit_code == 0
    monkeypatch.setitem(SCENES, "quick", Quick(at_3="kill", at_4="error"))
    result = dlgmd("synth", "quick", "--out", "f", "--count", 6, "--jobs", 2)
    assert result.exit_code == 1
    said = sorted(result.stderr.splitlines())
    assert said[0].startswith("Error: 2 of 6 flights failed; the other 4 are in")
    assert said[1].startswith("Error: quick-0003: its process was killed")
    assert said[2] == "Error: quick-0004: here: it cannot be. Mend it."
    listed = [label.video for label in read_labels(Path("f", "labels.csv"))]
    assert listed == [f"quick-000{i}.mp4" for i in (0, 1, 2, 5)]
    assert len(list(Path("f").iterdir())) == 3 * 4 + 1  # nothing half made
    for path in Path("alone").glob("quick-*"):
        assert path.read_bytes() == Path("f", path.name).read_bytes()
