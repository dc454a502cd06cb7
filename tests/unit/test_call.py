"""What every function of a command does with its folder: check, lock, write."""

import pytest

from dlgmd_cli import compare, layers, run
from dlgmd_cli.errors import OutputExistsError
from dlgmd_cli.machine.files import LOCK, is_locked
from dlgmd_cli.results import store
from dlgmd_cli.tasks.call import Request, choose, opened
from dlgmd_cli.video.options import InputOptions

TASKS = {"run": run, "compare": compare, "layers": layers}


def test_a_result_in_a_locked_folder(clips, tmp_path):
    asked = Request((choose(),), InputOptions())
    arguments = str(clips / "loom.avi"), asked, store.RUN, tmp_path
    with opened(*arguments, overwrite=False) as (_, claim):
        assert claim.folder == tmp_path / "loom" and is_locked(claim.folder)
        claim.write({store.RUN: lambda path: path.write_text("{}")})
    assert [path.name for path in claim.folder.iterdir()] == [store.RUN]
    with pytest.raises(OutputExistsError, match="already exists"):
        opened(*arguments, overwrite=False).__enter__()


@pytest.mark.parametrize("task", TASKS)
def test_save_refuses_what_the_command_refuses(clips, tmp_path, task):
    given = [3] if task == "layers" else ()
    found = TASKS[task](clips / "loom.avi", *([given] if given else []), size="32x24")
    (tmp_path / "foreign").mkdir()
    (tmp_path / "foreign" / "notes.txt").write_text("mine")
    with pytest.raises(OutputExistsError, match="contains other files, such as notes"):
        found.save(tmp_path / "foreign")
    with store.locked(tmp_path / "locked"):
        with pytest.raises(OutputExistsError, match="another dlgmd command is writing here"):
            found.save(tmp_path / "locked")
        assert [path.name for path in (tmp_path / "locked").iterdir()] == [LOCK]
    found.save(tmp_path / "new")
    before = sorted((path.name, path.stat().st_mtime_ns) for path in (tmp_path / "new").iterdir())
    with pytest.raises(OutputExistsError, match="Add overwrite=True to replace it"):
        found.save(tmp_path / "new")
    assert before == sorted((p.name, p.stat().st_mtime_ns) for p in (tmp_path / "new").iterdir())
    found.save(tmp_path / "new", overwrite=True)
