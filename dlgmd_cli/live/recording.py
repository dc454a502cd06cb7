"""A result that grows frame by frame in its files; memory holds some three hours of it."""

import logging
import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from dlgmd_cli.errors import OutputError
from dlgmd_cli.live.watch import BLIND, END, SEES, Answer, Sight
from dlgmd_cli.models.detection import Alarm
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import record_text
from dlgmd_cli.results.result import Result
from dlgmd_cli.results.rows import RowList
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.base import FALLBACK_FPS
from dlgmd_cli.video.live import LiveSource
from dlgmd_cli.video.options import InputOptions

_log = logging.getLogger(__name__)

# Some three hours: 26 MB, and mp.csv takes a third of a second to write again.
_MAX_HELD = 300_000
_HEADER = "# Written by 'dlgmd live'; frames that the model did not see have no row.\n"


class Recording:
    """Writes the files of a result as `dlgmd run` does, a row with each answer; a context manager.

    The record, run.yaml, is there from the first row on and says ``complete: false`` until the
    context ends without an exception: the rows of a killed process can be read. (After a power
    failure, the last seconds may be missing.) `mp_seq` and the summary need the whole sequence:
    they are empty until then, and stay so in recordings of more than some three hours. An alarm is
    written when it has ended.

    A folder that cannot be written any more ends the recording with a warning, but not the alarm.

    Parameters
    ----------
    folder : Path
        Created if necessary; an earlier result there is replaced.
    source : LiveSource
        The source.
    setup, options, alarm : Setup, InputOptions, Alarm
        The model with its parameters, the options of its input, and its alarm.
    sight : Sight
        Of the source, for warnings.

    Attributes
    ----------
    has_failed : bool
        Whether the folder could not be written.
    """

    def __init__(
        self,
        folder: Path,
        source: LiveSource,
        setup: Setup,
        options: InputOptions,
        alarm: Alarm,
        sight: Sight,
    ) -> None:
        self._folder, self._source, self._setup = folder, source, setup
        self._options, self._alarm, self._sight = options, alarm, sight
        self.has_failed = False
        self._summary: dict[str, Any] = {}
        self._rows, self._n_rows, self._last = RowList(), 0, (-1, 0.0)
        self._files: dict[str, TextIO] = {}

    @property
    def has_begun(self) -> bool:
        """Whether any frame was recorded."""
        return self._n_rows > 0

    def put(self, answer: Answer) -> None:
        """Write the rows of an answer; a frame that the model did not see has none."""
        if self.has_failed:
            return
        with self._failing():
            if answer.is_of_frame and not answer.is_repeat:
                is_first = not self._files
                if is_first:
                    self._begin()
                self._write_rows(answer)
                if is_first:  # a record without rows is not a result
                    self._write_record(complete=False)
            if answer.event == END and self._files:
                self._write_line(csv.ALARMS, csv.alarm_cells(answer.span))
            if answer.event in (BLIND, SEES) and self._files:
                self._write_record(complete=False)

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if not self._files or self.has_failed:
            return
        with self._failing():
            for file in self._files.values():
                file.close()
            if self._n_rows <= _MAX_HELD:
                self._write_whole()
            self._write_record(complete=kind is None)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """End the recording, not the program, if the folder cannot be written."""
        try:
            with store.writing(self._folder):
                yield
        except OutputError as error:
            self.has_failed = True
            _log.error("the recording has ended: %s %s", error.what, error.why)
            for file in self._files.values():
                with suppress(OSError):
                    file.close()
            if not self._n_rows:
                with suppress(OSError):
                    store.remove(self._folder, store.files_of(store.RUN))

    def _begin(self) -> None:
        """Create the files, in place of those of an earlier result."""
        self._folder.mkdir(parents=True, exist_ok=True)
        store.remove(self._folder, store.files_of(store.RUN))
        for name, header in {**csv.TABLES, csv.ALARMS: csv.ALARM_COLUMNS}.items():
            self._files[name] = (self._folder / name).open("w", encoding="utf-8", newline="")
            self._write_line(name, header)

    def _write_line(self, name: str, cells: Iterable[str]) -> None:
        """Write a row to a file and flush it."""
        self._files[name].write(",".join(cells) + "\n")
        self._files[name].flush()

    def _write_rows(self, answer: Answer) -> None:
        """Write a row of each table. Columns are attributes of the detection."""
        assert answer.frame is not None
        found = answer.detection
        others = {
            "frame": answer.frame.index,
            "time_s": answer.frame.time_s,
            "mp_seq": math.nan,
            "level": found.mp_abs,
            "threshold": self._setup.params.t_mp,
        }
        for name, header in csv.TABLES.items():
            values = (others[key] if key in others else getattr(found, key) for key in header)
            self._write_line(name, map(csv.cell, values))
        self._n_rows, self._last = self._n_rows + 1, (answer.frame.index, answer.frame.time_s)
        if self._n_rows <= _MAX_HELD:
            self._rows.append(answer.frame, found)
        else:
            self._rows = RowList()

    def _write_whole(self) -> None:
        """Find the summary, and copy mp.csv, line by line, with its column `mp_seq`."""
        result = Result(self._rows.rows(), self._setup.params, self._record())
        self._summary = result.summary
        place = csv.TABLES["mp.csv"].index("mp_seq")

        def write(path: Path) -> None:
            with (
                (self._folder / "mp.csv").open(encoding="utf-8", newline="") as before,
                path.open("w", encoding="utf-8", newline="") as after,
            ):
                after.write(next(before))
                for line, value in zip(before, result.mp_seq, strict=True):
                    cells = line.rstrip("\n").split(",")
                    cells[place] = csv.cell(value)
                    after.write(",".join(cells) + "\n")

        store.write_files(self._folder, {"mp.csv": write})

    def _write_record(self, *, complete: bool) -> None:
        record = {**self._record(), "complete": complete, "summary": self._summary}
        text = record_text(record, [str(record["engine"])], _HEADER)
        store.write_text(self._folder / store.RUN, text)

    def _record(self) -> dict[str, Any]:
        """What run.yaml says about the input, the model and the warnings so far."""
        (index, time_s), source, alarm = self._last, self._source, self._alarm
        (width, height), size_wh = source.picture_wh, source.size_wh
        fps = source.fps if source.fps > 0.0 else FALLBACK_FPS
        processed = {"width": size_wh[0], "height": size_wh[1], "frames": self._n_rows}
        if (hidden := source.hidden()) is not None:
            processed["cells"] = int((~hidden).sum())
        return {
            "input": {
                "path": source.name,
                "width": width,
                "height": height,
                "fps": round(fps, 3),
                "frames": index + 1,
                "duration_s": time_s + 1.0 / fps,
                "decoder": "live",
                "dropped": source.n_dropped,
                "left_out": source.n_left_out,
            },
            "processed": processed,
            **self._setup.named,
            **self._setup.settings(),
            "engine": alarm.model.engine_name,
            "options": self._options.to_record(),
            "warnings": self._sight.warnings(),
        }
