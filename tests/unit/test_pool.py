"""The pool of processes: what goes wrong in one task is that task's outcome."""

import gc

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
