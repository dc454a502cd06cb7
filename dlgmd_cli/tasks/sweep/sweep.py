"""A model over a grid of two of its parameters; files are written when all points are computed."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from dlgmd_cli.errors import (
    DlgmdError,
    ParameterError,
    WorkerError,
    argument,
    counted,
    printable,
    warn,
)
from dlgmd_cli.frame import Flags, Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.files import staging
from dlgmd_cli.machine.pool import results_of
from dlgmd_cli.machine.threads import n_processors, opencv_threads
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.session import Session
from dlgmd_cli.parameters.checks import refuse
from dlgmd_cli.parameters.facts import (
    Json,
    Processed,
    Record,
    Value,
    extended,
    flat,
    stating,
)
from dlgmd_cli.parameters.keys import DEGREES
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import RowList, rows_of
from dlgmd_cli.results.files import FIGURE_FORMATS
from dlgmd_cli.results.grid import AxisText, Grid
from dlgmd_cli.results.result import Result
from dlgmd_cli.scenes.objects import cube_clips
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import ModelName, Progress, Request, no_progress
from dlgmd_cli.tasks.describing import identified, input_record
from dlgmd_cli.tasks.stepping import too_short
from dlgmd_cli.tasks.sweep.sweep_result import SweepResult, Sweeps
from dlgmd_cli.video.base import input_name, is_pattern
from dlgmd_cli.video.input_options import INPUT_ARGUMENTS, InputOptions
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.source import KeptFrames, Video, read_ahead

# The measures: attenuation of cubes, then responses to a video.
_FURTHER = ("attenuation_frames", "median_attenuation_db", "pooled_attenuation_db")
ATTENUATION_COLUMNS: tuple[str, ...] = ("attenuation_db", *_FURTHER)
RESPONSE_COLUMNS = (
    *("mp_max", "mp_max_frame", "sharpness", "distinguishability"),
    *("first_alarm_frame", "first_alarm_time_s", "mean_attenuation_db"),
    *_FURTHER,
)
# The paper's Fig. 11: its fixed parameters (no latency, by a comment in the paper's source; a and r
# are our choice), speeds in px/frame, side of the cubes in px, and (width, height) in px.
FIG_11 = {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4}
SPEEDS_PX, SIDE_PX, SIZE_WH = (1.0, 2.0, 3.0, 4.0), 40.0, (200, 150)

# A point: its number and its parameters. The values of a point: per clip, one number per column.
Point = tuple[int, Parameters]
PointValues = list[tuple[float, ...]]


@stating(INPUT_ARGUMENTS)
def sweep(
    video: Openable | None = None,
    model: ModelName | None = None,
    *,
    x: AxisText,
    y: AxisText,
    speed: Iterable[float] = (),
    cube_size: float | None = None,
    frames: int | None = None,
    false_positive_frame: int | None = None,
    formulation: str | None = None,
    param: Mapping[str, Value] | None = None,
    jobs: int | None = None,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    progress: Progress = no_progress,
    **options: Any,
) -> SweepResult:
    """Run a model over a grid of values of two parameters, as `dlgmd sweep` does.

    Parameters
    ----------
    video : str, path, or iterable of ndarray, optional
        The input, as in `run`, whose responses are measured. Without a video, black cubes cross a
        white image, one clip per speed, and the attenuation is measured ([Zhao2023] Fig. 11).
    model, formulation, param
        The model, as in `run`; for cubes, the default is the model of Fig. 11.
    x, y : str, or (str, iterable)
        A parameter and its values: ``"sigma_e=0.2:2:0.1"``, ``"r=2,4,6"`` or ``("r", [2, 4, 6])``.
    speed, cube_size, frames : optional
        For cubes: speeds in px/frame (1, 2, 3 and 4), side in px (40), frames per clip.
    false_positive_frame : int, optional
        Frame of a false alarm in `video`, to measure the distinguishability.
    jobs, progress
        As in `batch`.
    out : str or path, optional
        Write the files of `dlgmd sweep` into ``out/sweep-NAME``, with `formats`, `dpi`, `width` and
        `overwrite`. An interrupted sweep writes nothing.
    options
        Options of the input, as in `run`; for cubes, only `size`.

    Returns
    -------
    SweepResult
        `columns` has each measure, shape (clips, values of y, values of x); `table` is a structured
        array with the columns of sweep.csv; `plot` draws.

    Raises
    ------
    ParameterError
        If an axis, a parameter or an option is not valid.
    SourceError, OutputError, OutputExistsError, MissingExtraError, WorkerError
        As in `run` and `batch`.

    Examples
    --------
    >>> found = sweep(x="sigma_e=0.2:2:0.2", y="sigma_i=1:6:1")  # doctest: +SKIP
    >>> found.columns["attenuation_db"].shape  # doctest: +SKIP
    (4, 6, 10)
    """
    speeds_px = tuple(dict.fromkeys(speed))
    others: dict[str, object] = {"speed": speeds_px, "cube_size": cube_size, "frames": frames}
    if video is None:
        others = {**options, "size": None, "false_positive_frame": false_positive_frame}
    refuse(others, f"works only {'with an INPUT' if video is None else 'without INPUT'}")
    of_rule = {name: options.get(name) for name in ("alarm", "threshold", "speed_m_s", "brake")}
    of_rule["alarm"] = of_rule["alarm"] or (param or {}).get("alarm")
    refuse(of_rule, "does not work here: the alarms of a sweep are those of the rule spikes")
    formats = store.known_formats(formats)
    if video is None and (model is None or model == call.DLGMD):
        of_fig_11 = call.choose(call.DLGMD, {**FIG_11, **(param or {})}, formulation)
        model = replace(of_fig_11, label="Fig. 11")
    request = call.fold(model, formulation, param, options, video).by_spikes()
    call.require_measured(request.setups, options)
    params = request.setup.params
    grid = Grid.parse(x, y, type(params), param or {}, formulation)
    if DEGREES in (params.to_dict().get("units"), *grid.values_of("units")):
        raise ParameterError("", "a sweep works in px and frames", "Leave out units.")
    with ExitStack() as opened:
        clips: Sequence[Iterable[Frame]]
        if video is None:
            source, speeds_px = None, speeds_px or SPEEDS_PX
            size_wh = request.options.size or SIZE_WH
            side_px = SIDE_PX if cube_size is None else cube_size
            # Clips are just high enough for the largest kernel.
            reach_px = max(*grid.values_of("r"), getattr(params, "r", size_wh[1]), 0)
            clips, cubes = cube_clips(speeds_px, side_px, frames, size_wh, reach_px)
            swept: dict[str, Json] = {"cubes": cubes}
        else:
            source = opened.enter_context(request.open(video, grid.values_of("formulation")))
            clips, swept = [source], {"false_positive_frame": false_positive_frame}
        result, fault = _planned(grid, request, swept, speeds_px, source)
        place = Path(opened.enter_context(TemporaryDirectory()) if out is None else out)
        folder = place / f"sweep-{store.fitting(result.name)}"
        names = SweepResult.own_files(formats)
        claimed = store.claimed(folder, SweepResult.RECORD, names=names, overwrite=overwrite)
        claim = opened.enter_context(claimed)
        with store.writing(folder), staging(folder) as stage:
            kept = _keep_frames(result, clips, source, request.options, stage, progress)
            _compute(result, kept, source, jobs or n_processors(), progress)
        _tell(result, fault, result.name if source is None else source.info.given)
        if out is not None:
            files = result.files(formats, dpi, width=width)
            claim.write(files, stale=SweepResult.own_files(FIGURE_FORMATS))
            result.paths = (folder,)
    return result


@stating(sweep)
def sweeps(
    videos: Sequence[str | os.PathLike[str]],
    model: ModelName | None = None,
    *,
    out: str | os.PathLike[str] | None = None,
    formats: Iterable[str] = (),
    dpi: int = 200,
    width: Literal["one", "two"] = "one",
    overwrite: bool = False,
    **arguments: Any,
) -> Sweeps:
    """A sweep of each video over the same grid, and one figure of their maps side by side.

    Arguments and files are those of `sweep`; the figure of all maps is written beside the folders.
    Raises the errors of `sweep`, and ParameterError if two videos would have the same folder.
    """
    formats = store.known_formats(formats)
    if out is not None:
        _refuse_same_names(videos)
    arguments |= {"out": out, "overwrite": overwrite}
    found = Sweeps([sweep(video, model, **arguments) for video in videos])
    if out is not None and formats:
        with store.claimed(Path(out), overwrite=True) as claim:
            found.write(claim, found.files(formats, dpi, width=width))
    return found


def _refuse_same_names(videos: Sequence[str | os.PathLike[str]]) -> None:
    """Raise ParameterError if two inputs have the same name: their folders would be the same."""
    names = [
        input_name(video, are_pictures=Path(video).is_dir() or is_pattern(os.fspath(video)))
        for video in videos
    ]
    for name in names:
        if names.count(name) > 1:
            hint = f"Sweep them one at a time, each with an {argument('out')} of its own."
            raise ParameterError("", f"two inputs are called {printable(name)}", hint)


def _planned(
    grid: Grid,
    request: Request,
    swept: Mapping[str, Json],
    speeds_px: tuple[float, ...],
    video: Video | None,
) -> tuple[SweepResult, ParameterError | None]:
    """The sweep before its first point, and the error of an invalid point, if any.

    The sweep's record has the axes and `swept`. Raises ParameterError if no point is valid.
    """
    setup = request.setup
    points, fault = grid.points(setup.params)
    name, names = "translating-cubes", ATTENUATION_COLUMNS
    if video is not None:
        name, names = video.info.name, RESPONSE_COLUMNS
    params, keys = setup.params.to_dict(), (grid.x.key, grid.y.key)
    others = {key: value for key, value in params.items() if key not in keys}
    settings = extended({"model": setup.params.model}, others)
    if setup.model_sha256:
        settings["model_sha256"] = setup.model_sha256
    settings["options"] = {} if video is None else request.options.to_record()
    axes = {"x": grid.x, "y": grid.y}
    values = {place: {"key": axis.key, "values": [*axis.values]} for place, axis in axes.items()}
    settings["sweep"] = {**values, **swept}
    columns = {name: np.full((len(speeds_px) or 1, *grid.shape), np.nan) for name in names}
    return SweepResult(grid, name, setup.label, points, columns, settings, speeds_px), fault


def _compute(
    result: SweepResult,
    clips: list[KeptFrames],
    video: Video | None,
    n_jobs: int,
    progress: Progress,
) -> None:
    """Compute all points; raises WorkerError if a process dies, ModelError, or Interrupted."""
    points = [*result.points.items()]
    hidden = None if video is None else video.hidden()
    probe = _Probe(clips, result.settings, tuple(result.columns), hidden)
    with progress(f"sweep {result.name}", len(points), "point") as on_point:
        computed = _computed(points, probe, n_jobs)
        for n_done, (point, values) in enumerate(computed, start=1):
            result.put(point, values)
            on_point(n_done)


def _tell(result: SweepResult, fault: ParameterError | None, name: str) -> None:
    """Log warnings about invalid points and about the input."""
    if fault is not None:
        n_left_out = len(result.grid) - len(result.points)
        warn(f"{n_left_out} of {len(result.grid)} points cannot be computed: {fault.why}")
    if result.speeds_px and np.isnan(result.columns["attenuation_db"]).all():
        why = "no attenuation, since the model returns no sums of P and S"
        result.warnings.append(f"{why}; with INPUT, its MP is measured")
    for warning in result.warnings:
        warn(f"{name}: {warning}")


def _keep_frames(
    result: SweepResult,
    clips: Sequence[Iterable[Frame]],
    video: Video | None,
    options: InputOptions,
    folder: Path,
    progress: Progress,
) -> list[KeptFrames]:
    """Write the frames of all clips into `folder`; raises if they are too few for every point."""
    kept, total = [], None if video is None else options.n_expected(video.info)
    with progress(result.name, total, "frame") as on_frame, opencv_threads(1):
        for number, frames in enumerate(clips):
            with read_ahead(frames) as ahead:
                kept.append(KeptFrames.write(folder / f"frames-{number}", ahead, on_frame))
    n_frames = min(len(clip.rows()) for clip in kept)
    needs = (create_model(params).first_valid_frame + 1 for params in result.points.values())
    if all(n_needed > n_frames for n_needed in needs):
        n_needed = min(create_model(p).first_valid_frame + 1 for p in result.points.values())
        if video is not None:
            raise too_short(video, result.label, n_needed, options)
        why = f"{counted(n_frames, 'frame')} of each cube, but {result.label} needs at least"
        hint = f"Give more frames, slower cubes, or a wider {argument('size')}."
        raise ParameterError(argument("frames"), f"{why} {n_needed}", hint)
    if video is not None:
        first = kept[0].rows()
        rows = rows_of({name: first[name] for name in ("frame", "time_s")})
        result.source = input_record(video, video.size_wh, rows, identified(video, options))
        result.warnings = [*video.progress.warnings]
    return kept


@dataclass(frozen=True)
class _Probe:
    """Computes a point of a sweep with its `settings`, see `SweepResult`; picklable."""

    clips: list[KeptFrames]
    settings: Record
    columns: tuple[str, ...]
    hidden: Flags | None

    def __call__(self, point: Point) -> PointValues:
        """Compute a point: for each clip, the values of the columns."""
        _, params = point
        n_hidden = 0 if self.hidden is None else int(np.count_nonzero(self.hidden))
        values = []
        with opencv_threads(1):
            model = create_model(params)
            model.ignore(self.hidden)
            session = Session([model])
            for clip in self.clips:
                session.reset()
                rows = RowList()
                for frame in clip:
                    cancel.check()
                    (answer,) = session.step(frame)
                    rows.append(answer)
                height, width = frame.grey.shape
                n_cells = width * height - n_hidden
                size: Processed = {"width": width, "height": height, "cells": n_cells}
                record: Record = {**self.settings, "processed": size}
                result = Result.of(rows.rows(), params, record)
                values.append(measured(result, self.columns))
        return values


def measured(result: Result, columns: Sequence[str]) -> tuple[float, ...]:
    """The values of the columns at one point, from the point's result; NaN where undefined."""
    facts = flat(result.attenuations)
    if not facts["attenuation_frames"]:  # -inf if nothing passes in any frame
        facts["mean_attenuation_db"] = facts["median_attenuation_db"]
    facts["attenuation_db"] = facts["mean_attenuation_db"]
    if tuple(columns) != ATTENUATION_COLUMNS:
        facts = {**flat(result.summary), **facts, "sharpness": result.sharpness}
    false_positive = result.record["sweep"].get("false_positive_frame")
    if isinstance(false_positive, int):
        facts["distinguishability"] = result.distinguishability(false_positive)
    values = map(facts.get, columns)
    return tuple(float(v) if isinstance(v, int | float) else math.nan for v in values)


def _computed(points: list[Point], probe: _Probe, jobs: int) -> Iterator[tuple[int, PointValues]]:
    """Points with their values in order of completion; the values do not depend on `jobs`."""
    for (point, _), values in results_of(probe, points, jobs):
        if isinstance(values, WorkerError):
            raise WorkerError("a point of the grid", values.why, values.hint)
        if isinstance(values, DlgmdError):
            raise values
        yield point, values
