"""Clips around alarms: the right frames, copied or encoded, and none of another's is lost."""

import cv2
import numpy as np
import pytest
from conftest import csv_rows, looming_frames, read_video, write_video

from dlgmd_cli.errors import OutputExistsError, SourceError
from dlgmd_cli.tasks.call import clips_written
from dlgmd_cli.video.writer import refuse_clips

pytest.importorskip("av", reason="copies need PyAV")
FPS, N = 20.0, 200


def frames():
    """Frame k shows its number as a bar: k cells of 200 are bright."""
    for k in range(N):
        image = np.full((48, 400), 40, np.uint8)
        image[:, : 2 * k] = 200
        yield image


def write_clips(*asked):
    """The clips that are written."""
    with clips_written(*asked) as made:
        return made


def numbers(path):
    """Which frames a clip shows, and its frame rate."""
    fps, pictures = read_video(path)
    return [round((one[24, :, 1] > 120).sum() / 2) for one in pictures], fps


@pytest.fixture(scope="module", params=["copied", "encoded", "pictures"])
def source(request, tmp_path_factory):
    """The path of a video of 10 s, and the frame with which a clip from frame 40 on may begin."""
    folder = tmp_path_factory.mktemp("source")
    if request.param == "copied":
        return str(write_video(folder / "a.mp4", list(frames()), FPS, "mp4v")), 20
    if request.param == "encoded":
        return str(write_video(folder / "a.avi", list(frames()), FPS)), 40
    for k, image in enumerate(frames()):
        cv2.imwrite(str(folder / f"{k:03d}.png"), image)
    return str(folder), 40


def test_a_clip_is_from_2_s_before_to_1_s_after(source, tmp_path):
    path, earliest = source
    made = write_clips(path, "a", [4.0, 4.5, 0.52, 9.9], tmp_path / "clips", {"input_fps": FPS})
    names = ["a-alarm1-4.00s", "a-alarm2-4.50s", "a-alarm3-0.52s", "a-alarm4-9.90s"]
    assert [one.stem for one in made] == names and sorted((tmp_path / "clips").iterdir()) == made
    shown, fps = zip(*map(numbers, made), strict=True)
    assert fps == pytest.approx([FPS] * 4)
    spans = [(40, 100), (50, 110), (0, 31), (158, 200)]
    for found, (first, end) in zip(shown, spans, strict=True):
        assert first - (40 - earliest) <= found[0] <= first
        assert found == list(range(found[0], found[-1] + 1)) and end - 1 <= found[-1] <= end
    assert (earliest < 40) == (shown[0][0] < 40)  # the key frame is not at frame 40


def test_only_clips_of_the_same_name_are_replaced(clips, tmp_path):
    folder = tmp_path / "clips"
    folder.mkdir()
    others = ["loom-alarm1-0.40s.mp4.txt", "bloom-alarm1-0.40s.mp4", "loom-alarmed-0.40s.mp4"]
    for name in [*others, "loom-alarm7-0.10s.mp4"]:
        (folder / name).write_text("")
    with pytest.raises(OutputExistsError, match="alarm7"):
        refuse_clips(folder, "loom")
    with pytest.raises(SourceError):
        write_clips(__file__, "loom", [0.4], folder)
    assert {path.name for path in folder.iterdir()} == {*others, "loom-alarm7-0.10s.mp4"}
    write_clips(str(clips / "loom.avi"), "loom", [0.4], folder)
    assert {path.name for path in folder.iterdir()} == {*others, "loom-alarm1-0.40s.mp4"}
    write_clips(str(clips / "loom.avi"), "loom", [], folder)
    assert {path.name for path in folder.iterdir()} == set(others)


ALARMED = ("--set", 9, "--normalise", "sequence", "--param", "n_sp=1", "--format=none")


def test_run_and_batch_write_clips(dlgmd, runs, tmp_path, here):
    (tmp_path / "in/day1").mkdir(parents=True)
    write_video(tmp_path / "in/day1/loom.avi", looming_frames())
    for n in range(2):
        options = ("--clips", "clips", "--out", f"out{n}", "-q")
        made = dlgmd("run", "in/day1/loom.avi", *ALARMED, *options)
        assert made.stderr == "" or n, "nothing but errors"
        assert made.exit_code == (2 if n else 0), made.output
    assert "already exists" in made.stderr and not (tmp_path / "out1").exists()
    (alarm,) = csv_rows(tmp_path / "out0/loom/alarms.csv")
    name = f"loom-alarm1-{float(alarm['start_s']):.2f}s.mp4"
    assert [path.name for path in (tmp_path / "clips").iterdir()] == [name]
    # The clips, in a folder that is searched, are no videos of the batch.
    batch = ("batch", "in", *ALARMED, "--clips", "in/clips", "--jobs", 1)
    assert "1 video: 1 done" in dlgmd(*batch).stdout
    assert (tmp_path / "in/clips/day1" / name).is_file()
    assert "1 video: 1 done (1 before)" in dlgmd(*batch).stdout
    other = dlgmd(*batch, "--out", "other")
    assert other.exit_code == 2 and "already exists" in other.stderr
    models = ("batch", "in/day1", "--model", "lgmd", *ALARMED, "--out", "both")
    runs(*models, "--set", "flight", "--clips", "three", "--jobs", 1)
    assert (tmp_path / "three/set9" / name).is_file()


def test_a_video_whose_clips_cannot_be_written_is_not_done(dlgmd, tmp_path, here):
    write_video(tmp_path / "loom.avi", looming_frames())
    (tmp_path / "file").touch()
    batch = ("batch", "loom.avi", *ALARMED, "--jobs", 1, "--clips")
    failed = dlgmd(*batch, "file/clips")
    assert failed.exit_code == 1 and "cannot be written (Not a directory)" in failed.stderr
    assert "1 video: 1 done, 1 with alarms" in dlgmd(*batch, "clips").stdout
    assert len(list((tmp_path / "clips").iterdir())) == 1


def test_clips_appear_only_with_what_they_belong_to(clips, tmp_path):
    with (
        pytest.raises(ZeroDivisionError),
        clips_written(str(clips / "loom.avi"), "a", [0.4], tmp_path),
    ):
        raise ZeroDivisionError
    assert not list(tmp_path.iterdir())
