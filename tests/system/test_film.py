"""The film of a model at work: panels on their scales, and the trace up to the present."""

import math

import numpy as np
import pytest
from conftest import result_of_level
from matplotlib.colors import to_rgb

from dlgmd_cli.plots.film import HEIGHT, WIDTH, Film
from dlgmd_cli.plots.heat import TINT, Overlay, Scale, mark_centroid
from dlgmd_cli.plots.style import BLUE, ORANGE, VERMILION

UNITS = ("luminance", "luminance²")


def make_result():
    level = np.full(60, 0.1)
    level[:3], level[20:23] = np.nan, 0.8
    return result_of_level(level, time_s=np.arange(60) / 30)


def make_film(scale):
    return Film(make_result(), (54, 96), (scale, scale), UNITS, "flight · set9")


@pytest.fixture(scope="module")
def film():
    return make_film(Scale.over(0.0, 2.0))


def images(value=0.0):
    return np.full((54, 96), value, np.float32)


def panel(film, picture, number, margin=3):
    """The pixels of a panel without its rim."""
    rows, columns = film.panels[number]
    return picture[
        rows.start + margin : rows.stop - margin, columns.start + margin : columns.stop - margin
    ]


def is_colour(picture, colour, tolerance=12):
    """Where a BGR image has that colour."""
    bgr = 255 * np.array(to_rgb(colour))[::-1]
    return np.abs(picture.astype(float) - bgr).max(axis=2) <= tolerance


def test_panels_show_the_input_and_the_layers_on_their_scales(film):
    picture = film.picture(10, images(0.6), images(2.0), images(0.0))
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
    film = make_film(Scale.over(-2.0, 1.0))
    picture = film.picture(10, images(), images(-2.0), images(0.0))
    blue, _, red = panel(film, picture, 1)[50, 50]
    assert blue > 60 > red and panel(film, picture, 2).min() > 240  # white


def test_undefined_layers_are_grey(film):
    assert np.median(panel(film, film.picture(0, images(), None, None), 1)) == 0xDD


def test_the_trace_ends_at_the_present_and_spikes_are_dots(film):
    for row in (10, 30, 59):
        shown = film.picture(row, images(), images(), images())[film.traces[0]]
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
    headers = [film.picture(row, images(), images(), images())[:50, :500] for row in (7, 8)]
    assert not np.array_equal(*headers)


def test_a_ring_marks_the_centroid():
    for g_x, g_y, at in ((-1.0, -1.0, (0, 0)), (1.0, 1.0, (199, 99)), (0.5, 0.0, (150, 50))):
        picture = np.full((100, 200, 3), 90, np.uint8)
        mark_centroid(picture, g_x, g_y)
        y, x = np.nonzero((picture == 255).all(axis=2))
        assert np.hypot(x - at[0], y - at[1]) == pytest.approx(3.5, abs=1.5)
    picture = np.full((100, 200, 3), 90, np.uint8)
    mark_centroid(picture, math.nan, math.nan)
    assert (picture == 90).all()


@pytest.mark.parametrize("shape", [(270, 480), (480, 270)])
def test_an_overlay_names_its_marks_and_has_the_mp_as_a_bar(shape):
    result = make_result()
    film = Overlay(result, shape, 1.0)
    shown = {
        row: film.picture(row, np.full((*shape, 3), 120, np.uint8), None) for row in (0, 9, 22)
    }
    heights = {}
    for row, picture in shown.items():
        assert is_colour(picture[shape[0] // 2 :], TINT).sum() > 50  # in the legend
        bar = picture[40 : round(0.8 * shape[0]), shape[1] // 2 :]
        heights[row] = [is_colour(bar, colour).any(axis=1).sum() for colour in (BLUE, ORANGE)]
    assert heights[0] == [0, 0]  # undefined
    whole = 0.6 * shape[0]
    assert heights[9] == [pytest.approx(0.1 * whole, abs=3), 0]
    # The tick at the threshold lies on it.
    assert heights[22] == [0, pytest.approx(0.8 * whole, abs=8)]
