"""The README keeps its word: its commands, its Python, its links, and the tables of parameters."""

import re
import runpy
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from dlgmd_cli.commands.app import COMMANDS, cli
from dlgmd_cli.parameters import MODELS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = ["README.md", "configs/README.md", "configs/cluster/README.md", "sample_videos/README.md"]


def blocks(kind, text=README):
    return re.findall(rf"```{kind}\n(.*?)```", text, flags=re.DOTALL)


LINES = [line for block in blocks("sh") for line in block.splitlines()]


def test_one_page():
    assert len(README.splitlines()) <= 200


def test_two_commands_do_everything():
    first, second = [line for line in LINES if line.startswith("python3 -m venv")]
    assert first.split(" && ")[-1].startswith(".venv/bin/dlgmd run sample_videos/")
    assert " -m pytest " in second.split(" && ")[-1]


def test_every_command_has_an_example():
    for name in COMMANDS:
        assert any(line.startswith(f"dlgmd {name} ") for line in LINES), name


@pytest.fixture(scope="module")
def reader(tmp_path_factory, clips):
    """A folder in which a reader types: the samples, and a flight of their own."""
    folder = tmp_path_factory.mktemp("reader")
    shutil.copytree(ROOT / "sample_videos", folder / "sample_videos")
    shutil.copy(clips / "loom.mp4", folder / "flight.mp4")
    (folder / "footage").mkdir()
    for name in ("a.mp4", "b.mp4"):
        shutil.copy(clips / "loom.mp4", folder / "footage" / name)
    labels = "video,collision_frame\na.mp4,19\nb.mp4,19\n"
    (folder / "footage" / "labels.csv").write_text(labels)
    return folder


# Smaller work in place of what takes long; CI runs the first two commands as written.
QUICKER = {
    "reproduce --quick": "reproduce --quick --only fig3,fig5",
    "sigma_e=0.2:2.0:0.1 --y sigma_i=0.5:6:0.25": "sigma_e=1,2 --y sigma_i=2,5 --frames 15",
    "synth group2 --size 480x270 --sheet": "synth group2 --size 64x36 --frames 60 --sheet",
    "batch sample_videos": "batch flight.mp4",
    "synth random --count 20": "synth random --count 1 --size 64x36 --frames 30",
    "calibrate flights": "calibrate footage",
    "looming-cube --out looming-cube.html": "looming-cube --no-film --out looming-cube.html",
    "bench --radius 6 --scale 0.25": "bench flight.mp4 --radius 6 --scale 0.25",
}


def test_commands_run_in_order(reader, monkeypatch):
    monkeypatch.chdir(reader)
    lines = [line for line in LINES if line.startswith("dlgmd ")]
    assert len(lines) >= len(COMMANDS)
    for line in lines:
        for slow, quick in QUICKER.items():
            line = line.replace(slow, quick)
        command, _, target = line.partition(" > ")
        result = CliRunner().invoke(cli, shlex.split(command)[1:], prog_name="dlgmd")
        assert result.exit_code == 0, f"{line}\n{result.output}"
        if target:
            Path(target).write_text(result.stdout, encoding="utf-8")


def test_python_runs_as_written(reader, monkeypatch, capsys):
    monkeypatch.chdir(reader)
    for number, code in enumerate(blocks("python")):
        script = reader / f"readme{number}.py"
        script.write_text(code, encoding="utf-8")
        runpy.run_path(str(script))
    first, second = capsys.readouterr().out.splitlines()
    assert float(first.split()[0]) == pytest.approx(127 / 30)
    assert second.split()[0] == "brake" and float(second.split()[1]) == pytest.approx(127 / 30)
    assert (reader / "overview.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize("name", list(MODELS))
def test_tables_of_parameters(name):
    page = (ROOT / "configs/README.md").read_text(encoding="utf-8")
    heading = {
        "dlgmd": "D-LGMD",
        "dlgmd-contrast": "Contrast-relative D-LGMD",
        "dlgmd-onoff": "ON/OFF D-LGMD",
        "lgmd": "LGMD",
        "emd-lgmd": "EMD-LGMD",
    }[name]
    (section,) = re.findall(rf"^## {heading}\n(.*?)(?=^## |\Z)", page, re.DOTALL | re.MULTILINE)
    rows = dict(re.findall(r"^\| `(\w+)` \|(.*)\|$", section, flags=re.MULTILINE))
    kind = MODELS[name].parameters
    specs, defaults = kind.specs(), kind.defaults()
    assert list(rows) == list(specs)
    for key, row in rows.items():
        symbol, unit, default, allowed, meaning = (part.strip() for part in row.split("|"))
        spec, shown = specs[key], defaults[key]
        assert (symbol, unit) == (spec.symbol, spec.unit)
        assert (allowed, meaning) == (spec.allowed, spec.meaning)
        if isinstance(shown, bool):
            shown = str(shown).lower()
        assert default == (shown if isinstance(shown, str) else f"{shown:.9g}")


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    text = (ROOT / page).read_text(encoding="utf-8")
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", text):
        assert (ROOT / page).parent.joinpath(target).exists(), target


def test_scripts_for_elsewhere_are_python():
    script = ROOT / "configs/cluster/slurm.py"
    compile(script.read_text(encoding="utf-8"), str(script), "exec")
