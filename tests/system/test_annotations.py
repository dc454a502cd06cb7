"""Annotations: options that cannot be read, and where figures put them."""

import numpy as np
import pytest
from figures import make_result
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb

from dlgmd_cli.plots.style import BLACK, VERMILION
from dlgmd_cli.plots.traces import plot
from dlgmd_cli.results.annotations import Annotations

EVERYTHING = Annotations(
    marks=((5, "pitching"), (9, "rolling"), (38, "near the right edge")),
    spans=((12, 30, "accelerating"), (26, 36, "braking")),
    collision_frame=24,
    false_positive_frame=22,
)


@pytest.mark.parametrize(
    ("option", "value", "error"),
    [
        ("--mark", "40pitching", "'40pitching' is not FRAME:TEXT. Write 40:pitching."),
        ("--mark", "40:", "'40:' is not FRAME:TEXT. Write 40:pitching."),
        ("--mark", "٤:x", "is not FRAME:TEXT"),
        ("--mark", "1" * 400 + ":x", "…' is not FRAME:TEXT"),
        ("--span", "40:x", "'40:x' is not FRAME-FRAME:TEXT. Write 40-75:accelerating."),
        ("--span", "75-40:x", "'75-40:x' ends before it starts. Write 40-75:accelerating."),
        ("--collision-frame", "-1", "-1 is not at least 0"),
    ],
)
def test_options_that_cannot_be_read(dlgmd, option, value, error):
    line = dlgmd("plot", "mp", "one", option, value).stderr.splitlines()[-1]
    assert line.startswith(f"Error: Invalid value for '{option}': ") and error in line
    assert len(line) < 200


def texts(figure):
    """Extents of the texts of annotations, which stand on the highest axes."""
    figure.draw_without_rendering()
    return {text.get_text().strip(): text.get_window_extent() for text in figure.axes[0].texts}


def vertical_lines(axes):
    return {
        line.get_xdata()[0]: line
        for line in axes.get_lines()
        if len(line.get_xdata()) == 2 and np.ptp(line.get_xdata()) == 0
    }


@pytest.mark.parametrize("kind", ["spikes", "overview"])
def test_annotations_go_through_every_panel(kind):
    result = make_result(frame_step=2)
    figure = plot(kind, {"a": result}, Annotations(((9, "here"),), ((20, 40, "while"),)))
    assert set(texts(figure)) == {"here", "while"}
    for axes in figure.axes:
        assert 0.45 in [pytest.approx(place) for place in vertical_lines(axes)]
        extents = [
            path.get_extents()
            for item in axes.collections
            if isinstance(item, PolyCollection)
            for path in item.get_paths()
        ]
        assert (1.0, 2.0) in [pytest.approx((box.x0, box.x1)) for box in extents]


def test_collisions_are_black_and_alarms_are_not():
    figure = plot("mp", {"a": make_result()}, EVERYTHING)
    lines = vertical_lines(figure.axes[1])
    assert sorted(lines) == pytest.approx([0.5, 0.9, 2.2, 2.4, 3.8])
    mark, _, false, true, _ = (lines[place] for place in sorted(lines))
    assert true.get_color() == BLACK and true.get_linewidth() > 1.5 * mark.get_linewidth()
    assert false.get_color() == VERMILION and false.get_linestyle() != "-"
    assert {"collision", "false positive", "pitching"} <= set(texts(figure))
    colours = [to_rgb(item.get_facecolor()[0]) for item in figure.axes[1].collections]
    assert sorted(colours) == [to_rgb(VERMILION), *[to_rgb("0.93")] * 2]  # the alarm, two spans


def test_a_line_passes_below_the_texts_that_it_would_cross():
    marks = ((10, "a text that is long"), (14, "short"))
    extents = texts(plot("mp", {"a": make_result()}, Annotations(marks)))
    assert extents["a text that is long"].y0 >= extents["short"].y1
    assert extents["a text that is long"].x1 > extents["short"].x0


@pytest.mark.parametrize(("frame", "is_right"), [(5, True), (38, False)])
def test_a_text_stands_beside_its_line_where_there_is_room(frame, is_right):
    figure = plot("mp", {"a": make_result()}, Annotations(collision_frame=frame))
    (box,) = texts(figure).values()
    (line,) = vertical_lines(figure.axes[0]).values()
    (x, _), _ = line.get_transform().transform(line.get_xydata())
    assert (box.x0 > x - 1) if is_right else (box.x1 < x + 4)


def test_frames_outside_are_left_out_and_spans_cut_off():
    late = Annotations(((40, "late"),), ((50, 60, "later"),), 99)
    assert not texts(plot("mp", {"a": make_result()}, late))
    figure = plot("mp", {"a": make_result()}, Annotations(((40, "late"),), ((30, 90, "cut"),)))
    assert list(texts(figure)) == ["cut"]
    (band,) = figure.axes[0].collections
    box = band.get_paths()[0].get_extents()
    assert (box.x0, box.x1) == pytest.approx((3.0, 3.9))


def test_a_frame_stands_where_the_first_result_has_it():
    slow, fast = make_result(), make_result(frame_step=2)
    for results, place in (({"a": slow, "b": fast}, 1.2), ({"b": fast, "a": slow}, 0.6)):
        figure = plot("mp", results, Annotations(((12, "x"),)))
        assert list(vertical_lines(figure.axes[0])) == [pytest.approx(place)]


def test_what_a_figure_cannot_show_in_full_is_told():
    spans = (5, 9, "all"), (4, 9, "cut"), (5, 10, "cut"), (1, 4, "before"), (10, 12, "after")
    told = Annotations((), spans).outside(5, 9)
    cut = ["'cut' at frames 4 to 9 is cut off", "'cut' at frames 5 to 10 is cut off"]
    left_out = ["'before' at frames 1 to 4 is outside", "'after' at frames 10 to 12 is outside"]
    assert [line.partition(" at frames 5 to 9")[0] for line in told[:2]] == cut
    assert [line.partition(" frames 5 to 9")[0] for line in told[2:]] == left_out
