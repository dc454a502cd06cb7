"""The shell completes what can be known: commands, options, values, files."""

import shutil
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from dlgmd_cli.commands.app import cli
from dlgmd_cli.commands.completion import SHELLS
from dlgmd_cli.parameters.presets import MODELS, PRESETS


def completed(*words):
    """What the last word may become, and the kinds of what it may."""
    *before, last = words
    found = ShellComplete(cli, {}, "dlgmd", "_DLGMD_COMPLETE").get_completions(before, last)
    return [item.value for item in found], {item.type for item in found}


def test_commands_and_options():
    assert completed("")[0] == cli.list_commands(None)
    assert completed("run", "--form")[0] == ["--format"]
    assert completed("run", "--qu")[0] == ["--quiet"]


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("run --set ", [*"123456789", *PRESETS]),
        ("batch x --set 7", ["7"]),
        ("run --model l", [name for name in MODELS if name[0] == "l"]),
        ("run --param sigma_", ["sigma_e=", "sigma_i="]),
        ("run --model lgmd --param ", [f"{key}=" for key in MODELS["lgmd"].specs()]),
        ("sweep --x tau_l", ["tau_low="]),
        ("synth loom", ["looming", "looming-cube", "looming-ball"]),
        ("sets l", [name for name in MODELS if name[0] == "l"]),
        ("sets show dlgmd-o", ["dlgmd-onoff"]),
        ("plot ov", ["overview"]),
        ("completion ", list(SHELLS)),
    ],
)
def test_values(words, expected):
    assert completed(*words.split(" ")) == (expected, {"plain"})


FILES = ("run", "batch", "compare", "layers", "sweep", "plot mp", "evaluate", "calibrate")


@pytest.mark.parametrize("words", [*FILES, "run --config"])
def test_files_and_folders(words):
    assert completed(*words.split(), "x") == (["x"], {"file"})
    assert completed("run", "x", "--out", "y") == (["y"], {"dir"})


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts(dlgmd, shell):
    script = dlgmd("completion", shell).stdout
    assert f"_DLGMD_COMPLETE={shell}_complete" in script


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
def test_bash_completes(dlgmd, tmp_path):
    command = tmp_path / "dlgmd"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m dlgmd_cli "$@"\n')
    command.chmod(0o755)
    script = dlgmd("completion", "bash").stdout
    words = "COMP_WORDS=(dlgmd run --param sigma_); COMP_CWORD=3"
    call = f"compopt() {{ :; }}; {words}; _dlgmd_completion ./dlgmd"
    program = f"{script}\n{call}\necho ${{COMPREPLY[@]}}"
    done = subprocess.run(["bash", "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "sigma_e= sigma_i=\n"
