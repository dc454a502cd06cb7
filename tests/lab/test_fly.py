"""`dlgmd lab fly`: flights are what their scripts, labels and truth say."""

import csv
import math
import sys

import cv2
import numpy as np
import pytest
from click.testing import CliRunner

from dlgmd_cli.errors import DlgmdError, MissingExtraError, ParameterError
from dlgmd_cli.lab.fly import gl, textures
from dlgmd_cli.lab.fly.fly import TRUTH, flown, fly, frame_times
from dlgmd_cli.lab.fly.motion import HULL_M, JERK_M_S3, STEP_S, simulated
from dlgmd_cli.lab.fly.objects import KINDS
from dlgmd_cli.lab.fly.scripts import AHEAD, GROUPS, MANNERS, Leg, Options, Script, script_of

SMALL = (96, 54)


@pytest.fixture(scope="session")
def mujoco():
    """MuJoCo; skips without it."""
    try:
        gl.require()
    except DlgmdError as error:
        pytest.skip(f"needs MuJoCo: {error}")


@pytest.fixture(scope="session")
def drawing(mujoco):
    """A rendered flight; skips where no library of OpenGL draws."""
    try:
        return flown(Options("hit", 1, SMALL, 10.0))
    except DlgmdError as error:
        pytest.skip(f"needs OpenGL: {error}")


@pytest.fixture
def bare(mujoco, monkeypatch):
    """Surfaces have no textures, which take most of the time of a scene that nobody looks at."""
    monkeypatch.setattr(textures, "drawn", lambda name, rng: np.zeros((8, 8), np.uint8))


def stage_of(script, seed=0, size=SMALL):
    from dlgmd_cli.lab.fly.stage import Stage

    return Stage(script, seed, size)


def into_a_wall(speed=2.0, seconds=2.5):
    """A straight flight into a wall."""
    return Script(
        "hit", "simple", (Leg("cruise", seconds + 0.2, speed),), 1.3, speed, target="wall",
        meets=AHEAD, meets_s=seconds, speed_m_s=speed,
    )  # fmt: skip


def path_of(*legs, seed=0, brake_s=None, **more):
    return simulated(Script("hit", "simple", legs, 1.0, **more), seed, brake_s)


class TestMotion:
    def test_a_stabilised_drone_tilts_at_most_47_degrees_a_second(self):
        path = path_of(Leg("hover", 1), Leg("go", 2, 3.0, tilt_deg=30))
        pitch = [path.at(t).attitude_deg[1] for t in np.arange(0, 3, STEP_S)]
        rate = np.abs(np.diff(pitch)) / STEP_S
        assert 30 < rate.max() <= math.degrees(JERK_M_S3 / 9.81) + 4  # drag adds a little
        assert min(pitch) < -20

    def test_an_agile_drone_tilts_as_fast_as_its_attitude_is_shaped(self):
        path = path_of(Leg("hover", 1), Leg("go", 1, 3.0, tilt_deg=30), agile=True)
        assert path.at(1.5).attitude_deg[1] < -20 < path.at(1.1).attitude_deg[1]

    @pytest.mark.parametrize("agile", [False, True])
    def test_the_rate_of_the_tilt_never_steps(self, agile):
        path = path_of(Leg("hover", 1), Leg("go", 1, 3.0, tilt_deg=30), agile=agile, brake_s=1.8)
        pitch = [path.at(t).attitude_deg[1] for t in np.arange(0, 2, STEP_S)]
        assert 500 < np.abs(np.diff(pitch, 2)).max() / STEP_S**2 < 1300  # drag adds a little

    def test_it_reaches_its_speed_without_overshoot(self):
        path = path_of(Leg("go", 4, 2.0, tilt_deg=20))
        speeds = path.samples[:, 3]
        assert speeds.max() < 2.15
        assert abs(path.at(3.9).velocity[0] - 2.0) < 0.15

    def test_it_brakes_with_25_degrees_from_the_time_on(self):
        kept, braked = (path_of(Leg("go", 4, 3.0), starts_m_s=3.0, brake_s=s) for s in (None, 1.0))
        n = round(1.0 / STEP_S)
        assert np.array_equal(kept.samples[:n], braked.samples[:n])
        # v²/2a, half of the time in which the deceleration grows, and the tilt's delay.
        way = braked.at(3.5).position[0] - braked.at(1.0).position[0]
        most = 9.81 * math.tan(math.radians(25))
        assert abs(way - (9 / (2 * most) + 3 * most / (2 * JERK_M_S3) + 3 * 0.15)) < 0.2
        assert np.linalg.norm(braked.at(3.5).velocity) < 0.15

    def test_a_contact_throws_it_back(self):
        path = path_of(Leg("go", 2, 2.0), starts_m_s=2.0)
        after = path.rebounding(1.0, np.zeros(3))
        assert np.array_equal(
            path.samples[: round(1.0 / STEP_S)], after.samples[: round(1 / STEP_S)]
        )
        assert -0.6 < after.at(1.02).velocity[0] < -0.3


class TestTextures:
    @pytest.mark.parametrize("name", [*textures.TEXTURES])
    def test_texture(self, name):
        one, again = (textures.drawn(name, np.random.default_rng(3)) for _ in range(2))
        assert np.array_equal(one, again)
        assert one.shape == (textures.SIDE_PX, textures.SIDE_PX)
        assert 20 < one.mean() < 230
        assert (one.std() > 4) == (name != "plain")

    @pytest.mark.parametrize("name", ["plaster", "grass", "leaves", "asphalt"])
    def test_repeats_without_a_seam(self, name):
        image = textures.drawn(name, np.random.default_rng(0)).astype(float)
        for axis in (0, 1):
            inside = np.abs(np.diff(image, axis=axis)).mean()
            seam = np.abs(image.take(0, axis) - image.take(-1, axis)).mean()
            assert seam < 3 * inside + 12


class TestScripts:
    def test_half_of_the_flights_end_in_a_contact(self):
        assert sum(manner.share for manner in MANNERS.values()) == pytest.approx(1)
        hits = np.mean([script_of(Options(None, seed)).collides for seed in range(300)])
        assert 0.4 < hits < 0.6

    def test_speeds_and_lenses_are_within_their_ranges(self):
        scripts = [script_of(Options(None, seed)) for seed in range(80)]
        assert all(60 <= script.fov_deg <= 120 for script in scripts)
        assert all(1.0 <= s.speed_m_s <= 3.0 for s in scripts if s.name != "climb")
        given = script_of(Options("hit", 0, speed_m_s=2.5, fov=90.0))
        assert {leg.climb_m_s for leg in script_of(Options("free", 3, height_m=0.7)).legs} == {0.0}
        assert (given.speed_m_s, given.fov_deg) == (2.5, 90.0)

    @pytest.mark.parametrize("environment", ["indoors", "outdoors"])
    def test_environment(self, environment):
        found = {
            script_of(Options(None, seed, environment=environment)).environment
            for seed in range(30)
        }
        assert found == {environment}

    def test_target(self):
        scripts = [script_of(Options(None, seed, target="person")) for seed in range(40)]
        assert {script.target for script in scripts} == {"person"}
        assert {"hit", "pass", "approached", "crossed"} == {script.name for script in scripts}

    @pytest.mark.parametrize(
        ("given", "text"),
        [
            ({"scene": "loop"}, "no manner 'loop'"),
            ({"scene": "door", "target": "pole"}, "meets no pole"),
            ({"scene": "hit", "environment": "indoors", "target": "tree"}, "not found indoors"),
            ({"scene": "group2", "target": "pole"}, "its own room"),
        ],
    )
    def test_refused(self, given, text):
        with pytest.raises(ParameterError, match=text):
            script_of(Options(**given))


class TestTruth:
    @pytest.mark.parametrize(
        ("group", "frame"),
        [("group1", 120), ("group2", 140), ("group3", 135), ("group4", 210), ("group5", 196)],
    )
    def test_groups_collide_at_the_frames_of_the_paper(self, bare, group, frame):
        stage = stage_of(GROUPS[group])
        assert stage.contact_s * 30 == pytest.approx(frame, abs=1e-6)
        times = frame_times(stage.seconds, 30.0)
        space = [stage.clearance(time_s, 0, 1) for time_s in times[: frame + 1]]
        assert min(space[:-1]) > 0
        assert -0.02 < space[-1] <= 1e-6

    def test_group2_pitches_at_40_and_brakes_at_125(self, bare):
        path = stage_of(GROUPS["group2"]).path
        pitch = {frame: path.at(frame / 30).attitude_deg[1] for frame in (38, 50, 124, 138)}
        assert abs(pitch[38]) < 2
        assert pitch[50] < -3
        assert pitch[124] < -3
        assert pitch[138] > 5
        assert path.at(140 / 30).velocity[0] < 0.8 * path.at(125 / 30).velocity[0]

    def test_the_chair_of_group1_can_be_seen(self, drawing):
        for seed in (0, 1):
            frame = fly("group1", seed=seed, size="96x54", fps=10).frames[33]
            assert np.median(frame[20:34, 43:53]) < 0.6 * np.median(frame[20:34])

    def test_group3_yaws_at_10_degrees_a_second(self, bare):
        path = stage_of(GROUPS["group3"]).path
        assert path.at(4).attitude_deg[2] - path.at(1).attitude_deg[2] == pytest.approx(
            -30, abs=1.5
        )

    @pytest.mark.parametrize("kind", [*KINDS])
    def test_every_kind_can_be_hit(self, bare, kind):
        script = script_of(Options("hit", 5, target=kind))
        stage = stage_of(script, 5)
        space = [stage.clearance(t, 0, 1) for t in np.arange(0, stage.contact_s - 0.01, 0.2)]
        assert min(space) > 0
        assert -0.02 < stage.clearance(stage.contact_s, 1) <= 1e-6

    @pytest.mark.parametrize("seed", range(6))
    def test_what_is_not_to_collide_does_not(self, bare, seed):
        scene = [manner for manner in MANNERS if manner not in ("hit", "approached")][seed]
        stage = stage_of(script_of(Options(scene, seed)), seed)
        times = frame_times(stage.seconds, 10.0)
        assert min(stage.clearance(time_s, 0, 1) for time_s in times) > 0.05

    def test_distance_falls_as_the_drone_flies(self, bare):
        stage = stage_of(into_a_wall())
        for time_s in (0.0, 0.7, 1.5, 2.5):
            distance, closing = stage.course(time_s)
            left = stage.path.at(2.5).position[0] - stage.path.at(time_s).position[0]
            assert distance == pytest.approx(left + HULL_M, abs=0.02)
            assert closing == pytest.approx(2.0, abs=0.1)

    def test_what_approaches_a_hovering_drone_closes_at_its_speed(self, bare):
        stage = stage_of(script_of(Options("approached", 3, target="ball", speed_m_s=2.0)), 3)
        (early, speed), (late, _) = stage.course(0.2), stage.course(1.2)
        assert speed == pytest.approx(2.0, abs=0.15)
        assert early - late == pytest.approx(2.0, abs=0.15)

    def test_the_image_grows_at_the_true_rate(self, drawing):
        from dlgmd_cli.lab.fly.stage import Stage

        ratios = []
        with Stage(into_a_wall(), 0, (960, 540)) as stage:
            for first, second in ((0.9, 1.0), (1.2, 1.3), (1.5, 1.6)):
                one, two = (stage.image(0, s).astype(np.float32) for s in (first, second))
                grown = stage.course(first)[0] / stage.course(second)[0]
                corner = np.float32([420, 210])  # of a square around the middle of the image
                shift = (1 - grown) * np.float32([480, 270]) + grown * corner
                guess = np.float32([[grown, 0, shift[0]], [0, grown, shift[1]]])
                affine = cv2.findTransformECC(
                    one[210:330, 420:540], two, guess, cv2.MOTION_AFFINE, (3, 200, 1e-7), None, 5
                )[1]
                measured = math.sqrt(np.linalg.det(affine[:, :2].astype(float)))
                ratios.append(math.log(measured) / math.log(grown))
        assert np.mean(ratios) == pytest.approx(1.0, abs=0.03)


class TestFlights:
    def test_flight(self, drawing):
        assert drawing.frames.dtype == np.uint8
        assert drawing.frames.shape[1:] == SMALL[::-1]
        assert drawing.truth.dtype.names == TRUTH
        assert len(drawing.truth) == len(drawing.frames)
        assert 40 < drawing.frames.mean() < 200
        assert drawing.frames.std(axis=(1, 2)).min() > 3
        row = drawing.truth[drawing.collision_frame]
        assert row["time_to_contact_s"] == pytest.approx(0, abs=1e-6)
        assert row["distance_m"] < 0.4
        assert np.isnan(drawing.truth["time_to_contact_s"][drawing.collision_frame + 1 :]).all()

    def test_a_seed_gives_the_same_flight(self, drawing):
        again, other = (fly("hit", seed=seed, size="96x54", fps=10) for seed in (1, 2))
        assert np.array_equal(again.frames, drawing.frames)
        assert np.array_equal(
            again.truth["distance_m"], drawing.truth["distance_m"], equal_nan=True
        )
        assert other.record != drawing.record

    def test_what_is_hit_fills_the_image(self, drawing):
        flight = flown(Options("hit", 1, SMALL, 10.0, "indoors", "board"))
        spread = [np.percentile(f, 95) - np.percentile(f, 5) for f in flight.frames]
        assert spread[flight.collision_frame - 1] > spread[0]


def lab_fly(*arguments):
    from dlgmd_cli.lab.fly.command import fly as command

    small = ("--size", "96x54", "--fps", "10", "--jobs", "1")
    return CliRunner().invoke(command, [*map(str, arguments), *small])


class TestCommand:
    def test_labels_videos_and_truth(self, drawing, tmp_path):
        out = tmp_path / "flights"
        done = lab_fly("--count", 2, "--seed", 3, "--out", out)
        assert done.exit_code == 0, done.output
        assert done.output.startswith("2 flights, ")
        with (out / "labels.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert {"video", "collision_frame", "target", "kind", "manner"} < rows[0].keys()
        assert {"fov", "camera_tilt"} < rows[0].keys()
        for seed, row in enumerate(rows, 3):
            assert row["video"] == f"{row['manner']}-{seed:04d}.mp4"
            assert row["kind"] == "rendered"
            assert bool(row.get("speed_m_s")) == bool(row["collision_frame"])
            n_frames = int(cv2.VideoCapture(str(out / row["video"])).get(cv2.CAP_PROP_FRAME_COUNT))
            truth = (out / "truth" / row["video"]).with_suffix(".csv").read_text().splitlines()
            assert truth[0] == ",".join(TRUTH)
            assert len(truth) == n_frames + 1
        again = lab_fly("--out", out)
        assert again.exit_code == 2
        assert "already exists" in again.output

    def test_images(self, drawing, tmp_path):
        done = lab_fly("--manner", "hit", "--seed", 1, "--png", "--out", tmp_path / "png")
        assert done.exit_code == 0, done.output
        images = sorted((tmp_path / "png" / "hit-0001").iterdir())
        assert len(images) == len(drawing.frames)
        assert np.array_equal(cv2.imread(str(images[0]), 0), drawing.frames[0])

    def test_film(self, drawing, tmp_path):
        out = tmp_path / "film"
        done = lab_fly("--manner", "hit", "--target", "board", "--seed", 4, "--with", "flight",
                       "--out", out)  # fmt: skip
        assert done.exit_code == 0, done.output
        assert "without the alarm: hits at " in done.output
        with (out / "hit-0004-film.csv").open() as file:
            rows = list(csv.DictReader(file))
        assert {row["flight"] for row in rows} == {"without", "with"}
        n_frames = cv2.VideoCapture(str(out / "hit-0004-film.mp4")).get(cv2.CAP_PROP_FRAME_COUNT)
        counts = [sum(row["flight"] == name for row in rows) for name in ("without", "with")]
        assert n_frames == max(counts)

    @pytest.mark.parametrize(
        ("arguments", "text"),
        [
            (("--speed", "fast"), "is not a number"),
            (("--target", "cow"), "'cow' is not one of"),
            (("--manner", "loop"), "'loop' is not one of"),
            (("--manner", "door", "--target", "pole"), "meets no pole"),
            (("--with", "flight", "--count", 2), "films one flight"),
            (("--with", "flight", "--manner", "approached"), "cannot brake"),
            (("--with", "nothing", "--manner", "hit"), "nothing"),
        ],
    )
    def test_refused_in_a_line(self, mujoco, tmp_path, arguments, text):
        done = lab_fly(*arguments, "--out", tmp_path / "x")
        assert done.exit_code == 2
        assert text in " ".join(done.output.split())
        assert not (tmp_path / "x").exists()


def test_without_mujoco_a_line_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[lab\]'"):
        fly("hit")
    done = lab_fly("--out", tmp_path / "x")
    assert done.exit_code == 1
    assert "'.[lab]'" in done.output


def test_without_opengl_a_line_names_the_packages():
    text = str(gl.unusable(RuntimeError("no EGL")))
    assert "libegl1" in text
    assert "libosmesa6" in text
