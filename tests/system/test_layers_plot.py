"""The contact sheet: tiles, scales, titles, and that nothing active is lost in it."""

from dataclasses import replace

import numpy as np
import pytest
from figures import UNITS, bars, hot, make_sheet, pixels, rows, tile_pixels
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from matplotlib import colormaps

from dlgmd_cli.plots.heat import Scale, strongest
from dlgmd_cli.plots.sheets import plot_layers


def titles(figure):
    return [label.get_text() for label in rows(figure)[0].get_xticklabels()]


def words(axes):
    return [text.get_text() for text in axes.texts]


def test_a_row_a_layer_and_a_column_a_frame():
    sheet = make_sheet(4, label="flight · set9")
    sheet.s[1, 0, 0] = -50.0
    figure = plot_layers(sheet)
    assert [axes.get_ylabel() for axes in rows(figure)] == ["Input", "P", "S", "G"]
    for axes, images in zip(
        rows(figure), (sheet.luminance, sheet.p, sheet.s, sheet.g), strict=True
    ):
        lefts = [image.get_extent()[0] for image in axes.get_images()]
        assert len(lefts) == 4 and lefts == sorted(lefts)
        for shown, image in zip(axes.get_images(), images, strict=True):
            assert np.array_equal(shown.get_array(), image)
    assert titles(figure)[3] == "frame 30\n1.000 s"
    assert figure.get_suptitle() == "flight · set9"
    assert [axes.get_ylabel() for axes in bars(figure)] == ["luminance", *UNITS]
    assert [axes.get_ylim()[1] for axes in bars(figure)] == [1.0, 3.0, 50.0, 300.0]
    limits = [{image.get_clim() for image in axes.get_images()} for axes in rows(figure)]
    assert limits == [{(0.0, 1.0)}, {(0.0, 3.0)}, {(-50.0, 50.0)}, {(0.0, 300.0)}]


def test_many_frames_are_shown_in_blocks_on_one_scale():
    figure = plot_layers(make_sheet(12))
    every = rows(figure)
    assert [axes.get_ylabel() for axes in every] == 2 * ["Input", "P", "S", "G"]
    assert [len(axes.get_images()) for axes in every] == [6] * 8
    assert titles(figure)[0].startswith("frame 0\n")
    assert every[4].get_xticklabels()[5].get_text().startswith("frame 110\n")
    limits = [{image.get_clim() for image in axes.get_images()} for axes in every]
    assert limits[:4] == limits[4:] and limits[1] == {(0.0, 11.0)}
    box = every[1].get_images()[0].get_window_extent()
    height_in = figure.get_figheight()
    assert box.width / figure.dpi > 0.8 and height_in < 9.5
    tiles_in = 8 * box.height / figure.dpi
    assert tiles_in > 0.6 * height_in  # no empty strips


def test_an_undefined_layer_is_a_grey_box_that_says_so():
    sheet = make_sheet(2)
    sheet.s[0] = np.nan
    figure = plot_layers(replace(sheet, g=np.full_like(sheet.p, np.nan)))
    s_row, g_row = rows(figure)[2:]
    assert words(s_row) == ["undefined"] and len(s_row.patches) == 1
    assert [image.get_clim() for image in s_row.get_images()] == [(0.0, 10.0)]
    assert len(bars(figure)) == 3 and words(g_row) == ["undefined"] * 2


def test_all_zero_has_words_for_a_bar_and_colours_mean_what_it_says():
    sheet = make_sheet(2, shape=(4, 4))
    figure = plot_layers(replace(sheet, g=0 * sheet.g))
    assert [axes.get_ylabel() for axes in bars(figure)] == ["luminance", *UNITS[:2]]
    assert words(rows(figure)[3]) == ["0 luminance²\neverywhere"]
    picture = pixels(figure)
    dark = tile_pixels(picture, rows(figure)[3].get_images()[1])
    assert np.abs(dark - np.array(colormaps["inferno"](0.0)[:3]) * 255).max() < 2
    shown = tile_pixels(picture, rows(figure)[1].get_images()[1])
    assert hot(shown).mean() == pytest.approx(1 / 16, rel=0.1)


@given(
    arrays(
        np.float32,
        array_shapes(min_dims=2, max_dims=2, max_side=40),
        elements=st.floats(-9, 9, width=32),
    ),
    st.integers(1, 20),
    st.integers(1, 20),
)
def test_strongest_keeps_extremes_and_invents_nothing(layer, height, width):
    small = strongest(layer, height, width)
    assert small.shape == (min(layer.shape[0], height), min(layer.shape[1], width))
    assert np.abs(small).max() == np.abs(layer).max()
    assert np.isin(small, layer).all()
    # Each stands for cells around the same place: halves stay halves.
    if layer.shape[1] % 2 == 0 and small.shape[1] % 2 == 0:
        left = strongest(layer[:, : layer.shape[1] // 2], height, small.shape[1] // 2)
        assert np.array_equal(small[:, : small.shape[1] // 2], left)


def test_painting_agrees_with_matplotlib():
    values = np.linspace(-3, 3, 7, dtype=np.float32)[None]
    for scale in (Scale.over(-3.0, 1.0), Scale.over(0.0, 3.0)):
        low, high = scale.limits
        assert low in (0.0, -high) and high == 3.0
        expected = colormaps[scale.colours](np.clip((values - low) / (high - low), 0, 1))
        painted = scale.painted(np.clip(values, low, high))[:, :, ::-1]
        assert np.abs(painted - 255 * expected[:, :, :3]).max() < 8
    assert Scale.of(np.full((2, 2), np.nan, np.float32)) is None
