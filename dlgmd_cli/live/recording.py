"""A result that grows frame by frame in its files, and never in memory."""

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from dlgmd_cli.errors import OutputError
from dlgmd_cli.live.watch import BEGIN, BLIND, SEES, Answer, Sight
from dlgmd_cli.models.detection import LEAST_PEAK, Alarm
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import record_text
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.base import FALLBACK_FPS
from dlgmd_cli.video.live import LiveSource
from dlgmd_cli.video.options import InputOptions

_log = logging.getLogger(__name__)

# Some three hours; these take a third of a second.
_MAX_NORMALISED = 300_000
_HEADER = "# Written by 'dlgmd live'; frames that the model did not see have no row.\n"


class Recording:
    """Writes the files of a result as `dlgmd run` does, a row with each answer; a context manager.

    The record, run.yaml, is there from the first frame on and says ``complete: false`` until the
    context ends without an exception: the rows of a killed process can be read. (After a power
    failure, the last seconds may be missing.) `mp_seq` needs the whole sequence: in the file it is
    empty until then, and stays so in very long ones, which would take too long to write again.

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
        self._summary: dict[str, Any] = {
            **dict.fromkeys(("mp_max", "mp_max_frame", "mp_max_time_s")),
            "spikes": 0,
            "first_spike_time_s": None,
            "alarms": 0,
            **dict.fromkeys(("first_alarm_frame", "first_alarm_time_s", "mean_attenuation_db")),
        }
        self._least, self._n_rows, self._last = math.inf, 0, (-1, 0.0)
        self._db_sum, self._n_db = 0.0, 0
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
                if not self._files:
                    self._begin()
                self._write_rows(answer)
                self._count(answer)
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
            if self._n_rows <= _MAX_NORMALISED:
                store.write_files(self._folder, {"mp.csv": self._write_normalised})
            self._write_record(complete=kind is None)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """End the recording, not the program, if the folder cannot be written."""
        try:
            with store.writing(self._folder):
                yield
        except OutputError as error:
            self.has_failed = True
            _log.warning("the recording has ended: %s %s", error.what, error.why)
            for file in self._files.values():
                with suppress(OSError):
                    file.close()
            if not self._n_rows:  # a record without rows is not a result
                with suppress(OSError):
                    store.remove(self._folder, store.files_of(store.RUN))

    def _begin(self) -> None:
        """Create the files, in place of those of an earlier result."""
        self._folder.mkdir(parents=True, exist_ok=True)
        store.remove(self._folder, store.files_of(store.RUN))
        for name, header in csv.TABLES.items():
            file = (self._folder / name).open("w", encoding="utf-8", newline="")
            self._files[name] = file
            file.write(",".join(header) + "\n")
        self._write_record(complete=False)

    def _write_rows(self, answer: Answer) -> None:
        """Write a row to each file and flush it. Columns are attributes of the detection."""
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
            self._files[name].write(",".join(map(csv.cell, values)) + "\n")
            self._files[name].flush()

    def _count(self, answer: Answer) -> None:
        """Take an answer into the summary, as `Result.summary` has it."""
        assert answer.frame is not None
        frame, found, summary = answer.frame, answer.detection, self._summary
        self._n_rows, self._last = self._n_rows + 1, (frame.index, frame.time_s)
        if found.is_valid:
            self._least = min(self._least, found.mp)
            if summary["mp_max"] is None or found.mp > summary["mp_max"]:
                summary |= {
                    "mp_max": found.mp,
                    "mp_max_frame": frame.index,
                    "mp_max_time_s": frame.time_s,
                }
        if found.spike:
            summary["spikes"] += 1
            if summary["first_spike_time_s"] is None:
                summary["first_spike_time_s"] = frame.time_s
        if answer.event == BEGIN:
            summary["alarms"] += 1
            if summary["first_alarm_frame"] is None:
                summary["first_alarm_frame"] = frame.index
                summary["first_alarm_time_s"] = frame.time_s
        if math.isfinite(found.attenuation_db):
            self._db_sum, self._n_db = self._db_sum + found.attenuation_db, self._n_db + 1
            summary["mean_attenuation_db"] = self._db_sum / self._n_db

    def _write_normalised(self, path: Path) -> None:
        """Copy mp.csv, line by line, with its column `mp_seq`."""
        header = csv.TABLES["mp.csv"]
        from_mp, to_seq = header.index("mp"), header.index("mp_seq")
        least, most = self._least, self._summary["mp_max"]
        is_defined = most is not None and most > least and most >= LEAST_PEAK
        with (
            (self._folder / "mp.csv").open(encoding="utf-8", newline="") as before,
            path.open("w", encoding="utf-8", newline="") as after,
        ):
            after.write(next(before))
            for line in before:
                cells = line.rstrip("\n").split(",")
                if is_defined and cells[from_mp]:
                    cells[to_seq] = csv.cell((float(cells[from_mp]) - least) / (most - least))
                after.write(",".join(cells) + "\n")

    def _write_record(self, *, complete: bool) -> None:
        """Write run.yaml."""
        (index, time_s), source, alarm = self._last, self._source, self._alarm
        (width, height), size_wh = source.picture_wh, source.size_wh
        fps = source.fps if source.fps > 0.0 else FALLBACK_FPS
        processed = {"width": size_wh[0], "height": size_wh[1], "frames": self._n_rows}
        if (hidden := source.hidden()) is not None:
            processed["cells"] = int((~hidden).sum())
        record = {
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
            "complete": complete,
            "summary": self._summary,
        }
        text = record_text(record, [str(record["engine"])], _HEADER)
        store.write_text(self._folder / store.RUN, text)
