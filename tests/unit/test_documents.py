"""The documents keep their word: options, tables, links, versions. The slow tier runs the code."""

import re
import shlex
from importlib import import_module
from importlib.util import find_spec

import click
import pytest
import yaml
from documents import PAGES, ROOT, commands, names_in, section_of, table_below, text_of

from dlgmd_cli import __version__
from dlgmd_cli.commands import console
from dlgmd_cli.commands.app import COMMANDS, HIDDEN, cli
from dlgmd_cli.machine import cancel
from dlgmd_cli.results import roc
from dlgmd_cli.results.csv import ALARM_COLUMNS, COMPARISON
from dlgmd_cli.scenes.objects import SCENES
from dlgmd_cli.scenes.scene import Truth
from dlgmd_cli.tasks.batch.batch import SUMMARY_COLUMNS
from dlgmd_cli.tasks.evaluate import benchmark
from dlgmd_cli.tasks.evaluate import tables as scores

README, PROJECT = text_of("README.md"), text_of("pyproject.toml")
FENCED = ("sh", "bash")
LINES = [line for page in PAGES for line, _ in commands(page, *FENCED)]
HAS_LAB = find_spec("dlgmd_cli.lab") is not None


def test_two_commands_do_everything():
    joined = re.sub(r"\\\n *", "", README)
    first, second = re.findall(r"^python3 -m venv .*$", joined, re.MULTILINE)
    assert first.split(" && ")[-1].startswith(".venv/bin/dlgmd run sample_videos/")
    assert " -m pytest " in second.split(" && ")[-1]


def test_every_command_has_an_example():
    assert {line.split()[1] for line in LINES} >= {*COMMANDS} - {"completion"}


def command_of(words):
    """The command that words name."""
    found = cli
    for word in words:
        if not isinstance(found, click.Group) or word not in found.list_commands(None):
            return found
        found = found.get_command(click.Context(cli), word)
    return found


def options_of(command):
    """Every way to write an option of a command."""
    own = [*command.params, *(p for p in cli.params if isinstance(p, click.Option))]
    return {name for one in own for name in (*one.opts, *one.secondary_opts)} | {"--help"}


def test_no_option_is_there_twice():
    """The general options are those of the tool alone."""
    for words in ([], ["sets", "show"], *([name] for name in COMMANDS if name != "lab")):
        options = [one for one in command_of(words).params if isinstance(one, click.Option)]
        names = [max(one.opts, key=len) for one in options]
        assert len({*names}) == len(names), words
        assert not words or not {"--quiet", "--json", "--log", "--debug"} & {*names}, words


INLINE = [
    code
    for page in PAGES
    for code in re.findall(r"`(dlgmd [^`]+)`", re.sub(r"```.*?```", "", text_of(page), flags=re.S))
]


def test_options_exist():
    for line in (*LINES, *INLINE):
        words = shlex.split(line)[1:]
        if words[:1] == ["lab"] and not HAS_LAB:
            continue
        given = [word for word in words if re.match(r"--?[a-zA-Z]", word)]
        command = command_of(words)
        assert not words or words[0] in (*COMMANDS, *HIDDEN, "COMMAND", "-v") or given, line
        assert command is cli or {*given} <= options_of(command), line


def test_options_in_sentences_exist():
    names = [[name] for name in COMMANDS if name != "lab" or HAS_LAB]
    names += [["lab", name] for name in ("fly", "paper", "bench", "measure") if HAS_LAB]
    known = set().union(*(options_of(command_of(words)) for words in names))
    for page in PAGES:
        if page.startswith("docs/lab") and not HAS_LAB:
            continue
        sentences = re.sub("```.*?```", "", text_of(page))
        named = {*re.findall(r"`(--[a-z][a-z0-9-]*)[^`]*`", sentences)}
        assert named <= known, page


def test_links_lead_somewhere():
    for page in PAGES:
        for target, anchor in re.findall(r"\]\((?!http)([^)#\s]*)#?([^)\s]*)\)", text_of(page)):
            place = (ROOT / page).parent / target if target else ROOT / page
            assert place.exists(), f"{page}: {target}"
            if anchor:
                heads = re.findall(r"^#+ (.*)$", place.read_text(encoding="utf-8"), re.MULTILINE)
                slugs = [re.sub(r"[^\w -]", "", head).lower().replace(" ", "-") for head in heads]
                assert anchor in slugs, f"{page}: {target}#{anchor}"


def test_the_keys_and_the_sets_have_generated_tables():
    found = re.findall(r"^<!-- generated: (.*) -->$", text_of("docs/parameters.md"), re.MULTILINE)
    assert {*found} == {"sets", "parameters"}


@pytest.fixture
def generate(monkeypatch):
    """The script that writes what is generated, and its module of tables."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    return import_module("generate")


def test_generated_tables_are_fresh(generate):
    for page in PAGES:
        new = generate.renewed(ROOT / page, tables_only=True)
        assert new == text_of(page), f"{page} is stale. Run: python docs/generate.py"


def test_every_column_is_explained():
    """The tables of `docs/columns.yaml`; those of runs and alarms are generated from the code."""
    tables = COMPARISON, SUMMARY_COLUMNS, scores.CURVE_COLUMNS, scores.SCORED_ALARM_COLUMNS
    columns = {name for table in (*tables, scores.TTC_COLUMNS) for name in table}
    section = text_of("docs/columns.md").partition("\n## Columns\n")[2].partition("\n## ")[0]
    section = re.sub("<!-- generated: columns .*?<!-- end -->", "", section, flags=re.DOTALL)
    lines = re.findall(r"^- (`.*?): ", section, re.MULTILINE)
    explained = [name for line in lines for name in names_in(line)]
    declared = {*COMPARISON[1:], *ALARM_COLUMNS}
    others = text_of("docs/columns.md").partition("\n## auc.csv and roc.csv\n")[2]
    own = [n for line in re.findall(r"^- (`.*?): ", others, re.MULTILINE) for n in names_in(line)]
    written = {*roc.AUC_COLUMNS, *roc.ROC_COLUMNS, *benchmark.COLUMNS, *benchmark.OF_SEQUENCES}
    assert {*own} == written - {"model", "video"}
    assert len(explained) == len({*explained}) and {*explained} == columns - declared


def test_exit_codes():
    codes = [int(first) for first, _ in table_below("docs/columns.md", "Exit codes")[1:]]
    assert codes == [0, console.EXIT_FAILED, console.EXIT_USAGE, cancel.EXIT_INTERRUPTED]


def test_extras_and_scenes_and_their_truth():
    (extras,) = re.findall(r"optional-dependencies\]\n(.*?)^\[", PROJECT, re.DOTALL | re.MULTILINE)
    named = [names_in(first)[0] for first, _ in table_below("docs/start.md", "Install")[1:]]
    known = re.findall(r"^(\w+) = \[", extras, re.MULTILINE)
    assert {*named} == {*known} - {"test", "docs", "bench", "dev"}
    assert names_in(section_of("docs/flights.md", "Ground truth")) == [*Truth._fields]
    scenes = section_of("docs/flights.md", "Scenes")
    (listed,) = re.findall(r"^(- .*?)\n\n", scenes, re.DOTALL | re.MULTILINE)
    assert {n for n in names_in(listed) if n[0] != "-"} == {*SCENES}
    assert "\n`benchmark` is " in scenes


@pytest.mark.parametrize("page", PAGES)
def test_every_table_has_one_head(page):
    """A row after an empty line would be shown as text."""
    tables = re.findall(r"^\|.*\n(?:^\|.*\n?)*", text_of(page), re.MULTILINE)
    assert all(re.match(r"\|.*\n\|[-| ]+\|\n\|", table) for table in tables)


@pytest.mark.parametrize("page", PAGES)
def test_no_line_begins_with_a_per_cent_sign(page):
    """The pages' parser takes such a line for a comment: its words would be missing."""
    assert not re.search(r"^\s*%", text_of(page), re.MULTILINE)


def test_the_first_page_has_the_version():
    for page in ("README.md", "docs/index.md"):
        assert f"version {__version__[:3]}" in text_of(page).replace("\n", " ")


@pytest.mark.parametrize("page", ["README.md", "docs/start.md"])
def test_the_sentence_below_the_sample_agrees_with_what_is_printed(page):
    """The clip has 30 frames/s, and its contact is at frame 140 (`sample_videos/README.md`)."""
    text = " ".join(text_of(page).split())
    began_s = float(re.search(r"([\d.]+) to [\d.]+ s, frames", text)[1])
    told = re.search(r"board at (\S+) s \(frame (\d+)\), (\S+) s after the alarm begins", text)
    assert told.groups() == (f"{140 / 30:.2f}", "140", f"{140 / 30 - began_s:.2f}")


def test_scores_in_sentences_are_those_of_the_tables():
    """Wherever the README and Limits repeat them."""
    rows = {cells[0]: cells[4:] for cells in table_below("docs/approaches.md", "Alarms")}
    of_models = [rows[name] for name in ("`flight`", "`set6`", "LK divergence, best threshold")]
    announced, false, rates = zip(*of_models, strict=True)
    readme = {row[0]: row[1:] for row in table_below("README.md", "How good is it?")}
    assert tuple(readme["real approaches announced, of 23"]) == announced
    assert tuple(readme["false alarms a minute in these clips"]) == rates
    held_out = table_below("docs/lab/held-out.md", "Flights held out")
    (row_of_flight,) = (row[2:] for row in held_out if row[:2] == ["`flight`", "0.47"])
    tilt, _, jerk, stock, false_per_min = row_of_flight
    assert [cells[0] for cells in readme.values()][-4:] == [tilt, jerk, stock, false_per_min]
    here = {page: " ".join(text_of(page).split()) for page in (*PAGES,)}
    (n, *_), rate = announced[0].split(), rates[0].split()[0]
    assert f"In {n} of 23 [recorded approaches" in here["README.md"]
    assert f"raises {float(rate):.1f} false alarms a minute" in here["README.md"]
    assert f"raises {false[0]} false alarms" in here["docs/limits.md"]


def test_the_citation_is_that_of_the_readme():
    citation = yaml.safe_load(text_of("CITATION.cff"))
    paper = citation["preferred-citation"]
    words = " ".join(README.replace("\n> ", " ").split())
    for part in (paper["title"], paper["journal"], paper["doi"], str(paper["start"])):
        assert part in words
    names = [f"{one['given-names']} {one['family-names']}" for one in paper["authors"]]
    assert ", ".join(names) in words
    # A version that is not released has no date.
    assert citation["version"] == __version__
    state = citation.get("date-released", "unreleased")
    assert f"## {__version__.removesuffix('.dev0')} ({state})" in text_of("CHANGELOG.md")


def test_the_script_for_a_cluster_is_python():
    compile(text_of("configs/cluster/slurm.py"), "slurm.py", "exec")
