"""The grid of a sweep over two parameters, and the measures at its points."""

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from decimal import Decimal
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from dlgmd_cli.errors import ParameterError
from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.parameters.checks import Spec
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Table, cell, table_of, write_rows
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import SCHEMA, versions, yaml_text
from dlgmd_cli.results.result import INFINITE_DISTINGUISHABILITY, Result

MAX_VALUES, MAX_POINTS = 1000, 100_000
# TO belongs to a range if a whole number of steps reaches it within this share of a step.
_SLACK = Decimal("1e-6")
_HINT = "Write KEY=FROM:TO:STEP, such as sigma_e=0.2:2:0.1, or KEY=VALUE,VALUE."


@dataclass(frozen=True)
class Axis:
    """A parameter and its values: at least one, of the parameter's type, numbers in order.

    Values may be outside the parameter's range.
    """

    key: str
    spec: Spec
    values: tuple[Any, ...]

    @classmethod
    def parse(cls, text: str, kind: type[Parameters]) -> "Axis":
        """Parse an axis for parameters of class `kind`; raises ParameterError.

        `text` is ``KEY=FROM:TO:STEP``, with TO included if the steps reach it, or
        ``KEY=VALUE,VALUE``.
        """
        key, equals, rest = (part.strip() for part in text.partition("="))
        if not equals or not key or not rest:
            raise ParameterError("", f"{text[:60]!r} is not an axis", _HINT)
        if key not in kind.specs():
            raise kind.unknown(key)
        words = _range(rest) if ":" in rest else [word.strip() for word in rest.split(",")]
        if len(words) > MAX_VALUES:
            raise _too_many(len(words))
        spec = kind.specs()[key]
        values = [spec.parse(word, key, bounded=False) for word in words]
        if len(set(values)) < len(values):
            twice = next(value for value in values if values.count(value) > 1)
            raise ParameterError("", f"{key} = {twice} appears twice", "Give every value once.")
        return cls(key, spec, tuple(values if spec.kind in (bool, str) else sorted(values)))

    @property
    def is_numeric(self) -> bool:
        """Whether the values are numbers."""
        return not isinstance(self.values[0], bool | str)

    def __len__(self) -> int:
        return len(self.values)


@dataclass(frozen=True)
class Grid:
    """All combinations of the values of two parameters; points are numbered row by row along x.

    Raises ParameterError if both are the same parameter, or there are too many points.
    """

    x: Axis
    y: Axis

    def __post_init__(self) -> None:
        if self.x.key == self.y.key:
            why = f"--x and --y are both {self.x.key}"
            raise ParameterError("", why, "Choose another parameter for one.")
        if len(self) > MAX_POINTS:
            why = f"{len(self.x)} x {len(self.y)} points are more than {MAX_POINTS}"
            raise ParameterError("", why, "Take larger steps.")

    def __len__(self) -> int:
        return len(self.x) * len(self.y)

    @property
    def shape(self) -> tuple[int, int]:
        """Number of rows (y) and columns (x)."""
        return len(self.y), len(self.x)

    def values(self, point: int) -> tuple[Any, Any]:
        """The values of x and y at a point."""
        row, column = divmod(point, len(self.x))
        return self.x.values[column], self.y.values[row]

    def overrides(self, point: int) -> dict[str, Any]:
        """Key -> value at a point."""
        return dict(zip((self.x.key, self.y.key), self.values(point), strict=True))


ATTENUATION_COLUMNS = ("attenuation_db",)
RESPONSE_COLUMNS = (
    *("mp_max", "mp_max_frame", "sharpness", "distinguishability"),
    *("first_alarm_frame", "first_alarm_time_s", "mean_attenuation_db"),
)


@dataclass(eq=False, repr=False)
class SweepResult(Outcome):
    """Measures at every point of a grid, filled in as points are computed.

    `speeds_px` holds the speed of the cube in each clip, in px/frame; it is empty for a video.
    `columns` has the measures by name, (n_clips, n_y, n_x): NaN where undefined or not computed
    yet, perhaps infinite. `is_possible`, (n_y, n_x) bool, says where the values of x and y are a
    valid combination. `done` has the numbers of the computed points. `name` is that of the video or
    the clips, and `warnings` are doubts about it. `about` has what else the record says: of the
    `input`, the `model`, the `settings`, and the `decoder`. `label` is the model's name.
    """

    RECORD = "sweep.yaml"
    TABLES = ("sweep.csv",)
    FIGURES = {"sweep": "sweeps.plot_sweep"}  # noqa: RUF012

    grid: Grid
    speeds_px: tuple[float, ...]
    columns: dict[str, Series]
    is_possible: Flags
    done: set[int]
    name: str = ""
    warnings: list[str] = field(default_factory=list)
    about: dict[str, Any] = field(default_factory=dict)
    label: str = ""

    def __repr__(self) -> str:
        axes = " x ".join(f"{axis.key} ({len(axis)})" for axis in (self.grid.x, self.grid.y))
        return f"<SweepResult {self.name}: {axes}; {', '.join(self.columns)}>"

    @property
    def table(self) -> Table:
        """The rows of sweep.csv, one per clip and point; NaN where undefined."""
        at = ((clip, point) for clip in range(self.n_clips) for point in range(len(self.grid)))
        return table_of(self.header, ([*self._keys(*one), *self._values(*one)] for one in at))

    def tables(self) -> dict[str, store.Write]:
        """The function that writes sweep.csv, with all points in order."""
        return self._table(range(len(self.grid)))

    def so_far(self) -> dict[str, store.Write]:
        """The function that writes each file of an unfinished sweep."""
        text = self.record_text(complete=False)
        return {**self._table(sorted(self.done)), self.RECORD: store.file_of(text)}

    def _table(self, points: Sequence[int]) -> dict[str, store.Write]:
        return {self.TABLES[0]: partial(write_rows, header=self.header, rows=self.rows(points))}

    def record_text(self, *, complete: bool = True) -> str:
        """The text of sweep.yaml."""
        axes = {"x": self.grid.x, "y": self.grid.y}
        swept, model = [axis.key for axis in axes.values()], self.about.get("model", {})
        record: dict[str, Any] = {
            "schema": SCHEMA,
            **self.about.get("input", {}),
            **{key: value for key, value in model.items() if key not in swept},
            "sweep": {
                **{name: {"key": a.key, "values": list(a.values)} for name, a in axes.items()},
                **self.about.get("settings", {}),
            },
            "warnings": self.warnings,
            "complete": complete,
            "summary": {
                "points": len(self.grid),
                "computed": len(self.done),
                "impossible": int(np.count_nonzero(~self.is_possible)),
            },
            "versions": versions(str(self.about.get("decoder")), str(model.get("engine"))),
        }
        return yaml_text(record, default_flow_style=None)

    def shown(self) -> Iterator[Shown]:
        """The least and the greatest values, and where the files are."""
        yield (self.label, "least", "at", "greatest", "at"), self.extremes()
        if np.isinf(self.columns.get("distinguishability", np.zeros(1))).any():
            yield INFINITE_DISTINGUISHABILITY
        yield from self.paths

    def facts(self) -> dict[str, Any]:
        """What --json prints: None where undefined, infinity as text."""
        return {
            "result": str(self.paths[0]) if self.paths else None,
            "complete": True,
            "points": len(self.done),
            "warnings": self.warnings,
            "measures": self.measures(),
        }

    @classmethod
    def empty(
        cls,
        grid: Grid,
        speeds_px: tuple[float, ...],
        names: Iterable[str],
        possible: Iterable[int],
        name: str = "",
        label: str = "",
    ) -> "SweepResult":
        """A result without computed points; `possible` holds the numbers of the valid ones."""
        shape = (len(speeds_px) or 1, *grid.shape)
        is_possible = np.isin(np.arange(len(grid)), list(possible)).reshape(grid.shape)
        columns = {name: np.full(shape, np.nan) for name in names}
        return cls(grid, speeds_px, columns, is_possible, set(), name, label=label)

    @property
    def n_clips(self) -> int:
        """Number of clips per point."""
        return len(self.speeds_px) or 1

    @property
    def header(self) -> list[str]:
        """The columns of `sweep.csv`: x, y, the speed of the cube if there is one, measures."""
        speed = ["speed_px"] if self.speeds_px else []
        return [self.grid.x.key, self.grid.y.key, *speed, *self.columns]

    def put(self, point: int, values: Sequence[Sequence[float]]) -> None:
        """Store a point; `values` holds, for each clip, the values of the columns."""
        for column, numbers in zip(self.columns.values(), zip(*values, strict=True), strict=True):
            column.reshape(self.n_clips, -1)[:, point] = numbers
        self.done.add(point)

    def rows(self, points: Sequence[int]) -> Iterator[list[str]]:
        """The rows of `sweep.csv`, one per grid point and speed, clip by clip."""
        for clip in range(self.n_clips):
            for point in points:
                yield [*self._key(clip, point), *map(cell, self._values(clip, point))]

    def read(self, path: Path) -> None:
        """Load the points whose rows are complete in a CSV; anything else in it is ignored."""
        try:
            with open_regular(path, encoding="utf-8", errors="replace") as file:
                text = file.read()
        except OSError:
            return
        # A killed process may have left an incomplete line.
        rows = [line.split(",") for line in text[: text.rfind("\n") + 1].splitlines()]
        if rows[:1] != [self.header]:
            return
        n_keys = len(self.header) - len(self.columns)
        by_key = {tuple(row[:n_keys]): row[n_keys:] for row in rows if len(row) == len(rows[0])}
        for point in np.flatnonzero(self.is_possible).tolist():
            with suppress(KeyError, ValueError):  # a row is missing or not numeric
                clips = [by_key[self._key(clip, point)] for clip in range(self.n_clips)]
                self.put(point, [[float(text or "nan") for text in cells] for cells in clips])

    def extremes(self) -> list[tuple[str, ...]]:
        """The least and the greatest value of each measure with their points, as table rows."""
        rows = []
        for measure in self.measures():
            speed = f", {measure['speed_px']:g} px/frame" if "speed_px" in measure else ""
            row = [f"{measure['measure']}{speed}"]
            for word in ("least", "greatest"):
                at = measure[f"{word}_at"]
                value = "–" if at is None else f"{float(measure[word]):.6g}"
                row += [value, ", ".join(f"{k} {_parameter(v)}" for k, v in (at or {}).items())]
            rows.append(tuple(row))
        return rows

    def measures(self) -> list[dict[str, Any]]:
        """The same as data for JSON: None where undefined, infinity as text."""
        rows = []
        for name, clips in self.columns.items():
            for clip, values in enumerate(clips):
                row: dict[str, Any] = {"measure": name}
                if self.speeds_px:
                    row["speed_px"] = self.speeds_px[clip]
                for word, find in (("least", np.nanargmin), ("greatest", np.nanargmax)):
                    at = None if np.isnan(values).all() else int(find(values))
                    value = None if at is None else float(values.flat[at])
                    row[word] = value if value is None or math.isfinite(value) else str(value)
                    row[f"{word}_at"] = None if at is None else self.grid.overrides(at)
                rows.append(row)
        return rows

    def _key(self, clip: int, point: int) -> tuple[str, ...]:
        """The cells that identify the point and clip of a row."""
        return tuple(map(_parameter, self._keys(clip, point)))

    def _values(self, clip: int, point: int) -> list[Any]:
        """The measures at a point."""
        return [column[clip].flat[point] for column in self.columns.values()]

    def _keys(self, clip: int, point: int) -> tuple[Any, ...]:
        """The values of x and y, and the speed of the cube if there is one."""
        return (*self.grid.values(point), *self.speeds_px[clip : clip + 1])


def measured(
    result: Result, columns: Sequence[str], false_positive_frame: int | None
) -> tuple[float, ...]:
    """The values of the columns at one point, from the result there; NaN where undefined."""
    attenuation = _mean_attenuation(result.attenuation_db)
    if tuple(columns) == ATTENUATION_COLUMNS:
        return (attenuation,)
    facts = {**result.summary, "sharpness": result.sharpness, "distinguishability": None}
    if false_positive_frame is not None:
        facts["distinguishability"] = result.distinguishability(false_positive_frame)
    facts["mean_attenuation_db"] = attenuation
    values = (facts[name] for name in columns)
    return tuple(math.nan if value is None else float(value) for value in values)


def _mean_attenuation(attenuation_db: Series) -> float:
    """Mean over frames with S above zero; -inf if there are none, NaN if no frame is valid."""
    passing = attenuation_db[np.isfinite(attenuation_db)]
    if passing.size:
        return math.fsum(passing) / passing.size
    return -math.inf if np.isneginf(attenuation_db).any() else math.nan


def _parameter(value: Any) -> str:
    """A parameter's value as `--param` takes it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value
    short = cell(value)
    return short if float(short) == value else repr(value)


def _range(text: str) -> list[str]:
    """The values from FROM to TO; Decimal avoids values such as 0.30000000000000004."""
    try:
        start, end, step = map(Decimal, text.split(":"))
        if not all(number.is_finite() for number in (start, end, step)):
            raise ValueError
        if step <= 0 or end < start:
            why = "its STEP is not above 0" if step <= 0 else "its TO is below its FROM"
            raise ParameterError("", f"{text[:60]!r} has no values: {why}", _HINT)
        n_steps = int(min((end - start) / step + _SLACK, Decimal(10**9)))
        if n_steps >= MAX_VALUES:
            raise _too_many(n_steps + 1)
        return [str(min(start + i * step, end)) for i in range(n_steps + 1)]
    except (ValueError, ArithmeticError):
        raise ParameterError("", f"{text[:60]!r} is not FROM:TO:STEP in numbers", _HINT) from None


def _too_many(count: int) -> ParameterError:
    why = f"{count} values are more than {MAX_VALUES}"
    return ParameterError("", why, "Take larger steps, or a shorter range.")
