"""What the fast tier asks of the models, asked of the compiled engine; and memory, of both."""

import gc
import sys
import tracemalloc
from pathlib import Path

import pytest
from engine_checks import check_what_is_no_number

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_dlgmd_reference import *  # noqa: F403
from test_model_contract import *  # noqa: F403
from test_model_contract import CASES, create, moving, steps
from test_on_off_reference import *  # noqa: F403
from test_own_flight import *  # noqa: F403

pytestmark = pytest.mark.slow


@pytest.fixture(autouse=True)
def compiled(request, monkeypatch):
    """Every model of this module is computed by Numba, whatever the frames' size."""
    pytest.importorskip("numba", reason="the numba engine needs numba")
    is_opencv = "opencv" in request.node.name
    least = sys.maxsize if is_opencv else 0
    monkeypatch.setattr("dlgmd_cli.models.engines.WORTH_COMPILING_PX", least)


def test_the_compiled_engine_is_at_work():
    model = create("dlgmd")
    model.step(moving()[0])
    assert model.engine_name == "numba"


@pytest.mark.parametrize("name", ["dlgmd", "dlgmd-onoff"])
def test_what_is_no_number_is_not_hidden_either(name):
    check_what_is_no_number("numba", name)


@pytest.mark.parametrize("engine", ["opencv", "numba"])
@pytest.mark.parametrize("case", CASES)
def test_memory_does_not_grow(case, engine):
    model, frames = create(case), moving()
    tracemalloc.start()
    try:
        steps(model, frames * 10)
        gc.collect()
        before, _ = tracemalloc.get_traced_memory()
        for frame in frames * 30:
            model.step(frame)
        gc.collect()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A single number kept for each of these 270 frames would take 8,600 bytes; Python's own
    # lists of free tuples take less.
    assert after - before < 6_144
