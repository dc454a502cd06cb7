"""Bits and levels of samples: told once, when an input is opened, and used by everything."""

import warnings

import cv2
import numpy as np
import pytest

pytest.importorskip("av", reason="PyAV writes these videos")

import av
from conftest import looming_frames
from damaged import encode

import dlgmd_cli
from dlgmd_cli import Alarm, open_video
from dlgmd_cli.errors import DlgmdWarning, FrameError
from dlgmd_cli.video.luma import read_mask

HLG, PQ, SDR = (9, 18, 9), (9, 16, 9), (1, 1, 1)
# Contrast and black of HDR, whose white leaves room for highlights.
CURVES = {SDR: (1.0, 0), HLG: (0.75, 0), PQ: (0.5, 30)}
CODERS = {
    "8 coded": ("libx264", "yuv420p", {"crf": "23"}),
    "10 coded": ("libx264", "yuv420p10le", {"crf": "23"}),
    "12 coded": ("libx265", "yuv420p12le", {"crf": "18", "x265-params": "log-level=none"}),
    "10 lossless": ("libx265", "yuv420p10le", {"x265-params": "lossless=1:log-level=none"}),
    "16 lossless": ("ffv1", "yuv420p16le", {}),
}


def flight(contrast=1.0, black=0, n=30):
    """A camera with a little noise that moves, now fast, now slowly."""
    rng, x = np.random.default_rng(4), 0.0
    wide = cv2.GaussianBlur(rng.normal(0, 1, (96, 300)).astype(np.float32), (0, 0), 3)
    for t in range(n):
        x += 2 + 1.5 * np.sin(t / 3)
        moved = cv2.warpAffine(wide, np.float32([[1, 0, -x], [0, 1, 0]]), (128, 96))
        view = 100 + 40 * moved / wide.std() + rng.normal(0, 1, moved.shape)
        yield np.uint8(np.clip(view * contrast + black, 0, 255))


# Every fourth image comes twice.
N_TIMES = [1 + (number % 4 == 3) for number in range(30)]
TRUTH = np.array([copy > 0 for times in N_TIMES for copy in range(times)])


# Each coder, curve and decoder; 8 bits that are decoded to 8, and 10 that stay 10.
@pytest.mark.parametrize(
    ("coder", "colours", "decoder"),
    [
        ("8 coded", SDR, "opencv"),
        ("10 coded", PQ, "opencv"),
        ("10 coded", HLG, "pyav"),
        ("12 coded", PQ, "pyav"),
        ("16 lossless", PQ, "pyav"),
    ],
)
def test_duplicates_do_not_depend_on_bits(tmp_path, coder, colours, decoder):
    codec, pixels, options = CODERS[coder]
    if codec not in av.codecs_available:
        pytest.skip(f"this PyAV has no {codec}")
    path, views = tmp_path / "x.mkv", flight(*CURVES[colours])
    frames = [view for view, times in zip(views, N_TIMES, strict=True) for _ in range(times)]
    encode(path, frames, codec, pixels=pixels, options=options, colours=colours)
    with open_video(path, decoder=decoder, repeats="skip") as video:
        found = np.array([frame.is_repeat for frame in video])
    settled = 8  # a first duplicate cannot be told from a scene at rest
    assert found[settled:].tolist() == TRUTH[settled:].tolist()
    assert not (found & ~TRUTH).any()


def deep_video(path, bits):
    """Frames whose samples of 16 bits end at `bits` bits."""
    codec, pixels = {".mkv": ("ffv1", "gray16le"), ".mov": ("png", "rgb48be")}[path.suffix]
    frames = [one.astype(np.uint16) << (bits - 8) for one in looming_frames(20)]
    if pixels == "rgb48be":
        frames = [np.dstack([one] * 3) for one in frames]
    return encode(path, [av.VideoFrame.from_ndarray(one, pixels) for one in frames], codec)


@pytest.mark.parametrize(("name", "bits"), [("x.mkv", 10), ("x.mov", 12), ("x.mkv", 14)])
def test_video_of_16_bits_whose_levels_end_lower(tmp_path, name, bits):
    path, expected = deep_video(tmp_path / name, bits), dlgmd_cli.run(looming_frames(20), fps=25)
    given = dlgmd_cli.run(path, bit_depth=bits, fps="all")
    assert given.mp[3:] == pytest.approx(expected.mp[3:], rel=0.02, abs=0.01)
    assert not given.warnings
    with open_video(path) as video:
        shown = list(video.frames(picture_wh=(32, 24)))
        assert max(one.grey.max() for one in shown) < 0.3
        (line,) = video.progress.warnings
        assert f"if the camera has {bits} bits, give bit_depth={bits}" in line
    with open_video(path, bit_depth=bits) as video:
        shown = next(video.frames(picture_wh=looming_frames(1)[0].shape[::-1])).picture
    assert np.abs(shown[..., 0].astype(int) - looming_frames(20)[0]).max() <= 2


@pytest.mark.parametrize("low", [7000, 27315])
def test_the_narrow_range_of_a_thermal_camera_is_told(low):
    images = 4 * np.array(looming_frames(20), np.uint16) + low
    with open_video(images, input_fps=25) as video:
        list(video)
        (line,) = video.progress.warnings
    assert f"from {images.min()} to {images.max()}" in line
    call = line.partition("run(")[2]
    spread = eval(call[:-1], {"images": images})
    assert (spread.min(), spread.max()) == (0, 1)


def test_samples_of_other_bits_end_a_sequence(tmp_path):
    for number, frame in enumerate(looming_frames(6)):
        deep = frame.astype(np.uint16) * 257
        cv2.imwrite(str(tmp_path / f"{number}.png"), deep if number == 4 else frame)
    with open_video(tmp_path) as video:
        assert len(list(video)) == 4
        assert any("4.png has 16 bits, not 8" in line for line in video.progress.warnings)


@pytest.mark.parametrize(("kind", "white"), [(np.uint8, 1), (np.uint8, 255), (np.uint16, 255)])
def test_white_of_a_mask_is_its_brightest_level(tmp_path, kind, white):
    mask = np.zeros((8, 8), kind)
    mask[:, 4:] = white
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    assert np.array_equal(read_mask(str(tmp_path / "mask.png")), mask == 0)


def test_levels_that_are_no_luminance_are_told_by_an_alarm():
    alarm, frames = Alarm(all_frames=True), looming_frames(4)
    with pytest.raises(FrameError, match="4095"):
        alarm.step(frames[0].astype(np.uint16))
    with pytest.warns(DlgmdWarning, match="where white is 1; divide them"):
        alarm.step(frames[1].astype(np.float32))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        alarm.step(frames[2].astype(np.float32), 0.1)
        Alarm().step(frames[3] / np.float32(255), 0.1)


def in_frame(level, x, y):
    """A moving picture of 64x48 in constant frames of 128x96."""
    for view in flight(n=12):
        frame = np.full((96, 128), level, np.uint8)
        frame[y : y + 48, x : x + 64] = view[:48, :64]
        yield frame


@pytest.mark.parametrize(("level", "x", "y"), [(0, 0, 0), (128, 64, 0), (255, 30, 48)])
def test_a_small_picture_is_told_with_its_crop(level, x, y):
    with open_video(list(in_frame(level, x, y)), input_fps=30) as video:
        list(video)
        (line,) = video.progress.warnings
    crop = f"64x48+{x}+{y}"
    assert "the rest of the frame is constant" in line and f"crop='{crop}' keeps" in line
    with open_video(list(in_frame(level, x, y)), input_fps=30, crop=crop) as video:
        list(video)
        assert video.progress.warnings == []


def test_an_object_before_a_constant_ground_is_no_small_picture():
    frames = np.full((20, 96, 128), 100, np.uint8)
    for number, frame in enumerate(frames):
        frame[40:60, 4 * number : 4 * number + 30] = 220
    for one in (frames, list(flight()), looming_frames(20)):
        with open_video(one, input_fps=30) as video:
            list(video)
            assert not any("constant" in line for line in video.progress.warnings)
