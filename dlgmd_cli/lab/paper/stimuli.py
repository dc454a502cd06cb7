"""The exhibits with simple stimuli: geometry, kernels, looming, receding and translation."""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import partial
from itertools import product

import numpy as np
import numpy.typing as npt

from dlgmd_cli import DLGMD, DlgmdParameters, Result, load_set, sweep
from dlgmd_cli.lab.paper.clips import (
    EVERY,
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
from dlgmd_cli.lab.paper.free import FREE, frames, free
from dlgmd_cli.lab.paper.panels import Panel, plot_panels
from dlgmd_cli.lab.paper.plan import ANY, FEW, Data, Evidence, Plan, Steps, by_version
from dlgmd_cli.plots.style import FLOOR_DB

# K of a single cell for a change of one grey level, in luminance²: a lower peak is rounding.
LEAST_PEAK = 1.0 / 255.0**2
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


# Versions in figures with a panel each, and with few curves.
SHOWN = tuple(version for version in VERSIONS if not version.endswith("2021"))
TWO = ("default", "equations")


def fig5(plan: Plan) -> Steps:
    """The latency of inhibition by distance, and the kernels."""
    yield {}
    params = load_set(9)
    along = DLGMD(params).latency()[params.r, params.r :]

    def kernels(version: str, *numbers: int) -> list[npt.NDArray[np.float64]]:
        return [DLGMD(load_set(n, **VERSIONS[version])).connections.excitation for n in numbers]

    def spread(numbers: Iterable[int], version: str) -> float:
        """The share of the excitation off the centre, the least of some sets."""
        each = kernels(version, *numbers)
        return min(1.0 - float(k[len(k) // 2, len(k) // 2] / k.sum()) for k in each)

    def neighbours(numbers: Iterable[int], version: str) -> float:
        """The number of neighbours with a hundredth of the excitation, the least of some sets."""
        each = kernels(version, *numbers)
        return min(np.count_nonzero(k >= 0.01 * k.sum()) - 1.0 for k in each)

    def held(number: int) -> float:
        """The share of the widest Gaussian of a set that its kernel holds."""
        params = load_set(number)
        whole = _gaussian(int(6 * params.sigma_i), params.sigma_i).sum()
        return float(_gaussian(params.r, params.sigma_i).sum() / whole)

    values = {
        "fig5-rises": {ANY: [float(np.diff(along).min())]},
        "fig5-excitation": by_version(partial(spread, (7, 8, 9)), VERSIONS),
        "fig5-excitation~neighbours": by_version(partial(neighbours, (7, 8, 9)), VERSIONS),
        "fig5-set3": by_version(partial(spread, (3,)), VERSIONS),
        "fig5-set3~neighbours": by_version(partial(neighbours, (3,)), VERSIONS),
        # A kernel is a square: what it holds along an axis is the root.
        "fig5-kernel-r4": {ANY: [held(7)]},
        "fig5-kernel-r4~axis": {ANY: [math.sqrt(held(7))]},
        "fig5-kernel-r6": {ANY: [held(8)]},
        "fig5-kernel-r6~axis": {ANY: [math.sqrt(held(8))]},
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


def _replicate(version: str) -> list[float]:
    """The share of two frames ago in the inhibition at 1 px/frame, of sets 4 to 9."""
    each = [_met(number, version, 1) for number in range(4, 10)]
    return [met.get(2, 0.0) / (sum(met.values()) or 1.0) for met in each]


def _not_escaped(version: str) -> list[float]:
    """The inhibition at 4 px/frame by that with a latency of one frame, of each pair of sets."""
    return [sum(_met(n, version, 4).values()) / _met(m, version, 4)[1] for n, m in _PAIRS]


def fig6(plan: Plan) -> Steps:
    """The attenuation of cubes by their speed, with and without radial latency."""
    data = yield {cube_clip(speed): _SETS_1_TO_6 | _LGMD for speed in SPEEDS_PX}

    def preference(version: str) -> list[float]:
        """How much more the attenuation changes with speed than the LGMD's, by set."""
        labels = [*(f"set{radial}/{version}" for radial, _ in _PAIRS), "lgmd"]
        *of_sets, lgmd = (db[-1] - db[0] for db in (_cube_db(data, label) for label in labels))
        return [each - lgmd for each in of_sets]

    def gain(version: str) -> Series:
        """The attenuation with radial latency minus that without, by pair of sets and speed."""
        pairs = [[_cube_db(data, f"set{n}/{version}") for n in pair] for pair in _PAIRS]
        return np.array([radial - plain for radial, plain in pairs])

    def alike(version: str) -> list[float]:
        """The attenuation at the greatest speed minus that at the least, without radial latency."""
        each = (_cube_db(data, f"set{plain}/{version}") for _, plain in _PAIRS)
        return [db[-1] - db[0] for db in each]

    def removed(version: str) -> list[float]:
        """The peak of K at the least speed by that at the greatest, by set."""

        def peak(number: int, speed: float) -> float:
            return float(np.nanmax(data[cube_clip(speed)].results[f"set{number}/{version}"].mp))

        return [peak(n, SPEEDS_PX[0]) / peak(n, SPEEDS_PX[-1]) for n, _ in _PAIRS]

    speeds = np.array(SPEEDS_PX)
    sets = [number for pair in _PAIRS for number in pair[::-1]]
    panels = [
        Panel(v, {f"set {n}": (speeds, _cube_db(data, f"set{n}/{v}")) for n in sets}) for v in FEW
    ]
    draw = partial(plot_panels, panels, "Speed (px/frame)", "Attenuation (dB)", dots=True)
    values = {
        **_pooled("fig6-slow", max, lambda v: gain(v)[:, 0]),
        **_pooled("fig6-fast", min, lambda v: gain(v)[:, -1]),
        **_pooled("fig6-replicate", min, _replicate, VERSIONS),
        **_pooled("fig6-escapes", max, _not_escaped, VERSIONS),
        **_pooled("fig6-preference", min, preference),
        **_pooled("fig6-alike", max, alike),
        **_pooled("fig6-removed", max, removed),
    }
    return Evidence(values, {"fig6": draw})


def _pooled(
    name: str,
    worst: Callable[..., float],
    of: Callable[[str], Iterable[float]],
    versions: Iterable[str] = EVERY,
) -> dict[str, dict[str, list[float]]]:
    """What several sets give, as the worst of them, and as the one in the middle."""
    pools: dict[str, Callable[..., float]] = {"": worst, "~middle": np.median}

    def value(pool: Callable[..., float], version: str) -> float:
        return float(pool([*of(version)]))

    return {name + how: by_version(partial(value, pool), versions) for how, pool in pools.items()}


_APPROACHES = {
    "cube": Clip.of("looming-cube", size=SIZE),
    "receding": Clip.of("receding-cube", size=SIZE),
}
LGMDS = {"lgmd": "LGMD (K)", SIGMOID: "LGMD (sigmoid)"}


def fig9(plan: Plan) -> Steps:
    """Set 9 and the LGMD while a cube approaches or recedes."""
    data = yield dict.fromkeys(_APPROACHES.values(), all_versions(9) | _LGMD)
    results = {kind: data[clip].results for kind, clip in _APPROACHES.items()}

    def reaching(kind: str, label: str, least: float) -> npt.NDArray[np.intp]:
        """The frames at which a level reaches a value."""
        return np.flatnonzero(level(results[kind], label) >= least)

    def silent(least: str, version: str) -> float:
        """The share of the looming cube's clip before K exceeds a share of its peak."""
        shown = share_of_peak(results["cube"][f"set9/{version}"])
        return float(np.argmax(shown > free(least)) / n_cube)

    def rise(shown: Series) -> Series:
        """A level from the first response to the peak."""
        return shown[np.argmax(shown > free("silent")) : np.argmax(shown) + 1]

    def risen(version: str) -> Series:
        return rise(share_of_peak(results["cube"][f"set9/{version}"]))

    def after(other: int, least: float, version: str) -> float:
        """The first frame at which set 9 responds to the looming cube, minus another."""
        answers = reaching("cube", f"set9/{version}", least)
        return float((answers[0] if answers.size else n_cube) - other)

    def last_active(least: float, version: str) -> float:
        """The last frame of the receding cube at which K is above a share of its peak, by all."""
        active = np.flatnonzero(share_of_peak(results["receding"][f"set9/{version}"]) > least)
        return float(active[-1] / n_cube) if active.size else 0.0

    def sharper(version: str) -> float:
        return results["cube"][f"set9/{version}"].sharpness / results["cube"]["lgmd"].sharpness

    def shorter(version: str) -> float:
        """The number of frames above half of the peak by that of the LGMD."""
        return len(reaching("cube", f"set9/{version}", 0.5)) / len(reaching("cube", "lgmd", 0.5))

    def enhances(pool: Callable[..., float], version: str) -> float:
        """The attenuation of the last frames before contact, pooled."""
        return float(pool(results["cube"][f"set9/{version}"].attenuation_db[-frames("looming") :]))

    def weaker(pool: Callable[..., float], version: str) -> float:
        """K of the receding cube by that of the looming one, relative to the LGMD's."""
        receding, cube = (results[kind] for kind in ("receding", "cube"))
        shares = [pool(receding[m].mp) / pool(cube[m].mp) for m in (f"set9/{version}", "lgmd")]
        return float(shares[0] / shares[1])

    n_cube, onset = len(results["cube"]["lgmd"]), free("onset")
    risen_lgmd = rise(sigmoid(results["cube"]["lgmd"]))
    values = {
        "fig9a-silent": by_version(partial(silent, "silent")),
        "fig9a-silent~visible": by_version(partial(silent, "onset")),
        "fig9a-nonlinear": by_version(lambda v: float(risen(v).mean())),
        "fig9a-nonlinear~half": by_version(lambda v: float(risen(v)[len(risen(v)) // 2])),
        "fig9a-lgmd-nonlinear": {ANY: [float(risen_lgmd.mean())]},
        "fig9a-lgmd-nonlinear~half": {ANY: [float(risen_lgmd[len(risen_lgmd) // 2])]},
        "fig9a-enhances": by_version(partial(enhances, np.nanmax)),
        "fig9a-enhances~middle": by_version(partial(enhances, np.nanmedian)),
        "fig9b-weaker": by_version(partial(weaker, np.nanmax)),
        "fig9b-weaker~sum": by_version(partial(weaker, np.nansum)),
        "fig9a-frame-15": {ANY: [math.nan]},
        "fig9b-rest": by_version(partial(last_active, 0.0)),
        "fig9b-rest~visible": by_version(partial(last_active, onset)),
        "fig9a-sharper": by_version(sharper),
        "fig9a-sharper~half": by_version(shorter),
    }
    for name, label in (("", SIGMOID), ("-raw", "lgmd")):
        for how, least in (("", onset), ("~half", 0.5)):
            first, last = reaching("cube", label, least)[0], reaching("receding", label, least)[-1]
            values[f"fig9a-later{name}{how}"] = by_version(partial(after, first, least))
            values[f"fig9b-lgmd{name}{how}"] = {ANY: [last / n_cube]}
        shown_lgmd = level(results["cube"], label)[reaching("cube", label, onset)[0] :]
        smooth = np.convolve(shown_lgmd, np.ones(3) / 3.0, "valid")
        for how, curve in (("", shown_lgmd), ("~smooth", smooth)):
            values[f"fig9a-lgmd{name}{how}"] = {ANY: [float((np.diff(curve) > 0.0).mean())]}
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
        return Panel(title, curves, level=FREE["onset"].value)

    return [
        panel("Looming cube", "cube"),
        panel("Its last second", "cube", -_SECOND),
        panel("Receding cube", "receding"),
        panel("Its first second", "receding", 0, _SECOND),
    ]


# Frames in a second of the clips.
_SECOND = 30


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

    def rise(n: int, version: str) -> float:
        shown = db(f"set7/{version}")
        return float(np.nanmean(shown[-n:]) - np.nanmean(shown[:n]))

    def slope(n: int, db: Series) -> float:
        """The rise a frame over the last frames, between means of n."""
        last = frames("final")
        return float((np.nanmean(db[-n:]) - np.nanmean(db[-n - last : -last])) / last)

    def sharper(n: int, version: str) -> float:
        return slope(n, db(f"set7/{version}")) - slope(n, lgmds[""])

    def stronger(of: Callable[..., float], version: str) -> float:
        first = np.s_[: frames("initial")]
        return float(of(db(f"set7/{version}")[first]) - of(lgmds[""][first]))

    lgmds = {"": data[rectified][3:], "-signed": db("lgmd")}
    frame = np.arange(3.0, 3.0 + len(db("lgmd")))
    curves = {f"set 7, {v}": (frame, db(f"set7/{v}")) for v in FEW}
    curves |= {"LGMD, rectified": (frame, lgmds[""]), "LGMD, signed": (frame, lgmds["-signed"])}
    near = {name: curve for name, curve in curves.items() if "LGMD" in name}
    panels = [Panel("Looming ball, set 7", curves), Panel("The LGMD alone", near)]
    values = {
        "fig10-rising": by_version(partial(rise, 3)),
        "fig10-rising~five": by_version(partial(rise, 5)),
        "fig10-sharper": by_version(partial(sharper, 3)),
        "fig10-sharper~five": by_version(partial(sharper, 5)),
        "fig10-stronger": by_version(partial(stronger, np.nanmean)),
        "fig10-stronger~middle": by_version(partial(stronger, np.nanmedian)),
        "fig10-attenuates": by_version(lambda v: np.nanmax(db(f"set7/{v}"))),
        "fig10-attenuates~middle": by_version(lambda v: np.nanmedian(db(f"set7/{v}"))),
        "fig10-lgmd-moderate": {ANY: [float(np.nanmin(lgmds[""]))]},
        "fig10-lgmd-moderate~middle": {ANY: [float(np.nanmedian(lgmds[""]))]},
    }
    for name, levels in lgmds.items():
        values[f"fig10-lgmd{name}"] = {ANY: [float(np.nanmax(levels))]}
        values[f"fig10-lgmd{name}~middle"] = {ANY: [float(np.nanmedian(levels))]}
    for how, n in (("", 3), ("~one", 1)):
        smooth = np.convolve(lgmds[""], np.ones(n) / n, "valid")
        values[f"fig10-lgmd-steady{how}"] = {ANY: [float((np.diff(smooth) > 0.0).mean())]}
    draw = partial(
        plot_panels,
        panels,
        "Frame",
        "Attenuation (dB)",
        share_y=False,
        emphasise=f"set 7, {FEW[0]}",
    )
    return Evidence(values, {"fig10": draw})


def fig12(plan: Plan) -> Steps:
    """The responses of sets 1 to 6 to a looming ball."""
    data = yield {looming_ball(plan): _SETS_1_TO_6}
    results = data[looming_ball(plan)].results

    def k(number: int, version: str) -> Series:
        return results[f"set{number}/{version}"].mp[3:]

    def early_db(version: str) -> Series:
        """What each step of σ_I adds to the attenuation in the first half."""
        middle = 3 + len(k(4, version)) // 2
        db = [pooled_db(results[f"set{n}/{version}"], 3, middle - 1) for n in (4, 5, 6)]
        return np.diff(np.maximum(db, FLOOR_DB))

    def control(version: str) -> list[float]:
        return [contact(2, 1, version), contact(3, 2, version)]

    def contact(wide: int, narrow: int, version: str) -> float:
        return float(k(wide, version).max() / k(narrow, version).max())

    def steeper(version: str) -> list[float]:
        """How much more a radial set grows in the frames before its peak, by pair."""

        def rise(number: int) -> float:
            mp = k(number, version)
            peak = int(np.argmax(mp))
            earlier = mp[peak - frames("rise")]
            return float(mp[peak] / earlier) if earlier else np.nan

        return [rise(radial) / rise(plain) for radial, plain in _PAIRS]

    def sharper(version: str) -> list[float]:
        sharpness = [results[f"set{n}/{version}"].sharpness for n in range(1, 7)]
        return [sharpness[radial - 1] / sharpness[plain - 1] for radial, plain in _PAIRS]

    raw, scaled = [], []
    for v in SHOWN:
        by_set = {f"set {n}": results[f"set{n}/{v}"] for n in range(1, 7)}
        frame = np.arange(float(len(by_set["set 1"])))
        raw.append(Panel(v, {name: (frame, positive(r.mp)) for name, r in by_set.items()}))
        last = slice(-_NEAR, None)
        near = {n: (frame[last], positive(share_of_peak(r)[last])) for n, r in by_set.items()}
        scaled.append(Panel(v, near))
    values = {
        "fig12a-early-radial": by_version(lambda v: float(early_db(v).max())),
        "fig12a-early-radial~ends": by_version(lambda v: float(early_db(v).sum())),
        "fig12a-contact-radial": by_version(lambda v: min(contact(5, 4, v), contact(6, 5, v))),
        "fig12a-contact-radial~ends": by_version(partial(contact, 6, 4)),
        "fig12a-control": by_version(lambda v: max(control(v))),
        "fig12a-control~ends": by_version(partial(contact, 3, 1)),
        **_pooled("fig12a-steeper", min, steeper),
        **_pooled("fig12b-order", max, sharper),
        **_pooled("fig12b-sharper", max, sharper),
    }
    figures = {
        "fig12a": partial(plot_panels, raw, "Frame", "Raw K", log_y=True),
        "fig12b": partial(plot_panels, scaled, "Frame", "K / max K", log_y=True),
    }
    return Evidence(values, figures)


# Frames before contact in the figure of the scaled responses.
_NEAR = 15
# The radii of Table II, and the greatest widths of the two ranges in the codes' comments. The first
# reading decides: the source of the paper has a constant latency, in a comment.
_RADII, _RANGES = (4, 6), ((1.5, 6.0), (1.0, 4.0))
_CONSTANT, _RADIAL = "constant", "radial"
_Range = tuple[float, float]


def fig11(plan: Plan) -> Steps:
    """The attenuation of cubes over the widths of excitation and inhibition.

    The paper states neither latency nor radius nor ranges: each claim has a reading for each.
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

    def of(measure: Callable[[Series], float], latency: str, r: int, top: _Range, v: str) -> float:
        """A measure of the map with a latency, a radius and a range."""
        if latency == _RADIAL:
            latency = by_latency[model(4, v).to_dict()["latency"]]
        db = maps[NULL if v.endswith(NULL) else latency, r]
        sigma_e, sigma_i = np.array(grid.x.values), np.array(grid.y.values)
        return measure(db[:, sigma_i <= top[1]][:, :, sigma_e <= top[0]])

    def slower(db: Series) -> float:
        """The pair of neighbouring speeds that agrees least."""
        return float((np.diff(db, axis=0) > 0.0).mean(axis=(1, 2)).min())

    def cut(db: Series, n: int) -> float:
        """The share of the map on which the first n speeds are suppressed, and no other."""
        slow, fast = db[:n] <= free("suppressed"), db[n:] >= free("free")
        return float((slow.all(axis=0) & fast.all(axis=0)).mean())

    def tuned(db: Series) -> float:
        """The number of speeds between which some point of the map cuts."""
        return float(sum(cut(db, n) > 0.0 for n in range(1, len(db))))

    measures: dict[str, Callable[[Series], float]] = {
        "fig11-speed": slower,
        "fig11-sigma-i": lambda db: float((np.diff(db[2:], axis=1) < 0.0).mean()),
        "fig11-sigma-e": lambda db: float((np.diff(db[2:], axis=2) > 0.0).mean()),
        "fig11-alone": partial(cut, n=1),
        "fig11-tuned": tuned,
        "fig11-much": lambda db: float(np.median(db[0] - db[-1])),
    }
    values: dict[str, dict[str, list[float]]] = {}
    for latency, r, top in product((_CONSTANT, _RADIAL), _RADII, _RANGES):
        reading = f"~{latency}-r{r}-{top[0]:g}"
        for key, measure in measures.items():
            values[key + reading] = by_version(partial(of, measure, latency, r, top))
            values.setdefault(key, values[key + reading])
    shown = {"fig11": (_CONSTANT, _RADII[0]), "fig11-radial": ("equations", _RADII[1])}
    drawn = {n: partial(data[f"fig11, {at}"].plot, width="two") for n, at in shown.items()}
    return Evidence(values, drawn)
