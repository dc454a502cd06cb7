"""The compiled engine gives the answers of the other, whatever the size of the frame.

These compile for the levels of frames, which takes as long as a tenth of the fast tier.
"""

import math
import sys
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from pickle import UnpicklingError

import numpy as np
import pytest
from conftest import csv_rows, looming_frames, yaml_of
from engine_checks import SUMS, answers, assert_engines_agree, create, scene
from reference import slow

sys.path.append(str(Path(__file__).parents[1] / "unit"))
from test_variants import test_gaussians_only_save_operations as check_gaussians
from test_variants import test_layer_by_layer_is_what_the_engine_computes as check_layers

from dlgmd_cli.models import engines
from dlgmd_cli.models.base import Response
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.normalise import LEAST_PEAK
from dlgmd_cli.parameters.presets import DlgmdParameters, load_set

pytestmark = pytest.mark.slow


@pytest.fixture
def loops():
    """The module of the numba engine."""
    pytest.importorskip("numba", reason="the numba engine needs numba")
    return import_module("dlgmd_cli.models.engines.numba")


def test_what_rounding_leaves_is_no_attenuation(loops):
    """E and aI are equal here: OpenCV leaves 1e-10 of P, -100 dB, and Numba nothing."""
    params = replace(load_set(5), sigma_e=1.5, sigma_i=2.0)
    found = {}
    for engine in ("opencv", "numba"):
        model = DLGMD(params, engine=engine)
        found[engine] = [model.step(one) for one in looming_frames(12, 96, 72)][3:]
        assert [one.attenuation_db for one in found[engine]] == [-math.inf] * 9
    assert any(one.s_sum > 0.0 for one in found["opencv"])
    assert Response(1.0, 2e-7, 0.0).attenuation_db == pytest.approx(-67.0, abs=0.1)


# Around the sides of OpenCV's tiles and of the compiled engine's blocks.
@pytest.mark.parametrize("shape", [(40, 481), (271, 30), (29, 20), (30, 20), (1, 600), (600, 1)])
def test_the_engines_agree_at_every_size(loops, shape):
    assert_engines_agree(scene(*shape))


@pytest.mark.parametrize("shape", [(40, 481), (271, 30)])
def test_the_engines_agree_for_pathways(loops, shape):
    assert_engines_agree(scene(*shape), "dlgmd-onoff")


@pytest.mark.parametrize("engine", engines.ENGINES)
def test_twice_the_same_to_the_last_bit(loops, engine):
    frames = scene(300, 530)
    model = DLGMD(DlgmdParameters(a=0.4), engine=engine)
    first = [model.step(frame) for frame in frames]
    model.reset()
    again = [model.step(frame) for frame in frames]
    fresh = answers(engine, frames)
    for a, b, c in zip(first[3:], again[3:], fresh[3:], strict=True):
        assert all(getattr(a, n) == getattr(b, n) == getattr(c, n) for n in SUMS)


@pytest.mark.parametrize("n_bands", [2, 3, 4])
@pytest.mark.parametrize("shape", [(4, 50), (5, 7), (63, 530), (200, 90)])
def test_bands_of_rows_give_what_one_gives(loops, monkeypatch, shape, n_bands):
    frames = scene(*shape)
    whole = answers("numba", frames)
    monkeypatch.setattr(loops, "MIN_BAND_PX", 1)
    monkeypatch.setattr(loops, "MAX_BANDS", n_bands)
    monkeypatch.setattr(loops, "n_threads", lambda: 8)
    model = create("numba")
    in_bands = [model.step(frame, layers=True) for frame in frames]
    assert len(model._engine._bands) == n_bands + 1
    for a, b in zip(whole[3:], in_bands[3:], strict=True):
        assert np.array_equal(a.layers.s, b.layers.s) and np.array_equal(a.layers.g, b.layers.g)
        assert b.s_sum == pytest.approx(a.s_sum, rel=1e-12)
        assert b.mp == pytest.approx(a.mp, rel=1e-12)


def test_small_frames_are_worked_on_in_one_thread(loops):
    model = DLGMD(engine="numba")
    model.step(np.zeros((270, 480), np.uint8))
    assert len(model._engine._bands) == 2


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize("number", range(1, 10))
def test_layer_by_layer_is_what_the_engine_computes(loops, number, formulation):
    check_layers(number, formulation, "numba")


def test_gaussians_only_save_operations(loops):
    check_gaussians("numba")


# Gains without limits: the largest sums that the ranges of the parameters allow.
EXTREMES = [
    {},
    {"a": 100.0, "k": 100.0},
    {"a": 0.0, "k": 100.0, "saturate": False},
    {"m": 0.001, "t0": 100.0, "saturate": False},
    {"sigma_e": 100.0, "sigma_i": 0.01, "r": 32},
    {"k": 1e-12},
]


@pytest.mark.parametrize("changes", EXTREMES, ids=str)
@pytest.mark.parametrize("shape", [(1, 1), (2, 3), (90, 120)], ids=str)
def test_engines_agree_to_1e4_of_the_peak(loops, shape, changes):
    one, other = ([a.mp for a in answers(e, scene(*shape), **changes)] for e in engines.ENGINES)
    assert np.isfinite(one[3:]).all()
    peak = max(LEAST_PEAK, np.nanmax(np.abs(one)))  # less is rounding
    np.testing.assert_allclose(other, one, rtol=0, atol=1e-4 * peak)


def test_commands_take_an_engine_and_record_it(loops, runs, clips):
    clip, mp = clips / "loom.avi", {}
    for engine in engines.ENGINES:
        runs("run", clip, "--out", engine, "--engine", engine)
        record = f"{engine}/loom/run.yaml"
        assert yaml_of(record)["engine"] == engine
        runs("run", clip, "--config", record, "--out", "again", "--overwrite")
        assert Path("again/loom/run.yaml").read_text() == Path(record).read_text()
        mp[engine] = Path(engine, "loom/mp.csv").read_text()
        assert Path("again/loom/mp.csv").read_text() == mp[engine]
    runs("run", clip, "--config", "numba/loom/run.yaml", "--engine", "opencv", "--out", "other")
    assert Path("other/loom/mp.csv").read_text() == mp["opencv"]
    Path("fast.yaml").write_text("preset: flight\nengine: numba\n")
    runs("compare", clip, "--config", "fast.yaml", "--set", 9)
    compared = [row for row in csv_rows("dlgmd-out/loom/compare.csv") if row["label"] == "fast"]
    alone = csv_rows("numba/loom/mp.csv")
    assert [row["mp"] for row in compared] == [row["mp"] for row in alone]


@pytest.mark.parametrize(
    "error", [OSError(), EOFError(), UnpicklingError(), RuntimeError("no locator available")]
)
def test_a_cache_that_fails_costs_only_time(loops, monkeypatch, error):
    expected, compiled = answers("numba", scene(20, 30)), loops._compiled(True)

    def load(on_disk):
        if on_disk:
            raise error
        return compiled

    monkeypatch.setattr(loops, "_compiled", load)
    found = answers("numba", scene(20, 30))
    assert [one.mp for one in found[3:]] == [one.mp for one in expected[3:]]
