"""Figures: what is drawn, where, and that they can be written."""

import subprocess
import sys
from dataclasses import replace
from itertools import combinations, pairwise

import matplotlib
import numpy as np
import pytest
from conftest import result_of_level
from matplotlib.collections import PolyCollection

from dlgmd_cli.models.kernels import connect
from dlgmd_cli.parameters import load_set
from dlgmd_cli.plots.kernels import plot_kernels
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.plots.traces import PLOTS, plot_attenuation, plot_mp, plot_spikes
from dlgmd_cli.results.tables import Result

NAN = np.nan


def make_result(n=40, frame_step=1):
    level = np.full(n, 0.1)
    level[:3] = NAN
    level[20:25] = [0.5, 0.6, 0.9, 0.7, 0.4]
    attenuation = np.linspace(-30, -5, n)
    attenuation[:3] = NAN
    attenuation[10:13] = -np.inf
    attenuation[30] = NAN
    return result_of_level(
        level, time_s=np.arange(n) / 10, frame_step=frame_step, attenuation_db=attenuation
    )


def lines(axes):
    return {line.get_label(): line for line in axes.get_lines()}


def test_mp_shows_level_threshold_spikes_and_collision():
    result = make_result()
    (axes,) = plot_mp(result).axes
    drawn = lines(axes)
    assert np.array_equal(drawn["MP"].get_ydata(), result.level, equal_nan=True)
    assert set(drawn["threshold 0.4"].get_ydata()) == {0.4}
    assert drawn["spike"].get_xdata().tolist() == pytest.approx([2.0, 2.1, 2.2, 2.3, 2.4])
    (span,) = axes.patches
    assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((2.05, 2.45))
    assert axes.get_xlabel() == "Time (s)" and axes.get_ylabel() == "Normalised MP"


def test_attenuation_has_gaps_and_marks_what_does_not_pass():
    result = make_result()
    (axes,) = plot_attenuation(result).axes
    line = lines(axes)["attenuation"].get_ydata()
    assert np.isnan(line[[0, 1, 2, 10, 11, 12, 30]]).all()
    assert np.isfinite(line).sum() == 40 - 7
    (marks,) = [line for label, line in lines(axes).items() if "nothing passes" in label]
    assert marks.get_xdata().tolist() == pytest.approx([1.0, 1.1, 1.2])
    assert axes.get_ylabel() == "Attenuation (dB)"


def test_spikes_are_a_raster_over_the_level():
    result = make_result()
    raster, level = plot_spikes(result).axes
    spikes, collisions = raster.collections
    assert len(spikes.get_segments()) == 5 and len(collisions.get_segments()) == 4
    assert "MP" in lines(level) and level.get_xlabel() == "Time (s)"


def ticks(axis):
    """Label -> place of every tick that is drawn."""
    axis.figure.draw_without_rendering()
    return {
        label.get_text(): place
        for label, place in zip(axis.get_ticklabels(), axis.get_ticklocs(), strict=True)
    }


def frame_axis(figure):
    (top,) = [child for axes in figure.axes for child in axes.child_axes]
    return top


@pytest.mark.parametrize("plot", PLOTS.values(), ids=PLOTS)
def test_frames_stand_above_seconds(plot):
    top = frame_axis(plot(make_result(frame_step=3)))
    assert top.get_xlabel() == "Frame"
    assert ticks(top.xaxis) == pytest.approx(
        {str(frame): frame / 30 for frame in range(0, 117, 20)}
    )


def test_one_frame_of_collision_is_one_frame_wide():
    for frame in (0, 17, 39):
        (axes,) = plot_mp(replace(make_result(), collision=np.arange(40) == frame)).axes
        (span,) = axes.patches
        assert span.get_width() == pytest.approx(0.1)
        assert span.get_x() >= -1e-9 and span.get_x() + span.get_width() <= 3.9 + 1e-9
        assert span.get_x() - 1e-9 <= frame / 10 <= span.get_x() + 0.1 + 1e-9


def test_one_frame_of_many_is_a_pixel_wide():
    n = 1_900  # each drawn by itself, but several of them to a pixel
    result = replace(long_result(n), collision=np.arange(n) == 700)
    (axes,) = plot_mp(result).axes
    (span,) = axes.patches
    assert span.get_x() <= 700 <= span.get_x() + span.get_width()
    assert 0.5 < span.get_width() / (n - 1) * 2.77 * 200 < 2


def test_rounding_is_no_event():
    wobble = np.full(40, -8.348184) + np.where(np.arange(40) == 20, 1e-7, 0)
    figure = plot_attenuation(replace(make_result(), attenuation_db=wobble))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    low, high = axes.get_ylim()
    assert high - low >= 5 and low < -8.35 < high
    assert not axes.yaxis.get_major_formatter().get_useOffset()


def test_what_is_undefined_says_why():
    nothing, never = np.full(40, NAN), np.zeros(40, bool)
    still = replace(
        make_result(), level=nothing, attenuation_db=nothing, spike=never, collision=never
    )
    short = replace(still, mp=nothing, s_sum=nothing)
    reasons = {
        plot_mp: "the membrane potential never changes",
        plot_spikes: "the membrane potential never changes",
        plot_attenuation: "no picture changes",
    }
    for plot, reason in reasons.items():
        for result, expected in ((still, reason), (short, "too few frames")):
            figure = plot(result)
            (note,) = [text.get_text() for axes in figure.axes for text in axes.texts]
            assert note == f"undefined: {expected}"
            labels = [text.get_text() for legend in figure.legends for text in legend.get_texts()]
            assert labels == (["threshold 0.4"] if plot is plot_mp else [])


def long_result(n=20_000):
    level = 0.3 + 0.2 * np.sin(np.arange(n) / 11)
    if n > 10_000:
        level[5_000:6_000] = NAN
        level[[0, 1_234, 5_500, n - 1, 8_888]] = [0.91, 0.92, 0.93, 0.94, 0.02]
    attenuation = -40 * level
    attenuation[7_777:7_778] = -np.inf
    collision = np.isin(np.arange(n), (0, 1_234, 1_235, 5_500, n - 1))
    return replace(
        make_result(),
        **{key: np.arange(n) for key in ("frame", "time_s")},
        **dict.fromkeys(("p_sum", "s_sum", "mp", "mp_abs", "mp_seq", "level"), level),
        attenuation_db=attenuation,
        threshold=np.full(n, 0.9),
        spike=level >= 0.9,
        collision=collision,
    )


def test_a_long_result_keeps_every_peak_and_gap():
    result = long_result()
    (axes,) = plot_mp(result).axes
    drawn = lines(axes)
    line = drawn["MP (max, range)"]
    seconds, levels = line.get_data()
    assert len(levels) < 1_000
    assert {0.91, 0.92, 0.93, 0.94} <= set(levels)
    # 0.93 is alone among undefined rows: no neighbour to draw a line to, hence a dot.
    (alone,) = [dots.get_ydata() for dots in axes.get_lines() if dots.get_marker() == "."]
    assert alone.tolist() == [0.93]
    inside = (seconds > 5_050) & (seconds < 5_950)
    assert np.isnan(levels[inside]).sum() == inside.sum() - 1
    (band,) = [item for item in axes.collections if isinstance(item, PolyCollection)]
    assert min(path.vertices[:, 1].min() for path in band.get_paths()) == 0.02
    marks = drawn["spike"]
    assert marks.get_ydata().tolist() == [0.91, 0.92, 0.93, 0.94]
    assert marks.get_markeredgewidth() == 0
    assert marks.get_xdata() == pytest.approx([0, 1_234, 5_500, 19_999], abs=36)


def test_a_long_result_loses_no_collision_and_no_silence():
    result = long_result()
    (axes,) = plot_mp(result).axes
    raster = plot_spikes(result).axes[0]
    bars = [bar.get_extents() for bar in raster.collections[1].get_paths()]
    spans = [(patch.get_x(), patch.get_x() + patch.get_width()) for patch in axes.patches]
    assert spans == pytest.approx(np.array([(bar.x0, bar.x1) for bar in bars]))
    for (left, right), frame in zip(spans, (0, 1_234, 5_500, 19_999), strict=True):
        assert left - 1e-6 <= frame <= right + 1e-6 and right - left < 100
        assert (right - left) / 19_999 * 2.77 * 200 > 0.5
    (axes,) = plot_attenuation(result).axes
    (marks,) = [line for label, line in lines(axes).items() if "nothing passes" in label]
    assert marks.get_xdata() == pytest.approx([7_777], abs=36)


def test_what_always_happens_is_one_bar():
    n = 20_000
    always = np.ones(n, bool)
    result = replace(long_result(n), level=np.full(n, 0.95), spike=always, collision=always)
    (axes,) = plot_mp(result).axes
    assert len(axes.patches) == 1 and len(lines(axes)["spike"].get_xdata()) < 1_000
    assert [len(bars.get_paths()) for bars in plot_spikes(result).axes[0].collections] == [1, 1]


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
def test_a_long_result_makes_no_large_file(suffix, tmp_path):
    noisy = np.random.default_rng(0).random(20_000)
    flags = noisy > 0.5
    result = replace(
        long_result(), level=noisy, attenuation_db=-noisy, spike=flags, collision=flags
    )
    for name, plot in PLOTS.items():
        save_figure(plot(result), tmp_path / f"{name}.{suffix}")
        assert (tmp_path / f"{name}.{suffix}").stat().st_size < 250_000


MEMORY = """
import resource, sys
from pathlib import Path
import numpy as np
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.plots.traces import PLOTS
from dlgmd_cli.results.tables import Result

n = int(sys.argv[1])
series, flags = np.zeros(n), np.zeros(n, bool)
series[::3], flags[::3] = 0.5, True
time_s = np.arange(n, dtype=float)
result = Result(time_s, time_s, *[series] * 8, flags, flags)
for plot in PLOTS.values():
    save_figure(plot(result), Path(sys.argv[2]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="ru_maxrss is in KiB on Linux only")
def test_memory_does_not_follow_the_length(tmp_path):
    def peak_mb(n):
        command = [sys.executable, "-c", MEMORY, str(n), str(tmp_path / "plot.png")]
        return int(subprocess.run(command, check=True, capture_output=True, text=True).stdout)

    assert peak_mb(200_000) < peak_mb(200) + 25


@pytest.mark.parametrize("suffix", ["png", "pdf", "svg"])
@pytest.mark.parametrize("plot", PLOTS.values(), ids=PLOTS)
def test_every_plot_of_every_kind_of_result(plot, suffix, tmp_path):
    full = make_result()
    silent = replace(
        full,
        level=np.where(np.isnan(full.level), NAN, 0.0),
        attenuation_db=np.where(np.isnan(full.attenuation_db), NAN, -np.inf),
        spike=np.zeros(40, bool),
        collision=np.zeros(40, bool),
    )
    single = Result(**{key: value[3:4] for key, value in vars(full).items()})
    undefined = Result(**{key: value[:2] for key, value in vars(full).items()})
    for number, result in enumerate((full, silent, single, undefined, long_result())):
        path = tmp_path / f"{number}.{suffix}"
        save_figure(plot(result), path)
        assert path.stat().st_size > 1000
        save_figure(plot(result), tmp_path / f"again.{suffix}")
        assert path.read_bytes() == (tmp_path / f"again.{suffix}").read_bytes()


def test_uneven_times_are_placed_truly():
    result = replace(make_result(), time_s=np.cumsum(np.linspace(0.01, 0.2, 40)))
    shown = ticks(frame_axis(plot_mp(result)).xaxis)
    assert len(shown) > 2
    for label, place in shown.items():
        assert place == pytest.approx(result.time_s[int(label)])


TIMES = {
    "single": ([1e6], [30_000_000]),
    "from zero": (np.arange(40) / 30, np.arange(40)),
    "later": (7.3 + np.arange(40) / 30, 219 + np.arange(40)),
    "far": (1e6 + np.arange(40) / 600, 30_000_000 + np.arange(40)),
    "long": (np.linspace(0, 1e6, 40), np.arange(40) * 769_230),
    "uneven": (np.geomspace(0.01, 70, 40), np.arange(40)),
}


@pytest.mark.parametrize(("time_s", "frame"), TIMES.values(), ids=TIMES)
def test_labels_neither_overlap_nor_leave_the_figure(time_s, frame):
    whole = make_result()
    result = Result(**{key: value[-len(frame) :] for key, value in vars(whole).items()})
    figure = plot_mp(replace(result, time_s=np.array(time_s), frame=np.array(frame)))
    figure.draw_without_rendering()
    (axes,) = figure.axes
    for axis in (axes.xaxis, frame_axis(figure).xaxis):
        boxes = [label.get_window_extent() for label in axis.get_ticklabels()]
        assert len(boxes) >= min(len(frame), 2)
        assert all(before.x1 < after.x0 for before, after in pairwise(boxes))
        assert boxes[0].x0 >= 0 and boxes[-1].x1 <= figure.bbox.width
        assert axis.get_offset_text().get_text() == ""
    (legend,) = figure.legends
    assert legend.get_window_extent().x0 >= 0


@pytest.mark.parametrize("result", [make_result(), long_result()], ids=["short", "long"])
def test_the_legend_fits(result):
    figure = plot_mp(result)
    figure.draw_without_rendering()
    assert len(figure.legends[0].get_texts()) == 4
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0 and box.x1 <= figure.bbox.width


def kernels_figure(number, formulation="default", **overrides):
    connections = connect(load_set(number, formulation=formulation, **overrides))
    figure = plot_kernels(connections.excitation, connections.inhibition, connections.latency)
    figure.draw_without_rendering()
    return figure


@pytest.mark.parametrize("formulation", ["default", "equations"])
def test_kernels_have_a_panel_each_and_one_scale_of_strength(formulation):
    figure = kernels_figure(9, formulation)
    maps = [axes for axes in figure.axes if axes.get_title()]
    titles = [axes.get_title() for axes in maps]
    delays = "12" if formulation == "default" else "012"
    assert titles[0] == "Excitation $K_E$" and titles[-1].startswith(r"Latency $\tau$")
    assert titles[1:-1] == [f"Inhibition $K_{{{delay}}}$" for delay in delays]
    assert len(figure.axes) == len(maps) + 2  # a bar of strengths, one of frames
    limits = {axes.images[0].get_clim() for axes in maps[:-1]}
    greatest = max(axes.images[0].get_array().max() for axes in maps[:-1])
    assert limits == {(0.0, greatest)}
    assert maps[-1].images[0].get_clim()[0] == 0.0


def test_one_value_is_printed_and_has_no_scale_of_its_own():
    excitation, *_ = kernels_figure(4).axes
    assert [text.get_text() for text in excitation.texts] == ["only 0.541"]
    figure = kernels_figure(1)
    (latency,) = [axes for axes in figure.axes if "Latency" in axes.get_title()]
    assert [text.get_text() for text in latency.texts] == ["only 1"]
    assert len(figure.axes) == 3 + 1


@pytest.mark.parametrize("radius", [1, 4, 32])
@pytest.mark.parametrize("number", [1, 4, 7, 9])
def test_kernels_stay_on_the_figure(number, radius):
    figure = kernels_figure(number, r=radius)
    for axes in figure.axes:
        box = axes.get_tightbbox()
        assert box.x0 >= 0 and box.y0 >= 0
        assert box.x1 <= figure.bbox.width and box.y1 <= figure.bbox.height
    feet = [axes.xaxis for axes in figure.axes if axes.get_xlabel()]
    boxes = [label.get_window_extent() for axis in feet for label in axis.get_ticklabels()]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def test_the_host_s_style_is_left_alone(tmp_path):
    before = dict(matplotlib.rcParams)
    save_figure(plot_mp(make_result()), tmp_path / "mp.png")
    assert dict(matplotlib.rcParams) == before
