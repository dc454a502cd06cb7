"""The frame that commands share."""

import pytest

from dlgmd_cli.commands.frame import job
from dlgmd_cli.commands.options import Output
from dlgmd_cli.errors import OutputExistsError
from dlgmd_cli.results import store
from dlgmd_cli.runs.setup import choose
from dlgmd_cli.video.options import InputOptions


def test_a_result_in_a_locked_folder(clips, tmp_path):
    output = Output(tmp_path, (), 200, overwrite=False)
    arguments = [str(clips / "loom.avi"), [choose()], InputOptions(), output, store.RUN]
    with job(*arguments) as one:
        assert one.folder == tmp_path / "loom" and store.is_locked(one.folder)
        one.commit({store.RUN: lambda path: path.write_text("{}")})
    assert [path.name for path in one.folder.iterdir()] == [store.RUN]
    with pytest.raises(OutputExistsError, match="already exists"), job(*arguments):
        pass
