"""The one reader of tables: what other programs write, and what is refused."""

import numpy as np
import pytest

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.machine import tables
from dlgmd_cli.machine.tables import clock, number, read_table


def read(tmp_path, text, encoding="utf-8"):
    (tmp_path / "x.csv").write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
    return read_table(tmp_path / "x.csv", ParameterError)


@pytest.mark.parametrize(
    ("text", "encoding"),
    [
        ("frame,höhe\n0,0.5\n10,-1\n", "utf-8"),
        ("frame;höhe\r\n0;0,5\r\n10;-1\r\n", "utf-8-sig"),
        ("frame\thöhe\n0\t0,5\n10\t-1,0\n", "utf-16"),
        ("frame|höhe\n0|0.5\n10|-1\n", "utf-8"),
        ("sep=;\nframe;höhe;;\n0;0,5;;\n10;-1;;\n;;;\n;;;\n", "utf-16"),
        ('"sep=,"\r"frame","höhe"\r"0","0,5"\r"10","-1"\r', "cp1252"),
        ("# one\n\n# frame, two\nframe, höhe\n-,[m]\n0, 0.5\n# a break\n10, −1\n\n\n", "utf-8"),
        ("# by a camera\n#frame,höhe\n0,0.5\n10,-1\n", "utf-8"),
        ("% frame;höhe\n0;0,5\n10;-1,0\n", "cp1252"),
        ("Frame;Höhe\n;m\n0;0,5\n10;-1\n", "utf-8"),
        ("Frame,Höhe,x\nnr,m,text\n0,0.5,a\n10,-1,b\n", "utf-8"),
    ],
)
def test_the_tables_of_other_programs(tmp_path, text, encoding):
    table = read(tmp_path, text, encoding)
    assert [name.lower() for name in table.names[:2]] == ["frame", "höhe"]
    assert table.numbers("frame").tolist() == [0.0, 10.0]
    assert table.numbers(table.names[1]).tolist() == [0.5, -1.0]


@pytest.mark.parametrize(
    ("name", "wanted"),
    [
        ("Collision Frame", "collision_frame"),
        ("speed [m/s]", "speed_m_s"),
        ("distance (m)", "distance_m"),
        ("rightDeg", "right_deg"),
    ],
)
def test_columns_are_found_by_their_plain_names(tmp_path, name, wanted):
    assert read(tmp_path, f"a;{name}\n1;2\n").numbers(wanted).tolist() == [2.0]


NUMBERS = {
    "12.5": 12.5,
    "0,040": 0.04,
    "1.234,5": None,
    "1,234,567": None,
    "1 234,5": 1234.5,
    "1\u202f234": 1234,
    "1e-3": 0.001,
    "1,2,3": None,
    "12a": None,
    "inf": None,
}
CLOCKS = {
    "01:02:03.5": 3723.5,
    "02:03,25": 123.25,
    "1 day, 0:00:01": 86401,
    "1970-01-02T00:00:00.000Z": 86400.0,
    "1970/01/01 02:00:00+02:00": 0,
    "1970-01-01 00:30": None,
    "00:00:01:12": None,
    "1970-13-01 00:00:00": None,
    "00:00:75": None,
    "12.5": None,
}


@pytest.mark.parametrize(("read", "cells"), [(number, NUMBERS), (clock, CLOCKS)])
def test_numbers_of_other_languages_and_times_of_day(read, cells):
    assert {cell: read(cell) for cell in cells} == cells


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("a,b\n1,2\n3,x\n", "line 3, column b: 'x' is no number. Write 12.5."),
        ("a,b\n1,0,5\n", "line 2 has 3 cells, the first line 2. Write a cell"),
        ('a,b\n1,"1,234"\n', "line 2, column b: '1,234' may be a thousand times 1.234."),
        ("b\tb\n1\t2\n", "has the column b twice"),
        ('a,b\n1,"2\n3,4\n', "the row in line 2 cannot be read"),
        (b"PK\x03\x04\0\0", "(not a CSV file). Save it as CSV"),
        ("a,b\n1,2\n" + "\n" * 999, "is larger than 0 MiB. Split it"),
    ],
)
def test_what_is_refused_names_line_and_column(tmp_path, monkeypatch, text, why):
    monkeypatch.setattr(tables, "MAX_BYTES", 999)
    with pytest.raises(ParameterError) as caught:
        read(tmp_path, text).numbers("b")
    assert why in str(caught.value)


def test_a_comma_is_one_mark_in_a_column(tmp_path):
    """With a cell that only a decimal comma explains, the others have one, too."""
    table = read(tmp_path, 'a,b\n0,"0,966"\n1,"1,000"\n2,\n')
    np.testing.assert_array_equal(table.numbers("b"), [0.966, 1.0, np.nan])


def test_a_video_may_begin_with_a_comment_mark(tmp_path):
    table = read(tmp_path, "video,collision_frame\n#1.mp4,3\n# out: b.mp4,4\nm,\n")
    assert table.texts("video") == ["#1.mp4", "m"] and table.lines == [2, 4]
