"""The exhibits with simple stimuli: geometry, kernels, looming, receding and translation."""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.lab.flights.ball import CAPSULES
from dlgmd_cli.lab.plots.panels import Panel, plot_panels
from dlgmd_cli.lab.reproduce.clips import (
    LAST_APART,
    Clip,
    all_formulations,
    model,
    object_sums,
    other_models,
    reference_clip,
)
from dlgmd_cli.lab.reproduce.plan import (
    ANY,
    Data,
    Evidence,
    Exhibit,
    Needs,
    Plan,
    by_formulation,
)
from dlgmd_cli.lab.stimuli.cubes import FIG_11, SIDE_PX, SIZE_WH, SPEEDS_PX, cube_input
from dlgmd_cli.models.detection import LEAST_PEAK
from dlgmd_cli.models.kernels import connect, latency_map
from dlgmd_cli.parameters import FORMULATIONS, DlgmdParameters, load_set
from dlgmd_cli.plots.kernels import plot_kernels
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.plots.sweeps import plot_sweep
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.results.sweep import Axis, Grid, SweepResult
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.runs.sweep import Sweep

# Least response, as a share of the peak: in a figure, less cannot be told from zero.
ONSET = 0.05
SIZE = (270, 480)
# Sets that differ only in their latency: radial, and none.
_PAIRS = ((4, 1), (5, 2), (6, 3))


def mean_db(result: Result, first: int = 0, last: int | None = None) -> float:
    """Mean attenuation in dB over frames `first` to `last`; values below -60 dB count as -60."""
    end = int(result.frame[-1]) if last is None else last
    within = (result.frame >= first) & (result.frame <= end) & ~np.isnan(result.attenuation_db)
    values = np.maximum(result.attenuation_db[within], FLOOR_DB)
    return float(values.mean()) if values.size else np.nan


def share_of_peak(result: Result) -> Series:
    """K divided by its peak up to the collision; 0 where undefined, or if nothing responds."""
    mp = np.nan_to_num(result.mp)
    end = result.collision_frame
    peak = float(mp[: None if end is None else end + 1].max())
    return mp / peak if peak >= LEAST_PEAK else np.zeros_like(mp)


def positive(mp: Series) -> Series:
    """K, and NaN where it is 0, for a logarithmic axis."""
    return np.where(mp > 0.0, mp, np.nan)


def onset(result: Result) -> int:
    """The first frame at which K reaches `ONSET` of its peak."""
    return int(np.argmax(share_of_peak(result) >= ONSET))


_LOOMING_CUBE = Clip.of("looming-cube", size=SIZE)


def fig3(plan: Plan, data: Data) -> Evidence:
    """The angular size of a looming cube and its velocity."""
    truth = data[_LOOMING_CUBE].truth
    size, velocity = truth["angular_size_deg"], truth["angular_velocity_deg_s"]
    concave = np.flatnonzero(np.diff(velocity, 2) < 0.0)
    until = size[concave[0] + 1] if concave.size else size[-1]
    time = truth["time_s"] - truth["time_s"][-1]
    panels = [
        Panel("Angular size", {"looming cube": (time, size)}, y_label="deg"),
        Panel("Angular velocity", {"looming cube": (time, velocity)}, y_label="deg/s"),
    ]
    draw = partial(plot_panels, panels, "Time to the last frame (s)", "", share_y=False)
    values = {
        "fig3-size": {ANY: [float(np.diff(size, 2).min())]},
        "fig3-velocity": {ANY: [float(until)]},
    }
    return Evidence(values, {"fig3": draw})


def fig5(plan: Plan, data: Data) -> Evidence:
    """The latency of inhibition by distance, and the kernels."""
    params = load_set(9)
    tau = latency_map(params.r, params.alpha, params.beta, params.lam)
    along = tau[params.r, params.r :]
    limit = params.alpha + 1.0 / params.beta

    def draw(formulation: str) -> Any:
        found = connect(load_set(9, formulation=formulation))
        return plot_kernels(found.excitation, found.inhibition, found.latency)

    values = {
        "fig5-rises": {ANY: [float(np.diff(along).min())]},
        "fig5-centre": {ANY: [abs(float(along[0]) - 0.567)]},
        "fig5-limit": {ANY: [float(limit - along[-1])]},
    }
    figures = {"fig5": partial(draw, "default"), "fig5-equations": partial(draw, "equations")}
    return Evidence(values, figures)


_SETS_1_TO_6 = all_formulations(*(f"set{n}" for n in range(1, 7)))
_STRENGTHS = tuple(np.arange(0.5, 2.51, 0.25).tolist())
_STRONGER = {
    f"{label}/a{a:g}": spec
    for a in _STRENGTHS
    for label, spec in all_formulations("set4", a=a).items()
}


def _cube(speed: float) -> Clip:
    flags = {"contrast": -1.0, "background": 1.0, "object_size": SIDE_PX, "frames": 31}
    return Clip.of("translating-cubes", size=(100, 200), speed=(speed,), **flags)


def _cubes(models: Needs) -> Needs:
    """The models, which see a cube at every speed."""
    return {_cube(speed): models for speed in SPEEDS_PX}


def _cube_db(data: Data, label: str) -> Series:
    """The attenuation of a cube at each of `SPEEDS_PX`."""
    return np.array([mean_db(data[_cube(speed)].results[label]) for speed in SPEEDS_PX])


def fig6(plan: Plan, data: Data) -> Evidence:
    """The attenuation of cubes by their speed, with and without radial latency."""

    def gain(formulation: str) -> Series:
        """The attenuation with radial latency minus that without, by pair of sets and speed."""
        radial, plain = (
            np.array([_cube_db(data, f"set{pair[place]}/{formulation}") for pair in _PAIRS])
            for place in (0, 1)
        )
        return radial - plain

    speeds = np.array(SPEEDS_PX)
    sets = [number for pair in _PAIRS for number in pair[::-1]]
    panels = [
        Panel(f, {f"set {n}": (speeds, _cube_db(data, f"set{n}/{f}")) for n in sets})
        for f in FORMULATIONS
    ]
    draw = partial(plot_panels, panels, "Speed (px/frame)", "Attenuation (dB)", dots=True)
    values = {
        "fig6-slow": by_formulation(lambda f: gain(f)[:, 0].max()),
        "fig6-fast": by_formulation(lambda f: gain(f)[:, -1].min()),
    }
    return Evidence(values, {"fig6": draw})


def strength(plan: Plan, data: Data) -> Evidence:
    """The attenuation of cubes by the strength of inhibition."""

    def db(formulation: str) -> Series:
        """The attenuation by strength and speed."""
        return np.array([_cube_db(data, f"set4/{formulation}/a{a:g}") for a in _STRENGTHS])

    def panel(formulation: str) -> Panel:
        strengths, columns = np.array(_STRENGTHS), db(formulation).T
        names = [f"{speed:g} px/frame" for speed in SPEEDS_PX]
        return Panel(formulation, {n: (strengths, c) for n, c in zip(names, columns, strict=True)})

    panels = [panel(f) for f in FORMULATIONS]
    draw = partial(plot_panels, panels, "Strength of inhibition a", "Attenuation (dB)", dots=True)
    values = {
        "strength-grows": by_formulation(lambda f: (db(f)[-1] - db(f)[0]).max()),
        "strength-throughout": by_formulation(lambda f: np.diff(db(f), axis=0).max()),
    }
    return Evidence(values, {"strength": draw})


# Number of frames before contact over which the ball is measured.
_BALL_FRAMES = 10


def _fig8_needs(plan: Plan) -> Needs:
    clip = reference_clip(plan.reference, "ball-and-capsules", size=(600, 800))
    return {"fig8": partial(object_sums, clip, all_formulations("set9"))}


def fig8(plan: Plan, data: Data) -> Evidence:
    """The attenuation around a ball that approaches and capsules that translate."""
    names = ("ball", *(f"capsule, {speed:g} px/frame" for _, speed in CAPSULES))

    def decibels(p: Series, s: Series) -> Series:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.maximum(10.0 * np.log10(s / p), FLOOR_DB)

    def db(formulation: str) -> Series:
        """The attenuation of the ball shortly before contact, then of each capsule."""
        sums = data["fig8"][f"set9/{formulation}"]
        p, s = np.nansum(sums[:, : LAST_APART + 1], axis=1)
        p[0], s[0] = np.nansum(sums[:, -_BALL_FRAMES:, 0], axis=1)
        return decibels(p, s)

    def curves(sums: Series) -> dict[str, tuple[Series, Series]]:
        db = decibels(*sums)
        db[LAST_APART + 1 :, 1:] = np.nan
        frame = np.arange(float(len(db)))
        return {name: (frame, db[:, place]) for place, name in enumerate(names)}

    panels = [Panel(f, curves(data["fig8"][f"set9/{f}"])) for f in FORMULATIONS]
    values = {
        "fig8-capsules": by_formulation(lambda f: db(f)[1:].max()),
        "fig8-ball": by_formulation(lambda f: db(f)[0] - db(f)[1:].max()),
    }
    return Evidence(values, {"fig8": partial(plot_panels, panels, "Frame", "Attenuation (dB)")})


_FIG_9 = {**all_formulations("set9"), **other_models("lgmd")}
_APPROACHES = {
    "cube": _LOOMING_CUBE,
    "ball": Clip.of("looming-ball", size=SIZE),
    "receding": Clip.of("receding-cube", size=SIZE),
}


def fig9(plan: Plan, data: Data) -> Evidence:
    """Set 9 and the LGMD while a cube or a ball approaches, or a cube recedes."""
    results = {kind: data[clip].results for kind, clip in _APPROACHES.items()}

    def later(kind: str, formulation: str) -> float:
        return onset(results[kind][f"set9/{formulation}"]) - onset(results[kind]["lgmd"])

    def sharper(kind: str, formulation: str) -> float:
        return results[kind][f"set9/{formulation}"].sharpness / results[kind]["lgmd"].sharpness

    def rest(label: str) -> int:
        """The last frame with a response to the receding cube."""
        return int(np.flatnonzero(share_of_peak(results["receding"][label]) >= ONSET)[-1])

    values = {"fig9b-rest": by_formulation(lambda f: rest(f"set9/{f}") - rest("lgmd"))}
    for kind in ("cube", "ball"):
        values[f"fig9a-silent-{kind}"] = by_formulation(partial(later, kind))
        values[f"fig9a-sharper-{kind}"] = by_formulation(partial(sharper, kind))
    titles = {"cube": "Looming cube", "ball": "Looming ball", "receding": "Receding cube"}
    panels = []
    for kind, title in titles.items():
        shown = {label: results[kind][label] for label in _FIG_9}
        curves = {label: (r.time_s, share_of_peak(r)) for label, r in shown.items()}
        panels.append(Panel(title, curves, level=ONSET))
    return Evidence(values, {"fig9": partial(plot_panels, panels, "Time (s)", "K / max K")})


_FIG_10 = {**all_formulations("set7"), **other_models("lgmd")}


def _ball(plan: Plan) -> Clip:
    return reference_clip(plan.reference, "looming-ball", size=SIZE)


def fig10(plan: Plan, data: Data) -> Evidence:
    """The attenuation of a looming ball."""
    results = data[_ball(plan)].results

    def db(label: str) -> Series:
        return np.maximum(results[label].attenuation_db, FLOOR_DB)[3:]

    def rise(formulation: str) -> float:
        own = db(f"set7/{formulation}")
        return float(np.nanmean(own[-3:]) - np.nanmean(own[:3]))

    curves = {
        label: (results[label].frame.astype(float), results[label].attenuation_db)
        for label in _FIG_10
    }
    panel = Panel("Looming ball, set 7", curves)
    values = {
        "fig10-stronger": by_formulation(lambda f: np.nanmax(db(f"set7/{f}") - db("lgmd"))),
        "fig10-attenuates": by_formulation(lambda f: np.nanmax(db(f"set7/{f}"))),
        "fig10-rising": by_formulation(rise),
    }
    return Evidence(values, {"fig10": partial(plot_panels, [panel], "Frame", "Attenuation (dB)")})


def fig12(plan: Plan, data: Data) -> Evidence:
    """The responses of sets 1 to 6 to a looming ball."""
    results = data[_ball(plan)].results

    def k(number: int, formulation: str) -> Series:
        return results[f"set{number}/{formulation}"].mp[3:]

    def early(wide: int, narrow: int, formulation: str) -> float:
        a, b = k(wide, formulation), k(narrow, formulation)
        half = len(a) // 2
        return float(a[:half].sum() / b[:half].sum()) if b[:half].any() else np.nan

    def contact(wide: int, narrow: int, formulation: str) -> float:
        return float(k(wide, formulation).max() / k(narrow, formulation).max())

    def sharper(formulation: str) -> float:
        found = [results[f"set{n}/{formulation}"].sharpness for n in range(1, 7)]
        return max(found[radial - 1] / found[plain - 1] for radial, plain in _PAIRS)

    raw, scaled = [], []
    for f in FORMULATIONS:
        own = {f"set {n}": results[f"set{n}/{f}"] for n in range(1, 7)}
        frame = np.arange(float(len(own["set 1"])))
        raw.append(Panel(f, {name: (frame, positive(r.mp)) for name, r in own.items()}))
        scaled.append(Panel(f, {name: (frame, share_of_peak(r)) for name, r in own.items()}))
    values = {
        "fig12a-early-plain": by_formulation(partial(early, 3, 1)),
        "fig12a-early-radial": by_formulation(partial(early, 6, 4)),
        "fig12a-contact-plain": by_formulation(partial(contact, 3, 1)),
        "fig12a-contact-radial": by_formulation(partial(contact, 6, 4)),
        "fig12b-sharper": by_formulation(sharper),
    }
    figures = {
        "fig12a": partial(plot_panels, raw, "Frame", "Raw K", log_y=True),
        "fig12b": partial(plot_panels, scaled, "Frame", "K / max K"),
    }
    return Evidence(values, figures)


# Only 1 px/frame is suppressed if at most a tenth of its change passes, and half at other speeds.
_SUPPRESSED_DB, _FREE_DB = -10.0, -3.0


def _grid(plan: Plan) -> Grid:
    step_e, step_i = (0.2, 0.5) if plan.quick else (0.1, 0.25)
    return Grid(
        Axis.parse(f"sigma_e=0.2:2:{step_e}", DlgmdParameters),
        Axis.parse(f"sigma_i=0.5:6:{step_i}", DlgmdParameters),
    )


def _fig11_needs(plan: Plan) -> Needs:
    sweep = partial(sweep_cubes, grid=_grid(plan), n_frames=21 if plan.quick else None)
    return {f"fig11, {f}": partial(sweep, f) for f in FORMULATIONS}


def sweep_cubes(formulation: str, grid: Grid, n_frames: int | None) -> SweepResult:
    """The attenuation of cubes at 1 to 4 px/frame for every point of a grid."""
    params = model("set1", formulation, **FIG_11)
    subject = cube_input(SPEEDS_PX, SIDE_PX, n_frames, SIZE_WH, int(FIG_11["r"]))
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        sweep = Sweep(Path(folder), subject, grid, Setup(params, "fig11", "opencv"))
        sweep.compute()
        return sweep.result


def fig11(plan: Plan, data: Data) -> Evidence:
    """The attenuation of cubes over the widths of excitation and inhibition."""
    db = {
        f: np.maximum(data[f"fig11, {f}"].columns["attenuation_db"], FLOOR_DB) for f in FORMULATIONS
    }
    # A kernel with r = 4 cuts off wider Gaussians.
    n_within = sum(value <= FIG_11["r"] for value in _grid(plan).y.values)

    def alone(formulation: str) -> float:
        slow, others = db[formulation][0], db[formulation][1:]
        return float(((slow <= _SUPPRESSED_DB) & (others >= _FREE_DB).all(axis=0)).mean())

    values = {
        "fig11-speed": by_formulation(lambda f: (np.diff(db[f], axis=0) >= 0.0).mean()),
        "fig11-sigma-i": by_formulation(
            lambda f: (np.diff(db[f][2:, :n_within], axis=1) <= 0.0).mean()
        ),
        "fig11-sigma-e": by_formulation(lambda f: (np.diff(db[f][2:], axis=2) >= 0.0).mean()),
        "fig11-alone": by_formulation(alone),
    }
    return Evidence(values, {"fig11": partial(plot_sweep, data["fig11, default"], "two")})


_LATERAL = Clip.of("translating-cubes", size=SIZE, object_size=160.0, speed=(12.0,))


def lateral(plan: Plan, data: Data) -> Evidence:
    """The response to a large square that translates fast."""
    results = data[_LATERAL].results
    curves = {label: (r.frame.astype(float), r.mp_abs) for label, r in results.items()}
    panel = Panel("Square of 160 px at 12 px/frame", curves, level=0.4)
    level = by_formulation(lambda f: np.nanmedian(results[f"set9/{f}"].mp_abs))
    draw = partial(plot_panels, [panel], "Frame", "mp_abs")
    return Evidence({"lateral-alarms": level}, {"lateral": draw})


EXHIBITS = {
    "fig3": Exhibit(lambda plan: {_LOOMING_CUBE: other_models("lgmd")}, fig3),
    "fig5": Exhibit(lambda plan: {}, fig5),
    "fig6": Exhibit(lambda plan: _cubes(_SETS_1_TO_6), fig6),
    "fig8": Exhibit(_fig8_needs, fig8),
    "fig9": Exhibit(lambda plan: dict.fromkeys(_APPROACHES.values(), _FIG_9), fig9),
    "fig10": Exhibit(lambda plan: {_ball(plan): _FIG_10}, fig10),
    "fig11": Exhibit(_fig11_needs, fig11),
    "fig12": Exhibit(lambda plan: {_ball(plan): _SETS_1_TO_6}, fig12),
    "lateral": Exhibit(lambda plan: {_LATERAL: all_formulations("set9")}, lateral),
    "strength": Exhibit(lambda plan: _cubes(_STRONGER), strength),
}
