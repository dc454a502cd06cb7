"""Imports point one way: a folder may import only what stands on an earlier step."""

import ast
from pathlib import Path

import pytest

import dlgmd_cli

PACKAGE = Path(dlgmd_cli.__file__).parent
STEPS = [
    {"errors", "stops", "threads"},
    {"parameters"},
    {"models", "video", "results"},
    {"stimuli", "runs", "plots"},
    {"flights"},
    {"paper", "batch"},
    {"commands"},
    {"app"},
    {"__main__"},
]
STEP = {name: number for number, step in enumerate(STEPS) for name in step}
ONLY_IN = {
    "click": {"app", "commands"},
    "rich": {"commands"},
    "matplotlib": {"plots"},
    "numba": {"models"},
    "av": {"video"},
    "yaml": {"parameters", "results", "commands"},
    "distributed": {"batch"},
    "fsspec": {"batch"},
}


def modules():
    return sorted(PACKAGE.rglob("*.py"))


def imports(path):
    """Every module that `path` imports, with those for type checking only."""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            yield node.module


def home(path):
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


@pytest.mark.parametrize("path", modules(), ids=lambda path: str(path.relative_to(PACKAGE)))
def test_imports_point_left(path):
    folder = home(path)
    for name in imports(path):
        parts = name.split(".")
        if parts[0] != "dlgmd_cli":
            assert folder in ONLY_IN.get(parts[0], {folder}), f"{name} in {path}"
            continue
        if folder == "__init__" or len(parts) == 1:  # the package root only holds the version
            continue
        if name == "dlgmd_cli.runs.axis":  # results and plots name the axes of a sweep
            continue
        other = parts[1]
        assert other == folder or STEP[other] < STEP[folder], f"{path} imports {name}"


def test_every_folder_has_its_step():
    assert {home(path) for path in modules()} == set(STEP) | {"__init__"}


def test_pyplot_and_capture_stay_in_their_places():
    for path in modules():
        text = path.read_text(encoding="utf-8")
        assert "pyplot" not in text, path
        assert "VideoCapture" not in text or home(path) == "video", path


def test_modules_are_short():
    for path in modules():
        assert path.read_text(encoding="utf-8").count("\n") <= 560, path
