"""A folder of videos, what an undisturbed batch makes of it, and ways to disturb one."""

import os
import shutil
import signal
import subprocess
import sys
import time
import uuid
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from unittest import mock

from click.testing import CliRunner
from conftest import looming_frames, write_video

from faults.batch_outcome import Ended, files_below, judge_batch, timeless
from faults.outcome import CRASHED, HUNG, Outcome
from faults.processes import PATIENCE_S, PROGRAM

# All that descends from one batch has it in its environment, whatever its parent and session.
MARK = "DLGMD_FAULTS_MARK"
# How long processes may live on once the batch has ended.
LINGER_S = 10.0


class BatchBench:
    """Videos, and the files of an undisturbed batch over them.

    `wall_s` is how long a process takes for that, from the first thing that it does.
    """

    def __init__(self, folder: Path, options=("--no-plots",), n_videos=8, n_frames=300, jobs=2):
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.videos, self.out = folder, folder / "videos", folder / "out"
        (self.videos / "deep").mkdir(parents=True)
        self.options = [*options, "--jobs", str(jobs)]
        for number in range(n_videos):
            below = self.videos / "deep" if number % 3 == 2 else self.videos
            frames = looming_frames(20, 64, 48) * (n_frames // 20) + looming_frames(number, 64, 48)
            write_video(below / f"{number}.avi", frames[: n_frames + number])
        self.names = sorted(files_below(self.videos))
        self.truth = None
        self.wall_s = min(self._time() for _ in range(2))

    def _time(self):
        """Run it undisturbed."""
        began = time.monotonic()
        outcome = self.start("undisturbed", codes={0})
        assert not outcome.problem, outcome
        taken_s = time.monotonic() - began
        self.truth = timeless(files_below(self.out))
        self.clear()
        return taken_s

    def command(self, *more):
        """The command line after `dlgmd`."""
        return ["batch", str(self.videos), "--out", str(self.out), *self.options, *more]

    @contextmanager
    def with_results_in(self, out):
        """Lets results go elsewhere."""
        with mock.patch.object(self, "out", out):
            yield

    def start(self, name, disturb=lambda process, mark: None, codes=(0, 130), more=()):
        """The outcome of a process; `disturb` is called as soon as that answers signals."""
        mark, before = uuid.uuid4().hex, self.done_at()
        ready, told = os.pipe()
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM, str(told), *self.command(*more)],
            cwd=self.folder,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            pass_fds=[told],
            start_new_session=True,
            env=environment(mark),
        )
        os.close(told)
        os.read(ready, 1)
        os.close(ready)
        # It may have ended already; then there is nothing to be disturbed.
        disturb(process, mark)
        try:
            stdout, stderr = process.communicate(timeout=PATIENCE_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            end_all(mark)
            return Outcome(name, HUNG, f"for more than {PATIENCE_S:g} s")
        is_killed = process.returncode == -signal.SIGKILL
        ended = Ended(130 if is_killed else process.returncode, stdout.decode(), stderr.decode())
        outcome = without_survivors(
            lambda: judge_batch(name, ended, self.out, self.truth, codes, allows_hidden=is_killed),
            mark,
        )
        if not outcome.problem and "--force" not in more and self._has_redone(before):
            return Outcome(name, CRASHED, "did again what was done")
        return outcome

    def run(self, name="rerun", codes=(0, 1), *, more=(), **how):
        """The outcome of a batch in this process, whose workers are their own, as ever."""
        mark = uuid.uuid4().hex
        with mock.patch.dict(os.environ, {MARK: mark}):
            ended = invoke(self.command(*more))
        return without_survivors(
            lambda: judge_batch(name, ended, self.out, self.truth, codes, **how),
            mark,
        )

    def then_as_ever(self, outcome, ignored=()):
        """`outcome`, unless the same command then does not do the rest, and nothing but that."""
        if not outcome.problem:
            before = self.done_at()
            again = self.run(codes={0}, ignored=ignored)
            if again.problem:
                outcome = Outcome(outcome.name, again.ending, f"then: {again.problem}")
            elif self._has_redone(before):
                outcome = Outcome(outcome.name, CRASHED, "then: did again what was done")
            elif fault := self.fault_of_whole(ignored):
                outcome = Outcome(outcome.name, CRASHED, f"then: {fault}")
        self.clear()
        return outcome

    def fault_of_whole(self, ignored=()):
        """In what the results differ from those of an undisturbed batch, or None."""
        found = timeless(files_below(self.out))
        names = {name for name in {*found, *self.truth} if found.get(name) != self.truth.get(name)}
        return f"other files: {sorted(names)[:5]}" if names - set(ignored) else None

    def done_at(self):
        """When each result that stands there was written."""
        return {path: path.stat().st_mtime_ns for path in self.out.rglob("[!.]*/run.yaml")}

    def clear(self):
        """Remove all results."""
        shutil.rmtree(self.out, ignore_errors=True)

    def _has_redone(self, before):
        now = self.done_at()
        return any(now.get(path) != written for path, written in before.items())


@contextmanager
def at_event(act, number=0):
    """Calls `act(worker)` before an event of a batch in this process, by number; None: all.

    `worker` is one that works on a video, and no longer starts, or None.
    """
    from dlgmd_cli.batch.local import LocalPool

    work_on, seen = LocalPool.work_on, []

    def disturbed(self, tasks):
        for event in work_on(self, tasks):
            if number is None or len(seen) == number:
                attendants = self._attendants.values()
                busy = [one.worker for one in attendants if one.task and one._is_ready]
                act(busy[0] if busy else None)
            seen.append(event)
            yield event

    with mock.patch.object(LocalPool, "work_on", disturbed):
        yield seen


def invoke(command):
    """A command in this process."""
    from dlgmd_cli.app import cli

    result = CliRunner().invoke(cli, command, prog_name="dlgmd")
    return Ended(result.exit_code, result.stdout, result.stderr)


def environment(mark):
    """That of a process whose descendants are to be known."""
    return {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), MARK: mark}


def processes_of(mark):
    """Every process that has a mark in its environment; none where that cannot be seen."""
    found, wanted = [], f"{MARK}={mark}".encode()
    for path in Path("/proc").glob("[0-9]*/environ"):
        try:
            if wanted in path.read_bytes().split(b"\0") and int(path.parent.name) != os.getpid():
                found.append(int(path.parent.name))
        except OSError:  # it has ended, or is somebody else's
            continue
    return found


def end_all(mark):
    """Kill whatever has a mark, until nothing has."""
    while alive := processes_of(mark):
        for number in alive:
            send(number, signal.SIGKILL)
        time.sleep(0.01)


def without_survivors(judge, mark):
    """What `judge` says, unless processes with a mark live on."""
    deadline = time.monotonic() + LINGER_S
    while alive := processes_of(mark):
        if time.monotonic() > deadline:
            end_all(mark)
            return replace(judge(), ending=HUNG, problem=f"processes live on: {alive}")
        time.sleep(0.02)
    return judge()


def send(number, which):
    """A signal to a process that may have ended."""
    with suppress(ProcessLookupError):
        os.kill(number, which)
