"""The figure of a sweep: every cell where its values lie, and none without a meaning."""

import numpy as np
import pytest
from figures import NAN, attenuation, axis, legend, swept
from matplotlib.collections import PolyCollection, QuadMesh
from matplotlib.colors import LogNorm, TwoSlopeNorm
from matplotlib.figure import Figure

from dlgmd_cli.plots.sweeps import (
    INFINITE,
    UNDEFINED,
    axis_name,
    edges,
    label_axis,
    places,
    plot_sweep,
    plot_sweeps,
)
from dlgmd_cli.results.grid import as_text

INF = np.inf


def maps(figure):
    """Axes of the heat maps, by title."""
    return {axes.get_title("left"): axes for axes in figure.axes if axes.get_title("left")}


def mesh(axes):
    (found,) = [c for c in axes.collections if isinstance(c, QuadMesh)]
    return found


def marked(axes, look):
    """Area of the cells that have a look."""
    return sum(
        np.prod(path.get_extents().size)
        for collection in axes.collections
        if isinstance(collection, PolyCollection) and (collection.get_hatch() or "") == look.hatch
        for path in collection.get_paths()
    )


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("r=2:4:1", [1.5, 2.5, 3.5, 4.5]),
        ("a=1,2,4", [0.5, 1.5, 3.0, 5.0]),
        ("a=3", [1.5, 4.5]),
        ("alpha=0", [-0.5, 0.5]),
        ("ffi_gd=true,false", [-0.5, 0.5, 1.5]),
        ("kappa=1e-4,1e-3,1e-2", np.array([1e-4, 1e-3, 1e-2, 1e-1]) / np.sqrt(10)),
    ],
)
def test_cells_reach_halfway_to_their_neighbours(text, expected):
    assert np.allclose(edges(axis(text)), expected)


def test_values_are_drawn_where_they_belong():
    values = np.arange(6.0).reshape(2, 3) - 2.5
    (axes,) = maps(plot_sweep(*attenuation(values, x="r=2,3,8", y="a=1,4"))).values()
    drawn = mesh(axes)
    assert np.array_equal(drawn.get_array(), values)
    corners = drawn.get_coordinates()
    assert np.allclose(corners[0, :, 0], [1.5, 2.5, 5.5, 10.5])
    assert np.allclose(corners[:, 0, 1], [-0.5, 2.5, 5.5])
    assert axes.get_xlim() == (1.5, 10.5) and axes.get_ylim() == (-0.5, 5.5)


def test_a_panel_a_speed_and_one_scale_of_all():
    values = [np.full(6, 1.0) * speed * np.arange(6) for speed in (1, 2, 3, 4)]
    figure = plot_sweep(*attenuation(values, speeds=(1.0, 2.0, 3.0, 4.0), x="sigma_e=1,2,3"))
    figure.draw_without_rendering()
    assert figure.get_size_inches()[0] == 3.5
    assert list(maps(figure)) == [f"{v} px/frame" for v in (1, 2, 3, 4)]
    assert {(mesh(axes).norm.vmin, mesh(axes).norm.vmax) for axes in maps(figure).values()} == {
        (0, 20)
    }
    assert [axes.get_title() for axes in figure.axes].count("dB") == 1
    boxes = [axes.get_tightbbox() for axes in figure.axes]
    assert all(b.x0 >= -1 and b.y0 >= -1 for b in boxes)
    assert all(b.x1 <= figure.bbox.x1 + 1 and b.y1 <= figure.bbox.y1 + 1 for b in boxes)
    # Only the outer maps have labels.
    labels = [(axes.get_xlabel() != "", axes.get_ylabel() != "") for axes in maps(figure).values()]
    assert labels == [(False, True), (False, False), (True, True), (True, False)]


def test_zero_is_in_the_middle_of_the_colours():
    (axes,) = maps(plot_sweep(*attenuation([-12, -6, 0, 1, 2, 3]))).values()
    norm = mesh(axes).norm
    assert isinstance(norm, TwoSlopeNorm) and (norm.vmin, norm.vcenter, norm.vmax) == (-12, 0, 3)
    assert mesh(axes).colorbar.ax.get_ylabel() == "centred at 0 dB"
    for values, is_blue in (([-6, -5, -4, -3, -2, -1], True), ([1, 2, 3, 4, 5, 6], False)):
        (axes,) = maps(plot_sweep(*attenuation(values))).values()
        red, _, blue, _ = mesh(axes).cmap(0.5)
        assert (blue > red) == is_blue


def test_what_is_weaker_than_30_db_looks_alike_and_the_bar_says_so():
    for lowest, is_cut in ((-50, True), (-29, False)):
        figure = plot_sweep(*attenuation([lowest, -20, -6, 1, 2, 3]))
        (axes,) = maps(figure).values()
        assert mesh(axes).norm.vmin == max(lowest, -30)
        assert mesh(axes).colorbar.extend == ("min" if is_cut else "neither")


def test_a_panel_a_measure():
    columns = {
        "mp_max": [1, 2, 3, 4, 5, 0],
        "mp_max_frame": [9] * 6,
        "sharpness": [0.1, 0.2, 0.3, 0.4, 0.5, NAN],
        "distinguishability": [1, 10, 1e3, 1e5, INF, NAN],
        "first_alarm_frame": [7, 8, 9, 10, 11, NAN],
    }
    figure = plot_sweep(*swept(columns))
    panels = maps(figure)
    assert list(panels) == ["Peak MP", "Sharpness", "Distinguishability", "First alarm"]
    assert isinstance(mesh(panels["Distinguishability"]).norm, LogNorm)
    assert not isinstance(mesh(panels["Peak MP"]).norm, LogNorm)
    assert marked(panels["Distinguishability"], INFINITE) == pytest.approx(1.0)
    assert legend(figure) == ["undefined", "∞: none at the false positive"]
    columns["distinguishability"] = [NAN] * 6
    assert "Distinguishability" not in maps(plot_sweep(*swept(columns)))


def test_inputs_are_side_by_side_with_one_scale_a_measure():
    grid, one, possible, *_ = swept({"mp_max": range(6), "sharpness": [NAN] * 6})
    _, other, *_ = swept({"mp_max": range(10, 16), "sharpness": [NAN] * 6})
    figure = plot_sweeps(grid, [("a", one, possible), ("b", other, possible)], "set9")
    top, bottom = (figure.axes[:2], figure.axes[2:4])
    assert [axes.get_title("left") for axes in (*top, *bottom)] == ["a", "b", "", ""]
    assert {mesh(axes).get_clim() for axes in top} == {(0.0, 15.0)}
    assert [axes.get_ylabel() for axes in figure.axes[4:]] == ["Peak MP"]
    assert all(marked(axes, UNDEFINED) for axes in bottom)
    many = plot_sweeps(grid, [(name, one, possible) for name in "abcd"], "set9")
    assert (figure.get_size_inches()[0], many.get_size_inches()[0]) == (3.5, 7.16)


@pytest.mark.parametrize(
    ("text", "labelled"),
    [
        ("r=2,4,8", [2, 4, 8]),
        ("r=2,3,20", [2, 20]),
        ("sigma_e=0.2:2:0.2", [0.2, 0.6, 1, 1.4, 1.8]),
        ("kappa=1e-5,1e-4,1e-3,1e-2", [1e-5, 1e-4, 1e-3, 1e-2]),
        ("ffi_gd=true,false", [0, 1]),
    ],
)
def test_every_value_has_a_tick_and_where_there_is_room_a_label(text, labelled):
    one = axis(text)
    axes = Figure().subplots()
    label_axis(axes, "x", one, shows=True)
    assert np.allclose(axes.get_xticks(), labelled)
    ticks = np.sort([*axes.get_xticks(), *axes.get_xticks(minor=True)])
    assert np.allclose(ticks, places(one))
    texts = [label.get_text() for label in axes.get_xticklabels()]
    known = [*map(as_text, one.values)]
    assert all(text in known for text in texts) and texts[0] == known[0]


@pytest.mark.parametrize(
    ("text", "label"),
    [
        ("sigma_e=1", r"σ$_{\mathrm{E}}$ (px)"),
        ("beta=1", "β (1/frames)"),
        ("a=1", "a"),
        ("t0=1", r"T$_{\mathrm{0}}$"),
        ("ffi_gd=true", "FFI-GD"),
        ("formulation=default", "formulation"),
    ],
)
def test_labels_are_symbols_with_units(text, label):
    assert axis_name(axis(text)) == label
