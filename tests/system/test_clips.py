"""Clips: a stimulus and its ground truth as files, whole or not at all."""

import csv
from pathlib import Path

import numpy as np
import pytest
from conftest import read_video

import dlgmd_cli
from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.scenes.objects import SCENES, Approach
from dlgmd_cli.video.writer import best_codec, write_video

SMALL = {"size": "64x48", "frames": 6}
needs_pyav = pytest.mark.skipif(best_codec() != "h264", reason="H.264 needs PyAV")


def names(folder):
    return sorted(path.name for path in folder.iterdir())


def decoded(path):
    """Every frame of a video, one channel."""
    return [frame[:, :, 1] for frame in read_video(path)[1]]


@pytest.mark.parametrize("name", ["looming-cube", "translating-cubes"])
def test_lossless_video_is_exact_and_the_other_close(tmp_path, name):
    options = {**SMALL, "noise": 0.02, "fps": 12.5}
    frames = dlgmd_cli.synth(name, **options).frames
    exact, _ = dlgmd_cli.synth(name, tmp_path / "a", **options).paths
    coded, _ = dlgmd_cli.synth(name, tmp_path / "b", lossless=False, **options).paths
    assert (exact.name, coded.name) == (f"{name}.avi", f"{name}.mp4")
    np.testing.assert_array_equal(decoded(exact), frames)
    rate, read = read_video(coded)
    assert np.mean(np.abs(np.array(read, float)[..., 1] - frames)) < 8.0
    assert rate == pytest.approx(12.5)


def test_truth_reads_back(tmp_path):
    clip = dlgmd_cli.synth("looming-cube", tmp_path, **SMALL)
    text = clip.paths[1].read_bytes().decode("ascii")
    header = "frame,time_s,angular_size_deg,angular_velocity_deg_s,time_to_contact_s"
    assert text.startswith(f"{header}\n0,0,") and "\r" not in text
    for cells, row in zip(csv.DictReader(text.splitlines()), clip.truth, strict=True):
        assert [*cells.values()] == [f"{value:.9g}" for value in row.tolist()]


class Faulty(Approach):
    """A cube whose third frame cannot be drawn."""

    def patches(self, index):
        if index == 2:
            raise self.fault
        return super().patches(index)


@pytest.mark.parametrize("lossless", [False, True])
@pytest.mark.parametrize("fault", [OutputError("here", "no"), IndexError(), KeyboardInterrupt()])
def test_an_error_leaves_what_was_there_and_nothing_half_made(
    tmp_path, monkeypatch, lossless, fault
):
    cube = SCENES["looming-cube"]
    dlgmd_cli.synth(cube.name, tmp_path / "old", lossless=lossless, **SMALL)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "old").iterdir()}
    monkeypatch.setattr(Faulty, "fault", fault, raising=False)
    faulty = Faulty(cube.name, "")
    monkeypatch.setitem(SCENES, cube.name, faulty)
    options = {"lossless": lossless, "overwrite": True, **SMALL}
    for folder in ("old", "new"):
        with pytest.raises(type(fault)):
            dlgmd_cli.synth(cube.name, tmp_path / folder, **options)
    assert not (tmp_path / "new").exists()
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "old").iterdir()} == before


def test_what_exists_is_replaced_only_when_told(tmp_path):
    dlgmd_cli.synth("looming-cube", tmp_path, **SMALL)
    with pytest.raises(OutputExistsError, match="already exists"):
        dlgmd_cli.synth("looming-cube", tmp_path, **SMALL)
    dlgmd_cli.synth("looming-cube", tmp_path, overwrite=True, size="64x48", frames=3)
    assert names(tmp_path) == ["looming-cube.avi", "looming-cube.csv"]
    assert len(decoded(tmp_path / "looming-cube.avi")) == 3
    other = {"lossless": False, "size": "64x48", "frames": 4}
    with pytest.raises(OutputExistsError, match=r"looming-cube.avi"):
        dlgmd_cli.synth("looming-cube", tmp_path, **other)
    dlgmd_cli.synth("looming-cube", tmp_path, overwrite=True, **other)
    assert names(tmp_path) == ["looming-cube.csv", "looming-cube.mp4"]


def test_the_truth_of_an_earlier_clip_never_stands_beside_the_images_of_a_later_one(
    tmp_path, monkeypatch
):
    dlgmd_cli.synth("looming-cube", tmp_path, size="32x16", frames=3)
    arrived, replace, truth = [], Path.replace, tmp_path / "looming-cube.csv"

    def watched(self, target):
        if Path(target).parent == tmp_path:
            arrived.append((Path(target).name, truth.exists()))
        return replace(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", watched)
        dlgmd_cli.synth("looming-cube", tmp_path, size="32x16", frames=4, overwrite=True)
    assert arrived == [("looming-cube.avi", False), ("looming-cube.csv", False)]


# The same every time


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
