"""The exhibits with flights: the figures of groups 1 to 5, and Table IV."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np

from dlgmd_cli.lab import benchmark
from dlgmd_cli.lab.benchmark import RADII, SCALES, TABLE_IV_SET
from dlgmd_cli.lab.plots.panels import Panel, plot_panels
from dlgmd_cli.lab.reproduce.clips import (
    Clip,
    ClipResults,
    Models,
    all_formulations,
    model,
    other_models,
    run_clip,
)
from dlgmd_cli.lab.reproduce.plan import (
    ANY,
    TIMING,
    Data,
    Evidence,
    Exhibit,
    Needs,
    Plan,
    by_formulation,
)
from dlgmd_cli.lab.reproduce.stimuli import SIZE, mean_db, positive, share_of_peak
from dlgmd_cli.parameters import FORMULATIONS, load_set
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.results.result import Series
from dlgmd_cli.video.opening import open_video

_SET9, _LGMD = all_formulations("set9"), other_models("lgmd")
_LABELS = {**{f"set9/{f}": f"set 9, {f}" for f in FORMULATIONS}, "lgmd": "LGMD"}
# Length of the approach, and of the window before contact in which a model must respond.
APPROACH_FRAMES, CONTACT_FRAMES = 30, 15
# Phases in which a model must be silent.
_BEFORE = ("pitch", "accelerate")


def _flight(group: int, seed: int) -> Clip:
    return Clip.of(f"group{group}", size=SIZE, seed=seed)


def _needs(models: Models, *groups: int) -> Callable[[Plan], Needs]:
    """The models, which see the flights of some groups, one per seed."""
    return lambda plan: {_flight(group, seed): models for group in groups for seed in plan.seeds}


def sustained(level: Series, first: int, last: int, n_frames: int = 2) -> float:
    """The greatest level that `n_frames` successive frames reach, from `first` to `last`.

    There is an alarm if this reaches the threshold: an alarm needs as many successive spikes.
    """
    windows = np.lib.stride_tricks.sliding_window_view(level[first : last + 1], n_frames)
    return float(windows.min(axis=1).max())


def phase(flight: ClipResults, name: str) -> tuple[int, int]:
    """First and last frame of a phase, without the approach."""
    first, last = flight.phases[name]
    return first, max(first + 1, min(last, flight.collision_frame - APPROACH_FRAMES))


def level_in(flight: ClipResults, label: str, name: str) -> float:
    """The greatest sustained K, as a share of its peak, in a phase or in the window to contact."""
    end = flight.collision_frame
    window = (end - CONTACT_FRAMES, end) if name == "contact" else phase(flight, name)
    return sustained(share_of_peak(flight.results[label]), *window)


def _levels(flights: list[ClipResults], label: str, *parts: str) -> dict[str, list[float]]:
    """The greatest level in some parts of each flight; "{}" in the label is the formulation."""

    def most(label: str) -> list[float]:
        return [max(level_in(flight, label, part) for part in parts) for flight in flights]

    return by_formulation(lambda f: most(label.format(f))) if "{}" in label else {ANY: most(label)}


def _flights(plan: Plan, data: Data, group: int) -> list[ClipResults]:
    """The flights of a group; the first one is in the figures."""
    return [data[_flight(group, seed)] for seed in plan.seeds]


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


def _shares(title: str, flight: ClipResults, labels: dict[str, str]) -> Panel:
    """A panel of K as a share of its peak; `labels` maps labels of results to the legend's."""
    curves = {shown: share_of_peak(flight.results[label]) for label, shown in labels.items()}
    return _panel(title, flight, curves, level=0.4)


def fig1(plan: Plan, data: Data) -> Evidence:
    """The LGMD responds to the camera's own motion."""
    flights = _flights(plan, data, 1)
    panels = [_shares("Group 1", flights[0], {"lgmd": "LGMD"})]
    values = {f"fig1-{part}": _levels(flights, "lgmd", part) for part in _BEFORE}
    return Evidence(values, {"fig1": partial(plot_panels, panels, "Frame", "K / max K")})


_FIG_13 = {**_SET9, **other_models("lgmd", "emd-lgmd")}
_FIG_13B = _SET9 | {
    f"{label}/no-ffi-gd": one for label, one in all_formulations("set9", ffi_gd=False).items()
}


def fig13a(plan: Plan, data: Data) -> Evidence:
    """Three models in groups 1 and 2."""
    values, panels = {}, []
    for group in (1, 2):
        flights = _flights(plan, data, group)
        for claim, label in (("silent", "set9/{}"), ("lgmd", "lgmd"), ("emd", "emd-lgmd")):
            values[f"fig13a-{claim}-group{group}"] = _levels(flights, label, *_BEFORE)
        panels.append(_shares(f"Group {group}", flights[0], {**_LABELS, "emd-lgmd": "EMD-LGMD"}))
    draw = partial(plot_panels, panels, "Frame", "K / max K", share_y=False)
    return Evidence(values, {"fig13a": draw})


def fig13b(plan: Plan, data: Data) -> Evidence:
    """Set 9 with and without FFI-GD."""
    flights = _flights(plan, data, 1)

    def left(formulation: str) -> list[float]:
        """The share that FFI-GD leaves of the frames before the approach with K above 0."""
        label, found = f"set9/{formulation}", []
        for flight in flights:
            kept, n = (
                np.count_nonzero(
                    flight.results[of].mp[: flight.collision_frame - APPROACH_FRAMES] > 0
                )
                for of in (label, f"{label}/no-ffi-gd")
            )
            found.append(kept / n if n else math.nan)
        return found

    def panel(formulation: str) -> Panel:
        label = f"set9/{formulation}"
        raw = {"without FFI-GD": f"{label}/no-ffi-gd", "with FFI-GD": label}
        curves = {shown: positive(flights[0].results[of].mp) for shown, of in raw.items()}
        return _panel(formulation, flights[0], curves)

    panels = [panel(f) for f in FORMULATIONS]
    values = {
        "fig13b-removes": by_formulation(left),
        "fig13b-without": _levels(flights, "set9/{}/no-ffi-gd", *_BEFORE),
    }
    return Evidence(values, {"fig13b": partial(plot_panels, panels, "Frame", "Raw K", log_y=True)})


_FIG_14_SETS = (3, 6, 7, 8)
_FIG_14 = all_formulations(*(f"set{n}" for n in _FIG_14_SETS)) | _LGMD
_BRAKE_FRAMES = 10
# Least level before braking, as a share of the peak, whose drop is measured.
_TO_DROP = 0.05


def fig14(plan: Plan, data: Data) -> Evidence:
    """Sets 3, 6, 7 and 8 while the drone pitches and brakes."""
    flights = _flights(plan, data, 2)

    def pitch(formulation: str, *numbers: int) -> Series:
        """The level in the pitch of each flight (rows) with each set (columns)."""
        labels = [f"set{n}/{formulation}" for n in numbers]
        return np.array([[level_in(s, label, "pitch") for label in labels] for s in flights])

    def order(formulation: str) -> list[float]:
        most, least = pitch(formulation, 6, 8).max(axis=1), pitch(formulation, 3, 7).min(axis=1)
        return [a / b if b > 0.0 else math.nan for a, b in zip(most, least, strict=True)]

    def worse(formulation: str) -> list[float]:
        most = pitch(formulation, *_FIG_14_SETS).max(axis=1)
        return (most / [level_in(s, "lgmd", "pitch") for s in flights]).tolist()

    def drop(number: int, formulation: str) -> list[float]:
        """Mean level after braking begins, divided by that before; NaN if that is too low."""
        found = []
        for flight in flights:
            level = share_of_peak(flight.results[f"set{number}/{formulation}"])
            first = flight.phases["decelerate"][0]
            before = float(level[first - _BRAKE_FRAMES : first].mean())
            after = float(level[first : first + _BRAKE_FRAMES].mean())
            found.append(after / before if before >= _TO_DROP else math.nan)
        return found

    values = {
        "fig14a-answers": by_formulation(lambda f: pitch(f, 3, 7).min(axis=1).tolist()),
        "fig14a-silent": by_formulation(lambda f: pitch(f, 6, 8).max(axis=1).tolist()),
        "fig14a-order": by_formulation(order),
        "fig14a-lgmd": by_formulation(worse),
        "fig14b-set3": by_formulation(partial(drop, 3)),
        "fig14b-set6": by_formulation(partial(drop, 6)),
    }
    shown = {f: {f"set{n}/{f}": f"set {n}" for n in _FIG_14_SETS} for f in FORMULATIONS}
    panels = [_shares(f, flights[0], {**own, "lgmd": "LGMD"}) for f, own in shown.items()]
    return Evidence(values, {"fig14": partial(plot_panels, panels, "Frame", "K / max K")})


_FIG_15 = {**_SET9, **_LGMD}


def _approach(group: int, name: str, plan: Plan, data: Data) -> Evidence:
    """Fig. 15 (group 4) or Fig. 16 (group 5)."""
    flights = _flights(plan, data, group)

    def flying(flight: ClipResults, label: str) -> float:
        """Mean attenuation from take-off until the drone accelerates."""
        first, last = flight.phases["take off"][0], flight.phases["accelerate"][0] - 1
        return mean_db(flight.results[label], first, last)

    def rise(flight: ClipResults, label: str) -> float:
        end = flight.collision_frame
        return mean_db(flight.results[label], end - CONTACT_FRAMES, end) - flying(flight, label)

    def causal(flight: ClipResults, label: str) -> float:
        return sustained(np.nan_to_num(flight.results[label].mp_abs), 0, flight.collision_frame)

    def of_set9(measure: Callable[[ClipResults, str], float]) -> dict[str, list[float]]:
        return by_formulation(lambda f: [measure(flight, f"set9/{f}") for flight in flights])

    found = {shown: flights[0].results[of].attenuation_db for of, shown in _LABELS.items()}
    db = {shown: np.maximum(values, FLOOR_DB) for shown, values in found.items()}
    panels = [
        _shares(f"Group {group}: K / max K", flights[0], _LABELS),
        _panel("Attenuation", flights[0], db, y_label="dB"),
    ]
    values = {
        f"{name}-attenuates": of_set9(flying),
        f"{name}-rising": of_set9(rise),
        f"{name}-detects": _levels(flights, "set9/{}", "contact"),
        f"{name}-causal": of_set9(causal),
        f"{name}-lgmd": _levels(flights, "lgmd", "contact"),
    }
    draw = partial(plot_panels, panels, "Frame", "K / max K", share_y=False)
    return Evidence(values, {name: draw})


def fig17(plan: Plan, data: Data) -> Evidence:
    """Set 9 while the drone yaws, and at contact."""
    flights = _flights(plan, data, 3)
    panels = [_shares("Group 3", flights[0], _LABELS)]
    values = {
        "fig17-silent": _levels(flights, "set9/{}", "yaw"),
        "fig17-answers": _levels(flights, "set9/{}", "contact"),
    }
    return Evidence(values, {"fig17": partial(plot_panels, panels, "Frame", "K / max K")})


BEST_SCALE = 0.25


def _scales(plan: Plan) -> tuple[float, ...]:
    """The scales of Table IV relative to 1920x1080; a quick report leaves out the full scale."""
    return SCALES[1:] if plan.quick else SCALES


def _da_name(formulation: str, seed: int) -> str:
    return f"table4, {formulation}, seed {seed}"


def _point(radius: int, scale: float) -> str:
    return f"r{radius}/x{scale:g}"


def _da_needs(plan: Plan) -> Needs:
    # One call per formulation, to run in parallel: rendering the clip again costs less than a
    # model. Two seeds at most.
    needs, scales = {}, _scales(plan)
    shrunk = {_point(r, x): x / scales[0] for r in RADII for x in scales}
    width, height = (round(side * scales[0]) for side in benchmark.PAPER_SIZE_WH)
    for seed in plan.seeds[:2]:
        clip = Clip.of("group2", size=(height, width), seed=seed)
        for f in FORMULATIONS:
            by_radius = {r: model(f"set{TABLE_IV_SET}", f, r=r) for r in RADII}
            models = {_point(r, x): by_radius[r] for r in RADII for x in scales}
            needs[_da_name(f, seed)] = partial(run_clip, clip, models, shrunk)
    return needs


def distinguishability(flight: ClipResults, label: str) -> float:
    """DA with the middle of the pitch as the false positive; 0 if the model never responds."""
    first, last = flight.phases["pitch"]
    found = flight.results[label].distinguishability((first + last) // 2)
    return 0.0 if math.isnan(found) else found


def table4_da(plan: Plan, data: Data) -> Evidence:
    """The distinguishability by radius and scale, as in Table IV."""
    scales = _scales(plan)

    def da(flight: ClipResults) -> Series:
        """DA by radius (rows) and scale; infinite where the model is silent at the pitch."""
        return np.array([[distinguishability(flight, _point(r, x)) for x in scales] for r in RADII])

    tables = {f: [da(data[_da_name(f, n)]) for n in plan.seeds[:2]] for f in FORMULATIONS}
    at_best = scales.index(BEST_SCALE)

    def best(table: Series) -> float:
        others = np.delete(table, at_best, axis=1).max(axis=1)
        return min(map(_ratio, table[:, at_best], others))

    def rising(table: Series) -> float:
        return min(map(_ratio, table[:-1].ravel(), table[1:].ravel()))

    def of(measure: Callable[[Series], float]) -> dict[str, list[float]]:
        return by_formulation(lambda f: [measure(table) for table in tables[f]])

    def panel(formulation: str) -> Panel:
        table = tables[formulation][0]
        shown = np.where(np.isfinite(table) & (table > 0.0), table, np.nan)
        curves = {f"r = {r}": (np.array(scales), shown[row]) for row, r in enumerate(RADII)}
        return Panel(formulation, curves, level=1.0)

    panels = [panel(f) for f in FORMULATIONS]
    draw = partial(plot_panels, panels, "Scale", "Distinguishability DA", dots=True)
    values = {
        "table4-da-above-1": of(lambda table: float(np.min(table))),
        "table4-da-above-10": of(lambda table: float(np.min(table[:, at_best]))),
        "table4-da-best": of(best),
        "table4-da-rising": of(rising),
    }
    rows = [
        (r, x, benchmark.PAPER_DA[r, x], *(float(tables[f][0][row, column]) for f in FORMULATIONS))
        for row, r in enumerate(RADII)
        for column, x in enumerate(scales)
    ]
    return Evidence(values, {"table4-da": partial(draw, log_x=True, log_y=True)}, rows)


def _ratio(one: float, other: float) -> float:
    """The ratio of two DA; 1 if both are infinite, or both 0."""
    if math.isinf(one) and math.isinf(other):
        return 1.0
    if other == 0.0:
        return 1.0 if one == 0.0 else math.inf
    return float(one / other)


_CORNERS = ((6, 1.0), (6, 0.25), (2, 0.02))


def _time_needs(plan: Plan) -> Needs:
    return {f"{TIMING}, {f}": partial(time_model, f, quick=plan.quick) for f in FORMULATIONS}


def time_model(formulation: str, *, quick: bool) -> list[dict[str, Any]]:
    """The rows of `dlgmd bench`; if `quick`, only three combinations of radius and scale."""
    params, rows = load_set(TABLE_IV_SET, formulation=formulation), []
    points = [((r,), (x,)) for r, x in _CORNERS] if quick else [(RADII, SCALES)]
    with benchmark.rendered_pan(24 if quick else 48) as path:
        for radii, scales in points:
            open_at = partial(open_video, path)
            rows += benchmark.measure(open_at, params, radii=radii, scales=scales)["rows"]
    return rows


def table4_time(plan: Plan, data: Data) -> Evidence:
    """The computing times by radius and scale, as in Table IV."""
    timed = {f: data[f"{TIMING}, {f}"] for f in FORMULATIONS}

    def paper_s(row: Mapping[str, Any]) -> float:
        return benchmark.PAPER_S[row["radius"], row["scale"]]

    values = by_formulation(lambda f: min(paper_s(row) / row["whole_s"] for row in timed[f]))
    rows = [
        (same[0]["radius"], same[0]["scale"], paper_s(same[0]), *(one["whole_s"] for one in same))
        for same in zip(*timed.values(), strict=True)
    ]
    return Evidence({"table4-time": values}, table=rows)


EXHIBITS = {
    "fig1": Exhibit(_needs(_LGMD, 1), fig1),
    "fig13a": Exhibit(_needs(_FIG_13, 1, 2), fig13a),
    "fig13b": Exhibit(_needs(_FIG_13B, 1), fig13b),
    "fig14": Exhibit(_needs(_FIG_14, 2), fig14),
    "fig15": Exhibit(_needs(_FIG_15, 4), partial(_approach, 4, "fig15")),
    "fig16": Exhibit(_needs(_FIG_15, 5), partial(_approach, 5, "fig16")),
    "fig17": Exhibit(_needs(_FIG_15, 3), fig17),
    "table4-da": Exhibit(_da_needs, table4_da),
    "table4-time": Exhibit(_time_needs, table4_time),
}
