"""A result that grows frame by frame in its files, and never in memory."""

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TextIO

from dlgmd_cli.errors import OutputError
from dlgmd_cli.live.watch import BEGIN, Answer
from dlgmd_cli.models.detection import LEAST_PEAK, Alarm
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.record import record_text
from dlgmd_cli.runs.setup import Setup
from dlgmd_cli.video.base import FALLBACK_FPS
from dlgmd_cli.video.live import LiveSource, without_password
from dlgmd_cli.video.options import InputOptions

# Some three hours; these take a third of a second.
_MAX_NORMALISED = 300_000
_HEADER = "# Written by 'dlgmd live'; frames that the model did not see have no row.\n"


class Recording:
    """Writes the files of a result as `dlgmd run` does, a row with each answer.

    The record, run.yaml, is there from the beginning and says ``complete: false`` until `close`: so
    what a killed process has seen can be read. (Where the power fails, the last seconds may not
    have reached the disk.) `mp_seq` needs the whole sequence: in the file it is empty until then,
    and stays so in very long ones, which would take too long to write again.

    Parameters
    ----------
    folder : Path
        Made if need be; what stands there is replaced.
    source : LiveSource
        What is watched.
    setup, options, alarm : Setup, InputOptions, Alarm
        The model with its parameters, how it sees the source, and what answers.
    tell : callable
        Called with the reason if the folder cannot be written any more. The recording ends there;
        the alarm must not.

    Attributes
    ----------
    has_failed : bool
        Whether it ended so.
    """

    def __init__(
        self,
        folder: Path,
        source: LiveSource,
        setup: Setup,
        options: InputOptions,
        alarm: Alarm,
        tell: Callable[[str], None],
    ) -> None:
        self._folder, self._source, self._setup = folder, source, setup
        self._options, self._alarm, self._tell = options, alarm, tell
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
        """Whether there was a frame to keep."""
        return bool(self._files)

    def put(self, answer: Answer) -> None:
        """Write the rows of an answer; a frame that the model did not see has none."""
        if answer.is_repeat or self.has_failed:
            return
        with self._failing():
            if not self._files:
                self._begin()
            self._write_rows(answer)
            self._count(answer)

    def close(self) -> None:
        """Fill in `mp_seq`, and write the final record."""
        if not self._files or self.has_failed:
            return
        with self._failing():
            for file in self._files.values():
                file.close()
            if self._n_rows <= _MAX_NORMALISED:
                store.write_files(self._folder, {"mp.csv": self._write_normalised})
            self._write_record(complete=True)

    @contextmanager
    def _failing(self) -> Iterator[None]:
        """End the recording, not the program, if the folder cannot be written."""
        try:
            with store.writing(self._folder):
                yield
        except OutputError as error:
            self.has_failed = True
            self._tell(f"the recording has ended: {error.what} {error.why}")
            for file in self._files.values():
                with suppress(OSError):
                    file.close()

    def _begin(self) -> None:
        """Make the files, in place of those of an earlier result."""
        self._folder.mkdir(parents=True, exist_ok=True)
        store.remove(self._folder, store.files_of(store.RUN))
        for name, header in csv.TABLES.items():
            file = (self._folder / name).open("w", encoding="utf-8", newline="")
            self._files[name] = file
            file.write(",".join(header) + "\n")
        self._write_record(complete=False)

    def _write_rows(self, answer: Answer) -> None:
        """A row in each file, out of this process at once."""
        frame, said, cell = answer.frame, answer.said, csv.cell
        begin = [str(frame.index), cell(frame.time_s)]
        mp_abs, db = cell(said.mp_abs), cell(said.attenuation_db)
        threshold = self._setup.params.t_mp
        rows = {
            "mp.csv": [cell(said.mp), mp_abs, "", cell(said.g_x), cell(said.g_y)],
            "attenuation.csv": [cell(said.p_sum), cell(said.s_sum), db],
            "spikes.csv": [mp_abs, cell(threshold), f"{said.spike:d}", f"{said.alarm:d}"],
        }
        for name, cells in rows.items():
            self._files[name].write(",".join(begin + cells) + "\n")
            self._files[name].flush()

    def _count(self, answer: Answer) -> None:
        """Take an answer into the summary, as `Result.summary` has it."""
        frame, said, summary = answer.frame, answer.said, self._summary
        self._n_rows, self._last = self._n_rows + 1, (frame.index, frame.time_s)
        if said.is_valid:
            self._least = min(self._least, said.mp)
            if summary["mp_max"] is None or said.mp > summary["mp_max"]:
                summary |= {
                    "mp_max": said.mp,
                    "mp_max_frame": frame.index,
                    "mp_max_time_s": frame.time_s,
                }
        if said.spike:
            summary["spikes"] += 1
            if summary["first_spike_time_s"] is None:
                summary["first_spike_time_s"] = frame.time_s
        if answer.event == BEGIN:
            summary["alarms"] += 1
            if summary["first_alarm_frame"] is None:
                summary["first_alarm_frame"] = frame.index
                summary["first_alarm_time_s"] = frame.time_s
        if math.isfinite(said.attenuation_db):
            self._db_sum, self._n_db = self._db_sum + said.attenuation_db, self._n_db + 1
            summary["mean_attenuation_db"] = self._db_sum / self._n_db

    def _write_normalised(self, path: Path) -> None:
        """Copy mp.csv, line by line, with its column `mp_seq`."""
        least, most = self._least, self._summary["mp_max"]
        is_defined = most is not None and most > least and most >= LEAST_PEAK
        with (
            (self._folder / "mp.csv").open(encoding="utf-8", newline="") as before,
            path.open("w", encoding="utf-8", newline="") as after,
        ):
            after.write(next(before))
            for line in before:
                cells = line.rstrip("\n").split(",")
                if is_defined and cells[2]:
                    cells[4] = csv.cell((float(cells[2]) - least) / (most - least))
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
                "path": without_password(source.name),
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
            "warnings": [],
            "complete": complete,
            "summary": self._summary,
        }
        text = record_text(record, [str(record["engine"])], _HEADER)
        store.write_text(self._folder / store.RUN, text)
