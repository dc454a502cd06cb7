"""The exhibits with simple stimuli: geometry, kernels, looming, receding and translation."""

import math
from collections.abc import Callable, Mapping
from functools import partial
from itertools import product

import numpy as np
import numpy.typing as npt

from dlgmd_cli import DLGMD, DlgmdParameters, Result, load_set, sweep
from dlgmd_cli.lab.paper.clips import (
    NULL,
    VERSIONS,
    Clip,
    Models,
    Series,
    Value,
    all_versions,
    model,
    rectified_lgmd_db,
    reference_clip,
)
from dlgmd_cli.lab.paper.panels import Panel, plot_panels
from dlgmd_cli.lab.paper.plan import ANY, Data, Evidence, Plan, Steps, by_version
from dlgmd_cli.plots.style import FLOOR_DB

# K of a single cell for a change of one grey level, in luminance²: a lower peak is rounding.
LEAST_PEAK = 1.0 / 255.0**2
# Least response, as a share of the peak: in a figure, less cannot be told from zero.
ONSET = 0.05
# The LGMD, read by its own sigmoid.
SIGMOID = "lgmd/sigmoid"
SIZE = "480x270"
# Sets that differ only in their latency: radial, and none.
_PAIRS = ((4, 1), (5, 2), (6, 3))


def pooled_db(result: Result, first: int = 0, last: int | None = None) -> float:
    """The attenuation 10 lg(ΣΣS / ΣΣP) over frames `first` to `last`, in dB.

    It is -inf if nothing passes, and NaN if nothing changes. A mean of decibels would depend on
    what stands for the frames through which nothing passes.
    """
    end = int(result.frame[-1]) if last is None else last
    within = (result.frame >= first) & (result.frame <= end) & ~np.isnan(result.s_sum)
    passed, changed = float(result.s_sum[within].sum()), float(result.p_sum[within].sum())
    if changed <= 0.0:
        return np.nan
    return 10.0 * math.log10(passed / changed) if passed > 0.0 else -math.inf


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


# Versions in figures with a panel each; of both codes and the text; and with few curves.
SHOWN = tuple(version for version in VERSIONS if not version.endswith("2021"))
FEW, TWO = ("default", "released-2020", "equations"), ("default", "equations")


def fig5(plan: Plan) -> Steps:
    """The latency of inhibition by distance, and the kernels."""
    yield {}
    params = load_set(9)
    along = DLGMD(params).latency()[params.r, params.r :]

    def spread(version: str) -> float:
        """The share of the excitation off the centre, the least of sets 7 to 9."""
        each = [DLGMD(load_set(n, **VERSIONS[version])).connections.excitation for n in (7, 8, 9)]
        return min(1.0 - float(k[len(k) // 2, len(k) // 2] / k.sum()) for k in each)

    def held(number: int) -> float:
        """The share of the widest Gaussian of a set that its kernel holds."""
        params = load_set(number)
        whole = _gaussian(int(6 * params.sigma_i), params.sigma_i).sum()
        return float(_gaussian(params.r, params.sigma_i).sum() / whole)

    values = {
        "fig5-rises": {ANY: [float(np.diff(along).min())]},
        "fig5-excitation": by_version(spread, VERSIONS),
        "fig5-kernel-r4": {ANY: [held(7)]},
        "fig5-kernel-r6": {ANY: [held(8)]},
    }
    panels = [_kernel_panel(version) for version in FEW]
    draw = partial(plot_panels, panels, "Distance from the centre (px)", "Strength", dots=True)
    return Evidence(values, {"fig5": draw})


def _kernel_panel(version: str) -> Panel:
    """The connections of set 9 along an axis: excitation, and inhibition by its delay."""
    params = load_set(9, **VERSIONS[version])
    connections, along = DLGMD(params).connections, np.s_[params.r, params.r :]
    distance = np.arange(params.r + 1.0)
    curves = {"excitation": (distance, connections.excitation[along])}
    for delay, kernel in sorted(connections.inhibition.items()):
        curves[f"inhibition, {delay} frames late"] = distance, kernel[along]
    return Panel(f"set 9, {version}", curves)


def _gaussian(radius_px: int, sigma_px: float) -> Series:
    """The Gaussian of a connection at each tap, (2r + 1, 2r + 1), Eq. (4)."""
    along = np.exp(-(np.arange(-radius_px, radius_px + 1.0) ** 2) / (2.0 * sigma_px**2))
    return np.outer(along, along) / (sigma_px * math.sqrt(2.0 * math.pi))


# The cubes of Figs. 6 and 11: speeds in px/frame, side in px; and the parameters of Fig. 11 that
# its axes do not vary. No latency, as a comment in the paper's source says; a and r are ours.
SPEEDS_PX, SIDE_PX = (1.0, 2.0, 3.0, 4.0), 40.0
_FIG_11: dict[str, Value] = {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4}
_LGMD: Models = {"lgmd": "lgmd"}
_SETS_1_TO_6 = all_versions(*range(1, 7))


def cube_clip(speed: float) -> Clip:
    """A black square on white that translates at a speed in px/frame."""
    shown = {"contrast": -1.0, "background": 1.0, "object_size": SIDE_PX, "frames": 31}
    return Clip.of("translating-cubes", size="200x100", speed=speed, **shown)


def _cube_db(data: Data, label: str) -> Series:
    """The attenuation of a cube at each of `SPEEDS_PX`."""
    levels = [pooled_db(data[cube_clip(speed)].results[label]) for speed in SPEEDS_PX]
    return np.maximum(levels, FLOOR_DB)


def _met(number: int, version: str, speed: int) -> dict[int, float]:
    """The inhibition by delay, relative to g, that a moving point leaves where it is later."""
    params = load_set(number, **VERSIONS[version])
    kernels, r = DLGMD(params).connections.inhibition, params.r
    alone = params.a * _gaussian(r, params.sigma_i)[r, r:]
    return {d: k[r, r + speed * d] / alone[1] for d, k in kernels.items() if 0 < d * speed <= r}


def _replicate(version: str) -> float:
    """The share of two frames ago in the inhibition at 1 px/frame, the least of sets 4 to 9."""
    each = [_met(number, version, 1) for number in range(4, 10)]
    return min(met.get(2, 0.0) / (sum(met.values()) or 1.0) for met in each)


def _not_escaped(version: str) -> float:
    """The inhibition at 4 px/frame by that with a latency of one frame; the most of the sets."""
    kept = (sum(_met(n, version, 4).values()) / _met(m, version, 4)[1] for n, m in _PAIRS)
    return float(max(kept))


def fig6(plan: Plan) -> Steps:
    """The attenuation of cubes by their speed, with and without radial latency."""
    data = yield {cube_clip(speed): _SETS_1_TO_6 | _LGMD for speed in SPEEDS_PX}

    def preference(version: str) -> float:
        """How much more the attenuation changes with speed than the LGMD's, the least of sets."""
        labels = [*(f"set{radial}/{version}" for radial, _ in _PAIRS), "lgmd"]
        *of_sets, lgmd = (db[-1] - db[0] for db in (_cube_db(data, label) for label in labels))
        return float(min(of_sets) - lgmd)

    def gain(version: str) -> Series:
        """The attenuation with radial latency minus that without, by pair of sets and speed."""
        pairs = [[_cube_db(data, f"set{n}/{version}") for n in pair] for pair in _PAIRS]
        return np.array([radial - plain for radial, plain in pairs])

    def alike(version: str) -> float:
        """The attenuation at the greatest speed minus that at the least, without radial latency."""
        each = (_cube_db(data, f"set{plain}/{version}") for _, plain in _PAIRS)
        return float(max(db[-1] - db[0] for db in each))

    def removed(version: str) -> float:
        """The peak of K at the least speed by that at the greatest, the most of the sets."""

        def peak(number: int, speed: float) -> float:
            return float(np.nanmax(data[cube_clip(speed)].results[f"set{number}/{version}"].mp))

        return max(peak(n, SPEEDS_PX[0]) / peak(n, SPEEDS_PX[-1]) for n, _ in _PAIRS)

    speeds = np.array(SPEEDS_PX)
    sets = [number for pair in _PAIRS for number in pair[::-1]]
    panels = [
        Panel(v, {f"set {n}": (speeds, _cube_db(data, f"set{n}/{v}")) for n in sets}) for v in FEW
    ]
    draw = partial(plot_panels, panels, "Speed (px/frame)", "Attenuation (dB)", dots=True)
    values = {
        "fig6-slow": by_version(lambda v: gain(v)[:, 0].max()),
        "fig6-fast": by_version(lambda v: gain(v)[:, -1].min()),
        "fig6-replicate": by_version(_replicate, VERSIONS),
        "fig6-escapes": by_version(_not_escaped, VERSIONS),
        "fig6-preference": by_version(preference),
        "fig6-alike": by_version(alike),
        "fig6-removed": by_version(removed),
    }
    return Evidence(values, {"fig6": draw})


_APPROACHES = {
    "cube": Clip.of("looming-cube", size=SIZE),
    "receding": Clip.of("receding-cube", size=SIZE),
}
LGMDS = {"lgmd": "LGMD (K)", SIGMOID: "LGMD (sigmoid)"}


def fig9(plan: Plan) -> Steps:
    """Set 9 and the LGMD while a cube approaches or recedes."""
    data = yield dict.fromkeys(_APPROACHES.values(), all_versions(9) | _LGMD)
    results = {kind: data[clip].results for kind, clip in _APPROACHES.items()}

    def frames(kind: str, label: str) -> npt.NDArray[np.intp]:
        """The frames at which a level reaches `ONSET`."""
        return np.flatnonzero(level(results[kind], label) >= ONSET)

    def silent(version: str) -> float:
        """The share of the looming cube's clip before K exceeds `_SILENT` of its peak."""
        shown = share_of_peak(results["cube"][f"set9/{version}"])
        return float(np.argmax(shown > _SILENT) / n_cube)

    def bent(version: str) -> float:
        """The mean level from the first response to the peak."""
        shown = share_of_peak(results["cube"][f"set9/{version}"])
        return float(shown[np.argmax(shown > _SILENT) : np.argmax(shown) + 1].mean())

    def after(other: int, version: str) -> float:
        """The first frame at which set 9 responds to the looming cube, minus another."""
        answers = frames("cube", f"set9/{version}")
        return float((answers[0] if answers.size else n_cube) - other)

    def last_active(version: str) -> float:
        """The last frame of the receding cube at which K is above 0, as a share of the clip."""
        active = np.flatnonzero(np.nan_to_num(results["receding"][f"set9/{version}"].mp) > 0.0)
        return float(active[-1] / n_cube) if active.size else 0.0

    def sharper(version: str) -> float:
        return results["cube"][f"set9/{version}"].sharpness / results["cube"]["lgmd"].sharpness

    n_cube = len(results["cube"]["lgmd"])
    values = {"fig9a-silent": by_version(silent), "fig9b-rest": by_version(last_active)}
    values |= {"fig9a-nonlinear": by_version(bent), "fig9a-frame-15": {ANY: [math.nan]}}
    for name, label in (("", SIGMOID), ("-raw", "lgmd")):
        onset, end = frames("cube", label)[0], frames("receding", label)[-1]
        values[f"fig9a-later{name}"] = by_version(partial(after, onset))
        values[f"fig9b-lgmd{name}"] = {ANY: [end / n_cube]}
        shown_lgmd = level(results["cube"], label)[onset:]
        values[f"fig9a-lgmd{name}"] = {ANY: [float((np.diff(shown_lgmd) > 0.0).mean())]}
    values["fig9a-sharper"] = by_version(sharper)
    draw = partial(plot_panels, _panels_9(results), "Time (s)", "Level", share_x=False)
    return Evidence(values, {"fig9": draw})


def _panels_9(results: Mapping[str, Mapping[str, Result]]) -> list[Panel]:
    """The levels of each approach, whole and near the greatest response."""
    shown = {f"set9/{v}": f"set 9, {v}" for v in TWO} | LGMDS

    def panel(title: str, kind: str, first: int = 0, last: int | None = None) -> Panel:
        time_s = results[kind]["lgmd"].time_s[first:last]
        curves = {
            text: (time_s, level(results[kind], label)[first:last]) for label, text in shown.items()
        }
        return Panel(title, curves, level=ONSET)

    return [
        panel("Looming cube", "cube"),
        panel("Its last second", "cube", -_SECOND),
        panel("Receding cube", "receding"),
        panel("Its first second", "receding", 0, _SECOND),
    ]


# Frames in a second of the clips; the share of the peak below which a model is silent.
_SECOND, _SILENT = 30, 1e-4


def looming_ball(plan: Plan) -> Clip:
    """The looming ball of Figs. 10 and 12: the authors', or the tool's own."""
    return reference_clip(plan.reference, "looming-ball", size=SIZE)


def fig10(plan: Plan) -> Steps:
    """The attenuation of a looming ball."""
    rectified = f"the rectified LGMD, {plan.name}"
    data = yield {
        looming_ball(plan): all_versions(7) | _LGMD,
        rectified: partial(rectified_lgmd_db, looming_ball(plan)),
    }
    results = data[looming_ball(plan)].results

    def db(label: str) -> Series:
        return np.maximum(results[label].attenuation_db, FLOOR_DB)[3:]

    def rise(db: Series) -> float:
        return float(np.nanmean(db[-3:]) - np.nanmean(db[:3]))

    def slope(db: Series) -> float:
        """The rise a frame over the last frames."""
        return float((np.nanmean(db[-3:]) - np.nanmean(db[-3 - _FINAL : -_FINAL])) / _FINAL)

    lgmds = {"": data[rectified][3:], "-signed": db("lgmd")}
    frame = np.arange(3.0, 3.0 + len(db("lgmd")))
    curves = {f"set 7, {v}": (frame, db(f"set7/{v}")) for v in FEW}
    curves |= {"LGMD, rectified": (frame, lgmds[""]), "LGMD, signed": (frame, lgmds["-signed"])}
    near = {name: curve for name, curve in curves.items() if "LGMD" in name}
    panels = [Panel("Looming ball, set 7", curves), Panel("The LGMD alone", near)]
    values = {
        "fig10-rising": by_version(lambda v: rise(db(f"set7/{v}"))),
        "fig10-sharper": by_version(lambda v: slope(db(f"set7/{v}")) - slope(lgmds[""])),
        "fig10-stronger": by_version(
            lambda v: np.nanmean(db(f"set7/{v}")[:_INITIAL]) - np.nanmean(lgmds[""][:_INITIAL])
        ),
        "fig10-attenuates": by_version(lambda v: np.nanmax(db(f"set7/{v}"))),
    }
    for name, levels in lgmds.items():
        values[f"fig10-lgmd{name}"] = {ANY: [float(np.nanmax(levels))]}
    smooth = np.convolve(lgmds[""], np.ones(3) / 3.0, "valid")
    values["fig10-lgmd-steady"] = {ANY: [float((np.diff(smooth) > 0.0).mean())]}
    values["fig10-lgmd-moderate"] = {ANY: [float(np.nanmin(lgmds[""]))]}
    draw = partial(
        plot_panels,
        panels,
        "Frame",
        "Attenuation (dB)",
        share_y=False,
        emphasise=f"set 7, {FEW[0]}",
    )
    return Evidence(values, {"fig10": draw})


# Frames of the initial period, a quarter of the authors' clip; and near the collision.
_INITIAL, _FINAL = 6, 5


def fig12(plan: Plan) -> Steps:
    """The responses of sets 1 to 6 to a looming ball."""
    data = yield {looming_ball(plan): _SETS_1_TO_6}
    results = data[looming_ball(plan)].results

    def k(number: int, version: str) -> Series:
        return results[f"set{number}/{version}"].mp[3:]

    def early_db(version: str) -> float:
        """What each step of σ_I adds to the attenuation in the first half; the lesser effect."""
        middle = 3 + len(k(4, version)) // 2
        db = [pooled_db(results[f"set{n}/{version}"], 3, middle - 1) for n in (4, 5, 6)]
        return float(np.diff(np.maximum(db, FLOOR_DB)).max())

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
        sharpness = [results[f"set{n}/{version}"].sharpness for n in range(1, 7)]
        return max(sharpness[radial - 1] / sharpness[plain - 1] for radial, plain in _PAIRS)

    raw, scaled = [], []
    for v in SHOWN:
        by_set = {f"set {n}": results[f"set{n}/{v}"] for n in range(1, 7)}
        frame = np.arange(float(len(by_set["set 1"])))
        raw.append(Panel(v, {name: (frame, positive(r.mp)) for name, r in by_set.items()}))
        last = slice(-_NEAR, None)
        near = {n: (frame[last], positive(share_of_peak(r)[last])) for n, r in by_set.items()}
        scaled.append(Panel(v, near))
    values = {
        "fig12a-early-radial": by_version(early_db),
        "fig12a-contact-radial": by_version(lambda v: min(contact(5, 4, v), contact(6, 5, v))),
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


# The radii of Table II, and the greatest widths of the two ranges in the codes' comments.
_RADII, _RANGES = (4, 6), ((1.0, 4.0), (1.5, 6.0))
_CONSTANT, _RADIAL = "constant", "radial"


def fig11(plan: Plan) -> Steps:
    """The attenuation of cubes over the widths of excitation and inhibition.

    The paper states neither latency nor radius nor ranges: each claim has a value for each.
    """
    step_e, step_i, n_frames = (0.2, 0.8, 21) if plan.quick else (0.1, 0.2, None)
    x, y = f"sigma_e=0.4:1.5:{step_e}", f"sigma_i=1.6:6:{step_i}"
    # With a constant latency, and without inhibition, all versions have the same S.
    settings: dict[tuple[str, int], DlgmdParameters] = {
        (_CONSTANT, r): load_set(1, **{**_FIG_11, "r": r}) for r in _RADII
    }
    settings |= {(NULL, r): load_set(1, **{**_FIG_11, "a": 0.0, "r": r}) for r in _RADII}
    by_latency = {model(4, v).to_dict()["latency"]: v for v in VERSIONS}
    settings |= {(v, r): model(4, v, r=r) for v in by_latency.values() for r in _RADII}
    data = yield {
        f"fig11, {at}": partial(sweep, model=params, x=x, y=y, jobs=1, frames=n_frames)
        for at, params in settings.items()
    }
    maps = {
        at: np.maximum(data[f"fig11, {at}"].columns["attenuation_db"], FLOOR_DB) for at in settings
    }
    grid = data[f"fig11, {(_CONSTANT, _RADII[0])}"].grid

    def of(measure: Callable[[Series], float], version: str) -> list[float]:
        """The values of a claim with each latency, radius and range, in the order of the rows."""
        latency = by_latency[model(4, version).to_dict()["latency"]]
        latencies = (NULL, NULL) if version.endswith(NULL) else (_CONSTANT, latency)
        sigma_e, sigma_i = np.array(grid.x.values), np.array(grid.y.values)
        return [
            measure(maps[latency, r][:, sigma_i <= top_i][:, :, sigma_e <= top_e])
            for latency, r, (top_e, top_i) in product(latencies, _RADII, _RANGES)
        ]

    def slower(db: Series) -> float:
        """The pair of neighbouring speeds that agrees least."""
        return float((np.diff(db, axis=0) > 0.0).mean(axis=(1, 2)).min())

    def alone(db: Series) -> float:
        slow, others = db[0], db[1:]
        return float(((slow <= _SUPPRESSED_DB) & (others >= _FREE_DB).all(axis=0)).mean())

    measures: dict[str, Callable[[Series], float]] = {
        "fig11-speed": slower,
        "fig11-sigma-i": lambda db: float((np.diff(db[2:], axis=1) < 0.0).mean()),
        "fig11-sigma-e": lambda db: float((np.diff(db[2:], axis=2) > 0.0).mean()),
        "fig11-alone": alone,
    }
    values = {key: by_version(partial(of, measure)) for key, measure in measures.items()}
    header = ("version", "latency", "r", "σ_E to", "σ_I to", "slower more", "σ_I", "σ_E", "1 alone")
    rows: list[tuple[Value, ...]] = [header]
    for v in FEW:
        each = zip(*(values[key][v] for key in measures), strict=True)
        places = product((_CONSTANT, _RADIAL), map(str, _RADII), _RANGES)
        rows += [(v, t, r, *top, *values) for (t, r, top), values in zip(places, each, strict=True)]
    shown = {"fig11": (_CONSTANT, _RADII[0]), "fig11-radial": ("equations", _RADII[1])}
    drawn = {n: partial(data[f"fig11, {at}"].plot, width="two") for n, at in shown.items()}
    return Evidence(values, drawn, {"Shares of the map, by what the paper leaves open": rows})
