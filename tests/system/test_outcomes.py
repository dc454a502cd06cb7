"""What every capability keeps: the command and the function write the same, and refuse the same."""

import csv
import json
import os
import re
import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import csv_rows, files_of, looming_frames, make_result, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli.errors import OutputError, OutputExistsError, ParameterError
from dlgmd_cli.machine.files import LOCK
from dlgmd_cli.models.base import Photoreceptors
from dlgmd_cli.results import store
from dlgmd_cli.results.files import DRAWN, names_of

pytestmark = pytest.mark.usefixtures("here")
# Large enough for the expansion to be measured.
SIZE = {"width": 64, "height": 48}
STILL = [looming_frames(1, **SIZE)[0]] * 12
AXES = {"x": "r=2,3", "y": "sigma_e=0.5:1.5:0.5", "jobs": 1}


@dataclass(frozen=True)
class Capability:
    """A command, the same by a function, its folder below --out, its files and its figures."""

    words: str
    call: Callable
    folder: str
    files: frozenset[str]
    figures: frozenset[str] = frozenset()
    tables: tuple = ()
    said: str = ""

    def command(self, out, *more, draws=True):
        words = self.words.split()
        if self.figures:
            words += ["--format", "svg"] if draws else ["--format=none"]
        return [*words, "--out", out, *more]


def capability(words, call, folder, files, figures="", **more):
    drawn = frozenset(f"{name}.svg" for name in figures.split())
    return Capability(words, call, folder, frozenset(files.split()), drawn, **more)


CAPABILITIES = {
    "run": capability(
        "run near.avi --set 9",
        lambda **how: dlgmd_cli.run("near.avi", 9, **how),
        "near",
        " ".join(names_of("run.yaml", ())),
        " ".join(DRAWN),
        said="<Result near.avi: 20 frames, set9, no alarm>",
    ),
    "compare": capability(
        "compare near.avi --set 3 --set 9",
        lambda **how: dlgmd_cli.compare("near.avi", [3, 9], **how),
        "near",
        "compare.yaml compare.csv",
        "compare-mp compare-attenuation",
        tables=[("table", "compare.csv")],
        said="<Comparison ",
    ),
    "layers": capability(
        "layers near.avi --set 9 --frames 3,9 --npz",
        lambda **how: dlgmd_cli.layers("near.avi", frames=[3, 9], model=9, npz=True, **how),
        "near",
        "layers.yaml layers.npz",
        "layers",
        said="<LayerResult near, set9: frames 3, 9>",
    ),
    "sweep": capability(
        "sweep near.avi --set 9 --x r=2,3 --y sigma_e=0.5:1.5:0.5 --jobs 1",
        lambda **how: dlgmd_cli.sweep("near.avi", model=9, **AXES, **how),
        "sweep-near",
        "sweep.yaml sweep.csv",
        "sweep",
        tables=[("table", "sweep.csv")],
        said="<SweepResult near: r (2) x sigma_e (3); ",
    ),
    "sweep of cubes": capability(
        "sweep --x r=2,3 --y sigma_e=0.5:1.5:0.5 --jobs 1 --size 64x48 --cube-size 10",
        lambda **how: dlgmd_cli.sweep(**AXES, size=(64, 48), cube_size=10.0, **how),
        "sweep-translating-cubes",
        "sweep.yaml sweep.csv",
        "sweep",
        tables=[("table", "sweep.csv")],
        said="<SweepResult translating-cubes: r (2) x sigma_e (3); ",
    ),
    "evaluate": capability(
        "evaluate labels.csv --set 3 --set 9 --param kappa=1e-4 --repeats keep --speed-m-s 0.5 "
        "--jobs 1",
        lambda **how: dlgmd_cli.evaluate(
            "labels.csv",
            [3, 9],
            **{"param": {"kappa": 1e-4}, "repeats": "keep", "speed_m_s": 0.5, "jobs": 1, **how},
        ),
        "",
        "evaluate.yaml evaluate.csv curves.csv alarms.csv ttc.csv auc.csv roc.csv",
        "evaluate-leads evaluate-ttc evaluate-roc",
        tables=[
            ("table", "evaluate.csv"),
            ("curve_table", "curves.csv"),
            ("alarm_table", "alarms.csv"),
            ("ttc_table", "ttc.csv"),
        ],
        said="<Evaluation on 3 videos, 2 contacts: set3 kappa=0.0001 recall",
    ),
    "calibrate": capability(
        "calibrate labels.csv --set 3 --jobs 1 --folds 2",
        lambda **how: dlgmd_cli.calibrate(
            "labels.csv", 3, jobs=1, folds=2, **{"formats": "png", **how}
        ),
        "",
        "calibrated.yaml calibrated.png",  # always drawn
        said="<Calibration of set3: ",
    ),
    "synth": capability(
        "synth looming-cube --size 64x48 --frames 12 --noise 0.01",
        lambda **how: dlgmd_cli.synth("looming-cube", size="64x48", frames=12, noise=0.01, **how),
        "",
        "looming-cube.avi looming-cube.csv",
        said="<RenderedClip looming-cube: 12 frames in mine",
    ),
}
# What writes a folder of its own is locked as a whole; what only has names in it, by these.
ALL, DRAWING = [*CAPABILITIES], [name for name, one in CAPABILITIES.items() if one.figures]
TELL = "run", "compare", "sweep", "evaluate", "calibrate"
each = pytest.mark.parametrize("name", ALL)


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    """Two clips in which something looms, and a still one; and labels."""
    folder = tmp_path_factory.mktemp("footage")
    write_video(folder / "near.avi", looming_frames(**SIZE))
    write_video(folder / "late.avi", [*STILL, *looming_frames(**SIZE)])
    write_video(folder / "still.avi", STILL)
    lines = ["video,collision_frame,target", "near.avi,19,box", "late.avi,31,", "still.avi,,"]
    (folder / "labels.csv").write_text("\n".join(lines))
    return folder


@pytest.fixture
def one(dlgmd, footage, monkeypatch, tmp_path, name):
    """A capability, in a folder with what it takes."""
    for path in footage.iterdir():
        os.link(path, tmp_path / path.name)
    return CAPABILITIES[name]


def same_numbers(table, path, but=()):
    """The table has the columns and, but for some, the numbers and the words of a CSV."""
    with open(path, encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    assert list(table.dtype.names) == names and len(table) == len(rows)
    for name in {*names} - {*but}:
        cells = [row[names.index(name)] for row in rows]
        if table[name].dtype.kind == "U":
            assert table[name].tolist() == cells, name
        else:
            expected = [float(text or "nan") for text in cells]
            np.testing.assert_allclose(table[name], expected, rtol=1e-8, err_msg=name)


def raise_of(text):
    raise ValueError(f"{text} is no JSON")


@pytest.mark.painted
@each
def test_the_function_writes_what_the_command_does(one, runs):
    runs(*one.command("its"), plots=True)
    its = files_of(Path("its") / one.folder)
    assert its.keys() == one.files | one.figures
    found = one.call(out="mine", **({"formats": "svg"} if one.figures else {}))
    assert files_of(Path("mine") / one.folder) == its
    assert repr(found).startswith(one.said or "<") and "\n" not in repr(found)
    for attribute, table in one.tables:
        same_numbers(getattr(found, attribute), Path("mine") / one.folder / table)
    with pytest.raises(ParameterError, match=r"Choose from|has no figure"):
        found.plot("nothing")
    if not one.figures:
        return
    # Saved later, it is the same. All are saved by one function; that it draws is seen once.
    formats = ["svg"] if one is CAPABILITIES["run"] else []
    found.save("saved", formats)
    assert files_of("saved") == {name: its[name] for name in its if formats or name in one.files}
    with pytest.raises(OutputExistsError, match="Add overwrite=True"):
        found.save("saved", ["svg"])
    found.save("saved", overwrite=True)
    assert files_of("saved").items() <= its.items()


@each
def test_what_is_there_is_replaced_only_if_that_is_asked_for(one, dlgmd, runs):
    """With --json, one object is told; without, the folder or its file."""
    folder, tells = Path("out") / one.folder, one.words.startswith(TELL)
    told = runs(*one.command("out", *(["--json"] if tells else []), draws=False)).stdout
    if tells:
        facts = json.loads(told, parse_constant=raise_of)
        assert isinstance(facts, dict) and facts.get("complete", True) is True and told.isascii()
    before = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()}
    again = dlgmd(*map(str, one.command("out", draws=False)))
    assert again.exit_code == 2 and re.search(r"already exists.* Add --overwrite", again.stderr)
    with pytest.raises(OutputExistsError, match="Add overwrite=True"):
        one.call(out="out")
    now = {path: (path.stat().st_mtime_ns, path.read_bytes()) for path in folder.iterdir()}
    assert now == before
    whole = files_of(folder)
    shown = Path(runs(*one.command("out", "--overwrite", draws=False)).stdout.splitlines()[-1])
    assert files_of(folder) == whole and (not tells or folder in (shown, shown.parent))


@each
def test_two_do_not_write_into_one_folder(one, dlgmd):
    folder = Path("out") / one.folder
    with store.locked(folder):
        refused = dlgmd(*map(str, one.command("out", draws=False)))
        with pytest.raises(OutputExistsError, match="another dlgmd command is writing here"):
            one.call(out="out")
        assert os.listdir(folder) == [LOCK]
    assert refused.exit_code == 2 and "another dlgmd command is writing here" in refused.stderr


@each
def test_a_place_that_cannot_be_written_is_one_line(one, dlgmd):
    Path("file").write_text("mine")
    refused = dlgmd(*map(str, one.command("file/out", draws=False)))
    assert refused.exit_code == 1 and "file" in refused.stderr
    errors = [line for line in refused.stderr.splitlines() if line.startswith("Error: ")]
    assert len(errors) == 1 and "cannot be written (" in errors[0]
    with pytest.raises(OutputError, match="cannot be written"):
        one.call(out="file/out")
    assert Path("file").read_text() == "mine"


@pytest.mark.parametrize("name", ["run", "compare", "layers"])
def test_files_of_others_are_left_alone(one, dlgmd):
    folder = Path("out") / one.folder
    folder.mkdir(parents=True)
    (folder / "notes.txt").write_text("mine")
    refused = dlgmd(*map(str, one.command("out", draws=False)))
    assert refused.exit_code == 2 and "contains other files, such as notes" in refused.stderr
    with pytest.raises(OutputExistsError, match="contains other files, such as notes"):
        one.call(out="out")
    with pytest.raises(OutputExistsError, match="contains other files, such as notes"):
        one.call().save(folder)
    assert os.listdir(folder) == ["notes.txt"]


@pytest.mark.parametrize("name", [n for n in ALL if n not in ("run", "compare")])
def test_an_interrupt_before_the_beginning_writes_nothing(one, dlgmd, stop):
    stop()
    ended = dlgmd(*map(str, one.command("out", draws=False)))
    assert ended.exit_code == 130 and ended.stderr.splitlines()[-1] == "Interrupted."
    assert not Path("out").exists()


# A command, in which call of what it stops, after how many frames, and what is kept of them.
STOPS = [
    ("run", (8,), 8, "the 8 frames processed"),
    # In the first model's 12th frame; the second one's is the 24th call.
    ("compare", (23, Photoreceptors, "take"), 12, "the 12 frames processed"),
    ("layers", (8,), 8, "1 of 2 frames"),
]


@pytest.mark.parametrize(("name", "call", "n_frames", "kept"), STOPS)
def test_a_stop_keeps_what_was_computed(one, call, n_frames, kept, dlgmd, stop_at):
    stop_at(*call)
    ended = dlgmd(*one.command("out"))
    folder = Path("out") / one.folder
    (line,) = ended.stderr.splitlines()
    assert ended.exit_code == 130 and line.startswith(f"Interrupted. {folder} holds {kept}")
    assert {path.name for path in folder.iterdir()} == one.files | one.figures
    (record,) = map(yaml_of, folder.glob("*.yaml"))
    assert record["complete"] is False and record["input"]["frames"] == n_frames
    for table in {"mp.csv", "compare.csv"} & one.files:
        n_rows = Counter(row.get("label") for row in csv_rows(folder / table))
        assert {*n_rows.values()} == {n_frames}


@pytest.mark.parametrize("name", DRAWING)
def test_figures_of_a_format_that_there_is_not_are_refused_at_once(one):
    shutil.rmtree("near.avi", ignore_errors=True)
    with pytest.raises(ParameterError, match="there is no format 'jpg'"):
        one.call(formats=["jpg"], out="out")
    assert not Path("out").exists()


@pytest.mark.parametrize("name", DRAWING)
def test_a_figure_that_cannot_be_drawn_costs_no_numbers(one, dlgmd, monkeypatch):
    def fail(*arguments, **options):
        raise RuntimeError("no figure today")

    monkeypatch.setattr("dlgmd_cli.plots.style.save_figure", fail)
    result = dlgmd(*map(str, one.command("out")))
    assert result.exit_code == 1 and "internal error" not in result.stderr, result.output
    assert "cannot be drawn (no figure today)" in result.stderr
    assert {path.name for path in (Path("out") / one.folder).iterdir()} == one.files


# A command, and options that its record keeps, so that the record repeats it.
RECORDED = [
    (
        "run",
        "--set 5 --param sigma_e=0.5 --param formulation=equations --scale 0.75 --fps 12.5 "
        "--start 0.1 --end 00:00:00.7 --normalise sequence --decoder pyav",
    ),
    ("run", "--set 4 --crop 24x20+4+2 --mask mask.png --repeats keep"),
    ("run", "--set flight --fov 100 --camera-tilt 5"),
    ("layers", "--set 5 --param r=3 --end 0.7"),
    ("sweep", "--set 5 --param a=1.2 --size 24x18"),
]


@pytest.mark.parametrize(("name", "options"), RECORDED)
def test_a_record_repeats_what_it_is_of(one, options, runs):
    if "pyav" in options:
        pytest.importorskip("av", reason="one of the options is --decoder pyav")
    cv2.imwrite("mask.png", np.tri(20, 24, dtype=np.uint8) * 255)
    words = one.words.replace(" --set 9", "").split()
    runs(*words, *options.split(), "--out", "first")
    first = Path("first") / one.folder
    (record,) = first.glob("*.yaml")
    runs(*words, "--config", record, "--out", "again")
    assert files_of(Path("again") / one.folder) == files_of(first)


# Commands that write a file whose name is given, and such a name.
NAMED = [
    ("layers near.avi --set 9 --end 0.3 --video", "film.mp4"),
    ("plot mp one --out", "fig.png"),
    ("view one --no-film --out", "page.html"),
]


@pytest.mark.painted
@pytest.mark.parametrize(("words", "file"), NAMED)
def test_a_file_that_is_named_is_kept_unless_told_otherwise(words, file, dlgmd, runs, footage):
    for package in ("jinja2", "plotly") if words.startswith("view") else ():
        pytest.importorskip(package, reason="pages need it")
    os.link(footage / "near.avi", "near.avi")
    make_result(np.arange(9.0)).save("one")
    command, path = words.split(), Path(file)
    path.write_text("mine")
    refused = dlgmd(*command, file)
    assert refused.exit_code == 2 and path.read_text() == "mine"
    assert refused.stderr == f"Error: {file}: already exists. Add --overwrite to replace it.\n"
    runs(*command, file, "--overwrite", plots=True)
    assert path.stat().st_size > 100
    # A place that cannot be written is refused before it takes long.
    below = os.path.join(file, file)
    refused = dlgmd(*command, below)
    assert refused.exit_code == 1 and refused.stdout == ""
    assert refused.stderr.startswith("Error: ") and refused.stderr.count("\n") == 1
    assert f"another {command[-1]}" in refused.stderr


# What only some can do.


@pytest.mark.parametrize("name", ["evaluate"])
def test_batch(one, dlgmd, runs, monkeypatch):
    folder = Path("in")
    folder.mkdir()
    for video in Path().glob("*.avi"):
        video.rename(folder / video)
    runs("batch", folder, "--set", 9, "--model", "lgmd", "--jobs", 1)
    found = dlgmd_cli.batch(folder, [9, "lgmd"], out="mine", jobs=1)
    assert found.complete and set(found.statuses.values()) == {"done"}
    for label in ("set9", "lgmd"):
        own = found.table[found.table["model"] == label]
        columns = [name for name in own.dtype.names if name != "model"]
        same_numbers(own[columns], f"mine/{label}/summary.csv")
        # Warnings of the command name options in place of arguments.
        but = ["wall_s", "warnings"]
        same_numbers(own[columns], f"dlgmd-out/{label}/summary.csv", but=but)
    assert repr(found) == "<Batch of 3 videos with set9, lgmd: 3 done>"
    again = dlgmd_cli.batch([folder / "near.avi"], model=9, out="mine/set9", dry_run=True)
    assert not any(again.to_do.values())
    with pytest.raises(OutputExistsError):
        dlgmd_cli.batch(folder, model=9, param={"r": 3}, out="mine/set9")
    with pytest.raises(ParameterError, match="there is no format 'jpg'"):
        dlgmd_cli.batch("gone.mp4", formats=["jpg"])
    monkeypatch.setattr("dlgmd_cli.plots.style.save_figure", None)
    undrawn = dlgmd(
        "batch", folder / "near.avi", "--jobs", 1, "--format", "svg", "--out", "undrawn"
    )
    assert undrawn.exit_code == 1
    assert ",done,,mp.svg cannot be drawn" in Path("undrawn/summary.csv").read_text()


@pytest.mark.parametrize("name", ["calibrate"])
def test_a_calibration_is_a_preset_and_parameters(one, runs):
    facts = json.loads(runs(*one.command("its", "--json")).stdout)
    found = one.call()
    assert found.preset == Path("its/calibrated.yaml").read_text("utf-8")
    assert found.params.kappa == facts["parameters"]["kappa"]
    assert found.scores["held_out"]["all"]["recall"] == facts["held_out"]["recall"]
    assert "held out recall" in repr(found)
    assert dlgmd_cli.run("near.avi", model=found.params).params == found.params


@pytest.mark.parametrize("name", ["layers"])
def test_a_film_of_layers_that_were_not_run_to_the_end(one, runs):
    runs("layers", "near.avi", "--set", 9, "--end", 0.3, "--video", "its.mp4")
    found = dlgmd_cli.layers("near.avi", frames=[3], model=9, end=0.3)
    assert found.film("mine.mp4") == 8
    assert Path("mine.mp4").read_bytes() == Path("its.mp4").read_bytes()
    images = dlgmd_cli.layers(looming_frames(), frames=[], model=9, fps=25)
    assert images.film("images.mp4", overlay=True) == 20
    with pytest.raises(OutputExistsError):
        images.film("mine.mp4")
    with pytest.raises(AttributeError, match="no attribute 'g'"):
        images.g  # noqa: B018


@pytest.mark.parametrize("name", ["synth"])
def test_synth_in_memory_is_the_lossless_video(one, runs):
    runs(*one.command("its"))
    clip = dlgmd_cli.synth("looming-cube", size=(64, 48), frames=12, noise=0.01)
    same_numbers(clip.truth, "its/looming-cube.csv")
    stored = dlgmd_cli.run("its/looming-cube.avi", model=9, repeats="keep")
    assert clip.fps == 30 and clip.frames.shape == (len(stored), 48, 64)
    np.testing.assert_allclose(dlgmd_cli.run(clip.frames, fps=30, model=9).mp, stored.mp, rtol=1e-6)
