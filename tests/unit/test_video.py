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

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.video.frames import Frame, open_video, processed_size
from dlgmd_cli.video.luma import resized, to_grey
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead
from dlgmd_cli.video.reading import Selection
from dlgmd_cli.video.timestamps import FrameClock, missing_frames

NAN = math.nan


def to_luminance(image, size_wh, levels=None):
    return Frame(0, 0.0, to_grey(image, size_wh, levels)).luminance


@pytest.fixture(params=["avi", "mp4", "folder", "printf", "glob"])
def any_input(request, clips, pictures):
    """Every kind of input."""
    return {
        "avi": clips / "loom.avi",
        "mp4": clips / "loom.mp4",
        "folder": pictures,
        "printf": pictures / "%d.png",
        "glob": pictures / "*.png",
    }[request.param]


def test_contract_frames(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        frames = list(source)
        assert (source.info.width, source.info.height) == source.size_wh == (WIDTH, HEIGHT)
        assert [f.index for f in frames] == list(range(len(frames)))
        assert source.progress.n_decoded == len(frames) == source.info.n_frames
        times = [f.time_s for f in frames]
        assert times[0] == 0.0 and all(np.diff(times) > 0)
        assert (
            times[-1]
            == source.progress.last_time_s
            == pytest.approx((len(frames) - 1) / source.info.fps)
        )
    for frame in frames:
        assert frame.luminance.shape == (HEIGHT, WIDTH)
        assert frame.luminance.dtype == np.float32
        assert 0.0 <= frame.luminance.min() <= frame.luminance.max() <= 1.0
    # The square has grown: later frames are darker.
    assert frames[-1].luminance.mean() < frames[0].luminance.mean() - 0.2


def test_contract_twice_the_same_and_in_memory_of_its_own(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        first = [(f.time_s, f.grey, f.grey.copy()) for f in source]
        second = list(source)
    for (time_s, grey, copy), again in zip(first, second, strict=True):
        assert time_s == again.time_s and np.array_equal(grey, copy)
        assert np.array_equal(grey, again.grey)


def test_contract_closing(any_input, decoder):
    source = open_video(any_input, decoder=decoder)
    n_frames = len(list(source))
    frames = iter(source)
    next(frames)
    source.close()
    source.close()
    if any_input.suffix in (".avi", ".mp4"):
        assert list(frames) == []
    assert len(list(source)) == n_frames  # opened again
    source.close()


def test_contract_size(any_input, decoder):
    with open_video(any_input, decoder=decoder, size_wh=(15, 11)) as source:
        assert next(iter(source)).luminance.shape == (11, 15)
    with open_video(any_input, decoder=decoder, scale=0.5) as source:
        assert next(iter(source)).luminance.shape == (HEIGHT // 2, WIDTH // 2)


def test_contract_span_and_number(any_input, decoder):
    with open_video(any_input, decoder=decoder, max_frames=5) as source:
        fps = source.info.fps
        for _ in range(2):
            assert [f.index for f in source] == [0, 1, 2, 3, 4]
            assert source.progress.n_decoded == 5
    span = {"start_s": 3 / fps - 0.001, "end_s": 7 / fps - 0.001}
    with open_video(any_input, decoder=decoder, **span) as source:
        assert [f.index for f in source] == [3, 4, 5, 6]
    with open_video(any_input, decoder=decoder, max_frames=3, max_fps=fps / 2) as source:
        assert [f.index for f in source] == [0, 2, 4]


def test_contract_rate(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        fps = source.info.fps
    with open_video(any_input, decoder=decoder, max_fps=fps / 3) as source:
        frames = list(source)
        assert [f.index for f in frames] == list(range(0, source.progress.n_decoded, 3))
        assert [f.time_s for f in frames] == pytest.approx([f.index / fps for f in frames])
    with open_video(any_input, decoder=decoder, max_fps=fps * 2) as source:
        assert len(list(source)) == source.progress.n_decoded


def test_a_rate_that_does_not_divide():
    selection = Selection(max_fps=10.0)
    taken = [i for i in range(30) if selection.takes(i / 25.0)]
    assert taken == [0, 3, 5, 8, 10, 13, 15, 18, 20, 23, 25, 28]


@given(st.lists(st.floats(0.001, 5), min_size=1, max_size=60), st.floats(0.1, 200))
def test_no_more_frames_than_asked_for(intervals, rate):
    times = np.cumsum(intervals)
    selection = Selection(max_fps=rate)
    taken = [t for t in times if selection.takes(t)]
    assert len(taken) <= math.floor((times[-1] - times[0] + 1e-3) * rate) + 1
    assert taken[0] == times[0]


@pytest.mark.parametrize(
    "options", [{"start_s": 2.0, "end_s": 1.0}, {"max_fps": 0.0}, {"max_fps": NAN}]
)
def test_bad_selection(options):
    with pytest.raises(ParameterError):
        Selection(**options)


def test_default_size_is_at_most_480_wide():
    assert processed_size(1920, 1080) == (480, 270)
    assert processed_size(432, 240) == (432, 240)
    assert processed_size(1080, 1920) == (480, 853)
    assert processed_size(100_000, 3) == (480, 1)
    assert processed_size(1920, 1080, scale=1.0) == (1920, 1080)
    assert processed_size(10, 10, size_wh=(20, 30)) == (20, 30)
    for bad in ({"scale": 0.0}, {"scale": 1.5}, {"scale": NAN}, {"size_wh": (0, 5)}):
        with pytest.raises(ParameterError):
            processed_size(10, 10, **bad)
    with pytest.raises(ParameterError):
        processed_size(10, 10, scale=0.5, size_wh=(5, 5))


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_luminance_of_grey_and_colour(depth):
    top = np.iinfo(depth).max
    image = np.full((6, 8, 3), np.array([0.2, 0.5, 0.9]) * top).astype(depth)
    expected = 0.114 * 0.2 + 0.587 * 0.5 + 0.299 * 0.9
    assert to_luminance(image, (8, 6)) == pytest.approx(expected, abs=1.5 / top)
    luminance = to_luminance(image[:, :, 0], (8, 6))
    assert luminance.dtype == np.float32 and luminance == pytest.approx(0.2, abs=1.5 / top)


@pytest.mark.parametrize(
    ("depth", "levels", "expected"),
    [
        (np.uint8, None, [0.0, 16 / 255, 126 / 255, 1.0]),
        (np.uint8, (16, 235), [0.0, 0.0, 128 / 255, 1.0]),
        (np.uint16, (64, 940), [0.0, 0.0, 62 / 876, 191 / 876]),
    ],
)
def test_levels_are_stretched_to_the_full_range(depth, levels, expected):
    picture = np.array([[0, 16, 126, 255]], depth)
    luminance = to_luminance(picture, (4, 1), levels)
    assert luminance[0] == pytest.approx(expected, abs=1e-6)


def test_stretching_is_exact_for_every_level():
    ramp = np.arange(256, dtype=np.uint8)[None]
    exact = np.clip(np.rint((np.arange(256) - 16) * 255 / 219), 0, 255)
    assert np.array_equal(to_grey(ramp, (256, 1), (16, 235))[0], exact)
    assert np.array_equal(to_grey(ramp, (256, 1)), ramp)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
@pytest.mark.parametrize("factors", [(2, 2), (3, 3), (4, 4), (6, 6), (8, 8), (4, 2), (5, 8)])
def test_reduced_pictures_are_means_of_areas(factors, depth):
    across, down = factors
    image = np.random.default_rng(3).integers(0, np.iinfo(depth).max, (24 * down, 32 * across))
    exact = image.reshape(24, down, 32, across).mean(axis=(1, 3))
    reduced = resized(image.astype(depth), (32, 24))
    in_one_step = cv2.resize(image.astype(depth), (32, 24), interpolation=cv2.INTER_AREA)
    assert reduced.dtype == depth
    assert np.abs(reduced - exact).max() <= 1.0
    assert np.abs(reduced.astype(int) - in_one_step.astype(int)).max() <= 1


def test_other_sizes_are_resized_as_by_opencv():
    image = np.random.default_rng(3).integers(0, 255, (54, 96), dtype=np.uint8)
    for size, how in (((40, 30), cv2.INTER_AREA), ((128, 72), cv2.INTER_LINEAR)):
        assert np.array_equal(resized(image, size), cv2.resize(image, size, interpolation=how))


@pytest.mark.parametrize(("depth", "kind"), [(np.uint8, np.uint8), (np.uint16, np.float32)])
def test_grey_is_new_memory_of_the_kind_that_models_take(depth, kind):
    for picture in (np.ones((4, 6), depth), np.ones((4, 6, 3), depth)):
        grey = to_grey(picture, (6, 4))
        assert grey.dtype == kind and not np.may_share_memory(grey, picture)


# Times


@pytest.mark.parametrize(
    ("stamps", "expected", "report"),
    [
        ([-0.04, 0.0, 0.05, 7.0, 1e6], [-0.04, 0.0, 0.05, 7.0, 1e6], None),
        ([0.0, NAN, NAN, NAN], [0.0, 0.1, 0.2, 0.3], "the stream has no timestamps"),
        (
            [0.0, 0.1, 0.1, 0.3, NAN, 0.5],
            [0.0, 0.1, 0.15, 0.3, 0.35, 0.5],
            "2 frames had",
        ),
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
    assert all(b > a for a, b in itertools.pairwise(times))


def holes(intervals, fps=30.0):
    """What is said of frames at these intervals, in frames."""
    return missing_frames(np.cumsum([0.0, *intervals]) / fps, fps)


def test_a_hole_in_a_steady_stream_is_told():
    assert "about 9 frames are missing after frame 30 (1.000 s)" in holes(
        [1] * 30 + [10] + [1] * 30
    )
    ragged = holes([1] * 30 + [2, 7, 1, 2] + [1] * 30)
    assert "about 8 frames are missing after frame 30" in ragged and "more" not in ragged
    two = holes([1] * 30 + [4] + [1] * 30 + [5] + [1] * 30)
    assert "about 7 frames are missing after frame 30 (1.000 s) and in 1 more place" in two


@pytest.mark.parametrize(
    "intervals",
    [
        [1] * 50,
        [1] * 30 + [3] * 30,  # the rate changes
        [1, 1, 1, 4] * 20,  # frames are dropped regularly
        [1.0, 1.6, 0.7, 2.4, 0.5] * 12,  # a phone's jitter
        [1] * 30 + [10],  # a ragged end
        [1] * 30 + [2] + [1] * 30,  # one frame
        [],
    ],
)
def test_a_variable_rate_is_no_hole(intervals):
    assert holes(intervals) is None


# Videos


def test_frames_that_an_edit_list_hides_are_not_missed(tmp_path, decoder):
    path = write_video(tmp_path / "edited.mp4", looming_frames(), fourcc="mp4v")
    data = bytearray(path.read_bytes())
    at = data.index(b"elst") + 12  # of a version-0 edit list: its first segment's duration
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


@pytest.mark.parametrize("share", [0.3, 0.6, 0.9])
def test_a_truncated_file_gives_what_it_holds(tmp_path, share, decoder):
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(40)]
    whole = write_video(tmp_path / "whole.avi", frames)
    path = tmp_path / "part.avi"
    data = whole.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with open_video(path, decoder=decoder) as source:
        n_frames = len(list(source))
        warnings = source.progress.warnings
    assert abs(n_frames - 40 * share) <= 3
    assert any(f"{n_frames} of about 40 frames" in line for line in warnings), warnings


def test_damage_in_the_middle_keeps_what_came_before(tmp_path, decoder):
    rng = np.random.default_rng(1)
    frames = [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(40)]
    path = write_video(tmp_path / "hurt.avi", frames)
    data = bytearray(path.read_bytes())
    starts = [i for i in range(len(data) - 3) if data[i : i + 3] == b"\xff\xd8\xff"]
    assert len(starts) == 40
    for frame in range(20, 26):  # six pictures that are none
        data[starts[frame] : starts[frame] + 600] = bytes(600)
    path.write_bytes(data)
    with open_video(path, decoder=decoder) as source:
        n_frames = len(list(source))
        warnings = source.progress.warnings
    assert n_frames == 20
    assert any("damaged" in line and "20 of about 40" in line for line in warnings), warnings


NAMES = [
    "%04d.avi",
    "100%.avi",
    "%d %s 50%%.avi",
    "two words 'and' \"quotes\".avi",
    "new\nline.avi",
    "ünïcödé 漢字 🐝.avi",
    "-dash.avi",
    "a:b.avi",
    "http:x.avi",
    "concat:a|b.avi",
    "[1]*?.avi",
    " lead.avi",
    "noextension",
]


@pytest.mark.skipif(sys.platform == "win32", reason="such names do not exist on Windows")
@pytest.mark.parametrize("name", NAMES)
def test_any_file_name_works(tmp_path, monkeypatch, clips, name, decoder):
    (tmp_path / name).write_bytes((clips / "loom.avi").read_bytes())
    monkeypatch.chdir(tmp_path)
    for path in (name, tmp_path / name):
        with open_video(path, decoder=decoder) as source:
            assert len(list(source)) == N_FRAMES


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes on Linux only")
def test_a_file_name_that_is_no_text_works(tmp_path, clips, decoder):
    path = os.fsdecode(os.fsencode(tmp_path) + b"/bad\xff.avi")
    with open(path, "wb") as file:
        file.write((clips / "loom.avi").read_bytes())
    with open_video(path, decoder=decoder) as source:
        assert len(list(source)) == N_FRAMES


@pytest.mark.parametrize(
    ("name", "content", "why"),
    [
        ("empty.mp4", b"", "the file is empty"),
        ("text.mp4", b"hello " * 300, "no frame could be decoded"),
        ("noise.avi", bytes(range(256)) * 40, "no frame could be decoded"),
        ("header.avi", b"RIFF\x00\x01\x00\x00AVI LIST", "no frame could be decoded"),
    ],
)
def test_what_is_no_video(tmp_path, name, content, why, decoder):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SourceError, match=why):
        open_video(tmp_path / name, decoder=decoder)


@pytest.mark.parametrize(
    ("path", "why"),
    [
        ("none.mp4", "no such file"),
        ("x" * 5000, None),
        ("nul\0.mp4", None),
        (".", "no picture in this folder"),
        ("%03d.png", "no file matches"),
        ("*.png", "no file matches"),
        ("pipe.mp4", "neither a file nor a folder"),
    ],
    ids=["absent", "long", "nul", "folder", "printf", "glob", "pipe"],
)
def test_what_is_not_there(tmp_path, path, why):
    if path == "pipe.mp4":
        if not hasattr(os, "mkfifo"):
            pytest.skip("no FIFO here")
        os.mkfifo(tmp_path / path)
    with pytest.raises(SourceError, match=why):
        open_video(os.path.join(tmp_path, path))


def test_a_name_for_the_results(tmp_path, monkeypatch, clips, pictures, decoder):
    monkeypatch.chdir(pictures)
    expected = pictures.name
    for path in (".", pictures, "%d.png", "*.png", pictures / "?.png"):
        with open_video(path, decoder=decoder) as source:
            assert source.info.name == expected
    with open_video(clips / "loom.avi", decoder=decoder) as source:
        assert source.info.name == "loom"


# Pictures


def test_natural_order_and_what_is_left_out(tmp_path):
    for number in (10, 9, 1, 100):
        cv2.imwrite(str(tmp_path / f"f{number}.png"), np.full((4, 4), number, np.uint8))
    cv2.imwrite(str(tmp_path / ".f5.png"), np.full((4, 4), 5, np.uint8))
    (tmp_path / "notes.txt").write_text("no picture")
    for path in (tmp_path, tmp_path / "f%d.png", tmp_path / "f*.png"):
        with open_video(path) as source:
            values = [round(float(f.luminance[0, 0]) * 255) for f in source]
        assert values == [1, 9, 10, 100]


@pytest.mark.parametrize("channels", [None, 3, 4])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_pictures_of_every_kind(tmp_path, channels, depth):
    shape = (6, 8) if channels is None else (6, 8, channels)
    cv2.imwrite(str(tmp_path / "1.png"), np.full(shape, np.iinfo(depth).max // 2, depth))
    with open_video(tmp_path) as source:
        assert next(iter(source)).luminance == pytest.approx(0.5, abs=0.01)


@pytest.mark.parametrize(
    ("size", "warning"),
    [(None, "4.png cannot be read as a picture"), ((48, 40), "4.png is 48x40, not 32x24")],
)
def test_a_bad_picture_ends_the_sequence(tmp_path, size, warning):
    for number, frame in enumerate(looming_frames(6)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), frame)
    content = b"no picture" if size is None else jpeg(np.zeros(size[::-1], np.uint8))
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
    (tmp_path / "1.png").write_bytes(b"no picture")
    with pytest.raises(SourceError, match="cannot be read as a picture"):
        open_video(tmp_path)


# Reading ahead


@pytest.fixture
def no_thread_is_left():
    yield
    assert [t for t in threading.enumerate() if "dlgmd-decode" in t.name] == []


@pytest.mark.usefixtures("no_thread_is_left")
@pytest.mark.parametrize("scale", [1.0, 0.5])
def test_reading_ahead_gives_the_same_frames(clips, scale, decoder):
    with open_video(clips / "loom.avi", scale=scale, decoder=decoder) as source:
        plain = [frame.grey for frame in source]
        with read_ahead(source) as frames:
            ahead = [frame.grey for frame in frames]
    assert len(plain) == N_FRAMES and np.array_equal(plain, ahead)


@pytest.mark.usefixtures("no_thread_is_left")
def test_never_further_ahead_than_asked():
    taken = []

    def source():
        for number in range(50):
            taken.append(number)
            yield number

    with read_ahead(source(), depth=3) as items:
        for number in items:
            time.sleep(0.002)
            # Three wait in the queue, and one more in the hand of the thread.
            assert len(taken) <= number + 1 + 3 + 1


@pytest.mark.usefixtures("no_thread_is_left")
def test_an_error_comes_after_what_was_before_it():
    def source():
        yield from range(5)
        raise OSError("damaged")

    seen = []
    with pytest.raises(OSError, match="damaged"), read_ahead(source()) as items:
        for item in items:
            seen.append(item)
    assert seen == list(range(5))


@pytest.mark.usefixtures("no_thread_is_left")
@pytest.mark.parametrize("error", [KeyboardInterrupt, ZeroDivisionError])
def test_an_error_of_the_consumer_stops_the_thread(error):
    def endless():
        number = 0
        while True:
            yield number
            number += 1

    with pytest.raises(error), read_ahead(endless()) as items:
        for number in items:
            if number == 20:
                raise error


def test_the_host_s_threads_are_restored():
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        with pytest.raises(ValueError), opencv_threads(1):
            assert cv2.getNumThreads() == 1
            raise ValueError
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)
