"""Axes and grids, and which files of a sweep are replaced."""

import os
from pathlib import Path

import numpy as np
import pytest
from conftest import csv_rows, looming_frames
from hypothesis import given
from hypothesis import strategies as st

import dlgmd_cli
from dlgmd_cli.errors import OutputError, OutputExistsError, ParameterError
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results.grid import MAX_POINTS, MAX_VALUES, Axis, Grid


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
        ("formulation=released-2021,default", ("released-2021", "default")),
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
        ("r=2:3:0.5", "r = 2.5 is not a whole number"),
    ],
)
def test_what_is_not_an_axis(text, why):
    with pytest.raises(ParameterError) as caught:
        axis(text)
    assert why in str(caught.value) and len(str(caught.value)) < 300


def test_grid_counts_along_x():
    grid = Grid(axis("r=2:4:1"), axis("ffi_gd=true,false"))
    assert len(grid) == 6 and grid.shape == (2, 3)
    assert grid.values(2) == (4, True) and grid.values(3) == (2, False)
    assert grid.overrides(4) == {"r": 3, "ffi_gd": False}
    with pytest.raises(ParameterError, match="x and y are both r"):
        Grid(axis("r=2:4:1"), axis("r=5:6:1"))
    with pytest.raises(ParameterError, match=f"1000 x 101 points are more than {MAX_POINTS}"):
        Grid(axis("a=0.1:100:0.1"), axis("sigma_e=1:11:0.1"))


FRAMES = np.array(looming_frames(9))
CUBES = {"x": "a=2,2.0000000001", "y": "ffi_gd=true,false", "speed": (1.0, 2.5), "frames": 7}
CUBES |= {"size": (40, 30), "cube_size": 8.0, "jobs": 1}
FOLDER = "sweep-translating-cubes"


def test_the_rows_are_clip_by_clip_and_along_x(tmp_path):
    found = dlgmd_cli.sweep(**CUBES, out=tmp_path)
    rows = (tmp_path / FOLDER / "sweep.csv").read_text().splitlines()[1:]
    keys = [tuple(row.split(",")[:3]) for row in rows]
    assert keys[:3] == [("2", "true", "1"), ("2.0000000001", "true", "1"), ("2", "false", "1")]
    assert len(keys) == 8 and keys[4] == ("2", "true", "2.5")
    assert list(found.table["a"][:2]) == [2.0, 2.0000000001]


def test_an_earlier_sweep_is_replaced_only_on_demand(tmp_path):
    asked = {"video": FRAMES, "model": DlgmdParameters(), "x": "sigma_e=1,2", "jobs": 1}
    dlgmd_cli.sweep(**asked, y="a=0.5,1", out=tmp_path, formats=["svg"])
    (folder,) = tmp_path.iterdir()
    assert sorted(os.listdir(folder)) == ["sweep.csv", "sweep.svg", "sweep.yaml"]
    (folder / "notes.txt").write_text("mine")
    before = (folder / "sweep.csv").read_bytes()
    with pytest.raises(OutputExistsError, match=r"sweep\.csv.*overwrite=True"):
        dlgmd_cli.sweep(**asked, y="a=0.5,1", out=tmp_path)
    assert (folder / "sweep.csv").read_bytes() == before
    other = dlgmd_cli.sweep(**asked, y="a=0.5,1,2", out=tmp_path, overwrite=True)
    expected = [float(row["mp_max"]) for row in csv_rows(folder / "sweep.csv")]
    assert other.table["mp_max"] == pytest.approx(expected, rel=1e-8)
    assert sorted(os.listdir(folder)) == ["notes.txt", "sweep.csv", "sweep.yaml"]


def test_a_full_disk_is_one_line(tmp_path, monkeypatch):
    def full(self, mode="r", **options):
        if "frames" in self.name:
            raise OSError(28, "No space left on device")
        return opened(self, mode, **options)

    opened = Path.open
    monkeypatch.setattr(Path, "open", full)
    with pytest.raises(OutputError, match=r"cannot be written \(No space left on device\)"):
        dlgmd_cli.sweep(**CUBES, out=tmp_path)
