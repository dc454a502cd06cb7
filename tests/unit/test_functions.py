"""The public functions refuse what the commands refuse; they are light, and declared."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import looming_frames

import dlgmd_cli
from dlgmd_cli import errors

ROOT = Path(dlgmd_cli.__file__).parent


@pytest.mark.parametrize(
    ("call", "error", "why"),
    [
        (lambda v: dlgmd_cli.batch(v, out="x"), errors.SourceError, "there is no video"),
        (lambda v: dlgmd_cli.batch(v, []), errors.ParameterError, "list of models is empty"),
        (lambda v: dlgmd_cli.batch(v, scael=0.5), errors.ParameterError, "no option 'scael'"),
        (
            lambda v: dlgmd_cli.batch(v, jobs=2, scheduler="tcp://x:1"),
            errors.ParameterError,
            "jobs does not work with scheduler",
        ),
        (lambda v: dlgmd_cli.evaluate("gone.csv"), errors.ResultError, "this file is missing"),
        (
            lambda v: dlgmd_cli.evaluate("l.csv", results="x", model=9),
            errors.ParameterError,
            "model does not work with results",
        ),
        (lambda v: dlgmd_cli.evaluate("l.csv", horizon=0), errors.ParameterError, "horizon: "),
        (lambda v: dlgmd_cli.evaluate("l.csv"), errors.SourceError, "no video could be scored"),
        (lambda v: dlgmd_cli.calibrate("l.csv", folds=1), errors.ParameterError, "folds = 1"),
        (
            lambda v: dlgmd_cli.calibrate("l.csv", 9, normalise="sequence"),
            errors.ParameterError,
            "no threshold",
        ),
        (
            lambda v: dlgmd_cli.calibrate("l.csv", 9, search=["width_px=100:300"], scale=0.5),
            errors.ParameterError,
            "width_px cannot be searched together with scale or size",
        ),
        (
            lambda v: dlgmd_cli.calibrate("l.csv", model="by-sequence.yaml"),
            errors.ParameterError,
            "no threshold",
        ),
        (
            lambda v: dlgmd_cli.calibrate("l.csv", model=9, search={"sigma_e": (2, 1)}),
            errors.ParameterError,
            "does not rise",
        ),
        *(
            (
                lambda v, f=f, more=more: f("gone.mp4", formats=["jpg"], **more),
                errors.ParameterError,
                "there is no format 'jpg'",
            )
            for f, more in {
                dlgmd_cli.run: {},
                dlgmd_cli.compare: {},
                dlgmd_cli.layers: {},
                dlgmd_cli.batch: {},
                dlgmd_cli.sweep: {"x": "r=2", "y": "a=1"},
                dlgmd_cli.evaluate: {},
                dlgmd_cli.calibrate: {},
            }.items()
        ),
        (lambda v: dlgmd_cli.layers("gone.mp4"), errors.SourceError, "no such file"),
        (
            lambda v: dlgmd_cli.layers(looming_frames(), range(13)),
            errors.ParameterError,
            "13 frames are too many",
        ),
        (
            lambda v: dlgmd_cli.layers(looming_frames(), [99]),
            errors.SourceError,
            "frame 99 is not in it",
        ),
        (
            lambda v: dlgmd_cli.sweep(x="r=2,3", y="sigma_e=1", fps=5),
            errors.ParameterError,
            "fps works only with an INPUT",
        ),
        (
            lambda v: dlgmd_cli.sweep(x="r=2,3", y="sigma_e=1", param={"r": 3}),
            errors.ParameterError,
            "param sets r, which is an axis",
        ),
        (lambda v: dlgmd_cli.synth("cube"), errors.ParameterError, "there is no scene 'cube'"),
        (
            lambda v: dlgmd_cli.synth("looming-cube", distanc=3),
            errors.ParameterError,
            "distanc: looming-cube has no such option",
        ),
        (
            lambda v: dlgmd_cli.synth("looming-cube", sheet=True),
            errors.ParameterError,
            "Give their folder, out",
        ),
    ],
)
def test_errors_are_the_library_s(dlgmd, tmp_path, call, error, why):
    (tmp_path / "empty").mkdir()
    (tmp_path / "l.csv").write_text("video,collision_frame\ngone.mp4,3\n")
    (tmp_path / "by-sequence.yaml").write_text("set: 9\noptions:\n  normalise: sequence\n")
    with pytest.raises(error, match=why):
        call("empty")
    assert not Path("x").exists()


def test_the_library_is_light_and_needs_no_click():
    program = """
import sys, dlgmd_cli
assert not {"numpy", "cv2", "yaml", "dlgmd_cli.tasks"} & set(sys.modules)
for name in dlgmd_cli.__all__:
    assert callable(getattr(dlgmd_cli, name)), name
heavy = {"click", "rich", "matplotlib", "optuna", "numba", "distributed"} & set(sys.modules)
assert not heavy, heavy
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_public_names_are_declared_for_type_checkers_and_are_no_modules():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    declared = {
        alias.asname: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("dlgmd_cli.")
        for alias in node.names
    }
    assert declared == {n: f"dlgmd_cli.{home}" for n, home in dlgmd_cli._HOMES.items()}
    modules = {path.stem for path in ROOT.iterdir()}
    assert not modules & {*dlgmd_cli.__all__}, "importing it would hide the function"
