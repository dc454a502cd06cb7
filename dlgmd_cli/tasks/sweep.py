"""A model over a grid of two of its parameters. An interrupted sweep can be resumed.

The folder of a sweep has `sweep.yaml` with its settings, and `sweep.csv`, to which rows are
appended as points are computed. Both are rewritten at the end, the record last.
"""

import csv
import logging
import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli.errors import OutputExistsError, ParameterError, WorkerError, counted
from dlgmd_cli.frame import Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.files import PREFIX, staging
from dlgmd_cli.machine.pool import run_tasks
from dlgmd_cli.machine.threads import n_processors
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.engines import choose_engine
from dlgmd_cli.models.step import Stepper
from dlgmd_cli.parameters.checks import blame
from dlgmd_cli.parameters.presets import DlgmdParameters, Parameters, reformulated
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import RowList, rows_of
from dlgmd_cli.results.record import differences, read_record
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.sweep import (
    ATTENUATION_COLUMNS,
    RESPONSE_COLUMNS,
    Axis,
    Grid,
    SweepResult,
    measured,
)
from dlgmd_cli.scenes.stimuli.flat import cube_clips
from dlgmd_cli.tasks import call
from dlgmd_cli.tasks.call import ModelName, OnFrame, Progress, Setup, no_progress
from dlgmd_cli.tasks.run import input_record, too_short
from dlgmd_cli.video.opening import Openable
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.source import Video, opencv_threads, read_ahead

_log = logging.getLogger(__name__)

RECORD, TABLE = SweepResult.RECORD, SweepResult.TABLES[0]
# The paper's Fig. 11: its parameters, except for those that it varies (no latency, as a comment in
# the paper's source says; a and r are ours); speeds in px/frame, side of the cubes in px, and size.
FIG_11 = {"alpha": 0.0, "beta": 0.0, "lam": 0.0, "a": 1.5, "r": 4}
SPEEDS_PX, SIDE_PX, SIZE_WH = (1.0, 2.0, 3.0, 4.0), 40.0, (200, 150)
# Cells per task, a few tenths of a second of work; smaller tasks would add overhead.
_CELLS_PER_TASK = 20_000_000
# Keys of a record that do not identify a sweep.
_FOUND = ("input", "processed", "warnings", "complete", "summary")

# A point: its number and its parameters. Its values: for each clip, one number per column.
Point = tuple[int, Parameters]
Values = list[tuple[float, ...]]
# A temporary file of frames, and the data type of one frame.
KeptFrames = tuple[Path, np.dtype[np.void]]
AxisText = str | tuple[str, Iterable[Any]]


def sweep(
    video: Openable | None = None,
    *,
    x: AxisText,
    y: AxisText,
    speed: Iterable[float] = (),
    cube_size: float | None = None,
    frames: int | None = None,
    false_positive_frame: int | None = None,
    model: ModelName | None = None,
    formulation: str | None = None,
    param: Mapping[str, Any] | None = None,
    engine: str | None = None,
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
        The input, as in `run`, of which responses are measured. Without it, black cubes cross a
        white image, one clip per speed, and the attenuation is measured ([Zhao2023] Fig. 11).
    x, y : str, or (str, iterable)
        A parameter and its values: ``"sigma_e=0.2:2:0.1"``, ``"r=2,4,6"`` or ``("r", [2, 4, 6])``.
    speed, cube_size, frames : optional
        Of the cubes: speeds in px/frame (1, 2, 3 and 4), side in px (40), frames per clip.
    false_positive_frame : int, optional
        Frame of a false alarm in `video`, to measure the distinguishability.
    model, formulation, param, engine
        The model, as in `run`; for cubes, the default is that of Fig. 11.
    jobs, progress
        As in `batch`.
    out : str or path, optional
        Write into ``out/sweep-NAME``, as `dlgmd sweep` does with `formats`, `dpi`, `width` and
        `overwrite`; the same call continues an interrupted sweep.
    options
        Options of the input, as in `run`; of cubes, only `size`.

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
    cubes = {"speed": tuple(speed), "cube_size": cube_size, "frames": frames}
    _refuse_others(video, cubes, {**options, "false_positive_frame": false_positive_frame})
    overridden, formats = param or {}, store.known_formats(formats)
    is_fig11 = video is None and (model is None or model == call.DLGMD)
    if is_fig11:
        model, param = call.DLGMD, {**FIG_11, **overridden}
    request = call.fold(model, formulation, param, engine, options, video).by_spikes()
    if is_fig11:
        request = replace(request, setups=(replace(request.setup, label="fig11"),))
    grid = _grid(x, y, type(request.setup.params), overridden, formulation)
    with ExitStack() as opened:
        if video is None:
            subject = _cubes(cubes, request.options.size, grid, request.setup.params)
        else:
            of_points = (v for a in (grid.x, grid.y) if a.key == "formulation" for v in a.values)
            source = opened.enter_context(request.open(video, of_points))
            settings = {"false_positive_frame": false_positive_frame}
            name, size_wh = source.info.name, source.size_wh
            subject = SweepInput(name, size_wh, [source], settings, (), source, request.options)
        place = Path(opened.enter_context(TemporaryDirectory()) if out is None else out)
        folder = place / f"sweep-{store.fitting(subject.name)}"
        claim = opened.enter_context(store.claimed(folder, RECORD))
        swept = Sweep(claim.folder, subject, grid, request.setup)
        swept.resume(overwrite=overwrite)
        _compute(swept, jobs or n_processors(), progress)
        if out is not None:
            swept.result.write(claim, formats, dpi, width=width)
            swept.result.paths = (folder,)
    return swept.result


def _refuse_others(
    video: Openable | None, of_cubes: dict[str, Any], of_video: dict[str, Any]
) -> None:
    """Raise if an option is given that does not work with, or without, a video."""
    options, needed = (of_video, "with an") if video is None else (of_cubes, "without")
    for name, value in options.items():
        if value not in (None, ()) and name != "size":
            why = f"--{name.replace('_', '-')} works only {needed} INPUT"
            raise ParameterError("", why, "Leave it out.")


def _grid(
    x: AxisText,
    y: AxisText,
    kind: type[Parameters],
    param: Mapping[str, Any],
    formulation: str | None,
) -> Grid:
    """The grid of both axes; errors name the option of the axis."""
    axes = []
    for option, axis in (("--x", x), ("--y", y)):
        text = axis if isinstance(axis, str) else f"{axis[0]}={','.join(map(str, axis[1]))}"
        with blame(f"Invalid value for '{option}'"):
            axes.append(Axis.parse(text, kind))
        key = axes[-1].key
        if key in param:
            raise ParameterError("", f"--param sets {key}, which is an axis", "Leave it out.")
        if key == "formulation" and formulation is not None:
            raise ParameterError("", "--formulation is an axis of the sweep", "Leave it out.")
    return Grid(*axes)


def _cubes(
    cubes: dict[str, Any], size_wh: tuple[int, int] | None, grid: Grid, params: Parameters
) -> "SweepInput":
    """The cubes that are asked for; clips are as high as the largest kernel needs."""
    speeds_px, size_wh = cubes["speed"] or SPEEDS_PX, size_wh or SIZE_WH
    side_px = SIDE_PX if cubes["cube_size"] is None else cubes["cube_size"]
    radii = [axis.values[-1] for axis in (grid.x, grid.y) if axis.key == "r"]
    reach_px = max([*radii, getattr(params, "r", size_wh[1])])
    return cube_input(speeds_px, side_px, cubes["frames"], size_wh, reach_px)


def _compute(swept: "Sweep", n_jobs: int, progress: Progress) -> None:
    """Compute the missing points; log how many were done before, and warnings at the end."""
    done, n_points, n_grid = swept.result.done, len(swept.points), len(swept.grid)
    if done:
        _log.info("%d of %d points are already done.", len(done), n_points)
    try:
        swept.compute(n_jobs, progress=progress)
    except Exception:
        if done:
            _log.info(
                "%s holds %d of %d points; the same command continues from there.",
                *(swept.folder, len(done), n_points),
            )
        raise
    if swept.fault is not None:
        left_out = f"{n_grid - n_points} of {n_grid} points"
        _log.warning("%s cannot be computed: %s", left_out, swept.fault.why)
    result = swept.result
    if result.speeds_px and all(np.isnan(column).all() for column in result.columns.values()):
        why = "no attenuation, since the model returns no sums of P and S"
        result.warnings.append(f"{why}; with INPUT, its MP is measured")
    subject = swept.subject
    name = subject.name if subject.video is None else subject.video.info.given
    for warning in result.warnings:
        _log.warning("%s: %s", name, warning)


def keep_frames(path: Path, frames: Iterable[Frame], on_frame: OnFrame = call.silent) -> KeptFrames:
    """Write frames of one size and type, at least one, into a file for memory mapping.

    Duplicate frames are left out.
    """
    with path.open("wb") as file:
        for frame in frames:
            cancel.check()
            if frame.is_repeat:
                continue
            picture = ("grey", frame.grey.dtype, frame.grey.shape)
            facts = [("frame", np.int64), ("time_s", np.float64), ("after_gap", np.bool_)]
            kind = np.dtype([*facts, picture], align=True)
            row = frame.index, frame.time_s, frame.after_gap, frame.grey
            file.write(np.array(row, kind).tobytes())
            on_frame(frame.index + 1)
    return path, kind


def _mapped(clip: KeptFrames) -> npt.NDArray[np.void]:
    """The memory-mapped frames of a clip: number, time, gap flag and image of each."""
    return np.asarray(np.memmap(clip[0], clip[1], mode="r"))


def _frames(clip: KeptFrames) -> Iterator[Frame]:
    for row in _mapped(clip):
        is_gap = bool(row["after_gap"])
        yield Frame(int(row["frame"]), float(row["time_s"]), row["grey"], after_gap=is_gap)


@dataclass(frozen=True)
class SweepInput:
    """The input of a sweep: a video, or translating cubes with one clip per speed.

    `settings` is added to the record. For a video, opened with the `options`, the response is
    measured; for cubes, only the attenuation.
    """

    name: str
    size_wh: tuple[int, int]
    clips: Sequence[Iterable[Frame]]
    settings: dict[str, Any]
    speeds_px: tuple[float, ...] = ()
    video: Video | None = None
    options: InputOptions = field(default_factory=InputOptions)


@dataclass(frozen=True)
class _Probe:
    """Computes points of a sweep; picklable."""

    clips: list[KeptFrames]
    engine: str
    columns: tuple[str, ...]
    options: Mapping[str, Any]
    false_positive_frame: int | None
    hidden: npt.NDArray[np.bool_] | None = None

    def __call__(self, batch: Sequence[Point]) -> list[tuple[int, Values]]:
        """Compute some points: their numbers, and for each clip the values of the columns."""
        with opencv_threads(1):
            return [(point, self._values(params)) for point, params in batch]

    def _values(self, params: Parameters) -> Values:
        stepper = Stepper(create_model(params, engine=self.engine))
        stepper.ignore(self.hidden)
        values = []
        for clip in self.clips:
            stepper.reset()
            rows = RowList()
            for frame in _frames(clip):
                cancel.check()
                rows.append(frame, stepper.step(frame))
            height, width = frame.grey.shape
            n_hidden = 0 if self.hidden is None else np.count_nonzero(self.hidden)
            size = {"width": width, "height": height, "cells": width * height - n_hidden}
            result = Result(rows.rows(), params, {"processed": size, "options": self.options})
            values.append(measured(result, self.columns, self.false_positive_frame))
        return values


def _computed(waiting: list[Point], probe: _Probe, jobs: int) -> Iterator[tuple[int, Values]]:
    """Points with their values in order of completion; the values do not depend on `jobs`."""
    if probe.engine == "numba" and jobs > 1:
        # Compile in this process first: the others load the code from disk.
        yield from probe(waiting[:1])
        waiting = waiting[1:]
    n_cells = sum(_mapped(clip)["grey"].size for clip in probe.clips)
    size = max(1, min(_CELLS_PER_TASK // n_cells, -(-len(waiting) // jobs)))
    batches = [waiting[start : start + size] for start in range(0, len(waiting), size)]
    if jobs == 1 or len(batches) == 1:
        for point in waiting:
            yield from probe([point])
        return
    for _, outcome in run_tasks(probe, batches, min(jobs, len(batches))):
        if isinstance(outcome.error, WorkerError):
            raise WorkerError("a point of the grid", outcome.error.why, outcome.error.hint)
        yield from outcome.result()


def engine_for(params: Parameters, engine: str, size_wh: tuple[int, int]) -> str:
    """The engine that `run` would use for this frame size; raises what `create_model` raises."""
    model = create_model(params, engine=engine)
    if not isinstance(params, DlgmdParameters):
        return model.engine_name
    return choose_engine(engine, size_wh[0] * size_wh[1])


class Sweep:
    """A sweep of the model `setup` over a grid, stored in a folder.

    `points` holds the parameters of all valid points, and `fault` the error of the first invalid
    one. `result` holds what is computed so far, and the doubts about the input. Raises
    ParameterError if no point is valid.
    """

    def __init__(self, folder: Path, subject: SweepInput, grid: Grid, setup: Setup) -> None:
        self.folder, self.subject, self.grid, self.setup = folder, subject, grid, setup
        self.engine = engine_for(setup.params, setup.engine, subject.size_wh)
        self.points: dict[int, Parameters] = {}
        self.fault: ParameterError | None = None
        for point in range(len(grid)):
            try:
                self.points[point] = replace(setup.params, **reformulated(grid.overrides(point)))  # type: ignore[type-var]
            except ParameterError as error:
                self.fault = self.fault or error
        if self.fault and not self.points:
            raise ParameterError("--x and --y", self.fault.why, self.fault.hint)
        columns = ATTENUATION_COLUMNS if subject.speeds_px else RESPONSE_COLUMNS
        names = subject.name, setup.label
        self.result = SweepResult.empty(grid, subject.speeds_px, columns, self.points, *names)
        info: Any = subject.video and subject.video.info
        self._identity = {**info.identity, "decoder": info.decoder} if info else {}
        self.result.about.update(
            settings=subject.settings,
            decoder=str(self._identity.get("decoder")),
            model={
                "model": setup.params.model,
                "engine": self.engine,
                **setup.params.to_dict(),
                "options": subject.options.to_record(),
            },
        )

    def resume(self, *, overwrite: bool = False) -> None:
        """Load the points of the same sweep that the folder, which must exist, already has.

        Raises OutputExistsError if it has other files, or another sweep that may not be replaced.
        """
        names = {path.name for path in self.folder.iterdir()}
        strays = sorted(name for name in names if not name.startswith(PREFIX))
        if strays and RECORD not in names:
            why = f"contains other files, such as {strays[0]}"
            raise OutputExistsError(str(self.folder), why, "Choose another --out.")
        if overwrite or RECORD not in names:
            return
        before, now = read_record(self.folder / RECORD), yaml.safe_load(self.result.record_text())
        options, swept = now.pop("options"), now.pop("sweep")
        settings = {**now, **swept}
        differing = differences(
            {**before, **before.get("sweep", {})},
            identity=self._identity,
            settings={key: settings[key] for key in settings if key not in _FOUND},
            options=options,
        )
        if differing:
            why = f"a sweep with other settings already exists here ({', '.join(differing)})"
            hint = "Add --overwrite to replace it, or choose another --out."
            raise OutputExistsError(str(self.folder), why, hint)
        facts = {key: before[key] for key in ("input", "processed") if key in before}
        self.result.about["input"] = facts
        self.result.warnings[:] = before.get("warnings", [])
        self.result.read(self.folder / TABLE)

    def compute(self, jobs: int = 1, *, progress: Progress = no_progress) -> None:
        """Compute the missing points and append them to the table.

        Computed points are kept after an error: SourceError or ParameterError if there are too few
        frames, OutputError, WorkerError if a process dies, or Interrupted.
        """
        done, subject = self.result.done, self.subject
        missing = [point for point in self.points.items() if point[0] not in done]
        if not missing:
            return
        with store.writing(self.folder), staging(self.folder) as stage:
            clips = self._keep_frames(stage, progress)
            stale = () if done else SweepResult.own_files(store.PLOT_FORMATS)
            store.ClaimedFolder(self.folder, RECORD).commit(self.result.so_far(), stale=stale)
            probe = _Probe(
                clips,
                self.engine,
                tuple(self.result.columns),
                subject.options.to_record(),
                subject.settings.get("false_positive_frame"),
                None if subject.video is None else subject.video.hidden(),
            )
            with (
                progress(f"sweep {subject.name}", len(self.points), "point") as on_point,
                store.appending(self.folder / TABLE) as file,
            ):
                table = csv.writer(file, lineterminator="\n")
                for point, values in _computed(missing, probe, jobs):
                    self.result.put(point, values)
                    table.writerows(self.result.rows([point]))
                    file.flush()
                    on_point(len(done))

    def _keep_frames(self, folder: Path, progress: Progress) -> list[KeptFrames]:
        """Write the frames of all clips into `folder`; raises if no point has enough of them."""
        subject, video, clips = self.subject, self.subject.video, []
        total = None if video is None else subject.options.n_expected(video.info)
        with progress(subject.name, total, "frame") as on_frame, opencv_threads(1):
            for number, frames in enumerate(subject.clips):
                with read_ahead(frames) as ahead:
                    clips.append(keep_frames(folder / f"frames-{number}", ahead, on_frame))
        n_frames = min(len(_mapped(clip)) for clip in clips)
        n_needed = sys.maxsize
        for params in self.points.values():
            n_needed = min(n_needed, create_model(params).first_valid_frame + 1)
            if n_needed <= n_frames:
                break
        else:
            label = self.setup.label
            if video is not None:
                raise too_short(video, label, n_needed, subject.options)
            why = f"{counted(n_frames, 'frame')} of each cube, but {label} needs at least"
            hint = "Give more frames, slower cubes, or a wider --size."
            raise ParameterError("--frames", f"{why} {n_needed}", hint)
        if video is not None:
            first = _mapped(clips[0])
            rows = rows_of({name: first[name] for name in ("frame", "time_s")})
            self.result.about["input"] = input_record(video, video.size_wh, rows)
            self.result.warnings[:] = video.progress.warnings
        return clips


def cube_input(
    speeds_px: Sequence[float],
    side_px: float,
    n_frames: int | None,
    size_wh: tuple[int, int],
    reach_px: int,
) -> "SweepInput":
    """Black cubes that translate over white, one clip for each speed, see `cube_clips`."""
    speeds_px = tuple(dict.fromkeys(speeds_px))
    clips, cubes = cube_clips(speeds_px, side_px, n_frames, size_wh, reach_px)
    return SweepInput("translating-cubes", size_wh, clips, {"cubes": cubes}, speeds_px)
