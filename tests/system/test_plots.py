"""Figures over time and of kernels: what is drawn, where, and that they can be written."""

from dataclasses import replace

import cv2
import matplotlib
import numpy as np
import pytest
from conftest import result_of_level
from figures import (
    NAN,
    approach,
    curve,
    frame_axis,
    legend,
    long_result,
    make_result,
    part,
    written,
)
from matplotlib.figure import Figure

import dlgmd_cli
from dlgmd_cli.errors import DlgmdWarning, ParameterError
from dlgmd_cli.plots.curves import LOOKS, MAX_COLUMNS, panels_of, span_db, stretches, thinned
from dlgmd_cli.plots.style import BLACK, figure_files, save_figure
from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.plots.traces import plot
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.csv import rows_of


def test_what_lies_beyond_an_axis_has_a_bar_at_its_end():
    result = approach("spikes")
    result.rows["ttc_s"] = np.where(np.arange(60) < 20, 9.0, np.where(np.arange(60) < 30, NAN, 0.5))
    axes = result.plot("ttc").axes[1]
    (bar,) = axes.collections[-1].get_paths()
    box, high = bar.get_extents(), axes.get_ylim()[1]
    half = np.diff(result.time_s[:2]).item() / 2
    ends = result.time_s[0] - half, result.time_s[19] + half
    assert (box.x0, box.x1) == pytest.approx(ends) and box.y0 == 1.0 and high < 9.0
    assert written(axes.figure)[-1] == f"> {high:.2g}"
    result.rows["ttc_s"] = 0.5
    assert not any(text.startswith(">") for text in written(result.plot("ttc")))
    result = approach("expansion")
    result.rows["expansion"][-1] = result.rows["signal"][-1] = -99.0
    for kind in ("ttc", "signal"):
        figure = dlgmd_cli.plot(result, kind)
        figure.draw_without_rendering()
        (words,) = [text for text in figure.axes[0].texts if text.get_text().startswith("< ")]
        box = words.get_window_extent()
        assert (box.y0 + box.y1) / 2 < figure.axes[0].bbox.y0  # below all that is drawn


def test_potentials_are_alone_unless_a_rule_goes_by_the_expansion():
    spikes = {"a": approach("spikes"), "b": approach("spikes")}
    assert [axes.get_ylabel() for axes in plot("mp", spikes).axes][1:] == [""]
    by_ttc = {**spikes, "b": approach()}
    assert panels_of("mp", [*by_ttc.values()]) == ("level", "expansion", "ttc", "raster")
    assert {"expansion", "ttc"} < {*panels_of("overview", [*spikes.values()])}
    (alone,) = plot("mp", by_ttc, one_panel=True).axes
    assert alone.get_ylabel() == "MP (fixed scale)" and "spike" not in legend(alone.figure)


def test_a_result_without_expansion_has_the_neuron_s_panel_only():
    old = approach()
    old.rows["expansion"] = NAN
    assert [axes.get_ylabel() for axes in old.plot().axes[1:]] == ["TTC (s)"]
    old.rows["ttc_s"] = NAN
    assert len(old.plot().axes) == 1
    (note, *_), *_ = [axes.texts for axes in old.plot("ttc").axes]
    assert note.get_text() == "undefined: the images are too small or too narrow"


def test_every_column_of_its_own_is_a_figure():
    plain, n = make_result(), 40
    columns = {name: plain.rows[name] for name in plain.rows.dtype.names}
    rows = rows_of({**columns, "heat": np.arange(n)}, ["heat"])
    result = replace(plain, rows=rows)
    (axes,) = result.plot("heat").axes
    assert axes.get_ylabel() == "heat" and curve(axes).tolist() == [*range(n)]
    with pytest.raises(ParameterError, match=r"no figure 'heap'"):
        result.plot("heap")


def test_rounding_is_no_event():
    wobble = np.full(40, -8.348184) + np.where(np.arange(40) == 20, 1e-7, 0)
    result = result_of_level(np.full(40, 0.1), attenuation_db=wobble)
    (axes,) = plot("attenuation", {"a": result}).axes
    low, high = axes.get_ylim()
    assert high - low >= 5 and low < -8.35 < high


@pytest.mark.parametrize("limits", [None, (-20.0, 0.0)])
def test_silence_has_a_row_per_result_at_the_foot_of_the_axis(limits):
    figure = plot("attenuation", {"a": make_result(), "b": make_result()}, ylim=limits)
    (axes,) = figure.axes
    marks = [line for line in axes.get_lines() if line.get_marker() == "v"]
    assert [line.get_color() for line in marks] == [LOOKS[0][0], LOOKS[1][0]]
    heights = [line.get_ydata()[0] for line in marks]
    (low, high), (least, greatest) = axes.get_ylim(), limits or span_db([curve(axes)])
    foot = (least - low) / (high - low)
    assert 0.0 < heights[1] < heights[0] < foot < 0.25 and high == greatest
    assert min(axes.get_yticks()) >= least


def test_the_emphasised_result_is_the_strongest_line():
    results = {name: make_result() for name in ("receding", "translating", "looming", "other")}
    figure = plot("mp", results, emphasise="looming")
    lines = dict(zip(results, figure.axes[0].get_lines()[::2], strict=False))
    strong = lines.pop("looming")
    # Without markers, which would look like data, or like spikes.
    assert (strong.get_color(), strong.get_marker()) == (LOOKS[0][0], "None")
    assert all(strong.get_linewidth() > 1.5 * line.get_linewidth() for line in lines.values())
    assert all(strong.get_zorder() > line.get_zorder() for line in lines.values())
    assert [line.get_color() for line in lines.values()] == [color for color, _ in LOOKS[1:4]]
    assert legend(figure)[:4] == list(results)


def black_lines(axes):
    found = [line for line in axes.get_lines() if line.get_color() == BLACK]
    return [(line.get_xdata()[0], line.get_linestyle()) for line in found]


def test_every_result_has_its_own_collisions():
    results = {"a": make_result(), "b": make_result()}
    figure = plot("spikes", results, collisions={"a": [30], "b": [33, 99]})
    level, raster = figure.axes
    assert black_lines(level) == [(pytest.approx(3.0), "-"), (pytest.approx(3.3), "--")]
    heights = [line.get_ydata() for line in raster.get_lines()]
    assert heights == [[0.5, 1.0], [0.0, 0.5]] and "collision" in legend(figure)
    same = plot("mp", results, collisions={"a": [30], "b": [30]})
    assert black_lines(same.axes[0]) == [(pytest.approx(3.0), "-")] * 2
    assert "collision" not in legend(plot("mp", results, collisions={"a": []}))


def test_limits_of_time_show_every_row_within():
    figure = plot("mp", {"a": long_result()}, Annotations(((9000, "x"),)), xlim=(200.0, 201.0))
    axes = figure.axes[1]
    assert axes.get_xlim() == (200.0, 201.0)
    drawn = axes.get_lines()[0].get_xdata()
    assert np.count_nonzero((drawn >= 200) & (drawn <= 201)) == 31
    assert all(line.get_clip_on() for line in axes.get_lines())  # such as spikes at other times
    assert not figure.axes[0].texts  # frame 9000 is at 300 s
    frames = [int(label.get_text()) for label in frame_axis(figure).get_xticklabels()]
    assert min(frames) >= 6000 and max(frames) <= 6030


def test_what_is_undefined_says_why():
    still = result_of_level(np.full(9, 0.0), attenuation_db=np.full(9, NAN), normalise="sequence")
    short = result_of_level(np.full(3, NAN), attenuation_db=np.full(3, NAN))
    unchanged = {
        "mp": "the membrane potential never changes",
        "attenuation": "no frame differs from the one before it",
    }
    for kind, why in unchanged.items():
        for results, expected in (
            ([still], why),
            ([short], "too few frames"),
            ([short, still], f"too few frames, or {why}"),
        ):
            axes, *_ = plot(kind, dict(zip("ab", results, strict=False))).axes
            assert axes.texts[-1].get_text() == f"undefined: {expected}"


def test_columns_and_what_the_axis_calls_them():
    result, by_sequence = make_result(), make_result(normalise="sequence")
    absolute, sequence = "MP (fixed scale)", "MP (min–max)"
    for results, column, name, has_threshold in (
        ([result], None, absolute, True),
        ([result], "mp_seq", sequence, False),
        ([by_sequence], None, sequence, True),
        ([result, by_sequence], None, "Normalised MP", True),
        ([result, by_sequence], "mp_seq", sequence, False),
    ):
        figure = plot("mp", dict(zip("ab", results, strict=False)), column=column)
        axes, *_ = figure.axes
        assert np.array_equal(curve(axes), getattr(results[0], column or "level"), equal_nan=True)
        assert axes.get_ylabel() == name and ("threshold 0.4" in written(figure)) is has_threshold


def own_mark(axes):
    """Colour, time and text of each mark of one result."""
    lines = [line for line in axes.get_lines() if line.get_zorder() == 3.1]
    texts = [one for one in axes.texts if one.get_position()[1] == 0.97]
    return [
        (line.get_color(), line.get_xdata()[0], text.get_text().strip())
        for line, text in zip(lines, texts, strict=True)
    ]


def test_a_mark_of_one_result_is_in_its_colour_or_panel():
    results = {name: make_result() for name in "abc"}
    time_s = results["b"].time_s[7]
    (axes,) = dlgmd_cli.plot(
        {k: results[k] for k in "ab"}, "attenuation", mark=[("b", 7, "x")]
    ).axes
    assert own_mark(axes) == [(LOOKS[1][0], time_s, "x")]
    figure = dlgmd_cli.plot(
        results, "attenuation", mark=[("b", 7, "x"), (9, "y")], span=[(1, 4, "z")]
    )
    strip, *panels = figure.axes  # three attenuations have a panel each
    assert [own_mark(axes) for axes in panels] == [[], [(LOOKS[1][0], time_s, "x")], []]
    assert {text.get_text().strip() for text in strip.texts} == {"y", "z"}
    assert own_mark(dlgmd_cli.plot(results, mark=[("b", 99, "x")]).axes[0]) == []  # outside
    upper, *_ = dlgmd_cli.plot(results["a"], "spikes", mark=[(results["a"].title, 7, "x")]).axes
    assert own_mark(upper) == [(LOOKS[0][0], time_s, "x")]


def test_results_are_drawn_into_axes_of_one_s_own():
    figure = Figure()
    upper, lower = figure.subplots(2, 1)
    notes = {"mark": [(7, "x")], "span": [(1, 4, "z")], "collision_frame": 20}
    one, other = make_result(), make_result()
    assert dlgmd_cli.plot([one, other], ax=upper, **notes) is figure
    assert one.plot("attenuation", ax=lower, false_positive_frame=5) is figure
    (strip,) = upper.child_axes
    assert {text.get_text().strip() for text in strip.texts} == {"x", "z", "collision"}
    assert [text.get_text().strip() for text in lower.child_axes[0].texts] == ["false positive"]
    names = [text.get_text() for text in upper.get_legend().get_texts()]
    assert names[:2] == [one.title, f"{one.title} (2)"] and upper.get_xlabel() == "Time (s)"
    assert np.array_equal(curve(upper), one.level, equal_nan=True)
    figure.draw_without_rendering()


def test_axes_are_one_and_other_figures_take_none():
    one, panels = make_result(), Figure().subplots(2)
    for given, why in ((panels, "type ndarray, .* one Axes"), (panels[0].figure, "type Figure")):
        with pytest.raises(ParameterError, match=why):
            one.plot("mp", ax=given)


def test_the_font_and_its_size_are_those_that_the_caller_has_set():
    sizes = []
    for rc in ({}, {"font.size": 16.0, "font.family": "serif"}, {"xtick.labelsize": 3.0}):
        with matplotlib.rc_context(rc):
            axes, *_ = (figure := plot("mp", {"a": make_result()})).axes
            label = axes.yaxis.label
            ticks = axes.get_xticklabels()[0].get_size(), axes.get_yticklabels()[0].get_size()
            sizes.append((label.get_size(), *ticks, label.get_family()[0]))
            assert rc or figure.get_size_inches()[1] < 6
    assert sizes[0] == (8, 7, 7, "DejaVu Sans") and sizes[1] == (16, 14, 14, "serif")
    assert sizes[2] == (8, 3, 7, "DejaVu Sans")


@pytest.mark.parametrize("kind", ["mp", "attenuation", "overview", "spikes", "aligned", "apart"])
def test_a_large_font_cuts_nothing_off(kind):
    """A `font.size` of 24, which a matplotlibrc may have: all texts lie within the figure."""
    with matplotlib.rc_context({"font.size": 24.0}):
        names = ["a", "a model with a rather long name, or two"] + [*"cdef"] * (kind == "apart")
        results = {name: make_result() for name in names}
        look = {"align": "collision", "collision_frame": 20} if kind == "aligned" else {}
        figure = dlgmd_cli.plot(results, "mp" if kind in ("aligned", "apart") else kind, **look)
        figure.get_layout_engine().execute(figure)
        drawn, size = figure.get_tightbbox(), figure.get_size_inches()
    assert size[0] > 3.5 and size[1] < 3 * size[0]
    assert drawn.min.min() > -0.01 and (drawn.max < size + 0.01).all()


def test_one_panel_shows_up_to_eight_results():
    results = {name: make_result() for name in "abcdefgh"}
    for kind in ("mp", "attenuation"):
        (axes,) = dlgmd_cli.plot(results, kind, one_panel=True).axes[:1]
        assert len({line.get_color() for line in axes.lines if line.get_linestyle() != "None"}) >= 8


def test_different_videos_are_no_trials():
    results = {}
    for name in "ab":
        results[name] = result_of_level(np.linspace(0.1, 0.9, 40))
        results[name].record["input"]["path"] = f"/{name}.mp4"
    frames = {label: [30] for label in results}
    figure = dlgmd_cli.plot(results, align="collision", collisions=frames, mean=True)
    assert legend(figure) == ["dlgmd, mean ± SEM of 2 videos"]


def test_aligned_results_need_a_collision_and_take_axes():
    axes, one = Figure().subplots(), make_result()
    look = {"align": "collision", "collision_frame": 30, "ax": axes, "mean": True}
    assert dlgmd_cli.plot(one, **look) is axes.figure  # of one trial there is no error
    assert [text.get_text() for text in axes.get_legend().get_texts()] == ["dlgmd, 1 video"]
    for look, why in (
        ({"align": "collision"}, "no result has a known collision"),
        ({"align": "alarm"}, "there is no align 'alarm'"),
        ({"mean": True}, "mean works only with align='collision'"),
    ):
        with pytest.raises(ParameterError, match=why):
            dlgmd_cli.plot(one, **look)
    with pytest.warns(dlgmd_cli.DlgmdWarning, match="1 result without a known collision"):
        frames = {"a": [20]}
        dlgmd_cli.plot({"a": one, "b": one}, align="collision", collisions=frames)


def test_what_cannot_be_drawn_is_refused():
    for look, why in (
        ({"mark": [("b", 7, "x")]}, r"no result is called b\. Choose from a"),
        ({"mark": (7, "x")}, r"7 is no mark\. Give a list of"),
        ({"span": [(7, "x")]}, "is no span"),
    ):
        with pytest.raises(ParameterError, match=why):
            dlgmd_cli.plot({"a": make_result()}, **look)
    for arguments, options, why in (
        (("mp", {}), {}, "there is no result"),
        (("film", {"a": make_result()}), {}, "kind is 'film', none of mp, attenuation"),
        (("mp", {"a": make_result()}), {"width": "three"}, "'three', neither 'one' nor 'two'"),
        (("mp", {"a": make_result()}), {"column": "spike"}, "none of level, mp_abs, mp_seq"),
        (("mp", {"a": make_result()}), {"emphasise": "b"}, "emphasise is 'b', none of a"),
        (("overview", {"a": make_result()}), {"ylim": (0, 1)}, "an overview has several"),
    ):
        with pytest.raises(ValueError, match=why):
            plot(*arguments, **options)


def test_labels_are_drawn_as_they_are_written():
    names = ["_hidden", "$x^2$", "two\nlines", "bell\a", "\udcff", "x" * 99]
    shown = []
    for some in (names[:3], names[3:]):
        figure = plot("mp", dict.fromkeys(some, make_result()))
        figure.draw_without_rendering()
        shown += legend(figure)[:3]
    figure = plot("mp", dict.fromkeys(names, make_result()))
    figure.draw_without_rendering()
    assert shown == [axes.texts[0].get_text() for axes in figure.axes[1:] if axes.texts]
    *short, long = shown
    assert short == ["_hidden", r"\$x^2\$", r"two\nlines", r"bell\x07", r"\udcff"]
    assert "…" in long and len(long) < 60


def test_frames_stand_above_seconds_at_their_true_places():
    times, frames = np.cumsum(np.linspace(0.01, 0.2, 40)), 3 * np.arange(40)
    result = result_of_level(np.full(40, 0.1), time_s=times, frame=frames)
    figure = plot("mp", {"a": result})
    figure.draw_without_rendering()
    top, axes = frame_axis(figure), figure.axes[0]
    assert top.get_xlabel() == "Frame"
    assert len(top.get_xticks()) > 3
    for place, label in zip(top.get_xticks(), top.get_xticklabels(), strict=True):
        assert place == pytest.approx(np.interp(int(label.get_text()), frames, times))
        above, _ = top.transData.transform((place, 0))
        assert above == pytest.approx(axes.transData.transform((place, 0))[0], abs=0.1)
    timeline = Timeline.of([result])
    assert timeline.frame_of(timeline.time_of([-3, 50.5])) == pytest.approx([-3, 50.5])


def test_frames_are_shown_where_all_results_agree():
    whole = make_result()
    for others in ([part(whole, slice(4, None, 4))], [part(whole, slice(0, 25)), whole]):
        timeline = Timeline.of([*others, whole])
        assert timeline.is_shared and timeline.frames == (0, 39)
        assert timeline.time_of(38) == pytest.approx(3.8)
    for other in (
        make_result(frame_step=2),  # another rate
        make_result(start_s=0.02),
        part(make_result(80), slice(50, 60)),  # no frame in common
    ):
        figure = plot("mp", {"a": whole, "b": other})
        assert not any(axes.child_axes for axes in figure.axes)
        left, right = figure.axes[-1].get_xlim()
        assert left < min(other.time_s[0], 0.01) and right > max(other.time_s[-1], 3.9)


def test_a_long_result_keeps_every_peak_and_gap():
    result = long_result()
    figure = plot("mp", {"a": result})
    (axes,) = figure.axes
    levels = curve(axes)
    assert len(levels) <= 2 * MAX_COLUMNS + 2
    assert {0.91, 0.92, 0.93, 0.94} <= {round(float(level), 9) for level in levels}
    # One of them is alone among undefined rows: no neighbour to draw a line to, hence a dot.
    (alone,) = [line.get_ydata() for line in axes.get_lines() if line.get_marker() == "."]
    assert alone == pytest.approx([0.93])
    (marks,) = [
        line
        for line in plot("attenuation", {"a": result}).axes[0].get_lines()
        if line.get_marker() == "v"
    ]
    assert marks.get_xdata() == pytest.approx([10_000 / 30], abs=0.5)


def test_a_long_result_loses_no_spike():
    time_s = np.arange(50_000.0)
    flags = np.zeros(50_000, bool)
    flags[[0, 17_001, 17_002, 49_999]] = True
    spans = stretches(time_s, flags)
    assert len(spans) == 3
    for (start, duration), time in zip(spans, (0, 17_001, 49_999), strict=True):
        assert start < time < start + duration <= time + 2
    assert len(stretches(time_s, np.ones(50_000, bool))) == 1
    assert thinned(np.full(3_000, 5.0), np.arange(3_000.0))[1].tolist() == [0.0, 2_999.0]


@pytest.mark.painted
def test_a_figure_is_drawn_once_for_all_its_formats(tmp_path):
    before, drawn = dict(matplotlib.rcParams), []

    def draw():
        drawn.append(1)
        return plot("mp", {"a": make_result()})

    files = figure_files({"mp": draw}, ["png", "svg", "png"])
    assert list(files) == ["mp.png", "mp.svg"]
    for name, write in files.items():
        write(tmp_path / name)
    assert len(drawn) == 1 and (tmp_path / "mp.svg").read_bytes().startswith(b"<?xml")
    assert dict(matplotlib.rcParams) == before  # the host's style is left alone


def test_a_notebook_shows_a_figure_as_it_is_saved(tmp_path):
    figure = make_result().plot("overview")
    assert figure._repr_png_().startswith(b"\x89PNG")
    figure.savefig(tmp_path / "words.svg")
    save_figure(figure, tmp_path / "fine.png", dpi=400)
    assert ">Frame</text>" in (tmp_path / "words.svg").read_text(encoding="utf-8")
    height, width = cv2.imread(str(tmp_path / "fine.png")).shape[:2]
    assert width == 1400 and height == pytest.approx(400 * figure.get_figheight(), abs=1)


def test_a_figure_until_the_collision_says_so_and_keeps_the_scale():
    result = result_of_level(np.append(np.linspace(0, 0.5, 50), np.linspace(0.9, 0, 10)))
    whole, cut = result.plot(collision_frame=45), result.plot(collision_frame=45, until="collision")
    assert whole.axes[-1].get_xlabel() == "Time (s)"
    assert cut.axes[-1].get_xlabel() == "Time (s), up to the collision"
    assert cut.axes[-1].get_xlim()[1] == result.time_s[45] < whole.axes[-1].get_xlim()[1]
    assert np.array_equal(curve(cut.axes[1]), curve(whole.axes[1]), equal_nan=True)
    twice = {"collisions": {"a": (20, 45)}, "until": "collision"}
    narrow = plot("mp", {"a": result}, **twice, xlim=(0.5, 9))  # the last one counts
    assert narrow.axes[-1].get_xlim() == (0.5, result.time_s[45])
    late = {"collision_frame": 45, "xlim": (result.time_s[45], 3.0)}
    for unknown in ({}, late):
        with pytest.warns(DlgmdWarning, match="until: no collision is known in the time"):
            axes = result.plot(until="collision", **unknown).axes[-1]
        assert axes.get_xlabel() == "Time (s)" and axes.get_xlim()[1] > result.time_s[45]
    with pytest.raises(ParameterError, match="until"):
        result.plot(collision_frame=45, until="contact")
