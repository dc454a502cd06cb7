"""The files of a run: each has a writer; `alarms.vtt` has a caption for each alarm."""

import re
import shutil
import subprocess

import numpy as np
import pytest
from conftest import looming_frames, make_result, result_of_level, write_video

import dlgmd_cli
from dlgmd_cli.errors import ParameterError
from dlgmd_cli.results.files import FILES, RUN, names_of
from dlgmd_cli.results.writers import SHOWN_S

CUE = re.compile(r"(\d\d):([0-5]\d):([0-5]\d)\.(\d{3}) --> (\d\d):([0-5]\d):([0-5]\d)\.(\d{3})")


def cues(path):
    """Begin, end and text of every caption of a WebVTT file: blocks below the header."""
    header, *blocks = path.read_bytes().decode().rstrip("\n").split("\n\n")
    assert header == "WEBVTT"
    for block in blocks:
        times, text = block.split("\n")
        numbers = [int(one) for one in CUE.fullmatch(times).groups()]
        begin_s, end_s = (
            3600 * h + 60 * m + s + ms / 1000 for h, m, s, ms in (numbers[:4], numbers[4:])
        )
        assert "-->" not in text and not re.search(r"[<>]|&(?!amp;|lt;|gt;)", text)
        yield begin_s, end_s, text


@pytest.fixture
def result():
    """Two alarms, of 2.0 s, and of two frames after an hour."""
    level = np.full(120, 0.1)
    level[10:61], level[100:102] = 0.5, 0.9
    time_s = np.arange(120) / 25
    time_s[90:] += 3600
    result = result_of_level(level, time_s=time_s)
    spikes = np.array(level) > 0.4
    result.rows["level"] = result.rows["signal"] = level
    result.rows["alarm"] = result.rows["spike"] = spikes
    result.rows["g_x"] = result.rows["g_y"] = -0.9
    return result


def test_a_caption_for_each_alarm(result, tmp_path):
    result.save(tmp_path, formats=("vtt",))
    assert {path.name for path in tmp_path.iterdir()} == names_of(RUN, ["vtt"])
    (first, second) = cues(tmp_path / "alarms.vtt")
    assert first == (0.4, 2.4, "Alarm 1: spikes, left high, normalised MP up to 0.50")
    assert second[:2] == pytest.approx((3604.0, 3604.0 + SHOWN_S))
    assert second[2] == "Alarm 2: spikes, left high, normalised MP up to 0.90"
    result.save(tmp_path, overwrite=True)
    assert {path.name for path in tmp_path.iterdir()} == names_of(RUN, [])


def test_a_caption_begins_at_0_where_a_video_begins_earlier(result, tmp_path):
    result.rows["time_s"] -= 0.8
    result.save(tmp_path, formats="vtt")
    (first, _) = cues(tmp_path / "alarms.vtt")
    assert first[:2] == (0.0, 1.6)


def test_a_rule_cannot_break_the_file(result, tmp_path):
    result.rule.name = "a --> b\n\n<v>&"
    result.save(tmp_path, formats="vtt")
    (first, _) = cues(tmp_path / "alarms.vtt")
    assert "a --&gt; b\\n\\n&lt;v&gt;&amp;, left high" in first[2]


def test_ffmpeg_reads_it(result, tmp_path):
    ffmpeg = shutil.which("ffmpeg")
    if ffmpeg is None:
        pytest.skip("ffmpeg is not installed")
    make_result([0.0, 0.0]).save(tmp_path / "none", formats="vtt")
    assert not [*cues(tmp_path / "none/alarms.vtt")]
    result.save(tmp_path / "two", formats="vtt")
    path = tmp_path / "two/alarms.vtt"
    command = [ffmpeg, "-v", "error", "-xerror", "-i", path, "-f", "srt", "-"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0 and not done.stderr
    assert [text for _, _, text in cues(path)] == re.findall(r"Alarm .*", done.stdout)


def test_no_other_format_is_known(result):
    with pytest.raises(ParameterError, match="Choose from png, pdf, svg, vtt"):
        result.files("mp4")


def test_every_file_has_a_writer_that_exists():
    for one in FILES[RUN]:
        assert one.meaning and (not one.writer or callable(one.write))


def test_a_batch_continues_until_every_file_is_there(tmp_path, here):
    clip, out = write_video(tmp_path / "loom.avi", looming_frames()), tmp_path / "out"
    once = {"model": 9, "out": out, "formats": ("vtt",), "jobs": 1}
    dlgmd_cli.batch(clip, **once)
    expected = names_of(RUN, ("vtt",))
    assert {path.name for path in (out / "loom").iterdir()} == expected
    for name in sorted(expected - {RUN}):
        (out / "loom" / name).unlink()
        dlgmd_cli.batch(clip, **once)
        assert (out / "loom" / name).exists(), name
