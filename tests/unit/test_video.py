"""Every kind of input: one contract for all of them, then what each has to cope with."""

import itertools
import math
import os
import struct
import sys
import threading
import time

import cv2
import numpy as np
import pytest
from conftest import HEIGHT, N_FRAMES, WIDTH, looming_frames, write_video
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.frame import Frame
from dlgmd_cli.machine.threads import opencv_threads
from dlgmd_cli.reduction import Reducer, resized
from dlgmd_cli.results.csv import cells
from dlgmd_cli.stream.clock import sampling_step
from dlgmd_cli.stream.continuity import Continuity
from dlgmd_cli.video.base import decoder_threads
from dlgmd_cli.video.damage import missing_frames
from dlgmd_cli.video.luma import to_grey
from dlgmd_cli.video.opening import open_video, processed_size
from dlgmd_cli.video.source import Selection, read_ahead
from dlgmd_cli.video.timestamps import FrameClock, frame_rates, steady_fps

NAN = math.nan


def to_luminance(image, size_wh, levels=(0, 255)):
    return Frame(0, 0.0, to_grey(image, size_wh, levels)).luminance


def taken(times, rate, max_fps):
    every, min_interval_s = sampling_step(rate, max_fps)
    selection = Selection(min_interval_s=min_interval_s)
    return every, [i for i, time_s in enumerate(times) if selection.take(time_s)]


@pytest.mark.parametrize(
    ("rate", "every"),
    [(24, 1), (25, 1), (29.97, 1), (30.3, 1), (48, 2), (50, 2), (60, 2), (100, 4), (120, 4)],
)
@pytest.mark.parametrize("jitter_s", [0.0, 0.003])
def test_a_high_rate_is_divided_evenly(rate, every, jitter_s):
    times = np.arange(300) / rate + np.random.default_rng(1).uniform(0, jitter_s, 300)
    assert taken(times, rate, 33.0) == (every, list(range(0, 300, every)))
    # Times in Matroska are rounded to 1 ms.
    assert taken(np.round(times, 3), rate, 33.0)[1] == list(range(0, 300, every))


def test_a_repeat_of_what_was_dropped_is_taken_and_others_fill_no_slot_twice():
    selection = Selection(min_interval_s=0.025)  # 60 frames a second, of which 30 are taken
    continuity, found = Continuity(), []
    for level in (10, 20):  # before anything has changed, nothing is a repeat
        continuity.step(np.full((9, 9), level, np.uint8), None)
        continuity.take()
    repeats = [False, True, True, True, False, True, False, False, True, True]
    for number, level in enumerate(40 + 20 * np.cumsum(~np.array(repeats))):
        is_repeat, _ = continuity.step(np.full((9, 9), level, np.uint8), number / 60)
        assert is_repeat == repeats[number]
        if selection.take(number / 60, is_new=continuity.is_new):
            found.append("old" if continuity.take()[0] else "new")
        else:
            found.append("none")
    assert found == ["new", "none", "old", "none", "new", "none", "new", "none", "new", "none"]


@pytest.mark.parametrize(
    "options",
    [
        *({"start_s": 2.0, "end_s": 1.0}, {"max_fps": 0.0}, {"max_fps": NAN}, {"scale": 0.0}),
        *({"scale": 1.5}, {"scale": NAN}, {"size_wh": (0, 5)}, {"scale": 0.5, "size_wh": (5, 5)}),
    ],
    ids=str,
)
def test_options_out_of_range(pictures, options):
    with pytest.raises(ParameterError):
        open_video(pictures, **options)


def test_default_size_is_at_most_480_wide():
    assert processed_size(1920, 1080) == (480, 270)
    assert processed_size(432, 240) == (432, 240)
    assert processed_size(1080, 1920) == (480, 853)
    assert processed_size(100_000, 3) == (480, 1)
    assert processed_size(1920, 1080, scale=1.0) == (1920, 1080)
    assert processed_size(10, 10, size_wh=(20, 30)) == (20, 30)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_luminance_of_grey_and_colour(depth):
    top = np.iinfo(depth).max
    image = np.full((6, 8, 3), np.array([0.2, 0.5, 0.9]) * top).astype(depth)
    expected = 0.114 * 0.2 + 0.587 * 0.5 + 0.299 * 0.9
    assert to_luminance(image, (8, 6), (0, top)) == pytest.approx(expected, abs=1.5 / top)
    luminance = to_luminance(image[:, :, 0], (8, 6), (0, top))
    assert luminance.dtype == np.float32 and luminance == pytest.approx(0.2, abs=1.5 / top)


def test_stretching_is_exact_for_every_level():
    ramp = np.arange(256, dtype=np.uint8)[None]
    exact = np.clip(np.rint((np.arange(256) - 16) * 255 / 219), 0, 255)
    assert np.array_equal(to_grey(ramp, (256, 1), (16, 235))[0], exact)
    assert np.array_equal(to_grey(ramp, (256, 1)), ramp)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("factors", [(2, 2), (3, 3), (4, 4), (6, 6), (4, 2), (5, 8)])
def test_reduced_pictures_are_means_of_areas(factors, depth):
    across, down = factors
    image = np.random.default_rng(3).integers(0, np.iinfo(depth).max, (24 * down, 32 * across))
    exact = image.reshape(24, down, 32, across).mean(axis=(1, 3))
    reduced = resized(image.astype(depth), (32, 24))
    in_one_step = cv2.resize(image.astype(depth), (32, 24), interpolation=cv2.INTER_AREA)
    assert reduced.dtype == depth
    assert np.abs(reduced - exact).max() <= 1.0
    assert np.abs(reduced.astype(int) - in_one_step.astype(int)).max() <= 1


def test_far_reductions_are_means_of_areas_too():
    image = np.random.default_rng(3).integers(0, 256, (1080, 1920), dtype=np.uint8)
    exact = cv2.resize(image.astype(np.float64), (38, 22), interpolation=cv2.INTER_AREA)
    assert np.abs(resized(image, (38, 22)) - exact).max() <= 1.25


def test_other_sizes_are_resized_as_by_opencv():
    image = np.random.default_rng(3).integers(0, 255, (54, 96), dtype=np.uint8)
    for size, how in (((40, 30), cv2.INTER_AREA), ((128, 72), cv2.INTER_LINEAR)):
        assert np.array_equal(resized(image, size), cv2.resize(image, size, interpolation=how))


@pytest.mark.parametrize("size", [(640, 360), (1280, 720), (960, 540), (800, 600), (854, 480)])
def test_areas_of_a_fraction_are_those_of_opencv_to_the_last_bit(size):
    """Ties, one in 64 for 8/3, go to the even level."""
    image = np.random.default_rng(5).integers(0, 256, size[::-1], dtype=np.uint8)
    reducer = Reducer()
    reducer.take(image)
    for width in (480, 240, 96):
        reduced_wh = width, round(size[1] * width / size[0])
        reference = cv2.resize(image, reduced_wh, interpolation=cv2.INTER_AREA)
        if all(old % (2 * new) == 0 for old, new in zip(size, reduced_wh, strict=True)):
            half = cv2.resize(image, (size[0] // 2, size[1] // 2), interpolation=cv2.INTER_AREA)
            reference = cv2.resize(half, reduced_wh, interpolation=cv2.INTER_AREA)
        assert np.array_equal(reducer.at(reduced_wh), reference)
        assert np.array_equal(resized(image, reduced_wh), reference)


def test_a_reduced_image_outlives_the_next_one():
    first, second = (np.full((36, 64, 3), level, np.uint8) for level in (10, 200))
    reducer = Reducer()
    for size in ((64, 36), (32, 18), (24, 13)):
        reducer.take(first)
        kept = reducer.at(size)
        reducer.take(second)
        assert (reducer.at(size) == 200).all() and (kept == 10).all()


# Times


@pytest.mark.parametrize(
    ("stamps", "expected", "report"),
    [
        ([-0.04, 0.0, 0.05, 7.0, 1e6], [-0.04, 0.0, 0.05, 7.0, 1e6], None),
        ([0.0, NAN, NAN, NAN], [0.0, 0.1, 0.2, 0.3], "the stream has no timestamps"),
        ([0.0, 0.1, 0.1, 0.3, NAN, 0.5], [0.0, 0.1, 0.15, 0.3, 0.35, 0.5], "2 frames had"),
        ([0.0, 0.1, NAN, 0.3], [0.0, 0.1, 0.15, 0.3], "1 frame"),
        ([5.0, NAN, 5.0, 5.0], [5.0, 5.1, 5.2, 5.3], "the stream has no timestamps"),
    ],
)
def test_clock(stamps, expected, report):
    clock = FrameClock(10.0)
    assert [clock.time(i, s) for i, s in enumerate(stamps)] == pytest.approx(expected)
    assert report in clock.report() if report else clock.report() is None


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=50))
def test_clock_always_increases(stamps):
    clock = FrameClock(30.0)
    times = [clock.time(i, s) for i, s in enumerate(stamps)]
    texts = [cells(("time_s",), (time_s,))[0] for time_s in times]
    assert all(b > a for a, b in itertools.pairwise(times)) and len({*texts}) == len(texts)


def holes(intervals, fps=30.0, n_short=0):
    """What is said of frames at these intervals, in frames."""
    times = np.cumsum([0.0, *intervals]) / fps
    return missing_frames(times, frame_rates(times), n_short)


@pytest.mark.parametrize(
    ("intervals", "told"),
    [
        ([10], "about 9 frames are missing after frame 30 (1.000 s), "),
        ([82], "about 81 frames are missing"),
        ([2, 7, 1, 2], "about 8 frames are missing after frame 30 (1.000 s), "),  # one ragged hole
        ([4] + [1] * 30 + [5], "7 frames are missing after frame 30 (1.000 s) and in 1 more place"),
    ],
)
def test_a_hole_in_a_steady_stream_is_told(intervals, told):
    assert told in holes([1] * 30 + intervals + [1] * 30)


@pytest.mark.parametrize(("before", "after"), [(59, 2), (8, 8), (12, 3)])
def test_a_large_hole_is_told_near_the_end_and_in_a_short_video(before, after):
    told = f"about 27 frames are missing after frame {before} "
    assert told in holes([1] * before + [28] + [1] * after)
    assert holes([1] * before + [4] + [1] * min(after, 5)) == ""  # three frames


@pytest.mark.parametrize(
    "intervals",
    [
        [1] * 50,
        [1] * 30 + [3] * 30,  # the rate changes
        [1, 1, 1, 4] * 20,  # frames are dropped regularly
        [1.0, 1.6, 0.7, 2.4, 0.5] * 12,  # a phone's jitter
        [1] * 30 + [10],  # a ragged end
        [1] * 30 + [2] + [1] * 30,  # one frame
        [1] * 30 + [2] + [1] * 30 + [2] + [1] * 30,  # and another one
        [],
    ],
)
def test_a_variable_rate_is_no_hole(intervals):
    assert holes(intervals) == ""


@pytest.mark.parametrize("fps", [24000 / 1001, 25, 60000 / 1001, 60, 120, 12.5])
@pytest.mark.parametrize("digits", [3, 9])  # Times in Matroska are whole milliseconds.
@pytest.mark.parametrize("pause_s", [0, 6])
def test_the_rate_of_the_first_stamps_is_that_between_gaps(fps, digits, pause_s):
    times = np.arange(100) / fps + pause_s * (np.arange(100) >= 40)
    order = np.random.default_rng(1).permutation(100)  # B-frames
    assert steady_fps(np.round(times, digits)[order]) == pytest.approx(fps, rel=2e-3)


@pytest.mark.parametrize(
    "stamps",
    [np.arange(8) / 30, np.cumsum([0.02, 0.045, 0.033, 0.06, 0.025] * 20), [0.0] * 100, []],
    ids=["few", "varies", "none", "empty"],
)
def test_no_rate_by_stamps(stamps):
    assert steady_fps(stamps) is None


# Videos


def test_frames_that_an_edit_list_hides_are_not_missed(tmp_path, decoder):
    path = write_video(tmp_path / "edited.mp4", looming_frames(), fourcc="mp4v")
    data = bytearray(path.read_bytes())
    # The duration of the first segment of an edit list, and that of its track, in version 0.
    for at in (data.index(b"elst") + 12, data.index(b"tkhd") + 24):
        duration = struct.unpack(">I", data[at : at + 4])[0]
        data[at : at + 4] = struct.pack(">I", duration // 2)
    path.write_bytes(data)
    with open_video(path, decoder=decoder) as source:
        n_frames = len(list(source))
        assert source.progress.warnings == []
        assert abs(n_frames - N_FRAMES // 2) <= 1 and source.info.n_frames == N_FRAMES


@pytest.mark.parametrize("stated", [5, 5000])
def test_a_wrong_frame_count_is_only_a_hint(tmp_path, clips, stated, decoder):
    data = bytearray((clips / "loom.avi").read_bytes())
    header, stream = data.index(b"avih"), data.index(b"strh")
    data[header + 24 : header + 28] = struct.pack("<I", stated)
    data[stream + 40 : stream + 44] = struct.pack("<I", stated)
    path = tmp_path / "lies.avi"
    path.write_bytes(data)
    with open_video(path, decoder=decoder) as source:
        assert source.info.n_frames == stated
        assert len(list(source)) == N_FRAMES


def jpeg(frame):
    return cv2.imencode(".jpg", frame)[1].tobytes()


def test_a_change_of_size_ends_the_reading_or_is_scaled(tmp_path, decoder):
    path = tmp_path / "changes.mjpeg"
    small = [jpeg(frame) for frame in looming_frames(7)]
    large = [jpeg(frame) for frame in looming_frames(5, 48, 40)]
    path.write_bytes(b"".join(small + large))
    with open_video(path, decoder=decoder) as source:
        frames = list(source)
        warnings = [line for line in source.progress.warnings if "size" in line]
    assert {frame.grey.shape for frame in frames} == {(HEIGHT, WIDTH)}
    if decoder == "opencv":  # which does not tell
        assert len(frames) == 12 and warnings == []
    else:
        assert len(frames) == 7
        assert "changes to 48x40" in warnings[0] and "used 7 frames" in warnings[0]


@pytest.fixture
def noisy(tmp_path):
    """The content of an AVI with 40 JPEG of noise."""
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(40)]
    return bytearray(write_video(tmp_path / "whole.avi", frames).read_bytes())


def read_damaged(path, data, decoder):
    """How many frames there are, and the warnings."""
    path.write_bytes(data)
    with open_video(path, decoder=decoder) as source:
        return len(list(source)), source.progress.warnings


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_truncated_file_gives_what_it_holds(tmp_path, noisy, share, decoder):
    part = noisy[: int(len(noisy) * share)]
    n_frames, warnings = read_damaged(tmp_path / "x.avi", part, decoder)
    assert abs(n_frames - 40 * share) <= 3
    assert any(f"{n_frames} of about 40 frames" in line for line in warnings), warnings


def test_damage_in_the_middle_is_a_gap(tmp_path, noisy, decoder):
    starts = [i for i in range(len(noisy) - 3) if noisy[i : i + 3] == b"\xff\xd8\xff"]
    for frame in range(20, 26):  # six images that are none
        noisy[starts[frame] : starts[frame] + 600] = bytes(600)
    n_frames, warnings = read_damaged(tmp_path / "x.avi", noisy, decoder)
    assert n_frames == 34
    (line,) = (line for line in warnings if "damaged" in line)
    assert "6 frames cannot be decoded after frame 19 (0.760 s)" in line
    assert "decoded and used 34 of about 40" in line


NAMES = [
    *("%04d.avi", "100%.avi", "%d %s 50%%.avi", "two words 'and' \"quotes\".avi", "new\nline.avi"),
    *("ünïcödé 漢字 🐝.avi", "-dash.avi", "a:b.avi", "http:x.avi", "concat:a|b.avi", "[1]*?.avi"),
    *(" lead.avi", "noextension"),
]


@pytest.mark.skipif(sys.platform != "linux", reason="other systems lack some of these names")
@pytest.mark.parametrize("name", [*NAMES, os.fsdecode(b"bad\xff.avi")], ids=ascii)
def test_any_file_name_works(tmp_path, monkeypatch, clips, name, decoder):
    (tmp_path / name).write_bytes((clips / "loom.avi").read_bytes())
    monkeypatch.chdir(tmp_path)
    with open_video(name, decoder=decoder) as source:
        assert len(list(source)) == N_FRAMES


FTYP = b"\0\0\0\x18ftypisom" + bytes(12) + b"\x99mdat" + bytes(99)


@pytest.mark.parametrize(
    ("content", "why"),
    [
        (b"", "the file is empty"),
        (b"ffconcat version 1.0\nfile victim.mp4\n", "is a list of other files"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\n", "is a Git LFS pointer"),
        (b"<!DOCTYPE html><html><body>Not found", "is a web page, not a video"),
        (b"PK\x03\x04" + bytes(99), "is a ZIP archive, not a video"),
        (FTYP, "perhaps cut off"),
        (FTYP + bytes(99999) + b"hdlr" + bytes(8) + b"soun", "has sound, but no video"),
        (bytes(range(256)) * 40, "no frame could be decoded"),
        (b"RIFF\x00\x01\x00\x00AVI LIST", "no frame could be decoded"),
    ],
    ids=range(9),
)
def test_what_is_no_video(tmp_path, content, why, decoder):
    (tmp_path / "x.avi").write_bytes(content)
    with pytest.raises(SourceError, match=why):
        open_video(tmp_path / "x.avi", decoder=decoder)


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("none.mp4", "no such file"),
        ("x" * 5000, None),
        ("nul\0.mp4", None),
        (".", "no image in this folder"),
        ("%03d.png", "no file matches"),
        ("*.png", "no file matches"),
    ],
    ids=["absent", "long", "nul", "folder", "printf", "glob"],
)
def test_what_is_not_there(tmp_path, path, why):
    with pytest.raises(SourceError, match=why):
        open_video(os.path.join(tmp_path, path))


# Images


def test_natural_order_and_what_is_left_out(tmp_path):
    for number in (10, 9, 1, 100):
        cv2.imwrite(str(tmp_path / f"f{number}.png"), np.full((4, 4), number, np.uint8))
    cv2.imwrite(str(tmp_path / ".f5.png"), np.full((4, 4), 5, np.uint8))
    (tmp_path / "notes.txt").write_text("no image")
    for path in (tmp_path, tmp_path / "f%d.png", tmp_path / "f*.png"):
        with open_video(path) as source:
            values = [round(float(f.luminance[0, 0]) * 255) for f in source]
        assert values == [1, 9, 10, 100]


def test_a_thumbnail_beside_videos_is_no_sequence(dlgmd, tmp_path, clips):
    folder = tmp_path / "flights"
    folder.mkdir()
    for number in range(7):
        cv2.imwrite(str(folder / f"{number}.png"), np.full((24, 32), 9 * number, np.uint8))
    assert len(list(open_video(folder))) == 7  # images alone are a sequence
    for name in ("a.avi", "b.AVI"):
        (folder / name).write_bytes((clips / "loom.avi").read_bytes())
    result = dlgmd("run", folder)
    assert result.exit_code == 1 and "holds 2 videos and 7 images" in result.stderr
    assert "use 'dlgmd batch'" in result.stderr
    cv2.imwrite(str(folder / "7.png"), np.full((24, 32), 99, np.uint8))
    assert len(list(open_video(folder))) == 8
    for number in range(1, 8):
        (folder / f"{number}.png").unlink()
    assert "holds 2 videos and 1 image, too few" in dlgmd("run", folder).stderr


@pytest.mark.parametrize("channels", [None, 3, 4])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_pictures_of_every_kind(tmp_path, channels, depth):
    shape = (6, 8, channels) if channels else (6, 8)
    cv2.imwrite(str(tmp_path / "1.png"), np.full(shape, np.iinfo(depth).max // 2, depth))
    with open_video(tmp_path) as source:
        assert next(iter(source)).luminance == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("size", "warning"),
    [(None, "4.png cannot be read as an image"), ((48, 40), "4.png is 48x40, not 32x24")],
)
def test_a_bad_picture_ends_the_sequence(tmp_path, size, warning):
    for number, frame in enumerate(looming_frames(6)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), frame)
    content = b"no image" if size is None else jpeg(np.zeros(size[::-1], np.uint8))
    (tmp_path / "4.png").write_bytes(content)
    with open_video(tmp_path, input_fps=8.0) as source:
        assert [f.time_s for f in source] == [0.0, 0.125, 0.25, 0.375]
        assert source.progress.warnings == [
            f"{warning}; decoded and used 4 of about 6 frames, up to 0.375 s"
        ]


def test_pictures_without_a_rate_or_a_first_one(tmp_path, pictures):
    with open_video(pictures) as source:
        assert next(iter(source)).time_s == 0.0 and source.info.fps == 30.0
        assert any("taken as 30 fps" in line for line in source.progress.warnings)
    (tmp_path / "1.png").write_bytes(b"no image")
    with pytest.raises(SourceError, match="cannot be read as an image"):
        open_video(tmp_path)


# Reading ahead


@pytest.fixture
def no_thread_is_left():
    yield
    assert [t for t in threading.enumerate() if "dlgmd-decode" in t.name] == []


@pytest.mark.usefixtures("no_thread_is_left")
def test_reading_ahead_gives_the_same_frames(clips, decoder):
    with open_video(clips / "loom.avi", scale=0.5, decoder=decoder) as source:
        plain = [frame.grey for frame in source]
        with read_ahead(source) as frames:
            assert np.array_equal(plain, [frame.grey for frame in frames])


@pytest.mark.usefixtures("no_thread_is_left")
@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_never_further_ahead_than_asked_and_stopped_by_an_error(error):
    taken = []
    endless = (taken.append(number) or number for number in itertools.count())
    with pytest.raises(error), read_ahead(endless, depth=3) as items:
        for number in items:
            time.sleep(0.001)
            assert len(taken) <= number + 1 + 3
            if number == 20:
                raise error


@pytest.mark.usefixtures("no_thread_is_left")
@pytest.mark.parametrize("together", [1, 2, 5, 16])
def test_an_error_comes_after_what_was_before_it(together):
    seen, failing = [], (1 // (5 - i) for i in range(9))
    with pytest.raises(ZeroDivisionError), read_ahead(failing, together=together) as items:
        seen.extend(items)
    assert len(seen) == 5


@pytest.mark.usefixtures("no_thread_is_left")
@pytest.mark.parametrize("together", [1, 2, 5, 7])
def test_batches_are_in_order_and_few(together):
    taken = []
    items = (taken.append(number) or number for number in range(20))
    with read_ahead(items, depth=2, together=together) as ahead:
        for number in ahead:
            time.sleep(0.001)
            assert len(taken) <= number + 1 + 3 * together
    assert taken == [*range(20)]


@pytest.mark.usefixtures("no_thread_is_left")
def test_without_more_threads_one_decodes_and_fetches(clips, decoder, monkeypatch):
    with open_video(clips / "loom.avi", decoder=decoder) as source:
        plain = [frame.grey for frame in source]

    def refuse(thread):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    assert decoder_threads() == 1
    opened = open_video(clips / "loom.avi", decoder=decoder)
    with opened as source, read_ahead(source) as frames:
        assert np.array_equal(plain, [frame.grey for frame in frames])


def test_without_memory_a_file_is_not_called_damaged(tmp_path, decoder, monkeypatch):
    (tmp_path / "x.mp4").write_bytes(b"no video")
    monkeypatch.setattr("dlgmd_cli.video.base.LITTLE_MEMORY", 1 << 62)
    with pytest.raises(MemoryError):
        open_video(tmp_path / "x.mp4", decoder=decoder)


def test_the_host_s_threads_are_restored(set_threads):
    set_threads(3)
    with pytest.raises(ValueError), opencv_threads(1):
        assert cv2.getNumThreads() == 1
        raise ValueError
    assert cv2.getNumThreads() == 3


# What shows nothing, and what is too large


def seen(kinds):
    """Frames that move (`m`), are black (`b`), or repeat the one before (`f`)."""
    moving, frames = iter(looming_frames(len(kinds))), []
    for kind in kinds:
        black = np.zeros((HEIGHT, WIDTH), np.uint8)
        frames.append({"m": next(moving), "b": black, "f": frames[-1] if frames else None}[kind])
    return frames


@pytest.mark.parametrize(
    ("kinds", "told"),
    [
        ("m" * 40, ""),
        ("m" * 10 + "b" * 17 + "m" * 10, ""),
        ("m" * 10 + "b" * 20 + "m" * 10, "black from 0.40 to 1.16 s: nothing can be seen there"),
        ("m" * 10 + "f" * 20 + "m" * 5, "frozen from 0.36 to 1.16 s: nothing can be seen there"),
        (("m" * 5 + "b" * 20) * 5, "2.96 s, and 2 more: nothing can be seen there"),
        ("b" * 30, "nothing can be seen: all frames are black"),
        ("m" + "f" * 30, "nothing can be seen: all frames are the same"),
    ],
)
def test_blind_pictures_are_told(tmp_path, kinds, told):
    pytest.importorskip("av", reason="OpenCV alone cannot tell still from interlaced video")
    video = write_video(tmp_path / "x.avi", seen(kinds), fourcc="FFV1")
    of_array = "opencv", "skip", np.array(seen(kinds))
    for decoder, repeats, path in (("pyav", "keep", video), ("opencv", "skip", video), of_array):
        with open_video(path, decoder=decoder, repeats=repeats, input_fps=25.0) as source:
            for _ in range(2):  # what is told is told once
                assert len(list(source)) <= len(kinds)
        lines = [line for line in source.progress.warnings if "nothing can be seen" in line]
        assert len(lines) == bool(told) and told in "".join(lines)
        assert source.progress.blind == (lines[0] if "all" in told else "")
        for begin_s, end_s in source.progress.blind_s if "from" in told else ():
            assert f"from {begin_s:.2f} to {end_s:.2f} s" in told


@pytest.mark.parametrize("command", ["run", "compare"])
def test_a_result_of_nothing_seen_is_kept_and_no_success(dlgmd, tmp_path, command):
    pytest.importorskip("av", reason="OpenCV alone cannot tell still from interlaced video")
    video = write_video(tmp_path / "x.avi", seen("b" * 30))
    result = dlgmd(command, video, "--format=none")
    assert result.exit_code == 1 and "dlgmd-out/x" in result.stdout
    assert result.stderr.splitlines()[-1].startswith(f"Error: {video}: nothing can be seen")
    assert (tmp_path / f"dlgmd-out/x/{command}.yaml").exists()


@pytest.mark.parametrize("size", [(16000, 16000), (9000, 40)])
def test_too_large_a_video_is_not_decoded(tmp_path, decoder, size):
    Image.new("L", (8, 8)).save(
        tmp_path / "x.gif", save_all=True, append_images=[Image.new("L", (8, 8), 9)]
    )
    data = bytearray((tmp_path / "x.gif").read_bytes())
    data[6:10] = struct.pack("<HH", *size)  # of the whole image, of which frames are parts
    (tmp_path / "x.gif").write_bytes(data)
    with pytest.raises(SourceError, match="is larger than 8192x8192 px"):
        open_video(tmp_path / "x.gif", decoder=decoder)


def test_too_large_a_picture(tmp_path):
    cv2.imwrite(str(tmp_path / "1.png"), np.zeros((4, 8193), np.uint8))
    with pytest.raises(SourceError, match=r"1\.png: is larger than 8192x8192 px"):
        open_video(tmp_path)
    with pytest.raises(ParameterError, match=r"1\.png is larger than 8192x8192 px"):
        open_video(np.zeros((3, 9, 9), np.uint8), mask=tmp_path / "1.png")
