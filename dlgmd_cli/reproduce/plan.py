"""The plan of a report: what its exhibits need, how that is computed, and what they show."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, WorkerError
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.reproduce.clips import EVERY, VERSIONS, Clip, run_clip
from dlgmd_cli.reproduce.finished import Finished

# Replaces the version of claims that are not about the D-LGMD.
ANY = "any"
# Calls whose names begin with this are timed, and have the machine to themselves.
TIMING = "timing"
# Pixels of all models that see a clip together: more would take too much memory.
_PIXELS_AT_ONCE = 32 * 1920 * 1080
# Seeds of a report, of a quick one, and of the check at full size; six give a 95 % interval.
_SEEDS, _FEW_SEEDS = 20, 6

# For a clip, the models that see it, by label; for a name, a call without arguments.
Needs = dict[Any, Any]
# A clip and some of its models, or a name and its call.
Task = tuple[Any, Any]
# The results, by the same clips and names.
Data = Mapping[Any, Any]


@dataclass(frozen=True)
class Plan:
    """How an exhibit is made: extent, frame size, and whose frames.

    `quick` is fewer seeds and coarser grids. `is_full_size` renders flights at the paper's size,
    with fewer seeds and without the null models. `reference` is the folder of the authors' frames.
    `is_idle` says that nothing else runs, so that times mean something.
    """

    quick: bool = False
    reference: Path | None = None
    is_full_size: bool = False
    is_idle: bool = True

    @property
    def name(self) -> str:
        """What distinguishes this from other plans of the same report."""
        if self.reference is not None:
            return "authors' frames"
        return "1920x1080" if self.is_full_size else "own frames"

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of what is rendered with one."""
        return tuple(range(_FEW_SEEDS if self.quick or self.is_full_size else _SEEDS))

    @property
    def flight_size(self) -> tuple[int, int]:
        """Height and width of the flights."""
        return (1080, 1920) if self.is_full_size else (270, 480)

    @property
    def versions(self) -> tuple[str, ...]:
        """The versions of the D-LGMD to run: without the null models at full size."""
        return tuple(VERSIONS) if self.is_full_size else EVERY


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
    figures: Mapping[str, Callable[[], Any]] = field(default_factory=dict)
    tables: Mapping[str, list[tuple[Any, ...]]] = field(default_factory=dict)
    inputs: Mapping[int | None, Mapping[str, str]] = field(default_factory=dict)


# A figure or table of the paper: it yields what it needs, is sent the results, and returns what it
# shows.
Exhibit = Callable[[Plan], Generator[Needs, Data, Evidence]]
Steps = Generator[Needs, Data, Evidence]


@dataclass
class Started:
    """An exhibit that has said what it needs."""

    steps: Steps
    needs: Needs

    @classmethod
    def of(cls, steps: Steps) -> "Started":
        """Start an exhibit."""
        return cls(steps, next(steps))

    def evidence(self, data: Data) -> Evidence:
        """What the exhibit shows once its needs are computed."""
        inputs: dict[int | None, dict[str, str]] = {}
        for found in (data[key] for key in self.needs):
            if hasattr(found, "sha256"):
                inputs.setdefault(found.clip.seed, {})[found.clip.name] = found.sha256
        try:
            self.steps.send(data)
        except StopIteration as end:
            return replace(end.value, inputs=inputs)
        raise RuntimeError("an exhibit yields once")


def by_version(
    value: Callable[[str], float | list[float]], versions: Iterable[str] = EVERY
) -> dict[str, list[float]]:
    """The values for each version: one per seed, or a single one."""
    found = {version: value(version) for version in versions}
    return {v: one if isinstance(one, list) else [float(one)] for v, one in found.items()}


def needed(started: Iterable[Started]) -> list[Task]:
    """The tasks of exhibits; a clip is rendered for all of them together."""
    needs: Needs = {}
    for exhibit in started:
        for key, need in exhibit.needs.items():
            needs[key] = {**needs.get(key, {}), **need} if isinstance(key, Clip) else need
    return [task for need in needs.items() for task in _tasks(*need)]


def compute(
    tasks: Sequence[Task],
    n_processes: int,
    on_result: Callable[[int, str], None],
    finished: Finished | None = None,
) -> Data:
    """Compute what is needed in several processes; what is timed, alone in this one.

    `on_result` is called with the number of results and the name of the last. Clips that are
    `finished` are not computed again, and new ones are added to them. Raises Interrupted if the
    user asks to stop, and passes on the exceptions of a call.
    """
    data: dict[Any, Any] = {}
    known = [(task, found) for task in tasks if finished and (found := finished.read(task))]
    shared: list[Task] = []
    timed: list[Task] = []
    for task in tasks:
        if not any(task is one for one, _ in known):
            (timed if _name(task[0]).startswith(TIMING) else shared).append(task)
    each = results_of(_result, shared, min(n_processes, len(shared)))
    for n_done, (task, found) in enumerate(chain(known, each, results_of(_result, timed, 1)), 1):
        key = task[0]
        if isinstance(found, WorkerError):
            raise WorkerError(_name(key), found.why, found.mend)
        if isinstance(found, DlgmdError):
            raise found
        if finished and n_done > len(known):
            finished.write(task, found)
        data[key] = data[key].joined(found) if isinstance(key, Clip) and key in data else found
        on_result(n_done, _name(key))
    return data


def _tasks(key: Any, need: Any) -> list[Task]:
    """A call, or a clip with some of its models at a time."""
    if not isinstance(key, Clip):
        return [(key, need)]
    height, width = dict(key.flags).get("--size", (1080, 1920))
    n, models = max(1, _PIXELS_AT_ONCE // (height * width)), iter(need.items())
    return [(key, some) for some in iter(lambda: dict(islice(models, n)), {})]


def _result(task: Task) -> Any:
    key, need = task
    return run_clip(key, need) if isinstance(key, Clip) else need()


def _name(key: Any) -> str:
    return key.name if isinstance(key, Clip) else str(key)
