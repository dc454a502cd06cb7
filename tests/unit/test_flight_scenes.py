"""Flights as scenes: their options, their length, what is recorded of them, and their files."""

import csv
import os
import pickle
import sys
from dataclasses import replace
from pathlib import Path

import cv2
import flightscenes
import numpy as np
import pytest
import yaml
from conftest import read_video
from flightscenes import DURATION_S, SHAPE, SHORT, Quick, stage_of

from dlgmd_cli import __version__
from dlgmd_cli.errors import OutputError, OutputExistsError, ParameterError
from dlgmd_cli.flights.scene import FlightOptions, FlightScene
from dlgmd_cli.flights.scenes import SCENES
from dlgmd_cli.stimuli.encode import write_clip, write_truth
from dlgmd_cli.stimuli.form import Form, n_digits
from dlgmd_cli.video.frames import open_video
from dlgmd_cli.video.writer import best_codec, write_video

PNG = Form.choose(png=True)
needs_pyav = pytest.mark.skipif(best_codec() != "h264", reason="H.264 needs PyAV")


@pytest.fixture
def scene():
    return Quick()


@pytest.fixture
def threads():
    """Sets the number of OpenCV's threads, and puts it back."""
    before = cv2.getNumThreads()
    yield cv2.setNumThreads
    cv2.setNumThreads(before)


def record_of(path):
    return yaml.safe_load(path.read_text("utf-8"))


def names(folder):
    return sorted(path.name for path in folder.iterdir())


# Options


@pytest.mark.parametrize("flag", ["--exposure", "--rolling-shutter"])
def test_no_longer_than_a_frame(scene, flag):
    assert scene.configure({flag: 1000 / 30, "--fps": 30.0})
    with pytest.raises(ParameterError) as caught:
        scene.configure({flag: 33.4, "--fps": 30.0})
    assert str(caught.value) == (
        f"Invalid value for '{flag}': 33.4 ms is longer than a frame at 30 frames/s. "
        "Choose 33.33 or less, or a lower --fps."
    )
    assert scene.configure({flag: 33.4, "--fps": 29.9})


@pytest.mark.parametrize(
    ("flag", "value"),
    [
        ("--exposure", -1.0),
        ("--exposure", float("nan")),
        ("--vignette", 1.01),
        ("--noise", -0.1),
        ("--shot-noise", 1.1),
        ("--gamma", 0.9),
        ("--gamma", 4.1),
        ("--rolling-shutter", -0.1),
    ],
)
def test_options_out_of_range(scene, flag, value):
    with pytest.raises(ParameterError, match=rf"'{flag}': .*is out of range"):
        scene.configure({flag: value})


def test_defaults_of_the_camera():
    options = FlightOptions()
    assert (options.fov_deg, options.exposure_ms, options.rolling_shutter_ms) == (80.0, 0.0, 0.0)
    assert (options.noise, options.shot_noise) == (0.002, 0.01)
    assert (options.vignette, options.gamma) == (0.3, 2.2)


def test_options_of_flat_scenes_are_none_of_a_flight(scene):
    with pytest.raises(ParameterError, match=r"^--contrast: quick has no such option\. It takes "):
        scene.configure({"--contrast": 0.5})
    with pytest.raises(ParameterError, match="looming-cube has no such option"):
        SCENES["looming-cube"].configure({"--exposure": 1.0})


# Length and record


@pytest.mark.parametrize(("fps", "n_frames"), [(30.0, 19), (10.0, 7), (12.5, 8), (1.0, 1)])
def test_a_clip_is_as_long_as_the_flight(scene, fps, n_frames):
    options = scene.configure({"--fps": fps})
    assert scene.n_frames(options) == n_frames
    assert (n_frames - 1) / fps <= DURATION_S + 1e-9 < n_frames / fps
    assert len(list(scene.truth(options))) == scene.record(options)["frames"] == n_frames


def test_a_flight_that_ends_on_a_frame_has_it(scene):
    assert 0.29 * 100.0 < 29.0  # in floating point
    assert scene.n_frames(scene.configure({"--seed": SHORT, "--fps": 100.0})) == 30


def test_a_clip_can_be_cut_but_not_drawn_out(scene):
    assert scene.n_frames(scene.configure({"--frames": 19})) == 19
    with pytest.raises(ParameterError, match=r"'--frames': the flight ends after 19 frames\. Choo"):
        scene.configure({"--frames": 20})


def test_more_frames_than_any_clip_has(scene, monkeypatch):
    monkeypatch.setattr("dlgmd_cli.flights.scene.MAX_FRAMES", 18)
    with pytest.raises(
        ParameterError, match=r"'--fps': the flight has 19 frames, and .* 18 at mos"
    ):
        scene.configure({})
    assert scene.configure({"--frames": 18})


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
    record = scene.record(scene.configure({"--seed": seed, "--fps": fps}))
    assert (record["collision_frame"], record["collision_time_s"]) == (frame, time_s)


def test_a_collision_beyond_the_clip_is_none_of_its_frames(scene):
    cut = scene.record(scene.configure({"--seed": 1, "--frames": 12}))
    assert (cut["collision_frame"], cut["collision_time_s"]) == (None, 0.4)
    assert scene.record(scene.configure({"--seed": 1, "--frames": 13}))["collision_frame"] == 12


@pytest.mark.parametrize("fps", [7.0, 30.0, 119.88])
def test_phases_are_those_of_the_truth(scene, fps):
    options = scene.configure({"--fps": fps})
    spelled_out = [
        phase["name"]
        for phase in scene.record(options)["phases"]
        for _ in range(phase["first_frame"], phase["last_frame"] + 1)
    ]
    assert spelled_out == [row.phase for row in scene.truth(options)]


def test_phases_have_no_gaps(scene):
    phases = scene.record(scene.configure({"--fps": 30.0}))["phases"]
    assert phases == [
        {"name": "hover", "first_frame": 0, "last_frame": 5},
        {"name": "cruise", "first_frame": 6, "last_frame": 8},
        {"name": "hover", "first_frame": 9, "last_frame": 18},
    ]


def test_a_scene_goes_to_other_processes_without_what_it_built(scene):
    scene.stage(FlightOptions(seed=1))
    there = pickle.loads(pickle.dumps(scene))
    assert there._built is None and there.name == "quick"
    assert scene._built is not None


# Files


def test_a_clip_of_a_flight(scene, tmp_path):
    flightscenes.built.clear()
    options = scene.configure({"--seed": 3, "--exposure": 5.0, "--frames": 15})
    paths = write_clip(scene, options, tmp_path)
    assert [path.name for path in paths] == ["quick.mp4", "quick.csv", "quick.yaml"]
    assert flightscenes.built == {3: 1}
    rate, frames = read_video(paths[0])
    assert (rate, len(frames), frames[0].shape[:2]) == (30.0, 15, SHAPE)
    with paths[1].open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 15 and rows[8]["phase"] == "cruise" and rows[8]["frame"] == "8"
    assert paths[2].read_text().startswith("# Written by dlgmd.\n")
    record = record_of(paths[2])
    assert record.pop("versions")["dlgmd"] == __version__
    assert record == {
        "scene": "quick",
        "seed": 3,
        "codec": best_codec(),
        "options": options.to_dict(),
        **scene.record(options),
    }
    assert record["options"] == {
        "size": "32x16",
        "fps": 30.0,
        "frames": 15,
        "fov": 80.0,
        "seed": 3,
        "exposure": 5.0,
        "rolling-shutter": 0.0,
        "vignette": 0.3,
        "noise": 0.002,
        "shot-noise": 0.01,
        "gamma": 2.2,
    }
    assert record["collision_frame"] == 13 and record["target"] == "wall"


@needs_pyav
def test_the_record_names_what_encoded_it(scene, tmp_path):
    options = scene.configure({"--frames": 3})
    *_, coded = write_clip(scene, options, tmp_path / "a")
    *_, exact = write_clip(scene, options, tmp_path / "b", Form.choose(lossless=True))
    assert "av" in record_of(coded)["versions"] and record_of(coded)["codec"] == "h264"
    assert "av" not in record_of(exact)["versions"] and record_of(exact)["codec"] == "ffv1"


@pytest.mark.parametrize("form", [None, PNG, Form.choose(lossless=True)])
@pytest.mark.parametrize("error", ["error", "bug", "interrupt"])
def test_nothing_half_made_stays(tmp_path, form, error):
    scene = Quick(at_0=error)
    with pytest.raises((OutputError, IndexError, KeyboardInterrupt)):
        write_clip(scene, scene.defaults, tmp_path / "new", form)
    assert names(tmp_path / "new") == []


def test_how_many_frames_are_rendered_is_told(scene, tmp_path):
    told = []
    write_clip(scene, scene.configure({"--frames": 4}), tmp_path, on_frame=told.append)
    assert told == [1, 2, 3, 4]


def test_text_in_a_truth_is_no_formula(tmp_path):
    from dlgmd_cli.flights.truth import FlightTruth

    values = dict.fromkeys(FlightTruth.__dataclass_fields__, 0.25)
    row = FlightTruth(**{**values, "time_to_contact_s": float("nan"), "phase": "=1,\n"})
    write_truth(tmp_path / "x.csv", FlightTruth, [row])
    header, line = (tmp_path / "x.csv").read_text().splitlines()
    assert header.split(",") == list(values)
    found = next(csv.DictReader([header, line]))
    assert found["phase"] == "./=1,\\n" and found["time_to_contact_s"] == ""


# Pictures


def test_pictures_are_exact(scene, tmp_path):
    options = scene.configure({"--size": (17, 33), "--fps": 30000 / 1001})
    frames, *_ = write_clip(scene, options, tmp_path, PNG)
    assert frames == tmp_path / "quick"
    assert names(tmp_path) == ["quick", "quick.csv", "quick.yaml"]
    assert names(frames) == [f"{index:04d}.png" for index in range(18)]
    made = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(frames.iterdir())]
    np.testing.assert_array_equal(made, list(scene.frames(options)))
    with open_video(frames, scale=1.0) as source:
        assert sum(1 for _ in source) == 18


def test_pictures_of_a_flat_scene(tmp_path):
    scene = SCENES["looming-ball"]
    options = scene.configure({"--size": (17, 33), "--frames": 2})
    frames, truth = write_clip(scene, options, tmp_path, Form.choose(png=True, lossless=True))
    assert names(tmp_path) == ["looming-ball", "looming-ball.csv"]
    assert len(truth.read_text().splitlines()) == 3 and len(names(frames)) == 2


def test_pictures_take_the_place_of_earlier_ones_only_when_told(scene, tmp_path):
    write_clip(scene, scene.defaults, tmp_path, PNG)
    for name in ("quick.csv", "quick.yaml"):
        (tmp_path / name).unlink()
    with pytest.raises(OutputExistsError, match=r"quick: it stands here already\. "):
        write_clip(scene, scene.defaults, tmp_path, PNG)
    shorter = scene.configure({"--frames": 3})
    write_clip(scene, shorter, tmp_path, PNG, overwrite=True)
    assert names(tmp_path) == ["quick", "quick.csv", "quick.yaml"]
    assert names(tmp_path / "quick") == ["0000.png", "0001.png", "0002.png"]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("stray", ["notes.txt", "0001.jpg", "1.png", "0001.png/"])
def test_a_folder_with_other_files_is_never_replaced(scene, tmp_path, stray, overwrite):
    folder = tmp_path / "quick"
    folder.mkdir()
    (folder / "0000.png").touch()
    (folder / stray).mkdir() if stray.endswith("/") else (folder / stray).touch()
    before = names(folder)
    with pytest.raises(OutputExistsError, match=f"holds other files, such as {before[-1]}"):
        write_clip(scene, scene.defaults, tmp_path, PNG, overwrite=overwrite)
    assert names(folder) == before and names(tmp_path) == ["quick"]


def test_what_is_no_folder_is_never_replaced_by_one(scene, tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "quick").symlink_to("elsewhere")
    with pytest.raises(OutputExistsError, match="this is no folder of pictures"):
        write_clip(scene, scene.defaults, tmp_path, PNG, overwrite=True)
    (tmp_path / "quick").unlink()
    (tmp_path / "quick").touch()
    with pytest.raises(OutputExistsError, match="this is no folder of pictures"):
        write_clip(scene, scene.defaults, tmp_path, PNG, overwrite=True)


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_pictures_that_find_no_room(scene, tmp_path, monkeypatch):
    def write_bytes(path, data):
        with open("/dev/full", "wb") as file:
            file.write(data)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    with pytest.raises(OutputError, match=r"quick: it cannot be written \(No space left"):
        write_clip(scene, scene.defaults, tmp_path, PNG)
    assert names(tmp_path) == []


def test_names_have_digits_enough():
    assert [n_digits(count) for count in (1, 10_000, 10_001, 1_000_000)] == [4, 4, 5, 6]


# Filmed for good


def test_a_flight_is_filmed_the_same_every_time(tmp_path, threads):
    options = FlightOptions(shape=(24, 32), n_frames=4, exposure_ms=20.0, rolling_shutter_ms=10.0)
    filmed = FlightScene("filmed", "a wall that comes closer", options, stage_of)
    made = []
    for n_threads in (1, 4):
        threads(n_threads)
        folder = tmp_path / str(n_threads)
        write_clip(filmed, options, folder)
        write_clip(filmed, options, folder, PNG, name="exact")
        made.append({path.name: path.read_bytes() for path in folder.rglob("*.*")})
    assert made[0] == made[1] and len(made[0]) == 3 + 2 + 4
    other = list(filmed.frames(replace(options, seed=1)))
    assert all(np.any(a != b) for a, b in zip(filmed.frames(options), other, strict=True))


# Videos


def waves(n_frames=12, shape=(64, 128)):
    """Smooth pictures with every grey level, and a little noise."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[: shape[0], : shape[1]]
    for k in range(n_frames):
        wave = 127.5 + 130.0 * np.sin(x / 20.0 + y / 31.0 + 0.2 * k) + rng.normal(0, 1.5, shape)
        yield np.rint(np.clip(wave, 0, 255)).astype(np.uint8)


@needs_pyav
def test_h264_keeps_grey_levels(tmp_path, decoder):
    path = tmp_path / "x.mp4"
    write_video(path, waves(), (64, 128), 30.0, codec="h264")
    with open_video(path, scale=1.0, decoder=decoder) as source:
        read = [frame.grey.astype(float) for frame in source]
    errors = np.array(read) - np.array(list(waves()), float)
    assert len(read) == 12
    assert np.abs(errors).mean() < 1.7  # of which the noise has 1.2
    assert abs(errors.mean()) < 0.6  # OpenCV rounds down
    ends = np.array(list(waves()))
    assert abs(errors[ends == 0].mean()) < 1.0 and abs(errors[ends == 255].mean()) < 1.0


@needs_pyav
@pytest.mark.parametrize("fps", [1.0, 23.976, 29.97, 119.999, 600.0])
def test_h264_keeps_times(tmp_path, fps):
    path = tmp_path / "x.mp4"
    write_video(path, waves(8), (64, 128), fps, codec="h264")
    capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
    for index in range(8):
        assert capture.grab()
        time_s = capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
        assert time_s == pytest.approx(index / fps, abs=1e-6)
    assert not capture.grab()


@pytest.mark.parametrize("codec", ["mpeg4", "ffv1", pytest.param("h264", marks=needs_pyav)])
def test_the_same_frames_make_the_same_file(tmp_path, threads, codec):
    suffix = "avi" if codec == "ffv1" else "mp4"
    made = []
    for n_threads in (1, 4):
        threads(n_threads)
        path = tmp_path / f"{n_threads}.{suffix}"
        write_video(path, waves(30), (64, 128), 30.0, codec=codec)
        made.append(path.read_bytes())
    assert made[0] == made[1]
    if codec == "h264":  # what would make another file now and then
        assert b" threads=1 " in made[0] and b" mbtree=0 " in made[0]


@needs_pyav
def test_flights_are_what_players_show_and_flat_scenes_what_they_were(scene, tmp_path):
    flight, *_ = write_clip(scene, scene.defaults, tmp_path)
    assert b"avc1" in flight.read_bytes()
    flat = SCENES["looming-cube"]
    video, _ = write_clip(flat, flat.configure({"--size": (16, 32), "--frames": 3}), tmp_path)
    assert b"mp4v" in video.read_bytes()


def test_without_pyav_a_flight_is_mpeg4(scene, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    video, _, record = write_clip(scene, scene.defaults, tmp_path)
    assert b"mp4v" in video.read_bytes()
    assert record_of(record)["codec"] == "mpeg4" and "av" not in record_of(record)["versions"]
