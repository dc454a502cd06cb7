"""Recording: a result whose files grow frame by frame; memory holds about three hours of rows."""

import logging
import math
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import IO

import cv2
import numpy as np

from dlgmd_cli import Model, Result
from dlgmd_cli.errors import OutputError, argument
from dlgmd_cli.frame import BgrImage, Frame
from dlgmd_cli.machine import cancel
from dlgmd_cli.machine.threads import started_thread
from dlgmd_cli.models.columns import ALARMS
from dlgmd_cli.models.corridor import Motion
from dlgmd_cli.parameters.facts import InputFacts, Record, Summary
from dlgmd_cli.results import csv, store
from dlgmd_cli.results.csv import RowList
from dlgmd_cli.results.files import names_of, written
from dlgmd_cli.results.record import record_text
from dlgmd_cli.tasks.call import Setup
from dlgmd_cli.tasks.camera import HEADING_COLUMNS, MOTION_COLUMNS, camera_of
from dlgmd_cli.tasks.describing import doubts_of, model_record, processed_record
from dlgmd_cli.video.base import FALLBACK_FPS
from dlgmd_cli.video.input_options import InputOptions
from dlgmd_cli.video.live_source import LiveSource
from dlgmd_cli.video.writer import by_opencv, playable_fps
from dlgmd_cli.watch.watch import BEGIN, BLIND, END, SEES, Answer, SourceState

_log = logging.getLogger(__name__)

VIDEO, PICTURES, HEADINGS, MASK = "video.mkv", "pictures", "heading.csv", "kept-mask.png"
_JPEG_QUALITY, _NOTHING = 90, np.zeros((0, 0), np.uint8)
# Maximum number of images that wait for the encoder; time limit (s) of the encoder at the end.
_MAX_PICTURES, _CLOSING_S = 60, 5.0
# Maximum number of rows in memory: about three hours, 29 MB; rewriting mp.csv takes 1/3 s.
MAX_HELD = 300_000
_HEADER = "# Written by 'dlgmd live'; frames that were dropped have no row.\n"


class Recording:
    """Writes the files of a result as `dlgmd run` does, one row per answer; a context manager.

    The record, run.yaml, exists from the first row on, so that the rows of a killed process can be
    read. (After a power failure, the last seconds may be missing.) The record says
    ``complete: false`` unless the context ended because the source ended, not by an exception or a
    signal. `mp_seq`, the summary and warnings about the result need the whole sequence: they are
    empty until the end, and stay empty in recordings of more than about three hours. An alarm is
    written after its end. The record names a table of the directions of flight that an autopilot
    reports, and a file of the mask, cropped like the kept images.

    If the folder becomes unwritable, the recording ends with an error message; the alarm goes on.

    Parameters
    ----------
    source : LiveSource
        The source.
    setup, options, model : Setup, InputOptions, Model
        The model with its parameters, and the options of its input.
    state : SourceState
        The state of the source, for warnings.
    folder : Path
        The folder, claimed within the context; raises what `store.claimed` raises.
    film : str
        `VIDEO` or `PICTURES` to keep an image of each row; the record names these as the input.
    overwrite : bool
        Whether an earlier result in the folder may be replaced.

    Attributes
    ----------
    has_failed : bool
        Whether writing to the folder has failed.
    n_rows : int
        Number of recorded frames.
    """

    def __init__(
        self,
        source: LiveSource,
        setup: Setup,
        options: InputOptions,
        model: Model,
        state: SourceState,
        folder: Path,
        *,
        film: str = "",
        overwrite: bool = False,
    ) -> None:
        self._folder, self._overwrite, self._claiming = folder, overwrite, ExitStack()
        self._source, self._setup = source, setup
        keeper = KeptPictures if film == PICTURES else KeptVideo
        self._film = keeper(folder / film) if film else None
        source.keeps_pictures |= bool(film)
        self._options, self._model, self._state = options, model, state
        self.has_failed = False
        self._summary: Summary = {}
        self._doubts: list[str] = []
        self._headers = csv.headers(model.columns)
        self._rows, self.n_rows, self._last = RowList(model.columns), 0, (-1, 0.0)
        self._files: dict[str, IO[str]] = {}

    def put(self, answer: Answer) -> None:
        """Write the rows of an answer to a frame, and the alarm if it has ended."""
        if self.has_failed:
            return
        with self._failing():
            if answer.is_of_frame:
                is_first = not self._files
                if is_first:
                    self._begin()
                self._write_rows(answer)
                if is_first:  # a record without rows is not a result
                    self._write_record()
            if answer.event == END and answer.span is not None and self._files:
                row = csv.cells(csv.ALARM_COLUMNS, answer.span.to_dict().values())
                self._write_line(ALARMS, row)
            if answer.event in (BLIND, SEES) and self._files:
                self._write_record()

    def __enter__(self) -> "Recording":
        identity: InputFacts = {"path": self._source.name}
        claimed = store.claimed(
            self._folder, store.RUN, identity, overwrite=self._overwrite, named_by="record"
        )
        # The claim has no record, so that rewriting the record leaves the growing tables alone.
        self._claim = replace(self._claiming.enter_context(claimed), record="")
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        with self._claiming:
            if self._files and not self.has_failed:
                self._complete(is_whole=kind is None and not cancel.requested())

    def _complete(self, *, is_whole: bool) -> None:
        """Close the files, and write the values that need the whole sequence."""
        with self._failing():
            for file in self._files.values():
                file.close()
            if self._film is not None:
                self._film.close()
            if self.n_rows <= MAX_HELD:
                self._write_whole()
            self._write_record(complete=is_whole)

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
            if not self.n_rows:
                with suppress(OSError):
                    store.remove(self._folder, names_of(store.RUN))

    def _begin(self) -> None:
        """Create the files, replacing the files of an earlier result."""
        self._folder.mkdir(parents=True, exist_ok=True)
        store.remove(self._folder, names_of(store.RUN) | {VIDEO, HEADINGS, MASK})
        for name, header in {**self._headers, ALARMS: csv.ALARM_COLUMNS}.items():
            self._create(name, header)
        region = self._source.region
        if self._keeps_part and region is not None and region.masked is not None:
            white = np.where(region.masked, np.uint8(0), np.uint8(255))
            self._claim.write({MASK: store.file_of(cv2.imencode(".png", white)[1].tobytes())})

    @property
    def _keeps_part(self) -> bool:
        """Whether the kept images show only the part that `crop` leaves."""
        return self._film is not None and self._options.crop is not None

    def _create(self, name: str, header: Iterable[str]) -> None:
        self._files[name] = self._claim.created(name)
        self._write_line(name, header)

    def _write_line(self, name: str, cells: Iterable[str]) -> None:
        """Write a row to a file and flush it."""
        self._files[name].write(",".join(cells) + "\n")
        self._files[name].flush()

    def _write_rows(self, answer: Answer) -> None:
        """Write a row of each table. Columns are attributes of the detection."""
        assert answer.frame is not None
        detection = answer.detection
        others = {
            "mp_seq": math.nan,
            "threshold": self._setup.params.t_mp,
            **{name: detection.more.get(name, math.nan) for name in self._model.columns},
        }
        if self._film is not None:
            self._film.put(answer.frame.picture, self._source.taken_fps)
        self._write_heading(answer.motion, answer.frame.index)
        for name, header in self._headers.items():
            values = (others[key] if key in others else getattr(detection, key) for key in header)
            self._write_line(name, csv.cells(header, values))
        self.n_rows, self._last = self.n_rows + 1, (answer.frame.index, answer.frame.time_s)
        if self.n_rows <= MAX_HELD:
            self._rows.append(detection)
        else:
            self._rows = RowList()

    def _write_heading(self, motion: Motion, frame: int) -> None:
        """Write the motion, from the first known number on."""
        cells = ["" if math.isnan(one) else repr(one) for one in (*motion.direction, *motion[1:])]
        if any(cells) and HEADINGS not in self._files:
            self._create(HEADINGS, (*HEADING_COLUMNS, *MOTION_COLUMNS))
        if HEADINGS in self._files:
            # In kept images, the frame number is the row number.
            at = frame if self._film is None else self.n_rows
            self._write_line(HEADINGS, [str(at), *cells])

    def _write_whole(self) -> None:
        """Compute the summary and warnings, and write the files as `run` does, with `mp_seq`."""
        source, result = self._source, Result(self._rows.rows(), self._setup.params, self._record())
        assert source.region is not None
        camera, _ = camera_of(self._options, source.picture_wh, source.name)
        self._doubts = doubts_of(result, camera, source.region.size_wh)
        self._summary = result.summary
        self._claim.write(written(result, store.RUN))

    def _write_record(self, *, complete: bool = False) -> None:
        record: Record = {**self._record(), "complete": complete, "interrupted": not complete}
        record["summary"] = self._summary
        text = record_text(record, _HEADER)
        self._claim.write({store.RUN: store.file_of(text)})

    def _record(self) -> Record:
        """The contents of run.yaml: the input, the model and the warnings so far."""
        (index, time_s), source = self._last, self._source
        width, height = source.picture_wh
        fps = source.fps if source.fps > 0.0 else FALLBACK_FPS
        kept: InputFacts = {}
        if self._film is not None:
            kept = {"path": str(self._film.path), "source": source.name}
        if self._keeps_part:
            kept["crop"] = str(self._options.crop)
        turns: InputFacts = {}
        if source.rotate:
            turns["rotate"] = source.rotate
        if source.flip:
            turns["flip"] = source.flip
        options = self._options if not kept else _of_kept(self._options, source)
        if self._keeps_part and options.mask is not None:
            options = replace(options, mask=str(self._folder.absolute() / MASK))
        has_headings = HEADINGS in self._files
        headings = str(self._folder.absolute() / HEADINGS) if has_headings else None
        return {
            "input": {
                "path": source.name,
                **kept,
                "width": width,
                "height": height,
                "fps": round(fps, 3),
                "frames": index + 1,
                "duration_s": time_s + 1.0 / fps,
                "decoder": "live",
                "dropped": source.n_dropped,
                "left_out": source.n_left_out,
                **turns,
            },
            "processed": processed_record(source.size_wh, self.n_rows, source.hidden()[0]),
            **model_record(self._setup, self._model),
            **camera_of(self._options, source.picture_wh, source.name)[1],
            "options": replace(options, heading=headings).to_record(),
            "warnings": [*self._state.warnings(), *self._doubts],
        }


def _of_kept(options: InputOptions, source: LiveSource) -> InputOptions:
    """The options for processing the kept images again: all of them, without another crop.

    Kept images may be smaller than the images that `scale` refers to.
    """
    if options.scale is not None:
        options = replace(options, scale=None, size=source.size_wh)
    repeats, fps = options.repeats or "skip", source.taken_fps
    input_fps = round(fps, 3) if fps > 0.0 else FALLBACK_FPS
    return replace(options, crop=None, fps="all", repeats=repeats, input_fps=input_fps)


class KeptPictures:
    """A folder with an image for each row, as JPEG, numbered from 0.

    Attributes
    ----------
    path : Path
        The folder, absolute.
    """

    def __init__(self, path: Path) -> None:
        self.path, self._n_kept = path.absolute(), 0

    def put(self, picture: BgrImage | None, fps: float) -> None:
        """Write an image that is already encoded."""
        assert picture is not None
        self.path.mkdir(parents=True, exist_ok=True)
        (self.path / f"{self._n_kept:06d}.jpg").write_bytes(picture.tobytes())
        self._n_kept += 1

    def close(self) -> None:
        """Do nothing: each image is written at once."""


class LastSeconds:
    """Keeps the rows of the last seconds with their images, and records them at an alarm.

    A `Receiver` calls it in the receiver's thread. A recording lasts until the alarm has ended; no
    row is recorded twice, and the next recording begins after the last recorded row.

    Parameters
    ----------
    seconds : float
        The duration to keep before an alarm.
    folder : Path
        The parent folder. Each recording has the next free folder inside, from ``alarm-1`` on.
    recorded : callable
        Creates the recording in a folder.
    """

    def __init__(
        self,
        seconds: float,
        folder: Path,
        recorded: Callable[..., Recording],
    ) -> None:
        self._seconds, self._folder, self._recorded = seconds, folder, recorded
        self._kept: deque[Answer] = deque()
        self._open = ExitStack()
        self._recording: Recording | None = None

    def __call__(self, answer: Answer) -> None:
        """Keep an answer, or record it while an alarm is on."""
        if answer.frame is not None and answer.is_of_frame:
            answer = replace(answer, frame=_encoded(answer.frame))
        if answer.is_of_frame or self._recording is not None:
            self._kept.append(answer)
        if answer.event == BEGIN and self._recording is None:
            numbered = (self._folder / f"alarm-{number}" for number in count(1))
            folder = next(path for path in numbered if not path.exists())
            self._recording = self._open.enter_context(self._recorded(folder, film=PICTURES))
        while self._kept and self._recording is not None:
            self._recording.put(self._kept.popleft())
        if answer.event == END:
            self.close()
        while self._kept and _time_of(self._kept[-1]) - _time_of(self._kept[0]) > self._seconds:
            self._kept.popleft()

    def close(self) -> None:
        """Complete the current recording, if any."""
        self._recording = None
        self._open.close()


def _time_of(answer: Answer) -> float:
    return math.nan if answer.frame is None else answer.frame.time_s


def _encoded(frame: Frame) -> Frame:
    """A frame that holds only its image, as the bytes of a JPEG."""
    picture = frame.picture
    if picture is not None:
        picture = cv2.imencode(".jpg", picture, (cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY))[1]
    return Frame(frame.index, frame.time_s, _NOTHING, frame.is_repeat, picture=picture)


class KeptVideo:
    """A video of the images that a model saw, one per row, written in its own thread.

    If the encoder is too slow for an image, the previous image is repeated. The file can be played
    even if the process is killed.

    Attributes
    ----------
    path : Path
        The file, absolute.
    """

    def __init__(self, path: Path) -> None:
        self.path = path.absolute()
        self._waiting: deque[BgrImage | None] = deque()
        self._changed, self._is_closed = threading.Condition(), False
        self._thread: threading.Thread | None = None

    def put(self, picture: BgrImage | None, fps: float) -> None:
        """Queue an image; returns at once. Writing begins as soon as the frame rate is known."""
        with self._changed:
            n_pictures = sum(image is not None for image in self._waiting)
            self._waiting.append(picture if n_pictures < _MAX_PICTURES else None)
            self._changed.notify()
        if self._thread is None and fps > 0.0:
            self._begin(fps)

    def _begin(self, fps: float) -> None:
        rate_fps, first = playable_fps(fps), self._waiting[0]
        assert first is not None
        self._thread = started_thread(lambda: self._write(first, rate_fps), "dlgmd-keep-video")

    def close(self) -> None:
        """Write the waiting images, for at most 5 s, and complete the file."""
        if self._thread is None and self._waiting:
            self._begin(FALLBACK_FPS)
        with self._changed:
            self._is_closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(_CLOSING_S)

    def _taken(self) -> Iterator[BgrImage | None]:
        """The queued images, until the end."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._is_closed)
                if not self._waiting:
                    return
                picture = self._waiting.popleft()
            yield picture

    def _write(self, shown: BgrImage, fps: float) -> None:
        shape = height, width = shown.shape[0] // 2 * 2, shown.shape[1] // 2 * 2
        try:
            with by_opencv("mpeg4", str(self.path), shape, fps, True) as write:
                for picture in self._taken():
                    shown = shown if picture is None else picture
                    write(shown[:height, :width])
        except OSError:
            _log.error("%s: %s cannot be written", argument("keep_video"), self.path)
