"""The exhibits with flights: the figures of groups 1 to 5, and Table IV."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from dlgmd_cli.lab.benchmark import (
    PAPER_DA,
    PAPER_S,
    PAPER_SIZE_WH,
    RADII,
    SCALES,
    measure,
    rendered_pan,
)
from dlgmd_cli.lab.reproduce.clips import (
    Clip,
    ClipResults,
    Job,
    ModelSpec,
    all_formulations,
    model,
    other_models,
    run_clip,
)
from dlgmd_cli.lab.reproduce.plan import (
    ANY,
    Data,
    Exhibit,
    Figures,
    Plan,
    Values,
    by_formulation,
    clip_jobs,
)
from dlgmd_cli.lab.reproduce.stimuli import mean_db, share_of_peak
from dlgmd_cli.parameters import FORMULATIONS, DlgmdParameters
from dlgmd_cli.plots.panels import Panel, plot_panels
from dlgmd_cli.results.result import Series
from dlgmd_cli.video.opening import open_video

SIZE = (270, 480)
FIGURE_SEED = 0
_SET9 = all_formulations("set9")
_LABELS = {**{f"set9/{f}": f"set 9, {f}" for f in FORMULATIONS}, "lgmd": "LGMD"}
# Length of the approach, and of the window before contact in which a model must respond.
APPROACH_FRAMES, CONTACT_FRAMES = 30, 15


def _flight(group: int, seed: int) -> Clip:
    return Clip.of(f"group{group}", size=SIZE, seed=seed)


def _jobs(models: dict[str, ModelSpec], groups: tuple[int, ...], plan: Plan) -> list[Job]:
    """The jobs of the flights of some groups, one per seed."""
    return clip_jobs(models, *(_flight(group, seed) for group in groups for seed in plan.seeds))


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


def _flights(plan: Plan, data: Data, group: int) -> list[ClipResults]:
    return [data[_flight(group, seed)] for seed in plan.seeds]


def _spans(flight: ClipResults) -> list[tuple[float, float, str]]:
    """First frame, last frame and name of the phases that a figure shows: all but the first."""
    short = {"accelerate": "accel.", "decelerate": "brake"}
    named = list(flight.phases.items())[1:]
    return [
        (float(first), float(last), short.get(name, name))
        for name, (first, last) in named
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


# --- Fig. 1 -----------------------------------------------------------------------------------


def _fig1_values(plan: Plan, data: Data) -> Values:
    flights = _flights(plan, data, 1)
    return {
        "fig1-pitch": {ANY: [level_in(flight, "lgmd", "pitch") for flight in flights]},
        "fig1-accelerate": {ANY: [level_in(flight, "lgmd", "accelerate") for flight in flights]},
    }


def _fig1_figures(plan: Plan, data: Data) -> Figures:
    flight = data[_flight(1, FIGURE_SEED)]
    panels = [_shares("Group 1", flight, {"lgmd": "LGMD"})]
    return {"fig1": partial(plot_panels, panels, "Frame", "K / max K")}


# --- Fig. 13 ----------------------------------------------------------------------------------

_FIG_13 = {**_SET9, **other_models("lgmd", "emd-lgmd")}
_FIG_13B = _SET9 | {
    f"{label}/no-ffi-gd": one for label, one in all_formulations("set9", ffi_gd=False).items()
}


def _most_before(flights: list[ClipResults], label: str) -> list[float]:
    """The greatest sustained share of the peak before the approach of each flight."""
    phases = ("pitch", "accelerate")
    return [max(level_in(flight, label, name) for name in phases) for flight in flights]


def _fig13a_values(plan: Plan, data: Data) -> Values:
    values: Values = {}
    for group in (1, 2):
        most = partial(_most_before, _flights(plan, data, group))
        own = {f: most(f"set9/{f}") for f in FORMULATIONS}
        values[f"fig13a-silent-group{group}"] = own
        values[f"fig13a-lgmd-group{group}"] = {ANY: most("lgmd")}
        values[f"fig13a-emd-group{group}"] = {ANY: most("emd-lgmd")}
    return values


def _fig13a_figures(plan: Plan, data: Data) -> Figures:
    labels = {**_LABELS, "emd-lgmd": "EMD-LGMD"}
    panels = [
        _shares(f"Group {group}", data[_flight(group, FIGURE_SEED)], labels) for group in (1, 2)
    ]
    return {"fig13a": partial(plot_panels, panels, "Frame", "K / max K", share_y=False)}


def _n_active(flight: ClipResults, label: str) -> int:
    """Number of frames before the approach with K above 0."""
    before = flight.results[label].mp[: flight.collision_frame - APPROACH_FRAMES]
    return int(np.count_nonzero(np.nan_to_num(before) > 0.0))


def _fig13b_values(plan: Plan, data: Data) -> Values:
    flights = _flights(plan, data, 1)

    def left(formulation: str) -> list[float]:
        label = f"set9/{formulation}"
        counts = [(_n_active(s, label), _n_active(s, f"{label}/no-ffi-gd")) for s in flights]
        return [kept / n if n else math.nan for kept, n in counts]

    def without(formulation: str) -> list[float]:
        return _most_before(flights, f"set9/{formulation}/no-ffi-gd")

    return {"fig13b-removes": by_formulation(left), "fig13b-without": by_formulation(without)}


def _fig13b_figures(plan: Plan, data: Data) -> Figures:
    flight = data[_flight(1, FIGURE_SEED)]

    def panel(formulation: str) -> Panel:
        label = f"set9/{formulation}"
        raw = {"without FFI-GD": f"{label}/no-ffi-gd", "with FFI-GD": label}
        curves = {shown: flight.results[of].mp for shown, of in raw.items()}
        curves = {shown: np.where(mp > 0.0, mp, np.nan) for shown, mp in curves.items()}
        return _panel(formulation, flight, curves)

    panels = [panel(f) for f in FORMULATIONS]
    return {"fig13b": partial(plot_panels, panels, "Frame", "Raw K", log_y=True)}


# --- Fig. 14 ----------------------------------------------------------------------------------

_FIG_14_SETS = (3, 6, 7, 8)
_FIG_14 = all_formulations(*(f"set{n}" for n in _FIG_14_SETS)) | other_models("lgmd")
_BRAKE_FRAMES = 10
# Least level before braking, as a share of the peak, whose drop is measured.
_TO_DROP = 0.05


def _drop(level: Series, first: int) -> float:
    """Mean level after braking begins, divided by that before; NaN if that is too low."""
    before = float(level[first - _BRAKE_FRAMES : first].mean())
    after = float(level[first : first + _BRAKE_FRAMES].mean())
    return after / before if before >= _TO_DROP else math.nan


def _fig14_values(plan: Plan, data: Data) -> Values:
    flights = _flights(plan, data, 2)

    def pitch(flight: ClipResults, formulation: str, *numbers: int) -> list[float]:
        return [level_in(flight, f"set{n}/{formulation}", "pitch") for n in numbers]

    def order(flight: ClipResults, formulation: str) -> float:
        most, least = max(pitch(flight, formulation, 6, 8)), min(pitch(flight, formulation, 3, 7))
        return most / least if least > 0.0 else math.nan

    def worse(flight: ClipResults, formulation: str) -> float:
        lgmd = level_in(flight, "lgmd", "pitch")
        return max(pitch(flight, formulation, *_FIG_14_SETS)) / lgmd

    def drop(number: int, formulation: str) -> list[float]:
        label = f"set{number}/{formulation}"
        return [_drop(share_of_peak(s.results[label]), s.phases["decelerate"][0]) for s in flights]

    values: Values = {
        "fig14a-answers": by_formulation(lambda f: [min(pitch(s, f, 3, 7)) for s in flights]),
        "fig14a-silent": by_formulation(lambda f: [max(pitch(s, f, 6, 8)) for s in flights]),
        "fig14a-order": by_formulation(lambda f: [order(s, f) for s in flights]),
        "fig14a-lgmd": by_formulation(lambda f: [worse(s, f) for s in flights]),
    }
    for n in (3, 6):
        values[f"fig14b-set{n}"] = by_formulation(partial(drop, n))
    return values


def _fig14_figures(plan: Plan, data: Data) -> Figures:
    flight = data[_flight(2, FIGURE_SEED)]
    panels = [
        _shares(f, flight, {**{f"set{n}/{f}": f"set {n}" for n in _FIG_14_SETS}, "lgmd": "LGMD"})
        for f in FORMULATIONS
    ]
    return {"fig14": partial(plot_panels, panels, "Frame", "K / max K")}


# --- Figs. 15, 16 and 17 ------------------------------------------------------------------------

_FIG_15 = {**_SET9, **other_models("lgmd")}


def _approach_values(group: int, number: int, plan: Plan, data: Data) -> Values:
    """The values of Fig. 15 (group 4) or Fig. 16 (group 5)."""
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

    name = f"fig{number}"
    return {
        f"{name}-attenuates": by_formulation(lambda f: [flying(s, f"set9/{f}") for s in flights]),
        f"{name}-rising": by_formulation(lambda f: [rise(s, f"set9/{f}") for s in flights]),
        f"{name}-detects": by_formulation(
            lambda f: [level_in(s, f"set9/{f}", "contact") for s in flights]
        ),
        f"{name}-causal": by_formulation(lambda f: [causal(s, f"set9/{f}") for s in flights]),
        f"{name}-lgmd": {ANY: [level_in(s, "lgmd", "contact") for s in flights]},
    }


def _approach_figures(group: int, number: int, plan: Plan, data: Data) -> Figures:
    flight = data[_flight(group, FIGURE_SEED)]
    db = {shown: flight.results[label].attenuation_db for label, shown in _LABELS.items()}
    db = {shown: np.maximum(values, -60.0) for shown, values in db.items()}
    panels = [
        _shares(f"Group {group}: K / max K", flight, _LABELS),
        _panel("Attenuation", flight, db, y_label="dB"),
    ]
    return {f"fig{number}": partial(plot_panels, panels, "Frame", "K / max K", share_y=False)}


def _fig17_values(plan: Plan, data: Data) -> Values:
    flights = _flights(plan, data, 3)
    return {
        claim: {f: [level_in(s, f"set9/{f}", part) for s in flights] for f in FORMULATIONS}
        for claim, part in (("fig17-silent", "yaw"), ("fig17-answers", "contact"))
    }


def _fig17_figures(plan: Plan, data: Data) -> Figures:
    panels = [_shares("Group 3", data[_flight(3, FIGURE_SEED)], _LABELS)]
    return {"fig17": partial(plot_panels, panels, "Frame", "K / max K")}


# --- Table IV ---------------------------------------------------------------------------------

_SET = "set7"
BEST_SCALE = 0.25


def _scales(plan: Plan) -> tuple[float, ...]:
    """The scales of Table IV relative to 1920x1080; a quick report leaves out the full scale."""
    return SCALES[1:] if plan.quick else SCALES


def _table4_clip(plan: Plan, seed: int) -> Clip:
    largest = _scales(plan)[0]
    width, height = (round(side * largest) for side in PAPER_SIZE_WH)
    return Clip.of("group2", size=(height, width), seed=seed)


def _table4_seeds(plan: Plan) -> tuple[int, ...]:
    return plan.seeds[:2]


def _point(formulation: str, radius: int, scale: float) -> str:
    return f"{_SET}/{formulation}/r{radius}/x{scale:g}"


def _da_jobs(plan: Plan) -> list[Job]:
    # One job per formulation, to run in parallel: rendering the clip again costs less than a model.
    jobs = []
    scales = _scales(plan)
    for seed in _table4_seeds(plan):
        for f in FORMULATIONS:
            models = {
                _point(f, r, x): ModelSpec(model(_SET, f, r=r), x / scales[0])
                for r in RADII
                for x in scales
            }
            clip = _table4_clip(plan, seed)
            jobs.append(Job(("da", clip, f), f"table4, {f}", partial(run_clip, clip, models)))
    return jobs


def distinguishability(flight: ClipResults, label: str) -> float:
    """DA with the middle of the pitch as the false positive; 0 if the model never responds."""
    first, last = flight.phases["pitch"]
    found = flight.results[label].distinguishability((first + last) // 2)
    return 0.0 if math.isnan(found) else found


def da_table(plan: Plan, data: Data, formulation: str, seed: int) -> Series:
    """DA by radius (rows) and scale (columns); infinite where the model is silent at the pitch."""
    flight = data["da", _table4_clip(plan, seed), formulation]
    return np.array(
        [
            [distinguishability(flight, _point(formulation, r, x)) for x in _scales(plan)]
            for r in RADII
        ]
    )


def _da_values(plan: Plan, data: Data) -> Values:
    def tables(formulation: str) -> list[Series]:
        return [da_table(plan, data, formulation, seed) for seed in _table4_seeds(plan)]

    def at_best(table: Series) -> Series:
        return table[:, _scales(plan).index(BEST_SCALE)]

    def best(table: Series) -> float:
        others = np.delete(table, _scales(plan).index(BEST_SCALE), axis=1).max(axis=1)
        return min(_ratio(a, b) for a, b in zip(at_best(table), others, strict=True))

    def rising(table: Series) -> float:
        pairs = zip(table[:-1].ravel(), table[1:].ravel(), strict=True)
        return min(_ratio(wide, narrow) for wide, narrow in pairs)

    def of(value: Callable[[Series], float]) -> dict[str, list[float]]:
        return by_formulation(lambda f: [value(table) for table in tables(f)])

    return {
        "table4-da-above-1": of(lambda table: float(np.min(table))),
        "table4-da-above-10": of(lambda table: float(np.min(at_best(table)))),
        "table4-da-best": of(best),
        "table4-da-rising": of(rising),
    }


def _ratio(one: float, other: float) -> float:
    """The ratio of two DA; 1 if both are infinite, or both 0."""
    if math.isinf(one) and math.isinf(other):
        return 1.0
    if other == 0.0:
        return 1.0 if one == 0.0 else math.inf
    return float(one / other)


def _da_figures(plan: Plan, data: Data) -> Figures:
    scales = np.array(_scales(plan))

    def panel(formulation: str) -> Panel:
        table = da_table(plan, data, formulation, FIGURE_SEED)
        shown = np.where(np.isfinite(table) & (table > 0.0), table, np.nan)
        curves = {f"r = {r}": (scales, shown[row]) for row, r in enumerate(RADII)}
        return Panel(formulation, curves, level=1.0)

    panels = [panel(f) for f in FORMULATIONS]
    draw = partial(plot_panels, panels, "Scale", "Distinguishability DA", dots=True)
    return {"table4-da": partial(draw, log_x=True, log_y=True)}


_CORNERS = ((6, 1.0), (6, 0.25), (2, 0.02))


def _time_jobs(plan: Plan) -> list[Job]:
    return [
        Job(("time", f), f"timing, {f}", partial(time_model, f, plan.quick), is_timed=True)
        for f in FORMULATIONS
    ]


def time_model(formulation: str, quick: bool) -> list[dict[str, Any]]:
    """The rows of `dlgmd bench`; if `quick`, only three combinations of radius and scale."""
    params = model(_SET, formulation)
    assert isinstance(params, DlgmdParameters)
    n_frames = 24 if quick else 48
    rows = []
    with rendered_pan(n_frames) as path:
        points = [((r,), (x,)) for r, x in _CORNERS] if quick else [(RADII, SCALES)]
        for radii, scales in points:
            found = measure(
                lambda scale: open_video(path, scale=scale),
                params,
                radii=radii,
                scales=scales,
                repeats=1,
                engine="auto",
                on_step=lambda done: None,
            )
            rows += found["rows"]
    return rows


def _time_values(plan: Plan, data: Data) -> Values:
    def ratio(formulation: str) -> list[float]:
        rows = data["time", formulation]
        return [min(PAPER_S[row["radius"], row["scale"]] / row["whole_s"] for row in rows)]

    return {"table4-time": by_formulation(ratio)}


def da_rows(plan: Plan, data: Data) -> list[tuple[float, ...]]:
    """Radius, scale, the paper's DA, and our DA for each formulation; empty if not computed."""
    if ("da", _table4_clip(plan, FIGURE_SEED), FORMULATIONS[0]) not in data:
        return []
    tables = [da_table(plan, data, f, FIGURE_SEED) for f in FORMULATIONS]
    return [
        (r, x, PAPER_DA[r, x], *(float(table[row, column]) for table in tables))
        for row, r in enumerate(RADII)
        for column, x in enumerate(_scales(plan))
    ]


def time_rows(data: Data) -> list[tuple[float, ...]]:
    """Radius, scale, the paper's time in s, and ours for each formulation; empty if not timed."""
    timed = [data["time", f] for f in FORMULATIONS if ("time", f) in data]
    return [
        (
            r["radius"],
            r["scale"],
            PAPER_S[r["radius"], r["scale"]],
            *(one["whole_s"] for one in same),
        )
        for same in zip(*timed, strict=True)
        for r in same[:1]
    ]


EXHIBITS = (
    Exhibit("fig1", partial(_jobs, other_models("lgmd"), (1,)), _fig1_values, _fig1_figures),
    Exhibit("fig13a", partial(_jobs, _FIG_13, (1, 2)), _fig13a_values, _fig13a_figures),
    Exhibit("fig13b", partial(_jobs, _FIG_13B, (1,)), _fig13b_values, _fig13b_figures),
    Exhibit("fig14", partial(_jobs, _FIG_14, (2,)), _fig14_values, _fig14_figures),
    *(
        Exhibit(
            f"fig{number}",
            partial(_jobs, _FIG_15, (group,)),
            partial(_approach_values, group, number),
            partial(_approach_figures, group, number),
        )
        for group, number in ((4, 15), (5, 16))
    ),
    Exhibit("fig17", partial(_jobs, _FIG_15, (3,)), _fig17_values, _fig17_figures),
    Exhibit("table4-da", _da_jobs, _da_values, _da_figures),
    Exhibit("table4-time", _time_jobs, _time_values, lambda plan, data: {}),
)
