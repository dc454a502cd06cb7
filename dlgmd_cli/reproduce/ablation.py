"""What the parts of the D-LGMD do: excitation by latency, grouping, and what follows for figures.

The null model without inhibition tests inhibition. The paper's other contributions are the spread
of excitation and the radial latency; here each is replaced while nothing else changes.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from dlgmd_cli.models.base import AUTO, Photoreceptors
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.models.kernels import Connections, delay_weights, gated, gaussian, latency_map
from dlgmd_cli.parameters.keys import key
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.plots.panels import Panel, plot_panels
from dlgmd_cli.plots.style import FLOOR_DB
from dlgmd_cli.reproduce.claims import interval
from dlgmd_cli.reproduce.clips import ClipResults, Models, model, other_models
from dlgmd_cli.reproduce.flights import clips_of
from dlgmd_cli.reproduce.plan import Data, Evidence, Exhibit, Plan, Steps
from dlgmd_cli.reproduce.stimuli import (
    cube_clip,
    looming_ball,
    pooled_db,
)
from dlgmd_cli.reproduce.table4 import da, false_positive
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.tasks.sweep import SPEEDS_PX

# Excitation over the whole kernel, as printed; gated, as released; and of the cell alone, which is
# the limit of a narrow σ_E at the same strength.
WHOLE, GATED, CELL = EXCITATIONS = ("whole", "gated", "cell")
RADIAL, CONSTANT = LATENCIES = ("radial", "constant")
CELLS = tuple((e, t) for e in EXCITATIONS for t in LATENCIES)
# The readings: rounding and limits of the released code, and of the printed equations.
READINGS = ("default", "equations")
SETS = (4, 5, 6, 7, 8, 9)
# Widths of excitation and inhibition, with which Fig. 11 is repeated in each cell.
WIDTHS_E, WIDTHS_I = (0.35, 0.7, 1.0, 1.5, 2.0), (1.0, 1.8, 2.5, 5.0)


@dataclass(frozen=True)
class AblatedParameters(DlgmdParameters):
    """Parameters of a D-LGMD with other connections."""

    model: ClassVar[str] = "dlgmd-ablated"
    module: ClassVar[str] = "dlgmd_cli.reproduce.ablation"

    rounding: str = key("bands", choices=("bands", "nearest", "interpolated"))
    excitation: str = key(WHOLE, choices=EXCITATIONS)
    delays: str = key(RADIAL, choices=LATENCIES)


class Ablated(DLGMD):
    """The D-LGMD with other connections, see `connections_of`."""

    params_class = AblatedParameters
    params: AblatedParameters

    def __init__(self, params: AblatedParameters | None = None, engine: str = AUTO) -> None:
        super().__init__(params, engine)
        self.connections = connections_of(self.params)
        delay = max(self.connections.max_delay_frames, self.least_delay)
        self.first_valid_frame = 1 + delay
        self.receptors = Photoreceptors(self.first_valid_frame)


def connections_of(params: AblatedParameters) -> Connections:
    """The connections with the excitation and the delays that `params` asks for.

    A constant latency is one frame, as in sets 1 to 3. Excitation is gated by the radial latency
    in either case, so that both factors are crossed.
    """
    wide, narrow = gaussian(params.r, params.sigma_i), gaussian(params.r, params.sigma_e)
    radial = latency_map(params.r, params.alpha, params.beta, params.lam)
    latency = radial if params.delays == RADIAL else np.ones_like(radial)
    weights, excitation = delay_weights(latency, params.rounding), narrow
    if params.excitation == GATED:
        excitation = gated(narrow, params.a * wide * weights.pop(0), radial)
    elif params.excitation == CELL:
        excitation = np.zeros_like(narrow)
        excitation[params.r, params.r] = narrow[params.r, params.r]
    inhibition = {d: params.a * wide * weight for d, weight in weights.items() if weight.any()}
    return Connections(latency, excitation, inhibition, (wide, narrow))


def label_of(number: int, reading: str, excitation: str, delays: str) -> str:
    """The label of a set in a cell of the ablation."""
    return f"set{number}/{reading}/{excitation}/{delays}"


def parameters_of(
    number: int, reading: str, excitation: str, delays: str, **widths: float
) -> AblatedParameters:
    """The parameters of a set in a cell of the ablation, with other widths if they are given."""
    own = model(f"set{number}", reading, **widths)
    rounding = "bands" if reading == "default" else "interpolated"
    changes = {"rounding": rounding, "excitation": excitation, "delays": delays}
    return AblatedParameters.from_mapping({**own.to_dict(), **changes})


def _models() -> Models:
    return {
        label_of(number, reading, *cell): parameters_of(number, reading, *cell)
        for number in SETS
        for reading in READINGS
        for cell in CELLS
    }


def _point(reading: str, cell: tuple[str, str], sigma_e: float, sigma_i: float) -> str:
    return f"{reading}/{'/'.join(cell)}/e{sigma_e:g}/i{sigma_i:g}"


def _fig_11_models() -> Models:
    """Set 4 in each cell over the widths of excitation and inhibition."""
    return {
        _point(reading, cell, e, i): parameters_of(4, reading, *cell, sigma_e=e, sigma_i=i)
        for reading in READINGS
        for cell in CELLS
        for e in WIDTHS_E
        for i in WIDTHS_I
    }


def _fig_11_rows(data: Data) -> list[tuple[Any, ...]]:
    """The shares of Fig. 11's claims that hold in each cell."""
    header = ("reading", "excitation", "latency", "slower is attenuated more")
    rows: list[tuple[Any, ...]] = [
        (*header, "larger σ_I, fast motion more", "larger σ_E, fast motion less")
    ]
    for reading in READINGS:
        for cell in CELLS:
            db = np.array(
                [
                    [
                        [
                            pooled_db(data[cube_clip(speed)].results[_point(reading, cell, e, i)])
                            for e in WIDTHS_E
                        ]
                        for i in WIDTHS_I
                    ]
                    for speed in SPEEDS_PX
                ]
            )
            shown = np.maximum(db, FLOOR_DB)
            slower = (np.diff(shown, axis=0) > 0.0).mean(axis=(1, 2)).min()
            wide_i = (np.diff(shown[2:], axis=1) < 0.0).mean()
            wide_e = (np.diff(shown[2:], axis=2) > 0.0).mean()
            rows.append((reading, *cell, float(slower), float(wide_i), float(wide_e)))
    return rows


def ablation(plan: Plan) -> Steps:
    """The distinguishability of sets 4 to 9 on group 1 in each cell, and what figures become."""
    clips, balls = clips_of(plan, 1), looming_ball(plan)
    models = _models()
    cubes = {speed: cube_clip(speed) for speed in SPEEDS_PX}
    flights = dict.fromkeys(clips, models | other_models("lgmd"))
    on_cubes = dict.fromkeys(cubes.values(), models | _fig_11_models())
    data = yield flights | on_cubes | {balls: models}
    flown = [data[clip] for clip in clips]
    frames = [false_positive(flight) for flight in flown]

    def das(number: int, reading: str, cell: tuple[str, str], grouped: bool = True) -> Series:
        """DA of each flight."""
        label = label_of(number, reading, *cell)
        found = (flight.results[label] for flight in flown)
        own = found if grouped else map(without_grouping, found)
        return np.array([da(one, frame) for one, frame in zip(own, frames, strict=True)])

    def gain(one: tuple[str, str], other: tuple[str, str], reading: str) -> list[float]:
        """The factor of DA between two cells in each flight, the median of the sets."""
        return _medians([_ratios(das(n, reading, one), das(n, reading, other)) for n in SETS])

    def grouping(reading: str) -> list[float]:
        cell = (WHOLE, RADIAL)
        return _medians(
            [_ratios(das(n, reading, cell), das(n, reading, cell, grouped=False)) for n in SETS]
        )

    values = {
        "ablation-latency-whole": _of(gain, (WHOLE, RADIAL), (WHOLE, CONSTANT)),
        "ablation-latency-gated": _of(gain, (GATED, RADIAL), (GATED, CONSTANT)),
        "ablation-gate-radial": _of(gain, (GATED, RADIAL), (WHOLE, RADIAL)),
        "ablation-gate-constant": _of(gain, (GATED, CONSTANT), (WHOLE, CONSTANT)),
        "ablation-spread": _of(gain, (WHOLE, RADIAL), (CELL, RADIAL)),
        "ablation-grouping": {reading: grouping(reading) for reading in READINGS},
    }
    tables = {
        "DA on group 1, median over seeds (95 % interval), and the peak of K": (
            _da_rows(das, flown)
        ),
        "What Figs. 6 and 12 become, radial minus or by constant latency": _figure_rows(
            [data[cube] for cube in cubes.values()], data[balls].results
        ),
        "Shares of the claims of Fig. 11 that hold, over five σ_E and four σ_I": (
            _fig_11_rows(data)
        ),
    }
    draw = partial(plot_panels, _panels(das), "Set", "DA", **_LOOK)
    return Evidence(values, {"ablation": draw}, tables)


_LOOK: dict[str, Any] = {"dots": True, "log_y": True, "share_x": False, "share_y": False}


def without_grouping(result: Result) -> Result:
    """The result with ΣS, what grouping and its threshold start from, for K."""
    rows = result.rows.copy()
    rows["mp"] = rows["s_sum"]
    return replace(result, rows=rows)


def _of(gain: Callable[..., list[float]], *cells: tuple[str, str]) -> dict[str, list[float]]:
    return {reading: gain(*cells, reading) for reading in READINGS}


def _ratios(one: Series, other: Series) -> Series:
    """The ratio of two DA; NaN if both are infinite or both 0, which decides nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(one / other)


def _medians(by_set: list[Series]) -> list[float]:
    """The median over the sets where the ratio is defined, by flight."""
    table = np.array(by_set)
    return [
        float(np.median(column[~np.isnan(column)])) if (~np.isnan(column)).any() else math.nan
        for column in table.T
    ]


def _shown(values: Series) -> str:
    low, high = interval(values.tolist())
    middle, ends = _short(float(np.median(values))), (_short(low), _short(high))
    return middle if ends == (middle, middle) else f"{middle} ({'–'.join(ends)})"


def _short(value: float) -> str:
    if not math.isfinite(value):
        return "∞" if value > 0 else "–"
    return f"{float(f'{value:.2g}'):g}" if value < 995.0 else f"{value:.1e}".replace("e+0", "e")


def _da_rows(das: Callable[..., Series], flown: list[ClipResults]) -> list[tuple[Any, ...]]:
    """A row for each reading, set and excitation: DA and the peak of K by latency."""

    def peak(number: int, reading: str, cell: tuple[str, str]) -> float:
        """The peak of K in the median flight."""
        label = label_of(number, reading, *cell)
        return float(np.median([np.nanmax(flight.results[label].mp) for flight in flown]))

    header = ("reading", "set", "excitation")
    rows: list[tuple[Any, ...]] = [
        (*header, "DA, radial", "DA, constant", "peak, radial", "peak, constant")
    ]
    for reading in READINGS:
        for number in SETS:
            for excitation in EXCITATIONS:
                cells = [(excitation, delays) for delays in LATENCIES]
                shown = [_shown(das(number, reading, cell)) for cell in cells]
                peaks = [peak(number, reading, cell) for cell in cells]
                rows.append((reading, str(number), excitation, *shown, *peaks))
    return rows


def _figure_rows(cubes: Sequence[ClipResults], ball: Mapping[str, Result]) -> list[tuple[Any, ...]]:
    """What radial latency changes at the slowest and the fastest speed, and in sharpness."""

    def shown_db(label: str) -> Series:
        """The attenuation at each speed, as far as figures show it."""
        return np.maximum([pooled_db(cube.results[label]) for cube in cubes], FLOOR_DB)

    header = ("reading", "set", "excitation", "1 px/frame, dB", "4 px/frame, dB")
    rows: list[tuple[Any, ...]] = [(*header, "breadth on the ball, ratio")]
    for reading in READINGS:
        for number in SETS:
            for excitation in EXCITATIONS:
                labels = [label_of(number, reading, excitation, delays) for delays in LATENCIES]
                radial, constant = map(shown_db, labels)
                change, breadths = radial - constant, [ball[label].sharpness for label in labels]
                ratio = breadths[0] / breadths[1]
                rows.append((reading, str(number), excitation, change[0], change[-1], ratio))
    return rows


def _panels(das: Callable[..., Series]) -> list[Panel]:
    """DA by set in each reading."""
    sets = np.array(SETS, np.float64)
    panels = []
    for reading in READINGS:
        curves, bars = {}, {}
        for cell in CELLS[:4]:
            each = [das(number, reading, cell) for number in SETS]
            ends = np.array([interval(values.tolist()) for values in each]).T
            clipped = np.clip([np.median(each, axis=1), *ends], 0.01, 1e7)
            curves[", ".join(cell)], bars[", ".join(cell)] = (sets, clipped[0]), clipped[1:]
        panels.append(Panel(f"DA on group 1, {reading}", curves, level=1.0, bars=bars))
    return panels


EXHIBITS: dict[str, Exhibit] = {"ablation": ablation}
