"""The exhibits with flights: the figures of groups 1 to 5, and what the paper says of a limit."""

import math
from collections.abc import Callable
from functools import partial
from itertools import chain
from typing import Any

import numpy as np

from dlgmd_cli import Result
from dlgmd_cli.lab.fly.scripts import TILT_S
from dlgmd_cli.lab.paper import stimuli
from dlgmd_cli.lab.paper.clips import Clip, ClipResults, Models, Series, all_versions, model
from dlgmd_cli.lab.paper.free import frames, free
from dlgmd_cli.lab.paper.panels import Panel, plot_panels
from dlgmd_cli.lab.paper.plan import (
    ANY,
    FEW,
    Data,
    Evidence,
    Needs,
    Plan,
    Steps,
    by_version,
)
from dlgmd_cli.lab.paper.stimuli import LGMDS, SIGMOID, level, positive, share_of_peak
from dlgmd_cli.plots.style import FLOOR_DB

_LGMD: Models = {"lgmd": "lgmd"}
_LGMDS: Models = {"lgmd": "lgmd", "emd-lgmd": "emd-lgmd"}
_LABELS = {f"set9/{v}": f"set 9, {v}" for v in stimuli.TWO} | LGMDS
# The threshold of a spike.
T_MP = 0.4
# Phases in which a model must be silent.
_BEFORE = ("pitch", "accelerate")
# Phases of the drone's attitude motion in groups 4 and 5, by the paper's Table III.
_ATTITUDE = ("take off", "pitch")
# Measures a model, given by its label, in one flight.
Measure = Callable[[ClipResults, str], float]
# One value per flight, by version.
Values = dict[str, list[float]]


def clips_of(plan: Plan, group: int) -> list[Clip]:
    """The flights of a group, one per seed; the first one is in the figures."""
    tilt = {} if plan.tilt_s == TILT_S else {"tilt_s": plan.tilt_s}
    return [Clip.of(f"group{group}", size=plan.size, seed=seed, **tilt) for seed in plan.seeds]


def _set9(plan: Plan) -> Models:
    return all_versions(9, only=plan.versions)


def greatest(level: Series, first: int, last: int, n_frames: int = 1) -> float:
    """The greatest level that so many successive frames hold, from `first` to `last`."""
    held = np.min([level[n : len(level) - n_frames + 1 + n] for n in range(n_frames)], axis=0)
    return float(held[first : last - n_frames + 2].max())


def phase(flight: ClipResults, name: str) -> tuple[int, int]:
    """First and last frame of a phase without the approach, or of the window to contact."""
    end = flight.collision_frame
    if name == "contact":
        return end - frames("contact"), end
    first, last = flight.phases[name]
    return first, max(first + 1, min(last, end - frames("approach")))


# A level is seen if one frame has it; there is an alarm if two successive frames hold it. Both are
# free constants.
SEEN, ALARM = "seen", "alarm"


def levels_in(flight: ClipResults, label: str, *parts: str, to: str = SEEN) -> list[float]:
    """The greatest level in each of some phases, or in the window to contact."""
    shown = level(flight.results, label)
    return [greatest(shown, *phase(flight, part), frames(to)) for part in parts]


def before(flight: ClipResults, label: str) -> float:
    """The greatest level in the phases before the approach."""
    return max(levels_in(flight, label, *_BEFORE))


def in_each(flight: ClipResults, label: str) -> float:
    """The level that raises an alarm in every phase before the approach."""
    return min(levels_in(flight, label, *_BEFORE, to=ALARM))


def contact(flight: ClipResults, label: str) -> float:
    """The level that raises an alarm in the window to contact."""
    return levels_in(flight, label, "contact", to=ALARM)[0]


def db_in(flight: ClipResults, label: str, first: str, last: str | None = None) -> float:
    """The pooled attenuation from the start of one phase to the end of another."""
    ends = phase(flight, first)[0], phase(flight, last or first)[1]
    return stimuli.pooled_db(flight.results[label], *ends)


def middle_db(flight: ClipResults, label: str, first: str, last: str | None = None) -> float:
    """The median of the attenuation of each frame in the same span; NaN if nothing changes."""
    ends = slice(phase(flight, first)[0], phase(flight, last or first)[1] + 1)
    db = np.maximum(flight.results[label].attenuation_db[ends], FLOOR_DB)
    return float(np.nanmedian(db)) if np.isfinite(db).any() else math.nan


def _of_set9(flights: list[ClipResults], measure: Measure, plan: Plan) -> dict[str, list[float]]:
    return by_version(lambda v: [measure(flight, f"set9/{v}") for flight in flights], plan.versions)


def _of_other(flights: list[ClipResults], measure: Measure, label: str) -> dict[str, list[float]]:
    return {ANY: [measure(flight, label) for flight in flights]}


def _spans(flight: ClipResults) -> list[tuple[float, float, str]]:
    """First frame, last frame and name of the phases that a figure shows: all but the first."""
    short = {"accelerate": "accel.", "decelerate": "brake"}
    return [
        (float(first), float(last), short.get(name, name))
        for name, (first, last) in [*flight.phases.items()][1:]
        if name != "collision"
    ]


def _panel(
    title: str,
    flight: ClipResults,
    curves: dict[str, Series],
    *,
    level: float | None = None,
    y_label: str = "",
) -> Panel:
    frame = np.arange(flight.collision_frame + 1.0)
    shown = {label: (frame, values[: len(frame)]) for label, values in curves.items()}
    return Panel(title, shown, _spans(flight), float(flight.collision_frame), level, y_label)


def _levels(title: str, flight: ClipResults, labels: dict[str, str]) -> Panel:
    """A panel of levels; `labels` maps labels of results to the legend's."""
    curves = {shown: level(flight.results, label) for label, shown in labels.items()}
    return _panel(title, flight, curves, level=T_MP)


def _attenuation(flight: ClipResults) -> Panel:
    """A panel of the attenuation of set 9 and the LGMD."""
    curves = {
        shown: np.maximum(flight.results[label].attenuation_db, FLOOR_DB)
        for label, shown in _LABELS.items()
        if label in flight.results
    }
    return _panel("Attenuation", flight, curves, y_label="dB")


def fig1(plan: Plan) -> Steps:
    """The LGMD responds to the camera's own motion."""
    data = yield dict.fromkeys(clips_of(plan, 1), _LGMD)
    flights = [data[clip] for clip in clips_of(plan, 1)]
    values = {
        f"fig1-{part}{name}": {ANY: [levels_in(f, label, part, to=to)[0] for f in flights]}
        for part in _BEFORE
        for name, label, to in (("", SIGMOID, ALARM), ("-raw", "lgmd", SEEN))
    }
    panels = [_levels("Group 1", flights[0], LGMDS)]
    return Evidence(values, {"fig1": partial(plot_panels, panels, "Frame", "Level")})


def roughness(result: Result, end: int, order: int = 2) -> float:
    """Mean absolute second difference of K / max K, up to a frame; or one of another order."""
    return float(np.abs(np.diff(share_of_peak(result)[:end], order)).mean())


def fig13(plan: Plan) -> Steps:
    """Three models in group 2, and in group 1; and set 9 with and without FFI-GD."""
    plain = all_versions(9, only=plan.versions, ffi_gd=False)
    models = _set9(plan) | _LGMDS
    models |= {f"{label}/raw": params for label, params in plain.items()}
    simple = [(*pair,) for pair in zip(*(clips_of(plan, n) for n in (4, 5)), strict=True)]
    needs = dict.fromkeys([*clips_of(plan, 1), *clips_of(plan, 2), *_CUBES], models)
    data = yield needs | dict.fromkeys(chain(*simple), _set9(plan) | _LGMD)
    values: dict[str, Values] = {}
    panels = []
    for group, suffix in ((2, ""), (1, "-chair")):
        flights = [data[clip] for clip in clips_of(plan, group)]
        values[f"fig13-silent{suffix}"] = _of_set9(flights, before, plan)
        others = {"lgmd": SIGMOID, "lgmd-raw": "lgmd", "emd": "emd-lgmd"}
        for name, label in others.items():
            values[f"fig13-{name}{suffix}"] = _of_other(flights, in_each, label)
        panels.append(_levels(f"Group {group}", flights[0], {**_LABELS, "emd-lgmd": "EMD-LGMD"}))
    flights = [data[clip] for clip in clips_of(plan, 2)]
    of = partial(_of_set9, flights, plan=plan)

    def advantage(other: str, flight: ClipResults, label: str) -> float:
        return before(flight, label) - before(flight, other)

    def complex_(version: str) -> list[float]:
        """The advantage in the cluttered room minus the mean of that in the simple ones."""
        of_version = partial(advantage, "lgmd", label=f"set9/{version}")
        others = [np.mean([of_version(data[clip]) for clip in pair]) for pair in simple]
        return [of_version(f) - float(other) for f, other in zip(flights, others, strict=True)]

    values |= {
        "fig13-advantage": of(partial(advantage, "lgmd")),
        "fig13-advantage~sigmoid": of(partial(advantage, SIGMOID)),
        "fig13-emd-advantage": of(partial(advantage, "emd-lgmd")),
        "fig13-emd-advantage~raw": of(lambda f, at: advantage("emd-lgmd", f, f"{at}/raw")),
        "fig13-complex": by_version(complex_, plan.versions),
        "fig13-pitching": {ANY: [math.nan]},
        "fig13-ffi-without": of(lambda flight, label: before(flight, f"{label}/raw")),
        "fig13-ffi-switch": of(_switched),
        "fig13-rises": of(_near),
        "fig13-rises~peak": of(_peak_near),
        "fig13-ffi-removes": of(_by_raw(_n_before)),
        "fig13-ffi-removes~sum": of(_by_raw(_sum_before)),
        "fig13-ffi-smooths": of(_by_raw(roughness)),
        "fig13-ffi-smooths~steps": of(_by_raw(partial(roughness, order=1))),
        "fig13-ffi-range": by_version(
            lambda v: [_ranges(data, plan, place, f"set9/{v}") for place in range(len(flights))],
            plan.versions,
        ),
        "fig13-ffi-range~contrasts": by_version(
            lambda v: [_ranges(data, plan, None, f"set9/{v}")], plan.versions
        ),
    }
    ffi = []
    for v in FEW:
        whole, kept = (flights[0].results[of].mp for of in (f"set9/{v}/raw", f"set9/{v}"))
        curves = {"with FFI-GD": positive(kept), "removed by it": positive(whole - kept)}
        ffi.append(_panel(v, flights[0], curves))
    figures = {
        "fig13": partial(plot_panels, panels, "Frame", "Level", share_y=False),
        "fig13-ffi": partial(plot_panels, ffi, "Frame", "Raw K", log_y=True),
    }
    return Evidence(values, figures)


def _near(flight: ClipResults, label: str) -> float:
    """The share of the sum of K up to contact that falls in the last frames before it."""
    first, end = phase(flight, "contact")
    mp = np.nan_to_num(flight.results[label].mp[: end + 1])
    return float(mp[first:].sum() / mp.sum()) if mp.any() else math.nan


def _peak_near(flight: ClipResults, label: str) -> float:
    """The greatest level before the window to contact; 1 is the peak."""
    return greatest(level(flight.results, label), 0, phase(flight, "contact")[0] - 1)


def _by_raw(measure: Callable[[Result, int], float]) -> Measure:
    """A measure up to contact with FFI-GD by that without; NaN if the latter is 0."""

    def share(flight: ClipResults, label: str) -> float:
        both = (flight.results[of] for of in (label, f"{label}/raw"))
        kept, raw = (measure(result, flight.collision_frame) for result in both)
        return kept / raw if raw else math.nan

    return share


def _n_before(result: Result, end: int) -> float:
    """The number of frames before the approach with K above 0."""
    return float(np.count_nonzero(result.mp[: end - frames("approach")] > 0))


def _sum_before(result: Result, end: int) -> float:
    """The sum of K before the approach."""
    return float(np.nansum(result.mp[: end - frames("approach")]))


# A cube that looms at three contrasts.
_CUBES = tuple(
    Clip.of("looming-cube", size=stimuli.SIZE, contrast=-contrast, background=1.0)
    for contrast in (1.0, 0.5, 0.25)
)


def _ranges(data: Data, plan: Plan, place: int | None, label: str) -> float:
    """The range of peaks over contrasts, and scenes of a seed, with FFI-GD by that without."""
    scenes = [data[clip] for clip in _CUBES]
    scenes += [] if place is None else [data[clips_of(plan, group)[place]] for group in (1, 2)]

    def range_of(label: str) -> float:
        peaks = [np.nanmax(one.results[label].mp[: one.collision_frame + 1]) for one in scenes]
        return float(ratio(max(peaks), min(peaks)))

    return float(ratio(range_of(label), range_of(f"{label}/raw")))


def _switched(flight: ClipResults, label: str) -> float:
    """What an FFI that silences the cell would leave of the response near contact."""
    result, ends = flight.results[label], phase(flight, "contact")
    k, ffi = np.nan_to_num(result.mp), np.roll(result.p_sum, 1) / result.n_cells
    switched = np.where(ffi > free("t_ffi") / 255.0, 0.0, k)
    left, whole = (greatest(response, *ends, frames(ALARM)) for response in (switched, k))
    return left / whole if whole else math.nan


_FIG_14_SETS = (3, 6, 7, 8)
# Lowest level in the figure.
_LOWEST = 1e-4


def fig14(plan: Plan) -> Steps:
    """Sets 3, 6, 7 and 8 while the drone pitches and brakes."""
    models = all_versions(*_FIG_14_SETS, only=plan.versions) | _LGMD
    models |= {f"set{n}r6/{v}": model(n, v, r=6) for n in (3, 6) for v in FEW}
    data = yield dict.fromkeys(clips_of(plan, 2), models)
    flights = [data[clip] for clip in clips_of(plan, 2)]

    def levels(version: str, part: str, *numbers: int, to: str = SEEN) -> Series:
        """The level in a part of each flight (rows) with each set (columns)."""
        labels = [f"set{n}/{version}" for n in numbers]
        return np.array([[levels_in(s, at, part, to=to)[0] for at in labels] for s in flights])

    def order(lower: int, higher: int, version: str) -> list[float]:
        """The level of one set minus that of the other in the same flight."""
        pairs = levels(version, "pitch", lower, higher)
        return [a - b if b >= free("to_compare") else math.nan for a, b in pairs]

    def worse(part: str, lgmd: str, version: str) -> list[float]:
        most = levels(version, part, *_FIG_14_SETS).max(axis=1)
        return (most - [levels_in(s, lgmd, part)[0] for s in flights]).tolist()

    def background(db: Callable[..., float], version: str) -> list[float]:
        """The attenuation in the pitch, set 8 minus set 7."""
        large, small = f"set8/{version}", f"set7/{version}"
        return [db(flight, large, "pitch") - db(flight, small, "pitch") for flight in flights]

    def drop(number: int | str, lowest: bool, version: str) -> list[float]:
        label = f"set{number}/{version}"
        return [_drop(flight.results[label], flight, lowest=lowest) for flight in flights]

    def wider(lowest: bool, version: str) -> list[float]:
        """The drop of sets 3 and 6 at r = 6 by that at r = 4, the mean of both."""
        drops = [drop(n, lowest, version) for n in ("3r6", "3", "6r6", "6")]
        return [float(np.mean([a / b, c / d])) for a, b, c, d in zip(*drops, strict=True)]

    of = partial(by_version, versions=plan.versions)
    values = {
        "fig14-radius": by_version(partial(wider, False), FEW),
        "fig14-radius~lowest": by_version(partial(wider, True), FEW),
        "fig14-background": of(partial(background, db_in)),
        "fig14-background~frames": of(partial(background, middle_db)),
        "fig14-answers": of(lambda v: levels(v, "pitch", 3, 7).min(axis=1).tolist()),
        "fig14-small": of(lambda v: levels(v, "pitch", 3, 7).max(axis=1).tolist()),
        "fig14-silent": of(lambda v: levels(v, "pitch", 6, 8).max(axis=1).tolist()),
        "fig14-order-6-3": of(partial(order, 6, 3)),
        "fig14-order-8-7": of(partial(order, 8, 7)),
        "fig14-lgmd": {ANY: [levels_in(f, SIGMOID, "pitch", to=ALARM)[0] for f in flights]},
        "fig14-detects": of(
            lambda v: levels(v, "contact", *_FIG_14_SETS, to=ALARM).min(axis=1).tolist()
        ),
    }
    for name, part in (("", "pitch"), ("-accelerating", "accelerate")):
        values[f"fig14-weaker{name}"] = of(partial(worse, part, "lgmd"))
        values[f"fig14-weaker{name}~sigmoid"] = of(partial(worse, part, SIGMOID))
    for n in _FIG_14_SETS:
        values[f"fig14-brake-set{n}"] = of(partial(drop, n, False))
        values[f"fig14-brake-set{n}~lowest"] = of(partial(drop, n, True))
    panels = []
    for v in FEW:
        labels = {f"set{n}/{v}": f"set {n}" for n in _FIG_14_SETS} | LGMDS
        curves = {text: level(flights[0].results, label) for label, text in labels.items()}
        floored = {text: np.maximum(curve, _LOWEST) for text, curve in curves.items()}
        panels.append(_panel(v, flights[0], floored, level=T_MP))
    return Evidence(values, {"fig14": partial(plot_panels, panels, "Frame", "Level", log_y=True)})


def _drop(result: Result, flight: ClipResults, *, lowest: bool) -> float:
    """Mean level after braking begins by that before; NaN if that is too low.

    With `lowest`, the lowest level after it by the highest before.
    """
    level, first, n = share_of_peak(result), flight.phases["decelerate"][0], frames("brake")
    before, after = level[first - n : first], level[first : first + n]
    if before.mean() < free("to_drop"):
        return math.nan
    return float(after.min() / before.max() if lowest else after.mean() / before.mean())


def small_peaks(level: Series, first: int, last: int) -> int:
    """The number of separate peaks of at least the onset, but below T_MP, between two frames."""
    shown = level[first : last + 1]
    is_peak = (shown[1:-1] > shown[:-2]) & (shown[1:-1] >= shown[2:])
    return int(np.count_nonzero(is_peak & (shown[1:-1] >= free("onset")) & (shown[1:-1] < T_MP)))


def _most_excited(flight: ClipResults, label: str, before: int) -> float:
    """The greatest sustained K by the number of cells until so many frames before contact."""
    result = flight.results[label]
    k = np.nan_to_num(result.mp) / result.n_cells
    return greatest(k, 0, flight.collision_frame - before, frames(ALARM))


def quietest(data: Data, plan: Plan, label: str) -> float:
    """The least mean excitation at which no flight of groups 1 to 3 alarms before its approach."""
    flights = [data[clip] for group in (1, 2, 3) for clip in clips_of(plan, group)]
    return max(_most_excited(flight, label, frames("approach")) for flight in flights)


def ratio(value: Any, other: Any) -> Any:
    """The ratio of two numbers or series; NaN where both are 0, or both infinite."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.divide(value, other)


def _calibration(plan: Plan) -> Needs:
    return {clip: _set9(plan) for group in (1, 2, 3) for clip in clips_of(plan, group)}


def approach(group: int, plan: Plan) -> Steps:
    """Fig. 15 (group 4) or Fig. 16 (group 5)."""
    data = yield _calibration(plan) | dict.fromkeys(clips_of(plan, group), _set9(plan) | _LGMD)
    flights, name = [data[clip] for clip in clips_of(plan, group)], f"fig{group + 11}"

    def causal(version: str) -> list[float]:
        label = f"set9/{version}"
        quiet = quietest(data, plan, label)
        return [float(ratio(_most_excited(flight, label, 0), quiet)) for flight in flights]

    def peaks(flight: ClipResults, label: str) -> float:
        shown = level(flight.results, label)
        return sum(small_peaks(shown, *phase(flight, part)) for part in _ATTITUDE)

    of_set9, of_other = partial(_of_set9, flights, plan=plan), partial(_of_other, flights)
    panels = [_levels(f"Group {group}", flights[0], _LABELS), _attenuation(flights[0])]
    values = {
        f"{name}-silent": of_set9(lambda flight, label: max(levels_in(flight, label, *_ATTITUDE))),
        f"{name}-detects": of_set9(contact),
        f"{name}-lgmd": of_other(contact, "lgmd"),
        f"{name}-causal": by_version(causal, plan.versions),
        f"{name}-lgmd-peaks": of_other(peaks, SIGMOID),
        f"{name}-lgmd-peaks-raw": of_other(peaks, "lgmd"),
    }
    for how, db in _DECIBELS.items():
        rise = partial(_rise, db)
        values |= {
            f"{name}-attenuates{how}": of_set9(partial(db, first=_ATTITUDE[0], last=_ATTITUDE[1])),
            f"{name}-accelerates{how}": of_set9(partial(db, first="accelerate")),
            f"{name}-rising{how}": of_set9(rise),
            f"{name}-stronger{how}": of_set9(partial(_beyond, rise)),
        }
    return Evidence(values, {name: partial(plot_panels, panels, "Frame", "Level", share_y=False)})


# How the attenuation over a span is read: pooled over its frames, or as their median.
_DECIBELS: dict[str, Callable[..., float]] = {"": db_in, "~frames": middle_db}


def _rise(db: Callable[..., float], flight: ClipResults, label: str) -> float:
    """The attenuation at contact minus that from take-off until the drone accelerates."""
    return db(flight, label, "contact") - db(flight, label, *_ATTITUDE)


def _beyond(rise: Measure, flight: ClipResults, label: str) -> float:
    """A rise minus that of the LGMD."""
    return rise(flight, label) - rise(flight, "lgmd")


def fig17(plan: Plan) -> Steps:
    """Set 9 while the drone yaws, and at contact."""
    data = yield dict.fromkeys(clips_of(plan, 3), _set9(plan) | _LGMD)
    flights = [data[clip] for clip in clips_of(plan, 3)]

    def opened(db: Callable[..., float], flight: ClipResults, label: str) -> float:
        """The attenuation at contact minus that in the yaw."""
        return db(flight, label, "contact") - db(flight, label, "yaw")

    of_set9 = partial(_of_set9, flights, plan=plan)
    values = {
        "fig17-silent": of_set9(lambda flight, label: levels_in(flight, label, "yaw")[0]),
        "fig17-answers": of_set9(contact),
    }
    for how, db in _DECIBELS.items():
        values[f"fig17-inhibits{how}"] = of_set9(partial(db, first="yaw"))
        values[f"fig17-opens{how}"] = of_set9(partial(opened, db))
    panels = [_levels("Group 3", flights[0], _LABELS), _attenuation(flights[0])]
    draw = partial(plot_panels, panels, "Frame", "Level", share_y=False)
    return Evidence(values, {"fig17": draw})


_LATERAL = Clip.of("translating-cubes", size=stimuli.SIZE, object_size=160.0, speed=12.0)


def lateral(plan: Plan) -> Steps:
    """The response to a large square that translates fast."""
    data = yield _calibration(plan) | {_LATERAL: _set9(plan)}
    results = data[_LATERAL].results

    def alarms(of: Callable[[Series], float], version: str) -> float:
        """The excitation by the least one at which the flights stay silent."""
        label = f"set9/{version}"
        k = results[label].mp / results[label].n_cells
        return float(ratio(of(k), quietest(data, plan, label)))

    curves = {v: (results[f"set9/{v}"].frame * 1.0, results[f"set9/{v}"].mp) for v in FEW}
    panel = Panel("Square of 160 px at 12 px/frame", curves)
    draw = partial(plot_panels, [panel], "Frame", "Raw K", log_y=True)
    values = {
        f"lateral-alarms{how}": by_version(partial(alarms, of), plan.versions)
        for how, of in (("", np.nanmedian), ("~greatest", np.nanmax))
    }
    return Evidence(values, {"lateral": draw})
