"""Readers: one contract for all of them, then what each has to put up with."""

import itertools
import math
import os
import struct
import sys
from collections import deque

import cv2
import numpy as np
import pytest
from conftest import FPS, HEIGHT, N_FRAMES, WIDTH, looming_frames, write_video
from hypothesis import given
from hypothesis import strategies as st

from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.video.frames import (
    KEPT_PICTURES,
    Frame,
    selection,
    open_video,
    processed_size,
)
from dlgmd_cli.video.base import Verdict
from dlgmd_cli.video.luma import resized, to_grey
from dlgmd_cli.video.timestamps import FrameClock, HoleWatch

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


def test_contract_twice_the_same(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        first, second = list(source), list(source)
    assert [f.time_s for f in first] == [f.time_s for f in second]
    assert all(np.array_equal(a.luminance, b.luminance) for a, b in zip(first, second, strict=True))


def test_contract_frames_do_not_change_later(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        kept = [(f.luminance, f.luminance.copy()) for f in source]
    assert all(np.array_equal(a, b) for a, b in kept)


def test_contract_pictures_stay_while_a_few_more_are_taken(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        kept = deque(maxlen=KEPT_PICTURES)
        for picture in source.pictures(KEPT_PICTURES):
            kept.append((picture, picture.image.copy()))
            assert all(np.array_equal(one.image, copy) for one, copy in kept)
        assert len(kept) == KEPT_PICTURES
        frame = source.frame(kept[-1][0])
        assert frame.index == source.progress.n_decoded - 1
        assert frame.luminance.shape == (HEIGHT, WIDTH)


def test_contract_closing_early(any_input, decoder):
    source = open_video(any_input, decoder=decoder)
    next(iter(source))
    source.close()
    source.close()


@pytest.mark.parametrize("kind", ["avi", "mp4"])
def test_closing_ends_an_iteration(clips, kind, decoder):
    source = open_video(clips / f"loom.{kind}", decoder=decoder)
    frames = iter(source)
    next(frames)
    source.close()
    assert list(frames) == []
    assert len(list(source)) == N_FRAMES  # opened again
    source.close()


def test_contract_size(any_input, decoder):
    with open_video(any_input, decoder=decoder, size_wh=(15, 11)) as source:
        assert next(iter(source)).luminance.shape == (11, 15)
    with open_video(any_input, decoder=decoder, scale=0.5) as source:
        assert next(iter(source)).luminance.shape == (HEIGHT // 2, WIDTH // 2)


def test_contract_span(any_input, decoder):
    with open_video(any_input, decoder=decoder) as source:
        fps = source.info.fps
    with open_video(
        any_input, decoder=decoder, start_s=3 / fps - 0.001, end_s=7 / fps - 0.001
    ) as source:
        assert [f.index for f in source] == [3, 4, 5, 6]


def test_contract_number_of_frames(any_input, decoder):
    with open_video(any_input, max_frames=5, decoder=decoder) as source:
        for _ in range(2):
            assert [f.index for f in source] == [0, 1, 2, 3, 4]
            assert source.progress.n_decoded == 5
        fps = source.info.fps
    with open_video(any_input, max_frames=3, max_fps=fps / 2, decoder=decoder) as source:
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
    select = selection(max_fps=10.0)()
    taken = [i for i in range(30) if select(i / 25.0) is Verdict.TAKE]
    assert taken == [0, 3, 5, 8, 10, 13, 15, 18, 20, 23, 25, 28]


@given(st.lists(st.floats(0.001, 5), min_size=1, max_size=60), st.floats(0.1, 200))
def test_no_more_frames_than_asked_for(intervals, rate):
    times = np.cumsum(intervals)
    select = selection(max_fps=rate)()
    taken = [t for t in times if select(t) is Verdict.TAKE]
    assert len(taken) <= math.floor((times[-1] - times[0] + 1e-3) * rate) + 1
    assert taken[0] == times[0]


@pytest.mark.parametrize(
    "options", [{"start_s": 2.0, "end_s": 1.0}, {"max_fps": 0.0}, {"max_fps": NAN}]
)
def test_bad_selection(options):
    with pytest.raises(ParameterError):
        selection(**options)


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
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_luminance_of_every_kind_of_picture(depth, channels):
    top = np.iinfo(depth).max
    colour = np.array([0.2, 0.5, 0.9, 0.1])[:channels] * top
    image = np.broadcast_to(colour.astype(depth), (6, 8, channels)).copy()
    expected = 0.2 if channels == 1 else 0.114 * 0.2 + 0.587 * 0.5 + 0.299 * 0.9
    for picture in (image, image[:, :, 0]) if channels == 1 else (image,):
        luminance = to_luminance(picture, (8, 6))
        assert luminance.dtype == np.float32
        assert luminance == pytest.approx(expected, abs=1.5 / top)


def test_luminance_is_exact_for_grey():
    grey = np.arange(256, dtype=np.uint8).reshape(16, 16)
    assert np.array_equal(to_luminance(grey, (16, 16)), grey.astype(np.float32) / 255)


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


@pytest.mark.parametrize(("depth", "kind"), [(np.uint8, np.uint8), (np.uint16, np.float32)])
def test_grey_is_new_memory_of_the_kind_that_models_take(depth, kind):
    for picture in (np.ones((4, 6), depth), np.ones((4, 6, 1), depth), np.ones((4, 6, 3), depth)):
        grey = to_grey(picture, (6, 4))
        assert grey.dtype == kind and not np.may_share_memory(grey, picture)


def test_shrinking_averages_areas():
    checks = np.indices((8, 8)).sum(axis=0) % 2 * np.uint8(200)
    assert np.all(to_luminance(checks.astype(np.uint8), (4, 4)) == np.float32(100) / 255)


def test_odd_pictures_are_refused():
    for image in (np.zeros((4, 4), np.float32), np.zeros((4, 4, 2), np.uint8)):
        with pytest.raises(SourceError):
            to_luminance(image, (4, 4))


# Times


def test_clock_keeps_good_stamps():
    clock = FrameClock(30.0)
    stamps = [-0.04, 0.0, 0.05, 7.0, 1e6]
    assert [clock.time(i, s) for i, s in enumerate(stamps)] == stamps
    assert clock.report() is None


def test_clock_without_stamps_counts():
    clock = FrameClock(25.0)
    assert [clock.time(i, 0.0 if i == 0 else NAN) for i in range(4)] == [0.0, 0.04, 0.08, 0.12]
    assert "no timestamps" in clock.report() and "25 fps" in clock.report()


def test_clock_bridges_a_bad_stamp():
    clock = FrameClock(10.0)
    times = [clock.time(i, s) for i, s in enumerate([0.0, 0.1, 0.1, 0.3, NAN, 0.5])]
    assert times == pytest.approx([0.0, 0.1, 0.15, 0.3, 0.35, 0.5])
    assert clock.report().startswith("2 frames had no usable timestamp")


@given(st.lists(st.floats(allow_nan=True, allow_infinity=True), min_size=1, max_size=50))
def test_clock_always_increases(stamps):
    clock = FrameClock(30.0)
    times = [clock.time(i, s) for i, s in enumerate(stamps)]
    assert all(b > a for a, b in itertools.pairwise(times))


def holes(intervals, fps=30.0):
    """What is said of frames at these intervals, in frames."""
    watch = HoleWatch(fps)
    for index, time_s in enumerate(np.cumsum([0.0, *intervals]) / fps):
        watch.add(index, time_s)
    return watch.report()


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


def with_durations(data: bytes, runs: list[tuple[int, int]]) -> bytes:
    """An MP4 (index at its end, one track) with other durations: (frames, time units) in turn."""
    start = data.index(b"stts") - 4
    old_size = struct.unpack(">I", data[start : start + 4])[0]
    entries = b"".join(struct.pack(">II", *run) for run in runs)
    box = b"stts" + bytes(4) + struct.pack(">I", len(runs)) + entries
    box = struct.pack(">I", 4 + len(box)) + box
    grown = bytearray(data[:start] + box + data[start + old_size :])
    for parent in (b"moov", b"trak", b"mdia", b"minf", b"stbl"):
        at = data.index(parent) - 4
        size = struct.unpack(">I", data[at : at + 4])[0] + len(box) - old_size
        grown[at : at + 4] = struct.pack(">I", size)
    return bytes(grown).replace(b"edts", b"free")  # the edit list would cut it to its old length


def test_times_of_a_variable_frame_rate(tmp_path, decoder):
    data = write_video(tmp_path / "x.mp4", looming_frames(), fourcc="mp4v").read_bytes()
    box = data.index(b"stts")
    n_entries, n_frames, unit = struct.unpack(">III", data[box + 8 : box + 20])
    assert (n_entries, n_frames) == (1, N_FRAMES)
    path = tmp_path / "vfr.mp4"
    path.write_bytes(with_durations(data, [(8, unit), (4, 3 * unit), (8, 2 * unit)]))
    with open_video(path, decoder=decoder) as source:
        times = [f.time_s for f in source]
        assert source.progress.warnings == []
    steps = [1] * 8 + [3] * 4 + [2] * 7
    assert np.diff(times) == pytest.approx(np.array(steps) / FPS, abs=1e-6)


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


def test_rotation_is_honoured(tmp_path, decoder):
    frames = [np.zeros((HEIGHT, WIDTH), np.uint8) for _ in range(4)]
    for frame in frames:
        frame[:4] = 255  # a bright upper edge
    path = write_video(tmp_path / "rotated.mp4", frames, fourcc="mp4v")
    data = bytearray(path.read_bytes())
    matrix = data.index(b"tkhd") + 4 + 40  # of a version-0 track header
    one = 0x10000
    assert struct.unpack(">9i", data[matrix : matrix + 36])[:5] == (one, 0, 0, 0, one)
    data[matrix : matrix + 36] = struct.pack(">9i", 0, one, 0, -one, 0, 0, 0, 0, 1 << 30)
    path.write_bytes(data)
    with open_video(path, decoder=decoder) as source:
        picture = next(iter(source)).luminance
        assert (source.info.width, source.info.height) == (HEIGHT, WIDTH)
    assert picture.shape == (WIDTH, HEIGHT)
    assert picture[:, -2:].mean() > 0.8 > 0.2 > picture[:, :-8].mean()  # now on the right


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


def test_a_change_of_size_ends_the_reading(tmp_path, decoder):
    path = tmp_path / "changes.mjpeg"
    small = [jpeg(frame) for frame in looming_frames(7)]
    large = [jpeg(frame) for frame in looming_frames(5, 48, 40)]
    path.write_bytes(b"".join(small + large))
    with open_video(path, decoder=decoder) as source:
        frames = list(source)
        (warning,) = [line for line in source.progress.warnings if "size" in line]
    assert len(frames) == 7
    assert "changes to 48x40" in warning and "used 7 frames" in warning


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


def test_what_is_not_there(tmp_path):
    with pytest.raises(SourceError, match="no such file"):
        open_video(tmp_path / "none.mp4")
    with pytest.raises(SourceError):
        open_video("x" * 5000)
    with pytest.raises(SourceError):
        open_video("nul\0.mp4")
    with pytest.raises(SourceError, match="no picture in this folder"):
        open_video(tmp_path)
    with pytest.raises(SourceError, match="no file matches"):
        open_video(tmp_path / "%03d.png")
    with pytest.raises(SourceError, match="no file matches"):
        open_video(tmp_path / "*.png")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no FIFO here")
def test_a_fifo_does_not_hang(tmp_path):
    os.mkfifo(tmp_path / "pipe.mp4")
    with pytest.raises(SourceError, match="neither a file nor a folder"):
        open_video(tmp_path / "pipe.mp4")


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


def test_rate_of_pictures(pictures):
    with open_video(pictures) as source:
        assert next(iter(source)).time_s == 0.0 and source.info.fps == 30.0
        assert any("taken as 30 fps" in line for line in source.progress.warnings)
    with open_video(pictures, input_fps=8.0) as source:
        assert [f.time_s for f in source][:3] == [0.0, 0.125, 0.25]
        assert source.progress.warnings == []


@pytest.mark.parametrize("channels", [None, 3, 4])
@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_pictures_of_every_kind(tmp_path, channels, depth):
    shape = (6, 8) if channels is None else (6, 8, channels)
    cv2.imwrite(str(tmp_path / "1.png"), np.full(shape, np.iinfo(depth).max // 2, depth))
    with open_video(tmp_path) as source:
        assert next(iter(source)).luminance == pytest.approx(0.5, abs=0.01)


def test_a_damaged_picture_ends_the_sequence(tmp_path):
    for number, frame in enumerate(looming_frames(6)):
        cv2.imwrite(str(tmp_path / f"{number}.png"), frame)
    (tmp_path / "4.png").write_bytes(b"no picture")
    with open_video(tmp_path, input_fps=30) as source:
        assert len(list(source)) == 4
        assert "4.png cannot be read" in source.progress.warnings[0]
        assert "the 4 of 6 pictures" in source.progress.warnings[0]


def test_a_picture_of_another_size_ends_the_sequence(tmp_path):
    for number in range(5):
        size = (6, 8) if number < 3 else (8, 6)
        cv2.imwrite(str(tmp_path / f"{number}.png"), np.zeros(size, np.uint8))
    with open_video(tmp_path, input_fps=30) as source:
        assert len(list(source)) == 3
        assert "3.png is 6x8, not 8x6" in source.progress.warnings[0]


def test_a_first_picture_that_is_none(tmp_path):
    (tmp_path / "1.png").write_bytes(b"no picture")
    with pytest.raises(SourceError, match="cannot be read as a picture"):
        open_video(tmp_path)
