"""`dlgmd batch`: every video has its row, and none costs another its result."""

import csv
import json
import os
import re
import shutil
import sys
import threading
from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from conftest import looming_frames, write_video
from faulty import prepare, unprepared

from dlgmd_cli.batch.drive import drive
from dlgmd_cli.batch.events import Began, Ended
from dlgmd_cli.batch.find import find_videos
from dlgmd_cli.batch.local import LocalPool
from dlgmd_cli.batch.places import Folder
from dlgmd_cli.batch.resume import plan
from dlgmd_cli.batch.task import Order, Task, Variant, Video
from dlgmd_cli.batch.work import prepare as prepare_work
from dlgmd_cli.batch.work import process
from dlgmd_cli.errors import OutputError
from dlgmd_cli.parameters import DlgmdParameters
from dlgmd_cli.video.choice import InputChoice

COLUMNS = [
    "video",
    "status",
    "error",
    "frames",
    "width",
    "height",
    "fps",
    "duration_s",
    "mp_max",
    "mp_max_frame",
    "spikes",
    "collisions",
    "first_collision_frame",
    "first_collision_time_s",
    "mean_attenuation_db",
    "wall_s",
]
QUICK = ("--no-plots", "--jobs", 2)


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
    with Path(path, "summary.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert header == COLUMNS
    return {row[0]: dict(zip(header, row, strict=True)) for row in rows}


def statuses(path="dlgmd-out"):
    return {video: row["status"] for video, row in summary(path).items()}


def files_below(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in Path(folder).rglob("*")
        if path.is_file()
    }


def timeless(files):
    """Files without what the clock puts into them."""
    found = {}
    for name, content in files.items():
        if name.endswith("run.yaml"):
            content = re.sub(rb"(?m)^wall_s: .*$", b"", content)
        if name.endswith("summary.csv"):
            content = b"\n".join(line.rpartition(b",")[0] for line in content.splitlines())
        found[name] = content
    return found


def mtime(path):
    return Path(path).stat().st_mtime_ns


def test_a_tree_with_broken_files(dlgmd, flights):
    result = dlgmd("batch", flights, "--jobs", 2)
    assert result.exit_code == 1
    assert sorted(result.stderr.splitlines()) == [
        "Error: 2 of 4 videos failed, 2 are in dlgmd-out. Mend or drop those 2 and rerun.",
        "Warning: empty.mp4: failed: the file is empty. Copy or record it again.",
        "Warning: text.mkv: failed: no frame could be decoded, damaged file or missing codec. "
        "Try re-encoding it with ffmpeg.",
    ]
    assert result.stdout.splitlines()[-1] == os.path.join("dlgmd-out", "summary.csv")
    assert statuses() == {
        "a/deep/other.mp4": "done",
        "a/loom.avi": "done",
        "empty.mp4": "failed",
        "text.mkv": "failed",
    }
    assert list(summary()) == sorted(summary())
    results = {path.parent.as_posix() for path in Path("dlgmd-out").rglob("run.yaml")}
    assert results == {"dlgmd-out/a/loom", "dlgmd-out/a/deep/other"}
    assert not list(Path("dlgmd-out").rglob(".dlgmd*"))


def test_what_is_doubtful_is_said(dlgmd, clips, tmp_path):
    data = (clips / "loom.avi").read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) // 2])
    result = dlgmd("batch", "cut.avi", *QUICK, "--set", 1, "--set", 9)
    assert result.exit_code == 0
    record = yaml.safe_load(Path("dlgmd-out/set9/cut/run.yaml").read_text())
    (warning,) = record["warnings"]
    assert "frames" in warning and result.stderr == f"Warning: cut.avi: {warning}.\n"
    assert summary("dlgmd-out/set9")["cut.avi"]["error"] == ""


def test_rows_and_files_are_those_of_run(dlgmd, flights):
    assert dlgmd("batch", flights, "--jobs", 1, "--set", 4).exit_code == 1
    done = dlgmd("run", flights / "a/loom.avi", "--set", 4, "--out", "single", "--json")
    single = json.loads(done.stdout)
    ours, theirs = files_below("dlgmd-out/a/loom"), files_below("single/loom")
    for name in set(ours) - {"run.yaml"}:
        assert ours[name] == theirs[name], name
    assert ours.keys() == theirs.keys()
    record, other = (yaml.safe_load(files["run.yaml"]) for files in (ours, theirs))
    record.pop("wall_s")
    assert record == other
    row = summary()["a/loom.avi"]
    for key in COLUMNS[8:15]:
        assert row[key] == ("" if single[key] is None else f"{single[key]:.9g}"), key
    assert [row[key] for key in COLUMNS[3:8]] == ["20", "32", "24", "25", "0.8"]
    assert float(row["wall_s"]) > 0 and row["error"] == ""
    failed = summary()["empty.mp4"]
    assert failed["error"] == "the file is empty. Copy or record it again."
    assert all(failed[key] == "" for key in COLUMNS[3:15])


def test_the_record_is_a_config_of_run(dlgmd, clips):
    assert dlgmd("batch", clips / "loom.avi", *QUICK, "--size", "16x12").exit_code == 0
    result = dlgmd("run", clips / "loom.avi", "--config", "dlgmd-out/loom/run.yaml", "--out", "o")
    assert result.exit_code == 0
    for name in ("mp.csv", "spikes.csv"):
        assert Path("o/loom", name).read_bytes() == Path("dlgmd-out/loom", name).read_bytes()


def test_jobs_do_not_change_results(dlgmd, flights):
    dlgmd("batch", flights, "--no-plots", "--jobs", 1, "--out", "one")
    dlgmd("batch", flights, "--no-plots", "--jobs", 3, "--out", "three")
    dlgmd("batch", flights, "--no-plots", "--out", "default")
    assert timeless(files_below("one")) == timeless(files_below("three"))
    assert timeless(files_below("one")) == timeless(files_below("default"))


def test_what_is_done_is_skipped(dlgmd, flights):
    dlgmd("batch", flights, *QUICK)
    record = Path("dlgmd-out/a/loom/run.yaml")
    before, rows = mtime(record), summary()
    result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 1
    assert result.stderr.splitlines()[0] == "2 of 4 videos were done already."
    assert mtime(record) == before
    again = summary()
    for video in ("a/loom.avi", "a/deep/other.mp4"):
        assert again[video] == rows[video]  # its time, too
    (flights / "empty.mp4").unlink()
    (flights / "text.mkv").unlink()
    result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 0 and set(summary()) == {"a/loom.avi", "a/deep/other.mp4"}


def test_force_redoes_all(dlgmd, flights):
    dlgmd("batch", flights, *QUICK)
    before = mtime("dlgmd-out/a/loom/run.yaml")
    result = dlgmd("batch", flights, *QUICK, "--force")
    assert "done already" not in result.stderr
    assert mtime("dlgmd-out/a/loom/run.yaml") > before
    result = dlgmd("batch", flights, *QUICK, "--force", "--set", 3)
    assert "done already" not in result.stderr
    assert yaml.safe_load(Path("dlgmd-out/a/loom/run.yaml").read_text())["sigma_e"] != 1.5


def test_a_changed_input_is_redone(dlgmd, flights, clips):
    dlgmd("batch", flights, *QUICK)
    write_video(flights / "a/loom.avi", looming_frames(12))
    result = dlgmd("batch", flights, *QUICK)
    assert result.stderr.splitlines()[0] == "1 of 4 videos were done already."
    assert summary()["a/loom.avi"]["frames"] == "12"
    os.utime(flights / "a/loom.avi", ns=(0, 0))
    result = dlgmd("batch", flights, *QUICK)
    assert result.stderr.splitlines()[0] == "1 of 4 videos were done already."


@pytest.mark.parametrize(
    "spoil", ["table", "record", "text", "incomplete", "summary", "size", "nothing", "plots"]
)
def test_what_is_half_done_is_redone(dlgmd, flights, spoil):
    dlgmd("batch", flights, *QUICK)
    folder = Path("dlgmd-out/a/loom")
    whole, record = files_below(folder), folder / "run.yaml"
    if spoil == "table":
        (folder / "spikes.csv").unlink()
    elif spoil == "record":
        record.unlink()
    elif spoil == "text":
        record.write_bytes(record.read_bytes()[:200] + b"\x00\xff: [")
    elif spoil == "incomplete":
        record.write_text(record.read_text().replace("complete: true", "complete: false"))
    elif spoil == "summary":
        record.write_text(re.sub(r"(?m)^  collisions: .*\n", "", record.read_text()))
    elif spoil == "size":
        record.write_text(
            re.sub(r"(?m)^  duration_s: .*$", "  duration_s: [1]", record.read_text())
        )
    n_done = 1 if spoil not in ("nothing", "plots") else 2
    options = QUICK if spoil != "plots" else ("--jobs", 2, "--format", "svg")
    result = dlgmd("batch", flights, *options)
    if spoil == "plots":
        assert "done already" not in result.stderr and (folder / "mp.svg").exists()
        return
    assert result.stderr.splitlines()[0] == f"{n_done} of 4 videos were done already."
    assert timeless(files_below(folder)) == timeless(whole)


def test_a_result_of_run_counts(dlgmd, flights):
    dlgmd("run", flights / "a/loom.avi", "--no-plots", "--out", "dlgmd-out/a")
    result = dlgmd("batch", flights, *QUICK)
    assert result.stderr.splitlines()[0] == "1 of 4 videos were done already."
    assert summary()["a/loom.avi"]["wall_s"] == ""


def test_other_settings_are_not_replaced_unasked(dlgmd, flights):
    dlgmd("batch", flights, *QUICK, "--param", "sigma_e=1.2")
    before = files_below("dlgmd-out")
    for options, shown in (
        (("--param", "sigma_e=1.3"), "sigma_e"),
        ((), "sigma_e"),
        (("--param", "sigma_e=1.2", "--input-fps", 12), "--input-fps"),
        (("--param", "sigma_e=1.2", "--engine", "numba"), "engine"),
    ):
        result = dlgmd("batch", flights, *QUICK, *options)
        assert result.exit_code == 2
        assert result.stderr == (
            f"Error: {os.path.join('dlgmd-out', 'a', 'deep', 'other')}: a result of other settings "
            f"stands here ({shown}). Add --overwrite to replace such results, or choose another "
            "--out.\n"
        ).replace(os.path.join("a", "deep", "other"), "a/deep/other")
        assert files_below("dlgmd-out") == before
    result = dlgmd("batch", flights, *QUICK, "--param", "sigma_e=1.3", "--overwrite")
    assert "done already" not in result.stderr
    assert "sigma_e: 1.3" in Path("dlgmd-out/a/loom/run.yaml").read_text()
    result = dlgmd("batch", flights, *QUICK, "--param", "sigma_e=1.3", "--overwrite")
    assert "2 of 4 videos were done already." in result.stderr


def test_a_recorded_option_that_is_not_given_is_another_setting(dlgmd, flights):
    dlgmd("batch", flights, *QUICK, "--normalise", "sequence")
    result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 2 and "of other settings stands here (--normalise)" in result.stderr


def test_results_of_another_release_are_kept_and_said(dlgmd, flights):
    dlgmd("batch", flights, *QUICK)
    record = Path("dlgmd-out/a/loom/run.yaml")
    record.write_text(re.sub(r"(?m)^  dlgmd: .*$", "  dlgmd: 0.0.1", record.read_text()))
    result = dlgmd("batch", flights, *QUICK)
    assert result.stderr.splitlines()[:2] == [
        "2 of 4 videos were done already.",
        "Warning: 1 of the results are of another release; --force redoes all.",
    ]


def test_an_input_that_cannot_be_told_apart_is_redone(dlgmd, flights):
    dlgmd("batch", flights / "a", *QUICK)
    (known, *_) = find_videos([("", str(flights / "a"))]).videos
    variant = Variant("set9", DlgmdParameters(), "auto", Folder.named("dlgmd-out"))
    order = Order((variant,), InputChoice(), ())
    for video, n_tasks in ((known, 0), (replace(known, identity={}), 1)):
        assert len(plan([video], order, force=False, overwrite=False).tasks) == n_tasks


def test_another_input_of_the_same_name(dlgmd, flights, clips):
    dlgmd("batch", flights / "a", *QUICK)
    other = Path("other")
    other.mkdir()
    write_video(other / "loom.avi", looming_frames(15))
    result = dlgmd("batch", other, *QUICK)
    assert result.exit_code == 2
    assert "dlgmd-out/loom: the result of another input stands here" in result.stderr
    shutil.copy2(flights / "a" / "loom.avi", other / "loom.avi")  # the same, at another place
    result = dlgmd("batch", other, *QUICK)
    assert result.exit_code == 0 and "1 of 1 videos were done already." in result.stderr


def test_several_models_decode_once(dlgmd, flights):
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
        assert timeless(files_below(f"dlgmd-out/{label}")) == timeless(
            files_below(f"alone/{label}")
        )
    (warning,) = {line for line in result.stderr.splitlines() if "empty.mp4" in line}
    assert warning.startswith("Warning: empty.mp4: failed: ")
    # One more model: only that one is computed.
    before = mtime("dlgmd-out/set7/a/loom/run.yaml")
    result = dlgmd("batch", flights, *QUICK, *models, "--model", "emd-lgmd")
    assert mtime("dlgmd-out/set7/a/loom/run.yaml") == before
    assert statuses("dlgmd-out/emd-lgmd")["a/loom.avi"] == "done"


def test_one_model_may_fail_alone(dlgmd, tmp_path):
    write_video(tmp_path / "three.avi", looming_frames(3))
    result = dlgmd("batch", "three.avi", *QUICK, "--set", 2, "--set", 9)
    assert result.exit_code == 1
    assert statuses("dlgmd-out/set2") == {"three.avi": "done"}
    assert statuses("dlgmd-out/set9") == {"three.avi": "failed"}
    assert "Warning: three.avi: set9: failed: 3 frames, but set9 needs at least 4." in result.stderr


def test_recorded_options_must_agree(dlgmd, clips):
    dlgmd("run", clips / "loom.avi", "--size", "16x12", "--out", "rec", "--no-plots")
    config = "rec/loom/run.yaml"
    assert dlgmd("batch", clips / "loom.avi", *QUICK, "--config", config).exit_code == 0
    assert yaml.safe_load(Path("dlgmd-out/loom/run.yaml").read_text())["processed"]["width"] == 16
    result = dlgmd("batch", clips / "loom.avi", *QUICK, "--config", config, "--set", 3)
    assert result.exit_code == 2 and "the options that it records differ" in result.stderr
    result = dlgmd(
        "batch", clips / "loom.avi", *QUICK, "--config", config, "--set", 3, "--size", "8x8"
    )
    assert result.exit_code == 0


def test_json(dlgmd, flights):
    result = dlgmd("batch", flights, *QUICK, "--json")
    assert json.loads(result.stdout) == {
        "summary": os.path.join("dlgmd-out", "summary.csv"),
        "complete": True,
        "videos": 4,
        "already_done": 0,
        "status": {"done": 2, "failed": 2},
    }
    result = dlgmd("batch", flights / "a", *QUICK, "--json", "--set", 1, "--set", 2, "--out", "o")
    assert json.loads(result.stdout)["summary"] == {
        "set1": os.path.join("o", "set1", "summary.csv"),
        "set2": os.path.join("o", "set2", "summary.csv"),
    }


USAGE = [
    ([], "Missing argument 'FOLDER...'"),
    (["flights", "--jobs", 0], "Invalid value for '--jobs'"),
    (["flights", "--timeout", 0], "Invalid value for '--timeout'"),
    (["flights", "--timeout", "nan"], "Invalid value for '--timeout'"),
    (["flights", "--set", 12], "there is no set 12"),
    (["flights", "--jobs", 2, "--scheduler", "tcp://x:1"], "--jobs is of this machine"),
    (["flights", "--out", ""], "--out is no name of a folder"),
    (["flights", "--scale", 1, "--size", "9x9"], "--scale and --size exclude each other"),
    (["flights", "--param", "sigma_x=1"], "unknown parameter 'sigma_x'"),
    (["flights", "--model", "lgmd", "--formulation", "released"], "--formulation is of the D-LGMD"),
]


@pytest.mark.parametrize(("arguments", "message"), USAGE)
def test_usage_errors(dlgmd, flights, arguments, message):
    result = dlgmd("batch", *arguments)
    assert result.exit_code == 2 and message in result.stderr
    assert not Path("dlgmd-out").exists()


def test_nothing_to_do(dlgmd, tmp_path):
    (tmp_path / "bare").mkdir()
    result = dlgmd("batch", "bare")
    assert (result.exit_code, result.stderr) == (
        1,
        "Error: bare: there is no video. Give folders with .mp4, .avi, .mkv and the like.\n",
    )
    result = dlgmd("batch", "none")
    assert (result.exit_code, result.stderr) == (
        1,
        "Error: none: it cannot be read (No such file or directory). Check the path.\n",
    )
    assert sorted(os.listdir()) == ["bare"]


def test_an_unusable_out(dlgmd, flights):
    Path("file").touch()
    for out in ("file", "file/below"):
        result = dlgmd("batch", flights, *QUICK, "--out", out)
        assert result.exit_code == 1
        assert result.stderr.startswith(f"Error: {out}: it cannot be written (")


def test_a_folder_of_others_is_left_alone(dlgmd, flights):
    stranger = Path("dlgmd-out/a/loom/thesis.tex")
    stranger.parent.mkdir(parents=True)
    stranger.touch()
    assert dlgmd("batch", flights, *QUICK).exit_code == 1
    row = summary()["a/loom.avi"]
    assert row["status"] == "failed"
    assert row["error"].startswith("this folder holds other files, such as thesis.tex")
    assert os.listdir("dlgmd-out/a/loom") == ["thesis.tex"]
    assert statuses()["a/deep/other.mp4"] == "done"


def test_a_folder_that_cannot_be_read_is_a_failure(dlgmd, flights, refuse_folder):
    refuse_folder("deep")
    result = dlgmd("batch", flights / "a", *QUICK)
    assert result.exit_code == 1 and statuses() == {"loom.avi": "done"}
    assert result.stderr.splitlines() == [
        f"Warning: {flights / 'a' / 'deep'}: this folder cannot be read (Permission denied); its "
        "videos are left out.",
        "Error: not every folder could be read; what was found is in dlgmd-out. Mend its access "
        "rights and rerun.",
    ]


@pytest.mark.skipif(sys.platform == "win32", reason="its locks are others")
def test_a_second_batch_at_the_same_time(dlgmd, flights):
    dlgmd("batch", flights, *QUICK)
    before = files_below("dlgmd-out")
    with Folder.named("dlgmd-out").locked():
        result = dlgmd("batch", flights, *QUICK, "--force")
    assert (result.exit_code, result.stderr) == (
        2,
        "Error: dlgmd-out: another 'dlgmd batch' is writing here. Wait for it, or choose another "
        "--out.\n",
    )
    assert files_below("dlgmd-out") == before


def test_two_batches_without_locks(dlgmd, flights, tmp_path, monkeypatch):
    """On a file system without locks both work on the same results: each is whole."""
    dlgmd("batch", flights, *QUICK, "--out", "undisturbed")
    monkeypatch.setattr("dlgmd_cli.batch.places.fcntl", None)
    threads = [
        threading.Thread(target=drive_alone, args=(flights, tmp_path / "dlgmd-out"))
        for _ in range(3)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    result = dlgmd("batch", flights, *QUICK)
    assert "2 of 4 videos were done already." in result.stderr
    assert timeless(files_below("dlgmd-out")) == timeless(files_below("undisturbed"))


def drive_alone(flights, out):
    """A batch without a command around it, for a thread of its own."""
    place = Folder.named(str(out))
    place.prepare()
    order = Order((Variant("set9", DlgmdParameters(), "auto", place),), InputChoice(), ())
    with place.locked():
        made = plan(find_videos([("", str(flights))]).videos, order, force=True, overwrite=True)
        drive(made, LocalPool(order, 2), lambda event: None)


FAULTS = {
    "segfault.avi": ("crashed", "its process crashed: it was killed by signal 11"),
    "abort.avi": ("crashed", "it was killed by signal 6 (\\x1b[31m  'cv::Exception')"),
    "exits.avi": ("crashed", "its process crashed: it ended with exit code 3"),
    "killed.avi": ("killed", "its process was killed, as happens when memory runs out"),
    "hangs.avi": ("timeout", "it took more than 1.5 s. Give it more with --timeout."),
    "bug.avi": ("failed", "internal error (IndexError)"),
}


def test_what_plots_need_is_there_before_the_first_video(monkeypatch):
    imported = []
    monkeypatch.setattr("dlgmd_cli.batch.work.import_module", imported.append)
    monkeypatch.setattr("dlgmd_cli.batch.work.limit_threads", lambda count: None)
    prepare_work(Order((), InputChoice(), ("png",)))
    assert imported == ["dlgmd_cli.plots.traces"]
    prepare_work(Order((), InputChoice(), ()))
    assert len(imported) == 1


@pytest.mark.parametrize("jobs", [1, 2])
def test_so_many_videos_at_a_time(monkeypatch, jobs):
    monkeypatch.setattr("dlgmd_cli.batch.attend.prepare", prepare)
    tasks = [Task(Video(f"hangs{n}", f"/hangs{n}", f"hangs{n}"), (0,)) for n in range(2)]
    pool = LocalPool(Order((), InputChoice(), ()), jobs, timeout_s=0.5)
    n_running, most, pids = 0, 0, set()
    with pool:
        for event in pool.work_on(tasks):
            n_running += isinstance(event, Began) - isinstance(event, Ended)
            most = max(most, n_running)
            pids |= {worker.pid for worker in pool._attendants}
    assert (n_running, most) == (0, jobs)
    for pid in pids:  # none hangs on
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_a_summary_that_cannot_be_written_now_is_written_later(dlgmd, flights, monkeypatch):
    write_text, n_refused = Folder.write_text, []

    def refusing(self, name, text):
        if len(n_refused) < 2:
            n_refused.append(1)
            raise OutputError(name, "no room for a moment")
        write_text(self, name, text)

    monkeypatch.setattr(Folder, "write_text", refusing)
    result = dlgmd("batch", flights, *QUICK)
    assert "Error: 2 of 4 videos failed" in result.stderr and len(statuses()) == 4
    n_refused.clear()
    monkeypatch.setattr(Folder, "write_text", lambda *_: refusing(n_refused.clear(), "x", ""))
    result = dlgmd("batch", flights, *QUICK, "--force")
    assert result.exit_code == 1 and result.stderr.endswith("Error: x: no room for a moment.\n")


def test_what_may_not_be_replaced_is_not_even_decoded(tmp_path, monkeypatch):
    (tmp_path / "loom").mkdir()
    (tmp_path / "loom" / "thesis.tex").touch()
    monkeypatch.setattr(InputChoice, "open", lambda *_: pytest.fail("decoded"))
    variant = Variant("set9", DlgmdParameters(), "auto", Folder.named(str(tmp_path)))
    task = Task(Video("loom.avi", "/loom.avi", "loom"), (0,))
    outcome = process(Order((variant,), InputChoice(), ()), task)
    assert outcome[0].error.startswith("this folder holds other files, such as thesis.tex")


@pytest.mark.skipif(sys.platform == "win32", reason="signals differ on Windows")
@pytest.mark.parametrize("jobs", [1, 3])
def test_a_decoder_takes_only_its_own_video_along(dlgmd, clips, tmp_path, monkeypatch, jobs):
    monkeypatch.setattr("dlgmd_cli.batch.attend.prepare", prepare)
    folder = tmp_path / "flights"
    folder.mkdir()
    for name in (*FAULTS, "first.avi", "good.avi", "last.avi", "zenith.avi"):
        shutil.copy(clips / "loom.avi", folder / name)
    result = dlgmd("batch", folder, "--no-plots", "--jobs", jobs, "--timeout", 1.5)
    assert result.exit_code == 1
    assert "Error: 6 of 10 videos failed, 4 are in dlgmd-out." in result.stderr
    rows = summary()
    assert len(rows) == 10
    for name, row in rows.items():
        status, error = FAULTS.get(name, ("done", ""))
        assert row["status"] == status and error in row["error"], row
        assert Path("dlgmd-out", Path(name).stem).exists() == (status == "done")
    assert float(rows["hangs.avi"]["wall_s"]) >= 1.5
    assert sorted(os.listdir("dlgmd-out")) == ["first", "good", "last", "summary.csv", "zenith"]
    # The same command, where nothing of the kind happens, does what is left.
    monkeypatch.undo()
    os.chdir(tmp_path)
    result = dlgmd("batch", folder, *QUICK)
    assert result.exit_code == 0 and "4 of 10 videos were done already." in result.stderr
    assert set(statuses().values()) == {"done"}


def test_a_process_that_cannot_even_begin(dlgmd, flights, monkeypatch):
    monkeypatch.setattr("dlgmd_cli.batch.attend.prepare", unprepared)
    result = dlgmd("batch", flights, *QUICK)
    assert result.exit_code == 1
    assert {row["error"] for row in summary().values()} == {
        "internal error (ImportError). 'dlgmd --debug run' shows more."
    }


def test_a_silent_process_is_ended(dlgmd, clips, monkeypatch):
    monkeypatch.setattr("dlgmd_cli.batch.attend.prepare", prepare)
    monkeypatch.setattr("dlgmd_cli.batch.attend.STALL_S", 1.0)
    shutil.copy(clips / "loom.avi", "hangs.avi")
    assert dlgmd("batch", "hangs.avi", *QUICK).exit_code == 1
    (row,) = summary().values()
    assert row["status"] == "timeout" and row["error"].startswith("nothing happened for 1 s.")
