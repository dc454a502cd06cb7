"""Engines give the same answers, whatever the size of the frame, and are chosen as said."""

import math
import sys
from importlib import import_module

import numpy as np
import pytest
from engine_checks import (
    check_what_is_no_number,
)

from dlgmd_cli.errors import MissingExtraError, ParameterError
from dlgmd_cli.models import engines
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.engines import just_below
from dlgmd_cli.models.engines.opencv import TILE_HW, tiles
from dlgmd_cli.parameters.presets import DlgmdParameters, LgmdParameters
from dlgmd_cli.tasks.run import engine_for


@pytest.fixture
def loops():
    """The module of the numba engine."""
    pytest.importorskip("numba", reason="the numba engine needs numba")
    return import_module("dlgmd_cli.models.engines.numba")


def test_tiles_cover_every_pixel_once_with_what_it_depends_on():
    for shape in ((1, 1), TILE_HW, (TILE_HW[0] + 1, TILE_HW[1] + 1), (700, 1300)):
        count = np.zeros(shape, int)
        for tile in tiles(shape, radius=6):
            count[tile.target] += 1
            whole = np.arange(shape[0] * shape[1]).reshape(shape)
            window = whole[tile.window]
            assert np.array_equal(window[tile.core], whole[tile.target])
            for place, side in enumerate(shape):
                needed = tile.target[place].start - 7, tile.target[place].stop + 8
                assert tile.window[place].start == max(0, needed[0])
                assert tile.window[place].stop == min(side, needed[1])
        assert np.all(count == 1)


@pytest.mark.parametrize("name", ["dlgmd", "dlgmd-onoff"])
def test_what_is_no_number_is_not_hidden(name):
    check_what_is_no_number("opencv", name)


@pytest.mark.parametrize("threshold", [1e-30, 0.1, 0.25, 1 / 3, 0.3, 1.0, 7.25])
def test_just_below_turns_greater_into_at_least(threshold):
    below = just_below(threshold)
    assert below == np.float32(below) < threshold
    assert float(np.nextafter(np.float32(below), np.float32(math.inf))) >= threshold


# The choice


def test_numba_is_chosen_for_large_frames_where_it_is_there(loops, monkeypatch):
    least = engines.WORTH_COMPILING_PX
    assert engines.choose_engine("auto", least) == "numba"
    assert engines.choose_engine("auto", least - 1) == "opencv"
    assert engines.choose_engine("opencv", least) == "opencv"
    assert engines.choose_engine("numba", 1) == "numba"
    monkeypatch.setitem(sys.modules, "numba", None)
    assert engines.choose_engine("auto", least) == "opencv"
    with pytest.raises(MissingExtraError, match=r"numba.*not installed.*pip install"):
        DLGMD(engine="numba")


def test_a_numba_that_cannot_be_loaded_is_not_chosen(loops, monkeypatch, caplog):
    def load(name):
        if name == "numba":
            raise RuntimeError("NumPy is too new")
        return import_module(name)

    monkeypatch.setattr(engines, "import_module", load)
    assert engines.choose_engine("auto", engines.WORTH_COMPILING_PX) == "opencv"
    assert "cannot be loaded (NumPy is too new); the engine is opencv" in caplog.text
    with pytest.raises(MissingExtraError, match=r"cannot be loaded \(NumPy is too new\)"):
        DLGMD(engine="numba")


def test_the_engine_of_a_sweep_is_that_of_a_run(loops):
    dlgmd = DlgmdParameters()
    assert engine_for(dlgmd, "auto", (480, 270)) == "opencv"
    assert engine_for(dlgmd, "auto", (1920, 1080)) == "numba"
    assert engine_for(dlgmd, "numba", (48, 27)) == "numba"
    assert engine_for(LgmdParameters(), "auto", (1920, 1080)) == "opencv"
    with pytest.raises(ParameterError, match="the model lgmd has no engine 'numba'"):
        engine_for(LgmdParameters(), "numba", (48, 27))


def test_an_unknown_engine_is_refused():
    with pytest.raises(ParameterError, match=r"no engine 'cuda'.*opencv, numba, auto"):
        DLGMD(engine="cuda")


# Compilation


def test_compilation_is_announced_once(loops, caplog):
    from numba.core.event import end_event, install_listener, start_event

    caplog.set_level("INFO", "dlgmd_cli")
    with install_listener("numba:compile", loops.Announcement()):
        for _ in range(3):
            start_event("numba:compile")
            end_event("numba:compile")
    assert caplog.text.count("Compiling the numba engine") == 1
