"""The named flights: what is hit and when, what is missed and by how much."""

import math
from dataclasses import replace

import numpy as np
import pytest
from flightscenes import cruise, hover, scene_of, yaw

from dlgmd_cli.lab.flights.camera import Camera
from dlgmd_cli.lab.flights.drone import fly
from dlgmd_cli.lab.flights.furniture import furniture, placement
from dlgmd_cli.lab.flights.painter import Renderer
from dlgmd_cli.lab.flights.path import REACH_M, Stage
from dlgmd_cli.lab.flights.scenes import SCENES, FlightOptions, film
from dlgmd_cli.lab.flights.solids import Solid, Texture, World, quad
from dlgmd_cli.lab.flights.stages import MissedError, obstacle_in_path, with_unique_name
from dlgmd_cli.lab.flights.truth import first_contact


def chair(at_m, yaw_deg=0.0):
    return furniture("chair", np.random.default_rng(0), placement(at_m, yaw_deg))


def phases_of(scene, options):
    return {each["name"]: each for each in scene.record(options)["phases"]}


def test_the_truth_leads_to_the_contact():
    scene, options, rows = scene_of("group2")
    frame = scene.record(options)["collision_frame"]
    assert frame == 140
    assert len(rows) == scene.n_frames(options)
    left = [row.time_to_contact_s for row in rows]
    assert left[frame - 1] == pytest.approx(1 / 30) and math.isnan(left[frame + 1])
    assert rows[frame].distance_m == pytest.approx(REACH_M, abs=1e-6)
    assert min(row.distance_m for row in rows) > 0.08
    sizes = [row.angular_size_deg for row in rows[: frame + 1]]
    assert sizes[0] < 30 and sizes[-1] > max(60, max(sizes) - 3)


def test_group2_pitches_from_40_and_brakes_from_105():
    scene, options, rows = scene_of("group2")
    phases = phases_of(scene, options)
    assert phases["pitch"]["first_frame"] == 40
    assert phases["decelerate"]["first_frame"] == 105
    assert phases["collision"]["first_frame"] == 140
    assert all(abs(row.pitch_deg) < 1.5 for row in rows[:40])
    # The nose goes down first, and speed comes of it.
    assert rows[60].pitch_deg < -7 and rows[138].pitch_deg > 5
    speeds = np.diff([row.x_m for row in rows]) * 30
    assert abs(speeds[30]) < 0.05 < 0.3 < speeds[60] < speeds[90] < speeds[110]
    assert 0.5 < speeds[138] < speeds.max() / 2


def test_group3_yaws_without_pitching():
    scene, options, rows = scene_of("group3")
    phase = phases_of(scene, options)["yaw"]
    turning = rows[phase["first_frame"] : phase["last_frame"] + 1]
    assert turning[-1].yaw_deg - turning[0].yaw_deg > 25
    assert np.ptp([row.pitch_deg for row in turning]) < 1.5


def test_groups_1_to_3_share_a_room():
    """What stands there is the same, but for what each of them hits."""
    stages = [SCENES[f"group{n}"].stage(scene_of(f"group{n}")[1]) for n in (1, 2, 3)]
    places = [
        [body.corners_m.tolist() for body in stage.world.bodies if isinstance(body, Solid)]
        for stage in stages
    ]
    shared = [place for place in places[0] if place in places[1] and place in places[2]]
    assert len(shared) > 25
    assert all(len(place) - len(shared) < 20 for place in places)


def test_ball_and_capsules_is_the_scene_of_the_papers_fig_8():
    scene, options, rows = scene_of("ball-and-capsules")
    stage = scene.stage(options)
    record = scene.record(options)
    assert (record["collision_frame"], record["frames"]) == (61, 62)
    camera = Camera((600, 800), 80.0)
    radii = camera.focal_px * np.tan(np.radians([row.angular_size_deg / 2 for row in rows]))
    # Read off the authors' frames, in px.
    for frame, radius in ((0, 25), (20, 36), (40, 66)):
        assert radii[frame] == pytest.approx(radius, rel=0.08)
    speeds = []
    for body in stage.world.bodies:
        if body.name == "capsule":
            first, later = (
                body.moved(np.array(body.motion(t))).ends_m.mean(axis=0) for t in (0, 1)
            )
            before, after = (camera.project(each, stage.path.pose(0.0)) for each in (first, later))
            assert after[1] == pytest.approx(before[1])
            speeds.append((after - before)[0] / 30)
    assert sorted(speeds) == pytest.approx([1.6, 3.2, 4.8, 6.4], rel=1e-6)
    assert len({(row.x_m, row.y_m, row.z_m, row.pitch_deg) for row in rows}) == 1


def test_only_the_piece_that_is_met_keeps_its_name():
    near, far = (chair((x, 0.0), 30.0) for x in (2.0, 4.0))
    walls = Solid("room", [quad([9, 5, 5], [0, -9, 0], [0, 0, -9], Texture(0.5))])
    world = with_unique_name(World(walls, [*near, *far]), len(near) + 2)
    names = [body.name for body in world.bodies]
    assert names == ["other chair"] * len(near) + ["chair"] * len(far)


def test_an_obstacle_can_only_be_in_the_way_at_its_height():
    path = fly([cruise(2.0)], position_m=(0, 0, 0.8), speed_m_s=1.0, jitter=0.0)
    bodies = obstacle_in_path(path, 1.5, chair, "chair")
    assert first_contact(path, World(Solid("room", []), bodies), ["chair"]) == pytest.approx(1.5)
    high = fly([cruise(2.0)], position_m=(0, 0, 1.8), speed_m_s=1.0, jitter=0.0)
    with pytest.raises(MissedError):
        obstacle_in_path(high, 1.5, chair, "chair")


# What the shutter does


def striped_stage(script, **how):
    """A drone in front of upright stripes on a wide wall."""
    stripes = np.repeat(np.tile([0.1, 0.9], 100), 16)[None].astype(np.float32)
    wall = quad([2.0, 30.0, 20.0], [0.0, -60.0, 0.0], [0.0, 0.0, -40.0], Texture(stripes))
    room = Solid("room", [wall])
    board = Solid("board", [quad([1.99, 0.1, 9], [0, -0.2, 0], [0, 0, -0.2], Texture(0.5))])
    path = fly(script, position_m=(0.0, 0.0, 0.0), jitter=0.0, **how)
    return Stage(World(room, [board]), path, "board", None, path.duration_s)


def filmed(stage, n_frames, **how):
    how = {"noise": 0.0, "shot_noise": 0.0, "vignette": 0.0, "gamma": 1.0, **how}
    options = FlightOptions(shape=(60, 80), **how)
    return np.array(list(film(stage, options, n_frames)), float)


def test_an_exposure_is_the_mean_of_what_passes_in_it():
    stage = striped_stage([cruise(2.0)], speed_m_s=3.0)
    renderer = Renderer(stage.world, Camera((60, 80), 80.0))
    times = 0.5 + 0.02 * ((np.arange(200) + 0.5) / 200 - 0.5)
    expected = np.mean([renderer.render(stage.path.pose(t), t) for t in times], axis=0)
    frame = filmed(stage, 16, exposure_ms=20.0)[15] / 255.0
    assert np.abs(frame - expected).max() < 0.06
    sharp = filmed(stage, 16)[15] / 255.0
    assert np.abs(sharp - expected).max() > 0.1


def test_a_lamp_that_goes_on_while_the_shutter_is_open_counts_from_then_on():
    still = striped_stage([hover(1.0)])
    for lit_s, share in ((0.51, 0.25), (0.495, 0.625), (0.525, 0.0)):
        world = replace(still.world, light=lambda t, lit_s=lit_s: 1.0 if t >= lit_s else 0.0)
        stage = replace(still, world=world)
        exposed = filmed(stage, 11, fps=20.0, exposure_ms=40.0)[10]
        expected = filmed(still, 1)[0] * share
        assert exposed == pytest.approx(expected, abs=4.0)
        # Rows that are taken later than that are lit.
        rolled = filmed(stage, 11, fps=20.0, rolling_shutter_ms=40.0)[10]
        first_lit = round(60 * (1.0 - share))
        assert (rolled[:first_lit] == 0).all() and (rolled[first_lit:] > 0).all()


def test_a_rolling_shutter_shears_upright_edges():
    """By the rows' share of the readout, the camera has turned on."""
    stage = striped_stage([yaw(4.0, 40.0)])
    frame = filmed(stage, 91, rolling_shutter_ms=30.0)[90]
    renderer = Renderer(stage.world, Camera((60, 80), 80.0))
    for row in (0, 29, 30, 59):
        time = 3.0 + ((row + 0.5) / 60 - 0.5) * 0.03
        expected = renderer.render(stage.path.pose(time), time)[row]
        # Rows are taken in strips, half a pixel apart.
        assert np.abs(frame[row] / 255.0 - expected).max() < 0.35
    whole = filmed(stage, 91)[90]
    assert np.abs(frame - whole)[29:31].max() < 90 < 120 < np.abs(frame - whole)[0].max()
