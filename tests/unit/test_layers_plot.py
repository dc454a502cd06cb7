"""The contact sheet: tiles, scales, titles, and that nothing active is lost in it."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg

from dlgmd_cli.plots.heat import Scale, strongest
from dlgmd_cli.plots.layers import plot_layers
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.results.layers import LayerSheet, write_npz

UNITS = ("luminance", "luminance", "luminance²")


def make_sheet(n=3, shape=(27, 48), *, label="", start=0):
    """Frame k has one active cell in each layer, of strength k in P, 10k in S, 100k in G."""
    layers = np.zeros((3, n, *shape), np.float32)
    for k in range(n):
        layers[:, k, shape[0] // 3, shape[1] // 4] = (k, 10 * k, 100 * k)
    frame = start + 10 * np.arange(n)
    grey = np.full((n, *shape), 0.25, np.float32)
    return LayerSheet(frame, frame / 30, grey, *layers, UNITS, label)


def rows(figure):
    """The axes of the rows: input, P, S, G."""
    return [axes for axes in figure.axes if not hasattr(axes, "_colorbar")]


def bars(figure):
    return [axes for axes in figure.axes if hasattr(axes, "_colorbar") and axes.get_visible()]


def titles(figure):
    return [label.get_text() for label in rows(figure)[0].get_xticklabels()]


def words(axes):
    return [text.get_text() for text in axes.texts]


def pixels(figure):
    """The figure as it is saved, (H, W, 3) in RGB order."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[:, :, :3].astype(int)


def tile_pixels(picture, image):
    """The pixels of one tile, without its rim."""
    box, height = image.get_window_extent(), picture.shape[0]
    return picture[
        round(height - box.y1) + 1 : round(height - box.y0) - 1,
        round(box.x0) + 1 : round(box.x1) - 1,
    ]


def hot(shown):
    """Where the strongest colour is."""
    top = np.array(colormaps["inferno"](1.0)[:3]) * 255
    return np.abs(shown - top).max(axis=2) < 2


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


@pytest.mark.parametrize(("shape", "width"), [((540, 960), "one"), ((500, 501), "two")])
def test_one_active_cell_of_many_is_visible(shape, width):
    figure = plot_layers(make_sheet(5, shape), width=width)
    picture = pixels(figure)
    for axes in rows(figure)[1:]:
        hottest = hot(tile_pixels(picture, axes.get_images()[4]))
        places = np.argwhere(hottest)
        assert 1 <= len(places) <= 4
        assert places.mean(axis=0) / hottest.shape == pytest.approx((1 / 3, 1 / 4), abs=0.04)


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


@pytest.mark.parametrize("width", ["one", "two"])
@pytest.mark.parametrize("shape", [(270, 480), (480, 270), (400, 4), (4, 400), (1, 1)])
@pytest.mark.parametrize("n", [1, 5])
def test_sizes_and_proportions(n, shape, width):
    figure = plot_layers(make_sheet(n, shape, label="x" * 200), width=width)
    figure_width, figure_height = figure.get_size_inches()
    assert figure_width <= {"one": 3.5, "two": 7.16}[width] + 1e-9
    assert figure_height < 9.5  # of a page
    for axes in rows(figure):
        for image in axes.get_images():
            box = image.get_window_extent()
            assert box.x0 >= -1 and box.y0 >= -1
            assert box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1
            if min(box.width, box.height) > 1.5:
                assert box.width / box.height == pytest.approx(shape[1] / shape[0], rel=1e-3)


@pytest.mark.parametrize(("n", "start", "width"), [(3, 12345, "one"), (12, 0, "two")])
def test_titles_neither_overlap_nor_leave_the_figure(n, start, width):
    figure = plot_layers(make_sheet(n, (270, 480), start=start, label="flight"), width)
    labels = [*rows(figure)[0].get_xticklabels(), figure._suptitle]
    boxes = [label.get_window_extent() for label in labels]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in boxes)
    for axes in bars(figure):
        box = axes.get_tightbbox()
        assert box.x1 <= figure.bbox.x1 + 1 and box.y0 >= -1


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_any_name_can_be_drawn_and_files_are_the_same_every_time(suffix, tmp_path):
    for name in "ab":
        figure = plot_layers(make_sheet(2, label="$x^{$ · \x07\n" + "y" * 500))
        save_figure(figure, tmp_path / f"{name}.{suffix}")
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


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
