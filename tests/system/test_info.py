"""`dlgmd info`: what an input is, what follows from it, and what would be left out of it."""

import json
import sys

import cv2
import numpy as np
import pytest
from conftest import looming_frames, write_video

import dlgmd_cli
from dlgmd_cli.video.base import Crop
from dlgmd_cli.video.content import crop_borders
from dlgmd_cli.video.luma import read_mask
from dlgmd_cli.video.opening import open_video
from dlgmd_cli.video.survey import static_pixels, survey
from dlgmd_cli.video.timestamps import frame_rates

WIDTH, HEIGHT, BAR = 160, 120, 16
SCENE_WH = WIDTH, HEIGHT - 2 * BAR


def panning(n_frames=40):
    """Clouds that pass by."""
    noise = np.random.default_rng(2).normal(size=(HEIGHT, WIDTH + 4 * n_frames))
    clouds = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 3), None, 20, 235, cv2.NORM_MINMAX)
    return [clouds[:, 4 * t : 4 * t + WIDTH].astype(np.uint8) for t in range(n_frames)]


def boxed(frames):
    """Between black bars, below a display that says the same all the time, and a clock."""
    shown = []
    for number, frame in enumerate(frames):
        picture = frame.copy()
        picture[:BAR] = picture[-BAR:] = 0
        cv2.putText(picture, "BAT 14.8", (12, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 2)
        cv2.putText(picture, f"{number}", (120, 90), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 2)
        shown.append(picture)
    return shown


@pytest.fixture(scope="module")
def boxes(tmp_path_factory):
    return write_video(tmp_path_factory.mktemp("boxes") / "boxed.avi", boxed(panning()))


def facts_of(runs, *arguments):
    result = runs("info", *arguments, "--json")
    (facts,) = json.loads(result.stdout)["inputs"]
    return facts


def test_a_plain_video(dlgmd, clips, decoder):
    facts = facts_of(dlgmd, clips / "loom.avi", "--decoder", decoder)
    assert (facts["width"], facts["height"], facts["frames"]) == (32, 24, 20)
    assert facts["duration_s"] == pytest.approx(20 / 25)
    assert facts["fps_stated"] == 25 and facts["fps_true"] == pytest.approx(25)
    assert not facts["is_variable"] and facts["repeats"] == facts["gaps"] == 0
    assert facts["damage"] == facts["warnings"] == [] and facts["crop"] is None
    assert facts["decoder"] == decoder and facts["still_share"] == 0.0
    line, of_camera = facts["advice"]
    assert "80° is assumed" in of_camera and "fov" in of_camera
    assert line.startswith("The preset flight processes it at 32x24 px (--scale 1)")
    result = dlgmd("info", clips / "loom.avi")
    for words in ("32x24", "20, 0.800 s", "25 stated, 25 true, constant", "none found", "none"):
        assert words in result.stdout
    assert line in result.stdout and result.stderr == ""


def test_codec_and_fields(dlgmd, tmp_path):
    pytest.importorskip("av", reason="PyAV is not installed")
    from damaged import encode

    encode(tmp_path / "ten.mkv", looming_frames(12), "ffv1", pixels="yuv420p10le", fps=50)
    facts = facts_of(dlgmd, "ten.mkv")
    assert (facts["codec"], facts["pixel_format"]) == ("ffv1", "yuv420p10le")
    assert facts["bits"] == 10 and facts["is_interlaced"] is False
    assert any("pyav keeps all 10 bits" in line for line in facts["advice"])
    assert any("one in 2" in line for line in facts["advice"])
    options = {"flags": "+ildct+ilme", "x264-params": "interlaced=1"}
    frames = [np.full((48, 64), 40 * t, np.uint8) for t in range(6)]
    encode(tmp_path / "fields.mkv", frames, "libx264", options=options)
    facts = facts_of(dlgmd, "fields.mkv", "--decoder", "pyav")
    assert facts["codec"] == "h264" and facts["is_interlaced"] is True
    assert any("bwdif" in line for line in facts["advice"])


def test_without_pyav_it_says_so(dlgmd, clips, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    facts = facts_of(dlgmd, clips / "loom.avi")
    assert facts["codec"] == "MJPG" and facts["pixel_format"] == ""
    assert facts["is_interlaced"] is facts["bits"] is None
    shown = dlgmd("info", clips / "loom.avi").stdout
    assert "MJPG (FOURCC; " in shown and "unknown without the package 'av'" in shown


@pytest.mark.parametrize(
    ("intervals", "varies"),
    [
        ([33, 34, 33] * 30, False),  # whole milliseconds
        ([8, 9, 8] * 30, False),
        ([33] * 60 + [400] + [33] * 60, False),  # a hole
        ([33] * 30 + [17] * 30, True),
        ([20, 45, 33, 60, 25] * 10, True),
    ],
)
def test_what_varies(intervals, varies):
    found = frame_rates([0.0, *np.cumsum(intervals) / 1000])
    assert found.varies == varies
    between_gaps = [one for one in intervals if one < 400]
    assert found.mean_fps == pytest.approx(1000 / np.mean(between_gaps))
    assert found.min_fps == pytest.approx(1000 / max(intervals))
    assert found.max_fps == pytest.approx(1000 / min(intervals))


def test_an_unusual_rate_is_told_by_info_and_by_run(dlgmd, clips, tmp_path):
    for fps, every, rate in ((60, 2, 30), (120, 4, 30)):
        name = write_video(tmp_path / f"{fps}.avi", looming_frames(24, 64, 48), fps).name
        result = dlgmd("run", name, "--format=none")
        line = f"{fps} frames/s; one frame in {every} was processed, {rate} a second"
        assert result.stderr.startswith(f"Note: {name}: {line}")
        assert dlgmd("run", name, "--format=none", "--overwrite", "-q").stderr == ""
        assert any(f"one in {every} " in one for one in facts_of(dlgmd, name)["advice"])
        assert dlgmd("run", name, "--format=none", "--overwrite", "--fps", "all").stderr == ""
    assert "frames/s" not in dlgmd("run", clips / "loom.avi", "--format=none").stderr
    pytest.importorskip("av", reason="PyAV writes a video of variable rate")
    from damaged import encode

    stamps = np.cumsum([0] + [20, 45, 33, 60, 25] * 5)
    encode(tmp_path / "varies.mkv", looming_frames(26), "ffv1", stamps=stamps)
    result = dlgmd("run", "varies.mkv", "--format=none", "--fps", "all")
    assert "the frame rate varies from 16.7 to 50 frames/s (27.3 on average)" in result.stderr
    assert "the model processed 26 of 26 frames, each at its own time." in result.stderr
    facts = facts_of(dlgmd, "varies.mkv")
    assert facts["is_variable"] and facts["fps_range"] == pytest.approx([1 / 0.06, 50])
    assert "variable, 16.7 to 50" in dlgmd("info", "varies.mkv").stdout


def test_the_rate_is_that_between_gaps(dlgmd, tmp_path, decoder):
    """Of a recording at 60 frames/s that paused for 6 s, the average states 18."""
    pytest.importorskip("av", reason="PyAV writes a video with a pause")
    from damaged import encode

    numbers = [n + 360 * (n >= 70) for n in range(150)]
    name = encode(tmp_path / "x.mp4", panning(150), "mpeg4", numbers=numbers, fps=60).name
    facts = facts_of(dlgmd, name, "--decoder", decoder)
    assert facts["fps_stated"] < 20 and facts["fps_true"] == pytest.approx(60, rel=2e-3)
    assert not facts["is_variable"] and facts["gaps"] == 1
    assert any("one in 2" in line for line in facts["advice"])
    assert facts["damage"] == []
    told = "about 360 frames are missing after frame 69 (1.150 s), the recording paused or dropped"
    assert any(told in line for line in facts["warnings"])
    result = dlgmd("run", name, "--decoder", decoder, "--format=none")
    assert "60 frames/s; one frame in 2 was processed, 30 a second" in result.stderr
    assert " 75 of 150 " in result.stdout


def test_repeats_gaps_and_damage(dlgmd, tmp_path):
    doubled = [frame for frame in panning(20) for _ in range(2)]
    write_video(tmp_path / "doubled.avi", doubled, 30, "FFV1")
    result = dlgmd("info", "doubled.avi")
    assert "20 of 40 (50 %)" in result.stdout
    assert "20 of 40 images equal the one before, and are processed" in result.stderr
    write_video(tmp_path / "coded.avi", doubled, 30)
    result = dlgmd("info", "coded.avi")
    assert "19 of 40 (48 %)" in result.stdout
    assert "19 of 40 frames are duplicates" in result.stderr
    data = write_video(tmp_path / "whole.avi", panning(), 30).read_bytes()
    (tmp_path / "cut.avi").write_bytes(data[: len(data) * 2 // 3])
    facts = facts_of(dlgmd, "cut.avi")
    assert facts["frames"] < 40 and "cut off" in facts["damage"][0]
    assert any("Do not trust" in line for line in facts["advice"])


def test_pictures_and_arrays_have_no_rate(dlgmd, pictures, tmp_path):
    np.save(tmp_path / "x.npy", np.stack(panning(10)))
    for path, codec in ((pictures, "png"), (tmp_path / "x.npy", "array")):
        facts = facts_of(dlgmd, path)
        assert facts["fps_stated"] is facts["fps_true"] is facts["fps_range"] is None
        assert facts["codec"] == codec and facts["is_interlaced"] is False
        assert any("--input-fps" in line for line in facts["advice"])
        assert not any("'av'" in line for line in facts["advice"])


def test_bars_and_a_display_are_proposed(dlgmd, runs, boxes):
    result = runs("info", boxes, "--write-mask", "mask.png")
    crop = f"{WIDTH}x{SCENE_WH[1]}+0+{BAR}"
    assert f"--crop {crop} leaves them out" in result.stdout
    assert "of the pixels never change" in result.stdout
    assert result.stdout.endswith("mask.png\n")
    masked = read_mask("mask.png")
    assert masked.shape == (HEIGHT, WIDTH) and masked[:BAR].all() and masked[-BAR:].all()
    # It hides the same cells with the crop that is suggested and without.
    with (
        open_video(boxes, mask="mask.png") as whole,
        open_video(boxes, crop=crop, mask="mask.png") as part,
    ):
        np.testing.assert_array_equal(whole.hidden(), masked)
        np.testing.assert_array_equal(part.hidden(), masked[BAR:-BAR])
    # The text is covered, and what is beside the display is not.
    masked = masked[BAR:-BAR]
    letters = np.zeros((HEIGHT, WIDTH), np.uint8)
    cv2.putText(letters, "BAT 14.8", (12, 40), cv2.FONT_HERSHEY_SIMPLEX, 0.5, 255, 2)
    letters = letters[BAR:-BAR] > 0
    assert masked[letters].mean() > 0.8
    assert not masked[:, 110:][:40].any() and masked.mean() < 0.1
    options = {"crop": crop, "mask": "mask.png", "model": 9}
    assert dlgmd_cli.run(boxes, **options).n_cells < SCENE_WH[0] * SCENE_WH[1]
    result = dlgmd("info", boxes, "--write-mask", "mask.png")
    assert result.exit_code == 2 and "--overwrite" in result.stderr


def test_nothing_is_proposed_where_nothing_is_to_be_left_out(tmp_path):
    found = survey(write_video(tmp_path / "pan.avi", panning()))
    assert found.crop is None and found.still is None
    still = survey(write_video(tmp_path / "still.avi", boxed(panning(1) * 40)))
    assert still.crop == (*SCENE_WH, 0, BAR) and still.still is None
    black = np.zeros((40, 60), np.uint8)
    assert crop_borders(black) is None
    black[18:22] = 200  # too little is left of it
    assert crop_borders(black) is None
    black[:] = 0
    black[10:, 7:59] = 200
    assert crop_borders(black) == Crop(53, 30, 7, 10)  # one dark column is no border
    # A clear sky.
    darkest, brightest = np.zeros((2, 100, 100), np.uint8)
    brightest[:], darkest[:30], brightest[:30] = 200, 250, 250
    assert static_pixels(darkest, brightest) is None


def test_several_inputs(dlgmd, clips, pictures, tmp_path):
    (tmp_path / "no.mp4").write_text("not a video")
    result = dlgmd("info", clips / "loom.avi", "no.mp4", pictures, "--json")
    assert result.exit_code == 1
    first, failed, last = json.loads(result.stdout)["inputs"]
    assert first["frames"] == 20 and last["frames"] == 12
    assert "no frame could be decoded" in failed["error"]
    assert "1 of 3 inputs failed." in result.stderr
