"""Stored results read back: exactly, or with a line that says what is wrong with them."""

import re
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.errors import ResultError
from dlgmd_cli.results.cells import cell
from dlgmd_cli.results.comparison import COMPARISON_COLUMNS, write_comparison
from dlgmd_cli.results.read import comparison_at, read_comparison, read_result
from dlgmd_cli.results.tables import TABLES, Result, write_tables

NAN, INF = np.nan, np.inf
FLAGS = ("spike", "collision")


def make_result(n=6, **changes):
    series = np.array([NAN, NAN, 0.25, 1 / 3, 0.125, 0.0])[:n]
    flags = np.array([0, 0, 0, 1, 1, 0], bool)[:n]
    result = Result(
        frame=np.arange(n) * 2,
        time_s=np.arange(n) / 3,
        **dict.fromkeys(("p_sum", "s_sum", "mp", "mp_abs", "mp_seq", "level"), series),
        attenuation_db=np.array([NAN, NAN, -3.0, -INF, -10.0, NAN])[:n],
        threshold=np.full(n, 0.4),
        spike=flags,
        collision=flags & (np.arange(n) > 3),
    )
    return replace(result, **changes)


def as_written(values):
    return np.array([float(cell(value) or "nan") for value in values])


@st.composite
def drawn_results(draw):
    n = draw(st.integers(1, 12))
    numbers = st.floats(-(2.0**66), 2.0**66, width=32) | st.just(NAN)
    rows = st.lists(numbers, min_size=n, max_size=n).map(np.array)
    steps = st.lists(st.integers(1, 1000), min_size=n, max_size=n)
    flags = st.lists(st.booleans(), min_size=n, max_size=n).map(np.array)
    silent = draw(flags)
    series = {field.name: draw(rows) for field in fields(Result)}
    series["attenuation_db"] = np.where(silent, -INF, series["attenuation_db"])
    series["frame"] = np.cumsum(draw(steps)) - 1
    series["time_s"] = np.cumsum(draw(steps)) / 600
    return Result(**{**series, **{name: draw(flags) for name in FLAGS}})


@given(drawn_results())
def test_what_is_written_reads_back(tmp_path_factory, result):
    folder = tmp_path_factory.mktemp("result")
    write_tables(folder, [result])
    again = read_result(folder)
    for field in fields(Result):
        values = getattr(again, field.name)
        assert np.array_equal(values, as_written(getattr(result, field.name)), equal_nan=True)
    assert again.frame.dtype == np.int64
    assert again.spike.dtype == again.collision.dtype == bool


def test_times_that_nine_digits_cannot_tell_apart_are_no_damage(tmp_path):
    write_tables(tmp_path, [make_result(time_s=1e6 + np.arange(6) / 1000)])
    assert (np.diff(read_result(tmp_path).time_s) == 0).any()


def edited(old, new, name="mp.csv"):
    def damage(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return damage


def shortened(name, keep):
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:keep])


DAMAGES = {
    "missing": (
        lambda folder: (folder / "spikes.csv").unlink(),
        "spikes.csv: this file is missing",
    ),
    "empty": (shortened("mp.csv", 0), "mp.csv: its columns are not frame,time_s,mp,mp_abs,mp_seq"),
    "header": (shortened("mp.csv", 30), "mp.csv: it holds no frames"),
    "columns": (edited("mp_abs", "mp_rel"), "mp.csv: its columns are not frame,"),
    "ragged": (edited("4,0.666666667,", "4,0.666666667\n"), "mp.csv: line 4: it has not 5 cells"),
    "blank": (edited("\n4,", "\n\n4,"), "mp.csv: line 4: it has not 5 cells"),
    "word": (edited("0.25", "much"), "mp.csv: line 4: 'much' is no number"),
    "infinite": (edited("0.25", "inf"), "the row of frame 4 is beyond all bounds in mp."),
    "loud": (edited("-inf", "inf", "attenuation.csv"), "6 is beyond all bounds in attenuation_db"),
    "twice": (edited("\n4,", "\n2,"), "the row of frame 2 does not come after the row before"),
    "fraction": (edited("\n4,", "\n3.5,"), "the row of frame 3.5 has no frame number"),
    "negative": (edited("\n0,", "\n-1,"), "the row of frame -1 has no frame number"),
    "endless": (edited("\n10,", "\n1e300,"), "has no frame number"),
    "no frame": (edited("\n4,", "\n,"), "the row of frame nan has no frame number"),
    "no time": (edited("4,0.666666667", "4,"), "the row of frame 4 has no time"),
    "backwards": (edited("4,0.666666667", "4,0.1"), "frame 4 is earlier than the row before it"),
    "flag": (edited(",1,0\n", ",2,0\n", "spikes.csv"), "6 has neither 0 nor 1 as spike"),
    "binary": (
        lambda folder: (folder / "mp.csv").write_bytes(bytes(range(256)) * 90),
        "mp.csv: it cannot be read (it is no table of text)",
    ),
    "NUL": (edited("0.25", "\0"), "mp.csv: "),
    "long line": (edited("0.25", "1" * 20_000), "mp.csv: it has lines too long"),
    "quote": (edited("0.25", '"'), "mp.csv: "),
    "shorter": (
        shortened("spikes.csv", -len("10,1.66666667,0,0.4,0,0\n")),
        "spikes.csv: its frames are not those of mp.csv",
    ),
    "other times": (
        edited("10,1.66666667", "10,1.8", "attenuation.csv"),
        "attenuation.csv: its frames are not those of mp.csv",
    ),
    "folder": (
        lambda folder: [(folder / "mp.csv").unlink(), (folder / "mp.csv").mkdir()],
        "mp.csv: it cannot be read (Is a directory)",
    ),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=DAMAGES)
def test_damage_is_an_error_of_one_line(tmp_path, damage, message):
    write_tables(tmp_path, [make_result()])
    damage(tmp_path)
    with pytest.raises(ResultError, match=re.escape(message)) as caught:
        read_result(tmp_path)
    assert str(caught.value).startswith(str(tmp_path)) and str(caught.value).endswith("overwrite.")


@given(st.binary(max_size=300))
def test_any_bytes_are_read_or_refused(tmp_path_factory, content):
    folder = tmp_path_factory.mktemp("result")
    write_tables(folder, [make_result()])
    for start in (b"", b",".join(name.encode() for name in TABLES["mp.csv"]) + b"\n0,0,"):
        (folder / "mp.csv").write_bytes(start + content)
        with pytest.raises(ResultError):
            read_result(folder)


def compare_csv(path, *rows):
    path.write_text("\n".join([",".join(COMPARISON_COLUMNS), *rows, ""]), encoding="utf-8")
    return path


def test_a_comparison_has_a_result_per_label(tmp_path):
    path = compare_csv(
        tmp_path / "compare.csv",
        "set9,0,0,,,,",
        "lgmd,0,0,1,0.5,0.25,-3",
        "set9,3,0.1,2,0.75,1,-inf",
        '"a, ""b""",0,0,1,0.5,0.25,-3',
        "lgmd,3,0.1,2,0.75,1,-2",
    )
    results = read_comparison(path)
    assert list(results) == ["set9", "lgmd", 'a, "b"']
    nine = results["set9"]
    assert nine.frame.tolist() == [0, 3] and nine.time_s.tolist() == [0, 0.1]
    assert np.array_equal(nine.mp_abs, [NAN, 0.75], equal_nan=True)
    assert np.array_equal(nine.mp_seq, [NAN, 1], equal_nan=True)
    assert np.array_equal(nine.attenuation_db, [NAN, -INF], equal_nan=True)
    assert np.array_equal(nine.level, nine.mp_abs, equal_nan=True)
    assert not nine.has_spikes and not nine.spike.any() and not nine.collision.any()
    assert all(np.isnan(getattr(nine, name)).all() for name in ("p_sum", "s_sum", "threshold"))
    assert make_result().has_spikes


def test_what_a_comparison_wrote_reads_back(tmp_path):
    written = {"set9": make_result(), 'a,"b" ü': make_result(4), "lgmd": make_result(1)}
    write_comparison(tmp_path / "compare.csv", written)
    results = read_comparison(tmp_path / "compare.csv")
    assert list(results) == list(written)
    for label, result in results.items():
        for column in COMPARISON_COLUMNS[1:]:
            expected = as_written(getattr(written[label], column))
            assert np.array_equal(getattr(result, column), expected, equal_nan=True)


def test_damage_of_a_comparison(tmp_path):
    path = tmp_path / "compare.csv"
    for row, message in (
        ("set9,0,0,1,1,1", "line 3: it has not 7 cells"),
        ("set9,0,0,1,1,1,x", "line 3: 'x' is no number"),
        ("set9,1,0,1,1,1,-3", "does not come after the row before it"),
        ('"set9,2,0,1,1,1,-3', "line 3: it has not 7 cells"),
    ):
        compare_csv(path, "set9,1,0,1,1,1,-3", row)
        with pytest.raises(ResultError, match=re.escape(message)):
            read_comparison(path)
    with pytest.raises(ResultError, match="it holds no frames"):
        read_comparison(compare_csv(path))


def test_a_path_that_no_system_has(tmp_path):
    for read in (comparison_at, read_result, read_comparison):
        with pytest.raises(ResultError):
            read(tmp_path / "a\0b")


def test_which_of_several_results_a_folder_stands_for(tmp_path):
    for path in (tmp_path / "none", tmp_path):
        with pytest.raises(ResultError, match="Give one that 'dlgmd run' wrote"):
            comparison_at(path)
    comparison = compare_csv(tmp_path / "compare.csv", "set9,0,0,1,1,1,-3")
    assert comparison_at(tmp_path) == comparison == comparison_at(comparison)
    write_tables(tmp_path, [make_result()])
    assert comparison_at(tmp_path) is None
    assert comparison_at(comparison) == comparison
