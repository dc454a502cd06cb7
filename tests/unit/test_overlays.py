"""Several results on one axis: told apart, placed truly, and nothing covered or cut off."""

from dataclasses import replace
from itertools import combinations, pairwise

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from test_plots import NAN, frame_axis, lines, long_result, make_result, ticks

from dlgmd_cli.plots.columns import Columns
from dlgmd_cli.plots.overlays import overlay_attenuation, overlay_mp, overlay_spikes
from dlgmd_cli.plots.overview import plot_overview
from dlgmd_cli.plots.series import LOOKS
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.plots.timeline import Timeline
from dlgmd_cli.plots.traces import plot_attenuation, plot_mp, plot_spikes
from dlgmd_cli.results.annotations import Annotations
from dlgmd_cli.results.tables import Result

OVERLAYS = {
    "mp": overlay_mp,
    "attenuation": overlay_attenuation,
    "spikes": overlay_spikes,
    "overview": plot_overview,
}
EVERY = pytest.mark.parametrize("overlay", OVERLAYS.values(), ids=OVERLAYS)
WIDTHS_IN = {"one": 3.5, "two": 7.16}


def part(result, rows):
    return Result(**{key: value[rows] for key, value in vars(result).items()})


def later(result, seconds):
    return replace(result, time_s=result.time_s + seconds)


def compared(result):
    never = np.zeros(len(result.frame), bool)
    return replace(result, threshold=np.full(len(never), NAN), spike=never, collision=never)


def legend(figure):
    return [text.get_text() for item in figure.legends for text in item.get_texts()]


def handles(figure):
    (item,) = figure.legends
    return dict(zip(legend(figure), item.legend_handles, strict=True))


def test_one_result_is_drawn_as_it_is_alone(tmp_path):
    result = make_result()
    for overlay, plot, label in (
        (overlay_mp, plot_mp, "MP"),
        (overlay_attenuation, plot_attenuation, "attenuation"),
        (overlay_spikes, plot_spikes, "MP"),
    ):
        for width in WIDTHS_IN:
            save_figure(overlay({label: result}, width=width), tmp_path / "overlay.png")
            save_figure(plot(result, width=width), tmp_path / "plot.png")
            assert (tmp_path / "overlay.png").read_bytes() == (tmp_path / "plot.png").read_bytes()


def test_several_lines_share_the_threshold_and_nothing_else():
    low = replace(make_result(), level=make_result().level / 2)
    figure = overlay_mp({"high": make_result(), "low": low})
    (axes,) = figure.axes
    drawn = lines(axes)
    assert np.array_equal(drawn["low"].get_ydata(), low.level, equal_nan=True)
    assert np.array_equal(drawn["high"].get_ydata(), make_result().level, equal_nan=True)
    assert set(drawn["threshold 0.4"].get_ydata()) == {0.4}
    assert legend(figure) == ["high", "low", "threshold 0.4"] and not axes.patches


@pytest.mark.parametrize(
    ("other", "column"),
    [
        (replace(make_result(), threshold=np.full(40, 0.5)), "level"),
        (compared(make_result()), "level"),
        (replace(make_result(), mp_abs=np.full(40, 0.3)), "mp_abs"),
    ],
)
def test_a_threshold_that_is_not_everyone_s_is_left_out(other, column):
    assert legend(overlay_mp({"a": make_result(), "b": other}, column=column)) == ["a", "b"]
    assert legend(overlay_mp({"b": other, "a": make_result()}, column=column)) == ["b", "a"]


def test_columns_and_what_the_axis_calls_them():
    levels = {"level": 0.1, "mp_abs": 0.2, "mp_seq": 0.3}
    result = replace(
        make_result(), **{column: np.full(40, level) for column, level in levels.items()}
    )
    names = {"level": "Normalised MP", "mp_abs": "Normalised MP", "mp_seq": "Self-normalised MP"}
    for column, level in levels.items():
        for results in ({"a": result}, {"a": result, "b": result}):
            for overlay in (overlay_mp, plot_overview):
                figure = overlay(results, column=column)
                axes = figure.axes[0]
                assert set(lines(axes)["a"].get_ydata()) == {level}
                assert axes.get_ylabel() == names[column]
                assert ("threshold 0.4" in legend(figure)) is (column == "level")
    dots = lines(overlay_mp({"a": result}, column="mp_seq").axes[0])["spike"]
    assert set(dots.get_ydata()) == {0.3}


@EVERY
def test_what_cannot_be_drawn_is_refused(overlay):
    with pytest.raises(ValueError, match="there is no result"):
        overlay({})
    with pytest.raises(ValueError, match="'three', neither 'one' nor 'two'"):
        overlay({"a": make_result()}, width="three")
    if overlay in (overlay_mp, plot_overview):
        with pytest.raises(ValueError, match="column is 'spike', none of level, mp_abs, mp_seq"):
            overlay({"a": make_result()}, column="spike")


def brightness(color):
    return np.dot(to_rgb(color), (0.299, 0.587, 0.114))


def test_twelve_looks_differ_without_colour():
    assert len(LOOKS) == 12
    for (one, dashes), (other, other_dashes) in combinations(LOOKS, 2):
        assert dashes != other_dashes or abs(brightness(one) - brightness(other)) > 0.15
    assert all(one[0] != other[0] for one, other in pairwise(LOOKS))


def test_more_than_twelve_lines_still_differ():
    figure = overlay_mp({f"line {number}": make_result() for number in range(30)})
    looks = {
        (line.get_color(), str(line._unscaled_dash_pattern), line.get_marker())
        for label, line in lines(figure.axes[0]).items()
        if label.startswith("line ")
    }
    assert len(looks) == 30


def many(n=12, length=60):
    return {f"{number} {'long name ' * 9}"[:length]: make_result() for number in range(n)}


@EVERY
@pytest.mark.parametrize("width", WIDTHS_IN)
@pytest.mark.parametrize("results", [many(3, 8), many(), many(12, 8)], ids=["3", "long", "12"])
def test_the_legend_hides_nothing_and_fits(overlay, width, results):
    figure = overlay(results, Annotations(((3, "a mark"),)), width=width)
    figure.draw_without_rendering()
    assert figure.get_figwidth() == WIDTHS_IN[width]
    (item,) = figure.legends
    box = item.get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height
    assert len(item.get_texts()) >= len(results)
    assert len(set(legend(figure))) == len(item.get_texts())
    top = frame_axis(figure)
    below = [top.xaxis.label, *top.get_xticklabels(), *figure.axes[-1].texts]
    for text in below:
        extent = text.get_window_extent()
        assert extent.y1 <= box.y0 + 3 or not extent.overlaps(box)
    for axes in figure.axes:
        tight = axes.get_tightbbox()
        assert tight.x0 >= 0 and tight.y0 >= 0 and tight.x1 <= figure.bbox.width
    for upper, lower in combinations(figure.axes[:-1], 2):
        assert upper.get_position().y0 > lower.get_position().y1
        labels = [axes.yaxis.label.get_window_extent() for axes in (upper, lower)]
        assert not labels[0].overlaps(labels[1])


def test_labels_are_drawn_as_they_are_written():
    names = ["_hidden", "$x^2$", "$", "two\nlines", "bell\a", "\udcff", ""]
    figure = overlay_mp(dict.fromkeys(names, make_result()))
    figure.draw_without_rendering()
    shown = ["_hidden", r"\$x^2\$", r"\$", r"two\nlines", r"bell\x07", r"\udcff", ""]
    assert legend(figure)[:-1] == shown


def test_frames_stand_above_where_all_results_agree():
    whole, decimated = make_result(), part(make_result(), slice(4, None, 4))
    for results in ([whole, decimated], [decimated, whole], [part(whole, slice(0, 25)), whole]):
        figure = overlay_mp({str(place): result for place, result in enumerate(results)})
        assert ticks(frame_axis(figure).xaxis) == pytest.approx({"0": 0, "10": 1, "20": 2, "30": 3})
        assert figure.axes[0].get_xlim() == pytest.approx((0, 3.9))


@EVERY
def test_frames_are_left_out_where_results_disagree(overlay):
    whole = make_result()
    for other in (
        make_result(frame_step=2),  # another rate
        later(whole, 0.02),
        part(later(whole, 1.0), slice(0, 5)),
        replace(part(whole, slice(0, 9)), frame=np.arange(9) * 2 + 101),  # no frame in common
    ):
        for results in ({"a": whole, "b": other}, {"b": other, "a": whole}):
            figure = overlay(results)
            assert not any(axes.child_axes for axes in figure.axes)
            assert figure.axes[-1].get_xlabel() == "Time (s)"
            ends = [results[name].time_s[[0, -1]] for name in results]
            assert figure.axes[-1].get_xlim() == pytest.approx((np.min(ends), np.max(ends)))


def test_frames_of_results_that_overlap_in_part_are_one_relation():
    whole = make_result()
    timeline = Timeline.of([part(whole, slice(10, 30)), part(whole, slice(0, 15)), whole])
    assert timeline.is_shared and timeline.frames == (0, 39)
    assert timeline.time_of(38) == pytest.approx(3.8) and timeline.time_of(2.5) == 0.25
    # As written with nine digits and read back.
    assert Timeline.of([whole, later(whole, 1e-9)]).is_shared
    apart = Timeline.of([part(whole, slice(0, 5)), later(whole, 0.01)])
    assert not apart.is_shared and apart.frames == (0, 4)
    # Each agrees with the other on a frame, but not on which of the others comes first.
    one = replace(part(whole, slice(0, 3)), frame=np.array([0, 4, 8]))
    other = replace(
        part(whole, slice(0, 3)), frame=np.array([0, 5, 6]), time_s=np.array([0, 0.05, 9])
    )
    assert not Timeline.of([one, other]).is_shared


def test_silence_has_a_row_per_result_below_all_lines():
    loud = replace(make_result(), attenuation_db=np.full(40, -8.0))
    figure = overlay_attenuation({"a": make_result(), "loud": loud, "b": make_result()})
    (axes,) = figure.axes
    marks = [line for line in axes.get_lines() if line.get_marker() == "v"]
    assert {line.get_color() for line in marks} == {LOOKS[0][0], LOOKS[2][0]}
    height = {line.get_color(): line.get_ydata()[0] for line in marks}
    assert height[LOOKS[0][0]] > height[LOOKS[2][0]]  # in the order of the legend
    for line in marks:
        assert line.get_xdata().tolist() == pytest.approx([1.0, 1.1, 1.2])
    low, high = axes.get_ylim()
    lowest = np.nanmin(lines(axes)["a"].get_ydata())
    assert (lowest - low) / (high - low) > max(height.values()) + 0.04
    assert min(ticks(axes.yaxis).values()) > low + max(height.values()) * (high - low)
    assert legend(figure) == ["a", "loud", "b", "nothing passes (< -60 dB)"]
    alone = plot_attenuation(make_result()).get_figheight()
    assert figure.get_figheight() > alone


def test_what_is_undefined_is_named():
    nothing = np.full(40, NAN)
    still = replace(make_result(), level=nothing, attenuation_db=nothing)
    short = replace(still, mp=nothing)
    changes = {overlay_mp: "the membrane potential never changes"}
    changes[overlay_attenuation] = "no picture changes"
    for overlay, change in changes.items():
        figure = overlay({"a": make_result(), "still": still})
        assert legend(figure)[:2] == ["a", "still (undefined)"] and not figure.axes[0].texts
        for results, why in (
            ([still, still], change),
            ([short, short], "too few frames"),
            ([short, still], f"too few frames, or {change}"),
        ):
            figure = overlay({str(place): result for place, result in enumerate(results)})
            (note,) = figure.axes[0].texts
            assert note.get_text() == f"undefined: {why}"


def test_an_entry_of_the_overview_stands_for_both_panels():
    half = replace(make_result(), attenuation_db=np.full(40, NAN))
    figure = plot_overview({"a": make_result(), "half": half})
    assert legend(figure) == [
        "a",
        "half",
        "threshold 0.4",
        "nothing passes (< -60 dB)",
        "spikes",
        "collision",
    ]
    other = replace(make_result(), level=np.full(40, NAN))
    assert legend(plot_overview({"a": make_result(), "other": other}))[1] == "other"


def test_a_row_of_spikes_and_collisions_each():
    none = replace(make_result(), spike=np.zeros(40, bool), collision=np.zeros(40, bool))
    figure = overlay_spikes({"none": none, "some": make_result()})
    raster, level = figure.axes
    bars = [
        [tuple(s[:, 0]) + tuple(s[:, 1]) for s in item.get_segments()]
        for item in raster.collections
    ]
    some_spikes, some_collisions, no_spikes, no_collisions = bars
    assert not no_spikes and not no_collisions
    assert [bar[0] for bar in some_spikes] == pytest.approx([2.0, 2.1, 2.2, 2.3, 2.4])
    assert [bar[0] for bar in some_collisions] == pytest.approx([2.1, 2.2, 2.3, 2.4])
    assert max(bar[3] for bar in some_collisions) < min(bar[2] for bar in some_spikes)
    samples = {line.get_ydata()[0]: line for line in raster.get_lines()}
    assert samples[0].get_color() == LOOKS[1][0] and samples[1].get_color() == LOOKS[0][0]
    assert all(max(line.get_xdata()) < 0 for line in samples.values())
    assert legend(figure) == ["none", "some", "threshold 0.4", "spikes", "collision"]
    assert {"none", "some"} <= set(lines(level))


def test_spikes_that_nobody_looked_for_are_not_shown_as_none():
    figure = overlay_spikes({"run": make_result(), "compared": compared(make_result())})
    (text,) = figure.axes[0].texts
    assert text.get_text() == "spikes not recorded" and text.get_position()[1] == 0
    mp, attenuation = plot_overview({"a": compared(make_result())}).axes
    assert (mp.get_ylabel(), attenuation.get_ylabel()) == ("Normalised MP", "Attenuation (dB)")
    assert len(plot_overview({"a": make_result()}).axes) == 3
    assert len(plot_overview({"a": compared(make_result()), "b": make_result()}).axes) == 3


def test_the_overview_has_all_that_its_panels_have_alone():
    result = make_result()
    mp, attenuation, raster = plot_overview({"a": result}).axes
    assert set(lines(mp)) >= {"a", "threshold 0.4", "spike"} and len(mp.patches) == 1
    assert np.isfinite(lines(attenuation)["a"].get_ydata()).sum() == 33
    assert [len(item.get_segments()) for item in raster.collections] == [5, 4]
    assert {axes.get_xlim() for axes in (mp, attenuation, raster)} == {(0.0, 3.9)}
    assert raster.get_xlabel() == "Time (s)" and not mp.get_xlabel()
    assert mp.child_axes and not attenuation.child_axes


def test_long_results_of_any_length_keep_every_peak():
    long = long_result()
    fast = replace(long, time_s=long.time_s / 7)
    figure = overlay_mp({"long": long, "fast": fast, "short": make_result()})
    drawn = lines(figure.axes[0])
    peaks = {0.91, 0.92, 0.93, 0.94}
    for name, most in (("long", 1_000), ("fast", 200)):
        levels = drawn[name].get_ydata()
        assert peaks <= set(levels) and len(levels) < most
    assert len(drawn["short"].get_ydata()) == 40
    assert "maximum, range" in legend(figure)
    assert "maximum, range" not in legend(overlay_mp({"a": make_result(), "b": make_result()}))
    for overlay in OVERLAYS.values():
        assert legend(overlay({"long": long, "fast": fast})).count("maximum, range") == 1


def test_two_columns_show_more_than_one():
    long = long_result()
    n_points = [
        len(lines(plot_mp(long, width=width).axes[0])["MP (max, range)"].get_ydata())
        for width in ("one", "two")
    ]
    assert n_points == [2.77 * 200, 6.43 * 200]
    labels = [ticks(plot_mp(make_result(), width=width).axes[0].xaxis) for width in ("one", "two")]
    assert len(labels[1]) > len(labels[0])


def test_columns_on_a_view_that_others_share():
    one = Columns(np.array([5.0]), (0.0, 100.0), 2.0)
    ((start, duration),) = one.spans(np.array([True]))
    assert duration == pytest.approx(100 / 400) and start <= 5.0 <= start + duration
    few = Columns(np.array([5.0, 6.0, 7.0]), (0.0, 100.0), 2.0)
    assert few.spans(np.array([True, False, True])) == [(4.5, 1.0), (6.5, 1.0)]
    equal = Columns(np.full(3_000, 5.0), (0.0, 100.0), 2.0)
    assert equal.highest(np.arange(3_000.0)).tolist() == [2_999]


@EVERY
@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_every_overlay_of_every_kind_of_result(overlay, suffix, tmp_path):
    whole = make_result()
    single, undefined = part(whole, slice(3, 4)), part(whole, slice(0, 2))
    silent = replace(whole, attenuation_db=np.full(40, -np.inf))
    mixture = [whole, single, undefined, silent, compared(whole), long_result(2_500)]
    for results in ([single, single], [undefined, undefined], [single, undefined], mixture):
        labelled = {str(place): result for place, result in enumerate(results)}
        for name in ("one", "again"):
            figure = overlay(labelled, Annotations(((1, "x"),), ((0, 3, "y"),), 2, 3))
            save_figure(figure, tmp_path / f"{name}.{suffix}")
        assert (tmp_path / f"one.{suffix}").stat().st_size > 1000
        assert (tmp_path / f"one.{suffix}").read_bytes() == (
            tmp_path / f"again.{suffix}"
        ).read_bytes()
