"""`evaluate --results`: each video is scored with its own result, wherever both are, or refused."""

import shutil

import numpy as np
import pytest
from conftest import csv_rows, looming_frames, write_video

pytestmark = pytest.mark.usefixtures("here")

LOOM = looming_frames(30, 64, 48)
STILL = [np.full((48, 64), 100, np.uint8)] * 30
QUIET = ("--format=none", "--no-baselines", "--out", "ev", "--overwrite")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Two days with a video v.avi each: the first one looms, in the other nothing happens."""
    folder = tmp_path_factory.mktemp("days")
    for day, frames in (("day1", LOOM), ("day2", STILL)):
        (folder / day).mkdir()
        write_video(folder / day / "v.avi", frames)
    return folder


@pytest.fixture
def days(made, tmp_path, dlgmd):
    """A copy of them in the working folder, with the results of the first day in `res`."""
    shutil.copytree(made, tmp_path, dirs_exist_ok=True)
    batch("res", "day1", dlgmd)
    return tmp_path


def batch(out, folder, runs):
    options = ("--set", 9, "--jobs", 1, "--repeats", "keep", "--format=none", "--out", out)
    runs("batch", folder, *options)


def scores(dlgmd, labels, text, results="res"):
    """The result of the command for a table of labels."""
    labels.write_text(f"video,collision_frame\n{text}")
    return dlgmd("evaluate", labels, "--results", results, *QUIET)


def videos():
    return int(csv_rows("ev/evaluate.csv")[0]["videos"])


def test_another_video_of_the_name_is_not_scored_with_this_result(days, dlgmd):
    result = scores(dlgmd, days / "day2/labels.csv", "v.avi,29\n")
    assert result.exit_code == 1 and "v.avi: there is no result of v.avi" in result.stderr
    assert scores(dlgmd, days / "day1/labels.csv", "v.avi,29\n").exit_code == 0


def test_labels_in_the_folder_above_a_batch_find_its_results(days, dlgmd):
    assert scores(dlgmd, days / "labels.csv", "day1/v.avi,29\n").exit_code == 0
    batch("both", ".", dlgmd)
    text = "day1/v.avi,29\nday2/v.avi,\n"
    assert scores(dlgmd, days / "labels.csv", text, "both").exit_code == 0 and videos() == 2


def test_a_link_to_the_folder_is_the_folder(days, dlgmd):
    (days / "link").symlink_to("day1")
    assert scores(dlgmd, days / "labels.csv", "link/v.avi,29\n").exit_code == 0


def test_a_video_that_was_moved_is_found_by_its_content(days, dlgmd):
    (days / "day1").rename(days / "archive")
    assert scores(dlgmd, days / "archive/labels.csv", "v.avi,29\n").exit_code == 0
    # A copy is the same video, another one of its size is not.
    shutil.copytree(days / "archive", days / "day1")
    assert scores(dlgmd, days / "archive/labels.csv", "v.avi,29\n").exit_code == 0
    data = (days / "archive/v.avi").read_bytes()
    (days / "archive/v.avi").write_bytes(data[:-1] + bytes([data[-1] ^ 1]))
    result = scores(dlgmd, days / "archive/labels.csv", "v.avi,29\n")
    assert result.exit_code == 1 and "there is no result of v.avi" in result.stderr
    # And nothing tells whose a result is if no video is left.
    shutil.rmtree(days / "day1")
    (days / "archive/v.avi").unlink()
    result = scores(dlgmd, days / "archive/labels.csv", "v.avi,29\n")
    assert result.exit_code == 1 and "there is no result of v.avi" in result.stderr
    # The path that is recorded is enough.
    assert scores(dlgmd, days / "labels.csv", "day1/v.avi,29\n").exit_code == 0


def test_a_video_that_was_replaced_is_refused(days, dlgmd):
    video = days / "day1/v.avi"
    whole = video.read_bytes()
    shutil.copy(days / "day2/v.avi", video)
    result = scores(dlgmd, days / "day1/labels.csv", "v.avi,29\n")
    assert result.exit_code == 1
    assert "v.avi is not the video of its result: it has another size" in result.stderr
    video.write_bytes(whole[:-1] + b"x")
    result = scores(dlgmd, days / "day1/labels.csv", "v.avi,29\n")
    assert result.exit_code == 1
    why = "v.avi is not the video of its result: it was changed later. Run 'dlgmd batch' again."
    assert why in result.stderr
    batch("res", "day1", dlgmd)
    assert scores(dlgmd, days / "day1/labels.csv", "v.avi,29\n").exit_code == 0


def test_a_column_that_stands_twice_is_an_error(days, dlgmd, runs):
    labels = days / "day1/labels.csv"
    labels.write_text("video,collision_frame,collision_frame\nv.avi,29,5\n")
    result = dlgmd("evaluate", labels, "--results", "res", *QUIET)
    assert result.exit_code == 1
    assert "labels.csv: has the column collision_frame twice. Remove one" in result.stderr
    # Spreadsheets leave empty columns, and those of others do not matter.
    labels.write_text("video,collision_frame,,,note,note\nv.avi,29,,,a,b\n")
    runs("evaluate", labels, "--results", "res", *QUIET)
