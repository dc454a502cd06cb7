"""The plan of a report: what its exhibits need, how that is computed, and what they show."""

import hashlib
import json
import shutil
import zipfile
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import DlgmdError, WorkerError
from dlgmd_cli.lab.paper.clips import (
    EVERY,
    VERSIONS,
    Clip,
    ClipResults,
    Models,
    layer_sheet,
    run_clip,
)
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.parameters.facts import Value
from dlgmd_cli.plots.sheets import plot_layers
from dlgmd_cli.plots.style import Figure

# What an exhibit needs: for a clip, the models that see it, by label; for a name, a call without
# arguments. Each is a task; the results are by the same clips and names.
Key = Clip | str
Needs = dict[Key, Any]
Task = tuple[Key, Any]
Data = Mapping[Key, Any]
# The functions that draw figures, by file name without suffix, from the results.
Draw = Callable[[], Figure]
Figures = Callable[[Data], dict[str, Draw]]

FOLDER = "unfinished"
_PACKAGE = Path(__file__).resolve().parents[1]


@cache
def _source() -> str:
    """A digest of the source code of this package."""
    digest = hashlib.sha256()
    for path in sorted(_PACKAGE.rglob("*")):
        if path.suffix in (".py", ".yaml"):
            digest.update(path.read_bytes())
    return digest.hexdigest()


class Finished:
    """Results of clips beside a report, one file each, under a name that says what was computed.

    The name depends on the clip, the models and their parameters, and the source code: what was
    computed by another version is not found.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder / FOLDER

    def read(self, clip: Clip, models: Models) -> ClipResults | None:
        """The results of a clip; None if it is not finished, or the file is damaged."""
        try:
            with np.load(self._path(clip, models), allow_pickle=False) as arrays:
                return ClipResults.of_arrays(clip, models, dict(arrays))
        except (OSError, ValueError, KeyError, zipfile.BadZipFile):
            return None

    def write(self, clip: Clip, models: Models, results: ClipResults) -> None:
        """Keep the results of a clip; what cannot be written is computed again."""
        path = self._path(clip, models)
        stage = path.with_suffix(".part.npz")
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            np.savez(stage, **results.arrays())
            stage.replace(path)
        except OSError:
            stage.unlink(missing_ok=True)

    def remove(self) -> None:
        """Remove the folder: the report is complete."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, clip: Clip, models: Models) -> Path:
        described = {label: repr(params) for label, params in models.items()}
        text = json.dumps([repr(clip), described, _source()], sort_keys=True)
        return self._folder / f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.npz"


# Replaces the version of claims that are not about the D-LGMD.
ANY = "any"
# Calls whose names begin with this are timed, and have the machine to themselves.
TIMING = "timing"
# Height and width of the flights: usual, and the paper's.
USUAL_SIZE, FULL_SIZE = (270, 480), (1080, 1920)
# Seeds of a report, of a quick one, and of the check at full size; six give a 95 % interval.
_SEEDS, FEW_SEEDS = 20, 6

# Exhibits that are checked at the paper's frame size, and those with frames by the authors.
AT_FULL_SIZE = {"fig1", "fig13", "fig14", "fig15", "fig16", "fig17", "table4-da"}
OF_AUTHORS = {"fig8": "ball_and_capsules", "fig10": "looming_ball", "fig12": "looming_ball"}


@dataclass(frozen=True)
class Plan:
    """How an exhibit is made: extent, frame size, and whose frames.

    `quick` is fewer seeds and coarser grids. `flight_size` is the height and width of the flights;
    larger ones have fewer seeds and no null models. `only_seeds` are other seeds than usual.
    `reference` is the folder of the authors' frames. `is_idle` says that nothing else runs, so that
    times mean something.
    """

    quick: bool = False
    reference: Path | None = None
    flight_size: tuple[int, int] = USUAL_SIZE
    only_seeds: tuple[int, ...] = ()
    is_idle: bool = True

    @property
    def name(self) -> str:
        """What distinguishes this from other plans of the same report."""
        if self.reference is not None:
            return "authors' frames"
        height, width = self.flight_size
        return f"{width}x{height}" if self.is_larger else "own frames"

    @property
    def seeds(self) -> tuple[int, ...]:
        """The seeds of what is rendered with one."""
        few = range(FEW_SEEDS if self.quick or self.is_larger else _SEEDS)
        return self.only_seeds or tuple(few)

    @property
    def is_larger(self) -> bool:
        """Whether the flights are larger than usual."""
        return self.flight_size > USUAL_SIZE

    @property
    def versions(self) -> tuple[str, ...]:
        """The versions of the D-LGMD to run: without the null models on larger frames."""
        return tuple(VERSIONS) if self.is_larger else EVERY


def plans_of(name: str, plan: Plan, reference: Path | None) -> list[Plan]:
    """The plan of an exhibit, then those that are shown beside it.

    `reference` is the folder of the authors' frames, if it is given.
    """
    plans = [plan]
    if name in AT_FULL_SIZE and not (plan.quick or plan.is_larger):
        plans.append(replace(plan, flight_size=FULL_SIZE, only_seeds=plan.only_seeds[:6]))
    if reference is not None and name in OF_AUTHORS and (reference / OF_AUTHORS[name]).is_dir():
        plans.append(replace(plan, reference=reference))
    return plans


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


def layer_figures(stem: str, clip: Clip, frames: tuple[int, ...]) -> tuple[Needs, Figures]:
    """What layer images of set 9 need, and the figures, of one version each."""
    names = {"default": f"{stem}-layers", "released-2020": f"{stem}-layers-2020"}
    needs: Needs = {f"layers, {clip}, {v}": partial(layer_sheet, clip, v, frames) for v in names}
    stems = dict(zip(needs, names.values(), strict=True))
    return needs, lambda data: {to: partial(plot_layers, data[key]) for key, to in stems.items()}


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
    n_processes: int,
    on_result: Callable[[int, str], None],
    finished: Finished | None = None,
) -> Data:
    """Compute what is needed in several processes; what is timed, alone in this one.

    `on_result` is called with the number of results and the name of the last. Clips that are
    `finished` are not computed again, and new ones are added to them. Raises Interrupted if the
    user asks to stop, and passes on the exceptions of a call.
    """
    data: dict[Key, Any] = {}
    for task in tasks:
        key, need = task
        if finished and isinstance(key, Clip) and (kept := finished.read(key, need)):
            data[key] = kept
            on_result(len(data), _name(key))
    left = [task for task in tasks if task[0] not in data]
    timed = [task for task in left if _name(task[0]).startswith(TIMING)]
    shared = [task for task in left if task not in timed]
    each = results_of(_result, shared, min(n_processes, len(shared)))
    for task, result in chain(each, results_of(_result, timed, 1)):
        key = task[0]
        if isinstance(result, WorkerError):
            raise WorkerError(_name(key), result.why, result.hint)
        if isinstance(result, DlgmdError):
            raise result
        if finished and isinstance(key, Clip):
            finished.write(key, task[1], result)
        data[key] = result
        on_result(len(data), _name(key))
    return data


def _result(task: Task) -> Any:
    key, need = task
    return run_clip(key, need) if isinstance(key, Clip) else need()


def _name(key: Key) -> str:
    return key.name if isinstance(key, Clip) else str(key)
