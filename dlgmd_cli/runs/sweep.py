"""Sweeps: a model at every point of a grid of two parameters. An interrupted sweep can be resumed.

The folder of a sweep has `sweep.yaml` with its settings, and `sweep.csv`, to which rows are
appended as points are computed. Both are rewritten at the end, the record last.
"""

import csv
import math
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli import cancel
from dlgmd_cli.errors import DlgmdError, OutputExistsError, ParameterError, WorkerError
from dlgmd_cli.files import PREFIX, staging
from dlgmd_cli.frame import Frame
from dlgmd_cli.models.base import create_model
from dlgmd_cli.models.engines import choose_engine
from dlgmd_cli.models.step import Stepper
from dlgmd_cli.parameters import DistributedParameters, Parameters, reformulated
from dlgmd_cli.pool import run_tasks
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import write_rows
from dlgmd_cli.results.record import SCHEMA, differences, read_record, versions, yaml_text
from dlgmd_cli.results.result import Result, Series
from dlgmd_cli.results.rows import RowList, Rows, rows_of
from dlgmd_cli.results.sweep import Grid, SweepResult
from dlgmd_cli.runs.run import OnFrame, Progress, input_record, no_progress, silent, too_short
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.options import InputOptions
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead
from dlgmd_cli.video.source import Video
from dlgmd_cli.words import counted

RECORD, TABLE, FIGURE = "sweep.yaml", "sweep.csv", "sweep"
PRODUCTS = frozenset({RECORD, TABLE, *(f"{FIGURE}.{suffix}" for suffix in store.PLOT_FORMATS)})
ATTENUATION_COLUMNS = ("attenuation_db",)
RESPONSE_COLUMNS = (
    *("mp_max", "mp_max_frame", "sharpness", "distinguishability"),
    *("first_alarm_frame", "first_alarm_time_s", "mean_attenuation_db"),
)
# Cells per task, a few tenths of a second of work; smaller tasks would add overhead.
_CELLS_PER_TASK = 20_000_000
# Keys of a record that do not identify a sweep.
_OUTCOME = ("input", "processed", "warnings", "complete", "summary")

# A point: its number and its parameters. Its values: for each clip, one number per column.
Point = tuple[int, Parameters]
Values = list[tuple[float, ...]]
# A temporary file of frames, and the data type of one frame.
Clip = tuple[Path, np.dtype[np.void]]


def keep_frames(path: Path, frames: Iterable[Frame], on_frame: OnFrame = silent) -> Clip:
    """Write frames of one size and type, at least one, into a file for memory mapping.

    Repeats are left out.
    """
    with path.open("wb") as file:
        for one in frames:
            cancel.check()
            if one.is_repeat:
                continue
            picture = ("grey", one.grey.dtype, one.grey.shape)
            facts = [("frame", np.int64), ("time_s", np.float64), ("after_gap", np.bool_)]
            kind = np.dtype([*facts, picture], align=True)
            row = one.index, one.time_s, one.after_gap, one.grey
            file.write(np.array(row, kind).tobytes())
            on_frame(one.index + 1)
    return path, kind


def _mapped(clip: Clip) -> npt.NDArray[np.void]:
    """The memory-mapped frames of a clip: number, time, gap flag and picture of each."""
    return np.asarray(np.memmap(clip[0], clip[1], mode="r"))


def _frames(clip: Clip) -> Iterator[Frame]:
    for one in _mapped(clip):
        is_gap = bool(one["after_gap"])
        yield Frame(int(one["frame"]), float(one["time_s"]), one["grey"], after_gap=is_gap)


@dataclass(frozen=True)
class SweepInput:
    """The input of a sweep: a video, or translating cubes with one clip per speed.

    `settings` is added to the record. For a video, opened with the options `asked`, the response is
    measured; for cubes, only the attenuation.
    """

    name: str
    size_wh: tuple[int, int]
    clips: Sequence[Iterable[Frame]]
    settings: dict[str, Any]
    speeds_px: tuple[float, ...] = ()
    video: Video | None = None
    path: str = ""
    asked: InputOptions = field(default_factory=InputOptions)


def video_input(
    path: str, video: Video, asked: InputOptions, false_positive_frame: int | None
) -> SweepInput:
    """A video or pictures; distinguishability needs a frame with a false positive response."""
    settings = {"false_positive_frame": false_positive_frame}
    name, size_wh = video.info.name, video.size_wh
    return SweepInput(name, size_wh, [video], settings, video=video, path=path, asked=asked)


@dataclass(frozen=True)
class _Probe:
    """Computes points of a sweep; picklable."""

    clips: list[Clip]
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
        stepper = Stepper(params, engine=self.engine)
        stepper.ignore(self.hidden)
        values = []
        for clip in self.clips:
            stepper.reset()
            rows = RowList()
            for frame in _frames(clip):
                cancel.check()
                rows.append(frame, stepper.step(frame))
            values.append(self._measured(frame.grey.shape, params, rows.rows()))
        return values

    def _measured(
        self, shape: tuple[int, ...], params: Parameters, rows: Rows
    ) -> tuple[float, ...]:
        """The values of the columns; NaN where undefined."""
        attenuation = _mean_attenuation(rows["attenuation_db"])
        if self.columns == ATTENUATION_COLUMNS:
            return (attenuation,)
        height, width = shape
        n_hidden = 0 if self.hidden is None else np.count_nonzero(self.hidden)
        size = {"width": width, "height": height, "cells": width * height - n_hidden}
        result = Result(rows, params, {"processed": size, "options": self.options})
        facts = {**result.summary, "sharpness": result.sharpness, "distinguishability": None}
        if self.false_positive_frame is not None:
            facts["distinguishability"] = result.distinguishability(self.false_positive_frame)
        facts["mean_attenuation_db"] = attenuation
        values = (facts[name] for name in self.columns)
        return tuple(math.nan if value is None else float(value) for value in values)


def _mean_attenuation(attenuation_db: Series) -> float:
    """Mean over frames with S above zero; -inf if there are none, NaN if no frame is valid."""
    passing = attenuation_db[np.isfinite(attenuation_db)]
    if passing.size:
        return math.fsum(passing) / passing.size
    return -math.inf if np.isneginf(attenuation_db).any() else math.nan


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
        for one in waiting:
            yield from probe([one])
        return
    for _, outcome in run_tasks(probe, batches, min(jobs, len(batches))):
        if isinstance(outcome.error, WorkerError):
            raise WorkerError("a point of the grid", outcome.error.why, outcome.error.mend)
        yield from outcome.result()


def engine_for(params: Parameters, asked: str, size_wh: tuple[int, int]) -> str:
    """The engine that `run` would use for this frame size; raises what `create_model` raises."""
    model = create_model(params, engine=asked)
    if not isinstance(params, DistributedParameters):
        return model.engine_name
    return choose_engine(asked, size_wh[0] * size_wh[1])


class Sweep:
    """A sweep of the model `setup` over a grid, stored in a folder.

    `points` holds the parameters of all valid points, and `fault` the error of the first invalid
    one. `result` holds what is computed so far, and the doubts about the input. Raises
    ParameterError if no point is valid.
    """

    def __init__(
        self,
        folder: Path,
        subject: SweepInput,
        grid: Grid,
        setup: Setup,
    ) -> None:
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
            raise ParameterError("--x and --y", self.fault.why, self.fault.mend)
        columns = ATTENUATION_COLUMNS if subject.speeds_px else RESPONSE_COLUMNS
        self.result = SweepResult.empty(grid, subject.speeds_px, columns, self.points, subject.name)
        self._identity: dict[str, Any] = {}
        if subject.video is not None:
            info = subject.video.info
            self._identity = {**info.identity, "decoder": info.decoder}
        self.facts: dict[str, Any] = {}

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
        before, now = read_record(self.folder / RECORD), yaml.safe_load(self._text(complete=True))
        options, swept = now.pop("options"), now.pop("sweep")
        asked = {**now, **swept}
        differing = differences(
            {**before, **before.get("sweep", {})},
            identity=self._identity,
            settings={key: asked[key] for key in asked if key not in _OUTCOME},
            options=options,
        )
        if differing:
            why = f"a sweep with other settings already exists here ({', '.join(differing)})"
            mend = "Add --overwrite to replace it, or choose another --out."
            raise OutputExistsError(str(self.folder), why, mend)
        self.facts = {key: before[key] for key in ("input", "processed") if key in before}
        self.result.warnings[:] = before.get("warnings", [])
        self.result.read(self.folder / TABLE)

    def compute(self, jobs: int = 1, *, progress: Progress = no_progress) -> None:
        """Compute the missing points and append them to the table.

        Computed points are kept after an error: SourceError or ParameterError if there are too few
        frames, OutputError, WorkerError if a process dies, or Interrupted.
        """
        done, subject = self.result.done, self.subject
        missing = [one for one in self.points.items() if one[0] not in done]
        if not missing:
            return
        with store.writing(self.folder), staging(self.folder) as stage:
            clips = self._keep_frames(stage, progress)
            files = self._files(sorted(done), complete=False)
            stale = () if done else PRODUCTS
            store.write_files(self.folder, files, record=RECORD, stale=stale)
            probe = _Probe(
                clips,
                self.engine,
                tuple(self.result.columns),
                subject.asked.to_record(),
                subject.settings.get("false_positive_frame"),
                None if subject.video is None else subject.video.hidden(),
            )
            with (
                progress(f"sweep {subject.name}", len(self.points), "point") as on_point,
                (self.folder / TABLE).open("a", newline="", encoding="utf-8") as file,
            ):
                table = csv.writer(file, lineterminator="\n")
                for point, values in _computed(missing, probe, jobs):
                    self.result.put(point, values)
                    table.writerows(self.result.rows([point]))
                    file.flush()
                    on_point(len(done))

    def finish(self, figures: Mapping[str, store.Write]) -> dict[str, str]:
        """Write the table in order, the `figures` by file name, and the record.

        Returns the figures that could not be drawn, with the reasons. Raises OutputError.
        """
        files = {**self._files(range(len(self.grid)), complete=True), **figures}
        return store.write_files(self.folder, files, record=RECORD)

    def _keep_frames(self, folder: Path, progress: Progress) -> list[Clip]:
        """Write the frames of all clips into `folder`; raises if no point has enough of them."""
        subject, video, clips = self.subject, self.subject.video, []
        total = None if video is None else subject.asked.n_expected(video.info)
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
            raise self._too_short(n_frames, n_needed)
        if video is not None:
            first = _mapped(clips[0])
            rows = rows_of({name: first[name] for name in ("frame", "time_s")})
            self.facts = input_record(video, video.size_wh, rows)
            self.result.warnings[:] = video.progress.warnings
        return clips

    def _too_short(self, n_frames: int, n_needed: int) -> DlgmdError:
        subject, label = self.subject, self.setup.label
        if subject.video is not None:
            return too_short(subject.video, label, n_needed, subject.asked)
        frames = counted(n_frames, "frame")
        why = f"{frames} of each cube, but {label} needs at least {n_needed}"
        return ParameterError("--frames", why, "Give more frames, slower cubes, or a wider --size.")

    def _files(self, points: Iterable[int], *, complete: bool) -> dict[str, store.Write]:
        rows = self.result.rows(points)
        table = partial(write_rows, header=self.result.header, rows=rows)
        return {TABLE: table, RECORD: store.file_of(self._text(complete=complete))}

    def _text(self, *, complete: bool) -> str:
        axes = {"x": self.grid.x, "y": self.grid.y}
        swept = [axis.key for axis in axes.values()]
        params = self.setup.params.to_dict().items()
        record: dict[str, Any] = {
            "schema": SCHEMA,
            **self.facts,
            "model": self.setup.params.model,
            "engine": self.engine,
            **{key: value for key, value in params if key not in swept},
            "options": self.subject.asked.to_record(),
            "sweep": {
                **{name: {"key": a.key, "values": list(a.values)} for name, a in axes.items()},
                **self.subject.settings,
            },
            "warnings": self.result.warnings,
            "complete": complete,
            "summary": {
                "points": len(self.grid),
                "computed": len(self.result.done),
                "impossible": len(self.grid) - len(self.points),
            },
            "versions": versions(str(self._identity.get("decoder")), self.engine),
        }
        return yaml_text(record, default_flow_style=None)
