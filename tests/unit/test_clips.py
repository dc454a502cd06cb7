"""Clips: a scene's frames, ground truth and record as files, whole or not at all."""

import csv
import math
import os
from dataclasses import replace
from pathlib import Path

import cv2
import flightscenes
import numpy as np
import pytest
from conftest import csv_rows, read_video, yaml_of
from flightscenes import SHAPE, Quick, stage_of

import dlgmd_cli
from dlgmd_cli import __version__
from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.scenes.flights.scenes import SCENES, FlightOptions, FlightScene
from dlgmd_cli.scenes.flights.truth import FlightTruth
from dlgmd_cli.scenes.stimuli.clip import Rendering, choose_codec, n_digits, write_truth
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.writer import best_codec, write_video

PNG, LOSSLESS = "png", "ffv1"
CUBE = SCENES["looming-cube"]
SMALL = {"size": (48, 64), "frames": 6}
needs_pyav = pytest.mark.skipif(best_codec() != "h264", reason="H.264 needs PyAV")


@pytest.fixture
def scene():
    return Quick()


def write_clip(scene, options, folder, codec=None, *, name=None, **more):
    codec = codec or choose_codec(playable=scene.is_flight)
    return Rendering(scene, options, folder, codec, name or scene.name).write(**more)


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def decoded(path):
    """Every frame of a video, one channel."""
    return [frame[:, :, 1] for frame in read_video(path)[1]]


# What is written


def test_a_clip_of_a_flight(scene, tmp_path):
    flightscenes.built.clear()
    options = scene.configure({"seed": 3, "exposure": 5.0, "frames": 15})
    told = []
    paths = write_clip(scene, options, tmp_path, on_frame=told.append)
    assert [path.name for path in paths] == ["quick.mp4", "quick.csv", "quick.yaml"]
    assert flightscenes.built == {3: 1} and told == list(range(1, 16))
    rate, frames = read_video(paths[0])
    assert (rate, len(frames), frames[0].shape[:2]) == (30.0, 15, SHAPE)
    rows = csv_rows(paths[1])
    assert len(rows) == 15 and rows[8]["phase"] == "cruise" and rows[8]["frame"] == "8"
    assert paths[2].read_text().startswith("# Written by dlgmd.\nscene: quick\nseed: 3\n")
    record = yaml_of(paths[2])
    assert record.pop("versions")["dlgmd"] == __version__
    assert record == {
        "scene": "quick",
        "seed": 3,
        "codec": best_codec(),
        "options": options.to_dict(),
        **scene.record(options),
    }
    given = {"size": "32x16", "fps": 30.0, "frames": 15, "seed": 3, "exposure": 5.0, "agile": None}
    assert given.items() <= record["options"].items() and "shot-noise" in record["options"]
    assert record["collision_frame"] == 13 and record["target"] == "wall"


@needs_pyav
def test_the_record_names_what_encoded_it(scene, tmp_path):
    options = scene.configure({"frames": 3})
    coded_video, _, coded = write_clip(scene, options, tmp_path / "a")
    *_, exact = write_clip(scene, options, tmp_path / "b", LOSSLESS)
    assert "av" in yaml_of(coded)["versions"] and yaml_of(coded)["codec"] == "h264"
    assert "av" not in yaml_of(exact)["versions"] and yaml_of(exact)["codec"] == "ffv1"
    # Flights are what players show; flat scenes are the same everywhere.
    flat, _ = write_clip(CUBE, CUBE.configure(SMALL), tmp_path)
    assert b"avc1" in coded_video.read_bytes() and b"mp4v" in flat.read_bytes()


@pytest.mark.parametrize("name", ["looming-cube", "translating-cubes"])
def test_lossless_video_is_exact_and_the_other_close(tmp_path, name):
    scene = SCENES[name]
    options = scene.configure({**SMALL, "noise": 0.02, "fps": 12.5})
    frames = list(scene.frames(options))
    exact, _ = write_clip(scene, options, tmp_path / "a", LOSSLESS)
    coded, _ = write_clip(scene, options, tmp_path / "b")
    assert (exact.name, coded.name) == (f"{name}.avi", f"{name}.mp4")
    np.testing.assert_array_equal(decoded(exact), frames)
    rate, read = read_video(coded)
    assert np.mean(np.abs(np.array(read, float)[..., 1] - frames)) < 8.0
    assert rate == pytest.approx(12.5)


def test_truth_reads_back(tmp_path):
    options = CUBE.configure(SMALL)
    _, path = write_clip(CUBE, options, tmp_path)
    text = path.read_bytes().decode("ascii")
    header = "frame,time_s,angular_size_deg,angular_velocity_deg_s,time_to_contact_s"
    assert text.startswith(f"{header}\n0,0,") and "\r" not in text
    lines = csv.DictReader(text.splitlines())
    for cells, row in zip(lines, CUBE.truth(options), strict=True):
        for column, cell in cells.items():
            assert cell == f"{getattr(row, column):.9g}"


def test_in_a_truth_nan_is_empty_and_text_is_no_formula(tmp_path):
    values = dict.fromkeys(FlightTruth.__dataclass_fields__, 0.25)
    row = FlightTruth(**{**values, "time_to_contact_s": math.nan, "phase": "=1,\n"})
    write_truth(tmp_path / "x.csv", FlightTruth, [row])
    header, line = (tmp_path / "x.csv").read_text().splitlines()
    assert header.split(",") == list(values)
    found = next(csv.DictReader([header, line]))
    assert found["phase"] == "./=1,\\n" and found["time_to_contact_s"] == ""


# Images


def test_pictures_are_exact_and_read_as_a_video(scene, tmp_path):
    options = scene.configure({"size": (17, 33), "fps": 30000 / 1001})
    frames, *_ = write_clip(scene, options, tmp_path, PNG)
    assert frames == tmp_path / "quick"
    assert names(tmp_path) == ["quick", "quick.csv", "quick.yaml"]
    assert names(frames) == [f"{index:04d}.png" for index in range(18)]
    made = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in sorted(frames.iterdir())]
    np.testing.assert_array_equal(made, list(scene.frames(options)))
    with open_video(frames, scale=1.0) as source:
        assert sum(1 for _ in source) == 18
    assert [n_digits(count) for count in (1, 10_000, 10_001, 1_000_000)] == [4, 4, 5, 6]


def test_pictures_take_the_place_of_earlier_ones_only_when_told(scene, tmp_path):
    write_clip(scene, scene.defaults, tmp_path, PNG)
    for name in ("quick.csv", "quick.yaml"):
        (tmp_path / name).unlink()
    with pytest.raises(OutputExistsError, match="quick: already exists"):
        write_clip(scene, scene.defaults, tmp_path, PNG)
    write_clip(scene, scene.configure({"frames": 3}), tmp_path, PNG, overwrite=True)
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


@pytest.mark.parametrize("is_link", [False, True])
def test_what_is_not_a_folder_is_never_replaced_by_one(scene, tmp_path, is_link):
    (tmp_path / "elsewhere").mkdir()
    there = tmp_path / "quick"
    there.symlink_to("elsewhere") if is_link else there.touch()
    with pytest.raises(OutputExistsError, match="not a folder of images"):
        write_clip(scene, scene.defaults, tmp_path, PNG, overwrite=True)


# Whole or not at all


@pytest.mark.parametrize("codec", [None, PNG, LOSSLESS])
@pytest.mark.parametrize("error", ["error", "bug", "interrupt"])
def test_an_error_leaves_what_was_there_and_nothing_half_made(scene, tmp_path, codec, error):
    broken = Quick(at_0=error)
    write_clip(scene, scene.defaults, tmp_path / "old", codec)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "old").rglob("*")}
    for folder in ("old", "new"):
        with pytest.raises((OutputError, IndexError, KeyboardInterrupt)):
            write_clip(broken, broken.defaults, tmp_path / folder, codec, overwrite=True)
    assert names(tmp_path / "new") == []
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "old").rglob("*")} == before


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_pictures_that_find_no_room(scene, tmp_path, monkeypatch):
    def write_bytes(path, data):
        with open("/dev/full", "wb") as file:
            file.write(data)

    monkeypatch.setattr(Path, "write_bytes", write_bytes)
    with pytest.raises(OutputError, match=r"quick: cannot be written \(No space left"):
        write_clip(scene, scene.defaults, tmp_path, PNG)
    assert names(tmp_path) == []


# The same every time


def test_a_flight_is_filmed_the_same_every_time(tmp_path, set_threads):
    options = FlightOptions(shape=(24, 32), n_frames=4, exposure_ms=20.0, rolling_shutter_ms=10.0)
    filmed = FlightScene("filmed", "a wall that comes closer", options, stage_of)
    made = []
    for n_threads in (1, 4):
        set_threads(n_threads)
        folder = tmp_path / str(n_threads)
        write_clip(filmed, options, folder)
        write_clip(filmed, options, folder, PNG, name="exact")
        made.append({path.name: path.read_bytes() for path in folder.rglob("*.*")})
    assert made[0] == made[1] and len(made[0]) == 3 + 2 + 4
    other = list(filmed.frames(replace(options, seed=1)))
    assert all(np.any(a != b) for a, b in zip(filmed.frames(options), other, strict=True))


def waves(n_frames=12, shape=(64, 128)):
    """Smooth images with every grey level, and a little noise."""
    rng = np.random.default_rng(5)
    y, x = np.mgrid[: shape[0], : shape[1]]
    for k in range(n_frames):
        wave = 127.5 + 130.0 * np.sin(x / 20.0 + y / 31.0 + 0.2 * k) + rng.normal(0, 1.5, shape)
        yield np.rint(np.clip(wave, 0, 255)).astype(np.uint8)


@pytest.mark.parametrize("codec", ["mpeg4", "ffv1", pytest.param("h264", marks=needs_pyav)])
def test_the_same_frames_make_the_same_file(tmp_path, set_threads, codec):
    suffix = "avi" if codec == "ffv1" else "mp4"
    made = []
    for n_threads in (1, 4):
        set_threads(n_threads)
        path = tmp_path / f"{n_threads}.{suffix}"
        write_video(path, waves(30), (64, 128), 30.0, codec=codec)
        made.append(path.read_bytes())
    assert made[0] == made[1]
    if codec == "h264":  # what would make another file now and then
        assert b" threads=1 " in made[0] and b" mbtree=0 " in made[0]


def test_the_truth_of_an_earlier_clip_never_stands_beside_the_images_of_a_later_one(
    tmp_path, monkeypatch
):
    for name in ("looming-cube", "quick"):
        monkeypatch.setitem(SCENES, "quick", Quick())
        dlgmd_cli.synth(name, tmp_path, size="32x16", frames=3)
        arrived, replace = [], Path.replace
        last = tmp_path / f"{name}.{'yaml' if name == 'quick' else 'csv'}"

        def watched(self, target, arrived=arrived, last=last, replace=replace):
            if Path(target).parent == tmp_path:
                arrived.append((Path(target).name, last.exists()))
            return replace(self, target)

        with monkeypatch.context() as patch:
            patch.setattr(Path, "replace", watched)
            dlgmd_cli.synth(name, tmp_path, size="32x16", frames=4, overwrite=True)
        assert arrived[-1] == (last.name, False) and len(arrived) > 1
        assert not any(has_record for _, has_record in arrived)
