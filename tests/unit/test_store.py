"""One write: what stands is kept until all that is new is complete, whatever goes wrong."""

import os
import shutil
from pathlib import Path

import pytest
from conftest import files_of, make_result

from dlgmd_cli import read_result
from dlgmd_cli.errors import OutputError, ResultError
from dlgmd_cli.machine.files import LOCK, PREFIX, open_regular
from dlgmd_cli.parameters.facts import SCHEMA
from dlgmd_cli.results import store
from dlgmd_cli.results.files import names_of
from dlgmd_cli.results.labels import read_labels
from dlgmd_cli.results.record import differences, read_record, yaml_text

POSIX = pytest.mark.skipif(os.name == "nt", reason="no such files or locks there")


@POSIX
def test_links_that_wait_under_a_name_are_not_followed(tmp_path):
    victim, folder = tmp_path / "victim", tmp_path / "r"
    victim.write_text("mine")
    folder.mkdir()
    for name in (LOCK, f"{PREFIX}mp.csv", "mp.csv", "spikes.csv", "run.yaml"):
        (folder / name).symlink_to("../victim")
    make_result([1.0, 2.0]).save(folder, overwrite=True)
    assert victim.read_text() == "mine" and read_result(folder).n_valid == 2
    assert not any(path.is_symlink() for path in folder.iterdir())


def test_a_folder_in_the_way_is_an_error_before_anything_changes(tmp_path):
    make_result([1.0, 2.0]).save(tmp_path)
    (tmp_path / "spikes.csv").unlink()
    (tmp_path / "spikes.csv").mkdir()
    before = files_of(tmp_path)
    with pytest.raises(OutputError, match=r"spikes\.csv is a folder"):
        make_result([3.0]).save(tmp_path, overwrite=True)
    assert files_of(tmp_path) == before and not [*tmp_path.glob(f"{PREFIX}*")]


def test_where_there_are_only_figures_one_that_fails_is_an_error(dlgmd, tmp_path):
    make_result([1.0, 2.0]).save(tmp_path / "r")
    (tmp_path / "x.png").write_text("old")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dlgmd_cli.plots.style.save_figure", lambda *_, **__: 1 / 0)
        result = dlgmd("plot", "mp", "r", "--out", "x.png", "--overwrite")
    assert result.exit_code == 1 and (tmp_path / "x.png").read_text() == "old"


# One at a time


def test_commands_lock_their_folder(dlgmd, tmp_path):
    with store.locked(tmp_path / "o"):
        result = dlgmd("export", "--out", "o")
        assert os.listdir(tmp_path / "o") == [LOCK]
    assert result.exit_code == 2, result.output
    assert "another dlgmd command is writing here" in result.stderr


# Records


def test_what_differs_is_named():
    record = {"schema": SCHEMA, "input": {"path": "a", "bytes": 3}, "r": 4}
    record["options"] = {"size": "2x2", "crop": "c"}
    assert differences(record, identity={"path": "a"}, settings={"r": 4}) == []
    assert differences(record, identity={"path": "a", "bytes": 4}) == ["input"]
    assert differences(record, settings={"r": 5, "k": 1}) == ["r", "k"]
    options = {"size": "2x2", "mask_sha256": "x", "input_fps": 3}
    assert differences(record, options=options) == ["mask", "input_fps", "crop"]
    assert differences({}, identity={"path": "a"}) == ["input"]
    assert differences({**record, "schema": SCHEMA - 1}, settings={"r": 4}) == ["schema"]


def test_records_never_refer(tmp_path):
    shared = {"a": [1, 2]}
    (tmp_path / "x.yaml").write_text(yaml_text({"one": shared, "two": shared}))
    assert read_record(tmp_path / "x.yaml") == {"one": shared, "two": shared}


@POSIX
@pytest.mark.parametrize("name", ["run.yaml", "mp.csv", "attenuation.csv"])
def test_pipes_are_not_waited_for(tmp_path, name):
    make_result([1.0, 2.0]).save(tmp_path)
    (tmp_path / name).unlink()
    os.mkfifo(tmp_path / name)
    with pytest.raises(ResultError):
        read_result(tmp_path)
    for read in (read_labels, lambda path: open_regular(path).close()):
        with pytest.raises((ResultError, OSError), match="not a regular file"):
            read(tmp_path / name)


def test_the_record_goes_first_and_comes_last(tmp_path, monkeypatch):
    make_result([0, 1, 2]).save(tmp_path)
    arrived, replace = [], Path.replace

    def watched(self, target):
        arrived.append((Path(target).name, (tmp_path / store.RUN).exists()))
        return replace(self, target)

    monkeypatch.setattr(Path, "replace", watched)
    make_result([0, 1, 3]).save(tmp_path, overwrite=True)
    assert arrived[-1] == (store.RUN, False) and {name for name, _ in arrived} == names_of(
        store.RUN, ()
    )
    assert not any(has_record for _, has_record in arrived)


def test_what_a_killed_process_left_is_no_result(tmp_path):
    make_result([1.0, 2.0]).save(tmp_path / "a", [])
    shutil.copytree(tmp_path / "a", tmp_path / "a" / f"{PREFIX}left")
    assert store.with_results([tmp_path]) == [tmp_path / "a"]
    assert store.records_below(tmp_path, store.RUN) == [tmp_path / "a" / store.RUN]
