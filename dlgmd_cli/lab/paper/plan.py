"""The plan of a report: what its exhibits need, how that is computed, and what they show."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.lab.paper.clips import EVERY, VERSIONS, Clip, Value, run_clip
from dlgmd_cli.machine.pool import results_of

# What an exhibit needs: for a clip, the models that see it, by label; for a name, a call without
# arguments. Each is a task; the results are by the same clips and names.
Key = Clip | str
Needs = dict[Key, Any]
Task = tuple[Key, Any]
Data = Mapping[Key, Any]
# Draws a figure.
Draw = Callable[[], Figure]

# Replaces the version of claims that are not about the D-LGMD.
ANY = "any"
# Calls whose names begin with this are timed, and have the machine to themselves.
TIMING = "timing"
# Width and height of the flights: usual, and the paper's.
USUAL_WH, FULL_WH = (480, 270), (1920, 1080)
# Seeds of a report; of a quick one, and of the check at full size.
_SEEDS, FEW_SEEDS = 20, 3

# Exhibits that are checked at the paper's frame size, those with frames by the authors, and those
# for which there are no others.
AT_FULL_SIZE = {"fig1", "fig13", "fig14", "fig15", "fig16", "fig17", "table4-da"}
OF_AUTHORS = {"fig8": "ball_and_capsules", "fig10": "looming_ball", "fig12": "looming_ball"}
ONLY_OF_AUTHORS = ("fig8",)


@dataclass(frozen=True)
class Plan:
    """How an exhibit is made: extent, frame size, and whose frames.

    `quick` is fewer seeds and coarser grids. `flight_wh` is the width and height of the flights;
    larger ones have fewer seeds and no null models. `reference` is the folder of the authors'
    frames. `is_idle` says that nothing else runs, so that
    times mean something.
    """

    quick: bool = False
    reference: Path | None = None
    flight_wh: tuple[int, int] = USUAL_WH
    is_idle: bool = True

    @property
    def name(self) -> str:
        """What distinguishes this from other plans of the same report."""
        if self.reference is not None:
            return "authors' frames"
        return self.size if self.is_larger else "own frames"

    @property
    def size(self) -> str:
        """The size of the flights as `fly` and `synth` take it."""
        return "{}x{}".format(*self.flight_wh)

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of what is rendered with one."""
        return tuple(range(FEW_SEEDS if self.quick or self.is_larger else _SEEDS))

    @property
    def is_larger(self) -> bool:
        """Whether the flights are larger than usual."""
        return self.flight_wh > USUAL_WH

    @property
    def versions(self) -> tuple[str, ...]:
        """The versions of the D-LGMD to run: without the null models on larger frames."""
        return tuple(VERSIONS) if self.is_larger else EVERY


def plans_of(name: str, plan: Plan, reference: Path | None) -> list[Plan]:
    """The plan of an exhibit, then those that are shown beside it.

    `reference` is the folder of the authors' frames, if it is given.
    """
    plans = [plan]
    if name in AT_FULL_SIZE and not plan.quick:
        plans.append(replace(plan, flight_wh=FULL_WH))
    if reference is not None and name in OF_AUTHORS and (reference / OF_AUTHORS[name]).is_dir():
        plans.append(replace(plan, reference=reference))
    return plans[-1:] if name in ONLY_OF_AUTHORS else plans


@dataclass(frozen=True)
class Evidence:
    """What an exhibit shows.

    Attributes
    ----------
    values : dict
        Claim -> version -> one value per seed, or a single one; NaN where it is undefined.
    figures : dict
        File name without suffix -> function that draws the figure.
    tables : dict
        Title -> header, then rows.
    inputs : dict
        Seed, None for clips without one -> SHA-256 of the frames of each clip, by its name.
    """

    values: dict[str, dict[str, list[float]]]
    figures: Mapping[str, Draw] = field(default_factory=dict)
    tables: Mapping[str, list[tuple[Value, ...]]] = field(default_factory=dict)
    inputs: Mapping[int | None, Mapping[str, str]] = field(default_factory=dict)


# A figure or table of the paper: it yields what it needs, is sent the results, and returns what it
# shows.
Exhibit = Callable[[Plan], Generator[Needs, Data, Evidence]]
Steps = Generator[Needs, Data, Evidence]


class Started:
    """An exhibit that has said what it `needs`."""

    def __init__(self, steps: Steps) -> None:
        self._steps, self.needs = steps, next(steps)

    def evidence(self, data: Data) -> Evidence:
        """What the exhibit shows once its needs are computed."""
        inputs: dict[int | None, dict[str, str]] = {}
        for result in (data[key] for key in self.needs):
            if hasattr(result, "sha256"):
                inputs.setdefault(result.clip.seed, {})[result.clip.name] = result.sha256
        try:
            self._steps.send(data)
        except StopIteration as end:
            return replace(end.value, inputs=inputs)
        raise RuntimeError("an exhibit yields once")


def by_version(
    value: Callable[[str], float | list[float]], versions: Iterable[str] = EVERY
) -> dict[str, list[float]]:
    """The values for each version: one per seed, or a single one."""
    values = {version: value(version) for version in versions}
    return {v: each if isinstance(each, list) else [float(each)] for v, each in values.items()}


def needed(started: Iterable[Started]) -> list[Task]:
    """The tasks of exhibits; a clip is rendered for all of them together."""
    needs: Needs = {}
    for exhibit in started:
        for key, need in exhibit.needs.items():
            needs[key] = {**needs.get(key, {}), **need} if isinstance(key, Clip) else need
    return list(needs.items())


def compute(
    tasks: Sequence[Task], n_processes: int | None, on_result: Callable[[int, str], None]
) -> Data:
    """Compute what is needed in several processes; what is timed, alone in this one.

    `on_result` is called with the number of results and the name of the last. Raises Interrupted if
    the user asks to stop, and passes on the exceptions of a call.
    """
    data: dict[Key, Any] = {}
    timed = [task for task in tasks if _name(task[0]).startswith(TIMING)]
    shared = [task for task in tasks if task not in timed]
    each = results_of(_result, shared, n_processes)
    for (key, _), result in chain(each, results_of(_result, timed, 1)):
        if isinstance(result, DlgmdError):
            raise result
        data[key] = result
        on_result(len(data), _name(key))
    return data


def _result(task: Task) -> Any:
    key, need = task
    return run_clip(key, need) if isinstance(key, Clip) else need()


def _name(key: Key) -> str:
    return key.name if isinstance(key, Clip) else str(key)
