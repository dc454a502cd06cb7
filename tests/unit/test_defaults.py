"""The user's own defaults: dlgmd.yaml sets them, options outdo it, and records tell of it."""

import json
import os
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import csv_rows, yaml_of

import dlgmd_cli
from dlgmd_cli.commands import defaults


@pytest.fixture
def own(monkeypatch, dlgmd, tmp_path):
    """Write dlgmd.yaml, which counts in these tests: `own("size: 16x12")`."""

    def write(text, name="dlgmd.yaml"):
        monkeypatch.delenv("DLGMD_SETTINGS", raising=False)
        (tmp_path / name).write_text(text)

    return write


def settings_of(folder):
    return yaml_of(Path(folder) / "run.yaml").get("settings")


def test_defaults_are_used_recorded_and_outdone_by_options(dlgmd, runs, own, clips, tmp_path):
    pytest.importorskip("av", reason="one of the options is --decoder pyav")
    cv2.imwrite(str(tmp_path / "mask.png"), np.full((24, 32), 255, np.uint8))
    own("size: 16x12\nmask: mask.png\ndecoder: opencv\nformat: [svg]\nout: results\n")
    assert dlgmd("run", clips / "loom.avi").stdout.splitlines()[-1] == "results/loom"
    record = yaml_of("results/loom/run.yaml")
    assert record["processed"]["width"] == 16 and record["input"]["decoder"] == "opencv"
    assert record["options"]["mask"] == str(tmp_path / "mask.png")
    assert record["settings"] == {
        "file": str(tmp_path / "dlgmd.yaml"),
        "size": "16x12",
        "mask": "mask.png",
        "decoder": "opencv",
        "format": ["svg"],
        "out": "results",
    }
    assert {path.name for path in Path("results/loom").glob("mp.*")} == {"mp.csv", "mp.svg"}
    again = ["--config", "results/loom/run.yaml", "--settings", "none", "--out", "again"]
    runs("run", clips / "loom.avi", *again)
    assert csv_rows("again/loom/mp.csv") == csv_rows("results/loom/mp.csv")
    options = ["--scale", 0.25, "--format", "png", "--decoder", "pyav", "--out", "b"]
    runs("run", clips / "loom.avi", *options, plots=True)
    assert yaml_of("b/loom/run.yaml")["processed"]["width"] == 8
    assert settings_of("b/loom").keys() == {"file", "mask"} and Path("b/loom/mp.png").exists()


def test_the_file_is_found_above_and_its_paths_are_its_own(
    dlgmd, own, clips, tmp_path, monkeypatch
):
    own("out: results")
    (tmp_path / "day" / "one").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "day" / "one")
    done = dlgmd("run", clips / "loom.avi", "--no-plots")
    assert done.stdout.splitlines()[-1] == str(tmp_path / "results" / "loom")


def test_every_command_that_follows_a_file_says_so(dlgmd, own, clips, tmp_path):
    own("out: results\nsize: 16x12\n")
    run = ["run", clips / "loom.avi", "--no-plots", "--overwrite"]
    line = f"Settings from {tmp_path / 'dlgmd.yaml'}: "
    assert f"{line}size, out.\n" in dlgmd(*run).stderr
    assert f"{line}size.\n" in dlgmd(*run, "--out", "a").stderr
    assert f"{line}out.\n" in dlgmd(*run, "--scale", 0.5).stderr
    assert f"{line}out.\n" in dlgmd(*run, "--config", "a/loom/run.yaml").stderr
    plot = ["plot", "mp", "a/loom", "--overwrite"]
    assert f"{line}out.\n" in dlgmd(*plot).stderr
    for quiet in (
        dlgmd(*run, "-q"),
        dlgmd(*run, "--out", "a", "--size", "9x9"),
        dlgmd(*run, "--settings", "none"),
        dlgmd("sets"),
    ):
        assert quiet.exit_code == 0 and "Settings from" not in quiet.stderr


def another_user(monkeypatch, path, stat="stat"):
    """Let a file, or a link, belong to another user."""
    real = getattr(Path, stat)

    def with_owner(self, **how):
        found = real(self, **how)
        if self.name != path.name:
            return found
        return os.stat_result((*found[:4], os.geteuid() + 1, *found[5:]))

    monkeypatch.setattr(Path, stat, with_owner)


@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="Windows knows no such owner")
@pytest.mark.parametrize("stat", ["stat", "lstat"])
def test_a_file_of_another_user_is_refused(dlgmd, runs, own, clips, tmp_path, monkeypatch, stat):
    own("out: theirs\n")
    (tmp_path / "below").mkdir()
    monkeypatch.chdir(tmp_path / "below")
    run = ["run", clips / "loom.avi", "--no-plots"]
    path = tmp_path / "dlgmd.yaml"
    another_user(monkeypatch, path, stat)
    result = dlgmd(*run)
    assert result.exit_code == 2 and result.stderr.splitlines()[-1] == (
        f"Error: {path}: belongs to another user. If you trust it, add --settings {path}; "
        "--settings none leaves it out."
    )
    assert not list(tmp_path.rglob("run.yaml"))
    runs(*run, "--settings", "none")
    runs(*run, "--settings", path)
    assert (tmp_path / "theirs/loom/run.yaml").exists()
    assert dlgmd("run", "--help").exit_code == dlgmd("sets").exit_code == 0


def test_the_search_ends_at_the_home_folder(dlgmd, own, tmp_path, monkeypatch):
    own("out: above\n")
    home = tmp_path / "home"
    (home / "day").mkdir(parents=True)
    monkeypatch.chdir(home / "day")
    assert defaults.find(None) == tmp_path / "dlgmd.yaml"
    monkeypatch.setenv("HOME", str(home))
    assert defaults.find(None) is None
    (home / "dlgmd.yaml").write_text("out: here\n")
    assert defaults.find(None) == home / "dlgmd.yaml"


def test_a_recorded_run_is_repeated_whatever_the_defaults_are(runs, own, clips):
    runs("run", clips / "loom.avi", "--out", "first")
    own("size: 9x7\ndecoder: opencv\n")
    config = ["--config", "first/loom/run.yaml"]
    runs("run", clips / "loom.avi", *config, "--out", "again")
    assert csv_rows("first/loom/mp.csv") == csv_rows("again/loom/mp.csv")
    assert settings_of("again/loom") is None
    # A file of parameters that says how the input is read outdoes only what it says.
    Path("my.yaml").write_text("r: 3\noptions: {scale: 0.5}\n")
    runs("run", clips / "loom.avi", "--config", "my.yaml")
    record = yaml_of("dlgmd-out/loom/run.yaml")
    assert record["processed"]["width"] == 16 and record["input"]["decoder"] == "opencv"


def test_a_batch_follows_them_and_knows_what_is_done(dlgmd, runs, own, clips, here):
    own("size: 16x12\nout: results\n")
    batch = ["batch", clips, "--exclude", "short*", "--no-plots", "--jobs", 1]
    runs(*batch)
    assert settings_of("results/loom.avi")["size"] == "16x12"
    own("size: 16x12\nout: results\n", "other.yaml")
    assert "2 of 2 videos are done already" in dlgmd(*batch, "--settings", "other.yaml").stderr
    refused = dlgmd(*batch, "--settings", "none", "--out", "results")
    assert refused.exit_code == 2 and "has other settings (--size)" in refused.stderr


def test_a_sweep_of_cubes_has_no_input_to_scale(runs, own):
    own("size: 16x12\ndecoder: opencv\n")
    axes = ["--x", "sigma_e=1", "--y", "sigma_i=2", "--frames", 10, "--speed", 2]
    runs("sweep", *axes)


def test_python_does_not_read_them(own, clips):
    own("size: 16x12")
    assert dlgmd_cli.run(clips / "loom.avi").record["processed"]["width"] == 32


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("sizes: 3x3", "contains an unknown setting. Did you mean 'size'?"),
        (
            "secret: 1",
            "contains an unknown setting. Choose from size, mask, decoder, fov, camera-tilt, "
            "format, out.",
        ),
        ("size: 5", "size: this is no text. It is the size of the processed frames"),
        ("size: secret", "size: this value cannot be used. It is the size of the processed"),
        ("decoder: secret", "decoder: this value cannot be used. It is the library that decodes"),
        ("format: [secret]", "format: this value cannot be used. It is the formats of figures"),
        ("format: []", "format: this is no text."),
        ("out: [a]", "out: this is no text."),
        ("out: secret.mp4", "out: this value cannot be used. It is the folder for the results."),
        ("mask: secret.png", "mask: this value cannot be used. It is the image that is black"),
        ("out: ftp://secret/x", "out: a URL is not allowed here. Give --out."),
        ("mask: ftp://secret/x", "mask: a URL is not allowed here. Give --mask."),
        ("- size", "does not consist of 'option: value' lines."),
        ("size: [", "is not plain YAML in line 1."),
        ("size: &secret 3x3\nout: *secret", "is not plain YAML. 'dlgmd info --settings' lists"),
        ("size: 3x3\nsecret: 1\nsecret: 2", "is not plain YAML in line 3."),
        ("root:secret:0:0:/root", "does not consist of 'option: value' lines."),
    ],
)
def test_what_is_wrong_with_a_file_is_one_line(dlgmd, own, clips, text, words):
    own(text)
    result = dlgmd("run", clips / "loom.avi", "--out", "x")
    assert result.exit_code == 2 and f"Error: dlgmd.yaml: {words}" in result.stderr
    assert "Usage: dlgmd run" in result.stderr and not Path("x").exists()
    assert "secret" not in result.stderr  # the file may be a link to anything


def test_a_file_with_an_error_stops_neither_help_nor_what_does_not_read_it(runs, own, clips):
    own("size: [")
    runs("run", "--help")
    runs("run", clips / "loom.avi", "--settings", "none")


def test_a_file_that_is_not_there(dlgmd):
    for arguments in (["run", "x", "--settings", "no.yaml"], ["--settings", "no.yaml", "run", "x"]):
        result = dlgmd(*arguments)
        assert result.exit_code == 2 and "no.yaml: there is no such file." in result.stderr


def test_help_and_info_show_them(dlgmd, runs, own):
    nothing = dlgmd("info", "--settings").stdout
    assert "There is no dlgmd.yaml here or in a folder above." in nothing
    assert "formats of figures, such as [png, pdf]" in nothing
    own("size: 16x12\nformat: [svg, pdf]\n")
    text = " ".join(dlgmd("run", "--help").stdout.split())
    assert "instead. [dlgmd.yaml: 16x12]" in text and "[dlgmd.yaml: svg, pdf]" in text
    assert "[default: dlgmd-out]" in text and "[default: png]" not in text
    assert "svg, pdf" in dlgmd("info", "--settings").stdout
    facts = json.loads(runs("info", "--settings", "--json").stdout)
    assert facts == {"settings": "dlgmd.yaml", "size": "16x12", "format": ["svg", "pdf"]}
    own("out: b", "other.yaml")
    for words in (["info", "--settings", "other.yaml"], ["--settings", "other.yaml", "info"]):
        shown = dlgmd(*words).stdout
        assert "other.yaml" in shown and "16x12" not in shown
    assert "Missing argument 'INPUT...'" in dlgmd("info").stderr


def test_the_variable_names_the_file_for_other_programs(runs, own, clips, monkeypatch):
    own("out: there", "my.yaml")
    monkeypatch.setenv("DLGMD_SETTINGS", "my.yaml")
    runs("run", clips / "loom.avi")
    assert Path("there/loom/run.yaml").exists()
