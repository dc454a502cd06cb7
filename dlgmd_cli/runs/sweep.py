"""A model at every point of a grid of its parameters, on one tape."""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import partial
from itertools import islice

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.engines import choose_engine
from dlgmd_cli.parameters import Parameters
from dlgmd_cli.results.measures import distinguishability, sharpness, summarise
from dlgmd_cli.results.tables import Result
from dlgmd_cli.runs.axis import Grid
from dlgmd_cli.runs.reading import Reading
from dlgmd_cli.runs.spool import Player, Tape
from dlgmd_cli.runs.workers import Workers, here

# Of each clip, the numbers of the columns that a sweep has.
Values = tuple[tuple[float, ...], ...]

ATTENUATION_COLUMNS = ("attenuation_db",)
RESPONSE_COLUMNS = (
    *("mp_max", "mp_max_frame", "sharpness", "distinguishability"),
    *("first_collision_frame", "first_collision_time_s", "mean_attenuation_db"),
)


@dataclass(frozen=True)
class Attenuation:
    """Measures how much of the change passes: the mean over the frames where something does.

    It is -inf where nothing ever passes, and NaN where no frame is valid.
    """

    columns = ATTENUATION_COLUMNS

    def __call__(self, result: Result) -> tuple[float, ...]:
        """The columns' values."""
        mean = summarise(result)["mean_attenuation_db"]
        if mean is not None:
            return (mean,)
        return (-math.inf if np.isneginf(result.attenuation_db).any() else math.nan,)


@dataclass(frozen=True)
class ResponseMeasures:
    """Measures the response to a video; NaN stands for what there is not.

    `false_positive_frame` is where a response is a mistake, for distinguishability.
    """

    false_positive_frame: int | None = None

    columns = RESPONSE_COLUMNS

    def __call__(self, result: Result) -> tuple[float, ...]:
        """The columns' values."""
        facts = dict(summarise(result), sharpness=sharpness(result), distinguishability=None)
        if self.false_positive_frame is not None:
            facts["distinguishability"] = distinguishability(result, self.false_positive_frame)
        (attenuation,) = Attenuation()(result)
        facts["mean_attenuation_db"] = attenuation
        return tuple(
            math.nan if facts[name] is None else float(facts[name]) for name in self.columns
        )


@dataclass(frozen=True)
class Probe:
    """How a point is computed; calling it opens the tape, for one process.

    Attributes
    ----------
    tape : Tape
        The input.
    measure : Attenuation or ResponseMeasures
        What is measured of each clip.
    engine : str
        What computes the model, not `auto`.
    by_sequence : bool
        Collisions follow the potential normalised by its own sequence, not the absolute one.
    """

    tape: Tape
    measure: Attenuation | ResponseMeasures
    engine: str
    by_sequence: bool = False

    def __call__(self) -> Callable[[tuple[int, Parameters]], Values]:
        """What turns a point of the grid, its number and parameters, into values."""
        return partial(self._answer, self.tape.open())

    def _answer(self, player: Player, task: tuple[int, Parameters]) -> Values:
        _, params = task
        height, width = self.tape.shape
        model = create_model(params, engine=self.engine)
        return tuple(
            self.measure(
                Reading(recording, (width, height), params, by_sequence=self.by_sequence).whole()
            )
            for recording in player.play(model)
        )


def engine_for(
    params: Parameters, asked: str, size_wh: tuple[int, int], tell: Callable[[str], None]
) -> str:
    """The engine that `run` would use on frames of that size.

    Raises
    ------
    ParameterError
        If the model has no such engine.
    MissingExtraError
        If the engine needs a package that is not installed.
    """
    model = create_model(params, engine=asked)
    if params.model != "dlgmd":
        return model.engine_name
    return choose_engine(asked, size_wh[0] * size_wh[1], tell)


def grid_parameters(
    grid: Grid, base: Parameters
) -> tuple[dict[int, Parameters], ParameterError | None]:
    """The parameters at every point where they are possible, and why they are not elsewhere.

    Parameters
    ----------
    grid : Grid
        What differs.
    base : Parameters
        What does not.

    Returns
    -------
    (dict of int to Parameters, ParameterError or None)
        By number of the point; the error is that of the first point that is left out.

    Raises
    ------
    ParameterError
        If they are not possible anywhere.
    """
    found: dict[int, Parameters] = {}
    first_fault = None
    same = base.to_dict()
    for point in range(len(grid)):
        try:
            found[point] = type(base).from_mapping({**same, **grid.overrides(point)})
        except ParameterError as error:
            first_fault = first_fault or error
    if not found and first_fault is not None:
        raise ParameterError("--x and --y", first_fault.why, first_fault.mend)
    return found, first_fault


def shortest_need(points: Mapping[int, Parameters], n_frames: int) -> int | None:
    """Frames that the model needs at least, if that is more than `n_frames`; else None."""
    least = math.inf
    for params in points.values():
        needed = create_model(params).first_valid_frame + 1
        if needed <= n_frames:
            return None
        least = min(least, needed)
    return int(least)


def sweep(
    points: Mapping[int, Parameters],
    probe: Probe,
    *,
    jobs: int = 1,
    tell: Callable[[str], None] = lambda message: None,
    on_ready: Callable[[], None] = lambda: None,
) -> Iterator[tuple[int, Values]]:
    """Compute points of a grid, P of the input being known.

    The values do not depend on `jobs`.

    Parameters
    ----------
    points : mapping of int to Parameters
        By number of the point; at least one.
    probe : Probe
        The input, and what is measured.
    jobs : int
        Processes that share the points out; with one it is this process.
    tell : callable, optional
        Called with a message before something that takes long.
    on_ready : callable, optional
        Called when every process has the tape open.

    Yields
    ------
    (int, tuple of tuple of float)
        Number of a point, as it is done, and for each clip the values of the measure's columns.

    Raises
    ------
    WorkerError
        If one of several processes dies.
    """
    if probe.engine == "numba":
        _compile_once(next(iter(points.values())), probe, tell)
    n_workers = min(jobs, len(points))
    pool: AbstractContextManager = here(probe) if n_workers == 1 else Workers(n_workers, probe)
    with pool as answers:
        on_ready()
        for (point, _), values in answers(points.items()):
            yield point, values


def _compile_once(params: Parameters, probe: Probe, tell: Callable[[str], None]) -> None:
    """Compile in this process, so that the others find compiled code on disk."""
    model = create_model(params, engine=probe.engine, tell=tell)
    for _ in islice(probe.tape.open().play(model, model.first_valid_frame + 1), 1):
        pass
