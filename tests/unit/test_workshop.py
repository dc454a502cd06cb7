"""What a killed process leaves is swept away, and what a living one makes is not."""

import errno
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from dlgmd_cli.errors import OutputError, OutputExistsError
from dlgmd_cli.results import workshop
from dlgmd_cli.results.files import appearing
from dlgmd_cli.results.folder import ResultFolder
from dlgmd_cli.results.workshop import Workshop, sweep_leftovers
from dlgmd_cli.runs.spool import Spool

pytest.importorskip("fcntl", reason="nothing is swept without locks")


def write(folder):
    (folder / "run.yaml").write_text("complete: true\n")


def made(out, text="old"):
    """A result."""
    with ResultFolder(out, "clip", overwrite=True) as folder:
        folder.save(lambda path: (path / "run.yaml").write_text(text))
    return out / "clip" / "run.yaml"


def die(program, *arguments):
    """Run a program that kills itself."""
    done = subprocess.run(
        [sys.executable, "-c", f"import os, signal, sys\nfrom pathlib import Path\n{program}"]
        + [str(argument) for argument in arguments],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
    )
    assert done.returncode == -9, done.stderr


KILL = "os.kill(os.getpid(), signal.SIGKILL)\n"
IN_RESULT = f"""
from dlgmd_cli.results.folder import ResultFolder
with ResultFolder(Path(sys.argv[1]), "clip") as folder:
    {KILL}
"""
IN_FILES = f"""
from dlgmd_cli.results.files import appearing
with appearing(Path(sys.argv[1]) / "a.csv", Path(sys.argv[1]) / "b.png") as files:
    files[1].write_text("half")
    {KILL}
"""
IN_SPOOL = f"""
from dlgmd_cli.runs.spool import Spool
with Spool() as spool:
    {KILL}
"""
# The second renaming is that which puts the new result in its place.
IN_SWAP = f"""
from dlgmd_cli.results.folder import ResultFolder
rename, done = Path.rename, []
def killing(self, target):
    if done:
        {KILL}
    done.append(self)
    return rename(self, target)
Path.rename = killing
out = Path(sys.argv[1])
with ResultFolder(out / sys.argv[2], "clip", overwrite=True, scratch=out) as folder:
    folder.save(lambda path: (path / "run.yaml").write_text("new"))
"""

# The earlier result is removed when the new one stands.
IN_REMOVAL = f"""
import shutil
from dlgmd_cli.results.folder import ResultFolder
def killing(*_, **__):
    {KILL}
shutil.rmtree = killing
with ResultFolder(Path(sys.argv[1]), "clip", overwrite=True) as folder:
    folder.save(lambda path: (path / "run.yaml").write_text("new"))
"""


@pytest.mark.parametrize("program", [IN_RESULT, IN_FILES], ids=["result", "files"])
def test_leftovers_of_the_dead_are_swept(tmp_path, program):
    die(program, tmp_path)
    assert len(os.listdir(tmp_path)) == 1
    with ResultFolder(tmp_path, "other") as folder:
        assert os.listdir(tmp_path) == [folder.partial.name]
    die(program, tmp_path)
    with appearing(tmp_path / "x.csv") as (file,):
        assert os.listdir(tmp_path) == [file.parent.name]
        file.write_text("")
    assert os.listdir(tmp_path) == ["x.csv"]


def test_a_spool_of_the_dead_is_swept(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    die(IN_SPOOL)
    assert len(os.listdir(tmp_path)) == 1
    with Spool() as spool:
        assert os.listdir(tmp_path) == [spool.tape.folder.name]
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("below", [".", "a/b"])
def test_an_earlier_result_comes_back(tmp_path, below):
    record = made(tmp_path / below)
    die(IN_SWAP, tmp_path, below)
    assert not record.exists()
    # Whoever comes next brings it back, and heeds it.
    with (
        pytest.raises(OutputExistsError, match="--overwrite"),
        ResultFolder(tmp_path / below, "clip", scratch=tmp_path),
    ):
        pass
    assert record.read_text() == "old"
    assert [name for name in os.listdir(tmp_path) if name.startswith(".")] == []


def test_an_earlier_result_does_not_replace_the_new_one(tmp_path):
    record = made(tmp_path)
    die(IN_REMOVAL, tmp_path)
    assert len(os.listdir(tmp_path)) == 2
    sweep_leftovers(tmp_path)
    assert os.listdir(tmp_path) == ["clip"] and record.read_text() == "new"


def test_an_earlier_result_stays_when_the_new_one_cannot_be_put(tmp_path, monkeypatch):
    record, rename = made(tmp_path), Path.rename

    def failing(self, target):
        if self.name == "result":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", failing)
    with pytest.raises(OutputError, match="No space"):
        made(tmp_path, "new")
    assert record.read_text() == "old" and os.listdir(tmp_path) == ["clip"]


def test_what_cannot_be_brought_back_is_not_removed(tmp_path, monkeypatch):
    record = made(tmp_path)
    die(IN_SWAP, tmp_path, ".")

    def failing(self, target):
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", failing)
        sweep_leftovers(tmp_path)
    assert not record.exists()
    sweep_leftovers(tmp_path)
    assert record.read_text() == "old" and os.listdir(tmp_path) == ["clip"]


@pytest.mark.parametrize("place", ["../elsewhere", "/elsewhere"])
def test_a_place_outside_is_not_obeyed(tmp_path, place):
    out = tmp_path / "out"
    with Workshop(out, lambda: out.mkdir(exist_ok=True)) as shop:
        name = shop.path.name
    (out / name / "earlier").mkdir(parents=True)
    (out / name / "place").write_text(place.replace("/elsewhere", f"{tmp_path}/elsewhere", 1))
    if place.startswith(".."):
        (out / name / "place").write_text(place)
    sweep_leftovers(out)
    assert os.listdir(tmp_path) == ["out"] and os.listdir(out) == [name]


def test_what_lives_is_not_swept(tmp_path):
    with Workshop(tmp_path) as one, Workshop(tmp_path) as other:
        sweep_leftovers(tmp_path)
        assert sorted(os.listdir(tmp_path)) == sorted([one.path.name, other.path.name])
    assert os.listdir(tmp_path) == []


def test_what_is_another_machine_s_is_not_swept(tmp_path, monkeypatch):
    die(IN_RESULT, tmp_path)
    (name,) = os.listdir(tmp_path)
    with monkeypatch.context() as patch:
        patch.setattr("platform.node", lambda: "elsewhere")
        sweep_leftovers(tmp_path)
    assert os.listdir(tmp_path) == [name]
    (tmp_path / ".dlgmd-notes").mkdir()
    (tmp_path / name.replace(name[-4:], "link")).symlink_to(tmp_path)
    (tmp_path / name.replace(name[-4:], "file")).write_text("")
    sweep_leftovers(tmp_path)
    assert name not in os.listdir(tmp_path) and len(os.listdir(tmp_path)) == 3
    sweep_leftovers(tmp_path / "none")


def test_without_locks_nothing_is_swept(tmp_path, monkeypatch):
    die(IN_RESULT, tmp_path)

    def none(*_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(workshop.fcntl, "flock", none)
    assert made(tmp_path).read_text() == "old" and len(os.listdir(tmp_path)) == 2
    monkeypatch.setattr(workshop, "fcntl", None)
    assert made(tmp_path).read_text() == "old" and len(os.listdir(tmp_path)) == 2


def test_one_who_sweeps_too_early_does_no_harm(tmp_path, monkeypatch):
    flock, n_calls = workshop.fcntl.flock, []

    def swept_before(lock, how):
        n_calls.append(1)
        if len(n_calls) == 1:
            raise BlockingIOError(errno.EAGAIN, "taken")
        if len(n_calls) == 2:
            for path in tmp_path.iterdir():
                path.rmdir()
        return flock(lock, how)

    monkeypatch.setattr(workshop.fcntl, "flock", swept_before)
    with Workshop(tmp_path) as shop:
        assert shop.path.is_dir()
        sweep_leftovers(tmp_path)
        assert shop.path.is_dir()
    assert len(n_calls) == 4


def test_a_folder_that_others_remove_again_is_made_again(tmp_path, monkeypatch):
    out, mkdir, n_removed = tmp_path / "a" / "out", Path.mkdir, []

    def removed_before(self, *arguments, **options):
        if self.name.startswith(".dlgmd-") and len(n_removed) < 3:
            n_removed.append(1)
            out.rmdir()
            (tmp_path / "a").rmdir()
        return mkdir(self, *arguments, **options)

    monkeypatch.setattr(Path, "mkdir", removed_before)
    with ResultFolder(out, "clip") as folder:
        folder.save(write)
    assert len(n_removed) == 3 and os.listdir(out) == ["clip"]


def test_a_folder_removed_in_mid_run_is_not_left_empty(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    with pytest.raises(OutputError), ResultFolder(out, "clip") as folder:
        folder.partial.rmdir()
        out.rmdir()

        def full(path):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        folder.save(full)
    assert os.listdir(tmp_path) == []


def test_what_was_never_finished_does_not_count_as_a_file_of_the_user_s(tmp_path):
    record = made(tmp_path)
    die(IN_FILES, record.parent)
    assert len(os.listdir(record.parent)) == 2
    made(tmp_path, "new")
    assert os.listdir(record.parent) == ["run.yaml"] and record.read_text() == "new"


def test_a_read_only_result_is_refused_at_once(tmp_path, monkeypatch):
    folder = made(tmp_path).parent
    folder.chmod(0o555)
    if os.geteuid() == 0:  # whom nothing is forbidden
        monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK)
    with pytest.raises(OutputError, match=r"cannot be written \(Permission denied\)"):
        ResultFolder(tmp_path, "clip", overwrite=True)
    folder.chmod(0o755)
