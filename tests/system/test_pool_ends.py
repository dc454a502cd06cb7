"""The pool of processes, where waiting is part of the test."""

import subprocess
import sys
import time
from pathlib import Path

import pytest
from conftest import until
from disturbed import environment, session_of
from pooltasks import work

from dlgmd_cli.errors import WorkerError
from dlgmd_cli.machine.pool import run_tasks

pytestmark = pytest.mark.slow


def test_kills_and_timeouts():
    outcomes = dict(run_tasks(work, ["kill", "hang", "ab"], 1, timeout_s=1.5))
    assert {task: one.status for task, one in outcomes.items()} == {
        "kill": "killed",
        "hang": "timeout",
        "ab": "done",
    }
    assert isinstance(outcomes["kill"].error, WorkerError)
    assert "not done after 1.5 s" in str(outcomes["hang"].error)


def test_processes_that_start_while_the_pool_ends_are_silent(capfd):
    for _ in range(8):  # with more processes than processors, some are still starting
        assert [task for task, _ in run_tasks(work, ["ab"], 6)] == ["ab"]
    assert capfd.readouterr().err == ""


PARENT = """
from pooltasks import work
from dlgmd_cli.machine.pool import run_tasks
if __name__ == "__main__":
    for task, outcome in run_tasks(work, ["pid", "hang", "hang"], 1):
        print(outcome.value, flush=True)
"""


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="no /proc here")
def test_processes_end_when_their_parent_is_killed(tmp_path):
    (tmp_path / "parent.py").write_text(PARENT)
    with subprocess.Popen(
        [sys.executable, "parent.py"],
        cwd=tmp_path,
        env=environment(),
        stdout=subprocess.PIPE,
        start_new_session=True,
    ) as parent:
        child = int(parent.stdout.readline())
        time.sleep(0.5)  # it is in the midst of the next task by now
        assert child in session_of(parent.pid)
        parent.kill()
    until(lambda: not session_of(parent.pid))


def test_a_script_without_its_main_guard_is_told_once(tmp_path):
    script = tmp_path / "script.py"
    call = "from dlgmd_cli.machine.pool import run_tasks\nlist(run_tasks(len, ['ab'], 2))\n"
    script.write_text(call)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and "Traceback" not in done.stderr
    # Under load, Python's own tracker of resources may say more.
    (line,) = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert "A Python script needs if __name__" in line
