"""What users stumble over: one line each says what is wrong and what to do."""

import logging
import os
import pickle
import re
import sys
from pathlib import Path

import pytest

import dlgmd_cli
from dlgmd_cli.commands import console
from dlgmd_cli.errors import (
    DlgmdWarning,
    ParameterError,
    argument,
    naming_arguments,
    warn,
)
from dlgmd_cli.machine.pool import run_tasks


def test_a_folder_that_looks_like_a_url_is_a_folder(runs, clips):
    os.makedirs("rtsp:/x")
    os.link(clips / "loom.avi", "rtsp:/x/loom.avi")
    runs("run", "rtsp://x/loom.avi")


def test_verbose_says_what_is_read_and_with_what(dlgmd, clips):
    lines = dlgmd("run", clips / "loom.avi", "--set", 9, "--format=none", "-v").stderr.splitlines()
    assert any("32x24, 25 frames a second, decoded by opencv" in line for line in lines)
    assert any("sigma_e = 1.5" in line for line in lines)


@pytest.mark.usefixtures("cut")
def test_quiet_leaves_results_and_errors(dlgmd):
    warned = dlgmd("run", "cut.avi", "--format=none", "-v")
    assert "Warning: " in warned.stderr and "Model: " in warned.stderr
    quiet = dlgmd("run", "cut.avi", "--format=none", "-q", "--overwrite")
    assert quiet.stderr == "" and quiet.stdout == warned.stdout
    assert "already exists" in dlgmd("run", "cut.avi", "-q").stderr


@pytest.mark.usefixtures("cut")
def test_a_log_has_everything_with_times(dlgmd):
    run = ["run", "cut.avi", "--format=none", "-q", "--log", "a.log"]
    assert dlgmd(*run).exit_code == 0 and dlgmd(*run).exit_code == 2
    lines = Path("a.log").read_text().splitlines()
    assert all(
        re.match(r"\d{4}-\d\d-\d\d \d\d:\d\d:\d\d,\d{3} [A-Z]+ dlgmd_cli", one) for one in lines
    )
    for level, words in (
        ("DEBUG", "Model: dlgmd"),
        ("WARNING", "cut.avi: "),
        ("ERROR", "a result already exists here"),
    ):
        assert any(f" {level} " in line and words in line for line in lines), level
    assert not logging.getLogger("dlgmd_cli").handlers[1:]


def test_details_of_a_batch_and_of_live(dlgmd, clips, here):
    common = ["--format=none", "--jobs", 1, "-v"]
    done = dlgmd("batch", clips / "loom.avi", "--set", 9, "--model", "lgmd", *common)
    for label in ("set9", "lgmd"):
        assert re.search(rf"loom.avi, {label}: done, \d+\.\d+ s\.", done.stderr)
    live = ["live", clips / "loom.avi", "--realtime", "--alarm", "spikes"]
    live += ["--param", "t_mp=0.01", "--param", "n_sp=1"]
    assert '"event": "begin"' in dlgmd(*live, "-v").stderr


def test_texts_name_arguments_or_the_options_of_the_command_that_runs():
    def text():
        hint = f"Add {argument('overwrite', True)}, or choose another {argument('out')}."
        return f"{hint} {argument('normalise', 'absolute')} {argument('no_option')}"

    in_python = "Add overwrite=True, or choose another out. normalise='absolute' no_option"
    assert text() == in_python
    options = {"overwrite": "--overwrite", "out": "--out", "normalise": "--normalise"}
    with naming_arguments(options):
        expected = "Add --overwrite, or choose another --out. --normalise absolute no_option"
        assert text() == expected
    assert text() == in_python


def test_an_error_names_its_argument():
    error = ParameterError("", "13 are too many", "Choose 12.", argument="frames")
    again = pickle.loads(pickle.dumps(error))
    for one in (error, again):
        assert str(one) == "frames: 13 are too many. Choose 12." and one.argument == "frames"


def test_a_program_that_logs_reads_the_names_of_arguments(caplog, tmp_path):
    caplog.set_level("INFO")
    dlgmd_cli.synth("looming-cube", tmp_path, lossless=False, frames=3, noise=0.01, background=0.8)
    assert "Note: MPEG-4 smooths the noise; lossless keeps every pixel of it." in caplog.messages


def test_a_warning_is_logged_and_issued_for_the_line_that_called(caplog):
    with pytest.warns(DlgmdWarning, match=r"^doubtful$") as caught:
        warn("doubtful")
    assert caplog.messages == ["doubtful"] and caught[0].filename == __file__


def test_workers_pass_their_warnings_on(caplog):
    with pytest.warns(DlgmdWarning) as caught:
        ended = [end for _, end in run_tasks(warn, ["a", "b"], 2)]
    assert {str(one.message) for one in caught} == {"a", "b"} == {*caplog.messages}
    assert [end.status for end in ended] == ["done", "done"]


def test_workers_name_arguments_as_the_command_does():
    with naming_arguments({"out": "--out"}):
        assert [end.result() for _, end in run_tasks(argument, ["out"], 1)] == ["--out"]


def test_a_table_whose_words_would_break_is_turned(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    monkeypatch.setenv("TERM", "dumb")
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    header = ("model", *(f"column-{n}-of-twenty-five" for n in range(4)))
    rows = [(f"model-{n}", *["0.00-(0.00–0.00)-of-ten"] * 4) for n in range(3)]
    console.print_table(header, rows)
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80 and sum("column-3-of-twenty-five" in x for x in lines) == 2
    assert lines[1].split()[:2] == ["model", "model-0"]
    console.print_table(("model", "peak"), [("model-0", "1.0 " * 40)])
    assert "model-0" in capsys.readouterr().out.splitlines()[3]
