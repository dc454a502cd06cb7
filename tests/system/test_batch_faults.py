"""Whatever befalls a batch, every video has its row, and no other video suffers from one."""

import csv
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from click.testing import CliRunner
from conftest import looming_frames, until, write_video
from disturbed import (
    PATIENCE_S,
    faults_of,
    hidden_in,
    results_of,
    session_of,
    small_files,
    started,
)
from faulty import faulty

from dlgmd_cli.commands.app import cli
from dlgmd_cli.results import store
from dlgmd_cli.tasks.batch.batch import SUMMARY_COLUMNS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform == "win32", reason="signals and limits differ there"),
]
THOROUGH = bool(os.environ.get("DLGMD_THOROUGH"))
N_SIGNALS = 30 if THOROUGH else 1
N_MANY = 3000 if THOROUGH else 200


class Bench:
    """Videos, the files of an undisturbed batch over them, and ways to run and judge others."""

    def __init__(self, folder, n_videos, n_frames):
        self.videos, self.out = folder / "videos", folder / "out"
        self.folder, self.names = folder, []
        for number in range(n_videos):
            self.names.append(f"deep/{number}.avi" if number % 3 == 2 else f"{number}.avi")
            path = self.videos / self.names[-1]
            path.parent.mkdir(parents=True, exist_ok=True)
            frames = looming_frames(20, 64, 48) * (n_frames // 20 + 1)
            write_video(path, frames[: n_frames + number])
        assert self.run().exit_code == 0
        self.truth = results_of(self.out)
        self.clear()

    def command(self, *more, out=None):
        out = out or self.out
        return [
            *map(str, ("batch", self.videos, "--out", out, "--format=none", "--jobs", 2, *more))
        ]

    def run(self, *more, out=None):
        """A batch by this process, whose workers are their own, as ever."""
        result = CliRunner().invoke(cli, self.command(*more, out=out), prog_name="dlgmd")
        assert "Error: internal error" not in result.stderr
        errors = [line for line in result.stderr.splitlines() if line.startswith("Error: ")]
        assert bool(errors) == (result.exit_code == 1) and result.exit_code in (0, 1)
        return result

    def clear(self):
        shutil.rmtree(self.out, ignore_errors=True)

    def judge(self, out=None, truth=None):
        """What is done is whole, and what summary.csv says is so; the statuses."""
        out = out or self.out
        assert faults_of(out, self.truth if truth is None else truth) == []
        rows = rows_of(out)
        for name, row in rows.items():
            folder = out / Path(name).with_suffix("")
            assert (row["error"] == "") == (row["status"] == "done")
            if row["status"] == "done":
                assert (folder / store.RUN).exists(), f"{name} is done, and has no result"
            elif row["status"] not in ("killed", "timeout"):  # those may end after the last rename
                assert not (folder / store.RUN).exists(), f"{name}: {row}, and has a result"
        return {name: row["status"] for name, row in rows.items()}

    def then_as_ever(self):
        """The same command does the rest, and only that."""
        records = store.records_below(self.out, store.RUN)
        before = {path: path.stat().st_mtime_ns for path in records}
        assert self.run().exit_code == 0
        assert self.judge() == dict.fromkeys(self.names, "done")
        # One that was killed as it wrote a result anew (--force), or between its last file and its
        # end, leaves its lock, which is open, and a temporary folder. The next command that writes
        # there removes them.
        for left in hidden_in(self.out):
            assert (left.parent / store.RUN).exists()
            if left.name == f"{store.PREFIX}lock":
                left.unlink()
            else:
                shutil.rmtree(left)
        assert results_of(self.out) == self.truth
        assert all(path.stat().st_mtime_ns == written for path, written in before.items())
        self.clear()


def rows_of(out):
    """The rows of summary.csv by video, which is whole whenever it is there."""
    path = out / "summary.csv"
    if not path.exists():
        return {}
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    assert tuple(header) == SUMMARY_COLUMNS and path.read_bytes().endswith(b"\n")
    found = {row[0]: dict(zip(header, row, strict=True)) for row in rows}
    assert len(found) == len(rows)
    return found


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("long"), 3, 150)


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    return Bench(tmp_path_factory.mktemp("short"), 4, 30)


SIGNALS = ["SIGKILL", "SIGINT to all", "SIGTERM"]


@pytest.mark.parametrize(("first", "name"), enumerate(SIGNALS))
def test_a_signal_at_any_moment(long, first, name):
    moments, number = random.Random(name), getattr(signal, name.partition(" ")[0])
    for case in range(first, first + N_SIGNALS):
        more = ["--force"] if case % 3 == 2 else []
        if more:
            long.run()
        with started(*long.command(*more), cwd=long.folder) as process:
            time.sleep(moments.uniform(0.2, 2.0))
            if process.poll() is None:
                (os.killpg if "all" in name else os.kill)(process.pid, number)
            _, said = process.communicate(timeout=PATIENCE_S)
            assert process.returncode in (0, 130, -number)
            if process.returncode == -number != -signal.SIGKILL:  # while Python itself ends
                assert long.judge() == dict.fromkeys(long.names, "done")
            assert "Traceback" not in said and "Error" not in said
            until(lambda process=process: not session_of(process.pid))
        long.judge()
        if case % 3 or case == first + N_SIGNALS - 1:
            long.then_as_ever()


def test_decoders_that_crash_hang_and_run_out_of_memory(short, monkeypatch):
    faults = {"segfault.avi": "crashed", "exits.avi": "crashed"}
    faults |= {"killed.avi": "killed", "hangs.avi": "timeout", "bug.avi": "failed"}
    for name in faults:
        shutil.copy(short.videos / "0.avi", short.videos / name)
    with monkeypatch.context() as patch:
        patch.setattr("dlgmd_cli.tasks.batch.batch.run_video", faulty)
        result = short.run("--timeout", 12)
    assert result.exit_code == 1
    assert short.judge() == dict.fromkeys(short.names, "done") | faults
    for name in faults:
        (short.videos / name).unlink()
    short.then_as_ever()


@pytest.mark.parametrize("n_bytes", [0, 700])
def test_files_that_may_not_grow(short, n_bytes):
    with small_files(n_bytes):
        result = short.run()
    assert result.exit_code == 1 and "File too large" in result.stderr
    assert not list(short.out.rglob(store.RUN))
    short.then_as_ever()


def test_videos_that_change_after_they_were_found(short, monkeypatch):
    from dlgmd_cli.tasks.batch import find

    last, kept = short.videos / short.names[-1], short.folder / "kept"
    ways = {
        "removed": last.unlink,
        "no video any more": lambda: last.write_text("no video\n" * 100),
        "all removed": lambda: shutil.rmtree(short.videos),
    }
    for name, disturb in ways.items():
        shutil.copytree(short.videos, kept)

        def found(*given, disturb=disturb, find_videos=find.find_videos):
            videos = find_videos(*given)
            disturb()
            return videos

        with monkeypatch.context() as patch:
            patch.setattr("dlgmd_cli.tasks.batch.batch.find_videos", found)
            assert short.run().exit_code == 1
        statuses = short.judge()
        n_failed = sum(status == "failed" for status in statuses.values())
        assert sorted(statuses) == sorted(short.names)
        assert n_failed == (len(short.names) if name == "all removed" else 1), name
        shutil.rmtree(short.videos, ignore_errors=True)
        kept.rename(short.videos)
        short.clear()


def test_very_many_files_that_are_no_videos(tmp_path):
    (tmp_path / "in").mkdir()
    for number in range(N_MANY):
        (tmp_path / f"in/{number}.mp4").touch()
    command = ["batch", str(tmp_path / "in"), "--out", str(tmp_path / "out"), "--format=none"]
    result = CliRunner().invoke(cli, command, prog_name="dlgmd")
    assert result.exit_code == 1 and len(rows_of(tmp_path / "out")) == N_MANY


CALLS = {
    "batch": "dlgmd_cli.batch({clips!r}, out='o', jobs=2)",
    "evaluate": "multiprocessing.set_start_method('forkserver', force=True)\n"
    "dlgmd_cli.evaluate('labels.csv', jobs=2)",
}


@pytest.mark.parametrize("task", CALLS)
def test_a_script_without_its_guard_is_told_so_in_one_line(clips, tmp_path, task):
    paths = [str(clips / name) for name in ("loom.avi", "loom.mp4")]
    lines = ["video,collision_frame", *(f"{path},10" for path in paths)]
    (tmp_path / "labels.csv").write_text("\n".join(lines))
    call = CALLS[task].format(clips=paths)
    (tmp_path / "script.py").write_text(f"import multiprocessing, dlgmd_cli\n{call}\n")
    words = [sys.executable, "script.py"]
    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, timeout=100)
    assert ended.returncode == 1 and ended.stdout == ""
    (line,) = ended.stderr.splitlines()
    assert "script.py: the worker processes end" in line and "__name__" in line, line
