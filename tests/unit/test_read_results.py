"""Stored comparisons read back, or a line that says what is wrong."""

import numpy as np
import pytest
import yaml
from conftest import make_result

from dlgmd_cli.errors import ResultError
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.results import csv
from dlgmd_cli.results.reading import read_comparison, read_result

NAN, INF = np.nan, np.inf


def write_comparison(folder, *rows, labels=("set9", "lgmd")):
    """A folder as `dlgmd compare` writes it, by hand."""
    folder.mkdir(exist_ok=True, parents=True)
    lines = [",".join(csv.COMPARISON), *rows, ""]
    (folder / "compare.csv").write_text("\n".join(lines), encoding="utf-8")
    model = {"model": "dlgmd", "width": 10, "height": 10, **DlgmdParameters().to_dict()}
    record = {
        "input": {"path": "/somewhere/flight.mp4"},
        "options": {},
        "models": [{"label": label, **model} for label in labels],
    }
    (folder / "compare.yaml").write_text(yaml.safe_dump(record), encoding="utf-8")
    return folder


def test_a_comparison_has_a_result_per_label(tmp_path):
    folder = write_comparison(
        tmp_path,
        *("set9,0,0,,,,", "lgmd,0,0,1,0.5,0.25,-3"),
        *("set9,3,0.1,2,0.75,1,-inf", '"a, ""b""",0,0,1,0.5,0.25,-3', "lgmd,3,0.1,2,0.75,1,-2"),
        labels=("set9", "lgmd", 'a, "b"'),
    )
    results = read_comparison(folder)
    assert list(results) == ["set9", "lgmd", 'a, "b"']
    nine = results["set9"]
    assert nine.frame.tolist() == [0, 3] and nine.time_s.tolist() == [0, 0.1]
    assert np.array_equal(nine.mp, [NAN, 2.0], equal_nan=True)
    assert np.array_equal(nine.attenuation_db, [NAN, -INF], equal_nan=True)
    assert nine.spikes.tolist() == [False, True] and np.isnan(nine.p_sum).all()


@pytest.mark.parametrize(
    ("row", "why"),
    [
        ("set9,2,0,1,1,1", "line 3 does not have 7 cells"),
        ("set9,2,0,1,1,1,x", "something other than numbers"),
        ("set9,1,0,1,1,1,-3", "its rows are not frames in order"),
        ("other,2,0,1,1,1,-3", "compare.csv and compare.yaml do not match"),
    ],
)
def test_damage_of_a_comparison(tmp_path, row, why):
    write_comparison(tmp_path, "set9,1,0,1,1,1,-3", row, labels=["set9"])
    with pytest.raises(ResultError, match=why):
        read_comparison(tmp_path)


def test_what_is_no_comparison(tmp_path):
    with pytest.raises(ResultError, match="contains no comparison"):
        read_comparison(tmp_path)
    for read in (read_result, read_comparison):
        with pytest.raises(ResultError):
            read(tmp_path / "a\0b")


def test_an_ffi_without_limit_is_read(tmp_path):
    result = make_result(np.linspace(0, 500, 60))
    result.rows["ffi"][3] = np.inf  # the model `flight`, where nothing changed before
    result.save(tmp_path)
    assert read_result(tmp_path).ffi[3] == np.inf
