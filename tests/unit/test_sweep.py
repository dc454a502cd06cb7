"""Grids of parameters, inputs that are played again, processes that share the work, journals."""

import json
import math
import os
import signal
import sys
import tempfile
import time
from contextlib import suppress
from itertools import pairwise

import numpy as np
import pytest
from conftest import looming_frames
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.errors import (
    FrameError,
    OutputError,
    OutputExistsError,
    ParameterError,
    WorkerError,
)
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters import DlgmdParameters, EmdLgmdParameters, LgmdParameters
from dlgmd_cli.results.journal import Journal
from dlgmd_cli.runs import spool as spool_module
from dlgmd_cli.runs.axis import MAX_POINTS, MAX_VALUES, Axis, Grid
from dlgmd_cli.runs.spool import Spool
from dlgmd_cli.runs.sweep import (
    Attenuation,
    Probe,
    ResponseMeasures,
    engine_for,
    grid_parameters,
    shortest_need,
    sweep,
)
from dlgmd_cli.runs.workers import Workers, here
from dlgmd_cli.video.frames import Frame


def axis(text, kind=DlgmdParameters):
    return Axis.parse(text, kind)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("sigma_e=0.2:0.5:0.1", (0.2, 0.3, 0.4, 0.5)),
        ("sigma_e=0.1:0.35:0.1", (0.1, 0.2, 0.3)),
        ("sigma_e=0:1:0.333333333", (0.0, 0.333333333, 0.666666666, 0.999999999)),
        ("sigma_e=0:1:0.33333334", (0.0, 0.33333334, 0.66666668, 1.0)),  # not beyond its end
        ("sigma_e = 2 : 2 : 1", (2.0,)),
        ("alpha=-0.2:.2:.2", (-0.2, 0.0, 0.2)),
        ("kappa=1e-4,1E-2, 1e-3", (1e-4, 1e-3, 1e-2)),
        ("r=2:8:3", (2, 5, 8)),
        ("r=2.0:4:1", (2, 3, 4)),
        ("r=8,2", (2, 8)),
        ("ffi_gd=true,false", (True, False)),
        ("formulation=released,default", ("released", "default")),
    ],
)
def test_axis(text, values):
    parsed = axis(text)
    assert parsed.values == values and len(parsed) == len(values)
    assert all(type(one) is type(other) for one, other in zip(parsed.values, values, strict=True))
    assert parsed.is_numeric == (type(values[0]) in (int, float))


@given(st.integers(-500, 500), st.integers(1, 99), st.integers(0, 200))
def test_values_of_a_range_are_what_one_would_write(start, step, count):
    numbers = [(start + i * step) / 100 for i in range(count + 1)]
    text = f"sigma_e={start / 100}:{numbers[-1]}:{step / 100}"
    assert axis(text).values == tuple(numbers)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("sigma_e", "'sigma_e' is no axis"),
        ("=1", "is no axis"),
        ("r=", "is no axis"),
        ("sigma_x=1", "unknown parameter 'sigma_x'. Did you mean 'sigma_e'?"),
        ("r=1:2", "'1:2' is not FROM:TO:STEP in numbers"),
        ("r=1:2:x", "is not FROM:TO:STEP in numbers"),
        ("r=1:nan:1", "is not FROM:TO:STEP in numbers"),
        (f"r=1:{'9' * 50}:1", "is not FROM:TO:STEP in numbers"),
        ("r=1:5:0", "its STEP is not above 0"),
        ("r=5:1:1", "its TO is below its FROM"),
        ("a=0:1:1e-300", "values are more than 1000"),
        (f"a={','.join(map(str, range(MAX_VALUES + 1)))}", "1001 values are more than 1000"),
        ("a=1,,2", "has an empty value"),
        ("a=1,1.0", "a = 1.0 stands twice"),
        ("a=one", "a = 'one' is not a number"),
        ("a=inf", "is not a number"),
        ("r=2:3:0.5", "r = 2.5 is not a whole number"),
        ("r=1e300", "is not a whole number"),
        ("ffi_gd=0:1:1", "is not one of true, false"),
        ("formulation=printed", "is not one of default, released, equations"),
    ],
)
def test_what_is_no_axis(text, why):
    with pytest.raises(ParameterError) as caught:
        axis(text)
    assert why in str(caught.value) and len(str(caught.value)) < 300


@given(st.text(max_size=60))
def test_any_text_is_an_axis_or_an_error(text):
    with suppress(ParameterError):
        assert 1 <= len(axis(text)) <= MAX_VALUES


def test_grid_counts_along_x():
    grid = Grid(axis("r=2:4:1"), axis("ffi_gd=true,false"))
    assert len(grid) == 6 and grid.shape == (2, 3)
    assert grid.values(2) == (4, True) and grid.values(3) == (2, False)
    assert grid.overrides(4) == {"r": 3, "ffi_gd": False}


def test_what_is_no_grid():
    with pytest.raises(ParameterError, match="--x and --y are both r"):
        Grid(axis("r=2:4:1"), axis("r=5:6:1"))
    with pytest.raises(ParameterError, match=f"1000 x 101 points are more than {MAX_POINTS}"):
        Grid(axis("a=0.1:100:0.1"), axis("sigma_e=1:11:0.1"))


def test_points_that_are_not_possible_are_left_out():
    grid = Grid(axis("alpha=-1:0:0.25"), axis("sigma_e=-1,2"))
    points, fault = grid_parameters(grid, DlgmdParameters())
    assert list(points) == [7, 8, 9]
    assert points[8] == DlgmdParameters(alpha=-0.25, sigma_e=2.0)
    assert fault.why == "sigma_e = -1.0 is not above 0"
    with pytest.raises(ParameterError, match=r"--x and --y: sigma_e = 0\.0 is not above 0"):
        grid_parameters(Grid(axis("r=2,4"), axis("sigma_e=0")), DlgmdParameters())


@pytest.fixture(params=["uint8", "float32"])
def clips(request):
    """Two clips that differ in length; the upper and the lower rows are still."""
    first = [f.copy() for f in looming_frames(9)]
    second = [f.copy() for f in looming_frames(7)[::-1]]
    if request.param == "float32":
        first, second = ([np.float32(f) / np.float32(255) for f in c] for c in (first, second))
    return first, second


def spooled(spool, clips):
    for clip in clips:
        spool.add(Frame(i, i / 25, picture) for i, picture in enumerate(clip))
    return spool.tape


@pytest.mark.parametrize("kind", [DlgmdParameters, LgmdParameters, EmdLgmdParameters])
def test_a_tape_played_is_the_input_stepped_through(clips, kind):
    with Spool(keeps_frames=kind is not DlgmdParameters) as spool:
        player = spooled(spool, clips).open()
        for _ in range(2):
            model = create_model(kind(), engine="opencv")
            for clip, recording in zip(clips, player.play(model), strict=True):
                fresh = create_model(kind(), engine="opencv")
                expected = [fresh.step(picture) for picture in clip]
                frame, time_s, p_sum, s_sum, attenuation_db, mp = recording.columns()
                assert frame.tolist() == list(range(len(clip)))
                assert time_s[3] == 3 / 25
                for name, found in (
                    ("p_sum", p_sum),
                    ("s_sum", s_sum),
                    ("attenuation_db", attenuation_db),
                    ("mp", mp),
                ):
                    wanted = [getattr(response, name) for response in expected]
                    assert np.array_equal(found, wanted, equal_nan=True), name


def test_attenuation_alone_needs_neither_grouping_nor_rows_at_rest(clips):
    clips = [[np.pad(f, ((30, 50), (0, 0)), mode="edge") for f in clip] for clip in clips]
    points = {3: DlgmdParameters(r=3, a=0.5), 8: DlgmdParameters(r=8, a=0.5)}
    with Spool(keeps_frames=False) as spool:
        tape = spooled(spool, clips)
        assert (tape.top, tape.bottom) == changing_rows(clips)
        probe = Probe.economic(points, tape, Attenuation(), "opencv")
        assert probe.reach_px == 8
        found = dict(sweep(points, probe))
        for point, params in points.items():
            for clip, (value,) in zip(clips, found[point], strict=True):
                model = DLGMD(params, engine="opencv")
                db = np.array([model.step(picture).attenuation_db for picture in clip])
                assert value == pytest.approx(db[np.isfinite(db)].mean(), rel=1e-12)


def changing_rows(clips):
    changes = [np.any(b != a, axis=1) for clip in clips for a, b in pairwise(clip)]
    rows = np.flatnonzero(np.any(changes, axis=0))
    return rows[0], rows[-1] + 1


@pytest.mark.parametrize("engine", ["opencv", "numba"])
def test_a_model_without_grouping_has_no_potential(engine):
    if engine == "numba":
        pytest.importorskip("numba", reason="the numba engine needs numba")
    frames = looming_frames(6)
    whole, part = (DLGMD(engine=engine, groups=groups) for groups in (True, False))
    for frame in frames:
        one, other = whole.step(frame), part.step(frame)
        assert math.isnan(other.mp)
        assert other.s_sum == one.s_sum or math.isnan(one.s_sum)
        assert other.attenuation_db == one.attenuation_db or math.isnan(one.s_sum)


def test_attenuation_of_other_models_needs_all(clips):
    points = {0: LgmdParameters()}
    with Spool(keeps_frames=True) as spool:
        probe = Probe.economic(points, spooled(spool, clips), Attenuation(), "opencv")
        assert probe.reach_px is None


def test_frames_that_were_not_kept(clips):
    with Spool(keeps_frames=False) as spool:
        player = spooled(spool, clips).open()
        with pytest.raises(FrameError, match="only its changes are on record"):
            next(player.play(create_model(LgmdParameters())))


def test_a_spool_leaves_nothing_behind(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with pytest.raises(ZeroDivisionError), Spool(keeps_frames=True) as spool:
        tape = spooled(spool, [looming_frames(5)])
        assert sorted(os.listdir(tape.folder)) == ["changes", "frames"]
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == []


def test_a_tape_outlives_its_folder(tmp_path, monkeypatch, clips):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Spool(keeps_frames=False) as spool:
        player = spooled(spool, clips).open()
        spool.unlink()
        assert os.listdir(tmp_path) == []
        assert [len(recording) for recording in player.play(DLGMD())] == [9, 7]


def test_no_room_for_a_spool(monkeypatch):
    def full(self, name, picture):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(spool_module.Spool, "_write", full)
    with (
        pytest.raises(OutputError, match=r"cannot be kept there \(No space left on device\)"),
        Spool(keeps_frames=False) as spool,
    ):
        spooled(spool, [looming_frames(5)])
    monkeypatch.setattr(tempfile, "tempdir", "/nonexistent")
    with pytest.raises(OutputError, match="/nonexistent: the decoded frames cannot be kept there"):
        Spool(keeps_frames=False).__enter__()


@pytest.mark.parametrize("params", [DlgmdParameters(r=3), LgmdParameters()])
def test_values_do_not_depend_on_the_number_of_processes(params):
    key = "sigma_e" if isinstance(params, DlgmdParameters) else "w_i"
    kind = type(params)
    grid = Grid(axis(f"{key}=0.2:1:0.2", kind), axis("t_mp=0.2:0.6:0.2", kind))
    points, _ = grid_parameters(grid, params)
    measure = ResponseMeasures(false_positive_frame=3)
    with Spool(keeps_frames=True) as spool:
        probe = Probe(spooled(spool, [looming_frames(30, 64, 48)]), measure, "opencv")
        alone, shared = (dict(sweep(points, probe, jobs=jobs)) for jobs in (1, 2))
    assert list(alone) == list(range(15)) and set(shared) == set(alone)
    assert all(np.array_equal(alone[p], shared[p], equal_nan=True) for p in alone)
    assert len({alone[p] for p in alone}) > 5


def test_measures_of_a_response():
    with Spool(keeps_frames=False) as spool:
        frames = looming_frames(30, 96, 72)
        tape = spooled(spool, [frames[:1] * 12 + frames])
        points = {0: DlgmdParameters(), 1: DlgmdParameters(a=100.0), 2: DlgmdParameters(a=0.0)}
        found = dict(sweep(points, Probe(tape, ResponseMeasures(4), "opencv")))
    named = {
        p: dict(zip(ResponseMeasures.columns, row, strict=True)) for p, (row,) in found.items()
    }
    assert named[0]["mp_max_frame"] == 41 and named[0]["mp_max"] > 0.0
    assert named[0]["distinguishability"] == math.inf
    assert 0.0 < named[0]["sharpness"] < named[2]["sharpness"] < 1.0
    assert named[1]["mp_max"] == 0.0
    assert all(math.isnan(named[1][c]) for c in ("sharpness", "first_collision_frame"))
    assert named[1]["mean_attenuation_db"] < -60.0 < named[0]["mean_attenuation_db"]


def test_how_many_frames_are_needed():
    points = {0: DlgmdParameters(), 1: DlgmdParameters(alpha=0.0, beta=0.0, lam=0.0)}
    assert shortest_need(points, 2) == 3
    assert shortest_need(points, 3) is None
    assert shortest_need({0: points[0]}, 3) == 4


def test_the_engine_is_that_of_a_run():
    pytest.importorskip("numba", reason="the numba engine needs numba")
    tell = pytest.fail
    assert engine_for(DlgmdParameters(), "auto", (480, 270), tell) == "opencv"
    assert engine_for(DlgmdParameters(), "auto", (1920, 1080), tell) == "numba"
    assert engine_for(DlgmdParameters(), "numba", (48, 27), tell) == "numba"
    assert engine_for(LgmdParameters(), "auto", (1920, 1080), tell) == "opencv"
    with pytest.raises(ParameterError, match="the model lgmd has no engine 'numba'"):
        engine_for(LgmdParameters(), "numba", (48, 27), tell)


def test_engines_agree_on_several_processes():
    pytest.importorskip("numba", reason="the numba engine needs numba")
    points = {0: DlgmdParameters(), 1: DlgmdParameters(sigma_e=2.5)}
    with Spool(keeps_frames=False) as spool:
        tape = spooled(spool, [looming_frames(30, 96, 72)])
        opencv, numba = (
            dict(sweep(points, Probe(tape, ResponseMeasures(), engine), jobs=2))
            for engine in ("opencv", "numba")
        )
    for point in points:
        assert np.allclose(opencv[point], numba[point], rtol=1e-4, equal_nan=True)


def square():
    return lambda number: number * number


def dying():
    return lambda number: os.kill(os.getpid(), signal.SIGKILL) if number == 3 else number


def failing():
    return lambda number: 1 // (number - 3)


def failing_at_once():
    raise OSError(28, "No space left on device")


def slow():
    return lambda seconds: time.sleep(seconds)


def test_workers_answer_every_task():
    numbers = range(50)
    for pool in (Workers(3, square), here(square)):
        with pool as answers:
            assert dict(answers(iter(numbers))) == {n: n * n for n in numbers}
            assert dict(answers([7])) == {7: 49}
            assert dict(answers([])) == {}


def test_a_dead_worker_is_an_error():
    with (
        pytest.raises(WorkerError, match="a worker process: it was killed by signal 9"),
        Workers(2, dying) as answers,
    ):
        list(answers(range(10)))


def test_what_a_worker_raises_is_raised():
    with pytest.raises(ZeroDivisionError), Workers(2, failing) as answers:
        list(answers(range(10)))
    with pytest.raises(OSError, match="No space left"), Workers(2, failing_at_once):
        pass


def test_workers_end_in_the_middle_of_a_task():
    began = time.monotonic()
    pool = Workers(2, slow)
    with pytest.raises(KeyboardInterrupt), pool as answers:
        for _ in answers([0, 60, 60]):
            raise KeyboardInterrupt
    assert time.monotonic() - began < 30 and not pool._workers


PRODUCTS = frozenset({"table.csv"})


def journal(folder, settings=None, **options):
    return Journal(folder, "j.jsonl", PRODUCTS, settings or {"x": (1, 2)}, **options)


def test_journal_goes_on_where_it_ended(tmp_path):
    folder = tmp_path / "out" / "sweep"
    with journal(folder) as first:
        assert first.points == {}
        first.begin()
        first.note({"frames": 4})
        first.add(5, [[1.5, math.inf]])
        first.add(2, [[math.nan, 0.1]])
    whole = (folder / "j.jsonl").read_bytes()
    (folder / "j.jsonl").write_bytes(whole + b"[7, [[1.0, 2")  # killed in mid-line
    with journal(folder) as second:
        assert second.facts == {"frames": 4}
        assert second.points[5] == [[1.5, math.inf]] and list(second.points) == [5, 2]
        assert math.isnan(second.points[2][0][0])
        second.begin()
        second.add(7, [[1.0, 2.0]])
    assert (folder / "j.jsonl").read_bytes() == whole + b"[7, [[1.0, 2.0]]]\n"


def test_journal_stops_at_a_damaged_line(tmp_path):
    with journal(tmp_path / "s") as first:
        first.begin()
        for point in range(4):
            first.add(point, [[1.0]])
    path = tmp_path / "s" / "j.jsonl"
    for damage in (b"[2, nonsense]", b'"text"', b"[99, [[1.0]]]", b"\xff\xfe"):
        lines = path.read_bytes().splitlines()
        lines[3] = damage
        path.write_bytes(b"\n".join(lines) + b"\n")
        with journal(tmp_path / "s", is_point=lambda point, values: point < 10) as second:
            assert list(second.points) == [0, 1]


def test_journal_of_nothing_leaves_nothing(tmp_path):
    with pytest.raises(ZeroDivisionError), journal(tmp_path / "a" / "b"):
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == []
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "b" / "mine.txt").write_text("mine")
    with journal(tmp_path / "a" / "b"):
        pass
    assert os.listdir(tmp_path / "a" / "b") == ["mine.txt"]


def test_journal_of_other_settings(tmp_path):
    with journal(tmp_path / "s", {"x": 1, "y": 2}) as first:
        first.begin()
        first.add(0, [[1.0]])
    for name in ("table.csv", "mine.txt"):
        (tmp_path / "s" / name).write_text("kept?")
    with (
        pytest.raises(OutputExistsError, match=r"a result of other settings stands here \(y, z\)"),
        journal(tmp_path / "s", {"x": 1, "y": 3, "z": 4}),
    ):
        pass
    assert (tmp_path / "s" / "table.csv").exists()
    with journal(tmp_path / "s", {"x": 1, "y": 3}, overwrite=True) as second:
        assert second.points == {} and (tmp_path / "s" / "table.csv").exists()
        second.begin()
        assert sorted(os.listdir(tmp_path / "s")) == ["j.jsonl", "mine.txt"]
    lines = (tmp_path / "s" / "j.jsonl").read_text().splitlines()
    assert [json.loads(line) for line in lines] == [{"settings": {"x": 1, "y": 3}}]


@pytest.mark.parametrize("overwrite", [False, True])
@pytest.mark.parametrize("name", ["j.jsonl", "table.csv"])
def test_files_of_others_are_never_touched(tmp_path, name, overwrite):
    (tmp_path / name).write_text("mine\n")
    with (
        pytest.raises(OutputExistsError, match=f"holds other files, such as {name}"),
        journal(tmp_path, overwrite=overwrite),
    ):
        pass
    assert (tmp_path / name).read_text() == "mine\n" and os.listdir(tmp_path) == [name]


def test_no_folder_of_results(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to(tmp_path, target_is_directory=True)
    for name in ("file", "link"):
        with pytest.raises(OutputExistsError, match="no folder of results"):
            journal(tmp_path / name).__enter__()
    with pytest.raises(OutputError, match="cannot be written"):
        journal(tmp_path / "file" / "s").__enter__()


@pytest.mark.skipif(sys.platform == "win32", reason="its locks are others")
def test_two_at_once_do_not_mix(tmp_path):
    with journal(tmp_path / "s") as first:
        first.begin()
        with pytest.raises(OutputExistsError, match="another 'dlgmd' is writing here"):
            journal(tmp_path / "s", overwrite=True).__enter__()
        first.add(0, [[1.0]])
    with journal(tmp_path / "s") as second:
        assert list(second.points) == [0]


def test_a_header_cut_off_is_a_new_beginning(tmp_path):
    (tmp_path / "j.jsonl").write_bytes(b'{"settings": {"x": [1')
    with journal(tmp_path) as one:
        one.begin()
        one.add(0, [[1.0]])
    assert (tmp_path / "j.jsonl").read_bytes() == b'{"settings": {"x": [1, 2]}}\n[0, [[1.0]]]\n'


def test_a_full_disk_is_one_line(tmp_path):
    def full(data):
        raise OSError(28, "No space left on device")

    with journal(tmp_path / "s") as one:
        one.begin()
        file, one._file = one._file, type("Full", (), {"write": staticmethod(full)})()
        with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
            one.add(0, [[1.0]])
        one._file = file
