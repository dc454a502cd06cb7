"""Flights as scenes: their length and record, where obstacles are put, what the shutter does."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import project
from flightscenes import DURATION_S, Quick, cruise, hover, scene_of, yaw

from dlgmd_cli.scenes.flights.camera import Camera
from dlgmd_cli.scenes.flights.drone import fly
from dlgmd_cli.scenes.flights.furniture import furniture, placement
from dlgmd_cli.scenes.flights.painter import Renderer
from dlgmd_cli.scenes.flights.path import Stage
from dlgmd_cli.scenes.flights.scenes import FilmCamera, FlightOptions
from dlgmd_cli.scenes.flights.solids import Solid, Texture, World, quad
from dlgmd_cli.scenes.flights.stages import MissedError, obstacle_in_path, with_unique_name
from dlgmd_cli.scenes.flights.truth import first_contact


@pytest.fixture
def scene():
    return Quick()


# Options


def test_options_at_their_limits(scene):
    for flag in ("exposure", "rolling_shutter"):
        assert scene.configure({flag: 1000 / 30, "fps": 30.0})
        assert scene.configure({flag: 33.4, "fps": 29.9})
    assert scene.n_frames(scene.configure({"frames": 19})) == 19


# Length and record


@pytest.mark.parametrize(("fps", "n_frames"), [(30.0, 19), (10.0, 7), (12.5, 8), (1.0, 1)])
def test_a_clip_is_as_long_as_the_flight(scene, fps, n_frames):
    options = scene.configure({"fps": fps})
    assert scene.n_frames(options) == n_frames
    assert (n_frames - 1) / fps <= DURATION_S + 1e-9 < n_frames / fps
    assert len(list(scene.truth(options))) == scene.record(options)["frames"] == n_frames


@pytest.mark.parametrize(
    ("seed", "fps", "frame", "time_s"),
    [
        (0, 30.0, None, None),
        (1, 30.0, 12, 0.4),
        (11, 25.0, 7, 0.28),  # 0.28 * 25 > 7 in floating point
        (3, 30.0, 13, 0.41),
        (3, 100.0, 41, 0.41),
        (5, 30.0, 18, 0.6),
        (7, 30.0, None, 0.601),
    ],
)
def test_the_collision_is_the_first_frame_at_or_after_contact(scene, seed, fps, frame, time_s):
    record = scene.record(scene.configure({"seed": seed, "fps": fps}))
    assert (record["collision_frame"], record["collision_time_s"]) == (frame, time_s)


def test_a_collision_beyond_the_clip_is_none_of_its_frames(scene):
    cut = scene.record(scene.configure({"seed": 1, "frames": 12}))
    assert (cut["collision_frame"], cut["collision_time_s"]) == (None, 0.4)
    assert scene.record(scene.configure({"seed": 1, "frames": 13}))["collision_frame"] == 12


@pytest.mark.parametrize("fps", [7.0, 30.0, 119.88])
def test_phases_are_those_of_the_truth(scene, fps):
    options = scene.configure({"fps": fps})
    spelled_out = [
        phase["name"]
        for phase in scene.record(options)["phases"]
        for _ in range(phase["first_frame"], phase["last_frame"] + 1)
    ]
    assert spelled_out == [row.phase for row in scene.truth(options)]


# Named flights


def chair(at_m, yaw_deg=0.0):
    return furniture("chair", np.random.default_rng(0), placement(at_m, yaw_deg))


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
            before, after = (project(camera, each, stage.path.pose(0.0)) for each in (first, later))
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
    assert first_contact(path, World(Solid("room", []), bodies)) == pytest.approx(1.5)
    high = fly([cruise(2.0)], position_m=(0, 0, 1.8), speed_m_s=1.0, jitter=0.0)
    with pytest.raises(MissedError):
        obstacle_in_path(high, 1.5, chair, "chair")


# What the shutter does


def striped_stage(script, **options):
    """A drone in front of upright stripes on a wide wall."""
    stripes = np.repeat(np.tile([0.1, 0.9], 100), 16)[None].astype(np.float32)
    wall = quad([2.0, 30.0, 20.0], [0.0, -60.0, 0.0], [0.0, 0.0, -40.0], Texture(stripes))
    board = Solid("board", [quad([1.99, 0.1, 9], [0, -0.2, 0], [0, 0, -0.2], Texture(0.5))])
    path = fly(script, position_m=(0.0, 0.0, 0.0), jitter=0.0, **options)
    return Stage(World(Solid("room", [wall]), [board]), path, "board", None, path.duration_s)


def filmed(stage, time_s, **options):
    """The frame at a time, without noise."""
    plain = {"noise": 0.0, "shot_noise": 0.0, "vignette": 0.0, "gamma": 1.0}
    options = FlightOptions(shape=(60, 80), fps=1 / time_s, **plain, **options)
    return FilmCamera(stage, options).frame(1, stage.path).astype(float)


def test_an_exposure_is_the_mean_of_what_passes_in_it():
    stage = striped_stage([cruise(2.0)], speed_m_s=3.0)
    renderer = Renderer(stage.world, Camera((60, 80), 80.0))
    times = 0.5 + 0.02 * ((np.arange(100) + 0.5) / 100 - 0.5)
    expected = np.mean([renderer.render(stage.path.pose(t), t) for t in times], axis=0)
    frame = filmed(stage, 0.5, exposure_ms=20.0) / 255.0
    assert np.abs(frame - expected).max() < 0.06
    assert np.abs(filmed(stage, 0.5) / 255.0 - expected).max() > 0.1


def test_a_lamp_that_goes_on_while_the_shutter_is_open_counts_from_then_on():
    still = striped_stage([hover(1.0)])
    bright = filmed(still, 0.5)
    for lit_s, share in ((0.51, 0.25), (0.495, 0.625), (0.525, 0.0)):
        world = replace(still.world, light=lambda t, lit_s=lit_s: 1.0 if t >= lit_s else 0.0)
        stage = replace(still, world=world)
        assert np.abs(filmed(stage, 0.5, exposure_ms=40.0) - bright * share).max() < 4.0
        # Rows that are taken later than that are lit.
        rolled = filmed(stage, 0.5, rolling_shutter_ms=40.0)
        first_lit = round(60 * (1.0 - share))
        assert (rolled[:first_lit] == 0).all() and (rolled[first_lit:] > 0).all()


def test_a_rolling_shutter_shears_upright_edges():
    """By the rows' share of the readout, the camera has turned on."""
    stage = striped_stage([yaw(2.0, 40.0)])
    frame, whole = (filmed(stage, 1.0, rolling_shutter_ms=ms) for ms in (30.0, 0.0))
    renderer = Renderer(stage.world, Camera((60, 80), 80.0))
    for row in (0, 29, 30, 59):
        time = 1.0 + ((row + 0.5) / 60 - 0.5) * 0.03
        expected = renderer.render(stage.path.pose(time), time)[row]
        # Rows are taken in strips, half a pixel apart.
        assert np.abs(frame[row] / 255.0 - expected).max() < 0.35
    assert np.abs(frame - whole)[29:31].max() < 90 < 120 < np.abs(frame - whole)[0].max()
