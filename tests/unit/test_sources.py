"""Everything that frames come from: the same contract, and the same frames."""

import itertools
from contextlib import nullcontext
from pathlib import Path

import cv2
import numpy as np
import pytest
from conftest import FPS, HEIGHT, N_FRAMES, WIDTH, looming_frames, write_video

import dlgmd_cli
from dlgmd_cli import Alarm, load_set, open_video
from dlgmd_cli.errors import ParameterError, SourceError
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.session import Session
from dlgmd_cli.results import csv
from dlgmd_cli.results.reading import read_result
from dlgmd_cli.video.images import numbered_places

FRAMES = looming_frames()


def a_video(folder, decoder):
    if decoder == "pyav":
        pytest.importorskip("av", reason="the pyav decoder needs av")
    return write_video(folder / "loom.avi", FRAMES, fourcc="FFV1"), {"decoder": decoder}


def pictures(folder, pattern=""):
    for index, frame in enumerate(FRAMES):
        cv2.imwrite(str(folder / f"{index:04d}.png"), frame)
    return folder / pattern, {"input_fps": FPS}


def a_file_of_numbers(folder):
    np.save(folder / "loom.npy", FRAMES)
    return folder / "loom.npy", {"input_fps": FPS}


def a_stack(folder):
    cv2.imwritemulti(str(folder / "loom.tif"), FRAMES)
    return folder / "loom.tif", {"input_fps": FPS}


SOURCES = {
    "opencv": lambda folder: a_video(folder, "opencv"),
    "pyav": lambda folder: a_video(folder, "pyav"),
    "pictures": pictures,
    "printf": lambda folder: pictures(folder, "%04d.png"),
    "glob": lambda folder: pictures(folder, "*.png"),
    "npy": a_file_of_numbers,
    "tiff": a_stack,
    "array": lambda folder: (np.array(FRAMES), {"input_fps": FPS}),
    "colour": lambda folder: (np.array(FRAMES)[..., None].repeat(3, 3), {"input_fps": FPS}),
    "list": lambda folder: (FRAMES, {"input_fps": FPS}),
}


def opened(kind, folder):
    """A source of a kind."""
    given, options = SOURCES[kind](folder)
    return open_video(given, **options)


@pytest.mark.parametrize("kind", SOURCES)
def test_every_source_keeps_the_contract(kind, tmp_path):
    with opened(kind, tmp_path) as source:
        info = source.info
        assert (info.width, info.height, info.fps) == (WIDTH, HEIGHT, FPS)
        assert info.n_frames == N_FRAMES and info.name and source.size_wh == (WIDTH, HEIGHT)
        first, frames = list(source), list(source.frames())
        copies = [one.grey.copy() for one in first]  # every iteration starts at the beginning
        for each in (first, frames):
            assert [one.index for one in each] == list(range(N_FRAMES))
            assert np.allclose([one.time_s for one in each], np.arange(N_FRAMES) / FPS)
            assert np.array_equal([one.grey for one in each], copies)  # in memory of their own
            assert not any(map(np.shares_memory, [one.grey for one in each], FRAMES))
        assert source.progress.n_decoded == N_FRAMES
        assert source.progress.last_time_s == frames[-1].time_s
        luminance = frames[-1].luminance
        assert luminance.dtype == np.float32 and luminance.shape == (HEIGHT, WIDTH)
        assert 0.0 <= luminance.min() <= luminance.max() <= 1.0
        frame = next(source.frames((16, 12), (8, 6), picture_wh=(20, 15)))
        assert frame.grey.shape == (12, 16) and frame.at((8, 6)).shape == (6, 8)
        assert frame.picture.shape == (15, 20, 3) and frame.picture.dtype == np.uint8
        levels = np.array([one.grey for one in frames], float)
        assert np.abs(levels - FRAMES).max() <= (2 if kind in ("opencv", "pyav") else 0)
        rest = iter(source)
        next(rest)
        source.close()
        source.close()
        assert kind not in ("opencv", "pyav") or list(rest) == []
        assert len(list(source)) == N_FRAMES  # opened again


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"max_frames": 5}, [0, 1, 2, 3, 4]),
        ({"start_s": 3 / FPS - 0.001, "end_s": 7 / FPS - 0.001}, [3, 4, 5, 6]),
        ({"max_frames": 3, "max_fps": FPS / 2}, [0, 2, 4]),
        ({"max_fps": FPS / 3}, [*range(0, N_FRAMES, 3)]),
        ({"max_fps": FPS * 2}, [*range(N_FRAMES)]),
    ],
    ids=str,
)
@pytest.mark.parametrize("kind", ["opencv", "pyav", "pictures", "array"])
def test_every_source_gives_the_part_that_is_asked_for(kind, tmp_path, options, expected):
    given, how = SOURCES[kind](tmp_path)
    with open_video(given, **how, **options) as source:
        for _ in range(2):
            frames = list(source)
            assert [one.index for one in frames] == expected
            assert [one.time_s for one in frames] == pytest.approx([n / FPS for n in expected])


@pytest.mark.parametrize("step", [1, 5])
def test_images_that_are_missing_in_their_numbers_leave_a_gap(tmp_path, step):
    drawn = looming_frames(30)
    kept = [number for number in range(30) if number not in (10, 11, 12)]
    for number in kept:
        cv2.imwrite(str(tmp_path / f"cam2_{number * step:03d}.png"), drawn[number])
    (tmp_path / f"cam2_{10 * step:03d}.png").symlink_to("nowhere.png")
    (tmp_path / f"cam2_{11 * step:03d}.png").mkdir()
    with open_video(tmp_path, input_fps=FPS) as video:
        frames = list(video)
    assert [frame.time_s for frame in frames] == [number / FPS for number in kept]
    assert [frame.index for frame in frames] == list(range(27))
    assert [frame.index for frame in frames if frame.after_gap] == [10]
    (damage,) = video.progress.warnings
    assert video.progress.damage == [damage] and "about 3 frames are missing" in damage


@pytest.mark.parametrize(
    "names",
    [
        ["1403636579763555584", "1403636579813555456", "1403636579863555328", "14036365799135552"],
        [str(number) for number in (1, 2, 3, 8, 13, 14, 20, 21, 40)],  # a selection
        [f"{take}_{number}" for take in (1, 7) for number in (1, 2, 3, 4, 5, 6)],
        [f"{number:03d}" for number in range(0, 60, 3)],
        ["a", "b", "c", "d", "e", "g"],
        ["only"],
        ["x1", "x"],
    ],
)
def test_other_names_of_images_tell_no_times(names):
    places = numbered_places([Path(f"/run3/{name}.png") for name in names])
    assert list(places) == list(range(len(names)))


def test_arrays_and_files_give_the_same_result(runs, tmp_path):
    np.save(tmp_path / "flight.v2.npy", FRAMES)
    cv2_frames = [cv2.cvtColor(frame, cv2.COLOR_GRAY2BGR) for frame in FRAMES]
    results = [
        dlgmd_cli.run(np.array(FRAMES), fps=FPS),
        dlgmd_cli.run((frame for frame in cv2_frames), fps=FPS),
        dlgmd_cli.run(np.array(FRAMES) / np.float64(255.0), fps=FPS),
        dlgmd_cli.run("flight.v2.npy", input_fps=FPS),
    ]
    runs("run", "flight.v2.npy", "--input-fps", FPS)
    stored = read_result("dlgmd-out/flight.v2")
    assert stored.name == "flight.v2" and stored.record["input"]["decoder"] == "array"
    for one in results:
        assert np.allclose(one.mp, stored.mp, rtol=1e-6, equal_nan=True)
        assert np.allclose(one.time_s, np.arange(N_FRAMES) / FPS)
    results[0].save("saved")
    assert read_result("saved").name == "array"
    half, many = dlgmd_cli.run(FRAMES, model=[9, "lgmd"], input_fps=FPS, fps=FPS / 2)
    assert len(half) == len(many) == N_FRAMES // 2


@pytest.mark.parametrize(
    ("images", "why"),
    [
        ([], "holds no frames"),
        ([np.zeros((4, 4), np.int64)], "frame 0 is int64"),
        ([np.zeros((4, 4, 4), np.uint8)], "frame 0 is uint8 of shape (4, 4, 4)"),
        ([np.full((4, 4), 200.0)], "numbers from 200 to 200"),
        ([np.full((4, 4), np.nan)], "frame 0 holds a number that is not finite"),
        ([7], "frame 0 is int64 of shape ()"),
        (np.zeros((24, 32, 3), np.uint8), "its array has the shape (24, 32, 3)"),
        (np.zeros((24, 32), np.uint8), "its array has the shape (24, 32)"),
    ],
)
def test_what_is_no_picture_is_refused(images, why):
    with pytest.raises(SourceError) as error:
        dlgmd_cli.run(images, fps=30)
    assert why in str(error.value)


def with_number(number, index=9):
    """The frames as numbers from 0 to 1, but for one number of one frame."""
    frames = np.array(FRAMES) / np.float32(255.0)
    frames[index, 3, 4] = number
    return frames


NO_PICTURES = {
    "nan": (with_number(np.nan), "frame 9 holds a number that is not finite (NaN or infinity)"),
    "inf": (with_number(np.inf), "frame 9 holds a number that is not finite (NaN or infinity)"),
    "above": (with_number(1.5), "frame 9 holds numbers from 0"),
    "size": ([*FRAMES[:9], FRAMES[9][:-2], *FRAMES[10:]], "frame 9 is uint8 of shape (22, 32)"),
}


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *(("whole", name) for name in NO_PICTURES),
        *(("iterable", name) for name in NO_PICTURES),
        *(("file", name) for name in ("nan", "inf", "above")),  # which holds one array
    ],
)
def test_one_bad_image_in_memory_is_an_error_and_no_shorter_result(tmp_path, kind, name):
    """Of a whole array before anything is computed, of an iterable when the image is reached."""
    images, why = NO_PICTURES[name]
    seen, source = [], images
    if kind == "iterable":
        source = (image for image in images)
    elif kind == "file":
        source = tmp_path / "x.npy"
        np.save(source, images)
    rate = {"input_fps": FPS} if kind == "file" else {"fps": FPS}

    def progress(*_):
        return nullcontext(seen.append)

    with pytest.raises(SourceError) as error:
        dlgmd_cli.run(source, 9, progress=progress, out=tmp_path / "out", **rate)
    assert why in str(error.value)
    assert seen == ([*range(1, 10)] if kind == "iterable" else [])
    assert not [*(tmp_path / "out").glob("*/*")]


def test_files_of_other_arrays_are_refused(tmp_path):
    np.save(tmp_path / "x.npy", np.zeros((9, 9, 9), np.uint8))
    whole = (tmp_path / "x.npy").read_bytes()
    changes = (b"'descr'", b'"""escr '), (b"(9", b"((")
    for changed in (*(whole.replace(*change) for change in changes), whole[:80]):
        (tmp_path / "x.npy").write_bytes(changed)
        with pytest.raises(SourceError, match="not an array of numbers"):
            open_video(tmp_path / "x.npy")
    for name, array in (("flat", np.zeros((3, 4))), ("objects", np.array([{}, {}], object))):
        np.save(tmp_path / f"{name}.npy", array, allow_pickle=True)
        with pytest.raises(SourceError, match=r"shape \(3, 4\)|cannot be read"):
            open_video(tmp_path / f"{name}.npy")
    (tmp_path / "x.npz").write_bytes(bytes(99))
    with pytest.raises(SourceError, match="not an array of numbers in NumPy's format"):
        open_video(tmp_path / "x.npz")
    with pytest.raises(ParameterError, match="not int"):
        dlgmd_cli.run(5)


def test_after_a_gap_the_model_restarts_even_if_the_first_picture_is_a_repeat(tmp_path):
    """Ten seconds away: what comes back is new, and must not be compared with what was before."""
    frames = [*FRAMES[:10], *FRAMES[9:]]
    times = [t / FPS + (10.0 if t >= 10 else 0.0) for t in range(len(frames))]
    alarm, fresh = Alarm(load_set(9)), Alarm(load_set(9))
    found = [alarm.step(frame, t) for frame, t in zip(frames, times, strict=True)]
    assert [one.is_valid for one in found[9:14]] == [True, False, False, False, True]
    expected = [fresh.step(frame) for frame in frames[10:]]
    assert [one.mp for one in found[13:]] == [one.mp for one in expected[3:]]
    pytest.importorskip("av", reason="PyAV writes times with a gap")
    from damaged import encode

    stamps = np.rint(1000.0 * np.array(times)).astype(int)
    encode(tmp_path / "gap.mkv", frames, "ffv1", stamps=stamps)
    result = dlgmd_cli.run(tmp_path / "gap.mkv", model=9)
    assert not result.is_repeat.any()
    assert np.isnan(result.mp[10:13]).all() and not np.isnan(result.mp[9:14:4]).any()


def test_a_gap_before_a_repeat_is_kept_for_the_next_frame():
    session = Session([create_model(load_set(3))])
    for index in range(6):
        session.step(Frame(index, index / FPS, FRAMES[index]))
    (again,) = session.step(Frame(6, 9.0, FRAMES[5], is_repeat=True, after_gap=True))
    assert again.is_valid
    (following,) = session.step(Frame(7, 9.1, FRAMES[6]))
    assert not following.is_valid


def test_older_tables_and_newer_ones_are_read(clips, tmp_path):
    result = dlgmd_cli.run(clips / "loom.avi")
    result.save(tmp_path / "x")
    for name, left_out, added in (("mp.csv", ("g_x", "g_y"), 0), ("attenuation.csv", (), 1)):
        path = tmp_path / "x" / name
        header, *lines = (line.split(",") for line in path.read_text().splitlines())
        keep = [place for place, one in enumerate(header) if one not in left_out]
        rows = [[line[place] for place in keep] + ["7"] * added for line in lines]
        names = [header[place] for place in keep] + ["later"] * added
        path.write_text("\n".join(map(",".join, itertools.chain([names], rows))) + "\n")
    stored = read_result(tmp_path / "x")
    assert np.isnan(stored.g_x).all() and np.allclose(stored.mp, result.mp, equal_nan=True)
    assert {*dir(stored)} >= csv.KNOWN


def test_a_collision_given_later_has_warnings_of_its_own(clips):
    result = dlgmd_cli.run(clips / "loom.avi")
    result.until(9).warnings.append("only there")
    assert "only there" not in result.warnings


@pytest.mark.parametrize("name", ["x.npy", "x/%04d.png"])
def test_fps_states_the_rate_of_images_in_memory_and_limits_a_stated_one(tmp_path, dlgmd, name):
    np.save("x.npy", FRAMES)
    (tmp_path / "x").mkdir()
    pictures(tmp_path / "x")
    assert dlgmd_cli.run(FRAMES, fps=15).record["input"]["fps"] == 15
    with pytest.raises(ParameterError, match=r"fps 15 limits .* state none\. Give theirs"):
        dlgmd_cli.run(name, fps=15)
    refused = dlgmd("run", name, "--fps", 15)
    assert refused.exit_code == 2 and "Give theirs with --input-fps" in refused.stderr
    assert len(dlgmd_cli.run(name, fps=15, input_fps=30)) == N_FRAMES // 2
    assert len(dlgmd_cli.run(name, fps="all")) == N_FRAMES


DEEP = [frame.astype(np.uint16) * 16 for frame in FRAMES]


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize("kind", ["array", "npy", "png"])
def test_samples_of_twelve_bits_are_what_they_are_with_their_depth(tmp_path, kind, channels):
    frames = [np.repeat(one[..., None], channels, 2).squeeze() for one in DEEP]
    source = frames
    if kind == "npy":
        source = tmp_path / "x.npy"
        np.save(source, frames)
    elif kind == "png":
        source = tmp_path
        for number, frame in enumerate(frames):
            cv2.imwrite(str(tmp_path / f"{number:04d}.png"), frame)
    given = {"input_fps": FPS, "bit_depth": 12}
    with open_video(source, **given) as video:
        shown = list(video.frames(picture_wh=(32, 24)))
        assert video.progress.warnings == []
    for one, grey in zip(shown, FRAMES, strict=True):
        np.testing.assert_allclose(one.grey, grey * np.float32(16 / 4095), atol=1e-3)
        np.testing.assert_allclose(one.picture[..., 0], grey, atol=1.01)
    with open_video(source, input_fps=FPS) as video:
        assert max(one.grey.max() for one in video) < 0.1
        (line,) = video.progress.warnings
    assert "give bit_depth=12" in line
    with open_video(source, input_fps=FPS, bit_depth=10) as video:
        assert max(one.grey.max() for one in video) == 1.0
        assert "are cut off at white by bit_depth=10" in video.progress.warnings[0]


@pytest.mark.parametrize("kind", ["array", "png"])
def test_samples_of_0_and_1_alone_are_told(tmp_path, kind):
    frames = [frame // 128 for frame in FRAMES]
    assert {*np.unique(frames)} == {0, 1}
    if kind == "png":
        for number, frame in enumerate(frames):
            cv2.imwrite(str(tmp_path / f"{number:04d}.png"), frame)
    with open_video(frames if kind == "array" else tmp_path, input_fps=FPS) as video:
        list(video)
    line = "all samples of 8 bits are 0 or 1, where white is 255; multiply them by 255"
    assert line in video.progress.warnings
    for others in (np.uint8(frames) * 255, np.float32(frames), np.uint8(frames) * 2):
        with open_video(others, input_fps=FPS) as video:
            list(video)
        assert line not in video.progress.warnings


COLOUR = np.array(FRAMES)[..., None].repeat(4, 3)


@pytest.mark.parametrize(
    "array",
    [
        np.moveaxis(COLOUR[..., :3], -1, 1),
        np.moveaxis(COLOUR, -1, 1),
        np.moveaxis(COLOUR[..., :1], -1, 1),
        np.moveaxis(COLOUR[..., :3], 0, -1),
        COLOUR,
        COLOUR[..., :1],
    ],
    ids=["n3HW", "n4HW", "n1HW", "HW3n", "nHW4", "nHW1"],
)
def test_colours_on_another_axis_are_refused(array):
    with pytest.raises(SourceError, match=r"frame 0 is uint8 of .*, of shape \(H, W\) or"):
        open_video(array)


def test_an_npz_file_of_one_array_is_read_and_others_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.savez_compressed("one.npz", frames=FRAMES)
    with open_video("one.npz") as video:
        assert len(list(video)) == N_FRAMES
    np.savez("two.npz", t=np.arange(20.0), frames=FRAMES)
    with pytest.raises(SourceError, match="holds the arrays t, frames") as error:
        open_video("two.npz")
    assert error.value.hint.endswith(" in Python: dlgmd_cli.run(np.load('two.npz')[NAME]).")


@pytest.mark.parametrize("version", ["5.0", "7.3"])
def test_a_file_of_matlab_is_refused_with_a_hint(tmp_path, monkeypatch, version):
    monkeypatch.chdir(tmp_path)
    Path("x.mat").write_bytes(f"MATLAB {version} MAT-file".encode() + bytes(200))
    with pytest.raises(SourceError, match=r"is a file of MATLAB, not a video.*scipy.io.loadmat"):
        open_video("x.mat")


def named(folder, names):
    image = cv2.imencode(".png", FRAMES[0])[1].tobytes()
    for name in names:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(image)


@pytest.mark.parametrize(
    "cameras",
    [
        ("x_cam_1_{:04}.png", "x_cam_2_{:04}.png"),
        ("{:04}_cam0.png", "{:04}_cam1.png"),
        ("cam1.{:04}.png", "cam2.{:04}.png"),
        ("left{}.png", "right{}.png"),
        ("{:04}L.png", "{:04}R.png"),
        ("rgb_{:04}.png", "depth16_{:04}.png"),
        ("{:04}.png", "{:04}_depth.png"),
        ("{:04}.png", "{:04}.jpg"),
        ("DJI_202301011200{0:02}_{0:04}_T.png", "DJI_202301011200{0:02}_{0:04}_V.png"),
        ("left_16{}.11.png", "right_16{}.52.png"),
        ("img_t{:03}_z01_c0.png", "img_t{:03}_z01_c1.png"),
        ("left/{:04}.png", "right/{:04}.png"),
        ("{:04}.png", "mask.png"),
    ],
)
def test_images_of_two_cameras_are_refused_with_a_pattern_that_works(tmp_path, cameras):
    named(tmp_path, [name.format(number) for name in cameras for number in range(10, 30)])
    with pytest.raises(SourceError, match="holds several series of images: 20 ") as error:
        open_video(tmp_path / "*/*.png" if "/" in cameras[0] else tmp_path)
    with open_video(error.value.hint.split("'")[1]) as video:
        assert len(list(video)) == 20


@pytest.mark.parametrize(
    "names",
    [
        [f"cam_1_{number:04}.png" for number in range(40)],
        [f"camera{number}.png" for number in range(40)],
        [f"t{0.25 * number:g}.png" for number in range(40)],
        [f"2024-01-01_12-{30 + number // 4}-{15 * (number % 4)}.png" for number in range(40)],
        [f"{number:04}_{'blur' if number % 3 else 'ok'}.png" for number in range(40)],
        [f"{number:04}.{'jpg' if number % 9 else 'png'}" for number in range(40)],
        [f"part{1 + number // 20}_{number:04}.png" for number in range(40)],
        [*(f"{number:04}.png" for number in range(39)), "0003 copy.png"],
        [f"{np.random.default_rng(number).bytes(4).hex()}.png" for number in range(40)],
    ],
)
def test_images_of_one_camera_are_read(tmp_path, names):
    named(tmp_path, names)
    with open_video(tmp_path) as video:
        assert len(list(video)) == 40


def test_frames_on_the_last_axis_are_told():
    frames = np.array(FRAMES)[:8]
    with open_video(np.moveaxis(frames, 0, -1), input_fps=FPS) as video:
        (line,) = video.progress.warnings
    read_as = f"({HEIGHT}, {WIDTH}, 8) is read as {HEIGHT} frames of 8x{WIDTH} px"
    assert line.startswith(f"its array {read_as}; if the last axis counts the frames, give")
    with open_video(np.moveaxis(np.array(FRAMES), 0, -1), input_fps=FPS) as video:
        assert "(24, 32, 20) is read as 24 frames of 20x32 px" in video.progress.warnings[0]
    noise = np.random.default_rng(7).integers(0, 256, (30, 24, 32), np.uint8)
    for others in (frames, np.array(FRAMES), np.array(FRAMES)[::5], noise, list(frames)):
        with open_video(others, input_fps=FPS) as video:
            assert video.progress.warnings == []


def test_the_bits_that_are_missed_are_those_of_the_brightest_sample():
    frames = [frame.copy() for frame in DEEP]
    for frame in frames:
        frame[0, 0] = 0
    with open_video(frames, input_fps=FPS) as video:
        list(video)
    (line,) = video.progress.warnings
    brightest = max(int(frame.max()) for frame in frames)
    assert f"all samples of 16 bits are {brightest} or less" in line and "12 bits" in line


@pytest.mark.parametrize("whole", [np.uint16(65535), np.float32(1.0)])
def test_black_and_white_of_deep_colours_are_shown_as_they_are(whole):
    levels = np.linspace(0.0, 1.0, 256)[None, :, None].repeat(4, 1).transpose(1, 2, 0)
    image = (levels * whole).astype(type(whole))[..., :1].repeat(3, 2)
    with open_video([image, image[::-1]], input_fps=FPS) as video:
        shown = next(iter(video.frames(picture_wh=image.shape[1::-1]))).picture
    assert shown.dtype == np.uint8 and (shown.min(), shown.max()) == (0, 255)


def test_the_depth_is_an_option_of_commands_and_functions(dlgmd):
    np.save("x.npy", DEEP)
    scaled = [np.float32(frame) / np.float32(4095) for frame in DEEP]
    one, other = dlgmd_cli.run(DEEP, fps=FPS, bit_depth=12), dlgmd_cli.run(scaled, fps=FPS)
    np.testing.assert_allclose(one.mp, other.mp, rtol=1e-3, atol=0.1)
    told = dlgmd("run", "x.npy", "--input-fps", FPS, "--bit-depth", 12, "--format=none")
    assert told.exit_code == 0 and "bit-depth" not in told.stderr
    assert "--bit-depth 12" in dlgmd("run", "x.npy", "--overwrite", "--format=none").stderr
