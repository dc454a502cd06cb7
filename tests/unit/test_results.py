"""Tables, summary, and folders that appear whole or not at all."""

import csv
import os
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results.cells import cell
from dlgmd_cli.results.files import appearing, refuse_existing
from dlgmd_cli.results.folder import COMPARISON, RUN, ResultFolder
from dlgmd_cli.results.measures import summarise
from dlgmd_cli.results.tables import TABLES, Result, write_tables

NAN, INF = np.nan, np.inf


def make_result(n=6):
    mp = np.array([NAN, NAN, 1.0, 5.0, 4.0, 0.0])[:n]
    flags = np.array([0, 0, 0, 1, 1, 0], bool)[:n]
    return Result(
        frame=np.arange(n) * 2,
        time_s=np.arange(n) / 3,
        p_sum=np.array([NAN, 0.0, 2.0, 3.0, 1.0, 0.0])[:n],
        s_sum=np.array([NAN, NAN, 1.0, 0.3, 0.0, 0.0])[:n],
        attenuation_db=np.array([NAN, NAN, -3.0, -10.0, -INF, NAN])[:n],
        mp=mp,
        mp_abs=mp / 10,
        mp_seq=mp / 5,
        level=mp / 10,
        threshold=np.full(n, 0.4),
        spike=flags,
        collision=np.array([0, 0, 0, 0, 1, 0], bool)[:n],
    )


@given(st.floats(width=32, allow_nan=False))
def test_cells_read_back_exactly_as_float32(value):
    assert np.float32(cell(value)) == np.float32(value)


def test_cells_of_what_is_not_a_number():
    assert [cell(NAN), cell(-INF), cell(True), cell(7)] == ["", "-inf", "1", "7"]


def test_tables(tmp_path):
    write_tables(tmp_path, [make_result()])
    assert sorted(os.listdir(tmp_path)) == sorted(TABLES)
    rows = list(csv.reader((tmp_path / "attenuation.csv").read_text().splitlines()))
    assert rows[0] == ["frame", "time_s", "p_sum", "s_sum", "attenuation_db"]
    assert rows[1] == ["0", "0", "", "", ""]
    assert rows[5] == ["8", "1.33333333", "1", "0", "-inf"]
    spikes = (tmp_path / "spikes.csv").read_bytes().splitlines()
    assert spikes[0] == b"frame,time_s,level,threshold,spike,collision"
    assert spikes[1] == b"0,0,,0.4,0,0"
    assert spikes[4] == b"6,1,0.5,0.4,1,0"


def test_summary():
    assert summarise(make_result()) == {
        "mp_max": 5.0,
        "mp_max_frame": 6,
        "mp_max_time_s": 1.0,
        "spikes": 2,
        "first_spike_time_s": 1.0,
        "collisions": 1,
        "first_collision_frame": 8,
        "first_collision_time_s": pytest.approx(4 / 3),
        "mean_attenuation_db": -6.5,
    }


def test_summary_counts_alarms_not_their_frames():
    result = replace(make_result(), collision=np.array([1, 1, 0, 1, 1, 1], bool))
    assert summarise(result)["collisions"] == 2
    assert summarise(result)["first_collision_frame"] == 0


def test_summary_of_nothing_valid():
    summary = summarise(make_result(2))
    assert summary["mp_max"] is None and summary["mean_attenuation_db"] is None
    assert summary["spikes"] == summary["collisions"] == 0


def fill(folder):
    write_tables(folder, [make_result()])
    (folder / "run.yaml").write_text("complete: true\n")


def hidden(folder):
    return [name for name in os.listdir(folder) if name.startswith(".")]


def test_folder_appears_at_the_end(tmp_path):
    with ResultFolder(tmp_path / "a" / "b", "clip") as folder:
        assert not folder.target.exists()
        folder.save(fill)
    assert set(os.listdir(tmp_path / "a/b/clip")) == {"run.yaml", *TABLES}
    assert hidden(tmp_path / "a/b") == []


def test_folder_leaves_nothing_behind_on_failure(tmp_path):
    with pytest.raises(ZeroDivisionError), ResultFolder(tmp_path / "a" / "b", "clip"):
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == []


def test_folder_of_others_is_kept_on_failure(tmp_path):
    (tmp_path / "a").mkdir()
    with pytest.raises(ZeroDivisionError), ResultFolder(tmp_path / "a", "clip"):
        raise ZeroDivisionError
    assert os.listdir(tmp_path) == ["a"] and os.listdir(tmp_path / "a") == []


def test_write_error_is_an_output_error_and_keeps_the_earlier_result(tmp_path):
    with ResultFolder(tmp_path, "clip") as folder:
        folder.save(fill)

    def fail(folder):
        fill(folder)
        raise OSError(28, "No space left on device")

    with (
        pytest.raises(OutputError, match=r"No space left on device"),
        ResultFolder(tmp_path, "clip", overwrite=True) as folder,
    ):
        folder.save(fail)
    assert len(os.listdir(tmp_path / "clip")) == len(TABLES) + 1 and hidden(tmp_path) == []


def test_folder_swept_away_in_mid_run_comes_back(tmp_path):
    with ResultFolder(tmp_path / "out", "clip") as folder:
        folder.partial.rmdir()
        (tmp_path / "out").rmdir()
        folder.save(fill)
    assert (tmp_path / "out/clip/run.yaml").exists()


def test_existing_results(tmp_path):
    with ResultFolder(tmp_path, "clip") as folder:
        folder.save(fill)
    with pytest.raises(OutputExistsError, match="--overwrite"):
        ResultFolder(tmp_path, "clip")
    (tmp_path / "clip" / "mp.csv").write_text("old")
    with ResultFolder(tmp_path, "clip", overwrite=True) as folder:
        folder.save(fill)
    assert (tmp_path / "clip" / "mp.csv").read_text() != "old"
    assert hidden(tmp_path) == []


def compared(folder):
    (folder / "compare.csv").write_text("label\n")
    (folder / "compare.yaml").write_text("complete: true\n")


def test_results_of_several_commands_share_a_folder(tmp_path, monkeypatch):
    for kind, write in ((RUN, fill), (COMPARISON, compared)):
        with ResultFolder(tmp_path, "clip", kind) as folder:
            folder.save(write)
        with pytest.raises(OutputExistsError, match="a result stands here already"):
            ResultFolder(tmp_path, "clip", kind)
    everything = {"run.yaml", *TABLES, "compare.csv", "compare.yaml"}
    assert set(os.listdir(tmp_path / "clip")) == everything

    def no_link(*_, **__):
        raise PermissionError(1, "Operation not permitted")

    (tmp_path / "clip" / "mp.png").write_text("a plot that the new result does not have")
    monkeypatch.setattr(os, "link", no_link)
    with ResultFolder(tmp_path, "clip", RUN, overwrite=True) as folder:
        folder.save(fill)
    assert set(os.listdir(tmp_path / "clip")) == everything
    assert (tmp_path / "clip" / "compare.csv").read_text() == "label\n"
    assert hidden(tmp_path) == []


def test_files_without_their_record_are_no_result(tmp_path):
    with ResultFolder(tmp_path, "clip") as folder:
        folder.save(fill)
    (tmp_path / "clip" / "compare.csv").write_text("precious")
    with pytest.raises(OutputExistsError, match=r"holds other files, such as compare\.csv"):
        ResultFolder(tmp_path, "clip", COMPARISON, overwrite=True)


def test_what_is_no_result_is_never_replaced(tmp_path):
    frames = tmp_path / "frames"
    frames.mkdir()
    (frames / "0001.png").write_text("precious")
    with pytest.raises(OutputExistsError, match=r"holds other files, such as 0001\.png"):
        ResultFolder(tmp_path, "frames", overwrite=True)
    with ResultFolder(tmp_path, "clip") as folder:
        folder.save(fill)
    (tmp_path / "clip" / "notes.txt").write_text("precious")
    with ResultFolder(tmp_path, "clip", overwrite=True) as folder:
        folder.save(fill)
    assert (tmp_path / "clip" / "notes.txt").read_text() == "precious"
    (tmp_path / "clip" / "more").mkdir()
    with pytest.raises(OutputExistsError, match="other files, such as more"):
        ResultFolder(tmp_path, "clip", overwrite=True)
    (tmp_path / "link").symlink_to(frames)
    with pytest.raises(OutputExistsError):
        ResultFolder(tmp_path, "link", overwrite=True)


def test_a_result_that_appears_meanwhile_is_kept(tmp_path):
    with ResultFolder(tmp_path, "clip") as slow:
        with ResultFolder(tmp_path, "clip") as fast:
            fast.save(fill)
        with pytest.raises(OutputExistsError):
            slow.save(fill)
    assert (tmp_path / "clip/run.yaml").exists() and hidden(tmp_path) == []


def test_out_that_is_a_file(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError), ResultFolder(tmp_path / "out", "clip"):
        pass


def test_files_appear_together_or_not_at_all(tmp_path):
    paths = tmp_path / "x.csv", tmp_path / "x.png"
    with pytest.raises(OutputError), appearing(*paths) as (first, _):
        first.write_text("half")
        raise OSError(28, "No space left on device")
    assert os.listdir(tmp_path) == []
    with appearing(*paths) as files:
        for file in files:
            file.write_text("whole")
    assert sorted(os.listdir(tmp_path)) == ["x.csv", "x.png"]
    with pytest.raises(OutputExistsError):
        refuse_existing(paths[0], overwrite=False)
    refuse_existing(paths[0], overwrite=True)
