"""A model at every point of a grid of two parameters; what is done is kept, and not done again.

The folder of a sweep has `sweep.yaml`, which says what is swept, and `sweep.csv`, to which rows are
appended as points are done. Both are written anew at the end, the record last.
"""

import csv
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import yaml

from dlgmd_cli import cancel
from dlgmd_cli.errors import DlgmdError, OutputError, OutputExistsError, ParameterError, WorkerError
from dlgmd_cli.models.base import Grey, create_model
from dlgmd_cli.models.engines import choose_engine
from dlgmd_cli.parameters import DlgmdParameters, Parameters
from dlgmd_cli.pool import run_tasks
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import write_rows
from dlgmd_cli.results.record import SCHEMA, read_record, versions, yaml_text
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.sweep import Grid, Series, SweepResult
from dlgmd_cli.runs.run import OnFrame, Setup, Tell
from dlgmd_cli.video.frames import Frame
from dlgmd_cli.video.prefetch import opencv_threads

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
class Clip:
    """Decoded frames in a temporary file, which any process can map into its memory.

    Attributes
    ----------
    path : Path
        The file.
    dtype : str
        Type of the frames, uint8 or float32.
    shape : (int, int, int)
        Number, height and width of the frames.
    frame, time_s : ndarray, shape (n,)
        Their numbers and times.
    is_still : bool
        Whether they are all alike.
    """

    path: Path
    dtype: str
    shape: tuple[int, int, int]
    frame: npt.NDArray[np.int64]
    time_s: Series
    is_still: bool

    @classmethod
    def keep(cls, path: Path, frames: Iterable[Frame], on_frame: OnFrame = lambda n: None) -> "Clip":
        """Write frames of one size and type, at least one, into a file.

        Raises
        ------
        OutputError
            If there is no room for them.
        Interrupted
            If the user asks to stop.
        """
        numbers, is_still = [], True
        first: Grey = np.empty((0, 0))
        try:
            with path.open("wb") as file:
                for one in frames:
                    cancel.check()
                    first = one.grey if not numbers else first
                    is_still = is_still and np.array_equal(one.grey, first)
                    file.write(np.ascontiguousarray(one.grey).data)
                    numbers.append((one.index, one.time_s))
                    on_frame(one.index + 1)
        except OSError as error:
            raise OutputError(
                str(path.parent),
                f"the decoded frames cannot be kept there ({error.strerror or error})",
                "Make room, or process smaller frames with --scale.",
            ) from None
        frame, time_s = np.array(numbers, dtype=np.float64).T.copy()
        height, width = first.shape
        shape = (len(numbers), height, width)
        return cls(path, first.dtype.name, shape, frame.astype(np.int64), time_s, is_still)

    def open(self) -> Grey:
        """The frames, shape (n, H, W), read from the file as they are needed."""
        return np.asarray(np.memmap(self.path, self.dtype, mode="r", shape=self.shape))


class Subject(Protocol):
    """What the models of a sweep look at.

    Attributes
    ----------
    name : str
        What results are called.
    size_wh : (int, int)
        Width and height of the frames, in px.
    speeds_px : tuple of float
        Of each clip, the speed of its cube; empty for a video, of which the response is measured
        instead of attenuation alone.
    settings : dict
        What of the record depends on it: `options`, `sweep`, and of a video `input`, as far as it
        is known without decoding.
    false_positive_frame : int or None
        Where a response is a mistake, for distinguishability.
    """

    name: str
    size_wh: tuple[int, int]
    speeds_px: tuple[float, ...]
    settings: dict[str, Any]
    false_positive_frame: int | None

    def clips(
        self, folder: Path, reach_px: int | None, progress: Progress
    ) -> tuple[list[Clip], dict[str, Any]]:
        """Keep all frames in `folder`; also returns what the record says of them.

        Rows that are farther than `reach_px` from any change may be left out, unless it is None.
        """
        ...

    def too_short(self, clip: Clip, label: str, n_needed: int) -> DlgmdError:
        """The error for too few frames."""
        ...


@dataclass(frozen=True)
class Probe:
    """What computes points of a sweep, in any process.

    Attributes
    ----------
    clips : tuple of Clip
        The frames.
    engine : str
        What computes the model.
    measures_response : bool
        Measure `RESPONSE_COLUMNS`, not `ATTENUATION_COLUMNS`.
    by_sequence : bool
        Alarms follow the potential normalised by its own sequence, not the absolute one.
    false_positive_frame : int or None
        See `Subject`.
    """

    clips: tuple[Clip, ...]
    engine: str
    measures_response: bool = False
    by_sequence: bool = False
    false_positive_frame: int | None = None

    def __call__(
        self, batch: Sequence[Point], tell: Tell = lambda message: None
    ) -> list[tuple[int, Values]]:
        """Numbers and values of some points."""
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

    def _measured(self, clip: Clip, params: Parameters, rows: Series) -> tuple[float, ...]:
        """The values of the columns; NaN stands for what there is not."""
        attenuation = mean_attenuation(rows[3])
        if not self.measures_response:
            return (attenuation,)
        _, height, width = clip.shape
        options = {"normalise": "sequence"} if self.by_sequence else {}
        record = {"processed": {"width": width, "height": height}, "options": options}
        result = Result(clip.frame, clip.time_s, *rows, params=params, record=record)
        facts = {**result.summary, "sharpness": result.sharpness, "distinguishability": None}
        if self.false_positive_frame is not None:
            facts["distinguishability"] = result.distinguishability(self.false_positive_frame)
        facts["mean_attenuation_db"] = attenuation
        values = (facts[name] for name in RESPONSE_COLUMNS)
        return tuple(math.nan if value is None else float(value) for value in values)


def mean_attenuation(attenuation_db: Series) -> float:
    """How much of the change passes, in dB: the mean over the frames where something does.

    It is -inf where nothing ever passes, and NaN where no frame is valid.
    """
    passing = attenuation_db[np.isfinite(attenuation_db)]
    if passing.size:
        return math.fsum(passing) / passing.size
    return -math.inf if np.isneginf(attenuation_db).any() else math.nan


def compute(
    points: Mapping[int, Parameters],
    probe: Probe,
    jobs: int = 1,
    tell: Tell = lambda message: None,
) -> Iterator[tuple[int, Values]]:
    """Compute points of a grid; the values do not depend on `jobs`.

    Parameters
    ----------
    points : mapping of int to Parameters
        By number of the point.
    probe : Probe
        The frames, and what is measured.
    jobs : int
        Processes that share the points; with one it is this process.
    tell : callable, optional
        Called with a message before something that takes long.

    Yields
    ------
    (int, tuple of tuple of float)
        Number of a point, as it is done, and for each clip the values of the columns.

    Raises
    ------
    WorkerError
        If one of several processes dies.
    Interrupted
        If the user asks to stop.
    """
    waiting = list(points.items())
    if probe.engine == "numba" and jobs > 1:
        # Compiled in this process first: the others find the code on disk.
        yield from probe(waiting[:1], tell)
        del waiting[:1]
    n_cells = sum(math.prod(clip.shape) for clip in probe.clips)
    size = max(1, min(_CELLS_PER_TASK // n_cells, -(-len(waiting) // jobs)))
    batches = [waiting[start : start + size] for start in range(0, len(waiting), size)]
    if min(jobs, len(batches)) == 1:
        for one in waiting:
            yield from probe([one], tell)
        return
    for _, outcome in run_tasks(probe, batches, min(jobs, len(batches))):
        if isinstance(outcome.error, WorkerError):
            raise WorkerError("a point of the grid", outcome.error.why, outcome.error.mend)
        yield from outcome.result()


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


def engine_for(setup: Setup, size_wh: tuple[int, int], tell: Tell = lambda message: None) -> str:
    """The engine that `run` would use on frames of that size; raises what `create_model` does."""
    model = create_model(setup.params, engine=setup.engine)
    if setup.params.model != "dlgmd":
        return model.engine_name
    return choose_engine(setup.engine, size_wh[0] * size_wh[1], tell)


@dataclass
class Sweep:
    """A sweep and the folder that it is kept in.

    Attributes
    ----------
    folder : Path
        Where its files are.
    subject : Subject
        What the models look at.
    setup : Setup
        The model, and the parameters that are the same at all points.
    grid : Grid
        Those that are not.
    points : mapping of int to Parameters
        The parameters at all points that are possible.
    engine : str
        What computes the model, not `auto`.
    result : SweepResult
        What is done so far.
    """

    folder: Path
    subject: Subject
    setup: Setup
    grid: Grid
    points: Mapping[int, Parameters]
    engine: str
    result: SweepResult = field(init=False)
    _facts: dict[str, Any] = field(init=False, default_factory=dict)

    def __post_init__(self) -> None:
        speeds_px = self.subject.speeds_px
        names = ATTENUATION_COLUMNS if speeds_px else RESPONSE_COLUMNS
        self.result = SweepResult.empty(self.grid, speeds_px, names, self.points)

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
        settings = yaml.safe_load(self._text(self._settings()))
        differing = _differing(before, settings)
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
        missing = {point: self.points[point] for point in self.points if point not in done}
        if not missing:
            return
        clips: list[Clip] = []
        try:
            clips, self._facts = self.subject.clips(self.folder, self._reach_px(), progress)
            self._require_an_answer(clips)
            self._begin()
            probe = Probe(
                tuple(clips),
                self.engine,
                measures_response=not self.subject.speeds_px,
                by_sequence=self.subject.settings["options"].get("normalise") == "sequence",
                false_positive_frame=self.subject.false_positive_frame,
            )
            with (
                progress(f"sweep {self.subject.name}", len(self.points), "point") as on_point,
                (self.folder / TABLE).open("a", newline="", encoding="utf-8") as file,
            ):
                table = csv.writer(file, lineterminator="\n")
                for point, values in compute(missing, probe, jobs, tell):
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
            TABLE: lambda path: write_rows(path, self.result.header, rows),
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

    def _begin(self) -> None:
        """Make the folder that of this sweep, with the points that were taken in."""
        done = self.result.done
        for name in () if done else PRODUCTS:
            (self.folder / name).unlink(missing_ok=True)
        text = self._text(self._record(complete=False))
        store.write_text(self.folder / RECORD, text)
        rows = self.result.rows(sorted(done))
        store.write_file(
            self.folder / TABLE, lambda path: write_rows(path, self.result.header, rows)
        )

    def _require_an_answer(self, clips: Sequence[Clip]) -> None:
        """Raise if the shortest clip ends before the model can answer, at every point."""
        n_frames = min(len(clip.frame) for clip in clips)
        least = math.inf
        for params in self.points.values():
            least = min(least, create_model(params).first_valid_frame + 1)
            if least <= n_frames:
                return
        raise self.subject.too_short(clips[0], self.setup.label, int(least))

    def _reach_px(self) -> int | None:
        """How far from a change there may be any answer; None if that is not known."""
        radii = [one.r for one in self.points.values() if isinstance(one, DlgmdParameters)]
        return max(radii) if radii else None

    def _settings(self) -> dict[str, Any]:
        """The part of the record that says what is swept."""
        axes = {self.grid.x.key, self.grid.y.key}
        params = self.setup.params.to_dict()
        settings = dict(self.subject.settings)
        swept = {"x": self.grid.x.to_record(), "y": self.grid.y.to_record()}
        return {
            "input": settings.get("input", {}),
            "model": self.setup.params.model,
            "engine": self.engine,
            **{key: value for key, value in params.items() if key not in axes},
            "options": settings["options"],
            "sweep": {**swept, **settings["sweep"]},
        }

    def _record(self, *, complete: bool) -> dict[str, Any]:
        """What `sweep.yaml` says."""
        settings = {key: value for key, value in self._settings().items() if key != "input"}
        summary = {
            "points": len(self.grid),
            "computed": len(self.result.done),
            "impossible": len(self.grid) - len(self.points),
        }
        facts = {key: value for key, value in self._facts.items() if key != "warnings"}
        outcome = {"warnings": self.warnings, "complete": complete, "summary": summary}
        return {**facts, **settings, **outcome}

    def _text(self, record: dict[str, Any]) -> str:
        """A record with the versions, as YAML."""
        decoder = str(self.subject.settings.get("input", {}).get("decoder"))
        used = versions(decoder, self.engine)
        whole = {"schema": SCHEMA, **record, "versions": used}
        return yaml_text(whole, default_flow_style=None)


def _differing(before: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """The keys by which the settings `now` differ from those on record."""
    found = [key for key in now if key not in ("input", "sweep") and before.get(key) != now[key]]
    for part in ("input", "sweep"):
        known = before.get(part)
        known = known if isinstance(known, dict) else {}
        if any(known.get(key) != value for key, value in now[part].items()):
            keys = [key for key in now[part] if known.get(key) != now[part][key]]
            found += keys if part == "sweep" else [part]
    return found
