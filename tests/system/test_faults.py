"""Whatever befalls a run, it ends with a whole result or one clear line, and nothing else."""

import os
from pathlib import Path

import pytest
from faults import worker
from faults.inputs import Input
from faults.outcome import CRASHED, HALF_WRITTEN, HUNG, judge
from faults.suite import DECODERS, of_inputs, of_processes, problems_of

from dlgmd_cli.results.folder import ResultFolder

GROUPS = list(of_processes(Path()))


@pytest.fixture(scope="module")
def over_inputs(tmp_path_factory):
    return of_inputs(tmp_path_factory.mktemp("faults"), DECODERS)


@pytest.fixture(scope="module")
def over_processes(tmp_path_factory):
    return of_processes(tmp_path_factory.mktemp("faults"))


@pytest.mark.parametrize("decoder", DECODERS)
@pytest.mark.parametrize("kind", ["sound", "none", "unusual", "cut", "mutants"])
def test_inputs(over_inputs, decoder, kind):
    outcomes = over_inputs[f"{decoder}: {kind}"]
    assert outcomes and problems_of(outcomes) == []


def test_mutants_end_in_both_ways(over_inputs):
    endings = {outcome.ending for outcome in over_inputs["opencv: mutants"]}
    assert endings == {"error", "recovered"} and len(over_inputs["opencv: mutants"]) >= 500


@pytest.mark.parametrize("group", GROUPS)
def test_processes(over_processes, group):
    outcomes = over_processes[group]()
    assert problems_of(outcomes) == []
    if not outcomes:
        pytest.skip("this system does not permit it")


PROGRAMS = {
    "dies": "import os; os.abort()",
    "hangs": "import time; time.sleep(3600)",
}


@pytest.mark.parametrize(("program", "ending"), [("dies", CRASHED), ("hangs", HUNG)])
def test_a_death_is_laid_at_the_right_door(tmp_path, clips, monkeypatch, program, ending):
    (tmp_path / "sitecustomize.py").write_text(
        "import dlgmd_cli.video.frames as module\n"
        "def opened(path, *more, open_reader=module._open_reader):\n"
        f"    if 'bad' in str(path):\n        {PROGRAMS[program]}\n"
        "    return open_reader(path, *more)\n"
        "module._open_reader = opened\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    good, bad = clips / "loom.avi", tmp_path / "bad.avi"
    cases = [Input("1", good), Input("2", bad), Input("3", good, "recovers")]
    outcomes = worker.run_all(cases, [], tmp_path / "runs", silence_s=6.0)
    assert [outcome.ending for outcome in outcomes] == ["recovered", ending, "recovered"]
    assert [bool(outcome.problem) for outcome in outcomes] == [False, True, False]


@pytest.mark.parametrize(
    ("code", "said", "expected", "ending"),
    [
        (1, "Error: no.\n", "error", None),
        (1, "Error: no.\n", "recovers", "error"),
        (0, "", "error", "recovered"),
        (1, "", "error", "error"),
        (1, "Error: a\nError: b\n", "error", "error"),
        (1, "Error: internal error (IndexError).\n", "error", CRASHED),
        (-11, "", "either", CRASHED),
        (1, "Traceback\nError: no.\n", "error", CRASHED),
    ],
)
def test_judgement_of_what_is_said(tmp_path, code, said, expected, ending):
    outcome = judge("x", code, said, tmp_path / "none", expected)
    assert (outcome.ending if outcome.problem else None) == ending


def test_judgement_of_what_is_left(tmp_path):
    (tmp_path / ".dlgmd-1").mkdir()
    assert judge("x", 1, "Error: no.\n", tmp_path).ending == HALF_WRITTEN
    assert not judge("x", 130, "", tmp_path, allows_partial=True).problem
    os.rmdir(tmp_path / ".dlgmd-1")
    assert judge("x", 1, "Error: no.\n", tmp_path).problem.startswith("left")
    with ResultFolder(tmp_path, "clip") as folder:
        folder.save(lambda path: (path / "run.yaml").write_text("complete: true\n"))
    assert judge("x", 0, "", tmp_path).ending == HALF_WRITTEN
