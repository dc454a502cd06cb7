"""What a sweep comes to: a table in long form, and its record."""

import csv
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from dlgmd_cli.results.cells import cell
from dlgmd_cli.results.folder import PLOT_FORMATS
from dlgmd_cli.results.record import versions, yaml_text
from dlgmd_cli.results.tables import Flags, Series
from dlgmd_cli.runs.axis import Grid

JOURNAL, TABLE, RECORD, FIGURE = "sweep.jsonl", "sweep.csv", "sweep.yaml", "sweep"
PRODUCTS = frozenset({TABLE, RECORD, *(f"{FIGURE}.{suffix}" for suffix in PLOT_FORMATS)})


@dataclass(frozen=True)
class SweepResult:
    """Measures at every point of a grid.

    Attributes
    ----------
    grid : Grid
        The parameters.
    speeds_px : tuple of float
        Of each clip, the speed of its cube in px/frame; empty for a video.
    columns : dict of str to ndarray, shape (n_clips, n_y, n_x)
        What was measured; NaN where undefined, infinite where it is.
    is_possible : bool array, shape (n_y, n_x)
        Where the parameters can be had.
    is_done : bool array, shape (n_y, n_x)
        Where it was computed, or cannot be.
    """

    grid: Grid
    speeds_px: tuple[float, ...]
    columns: dict[str, Series]
    is_possible: Flags
    is_done: Flags

    @classmethod
    def gather(
        cls,
        grid: Grid,
        speeds_px: tuple[float, ...],
        names: tuple[str, ...],
        points: Mapping[int, Any],
        possible: Mapping[int, Any],
    ) -> "SweepResult":
        """From the values of every point that is there, (n_clips, n_columns) each.

        `possible` has the numbers of all points that can be computed.
        """
        n_clips = len(speeds_px) or 1
        table: npt.NDArray[np.float64] = np.full((len(names), n_clips, len(grid)), np.nan)
        for point, values in points.items():
            table[:, :, point] = np.array(values, dtype=np.float64).T
        numbers = range(len(grid))
        is_possible = np.array([number in possible for number in numbers])
        is_there = np.array([number in points for number in numbers])
        columns = table.reshape(len(names), n_clips, *grid.shape)
        return cls(
            grid,
            speeds_px,
            dict(zip(names, columns, strict=True)),
            is_possible.reshape(grid.shape),
            (is_there | ~is_possible).reshape(grid.shape),
        )

    def has_infinite(self, column: str) -> bool:
        """Whether a column, if there is one of that name, is infinite anywhere."""
        return column in self.columns and bool(np.isinf(self.columns[column]).any())


def extremes(result: SweepResult) -> list[tuple[str, ...]]:
    """The least and the greatest value of every measure, and where: rows of a table."""
    rows = []
    for name, clips in result.columns.items():
        for clip, values in enumerate(clips):
            title = f"{name}, {result.speeds_px[clip]:g} px/frame" if result.speeds_px else name
            row = [title]
            for of in (np.nanargmin, np.nanargmax):
                point = None if np.isnan(values).all() else int(of(values))
                row += ["–", ""] if point is None else [f"{values.flat[point]:.6g}"]
                if point is not None:
                    place = zip(
                        (result.grid.x, result.grid.y), result.grid.values(point), strict=True
                    )
                    row.append(", ".join(f"{axis.key} {_parameter(v)}" for axis, v in place))
            rows.append(tuple(row))
    return rows


def write_table(path: Path, result: SweepResult) -> None:
    """Write the points that are done as CSV, x, y, then what distinguishes clips, then measures.

    OSError passes through.
    """
    grid = result.grid
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        speed = ["speed_px"] if result.speeds_px else []
        writer.writerow([grid.x.key, grid.y.key, *speed, *result.columns])
        for clip in range(len(result.speeds_px) or 1):
            which = [cell(result.speeds_px[clip])] if result.speeds_px else []
            for point in np.flatnonzero(result.is_done):
                values = [column[clip].flat[point] for column in result.columns.values()]
                place = map(_parameter, grid.values(int(point)))
                writer.writerow([*place, *which, *map(cell, values)])


def _parameter(value: Any) -> str:
    """A parameter's value as `--param` takes it."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else cell(value)


def write_sweep_record(path: Path, record: dict[str, Any], *used: str) -> None:
    """Write `record` and the versions as YAML, given the decoder and the engine used.

    OSError passes through.
    """
    text = yaml_text({**record, "versions": versions(*used)}, default_flow_style=None)
    path.write_text("# Written by dlgmd.\n" + text, encoding="utf-8")
