"""The exhibits with simple stimuli: geometry, kernels, looming, receding and translation."""

import tempfile
from collections.abc import Callable, Generator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.lab.flights.ball import CAPSULES
from dlgmd_cli.lab.plots.panels import Panel, plot_panels
from dlgmd_cli.lab.reproduce.clips import (
    EVERY,
    LAST_APART,
    NULL,
    VERSIONS,
    Clip,
    all_versions,
    model,
    object_sums,
    other_models,
    rectified_lgmd_db,
    reference_clip,
)
from dlgmd_cli.lab.reproduce.plan import ANY, Data, Evidence, Exhibit, Needs, Plan, by_version
from dlgmd_cli.lab.stimuli.cubes import FIG_11, SIDE_PX, SIZE_WH, SPEEDS_PX, cube_input
from dlgmd_cli.models.detection import LEAST_PEAK
from dlgmd_cli.models.kernels import connect, latency_map
from dlgmd_cli.parameters import DlgmdParameters, load_set
from dlgmd_cli.plots.kernels import plot_kernels
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.plots.sweeps import plot_sweep
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.results.sweep import Axis, Grid, SweepResult
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.runs.sweep import Sweep

# Least response, as a share of the peak: in a figure, less cannot be told from zero.
ONSET = 0.05
# The LGMD, read by its own sigmoid.
SIGMOID = "lgmd/sigmoid"
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


def sigmoid(result: Result) -> Series:
    """The LGMD's own output 1/(1 + exp(-K/n_cell)), scaled to 0 at rest; 0 where undefined."""
    return 2.0 * np.nan_to_num(result.mp_abs, nan=0.5) - 1.0


def level(results: Mapping[str, Result], label: str) -> Series:
    """The level of a model: `SIGMOID` reads the LGMD by its sigmoid, all else is K / max K."""
    return sigmoid(results["lgmd"]) if label == SIGMOID else share_of_peak(results[label])


def positive(mp: Series) -> Series:
    """K, and NaN where it is 0, for a logarithmic axis."""
    return np.where(mp > 0.0, mp, np.nan)


def answering(level: Series) -> npt.NDArray[np.intp]:
    """The frames at which a level reaches `ONSET`."""
    return np.flatnonzero(level >= ONSET)


# Versions in figures with a panel each; where only the connections matter; and with few curves.
SHOWN = ("default", "bands-unlimited", "nearest", "nearest-unlimited", "interpolated", "equations")
BY_LATENCY = ("default", "nearest", "interpolated")
FEW, TWO = ("default", "nearest-unlimited", "equations"), ("default", "equations")
_LOOMING_CUBE = Clip.of("looming-cube", size=SIZE)
Steps = Generator[Needs, Data, Evidence]


def fig2(plan: Plan) -> Steps:
    """The angular size of a looming cube and its velocity."""
    data = yield {_LOOMING_CUBE: other_models("lgmd")}
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
        "fig2-size": {ANY: [float(np.diff(size, 2).min())]},
        "fig2-velocity": {ANY: [float(until)]},
    }
    return Evidence(values, {"fig2": draw})


def fig5(plan: Plan) -> Steps:
    """The latency of inhibition by distance, and the kernels."""
    yield {}
    params = load_set(9)
    along = latency_map(params.r, params.alpha, params.beta, params.lam)[params.r, params.r :]

    def draw(version: str) -> Any:
        found = connect(load_set(9, **VERSIONS[version]))
        return plot_kernels(found.excitation, found.inhibition, found.latency)

    def taps(version: str) -> int:
        """The fewest excitatory taps of a set with radial latency."""
        each = (connect(load_set(n, **VERSIONS[version])) for n in range(4, 10))
        return min(int(np.count_nonzero(one.excitation)) for one in each)

    values = {
        "fig5-rises": {ANY: [float(np.diff(along).min())]},
        "fig5-excitation": by_version(taps, VERSIONS),
    }
    names = {"default": "fig5", "nearest": "fig5-nearest", "interpolated": "fig5-interpolated"}
    return Evidence(values, {stem: partial(draw, version) for version, stem in names.items()})


_SETS_1_TO_6 = all_versions(*(f"set{n}" for n in range(1, 7)))
_STRENGTHS = tuple(np.arange(0.5, 2.51, 0.25).tolist())
_STRONGER = {f"set4/{v}/a{a:g}": model("set4", v, a=a) for a in _STRENGTHS for v in BY_LATENCY}


def _cube(speed: float) -> Clip:
    flags = {"contrast": -1.0, "background": 1.0, "object_size": SIDE_PX, "frames": 31}
    return Clip.of("translating-cubes", size=(100, 200), speed=(speed,), **flags)


def _cube_db(data: Data, label: str) -> Series:
    """The attenuation of a cube at each of `SPEEDS_PX`."""
    return np.array([mean_db(data[_cube(speed)].results[label]) for speed in SPEEDS_PX])


def fig6(plan: Plan) -> Steps:
    """The attenuation of cubes by their speed, with and without radial latency."""
    data = yield {_cube(speed): _SETS_1_TO_6 for speed in SPEEDS_PX}

    def gain(version: str) -> Series:
        """The attenuation with radial latency minus that without, by pair of sets and speed."""
        radial, plain = (
            np.array([_cube_db(data, f"set{pair[place]}/{version}") for pair in _PAIRS])
            for place in (0, 1)
        )
        return radial - plain

    speeds = np.array(SPEEDS_PX)
    sets = [number for pair in _PAIRS for number in pair[::-1]]
    panels = [
        Panel(v, {f"set {n}": (speeds, _cube_db(data, f"set{n}/{v}")) for n in sets})
        for v in BY_LATENCY
    ]
    draw = partial(plot_panels, panels, "Speed (px/frame)", "Attenuation (dB)", dots=True)
    values = {
        "fig6-slow": by_version(lambda v: gain(v)[:, 0].max()),
        "fig6-fast": by_version(lambda v: gain(v)[:, -1].min()),
    }
    return Evidence(values, {"fig6": draw})


def strength(plan: Plan) -> Steps:
    """The attenuation of cubes by the strength of inhibition."""
    data = yield {_cube(speed): _STRONGER for speed in SPEEDS_PX}

    def db(version: str) -> Series:
        """The attenuation by strength and speed."""
        return np.array([_cube_db(data, f"set4/{version}/a{a:g}") for a in _STRENGTHS])

    def panel(version: str) -> Panel:
        strengths, columns = np.array(_STRENGTHS), db(version).T
        names = [f"{speed:g} px/frame" for speed in SPEEDS_PX]
        return Panel(version, {n: (strengths, c) for n, c in zip(names, columns, strict=True)})

    panels = [panel(v) for v in BY_LATENCY]
    draw = partial(plot_panels, panels, "Strength of inhibition a", "Attenuation (dB)", dots=True)
    values = {
        "strength-grows": by_version(lambda v: (db(v)[-1] - db(v)[0]).max(), BY_LATENCY),
        "strength-throughout": by_version(lambda v: np.diff(db(v), axis=0).max(), BY_LATENCY),
    }
    return Evidence(values, {"strength": draw})


# Number of frames before contact over which the ball is measured.
_BALL_FRAMES = 10


def fig8(plan: Plan) -> Steps:
    """The attenuation around a ball that approaches and capsules that translate."""
    clip = reference_clip(plan.reference, "ball-and-capsules", size=(600, 800))
    half = len(EVERY) // 2  # two calls, to run in parallel
    models = [all_versions("set9", only=some) for some in (EVERY[:half], EVERY[half:])]
    data = yield {f"fig8, {n}": partial(object_sums, clip, some) for n, some in enumerate(models)}
    found = data["fig8, 0"] | data["fig8, 1"]
    names = ("ball", *(f"capsule, {speed:g} px/frame" for _, speed in CAPSULES))

    def decibels(p: Series, s: Series) -> Series:
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.maximum(10.0 * np.log10(s / p), FLOOR_DB)

    def db(version: str) -> Series:
        """The attenuation of the ball shortly before contact, then of each capsule."""
        sums = found[f"set9/{version}"][0]
        p, s = np.nansum(sums[:, : LAST_APART + 1], axis=1)
        p[0], s[0] = np.nansum(sums[:, -_BALL_FRAMES:, 0], axis=1)
        return decibels(p, s)

    def shares(version: str) -> Series:
        """Medians of `layer_shares` over the frames."""
        return np.nanmedian(found[f"set9/{version}"][1], axis=0)

    def curves(sums: Series) -> dict[str, tuple[Series, Series]]:
        db = decibels(*sums)
        db[LAST_APART + 1 :, 1:] = np.nan
        frame = np.arange(float(len(db)))
        return {name: (frame, db[:, place]) for place, name in enumerate(names)}

    panels = [Panel(v, curves(found[f"set9/{v}"][0])) for v in BY_LATENCY]
    values = {
        "fig8-capsules": by_version(lambda v: db(v)[1:].max()),
        "fig8-ball": by_version(lambda v: db(v)[0] - db(v)[1:].max()),
        "fig8-polarised": by_version(lambda v: shares(v)[1] / shares(v)[0]),
        "fig8-sparse": by_version(lambda v: shares(v)[2] - shares(v)[3]),
    }
    draw = partial(plot_panels, panels, "Frame", "Attenuation (dB)", emphasise=names[0])
    return Evidence(values, {"fig8": draw})


_FIG_9 = all_versions("set9") | other_models("lgmd")
_APPROACHES = {
    "cube": _LOOMING_CUBE,
    "ball": Clip.of("looming-ball", size=SIZE),
    "receding": Clip.of("receding-cube", size=SIZE),
}
LGMDS = {"lgmd": "LGMD (K)", SIGMOID: "LGMD (sigmoid)"}


def fig9(plan: Plan) -> Steps:
    """Set 9 and the LGMD while a cube or a ball approaches, or a cube recedes."""
    data = yield dict.fromkeys(_APPROACHES.values(), _FIG_9)
    results = {kind: data[clip].results for kind, clip in _APPROACHES.items()}

    def frames(kind: str, label: str) -> npt.NDArray[np.intp]:
        return answering(level(results[kind], label))

    def own(kind: str, version: str) -> npt.NDArray[np.intp]:
        found = frames(kind, f"set9/{version}")
        return found if found.size else np.array([len(results[kind]["lgmd"])])

    def after(kind: str, place: int, other: int, version: str) -> float:
        return float(own(kind, version)[place] - other)

    def sharper(kind: str, version: str) -> float:
        return results[kind][f"set9/{version}"].sharpness / results[kind]["lgmd"].sharpness

    n_cube = len(results["cube"]["lgmd"])
    values = {"fig9a-silent": by_version(lambda v: own("cube", v)[0] / n_cube)}
    for name, label in (("", SIGMOID), ("-raw", "lgmd")):
        first, last = frames("cube", label)[0], frames("receding", label)[-1]
        values[f"fig9a-later{name}"] = by_version(partial(after, "cube", 0, first))
        values[f"fig9b-rest{name}"] = by_version(partial(after, "receding", -1, last))
        values[f"fig9b-lgmd{name}"] = {ANY: [last / n_cube]}
    values |= {
        "fig9a-sharper": by_version(partial(sharper, "cube")),
        "fig9-ball-later": by_version(partial(after, "ball", 0, frames("ball", "lgmd")[0])),
        "fig9-ball-sharper": by_version(partial(sharper, "ball")),
    }
    shown = {f"set9/{v}": f"set 9, {v}" for v in TWO} | LGMDS

    def panel(title: str, kind: str, first: int = 0, last: int | None = None) -> Panel:
        time_s = results[kind]["lgmd"].time_s[first:last]
        curves = {
            text: (time_s, level(results[kind], label)[first:last]) for label, text in shown.items()
        }
        return Panel(title, curves, level=ONSET)

    panels = [
        panel("Looming cube", "cube"),
        panel("Its last second", "cube", -_SECOND),
        panel("Receding cube", "receding"),
        panel("Its first second", "receding", 0, _SECOND),
        panel("Looming ball (ours)", "ball"),
        panel("Its last second", "ball", -_SECOND),
    ]
    draw = partial(plot_panels, panels, "Time (s)", "Level", share_x=False)
    return Evidence(values, {"fig9": draw})


# Frames in a second of the clips.
_SECOND = 30


def _ball(plan: Plan) -> Clip:
    return reference_clip(plan.reference, "looming-ball", size=SIZE)


def fig10(plan: Plan) -> Steps:
    """The attenuation of a looming ball."""
    rectified = "the rectified LGMD"
    data = yield {
        _ball(plan): all_versions("set7") | other_models("lgmd"),
        rectified: partial(rectified_lgmd_db, _ball(plan)),
    }
    results = data[_ball(plan)].results

    def db(label: str) -> Series:
        return np.maximum(results[label].attenuation_db, FLOOR_DB)[3:]

    def rise(db: Series) -> float:
        return float(np.nanmean(db[-3:]) - np.nanmean(db[:3]))

    lgmds = {"": data[rectified][3:], "-signed": db("lgmd")}
    frame = np.arange(3.0, 3.0 + len(db("lgmd")))
    curves = {f"set 7, {v}": (frame, db(f"set7/{v}")) for v in BY_LATENCY}
    curves |= {
        "LGMD, rectified": (frame, lgmds[""]),
        "LGMD, signed": (frame, lgmds["-signed"]),
    }
    near = {name: curve for name, curve in curves.items() if "LGMD" in name}
    panels = [Panel("Looming ball, set 7", curves), Panel("The LGMD alone", near)]
    values = {
        "fig10-rising": by_version(lambda v: rise(db(f"set7/{v}"))),
        "fig10-sharper": by_version(lambda v: rise(db(f"set7/{v}")) - rise(lgmds[""])),
        "fig10-stronger": by_version(lambda v: np.nanmax(db(f"set7/{v}") - db("lgmd"))),
        "fig10-attenuates": by_version(lambda v: np.nanmax(db(f"set7/{v}"))),
    }
    for name, one in lgmds.items():
        values[f"fig10-lgmd{name}"] = {ANY: [float(np.nanmax(one))]}
    values["fig10-lgmd-moderate"] = {ANY: [float(np.nanmin(lgmds[""]))]}
    look: dict[str, Any] = {"share_y": False, "emphasise": f"set 7, {BY_LATENCY[0]}"}
    draw = partial(plot_panels, panels, "Frame", "Attenuation (dB)", **look)
    return Evidence(values, {"fig10": draw})


def fig12(plan: Plan) -> Steps:
    """The responses of sets 1 to 6 to a looming ball."""
    data = yield {_ball(plan): _SETS_1_TO_6}
    results = data[_ball(plan)].results

    def k(number: int, version: str) -> Series:
        return results[f"set{number}/{version}"].mp[3:]

    def early(wide: int, narrow: int, version: str) -> float:
        a, b = k(wide, version), k(narrow, version)
        half = len(a) // 2
        return float(a[:half].sum() / b[:half].sum()) if b[:half].any() else np.nan

    def contact(wide: int, narrow: int, version: str) -> float:
        return float(k(wide, version).max() / k(narrow, version).max())

    def steeper(version: str) -> float:
        """How much more a radial set grows in the frames before its peak, the worst pair."""

        def rise(number: int) -> float:
            mp = k(number, version)
            peak = int(np.argmax(mp))
            return float(mp[peak] / mp[peak - _RISE]) if mp[peak - _RISE] else np.nan

        return float(np.min([rise(radial) / rise(plain) for radial, plain in _PAIRS]))

    def sharper(version: str) -> float:
        found = [results[f"set{n}/{version}"].sharpness for n in range(1, 7)]
        return max(found[radial - 1] / found[plain - 1] for radial, plain in _PAIRS)

    raw, scaled = [], []
    for v in SHOWN:
        own = {f"set {n}": results[f"set{n}/{v}"] for n in range(1, 7)}
        frame = np.arange(float(len(own["set 1"])))
        raw.append(Panel(v, {name: (frame, positive(r.mp)) for name, r in own.items()}))
        last = slice(-_NEAR, None)
        scaled.append(
            Panel(v, {n: (frame[last], positive(share_of_peak(r)[last])) for n, r in own.items()})
        )
    values = {
        "fig12a-early-plain": by_version(partial(early, 3, 1)),
        "fig12a-early-radial": by_version(partial(early, 6, 4)),
        "fig12a-contact-plain": by_version(partial(contact, 3, 1)),
        "fig12a-contact-radial": by_version(partial(contact, 6, 4)),
        "fig12a-steeper": by_version(steeper),
        "fig12b-order": by_version(sharper),
        "fig12b-sharper": by_version(sharper),
    }
    figures = {
        "fig12a": partial(plot_panels, raw, "Frame", "Raw K", log_y=True),
        "fig12b": partial(plot_panels, scaled, "Frame", "K / max K", log_y=True),
    }
    return Evidence(values, figures)


# Frames before contact in the figure of the scaled responses; and over which raw K rises.
_NEAR, _RISE = 15, 5
# Only 1 px/frame is suppressed if at most a tenth of its change passes, and half at other speeds.
_SUPPRESSED_DB, _FREE_DB = -10.0, -3.0


def sweep_cubes(a: float, grid: Grid, n_frames: int | None) -> SweepResult:
    """The attenuation of cubes at 1 to 4 px/frame for every point of a grid."""
    params = load_set(1, **{**FIG_11, "a": a})
    subject = cube_input(SPEEDS_PX, SIDE_PX, n_frames, SIZE_WH, int(FIG_11["r"]))
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        sweep = Sweep(Path(folder), subject, grid, Setup(params, "fig11", "opencv"))
        sweep.compute()
        return sweep.result


def fig11(plan: Plan) -> Steps:
    """The attenuation of cubes over the widths of excitation and inhibition."""
    step_e, step_i = (0.2, 0.5) if plan.quick else (0.1, 0.25)
    grid = Grid(
        Axis.parse(f"sigma_e=0.2:2:{step_e}", DlgmdParameters),
        Axis.parse(f"sigma_i=0.5:6:{step_i}", DlgmdParameters),
    )
    sweep = partial(sweep_cubes, grid=grid, n_frames=21 if plan.quick else None)
    # Without latency, all versions have the same S.
    strengths = {"fig11": FIG_11["a"], f"fig11{NULL}": 0.0}
    data = yield {name: partial(sweep, a) for name, a in strengths.items()}
    maps = {name: np.maximum(data[name].columns["attenuation_db"], FLOOR_DB) for name in strengths}

    def of(measure: Callable[[Series], float]) -> dict[str, list[float]]:
        return by_version(lambda v: measure(maps[f"fig11{NULL}" if v.endswith(NULL) else "fig11"]))

    def slower(db: Series) -> float:
        """The pair of neighbouring speeds that agrees least."""
        return float((np.diff(db, axis=0) >= 0.0).mean(axis=(1, 2)).min())

    def alone(db: Series) -> float:
        slow, others = db[0], db[1:]
        return float(((slow <= _SUPPRESSED_DB) & (others >= _FREE_DB).all(axis=0)).mean())

    # A kernel with r = 4 cuts off wider Gaussians.
    n_within = sum(value <= FIG_11["r"] for value in grid.y.values)
    values = {
        "fig11-speed": of(slower),
        "fig11-sigma-i": of(lambda db: (np.diff(db[2:], axis=1) <= 0.0).mean()),
        "fig11-sigma-i-within": of(lambda db: (np.diff(db[2:, :n_within], axis=1) <= 0.0).mean()),
        "fig11-sigma-e": of(lambda db: (np.diff(db[2:], axis=2) >= 0.0).mean()),
        "fig11-alone": of(alone),
    }
    return Evidence(values, {"fig11": partial(plot_sweep, data["fig11"], "two")})


_LATERAL = Clip.of("translating-cubes", size=SIZE, object_size=160.0, speed=(12.0,))


def lateral(plan: Plan) -> Steps:
    """The response to a large square that translates fast."""
    data = yield {_LATERAL: all_versions("set9")}
    results = data[_LATERAL].results
    curves = {v: (results[f"set9/{v}"].frame * 1.0, results[f"set9/{v}"].mp_abs) for v in FEW}
    panel = Panel("Square of 160 px at 12 px/frame", curves, level=0.4)
    level = by_version(lambda v: np.nanmedian(results[f"set9/{v}"].mp_abs))
    draw = partial(plot_panels, [panel], "Frame", "mp_abs")
    return Evidence({"lateral-alarms": level}, {"lateral": draw})


EXHIBITS: dict[str, Exhibit] = {
    one.__name__: one
    for one in (fig2, fig5, fig6, fig8, fig9, fig10, fig11, fig12, lateral, strength)
}
