"""The film of a model at work: panels on their scales, and the trace up to the present."""

import numpy as np
import pytest
from conftest import result_of_level
from matplotlib.colors import to_rgb

from dlgmd_cli.plots.film import HEIGHT, WIDTH, Film
from dlgmd_cli.plots.heat import Scale
from dlgmd_cli.plots.style import BLUE, ORANGE, VERMILION

UNITS = ("luminance", "luminance²")


def make_result(n=60, *, spikes=(20, 21, 22), **options):
    level = np.full(n, 0.1)
    level[:3] = np.nan
    level[[row for row in spikes if row < n]] = 0.8
    return result_of_level(level, time_s=np.arange(n) / 30, **options)


def make_film(result=None, shape=(54, 96), scale=None, label="flight · set9"):
    scale = scale or Scale.over(0.0, 2.0)
    return Film(result or make_result(), shape, (scale, scale), UNITS, label)


@pytest.fixture(scope="module")
def film():
    return make_film()


def images(shape=(54, 96), value=0.0):
    return np.full(shape, value, np.float32)


def panel(film, picture, number, margin=3):
    """The pixels of a panel without its rim."""
    rows, columns = film._panels[number]
    return picture[
        rows.start + margin : rows.stop - margin, columns.start + margin : columns.stop - margin
    ]


def trace(film, picture):
    return picture[film._trace]


def is_colour(picture, colour, tolerance=12):
    """Where a BGR picture has that colour."""
    bgr = 255 * np.array(to_rgb(colour))[::-1]
    return np.abs(picture.astype(float) - bgr).max(axis=2) <= tolerance


def test_panels_show_the_input_and_the_layers_on_their_scales(film):
    picture = film.picture(10, images(value=0.6), images(value=2.0), images(value=0.0))
    assert picture.shape == (HEIGHT, WIDTH, 3) == (720, 1280, 3) and picture.dtype == np.uint8
    grey, s, g = (panel(film, picture, number) for number in range(3))
    assert set(np.unique(grey)) == {153}
    assert np.array_equal(np.unique(s.reshape(-1, 3), axis=0), [[164, 254, 252]])  # inferno's end
    assert np.array_equal(np.unique(g.reshape(-1, 3), axis=0), [[3, 0, 0]])  # and its beginning


def test_left_is_left_and_up_is_up(film):
    s = images()
    s[:27, :48] = 2.0
    shown = panel(film, film.picture(10, images(), s, images()), 1).max(axis=2)
    height, width = shown.shape
    assert width / height == pytest.approx(96 / 54, rel=0.05)
    assert shown[: height // 2 - 8, : width // 2 - 8].min() > 200
    assert shown[height // 2 + 8 :].max() < 20 and shown[:, width // 2 + 8 :].max() < 20


def test_signed_layers_are_painted_about_zero():
    film = make_film(scale=Scale.over(-2.0, 1.0))
    picture = film.picture(10, images(), images(value=-2.0), images(value=0.0))
    blue, _, red = panel(film, picture, 1)[50, 50]
    assert blue > 60 > red and panel(film, picture, 2).min() > 240  # white


def test_one_active_cell_of_many_is_visible():
    shape = (1080, 1920)
    s = images(shape)
    s[701, 1203] = 2.0
    film = make_film(shape=shape)
    shown = panel(film, film.picture(10, images(shape), s, images(shape)), 1)
    assert np.count_nonzero(shown.max(axis=2) > 200) == 1


def test_undefined_layers_are_grey_and_pictures_do_not_depend_on_those_before(film):
    before = film.picture(0, images(), None, None).copy()
    assert np.median(panel(film, before, 1)) == 0xDD
    for row in (40, 21, 22):
        film.picture(row, images(value=0.3), images(value=2.0), images(value=1.0))
    assert np.array_equal(film.picture(0, images(), None, None), before)


def test_the_trace_ends_at_the_present_and_spikes_are_dots(film):
    for row in (10, 30, 59):
        shown = trace(film, film.picture(row, images(), images(), images()))
        now = row / 59 * shown.shape[1]
        drawn = np.flatnonzero(is_colour(shown, BLUE).any(axis=0))
        assert drawn[0] == pytest.approx(3 / 59 * shown.shape[1], abs=4)
        assert now - 12 <= drawn[-1] <= now + 2
        dots = np.flatnonzero(is_colour(shown, ORANGE).any(axis=0))
        assert bool(dots.size) == (row > 20)
        if dots.size:
            ends = 20 / 59 * shown.shape[1], 22 / 59 * shown.shape[1]
            assert (dots[0] + 3, dots[-1] - 3) == pytest.approx(ends, abs=3)


def test_an_alarm_is_said_while_it_lasts(film):
    said = [
        is_colour(film.picture(row, images(), images(), images())[:50], VERMILION).any()
        for row in (19, 20, 21, 22, 23)
    ]
    assert said == [False, False, True, True, False]


def test_the_header_changes_with_the_frame(film):
    headers = [film.picture(row, images(), images(), images())[:50, :500].copy() for row in (7, 8)]
    assert not np.array_equal(*headers)
