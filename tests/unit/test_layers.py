"""Imports point one way: a folder may import only what stands on an earlier step; no circles."""

import ast
from graphlib import TopologicalSorter
from importlib import import_module
from pathlib import Path

import pytest
from source import statements, tree

import dlgmd_cli
from dlgmd_cli.results.outcome import Outcome, drawn_by

PACKAGE = Path(dlgmd_cli.__file__).parent
STEPS = [
    {"errors"},
    {"frame"},
    {"reduction"},
    {"stream"},
    {"parameters"},
    {"machine"},
    {"stream"},
    {"models", "video"},
    {"results"},
    {"scenes"},
    {"plots"},
    {"tasks"},
    {"microcontroller", "watch", "pages"},
    {"commands"},
    {"lab"},
    {"__main__"},
]
STEP = {name: number for number, step in enumerate(STEPS) for name in step}
ONLY_IN = {
    "click": {"commands", "lab"},
    "rich": {"commands"},
    "matplotlib": {"lab", "plots", "results", "tasks"},  # outside plots: the type of a figure
    "jinja2": {"pages", "lab"},
    "PIL": {"plots"},
    "av": {"video"},
    "pebble": {"machine"},
    "filelock": {"results"},
    "distributed": {"machine"},
    "fsspec": {"results", "tasks"},
    "upath": {"results", "tasks"},
    "plotly": {"pages"},
    "pymavlink": {"watch"},
    "starlette": {"watch"},
    "uvicorn": {"watch"},
}


MODULES = {path: path.read_text(encoding="utf-8") for path in sorted(PACKAGE.rglob("*.py"))}
NAMES = {
    ".".join([PACKAGE.name, *path.relative_to(PACKAGE).with_suffix("").parts]) for path in MODULES
}


def relative(path):
    return path.relative_to(PACKAGE).as_posix()


def imports(path):
    """Every module that `path` imports, with those for type checking only."""
    for node in statements(tree(path)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                name = f"{node.module}.{alias.name}"
                yield name if name in NAMES else node.module


def home(parts):
    """The folder of a module, or its own name at the top."""
    return parts[0].removesuffix(".py")


@pytest.fixture(scope="module")
def imported():
    """What each module imports."""
    return {path: [*imports(path)] for path in MODULES}


def test_imports_point_left(imported):
    for path, name in ((path, name) for path, names in imported.items() for name in names):
        folder, parts = home(path.relative_to(PACKAGE).parts), name.split(".")
        if parts[0] != "dlgmd_cli":
            assert folder in ONLY_IN.get(parts[0], {folder}), f"{name} in {path}"
        elif folder != "__init__" and len(parts) > 1:
            other = home(parts[1:])
            assert other == folder or STEP[other] < STEP[folder], f"{path} imports {name}"


def test_every_folder_has_its_step():
    found = {home(path.relative_to(PACKAGE).parts) for path in MODULES}
    # The laboratory may be deleted.
    assert found | {"lab"} == set(STEP) | {"__init__"}


def test_there_are_no_circles(imported):
    graph = {}
    for path, names in imported.items():
        name = ".".join(["dlgmd_cli", *path.relative_to(PACKAGE).with_suffix("").parts])
        graph[name.removesuffix(".__init__")] = set(names)
    del graph["dlgmd_cli"]  # it only hands names on, and they are imported when they are used
    tuple(TopologicalSorter(graph).static_order())  # raises CycleError


def test_an_outcome_is_drawn_by_what_there_is():
    for room in ("results", "tasks"):
        for path in PACKAGE.glob(f"{room}/**/*.py"):
            parts = path.relative_to(PACKAGE).with_suffix("").parts
            import_module(".".join(["dlgmd_cli", *parts]))
    kinds = [kind for kind in Outcome.__subclasses__() if kind.FIGURES]
    assert kinds
    for where in {where for kind in kinds for where in kind.FIGURES.values()}:
        assert callable(drawn_by(where)), where


# The last one starts another program, a bare loop over `read`.
CAPTURES = ("video/opencv_decoder.py", "video/live_source.py", "lab/bench/programs.py")


def test_pyplot_and_capture_stay_in_their_places():
    for path, text in MODULES.items():
        assert "pyplot" not in text, path
        is_capture = relative(path) in CAPTURES
        assert "VideoCapture" not in text or is_capture, path


def test_modules_are_short():
    for path, text in MODULES.items():
        assert text.count("\n") <= 600, path
