"""`dlgmd plot`: its files, options, errors and exit codes."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from conftest import csv_rows
from figures import make_result, write_comparison
from matplotlib.figure import Figure

from dlgmd_cli import read_result
from dlgmd_cli.plots import traces

ROWS = ("set9,0,0,1,0.5,0.25,-3", "set9,1,0.1,1,0.6,0.5,-4", "lgmd,0,0,1,0.5,0.25,-3")


def make_run(path, result=None, **options):
    (result or make_result(**options)).save(path)
    return path


def make_comparison(path, *rows):
    return write_comparison(Path(path), *(rows or ROWS))


@pytest.fixture
def drawn(monkeypatch):
    """What the command hands to the function that draws: kind, results, annotations, options.

    Without the name of the model, which all of these results have in their titles.
    """
    calls = []

    def short(name):
        return name and name.removesuffix(" · dlgmd")

    def record(kind, results, annotations, **options):
        for key in ("collisions", "emphasise"):
            given = options[key]
            options[key] = (
                {short(k): v for k, v in given.items()} if key[0] == "c" else short(given)
            )
        calls.append((kind, {short(k): one for k, one in results.items()}, annotations, options))
        return Figure(figsize=(1, 1))

    monkeypatch.setattr(traces, "plot", record)
    return calls


@pytest.mark.painted
@pytest.mark.parametrize("kind", ["ttc", "overview"])
def test_one_short_command_makes_a_figure(runs, kind):
    make_run("dlgmd-out/flight")
    result = runs("plot", kind, "dlgmd-out/flight")
    path = os.path.join("dlgmd-out", f"{kind}-flight.png")
    assert result.stdout == f"{path}\n" and result.stderr == ""
    assert Path(path).read_bytes().startswith(b"\x89PNG")
    assert sorted(os.listdir("dlgmd-out")) == sorted(["flight", f"{kind}-flight.png"])


def test_results_are_aligned_by_a_table_of_labels(dlgmd, runs):
    for name in "ab":
        make_run(f"out/{name}")
    Path("labels.csv").write_text("video,collision_frame\nflight.mp4,20\n")
    path = read_result("out/a").record["input"]["path"]
    Path("labels.csv").write_text(f"video,collision_frame\n{path},20\n")
    align = ("plot", "mp", "out", "--align", "collision", "--labels", "labels.csv")
    made = runs(*align, "--mean", "--xlim", "0:0.3", "--out", "x")
    paths = [os.path.join("x", name) for name in ("mp-aligned-out.png", "aligned.csv")]
    assert made.stdout.splitlines() == paths and not made.stderr
    rows, one = csv_rows("x/aligned.csv"), read_result("out/a")
    assert [*rows[0]] == ["model", "time_to_collision_s", "mean", "sem", "n", "a", "b"]
    at_s = np.array([float(row["time_to_collision_s"]) for row in rows])
    for key in ("mean", "a", "b"):  # each curve whole, as drawn; both runs are the same
        values = np.interp(one.time_s[20] - at_s, one.time_s, one.level)
        np.testing.assert_allclose([float(row[key] or "nan") for row in rows], values, atol=1e-6)
    assert {(row["sem"], row["n"]) for row in rows} == {("0", "2")}
    for more, why in (
        (("--mark", "3:x"), "--mark does not work with --align"),
        (("--emphasise", "a"), "--emphasise does not work with --align"),
        (("--one-panel",), "--one-panel does not work with --align"),
    ):
        refused = dlgmd(*align, *more)
        assert refused.exit_code == 2 and why in refused.stderr


def test_figures_name_the_model_unless_the_label_does(runs, monkeypatch):
    shown = []

    def record(_, results, *__, **___):
        shown.append([*results])
        return Figure(figsize=(1, 1))

    monkeypatch.setattr(traces, "plot", record)
    make_run("one"), make_run("dlgmd-9")
    for more in ([], ["--label", "a", "--label", "b"]):
        runs("plot", "mp", "one", "dlgmd-9", *more, "--overwrite")
    assert shown == [["one · dlgmd", "dlgmd-9"], ["a", "b"]]


@pytest.mark.painted
def test_options_reach_the_figure(runs, drawn):
    make_run("a/one"), make_run("a/two")
    options = ["--mark", "4: at 12:30: a turn ", "--mark", "5:\x1b[31mred\nnext"]
    options += ["--span", "4-7:accelerating", "--span", "3-3:blink", "--collision-frame", 12]
    options += ["--width", "two", "--label", "9", "--label", "$"]
    runs("plot", "mp", "a/one", "a/two", *options, "--normalise", "sequence", "--one-panel")
    kind, results, annotations, given = drawn[-1]
    look = dict.fromkeys(("emphasise", "until", "xlim", "ylim")) | {"collisions": {}}
    assert list(results) == ["9", "$"]
    assert given == {"column": "mp_seq", "width": "two", "one_panel": True, **look}
    # What a terminal would act on becomes an escape.
    marks = ((4, "at 12:30: a turn"), (5, "\\x1b[31mred\\nnext"))
    assert kind == "mp" and annotations.marks == marks
    assert annotations.spans == ((4, 7, "accelerating"), (3, 3, "blink"))
    assert annotations.collision_frame == 12
    for arguments, column in (([], "level"), (["--normalise", "absolute"], "mp_abs")):
        runs("plot", "overview", "a/one", *arguments, "--overwrite")
        assert drawn[-1][3] == {"column": column, "width": "one", "one_panel": False, **look}
    look = ["--emphasise", "one", "--xlim", "1:2.5", "--ylim", "-0.5:1"]
    runs("plot", "mp", "a/one", *look, "--overwrite")
    given = drawn[-1][3]
    assert (given["emphasise"], given["xlim"], given["ylim"]) == ("one", (1, 2.5), (-0.5, 1))
    runs("plot", "mp", "a/one", "--until", "collision", "--overwrite")
    assert drawn[-1][3]["until"] == "collision"


@pytest.mark.parametrize(
    ("given", "mark"),
    [
        ("a:64:x", ("a", 64, "x")),
        ("run: set9:64:at 5:40", ("run: set9", 64, "at 5:40")),
        ("64:12:30", (64, "12:30")),
    ],
)
def test_a_mark_of_one_result_has_its_label(runs, drawn, given, mark):
    names = ("--label", "a", "--label", "run: set9")
    runs("plot", "attenuation", make_run("a/one"), make_run("b"), *names, "--mark", given)
    assert drawn[-1][2].marks == (mark,)


def test_collisions_of_a_table_are_those_of_each_video(runs, drawn):
    for name in ("one", "two", "three"):
        result = make_result()
        result.record["input"]["path"] = os.path.abspath(f"videos/{name}.mp4")
        make_run(name, result)
    rows = ("videos/one.mp4,12", "videos/one.mp4,99", "elsewhere/two.mp4,")
    Path("labels.csv").write_text("\n".join(["video,collision_frame", *rows]))
    result = runs("plot", "mp", "one", "two", "three", "--collisions", "labels.csv")
    assert drawn[-1][3]["collisions"] == {"one": [12, 99], "two": []}
    assert result.stderr.splitlines() == [
        "Warning: one: the collision at frame 99 is outside frames 0 to 39.",
        f"Warning: the labels do not list {os.path.abspath('videos/three.mp4')}.",
    ]


@pytest.mark.painted
@pytest.mark.usefixtures("drawn")
def test_where_it_goes(runs):
    make_run("one"), make_run("two")
    both = ["plot", "mp", "one", "two"]
    for arguments, paths in (
        (["--out", "figures"], ["figures/mp-one-two.png"]),
        (["--out", "sub/fig.pdf"], ["sub/fig.pdf"]),
        (["--out", "FIG.SVG"], ["FIG.SVG"]),
        (["--out", "v1.5"], ["v1.5/mp-one-two.png"]),
    ):
        result = runs(*both, *arguments)
        assert result.stdout.split() == [os.path.normpath(path) for path in paths]
        for path in paths:
            start = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}[path[-3:].lower()]
            assert Path(path).read_bytes().startswith(start)
    assert not [name for name in os.listdir(".") if name.startswith(".dlgmd")]
    assert b"CreationDate" not in Path("sub/fig.pdf").read_bytes()
    assert b"dc:date" not in Path("FIG.SVG").read_bytes()


def test_a_damaged_result_is_one_line_and_the_others_are_drawn(dlgmd):
    make_run("good"), make_run("bad")
    Path("bad/mp.csv").write_bytes(b"\xff\xd8\0" * 999)
    message = "mp.csv: cannot be read (not a CSV file)"
    for order in (["good", "bad"], ["bad", "good"]):
        result = dlgmd("plot", "overview", *order)
        assert result.exit_code == 1 and os.path.exists(result.stdout.strip())
        assert result.stderr == f"Error: bad/{message}; it is left out.\n"
    alone = dlgmd("plot", "overview", "bad")
    assert (alone.exit_code, alone.stdout) == (1, "") and f"bad/{message}. " in alone.stderr


@pytest.mark.painted
def test_letters_that_the_font_lacks_are_one_warning(runs):
    make_run("one")
    result = runs("plot", "mp", "one", "--label", "飛行", "--mark", "4:左")
    assert result.stdout
    lacks = "the figure's font lacks some letters; the figure shows boxes instead"
    assert result.stderr == f"Warning: {lacks}.\n"


def test_a_comparison_has_labels_of_its_own_and_a_tree_stands_for_its_results(runs, drawn):
    make_comparison("cmp/one"), make_comparison("cmp/two"), make_run("set9")
    make_run("out/set9/a"), make_run("out/set9/day/b")
    Path("out/set9/summary.csv").write_text("video\n")
    for paths, names, file in (
        (["cmp/one"], ["set9", "lgmd"], "mp-one"),
        (["cmp/one/compare.csv"], ["set9", "lgmd"], "mp-one"),
        (["cmp/one", "set9"], ["set9", "lgmd", "set9 (2)"], "mp-one-set9"),
        (
            ["cmp/one", "cmp/two/compare.csv"],
            ["one: set9", "one: lgmd", "two: set9", "two: lgmd"],
            "mp-one-two",
        ),
        (["out/set9"], ["a", "b"], "mp-set9"),
        (["out"], ["a", "b"], "mp-out"),
        (["out/set9/summary.csv"], ["a", "b"], "mp-set9"),
        # What a shell makes of out/set9/*.
        (["out/set9/day", "out/set9/a", "out/set9/summary.csv"], ["b", "a"], "mp-day-a-set9"),
    ):
        result = runs("plot", "mp", *paths, "--overwrite")
        assert result.stderr == ""
        assert list(drawn[-1][1]) == names
        assert result.stdout.strip() == os.path.join("dlgmd-out", f"{file}.png")


def test_a_run_goes_before_a_comparison_in_the_same_folder(runs, drawn):
    make_run("both"), make_comparison("both")
    result = runs("plot", "mp", "both")
    assert list(drawn[-1][1]) == ["both"]
    given = os.path.join("both", "compare.csv")
    assert result.stderr == (f"Note: both holds a run and a comparison; for that, give {given}.\n")
    result = runs("plot", "mp", "both/compare.csv", "--overwrite")
    assert list(drawn[-1][1]) == ["set9", "lgmd"]
    assert result.stderr == ""


def test_a_comparison_is_drawn_as_it_drew_itself(runs, drawn):
    make_comparison("cmp"), make_run("run")
    shutil.copytree("cmp", "absolute")
    record = Path("absolute/compare.yaml")
    record.write_text(record.read_text().replace("options: {}", "options: {normalise: absolute}"))
    for paths, column in (
        (["cmp"], "level"),
        (["absolute"], "level"),
        (["cmp", "--normalise", "absolute"], "mp_abs"),
        (["cmp", "run"], "level"),
    ):
        runs("plot", "mp", *paths, "--overwrite")
        assert drawn[-1][3]["column"] == column


@pytest.mark.usefixtures("drawn")
def test_different_normalisations_are_warned_of(dlgmd):
    make_run("absolute"), make_run("sequence", normalise="sequence")
    line, both = "the results were normalised in different ways", ["absolute", "sequence"]
    assert line in dlgmd("plot", "mp", *both).stderr
    assert line not in dlgmd("plot", "attenuation", *both).stderr
    arguments = ("--normalise", "absolute", "--overwrite")
    assert line not in dlgmd("plot", "mp", *both, *arguments).stderr
