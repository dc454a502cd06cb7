"""Whatever is saved into a folder in whichever order, it holds what the last whole writes left."""

import os
import shutil
import tempfile
from functools import lru_cache
from pathlib import Path

import pytest
from conftest import looming_frames, write_video
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

import dlgmd_cli
from dlgmd_cli.errors import DlgmdError, OutputError, OutputExistsError
from dlgmd_cli.machine.files import LOCK, PREFIX
from dlgmd_cli.results import store
from dlgmd_cli.results.files import names_of

TASKS = {
    "run.yaml": lambda video, number: dlgmd_cli.run(video, number),
    "compare.yaml": lambda video, number: dlgmd_cli.compare(video, [number, "lgmd"]),
    "layers.yaml": lambda video, number: dlgmd_cli.layers(video, model=number, frames=[5, 9]),
}
THEIRS = "notes.txt"


@lru_cache
def videos():
    """Two videos of the same name."""
    folder = Path(tempfile.mkdtemp())
    for name, n_frames in (("a", 12), ("b", 14)):
        (folder / name).mkdir()
        write_video(folder / name / "loom.avi", looming_frames(n_frames))
    return folder


@lru_cache
def outcome(record, video, number):
    return TASKS[record](videos() / video / "loom.avi", number)


@lru_cache
def content(record, video, number, formats):
    """The files of an outcome that is saved alone."""
    with tempfile.TemporaryDirectory() as folder:
        outcome(record, video, number).save(folder, formats)
        return {path.name: path.read_bytes() for path in Path(folder).iterdir()}


WHAT = {
    "record": st.sampled_from([*TASKS]),
    "video": st.sampled_from(["a", "b"]),
    "number": st.sampled_from([3, 9]),
    "formats": st.sampled_from([(), (), (), ("svg",)]),
    "overwrite": st.booleans(),
}


class Folder(RuleBasedStateMachine):
    """A folder, and what is in it if every write was whole or did nothing."""

    def __init__(self):
        super().__init__()
        self.folder = Path(tempfile.mkdtemp()) / "out"
        self.files: dict[str, bytes] = {}
        self.owners: dict[str, str] = {}  # record -> video
        self.read: dict[str, bytes] = {}  # the files when they were read last

    def teardown(self):
        shutil.rmtree(self.folder.parent)

    def refusal(self, record, video, overwrite):
        """Why this outcome may not be saved here now; empty if it may."""
        if THEIRS in self.files and not self.owners:
            return "contains other files, such as notes.txt"
        if record in self.owners and not overwrite:
            return "a result already exists here"
        if {*self.owners.values()} - {video} and not overwrite:
            return "it holds the result of another input"
        return ""

    @initialize(is_there=st.booleans())
    def begin(self, is_there):
        if is_there:
            self.folder.mkdir()

    @rule(**WHAT)
    def save(self, record, video, number, formats, overwrite):
        one, why = outcome(record, video, number), self.refusal(record, video, overwrite)
        if why:
            with pytest.raises(OutputExistsError, match=why):
                one.save(self.folder, formats, overwrite=overwrite)
            return
        one.save(self.folder, formats, overwrite=overwrite)
        is_other = bool({*self.owners.values()} - {video})
        for gone in TASKS if is_other else [record]:
            self.owners.pop(gone, None)
            for name in names_of(gone):
                self.files.pop(name, None)
        self.owners[record] = video
        self.files |= content(record, video, number, formats)
        assert not [path for path in self.folder.iterdir() if path.name.startswith(PREFIX)]

    @rule(**WHAT, error=st.sampled_from([OSError(28, "No space left"), RuntimeError("a bug")]))
    def fail_to_save(self, record, video, number, formats, overwrite, error):
        """When all but the record is written."""
        one, write_bytes = outcome(record, video, number), Path.write_bytes

        def fail(path, data):
            write_bytes(path, b"half")
            raise error

        refused = OutputExistsError if self.refusal(record, video, overwrite) else None
        expected = OutputError if isinstance(error, OSError) else RuntimeError
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(Path, "write_bytes", fail)
            with pytest.raises(refused or expected):
                one.save(self.folder, formats, overwrite=overwrite)

    @precondition(lambda self: self.folder.exists())
    @rule(**WHAT)
    def save_while_another_writes(self, record, video, number, formats, overwrite):
        with store.locked(self.folder):
            with pytest.raises(OutputExistsError):
                outcome(record, video, number).save(self.folder, formats, overwrite=overwrite)
            assert (self.folder / LOCK).exists()

    @precondition(lambda self: self.folder.exists())
    @rule()
    def be_killed_while_writing(self):
        """What a process leaves that is killed before anything is renamed."""
        (self.folder / f"{PREFIX}left").mkdir(exist_ok=True)
        (self.folder / f"{PREFIX}left" / "run.yaml").write_text("half")
        (self.folder / f"{PREFIX}mp.csv").write_text("half")

    @precondition(lambda self: self.owners)
    @rule(number=st.integers(0, 2))
    def be_killed_while_renaming(self, number):
        """The record has gone, the tables are still there."""
        record = sorted(self.owners)[number % len(self.owners)]
        (self.folder / record).unlink()
        del self.owners[record], self.files[record]

    @precondition(lambda self: self.folder.exists())
    @rule()
    def put_a_file_of_others(self):
        (self.folder / THEIRS).write_text("mine")
        self.files[THEIRS] = b"mine"

    @invariant()
    def the_folder_is_what_the_whole_writes_left(self):
        found = {}
        if self.folder.exists():
            paths = [path for path in self.folder.iterdir() if not path.name.startswith(PREFIX)]
            found = {path.name: path.read_bytes() for path in paths}
        assert found == self.files

    @invariant()
    def there_is_a_result_if_there_is_its_record(self):
        if self.read == self.files and self.files:
            return
        self.read = dict(self.files)
        for record, read in (
            ("run.yaml", dlgmd_cli.read_result),
            ("compare.yaml", dlgmd_cli.read_comparison),
        ):
            if record in self.owners:
                read(self.folder)
            else:
                with pytest.raises(DlgmdError):
                    read(self.folder)
        known = [path.name for path in store.records_below(self.folder, *TASKS)]
        assert sorted(known) == sorted(self.owners)


TestFolder = Folder.TestCase
TestFolder.settings = settings(max_examples=3, stateful_step_count=12, deadline=None)


def test_a_folder_that_stays_empty_is_removed(tmp_path):
    folder = tmp_path / "deep" / "down"
    with store.locked(folder), pytest.raises(OutputExistsError, match="another dlgmd command is"):
        store.locked(folder).__enter__()
    assert os.listdir(tmp_path) == []  # nothing came of it
    with store.locked(folder):
        (folder / "x").write_text("kept")
    assert os.listdir(folder) == ["x"]
