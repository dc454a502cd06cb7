"""The true times of frames: a rate that the video does not state, and a table of times."""

import numpy as np
import pytest
from conftest import looming_frames, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.video.given_times import read_times
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.timestamps import FrameClock

# 20 frames at 500 a second, with a pause of 1 s before frame 12.
TIMES_S = np.arange(20) / 500 + np.where(np.arange(20) < 12, 0.0, 1.0)


def table(path, times=TIMES_S, head="time_s"):
    path.write_text("\n".join([head, *(f"{time:.6f}" for time in times)]) + "\n")
    return path


@pytest.mark.parametrize("head", ["time_s", "t", "Time Stamp (ms)", "time_ms"])
def test_a_table_of_times_is_the_clock(clips, tmp_path, monkeypatch, decoder, head):
    monkeypatch.setattr(FrameClock, "report", lambda _: "the file's own times are mended")
    scale = 1000 if "ms" in head else 1
    path = table(tmp_path / "x.csv", TIMES_S * scale, head)
    with open_video(clips / "loom.avi", times=path, decoder=decoder) as video:
        frames = list(video)
    np.testing.assert_allclose([frame.time_s for frame in frames], TIMES_S, atol=1e-9)
    assert [frame.index for frame in frames if frame.after_gap] == [12]
    assert video.info.fps == pytest.approx(500)
    assert not video.progress.damage and "mended" not in str(video.progress.warnings)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (
            "time_s\n0\n1\n0.5\n\n",
            "line 4, column time_s: frame 2 is at 0.5, not after the one before, 1",
        ),
        ("time_s\n0\n1\n\n2\n", "frame 2 has no time"),
        ("time_s\n \n0\n1\n", "frame 0 has no time"),
        ("0\n1\n2\n", "is not a table with a column of times"),
        ("frame\n1\n2\n", "is not a table with a column of times: it has the columns frame"),
        ("# timecode format v2\n", "has fewer than two times"),
        ("frame,time_s\n0,0\n1,\n2,1\n", "frame 1 has no time"),
        ("frame,time_s\n0,0\n1\n2,1\n", "frame 1 has no time"),
        ("a,b\n0,0\n", "is not a table with a column of times"),
        ("", "is not a table with a column of times"),
        ("t\n0\n", "has fewer than two times"),
        ("t\n0\n1\n2\n", "has 3 times, fewer than the video has frames"),
    ],
)
def test_what_is_missing_or_runs_backwards_is_refused(clips, tmp_path, text, why):
    (tmp_path / "x.csv").write_text(text)
    with (
        pytest.raises(ParameterError, match=why),
        open_video(clips / "loom.avi", times=tmp_path / "x.csv") as video,
    ):
        list(video)


def test_more_times_than_frames_are_reported(clips, tmp_path):
    path = table(tmp_path / "x.csv", np.arange(22) / 500)
    with open_video(clips / "loom.avi", times=path) as video:
        list(video)
    assert any("has 2 times more than the video has frames" in w for w in video.progress.warnings)


def test_a_rate_and_a_table_exclude_each_other(clips, tmp_path):
    with pytest.raises(ParameterError, match="times and input_fps exclude each other"):
        open_video(clips / "loom.avi", times=table(tmp_path / "x.csv"), input_fps=500)


def test_a_cut_file_is_still_found(tmp_path):
    whole = write_video(tmp_path / "x.avi", looming_frames(40)).read_bytes()
    (tmp_path / "x.avi").write_bytes(whole[: len(whole) * 3 // 4])
    with open_video(tmp_path / "x.avi", input_fps=500) as video:
        n_frames = len(list(video))
    assert n_frames < 40
    assert any("cut off" in line for line in video.progress.damage)


# A table of 3 frames, and the time of the last, which follows the first by one or two steps.
@pytest.mark.parametrize(
    ("text", "last_s"),
    [
        ("# timecode format v2\n0\n33.37\n66.73\n", 0.06673),
        ("# timestamp format v2\n0\n33,37\n66,73\n", 0.06673),
        ("timestamp_us\n0\n33333\n66666\n", 0.066666),
        ("t [ns];n\n5000000000;0\n5040000000;1\n5080000000;2\n", 0.08),
        ("t [µs]\n0\n40000\n80000\n", 0.08),
        ("Frame Number,Time Stamp (ms),Buffer Index\n0,26,0\n1,59,0\n2,92,1\n", 0.066),
        ("frame,time\n-,ms\n0,0\n1,40\n2,80\n", 0.08),
        ("captureTimeMs\n0\n40\n80\n", 0.08),
        ("frame,speed_m_s,exposure_us,time_s\n0,3,9,0\n1,3,9,0.04\n2,3,9,0.08\n", 0.08),
        ("time_s\n0\n0,04\n0,08\n", 0.08),
        ("0\n0.04\n0.08\n", 0.08),
        ("time\n00:59:59.98\n01:00:00.02\n01:00:00.06\n", 0.08),
        ("time (min)\n0\n1\n2\n", 120.0),
        ("SensorTimestamp\n123456000000000\n123456040000000\n123456080000000\n", 0.08),
    ],
)
def test_the_unit_of_a_clock(tmp_path, text, last_s):
    (tmp_path / "x.csv").write_text(text, encoding="utf-8")
    times_s = read_times(tmp_path / "x.csv").table
    assert times_s[0] == 0.0 and times_s[-1] == pytest.approx(last_s, abs=1e-12)


UNIX = "2023-11-14T22:13:20.000000Z"


@pytest.mark.parametrize(
    ("times", "start"),
    [
        (("1700000000", "1700000000.0400001", "1700000000.08"), UNIX),
        (("1700000000000", "1700000000040", "1700000000080"), UNIX),
        (("1700000000000000000", "1700000000040000100", "1700000000080000000"), UNIX),
        (("2023-11-14T22:13:20Z", "2023-11-14 22:13:20.0400001", "2023/11/14 22:13:20,08"), UNIX),
        (("2023-11-14T23:13:20+01:00", "2023-11-14T22:13:20.04Z", "2023-11-14T22:13:20.08"), UNIX),
        (("100000.5", "100000.54", "100000.58"), 100000.5),
    ],
)
def test_an_absolute_clock_counts_from_the_first_frame(tmp_path, times, start):
    path = tmp_path / "x.csv"
    path.write_text("\n".join(["timestamp", *times]))
    result = dlgmd_cli.run(looming_frames(3), "lgmd", times=path, out=tmp_path)
    np.testing.assert_allclose(result.time_s, [0.0, 0.04, 0.08], atol=1e-6)
    kept = yaml_of(*tmp_path.rglob("run.yaml"))["input"]
    assert start in (kept.get("start_time_utc"), kept.get("clock_offset_s"))
    assert kept["duration_s"] == pytest.approx(0.12)


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("t\n0\n33\n67\n", "33.5 s means 0.0299 frames/s. Write the unit .*: time_ms .29.9 frames"),
        ("t\n0\n60\n120\n", "time_ms .16.7 frames/s.; time_s, if it is so slow"),
        ("t\n0\n500\n1000\n", "time_ms .2 frames/s. or time_us .2e.03 frames/s."),
        ("0\n33333\n66667\n", "its only column: .* time_us"),
        ("time_s\n0\n1e-9\n2e-9\n", "means 1e.09 frames/s"),
        ("time_ms\n0\n0.1\n0.2\n", "means 1e.04 frames/s"),
        ("# timecode format v1\nassume 30\n", "timecode format v1, of which only v2 is read"),
        ("time_s\n0\nsoon\n", "line 3, column time_s: 'soon' is no number. Write 12.5, or a time"),
    ],
)
def test_a_step_that_no_camera_has_is_refused_with_the_units_that_fit(tmp_path, text, why):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(ParameterError, match=why):
        read_times(tmp_path / "x.csv")


def test_a_rate_that_is_a_time_base_is_refused(dlgmd, clips):
    done = dlgmd("run", clips / "loom.avi", "--input-fps", "90000")
    assert done.exit_code == 2 and "90000" in done.stderr and "more than 5000" in done.stderr
    for source in (clips / "loom.avi", looming_frames(3)):
        with pytest.raises(ParameterError, match="more than 5000"):
            open_video(source, input_fps=1e9)


def test_the_end_of_the_last_frame_is_no_surplus(clips, tmp_path):
    """mkvextract writes it below the times."""
    path = table(tmp_path / "x.csv", np.arange(21) * 40, "# timecode format v2")
    with open_video(clips / "loom.avi", times=path) as video:
        list(video)
    assert not video.progress.warnings
