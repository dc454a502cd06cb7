"""The times of frames where the user knows better than the video: a rate, or a table."""

import logging
import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from dlgmd_cli.errors import ParameterError, argument, counted
from dlgmd_cli.machine.tables import TextTable, listed, plain, read_table
from dlgmd_cli.parameters.facts import InputFacts
from dlgmd_cli.video.base import MAX_FPS
from dlgmd_cli.video.timestamps import LEAST_STEP_S, frame_rates, is_unix, start_of

_log = logging.getLogger(__name__)

# Names of columns with times; with times of something else; and with what is per time.
_TIMES = re.compile(r"time|stamp|zeit|(?:^|_)(?:t|ts|pts|utc|clock|elapsed)(?:_|$)")
_NO_TIMES = re.compile(r"contact|exposure|shutter|duration|delta|interval|latency|(?:^|_)dt(?:_|$)")
_RATE = re.compile(r"(?:^|_)(?:[ck]?m|deg|rad|px|per|1)_")
# Unit -> seconds, and the words in a column's name that mean it.
_UNITS = {
    "ns": (1e-9, r"n(?:s|secs?|anos?|ano_?sec(?:ond)?s?)|sensor_timestamp$"),
    "us": (1e-6, r"[uµμ](?:s|secs?)|micros?|micro_?sec(?:ond)?s?"),
    "ms": (1e-3, r"m(?:s|secs?)|millis?|milli_?sec(?:ond)?s?"),
    "s": (1.0, r"s|secs?|seconds?"),
    "min": (60.0, r"mins?|minutes?"),
    "h": (3600.0, r"h|hrs?|hours?"),
}
_GUESSED = ("s", "ms", "us", "ns")
_FORMAT = re.compile(r"(?:timecode|timestamp) format (v\d+)")
_MEND = "Its first line names the columns; write time_s above seconds, time_ms above ms."


def misfit(
    table: TextTable,
    n_frames: float,
    frames: npt.NDArray[np.int64],
    times_s: npt.NDArray[np.float64],
    spare: int = 0,
) -> str:
    """A warning if a table, such as a truth, is not that of the video beside it, or empty.

    The table has the columns `frame` and, perhaps, `time_s`; it may have `spare` rows after the
    video's last frame. The times of the video's `frames` are `times_s`, (m,); both count from the
    first common frame.
    """
    rows, told_s = table.numbers("frame"), table.numbers("time_s", clocks=True)
    n_more = int((rows >= n_frames).sum())
    if n_more > spare:
        return _surplus(str(table.path), "row", n_more)
    is_timed = np.isfinite(told_s)
    common, at, own_at = np.intersect1d(rows[is_timed], frames, return_indices=True)
    if len(common) < 2:
        return ""
    told_s, own_s = told_s[is_timed][at], times_s[own_at]
    told_s, own_s = told_s - told_s[0], own_s - own_s[0]
    worst = int(np.argmax(np.abs(told_s - own_s)))
    if abs(told_s[worst] - own_s[worst]) <= 2.0 * np.median(np.diff(times_s)):
        return ""
    what = f"{table.path} has frame {common[worst]:.0f} at {told_s[worst]:.3f} s"
    return f"{what}, the video at {own_s[worst]:.3f} s; check that they belong together"


@dataclass(frozen=True)
class GivenTimes:
    """The true times of a video's frames.

    `fps` is their nominal rate. `table` has the time of each frame in seconds from the first, from
    the file `origin`, and may have `spare` rows more than the video has frames; `start` is what a
    record says of the first time, see `start_of`. Without a table, the video's own times are
    multiplied by `factor`.
    """

    fps: float
    factor: float = 1.0
    table: npt.NDArray[np.float64] | None = None
    origin: str = ""
    start: InputFacts = field(default_factory=InputFacts)
    spare: int = 0

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
        n_more = 0 if self.table is None else len(self.table) - n_frames
        return _surplus(self.origin, "time", n_more) if n_more > self.spare else ""


def _surplus(origin: str, noun: str, n_more: int) -> str:
    """A warning that a table has more rows, each a `noun`, than its video has frames."""
    what = f"{origin} has {counted(n_more, noun)} more than the video has frames"
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
        return read_times(times)
    if input_fps and stated_fps and input_fps != stated_fps:
        return GivenTimes(input_fps, stated_fps / input_fps)
    return None


def read_times(path: str | os.PathLike[str]) -> GivenTimes:
    """The times in a table with one row a frame.

    They are in the first column whose name speaks of time (``time_s``), or in the only one, as
    numbers, as ``hh:mm:ss.fff``, or with a date. The name, or a row of units below it, may say the
    unit (``time_ms``, ``t [ns]``); a file that begins with ``# timecode format v2`` is in ms.
    Without a unit, times are in seconds, or count from 1970 in the unit that means this century.

    Raises
    ------
    ParameterError
        If the file has no such column, a time is missing, times do not increase, or their step
        means no rate of a camera.
    """
    table = read_table(Path(path), ParameterError)
    name, unit = _column(table)
    cells, times = table.texts(name), table.numbers(name, clocks=True)
    for row in np.flatnonzero(~np.isfinite(times)):
        raise table.at(int(row), name, f"frame {row} has no time", "Give one row a frame.")
    if len(times) < 2:
        raise ParameterError(str(path), "has fewer than two times", "Give one row a frame.")
    steps = np.diff(times)
    unit = "s" if any(":" in cell for cell in cells) else unit
    scale = _scale(table, name, unit, float(times[0]), float(np.median(steps)))
    for row in 1 + np.flatnonzero(steps * scale < LEAST_STEP_S):
        why = f"frame {row} is at {cells[row]}, not after the one before, {cells[row - 1]}"
        raise table.at(int(row), name, why, "Times must increase.")
    found = np.round((times - times[0]) * scale, 6)  # seconds since 1970 are exact to 0.2 µs
    rates = frame_rates(found.tolist())
    assert rates is not None  # there are two times or more
    start, spare = start_of(float(times[0]) * scale), int(bool(_FORMAT.search(table.remark)))
    return GivenTimes(rates.mean_fps, 1.0, found, str(path), start, spare)


def _column(table: TextTable) -> tuple[str, str]:
    """The name of the column of times, and its unit, empty if unknown; raises ParameterError."""
    if form := _FORMAT.search(table.remark):
        if form[1] != "v2":
            why = f"is in the timecode format {form[1]}, of which only v2 is read"
            hint = "Write a time in ms for each frame, as 'mkvextract FILE timestamps_v2' does."
            raise ParameterError(str(table.path), why, hint)
        return next(iter(table.names), ""), "ms"
    units = dict(zip(table.names, table.units, strict=False))
    known = {name: unit_of(name) or unit_of(units.get(name, "")) for name in table.names}
    named = [name for name in known if _TIMES.search(plain(name))]
    named = named or [name for name in known if known[name] and not _RATE.search(plain(name))]
    chosen = [name for name in named if not _NO_TIMES.search(plain(name))]
    if not chosen and len(table.names) == 1 and not _counts(table):
        chosen = table.names
    if not chosen:
        columns = f": it has the columns {listed(table.names)} ({table.form})"
        why = "is not a table with a column of times" + (columns if any(table.names) else "")
        raise ParameterError(str(table.path), why, _MEND)
    if len(chosen) > 1:
        others = listed(chosen[1:])
        _log.info("Note: %s: the times are those of %s, not of %s.", table.path, chosen[0], others)
    return chosen[0], known[chosen[0]]


def _counts(table: TextTable) -> bool:
    """Whether the only column numbers the rows, from 0 or 1."""
    cells, numbers = table.texts(table.names[0]), [*map(str, range(len(table.rows) + 1))]
    return cells in (numbers[:-1], numbers[1:])


def unit_of(text: str) -> str:
    """The unit of time that a name says, such as ``ms`` for ``time_ms``; empty for none."""
    words = plain(text)
    for unit, (_, names) in _UNITS.items():
        if re.search(f"(?:^|_)(?:{names})(?:_|$)", words):
            return unit
    return ""


def _scale(table: TextTable, name: str, unit: str, first: float, step: float) -> float:
    """The seconds of the given unit, or of the one that fits; raises if the step is no rate's."""
    if step <= 0.0:
        return 1.0  # the caller finds the row
    rates = {one: 1.0 / (step * scale) for one, (scale, _) in _UNITS.items()}
    fitting = [one for one in _GUESSED if 1.0 <= rates[one] <= MAX_FPS]
    dated = [one for one in fitting if is_unix(first * _UNITS[one][0])]
    taken = unit or next(iter(dated), "s")
    if taken in fitting or (unit and rates[unit] <= MAX_FPS):
        return _UNITS[taken][0]
    why = f"a step of {step:.9g} {taken} means {rates[taken]:.3g} frames/s"
    hint = " or ".join(f"time_{one} ({rates[one]:.3g} frames/s)" for one in fitting)
    slow = f"; time_{taken}, if it is so slow" if rates[taken] < 1.0 else ""
    hint = f"Write the unit into the first line: {hint}{slow}." if hint else "Check the column."
    raise ParameterError(str(table.path), f"{name or 'its only column'}: {why}", hint)
