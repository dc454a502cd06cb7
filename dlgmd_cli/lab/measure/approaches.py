"""The tables and figures of the page of real approaches: alarms, and measured against true rates.

The true rate is closing speed / distance, from `truth/NAME.csv` beside the labels.
"""

from functools import cache
from pathlib import Path, PurePath
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import dlgmd_cli
from dlgmd_cli.lab.measure.pages import root
from dlgmd_cli.lab.measure.scores import Row, evaluated, number, reference, rows_of, table
from dlgmd_cli.plots.style import house_style, new_figure, save_figure
from dlgmd_cli.results.labels import Case, read_cases

Series = npt.NDArray[np.float64]

# Targets in the labels -> how the page calls them.
TARGETS = {"checkerboard": "chessboard", "stereoboard": "stereo board", "tof": "Crazyflie"}
CHESSBOARD = "chessboard"
# Beginning of the clips' names -> the group, and its images per second. The truth of the Crazyflie
# is motion capture in A, and a sensor of distance in O.
GROUPS = {
    CHESSBOARD: ("chessboard", "60"),
    "stereoboard": ("stereo board", "7–8"),
    "tof_A": ("Crazyflie A", "6–7.5"),
    "tof_O": ("Crazyflie O", "6–7.5"),
}
# Rates at which the chessboard is measured, by taking every k-th image.
FRAME_RATES = (30.0, 7.5)
# Truth nearer (m) or faster (m/s) than this is left out: its error is too large.
LEAST_M, MOST_M_S = 0.05, 2.0
# Truth below STILL (1/s) counts as 0; the ranges of true rates in the table, in 1/s.
STILL, RANGES = 0.05, ((0.3, 0.8), (0.8, 1.5))
# An alarm needs this rate, in 1/s, and counts it in full from this quality on.
QUALITY, ALARM = 0.35, 0.47
# An oracle announces a contact up to this many seconds before the closest approach.
ORACLE_S = 3.0
MODELS = ("flight", 6, 9)
LK = "LK divergence"
# Clips drawn over time: those with missed approaches, and those with false alarms.
MISSED = ("stereoboard1_take07", "tof_O22", "tof_O26", "tof_O28")
FALSE = ("stereoboard2_take03", "stereoboard2_take07")


class Compared(NamedTuple):
    """Measured and true rates (1/s), quality and time (s) by frame, shape (n,); NaN if unknown."""

    true: Series
    measured: Series
    quality: Series
    time_s: Series


def truth_rows(case: Case) -> list[Row]:
    """The rows of the truth of a clip; none if the clip has no truth."""
    path = Path(case.path).parent / "truth" / f"{PurePath(case.name).stem}.csv"
    return [*rows_of(path)] if path.is_file() else []


def truth_of(case: Case) -> dict[int, float]:
    """Frame -> true rate of a clip, in 1/s, where the truth is good enough."""
    true = {}
    for row in truth_rows(case):
        distance, closing = (float(row[key] or "nan") for key in ("distance_m", "closing_m_s"))
        if distance >= LEAST_M and closing <= MOST_M_S:
            true[int(row["frame"])] = closing / distance
    return true


@cache
def compared(path: str, fps: float) -> Compared:
    """What is measured on a clip at up to `fps` images per second, beside the truth."""
    case = next(case for case in cases() if case.path == path)
    result = dlgmd_cli.run(path, "flight", fps=fps, fov=case.labels[0].fov)
    truth = truth_of(case)
    true = np.array([truth.get(int(frame), np.nan) for frame in result.frame])
    return Compared(true, result.expansion, result.expansion_quality, result.time_s)


@cache
def cases() -> list[Case]:
    """The labelled clips."""
    return read_cases(reference("approach"))


def of_group(group: str, fps: float = 60.0) -> Compared:
    """The frames with truth of all clips of a group."""
    paths = [case.path for case in cases() if case.name.startswith(group)]
    clips = [compared(path, fps) for path in paths]
    joined = [np.concatenate(parts) for parts in zip(*clips, strict=True)]
    known = ~np.isnan(joined[0])
    return Compared(*(part[known] for part in joined))


def announced() -> str:
    """Approaches that alarms announce, by group, and false alarms: models, LK, an oracle."""
    rows = evaluated(reference("approach"), *MODELS, baselines=True)
    shown = [row for row in rows if row["at"] == ("best" if row["model"] == LK else "default")]
    models = dict.fromkeys(row["model"] for row in shown)
    of = {row["target"]: row["contacts"] for row in rows}
    head = ["model", *(f"{name}, of {of[key]}" for key, name in TARGETS.items())]
    head += [f"all, of {of['all']} (95 %)", f"false alarms, in {float(rows[0]['minutes']):.1f} min"]
    cells = []
    for model in models:
        own = {row["target"]: row for row in shown if row["model"] == model}
        name = f"{model}, best threshold" if model == LK else f"`{model}`"
        cells.append([name, *(own[key]["announced"] for key in TARGETS), *_overall(own["all"])])
    seen = {key: sum(map(reached, by_target(key))) for key in TARGETS}
    oracle = ["oracle", *map(str, seen.values()), str(sum(seen.values())), "–", "–"]
    return table([*head, "per minute (95 %)"], [*cells, oracle])


def _overall(row: Row) -> list[str]:
    """The cells of a model on all clips: announced, false alarms, and their rate."""
    low, high = (
        f"{float(row['contacts']) * float(row[f'announced_share_{end}']):.0f}"
        for end in ("low", "high")
    )
    rate, least, most = (number(row[f"false_alarms_per_min{end}"]) for end in ("", "_low", "_high"))
    return [f"{row['announced']} ({low}–{high})", row["false_alarms"], f"{rate} ({least}–{most})"]


def by_target(target: str) -> list[tuple[Case, int]]:
    """The clips and frames of the approaches of a group."""
    return [(case, at) for case in cases() if target in case.targets for at in case.collisions]


def reached(approach: tuple[Case, int]) -> bool:
    """Whether the true rate reaches the oracle's threshold shortly before the closest frame."""
    case, at = approach
    time_s = {int(row["frame"]): float(row["time_s"]) for row in truth_rows(case)}
    return any(0.0 <= time_s[at] - time_s[frame] <= ORACLE_S for frame in case.near)


def rates() -> str:
    """Measured against true rates, by group and frame rate; draws the page's figures, too."""
    head = ["group", "frames/s", "measured where truth is 0"]
    head += [f"measured / true, {low}–{high}/s" for low, high in RANGES]
    head += ["frames", f"quality ≥ {QUALITY}, %"]
    rows = []
    for group, (name, own_rate) in GROUPS.items():
        for fps in FRAME_RATES if group == CHESSBOARD else (60.0,):
            rate = f"{fps:g}" if group == CHESSBOARD else own_rate
            rows.append([name, rate, *_ratios(of_group(group, fps))])
    draw(root() / "docs" / "pictures")
    return table(head, rows)


def _spread(values: Series) -> str:
    """The median, and the 10th and 90th percentiles."""
    middle, least, most = (f"{part:.2f}" for part in np.nanpercentile(values, (50, 10, 90)))
    return f"{middle} ({least} to {most})"


def _ratios(found: Compared) -> list[str]:
    """The cells of a row: the rate of what is still, ratios, and the share of good quality."""
    cells = [_spread(found.measured[np.abs(found.true) < STILL])]
    for low, high in RANGES:
        inside = (found.true >= low) & (found.true < high)
        cells.append(_spread(found.measured[inside] / found.true[inside]))
    grows = (found.true >= RANGES[0][0]) & (found.true < RANGES[-1][1])
    good = 100 * (found.quality[grows] >= QUALITY).mean()
    return [*cells, str(grows.sum()), f"{good:.0f}"]


def draw(folder: Path) -> None:
    """Draw the figures of the page into a folder."""
    with house_style():
        save_figure(scatter(), folder / "approaches.png")
        save_figure(over_time(MISSED), folder / "approaches-missed.png")
        save_figure(over_time(FALSE), folder / "approaches-false.png")


def scatter() -> Figure:
    """Measured over true rate, a panel for each group, coloured by quality."""
    figure = new_figure(2.2, "two")
    panels = figure.subplots(1, len(GROUPS), sharex=True, sharey=True)
    for axes, (group, (name, fps)) in zip(panels, GROUPS.items(), strict=True):
        found = of_group(group)
        axes.plot((-1.5, 2.0), (-1.5, 2.0), color="black", linewidth=0.8)
        axes.axhline(ALARM, color="grey", linewidth=0.8, linestyle="--")
        dots = axes.scatter(
            found.true, found.measured, s=4, c=found.quality, vmin=0.0, vmax=1.0, rasterized=True
        )
        axes.set(xlim=(-1.5, 2.0), ylim=(-1.5, 2.0), title=f"{name}, {fps}/s")
        axes.set_xlabel("true rate (1/s)")
    panels[0].set_ylabel("measured rate (1/s)")
    figure.colorbar(dots, ax=panels, label="quality")
    return figure


def over_time(names: tuple[str, ...]) -> Figure:
    """True and measured rates of clips over time, with the closest approaches."""
    figure = new_figure(1.5 * len(names), "two")
    of_name = {PurePath(case.name).stem: case for case in cases()}
    for axes, name in zip(figure.subplots(len(names), 1), names, strict=True):
        _trace(axes, of_name[name])
        axes.set(title=name, ylim=(-1.5, 2.0), ylabel="rate (1/s)")
    axes.set_xlabel("time (s)")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside upper center", ncols=5)
    return figure


def _trace(axes: Axes, case: Case) -> None:
    """Draw a clip's rates; measured ones only as dots, by their quality, behind the true ones."""
    found = compared(case.path, 60.0)
    good = found.quality >= QUALITY
    axes.plot(found.time_s, found.true, color="black", label="true", zorder=3)
    for rows, color, name in ((good, "C0", f"quality {QUALITY}+"), (~good, "0.7", "lower quality")):
        axes.plot(
            found.time_s[rows], found.measured[rows], ".", color=color, label=name, markersize=3
        )
    axes.axhline(ALARM, color="C3", linewidth=0.8, linestyle="--", label="threshold")
    at_s = np.interp(case.collisions, np.arange(len(found.time_s)), found.time_s)
    axes.vlines(at_s, -1.5, 2.0, color="0.5", label="closest approach")
