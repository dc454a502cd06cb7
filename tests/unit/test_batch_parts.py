"""What a batch is made of: the search, names of results, the summary, the tally."""

import csv
import os
import posixpath
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from queue import SimpleQueue

import pytest
from faulty import prepare as faulty_prepare
from hypothesis import example, given
from hypothesis import strategies as st

from dlgmd_cli.batch.attend import Attendant
from dlgmd_cli.batch.drive import drive
from dlgmd_cli.batch.events import Advanced, Began, Ended
from dlgmd_cli.batch.find import find_videos
from dlgmd_cli.batch.local import LocalPool
from dlgmd_cli.batch.names import result_names
from dlgmd_cli.batch.places import Folder
from dlgmd_cli.batch.resume import plan
from dlgmd_cli.batch.summary import COLUMNS, Summary
from dlgmd_cli.batch.task import DONE, FAILED, TIMEOUT, Ending, Order, Task, Variant, Video
from dlgmd_cli.commands._batch_view import Tally, failures
from dlgmd_cli.errors import OutputExistsError, SourceError, WorkerError
from dlgmd_cli.parameters import DlgmdParameters
from dlgmd_cli.results.record import parse_record, yaml_text
from dlgmd_cli.runs.worker import Worker
from dlgmd_cli.video.frames import InputOptions


def tree(folder, *names):
    for name in names:
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    return folder


def names(found):
    return [video.name for video in found.videos]


def test_videos_are_told_by_their_endings(tmp_path):
    tree(tmp_path, "b.MP4", "a/x.mkv", "a/b/c/y.webm", "n.txt", "labels.csv", "mp4", "z.mp4.part")
    found = find_videos([("", str(tmp_path))])
    assert names(found) == ["a/b/c/y.webm", "a/x.mkv", "b.MP4"]
    assert [video.result for video in found.videos] == ["a/b/c/y", "a/x", "b"]
    assert all(os.path.isabs(video.path) for video in found.videos)
    assert found.videos[0].identity["bytes"] == 0
    assert found.remarks == found.faults == []


def test_a_root_may_be_a_file_of_any_name(tmp_path):
    tree(tmp_path, "clip.bin")
    assert names(find_videos([("", str(tmp_path / "clip.bin"))])) == ["clip.bin"]
    with pytest.raises(SourceError, match="cannot be read"):
        find_videos([("", str(tmp_path / "none"))])
    with pytest.raises(SourceError, match="cannot be read"):
        find_videos([("", "a\0b")])


def test_several_roots(tmp_path):
    tree(tmp_path, "one/x.mp4", "two/x.mp4", "two/three/y.mp4")
    roots = [
        ("one", tmp_path / "one"),
        ("two", tmp_path / "two"),
        ("three", tmp_path / "two/three"),
    ]
    found = find_videos([(prefix, str(path)) for prefix, path in roots])
    assert names(found) == ["one/x.mp4", "two/three/y.mp4", "two/x.mp4"]
    assert found.remarks == [f"{tmp_path / 'two/three'}: left out, for it was searched already"]


def test_hidden_ones_are_left_out(tmp_path):
    tree(tmp_path, ".x.mp4", "._y.mp4", ".git/z.mp4", "a/.b/c.mp4", "v.mp4")
    found = find_videos([("", str(tmp_path))])
    assert names(found) == ["v.mp4"] and found.remarks == ["4 hidden files and folders left out"]
    (tmp_path / ".x.mp4").unlink()
    for name in ("._y.mp4", ".git/z.mp4"):
        (tmp_path / name).unlink()
    (tmp_path / ".git").rmdir()
    assert find_videos([("", str(tmp_path))]).remarks == ["1 hidden file or folder left out"]


@pytest.mark.skipif(sys.platform == "win32", reason="links need rights on Windows")
def test_links_are_followed_once(tmp_path):
    flights, elsewhere = tmp_path / "flights", tmp_path / "elsewhere"
    tree(flights, "a/x.mp4")
    tree(elsewhere, "y.mp4")
    (flights / "a" / "up").symlink_to(flights)
    (flights / "a" / "self").symlink_to("self")
    (flights / "linked").symlink_to(elsewhere)
    (flights / "more").symlink_to(elsewhere)
    (flights / "same.mp4").symlink_to("a/x.mp4")
    (flights / "dangling.mp4").symlink_to("none")
    found = find_videos([("", str(flights))])
    assert names(found) == ["a/x.mp4", "dangling.mp4", "linked/y.mp4", "same.mp4"]
    assert [video.identity == {} for video in found.videos] == [False, True, False, False]
    assert found.remarks == [
        f"{flights / path}: left out, for it was searched already" for path in ("a/up", "more")
    ]


def test_a_folder_that_cannot_be_read_is_said(tmp_path, refuse_folder):
    tree(tmp_path, "a/x.mp4", "b/y.mp4")
    refuse_folder("a")
    found = find_videos([("", str(tmp_path))])
    assert names(found) == ["b/y.mp4"]
    assert found.faults == [f"{tmp_path / 'a'}: this folder cannot be read (Permission denied)"]


def test_results_are_not_searched(tmp_path):
    tree(tmp_path, "x.mp4", "dlgmd-out/x/layers.mp4")
    assert names(find_videos([("", str(tmp_path))], [tmp_path / "dlgmd-out"])) == ["x.mp4"]
    # Unless that is what was asked for.
    assert names(find_videos([("", str(tmp_path))], [tmp_path])) == [
        "dlgmd-out/x/layers.mp4",
        "x.mp4",
    ]
    assert names(find_videos([("", str(tmp_path))], [tmp_path / "none"])) == [
        "dlgmd-out/x/layers.mp4",
        "x.mp4",
    ]


def test_a_deep_tree(tmp_path):
    folder = tmp_path
    for _ in range(300):
        folder = folder / "d"
        folder.mkdir()
    (folder / "x.mp4").touch()
    assert len(find_videos([("", str(tmp_path))]).videos) == 1


def test_results_of_one_name(tmp_path):
    assert result_names(["a/x.mp4", "a/x.avi", "b/x.mp4"]) == {
        "a/x.mp4": "a/x.mp4",
        "a/x.avi": "a/x.avi",
        "b/x.mp4": "b/x",
    }
    # A folder of that name, names that differ in capitals, and the summary's own.
    assert result_names(["x.mp4", "x/y.mp4"]) == {"x.mp4": "x.mp4", "x/y.mp4": "x/y"}
    assert result_names(["x.mp4", "X.mp4"]) == {"x.mp4": "x.mp4 (2)", "X.mp4": "X.mp4"}
    assert result_names(["\u00e9.mp4", "e\u0301.mp4"]) == {
        "\u00e9.mp4": "\u00e9.mp4 (2)",
        "e\u0301.mp4": "e\u0301.mp4",
    }
    assert result_names(["x.mp4", "x.avi", "x.avi.mp4"]) == {
        "x.avi.mp4": "x.avi",
        "x.avi": "x.avi (2)",
        "x.mp4": "x.mp4",
    }
    assert result_names(["summary.csv.mp4", "a/summary.csv.mp4"]) == {
        "summary.csv.mp4": "summary.csv.mp4",
        "a/summary.csv.mp4": "a/summary.csv",
    }
    tree(tmp_path, "a/x.mp4", "a/x.avi")
    assert find_videos([("", str(tmp_path))]).remarks == [
        f"a/x.{kind}: its result is in a/x.{kind}, for the shorter name is taken"
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
    results = result_names(videos)
    assert set(results) == set(videos)
    folded = [result.casefold() for result in results.values()]
    assert len(set(folded)) == len(folded)
    for result in folded:
        parts = result.split("/")
        assert posixpath.normpath(result) == result and not result.startswith(("/", "../"))
        assert not any(part.startswith(".") or "\\" in part for part in parts)
        assert not any(other.startswith(f"{result}/") for other in folded)


def ending(**summary):
    record = {
        "input": {"frames": 20, "width": 4, "height": 3, "fps": 25.0, "duration_s": 0.8},
        "summary": {"mp_max": -1.5, "mp_max_frame": 3, "spikes": 0, "collisions": 0, **summary},
    }
    return Ending(DONE, record=record, wall_s=1.23456)


def read(path):
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.reader(file))


def test_cells_of_the_summary(tmp_path):
    summary = Summary(Folder.named(str(tmp_path)))
    for name in ("=cmd|'/C calc'!A0.mp4", "a,b\x1b[2J\n.mp4", "-1.mp4", "@x.mp4", "plain.mp4"):
        summary.add(name, ending(mean_attenuation_db=-12.5))
    summary.add("bad.mp4", Ending(FAILED, "=HYPERLINK(1)\nmore", wall_s=0.5))
    summary.write()
    header, *rows = read(tmp_path / "summary.csv")
    assert tuple(header) == COLUMNS
    assert [row[0] for row in rows] == [
        "./-1.mp4",
        "./=cmd|'/C calc'!A0.mp4",
        "./@x.mp4",
        "a,b\\x1b[2J\\n.mp4",
        "bad.mp4",
        "plain.mp4",
    ]
    assert rows[-1][1:] == [
        "done",
        "",
        "20",
        "4",
        "3",
        "25",
        "0.8",
        "-1.5",
        "3",
        "0",
        "0",
        "",
        "",
        "-12.5",
        "1.235",
    ]
    assert rows[-2] == ["bad.mp4", "failed", "./=HYPERLINK(1)\\nmore", *[""] * 12, "0.500"]


def test_a_record_of_anything_is_a_row(tmp_path):
    summary = Summary(Folder.named(str(tmp_path)))
    summary.add("x", Ending(DONE, record={"input": {"frames": "=1+1", "fps": [1]}, "summary": {}}))
    summary.write()
    assert read(tmp_path / "summary.csv")[1] == ["x", "done", *[""] * 14]


def test_writing_takes_a_small_share_of_the_time(tmp_path, monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("dlgmd_cli.batch.summary.time.monotonic", lambda: clock[0])
    summary = Summary(Folder.named(str(tmp_path)))
    written = []

    def write_text(self, name, text):
        written.append(clock[0])
        clock[0] += 0.1

    monkeypatch.setattr(Folder, "write_text", write_text)
    for second in range(20):
        clock[0] = max(clock[0], float(second))
        summary.add(f"{second}", ending())
        summary.write(at_once=False)
        summary.write(at_once=False)  # nothing is new
    assert written == [0.0, pytest.approx(3.0), pytest.approx(6.0)] or len(written) <= 10
    n_before = len(written)
    summary.write()
    summary.write()
    assert len(written) == n_before + 1


@pytest.mark.skipif(sys.platform == "win32", reason="its locks are others")
def test_a_second_batch_is_kept_out(tmp_path):
    place = Folder.named(str(tmp_path))
    refused = pytest.raises(OutputExistsError, match="another 'dlgmd batch' is writing here")
    with place.locked(), refused, place.locked():
        pass
    with place.locked():
        pass
    assert list(tmp_path.iterdir()) == []


def test_a_file_system_without_locks(tmp_path, monkeypatch):
    fcntl = pytest.importorskip("fcntl")

    def unsupported(*_):
        raise OSError(95, "Operation not supported")

    monkeypatch.setattr(fcntl, "flock", unsupported)
    with Folder.named(str(tmp_path)).locked():
        pass


def task(name, n_bytes=100):
    return Task(Video(name, f"/{name}", name, {"bytes": n_bytes}), (0,))


def test_tally(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr("dlgmd_cli.commands._batch_view.time.monotonic", lambda: clock[0])
    one, two, three = task("one"), task("two", 200), task("three", 100)
    tally = Tally([one, two, three])
    assert tally.seconds_left() is None and tally.frames_per_s() == 0.0
    clock[0] = 2.0
    tally.take(Began(one))
    tally.take(Advanced(one, 10, 20))
    assert tally.running == {"one": 0.5}
    assert tally.frames_per_s() == 5.0
    assert tally.seconds_left() == pytest.approx(2.0 * 350 / 50)
    tally.take(Ended(one, {0: ending()}))
    tally.take(Ended(two, {0: Ending(FAILED, "why")}))
    assert (tally.n_done, tally.n_failed, tally.running) == (1, 1, {})
    assert tally.frames_per_s() == 10.0  # 20 frames in 2 s
    assert tally.seconds_left() == pytest.approx(2.0 * 100 / 300)
    clock[0] = 30.0
    assert tally.frames_per_s() == 0.0


def test_failures_name_models_where_they_differ():
    bad, worse = Ending(FAILED, "why."), Ending("killed", "because.")
    assert failures({0: ending(), 1: ending()}, ["a", "b"]) == []
    assert failures({0: bad}, ["a"]) == ["failed: why."]
    assert failures({0: bad, 1: bad}, ["a", "b"]) == ["failed: why."]
    assert failures({0: bad, 1: ending()}, ["a", "b"]) == ["a: failed: why."]
    assert failures({0: bad, 1: worse}, ["a", "b"]) == ["a: failed: why.", "b: killed: because."]


def test_a_worker_that_nobody_wants_any_more_ends(tmp_path):
    inbox = SimpleQueue()
    worker = Worker(faulty_prepare_none, inbox)
    assert inbox.get(timeout=30).kind == "ready"
    worker.end()
    message = inbox.get(timeout=30)
    assert message.kind == "death" and message.value.code == 0


def test_a_worker_without_a_temporary_file(monkeypatch):
    monkeypatch.setattr(tempfile, "TemporaryFile", refusing(FileNotFoundError(2, "No such")))
    inbox = SimpleQueue()
    worker = Worker(faulty_prepare_none, inbox)
    assert inbox.get(timeout=30).kind == "ready"
    worker.kill()
    assert inbox.get(timeout=30).value.last_words == ""


def test_a_task_for_a_worker_that_is_dead():
    inbox = SimpleQueue()
    worker = Worker(faulty_prepare_none, inbox)
    assert inbox.get(timeout=30).kind == "ready"
    worker.kill()
    worker.send("task")  # its pipe is closed by now
    assert inbox.get(timeout=30).kind == "death" and inbox.empty()


@pytest.mark.parametrize(
    ("module", "name", "error", "reason"),
    [
        (subprocess, "Popen", OSError(24, "Too many open files"), "Too many open files"),
        (subprocess, "Popen", BlockingIOError(11, "Try again"), "Try again"),
        (threading.Thread, "start", RuntimeError("can't start new thread"), "can't start new"),
    ],
)
def test_a_worker_that_cannot_be_started(monkeypatch, module, name, error, reason):
    monkeypatch.setattr(module, name, refusing(error))
    with pytest.raises(WorkerError, match=f"^a worker process: it cannot be started .{reason}"):
        Worker(faulty_prepare_none, SimpleQueue())


@pytest.mark.parametrize("n_possible", [0, 1, 2])
def test_as_many_workers_as_there_can_be(clips, tmp_path, monkeypatch, n_possible):
    alive = []

    class Few(Attendant):
        def __init__(self, *arguments):
            if len(alive) == n_possible:
                raise WorkerError("a worker process", "it cannot be started")
            super().__init__(*arguments)
            alive.append(self)

    monkeypatch.setattr("dlgmd_cli.batch.local.Attendant", Few)
    for number in range(5):
        shutil.copy(clips / "loom.avi", tmp_path / f"{number}.avi")
    variant = Variant("set9", DlgmdParameters(), "auto", Folder.named(str(tmp_path / "out")))
    order = Order((variant,), InputOptions(), ())
    videos = find_videos([("", str(tmp_path))]).videos
    made = plan(videos, order, force=False, overwrite=False)
    if n_possible:
        drive(made, LocalPool(order, 4), lambda event: None)
        assert [one.status for one in made.summaries[0].endings.values()] == [DONE] * 5
    else:
        with pytest.raises(WorkerError):
            drive(made, LocalPool(order, 4), lambda event: None)
    assert len(alive) == n_possible


def test_a_record_of_a_name_that_is_no_text():
    parts = ("input", "processed", "versions", "summary")
    record = {part: {"path": "\udcff.avi"} for part in parts}
    assert parse_record(yaml_text(record).encode()) == record


def refusing(error):
    def refuse(*arguments, **options):
        raise error

    return refuse


def faulty_prepare_none():
    return lambda given_task: faulty_prepare


@pytest.mark.skipif(sys.platform == "win32", reason="needs SIGSTOP")
def test_a_process_that_stops_before_it_begins_is_overdue_all_the_same():
    inbox = SimpleQueue()
    attendant = Attendant(Order((), InputOptions(), ()), inbox, timeout_s=0.3)
    assert attendant.hear(inbox.get(timeout=30)) is None  # it is ready
    os.kill(attendant.worker.pid, signal.SIGSTOP)
    attendant.give(task("one"))
    assert attendant.overdue() is None
    time.sleep(0.4)
    ended = attendant.overdue()
    assert ended.outcome[0].status == TIMEOUT and ended.outcome[0].wall_s >= 0.3
    assert not attendant.is_alive


def test_what_a_process_takes_to_start_is_not_the_videos():
    attendant = Attendant(Order((), InputOptions(), ()), SimpleQueue(), timeout_s=1e-9)
    attendant.give(task("one"))
    time.sleep(0.01)
    assert attendant.overdue() is None
    attendant.worker.end()
