"""`dlgmd batch`: every video has its row, and none costs another its result."""

import json
import math
import os
import shutil
from pathlib import Path

import pytest
from conftest import csv_rows, files_of, full, looming_frames, write_video, yaml_of

from dlgmd_cli.machine import cancel
from dlgmd_cli.results import store
from dlgmd_cli.results.files import names_of
from dlgmd_cli.tasks.batch.batch import SUMMARY_COLUMNS

QUICK = ("--format=none", "--jobs", 2)


@pytest.fixture
def flights(clips, tmp_path):
    """Four videos in a tree, two of them broken."""
    folder = tmp_path / "flights"
    (folder / "a" / "deep").mkdir(parents=True)
    shutil.copy(clips / "loom.avi", folder / "a" / "loom.avi")
    shutil.copy(clips / "loom.mp4", folder / "a" / "deep" / "other.mp4")
    (folder / "empty.mp4").touch()
    (folder / "text.mkv").write_text("no video\n")
    (folder / "notes.txt").write_text("no video either\n")
    return folder


def summary(path="dlgmd-out"):
    return {row["video"]: row for row in csv_rows(Path(path, "summary.csv"))}


def statuses(path="dlgmd-out"):
    return {video: row["status"] for video, row in summary(path).items()}


def mtime(path):
    return Path(path).stat().st_mtime_ns


def test_a_tree_with_broken_files_in_processes_of_their_own(dlgmd, flights):
    result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 1
    *lines, last = result.stderr.splitlines()
    assert len(lines) == 2 and last.startswith("Error: 2 of 4 videos failed")
    for words in ("empty.mp4: failed: the file is empty", "text.mkv: failed: no frame could"):
        assert f"Error: {words}" in result.stderr
    path, counts = result.stdout.splitlines()[-2:]
    assert path == os.path.join("dlgmd-out", "summary.csv") and "2 done, 2 failed, " in counts
    names = ["a/deep/other.mp4", "a/loom.avi", "empty.mp4", "text.mkv"]
    assert list(statuses().items()) == list(zip(names, ["done"] * 2 + ["failed"] * 2, strict=True))
    results = {path.parent.as_posix() for path in Path("dlgmd-out").rglob("run.yaml")}
    assert results == {"dlgmd-out/a/loom", "dlgmd-out/a/deep/other"}
    assert not list(Path("dlgmd-out").rglob(".dlgmd*"))


def test_rows_and_files_are_those_of_run(dlgmd, runs, flights, here):
    assert dlgmd("batch", flights, *QUICK, "--set", 4).exit_code == 1
    single = ("--set", 4, "--out", "single", "--json", "--format=none")
    facts = json.loads(runs("run", flights / "a/loom.avi", *single).stdout)
    assert files_of("dlgmd-out/a/loom").keys() == files_of("single/loom").keys()
    for name in names_of(store.RUN, ()) - {store.RUN}:
        assert Path("dlgmd-out/a/loom", name).read_bytes() == Path("single/loom", name).read_bytes()
    record, other = (yaml_of(f"{folder}/loom/run.yaml") for folder in ("dlgmd-out/a", "single"))
    assert record.pop("wall_s") > 0.0
    assert record == other
    row = summary()["a/loom.avi"]
    for key in SUMMARY_COLUMNS[9:17]:
        value = "" if facts[key] is None else facts[key]
        assert row[key] == (f"{value:.9g}" if isinstance(value, float) else str(value)), key
    assert [row[key] for key in SUMMARY_COLUMNS[4:9]] == ["20", "32", "24", "25", "0.8"]
    assert float(row["wall_s"]) > 0 and row["error"] == ""
    failed = summary()["empty.mp4"]
    assert failed["error"] == "the file is empty. Copy or record it again."
    assert all(failed[key] == "" for key in SUMMARY_COLUMNS[3:17])


def test_what_is_done_is_skipped(dlgmd, runs, flights, here):
    dlgmd("batch", flights, *QUICK)
    record = Path("dlgmd-out/a/loom/run.yaml")
    before, rows = mtime(record), summary()
    result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[0] == "2 of 4 videos are done already."
    assert mtime(record) == before and summary().keys() == rows.keys()
    for video in ("a/loom.avi", "a/deep/other.mp4"):
        assert summary()[video] == rows[video]  # its time, too
    result = dlgmd("batch", flights, *QUICK, "--force")
    assert "done already" not in result.stderr and mtime(record) > before
    (flights / "empty.mp4").unlink()
    (flights / "text.mkv").unlink()
    runs("batch", flights, *QUICK)
    assert set(summary()) == {"a/loom.avi", "a/deep/other.mp4"}
    runs("batch", flights, *QUICK, "--force", "--set", 3)
    assert yaml_of(record)["set"] == 3


def test_a_changed_input_is_computed_again(dlgmd, flights, here):
    dlgmd("batch", flights, *QUICK)
    write_video(flights / "a/loom.avi", looming_frames(12))
    result = dlgmd("batch", flights, *QUICK)
    assert result.stderr.splitlines()[0] == "1 of 4 videos are done already."
    assert summary()["a/loom.avi"]["frames"] == "12"
    os.utime(flights / "a/loom.avi", ns=(0, 0))
    result = dlgmd("batch", flights, *QUICK)
    assert result.stderr.splitlines()[0] == "1 of 4 videos are done already."


SPOILED = {
    "half a record": lambda folder: (folder / "run.yaml").write_bytes(b"input: [\0\xff"),
    "interrupted": lambda folder: edit(folder, "interrupted: false", "interrupted: true"),
    "an old record": lambda folder: edit(folder, "\ncomplete: true", ""),
    "an old summary": lambda folder: edit(folder, "  alarms:", "  collisions:"),
}


def edit(folder, old, new):
    text = (folder / "run.yaml").read_text()
    assert old in text
    (folder / "run.yaml").write_text(text.replace(old, new))


@pytest.mark.parametrize("name", SPOILED)
def test_what_is_not_whole_is_computed_again(runs, clips, here, name):
    runs("batch", clips / "loom.avi", *QUICK)
    whole = files_of("dlgmd-out")
    SPOILED[name](Path("dlgmd-out/loom"))
    result = runs("batch", clips / "loom.avi", *QUICK)
    assert result.stderr == ""
    assert files_of("dlgmd-out") == whole


def test_results_of_run_and_of_another_version_count(dlgmd, runs, flights, here):
    runs("run", flights / "a/loom.avi", "--out", "dlgmd-out/a")
    edit(Path("dlgmd-out/a/loom"), "  dlgmd: ", "  dlgmd: 0.0.1.")
    result = dlgmd("batch", flights, *QUICK)
    first, second, *_ = result.stderr.splitlines()
    assert first == "1 of 4 videos are done already." and "kept 1 result of another" in second
    assert summary()["a/loom.avi"]["wall_s"] == ""


def test_other_settings_are_not_replaced_unasked(dlgmd, flights, here):
    folder = flights / "a/deep"
    dlgmd("batch", folder, *QUICK, "--param", "sigma_e=1.2", "--normalise", "sequence")
    before = files_of("dlgmd-out")
    same = ("--param", "sigma_e=1.2", "--normalise", "sequence")
    Path("wide.yaml").write_text("preset: flight\nwidth_px: 320\n")
    for options, shown in (
        (("--param", "sigma_e=1.3", *same[2:]), "sigma_e"),
        (same[:2], "--normalise"),
        ((*same, "--input-fps", 12), "--input-fps"),
        ((*same, "--config", "wide.yaml"), "width_px"),
    ):
        result = dlgmd("batch", folder, *QUICK, *options)
        assert result.exit_code == 2 and result.stderr.count("\n") == 1
        assert f"dlgmd-out/other: the result there has other settings ({shown})" in result.stderr
        assert files_of("dlgmd-out") == before
    other = (*QUICK, "--param", "sigma_e=1.3", "--overwrite")
    assert "done already" not in dlgmd("batch", folder, *other).stderr
    assert "sigma_e: 1.3" in Path("dlgmd-out/other/run.yaml").read_text()
    assert "1 of 1 video is done already." in dlgmd("batch", folder, *other).stderr


def test_another_input_of_the_same_name(dlgmd, runs, flights, here):
    runs("batch", flights / "a", *QUICK)
    other = Path("other")
    other.mkdir()
    write_video(other / "loom.avi", looming_frames(15))
    result = dlgmd("batch", other, *QUICK)
    assert result.exit_code == 2
    assert "dlgmd-out/loom: the result there is of another input" in result.stderr
    shutil.copy2(flights / "a" / "loom.avi", other / "loom.avi")  # the same, at another place
    result = runs("batch", other, *QUICK)
    assert "1 of 1 video is done already." in result.stderr


def test_a_comparison_of_another_input_is_not_removed_unasked(
    dlgmd, runs, flights, here, monkeypatch
):
    folder = Path("dlgmd-out/loom")
    folder.mkdir(parents=True)
    (folder / "compare.csv").touch()
    (folder / "compare.yaml").write_text("input: {path: /elsewhere/loom.avi}\n")
    with monkeypatch.context() as patch:  # nothing is read for it
        opens = "dlgmd_cli.tasks.call.open_input"
        patch.setattr(opens, lambda *_, **__: pytest.fail("read"))
        assert dlgmd("batch", flights / "a/loom.avi", "--format=none", "--jobs", 1).exit_code == 1
    assert "the result of another input (compare.yaml)" in summary()["loom.avi"]["error"]
    assert sorted(os.listdir(folder)) == ["compare.csv", "compare.yaml"]
    runs("batch", flights / "a/loom.avi", *QUICK, "--overwrite")
    assert not (folder / "compare.csv").exists()


def test_several_models_on_one_decoding(dlgmd, flights, here):
    Path("my cfg.yaml").write_text("sigma_e: 1.25\nr: 3\n")
    models = ("--set", 7, "--set", 9, "--set", 7, "--config", "my cfg.yaml", "--model", "lgmd")
    result = dlgmd("batch", flights, *QUICK, *models)
    assert result.exit_code == 1
    assert sorted(os.listdir("dlgmd-out")) == ["lgmd", "my cfg", "set7", "set9"]
    for label, options in {
        "set7": ("--set", 7),
        "lgmd": ("--model", "lgmd"),
        "my cfg": ("--config", "my cfg.yaml"),
    }.items():
        dlgmd("batch", flights, *QUICK, *options, "--out", f"alone/{label}")
        assert files_of(f"dlgmd-out/{label}") == files_of(f"alone/{label}")
    (error,) = {line for line in result.stderr.splitlines() if "empty.mp4" in line}
    assert error.startswith("Error: empty.mp4: failed: ")
    # One more model: only that one is computed.
    before = mtime("dlgmd-out/set7/a/loom/run.yaml")
    dlgmd("batch", flights, *QUICK, *models, "--model", "emd-lgmd")
    assert mtime("dlgmd-out/set7/a/loom/run.yaml") == before
    assert statuses("dlgmd-out/emd-lgmd")["a/loom.avi"] == "done"


def test_one_model_may_fail_alone(dlgmd, tmp_path, here):
    write_video(tmp_path / "three.avi", looming_frames(3))
    result = dlgmd("batch", "three.avi", *QUICK, "--set", 2, "--set", 9, "-q")
    assert result.exit_code == 1
    assert statuses("dlgmd-out/set2") == {"three.avi": "done"}
    assert statuses("dlgmd-out/set9") == {"three.avi": "failed"}
    assert "Error: three.avi: set9: failed: 3 frames, but set9 needs at least 4." in result.stderr


def test_recorded_options_must_agree(dlgmd, runs, clips, here):
    runs("run", clips / "loom.avi", "--size", "16x12", "--out", "rec")
    config = ("--config", "rec/loom/run.yaml")
    runs("batch", clips / "loom.avi", *QUICK, *config)
    assert yaml_of("dlgmd-out/loom/run.yaml")["processed"]["width"] == 16
    result = dlgmd("batch", clips / "loom.avi", *QUICK, *config, "--set", 3)
    assert result.exit_code == 2 and "its recorded options differ" in result.stderr
    sized = (*config, "--set", 3, "--size", "8x8")
    runs("batch", clips / "loom.avi", *QUICK, *sized)


def test_json(dlgmd, flights, here):
    result = dlgmd("batch", flights, *QUICK, "--json")
    assert json.loads(result.stdout) == {
        "summary": os.path.join("dlgmd-out", "summary.csv"),
        "complete": True,
        "videos": 4,
        "already_done": 0,
        "status": {"done": 2, "failed": 2},
        "warnings": {},
    }
    result = dlgmd("batch", flights / "a", *QUICK, "--json", "--set", 1, "--set", 2, "--out", "o")
    assert json.loads(result.stdout)["summary"] == {
        "set1": os.path.join("o", "set1", "summary.csv"),
        "set2": os.path.join("o", "set2", "summary.csv"),
    }


def test_a_dry_run_writes_nothing(dlgmd, runs, flights, here):
    for video in flights.rglob("*.mkv"):
        video.unlink()
    line = ("batch", flights, *QUICK, "--set", 1, "--set", 2)
    result = runs(*line, "--dry-run")
    assert not Path("dlgmd-out").exists()
    assert os.path.join("dlgmd-out", "set2", "a", "loom") in result.stdout
    assert result.stdout.splitlines()[-1].startswith("3 videos: 3 to process, 0 done before")
    dlgmd(*line)
    made = {path: mtime(path) for path in Path("dlgmd-out").rglob("*")}
    facts = json.loads(runs(*line, "--dry-run", "--json").stdout)
    assert [video for video, folders in facts["to_do"].items() if folders] == ["empty.mp4"]
    assert {path: mtime(path) for path in Path("dlgmd-out").rglob("*")} == made


def test_warnings_and_a_folder_of_pictures(runs, pictures, cut, tmp_path, here):
    folder = tmp_path / "mixed"
    shutil.copytree(pictures, folder / "frames")
    shutil.move(cut, folder)
    result = runs("batch", folder, "--set", 9, *QUICK, "--input-fps", 30)
    assert result.stdout.splitlines()[-1].startswith("2 videos: 2 done, ")
    assert result.stdout.endswith(", 1 with warnings. Model: set9.\n")
    rows = summary()
    assert "cut off or damaged" in rows["cut.avi"]["warnings"]
    assert rows["frames"]["warnings"] == "" and rows["frames"]["frames"] == "12"
    facts = json.loads(
        runs("batch", folder, "--set", 9, *QUICK, "--input-fps", 30, "--json").stdout
    )
    assert facts["warnings"] == {"cut.avi": [rows["cut.avi"]["warnings"]]}


def test_a_folder_that_cannot_be_read_is_a_failure(dlgmd, flights, monkeypatch, here):
    def refusing(path, scandir=os.scandir):  # even for root
        if str(path).endswith(f"{os.sep}deep"):
            raise PermissionError(13, "Permission denied")
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    result = dlgmd("batch", flights / "a", *QUICK)
    assert result.exit_code == 1 and statuses() == {"loom.avi": "done"}
    warning, error = result.stderr.splitlines()
    assert f"{flights / 'a' / 'deep'}: this folder cannot be read (Permission denied)" in warning
    assert error.startswith("Error: some folders could not be read")


def test_a_second_batch_at_the_same_time(dlgmd, flights, here):
    with store.locked(Path("dlgmd-out")):
        result = dlgmd("batch", flights, *QUICK, "--force")
    assert result.exit_code == 2 and "another dlgmd command is writing here" in result.stderr
    assert not os.path.exists("dlgmd-out")


@pytest.mark.parametrize("kind", [cancel.Interrupted, KeyboardInterrupt])
def test_an_interrupt_keeps_what_is_done(dlgmd, flights, here, monkeypatch, kind):
    def check(seen=[]):  # noqa: B006, it counts
        seen.append(1)
        if len(seen) == 3:
            raise kind

    with monkeypatch.context() as patch:
        patch.setattr(cancel, "check", check)
        result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 130
    said = " 2 of 4 videos are done" if kind is cancel.Interrupted else "\n"
    assert result.stderr.startswith(f"Interrupted.{said}")
    assert list(statuses().values()) == ["done"] * 2
    result = dlgmd("batch", flights, *QUICK)
    assert "2 of 4 videos are done already." in result.stderr and len(statuses()) == 4


def test_a_summary_that_cannot_be_written(dlgmd, flights, here, monkeypatch):
    commit, calls = store.ClaimedFolder.commit, []

    def refusing(claim, files):
        if "summary.csv" in files:
            calls.append(claim.folder)
            if len(calls) in refused:
                files = {"summary.csv": full}
        return commit(claim, files)

    monkeypatch.setattr(
        "dlgmd_cli.tasks.batch.batch.SHARE_OF_TIME", math.inf
    )  # no write is postponed
    monkeypatch.setattr(store.ClaimedFolder, "commit", refusing)
    refused = {2, 3}  # in between: it is written later
    assert "Error: 2 of 4 videos failed" in dlgmd("batch", flights, *QUICK).stderr
    assert len(statuses()) == 4
    calls.clear()
    refused = {1}  # before it takes the time to compute
    result = dlgmd("batch", flights, *QUICK, "--force")
    assert result.exit_code == 1 and result.stderr.count("\n") == 1
    assert "summary.csv: cannot be written (No space left on device)" in result.stderr


def test_frames_are_counted_as_by_run(dlgmd, clips, here):
    alone = dlgmd("run", clips / "loom.avi", "--fps", 10, "--format=none", "--out", "a")
    many = dlgmd("batch", clips / "loom.avi", "--fps", 10, "--format=none", "--out", "b")
    assert "7 of 20 at 32x24" in alone.stdout and "done     7 of 20 " in many.stdout


def test_a_warning_about_several_videos_is_told_once(dlgmd, tmp_path, here):
    (tmp_path / "slow").mkdir()
    for name in "abc":
        write_video(tmp_path / f"slow/{name}.avi", looming_frames(), fps=5)
    both = ("--set", "flight", "--set", "flight-small")
    told = dlgmd("batch", "slow", *both, "--format=none", "--jobs", 1).stderr
    assert told.count("5 frames/s: expansion rates are unreliable") == 1
    assert "a.avi and 2 other videos: 5 frames/s" in told
