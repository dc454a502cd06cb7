"""A stranger's folder runs nothing: no file of it starts code, unless the command line says so."""

import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from conftest import looming_frames, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.parameters.presets import MODELS, stored_parameters

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
        more = {"layers": dlgmd_cli.Layers(p, p, p)} if layers else {}
        sums = {} if is_first else {"p_sum": p.sum(), "s_sum": p.sum(), "mp": p.sum()}
        return dlgmd_cli.Response(**sums, **more)
"""
MINE = ("--model", "stranger:M")


def call(folder, *words, first="", **more):
    """The command in a process of its own, in a folder; `first` is what Python does before."""
    # A script: unlike `python -c`, it imports nothing from the working folder.
    with tempfile.TemporaryDirectory() as elsewhere:
        script = Path(elsewhere) / "dlgmd.py"
        start = 'if __name__ == "__main__":\n    main()\n'
        script.write_text(f"{first}\nfrom dlgmd_cli.__main__ import main\n{start}")
        root = str(Path(dlgmd_cli.__file__).parents[1])
        environment = {"PYTHONPATH": root, "DLGMD_SETTINGS": "none", **more}
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
        f"view {RESULT} --out a.html",
        "view cmp/loom --out a.html",
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
        "compare loom.avi --set 9",
        "batch loom.avi",
        "layers loom.avi",
        "evaluate labels.csv",
        "calibrate labels.csv",
        "sweep loom.avi --x n_sp=1,2 --y t_mp=0.3,0.4",
        "live loom.avi",
        "export",
        "sets 9 --plot kernels.png",
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


def test_a_page_has_the_film_of_a_module_that_is_named(within, theirs):
    words = ["view", RESULT, "--out"]
    without, named = within(*words, "a.html"), call(theirs, *words, "b.html", *MINE)
    (theirs / "ran").unlink()  # as it should
    assert "no film: its model stranger:M is Python code" in without.stderr
    assert named.returncode == 0 and not named.stderr
    assert (theirs / "b.html").stat().st_size > 2000 + (theirs / "a.html").stat().st_size


def test_python_names_a_module_too(theirs, monkeypatch):
    monkeypatch.chdir(theirs)
    monkeypatch.syspath_prepend(theirs)
    monkeypatch.delitem(sys.modules, "stranger", raising=False)
    with pytest.raises(ParameterError, match="which no file may start"):
        dlgmd_cli.run("loom.avi", model=RECORD)
    assert not Path("ran").exists()
    import stranger  # from here on, the class is defined, and reading finds it

    named = dlgmd_cli.run("loom.avi", RECORD)
    assert isinstance(named.params, stranger.M.params_class)
    assert dlgmd_cli.read_result(RESULT).params == named.params
    sys.modules.pop("stranger")


def test_a_file_is_no_optional_package(tmp_path, clips, theirs):
    for name in ("numba", "jinja2", "plotly", "av"):
        (tmp_path / f"{name}.py").write_text("open('ran', 'w')")
    not_installed = """
import sys
from importlib.machinery import PathFinder
find = PathFinder.find_spec
def find_spec(name, path=None, target=None):
    if name in ("numba", "jinja2", "plotly", "av"):
        path = [one for one in sys.path if "site-packages" not in one]
    return find(name, path, target)
PathFinder.find_spec = find_spec
"""
    for words in (
        ["run", clips / "loom.avi", "--set", "9", "--engine", "numba"],
        ["run", clips / "loom.avi", "--decoder", "pyav", "--format=none"],
        ["view", theirs / RESULT, "--out", "x.html"],
    ):
        call(tmp_path, *words, first=not_installed)
    assert not (tmp_path / "ran").exists()


def test_a_folder_registers_no_model(tmp_path, clips):
    (tmp_path / "stranger.py").write_text(MODULE)
    package = tmp_path / "stranger-1.0.dist-info"
    package.mkdir()
    (package / "METADATA").write_text("Metadata-Version: 2.1\nName: stranger\nVersion: 1.0\n")
    (package / "entry_points.txt").write_text("[dlgmd.models]\nquick = stranger:M\n")
    for text in ("model: quick", "model: stranger:M"):
        (tmp_path / "my.yaml").write_text(text)
        done = call(tmp_path, "run", clips / "loom.avi", "--config", "my.yaml", "--format=none")
        assert done.returncode == 2 and not (tmp_path / "ran").exists(), done.stderr


@pytest.mark.skipif(sys.version_info < (3, 11), reason="older Pythons look there first")
def test_worker_processes_import_nothing_from_the_folder(tmp_path):
    for name in ("multiprocessing", "socket", "selectors"):
        (tmp_path / f"{name}.py").write_text("open('ran', 'w')")
    for name in "ab":
        write_video(tmp_path / f"{name}.avi", looming_frames())
    done = call(tmp_path, "batch", ".", "--format=none", "--jobs", 2)
    assert done.returncode == 0 and not (tmp_path / "ran").exists(), done.stderr


def test_settings_of_libraries_start_nothing(theirs):
    (theirs / "latex").write_text("#!/bin/sh\necho x > ran\nexit 1\n")
    (theirs / "latex").chmod(0o755)
    (theirs / "matplotlibrc").write_text("text.usetex: True\n")
    (theirs / ".numba_config.yaml").write_text("cache_dir: compiled\n")
    done = call(theirs, "plot", "mp", RESULT, "--out", "a.png", PATH=str(theirs))
    assert done.returncode == 0 and not (theirs / "ran").exists(), done.stderr
    pytest.importorskip("numba", reason="the numba engine needs numba")
    run = ["run", "loom.avi", "--set", 9, "--engine", "numba", "--format=none", "--out", "n"]
    done = call(theirs, *run)
    assert done.returncode == 0 and not (theirs / "compiled").exists(), done.stderr


def test_a_record_cannot_name_the_module_of_its_parameters(tmp_path, monkeypatch):
    (tmp_path / "evil.py").write_text("open('ran', 'w')")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    record = {"model": "evil:M", "t_mp": 0.4, "n_sp": 2, "module": "evil", "model_class": "x"}
    record |= {"specs": 1, "to_dict": 2, "lambda": 3, "__slots__": "a", "floor": 0.5}
    params = stored_parameters(record)
    assert params.to_dict().items() >= {"t_mp": 0.4, "n_sp": 2, "floor": 0.5}.items()
    assert not hasattr(params, "module") or params.module != "evil"
    with pytest.raises(ParameterError, match="evil:M is Python code"):
        create_model(params)
    assert not Path("ran").exists()
    with pytest.raises(ParameterError, match=f"there is no model 'evil'.*{'.*'.join(MODELS)}"):
        stored_parameters({**record, "model": "evil"})
