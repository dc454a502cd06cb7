"""The times of frames where the user knows better than the video: a rate, or a table."""

import csv
import math
import os
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, argument, counted
from dlgmd_cli.machine.files import open_regular
from dlgmd_cli.video.timestamps import frame_rates

# Names of columns with times: time_s, t, seconds, "Time Stamp (ms)"; those in milliseconds.
_TIMES = re.compile(r"(?i)time|sec|milli|(^|[^a-z])(t|s|ms)([^a-z]|$)")
_MILLISECONDS = re.compile(r"(?i)milli|msec|(^|[^a-z])ms([^a-z]|$)")


@dataclass(frozen=True)
class GivenTimes:
    """The true times of a video's frames.

    `fps` is their nominal rate. `table` has the time of each frame in seconds, from the file
    `origin`; without it, the video's own times are multiplied by `factor`.
    """

    fps: float
    factor: float = 1.0
    table: npt.NDArray[np.float64] | None = None
    origin: str = ""

    def time(self, index: int, file_s: float) -> float:
        """Time of frame `index` in seconds; `file_s` is the video's own. Raises ParameterError."""
        if self.table is None:
            return file_s * self.factor
        if index >= len(self.table):
            why = f"has {counted(len(self.table), 'time')}, fewer than the video has frames"
            raise ParameterError(self.origin, why, "Give one row a frame.")
        return float(self.table[index])

    def report(self, n_frames: int) -> str:
        """After reading a whole video: a warning about times without a frame, or empty."""
        return "" if self.table is None else surplus(self.origin, "time", len(self.table), n_frames)


def surplus(origin: str, noun: str, n_rows: int, n_frames: int) -> str:
    """A warning if a table of a video's frames has more rows than the video has frames, or empty.

    `noun` names a row of the table, which is the file `origin`.
    """
    if n_rows <= n_frames:
        return ""
    what = f"{origin} has {counted(n_rows - n_frames, noun)} more than the video has frames"
    return f"{what}; check that they belong together"


def given_times(
    times: str | os.PathLike[str] | None, input_fps: float | None, stated_fps: float | None
) -> GivenTimes | None:
    """The times by a table, or by a rate that a video does not state; None for the video's own.

    Raises ParameterError for both, or if the table cannot be used, see `read_times`.
    """
    if times is not None:
        if input_fps is not None:
            why = f"{argument('times')} and {argument('input_fps')} exclude each other"
            raise ParameterError("", why, "Give one of them.")
        table = read_times(times)
        rates = frame_rates([*map(float, table)])
        if rates is None:
            raise ParameterError(str(times), "has fewer than two times", "Give one row a frame.")
        return GivenTimes(rates.mean_fps, table=table, origin=str(times))
    if input_fps and stated_fps and input_fps != stated_fps:
        return GivenTimes(input_fps, stated_fps / input_fps)
    return None


def read_times(path: str | os.PathLike[str]) -> npt.NDArray[np.float64]:
    """The times in seconds in a CSV with one row a frame, (n,).

    Columns are separated by commas, or by semicolons or tabs, and then 0.5 may be ``0,5``. The
    times are in the first column whose name speaks of time (``time_s``), or in the only one.
    They are milliseconds if the name says so (``ms``, ``Time Stamp (ms)``).

    Raises
    ------
    ParameterError
        If the file has no such column, a time is missing, or times do not increase.
    """
    try:
        with open_regular(Path(path), newline="", encoding="utf-8-sig") as file:
            lines = file.read().rstrip().splitlines() or [""]
        separator = max(",;\t", key=lines[0].count)
        names, *rows = csv.reader(lines, delimiter=separator)
    except OSError as error:
        raise ParameterError(str(path), error.strerror or str(error)) from None
    except (UnicodeError, csv.Error):
        separator, names, rows = ",", [], []
    columns = [at for at, name in enumerate(names) if _TIMES.search(name.strip())]
    if not columns and len(names) == 1 and math.isnan(_seconds(names[0], separator)):
        columns = [0]
    if not columns:
        hint = "Its first line names the columns; write time_s above seconds, time_ms above ms."
        raise ParameterError(str(path), "is not a table with a column of times", hint)
    at = columns[0]
    scale = 1e-3 if _MILLISECONDS.search(names[at]) else 1.0
    table = np.array([_seconds(row[at] if at < len(row) else "", separator) for row in rows])
    table *= scale
    for number in np.flatnonzero(~np.isfinite(table)):
        raise ParameterError(str(path), f"frame {number} has no time", "Give one row a frame.")
    for number in np.flatnonzero(np.diff(table) <= 0.0) + 1:
        why = f"the time of frame {number}, {table[number]:g} s, is not after the one before"
        raise ParameterError(str(path), why, "Times must increase.")
    return table


def _seconds(cell: str, separator: str) -> float:
    try:
        return float(cell if separator == "," else cell.replace(",", "."))
    except ValueError:
        return math.nan
