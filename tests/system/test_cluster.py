"""Batches on a Dask cluster, whose workers are killed and whose scheduler goes."""

import csv
import json
import logging
import os
import platform
import re
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from dlgmd_cli.batch import cluster as cluster_module
from dlgmd_cli.batch.drive import drive
from dlgmd_cli.batch.errand import IDLE_S, Job, _obstacle
from dlgmd_cli.batch.events import Advanced, Began, Ended, Waiting
from dlgmd_cli.batch.find import find_videos
from dlgmd_cli.batch.local import LocalPool
from dlgmd_cli.batch.places import Folder
from dlgmd_cli.batch.resume import plan
from dlgmd_cli.batch.task import Order, Task, Variant, Video
from dlgmd_cli.errors import ParameterError, WorkerError
from dlgmd_cli.parameters import load_set
from tests.conftest import looming_frames, write_video
from tests.saboteurs import Sabotaged

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
pytestmark = [
    pytest.mark.skipif(os.name == "nt", reason="signals there are others"),
    # Dask's own: connections that end with their worker.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]
FREE_S = 20.0


@pytest.fixture(scope="module")
def scheduler():
    """The address of two workers with a thread each; a task may lose one of them, but not two."""
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as started,
    ):
        yield started.scheduler_address


@pytest.fixture
def folder(tmp_path, clips):
    """Makes copies of a short clip, by name, in a folder."""
    (tmp_path / "in").mkdir()

    def make(*names):
        for name in names:
            shutil.copy(clips / "loom.avi", tmp_path / "in" / f"{name}.avi")
        return tmp_path / "in"

    return make


def planned(folder, out="out", options=None):
    """An order, and what is to be done for it."""
    place = Folder.named(str(folder.parent / out))
    variant = Variant("set9", load_set(9), "auto", place)
    order = Order((variant,), options or Sabotaged(), ())
    place.prepare()
    return order, plan(find_videos([("", str(folder))]).videos, order, force=False, overwrite=False)


def run(folder, scheduler, timeout_s=None, on_event=lambda event: None, **given):
    """Work on all videos of a folder; the statuses by name, and everything that happened."""
    order, made = planned(folder, **given)
    events = []

    def tell(event):
        events.append(event)
        on_event(event)

    drive(made, cluster_module.Cluster(order, scheduler, timeout_s), tell)
    statuses = {name: one.status for name, one in made.summaries[0].endings.items()}

    return statuses, events


def pids(folder):
    return {int(line) for line in (folder / "pids.txt").read_text().split()}


def is_alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def wait_until(is_so, limit_s=FREE_S):
    began = time.monotonic()
    while not is_so():
        assert time.monotonic() - began < limit_s
        time.sleep(0.05)


def leftovers(folder):
    return [path for path in folder.rglob("*") if path.name.startswith(".dlgmd")]


def without_time(path):
    rows = list(csv.reader(path.read_text(encoding="utf-8").splitlines()))
    return [row[:-1] for row in rows]


def test_the_summary_is_that_of_local_processes(dlgmd, tmp_path, scheduler, folder):
    source = folder("a", "b", "sub")
    (source / "sub").mkdir()
    shutil.copy(source / "a.avi", source / "sub" / "c.avi")
    (source / "broken.mp4").write_bytes(b"no video")
    (source / "empty.mkv").touch()
    shutil.copy(source / "a.avi", source / "cut.avi")
    os.truncate(source / "cut.avi", 3000)
    options = ("--set", "3", "--set", "9", "--no-plots")
    here = dlgmd("batch", "in", "--out", "here", *options, "--jobs", "2")
    there = dlgmd("batch", "in", "--out", "there", *options, "--scheduler", scheduler)
    assert here.exit_code == there.exit_code == 1
    assert there.stderr.splitlines()[-1].startswith("Error: 3 of 7 videos failed, 4 are in")
    assert there.stdout == here.stdout.replace("here/", "there/")
    for label in ("set3", "set9"):
        rows = without_time(tmp_path / "there" / label / "summary.csv")
        assert rows == without_time(tmp_path / "here" / label / "summary.csv")
        assert [row[1] for row in rows[1:]].count("done") == 4
        for name in ("a", "sub/c"):
            one = tmp_path / "there" / label / name / "mp.csv"
            assert one.read_bytes() == (tmp_path / "here" / label / name / "mp.csv").read_bytes()
    again = dlgmd("batch", "in", "--out", "there", *options, "--scheduler", scheduler, "--json")
    assert json.loads(again.stdout)["already_done"] == 4
    kept = dlgmd("batch", "in", "--out", "here", *options, "--scheduler", scheduler, "--json")
    assert json.loads(kept.stdout)["already_done"] == 4
    assert leftovers(tmp_path) == []


def test_children_die_and_hang_alone(scheduler, folder):
    source = folder("a", "aborts", "b", "hangs", "kills", "z")
    statuses, events = run(source, scheduler, timeout_s=1.5)
    assert statuses == {
        **{f"{name}.avi": "done" for name in "abz"},
        "aborts.avi": "crashed",
        "hangs.avi": "timeout",
        "kills.avi": "killed",
    }
    ended = [one.task.video.name for one in events if isinstance(one, Ended)]
    assert sorted(ended) == sorted(statuses)
    began = {one.task.video.name for one in events if isinstance(one, Began)}
    assert {"hangs.avi"} <= began <= set(statuses)
    wait_until(lambda: not any(map(is_alive, pids(source))), IDLE_S - 1)
    assert leftovers(source.parent) == []


def test_children_are_kept_for_the_next_video_and_end_with_the_batch(scheduler, folder):
    source = folder(*"abcdefgh")
    statuses, _ = run(source, scheduler)
    assert list(statuses.values()) == ["done"] * 8
    assert 1 <= len(pids(source)) <= 2
    wait_until(lambda: not any(map(is_alive, pids(source))), IDLE_S - 1)


def test_what_a_lost_worker_had_is_done_by_another(scheduler, folder):
    source = folder(*"abc", "slays", *"xyz")
    statuses, _ = run(source, scheduler)
    assert list(statuses.values()) == ["done"] * 7
    assert leftovers(source.parent) == []
    # The child outlived its worker by no more than it takes to clean up.
    wait_until(lambda: not any(map(is_alive, pids(source))))


def test_a_video_that_loses_every_worker_is_a_row(scheduler, folder):
    # Those that wait at the workers which it slays are not to blame.
    others = [f"{letter}{n}" for letter in "az" for n in range(3)]
    source = folder("slays-always", *others)
    statuses, _ = run(source, scheduler)
    assert statuses.pop("slays-always.avi") == "killed"
    assert statuses == {f"{name}.avi": "done" for name in others}
    text = (source.parent / "out/summary.csv").read_text(encoding="utf-8")
    assert "every worker that had it was lost" in text
    wait_until(lambda: not any(map(is_alive, pids(source))))


def test_no_more_is_sent_than_workers_can_hold(scheduler, folder):
    order, made = planned(folder(*map(str, range(20))))
    n_taken = n_ended = most = 0

    def counted():
        nonlocal n_taken
        for task in made.tasks:
            n_taken += 1
            yield task

    with cluster_module.Cluster(order, scheduler) as pool:
        for event in pool.work_on(counted()):
            most = max(most, n_taken - n_ended)
            n_ended += isinstance(event, Ended)
    assert n_ended == n_taken == 20
    assert 2 <= most <= 2 * cluster_module.PER_THREAD


def test_nothing_to_do_needs_no_scheduler(folder):
    order, _ = planned(folder("a"))
    with cluster_module.Cluster(order, "tcp://127.0.0.1:1") as pool:
        assert list(pool.work_on([])) == []


def test_progress_comes_from_the_workers(scheduler, tmp_path):
    (tmp_path / "in").mkdir()
    write_video(tmp_path / "in/long.avi", looming_frames(1, 320, 240) * 900)
    _, events = run(tmp_path / "in", scheduler)
    told = [(one.n_frames, one.n_expected) for one in events if isinstance(one, Advanced)]
    assert told == sorted(told) and told[-1][0] > 0 and {n for _, n in told[1:]} == {900}


def test_a_worker_says_what_it_does_not_see(scheduler, folder, tmp_path):
    order, made = planned(folder("a"))
    gone = Task(Video("gone.avi", "/nowhere/gone.avi", "gone"), (0,))
    with cluster_module.Cluster(order, scheduler) as pool:
        (ended,) = (one for one in pool.work_on([gone]) if isinstance(one, Ended))
    assert ended.outcome[0].status == "failed"
    assert ended.outcome[0].error.startswith(
        f"on {platform.node()}, there is no /nowhere/gone.avi. Put the videos where"
    )
    job = Job("x", order, None, (str(tmp_path / "elsewhere/.dlgmd-1"),))
    assert _obstacle(job, made.tasks[0]).startswith(
        f"the folder of the results is not to be seen, {tmp_path / 'elsewhere'}. Choose an --out"
    )
    assert _obstacle(Job("x", order, None, (str(tmp_path),)), made.tasks[0]) == ""


@pytest.mark.parametrize(
    ("version", "asked", "message"),
    [
        ("9.9", cluster_module._VERSION, r"there is dlgmd \d.*, here 9\.9\. Install dlgmd 9\.9 on"),
        ("9.9", "__import__('dlgmd_gone').x", "the scheduler: dlgmd is not installed. Install"),
    ],
)
def test_the_release_is_the_same_everywhere(
    scheduler, folder, monkeypatch, version, asked, message
):
    monkeypatch.setattr(cluster_module, "__version__", version)
    monkeypatch.setattr("dlgmd_cli.batch.errand.__version__", version)
    monkeypatch.setattr(cluster_module, "_VERSION", asked)
    with pytest.raises(WorkerError, match=message):
        run(folder("a"), scheduler)


@pytest.mark.parametrize(
    "address", ["", "foo", "foo:bar", "nope://x:1", "http://x:80", "tcp://x", "a b:1", "\x1b:1x"]
)
def test_what_is_no_address(dlgmd, folder, address):
    folder("a")
    result = dlgmd("batch", "in", "--scheduler", address)
    assert result.exit_code == 2 and result.stderr.splitlines()[-1].isprintable()
    assert "is neither an address nor a scheduler file. Give one like tcp://" in result.stderr
    with pytest.raises(ParameterError):
        cluster_module.connect(address)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (None, "it cannot be read (No such file or directory)"),
        ("", "it is no scheduler file"),
        ("[1]", "it is no scheduler file"),
        ('{"x": 1}', "it is no scheduler file"),
        ('{"address": 3}', "it holds no address"),
        ('{"address": "x"}', "it holds no address"),
    ],
)
def test_what_is_no_scheduler_file(dlgmd, folder, tmp_path, content, why):
    folder("a")
    if content is not None:
        (tmp_path / "s.json").write_text(content)
    result = dlgmd("batch", "in", "--scheduler", "s.json")
    mend = "Write it with: dask scheduler --scheduler-file FILE."
    assert (result.exit_code, result.stderr) == (1, f"Error: s.json: {why}. {mend}\n")


def test_nobody_answers(dlgmd, folder, monkeypatch):
    folder("a")
    monkeypatch.setattr("dlgmd_cli.batch.scheduler.CONNECT_S", 0.5)
    result = dlgmd("batch", "in", "--scheduler", "tcp://127.0.0.1:1")
    assert result.exit_code == 1 and result.stderr == (
        "Error: tcp://127.0.0.1:1: no Dask scheduler answers within 0.5 s. "
        "Start it with 'dask scheduler', or check --scheduler.\n"
    )


def test_dask_is_missing(dlgmd, folder, monkeypatch):
    folder("a")
    monkeypatch.setitem(sys.modules, "distributed", None)
    result = dlgmd("batch", "in", "--scheduler", "tcp://127.0.0.1:1")
    assert result.exit_code == 1 and result.stderr == (
        "Error: --scheduler: it needs the package 'distributed'. "
        "Install it with: pip install 'dlgmd[cluster]'.\n"
    )


def test_jobs_are_of_this_machine(dlgmd):
    result = dlgmd("batch", ".", "--scheduler", "tcp://127.0.0.1:1", "--jobs", "2")
    assert result.exit_code == 2 and "--jobs is of this machine" in result.stderr


@contextmanager
def started(*arguments):
    """A program of Dask's, which is killed in the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
    )
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_workers_that_come_late_die_and_a_scheduler_that_goes(folder, tmp_path):
    """By a scheduler file, with workers that no nanny starts again."""
    source, file = folder("a", "slow1", "slow2"), tmp_path / "s.json"
    of_scheduler = ("--port", 0, "--no-dashboard", "--host", "127.0.0.1")
    of_worker = ("--no-nanny", "--no-dashboard", "--nthreads", 1, "--scheduler-file", file)
    of_worker += ("--local-directory", tmp_path)
    workers, waited = [], []
    with started("scheduler", *of_scheduler, "--scheduler-file", file) as its_process:
        wait_until(file.exists)

        def start_and_kill(event):
            if isinstance(event, Waiting) and event.why and not workers:
                waited.append(event.why)
                workers.extend(started("worker", *of_worker) for _ in range(2))
                workers[:] = [(one, one.__enter__()) for one in workers]
            elif isinstance(event, Began) and "slow" in event.task.video.name and len(workers) == 2:
                children = pids(source)
                parents = {
                    Path(f"/proc/{one}/stat").read_text().rpartition(")")[2].split()[1]
                    for one in children
                    if is_alive(one)
                }
                victim = next(one for one in workers if str(one[1].pid) in parents)
                victim[1].send_signal(signal.SIGKILL)
                workers.append("one is dead")

        statuses, _ = run(source, str(file), on_event=start_and_kill)
        assert waited == ["Waiting for workers of the cluster."]
        assert workers[2:] == ["one is dead"]
        assert list(statuses.values()) == ["done"] * 3

        folder("b", "hangs")
        order, made = planned(source)
        assert [task.video.name for task in made.tasks] == ["b.avi", "hangs.avi"]

        def end_scheduler(event):
            if isinstance(event, Ended):
                its_process.kill()

        with pytest.raises(WorkerError, match="was lost, or dropped the work"):
            drive(made, cluster_module.Cluster(order, str(file)), end_scheduler)
    for context, _ in workers[:2]:
        context.__exit__(None, None, None)
    rows = without_time(source.parent / "out/summary.csv")
    assert [row[:2] for row in rows[1:]] == [
        [f"{name}.avi", "done"] for name in ("a", "b", "slow1", "slow2")
    ]
    wait_until(lambda: not any(map(is_alive, pids(source))))
    assert leftovers(source.parent) == []
    (source / "hangs.avi").rename(source / "z.avi")
    order, made = planned(source)
    assert [task.video.name for task in made.tasks] == ["z.avi"]
    drive(made, LocalPool(order, 1), lambda event: None)
    assert made.summaries[0].endings["z.avi"].status == "done"


def test_a_scheduler_that_goes_is_one_line(folder, tmp_path):
    folder("a")
    file = tmp_path / "s.json"
    arguments = ("--port", 0, "--no-dashboard", "--host", "127.0.0.1", "--scheduler-file", file)
    with started("scheduler", *arguments) as its_process:
        wait_until(file.exists)
        command = [sys.executable, "-m", "dlgmd_cli", "batch", "in", "--scheduler", str(file)]
        with subprocess.Popen(
            command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
        ) as process:
            assert process.stderr.readline() == "Waiting for workers of the cluster.\n"
            its_process.kill()
            said = process.stderr.read()
    assert process.returncode == 1 and said == (
        f"Error: {file}: the scheduler was lost, or dropped the work. "
        "Start it again, then the same command, which goes on from there.\n"
    )
    assert leftovers(tmp_path) == []


def test_an_interrupt_ends_it_at_once_and_the_same_command_goes_on(scheduler, folder, tmp_path):
    source = folder("a")
    for name in ("y", "z"):
        write_video(source / f"{name}.avi", looming_frames(1, 320, 240) * 3000)
    command = [sys.executable, "-m", "dlgmd_cli", "batch", "in", "--no-plots", "--end"]
    scheduled = ["--scheduler", scheduler]
    process = subprocess.Popen(
        [*command, "1000", *scheduled],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        stdout=subprocess.DEVNULL,
    )
    summary = tmp_path / "dlgmd-out/summary.csv"
    wait_until(lambda: summary.exists() and "a.avi" in summary.read_text())
    began = time.monotonic()
    process.send_signal(signal.SIGINT)
    _, said = process.communicate(timeout=FREE_S)
    assert time.monotonic() - began < 5
    assert process.returncode == 130
    assert re.sub(r"\d of", "N of", said) == (
        "Interrupted; N of 3 videos are done, and the same command goes on from there.\n"
    )
    with distributed.Client(scheduler, set_as_default=False) as client:
        wait_until(lambda: not any(client.processing().values()))
        wait_until(lambda: sum(client.run(_n_children).values()) == 0, 8)
    assert leftovers(tmp_path) == []
    for name in ("y", "z"):
        with suppress(FileNotFoundError):
            (source / f"{name}.avi").unlink()
    again = subprocess.run(
        [*command, "1000", *scheduled, "--json"], cwd=tmp_path, capture_output=True, text=True
    )
    assert again.returncode == 0 and json.loads(again.stdout)["already_done"] == 1


def _n_children():
    """Children of a Dask worker that it started for videos."""
    import psutil

    return sum(
        "dlgmd_cli" in " ".join(one.cmdline())
        for one in psutil.Process().children(recursive=True)
        if one.status() != psutil.STATUS_ZOMBIE
    )
