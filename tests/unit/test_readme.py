"""The README keeps its word: its table, its Python, its commands."""

import math
import re
import runpy
import shlex
import shutil
from importlib import import_module
from pathlib import Path

import pytest

from dlgmd_cli.app import COMMANDS
from dlgmd_cli.parameters import DlgmdParameters, EmdLgmdParameters, LgmdParameters

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMAND_LINES = [
    line
    for block in re.findall(r"```sh\n(.*?)```", README, flags=re.DOTALL)
    for line in block.splitlines()
]


def test_two_commands_do_everything():
    first, second = [line for line in COMMAND_LINES if line.startswith("python3 -m venv")]
    assert first.split(" && ")[-1].startswith(".venv/bin/dlgmd run sample_videos/")
    assert " -m pytest " in second


def test_every_command_has_an_example():
    for name in COMMANDS:
        assert any(line.startswith(f"dlgmd {name} ") for line in COMMAND_LINES), name


def test_commands_run_as_written(dlgmd, clips):
    """In their order and in one folder, as by a reader: a line may use what others made."""
    shutil.copytree(ROOT / "sample_videos", "sample_videos")
    Path("flight.mp4").write_bytes((clips / "loom.mp4").read_bytes())
    lines = [line for line in COMMAND_LINES if line.startswith("dlgmd ")]
    assert len(lines) >= len(COMMANDS)
    for line in lines:
        command, _, target = line.partition(" > ")
        result = dlgmd(*shlex.split(command)[1:])
        assert result.exit_code == 0, f"{line}\n{result.output}"
        if target:
            Path(target).write_text(result.stdout, encoding="utf-8")


@pytest.mark.parametrize(
    ("heading", "kind"),
    [("D-LGMD", DlgmdParameters), ("LGMD", LgmdParameters), ("EMD-LGMD", EmdLgmdParameters)],
)
def test_table_of_parameters(heading, kind):
    (section,) = re.findall(rf"^### {heading}\n(.*?)^##", README, flags=re.DOTALL | re.MULTILINE)
    rows = dict(re.findall(r"^\| `(\w+)` \|(.*)\|$", section, flags=re.MULTILINE))
    specs, defaults = kind.specs(), kind.defaults()
    assert list(rows) == list(specs)
    for key, row in rows.items():
        symbol, unit, default, allowed, meaning = (part.strip() for part in row.split("|"))
        spec = specs[key]
        assert (symbol, unit, allowed, meaning) == (
            spec.symbol,
            spec.unit,
            spec.allowed,
            spec.meaning,
        )
        shown = defaults[key]
        if isinstance(shown, bool):
            shown = str(shown).lower()
        assert default == (shown if isinstance(shown, str) else f"{shown:g}")


def test_python_runs_as_written(dlgmd, tmp_path, capsys):
    shutil.copytree(ROOT / "sample_videos", "sample_videos")
    assert dlgmd("run", "sample_videos/looming-ball.mp4", "--no-plots").exit_code == 0
    for number, code in enumerate(re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)):
        script = tmp_path / f"readme{number}.py"
        script.write_text(code, encoding="utf-8")
        runpy.run_path(str(script))
    printed = capsys.readouterr().out.splitlines()
    flight, ball = printed[:45], printed[45:]
    assert flight[0].split()[0] == "hover" and flight[-1].split()[0] == "pitch"
    assert len(ball) == 75
    potential = [float(line.split()[1]) for line in ball]
    assert math.isnan(potential[2]) and max(potential[3:30]) < 1.0 < max(potential[60:])
    assert Path("attenuation.pdf").read_bytes().startswith(b"%PDF")


def test_scripts_for_elsewhere_are_python():
    scripts = re.findall(r"```py\n(.*?)```", README, flags=re.DOTALL)
    assert len(scripts) == 1
    compile(scripts[0], "README.md", "exec")


def test_figures_are_where_the_readme_says():
    places = re.findall(r"`(\w+)\.((?:plot|overlay)_\w+)`", README)
    assert len(places) >= 10
    for module, function in places:
        assert callable(getattr(import_module(f"dlgmd_cli.plots.{module}"), function))


def test_links_lead_somewhere():
    for target in re.findall(r"\]\((?!http)([^)#]+)\)", README):
        assert (ROOT / target).exists(), target
