"""The panels of figures over time: lines, marks and bars of results."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from dlgmd_cli.frame import runs_of
from dlgmd_cli.models.rules import APPROACH, GROUND, POINTS, QUALITY
from dlgmd_cli.plots import style
from dlgmd_cli.results.annotations import KINDS
from dlgmd_cli.results.names import threshold_text
from dlgmd_cli.results.result import Flags, Result, Series

# Least span of the vertical axis, in dB: rounding errors should not look like an event.
MIN_SPAN_DB = 5.0
# Pixel columns of the widest figure; of longer results, the extremes in each column are drawn.
MAX_COLUMNS = 1400

MP_COLUMNS = ("level", "mp_abs", "mp_seq")
# Axis labels by `Result.by_sequence`; the last one is for results that differ.
LEVEL_NAMES = {False: "MP (fixed scale)", True: "MP (min–max)"}
EITHER = "Normalised MP"
# Column that a rule compares -> name of an axis; of a rule of one's own: Signal.
SIGNAL_NAMES = {
    "expansion": "Expansion (1/s)",
    "corridor": "In the way (1/s)",
    "ttc_s": "TTC (s)",
}
# Neighbours differ in colour, dashes and brightness; vermilion and black have other meanings. The
# last four looks serve other figures, and one panel of up to eight results.
LOOKS: tuple[tuple[str, style.Dashes], ...] = (
    (style.BLUE, "-"),
    (style.PURPLE, (0, (4, 1.5))),
    (style.GREEN, (0, (5, 1.5, 1, 1.5))),
    (style.SKY_BLUE, (0, (1, 1.2))),
    (style.GREY, (0, (9, 2))),
    (style.ORANGE, (0, (5, 1.2, 1, 1.2, 1, 1.2))),
    (style.INDIGO, (0, (2.5, 1))),
    (style.OLIVE, "-"),
)
# Width of an emphasised line; below, its place in front, and the width of the other lines.
STRONG: style.Line = {"linewidth": 2.0}
_STRONGEST: style.Line = {**STRONG, "zorder": 2.5}
_WEAK: style.Line = {"linewidth": 0.8}
# Of what was measured, behind what the rule makes of it; and what shades what a rule holds back.
_BEHIND: style.Line = {"linewidth": 0.5, "alpha": 0.6, "zorder": 1.5}
_HATCHES = {GROUND: "", QUALITY: "//////", POINTS: "++++++", APPROACH: "......"}
_BLIND_HATCH = "\\\\\\"
# Height in inches of a row of marks at the foot of an axis.
_MARKS_IN = 0.09

# Limits of the potential's axis: no tick falls halfway between two pixels and depends on rounding.
LEVEL_LIMITS = (-0.03, 1.055)
# Greatest number of characters of a name beside a row of spikes.
_LONGEST_ROW_NAME = 18
# Height of the bar that marks values beyond an axis, as a share of the axes' height.
_BEYOND = 0.035
# Share of the time axis in which its words stand to the right of the bar, not to its left.
_WORDS_SHARE = 0.15
# Height in inches of a panel that has room for the name of a line.
_ROOM_IN = 0.7
# With more dots than this, dots touch, and black rims would hide everything else: no rims.
_MAX_RINGED = 200


@dataclass(frozen=True)
class Trace:
    """A result and the look of its line; if the result is `alone`, spikes and alarms are drawn too.

    `collisions_s` has the times of the collisions drawn as lines, `contacts_s` of the collisions
    that the true time to contact refers to, and `marks` the times and texts of the result's own
    marks. The line is reduced to `n_columns`, see `thinned`.
    """

    label: str
    result: Result
    look: style.Line
    alone: bool
    collisions_s: tuple[float, ...] = ()
    contacts_s: tuple[float, ...] = ()
    marks: tuple[tuple[float, str], ...] = ()
    n_columns: int = MAX_COLUMNS


class AxisScale(NamedTuple):
    """The vertical axis of a panel: its height in inches, and what is drawn.

    `column` is the column of the potential. `limits` are the limits of the values, None to fit
    them.
    """

    height_in: float
    column: str = "level"
    limits: tuple[float, float] | None = None


def thinned(time_s: Series, values: Series, n_columns: int = MAX_COLUMNS) -> tuple[Series, Series]:
    """Reduce a series to its envelope: the least and the greatest value of each column of time.

    Both stay at their own times. A column is NaN if all its values are NaN.
    """
    if len(values) <= 2 * n_columns:
        return time_s, values
    edges = np.linspace(time_s[0], time_s[-1], n_columns, endpoint=False)
    starts = np.unique(np.searchsorted(time_s, edges))
    column = np.searchsorted(starts, np.arange(len(values)), side="right")
    # Sorted within each column, with NaN last: the first is the least, or of −values the greatest.
    extremes = (np.lexsort((keys, column))[starts] for keys in (values, -values))
    rows = np.unique(np.concatenate([*extremes, [0, len(values) - 1]]))
    return time_s[rows], values[rows]


def stretches(time_s: Series, flags: Flags) -> list[tuple[float, float]]:
    """Start and duration, in seconds, of every run of flagged rows.

    A row extends halfway to its neighbours.
    """
    half = np.diff(time_s) / 2 if len(time_s) > 1 else np.array([0.1])
    edges = np.concatenate(
        (time_s[:1] - half[:1], time_s[:-1] + half[: len(time_s) - 1], time_s[-1:] + half[-1:])
    )
    return [(float(edges[a]), float(edges[b] - edges[a])) for a, b in runs_of(flags)]


def traces_of(results: Mapping[str, Result], emphasise: str | None = None) -> list[Trace]:
    """The results as traces, each with its look; the emphasised result has the first look."""
    looks: dict[str, style.Line] = {}
    for place, label in enumerate(sorted(results, key=lambda label: label != emphasise)):
        color, dashes = LOOKS[place % len(LOOKS)]
        looks[label] = {"color": color, "linestyle": dashes}
        if emphasise:
            looks[label].update(_STRONGEST if label == emphasise else _WEAK)
    return [
        Trace(label, result, looks[label], alone=len(results) == 1)
        for label, result in results.items()
    ]


def _draw_line(axes: Axes, trace: Trace, values: Series) -> style.Entries:
    """Draw a line that breaks at NaN; an isolated value is a dot."""
    times, shown = thinned(trace.result.time_s, values, trace.n_columns)
    known = np.concatenate(([False], ~np.isnan(shown), [False]))
    single = known[1:-1] & ~known[:-2] & ~known[2:]
    (line,) = axes.plot(times, shown, **trace.look)
    axes.plot(times[single], shown[single], ".", color=trace.look["color"], markersize=3)
    return [(line, trace.label)] if known.any() or not trace.alone else []


def _draw_level(axes: Axes, traces: list[Trace], scale: AxisScale) -> style.Entries:
    """Draw the normalised potential, a shared threshold, and the events of a single result."""
    results, column = [trace.result for trace in traces], scale.column
    by_sequence = {r.by_sequence if column == "level" else column == "mp_seq" for r in results}
    levels: list[Series] = [getattr(result, column) for result in results]
    entries = []
    for trace, level in zip(traces, levels, strict=True):
        entries += _draw_line(axes, trace, level)
    thresholds = {result.threshold for result in results}
    is_level = all({result.by_sequence} == by_sequence for result in results)
    if len(thresholds) == 1 and (column == "level" or is_level):
        threshold = thresholds.pop()
        line = axes.axhline(threshold, color=style.GREY, linestyle="--", linewidth=0.8)
        low, high = scale.limits or LEVEL_LIMITS
        is_at_end = min(abs(threshold - low), abs(high - threshold)) < 1e-3 * (high - low)
        # Visible on a curve at the threshold, and at the end of the axis.
        line.set(zorder=2.3, clip_on=not is_at_end)
        text = f"threshold {threshold_text(threshold)}"
        entries += _name_line(axes, line, text, (low, high), scale.height_in)
    if traces[0].alone:
        entries += _draw_spikes(axes, traces[0], levels[0])
    if all(np.isnan(level).all() for level in levels):
        _note(axes, traces, "the membrane potential never changes")
    axes.set_ylim(scale.limits or LEVEL_LIMITS)
    axes.set_ylabel(LEVEL_NAMES[by_sequence.pop()] if len(by_sequence) == 1 else EITHER)
    return entries


def _name_line(
    axes: Axes, line: Line2D, text: str, limits: tuple[float, float], height_in: float
) -> style.Entries:
    """Write the name of a horizontal line at its left end; in a low panel, the legend has it."""
    if height_in < _ROOM_IN:
        return [(line, text)]
    level = float(np.asarray(line.get_ydata())[0])
    is_high = level > limits[0] + 0.85 * (limits[1] - limits[0])
    aside, va = (-2, "top") if is_high else (1.5, "bottom")
    place = axes.annotate(text, (0.01, level), (0, aside), axes.get_yaxis_transform())
    place.set(anncoords="offset points", annotation_clip=True, zorder=3)
    place.set(va=va, color=line.get_color(), fontsize=style.points(6.5), bbox=style.GROUND)
    return []


def _draw_spikes(axes: Axes, trace: Trace, level: Series) -> style.Entries:
    """Draw a dot at every spike, and the bands."""
    result = trace.result
    spikes = np.where(result.new_spikes, level, np.nan)
    times, levels = thinned(result.time_s, spikes, trace.n_columns)
    spiking = ~np.isnan(levels)
    if not spiking.any():
        return _draw_bands(axes, trace)
    (dots,) = axes.plot(times[spiking], levels[spiking], "o", color=style.ORANGE, zorder=3)
    dots.set_clip_on(False)
    if np.count_nonzero(spiking) > _MAX_RINGED:
        dots.set(markersize=2, markeredgewidth=0)
    else:
        dots.set(markersize=3, markeredgewidth=0.3, markeredgecolor="black")
    return [(dots, "spike"), *_draw_bands(axes, trace)]


def _draw_bands(axes: Axes, trace: Trace) -> style.Entries:
    """Draw a band at every alarm, and a hatched one wherever the result is blind."""
    result, entries, up = trace.result, style.Entries(), axes.get_xaxis_transform()
    if result.alarms.any():
        bars = stretches(result.time_s, result.alarmed)
        bands = axes.broken_barh(bars, (0, 1), alpha=0.3, transform=up, zorder=0)
        bands.set(color=style.VERMILION, linewidth=0.8)
        entries.append((bands, f"alarm ({result.rule.name})"))
    for reason in dict.fromkeys(reason for *_, reason in result.blind_spans):
        bars = stretches(result.time_s, result.blind == reason)
        bands = axes.broken_barh(bars, (0, 1), transform=up, zorder=0)
        bands.set(facecolor="none", edgecolor=style.LIGHT_GREY, linewidth=0.0, hatch=_BLIND_HATCH)
        entries.append((bands, f"blind: {reason}"))
    return entries


def is_measured(result: Result, column: str = "expansion") -> bool:
    """Whether a result has the expansion, or another column, in some frame."""
    return bool(np.isfinite(getattr(result, column)).any())


def compared(result: Result, column: str) -> Series:
    """The signal of a rule that compares a column, else the column itself."""
    values: Series = getattr(result, "signal" if result.rule.column == column else column)
    return values


def _are_equal(every: Sequence[Series]) -> bool:
    return all(np.array_equal(every[0], series, equal_nan=True) for series in every)


def _draw_measured(
    axes: Axes, traces: list[Trace], column: str, name: str
) -> tuple[style.Entries, list[tuple[Trace, Series]]]:
    """Draw what rules compare of a column; where that is not what was measured, both.

    What was measured is thin. There is one line if all results have the same numbers. A single
    result also shows its alarms. Returns the legend's entries and the drawn series.
    """
    entries = _draw_bands(axes, traces[0]) if traces[0].alone else []
    signals = [compared(trace.result, column) for trace in traces]
    measured: list[Series] = [getattr(trace.result, column) for trace in traces]
    if is_shared := _are_equal(signals) and _are_equal(measured):
        color = style.GREEN if traces[0].alone else style.GREY
        traces = [replace(traces[0], label="measured in the video", look={"color": color})]
    pairs = list(zip(traces, signals, measured, strict=False))
    behind = [(t, raw) for t, signal, raw in pairs if not _are_equal([signal, raw])]
    if behind and is_shared:
        pairs[0] = replace(traces[0], label="signal of the rule"), signals[0], measured[0]
    for trace, signal, _ in pairs:
        line = _draw_line(axes, trace, signal)
        # The axis names a line that is alone.
        entries += [] if traces[0].alone and not behind else line
    for trace, raw in behind:
        thin = replace(trace, label=f"measured {name}", look={**trace.look, **_BEHIND})
        entries += _draw_line(axes, thin, raw)
    if not any(is_measured(t.result) or is_measured(t.result, "ttc_s") for t in traces):
        _note(axes, traces, "the images are too small or too narrow")
    return entries, [*((trace, signal) for trace, signal, _ in pairs), *behind]


def _mark_beyond(
    axes: Axes, shown: list[tuple[Trace, Series]], limits: tuple[float, float]
) -> None:
    """Set the limits of an axis, with a bar at the end wherever a value lies beyond the limits.

    The longest bar says which values these are.
    """
    axes.set_ylim(limits)
    across = axes.get_xaxis_transform()
    low, high = (f"{limit:.2g}".replace("-", "−") for limit in limits)
    for is_high, text in ((False, f"< {low}"), (True, f"> {high}")):
        every: list[tuple[float, float]] = []
        for trace, values in shown:
            flags = values > limits[1] if is_high else values < limits[0]
            bars = stretches(trace.result.time_s, flags)
            place = (1.0 if is_high else -_BEYOND), _BEYOND
            drawn = axes.broken_barh(bars, place, transform=across)
            drawn.set(color=trace.look["color"], linewidth=0.0)
            # Clip the bars to the width of the axes: they lie above or below, never beside.
            drawn.set_clip_path(Rectangle((0, -1), 1, 3, transform=axes.transAxes))
            drawn.set_in_layout(False)  # else Matplotlib's layout reserves the clip rectangle
            every += bars
        if every:
            first_s, last_s = (
                f(t.result.time_s[i] for t, _ in shown) for f, i in ((min, 0), (max, -1))
            )
            start_s, width_s = max(every, key=lambda bar: bar[1])
            # Beside the bar, above or below the axes, where no curve runs.
            is_left = start_s < first_s + _WORDS_SHARE * (last_s - first_s)
            at_s, ha, aside = (start_s + width_s, "left", 2) if is_left else (start_s, "right", -2)
            y, up, va = (0.999, 1.0, "bottom") if is_high else (0.001, -4.3, "baseline")
            apart = aside, style.points(up)
            words = axes.annotate(text, (at_s, y), apart, across, annotation_clip=True)
            words.set(anncoords="offset points", ha=ha, va=va)
            words.set(color=style.GREY, fontsize=style.points(6.5), in_layout=False, zorder=3)
            if is_high:  # below are the ticks, which a ground would hide
                words.set_bbox(style.GROUND)


def _draw_thresholds(
    axes: Axes, texts: Mapping[float, str], limits: tuple[float, float], height_in: float
) -> style.Entries:
    """Draw the threshold of rules, with its text, if all these rules have the same one."""
    if len(texts) != 1:
        return []
    ((level, text),) = texts.items()
    line = axes.axhline(level, color=style.VERMILION, linestyle="--", linewidth=0.8)
    return _name_line(axes, line, text, limits, height_in)


def _draw_held(axes: Axes, trace: Trace) -> style.Entries:
    """Shade what was measured beyond the threshold without an alarm, by what held it back."""
    result, entries = trace.result, style.Entries()
    for first, last, word in result.held:
        rows = slice(first, last + 1)
        area = axes.fill_between(
            result.time_s[rows], result.rule.threshold, getattr(result, result.rule.column)[rows],
            facecolor=style.LIGHT_GREY, edgecolor="white", hatch=_HATCHES.get(word, ""),
            linewidth=0.0, zorder=0.5,
        )  # fmt: skip
        entries.append((area, f"held back: {word}"))
    return entries


def _draw_expansion(axes: Axes, traces: list[Trace], scale: AxisScale) -> style.Entries:
    """Draw the expansion and the threshold of rules that compare it.

    Shrinking faster than half of the greatest growth is cut off.
    """
    entries, shown = _draw_measured(axes, traces, "expansion", "expansion")
    values = np.concatenate([series for _, series in shown])
    axes.axhline(0.0, color=style.LIGHT_GREY, linewidth=0.6, zorder=0)
    usual = 1.0 / max(trace.result.params.ttc_alarm for trace in traces)
    rules = [t.result.rule for t in traces if t.result.rule.column == "expansion"]
    # In this order, `max` ignores a NaN.
    high = max(usual, *(rule.threshold for rule in rules), float(np.fmax.reduce(values)))
    low = max(float(np.fmin.reduce(values, initial=0.0)), -0.5 * high)
    axes.set_ylabel(SIGNAL_NAMES["expansion"])
    limits = scale.limits or (low - 0.05 * high, 1.08 * high)
    _mark_beyond(axes, shown, limits)
    if traces[0].alone and rules:
        entries += _draw_held(axes, traces[0])
    texts = {rule.threshold: rule.line_text for rule in rules}
    return entries + _draw_thresholds(axes, texts, limits, scale.height_in)


def _draw_ttc(axes: Axes, traces: list[Trace], scale: AxisScale) -> style.Entries:
    """Draw the estimated time to contact, and the true time before known collisions.

    The threshold of rules that compare the time to contact is drawn if these rules share it.
    """
    entries, shown = _draw_measured(axes, traces, "ttc_s", "TTC")
    rules = [trace.result.rule for trace in traces]
    top_s = max(rule.longest_ttc_s for rule in rules)
    limits = scale.limits or (0.0, top_s)
    texts = {rule.threshold: rule.line_text for rule in rules if rule.column == "ttc_s"}
    entries += _draw_thresholds(axes, texts, limits, scale.height_in)
    for contact_s in sorted({time_s for trace in traces for time_s in trace.contacts_s}):
        times_s = [contact_s - 2.0 * top_s, contact_s]
        (line,) = axes.plot(times_s, [2.0 * top_s, 0.0], color=style.BLACK, linewidth=0.8)
        line.set_linestyle((0, (1, 1)))
        entries.append((line, "true TTC"))
    axes.set_ylabel(SIGNAL_NAMES["ttc_s"])
    _mark_beyond(axes, shown, limits)
    return entries


def has_own_signal(result: Result) -> bool:
    """Whether a rule compares what no other panel shows."""
    rule = result.rule
    if rule.column == "level":
        is_spike = rule.threshold == result.threshold
        return not (is_spike and _are_equal([result.signal, result.level]))
    return rule.panel == "signal"


def signal_limits(result: Result) -> tuple[float, float]:
    """The limits of an axis that shows the signal of a rule, its threshold and 0."""
    if result.rule.column == "ttc_s":
        return 0.0, result.rule.longest_ttc_s
    if result.rule.column == "level" and not has_own_signal(result):
        return LEVEL_LIMITS
    known = result.signal[np.isfinite(result.signal)]
    reach = 1.2 * result.rule.threshold
    low = float(known.min(initial=min(0.0, reach)))
    high = float(known.max(initial=max(0.0, reach)))
    if result.rule.column == "expansion":  # what shrinks faster than that is cut off
        low = max(low, -0.5 * high)
    room = 0.05 * (high - low) or 0.5
    return low - room, high + room


def _draw_signal(axes: Axes, traces: list[Trace], scale: AxisScale) -> style.Entries:
    """Draw the signals of rules of one's own, or of all rules, and their threshold by name."""
    entries = _draw_bands(axes, traces[0]) if traces[0].alone else []
    own = [trace for trace in traces if has_own_signal(trace.result)] or traces
    for trace in own:
        line = _draw_line(axes, trace, trace.result.signal)
        entries += [] if trace.alone else line
    rules = [trace.result.rule for trace in own]
    texts = {r.threshold: f"{style.plain(r.name.rpartition(':')[2])}: {r.line_text}" for r in rules}
    lows, highs = zip(*(signal_limits(trace.result) for trace in own), strict=True)
    limits = scale.limits or (min(lows), max(highs))
    _mark_beyond(axes, [(trace, trace.result.signal) for trace in own], limits)
    axes.set_ylabel(
        " or ".join(sorted({SIGNAL_NAMES.get(rule.column, "Signal") for rule in rules}))
    )
    return entries + _draw_thresholds(axes, texts, limits, scale.height_in)


def _draw_column(name: str, axes: Axes, traces: list[Trace], scale: AxisScale) -> style.Entries:
    """Draw a column of the results by its name."""
    entries: style.Entries = []
    for trace in traces:
        entries += _draw_line(axes, trace, getattr(trace.result, name))
    if scale.limits:
        axes.set_ylim(scale.limits)
    axes.set_ylabel(style.plain(name, _LONGEST_ROW_NAME))
    return entries


def silence(trace: Trace) -> tuple[Flags, Series]:
    """Flags where almost nothing passes, and the attenuation (dB) elsewhere."""
    silent = trace.result.attenuation_db < style.FLOOR_DB  # -inf, but not NaN
    return silent, np.where(silent, np.nan, trace.result.attenuation_db)


def _draw_attenuation(axes: Axes, traces: list[Trace], scale: AxisScale) -> style.Entries:
    """Draw attenuation in dB; where nothing passes, marks at the foot, a row per such result."""
    entries: style.Entries = []
    silences, shown = zip(*(silence(trace) for trace in traces), strict=True)
    for trace, values in zip(traces, shown, strict=True):
        entries += _draw_line(axes, trace, values)
    silent = [(t, s) for t, s in zip(traces, silences, strict=True) if s.any()]
    if silent:
        mark = Line2D([], [], marker="v", linestyle="", color=style.GREY, markersize=3)
        entries.append((mark, f"nothing passes (< −{-style.FLOOR_DB:g} dB)"))
    elif all(np.isnan(values).all() for values in shown):
        _note(axes, traces, "no frame differs from the one before it")
    row = _MARKS_IN / scale.height_in
    for place, (trace, flags) in enumerate(silent):
        new = flags & ~trace.result.is_repeat
        times, zeros = thinned(trace.result.time_s, np.where(new, 0.0, np.nan), trace.n_columns)
        marked = times[zeros == 0.0]
        color = style.GREY if trace.alone else trace.look["color"]
        height = np.full(len(marked), (len(silent) - place - 0.5) * row)
        up = axes.get_xaxis_transform()
        axes.plot(marked, height, "v", color=color, markersize=3, transform=up)
    # There is a row also without marks: panels of single results, one below the other, are alike.
    low, high = scale.limits or span_db(shown)
    axes.set_ylim(high - (high - low) / (1.0 - max(1, len(silent)) * row), high)
    locator = MaxNLocator(int(np.clip(5 * scale.height_in, 2, 6)), steps=[1, 2, 5, 10])
    axes.set_yticks([tick for tick in locator.tick_values(low, high) if low <= tick <= high])
    axes.set_ylabel("Attenuation (dB)")
    return entries


def span_db(shown: Sequence[Series]) -> tuple[float, float]:
    """Limits of the vertical axis."""
    known = np.concatenate([values[~np.isnan(values)] for values in shown])
    if not known.size:
        return style.FLOOR_DB, 0.0
    low, high = float(known.min()), float(known.max())
    missing = max(0.0, MIN_SPAN_DB - (high - low)) / 2
    margin = 0.1 * max(high - low, MIN_SPAN_DB)
    return low - missing - margin, high + missing + margin


def _draw_raster(axes: Axes, traces: list[Trace], _: AxisScale) -> style.Entries:
    """Draw a row of spikes and a row of alarms; for several results, a row with both per result."""
    axes.tick_params(axis="y", length=0)
    if traces[0].alone:
        trace = traces[0]
        _draw_bars(axes, trace, trace.result.new_spikes, (0.65, 1.35), style.ORANGE)
        _draw_bars(axes, trace, trace.result.alarmed, (-0.35, 0.35), style.VERMILION)
        axes.set_yticks([1, 0], ["spikes", "alarm"])
        axes.set_ylim(-0.6, 1.6)
        return []
    for row, trace in enumerate(reversed(traces)):
        _draw_bars(
            axes, trace, trace.result.new_spikes, (row - 0.1, row + 0.4), trace.look["color"]
        )
        _draw_bars(axes, trace, trace.result.alarmed, (row - 0.4, row - 0.15), style.VERMILION)
    labels = [trace.label for trace in reversed(traces)]
    if len({label.rpartition(" · ")[2] for label in labels}) == 1:  # all have the same model
        labels = [label.rpartition(" · ")[0] or label for label in labels]
    names = [style.plain(label, _LONGEST_ROW_NAME) for label in labels]
    axes.set_yticks(range(len(traces)), names, fontsize=style.points(6.5))
    axes.set_ylim(-0.5, len(traces) - 0.5)
    colors = {trace.look["color"] for trace in traces}
    rules = ", ".join(sorted({trace.result.rule.name for trace in traces}))
    return [
        (Line2D([], [], color=color, marker="|", linestyle="", markeredgewidth=1.2), text)
        for color, text in (
            (colors.pop() if len(colors) == 1 else style.GREY, "spike"),
            (style.VERMILION, f"alarm ({rules})"),
        )
    ]


def _draw_bars(
    axes: Axes, trace: Trace, flags: Flags, reach: tuple[float, float], color: str
) -> None:
    """Draw a bar over every run of flagged rows, between two heights."""
    low, high = reach
    bars = stretches(trace.result.time_s, flags)
    axes.broken_barh(bars, (low, high - low), color=color, linewidth=0.4)


def _note(axes: Axes, traces: list[Trace], unchanged: str) -> None:
    """Write why there is no line: too few frames, or the reason `unchanged`."""
    n_short = sum(trace.result.n_valid == 0 for trace in traces)
    reasons = ["too few frames"] * (n_short > 0) + [unchanged] * (n_short < len(traces))
    why = ", or ".join(reasons)
    ground = {"facecolor": "white", "edgecolor": "none", "pad": 1}
    note = style.write_centred(axes, 0.5, 0.5, f"undefined: {why}", transform=axes.transAxes)
    note.set(fontsize=style.points(7), bbox=ground)


# A function that draws results in a panel: axes, results, vertical axis.
Draw = Callable[[Axes, list[Trace], AxisScale], style.Entries]


class PanelKind(NamedTuple):
    """A kind of panel: the function that draws it, and its height in inches."""

    draw: Draw
    height_in: float = 1.25


# Panel's name in `KINDS` -> its kind.
_PANELS = {
    "level": PanelKind(_draw_level),
    "signal": PanelKind(_draw_signal, 0.9),
    "expansion": PanelKind(_draw_expansion, 0.9),
    "ttc": PanelKind(_draw_ttc, 0.9),
    "attenuation": PanelKind(_draw_attenuation),
    "raster": PanelKind(_draw_raster, 0.4),
}


def panel_of(name: str) -> PanelKind:
    """The kind of panel for a name in `KINDS`, or for a column of the results."""
    return _PANELS.get(name) or PanelKind(partial(_draw_column, name))


def panels_of(kind: str, results: Sequence[Result]) -> tuple[str, ...]:
    """The names of the panels of a kind of figure, or a column, that these results can fill.

    Several results show only their potentials, unless a rule uses the expansion.
    """
    names = KINDS.get(kind, (kind,))
    if kind == "mp" and len(results) > 1 and not any(r.rule.uses_expansion for r in results):
        names = names[:1]
    if names[0] != "level":
        return names
    if len(results) > 1 and "raster" not in names:
        names = (*names, "raster")  # the only panel that shows the alarms of several results
    is_filled: dict[str, Callable[[Result], bool]] = {
        "signal": has_own_signal,
        "expansion": is_measured,
        "ttc": partial(is_measured, column="ttc_s"),
    }
    return tuple(
        name
        for name in names
        if name not in is_filled or any(is_filled[name](result) for result in results)
    )
