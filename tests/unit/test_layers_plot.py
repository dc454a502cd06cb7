"""The contact sheet: tiles, scales, titles, and that nothing active is lost in it."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from matplotlib import colormaps
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb

from dlgmd_cli.plots.heat import Scale, strongest
from dlgmd_cli.plots.layers import plot_layers
from dlgmd_cli.plots.pixels import drawable, rasterised
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.results.layers import LayerSheet, Shot, write_npz

UNITS = ("luminance", "luminance", "luminance²")


def make_sheet(n=3, shape=(27, 48), *, label="", frame_step=10, units=UNITS, start=0):
    """Frame k has one active cell in each layer, of strength k in P, 10k in S, 100k in G."""
    shots = []
    for k in range(n):
        layers = []
        for factor in (1, 10, 100):
            layer = np.zeros(shape, np.float32)
            layer[shape[0] // 3, shape[1] // 4] = factor * k
            layers.append(layer)
        grey = np.full(shape, 0.25, np.float32)
        shots.append(Shot(start + k * frame_step, (start + k * frame_step) / 30, grey, *layers))
    return LayerSheet.of(shots, units, label)


def undefined(sheet, *names):
    return replace(sheet, **{name: np.full_like(sheet.p, np.nan) for name in names})


def tiles(figure, n):
    """The axes of the tiles, a list a row; every row has n of them."""
    found = [axes for axes in figure.axes if not hasattr(axes, "_colorbar")]
    return [found[row * n : (row + 1) * n] for row in range(4)]


def bars(figure):
    return [axes for axes in figure.axes if hasattr(axes, "_colorbar")]


def words(figure):
    return [text.get_text() for text in figure.texts]


def pixels(figure):
    """The figure as it is saved, (H, W, 3) in RGB order."""
    return rasterised(figure)[:, :, ::-1]


def tile_pixels(figure, axes):
    """The pixels of one tile, without its rim."""
    box = axes.get_window_extent()
    picture = pixels(figure)
    height = picture.shape[0]
    rows = slice(round(height - box.y1) + 1, round(height - box.y0) - 1)
    return picture[rows, round(box.x0) + 1 : round(box.x1) - 1]


def test_a_row_a_layer_and_a_column_a_frame():
    sheet = make_sheet(4, label="flight · set9")
    figure = plot_layers(sheet)
    rows = tiles(figure, 4)
    assert all(len(row) == 4 for row in rows) and len(figure.axes) == 16 + 4
    for row, images in zip(rows, (sheet.luminance, sheet.p, sheet.s, sheet.g), strict=True):
        for axes, image in zip(row, images, strict=True):
            assert np.array_equal(axes.get_images()[0].get_array(), image)
    expected = {"Input", "P", "S", "G", "frame 30", "1.000 s", "frame 0", "0.000 s"}
    assert expected | {"flight · set9"} <= set(words(figure))
    assert [axes.get_ylabel() for axes in bars(figure)] == ["luminance", *UNITS]


def test_tiles_of_a_row_share_one_scale_from_zero():
    figure = plot_layers(make_sheet(4))
    limits = [{axes.get_images()[0].get_clim() for axes in row} for row in tiles(figure, 4)]
    assert limits == [{(0.0, 1.0)}, {(0.0, 3.0)}, {(0.0, 30.0)}, {(0.0, 300.0)}]


def test_signs_make_the_scale_symmetric():
    sheet = make_sheet(3)
    sheet.s[1, 0, 0] = -50.0
    s_row = tiles(plot_layers(sheet), 3)[2]
    for axes in s_row:
        image = axes.get_images()[0]
        assert image.get_clim() == (-50.0, 50.0) and image.get_cmap().name == "RdBu_r"
    red, _, blue = colormaps["RdBu_r"](0.0)[:3]
    assert blue > red  # below zero is blue


def test_the_row_label_colours_mean_what_the_bar_says():
    figure = plot_layers(make_sheet(3, shape=(4, 4)))
    hottest = tile_pixels(figure, tiles(figure, 3)[1][2])
    top = np.array(colormaps["inferno"](1.0)[:3]) * 255
    n_cells = np.count_nonzero(np.abs(hottest - top).max(axis=2) < 2)
    assert n_cells == pytest.approx(hottest.shape[0] * hottest.shape[1] / 16, rel=0.1)


def test_an_undefined_layer_is_a_grey_box_that_says_so():
    sheet = make_sheet(2)
    sheet.s[0] = np.nan
    figure = plot_layers(sheet)
    first, second = tiles(figure, 2)[2]
    assert not first.get_images() and second.get_images()
    assert [text.get_text() for text in first.texts] == ["undefined"]
    assert tuple(first.get_facecolor()[:3]) == to_rgb("#DDDDDD")
    assert second.get_images()[0].get_clim() == (0.0, 10.0)


def test_a_row_without_any_layer_has_no_bar():
    figure = plot_layers(undefined(make_sheet(2), "s", "g"))
    assert [axes.get_ylabel() for axes in bars(figure)] == ["luminance", "luminance"]
    assert "everywhere" not in " ".join(words(figure))


def test_all_zero_has_words_for_a_bar():
    sheet = make_sheet(1)  # its only frame has strength 0
    figure = plot_layers(sheet)
    assert [axes.get_ylabel() for axes in bars(figure)] == ["luminance"]
    assert words(figure).count("0 luminance\neverywhere") == 2
    assert "0 luminance²\neverywhere" in words(figure)
    dark = tile_pixels(figure, tiles(figure, 1)[3][0])
    assert np.abs(dark - np.array(colormaps["inferno"](0.0)[:3]) * 255).max() < 2


@pytest.mark.parametrize("shape", [(1080, 1920), (1920, 1080), (700, 701)])
@pytest.mark.parametrize("width", ["one", "two"])
def test_one_active_cell_of_many_is_visible(shape, width):
    figure = plot_layers(make_sheet(5, shape), width=width)
    top = np.array(colormaps["inferno"](1.0)[:3]) * 255
    for row in tiles(figure, 5)[1:]:
        hottest = tile_pixels(figure, row[4])
        rows, columns = np.nonzero(np.abs(hottest - top).max(axis=2) < 2)
        assert 1 <= rows.size <= 4
        place = rows.mean() / hottest.shape[0], columns.mean() / hottest.shape[1]
        assert place == pytest.approx((1 / 3, 1 / 4), abs=0.03)


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


def test_nothing_defined_has_no_scale():
    assert Scale.over(np.inf, -np.inf) is None
    assert Scale.of(np.full((2, 2), np.nan, np.float32)) is None


@pytest.mark.parametrize("width", ["one", "two"])
@pytest.mark.parametrize("shape", [(270, 480), (480, 270), (1000, 4), (4, 1000), (1, 1)])
@pytest.mark.parametrize("n", [1, 5, 12])
def test_sizes_and_proportions(n, shape, width):
    figure = plot_layers(make_sheet(n, shape, label="x" * 200), width=width)
    figure_width, figure_height = figure.get_size_inches()
    assert figure_width <= {"one": 3.5, "two": 7.16}[width] + 1e-9
    assert figure_height < 9.5  # of a page
    for axes in np.ravel(tiles(figure, n)):
        box = axes.get_window_extent()
        assert box.x0 >= 0 and box.y0 >= 0
        assert box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
        if min(box.width, box.height) > 1.5:
            assert box.width / box.height == pytest.approx(shape[1] / shape[0], rel=1e-6)


@pytest.mark.parametrize("shape", [(270, 480), (480, 270), (1000, 4), (4, 1000)])
@pytest.mark.parametrize(("n", "start"), [(1, 0), (3, 12345), (12, 0), (12, 1_234_567)])
def test_words_neither_overlap_nor_leave_the_figure(n, start, shape):
    figure = plot_layers(make_sheet(n, shape, start=start, label="flight · set9"))
    renderer = FigureCanvasAgg(figure).get_renderer()
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    for number, box in enumerate(boxes):
        assert box.x0 >= 0 and box.x1 <= figure.bbox.x1, words(figure)[number]
        assert box.y0 >= 0 and box.y1 <= figure.bbox.y1, words(figure)[number]
        for other in boxes[:number]:
            apart = box.x1 <= other.x0 or other.x1 <= box.x0
            assert apart or box.y1 <= other.y0 + 1 or other.y1 <= box.y0 + 1
    for axes in bars(figure):
        box = axes.get_tightbbox(renderer)
        assert box.x1 <= figure.bbox.x1 and box.y0 >= 0


@pytest.mark.filterwarnings("ignore:Glyph")  # the command says it in one line
def test_any_name_can_be_drawn(tmp_path):
    figure = plot_layers(make_sheet(2, label="$x^{$ · \x07飞行\n" + "y" * 500))
    save_figure(figure, tmp_path / "x.svg")
    assert (tmp_path / "x.svg").stat().st_size > 1000
    assert drawable("a$\x00飞") == "a$□□"
    assert len(drawable("y" * 500, 20)) == 20 and drawable("y" * 20, 20) == "y" * 20


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_it_can_be_written_and_is_the_same_every_time(suffix, tmp_path):
    for name in "ab":
        save_figure(plot_layers(make_sheet(2)), tmp_path / f"{name}.{suffix}")
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_a_saved_sheet_has_the_pixels_that_cells_were_chosen_for(tmp_path):
    figure = plot_layers(make_sheet(5, (1080, 1920)))
    save_figure(figure, tmp_path / "x.png")
    saved = cv2.imread(str(tmp_path / "x.png"))[:, :, ::-1]
    assert np.array_equal(saved, pixels(figure))


def test_arrays_come_back(tmp_path):
    sheet = undefined(make_sheet(3), "s")
    write_npz(tmp_path / "x.npz", sheet)
    with np.load(tmp_path / "x.npz", allow_pickle=False) as loaded:
        assert set(loaded) == {"frame", "time_s", "luminance", "p", "s", "g", "units"}
        for name in set(loaded) - {"units"}:
            assert np.array_equal(loaded[name], getattr(sheet, name), equal_nan=True)
            assert loaded[name].dtype == getattr(sheet, name).dtype
        assert loaded["units"].tolist() == list(UNITS)


def test_colour_bars_are_of_their_rows():
    figure = plot_layers(make_sheet(3))
    tops = [axes.get_ylim()[1] for axes in bars(figure)]
    assert tops == [1.0, 2.0, 20.0, 200.0]
