"""`dlgmd layers`: its files, options, errors and exit codes."""

import os
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import FPS, looming_frames, read_video, result_of_level, yaml_of

from dlgmd_cli import DLGMD, layers, load_set, open_video, read_result
from dlgmd_cli.plots.film import Film
from dlgmd_cli.tasks.layers import strongest_frames, telling_frames

NAN = np.nan


def record(folder="dlgmd-out/loom"):
    return yaml_of(Path(folder, "layers.yaml"))


def test_arrays_are_the_library_s(runs, clips):
    arguments = ("--frames", "0,2,19", "--npz", "--set", 7)
    runs("layers", clips / "loom.avi", *arguments)
    assert set(os.listdir("dlgmd-out/loom")) == {"layers.yaml", "layers.npz"}
    model, expected = DLGMD(load_set(7)), {}
    with open_video(clips / "loom.avi") as video:
        for frame in video:
            response = model.step(frame.grey, layers=True)
            expected[frame.index] = frame, response.layers
    with np.load("dlgmd-out/loom/layers.npz", allow_pickle=False) as arrays:
        assert set(arrays) == {"frame", "time_s", "luminance", "p", "s", "g", "units"}
        assert arrays["frame"].tolist() == [0, 2, 19]
        assert arrays["units"].tolist() == list(DLGMD.layer_units)
        for row, number in enumerate((0, 2, 19)):
            frame, layers = expected[number]
            assert arrays["time_s"][row] == frame.time_s
            assert np.array_equal(arrays["luminance"][row], frame.luminance)
            for name in "psg":
                layer = getattr(layers, name)
                wanted = np.full(frame.grey.shape, np.nan) if layer is None else layer
                assert np.array_equal(arrays[name][row], wanted, equal_nan=True)
        assert np.isnan(arrays["p"][0]).all() and arrays["g"][2].max() > 0


def test_the_strongest_frames_are_chosen_unless_given(dlgmd, runs, clips):
    runs("run", clips / "loom.avi", "--set", 4)
    strength = np.nan_to_num(read_result("dlgmd-out/loom").mp)
    result = runs("layers", clips / "loom.avi", "--set", 4, "--npz")
    assert result.stderr == ""
    frames = record()["frames"]
    assert frames == sorted(np.argsort(-strength)[: len(frames)].tolist()) and len(frames) > 1
    with np.load("dlgmd-out/loom/layers.npz") as arrays:
        assert arrays["frame"].tolist() == frames
    assert dlgmd("layers", clips / "short.avi", "--set", 4).exit_code == 1


def test_an_approach_is_shown_from_its_alarm_to_the_contact():
    level = np.full(90, 0.01)
    level[30:60], level[52:57], level[70:] = 0.5, 0.6, 0.9  # the approach; the recoil
    result = result_of_level(level)
    onset = int(result.frame[result.alarm_onsets[0]])
    assert telling_frames(result, contact=61) == (onset, 39, 46, 53, 61)
    assert telling_frames(result_of_level(level[:60])) == (onset, 36, 41, 47, 52)
    assert telling_frames(result, contact=20) == strongest_frames(result_of_level(level[:21]))
    result.record["input"]["contact_s"] = 61 / FPS  # of a rendered clip
    assert telling_frames(result) == (onset, 39, 46, 53, 61)


def test_strong_frames_are_spread_out_where_many_respond():
    level = np.concatenate((np.full(20, 1e-5), 0.5 + 0.2 * np.sin(np.arange(100) / 16)))
    frames = strongest_frames(result_of_level(level), 4)
    assert 20 + round(16 * np.pi / 2) in frames and len(frames) == 4
    assert min(np.diff(frames)) >= 100 // 8 and min(frames) >= 20
    assert strongest_frames(result_of_level(np.zeros(9)), 3) == (0, 4, 8)
    assert strongest_frames(result_of_level([NAN, 0.0]), 3) == (0, 1)


def test_no_frame_after_contact_or_without_a_picture_is_chosen():
    level = np.full(60, 0.1)
    level[[10, 20, 30, 34, 50]] = [0.5, 0.8, 0.6, 0.6, 0.9]  # 20 to 30: black, 50: the recoil
    result, fps = result_of_level(level), 25
    frames = telling_frames(result, contact=45, blind_s=[(20 / fps, 29 / fps)])
    assert 10 in frames and max(frames) <= 45 and not set(range(20, 35)) & set(frames)
    assert telling_frames(result, contact=-1) == telling_frames(result)


def test_collisions_are_those_given_or_listed(runs, clips):
    shutil.copy(clips / "loom.avi", "loom.avi")
    arguments = ("layers", "loom.avi", "--set", 4, "--format=none", "--overwrite")
    runs(*arguments)
    assert max(record()["frames"]) > 12
    Path("labels.csv").write_text("video,collision_frame\nloom.avi,15\nloom.avi,12\n")
    for options in ({"collision_frame": 12}, {"collisions": "labels.csv"}):
        found = layers("loom.avi", model=4, **options)
        assert max(found.result.record["frames"]) <= 12
    Path("loom.csv").write_text(f"time_s,time_to_contact_s\n0,{12 / FPS}\n")
    assert runs(*arguments).stderr == "" and max(record()["frames"]) <= 12


@pytest.mark.parametrize(
    ("options", "warning", "shown"),
    [
        (
            ["--frames", "5,20,99999"],
            "20 frames that were processed is frame 20, 99999;",
            [5],
        ),
        (
            ["--frames", "0,3,4", "--config", "slow.yaml"],
            "2 frames that were processed is frame 3, 4; --start",
            [0],
        ),
    ],
)
def test_frames_that_are_not_there_are_named(runs, clips, options, warning, shown):
    Path("slow.yaml").write_text("preset: flight\noptions: {fps: 5}\n")
    result = runs("layers", clips / "loom.avi", *options)
    assert f"Warning: {clips / 'loom.avi'}: none of the {warning}" in result.stderr
    assert record()["frames"] == shown
    assert any(line in result.stderr for line in record()["warnings"])


def test_a_film_at_the_rate_of_what_was_processed(runs, clips, monkeypatch):
    """Its images are those of the frames and layers, in order, on scales that hold them all."""
    seen, scales, picture = [], [], Film.picture

    def recording(self, row, luminance, s, g):
        highest = [0.0 if layer is None else float(layer.max()) for layer in (s, g)]
        seen.append((row, float(luminance.mean()), *highest))
        scales[:] = [scale.high for scale in self._scales]
        return picture(self, row, luminance, s, g)

    monkeypatch.setattr(Film, "picture", recording)
    Path("half.yaml").write_text("preset: flight\noptions: {fps: 12.5}\n")
    arguments = ("--video", "film.mp4", "--config", "half.yaml")
    result = runs("layers", clips / "loom.avi", *arguments)
    assert result.stdout == "film.mp4\n" and {*os.listdir(".")} == {"half.yaml", "film.mp4"}
    rate, film = read_video("film.mp4")
    assert rate == pytest.approx(12.5) and len(film) == 10
    assert {frame.shape for frame in film} == {(720, 1280, 3)}
    assert [row for row, *_ in seen] == list(range(10))
    assert seen[0][1] > seen[-1][1] + 0.1  # the dark square grows
    assert scales == [max(highest) for highest in list(zip(*seen, strict=True))[2:]]
    assert min(scales) > 0


def test_an_overlay_is_the_input_with_active_cells_and_a_banner(runs):
    """Images have an odd number of rows and columns, the film an even one."""
    looming = [cv2.resize(frame, (161, 121)) for frame in looming_frames()]
    os.mkdir("loom")
    for number, frame in enumerate(looming):
        cv2.imwrite(f"loom/{number}.png", frame)
    Path("images.yaml").write_text("set: 4\noptions: {input_fps: 25}\n")
    model = ("--config", "images.yaml", "--param", "t_mp=0.01")
    result = runs("layers", "loom", "--video", "film.mp4", "--overlay", *model, plots=True)
    assert result.stdout == "film.mp4\n"
    _, film = read_video("film.mp4")
    assert len(film) == 20 and film[0].shape == (122, 162, 3)
    runs("run", "loom", *model)
    alarms = read_result("dlgmd-out/loom").alarms
    blue, _, red = np.array([frame[3, 8:40].mean(axis=0) for frame in film]).T
    assert alarms.any() and not alarms.all()
    assert np.array_equal((red > 180) & (blue < 60), alarms)
    scene = np.s_[20:100, :140]  # between the banner, the legend and the bar of MP
    colour = [int(np.ptp(frame[scene].astype(int), axis=2).max()) for frame in film]
    assert max(colour[:3]) < 40 < 100 < max(colour)
    assert np.abs(film[2][scene].mean(axis=2) - looming[2][scene]).mean() < 4


def test_what_is_doubtful_about_a_film_is_said(runs, tmp_path):
    for number in range(6):
        cv2.imwrite(str(tmp_path / f"{number}.png"), looming_frames(1)[0])
    Path("look.yaml").write_text(
        "preset: flight\noptions: {normalise: sequence, input_fps: 5000}\n"
    )
    look = ("--overlay", "--config", "look.yaml")
    arguments = ("--video", "film.mp4", *look)
    result = runs("layers", "%d.png", *arguments)
    assert len(read_video("film.mp4")[1]) == 6
    assert "film.mp4 plays at 240 frames a second, not at 5000." in result.stderr
    assert "all frames are the same" in result.stderr
    assert "cannot be scaled by its per-video min–max" in result.stderr


def test_sheet_and_film_come_from_one_command(dlgmd, runs, clips):
    arguments = ("--frames", "1,30", "--video", "new/film.mp4", "--format=none", "--set", 9)
    result = runs("layers", clips / "loom.avi", *arguments, "--end", 0.3)
    folder, film = result.stdout.splitlines()
    assert folder == os.path.join("dlgmd-out", "loom") and record()["frames"] == [1]
    assert record()["input"]["frames"] == len(read_video(film)[1]) == 8
    assert Path(film) == Path("new/film.mp4") and os.listdir("new") == ["film.mp4"]
    result = dlgmd("layers", clips / "short.avi", *arguments, "--overwrite")
    assert result.exit_code == 1 and result.stdout == os.path.join("dlgmd-out", "short") + "\n"
    assert "3 frames, but set9 needs at least 4. Use a longer clip." in result.stderr


def test_a_film_does_not_replace_the_input(dlgmd, clips):
    data = (clips / "loom.mp4").read_bytes()
    Path("loom.mp4").write_bytes(data)
    result = dlgmd("layers", "loom.mp4", "--video", "./loom.mp4", "--overwrite")
    assert result.exit_code == 2 and "--video would replace INPUT" in result.stderr
    assert Path("loom.mp4").read_bytes() == data


def test_a_film_that_cannot_be_written_is_refused_at_once(dlgmd, clips, monkeypatch):
    monkeypatch.setattr("dlgmd_cli.tasks.layers.run_layers", None)
    Path("file").touch()
    result = dlgmd("layers", clips / "loom.avi", "--video", "file/x.mp4")
    assert result.exit_code == 1 and "Choose another --video" in result.stderr
    Path("folder.mp4").mkdir()
    result = dlgmd("layers", clips / "loom.avi", "--video", "folder.mp4", "--overwrite")
    assert result.exit_code == 2 and "Choose another --video." in result.stderr
    film = "dlgmd-out/loom/film.mp4"
    result = dlgmd("layers", clips / "loom.avi", "--frames", "5", "--video", film)
    assert result.exit_code == 2 and "--video lies in" in result.stderr
    assert not os.path.exists("dlgmd-out")


def test_a_film_that_finds_no_room(dlgmd, clips, monkeypatch):
    monkeypatch.setattr("dlgmd_cli.video.writer.count_frames", lambda path: 7)
    options = ("--frames", "3", "--format=none", "--end", "0.3", "--overlay")
    result = dlgmd("layers", clips / "loom.avi", "--video", "film.mp4", *options)
    assert result.exit_code == 1 and result.stdout == os.path.join("dlgmd-out", "loom") + "\n"
    assert "film.mp4: only 7 of 8 frames arrived on the disk." in result.stderr
    assert os.listdir(".") == ["dlgmd-out"] and record()["complete"] is True


@pytest.mark.parametrize("options", [["--frames", "15"], []])
def test_a_stop_before_the_first_of_them_writes_nothing(dlgmd, clips, stop_at, options):
    stop_at(9)
    result = dlgmd("layers", clips / "loom.avi", *options, "--video", "film.mp4", "--set", 9)
    assert result.exit_code == 130 and result.stderr == "Interrupted.\n"
    assert os.listdir(".") == []


def test_a_stop_of_the_first_pass_makes_no_film(dlgmd, clips, stop_at):
    stop_at(9)
    arguments = ("--set", 9, "--frames", "3", "--video", "film.mp4", "--format=none")
    result = dlgmd("layers", clips / "loom.avi", *arguments)
    assert result.exit_code == 130
    assert "holds 1 of 1 frames." in result.stderr
    assert os.listdir(".") == ["dlgmd-out"] and record()["complete"] is True


def test_a_film_that_is_stopped_is_whole_as_far_as_it_goes(dlgmd, clips, stop_at):
    stop_at(4, Film, "picture")
    result = dlgmd("layers", clips / "loom.avi", "--video", "film.mp4", "--set", 9)
    assert result.exit_code == 130
    assert result.stderr == "Interrupted. film.mp4 holds the first 4 of 20 frames.\n"
    assert result.stdout == "film.mp4\n" and os.listdir(".") == ["film.mp4"]
    assert len(read_video("film.mp4")[1]) == 4
