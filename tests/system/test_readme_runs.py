"""The README's commands and its Python run as they are written, in their order."""

import re
import runpy
import shlex
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from dlgmd_cli.commands.app import COMMANDS, cli

pytestmark = pytest.mark.slow
ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def blocks(kind):
    """What stands in the blocks of a kind."""
    return re.findall(rf"```{kind}\n(.*?)```", README, flags=re.DOTALL)


@pytest.fixture(scope="module")
def reader(tmp_path_factory, clips):
    """A folder in which a reader types: the samples, and a flight of their own."""
    folder = tmp_path_factory.mktemp("reader")
    shutil.copytree(ROOT / "sample_videos", folder / "sample_videos")
    shutil.copy(clips / "loom.mp4", folder / "flight.mp4")
    (own,) = [code for code in blocks("python") if "# fast.py" in code]
    (folder / "fast.py").write_text(own, encoding="utf-8")
    (folder / "footage").mkdir()
    for name in ("a.mp4", "b.mp4"):
        shutil.copy(clips / "loom.mp4", folder / "footage" / name)
    labels = "video,collision_frame\na.mp4,19\nb.mp4,19\n"
    (folder / "footage" / "labels.csv").write_text(labels)
    return folder


# Smaller work in place of what takes long; CI runs the first two commands as written.
QUICKER = {
    "reproduce --quick": "reproduce --quick --only fig2,fig5",
    "sigma_e=0.2:2.0:0.1 --y sigma_i=0.5:6:0.25": "sigma_e=1,2 --y sigma_i=2,5 --frames 15",
    "synth group2 --size 480x270 --sheet": "synth group2 --size 64x36 --frames 60 --sheet",
    "batch sample_videos": "batch flight.mp4",
    "live sample_videos/group2.mp4": "live flight.mp4",
    "synth random --count 20": "synth random --count 1 --size 64x36 --frames 30",
    "calibrate flights": "calibrate footage",
    "looming-cube --out looming-cube.html": "looming-cube --no-film --out looming-cube.html",
    "bench --radius 6 --scale 0.25": "bench flight.mp4 --radius 6 --scale 0.25",
}


def test_commands_run_in_order(reader, monkeypatch):
    monkeypatch.chdir(reader)
    monkeypatch.syspath_prepend(reader)
    lines = [line for line in "".join(blocks("sh")).splitlines() if line.startswith("dlgmd ")]
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
        flown = code.replace("VideoCapture(0)", 'VideoCapture("sample_videos/group2.mp4")')
        script.write_text(flown, encoding="utf-8")
        runpy.run_path(str(script))
    first, *brakes = capsys.readouterr().out.splitlines()
    assert float(first.split()[0]) == pytest.approx(127 / 30)
    assert len(brakes) > 10 and all(line.startswith("brake ahead") for line in brakes)
    assert (reader / "overview.pdf").read_bytes().startswith(b"%PDF")
