"""The exhibits on distinguishability and time: Table IV, and what the two contributions do."""

import math
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise, product
from pathlib import Path
from statistics import median
from typing import Any, ClassVar

import cv2
import numpy as np

import dlgmd_cli
from dlgmd_cli import DLGMD, DlgmdParameters, Result
from dlgmd_cli.lab.bench.bench import (
    MOST_DA,
    N_FRAMES,
    PAPER_DA,
    PAPER_S,
    RADII,
    SCALES,
    TABLE_IV_SET,
)
from dlgmd_cli.lab.paper.claims import interval, number
from dlgmd_cli.lab.paper.clips import (
    FPS,
    NULLS,
    VERSIONS,
    Clip,
    ClipResults,
    Models,
    Series,
    Value,
    model,
)
from dlgmd_cli.lab.paper.flights import T_MP, clips_of, db_in, phase, ratio
from dlgmd_cli.lab.paper.free import frames
from dlgmd_cli.lab.paper.panels import Panel, plot_panels
from dlgmd_cli.lab.paper.plan import ANY, FEW, FULL_WH, TIMING, Evidence, Plan, Steps, by_version
from dlgmd_cli.lab.paper.stimuli import SPEEDS_PX, cube_clip, pooled_db, sigmoid
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.video.writer import write_video

# The scale that the paper finds best, and the least that it calls satisfactory.
BEST_SCALE, LEAST_SCALE = 0.25, 0.02
# The label of the LGMD on frames of the best scale.
SMALL_LGMD = "lgmd, small"
# The paper's criterion of a sufficient DA.
SUFFICIENT = 10.0
# Where a figure draws an infinite DA, and one of 0.
_INFINITE, _ZERO = 1e6, 1e-2


def false_positive(flight: ClipResults, *, highest: bool = False) -> int:
    """The frame of the LGMD's first false peak: the first that reaches T_MP before the approach.

    If none does, or with `highest`, the frame of its highest level there.
    """
    first, end = phase(flight, "pitch")[0], flight.collision_frame - frames("approach")
    shown = sigmoid(flight.results["lgmd"])[first - 1 : end]
    is_peak = (shown[1:-1] >= shown[:-2]) & (shown[1:-1] >= shown[2:]) & (shown[1:-1] >= T_MP)
    is_first = is_peak.any() and not highest
    return int(first + (np.argmax(is_peak) if is_first else np.argmax(shown[1:-1])))


def _point(radius: int, scale: float, version: str) -> str:
    return f"r{radius}/x{scale:g}/{version}"


def _models(plan: Plan, scales: tuple[float, ...]) -> Models:
    """Set 7 with each radius in each version, on frames of each scale of 1920x1080."""
    rendered = plan.flight_wh[0] / FULL_WH[0]
    models: Models = {"lgmd": "lgmd", SMALL_LGMD: ("lgmd", BEST_SCALE / rendered)}
    for v in plan.versions:
        for r in RADII:
            params = model(TABLE_IV_SET, v, r=r)
            models |= {_point(r, x, v): (params, x / rendered) for x in scales}
    return models


def table4_da(plan: Plan) -> Steps:
    """The distinguishability by radius and scale; small frames have the small scales only."""
    scales = tuple(x for x in SCALES if x * FULL_WH[0] <= plan.flight_wh[0])
    clips: list[Clip] = clips_of(plan, 1)
    data = yield dict.fromkeys(clips, _models(plan, scales))

    def table_of(flight: ClipResults, version: str, *, highest: bool) -> Series:
        """DA by radius (rows) and scale."""
        frame = false_positive(flight, highest=highest)
        results = [[flight.results[_point(r, x, version)] for x in scales] for r in RADII]
        return np.array([[da(result, frame) for result in row] for row in results])

    def tables_of(*, highest: bool) -> dict[str, list[Series]]:
        """The table of each flight, by version."""
        flown = [data[clip] for clip in clips]
        return {v: [table_of(one, v, highest=highest) for one in flown] for v in plan.versions}

    paper = np.array([[PAPER_DA[r, x] for x in scales] for r in RADII])
    best, least = scales.index(BEST_SCALE), scales.index(LEAST_SCALE)
    measures: dict[str, Callable[[Series], Any]] = {
        "above-1": np.min,
        "above-1~middle": np.median,
        "above-10": lambda table: np.min(table[:, best]),
        "above-10~middle": lambda table: np.median(table[:, best]),
        "small": lambda table: np.min(table[:, least]),
        "small~middle": lambda table: np.median(table[:, least]),
        "rising": _rising,
        "apart": partial(_apart, paper=paper),
    }
    if scales == SCALES:
        measures |= {
            "best": partial(_best, place=best),
            "smaller": partial(_smaller, last=best),
            "reduced": _reduced,
            "turns": partial(_turning, last=least),
            "r2": lambda table: table[RADII.index(2), 0],
            "r2-only": _others_insufficient,
        }
    tables, values = tables_of(highest=False), {}
    for how, by in (("", tables), ("~highest", tables_of(highest=True))):
        for name, measure in measures.items():
            if "~" not in name or not how:
                each = {v: [float(measure(table)) for table in by[v]] for v in plan.versions}
                values[f"table4-da-{name}{how}"] = each

    def better(of: Callable[..., Any], version: str) -> list[float]:
        """DA at the best scale by that of the LGMD in the same flight."""
        flown = (data[clip] for clip in clips)
        lgmds = [da(flight.results[SMALL_LGMD], false_positive(flight)) for flight in flown]
        pairs = zip(tables[version], lgmds, strict=True)
        return [_ratio(of(table[:, best]), lgmd) for table, lgmd in pairs]

    def barrier(scale: float, version: str) -> list[float]:
        """The attenuation in the pitch at a smaller scale minus that at full scale, at r = 4."""
        labels = [_point(4, x, version) for x in (scale, 1.0)]
        flown = (data[clip] for clip in clips)
        each = ([db_in(flight, label, "pitch") for label in labels] for flight in flown)
        return [small - whole for small, whole in each]

    if scales == SCALES:
        for how, scale in (("", BEST_SCALE), ("~half", 0.5)):
            of_scale = by_version(partial(barrier, scale), plan.versions)
            values[f"table4-da-barrier{how}"] = of_scale
    values["table4-da-lgmd"] = by_version(partial(better, np.min), plan.versions)
    values["table4-da-lgmd~middle"] = by_version(partial(better, np.median), plan.versions)

    def panel(title: str, table: Series) -> Panel:
        shown = np.clip(table, _ZERO, _INFINITE)
        curves = {f"r = {r}": (np.array(scales), shown[row]) for row, r in enumerate(RADII)}
        return Panel(title, curves, level=1.0)

    middle = {v: np.median(tables[v], axis=0) for v in plan.versions}
    shown = [v for v in VERSIONS if v in middle]
    panels = [panel("the paper", paper), *(panel(v, middle[v]) for v in shown)]
    draw = partial(plot_panels, panels, "Scale", "DA", dots=True, log_x=True, log_y=True)
    names = [v for v in (*shown, NULLS["default"]) if v in middle]
    rows: list[tuple[Value, ...]] = [("r", "scale", "paper", *names)]
    rows += [
        (r, x, shownda(paper[row, column]), *(float(middle[v][row, column]) for v in names))
        for row, r in enumerate(RADII)
        for column, x in enumerate(scales)
    ]
    return Evidence(values, {"table4-da": draw}, {"DA, median over seeds": rows})


def _best(table: Series, place: int) -> float:
    """DA at the best scale by the best of the others, for the worst radius."""
    return min(map(_ratio, table[:, place], np.delete(table, place, axis=1).max(axis=1)))


def _smaller(table: Series, last: int) -> float:
    """DA of a smaller input by that of the next larger one, down to a scale; the worst."""
    return min(map(_ratio, table[:, 1 : last + 1].ravel(), table[:, :last].ravel()))


def _reduced(table: Series) -> float:
    """DA of a smaller input by that at full scale; the worst."""
    return min(_ratio(value, row[0]) for row in table for value in row[1:])


def _rising(table: Series) -> float:
    """The share of the pairs of a radius and the next smaller one in which DA rises."""
    return float((table[:-1] >= table[1:]).mean())


def _turning(table: Series, last: int) -> float:
    """The share of radii whose DA rises and then falls as the input gets smaller."""
    rows = table[:, :last]
    turns = [
        0 < peak < last - 1
        and all(a <= b for a, b in pairwise(row[: peak + 1]))
        and all(a >= b for a, b in pairwise(row[peak:]))
        for row, peak in zip(rows, rows.argmax(axis=1), strict=True)
    ]
    return float(np.mean(turns))


def _others_insufficient(table: Series) -> float:
    """The number of cells, but that of r = 2 at full scale, whose DA is not sufficient."""
    is_it = table < SUFFICIENT
    is_it[RADII.index(2), 0] = False
    return float(np.count_nonzero(is_it))


def _apart(table: Series, paper: Series) -> float:
    """The median factor between ours and the paper's, where both are measured."""
    known = np.isfinite(table) & (table > 0.0) & (paper < MOST_DA)
    if not known.any():
        return math.nan
    return float(np.exp(np.median(np.abs(np.log(table[known] / paper[known])))))


def shownda(value: float) -> str | float:
    """The paper's DA, as it prints it where it gives a bound alone."""
    return ">10000" if value == MOST_DA else value


def da(result: Result, false_positive_frame: int) -> float:
    """DA; 0 if the model never responds."""
    value = result.distinguishability(false_positive_frame)
    return 0.0 if math.isnan(value) else value


def _ratio(ours: float, other: float) -> float:
    """The ratio of two DA; 1 if both are infinite, or both 0."""
    value = float(ratio(ours, other))
    return 1.0 if math.isnan(value) else value


# Seconds for 120 frames by radius and scale.
Seconds = Mapping[tuple[int, float], float]

_CORNERS = ((6, 1.0), (6, 0.25), (2, 1.0), (2, 0.02))
# Versions that are timed: the fastest, and the slowest.
_TIMED = ("default", "equations")
N_PASSES = 5


# A row of the table of times: seconds for 120 frames with loading, and of the model alone.
Timing = tuple[float, float]


@contextmanager
def _panning(n_frames: int) -> Iterator[str]:
    """A temporary video, 1920x1080, of a texture that moves sideways."""
    width, height = FULL_WH
    cells = np.random.default_rng(0).integers(0, 256, (height // 20, width // 20), np.uint8)
    texture = cv2.resize(cells, FULL_WH, interpolation=cv2.INTER_CUBIC)
    with tempfile.TemporaryDirectory(prefix="dlgmd-") as folder:
        path = Path(folder) / "panning.mp4"
        images = (np.roll(texture, 4 * n, axis=1) for n in range(n_frames))
        write_video(path, images, (height, width), FPS)
        yield str(path)


def _timed(path: str, params: DlgmdParameters, scale: float) -> Timing:
    """Seconds for 120 frames at a scale: reading and the model together, and the model alone."""
    cell, alone_s, started = DLGMD(params), [], time.perf_counter()
    with dlgmd_cli.open_video(path, scale=scale) as video:
        for frame in video:
            before = time.perf_counter()
            cell.step(frame.grey)
            alone_s.append(time.perf_counter() - before)
    whole_s = (time.perf_counter() - started) / len(alone_s)
    return N_FRAMES * whole_s, N_FRAMES * median(alone_s)


def time_models(*, quick: bool) -> dict[str, dict[tuple[int, float], Timing]]:
    """The times of some versions by radius and scale; if `quick`, once, and of four of these alone.

    Each is the median of passes over all, so that what else the computer does meets all alike.
    """
    cells = _CORNERS if quick else tuple(PAPER_S)
    with _panning(24 if quick else 48) as path:
        passes = [
            {
                (v, r, x): _timed(path, model(TABLE_IV_SET, v, r=r), x)
                for v in _TIMED
                for r, x in cells
            }
            for _ in range(1 if quick else N_PASSES)
        ]

    def middle(at: tuple[str, int, float]) -> Timing:
        whole_s, alone_s = zip(*(one[at] for one in passes), strict=True)
        return median(whole_s), median(alone_s)

    return {v: {(r, x): middle((v, r, x)) for r, x in cells} for v in _TIMED}


def table4_time(plan: Plan) -> Steps:
    """The computing times by radius and scale, with loading and without."""
    data = yield {TIMING: partial(time_models, quick=plan.quick)}
    timed: dict[str, dict[tuple[int, float], Timing]] = data[TIMING]

    def judged(measure: Callable[[Seconds], float], part: int) -> dict[str, list[float]]:
        """The measure of the times with loading (0), or of the model alone (1)."""

        def of(version: str) -> float:
            cells = {at: times[part] for at, times in timed[version].items()}
            return measure(cells) if plan.is_idle else math.nan

        return by_version(of, _TIMED)

    header = [f"{v}, {what}" for v in _TIMED for what in ("s", "ratio", "model alone, s")]
    rows: list[tuple[Value, ...]] = [("r", "scale", "paper, s", "paper, ratio", *header)]
    least = _CORNERS[-1]
    for at in timed[_TIMED[0]]:
        ours = (timed[v] for v in _TIMED)
        each = ((of[at][0], of[at][0] / of[least][0], of[at][1]) for of in ours)
        rows.append((*at, PAPER_S[at], PAPER_S[at] / PAPER_S[least], *chain(*each)))
    measures: dict[str, tuple[Callable[..., float], int]] = {
        "r": (_costs_more, 0), "size": (_costs_more, 0),
        "order-r": (_exponent, 1), "order-size": (_exponent, 1),
    }  # fmt: skip
    values = {}
    for name, (measure, part) in measures.items():
        of = partial(measure, by=int(name.endswith("size")))
        other = "~alone" if part == 0 else "~whole"
        values[f"table4-time-{name}"] = judged(of, part)
        values[f"table4-time-{name}{other}"] = judged(of, 1 - part)
    values["table4-time-convolutions"] = {ANY: [math.nan]}
    title = "Seconds for 120 frames, and their ratio to the last row: the paper's, and ours"
    return Evidence(values, tables={title: rows})


def _exponent(seconds: Seconds, by: int) -> float:
    """The power of the radius (0) or of the number of cells (1) with which the time grows.

    The slope of the logarithms, by least squares, with a level for each value of the other.
    """
    points: dict[float, list[tuple[float, float]]] = {}
    for at, time_s in seconds.items():
        x = math.log(at[by]) * (1 + by)  # cells are the square of the scale
        points.setdefault(at[1 - by], []).append((x, math.log(time_s)))
    each = [np.array(group) for group in points.values()]
    x, y = np.concatenate([group - group.mean(axis=0) for group in each]).T
    return float((x @ y) / (x @ x))


def _costs_more(seconds: Seconds, by: int) -> float:
    """The share of the pairs that differ in radius (0) or scale (1) in which more costs more."""
    pairs = [(a, b) for a in seconds for b in seconds if a[by] > b[by] and a[1 - by] == b[1 - by]]
    return float(np.mean([seconds[a] > seconds[b] for a, b in pairs]))


# What the paper's two contributions do, each by itself, is seen where nothing else of a version
# changes. (The null model without inhibition tests inhibition.)
# A version as it is, with a latency of one frame everywhere as in sets 1 to 3, and with the
# excitation of the cell alone, which is the limit of a narrow σ_E at the same strength.
OWN, CONSTANT, CELL = PARTS = ("as it is", "constant latency", "excitation of the cell alone")
# `WIDE` are the sets that distribute excitation: the paper says that a σ_E of 0.35 rarely does.
SETS, WIDE = (4, 5, 6, 7, 8, 9), (7, 8, 9)


@dataclass(frozen=True)
class CellParameters(DlgmdParameters):
    """Parameters of a D-LGMD whose excitation is not distributed."""

    model: ClassVar[str] = "dlgmd-cell"
    module: ClassVar[str] = "dlgmd_cli.lab.paper.table4"


class CellExcited(DLGMD):
    """The D-LGMD with the excitation of the cell alone."""

    params_class = CellParameters
    params: CellParameters

    def net(self, connections: Any) -> Any:  # the type has no public name
        """The connections as they are, and of the excitation the cell's alone."""
        netted, r = super().net(connections), self.params.r
        alone = np.zeros_like(netted.excitation)
        alone[r, r] = netted.excitation[r, r]
        return replace(netted, excitation=alone)


def parameters_of(number: int, version: str, part: str) -> DlgmdParameters:
    """The parameters of a set in a version, with a part of it replaced."""
    constant = {"alpha": 0.0, "beta": 0.0, "lam": 0.0} if part == CONSTANT else {}
    values = model(number, version, **constant).to_dict()
    return (CellParameters if part == CELL else DlgmdParameters).from_mapping(values)


def label_of(number: int, version: str, part: str) -> str:
    """The label of a set in a version, with a part of it replaced."""
    return f"set{number}/{version}/{part}"


def ablation(plan: Plan) -> Steps:
    """The distinguishability of sets 4 to 9 on group 1 with each part replaced."""
    clips, versions = clips_of(plan, 1), [v for v in VERSIONS if v in plan.versions]
    cells = [(n, version, part) for n in SETS for version in versions for part in PARTS]
    models: Models = {label_of(*cell): parameters_of(*cell) for cell in cells}
    own_and_cell = {
        label_of(n, version, part): parameters_of(n, version, part)
        for n, version, part in product(WIDE, versions, (OWN, CELL))
    }
    cubes = cube_clip(SPEEDS_PX[0]), cube_clip(SPEEDS_PX[-1])
    data = yield {
        **dict.fromkeys(clips, models | {"lgmd": "lgmd"}),
        **dict.fromkeys(cubes, own_and_cell),
    }
    flown = [data[clip] for clip in clips]
    false = {how: [false_positive(f, highest=how) for f in flown] for how in (False, True)}

    def das(number: int, version: str, part: str = OWN, *, highest: bool = False) -> Series:
        """DA of each flight."""
        results = (flight.results[label_of(number, version, part)] for flight in flown)
        pairs = zip(results, false[highest], strict=True)
        return np.array([da(result, frame) for result, frame in pairs])

    def filtered(number: int, version: str, part: str = OWN) -> Series:
        """The attenuation at contact minus that in the pitch, of each flight, in dB."""
        label = label_of(number, version, part)
        rises = [db_in(f, label, "contact") - db_in(f, label, "pitch") for f in flown]
        return np.array(rises)

    def gain(sets: Sequence[int], part: str, version: str, *, highest: bool = False) -> list[float]:
        """The factor of DA that a part brings, over some sets."""
        das_of = partial(das, highest=highest)
        return _medians([ratio(das_of(n, version), das_of(n, version, part)) for n in sets])

    def sharper(part: str, version: str) -> list[float]:
        """What a part adds to the attenuation's rise from the pitch to contact, over the sets."""
        return _medians([filtered(n, version) - filtered(n, version, part) for n in SETS])

    def preferred(pool: Callable[..., float], version: str) -> float:
        """What the neighbours' excitation adds to the attenuation of fast motion, beyond slow."""

        def gain(n: int, cube: Clip) -> float:
            labels = [label_of(n, version, part) for part in (OWN, CELL)]
            own, cell = (max(pooled_db(data[cube].results[x]), FLOOR_DB) for x in labels)
            return own - cell

        gains = [gain(n, cubes[1]) - gain(n, cubes[0]) for n in WIDE]
        return float(pool(gains))

    values = {
        "ablation-preferred": by_version(partial(preferred, min), versions),
        "ablation-preferred~middle": by_version(partial(preferred, np.median), versions),
    }
    for name, part in (("latency", CONSTANT), ("spread", CELL)):
        measures = {
            "": partial(gain, SETS, part),
            "~wide": partial(gain, WIDE, part),
            "~highest": partial(gain, SETS, part, highest=True),
            "~filter": partial(sharper, part),
        }
        for how, measure in measures.items():
            values[f"ablation-{name}{how}"] = by_version(measure, versions)
    rows: list[tuple[Value, ...]] = [("version", "set", *(f"DA, {part}" for part in PARTS))]
    rows += [(v, str(n), *(_shown(das(n, v, part)) for part in PARTS)) for v in FEW for n in SETS]
    draw = partial(plot_panels, _panels(das), "Set", "DA", dots=True, log_y=True)
    title = f"DA on group 1, median over seeds ({plan.interval})"
    return Evidence(values, {"ablation": draw}, {title: rows})


def _medians(by_set: list[Series]) -> list[float]:
    """The median over the sets where the ratio of two DA is defined, by flight."""
    known = [column[~np.isnan(column)] for column in np.array(by_set).T]
    return [float(np.median(ratios)) if ratios.size else math.nan for ratios in known]


def _shown(values: Series) -> str:
    """The median, and its interval if it has one."""
    middle, *ends = map(number, (float(np.median(values)), *interval(values.tolist())))
    return middle if ends == [middle, middle] else f"{middle} ({'–'.join(ends)})"


def _panels(das: Callable[..., Series]) -> list[Panel]:
    """DA by set in some versions."""
    sets = np.array(SETS, np.float64)
    panels = []
    for version in FEW:
        curves, bars = {}, {}
        for part in PARTS:
            each = [das(number, version, part) for number in SETS]
            ends = np.array([interval(values.tolist()) for values in each]).T
            clipped = np.clip([np.median(each, axis=1), *ends], 0.01, 1e7)
            curves[part], bars[part] = (sets, clipped[0]), clipped[1:]
        panels.append(Panel(version, curves, level=1.0, bars=bars))
    return panels
