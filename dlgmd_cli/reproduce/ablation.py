"""What the paper's two contributions do, each by itself: distributed excitation, radial latency.

The null model without inhibition tests inhibition. Here latency is made the same everywhere, or
excitation is left to the cell alone, while nothing else of a version changes.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np

from dlgmd_cli.models.base import AUTO
from dlgmd_cli.models.dlgmd import DLGMD
from dlgmd_cli.parameters.presets import DlgmdParameters
from dlgmd_cli.plots.panels import Panel, plot_panels
from dlgmd_cli.reproduce.claims import interval
from dlgmd_cli.reproduce.clips import VERSIONS, Models, model, other_models
from dlgmd_cli.reproduce.flights import clips_of, ratio
from dlgmd_cli.reproduce.plan import Evidence, Exhibit, Plan, Steps, by_version
from dlgmd_cli.reproduce.report import number
from dlgmd_cli.reproduce.table4 import da, false_positive
from dlgmd_cli.results.result import Series

# A version as it is, with a latency of one frame everywhere as in sets 1 to 3, and with the
# excitation of the cell alone, which is the limit of a narrow σ_E at the same strength.
OWN, CONSTANT, CELL = PARTS = ("as it is", "constant latency", "excitation of the cell alone")
SETS = (4, 5, 6, 7, 8, 9)
SHOWN = ("default", "whole-unlimited", "released-2020", "equations")


@dataclass(frozen=True)
class CellParameters(DlgmdParameters):
    """Parameters of a D-LGMD whose excitation is not distributed."""

    model: ClassVar[str] = "dlgmd-cell"
    module: ClassVar[str] = "dlgmd_cli.reproduce.ablation"


class CellExcited(DLGMD):
    """The D-LGMD with the excitation of the cell alone."""

    params_class = CellParameters
    params: CellParameters

    def __init__(self, params: CellParameters | None = None, engine: str = AUTO) -> None:
        super().__init__(params, engine)
        whole, r = self.connections.excitation, self.params.r
        alone = np.zeros_like(whole)
        alone[r, r] = whole[r, r]
        self.connections = replace(self.connections, excitation=alone)


def parameters_of(number: int, version: str, part: str) -> DlgmdParameters:
    """The parameters of a set in a version, with a part of it replaced."""
    constant = {"alpha": 0.0, "beta": 0.0, "lam": 0.0} if part == CONSTANT else {}
    values = model(f"set{number}", version, **constant).to_dict()
    return (CellParameters if part == CELL else DlgmdParameters).from_mapping(values)


def label_of(number: int, version: str, part: str) -> str:
    """The label of a set in a version, with a part of it replaced."""
    return f"set{number}/{version}/{part}"


def ablation(plan: Plan) -> Steps:
    """The distinguishability of sets 4 to 9 on group 1 with each part replaced."""
    clips = clips_of(plan, 1)
    cells = [(n, version, part) for n in SETS for version in VERSIONS for part in PARTS]
    models: Models = {label_of(*cell): parameters_of(*cell) for cell in cells}
    data = yield dict.fromkeys(clips, models | other_models("lgmd"))
    flown = [data[clip] for clip in clips]
    frames = [false_positive(flight) for flight in flown]

    def das(number: int, version: str, part: str = OWN) -> Series:
        """DA of each flight."""
        own = (flight.results[label_of(number, version, part)] for flight in flown)
        return np.array([da(result, frame) for result, frame in zip(own, frames, strict=True)])

    def gain(part: str, version: str) -> list[float]:
        return _medians([ratio(das(n, version), das(n, version, part)) for n in SETS])

    gates = [ratio(das(n, "bands-unlimited"), das(n, "whole-unlimited")) for n in SETS]
    values = {
        "ablation-latency": by_version(partial(gain, CONSTANT), VERSIONS),
        "ablation-spread": by_version(partial(gain, CELL), VERSIONS),
        "ablation-gate": {"bands-unlimited": _medians(gates)},
    }
    rows: list[tuple[Any, ...]] = [("version", "set", *(f"DA, {part}" for part in PARTS))]
    rows += [(v, str(n), *(_shown(das(n, v, part)) for part in PARTS)) for v in SHOWN for n in SETS]
    draw = partial(plot_panels, _panels(das), "Set", "DA", dots=True, log_y=True)
    title = "DA on group 1, median over seeds (95 % interval)"
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
    for version in SHOWN:
        curves, bars = {}, {}
        for part in PARTS:
            each = [das(number, version, part) for number in SETS]
            ends = np.array([interval(values.tolist()) for values in each]).T
            clipped = np.clip([np.median(each, axis=1), *ends], 0.01, 1e7)
            curves[part], bars[part] = (sets, clipped[0]), clipped[1:]
        panels.append(Panel(version, curves, level=1.0, bars=bars))
    return panels


EXHIBITS: dict[str, Exhibit] = {"ablation": ablation}
