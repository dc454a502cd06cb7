"""The exhibits with simple stimuli: geometry, kernels, looming, receding and translation."""

import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.lab.reproduce.clips import (
    LAST_APART,
    Clip,
    Job,
    all_formulations,
    model,
    object_sums,
    other_models,
    reference_clip,
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
from dlgmd_cli.lab.stimuli.cubes import cube_input
from dlgmd_cli.models.detection import LEAST_PEAK
from dlgmd_cli.models.kernels import connect, latency_map
from dlgmd_cli.parameters import FORMULATIONS, DlgmdParameters
from dlgmd_cli.plots.kernels import plot_kernels
from dlgmd_cli.plots.panels import Panel, plot_panels
from dlgmd_cli.plots.sweeps import plot_sweep
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.results.sweep import Axis, Grid, SweepResult
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.runs.sweep import Sweep

# Least response, as a share of the peak: in a figure, less cannot be told from zero.
ONSET = 0.05
SILENT_DB = -60.0
SIZE = (270, 480)


def mean_db(result: Result, first: int = 0, last: int | None = None) -> float:
    """Mean attenuation in dB over frames `first` to `last`; values below -60 dB count as -60."""
    end = int(result.frame[-1]) if last is None else last
    within = (result.frame >= first) & (result.frame <= end) & ~np.isnan(result.attenuation_db)
    values = np.maximum(result.attenuation_db[within], SILENT_DB)
    return float(values.mean()) if values.size else np.nan


def share_of_peak(result: Result) -> Series:
    """K divided by its peak up to the collision; 0 where undefined, or if nothing responds."""
    mp = np.nan_to_num(result.mp)
    end = result.collision_frame
    peak = float(mp[: None if end is None else end + 1].max())
    return mp / peak if peak >= LEAST_PEAK else np.zeros_like(mp)


def onset(result: Result) -> int:
    """The first frame at which K reaches `ONSET` of its peak."""
    return int(np.argmax(share_of_peak(result) >= ONSET))


# --- Fig. 3 -----------------------------------------------------------------------------------


_LOOMING_CUBE = Clip.of("looming-cube", size=SIZE)


def _fig3_values(plan: Plan, data: Data) -> Values:
    truth = data[_LOOMING_CUBE].truth
    size, velocity = truth["angular_size_deg"], truth["angular_velocity_deg_s"]
    bend = np.diff(velocity, 2)
    concave = np.flatnonzero(bend < 0.0)
    until = size[concave[0] + 1] if concave.size else size[-1]
    return {
        "fig3-size": {ANY: [float(np.diff(size, 2).min())]},
        "fig3-velocity": {ANY: [float(until)]},
    }


def _fig3_figures(plan: Plan, data: Data) -> Figures:
    truth = data[_LOOMING_CUBE].truth
    time = truth["time_s"] - truth["time_s"][-1]
    panels = [
        Panel(f"Angular {name}", {"looming cube": (time, truth[column])}, y_label=unit)
        for name, column, unit in (
            ("size", "angular_size_deg", "deg"),
            ("velocity", "angular_velocity_deg_s", "deg/s"),
        )
    ]
    return {"fig3": partial(plot_panels, panels, "Time to the last frame (s)", "", share_y=False)}


# --- Fig. 5 -----------------------------------------------------------------------------------


def _fig5_values(plan: Plan, data: Data) -> Values:
    params = model("set9")
    assert isinstance(params, DlgmdParameters)
    tau = latency_map(params.r, params.alpha, params.beta, params.lam)
    along = tau[params.r, params.r :]
    limit = params.alpha + 1.0 / params.beta
    return {
        "fig5-rises": {ANY: [float(np.diff(along).min())]},
        "fig5-centre": {ANY: [abs(float(along[0]) - 0.567)]},
        "fig5-limit": {ANY: [float(limit - along[-1])]},
    }


def _fig5_figures(plan: Plan, data: Data) -> Figures:
    def draw(formulation: str) -> Any:
        params = model("set9", formulation)
        assert isinstance(params, DlgmdParameters)
        found = connect(params)
        return plot_kernels(found.excitation, found.inhibition, found.latency)

    return {"fig5": partial(draw, "default"), "fig5-equations": partial(draw, "equations")}


# --- Fig. 6, and inhibition's strength ---------------------------------------------------------

_SPEEDS = (1.0, 2.0, 3.0, 4.0)
_PAIRS = ((4, 1), (5, 2), (6, 3))
_SIDE_PX = 40.0
_SETS_1_TO_6 = all_formulations(*(f"set{n}" for n in range(1, 7)))


def _cube(speed: float) -> Clip:
    flags = {"contrast": -1.0, "background": 1.0, "object_size": _SIDE_PX, "frames": 31}
    return Clip.of("translating-cubes", size=(100, 200), speed=(speed,), **flags)


def _cube_db(data: Data, speed: float, label: str) -> float:
    return mean_db(data[_cube(speed)].results[label])


def _fig6_values(plan: Plan, data: Data) -> Values:
    def gain(speed: float, formulation: str) -> list[float]:
        """The attenuation with radial latency minus that without, for each pair of sets."""
        return [
            _cube_db(data, speed, f"set{radial}/{formulation}")
            - _cube_db(data, speed, f"set{plain}/{formulation}")
            for radial, plain in _PAIRS
        ]

    return {
        "fig6-slow": by_formulation(lambda f: [max(gain(1.0, f))]),
        "fig6-fast": by_formulation(lambda f: [min(gain(4.0, f))]),
    }


def _fig6_figures(plan: Plan, data: Data) -> Figures:
    speeds = np.array(_SPEEDS)

    def curve(number: int, formulation: str) -> tuple[Series, Series]:
        label = f"set{number}/{formulation}"
        return speeds, np.array([_cube_db(data, speed, label) for speed in _SPEEDS])

    panels = [
        Panel(f, {f"set {n}": curve(n, f) for pair in _PAIRS for n in pair[::-1]})
        for f in FORMULATIONS
    ]
    return {"fig6": partial(plot_panels, panels, "Speed (px/frame)", "Attenuation (dB)", dots=True)}


_STRENGTHS = tuple(np.arange(0.5, 2.51, 0.25).tolist())


def _strength_jobs(plan: Plan) -> list[Job]:
    models = {
        f"{label}/a{a:g}": spec
        for a in _STRENGTHS
        for label, spec in all_formulations("set4", a=a).items()
    }
    return clip_jobs(models, *map(_cube, _SPEEDS))


def _strength_curve(data: Data, speed: float, formulation: str) -> Series:
    return np.array([_cube_db(data, speed, f"set4/{formulation}/a{a:g}") for a in _STRENGTHS])


def _strength_values(plan: Plan, data: Data) -> Values:
    def steps(formulation: str) -> Series:
        return np.array([np.diff(_strength_curve(data, v, formulation)) for v in _SPEEDS])

    return {
        "strength-grows": by_formulation(
            lambda f: [max(float(_strength_curve(data, v, f)[-1] - _strength_curve(data, v, f)[0])
                           for v in _SPEEDS)]
        ),
        "strength-throughout": by_formulation(lambda f: [float(steps(f).max())]),
    }  # fmt: skip


def _strength_figures(plan: Plan, data: Data) -> Figures:
    strengths = np.array(_STRENGTHS)
    panels = [
        Panel(f, {f"{v:g} px/frame": (strengths, _strength_curve(data, v, f)) for v in _SPEEDS})
        for f in FORMULATIONS
    ]
    draw = partial(plot_panels, panels, "Strength of inhibition a", "Attenuation (dB)", dots=True)
    return {"strength": draw}


# --- Fig. 8 -----------------------------------------------------------------------------------

# Number of frames before contact over which the ball is measured.
_BALL_FRAMES = 10


def _fig8_clip(plan: Plan) -> Clip:
    return reference_clip(plan.reference, "ball-and-capsules", size=(600, 800))


def _fig8_jobs(plan: Plan) -> list[Job]:
    clip = _fig8_clip(plan)
    return [
        Job(("objects", clip), clip.scene, partial(object_sums, clip, all_formulations("set9")))
    ]


def _object_db(sums: Series) -> Series:
    """Attenuation in dB: of the ball shortly before contact, then of each capsule."""
    p, s = np.nansum(sums[:, : LAST_APART + 1], axis=1)
    p[0], s[0] = np.nansum(sums[:, -_BALL_FRAMES:, 0], axis=1)
    with np.errstate(divide="ignore"):
        return np.maximum(10.0 * np.log10(s / p), SILENT_DB)


def _fig8_values(plan: Plan, data: Data) -> Values:
    found = data["objects", _fig8_clip(plan)]

    def db(formulation: str) -> Series:
        return _object_db(found[f"set9/{formulation}"])

    return {
        "fig8-capsules": by_formulation(lambda f: [float(db(f)[1:].max())]),
        "fig8-ball": by_formulation(lambda f: [float(db(f)[0] - db(f)[1:].max())]),
    }


def _fig8_figures(plan: Plan, data: Data) -> Figures:
    found = data["objects", _fig8_clip(plan)]
    names = ("ball", *(f"capsule, {speed:g} px/frame" for speed in (6.4, 4.8, 3.2, 1.6)))

    def curves(sums: Series) -> dict[str, tuple[Series, Series]]:
        with np.errstate(divide="ignore", invalid="ignore"):
            db = np.maximum(10.0 * np.log10(sums[1] / sums[0]), SILENT_DB)
        db[LAST_APART + 1 :, 1:] = np.nan
        frame = np.arange(float(len(db)))
        return {name: (frame, db[:, place]) for place, name in enumerate(names)}

    panels = [Panel(f, curves(found[f"set9/{f}"])) for f in FORMULATIONS]
    return {"fig8": partial(plot_panels, panels, "Frame", "Attenuation (dB)")}


# --- Fig. 9 -----------------------------------------------------------------------------------

_APPROACHES = {
    "cube": _LOOMING_CUBE,
    "receding": Clip.of("receding-cube", size=SIZE),
    "ball": Clip.of("looming-ball", size=SIZE),
}


def _fig9_jobs(plan: Plan) -> list[Job]:
    models = {**all_formulations("set9"), **other_models("lgmd")}
    return clip_jobs(models, *_APPROACHES.values())


def _fig9_values(plan: Plan, data: Data) -> Values:
    def both(kind: str, formulation: str) -> tuple[Result, Result]:
        results = data[_APPROACHES[kind]].results
        return results[f"set9/{formulation}"], results["lgmd"]

    def later(kind: str, formulation: str) -> list[float]:
        own, lgmd = both(kind, formulation)
        return [float(onset(own) - onset(lgmd))]

    def sharper(kind: str, formulation: str) -> list[float]:
        own, lgmd = both(kind, formulation)
        return [own.sharpness / lgmd.sharpness]

    def at_rest(formulation: str) -> list[float]:
        shares = map(share_of_peak, both("receding", formulation))
        own, lgmd = (np.flatnonzero(share >= ONSET)[-1] for share in shares)
        return [float(own - lgmd)]

    values: Values = {"fig9b-rest": by_formulation(at_rest)}
    for kind in ("cube", "ball"):
        values[f"fig9a-silent-{kind}"] = by_formulation(partial(later, kind))
        values[f"fig9a-sharper-{kind}"] = by_formulation(partial(sharper, kind))
    return values


def _fig9_figures(plan: Plan, data: Data) -> Figures:
    titles = {"cube": "Looming cube", "ball": "Looming ball", "receding": "Receding cube"}

    def panel(kind: str) -> Panel:
        results = data[_APPROACHES[kind]].results
        shown = {label: results[label] for label in (*all_formulations("set9"), "lgmd")}
        curves = {label: (r.time_s, share_of_peak(r)) for label, r in shown.items()}
        return Panel(titles[kind], curves, level=ONSET)

    panels = [panel(kind) for kind in titles]
    return {"fig9": partial(plot_panels, panels, "Time (s)", "K / max K")}


# --- Figs. 10 and 12 ----------------------------------------------------------------------------


def _ball(plan: Plan) -> Clip:
    return reference_clip(plan.reference, "looming-ball", size=SIZE)


def _fig10_values(plan: Plan, data: Data) -> Values:
    results = data[_ball(plan)].results

    def curve(label: str) -> Series:
        return np.maximum(results[label].attenuation_db, SILENT_DB)[3:]

    def part(formulation: str) -> Series:
        return curve(f"set7/{formulation}")

    return {
        "fig10-stronger": by_formulation(
            lambda f: [float(np.nanmax(part(f) - curve("lgmd")))]
        ),
        "fig10-attenuates": by_formulation(lambda f: [float(np.nanmax(part(f)))]),
        "fig10-rising": by_formulation(
            lambda f: [float(np.nanmean(part(f)[-3:]) - np.nanmean(part(f)[:3]))]
        ),
    }  # fmt: skip


def _fig10_figures(plan: Plan, data: Data) -> Figures:
    results = data[_ball(plan)].results
    curves = {
        label: (results[label].frame.astype(float), results[label].attenuation_db)
        for label in (*all_formulations("set7"), "lgmd")
    }
    return {
        "fig10": partial(
            plot_panels, [Panel("Looming ball, set 7", curves)], "Frame", "Attenuation (dB)"
        )
    }


def _fig12_values(plan: Plan, data: Data) -> Values:
    results = data[_ball(plan)].results

    def k(number: int, formulation: str) -> Series:
        return results[f"set{number}/{formulation}"].mp[3:]

    def early(wide: int, narrow: int, formulation: str) -> list[float]:
        a, b = k(wide, formulation), k(narrow, formulation)
        half = len(a) // 2
        return [float(a[:half].sum() / b[:half].sum()) if b[:half].any() else np.nan]

    def contact(wide: int, narrow: int, formulation: str) -> list[float]:
        return [float(k(wide, formulation).max() / k(narrow, formulation).max())]

    def sharper(formulation: str) -> list[float]:
        found = [results[f"set{n}/{formulation}"].sharpness for n in range(1, 7)]
        return [max(found[radial - 1] / found[plain - 1] for radial, plain in _PAIRS)]

    return {
        "fig12a-early-plain": by_formulation(partial(early, 3, 1)),
        "fig12a-early-radial": by_formulation(partial(early, 6, 4)),
        "fig12a-contact-plain": by_formulation(partial(contact, 3, 1)),
        "fig12a-contact-radial": by_formulation(partial(contact, 6, 4)),
        "fig12b-sharper": by_formulation(sharper),
    }


def _fig12_figures(plan: Plan, data: Data) -> Figures:
    results = data[_ball(plan)].results
    raw, scaled = [], []
    for f in FORMULATIONS:
        own = {f"set {n}": results[f"set{n}/{f}"] for n in range(1, 7)}
        frame = {label: r.frame.astype(float) for label, r in own.items()}
        floor = {label: np.where(r.mp > 0.0, r.mp, np.nan) for label, r in own.items()}
        raw.append(Panel(f, {label: (frame[label], floor[label]) for label in own}))
        scaled.append(Panel(f, {label: (frame[label], share_of_peak(own[label])) for label in own}))
    return {
        "fig12a": partial(plot_panels, raw, "Frame", "Raw K", log_y=True),
        "fig12b": partial(plot_panels, scaled, "Frame", "K / max K"),
    }


# --- Fig. 11 -----------------------------------------------------------------------------------

# Comments in the paper's source say: no latency, a = 1.5 and r = 4.
_FIG_11 = {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4}
_SIZE_WH = (200, 150)
# Only 1 px/frame is suppressed if at most a tenth of its change passes, and half at other speeds.
_SUPPRESSED_DB, _FREE_DB = -10.0, -3.0


def _grid(plan: Plan) -> Grid:
    step_e, step_i = (0.2, 0.5) if plan.quick else (0.1, 0.25)
    return Grid(
        Axis.parse(f"sigma_e=0.2:2:{step_e}", DlgmdParameters),
        Axis.parse(f"sigma_i=0.5:6:{step_i}", DlgmdParameters),
    )


def _fig11_jobs(plan: Plan) -> list[Job]:
    return [
        Job(("fig11", f), f"fig11, {f}", partial(sweep_cubes, f, _grid(plan), plan.quick))
        for f in FORMULATIONS
    ]


def sweep_cubes(formulation: str, grid: Grid, quick: bool) -> SweepResult:
    """The attenuation of cubes at 1 to 4 px/frame for every point of a grid."""
    params = model("set1", formulation, **_FIG_11)
    subject = cube_input(_SPEEDS, _SIDE_PX, 21 if quick else None, _SIZE_WH, int(_FIG_11["r"]))
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        sweep = Sweep(Path(folder), subject, grid, Setup(params, "fig11", "opencv"))
        sweep.compute()
        return sweep.result


def _fig11_values(plan: Plan, data: Data) -> Values:
    def db(formulation: str) -> Series:
        return np.maximum(data["fig11", formulation].columns["attenuation_db"], SILENT_DB)

    def fast(formulation: str) -> Series:
        return db(formulation)[2:]

    def share(ordered: Any) -> list[float]:
        return [float(np.mean(ordered))]

    def alone(formulation: str) -> list[float]:
        values = db(formulation)
        points = (values[0] <= _SUPPRESSED_DB) & (values[1:] >= _FREE_DB).all(axis=0)
        return [float(points.mean())]

    # A kernel with r = 4 cuts off wider Gaussians.
    n_within = sum(value <= _FIG_11["r"] for value in _grid(plan).y.values)
    return {
        "fig11-speed": by_formulation(lambda f: share(np.diff(db(f), axis=0) >= 0.0)),
        "fig11-sigma-i": by_formulation(
            lambda f: share(np.diff(db(f)[2:, :n_within], axis=1) <= 0.0)
        ),
        "fig11-sigma-e": by_formulation(lambda f: share(np.diff(db(f)[2:], axis=2) >= 0.0)),
        "fig11-alone": by_formulation(alone),
    }


def _fig11_figures(plan: Plan, data: Data) -> Figures:
    return {"fig11": partial(plot_sweep, data["fig11", "default"], "two")}


# --- The paper's stated limit -------------------------------------------------------------------

_LATERAL = Clip.of("translating-cubes", size=SIZE, object_size=160.0, speed=(12.0,))


def _lateral_values(plan: Plan, data: Data) -> Values:
    def level(formulation: str) -> list[float]:
        return [float(np.nanmedian(data[_LATERAL].results[f"set9/{formulation}"].mp_abs))]

    return {"lateral-alarms": by_formulation(level)}


def _lateral_figures(plan: Plan, data: Data) -> Figures:
    results = data[_LATERAL].results
    curves = {label: (r.frame.astype(float), r.mp_abs) for label, r in results.items()}
    panel = Panel("Square of 160 px at 12 px/frame", curves, level=0.4)
    return {"lateral": partial(plot_panels, [panel], "Frame", "mp_abs")}


EXHIBITS = (
    Exhibit(
        "fig3",
        lambda plan: clip_jobs(other_models("lgmd"), _LOOMING_CUBE),
        _fig3_values,
        _fig3_figures,
    ),
    Exhibit("fig5", lambda plan: [], _fig5_values, _fig5_figures),
    Exhibit(
        "fig6",
        lambda plan: clip_jobs(_SETS_1_TO_6, *map(_cube, _SPEEDS)),
        _fig6_values,
        _fig6_figures,
    ),
    Exhibit("fig8", _fig8_jobs, _fig8_values, _fig8_figures),
    Exhibit("fig9", _fig9_jobs, _fig9_values, _fig9_figures),
    Exhibit(
        "fig10",
        lambda plan: clip_jobs(all_formulations("set7") | other_models("lgmd"), _ball(plan)),
        _fig10_values,
        _fig10_figures,
    ),
    Exhibit("fig11", _fig11_jobs, _fig11_values, _fig11_figures),
    Exhibit(
        "fig12", lambda plan: clip_jobs(_SETS_1_TO_6, _ball(plan)), _fig12_values, _fig12_figures
    ),
    Exhibit(
        "lateral",
        lambda plan: clip_jobs(all_formulations("set9"), _LATERAL),
        _lateral_values,
        _lateral_figures,
    ),
    Exhibit("strength", _strength_jobs, _strength_values, _strength_figures),
)
