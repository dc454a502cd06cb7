"""What a forge reads: workflows, forms, the changelog, the addresses of the project."""

import os
import re
import runpy
import shutil
import subprocess
import sys
from types import SimpleNamespace

import pytest
import yaml
from documents import ROOT, text_of

from dlgmd_cli import __version__

WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
FORMS = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("[bq]*.yml"))


def blocks():
    """The shell blocks of the workflows, by the names of their steps."""
    for path in WORKFLOWS:
        for job in yaml.safe_load(path.read_text(encoding="utf-8"))["jobs"].values():
            for step in job["steps"]:
                assert {"uses", "run"} & {*step}, (path.name, step)
                if "run" in step and step.get("shell") != "pwsh":
                    yield step["name"] if "name" in step else step["run"], step["run"]


def bash(block, folder, **environment):
    """Run a block as a forge does."""
    shell = shutil.which("bash") or pytest.skip("needs bash")
    return subprocess.run(
        [shell, "-eo", "pipefail", "-c", block],
        cwd=folder,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize(("name", "block"), [*blocks()], ids=lambda words: words[:30])
def test_each_block_is_a_script(tmp_path, name, block):
    done = bash(f"set -n\n{block}", tmp_path)
    assert done.returncode == 0 and not done.stderr, (name, done.stderr)


def test_commands_are_read_from_the_pages(tmp_path):
    (tmp_path / "docs").mkdir()
    for page in ("README.md", "docs/start.md"):
        shutil.copy(ROOT / page, tmp_path / page)
    for name, block in blocks():
        if name.startswith("Read the"):
            assert bash(block, tmp_path).returncode == 0, name
    run, test = (tmp_path / "commands.sh").read_text().splitlines()
    assert ".venv/bin/dlgmd run" in run and "-m pytest" in test
    assert "dlgmd run" in (tmp_path / "lines.ps1").read_text()


def test_a_release_needs_its_tag_and_a_date(tmp_path):
    block = dict(blocks())["The tag names the version"]
    (tmp_path / "dlgmd_cli").mkdir()
    shutil.copy(ROOT / "dlgmd_cli" / "__init__.py", tmp_path / "dlgmd_cli")
    heading = f"## {__version__} (2030-01-02)\n"
    for tag, log, holds in (
        (f"v{__version__}", heading, True),
        (__version__, heading, False),
        (f"v{__version__}", heading.replace("2030-01-02", "unreleased"), False),
    ):
        (tmp_path / "CHANGELOG.md").write_text(log)
        assert (bash(block, tmp_path, GITHUB_REF_NAME=tag).returncode == 0) is holds, tag


def test_all_supported_versions_of_python_are_tried():
    workflow = yaml.safe_load(text_of(".github/workflows/tests.yml"))
    versions = workflow["jobs"]["readme"]["strategy"]["matrix"]["python"]
    declared = re.findall(r"Python :: (3\.\d+)", text_of("pyproject.toml"))
    assert versions == sorted(versions, key=lambda v: int(v[2:]))
    assert {*declared} <= {*versions}


@pytest.mark.parametrize("path", FORMS, ids=lambda path: path.stem)
def test_forms_have_what_a_forge_requires(path):
    form = yaml.safe_load(path.read_text(encoding="utf-8"))
    assert form["name"] and form["description"]
    fields = [field for field in form["body"] if field["type"] != "markdown"]
    assert all(field["attributes"]["label"] for field in fields)
    assert len({field["id"] for field in fields}) == len(fields)


def test_the_readme_on_an_index_leads_to_the_repository(monkeypatch):
    base = "hatchling.metadata.plugin.interface"
    monkeypatch.setitem(sys.modules, base, SimpleNamespace(MetadataHookInterface=object))
    hook = runpy.run_path(str(ROOT / "hatch_build.py"))["Readme"]()
    hook.root = ROOT
    for urls, here in (({}, ""), ({"Source": "https://a.example/b"}, "https://a.example/b/")):
        metadata = {"urls": urls}
        hook.update(metadata)
        text = metadata["readme"]["text"]
        raw, page = (f"{here}{name}/HEAD/" if here else "" for name in ("raw", "blob"))
        assert f"![Membrane potential of set 9 with its spikes and the alarm]({raw}docs/" in text
        assert f'srcset="{raw}docs/_static/' in text and f'<img src="{raw}docs/' in text
        assert f"[questions]({page}docs/questions.md)" in text
        assert not here or not re.search(r'\]\((docs|sample)|(src|srcset)="docs', text)


def test_no_other_file_names_an_index():
    places = ["README.md", *(f"docs/{path.name}" for path in (ROOT / "docs").glob("*.md"))]
    for place in (*places, ".github/workflows/tests.yml", "pyproject.toml"):
        assert not re.search(r"pypi|pip install '?\"?dlgmd", text_of(place), re.IGNORECASE), place


def test_the_changelog_has_versions_sections_and_lines():
    log = text_of("CHANGELOG.md")
    headings = re.findall(r"^## (.*)$", log, re.MULTILINE)
    assert all(re.fullmatch(r"\d+\.\d+\.\d+ \((unreleased|\d{4}(-\d\d){2})\)", h) for h in headings)
    newest = log.partition("\n## ")[2].partition("\n## ")[0]
    for line in newest.partition("\n### ")[2].splitlines()[1:]:
        assert not line or line.startswith(("- ", "  ", "### ")) or line.endswith(":"), line
