"""A stranger's folder runs nothing: no file of it starts code, unless the command line says so."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from conftest import looming_frames, write_video, yaml_of

import dlgmd_cli

pytestmark = pytest.mark.slow

MODULE = """
import dlgmd_cli
with open("ran", "a") as file:
    file.write("x")

class M(dlgmd_cli.Model):
    def step(self, luminance, time_s=None, *, layers=False):
        self.receptors.take(luminance)
        is_first = self.receptors.frame < 1
        p = luminance * 0.0 if is_first else self.receptors.p(0) * self.receptors.unit
        sums = {} if is_first else {"p_sum": p.sum(), "s_sum": p.sum(), "mp": p.sum()}
        return dlgmd_cli.Response(**sums)
"""
MINE = ("--model", "stranger:M")


def call(folder, *words):
    """The command in a process of its own, in a folder."""
    # A script: unlike `python -c`, it imports nothing from the working folder.
    with tempfile.TemporaryDirectory() as elsewhere:
        script = Path(elsewhere) / "dlgmd.py"
        start = 'if __name__ == "__main__":\n    main()\n'
        script.write_text(f"from dlgmd_cli.__main__ import main\n{start}")
        environment = {"PYTHONPATH": str(Path(dlgmd_cli.__file__).parents[1])}
        command = [sys.executable, str(script), *map(str, words)]
        return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A folder with a module, a result of its model, a comparison, and labels."""
    folder = tmp_path_factory.mktemp("stranger")
    (folder / "stranger.py").write_text(MODULE)
    write_video(folder / "loom.avi", looming_frames())
    (folder / "labels.csv").write_text("video,collision_frame\nloom.avi,19\n")
    for words in (("run", "loom.avi"), ("compare", "loom.avi", "--set", 9, "--out", "cmp")):
        assert call(folder, *words, *MINE, "--format=none").returncode == 0
    (folder / "ran").unlink()
    return folder


@pytest.fixture
def theirs(made, tmp_path):
    """A copy of that folder."""
    return Path(shutil.copytree(made, tmp_path / "theirs"))


@pytest.fixture
def within(dlgmd, theirs, monkeypatch):
    """Call the command in that folder, from which Python would import the module."""
    monkeypatch.chdir(theirs)
    monkeypatch.syspath_prepend(theirs)
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    yield dlgmd
    assert "stranger" not in sys.modules and not Path("ran").exists()


RESULT, RECORD = "dlgmd-out/loom", "dlgmd-out/loom/run.yaml"


@pytest.mark.parametrize(
    "words",
    [
        f"plot overview {RESULT} --out a.png",
        "plot mp cmp/loom --out a.png",
        f"view {RESULT} --no-film --out a.html",
        "evaluate labels.csv --results dlgmd-out --no-baselines --format=none --out e",
    ],
)
def test_reading_imports_no_model(within, words):
    Path("dlgmd-out/summary.csv").touch()
    done = within(*words.split())
    assert done.exit_code == 0, done.output


@pytest.mark.parametrize(
    "command",
    [
        "run loom.avi",
        "batch loom.avi",
        "evaluate labels.csv",
        "live loom.avi",
    ],
)
def test_a_file_names_no_module_to_import(within, command):
    done = within(*command.split(), "--config", RECORD)
    line = f"Error: {RECORD}: its model stranger:M is Python code, which no file may start."
    assert done.exit_code == 2 and done.stderr.splitlines()[-1] == (
        f"{line} If you trust that module, add --model stranger:M."
    )


def test_whoever_names_the_module_repeats_the_run(theirs):
    for words in (
        ["run", "loom.avi", "--out", "again"],
        ["batch", "loom.avi", "--out", "again", "--overwrite"],
        ["compare", "loom.avi", "--set", 9, "--out", "both"],
    ):
        done = call(theirs, *words, "--config", RECORD, *MINE, "--format=none")
        assert done.returncode == 0, done.stderr
    record = yaml_of(theirs / "again/loom/run.yaml")
    assert record["model"] == "stranger:M" and (theirs / "ran").read_text()
    again, first = (theirs / name / "mp.csv" for name in ("again/loom", RESULT))
    assert again.read_bytes() == first.read_bytes()
    labels = [one["label"] for one in yaml_of(theirs / "both/loom/compare.yaml")["models"]]
    assert labels == ["set9", "run"]
