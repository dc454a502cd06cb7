"""The film of a model at work: its pictures, its ribbon, and the files it is written to."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import read_video, result_of_level
from matplotlib.colors import to_rgb

from dlgmd_cli.errors import OutputError
from dlgmd_cli.plots.film import HEIGHT, WIDTH, Film, FilmFacts
from dlgmd_cli.plots.heat import Scale
from dlgmd_cli.plots.pixels import pixel_figure, rasterised
from dlgmd_cli.plots.ribbon import Ribbon
from dlgmd_cli.plots.style import BLUE, ORANGE
from dlgmd_cli.results.tables import Result
from dlgmd_cli.video.files import count_frames
from dlgmd_cli.video.writer import best_codec, playable_fps, video_writer

UNITS = ("luminance", "luminance²")
# Of a film of 16:9: the rows of the panels, and the left and right edges of each.
PANEL_ROWS = slice(90, 280)
PANELS = (slice(84, 438), slice(488, 842), slice(892, 1246))


def make_result(n=60, *, fps=30.0, start_s=0.0, spikes=(20, 21, 22)):
    level = np.full(n, 0.1)
    level[:3] = np.nan
    level[list(spikes)] = 0.8
    return result_of_level(level, time_s=start_s + np.arange(n) / fps)


def make_film(result=None, shape=(54, 96), scale=None, label="flight · set9"):
    scale = scale or Scale.over(0.0, 2.0)
    return Film(FilmFacts(result or make_result(), shape, scale, scale, UNITS, label))


def images(shape=(54, 96), value=0.0):
    return np.full(shape, value, np.float32)


def is_colour(picture, colour, tolerance=12):
    """Where a BGR picture has that colour."""
    bgr = 255 * np.array(to_rgb(colour))[::-1]
    return np.abs(picture.astype(float) - bgr).max(axis=2) <= tolerance


def test_a_picture_has_the_size_of_hd_video():
    picture = make_film().picture(0, images(), None, None)
    assert picture.shape == (HEIGHT, WIDTH, 3) == (720, 1280, 3) and picture.dtype == np.uint8


def test_panels_show_the_input_and_the_layers_on_their_scales():
    film = make_film()
    picture = film.picture(10, images(value=0.6), images(value=2.0), images(value=0.0))
    grey, s, g = (picture[PANEL_ROWS, columns] for columns in PANELS)
    assert set(np.unique(grey)) == {153}
    assert np.array_equal(np.unique(s.reshape(-1, 3), axis=0), [[164, 254, 252]])  # inferno's end
    assert np.array_equal(np.unique(g.reshape(-1, 3), axis=0), [[3, 0, 0]])  # and its beginning


def test_left_is_left_and_up_is_up():
    s = images()
    s[:27, :48] = 2.0
    picture = make_film().picture(10, images(), s, images())
    panel = picture[PANEL_ROWS, PANELS[1]].max(axis=2)
    height, width = panel.shape
    assert panel[: height // 2 - 8, : width // 2 - 8].min() > 200
    assert panel[height // 2 + 8 :].max() < 20 and panel[:, width // 2 + 8 :].max() < 20


def test_signed_layers_are_painted_about_zero():
    film = make_film(scale=Scale.over(-2.0, 1.0))
    picture = film.picture(10, images(), images(value=-2.0), images(value=0.0))
    blue, _, red = picture[150, 600]
    assert blue > 60 > red
    assert picture[150, 1000].min() > 240  # white


def test_one_active_cell_of_many_is_visible():
    shape = (1080, 1920)
    s = images(shape)
    s[701, 1203] = 2.0
    film = make_film(shape=shape)
    panel = film.picture(10, images(shape), s, images(shape))[PANEL_ROWS, PANELS[1]]
    assert np.count_nonzero(panel.max(axis=2) > 200) == 1


def test_undefined_layers_are_grey_again_after_others():
    film = make_film()
    before = film.picture(0, images(), None, None).copy()
    assert np.median(before[PANEL_ROWS, PANELS[1]]) == 0xDD
    film.picture(1, images(), images(value=2.0), images(value=2.0))
    again = film.picture(0, images(), None, None)
    assert np.array_equal(again, before)


def test_pictures_do_not_depend_on_those_before():
    fresh, used = make_film(), make_film()
    for row in (22, 5, 40):
        used.picture(row, images(value=0.3), images(value=1.0), images())
    arguments = (30, images(value=0.5), images(value=0.5), images(value=0.1))
    assert np.array_equal(used.picture(*arguments), fresh.picture(*arguments))


def trace_of(picture):
    return picture[400:655, 80:1250]


def test_the_trace_ends_at_the_present():
    film = make_film()
    for row in (10, 30, 59):
        trace = trace_of(film.picture(row, images(), images(), images()))
        drawn = np.flatnonzero(is_colour(trace, BLUE).any(axis=0))
        now = row / 60 * 1170
        assert drawn[0] == pytest.approx(3 / 60 * 1170, abs=3)
        assert now - 10 <= drawn[-1] <= now + 1


def test_spikes_are_dots_at_their_times():
    film = make_film(make_result(spikes=(20, 40)))
    trace = trace_of(film.picture(59, images(), images(), images()))
    columns = np.flatnonzero(is_colour(trace, ORANGE).any(axis=0))
    dots = np.split(columns, np.flatnonzero(np.diff(columns) > 3) + 1)
    assert [dot.mean() for dot in dots] == pytest.approx([20 / 60 * 1170, 40 / 60 * 1170], abs=2)
    trace = trace_of(film.picture(30, images(), images(), images()))
    assert np.flatnonzero(is_colour(trace, ORANGE).any(axis=0)).max() < 30 / 60 * 1170


def test_a_collision_is_said_while_it_lasts():
    film = make_film()
    said = [
        is_colour(film.picture(row, images(), images(), images())[:50], "#D55E00").any()
        for row in (19, 20, 21, 22, 23)
    ]
    assert said == [False, False, True, True, False]


def test_frame_and_time_are_printed():
    film = make_film()
    headers = [film.picture(row, images(), images(), images())[:50, :500].copy() for row in (7, 8)]
    assert not np.array_equal(*headers)
    same = make_film(make_result(30)).picture(7, images(), images(), images())[:50, :500]
    assert np.array_equal(same, headers[0])


def test_a_long_trace_scrolls_with_the_present_at_the_right():
    result = make_result(1000, spikes=(990, 950, 500))
    film = make_film(result)
    trace = trace_of(film.picture(995, images(), images(), images()))
    columns = np.flatnonzero(is_colour(trace, ORANGE).any(axis=0))
    dots = np.split(columns, np.flatnonzero(np.diff(columns) > 3) + 1)
    expected = [1162 - (995 - row) / 300 * 1170 for row in (950, 990)]
    assert [dot.mean() for dot in dots] == pytest.approx(expected, abs=2)


def test_lengths_of_the_ribbon_join():
    result = make_result(1000, spikes=(299, 300, 301, 306))
    ribbon, shifted = Ribbon(result, 1170, 280), Ribbon(result, 1170, 280)
    shifted._first_s -= 5.0  # its joints lie elsewhere
    joined = ribbon.cut(1000, 400, 10**6)
    whole = shifted.cut(1000 + 1170 // 2, 400, 10**6)
    assert joined.shape == (280, 400, 3) and is_colour(joined, ORANGE).sum() > 50
    assert np.count_nonzero(np.abs(joined.astype(int) - whole).max(axis=2) > 40) == 0


def test_a_line_crosses_lengths_without_any_frame():
    regular = make_result(100, spikes=())
    times = np.append(regular.time_s[:-1], 35.0)
    ribbon = Ribbon(replace(regular, time_s=times), 1170, 280)
    for left in (1170 + 100, 2 * 1170 + 100):
        assert is_colour(ribbon.cut(left, 300, 10**6), BLUE).any(axis=0).all()


def test_what_is_drawn_of_the_ribbon_does_not_follow_its_length(monkeypatch):
    drawn = []
    draw = Ribbon._draw

    def counting(self, number):
        drawn.append(number)
        return draw(self, number)

    monkeypatch.setattr(Ribbon, "_draw", counting)
    ribbon = Ribbon(make_result(100_000), 1170, 280)
    for time_s in (0.0, 0.1, 3000.0, 3000.1):
        now = ribbon.place(time_s)
        ribbon.cut(max(0, now - 1169), 1170, now)
    assert len(drawn) <= 6


@pytest.mark.parametrize("shape", [(1, 1), (1000, 4), (4, 1000), (480, 270), (270, 480)])
@pytest.mark.parametrize("n", [1, 2, 60])
def test_any_shape_and_length(shape, n):
    result = make_result(60)
    short = Result(**{name: series[:n] for name, series in vars(result).items()})
    film = make_film(short, shape, label="$^{ \x07 飞" + "y" * 300)
    for row in range(min(n, 3)):
        assert film.picture(row, images(shape), images(shape, 1.0), images(shape)).any()


def test_nothing_to_scale():
    for scale in (None, Scale.over(0.0, 0.0)):
        film = Film(FilmFacts(make_result(), (54, 96), scale, scale, UNITS))
        assert film.picture(3, images(), images(), images()).shape == (HEIGHT, WIDTH, 3)


def pictures(n, shape=(48, 64)):
    """Frame k is of one grey level, 20 + 10k, with a red square."""
    for k in range(n):
        image = np.full((*shape, 3), 20 + 10 * k, np.uint8)
        image[8:24, 8:24] = (0, 0, 200)
        yield image


CODECS = ["mpeg4", "h264"]


def write(path, n=12, codec="mpeg4", fps=25.0):
    if codec == "h264" and best_codec() != "h264":
        pytest.skip("H.264 needs PyAV")
    with video_writer(path, (48, 64), fps, codec=codec, is_colour=True) as put:
        for image in pictures(n):
            put(image)
    return path


@pytest.mark.parametrize("codec", CODECS)
@pytest.mark.parametrize("fps", [25.0, 29.97, 59.94, 1.0, 240.0])
def test_a_video_comes_back(tmp_path, codec, fps):
    path = write(tmp_path / "x.mp4", codec=codec, fps=playable_fps(fps))
    rate, frames = read_video(path)
    assert rate == pytest.approx(fps, rel=1e-3)
    assert len(frames) == count_frames(path) == 12
    for k, frame in enumerate(frames):
        assert frame.shape == (48, 64, 3)
        assert np.abs(frame[:, 40:].astype(int) - (20 + 10 * k)).max() <= 6
        blue, green, red = frame[16, 16].astype(int)
        assert red > 180 and blue < 30 and green < 30


@pytest.mark.parametrize("codec", CODECS)
def test_names_that_decoders_read_otherwise(tmp_path, codec):
    for name in ("a%03d.mp4", "b:c.mp4", "d$e f.mp4"):
        assert count_frames(write(tmp_path / name, codec=codec)) == 12


def test_h264_is_what_browsers_play(tmp_path):
    path = write(tmp_path / "x.mp4", codec="h264")
    data = path.read_bytes()
    assert data.index(b"moov") < data.index(b"mdat")  # plays while it loads
    av = pytest.importorskip("av")
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.pix_fmt) == ("h264", "yuv420p")
        assert stream.codec_context.colorspace == 1  # BT.709


def test_without_pyav_it_is_mpeg4(monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    assert best_codec() == "mpeg4"


@pytest.mark.parametrize("codec", CODECS)
def test_a_folder_that_is_not_there(tmp_path, codec):
    with pytest.raises(OutputError):
        write(tmp_path / "no" / "x.mp4", codec=codec)


@pytest.mark.skipif(sys.platform != "linux", reason="limits the size of files as POSIX has it")
@pytest.mark.parametrize("codec", CODECS)
def test_a_full_disk_is_noticed(tmp_path, codec):
    if codec == "h264" and best_codec() != "h264":
        pytest.skip("H.264 needs PyAV")
    script = f"""
import resource
from pathlib import Path
import numpy as np
from dlgmd_cli.errors import OutputError
from dlgmd_cli.video.writer import video_writer
resource.setrlimit(resource.RLIMIT_FSIZE, (50_000, 50_000))
rng = np.random.default_rng(1)
path = Path("x.mp4")
try:
    with video_writer(path, (480, 640), 30.0, codec={codec!r}, is_colour=True) as put:
        for _ in range(30):
            put(rng.integers(0, 255, (480, 640, 3), dtype=np.uint8))
except OutputError as error:
    print("noticed", error, path.exists())
"""
    done = subprocess.run(
        [sys.executable, "-c", script], cwd=tmp_path, capture_output=True, text=True
    )
    assert done.stdout.startswith("noticed x.mp4: ") and "False" in done.stdout, done.stderr


@pytest.mark.parametrize(
    ("fps", "expected"),
    [(30.0, 30.0), (30000 / 1001, 29.97), (120000 / 1001, 119.88), (0.2, 1.0), (5000.0, 240.0)],
)
def test_playable_rates(fps, expected):
    assert playable_fps(fps) == expected


def test_a_figure_has_the_pixels_asked_for():
    sides = range(20, 420)
    for height in sides:
        assert rasterised(pixel_figure(30, height)).shape == (height, 30, 3)
        assert rasterised(pixel_figure(height, 30)).shape == (30, height, 3)
