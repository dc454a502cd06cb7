"""`dlgmd plot`: its files, options, errors and exit codes."""

import os
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from test_plots import make_result
from test_read_results import compare_csv

from dlgmd_cli.commands import plot as plot_module
from dlgmd_cli.commands._labels import numbered, told_apart
from dlgmd_cli.plots import overlays, overview
from dlgmd_cli.results.tables import write_tables

KINDS = ("mp", "attenuation", "spikes", "overview")
ROWS = ("set9,0,0,1,0.5,0.25,-3", "set9,1,0.1,1,0.6,0.5,-4", "lgmd,0,0,1,0.5,0.25,-3")


def make_run(path, **changes):
    os.makedirs(path)
    write_tables(Path(path), [replace(make_result(), **changes)])
    Path(path, "run.yaml").write_text("complete: true\n")
    return path


def make_comparison(path, *rows):
    os.makedirs(path, exist_ok=True)
    return compare_csv(Path(path, "compare.csv"), *(rows or ROWS))


@pytest.fixture
def drawn(monkeypatch):
    """What the command hands to the function that draws: results, annotations, options."""
    calls = []

    def record(draw, results, annotations, **options):
        calls.append((results, annotations, options))
        return draw(results, annotations, **options)

    for module, name in (
        (overlays, "overlay_mp"),
        (overlays, "overlay_attenuation"),
        (overlays, "overlay_spikes"),
        (overview, "plot_overview"),
    ):
        monkeypatch.setattr(module, name, partial(record, getattr(module, name)))
    return calls


@pytest.mark.parametrize("kind", KINDS)
def test_one_short_command_makes_a_figure(dlgmd, kind):
    make_run("dlgmd-out/flight")
    result = dlgmd("plot", kind, "dlgmd-out/flight")
    assert result.exit_code == 0, result.output
    path = os.path.join("dlgmd-out", f"{kind}-flight.png")
    assert result.stdout == f"{path}\n" and result.stderr == ""
    assert Path(path).read_bytes().startswith(b"\x89PNG")
    assert sorted(os.listdir("dlgmd-out")) == sorted(["flight", f"{kind}-flight.png"])


def test_what_run_wrote_is_drawn_as_run_drew_it(dlgmd, clips, drawn):
    assert dlgmd("run", clips / "loom.avi").exit_code == 0
    for kind, label in (("mp", "MP"), ("attenuation", "attenuation"), ("spikes", "MP")):
        assert dlgmd("plot", kind, "dlgmd-out/loom", "--label", label).exit_code == 0
        again, first = Path(f"dlgmd-out/{kind}-loom.png"), Path(f"dlgmd-out/loom/{kind}.png")
        assert again.stat().st_size == pytest.approx(first.stat().st_size, rel=0.01)
        assert list(drawn[-1][0]) == [label]


def test_options_reach_the_figure(dlgmd, drawn):
    make_run("a/one"), make_run("a/two")
    options = ["--mark", "4:pitching", "--span", "4-7:accelerating", "--collision-frame", 12]
    options += ["--false-positive-frame", 5, "--width", "two", "--label", "9", "--label", "$"]
    assert dlgmd("plot", "mp", "a/one", "a/two", *options, "--normalise", "sequence").exit_code == 0
    results, annotations, given = drawn[-1]
    assert list(results) == ["9", "$"] and given == {"column": "mp_seq", "width": "two"}
    assert annotations.marks == ((4, "pitching"),)
    assert annotations.spans == ((4, 7, "accelerating"),)
    assert (annotations.collision_frame, annotations.false_positive_frame) == (12, 5)
    for arguments, column in (([], "level"), (["--normalise", "absolute"], "mp_abs")):
        assert dlgmd("plot", "overview", "a/one", *arguments, "--overwrite").exit_code == 0
        assert drawn[-1][2] == {"column": column, "width": "one"}


def test_where_it_goes(dlgmd):
    make_run("one"), make_run("two")
    both = ["plot", "mp", "one", "two"]
    for arguments, paths in (
        ([], ["dlgmd-out/mp-one-two.png"]),
        (["--out", "figures"], ["figures/mp-one-two.png"]),
        (["--out", "sub/fig.pdf"], ["sub/fig.pdf"]),
        (["--out", "FIG.SVG", "--format", "svg"], ["FIG.SVG"]),
        (
            ["--out", "o", "--format", "svg", "--format", "pdf", "--format", "svg"],
            ["o/mp-one-two.svg", "o/mp-one-two.pdf"],
        ),
        (["--out", "v1.5"], ["v1.5/mp-one-two.png"]),
    ):
        result = dlgmd(*both, *arguments)
        assert result.exit_code == 0, result.output
        assert result.stdout.split() == [os.path.normpath(path) for path in paths]
        for path in paths:
            start = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[path[-3:].lower()]
            assert Path(path).read_bytes().startswith(start)
    assert not [name for name in os.listdir(".") if name.startswith(".dlgmd")]


def test_pdf_and_svg_hold_no_dates(dlgmd):
    make_run("one")
    for name in ("a.pdf", "b.PDF", "c.svg", "d.SVG"):
        assert dlgmd("plot", "mp", "one", "--out", name).exit_code == 0
    for one, other in (("a.pdf", "b.PDF"), ("c.svg", "d.SVG")):
        assert Path(one).read_bytes() == Path(other).read_bytes()
        assert b"CreationDate" not in Path(other).read_bytes()
        assert b"dc:date" not in Path(other).read_bytes()


def test_what_stands_there_is_kept_unless_told_otherwise(dlgmd):
    make_run("one")
    Path("fig.png").write_text("mine")
    result = dlgmd("plot", "mp", "one", "--out", "fig.png")
    assert result.exit_code == 2 and Path("fig.png").read_text() == "mine"
    assert result.stderr == (
        "Error: fig.png: it stands here already. Add --overwrite to replace it.\n"
    )
    assert dlgmd("plot", "mp", "one", "--out", "fig.png", "--overwrite").exit_code == 0
    assert Path("fig.png").read_bytes().startswith(b"\x89PNG")
    os.mkdir("folder.png")
    assert dlgmd("plot", "mp", "one", "--out", "folder.png", "--overwrite").exit_code == 2


def test_an_output_that_cannot_be_written(dlgmd):
    make_run("one")
    Path("file").write_text("")
    result = dlgmd("plot", "mp", "one", "--out", "file/sub")
    assert result.exit_code == 1 and result.stdout == ""
    assert "it cannot be written" in result.stderr and result.stderr.count("\n") == 1


def test_long_names_are_cut(dlgmd):
    names = [f"{place}{'ü' * 80}" for place in range(4)]
    for name in names:
        make_run(name)
    assert dlgmd("plot", "mp", *names).exit_code == 0
    (path,) = os.listdir("dlgmd-out")
    assert path.startswith("mp-0ü") and 60 < len(path) <= len("mp-.png") + 100
    make_run("你" * 80)
    assert dlgmd("plot", "mp", "你" * 80, names[0]).exit_code == 0


USAGE = {
    "no result": (["mp"], "Missing argument 'RESULT...'."),
    "kind": (
        ["layers", "one"],
        "'layers' is not one of 'mp', 'attenuation', 'spikes', 'overview'.",
    ),
    "mark": (["mp", "one", "--mark", "x"], "'x' is not FRAME:TEXT. Write 40:pitching."),
    "width": (["mp", "one", "--width", "three"], "'three' is not one of 'one', 'two'."),
    "fewer labels": (
        ["mp", "one", "one", "--label", "a"],
        "--label is given 1 time, for 2 results.",
    ),
    "more labels": (
        ["mp", "one", "--label", "a", "--label", "b"],
        "--label is given 2 times, for 1 result.",
    ),
    "no label": (["mp", "one", "--label", " "], "--label: a label may not be empty."),
    "same labels": (
        ["mp", "one", "one", "--label", "a", "--label", "a"],
        "--label: two results may not have the same label.",
    ),
    "formats": (
        ["mp", "one", "--out", "a.pdf", "--format", "png"],
        "--out ends in .pdf, and --format says otherwise. Give one of them.",
    ),
    "normalise": (
        ["attenuation", "one", "--normalise", "sequence"],
        "--normalise is for mp and overview, not for attenuation.",
    ),
}


@pytest.mark.parametrize(("arguments", "message"), USAGE.values(), ids=USAGE)
def test_wrong_usage(dlgmd, arguments, message):
    make_run("one")
    result = dlgmd("plot", *arguments)
    assert result.exit_code == 2 and result.stderr.splitlines()[-1].endswith(message)
    assert os.listdir(".") == ["one"]


def test_drawing_needs_no_decoder():
    program = (
        "import sys, dlgmd_cli.commands.plot, dlgmd_cli.plots.overview, dlgmd_cli.results.read"
    )
    done = subprocess.run(
        [sys.executable, "-c", f"{program}\nprint({{'av', 'cv2', 'yaml'}} & set(sys.modules))"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout == "set()\n"


DAMAGES = {
    "nothing there": (None, "there is no such folder or file. Give one that 'dlgmd run' wrote."),
    "no result": (lambda folder: folder.mkdir(), "there is no result in this folder."),
    "escapes": ("bad\x1b[31m\n", "bad\\x1b[31m\\n: there is no such folder or file."),
    "half": (
        lambda folder: (make_run(folder), (folder / "spikes.csv").unlink()),
        "spikes.csv: this file is missing",
    ),
    "only the record": (
        lambda folder: (folder.mkdir(), (folder / "run.yaml").write_text("")),
        "mp.csv: this file is missing",
    ),
    "binary": (
        lambda folder: (make_run(folder), (folder / "mp.csv").write_bytes(b"\xff\xd8" * 999)),
        "mp.csv: it cannot be read (it is no table of text)",
    ),
    "comparison": (lambda folder: make_comparison(folder, "a,b"), "line 2: it has not 7 cells"),
}


@pytest.mark.parametrize(("damage", "message"), DAMAGES.values(), ids=DAMAGES)
def test_a_damaged_result_is_one_line(dlgmd, damage, message):
    make_run("good")
    bad = damage if isinstance(damage, str) else "bad"
    if callable(damage):
        damage(Path("bad"))
    for order in (["good", bad], [bad, "good"]):
        result = dlgmd("plot", "overview", *order)
        assert result.exit_code == 1 and result.stdout == ""
        assert result.stderr.startswith("Error: bad") and message in result.stderr
        assert result.stderr.count("\n") == 1
        assert not os.path.exists("dlgmd-out")


def test_annotations_beside_the_data_are_warned_of_and_lose_nothing(dlgmd):
    make_run("one")
    arguments = ["--mark", "90:late\x1b", "--span", "30-50:long", "--collision-frame", 39]
    result = dlgmd("plot", "mp", "one", *arguments)
    assert result.exit_code == 0 and result.stdout
    assert result.stderr.splitlines() == [
        "Warning: 'late\\\\x1b' at frame 90 is not on the frames 0 to 39 and is left out.",
        "Warning: 'long' at frames 30 to 50 is cut off at the frames 0 to 39.",
    ]


def test_letters_that_the_font_lacks_are_one_warning(dlgmd):
    make_run("one")
    result = dlgmd("plot", "mp", "one", "--label", "飛行", "--mark", "4:左")
    assert result.exit_code == 0 and result.stdout
    assert result.stderr == (
        "Warning: the figure's font lacks some letters of the texts, "
        "and shows boxes in their place.\n"
    )
    result = dlgmd("plot", "mp", "one", "--label", "Zürich → Σ", "--overwrite")
    assert result.exit_code == 0 and result.stderr == ""


def test_results_are_named_after_their_folders(dlgmd, drawn):
    make_run("a/x/flight"), make_run("b/x/flight"), make_run("b/other")
    for paths, names in (
        (["b/other", "a/x/flight/"], ["other", "flight"]),
        (["a/x/flight", "b/x/flight"], ["a/x/flight", "b/x/flight"]),
        (["b/other", "b/../b/other"], ["other", "other (2)"]),
    ):
        assert dlgmd("plot", "mp", *paths, "--overwrite").exit_code == 0
        assert list(drawn[-1][0]) == names


def test_names_are_told_apart():
    assert told_apart([Path("/a/b"), Path("/c/b"), Path("/c/d")]) == ["a/b", "c/b", "d"]
    assert told_apart([Path("/b"), Path("/a/b")]) == ["//b", "a/b"] or os.name == "nt"
    assert numbered(["a", "a", "a (2)", "a"]) == ["a", "a (2)", "a (2) (2)", "a (3)"]


def test_a_comparison_has_labels_of_its_own(dlgmd, drawn):
    make_comparison("cmp/one"), make_comparison("cmp/two"), make_run("set9")
    for paths, names, file in (
        (["cmp/one"], ["set9", "lgmd"], "mp-one"),
        (["cmp/one/compare.csv"], ["set9", "lgmd"], "mp-one"),
        (["cmp/one", "set9"], ["set9", "lgmd", "set9 (2)"], "mp-one-set9"),
        (
            ["cmp/one", "cmp/two/compare.csv"],
            ["one: set9", "one: lgmd", "two: set9", "two: lgmd"],
            "mp-one-two",
        ),
    ):
        result = dlgmd("plot", "mp", *paths, "--overwrite")
        assert result.exit_code == 0 and result.stderr == ""
        assert list(drawn[-1][0]) == names
        assert result.stdout.strip() == os.path.join("dlgmd-out", f"{file}.png")
    os.rename("cmp/two/compare.csv", "cmp/mine.csv")
    result = dlgmd("plot", "attenuation", "cmp/mine.csv", "--label", "a", "--label", "b")
    assert result.exit_code == 0 and list(drawn[-1][0]) == ["a", "b"]
    assert result.stdout.strip() == os.path.join("dlgmd-out", "attenuation-mine.png")


def test_a_run_goes_before_a_comparison_in_the_same_folder(dlgmd, drawn):
    make_run("both"), make_comparison("both")
    result = dlgmd("plot", "mp", "both")
    assert result.exit_code == 0 and list(drawn[-1][0]) == ["both"]
    given = os.path.join("both", "compare.csv")
    assert result.stderr == f"Drawing the run in both; give {given} for the comparison.\n"
    assert drawn[-1][0]["both"].has_spikes
    assert dlgmd("plot", "mp", "both/compare.csv", "--overwrite").exit_code == 0
    assert list(drawn[-1][0]) == ["set9", "lgmd"]


def test_a_comparison_has_no_spikes(dlgmd):
    make_comparison("cmp"), make_run("run")
    result = dlgmd("plot", "spikes", "cmp")
    assert result.exit_code == 1 and result.stderr == (
        "Error: cmp: a comparison holds no spikes. "
        "Draw its mp or attenuation, or the spikes of a run.\n"
    )
    for kind, paths in (("overview", ["cmp"]), ("spikes", ["cmp", "run"])):
        result = dlgmd("plot", kind, *paths)
        assert result.exit_code == 0
        assert result.stderr == (
            "Warning: no spikes are drawn of set9, lgmd: a comparison holds none.\n"
        )


def test_a_still_scene_and_a_single_frame_are_no_errors(dlgmd):
    nothing = np.full(40, np.nan)
    make_run("still", level=nothing, attenuation_db=nothing, mp_seq=nothing)
    make_run("short", **{key: value[:1] for key, value in vars(make_result()).items()})
    for kind in KINDS:
        for paths in (["still"], ["short"], ["still", "short"]):
            result = dlgmd("plot", kind, *paths)
            assert result.exit_code == 0 and result.stderr == "", result.output


def test_a_bug_is_one_line_too(dlgmd, monkeypatch):
    make_run("one")
    monkeypatch.setattr(plot_module, "_write", lambda *_: 1 / 0)
    result = dlgmd("plot", "mp", "one")
    assert result.exit_code == 1 and result.stderr.startswith("Error: internal error (ZeroDivision")
    assert not os.listdir("dlgmd-out")


def test_one_file_of_a_result_is_not_it(dlgmd):
    make_run("one")
    result = dlgmd("plot", "mp", "one/mp.csv")
    assert result.exit_code == 1
    assert "it is one file of a result. Give the folder that holds it." in result.stderr


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_not_waited_for(dlgmd, tmp_path):
    make_run("one")
    os.unlink("one/mp.csv")
    os.mkfifo("one/mp.csv")
    os.mkfifo("pipe.csv")
    for path in ("one", "pipe.csv"):
        # A process of its own, which can be given up.
        done = subprocess.run(
            [sys.executable, "-m", "dlgmd_cli", "plot", "mp", path],
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=30,
        )
        assert done.returncode == 1 and "it is not a file" in done.stderr


def test_a_comparison_is_drawn_as_it_drew_itself(dlgmd, drawn):
    make_comparison("cmp"), make_run("run")
    for paths, options, column in (
        (["cmp"], [], "mp_seq"),
        (["cmp"], ["--normalise", "absolute"], "mp_abs"),
        (["cmp", "run"], [], "level"),
    ):
        result = dlgmd("plot", "mp", *paths, *options, "--overwrite")
        assert result.exit_code == 0 and drawn[-1][2]["column"] == column


def test_different_normalisations_are_warned_of(dlgmd):
    values = vars(make_result())
    make_run("absolute", mp_seq=values["level"] / 2), make_run("sequence", mp_seq=values["level"])
    line = "the results were normalised in different ways"
    assert line in dlgmd("plot", "mp", "absolute", "sequence", "--overwrite").stderr
    assert line not in dlgmd("plot", "attenuation", "absolute", "sequence").stderr
    assert (
        line
        not in dlgmd(
            "plot",
            "mp",
            "absolute",
            "sequence",
            "--label",
            "a",
            "--label",
            "b",
            "--normalise",
            "absolute",
            "--overwrite",
        ).stderr
    )
