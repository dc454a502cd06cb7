"""What the fast tier asks of the models, asked of the compiled engine; and memory, of both."""

import gc
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from engine_checks import check_what_is_no_number

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_dlgmd_reference import *  # noqa: F403
from test_model_contract import *  # noqa: F403
from test_model_contract import CASES, create, moving, steps
from test_on_off_reference import *  # noqa: F403
from test_own_flight import *  # noqa: F403

from dlgmd_cli.models.alarm import Alarm
from dlgmd_cli.parameters.presets import load_set

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
        for frame in frames * 60:
            model.step(frame)
        gc.collect()
        after, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    # A single number kept for each of these 540 frames would take 17,000 bytes; Python's own
    # lists of free tuples take less.
    assert after - before < 12_288


def test_an_alarm_keeps_constant_memory():
    frames = moving() * 10
    alarm = Alarm(load_set(9, kappa=1e-4))
    held = []
    tracemalloc.start()
    try:
        for _ in range(5):
            for frame in frames:
                alarm.step(frame)
            gc.collect()
            held.append(tracemalloc.get_traced_memory()[0])
    finally:
        tracemalloc.stop()
    # Python's own caches may grow at times. One number kept for each of these 90 frames would
    # take twice as much every time.
    assert min(np.diff(held)) < 2048
