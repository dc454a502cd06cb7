"""The public functions refuse what the commands refuse; they are light, and declared."""

import ast
import inspect
import re
from importlib import import_module
from pathlib import Path

import pytest
from conftest import looming_frames

import dlgmd_cli
from dlgmd_cli.commands.app import COMMANDS, cli
from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.tasks.call import RUN_ARGUMENTS

ROOT = Path(dlgmd_cli.__file__).parent


@pytest.mark.parametrize(
    ("call", "why"),
    [
        (lambda v: dlgmd_cli.batch(v, out="x"), "SourceError: .*there is no video"),
        (lambda v: dlgmd_cli.batch(v, brake="px4"), "ParameterError: brake works only with"),
        (lambda v: dlgmd_cli.batch(v, []), "ParameterError: the list of models is empty"),
        (lambda v: dlgmd_cli.batch(v, scael=0.5), "ParameterError: there is no option 'scael'"),
        (lambda v: dlgmd_cli.evaluate("gone.csv"), "ResultError: .*this file is missing"),
        (lambda v: dlgmd_cli.evaluate("l.csv", results="x", model=9), "does not work with results"),
        (lambda v: dlgmd_cli.evaluate("l.csv", speed_m_s=0), "ParameterError: speed_m_s: "),
        (lambda v: dlgmd_cli.evaluate("l.csv"), "SourceError: .*no video could be scored"),
        (lambda v: dlgmd_cli.calibrate("l.csv", folds=1), "ParameterError: folds = 1"),
        (lambda v: dlgmd_cli.calibrate("l.csv", 9, normalise="sequence"), "no threshold"),
        (lambda v: dlgmd_cli.calibrate("l.csv", "by-sequence.yaml"), "no threshold"),
        (lambda v: dlgmd_cli.layers("gone.mp4"), "SourceError: .*no such file"),
        (
            lambda v: dlgmd_cli.layers(looming_frames(), frames=[99]),
            "none of the 20 frames that were processed is frame 99;",
        ),
        (
            lambda v: dlgmd_cli.layers(looming_frames(), [5, 9]),
            r"layers\(video, 9, frames=\[50, 65\]\)",
        ),
        (lambda v: dlgmd_cli.sweep(x="r=2,3", y="a=1", fps=5), "fps works only with an INPUT"),
        (lambda v: dlgmd_cli.sets("gone"), "there is no set, preset, model or file 'gone'"),
        (lambda v: dlgmd_cli.sets(9, "x.gif"), "plot: 'x.gif' is no figure. Write kernels.png"),
        (lambda v: dlgmd_cli.sets("lgmd").plot(), "only the D-LGMD model has kernels, not lgmd"),
        (lambda v: dlgmd_cli.export(size="8x8"), "size: 8x8 is out of range"),
        (lambda v: dlgmd_cli.synth("looming-cube", distanc=3), "looming-cube has no such option"),
        (lambda v: dlgmd_cli.read_result("str"), "no such folder. Run 'dlgmd run' first."),
        (lambda v: dlgmd_cli.read_result(9), "not int"),
        (lambda v: dlgmd_cli.DLGMD(9), r"DlgmdParameters, not 9. Write load_set\(9\)"),
        (lambda v: dlgmd_cli.LGMD(dlgmd_cli.load_set(9)), "LgmdParameters, not DlgmdParameters"),
        (lambda v: dlgmd_cli.Alarm("10"), "there is no set 10. Choose 1 to 9"),
        (lambda v: dlgmd_cli.run("x.mp4", fbs=9), "there is no option 'fbs'. Choose from scale"),
        (lambda v: dlgmd_cli.open_video(None), "expected a path or images, not NoneType"),
        (lambda v: dlgmd_cli.open_video("x.mp4", decoder="vlc"), "no decoder 'vlc'"),
    ],
)
def test_errors_are_the_library_s(dlgmd, tmp_path, call, why):
    (tmp_path / "empty").mkdir()
    (tmp_path / "l.csv").write_text("video,collision_frame\ngone.mp4,3\n")
    (tmp_path / "by-sequence.yaml").write_text("set: 9\noptions:\n  normalise: sequence\n")
    with pytest.raises(DlgmdError) as caught:
        call("empty")
    assert re.search(why, f"{type(caught.value).__name__}: {caught.value}")
    assert not Path("x").exists()


def test_public_names_are_declared_for_type_checkers_and_are_no_modules():
    tree = ast.parse((ROOT / "__init__.py").read_text(encoding="utf-8"))
    declared = {
        alias.asname: node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("dlgmd_cli.")
        for alias in node.names
    }
    assert declared.keys() == {*dlgmd_cli.__all__}
    for name, home in declared.items():
        assert getattr(dlgmd_cli, name) is getattr(import_module(home), name)
    modules = {path.stem for path in ROOT.iterdir()}
    assert not modules & {*dlgmd_cli.__all__}, "importing it would hide the function"


def test_the_model_is_the_second_argument_and_has_a_short_name():
    for function in (
        *(dlgmd_cli.run, dlgmd_cli.compare, dlgmd_cli.batch, dlgmd_cli.evaluate),
        *(dlgmd_cli.calibrate, dlgmd_cli.layers, dlgmd_cli.sweep),
    ):
        second = [*inspect.signature(function).parameters.values()][1]
        assert second.name == "model" and second.default is None
        assert "ModelName" in str(second) and "PathLike" not in str(second)


@pytest.mark.parametrize("name", ["run", "batch", "compare", "layers", "evaluate", "calibrate"])
def test_a_function_takes_what_its_command_takes(name):
    options = {option.name for option in cli.get_command(None, name).params}
    common = options & RUN_ARGUMENTS.keys()
    assert len(common) >= 4
    assert common <= inspect.signature(getattr(dlgmd_cli, name)).parameters.keys()


def test_numbers_have_the_defaults_of_the_commands():
    compared = {}
    for name in sorted({*dlgmd_cli.__all__} & {*COMMANDS}):
        options = {option.name: option.default for option in cli.get_command(None, name).params}
        for key, one in inspect.signature(getattr(dlgmd_cli, name)).parameters.items():
            has_default = isinstance(options.get(key), int | float | str)
            if type(one.default) in (int, float) and has_default:
                compared[name, key] = one.default, float(options[key])
    assert {key: ours for key, (ours, theirs) in compared.items() if ours != theirs} == {}
    assert ("evaluate", "react") in compared and len(compared) > 3


def test_sets_and_export_save_what_their_commands_write(runs, tmp_path):
    table = dlgmd_cli.sets().table
    assert table["set"].tolist() == [*"123456789"] and table["sigma_e"][8] == 1.5
    nine = dlgmd_cli.sets(9)
    assert nine.record_text() == runs("sets", 9).stdout
    assert "sigma_e" in nine.table["key"]
    nine.save("nine")
    assert dlgmd_cli.load_config("nine/parameters.yaml").values == nine.params.to_dict()
    runs("export", "--size", "16x16", "--alarm", "spikes", "--out", "its")
    exported = dlgmd_cli.export(out="mine", size="16x16", alarm="spikes")
    its = {path.name: path.read_bytes() for path in (tmp_path / "its").iterdir()}
    assert exported.contents == its
    assert {path.name: path.read_bytes() for path in (tmp_path / "mine").iterdir()} == its
