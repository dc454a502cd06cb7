"""`Batch`: the outcome of models over many videos, and summary.csv, one row per video."""

import re
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dlgmd_cli.errors import DlgmdError, ResultError, counted, printable
from dlgmd_cli.machine.pool import DONE
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.names import frames_text
from dlgmd_cli.results.outcome import Outcome, Shown

if TYPE_CHECKING:
    from upath import UPath

OF_INPUT = ("frames", "width", "height", "fps", "duration_s")
OF_SUMMARY = (
    "mp_max",
    "mp_max_frame",
    "spikes",
    "alarms",
    "first_alarm_frame",
    "first_alarm_time_s",
    "mean_attenuation_db",
)
SIDE = "first_alarm_side"
COLUMNS = ("video", "status", "error", "warnings", *OF_INPUT, *OF_SUMMARY, SIDE, "wall_s")
# Share of the time for rewriting summary.csv: after every short video it would take too long.
_SHARE_OF_TIME = 0.05
# Longer tables show only the videos that failed.
_MAX_ROWS = 60


@dataclass(frozen=True)
class Row:
    """The outcome of one video with one model.

    `status` is that of a `pool.Outcome`, and `error` says on one line why the video is not done.
    If it is done, `record` has the contents of run.yaml. `wall_s` is the wall time in seconds,
    decoding included; None if unknown. `lacks_figures` says that a figure could not be drawn,
    which is a warning in the record.
    """

    status: str
    error: str = ""
    record: dict[str, Any] = field(default_factory=dict)
    wall_s: float | None = None
    lacks_figures: bool = False


class Summary:
    """A summary.csv: its rows by the video's name, and the file, which is rewritten each time."""

    def __init__(self, place: "Path | UPath") -> None:
        self.path = place / store.SUMMARY
        self.rows: dict[str, Row] = {}
        self._next_write_s = 0.0

    def n_dropped(self, videos: Iterable[str]) -> int:
        """How many videos the file lists that are not among these."""
        rows: list[list[str]] = []
        if not store.is_url(str(self.path)) and self.path.is_file():
            with suppress(ResultError):
                rows = csv.read_rows(Path(self.path))
        listed = {row[0] for row in rows[1:] if row}
        return len(listed - {csv.text_cell(_distinct(video)) for video in videos})

    def write(self, *, at_once: bool = True) -> None:
        """Write the file; raises OutputError.

        Without `at_once`, writing may be postponed to keep its share of the time small.
        """
        began = time.monotonic()
        if not at_once and began < self._next_write_s:
            return
        rows = [row_values(name, self.rows[name]) for name in sorted(self.rows)]
        write = partial(csv.write_values, header=COLUMNS, rows=rows)
        store.ClaimedFolder(self.path.parent).commit({store.SUMMARY: write})
        ended = time.monotonic()
        self._next_write_s = ended + (ended - began) / _SHARE_OF_TIME


def _distinct(video: str) -> str:
    r"""A video's name, with ``\\n`` for what would look like an escaped control character."""
    return re.sub(r"\\(?=[nrtxuU])", r"\\\\", video)


def row_values(video: str, row: Row) -> list[Any]:
    """The row of a video in summary.csv; None and an empty text are undefined."""
    values: list[Any] = [
        _distinct(video),
        row.status,
        row.error,
        "; ".join(row.record.get("warnings", [])),
    ]
    for part, keys in (("input", OF_INPUT), ("summary", OF_SUMMARY)):
        numbers = (row.record.get(part, {}).get(key) for key in keys)
        values += [number if isinstance(number, int | float) else None for number in numbers]
    side = row.record.get("summary", {}).get(SIDE) or ""
    return [*values, side, None if row.wall_s is None else round(row.wall_s, 3)]


@dataclass(eq=False, repr=False)
class Batch(Outcome):
    """The outcome of a batch.

    Attributes
    ----------
    labels : list of str
        The models' names.
    out : str
        The folder of the results.
    summaries : list of Summary
        One per model, with the row of each video.
    to_do : dict of str to dict of str to str
        For each video, by its name, the folders to write by the models' labels; empty for a video
        that was done before.
    faults : list of str
        The folders that could not be read.
    complete : bool
        Whether it ran to its end.
    is_dry : bool
        Whether it only found what there is to do.
    """

    TABLES = (store.SUMMARY,)

    labels: list[str]
    out: str
    summaries: list[Summary]
    to_do: dict[str, dict[str, str]]
    faults: list[str]
    complete: bool = True
    is_dry: bool = False

    def __repr__(self) -> str:
        counts = Counter(status or "not processed" for status in self.statuses.values())
        said = ", ".join(f"{n} {status}" for status, n in counts.items())
        n_videos = counted(len(self.statuses), "video")
        return f"<Batch of {n_videos} with {', '.join(self.labels)}: {said}>"

    def cells(self) -> dict[str, Any]:
        """The rows of every summary.csv, after a column `model`."""
        rows = [
            [label, *row_values(video, row)]
            for label, summary in zip(self.labels, self.summaries, strict=True)
            for video, row in sorted(summary.rows.items())
        ]
        return {store.SUMMARY: (("model", *COLUMNS), rows)}

    @property
    def statuses(self) -> dict[str, str]:
        """The status of each video: the first that is not `done`; empty if it was not processed."""
        return {video: self._status(video) for video in self.to_do}

    def _status(self, video: str) -> str:
        statuses = [summary.rows.get(video, Row("")).status for summary in self.summaries]
        return "" if "" in statuses else next((word for word in statuses if word != DONE), DONE)

    @property
    def warnings(self) -> dict[str, list[str]]:
        """The warnings about each video, from all models; only videos that have some."""
        by_video: dict[str, list[str]] = {}
        for summary in self.summaries:
            for video, row in summary.rows.items():
                lines = [*by_video.get(video, []), *row.record.get("warnings", [])]
                by_video[video] = list(dict.fromkeys(lines))
        return {video: lines for video, lines in sorted(by_video.items()) if lines}

    @property
    def failure(self) -> DlgmdError | None:  # type: ignore[override]
        """Why the exit code is 1: a video, a folder or a figure failed."""
        if self.is_dry:
            return None
        statuses, out = self.statuses, printable(self.out)
        n_total, n_failed = len(statuses), sum(status != DONE for status in statuses.values())
        if n_failed:
            n_done, those = n_total - n_failed, "it" if n_total == 1 else f"those {n_failed}"
            kept = "result is" if n_done == 1 else f"{n_done} results are"
            rest = f"; the other {kept} in {out}" if n_done else ""
            those = "that one" if n_failed == 1 < n_total else those
            why = f"{n_failed} of {counted(n_total, 'video')} failed{rest}"
            return DlgmdError("", why, f"Fix or remove {those}, then run again.")
        if self.faults:
            why = f"some folders could not be read; the results of the others are in {out}"
            return DlgmdError("", why, "Check their access rights, then run again.")
        if any(row.lacks_figures for summary in self.summaries for row in summary.rows.values()):
            return DlgmdError("", f"some figures could not be drawn; all tables are in {out}")
        return None

    def facts(self) -> dict[str, Any]:
        """What --json prints."""
        if self.is_dry:
            return {"dry_run": True, "videos": len(self.to_do), "to_do": self.to_do}
        paths, statuses = [str(summary.path) for summary in self.summaries], self.statuses
        return {
            "summary": paths[0] if len(paths) == 1 else dict(zip(self.labels, paths, strict=True)),
            "complete": self.complete,
            "videos": len(statuses),
            "already_done": self._n_before,
            "status": {DONE: 0, **Counter(status for status in statuses.values() if status)},
            "warnings": self.warnings,
        }

    @property
    def _n_before(self) -> int:
        return sum(not folders for folders in self.to_do.values())

    def shown(self) -> Iterator[Shown]:
        """A table for each model, the paths of the summaries, and the counts."""
        if self.is_dry:
            yield from self._planned()
            return
        for label, summary in zip(self.labels, self.summaries, strict=True):
            rows = sorted(summary.rows.items())
            if len(rows) > _MAX_ROWS:
                rows = [(name, row) for name, row in rows if row.status != DONE]
            if rows:
                yield (label, *_HEADER), [(name, row.status, *_cells(row)) for name, row in rows]
        for summary in self.summaries:
            yield summary.path
        yield self._counts()

    def _planned(self) -> Iterator[Shown]:
        """What the batch would do."""
        rows = [
            (name, ", ".join(folders.values()) or "– (done before)")
            for name, folders in self.to_do.items()
        ]
        yield ("video", "would be written to"), rows
        n_videos, n_before = len(rows), self._n_before
        yield (
            f"{counted(n_videos, 'video')}: {n_videos - n_before} to process, {n_before} done "
            "before. Nothing was written."
        )

    def _counts(self) -> str:
        """One line with the number of videos, in total and by status."""
        statuses = self.statuses
        by_status, n_before = Counter(statuses.values()), self._n_before
        done = f"{by_status.pop(DONE, 0)} done"
        parts = [f"{done} ({n_before} before)" if n_before else done]
        n_open = by_status.pop("", 0)
        parts += [f"{n} {status}" for status, n in sorted(by_status.items())]
        parts += [f"{n_open} not processed"] if n_open else []
        alarmed = {
            video
            for summary in self.summaries
            for video, row in summary.rows.items()
            if row.record.get("summary", {}).get("alarms")
        }
        n_warned = len(self.warnings)
        parts += [f"{len(alarmed)} with alarms"]
        parts += [f"{n_warned} with warnings"] if n_warned else []
        videos = f"{counted(len(statuses), 'video')}: {', '.join(parts)}."
        return f"{videos} Model: {', '.join(self.labels)}."

    def kept(self) -> str:
        """What there is after an interruption."""
        statuses = self.statuses
        n_done = sum(status == DONE for status in statuses.values())
        return f"{n_done} of {len(statuses)} videos are done; the same command continues from there"


_HEADER = ("status", "frames", "peak MP", "spikes", "alarms", "first alarm")


def _cells(row: Row) -> tuple[str, ...]:
    """The cells of a video for a terminal."""
    summary: Mapping[str, Any] = row.record.get("summary", {})
    if not summary:
        return ("–",) * (len(_HEADER) - 1)
    peak = "–" if summary["mp_max"] is None else f"{summary['mp_max']:.6g}"
    first = "–"
    if None not in (summary["first_alarm_frame"], summary["first_alarm_time_s"]):
        first = "frame {first_alarm_frame}, {first_alarm_time_s:.3f} s".format(**summary)
        first += f", {side}" if (side := summary.get("first_alarm_side")) else ""
    spikes, alarms = str(summary["spikes"]), str(summary["alarms"])
    return frames_text(row.record), peak, spikes, alarms, first
