"""What every figure says: its curves, what the legend calls them, where axes end, and marks."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from browsing import Reader
from conftest import judged_anew
from figures import approach, legend, line_named, make_result, named, swept, written
from matplotlib.colors import to_hex
from matplotlib.figure import Figure

import dlgmd_cli
from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.lab.paper.panels import Panel, plot_panels
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters.presets import load_set
from dlgmd_cli.plots import film as films
from dlgmd_cli.plots.evaluation import leads, times_to_contact, trade_off, verdict
from dlgmd_cli.plots.heat import Scale
from dlgmd_cli.plots.sheets import plot_kernels
from dlgmd_cli.plots.style import BLACK, BLUE, GREEN, ORANGE, VERMILION
from dlgmd_cli.plots.sweeps import IMPOSSIBLE, MINUS_INFINITE, UNDEFINED, plot_sweep
from dlgmd_cli.plots.traces import plot
from dlgmd_cli.results.annotations import KINDS
from dlgmd_cli.results.tradeoff import Curve

PAGE = Path(dlgmd_cli.__file__).parent / "watch/page.html"


class Twice(dlgmd_cli.Rule, name="twice"):
    """A rule of one's own."""

    def value(self, row):
        return 2.0 * row.expansion


def held(rule="expansion"):
    """An approach whose expansion is uncertain until 3.8 s, so that its signal lags behind."""
    result = approach(rule)
    result.rows["expansion_quality"][:38] = 0.07
    return judged_anew(result)


# Name of a vertical axis -> its column, whatever the rule.
COLUMNS = {"MP (fixed scale)": "level", "Attenuation (dB)": "attenuation_db"}


def close(drawn, values):
    return np.allclose(drawn, np.where(np.isneginf(values), np.nan, values), equal_nan=True)


def spans_of(bars):
    return [(path.get_extents().x0, path.get_extents().x1) for path in bars.get_paths()]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("rule", ["expansion", "ttc", "spikes", "twice"])
def test_beside_a_threshold_is_what_the_rule_compares(kind, rule):
    result = held(rule)
    figure = result.plot(kind)
    axes_of = {axes.get_ylabel(): axes for axes in figure.axes}
    of_rule = {"expansion": "Expansion (1/s)", "ttc": "TTC (s)", "twice": "Signal"}
    signals = dict.fromkeys((of_rule.get(rule),), result.signal)
    measured = {"Expansion (1/s)": result.expansion, "TTC (s)": result.ttc_s}
    for name, axes in axes_of.items():
        if not name:  # the raster: which row is which, and when
            assert [text.get_text() for text in axes.get_yticklabels()] == ["spikes", "alarm"]
            drawn = zip(axes.collections, (result.new_spikes, result.alarmed), strict=True)
            for bars, flags in drawn:
                assert [start for start, _ in spans_of(bars)] == pytest.approx(
                    result.time_s[np.flatnonzero(np.diff(flags, prepend=False) & flags)] - 0.05
                )
            assert axes.collections[0].get_paths()[0].get_extents().y0 > 0.5
            continue
        values = (
            getattr(result, COLUMNS[name]) if name in COLUMNS else {**measured, **signals}[name]
        )
        line = axes.lines[0]
        assert close(line.get_ydata(), values) and close(line.get_xdata(), result.time_s)
        low, high = axes.get_ylim()
        assert low < high and axes.get_xlim()[0] < axes.get_xlim()[1]
        rules = [one for one in axes.lines if one.get_color() == VERMILION]
        heights = [result.rule.threshold] if name == of_rule.get(rule) else []
        assert [one.get_ydata()[0] for one in rules] == pytest.approx(heights)
        if heights:
            assert low < heights[0] < high and spans_of(axes.collections[0])[0][1] > 4.0
    texts = [result.rule.line_text] if of_rule.get(rule) in axes_of else []
    texts = [f"twice: {text}" if rule == "twice" else text for text in texts if rule != "spikes"]
    shown = [text for text in written(figure) if "alarm at" in text]
    assert shown == texts and ("Signal" in axes_of) == (
        rule == "twice" and kind in ("mp", "overview")
    )


def test_what_was_measured_is_thin_behind_the_signal_and_what_holds_it_back_is_shaded():
    result = held()
    figure = result.plot("ttc")
    axes = figure.axes[0]
    signal, raw = (
        line_named(figure, text) for text in ("signal of the rule", "measured expansion")
    )
    assert close(signal.get_ydata(), result.signal) and close(raw.get_ydata(), result.expansion)
    assert raw.get_linewidth() < 0.7 * signal.get_linewidth()
    assert raw.get_zorder() < signal.get_zorder()
    assert {signal.axes, raw.axes} == {axes} and (result.signal[:38] < result.expansion[:38]).any()
    assert axes.get_ylim()[1] > np.nanmax(result.expansion)
    assert result.held == [(29, 37, "quality")] and "held back: quality" in legend(figure)
    area = named(figure)["held back: quality"]
    (shaded,) = [c for c in axes.collections if c.get_hatch() == area.get_hatch() != None]  # noqa: E711
    corners = shaded.get_paths()[0].get_extents()
    assert (corners.x0, corners.x1) == pytest.approx((result.time_s[29], result.time_s[37]))
    assert corners.y0 == pytest.approx(result.rule.threshold)
    assert corners.y1 == pytest.approx(result.expansion[37])
    result.rows["blind"][10:20] = "unmeasured"
    band = named(result.plot("mp"))["blind: unmeasured"]
    assert band.get_hatch() not in (None, area.get_hatch())
    assert "blind" not in " ".join(legend(figure))
    narrow = dlgmd_cli.plot(result, "ttc", ylim=(0.0, 0.6))  # both go beyond
    assert "> 0.6" in written(narrow)
    # Of two results of the same video, both lines are drawn once; of different ones, each's.
    both = plot("ttc", {"a": result, "b": held()})
    assert close(line_named(both, "signal of the rule").get_ydata(), result.signal)
    other = approach("expansion", contact_s=4.5)
    figure = plot("ttc", {"a": result, "b": other})
    for label, one in (("a", result), ("b", other)):
        assert close(line_named(figure, label, axes=figure.axes[0]).get_ydata(), one.signal)


def test_the_legend_calls_each_thing_by_its_name():
    results = {"a": make_result(), "b": make_result(scale=0.5), "c": make_result(scale=0.7)}
    figure = plot("mp", results)
    for label, result in results.items():
        assert close(line_named(figure, label, axes=figure.axes[0]).get_ydata(), result.level)
    figure = plot("overview", {"a": make_result()}, collision_frame=30)
    look = {text: to_hex(color_of(handle)) for text, handle in named(figure).items()}
    assert look["a"] == BLUE.lower() and look["spike"] == ORANGE.lower()
    assert look["alarm (spikes)"] == VERMILION.lower()
    marks = {text: handle.get_marker() for text, handle in named(figure).items() if text in
             ("spike", "nothing passes (< −60 dB)")}  # fmt: skip
    assert marks == {"spike": "o", "nothing passes (< −60 dB)": "v"}
    attenuation = figure.axes[2] if len(figure.axes) > 3 else figure.axes[-2]
    (silent,) = [line for line in attenuation.lines if line.get_marker() == "v"]
    assert silent.get_xdata() == pytest.approx([1.0, 1.1, 1.2])
    aligned = dlgmd_cli.plot(results, align="collision", collision_frame=30, mean=True)
    assert legend(aligned) == ["dlgmd, mean ± SEM of 3 trials"]
    mean = line_named(aligned, legend(aligned)[0])
    middle = np.mean([one.level for one in results.values()], axis=0)[3:]
    assert mean.get_ydata()[::-1] == pytest.approx(middle)
    assert mean.get_xdata()[::-1] == pytest.approx(3.0 - make_result().time_s[3:])
    (band,) = aligned.axes[0].collections
    edges = band.get_paths()[0].vertices
    error = np.std([one.level[3] for one in results.values()], ddof=1) / np.sqrt(3)
    first = edges[np.isclose(edges[:, 0], mean.get_xdata()[-1]), 1]
    assert (first.min(), first.max()) == pytest.approx((middle[0] - error, middle[0] + error))
    (axes,) = aligned.axes
    assert axes.get_xlabel() == "Time to collision (s)" and axes.get_xlim()[0] > axes.get_xlim()[1]


def color_of(handle):
    kinds = ("get_markerfacecolor" if getattr(handle, "get_marker", str)() == "o" else "get_color",)
    found = next(getattr(handle, k)() for k in (*kinds, "get_facecolor") if hasattr(handle, k))
    return found[0] if np.ndim(found) == 2 else found


def test_figures_of_an_evaluation():
    lead_s = {
        "one": np.array([0.5, 2.0, np.nan, -0.3]),
        "two": np.array([1.0, 1.0, np.nan, np.nan]),
    }
    figure = leads(lead_s)
    for label, own in lead_s.items():
        left_s, share = line_named(figure, label).get_data()
        assert close(share, [(own >= left).mean() for left in left_s])  # a late alarm is none
        assert left_s[0] == 0.0 and left_s[-1] > 2.0
    assert figure.axes[0].get_xlim() == pytest.approx((2.1, 0.0))
    labels = [f"set{k} ttc_alarm=0.5 alarm=ttc, default threshold" for k in range(5)]
    few, many = (leads(dict.fromkeys(labels[:n], lead_s["one"])) for n in (4, 5))
    many.draw_without_rendering()
    titles = [(axes._left_title, axes) for axes in many.axes[:5]]
    assert all(t.get_window_extent().x1 <= axes.bbox.x1 + 1 for t, axes in titles)
    for names in (legend(few), [title.get_text() for title, _ in titles]):
        assert [name.replace("\n", " ") for name in names] == labels[: len(names)]
    rate, recall = np.array([4.0, 1.0, 0.0]), np.array([0.9, 0.6, 0.2])
    lines = {
        name: Curve(np.arange(3.0), recall - off, recall - off - 0.1, recall - off + 0.1, rate)
        for name, off in (("a", 0.0), ("b", 0.15))
    }
    figure = trade_off(lines, {"b": (1.0, 0.45)}, 0.5)
    for label, line in lines.items():
        drawn = line_named(figure, label)
        at = np.argsort(rate)
        assert drawn.get_drawstyle() == "steps-post"
        assert drawn.get_xdata()[:3] == pytest.approx(rate[at])
        assert drawn.get_ydata()[:3] == pytest.approx(line.recall[at])
        (band,) = [c for c in figure.axes[0].collections
                   if to_hex(c.get_facecolor()[0]) == to_hex(drawn.get_color())]  # fmt: skip
        box = band.get_paths()[0].get_extents()
        assert (box.y0, box.y1) == pytest.approx((line.recall_low[2], line.recall_high[0]))
    (dot,) = [line for line in figure.axes[0].lines if line.get_marker() == "o"]
    assert dot.get_xydata().tolist() == [[1.0, 0.45]]
    assert dot.get_color() == line_named(figure, "b").get_color()
    assert set(line_named(figure, "0.5 a minute, the most allowed").get_xdata()) == {0.5}
    assert figure.axes[0].get_xlim()[0] == 0.0 and figure.axes[0].get_xlim()[1] > 4.0
    errors = {"x": np.array([[0.5, 1.0], [0.1, 0.2], [0.3, 0.4]])}
    figure = times_to_contact(errors)
    middle, most = (line for line in figure.axes[0].lines)
    assert middle.get_ydata() == pytest.approx(np.exp([0.1, 0.2])) and middle.get_linestyle() == "-"
    assert most.get_ydata() == pytest.approx(np.exp([0.3, 0.4])) and most.get_linestyle() == ":"
    handles = {text: handle.get_linestyle() for text, handle in named(figure).items()}
    assert handles == {"x": "-", "median": "-", "90th percentile": ":"}
    assert figure.axes[0].get_xlim()[0] > figure.axes[0].get_xlim()[1] == 0.0


def test_the_verdict_of_a_calibration():
    def scores(rate, recall):
        ends = ("", 0.0), ("_low", -0.1), ("_high", 0.2)
        rates = {f"false_alarms_per_min{end}": rate + 3 * by for end, by in ends}
        return rates | {f"recall{end}": recall + by for end, by in ends}

    figure = verdict({"held out": scores(2.0, 0.7), "before": scores(5.0, 0.4)}, 1.0)
    places, lines = {}, figure.axes[0].lines
    for text in ("held out", "before"):
        color = to_hex(named(figure)[text].get_color()[0])
        dots = [line for line in lines if line.get_marker() in "os"]
        (dot,) = [dot for dot in dots if to_hex(dot.get_color()) == color]
        places[text] = dot.get_xydata()[0].tolist()
    assert places == {"held out": [2.0, 0.7], "before": [5.0, 0.4]}
    across, up, *_ = figure.axes[0].collections
    assert across.get_segments()[0][:, 0] == pytest.approx([1.7, 2.6])
    assert up.get_segments()[0][:, 1] == pytest.approx([0.6, 0.9])
    assert set(line_named(figure, "1 a minute, the most allowed").get_xdata()) == {1.0}
    assert figure.axes[0].get_xlim()[1] > 5.2 and figure.axes[0].get_ylim()[1] > 1.0


def test_hatches_of_a_sweep_and_images_of_kernels_are_named():
    values = [-np.inf, np.nan, np.nan, -3, 2, 1]
    possible = [[1, 1, 0], [1, 1, 1]]
    figure = plot_sweep(*swept({"attenuation_db": values}, speeds=(1.0,), possible=possible))
    texts = "nothing passes (< −60 dB)", "no valid frame", "no such parameters"
    looks = {text: (patch.get_hatch() or "", to_hex(patch.get_facecolor()))
             for text, patch in named(figure).items()}  # fmt: skip
    expected = zip(texts, (MINUS_INFINITE, UNDEFINED, IMPOSSIBLE), strict=True)
    assert looks == {text: (look.hatch, to_hex(look.facecolor)) for text, look in expected}
    found = DLGMD(load_set(9, formulation="equations")).connections
    figure = plot_kernels("set9", found.excitation, found.inhibition, found.latency)
    maps = {axes.get_title(): axes.images[0] for axes in figure.axes if axes.get_title()}
    kernels = {"Excitation $K_E$": found.excitation, r"Latency $\tau$ (frames)": found.latency}
    kernels |= {f"Inhibition $K_{{{delay}}}$": one for delay, one in found.inhibition.items()}
    assert maps.keys() == kernels.keys()
    strongest = max(kernel.max() for name, kernel in kernels.items() if "tau" not in name)
    for name, image in maps.items():
        assert np.array_equal(image.get_array().data, kernels[name])
        top = found.latency.max() if "tau" in name else strongest
        assert image.get_clim() == (0.0, top) and image.origin == "upper"


def test_panels_of_the_paper():
    curves = {
        "a": (np.arange(3.0), np.array([1.0, 2.0, -np.inf])),
        "b": (np.arange(3.0), np.ones(3)),
    }
    panels = [Panel("one", curves, collision=2.0, level=0.5), Panel("two", {"b": curves["b"]})]
    figure = plot_panels(panels, "x", "y")
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["one", "two"]
    for label in "ab":
        drawn = line_named(figure, label, axes=figure.axes[0])
        assert drawn.get_ydata() == pytest.approx(np.maximum(curves[label][1], -60.0))
    assert set(line_named(figure, "threshold 0.5").get_ydata()) == {0.5}
    assert set(line_named(figure, "collision").get_xdata()) == {2.0}


@pytest.mark.parametrize("rule", ["expansion", "spikes", "twice"])
def test_the_film_of_layers_shows_the_potential_and_the_signal(rule, monkeypatch):
    figures, pixels = [], films._pixels
    monkeypatch.setattr(films, "_pixels", lambda one: (figures.append(one), pixels(one))[1])
    scale, result = Scale.over(0.0, 2.0), held(rule)
    film = films.Film(result, (54, 96), (scale, scale), ("a", "b"), "flight")
    (below,) = figures[-1].subfigs[1:]
    shown = [(result.level, result.threshold, BLUE)]
    if rule != "spikes":
        shown.append((result.signal, result.rule.threshold, GREEN))
    for axes, (values, threshold, color) in zip(below.axes, shown, strict=True):
        (curve,) = [line for line in axes.lines if line.get_color() == color]
        assert close(curve.get_ydata(), values)
        (dashed,) = [line for line in axes.lines if line.get_linestyle() == "--"]
        assert set(dashed.get_ydata()) == {threshold}
        assert axes.get_ylim()[0] < threshold < axes.get_ylim()[1]
    handles = named(below)
    assert handles["threshold 0.4"].get_color() != VERMILION
    assert rule == "spikes" or handles[result.rule.line_text].get_color() == VERMILION
    assert handles["spike"].get_marker() == "o" and f"alarm ({rule})" in handles
    if rule != "spikes":  # the present: higher for a greater signal
        heights = [film._places[1][row, 1] for row in (20, 47)]
        assert heights[1] < heights[0] - 10


def test_the_film_of_a_flight_shows_the_signal():
    from dlgmd_cli.lab.fly import gl

    try:
        gl.require()  # a plain import would choose a display, also for later tests
    except DlgmdError as error:
        pytest.skip(f"flights need MuJoCo: {error}")
    from dlgmd_cli.lab.fly.film import Loop, _draw_curves

    rows = [(t / 10, 5.0, 1.0, 0.1 * t, 0.05 * t, 0.01 * t, 0) for t in range(30)]
    loops = {"without": Loop([], rows, contact_s=2.5), "with": Loop([], rows, alarm_s=2.0)}
    for threshold, column in ((0.47, 4), (None, 3)):
        expansion, potential = curves = [*Figure().subplots(2, 1)]
        _draw_curves(curves, loops, threshold)
        thick = [line for line in expansion.lines if line.get_linewidth() == 4]
        assert all(close(one.get_ydata(), np.array(rows)[:, column]) for one in thick)
        thin = [line for line in expansion.lines if line.get_linewidth() == 1.5]
        assert len(thick) == 2 and len(thin) == (2 if threshold else 0)
        assert all(close(one.get_ydata(), np.array(rows)[:, 3]) for one in thin)
        assert close(potential.lines[0].get_ydata(), np.array(rows)[:, 5])
        marks = [(line.get_color(), line.get_xdata()[0]) for line in potential.lines
                 if len(line.get_xdata()) == 2]  # fmt: skip
        assert marks == [(BLACK, 2.5), (VERMILION, 2.0)]
    assert expansion.get_title(loc="left") == "Expansion (1/s)"


def sparkline(text, n=0):
    """Points of the path, height of the threshold, and alarms, in a row of an index."""
    svg = re.findall(r"<svg.*?</svg>", text, re.S)[n]
    path = re.search(r'<path d="(.*?)"', svg)[1]
    points = [
        (way, *map(float, pair.split(","))) for way, pair in re.findall(r"([ML])([^ML]+)", path)
    ]
    line, rects = (
        re.search(r'y1="(.*?)"', svg)[1],
        re.findall(r'<rect x="(.*?)".*?width="(.*?)"', svg),
    )
    return points, float(line), [(float(x), float(x) + float(width)) for x, width in rects]


@pytest.mark.parametrize(
    ("rule", "peak", "low", "high"),
    [
        ("expansion", "expansion up to 10.00/s", -0.5, 10.5),
        ("ttc", "time to contact down to 0.10 s", 0.0, 1.92),
        ("spikes", "normalised MP up to 0.90", -0.03, 1.055),
        ("twice", "signal up to 20.00", -1.0, 21.0),
    ],
)
def test_an_index_shows_the_signal_with_its_threshold_and_its_peak(runs, rule, peak, low, high):
    pytest.importorskip("jinja2", reason="pages need Jinja2")
    result = held(rule)
    result.rows["alarm"][result.alarm_onsets + 2] = False  # a pause, which ends no alarm
    result.save("out/a")
    runs("view", "out", "--no-film", "--out", "index.html")
    text = Path("index.html").read_text("utf-8")
    assert f", {peak}</li>" in text and f"alarm by {rule}" in text
    points, line, alarms = sparkline(text)

    def y(value):
        return 42 - 40 * (np.clip(value, low, high) - low) / (high - low)

    known = np.isfinite(result.signal)
    places = [(x, where) for _, x, where in points]
    x = result.time_s[known] / result.time_s[-1] * 240
    np.testing.assert_allclose(places, np.column_stack((x, y(result.signal[known]))), atol=0.11)
    assert line == pytest.approx(y(result.rule.threshold), abs=0.1)
    starts = np.flatnonzero(np.diff(known, prepend=False) & known)
    assert [way for way, *_ in points].count("M") == len(starts)  # broken where it is undefined
    begin = result.alarm_list[0].start_s - 0.05
    assert "contact in 0.60 s" in text or rule != "ttc"
    assert len(alarms) == len(result.alarm_list) == 1
    assert alarms[0][0] == pytest.approx(begin / result.time_s[-1] * 240, abs=0.1)
    (page,) = Path("index-pages").glob("*.html")
    (data,) = re.findall(r'id="data">(.*?)</script>', page.read_text("utf-8"), re.S)
    (one,) = json.loads(data)["results"]
    assert close(np.array(one["signal"], float), np.round(result.signal, 4))
    assert one["limits"] == pytest.approx((low, high), abs=0.01)
    assert one["rule"] == pytest.approx(result.rule.to_dict())


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "axis"), [("expansion", "y4"), ("ttc", "y5"), ("twice", "y6")])
def test_the_curves_of_a_page_are_the_signal_and_what_was_measured(
    browser, runs, tmp_path, rule, axis
):
    pytest.importorskip("plotly", reason="pages need Plotly")
    result = held(rule)
    result.save("out")
    runs("view", "out", "--no-film", "--out", "page.html")
    reader = Reader(browser, f"file://{tmp_path}/page.html")
    reader.until("window.plot !== undefined && plot.data !== undefined")
    drawn = f"plot.data.filter(one => one.yaxis === '{axis}')"
    drawn = f"{drawn}.map(one => [one.line.width, one.customdata])"
    (thin, raw), (thick, signal) = reader.page.evaluate(drawn)
    column = {"expansion": "expansion", "ttc": "ttc_s", "twice": "signal"}[rule]
    assert thin < thick and close(np.array(signal, float), np.round(result.signal, 4))
    assert close(np.array(raw, float), np.round(getattr(result, column), 4))
    shape = f"plot.layout.shapes.find(one => one.yref === '{axis}' && one.line.dash === 'dash')"
    assert reader.page.evaluate(f"{shape}.y0") == result.rule.threshold
    texts = f"plot.layout.annotations.filter(one => one.yref === '{axis}').map(one => one.text)"
    assert reader.page.evaluate(texts) == [result.rule.line_text] and not reader.faults


@pytest.mark.slow
@pytest.mark.parametrize(("rule", "column"), [("expansion", "expansion"), ("twice", "signal")])
def test_the_charts_of_live_are_the_signal_and_what_was_measured(browser, rule, column):
    page = browser.new_page()
    page.goto(f"file://{PAGE}")
    row = {"time_s": 0.0, "mp_abs": 0.1, "expansion": 2.0, "ttc_s": 0.5, "signal": 0.7}
    row |= {"latency_ms": 3.0, "alarm": False, "spike": False}
    state = {"rule": held(rule).rule.to_dict(), "name": "a", "fps": 9.0, "latency_ms": 1.0}
    page.evaluate(
        f"[rows, state] = {json.dumps([[row], {'latency_high_ms': 1.0, **state}])}; undefined"
    )
    drawn = """(() => { const found = [], kept = chart; let now = "";
        chart = (canvas, limits, marks) => { now = canvas.id; return kept(canvas, limits, marks); };
        curve = (plot, key, width) => found.push([now, key, width ?? 1.8]);
        drawThreshold = (plot, one) => found.push([now, one.text, 0]);
        showNumbers(); drawCharts(); return found; })()"""
    found = page.evaluate(drawn)
    own = [[key, width] for name, key, width in found if name == f"chart-{column}"]
    thin = [[column, 0.6]] if column != "signal" else []
    assert own == [[held(rule).rule.line_text, 0], *thin, ["signal", 1.8]]
    assert [name for name, _, width in found if width == 0] == [f"chart-{column}"]
    words = """(() => { const found = [], kept = chart;
        chart = (...all) => { const plot = kept(...all), {top, bottom} = plot;
            plot.pen.fillText = (text, x, y) => found.push([text, y < top || y > bottom]);
            return plot; };
        rows = [{...rows[0], ttc_s: 99, expansion: -3}, {...rows[0], time_s: 0.1}];
        drawCharts(); return found; })()"""
    beyond = [one for one in page.evaluate(words) if one[0][0] in "<>"]
    assert sorted(beyond) == [["< −1", True], ["> 1.9", True]]
    assert page.is_visible("[data-column=signal]") == (column == "signal")
    assert page.text_content("#expansion") == ("0.70/s" if rule == "expansion" else "2.00/s")
