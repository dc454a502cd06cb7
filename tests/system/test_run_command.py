"""`dlgmd run`: its files, options, errors and exit codes."""

import hashlib
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest
from conftest import FPS, N_FRAMES, csv_rows, looming_frames, result_of_level, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli import DLGMD, load_set
from dlgmd_cli.errors import MissingExtraError, SourceError
from dlgmd_cli.models.detection import AlarmSpan
from dlgmd_cli.models.rules import rule_of
from dlgmd_cli.results import csv
from dlgmd_cli.results.files import RUN, names_of
from dlgmd_cli.results.result import listed

# Versions that every record has.
NUMERIC = {"dlgmd", "python", "numpy", "opencv"}


def test_files_and_columns(runs, clips, tmp_path):
    result = runs("run", clips / "loom.avi", plots=True)
    folder = tmp_path / "dlgmd-out" / "loom"
    assert os.listdir(folder.parent) == ["loom"]
    assert result.stdout.splitlines()[-1] == os.path.join("dlgmd-out", "loom")
    assert {*os.listdir(folder)} == names_of(RUN, ["png"])
    for name, header in csv.headers().items():
        lines = (folder / name).read_text().splitlines()
        assert lines[0] == ",".join(header) and len(lines) == 1 + N_FRAMES
        assert [int(line.split(",")[0]) for line in lines[1:]] == list(range(N_FRAMES))


def test_the_table_and_json_list_the_alarms(dlgmd, runs, tmp_path):
    """Two approaches from the left, and a stretch of rest between them."""
    looms = [np.pad(frame, ((0, 0), (0, 64)), constant_values=215) for frame in looming_frames(24)]
    write_video(tmp_path / "looms.avi", [*looms, *looms[-1:] * 10, *looms])
    options = ["looms.avi", "--set", 3, "--param", "kappa=1e-5", "--format=none"]
    facts = json.loads(runs("run", *options, "--json").stdout)
    rows = csv_rows(tmp_path / "dlgmd-out/looms/alarms.csv")
    assert len(facts["alarm_list"]) == facts["alarms"] == len(rows) >= 2
    for one, row in zip(facts["alarm_list"], rows, strict=True):
        assert list(one) == list(row) and one["side"] == row["side"] == "left"
        assert one["start_s"] == pytest.approx(float(row["start_s"]))
        assert str(one["end_frame"]) == row["end_frame"]
    table = dlgmd("run", *options, "--overwrite").stdout
    first = facts["alarm_list"][0]
    line = f"{first['start_s']:.3f} to {first['end_s']:.3f} s, frames {first['start_frame']} to"
    words = " ".join(table.split())
    assert line in words and f"{first['side']}, " in words


def test_the_table_lists_five_alarms_at_most():
    rule = rule_of(load_set(9))
    alarms = [AlarmSpan(n, n / 30, n + 2, (n + 2) / 30, 0.5) for n in range(0, 140, 20)]
    *lines, last = listed(alarms, rule)
    assert len(lines) == 5 and last == "and 2 more in alarms.csv"
    assert lines[1] == "0.667 to 0.733 s, frames 20 to 22, normalised MP up to 0.50"
    assert len(listed(alarms[:5], rule)) == 5 and listed([], rule) == []


def test_run_yaml(runs, clips):
    options = ["--set", 9, "--size", "20x16", "--param", "r=3"]
    runs("run", clips / "loom.avi", *options)
    record = yaml_of("dlgmd-out/loom/run.yaml")
    assert record["input"] == {
        "path": str(clips / "loom.avi"),
        "name": "loom",
        "width": 32,
        "height": 24,
        "fps": FPS,
        "frames": N_FRAMES,
        "duration_s": pytest.approx(N_FRAMES / FPS),
        "decoder": "opencv",
        "repeats": 0,
        "bytes": (clips / "loom.avi").stat().st_size,
        "mtime_ns": (clips / "loom.avi").stat().st_mtime_ns,
        "content_sha256": hashlib.sha256((clips / "loom.avi").read_bytes()).hexdigest(),
    }
    assert record["schema"] == 3
    assert record["processed"] == {"width": 20, "height": 16, "frames": N_FRAMES}
    assert (record["model"], record["formulation"], record["r"]) == ("dlgmd", "default", 3)
    assert "engine" not in record
    assert record.keys() >= load_set(9).to_dict().keys()
    assert record["complete"] is True
    assert record["machine"]["cpu"] and record["machine"]["os"]
    assert set(record["versions"]) - {"commit"} == {*NUMERIC, "ffmpeg"}
    numbers = "mp_max mp_max_frame mp_max_time_s spikes first_spike_time_s rule alarms "
    numbers += "first_alarm_frame first_alarm_time_s first_alarm_ttc_s first_alarm_side "
    numbers += "blind_share mean_attenuation_db attenuation_frames median_attenuation_db "
    numbers += "pooled_attenuation_db"
    assert set(record["summary"]) == set(numbers.split())


def test_options_are_recorded_and_outdone_by_the_command_line(runs, clips):
    pytest.importorskip("av", reason="one of the options is --decoder pyav")
    options = ["--scale", 0.75, "--fps", 12.5, "--start", "0.1", "--end", "00:00:00.7"]
    options += ["--normalise", "sequence", "--decoder", "pyav"]
    runs("run", clips / "loom.avi", *options, "--out", "one")
    first = yaml_of("one/loom/run.yaml")
    assert first["input"]["decoder"] == first["options"]["decoder"] == "pyav"
    assert "av" in first["versions"]
    rows = csv_rows("one/loom/mp.csv")
    assert [int(row["frame"]) for row in rows] == list(range(3, 18, 2))
    over = ["--size", "16x12", "--out", "two", "--normalise", "absolute"]
    runs("run", clips / "loom.avi", "--config", "one/loom/run.yaml", *over)
    record = yaml_of("two/loom/run.yaml")
    assert record["processed"]["width"] == 16 and record["options"]["normalise"] == "absolute"


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ('model: "\\e[2J\\x9b\\0"', r"there is no model '\x1b[2J\x9b\x00'."),
        ("options: {scale: 0.5, size: 4x4}", "options: --scale and --size exclude"),
        ("options: {pace: 1}", "unknown option 'pace' under 'options'"),
        ('options: {"\\e[2J": 1}', r"unknown option '\x1b[2J' under 'options'."),
        (f"options: {{? 0x{'f' * 5000} : 1}}", "unknown option a huge number under"),
        ("options: {size: big}", "options: 'big' is not WIDTHxHEIGHT"),
        ("options: {size: [480, 270]}", "is not WIDTHxHEIGHT. Write 480x270."),
        ("options: {scale: [1]}", "options: --scale = a list or mapping is not a number"),
        ("options: {fps: .nan}", "options: --fps = nan is not a finite number"),
        (f"options: {{fps: 0x{'f' * 5000}}}", "options: --fps = a huge number is not"),
        (f"options: {{start: '{'9' * 400}'}}", "options: --start = inf is not a finite number"),
        ("options: {decoder: vlc}", "options: --decoder = 'vlc' is not one of opencv, pyav"),
    ],
)
def test_what_a_config_may_not_say(dlgmd, clips, tmp_path, text, why):
    (tmp_path / "my.yaml").write_text(text)
    result = dlgmd("run", clips / "loom.avi", "--config", "my.yaml")
    line = result.stderr.splitlines()[-1]
    assert result.exit_code == 2 and line.startswith("Error: my.yaml: ") and why in line
    assert line.isprintable() and len(line) < 250


def test_a_warning_is_recorded(runs, cut):
    result = runs("run", cut, "--json")
    (warning,) = json.loads(result.stdout)["warnings"]
    assert f"of about {N_FRAMES} frames" in warning
    assert f"Warning: {cut}: {warning}." in result.stderr
    record = yaml_of("dlgmd-out/cut/run.yaml")
    assert record["warnings"] == [warning]
    assert (record["complete"], record["interrupted"]) == (False, False)
    facts = json.loads(runs("compare", cut, "--json", "--out", "b").stdout)
    assert warning in facts["warnings"]


def test_a_stop_before_the_first_frame_writes_nothing(dlgmd, clips, monkeypatch, stop):
    monkeypatch.setattr("dlgmd_cli.tasks.stepping.responses", lambda *_, **__: stop() or [])
    result = dlgmd("run", clips / "loom.avi")
    assert result.exit_code == 130 and os.listdir(".") == []


def test_a_bug_is_one_line(dlgmd, clips, monkeypatch):
    def broken(self, *arguments, **options):
        raise IndexError("inner secret")

    monkeypatch.setattr(DLGMD, "step", broken)
    result = dlgmd("run", clips / "loom.avi", "--set", 9)
    assert result.exit_code == 1
    assert result.stderr == (
        "Error: internal error (IndexError). Rerun with --debug and report the traceback.\n"
    )
    assert os.listdir(".") == []
    assert isinstance(dlgmd("--debug", "run", clips / "loom.avi", "--set", 9).exception, IndexError)


def test_a_repeated_run_tells_of_other_content(dlgmd, runs, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    frames = np.stack(looming_frames())
    np.save("x.npy", frames)
    runs("run", "x.npy", "--set", 9, "--out", "one")
    repeated = "--config", "one/x/run.yaml", "--out", "two", "--overwrite"
    assert "content" not in dlgmd("run", "x.npy", *repeated).stderr
    np.save("x.npy", frames[::-1])
    np.save("y.npy", frames[::-1])
    told = "x is not the file of one/x/run.yaml: its content differs (SHA-256)"
    assert told in dlgmd("run", "x.npy", *repeated).stderr
    assert told in yaml_of("two/x/run.yaml")["warnings"]
    assert "content" not in dlgmd("run", "y.npy", *repeated).stderr


def test_local_files_are_hashed_unless_they_are_large_or_raw(clips, tmp_path, monkeypatch):
    """What is asked for is done; an array has no file."""

    def is_hashed(video, hashed=None):
        result = dlgmd_cli.run(video, 7, hashed=hashed)
        assert "hashed" not in result.record["options"]
        return "content_sha256" in result.record["input"]

    monkeypatch.chdir(tmp_path)
    video = clips / "loom.avi"
    assert [is_hashed(video, hashed) for hashed in (None, True, False)] == [True, True, False]
    frames = np.stack(looming_frames())
    np.save("array.npy", frames)
    assert [is_hashed("array.npy"), is_hashed("array.npy", False)] == [True, False]
    assert not is_hashed(frames)
    write_video("raw.avi", looming_frames(), fourcc="I420")
    monkeypatch.setattr("dlgmd_cli.tasks.describing.HASHED_BYTES", video.stat().st_size - 1)
    assert not is_hashed(video) and is_hashed(video, True) and not is_hashed("raw.avi")


@pytest.mark.parametrize(
    ("more", "is_warned"),
    [
        ([], False),
        (["--param", "formulation=released-2021"], False),
        (["--param", "formulation=equations"], True),
        (["--param", "saturate=false"], True),
        (["--param", "formulation=equations", "--param", "kappa=0.02"], False),
        (["--param", "formulation=equations", "--normalise", "sequence"], False),
    ],
)
def test_a_kappa_of_another_formulation_is_doubted(runs, clips, more, is_warned):
    result = runs("run", clips / "loom.avi", "--set", 9, *more)
    assert ("kappa 0.0028 was calibrated" in result.stderr) == is_warned


@pytest.mark.parametrize(
    ("options", "is_whole"),
    [
        *(({}, True), ({"end": 9}, True), ({"fps": 12}, True), ({"crop": "20x10+0+0"}, True)),
        *(({"end": 0.5}, False), ({"start": 0.1}, False)),
    ],
)
def test_complete_says_whether_all_of_the_input_was_used(clips, options, is_whole):
    result = dlgmd_cli.run(clips / "loom.avi", 3, **options)
    assert (result.complete, result.interrupted) == (is_whole, False)
    ((_, rows),) = result.shown()
    part = f", only {result.time_s[0]:.3f} to {result.time_s[-1]:.3f} s of the input"
    assert dict(rows)["frames"].endswith(part) != is_whole


def test_a_part_of_a_video_is_done_and_says_so(runs, clips):
    Path("part.yaml").write_text("preset: flight\noptions: {end: 0.5}\n")
    options = ("--config", "part.yaml", "--json")
    assert json.loads(runs("run", clips / "loom.avi", *options).stdout)["complete"] is False
    record = yaml_of("dlgmd-out/loom/run.yaml")
    assert (record["complete"], record["interrupted"]) == (False, False)
    for n_before in (0, 1):
        done = json.loads(runs("batch", clips / "loom.avi", *options, "--out", "b").stdout)
        assert (done["complete"], done["already_done"]) == (True, n_before)
        (row,) = csv_rows("b/summary.csv")
        assert (row["status"], row["complete"]) == ("done", "0")


def test_an_image_at_fault_loses_no_earlier_row(tmp_path):
    frames = looming_frames(12)

    def images():
        yield from frames
        yield frames[0][:5]

    with pytest.raises(SourceError, match="frame 12 is uint8 of shape") as caught:
        dlgmd_cli.run(images(), [3, "lgmd"])
    whole = dlgmd_cli.run(frames, [3, "lgmd"])
    for kept, result in zip(caught.value.results, whole, strict=True):
        assert np.array_equal(kept.mp, result.mp, equal_nan=True) and result.complete
        assert (kept.complete, kept.interrupted, len(kept)) == (False, False, 12)
    assert "an array has no times" in whole[0].warnings[0]
    assert repr(whole[0]).endswith(", 1 warning>")


def test_to_dataframe_needs_pandas(monkeypatch):
    pandas = pytest.importorskip("pandas", reason="pandas is not installed")
    result = result_of_level([0.1, 0.5, 0.5])
    table = result.to_dataframe()
    assert isinstance(table, pandas.DataFrame)
    assert table["alarm"].tolist() == [False, False, True]
    assert {*table.columns} == csv.KNOWN
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match=r"pip install '\.\[pandas\]'"):
        result.to_dataframe()
