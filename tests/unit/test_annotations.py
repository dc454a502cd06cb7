"""Annotations: what falls outside, how options are read, and where figures put them."""

from itertools import combinations

import click
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from test_plots import make_result

from dlgmd_cli.commands._annotations import annotation_options
from dlgmd_cli.plots.overlays import overlay_mp
from dlgmd_cli.plots.overview import plot_overview
from dlgmd_cli.plots.traces import PLOTS, plot_mp, plot_spikes
from dlgmd_cli.results.annotations import Annotations

EVERYTHING = Annotations(
    marks=((5, "pitching"), (9, "rolling"), (38, "near the right edge")),
    spans=((12, 30, "accelerating"), (26, 36, "braking")),
    collision_frame=24,
    false_positive_frame=22,
)


def test_what_is_outside_is_said_and_what_is_inside_is_not():
    assert EVERYTHING.outside(0, 39) == EVERYTHING.outside(5, 38) == []
    assert Annotations().outside(0, 0) == []
    assert EVERYTHING.outside(9, 23) == [
        "'pitching' at frame 5 is not on the frames 9 to 23 and is left out",
        "'near the right edge' at frame 38 is not on the frames 9 to 23 and is left out",
        "'collision' at frame 24 is not on the frames 9 to 23 and is left out",
        "'accelerating' at frames 12 to 30 is cut off at the frames 9 to 23",
        "'braking' at frames 26 to 36 is not on the frames 9 to 23 and is left out",
    ]
    assert len(EVERYTHING.outside(10, 11)) == 7


def parse(*arguments):
    """What the options say, or the last line of the error."""
    parsed = []

    @click.command()
    @annotation_options
    def command(annotations):
        parsed.append(annotations)

    result = CliRunner().invoke(command, list(arguments))
    assert result.exit_code == (0 if parsed else 2)
    return parsed[0] if parsed else result.stderr.splitlines()[-1]


def test_options():
    assert parse() == Annotations()
    assert parse(
        *("--mark", "40:pitching", "--mark", "7: at 12:30: a turn "),
        *("--span", "40-75:accelerating", "--span", "3-3:blink"),
        *("--collision-frame", "120", "--false-positive-frame", "0"),
    ) == Annotations(
        marks=((40, "pitching"), (7, "at 12:30: a turn")),
        spans=((40, 75, "accelerating"), (3, 3, "blink")),
        collision_frame=120,
        false_positive_frame=0,
    )


def test_what_a_terminal_would_act_on_is_shown_as_an_escape():
    assert parse("--mark", "4:\x1b[31mred\nnext").marks == ((4, "\\x1b[31mred\\nnext"),)
    assert parse("--mark", "4:$\\alpha$ ü").marks == ((4, "$\\alpha$ ü"),)


@pytest.mark.parametrize(
    ("option", "value", "error"),
    [
        ("--mark", "40pitching", "'40pitching' is not FRAME:TEXT. Write 40:pitching."),
        ("--mark", "-1:x", "'-1:x' is not FRAME:TEXT. Write 40:pitching."),
        ("--mark", "40:", "'40:' is not FRAME:TEXT. Write 40:pitching."),
        ("--mark", "٤:x", "is not FRAME:TEXT"),
        ("--mark", "1" * 400 + ":x", "…' is not FRAME:TEXT"),
        ("--mark", "4:" + "x" * 61, "a text may have 60 characters, not 61."),
        ("--span", "40:x", "'40:x' is not FRAME-FRAME:TEXT. Write 40-75:accelerating."),
        ("--span", "75-40:x", "'75-40:x' ends before it starts. Write 40-75:accelerating."),
        ("--collision-frame", "-1", "-1 is not in the range 0<=x<=999999999."),
        ("--false-positive-frame", "1.5", "'1.5' is not a valid integer range."),
    ],
)
def test_options_that_cannot_be_read(option, value, error):
    line = parse(option, value)
    assert line.startswith(f"Error: Invalid value for '{option}': ") and error in line
    assert len(line) < 200


def test_more_marks_than_a_figure_has_room_for():
    many = [part for frame in range(41) for part in ("--mark", f"{frame}:x")]
    assert parse(*many).startswith("Error: a figure has room for 40 times --mark and --span")
    assert len(parse(*many[2:]).marks) == 40


def strip(figure):
    (axes,) = [axes for axes in figure.axes if axes.get_label() == "annotations"]
    return axes


def boxes(figure):
    figure.draw_without_rendering()
    return {text.get_text(): text.get_window_extent() for text in strip(figure).texts}


def vertical_lines(axes):
    return {
        line.get_xdata()[0]: line
        for line in axes.get_lines()
        if len(line.get_xdata()) == 2 and np.ptp(line.get_xdata()) == 0
    }


@pytest.mark.parametrize("plot", [*PLOTS.values(), lambda r, a: plot_overview({"a": r}, a)])
def test_annotations_go_through_every_panel(plot):
    figure = plot(make_result(frame_step=2), Annotations(((9, "here"),), ((20, 40, "while"),)))
    *panels, texts = figure.axes
    assert texts is strip(figure) and len(panels) >= 1
    for axes in figure.axes:
        assert 0.45 in [pytest.approx(place) for place in vertical_lines(axes)]
        bands = [(patch.get_x(), patch.get_width()) for patch in axes.patches]
        assert pytest.approx((1.0, 1.0)) in bands
    assert {text.get_text() for text in texts.texts} == {"here", "while"}


def test_lines_differ_without_colour_and_carry_their_names():
    figure = plot_mp(make_result(), EVERYTHING)
    lines = vertical_lines(figure.axes[0])
    assert sorted(lines) == pytest.approx([0.5, 0.9, 2.2, 2.4, 3.8])
    mark, _, false, true, _ = (lines[place] for place in sorted(lines))
    assert true.get_color() == "#D55E00" and true.get_linewidth() > 1.5 * mark.get_linewidth()
    assert false.get_linestyle() != "-" and mark.get_linestyle() == true.get_linestyle() == "-"
    assert {"collision", "false positive", "pitching"} <= set(boxes(figure))


@settings(max_examples=40, deadline=None)
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
    figure = plot_mp(make_result(), annotations, width=width)
    figure.draw_without_rendering()
    extents = [text.get_window_extent() for text in strip(figure).texts]
    assert len(extents) == len(marks) + len(spans) + 2
    assert not any(one.overlaps(other) for one, other in combinations(extents, 2))
    top = strip(figure).get_window_extent()
    for box in extents:
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width
        assert box.y0 >= top.y0 and box.y1 <= top.y1


def test_a_line_ends_at_its_text_and_passes_below_those_it_would_cross():
    figure = plot_mp(make_result(), Annotations(((10, "a text that is long"), (14, "short"))))
    extents = boxes(figure)
    assert extents["a text that is long"].y0 > extents["short"].y1
    assert extents["a text that is long"].x1 > extents["short"].x0
    transform = strip(figure).transAxes
    for line, text in zip(strip(figure).get_lines(), extents.values(), strict=True):
        end = transform.transform((0, line.get_ydata()[1]))[1]
        assert text.y0 < end < text.y1 + 3


@pytest.mark.parametrize(("frame", "is_right"), [(5, True), (30, True), (38, False)])
def test_a_text_stands_beside_its_line_where_there_is_room(frame, is_right):
    figure = plot_mp(make_result(), Annotations(collision_frame=frame))
    (box,) = boxes(figure).values()
    (line,) = strip(figure).get_lines()
    (x, _), _ = line.get_transform().transform(line.get_xydata())
    assert (box.x0 > x) if is_right else (box.x1 < x)


def test_no_line_goes_through_a_text_that_stands_lower():
    marks = ((2, "spans the next one"), (14, "a text, over it"), (20, "and the last"))
    extents = boxes(plot_mp(make_result(), Annotations(marks), width="one"))
    first, second, last = extents.values()
    assert first.x1 < last.x0 and first.x1 > second.x0  # so that only the line is in its way
    assert last.y1 < second.y0 and second.y1 < first.y0


def test_long_texts_are_cut_in_the_middle_and_dollars_are_no_formula():
    long = "from here on " * 8
    figure = plot_mp(make_result(), Annotations(((3, long), (20, "$5 to $\\frac{6$"))))
    shown, dollars = (text.get_text() for text in strip(figure).texts)
    assert shown.startswith("from here") and shown.endswith("here on ") and "…" in shown
    figure.draw_without_rendering()
    assert dollars == r"\$5 to \$\frac{6\$"


def test_a_text_over_a_band_at_the_edge_stays_on_the_figure():
    text = "a text that is much wider than its band"
    for span in ((0, 2, text), (37, 39, text)):
        figure = plot_mp(make_result(), Annotations(spans=(span,)))
        box = boxes(figure)[text]
        assert box.x0 >= 0 and box.x1 <= figure.bbox.width


def test_frames_outside_are_left_out_and_spans_cut_off():
    none = plot_spikes(make_result(), Annotations(((40, "late"),), ((50, 60, "later"),), 99))
    assert len(none.axes) == 2
    figure = plot_mp(make_result(), Annotations(((40, "late"),), ((30, 90, "cut"),)))
    assert list(boxes(figure)) == ["cut"]
    band = figure.axes[0].patches[-1]
    assert (band.get_x(), band.get_width()) == pytest.approx((3.0, 0.9))


def test_a_frame_stands_where_the_first_result_has_it():
    slow, fast = make_result(), make_result(frame_step=2)
    for results, place in (({"a": slow, "b": fast}, 1.2), ({"b": fast, "a": slow}, 0.6)):
        figure = overlay_mp(results, Annotations(((12, "x"),)))
        assert list(vertical_lines(figure.axes[0])) == [pytest.approx(place)]
