"""The README keeps its word: its commands, its Python, its links, and the tables of parameters."""

import re
from pathlib import Path

import pytest
import yaml

from dlgmd_cli import __version__
from dlgmd_cli.commands.app import COMMANDS
from dlgmd_cli.parameters import MODELS

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = ["README.md", "configs/README.md", "configs/cluster/README.md", "sample_videos/README.md"]


def blocks(kind, text=README):
    return re.findall(rf"```{kind}\n(.*?)```", text, flags=re.DOTALL)


LINES = [line for block in blocks("sh") for line in block.splitlines()]


def test_one_page():
    assert len(README.splitlines()) <= 240


def test_two_commands_do_everything():
    first, second = [line for line in LINES if line.startswith("python3 -m venv")]
    assert first.split(" && ")[-1].startswith(".venv/bin/dlgmd run sample_videos/")
    assert " -m pytest " in second.split(" && ")[-1]


def test_every_command_has_an_example():
    for name in COMMANDS:
        assert any(line.startswith(f"dlgmd {name} ") for line in LINES), name


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
    kind = MODELS[name]
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


def test_the_citation_is_that_of_the_readme():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    paper = citation["preferred-citation"]
    assert citation["version"] == __version__
    words = " ".join(README.replace("\n> ", " ").split())
    for part in (paper["title"], paper["journal"], paper["doi"], str(paper["start"])):
        assert part in words
    names = [f"{one['given-names']} {one['family-names']}" for one in paper["authors"]]
    assert ", ".join(names) in words


def test_scripts_for_elsewhere_are_python():
    script = ROOT / "configs/cluster/slurm.py"
    compile(script.read_text(encoding="utf-8"), str(script), "exec")
