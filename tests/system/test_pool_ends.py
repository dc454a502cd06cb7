"""The pool of processes, where waiting is part of the test."""

import pytest
from pooltasks import work

from dlgmd_cli.errors import WorkerError
from dlgmd_cli.pool import run_tasks

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
