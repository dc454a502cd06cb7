"""Whole figures: nothing covers anything or is cut off, and every kind of data can be drawn."""

from itertools import combinations, pairwise

import numpy as np
import pytest
from conftest import result_of_level
from figures import (
    NAN,
    UNITS,
    attenuation,
    bars,
    boxes,
    curve,
    frame_axis,
    hot,
    legend,
    long_result,
    make_result,
    make_sheet,
    part,
    pixels,
    rows,
    tile_pixels,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters.presets import load_set
from dlgmd_cli.plots.film import Film
from dlgmd_cli.plots.heat import Scale
from dlgmd_cli.plots.sheets import plot_kernels, plot_layers
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.plots.sweeps import plot_sweep
from dlgmd_cli.plots.traces import plot
from dlgmd_cli.results.annotations import KINDS, Annotations

pytestmark = pytest.mark.slow

INF = np.inf
WIDTHS_IN = {"one": 3.5, "two": 7.16}


# Not ttc: these results have no expansion.
@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "ttc"])
@pytest.mark.parametrize(("width", "n_results"), [("one", 4), ("two", 6)])
def test_nothing_is_covered_or_cut_off(kind, width, n_results):
    results = {f"{number} {'long name ' * 9}"[:60]: make_result() for number in range(n_results)}
    figure = plot(kind, results, Annotations(((3, "a mark"),)), width=width)
    figure.draw_without_rendering()
    assert figure.get_figwidth() == WIDTHS_IN[width]
    (item,) = figure.legends
    box = item.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.width + 1 and box.y1 <= figure.bbox.height + 1
    assert len(set(legend(figure))) == len(legend(figure)) == len(item.get_texts())
    top = frame_axis(figure)
    assert all(text.y1 <= box.y0 + 3 for text in boxes([top.xaxis.label, *top.get_xticklabels()]))
    for axes in figure.axes:
        tight = axes.get_tightbbox()
        assert tight.x0 >= -1 and tight.y0 >= -1 and tight.x1 <= figure.bbox.width + 1
    places = [axes.get_position() for axes in figure.axes]
    for one, other in combinations(places, 2):
        assert one.y0 >= other.y1 or one.x1 < other.x0 or other.x1 < one.x0
    for axis in (figure.axes[-1].xaxis, top.xaxis):
        labels = boxes(axis.get_ticklabels())
        assert len(labels) > 1 and all(one.x1 < other.x0 for one, other in pairwise(labels))


def test_every_kind_of_result_can_be_drawn(tmp_path):
    whole = make_result()
    single, undefined = part(whole, slice(3, 4)), part(whole, slice(0, 2))
    mixture = [whole, single, undefined, long_result(2_500)]
    for results in ([single], [undefined], mixture):
        labelled = {str(place): result for place, result in enumerate(results)}
        figure = plot("overview", labelled, Annotations(((1, "x"),), ((0, 3, "y"),), 2, 3))
        save_figure(figure, tmp_path / "x.svg")
        assert (tmp_path / "x.svg").stat().st_size > 1000


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_files_are_small_and_the_same_every_time(suffix, tmp_path):
    noisy = np.random.default_rng(0).random(8_000)
    result = result_of_level(noisy, attenuation_db=-noisy)
    for name in ("a", "b"):
        save_figure(plot("spikes", {"a": result}), tmp_path / f"{name}.{suffix}")
    data = (tmp_path / f"a.{suffix}").read_bytes()
    assert data == (tmp_path / f"b.{suffix}").read_bytes()
    # Text has every spike.
    assert len(data) < (1_000_000 if suffix == "svg" else 160_000)


@pytest.mark.parametrize(("number", "radius"), [(1, 4), (4, 1), (9, 32)])
def test_kernels_say_their_values_and_stay_on_the_figure(number, radius):
    connections = DLGMD(load_set(number, r=radius)).connections
    figure = plot_kernels(
        "set9", connections.excitation, connections.inhibition, connections.latency
    )
    figure.draw_without_rendering()
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert box is None or (box.x0 >= -1 and box.x1 <= figure.bbox.width + 1)
        assert box is None or (box.y0 >= -1 and box.y1 <= figure.bbox.height + 1)
    feet = [axes.xaxis for axes in figure.axes if axes.get_xlabel()]
    labels = [box for axis in feet for box in boxes(axis.get_ticklabels())]
    assert not any(one.overlaps(other) for one, other in combinations(labels, 2))


@settings(max_examples=10, deadline=None)
@given(
    st.lists(
        st.tuples(st.integers(0, 39), st.text("abW i.$_", min_size=1, max_size=60)), max_size=9
    ),
    st.lists(st.tuples(st.integers(0, 39), st.integers(0, 39)), max_size=4),
    st.sampled_from(["one", "two"]),
)
def test_no_text_touches_another_or_leaves_the_figure(marks, spans, width):
    annotations = Annotations(
        tuple(marks), tuple((min(span), max(span), "as long as it takes") for span in spans), 24, 22
    )
    figure = plot("mp", {"a": make_result()}, annotations, width=width)
    figure.draw_without_rendering()
    strip = figure.axes[0]
    extents = [text.get_window_extent() for text in strip.texts]
    assert len(extents) == len(marks) + len(spans) + 2
    assert not any(one.overlaps(other) for one, other in combinations(extents, 2))
    top = strip.get_window_extent()
    for box in extents:
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width
        assert box.y0 >= top.y0 - 3 and box.y1 <= top.y1 + 3


@pytest.mark.parametrize("shape", [(540, 960), (500, 501)])
def test_one_active_cell_of_many_is_visible(shape):
    figure = plot_layers(make_sheet(5, shape))
    picture = pixels(figure)
    for axes in rows(figure)[1:]:
        hottest = hot(tile_pixels(picture, axes.get_images()[4]))
        places = np.argwhere(hottest)
        assert 1 <= len(places) <= 4
        assert places.mean(axis=0) / hottest.shape == pytest.approx((1 / 3, 1 / 4), abs=0.04)


@pytest.mark.parametrize(
    ("n", "shape"),
    [
        *[(1, (270, 480)), (3, (480, 270)), (12, (270, 480))],
        *[(1, (400, 4)), (5, (4, 400)), (1, (1, 1))],
    ],
)
def test_sizes_and_proportions(n, shape):
    figure = plot_layers(
        make_sheet(n, shape, label="$x^{$ · \x07\n" + "x" * 200, start=0 if n > 8 else 12345)
    )
    width, height = figure.get_size_inches()
    assert width <= 7.16 + 1e-9 and height < 9.5  # of a page
    for axes in rows(figure):
        for image in axes.get_images():
            box = image.get_window_extent()
            assert box.x0 >= -1 and box.y0 >= -1
            assert box.x1 <= figure.bbox.x1 + 1 and box.y1 <= figure.bbox.y1 + 1
            if min(box.width, box.height) > 1.5:
                assert box.width / box.height == pytest.approx(shape[1] / shape[0], rel=1e-3)
    assert all(axes.yaxis.label.get_window_extent().x0 >= 0 for axes in rows(figure))
    labels = [*rows(figure)[0].get_xticklabels(), *figure.texts]
    boxes = [label.get_window_extent() for label in labels]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))
    assert all(box.x0 >= 0 and box.x1 <= figure.bbox.x1 for box in boxes)
    for axes in bars(figure):
        box = axes.get_tightbbox()
        assert box.x1 <= figure.bbox.x1 + 1 and box.y0 >= -1


def test_a_large_grid_makes_no_large_file(tmp_path):
    values = np.random.default_rng(1).normal(size=10_000)
    values[::3] = NAN
    big = attenuation(values, x="a=0.1:10:0.1", y="sigma_e=0.1:10:0.1")
    save_figure(plot_sweep(*big), tmp_path / "sweep.png")
    assert (tmp_path / "sweep.png").stat().st_size < 1e6


@pytest.mark.parametrize(
    ("n", "shape", "top"), [(1, (1, 1), 0.0), (60, (1000, 4), 2.0), (2, (4, 1000), 2.0)]
)
def test_a_film_of_any_shape_and_length(n, shape, top):
    scale = Scale.over(0.0, top)
    result = make_result(60) if n == 60 else result_of_level(np.full(n, 0.1))
    film = Film(result, shape, (scale, scale), UNITS[1:], "$^{ \x07 飞" + "y" * 300)
    layer = np.ones(shape, np.float32)
    for row in range(min(n, 3)):
        assert film.picture(row, layer, layer, None).shape == (720, 1280, 3)


def test_more_than_four_results_have_a_panel_each_on_one_scale():
    results = {f"set{n}": make_result(scale=1.0 - 0.1 * n) for n in range(9)}
    figure = plot("overview", results, Annotations(((3, "pitching"),)))
    figure.draw_without_rendering()
    panels = figure.axes[2:]
    levels, attenuations = panels[::2], panels[1::2]
    assert [axes.texts[0].get_text() for axes in levels] == [*results]
    labels = [axes.get_ylabel() for axes in panels if axes.get_ylabel()]
    assert labels == ["MP (fixed scale)", "Attenuation (dB)"]
    for group in (levels, attenuations):
        assert len({axes.get_ylim() for axes in group}) == 1
    for axes, result in zip(levels, results.values(), strict=True):
        assert np.array_equal(curve(axes), result.level, equal_nan=True)
    assert legend(figure) == [
        "threshold 0.4",
        "spike",
        "alarm (spikes)",
        "nothing passes (< −60 dB)",
    ]
    names = [axes.texts[0].get_window_extent() for axes in levels]
    above = [axes.get_window_extent() for axes in (figure.axes[0], *levels)]
    assert all(box.y0 >= name.y1 - 2 for box, name in zip(above, names, strict=False))
    texts = [text.get_text() for axes in figure.axes[:2] for text in axes.texts]
    assert [text.strip() for text in texts] == ["pitching"] * 2  # above either column


@pytest.mark.parametrize("kind", ["mp", "overview"])  # a panel a result, and two
@pytest.mark.parametrize(("width", "n_results"), [("one", 12), ("two", 9)])
def test_figures_of_many_results_fit_on_a_page_with_legible_ticks(kind, width, n_results):
    figure = plot(kind, {f"set {i}": make_result() for i in range(n_results)}, width=width)
    figure.draw_without_rendering()
    assert figure.get_figheight() < 9.3
    assert sum(text.startswith("spike") for text in legend(figure)) <= 1
    panels = [axes for axes in figure.axes if axes.get_yticklabels()]
    assert len(panels) >= n_results
    for axes in panels:
        labels = boxes(axes.get_yticklabels())
        assert len(labels) > 1 and axes.get_window_extent().height > 0.25 * figure.dpi
        assert not any(one.overlaps(other) for one, other in combinations(labels, 2))
