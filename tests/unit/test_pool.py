"""The pool of processes: what goes wrong in one task is that task's outcome."""

import gc
import subprocess
import sys

import pytest
from pooltasks import work

from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.pool import run_tasks

pytestmark = pytest.mark.filterwarnings("ignore:.*leaked semaphore")


def test_every_task_has_its_outcome():
    tasks = ["raise", "ab", "crash", "cd", "exit", "ef"]
    outcomes = dict(run_tasks(work, tasks, 2))
    assert {task: one.status for task, one in outcomes.items()} == {
        **dict.fromkeys(("ab", "cd", "ef"), "done"),
        "raise": "failed",
        "crash": "crashed",
        "exit": "crashed",
    }
    assert outcomes["ab"].result() == "abab" and outcomes["ef"].value == "efef"
    with pytest.raises(ValueError, match="no"):
        outcomes["raise"].result()
    assert "exit code 3" in str(outcomes["exit"].error)


def test_a_stop_drops_what_is_being_worked_on(stop):
    with pytest.raises(cancel.Interrupted):
        for _ in run_tasks(work, iter(["ab", *["hang"] * 3000]), 1):
            stop()
    gc.collect()  # nothing that is left of them complains when it goes


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
