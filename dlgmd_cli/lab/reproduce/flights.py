"""The exhibits with flights: the figures of groups 1 to 5, and Table IV."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from dlgmd_cli.lab import benchmark
from dlgmd_cli.lab.benchmark import RADII, SCALES, TABLE_IV_SET
from dlgmd_cli.lab.plots.panels import Panel, plot_panels
from dlgmd_cli.lab.reproduce.clips import (
    EVERY,
    LATE,
    NULLS,
    VERSIONS,
    Clip,
    ClipResults,
    Models,
    all_versions,
    model,
    other_models,
    run_clip,
)
from dlgmd_cli.lab.reproduce.plan import ANY, TIMING, Evidence, Exhibit, Plan, by_version
from dlgmd_cli.lab.reproduce.stimuli import (
    FEW,
    LGMDS,
    ONSET,
    SIGMOID,
    TWO,
    Steps,
    level,
    mean_db,
    positive,
    share_of_peak,
    sigmoid,
)
from dlgmd_cli.parameters import load_set
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.video.opening import open_video

_SET9, _LGMD = all_versions("set9"), other_models("lgmd")
_LABELS = {f"set9/{v}": f"set 9, {v}" for v in TWO} | LGMDS
# Length of the approach, and of the window before contact in which a model must respond.
APPROACH_FRAMES, CONTACT_FRAMES = 30, 15
# The threshold of a spike.
T_MP = 0.4
# Phases in which a model must be silent.
_BEFORE = ("pitch", "accelerate")
# Measures a model, given by its label, in one flight.
Measure = Callable[[ClipResults, str], float]
# Group 2 is that of Fig. 14, with its brakes at the paper's frame.
_SCENES = {1: "group1", 2: LATE, 3: "group3", 4: "group4", 5: "group5"}


def _clips(plan: Plan, group: int) -> list[Clip]:
    """The flights of a group, one per seed; the first one is in the figures."""
    return [Clip.of(_SCENES[group], size=plan.flight_size, seed=seed) for seed in plan.seeds]


def sustained(level: Series, first: int, last: int) -> float:
    """The greatest level that two successive frames reach, from `first` to `last`.

    There is an alarm if this reaches the threshold: an alarm needs as many successive spikes.
    """
    return float(np.minimum(level[first:last], level[first + 1 : last + 1]).max())


def phase(flight: ClipResults, name: str) -> tuple[int, int]:
    """First and last frame of a phase without the approach, or of the window to contact."""
    end = flight.collision_frame
    if name == "contact":
        return end - CONTACT_FRAMES, end
    first, last = flight.phases[name]
    return first, max(first + 1, min(last, end - APPROACH_FRAMES))


def level_in(flight: ClipResults, label: str, *parts: str) -> float:
    """The greatest sustained level in some phases, or in the window to contact."""
    shown = level(flight.results, label)
    return max(sustained(shown, *phase(flight, part)) for part in parts)


def before(flight: ClipResults, label: str) -> float:
    """The level in the phases before the approach."""
    return level_in(flight, label, *_BEFORE)


def contact(flight: ClipResults, label: str) -> float:
    """The level in the window to contact."""
    return level_in(flight, label, "contact")


def _of_set9(flights: list[ClipResults], measure: Measure) -> dict[str, list[float]]:
    return by_version(lambda v: [measure(flight, f"set9/{v}") for flight in flights])


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


def _panel(title: str, flight: ClipResults, curves: dict[str, Series], **more: Any) -> Panel:
    frame = np.arange(flight.collision_frame + 1.0)
    shown = {label: (frame, values[: len(frame)]) for label, values in curves.items()}
    return Panel(title, shown, _spans(flight), float(flight.collision_frame), **more)


def _levels(title: str, flight: ClipResults, labels: dict[str, str]) -> Panel:
    """A panel of levels; `labels` maps labels of results to the legend's."""
    curves = {shown: level(flight.results, label) for label, shown in labels.items()}
    return _panel(title, flight, curves, level=T_MP)


def _attenuation(flight: ClipResults) -> Panel:
    """A panel of the attenuation of set 9 and the LGMD."""
    found = {
        shown: np.maximum(flight.results[label].attenuation_db, FLOOR_DB)
        for label, shown in _LABELS.items()
        if label in flight.results
    }
    return _panel("Attenuation", flight, found, y_label="dB")


def fig1(plan: Plan) -> Steps:
    """The LGMD responds to the camera's own motion."""
    data = yield dict.fromkeys(_clips(plan, 1), _LGMD)
    flights = [data[clip] for clip in _clips(plan, 1)]
    values = {
        f"fig1-{part}{name}": {ANY: [level_in(flight, label, part) for flight in flights]}
        for part in _BEFORE
        for name, label in (("", SIGMOID), ("-raw", "lgmd"))
    }
    panels = [_levels("Group 1", flights[0], LGMDS)]
    return Evidence(values, {"fig1": partial(plot_panels, panels, "Frame", "Level")})


def roughness(result: Result, end: int) -> float:
    """Mean absolute second difference of K / max K, up to a frame."""
    return float(np.abs(np.diff(share_of_peak(result)[:end], 2)).mean())


def fig13(plan: Plan) -> Steps:
    """Three models in groups 1 and 2; and set 9 with and without FFI-GD in group 1."""
    raw = {f"{label}/raw": one for label, one in all_versions("set9", ffi_gd=False).items()}
    models = _SET9 | other_models("lgmd", "emd-lgmd")
    data = yield dict.fromkeys(_clips(plan, 1), models | raw) | dict.fromkeys(
        _clips(plan, 2), models
    )
    values, panels = {}, []
    for group in (1, 2):
        flights = [data[clip] for clip in _clips(plan, group)]
        values[f"fig13-silent-group{group}"] = _of_set9(flights, before)
        others = {"lgmd": SIGMOID, "lgmd-raw": "lgmd", "emd": "emd-lgmd"}
        for name, label in others.items():
            values[f"fig13-{name}-group{group}"] = _of_other(flights, before, label)
        labels = {**_LABELS, "emd-lgmd": "EMD-LGMD"}
        panels.append(_levels(f"Group {group}", flights[0], labels))
    flights = [data[clip] for clip in _clips(plan, 1)]

    def near(flight: ClipResults, label: str) -> float:
        """The share of the sum of K up to contact that falls in the last frames before it."""
        first, end = phase(flight, "contact")
        mp = np.nan_to_num(flight.results[label].mp[: end + 1])
        return float(mp[first:].sum() / mp.sum()) if mp.any() else math.nan

    def left(flight: ClipResults, label: str) -> float:
        """The share that FFI-GD leaves of the frames before the approach with K above 0."""
        end = flight.collision_frame - APPROACH_FRAMES
        kept, n = (
            np.count_nonzero(flight.results[of].mp[:end] > 0) for of in (label, f"{label}/raw")
        )
        return kept / n if n else math.nan

    def smoother(flight: ClipResults, label: str) -> float:
        kept, raw = (
            roughness(flight.results[of], flight.collision_frame) for of in (label, f"{label}/raw")
        )
        return kept / raw if raw else math.nan

    values |= {
        "fig13-rises": _of_set9(flights, near),
        "fig13-ffi-removes": _of_set9(flights, left),
        "fig13-ffi-smooths": _of_set9(flights, smoother),
        "fig13-ffi-without": _of_set9(flights, lambda one, label: before(one, f"{label}/raw")),
    }
    ffi = []
    for v in FEW:
        without, kept = (flights[0].results[of].mp for of in (f"set9/{v}/raw", f"set9/{v}"))
        curves = {"with FFI-GD": positive(kept), "removed by it": positive(without - kept)}
        ffi.append(_panel(v, flights[0], curves))
    figures = {
        "fig13": partial(plot_panels, panels, "Frame", "Level", share_y=False),
        "fig13-ffi": partial(plot_panels, ffi, "Frame", "Raw K", log_y=True),
    }
    return Evidence(values, figures)


_FIG_14_SETS = (3, 6, 7, 8)
_BRAKE_FRAMES = 10
# Least level before braking whose drop is measured, and in the pitch that is compared; as shares of
# the peak.
_TO_DROP, _TO_COMPARE = 0.05, 0.001
# Lowest level in the figure.
_LOWEST = 1e-4


def fig14(plan: Plan) -> Steps:
    """Sets 3, 6, 7 and 8 while the drone pitches and brakes."""
    models = all_versions(*(f"set{n}" for n in _FIG_14_SETS)) | _LGMD
    data = yield dict.fromkeys(_clips(plan, 2), models)
    flights = [data[clip] for clip in _clips(plan, 2)]

    def levels(version: str, part: str, *numbers: int) -> Series:
        """The level in a part of each flight (rows) with each set (columns)."""
        labels = [f"set{n}/{version}" for n in numbers]
        return np.array([[level_in(s, label, part) for label in labels] for s in flights])

    def order(lower: int, higher: int, version: str) -> list[float]:
        pairs = levels(version, "pitch", lower, higher)
        return [a / b if b >= _TO_COMPARE else math.nan for a, b in pairs]

    def worse(version: str) -> list[float]:
        most = levels(version, "pitch", *_FIG_14_SETS).max(axis=1)
        return (most / [level_in(s, SIGMOID, "pitch") for s in flights]).tolist()

    def drop(number: int, version: str) -> list[float]:
        """Mean level after braking begins, divided by that before; NaN if that is too low."""
        found = []
        for flight in flights:
            level = share_of_peak(flight.results[f"set{number}/{version}"])
            first = flight.phases["decelerate"][0]
            before = float(level[first - _BRAKE_FRAMES : first].mean())
            after = float(level[first : first + _BRAKE_FRAMES].mean())
            found.append(after / before if before >= _TO_DROP else math.nan)
        return found

    def worst(part: str, *numbers: int) -> dict[str, list[float]]:
        return by_version(lambda v: levels(v, part, *numbers).min(axis=1).tolist())

    values = {
        "fig14a-answers": worst("pitch", 3, 7),
        "fig14a-silent": by_version(lambda v: levels(v, "pitch", 6, 8).max(axis=1).tolist()),
        "fig14a-order-6-3": by_version(partial(order, 6, 3)),
        "fig14a-order-8-7": by_version(partial(order, 8, 7)),
        "fig14a-weaker": by_version(worse),
        "fig14a-lgmd": {ANY: [level_in(flight, SIGMOID, "pitch") for flight in flights]},
        "fig14-detects": worst("contact", *_FIG_14_SETS),
    }
    values |= {f"fig14b-set{n}": by_version(partial(drop, n)) for n in _FIG_14_SETS}
    shown = {v: {f"set{n}/{v}": f"set {n}" for n in _FIG_14_SETS} for v in FEW}
    panels = []
    for v, own in shown.items():
        labels = {**own, SIGMOID: LGMDS[SIGMOID]}
        curves = {text: level(flights[0].results, label) for label, text in labels.items()}
        floored = {text: np.maximum(one, _LOWEST) for text, one in curves.items()}
        panels.append(_panel(v, flights[0], floored, level=T_MP))
    draw = partial(plot_panels, panels, "Frame", "Level", log_y=True)
    return Evidence(values, {"fig14": draw})


def small_peaks(level: Series, end: int) -> int:
    """The number of separate peaks of at least `ONSET`, but below T_MP, up to a frame."""
    before = level[:end]
    is_peak = (before[1:-1] > before[:-2]) & (before[1:-1] >= before[2:])
    return int(np.count_nonzero(is_peak & (before[1:-1] >= ONSET) & (before[1:-1] < T_MP)))


def _approach(group: int, plan: Plan) -> Steps:
    """Fig. 15 (group 4) or Fig. 16 (group 5)."""
    data = yield dict.fromkeys(_clips(plan, group), _SET9 | _LGMD)
    flights, name = [data[clip] for clip in _clips(plan, group)], f"fig{group + 11}"

    def flying(flight: ClipResults, label: str) -> float:
        """Mean attenuation from take-off until the drone accelerates."""
        first, last = flight.phases["take off"][0], flight.phases["accelerate"][0] - 1
        return mean_db(flight.results[label], first, last)

    def weaker(flight: ClipResults, label: str) -> float:
        return flying(flight, label) - flying(flight, "lgmd")

    def rise(flight: ClipResults, label: str) -> float:
        return mean_db(flight.results[label], *phase(flight, "contact")) - flying(flight, label)

    def causal(flight: ClipResults, label: str) -> float:
        return sustained(np.nan_to_num(flight.results[label].mp_abs), 0, flight.collision_frame)

    def peaks(flight: ClipResults, label: str) -> float:
        return small_peaks(level(flight.results, label), flight.collision_frame - APPROACH_FRAMES)

    of_set9, of_other = partial(_of_set9, flights), partial(_of_other, flights)
    panels = [_levels(f"Group {group}", flights[0], _LABELS), _attenuation(flights[0])]
    values = {
        f"{name}-attenuates": of_set9(flying),
        f"{name}-stronger": of_set9(weaker),
        f"{name}-rising": of_set9(rise),
        f"{name}-detects": of_set9(contact),
        f"{name}-causal": of_set9(causal),
        f"{name}-lgmd": of_other(contact, "lgmd"),
        f"{name}-lgmd-peaks": of_other(peaks, SIGMOID),
        f"{name}-lgmd-peaks-raw": of_other(peaks, "lgmd"),
    }
    return Evidence(values, {name: partial(plot_panels, panels, "Frame", "Level", share_y=False)})


def fig17(plan: Plan) -> Steps:
    """Set 9 while the drone yaws, and at contact."""
    data = yield dict.fromkeys(_clips(plan, 3), _SET9 | _LGMD)
    flights = [data[clip] for clip in _clips(plan, 3)]

    def opened(flight: ClipResults, label: str) -> float:
        """The attenuation at contact minus that in the yaw."""
        at_contact, turning = (
            mean_db(flight.results[label], *phase(flight, part)) for part in ("contact", "yaw")
        )
        return at_contact - turning

    values = {
        "fig17-silent": _of_set9(flights, lambda one, label: level_in(one, label, "yaw")),
        "fig17-answers": _of_set9(flights, contact),
        "fig17-db": _of_set9(flights, opened),
    }
    panels = [_levels("Group 3", flights[0], _LABELS), _attenuation(flights[0])]
    draw = partial(plot_panels, panels, "Frame", "Level", share_y=False)
    return Evidence(values, {"fig17": draw})


BEST_SCALE = 0.25
# Versions of Table IV that share a rendering.
_TOGETHER = 4
# Where a figure draws an infinite DA, and one of 0.
_INFINITE, _ZERO = 1e6, 1e-2


def false_positive(flight: ClipResults) -> int:
    """The frame of the LGMD's first false peak: the first that reaches T_MP before the approach.

    If none does, the frame of its highest level there.
    """
    first, end = phase(flight, "pitch")[0], flight.collision_frame - APPROACH_FRAMES
    shown = sigmoid(flight.results["lgmd"])[first - 1 : end]
    is_peak = (shown[1:-1] >= shown[:-2]) & (shown[1:-1] >= shown[2:]) & (shown[1:-1] >= T_MP)
    return int(first + (np.argmax(is_peak) if is_peak.any() else np.argmax(shown[1:-1])))


def _point(radius: int, scale: float, version: str) -> str:
    return f"r{radius}/x{scale:g}/{version}"


def table4_da(plan: Plan) -> Steps:
    """The distinguishability by radius and scale, as in Table IV."""
    # A quick report leaves out the full scale.
    scales = SCALES[1:] if plan.quick else SCALES
    lgmd = dict.fromkeys(_clips(plan, 1), _LGMD)
    width, height = (round(side * scales[0]) for side in benchmark.PAPER_SIZE_WH)

    def call(seed: int, versions: tuple[str, ...]) -> Callable[[], ClipResults]:
        models: Models = {}
        for v in versions:
            own = {r: model(f"set{TABLE_IV_SET}", v, r=r) for r in RADII}
            models |= {_point(r, x, v): own[r] for r in RADII for x in scales}
        shrunk = {_point(r, x, v): x / scales[0] for v in versions for r in RADII for x in scales}
        return partial(run_clip, Clip.of("group1", size=(height, width), seed=seed), models, shrunk)

    calls = {
        f"table4, {', '.join(some)}, seed {seed}": (seed, some)
        for seed in plan.seeds
        for some in (EVERY[i : i + _TOGETHER] for i in range(0, len(EVERY), _TOGETHER))
    }
    data = yield lgmd | {name: call(*one) for name, one in calls.items()}
    tables: dict[str, list[Series]] = {v: [] for v in EVERY}
    for name, (seed, some) in calls.items():
        frame = false_positive(data[_clips(plan, 1)[plan.seeds.index(seed)]])
        for v in some:
            results = data[name].results
            found = [[_da(results[_point(r, x, v)], frame) for x in scales] for r in RADII]
            tables[v].append(np.array(found))
    at_best = scales.index(BEST_SCALE)

    def best(table: Series) -> float:
        others = np.delete(table, at_best, axis=1).max(axis=1)
        return min(map(_ratio, table[:, at_best], others))

    def smaller(table: Series) -> float:
        """DA of a smaller input by that of the next larger one, down to the best scale."""
        return min(map(_ratio, table[:, 1 : at_best + 1].ravel(), table[:, :at_best].ravel()))

    def rising(table: Series) -> float:
        ratios = map(_ratio, table[:-1].ravel(), table[1:].ravel())
        return float(np.mean([one >= 1.0 for one in ratios]))

    def turning(table: Series) -> float:
        """The share of radii whose DA rises and then falls as the input gets smaller."""
        peaks = table.argmax(axis=1)
        found = [
            0 < peak < len(scales) - 1
            and all(a <= b for a, b in pairwise(row[: peak + 1]))
            and all(a >= b for a, b in pairwise(row[peak:]))
            for row, peak in zip(table, peaks, strict=True)
        ]
        return float(np.mean(found))

    paper = np.array([[benchmark.PAPER_DA[r, x] for x in scales] for r in RADII])

    def apart(table: Series) -> float:
        """The median factor between ours and the paper's, where both are measured."""
        known = np.isfinite(table) & (table > 0.0) & (paper < benchmark.MOST_DA)
        return float(np.exp(np.median(np.abs(np.log(table[known] / paper[known])))))

    def at_full_scale(table: Series) -> float:
        """DA at r = 2."""
        return math.nan if plan.quick else float(table[RADII.index(2), 0])

    def of(measure: Callable[[Series], float]) -> dict[str, list[float]]:
        return by_version(lambda v: [measure(table) for table in tables[v]])

    def panel(title: str, table: Series) -> Panel:
        shown = np.clip(table, _ZERO, _INFINITE)
        curves = {f"r = {r}": (np.array(scales), shown[row]) for row, r in enumerate(RADII)}
        return Panel(title, curves, level=1.0)

    panels = [panel("the paper", paper), *(panel(v, tables[v][0]) for v in VERSIONS)]
    draw = partial(plot_panels, panels, "Scale", "DA", dots=True, log_x=True, log_y=True)
    values = {
        "table4-da-above-1": of(lambda table: float(np.min(table))),
        "table4-da-above-10": of(lambda table: float(np.min(table[:, at_best]))),
        "table4-da-best": of(best),
        "table4-da-rising": of(rising),
        "table4-da-smaller": of(smaller),
        "table4-da-turns": of(turning),
        "table4-da-r2": of(at_full_scale),
        "table4-da-apart": of(apart),
    }
    rows: list[tuple[Any, ...]] = [("r", "scale", "paper", *VERSIONS, "a = 0")]
    names = (*VERSIONS, NULLS["default"])
    rows += [
        (r, x, shown_da(paper[row, column]), *(float(tables[v][0][row, column]) for v in names))
        for row, r in enumerate(RADII)
        for column, x in enumerate(scales)
    ]
    return Evidence(values, {"table4-da": draw}, rows)


def shown_da(value: float) -> str | float:
    """The paper's DA, as it prints it where it gives a bound alone."""
    return ">10000" if value == benchmark.MOST_DA else value


def _da(result: Result, false_positive_frame: int) -> float:
    """DA; 0 if the model never responds."""
    found = result.distinguishability(false_positive_frame)
    return 0.0 if math.isnan(found) else found


def _ratio(one: float, other: float) -> float:
    """The ratio of two DA; 1 if both are infinite, or both 0."""
    if math.isinf(one) and math.isinf(other):
        return 1.0
    if other == 0.0:
        return 1.0 if one == 0.0 else math.inf
    return float(one / other)


_CORNERS = ((6, 1.0), (6, 0.25), (2, 0.02))
# Versions that are timed: the fastest, and the slowest.
_TIMED = ("default", "equations")


def time_model(version: str, *, quick: bool) -> list[dict[str, Any]]:
    """The rows of `dlgmd bench`; if `quick`, only three combinations of radius and scale."""
    params, rows = load_set(TABLE_IV_SET, **VERSIONS[version]), []
    points = [((r,), (x,)) for r, x in _CORNERS] if quick else [(RADII, SCALES)]
    with benchmark.rendered_pan(24 if quick else 48) as path:
        for radii, scales in points:
            open_at = partial(open_video, path)
            rows += benchmark.measure(open_at, params, radii=radii, scales=scales)["rows"]
    return rows


def table4_time(plan: Plan) -> Steps:
    """The computing times by radius and scale, as in Table IV."""
    data = yield {f"{TIMING}, {v}": partial(time_model, v, quick=plan.quick) for v in _TIMED}
    timed = {v: data[f"{TIMING}, {v}"] for v in _TIMED}

    def paper_s(row: Mapping[str, Any]) -> float:
        return benchmark.PAPER_S[row["radius"], row["scale"]]

    def slowest(version: str) -> float:
        if not plan.is_idle:
            return math.nan
        return min(paper_s(row) / row["whole_s"] for row in timed[version])

    rows: list[tuple[Any, ...]] = [("r", "scale", "paper, s", *(f"{v}, s" for v in _TIMED))]
    rows += [
        (same[0]["radius"], same[0]["scale"], paper_s(same[0]), *(one["whole_s"] for one in same))
        for same in zip(*timed.values(), strict=True)
    ]
    return Evidence({"table4-time": by_version(slowest, _TIMED)}, table=rows)


EXHIBITS: dict[str, Exhibit] = {
    "fig1": fig1,
    "fig13": fig13,
    "fig14": fig14,
    "fig15": partial(_approach, 4),
    "fig16": partial(_approach, 5),
    "fig17": fig17,
    "table4-da": table4_da,
    "table4-time": table4_time,
}
