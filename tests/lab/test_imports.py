"""The tool does not know the laboratory; laboratory and `live` use documented modules of it."""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import dlgmd_cli

PACKAGE = Path(dlgmd_cli.__file__).parent
LAB = PACKAGE / "lab"
MODULES_RST = Path(__file__).parents[2] / "docs" / "python-modules.rst"
# Beside the names in `dlgmd_cli.__all__`, the laboratory may import these modules.
ALLOWED = {
    "dlgmd_cli.errors",
    "dlgmd_cli.commands.console",
    "dlgmd_cli.commands.options",
    "dlgmd_cli.machine.pool",
    "dlgmd_cli.results.store",
    "dlgmd_cli.results.outcome",
    "dlgmd_cli.results.labels",
    "dlgmd_cli.models.base",
    "dlgmd_cli.models.health",
    "dlgmd_cli.models.stopping",
    "dlgmd_cli.parameters.presets",
    "dlgmd_cli.video.writer",
    "dlgmd_cli.plots.style",
}
DOCUMENTED = {
    *re.findall(r"^\.\. automodule:: (\S+)$", MODULES_RST.read_text(encoding="utf-8"), re.M)
}
LAB_FILES = sorted(LAB.rglob("*.py"))
LIVE_FILES = sorted((PACKAGE / "watch").rglob("*.py"))
TOOL_FILES = [path for path in sorted(PACKAGE.rglob("*.py")) if LAB not in path.parents]
# What names the laboratory: its module, one of its modules by a relative import, a path.
NAMES_LAB = re.compile(
    r"dlgmd_cli[./]lab\b|from \.+ ?lab\b|from \.+ import .*\blab\b|[\"']\.?lab\."
)


def imported(path):
    """What a file imports of `dlgmd_cli`, at the top and in functions: module and name."""
    own = [*path.relative_to(PACKAGE.parent).parts[:-1]]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = own[: len(own) - node.level + 1] if node.level else []
            module = ".".join([*above, *filter(None, [node.module])])
            yield from ((module, alias.name) for alias in node.names)


def is_allowed(module, name, room="lab", allowed=frozenset(ALLOWED)):
    """Whether a room may import a name of a module, or the module itself."""
    if module.split(".")[0] != "dlgmd_cli":
        return True
    if module == "dlgmd_cli":
        return (
            name in ("", "__version__", room, *dlgmd_cli.__all__) or f"{module}.{name}" in allowed
        )
    is_own = f"{module}.".startswith(f"dlgmd_cli.{room}.")
    return is_own or module in allowed or f"{module}.{name}" in allowed


def test_nothing_of_the_tool_names_the_laboratory():
    lines = [
        f"{path.relative_to(PACKAGE)}: {line.strip()}"
        for path in TOOL_FILES
        for line in path.read_text(encoding="utf-8").splitlines()
        if NAMES_LAB.search(line)
    ]
    assert len(lines) == 1 and lines[0].startswith("commands/app.py: "), lines
    imports = {module for path in TOOL_FILES for module, _ in imported(path)}
    assert not {module for module in imports if module.startswith("dlgmd_cli.lab")}


@pytest.mark.parametrize("path", LAB_FILES, ids=lambda path: path.relative_to(LAB).as_posix())
def test_the_laboratory_uses_public_names_and_documented_modules(path):
    others = [f"{module} {name}" for module, name in imported(path) if not is_allowed(module, name)]
    assert not others


@pytest.mark.parametrize("path", LIVE_FILES, ids=lambda path: path.name)
def test_live_uses_public_names_and_documented_modules(path):
    found = imported(path)
    assert not [one for one in found if not is_allowed(*one, "watch", DOCUMENTED)]


def test_modules_and_names_in_strings_are_allowed_too():
    """Modules that are named for a later import, as by `import_module`."""
    for path in LAB_FILES:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                names = re.fullmatch(r"dlgmd_cli(\.[\w.]+)(:\w+)?", node.value)
                assert not names or is_allowed(f"dlgmd_cli{names[1]}", ""), (path, node.value)


def test_each_module_that_it_uses_is_documented():
    assert DOCUMENTED >= ALLOWED


WITHOUT_LAB = """
import importlib.abc
import pkgutil
import sys

class Refuse(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name == "dlgmd_cli.lab" or name.startswith("dlgmd_cli.lab."):
            raise ModuleNotFoundError(name, name=name)

sys.meta_path.insert(0, Refuse())
import dlgmd_cli

modules = [one.name for one in pkgutil.walk_packages(dlgmd_cli.__path__, "dlgmd_cli.")
           if not one.name.startswith("dlgmd_cli.lab") and one.name != "dlgmd_cli.__main__"]
for name in modules:
    importlib.import_module(name)
for name in dlgmd_cli.__all__:
    getattr(dlgmd_cli, name)
print(len(modules))
sys.argv = ["dlgmd", "--help"]
from dlgmd_cli.__main__ import main
main()
"""


def test_the_tool_works_without_the_laboratory():
    done = subprocess.run(
        [sys.executable, "-c", WITHOUT_LAB], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    n_modules, shown = done.stdout.split("\n", 1)
    assert int(n_modules) > 100 and "run" in shown and "Usage: dlgmd" in shown
