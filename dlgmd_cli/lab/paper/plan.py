"""The plan of a report: what its exhibits need, how that is computed, and what they show."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from dlgmd_cli.errors import DlgmdError
from dlgmd_cli.lab.fly.scripts import TILT_S
from dlgmd_cli.lab.paper.clips import EVERY, NULLS, Clip, Value, run_clip
from dlgmd_cli.lab.paper.free import FREE, trying
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
# Seeds of a report, and of a quick one.
_SEEDS, FEW_SEEDS = 20, 3
# The versions on flights at full size, and on those with smoother motion: the default, a code of
# the authors, and their text.
FEW = ("default", "released-2020", "equations")
# The time constant of a tilt that is smoother than that of a real autopilot.
SMOOTHER_S = 2 * TILT_S

# Exhibits that need the paper's frame size, those with flights, and those with the authors' frames.
AT_FULL_SIZE = {"table4-da"}
FLOWN = {"fig1", "fig13", "fig14", "fig15", "fig16", "fig17", "table4-da", "ablation"}
OF_AUTHORS = {"fig8": "ball_and_capsules", "fig10": "looming_ball", "fig12": "looming_ball"}


@dataclass(frozen=True)
class Plan:
    """How an exhibit is made: extent, frame size, and whose frames.

    `quick` is fewer seeds and coarser grids. `flight_wh` is the width and height of the flights,
    `tilt_s` the time constant of the drone's tilt; larger and smoother ones have few versions.
    `reference` is the folder of the authors' frames. `is_idle` says that nothing else runs, so that
    times mean something.
    """

    quick: bool = False
    reference: Path | None = None
    flight_wh: tuple[int, int] = USUAL_WH
    is_idle: bool = True
    tilt_s: float = TILT_S

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
        return tuple(range(FEW_SEEDS if self.quick else _SEEDS))

    @property
    def interval(self) -> str:
        """What the ends beside a median are: fewer than six seeds have their range."""
        return "95 % interval" if len(self.seeds) > 5 else "range"

    @property
    def is_larger(self) -> bool:
        """Whether the flights are larger than usual."""
        return self.flight_wh > USUAL_WH

    @property
    def versions(self) -> tuple[str, ...]:
        """The versions of the D-LGMD to run: few on larger frames, and with smoother motion."""
        if self.is_larger:
            return (*FEW, NULLS[FEW[0]])
        few = (*FEW, *dict.fromkeys(NULLS[version] for version in FEW))
        return few if self.tilt_s > TILT_S else EVERY


def plan_of(name: str, plan: Plan, reference: Path | None) -> Plan:
    """The plan of an exhibit: at the paper's size, or on the authors' frames, where it has these.

    `reference` is the folder of the authors' frames, if it is given.
    """
    if name in AT_FULL_SIZE and not plan.quick:
        return replace(plan, flight_wh=FULL_WH)
    if reference is not None and name in OF_AUTHORS and (reference / OF_AUTHORS[name]).is_dir():
        return replace(plan, reference=reference)
    return plan


class Trial(NamedTuple):
    """Another way to look at an exhibit: a text, a plan, and a free constant with its value."""

    text: str
    plan: Plan
    constant: str = ""
    value: float = 0.0
    is_reading: bool = False


def trials_of(name: str, plan: Plan) -> list[Trial]:
    """What else is tried of an exhibit: other values of constants that matter, smoother motion."""
    found = [
        Trial(constant.text(value), plan, key, value, constant.is_reading)
        for key, constant in FREE.items()
        if name in constant.exhibits
        for value in constant.others
    ]
    if name in FLOWN and not plan.quick and not plan.is_larger:
        found.append(Trial("smoother motion", replace(plan, tilt_s=SMOOTHER_S)))
    return found


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
    """An exhibit that has said what it `needs`, with a free constant at a value."""

    def __init__(
        self, exhibit: Exhibit, plan: Plan, constant: str = "", value: float = 0.0
    ) -> None:
        self._tried = constant, value
        with trying(*self._tried):
            self._steps = exhibit(plan)
            self.needs = next(self._steps)

    def evidence(self, data: Data) -> Evidence:
        """What the exhibit shows once its needs are computed."""
        inputs: dict[int | None, dict[str, str]] = {}
        for result in (data[key] for key in self.needs):
            if hasattr(result, "sha256"):
                inputs.setdefault(result.clip.seed, {})[result.clip.name] = result.sha256
        try:
            with trying(*self._tried):
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
    tasks: Sequence[Task],
    n_processes: int | None,
    on_result: Callable[[int, str], None],
    kept: Path | None = None,
) -> Data:
    """Compute what is needed in several processes; what is timed, alone in this one.

    `on_result` is called with the number of results and the name of the last. `kept` is a folder
    for the responses to clips, from which an interrupted run goes on. Raises Interrupted if the
    user asks to stop, and passes on the exceptions of a call.
    """
    data: dict[Key, Any] = {}
    timed = [task for task in tasks if _name(task[0]).startswith(TIMING)]
    shared = [task for task in tasks if task not in timed]
    each = results_of(partial(_result, kept), shared, n_processes)
    for (key, _), result in chain(each, results_of(partial(_result, None), timed, 1)):
        if isinstance(result, DlgmdError):
            raise result
        data[key] = result
        on_result(len(data), _name(key))
    return data


def _result(kept: Path | None, task: Task) -> Any:
    key, need = task
    return run_clip(key, need, kept) if isinstance(key, Clip) else need()


def _name(key: Key) -> str:
    return key.name if isinstance(key, Clip) else str(key)
