"""A model at every point of a grid of two parameters; what is done is kept, and not done again.

The folder of a sweep has `sweep.yaml`, which says what is swept, and `sweep.csv`, to which rows are
appended as points are done. Both are written anew at the end, the record last.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli import cancel
from dlgmd_cli.errors import DlgmdError, OutputExistsError, ParameterError, WorkerError
from dlgmd_cli.models.base import Grey, create_model
from dlgmd_cli.models.engines import choose_engine
from dlgmd_cli.parameters import DlgmdParameters, Parameters
from dlgmd_cli.pool import run_tasks
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import write_rows
from dlgmd_cli.results.record import SCHEMA, read_record, versions, yaml_text
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.sweep import Grid, Series, SweepResult
from dlgmd_cli.runs.run import OnFrame, Tell, input_identity, input_record, too_short
from dlgmd_cli.video.frames import Frame, InputOptions, Video
from dlgmd_cli.video.prefetch import opencv_threads, read_ahead

RECORD, TABLE, FIGURE = "sweep.yaml", "sweep.csv", "sweep"
PRODUCTS = frozenset({RECORD, TABLE, *(f"{FIGURE}.{suffix}" for suffix in store.PLOT_FORMATS)})
ATTENUATION_COLUMNS = ("attenuation_db",)
RESPONSE_COLUMNS = (
    *("mp_max", "mp_max_frame", "sharpness", "distinguishability"),
    *("first_alarm_frame", "first_alarm_time_s", "mean_attenuation_db"),
)
# Cells that a task of a process steps through, some tenth of a second: shorter ones cost more.
_CELLS_PER_TASK = 20_000_000

# Of each clip, the numbers of the columns that a sweep has.
Values = tuple[tuple[float, ...], ...]
Point = tuple[int, Parameters]
# Name, total (None if it is not known) and unit -> what is called with the number that is done.
Progress = Callable[[str, int | None, str], AbstractContextManager[OnFrame]]


@dataclass(frozen=True)
class Subject:
    """What the models of a sweep look at.

    Attributes
    ----------
    name : str
        What results are called.
    size_wh : (int, int)
        Width and height of the frames, in px.
    clips : callable
        The frames of each clip. Rows farther than so many px from any change may be left out;
        None asks for all.
    speeds_px : tuple of float
        Of each clip, the speed of its cube in px/frame; empty for a video, of which the response
        is measured instead of attenuation alone.
    settings : dict
        What it adds to the record's `sweep`.
    too_short : callable
        From the number of frames, the model's label and the number that it needs to the error.
    options : dict
        What is read of a video, as the record has it.
    identity : dict
        What tells a video from others.
    facts : callable
        What the record says of a video of so many frames, once they are read.
    """

    name: str
    size_wh: tuple[int, int]
    clips: Callable[[int | None], Iterable[Iterable[Frame]]]
    speeds_px: tuple[float, ...]
    settings: dict[str, Any]
    too_short: Callable[[int, str, int], DlgmdError]
    n_expected: int | None = None
    options: dict[str, Any] = field(default_factory=dict)
    identity: dict[str, Any] = field(default_factory=dict)
    facts: Callable[[int], dict[str, Any]] = lambda n_frames: {"warnings": []}


def video_subject(
    path: str, video: Video, options: InputOptions, false_positive_frame: int | None = None
) -> Subject:
    """A video, or pictures, that `path` led to.

    Parameters
    ----------
    path : str
        As the user gave it.
    video : Video
        Open; it may be closed when the sweep is done.
    options : InputOptions
        How it was opened.
    false_positive_frame : int, optional
        Where a response is a mistake, for distinguishability.
    """
    identity = {**input_identity(video.info, path), "decoder": video.info.decoder}

    def frames() -> Iterator[Frame]:
        with opencv_threads(1), read_ahead(video) as ahead:
            yield from ahead

    def facts(n_frames: int) -> dict[str, Any]:
        known = input_record(video, video.size_wh, n_frames, identity)
        return {**known, "warnings": list(video.progress.warnings)}

    return Subject(
        name=video.info.name,
        size_wh=video.size_wh,
        clips=lambda reach_px: [frames()],
        speeds_px=(),
        settings={"false_positive_frame": false_positive_frame},
        too_short=lambda n_frames, label, n: too_short(path, video, label, n, options),
        n_expected=options.n_expected(video.info),
        options=options.to_record(),
        identity=identity,
        facts=facts,
    )


@dataclass(frozen=True)
class _Clip:
    """Decoded frames, `shape` (n, H, W), in a temporary file that any process can map."""

    path: Path
    dtype: str
    shape: tuple[int, int, int]
    frame: npt.NDArray[np.int64]
    time_s: Series
    is_still: bool

    @classmethod
    def keep(cls, path: Path, frames: Iterable[Frame], on_frame: OnFrame) -> "_Clip":
        """Write frames of one size and type, at least one, into a file."""
        numbers: list[tuple[int, float]] = []
        first: Grey = np.empty((0, 0))
        is_still = True
        with path.open("wb") as file:
            for one in frames:
                cancel.check()
                first = one.grey if not numbers else first
                is_still = is_still and np.array_equal(one.grey, first)
                file.write(np.ascontiguousarray(one.grey).data)
                numbers.append((one.index, one.time_s))
                on_frame(one.index + 1)
        frame, time_s = np.array(numbers, dtype=np.float64).T.copy()
        height, width = first.shape
        shape = (len(numbers), height, width)
        return cls(path, first.dtype.name, shape, frame.astype(np.int64), time_s, is_still)

    def open(self) -> Grey:
        """The frames, read from the file as they are needed."""
        return np.asarray(np.memmap(self.path, self.dtype, mode="r", shape=self.shape))


@dataclass(frozen=True)
class _Probe:
    """Computes points of a sweep, in any process."""

    clips: tuple[_Clip, ...]
    engine: str
    columns: tuple[str, ...]
    by_sequence: bool
    false_positive_frame: int | None

    def __call__(
        self, batch: Sequence[Point], tell: Tell = lambda message: None
    ) -> list[tuple[int, Values]]:
        """The numbers of some points, and for each clip the values of the columns."""
        found = []
        with opencv_threads(1):
            pictures = [clip.open() for clip in self.clips]
            for point, params in batch:
                model = create_model(params, engine=self.engine, tell=tell)
                values = []
                for clip, frames in zip(self.clips, pictures, strict=True):
                    model.reset()
                    rows = np.empty((4, len(frames)))
                    for i, (grey, time_s) in enumerate(zip(frames, clip.time_s, strict=True)):
                        cancel.check()
                        one = model.step(grey, time_s)
                        rows[:, i] = one.mp, one.p_sum, one.s_sum, one.attenuation_db
                    values.append(self._measured(clip, params, rows))
                found.append((point, tuple(values)))
        return found

    def _measured(self, clip: _Clip, params: Parameters, rows: Series) -> tuple[float, ...]:
        """The values of the columns; NaN stands for what there is not."""
        mp, p_sum, s_sum, attenuation_db = rows
        attenuation = _mean_attenuation(attenuation_db)
        if self.columns == ATTENUATION_COLUMNS:
            return (attenuation,)
        _, height, width = clip.shape
        options = {"normalise": "sequence"} if self.by_sequence else {}
        record = {"processed": {"width": width, "height": height}, "options": options}
        sums = (p_sum, s_sum, attenuation_db)
        result = Result(clip.frame, clip.time_s, mp, *sums, params, record)
        facts = {**result.summary, "sharpness": result.sharpness, "distinguishability": None}
        if self.false_positive_frame is not None:
            facts["distinguishability"] = result.distinguishability(self.false_positive_frame)
        facts["mean_attenuation_db"] = attenuation
        values = (facts[name] for name in self.columns)
        return tuple(math.nan if value is None else float(value) for value in values)


def _mean_attenuation(attenuation_db: Series) -> float:
    """Mean over frames where something passes; -inf if nothing ever does, NaN if none is valid."""
    passing = attenuation_db[np.isfinite(attenuation_db)]
    if passing.size:
        return math.fsum(passing) / passing.size
    return -math.inf if np.isneginf(attenuation_db).any() else math.nan


def _computed(
    waiting: list[Point], probe: _Probe, jobs: int, tell: Tell
) -> Iterator[tuple[int, Values]]:
    """Every point with its values, as they are done; the values do not depend on `jobs`."""
    if probe.engine == "numba" and jobs > 1:
        # Compiled in this process first: the others find the code on disk.
        yield from probe(waiting[:1], tell)
        waiting = waiting[1:]
    n_cells = sum(math.prod(clip.shape) for clip in probe.clips)
    size = max(1, min(_CELLS_PER_TASK // n_cells, -(-len(waiting) // jobs)))
    batches = [waiting[start : start + size] for start in range(0, len(waiting), size)]
    if jobs == 1 or len(batches) == 1:
        for one in waiting:
            yield from probe([one], tell)
        return
    for _, outcome in run_tasks(probe, batches, min(jobs, len(batches))):
        if isinstance(outcome.error, WorkerError):
            raise WorkerError("a point of the grid", outcome.error.why, outcome.error.mend)
        yield from outcome.result()


def _possible(grid: Grid, base: Parameters) -> tuple[dict[int, Parameters], ParameterError | None]:
    """The parameters at every point where they are valid; why the first of the others is not."""
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


def engine_for(params: Parameters, asked: str, size_wh: tuple[int, int], tell: Tell) -> str:
    """The engine that `run` would use on frames of that size; raises what `create_model` does."""
    model = create_model(params, engine=asked)
    if params.model != "dlgmd":
        return model.engine_name
    return choose_engine(asked, size_wh[0] * size_wh[1], tell)


class Sweep:
    """A sweep and the folder that it is kept in.

    Parameters
    ----------
    folder : Path
        Where its files are.
    subject : Subject
        What the models look at.
    grid : Grid
        Parameters that differ.
    params : Parameters
        The others.
    label : str
        What errors call the model.
    engine : str
        What computes it, not `auto`.

    Attributes
    ----------
    points : dict of int to Parameters
        The parameters at all points that are possible.
    fault : ParameterError or None
        Why the first of the other points is not.
    result : SweepResult
        What is done so far.

    Raises
    ------
    ParameterError
        If no point is possible.
    """

    def __init__(
        self,
        folder: Path,
        subject: Subject,
        grid: Grid,
        params: Parameters,
        label: str,
        engine: str,
    ) -> None:
        self.folder, self.subject, self.grid = folder, subject, grid
        self.params, self.label, self.engine = params, label, engine
        self.points, self.fault = _possible(grid, params)
        columns = ATTENUATION_COLUMNS if subject.speeds_px else RESPONSE_COLUMNS
        self.result = SweepResult.empty(grid, subject.speeds_px, columns, self.points)
        self._facts: dict[str, Any] = {}

    def resume(self, *, overwrite: bool = False) -> None:
        """Take in the points that the folder, which must be there, has of the same sweep.

        Raises
        ------
        OutputExistsError
            If it has other files, or another sweep that may not be replaced.
        """
        names = {path.name for path in self.folder.iterdir()}
        strays = sorted(name for name in names if not name.startswith(store.PREFIX))
        if strays and RECORD not in names:
            why = f"it holds other files, such as {strays[0]}"
            raise OutputExistsError(str(self.folder), why, "Choose another --out.")
        if overwrite or RECORD not in names:
            return
        before = read_record(self.folder / RECORD)
        differing = _differing(before, yaml.safe_load(self._text(self._settings())))
        if self.subject.identity and not store.is_same_input(before, self.subject.identity):
            differing.append("input")
        if differing:
            why = f"a sweep with other settings already exists here ({', '.join(differing)})"
            mend = "Add --overwrite to replace it, or choose another --out."
            raise OutputExistsError(str(self.folder), why, mend)
        self._facts = {k: before[k] for k in ("input", "processed", "warnings") if k in before}
        self.result.read(self.folder / TABLE)

    def compute(
        self,
        jobs: int = 1,
        *,
        tell: Tell = lambda message: None,
        progress: Progress = lambda *_: nullcontext(lambda n_done: None),
    ) -> None:
        """Compute what is not there yet, and append it to the table.

        Raises
        ------
        SourceError, ParameterError
            If there are too few frames for every point.
        OutputError
            If something cannot be written.
        WorkerError
            If one of several processes dies.
        Interrupted
            If the user asks to stop. Points that are done are kept.
        """
        done = self.result.done
        missing = [one for one in self.points.items() if one[0] not in done]
        if not missing:
            return
        try:
            clips = self._keep_frames(progress)
            self._require_an_answer(clips)
            self._begin()
            probe = _Probe(
                clips,
                self.engine,
                tuple(self.result.columns),
                by_sequence=self.subject.options.get("normalise") == "sequence",
                false_positive_frame=self.subject.settings.get("false_positive_frame"),
            )
            with (
                progress(f"sweep {self.subject.name}", len(self.points), "point") as on_point,
                (self.folder / TABLE).open("a", newline="", encoding="utf-8") as file,
            ):
                table = csv.writer(file, lineterminator="\n")
                for point, values in _computed(missing, probe, jobs, tell):
                    self.result.put(point, values)
                    table.writerows(self.result.rows([point]))
                    file.flush()
                    on_point(len(done))
        except OSError as error:
            raise store.unwritable(self.folder, error) from None
        finally:
            with suppress(OSError):
                store.remove(self.folder, ())

    def finish(self, figures: Mapping[str, store.Write]) -> None:
        """Write the table in order, `figures` by the names of their files, and the record.

        Raises
        ------
        OutputError
            If something cannot be written.
        """
        rows = self.result.rows(range(len(self.grid)))
        text = self._text(self._record(complete=True))
        files: dict[str, store.Write] = {
            TABLE: partial(write_rows, header=self.result.header, rows=rows),
            **figures,
            RECORD: lambda path: path.write_text(text, encoding="utf-8"),
        }
        try:
            for name, write in files.items():
                store.write_file(self.folder / name, write)
        except OSError as error:
            raise store.unwritable(self.folder, error) from None

    @property
    def warnings(self) -> list[str]:
        """What is doubtful about the input, a line each."""
        return list(self._facts.get("warnings", []))

    def _keep_frames(self, progress: Progress) -> tuple[_Clip, ...]:
        """Write the frames of all clips into files, and note what the record says of them."""
        subject, clips = self.subject, []
        radii = [one.r for one in self.points.values() if isinstance(one, DlgmdParameters)]
        with progress(subject.name, subject.n_expected, "frame") as on_frame:
            for number, frames in enumerate(subject.clips(max(radii, default=None))):
                path = self.folder / f"{store.PREFIX}frames-{number}"
                clips.append(_Clip.keep(path, frames, on_frame))
        self._facts = subject.facts(len(clips[0].frame))
        if clips[0].is_still and len(clips[0].frame) > 1:
            self._facts["warnings"].append("no frame differs from the one before it")
        return tuple(clips)

    def _require_an_answer(self, clips: Sequence[_Clip]) -> None:
        """Raise if the shortest clip ends before the model can answer, at every point."""
        n_frames = min(len(clip.frame) for clip in clips)
        least = math.inf
        for params in self.points.values():
            least = min(least, create_model(params).first_valid_frame + 1)
            if least <= n_frames:
                return
        raise self.subject.too_short(n_frames, self.label, int(least))

    def _begin(self) -> None:
        """Make the folder that of this sweep, with the points that were taken in."""
        done = self.result.done
        for name in () if done else PRODUCTS:
            (self.folder / name).unlink(missing_ok=True)
        store.write_text(self.folder / RECORD, self._text(self._record(complete=False)))
        rows = self.result.rows(sorted(done))
        write = partial(write_rows, header=self.result.header, rows=rows)
        store.write_file(self.folder / TABLE, write)

    def _settings(self) -> dict[str, Any]:
        """The part of the record that says what is swept."""
        axes = {self.grid.x.key, self.grid.y.key}
        params = self.params.to_dict()
        swept = {"x": self.grid.x.to_record(), "y": self.grid.y.to_record()}
        return {
            "model": self.params.model,
            "engine": self.engine,
            **{key: value for key, value in params.items() if key not in axes},
            "options": self.subject.options,
            "sweep": {**swept, **self.subject.settings},
        }

    def _record(self, *, complete: bool) -> dict[str, Any]:
        """What `sweep.yaml` says."""
        summary = {
            "points": len(self.grid),
            "computed": len(self.result.done),
            "impossible": len(self.grid) - len(self.points),
        }
        facts = {key: value for key, value in self._facts.items() if key != "warnings"}
        outcome = {"warnings": self.warnings, "complete": complete, "summary": summary}
        return {**facts, **self._settings(), **outcome}

    def _text(self, record: dict[str, Any]) -> str:
        """A record with the versions, as YAML."""
        used = versions(str(self.subject.identity.get("decoder")), self.engine)
        return yaml_text({"schema": SCHEMA, **record, "versions": used}, default_flow_style=None)


def _differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """The keys by which the settings `now` differ from those on record."""
    swept = before.get("sweep")
    known = {**before, **(swept if isinstance(swept, dict) else {})}
    asked = {**now, **now["sweep"]}
    return [key for key in asked if key != "sweep" and known.get(key) != asked[key]]
