"""The plan of a report: what its exhibits need, how that is computed, and what they show."""

from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import Any

from dlgmd_cli.errors import DlgmdError, WorkerError
from dlgmd_cli.lab.reproduce.clips import EVERY, Clip, run_clip
from dlgmd_cli.pool import results_of

# Replaces the version of claims that are not about the D-LGMD.
ANY = "any"
# Calls whose names begin with this are timed, and have the machine to themselves.
TIMING = "timing"
# Models that see a clip together: more would take too much memory at 1920x1080.
_AT_ONCE = 32

# For a clip, the models that see it, by label; for a name, a call without arguments.
Needs = dict[Any, Any]
# A clip and some of its models, or a name and its call.
Task = tuple[Any, Any]
# The results, by the same clips and names.
Data = Mapping[Any, Any]


@dataclass(frozen=True)
class Plan:
    """The extent of a report, the folder of reference frames, and whether times mean anything.

    `quick` is fewer seeds per flight, and small frames. `is_idle` says that nothing else runs.
    """

    quick: bool = False
    reference: Path | None = None
    is_idle: bool = True

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of the flights."""
        return (0, 1) if self.quick else (0, 1, 2)

    @property
    def flight_size(self) -> tuple[int, int]:
        """Height and width of the flights: those of the paper, unless quick."""
        return (270, 480) if self.quick else (1080, 1920)


@dataclass(frozen=True)
class Evidence:
    """What an exhibit shows.

    Attributes
    ----------
    values : dict
        Claim -> version -> one value per seed; NaN where it is undefined.
    figures : dict
        File name without suffix -> function that draws the figure.
    table : sequence of tuple
        Header, then rows of Table IV: radius, scale, the paper's value, and ours.
    """

    values: dict[str, dict[str, list[float]]]
    figures: Mapping[str, Callable[[], Any]] = field(default_factory=dict)
    table: list[tuple[Any, ...]] = field(default_factory=list)


# A figure or table of the paper: it yields what it needs, is sent the results, and returns what it
# shows.
Exhibit = Callable[[Plan], Generator[Needs, Data, Evidence]]


def by_version(
    value: Callable[[str], float | list[float]], versions: Iterable[str] = EVERY
) -> dict[str, list[float]]:
    """The values for each version: one per seed, or a single one."""
    found = {version: value(version) for version in versions}
    return {v: one if isinstance(one, list) else [float(one)] for v, one in found.items()}


def needed(started: Iterable[Generator[Needs, Data, Evidence]]) -> list[Task]:
    """The tasks of exhibits that have been called; a clip is rendered for all of them together."""
    needs: Needs = {}
    for exhibit in started:
        for key, need in next(exhibit).items():
            needs[key] = {**needs.get(key, {}), **need} if isinstance(key, Clip) else need
    return [task for need in needs.items() for task in _tasks(*need)]


def shown_by(exhibit: Generator[Needs, Data, Evidence], data: Data) -> Evidence:
    """What an exhibit shows once its needs are computed."""
    try:
        exhibit.send(data)
    except StopIteration as end:
        found: Evidence = end.value
        return found
    raise RuntimeError("an exhibit yields once")


def compute(tasks: Sequence[Task], n_processes: int, on_result: Callable[[int, str], None]) -> Data:
    """Compute what is needed in several processes; what is timed, alone in this one.

    `on_result` is called with the number of results and the name of the last. Raises Interrupted if
    the user asks to stop, and passes on the exceptions of a call.
    """
    data: dict[Any, Any] = {}
    shared = [task for task in tasks if not _name(task[0]).startswith(TIMING)]
    timed = [task for task in tasks if _name(task[0]).startswith(TIMING)]
    each = results_of(_result, shared, min(n_processes, len(shared)))
    for n_done, ((key, _), found) in enumerate(chain(each, results_of(_result, timed, 1)), 1):
        if isinstance(found, WorkerError):
            raise WorkerError(_name(key), found.why, found.mend)
        if isinstance(found, DlgmdError):
            raise found
        if key in data:
            found = replace(found, results={**data[key].results, **found.results})
        data[key] = found
        on_result(n_done, _name(key))
    return data


def _tasks(key: Any, need: Any) -> list[Task]:
    """A call, or a clip with a few of its models at a time."""
    if not isinstance(key, Clip):
        return [(key, need)]
    models = iter(need.items())
    return [(key, some) for some in iter(lambda: dict(islice(models, _AT_ONCE)), {})]


def _result(task: Task) -> Any:
    key, need = task
    return run_clip(key, need) if isinstance(key, Clip) else need()


def _name(key: Any) -> str:
    return key.scene if isinstance(key, Clip) else str(key)
