"""The command as a whole, and its small commands."""

import importlib
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from dlgmd_cli import __version__
from dlgmd_cli.commands.app import GROUPS, cli
from dlgmd_cli.parameters.presets import MODELS, load_config, load_preset, parameters_of

# Without the laboratory, which may be left out and has tests of its own.
COMMANDS = tuple(name for name in cli.list_commands(None) if name != "lab")


def python(*words, **options):
    """What a process of Python says; `words` follow its name."""
    options = {"capture_output": True, "encoding": "utf-8"} | options
    return subprocess.run([sys.executable, *words], **options)


def test_the_examples_of_help_parse(runs):
    for name in ((), *((name,) for name in COMMANDS), ("sets", "show")):
        text = runs(*name, "--help").stdout
        lines = text.splitlines()
        shown = "\n".join(lines[lines.index("  Examples:") :]).partition("\n\n")[0]
        uses = re.findall(rf"dlgmd{''.join(f' {word}' for word in name)}\b([^#>|)\n]*)", shown)
        assert uses, name
        command = cli
        for word in name:
            command = command.get_command(None, word)
        for use in uses:
            command.make_context("dlgmd", shlex.split(use))
    text = runs("--help").stdout
    for title, names in GROUPS.items():
        section = text.partition(f"\n{title}:\n")[2].partition("\n\n")[0]
        listed = re.findall(r"^  (\w+) ", section, re.M)
        assert listed == [name for name in names if name in (*COMMANDS, *listed)]
    assert "completion" not in text


def test_help_has_sections_and_nothing_of_the_parser(dlgmd):
    """The common options come first in their sections, and types are named by what is wanted."""
    for name in COMMANDS:
        text = dlgmd(name, "--help").stdout
        assert not re.search(r"RANGE|INTEGER|FLOAT|WXH|x<=|<x", text.partition("\n\n")[2]), name
        titles = re.findall(r"^(Model|Input|Output|General):$", text, re.M)
        order = ["Model", "Input", "Output", "General"]
        assert titles == [title for title in order if title in titles], name
        assert "General" in titles and "--quiet" in text
    sections = re.split(
        r"^(?:Model|Input|Output|General):$", dlgmd("run", "--help").stdout, flags=re.M
    )
    firsts = [re.search(r"--\w[\w-]*", section)[0] for section in sections[1:]]
    assert firsts == ["--set", "--size", "--out", "--json"]


def test_the_group_alone_prints_its_help(dlgmd):
    result = dlgmd()
    assert result.exit_code == 2
    assert result.stderr.splitlines() == dlgmd("--help").stdout.splitlines()


@pytest.mark.parametrize("arguments", ["--version", "-V", "run -V", "sets --version"])
def test_version(dlgmd, arguments):
    assert dlgmd(*arguments.split()).stdout == f"dlgmd, version {__version__}\n"


def test_general_options_before_and_after_the_command(dlgmd):
    scene = ["synth", "ball", "--mp4", "--frames", 2, "--size", "64x48", "--noise", 0.1]
    assert "Note: " in dlgmd(*scene, "-o", "a").stderr
    for number, arguments in enumerate(([*scene, "-q"], [*scene, "--quiet"], ["-q", *scene])):
        assert dlgmd(*arguments, "-o", f"b{number}").stderr == ""
    for number, words in enumerate((["--log", "a.log"], ["--log=a.log"])):
        dlgmd(*scene, *words, "-o", f"c{number}")
    assert Path("a.log").read_text().count("Note: ") == 2
    # What follows -- is no option.
    assert "--quiet: there is no" in dlgmd("run", "--", "--quiet").stderr


def test_an_option_may_be_an_environment_variable(dlgmd, monkeypatch):
    monkeypatch.setenv("DLGMD_RUN_FOV", "500")
    result = dlgmd("run", "flight.mp4")
    assert result.exit_code == 2 and "'--fov': 500 is more than 170" in result.stderr
    monkeypatch.setenv("DLGMD_QUIET", "1")
    monkeypatch.delenv("DLGMD_RUN_FOV")
    scene = ("synth", "looming-cube", "--frames", 2, "--size", "64x48", "--noise", 0.1)
    assert dlgmd(*scene).stderr == ""


def test_arguments_too_many_are_not_alllisted(dlgmd):
    for number in range(155):
        open(f"{number}.png", "w").close()
    names = [f"{number}.png" for number in range(155)]
    error = dlgmd("run", *names).stderr
    assert "quote the pattern: '*.png'" in error and len(error) < 400
    assert "unexpected arguments: 'b', 'c', 'd' and 2 more." in dlgmd("run", *"abcdef").stderr


def test_a_command_that_is_not_there(dlgmd):
    result = dlgmd("rum")
    assert result.exit_code == 2 and "Did you mean 'dlgmd run'?" in result.stderr
    assert dlgmd("xyzzy").exit_code == 2


def test_help_and_usage_errors_import_nothing_heavy():
    lines = [[name, "--help"] for name in COMMANDS]
    lines += [["--help"], ["run"], ["run", "x", "--scale", "5"], ["run", "x", "--decoder", "vlc"]]
    lines += [["plot", "mp", "x", "--mark", "y"], ["nonsense"]]
    program = f"""
import contextlib, io, sys
from dlgmd_cli.commands.app import main
for arguments in {lines}:
    sys.argv = ["dlgmd", *arguments]
    with contextlib.suppress(SystemExit), contextlib.redirect_stdout(io.StringIO()):
        main()
    heavy = {{"av", "cv2", "matplotlib", "numpy", "yaml", "distributed", "pebble"}}
    assert not heavy & set(sys.modules), (arguments, heavy & set(sys.modules))
"""
    done = python("-c", program)
    assert done.returncode == 0, done.stderr


def test_without_the_laboratory_the_tool_lacks_one_command(dlgmd, monkeypatch):
    def load(name):
        if name.startswith("dlgmd_cli.lab"):
            raise ModuleNotFoundError(f"No module named {name!r}", name="dlgmd_cli.lab")
        return importlib.import_module(name)

    monkeypatch.setattr("dlgmd_cli.commands.app.import_module", load)
    assert "\n  lab " not in dlgmd("--help").stdout
    result = dlgmd("lab")
    assert (
        result.exit_code == 2 and result.stderr.splitlines()[-1] == "Error: No such command 'lab'."
    )


def test_sets_table(runs):
    lines = runs("sets").stdout.splitlines()
    assert max(len(line) for line in lines if not line.startswith("Keys")) <= 80
    rows = [line.split() for line in lines]
    (nine,) = [row for row in rows if row[:1] == ["9"]]
    assert nine == ["9", "-0.1", "0.5", "0.7", "1.5", "5", "6", "1.5", "0.5", "0.0028"]


@pytest.mark.parametrize("name", ["1", "9", "flight", "lgmd", "plgmd", "emd-lplc2"])
def test_sets_show_is_a_config(dlgmd, runs, tmp_path, name):
    result = runs("sets", "show", name)
    assert name in dlgmd("sets").stdout
    (tmp_path / "my.yaml").write_text(result.stdout, encoding="utf-8")
    shown = load_config(tmp_path / "my.yaml")
    if name in MODELS:
        assert (shown.model, shown.values) == (name, MODELS[name]().to_dict())
        return
    preset = load_config("flight") if name == "flight" else load_preset(name)
    assert parameters_of(shown) == parameters_of(preset)
    model, width_px = ("dlgmd", 240) if name == "flight" else ("dlgmd", 480)
    assert (shown.model, shown.width_px, shown.model_fps) == (model, width_px, 30.0)


@pytest.mark.parametrize(
    ("error", "words"),
    [
        ("ImportError('x.so: failed to map segment from shared object')", "not enough memory"),
        ("ImportError('x.so: cannot allocate memory in static TLS block')", "not enough memory"),
        ("MemoryError", "not enough memory"),
        ("SystemError", "not enough memory"),
        ('RuntimeError("can\'t start new thread")', "no more threads"),
    ],
)
def test_what_runs_short_while_modules_are_loaded(dlgmd, monkeypatch, error, words):
    def load(name):
        raise eval(error)

    monkeypatch.setattr("dlgmd_cli.commands.app.import_module", load)
    result = dlgmd("sets")
    assert result.exit_code == 1 and result.stderr.startswith("Error: ") and words in result.stderr
    assert result.stderr.count("\n") == 1


def test_the_table_of_collisions_has_the_same_names_everywhere(dlgmd):
    for name in ("plot", "view"):
        (opts,) = (p.opts for p in cli.get_command(None, name).params if "--collisions" in p.opts)
        assert {*opts} == {"--collisions", "--labels"}
        text = dlgmd(name, "--help").stdout  # the alias is not shown
        assert "  --collisions" in text and "--labels" not in text
