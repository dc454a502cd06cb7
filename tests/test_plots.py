"""Figures: what is drawn, where, and that they can be written."""

from dataclasses import replace

import matplotlib
import numpy as np
import pytest

from dlgmd_cli.models.dlgmd import connections_of
from dlgmd_cli.plots.kernels import plot_kernels
from dlgmd_cli.plots.style import save_figure
from dlgmd_cli.plots.traces import PLOTS, plot_attenuation, plot_mp, plot_spikes
from dlgmd_cli.presets import load_set
from dlgmd_cli.results.tables import Result

NAN = np.nan


def make_result(n=40, frame_step=1):
    level = np.full(n, 0.1)
    level[:3] = NAN
    level[20:25] = [0.5, 0.6, 0.9, 0.7, 0.4]
    spike = level >= 0.4
    attenuation = np.linspace(-30, -5, n)
    attenuation[:3] = NAN
    attenuation[10:13] = -np.inf
    attenuation[30] = NAN
    zero = np.zeros(n)
    return Result(
        frame=np.arange(n) * frame_step,
        time_s=np.arange(n) / 10,
        p_sum=zero,
        s_sum=zero,
        attenuation_db=attenuation,
        mp=level,
        mp_abs=level,
        mp_seq=level,
        level=level,
        threshold=np.full(n, 0.4),
        spike=spike,
        collision=spike & (np.arange(n) > 20),
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
    assert (span.get_x(), span.get_x() + span.get_width()) == pytest.approx((2.1, 2.4))
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


@pytest.mark.parametrize("plot", PLOTS.values(), ids=PLOTS)
def test_frames_stand_above_seconds(plot):
    result = make_result(frame_step=3)
    figure = plot(result)
    figure.draw_without_rendering()
    (top,) = [child for axes in figure.axes for child in axes.child_axes]
    assert top.get_xlabel() == "Frame"
    assert top.get_xlim() == pytest.approx((0, 39 * 3))


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
    for number, result in enumerate((full, silent, single, undefined)):
        path = tmp_path / f"{number}.{suffix}"
        save_figure(plot(result), path)
        assert path.stat().st_size > 1000
        save_figure(plot(result), tmp_path / f"again.{suffix}")
        assert path.read_bytes() == (tmp_path / f"again.{suffix}").read_bytes()


def test_uneven_times_are_placed_truly():
    result = replace(make_result(), time_s=np.cumsum(np.linspace(0.01, 0.2, 40)))
    figure = plot_mp(result)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    forward, backward = axes.child_axes[0]._functions
    assert forward(result.time_s) == pytest.approx(result.frame)
    assert backward(result.frame) == pytest.approx(result.time_s)


@pytest.mark.parametrize("formulation", ["default", "equations"])
def test_kernels_have_a_panel_and_a_bar_each(formulation):
    connections = connections_of(load_set(9, formulation=formulation))
    figure = plot_kernels(connections.excitation, connections.inhibition, connections.latency)
    shown = [axes for axes in figure.axes if axes.get_visible()]
    n_panels = 2 + len(connections.inhibition)
    assert len(shown) == 2 * n_panels
    titles = [axes.get_title() for axes in shown[:n_panels]]
    assert titles[0] == "Excitation $K_E$" and titles[-1] == r"Latency $\tau$"


def test_the_host_s_style_is_left_alone(tmp_path):
    before = dict(matplotlib.rcParams)
    save_figure(plot_mp(make_result()), tmp_path / "mp.png")
    assert dict(matplotlib.rcParams) == before
