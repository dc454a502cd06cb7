"""Axes and grids, the table of a sweep, and that what is done is kept and not done again."""

import math
import os
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from conftest import looming_frames
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.errors import OutputError, OutputExistsError, ParameterError
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.presets import DlgmdParameters, EmdLgmdParameters, LgmdParameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import write_rows
from dlgmd_cli.results.sweep import MAX_POINTS, MAX_VALUES, Axis, Grid, SweepResult
from dlgmd_cli.tasks.call import Setup
from dlgmd_cli.tasks.sweep import Sweep, SweepInput


def axis(text, kind=DlgmdParameters):
    return Axis.parse(text, kind)


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("sigma_e=0.2:0.5:0.1", (0.2, 0.3, 0.4, 0.5)),
        ("sigma_e=0:1:0.33333334", (0.0, 0.33333334, 0.66666668, 1.0)),  # not beyond its end
        ("sigma_e = 2 : 2 : 1", (2.0,)),
        ("alpha=-0.2:.2:.2", (-0.2, 0.0, 0.2)),
        ("kappa=1e-4,1E-2, 1e-3", (1e-4, 1e-3, 1e-2)),
        ("r=2:8:3", (2, 5, 8)),
        ("r=2.0:4:1", (2, 3, 4)),
        ("ffi_gd=true,false", (True, False)),
        ("ffi_gd=True,False", (True, False)),  # as Python writes them
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
        ("sigma_e", "'sigma_e' is not an axis"),
        ("r=", "is not an axis"),
        ("sigma_x=1", "unknown parameter 'sigma_x'. Did you mean 'sigma_e'?"),
        ("r=1:2", "'1:2' is not FROM:TO:STEP in numbers"),
        ("r=1:1e999999999:1", "is not FROM:TO:STEP in numbers"),
        ("r=1:5:0", "its STEP is not above 0"),
        ("r=5:1:1", "its TO is below its FROM"),
        ("a=0:1:1e-300", "values are more than 1000"),
        (f"a={','.join(map(str, range(MAX_VALUES + 1)))}", "1001 values are more than 1000"),
        ("a=1,1.0", "a = 1.0 appears twice"),
        ("a=one", "a = 'one' is not a number"),
        ("r=2:3:0.5", "r = 2.5 is not a whole number"),
        ("formulation=printed", "is not one of default, released-2021, released-2020, equations"),
    ],
)
def test_what_is_not_an_axis(text, why):
    with pytest.raises(ParameterError) as caught:
        axis(text)
    assert why in str(caught.value) and len(str(caught.value)) < 300


@settings(max_examples=40)
@given(st.text(max_size=60))
def test_any_text_is_an_axis_or_an_error(text):
    for words in (text, f"r={text}", f"a={text}"):
        with suppress(ParameterError):
            assert 1 <= len(axis(words)) <= MAX_VALUES


def test_grid_counts_along_x():
    grid = Grid(axis("r=2:4:1"), axis("ffi_gd=true,false"))
    assert len(grid) == 6 and grid.shape == (2, 3)
    assert grid.values(2) == (4, True) and grid.values(3) == (2, False)
    assert grid.overrides(4) == {"r": 3, "ffi_gd": False}
    with pytest.raises(ParameterError, match="x and y are both r"):
        Grid(axis("r=2:4:1"), axis("r=5:6:1"))
    with pytest.raises(ParameterError, match=f"1000 x 101 points are more than {MAX_POINTS}"):
        Grid(axis("a=0.1:100:0.1"), axis("sigma_e=1:11:0.1"))


def table():
    grid = Grid(axis("a=2,2.0000000001"), axis("ffi_gd=true,false"))
    return SweepResult.empty(grid, (1.0, 2.5), ("attenuation_db",), range(4))


def write(path, result, points):
    write_rows(path, result.header, result.rows(points))


def test_a_table_is_read_back(tmp_path):
    first = table()
    first.put(2, [(1.5,), (-math.inf,)])
    first.put(0, [(math.nan,), (0.25,)])
    first.put(1, [(3.0,), (4.0,)])
    assert list(first.rows([2, 1])) == [
        ["2", "false", "1", "1.5"],
        ["2.0000000001", "true", "1", "3"],
        ["2", "false", "2.5", "-inf"],
        ["2.0000000001", "true", "2.5", "4"],
    ]
    write(tmp_path / "t.csv", first, [2, 1, 0])
    again = table()
    again.read(tmp_path / "t.csv")
    assert again.done == {0, 1, 2}
    found, expected = again.columns["attenuation_db"], first.columns["attenuation_db"]
    assert np.array_equal(found, expected, equal_nan=True)


@pytest.mark.parametrize(
    "tail",
    [
        "2,false,1,5.0\n2,false,2.5,6.",
        "2,false,1,5\n",
        "9,true,1,5\n9,true,2.5,5\n",
        "2,false,1,x\n2,false,2.5,x\n",
        "2,false,1\n2,false,2.5\n",
        "\n\n",
        "\udcff,\0\n",
    ],
)
def test_only_whole_points_of_the_grid_are_read(tmp_path, tail):
    result, path = table(), tmp_path / "t.csv"
    result.put(0, [(1.0,), (2.0,)])
    write(path, result, [0])
    path.write_bytes(path.read_bytes() + tail.encode(errors="surrogateescape"))
    again = table()
    again.read(path)
    assert again.done == {0}


def subject(clips, speeds=()):
    """Frames in memory, as a subject."""
    frames = [[Frame(i, i / 25, picture) for i, picture in enumerate(clip)] for clip in clips]
    return SweepInput("test", clips[0][0].shape[::-1], frames, {}, speeds)


def sweep(folder, what, x="sigma_e=1,2", y="a=0.5,1", params=None, engine="opencv"):
    params = params or DlgmdParameters()
    grid = Grid(axis(x, type(params)), axis(y, type(params)))
    folder.mkdir(exist_ok=True)
    return Sweep(folder, what, grid, Setup(params, "set9", engine))


def done(folder, what, **options):
    """A sweep from its beginning to its end."""
    one = sweep(folder, what, **options)
    one.resume()
    one.compute()
    one.result.write(store.ClaimedFolder(folder, one.result.RECORD))
    return one


@pytest.mark.parametrize(
    ("params", "x"),
    [
        (DlgmdParameters(a=0.5), "r=3,8"),
        (LgmdParameters(), "w_i=0.2"),
        (EmdLgmdParameters(), "c=1,2"),
    ],
)
@pytest.mark.parametrize("dtype", ["uint8", "float32"])
def test_values_are_those_of_the_model(tmp_path, params, x, dtype):
    clips = [looming_frames(9), looming_frames(7)[::-1]]
    if dtype == "float32":
        clips = [[np.float32(f) / np.float32(255) for f in clip] for clip in clips]
    one = done(tmp_path / "s", subject(clips, (1.0, 2.0)), x=x, y="t_mp=0.2", params=params)
    assert len(one.points) == len(one.result.done) == len(one.grid)
    for point, at in one.points.items():
        for clip, values in zip(clips, one.result.columns["attenuation_db"], strict=True):
            model = create_model(at, engine="opencv")
            db = np.array([model.step(frame).attenuation_db for frame in clip])
            passing = db[np.isfinite(db)]  # what recedes leaves nothing of the EMD-LGMD
            expected = passing.mean() if passing.size else -math.inf
            assert values.flat[point] == pytest.approx(expected, rel=1e-12)
    assert sorted(os.listdir(tmp_path / "s")) == ["sweep.csv", "sweep.yaml"]


@pytest.mark.parametrize(
    ("options", "differing"),
    [
        ({"y": "a=0.5,1,2"}, "y"),
        ({"y": "k=0.5,1"}, "a, y"),
        ({"params": DlgmdParameters(k=2.0, m=0.3)}, "k, m"),
        ({"engine": "numba"}, "engine"),
    ],
)
def test_another_sweep_is_refused(tmp_path, options, differing):
    what = subject([looming_frames(9)])
    done(tmp_path / "s", what)
    (tmp_path / "s" / "notes.txt").write_text("mine")
    before = (tmp_path / "s" / "sweep.csv").read_bytes()
    other = sweep(tmp_path / "s", what, **options)
    match = rf"a sweep with other settings already exists here \({differing}(, versions)?\)"
    with pytest.raises(OutputExistsError, match=match):
        other.resume()
    other.resume(overwrite=True)
    assert not other.result.done
    assert (tmp_path / "s" / "sweep.csv").read_bytes() == before
    assert (tmp_path / "s" / "notes.txt").read_text() == "mine"


def test_a_full_disk_is_one_line(tmp_path, monkeypatch):
    def full(self, mode="r", **options):
        if "frames" in self.name:
            raise OSError(28, "No space left on device")
        return opened(self, mode, **options)

    opened = Path.open
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
        sweep(tmp_path / "s", subject([looming_frames(9)])).compute()
