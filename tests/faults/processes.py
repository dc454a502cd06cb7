"""What happens to the process and its disk, not to the video."""

import errno
import io
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import contextmanager
from pathlib import Path
from unittest import mock

from click.testing import CliRunner
from conftest import looming_frames, write_video

from faults.outcome import CRASHED, HUNG, Outcome, judge

PATIENCE_S = 60.0
# Closes a pipe once it answers signals, which is the first thing that it does.
PROGRAM = """
import os, sys
import dlgmd_cli.__main__ as entry
told = [int(sys.argv.pop(1))]
def answer(handler, answer=entry.answer):
    answer(handler)
    if told:
        os.close(told.pop())
entry.answer = answer
entry.main()
"""


class Bench:
    """A folder with a video, and the files of an undisturbed run over it.

    `wall_s` is how long a process takes for that, from the first thing that it does.
    """

    def __init__(self, folder: Path, options=(), n_frames=400):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.out, self.options = folder, folder / "out", list(options)
        self.video = write_video(folder / "clip.avi", looming_frames(20, 64, 48) * (n_frames // 20))
        self.wall_s = min(self._time() for _ in range(2))
        self.expected = self._files()
        shutil.rmtree(self.out)

    def _time(self):
        """Run it undisturbed."""
        began = time.monotonic()
        outcome = self.start("undisturbed")
        assert not outcome.problem, outcome
        return time.monotonic() - began

    def command(self, out=None, overwrite=False):
        """The command line after `dlgmd`."""
        more = ["--overwrite"] if overwrite else []
        return ["run", str(self.video), "--out", str(out or self.out), *self.options, *more]

    def start(self, name, number=None, after_s=0.0, **how):
        """The outcome of a process, which gets signal `number` so long after it is ready."""
        ready, told = os.pipe()
        command = [str(told), *self.command(overwrite=self.out.exists())]
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, *command],
            cwd=self.folder,
            stderr=subprocess.PIPE,
            stdout=subprocess.PIPE,
            pass_fds=[told],
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        os.close(told)
        os.read(ready, 1)
        os.close(ready)
        if number is not None:
            time.sleep(after_s)
            process.send_signal(number)
        try:
            _, errors = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            return Outcome(name, HUNG, f"after {after_s:.3f} s")
        code, is_killed = process.returncode, number == signal.SIGKILL
        if is_killed and code == -signal.SIGKILL:
            code = 130  # nothing else is expected of it than of one that was interrupted
        return judge(name, code, errors.decode(), self.out, allows_partial=is_killed)

    def run(self, name="rerun", out=None, expected="either", overwrite=False):
        """The outcome of a run in this process."""
        from dlgmd_cli.app import cli

        result = CliRunner().invoke(cli, self.command(out, overwrite), prog_name="dlgmd")
        return judge(name, result.exit_code, result.stderr, out or self.out, expected)

    def then_as_ever(self, outcome):
        """`outcome`, unless another run no longer gives what an undisturbed one does."""
        if outcome.problem:
            shutil.rmtree(self.out, ignore_errors=True)
            return outcome
        again = self.run(overwrite=True, expected="recovers")
        if again.problem:
            return Outcome(outcome.name, again.ending, f"then: {again.problem}")
        if self._files() != self.expected:
            return Outcome(outcome.name, CRASHED, "then: another result")
        shutil.rmtree(self.out)
        return outcome

    def _files(self):
        """All below the folder of results, by name."""
        paths = (path for path in self.out.rglob("*") if path.is_file())
        return {str(path.relative_to(self.out)): path.read_bytes() for path in paths}


def signals(bench, number, count, seed=11):
    """A signal at `count` random moments of a run, every other one over an earlier result."""
    moments = random.Random(seed + number)
    outcomes = []
    for case in range(count):
        name = f"{signal.Signals(number).name} {case}"
        if case % 2:
            bench.run()
        after_s = moments.uniform(0.0, 1.05 * bench.wall_s)
        outcome = bench.start(name, number, after_s)
        is_lost = case % 2 and not (bench.out / "clip" / "run.yaml").exists()
        if is_lost and number != signal.SIGKILL:
            outcome = Outcome(name, CRASHED, f"lost the earlier result after {after_s:.3f} s")
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def no_room_for_a_write(bench):
    """A write that fails for want of room, each of them in turn."""
    outcomes = []
    for n_good in range(10_000):
        with failing_writes(bench.out, n_good) as n_failed:
            outcome = bench.run(f"write {n_good}")
        if not n_failed:
            shutil.rmtree(bench.out)
            return outcomes
        if outcome.ending != "error" and not outcome.problem:
            outcome = Outcome(outcome.name, outcome.ending, "a failed write went unnoticed")
        outcomes.append(bench.then_as_ever(outcome))
    raise AssertionError("no end of writes")


@contextmanager
def failing_writes(folder, n_good):
    """Files below `folder` take `n_good` writes and no more; yields those that failed."""
    opened, n_left, n_failed = io.open, [n_good], []

    class Full:
        def __init__(self, file):
            self._file = file

        def write(self, data):
            if n_left[0] == 0:
                n_failed.append(1)
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            n_left[0] -= 1
            return self._file.write(data)

        def __getattr__(self, name):
            return getattr(self._file, name)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            self._file.close()

    def full(file, mode="r", *arguments, **options):
        made = opened(file, mode, *arguments, **options)
        is_below = isinstance(file, (str, os.PathLike)) and folder.resolve() in (
            Path(file).absolute().parents
        )
        return Full(made) if is_below and set(mode) & set("wax+") else made

    with mock.patch("io.open", full), mock.patch("builtins.open", full):
        yield n_failed


def no_room_on_disk(bench, sizes_kib=(0, 4, 16, 64)):
    """A file system of its own that is too small; none where it may not be mounted."""
    outcomes, mounted = [], bench.folder / "small"
    mounted.mkdir(exist_ok=True)
    for size in sizes_kib:
        options = f"size={max(size, 4)}k,nr_inodes={3 if size == 0 else 64}"
        if not mount("-t", "tmpfs", "-o", options, "none", mounted):
            return outcomes
        try:
            outcome = bench.run(f"disk of {size} KiB", mounted / "out")
            if list(mounted.iterdir()) and outcome.ending == "error":
                outcome = Outcome(outcome.name, outcome.ending, "left something")
        finally:
            unmount(mounted)
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def no_files_so_large(bench, sizes=(0, 1, 100, 1000, 5000)):
    """Files may not grow beyond a size: what a quota does, and to C code, too."""
    try:
        import resource
    except ImportError:
        return []
    before, outcomes = resource.getrlimit(resource.RLIMIT_FSIZE), []
    for size in sizes:
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
        try:
            outcome = bench.run(f"files of {size} bytes")
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, before)
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def nowhere_to_write(bench):
    """Folders that nobody can write to, not even root."""
    places = [bench.video / "out", bench.video, Path("/dev/null/out")]
    places += [Path(path) / "out" for path in ("/proc", "/sys") if os.path.isdir(path)]
    outcomes = []
    for place in places:
        # What is no folder of ours counts as none.
        from dlgmd_cli.app import cli

        result = CliRunner().invoke(cli, bench.command(place), prog_name="dlgmd")
        nothing = bench.folder / "nothing"
        name = f"out {place.parent.name}/{place.name}"
        outcomes.append(judge(name, result.exit_code, result.stderr, nothing, "error"))
    read_only = bench.folder / "read-only"
    read_only.mkdir(exist_ok=True)
    if mount("-t", "tmpfs", "-o", "ro,size=64k", "none", read_only):
        try:
            outcomes.append(bench.run("read-only mount", read_only / "out", "error"))
        finally:
            unmount(read_only)
    return [bench.then_as_ever(outcome) for outcome in outcomes]


def folder_removed(bench, frames=(0, 1, 10, 19)):
    """The folder of results goes while the run computes, and while it writes."""
    from dlgmd_cli.models.dlgmd import DLGMD
    from dlgmd_cli.runs import findings

    outcomes = []
    step = DLGMD.step
    for number in frames:
        seen = []

        def removing(self, *arguments, number=number, seen=seen, **options):
            if len(seen) == number:
                shutil.rmtree(bench.out)
            seen.append(1)
            return step(self, *arguments, **options)

        with mock.patch.object(DLGMD, "step", removing):
            outcome = bench.run(f"removed at frame {number}")
        outcomes.append(bench.then_as_ever(outcome))
    for name in ("write_tables", "write_record"):
        write = getattr(findings, name)

        def removing_before(*arguments, write=write, **options):
            shutil.rmtree(bench.out)
            write(*arguments, **options)

        def removing_after(*arguments, write=write, **options):
            write(*arguments, **options)
            shutil.rmtree(bench.out)

        for when, how in (("before", removing_before), ("after", removing_after)):
            with mock.patch.object(findings, name, how):
                outcome = bench.run(f"removed {when} {name}", expected="error")
            outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def closed_streams(bench):
    """Nobody reads what is printed, or nothing can be printed at all."""
    outcomes = []
    for name, redirection, codes in (
        ("stdout closed", ">&-", {0}),
        ("stderr closed", "2>&-", {0}),
        ("both closed", ">&- 2>&-", {0}),
        ("all closed", "<&- >&- 2>&-", {0}),
        ("stdout full", ">/dev/full", {0, 1}),
        ("reader gone", "| true", {0, 1}),
        ("reader leaves", "| head -1", {0, 1}),
    ):
        if "full" in redirection and not os.path.exists("/dev/full"):
            continue
        words = [sys.executable, "-m", "dlgmd_cli", *bench.command()]
        quoted = " ".join(f"'{word}'" for word in words)
        done = subprocess.run(
            ["sh", "-c", f"{{ {quoted}; echo $? >code; }} {redirection}"],
            cwd=bench.folder,
            capture_output=True,
            timeout=PATIENCE_S,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        )
        code = int((bench.folder / "code").read_text())
        # The result is whole before anything is printed.
        outcome = judge(name, 0 if code in codes else code, "", bench.out)
        said = done.stderr.decode()
        if "Traceback" in said or "Exception ignored" in said or code not in codes:
            outcome = Outcome(name, CRASHED, f"exit code {code}: {said}")
        outcomes.append(bench.then_as_ever(outcome))
    return outcomes


def mount(*arguments):
    """Mount something, if that is permitted."""
    return shutil.which("mount") is not None and (
        subprocess.run(["mount", *map(str, arguments)], capture_output=True).returncode == 0
    )


def unmount(folder):
    subprocess.run(["umount", str(folder)], check=True, capture_output=True)
