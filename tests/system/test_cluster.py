"""Batches on a Dask cluster, whose workers are killed and whose scheduler goes."""

import csv
import json
import logging
import os
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import pytest
from conftest import looming_frames, until, write_video
from disturbed import environment, hidden_in, results_of, started
from faulty import faulty

from dlgmd_cli.errors import ParameterError, WorkerError
from dlgmd_cli.machine import dask as cluster

distributed = pytest.importorskip("distributed", reason="Dask is not installed")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(os.name == "nt", reason="signals there are others"),
    # Dask's own: connections that end with their worker.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


# Seconds after which a test gives up. Dask does not always start a lost worker again on a busy
# computer, and a batch waits for workers for ever.
LIMIT_S = 60
_WITHOUT_WORKERS = "Dask started no worker again: this computer is too busy"
_given_up: list[str] = []


@pytest.fixture(autouse=True)
def time_limit(request):
    """Skips a test whose workers do not come back, and those after it on the same cluster."""
    if _given_up:
        pytest.skip(f"{_WITHOUT_WORKERS} ({_given_up[0]})")

    def give_up(number, frame):
        _given_up.append(request.node.name)
        pytest.skip(_WITHOUT_WORKERS)

    before = signal.signal(signal.SIGALRM, give_up)
    signal.alarm(LIMIT_S)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.fixture(scope="module")
def scheduler():
    """The address of two workers of one thread each; a task may lose one of them, but not two."""
    import dask

    with (
        dask.config.set({"distributed.scheduler.allowed-failures": 1}),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address="127.0.0.1:0",
            silence_logs=logging.CRITICAL,
        ) as made,
    ):
        yield made.scheduler_address


@pytest.fixture
def folder(tmp_path, clips):
    """Makes copies of a short clip, by name, in a folder."""
    (tmp_path / "in").mkdir()

    def make(*names):
        for name in names:
            data = (clips / "loom.avi").read_bytes()
            (tmp_path / "in" / f"{name}.avi").write_bytes(data)
        return tmp_path / "in"

    return make


def rows_of(path):
    """The cells of a summary.csv less the time that each video took."""
    return [row[:-1] for row in csv.reader(path.read_text(encoding="utf-8").splitlines())]


def test_the_results_are_those_of_local_processes(dlgmd, tmp_path, scheduler, folder):
    source = folder("a", "b", "cut")
    (source / "sub").mkdir()
    write_video(source / "sub/c.avi", looming_frames(30))
    (source / "broken.mp4").write_bytes(b"no video")
    (source / "empty.mkv").touch()
    os.truncate(source / "cut.avi", 3000)
    options = ("--set", "3", "--set", "9", "--format", "none")
    here = dlgmd("batch", "in", "--out", "here", *options, "--jobs", "2")
    there = dlgmd("batch", "in", "--out", "there", *options, "--scheduler", scheduler)
    assert here.exit_code == there.exit_code == 1
    assert there.stderr.splitlines()[-1].startswith("Error: 3 of 6 videos failed; the other 3")
    assert there.stdout == here.stdout.replace("here/", "there/")
    assert results_of(tmp_path / "here") == results_of(tmp_path / "there")
    for label in ("set3", "set9"):
        rows = rows_of(tmp_path / "there" / label / "summary.csv")
        assert rows == rows_of(tmp_path / "here" / label / "summary.csv")
        assert [row[1] for row in rows[1:]].count("done") == 3
    for out, how in (("there", ("--scheduler", scheduler)), ("here", ("--scheduler", scheduler))):
        again = dlgmd("batch", "in", "--out", out, *options, *how, "--json")
        assert json.loads(again.stdout)["already_done"] == 3
    assert hidden_in(tmp_path) == []


def test_what_keeps_workers_from_their_work(scheduler, tmp_path, monkeypatch):
    def outcomes(**options):
        return list(cluster.run_tasks(os.path.basename, ["a/b"], scheduler, **options))

    ((task, outcome),) = outcomes()
    assert (task, outcome.result()) == ("a/b", "b")
    assert list(cluster.run_tasks(os.path.basename, [], "tcp://127.0.0.1:1")) == []
    with pytest.raises(WorkerError, match=r"cannot reach the folder of the results, .*elsewhere"):
        outcomes(folders=[tmp_path / "elsewhere"])
    monkeypatch.setattr(cluster, "__version__", "9.9")
    with pytest.raises(WorkerError, match=r"it has dlgmd \d.*Install dlgmd 9\.9 on the scheduler"):
        outcomes()

    def missing(folders):
        raise ModuleNotFoundError("No module named 'dlgmd_cli'")

    monkeypatch.setattr(cluster, "_report", missing)
    with pytest.raises(WorkerError, match=r"the scheduler: dlgmd is not installed\. Install"):
        outcomes()


@pytest.mark.parametrize(
    "address", ["", "foo", "foo:bar", "nope://x:1", "http://x:80", "tcp://x", "a b:1", "\x1b:1x"]
)
def test_what_is_no_address(address):
    with pytest.raises(ParameterError, match="is neither an address nor a scheduler file"):
        cluster.address_of(address)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (None, "cannot be read"),
        *(
            (content, "it is not a scheduler file")
            for content in ("", "[1]", '{"x": 1}', '{"address": 3}', '{"address": "x"}')
        ),
    ],
)
def test_what_is_no_scheduler_file(dlgmd, folder, tmp_path, content, why):
    folder("a")
    if content is not None:
        (tmp_path / "s.json").write_text(content)
    result = dlgmd("batch", "in", "--scheduler", "s.json")
    assert result.exit_code == 1 and f"Error: s.json: {why}" in result.stderr


def test_nobody_answers_and_dask_is_missing(dlgmd, folder, monkeypatch):
    folder("a")
    monkeypatch.setattr(cluster, "CONNECT_S", 0.5)
    command = ("batch", "in", "--scheduler", "tcp://127.0.0.1:1")
    result = dlgmd(*command)
    assert result.exit_code == 1 and "no Dask scheduler answered within 0.5 s" in result.stderr
    monkeypatch.setitem(sys.modules, "distributed", None)
    result = dlgmd(*command)
    assert result.exit_code == 1 and "pip install '.[cluster]'" in result.stderr


@contextmanager
def program(*arguments):
    """A program of Dask's, which is killed in the end."""
    process = subprocess.Popen(
        [sys.executable, "-m", "dask", *map(str, arguments)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
        env=environment(),
    )
    try:
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.fixture
def scheduler_file(tmp_path):
    """A scheduler without workers, by its file; and its process."""
    file = tmp_path / "s.json"
    arguments = ("--port", 0, "--no-dashboard", "--host", "127.0.0.1", "--scheduler-file", file)
    with program("scheduler", *arguments) as process:
        until(file.exists, 20)
        yield file, process


WAITING = "Waiting for workers of the cluster.\n"


def test_workers_that_come_late(folder, tmp_path, scheduler_file):
    folder("a", "b")
    file, _ = scheduler_file
    command = ("batch", "in", "--format=none", "--scheduler", file)
    with started(*command, cwd=tmp_path) as process:
        assert process.stderr.readline() == WAITING
        workers = ("--no-dashboard", "--nworkers", 2, "--nthreads", 1)
        with program("worker", "--scheduler-file", file, *workers, "--local-directory", tmp_path):
            _, said = process.communicate(timeout=60)
    assert process.returncode == 0 and said == ""
    rows = rows_of(tmp_path / "dlgmd-out/summary.csv")
    assert [row[:2] for row in rows[1:]] == [["a.avi", "done"], ["b.avi", "done"]]


@pytest.mark.parametrize("what", ["the scheduler goes", "Ctrl-C"])
def test_an_end_while_it_waits(folder, tmp_path, scheduler_file, what):
    folder("a")
    file, scheduler = scheduler_file
    with started("batch", "in", "--scheduler", file, cwd=tmp_path) as process:
        assert process.stderr.readline() == WAITING
        (scheduler if "goes" in what else process).send_signal(
            signal.SIGKILL if "goes" in what else signal.SIGINT
        )
        _, said = process.communicate(timeout=60)
    code, words = (1, "scheduler was lost") if "goes" in what else (130, "0 of 1 videos are done")
    assert process.returncode == code and words in said and said.count("\n") == 1
    assert hidden_in(tmp_path) == []


def test_an_interrupt_and_the_same_command_again(scheduler, folder, tmp_path):
    source = folder("a")
    write_video(source / "long.avi", looming_frames(1, 320, 240) * 600)
    write_video(source / "short.avi", looming_frames(1, 320, 240) * 100)
    command = ("batch", "in", "--format=none", "--scheduler", scheduler)
    summary = tmp_path / "dlgmd-out/summary.csv"
    with started(*command, cwd=tmp_path) as process:
        until(lambda: summary.exists() and "done" in summary.read_text(), 20)
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=20)
    assert process.returncode == 130
    ends = "of 3 videos are done; the same command continues from there.\n"
    assert said.endswith((f"Interrupted. 1 {ends}", f"Interrupted. 2 {ends}")), said
    # What a worker was at comes to its end there; no more is begun.
    with distributed.Client(scheduler, set_as_default=False) as client:
        until(lambda: not any(client.processing().values()), 20)
    with started(*command, cwd=tmp_path) as process:
        _, said = process.communicate(timeout=60)
    assert process.returncode == 0 and "videos are done already" in said
    assert [row[1] for row in rows_of(summary)[1:]] == ["done"] * 3
    assert hidden_in(tmp_path) == []


# At the end: on a busy computer, workers that were killed may not come back.
def test_who_loses_workers_is_to_blame_and_others_are_not(dlgmd, scheduler, folder, monkeypatch):
    names = ["a0", "a1", "z0", "z1"]
    folder("killed", "once", "bug", *names)
    with monkeypatch.context() as patch:
        patch.setattr("dlgmd_cli.tasks.batch.batch.run_video", faulty)
        result = dlgmd("batch", "in", "--format=none", "--scheduler", scheduler, "--json")
    assert result.exit_code == 1
    rows = {row[0]: row for row in rows_of(Path("dlgmd-out/summary.csv"))[1:]}
    assert {name: row[1] for name, row in rows.items()} == {
        **{f"{name}.avi": "done" for name in (*names, "once")},
        "killed.avi": "killed",
        "bug.avi": "failed",
    }, result.stderr
    assert rows["killed.avi"][2].startswith("every worker that ran it was lost, as happens when")
