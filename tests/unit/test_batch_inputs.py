"""The videos below folders, and what the folders of their results are called."""

import os
import posixpath
import sys

import cv2
import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from matplotlib.figure import Figure

from dlgmd_cli.errors import SourceError
from dlgmd_cli.results.store import failure_text, place
from dlgmd_cli.tasks.batch.batch import SUMMARY_COLUMNS, SummaryFile
from dlgmd_cli.tasks.batch.find import find_videos, result_folders
from dlgmd_cli.tasks.batch.video import VideoRow

LINKS = pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")


def tree(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def find(*roots, leave_out=()):
    return find_videos([str(root) for root in roots], leave_out)


def names(found):
    return [video.name for video in found.videos]


def test_videos_are_told_by_their_extensions(tmp_path):
    tree(tmp_path, "b.MP4", "a/x.mkv", "a/b/c/y.webm", "n.txt", "labels.csv", "mp4", "z.mp4.part")
    found = find(tmp_path)
    assert names(found) == ["a/b/c/y.webm", "a/x.mkv", "b.MP4"]
    assert [video.folder for video in found.videos] == ["a/b/c/y", "a/x", "b"]
    assert all(os.path.isabs(video.path) for video in found.videos)
    assert found.videos[0].identity["bytes"] == 0
    assert found.remarks == found.faults == []


def test_a_root_may_be_a_file_of_any_name(tmp_path):
    tree(tmp_path, "clip.bin")
    assert names(find(tmp_path / "clip.bin")) == ["clip.bin"]
    for bad in (tmp_path / "none", "a\0b"):
        with pytest.raises(SourceError, match="cannot be read"):
            find(bad)


def test_several_roots(tmp_path):
    tree(tmp_path, "one/x.mp4", "two/x.mp4", "two/three/y.mp4", "four/x.mp4", "4/one/z.mp4")
    found = find(tmp_path / "one", tmp_path / "two", tmp_path / "two/three", tmp_path / "one")
    assert names(found) == ["one/x.mp4", "two/three/y.mp4", "two/x.mp4"]
    assert found.remarks == [f"{tmp_path / 'two/three'}: left out, already searched"]
    found = find(tmp_path / "4/one", tmp_path / "one", tmp_path / "four/x.mp4")
    parent = tmp_path.name
    assert names(found) == ["4/one/z.mp4", f"{parent}/one/x.mp4", "x.mp4"]


def test_hidden_ones_are_left_out(tmp_path):
    tree(tmp_path, ".x.mp4", "._y.mp4", ".git/z.mp4", "a/.b/c.mp4", "v.mp4")
    assert names(find(tmp_path)) == ["v.mp4"]


def sequence(folder, n, size=(8, 6), ending="png"):
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(n):
        cv2.imwrite(str(folder / f"{number}.{ending}"), np.zeros(size, np.uint8))
    return folder


def test_folders_of_pictures_are_videos(tmp_path):
    sequence(tmp_path / "a/frames.v1", 8)
    sequence(tmp_path / "few", 7)
    sequence(tmp_path / "mixed", 8)
    tree(tmp_path / "mixed", "notes.txt")
    sequence(sequence(tmp_path / "outer", 8) / "inner", 9, ending="jpg")
    sizes = sequence(tmp_path / "sizes", 8)
    sequence(sizes, 1, (6, 8))
    tree(tmp_path / "broken", *(f"{number}.png" for number in range(8)))
    (tmp_path / "figures").mkdir()
    figure = Figure((1, 1))
    for number in range(8):
        figure.savefig(tmp_path / f"figures/{number}.png")
    found = find(tmp_path)
    assert names(found) == ["a/frames.v1", "outer/inner"]
    assert [video.folder for video in found.videos] == ["a/frames", "outer/inner"]
    assert found.videos[0].identity["pictures"] == 8
    reasons = {"broken": "cannot be read", "figures": "are figures"}
    reasons |= {"mixed": "such as notes.txt", "outer": "such as inner", "sizes": "not of one size"}
    remarks = sorted(found.remarks)
    assert len(remarks) == len(reasons)
    for remark, (name, why) in zip(remarks, reasons.items(), strict=True):
        assert remark.startswith(f"{tmp_path / name}: left out") and why in remark
    assert names(find(tmp_path / "a/frames.v1")) == ["frames.v1"]


def test_what_is_excluded(tmp_path):
    tree(tmp_path, "raw/x.mp4", "a/raw/y.mp4", "a/y.mp4", "b/rawest.mp4", "b/z.mp4")
    found = find_videos([str(tmp_path)], exclude=["raw/", "b/z*", "no*"])
    assert names(found) == ["a/y.mp4", "b/rawest.mp4"]
    assert found.remarks == [
        "exclude 'raw' left out 2 files or folders",
        "exclude 'b/z*' left out 1 file or folder",
        "exclude 'no*' left out nothing",
    ]


@LINKS
def test_a_real_folder_comes_before_a_link_that_is_named_first(tmp_path):
    tree(tmp_path, "real/x.mp4")
    (tmp_path / "link").symlink_to("real")
    found = find(tmp_path / "link", tmp_path / "real")
    assert names(found) == ["real/x.mp4"]
    assert found.remarks == [f"{tmp_path / 'link'}: left out, already searched"]


@LINKS
def test_links_are_followed_once_and_after_what_is_real(tmp_path):
    flights, elsewhere = tmp_path / "flights", tmp_path / "elsewhere"
    tree(flights, "a/x.mp4", "b/real/z.mp4")
    tree(elsewhere, "y.mp4")
    (flights / "a" / "up").symlink_to(flights)
    (flights / "a" / "self").symlink_to("self")
    (flights / "a" / "early").symlink_to(flights / "b" / "real")
    (flights / "linked").symlink_to(elsewhere)
    (flights / "more").symlink_to(elsewhere)
    (flights / "same.mp4").symlink_to("a/x.mp4")
    (flights / "dangling.mp4").symlink_to("none")
    found = find(flights)
    assert names(found) == [
        *("a/x.mp4", "b/real/z.mp4", "dangling.mp4", "linked/y.mp4", "same.mp4")
    ]
    assert [video.identity == {} for video in found.videos] == [False, False, True, False, False]
    assert found.remarks == [
        f"{flights / path}: left out, already searched" for path in ("a/early", "a/up", "more")
    ]


def test_results_are_not_searched(tmp_path):
    tree(tmp_path, "x.mp4", "dlgmd-out/x/layers.mp4")
    assert names(find(tmp_path, leave_out=[tmp_path / "dlgmd-out"])) == ["x.mp4"]
    both = ["dlgmd-out/x/layers.mp4", "x.mp4"]
    assert names(find(tmp_path, leave_out=[tmp_path])) == both  # it was asked for
    assert names(find(tmp_path, leave_out=[tmp_path / "none"])) == both


def test_a_deep_tree(tmp_path):
    folder = tmp_path
    for _ in range(300):
        folder = folder / "d"
        folder.mkdir()
    (folder / "x.mp4").touch()
    assert len(find(tmp_path).videos) == 1


def test_results_of_one_name(tmp_path):
    for folders in (
        {"a/x.mp4": "a/x.mp4", "a/x.avi": "a/x.avi", "b/x.mp4": "b/x"},
        {"x.mp4": "x.mp4", "x/y.mp4": "x/y"},  # a folder of that name
        {"x.mp4": "x.mp4 (2)", "X.mp4": "X.mp4"},
        {"\u00e9.mp4": "\u00e9.mp4 (2)", "e\u0301.mp4": "e\u0301.mp4"},
        {"x.avi.mp4": "x.avi", "x.avi": "x.avi (2)", "x.mp4": "x.mp4"},
        {"summary.csv.mp4": "summary.csv.mp4", "a/summary.csv.mp4": "a/summary.csv"},
    ):
        assert result_folders(folders) == folders
    tree(tmp_path, "a/x.mp4", "a/x.avi")
    assert find(tmp_path).remarks == [
        f"a/x.{kind}: the result folder is a/x.{kind}: another video has the same name"
        for kind in ("avi", "mp4")
    ]


_PARTS = st.text(st.sampled_from("aA.b \\~ß\n-"), min_size=1, max_size=4).filter(
    lambda part: part not in (".", "..")
)
_PATHS = st.lists(
    st.lists(_PARTS, min_size=1, max_size=3).map("/".join), min_size=1, max_size=12, unique=True
)


@given(_PATHS)
@example(["A/A", "a/A"])
def test_results_are_apart_and_within_the_tree(paths):
    folders = {path[: path.rindex("/")] for path in paths if "/" in path}
    videos = [
        path for path in paths if not any(f"{folder}/".startswith(f"{path}/") for folder in folders)
    ]
    results = result_folders(videos)
    assert set(results) == set(videos)
    folded = [result.casefold() for result in results.values()]
    assert len(set(folded)) == len(folded)
    for result in folded:
        parts = result.split("/")
        assert posixpath.normpath(result) == result and not result.startswith(("/", "../"))
        assert not any(part.startswith(".") or "\\" in part for part in parts)
        assert not any(other.startswith(f"{result}/") for other in folded)


def test_distinct_folders_for_keys_in_a_bucket():
    folders = result_folders(["a\\b/x.avi", "a_b/x.avi", "a_b/x.mp4", "/y.avi", "video/y.avi"])
    assert len(set(folders.values())) == 5
    assert not any(".." in one or one.startswith("/") or "//" in one for one in folders.values())


def row(**more):
    record = {
        "input": {"frames": 20, "width": 4, "height": 3, "fps": 25.0, "duration_s": 0.8},
        "summary": {"mp_max": -1.5, "mp_max_frame": 3, "spikes": 0, "alarms": 0, **more},
    }
    return VideoRow("done", record=record, wall_s=1.23456)


def written(tmp_path, rows):
    import csv

    summary = SummaryFile(tmp_path)
    summary.rows.update(rows)
    summary.write()
    with (tmp_path / "summary.csv").open(newline="", encoding="utf-8") as file:
        header, *cells = csv.reader(file)
    assert tuple(header) == SUMMARY_COLUMNS
    return cells


def test_cells_of_the_summary(tmp_path):
    hostile = ("=cmd|'/C calc'!A0.mp4", "a,b\x1b[2J\n.mp4", "-1.mp4", "@x.mp4", "plain.mp4")
    rows = dict.fromkeys(hostile, row(mean_attenuation_db=-12.5))
    rows["bad.mp4"] = VideoRow("failed", "=HYPERLINK(1)\nmore", wall_s=0.5)
    odd = {"frames": "=1+1", "fps": [1]}
    record = {"input": odd, "summary": {}, "warnings": ["=1", "b"]}
    rows["odd.mp4"] = VideoRow("done", record=record)
    cells = written(tmp_path, rows)
    assert [one[0] for one in cells] == [
        "./-1.mp4",
        "./=cmd|'/C calc'!A0.mp4",
        "./@x.mp4",
        "a,b\\x1b[2J\\n.mp4",
        "bad.mp4",
        "odd.mp4",
        "plain.mp4",
    ]
    numbers = ["20", "4", "3", "25", "0.8", "-1.5", "3", "0", "0", "", "", "", "-12.5"]
    numbers += ["", "", "", "", "", "1.235"]
    assert cells[-1][1:] == ["done", "", "", *numbers]
    assert cells[-2] == ["odd.mp4", "done", "", "=1; b".replace("=", "./="), *[""] * 19]
    assert cells[-3] == ["bad.mp4", "failed", "./=HYPERLINK(1)\\nmore", *[""] * 19, "0.5"]


def test_writing_takes_a_small_share_of_the_time(tmp_path, monkeypatch):
    clock, written = [0.0], []
    monkeypatch.setattr("dlgmd_cli.tasks.batch.batch.time.monotonic", lambda: clock[0])
    summary = SummaryFile(tmp_path)

    def commit(claim, files):
        written.append(clock[0])
        clock[0] += 0.1

    monkeypatch.setattr("dlgmd_cli.results.store.ClaimedFolder.commit", commit)
    for second in range(20):
        clock[0] = max(clock[0], float(second))
        summary.write(at_once=False)
    assert len(written) <= 10
    summary.write()
    assert written[-1] == pytest.approx(19.0, abs=0.2)


def test_places_and_reasons(tmp_path):
    assert place(f"file://{tmp_path}/x") == tmp_path / "x"
    assert failure_text(OSError(28, "No space left")) == "No space left"
    assert failure_text(FileNotFoundError("bucket/x")) == "no such file or folder"
    assert failure_text(ValueError("a\n  b.")) == "a b"
    assert failure_text(ValueError()) == "ValueError"
