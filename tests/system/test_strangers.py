"""Names and files from strangers: they are shown and refused, and do nothing else."""

import csv
import io
import json
import os
import re
import shutil
import subprocess
import sys
import xml.dom.minidom
from pathlib import Path

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from dlgmd_cli.errors import printable
from dlgmd_cli.parameters.plain_yaml import MAX_CONFIG_BYTES
from dlgmd_cli.results.csv import cell, text_cell
from dlgmd_cli.results.reading import read_comparison
from dlgmd_cli.results.record import yaml_text
from dlgmd_cli.results.store import fitting

pytestmark = pytest.mark.slow
STARTS_FORMULA = "=+-@＝＋－＠﹦﹢﹣﹫−"

# A title for the window, a C1 control, text that runs backwards, two ends of a line, no UTF-8.
HOSTILE = "a\x1b]0;x\x07\x9b2J\u202eb\n\r" + os.fsdecode(b"\xff")
SHOWN = r"a\x1b]0;x\x07\x9b2J\u202eb\n\r\udcff"
POSIX = pytest.mark.skipif(os.name == "nt", reason="no such names there")

texts = st.text(
    st.one_of(
        st.sampled_from([*STARTS_FORMULA, *";,\t\r\n\"' ./\\a0", "\x1b", "\u202e", "\x9b"]),
        st.characters(),
    ),
    max_size=12,
)


def is_clean(text):
    """Whether a terminal acts on nothing but the ends of lines."""
    return text.replace("\n", "").isprintable()


def written(*cells):
    file = io.StringIO()
    csv.writer(file, lineterminator="\n").writerow(cells)
    return file.getvalue()


@given(texts)
@example("a;=cmd|' /C calc'!A0")
@example('x;"=1"')
@example(" =1")
@example("\t=1")
@example("＝1")
def test_text_starts_no_formula_however_a_line_is_split(text):
    guarded_text = text_cell(text)
    assert text_cell(guarded_text) == guarded_text
    line = written("ok", guarded_text, cell(-12.3), guarded_text)
    assert next(csv.reader([line])) == ["ok", guarded_text, "-12.3", guarded_text]
    assert guarded_text.isprintable() and guarded_text[:1] not in [*STARTS_FORMULA, "\t", "\r"]
    for piece in re.split("[;\t]", written(guarded_text, "1", guarded_text)):
        assert not re.match(rf"[\s\"']*[{re.escape(STARTS_FORMULA)}]", piece)


@given(st.text(st.characters(exclude_characters="/\0;", exclude_categories=["C", "Z"]), min_size=1))
@example("=cmd.mp4")
@example("-rf.mp4")
def test_a_guarded_path_leads_to_the_same_file(name):
    assert text_cell(name) in (name, f"./{name}")
    assert Path(text_cell(name)) == Path(name)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("=cmd.mp4", "./=cmd.mp4"),
        (" =1", "./ =1"),
        ("\t=1", r"\t=1"),
        ("a;=b", r"a;\x3db"),
        ("a; ＠b", r"a; \uff20b"),
        ("a;b=c", "a;b=c"),
        ("a-b/c@d=e", "a-b/c@d=e"),
        ("", ""),
    ],
)
def test_what_is_put_in_front(text, expected):
    assert text_cell(text) == expected


@POSIX
def test_a_label_is_the_same_everywhere(runs, tmp_path, clips):
    for number, stem in enumerate(("=cmd|' C'!A0", "a;=b,c$", f"-{HOSTILE}")):
        (tmp_path / f"{stem}.yaml").write_text(f"r: {number + 2}\n")
    files = [f"--config={stem}.yaml" for stem in ("=cmd|' C'!A0", "a;=b,c$", f"-{HOSTILE}")]
    labels = ["./=cmd|' C'!A0", r"a;\x3db,c$", f"./-{SHOWN}"]
    options = ("--format", "svg", "--format", "pdf", "--overwrite")
    folder = tmp_path / "dlgmd-out/loom"
    result = runs("compare", clips / "loom.avi", *files, *options, "--json", plots=True)
    assert list(json.loads(result.stdout)["models"]) == labels
    assert list(read_comparison(folder)) == labels
    record = yaml.safe_load((folder / "compare.yaml").read_text(encoding="utf-8"))
    assert [one["label"] for one in record["models"]] == labels
    drawing = (folder / "compare-mp.svg").read_text(encoding="utf-8")
    xml.dom.minidom.parseString(drawing)
    assert is_clean(drawing)
    table = runs("compare", clips / "loom.avi", *files, *options, plots=True)
    assert is_clean(table.output)
    assert all(label in table.stdout for label in labels)


@pytest.mark.parametrize(
    "letter",
    [
        *map(chr, [*range(32), *range(127, 160)]),
        *"\u2028\u2029\u200e\u200f\u061c\ufeff\u202a\u202e\u2066\u2069\udcff",
    ],
)
def test_controls_are_escaped(letter):
    assert is_clean(printable(letter)) and printable(letter).isascii()


@POSIX
def test_every_path_on_stdout_is_escaped(runs, tmp_path, clips):
    video = shutil.copy(clips / "loom.avi", tmp_path / f"{HOSTILE}.avi")
    out = os.path.join(HOSTILE, HOSTILE)
    sweep = ("--x", "r=1,2", "--y", "a=1,2", "--jobs", "1")
    for arguments, path in (
        (["run", video, "--out", HOSTILE], f"{SHOWN}/{SHOWN}"),
        (["plot", "mp", out, "--out", HOSTILE], f"{SHOWN}/mp-{SHOWN}.png"),
        (["compare", video, "--out", HOSTILE], f"{SHOWN}/{SHOWN}"),
        (["layers", video, "--frames", "3", "--out", HOSTILE], f"{SHOWN}/{SHOWN}"),
        (["layers", video, "--video", f"{HOSTILE}.mp4"], f"{SHOWN}.mp4"),
        (["sweep", video, *sweep, "--out", HOSTILE], f"{SHOWN}/sweep-{SHOWN}"),
        (["kernels", "--set", "9", "--out", HOSTILE], f"{SHOWN}/kernels-set9.csv"),
        (["synth", "looming-cube", "--frames", "2", "--out", HOSTILE], f"{SHOWN}/looming-cube.csv"),
        (
            ["bench", video, "--radius", "2", "--scale", "1", "--csv", f"{HOSTILE}.csv"],
            f"{SHOWN}.csv",
        ),
    ):
        result = runs(*arguments)
        assert is_clean(result.output), arguments
        assert result.stdout.splitlines()[-1] == path


@POSIX
def test_json_keeps_a_name_and_holds_no_control(runs, tmp_path, clips):
    name = f"{HOSTILE}\x7f\u2028"
    shutil.copy(clips / "loom.avi", tmp_path / f"{name}.avi")
    result = runs("run", f"{name}.avi", "--json")
    assert result.stdout.isascii() and is_clean(result.stdout)
    assert json.loads(result.stdout)["result"] == os.path.join("dlgmd-out", name)
    record = (tmp_path / "dlgmd-out" / name / "run.yaml").read_text(encoding="utf-8")
    assert is_clean(record)
    assert yaml.safe_load(record)["input"]["path"] == str(tmp_path / f"{name}.avi")


def test_a_record_stays_readable_where_nothing_is_hostile():
    assert yaml_text({"path": "Überflug.mp4"}, "") == "path: Überflug.mp4\n"
    assert yaml_text({"path": "\u202eÜ"}, "") == 'path: "\\u202E\\xDC"\n'


@pytest.mark.parametrize(
    "arguments",
    [
        ["{}"],
        ["--{}"],
        ["run", "x", "--{}"],
        ["run", "x", "{}"],
        ["run", "{}"],
        ["run", "x", "--set", "{}"],
        ["run", "x", "--config", "{}"],
        ["run", "x", "--model", "{}"],
        ["run", "x", "--scale", "{}"],
        ["run", "x", "--size", "{}"],
        ["run", "x", "--start", "{}"],
        ["run", "x", "--param", "{}=1"],
        ["plot", "mp", "{}"],
        ["layers", "x", "--frames", "{}"],
        ["layers", "x", "--video", "{}"],
        ["sweep", "--x", "{}", "--y", "r=1,2"],
        ["sets", "show", "{}"],
        ["synth", "{}"],
        ["bench", "--csv", "here{}"],
        ["kernels", "--out", "file{}/x"],
    ],
)
@POSIX
def test_what_was_typed_is_not_echoed_raw(dlgmd, tmp_path, arguments):
    (tmp_path / f"here{HOSTILE}").mkdir()
    (tmp_path / f"file{HOSTILE}").touch()
    result = dlgmd(*[one.format(HOSTILE) for one in arguments])
    assert result.exit_code in (1, 2) and result.stdout == ""
    assert is_clean(result.stderr) and r"a\x1b]0;x" in result.stderr
    assert result.stderr.splitlines()[-1].startswith("Error: ")


@POSIX
def test_a_kind_of_figure_that_was_typed_is_not_echoed_raw(runs, dlgmd, clips):
    runs("run", clips / "loom.avi", "--model", "9")
    result = dlgmd("plot", HOSTILE, "dlgmd-out/loom")
    assert result.exit_code == 2
    assert is_clean(result.stderr) and r"a\x1b]0;x" in result.stderr


@POSIX
def test_a_traceback_is_escaped(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "dlgmd_cli", "--debug", "run", HOSTILE],
        capture_output=True,
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    text = done.stderr.decode()
    assert done.returncode == 1 and "Traceback" in text and "SourceError" in text
    assert is_clean(text) and r"a\x1b]0;x\x07\x9b2J\u202eb" in text


def test_a_name_that_looks_like_an_option(dlgmd, runs, tmp_path, clips):
    shutil.copy(clips / "loom.avi", tmp_path / "-rf.avi")
    assert "No such option" in dlgmd("run", "-rf.avi").stderr
    for arguments in (["./-rf.avi", "--out", "1"], ["--out", "2", "--", "-rf.avi"]):
        runs("run", *arguments)


NAMES = (
    *("..avi", "...avi", ".avi", "....avi", " .avi", "x . .avi", "CON.avi", "~user.avi", "-rf.avi"),
    *("$(touch pwned).avi", "`touch pwned`.avi", ";touch pwned;.avi", "|touch pwned.avi"),
    *("%s%n.avi", "frame%04d.avi", "*.avi", "[a].avi", r"C:\x.avi", "concat:a|b.avi", "pipe:0"),
    *("file:x.avi", "data:,x", "http:x.avi", "a" * 251 + ".avi", "é" * 125 + ".avi"),
)


@POSIX
def test_results_of_any_name_stay_in_their_folder(runs, tmp_path, clips):
    (tmp_path / "in").mkdir()
    for name in NAMES:
        shutil.copy(clips / "loom.avi", tmp_path / "in" / name)
    for number, name in enumerate(NAMES):
        out = tmp_path / "out" / str(number)
        runs("run", os.path.join("in", name), "--out", out)
        (folder,) = out.iterdir()
        assert (folder / "run.yaml").is_file()
    assert sorted(os.listdir("in")) == sorted(NAMES)
    assert sorted(os.listdir(".")) == ["in", "out"]


@pytest.mark.parametrize("command", ["sweep", "kernels", "plot"])
def test_names_too_long_for_a_prefix_are_cut(runs, tmp_path, clips, command):
    name = "é" * 123 + "aaaa"
    (tmp_path / f"{name}.yaml").write_text("r: 2\n")
    video = shutil.copy(clips / "loom.avi", tmp_path / f"{name}.avi")
    runs("run", video)
    arguments = {
        "sweep": [video, "--x", "r=1,2", "--y", "a=1,2", "--jobs", "1"],
        "kernels": ["--config", f"{name}.yaml", "--formulation", "released"],
        "plot": ["mp", os.path.join("dlgmd-out", name)],
    }[command]
    result = runs(command, *arguments)
    assert os.path.exists(result.stdout.splitlines()[-1])


@given(st.text(st.characters(exclude_categories=["Cs"]), max_size=300))
def test_a_fitting_name_is_a_beginning_and_short(name):
    short = fitting(name)
    assert name.startswith(short) and len(os.fsencode(short)) <= 200
    assert short == name or len(os.fsencode(name[: len(short) + 1])) > 200


def test_a_file_longer_than_it_says(dlgmd, tmp_path, monkeypatch):
    (tmp_path / "x.yaml").write_text("#" * (MAX_CONFIG_BYTES + 1))
    real = Path.stat

    def says_nothing(path, **options):
        facts = real(path, **options)
        return os.stat_result((*facts[:6], 0, *facts[7:])) if path.suffix == ".yaml" else facts

    monkeypatch.setattr(Path, "stat", says_nothing)
    result = dlgmd("kernels", "--config", "x.yaml")
    assert result.exit_code == 2 and "0.1 MB is too large for a configuration" in result.stderr


@POSIX
def test_paths_in_a_record_are_neither_read_nor_written(runs, tmp_path, clips):
    os.mkfifo(tmp_path / "pipe")  # whoever opens it waits for ever
    record = {
        "input": {"path": str(tmp_path / "pipe"), "width": "../../x"},
        "processed": {"path": str(tmp_path / "pipe")},
        "sweep": {"path": "../x"},
        "versions": {"dlgmd": "\x1b[2J"},
        "warnings": ["\x1b[2J"],
        "summary": {"path": "../x"},
        "r": 2,
    }
    (tmp_path / "run.yaml").write_text(yaml.safe_dump(record))
    result = runs("run", clips / "loom.avi", "--config", "run.yaml")
    assert is_clean(result.output)
    made = yaml.safe_load((tmp_path / "dlgmd-out/loom/run.yaml").read_text(encoding="utf-8"))
    assert made["input"]["path"] == str(clips / "loom.avi") and made["r"] == 2
    assert "\x1b[2J" not in made["warnings"] and made["versions"]["dlgmd"] != "\x1b[2J"
    assert sorted(os.listdir(".")) == ["dlgmd-out", "pipe", "run.yaml"]
