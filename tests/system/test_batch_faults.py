"""Whatever befalls a batch, every video has its row, and no other video suffers from one."""

from pathlib import Path

import pytest
from faults.suite import DECODERS, of_batch_inputs, of_batch_processes, problems_of

GROUPS = list(of_batch_processes(Path()))


@pytest.fixture(scope="module")
def over_inputs(tmp_path_factory):
    return of_batch_inputs(tmp_path_factory.mktemp("faults"), DECODERS)


@pytest.fixture(scope="module")
def over_processes(tmp_path_factory):
    return of_batch_processes(tmp_path_factory.mktemp("faults"))


@pytest.mark.parametrize("decoder", DECODERS)
@pytest.mark.parametrize("kind", ["sound", "none", "unusual", "cut", "mutants", "as a whole"])
def test_inputs(over_inputs, decoder, kind):
    outcomes = over_inputs[f"batch, {decoder}: {kind}"]
    assert outcomes and problems_of(outcomes) == []


def test_mutants_end_in_both_ways(over_inputs):
    outcomes = over_inputs["batch, opencv: mutants"]
    assert {outcome.ending for outcome in outcomes} == {"error", "recovered"}
    assert len(outcomes) >= 500


@pytest.mark.parametrize("group", GROUPS)
def test_processes(over_processes, group):
    outcomes = over_processes[group]()
    assert problems_of(outcomes) == []
    if not outcomes:
        pytest.skip("this system does not permit it")
