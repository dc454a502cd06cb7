"""Engines give the same answers, whatever the size of the frame, and are chosen as said."""

import math
import os
import subprocess
import sys
from importlib import import_module
from pickle import UnpicklingError

import numpy as np
import pytest
from dlgmd_cli.models.history import CACHE_LINE, History, aligned
from dlgmd_cli.models.tiled import TILE_HW, tiles
from reference import slow

from dlgmd_cli.errors import MissingExtraError, ParameterError
from dlgmd_cli.models import engines
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.engines import just_below
from dlgmd_cli.parameters import DlgmdParameters

SUMS = ("p_sum", "s_sum", "mp", "ffi", "t_de")
# Around the sides of OpenCV's tiles and of the compiled engine's strips and blocks.
SHAPES = [(40, 480), (40, 481), (40, 511), (40, 513), (270, 30), (271, 30), (64, 20), (63, 70)]
SHAPES += [(555, 965), (33, 1025), (1, 600), (600, 1)]
# Here the rows before the last block are just enough for S, and too few for G.
SHAPES += [(1055, 481)]


def scene(height, width, n_frames=6, dtype=np.uint8, seed=3):
    """Blocks that drift, and bright squares that grow fast: something for every tile."""
    rng = np.random.default_rng(seed)
    ground = rng.integers(40, 160, (height // 5 + 9, width // 5 + 9), dtype=np.uint8)
    ground = np.kron(ground, np.ones((5, 5), np.uint8))
    frames = []
    for t in range(n_frames):
        frame = ground[2 * t : 2 * t + height, 3 * t : 3 * t + width].copy()
        for y in range(height // 2 % 80, height, 80):
            for x in range(width // 2 % 80, width, 80):
                rows, columns = (slice(max(0, c - 5 * t), c + 5 * t) for c in (y, x))
                frame[rows, columns] = 250
        frames.append(frame)
    return frames if dtype == np.uint8 else [f.astype(dtype) / dtype(255) for f in frames]


def answers(engine, frames, **changes):
    # Little inhibition, so that something passes everywhere.
    model = DLGMD(DlgmdParameters(**slow.table_2(9, a=0.4) | changes), engine=engine)
    responses = [model.step(frame, layers=True) for frame in frames]
    assert model.engine_name == engine
    return responses


@pytest.fixture
def numba():
    return pytest.importorskip("numba", reason="the numba engine needs numba")


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
@pytest.mark.parametrize("shape", SHAPES)
def test_the_engines_agree_at_every_size(numba, shape, dtype):
    frames = scene(*shape, dtype=dtype)
    one, other = answers("opencv", frames), answers("numba", frames)
    for a, b in zip(one[3:], other[3:], strict=True):
        for name in SUMS:
            assert getattr(a, name) == pytest.approx(getattr(b, name), rel=1e-5, abs=1e-5)
        np.testing.assert_allclose(a.layers.s, b.layers.s, rtol=0, atol=2e-5)
        # A cell at the threshold may fall on either side.
        apart = np.abs(a.layers.g - b.layers.g) > 1e-4
        assert apart.sum() <= 2 and np.all(np.minimum(a.layers.g, b.layers.g)[apart] == 0.0)
    assert max(a.mp for a in one[3:]) > 0.0 or min(shape) == 1


@pytest.mark.parametrize("formulation", slow.FORMULATIONS)
@pytest.mark.parametrize(
    "changes", [{"r": 12, "sigma_i": 9.0}, {"r": 32}, {"alpha": 3.0}, {"r": 1}]
)
def test_the_engines_agree_for_wide_and_late_kernels(numba, changes, formulation):
    frames = scene(90, 530, n_frames=9)
    one, other = (answers(e, frames, formulation=formulation, **changes) for e in engines.ENGINES)
    assert one[-1].is_valid
    for a, b in zip(one, other, strict=True):
        for name in SUMS:
            expected = pytest.approx(getattr(a, name), rel=1e-5, abs=1e-4, nan_ok=True)
            assert getattr(b, name) == expected


@pytest.mark.parametrize("engine", engines.ENGINES)
def test_twice_the_same_to_the_last_bit(numba, engine):
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
def test_bands_of_rows_give_what_one_gives(numba, monkeypatch, shape, n_bands):
    from dlgmd_cli.models import fused

    frames = scene(*shape)
    whole = answers("numba", frames)
    monkeypatch.setattr(fused, "MIN_BAND_PX", 1)
    monkeypatch.setattr(fused, "MAX_BANDS", n_bands)
    monkeypatch.setattr(fused, "n_threads", lambda: 8)
    model = DLGMD(DlgmdParameters(**slow.table_2(9, a=0.4)), engine="numba")
    in_bands = [model.step(frame, layers=True) for frame in frames]
    assert len(model._engine._bands) == n_bands + 1
    for a, b in zip(whole[3:], in_bands[3:], strict=True):
        assert np.array_equal(a.layers.s, b.layers.s) and np.array_equal(a.layers.g, b.layers.g)
        assert b.s_sum == pytest.approx(a.s_sum, rel=1e-12)
        assert b.mp == pytest.approx(a.mp, rel=1e-12)


def test_small_frames_are_worked_on_in_one_thread(numba):
    from dlgmd_cli.models import fused

    model = DLGMD(engine="numba")
    model.step(np.zeros((270, 480), np.uint8))
    assert len(model._engine._bands) == 2
    assert 1 <= fused.n_threads() <= os.cpu_count()


def test_tiles_cover_every_pixel_once_with_what_it_depends_on():
    for shape in ((1, 1), TILE_HW, (TILE_HW[0] + 1, TILE_HW[1] + 1), (700, 1300)):
        count = np.zeros(shape, int)
        for tile in tiles(shape, radius=6):
            count[tile.target] += 1
            whole = np.arange(shape[0] * shape[1]).reshape(shape)
            window = whole[tile.window]
            assert np.array_equal(window[tile.core], whole[tile.target])
            assert np.array_equal(window[tile.grouped][tile.core_in_grouped], whole[tile.target])
            for place, side in enumerate(shape):
                needed = tile.target[place].start - 7, tile.target[place].stop + 8
                assert tile.window[place].start == max(0, needed[0])
                assert tile.window[place].stop == min(side, needed[1])
        assert np.all(count == 1)


# The choice


def test_numba_is_chosen_for_large_frames_where_it_is_there(numba, monkeypatch):
    least = engines.WORTH_COMPILING_PX
    assert engines.choose_engine("auto", least) == "numba"
    assert engines.choose_engine("auto", least - 1) == "opencv"
    assert engines.choose_engine("opencv", least) == "opencv"
    assert engines.choose_engine("numba", 1) == "numba"
    monkeypatch.setitem(sys.modules, "numba", None)
    assert engines.choose_engine("auto", least) == "opencv"


def test_a_missing_numba_is_said_in_one_line(monkeypatch):
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(MissingExtraError) as caught:
        DLGMD(engine="numba")
    assert str(caught.value) == (
        "--engine numba: the package 'numba' is not installed. "
        "Install it with: pip install 'dlgmd[fast]', or use --engine opencv."
    )


def test_a_numba_that_cannot_be_loaded_is_not_chosen(numba, monkeypatch):
    def load(name):
        if name == "numba":
            raise RuntimeError("NumPy is too new")
        return import_module(name)

    monkeypatch.setattr(engines, "import_module", load)
    told = []
    assert engines.choose_engine("auto", engines.WORTH_COMPILING_PX, told.append) == "opencv"
    assert told == [
        "The package 'numba' cannot be loaded (NumPy is too new); the engine is opencv."
    ]
    with pytest.raises(MissingExtraError, match=r"cannot be loaded \(NumPy is too new\)"):
        DLGMD(engine="numba")


def test_an_unknown_engine_is_refused():
    with pytest.raises(ParameterError, match=r"no engine 'cuda'.*opencv, numba, auto"):
        DLGMD(engine="cuda")


def test_compilation_is_announced_once(numba):
    from dlgmd_cli.models.fused import Announcement
    from numba.core.event import end_event, install_listener, start_event

    told = []
    with install_listener("numba:compile", Announcement(told.append)):
        for _ in range(3):
            start_event("numba:compile")
            end_event("numba:compile")
    assert len(told) == 1 and "Compiling the numba engine" in told[0]


def test_an_engine_announces_its_compilation(numba, tmp_path):
    # With two bands, neither of which may compile on its own in the background.
    program = (
        "import numpy as np\n"
        "from dlgmd_cli.models import fused\n"
        "from dlgmd_cli import DLGMD\n"
        "fused.MIN_BAND_PX, fused.n_threads = 1, lambda: 2\n"
        "model = DLGMD(engine='numba', tell=print)\n"
        "for t in range(6): model.step(np.full((40, 50), t, np.uint8))\n"
        "assert len(model._engine._bands) == 3\n"
    )
    lines = []
    for _ in range(2):  # compiled the first time, loaded the second
        done = subprocess.run(
            [sys.executable, "-c", program],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            capture_output=True,
            text=True,
            check=True,
        )
        lines.append(done.stdout.splitlines())
    assert lines == [["Compiling the numba engine; about ten seconds, the first time."], []]


@pytest.mark.parametrize("error", [OSError("disk full"), EOFError(), UnpicklingError("cut off")])
def test_a_cache_that_fails_costs_only_time(numba, monkeypatch, error):
    from dlgmd_cli.models import compiled

    expected, whole = answers("numba", scene(20, 30)), compiled.respond

    def fails(*arguments):
        raise error

    monkeypatch.setattr(compiled, "respond", fails)
    monkeypatch.setattr(compiled, "without_cache", lambda: whole)
    found = answers("numba", scene(20, 30))
    assert [one.mp for one in found[3:]] == [one.mp for one in expected[3:]]


def test_loops_are_compiled_where_nothing_can_be_kept(numba, monkeypatch):
    from dlgmd_cli.models import compiled

    def njit(cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(compiled, "njit", njit)
    assert compiled._cached(len) is len


def test_the_command_line_knows_the_engines():
    from dlgmd_cli.commands._model import ENGINES

    assert ENGINES == engines.ENGINES


@pytest.mark.parametrize("engine", engines.ENGINES)
def test_what_is_no_number_is_not_hidden(numba, engine):
    frames = scene(20, 30, n_frames=9, dtype=np.float32)
    frames[4][5, 5] = np.nan
    model = DLGMD(engine=engine)
    responses = [model.step(frame) for frame in frames]
    assert math.isnan(responses[4].s_sum) and math.isfinite(responses[3].s_sum)
    assert math.isfinite(responses[8].s_sum)  # it has left the history


def test_nothing_is_announced_without_compilation(numba):
    answers("numba", scene(20, 20))
    told = []
    model = DLGMD(engine="numba", tell=told.append)
    for frame in scene(20, 20):
        model.step(frame)
    assert told == []


# Parts


def test_history_gives_what_came_so_many_frames_ago():
    history = History(3, np.zeros((2, 2), np.uint8))
    for t in range(7):
        history.advance()[:] = t
        for delay in range(min(t, 2) + 1):
            assert np.all(history[delay] == t - delay)
            assert np.all(history.stack[history.position(delay)] == t - delay)
    assert history.unit == 1 / 255 and History(1, np.zeros((1, 1), np.float32)).unit == 1.0


def test_memory_starts_at_a_cache_line():
    for shape in ((1,), (7, 3), (2, 5, 9)):
        for dtype in (np.uint8, np.float32):
            memory = aligned(shape, dtype)
            assert memory.shape == shape and memory.dtype == dtype and memory.flags.c_contiguous
            assert memory.ctypes.data % CACHE_LINE == 0


@pytest.mark.parametrize("threshold", [1e-30, 0.1, 0.25, 1 / 3, 0.3, 1.0, 7.25])
def test_just_below_turns_greater_into_at_least(threshold):
    below = just_below(threshold)
    assert below == np.float32(below) < threshold
    assert float(np.nextafter(np.float32(below), np.float32(math.inf))) >= threshold
