"""The outcome of a sweep: measures at every point of a grid, for one or several inputs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from dlgmd_cli.frame import Flags, Series
from dlgmd_cli.parameters.facts import (
    SCHEMA,
    InputEntries,
    Json,
    Record,
    Value,
)
from dlgmd_cli.parameters.presets import Parameters
from dlgmd_cli.results import store
from dlgmd_cli.results.csv import Table, cell, table_of, write_rows
from dlgmd_cli.results.grid import Grid, as_text
from dlgmd_cli.results.outcome import Outcome, Shown
from dlgmd_cli.results.record import versions, yaml_text
from dlgmd_cli.results.result import INFINITE_DISTINGUISHABILITY


@dataclass(eq=False, repr=False)
class SweepResult(Outcome):
    """Measures at every point of a grid.

    Attributes
    ----------
    grid : Grid
        The values of x and y.
    name, label : str
        The name of the video or the clips; the label of the model.
    points : dict of int to Parameters
        The parameters at each point where the values of x and y are a valid combination.
    columns : dict of str to ndarray, shape (n_clips, n_y, n_x)
        The measures: NaN where undefined, perhaps infinite.
    settings : dict
        The record's entries about the model, the options and the sweep.
    speeds_px : tuple of float
        The speed of the cube in each clip, in px/frame; empty for a video.
    source : dict
        The record's entries about the video.
    warnings : list of str
        Warnings about the input.
    """

    RECORD = "sweep.yaml"
    TABLES = ("sweep.csv",)
    FIGURES = {"sweep": "sweeps.plot_sweep"}  # noqa: RUF012

    grid: Grid
    name: str
    label: str
    points: dict[int, Parameters]
    columns: dict[str, Series]
    settings: Record
    speeds_px: tuple[float, ...] = ()
    source: InputEntries = field(default_factory=InputEntries)
    warnings: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        axes = " x ".join(f"{axis.key} ({len(axis)})" for axis in (self.grid.x, self.grid.y))
        return f"<SweepResult {self.name}: {axes}; {', '.join(self.columns)}>"

    @property
    def is_possible(self) -> Flags:
        """Whether the values of x and y are a valid combination, shape (n_y, n_x)."""
        return np.isin(np.arange(len(self.grid)), list(self.points)).reshape(self.grid.shape)

    @property
    def header(self) -> list[str]:
        """The columns of sweep.csv: x, y, the speed of the cube if there is one, measures."""
        speed = ["speed_px"] if self.speeds_px else []
        return [self.grid.x.key, self.grid.y.key, *speed, *self.columns]

    @property
    def table(self) -> Table:
        """The rows of sweep.csv, one per clip and point; NaN where undefined."""
        return table_of(self.header, ([*keys, *values] for keys, values in self._rows()))

    def _rows(self) -> Iterator[tuple[list[Value], list[float]]]:
        """The values of x, y and the speed, and the measures, of each clip and point."""
        for clip in range(len(self.speeds_px) or 1):
            for point in range(len(self.grid)):
                keys = [*self.grid.values(point), *self.speeds_px[clip : clip + 1]]
                yield keys, [column[clip].flat[point] for column in self.columns.values()]

    def tables(self) -> dict[str, store.Write]:
        """The function that writes sweep.csv: a row per grid point and speed, clip by clip."""
        rows = ([*map(as_text, keys), *map(cell, values)] for keys, values in self._rows())
        return {self.TABLES[0]: partial(write_rows, header=self.header, rows=rows)}

    def record_text(self) -> str:
        """The text of sweep.yaml."""
        decoder = self.source.get("input", {}).get("decoder")
        record: dict[str, object] = {
            "schema": SCHEMA,
            **self.source,
            **self.settings,
            "warnings": self.warnings,
            "complete": True,
            "summary": {
                "points": len(self.grid),
                "computed": len(self.points),
                "impossible": len(self.grid) - len(self.points),
            },
            "versions": versions(str(decoder)),
        }
        return yaml_text(record, flow=None)

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The grid, the measures at its points, and a title."""
        of_cubes = "Attenuation of a moving cube, 10 lg(ΣS/ΣP)"
        title = f"{of_cubes if self.speeds_px else self.name} · {self.label}"
        return self.grid, self.columns, self.is_possible, self.speeds_px, title

    def shown(self) -> Iterator[Shown]:
        """The least and the greatest values, and the paths of the files.

        A measure that is the same everywhere, at all speeds, has one row.
        """
        rows: list[tuple[str, ...]] = []
        extremes: dict[str, set[Any]] = {}
        for measure in self.measures():
            ends = measure["least"], measure["greatest"]
            extremes.setdefault(measure["measure"], set()).update(ends)
        for measure in self.measures():
            speed = f", {measure['speed_px']:g} px/frame" if "speed_px" in measure else ""
            if len(extremes[measure["measure"]]) == 1:
                if (least := measure["least"]) is not None:
                    same = (measure["measure"], f"{float(least):.6g}", "everywhere", "", "")
                    rows += [same] if same not in rows else []
                continue
            row = [f"{measure['measure']}{speed}"]
            for word in ("least", "greatest"):
                at = measure[f"{word}_at"]
                value = "–" if at is None else f"{float(measure[word]):.6g}"
                row += [value, ", ".join(f"{k} {as_text(v)}" for k, v in (at or {}).items())]
            rows.append(tuple(row))
        yield (self.label, "least", "at", "greatest", "at"), rows
        if np.isinf(self.columns.get("distinguishability", np.zeros(1))).any():
            yield INFINITE_DISTINGUISHABILITY
        yield from self.paths

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output: None where undefined, infinity as text."""
        return {
            "result": str(self.paths[0]) if self.paths else None,
            "complete": True,
            "points": len(self.points),
            "warnings": self.warnings,
            "measures": self.measures(),
        }

    def measures(self) -> list[dict[str, Any]]:
        """The least and the greatest value of each measure with their points, for JSON."""
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

    def put(self, point: int, values: Sequence[Sequence[float]]) -> None:
        """Store a point; `values` holds, for each clip, the values of the columns."""
        for column, numbers in zip(self.columns.values(), zip(*values, strict=True), strict=True):
            column.reshape(len(column), -1)[:, point] = numbers


@dataclass(eq=False)
class Sweeps(Outcome):
    """Sweeps of several inputs over the same grid; `results` has one sweep per input."""

    FIGURES = {"sweeps": "sweeps.plot_sweeps"}  # noqa: RUF012

    results: list[SweepResult]

    def drawn(self, kind: str) -> tuple[Any, ...]:
        """The grid, the measures and the possible points of each input, and a title."""
        first = self.results[0]
        maps = [(result.name, result.columns, result.is_possible) for result in self.results]
        return first.grid, maps, first.label

    def shown(self) -> Iterator[Shown]:
        """The tables of each sweep, and the path of the figure."""
        for result in self.results:
            yield from result.shown()
        yield from self.paths

    def facts(self) -> dict[str, Json]:
        """The contents of the JSON output: the figures, and the facts of each sweep."""
        return {**super().facts(), "sweeps": [result.facts() for result in self.results]}
