"""What is left out of an image: `--crop` and `--mask`, in every command that reads an input."""

import cv2
import numpy as np
import pytest
from conftest import looming_frames, write_video, yaml_of

import dlgmd_cli
from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.results.reading import read_comparison
from dlgmd_cli.video.base import Crop, parse_crop
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.luma import Region, read_mask
from dlgmd_cli.video.opening import open_input, open_video

WIDTH, HEIGHT, BAR, N = 48, 36, 6, 20
CROP = f"{WIDTH}x{HEIGHT - 2 * BAR}+0+{BAR}"
# What an on-screen display shows: another number in each frame.
DISPLAY = np.s_[9:14, 30:46]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """`clean` and `display`, images of a square that looms between black bars, the second with a
    display; `bars.png`, `display.png`, `both.png` and, for the part between the bars,
    `cropped.png` mask them."""
    folder, draw = tmp_path_factory.mktemp("regions"), np.random.default_rng(5)
    for name in ("clean", "display"):
        (folder / name).mkdir()
    for number, frame in enumerate(looming_frames(N, WIDTH, HEIGHT)):
        frame[:BAR] = frame[-BAR:] = 0
        cv2.imwrite(str(folder / "clean" / f"{number}.png"), frame)
        frame[DISPLAY] = draw.integers(0, 256, (5, 16))
        cv2.imwrite(str(folder / "display" / f"{number}.png"), frame)
    bars, display = np.full((HEIGHT, WIDTH), 255, np.uint8), np.full((HEIGHT, WIDTH), 255, np.uint8)
    bars[:BAR] = bars[-BAR:] = 0
    display[DISPLAY] = 0
    both = cv2.cvtColor(np.minimum(bars, display), cv2.COLOR_GRAY2BGR)
    both[both[:, :, 0] > 0] = 30, 200, 0  # any colour that is not dark is kept
    for name, image in (("bars", bars), ("display", display), ("both", both)):
        cv2.imwrite(str(folder / f"{name}.png"), image)
    cv2.imwrite(str(folder / "cropped.png"), display[BAR:-BAR])
    return folder


def test_text_of_a_rectangle():
    crop = parse_crop("640x360+8+60")
    assert crop == (640, 360, 8, 60) and str(crop) == "640x360+8+60"
    for text in ("640x360", "640x360+8", "0x360+8+60", "640x360-8+60", ""):
        with pytest.raises(ParameterError, match="Write 640x360"):
            parse_crop(text)


def test_a_crop_is_a_part_of_each_picture(clips, decoder):
    with open_video(clips / "loom.mp4", decoder=decoder) as whole:
        frames = [frame.grey for frame in whole]
    with open_video(clips / "loom.mp4", decoder=decoder, crop="20x10+5+3") as part:
        assert part.size_wh == part.source_wh == (20, 10)
        assert (part.info.width, part.info.height) == (32, 24)
        for frame, before in zip(part, frames, strict=True):
            np.testing.assert_array_equal(frame.grey, before[3:13, 5:25])
    with open_video(clips / "loom.mp4", crop=Crop(20, 10, 12, 14), scale=0.5) as part:
        assert next(iter(part)).grey.shape == (5, 10)


def test_a_cell_is_ignored_if_any_of_it_is_black(folder):
    masked = read_mask(str(folder / "display.png"))
    expected = np.zeros((HEIGHT, WIDTH), np.bool_)
    expected[DISPLAY] = True
    np.testing.assert_array_equal(masked, expected)
    region = Region((WIDTH, HEIGHT), None, masked)
    np.testing.assert_array_equal(region.hidden((WIDTH, HEIGHT)), expected)
    coarse = expected.reshape(HEIGHT // 4, 4, WIDTH // 4, 4).any(axis=(1, 3))
    np.testing.assert_array_equal(region.hidden((WIDTH // 4, HEIGHT // 4)), coarse)
    finer = region.hidden((3 * WIDTH, 3 * HEIGHT))
    assert finer[27:42, 90:138].all() and not finer[:24].any() and not finer[:, :87].any()
    assert Region((WIDTH, HEIGHT), None, np.zeros((3, 3), np.bool_)).hidden((8, 8)) is None
    with pytest.raises(ParameterError, match="leaves no cell of 1x1"):
        region.hidden((1, 1))


@pytest.mark.parametrize("model", ["dlgmd", "dlgmd-onoff", "lgmd"])
def test_masked_bars_are_as_if_cut_off(folder, model):
    masked = dlgmd_cli.run(folder / "clean", model=model, scale=1.0, mask=folder / "bars.png")
    cut = dlgmd_cli.run(folder / "clean", model=model, crop=CROP)
    assert masked.n_cells == cut.n_cells == WIDTH * (HEIGHT - 2 * BAR)
    for column in ("mp", "p_sum", "s_sum", "mp_abs"):
        np.testing.assert_allclose(getattr(masked, column), getattr(cut, column), rtol=1e-5)
    assert np.nanmax(masked.mp) > 0.0


def test_a_display_does_not_disturb(folder):
    def mp(name, **options):
        return dlgmd_cli.run(folder / name, model="flight", crop=CROP, **options).mp

    mask = {"mask": folder / "cropped.png"}
    np.testing.assert_array_equal(mp("display", **mask), mp("clean", **mask))
    assert np.nanmax(np.abs(mp("display") - mp("clean"))) > 1.0


def test_repeats_are_found_beside_a_display(folder, tmp_path):
    frames = [cv2.imread(str(folder / "clean" / f"{n}.png")) for n in range(8, N)]
    doubled = [frame.copy() for frame in frames for _ in range(2)]
    for number, frame in enumerate(doubled):
        frame[DISPLAY] = 255 * (number % 2)
    clip = write_video(tmp_path / "doubled.avi", doubled, fourcc="FFV1")

    def n_repeats(**options):
        found = dlgmd_cli.run(clip, model=9, repeats="skip", **options)
        return found.record["input"]["repeats"]

    assert n_repeats() == 0
    # Black bars and all, the mask is of any size.
    mask = cv2.resize(cv2.imread(str(folder / "both.png")), None, fx=2, fy=2)
    cv2.imwrite(str(tmp_path / "twice.png"), mask)
    assert n_repeats(mask=tmp_path / "twice.png") == len(frames)


def test_every_task_takes_them(runs, folder, tmp_path):
    options = ("--crop", CROP, "--mask", folder / "cropped.png", "--set", 4)
    n_cells = WIDTH * (HEIGHT - 2 * BAR) - 5 * 16
    runs("run", folder / "display", *options)
    record = yaml_of(tmp_path / "dlgmd-out/display/run.yaml")
    assert record["processed"]["cells"] == n_cells
    assert record["options"]["crop"] == CROP
    assert record["options"]["mask"] == str(folder / "cropped.png")
    expected = dlgmd_cli.read_result(tmp_path / "dlgmd-out/display")

    display, given = folder / "display", {"crop": CROP, "mask": folder / "cropped.png"}
    dlgmd_cli.compare(display, [4, "lgmd"], out="dlgmd-out", **given)
    compared = read_comparison(tmp_path / "dlgmd-out/display")
    assert {one.n_cells for one in compared.values()} == {n_cells}
    np.testing.assert_allclose(compared["set4"].mp_abs, expected.mp_abs, rtol=1e-6)

    dlgmd_cli.sweep(display, 4, x="alpha=-0.1", y="t0=1", jobs=1, out="dlgmd-out", **given)
    swept = yaml_of(tmp_path / "dlgmd-out/sweep-display/sweep.yaml")
    assert swept["processed"]["cells"] == n_cells
    dlgmd_cli.layers(display, 4, frames=[19], npz=True, out="dlgmd-out", **given)
    with np.load(tmp_path / "dlgmd-out/display/layers.npz") as layers:
        hidden = open_video(folder / "display", crop=CROP, mask=folder / "cropped.png").hidden()
        for name in "psg":
            assert (layers[name][:, hidden] == 0.0).all() and layers[name].any()


def test_a_batch_sees_that_a_mask_has_changed(dlgmd, runs, folder, tmp_path, here):
    mask = tmp_path / "mask.png"
    (tmp_path / "in").mkdir()
    clip = write_video(tmp_path / "in" / "a.avi", looming_frames(width=64, height=48))
    command = ("batch", clip.parent, "--mask", mask, "--format=none", "--jobs", 1)
    image = np.full((4, 4), 255, np.uint8)
    image[3] = 0
    cv2.imwrite(str(mask), image)
    assert dlgmd(*command).exit_code == dlgmd(*command).exit_code == 0
    image[0] = 0
    cv2.imwrite(str(mask), image)
    result = dlgmd(*command)
    assert result.exit_code == 2 and "other settings (--mask)" in result.stderr
    config = ("--config", "dlgmd-out/a/run.yaml", "--format=none", "--out", "again")
    again = dlgmd("run", clip, *config)
    told = f"Warning: dlgmd-out/a/run.yaml: the mask {mask} has changed since.\n"
    assert again.exit_code == 0 and again.stderr == told
    runs(*command, "--overwrite")
    assert dlgmd("run", clip, *config, "--overwrite").stderr == ""


def test_what_is_wrong_is_said(dlgmd, clips, folder, tmp_path):
    clip, black = clips / "loom.avi", tmp_path / "black.png"
    cv2.imwrite(str(black), np.zeros((9, 9), np.uint8))
    result = dlgmd("run", clip, "--mask", black)
    assert result.exit_code == 2 and "--mask leaves no cell of 32x24" in result.stderr
    assert not (tmp_path / "dlgmd-out").exists()
    with pytest.raises(SourceError, match="reaches outside"):
        open_input(clip, InputOptions(crop="32x24+0+1"))
    with pytest.raises(ParameterError, match="mask = 5 is not the name of a file"):
        InputOptions(mask=5)
