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
from dlgmd_cli.plots.layers import plot_layers
from dlgmd_cli.results.layers import write_npz


def titles(figure):
    return [label.get_text() for label in rows(figure)[0].get_xticklabels()]


def words(axes):
    return [text.get_text() for text in axes.texts]


def test_a_row_a_layer_and_a_column_a_frame():
    sheet = make_sheet(4, label="flight · set9")
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
    assert [axes.get_ylim()[1] for axes in bars(figure)] == [1.0, 3.0, 30.0, 300.0]


def test_tiles_of_a_row_share_one_scale():
    sheet = make_sheet(4)
    sheet.s[1, 0, 0] = -50.0
    limits = [
        {image.get_clim() for image in axes.get_images()} for axes in rows(plot_layers(sheet))
    ]
    assert limits == [{(0.0, 1.0)}, {(0.0, 3.0)}, {(-50.0, 50.0)}, {(0.0, 300.0)}]


def test_colours_mean_what_the_bar_says():
    figure = plot_layers(make_sheet(3, shape=(4, 4)))
    shown = tile_pixels(pixels(figure), rows(figure)[1].get_images()[2])
    assert hot(shown).mean() == pytest.approx(1 / 16, rel=0.1)


def test_an_undefined_layer_is_a_grey_box_that_says_so():
    sheet = make_sheet(2)
    sheet.s[0] = np.nan
    s_row = rows(plot_layers(sheet))[2]
    assert words(s_row) == ["undefined"] and len(s_row.patches) == 1
    assert [image.get_clim() for image in s_row.get_images()] == [(0.0, 10.0)]
    nothing = np.full_like(sheet.p, np.nan)
    figure = plot_layers(replace(sheet, s=nothing, g=nothing))
    assert len(bars(figure)) == 2 and words(rows(figure)[3]) == ["undefined"] * 2


def test_all_zero_has_words_for_a_bar():
    figure = plot_layers(make_sheet(1))  # its only frame has strength 0
    assert [axes.get_ylabel() for axes in bars(figure)] == ["luminance"]
    assert words(rows(figure)[3]) == ["0 luminance²\neverywhere"]
    dark = tile_pixels(pixels(figure), rows(figure)[3].get_images()[0])
    assert np.abs(dark - np.array(colormaps["inferno"](0.0)[:3]) * 255).max() < 2


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


@given(st.floats(-1e6, 1e6), st.floats(-1e6, 1e6))
def test_a_scale_holds_its_values(a, b):
    low, high = min(a, b), max(a, b)
    scale = Scale.over(low, high)
    assert scale.low <= low and high <= scale.high
    assert scale.low in (0.0, -scale.high)
    assert scale.is_flat == (low == high == 0.0)
    assert scale.limits[0] < scale.limits[1]


def test_painting_agrees_with_matplotlib():
    values = np.linspace(-3, 3, 7, dtype=np.float32)[None]
    for scale in (Scale.over(-3.0, 1.0), Scale.over(0.0, 3.0)):
        low, high = scale.limits
        expected = colormaps[scale.colours](np.clip((values - low) / (high - low), 0, 1))
        painted = scale.painted(np.clip(values, low, high))[:, :, ::-1]
        assert np.abs(painted - 255 * expected[:, :, :3]).max() < 8
    assert Scale.over(np.inf, -np.inf) is None
    assert Scale.of(np.full((2, 2), np.nan, np.float32)) is None


def test_arrays_come_back(tmp_path):
    sheet = make_sheet(3)
    sheet.s[:] = np.nan
    write_npz(tmp_path / "x.npz", sheet)
    with np.load(tmp_path / "x.npz", allow_pickle=False) as loaded:
        assert set(loaded) == {"frame", "time_s", "luminance", "p", "s", "g", "units"}
        for name in set(loaded) - {"units"}:
            assert np.array_equal(loaded[name], getattr(sheet, name), equal_nan=True)
            assert loaded[name].dtype == getattr(sheet, name).dtype
        assert loaded["units"].tolist() == list(UNITS)
