"""The plan of a report: what its exhibits need, how that is computed, and what they show."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, WorkerError
from dlgmd_cli.lab.reproduce.clips import Clip, run_clip
from dlgmd_cli.parameters import FORMULATIONS
from dlgmd_cli.pool import results_of

# Replaces the formulation of claims that are not about the D-LGMD.
ANY = "any"
# Calls whose names begin with this are timed, and have the machine to themselves.
TIMING = "timing"

# For a clip, the models that see it, by label; for a name, a call without arguments.
Needs = dict[Any, Any]
# The results, by the same clips and names.
Data = Mapping[Any, Any]


@dataclass(frozen=True)
class Plan:
    """The extent of a report (`quick`: one seed per flight), and the folder of reference frames."""

    quick: bool = False
    reference: Path | None = None

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the flights."""
        return (0,) if self.quick else (0, 1, 2, 3, 4)


@dataclass(frozen=True)
class Evidence:
    """What an exhibit shows.

    Attributes
    ----------
    values : dict
        Claim -> formulation -> one value per seed; NaN where it is undefined.
    figures : dict
        File name without suffix -> function that draws the figure.
    table : sequence of tuple
        Rows of Table IV: radius, scale, the paper's value, and ours for each formulation.
    """

    values: dict[str, dict[str, list[float]]]
    figures: Mapping[str, Callable[[], Any]] = field(default_factory=dict)
    table: list[tuple[float, ...]] = field(default_factory=list)


@dataclass(frozen=True)
class Exhibit:
    """A figure or table of the paper: what it needs, and what it shows once that is computed."""

    needs: Callable[[Plan], Needs]
    show: Callable[[Plan, Data], Evidence]


def by_formulation(value: Callable[[str], float | list[float]]) -> dict[str, list[float]]:
    """The values for each formulation: one per seed, or a single one."""
    found = {formulation: value(formulation) for formulation in FORMULATIONS}
    return {f: one if isinstance(one, list) else [float(one)] for f, one in found.items()}


def needed(exhibits: Iterable[Exhibit], plan: Plan) -> Needs:
    """What exhibits need, each once: a clip is rendered once for all models."""
    found: Needs = {}
    for exhibit in exhibits:
        for key, need in exhibit.needs(plan).items():
            found[key] = {**found.get(key, {}), **need} if isinstance(key, Clip) else need
    return found


def compute(needs: Needs, n_processes: int, on_result: Callable[[int, str], None]) -> Data:
    """Compute what is needed in several processes; what is timed, alone in this one.

    `on_result` is called with the number of results and the name of the last. Raises Interrupted if
    the user asks to stop, and passes on the exceptions of a call.
    """
    data: dict[Any, Any] = {}
    shared = [item for item in needs.items() if not _is_timed(item[0])]
    timed = [item for item in needs.items() if _is_timed(item[0])]
    each = results_of(_result, shared, min(n_processes, len(shared)))
    for (key, _), found in chain(each, results_of(_result, timed, 1)):
        if isinstance(found, WorkerError):
            raise WorkerError(_name(key), found.why, found.mend)
        if isinstance(found, DlgmdError):
            raise found
        data[key] = found
        on_result(len(data), _name(key))
    return data


def _result(item: tuple[Any, Any]) -> Any:
    """Compute one need."""
    key, need = item
    return run_clip(key, need) if isinstance(key, Clip) else need()


def _name(key: Any) -> str:
    return key.scene if isinstance(key, Clip) else str(key)


def _is_timed(key: Any) -> bool:
    return _name(key).startswith(TIMING)
